"""Recordings made elsewhere: one reader per file format, and conversion of columns to
recordings.
"""

from __future__ import annotations

from rig.sources.load import load_source

__all__ = ["load_source"]
