"""Chooses the engine that the command line asks for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rig.common.errors import InputError
from rig.results.prove.engines.engine import Engine
from rig.results.prove.engines.processes import Processes


@contextmanager
def engine(jobs: int, workers: int | None, scheduler: str | None) -> Iterator[Engine]:
    """Yield the engine of ``--jobs``, ``--cluster`` or ``--scheduler``; the workers of the engine
    end with the context.

    Args:
        jobs: Processes of this command.
        workers: Workers of a local cluster, or None.
        scheduler: Address of a scheduler, or None.

    Raises:
        InputError: More than one of the options is given, or the cluster cannot be used.
    """
    if sum((jobs > 1, workers is not None, scheduler is not None)) > 1:
        raise InputError(
            "--jobs, --cluster and --scheduler each choose an engine; give only one of these "
            "options"
        )
    if workers is None and scheduler is None:
        yield Processes(jobs)
        return
    # Imported late: the import of dask takes a second, and only these two options need dask.
    from rig.results.prove.engines.cluster import local_cluster, remote_cluster

    if workers is not None:
        with local_cluster(workers) as cluster:
            yield cluster
    elif scheduler is not None:
        with remote_cluster(scheduler) as cluster:
            yield cluster
