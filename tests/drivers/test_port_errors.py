from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.port_errors import close_all, os_errors, words

from .library_errors import ERRORS, name


def raising(error: BaseException) -> Callable[..., None]:
    def action(*_args: object) -> None:
        raise error

    return action


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_only_os_errors_get_out_and_they_have_words(make: Callable[[], Exception]) -> None:
    error = make()
    with pytest.raises(OSError, match=r"\w") as caught:
        os_errors(raising(error))()
    assert caught.value is error or caught.value.__cause__ is error
    assert words(caught.value) == words(error) or isinstance(error, OSError)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_who_ends_the_program_is_not_held_up(error: type[BaseException]) -> None:
    with pytest.raises(error):
        os_errors(raising(error()))()


def test_words_name_the_type_where_the_text_is_no_sentence() -> None:
    assert words(KeyError(12)) == "KeyError: 12"
    assert words(NotImplementedError()) == "NotImplementedError"
    assert words(OSError(5, "Input/output error")) == "[Errno 5] Input/output error"
    assert words(OSError()) == "OSError"


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_everything_is_closed_whatever_closing_raises(make: Callable[[], Exception]) -> None:
    closed: list[int] = []
    close_all(raising(make()), lambda: closed.append(1), raising(make()), lambda: closed.append(2))
    assert closed == [1, 2]
    with pytest.raises(KeyboardInterrupt):
        close_all(raising(KeyboardInterrupt()), lambda: closed.append(3), raising(make()))
    assert closed == [1, 2, 3]


def test_a_traceback_inside_a_message_is_left_out() -> None:
    error = OSError("Failed to receive: bad byte  Traceback (most recent call last):\n  File x")
    assert words(error) == "Failed to receive: bad byte"
    assert words(ValueError("\n  second\n")) == "ValueError: second"
