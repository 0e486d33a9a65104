"""Checks the mass on the lever against its label, from the friction level."""
