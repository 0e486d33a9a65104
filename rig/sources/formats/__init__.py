"""File formats of recordings made elsewhere: one reader for each format, all with the same
interface.
"""

from __future__ import annotations

from rig.sources.formats.table import Table, format_of

__all__ = ["Table", "format_of"]
