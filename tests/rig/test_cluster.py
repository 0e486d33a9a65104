"""A proof is the same bytes from one process and from workers, of which one is killed."""

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.provenance import sha256
from rig.results.prove import cluster, run
from rig.results.prove.engine import Processes, bundle
from rig.results.prove.run import begin_from, diagnose_all, score_all
from tests.rig import proof_parts
from tests.rig.workers import parent

distributed = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[2]
PATIENCE_S = 60.0
"""Of a command that never ends."""
TIMED = {
    "created",
    "seconds",
    "seconds_each",
}
CAMPAIGN = """campaign: 1
bench: {motion: rotary, torque_constant: 0.1}
recordings: [{file: a.csv, channels: {time: t, angle: q, current: i}}]
"""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have trials and diagnoses that are made up in this process."""
    monkeypatch.setattr(run, "_seal", proof_parts.seal)
    monkeypatch.setattr("rig.results.prove.judge.judge", proof_parts.judge)
    monkeypatch.setattr("rig.results.prove.judge.oracle_of", proof_parts.oracle_of)
    monkeypatch.setattr("rig.results.prove.simulate.floors_of", proof_parts.floors_of)


@pytest.mark.proof
@pytest.mark.usefixtures("quick")
def test_the_same_bytes_from_a_cluster_of_which_a_worker_is_killed(tmp_path, monkeypatch):
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
        [sys.executable, "-c", command, *options, "--out", "proof", "--cluster", "2"],
        cwd=other,
        env={**os.environ, **variables, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert (tmp_path / "died").exists(), "no worker was killed"
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


class Away:
    """An engine whose workers share no files with this process."""

    shares_files = False

    def each(self, one: Callable[[Any], Any], todo: Iterable[Any]) -> Iterator[Any]:
        yield from reversed([one(task) for task in todo])


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    """Return three rigs that others have sealed, one with a reference."""
    home = tmp_path / "sealed"
    (home / "sealed" / "b.reference").mkdir(parents=True)
    (home / "sealed" / "b.reference" / "campaign.yaml").write_text(CAMPAIGN)
    for name, truth in (("a", "{}"), ("b", "{backlash: {gap_rad: 0.1}}"), ("c", "{cogging: {}}")):
        (home / name).mkdir()
        (home / name / "campaign.yaml").write_text(CAMPAIGN)
        (home / name / "a.csv").write_text(f"t,q,i\n{name}\n")
        (home / "sealed" / f"{name}.yaml").write_text(f"truth: 1\neffects: {truth}\n")
    return home


def test_the_same_bytes_from_workers_that_share_no_files(tmp_path: Path, sealed: Path) -> None:
    found = []
    for engine in (Processes(1), Away()):
        out = tmp_path / type(engine).__name__
        proof = begin_from(out, 9, 3, sealed)
        diagnose_all(proof, proof_parts.judge, engine, lambda what, share: None)
        oracle, floors = proof_parts.oracle_of, proof_parts.floors_of
        score_all(proof, oracle, floors, engine, lambda what, share: None)
        files = [f for f in sorted(out.rglob("*")) if f.is_file() and f.parent.name != "times"]
        found.append({f.relative_to(out): f.read_bytes() for f in files})
    assert found[0] == found[1]
    assert len(found[0]) == 1 + 3 * 3 + 1
    assert json.loads(found[0][Path("rows/b.json")])["oracle"]["oracle_rms"]


def test_a_campaign_with_files_elsewhere_cannot_travel(sealed: Path) -> None:
    file = sealed / "a" / "campaign.yaml"
    file.write_text(CAMPAIGN.replace("a.csv", "../b/a.csv"))
    with pytest.raises(InputError, match=r"\.\./b/a\.csv: outside the campaign's folder"):
        bundle(file)


class Client:
    """A client whose scheduler has no workers, and is gone when a task is cancelled."""

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": {}}

    def submit(self, call: object, task: object, pure: bool) -> str:
        return "a task that waits"

    def cancel(self, futures: object, force: bool) -> None:
        raise distributed.comm.CommClosedError("closed")

    def as_current(self) -> AbstractContextManager[None]:
        return nullcontext()


KEPT = "the scheduler is gone; all finished work is kept"


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (TimeoutError(), "no worker for 180 s"),
        (distributed.client.FuturesCancelledError([]), KEPT),
        (distributed.comm.CommClosedError("closed"), KEPT),
    ],
    ids=["no worker", "cancelled", "closed"],
)
def test_neither_workers_that_never_come_nor_a_scheduler_that_ends_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, error: Exception, message: str
) -> None:
    def wait(futures: object, timeout: float, return_when: str) -> None:
        raise error

    monkeypatch.setattr(cluster.distributed, "wait", wait)
    with pytest.raises(InputError, match=message):
        list(cluster.DaskCluster(Client(), "--scheduler x").each(abs, [1]))


def test_the_digest_is_that_of_this_programs_code() -> None:
    assert cluster._fingerprint()["code"] != sha256(b"")[:12]


def test_a_worker_with_other_packages_is_refused() -> None:
    assert cluster._on_worker(abs, cluster._fingerprint(), -2) == 2
    with pytest.raises(
        InputError, match=r"numpy \S+ instead of 1\.0: the results of this worker could"
    ):
        cluster._on_worker(abs, {**cluster._fingerprint(), "numpy": "1.0"}, -2)


@pytest.mark.parametrize(
    ("address", "open_"),
    [("tls://10.0.0.5:8786", False), ("bench.example:8786", True), ("tcp://[::1]:8786", False)],
)
def test_a_scheduler_that_others_can_reach_without_keys_is_warned_of(address, open_):
    assert cluster.unprotected(address) is open_


def test_one_engine_at_a_time_and_what_to_install_for_it(tmp_path, monkeypatch, capsys):
    out = ["--out", str(tmp_path / "proof")]
    assert status(["prove", "--jobs", "2", "--cluster", "2", *out]) == 2
    assert "give only one of these options" in capsys.readouterr().err
    monkeypatch.setattr(cluster, "distributed", None)
    assert status(["prove", "--cluster", "2", *out]) == 2
    assert "pip install 'loadrig[dask]'" in capsys.readouterr().err


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
