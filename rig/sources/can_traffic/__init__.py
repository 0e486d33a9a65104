"""Reads recorded CAN traffic: frames from any logger, and their signals by a DBC file or a bench
file.
"""

from __future__ import annotations

from rig.sources.can_traffic.table import CanTable

__all__ = ["CanTable"]
