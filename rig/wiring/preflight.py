"""Checks before a run: of the bench file and of the devices.

``rig run``, ``resume`` and ``jog`` refuse to start if a check fails; ``rig check`` and ``rig run
--dry-run`` report failed checks. Checks that need a write to a device are made by the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import date

from drivers.errors import ConfigurationError, DeviceError
from drivers.interfaces import ServoLimits, ServoState
from rig.common.errors import InputError
from rig.common.findings import Cause, Finding, refusals, warnings
from rig.config.bench import Bench
from rig.config.calibration import calibration_records, overdue, overdue_problems
from rig.config.configuration import Document
from rig.config.simulated_loops import unstable_current_loop
from rig.wiring.connect import NO_BUS
from rig.wiring.device_files import device_file_findings
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import require_within_own
from rig.wiring.off import BEFORE_PROMPT, energised_doubt
from rig.wiring.plausibility import implausible

RESET_HINT = "; remove the cause of the fault, then clear the fault with --reset-fault"


def bench_findings(document: Document[Bench], today: date) -> list[Finding]:
    """Return the errors of a bench in its file and in the files that it names.

    Args:
        document: The bench.
        today: Date for the calibration check.
    """
    bench = document.value
    if bench.bus is None:
        return [Finding(Cause.BUS, document.problem(("bus",), NO_BUS), connectable=False)]
    found = device_file_findings(document) + implausible(document)
    if bench.simulated and bench.mock is not None and (text := unstable_current_loop(bench.mock)):
        place = ("mock", "loops", "current_gain_V_A")
        found.append(Finding(Cause.SIMULATION, document.problem(place, text)))
    late = overdue_problems(document, today)
    found += [Finding(Cause.CALIBRATION, text) for text in late]
    if not late:
        records = calibration_records(bench, today)
        found += [Finding(Cause.CALIBRATION, text, refused=False) for text in overdue(records)]
    return found


def require_startable(
    document: Document[Bench], today: date, warn: Callable[[str], object]
) -> None:
    """Refuse a bench with errors in its files, before a connection to a device.

    Args:
        document: The bench.
        today: Date for the calibration check.
        warn: Receives warnings, which do not prevent a run.

    Raises:
        InputError: The bench has errors; the message lists each with its place in the file.
    """
    found = bench_findings(document, today)
    for text in warnings(found):
        warn(f"warning: {text}")
    if problems := refusals(found):
        raise InputError(problems)


def device_findings(
    devices: Devices, wanted: ServoLimits, cycle_s: float, reset_fault: bool = False
) -> Iterator[Finding]:
    """Yield the reasons for which a run with these limits would refuse the devices. Nothing is
    written.

    Args:
        devices: Devices on an opened link, before :meth:`Devices.prepare`.
        wanted: The limits that the run would write into the drive.
        cycle_s: Control cycle, s.
        reset_fault: Whether the run may clear a fault.

    Raises:
        DeviceError: A device does not answer.
    """
    servo = devices.servo
    state = servo.state()
    if state.energised:
        yield Finding(Cause.STATE, f"{BEFORE_PROMPT}: {energised_doubt(state)}")
    elif state is ServoState.FAULT and not reset_fault:
        yield Finding(Cause.STATE, f"{servo.fault()}{RESET_HINT}")
    settings = list(_refused(Cause.DRIVE, servo.refusals(cycle_s)))
    yield from settings
    unread = list(_refused(Cause.ENCODER, devices.encoder.refusals(cycle_s)))
    yield from unread
    if not unread:
        for text in devices.encoder.lacks():
            yield Finding(Cause.ENCODER, text, refused=False)
    if devices.pressure is not None:
        yield from _refused(Cause.PRESSURE, devices.pressure.refusals(cycle_s))
    if settings:
        return  # limits in other units than the drive's cannot be compared
    try:
        unheld = servo.lacks(cycle_s).limits
        steps, places = servo.limit_steps(), servo.limit_places
        require_within_own(wanted, servo.read_limits(), steps, places, unheld)
    except ConfigurationError as refused:
        yield Finding(Cause.LIMITS, str(refused))
    yield from _refused(Cause.LIMITS, servo.limit_refusals(wanted))


def require_ready(
    devices: Devices, wanted: ServoLimits, cycle_s: float, reset_fault: bool = False
) -> list[str]:
    """Before the operator hangs a weight, refuse the devices that the run would refuse later.

    Args:
        devices: See :func:`device_findings`.
        wanted: See :func:`device_findings`.
        cycle_s: See :func:`device_findings`.
        reset_fault: See :func:`device_findings`.

    Returns:
        Warnings for the operator.

    Raises:
        ConfigurationError: The run would refuse devices; the message lists every reason.
        DeviceError: A device does not answer.
    """
    found = list(device_findings(devices, wanted, cycle_s, reset_fault))
    if problems := refusals(found):
        raise ConfigurationError("; ".join(problems))
    return warnings(found)


def _refused(cause: Cause, errors: Iterable[DeviceError]) -> Iterator[Finding]:
    return (Finding(cause, str(error)) for error in errors)
