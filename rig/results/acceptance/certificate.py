"""Collects the content of the certificate of a run as text; the certificate is then written as HTML
and as PDF.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from rig.common.tables import interval, number
from rig.results.acceptance.evidence import Check, Evidence, accepted
from rig.results.acceptance.figure import overview
from rig.results.document import Picture, Table
from rig.runs.run_record import Ending, RunRecord

FRICTION_FIGURE = "figures/stribeck_default.png"
"""Name of the figure that shows the result of an identified run."""
_ROLES = ("servo", "encoder", "pressure")


@dataclass(frozen=True)
class Certificate:
    """Content of one certificate page.

    Attributes:
        title: Heading.
        accepted: Whether the run is accepted.
        facts: Name and value of each fact on run, bench, time and operator.
        checks: Limits, found values and verdicts.
        course: Recordings of a run that was interrupted, with its stops and continuations; None
            for a run without an interruption.
        constants: Identified constants, or None if no limit is on a constant.
        masses: Stages with their masses.
        devices: Identities of the devices.
        calibrations: Calibrations and due dates, or None if the bench file names none.
        digests: Files and their SHA-256.
        figure: Figure that shows the result.
        made: Program and time.
    """

    title: str
    accepted: bool
    facts: tuple[tuple[str, str], ...]
    checks: Table
    course: Table | None
    constants: Table | None
    masses: Table
    devices: Table
    calibrations: Table | None
    digests: Table
    figure: Picture | None
    made: str

    @property
    def headline(self) -> str:
        """The verdict as one word."""
        return "ACCEPTED" if self.accepted else "REJECTED"


def make_certificate(
    folder: Path,
    bench: str,
    evidence: Evidence,
    checks: Sequence[Check],
    digests: Mapping[str, str],
    made: str,
) -> Certificate:
    """Return the certificate of a run.

    Args:
        folder: The run folder.
        bench: Name of the bench.
        evidence: Values of the run that the limits apply to.
        checks: Verdicts on the limits of the run.
        digests: SHA-256 of the files of the run folder, by file name.
        made: Program and time.
    """
    record = evidence.record
    return Certificate(
        f"Certificate of run {record.name}",
        accepted(checks),
        tuple(_facts(folder, bench, record)),
        Table(
            ("limit", "found", "verdict"),
            tuple((c.limit, c.words, "passed" if c.passed else "FAILED") for c in checks),
            (),
        ),
        _course(record),
        _constants(evidence),
        _masses(evidence),
        _devices(record),
        _calibrations(record),
        Table(("file", "SHA-256"), tuple(digests.items()), ()),
        _figure(folder, evidence),
        made,
    )


def _facts(folder: Path, bench: str, record: RunRecord) -> Iterator[tuple[str, str]]:
    operators = [part.operator for part in record.parts if part.operator]
    yield "bench", f"{bench} ({'SIMULATED' if record.simulated else 'REAL BENCH'})"
    yield "sequence", record.name
    yield "begun", f"{_moment(record.created)} UTC"
    yield "operator", ", ".join(dict.fromkeys(operators)) or record.operator or "not given"
    yield "run folder", folder.resolve().name
    yield "recorded", f"{record.cycles} cycles of {1e3 * record.cycle_s:g} ms"
    yield "ended", record.state
    yield "interruptions", _interruptions(record)


def _moment(stamp: str) -> str:
    return stamp.replace("T", " ").replace("+00:00", "")


def _period(begun: str, ended: str | None) -> str:
    """Return start and end of a recording; the date of the end only if it is another date."""
    if ended is None:
        return f"{_moment(begun)}, end not recorded"
    date, _, time = _moment(ended).partition(" ")
    return f"{_moment(begun)} to {time if begun.startswith(date) else _moment(ended)}"


def _interruptions(record: RunRecord) -> str:
    """Return how often the run was interrupted, and whether it was continued, as text."""
    ends = [part.state for part in record.parts if part.state != Ending.DONE.value]
    if not ends:
        return "none"
    times = len(record.parts) - 1
    continued = (
        f"continued {times} {'time' if times == 1 else 'times'}" if times else "not continued"
    )
    return f"{len(ends)} ({', '.join(ends)}); {continued}; see Course of the run"


def _course(record: RunRecord) -> Table | None:
    """Return when each recording began and ended, and how; None for a run without an
    interruption.
    """
    if len(record.parts) == 1 and record.parts[0].state == Ending.DONE.value:
        return None
    rows = tuple(
        (
            "continued" if number else "begun",
            _period(part.created, part.ended),
            part.operator or "not given",
            part.message or part.state,
        )
        for number, part in enumerate(record.parts)
    )
    return Table(("recording", "time, UTC", "operator", "how it ended"), rows, ())


def _constants(evidence: Evidence) -> Table | None:
    if not evidence.constants:
        return None
    rows = tuple(
        (name, number(each.value), interval(each.low, each.high), each.unit)
        for name, each in evidence.constants.items()
    )
    return Table(("constant", "value", "90 % interval", "unit"), rows, (1, 2))


def _masses(evidence: Evidence) -> Table:
    rows = tuple(
        (
            s.name,
            f"{s.weight_kg:g}",
            number(s.confirmed_kg),
            evidence.weights.get(s.name, ("-", ""))[0],
            s.state,
        )
        for s in evidence.record.stages
    )
    return Table(("stage", "planned kg", "confirmed kg", "weight check", "state"), rows, (1, 2))


def _devices(record: RunRecord) -> Table:
    known = record.parts[-1].devices
    rows = tuple(
        (
            role,
            str(known[role]["name"]),
            str(known[role]["serial_number"]),
            f"{known[role]['revision']:08X}h",
            known[role]["software_version"] or "not given",
        )
        for role in _ROLES
        if known.get(role)
    )
    return Table(("device", "name", "serial number", "revision", "software"), rows, ())


def _calibrations(record: RunRecord) -> Table | None:
    if not record.calibrations:
        return None
    rows = tuple(
        (str(c["device"]), str(c["id"]), str(c["due"]), "OVERDUE" if c["overdue"] else "valid")
        for c in record.calibrations
    )
    return Table(("calibration of", "certificate", "due", "at the run"), rows, ())


def _figure(folder: Path, evidence: Evidence) -> Picture | None:
    """Return the figure of friction against speed if the run was identified, else the traces of the
    run.
    """
    if evidence.constants:
        try:
            data = (folder / FRICTION_FIGURE).read_bytes()
        except OSError:
            data = b""
        if data:
            caption = "Friction against speed, measured (dots) and identified (black)"
            return Picture("result", caption, data)
    if evidence.dataset is None:
        return None
    caption = "Tracking error and current of the excitations"
    return Picture.of("result", caption, overview(evidence.dataset))


def certificate_html(certificate: Certificate) -> str:
    """Return the certificate as one self-contained HTML page; all text is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("certificate.html.j2").render(it=certificate)
