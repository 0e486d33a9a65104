"""``rig new campaign``: writes the file that describes recordings made elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click

from identification.recording import CHANNELS
from rig.cli.authoring.questions import Answers, Kind, Number, Numbers, Question, ask_all
from rig.cli.authoring.yaml_text import Block, render
from rig.common.errors import InputError
from rig.config.bench import Constants
from rig.config.campaign import Campaign
from rig.config.campaign_columns import ChannelSection, ReadSection
from rig.config.campaign_sections import FITTED_TERMS, BenchSection, ModelSection, RecordingSection
from rig.sources.columns import Guess, channel_unit, guess_channels, guess_mass, is_linear, scale_of
from rig.sources.formats import FORMATS, open_table, unknown_format
from rig.sources.table import format_of
from rig.terminal.prompt import Asker

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
    """A recording made elsewhere.

    Attributes:
        path: The file.
        names: Names of the columns of the file.
        mass_kg: Mass on the lever according to its file name; 0 for none.
    """

    path: Path
    names: tuple[str, ...]
    mass_kg: float


def questions(files: Sequence[DataFile]) -> tuple[Question, ...]:
    """Return the questions about the given data files."""

    def has(*channels: str) -> Callable[[Mapping[str, Any]], bool]:
        return lambda answers: any(answers[channel] != NONE for channel in channels)

    def loaded(answers: Mapping[str, Any]) -> bool:
        return any(answers["masses"])

    motion = Question(
        "motion",
        "Motion of the joint: rotary (rad, N m) or linear (m, N)",
        kind=click.Choice(("rotary", "linear")),
        default="linear" if any(is_linear(file.names) for file in files) else "rotary",
    )
    columns = tuple(
        question
        for channel in ASKED
        for question in (_column_question(channel, files), _scale_question(channel, files))
    )
    constants = _constants(has, loaded, tuple(file.mass_kg for file in files))
    return (motion, *columns, *constants, *_model(files))


def _column_question(channel: str, files: Sequence[DataFile]) -> Question:
    def default(answers: Mapping[str, Any]) -> str:
        guess = _common(files, linear(answers)).get(channel)
        return NONE if guess is None else str(guess.column)

    def refusal(answer: str, _answers: Mapping[str, Any]) -> str | None:
        lacking = [
            file for file in files if answer != NONE and column_of(answer, file.names) is None
        ]
        if not lacking:
            return None
        return "; ".join(
            f"{file.path.name} has no column {answer!r}; it has {', '.join(file.names)}"
            for file in lacking
        )

    return Question(
        channel,
        f"Column of {channel.replace('_', ' ')}, or {NONE} for none",
        kind=click.STRING,
        default=default,
        refusal=refusal,
    )


def _scale_question(channel: str, files: Sequence[DataFile]) -> Question:
    def default(answers: Mapping[str, Any]) -> float:
        column = column_of(answers[channel], files[0].names)
        name = files[0].names[column] if isinstance(column, int) else column
        return scale_of(name, channel, linear(answers)) if name else 1.0

    return Question(
        f"{channel}_scale",
        f"SI units ({_units(channel)}) per unit of the column of {channel.replace('_', ' ')}; "
        "negative to reverse the sign",
        kind=Number(above=None, not_zero=True),
        default=default,
        when=lambda answers: bool(answers[channel] != NONE),
    )


def _units(channel: str) -> str:
    return " or ".join(dict.fromkeys((channel_unit(channel), channel_unit(channel, linear=True))))


def linear(answers: Mapping[str, Any]) -> bool:
    """Return whether the bench is linear."""
    return bool(answers["motion"] == "linear")


def _model(files: Sequence[DataFile]) -> tuple[Question, ...]:
    names = tuple(dict.fromkeys(file.path.name for file in files))

    def refusal(answer: tuple[str, ...], _answers: Mapping[str, Any]) -> str | None:
        unknown = [name for name in answer if name not in names]
        if unknown:
            return f"no recording {', '.join(unknown)}; there are {', '.join(names)}"
        if set(answer) == set(names):
            return "at least one recording must be left to fit"
        return None

    return (
        Question(
            "validate",
            "Recordings set aside to validate, by file name, or none",
            kind=Names(),
            default=(),
            refusal=refusal,
        ),
        Question(
            "terms",
            f"Declared terms that are fitted as well ({', '.join(FITTED_TERMS)}), or none",
            kind=Names(FITTED_TERMS),
            default=(),
        ),
    )


def _constants(
    has: Callable[..., Callable[[Mapping[str, Any]], bool]],
    loaded: Callable[[Mapping[str, Any]], bool],
    masses: tuple[float, ...],
) -> tuple[Question, ...]:
    def by_voltage(answers: Mapping[str, Any]) -> bool:
        return has("voltage")(answers) and not has("current", "torque")(answers)

    return (
        Question(
            "rate",
            "Sampling rate",
            "Hz",
            when=lambda a: not has("time")(a),
            why="without a column of time the sampling rate must be known",
        ),
        Question(
            "masses",
            "Mass on the lever in each recording, in the order of the files; 0 for none",
            "kg",
            kind=Masses(len(masses)),
            default=masses,
        ),
        Question(
            "torque_constant",
            "Torque constant of the motor",
            "N m/A",
            default=0.03,
            when=has("current", "voltage"),
        ),
        Question(
            "back_emf_constant",
            "Back-EMF constant",
            "V s/rad",
            default=lambda a: a["torque_constant"],
            when=by_voltage,
        ),
        Question(
            "resistance",
            "Winding resistance",
            "ohm",
            when=by_voltage,
            why="the current is computed from the voltage with the resistance",
        ),
        Question("gear_ratio", "Gear ratio, motor turns per turn of the joint", default=1.0),
        Question(
            "moment_arm",
            "Radius at which the load presses on the joint",
            "m",
            when=loaded,
            why="the torque is the contact force times this radius",
        ),
        Question(
            "lever_ratio",
            "Lever ratio, contact force over weight",
            when=loaded,
            why="the ratio scales every working load; 1 if the weight itself is the contact force",
        ),
    )


class Names(Kind):
    """Names separated by commas; an empty answer is an empty list.

    Args:
        allowed: Names that are known; empty for any.
    """

    name = "names"

    def __init__(self, allowed: Sequence[str] = ()) -> None:
        self._allowed = tuple(allowed)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the names, each once and in the order given, or fail with a message."""
        if isinstance(value, tuple):
            return value
        names = [word.strip() for word in str(value).split(",") if word.strip()]
        if names == ["none"]:
            return ()
        unknown = [name for name in names if self._allowed and name not in self._allowed]
        if unknown:
            self.fail(
                f"unknown: {', '.join(unknown)}; known are {', '.join(self._allowed)}", param, ctx
            )
        return tuple(dict.fromkeys(names))


class Masses(Numbers):
    """Masses separated by commas, one for each recording; 0 means no mass.

    Args:
        count: Number of recordings.
    """

    def __init__(self, count: int) -> None:
        self._count = count

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the masses, or fail with a message."""
        if isinstance(value, tuple):
            return value
        words = str(value).replace(",", " ").split()
        if self._count and len(words) != self._count:
            self.fail(
                f"{len(words)} masses for {self._count} recordings; give one mass for each "
                f"recording, 0 for no mass",
                param,
                ctx,
            )
        return tuple(Number(at_least=0.0).convert(word, param, ctx) for word in words)


OPTIONS: Final = (
    Question(
        "motion",
        "Motion of the joint; linear where a column states m or mm, else rotary",
        kind=click.Choice(("rotary", "linear")),
    ),
    *(
        Question(
            channel, f"Column of {channel.replace('_', ' ')}, by name or index", kind=click.STRING
        )
        for channel in ASKED
    ),
    *(
        Question(
            f"{channel}_scale",
            f"SI units ({_units(channel)}) per unit of the column of {channel.replace('_', ' ')}; "
            "default: from the unit in the column's name, else 1",
            kind=Number(above=None, not_zero=True),
        )
        for channel in ASKED
    ),
    Question("rate", "Sampling rate, where there is no column of time", "Hz"),
    Question("masses", "Mass on the lever in each recording, such as 0,2,5", "kg", kind=Masses(0)),
    Question("torque_constant", "Torque constant of the motor", "N m/A"),
    Question("back_emf_constant", "Back-EMF constant of the motor", "V s/rad"),
    Question("resistance", "Winding resistance", "ohm"),
    Question("gear_ratio", "Gear ratio, motor turns per turn of the joint"),
    Question("moment_arm", "Radius at which the load presses on the joint", "m"),
    Question("lever_ratio", "Lever ratio, contact force over weight"),
    Question(
        "validate",
        "Recordings for validation only, such as b.csv,c.csv; without a name all are fitted",
        kind=Names(),
    ),
    Question(
        "terms",
        f"Declared terms that are fitted as well: {', '.join(FITTED_TERMS)}",
        kind=Names(FITTED_TERMS),
    ),
)
"""The options of the command; their defaults follow from the files."""


def column_of(answer: str, names: Sequence[str]) -> str | int | None:
    """Return the column selected by an answer, by name or else by index, or None if the answer is
    `none`.
    """
    if answer in names:
        return answer
    if answer.isdecimal() and int(answer) < len(names):
        return int(answer)
    return None


def _common(files: Sequence[DataFile], linear: bool) -> dict[str, Guess]:
    """Return guesses that hold for every file."""
    first, *others = [guess_channels(file.names, linear) for file in files]
    return {
        channel: guess
        for channel, guess in first.items()
        if all(other.get(channel) == guess for other in others)
    }


def read_names(paths: Sequence[Path]) -> list[DataFile]:
    """Return the column names of files.

    Raises:
        InputError: Files are missing, damaged or of unknown format; the message lists all of them.
    """
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


def answer(
    files: Sequence[DataFile],
    given: Mapping[str, Any],
    asker: Asker | None,
    tell: Callable[[str], None],
    before: Mapping[str, Any] | None = None,
) -> Answers:
    """Return the answers about files; the columns are shown before the questions.

    Args:
        files: The recordings.
        given: Answers given as options.
        asker: Asks for the other answers; None to ask nothing.
        tell: Shows messages.
        before: Answers of an earlier round, used as defaults.

    Raises:
        InputError: An answer is missing, or names no column.
    """
    masses = given.get("masses")
    if masses is not None and len(masses) != len(files):
        raise InputError(
            f"--masses: {len(masses)} masses for {len(files)} recordings; give one mass for each "
            f"recording, 0 for no mass"
        )
    if not before:
        named = [name for name in files[0].names if name]
        tell(
            f"columns of {files[0].path.name}: "
            f"{', '.join(named) if named else f'{len(files[0].names)} without a name'}"
        )
    return ask_all(questions(files), given, asker, tell, before)


def campaign_text(
    path: Path,
    files: Sequence[DataFile],
    answers: Answers,
    read: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of a campaign file without its first line.

    Args:
        path: Future path of the campaign file; recordings are named relative to its folder.
        files: The recordings.
        answers: The user's answers to the questions about the recordings.
        read: Options to read text files; empty for files that are read without options.
    """
    bench = {
        **{key: answers[key] for key in BenchSection.model_fields if key in answers},
        "gravity": Constants.model_fields["gravity_m_s2"].default,
    }
    recordings = [
        _recording(path, file, mass, answers, read or {}, bare=n > 0)
        for n, (file, mass) in enumerate(zip(files, answers["masses"], strict=True))
    ]
    head = (
        "# Campaign of recordings made elsewhere, written by `rig new campaign`. The keys of the "
        "first\n"
        "# recording are explained. Check scale and sign of every channel: SI = scale * column + "
        "offset.\n"
        f"# Then: rig identify {path.name}\n"
    )
    return head + render(
        Block(
            Campaign,
            {
                "campaign": 1,
                "bench": Block(BenchSection, bench),
                "model": Block(ModelSection, {"terms": list(answers["terms"])}),
                "recordings": recordings,
            },
        )
    )


def _recording(
    path: Path,
    file: DataFile,
    mass: float,
    answers: Answers,
    read: Mapping[str, Any],
    bare: bool,
) -> Block:
    values: dict[str, Any] = {
        "file": Path(os.path.relpath(file.path, path.parent)).as_posix(),
        "stage": "loaded" if mass else "unloaded",
        "weight_mass": mass,
        "role": "validate" if file.path.name in answers["validate"] else "fit",
    }
    if "rate" in answers:
        values["rate"] = answers["rate"]
    if read:
        values["read"] = Block(ReadSection, read, bare=bare)
    return Block(RecordingSection, {**values, "channels": _channels(file, answers)}, bare=bare)


def _channels(file: DataFile, answers: Answers) -> Block:
    guesses = guess_channels(file.names, linear(answers))
    columns: dict[str, tuple[str | int, float]] = {}
    for channel in ASKED:
        column = None if answers[channel] == NONE else column_of(answers[channel], file.names)
        if column is not None:
            columns[channel] = column, answers[f"{channel}_scale"]
    taken = {column for column, _ in columns.values()}
    for channel, guess in guesses.items():
        if channel not in ASKED and guess.column not in taken:
            columns[channel] = guess.column, guess.scale
    values = {
        channel: {"column": column, "scale": scale, "offset": 0.0}
        for channel in CHANNELS
        if channel in columns
        for column, scale in (columns[channel],)
    }
    return Block(ChannelSection, values)
