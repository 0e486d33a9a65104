"""Quantisation, differentiation, filtering, decimation and tracking against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from identification.recording import Recording
from identification.signals import (
    Decimator,
    central_difference,
    decimator,
    derivative,
    forwards_and_backwards,
    quantum,
    resample,
    sections,
    smooth,
    track,
    tracking_error,
    values_at_ends,
)

RATE = 1000.0
TIME = np.arange(4000) / RATE


@given(
    unit=st.floats(1e-6, 1e3),
    offset=st.floats(-10.0, 10.0),
    counts=st.lists(st.integers(-3, 3), min_size=60, max_size=200).filter(
        lambda steps: sum(abs(s) == 1 for s in steps) > 8
    ),
)
def test_quantum_is_the_step_of_an_encoder_after_any_scale_and_offset(unit, offset, counts):
    values = np.cumsum(np.array(counts)) * unit + offset * unit
    assert quantum(values) == pytest.approx(unit, rel=1e-6)


def test_quantum_of_an_encoder_that_never_moves_slowly() -> None:
    unit = 2.0 * np.pi / 262144.0
    values = np.floor(0.35 * np.sin(2.0 * np.pi * 0.2 * TIME) / unit) * unit
    assert quantum(values) == pytest.approx(unit, rel=1e-6)


@pytest.mark.parametrize("seed", range(1))
def test_noise_has_no_quantum(seed: int) -> None:
    assert quantum(np.random.default_rng(seed).normal(size=2000)) == 0.0


@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5])
def test_exact_motion_has_no_quantum(shift: float) -> None:
    assert quantum(0.35 * np.sin(2.0 * np.pi * 0.2 * (TIME + shift / RATE))) == 0.0


def test_a_few_equal_tiny_steps_are_chance() -> None:
    """A shaft creeping before it sticks leaves a handful of steps far below all others."""
    creep = np.cumsum(np.full(4, 1e-9))
    assert quantum(np.concatenate((creep, 0.35 * np.sin(TIME)))) == 0.0


def test_a_constant_has_no_quantum() -> None:
    assert quantum(np.full(100, 0.3)) == 0.0
    assert quantum(np.zeros(1)) == 0.0


def order(differentiate: object, inner: slice) -> float:
    """Log2 of the error's fall when the step is halved."""
    errors = []
    for step in (0.02, 0.01):
        time = np.arange(0.0, 4.0, step)
        error = differentiate(np.sin(3.0 * time), step) - 3.0 * np.cos(3.0 * time)  # type: ignore[operator]
        errors.append(float(np.max(np.abs(error[inner]))))
    return float(np.log2(errors[0] / errors[1]))


def test_seven_point_derivative_is_of_sixth_order() -> None:
    assert order(derivative, slice(3, -3)) == pytest.approx(6.0, abs=0.1)


def test_three_point_derivative_is_of_second_order() -> None:
    assert order(central_difference, slice(1, -1)) == pytest.approx(2.0, abs=0.1)


def test_derivative_of_a_short_series_falls_back() -> None:
    assert derivative(np.array([0.0, 1.0, 4.0, 9.0]), 1.0) == pytest.approx([1.0, 2.0, 4.0, 5.0])


def test_resample_moves_values_by_their_offset() -> None:
    grid = TIME[10:-10]
    moved = resample(TIME, 2.0 * TIME, grid, offset=-0.0005)
    assert moved == pytest.approx(2.0 * (grid + 0.0005))


def test_smooth_keeps_phase_and_removes_what_lies_above() -> None:
    slow, fast = np.sin(2.0 * np.pi * 2.0 * TIME), np.sin(2.0 * np.pi * 200.0 * TIME)
    inner = slice(500, -500)
    assert smooth(slow + fast, RATE, 40.0)[inner] == pytest.approx(slow[inner], abs=1e-4)


@pytest.mark.parametrize("bandwidth", [5.0, 20.0, 40.0, 100.0])
def test_decimator_keeps_every_sample_at_its_own_time(bandwidth: float) -> None:
    low_pass = decimator(RATE, bandwidth)
    lead = slice(low_pass.half, len(TIME) - low_pass.half, low_pass.factor)
    wave = np.sin(2.0 * np.pi * 0.05 * bandwidth * TIME + 0.3)
    assert low_pass(wave) == pytest.approx(wave[lead], abs=2e-3)
    assert low_pass(TIME) == pytest.approx(
        TIME[lead], abs=1e-12
    )  # symmetric: a line passes unchanged


@pytest.mark.parametrize("length", [400, 407, 413])
def test_decimator_is_the_plain_convolution_at_every_length(length: int) -> None:
    low_pass = decimator(RATE, 40.0)
    values = np.random.default_rng(length).normal(size=length)
    plain = np.convolve(values, low_pass.taps, mode="valid")[:: low_pass.factor]
    assert low_pass(values) == pytest.approx(plain, abs=1e-12)


@given(st.lists(st.integers(0, 499), max_size=5), st.sampled_from([20.0, 40.0, 150.0]))
def test_untouched_is_exactly_what_no_bad_sample_can_change(bad, bandwidth):
    low_pass = decimator(RATE, bandwidth)
    marks = np.zeros(500, dtype=bool)
    marks[bad] = True
    centres = np.arange(low_pass.half, 500 - low_pass.half, low_pass.factor)
    expected = [not np.any(marks[c - low_pass.half : c + low_pass.half + 1]) for c in centres]
    assert low_pass.untouched(marks).tolist() == expected
    spoiled = low_pass(np.where(marks, 1e9, 0.0))
    assert np.all(spoiled[low_pass.untouched(marks)] == 0.0)


def test_without_anything_to_remove_the_decimator_is_the_identity() -> None:
    low_pass = decimator(RATE, 450.0)
    assert low_pass == Decimator(low_pass.taps, 1)
    assert np.array_equal(low_pass(TIME), TIME)
    assert low_pass.untouched(TIME > 1.0).tolist() == (TIME <= 1.0).tolist()


@pytest.mark.parametrize("bandwidth", [5.0, 40.0, 333.3])
def test_the_low_pass_is_the_sinc_function_in_kaisers_window(bandwidth: float) -> None:
    low_pass = decimator(RATE, bandwidth)
    size = 2 * low_pass.half + 1
    taps = signal.firwin(size, bandwidth, fs=RATE, window=("kaiser", 5.0))
    np.testing.assert_allclose(low_pass.taps, taps / np.sum(taps), rtol=1e-14)


def test_values_at_the_ends_of_sample_periods_follow_from_means() -> None:
    """The reconstruction is exact for cubics; at both ends it is the mean of neighbours."""
    ends = np.arange(1.0, 31.0)
    integral = np.polynomial.Polynomial([0.0, 2.0, -0.3, 0.04, -0.001])
    means = integral(ends) - integral(ends - 1.0)
    found = values_at_ends(ends, means, 1.0)
    np.testing.assert_allclose(found[1:-2], integral.deriv()(ends)[1:-2], rtol=1e-12)
    np.testing.assert_allclose(found[[0, -2]], 0.5 * (means[[0, -2]] + means[[1, -1]]))
    assert found[-1] == means[-1]


def test_a_missing_sample_leaves_a_ramp_of_means_exact() -> None:
    ends = np.delete(np.arange(1.0, 31.0), 12)
    np.testing.assert_allclose(values_at_ends(ends, ends - 0.5, 1.0)[:-1], ends[:-1], rtol=1e-12)


def test_an_unknown_mean_reaches_no_further_than_its_neighbour() -> None:
    """The mean of an unknown sample, here 0, takes no part in the curvature."""
    ends, known = np.arange(1.0, 31.0), np.ones(30, bool)
    known[10:20] = False
    found = values_at_ends(ends, np.where(known, 24.0, 0.0), 1.0, known)
    np.testing.assert_array_equal(found[known & np.append(known[1:], True)], 24.0)


@pytest.mark.parametrize("share", [0.01, 0.08, 0.4, 0.85])
def test_the_filter_without_phase_is_scipys(share: float) -> None:
    values = 3.0 + np.cumsum(np.random.default_rng(0).normal(size=1500))
    expected = signal.sosfiltfilt(
        signal.butter(4, share, output="sos"), values, padlen=min(1499, int(6 / share))
    )
    found = forwards_and_backwards(sections(share), values, min(1499, int(6 / share)))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_without_padding_the_ends_start_in_their_steady_state() -> None:
    values = np.linspace(0.0, 1.0, 40)
    expected = signal.sosfiltfilt(signal.butter(4, 0.2, output="sos"), values, padlen=0)
    assert forwards_and_backwards(sections(0.2), values, 0) == pytest.approx(expected)


CLOCK = 1e-3 * np.arange(4000)


def tracked(angle: np.ndarray, command: np.ndarray, current: float = 2.0) -> Recording:
    channels = {"time": CLOCK, "angle": angle, "command": command}
    return Recording(channels=channels, voltage=np.full(4000, 3.0), current=np.full(4000, current))


def test_a_target_is_due_one_sample_later() -> None:
    command = 0.1 * CLOCK
    arrived = np.concatenate([[0.0], command[:-1]])
    assert not np.any(tracking_error(tracked(arrived, command)))
    np.testing.assert_allclose(tracking_error(tracked(arrived - 2e-3, command)), 2e-3)


def test_errors_and_energy_of_a_part() -> None:
    command = 0.1 * np.minimum(CLOCK, 2.0)
    angle = np.concatenate([[0.0], command[:-1]]) - np.where(CLOCK < 3.0, 1e-3, 4e-3)
    whole, early = track(tracked(angle, command)), track(tracked(angle, command), 1.0, 3.0)
    assert early.rms == pytest.approx(1e-3)
    assert whole.rms == pytest.approx(np.sqrt((3 * 1e-6 + 16e-6) / 4))
    assert (whole.largest, whole.at_end) == (pytest.approx(4e-3), pytest.approx(4e-3))
    assert early.energy == pytest.approx(3.0 * 2.0 * 2.0)
    with pytest.raises(ValueError, match="no sample from 9"):
        track(tracked(angle, command), 9.0)
