"""Divides work among processes that end when their parent process ends."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import NamedTuple

from rig.common.allocation import keep_freed_memory
from rig.results.prove.engines.engine import DEATHS, Result, Task, died

ORPHANED = 1
"""Exit status of a worker whose parent has died."""
AHEAD = 2
"""Number of tasks per worker that are submitted at once."""


class Processes(NamedTuple):
    """Engine of processes on this machine.

    Attributes:
        jobs: Number of processes; with 1 the work is done in this process.
    """

    jobs: int

    @property
    def shares_files(self) -> bool:
        """Return True: the workers can read the files of this process."""
        return True

    def each(self, one: Callable[[Task], Result], todo: Iterable[Task]) -> Iterator[Result]:
        """Yield results as they arrive; see :class:`rig.results.prove.engines.engine.Engine`."""
        if self.jobs == 1:
            yield from map(one, todo)
            return
        tasks, again, deaths = iter(todo), list[Task](), 0
        while True:
            waiting: dict[Future[Result], Task] = {}
            try:
                for result in self._until_broken(one, tasks, again, waiting):
                    deaths = 0
                    yield result
                return
            except BrokenProcessPool as error:
                deaths += 1
                if deaths == DEATHS:
                    raise died(f"worker processes died {deaths} times without a result") from error
                again = [*again, *waiting.values()]

    def _until_broken(
        self,
        one: Callable[[Task], Result],
        tasks: Iterator[Task],
        again: list[Task],
        waiting: dict[Future[Result], Task],
    ) -> Iterator[Result]:
        """Yield results until all tasks are done.

        Args:
            one: Function that does one task.
            tasks: Tasks that were never submitted.
            again: Tasks to submit first, which this function removes from the list.
            waiting: Filled with the tasks that are submitted and have no result.

        Raises:
            BrokenProcessPool: A worker died.
        """
        with ProcessPoolExecutor(
            self.jobs, mp_context=get_context("spawn"), initializer=begin_worker
        ) as pool:
            try:
                while True:
                    while len(waiting) < AHEAD * self.jobs:
                        if not again:
                            again.extend(islice(tasks, 1))
                        if not again:
                            break
                        waiting[pool.submit(one, again[0])] = again[0]
                        del again[0]
                    if not waiting:
                        return
                    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                        result = future.result()
                        del waiting[future]
                        yield result
            finally:
                pool.shutdown(cancel_futures=True)


def begin_worker() -> None:
    """Set up a worker process with the settings that the command line gives its process."""
    keep_freed_memory()
    follow_parent()


def follow_parent() -> None:
    """End this worker when its parent ends, whatever signal ends the parent.

    A worker that waits for work holds both ends of its queue, and therefore reads no end of file
    when its parent ends.
    """
    Thread(target=_end_with_parent, name="parent watch", daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None, "not a worker"
    parent.join()
    os._exit(ORPHANED)
