"""Collects the provenance of a result: digests, versions, commit."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path

from drivers.plain_file import require_plain


def sha256(content: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal.

    Raises:
        OSError: The file cannot be read.
    """
    require_plain(path)
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def utc_now() -> datetime:
    """Return the date and time in UTC, which are used for labels only and never for timing."""
    return datetime.now(UTC)


def versions() -> dict[str, str]:
    """Return the versions of this program and its dependencies, and the commit of a work tree."""
    found = dict(_installed())
    commit = git_commit(Path(__file__).parents[2])
    if commit:
        found["commit"] = commit
    return found


@cache
def _installed() -> Mapping[str, str]:
    names = ("loadrig", "numpy", "canopen", "python-can", "mcap")
    return {name: version(name) for name in names} | {"python": platform.python_version()}


def git_commit(root: Path) -> str | None:
    """Return the commit that is checked out at ``root``, or None if ``root`` is no plain git work
    tree.
    """
    head = _text(root / ".git" / "HEAD")
    if head is None or not head.startswith("ref: "):
        return head
    ref = head.removeprefix("ref: ")
    loose = _text(root / ".git" / ref)
    if loose is not None:
        return loose
    packed = _text(root / ".git" / "packed-refs") or ""
    return next((line.split()[0] for line in packed.splitlines() if line.endswith(f" {ref}")), None)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        # ``root`` is not a work tree, or is one of another project.
        return None
