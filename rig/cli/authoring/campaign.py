"""``rig new campaign``: writes the file that describes recordings made elsewhere."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from identification.recording import CHANNELS
from rig.cli.authoring.campaign_questions import (
    ASKED,
    NONE,
    DataFile,
    column_of,
    linear,
    questions,
)
from rig.cli.authoring.questions import Answers, ask_all
from rig.cli.authoring.yaml_text import Block, render
from rig.common.errors import InputError
from rig.config.bench import Constants
from rig.config.campaign import Campaign
from rig.config.campaign_columns import ChannelSection, ReadSection
from rig.config.campaign_sections import BenchSection, ModelSection, RecordingSection
from rig.sources.columns import guess_channels, guess_mass
from rig.sources.formats import format_of
from rig.sources.readers import FORMATS, open_table, unknown_format
from rig.terminal.prompt import Asker


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
