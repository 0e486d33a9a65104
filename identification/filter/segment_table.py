"""Column numbers of the table of motion segments, which is an input of the Kalman filter."""

from __future__ import annotations

FIRST, LAST, DIRECTION, TORQUE_RATE = range(4)
"""The columns: first sample, sample after the last, direction of motion (1 or -1), and rate of rise
of the torque before the breakaway, N m/s; the rate is zero where the segment does not start from
rest.
"""
