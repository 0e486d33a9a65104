"""JSON Schemas of the files that a user writes: for editors, and for programs that make such files.

The schemas are generated from the records into which the program reads the files. A schema refuses
unknown keys, wrong types and values outside their range. A schema cannot check relations between
values or the existence of files; the program makes these checks. A schema accepts every file that
the program accepts, except files with wrong values under ``defaults`` that every recording, or
every row of a table, overrides.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from pydantic import BaseModel, TypeAdapter

from drivers.mock.plant.effects.pack import GAS_KNOWN, KNOWN
from drivers.mock.plant.parts.constants import Machine
from identification.model.parameters import LADDER
from identification.recording import CHANNELS
from rig.config.bench import Bench
from rig.config.campaign import Campaign
from rig.config.campaign_sections import ANGLE_TIME, FITTED_TERMS, PARAMETERS
from rig.config.faults import COUNTED_FRAMES, FAULTS, FaultSchedule
from rig.config.sequence import Sequence
from rig.config.simulated_machine import may_be

SUFFIXES: Mapping[str, str] = {
    "N_m_s_rad": "N m s/rad",
    "V_s_rad": "V s/rad",
    "N_m_A": "N m/A",
    "kg_m2": "kg m^2",
    "kg_m3": "kg/m^3",
    "deg_s2": "deg/s^2",
    "rad_s2": "rad/s^2",
    "m_s2": "m/s^2",
    "deg_s": "deg/s",
    "rad_s": "rad/s",
    "s_rad": "s/rad",
    "kg_s": "kg/s",
    "mm_s": "mm/s",
    "m_s": "m/s",
    "J_kg": "J/kg",
    "V_A": "V/A",
    "1_s": "1/s",
    "N_m": "N m",
    "deg": "deg",
    "rad": "rad",
    "ohm": "ohm",
    "MPa": "MPa",
    "Pa": "Pa",
    "Hz": "Hz",
    "kg": "kg",
    "ms": "ms",
    "us": "us",
    "m3": "m^3",
    "A": "A",
    "C": "deg C",
    "H": "H",
    "K": "K",
    "N": "N",
    "V": "V",
    "m": "m",
    "s": "s",
}
"""Unit for each suffix of a field's name, the longest suffix first."""
_NO_UNIT = frozenset({"mu_s"})
"""Names from the paper with an ending that looks like a unit but is not a unit."""
UNITS = frozenset(
    {*SUFFIXES.values(), "kg/m^3", "N m", "deg C", "N s/m", "s/m", "bytes", "ns", "deg/s^2", "Bd"}
)
_ENTRY = re.compile(r"^(\w+):\s+(.*)$")
_SECTION = re.compile(r"^[A-Z]\w+:$")


class Meaning(NamedTuple):
    """Description and unit of one field."""

    text: str
    unit: str


def summary(docstring: str) -> str:
    """Return the description of a record: its docstring before the list of fields."""
    lines = inspect.cleandoc(docstring).split("\n")
    end = next((n for n, line in enumerate(lines) if _SECTION.match(line)), len(lines))
    return "\n".join(lines[:end]).strip()


def meanings(record: type) -> dict[str, Meaning]:
    """Return the meanings of a record's fields, including inherited fields, from the docstrings."""
    found: dict[str, Meaning] = {}
    for base in reversed(record.__mro__):
        found |= _attributes(base.__dict__.get("__doc__") or "")
    return found


def _attributes(docstring: str) -> dict[str, Meaning]:
    """Return the meaning of each field in the section ``Attributes:``."""
    found: dict[str, str] = {}
    name, inside = "", False
    for line in inspect.cleandoc(docstring).split("\n"):
        if _SECTION.match(line):
            inside = line == "Attributes:"
        elif inside and line.strip():
            deep = len(line) - len(line.lstrip()) > len("    ")
            entry = None if deep else _ENTRY.match(line.strip())
            if entry is not None:
                name = entry[1]
                found[name] = entry[2]
            elif name:
                found[name] += f" {line.strip()}"
    return {name: _meaning(name, text) for name, text in found.items()}


def _meaning(name: str, text: str) -> Meaning:
    text = text.replace("``", "`")
    first = re.match(r"[^.;]*(?:\.\d[^.;]*)*", text)
    head = "" if first is None else first[0]
    before, _, unit = head.rpartition(", ")
    if unit in UNITS:
        return Meaning(before + text[len(head) :], unit)
    return Meaning(text, unit_of(name))


def unit_of(name: str) -> str:
    """Return the unit from the suffix of a name; empty if the name states no unit."""
    if name in _NO_UNIT:
        return ""
    return next((unit for ending, unit in SUFFIXES.items() if name.endswith(f"_{ending}")), "")


Tree = dict[str, Any]
_LINK: Final = re.compile(r"\s*\[[^\]]+\]\([^)]+\.md\)\.?")
_SHORT_WINDOW: Final = {
    "type": "array",
    "items": {"type": ["number", "null"]},
    "minItems": 2,
    "maxItems": 2,
    "description": "[from, to], s; null leaves an end open.",
}
_TABLE: Final = {
    "anyOf": [
        {"type": "string", "description": "CSV file, relative to this file."},
        {"type": "array", "items": {"type": "array"}, "minItems": 2},
    ],
    "description": "Rows of recordings; the header names keys, such as `file` or `gravity.mass`.",
}
KINDS: Final[Mapping[str, type[BaseModel]]] = {
    "bench": Bench,
    "sequence": Sequence,
    "campaign": Campaign,
    "faults": FaultSchedule,
}
"""Record classes by kind of file."""
DIALECT: Final = "http://json-schema.org/draft-07/schema#"
"""Schema dialect with the best support in YAML editors."""
_SHORT_CHANNEL: Final = {
    "type": ["string", "integer"],
    "description": "Column, by name or by index from 0.",
}


def json_schema(kind: str) -> Tree:
    """Return the JSON Schema of one kind of file."""
    tree = KINDS[kind].model_json_schema(ref_template="#/definitions/{model}")
    definitions: Tree = tree.pop("$defs", {})
    for node in (tree, *definitions.values()):
        _describe(node)
    _REFINED[kind](tree, definitions)
    schema = {
        "$schema": DIALECT,
        "$id": f"urn:loadrig:{kind}:1",
        **tree,
        "title": f"loadrig {kind} file",
        "definitions": definitions,
    }
    _walk(schema, _tidy)
    return schema


def _describe(node: Tree) -> None:
    """Add descriptions and units from a record's docstring, and forbid unknown keys."""
    docstring = node.get("description", "")
    node["description"] = _plain(summary(docstring))
    node["additionalProperties"] = False
    known = _attributes(docstring)
    for name, key in node.get("properties", {}).items():
        if name in known:
            key["description"] = describe(known[name])


def describe(meaning: Meaning) -> str:
    """Return the meaning of a key with its unit, in one paragraph."""
    text = _plain(meaning.text)
    if not meaning.unit:
        return text
    return f"{text if text.endswith('.') else f'{text}.'} Unit: {meaning.unit}."


def _plain(text: str) -> str:
    return _LINK.sub("", " ".join(text.replace("``", "`").split()))


def _walk(node: Any, change: Callable[[Tree], None]) -> None:
    if isinstance(node, dict):
        change(node)
        for child in node.values():
            _walk(child, change)
    elif isinstance(node, list):
        for child in node:
            _walk(child, change)


def _tidy(node: Tree) -> None:
    """Use only keywords of draft 7; as ``oneOf`` overlapping branches would refuse good files."""
    if isinstance(branches := node.get("oneOf"), list) and any("$ref" in item for item in branches):
        node["anyOf"] = node.pop("oneOf")
    node.pop("discriminator", None)
    if isinstance(node.get("title"), str) and "$schema" not in node:
        del node["title"]
    if isinstance(items := node.get("prefixItems"), list):
        node["items"] = node.pop("prefixItems")
        node["additionalItems"] = False
        assert items


def _bench(tree: Tree, definitions: Tree) -> None:
    for name in ("Machine", *TypeAdapter(Machine).json_schema()["$defs"]):
        for key, node in definitions[name]["properties"].items():
            _bound(node, may_be(key))
    definitions["Machine"]["properties"]["effects"] = _effects()
    definitions["Machine"]["properties"]["plant"] |= {
        "properties": {name: {"type": "string"} for name in ("python", "class", "fmu")},
        "additionalProperties": False,
        "anyOf": [{"required": ["python", "class"]}, {"required": ["fmu"]}, {"maxProperties": 0}],
    }
    # The interface distinguishes the kinds of bus; as free text, it would match every kind.
    definitions["Bus"]["properties"]["interface"]["not"] = {"const": "epos_serial"}
    definitions["ServoSection"]["not"] = {
        "properties": {"kind": {"const": "dbc"}},
        "required": ["kind"],
    }


def _bound(node: Tree, sign: str) -> None:
    for target in node.get("anyOf", [node]):
        if target.get("type") not in ("number", "integer") or "enum" in target:
            continue
        if sign == "> 0":
            target["exclusiveMinimum"] = 0
        elif sign:
            target["minimum"] = 0


def _effects() -> Tree:
    """Return the schema of the effects that can be injected into a simulated machine."""
    effects = {
        name: {
            "type": "object",
            "properties": {
                key: {"type": "number", "minimum": limit.low, "maximum": limit.high}
                for key, limit in parameters.items()
            },
            "required": list(parameters),
            "additionalProperties": False,
        }
        for name, parameters in {**KNOWN, **GAS_KNOWN}.items()
    }
    return {
        "type": "object",
        "description": "Injected effects of the simulated machine: effect, parameter, value.",
        "properties": effects,
        "additionalProperties": False,
    }


def _sequence(_tree: Tree, definitions: Tree) -> None:
    stage = definitions["StageSection"]
    stage["allOf"] = [
        _when("stage", "unloaded", {"properties": {"weight_kg": {"const": 0}}}),
        _when(
            "stage",
            "loaded",
            {"properties": {"weight_kg": {"exclusiveMinimum": 0}}, "required": ["weight_kg"]},
        ),
        _when("stage", "hot_fire", {"properties": {"weight_kg": {"const": 0}}}),
    ]
    stage["anyOf"] = [{"required": [name]} for name in ("tones", "ramp", "flow")]


def _when(key: str, value: str, then: Tree) -> Tree:
    return {"if": {"properties": {key: {"const": value}}, "required": [key]}, "then": then}


def _campaign(tree: Tree, definitions: Tree) -> None:
    model = definitions["ModelSection"]["properties"]
    model["friction"]["enum"] = list(LADDER)
    model["terms"]["items"] = {"enum": list(FITTED_TERMS)}
    model["fixed"] = {
        "type": "object",
        "description": model["fixed"].get("description", ""),
        "properties": {
            name: {
                "anyOf": [
                    {"type": "number", **({} if name == "offset" else {"minimum": 0})},
                    {"$ref": "#/definitions/UncertainNumber"},
                ]
            }
            for name in PARAMETERS
        },
        "additionalProperties": False,
    }
    channel = {"anyOf": [_SHORT_CHANNEL, {"$ref": "#/definitions/ChannelSection"}]}
    units = {**CHANNELS, ANGLE_TIME: "s"}
    channels = definitions["RecordingSection"]["properties"]["channels"]
    channels["properties"] = {
        name: {**channel, "description": f"In {unit}, after scale and offset."}
        for name, unit in units.items()
    }
    channels["additionalProperties"] = False
    channels.pop("propertyNames", None)
    window = definitions["RecordingSection"]["properties"]["window"]
    window["anyOf"].append(_SHORT_WINDOW)
    _add_partial(definitions, "RecordingSection")
    partial = {"$ref": f"#/definitions/{_PART}RecordingSection"}
    tree["properties"]["defaults"] = {
        **partial,
        "description": tree["properties"]["defaults"].get("description", ""),
    }
    entry = definitions[f"{_PART}RecordingSection"]
    definitions["TableEntry"] = {
        **entry,
        "description": "One recording for each row of a table; other keys apply to every row.",
        "properties": {"table": _TABLE, **entry["properties"]},
        "required": ["table"],
    }
    table = {"$ref": "#/definitions/TableEntry"}
    recordings = tree["properties"]["recordings"]
    items = recordings.pop("items")
    listed = {key: recordings.pop(key) for key in ("type", "minItems") if key in recordings}
    recordings["anyOf"] = [listed, table]
    # A key missing in a recording may be given under `defaults`.
    tree["if"] = {"required": ["defaults"]}
    tree["then"] = {"properties": {"recordings": {"items": {"anyOf": [partial, table]}}}}
    tree["else"] = {"properties": {"recordings": {"items": {"anyOf": [items, table]}}}}


_PART: Final = "Partial"
_REFERENCE: Final = re.compile(r'(?<="#/definitions/)\w+')


def _add_partial(definitions: dict[str, Tree], name: str) -> None:
    """Add copies of a record and of the records below it, in which no key is required."""
    if (copy := f"{_PART}{name}") in definitions:
        return
    text = json.dumps({key: each for key, each in definitions[name].items() if key != "required"})
    definitions[copy] = json.loads(_REFERENCE.sub(rf"{_PART}\g<0>", text))
    for below in _REFERENCE.findall(text):
        _add_partial(definitions, below)


def _faults(_tree: Tree, definitions: Tree) -> None:
    row, frames = definitions["FaultRow"], definitions["Frames"]
    by_target: dict[str, dict[str, str]] = {}
    for (target, fault), kind in FAULTS.items():
        by_target.setdefault(target, {})[fault] = kind.meaning
    row["allOf"] = [
        _when("target", target, {"properties": {"fault": {"enum": list(faults)}}})
        for target, faults in by_target.items()
    ]
    row["anyOf"] = [{"required": [name]} for name in ("time_s", "phase", "state")]
    frames["properties"]["function"]["enum"] = [*COUNTED_FRAMES, None]


_REFINED: Final[Mapping[str, Callable[[Tree, Tree], None]]] = {
    "bench": _bench,
    "sequence": _sequence,
    "campaign": _campaign,
    "faults": _faults,
}
