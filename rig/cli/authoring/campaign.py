"""``rig new campaign``: from recordings made elsewhere to the file that describes them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click

from identification.recording import CHANNELS
from rig.cli.authoring.columns import Guess, guess_channels, guess_mass
from rig.cli.authoring.questions import Answers, Number, Numbers, Question, ask_all
from rig.cli.authoring.yaml_text import Block, render
from rig.common.errors import InputError
from rig.config.bench import Constants
from rig.config.campaign import Campaign
from rig.config.campaign_sections import BenchSection, ChannelSection, ReadSection, RecordingSection
from rig.sources.formats import FORMATS, open_table
from rig.sources.table import format_of
from rig.terminal.prompt import Asker

_ASKED: Final = (
    "time",
    "current",
    "voltage",
    "torque",
    "angle",
    "motor_angle",
    "velocity",
    "command",
)
"""Channels that are asked for; the others are taken where a column is named for them."""
_NONE: Final = "-"


@dataclass(frozen=True)
class DataFile:
    """A recording made elsewhere.

    Attributes:
        path: The file.
        names: Its columns.
        mass_kg: Mass on the lever that its name states; 0 for none.
    """

    path: Path
    names: tuple[str, ...]
    mass_kg: float


def read_names(paths: Sequence[Path]) -> list[DataFile]:
    """Return the column names of files.

    Raises:
        InputError: A file is missing, damaged or of unknown format; lists all.
    """
    found, problems = [], []
    for path in paths:
        if not path.is_file():
            problems.append(f"{path}: no such file; name recordings ({', '.join(FORMATS)})")
        elif format_of(path) not in FORMATS:
            problems.append(f"{path}: unknown format; readable are {', '.join(FORMATS)}")
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


def questions(files: Sequence[DataFile]) -> tuple[Question, ...]:
    """Return what is asked about files."""
    guesses = _common(files)

    def has(*channels: str) -> Callable[[Mapping[str, Any]], bool]:
        return lambda answers: any(answers[channel] != _NONE for channel in channels)

    def loaded(answers: Mapping[str, Any]) -> bool:
        return any(answers["masses"])

    columns = tuple(
        Question(
            channel,
            f"Column of {channel.replace('_', ' ')}, or {_NONE} for none",
            kind=click.STRING,
            default=str(guesses[channel].column) if channel in guesses else _NONE,
        )
        for channel in _ASKED
    )
    return (*columns, *_constants(has, loaded, tuple(file.mass_kg for file in files)))


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
            why="it turns the voltage into a current",
        ),
        Question("gear_ratio", "Gear ratio, motor turns per turn of the joint", default=1.0),
        Question(
            "moment_arm",
            "Radius at which the load presses on the joint",
            "m",
            when=loaded,
            why="it turns the contact force into a torque",
        ),
        Question(
            "lever_ratio",
            "Lever ratio, contact force over weight",
            when=loaded,
            why="it scales every working load; 1 where the weight presses straight on the moment "
            "arm",
        ),
    )


class Masses(Numbers):
    """Masses between commas, one for each recording; 0 for none.

    Args:
        count: Number of recordings.
    """

    def __init__(self, count: int) -> None:
        self._count = count

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the masses, or fail with words."""
        if isinstance(value, tuple):
            return value
        words = str(value).replace(",", " ").split()
        if self._count and len(words) != self._count:
            self.fail(
                f"{len(words)} masses for {self._count} recordings; give one for each, 0 for none",
                param,
                ctx,
            )
        return tuple(Number(at_least=0.0).convert(word, param, ctx) for word in words)


OPTIONS: Final = (
    *(
        Question(
            channel, f"Column of {channel.replace('_', ' ')}, by name or index", kind=click.STRING
        )
        for channel in _ASKED
    ),
    Question("rate", "Sampling rate, where there is no column of time", "Hz"),
    Question("masses", "Mass on the lever in each recording, such as 0,2,5", "kg", kind=Masses(0)),
    Question("torque_constant", "Torque constant of the motor", "N m/A"),
    Question("back_emf_constant", "Back-EMF constant of the motor", "V s/rad"),
    Question("resistance", "Winding resistance", "ohm"),
    Question("gear_ratio", "Gear ratio, motor turns per turn of the joint"),
    Question("moment_arm", "Radius at which the load presses on the joint", "m"),
    Question("lever_ratio", "Lever ratio, contact force over weight"),
)
"""The options of the command; their defaults follow from the files."""


def answer(
    files: Sequence[DataFile],
    given: Mapping[str, Any],
    asker: Asker | None,
    tell: Callable[[str], None],
) -> Answers:
    """Return the answers about files; the columns are told first.

    Raises:
        InputError: An answer is missing, or names no column.
    """
    masses = given.get("masses")
    if masses is not None and len(masses) != len(files):
        raise InputError(
            f"--masses: {len(masses)} masses for {len(files)} recordings; give one for each, 0 "
            f"for none"
        )
    named = [name for name in files[0].names if name]
    tell(
        f"columns of {files[0].path.name}: "
        f"{', '.join(named) if named else f'{len(files[0].names)} without a name'}"
    )
    answers = ask_all(questions(files), given, asker, tell)
    problems = [
        f"{_option(channel)}: {file.path.name} has no column {answers[channel]!r}; it has "
        f"{', '.join(file.names)}"
        for channel in _ASKED
        for file in files
        if answers[channel] != _NONE and _column(answers[channel], file.names) is None
    ]
    if problems:
        raise InputError(problems)
    return answers


def _option(channel: str) -> str:
    return f"--{channel.replace('_', '-')}"


def _column(answer: str, names: Sequence[str]) -> str | int | None:
    """Return the column that an answer means, by name or else by index; None for none."""
    if answer in names:
        return answer
    if answer.isdecimal() and int(answer) < len(names):
        return int(answer)
    return None


def _common(files: Sequence[DataFile]) -> dict[str, Guess]:
    """Return guesses that hold for every file."""
    first, *others = [guess_channels(file.names) for file in files]
    return {
        channel: guess
        for channel, guess in first.items()
        if all(other.get(channel) == guess for other in others)
    }


def campaign_text(path: Path, files: Sequence[DataFile], answers: Answers) -> str:
    """Return the text of a campaign file, its first line left out.

    Args:
        path: Where it will be; files are named relative to its folder.
        files: The recordings.
        answers: About them.
    """
    bench = {
        "motion": "rotary",
        **{key: answers[key] for key in BenchSection.model_fields if key in answers},
        "gravity": Constants.model_fields["gravity_m_s2"].default,
    }
    recordings = [
        _recording(path, file, mass, answers, bare=n > 0)
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
            Campaign, {"campaign": 1, "bench": Block(BenchSection, bench), "recordings": recordings}
        )
    )


def _recording(path: Path, file: DataFile, mass: float, answers: Answers, bare: bool) -> Block:
    values: dict[str, Any] = {
        "file": Path(os.path.relpath(file.path, path.parent)).as_posix(),
        "stage": "loaded" if mass else "unloaded",
        "weight_mass": mass,
        "role": "fit",
    }
    if "rate" in answers:
        values["rate"] = answers["rate"]
    return Block(RecordingSection, {**values, "channels": _channels(file, answers)}, bare=bare)


def _channels(file: DataFile, answers: Answers) -> Block:
    guesses = guess_channels(file.names)
    chosen: dict[str, str | int] = {}
    for channel in _ASKED:
        if (
            answers[channel] != _NONE
            and (column := _column(answers[channel], file.names)) is not None
        ):
            chosen[channel] = column
    for channel, guess in guesses.items():
        if channel not in _ASKED and guess.column not in chosen.values():
            chosen[channel] = guess.column
    values = {}
    for channel in CHANNELS:
        if channel in chosen:
            column = chosen[channel]
            scale = next(
                (g.scale for c, g in guesses.items() if c == channel and g.column == column), 1.0
            )
            values[channel] = {"column": column, "scale": scale, "offset": 0.0}
    return Block(ChannelSection, values)
