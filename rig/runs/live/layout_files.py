"""Finds the packaged layout files for Foxglove and PlotJuggler."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

_FILES = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}


def layout(tool: Literal["foxglove", "plotjuggler"]) -> Path:
    """Return the path of the layout file for a tool."""
    return Path(__file__).parent / "layouts" / _FILES[tool]
