"""Simulated CAN bus and serial lines in simulated time, and their clocks."""

import drivers.can  # noqa: F401 - before a library imports python-can
