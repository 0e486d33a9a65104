"""The sequencer against fakes: every way out leaves the drive verified off and a readable log."""

import dataclasses
import errno
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.clock import NS
from drivers.errors import DriveFault, LinkError, StateError
from drivers.interfaces import ServoState
from rig.common.sample import Phase
from rig.control.motion_proof import MotionWitness
from rig.control.operator import AutomaticOperator
from rig.control.phase_handlers import TRANSITIONS, Event, next_phase
from rig.runs.mcap.reader import read_run
from rig.runs.mcap.writer import McapWriter
from rig.runs.run import load_run, read_record
from rig.runs.run_record import Ending
from rig.terminal.stop_button import OperatorStopError
from rig.wiring.devices import Nominal

from .test_cycle import Pacer


def throw(error: BaseException) -> Callable[[], None]:
    def action() -> None:
        raise error

    return action


def assert_safe_and_readable(runner: Any, bench: Any, folder: Any, outcome: Any) -> None:
    """The drive is off and that was read back; log and record on disk say how the run ended."""
    assert not bench.drive_state.energised
    assert outcome.safe.verified
    # Nothing comes after the reading back but the drive's own limits, into a drive that is off.
    assert bench.order[-2:] == ["state", "write_limits"] or bench.order[-1] == "state"
    log = read_run(folder.recording)
    assert log.damage is None
    assert log.events[-1]["event"] == outcome.ending.value
    record = read_record(folder.path)
    assert record.state == outcome.ending.value
    assert record.message == outcome.message
    assert record.de_energised is True
    assert len(log.samples["time"]) == record.cycles


def test_a_whole_run(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.DONE
    assert_safe_and_readable(runner, bench, folder, outcome)
    assert bench.hung == [0.0, 10.0]
    assert bench.calls["enable"] == 2
    assert bench.calls["quick_stop"] == 0
    assert [s.state for s in folder.record.stages] == ["done", "done"]
    assert [s.name for s in folder.record.segments] == ["empty[1]", "empty[2]", "heavy"]
    log = read_run(folder.recording)
    assert [e["event"] for e in log.events] == [
        *("prompt", "answer", "stage start", "segment", "segment", "stage end"),
        *("prompt", "answer", "stage start", "segment", "stage end", "done"),
    ]
    seen = [e for e in log.events if e["event"] in ("prompt", "stage end")]
    assert [(e["current_A"], e["motion_rad_s"]) for e in seen] == [(0.0, 0.0)] * 4
    assert set(np.unique(log.samples["segment"])) == {0, 1, 2, 3}
    assert set(log.attachments) == {"bench.yaml", "sequence.yaml", "devices.json", "run.json"}


def test_commands_never_jump(runner: Any, fake_bench: Any) -> None:
    """From an arbitrary start angle, through both stages, no step exceeds the speed limit."""
    bench = fake_bench(joint=-0.3)
    runner(bench)
    steps = np.abs(np.diff([-0.3, *bench.targets])) / runner.plan.cycle_s
    assert steps.max() < runner.plan.limits.speed
    assert np.abs(np.diff(bench.targets, 2)).max() / runner.plan.cycle_s**2 < 100


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"current_A": 26.0}, "motor current 26 A is beyond its limit 25 A"),
        ({"current_A": float("nan")}, "motor current nan A"),
    ],
)
def test_a_limit_trips_mid_motion(runner, fake_bench, change, words):
    bench = fake_bench()
    bench.faults["exchange", 700] = lambda: bench.overrides.update(change)
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.TRIPPED
    assert words in outcome.message
    assert bench.calls["quick_stop"] == 1
    assert_safe_and_readable(runner, bench, folder, outcome)
    value = abs(next(iter(change.values())))
    assert read_record(folder.path).trip["value"] == (None if np.isnan(value) else value)
    # Nothing was commanded after the sample that tripped it; what follows in the recording is the
    # drive braking.
    assert len(bench.targets) == 700
    segment = read_run(folder.recording).samples["segment"]
    assert segment[699] != 0
    assert len(segment) > 700
    assert not segment[700:].any()


@pytest.mark.parametrize(
    ("verb", "count", "error"),
    [
        ("exchange", 1, LinkError("bus-off")),
        ("exchange", 800, LinkError("bus-off")),
        ("prepare", 1, StateError("no")),
        ("write_limits", 2, LinkError("no answer")),
        ("enable", 2, DriveFault(0x2310, "over-current")),
        ("disable", 1, StateError("still on")),
        ("state", 1, LinkError("no answer")),
        *(
            (verb, count, KeyboardInterrupt())
            for verb, count in (
                *(("state", 1), ("prepare", 1), ("write_limits", 1), ("enable", 1)),
                *(("exchange", 1), ("exchange", 300), ("set_target", 900), ("disable", 2)),
            )
        ),
    ],
)
def test_whatever_a_verb_raises_anywhere(runner, fake_bench, verb, count, error):
    bench = fake_bench()
    bench.faults[verb, count] = throw(error)
    folder, outcome = runner(bench)
    stopped = isinstance(error, KeyboardInterrupt)
    assert outcome.ending is (Ending.STOPPED if stopped else Ending.FAILED)
    assert str(error) in outcome.message
    assert_safe_and_readable(runner, bench, folder, outcome)


@pytest.mark.parametrize("state", [ServoState.READY, ServoState.SWITCHED_ON])
def test_no_single_command_gives_power_while_a_person_hangs_a_weight(runner, fake_bench, state):
    bench = fake_bench()
    bench.drive_state = state
    assert runner(bench)[1].ending is Ending.DONE
    assert bench.order.index("disable") < bench.order.index("prepare")


def test_the_operator_gives_up_at_the_second_prompt(runner: Any, fake_bench: Any) -> None:
    class GivesUp(AutomaticOperator):
        def confirm_weight(self, stage: str, weight_kg: float) -> float:
            if weight_kg:
                raise OperatorStopError("stopped at the weight prompt")
            return weight_kg

    bench = fake_bench()
    folder, outcome = runner(bench, operator=GivesUp())
    assert outcome.ending is Ending.STOPPED
    assert bench.hung == [0.0]
    assert [s.state for s in folder.record.stages] == ["done", "stopped"]
    assert_safe_and_readable(runner, bench, folder, outcome)
    assert len(load_run(folder.path).recordings) == 2


def test_a_few_lost_answers_are_left_out_of_the_recording(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    bench.faults["exchange", 700] = lambda: setattr(bench, "fresh", False)
    bench.faults["exchange", 703] = lambda: setattr(bench, "fresh", True)
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.DONE
    short = [r for r in load_run(folder.path).recordings if r.notes]
    assert [len(r.time) for r in short] == [497]
    assert any("3 samples left out" in note for note in short[0].notes)


def test_a_drive_that_drops_out_is_a_device_failure(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    bench.faults["exchange", 700] = lambda: setattr(bench, "drive_state", ServoState.FAULT)
    _, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "0218h is not OPERATION ENABLED" in outcome.message
    assert not bench.drive_state.energised
    assert outcome.safe.verified


@pytest.mark.parametrize("nth", [3, 20])
def test_a_full_disk(runner, fake_bench, monkeypatch, nth):
    """Out of space at the n-th flush after the run's head."""
    flush, calls = McapWriter.flush, itertools.count()

    def full(self: McapWriter) -> None:
        if next(calls) >= 11 + nth:
            raise OSError(errno.ENOSPC, "No space left on device")
        flush(self)

    monkeypatch.setattr(McapWriter, "flush", full)
    bench = fake_bench()
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "No space left on device" in outcome.message
    assert not bench.drive_state.energised
    assert outcome.safe.verified
    log = read_run(folder.recording)
    assert log.damage is not None
    # A tenth of a second, and the cycles in which the drive braked.
    assert folder.record.cycles - len(log.samples["time"]) <= 101 + 50


def test_a_defect_in_the_loop_still_leaves_the_drive_off(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    bench.faults["exchange", 700] = throw(ZeroDivisionError("a defect"))
    _, outcome = runner(bench)
    assert outcome.ending is Ending.CRASHED
    assert isinstance(outcome.error, ZeroDivisionError)
    assert outcome.safe.verified
    assert (
        "the program failed (ZeroDivisionError: a defect); the drive is de-energised"
        in outcome.message
    )
    assert bench.drive_state is ServoState.SWITCH_ON_DISABLED
    assert bench.order[-2:] == ["state", "write_limits"]
    assert read_run(runner.folder / "recording.mcap").damage is None
    record = read_record(runner.folder)
    assert (record.state, record.de_energised) == ("crashed", True)


def test_a_defect_in_the_explanation_does_not_hide_the_state_of_the_drive(
    runner: Any, fake_bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(self: MotionWitness, message: str) -> str:
        raise IndexError("a defect")

    monkeypatch.setattr(MotionWitness, "after_braking", wrong)
    devices = fake_bench.devices
    monkeypatch.setattr(
        fake_bench,
        "devices",
        lambda self: dataclasses.replace(devices(self), nominal=Nominal(0.05, 100.0)),
    )
    bench = fake_bench()
    bench.faults["exchange", 30] = lambda: bench.overrides.update(current_A=26.0)
    _, outcome = runner(bench)
    assert outcome.ending is Ending.CRASHED
    assert isinstance(outcome.error, IndexError)
    assert outcome.trip is not None
    assert outcome.safe.verified
    assert "motor current 26 A is beyond its limit" in outcome.message
    assert bench.order[-2:] == ["state", "write_limits"]
    record = read_record(runner.folder)
    assert (record.state, record.de_energised) == ("crashed", True)
    log = read_run(runner.folder / "recording.mcap")
    assert (log.damage, log.events[-1]["event"]) == (None, "tripped")


def test_a_drive_that_is_found_under_power_ends_its_ramp(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench(drive_state=ServoState.OPERATION_ENABLED)
    clock, ended = bench.clock, []

    def stopped() -> None:
        bench.drive_state = ServoState.SWITCH_ON_DISABLED

    bench.faults["quick_stop", 1] = lambda: clock.call_at(clock.now_ns() + NS // 20, stopped)
    bench.faults["disable", 1] = lambda: ended.append(bench.drive_state)
    _, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "phase load" in outcome.message
    assert outcome.safe.verified
    assert ended == [ServoState.SWITCH_ON_DISABLED]


@pytest.mark.parametrize(("busy_ms", "ending"), [(26, Ending.DONE), (27, Ending.FAILED)])
def test_lateness_against_real_time_is_counted_and_judged(runner, fake_bench, busy_ms, ending):
    """A simulated bench that is held to real time is judged by this computer's lateness."""
    pacer = Pacer()
    bench = fake_bench(pacer=pacer)

    def busy() -> None:
        pacer.now += busy_ms * 1_000_000

    bench.faults["exchange", 700] = busy
    folder, outcome = runner(bench)
    assert outcome.ending is ending
    timing = folder.record.parts[0].timing
    assert timing["missed_syncs"] == busy_ms - 1
    assert timing["lateness"]["worst_us"] == pytest.approx(1000.0 * (busy_ms - 1))
    assert folder.record.overruns == 1


TABLE = {
    ("load", "done"): "prepare",
    ("load", "repeat stage"): "load",
    ("prepare", "done"): "enable",
    ("enable", "done"): "approach",
    ("enable", "first pass"): "first pass",
    ("first pass", "done"): "weight check",
    ("weight check", "done"): "approach",
    ("weight check", "first pass"): "first pass",
    ("approach", "done"): "settle",
    ("settle", "done"): "excite",
    ("excite", "done"): "hold",
    ("hold", "next repeat"): "approach",
    ("hold", "done"): "release",
    ("release", "done"): "between stages",
    ("between stages", "next stage"): "load",
    ("between stages", "repeat stage"): "load",
    ("between stages", "done"): "finished",
}


def test_every_pair_of_phase_and_event() -> None:
    for phase, event in itertools.product(Phase, Event):
        following = TABLE.get((phase.value, event.value))
        if following is not None:
            assert next_phase(phase, event) is TRANSITIONS[phase, event] is Phase(following)
            continue
        with pytest.raises(ValueError, match="no transition") as caught:
            next_phase(phase, event)
        assert (
            str(caught.value)
            == f"no transition from phase {phase.value!r} on event {event.value!r}"
        )


def test_every_way_to_the_end_passes_through_release() -> None:
    """The drive has power from ENABLE to RELEASE; no way to an end or prompt leaves it out."""
    seen, waiting = set(), [Phase.ENABLE]
    while waiting:
        phase = waiting.pop()
        if phase in seen or phase is Phase.RELEASE:
            continue
        seen.add(phase)
        waiting += [after for (before, _), after in TRANSITIONS.items() if before is phase]
    assert not seen & {Phase.LOAD, Phase.PREPARE, Phase.BOUNDARY, Phase.FINISHED}
