"""Imports a module in a thread while the program computes something else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Thread


@contextmanager
def imported_ahead(module: str) -> Iterator[None]:
    """Import a module in a thread during the block; compiled kernels leave the interpreter free.

    An error of this import is not raised; the later import statement raises it again.
    """

    def load() -> None:
        with suppress(Exception):
            import_module(module)

    thread = Thread(target=load, name=f"import of {module}")
    thread.start()
    try:
        yield
    finally:
        thread.join()
