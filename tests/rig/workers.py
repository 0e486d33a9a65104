"""Parents whose workers hang or die, which ``test_cluster`` runs in processes of their own."""

import json
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from subprocess import PIPE, Popen

from rig.common.errors import InputError
from rig.results.prove.engine import Engine, Processes


def hang(fifo: str) -> None:
    """Say so through the pipe, hold it open, and do not come back."""
    with open(fifo, "wb", buffering=0) as pipe:
        pipe.write(b"!")
        threading.Event().wait(120.0)


def square_or_die(task: tuple[int, str]) -> int:
    """Return the square; killed where the number is negative or the file is not there yet."""
    number, file = task
    try:
        Path(file).touch(exist_ok=number < 0)
    except FileExistsError:
        return number**2
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def hanging(engine: Engine, file: str) -> None:
    with suppress(KeyboardInterrupt):
        list(engine.each(hang, [file] * 2))
    sys.exit(3)


def dying(engine: Engine, file: str) -> None:
    """Print the squares, and the message after a task that kills every worker."""
    squares = sorted(engine.each(square_or_die, [(n, file) for n in range(5)]))
    try:
        list(engine.each(square_or_die, [(-1, file)]))
    except InputError as error:
        print(json.dumps([squares, str(error)]))


def main() -> None:
    """Run what the command line names on an engine."""
    name, workers, file = sys.argv[1:]
    if int(workers):
        from rig.results.prove.cluster import local_cluster
    with local_cluster(int(workers)) if int(workers) else nullcontext(Processes(2)) as engine:
        {"hanging": hanging, "dying": dying}[name](engine, file)


@contextmanager
def parent(name: str, workers: int, file: Path) -> Iterator[Popen[str]]:
    """Run :func:`main` in a process and a process group of its own."""
    root = str(Path(__file__).parents[2])
    command = "from tests.rig import workers; workers.main()"
    with Popen(
        [sys.executable, "-c", command, name, str(workers), str(file)],
        env={**os.environ, "PYTHONPATH": root},
        stdout=PIPE,
        stderr=PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()
