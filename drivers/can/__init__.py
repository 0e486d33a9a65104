"""CAN ports: python-can adapters, the serial-line protocol slcan, bit timing."""

import sys
from typing import Any

_LEFT_OUT = "asammdf"


def _import_python_can() -> None:
    """Import python-can without its reader of MDF, which loads pandas: a second of every start."""
    modules: dict[str, Any] = sys.modules  # None keeps a module from being imported
    if "can" in modules or _LEFT_OUT in modules:
        return
    modules[_LEFT_OUT] = None
    try:
        import can  # noqa: F401
    finally:
        del modules[_LEFT_OUT]


_import_python_can()
