"""The script behind ``make structure``: both sides of each budget, on small trees of files."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[1] / "tools" / "structure.py"


@pytest.fixture(scope="module")
def structure() -> ModuleType:
    spec = importlib.util.spec_from_file_location("structure", SCRIPT)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up by name.
    sys.modules["structure"] = module
    spec.loader.exec_module(module)
    return module


def tree(root: Path, files: dict[str, str]) -> Path:
    for package in ("drivers", "identification", "rig"):
        files.setdefault(f"{package}/__init__.py", "")
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def found(structure: ModuleType, root: Path, *budgets: str) -> list[tuple[str, str]]:
    return [
        (item.budget, item.where)
        for item in structure.report(root)[2]
        if not budgets or item.budget in budgets
    ]


@pytest.mark.parametrize(
    ("lines", "users", "broken"),
    [
        (149, 2, []),
        (150, 1, []),
        (150, 0, []),
        (149, 1, [("thin modules", "rig.a.m")]),
        (10, 0, [("thin modules", "rig.a.m")]),
    ],
)
def test_a_module_has_two_importers_or_150_lines(
    structure: ModuleType, tmp_path: Path, lines: int, users: int, broken: list[object]
) -> None:
    full = "x = 1\n" * 150
    files = {"rig/a/m.py": "x = 1\n" * lines}
    files |= {f"rig/u{n}.py": f"from rig.a import m\n{full}" for n in range(users)}
    assert found(structure, tree(tmp_path, files)) == broken


@pytest.mark.parametrize(("single", "broken"), [(2, []), (3, [("thin rooms", "rig.a")])])
def test_a_room_of_files_with_one_importer(
    structure: ModuleType, tmp_path: Path, single: int, broken: list[object]
) -> None:
    full = "x = 1\n" * 150
    files = {f"rig/a/m{n}.py": full for n in range(4)}
    users = "".join(f"import rig.a.m{n}\n" for n in range(4 - single))
    files |= {"rig/b.py": users + full, "rig/c.py": users + full}
    assert found(structure, tree(tmp_path, files)) == broken


@pytest.mark.parametrize(
    "text",
    [
        "from rig.b import x\n",
        "import rig.b.c\n",
        "from ..b import c\n",
        "def f():\n    from rig.b import c\n",
    ],
)
def test_rooms_that_import_one_another(structure: ModuleType, tmp_path: Path, text: str) -> None:
    root = tree(
        tmp_path,
        {
            "rig/a/__init__.py": "",
            "rig/a/m.py": text,
            "rig/b/__init__.py": "x = 1\n",
            "rig/b/c.py": "",
        },
    )
    assert found(structure, root, "two-way ties") == []
    (root / "rig/b/c.py").write_text("from rig.a import m\n")
    assert found(structure, root, "two-way ties") == [("two-way ties", "rig.a - rig.b")]


def test_an_arrow_against_the_declared_order(structure: ModuleType, tmp_path: Path) -> None:
    contract = (
        '[[tool.importlinter.contracts]]\ntype = "layers"\nlayers = ["rig", "drivers | '
        'identification"]\n'
    )
    root = tree(
        tmp_path, {"pyproject.toml": contract, "rig/a.py": "import drivers.b\n", "drivers/b.py": ""}
    )
    assert found(structure, root, "upward arrows") == []
    (root / "drivers/b.py").write_text("import identification\n")
    assert found(structure, root, "upward arrows") == [("upward arrows", "drivers.b")]
    (root / "drivers/b.py").write_text("import rig\n")
    assert ("upward arrows", "drivers.b") in found(structure, root)


def test_sizes_are_counted(structure: ModuleType, tmp_path: Path) -> None:
    files = {
        "rig/a.py": "x = 1\n" * 3,
        "tests/rig/test_a.py": "x = 1\n" * 5,
        "README.md": "three more words",
        "docs/guides/a.md": "two words",
        "docs/reference/a.md": "generated",
    }
    counts = structure.report(tree(tmp_path, files))[1]
    assert counts["product lines"] == 3
    assert counts["product files"] == 4
    assert counts["test lines"] == 5
    assert counts["words of documentation"] == 5


def test_a_budget_is_held_up_to_its_count(structure: ModuleType) -> None:
    assert structure.judge(structure.BUDGETS, [])[1] is True
    for budget, most in structure.BUDGETS.items():
        assert structure.judge({budget: most + 1}, [])[1] is False
