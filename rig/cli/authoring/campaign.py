"""``rig new campaign``: the file that describes recordings made elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click

from identification.recording import CHANNELS
from rig.cli.authoring.questions import UNKNOWN, Answers, Known, Listed, Quantity, Question
from rig.cli.authoring.writing import fill
from rig.common.errors import InputError
from rig.config.campaign_sections import FITTED_TERMS, ReadSection
from rig.sources.columns import Guess, channel_unit, guess_channels, guess_mass, is_linear, scale_of
from rig.sources.formats import FORMATS, open_table, unknown_format
from rig.sources.table import format_of

ASKED: Final = (
    "time",
    "current",
    "voltage",
    "torque",
    "angle",
    "motor_angle",
    "velocity",
    "command",
)
"""Channels that the questions ask for; another channel is used only if a column has its name."""
NONE: Final = "-"


@dataclass(frozen=True)
class DataFile:
    """A recording made elsewhere."""

    path: Path
    names: tuple[str, ...]
    mass_kg: float


def questions(files: Sequence[DataFile] = ()) -> tuple[Question, ...]:
    """Return the questions about data files; without files, the questions as options."""

    def has(*channels: str) -> Callable[[Mapping[str, Any]], bool]:
        return lambda answers: any(answers[channel] != NONE for channel in channels)

    def loaded(answers: Mapping[str, Any]) -> bool:
        return any(answers["masses"])

    def by_voltage(answers: Mapping[str, Any]) -> bool:
        return has("voltage")(answers) and not has("current", "torque")(answers)

    def motion(_answers: Mapping[str, Any]) -> str:
        return "linear" if any(is_linear(file.names) for file in files) else "rotary"

    def one_for_each(masses: tuple[float, ...]) -> str | None:
        if len(masses) == len(files):
            return None
        return (
            f"{len(masses)} masses for {len(files)} recordings; give one mass for each recording, "
            "0 for no mass"
        )

    def leaves_some(answer: tuple[str, ...]) -> str | None:
        names = dict.fromkeys(file.path.name for file in files)
        unknown = [name for name in answer if name not in names]
        if unknown:
            return f"no recording {', '.join(unknown)}; there are {', '.join(names)}"
        if set(answer) == set(names):
            return "at least one recording must be left to fit"
        return None

    return (
        Question(
            "motion",
            "Motion of the joint (linear: m, N); linear where a column states m or mm, else rotary",
            default=motion,
            kind=click.Choice(("rotary", "linear")),
        ),
        *(question for channel in ASKED for question in _channel_questions(channel, files)),
        Question(
            "rate",
            "Sampling rate, where there is no column of time",
            "Hz",
            when=lambda a: not has("time")(a),
        ),
        Question(
            "masses",
            "Mass on the lever in each recording, in the order of the files; 0 for none",
            "kg",
            default=lambda a: tuple(file.mass_kg for file in files),
            kind=Listed(Quantity(min=0.0)),
            refusal=one_for_each,
        ),
        Question(
            "torque_constant",
            "Torque constant of the motor, or none for a fit in amperes",
            "N m/A",
            default=UNKNOWN,
            kind=Known(min=0.0, min_open=True),
            when=has("current", "voltage"),
        ),
        Question(
            "back_emf_constant",
            "Back-EMF constant of the motor",
            "V s/rad",
            default=lambda a: None if a["torque_constant"] == UNKNOWN else a["torque_constant"],
            when=by_voltage,
        ),
        Question(
            "resistance",
            "Winding resistance, with which the current is computed from the voltage",
            "ohm",
            when=by_voltage,
        ),
        Question("gear_ratio", "Gear ratio, motor turns per turn of the joint", default=1.0),
        Question("moment_arm", "Radius at which the load presses on the joint", "m", when=loaded),
        Question(
            "lever_ratio",
            "Lever ratio, contact force over weight; 1 if the weight itself is the contact force",
            when=loaded,
        ),
        Question(
            "validate",
            "Recordings for validation only, such as b.csv,c.csv, or none",
            default=(),
            kind=Listed(click.STRING),
            refusal=leaves_some,
        ),
        Question(
            "terms",
            f"Declared terms that are fitted as well ({', '.join(FITTED_TERMS)}), or none",
            default=(),
            kind=Listed(click.Choice(FITTED_TERMS)),
        ),
    )


def _channel_questions(channel: str, files: Sequence[DataFile]) -> tuple[Question, Question]:
    """Return the questions about column and scale of a channel."""
    words = channel.replace("_", " ")
    units = dict.fromkeys((channel_unit(channel), channel_unit(channel, linear=True)))

    def column(answers: Mapping[str, Any]) -> str:
        """Return the guess if it is the same for every file."""
        guesses = {_guess_of(file, linear(answers)).get(channel) for file in files}
        guess = guesses.pop()
        return NONE if guess is None or guesses else str(guess.column)

    def scale(answers: Mapping[str, Any]) -> float:
        found = _column_of(answers[channel], files[0].names)
        name = files[0].names[found] if isinstance(found, int) else found
        return scale_of(name, channel, linear(answers)) if name else 1.0

    def no_column(answer: str) -> str | None:
        lacking = [
            f"{file.path.name} has no column {answer!r}; it has {', '.join(file.names)}"
            for file in files
            if answer != NONE and _column_of(answer, file.names) is None
        ]
        return "; ".join(lacking) or None

    return (
        Question(
            channel,
            f"Column of {words}, by name or index, or {NONE} for none",
            default=column,
            kind=click.STRING,
            refusal=no_column,
        ),
        Question(
            f"{channel}_scale",
            f"SI units ({' or '.join(units)}) per unit of the column of {words}, negative to "
            "reverse the sign; by default from the unit in the column's name",
            default=scale,
            kind=Quantity(),
            when=lambda answers: bool(answers[channel] != NONE),
            refusal=lambda answer: "a scale of 0 makes all samples 0" if answer == 0.0 else None,
        ),
    )


def linear(answers: Mapping[str, Any]) -> bool:
    """Return whether the bench is linear."""
    return bool(answers["motion"] == "linear")


def _guess_of(file: DataFile, linear: bool) -> dict[str, Guess]:
    return guess_channels(file.names, linear)


def _column_of(answer: str, names: Sequence[str]) -> str | int | None:
    """Return the column of an answer, by name or else by index; None for none."""
    if answer in names:
        return answer
    if answer.isdecimal() and int(answer) < len(names):
        return int(answer)
    return None


def read_names(paths: Sequence[Path]) -> list[DataFile]:
    """Return the column names of files."""
    found, problems = [], []
    for path in paths:
        if not path.is_file():
            problems.append(f"{path}: no such file; name recordings ({', '.join(FORMATS)})")
        elif format_of(path) not in FORMATS:
            problems.append(f"{path}: {unknown_format(path)}")
        else:
            try:
                names = open_table(path, ReadSection()).names
            except InputError as error:
                problems.extend(error.problems)
                continue
            found.append(DataFile(path, names, guess_mass(path.stem)))
    if problems:
        raise InputError(problems)
    return found


def campaign_text(
    path: Path, files: Sequence[DataFile], answers: Answers, read: Mapping[str, Any] | None = None
) -> str:
    """Return the text of a campaign file without its first line.

    ``path``: future path of the campaign file; recordings are named relative to its folder.
    ``read``: options to read text files; empty for files that are read without options.
    """
    recordings = [
        {
            "file": Path(os.path.relpath(file.path, path.parent)).as_posix(),
            "weight_mass": mass,
            "role": "validate" if file.path.name in answers["validate"] else "fit",
            "channels": _channels(file, answers),
        }
        for file, mass in zip(files, answers["masses"], strict=True)
    ]
    values = {**answers, "path": path.name, "read": read or {}, "recordings": recordings}
    return fill("campaign", values)


def _channels(file: DataFile, answers: Answers) -> dict[str, dict[str, Any]]:
    columns: dict[str, tuple[str | int, float]] = {}
    for channel in ASKED:
        column = None if answers[channel] == NONE else _column_of(answers[channel], file.names)
        if column is not None:
            columns[channel] = column, answers[f"{channel}_scale"]
    taken = {column for column, _ in columns.values()}
    for channel, guess in _guess_of(file, linear(answers)).items():
        if channel not in ASKED and guess.column not in taken:
            columns[channel] = guess.column, guess.scale
    return {
        channel: {"column": columns[channel][0], "scale": columns[channel][1], "offset": 0.0}
        | ({"wraps_after": turn} if (turn := answers.get(f"{channel}_wraps_after")) else {})
        for channel in CHANNELS
        if channel in columns
    }
