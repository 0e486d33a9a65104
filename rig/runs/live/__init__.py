"""Recordings shown live by other tools: Foxglove and PlotJuggler.

Everything here reads; nothing can command a bench.
"""

from rig.runs.live.layout_files import layout
from rig.runs.live.server import HOST, Offer, serve
from rig.runs.live.session import sdk

__all__ = ["HOST", "Offer", "layout", "sdk", "serve"]
