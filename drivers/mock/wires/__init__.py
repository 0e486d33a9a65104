"""Simulated CAN bus and serial lines in simulated time, and their clocks."""
