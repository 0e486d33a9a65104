"""The table from the paper to the code: complete, once each, and every name in it exists."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from .names import found

ROOT = Path(__file__).parents[1]
ITEMS = (
    "eq. 1, Fig. 6, 7",
    "eq. 2-8, Fig. 1",
    "Fig. 3",
    "Fig. 2, 9",
    "Fig. 4",
    "eq. 9",
    "eq. 10-13, Fig. 8",
    "Fig. 5, 11",
    "eq. 14",
    "eq. 15, 16",
    "eq. 17, Fig. 10",
    "Sec. 4.1",
    "Sec. 4.2, Fig. 12, 13, Table 1, 2",
)
"""What the paper contains."""
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
        if "." in part:
            yield f"{kind} {part}"
        else:
            yield from (f"{kind} {n}" for n in range(int(first), int(last or first) + 1))


def test_every_row_stands_there_once() -> None:
    assert Counter(item for item, _, _ in rows()) == Counter(ITEMS)


def test_no_equation_figure_or_table_is_left_out() -> None:
    listed = Counter(number for item in ITEMS for number in numbers(item))
    wanted = (
        [f"eq. {n}" for n in range(1, 18)]
        + [f"Fig. {n}" for n in range(1, 14)]
        + ["Table 1", "Table 2"]
    )
    assert listed == Counter([*wanted, "Sec. 4.1", "Sec. 4.2"])


@pytest.mark.parametrize("item", ITEMS)
def test_its_code_and_its_tests_exist(item: str) -> None:
    code, tests = next((code, tests) for name, code, tests in rows() if name == item)
    names, shown = _CODE.findall(code), _TEST.findall(tests)
    assert names
    assert shown
    # Nothing stands in the cells but names.
    assert len(names) == code.count("`") // 2
    assert len(shown) == tests.count("`") // 2
    for name in names:
        assert callable(found(name)), name
    for file, test in shown:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert test in {
            node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
        }, test
