"""Simulated buses and devices: a bus in simulated time, and devices that use the real protocols."""
