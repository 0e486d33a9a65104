"""Faults of the simulated bench, made at a chosen moment of a run."""
