"""The words about who holds a lock."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.common.locks import Holder

NOW = datetime(2026, 11, 20, 12, 37, 56, tzinfo=UTC)
NAMES = st.sampled_from(["pid", "command", "what", "user", "host", "since"])
VALUES = st.none() | st.booleans() | st.text() | st.integers() | st.floats() | st.lists(st.text())
JSON = VALUES | st.dictionaries(NAMES, VALUES)
HERE = Holder(1234, "rig run", "bench x", "ada", socket.gethostname(), "2026-11-20T12:34:56+00:00")


def test_all_that_is_known_is_said() -> None:
    assert (
        HERE.words("bench x", NOW)
        == "`rig run` (process 1234, user ada) since 12:34:56 UTC, 3 min ago"
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"what": "bench y"}, "`rig run` on bench y (process 1234, user ada)"),
        ({"host": "elsewhere"}, "`rig run` (process 1234, user ada, computer elsewhere)"),
        ({"host": "", "user": "", "command": ""}, "`a program` (process 1234)"),
    ],
)
def test_what_differs_is_said_and_what_is_not_known_is_not(
    changes: dict[str, str], words: str
) -> None:
    assert replace(HERE, **changes, since="").words("bench x", NOW) == words  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (-0.1, "12:37:56 UTC"),
        (0.9, "12:37:55 UTC, just now"),
        (59.9, "12:36:56 UTC, 59 s ago"),
        (60.0, "12:36:56 UTC, 1 min ago"),
        (45_476.0, "00:00:00 UTC, 12 h ago"),
        (86_400.0, "2026-11-19 12:37:56 UTC, 1 d ago"),
    ],
)
def test_the_age_is_said_in_one_unit(seconds: float, words: str) -> None:
    since = (NOW - timedelta(seconds=seconds)).isoformat()
    assert (
        replace(HERE, since=since).words("bench x", NOW)
        == f"`rig run` (process 1234, user ada) since {words}"
    )


@pytest.mark.parametrize("since", ["soon", "9999-12-31T23:59:59-23:00"])
def test_a_time_that_cannot_be_is_left_out(since: str) -> None:
    assert replace(HERE, since=since).words("bench x", NOW) == "`rig run` (process 1234, user ada)"


def test_a_holder_is_read_back() -> None:
    assert Holder.parse(HERE.content()) == HERE
    mine = Holder.here("rig jog", "bench x")
    assert Holder.parse(mine.content()) == mine
    assert (mine.pid, mine.host) == (os.getpid(), socket.gethostname())
    assert mine.user


@pytest.mark.parametrize(
    ("pid", "read"),
    [
        (0, False),
        (1, True),
        (2**31 - 1, True),
        (2**31, False),
    ],
)
def test_only_a_process_that_can_be_is_believed(pid: int, read: bool) -> None:
    assert (Holder.parse(replace(HERE, pid=pid).content()) is not None) is read


@given(st.binary() | JSON.map(lambda told: json.dumps(told).encode()))
def test_any_content_is_read_without_an_error(content: bytes) -> None:
    found = Holder.parse(content)
    assert found is None or found.words("bench x", NOW).isprintable()


def test_a_process_is_looked_for_on_this_computer_only() -> None:
    assert replace(HERE, pid=os.getpid()).alive()
    assert replace(HERE, pid=1).alive()
    assert not replace(HERE, pid=2**31 - 1).alive()
    assert replace(HERE, pid=2**31 - 1, host="elsewhere").alive()
