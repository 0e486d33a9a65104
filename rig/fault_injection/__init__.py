"""Injection of faults into the simulated bench at chosen times of a run."""
