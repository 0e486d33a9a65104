"""The phases of a run."""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    """Phase of a run. The drive is energised only from ENABLE to RELEASE."""

    LOAD = "load"
    PREPARE = "prepare"
    ENABLE = "enable"
    FIRST_PASS = "first pass"
    WEIGH = "weight check"
    APPROACH = "approach"
    SETTLE = "settle"
    EXCITE = "excite"
    HOLD = "hold"
    RELEASE = "release"
    BOUNDARY = "between stages"
    FINISHED = "finished"
