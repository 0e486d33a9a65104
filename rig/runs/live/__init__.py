"""Streams recordings to Foxglove and PlotJuggler.

The modules here only read recordings, and have no way to command a bench.

"""

from rig.runs.live.layout_files import layout
from rig.runs.live.server import HOST, Offer, serve
from rig.runs.live.session import sdk

__all__ = ["HOST", "Offer", "layout", "sdk", "serve"]
