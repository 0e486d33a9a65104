"""Device access: buses, protocols, devices in SI units, and their simulated counterparts.

This package knows nothing of sequences, files or fits.
"""
