"""Recordings shown live by other tools: Foxglove and PlotJuggler.

Everything here reads; nothing can command a bench.
"""

from rig.live.layout_files import layout
from rig.live.server import HOST, Offer, serve
from rig.live.session import sdk

__all__ = ["HOST", "Offer", "layout", "sdk", "serve"]
