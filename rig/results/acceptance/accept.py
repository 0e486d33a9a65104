"""Accepts or rejects a finished run, and writes result file, certificate and seal into the run
folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.places import replacing
from rig.common.provenance import RESULT_FILE as IDENTIFY_FILE
from rig.common.provenance import sha256_file
from rig.config.acceptance import Limit
from rig.results.acceptance.certificate import certificate_html, make_certificate
from rig.results.acceptance.evidence import (
    DIAGNOSIS_FOLDER,
    Check,
    Progress,
    accepted,
    gather,
    judge,
)
from rig.results.acceptance.pdf import certificate_pdf
from rig.results.acceptance.record import RESULT_FILE, acceptance_record, junit
from rig.results.diagnose.diagnose import RESULT_FILE as DIAGNOSIS_FILE
from rig.results.document import Document, Note, Section, Table, Verdict, write_record, write_texts
from rig.results.run.go_on import CERTIFICATE_PAGE, CERTIFICATE_PDF
from rig.results.run.report import REPORT_FILE, write_verdict
from rig.runs.catalogue.index import bench_name
from rig.runs.run_file import seal, seal_run
from rig.runs.run_record import RUN_FILE


@dataclass(frozen=True)
class Acceptance:
    """Result of an acceptance.

    Attributes:
        checks: The limits, judged.
        record: The result file.
        junit: The checks as JUnit XML.
        folder: The run folder.
    """

    checks: tuple[Check, ...]
    record: Mapping[str, Any]
    junit: bytes
    folder: Path

    @property
    def accepted(self) -> bool:
        """Whether the run is accepted."""
        return accepted(self.checks)


def accept(folder: Path, limits: Sequence[Limit], source: str, progress: Progress) -> Acceptance:
    """Judge a run, and write result file, certificate and seal into its folder.

    Args:
        folder: The run folder.
        limits: The acceptance limits of the run.
        source: Origin of the limits.
        progress: Called with the current step and the completed share.

    Raises:
        InputError: The folder is not a run folder, or cannot be written.
    """
    evidence = gather(folder, limits, progress)
    progress("writing the certificate", 1.0)
    checks = judge(limits, evidence)
    record, bench = evidence.record, bench_name(folder, evidence.record)
    names = [RUN_FILE, IDENTIFY_FILE, f"{DIAGNOSIS_FOLDER}/{DIAGNOSIS_FILE}"]
    used = {n: sha256_file(folder / n) for n in names if (folder / n).is_file()}
    inputs = {**evidence.digests, **used}
    result = acceptance_record(record, source, checks, inputs)
    write_record(result, folder / RESULT_FILE, None)
    digests = {**inputs, RESULT_FILE: sha256_file(folder / RESULT_FILE)}
    made = f"loadrig {result['version']}, {result['created'].replace('+00:00', ' UTC')}"
    certificate = make_certificate(folder, bench, evidence, checks, digests, made)
    write_texts({CERTIFICATE_PAGE: certificate_html(certificate)}, folder)
    write_bytes(folder / CERTIFICATE_PDF, certificate_pdf(certificate))
    seal_run(folder, record)
    seal(folder, [*digests, CERTIFICATE_PAGE, CERTIFICATE_PDF])
    try:
        write_verdict(folder, record)
    except OSError as error:
        raise InputError(f"{folder / REPORT_FILE}: cannot be written: {error.strerror}") from error
    return Acceptance(checks, result, junit(record, bench, checks), folder)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file in one step.

    Raises:
        InputError: The file cannot be written; an earlier version is kept.
    """
    try:
        with replacing(path) as draft:
            draft.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def acceptance_document(found: Acceptance) -> Document:
    """Return an acceptance as a document; its page is the certificate."""
    rows = tuple((c.limit, "passed" if c.passed else "FAILED", c.words) for c in found.checks)
    failed = sum(not check.passed for check in found.checks)
    headline = "ACCEPTED" if found.accepted else "REJECTED"
    statement = (
        f"{failed} of {len(rows)} checks failed."
        if failed
        else f"The run passed all {len(rows)} checks."
    )
    blocks = (
        Table(("limit", "verdict", "found"), rows, ()),
        Verdict(headline, statement, "good" if found.accepted else "open"),
        Note(f"certificate: {found.folder / CERTIFICATE_PAGE}, {CERTIFICATE_PDF}"),
    )
    return Document("Acceptance", "", (Section("", blocks),))
