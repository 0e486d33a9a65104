"""Symbols in place of signals: the functions that compute torques from recordings, applied to
symbols, give the equations of one sample as a graph.

Arithmetic, comparisons and numpy's functions of a :class:`Node` are nodes. A compiled kernel, which
loops over samples, becomes one pass of its loop, whose variables are the memory of the model. A
branch that depends on a signal is followed both ways, and a choice joins both results.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from identification.numerics import series
from identification.signals import central_difference


def _quotient(a: float, b: float) -> float:
    return a / b if b else math.copysign(math.inf, a) if a else math.nan


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _quotient,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    "==": lambda a, b: a == b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "choose": lambda c, a, b: a if c else b,
    "power": lambda a, b: a * a if b == 2.0 else a**b,
    "min": min,
    "max": max,
    "abs": abs,
    "sign": lambda a: float((a > 0.0) - (a < 0.0)),
    "exp": lambda a: math.exp(min(a, 709.0)),
    "sqrt": lambda a: math.sqrt(a) if a >= 0.0 else math.nan,
    "atanh": lambda a: math.atanh(a) if abs(a) < 1.0 else math.nan,
    **{n: getattr(math, n) for n in ("sin", "cos", "tanh", "expm1")},
}
"""Operations of the graph with their values."""
OF_ARRAYS: Mapping[str, Callable[..., Any]] = {
    **OPERATIONS,
    "/": np.divide,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "choose": np.where,
    "power": np.power,
    "min": np.minimum,
    "max": np.maximum,
    "atanh": np.arctanh,
    **{n: getattr(np, n) for n in ("abs", "sign", "exp", "sqrt", "sin", "cos", "tanh", "expm1")},
}
"""The same for arrays."""
LOGICAL = frozenset({"<", "<=", "==", "and", "or", "not"})
_known: WeakValueDictionary[Any, Node] = WeakValueDictionary()
_decided: ContextVar[Mapping[Node, bool]] = ContextVar("decided", default={})  # noqa: B039 - read only
NOW, BEFORE = object(), object()
"""Indices of the present and of the previous sample in a kernel's loop."""


class NotCausalError(Exception):
    """The response of an effect needs samples that a simulation does not have yet."""


class _UndecidedError(Exception):
    def __init__(self, condition: Node) -> None:
        self.condition = condition


class Node:
    """One value of the graph; equal nodes are the same object.

    Attributes:
        operation: Name from :data:`OPERATIONS`; ``constant``, ``parameter`` or ``input``; or
            ``memory``: the value of ``update`` one sample ago.
        arguments: Operands.
        value: Value of a constant or parameter.
        name: Name of a parameter, an input or a memory.
        update: Value of a memory at the present sample.
        fixed: Whether the value depends on no signal.
        logical: Whether the value is true or false.
    """

    fixed: bool
    logical: bool
    __add__: Callable[..., Any]
    __radd__: Callable[..., Any]
    __sub__: Callable[..., Any]
    __mul__: Callable[..., Any]
    __rmul__: Callable[..., Any]
    flags = SimpleNamespace()
    """Numpy's flags of an array, which functions of this program set."""

    def __init__(self, operation: str, arguments: tuple[Node, ...], value: float, name: str):
        self.operation, self.arguments, self.value, self.name = operation, arguments, value, name
        self.update: Node = self
        leaf = operation in ("constant", "parameter")
        self.fixed = leaf or (bool(arguments) and all(a.fixed for a in arguments))
        self.logical = (
            isinstance(value, bool)
            or operation in LOGICAL
            or (operation == "choose" and arguments[1].logical)
        )

    def __hash__(self) -> int:
        return id(self)

    def __len__(self) -> int:
        return 1

    def __round__(self) -> int:
        value: float = evaluated(self)
        return round(value)

    def __bool__(self) -> bool:
        if self.fixed:
            return bool(evaluated(self))
        found = _decided.get()
        if self not in found:
            raise _UndecidedError(self)
        return found[self]

    def __iter__(self) -> Any:
        raise TypeError("one sample has no length")

    def __getitem__(self, index: Any) -> Any:
        if index is None:
            return Rows([self])
        if index is BEFORE or index == slice(None, -1):
            number = apply("*", self, 1.0)
            before = memory("previous", number, number)
            return apply("<", 0.5, before) if self.logical else before
        return node(0.0) if self.name == "time" and index is not NOW else self


def node(
    value: Any = 0.0, operation: str = "constant", arguments: tuple[Node, ...] = (), name: str = ""
) -> Node:
    """Return the node of a constant, or of an operation."""
    if isinstance(value, Node):
        return value
    if isinstance(value, np.ndarray | np.generic):
        value = value.item()
    key = operation, arguments, value, type(value), name
    found = _known.get(key)
    if found is None:
        found = _known[key] = Node(operation, arguments, value, name)
    return found


def memory(name: str, key: Node, update: Node | None = None) -> Node:
    """Return what a node was one sample ago; ``key`` distinguishes memories of one name."""
    if key.fixed and update is not None:
        return update
    found = node(0.0, "memory", (key,), name)
    found.fixed = False
    if update is not None:
        found.update = update
    return found


def apply(operation: str, *given: Any) -> Node:
    """Return the node of an operation, simplified where an operand is a constant."""
    a = [node(g) for g in given]
    if operation not in ("==", "and", "or", "not", "choose"):
        a = [apply("choose", x, 1.0, 0.0) if x.logical else x for x in a]
    if all(x.operation == "constant" for x in a):
        return node(OPERATIONS[operation](*(x.value for x in a)))
    known = [x.value if x.operation == "constant" else None for x in a]
    match operation, known:
        case ("*", [0 | 0.0, _] | [_, 0 | 0.0]):
            return node(0.0)
        case ("+", [0 | 0.0, _]) | ("*", [1 | 1.0, _]):
            return a[1]
        case ("+" | "-", [_, 0 | 0.0]) | ("*" | "/" | "power", [_, 1 | 1.0]):
            return a[0]
        case ("/", [0 | 0.0, _]):
            return node(0.0)
        case ("choose", [None, *_]) if a[1] is a[2]:
            return a[1]
        case ("choose", [bool(), *_]):
            return a[1] if known[0] else a[2]
        case ("and", [False, _] | [_, False]) | ("or", [True, _] | [_, True]):
            return node(operation == "or")
        case ("and" | "or", [bool(), _]):
            return a[1]
        case ("and" | "or", [_, bool()]):
            return a[0]
    return node(0.0, operation, tuple(a))


def _operator(operation: str, swapped: bool) -> Callable[[Node, Any], Any]:
    def method(self: Node, other: Any) -> Any:
        if isinstance(other, Rows):
            return NotImplemented
        return apply(operation, *((other, self) if swapped else (self, other)))

    return method


for _name, _sign in {"add": "+", "sub": "-", "mul": "*", "truediv": "/", "pow": "power"}.items():
    setattr(Node, f"__{_name}__", _operator(_sign, False))
    setattr(Node, f"__r{_name}__", _operator(_sign, True))
for _name, _sign in {"lt": "<", "le": "<=", "eq": "==", "and": "and", "or": "or"}.items():
    setattr(Node, f"__{_name}__", _operator(_sign, False))
for _name, _sign in {"gt": "<", "ge": "<=", "rand": "and", "ror": "or"}.items():
    setattr(Node, f"__{_name}__", _operator(_sign, True))
for _name, _made in {
    "ne": lambda a, b: apply("not", apply("==", a, b)),
    "invert": lambda a: apply("not", a),
    "neg": lambda a: apply("*", -1.0, a),
    "abs": lambda a: apply("abs", a),
    "float": lambda a: evaluated(a),
}.items():
    setattr(Node, f"__{_name}__", _made)


class Rows(list[Any]):
    """Regressors: a list of nodes with arithmetic of its elements."""

    def _with(self, other: Any, operation: str) -> Rows:
        others = other if isinstance(other, list) else [other] * len(self)
        return Rows(apply(operation, a, b) for a, b in zip(self, others, strict=True))

    def __mul__(self, other: Any) -> Rows:
        return self._with(other, "*")

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Rows:
        return self._with(other, "+")

    def __truediv__(self, other: Any) -> Rows:
        return self._with(other, "/")

    def __neg__(self) -> Rows:
        return self * -1.0

    def __matmul__(self, other: Rows) -> Any:
        return total(self * other)

    def __getitem__(self, index: Any) -> Any:
        found = super().__getitem__(index)
        return Rows(found) if isinstance(index, slice) else found


def computed(
    roots: list[Node],
    known: Mapping[Node, Any] | None = None,
    operations: Mapping[str, Callable[..., Any]] = OPERATIONS,
) -> list[Any]:
    """Return the values of nodes that depend on parameters and on the ``known`` nodes alone."""
    values = dict(known or {})
    for each in ordered(roots, values):
        if each.operation in ("constant", "parameter"):
            values[each] = each.value
        elif each not in values:
            values[each] = operations[each.operation](*(values[a] for a in each.arguments))
    return [values[root] for root in roots]


def evaluated(found: Node) -> Any:
    """Return the value of a node that depends on parameters alone."""
    return computed([found])[0]


def ordered(roots: list[Node], given: Any = ()) -> list[Node]:
    """Return all nodes that the roots depend on, operands first; memories and the ``given`` nodes
    count as known.
    """
    found: dict[Node, None] = {}
    stack = [(root, False) for root in reversed(roots)]
    while stack:
        each, done = stack.pop()
        if each in found:
            continue
        if done or each.operation == "memory" or each in given:
            found[each] = None
        else:
            stack.append((each, True))
            stack.extend((a, False) for a in reversed(each.arguments))
    return list(found)


def substituted(roots: list[Node], changes: Mapping[Node, Node]) -> list[Node]:
    """Return the roots with other nodes in place of some, simplified again."""
    new = dict(changes)
    for each in ordered(roots, changes):
        if each not in new:
            inner = tuple(new[a] for a in each.arguments) if each.operation != "memory" else ()
            new[each] = apply(each.operation, *inner) if inner else each
    return [new[root] for root in roots]


def explored(function: Callable[[], Any]) -> Any:
    """Return the result of a function whose branches depend on signals, as choices."""
    try:
        return function()
    except _UndecidedError as found:
        condition, before = found.condition, _decided.get()
    results = []
    for taken in (True, False):
        token = _decided.set({**before, condition: taken})
        try:
            results.append(explored(function))
        finally:
            _decided.reset(token)
    return _joined(condition, *results)


def _joined(condition: Node, first: Any, second: Any) -> Any:
    if isinstance(first, list | tuple):
        return type(first)(_joined(condition, a, b) for a, b in zip(first, second, strict=True))
    return apply("choose", condition, first, second)


def total(parts: Iterable[Any]) -> Any:
    """Return a sum of nodes."""
    return functools.reduce(lambda a, b: apply("+", a, b), parts, node(0.0))


def _not_causal(*_: Any) -> Any:
    raise NotCausalError


def _function(operation: str) -> Callable[..., Any]:
    return lambda *given, **_: apply(operation, *given)


class Written(Rows):
    """Arrays that a function fills; the samples of one array have one place."""

    def __setitem__(self, index: Any, value: Any) -> None:
        row = index[0] if isinstance(index, tuple) else index if len(self) > 1 else 0
        super().__setitem__(row, value)


NUMPY = SimpleNamespace(
    **{n: _function(n) for n in ("abs", "sign", "exp", "expm1", "sin", "cos", "tanh", "sqrt")},
    arctanh=_function("atanh"),
    **{n: _function("abs") for n in ("absolute", "fabs")},
    copysign=lambda a, b: apply("*", apply("choose", apply("<", b, 0.0), -1.0, 1.0), abs(a)),
    power=_function("power"),
    square=lambda a: a * a,
    maximum=_function("max"),
    minimum=_function("min"),
    multiply=_function("*"),
    subtract=_function("-"),
    where=_function("choose"),
    negative=lambda a, **_: -a,
    clip=lambda a, low, high, **_: apply("min", apply("max", a, low), high),
    isnan=lambda _: node(False),
    asarray=lambda a, **_: a,
    stack=lambda parts: Rows(node(p) for p in parts),
    array=lambda a: Rows(a),
    ones=lambda _: node(1.0),
    zeros=lambda shape: Rows([0.0] * shape[0]) if isinstance(shape, tuple) else node(0.0),
    full=lambda _, value: node(value),
    empty=lambda shape: Written([0.0] * shape[0]),
    empty_like=lambda _: Written([0.0]),
    mean=lambda _: node(0.0),
    pi=math.pi,
    inf=math.inf,
    float64=float,
)
"""Functions of numpy, and of math, for nodes. Before the first sample the machine was at rest
without current: means over that time are zero.
"""


def _least(operation: str) -> Callable[..., Any]:
    return lambda *given: functools.reduce(
        lambda a, b: apply(operation, a, b), given[0] if len(given) == 1 else given
    )


_BUILTINS: Mapping[str, Any] = {
    "float": lambda a: apply("*", a, 1.0),
    "min": _least("min"),
    "max": _least("max"),
}


class Symbols:
    """Functions of this program, made to compute with nodes.

    Args:
        step: Node of the time since the previous sample, s.
        first: Node that is true at the first sample.
        replaced: Function of this program to what takes its place.
    """

    def __init__(self, step: Node, first: Node, replaced: Mapping[Any, Any]) -> None:
        self.first = first
        numpy = SimpleNamespace(
            **vars(NUMPY),
            roll=lambda a, _: self.started(a, a[BEFORE]),
            concatenate=lambda parts: self.started(node(parts[0][0]), parts[1]),
        )
        self._replaced: dict[Any, Any] = {
            np: numpy,
            math: numpy,
            central_difference: lambda a, _: self.started(node(0.0), (a - a[BEFORE]) / step),
            series.sine_cosine: lambda f, a: Rows([apply("sin", f * a), apply("cos", f * a)]),
            series.delayed_series: _not_causal,
            series.first_swing: lambda *_: 0,
            **replaced,
        }

    def started(self, at_first: Node, later: Node) -> Node:
        """Return a value that differs at the first sample."""
        return apply("choose", self.first, at_first, later)

    def function(self, given: Any) -> Any:
        """Return a function, or a kernel, for nodes."""
        if given in self._replaced:
            return self._replaced[given]
        kernel = hasattr(given, "py_func")
        plain = inspect.unwrap(getattr(given, "py_func", given))
        made = self._kernel(plain) if kernel and _loop(plain) else self._rebound(plain)
        self._replaced[given] = made
        return made

    def _rebound(self, plain: FunctionType) -> Any:
        scope: dict[str, Any] = {"__builtins__": __builtins__, **_BUILTINS}
        made = FunctionType(
            plain.__code__, scope, plain.__name__, plain.__defaults__, plain.__closure__
        )
        made.__kwdefaults__ = plain.__kwdefaults__
        self._replaced[plain] = made
        self._fill(scope, plain.__code__, plain.__globals__)
        return made

    def _fill(self, scope: dict[str, Any], code: CodeType, known: Mapping[str, Any]) -> None:
        for name in _names(code) & known.keys():
            value = known[name]
            module = getattr(value, "__module__", None) or ""
            own = module.startswith("identification.") or module == known.get("__name__")
            if value is np or value is math:
                value = self._replaced[value]
            elif module in ("math", "numpy"):  # from math import exp
                value = getattr(self._replaced[np], value.__name__, value)
            elif own and callable(value) and not inspect.isclass(value):
                value = self.function(value)
            scope[name] = value

    def _kernel(self, plain: FunctionType) -> Callable[..., Any]:
        """Return one pass of the loop of a kernel as a function of its arguments; the variables
        that the loop carries on are memories.
        """
        tree = ast.parse(textwrap.dedent(inspect.getsource(plain))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        place = next(k for k, s in enumerate(tree.body) if isinstance(s, ast.For))
        loop, result = tree.body[place], tree.body[-1]
        assert isinstance(loop, ast.For)
        assert isinstance(result, ast.Return)
        assert isinstance(result.value, ast.Name)
        before = _assigned(tree.body[:place])
        kept = [n for n in _assigned(loop.body) if n in before]
        names, out = ", ".join(kept), result.value.id
        head = ast.parse(f"if carried: ({names},) = carried\nelse: return ({names},), {out}").body
        last = ast.parse(f"return ({names},), {out}").body
        once = [_Previous().visit(s) for s in loop.body]
        arguments = [ast.arg(a.arg) for a in tree.args.args]
        tree.args = ast.arguments([], [*arguments, ast.arg("carried")], None, [], [], None, [])
        tree.decorator_list, tree.returns = [], None
        tree.body = [*tree.body[1:place], *head, *once, *last]
        module = ast.fix_missing_locations(ast.Module([tree], []))
        scope: dict[str, Any] = {"k": NOW, "BEFORE": BEFORE, **_BUILTINS}
        self._fill(scope, plain.__code__, plain.__globals__)
        compiled = compile(module, plain.__name__, "exec").co_consts
        code = next(c for c in compiled if isinstance(c, CodeType))
        one_pass = FunctionType(code, scope, plain.__name__)
        defaults = plain.__defaults__ or ()

        def pass_of(given: tuple[Any, ...], carried: tuple[Node, ...]) -> Any:
            values, written = one_pass(*given, carried)
            return values, tuple(written)

        def kernel(*given: Any) -> Any:
            lacking = len(arguments) - len(given)
            given = (*given, *(defaults[-lacking:] if lacking else ()))
            key = node(0.0, "key", tuple(node(g) for g in given), plain.__name__)
            carried = tuple(
                memory(f"{plain.__name__}_{n}", node(0.0, "key", (key,), n)) for n in kept
            )
            starts, at_first = explored(lambda: pass_of(given, ()))
            updates, later = explored(lambda: pass_of(given, carried))
            for each, start, update in zip(carried, starts, updates, strict=True):
                each.update = self.started(node(start), node(update))
            out = Rows(self.started(a, b) for a, b in zip(at_first, later, strict=True))
            return out[0] if len(out) == 1 else out

        return kernel


class _Previous(ast.NodeTransformer):
    """Writes ``BEFORE`` in place of ``k - 1``."""

    def visit_BinOp(self, given: ast.BinOp) -> ast.AST:
        if isinstance(given.left, ast.Name) and given.left.id == "k":
            return ast.Name("BEFORE", ast.Load())
        return self.generic_visit(given)


def _loop(plain: FunctionType) -> bool:
    return "for k in range(1, len(" in inspect.getsource(plain)


def _assigned(body: list[ast.stmt]) -> list[str]:
    """Return the variables that statements assign, in order."""
    found = (
        n.id
        for s in body
        for n in ast.walk(s)
        if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    )
    return list(dict.fromkeys(found))


def _names(code: CodeType) -> set[str]:
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*(_names(c) for c in inner))
