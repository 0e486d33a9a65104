"""Position servo for CiA 402 drives, in any mode of operation and over any transport, and its
homing: mode 6, objects 6098h, 6099h, 609Ah, 607Ch and 60E3h, bits 10, 12 and 13 of the statusword.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from typing import Final

from drivers import servo_limits
from drivers.canopen import cia402
from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402 import Command, controlword, decode_state
from drivers.canopen.cia402_objects import CyclicValues
from drivers.canopen.link import explain
from drivers.canopen.motion import (
    OUTPUT_PDO,
    TARGET_POSITION,
    TORQUE_OFFSET,
    CyclicPosition,
    Motion,
    Observed,
    ProfilePosition,
    SpeedUnit,
    stated_unit_problems,
)
from drivers.clock import NS
from drivers.errors import (
    ConfigurationError,
    DeviceError,
    DriveFault,
    ObjectAccessError,
    StateError,
)
from drivers.homing import IN_PLACE, STANDARD, Homes, HomingOffer, HomingOrder, HomingState
from drivers.interfaces import (
    Identity,
    Lacks,
    LimitSteps,
    Link,
    Measuring,
    ServoLimits,
    ServoMotion,
    ServoReadings,
    ServoSample,
    ServoState,
)
from drivers.objects import (
    VENDOR,
    ObjectAddress,
    PdoLayout,
    ProcessChannel,
    access_problems,
    identity_problems,
    optional,
    problem_of,
    read_identity,
    short_name,
)
from drivers.transitions import FAULTS, SteppedServo
from drivers.units import ServoScales

HOMING: Final = 6  # value of 6060h
HOME_OFFSET: Final = (0x607C, 0)
METHOD: Final = (0x6098, 0)
SEARCH_SPEED: Final = (0x6099, 1)
ZERO_SPEED: Final = (0x6099, 2)
HOMING_ACCELERATION: Final = (0x609A, 0)
SUPPORTED_METHODS: Final = 0x60E3
_START: Final = 1 << 4
_REACHED, _ATTAINED, _ERROR = 1 << 10, 1 << 12, 1 << 13


class Homing(Motion):
    """Homing mode: after the start of a homing the drive moves by itself.

    Args:
        usual: The mode of operation of the bench, whose process data stay mapped during the homing.
    """

    mode = HOMING
    words = "homing"
    target = METHOD
    follows = False

    def __init__(self, usual: Motion) -> None:
        super().__init__()
        self.usual = usual
        self.takes_offset = usual.takes_offset
        self.started = False

    def reset(self) -> None:
        """Clear the start of a homing, too: switching the drive on must never start one."""
        super().reset()
        self.started = False

    @property
    def outputs(self) -> tuple[ObjectAddress, ...]:
        return self.usual.outputs

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Stage the controlword; a homing starts only if the drive is energised."""
        if word == cia402.ENABLE_OPERATION and self.started:
            word |= _START
        values = (counts if address == TARGET_POSITION else 0 for address in self.outputs)
        channel.stage(OUTPUT_PDO, word, *values)


WATCH_S: Final = 0.1
"""Time without a heartbeat of the control loop after which the drive stops by itself, s."""
_WAIT_SHARE: Final = 0.4
"""Longest wait for an answer while the drive brakes, in units of the heartbeat time-out."""
_ENABLE_SHARE: Final = 3.0
"""Time in which the drive is energised at the latest, in units of the time-out of a state: the
signs of the control loop end then.
"""
_UNANSWERED_SHARE, _DISABLE_SHARE = 1.5, 5.0
"""Time in which a drive answers a request for its state or the command to switch the power off, and
time of all further requests of this command, in units of the heartbeat time-out: the signs of the
control loop end then at the latest, so that a drive that does not answer or obey stops by itself.
"""
_INT32: Final = range(-(1 << 31), 1 << 31)
_INT16: Final = range(-(1 << 15), 1 << 15)


class Cia402Servo(SpeedUnit, Homes, SteppedServo):
    """A drive that follows a position. Only :meth:`enable`, which :meth:`begin_homing` calls,
    changes the state of the drive toward power.

    Args:
        channel: The device.
        link: The link to the device; this class exchanges process data only while :meth:`enable`
            changes the states.
        scales: Units of the drive, from the bench file.
        watch_s: Time without a heartbeat of the control loop after which the drive stops by itself,
            s.
        state_timeout_s: Time-out for reaching a state, s.
        motion: Mode of operation; cyclic synchronous position unless given.
        stops_alone: Whether the drive takes the power off by itself when the heartbeat of the
            control loop ends, or None to conclude this from its EDS (6007h, and 1016h or 100Ch).
    """

    def __init__(
        self,
        channel: ProcessChannel,
        link: Link,
        scales: ServoScales,
        watch_s: float = WATCH_S,
        state_timeout_s: float = 1.0,
        motion: Motion | None = None,
        stops_alone: bool | None = None,
    ) -> None:
        SpeedUnit.__init__(self, scales)
        SteppedServo.__init__(self, link, state_timeout_s)
        self._channel = channel
        self._motion = motion or CyclicPosition()
        self._sent = objects.cyclic(channel, scales)
        # The limits that the EDS of the drive has and that the drive obeys in this mode.
        self._held = tuple(
            address
            for address in servo_limits.OBJECTS
            if address not in self._motion.unheld and channel.describes(*address)
        )
        self._inputs = objects.inputs(self._sent, channel)
        self._values = CyclicValues(channel, scales, self._sent, self._inputs)
        self._watch_s = watch_s
        if stops_alone is None:
            stops_alone = objects.stops_alone(channel.describes)
        self.watch_s = watch_s if stops_alone else None
        link.has_watchdog = link.has_watchdog and stops_alone
        self._word = cia402.DISABLE_VOLTAGE
        self._target = 0
        self._previous = 0
        self._staged_in = 0
        self._armed = False
        self._deceleration = math.nan

    def identity(self) -> Identity:
        return read_identity(self._channel)

    def identity_problems(self) -> Iterator[DeviceError]:
        yield from identity_problems(self._channel)

    def state(self) -> ServoState:
        """Read the state (6041h); end the heartbeat time-out of a drive that is off."""
        limit_s = _UNANSWERED_SHARE * self._watch_s
        feeds = self._feeds()
        if feeds:
            self._channel.limit_wait(None)
        with self._channel.kept_alive(limit_s) if feeds else nullcontext():
            state = decode_state(self._channel.read(*cia402.STATUSWORD))
        if not state.energised:
            self._channel.limit_wait(None)
            if self._armed:
                # Without power the loop may pause, but a drive may go into fault then, too.
                with suppress(DeviceError):
                    self._release()
        return state

    def sent_state(self) -> ServoState | None:
        if not self._cycle_ns or not self._channel.fresh:
            return None
        return decode_state(self._values.motion()[0])

    def read_limits(self) -> ServoLimits:
        return servo_limits.read(self._channel, self._scales, self._held)

    def lacks(self, cycle_s: float) -> Lacks:
        motion, sent = self._motion, self._sent
        missing = {
            field: f"{what} ({short_name(address)})"
            for address, (field, what) in servo_limits.FIELDS.items()
            if address not in self._held
        }
        words = [f"mode {motion.mode}, {motion.words}: {text}" for text in motion.remarks]
        words += [
            f"no such limit in the drive: {text}; only this program, and not the drive, checks "
            "this limit in every cycle"
            for text in missing.values()
        ]
        words += self._replaced(cycle_s)
        if motion.mode == ProfilePosition.mode and not self._channel.describes(
            *servo_limits.PROFILE_ACCELERATION
        ):
            words.append("no ramps of the profile (6083h, 6084h): set them with the maker's tool")
        return Lacks(
            frozenset(missing), sent.temperature is None, sent.supply is None, tuple(words)
        )

    def _replaced(self, cycle_s: float) -> Iterator[str]:
        """Yield texts on what is not monitored, and on what replaces a missing object."""
        scales, sent, has = self._scales, self._sent, self._channel.describes

        def place(address: ObjectAddress | None) -> str:
            if address is None:
                return ""
            single = ", which cannot be process data" if has(*address) else ""
            return f" ({short_name(address)}{single})"

        supply, temperature, voltage = map(
            place, (scales.supply_object, scales.temperature_object, scales.voltage_object)
        )
        watchless = "neither heartbeat consumer (1016h) nor life guarding (100Ch, 100Dh)"
        if not has(*objects.ON_ABORT):
            watchless = "no object for the reaction to a lost master (6007h)"
        for there, text in (
            (sent.supply, f"not monitored: supply voltage{supply}; servo.supply_object names it"),
            (
                sent.temperature,
                f"not monitored: temperature{temperature}; servo.temperature_object names it",
            ),
            (sent.voltage, f"not recorded: motor voltage{voltage}; servo.voltage_object names it"),
            (
                sent.time,
                "no time stamp (1013h): samples have the time of the SYNC on this computer",
            ),
            (sent.speed, "no motor speed (606Ch): the speed is computed from the position"),
            (
                sent.current in (scales.current_object, objects.CURRENT) and sent.current,
                "no motor current (6078h): the current is computed from the torque (6077h)",
            ),
            *(
                (
                    has(*rated),
                    f"not checked: {what} ({short_name(rated)}): the drive's values are in "
                    "thousandths of this value; read it with the maker's tool",
                )
                for what, rated in (
                    ("rated current", scales.rated_current_object),
                    ("rated torque", scales.rated_torque_object),
                )
            ),
            (
                has(*objects.CYCLE),
                f"no interpolation period (60C2h): set the period to {cycle_s * 1e3:g} ms with the "
                "maker's tool",
            ),
            (
                objects.stops_alone(has),
                f"{watchless}, so that the drive counts as a drive without a watchdog; if its "
                "manual states that the drive takes the power off when it receives nothing from "
                "this program, set servo.stops_alone: true",
            ),
        ):
            if not there:
                yield text

    def limit_steps(self) -> LimitSteps:
        return servo_limits.steps(self._scales)

    def limit_problems(self, limits: ServoLimits) -> Iterator[DeviceError]:
        encoded = servo_limits.encode(limits, self._scales).items()
        values = [(address, value) for address, value in encoded if address in self._held]
        values += self._motion_settings(limits)
        yield from servo_limits.problems(self._channel, self._scales, values)

    def write_limits(self, limits: ServoLimits) -> None:
        servo_limits.write(self._channel, self._scales, limits, self._held)
        self._deceleration = limits.quick_stop_deceleration_rad_s2
        for address, value in self._motion_settings(limits):
            servo_limits.store_limit(self._channel, self._scales, address, value)
        self._motion.take_limits(limits)

    def _motion_settings(self, limits: ServoLimits) -> list[tuple[ObjectAddress, int]]:
        settings = self._motion.settings(limits)
        return [(at, value) for at, value in settings if self._channel.describes(*at)]

    def readings(self) -> ServoReadings:
        scales = self._scales
        speed, supply, temperature = (
            self._read_or_nan(address)
            for address in (objects.SPEED_ACTUAL, scales.supply_object, scales.temperature_object)
        )
        return self.glance()._replace(
            velocity_rad_s=speed * scales.joint_speed_unit_rad_s * scales.sign,
            supply_voltage_V=supply * scales.supply_unit_V,
            temperature_C=temperature * scales.temperature_unit_C,
        )

    def glance(self) -> ServoReadings:
        scales, sent = self._scales, self._sent
        counts = self._read_or_nan(objects.POSITION)
        current = self._read_or_nan(sent.current)
        return ServoReadings(
            counts * scales.motor_rad_per_count + scales.offset_rad * scales.gear_ratio,
            current_A=scales.current_A(current, sent.current_unit_A),
        )

    def _read_or_nan(self, address: ObjectAddress | None) -> float:
        if address is None:
            return math.nan
        try:
            return self._channel.read(*address)
        except (ConfigurationError, ObjectAccessError):
            return math.nan

    def measuring(self) -> Measuring:
        scales, sent = self._scales, self._sent
        step_A = math.nan if sent.current is None else sent.current_unit_A
        step_rad = abs(scales.joint_rad_per_count)
        return Measuring(step_rad, scales.gear_ratio, step_A, scales.rated_current_A)

    def motion(self) -> ServoMotion:
        scales, speed = self._scales, math.nan
        angle = scales.joint_angle_rad(self._channel.read(*objects.POSITION))
        if self._channel.describes(*objects.SPEED_ACTUAL):
            units = self._channel.read(*objects.SPEED_ACTUAL)
            speed = units * scales.joint_speed_unit_rad_s * scales.sign
        return ServoMotion(angle, speed)

    def promised_deceleration(self) -> float:
        if math.isnan(self._deceleration) and servo_limits.QUICK_STOP_DECELERATION in self._held:
            units = self._channel.read(*servo_limits.QUICK_STOP_DECELERATION)
            self._deceleration = units * self._scales.joint_acceleration_unit_rad_s2
        return self._deceleration

    def fault(self) -> DriveFault:
        code, label = optional(self._channel.read, *objects.ERROR_CODE), self._channel.label
        if code is None:
            return DriveFault(
                0,
                f"{label} is in fault, and its fault code (603Fh) cannot be read: see the display "
                "of the drive",
            )
        return DriveFault(code, f"{label} is in fault: {explain(code)}")

    def description_problems(self) -> Iterator[DeviceError]:
        """Yield an error for each needed object that the EDS lacks. Nothing is sent."""
        channel, motion = self._channel, self._motion
        yield from problem_of(channel.require_fit, *VENDOR, 0)
        lacking = [
            ConfigurationError(f"{error}; every run needs this object, because {purpose}")
            for address, purpose in {**objects.NEEDED, **motion.needed}.items()
            for error in problem_of(channel.require_fit, *address, 0)
        ]
        lacking += [
            ConfigurationError(
                f"{error}, although the bench file names this object: correct the bench file"
            )
            for address in self._scales.named_objects
            for error in problem_of(channel.require_fit, *address, 0)
        ]
        if self._sent.current is None:
            lacking.append(
                ConfigurationError(
                    "the device's EDS has neither the current 6078h nor the torque 6077h as "
                    "process data; one of the two is needed to check the limits of current and "
                    "torque: state the maker's own object of the current in servo.current_object "
                    "and its unit in servo.current_unit_A"
                )
            )
        yield from lacking
        if not lacking:
            settings = (address for address, _ in objects.settings(channel, 0.0))
            for address in (*self._held, *settings):
                yield from problem_of(channel.require_fit, *address, 0)
            yield from problem_of(channel.require_mappable, self._outputs, self._inputs)
        if motion.needs_watch and self.watch_s is None:
            yield ConfigurationError(
                f"mode {motion.words} needs a drive that takes the power off when the messages of "
                "this program end, because the drive would continue to execute the last command; "
                "this drive lacks the objects for this (6007h, and 1016h or 100Ch with 100Dh): if "
                "its manual states that it takes the power off, set servo.stops_alone: true"
            )

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        if (error := self._not_offered()) is not None:
            yield error
        yield from self._unit_problems(cycle_s)
        needed = (*objects.NEEDED, *self._motion.needed, *self._held)
        settings = (address for address, _ in objects.settings(self._channel, cycle_s))
        yield from access_problems(
            self._channel,
            self._outputs,
            self._inputs,
            self.watch_s is not None,
            (*needed, *settings),
        )

    def _not_offered(self) -> StateError | None:
        """Return an error if the drive, by object 6502h, does not support its mode."""
        offered, bit = self._modes(), self._motion.mode - 1
        if offered is None or offered & 1 << bit:
            return None
        return StateError(
            f"the drive does not support mode {self._motion.mode}, {self._motion.words} (6502h "
            f"reads {offered:08X}h, in which bit {bit} is 0): set servo.mode to a mode that the "
            "drive supports"
        )

    def _modes(self) -> int | None:
        """Return the supported modes (6502h), or None if the drive does not state them."""
        if not self._channel.describes(*objects.MODES):
            return None
        return optional(self._channel.read, *objects.MODES)

    def _unit_problems(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield the errors of units, vendor and cycle time."""
        channel, scales = self._channel, self._scales
        if scales.vendor_id is not None and channel.read(*VENDOR) != scales.vendor_id:
            yield ConfigurationError(
                f"vendor 1018h:01h: the drive reports {channel.read(*VENDOR):X}h, but the units "
                f"are those of the vendor {scales.vendor_id:X}h in its EDS file: use the EDS file "
                "of this drive"
            )
        yield from scales.mismatches(channel)
        yield from stated_unit_problems(channel, scales)
        milliseconds = round(cycle_s * 1e3)
        if milliseconds < 1 or abs(milliseconds * 1e-3 - cycle_s) > 1e-9:
            yield ConfigurationError(
                f"the cycle time is {cycle_s * 1e3:g} ms; it must be a whole number of "
                "milliseconds (60C2h)"
            )
        if self._motion.takes_offset:
            for error in problem_of(channel.read, *TORQUE_OFFSET):
                words = (
                    f"{channel.label}: no torque offset 60B2h ({error}): run without feed-forward"
                )
                offset_error = ConfigurationError(words)
                offset_error.__cause__ = error
                yield offset_error

    def prepare(self, cycle_s: float) -> None:
        """Check units, map process data, set the cycle time, and verify that the heartbeat time-out
        can be set. The drive is not energised.

        The heartbeat time-out is active only from :meth:`enable` to :meth:`disable`, so that the
        control loop may pause at all other times.
        """
        self._require_off()
        self._word = cia402.DISABLE_VOLTAGE
        self._cycle_ns = 0
        self.prepared = False
        channel = self._channel
        for error in self._unit_problems(cycle_s):
            raise error
        for address, value in objects.settings(channel, cycle_s):
            servo_limits.store(channel, address, value)
        self._motion.offset = 0
        watched = self.watch_s is not None
        channel.map_process_data(self._outputs, self._inputs, cycle_s=cycle_s, watched=watched)
        self._cycle_ns = round(cycle_s * NS)
        self.prepared = True
        self._values.begin(self._cycle_ns)
        self._motion.begin(cycle_s)
        with channel.kept_alive(_ENABLE_SHARE * self._timeout_s):
            self._arm()
            self._release()
        self._stage(channel.read(*objects.POSITION))

    def _require_way(self, state: ServoState) -> None:
        controlword(state, Command.ENABLE)
        self._motion.reset()

    def _energise(self) -> None:
        with self._channel.kept_alive(_ENABLE_SHARE * self._timeout_s):
            self._arm()
            self._word = cia402.DISABLE_VOLTAGE
            self._stage(self._channel.read(*objects.POSITION))
            self._walk(in_mode=self._select_mode())

    def disable(self) -> None:
        channel = self._channel
        with channel.kept_alive(_UNANSWERED_SHARE * self._watch_s):
            self._command(Command.DISABLE)
        # The drive has accepted the command.
        with channel.kept_alive(_DISABLE_SHARE * self._watch_s):
            self._await(self.state, lambda state: not state.energised, "a de-energised state")
            if self._motion.takes_offset:
                channel.write(*TORQUE_OFFSET, 0)
            if self._armed or not self._cycle_ns:
                self._release()

    def quick_stop(self, *, at_once: bool = True) -> None:
        self._command(Command.QUICK_STOP, at_once)

    def reset_fault(self) -> None:
        word = controlword(self.state(), Command.RESET_FAULT)
        self._command(Command.DISABLE)
        if word == cia402.FAULT_RESET:
            self._channel.write(*cia402.CONTROLWORD, word)
            self._channel.write(*cia402.CONTROLWORD, cia402.DISABLE_VOLTAGE)
        off = ServoState.SWITCH_ON_DISABLED
        self._await(self.state, lambda state: state is off, off.value)
        self._channel.forget_faults()

    def set_target(self, angle_rad: float) -> None:
        counts = self._scales.counts(angle_rad)
        if counts not in _INT32:
            raise ConfigurationError(
                f"the target {angle_rad:g} rad is {counts} counts, which do not fit into the 32 "
                "bits of 607Ah: check the scales in the bench file"
            )
        self._stage(counts)

    def set_torque_offset(self, torque_N_m: float) -> None:
        """Set the torque offset (60B2h) to the nearest per mille of the rated torque. Unless the
        controlword commands operation, a torque offset of zero is sent.
        """
        if not self._motion.takes_offset:
            super().set_torque_offset(torque_N_m)
        units = round(self._scales.sign * torque_N_m / self._scales.joint_torque_unit_N_m)
        if units not in _INT16:
            raise ConfigurationError(
                f"the torque offset {torque_N_m:g} N m is {units} per mille of the rated torque "
                "6076h, which does not fit into the 16 bits of 60B2h"
            )
        self._motion.offset = units if self._word == cia402.ENABLE_OPERATION else 0
        self._stage(self._target)

    def sample(self) -> ServoSample:
        statusword, position = self._values.motion()
        following = 0
        if statusword & 0x6F == 0x27 and self._motion.follows:
            # At the SYNC of an exchange the drive has reached the target of the previous exchange.
            demand = self._previous if self._channel.cycle <= self._staged_in + 1 else self._target
            following = demand - position
        return self._values.sample(following)

    @property
    def _outputs(self) -> list[PdoLayout]:
        return objects.outputs(self._motion)

    def _stage(self, counts: int) -> None:
        if self._channel.cycle != self._staged_in:
            self._previous = self._target
            self._staged_in = self._channel.cycle
        self._target = counts
        self._motion.stage(self._channel, self._word, counts, self._values.observed)

    def _command(self, command: Command, at_once: bool = True) -> None:
        # The controlword of the process data is changed first, so that no later exchange can undo
        # the command.
        self._word = cia402.CONTROLWORDS[ServoState.OPERATION_ENABLED, command]
        self._motion.offset = 0
        if self._cycle_ns:
            self._stage(self._target)
        brakes = command is Command.QUICK_STOP
        self._channel.limit_wait(_WAIT_SHARE * self._watch_s if brakes else None)
        send = self._channel.insist if at_once else self._channel.announce
        send(*cia402.CONTROLWORD, self._word)

    def _arm(self) -> None:
        """Start the watch; a drive that counts as one without a watchdog may refuse it."""
        self._armed = True
        for refused in problem_of(self._channel.watch, self._watch_s):
            if self.watch_s is not None:
                raise refused

    def _feeds(self) -> bool:
        """Return whether the drive may be told that the loop is alive while its state is read: a
        drive that does not execute the quick stop is braked by its watchdog.
        """
        if not self._armed or self._word != cia402.QUICK_STOP:
            return self._armed
        sent = self.sent_state()
        return sent is not None and not sent.energised

    def _release(self) -> None:
        self._channel.unwatch()
        self._armed = False

    def _in_mode(self) -> bool:
        """Return whether the mode of operation is active, that is, shown in object 6061h."""
        return self._channel.read(*objects.MODE_DISPLAY) == self._motion.mode

    def _select_mode(self) -> bool:
        """Select the mode of operation (6060h) and wait; return whether the drive activated it."""
        if (error := self._not_offered()) is not None:
            raise error
        self._channel.write(*objects.MODE, self._motion.mode)
        for in_time in self._exchanges():
            if self._in_mode():
                return True
            if not in_time:
                break
        return False

    def _walk(self, in_mode: bool) -> None:
        for in_time in self._exchanges():
            statusword, position = self._values.motion()
            state = decode_state(statusword)
            if state in FAULTS:
                raise self.fault()
            if state in objects.NEEDED_IN and not in_mode:
                in_mode = self._in_mode()
                if not in_mode and not in_time:
                    raise StateError(
                        f"in state '{state.value}' the active mode 6061h still reads "
                        f"{self._channel.read(*objects.MODE_DISPLAY)}, {self._timeout_s:g} s after "
                        f"mode {self._motion.mode} ({self._motion.words}) was written to 6060h: "
                        "check in the drive's manual how this mode is selected"
                    )
                if not in_mode:
                    continue
            if state is ServoState.OPERATION_ENABLED and self._channel.fresh:
                return
            if not in_time:
                raise self._not_up(state)
            if self._channel.fresh:
                self._word = controlword(state, Command.ENABLE)
                self._stage(position)

    def homing_offer(self) -> HomingOffer:
        channel = self._channel
        try:
            why = self._missing(METHOD, HOME_OFFSET)
            modes = None if why else self._modes()
            if modes is not None and not modes >> HOMING - 1 & 1:
                why = f"6502h reads {modes:08X}h: bit {HOMING - 1}, homing mode, is 0"
            if why:
                return HomingOffer(why_not=why)
            listed = self._listed_methods()
            methods = STANDARD if listed is None else listed
            fit = tuple(m for m in methods if not [*problem_of(channel.require_fit, *METHOD, m)])
            still = self._missing(SEARCH_SPEED, ZERO_SPEED)
        except (ObjectAccessError, ConfigurationError) as refused:
            return HomingOffer(why_not=str(refused))
        if still:
            fit = tuple(m for m in fit if m in IN_PLACE)
        why = still or ("" if fit else "60E3h lists no method that fits into 6098h")
        return HomingOffer(fit, why, listed is not None)

    def _missing(self, *addresses: ObjectAddress) -> str:
        """Return the object for homing that the drive lacks; empty if none is missing."""
        for address in addresses:
            if not self._channel.describes(*address):
                return f"object {short_name(address)} is not in the device's EDS"
            if optional(self._channel.read, *address) is None:
                return f"object {short_name(address)} is in the device's EDS, but not in the device"
        return ""

    def _listed_methods(self) -> tuple[int, ...] | None:
        """Return the methods that object 60E3h lists, or None for a drive without this object."""
        read = self._channel.read
        if not self._channel.describes(SUPPORTED_METHODS, 0):
            return None
        count = optional(read, SUPPORTED_METHODS, 0)
        if count is None:
            return None
        found = (optional(read, SUPPORTED_METHODS, at) for at in range(1, min(count, 254) + 1))
        # 60E3h may be unsigned, whereas in 6098h the maker's own methods are negative numbers.
        return tuple(sorted({m - 256 if m > 127 else m for m in found if m}))

    def begin_homing(self, order: HomingOrder) -> Mapping[str, int]:
        state = self.state()
        if state.energised or isinstance(self._motion, Homing):
            raise StateError(f"the drive is in state '{state.value}': disable it before homing")
        held: dict[str, int] = {}
        for address, value in homing_settings(self._channel, self._scales, order):
            self._channel.require_fit(*address, value)
            servo_limits.store(self._channel, address, value)
            held[short_name(address)] = value
        self._motion = Homing(self._motion)
        try:
            self.enable()
        except DeviceError:
            with suppress(DeviceError):
                self.end_homing()
            raise
        return held

    def start_homing(self) -> None:
        if isinstance(self._motion, Homing):
            self._motion.started = True
            self._stage(self._target)

    def homing_state(self) -> HomingState:
        word, _ = self._values.motion()
        if word & _ERROR:
            return HomingState.FAILED
        if not word & _REACHED or not self._channel.fresh:
            return HomingState.RUNNING
        return HomingState.ATTAINED if word & _ATTAINED else HomingState.INTERRUPTED

    def end_homing(self) -> tuple[int, int]:
        state = self.state()
        if state.energised:
            raise StateError(
                f"the drive is in state '{state.value}', in which its mode of operation cannot be "
                "changed from homing: disable it first"
            )
        if isinstance(self._motion, Homing):
            self._motion = self._motion.usual
        mode = self._motion.mode
        self._channel.write(*objects.MODE, mode)
        return self._channel.read(*objects.MODE_DISPLAY), mode


def homing_settings(
    channel: ProcessChannel, scales: ServoScales, order: HomingOrder
) -> Iterator[tuple[ObjectAddress, int]]:
    """Yield the objects that are written before a homing, and their values; speeds are rounded
    down.

    Raises:
        ConfigurationError: A speed is less than the unit of its object.
    """
    unit = scales.joint_speed_unit_rad_s
    if order.method not in IN_PLACE:
        for address, speed in ((SEARCH_SPEED, order.search_rad_s), (ZERO_SPEED, order.zero_rad_s)):
            value = math.floor(speed / unit + 1e-6)
            if value < 1:
                raise ConfigurationError(
                    f"the homing speed, {speed:g} rad/s at the joint, is less than one unit of "
                    f"object 6099h, {unit:g} rad/s: raise --speed-limit"
                )
            yield address, value
        if channel.describes(*HOMING_ACCELERATION):
            units = order.acceleration_rad_s2 / scales.joint_acceleration_unit_rad_s2
            yield HOMING_ACCELERATION, max(1, round(units))
    yield HOME_OFFSET, scales.counts(order.home_rad)
    yield METHOD, order.method
