"""Engines that divide the work of a proof among processes of this command, or among the workers of
a dask cluster.

An engine calls a function with each task of a list, and yields the results as they arrive.
Function, tasks and results are sent between processes: the function must be importable, tasks and
results must be plain data, and the result of a task must depend on the task alone. Only the calling
process writes files, so that no file depends on the number or on the order of the workers.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any, NamedTuple, Protocol, TypeVar

import rig
from rig.common.errors import InputError
from rig.common.places import is_file, read_bytes, replacing
from rig.common.text import changed_texts
from rig.config.campaign import load_campaign

Task = TypeVar("Task")
Result = TypeVar("Result")

DEATHS = 3  # number of workers that may die in a row, or on one task, without a result


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
        """
        ...


def died(what: str) -> InputError:
    """Return the error for workers that die repeatedly."""
    return InputError(
        f"{what}, perhaps for lack of memory; all finished work is kept: repeat the command with "
        f"this --out and with fewer --jobs or workers"
    )


Files = Mapping[str, bytes]  # contents of files by their paths relative to a folder, with slashes


class Bundle(NamedTuple):
    """A campaign with the files of its folder."""

    folder: str
    campaign: str
    files: Files


def read_folder(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder and of the folders in it, in order of their names."""
    found = sorted(f for f in folder.rglob("*") if is_file(f))
    return {f.relative_to(folder).as_posix(): read_bytes(f) for f in found}


def write_folder(folder: Path, files: Files) -> None:
    """Write files into a folder, in their order, each by one rename."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            draft.write_bytes(content)


def bundle(campaign: Path) -> Bundle:
    """Return a campaign in the form in which it is sent to a worker on another machine."""
    folder = campaign.parent
    try:
        named = [name for r in load_campaign(campaign).value.recordings for name in r.patterns]
    except InputError:
        named = []  # The worker reports the error as the result of this rig.
    astray = [n for n in named if Path(n).is_absolute() or ".." in Path(n).parts]
    if astray:
        raise InputError(
            f"{campaign}: {', '.join(astray)}: outside the campaign's folder, so that a worker on "
            f"another machine cannot read the files; move these files into {folder}, or use --jobs"
        )
    try:
        return Bundle(folder.name, campaign.name, read_folder(folder))
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error


@contextmanager
def unpacked(given: Path | Bundle) -> Iterator[Path]:
    """Yield the path of a campaign file; a bundle is first written into a temporary folder."""
    if isinstance(given, Path):
        yield given
        return
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        folder = Path(scratch) / given.folder
        write_folder(folder, given.files)
        yield folder / given.campaign


def without_place(record: Any, folder: Path) -> Any:
    """Return a record that does not depend on the places of its folder and of this program."""
    places = {folder.parent, folder.parent.absolute(), folder.parent.resolve()} - {Path(".")}
    homes = [str(p) for p in sorted(places, key=lambda p: -len(str(p)))]
    homes.append(str(Path(rig.__file__).parents[1]))
    pattern = re.compile("|".join(re.escape(home) + r"[/\\]" for home in homes))
    return changed_texts(record, lambda text: pattern.sub("", text))


ORPHANED = 1  # exit status of a worker whose parent has died
AHEAD = 2  # number of tasks per worker that are submitted at once


class Processes(NamedTuple):
    """Engine of processes on this machine."""

    jobs: int

    @property
    def shares_files(self) -> bool:
        """Return True: the workers can read the files of this process."""
        return True

    def each(self, one: Callable[[Task], Result], todo: Iterable[Task]) -> Iterator[Result]:
        """Yield results as they arrive; see :class:`rig.results.prove.engine.Engine`."""
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
        """Yield results until all tasks are done; ``waiting`` has those without a result."""
        with ProcessPoolExecutor(
            self.jobs, mp_context=get_context("spawn"), initializer=_follow_parent
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


def _follow_parent() -> None:
    """End this worker with its parent; its own ends of the queue hide the end of file."""
    parent = parent_process()
    assert parent is not None, "not a worker"

    def end() -> None:
        parent.join()
        os._exit(ORPHANED)

    Thread(target=end, name="parent watch", daemon=True).start()


@contextmanager
def engine(jobs: int, workers: int | None, scheduler: str | None) -> Iterator[Engine]:
    """Yield the engine of ``--jobs``, ``--cluster`` or ``--scheduler``; workers end with it."""
    if sum((jobs > 1, workers is not None, scheduler is not None)) > 1:
        raise InputError(
            "--jobs, --cluster and --scheduler each choose an engine; give only one of these "
            "options"
        )
    if workers is None and scheduler is None:
        yield Processes(jobs)
        return
    # Imported late: the import of dask takes a second, and only these two options need dask.
    from rig.results.prove.cluster import local_cluster, remote_cluster

    if workers is not None:
        with local_cluster(workers) as cluster:
            yield cluster
    elif scheduler is not None:
        with remote_cluster(scheduler) as cluster:
            yield cluster
