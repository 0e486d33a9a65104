"""Actions of a fault schedule on a simulated bench of any kind, and the faults a bench supports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from drivers.mock import dbc_drive, faults, power_state
from drivers.mock.bench import SimulatedBench, SimulatedDbcBench
from drivers.mock.dbc_drive import DbcDrive
from drivers.mock.drive import SimulatedDrive
from drivers.mock.encoder import SimulatedAmt21
from drivers.mock.faults import LineFaults, Match, WireFaults
from rig.config.bench import Bench
from rig.config.dbc import DbcServoSection
from rig.config.faults import COUNTED_FRAMES, FaultRow, Frames
from rig.config.serial_bus import Amt21Section, SerialBus
from rig.wiring.off import REST_RAD_S

_CANOPEN_DRIVE: Final = frozenset({"emcy", "sdo_abort", "sdo_timeout"})
_DBC_DRIVE: Final = frozenset({"limits_refused", "counter_stuck"})
_LARGEST_CODE: Final = 0xFF

_DBC_STATES: Final[Mapping[dbc_drive.State, str]] = {
    dbc_drive.State.OFF: "switch_on_disabled",
    dbc_drive.State.READY: "ready",
    dbc_drive.State.RUN: "operation_enabled",
    dbc_drive.State.STOPPING: "quick_stop_active",
    dbc_drive.State.BRAKING: "fault_reaction",
    dbc_drive.State.FAULT: "fault",
}
_DBC_FRAMES: Final[Mapping[str, int]] = {
    "output": dbc_drive.COMMAND,
    "motion": dbc_drive.MOTION,
    "speed": dbc_drive.POWER,
    "heartbeat": dbc_drive.STATUS,
}
"""Frames of the simulated DBC drive by the functions of a CANopen drive in ``frames``."""
_DBC_IDENTIFIERS: Final = frozenset(
    {
        dbc_drive.STOP,
        dbc_drive.COMMAND,
        dbc_drive.LIMITS,
        dbc_drive.MOTION,
        dbc_drive.POWER,
        dbc_drive.STATUS,
        dbc_drive.INFO,
        dbc_drive.LIMITS_HELD,
    }
)


def impossible(row: FaultRow, bench: Bench) -> str | None:
    """Return why a bench does not support a fault, or None if the bench supports the fault."""
    serial = isinstance(bench.bus, SerialBus)
    own_frames = isinstance(bench.servo, DbcServoSection)
    has = {
        "bus": not serial,
        "line": serial,
        "encoder_line": isinstance(bench.encoder, Amt21Section),
    }
    if not has.get(row.target, True):
        return (
            f"this bench has no {row.target}; it has "
            f"{' and '.join(name for name in has if has[name])}"
        )
    if row.target == "drive":
        if row.fault in _CANOPEN_DRIVE and (serial or own_frames):
            return f"the fault {row.fault} exists only for CANopen drives on CAN; leave it out"
        if row.fault in _DBC_DRIVE and not own_frames:
            return f"the fault {row.fault} exists only for drives of kind dbc; leave it out"
        if row.fault == "quick_stop_option" and own_frames:
            return "a drive of kind dbc has no 605Ah; leave this fault out"
        if row.fault == "fault" and own_frames and (row.amount or 0) > _LARGEST_CODE:
            return (
                f"error codes of a drive of kind dbc go up to FFh; give a lower value (got "
                f"{row.amount:g})"
            )
    if row.state == "switched_on" and own_frames:
        return "a drive of kind dbc has no state switched_on; use another state"
    return None


class Scene:
    """One simulated bench, with the faults of its buses and lines."""

    def __init__(self, bench: SimulatedBench | SimulatedDbcBench) -> None:
        self.clock, self.machine = bench.clock, bench.machine
        self.bench = bench
        self.wire = WireFaults(bench.bus, bench.clock)
        self._lines: dict[str, LineFaults] = {}

    def watch(self, told: Callable[[str, bool], None]) -> None:
        """Set a callback for every new state of the drive: name, and whether energised."""
        drive = self.bench.drive
        if isinstance(drive, DbcDrive):
            drive.entered.append(lambda state: told(_DBC_STATES[state], state in dbc_drive.POWERED))
        else:
            drive.entered.append(
                lambda state: told(state.name.lower(), state in power_state.POWERED)
            )

    @property
    def live(self) -> bool:
        """Whether current flows in the motor or the joint moves, whatever the drive reports."""
        self.bench.sampler.advance(self.clock.now_ns())
        truth = self.machine.truth()
        return truth.current_A != 0.0 or abs(truth.velocity_rad_s) > REST_RAD_S

    def apply(self, row: FaultRow) -> None:
        """Execute a fault."""
        ACTIONS[row.target, row.fault](self, row)

    def line(self, device: str) -> LineFaults:
        """Return the fault injector of a line, which exists once the host has made its driver."""
        if device not in self._lines:
            assert isinstance(self.bench, SimulatedBench)
            self._lines[device] = LineFaults(self.bench.lines[device], self.clock)
        return self._lines[device]

    @property
    def canopen_drive(self) -> SimulatedDrive:
        """The drive, if it is a CANopen drive."""
        assert isinstance(self.bench, SimulatedBench)
        return self.bench.drive

    @property
    def dbc_drive(self) -> DbcDrive:
        """The drive, if it has its own CAN frames."""
        assert isinstance(self.bench, SimulatedDbcBench)
        return self.bench.drive

    @property
    def sensor(self) -> faults.Sensor:
        """The joint encoder that the host uses."""
        if isinstance(self.bench, SimulatedBench) and "encoder" in self.bench.lines:
            station = self.bench.lines["encoder"].station
            assert isinstance(station, SimulatedAmt21)
            return station
        return self.bench.encoder

    def counts(self, degrees: float) -> int:
        """Return an angle in counts of the joint encoder that the host uses."""
        return round(degrees / 360.0 * self.sensor.counts_per_turn)

    def restart(self) -> None:
        """Restart the drive."""
        if isinstance(self.bench, SimulatedBench):
            self.wire.restart(self.bench.drive.node_id)
        else:
            self.bench.drive.restart()

    def refuse_mode(self) -> None:
        """Make the drive ignore the command without which it does not follow targets."""
        if isinstance(self.bench, SimulatedBench):
            faults.refuse_mode(self.bench.drive)
        else:
            self.bench.drive.deaf_to = frozenset({dbc_drive.Order.RUN})

    def match(self, frames: Frames) -> Match:
        """Return the selection of bus frames that a row states."""
        drive, encoder = self.bench.drive, self.bench.encoder
        nodes = {"encoder": encoder.node_id}
        own: Mapping[str, int] = {}
        mine: frozenset[int] = frozenset()
        if isinstance(drive, DbcDrive):
            own, mine = _DBC_FRAMES, _DBC_IDENTIFIERS
        else:
            nodes["drive"] = drive.node_id
        device, function = frames.device, frames.function

        def match(identifier: int, host: bool) -> bool:
            of_drive = identifier in mine
            if device == "host" and not host:
                return False
            if device == "drive" and mine and not of_drive:
                return False
            if device in nodes and (of_drive or identifier & 0x7F != nodes[device]):
                return False
            if function is None:
                return True
            return (
                identifier == own.get(function)
                if of_drive
                else identifier & 0x780 in COUNTED_FRAMES[function]
            )

        return match


def _from_host(row: FaultRow) -> bool | None:
    return None if row.frames.device is None else row.frames.device == "host"


def _whole(row: FaultRow) -> int:
    return int(row.amount or 0)


Action = Callable[[Scene, FaultRow], None]


def _line_actions(target: str, device: str) -> dict[tuple[str, str], Action]:
    actions: dict[str, Action] = {
        "lost": lambda s, r: s.line(device).lose(_from_host(r), r.count),
        "byte_lost": lambda s, r: s.line(device).drop_byte(_from_host(r), r.count, _whole(r)),
        "corrupt": lambda s, r: s.line(device).flip(_from_host(r), r.count, _whole(r)),
        "late": lambda s, r: s.line(device).delay(_from_host(r), r.count, r.amount or 0.0),
        "repeated": lambda s, r: s.line(device).repeat(_from_host(r), r.count),
        "cut": lambda s, r: s.line(device).cut(r.amount),
    }
    return {(target, name): action for name, action in actions.items()}


ACTIONS: Mapping[tuple[str, str], Action] = {
    ("bus", "lost"): lambda s, r: s.wire.lose(s.match(r.frames), r.count),
    ("bus", "repeated"): lambda s, r: s.wire.repeat(s.match(r.frames), r.count),
    ("bus", "late"): lambda s, r: s.wire.delay(s.match(r.frames), r.count, r.amount or 0.0),
    ("bus", "flipped"): lambda s, r: s.wire.flip(s.match(r.frames), r.count, _whole(r)),
    ("bus", "short"): lambda s, r: s.wire.shorten(s.match(r.frames), r.count),
    ("bus", "bus_off"): lambda s, r: s.wire.bus_off(r.amount),
    ("bus", "error_frames"): lambda s, r: s.wire.error_frames(r.count),
    **_line_actions("line", "drive"),
    ("line", "stuffing"): lambda s, r: s.line("drive").break_stuffing(_from_host(r), r.count),
    ("line", "refused"): lambda s, r: s.line("drive").refuse(r.count),
    **_line_actions("encoder_line", "encoder"),
    ("drive", "emcy"): lambda s, r: s.canopen_drive.emergency(_whole(r), 0x01),
    ("drive", "fault"): lambda s, r: s.bench.drive.fail(_whole(r)),
    ("drive", "restart"): lambda s, _: s.restart(),
    ("drive", "quick_stop_option"): lambda s, r: s.canopen_drive.objects.values.update(
        {0x605A00: _whole(r)}
    ),
    ("drive", "stuck"): lambda s, _: setattr(s.machine, "stuck", True),
    ("drive", "mode_refused"): lambda s, _: s.refuse_mode(),
    ("drive", "sdo_abort"): lambda s, r: s.wire.refuse_sdo(s.canopen_drive.node_id, r.count),
    ("drive", "sdo_timeout"): lambda s, r: s.wire.lose(
        s.match(Frames(device="drive", function="sdo_request")), r.count
    ),
    ("drive", "limits_refused"): lambda s, _: setattr(s.dbc_drive, "locked", True),
    ("drive", "counter_stuck"): lambda s, _: setattr(s.dbc_drive, "counting", False),
    ("drive", "position_sign"): lambda s, _: s.machine.reverse("position"),
    ("drive", "velocity_sign"): lambda s, _: s.machine.reverse("velocity"),
    ("drive", "phases_swapped"): lambda s, _: s.machine.reverse("phases"),
    ("encoder", "bit"): lambda s, r: faults.flip_bit(s.sensor, _whole(r), r.count),
    ("encoder", "jump"): lambda s, r: faults.jump(s.sensor, s.counts(r.amount or 0.0)),
    ("encoder", "frozen"): lambda s, _: faults.freeze(s.sensor),
    ("encoder", "reversed"): lambda s, _: faults.reverse(s.sensor),
}
