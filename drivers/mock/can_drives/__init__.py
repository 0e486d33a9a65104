"""Simulated drives with frames of their own that are shaped as those of known kinds of drives."""
