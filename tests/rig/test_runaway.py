"""A joint that runs away is cut, not braked: true peak and travel of the simulated machine."""

import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from drivers.mock.plant.machine import LOOPS, Loop
from rig.cli.entry import status
from rig.wiring.runaway import REACTION, SIGNS, Runaway, Seen

from .benches import sine, stages, variant
from .true_motion import watch_machines

MOST = {
    ("jog", "practical"): (25.0, 0.2),
    ("jog", "practical_serial"): (35.0, 0.4),
    ("jog", "practical_dbc"): (25.0, 0.2),
    ("run", "practical"): (25.0, 0.2),
    ("run", "practical_serial"): (80.0, 1.4),
    ("run", "practical_dbc"): (25.0, 0.2),
}
"""Greatest true speed, deg/s, and travel, deg, of a jog at 5 deg/s and of a first pass, by command
and bench, with a loop of the wrong sign. At full current the speed grows by 21 deg/s in a
millisecond; the serial bench has a cycle of 10 ms. The travel includes the coasting without power:
from 66 deg/s, friction of 6.8 N m stops an inertia of 0.2 kg m^2 within 1.1 deg.
"""
SEQUENCE = stages(sine("empty", 10, 1, 2, more=", settle_s: 0.05"))


def moved(command: str, bench: str, folder: Path) -> int:
    if command == "jog":
        return status(["jog", bench, "--to", "5", "--json", str(folder / "jog.json")])
    (folder / "probe.yaml").write_text(SEQUENCE)
    options = ["--bench", bench, "--yes", "--first-pass", "--out", str(folder / "run")]
    return status(["run", str(folder / "probe.yaml"), *options])


@pytest.mark.parametrize(("command", "bench"), MOST)
@pytest.mark.parametrize("loop", LOOPS)
def test_a_motion_that_runs_away_is_cut(tmp_path, monkeypatch, capsys, loop, command, bench):
    found = watch_machines(monkeypatch, loop)
    assert moved(command, bench, tmp_path) == 1
    peak_deg_s, travel_deg = MOST[command, bench]
    assert found.peak_deg_s < peak_deg_s, found
    assert found.travel_deg < travel_deg, found
    record = tmp_path / ("jog.json" if command == "jog" else "run/run.json")
    assert json.loads(record.read_text())["de_energised"] is True
    assert "two swapped motor phases" in capsys.readouterr().err


@pytest.mark.parametrize("loop", [*LOOPS, None])
def test_a_slow_motion_against_the_command_names_the_sign(tmp_path, monkeypatch, loop):
    """A long cycle hides that the speed grows."""
    watch_machines(monkeypatch, loop)
    changes = (("cycle_Hz: 1000", "cycle_Hz: 100"), ("sample_age_ms: 5", "sample_age_ms: 50"))
    bench = variant(tmp_path, *changes, source="practical_soft" if loop is None else "practical")
    file = tmp_path / "jog.json"
    assert status(["jog", str(bench), "--to", "5", "--speed", "2", "--json", str(file)]) == 1
    message = json.loads(file.read_text())["message"]
    assert ("check the drive gains" in message) is (loop is None)
    assert (SIGNS in message.partition("after the order to brake")[0]) is (loop is not None)


@pytest.mark.parametrize("loop", LOOPS)
def test_a_fault_of_the_drive_in_a_motion_against_the_command_names_the_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loop: Loop
) -> None:
    """The drive finds its following error before the next cycle of the program."""
    watch_machines(monkeypatch, loop)
    bench = variant(
        tmp_path,
        ("cycle_Hz: 1000", "cycle_Hz: 100"),
        ("sample_age_ms: 5", "sample_age_ms: 50"),
        ("following_error_deg: 2", "following_error_deg: 0.1"),
    )
    file = tmp_path / "jog.json"
    assert status(["jog", str(bench), "--to", "5", "--json", str(file)]) == 4
    message = json.loads(file.read_text())["message"]
    assert message.startswith("drive fault 8611h")
    assert SIGNS in message


@pytest.mark.parametrize(
    ("command", "bench"), [("jog", "practical_serial"), ("run", "practical_dbc")]
)
def test_loops_of_the_right_sign_are_not_cut(tmp_path, monkeypatch, command, bench):
    found = watch_machines(monkeypatch)
    assert moved(command, bench, tmp_path) == 0
    assert found.travel_deg > 4.0


CYCLE_S = 0.001
DECELERATION = 10.0
"""Of the drives below, rad/s^2; a load may add twice its product with the cycle to the speed."""
COUNT = 1e-5
"""Resolution of both angles, rad; in a cycle it is a speed of 0.01 rad/s."""


def motion(
    speeds: Iterable[float], *, deceleration: float = DECELERATION, quantum: float = COUNT
) -> tuple[Runaway, list[Seen]]:
    """Return a judge and the samples of a joint with these speeds, whose target stands still."""
    angle, samples = 0.0, [Seen(0.0, 0.0, 0.0, 0.0, 0.0)]
    for n, speed in enumerate(speeds, 1):
        angle += speed * CYCLE_S
        seen = round(angle / quantum) * quantum
        samples.append(Seen(n * CYCLE_S, speed, seen, seen, 0.0))
    return Runaway(deceleration, COUNT), samples


def grows(judge: Runaway, before: list[Seen], after: list[Seen]) -> bool:
    for seen in before:
        judge.see(seen)
    judge.order(CYCLE_S)
    found = False
    for seen in after:
        judge.see(seen)
        found = found or judge.grows()
    return found


ALLOWED = REACTION * (CYCLE_S * DECELERATION + COUNT / CYCLE_S)
"""Growth of a speed of a joint that moves evenly: that by a load, and two counts of its angle."""


@pytest.mark.parametrize(("growth", "found"), [(0.9 * ALLOWED, False), (1.5 * ALLOWED, True)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_both_sides_of_the_growth_after_an_order(growth: float, found: bool, way: float) -> None:
    judge, samples = motion([way * 0.2] * 50 + [way * (0.2 + growth)] * 3)
    assert grows(judge, samples[:51], samples[51:]) is found


def test_a_ramp_that_starts_late_and_swings_is_no_runaway() -> None:
    ramp = [0.2, 0.21, 0.2, *(0.2 - 0.01 * n for n in range(20)), -0.05, 0.03, -0.01, 0.0]
    judge, samples = motion([0.2] * 50 + ramp)
    assert not grows(judge, samples[:51], samples[51:])


def test_a_joint_that_turns_round_and_runs_away_is_found() -> None:
    judge, samples = motion([0.2] * 50 + [0.1, 0.0, -0.1, -0.2, -0.3, -0.4])
    assert grows(judge, samples[:51], samples[51:])


def test_one_wrong_angle_is_no_runaway_and_a_lasting_one_is() -> None:
    judge, samples = motion([0.2] * 60)
    after = [
        s._replace(joint_rad=s.joint_rad + 0.1) if n == 2 else s for n, s in enumerate(samples[51:])
    ]
    assert not grows(judge, samples[:51], after)
    # The drive sees nothing, and the joint runs away by its own encoder.
    judge, samples = motion([0.2] * 60)
    after = [s._replace(joint_rad=s.joint_rad + 0.001 * n) for n, s in enumerate(samples[51:])]
    assert grows(judge, samples[:51], after)


def test_a_joint_of_which_nothing_is_known_before_the_order_shows_its_speed_first() -> None:
    judge, samples = motion([0.2] * 5)
    judge.order(CYCLE_S)
    assert not grows(judge, [], samples)
    judge, samples = motion([0.2, 0.2, 0.4, 0.6, 0.8])
    assert grows(judge, [], samples)


def escapes(judge: Runaway, samples: list[Seen], targets: Iterable[float]) -> bool:
    found = False
    for seen, target in zip(samples, targets, strict=True):
        judge.see(seen._replace(target_rad=target))
        found = found or judge.escapes()
    return found


def test_only_a_joint_that_is_faster_than_its_target_and_leaves_it_escapes() -> None:
    speeds = [0.0, 0.02, 0.06, 0.12, 0.2, 0.3]
    # A joint that follows its target at once or follows it late, and one that has left it and
    # slows down.
    judge, samples = motion(speeds)
    assert not escapes(judge, samples, [s.drive_rad for s in samples])
    judge, samples = motion(speeds)
    assert not escapes(judge, samples, [3.0 * s.drive_rad for s in samples])
    judge, samples = motion([0.3, 0.2, 0.12, 0.06, 0.02, 0.0])
    assert not escapes(judge, samples, [0.0] * len(samples))
    judge, samples = motion(speeds)
    assert escapes(judge, samples, [0.0] * len(samples))
