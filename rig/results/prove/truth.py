"""The sealed truth of one rig: names and values of the injected effects."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from drivers.mock.plant.effects.gas import GAS_CATALOGUE
from drivers.mock.plant.effects.table import CATALOGUE
from identification.effects import EFFECTS
from rig.common.errors import InputError
from rig.common.places import read_bytes, write_text
from rig.common.provenance import sha256
from rig.config.configuration import Document, Loc, Schema, load_located
from rig.results.prove.draw import Kind

INJECTED: Mapping[str, Mapping[str, object]] = {**CATALOGUE, **GAS_CATALOGUE}
"""Parameters that a simulated machine accepts, by effect; a diagnosis estimates some of them."""
Axis = bool | float | str | None


class Truth(Schema):
    """The truth of one rig, in YAML or JSON.

    Attributes:
        truth: Version of the file format.
        effects: Parameters of each injected effect, with names, units and signs of the catalogue
            (`rig effects`). `recording` counts the files of the campaign from 1. An unknown
            parameter is left out; `{}` states no parameter.
        outside: Names among `effects` that the catalogue does not have.
        parameters: True nominal parameters, by the names of `rig identify`; a parameter that is
            not given is not scored.
        not_scored: Names whose values are not scored, for example because this simulator has
            another formula: a nominal parameter, or `effect.parameter`. The name of an effect
            alone, injected or not, excludes the effect from the score: neither a diagnosis that
            names the effect nor a diagnosis that does not name it counts as an error. A rig whose
            injected effects are all excluded takes no part in the rates.
        axes: Value of the rig on each axis of the worlds, such as rates, encoders, excitation,
            loads. The results are listed by these values.
        strength: For each channel, the rms change by the effects over the noise of the channel.
        floor: For each equation, the residual of the nominal model on this rig without its
            effects; if there is a `.reference` campaign, the residual is computed from that
            campaign instead.
        maker: Further content of any form, which the author of the rig adds.
        rig: Number or name of the rig, for the reader; the program uses the name of the file.
        salt: Random text, so that the digest cannot be guessed.
    """

    truth: Literal[1]
    effects: dict[str, dict[str, float]] = Field(default_factory=dict)
    outside: tuple[str, ...] = ()
    parameters: dict[str, float] = Field(default_factory=dict)
    not_scored: tuple[str, ...] = ()
    axes: dict[str, Axis] = Field(default_factory=dict)
    strength: dict[str, float] = Field(default_factory=dict)
    floor: dict[str, float] = Field(default_factory=dict)
    maker: dict[str, object] = Field(default_factory=dict)
    rig: int | str = ""
    salt: str = ""

    @property
    def scored(self) -> dict[str, dict[str, float]]:
        """Return the effects that are scored, with the parameters that are scored."""
        return {
            name: {
                key: value for key, value in given.items() if f"{name}.{key}" not in self.not_scored
            }
            for name, given in self.effects.items()
            if name not in self.not_scored
        }

    @property
    def kind(self) -> Kind:
        """Return the kind by the scored effects; ``unscored`` if there are others only."""
        if self.effects and not self.scored:
            return "unscored"
        if any(name in self.outside for name in self.scored):
            return "outside"
        kinds: tuple[Kind, ...] = ("nothing", "one", "two")
        return kinds[min(len(self.scored), 2)]

    @property
    def excused(self) -> tuple[str, ...]:
        """Return the effects that are not scored at all."""
        return tuple(n for n in self.not_scored if n in EFFECTS or n in self.effects)

    def record(self, rig: int | str) -> dict[str, Any]:
        """Return the truth in the form that the rows of the proof use."""
        constants = {k: v for k, v in self.parameters.items() if k not in self.not_scored}
        return {"rig": rig, "kind": self.kind, "effects": self.scored, "parameters": constants}


def load_truth(path: Path) -> Truth:
    """Read a truth."""
    document = load_located(path, Truth)
    document.require(_cross_check(document))
    return document.value


def _cross_check(document: Document[Truth]) -> Iterator[tuple[Loc, str]]:
    truth = document.value
    for name, given in truth.effects.items():
        if name in truth.outside:
            continue
        if name not in EFFECTS:
            yield (
                ("effects", name),
                "not an effect of the catalogue (see `rig effects`); list an effect outside the "
                "catalogue under outside as well",
            )
            continue
        known = {p.name for p in EFFECTS[name].parameters} | INJECTED.get(name, {}).keys()
        for key in given.keys() - known:
            yield (
                ("effects", name, key),
                f"no parameter of {name}, which has {', '.join(sorted(known))}",
            )
    for k, name in enumerate(truth.outside):
        if name not in truth.effects:
            yield (("outside", k), "not among effects; add the name to effects, with {} if need be")
        elif name in EFFECTS:
            yield (("outside", k), "is an effect of the catalogue; remove it from this list")
    for k, name in enumerate(truth.not_scored):
        effect, _, key = name.partition(".")
        listed = effect in truth.effects or (not key and effect in {*truth.parameters, *EFFECTS})
        if not listed:
            yield (
                ("not_scored", k),
                "unknown name; state a nominal parameter, an effect, or EFFECT.PARAMETER of an "
                "effect of this rig",
            )


CAMPAIGN_FILE = "campaign.yaml"
SEALED = "sealed"  # folder of the truths


class Sealed(NamedTuple):
    """Files of one rig whose truth is sealed; the campaign exists once the rig is simulated."""

    name: str
    campaign: Path
    truth: Path
    digest: str = ""  # SHA-256 of the truth's file

    @property
    def reference(self) -> Path:
        """Campaign file of the rig without its effects; this file need not exist."""
        return self.truth.parent / f"{self.name}.reference" / CAMPAIGN_FILE


def place(home: Path, name: str) -> Sealed:
    """Return the files of the rig with this name in a folder of sealed rigs."""
    return Sealed(name, home / name / CAMPAIGN_FILE, home / SEALED / f"{name}.json")


def seal_truth(where: Sealed, rig: int | str, truth: Mapping[str, Any], salt: str) -> Sealed:
    """Write and seal the truth of one rig, with a salt, so that it cannot be guessed; return the
    rig with its digest.
    """
    where.truth.parent.mkdir(parents=True, exist_ok=True)
    outside = [name for name in truth["effects"] if name not in EFFECTS]
    content = {"salt": salt, "truth": 1, "rig": rig, "outside": outside, **truth}
    text = json.dumps(content, indent=1) + "\n"
    write_text(where.truth, text)
    return where._replace(digest=sha256(text.encode()))


_SALT = 2  # separates the draws of salts from those of trials and diagnoses


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
    """Read a truth, and check it against the digest that was shown."""
    try:
        found = sha256(read_bytes(path))
    except FileNotFoundError as error:
        raise InputError(
            f"{path}: the sealed truth is missing; generate the blind trials again"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if found != digest:
        raise InputError(
            f"{path}: SHA-256 is {found}, was {digest} when sealed; the truth was changed: "
            f"discard this trial"
        )
    return load_truth(path)
