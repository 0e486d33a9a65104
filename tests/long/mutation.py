"""Small changes of a module, for mutation testing: which there are, where, and what they do in
words.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from typing import Any, NamedTuple

Change = tuple[str, Callable[[], None]]
"""What becomes of a node, in words (empty: its new text), and the action that does it in place."""
Statements = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
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
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}
_TWINS = {"min": "max", "max": "min", "any": "all", "all": "any"}
_TRANSPARENT = frozenset({"abs", "int", "round", "float", "bool"})
"""Functions of which a call may be replaced by its argument."""


class Mutant(NamedTuple):
    """One change.

    Attributes:
        first: First line of its statement.
        words: Where and what, unique in its module.
        place: Number of the node in :func:`_walk`.
        number: Number of the change of that node.
    """

    first: int
    words: str
    place: int
    number: int


class _Spot(NamedTuple):
    """Whether a node is in a function, first line of its statement, innermost function or class."""

    inside: bool = False
    first: int = 0
    name: str = ""


def mutants(source: str) -> list[Mutant]:
    """Return every mutant of a module."""
    found: list[Mutant] = []
    seen: Counter[str] = Counter()
    for place, (node, spot) in enumerate(_walk(ast.parse(source))):
        before = _text(node)
        for number in range(len(_changes(node, spot))):
            copy = deepcopy(node)
            words, apply = _changes(copy, spot)[number]
            apply()
            told = f"{spot.name or 'module'}: {before} -> {words or _text(copy)}"
            seen[told] += 1
            if seen[told] > 1:
                told += f" ({seen[told]})"
            found.append(Mutant(spot.first, told, place, number))
    return found


def mutate(source: str, mutant: Mutant) -> ast.Module:
    """Return the changed module."""
    tree = ast.parse(source)
    node, spot = next(found for at, found in enumerate(_walk(tree)) if at == mutant.place)
    _changes(node, spot)[mutant.number][1]()
    return ast.fix_missing_locations(tree)


def _walk(tree: ast.Module) -> Iterator[tuple[ast.AST, _Spot]]:
    """Yield every node that may be changed, parents first: neither documentation nor
    annotations.
    """
    for statement in tree.body:
        yield from _inside(statement, _Spot())


def _inside(node: ast.AST, spot: _Spot) -> Iterator[tuple[ast.AST, _Spot]]:
    if _untouched(node) or (not spot.inside and isinstance(node, ast.Subscript)):
        return
    if isinstance(node, ast.stmt | ast.ExceptHandler):
        name = spot.name
        if not spot.inside and isinstance(node, ast.Assign | ast.AnnAssign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            name = f"{name}.{_text(target)}" if name else _text(target)
        spot = _Spot(spot.inside, node.lineno, name)
    yield node, spot
    within = spot
    if isinstance(node, Statements):
        name = f"{spot.name}.{node.name}" if spot.name else node.name
        within = _Spot(spot.inside or not isinstance(node, ast.ClassDef), spot.first, name)
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.arguments):
                # Defaults are part of what is around the function.
                for default in [*child.defaults, *child.kw_defaults]:
                    if default is not None:
                        yield from _inside(default, spot)
            elif isinstance(child, ast.AST):
                yield from _inside(child, within if field == "body" else spot)


def _untouched(node: ast.AST) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom | ast.Assert):
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        # Any bare string is documentation, that after an assignment too; an ellipsis is an abstract
        # body.
        return True
    # What only a process of its own runs, or only a type checker sees.
    return isinstance(node, ast.If) and _text(node.test) in (
        "__name__ == '__main__'",
        "TYPE_CHECKING",
    )


def _text(node: ast.AST) -> str:
    if isinstance(node, Statements):
        return node.name
    text = ast.unparse(node)
    if isinstance(node, ast.stmt | ast.ExceptHandler) and isinstance(
        getattr(node, "body", None), list
    ):
        text = text.partition("\n")[0]
    return " ".join(text.split())[:100]


def _changes(node: ast.AST, spot: _Spot) -> list[Change]:
    """Return the changes that can be made to a node in place."""
    changes = [
        *_of_operators(node),
        *_of_values(node),
        *_of_calls(node),
        *_of_conditions(node),
        *_of_blocks(node),
    ]
    if spot.inside:
        # A statement of a class or of the module can't be dropped without an error that says
        # nothing.
        changes += _of_statements(node)
    return changes


def _of_operators(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            for other in _SWAPS[type(operator)]:
                yield (other.__name__ if len(node.ops) > 1 else ""), _setter(node.ops, at, other())
    elif isinstance(node, ast.BinOp | ast.BoolOp):
        for other in _SWAPS.get(type(node.op), ()):
            yield "", _attribute(node, "op", other())
        for operand in node.values if isinstance(node, ast.BoolOp) else ():
            rest = [value for value in node.values if value is not operand]
            after = rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)
            yield f"without {_text(operand)}", _becomes(node, after)
    elif isinstance(node, ast.AugAssign):
        for other in _SWAPS.get(type(node.op), ()):
            yield "", _attribute(node, "op", other())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield (
            f"without {'not' if isinstance(node.op, ast.Not) else 'minus'}",
            _becomes(node, node.operand),
        )


def _of_values(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Constant):
        value: Any = node.value
        others: list[Any] = []
        if isinstance(value, bool):
            others = [not value]
        elif isinstance(value, int | float):
            others = [value + 1, value - 1, *([0] if value not in (-1, 0, 1) else [])]
        elif isinstance(value, str):
            others = [f"{value}x"]
        elif isinstance(value, bytes):
            others = [value + b"x"]
        for other in others:
            yield "", _attribute(node, "value", other)
    elif isinstance(node, ast.Dict):
        for at, value in enumerate(node.values):
            key = node.keys[at]
            name = f"**{_text(value)}" if key is None else _text(key)
            yield f"without {name}", _dropper([node.keys, node.values], at)
            if (
                at
                and key is not None
                and node.keys[at - 1] is not None
                and _differ(value, node.values[at - 1])
            ):
                yield f"value of {name} with that before it", _swapper(node.values, at)
    elif isinstance(node, ast.Set | ast.List) and isinstance(
        getattr(node, "ctx", ast.Load()), ast.Load
    ):
        for at, value in enumerate(node.elts):
            yield f"without {_text(value)}", _dropper([node.elts], at)


def _of_calls(node: ast.AST) -> Iterator[Change]:
    if not isinstance(node, ast.Call):
        return
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    if name in _TRANSPARENT and node.args:
        yield f"without {name}", _becomes(node, node.args[0])
    if name in _TWINS:
        yield "", _attribute(node.func, "id", _TWINS[name])
    for at in range(1, len(node.args)) if name not in _TWINS else ():
        first, second = node.args[at - 1 : at + 1]
        if (
            _differ(first, second)
            and not isinstance(first, ast.Starred)
            and not isinstance(second, ast.Starred)
        ):
            yield f"{_text(first)} and {_text(second)} swapped", _swapper(node.args, at)


def _of_conditions(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.If | ast.IfExp):
        for test in (True, False):
            yield f"if {test}", _attribute(node, "test", ast.Constant(test))
    elif isinstance(node, ast.While):
        yield "while False", _attribute(node, "test", ast.Constant(False))
    elif isinstance(node, ast.For):
        yield "for nothing", _attribute(node, "iter", ast.Tuple([], ast.Load()))
    elif isinstance(node, ast.comprehension):
        for at, test in enumerate(node.ifs):
            yield f"without if {_text(test)}", _dropper([node.ifs], at)
    elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield "return None", _attribute(node, "value", ast.Constant(None))
    # Members of a tuple that is looked through.
    sought = node.iter if isinstance(node, ast.For | ast.comprehension) else None
    if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn):
        sought = node.comparators[0]
    elif isinstance(node, ast.ExceptHandler):
        sought = node.type
    if isinstance(sought, ast.Tuple):
        for at, member in enumerate(sought.elts):
            yield f"without {_text(member)}", _dropper([sought.elts], at)


def _of_blocks(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.ExceptHandler) and not (
        len(node.body) == 1 and isinstance(node.body[0], ast.Raise)
    ):
        yield "raise", _attribute(node, "body", [ast.Raise()])
    elif isinstance(node, ast.With) and all(item.optional_vars is None for item in node.items):
        yield "without with", _becomes(node, ast.If(ast.Constant(True), node.body, []))


def _of_statements(node: ast.AST) -> Iterator[Change]:
    droppable = isinstance(
        node,
        ast.Assign | ast.AugAssign | ast.Raise | ast.Break | ast.Continue | ast.Delete | ast.Expr,
    )
    if isinstance(node, ast.AnnAssign | ast.Return):
        # A declaration does nothing; the end of a value's way is "return None".
        droppable = isinstance(node, ast.AnnAssign) is (node.value is not None)
    if droppable:
        yield "pass", _becomes(node, ast.Pass())
    if isinstance(node, ast.Break | ast.Continue):
        yield "", _becomes(node, ast.Continue() if isinstance(node, ast.Break) else ast.Break())


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _differ(first: ast.expr, second: ast.expr) -> bool:
    return ast.dump(first) != ast.dump(second)


def _setter(items: list[Any], at: int, value: object) -> Callable[[], None]:
    return lambda: items.__setitem__(at, value)


def _dropper(lists: list[list[Any]], at: int) -> Callable[[], None]:
    def change() -> None:
        for items in lists:
            del items[at]

    return change


def _swapper(items: list[Any], at: int) -> Callable[[], None]:
    def change() -> None:
        items[at - 1], items[at] = items[at], items[at - 1]

    return change


def _attribute(node: ast.AST, name: str, value: object) -> Callable[[], None]:
    return lambda: setattr(node, name, value)


def _becomes(node: ast.AST, other: ast.AST) -> Callable[[], None]:
    def change() -> None:
        node.__class__ = other.__class__
        node.__dict__ = other.__dict__

    return change
