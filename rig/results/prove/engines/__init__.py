"""Engines that share the work of a proof out: processes of this command, or a dask cluster.

An engine calls a function on each of some tasks and yields the results as they arrive. Function,
tasks and results travel between processes, so that they must be importable and plain; the work on a
task depends on the task alone. Only the process that asks writes files, so that neither the number
of workers nor their order shows in a file.
"""

from __future__ import annotations

from rig.results.prove.engines.engine import Engine
from rig.results.prove.engines.processes import Processes

__all__ = ["Engine", "Processes"]
