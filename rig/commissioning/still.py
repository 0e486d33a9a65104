"""Steps without motion and without power: identity, readings, zero, limits."""

from __future__ import annotations

import math
from typing import Final

from drivers.errors import DeviceError
from rig.commissioning.record import StepRecord, WrongError
from rig.commissioning.setup import Setup
from rig.common.errors import Cause
from rig.control.motion_proof import Change
from rig.control.readings import reading_findings, take_readings
from rig.wiring.devices import watcher
from rig.wiring.drive_limits import compare, show
from rig.wiring.preflight import device_findings
from rig.wiring.teardown import observed

ZERO_TOLERANCE_DEG: Final = 0.1
"""Greatest difference, deg, of a reading from the true angle that needs no correction."""


def identity(setup: Setup, step: StepRecord) -> None:
    """Compare the identities of the devices with their EDS files; WrongError if one differs."""
    devices = setup.devices
    found = {"drive": devices.servo.identity(), "joint encoder": devices.encoder.identity()}
    for role, who in found.items():
        words = f"{who.name or 'no name'}, vendor {who.vendor_id:X}h, product {who.product_code:X}h"
        step.measure(role, f"{words}, serial number {who.serial_number}")
    problems = [*devices.servo.identity_problems(), *devices.encoder.identity_problems()]
    if problems:
        raise WrongError("; ".join(map(str, problems)))
    for item in step.measured:
        setup.interview.tell(f"  {item.name}: {item.value}")
    if not setup.interview.agrees("Are these the devices of this bench?"):
        raise WrongError(
            "these are not the devices of this bench: correct node numbers, channel and EDS files"
        )
    step.words = "the devices are those of the bench file"


def readings(setup: Setup, step: StepRecord) -> None:
    """Read values, state and settings; raise a WrongError if a run would refuse them."""
    devices, bench = setup.devices, setup.bench
    taken = take_readings(devices, bench.machine.gear_ratio)
    for name, value, unit in taken.rows():
        step.measure(name, value, unit)
    step.measure("state of the drive", taken.state)
    step.measure("watched by", watcher(devices).words)
    proof = setup.off.prove()
    if not proof.off:
        setup.safe = observed(proof)
        raise WrongError(setup.safe.message)
    found = list(device_findings(devices, setup.wanted, bench.cycle_s))
    # The next step checks the angles.
    found += [
        item
        for item in reading_findings(taken, setup.limits)
        if "joint angle" not in item.text and "encoder against drive" not in item.text
    ]
    noted = [item.text for item in found if not item.refused and item.cause is Cause.ENCODER]
    for words in (*devices.servo.lacks(bench.cycle_s).words, *noted):
        setup.interview.tell(f"note: {words}")
    problems = [item.text for item in found if item.refused]
    if problems:
        raise WrongError("; ".join(problems))
    step.words = "state, settings and readings allow a run to start"


def zero(setup: Setup, step: StepRecord) -> None:
    """Compare the angles of drive and joint encoder with the true angle, or with each other if the
    true angle is unknown.

    Raises:
        WrongError: The angles differ; the error states the offsets to be set if the true angle is
            known.
    """
    bench = setup.bench
    offer, home = setup.homing_offer, setup.home
    if home is None:
        then = "--home METHOD starts a homing" if offer.methods else "the zero is typed in"
        setup.interview.tell(f"  note: {offer.words}; {then}")
    elif why := offer.problem(home.method):
        setup.interview.tell(f"  note: {why}; the zero is typed in instead")
    taken = take_readings(setup.devices, bench.machine.gear_ratio)
    both = (
        ("servo", "drive", math.degrees(taken.motor_encoder_at_joint_rad)),
        ("encoder", "joint encoder", math.degrees(taken.joint_encoder_rad)),
    )
    for _, name, reading in both:
        step.measure(f"angle by the {name}", reading, "deg")
    later = " (the drive's zero is set by homing, after the limits)" if setup.homes_in_place else ""
    true = setup.true_deg = setup.interview.angle_deg(
        "True joint angle now, by protractor or stop, deg"
    )
    if true is None:
        difference = abs(both[0][2] - both[1][2])
        limit = bench.limits.encoder_disagreement_deg
        if not difference <= limit and not later:
            raise WrongError(
                f"drive and joint encoder differ by {difference:.4g} deg, limit {limit:g} deg: "
                "state the true angle with --angle; the offsets are then computed"
            )
        step.words = f"the true angle was not given: the zero is not checked{later}"
        return
    step.measure("true angle", true, "deg")
    if not bench.limits.angle_min_deg <= true <= bench.limits.angle_max_deg:
        raise WrongError(
            f"the joint is at {true:g} deg, outside the limits {bench.limits.angle_min_deg:g} to "
            f"{bench.limits.angle_max_deg:g} deg: turn the joint by hand"
        )
    changes = []
    for section, _, reading in both[1:] if later else both:
        offset = getattr(getattr(bench, section), "offset_deg", 0.0)
        if math.isnan(reading):
            raise WrongError(f"the angle of {section} could not be read: check its connection")
        if abs(true - reading) > ZERO_TOLERANCE_DEG:
            wanted = float(f"{offset + true - reading:.4f}")
            changes.append(Change(section, "offset_deg", wanted))
    if changes:
        raise WrongError(
            f"the zero is wrong: set {' and '.join(map(str, changes))}", tuple(changes)
        )
    which = "the joint encoder is" if later else "both angles are"
    step.words = f"{which} within {ZERO_TOLERANCE_DEG:g} deg of the true angle{later}"


def limits(setup: Setup, step: StepRecord) -> None:
    """Write the low limits into the drive and read them back; WrongError if it rejects one."""
    servo = setup.devices.servo
    try:
        setup.prepare()
    except DeviceError as refused:
        raise WrongError(f"the limits cannot be set: {refused}") from refused
    held, lacks = servo.read_limits(), servo.lacks(setup.bench.cycle_s)
    for row in compare(held, setup.wanted, servo.limit_steps(), servo.limit_places):
        if row.field not in lacks.limits:
            shown, _, unit = show(row.field, row.first).partition(" ")
            step.measure(f"{row.name}, {row.objects}", shown, unit)
    only = sorted(lacks.limits)
    step.words = "the limits in the drive are those that were written" + (
        f"; checked by this program only: {', '.join(only)}" if only else ""
    )
