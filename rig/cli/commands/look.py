"""``rig look``: shows the content of a log."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from identification.numerics.arrays import plain
from rig.cli import options as shared
from rig.common.errors import InputError
from rig.common.places import is_folder, write_asked
from rig.common.provenance import heading
from rig.common.tables import picture, table

if TYPE_CHECKING:
    from rig.sources.look import Column, Look

LOOK_SCHEMA = "loadrig.look/1"
NEEDED = {
    "the angle": {"angle", "motor_angle", "velocity"},
    "the current, torque or voltage": {"current", "torque", "voltage"},
}
"""Sets of channels; an identification needs at least one channel of each set."""


@click.command("look")
@click.argument("path", metavar="FILE", type=shared.PATH)
@click.option("--skip-rows", type=click.IntRange(0), default=0, help="Lines before the header.")
@click.option("--delimiter", help="Delimiter, one character. [default: detected from the file]")
@click.option("--decimal", type=click.Choice([".", ","]), default=".")
@click.option(
    "--dbc",
    multiple=True,
    type=click.Path(dir_okay=False),
    help="DBC file of recorded CAN traffic; may be given several times.",
)
@click.option("--bus", help="Bus of recorded CAN traffic, by its name in the file.")
@shared.path(
    "--campaign", "Write a first campaign file, with a comment on every key.", type=shared.FILE
)
@shared.result_file
def look(
    path: Path,
    skip_rows: int,
    delimiter: str | None,
    decimal: str,
    dbc: tuple[str, ...],
    bus: str | None,
    campaign: Path | None,
    json_file: Path | None,
) -> None:
    """Show what FILE contains: for each column the unit, the range, the quantisation step,
    wrap-arounds and a small plot; and the sample rate and gaps.

    FILE is a log of any format that campaign files can name, a run folder or a campaign file. The
    command guesses the channel of a column from the name and the unit of the column; check these
    guesses.

    \b
    Example:
      rig look log.csv
      rig look log.csv --campaign campaign.yaml
      rig look traffic.blf --dbc drive.dbc
    """
    read: dict[str, Any] = {"skip_rows": skip_rows, "delimiter": delimiter, "decimal": decimal}
    read |= {"dbc": dbc or None, "bus": bus}
    looks = _looks(path, read)
    click.echo("\n\n".join(described(look) for look in looks))
    write_asked(json_file, look_record(looks))
    if campaign is not None:
        _write_campaign(campaign, path, looks, read)
    elif len(looks) == 1 and looks[0].format != "recording":
        lacking = [n for n, any_of in NEEDED.items() if not any_of & looks[0].guesses.keys()]
        state = f", and state the column of {' and '.join(lacking)} in that file"
        told = state if lacking else ""
        click.echo(f"\nnext: rig look {path} --campaign campaign.yaml{told}")


def _looks(path: Path, read: dict[str, Any]) -> list[Look]:
    from pydantic import ValidationError

    from rig.config.campaign_sections import ReadSection
    from rig.sources import load_source
    from rig.sources.look import look_at_file, look_at_recording

    if is_folder(path) or path.suffix.lower() in (".yaml", ".yml"):
        return [look_at_recording(recording) for recording in load_source(path).recordings]
    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        options = ReadSection(**read)
    except ValidationError as error:
        first = error.errors()[0]
        option = first["loc"][0] if first["loc"] else "delimiter"
        raise InputError(f"--{option}: {first['msg']}") from error
    return [look_at_file(path, options)]


def _write_campaign(campaign: Path, path: Path, looks: list[Look], read: dict[str, Any]) -> None:
    """Write the campaign file; an unknown value has a placeholder that the user must change."""
    from rig.cli.authoring.campaign import ASKED, NONE, DataFile, campaign_text, questions
    from rig.cli.authoring.questions import ask_all
    from rig.cli.authoring.writing import RefusedError, require_new, write_new
    from rig.config.campaign import load_campaign
    from rig.sources.columns import guess_mass

    (look,) = looks if len(looks) == 1 else (None,)
    if look is None or look.format == "recording":
        raise InputError(
            f"--campaign: {path} is a run folder or a campaign file, which other commands read "
            "without a further campaign file"
        )
    require_new(campaign, "campaign")
    names = tuple(column.name for column in look.columns)
    given: dict[str, Any] = {channel: NONE for channel in ASKED}
    turns: dict[str, float | None] = {}
    for channel in ASKED:
        guess = look.guesses.get(channel)
        if guess is not None:
            place = int(guess.column)
            unique = names[place] and names.count(names[place]) == 1
            given[channel] = names[place] if unique else str(place)
            given[f"{channel}_scale"] = guess.scale
            turns[f"{channel}_wraps_after"] = look.columns[place].turn
    file = DataFile(path, names, guess_mass(path.stem))
    stand_in = {"moment_arm": 0.1, "lever_ratio": 1.0} if file.mass_kg else {}
    if given["time"] == NONE:
        stand_in["rate"] = 1000.0
    if given["voltage"] != NONE and given["current"] == given["torque"] == NONE:
        stand_in |= {"resistance": 1.0, "back_emf_constant": 1.0}
    answers = ask_all(questions([file]), given | stand_in, None, lambda _: None, {}) | turns
    told = {key: value for key, value in read.items() if value not in (None, 0, ".")}
    if "dbc" in told:
        # The names of files are relative to the campaign file.
        names = tuple(Path(os.path.relpath(n, campaign.parent)).as_posix() for n in told["dbc"])
        told["dbc"] = names[0] if len(names) == 1 else list(names)
    try:
        written = write_new(
            campaign, "campaign", campaign_text(campaign, [file], answers, told), load_campaign
        )
    except RefusedError as error:
        remedy = f"name the columns: rig new campaign {campaign} {path} --current COLUMN ..."
        raise InputError([*(f"{campaign}: {text}" for text in error.problems), remedy]) from error
    click.echo(f"wrote {', '.join(map(str, written))}")
    guessed = ", ".join(sorted({"torque_constant", "gear_ratio", *stand_in}))
    click.echo(f"set the bench's constants ({guessed}) and check each channel's scale and sign")


def described(look: Look) -> str:
    """Return the terminal text: notes, the clock, and one row per column with a small picture."""
    rows = max((column.samples for column in look.columns), default=0)
    parts = [f"{look.name}: {look.format}, {len(look.columns)} columns, {rows} rows"]
    parts += [f"  {note}" for note in look.notes]
    parts += [f"  {_clock_words(look)}"]
    cells = [_row(column) for column in look.columns]
    parts += [f"  doubt: {words}" for words in look.doubts]
    parts += [table(("column", "unit", "may be", "least", "greatest", "course", "notes"), cells)]
    return "\n".join(parts)


def _clock_words(look: Look) -> str:
    clock = look.clock
    if clock is None and "time" in look.guesses:
        return "there are too few rows to describe the time"
    if clock is None:
        return (
            "no column is recognised as time: name the column of time in the campaign file or, if "
            "there is none, give `rate`"
        )
    name = look.columns[clock.column].name or clock.column
    words = [f"time is {name}"]
    if clock.period_s > 0:
        words.append(f"{1.0 / clock.period_s:.6g} Hz (median period {clock.period_s:.4g} s)")
    if clock.high_s - clock.low_s > 0.05 * abs(clock.period_s):
        words.append(f"uneven: 90 % of the steps from {clock.low_s:.4g} to {clock.high_s:.4g} s")
    words.append(f"{clock.gaps} gaps, the longest step {clock.longest_s:.4g} s")
    words += [f"{clock.backwards} steps backwards"] if clock.backwards else []
    words += [f"{clock.repeated} repeated"] if clock.repeated else []
    return ", ".join(words)


def _row(column: Column) -> tuple[str, ...]:
    notes = [column.problem] if column.problem else []
    if column.missing:
        notes.append(f"{column.missing} missing")
    if column.samples and column.least == column.greatest:
        notes.append("constant")
    if column.step:
        notes.append(f"steps of {column.step:.4g}")
    if column.flicker:
        notes.append(f"flickers in {100 * column.flicker:.0f} % of the samples")
    if column.wrap:
        notes.append(column.wrap)
    may = column.channel + (f" x {column.scale:.6g}" if column.scale != 1.0 else "")
    low, high = (
        "" if math.isnan(value) else f"{value:.6g}" for value in (column.least, column.greatest)
    )
    name = column.name or str(column.index)
    return (name, column.unit, may, low, high, picture(column.course), "; ".join(notes))


def look_record(looks: Sequence[Look]) -> dict[str, Any]:
    """Return the record of ``rig look --json``."""
    logs = [plain(look, "guesses") for look in looks]
    for log in logs:
        for column in log["columns"]:
            del column["turn"]
    return {**heading(LOOK_SCHEMA), "logs": logs}
