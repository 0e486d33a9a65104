"""Jogging: moves of the joint under low limits, with the drive off before and after all."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import DeviceError
from drivers.interfaces import RawFrame, ServoLimits, ServoState
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import Bench
from rig.config.sequence import approach
from rig.control.cycle import Cycle, Progress, TripError
from rig.control.sequencer import Outcome
from rig.planning.limits import Limits
from rig.planning.plan import bench_limits, servo_limits
from rig.runs.run_record import Ending
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import only_here, require_within_own, require_written
from rig.wiring.off import OffProof, words_of
from rig.wiring.teardown import attempt_all, give_back, make_safe

SPEED_MARGIN = 2.0
"""Ratio of the speed limit to the requested speed; the margin is for the breakaway."""
LEAST_LIMIT_DEG_S = 10.0
"""Least speed limit of a jog, deg/s: a joint that breaks away is faster than a slow command."""
TORQUE_SHARE = 0.6  # limits of torque and current in a jog, as a share of the bench's limits
GREATEST_SPEED_SHARE = 0.25
"""Highest permitted speed of a jog, as a share of the bench's speed limit."""
REST_S = 0.2


@dataclass(frozen=True)
class Jog:
    """The moves of a jog, in order."""

    angles: tuple[float, ...]
    speed: float
    limits: Limits


def plan_jog(bench: Bench, angles_deg: tuple[float, ...], speed_deg_s: float) -> Jog:
    """Check the requested moves against the bench; the InputError lists every value beyond."""
    limits, section = bench_limits(bench), bench.limits
    greatest = GREATEST_SPEED_SHARE * section.speed_deg_s
    problems = [
        f"--to {angle:g}: outside the bench's range {section.angle_min_deg:g} to "
        f"{section.angle_max_deg:g} deg"
        for angle in angles_deg
        if not section.angle_min_deg <= angle <= section.angle_max_deg
    ]
    if not 0.0 < speed_deg_s <= greatest:
        problems.append(
            f"--speed {speed_deg_s:g}: must be above 0 and at most {greatest:g} deg/s on this bench"
        )
    if problems:
        raise InputError(problems)
    speed = math.radians(speed_deg_s)
    low = dataclasses.replace(
        limits,
        speed=min(limits.speed, max(SPEED_MARGIN * speed, math.radians(LEAST_LIMIT_DEG_S))),
        torque=TORQUE_SHARE * limits.torque,
        current=TORQUE_SHARE * limits.current,
    )
    return Jog(tuple(math.radians(angle) for angle in angles_deg), speed, low)


def held_only_here(jog: Jog, bench: Bench, devices: Devices) -> str | None:
    """Return a text on the limits of the jog that only this program checks, or None."""
    servo = devices.servo
    return only_here(servo, servo_limits(jog.limits, bench), servo.read_limits())


class _Discard:
    def sample(self, time_ns: int, sample: Sample, frames: list[RawFrame]) -> None:
        """Discard the sample."""


def move(
    jog: Jog,
    bench: Bench,
    devices: Devices,
    stop: StopButton,
    progress: Progress,
    tell: Callable[[str, bool], None],
    reset_fault: bool = False,
) -> Outcome:
    """Make the moves and de-energise the drive in every case; the function raises no error.

    The limits are written into the drive before each enabling, and the drive's own limits are
    restored at the end. A drive fault is cleared if ``reset_fault`` is true. ``tell`` is called at
    the end with a text on the outcome and with whether the outcome is good; an unexpected exception
    becomes the ``error`` of the outcome.
    """
    cycle = Cycle(jog.limits, bench.cycle_ns, devices, _Discard(), stop, progress)
    servo = devices.servo
    own: list[ServoLimits] = []
    off = devices.off_proof(bench_limits(bench))
    ending, words, error = _moves(jog, bench, devices, cycle, stop, reset_fault, own, off)
    safe = make_safe(
        servo,
        cycle.watch,
        devices.link.clock,
        bench.cycle_ns,
        brake=ending is not Ending.DONE,
        hurry=stop.hurry(),
        watched=devices.link.has_watchdog,
        insistent=not devices.link.has_watchdog,
        off=off,
        insist=devices.insist,
    )
    if ending is Ending.DONE and not safe.verified:
        ending = Ending.FAILED
    words = f"{words}; {safe.message}"
    unforeseen = [
        *safe.unforeseen,
        *attempt_all(lambda: tell(f"{ending.value}: {words}", ending is Ending.DONE)),
    ]
    if own:
        unforeseen += give_back(servo, own[0], safe)
    if unforeseen:
        ending, error = Ending.CRASHED, error or unforeseen[0]
    return Outcome(ending, words, safe, error=error)


def _moves(
    jog: Jog,
    bench: Bench,
    devices: Devices,
    cycle: Cycle,
    stop: StopButton,
    reset_fault: bool,
    own: list[ServoLimits],
    off: OffProof,
) -> tuple[Ending, str, BaseException | None]:
    """Make the moves; return how they ended; ``own`` receives the drive's limits."""
    servo, wanted = devices.servo, servo_limits(jog.limits, bench)
    try:
        stop.check()
        if reset_fault and servo.state() is ServoState.FAULT:
            servo.reset_fault()
        off.require("before the jog")
        devices.prepare(bench.cycle_s)
        held, unheld = servo.read_limits(), servo.lacks(bench.cycle_s).limits
        require_within_own(wanted, held, servo.limit_steps(), servo.limit_places, unheld)
        own.append(held)
        servo.write_limits(wanted)
        require_written(servo, wanted, bench.cycle_s)
        servo.enable()
        here = servo.sample().motor_angle_rad / bench.machine.gear_ratio
        cycle.ask_reset()
        cycle.begin(here)
        for angle in jog.angles:
            course = approach(here, angle, jog.speed, bench.cycle_s).tolist()
            cycle.follow(course, 0, f"to {math.degrees(angle):g} deg")
            cycle.follow([angle] * round(REST_S / bench.cycle_s), 0, "rest")
            here = angle
        servo.disable()
    except TripError as trip:
        return Ending.TRIPPED, str(trip), None
    except (OperatorStopError, KeyboardInterrupt):
        return Ending.STOPPED, stop.words, None
    except DeviceError as failure:
        return Ending.FAILED, str(failure), None
    except BaseException as defect:  # noqa: BLE001 - raised again after the drive is made safe
        return Ending.CRASHED, f"the program failed ({words_of(defect)})", defect
    return Ending.DONE, f"{len(jog.angles)} moves done", None
