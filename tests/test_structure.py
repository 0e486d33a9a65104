"""The script behind ``make structure``: both sides of each bound, on small trees of files."""

from __future__ import annotations

import importlib.util
import subprocess
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


def found(structure: ModuleType, root: Path) -> list[tuple[str, str]]:
    return [(item.bound, item.where) for item in structure.report(root)[1]]


def test_a_tree_within_all_bounds(structure: ModuleType, tmp_path: Path) -> None:
    root = tree(
        tmp_path, {"rig/a.py": "from drivers.b import f\n", "drivers/b.py": "def f(): pass\n"}
    )
    assert found(structure, root) == []


@pytest.mark.parametrize(("count", "broken"), [(20, []), (21, [("files", "drivers")])])
def test_files_in_a_folder(
    structure: ModuleType, tmp_path: Path, count: int, broken: list[object]
) -> None:
    root = tree(tmp_path, {f"drivers/m{n}.py": "" for n in range(count)})
    assert found(structure, root) == broken


@pytest.mark.parametrize(("count", "broken"), [(14, []), (15, [("entries", "rig")])])
def test_entries_at_the_top_of_rig(
    structure: ModuleType, tmp_path: Path, count: int, broken: list[object]
) -> None:
    root = tree(
        tmp_path, {f"rig/room{n}/__init__.py": "" for n in range(count - 1)} | {"rig/a.py": ""}
    )
    assert found(structure, root) == broken


@pytest.mark.parametrize(("lines", "broken"), [(60, []), (61, [("long function", "rig.a:C.f")])])
def test_length_of_a_function(
    structure: ModuleType, tmp_path: Path, lines: int, broken: list[object]
) -> None:
    body = "class C:\n    def f(self):\n" + "        x = 1\n" * (lines - 1)
    assert found(structure, tree(tmp_path, {"rig/a.py": body})) == broken


@pytest.mark.parametrize(("count", "broken"), [(8, []), (9, [("arguments", "rig.a:C.f")])])
def test_arguments_of_a_function(
    structure: ModuleType, tmp_path: Path, count: int, broken: list[object]
) -> None:
    names = ", ".join(f"a{n}" for n in range(count - 1))
    text = f"class C:\n    def f(self, {names}, *, last): pass\n"
    assert found(structure, tree(tmp_path, {"rig/a.py": text})) == broken
    command = text.replace("    def", "    @click.command('x')\n    def")
    assert found(structure, tree(tmp_path, {"rig/a.py": command})) == []


@pytest.mark.parametrize(("lines", "broken"), [(400, []), (401, [("long module", "rig.a")])])
def test_length_of_a_module(
    structure: ModuleType, tmp_path: Path, lines: int, broken: list[object]
) -> None:
    assert found(structure, tree(tmp_path, {"rig/a.py": "x = 1\n" * lines})) == broken


@pytest.mark.parametrize(
    "text",
    [
        "from rig.b import x\n",
        "import rig.b.c\n",
        "from ..b import c\n",
        "def f():\n    from rig.b import c\n",
    ],
)
def test_folders_that_import_one_another(structure: ModuleType, tmp_path: Path, text: str) -> None:
    root = tree(
        tmp_path,
        {
            "rig/a/__init__.py": "",
            "rig/a/m.py": text,
            "rig/b/__init__.py": "x = 1\n",
            "rig/b/c.py": "",
        },
    )
    assert found(structure, root) == []
    (root / "rig/b/c.py").write_text("from rig.a import m\n")
    ties = [("two-way tie", "rig.a - rig.b")]
    assert found(structure, root) == ties


def test_a_package_that_gathers_names_from_its_folders_is_no_tie(
    structure: ModuleType, tmp_path: Path
) -> None:
    files = {"rig/a/__init__.py": "from rig.a.b import x\n", "rig/a/b/__init__.py": "x = 1\n"}
    root = tree(
        tmp_path, {**files, "rig/a/base.py": "", "rig/a/b/m.py": "from rig.a.base import y\n"}
    )
    assert found(structure, root) == []
    (root / "rig/a/user.py").write_text("from rig.a.b.m import z\n")
    assert found(structure, root) == [("two-way tie", "rig.a - rig.a.b")]


def test_an_arrow_against_the_declared_order(structure: ModuleType, tmp_path: Path) -> None:
    contract = (
        '[[tool.importlinter.contracts]]\ntype = "layers"\nlayers = ["rig", "drivers | '
        'identification"]\n'
    )
    root = tree(
        tmp_path, {"pyproject.toml": contract, "rig/a.py": "import drivers.b\n", "drivers/b.py": ""}
    )
    assert found(structure, root) == []
    (root / "drivers/b.py").write_text("import identification\n")
    assert found(structure, root) == [("upward arrow", "drivers.b")]
    (root / "drivers/b.py").write_text("import rig\n")
    assert ("upward arrow", "drivers.b") in found(structure, root)


def test_floors_are_the_longest_chain_of_a_folder(structure: ModuleType, tmp_path: Path) -> None:
    files = {
        "rig/a.py": "import rig.b, rig.d\n",
        "rig/b.py": "import rig.c\n",
        "rig/c.py": "",
        "rig/d.py": "",
    }
    lines, _ = structure.report(tree(tmp_path, files))
    row = next(line.split() for line in lines if line.startswith("rig "))
    assert row == ["rig", "4", "3", "1"]


def test_an_argued_break_is_let_pass_and_an_idle_argument_is_not(structure: ModuleType) -> None:
    broken = [structure.Break("long module", "rig.a", "401 lines")]
    assert structure.judge(broken, {})[1] is False
    assert structure.judge(broken, {("long module", "rig.a"): "one table"})[1] is True
    assert structure.judge([], {("long module", "rig.a"): "one table"})[1] is False
    five = [structure.Break("arguments", f"rig.a:f{n}", "9 arguments") for n in range(5)]
    assert structure.judge(five, {})[1] is True
    assert structure.judge([*five, structure.Break("arguments", "rig.a:g", "9")], {})[1] is False


def test_it_runs_without_anything_installed() -> None:
    done = subprocess.run([sys.executable, "-S", "-E", str(SCRIPT)], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.startswith("folder ")
    assert done.returncode in (0, 1)
