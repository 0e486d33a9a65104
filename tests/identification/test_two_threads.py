"""The second thread of the kernels: results, failures, calls inside calls."""

from __future__ import annotations

import threading

import pytest

from identification.numerics.two_threads import THREAD, both


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
