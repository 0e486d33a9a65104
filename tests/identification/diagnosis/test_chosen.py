"""Recordings that a diagnosis can use, and what it says about the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.result import Verdict
from identification.diagnosis.within_limits import choose
from identification.recording import Dataset, Model, Recording, RecordingError

from .benches import campaign

HIDDEN = {"asymmetric_coulomb": {"torque_Nm": 0.4}}


def at_rest(recording: Recording, seed: int = 3) -> Recording:
    """Return a recording whose joint keeps its first angle under the torque of its first sample."""
    noise = np.random.default_rng(seed)
    still = {k: np.full_like(v, v[0]) for k, v in recording.channels.items() if k != "time"}
    for name in ("current", "voltage"):
        still[name] = still[name] + 1e-3 * noise.standard_normal(len(still[name]))
    return replace(recording, channels={**recording.channels, **still})


def resting(stage: str, seconds: float = 6.0) -> Dataset:
    """Return a campaign with a hidden effect whose recordings of one stage rest."""
    made = campaign(HIDDEN, 5, seconds)
    return Dataset(tuple(at_rest(r) if r.stage == stage else r for r in made), Model())


def test_a_loaded_stage_at_rest_is_left_out_and_the_rest_is_diagnosed() -> None:
    dataset = resting("loaded")
    chosen = choose(dataset, 25.0)
    assert [r.role for r in chosen.dataset.recordings] == ["fit", "fit", *["unused"] * 4]
    (warning,) = chosen.warnings
    assert warning.startswith(
        "r3, r4, r5, r6: at a bandwidth of 25 Hz these loaded recordings have 0 "
    )
    result = diagnose(dataset, bandwidth_Hz=25.0)
    assert warning in result.warnings
    assert result.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert result.effects[0].name == "asymmetric_coulomb"
    assert result.effects[0].parameters["torque_Nm"].value == pytest.approx(0.4, abs=0.02)


def test_a_campaign_that_moves_is_used_as_it_is() -> None:
    dataset = Dataset(campaign(HIDDEN, 5, 6.0), Model())
    assert choose(dataset, 25.0) == (dataset, 25.0, ())


def test_an_unloaded_stage_at_rest_is_refused() -> None:
    """Without its friction, that of the load is not known either."""
    with pytest.raises(RecordingError, match="samples are in motion"):
        diagnose(resting("unloaded"), bandwidth_Hz=25.0)
