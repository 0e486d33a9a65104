"""Computes the plan of a run from sequence and bench: targets, limits, first passes."""
