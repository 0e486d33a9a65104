"""Evaluates a blind trial by diagnosis and baselines and, once it is opened, by the oracle."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from identification.diagnosis.joint import Joint
from identification.diagnosis.oracle import greedy_bic, library, oracle, sparse
from identification.diagnosis.within_limits import choose, views_and_fit
from identification.effects import MOTION
from identification.recording import Dataset, RecordingError
from rig.results.diagnose.diagnose import diagnose_source
from rig.results.prove.simulate import residual_rms
from rig.sources import load_source


class Judgement(NamedTuple):
    """Judgement of one trial."""

    diagnosis: Mapping[str, Any]  # the record of `rig diagnose --json`
    # Effects that each baseline method selects, the most important first.
    baselines: Mapping[str, Sequence[str]]
    # Function of the true names that returns the record of `HeldOut` or None.
    oracle: Callable[[Sequence[str]], Mapping[str, Any] | None]
    seconds: float
    baseline_seconds: float
    # Residual of the nominal model's fit in each equation, in the unit of the equation.
    left: Mapping[str, float] = MappingProxyType({})


Judge = Callable[[Path, int], Judgement]
"""Judges a campaign with a seed; only the judgement's oracle gets the true names."""


def judge(source: Path, seed: int) -> Judgement:
    """Diagnose a campaign, and run the baseline methods on the same rows."""
    seen: list[Joint] = []
    began = time.perf_counter()
    outcome = diagnose_source(source, seed, inspect=seen.append)
    diagnosed = time.perf_counter()
    if not seen:
        # Baselines and oracle exist for diagnoses of the motion only.
        return Judgement(outcome.record(), {}, lambda _names: None, diagnosed - began, 0.0)
    first = seen[0]
    declared = outcome.dataset.model.terms
    regressors = library(first, [t for t in MOTION if t.name not in declared])
    named = {"greedy_bic": greedy_bic(regressors), "sparse": sparse(regressors)}
    bandwidth = outcome.diagnosis.fit.bandwidth_Hz
    later = time.perf_counter() - diagnosed
    asked = partial(_oracle, outcome.dataset, first, bandwidth)
    return Judgement(outcome.record(), named, asked, diagnosed - began, later, residual_rms(first))


def oracle_of(source: Path, names: Sequence[str]) -> Mapping[str, Any] | None:
    """Fit the true structure to a campaign, after the diagnosis.

    Returns:
        The record of :class:`identification.diagnosis.oracle.HeldOut`, or None if the nominal model
        cannot be fitted, or if the campaign has no unused recordings.
    """
    dataset, bandwidth, _ = choose(load_source(source), None)
    try:
        _, first = views_and_fit(dataset, bandwidth)
        return _oracle(dataset, first, bandwidth, names)
    except RecordingError:
        return None


def _oracle(
    dataset: Dataset, first: Joint, bandwidth_Hz: float, names: Sequence[str]
) -> Mapping[str, Any] | None:
    found = oracle(dataset, first, names, bandwidth_Hz)
    return None if found is None else asdict(found)
