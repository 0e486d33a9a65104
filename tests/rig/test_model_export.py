"""The exported model: a file that stands alone and computes what this program computes."""

import dataclasses
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

from identification.effects import EFFECTS, MOTION
from identification.effects.model import CorrectedModel, Curve, carried
from identification.export.python import python_text
from identification.recording import Array, Bench, Recording
from identification.views.view import views
from rig.results.diagnose.exports import yaml_text

PARAMETERS = {
    "J": 0.2, "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3, "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.033, "mu_2": 0.032,
}  # fmt: skip
BENCH = Bench(
    torque_constant=0.03,
    back_emf_constant=0.026,
    resistance=1.56,
    inductance=1e-3,
    gear_ratio=100.0,
    moment_arm=0.095,
)
TIME = np.arange(2000) / 500.0
ANGLE = 0.3 * np.sin(2.0 * TIME)
VELOCITY = np.where(np.abs(np.cos(2.0 * TIME)) < 0.1, 0.0, 0.6 * np.cos(2.0 * TIME))
ACCELERATION = np.gradient(VELOCITY, TIME)
CURRENT = 4.0 * np.sign(VELOCITY) + VELOCITY
RECORDING = Recording(TIME, ANGLE, CURRENT, name="r", bench=BENCH, weight_mass=30.6)


def middle(name: str) -> dict[str, float]:
    given = {q.name: q.low + 0.3 * (q.high - q.low) for q in EFFECTS[name].parameters}
    special = {
        "wrong_weight": {"recording": 2.0},
        "encoder_slip": {"recording": 2.0, "at_s": 1.0},
        "end_stop": {"angle_rad": -0.2},
    }
    return given | special.get(name, {})


def imported(text: str, tmp_path: Path) -> ModuleType:
    path = tmp_path / "model.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("exported", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", [None, *(e.name for e in MOTION)])
def test_the_file_computes_what_the_program_does(name: str | None, tmp_path: Path) -> None:
    effects = {} if name is None else {name: middle(name)}
    model = CorrectedModel(PARAMETERS, 2.0, effects)
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    assert model.numbers(RECORDING) == module.M
    s = module.signals(
        module.M, TIME, ANGLE, VELOCITY, ACCELERATION, contact_force=2000.0, weight_mass=20.4,
        current=CURRENT,
        voltage=1.6 * CURRENT, supply=60.0, known=1.2, run_start=100.0, number=2,
    )  # fmt: skip
    for theirs, ours in (
        (module.torque, model.torque), (module.drive, model.drive), (module.twist, model.twist),
        (module.voltage, model.voltage),
    ):  # fmt: skip
        assert theirs(s) == pytest.approx(ours(s), rel=1e-12, abs=1e-12)
    plain = CorrectedModel(PARAMETERS, 2.0)
    moved = [
        np.max(np.abs(f(s) - g(s)))
        for f, g in (
            (module.torque, plain.torque), (module.drive, plain.drive), (module.twist, plain.twist),
            (module.voltage, plain.voltage),
        )
    ]  # fmt: skip
    assert bool(max(moved) > 0.0) is (name is not None)


def test_recordings_before_heat_the_winding(tmp_path: Path) -> None:
    """As in one recording with the pause in it."""
    model = CorrectedModel(PARAMETERS, 2.0, {"winding_heating": middle("winding_heating")})
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)

    def seen(time: Array, current: Array, **more: Any) -> Any:
        still = np.zeros(len(time))
        return module.signals(
            module.M, time, still, still, still, current=current, voltage=1.6 * current, **more
        )

    step = TIME[1] - TIME[0]
    whole = np.arange(3 * len(TIME)) * step
    power = np.concatenate([CURRENT, 0.0 * CURRENT, CURRENT])
    first = seen(TIME, CURRENT)
    second = seen(TIME, CURRENT, run_start=2 * len(TIME) * step, before=first)
    # At the first sample the rate of the current is another one.
    expected = model.voltage(seen(whole, power))[-len(TIME) + 1 :]
    for computed in (module.voltage, model.voltage):
        assert computed(second)[1:] == pytest.approx(expected, rel=1e-4)
        assert computed(second) != pytest.approx(computed(first), rel=1e-3)


def test_a_winding_has_no_heat_left_after_a_long_pause(tmp_path: Path) -> None:
    model = CorrectedModel(PARAMETERS, 2.0, {"winding_heating": middle("winding_heating")})
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)

    def seen(**more: Any) -> Any:
        still = np.zeros(len(TIME))
        return module.signals(
            module.M, TIME, still, still, still, current=CURRENT, voltage=1.6 * CURRENT, **more
        )

    first = seen()
    for factor, alike in ((1.0, False), (30.0, True)):
        late = factor * model.effects["winding_heating"]["time_s"]
        second = seen(run_start=TIME[-1] + late, before=first)
        for computed in (module.voltage, model.voltage):
            same = computed(second) == pytest.approx(computed(first), rel=1e-5)
            assert same is alike


def test_effects_at_an_angle_are_as_late_as_the_torque(tmp_path: Path) -> None:
    late, step = 0.012, TIME[1] - TIME[0]
    effects = {name: middle(name) for name in ("cogging", "end_stop", "gravity_imbalance")}
    model = CorrectedModel(PARAMETERS, 2.0, {**effects, "time_skew": {"time_s": late}})
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    still = dataclasses.replace(model, effects={**effects, "time_skew": {"time_s": 0.0}})
    assert module.M["late_s"] == late
    assert model.numbers(RECORDING) == module.M
    (seen,) = views([RECORDING], 20.0)
    s = module.signals(
        module.M, seen.time, seen.angle, seen.velocity, seen.acceleration, current=seen.current,
        known=seen.known, contact_force=RECORDING.contact_force, weight_mass=30.6,
    )  # fmt: skip
    for name in ("sense", "still", "rest_time", "moment", "torque", "transmitted", "motor"):
        setattr(s, name, getattr(seen, name))
    inner = slice(20, -20)
    for theirs, ours in ((module.torque, model.torque), (module.drive, model.drive)):
        assert theirs(s)[inner] == pytest.approx(ours(seen)[inner], abs=1e-6)
        assert np.max(np.abs(theirs(s) - getattr(still, theirs.__name__)(seen))[inner]) > 0.1
    moved = s.delayed(late)
    shift = round(late / step)
    assert moved.angle[shift:] == pytest.approx(s.angle[:-shift], abs=1e-9)
    assert moved.drive_angle == pytest.approx(moved.motor / 100.0, abs=1e-9)


def test_the_file_needs_numpy_alone(tmp_path: Path) -> None:
    text = python_text(
        CorrectedModel(PARAMETERS, 2.0, {"presliding": middle("presliding")}), RECORDING, "bench"
    )
    (tmp_path / "model.py").write_text(text)
    code = "import model; assert model.M['Mc'] == 6.8; assert 'presliding' in model.__doc__"
    subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {code}"],
        check=True,
    )


def test_a_gap_in_the_times_is_refused(tmp_path: Path) -> None:
    module = imported(python_text(CorrectedModel(PARAMETERS), RECORDING, "bench"), tmp_path)
    kept = np.r_[0:900, 903:2000]
    with pytest.raises(ValueError, match="evenly spaced"):
        module.signals(module.M, TIME[kept], ANGLE[kept], VELOCITY[kept], ACCELERATION[kept])


def test_a_curve_against_the_motion_changes_its_sign_with_it(tmp_path: Path) -> None:
    grid = np.linspace(-0.3, 0.3, 9)
    curve = Curve("torque", "angle", "rad", "N m", grid, 1.0 + grid, against_motion=True)
    model = CorrectedModel(PARAMETERS, 2.0, {}, curve)
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    s = module.signals(module.M, TIME, ANGLE, VELOCITY, ACCELERATION)
    added = module.torque(s) - dataclasses.replace(model, curve=None).torque(s)
    # At rest the curve keeps the sign of friction.
    assert np.count_nonzero(VELOCITY == 0.0) > 100
    assert added == pytest.approx(s["sense"] * np.interp(ANGLE, grid, 1.0 + grid))
    assert np.abs(added).min() > 0.5
    assert added == pytest.approx(carried(curve, "torque", s))
    assert yaml.safe_load(yaml_text(model, RECORDING))["curve"]["against_motion"] is True
