"""A part of `make makes`: a fault under power and one before it, and faults of a homing, on the
simulated drives of the makes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.mock.makes import MAKES

from ..long import fault_matrix, makes
from ..long.fault_cases_homing import CASES, HOST
from ..long.fault_cases_homing import run as home
from ..long.fault_cases_makes import cases

FAULTS = ("cable pulled", "drive fault", "drive restarts", "control loop hangs 0.5 s", "EMCY")
"""One for each make in turn."""
HOMINGS = {
    "Elmo": ("cable lost", "drive restarts", "the limit switch never closes", "encoder frozen"),
    "Trinamic": ("cable lost", "drive fault", "it never ends"),
    "Trinamic:serial": ("cable lost", "drive fault"),
}


@pytest.mark.parametrize("number", range(len(MAKES)))
def test_a_fault_leaves_the_drive_of_a_make_as_it_must(number: int, tmp_path: Path) -> None:
    make = list(MAKES)[number]
    bench = str(makes.write_bench(tmp_path / make, make))
    fault = FAULTS[number % len(FAULTS)]
    for phase in ("prompt", "excite"):
        case = cases(make)[fault]
        assert fault_matrix.run_case(case, phase, bench, tmp_path / phase).problems == ()


@pytest.mark.parametrize(
    ("label", "fault"), [(label, fault) for label, faults in HOMINGS.items() for fault in faults]
)
def test_a_fault_in_a_homing_ends_it_de_energised(label: str, fault: str, tmp_path: Path) -> None:
    bench = makes.homing_bench(tmp_path / "bench", label)
    case = CASES[fault]
    assert home(case, case.methods[-1], bench, tmp_path / "run") == []


def test_ctrl_c_ends_a_homing(tmp_path: Path) -> None:
    act, case = HOST["Ctrl-C"]
    assert (
        home(case, 17, makes.homing_bench(tmp_path / "bench", "Copley"), tmp_path / "run", act)
        == []
    )
