"""File formats of recordings made elsewhere: one reader for each format, all with the interface
of :class:`rig.sources.formats.table.Table`.
"""

from __future__ import annotations

from rig.sources.formats.table import Table, format_of

__all__ = ["Table", "format_of"]
