"""Which messages a run accepts, and which it refuses, in words."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import NS
from rig.terminal.control_socket import (
    LONGEST_TEXT,
    STALE_NS,
    Command,
    MessageError,
    Order,
    SocketFolderError,
    decode,
    objection,
    order_of,
    require_own_folder,
    socket_folders,
)

NOW = 1000 * NS
FIELDS: dict[str, Any] = {"command": "answer", "run": "r", "number": 5, "who": "w", "text": "0"}


def order(**changed: Any) -> Order:
    return Order(**{"command": Command.PAUSE, "run": "r", "number": NOW, "who": "w", **changed})


def test_a_command_survives_its_encoding() -> None:
    sent = order(command=Command.ANSWER, prompt=3, text="30,6 kg")
    assert order_of(decode(sent.encode())) == sent


@pytest.mark.parametrize(
    ("changed", "last", "words"),
    [
        ({}, 0, None),
        ({"run": "another"}, 0, "another run"),
        ({}, NOW, "already received"),
        ({}, NOW - 1, None),
        ({"number": NOW + 1}, 0, "future"),
        ({"number": NOW - STALE_NS}, 0, None),
        ({"number": NOW - STALE_NS - 1}, 0, "5.0 s old"),
        ({"number": NOW - 100 * NS, "command": Command.STOP}, 0, None),
        ({"number": NOW, "command": Command.STOP}, NOW, "already received"),
        ({"run": "another", "command": Command.STOP}, 0, "another run"),
    ],
)
def test_what_is_refused(changed: dict[str, Any], last: int, words: str | None) -> None:
    found = objection(order(**changed), "r", last, NOW)
    assert found is None if words is None else found is not None and words in found


@pytest.mark.parametrize(
    "changed",
    [
        {"command": "jump"},
        {"number": "5"},
        {"number": True},
        {"run": 1},
        {"text": None},
        {"text": "0" * (LONGEST_TEXT + 1)},
        {"who": "w" * (LONGEST_TEXT + 1)},
        {"more": 1},
        {"prompt": 1.5},
    ],
)
def test_commands_with_wrong_fields(changed: dict[str, Any]) -> None:
    with pytest.raises(MessageError):
        order_of({**FIELDS, **changed})


@pytest.mark.parametrize("data", [b"", b"[1]", b"\xff", b"[" * 4000, b"null", b'{"a":'])
def test_what_is_no_message(data: bytes) -> None:
    with pytest.raises(MessageError):
        decode(data)


def test_the_folder_is_closed_to_others(tmp_path: Path) -> None:
    folder = tmp_path / "sockets"
    require_own_folder(folder)
    assert folder.stat().st_mode & 0o777 == 0o700
    require_own_folder(folder)
    folder.chmod(0o750)
    with pytest.raises(SocketFolderError, match="chmod 700"):
        require_own_folder(folder)


def test_a_link_is_no_folder_for_sockets(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(SocketFolderError, match="folder that belongs to this user"):
        require_own_folder(tmp_path / "link")


def test_the_folder_follows_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    without = Path(f"/tmp/loadrig-{os.geteuid()}")
    assert socket_folders() == [tmp_path / "loadrig", without]
    for missing in ("nowhere", str(tmp_path / "nowhere"), ""):
        monkeypatch.setenv("XDG_RUNTIME_DIR", missing)
        assert socket_folders() == [without]
