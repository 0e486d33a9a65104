"""Column numbers of the tables that are inputs of the Kalman filter."""

from __future__ import annotations

FIRST, LAST, DIRECTION, TORQUE_RATE = range(4)
"""Columns of the table of motion segments: first sample, sample after the last, direction of motion
(1 or -1), and rate of rise of the torque before the breakaway, N m/s, greater than zero.
"""
REST, EXTRA_INERTIA, QUANTISATION = range(4, 7)
"""Further columns of the table of an experiment: angle of the reading before the first sample, rad;
known inertia added to J, kg m^2; variance of the quantisation error of the angle, rad^2.
"""
TIME, BEFORE, ANGLE, TORQUE, SLOPE, MOMENT, STEPS, UNSURE = range(8)
"""Columns of the table of samples: time of the sample and of the one before it, s; angle, rad; mean
torque over the period between them, N m, and its rate of change, N m/s; mean contact moment F_P L1,
N m; number of integration steps; variance that is added to the variance of the speed, (rad/s)^2.
"""
SAMPLE_COLUMNS = UNSURE + 1
