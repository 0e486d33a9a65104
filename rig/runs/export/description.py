"""Writes the description of an export: stage, mass, loads and constants of each recording, which
the exported numbers do not contain.

The description is one JSON text per file: inside MATLAB, Parquet and MCAP files, beside a CSV file.
With the description, a campaign can read an export back without stating channels and constants.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from identification.recording import (
    CHANNELS,
    Array,
    Bench,
    Controller,
    Hoist,
    Pendulum,
    Recording,
    RecordingError,
)
from rig.common.errors import InputError

SCHEMA = "loadrig.export/1"
KEY = "loadrig"
"""Name of the description inside a file."""
_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
Read = tuple["Described", Mapping[str, Array]]
"""Result of a reader for each recording: its description and its channels."""


class Described(BaseModel):
    """A recording without its samples; the fields are those of
    :class:`identification.recording.Recording`.

    Attributes:
        samples: Number of samples.
        channels: Names of the channels of this recording; a table may have further channels, which
            belong to other recordings.
    """

    model_config = _STRICT

    name: str
    samples: Annotated[int, Field(ge=2)]
    channels: tuple[str, ...]
    bench: Bench
    stage: Literal["unloaded", "loaded"]
    weight_mass: float
    pendulum: Pendulum | None
    hoist: Hoist | None
    constant_torque: float
    controller: Controller | None
    role: Literal["fit", "validate"]
    averaged: tuple[str, ...]
    partial: bool
    start: float | None
    uncertainties: dict[str, float]

    def recording(
        self, channels: Mapping[str, Array], bench: Bench, source: str, sha256: str
    ) -> Recording:
        """Return the recording.

        Raises:
            RecordingError: Channels and description do not fit together.
        """
        return Recording(
            name=self.name,
            channels=channels,
            bench=bench,
            stage=self.stage,
            weight_mass=self.weight_mass,
            pendulum=self.pendulum,
            hoist=self.hoist,
            constant_torque=self.constant_torque,
            controller=self.controller,
            role=self.role,
            averaged=frozenset(self.averaged),
            source=source,
            sha256=sha256,
            notes=("stage, load and constants are taken from the exported file",),
            partial=self.partial,
            start=self.start,
            uncertainties=self.uncertainties,
        )


class _Description(BaseModel):
    model_config = ConfigDict(extra="forbid")

    schema_: Literal["loadrig.export/1"] = Field(alias="schema")
    recordings: Annotated[tuple[Described, ...], Field(min_length=1)]


def describe(recordings: Sequence[Recording]) -> str:
    """Return the description of an export."""
    return json.dumps({"schema": SCHEMA, "recordings": [_one(r) for r in recordings]}, indent=1)


def _one(recording: Recording) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "samples": len(recording.time),
        "channels": [name for name in CHANNELS if name in recording.channels],
        "averaged": sorted(recording.averaged),
        "uncertainties": dict(recording.uncertainties),
    }
    for name in Described.model_fields:
        if name not in plain:
            value = getattr(recording, name)
            plain[name] = dataclasses.asdict(value) if dataclasses.is_dataclass(value) else value  # type: ignore[arg-type]
    return plain


def parse(text: str | bytes, path: Path) -> tuple[Described, ...]:
    """Read a description.

    Raises:
        InputError: The description was changed, or is of another version.
    """
    try:
        return _Description.model_validate_json(text).recordings
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(
            f"{path}: the description of this export cannot be read ({place}: {first['msg']}); "
            "export the recordings again"
        ) from error


def sidecar(path: Path) -> Path:
    """Return the path of the file beside a CSV file that contains the description."""
    return path.with_name(f"{path.name}.json")


def misfit(path: Path, error: RecordingError | str) -> InputError:
    """Return the error for a file whose numbers contradict its description."""
    return InputError(
        f"{path}: the numbers contradict the description of this export ({error}); export the "
        "recordings again"
    )
