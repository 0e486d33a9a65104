"""The pass at low amplitude: what is planned, and what is allowed meanwhile."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Sequence
from rig.planning.plan import Plan, make_plan
from rig.runs.mcap.reader import read_run
from rig.runs.run_record import Ending

LOW = "first_pass: {amplitude: 0.1, duration_s: 0.4, limit_share: 0.5}\n"


def plan_of(
    path: Path, extra: str = "", bench: str = "practical", first_pass: bool | None = None
) -> Plan:
    path.write_text(path.read_text() + extra)
    return make_plan(load_located(path, Sequence), load_bench(bench), first_pass)


def test_one_on_a_real_bench_unless_refused(short_sequence: Path, tmp_path: Path) -> None:
    real = tmp_path / "real.yaml"
    text = load_bench("practical").path.read_text().split("mock:  ")[0]
    real.write_text(text.replace("interface: mock", "interface: virtual"))
    bench = load_bench(real)
    sequence = load_located(short_sequence, Sequence)
    assert all(stage.first_passes for stage in make_plan(sequence, bench).stages)
    assert all(not stage.first_passes for stage in make_plan(sequence, bench, False).stages)
    short_sequence.write_text(short_sequence.read_text() + "first_pass: never\n")
    assert all(
        not s.first_passes for s in make_plan(load_located(short_sequence, Sequence), bench).stages
    )


def test_it_is_the_stage_made_small(short_sequence: Path) -> None:
    plan = plan_of(short_sequence, LOW)
    for stage in plan.stages:
        low = stage.first_passes[0]
        assert len(low.targets) == 400
        assert low.targets[0] == pytest.approx(stage.targets[0], abs=1e-12)
        assert np.abs(low.targets).max() <= 0.1 * np.radians(5) + 1e-12
        assert np.abs(low.targets).max() > 0.05 * np.radians(5)


def test_the_limits_are_tighter_meanwhile(short_sequence: Path) -> None:
    plan = plan_of(short_sequence, LOW)
    low = plan.stages[0].first_passes[0]
    full = plan.limits
    assert low.limits.speed == 0.5 * full.speed
    assert low.limits.following_error == 0.75 * full.following_error
    assert low.limits.torque == 0.75 * full.torque
    assert low.limits.current == 0.75 * full.current
    assert low.limits.angle_max == pytest.approx(low.targets.max() + low.limits.following_error)
    assert low.limits.angle_min == pytest.approx(low.targets.min() - low.limits.following_error)
    # On the way to the start the joint may be anywhere that it may be.
    assert low.move_limits == dataclasses.replace(
        low.limits, angle_min=full.angle_min, angle_max=full.angle_max
    )


def test_of_ramps_there_and_back_it_is_one(short_sequence: Path) -> None:
    text = short_sequence.read_text()
    tones = next(line for line in text.splitlines() if "tones" in line)
    start = text.index("\n  - ", text.index(tones))
    stage = (
        "  - {name: r, stage: unloaded, ramp: {travel_deg: 5, speed_deg_s: 5, rest_s: 0.5, "
        "times: 3}, duration_s: 8}"
    )
    short_sequence.write_text(text[:start] + "\n" + stage + "\n")
    low = plan_of(short_sequence, first_pass=True).stages[-1].first_passes[0]
    assert low.duration_s == pytest.approx(2.0 * 0.5 / 5.0 + 0.5)
    assert low.targets.max() == pytest.approx(np.radians(0.5), rel=0.02)


def test_larger_ones_stand_ready_as_far_as_the_limits_allow(short_sequence: Path) -> None:
    """With its ramps 0.8 of the 2 Hz takes more than the 60 deg/s that a first pass may take."""
    plan = plan_of(short_sequence, LOW)
    assert [low.amplitude for low in plan.stages[0].first_passes] == [0.1, 0.2, 0.4]
    short_sequence.write_text(
        short_sequence.read_text().replace("frequency_Hz: 2", "frequency_Hz: 1")
    )
    plan = plan_of(short_sequence)
    assert [low.amplitude for low in plan.stages[0].first_passes] == [0.1, 0.2, 0.4, 0.8]
    # The limit on time under power has room for all of them.
    assert plan.stages[0].time_limit_s > 1.5 * sum(
        low.duration_s for low in plan.stages[0].first_passes
    )


def test_while_the_joint_does_not_move_larger_ones_follow(runner, fake_bench, short_sequence):
    runner.plan = plan_of(short_sequence, LOW)
    bench = fake_bench()
    follow = bench.exchange

    def stuck() -> None:
        before, free = bench.joint, max(map(abs, bench.targets), default=1.0) > np.radians(1.0)
        follow()
        bench.joint = bench.joint if free else before
        bench.speed = float(np.clip(bench.speed, -0.5, 0.5)) if free else 0.0

    bench.exchange, bench.joint, bench.target = stuck, 0.0, 0.0
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.DONE, outcome.message
    events = read_run(folder.recording).events
    assert [e["amplitude"] for e in events if e["event"] == "first pass"] == [0.1, 0.2, 0.4, 0.1]
    assert [e["event"] for e in events].count("weight check") == 2


def test_a_run_goes_through_it_first(runner: Any, fake_bench: Any, short_sequence: Path) -> None:
    runner.plan = plan_of(short_sequence, LOW)
    bench = fake_bench()
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.DONE
    log = read_run(folder.recording)
    assert [e["event"] for e in log.events][:6] == [
        "prompt",
        "answer",
        "stage start",
        "first pass",
        "weight check",
        "segment",
    ]
    # None of it counts as data of the stage, and no command jumps.
    assert [s.name for s in folder.record.segments] == ["empty[1]", "empty[2]", "heavy"]
    steps = np.abs(np.diff([0.1, *bench.targets])) / runner.plan.cycle_s
    assert steps.max() < runner.plan.limits.speed
    assert bench.calls["enable"] == 2
    assert folder.record.overruns == 0


@pytest.mark.parametrize("change", [{"velocity_rad_s": 1.5}, {"current_A": 20.0}])
def test_what_the_stage_may_the_first_pass_may_not(runner, fake_bench, short_sequence, change):
    def at(cycle: int) -> Any:
        bench = fake_bench()
        bench.faults["exchange", cycle] = lambda: bench.overrides.update(change)
        bench.faults["exchange", cycle + 1] = lambda: bench.overrides.clear()
        return bench

    runner.plan = plan_of(short_sequence, LOW)
    _, outcome = runner(at(600))
    assert outcome.ending is Ending.TRIPPED
    assert "phase first pass" in outcome.message
    (runner.folder / "recording.mcap").unlink()
    _, outcome = runner(at(1100))
    assert outcome.ending is Ending.DONE, outcome.message


def test_a_stage_has_a_time_limit(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    stages = tuple(dataclasses.replace(stage, time_limit_s=0.5) for stage in runner.plan.stages)
    runner.plan = dataclasses.replace(runner.plan, stages=stages)
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.TRIPPED
    assert folder.record.trip["check"] == "time under power in this stage"
    assert len(bench.targets) == pytest.approx(502, abs=2)


def test_a_time_limit_that_the_stage_cannot_keep_is_refused(short_sequence: Path) -> None:
    short_sequence.write_text(
        short_sequence.read_text().replace("repeats: 2", "repeats: 2, time_limit_s: 1")
    )
    with pytest.raises(InputError, match=r"time_limit_s: below the 1.2 s that this stage takes"):
        plan_of(short_sequence)
