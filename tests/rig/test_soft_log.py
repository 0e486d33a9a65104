"""What a log of soft gains tells: the joint waits and slips, and its breakaways hold what the
equation error misses.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.estimate.default import identify
from identification.model.parameters import NOMINAL
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated

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
    """The first start has no rise, and nothing pins its Stribeck speed there; those of the
    breakaways do.
    """
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
