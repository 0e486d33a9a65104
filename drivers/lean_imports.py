"""Imports python-can without a log format that this program does not use.

python-can imports asammdf, and with it pandas, wherever they are installed: a third of a second at
the start of each command. The drivers use no log format of python-can, and MDF files are read with
asammdf itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType

_MODULE, _LIBRARY = "can.io.mf4", "asammdf"


def install() -> None:
    """Hide asammdf from python-can's module for MDF files, which python-can allows to be absent."""
    sys.meta_path.insert(0, _Finder())


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module with another loader; None for every other module."""
        if fullname != _MODULE or _LIBRARY in sys.modules:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    def exec_module(self, module: ModuleType) -> None:
        """Run the module while the library cannot be imported."""
        sys.modules[_LIBRARY] = None  # type: ignore[assignment]
        try:
            super().exec_module(module)
        finally:
            del sys.modules[_LIBRARY]
