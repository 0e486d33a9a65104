import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, ObjectAccessError
from drivers.units import ServoScales, Unwrapper

GOOD = {
    "counts_per_turn": 4096,
    "gear_ratio": 100.0,
    "rated_current_A": 15.0,
    "rated_torque_N_m": 0.45,
}


class Objects:
    """A drive of nothing but objects."""

    def __init__(self, **changes: int) -> None:
        self.values = {(0x6075, 0): 15000, (0x6076, 0): 450, (0x608F, 1): 4096, (0x608F, 2): 1}
        self.values |= {(int(name[1:], 16), 0): value for name, value in changes.items()}

    def read(self, index: int, subindex: int = 0) -> int:
        if (index, subindex) not in self.values:
            raise ObjectAccessError(index, subindex, 0x06020000, "no such object")
        return self.values[index, subindex]


def check(scales: ServoScales, drive: Objects) -> None:
    """Raise what preparing a drive would raise of its units."""
    for error in scales.mismatches(drive):
        raise error


@given(
    st.integers(-(1 << 31), (1 << 31) - 1),
    st.sampled_from([1, -1]),
    st.floats(-10, 10),
    st.integers(16, 1 << 20),
    st.floats(0.1, 1000),
)
def test_counts_survive_the_way_to_angles_and_back(counts, sign, offset, per_turn, gear):
    scales = ServoScales(per_turn, gear, 15.0, 0.45, sign, offset)
    back = scales.counts(scales.joint_angle_rad(counts))
    # Beside a large offset an angle keeps 53 bits, so a tiny count may lose its last place.
    assert abs(back - counts) <= 1 + abs(offset / scales.joint_rad_per_count) * 1e-15


def test_one_motor_turn_is_a_hundredth_of_a_joint_turn() -> None:
    scales = ServoScales(**GOOD, sign=-1, offset_rad=0.5)
    assert scales.joint_angle_rad(4096) == pytest.approx(0.5 - math.tau / 100)
    assert scales.joint_speed_unit_rad_s == pytest.approx(math.tau / 409600)
    assert scales.current_unit_A == 0.015
    assert scales.joint_torque_unit_N_m == pytest.approx(0.045)


def test_a_drive_without_608f_is_taken_at_its_word() -> None:
    drive = Objects()
    del drive.values[0x608F, 1]
    check(ServoScales(**GOOD), drive)


@pytest.mark.parametrize(
    ("current", "accepted"), [(15014, True), (15016, False), (14986, True), (14984, False)]
)
def test_the_tolerance_is_a_thousandth(current: int, accepted: bool) -> None:
    scales = ServoScales(**GOOD)
    if accepted:
        check(scales, Objects(x6075=current))
    else:
        with pytest.raises(ConfigurationError, match=r"15 A in the bench file"):
            check(scales, Objects(x6075=current))


@pytest.mark.parametrize(
    "wrong", [{"gear_ratio": 0.0}, {"counts_per_turn": -1}, {"rated_current_A": math.inf}]
)
def test_impossible_scales_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(wrong))):
        ServoScales(**GOOD | wrong)


@given(st.integers(0, 999), st.lists(st.integers(-499, 499), max_size=50))
def test_unwrapping_follows_any_walk_of_less_than_half_the_range(start, steps):
    unwrapper = Unwrapper(1000)
    position = start
    assert unwrapper.update(start) == start
    for step in steps:
        position += step
        assert unwrapper.update(position % 1000) == position
        assert unwrapper.update(position % 1000) == position


def test_a_signed_counter_starts_next_to_zero() -> None:
    assert Unwrapper(1000, near=0).update(990) == -10
    assert Unwrapper(1000, near=0).update(10) == 10
    assert Unwrapper(1000).update(990) == 990
