"""Steps under power, at low limits: hold, watchdog, small moves, stop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from drivers.clock import NS
from drivers.errors import DeviceError, DriveFault
from drivers.interfaces import ServoState
from rig.commissioning.record import SkippedError, StepRecord, WrongError
from rig.commissioning.setup import FASTEST_DEG_S, SPEED_SHARE, Setup
from rig.control.cycle import TripError
from rig.control.motion_proof import RATIO_TOLERANCE, MotionWitness
from rig.control.safety import Check
from rig.planning.predicted_load import breakaway_speed, friction_model
from rig.runs.run import bench_constants
from rig.wiring.braking import BRAKING_TIMEOUT_S, brake
from rig.wiring.off import Steps

HOLD_S: Final = 0.5
DRIFT_DEG: Final = 0.2  # largest motion, deg, of a joint that must stand still
SILENCES: Final = (2.0, 5.0)
"""Durations for which this program sends nothing, in units of the drive's time-out; after the
longest duration the drive must be off. The drive is queried only after each duration, because a
query may restart the drive's time-out.
"""
SMALL_DEG: Final = 0.5
LARGE_DEG: Final = 5.0
GROWTH: Final = 2.0
SLOW_DEG_S: Final = 1.0
MARGIN: Final = 1.2  # ratio of a limit of the speed that would do to the predicted speed
STAYS: Final = 5  # least value of 605Ah with which a drive keeps its state after the ramp
RAMPS: Final = 3.0  # longest time of a quick stop, in units of the time by its deceleration
ANSWERS: Final = 4.0  # longest time until its end is known, in units of the time of one answer
LARGE_TOLERANCE: Final = 0.02
"""Relative difference of the encoders' travels that is allowed in the large move."""


def hold(setup: Setup, step: StepRecord) -> None:
    """Hold the joint under power, then without; raise a WrongError if it moves."""
    before = setup.devices.encoder
    with setup.power("hold") as here:
        setup.rest(here)
        start = before.sample().angle_rad
        setup.rest(here, HOLD_S)
        held = math.degrees(before.sample().angle_rad - start)
        step.measure("current while holding", abs(setup.devices.servo.sample().current_A), "A")
    step.measure("motion while holding", held, "deg")
    at = before.reading()
    clock = setup.devices.link.clock
    clock.sleep_until_ns(clock.now_ns() + round(HOLD_S * NS))
    fallen = math.degrees(before.reading() - at)
    step.measure("motion without power", fallen, "deg")
    for moved, when in ((held, "held under power"), (fallen, "without power")):
        if not abs(moved) <= DRIFT_DEG:
            raise WrongError(
                f"the joint moved by {moved:.3g} deg {when}; it may move by at most "
                f"{DRIFT_DEG:g} deg: check gains, brake and balance"
            )
    step.words = "the joint stands still, with power and without"


def watchdog(setup: Setup, step: StepRecord) -> None:
    """Send nothing while the drive holds the joint, until it has switched the power off itself.

    Raises:
        SkippedError: The drive has no watchdog.
        WrongError: The drive does not switch the power off.
    """
    servo, link = setup.devices.servo, setup.devices.link
    if servo.watch_s is None or not link.has_watchdog:
        raise SkippedError(
            "this drive has no watchdog: the program uses lower limits, and the operator "
            "must stay at the bench"
        )
    with setup.power("watchdog") as here:
        setup.rest(here)
        for silent_s in (share * servo.watch_s for share in SILENCES):
            link.clock.sleep_until_ns(link.clock.now_ns() + round(silent_s * NS))
            state = servo.state()
            if state.energised:
                # Some drives report their state only in answer to a target; this target is the
                # angle that the drive holds.
                with suppress(DeviceError):
                    setup.cycle.watch()
                state = servo.state()
            if not state.energised:
                break
        else:
            raise WrongError(
                f"the drive is still in state {state.value!r} {silent_s:.3g} s after this "
                f"program went silent, but must be off within {servo.watch_s:g} s: the drive "
                "would continue if the program died. Set the drive's reaction (6007h, 1016h) "
                "with the maker's tool; if the drive has no such reaction, set "
                "servo.stops_alone: false, which reduces the limits"
            )
    step.measure("power off within", silent_s, "s")
    step.measure("state", state.value)
    setup.clear()
    step.words = "the drive switches the power off when this program sends nothing"


def small_move(setup: Setup, step: StepRecord) -> None:
    """Move the joint by half a degree in both directions, and compare the reports of drive and
    joint encoder with each other and with the bench file; if the joint does not follow, move
    further.

    Raises:
        WrongError: Units, signs, ratio or constants are wrong, or the joint would exceed the limit
            of the speed.
    """
    _require_slow(setup)
    size = SMALL_DEG
    while True:
        if _move(setup, step, size, SLOW_DEG_S * size / SMALL_DEG, RATIO_TOLERANCE):
            break
        size *= GROWTH
        if size > LARGE_DEG:
            raise WrongError(
                f"the joint hardly moves within {size / GROWTH:g} deg: check that the joint is "
                "free, and the gains of the drive"
            )
    step.words = "units, signs and ratio agree"


def _require_slow(setup: Setup) -> None:
    """Refuse soft gains if the predicted speed of the breakaway is above the limit."""
    stiffness, limits = setup.stiffness_N_m_rad, setup.limits
    model = friction_model(bench_constants(setup.bench))
    stuck = (stiffness or 0.0) * math.radians(SMALL_DEG)
    if stiffness is None or not 0.0 < stuck < model.values["Ms"] < limits.torque:
        return  # the joint moves, or is another than that of the friction
    command = math.radians(0.5 * FASTEST_DEG_S)
    speed = math.degrees(breakaway_speed(stiffness, command, model))
    limit, most = math.degrees(limits.speed), SPEED_SHARE * setup.bench.limits.speed_deg_s
    if limit < min(speed, most):
        wanted = min(math.ceil(MARGIN * speed), most)
        enough = "" if speed < most else ", which may not be enough"
        raise WrongError(
            f"nothing was moved: the gains of the drive are low ({stiffness:.3g} N m/rad), so that "
            f"the joint would break away at up to {speed:.3g} deg/s, above the limit of "
            f"{limit:.3g} deg/s; give --speed-limit {wanted:g}{enough}, or raise the gains "
            f"(predicted from {model.source})"
        )


def large_move(setup: Setup, step: StepRecord) -> None:
    """Move the joint further, for a more accurate ratio; raises as :func:`small_move`."""
    if not _move(setup, step, LARGE_DEG, _fastest_deg_s(setup), LARGE_TOLERANCE):
        raise WrongError(
            f"the joint hardly moves within {LARGE_DEG:g} deg: check that the joint is free"
        )
    step.words = f"the encoders agree within {LARGE_TOLERANCE:.0%}"


def stop(setup: Setup, step: StepRecord) -> None:
    """Stop the drive in the middle of a slow move; raise a WrongError if it does not stop."""
    encoder, cycle, clock = setup.devices.encoder, setup.cycle, setup.devices.link.clock
    servo, cycle_s = setup.devices.servo, setup.bench.cycle_s
    speed = math.radians(_fastest_deg_s(setup))
    asked_ns = clock.now_ns()
    servo.state()
    answer_s = (clock.now_ns() - asked_ns) / NS
    with setup.power("stop") as here:
        end = here + _way(setup, here, LARGE_DEG)
        step_rad = math.copysign(speed * cycle_s, end - here)
        cycles = round(0.5 * abs(end - here) / abs(step_rad))
        cycle.follow([here + step_rad * n for n in range(1, cycles)], 0, "stop")
        began, at = clock.now_ns(), encoder.sample().angle_rad
        state = _brake(setup, step)
        took_s = (clock.now_ns() - began) / NS
        way = abs(math.degrees(encoder.sample().angle_rad - at))
    if state is ServoState.FAULT:
        raise WrongError(
            "the drive did not execute the quick stop and is in fault, by its watchdog or by "
            "another cause; check 605Ah and 6085h"
        )
    step.measure("time to the end of the stop", took_s, "s")
    step.measure("way", way, "deg")
    step.measure("state", state.value)
    # Upper bound: constant speed for twice the time of the stop, plus the drift of a joint at rest.
    allowed = 2.0 * math.degrees(speed) * max(took_s, 0.05) + DRIFT_DEG
    if not way <= allowed:
        raise WrongError(
            f"after the stop was commanded the joint moved by {way:.3g} deg, limit {allowed:.3g} "
            "deg; check 605Ah and 6085h"
        )
    promised = servo.promised_deceleration()
    if state is ServoState.QUICK_STOP_ACTIVE:
        # A drive that stays in this state after its ramp must be told from one that still brakes.
        stays = setup.bench.servo.quick_stop_option >= STAYS
        longest_s = math.inf if stays else 0.9 * BRAKING_TIMEOUT_S
    else:
        ramp_s = RAMPS * speed / promised if promised > 0.0 else BRAKING_TIMEOUT_S
        longest_s = ramp_s + 5.0 * cycle_s + ANSWERS * answer_s + 0.05
    if not took_s < longest_s:
        raise WrongError(
            f"the quick stop took {took_s:.3g} s from {math.degrees(speed):.3g} deg/s, limit "
            f"{longest_s:.3g} s by the deceleration that the drive promises; check 6085h and its "
            "unit"
        )
    step.words = "the drive stops and is off"


@contextmanager
def explained(setup: Setup, witness: MotionWitness) -> Iterator[None]:
    """Explain a trip or a fault of a motion by its samples, where a value of the bench file
    explains it.

    Raises:
        WrongError: A value of the bench file, or a unit of a device, caused the trip or fault.
    """
    try:
        yield
    except (TripError, DeviceError) as error:
        too_fast = isinstance(error, TripError) and error.trip.check is Check.SPEED
        cause = witness.hint(too_fast) or next(iter(witness.prove().contradictions), None)
        if cause is None:
            raise
        named = cause.words in str(error)
        if isinstance(error, TripError) and error.trip.check is Check.RUNAWAY:
            named = True  # by a wrong ratio or sign of the joint encoder
        words = cause.words if named else f"{error}; {cause.words}"
        raise WrongError(words, cause.changes) from error
    finally:
        setup.cycle.units = None


def _brake(setup: Setup, step: StepRecord) -> ServoState:
    """Stop the drive by its quick stop; return the state in which it ended."""
    link, failures, steps = setup.devices.link, list[DeviceError](), Steps()

    def watch() -> ServoState | None:
        try:
            return setup.cycle.watch()
        except DeviceError as failure:
            failures.append(failure)
            raise

    state = brake(
        setup.devices.servo,
        watch,
        link.clock,
        setup.bench.cycle_ns,
        setup.stop.hurry(),
        steps,
        link.has_watchdog,
    )
    if steps.problems:
        step.measure("errors during the stop", "; ".join(dict.fromkeys(steps.problems)))
    if steps.interrupted:
        raise KeyboardInterrupt
    for defect in steps.unforeseen:
        raise defect
    # The handler of this error takes the power off, after the rest of the ramp or at once.
    setup.stop.raise_if_pressed()
    if state is None or state is ServoState.OPERATION_ENABLED:
        unknown = next(iter(steps.problems), "it sends no state")
        why = unknown if state is None else f"it reports the state {state.value!r}"
        raise WrongError(
            f"the drive does not execute the quick stop: {why}. The power was taken off; check "
            "605Ah and 6085h"
        )
    for failure in failures:
        if not (isinstance(failure, DriveFault) and state is ServoState.FAULT):
            raise failure
    return state


def _fastest_deg_s(setup: Setup) -> float:
    """Return half the speed limit, deg/s, so that a breakaway stays below the limit."""
    return min(0.5 * math.degrees(setup.limits.speed), 0.5 * FASTEST_DEG_S)


def _way(setup: Setup, here: float, size_deg: float) -> float:
    """Return a move of this size towards the middle of the limits, rad."""
    middle = 0.5 * (setup.limits.angle_min + setup.limits.angle_max)
    size = min(math.radians(size_deg), 0.4 * (setup.limits.angle_max - setup.limits.angle_min))
    return size if here <= middle else -size


def _move(
    setup: Setup, step: StepRecord, size_deg: float, speed_deg_s: float, tolerance: float
) -> bool:
    """Move the joint away and back, twice; return False if the joint did not move enough."""
    nominal = setup.devices.nominal
    assert nominal is not None
    setup.cycle.units = witness = MotionWitness(setup.devices.servo, nominal)
    speed = math.radians(min(speed_deg_s, _fastest_deg_s(setup)))
    with explained(setup, witness), setup.power("move") as here:
        end = here + _way(setup, here, size_deg)
        for _ in range(2):
            setup.go(here, end, speed)
            setup.go(end, here, speed)
    proof = witness.prove(tolerance)
    step.measured.clear()
    step.measure("move", size_deg, "deg")
    for name, factor in proof.found.items():
        if not math.isnan(factor):
            step.measure(name, factor)
    if proof.contradictions:
        first = proof.contradictions[0]
        raise WrongError(first.words, first.changes)
    if proof.moved and proof.unproven:
        setup.interview.tell(f"note: {proof.unproven}")
    return proof.moved
