"""Engines that divide the work of a proof among processes of this command, or among the workers of
a dask cluster.

An engine calls a function with each task of a list, and yields the results as they arrive.
Function, tasks and results are sent between processes: the function must be importable, tasks and
results must be plain data, and the result of a task must depend on the task alone. Only the calling
process writes files, so that no file depends on the number or on the order of the workers.
"""

from __future__ import annotations

from rig.results.prove.engines.engine import Engine, Processes

__all__ = ["Engine", "Processes"]
