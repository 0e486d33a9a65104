"""One figure or table of the paper, with our result."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.mock.plant.parts.constants import Machine
from identification.recording import Array
from rig.common.places import write_json
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.planning.feedforward import Feedforward, load_feedforward
from rig.results.document import Picture, Table
from rig.results.identify.identify import Request, identification_record, identify_source
from rig.runs.run import bench_constants

Rows = tuple[tuple[str, ...], Sequence[Sequence[float | str]]]
"""Column titles with their units, and the rows of the table."""


@dataclass(frozen=True)
class Exhibit:
    """Content of the page under one heading.

    Attributes:
        name: Key in the result file, and file name of its data: ``fig_2``.
        title: Heading.
        paper: What the paper prints or shows, as text.
        found: Our results, one sentence each.
        pictures: Figures; the first is named like the exhibit.
        data: Plotted data by the name of the picture.
        table: Values side by side, if any.
    """

    name: str
    title: str
    paper: str
    found: tuple[str, ...]
    pictures: tuple[Picture, ...] = ()
    data: Mapping[str, Rows] | None = None
    table: Table | None = None


def columns(**named: Array) -> Rows:
    """Return arrays of one length, shape (n,), as rows; each title is a ``name`` with its unit
    (``time_s``).
    """
    return tuple(named), list(zip(*(values.tolist() for values in named.values()), strict=True))


def data_files(exhibits: Sequence[Exhibit]) -> dict[str, str]:
    """Return the CSV text with the numbers of every picture, by the name of its file relative to
    the page.
    """
    return {
        _data_file(name): _csv(rows)
        for exhibit in exhibits
        for name, rows in (exhibit.data or {}).items()
    }


def files_of(exhibits: Sequence[Exhibit]) -> dict[str, list[str]]:
    """Return the paths of each picture and of its plotted data, relative to the page, by the name
    of the picture.
    """
    files = {picture.name: [picture.file] for e in exhibits for picture in e.pictures}
    for exhibit in exhibits:
        for name in exhibit.data or {}:
            files.setdefault(name, []).append(_data_file(name))
    return files


def _data_file(name: str) -> str:
    return f"data/{name}.csv"


def _csv(rows: Rows) -> str:
    titles, lines = rows
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(titles)
    writer.writerows(
        [cell if isinstance(cell, str) else f"{cell:.9g}" for cell in line] for line in lines
    )
    return text.getvalue()


def true_machine(name: str) -> Machine:
    """Return the simulated machine of a packaged bench.

    Raises:
        ValueError: The bench has no simulated machine.
    """
    machine = load_bench(name).value.mock
    if machine is None:
        raise ValueError(f"the packaged bench {name!r} has no simulated machine")
    return machine


def identified(
    name: str, scratch: Path, seed: int, progress: Callable[[str, float], None]
) -> Feedforward:
    """Run ``figure10`` on a packaged bench and identify that run.

    Args:
        name: Name of the bench.
        scratch: Empty folder for the run and its result.
        seed: Seed of the bench's noise and of the method.
        progress: Called with the current step and the completed share.
    """
    bench = load_bench(name)
    progress(f"running figure10 on {name}", 0.0)
    run_simulated(bench, load_sequence("figure10"), seed, scratch / f"{name}-run")
    outcome = identify_source(scratch / f"{name}-run", Request(seed=seed), progress)
    result = scratch / f"{name}.json"
    write_json(result, identification_record(outcome.results[0], outcome.provenance))
    return load_feedforward(result, bench_constants(bench.value))
