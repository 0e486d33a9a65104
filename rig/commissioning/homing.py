"""The step in which the drive sets its zero by its own homing, watched at low limits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from drivers.clock import NS
from drivers.errors import DeviceError
from drivers.homing import Homes, HomingOrder, HomingState, method_words
from drivers.interfaces import ServoState
from rig.commissioning.record import SkippedError, StepRecord, WrongError
from rig.commissioning.setup import FASTEST_DEG_S, HomeRequest, Setup
from rig.commissioning.still import ZERO_TOLERANCE_DEG
from rig.common.sample import Sample
from rig.control.cycle import TripError
from rig.control.motion_proof import Change
from rig.control.readings import take_readings
from rig.control.safety import Check, Trip
from rig.planning.limits import Limits
from rig.terminal.stop_button import OperatorStopError

SETTLE_S: Final = 0.3
"""Time after the start in which the statusword may still show the state before, s."""
STILL_S: Final = 0.2  # time, s, for which the joint is monitored after the end of a homing
IN_PLACE_LIMIT_S: Final = 5.0
SPARE_S: Final = 20.0
MOVED_DEG: Final = 0.2  # largest motion of the joint in a homing without motion
NEAR_DEG: Final = 1.0
"""Largest distance from the home position after a homing with motion, which brakes there."""
ZERO_DEG_S: Final = 1.0
FASTER: Final = 3.0
"""Ratio to the speed limit above which a change of the drive's position is a new zero."""
ACCELERATION_S: Final = 0.2  # time, s, in which the drive reaches the speed of the homing
UNSET: Final = (
    "The zero of the drive counts as not set: home again, or leave --home out and give the true "
    "angle (--angle)"
)


_LOOK_FOR: Final[Mapping[Check, str]] = {
    Check.ANGLE: "look for a switch that does not close within the limits of the bench",
    Check.SAMPLE_AGE: "check the cable, its plugs and the load of the bus",
    Check.PAUSE: "look for other programs that load this computer",
    Check.LATENESS: "look for other programs that load this computer",
    Check.SLEEP: "switch the sleep of this computer off",
    Check.DRIVE_STATE: "read the drive's error code (603Fh) and remove its cause",
    Check.SPEED: "look at the drive's gains and at the unit of its speeds",
    Check.CURRENT: "look for a joint that is blocked, and an end stop before the switch",
    Check.TORQUE: "look for a joint that is blocked, and an end stop before the switch",
    Check.DISAGREEMENT: "check the joint encoder, its cable and its coupling",
}
"""Advice for checks that fail during a homing, by check."""
_ORDINARY: Final = "look for a fault of the drive (603Fh)"


def announced(setup: Setup, home: HomeRequest) -> str:
    """Return a text on what moves and what is under power."""
    what = f"The drive homes by method {home.method} ({method_words(home.method)})"
    alone = ""
    if setup.devices.servo.watch_s is None or not setup.devices.link.has_watchdog:
        goes_on = (
            "the drive STAYS UNDER POWER" if home.in_place else "THE HOMING GOES ON to its end"
        )
        alone = (
            f" This drive has no watchdog: if this program dies or the cable is lost, {goes_on}."
        )
    if home.in_place:
        return f"{what}: the drive is energised, and the joint stands still.{alone}"
    again = "" if home.home_deg is not None else ", and a second time with the offset found"
    return (
        f"{what}: THE JOINT TURNS BY ITSELF at up to {0.5 * FASTEST_DEG_S:g} deg/s, as far as the "
        f"limits of the bench allow{again}.{alone}"
    )


def homing(setup: Setup, step: StepRecord) -> None:
    """Home, and compare the drive's position with the joint angle of the home position.

    Raises:
        SkippedError: The drive does not offer the requested homing method.
        WrongError: The homing failed, took too long, or ended at a wrong position.
        OperatorStopError: The operator stopped the homing.
    """
    home = setup.home
    assert home is not None
    if why := setup.homing_offer.problem(home.method):
        raise SkippedError(f"{why}. The zero of the bench file is used")
    step.measure("method, 6098h", home.method)
    home_rad = _home_rad(setup, home)
    drive, joint = _homed(setup, step, home, home_rad)
    if home.home_deg is None and not home.in_place and abs(joint - drive) > _tolerance(home):
        home_rad += joint - drive
        drive, joint = _homed(setup, step, home, home_rad)
    degrees = math.degrees(home_rad)
    step.measure("joint angle of the home position", degrees, "deg")
    step.measure("angle by the drive afterwards", math.degrees(drive), "deg")
    step.measure("angle by the joint encoder afterwards", math.degrees(joint), "deg")
    for section in ("servo", "encoder"):
        offset = getattr(getattr(setup.bench, section), "offset_deg", 0.0)
        step.measure(f"{section}.offset_deg of the bench file", offset, "deg")
    _judge(setup, home, home_rad, drive, joint)
    step.words = (
        f"the drive has set its zero: the home position is {degrees:.4g} deg. This zero is valid "
        "until the drive loses its supply, unless the drive stores the zero; after a loss, home "
        "again"
    )


def _tolerance(home: HomeRequest) -> float:
    return math.radians(ZERO_TOLERANCE_DEG if home.in_place else NEAR_DEG)


def _home_rad(setup: Setup, home: HomeRequest) -> float:
    if home.home_deg is not None:
        return math.radians(home.home_deg)
    if home.in_place:
        if setup.true_deg is not None:
            return math.radians(setup.true_deg)
        angle = setup.devices.encoder.reading()
        if math.isnan(angle):
            raise WrongError("the joint encoder gives no angle: give the true angle (--angle)")
        return angle
    return math.radians(getattr(setup.bench.servo, "offset_deg", 0.0))


def _homed(
    setup: Setup, step: StepRecord, home: HomeRequest, home_rad: float
) -> tuple[float, float]:
    """Home once; return the angles of drive and joint encoder, rad, with the power off."""
    search = min(0.5 * setup.limits.speed, math.radians(0.5 * FASTEST_DEG_S))
    zero = min(search, math.radians(ZERO_DEG_S))
    order = HomingOrder(home.method, home_rad, search, zero, search / ACCELERATION_S)
    try:
        with setup.homing(order, step):
            _attend(setup, home, search)
    except WrongError as wrong:
        raise WrongError(f"{wrong}. {UNSET}{_left_on(setup, home)}") from wrong
    except TripError as tripped:
        raise WrongError(
            f"homing by method {home.method} ended: {tripped.trip.found}{_fault(setup, tripped)}; "
            f"{_LOOK_FOR.get(tripped.trip.check, _ORDINARY)}. {UNSET}{_left_on(setup, home)}"
        ) from tripped
    except DeviceError as error:
        raise WrongError(
            f"homing by method {home.method} ended: {error}. {UNSET}{_left_on(setup, home)}"
        ) from error
    except OperatorStopError as stopped:
        raise OperatorStopError(
            f"{stopped}; the homing was ended. {UNSET}{_left_on(setup, home)}"
        ) from stopped
    taken = take_readings(setup.devices, setup.bench.machine.gear_ratio)
    return taken.motor_encoder_at_joint_rad, taken.joint_encoder_rad


def _fault(setup: Setup, tripped: TripError) -> str:
    if tripped.trip.check is Check.DRIVE_STATE:
        with suppress(DeviceError):
            if setup.devices.servo.state() is ServoState.FAULT:
                return f" ({setup.devices.servo.fault()})"
    return ""


def _left_on(setup: Setup, home: HomeRequest) -> str:
    """Return a warning if a drive without a watchdog may still be under power."""
    safe = setup.safe
    if safe is None or safe.verified or safe.watched:
        return ""
    doing = "hold under power" if home.in_place else "BE TURNING"
    return f". The drive has no watchdog and may still {doing}: switch the main supply off now"


class _Travels:
    """Compares the travel of the joint that the drive reports with the travel that the joint
    encoder reports.

    Before the zero is set, the drive's angle has no meaning, but changes of the angle are valid. A
    change in one cycle that is faster than the limits allow is caused by the new zero, and does not
    count as travel.
    """

    def __init__(self, setup: Setup, begun: Sample) -> None:
        self._ratio = setup.bench.machine.gear_ratio
        self._fastest = FASTER * setup.limits.speed
        self._limit = setup.limits.encoder_disagreement
        self._begun = self._last = begun
        self._travel = 0.0

    def require_same(self, sample: Sample) -> None:
        change = (sample.motor_angle - self._last.motor_angle) / self._ratio
        if abs(change) <= self._fastest * (sample.time - self._last.time):
            self._travel += change
        self._last = sample
        apart = abs(sample.angle - self._begun.angle - self._travel)
        if apart > self._limit:
            raise TripError(Trip(Check.DISAGREEMENT, apart, self._limit, "rad", sample.time))


def _limits(setup: Setup, home: HomeRequest) -> Limits:
    """Return the limits of a homing: without those that need the drive's zero."""
    limits = dataclasses.replace(
        setup.limits, following_error=math.inf, encoder_disagreement=math.inf
    )
    if home.in_place:
        limits = dataclasses.replace(limits, angle_min=-math.inf, angle_max=math.inf)
    return limits


def _attend(setup: Setup, home: HomeRequest, search: float) -> None:
    """Start the homing and monitor it until its end."""
    servo, cycle, clock = setup.devices.servo, setup.cycle, setup.devices.link.clock
    limits = _limits(setup, home)
    cycle.resume()
    begun = cycle.attend(limits)
    way = setup.limits.angle_max - setup.limits.angle_min
    allowed_s = home.time_limit_s
    if allowed_s is None:
        allowed_s = IN_PLACE_LIMIT_S if home.in_place else SPARE_S + 2.0 * way / search
    assert isinstance(servo, Homes)  # the homing is offered
    servo.start_homing()
    travels = _Travels(setup, begun)
    started, state, sample = clock.now_ns(), HomingState.RUNNING, begun
    while state is HomingState.RUNNING:
        sample = cycle.attend(limits)
        _require_still(home, begun, sample)
        if not home.in_place:
            travels.require_same(sample)
        took_s = (clock.now_ns() - started) / NS
        if took_s >= SETTLE_S:
            state = servo.homing_state()
        if state is HomingState.RUNNING and took_s > allowed_s:
            raise WrongError(
                f"homing by method {home.method} has not ended after {took_s:.3g} s, limit "
                f"{allowed_s:g} s; look for a switch that does not close, or give more time "
                "(--home-time)"
            )
    if state is not HomingState.ATTAINED:
        angle = math.degrees(sample.angle)
        what = (
            "the drive reports a homing error (6041h bit 13)"
            if state is HomingState.FAILED
            else "the drive did not start or did not finish the homing (6041h bits 10 and 12)"
        )
        raise WrongError(
            f"{what} at {angle:.4g} deg, method {home.method}, statusword "
            f"{sample.statusword:04X}h; look for a joint that is blocked, check the switches and "
            f"their wiring, and read the error history (603Fh, 1003h)"
        )
    for _ in range(max(1, round(STILL_S / setup.bench.cycle_s))):
        _require_still(home, begun, cycle.attend(limits))


def _require_still(home: HomeRequest, begun: Sample, sample: Sample) -> None:
    moved = math.degrees(sample.angle - begun.angle)
    if home.in_place and not abs(moved) <= MOVED_DEG:
        raise WrongError(
            f"the joint moved by {moved:.3g} deg in a homing without motion (method "
            f"{home.method}); it may move by at most {MOVED_DEG:g} deg: check the drive's gains, "
            "and look for this method in the drive's manual"
        )


def _judge(setup: Setup, home: HomeRequest, home_rad: float, drive: float, joint: float) -> None:
    near = _tolerance(home)
    zero = math.radians(getattr(setup.bench.servo, "offset_deg", 0.0))
    if not abs(drive - home_rad) <= near:
        found = f"the drive shows {math.degrees(drive):.4g} deg after homing"
        # A drive that uses the offset with the opposite sign is right with an offset of 0.
        if abs(drive - (2.0 * zero - home_rad)) <= near:
            value = float(f"{math.degrees(home_rad):.4f}")
            change = Change("servo", "offset_deg", value)
            raise WrongError(
                f"{found}: the drive uses the home offset 607Ch with the opposite sign; set "
                f"{change}, so that 607Ch is 0",
                (change,),
            )
        raise WrongError(
            f"{found}; it must show {math.degrees(home_rad):.4g} deg within "
            f"{math.degrees(near):.2g} deg: look in the manual of the drive for the "
            f"meaning of 607Ch. {UNSET}"
        )
    limit = max(near, math.radians(setup.bench.limits.encoder_disagreement_deg))
    if not abs(joint - drive) <= limit:
        raise WrongError(
            f"the joint encoder shows {math.degrees(joint):.4g} deg after homing, the drive "
            f"{math.degrees(drive):.4g} deg; they must agree within {math.degrees(limit):.3g} deg: "
            f"correct --home-angle, or the zero of the joint encoder (--angle). {UNSET}"
        )
