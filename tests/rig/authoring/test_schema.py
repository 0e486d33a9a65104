"""The JSON Schemas accept what the program accepts, and refuse what an editor can know."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from rig.cli.authoring.schema import KINDS, json_schema
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.yaml_tree import Mark, Node, parse
from rig.config import configuration
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.configuration import names, resolve
from rig.config.faults import load_faults
from rig.config.sequence import load_sequence

CAMPAIGNS = sorted((Path(__file__).parents[2] / "campaigns").glob("*.yaml"))
FAULTS = """\
faults: 1
rows:
  - {phase: excite, after_s: 0.25, target: encoder, fault: jump, value: 5,
     expect: {deenergised_within_s: 0.1, exit_status: 1, words: encoder against drive}}
  - {time_s: 1, target: bus, fault: lost, count: 3, frames: {device: drive, function: motion}}
"""
FILES = [
    *(("bench", resolve(name, "benches")) for name in names("benches")),
    *(("sequence", resolve(name, "sequences")) for name in names("sequences")),
    *(("campaign", path) for path in CAMPAIGNS),
]
LOADERS = {
    "bench": load_bench,
    "sequence": load_sequence,
    "campaign": load_campaign,
    "faults": load_faults,
}


def plain(text: str) -> Any:
    return parse(text)[0].plain()


@cache
def validator(kind: str) -> Draft7Validator:
    schema = json_schema(kind)
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


def node(tree: Any) -> Node:
    """Return what the parser makes of a tree, all of it at one place."""
    at = Mark(1, 1)
    if isinstance(tree, dict):
        return Node({k: node(child) for k, child in tree.items()}, at, dict.fromkeys(tree, at))
    return Node([node(child) for child in tree] if isinstance(tree, list) else tree, at, {})


@pytest.fixture
def trees_from_json(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the program read the mutants, which are JSON, without the slow YAML parser."""
    monkeypatch.setattr(configuration, "parse", lambda text: (node(json.loads(text)), []))


def accepted(kind: str, tree: Any, folder: Path) -> bool:
    """Whether the program takes a file."""
    path = folder / "mutant.yaml"
    path.write_text(json.dumps(tree))
    try:
        LOADERS[kind](path)
    except InputError:
        return False
    return True


SESSION = """\
campaign: 1
bench: {torque_constant: {value: 0.03, std: 0.003}, gear_ratio: 100}
model: {fixed: {J: {value: 0.2, std: 0.02}, Mc: 5}}
defaults: {channels: {time: t, current: i, motor_angle: phi}}
recordings:
  - {file: a.csv, start: 0, window: {from: 2}, hoisted: {mass: 2, radius: 0.1}}
  - {file: b.csv, start: 500.5, window: [null, 20], constant_torque: -1}
  - table: [[file, start, weight_mass], [c.csv, 900, 0]]
    gravity: {mass: 2, length: 0.1, zero: {value: 0.1, std: 0.01}}
"""


def test_a_session_with_a_table_is_valid(tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(SESSION)
    load_campaign(tmp_path / "c.yaml")
    check, tree = validator("campaign"), plain(SESSION)
    assert [error.message for error in check.iter_errors(tree)] == []
    assert check.is_valid({**tree, "recordings": {"table": "files.csv"}})
    for wrong in ({"tabel": "files.csv"}, {"table": 5}, [{"table": "f.csv", "fill": "a.csv"}]):
        assert not check.is_valid({**tree, "recordings": wrong})


@pytest.mark.parametrize(
    ("kind", "path"), FILES, ids=lambda item: item.stem if isinstance(item, Path) else item
)
def test_files_of_this_repository_are_valid(kind: str, path: Path) -> None:
    errors = list(validator(kind).iter_errors(plain(path.read_text())))
    assert [f"{list(error.absolute_path)}: {error.message}" for error in errors] == []


def mappings(tree: Any) -> Iterator[dict[str, Any]]:
    if isinstance(tree, dict):
        yield tree
        for child in tree.values():
            yield from mappings(child)
    elif isinstance(tree, list):
        for child in tree:
            yield from mappings(child)


def kinds(tree: Any) -> list[dict[str, Any]]:
    """Return the mappings of a tree; of entries of one list with the same keys the first."""
    found: dict[tuple[object, ...], dict[str, Any]] = {}

    def walk(item: Any, path: tuple[str, ...]) -> None:
        if isinstance(item, dict):
            found.setdefault((path, *sorted(item)), item)
            for key, child in item.items():
                walk(child, (*path, key))
        elif isinstance(item, list):
            for child in item:
                walk(child, path)

    walk(tree, ())
    return list(found.values())


MUTATED = (
    "practical_hot",
    "practical_dbc",
    "practical_serial",
    "figure10",
    "hotfire",
    "emps",
    "sts3032_to_heavy",
)
"""Files that have every section between them."""


def sources() -> list[Any]:
    chosen = [(kind, path) for kind, path in FILES if path.stem in MUTATED]
    texts = [("faults", FAULTS), ("campaign", SESSION)]
    return [(kind, plain(path.read_text())) for kind, path in chosen] + [
        (kind, plain(text)) for kind, text in texts
    ]


@pytest.mark.parametrize(
    ("kind", "tree"), sources(), ids=lambda item: item if isinstance(item, str) else ""
)
def test_an_unknown_key_is_refused_wherever_it_stands(kind: str, tree: Any) -> None:
    check = validator(kind)
    assert check.is_valid(tree)
    for place in list(mappings(tree)):
        if set(place) & {"DRV_Command.Order", "Code", "DRV_Command", "disabled"}:
            continue  # Names of a DBC file, or words for its states: any name may stand there.
        place["no_such_key"] = 1
        assert not check.is_valid(tree), place
        del place["no_such_key"]
    assert check.is_valid(tree)


OTHERS = (None, -1, 0, 1, 2.5, "text", [], {}, "absent")


def test_mutants_are_the_same_read_as_yaml_or_as_json() -> None:
    for tree in (*(tree for _, tree in sources()), {"others": list(OTHERS)}):
        text = json.dumps(tree)
        read, duplicates = parse(text)
        assert repr(read.plain()) == repr(node(json.loads(text)).plain()) == repr(tree)
        assert duplicates == []


@pytest.mark.usefixtures("trees_from_json")
@pytest.mark.parametrize(
    ("kind", "tree"), sources(), ids=lambda item: item if isinstance(item, str) else ""
)
def test_the_schema_refuses_nothing_that_the_program_accepts(kind, tree, tmp_path):
    """Each value in turn is left out and replaced; the schema is never the harder judge."""
    check, judged = validator(kind), 0
    defaults = tree.get("defaults")
    for place in kinds(tree):
        if place is defaults:
            continue  # The program never looks at a default that every recording overrides.
        for key, right in list(place.items()):
            for other in OTHERS[:: 4 if len(place) > 6 else 1]:
                if other == "absent":
                    del place[key]
                else:
                    place[key] = other
                if not check.is_valid(tree):
                    judged += 1
                    assert not accepted(kind, tree, tmp_path), (key, other)
                place[key] = right
    assert judged > 10


@pytest.mark.parametrize(
    ("kind", "name", "path", "value"),
    [
        ("bench", "practical", ("machine", "gear_ratio"), "100"),
        ("bench", "practical", ("limits", "lateness_ms"), 51),
        ("bench", "practical", ("mock", "effects"), {"backlash": {"gap_rad": 5}}),
        ("bench", "practical_serial", ("bus", "port"), 5),
        ("sequence", "figure10", ("stages", 0, "weight_kg"), 5),
        ("sequence", "figure10", ("stages", 0, "name"), "a b"),
    ],
)
def test_values_that_are_refused(kind, name, path, value, tmp_path):
    tree = plain(resolve(name, "benches" if kind == "bench" else "sequences").read_text())
    assert validator(kind).is_valid(tree)
    place = tree
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert not validator(kind).is_valid(tree)
    assert not accepted(kind, tree, tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_of_a_record_is_described(kind: str) -> None:
    schema = json_schema(kind)
    records = [schema, *schema["definitions"].values()]
    lacking = [
        f"{record['description'][:30]}: {key}"
        for record in records
        for key, node in record.get("properties", {}).items()
        if not node.get("description")
    ]
    assert lacking == []


def test_one_schema_goes_to_the_terminal_and_all_to_a_folder(tmp_path, capsys):
    assert status(["schema", "bench"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema("bench")
    assert status(["schema", "--out", str(tmp_path / "schemas")]) == 0
    written = {path.name: json.loads(path.read_text()) for path in (tmp_path / "schemas").iterdir()}
    assert written == {f"{kind}.schema.json": json_schema(kind) for kind in KINDS}
    assert status(["schema"]) == 2
    assert "bench, sequence, campaign, faults" in capsys.readouterr().err
