"""The control cycle: send a target, collect the answer, record it, judge it, in that order and on time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.interfaces import Encoder, Link, Servo
from rig.operator import StopButton
from rig.plan import Plan
from rig.recorder import Recorder
from rig.safety import Latch, Trip
from rig.sample import Sample

PROGRESS_CYCLES = 100


@dataclass(frozen=True)
class Devices:
    """What a run moves.

    Attributes:
        link: The opened bus.
        servo: The drive.
        encoder: The joint encoder.
        hang: Puts a mass in kg on a simulated lever; None where a person does.
        pacer: Real clock that holds simulated time back to real time; None to run on the link's clock alone.
    """

    link: Link
    servo: Servo
    encoder: Encoder
    hang: Callable[[float], None] | None = None
    pacer: Clock | None = None


Progress = Callable[[str, int, Sample], None]
"""Called now and then with stage name, cycles since the last call and the latest sample."""


class TripError(Exception):
    """A sample broke a limit.

    Args:
        trip: Which.
    """

    def __init__(self, trip: Trip) -> None:
        super().__init__(trip.message)
        self.trip = trip


class Cycle:
    """Runs control cycles and keeps their time.

    A cycle that starts more than a period late moves the following ones back rather than rushing to catch up.

    Attributes:
        overruns: Cycles that started more than a period late.
        stale: Cycles in which a part of the answer was missing.
        count: Cycles so far.
    """

    def __init__(self, plan: Plan, devices: Devices, recorder: Recorder, stop: StopButton, progress: Progress) -> None:
        self._link, self._servo, self._encoder = devices.link, devices.servo, devices.encoder
        self._clock = devices.link.clock
        self._pacer = devices.pacer
        self._recorder = recorder
        self._stop = stop
        self._progress = progress
        self._limits = plan.limits
        self._period_ns = plan.cycle_ns
        self._latch = Latch()
        self._start_ns = self._clock.now_ns()
        self._next_ns = self._fresh_ns = self._start_ns
        self._age_s = self._target = 0.0
        self._pacer_offset_ns = 0
        self.count = 0
        self.overruns = 0
        self.stale = 0

    @property
    def now_ns(self) -> int:
        """Time since the start of the run, ns."""
        return self._clock.now_ns() - self._start_ns

    @property
    def next_s(self) -> float:
        """Run time at which the next cycle starts, s."""
        return (self._next_ns - self._start_ns) * 1e-9

    def begin(self, target: float) -> None:
        """Start cycling afresh after a pause, at rest on ``target``, and reset the safety latch with the first sample.

        Raises:
            TripError: That sample is outside a limit; nothing has been commanded to move.
        """
        self._next_ns = self._fresh_ns = self._clock.now_ns()
        if self._pacer is not None:
            self._pacer_offset_ns = self._pacer.now_ns() - self._next_ns
        self._servo.set_target(target)
        sample = self._exchange(target, 0)
        trip = self._latch.reset(sample, self._age_s, self._limits)
        if trip is not None:
            raise TripError(trip)

    def follow(self, targets: Sequence[float], segment: int, stage: str) -> None:
        """Command one joint angle in rad a cycle; each sample is judged before the next command goes out.

        Raises:
            TripError: A sample broke a limit.
            OperatorStopError: The stop button was pressed.
            DeviceError: A device or the bus failed.
            OSError: The recording cannot be written.
        """
        stop, judge, limits = self._stop, self._latch.judge, self._limits
        set_target = self._servo.set_target
        since = 0
        for target in targets:
            if stop.pressed:
                stop.check()
            set_target(target)
            sample = self._exchange(target, segment)
            trip = judge(sample, self._age_s, limits)
            if trip is not None:
                raise TripError(trip)
            since += 1
            if since == PROGRESS_CYCLES:
                self._progress(stage, since, sample)
                since = 0

    def watch(self) -> None:
        """Run one cycle that commands nothing and is not judged, for the time in which the drive brakes by itself.

        Raises:
            DeviceError: A device or the bus failed.
        """
        self._next_ns = max(self._next_ns, self._clock.now_ns())
        # A recording that cannot be written is no reason to leave the drive alone while it brakes.
        with suppress(OSError):
            self._exchange(self._target, 0)

    def _exchange(self, target: float, segment: int) -> Sample:
        """Wait for the cycle's start, send what is staged, collect and record the answer."""
        link, clock = self._link, self._clock
        self._target = target
        begin_ns = self._next_ns
        if self._pacer is not None:
            self._pacer.sleep_until_ns(begin_ns + self._pacer_offset_ns)
        clock.sleep_until_ns(begin_ns)
        late_ns = clock.now_ns() - begin_ns
        if late_ns > self._period_ns:
            self.overruns += 1
            begin_ns += late_ns
        link.exchange()
        servo, encoder = self._servo.sample(), self._encoder.sample()
        fresh = servo.fresh and encoder.fresh
        time_ns = begin_ns - self._start_ns
        sample = Sample(
            time_ns * 1e-9,
            (clock.now_ns() - self._start_ns) * 1e-9,
            servo.device_time_s,
            encoder.device_time_s,
            target,
            servo.motor_angle_rad,
            encoder.angle_rad,
            servo.velocity_rad_s,
            servo.current_A,
            servo.voltage_V,
            servo.supply_voltage_V,
            servo.temperature_C,
            servo.following_error_rad,
            servo.statusword,
            segment,
            fresh,
        )
        if fresh:
            self._fresh_ns = begin_ns
        else:
            self.stale += 1
        self._age_s = (begin_ns - self._fresh_ns) * 1e-9
        self.count += 1
        self._next_ns = begin_ns + self._period_ns
        self._recorder.sample(time_ns, sample, link.take_frames())
        return sample
