"""Writing of a trial's truth with its digest, and reading of it with a check of the digest."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.input_files import parse_json, read_bytes
from rig.common.places import write_text
from rig.common.provenance import sha256


def seal(path: Path, truth: Mapping[str, Any], salt: str) -> str:
    """Write the truth with a salt, which keeps it from being guessed from the digest; return the
    SHA-256.
    """
    text = json.dumps({"salt": salt, **truth}, indent=1) + "\n"
    write_text(path, text)
    return sha256(text.encode())


def unseal(path: Path, digest: str) -> dict[str, Any]:
    """Read a truth back and check it against the digest that was shown.

    Raises:
        InputError: It is missing, or no longer what was sealed.
    """
    try:
        content = read_bytes(path)
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: the sealed truth is missing; generate the blind trials again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    found = sha256(content)
    if found != digest:
        raise InputError(
            f"{path}: SHA-256 is {found}, was {digest} when sealed; the truth was changed: "
            f"discard this trial"
        )
    truth = parse_json(path, content.decode("utf-8", "replace"))
    if not isinstance(truth, dict):
        raise InputError(
            f"{path}: no sealed truth: a mapping is needed (got {type(truth).__name__})"
        )
    return truth
