"""Shares work among processes that end when the process that started them ends."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

from rig.common.allocation import keep_freed_memory

Task = TypeVar("Task")
Result = TypeVar("Result")

ORPHANED = 1
"""Exit status of a worker whose parent has died."""


def each(one: Callable[[Task], Result], todo: Sequence[Task], jobs: int) -> Iterator[Result]:
    """Yield results in the order in which they arrive.

    Args:
        one: The work on one item; with more than one job it must be importable.
        todo: The items.
        jobs: Processes; one does the work here.
    """
    if jobs == 1:
        yield from map(one, todo)
        return
    with ProcessPoolExecutor(
        jobs, mp_context=get_context("spawn"), initializer=begin_worker
    ) as pool:
        try:
            for future in as_completed([pool.submit(one, task) for task in todo]):
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def begin_worker() -> None:
    """Set up a worker process as the command line sets up its own process."""
    keep_freed_memory()
    follow_parent()


def follow_parent() -> None:
    """End this worker when its parent ends, whatever signal ends the parent.

    A worker that waits for work holds both ends of its queue, so it never reads an end of file.
    """
    Thread(target=_end_with_parent, name="parent watch", daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None, "not a worker"
    parent.join()
    os._exit(ORPHANED)
