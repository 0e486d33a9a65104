"""Workers of a proof end with it; the work of a worker that dies is done again."""

from __future__ import annotations

import json
import os
import select
import signal
from pathlib import Path

import pytest

from tests.rig.workers import parent

PATIENCE_S = 60.0
"""Of the tests, where workers never start or never end."""


def test_the_work_of_a_process_that_is_killed_is_done_again(tmp_path: Path) -> None:
    with parent("dying", 0, tmp_path / "died") as process:
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    squares, message = json.loads(output)
    assert squares == [0, 1, 4, 9, 16]
    assert "died 3 times" in message
    assert "repeat the command with this --out" in message


@pytest.mark.parametrize(
    ("workers", "how"),
    [
        (0, signal.SIGINT),
        (0, signal.SIGKILL),
        pytest.param(2, signal.SIGKILL, marks=pytest.mark.proof),
    ],
)
def test_workers_end_with_their_parent(tmp_path: Path, workers: int, how: signal.Signals) -> None:
    """Two processes, or a cluster of ``workers``."""
    if workers:
        pytest.importorskip("distributed")
    fifo = tmp_path / "alive"
    os.mkfifo(fifo)
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with parent("hanging", workers, fifo) as process:
            started = b""
            while len(started) < 2:
                started += _next(reading)
            if how == signal.SIGINT:
                os.killpg(process.pid, how)  # as a terminal does
            else:
                process.send_signal(how)
            _, errors = process.communicate(timeout=PATIENCE_S)
            assert process.returncode == {signal.SIGINT: 3}.get(how, -how), errors
        assert _next(reading) == b"", "end of file: no worker holds the pipe any more"
    finally:
        os.close(reading)


def _next(reading: int) -> bytes:
    ready, _, _ = select.select([reading], [], [], PATIENCE_S)
    assert ready, "workers are still there"
    return os.read(reading, 1)
