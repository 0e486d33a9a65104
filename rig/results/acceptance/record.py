"""Writes an acceptance as JSON and as JUnit XML."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from typing import Any

from rig.common.provenance import utc_now, versions
from rig.common.text import valid
from rig.results.acceptance.evidence import Check, accepted
from rig.runs.run_record import RunRecord

ACCEPTANCE_SCHEMA = "loadrig.acceptance/1"
RESULT_FILE = "acceptance.json"
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 does not allow."""


def acceptance_record(
    record: RunRecord, source: str, checks: Sequence[Check], inputs: Mapping[str, str]
) -> dict[str, Any]:
    """Return the record of ``rig runs accept --json``.

    Args:
        record: The run.
        source: Origin of the limits.
        checks: The limits, and whether the run met them.
        inputs: SHA-256 of the files of the run folder, by file name.
    """
    known = versions()
    return {
        "schema": ACCEPTANCE_SCHEMA,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
        "run": record.name,
        "begun": record.created,
        "verdict": "accepted" if accepted(checks) else "rejected",
        "limits": source,
        "checks": [_check_record(check) for check in checks],
        "inputs": [{"file": file, "sha256": digest} for file, digest in inputs.items()],
    }


def _check_record(check: Check) -> dict[str, Any]:
    return {
        "limit": check.limit,
        "passed": check.passed,
        "words": check.words,
        "value": check.value,
        "low": check.low,
        "high": check.high,
        "unit": check.unit,
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
    for key, value in _properties(record, bench).items():
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


def _properties(record: RunRecord, bench: str) -> dict[str, str]:
    return {
        "bench": bench,
        "simulated": str(record.simulated).lower(),
        "operator": record.operator or "",
        "begun": record.created,
        "state": record.state,
        **{f"mass of {s.name}, kg": f"{s.mass_kg:g}" for s in record.stages},
        **{f"sha256 of {name}": entry["sha256"] for name, entry in record.inputs.items()},
    }
