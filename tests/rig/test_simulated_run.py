"""Unattended runs on a simulated bench: what comes back, and how they end early."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated

SHORT = """\
sequence: 1
name: short
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1}
"""


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_a_real_bench_does_not_run_unattended(sequence: Path, tmp_path: Path) -> None:
    text = resolve("practical", "benches").read_text()
    path = tmp_path / "bench.yaml"
    path.write_text(text.replace("interface: mock", "interface: virtual"))
    with pytest.raises(
        InputError,
        match="bus: this command runs without an operator, so the bench must be simulated",
    ):
        run_simulated(load_bench(path), load_sequence(sequence), 0, tmp_path / "run")


def test_a_run_that_trips_is_an_error(sequence: Path, tmp_path: Path) -> None:
    sequence.write_text(SHORT + "limits: {following_error_deg: 0.01}\n")
    with pytest.raises(InputError, match=r"short on practical: stage empty, .*following error"):
        run_simulated(load_bench("practical"), load_sequence(sequence), 0, tmp_path / "run")
