"""The stop and pause buttons: which signal does what, and what is given back."""

import signal
import threading
from collections.abc import Iterator

import pytest

from rig.terminal.stop_button import OperatorStopError, StopButton, ignore_stops

CAUSES = {
    "SIGINT": "Ctrl-C",
    "SIGTERM": "SIGTERM",
    "SIGHUP": "SIGHUP: the terminal was closed",
    "SIGTSTP": "Ctrl-Z: a run can't be suspended under power",
    "SIGQUIT": "SIGQUIT",
}
TAKEN = (*CAUSES, "SIGTTOU", "SIGUSR1")


def handlers() -> dict[str, object]:
    return {
        name: signal.getsignal(getattr(signal, name)) for name in TAKEN if hasattr(signal, name)
    }


@pytest.fixture(autouse=True)
def _given_back() -> Iterator[None]:
    """Whatever a test does, the signals are afterwards as they were."""
    numbers = [getattr(signal, name) for name in TAKEN]
    before = [signal.getsignal(number) for number in numbers]
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup ignores it
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.mark.parametrize("name", CAUSES)
def test_what_ends_a_run_and_how_that_is_said(name: str) -> None:
    with StopButton() as stop:
        assert (stop.pressed, stop.presses, stop.cause, stop.pausing) == (False, 0, "", False)
        stop.check()
        signal.raise_signal(getattr(signal, name))
        assert stop.cause == CAUSES[name]
        assert stop.words == f"stopped by the operator ({CAUSES[name]})"
        # A drive that brakes is taken off the power at once by two presses, of which SIGQUIT is
        # both.
        assert stop.presses == (2 if name == "SIGQUIT" else 1)
        hurry = stop.hurry()
        assert hurry() == (name == "SIGQUIT")
        stop.press()
        assert hurry()
        with pytest.raises(OperatorStopError) as caught:
            stop.check()
        assert str(caught.value) == stop.words


def test_the_first_cause_is_the_one_that_counts() -> None:
    stop = StopButton()
    stop.press()
    assert (stop.pressed, stop.presses, stop.cause) == (True, 1, "")
    assert stop.words == "stopped by the operator"
    stop.press("SIGTERM")
    stop.press("Ctrl-C")
    assert (stop.presses, stop.words) == (3, "stopped by the operator (SIGTERM)")


def test_without_a_stop_before_the_braking_the_first_press_is_enough() -> None:
    stop = StopButton()
    hurry = stop.hurry()
    assert not hurry()
    # The control socket is read as well.
    stop.listen = stop.press
    assert hurry()


def test_all_signals_are_taken_over_and_given_back() -> None:
    before = handlers()
    stop = StopButton()
    with stop as entered:
        assert entered is stop
        assert handlers()["SIGTTOU"] is signal.SIG_IGN
        assert all(handler is not before[name] for name, handler in handlers().items())
    assert handlers() == before
    # Once: what others have set since is theirs.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    stop.__exit__(None, None, None)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN


def test_of_what_was_ignored_at_the_start_only_a_hangup_stays_so() -> None:
    for name in CAUSES:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    with StopButton():
        assert [name for name, handler in handlers().items() if handler is signal.SIG_IGN] == [
            "SIGHUP",
            "SIGTTOU",
        ]


@pytest.mark.parametrize("missing", [*CAUSES, "SIGTTOU"])
def test_a_system_may_lack_a_signal(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    number = getattr(signal, missing)
    kept = signal.getsignal(number)
    before = handlers()
    monkeypatch.delattr(signal, missing)
    with StopButton():
        taken = [name for name, handler in handlers().items() if handler is not before[name]]
        assert taken == [name for name in TAKEN if name != missing]
        assert signal.getsignal(number) is kept


def test_a_system_may_lack_the_pause_signal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.terminal.stop_button.PAUSE_SIGNAL", None)
    before = handlers()
    with StopButton():
        assert [name for name, handler in handlers().items() if handler is before[name]] == [
            "SIGUSR1"
        ]


def test_outside_the_main_thread_the_methods_do_it() -> None:
    before = handlers()
    stop = StopButton()
    found: list[object] = []

    def other() -> None:
        with stop as entered:
            found.extend([entered, handlers()])
            entered.press("the other thread")

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert found == [stop, before]
    assert stop.words == "stopped by the operator (the other thread)"


def test_a_pause_is_asked_for_and_taken_back() -> None:
    told: list[str] = []
    with StopButton(told.append) as stop:
        signal.raise_signal(signal.SIGUSR1)
        assert stop.pausing
        signal.raise_signal(signal.SIGUSR1)
        assert not stop.pausing
        assert not stop.pressed
    assert told == [
        "pause requested: at the end of this stage, with the drive off; SIGUSR1 again cancels "
        "the pause",
        "pause cancelled",
    ]
    with StopButton() as silent:
        signal.raise_signal(signal.SIGUSR1)
        assert silent.pausing


def test_only_where_it_is_interruptible_a_stop_interrupts() -> None:
    with StopButton() as stop:
        with stop.interruptible():
            pass
        signal.raise_signal(signal.SIGINT)
        assert stop.pressed


def test_what_cleans_up_after_an_interrupt_is_not_interrupted() -> None:
    cleaned: list[int] = []

    def interrupted(stop: StopButton) -> None:
        with stop.interruptible():
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                signal.raise_signal(signal.SIGTERM)
                cleaned.append(stop.presses)

    with StopButton() as stop, pytest.raises(KeyboardInterrupt):
        interrupted(stop)
    assert cleaned == [2]
    assert stop.cause == "Ctrl-C"


def test_a_stop_asked_for_before_does_not_leave_it_interruptible() -> None:
    with StopButton() as stop:
        stop.press()
        with pytest.raises(OperatorStopError), stop.interruptible():
            pytest.fail("it was not heard")
        signal.raise_signal(signal.SIGINT)
        assert stop.presses == 2


def test_after_a_stopped_run_every_stop_signal_is_ignored() -> None:
    ignore_stops()
    for name in CAUSES:
        assert signal.getsignal(getattr(signal, name)) is signal.SIG_IGN
        signal.raise_signal(getattr(signal, name))


def test_a_system_may_lack_a_signal_that_is_to_be_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    hangup = signal.SIGHUP
    before = signal.getsignal(hangup)
    monkeypatch.delattr(signal, "SIGHUP")
    ignore_stops()
    assert signal.getsignal(hangup) is before
    assert signal.getsignal(signal.SIGQUIT) is signal.SIG_IGN
