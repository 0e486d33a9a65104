"""Divides work among the workers of a dask cluster: an existing cluster, or a cluster of worker
processes on this machine.

A cluster that this package starts listens on the loopback interface only, and accepts only
connections with a key that is made for this cluster and stays in memory. A scheduler that the user
started is trusted: anyone who can connect to such a scheduler can run any code on its workers and
in this process.
"""

from __future__ import annotations

import ipaddress
import logging
import platform
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.provenance import sha256
from rig.results.prove.engine import AHEAD, DEATHS, Result, Task, died
from rig.terminal.output import complain

try:
    import cryptography  # noqa: F401 - needed by the cluster's own keys
    import dask
    import distributed
except ImportError:
    dask = distributed = None

MISSING = (
    "--cluster and --scheduler need the packages distributed and cryptography; install them with: "
    "pip install 'loadrig[dask]'"
)
LOOPBACK = "127.0.0.1"
WAIT_S = 60.0  # time, s, within which a scheduler must answer, and must have a worker
IDLE = 3  # number of periods of `WAIT_S` after which a cluster without workers ends the command
PACKAGES = ("loadrig", "numpy", "scipy", "numba", "mujoco")
"""Packages that must have the same version on all workers, or the results may differ."""
OWN = ("rig", "drivers", "identification")
"""Packages of this program, of which workers must have the same code."""
SETTINGS: Mapping[str, Any] = {
    "distributed.scheduler.allowed-failures": DEATHS - 1,
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.profile.enabled": False,
    # On a busy machine a worker answers late, and a killed worker takes long to start again.
    "distributed.deploy.lost-worker-timeout": "10 minutes",
    "distributed.scheduler.worker-ttl": "30 minutes",
    "distributed.comm.timeouts.connect": "5 minutes",
    "distributed.comm.timeouts.tcp": "10 minutes",
    # A task contains the files of its trial.
    "distributed.admin.large-graph-warning-threshold": "1TB",
}


class DaskCluster:
    """Engine of the workers of a dask scheduler, which need not share files with this process."""

    shares_files = False  # workers may be on other machines

    def __init__(self, client: Any, where: str) -> None:
        """Use a connected client."""
        self._client = client
        self._where = where

    def each(self, one: Callable[[Task], Result], todo: Iterable[Task]) -> Iterator[Result]:
        """Yield results as they arrive; see :class:`rig.results.prove.engine.Engine`."""
        tasks, waiting = iter(todo), set[Any]()
        call = partial(_on_worker, one, _fingerprint())
        try:
            while True:
                room = AHEAD * max(self._workers(), 1) - len(waiting)
                for task in islice(tasks, max(room, 0)):
                    waiting.add(self._client.submit(call, task, pure=False))
                if not waiting:
                    return
                for future in self._first_of(waiting):
                    waiting.remove(future)
                    yield self._result(future)
                    future.release()
        finally:
            # Without a scheduler there is nothing to cancel, and its error has been raised.
            with suppress(*self._lost):
                self._client.cancel(list(waiting), force=True)

    def _first_of(self, waiting: Collection[Any]) -> Collection[Any]:
        """Wait for finished tasks; fail if there is no worker for ``IDLE * WAIT_S``."""
        without = 0
        while without < IDLE:
            try:
                with self._asking(), self._client.as_current():
                    done: set[Any] = distributed.wait(waiting, WAIT_S, "FIRST_COMPLETED").done
                return done
            except TimeoutError:
                # A worker that died needs time to start again.
                without = 0 if self._workers() else without + 1
        raise InputError(
            f"{self._where}: no worker for {IDLE * WAIT_S:g} s; all finished work is kept: start "
            "workers and repeat the command with this --out"
        )

    def _workers(self) -> int:
        with self._asking():
            return len(self._client.scheduler_info(n_workers=-1)["workers"])

    @property
    def _lost(self) -> tuple[type[BaseException], ...]:
        """Errors of a client whose scheduler is gone."""
        return distributed.CancelledError, distributed.comm.CommClosedError

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Turn the error of a scheduler that is gone into what it means to the user."""
        try:
            yield
        except self._lost as error:
            raise InputError(
                f"{self._where}: the scheduler is gone; all finished work is kept: start the "
                f"scheduler again and repeat the command with this --out"
            ) from error

    def _result(self, future: Any) -> Any:
        """Return the result of a finished task, or raise what its failure means to the user."""
        try:
            with self._asking():
                return future.result()
        except distributed.scheduler.KilledWorker as error:
            raise died(f"{self._where}: {DEATHS} workers died on one task") from error
        except ModuleNotFoundError as error:
            raise InputError(
                f"{self._where}: a worker cannot import {error.name}; install this version of "
                f"loadrig where the workers run"
            ) from error


def _on_worker(one: Callable[[Task], Result], expected: Mapping[str, str], task: Task) -> Result:
    """Do one task on a worker with the package versions of the calling process."""
    found = _fingerprint()
    other = [
        f"{name} {found.get(name, 'missing')} instead of {expected.get(name, 'none')}"
        for name in sorted({*found, *expected})
        if found.get(name) != expected.get(name)
    ]
    if other:
        raise InputError(
            f"worker on {platform.node()}: {'; '.join(other)}: the results of this worker could "
            "differ; install the versions of this process on that machine"
        )
    return one(task)


@cache
def _fingerprint() -> dict[str, str]:
    """Return the versions on which results depend, and a digest of this program's own code."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    root = Path(__file__).parents[3]
    files = sorted(f for own in OWN for f in (root / own).rglob("*.py"))
    code = b"".join(f.relative_to(root).as_posix().encode() + f.read_bytes() for f in files)
    return found | {"code": sha256(code)[:12]}


@contextmanager
def local_cluster(workers: int) -> Iterator[DaskCluster]:
    """Start worker processes on this machine, and end them with the context."""
    _require()
    with (
        tempfile.TemporaryDirectory(prefix="loadrig-workers-") as scratch,
        dask.config.set(SETTINGS),
        distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK,
            # With None, dask serves no dashboard, but its server would still take the port 8787.
            dashboard_address=f"{LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=None,
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
            security=distributed.Security.temporary(),
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield DaskCluster(client, f"--cluster {workers}")


@contextmanager
def remote_cluster(address: str) -> Iterator[DaskCluster]:
    """Connect to a scheduler that the user started; keys for TLS are in dask's configuration."""
    _require()
    if unprotected(address):
        complain(
            f"warning: {address}: without TLS, anyone who can reach this port can run code as you; "
            f"use tls:// (docs/guides/worlds.md)"
        )
    with dask.config.set(SETTINGS), distributed.utils.silence_logging_cmgr(logging.CRITICAL):
        try:
            client = distributed.Client(address, timeout=WAIT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"--scheduler {address}: cannot connect: {error}; start a scheduler with `dask "
                "scheduler`, or give the address that `dask scheduler` prints"
            ) from error
        with client:
            try:
                client.wait_for_workers(1, timeout=WAIT_S)
            except TimeoutError as error:
                raise InputError(
                    f"--scheduler {address}: no worker within {WAIT_S:g} s; start one with `dask "
                    f"worker {address} --nthreads 1`"
                ) from error
            yield DaskCluster(client, f"--scheduler {address}")


def unprotected(address: str) -> bool:
    """Return whether a scheduler can be reached from other machines without TLS, by its address."""
    protocol, _, rest = address.rpartition("://")
    if protocol in ("tls", "wss"):
        return False
    host = rest.rpartition(":")[0].strip("[]")
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host != "localhost"


def _require() -> None:
    if distributed is None:
        raise InputError(MISSING)
