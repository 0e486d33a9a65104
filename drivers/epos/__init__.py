"""The EPOS serial protocol: frames, link, node."""

import drivers.can  # noqa: F401 - before a library imports python-can
