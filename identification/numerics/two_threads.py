"""Computes two parts of a result at the same time, the second part in a thread that is kept for
the next computation.

Compiled kernels release the interpreter lock, so that two kernels run on two cores. The thread is
kept because to start a thread takes a tenth of the time of one run of the Kalman filter.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from threading import Lock
from typing import TypeVar, cast

One = TypeVar("One")
Other = TypeVar("Other")
Item = TypeVar("Item")
THREAD = "second thread of the kernels"
"""First part of the name of the thread."""


@cache
def _second(_process: int) -> tuple[ThreadPoolExecutor, Lock]:
    """Return the second thread of a process, and the lock of the caller that uses the thread.

    The process is an argument, so that a forked process, which inherits only its main thread, gets
    a new second thread.
    """
    return ThreadPoolExecutor(1, thread_name_prefix=THREAD), Lock()


def idle() -> bool:
    """Return whether the second thread is free."""
    return not _second(os.getpid())[1].locked()


def both(one: Callable[[], One], other: Callable[[], Other]) -> tuple[One, Other]:
    """Return the results of two functions that are called at the same time.

    If the second thread is busy, for example because one of the functions uses it, the functions
    are called one after the other.
    """
    thread, used = _second(os.getpid())
    if not used.acquire(blocking=False):
        return one(), other()
    try:
        beside = thread.submit(other)
        try:
            first = one()
        finally:
            wait([beside])
        return first, beside.result()
    finally:
        used.release()


def each(function: Callable[[Item], One], items: Iterable[Item]) -> list[One]:
    """Return the results of a function for all items, in their order, with two items at a time.

    The function must not change data that another call of it reads.
    """
    todo, found, taking = iter(enumerate(items)), dict[int, One](), Lock()

    def work() -> None:
        while True:
            with taking:
                number, item = next(todo, (None, None))
            if number is None:
                return
            found[number] = function(cast(Item, item))

    both(work, work)
    return [found[number] for number in range(len(found))]
