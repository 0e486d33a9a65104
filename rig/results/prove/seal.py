"""Writes the truth of a trial with its digest, and reads the truth with a check of the digest."""

from __future__ import annotations

import json
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.common.errors import InputError
from rig.common.input_files import read_bytes
from rig.common.places import write_text
from rig.common.provenance import sha256
from rig.results.prove.truth import Truth, load_truth

_SALT = 2
"""Separates the draws of salts from those of trials and diagnoses."""


def seal(path: Path, truth: Mapping[str, Any], salt: str) -> str:
    """Write the truth with a salt, so that the truth cannot be guessed from the digest; return the
    SHA-256.
    """
    text = json.dumps({"salt": salt, **truth}, indent=1) + "\n"
    write_text(path, text)
    return sha256(text.encode())


def repeated_salt(seed: int, number: int) -> str:
    """Return a salt that follows from the seed of a proof and the number of a trial, so that the
    digests of a repeated proof are equal.

    The salt, like the draws, hides a truth only from those who do not know the seed.
    """
    state = np.random.SeedSequence([seed, number, _SALT]).generate_state(4)
    return "".join(f"{word:08x}" for word in state)


def random_salt(_number: int = 0) -> str:
    """Return a salt that nobody can repeat, for truths that are sent to others later."""
    return secrets.token_hex(16)


def unseal(path: Path, digest: str) -> Truth:
    """Read a truth, and check it against the digest that was shown.

    Raises:
        InputError: The file is missing, was changed after it was sealed, or is not a truth.
    """
    content = sealed_content(path)
    found = sha256(content)
    if found != digest:
        raise InputError(
            f"{path}: SHA-256 is {found}, was {digest} when sealed; the truth was changed: "
            f"discard this trial"
        )
    return load_truth(path)


def sealed_content(path: Path) -> bytes:
    """Return the content of a sealed truth as bytes, without parsing it.

    Raises:
        InputError: The file is missing or cannot be read.
    """
    try:
        return read_bytes(path)
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: the sealed truth is missing; generate the blind trials again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
