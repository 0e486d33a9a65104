"""The control cycle: sends a target, receives the sample, records it, and checks the limits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final, NoReturn, Protocol

from drivers.clock import NS, Clock
from drivers.errors import DeviceError, DriveFault
from drivers.interfaces import RawFrame, ServoState
from rig.common.errors import StorageError
from rig.common.sample import Sample
from rig.common.timing import Timing
from rig.control.motion_proof import MotionWitness, SpeedWitness
from rig.control.safety import AGAINST, MOVED, Check, Latch, Trip, check, check_stage_time
from rig.planning.limits import Limits
from rig.terminal.stop_button import StopButton
from rig.wiring.braking import grown
from rig.wiring.devices import Devices
from rig.wiring.runaway import Runaway, RunawayError, Seen

PROGRESS_CYCLES = 100
FAR_SHARE: Final = 0.5
"""Distance from the target at which a joint that moves away ever faster runs away, as a share of
the limit of the following error; beyond the limit some drives start a ramp that no order ends.
"""
FIRST_WITHIN_NS: Final = NS // 200  # longest wait for the first cycle of the braking, ns
SPACING: Final = 0.9
"""Shortest time between two targets after a late cycle, as a share of the period: some drives take
the time between targets as the time of the step, so that a late cycle would double their speed.
"""


Progress = Callable[[str, int, Sample], None]
"""Progress callback: stage name, cycles since the last call, latest sample."""


class SampleSink(Protocol):
    """Receives the sample of each cycle, as :class:`rig.runs.recorder.Recorder` does."""

    def sample(self, time_ns: int, sample: Sample, frames: list[RawFrame]) -> None:
        """Store the sample of one cycle, or raise a StorageError."""
        ...


class TripError(Exception):
    """A sample is outside a limit."""

    def __init__(self, trip: Trip, explanation: str = "") -> None:
        super().__init__(f"{trip.message}{explanation}")
        self.trip = trip
        self.event = f"{trip.event}{explanation}"  # the message without the remedy


class Cycle:
    """Runs control cycles at a fixed period.

    A cycle that starts more than a period late delays all later cycles; the time is not made up.
    Less is made up in several cycles, each at least :data:`SPACING` of a period long.

    Args:
        limits: Limits that are checked on every sample, until :meth:`use` changes them.
    """

    def __init__(
        self,
        limits: Limits,
        cycle_ns: int,
        devices: Devices,
        recorder: SampleSink,
        stop: StopButton,
        progress: Progress,
    ) -> None:
        self._link, self._servo, self._encoder = devices.link, devices.servo, devices.encoder
        self._pressure = devices.pressure
        self._clock = devices.link.clock
        self._pacer = devices.pacer
        self._suspension = devices.suspension
        self._recorder = recorder
        self._stop = stop
        self._progress = progress
        self._period_ns = cycle_ns
        lacks = devices.servo.lacks(cycle_ns / NS)
        self._reports_temperature, self._reports_supply = not lacks.temperature, not lacks.supply
        self._limits = self._checkable(limits)
        self._witness: SpeedWitness | None = SpeedWitness(devices.servo, limits.gear_ratio)
        nominal = devices.nominal
        # Samples that are collected to check the units of the drive; None after the check, and on a
        # bench without constants.
        self.units = None if nominal is None else MotionWitness(devices.servo, nominal)
        self._latch = Latch()
        self._runaway = Runaway(math.nan)
        self._start_ns = self._clock.now_ns()
        self._fresh_ns = self._powered_ns = self._start_ns
        self._paused_ns = self._paused_until_ns = 0
        self._time_limit_s: float | None = None
        self._age_s = self._late_s = self._target = 0.0
        self._torque = math.nan
        self._woken_ns = 0
        self._start_grid(self._start_ns)
        self.count = 0
        self._watched = -1
        self.overruns = 0  # number of cycles that started more than a period late
        self.stale = 0  # number of cycles in which a part of the sample was missing
        self.timing = Timing()

    @property
    def start_ns(self) -> int:
        """Start of the run by the link's clock, ns."""
        return self._start_ns

    @property
    def now_ns(self) -> int:
        """Time since the start of the run, ns."""
        return self._clock.now_ns() - self._start_ns

    @property
    def target(self) -> float:
        """Last commanded joint angle, rad."""
        return self._target

    @property
    def next_s(self) -> float:
        """Run time at which the next cycle starts, s."""
        return (self._next_ns - self._start_ns) * 1e-9

    def ask_reset(self) -> None:
        """Store the operator's request that the next :meth:`begin` resets the safety latch."""
        self._latch.ask()

    def end(self) -> None:
        """Open the safety latch at the regular end of a stage; a reset must precede commands."""
        self._latch.open()

    def use(self, limits: Limits) -> None:
        """Set the limits of further samples, without those on missing values."""
        self._limits = self._checkable(limits)

    def begin(self, target: float, time_limit_s: float | None = None) -> None:
        """Restart the cycle after a pause, holding ``target``; the first sample resets the safety
        latch.

        Args:
            target: Present joint angle, rad.
            time_limit_s: Longest time for commands from now on, s, or None for no limit.

        Raises:
            TripError: The first sample is outside a limit, or the reset was not requested; no
                motion was commanded.
        """
        self.resume()
        steps = self._servo.limit_steps()
        self._runaway = Runaway(
            self._servo.promised_deceleration(), 0.0 if steps is None else steps.angle_rad
        )
        self._powered_ns = self._next_ns
        self._time_limit_s = time_limit_s
        self._servo.set_target(target)
        sample = self._exchange(target, 0)
        trip = self._latch.reset(sample, self._age_s, self._late_s, self._limits)
        if trip is not None:
            raise TripError(trip)

    def resume(self) -> None:
        """Continue after work that took longer than a cycle; its time is no lateness."""
        self._fresh_ns = self._clock.now_ns()
        self._start_grid(self._fresh_ns)
        if self._suspension is not None:
            self._suspension.passed_ns()

    def follow(
        self,
        targets: Iterable[float],
        segment: int,
        stage: str,
        keep: Callable[[Sample], object] | None = None,
        compensate: Callable[[Sample | None], float] | None = None,
    ) -> None:
        """Command one joint angle (rad) per cycle; each sample is checked before the next command.

        Args:
            targets: Joint angles, rad; the next angle is taken from the iterable after the previous
                sample was checked and stored.
            segment: Number of the excitation, 0 for none.
            stage: Name for the progress display.
            keep: Function that is called with every sample inside the limits.
            compensate: Function that is called before every command with the previous sample (None
                before the first command). The function returns the torque, N m, that the drive adds
                until the next command. No torque is added after the last command.

        Raises:
            TripError: A sample is outside a limit.
            OperatorStopError: The stop button was pressed.
            DeviceError: A device or the bus failed.
            StorageError: The recording cannot be written.
        """
        try:
            self._follow(targets, segment, stage, keep, compensate)
        except DriveFault as fault:
            # A drive that reads a limit in a wrong unit ends the motion by itself, and so does a
            # drive of a wrong sign.
            words = "" if self.units is None else self.units.explanation()
            fault.args = (f"{fault}{f'; {AGAINST}' * self._runaway.against}{words}",)
            raise

    def _follow(
        self,
        targets: Iterable[float],
        segment: int,
        stage: str,
        keep: Callable[[Sample], object] | None,
        compensate: Callable[[Sample | None], float] | None,
    ) -> None:
        """Command the targets as :meth:`follow` does, without the explanation of a drive fault."""
        stop, judge, limits = self._stop, self._latch.judge, self._limits
        set_target = self._servo.set_target
        time_limit_s = self._time_limit_s
        sample: Sample | None = None
        since = 0
        for target in targets:
            stop.check()
            if time_limit_s is not None:
                self._check_time(time_limit_s)
            set_target(target)
            if compensate is not None:
                self._servo.set_torque_offset(compensate(sample))
            sample = self._exchange(target, segment)
            trip = judge(sample, self._age_s, self._late_s, limits)
            units = self.units
            if units is not None:
                units.take(sample, self._torque)
            far = FAR_SHARE * limits.following_error
            escapes = sample.fresh and self._runaway.escapes(far)
            if escapes or (trip is not None and self._runaway.leaves()):
                self._cut(sample)
            if trip is not None:
                against = trip.check in MOVED and self._runaway.against
                trip = dataclasses.replace(self._cause(trip), against=against)
                of = (trip.check is Check.SPEED, trip.check is Check.TORQUE)
                raise TripError(trip, "" if units is None else units.explanation(*of))
            if self._witness is not None and self._witness.decided(sample):
                self._witness = None
            if keep is not None:
                keep(sample)
            since += 1
            if since == PROGRESS_CYCLES:
                self._progress(stage, since, sample)
                since = 0
        if compensate is not None:
            self._servo.set_torque_offset(0.0)

    def _cut(self, sample: Sample) -> NoReturn:
        """Switch the power off without a ramp, which would accelerate the joint; raise the trip."""
        # The teardown repeats a command that failed, and reads the state back.
        with suppress(DeviceError):
            self._servo.disable()
        self._latch.open()
        found, units = self._runaway, self.units
        raise TripError(
            Trip(Check.RUNAWAY, found.speed_rad_s, found.limit_rad_s, "rad/s", sample.time),
            "" if units is None else units.explanation(),
        )

    def watch(self) -> ServoState | None:
        """Run one cycle without a command and without a limit check, while the drive brakes. If the
        first such cycle is due later than :data:`FIRST_WITHIN_NS`, it starts at once: it brings the
        order to brake to the drive.

        Returns:
            The state that the drive sent in this cycle, or None.

        Raises:
            RunawayError: The joint has become faster since the first such cycle.
            DeviceError: A device or the bus failed.
        """
        now_ns, first = self._clock.now_ns(), self._watched != self.count
        if first:
            self._runaway.order(self._period_ns / NS)
        late = self._next_ns - now_ns > FIRST_WITHIN_NS and first
        self._watched = self.count  # a failed exchange is no new order to brake
        if late or now_ns > self._next_ns:
            # The time since the last cycle is a pause and does not count as lateness.
            self._start_grid(now_ns)
        # The drive is monitored while it brakes even if the recording cannot be written.
        with suppress(StorageError):
            try:
                sample = self._exchange(self._target, 0, braking=True)
            finally:
                self._watched = self.count
            if self.units is not None:
                self.units.take_braking(sample, self._torque)
        sent = self._servo.sent_state()
        if (sent is None or sent.energised) and self._runaway.grows():
            raise RunawayError(grown(self._runaway))
        return sent

    def attend(self, limits: Limits) -> Sample:
        """Run one cycle without a command, while the drive moves by itself; raises as
        :meth:`follow`.

        Args:
            limits: Limits with which the sample is compared; the latch is not used.
        """
        self._stop.check()
        sample = self._exchange(self._target, 0)
        trip = check(sample, self._age_s, self._late_s, self._checkable(limits))
        if trip is not None:
            raise TripError(self._cause(trip))
        return sample

    def _checkable(self, limits: Limits) -> Limits:
        """Return limits without those on values that the drive does not report."""
        return dataclasses.replace(
            limits,
            reports_temperature=self._reports_temperature,
            reports_supply=self._reports_supply,
        )

    def _start_grid(self, now_ns: int) -> None:
        """Set the start of the next cycle to the present time, for the real clock as well."""
        self._next_ns = self._earliest_ns = now_ns
        if self._pacer is not None:
            self._pacer_offset_ns = self._pacer.now_ns() - now_ns

    def _cause(self, trip: Trip) -> Trip:
        """Return the trip, as one by a pause of this computer if pauses are most of its age."""
        paused_s = self._paused_ns * 1e-9 if self._paused_until_ns > self._fresh_ns else 0.0
        if trip.check is not Check.SAMPLE_AGE or paused_s < 0.5 * trip.value:
            return trip
        return dataclasses.replace(trip, check=Check.PAUSE)

    def _check_time(self, limit_s: float) -> None:
        trip = check_stage_time((self._next_ns - self._powered_ns) / NS, limit_s, self.next_s)
        if trip is not None:
            raise TripError(trip)

    def _exchange(self, target: float, segment: int, braking: bool = False) -> Sample:
        """Wait for the start of the cycle, send the prepared commands, record the answer."""
        link, clock = self._link, self._clock
        self._target = target
        begin_ns = self._next_ns
        earliest_ns = begin_ns if braking else max(begin_ns, self._earliest_ns)
        paced_late_ns = 0 if self._pacer is None else self._pace(self._pacer, begin_ns)
        clock.sleep_until_ns(earliest_ns)
        started_ns = clock.now_ns()
        woken_ns = started_ns - earliest_ns
        # What every sleep of this computer takes too long is no late cycle.
        usual_ns, self._woken_ns = min(woken_ns, self._woken_ns), woken_ns
        self._earliest_ns = started_ns - usual_ns + round(SPACING * self._period_ns)
        late_ns = started_ns - begin_ns
        if self._suspension is not None and not braking:
            slept_ns = self._suspension.passed_ns()
            if slept_ns:
                time_s = (begin_ns - self._start_ns) * 1e-9
                raise TripError(Trip(Check.SLEEP, slept_ns / NS, 0.0, "s", time_s))
        timing = self.timing
        # A wait for the spacing is not late.
        timing.lateness.note(max(woken_ns, paced_late_ns))
        self._late_s = max(woken_ns, paced_late_ns) * 1e-9
        if late_ns > self._period_ns:
            self._overrun(late_ns)
            begin_ns += late_ns
            before_ns = self._paused_ns if self._paused_until_ns > self._fresh_ns else 0
            self._paused_ns, self._paused_until_ns = before_ns + late_ns, begin_ns
        link.exchange()
        servo, encoder = self._servo.sample(), self._encoder.sample()
        self._torque = servo.motor_torque_N_m
        fresh = servo.fresh and encoder.fresh
        pressure = math.nan
        if self._pressure is not None:
            pressure, valid = self._pressure.sample()
            fresh = fresh and valid
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
            pressure,
        )
        if fresh:
            self._fresh_ns = begin_ns
            gear = self._limits.gear_ratio
            motion = (servo.velocity_rad_s, servo.motor_angle_rad / gear, encoder.angle_rad)
            self._runaway.see(Seen(sample.time, *motion, target))
        else:
            self._lost(servo.fresh, encoder.fresh)
        self._age_s = (begin_ns - self._fresh_ns) * 1e-9
        timing.oldest_s = max(timing.oldest_s, self._age_s)
        timing.answer.note(clock.now_ns() - begin_ns)
        self.count += 1
        self._next_ns = begin_ns + self._period_ns
        self._recorder.sample(time_ns, sample, link.take_frames())
        return sample

    def _pace(self, pacer: Clock, begin_ns: int) -> int:
        """Slow simulated time down to real time; return the lateness of this computer, ns."""
        due_ns = begin_ns + self._pacer_offset_ns
        pacer.sleep_until_ns(due_ns)
        late_ns = pacer.now_ns() - due_ns
        if late_ns > self._period_ns:
            self._overrun(late_ns)
            self._pacer_offset_ns += late_ns
        return late_ns

    def _overrun(self, late_ns: int) -> None:
        self.overruns += 1
        self.timing.missed_syncs += late_ns // self._period_ns

    def _lost(self, servo_fresh: bool, encoder_fresh: bool) -> None:
        self.stale += 1
        self.timing.lost_servo += not servo_fresh
        self.timing.lost_encoder += not encoder_fresh
