"""Estimating equation of the inertia (M27 to M32): half cycles, instruments, variance inflation."""
