"""The certificate of a run: as a document, and as an HTML page for one sheet."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.numerics.arrays import Progress, plain
from identification.plots.style import BLUE, VERMILION, Figure, figure, thinned
from identification.recording import Dataset
from rig.common.places import usable
from rig.common.provenance import ACCEPTANCE_SCHEMA, FRICTION_FIGURE, heading, sha256_file
from rig.common.provenance import RESULT_FILE as IDENTIFY_FILE
from rig.common.tables import interval, number
from rig.common.text import valid
from rig.config.acceptance import Limit
from rig.results.acceptance.evidence import (
    DIAGNOSIS_FOLDER,
    Check,
    Evidence,
    accepted,
    gather,
    judge,
    weight_verdict,
)
from rig.results.diagnose.diagnose import RESULT_FILE as DIAGNOSIS_FILE
from rig.results.document import (
    Document,
    Note,
    Picture,
    Section,
    SideBySide,
    Table,
    Verdict,
    columns,
    filled,
    write_record,
    write_texts,
)
from rig.results.run.go_on import ACCEPTANCE_FILE, CERTIFICATE_PAGE
from rig.results.run.report import REPORT_FILE, write_verdict
from rig.runs.catalogue.index import ROLES, bench_name
from rig.runs.run_file import seal, seal_run
from rig.runs.run_record import RUN_FILE, Ending, PartRecord, RunRecord

RULE = "A constant passes if its whole 90 % interval is within the limits."


def make_certificate(
    folder: Path,
    bench: str,
    evidence: Evidence,
    checks: Sequence[Check],
    digests: Mapping[str, str],
    made: str,
) -> Document:
    """Return the certificate of a run: verdict and figure, then a section for each table."""
    record = evidence.record
    verdict = _judged(checks, f"{made}. {RULE}")
    picture = _figure(folder, evidence)
    limits = columns(
        checks,
        (),
        ("limit", lambda c: c.limit),
        ("found", lambda c: c.words),
        ("verdict", lambda c: "passed" if c.passed else "FAILED"),
    )
    masses = columns(
        record.stages,
        (1, 2),
        ("stage", lambda s: s.name),
        ("planned kg", lambda s: f"{s.weight_kg:g}"),
        ("confirmed kg", lambda s: number(s.confirmed_kg)),
        ("weight check", lambda s: weight_verdict(evidence.weights, s.name) or "-"),
        ("state", lambda s: s.state),
    )
    constants = columns(
        evidence.constants.items(),
        (1, 2),
        ("constant", lambda c: c[0]),
        ("value", lambda c: number(c[1].value)),
        ("90 % interval", lambda c: interval(c[1].low, c[1].high)),
        ("unit", lambda c: c[1].unit),
    )
    known = record.parts[-1].devices
    devices = columns(
        [(role, known[role]) for role in ROLES if known.get(role)],
        (),
        ("device", lambda d: d[0]),
        ("name", lambda d: str(d[1]["name"])),
        ("serial number", lambda d: str(d[1]["serial_number"])),
        ("revision", lambda d: f"{d[1]['revision']:08X}h"),
        ("software", lambda d: d[1]["software_version"] or "not given"),
    )
    calibrations = columns(
        record.calibrations,
        (),
        ("calibration of", lambda c: str(c["device"])),
        ("certificate", lambda c: str(c["id"])),
        ("due", lambda c: str(c["due"])),
        ("at the run", lambda c: "OVERDUE" if c["overdue"] else "valid"),
    )
    none = Note("The bench file names no calibrations.")
    weighed = Section("Masses", (masses,))
    sections = [Section("Limits", (limits,))]
    if len(record.parts) > 1 or record.parts[0].state != Ending.DONE.value:
        sections.append(Section("Course of the run", (_course(record),)))
    if constants.rows:
        found = Section("Constants", (constants,))
        sections.append(Section("", (SideBySide(found, weighed),)))
    else:
        sections.append(weighed)
    return Document(
        f"Certificate of run {record.name}",
        "",
        (Section("", (verdict, *([picture] if picture else ()))),),
        (
            *sections,
            Section("Devices", (devices,)),
            Section("Calibrations", (calibrations if record.calibrations else none,)),
            Section("Files", (Table(("file", "SHA-256"), tuple(digests.items()), ()),)),
        ),
        (
            ("bench", f"{bench} ({'SIMULATED' if record.simulated else 'REAL BENCH'})"),
            ("sequence", record.name),
            ("begun", f"{_moment(record.created)} UTC"),
            ("operator", record.operators_words),
            ("run folder", folder.resolve().name),
            ("recorded", f"{record.cycles} cycles of {1e3 * record.cycle_s:g} ms"),
            ("ended", record.state),
            ("interruptions", _interruptions(record)),
        ),
    )


def _judged(checks: Sequence[Check], statement: str) -> Verdict:
    if accepted(checks):
        return Verdict("ACCEPTED", statement, "good")
    return Verdict("REJECTED", statement, "open")


def _course(record: RunRecord) -> Table:
    """Return how each recording began and ended; the date of the end only if it is another date."""

    def period(part: PartRecord) -> str:
        begun = _moment(part.created)
        if part.ended is None:
            return f"{begun}, end not recorded"
        date, _, time = _moment(part.ended).partition(" ")
        return f"{begun} to {time if begun.startswith(date) else _moment(part.ended)}"

    return columns(
        record.parts,
        (),
        ("recording", lambda p: "begun" if p is record.parts[0] else "continued"),
        ("time, UTC", period),
        ("operator", lambda p: p.operator or "not given"),
        ("how it ended", lambda p: p.message or p.state),
    )


def _interruptions(record: RunRecord) -> str:
    """Return how often the run was interrupted, and whether it was continued, as text."""
    ends = [part.state for part in record.parts if part.state != Ending.DONE.value]
    if not ends:
        return "none"
    times = len(record.parts) - 1
    words = "not continued" if not times else f"continued {times} time{'s' * (times > 1)}"
    return f"{len(ends)} ({', '.join(ends)}); {words}; see Course of the run"


def _moment(stamp: str) -> str:
    return stamp.replace("T", " ").replace("+00:00", "")


def _figure(folder: Path, evidence: Evidence) -> Picture | None:
    """Return friction against speed if the run was identified, else its traces."""
    if evidence.constants and (folder / FRICTION_FIGURE).is_file():
        caption = "Friction against speed, measured (dots) and identified (black)"
        return Picture("result", caption, (folder / FRICTION_FIGURE).read_bytes())
    if evidence.dataset is None:
        return None
    caption = "Tracking error and current of the excitations"
    return Picture.of("result", caption, _overview(evidence.dataset))


def _overview(dataset: Dataset) -> Figure:
    """Draw tracking error and current of all excitations, one after the other."""
    made, (upper, lower) = figure(2, height=5.0, sharex=True)
    begun = 0.0
    for recording in dataset.recordings:
        few = thinned(len(recording.time))
        time = begun + recording.time[few] - recording.time[0]
        channels = recording.channels
        if "command" in channels and "angle" in channels:
            error = np.rad2deg(channels["command"] - channels["angle"])
            upper.plot(time, error[few], color=BLUE, linewidth=0.8)
        if "current" in channels:
            lower.plot(time, channels["current"][few], color=VERMILION, linewidth=0.8)
        upper.annotate(recording.name, (float(time[0]), 1.0), xycoords=("data", "axes fraction"))
        begun = float(time[-1])
    upper.set_ylabel("tracking error (deg)")
    lower.set_ylabel("motor current (A)")
    lower.set_xlabel("time of the excitations (s)")
    return made


_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow."""


def acceptance_record(
    record: RunRecord, source: str, checks: Sequence[Check], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Return the record of ``rig runs accept --json``."""
    return {
        **heading(ACCEPTANCE_SCHEMA),
        "run": record.name,
        "begun": record.created,
        "verdict": "accepted" if accepted(checks) else "rejected",
        "limits": source,
        "checks": plain(checks),
        "inputs": [{"file": file, "sha256": digest} for file, digest in inputs.items()],
    }


def junit(record: RunRecord, bench: str, checks: Sequence[Check]) -> bytes:
    """Return the checks as JUnit XML in UTF-8: one test suite with one test case for each limit.

    The form is that of https://github.com/testmoapp/junitxml; times are zero, because a check takes
    no measurable time.
    """
    failed = sum(not check.passed for check in checks)
    counts = {
        "tests": str(len(checks)),
        "failures": str(failed),
        "errors": "0",
        "skipped": "0",
        "time": f"{record.seconds:.3f}",
    }
    name = _xml(f"{record.name} on {bench}")
    root = ET.Element("testsuites", {"name": "rig acceptance", **counts})
    stamp = record.created.partition("+")[0]
    suite = ET.SubElement(root, "testsuite", {"name": name, **counts, "timestamp": stamp})
    properties = ET.SubElement(suite, "properties")
    for key, value in {
        "bench": bench,
        "simulated": str(record.simulated).lower(),
        "operator": record.operator or "",
        "begun": record.created,
        "state": record.state,
        **{f"mass of {s.name}, kg": f"{s.mass_kg:g}" for s in record.stages},
        **{f"sha256 of {name}": entry["sha256"] for name, entry in record.inputs.items()},
    }.items():
        ET.SubElement(properties, "property", {"name": key, "value": _xml(value)})
    for check in checks:
        told = {"name": _xml(check.limit), "classname": name, "time": "0.000"}
        case = ET.SubElement(suite, "testcase", told)
        if not check.passed:
            words = _xml(check.words)
            failure = {"message": words, "type": "limit"}
            ET.SubElement(case, "failure", failure).text = f"{_xml(check.limit)}: {words}"
        else:
            ET.SubElement(case, "system-out").text = _xml(check.words)
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _xml(text: str) -> str:
    """Return a text without the characters that XML does not allow."""
    return _NOT_XML.sub("?", valid(text))


@dataclass(frozen=True)
class Acceptance:
    """Result of an acceptance."""

    checks: tuple[Check, ...]
    record: Mapping[str, Any]
    junit: bytes
    folder: Path

    @property
    def accepted(self) -> bool:
        """Whether the run is accepted."""
        return accepted(self.checks)


def accept(folder: Path, limits: Sequence[Limit], source: str, progress: Progress) -> Acceptance:
    """Judge a run, and write result file, certificate and seal into its folder."""
    evidence = gather(folder, limits, progress)
    progress("writing the certificate", 1.0)
    checks = judge(limits, evidence)
    record, bench = evidence.record, bench_name(folder, evidence.record)
    names = [RUN_FILE, IDENTIFY_FILE, f"{DIAGNOSIS_FOLDER}/{DIAGNOSIS_FILE}"]
    used = {n: sha256_file(folder / n) for n in names if (folder / n).is_file()}
    inputs = {**evidence.digests, **used}
    result = acceptance_record(record, source, checks, inputs)
    write_record(result, folder / ACCEPTANCE_FILE, None)
    digests = {**inputs, ACCEPTANCE_FILE: sha256_file(folder / ACCEPTANCE_FILE)}
    made = f"loadrig {result['version']}, {result['created'].replace('+00:00', ' UTC')}"
    certificate = make_certificate(folder, bench, evidence, checks, digests, made)
    write_texts({CERTIFICATE_PAGE: filled("certificate.html.j2", certificate)}, folder)
    seal_run(folder, record)
    seal(folder, [*digests, CERTIFICATE_PAGE])
    with usable(folder / REPORT_FILE, "written"):
        write_verdict(folder, record)
    return Acceptance(checks, result, junit(record, bench, checks), folder)


def acceptance_document(found: Acceptance) -> Document:
    """Return an acceptance as a document; its page is the certificate."""
    limits = columns(
        found.checks,
        (),
        ("limit", lambda c: c.limit),
        ("verdict", lambda c: "passed" if c.passed else "FAILED"),
        ("found", lambda c: c.words),
    )
    count, failed = len(found.checks), sum(not check.passed for check in found.checks)
    statement = f"The run is complete and met all {count - 1} limits."
    if failed:
        statement = f"{failed} of {count} checks failed."
    verdict = _judged(found.checks, statement)
    note = Note(f"certificate: {found.folder / CERTIFICATE_PAGE}")
    return Document("Acceptance", "", (Section("", (limits, verdict, note)),))
