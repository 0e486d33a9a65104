"""The table from the paper to the code: nothing is left out, every name exists."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from .names import found

ROOT = Path(__file__).parents[1]
_TEST = re.compile(r"`(tests/[a-z0-9_/]+\.py)::(test_[a-z0-9_]+)`")
_CODE = re.compile(r"`((?:drivers|identification|rig)(?:\.[A-Za-z_0-9]+)+)`")


def rows() -> list[tuple[str, str, str]]:
    """Item, code and tests of each row."""
    page = (ROOT / "docs" / "paper_to_code.md").read_text(encoding="utf-8")
    cells = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")]
    return [(item.split(":")[0], code, tests) for item, code, tests in cells[2:]]


def numbers(items: str) -> Iterator[str]:
    """Every single item of "eq. 2-8, Fig. 1": eq. 2 ... eq. 8, Fig. 1."""
    kind = ""
    for part in items.split(", "):
        if " " in part:
            kind, part = part.split(" ")
        first, _, last = part.partition("-")
        if "." not in part:
            yield from (f"{kind} {n}" for n in range(int(first), int(last or first) + 1))


def test_no_equation_figure_or_table_is_left_out() -> None:
    counts = {"eq.": 17, "Fig.": 13, "Table": 2}
    wanted = [f"{kind} {n}" for kind, count in counts.items() for n in range(1, count + 1)]
    assert sorted(number for item, _, _ in rows() for number in numbers(item)) == sorted(wanted)


@pytest.mark.parametrize(("code", "tests"), [row[1:] for row in rows()])
def test_its_code_and_its_tests_exist(code: str, tests: str) -> None:
    names, shown = _CODE.findall(code), _TEST.findall(tests)
    assert names
    assert shown
    for name in names:
        assert callable(found(name)), name
    for file, test in shown:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert test in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
