import runpy
from pathlib import Path
from typing import Annotated, Literal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field, PositiveFloat

import rig
from rig.common import yaml_tree
from rig.common.errors import InputError
from rig.common.yaml_tree import MAX_BYTES, DocumentError, parse
from rig.config.configuration import Schema, load_located


class Move(Schema):
    kind: Literal["move"]
    speed: PositiveFloat
    tags: tuple[str, ...] = ()


class Wait(Schema):
    kind: Literal["wait"]
    time: float


class Plan(Schema):
    name: str = "plan"
    count: int = 1
    gain: float = 1.0
    file: str | tuple[str, ...] = "a"
    stages: tuple[Annotated[Move | Wait, Field(discriminator="kind")], ...] = ()


def load(path: Path) -> Plan:
    return load_located(path, Plan).value


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "plan.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def problems(folder: Path, text: str | bytes) -> list[str]:
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value) == "\n".join(caught.value.problems)
    assert all(line.startswith(f"{path}:") for line in caught.value.problems)
    return [line.removeprefix(f"{path}:") for line in caught.value.problems]


PACKAGED = sorted(Path(rig.__file__).parent.rglob("*.yaml"))


def test_without_libyaml_the_trees_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml, "__with_libyaml__", False)
    slow = runpy.run_path(yaml_tree.__file__)["parse"]
    assert len(PACKAGED) > 10
    for path in PACKAGED:
        assert repr(slow(path.read_text())) == repr(parse(path.read_text())), path


@pytest.mark.parametrize(
    ("written", "value"),
    [("1e3", 1000.0), ("1E-4", 1e-4), ("-2.5e+1", -25.0), (".5", 0.5), ("7", 7.0), ("0x10", 16.0)],
)
def test_numbers_are_numbers(tmp_path: Path, written: str, value: float) -> None:
    assert load(write(tmp_path, f"gain: {written}\n")).gain == value


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "2020-01-01", "1:30", "<<"])
def test_words_stay_words(tmp_path: Path, word: str) -> None:
    assert load(write(tmp_path, f"name: {word}\n")).name == word


@pytest.mark.parametrize("wrong", ["true", '"5"', "[1]", "null", ".nan", ".inf"])
def test_a_number_is_not_guessed_from_something_else(tmp_path: Path, wrong: str) -> None:
    (line,) = problems(tmp_path, f"gain: {wrong}\n")
    assert line.startswith("1:7: gain: ")


def test_every_error_at_once_with_its_place(tmp_path: Path) -> None:
    text = (
        "stages:\n"
        "  - {kind: move, speed: -1, tgas: [x]}\n"
        "  - {kind: wait}\n"
        "  - {kind: jump}\n"
        "  - {speed: 1}\n"
        "count: 1.5\n"
        "nmae: x\n"
        "file: 3\n"
        "count: 2\n"
    )
    assert problems(tmp_path, text) == [
        "2:25: stages[0].speed: input should be greater than 0 (got -1)",
        "2:29: stages[0].tgas: unknown key; did you mean 'tags'?",
        "3:5: stages[1].time: missing; this key is required",
        "4:12: stages[2].kind: input tag 'jump' found using 'kind' does not match any of the "
        "expected tags: 'move',"
        " 'wait' (got \"jump\")",
        "5:5: stages[3].kind: missing; this key is required",
        "6:8: count: input should be a valid integer (got 1.5)",
        "7:1: nmae: unknown key; did you mean 'name'?",
        "8:7: file: input should be a valid string or input should be a valid array (got 3)",
        "9:1: count: duplicate key 'count', first given on line 6; remove one",
    ]


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("", "1:1", "the file is empty"),
        ("- 1\n", "1:1", "top level must be a mapping"),
        ("name:\n\tx: 1\n", "2:1", "a tab character; indent with spaces"),
        (b"name: x\ngain: \xff\n", "2:7", "byte 0xFF is not UTF-8"),
        ("a: 1\nname: \x01\n", "2:7", "U+0001 is not allowed"),
        ("name: a\n---\nname: b\n", "2:1", "a second document"),
        ("name: &x [*x]\n", "1:7", "refers to a value that contains this alias"),
        ("name: " + "[" * 500, "1:46", "nested deeper"),
        ("name: !!python/name:os.getcwd x\n", "1:7", "is not allowed"),
        ("? [1]\n: 2\n", "1:3", "a key must be plain text"),
        ("count: " + "9" * 5000, "1:8", "is not a usable int"),
    ],
)
def test_documents_that_are_none(tmp_path: Path, text: str | bytes, place: str, words: str) -> None:
    (line,) = problems(tmp_path, text)
    assert line.startswith(f"{place}: ")
    assert words in line


def test_aliases_work_until_they_explode(tmp_path: Path) -> None:
    plan = load(write(tmp_path, "stages: [&a {kind: wait, time: 1}, *a]\n"))
    assert plan.stages[0] == plan.stages[1]
    bomb = "a0: &a0 [x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9)
    )
    (line,) = problems(tmp_path, bomb)
    assert "use fewer aliases" in line


def test_size_is_bounded(tmp_path: Path) -> None:
    (line,) = problems(tmp_path, "#" * (MAX_BYTES + 1))
    assert f"at most {MAX_BYTES} bytes" in line
    assert load(write(tmp_path, "gain: 2\n" + "#" * (MAX_BYTES - 8))).gain == 2


def test_byte_order_mark_and_windows_lines(tmp_path: Path) -> None:
    assert load(write(tmp_path, b"\xef\xbb\xbfname: x\r\ngain: 2\r\n")).gain == 2


def test_missing_file_names_its_neighbours(tmp_path: Path) -> None:
    write(tmp_path, "name: x\n")
    with pytest.raises(
        InputError, match=r"paln\.yaml:1:1: document: no such file; beside it: plan\.yaml"
    ):
        load(tmp_path / "paln.yaml")
    with pytest.raises(InputError, match="is a folder"):
        load(tmp_path)
    with pytest.raises(InputError, match="does not exist either"):
        load(tmp_path / "no" / "plan.yaml")


def test_a_later_check_points_into_the_file(tmp_path: Path) -> None:
    document = load_located(write(tmp_path, "stages:\n  - kind: move\n    speed: 9\n"), Plan)
    path = document.path
    assert document.problem(("stages", 0, "speed"), "above 5 rad/s") == (
        f"{path}:3:12: stages[0].speed: above 5 rad/s (got 9)"
    )
    assert document.problem(("stages", 0, "tags"), "none") == f"{path}:2:5: stages[0].tags: none"
    assert document.problem(("gain",), "low", 1.0) == f"{path}:1:1: gain: low (got 1.0)"
    document.require([])
    with pytest.raises(InputError) as caught:
        document.require([(("gain",), "low"), (("stages", 0, "speed"), "high")])
    assert len(caught.value.problems) == 2


# Digits are left out of text: PyYAML writes "1e3" unquoted because YAML 1.1 reads it as text, and
# here it is a number.
words = st.text(st.characters(exclude_categories=["Nd", "Cs"]), max_size=8)
plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**12), 10**12) | st.floats(allow_nan=False) | words,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=8,
)


@settings(deadline=None)
@given(st.dictionaries(st.text(min_size=1, max_size=6), plain, min_size=1, max_size=4))
def test_what_yaml_dumps_is_read_back(data: dict[str, object]) -> None:
    root, duplicates = parse(yaml.safe_dump(data, allow_unicode=False))
    assert duplicates == []
    assert root.plain() == data


@settings(deadline=None)
@given(st.text(max_size=60))
def test_any_text_gives_a_tree_or_a_document_error(text: str) -> None:
    try:
        root, _ = parse(text)
    except DocumentError as error:
        mark = error.mark
    else:
        mark = root.mark
    assert mark.line >= 1
    assert mark.column >= 1
