"""The definitions of Python modules in a form that does not depend on where they stand."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from typing import NamedTuple

PLACE = {"__file__", "__name__", "__package__"}
"""Names whose value depends on the module that they stand in."""
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)
Target = tuple[str, str]
"""Module and definition that a name stands for; the module itself with an empty definition."""


class Definition(NamedTuple):
    """A definition: place, tree without names, the names in order, what some of them stand for."""

    place: Target
    tree: str
    names: tuple[str, ...]
    targets: tuple[Target, ...]


class Code:
    """The modules of one revision, from dotted name to text."""

    def __init__(self, sources: Mapping[str, str]) -> None:
        self.trees = {module: ast.parse(text) for module, text in sources.items()}
        self.imports = {module: dict(imported(tree)) for module, tree in self.trees.items()}
        self.own = {
            module: {own for name, _ in parts(tree) for own in name.split(".")[0].split(",")}
            for module, tree in self.trees.items()
        }
        self.definitions = [
            Reader(self, (module, name), node).definition
            for module, tree in self.trees.items()
            for name, node in parts(tree)
        ]

    def find(self, module: str, name: str) -> Target:
        """Return what a name of a module stands for, through modules that pass it on."""
        here, source = (module, name), self.imports.get(module, {}).get(name)
        if source is None or source == here or name in self.own[module]:
            inner = f"{module}.{name}"
            return (inner, "") if inner in self.trees else here
        return self.find(*source) if source[1] else source


class Reader(ast.NodeTransformer):
    """Takes docstrings, imports and names out of the syntax tree of a definition."""

    def __init__(self, code: Code, place: Target, node: ast.stmt) -> None:
        self.code, self.module, self.node = code, place[0], node
        self.names, self.targets = [place[1]], list[Target]()
        inner = ast.iter_child_nodes(node) if isinstance(node, FUNCTION) else ()
        self.local = {name for child in inner for name in bound(child)}
        tree = ast.dump(self.visit(node))
        self.definition = Definition(place, tree, tuple(self.names), tuple(self.targets))

    def target(self, node: ast.AST) -> Target | None:
        """Return what a name stands for, None for a local one or an attribute of an object."""
        if isinstance(node, ast.Attribute):
            owner = self.target(node.value)
            return self.code.find(owner[0], node.attr) if owner and not owner[1] else None
        if not isinstance(node, ast.Name) or node.id in self.local:
            return None
        known = node.id in self.code.own[self.module] or node.id in self.code.imports[self.module]
        return self.code.find(self.module, node.id) if known else None

    def visit(self, node: ast.AST) -> ast.AST:
        """Return the node with placeholders for names, without what is silent."""
        if isinstance(node, ast.Name) and node.id in PLACE:
            return ast.Name(f"{self.module}:{node.id}")
        if not isinstance(getattr(node, "ctx", None), ast.Store) and (target := self.target(node)):
            self.names.append(target[1] or "module")
            self.targets.append(target)
            return ast.Name("@")
        methods = FUNCTION if node is self.node and isinstance(node, ast.ClassDef) else ()
        for field in ("body", "orelse", "finalbody"):
            if isinstance(inner := getattr(node, field, None), list):
                kept = [i for i in inner if not silent(i) and not isinstance(i, methods)]
                setattr(node, field, kept)
        for field in ("id", "attr", "arg", "name"):
            if isinstance(name := getattr(node, field, None), str):
                self.names += [] if node is self.node else [f"{type(node).__name__[0]}:{name}"]
                setattr(node, field, "@")
        return self.generic_visit(node)


def silent(node: ast.AST) -> bool:
    """Return whether a statement is a docstring, an import or without effect."""
    text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    empty = isinstance(node, ast.If) and all(silent(item) for item in node.body + node.orelse)
    return text or empty or isinstance(node, ast.Import | ast.ImportFrom | ast.Pass)


def imported(tree: ast.AST) -> Iterator[tuple[str, Target]]:
    """Yield each imported name and what it stands for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from ((i.asname or i.name, (node.module or "", i.name)) for i in node.names)
        elif isinstance(node, ast.Import):
            for item in node.names:
                first = item.name.split(".")[0]
                yield item.asname or first, (item.name if item.asname else first, "")


def bound(node: ast.AST) -> Iterator[str]:
    """Yield the names that get a value inside a node."""
    for item in ast.walk(node):
        if isinstance(item, ast.Name) and isinstance(item.ctx, ast.Store):
            yield item.id
        elif isinstance(item, (*FUNCTION, ast.ClassDef, ast.ExceptHandler, ast.MatchAs)):
            yield item.name or ""
        elif isinstance(item, ast.arg):
            yield item.arg


def parts(tree: ast.Module) -> Iterator[tuple[str, ast.stmt]]:
    """Yield name and syntax tree of each definition of a module; methods before their class."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            inner = (item for item in node.body if isinstance(item, FUNCTION))
            yield from ((f"{node.name}.{method.name}", method) for method in inner)
        name = getattr(node, "name", "") or ",".join(bound(node))
        if not silent(node) and name != "__all__":
            yield name, node
