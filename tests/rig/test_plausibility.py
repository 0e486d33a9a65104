"""Machine constants that no bench has are refused, and those that few have are warned of."""

from pathlib import Path

import pytest

from rig.cli.entry import status
from rig.common.errors import Cause
from rig.config.bench import load_bench
from rig.config.configuration import names
from rig.wiring.preflight import CONSTANTS, implausible

from .benches import variant

PRINTED = {
    "torque_constant_N_m_A": "0.03",
    "back_emf_constant_V_s_rad": "0.02588",
    "resistance_ohm": "1.56",
    "inductance_H": "0.00132",
    "gear_ratio": "100",
    "moment_arm_m": "0.095",
    "lever_ratio": "10",
    "gravity_m_s2": "9.80665",
}


def judged(path: Path, key: str, value: float) -> list[bool]:
    text = path.read_text()
    old = f"  {key}: {PRINTED[key]}\n"
    assert old in text
    head, tail = text.split(old, 1)
    path.write_text(f"{head}  {key}: {value!r}\n{tail}")
    found = implausible(load_bench(path))
    assert all(finding.cause is Cause.CONSTANTS and finding.connectable for finding in found)
    return [finding.refused for finding in found if f"machine.{key}: {value:g}" in finding.text]


@pytest.mark.parametrize("name", names("benches"))
def test_the_packaged_benches_are_plausible(name: str) -> None:
    assert implausible(load_bench(name)) == []


@pytest.mark.parametrize("key", sorted(PRINTED))
@pytest.mark.parametrize("end", ["low", "high"])
def test_both_sides_of_each_range(tmp_path: Path, key: str, end: str) -> None:
    bounds, side = CONSTANTS[key], end == "high"
    outward, inward = (1.001, 0.999) if side else (0.999, 1.001)
    usual, possible = bounds.usual[side], bounds.possible[side]
    assert judged(variant(tmp_path), key, usual * inward) == []
    assert judged(variant(tmp_path), key, usual * outward) == [False]
    if possible == 0.0:
        return
    assert judged(variant(tmp_path), key, possible * inward) == [False]
    assert judged(variant(tmp_path), key, possible * outward) == [True]


@pytest.mark.parametrize(
    ("ratio", "expected"), [(0.39, [False]), (0.19, [True]), (2.4, []), (2.6, [False])]
)
def test_torque_constant_and_back_emf_belong_together(tmp_path, ratio, expected):
    path = variant(
        tmp_path,
        (
            "back_emf_constant_V_s_rad: 0.02588\n  resistance_ohm: 1.56\n  inductance_H: "
            "0.00132\n  "
            "gear_ratio: 100\n  moment_arm_m",
            f"back_emf_constant_V_s_rad: {0.03 * ratio!r}\n  resistance_ohm: 1.56\n  "
            "inductance_H: 0.00132\n  gear_ratio: 100\n  moment_arm_m",
        ),
    )
    found = implausible(load_bench(path))
    assert [finding.refused for finding in found] == expected
    assert all("its ratio to torque_constant_N_m_A" in finding.text for finding in found)


@pytest.mark.parametrize(
    ("speed", "expected"), [(1199.0, []), (1201.0, [False]), (12001.0, [True])]
)
def test_a_speed_limit_is_judged_at_the_motor(tmp_path, speed, expected):
    found = implausible(
        load_bench(variant(tmp_path, ("speed_deg_s: 120", f"speed_deg_s: {speed}")))
    )
    assert [finding.refused for finding in found] == expected


@pytest.mark.parametrize(("torque", "expected"), [(1.12, []), (1.13, [False]), (9.01, [True])])
def test_rated_torque_goes_with_rated_current(tmp_path, torque, expected):
    found = implausible(
        load_bench(variant(tmp_path, ("rated_torque_N_m: 0.45", f"rated_torque_N_m: {torque}")))
    )
    assert [finding.refused for finding in found] == expected


def test_a_moment_arm_in_millimetres_is_refused_before_anything_moves(elsewhere, capsys):
    rest = "\n  lever_ratio: 10\n  gravity_m_s2: 9.80665\nbus"
    path = variant(elsewhere, (f"moment_arm_m: 0.095{rest}", f"moment_arm_m: 95{rest}"))
    for command, code in ((["run", "figure10", "--yes", "--bench"], 2), (["check"], 1)):
        assert status([*command, str(path)]) == code
        said = capsys.readouterr()
        words = f"{path}:10:17: machine.moment_arm_m: 95 m is outside 0.001 to 5 m"
        assert words in said.out + said.err
    assert not Path("runs").exists()
