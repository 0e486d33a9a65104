"""Mutation testing: every small change of a safety module must be noticed by its tests.

For each mutant a forked child takes the changed module in place of the good one, runs the tests and ends with their
status. What lives on is printed; it is either missing from the tests or argued in :data:`ARGUED`.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
TARGETS: Mapping[str, tuple[str, ...]] = {
    "drivers.cia402": ("tests/drivers/test_cia402.py",),
    "rig.safety": ("tests/rig/test_safety.py",),
    "rig.drive_limits": ("tests/rig/test_drive_limits.py",),
}
"""Module to the tests that guard it."""

_NO_SUCH_STATE = "no state has all of bits 0 to 3, 5 and 6 set, so that the last number looked at decides nothing"
_OUTSIDE = "asked only of a value outside its limits, which cannot be equal to one of them"
ARGUED: Mapping[tuple[str, str], str] = {
    ("drivers.cia402", "112 -> 111"): _NO_SUCH_STATE,
    ("drivers.cia402", "112 -> 113"): _NO_SUCH_STATE,
    ("rig.safety", "angle < limits.angle_min -> angle <= limits.angle_min"): _OUTSIDE,
    ("rig.safety", "supply < limits.supply_min -> supply <= limits.supply_min"): _OUTSIDE,
}
"""Living mutants that change nothing: (module, description) to why. See docs/faults.md."""

TIMEOUT_S = 120
Change = Callable[[], None]
_SWAPS: Mapping[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}


@dataclass(frozen=True)
class Mutant:
    """One change: where, in words, and the changed module."""

    line: int
    words: str
    tree: ast.Module


def mutants(source: str) -> Iterator[Mutant]:
    """Yield every mutant of a module."""
    original = ast.parse(source)
    skipped = set(_docstrings(original)) | set(_annotations(original))
    for place, node in enumerate(ast.walk(original)):
        if id(node) in skipped:
            continue
        for number, (words, _) in enumerate(_changes(node)):
            tree = deepcopy(original)
            target = next(n for i, n in enumerate(ast.walk(tree)) if i == place)
            apply = list(_changes(target))[number][1]
            before = _text(target)
            apply()
            yield Mutant(
                getattr(node, "lineno", 0), f"{before} -> {words or _text(target)}", ast.fix_missing_locations(tree)
            )


def _docstrings(tree: ast.AST) -> Iterator[int]:
    # Any bare string is documentation, that after an assignment too.
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield id(node)
            yield id(node.value)


def _annotations(tree: ast.AST) -> Iterator[int]:
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            annotation = getattr(node, name, None)
            if isinstance(annotation, ast.expr):
                yield from (id(part) for part in ast.walk(annotation))


def _text(node: ast.AST) -> str:
    return ast.unparse(node).replace("\n", " ")[:90] if not isinstance(node, ast.FunctionDef) else node.name


def _changes(node: ast.AST) -> list[tuple[str, Change]]:
    """Return the changes that can be made to a node in place, as words and action."""
    changes: list[tuple[str, Change]] = []
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            for other in _SWAPS[type(operator)]:
                changes.append((other.__name__ if len(node.ops) > 1 else "", _setter(node.ops, at, other())))
    elif isinstance(node, ast.BinOp | ast.BoolOp):
        for other in _SWAPS.get(type(node.op), ()):
            changes.append(("", _attribute(node, "op", other())))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        changes.append(("without not", _becomes(node, node.operand)))
    elif isinstance(node, ast.Constant):
        value = node.value
        if isinstance(value, bool):
            changes.append(("", _attribute(node, "value", not value)))
        elif isinstance(value, int | float):
            changes += [("", _attribute(node, "value", value + 1)), ("", _attribute(node, "value", value - 1))]
        elif isinstance(value, str):
            changes.append(("", _attribute(node, "value", f"{value}x")))
    elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        changes.append(("return None", _attribute(node, "value", ast.Constant(None))))
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("abs", "int"):
        changes.append((f"without {node.func.id}", _becomes(node, node.args[0])))
    elif isinstance(node, ast.If | ast.IfExp):
        for test in (True, False):
            changes.append((f"if {test}", _attribute(node, "test", ast.Constant(test))))
    for name in ("body", "orelse"):
        statements = getattr(node, name, None)
        if isinstance(statements, list):
            for at, statement in enumerate(statements):
                if isinstance(statement, ast.Assign | ast.AugAssign | ast.Raise | ast.AnnAssign) and _droppable(
                    statement
                ):
                    words = f"without line {statement.lineno}: {_text(statement)}"
                    changes.append((words, _setter(statements, at, ast.Pass())))
    return changes


def _droppable(statement: ast.stmt) -> bool:
    # A field of a class or a constant of the module cannot be dropped without an error that says nothing.
    if isinstance(statement, ast.Assign):
        return any(isinstance(target, ast.Attribute) for target in statement.targets)
    return not isinstance(statement, ast.AnnAssign) or isinstance(statement.target, ast.Attribute)


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _setter(items: list[Any], at: int, value: object) -> Change:
    def change() -> None:
        items[at] = value

    return change


def _attribute(node: ast.AST, name: str, value: object) -> Change:
    return lambda: setattr(node, name, value)


def _becomes(node: ast.AST, other: ast.AST) -> Change:
    def change() -> None:
        node.__class__ = other.__class__
        node.__dict__ = other.__dict__

    return change


def survivors(name: str, everything: list[Mutant], jobs: int) -> list[Mutant]:
    """Run the tests on every mutant, each in a forked child; return those with which they pass."""
    path = ROOT / f"{name.replace('.', '/')}.py"
    running: dict[int, tuple[Mutant, float]] = {}
    waiting = everything[::-1]
    living = []
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            child = os.fork()
            if child == 0:
                os._exit(_test(name, path, mutant))
            running[child] = mutant, time.monotonic() + TIMEOUT_S
        time.sleep(0.005)
        for child, (mutant, deadline) in list(running.items()):
            done, status = os.waitpid(child, os.WNOHANG)
            if not done and time.monotonic() > deadline:
                os.kill(child, signal.SIGKILL)
                done, status = os.waitpid(child, 0)
            if done:
                del running[child]
                if os.waitstatus_to_exitcode(status) == 0:
                    living.append(mutant)
    return sorted(living, key=lambda mutant: (mutant.line, mutant.words))


def _test(name: str, path: Path, mutant: Mutant) -> int:
    import pytest

    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    parent, _, leaf = name.rpartition(".")
    setattr(importlib.import_module(parent), leaf, module)
    try:
        exec(compile(mutant.tree, str(path), "exec"), module.__dict__)  # noqa: S102 - the mutant itself
    except Exception:  # noqa: BLE001 - a module that cannot be imported is dead
        return 1
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *TARGETS[name]]))


def main() -> int:
    """Test every mutant of every target, and print those that live."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    os.chdir(ROOT)
    # Imported before the first fork, so that a child starts warm; the module under test itself is not.
    for warm in ("pytest", "numpy", "psutil", "yaml", "pydantic", "drivers.errors", "drivers.interfaces", "rig.sample"):
        importlib.import_module(warm)
    unargued = 0
    for name in options.modules or TARGETS:
        source = (ROOT / f"{name.replace('.', '/')}.py").read_text()
        everything = list(mutants(source))
        began = time.monotonic()
        if not survivors(name, [Mutant(0, "unchanged", ast.parse(source))], 1):
            print(f"{name}: its tests fail without any change; mend them first")
            return 1
        living = survivors(name, everything, options.jobs)
        print(f"{name}: {len(everything)} mutants, {len(living)} alive, {time.monotonic() - began:.0f} s")
        for mutant in living:
            reason = ARGUED.get((name, mutant.words))
            unargued += reason is None
            print(f"  line {mutant.line}: {mutant.words}{'' if reason is None else f'  [argued: {reason}]'}")
    return 1 if unargued else 0


if __name__ == "__main__":
    sys.exit(main())
