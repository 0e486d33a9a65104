"""The default identification method for recordings too long for memory, piece by piece.

The signals of the equation error are decimated to 2.5 times the bandwidth without loss of
information, as in the method for short recordings; only the velocity keeps the full sampling rate.
The prediction errors pass over the pieces
(:mod:`identification.estimate.likelihood.long_refinement`).
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from identification.estimate import default
from identification.estimate.default import (
    by_load,
    free_names,
    identification,
    solve_stages,
)
from identification.estimate.equation_error.block_sandwich import block_sandwich
from identification.estimate.likelihood import acceptance
from identification.estimate.likelihood.long_refinement import refine_pieces
from identification.estimate.likelihood.refinement import (
    Found,
    floors_of,
    joint_convergence,
    partly_used,
    spread_of,
)
from identification.estimate.uncertainty.parameter_table import (
    typical_error,
)
from identification.numerics.progress import Progress, silent
from identification.prepare import (
    default_bandwidth,
    joint_angle,
    prepare,
    resting,
)
from identification.recording import Dataset, Recording
from identification.result import Identification

LONG_SAMPLES = 200_000
"""Number of samples to fit, over all recordings, above which recordings are processed in pieces;
with fewer samples, processing without pieces is faster.
"""
PIECE_SAMPLES = 60_000
_SEARCH_SAMPLES = 6000
"""Number of samples before the end of a piece in which a rest is searched, at which the recording
is cut.
"""


def identify_any_length(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    profile: bool = False,
    draws: int = 0,
) -> Identification:
    """Identify by the default method, piece by piece if the recordings are long; the arguments are
    those of :func:`default.identify`.

    Raises:
        RecordingError: The recordings do not determine the model; the message says what is missing.
    """
    fitted = dataset.part("fit")
    if sum(len(r.time) for r in fitted) <= LONG_SAMPLES:
        return default.identify(
            dataset,
            bandwidth_Hz=bandwidth_Hz,
            rng=rng,
            progress=progress,
            profile=profile,
            draws=draws,
        )
    found = identify_long(dataset, bandwidth_Hz=bandwidth_Hz, progress=progress)
    if profile or draws:
        limit = (
            "no profiles and no bootstrap: these are computed only if all recordings together have "
            f"at most {LONG_SAMPLES} samples; use shorter recordings"
        )
        found = replace(found, warnings=(*found.warnings, limit))
    return found


def pieces(recording: Recording) -> list[Recording]:
    """Cut a recording into pieces of about ``PIECE_SAMPLES`` samples, at rests if possible; the
    channels of a piece are views of those of the recording.
    """
    n, start = len(recording.time), 0
    found = []
    while start < n:
        stop = n if n - start < 1.5 * PIECE_SAMPLES else _cut(recording, start + PIECE_SAMPLES)
        found.append(
            replace(recording, channels={c: v[start:stop] for c, v in recording.channels.items()})
        )
        start = stop
    return found


def identify_long(
    dataset: Dataset, *, bandwidth_Hz: float | None = None, progress: Progress | None = None
) -> Identification:
    """Identify piece by piece; memory in addition to the recordings grows by 14 bytes per sample.

    Traces cover the first piece of each recording only.

    Raises:
        RecordingError: The recordings do not determine the model; the message says what is missing.
    """
    started = perf_counter()
    tell = progress or silent
    model = dataset.model
    cut = [(r, pieces(r)) for r in dataset.recordings]
    heads = [parts[0] for r, parts in cut if r.role == "fit"]
    if bandwidth_Hz is None:
        bandwidth_Hz = min(default_bandwidth(head) for head in heads)
    tell("unloaded", 0.0)
    prepared = [(r, [prepare(part, bandwidth_Hz) for part in parts]) for r, parts in cut]
    fit = [p for r, parts in prepared if r.role == "fit" for p in parts]
    values, stages = solve_stages(*by_load(fit), model, tell)
    names = free_names(values, model)
    tell("joint", 0.0)
    every = [part for r, parts in cut if r.role == "fit" for part in parts]
    refined, fault = acceptance.try_refinements(
        lambda correlated: refine_pieces(
            heads, every, values, names, model, lambda share: tell("joint", share), correlated
        ),
        lambda v: typical_error(fit, v, model.alpha),
        values,
    )
    if refined is None or fault:
        kept = f"values are those of the equation error at {bandwidth_Hz:.3g} Hz: {fault}"
        found = Found(values, block_sandwich(fit, values, names, model.alpha), warnings=(kept,))
    else:
        floors = floors_of(refined.names, refined.floor)
        partly = partly_used(refined.left_out)
        found = Found(dict(refined.values), spread_of(refined), floors, refined, warnings=partly)
    if refined is not None:
        stages = [*stages, joint_convergence(refined)]
        found = replace(found, starts=refined.starts)
    tell("joint", 1.0)
    result = identification(dataset, prepared, replace(found, stages=tuple(stages)))
    return replace(result, seconds=perf_counter() - started)


def _cut(recording: Recording, near: int) -> int:
    """Return the sample at which a recording is cut: the middle of the last rest shortly before the
    sample ``near``, or ``near`` if there is no rest.
    """
    window = slice(near - _SEARCH_SAMPLES, near)
    angle = joint_angle(
        replace(recording, channels={c: v[window] for c, v in recording.channels.items()})
    )
    if angle is None:
        return near
    edges = np.flatnonzero(np.diff(np.concatenate(([0], resting(angle).astype(np.int64), [0]))))
    if not edges.size:
        return near
    return near - _SEARCH_SAMPLES + int((edges[-2] + edges[-1]) // 2)
