"""Evaluates a blind trial by diagnosis and, once its truth is opened, by the oracle."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from identification.diagnosis.held_out import oracle
from identification.diagnosis.joint import Joint
from identification.diagnosis.within_limits import choose, views_and_fit
from identification.recording import RecordingError
from rig.results.diagnose.diagnose import diagnose_source
from rig.results.prove.simulate import residual_rms
from rig.sources import load_source


class Judgement(NamedTuple):
    """Judgement of one trial."""

    diagnosis: Mapping[str, Any]  # the record of `rig diagnose --json`
    seconds: float
    # Residual of the nominal model's fit in each equation, in the unit of the equation.
    left: Mapping[str, float] = MappingProxyType({})


Judge = Callable[[Path, int], Judgement]  # judges a campaign with a seed


def judge(source: Path, seed: int) -> Judgement:
    """Diagnose a campaign; only a diagnosis of the motion has a residual of the nominal model."""
    seen: list[Joint] = []
    began = time.perf_counter()
    outcome = diagnose_source(source, seed, inspect=seen.append)
    seconds = time.perf_counter() - began
    return Judgement(outcome.record(), seconds, residual_rms(seen[0]) if seen else {})


def oracle_of(source: Path, names: Sequence[str]) -> Mapping[str, Any] | None:
    """Fit the true structure to a campaign, after the diagnosis.

    Returns:
        The record of a :class:`~identification.diagnosis.held_out.HeldOut`, or None if the nominal
        model cannot be fitted, or if the campaign has no unused recordings.
    """
    dataset = load_source(source)
    try:
        dataset, bandwidth, _ = choose(dataset, None)
        _, first = views_and_fit(dataset, bandwidth)
        found = oracle(dataset, first, names, bandwidth)
    except RecordingError:
        return None
    return None if found is None else asdict(found)
