"""The wire: buses, protocols, devices in SI units, and their simulated twins.

Knows nothing of sequences, files or fits.
"""
