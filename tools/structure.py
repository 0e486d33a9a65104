"""Holds the layout of the packages against its bounds: ``make structure``, or
``python tools/structure.py``.

Needs nothing but Python. Prints a line for each folder of drivers, identification and rig, then
what breaks a bound, and ends with 1 where a break isn't argued in :data:`ARGUED`.

Columns: ``files``; ``floors``, the longest chain of files of the folder that import one another, so
that 1 is a folder whose files don't know each other; ``lines`` of its longest module.
"""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("drivers", "identification", "rig")
FOLDER_FILES = 20
"""Most files in a folder; ``__init__.py`` is not counted."""
TOP_ENTRIES = 14
"""Most entries, files and folders, at the top of rig/; ``__init__.py`` and ``py.typed`` are not
counted.
"""
FUNCTION_LINES = 60
ARGUMENTS = 8
MODULE_LINES = 400
BOUNDS: Mapping[str, int] = {
    "files": 0,
    "entries": 0,
    "upward arrow": 0,
    "two-way tie": 0,
    "long function": 0,
    "arguments": 5,
    "long module": 0,
}
"""Bound to how often it may be broken without an argument in :data:`ARGUED`.

Commands are not counted under ``arguments``: theirs are their options, one for one.
"""

ARGUED: Mapping[tuple[str, str], str] = {
    (
        "long function",
        "drivers.mock.plant.effects.kernel:integrate",
    ): "the inner loop of the simulation: its parts share a dozen local values and are inlined, so "
    "that a further part would take and return them all",
    (
        "arguments",
        "drivers.mock.plant.effects.kernel:integrate",
    ): "compiled kernel: five vectors, and four values that its caller has at hand from each loop",
    (
        "arguments",
        "drivers.mock.plant.effects.kernel:advance_hiding",
    ): "compiled kernel: the vectors of one machine, which Python holds apart and passes as arrays",
    (
        "arguments",
        "drivers.mock.plant.burning:advance_loaded",
    ): "compiled kernel: all vectors of `advance_hiding`, and the two of the gas generator",
    (
        "arguments",
        "drivers.mock.plant.record:record_cycles",
    ): "compiled kernel: all vectors of `advance_loaded`, and where the latches go",
    ("arguments", "identification.export.signals:Signals.__init__"): (
        "is exported as source for users' own scripts, which pass plain arrays by name"
    ),
    ("long function", "identification.filter.sensitivity:sensitivities"): (
        "a third documents its arrays; parts of the loop would each take the state and all arrays"
    ),
    ("arguments", "identification.simulate.closed_loop_kernel:closed_loop"): (
        "compiled kernel: takes numbers and arrays and no records"
    ),
    ("arguments", "identification.simulate.servo_loop:_follow"): (
        "compiled kernel: takes numbers and arrays and no records"
    ),
}
"""Bound and place, as they are printed, to why the break stays, in one line.

A row that no break needs is an error.
"""


class Break(NamedTuple):
    """A bound that is broken.

    Attributes:
        bound: Which.
        where: Place: a folder, a module, or module:function.
        text: What was found.
    """

    bound: str
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
    def folder(self) -> str:
        """Dotted name of the folder that it is in."""
        return self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]


def modules(root: Path, packages: tuple[str, ...] = PACKAGES) -> dict[str, Module]:
    """Return every module of the packages, by name."""
    found = {}
    for package in packages:
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
    for node in _statements(module.tree):
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


def _inner(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements inside a statement, with handlers and cases.

    Expressions, most nodes of a tree, have no imports and no functions with a name.
    """
    for part in ("body", "handlers", "orelse", "finalbody", "cases"):
        yield from getattr(node, part, ())


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield every statement inside a module or a statement."""
    for child in _inner(node):
        yield child
        yield from _statements(child)


def _absolute(module: Module, node: ast.ImportFrom) -> str:
    """Return the dotted name that an import is from."""
    if not node.level:
        return node.module or ""
    parts = module.folder.split(".")
    parts = parts[: len(parts) - node.level + 1]
    return ".".join([*parts, node.module] if node.module else parts)


def floors(names: set[str], arrows: Mapping[str, set[str]]) -> int:
    """Return the number of modules in the longest chain of imports among some; modules in a ring
    count once each.
    """
    depth: dict[str, int] = {}

    def below(name: str, above: frozenset[str]) -> int:
        if name not in depth:
            inner = (below(other, above | {name}) for other in arrows[name] & names - above)
            depth[name] = 1 + max(inner, default=0)
        return depth[name]

    return max((below(name, frozenset({name})) for name in sorted(names)), default=0)


def layers(root: Path) -> list[list[list[str]]]:
    """Return the declared orders of folders, each from top to bottom, from import-linter's
    contracts.
    """
    path = root / "pyproject.toml"
    contracts = []
    if path.is_file():
        tool = tomllib.loads(path.read_text(encoding="utf-8")).get("tool", {})
        contracts = tool.get("importlinter", {}).get("contracts", [])
    orders = []
    for contract in contracts:
        if contract.get("type") != "layers":
            continue
        for container in contract.get("containers", [""]):
            prefix = f"{container}." if container else ""
            orders.append(
                [
                    [prefix + name.strip("( )") for name in layer.replace(":", "|").split("|")]
                    for layer in contract["layers"]
                ]
            )
    return orders


def upward(arrows: Mapping[str, set[str]], orders: list[list[list[str]]]) -> Iterator[Break]:
    """Yield imports that lead from a lower layer to a higher one, or across one layer."""
    for order in orders:
        height = {name: -level for level, layer in enumerate(order) for name in layer}
        for name, others in sorted(arrows.items()):
            start = _layer(name, height)
            for other in sorted(others):
                end = _layer(other, height)
                if start and end and start != end and height[end] >= height[start]:
                    yield Break("upward arrow", name, f"imports {other}, which stands no lower")


def _layer(name: str, height: Mapping[str, int]) -> str:
    while name and name not in height:
        name = name.rpartition(".")[0]
    return name


def ties(arrows: Mapping[str, set[str]], known: Mapping[str, Module]) -> Iterator[Break]:
    """Yield pairs of folders that import one another.

    A folder's ``__init__.py`` that gathers names from the folders inside it makes no tie with them.
    """
    between: dict[tuple[str, str], str] = {}
    for name, others in sorted(arrows.items()):
        start = known[name].folder
        for other in sorted(others):
            end = known[other].folder
            gathers = known[name].path.name == "__init__.py" and end.startswith(f"{start}.")
            if start != end and not gathers:
                between.setdefault((start, end), f"{name} imports {other}")
    for first, second in combinations(sorted({folder for pair in between for folder in pair}), 2):
        if (first, second) in between and (second, first) in between:
            text = f"{between[first, second]}, {between[second, first]}"
            yield Break("two-way tie", f"{first} - {second}", text)


def functions(module: Module) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Yield every function of a module with its qualified name."""

    def inside(
        node: ast.AST, prefix: str
    ) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
        for child in _inner(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{prefix}{child.name}", child
            name = getattr(child, "name", "")
            yield from inside(child, f"{prefix}{name}." if name else prefix)

    yield from inside(module.tree, "")


def long_and_wide(module: Module) -> Iterator[Break]:
    """Yield functions that are too long or take too many arguments."""
    for name, node in functions(module):
        where = f"{module.name}:{name}"
        length = (node.end_lineno or node.lineno) - node.lineno + 1
        if length > FUNCTION_LINES:
            yield Break("long function", where, f"{length} lines, at most {FUNCTION_LINES}")
        count = _arguments(node)
        if count > ARGUMENTS and not _is_command(node):
            yield Break("arguments", where, f"{count} arguments, at most {ARGUMENTS}")


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return len([argument for argument in given if argument.arg not in ("self", "cls")])


def _is_command(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is a click command."""
    called = (item.func if isinstance(item, ast.Call) else item for item in node.decorator_list)
    return any(isinstance(item, ast.Attribute) and item.attr == "command" for item in called)


def entries(root: Path, package: str = "rig") -> list[str]:
    """Return the files and folders at the top of a package."""
    skipped = {"__init__.py", "py.typed", "__pycache__"}
    return sorted(path.name for path in (root / package).iterdir() if path.name not in skipped)


def report(root: Path) -> tuple[list[str], list[Break]]:
    """Return a line for each folder, and everything that breaks a bound."""
    known = modules(root)
    arrows = {name: imports(module, known) for name, module in known.items()}
    lines = [f"{'folder':<44} {'files':>5} {'floors':>6} {'lines':>5}"]
    breaks: list[Break] = []
    for folder in sorted({module.folder for module in known.values()}):
        inside = {
            name
            for name, module in known.items()
            if module.folder == folder and module.path.name != "__init__.py"
        }
        longest = max((known[name].lines for name in inside), default=0)
        place = folder.replace(".", "/")
        lines.append(f"{place:<44} {len(inside):>5} {floors(inside, arrows):>6} {longest:>5}")
        if len(inside) > FOLDER_FILES:
            breaks.append(Break("files", place, f"{len(inside)} files, at most {FOLDER_FILES}"))
    top = entries(root)
    if len(top) > TOP_ENTRIES:
        breaks.append(
            Break("entries", "rig", f"{len(top)} entries at the top, at most {TOP_ENTRIES}")
        )
    breaks += upward(arrows, layers(root))
    breaks += ties(arrows, known)
    for module in known.values():
        breaks += long_and_wide(module)
        if module.lines > MODULE_LINES:
            breaks.append(
                Break("long module", module.name, f"{module.lines} lines, at most {MODULE_LINES}")
            )
    return lines, breaks


def judge(breaks: list[Break], argued: Mapping[tuple[str, str], str]) -> tuple[list[str], bool]:
    """Return a summary with every break, and whether all is in order."""
    lines, good = [""], True
    for bound, allowed in BOUNDS.items():
        found = [item for item in breaks if item.bound == bound]
        open_ = [item for item in found if (item.bound, item.where) not in argued]
        good &= len(open_) <= allowed
        lines.append(
            f"{bound}: {len(found)}, {len(found) - len(open_)} of them argued; allowed are "
            f"{allowed} others"
        )
        for item in found:
            reason = argued.get((item.bound, item.where))
            lines.append(f"  {item.where}: {item.text}{f' ({reason})' if reason else ''}")
    for row in sorted(argued.keys() - {(item.bound, item.where) for item in breaks}):
        good = False
        lines.append(f"ARGUED has a row that nothing needs: {row}; remove it")
    return lines, good


def main() -> int:
    """Print the layout; return 0 where every bound holds."""
    lines, breaks = report(ROOT)
    summary, good = judge(breaks, ARGUED)
    print("\n".join([*lines, *summary]))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
