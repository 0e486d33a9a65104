"""Schema of the campaign file: recordings of other programs, and how to read them.

`recordings` is a list; an entry with `table` represents one recording for each row of the table.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from glob import glob
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from identification.model.parameters import LOAD_PARAMETERS, bears_load, rises
from rig.common.errors import InputError
from rig.common.text import stored_path
from rig.common.yaml_tree import DocumentError, Node, csv_rows, read_text, row
from rig.config.campaign_sections import (
    ANGLE_TIME,
    BenchSection,
    ChannelSection,
    ModelSection,
    RecordingSection,
)
from rig.config.configuration import Document, Loc, Schema, load_located


class Campaign(Schema):
    """A campaign file, after `defaults` were merged into every recording.

    Attributes:
        campaign: Version of the file format.
        bench: Constants of the machine.
        model: Declared physics.
        defaults: Keys of `recordings` with values for all recordings that do not state the keys.
        recordings: The recordings. An entry with the key `table` represents one recording for each
            row of a CSV file, or of a list of lists, whose header contains keys such as `file` or
            `gravity.mass`; the other keys of the entry apply to every row. `{table: files.csv}`
            alone may replace the list.
    """

    campaign: Literal[1]
    bench: BenchSection
    model: ModelSection = ModelSection()
    defaults: dict[str, object] = Field(default_factory=dict)
    recordings: Annotated[tuple[RecordingSection, ...], Field(min_length=1)]


def load_campaign(path: Path) -> Document[Campaign]:
    """Read and check a campaign file but not the recordings; InputError lists every error."""
    document = load_located(path, Campaign, lambda root: _merge_defaults(_rows(root, path)))
    document.require(_cross_check(document.value))
    return document


def matching_files(folder: Path, pattern: str) -> list[Path]:
    """Return the files of a pattern of a campaign in ``folder``, sorted; empty without a match.

    An existing name is used literally, because file names may contain brackets.
    """
    stored = stored_path(pattern)
    if os.path.exists(folder / stored):
        return [folder / stored]
    return [folder / name for name in sorted(glob(str(stored), root_dir=folder, recursive=True))]


def _rows(root: Node, path: Path) -> Node:
    """Replace the entries that name a table by the rows of the table."""
    top = root.value
    if not isinstance(top, dict) or "recordings" not in top:
        return root
    given = top["recordings"]
    entries = given.value if isinstance(given.value, list) else [given]
    if not any(isinstance(e.value, dict) and "table" in e.value for e in entries):
        return root
    found: list[Node] = []
    for entry in entries:
        if not isinstance(entry.value, dict) or "table" not in entry.value:
            found.append(entry)
            continue
        others = {key: node for key, node in entry.value.items() if key != "table"}
        under = Node(others, entry.mark, entry.keys)
        table = entry.value["table"]
        try:
            rows = _table(table, path.parent)
        except DocumentError as error:
            # A mark without a file is a place in the campaign, or in a table that was not read.
            mark = error.mark if error.mark.file else table.mark
            place = f"{mark.file or path}:{mark.line}:{mark.column}"
            raise InputError(f"{place}: recordings.table: {error.message}") from error
        found.extend(one.over(under) for one in rows)
    recordings = Node(found, given.mark, {})
    return Node({**top, "recordings": recordings}, root.mark, root.keys)


def _table(table: Node, folder: Path) -> list[Node]:
    """Return one mapping for each row of a CSV file or of an inline list of lists."""
    if isinstance(table.value, str):
        file = folder / stored_path(table.value)
        try:
            return csv_rows(read_text(file), file)
        except DocumentError as error:
            raise (
                error if error.mark.file else DocumentError(f"{file}: {error.message}")
            ) from error
    lines = table.value if isinstance(table.value, list) else []
    rows = [line.value for line in lines if isinstance(line.value, list)]
    if len(rows) < 2 or len(rows) != len(lines):
        raise DocumentError(
            "a table must be the name of a CSV file, or a list of lists, of which the first list "
            "names the columns"
        )
    header, *_ = rows
    return [row(header, rows[n], lines[n].mark) for n in range(1, len(lines))]


def _merge_defaults(root: Node) -> Node:
    """Merge ``defaults`` into every recording; the keys of the recording have priority."""
    top = root.value
    if not isinstance(top, dict) or "defaults" not in top or "recordings" not in top:
        return root
    recordings = top["recordings"]
    if not isinstance(recordings.value, list):
        return root
    merged = [item.over(top["defaults"]) for item in recordings.value]
    return Node({**top, "recordings": Node(merged, recordings.mark, {})}, root.mark, root.keys)


def _cross_check(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield problems that the schema cannot detect, as (location, message)."""
    fixed = campaign.model.fixed
    if "Mc" in fixed and "Ms" in fixed and fixed["Ms"] < fixed["Mc"]:
        yield (
            ("model", "fixed", "Ms"),
            f"static friction Ms must be at least Coulomb friction Mc = {fixed['Mc']:g}",
        )
    if not rises(campaign.model.rung):
        for name in sorted({"Ms", "omega_sf"} & fixed.keys()):
            yield (
                ("model", "fixed", name),
                f"the friction model {campaign.model.rung} has no static friction and therefore no "
                f"parameter {name}; remove {name}",
            )
    # Such a term is permitted without a known load, because a diagnosis may find a load.
    if bears_load(campaign.model.friction) and not any(
        r.known_load and r.role == "fit" for r in campaign.recordings
    ):
        yield (
            ("model",),
            f"friction {campaign.model.friction} grows with the torque of a pendulum, but no "
            "recording with role fit has `gravity` or another known load; declare the load, or "
            "choose another `friction`",
        )
    for index, recording in enumerate(campaign.recordings):
        for loc, message in _check_recording(recording, campaign.bench):
            yield ("recordings", index, *loc), message
    yield from _check_clock(campaign)
    yield from _check_units(campaign)
    if all(recording.role == "validate" for recording in campaign.recordings):
        yield ("recordings",), "every recording has role validate; at least one must have role fit"
    yield from _check_validation(campaign)
    units = {_torque_unit(r, campaign.bench) for r in campaign.recordings}
    if len(units) > 1:
        yield (
            ("bench",),
            "some recordings contain torque and others only current; add torque_constant, or a "
            "torque channel to all recordings",
        )


def _check_units(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield recordings without a unit beside others with one, and parameters stated as both."""
    unnamed = [k for k, recording in enumerate(campaign.recordings) if not recording.unit]
    if 0 < len(unnamed) < len(campaign.recordings):
        yield ("recordings", unnamed[0], "unit"), "other recordings state a unit; state it here too"
    if both := {*campaign.model.shared} & {*campaign.model.per_unit}:
        yield ("model", "per_unit"), f"{', '.join(sorted(both))}: either shared or per unit"
    stated = [key for key in ("shared", "per_unit") if getattr(campaign.model, key)]
    if stated and unnamed:
        yield ("model", stated[0]), "needs the key `unit` in the recordings"


def _check_clock(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield recordings whose start time has another form than that of the first recording."""
    first = _way(campaign.recordings[0])
    for index, recording in enumerate(campaign.recordings):
        if (way := _way(recording)) != first:
            yield (
                ("recordings", index, "start"),
                f"{way}, but the first recording has {first}; recordings have a common clock only "
                "if all have `start`, as ISO times or as seconds",
            )


def _way(recording: RecordingSection) -> str:
    """Return how a recording states its time, as text."""
    if recording.start is None:
        return "no `start`"
    return "`start` as an ISO time" if isinstance(recording.start, str) else "`start` in seconds"


def _check_validation(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield loaded recordings for validation if the model would have no working load."""
    fitted = any(r.role == "fit" and r.stage == "loaded" for r in campaign.recordings)
    if fitted or campaign.model.held.keys() >= set(LOAD_PARAMETERS):
        return
    for index, recording in enumerate(campaign.recordings):
        if recording.role == "validate" and recording.stage == "loaded":
            yield (
                ("recordings", index, "role"),
                "a loaded recording has role validate, but no loaded recording has role fit, so "
                "that the working load would be unknown; fit a loaded recording, or fix "
                f"{', '.join(LOAD_PARAMETERS)}",
            )


def _torque_unit(recording: RecordingSection, bench: BenchSection) -> str:
    return (
        "torque"
        if "torque" in recording.channels or bench.torque_constant is not None
        else "amperes"
    )


def _check_recording(recording: RecordingSection, bench: BenchSection) -> Iterator[tuple[Loc, str]]:
    channels: Mapping[str, ChannelSection] = recording.channels
    if "time" not in channels and recording.rate is None:
        yield ("channels",), "no `time` channel and no `rate`; state the channel or the rate"
    if "time" in channels and recording.rate is not None:
        yield (
            ("rate",),
            "`rate` is allowed only for files without time; remove `rate` or the `time` channel",
        )
    if ANGLE_TIME in channels and "angle" not in channels:
        yield (
            ("channels", ANGLE_TIME),
            "time stamps of an encoder without its `angle`; add the channel `angle`",
        )
    if not channels.keys() & {"angle", "velocity", "motor_angle"}:
        yield ("channels",), "no `angle`, `velocity` or `motor_angle`; add at least one"
    if not channels.keys() & {"torque", "current", "voltage"}:
        yield from _check_burn(channels, bench)
    elif not channels.keys() & {"torque", "current"}:
        missing = [
            name for name in ("resistance", "back_emf_constant") if getattr(bench, name) is None
        ]
        if missing:
            yield (
                ("channels", "voltage"),
                "to compute the current from the voltage, I = (U - Ke omega_motor)/R, state "
                + " and ".join(f"bench.{name}" for name in missing),
            )
    if bench.motion == "linear" and recording.gravity is not None:
        yield (
            ("gravity",),
            "`gravity` is a weight that turns with the joint, which a linear bench cannot have; "
            "remove `gravity` or, if the bench is rotary, set bench.motion: rotary",
        )
    yield from _check_known_load(recording, bench)
    yield from _check_load(recording, bench)
    for name, channel in channels.items():
        if channel.unsigned:
            yield ("channels", name, "unsigned"), _UNSIGNED.get(name, _UNSIGNED_OTHER)
        if channel.wraps_after is not None and name not in ("angle", "motor_angle", "command"):
            yield (
                ("channels", name, "wraps_after"),
                "is allowed for `angle`, `motor_angle` and `command` only; remove it",
            )


_UNSIGNED_OTHER = "a magnitude without its sign cannot be used; remove the channel"
_UNSIGNED: Mapping[str, str] = {
    "current": (
        "a magnitude of the current has no sign, so that driving and braking cannot be "
        "distinguished; remove `current` and add either a signed `torque`, or `voltage` with "
        "bench.resistance and bench.back_emf_constant, from which the signed current "
        "I = (U - Ke omega_motor)/R is computed"
    )
}


def _check_known_load(
    recording: RecordingSection, bench: BenchSection
) -> Iterator[tuple[Loc, str]]:
    linear = bench.motion == "linear"
    if (hoisted := recording.hoisted) is not None:
        if linear and hoisted.radius is not None:
            yield (
                ("hoisted", "radius"),
                "on a linear bench the force of a hanging mass is -m g; remove `radius`",
            )
        if not linear and hoisted.radius is None:
            yield ("hoisted",), "no `radius` of the drum or pulley; state the radius, m"
    amperes = _torque_unit(recording, bench) == "amperes"
    for name in ("gravity", "hoisted", "constant_torque"):
        if amperes and getattr(recording, name):
            yield (
                (name,),
                "a known torque in N m has no use in a fit in amperes; add bench.torque_constant",
            )


def _check_burn(
    channels: Mapping[str, ChannelSection], bench: BenchSection
) -> Iterator[tuple[Loc, str]]:
    if "pressure" not in channels:
        yield (
            ("channels",),
            "no `torque`, `current` or `voltage`; add at least one of these channels, or "
            "`pressure` of a gas generator",
        )
    elif bench.gas_generator is None:
        yield (
            ("channels", "pressure"),
            "`pressure` without torque, current or voltage needs the constants of a gas generator; "
            "add bench.gas_generator ({} for the constants of the paper)",
        )
    elif "angle" not in channels:
        yield (
            ("channels",),
            "no `angle` of the valve, which determines the throat area; add this channel",
        )


def _check_load(recording: RecordingSection, bench: BenchSection) -> Iterator[tuple[Loc, str]]:
    loaded = recording.stage == "loaded"
    hot_fire = "pressure" in recording.channels and bench.gas_generator is not None
    if (
        loaded
        and recording.weight_mass == 0
        and "load_force" not in recording.channels
        and not hot_fire
    ):
        yield (
            ("stage",),
            "the stage is loaded, but weight_mass is 0 kg and there is no `load_force` "
            "channel; state weight_mass or `load_force`, or for a hot firing `pressure` and "
            "bench.gas_generator",
        )
    if loaded and bench.moment_arm is None and recording.moment_arm is None:
        yield (
            ("stage",),
            "the loaded stage needs bench.moment_arm (L1, m) to turn contact force into torque",
        )
    if recording.weight_mass > 0 and bench.lever_ratio is None:
        yield (
            ("weight_mass",),
            "a weight on the lever needs bench.lever_ratio (L3/L4), the ratio of contact force to "
            "weight; state 1 if the weight acts directly on the joint's arm",
        )
    if not loaded and recording.weight_mass > 0:
        yield (
            ("weight_mass",),
            "the stage is unloaded, but weight_mass is not 0; if a weight hung on the lever, set "
            "stage: loaded, otherwise weight_mass: 0",
        )
