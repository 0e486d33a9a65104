"""Imports a module in a thread while the program computes something else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Thread


@contextmanager
def imported_ahead(module: str) -> Iterator[None]:
    """Import a module in a thread while the block runs; compiled code in the block releases the
    interpreter.

    An error of this import is ignored; a later import statement raises the error again.
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
