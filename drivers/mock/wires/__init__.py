"""Simulated wires: CAN bus and serial lines in simulated time, and the clock."""
