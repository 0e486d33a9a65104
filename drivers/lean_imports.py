"""Imports python-can without asammdf, until a log file of the format MDF is read. If asammdf and
pandas are installed, python-can imports both, which takes a third of a second at the start of each
command.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType

_MODULE, _LIBRARY = "can.io.mf4", "asammdf"


def install() -> None:
    """Hide asammdf from python-can's module for MDF files; python-can works without asammdf."""
    sys.meta_path.insert(0, _Finder())


def mf4_module() -> ModuleType:
    """Return python-can's module for MDF files, imported with asammdf if asammdf is installed."""
    module = importlib.import_module(_MODULE)
    if getattr(module, _LIBRARY, None) is None:
        with suppress(ImportError):
            importlib.import_module(_LIBRARY)
            module = importlib.reload(module)
    return module


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import specification of python-can's module for MDF files with another loader,
        or None for all other modules.
        """
        if fullname != _MODULE or _LIBRARY in sys.modules:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        """Execute the module of python-can while asammdf cannot be imported."""
        sys.modules[_LIBRARY] = None  # type: ignore[assignment]
        try:
            super().exec_module(module)
        finally:
            del sys.modules[_LIBRARY]
