"""Imports optional libraries of file formats when a file needs them, and keeps their warnings."""

from __future__ import annotations

import gc
import importlib
import logging
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.common.errors import InputError

_MOST_WORDS = 200
"""Greatest length of a library's warning that is shown to the user, characters."""


def library(name: str, path: Path, format_name: str, extra: str) -> Any:
    """Import an optional library.

    Args:
        name: Name of the module.
        path: The file that needs the library, for the message.
        format_name: Format of the file, for the message.
        extra: The extra of this program that installs the library.

    Raises:
        InputError: The library is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.split(".")[0]
        raise InputError(
            f"{path}: reading {format_name} needs {package}; install it with: pip install "
            f"'loadrig[{extra}]'"
        ) from error


class _Heard(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.words: dict[str, int] = {}

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())[:_MOST_WORDS]
        self.words[text] = self.words.get(text, 0) + 1


@contextmanager
def heard(logger: str) -> Iterator[list[str]]:
    """Do not show the warnings of a library on the terminal; yield a list that contains them at the
    end.
    """
    log, handler, found = logging.getLogger(logger), _Heard(), list[str]()
    propagate, handlers = log.propagate, log.handlers
    # Some libraries install their own handlers, which print the warnings.
    log.propagate, log.handlers = False, [handler]
    try:
        yield found
    finally:
        log.propagate, log.handlers = propagate, handlers
        found += [text if n == 1 else f"{text} ({n} times)" for text, n in handler.words.items()]


@contextmanager
def quiet_ends() -> Iterator[None]:
    """Release the objects in the stack frames of a library's error, and suppress the errors that
    these incomplete objects raise when they are deleted.
    """
    before = sys.unraisablehook
    try:
        yield
    except BaseException as error:
        sys.unraisablehook = lambda _: None
        chained: BaseException | None = error
        while chained is not None:
            traceback.clear_frames(chained.__traceback__)
            chained = chained.__context__
        gc.collect()
        raise
    finally:
        sys.unraisablehook = before
