"""A proof is the same bytes from one process and from workers, of which one is killed."""

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from rig.cli.entry import status
from rig.results.prove import run
from tests.rig import proof_parts
from tests.rig.workers import parent

ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0
"""Of a command that never ends."""
TIMED = {
    "created",
    "seconds",
    "seconds_each",
}


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have trials and diagnoses that are made up in this process."""
    monkeypatch.setattr(run, "_seal", proof_parts.seal)
    monkeypatch.setattr("rig.results.prove.judge.judge", proof_parts.judge)
    monkeypatch.setattr("rig.results.prove.judge.oracle_of", proof_parts.oracle_of)
    monkeypatch.setattr("rig.results.prove.simulate.floors_of", proof_parts.floors_of)


@pytest.mark.proof
@pytest.mark.usefixtures("quick")
def test_the_same_bytes_from_processes_of_which_one_is_killed(tmp_path, monkeypatch):
    options = ["prove", "--seed", "3", "--rigs", "3"]
    monkeypatch.chdir(tmp_path)
    assert status([*options, "--out", "proof"]) == 0
    alone = content(tmp_path / "proof")
    assert alone["SHA256SUMS"].count(b"\n") == 10, "settings, diagnoses, judgements and rows"
    assert len([name for name in alone if name.endswith("a.npz")]) == 6
    other = tmp_path / "elsewhere"
    other.mkdir()
    command = (
        "from tests.rig import proof_parts; from rig.cli.entry import status; import sys; "
        "sys.exit(status(sys.argv[1:]))"
    )
    variables = {"PROOF_PARTS": "", proof_parts.DIES: str(tmp_path / "died")}
    ended = subprocess.run(
        [sys.executable, "-c", command, *options, "--out", "proof", "--jobs", "2"],
        cwd=other,
        env={**os.environ, **variables, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert (tmp_path / "died").exists(), "no process was killed"
    assert content(other / "proof") == alone


def content(out: Path) -> dict[str, bytes]:
    """Return the bytes of the files of a proof, without dates and durations."""
    files = {f.relative_to(out).as_posix(): f for f in out.rglob("*") if f.is_file()}
    result = untimed(json.loads(files.pop("prove.json").read_text()))
    kept = {n: f.read_bytes() for n, f in files.items() if not n.startswith(("times/", "report"))}
    return {**kept, "prove.json": json.dumps(result).encode()}


def untimed(value: object) -> object:
    if isinstance(value, Mapping):
        return {k: untimed(v) for k, v in value.items() if k not in TIMED}
    return [untimed(v) for v in value] if isinstance(value, list) else value


def test_the_work_of_a_process_that_is_killed_is_done_again(tmp_path: Path) -> None:
    with parent("dying", tmp_path / "died") as process:
        output, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    squares, message = json.loads(output)
    assert squares == [0, 1, 4, 9, 16]
    assert "died 3 times" in message
    assert "repeat the command with this --out" in message


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_their_parent(tmp_path: Path, how: signal.Signals) -> None:
    fifo = tmp_path / "alive"
    os.mkfifo(fifo)
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with parent("hanging", fifo) as process:
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
