"""Resolves dotted names in documents, so that tests compare documents with the code."""

import importlib


def found(name: str) -> object:
    """Return the module, class, function or attribute that a dotted name stands for.

    Raises:
        ModuleNotFoundError: No part of the name is a module.
        AttributeError: The module has no such name.
    """
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            value: object = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[end:]:
            value = _attribute(value, attribute)
        return value
    raise ModuleNotFoundError(name)


def _attribute(value: object, name: str) -> object:
    """Return an attribute; the annotation where a dataclass declares a field without a default."""
    annotations = getattr(value, "__annotations__", {})
    if not hasattr(value, name) and name in annotations:
        return annotations[name]
    return getattr(value, name)
