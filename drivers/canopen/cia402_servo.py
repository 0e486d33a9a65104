"""A position servo behind the CiA 402 profile, in cyclic synchronous position mode, over any
transport.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

from drivers import servo_limits
from drivers.canopen import cia402, cia402_checks, cia402_mode, velocity_unit
from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402 import Command, controlword, decode_state
from drivers.canopen.cia402_values import CyclicValues
from drivers.canopen.emergency import explain
from drivers.canopen.transitions import await_state, exchanges
from drivers.clock import NS
from drivers.errors import (
    ConfigurationError,
    DeviceError,
    DriveFault,
    ObjectAccessError,
    StateError,
)
from drivers.interfaces import (
    Identity,
    LimitSteps,
    Link,
    Servo,
    ServoLimits,
    ServoReadings,
    ServoSample,
    ServoState,
)
from drivers.lacks import Lacks
from drivers.objects import (
    ObjectAddress,
    ProcessChannel,
    identity_doubts,
    optional,
    read_identity,
    refusal,
)
from drivers.units import ServoScales

WATCH_S: Final = 0.1
"""Heartbeat time-out after which the drive stops by itself, s."""
_INT32: Final = range(-(1 << 31), 1 << 31)
_INT16: Final = range(-(1 << 15), 1 << 15)


class Cia402Servo(Servo):
    """A drive in cyclic synchronous position mode. Only :meth:`enable` ever moves it toward power.

    Args:
        channel: The device.
        link: The link it is on; exchanged here only while :meth:`enable` changes the states.
        scales: Its units, from the bench file.
        watch_s: Silence of the control loop after which the drive stops by itself, s.
        state_timeout_s: Time-out for reaching a state, s.
        torque_offset: Map 60B2h, so that :meth:`set_torque_offset` can be used.
        stops_alone: Whether the drive takes the power off by itself when the control loop is
            silent; None where its EDS shows it (6007h).
    """

    def __init__(
        self,
        channel: ProcessChannel,
        link: Link,
        scales: ServoScales,
        watch_s: float = WATCH_S,
        state_timeout_s: float = 1.0,
        torque_offset: bool = False,
        stops_alone: bool | None = None,
    ) -> None:
        self._channel = channel
        self._link = link
        self._clock = link.clock
        self._scales = scales
        self._told = objects.cyclic(channel, scales)
        self._held = cia402_checks.held_limits(channel)
        self._inputs = objects.inputs(self._told, channel)
        self._values = CyclicValues(channel, scales, self._told, self._inputs)
        self._watch_s = watch_s
        if stops_alone is None:
            stops_alone = channel.describes(*objects.ON_ABORT)
        self.watch_s = watch_s if stops_alone else None
        link.has_watchdog = link.has_watchdog and stops_alone
        self._timeout_s = state_timeout_s
        self._cycle_ns = 0
        self._word = cia402.DISABLE_VOLTAGE
        self._target = 0
        self._takes_offset = torque_offset
        self._offset = 0
        self._previous = 0
        self._staged_in = 0

    def identity(self) -> Identity:
        """Read the drive's identity."""
        return read_identity(self._channel)

    def identity_doubts(self) -> Iterator[str]:
        """Yield the numbers of 1018h that differ from the EDS file's."""
        yield from identity_doubts(self._channel)

    def state(self) -> ServoState:
        """Read the drive's state from the device (6041h)."""
        return decode_state(self._channel.read(*cia402.STATUSWORD))

    def read_limits(self) -> ServoLimits:
        """Read back the limits the drive itself holds."""
        return servo_limits.read(self._channel, self._scales, self._held)

    def lacks(self, cycle_s: float) -> Lacks:
        """Return what the drive neither holds nor tells, according to its EDS. Sends nothing."""
        return cia402_checks.lacks(self._channel, self._scales, self._told, cycle_s)

    def speed_remedy(self, factor: float) -> str:
        """Return what to change where the reported speed is ``factor`` times the true one."""
        return velocity_unit.remedy(self._scales, factor)

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor of the nearest known unit to a rough factor."""
        return velocity_unit.nearest_factor(self._scales, factor, spread)

    def speed_settings(self, factor: float) -> tuple[tuple[str, str | float | None], ...]:
        """Return the keys that set the unit of the speed, and their values."""
        return velocity_unit.settings(self._scales, factor)

    def limit_steps(self) -> LimitSteps:
        """Return one unit of each limit's object, at the joint."""
        return servo_limits.steps(self._scales)

    def limit_refusals(self, limits: ServoLimits) -> Iterator[DeviceError]:
        """Yield each limit that its object cannot hold."""
        for address, value in servo_limits.encode(limits, self._scales).items():
            if address in self._held:
                yield from refusal(self._channel.require_fit, *address, value)

    def write_limits(self, limits: ServoLimits) -> None:
        """Write limits into the drive and verify them by reading back.

        Raises:
            ConfigurationError: The drive holds another value, or one does not fit.
            ObjectAccessError: The drive refuses one.
        """
        servo_limits.write(self._channel, self._scales, limits, self._held)

    def readings(self) -> ServoReadings:
        """Read each value singly; NaN for values that the drive does not have."""
        scales, told = self._scales, self._told
        counts, speed, current, supply, temperature = map(
            self._read_or_nan,
            (
                objects.POSITION,
                objects.SPEED_ACTUAL,
                told.current,
                scales.supply_object,
                scales.temperature_object,
            ),
        )
        return ServoReadings(
            counts * scales.motor_rad_per_count + scales.offset_rad * scales.gear_ratio,
            speed * scales.joint_speed_unit_rad_s * scales.sign,
            current * told.current_unit_A * scales.sign * scales.current_sign,
            supply * scales.supply_unit_V,
            temperature * scales.temperature_unit_C,
        )

    def fault(self) -> DriveFault:
        """Read why the drive is in fault (603Fh)."""
        code, label = optional(self._channel.read, *objects.ERROR_CODE), self._channel.label
        if code is None:
            return DriveFault(0, f"{label} is in fault, and has no code 603Fh: see its display")
        return DriveFault(code, f"{label} is in fault: {explain(code)}")

    def description_refusals(self) -> Iterator[DeviceError]:
        """Yield the objects that this profile needs and the EDS lacks. Sends nothing."""
        yield from cia402_checks.description_refusals(
            self._channel, self._scales, self._told, self._takes_offset
        )

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield units that differ from the bench file, a cycle that cannot be set, and missing
        objects.
        """
        yield from cia402_checks.refusals(
            self._channel, self._scales, self._told, self._takes_offset, cycle_s
        )

    def prepare(self, cycle_s: float) -> None:
        """Check units, map process data, set the cycle, and verify that the heartbeat time-out can
        be set. Nothing is energised.

        The heartbeat time-out is active only from :meth:`enable` to :meth:`disable`, so that the
        loop may pause otherwise.

        Raises:
            ConfigurationError: Scale or unit differ from the bench file, or the drive did not take
            a setting.
            StateError: The drive is energised.
        """
        state = self.state()
        if state.energised:
            raise StateError(
                f"the drive is in state '{state.value}': disable it before preparing it"
            )
        self._word = cia402.DISABLE_VOLTAGE
        channel = self._channel
        for error in cia402_checks.unit_refusals(
            channel, self._scales, self._takes_offset, cycle_s
        ):
            raise error
        for address, value in (
            (objects.CYCLE, round(cycle_s * 1e3)),
            (objects.CYCLE_EXPONENT, -3),
            (objects.ON_ABORT, objects.ABORT_IS_FAULT),
        ):
            if channel.describes(*address):
                servo_limits.store(channel, address, value)
        self._offset = 0
        outputs = objects.outputs(self._takes_offset)
        channel.map_process_data(outputs, self._inputs, cycle_s=cycle_s)
        self._cycle_ns = round(cycle_s * NS)
        self._values.begin(self._cycle_ns)
        channel.watch(self._watch_s)
        channel.unwatch()
        self._stage(channel.read(*objects.POSITION))

    def enable(self) -> None:
        """Energise and hold the present position, with process data exchanged throughout.

        Raises:
            StateError: Not prepared, not allowed in this state, or not reached in time; the drive
                is left de-energised.
            DriveFault: The drive is in fault.
        """
        if not self._cycle_ns:
            raise StateError("the drive is not prepared: call prepare() first")
        state = self.state()
        if state in (ServoState.FAULT, ServoState.FAULT_REACTION):
            raise self.fault()
        controlword(state, Command.ENABLE)
        try:
            self._channel.watch(self._watch_s)
            self._word = cia402.DISABLE_VOLTAGE
            self._offset = 0
            self._stage(self._channel.read(*objects.POSITION))
            self._walk(in_mode=self._select_mode())
        except DeviceError:
            with suppress(DeviceError):
                self.disable()
            raise

    def disable(self) -> None:
        """Take the power off, verify this by reading 6041h, and end the heartbeat time-out.

        Raises:
            StateError: The drive still reports an energised state.
            LinkError: The drive cannot be reached; it stops by itself after its heartbeat time-out.
        """
        self._command(Command.DISABLE)
        self._await(lambda state: not state.energised, "a de-energised state")
        if self._takes_offset:
            self._channel.write(*objects.TORQUE_OFFSET, 0)
        self._channel.unwatch()

    def quick_stop(self) -> None:
        """Brake with the drive's own ramp (605Ah, 6085h); never leads to power.

        Raises:
            StateError: The drive does not stop and is not stopped already.
            LinkError: The drive cannot be reached.
        """
        self._command(Command.QUICK_STOP)
        self._await(
            lambda state: state in cia402.STOPPED, "quick stop active, switch on disabled or fault"
        )

    def reset_fault(self) -> None:
        """Clear a fault. Ends in SWITCH ON DISABLED; never restarts motion.

        Raises:
            StateError: There is no fault to reset, or it comes back.
        """
        word = controlword(self.state(), Command.RESET_FAULT)
        self._command(Command.DISABLE)
        if word == cia402.FAULT_RESET:
            self._channel.write(*cia402.CONTROLWORD, word)
            self._channel.write(*cia402.CONTROLWORD, cia402.DISABLE_VOLTAGE)
        self._await(lambda state: state is ServoState.SWITCH_ON_DISABLED, "switch on disabled")

    def set_target(self, angle_rad: float) -> None:
        """Stage the joint angle that the next exchange sends.

        Raises:
            ConfigurationError: The angle is beyond what 607Ah can hold.
        """
        counts = self._scales.counts(angle_rad)
        if counts not in _INT32:
            raise ConfigurationError(
                f"target {angle_rad:g} rad is {counts} counts, beyond 32 bits: check the scales"
            )
        self._stage(counts)

    def set_torque_offset(self, torque_N_m: float) -> None:
        """Stage a joint torque that the drive adds to its own, to the nearest per mille of its
        rated torque (60B2h).

        Zero is staged instead while the drive is not commanded to operate.

        Raises:
            ConfigurationError: The drive was not prepared for it, or the torque is beyond what
                60B2h can hold.
        """
        if not self._takes_offset:
            super().set_torque_offset(torque_N_m)
        units = round(self._scales.sign * torque_N_m / self._scales.joint_torque_unit_N_m)
        if units not in _INT16:
            raise ConfigurationError(
                f"torque offset {torque_N_m:g} N m is {units} per mille of 6076h, beyond 16 bits"
            )
        self._offset = units if self._word == cia402.ENABLE_OPERATION else 0
        self._stage(self._target)

    def sample(self) -> ServoSample:
        """Return the sample of the last exchange."""
        statusword, position = self._values.motion()
        following = 0
        if statusword & 0x6F == 0x27:
            # The target of the previous exchange is the one that the drive has reached at this
            # SYNC.
            demand = self._previous if self._channel.cycle <= self._staged_in + 1 else self._target
            following = demand - position
        return self._values.sample(following)

    def _stage(self, counts: int) -> None:
        if self._channel.cycle != self._staged_in:
            self._previous = self._target
            self._staged_in = self._channel.cycle
        self._target = counts
        if self._takes_offset:
            self._channel.stage(objects.OUTPUT_PDO, self._word, counts, self._offset)
        else:
            self._channel.stage(objects.OUTPUT_PDO, self._word, counts)

    def _read_or_nan(self, address: ObjectAddress | None) -> float:
        if address is None:
            return math.nan
        try:
            return self._channel.read(*address)
        except (ConfigurationError, ObjectAccessError):
            return math.nan

    def _command(self, command: Command) -> None:
        # The cyclic controlword is changed first, so that no later exchange can undo the command.
        self._word = cia402.CONTROLWORDS[ServoState.OPERATION_ENABLED, command]
        self._offset = 0
        if self._cycle_ns:
            self._stage(self._target)
        self._channel.insist(*cia402.CONTROLWORD, self._word)

    def _await(self, reached: Callable[[ServoState], bool], wanted: str) -> None:
        await_state(self.state, reached, wanted, self._clock, self._timeout_s)

    def _select_mode(self) -> bool:
        """Select the mode and wait for it; returns whether it came."""
        cia402_mode.select(self._channel)
        for in_time in exchanges(self._link, self._cycle_ns, self._timeout_s):
            if cia402_mode.in_force(self._channel):
                return True
            if not in_time:
                break
        return False

    def _walk(self, in_mode: bool) -> None:
        for in_time in exchanges(self._link, self._cycle_ns, self._timeout_s):
            statusword, position = self._values.motion()
            state = decode_state(statusword)
            if state in (ServoState.FAULT, ServoState.FAULT_REACTION):
                raise self.fault()
            if state in cia402_mode.NEEDED_IN and not in_mode:
                in_mode = cia402_mode.in_force(self._channel)
                if not in_mode and not in_time:
                    raise cia402_mode.not_shown(self._channel, state, self._timeout_s)
                if not in_mode:
                    continue
            if state is ServoState.OPERATION_ENABLED and self._channel.fresh:
                return
            if not in_time:
                raise StateError(
                    f"the drive is still in state '{state.value}' after {self._timeout_s:g} s of "
                    f"enabling: "
                    "check its supply and its enable input"
                )
            if self._channel.fresh:
                self._word = controlword(state, Command.ENABLE)
                self._stage(position)
