"""Identifies friction, inertia and unmodelled effects of a machine from recordings.

    import identification as lr

    found = lr.identify(lr.Recording(time, angle, current, bench=lr.Bench(torque_constant=0.03)))
    found.values["J"], found.intervals["J"], found.covariance.matrix

What this module exports is the library; its modules are not part of it. Nothing is read from or
written to files, printed, or kept between calls. The package knows nothing of buses, devices or
operators.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identification.library import Effect, catalogue, diagnose, effect, identify, plan, simulate
    from identification.recording import (
        Bench,
        Controller,
        Dataset,
        Hoist,
        Model,
        Pendulum,
        Recording,
        RecordingError,
    )

__all__ = [
    "Bench",
    "Controller",
    "Dataset",
    "Effect",
    "Hoist",
    "Model",
    "Pendulum",
    "Recording",
    "RecordingError",
    "catalogue",
    "diagnose",
    "effect",
    "identify",
    "plan",
    "simulate",
]
_LIBRARY = frozenset({"Effect", "catalogue", "diagnose", "effect", "identify", "plan", "simulate"})


def __getattr__(name: str) -> Any:
    """Import what is exported on demand, so that the import of this package takes no time."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "library" if name in _LIBRARY else "recording"
    return getattr(import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return __all__
