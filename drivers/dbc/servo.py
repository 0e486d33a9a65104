"""Position servo for drives with their own CAN frames, by a DBC file and a map of its signals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from drivers.can.port import hexadecimal
from drivers.canopen import cia402
from drivers.clock import NS
from drivers.dbc import limits as dbc_limits
from drivers.dbc.channel import PERIODS_KEPT, DbcChannel, Slot
from drivers.dbc.codec import Order
from drivers.dbc.limits import DbcDrive
from drivers.dbc.link import DbcLink
from drivers.errors import ConfigurationError, DeviceError, DriveFault, LinkError, StateError
from drivers.interfaces import (
    Identity,
    LimitSteps,
    Measuring,
    ServoLimits,
    ServoMotion,
    ServoReadings,
    ServoSample,
    ServoState,
)
from drivers.objects import problem_of
from drivers.transitions import FAULTS, SteppedServo
from drivers.units import Unwrapper

_ANSWER_S: Final = 0.3
_BRAKING_S: Final = 0.04
"""Time-out of an answer while the drive brakes, s; no cycle is sent meanwhile."""


class Feedback:
    """The quantities that a drive reports; LinkError if it sends none."""

    def __init__(self, link: DbcLink, channel: DbcChannel) -> None:
        self._link = link
        self._clock = link.clock
        self._channel = channel
        self._inputs = channel.wiring.inputs
        self._reads = {
            name: (channel.slot(quantity.message), quantity.read)
            for name, quantity in self._inputs.items()
        }
        self._fault_asked = False
        self._position: float | None = None
        self.restart_time()

    def restart_time(self) -> None:
        """Restart the count of overflows of the drive's time stamp."""
        time = self._inputs.get("time")
        self._time = Unwrapper(1 if time is None else 1 << time.signal.width)

    def unasked(self, *names: str) -> list[float]:
        """Return quantities from their next frames; NaN for those not sent unasked."""
        slots = {name: self._reads[name][0] for name in names if name in self._reads}
        heard = {
            key: self._await(slot)
            for key, slot in {id(slot): slot for slot in slots.values()}.items()
        }
        return [
            self.value(name) if name in slots and heard[id(slots[name])] else math.nan
            for name in names
        ]

    def limits(self) -> dict[str, float]:
        """Return the limits in the next frames of the drive."""
        reported = self._channel.wiring.reported.values()
        for message in sorted({held.message for held in reported}):
            self.await_frame(message)
        return self._channel.limits()

    def fault_code(self, *, again: bool = False) -> None:
        """Wait for the fault code, if none has been received yet or if ``again`` is true.

        For a drive that sends the fault code only in answer to a command, this method waits once.
        """
        quantity = self._inputs.get("fault_code")
        if quantity is None or quantity.message == self._channel.wiring.status_message:
            return
        slot = self._channel.slot(quantity.message)
        if again or not (slot.count or self._fault_asked):
            self._fault_asked = True
            self._await(slot)

    def state_since(self, since_ns: int, cycle_ns: int) -> ServoState | None:
        """Return the state if its last frame is after ``since_ns`` and in time, or None."""
        channel = self._channel
        slot = channel.slot(channel.wiring.status_message)
        kept_ns = PERIODS_KEPT * max(slot.message.period_s * NS, cycle_ns)
        recent = since_ns < slot.time_ns >= self._clock.now_ns() - kept_ns
        return channel.state if cycle_ns and recent else None

    def value(self, name: str) -> float:
        """Return a quantity from its last valid frame; NaN if it is not reported."""
        if name not in self._reads:
            return math.nan
        slot, read = self._reads[name]
        found = read(slot.data)
        if name != "position" or (period := self._inputs[name].wraps_after) is None:
            return found
        last = found if self._position is None else self._position
        self._position = last + math.remainder(found - last, period)
        return self._position

    def device_time(self) -> float:
        """Return the drive's time of the last sample, or the host's of its arrival, s."""
        quantity = self._inputs.get("time")
        if quantity is None:
            return self._reads["position"][0].time_ns / NS
        raw = quantity.signal.raw(self._channel.slot(quantity.message).data)
        whole = raw if quantity.signal.real else self._time.update(int(raw))
        return whole * quantity.gain + quantity.bias

    def told(self, name: str, otherwise: int) -> int:
        """Return an integer from the next frame of the drive; ``otherwise`` if it has none."""
        quantity = self._inputs.get(name)
        if quantity is None:
            return otherwise
        self.await_frame(quantity.message)
        return round(self.value(name))

    def await_frame(self, name: str, *, ask: bool = False) -> None:
        """Wait for the next valid frame of a message; with ``ask``, send the current order until it
        arrives, because a drive may send a message only as an answer.
        """
        slot = self._channel.slot(name)
        refused = slot.refused
        if not self._await(slot, ask):
            raise self._silent(slot, refused)

    def _await(self, slot: Slot, ask: bool = False) -> bool:
        link, channel, message = self._link, self._channel, slot.message

        def prompt() -> None:
            if ask or not message.remote:
                link.command(channel)
            link.request(slot)

        alone = message.period_s or not channel.wiring.asked
        asked = ask or message.remote or not alone
        return link.await_frame(channel, slot, self._patience_s(slot), prompt if asked else None)

    def _silent(self, slot: Slot, refused: int) -> LinkError:
        bad = slot.refused - refused
        why = (
            f"{bad} had a wrong length, checksum or counter: check these in the map"
            if bad
            else "check the supply and the bus of the drive"
        )
        name, identifier = slot.message.name, hexadecimal(slot.message.identifier)
        return LinkError(
            f"{self._channel.label} sent no valid {name} ({identifier}) "
            f"in {self._patience_s(slot):g} s: {why}"
        )

    def _patience_s(self, slot: Slot) -> float:
        answer_s = _BRAKING_S if self._channel.stopping else _ANSWER_S
        return max(answer_s, PERIODS_KEPT * slot.message.period_s)


_STATUSWORDS: Final = {state: value for _, value, state in cia402.STATUS}
_UNKNOWN_STATE: Final = _STATUSWORDS[ServoState.NOT_READY]


class DbcServo(SteppedServo):
    """A drive with its own CAN frames. Only :meth:`enable` changes its state toward power."""

    def __init__(
        self, link: DbcLink, channel: DbcChannel, drive: DbcDrive, state_timeout_s: float = 1.0
    ) -> None:
        super().__init__(link, state_timeout_s)
        self._bus = link
        self._channel = channel
        self._wiring = wiring = channel.wiring
        self._drive = drive
        self._feedback = Feedback(link, channel)
        self._effort = "current" if "current" in wiring.inputs else "torque"
        self._effort_per_A = 1.0 if "current" in wiring.inputs else drive.torque_constant_N_m_A
        self._status = channel.slot(wiring.status_message)
        self._command_period_s = wiring.sent[wiring.target.message].period_s
        self.watch_s = drive.watchdog_s
        self.asked = wiring.asked
        self.limits_taken = dbc_limits.taken(wiring)
        self.limit_places = dbc_limits.places(wiring)
        link.has_watchdog = link.has_watchdog and drive.watchdog_s is not None
        self._target = self._previous = 0.0
        self._staged_in = 0
        self._stopped_ns = 0

    def identity(self) -> Identity:
        told = self._drive.identity
        return Identity(
            name=told.name,
            vendor_id=told.vendor_id,
            product_code=told.product_code,
            revision=self._feedback.told("revision", told.revision),
            serial_number=self._feedback.told("serial_number", told.serial_number),
        )

    def state(self) -> ServoState:
        """Wait for the drive's next status frame and return its state."""
        self._feedback.fault_code()
        self._feedback.await_frame(self._wiring.status_message)
        state = self._channel.state
        if state is None:
            raw = self._wiring.status.raw(self._status.data)
            raise StateError(
                f"{self._channel.label} reports the status {raw:g}, which the map does not "
                "contain: add this value under servo.status.states"
            )
        return state

    def sent_state(self) -> ServoState | None:
        """Return the state in the last frames; None if older than the last quick stop."""
        return self._feedback.state_since(self._stopped_ns, self._cycle_ns)

    def _told(self) -> ServoState:
        """Return the state after the next fault code, which may arrive later than the state."""
        self._feedback.fault_code(again=True)
        return self.state()

    def read_limits(self) -> ServoLimits:
        return dbc_limits.decode(self._feedback.limits(), self._drive)

    def limit_steps(self) -> LimitSteps:
        return dbc_limits.steps(self._wiring, self._drive)

    def limit_problems(self, limits: ServoLimits) -> Iterator[DeviceError]:
        wiring, drive = self._wiring, self._drive
        yield from problem_of(dbc_limits.images, wiring, dbc_limits.encode(limits, drive))
        yield from problem_of(
            dbc_limits.require_room, limits, drive.held, wiring.limits, self._channel.label
        )

    def write_limits(self, limits: ServoLimits) -> None:
        wanted = dbc_limits.encode(limits, self._drive)
        settable = self._wiring.limits
        self._channel.pin({})
        for identifier, data in self._channel.settings(dbc_limits.images(self._wiring, wanted)):
            self._bus.send(identifier, data)
        held = self._feedback.limits()
        dbc_limits.verify(wanted, held, settable, self._channel.label)
        self._channel.pin(held)
        dbc_limits.require_room(limits, self._drive.held, settable, self._channel.label)

    def readings(self) -> ServoReadings:
        """Wait for the next frame of each message that contains a value.

        A message that the drive sends only in answer to a command is not requested; its values are
        NaN.
        """
        names = ("position", "velocity", self._effort, "supply_voltage", "temperature")
        position, velocity, effort, supply, temperature = self._feedback.unasked(*names)
        gear = self._drive.gear_ratio
        angle = position + self._drive.offset_rad * gear
        return ServoReadings(
            angle, velocity / gear, effort / self._effort_per_A, supply, temperature
        )

    def glance(self) -> ServoReadings:
        position, effort = self._feedback.unasked("position", self._effort)
        angle = position + self._drive.offset_rad * self._drive.gear_ratio
        return ServoReadings(angle, current_A=effort / self._effort_per_A)

    def measuring(self) -> Measuring:
        """Return the steps of the signals; the current limit stands in for the rating."""
        inputs, gear = self._wiring.inputs, self._drive.gear_ratio
        step_rad, effort = (
            0.0 if inputs[name].signal.real else abs(inputs[name].gain)
            for name in ("position", self._effort)
        )
        limit_A = self._drive.held.current_A
        return Measuring(step_rad / gear, gear, effort / self._effort_per_A, limit_A)

    def motion(self) -> ServoMotion:
        position, velocity = self._feedback.unasked("position", "velocity")
        gear = self._drive.gear_ratio
        return ServoMotion(position / gear + self._drive.offset_rad, velocity / gear)

    def promised_deceleration(self) -> float:
        return self._drive.held.quick_stop_deceleration_rad_s2

    def fault(self) -> DriveFault:
        return self._channel.fault()

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield an error for a cycle time that is too long for the drive's watchdog, and for a
        position that does not fit into the target signal.

        The method does not wait for a message that the drive sends only in answer to a command.
        """
        yield from problem_of(self._require_watchdog, cycle_s)
        (position,) = self._feedback.unasked("position")
        if not math.isnan(position):
            yield from problem_of(self._target_bits, position)

    def prepare(self, cycle_s: float) -> None:
        """Set the cycle, and wait for a valid frame of every message, without power."""
        self._require_off()
        self._require_watchdog(cycle_s)
        channel = self._channel
        self._bus.set_cycle(cycle_s, channel.label)
        channel.set_cycle(cycle_s)
        channel.order(self._wiring.disable)
        for name in (*self._wiring.received, *self._wiring.pages):
            self._feedback.await_frame(name, ask=True)
        self._cycle_ns = round(cycle_s * NS)
        self.prepared = True
        self._feedback.restart_time()
        self._stage(self._feedback.value("position"))

    def _require_way(self, state: ServoState) -> None:
        if state not in self._wiring.enable:
            raise StateError(f"'enable' is not allowed in state '{state.value}': disable first")

    def disable(self) -> None:
        self._command(self._wiring.disable)
        self._bus.stop(self._channel)
        # The orders are repeated, because a frame may have been lost.
        self._await(
            self.state,
            lambda state: not state.energised,
            "a de-energised state",
            lambda: self._command(self._wiring.disable),
        )

    def quick_stop(self, *, at_once: bool = True) -> None:
        del at_once  # no answer is waited for
        # The periodic order is changed first, so that no later exchange can undo the stop.
        self._channel.order(self._wiring.stop)
        self._stopped_ns = self._clock.now_ns()
        self._bus.stop(self._channel)
        self._command(self._wiring.stop)

    def reset_fault(self) -> None:
        # The table of CiA 402 determines the states in which a fault can be reset.
        word = cia402.controlword(self.state(), cia402.Command.RESET_FAULT)
        disable, reset = self._wiring.disable, self._wiring.reset
        # A drive reacts to the rising edge of a reset, so that each reset is sent between two
        # disable orders.
        orders = (disable, reset, disable) if word == cia402.FAULT_RESET else (disable,)
        self._command(*orders)
        off = ServoState.SWITCH_ON_DISABLED
        self._await(
            self._told, lambda state: state is off, off.value, lambda: self._command(*orders)
        )

    def set_target(self, angle_rad: float) -> None:
        self._stage((angle_rad - self._drive.offset_rad) * self._drive.gear_ratio)

    def set_torque_offset(self, torque_N_m: float) -> None:
        quantity = self._wiring.torque_offset
        if quantity is None:
            raise ConfigurationError(
                f"the map of this drive has no torque offset, but {torque_N_m:g} N m are "
                "requested: run without feed-forward"
            )
        try:
            bits = quantity.bits(torque_N_m / self._drive.gear_ratio)
        except ValueError as error:
            raise ConfigurationError(
                f"torque offset of {torque_N_m:g} N m at the joint: {error}; check its scale"
            ) from error
        self._channel.push(bits)

    def sample(self) -> ServoSample:
        channel, drive = self._channel, self._drive
        state = channel.state
        position = self._feedback.value("position")
        following = 0.0
        if state is ServoState.OPERATION_ENABLED:
            # At this time the drive has reached the target of the previous exchange.
            demand = self._previous if channel.cycle <= self._staged_in + 1 else self._target
            following = (demand - position) / drive.gear_ratio
        return ServoSample(
            self._feedback.device_time(),
            position + drive.offset_rad * drive.gear_ratio,
            self._feedback.value("velocity") / drive.gear_ratio,
            self._feedback.value(self._effort) / self._effort_per_A,
            self._feedback.value("voltage"),
            self._feedback.value("supply_voltage"),
            self._feedback.value("temperature"),
            following,
            _UNKNOWN_STATE if state is None else _STATUSWORDS[state],
            channel.fresh,
        )

    def _require_watchdog(self, cycle_s: float) -> None:
        slowest, watchdog_s = max(cycle_s, self._command_period_s), self._drive.watchdog_s
        if watchdog_s is not None and slowest > watchdog_s / 2:
            raise ConfigurationError(
                f"a command is sent every {slowest * 1e3:g} ms, but the drive stops after "
                f"{watchdog_s * 1e3:g} ms without a command; the time between two commands must "
                "be at most half of this time: raise cycle_Hz"
            )

    def _stage(self, motor_rad: float) -> None:
        bits = self._target_bits(motor_rad)
        channel = self._channel
        if channel.cycle != self._staged_in:
            self._previous = self._target
            self._staged_in = channel.cycle
        self._target = motor_rad
        channel.aim(bits)

    def _target_bits(self, motor_rad: float) -> int:
        try:
            return self._wiring.target.bits(motor_rad)
        except ValueError as error:
            raise ConfigurationError(
                f"target of {motor_rad:g} rad at the motor: {error}; check its scale"
            ) from error

    def _command(self, *orders: Order) -> None:
        for order in orders:
            self._channel.order(order)
            self._bus.command(self._channel)

    def _energise(self) -> None:
        channel, wiring = self._channel, self._wiring
        channel.order(wiring.disable)
        step: ServoState | None = None
        for in_time in self._exchanges():
            state = channel.state
            if state in FAULTS:
                raise channel.fault()
            if channel.fresh and state is ServoState.OPERATION_ENABLED:
                channel.order(wiring.enable[ServoState.OPERATION_ENABLED], hold=True)
                return
            if not in_time:
                raise self._not_up(state)
            if channel.fresh and state is not None and state in wiring.enable:
                # The order of each state is sent once, because a message that is sent only with an
                # order must not be repeated.
                if state is not step:
                    channel.order(wiring.enable[state])
                    step = state
                self._stage(self._feedback.value("position"))
