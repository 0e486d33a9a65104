"""A model carried over to other recordings, as text, record and table."""

from __future__ import annotations

from typing import Any

from identification.estimate.transfer import Moved, Transfer
from rig.common.parameter_table import Table
from rig.common.result_files import fit_record, parameter_record
from rig.common.tables import number, percent


def transfer_table(found: Transfer) -> Table:
    """Return one row per parameter: on both, the difference, and whether it is more than the joint
    interval.
    """
    rows = tuple(
        (
            m.name,
            number(m.first.value),
            number(m.second.value),
            number(m.difference, 3),
            "-" if m.joint is None else f"+- {number(m.joint, 3)}",
            m.unit,
            {None: "not identifiable on both", False: "no", True: "yes"}[m.moved],
        )
        for m in found.parameters
    )
    return Table(
        ("parameter", "here", "there", "difference", "90 %", "unit", "moved"), rows, (1, 2, 3, 4)
    )


def transfer_notes(found: Transfer) -> list[str]:
    """Return the errors in words."""
    fit, own = found.fit, found.own
    line = (
        f"carried over, the model errs by {number(fit.train_rms, 3)} {fit.unit} rms "
        f"({percent(100.0 * fit.train_relative)}) at {number(fit.bandwidth_Hz, 3)} Hz; identified "
        f"there it would by "
        f"{number(own.train_rms, 3)} {own.unit}"
    )
    floor = found.floor
    if floor is None:
        return [
            line,
            "the noise floor there is unknown: nothing is done twice under the same command",
        ]
    ways = [
        f"{count} {what}"
        for count, what in ((floor.periods, "periodic"), (floor.repeats, "repeated"))
        if count
    ]
    return [
        line,
        f"the noise floor there is {number(floor.rms, 3)} {fit.unit}, from {floor.samples} pairs "
        f"of samples of "
        f"{' and '.join(ways)} recordings: the error is {number(fit.train_rms / floor.rms, 3)} "
        f"times that",
    ]


def transfer_record(found: Transfer, source: str) -> dict[str, Any]:
    """Return the record under ``transfer`` of ``rig identify --json``."""
    floor = found.floor
    return {
        "source": source,
        "fit": fit_record(found.fit),
        "own": fit_record(found.own),
        "noise_floor_rms": None if floor is None else floor.rms,
        "noise_floor_samples": 0 if floor is None else floor.samples,
        "fit_by_recording": {name: fit_record(fit) for name, fit in found.by_recording.items()},
        "parameters": {m.name: _moved_record(m) for m in found.parameters},
    }


def _moved_record(m: Moved) -> dict[str, Any]:
    return {
        "here": parameter_record(m.first),
        "there": parameter_record(m.second),
        "difference": m.difference,
        "joint": m.joint,
        "moved": m.moved,
    }
