"""Benches whose drive takes speeds, torques or set-points, and faults of makes' drives."""

import json
from pathlib import Path

import pytest

from drivers.mock.traits import MAKES
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.planning.feedforward import require_torque_offset

from ..long import fault_matrix, makes
from ..long.fault_cases_homing import CASES, HOST
from ..long.fault_cases_homing import run as home
from ..long.fault_cases_makes import MODES, cases

pytestmark = pytest.mark.usefixtures("unpaged")


@pytest.mark.parametrize(
    ("name", "fault", "phase"),
    [
        *(
            (mode, fault, phase)
            for mode in MODES
            for fault, phase in (
                ("one frame lost", "excite"),
                ("cable pulled", "excite"),
                ("the drive's frames lost, 40 of them", "approach"),
                ("Ctrl-C", "excite"),
                ("mode refused", "enable"),
            )
        ),
        ("Trinamic", "cable pulled", "excite"),
        ("Trinamic", "drive fault", "excite"),
        ("EPOS4", "EMCY", "excite"),
        ("EPOS2", "Ctrl-C", "excite"),
        ("Copley", "drive restarts", "approach"),
    ],
)
def test_a_fault_ends_as_it_must(name: str, fault: str, phase: str, tmp_path: Path) -> None:
    bench = makes.write_bench(tmp_path / "bench", name)
    cell = fault_matrix.run_case(cases(name)[fault], phase, str(bench), tmp_path / "run")
    assert cell.problems == ()


def bench(packaged: str, keys: str) -> str:
    text = resolve(packaged, "benches").read_text()
    Path("bench.yaml").write_text(text.replace("servo: {", f"servo: {{{keys}", 1))
    return "bench.yaml"


@pytest.fixture
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("packaged", "keys", "words"),
    [
        ("practical", "mode: cst, ", "mode cst needs position_loop.inertia_kg_m2"),
        (
            "practical",
            "mode: cst, position_loop: {inertia_kg_m2: 0.2}, ",
            "drive_limits_speed: true",
        ),
        ("practical_serial", "mode: csv, ", "servo.mode csv needs a CAN bus"),
    ],
)
@pytest.mark.usefixtures("_here")
def test_a_mode_that_is_not_safe_is_refused(packaged: str, keys: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_bench(bench(packaged, keys))


@pytest.mark.usefixtures("_here")
def test_a_drive_that_does_not_notice_a_silent_program_takes_no_speeds() -> None:
    path = makes.write_bench(Path("t"), "Trinamic")
    text = path.read_text()
    path.write_text(text.replace("servo: {", "servo: {mode: csv, ", 1))
    assert status(["check", str(path)]) == 2
    path.write_text(text.replace("servo: {", "servo: {mode: csv, stops_alone: true, ", 1))
    assert status(["check", str(path), "--json", "check.json"]) == 0
    held = json.loads(Path("check.json").read_text())
    assert {"angle_min_rad", "angle_max_rad", "following_error_rad"} <= set(held["not_held"])


@pytest.mark.parametrize("keys", ["mode: csv, ", "mode: pp, "])
@pytest.mark.usefixtures("_here")
def test_feed_forward_needs_positions_in_every_cycle(keys: str) -> None:
    with pytest.raises(InputError, match=r"servo.mode: feed-forward needs servo.mode csp"):
        require_torque_offset(load_bench(bench("practical", keys)))


FAULTS = ("cable pulled", "drive fault", "drive restarts", "control loop hangs 0.5 s", "EMCY")
"""One for each make in turn."""
HOMINGS = {
    "Elmo": ("cable lost", "drive restarts", "the limit switch never closes", "encoder frozen"),
    "Trinamic": ("cable lost", "it never ends"),
    "Trinamic:serial": ("drive fault",),
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
