"""Units, signs, ratio and torque constant from the samples of a motion."""

import math
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.interfaces import Lacks
from rig.control.cycle import Cycle
from rig.control.motion_proof import (
    STEP_RAD,
    STEPS,
    Change,
    Motion,
    SpeedWitness,
    hint,
    prove,
    surer,
)
from rig.control.readings import at_rest
from rig.control.session import Ending
from rig.wiring.devices import Nominal

from .test_safety import LIMITS

GEAR, KM, RESISTANCE = 50.0, 0.04, 0.8
NOMINAL = Nominal(KM, GEAR)


class Remedies:
    def __init__(self, count: float = 0.0) -> None:
        self.count = count

    def speed_remedy(self, factor: float) -> str:
        return f"unit {factor:.3g}"

    def speed_settings(self, factor: float) -> Any:
        return (("velocity_unit", "rpm"),)

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        return 100.0 if 100.0 / spread <= factor <= 100.0 * spread else factor

    def limit_steps(self) -> Any:
        return type("Steps", (), {"angle_rad": self.count})


def motion(rng: np.random.Generator | None = None, **changes: Any) -> Motion:
    """Return a sine of 1.5 deg with friction, sampled at 1 kHz."""
    rng = rng or np.random.default_rng(1)
    time = np.arange(4000) * 1e-3
    motor = math.radians(1.5) * np.sin(math.pi * time)
    speed = np.gradient(motor, time)
    current = 0.5 * np.sign(speed) + 2.0 * speed + 0.02 * rng.standard_normal(len(time))
    values: dict[str, Any] = {
        "time": time,
        "motor": motor,
        "joint": motor.copy(),
        "velocity": speed,
        "current": current,
        "voltage": RESISTANCE * current + KM * GEAR * speed,
        "torque": KM * current,
    }
    for name, change in changes.items():
        values[name] = change(values[name]) if callable(change) else change
    return Motion(**values)


def proven(seen: Motion, nominal: Nominal = NOMINAL) -> Any:
    return prove(seen, nominal, Remedies())  # type: ignore[arg-type]


def nothing(values: Any) -> Any:
    return values * math.nan


def test_a_right_motion_shows_everything_and_contradicts_nothing() -> None:
    proof = proven(motion())
    assert all(found == pytest.approx(1.0, abs=0.03) for found in proof.found.values())
    assert proof.contradictions == ()
    assert proof.moved
    assert proof.unproven == ""


@pytest.mark.parametrize(("factor", "wrong"), [(0.3, 0), (3.7, 0), (0.2, 1), (5.0, 1), (-1.0, 1)])
def test_speed_against_position(factor: float, wrong: int) -> None:
    proof = proven(motion(velocity=lambda v: factor * v))
    assert len(proof.contradictions) == wrong
    assert proof.found["speed against position"] == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize(
    ("factor", "changes"),
    [
        (0.92, None),
        (1.08, None),
        (-1.0, (Change("encoder", "sign", -1),)),
        (1.25, (Change("machine", "gear_ratio", 40.0),)),
        (-2.0, (Change("encoder", "sign", -1), Change("machine", "gear_ratio", 25.0))),
        (GEAR, ()),
        (0.0, ()),
    ],
)
def test_joint_against_motor_encoder(factor: float, changes: Any) -> None:
    proof = proven(motion(joint=lambda j: factor * j))
    assert proof.found["joint encoder against motor encoder"] == pytest.approx(
        factor, rel=1e-3, abs=1e-9
    )
    assert (proof.contradictions[0].changes if proof.contradictions else None) == changes
    if factor == 0.0:
        assert "the joint encoder stands still" in proof.words
    elif changes == ():
        assert "both are on the same side of the gear" in proof.words


def test_play_twist_and_time_between_readings_are_no_ratio() -> None:
    def behind(joint: Any) -> Any:
        turned = np.sign(np.gradient(joint))
        return np.roll(joint, 3) - 0.003 * turned

    assert proven(motion(joint=behind)).contradictions == ()


@pytest.mark.parametrize(("share", "wrong"), [(-1.0, True), (1.0, False)])
def test_sign_of_the_current(share: float, wrong: bool) -> None:
    proof = proven(motion(current=lambda i: share * i, torque=nothing, voltage=nothing))
    assert [c.changes for c in proof.contradictions] == (
        [(Change("servo", "current_sign", -1),)] if wrong else []
    )


@pytest.mark.parametrize("stated", [2.0, 1.6, 1.4])
@pytest.mark.parametrize("source", ["torque", "voltage", "rated"])
def test_torque_constant(stated: float, source: str) -> None:
    gone = {name: nothing for name in ("torque", "voltage") if name != source}
    rated = (10.0, 10.0 * KM) if source == "rated" else (None, None)
    (proof) = proven(motion(**gone), Nominal(stated * KM, GEAR, *rated))
    within = 1 / 1.5 <= 1 / stated <= 1.5
    assert len(proof.contradictions) == (0 if within else 1)
    if not within:
        (change,) = proof.contradictions[0].changes
        assert (change.section, change.key) == ("machine", "torque_constant_N_m_A")
        assert change.value == pytest.approx(KM, rel=0.1)


@pytest.mark.parametrize(("share", "wrong"), [(0.577, 0), (0.5, 1)])
def test_a_back_emf_constant_as_stated_may_be_that_of_alternating_current(share, wrong):
    nominal = Nominal(KM / share, GEAR, back_emf_constant_V_s_rad=KM)
    assert len(proven(motion(torque=nothing), nominal).contradictions) == wrong
    other = Nominal(KM / share, GEAR, back_emf_constant_V_s_rad=KM / share)
    assert len(proven(motion(torque=nothing), other).contradictions) == 1


def test_an_uncertain_voltage_on_the_side_of_the_file_outweighs_the_rated_values() -> None:
    rng = np.random.default_rng(2)
    noisy = motion(torque=nothing, voltage=lambda u: u + 1.0 * rng.standard_normal(len(u)))
    rated = Nominal(KM, GEAR, 10.0, 5.0 * KM)
    assert proven(noisy, rated).contradictions == ()
    assert len(proven(motion(torque=nothing, voltage=nothing), rated).contradictions) == 1


def test_a_joint_that_hardly_moves_shows_nothing() -> None:
    small = motion(motor=lambda m: 0.01 * m, joint=lambda j: -0.01 * j)
    assert not proven(small).moved
    assert proven(small).contradictions == ()


def early(moved: Any, joint: Any, velocity: Any) -> Motion:
    n = len(moved)
    blank = np.full(n, math.nan)
    time = np.arange(n) * 1e-3
    arrays = (np.asarray(x, dtype=float) for x in (moved, joint, velocity))
    return Motion(time, *arrays, np.ones(n), blank, blank)


@pytest.mark.parametrize("factor", [-1.0, 3.0, 0.3, GEAR])
def test_a_trip_is_explained_by_encoders_in_proportion(factor: float) -> None:
    moved = np.linspace(0.0, 1.0, 30) ** 2 * 1e-3
    found = hint(early(moved, factor * moved, np.gradient(moved, 1e-3)), NOMINAL, Remedies())  # type: ignore[arg-type]
    assert found.factor == pytest.approx(factor, rel=0.02)


def test_an_encoder_that_stands_still_explains_a_trip() -> None:
    moved = np.linspace(0.0, 1.0, 30) ** 2 * 5e-3
    found = hint(early(moved, 0.0 * moved, np.gradient(moved, 1e-3)), NOMINAL, Remedies())  # type: ignore[arg-type]
    assert "the joint encoder stands still" in found.words


@pytest.mark.parametrize("shown", [0, 1, 2])
@pytest.mark.parametrize("counts", [5, 40])
def test_a_joint_encoder_with_few_steps_in_the_travel_explains_no_trip(shown, counts):
    count = 1e-5
    moved = np.concatenate((np.zeros(150), count * np.arange(1.0, counts + 1)))
    joint = np.floor(np.linspace(0.0, shown, len(moved))) * 4e-4
    right = early(moved, joint, np.gradient(moved, 1e-3))
    assert hint(right, NOMINAL, Remedies()) is None  # type: ignore[arg-type]
    found = hint(early(moved, joint, 60.0 * np.gradient(moved, 1e-3)), NOMINAL, Remedies())  # type: ignore[arg-type]
    assert found.what == "speed against position"
    assert ("few counts" in found.words) == (counts == 5)


@pytest.mark.parametrize(("share", "wrong"), [(2.0, True), (1.2, False)])
def test_a_torque_that_tripped_is_explained_by_its_constant(share: float, wrong: bool) -> None:
    moved = np.linspace(0.0, 1.0, 30) ** 2 * 1e-3
    few = early(moved, moved, np.gradient(moved, 1e-3))
    nominal = Nominal(share * KM, GEAR, 10.0, 10.0 * KM)
    drive: Any = Remedies()
    assert hint(few, nominal, drive) is None
    found = hint(few, nominal, drive, too_strong=True)
    assert (found is not None) is wrong
    if found is not None:
        assert found.changes == (Change("machine", "torque_constant_N_m_A", KM),)


def test_the_peak_of_a_slip_back_is_no_wrong_sign() -> None:
    moved = -1e-4 * np.repeat(np.arange(6.0), 5)
    velocity = np.where(np.arange(30) == 29, 8.0, 0.0)
    found = hint(early(moved, moved, velocity), NOMINAL, Remedies(count=1e-4), too_fast=True)  # type: ignore[arg-type]
    assert found.factor == pytest.approx(100.0)


def test_a_ratio_is_not_taken_from_the_rest_before_the_motion() -> None:
    rest = np.zeros(200)
    moved = np.concatenate((rest, 1e-5 * np.arange(1.0, 7.0)))
    joint = np.concatenate((rest, 1e-5 * np.array([0.5, 3.0, 1.0, 5.0, 2.0, 4.0])))
    found = hint(early(moved, joint, 1000.0 * np.gradient(moved, 1e-3)), NOMINAL, Remedies())  # type: ignore[arg-type]
    assert found.what == "speed against position"


def test_a_jump_explains_nothing() -> None:
    moved = np.linspace(0.0, 1.0, 30) ** 2 * 1e-3
    jumped = moved + np.where(np.arange(30) > 28, 0.09, 0.0)
    assert hint(early(moved, jumped, np.gradient(moved, 1e-3)), NOMINAL, Remedies()) is None  # type: ignore[arg-type]
    still = np.zeros(30)
    still[-1] = 2e-5
    assert hint(early(still, jumped - moved, still), NOMINAL, Remedies()) is None  # type: ignore[arg-type]


def test_two_counts_of_the_motor_and_a_turning_joint_are_one_shaft() -> None:
    count = 1e-4
    moved = count * np.repeat([0.0, 1.0, 2.0], 10)
    joint = GEAR * np.linspace(0.0, 2.4 * count, 30)
    found = hint(early(moved, joint, np.zeros(30)), NOMINAL, Remedies())  # type: ignore[arg-type]
    assert "on the same side of the gear" in found.words


@pytest.mark.parametrize(("speed", "found"), [(0.35, None), (0.5, 5.0), (8.0, 100.0)])
def test_the_speed_of_one_sample_against_one_count(speed: float, found: float | None) -> None:
    still = np.zeros(10)
    velocity = np.where(np.arange(10) == 9, speed, 0.0)
    drive: Any = Remedies(count=1e-4)
    assert hint(early(still, still, velocity), NOMINAL, drive) is None
    explained = hint(early(still, still, velocity), NOMINAL, drive, too_fast=True)
    assert (None if explained is None else explained.factor) == (
        None if found is None else pytest.approx(found)
    )


def test_the_motion_until_standstill_makes_a_rough_factor_surer() -> None:
    moved = np.linspace(0.0, 1e-3, 60)
    peak = early(moved[:8], moved[:8], 90.0 * np.gradient(moved, 1e-3)[:8])
    rough = hint(peak, NOMINAL, Remedies())  # type: ignore[arg-type]
    assert rough.rough
    whole = early(moved, moved, 10.0 * np.gradient(moved, 1e-3))
    found = surer(rough, whole, Remedies())  # type: ignore[arg-type]
    assert not found.rough
    assert found.factor == pytest.approx(10.0, rel=0.02)
    still = early(moved, moved, np.gradient(moved, 1e-3))
    assert surer(rough, still, Remedies()) is rough  # type: ignore[arg-type]


def test_a_rough_factor_names_a_power_of_ten_that_is_nearer_than_the_common_unit() -> None:
    class Drive(Remedies):
        def nearest_speed_factor(self, factor: float, spread: float) -> float:
            return 68.0 if 68.0 / spread <= factor <= 68.0 * spread else 10.0

    moved = np.linspace(0.0, 1e-4, 8)
    for factor, words in ((12.0, "unit 68; or the factor is 10: unit 10"), (60.0, "unit 68; few")):
        few = early(moved, moved, factor * np.gradient(moved, 1e-3))
        found = hint(few, NOMINAL, Drive())  # type: ignore[arg-type]
        assert words in found.words


JOINT_GEAR = LIMITS.gear_ratio


class Named:
    def speed_remedy(self, factor: float) -> str:
        return f"factor {factor:.4f}"


def witnessed(
    factor: float, speed: float = 0.2, cycles: int = 1000, start_s: float = 0.0, **changes: Any
) -> int | None:
    """Return the cycle in which the speed was found good; None where it is not decided."""
    witness = SpeedWitness(Named(), JOINT_GEAR)  # type: ignore[arg-type]
    calm = at_rest(LIMITS)
    for cycle in range(cycles):
        time = 1e-3 * cycle
        moved = calm._replace(
            time=start_s + time,
            motor_angle=speed * time * JOINT_GEAR,
            velocity=factor * speed,
            **changes,
        )
        if witness.decided(moved):
            return cycle
    return None


@pytest.mark.parametrize("factor", [0.3, 3.9])
def test_the_same_unit_is_found_after_some_travel(factor: float) -> None:
    for start_s in (0.0, 100.0):
        found = witnessed(factor, start_s=start_s)
        assert found == pytest.approx(STEPS * STEP_RAD / 0.2 * 1e3, abs=3 * STEPS)


@pytest.mark.parametrize("speed", [0.2, -0.2])
@pytest.mark.parametrize("factor", [0.0, 0.2, 68.3, -1.0])
def test_another_unit_is_refused_with_the_factor(factor: float, speed: float) -> None:
    with pytest.raises(ConfigurationError) as caught:
        witnessed(factor, speed)
    assert str(caught.value).endswith(
        f"must be 0.25 to 4 times: factor {factor:.4f}".replace("-0.0000", "0.0000")
    )


def test_a_joint_at_rest_decides_nothing() -> None:
    assert witnessed(1.0, speed=0.0) is None
    assert witnessed(68.0, speed=0.0) is None


def test_too_slow_a_travel_and_stale_samples_decide_nothing() -> None:
    assert witnessed(68.0, speed=0.9 * STEP_RAD, cycles=10_000) is None
    assert witnessed(68.0, fresh=False) is None


def test_a_run_ends_before_its_first_stage_and_takes_the_power_off(runner, fake_bench):
    bench = fake_bench()
    follow = bench.exchange

    def wrong() -> None:
        follow()
        bench.speed *= 1 / 68.3

    bench.exchange = wrong
    _, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "the speed that the drive reports is 0.01464 times the change" in outcome.message
    assert outcome.safe.verified
    assert bench.calls["quick_stop"] == 1
    assert max(map(abs, bench.targets)) < 0.1 + 2 * STEPS * STEP_RAD


def test_limits_on_what_a_drive_does_not_report_are_not_checked(fake_bench: Any) -> None:
    bench = fake_bench()
    bench.lacks = lambda cycle_s: Lacks(temperature=True)
    cycle = Cycle(LIMITS, 1_000_000, bench.devices(), None, None, None)  # type: ignore[arg-type]
    assert cycle._limits.reports_supply
    assert not cycle._limits.reports_temperature
    cycle.use(LIMITS)
    assert not cycle._limits.reports_temperature
    assert math.isfinite(cycle._limits.temperature)
