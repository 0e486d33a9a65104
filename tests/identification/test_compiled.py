"""Compiled kernels: the second thread and the exponential."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from identification.numerics.compiled import LEAST, THREAD, both, compiled, each, exponential


def _name() -> str:
    return threading.current_thread().name


def test_the_second_function_runs_in_a_thread_that_stays() -> None:
    first, second = both(_name, _name)
    assert first == threading.main_thread().name
    assert second.startswith(THREAD)
    assert both(_name, _name) == (first, second)


def test_inside_a_call_the_functions_run_one_after_the_other() -> None:
    inside, beside = both(lambda: both(_name, _name), lambda: both(_name, _name))
    assert len(set(inside)) == len(set(beside)) == 1
    assert inside != beside


@pytest.mark.parametrize("failing", [0, 1])
def test_a_failure_is_raised_after_both_have_ended_and_the_thread_goes_on(failing: int) -> None:
    ended = []

    def work(number: int) -> None:
        if number == failing:
            raise ValueError(str(number))
        ended.append(number)

    with pytest.raises(ValueError, match=str(failing)):
        both(lambda: work(0), lambda: work(1))
    assert ended == [1 - failing]
    assert both(_name, _name)[1].startswith(THREAD)


def test_two_items_run_at_the_same_time_and_results_keep_the_order_of_the_items() -> None:
    meeting = threading.Barrier(2, timeout=10.0)

    def work(item: int) -> int:
        if item < 2:
            meeting.wait()  # passes only if another item is worked on meanwhile
        return 10 * item

    assert each(work, range(5)) == [0, 10, 20, 30, 40]
    assert each(work, []) == []


@compiled
def of_all(x: np.ndarray) -> np.ndarray:
    out = np.empty_like(x)
    for k in range(len(x)):
        out[k] = exponential(x[k])
    return out


def test_the_exponential_is_the_librarys_to_a_unit_in_the_last_place() -> None:
    x = np.concatenate([np.linspace(LEAST, 0.0, 100_001), -np.geomspace(1e-300, 1.0, 10_001)])
    assert np.max(np.abs(of_all(x) / np.exp(x) - 1.0)) < 1.1 * np.finfo(float).eps
