"""Unattended runs on a simulated bench: what comes back, and how they end early."""

from pathlib import Path

import pytest

from identification.estimate.default import identify
from identification.model.parameters import NOMINAL
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated

from .benches import stages, swing

SHORT = stages(swing())


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


SINE = """\
sequence: 1
name: sine
stages:
  - {name: sine, stage: unloaded, tones: [{amplitude_deg: 20, frequency_Hz: 0.2}], duration_s: 8}
"""


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.proof) for seed in (2, 3))]
)
def test_the_rise_is_found_where_the_equation_error_sees_none(seed: int, tmp_path: Path) -> None:
    """The first start has no rise and pins no Stribeck speed; the breakaways do."""
    path = tmp_path / "sine.yaml"
    path.write_text(SINE)
    dataset = run_simulated(
        load_bench("practical_soft"), load_sequence(path), seed, tmp_path / "run"
    )
    found = identify(dataset)
    assert found.warnings == ()
    bounds = {"Mc": 0.002, "Ms": 0.003, "omega_sf": 0.03, "sigma_2": 0.005, "J": 0.005}
    for name, bound in bounds.items():
        value = found.parameters[name].value
        assert value is not None
        assert value == pytest.approx(NOMINAL[name], rel=bound), name
