"""The control cycle by itself: what goes out, what is recorded, what is judged, and when."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.clock import NS, SimulatedClock, Suspension
from drivers.errors import LinkError
from drivers.interfaces import EncoderSample, Lacks, PressureSample, RawFrame, ServoSample
from rig.common.errors import StorageError
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.control.cycle import SPACING, Cycle, TripError
from rig.control.safety import Check, Trip
from rig.planning.limits import Limits
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS, connect
from rig.wiring.devices import Devices
from rig.wiring.runaway import Runaway

from .benches import variant

PERIOD_NS = 1_000_000
ANSWER_NS = 400_000
START_NS = 7_000_000_000
LIMITS = Limits(
    angle_min=-1.0,
    angle_max=1.0,
    speed=2.0,
    torque=60.0,
    current=25.0,
    following_error=0.5,
    encoder_disagreement=0.01,
    temperature=80.0,
    supply_min=48.0,
    supply_max=72.0,
    sample_age=0.004,
    lateness=0.02,
    torque_per_ampere=3.0,
    gear_ratio=100.0,
)


class Bench:
    """Link, drive, encoder, transmitter and recorder in one; notes what is asked of it.

    Attributes:
        actions: Exchange, counted from 1, to what happens in it.
    """

    def __init__(self, pressure: bool = False) -> None:
        self.clock = SimulatedClock(START_NS)
        self.told: list[tuple[str, object]] = []
        self.actions: dict[int, Callable[[], None]] = {}
        self.exchanged: list[int] = []
        self.recorded: list[tuple[int, Sample, object]] = []
        self.changes: dict[str, Any] = {}
        self.angle = 0.1
        self.encoder_fresh = self.pressure_fresh = True
        self.has_pressure = pressure
        self.full = False

    def exchange(self) -> None:
        self.told.append(("exchange", len(self.exchanged)))
        self.exchanged.append(self.clock.now_ns() - START_NS)
        self.clock.sleep_until_ns(self.clock.now_ns() + ANSWER_NS)
        self.actions.pop(len(self.exchanged), lambda: None)()

    def lacks(self, cycle_s: float) -> Lacks:
        return Lacks()

    def limit_steps(self) -> None:
        return None

    def promised_deceleration(self) -> float:
        return 1.0

    def disable(self) -> None:
        self.told.append(("disable", None))

    def take_frames(self) -> list[RawFrame]:
        return [RawFrame(len(self.exchanged), 0x80, b"", True)]

    def sent_state(self) -> None:
        return None

    def set_target(self, angle_rad: float) -> None:
        self.told.append(("target", angle_rad))

    def set_torque_offset(self, torque_N_m: float) -> None:
        self.told.append(("offset", torque_N_m))

    def prepare(self, cycle_s: float) -> None:
        self.told.append(("prepare", cycle_s))

    def sample(self, *recording: Any) -> Any:
        if not recording:
            values = dict(
                zip(
                    ServoSample._fields,
                    (2.5, 10.0, 0.7, 1.5, 3.0, 60.0, 25.0, 0.03, 0x0637),
                    strict=False,
                )
            )
            return ServoSample(**(values | {"fresh": True} | self.changes))
        if self.full:
            raise StorageError("no space left")
        self.recorded.append(recording)  # type: ignore[arg-type]
        return None


class Part:
    def __init__(self, bench: Bench, name: str, sample: Callable[[], object]) -> None:
        self._bench, self._name, self.sample = bench, name, sample

    def prepare(self, cycle_s: float) -> None:
        self._bench.told.append((f"prepare {self._name}", cycle_s))


def devices(bench: Bench, pacer: Any = None, suspension: Any = None) -> Devices:
    whole: Any = bench
    encoder: Any = Part(
        bench, "encoder", lambda: EncoderSample(4.5, bench.angle, bench.encoder_fresh)
    )
    pressure: Any = Part(bench, "pressure", lambda: PressureSample(3e5, bench.pressure_fresh))
    return Devices(
        whole,
        whole,
        encoder,
        pacer=pacer,
        pressure=pressure if bench.has_pressure else None,
        suspension=suspension,
    )


def make(
    bench: Bench,
    limits: Limits = LIMITS,
    stop: StopButton | None = None,
    progress: Callable[[str, int, Sample], None] = lambda stage, cycles, sample: None,
    pacer: Any = None,
    suspension: Any = None,
) -> Cycle:
    recorder, used = bench, devices(bench, pacer, suspension)
    return Cycle(limits, PERIOD_NS, used, recorder, stop or StopButton(), progress)  # type: ignore[arg-type]


def begun(bench: Bench, **options: Any) -> Cycle:
    cycle = make(bench, **options)
    cycle.ask_reset()
    cycle.begin(0.1)
    bench.told.clear()
    return cycle


def after(seconds: float, bench: Bench) -> Callable[[], None]:
    return lambda: bench.clock.sleep_until_ns(bench.clock.now_ns() + round(seconds * 1e9))


def losing(bench: Bench, **changes: Any) -> Callable[[], None]:
    def lose() -> None:
        bench.changes["fresh"] = changes.get("servo", True)
        bench.encoder_fresh = changes.get("encoder", True)
        bench.pressure_fresh = changes.get("pressure", True)

    return lose


def test_a_sample_holds_what_each_device_said() -> None:
    bench = Bench(pressure=True)
    cycle = begun(bench)
    after(0.005, bench)()
    cycle.follow([0.2], 3, "heavy")
    time_ns, sample, frames = bench.recorded[1]
    # Begun at 5.4 ms: the cycle due at 1 ms was late, and moves the grid.
    assert time_ns == 5_400_000
    assert sample == Sample(
        time=0.0054,
        host_time=pytest.approx(0.0058),
        device_time=2.5,
        encoder_time=4.5,
        command=0.2,
        motor_angle=10.0,
        angle=0.1,
        velocity=0.7,
        current=1.5,
        voltage=3.0,
        supply_voltage=60.0,
        temperature=25.0,
        following_error=0.03,
        statusword=0x0637,
        segment=3,
        fresh=True,
        pressure=3e5,
    )
    assert frames == [RawFrame(2, 0x80, b"", True)]


def test_cycles_start_a_period_apart_and_are_counted() -> None:
    bench = Bench()
    cycle = begun(bench)
    cycle.follow([0.1, 0.2, 0.3], 1, "empty")
    assert bench.exchanged == [0, 1_000_000, 2_000_000, 3_000_000]
    assert [time_ns for time_ns, _, _ in bench.recorded] == bench.exchanged
    assert [sample.command for _, sample, _ in bench.recorded] == [0.1, 0.1, 0.2, 0.3]
    assert [sample.segment for _, sample, _ in bench.recorded] == [0, 1, 1, 1]
    assert (cycle.count, cycle.overruns, cycle.stale) == (4, 0, 0)
    assert cycle.target == 0.3
    assert cycle.next_s == pytest.approx(0.004)
    assert cycle.timing.answer.worst_ns == ANSWER_NS
    assert sum(cycle.timing.answer.counts) == sum(cycle.timing.lateness.counts) == 4
    assert cycle.timing.lateness.worst_ns == 0


def test_begin_trips_where_nobody_asked_or_the_first_sample_is_outside() -> None:
    bench = Bench()
    cycle = make(bench)
    with pytest.raises(TripError) as caught:
        cycle.begin(0.1)
    assert caught.value.trip.check is Check.NOT_RESET
    assert str(caught.value) == caught.value.trip.message
    bench.changes["current_A"] = 26.0
    cycle.ask_reset()
    with pytest.raises(TripError, match="motor current 26 A"):
        cycle.begin(0.1)


def test_a_new_beginning_forgets_how_old_the_last_sample_was() -> None:
    bench = Bench()
    cycle = begun(bench)
    bench.changes["fresh"] = False
    for _ in range(6):
        cycle.watch()
    after(0.03, bench)()
    cycle.ask_reset()
    cycle.begin(0.1)
    assert cycle.stale == 7
    cycle.follow([0.1] * 4, 1, "empty")
    with pytest.raises(TripError, match="sample age"):
        cycle.follow([0.1], 1, "empty")


def test_each_sample_is_judged_before_the_next_command() -> None:
    bench = Bench()
    cycle = begun(bench)
    kept: list[Sample] = []
    bench.actions[3] = lambda: bench.changes.update(velocity_rad_s=2.1)
    with pytest.raises(TripError) as caught:
        cycle.follow([0.1, 0.2, 0.3, 0.4], 1, "empty", keep=kept.append)
    assert caught.value.trip == Trip(Check.SPEED, 2.1, 2.0, "rad/s", 0.002)
    assert [told for told in bench.told if told[0] == "target"] == [
        ("target", 0.1),
        ("target", 0.2),
    ]
    # What tripped is recorded, and not handed on.
    assert [sample.command for sample in kept] == [0.1]
    assert bench.recorded[-1][1].velocity == 2.1


def test_other_limits_hold_from_then_on() -> None:
    bench = Bench()
    cycle = begun(bench)
    cycle.use(dataclasses.replace(LIMITS, speed=0.5))
    with pytest.raises(TripError, match=r"joint speed 0\.7 rad/s"):
        cycle.follow([0.1], 0, "empty")


def test_each_target_is_taken_after_the_sample_before_it_was_kept() -> None:
    bench = Bench()
    cycle = begun(bench)
    kept: list[Sample] = []

    def targets() -> Any:
        for number in range(3):
            assert len(kept) == number
            yield 0.1

    cycle.follow(targets(), 1, "empty", keep=kept.append)
    assert len(kept) == 3


def test_the_torque_offset_goes_out_with_the_command_and_ends_with_the_motion() -> None:
    bench = Bench()
    cycle = begun(bench)
    seen: list[Sample | None] = []

    def compensate(sample: Sample | None) -> float:
        seen.append(sample)
        return float(len(seen))

    cycle.follow([0.1, 0.2], 1, "empty", compensate=compensate)
    assert bench.told == [
        *(("target", 0.1), ("offset", 1.0), ("exchange", 1)),
        *(("target", 0.2), ("offset", 2.0), ("exchange", 2), ("offset", 0.0)),
    ]
    assert seen == [None, bench.recorded[1][1]]


def test_the_stop_button_is_looked_at_before_every_command() -> None:
    bench, stop = Bench(), StopButton()
    cycle = begun(bench, stop=stop)
    bench.actions[2] = stop.press
    with pytest.raises(OperatorStopError):
        cycle.follow([0.1, 0.2, 0.3], 1, "empty")
    assert bench.told == [("target", 0.1), ("exchange", 1)]


def test_progress_is_told_every_hundred_cycles() -> None:
    bench = Bench()
    told: list[tuple[str, int, Sample]] = []
    cycle = begun(bench, progress=lambda *news: told.append(news))
    cycle.follow([0.1] * 99, 1, "empty")
    assert not told
    cycle.follow([0.1] * 250, 1, "heavy")
    assert [news[:2] for news in told] == [("heavy", 100), ("heavy", 100)]
    assert [news[2] for news in told] == [bench.recorded[99 + at][1] for at in (100, 200)]


def test_a_stage_may_be_under_power_for_its_time_and_no_longer() -> None:
    bench = Bench()
    cycle = make(bench)
    after(1.0, bench)()
    cycle.ask_reset()
    cycle.begin(0.1, time_limit_s=0.0034)
    with pytest.raises(TripError) as caught:
        cycle.follow([0.1] * 10, 1, "empty")
    # Begun at 1 s: the cycles at 1, 2 and 3 ms are within the limit, that at 4 ms is not sent.
    assert len(bench.exchanged) == 4
    trip = caught.value.trip
    assert (trip.check, trip.unit) == (Check.STAGE_TIME, "s")
    assert (trip.value, trip.limit, trip.time) == (
        pytest.approx(0.004),
        pytest.approx(0.0034),
        pytest.approx(1.004),
    )


def test_watching_commands_nothing_and_judges_nothing() -> None:
    bench = Bench()
    cycle = begun(bench)
    cycle.follow([0.2], 4, "empty")
    bench.told.clear()
    bench.changes["current_A"] = 99.0
    after(0.5, bench)()
    cycle.watch()
    cycle.watch()
    assert bench.told == [("exchange", 2), ("exchange", 3)]
    # After a pause the grid starts again; within it the period is kept.
    assert bench.exchanged[2:] == [501_400_000, 502_400_000]
    assert [(s.command, s.segment, s.current) for _, s, _ in bench.recorded[2:]] == [
        (0.2, 0, 99.0)
    ] * 2
    assert cycle.timing.lateness.worst_ns == 0


@pytest.mark.parametrize("full", [False, True])
def test_a_failed_exchange_is_no_new_order_to_brake(
    monkeypatch: pytest.MonkeyPatch, full: bool
) -> None:
    """The speeds stay compared with those of the order, whatever fails while the drive brakes."""
    bench = Bench()
    cycle = begun(bench)
    ordered: list[float] = []
    order = Runaway.order

    def counted(self: Runaway, cycle_s: float) -> None:
        ordered.append(cycle_s)
        order(self, cycle_s)

    monkeypatch.setattr(Runaway, "order", counted)

    def fail() -> None:
        if full:
            bench.full = True
        else:
            raise LinkError("no answer")

    cycle.follow([0.1] * 3, 1, "empty")
    for more in (2, 3):
        bench.actions[len(bench.exchanged) + more] = fail
    failed = 0
    for _ in range(6):
        try:
            cycle.watch()
        except LinkError:
            failed += 1
    assert (failed, len(ordered)) == (0 if full else 2, 1)


@pytest.mark.parametrize(
    ("period_ms", "second_ms"), [(1, 1), (5, 5), (10, 0.4), (50, 0.4), (2000, 0.4)]
)
def test_the_order_to_brake_does_not_wait_for_a_long_cycle(period_ms, second_ms):
    bench = Bench()
    cycle = Cycle(
        LIMITS, period_ms * 1_000_000, devices(bench), bench, StopButton(), lambda *_: None
    )
    began_ns = bench.clock.now_ns() - START_NS
    for _ in range(4):
        cycle.watch()
    cycle.ask_reset()
    cycle.begin(0.1)
    cycle.watch()
    cycle.watch()
    starts_ms = (np.array(bench.exchanged) - began_ns) / 1e6
    regular = [period_ms] * 3
    # The cycle that begins starts at once, and the first one that watches within 5 ms of it.
    assert np.diff(starts_ms) == pytest.approx([*regular, 0.4, second_ms, period_ms])


def test_a_prompt_before_the_watching_is_no_lateness_of_this_computer() -> None:
    bench, pacer = Bench(), Pacer()
    cycle = make(bench, pacer=pacer)
    pacer.now += 3_000_000
    cycle.watch()
    assert cycle.timing.lateness.worst_ns == 3_000_000
    # What goes on while the drive has no power takes a while, by either clock.
    after(0.001, bench)()
    pacer.now += 600_000_000_000
    cycle.watch()
    cycle.watch()
    assert (cycle.timing.missed_syncs, cycle.overruns) == (3, 1)
    assert cycle.timing.lateness.worst_ns == 3_000_000
    assert np.diff(pacer.deadlines[-2:]) == 1_000_000


def test_a_full_disk_does_not_end_the_watching() -> None:
    bench = Bench()
    cycle = begun(bench)
    bench.full = True
    cycle.watch()
    assert len(bench.exchanged) == 2
    with pytest.raises(StorageError):
        cycle.follow([0.1], 0, "empty")


@pytest.mark.parametrize(
    ("late_ns", "overruns", "missed"), [(PERIOD_NS, 0, 0), (PERIOD_NS + 1, 1, 1), (3_700_000, 1, 3)]
)
def test_a_cycle_more_than_a_period_late_moves_the_grid(late_ns, overruns, missed):
    bench = Bench()
    cycle = begun(bench)
    bench.actions[2] = lambda: bench.clock.sleep_until_ns(START_NS + 2_000_000 + late_ns)
    cycle.follow([0.1] * 3, 1, "empty")
    assert (cycle.overruns, cycle.timing.missed_syncs) == (overruns, missed)
    assert cycle.timing.lateness.worst_ns == late_ns
    moved = late_ns if overruns else 0
    assert bench.exchanged[2] == 2_000_000 + late_ns
    assert bench.recorded[2][0] == 2_000_000 + moved
    assert bench.recorded[3][0] == 3_000_000 + moved


def test_the_targets_after_a_late_one_come_no_faster_than_the_spacing():
    bench = Bench()
    cycle = begun(bench)
    late_ns = PERIOD_NS // 4
    bench.actions[2] = lambda: bench.clock.sleep_until_ns(START_NS + 2 * PERIOD_NS + late_ns)
    cycle.follow([0.1] * 6, 1, "empty")
    began = np.array(bench.exchanged[2:]) - np.arange(2, 7) * PERIOD_NS
    spaced = (late_ns - k * round((1.0 - SPACING) * PERIOD_NS) for k in range(5))
    assert began.tolist() == [max(late, 0) for late in spaced]
    assert [time_ns for time_ns, *_ in bench.recorded] == [k * PERIOD_NS for k in range(7)]


@pytest.mark.parametrize("usual_ns", [0, PERIOD_NS // 7])
def test_a_computer_that_always_wakes_late_keeps_the_grid(usual_ns):
    bench = Bench()
    cycle = begun(bench)
    wake = bench.clock.sleep_until_ns
    bench.clock.sleep_until_ns = lambda when: wake(when + usual_ns)  # type: ignore[method-assign]
    cycle.follow([0.1] * 40, 1, "empty")
    assert cycle.overruns == 0
    assert cycle.timing.lateness.worst_ns == usual_ns
    assert bench.exchanged[-1] == 40 * PERIOD_NS + usual_ns


def test_braking_waits_for_no_spacing() -> None:
    bench = Bench()
    cycle = begun(bench)
    bench.actions[2] = lambda: bench.clock.sleep_until_ns(START_NS + 3 * PERIOD_NS - ANSWER_NS)
    cycle.follow([0.1] * 2, 1, "empty")
    cycle.watch()
    assert bench.exchanged[3] - bench.exchanged[2] < SPACING * PERIOD_NS


def test_lateness_is_judged() -> None:
    bench = Bench()
    cycle = begun(bench)
    bench.actions[2] = lambda: bench.clock.sleep_until_ns(START_NS + 2_000_000 + 20_000_001)
    with pytest.raises(TripError) as caught:
        cycle.follow([0.1] * 3, 1, "empty")
    assert caught.value.trip.check is Check.LATENESS
    assert caught.value.trip.value == pytest.approx(0.020000001)


def test_a_pause_for_other_work_is_no_lateness() -> None:
    bench = Bench()
    cycle = begun(bench)
    after(0.5, bench)()
    cycle.resume()
    bench.changes["fresh"] = False
    cycle.follow([0.1] * 2, 1, "empty")
    assert bench.exchanged[1:] == [500_400_000, 501_400_000]
    assert cycle.timing.oldest_s == pytest.approx(0.001)
    assert cycle.overruns == 0


@pytest.mark.parametrize(
    ("lost", "servo", "encoder"),
    [
        ({"servo": False}, 1, 0),
        ({"encoder": False}, 0, 1),
        ({"servo": False, "encoder": False}, 1, 1),
        ({"pressure": False}, 0, 0),
    ],
)
def test_a_part_of_the_answer_that_is_missing_is_counted(lost, servo, encoder):
    bench = Bench(pressure=True)
    cycle = begun(bench)
    for exchange, parts in ((2, lost), (3, {}), (4, lost), (6, {})):
        bench.actions[exchange] = losing(bench, **parts)
    cycle.follow([0.1] * 5, 1, "empty")
    assert [sample.fresh for _, sample, _ in bench.recorded] == [
        True,
        False,
        True,
        False,
        False,
        True,
    ]
    assert cycle.stale == 3
    assert (cycle.timing.lost_servo, cycle.timing.lost_encoder) == (3 * servo, 3 * encoder)
    assert cycle.timing.oldest_s == pytest.approx(0.002)


def test_the_greatest_age_is_kept_and_the_present_one_judged() -> None:
    bench = Bench()
    cycle = begun(bench)
    for exchange, parts in ((2, {"servo": False}), (5, {}), (6, {"servo": False})):
        bench.actions[exchange] = losing(bench, **parts)
    cycle.follow([0.1] * 5, 1, "empty")
    assert cycle.timing.oldest_s == pytest.approx(0.003)
    # The last fresh sample is that of 4 ms; at 8 ms it is as old as it may be, at 9 ms older.
    with pytest.raises(TripError) as caught:
        cycle.follow([0.1] * 10, 1, "empty")
    assert caught.value.trip == Trip(
        Check.SAMPLE_AGE, pytest.approx(0.005), 0.004, "s", pytest.approx(0.009)
    )


@pytest.mark.parametrize(
    ("pause_s", "lost", "cause"),
    [(0.0035, 2, Check.PAUSE), (0.0017, 5, Check.SAMPLE_AGE), (0.0, 5, Check.SAMPLE_AGE)],
    ids=["a long pause", "a short pause, then a bad cable", "a bad cable"],
)
def test_a_pause_of_this_computer_is_named_as_the_cause(pause_s, lost, cause):
    bench = Bench()
    cycle = begun(bench)

    def pause() -> None:
        bench.encoder_fresh = False
        bench.clock.sleep_until_ns(bench.clock.now_ns() + round(pause_s * 1e9))

    def heal() -> None:
        bench.encoder_fresh = True

    bench.actions[3], bench.actions[3 + lost] = pause, heal
    with pytest.raises(TripError) as caught:
        cycle.follow([0.1] * 12, 1, "empty")
    assert caught.value.trip.check is cause
    assert caught.value.trip.limit == LIMITS.sample_age


class Pacer:
    """A real clock that nobody has to wait for."""

    def __init__(self) -> None:
        self.now = 90_000_000_000
        self.deadlines: list[int] = []

    def now_ns(self) -> int:
        return self.now

    def sleep_until_ns(self, deadline_ns: int) -> None:
        self.now = max(self.now, deadline_ns)
        self.deadlines.append(deadline_ns)


def test_simulated_time_is_held_back_to_real_time() -> None:
    bench, pacer = Bench(), Pacer()
    cycle = begun(bench, pacer=pacer)
    cycle.follow([0.1] * 2, 1, "empty")
    assert pacer.deadlines == [90_000_000_000, 90_001_000_000, 90_002_000_000]
    # A pause on both sides: a new pair of origins.
    after(0.25, bench)()
    pacer.now += 3_000_000_000
    cycle.resume()
    cycle.follow([0.1] * 2, 1, "empty")
    assert pacer.deadlines[3:] == [93_002_000_000, 93_003_000_000]
    assert bench.exchanged[3:] == [252_400_000, 253_400_000]
    assert cycle.timing.lateness.worst_ns == 0


@pytest.mark.parametrize(
    ("late_ns", "overruns", "missed"), [(PERIOD_NS, 0, 0), (PERIOD_NS + 1, 1, 1), (5_500_000, 1, 5)]
)
def test_this_computers_lateness_is_counted_and_moves_the_real_grid(late_ns, overruns, missed):
    bench, pacer = Bench(), Pacer()
    cycle = begun(bench, pacer=pacer)

    def busy() -> None:
        pacer.now = 90_002_000_000 + late_ns

    bench.actions[2] = busy
    cycle.follow([0.1] * 3, 1, "empty")
    assert (cycle.overruns, cycle.timing.missed_syncs) == (overruns, missed)
    assert cycle.timing.lateness.worst_ns == late_ns
    moved = late_ns if overruns else 0
    assert pacer.deadlines == [
        90_000_000_000,
        90_001_000_000,
        90_002_000_000,
        90_003_000_000 + moved,
    ]
    # The simulated bench waits: it is never late.
    assert bench.exchanged == [0, 1_000_000, 2_000_000, 3_000_000]


class Boot:
    """The clock that counts the sleep of the computer."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.slept_ns = bench, 0
        self.suspension = Suspension(self.now_ns, bench.clock.now_ns)

    def now_ns(self) -> int:
        return self.bench.clock.now_ns() + self.slept_ns


def test_a_sleep_of_the_computer_ends_the_commands_before_the_next_one() -> None:
    bench = Bench()
    boot = Boot(bench)
    cycle = begun(bench, suspension=boot.suspension)

    def targets() -> Iterator[float]:
        yield 0.1
        boot.slept_ns += round(12.3e9)
        bench.told.clear()
        yield 0.1

    with pytest.raises(TripError) as caught:
        cycle.follow(targets(), 1, "stage")
    trip = caught.value.trip
    assert (trip.check, trip.value, trip.unit) == (Check.SLEEP, pytest.approx(12.3), "s")
    assert "the computer slept for 12.3 s" in trip.message
    # Nothing was exchanged after the sleep, so that no fault of the drive hides its cause.
    assert [step for step in bench.told if step[0] == "exchange"] == []
    # The braking goes on, and says nothing of it again.
    boot.slept_ns += round(3e9)
    cycle.watch()


def test_a_sleep_between_two_stages_does_no_harm() -> None:
    bench = Bench()
    boot = Boot(bench)
    cycle = begun(bench, suspension=boot.suspension)
    boot.slept_ns += round(3600e9)
    cycle.ask_reset()
    cycle.begin(0.1)
    cycle.follow([0.1] * 3, 1, "stage")


def test_a_pause_between_two_clock_reads_is_no_sleep() -> None:
    """The second read may come late; only a difference above the greatest so far is a sleep."""
    delays = [0, 30_000_000, 0, 500_000_000, 0]
    now = iter(range(0, 10_000_000_000, 1_000_000_000))
    boot: list[int] = []

    def boot_ns() -> int:
        boot.append(next(now))
        return boot[-1]

    suspension = Suspension(boot_ns, lambda: boot[-1] + delays[len(boot) - 1])
    assert [suspension.passed_ns() for _ in delays[1:]] == [0] * 4


def test_a_sleep_is_counted_by_the_clock_since_boot(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, boot_ns = 7, {7: 3 * NS}
    monkeypatch.setattr(time, "CLOCK_BOOTTIME", clock, raising=False)
    monkeypatch.setattr(time, "clock_gettime_ns", boot_ns.__getitem__, raising=False)
    suspension = Suspension(awake_ns=lambda: 2 * NS)
    boot_ns[clock] += 12 * NS
    assert suspension.passed_ns() == 12 * NS


@pytest.mark.parametrize(("real", "realtime"), [(True, False), (False, True), (False, False)])
def test_a_sleep_is_looked_for_unless_time_is_simulated(tmp_path, real, realtime):
    changes = (
        ("interface: mock", "interface: virtual"),
        ("servo: {", f"servo: {{eds: {DRIVE_EDS}, "),
        ("encoder: {", f"encoder: {{eds: {ENCODER_EDS}, "),
    )
    document = load_bench(variant(tmp_path, *changes[: 3 * real]))
    assert document.value.simulated is not real
    with connect(document, 0, realtime) as devices:
        assert (devices.suspension is not None) is (real or realtime)
