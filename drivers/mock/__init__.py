"""Simulated counterparts: a bus in simulated time and devices that speak the real wire."""
