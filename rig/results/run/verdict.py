"""Reads the verdict of a run folder, for the page of the run and for the console.

The libraries of the judgement take half a second to import, so this module reads its result file.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from rig.common.provenance import sha256_file
from rig.runs.run_record import RUN_FILE

ACCEPTANCE_FILE: Final = "acceptance.json"
CERTIFICATE_PAGE, CERTIFICATE_PDF = "certificate.html", "certificate.pdf"
_VERDICTS: Final = frozenset({"accepted", "rejected"})


def read_verdict(folder: Path) -> dict[str, Any] | None:
    """Return the verdict on a run as JSON values.

    Args:
        folder: The run folder.

    Returns:
        ``verdict``, ``accepted`` or ``rejected``; ``checks``, the number of checks; ``failed``, the
        failed checks as text; ``pages``, the certificates. None if the run was not judged, or if
        ``run.json`` was changed after the judgement, for example by ``rig resume``.
    """
    try:
        found = json.loads((folder / ACCEPTANCE_FILE).read_text(encoding="utf-8"))
        digests = {each["file"]: each["sha256"] for each in found["inputs"]}
        if digests[RUN_FILE] != sha256_file(folder / RUN_FILE):
            return None
        if found["verdict"] not in _VERDICTS:
            return None
        return {
            "verdict": found["verdict"],
            "checks": len(found["checks"]),
            "failed": [f"{c['limit']}: {c['words']}" for c in found["checks"] if not c["passed"]],
            "pages": [p for p in (CERTIFICATE_PAGE, CERTIFICATE_PDF) if (folder / p).is_file()],
        }
    except (OSError, ValueError, KeyError, TypeError):
        return None
