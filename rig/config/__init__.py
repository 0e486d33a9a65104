"""Reads and validates bench, sequence, campaign and fault files; holds the packaged examples."""
