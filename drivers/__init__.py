"""Device access: buses, protocols, devices in SI units, and their simulated counterparts.

This package knows nothing of sequences, files or fits.
"""

from drivers.lean_imports import install as _install

_install()
