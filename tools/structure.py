"""Counts the size and the imports of the packages, and compares both with their budgets.

``make structure``, or ``python tools/structure.py``. Needs nothing but Python. The script prints a
line for each room, then each budget with its count, then what breaks it; it ends with 1 if a
budget is exceeded.

The budgets count both ways: many lines cost a reader, and so do many files. A module has at least
two importers or :data:`FULL_LINES` lines; otherwise it belongs into the module that imports it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("drivers", "identification", "rig")
REFERENCE = "docs/reference/"
"""Pages that are generated from the code; their words are not counted."""
FULL_LINES = 150
"""Lines of a module that needs no second importer."""
ENTRY = {"rig.cli.entry", "rig.wiring.guardian"}
"""Modules that are started as programs."""
BUDGETS: Mapping[str, int] = {
    "product lines": 80_000,
    "product files": 400,
    "test lines": 50_000,
    "words of documentation": 70_000,
    "thin modules": 0,
    "thin rooms": 0,
    "upward arrows": 0,
    "two-way ties": 0,
}


class Break(NamedTuple):
    """A place that counts against a budget.

    Attributes:
        budget: Name of the budget.
        where: Module, room, or pair of rooms.
        text: What was found.
    """

    budget: str
    where: str
    text: str


@dataclass(frozen=True)
class Module:
    """A file of a package.

    Attributes:
        name: Dotted name; a package's own file has the package's name.
        path: The file.
        tree: Its syntax tree.
        lines: Its length.
    """

    name: str
    path: Path
    tree: ast.Module
    lines: int

    @property
    def gathers(self) -> bool:
        """Whether the file is the ``__init__.py`` of a room."""
        return self.path.name == "__init__.py"

    @property
    def room(self) -> str:
        """Dotted name of the folder that contains the file."""
        return self.name if self.gathers else self.name.rpartition(".")[0]


def modules(root: Path) -> dict[str, Module]:
    """Return every module of the packages, by name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            text = path.read_text(encoding="utf-8")
            found[name] = Module(name, path, ast.parse(text), len(text.splitlines()))
    return found


def imports(module: Module, known: Mapping[str, Module]) -> set[str]:
    """Return the modules of the packages that a module imports anywhere, late imports and those for
    types included.
    """
    found = set()
    for node in ast.walk(module.tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(module, node)
            names = [f"{base}.{alias.name}" for alias in node.names] if base else []
        for name in names:
            while name and name not in known:
                name = name.rpartition(".")[0]
            if name and name != module.name:
                found.add(name)
    return found


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    """Return the dotted name that an import is from."""
    if not node.level:
        return node.module or ""
    parts = module.room.split(".")
    parts = parts[: len(parts) - node.level + 1]
    return ".".join([*parts, node.module] if node.module else parts)


def loaded_late(module: Module, known: Mapping[str, Module]) -> Iterator[tuple[str, str]]:
    """Yield the modules and attributes that the table of commands names: an attribute is the key of
    a tuple that begins with its module's name in the folder ``commands``; each such attribute
    counts as an importer of its module.
    """
    for table in (node for node in ast.walk(module.tree) if isinstance(node, ast.Dict)):
        for key, entry in zip(table.keys, table.values, strict=True):
            if isinstance(key, ast.Constant) and isinstance(entry, ast.Tuple) and entry.elts:
                first = getattr(entry.elts[0], "value", "")
                if (name := f"{module.room}.commands.{first}") in known:
                    yield name, str(key.value)


def thin(arrows: Mapping[str, set[str]], known: Mapping[str, Module]) -> Iterator[Break]:
    """Yield modules with fewer than two importers and fewer than :data:`FULL_LINES` lines, and
    rooms of at least three modules of which most have fewer than two importers.
    """
    importers: dict[str, set[str]] = defaultdict(set)
    for name, others in arrows.items():
        for other in others:
            importers[other].add(name)
    for module in known.values():
        for other, attribute in loaded_late(module, known):
            importers[other].add(attribute)
    rooms: dict[str, list[int]] = defaultdict(list)
    for name, module in known.items():
        if module.gathers or name in ENTRY:
            continue
        count = len(importers[name])
        rooms[module.room].append(count)
        if count < 2 and module.lines < FULL_LINES:
            yield Break("thin modules", name, f"{module.lines} lines, {count} importers")
    for room, counts in sorted(rooms.items()):
        single = sum(count < 2 for count in counts)
        if len(counts) > 2 and 2 * single > len(counts):
            text = f"{single} of {len(counts)} modules have fewer than two importers"
            yield Break("thin rooms", room, text)


def orders(root: Path) -> list[list[list[str]]]:
    """Return the declared orders of rooms, each from top to bottom, from import-linter's
    contracts.
    """
    path = root / "pyproject.toml"
    tool = tomllib.loads(path.read_text(encoding="utf-8")).get("tool", {}) if path.is_file() else {}
    found = []
    for contract in tool.get("importlinter", {}).get("contracts", []):
        if contract.get("type") != "layers":
            continue
        for container in contract.get("containers", [""]):
            prefix = f"{container}." if container else ""
            found.append(
                [
                    [prefix + name.strip("( )") for name in layer.replace(":", "|").split("|")]
                    for layer in contract["layers"]
                ]
            )
    return found


def upward(arrows: Mapping[str, set[str]], declared: list[list[list[str]]]) -> Iterator[Break]:
    """Yield imports that lead from a lower layer to a higher one, or across one layer."""
    for order in declared:
        height = {name: -level for level, layer in enumerate(order) for name in layer}
        for name, others in sorted(arrows.items()):
            start = _layer(name, height)
            for other in sorted(others):
                end = _layer(other, height)
                if start and end and start != end and height[end] >= height[start]:
                    yield Break("upward arrows", name, f"imports {other}, which stands no lower")


def _layer(name: str, height: Mapping[str, int]) -> str:
    while name and name not in height:
        name = name.rpartition(".")[0]
    return name


def ties(arrows: Mapping[str, set[str]], known: Mapping[str, Module]) -> Iterator[Break]:
    """Yield pairs of rooms that import one another.

    A room's ``__init__.py`` that gathers names from the rooms inside it makes no tie with them.
    """
    between: dict[tuple[str, str], str] = {}
    for name, others in sorted(arrows.items()):
        start = known[name].room
        for other in sorted(others):
            end = known[other].room
            gathers = known[name].gathers and end.startswith(f"{start}.")
            if start != end and not gathers:
                between.setdefault((start, end), f"{name} imports {other}")
    for first, second in combinations(sorted({room for pair in between for room in pair}), 2):
        if (first, second) in between and (second, first) in between:
            text = f"{between[first, second]}, {between[second, first]}"
            yield Break("two-way ties", f"{first} - {second}", text)


def tracked(root: Path, pattern: str) -> list[Path]:
    """Return the files that git tracks and that match a pattern; outside a checkout all files."""
    done = subprocess.run(
        ["git", "-C", str(root), "ls-files", "-z", pattern], capture_output=True, text=True
    )
    if done.returncode == 0 and done.stdout:
        return [root / name for name in done.stdout.split("\0") if name and (root / name).is_file()]
    folder, _, name = pattern.rpartition("/")
    return sorted((root / folder).rglob(name))


def words(root: Path) -> int:
    """Return the number of words of the documentation beside the generated reference."""
    pages = (
        page
        for page in tracked(root, "*.md")
        if not page.relative_to(root).as_posix().startswith(REFERENCE)
    )
    return sum(len(page.read_text(encoding="utf-8").split()) for page in pages)


def lines_of(paths: list[Path]) -> int:
    """Return the number of lines of files."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def report(root: Path) -> tuple[list[str], dict[str, int], list[Break]]:
    """Return a line for each room, the count of each budget, and everything that counts against a
    budget without being a size.
    """
    known = modules(root)
    arrows = {name: imports(module, known) for name, module in known.items()}
    breaks = [*thin(arrows, known), *upward(arrows, orders(root)), *ties(arrows, known)]
    table = [f"{'room':<44} {'files':>5} {'lines':>6} {'thin':>4}"]
    small = {item.where for item in breaks if item.budget == "thin modules"}
    rooms = defaultdict(list)
    for module in known.values():
        rooms[module.room].append(module)
    for room, inside in sorted(rooms.items()):
        place, lines = room.replace(".", "/"), sum(module.lines for module in inside)
        count = sum(module.name in small for module in inside)
        table.append(f"{place:<44} {len(inside):>5} {lines:>6} {count:>4}")
    counts = {
        "product lines": sum(module.lines for module in known.values()),
        "product files": len(known),
        "test lines": lines_of(tracked(root, "tests/*.py")) if (root / "tests").is_dir() else 0,
        "words of documentation": words(root),
    }
    for item in breaks:
        counts[item.budget] = counts.get(item.budget, 0) + 1
    return table, counts, breaks


def judge(counts: Mapping[str, int], breaks: list[Break]) -> tuple[list[str], bool]:
    """Return each budget with its count and what counts against it, and whether all are held."""
    lines, good = ["", f"{'budget':<24} {'count':>7} {'at most':>8}"], True
    for budget, most in BUDGETS.items():
        count = counts.get(budget, 0)
        good &= count <= most
        over = f"  exceeded by {count - most}" if count > most else ""
        lines.append(f"{budget:<24} {count:>7} {most:>8}{over}")
    lines += [f"{item.budget}: {item.where}: {item.text}" for item in sorted(breaks)]
    return lines, good


def main() -> int:
    """Print rooms and budgets; return 0 if every budget is held."""
    table, counts, breaks = report(ROOT)
    summary, good = judge(counts, breaks)
    print("\n".join([*table, *summary]))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
