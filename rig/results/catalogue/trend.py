"""Tests each identified parameter of a bench for a change over the runs, at a stated false-alarm
rate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.numerics.change import LEAST_RUNS, Change, ChangeTest
from identification.recording import Array
from rig.results.catalogue.listing import copies_of
from rig.results.catalogue.words import place
from rig.runs.catalogue.entry import Constant, Details, Entry

FALSE_ALARMS = 0.01
"""Greatest share of the histories without change in which a change is reported."""
_HALF_WIDTHS = 1.6448536269514722
"""Ratio of the half width of a 90 % interval to the standard error."""


@dataclass(frozen=True)
class Course:
    """Values of one identified parameter in the runs that determine it, in the order of the runs.

    Attributes:
        name: Name of the constant.
        runs: Index of the run of each value, in the history.
        constants: The values with their intervals.
        change: The step or drift that fits best; None with too few runs.
        p_value: p-value of the change, for all constants of the history together; None without a
            test.
        with_devices: Devices that were replaced at the step.
    """

    name: str
    runs: tuple[int, ...]
    constants: tuple[Constant, ...]
    change: Change | None
    p_value: float | None
    with_devices: tuple[str, ...] = ()

    @property
    def alarm(self) -> bool:
        """Whether the change is reported."""
        return self.p_value is not None and self.p_value <= FALSE_ALARMS


@dataclass(frozen=True)
class History:
    """The runs of one bench in order of time.

    Attributes:
        bench: Name of the bench.
        simulated: Whether the bench is simulated.
        method: Method of the identifications.
        runs: Folders, in the order of time.
        begun: When each run began.
        courses: Every constant over these runs.
        left_out: Messages on the runs that are left out.
    """

    bench: str
    simulated: bool | None
    method: str
    runs: tuple[str, ...]
    begun: tuple[str, ...]
    courses: tuple[Course, ...]
    left_out: tuple[str, ...] = ()


def histories(
    root: Path, entries: Sequence[Entry], seed: int = 0, only: str | None = None
) -> list[History]:
    """Return the histories of the benches of some runs. Runs without identified parameters are left
    out, and a run and its copies count once.

    Args:
        root: The searched folder.
        entries: The runs, the earliest first.
        seed: Seed of the simulated distribution of the test.
        only: Name of the constant to which histories are restricted, or None for all constants.
            The p-value of this constant also accounts for the tests of all other constants.
    """
    copies = {id(e): each[0] for each in copies_of(entries).values() for e in each[1:]}
    groups: dict[tuple[str, bool | None, str, str], list[tuple[Entry, Details]]] = {}
    left_out: dict[tuple[str, bool | None], list[str]] = {}
    for entry in entries:
        head = entry.head
        if head.kind != "run":
            continue
        if id(entry) in copies:
            words = f"{place(root, entry)}: a copy of {place(root, copies[id(entry)])}"
            left_out.setdefault((head.bench, head.simulated), []).append(words)
        elif not head.identified:
            words = f"{place(root, entry)}: not identified"
            left_out.setdefault((head.bench, head.simulated), []).append(words)
        else:
            details = entry.parsed()
            key = (head.bench, head.simulated, head.identified, details.motion)
            groups.setdefault(key, []).append((entry, details))
    made = (
        _history(root, key[:3], runs, tuple(left_out.get(key[:2], ())), seed, only)
        for key, runs in groups.items()
    )
    return [each for each in made if each.courses or only is None]


def _history(
    root: Path,
    key: tuple[str, bool | None, str],
    runs: Sequence[tuple[Entry, Details]],
    left_out: tuple[str, ...],
    seed: int,
    only: str | None,
) -> History:
    details = [each for _, each in runs]
    return History(
        *key,
        tuple(place(root, entry) for entry, _ in runs),
        tuple(entry.head.created for entry, _ in runs),
        tuple(courses(details, seed, only)),
        left_out,
    )


def courses(history: Sequence[Details], seed: int = 0, only: str | None = None) -> Iterator[Course]:
    """Yield the values of every parameter over a history, with a test for a change; the false-alarm
    rate is that of all parameters together.

    Args:
        history: Details of the runs in the order of time.
        seed: Seed of the simulated distribution of the test.
        only: Name of the constant to yield, or None for all; the false-alarm rate is that of all
            constants in either case.
    """
    found = {name: _determined(name, history) for each in history for name in each.constants}
    tested = sum(len(runs) >= LEAST_RUNS for runs, _ in found.values())
    known: dict[bytes, ChangeTest] = {}
    for name, (runs, constants) in found.items():
        if only is not None and name != only:
            continue
        if len(runs) < LEAST_RUNS:
            yield Course(name, runs, constants, None, None)
            continue
        values = np.array([each.value for each in constants], dtype=np.float64)
        halves = np.array([each.half_width for each in constants], dtype=np.float64)
        scale = float(np.median(halves)) / _HALF_WIDTHS
        found_change = _test(halves / np.median(halves), seed, known)(values / scale)
        change = dataclasses.replace(
            found_change,
            size=scale * found_change.size,
            half_width=scale * found_change.half_width,
        )
        p_value = min(1.0, tested * change.p_value)
        yield Course(name, runs, constants, change, p_value, _devices(history, runs, change.start))


def _test(relative: Array, seed: int, known: dict[bytes, ChangeTest]) -> ChangeTest:
    """Return the test for errors relative to their median; parameters with equal relative errors
    share one test.
    """
    key = np.round(relative, 6).tobytes()
    if key not in known:
        known[key] = ChangeTest(relative, np.random.default_rng(seed))
    return known[key]


def _determined(
    name: str, history: Sequence[Details]
) -> tuple[tuple[int, ...], tuple[Constant, ...]]:
    """Return the runs that determine a parameter with an interval of positive width."""
    first = next(each.constants[name].unit for each in history if name in each.constants)
    kept = [
        (index, each.constants[name])
        for index, each in enumerate(history)
        if name in each.constants and each.constants[name].unit == first
    ]
    kept = [(index, each) for index, each in kept if each.half_width]
    return tuple(index for index, _ in kept), tuple(each for _, each in kept)


def _devices(history: Sequence[Details], runs: Sequence[int], start: int | None) -> tuple[str, ...]:
    """Return the devices that were replaced at a step."""
    if start is None:
        return ()
    before, after = history[runs[start - 1]].devices, history[runs[start]].devices
    return tuple(
        f"{role}: {before.get(role, 'none')}, then {after.get(role, 'none')}"
        for role in {**before, **after}
        if before.get(role) != after.get(role)
    )


def alarms(history: History) -> Mapping[str, int | None]:
    """Return the parameters that changed, with the first run after the step, or None for a
    drift.
    """
    return {each.name: each.change.start for each in history.courses if each.alarm and each.change}
