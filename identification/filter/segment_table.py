"""Columns of the table of motion segments for the filter, one row per segment."""

from __future__ import annotations

FIRST, LAST, DIRECTION, TORQUE_RATE = range(4)
"""First sample, sample after the last, direction of motion (1 or -1), and rate of rise of the
torque before the breakaway, N m/s; zero where the segment does not start from rest.
"""
