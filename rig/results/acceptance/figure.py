"""Figure of a run that was not identified: tracking error and current of its excitations."""

from __future__ import annotations

import numpy as np

from identification.plots.style import BLUE, VERMILION, Figure, figure, thinned
from identification.recording import Dataset


def overview(dataset: Dataset) -> Figure:
    """Draw tracking error and current of all excitations, one after the other."""
    made, (upper, lower) = figure(2, height=5.0, sharex=True)
    begun = 0.0
    for recording in dataset.recordings:
        few = thinned(len(recording.time))
        time = begun + recording.time[few] - recording.time[0]
        channels = recording.channels
        if "command" in channels and "angle" in channels:
            error = np.rad2deg(channels["command"] - channels["angle"])
            upper.plot(time, error[few], color=BLUE, linewidth=0.8)
        if "current" in channels:
            lower.plot(time, channels["current"][few], color=VERMILION, linewidth=0.8)
        upper.annotate(recording.name, (float(time[0]), 1.0), xycoords=("data", "axes fraction"))
        begun = float(time[-1])
    upper.set_ylabel("tracking error (deg)")
    lower.set_ylabel("motor current (A)")
    lower.set_xlabel("time of the excitations (s)")
    return made
