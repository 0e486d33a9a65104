"""Reads recordings of other programs: one reader per file format, conversion to SI channels."""

from __future__ import annotations

from rig.sources.load import load_source

__all__ = ["load_source"]
