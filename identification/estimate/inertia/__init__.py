"""Estimates the inertia by instrumental variables (M27-M32): instruments, variance inflation."""
