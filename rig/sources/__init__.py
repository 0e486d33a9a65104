"""Reads recordings of other programs: a reader for each format, channels in SI units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.sources.build import load_source

__all__ = ["load_source"]


def __getattr__(name: str) -> Any:
    """Import the loader on demand: the process that reads one file does without it."""
    if name != "load_source":
        raise AttributeError(name)
    from rig.sources.build import load_source

    return load_source
