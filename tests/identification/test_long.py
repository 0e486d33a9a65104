"""Identification in pieces: what it cuts, and that it finds what the in-memory path finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import default
from identification.prepare import resting
from identification.recording import Dataset, Recording
from identification.result import Identification

from .synthetic import SYSTEM, TRUTH, sine


@pytest.fixture
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(default, "PIECE_SAMPLES", 7000)


@pytest.mark.usefixtures("short_pieces")
def test_pieces_join_up_and_are_cut_at_rest(practical_pair: tuple[Recording, Recording]) -> None:
    for recording in practical_pair:
        parts = default.pieces(recording)
        assert len(parts) > 1
        for name, values in recording.channels.items():
            assert np.array_equal(np.concatenate([p.channels[name] for p in parts]), values)
            assert all(np.shares_memory(p.channels[name], values) for p in parts)
        still = resting(recording.channels["motor_angle"])
        cuts = np.cumsum([len(p.time) for p in parts])[:-1]
        assert np.all(still[cuts])


@pytest.mark.usefixtures("short_pieces")
def test_pieces_give_what_the_whole_gives(
    practical_pair: tuple[Recording, Recording], practical_result: Identification
) -> None:
    whole, parts = practical_result, default.identify_long(Dataset(practical_pair))
    assert parts.warnings == ()
    assert [s.method for s in parts.stages] == [s.method for s in whole.stages]
    for name, p in whole.parameters.items():
        q = parts.parameters[name]
        assert p.value is not None
        assert p.low is not None
        assert p.high is not None
        if name == "J":  # found on the first pieces alone
            assert abs(q.value - p.value) < 0.5 * (q.high - q.low)
            continue
        # Two estimates of one value: least squares beside the inertia on the whole, instruments on
        # the pieces.
        assert abs(q.value - p.value) < 0.5 * (p.high - p.low), name
        assert 0.6 < (q.high - q.low) / (p.high - p.low) < 1.7, name
    assert list(parts.fits_by_recording) == ["unloaded", "loaded"]


@pytest.mark.usefixtures("short_pieces")
def test_recordings_that_cannot_be_refined_keep_the_equation_error() -> None:
    parts = default.identify_long(Dataset((sine(duration=20.0),)), bandwidth_Hz=500.0)
    assert "a quantised encoder" in parts.warnings[0]
    assert parts.values() == pytest.approx({n: TRUTH[n] for n in SYSTEM}, rel=1e-6)


def test_the_path_follows_the_length(
    practical_pair: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[str] = []
    monkeypatch.setattr(default, "identify", lambda *_a, **_k: taken.append("memory"))
    monkeypatch.setattr(default, "identify_long", lambda *_a, **_k: taken.append("pieces"))
    dataset = Dataset(practical_pair[:1])
    default.identify_any_length(dataset)
    monkeypatch.setattr(default, "LONG_SAMPLES", 1000)
    default.identify_any_length(dataset)
    aside = Dataset((replace(practical_pair[0], role="validate"),))
    default.identify_any_length(aside)
    assert taken == ["memory", "pieces", "memory"]
