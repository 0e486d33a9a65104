"""Reads recordings of other programs: one reader for each file format, and the conversion to
channels in SI units.
"""

from __future__ import annotations

from rig.sources.load import load_source

__all__ = ["load_source"]
