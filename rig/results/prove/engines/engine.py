"""Interface of all engines, and the error that is raised if workers die."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

from rig.common.errors import InputError

Task = TypeVar("Task")
Result = TypeVar("Result")

DEATHS = 3
"""Number of workers that may die in a row, or on one task, without a result."""


class Engine(Protocol):
    """Calls a function with each of many tasks, in worker processes.

    Attributes:
        shares_files: Whether workers read the files of this process at the same paths.
    """

    @property
    def shares_files(self) -> bool: ...  # noqa: D102 - see the class

    def each(self, one: Callable[[Task], Result], todo: Iterable[Task]) -> Iterator[Result]:
        """Yield results in the order in which they arrive.

        A task whose worker dies is given to another worker.

        Args:
            one: Function that does one task; it must be importable.
            todo: The tasks; each is taken when a worker is free.

        Raises:
            InputError: Workers die repeatedly on the tasks.
        """
        ...


def died(what: str) -> InputError:
    """Return the error for workers that die repeatedly.

    Args:
        what: What died, and how often.
    """
    return InputError(
        f"{what}, perhaps for lack of memory; all finished work is kept: repeat the command with "
        f"this --out and with fewer --jobs or workers"
    )
