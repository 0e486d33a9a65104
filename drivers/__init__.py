"""Device access: buses, protocols, devices in SI units, and their simulated counterparts.

Knows nothing of sequences, files or fits.
"""
