"""The experiment that splits an alias group stays within the bench and runs."""

from pathlib import Path

import pytest

from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Separation
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.planning.plan import make_plan
from rig.results.diagnose.exports import Room, recipes, separating_sequence

BY_HAND = {
    *("inverter_dead_time", "brush_drop", "supply_sag", "constant_torque"),
    *("encoder_eccentricity", "encoder_slip"),
}
"""Effects that only another supply voltage, another load, or the encoder moved by hand, splits from
their likes.
"""


def test_every_effect_has_an_experiment_or_needs_a_hand() -> None:
    assert {e.name for e in MOTION if e.separation is None} == BY_HAND
    assert set(recipes(Room(30.0, 20.0, 30.0))) == set(Separation)


@pytest.mark.parametrize("name", [e.name for e in MOTION if e.separation is not None])
def test_the_experiment_is_a_plan_within_the_bench_s_limits(name: str, tmp_path: Path) -> None:
    bench = load_bench("practical")
    text = separating_sequence([name, *EFFECTS[name].look_alikes], bench.value)
    assert text is not None
    file = tmp_path / "split.yaml"
    file.write_text(text)
    plan = make_plan(load_sequence(file), bench)
    assert len(plan.stages) >= 2
    assert plan.duration_s < 1500.0


def test_a_group_that_no_sequence_splits_has_none() -> None:
    assert (
        separating_sequence(["brush_drop", "inverter_dead_time"], load_bench("practical").value)
        is None
    )


def test_it_is_sized_by_the_bench() -> None:
    bench = load_bench("practical").value
    narrow = bench.model_copy(
        update={"limits": bench.limits.model_copy(update={"angle_max_deg": 10.0})}
    )
    wide, short = (separating_sequence(["return_spring"], b) for b in (bench, narrow))
    assert wide is not None
    assert short is not None
    assert "amplitude_deg: 25.5" in wide
    assert "amplitude_deg: 8.5" in short


def test_its_first_stage_runs(tmp_path: Path) -> None:
    text = separating_sequence(["time_skew"], load_bench("practical").value)
    head, _, stages = text.partition("stages:\n")
    file = tmp_path / "split.yaml"
    file.write_text(f"{head}stages:\n{stages.splitlines()[0]}\n")
    assert status(["run", str(file), "--yes", "--out", str(tmp_path / "run")]) == 0
