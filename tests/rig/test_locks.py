"""One owner: locks of benches and run folders, held by real processes that end in every way."""

import errno
import json
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.common import locks
from rig.common.errors import InputError, InUseError, StorageError
from rig.common.locks import OWNER_FILE, Holder, Lock, Resource, file_name, hold_bench, hold_folder

from .lock_child import PART

CHILD = Path(__file__).with_name("lock_child.py")
ROOT = Path(__file__).parents[2]
OTHER = Resource("socketcan:can7", "socketcan channel can7")
KINDS = ("bench", "folder")


@dataclass
class Program:
    process: subprocess.Popen[str]

    @property
    def pid(self) -> int:
        return self.process.pid

    def tell(self, words: str, answer: str) -> None:
        self.process.stdin.write(f"{words}\n")
        self.process.stdin.flush()
        self.hear(answer)

    def hear(self, answer: str) -> None:
        assert self.process.stdout.readline() == f"{answer}\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def program(kind: str, folder: Path, command: str = "rig run") -> Iterator[Program]:
    """Start a program that holds the lock; it and its child are gone afterwards."""
    words = [sys.executable, str(CHILD), kind, str(folder), command]
    with subprocess.Popen(
        words,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as process:
        made = Program(process)
        try:
            made.hear("held")
            yield made
        finally:
            process.kill()


def hold(kind: str, folder: Path, command: str = "rig jog") -> Lock:
    return (
        hold_bench("wired", [PART], command, folder)
        if kind == "bench"
        else hold_folder(folder, command)
    )


def lock_file(kind: str, folder: Path) -> Path:
    return folder / (file_name(PART.key) if kind == "bench" else OWNER_FILE)


def free(kind: str, folder: Path) -> bool:
    """Whether the lock can be had, with nobody left to be named."""
    with hold(kind, folder) as lock:
        return lock.taken_over is None


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not wait for the name of a holder that gives none."""
    monkeypatch.setattr(locks, "_PAUSE_S", 0.0)


def test_the_second_program_is_told_who_the_first_is(kind: str, tmp_path: Path) -> None:
    with program(kind, tmp_path) as first:
        with pytest.raises(InUseError) as refused:
            hold(kind, tmp_path)
        subject = r"bench wired \(port /dev/ttyX\)" if kind == "bench" else f"run folder {tmp_path}"
        words = (
            rf"{subject} is in use by `rig run` \(process {first.pid}, user \w+\) since "
            rf"\d\d:\d\d:\d\d UTC, "
            r"(just now|\d+ s ago); wait for it to end, or stop it"
            + ("; `rig off BENCH` ends it and makes the bench safe" if kind == "bench" else "")
        )
        assert refused.match(f"^{words}$")
        first.tell("release", "released")
        assert free(kind, tmp_path)


def test_what_a_killed_program_held_is_taken_over_and_said(kind: str, tmp_path: Path) -> None:
    with program(kind, tmp_path) as first:
        first.kill()
        with hold(kind, tmp_path) as lock:
            assert f"was left locked by `rig run` (process {first.pid}, user " in lock.taken_over
            assert lock.taken_over.endswith(
                "which no longer holds the lock; the lock is taken over"
            )
            with pytest.raises(InUseError, match=f"`rig jog` .process {os.getpid()}"):
                hold(kind, tmp_path)
        assert free(kind, tmp_path)


@pytest.mark.usefixtures("hurried")
def test_a_child_that_inherits_it_keeps_it_when_its_parent_is_killed(kind, tmp_path):
    with program(kind, tmp_path) as first:
        first.tell("guard", "guarding")
        first.kill()
        with pytest.raises(
            InUseError, match=rf"process {first.pid}.* is gone, but a process that it started, such"
        ):
            hold(kind, tmp_path)
        first.tell("note guardian of rig run", "noted")
        with pytest.raises(InUseError) as refused:
            hold(kind, tmp_path)
        assert f"process {first.pid}" not in str(refused.value)
        first.tell("release", "released")
        assert lock_file(kind, tmp_path).exists() is (kind == "bench")
        assert free(kind, tmp_path)
        first.process.stdin.close()


@pytest.mark.usefixtures("hurried")
def test_a_parent_that_releases_leaves_it_to_its_child(kind: str, tmp_path: Path) -> None:
    with program(kind, tmp_path) as first:
        first.tell("guard", "guarding")
        first.process.send_signal(signal.SIGUSR1)
        first.hear("released")
        with pytest.raises(InUseError, match="that has not written its name; `fuser "):
            hold(kind, tmp_path)
        first.tell("release", "released")
        assert free(kind, tmp_path)
        first.process.stdin.close()


@pytest.mark.usefixtures("hurried")
@pytest.mark.parametrize("content", [b"{x", b'{"pid": 0}'])
def test_damaged_content_changes_nothing(kind: str, tmp_path: Path, content: bytes) -> None:
    with hold(kind, tmp_path):
        lock_file(kind, tmp_path).write_bytes(content)
        with pytest.raises(InUseError, match="by a program that has not written its name"):
            hold(kind, tmp_path)
    # Not this process's words, so it has let them stand.
    with hold(kind, tmp_path) as lock:
        assert lock.taken_over is not None
    assert free(kind, tmp_path)


def test_one_of_many_parts_in_use_leaves_the_others_free(tmp_path: Path) -> None:
    with hold_bench("one", [OTHER], "rig run", tmp_path):
        with pytest.raises(
            InUseError,
            match=r"^bench two \(socketcan channel can7\) is in use by `rig run` on bench one",
        ):
            hold_bench("two", [OTHER, PART], "rig jog", tmp_path)
        assert free("bench", tmp_path)
    with hold_bench("two", [OTHER, PART, OTHER], "rig jog", tmp_path) as lock:
        assert len(lock.descriptors) == 2
        for part in (OTHER, PART):
            with pytest.raises(InUseError):
                hold_bench("one", [part], "rig run", tmp_path)


def test_the_folder_of_all_users_is_open_to_all_users(tmp_path: Path) -> None:
    folder = tmp_path / "locks"
    before = os.umask(0o077)
    try:
        hold("bench", folder).release()
        assert stat.S_IMODE(folder.stat().st_mode) == 0o1777
        assert stat.S_IMODE(lock_file("bench", folder).stat().st_mode) == 0o666
        # What a program that died too early has left is put right.
        folder.chmod(0o700)
        lock_file("bench", folder).chmod(0o600)
        hold("bench", folder).release()
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.stat().st_mode) == 0o1777
    assert stat.S_IMODE(lock_file("bench", folder).stat().st_mode) == 0o666


TRAPS: Mapping[str, Callable[[Path, Path], object]] = {
    "link": lambda file, victim: file.symlink_to(victim),
    "pipe": lambda file, victim: os.mkfifo(file),
    "hard link": lambda file, victim: file.hardlink_to(victim),
    "folder": lambda file, victim: file.mkdir(),
}


@pytest.mark.parametrize("trap", TRAPS)
def test_what_somebody_put_in_the_place_of_a_file_is_refused(tmp_path: Path, trap: str) -> None:
    victim, folder = tmp_path / "victim", tmp_path / "locks"
    victim.write_text("precious")
    victim.chmod(0o600)
    folder.mkdir()
    TRAPS[trap](lock_file("bench", folder), victim)
    with pytest.raises(
        StorageError,
        match=r"bench wired .* cannot be used: .* \(mode 1777\); remove or rename what",
    ):
        hold("bench", folder)
    assert victim.read_text() == "precious"
    assert stat.S_IMODE(victim.stat().st_mode) == 0o600


def test_a_link_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.mkdir()
    (tmp_path / "locks").symlink_to(victim)
    with pytest.raises(StorageError, match=r"cannot be used: (Not a directory|Too many levels)"):
        hold("bench", tmp_path / "locks")
    assert not list(victim.iterdir())


@pytest.mark.parametrize(
    ("reason", "broken"), [(errno.EROFS, "os.open"), (errno.ENOLCK, "fcntl.flock"), (0, "fcntl")]
)
def test_a_system_that_refuses_is_an_error_in_words(kind, tmp_path, monkeypatch, reason, broken):
    opened = os.open

    def refuse(path: Any, flags: int, *mode: int, **options: Any) -> int:
        if broken == "os.open" and not flags & os.O_CREAT:
            return opened(path, flags, *mode, **options)
        raise OSError(reason, os.strerror(reason))

    if reason:
        monkeypatch.setattr(broken, refuse)
    else:
        monkeypatch.setitem(sys.modules, broken, None)
    with pytest.raises(StorageError, match=os.strerror(reason) if reason else "cannot lock files"):
        hold(kind, tmp_path)


def test_a_full_disk_takes_the_name_and_leaves_the_lock(kind, tmp_path, monkeypatch):
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(locks, "_PAUSE_S", 0.0)
    monkeypatch.setattr(os, "pwrite", refuse)
    with hold(kind, tmp_path), pytest.raises(InUseError, match="has not written its name"):
        hold(kind, tmp_path)
    assert free(kind, tmp_path)


def test_releasing_never_raises(kind: str, tmp_path: Path) -> None:
    folder = tmp_path / "held"
    folder.mkdir()
    lock = hold(kind, folder)
    shutil.rmtree(folder)
    lock.note("rig resume")
    for descriptor in lock.descriptors:
        os.close(descriptor)
    lock.release()
    lock.release()
    assert lock.descriptors == ()


def test_a_standard_stream_that_is_closed_is_not_replaced_by_a_lock(kind, tmp_path):
    code = (
        "import os, sys; from pathlib import Path; from rig.common.locks import Resource, "
        "hold_bench, hold_folder\n"
        "bench, folder = sys.argv[1] == 'bench', Path(sys.argv[2])\n"
        "os.closerange(0, 3)\n"
        "lock = hold_bench('b', [Resource('k', 'l')], 'rig', folder) if bench else "
        "hold_folder(folder, 'rig')\n"
        "os._exit(min(lock.descriptors))"
    )
    words = [sys.executable, "-c", code, kind, str(tmp_path)]
    assert subprocess.run(words, env={**os.environ, "PYTHONPATH": str(ROOT)}).returncode == 3


def test_a_folder_that_is_not_there_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name in ("none", "file", "file/none"):
        with pytest.raises(InputError, match=f"{name}: no such folder"):
            hold("folder", tmp_path / name)


def test_a_file_that_is_removed_between_opening_and_locking_is_not_the_lock(tmp_path, monkeypatch):
    last, locked = hold("folder", tmp_path), locks._locked
    with ExitStack() as later:

        def late(descriptor: int, fcntl: Any) -> bool:
            # Its holder releases, and another program comes, before this one locks what it has
            # opened.
            monkeypatch.setattr(locks, "_locked", locked)
            last.release()
            later.enter_context(hold("folder", tmp_path, "rig resume"))
            return locked(descriptor, fcntl)

        monkeypatch.setattr(locks, "_locked", late)
        with pytest.raises(InUseError, match=f"`rig resume` .process {os.getpid()}"):
            hold("folder", tmp_path)
    assert free("folder", tmp_path)


def test_a_file_that_comes_while_the_last_one_is_removed_stays(tmp_path, monkeypatch):
    lock, locked = hold("folder", tmp_path), locks._locked

    def late(descriptor: int, fcntl: Any) -> bool:
        (tmp_path / OWNER_FILE).unlink()
        (tmp_path / OWNER_FILE).touch()
        return locked(descriptor, fcntl)

    monkeypatch.setattr(locks, "_locked", late)
    lock.release()
    assert (tmp_path / OWNER_FILE).exists()


def test_a_file_that_another_user_makes_at_the_same_moment_is_opened(kind, tmp_path, monkeypatch):
    opened, file = os.open, lock_file(kind, tmp_path)

    def protect(path: Any, flags: int, *mode: int, **options: Any) -> int:
        # As fs.protected_regular does with a file of another user in a sticky folder.
        if flags & os.O_CREAT:
            os.close(opened(file, os.O_CREAT | os.O_RDWR, 0o666))
            if not flags & os.O_EXCL:
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return opened(path, flags, *mode, **options)

    monkeypatch.setattr(os, "open", protect)
    monkeypatch.setattr(locks, "_PAUSE_S", 0.0)
    with hold(kind, tmp_path), pytest.raises(InUseError, match=f"process {os.getpid()}"):
        hold(kind, tmp_path)


@given(st.text())
def test_every_channel_has_a_safe_file_name(key: str) -> None:
    assert re.fullmatch(r"[A-Za-z0-9-]{1,93}\.lock", file_name(key))


NOW = datetime(2026, 11, 20, 12, 37, 56, tzinfo=UTC)
NAMES = st.sampled_from(["pid", "command", "what", "user", "host", "since"])
VALUES = st.none() | st.booleans() | st.text() | st.integers() | st.floats() | st.lists(st.text())
JSON = VALUES | st.dictionaries(NAMES, VALUES)
HERE = Holder(1234, "rig run", "bench x", "ada", socket.gethostname(), "2026-11-20T12:34:56+00:00")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"what": "bench y"}, "`rig run` on bench y (process 1234, user ada)"),
        ({"host": "elsewhere"}, "`rig run` (process 1234, user ada, computer elsewhere)"),
        ({"host": "", "user": "", "command": ""}, "`a program` (process 1234)"),
    ],
)
def test_what_differs_is_said_and_what_is_not_known_is_not(changes, words):
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


def test_a_holder_is_read_back() -> None:
    assert Holder.parse(HERE.content()) == HERE
    mine = Holder.here("rig jog", "bench x")
    assert Holder.parse(mine.content()) == mine
    assert (mine.pid, mine.host) == (os.getpid(), socket.gethostname())
    assert mine.user


@pytest.mark.parametrize(
    ("pid", "read"), [(0, False), (1, True), (2**31 - 1, True), (2**31, False)]
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
