"""Computes rates, lists and pages of a proof from its rows."""
