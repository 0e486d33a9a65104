"""Errors that the user can correct: unusable input, unwritable output, a bench in use."""

from __future__ import annotations

from collections.abc import Iterable


class InputError(Exception):
    """A file that the user wrote or named cannot be used; the command line exits with status 2.

    Attributes:
        problems: All problems found, one line each: ``file:line:column: path: message (got VALUE)``
            for configuration, ``file: row N: message`` for recordings.
    """

    def __init__(self, problems: str | Iterable[str]) -> None:
        self.problems: tuple[str, ...] = (
            (problems,) if isinstance(problems, str) else tuple(problems)
        )
        super().__init__("\n".join(self.problems))


class StorageError(Exception):
    """A recording, a run folder or a lock file cannot be written; the command line exits with
    status 4.
    """


class InUseError(Exception):
    """A bench or a run folder is held by another program; the command line exits with status 4."""
