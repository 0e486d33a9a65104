"""Fits friction models to the simulated angle, over a horizon or a whole recording."""
