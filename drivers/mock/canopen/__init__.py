"""CANopen side of the simulated devices: object dictionary, SDO server, process data, node."""

import drivers.can  # noqa: F401 - before a library imports python-can
