"""Advisory locks, with the name of their holder, for exclusive use of benches and run folders.

A lock is an ``flock`` of the operating system. The lock ends when the last process that has the
file open ends, in any way; a suspended process keeps the lock, and so does a child that inherits
the descriptor. The content of the file names the holder. The content is used only for messages, so
that damaged content does no harm.

The lock files of benches remain; such a file is empty while no program holds the lock. The lock
file of a run folder is removed by its holder; a process that locks this file then checks that the
name still refers to the locked file.
"""

from __future__ import annotations

import dataclasses
import json
import os
import socket
import stat
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from re import sub
from types import ModuleType
from typing import Any, Final, Self

from rig.common.errors import InputError, InUseError, StorageError
from rig.common.provenance import utc_now

_LONGEST: Final = 300
"""Greatest number of characters of a text that are shown, because anyone may write a lock file."""
_GREATEST_PID: Final = 2**31 - 1
_STEPS: Final = ((86_400, "d"), (3_600, "h"), (60, "min"), (1, "s"))


@dataclass(frozen=True)
class Holder:
    """A program that holds a lock."""

    pid: int
    command: str  # name of the program, such as `rig run`
    what: str  # locked object: `bench NAME` or `run folder PATH`
    user: str
    host: str
    since: str  # time at which the program took the lock, ISO 8601 in UTC

    @classmethod
    def here(cls, command: str, what: str) -> Self:
        """Return a record of this process as the holder of a lock, with the present time."""
        since = utc_now().isoformat(timespec="seconds")
        return cls(os.getpid(), command, what, _user(), socket.gethostname(), since)

    @classmethod
    def parse(cls, content: bytes) -> Self | None:
        """Return the holder named in a lock file, or None if the file is empty or damaged."""
        try:
            told = json.loads(content)
        except (ValueError, RecursionError):
            return None
        if not isinstance(told, dict):
            return None
        pid = told.get("pid")
        if not isinstance(pid, int) or isinstance(pid, bool) or not 0 < pid <= _GREATEST_PID:
            return None
        names = [field.name for field in dataclasses.fields(cls) if field.name != "pid"]
        return cls(pid, *(_printable(told.get(name)) for name in names))

    def content(self) -> bytes:
        """Return the content for the lock file."""
        return json.dumps(dataclasses.asdict(self)).encode() + b"\n"

    def alive(self) -> bool:
        """Whether the process exists; true if its existence cannot be checked."""
        if self.host != socket.gethostname() or os.name != "posix":
            return True
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except OSError:
            # The process exists and belongs to another user.
            return True
        return True

    def words(self, what: str, now: datetime) -> str:
        """Return a description of the holder; the locked object only if it is not ``what``."""
        other = f" on {self.what}" if self.what and self.what != what else ""
        user = f", user {self.user}" if self.user else ""
        host = f", computer {self.host}" if self.host and self.host != socket.gethostname() else ""
        return (
            f"`{self.command or 'a program'}`{other} (process "
            f"{self.pid}{user}{host}){self._when(now)}"
        )

    def _when(self, now: datetime) -> str:
        """Return the start time and the time since then; empty if the file has no start time."""
        try:
            since = datetime.fromisoformat(self.since).astimezone(UTC)
        except (ValueError, OverflowError):
            return ""
        day = "" if since.date() == now.astimezone(UTC).date() else f"{since:%Y-%m-%d} "
        seconds = (now - since).total_seconds()
        # Nothing if the clock was set back meanwhile.
        ago = ", just now" if seconds >= 0 else ""
        for length_s, unit in reversed(_STEPS):
            if seconds >= length_s:
                ago = f", {int(seconds // length_s)} {unit} ago"
        return f" since {day}{since:%H:%M:%S} UTC{ago}"


def is_held(file: Path) -> bool:
    """Return whether a program on this computer holds a lock file; a lock that is taken for this
    test is released at once.

    A file that exists but cannot be opened counts as held.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return True
    finally:
        os.close(descriptor)
    return False


def _printable(text: Any) -> str:
    """Return a text shortened and without control characters, safe for a terminal."""
    if not isinstance(text, str):
        return ""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:_LONGEST])


def _user() -> str:
    """Return the user of this process; the number if the system has no name."""
    try:
        import pwd
    except ImportError:
        return os.environ.get("USERNAME", "")
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())


LOCK_FOLDER: Final = Path("/tmp/loadrig-locks")
"""Folder of the lock files of benches, for all users of this computer."""
OWNER_FILE: Final = ".owner"  # the lock file of a run folder

_FOLDER_MODE: Final = 0o1777
_FILE_MODE: Final = 0o666
_READABLE: Final = 40
_CONTENT_BYTES: Final = 16_384
_ATTEMPTS: Final = 25
_PAUSE_S: Final = 0.02
"""Time, s, between two attempts to read the holder's name before a lock is refused."""


@dataclass(frozen=True, order=True)
class Resource:
    """A part of a bench that only one program at a time may use."""

    key: str  # unique key: the real path of a device, else `interface:channel`
    label: str  # name for the operator, such as `port /dev/ttyUSB0`


class Lock:
    """Locks held by this process; a context manager that releases them at the end."""

    def __init__(
        self, held: Sequence[_Held] = (), taken_over: str | None = None, owner: Path | None = None
    ) -> None:
        # Message on locks left by a dead program, or None if there were none.
        self.taken_over = taken_over
        self._held = tuple(held)
        self._owner = owner

    @property
    def descriptors(self) -> tuple[int, ...]:
        """File descriptors of the locks; a child that inherits these holds the locks to its end."""
        return tuple(item.descriptor for item in self._held)

    def note(self, command: str) -> None:
        """Write this process to the lock files as their holder; no error is raised."""
        for item in self._held:
            before = Holder.parse(item.read())
            holder = Holder.here(command, "" if before is None else before.what)
            item.write(holder if before is None else replace(holder, since=before.since))

    def release(self) -> None:
        """Release the locks, without an error. The name of a child that holds a lock remains."""
        held, self._held = self._held, ()
        for item in reversed(held):
            item.close()
        if self._owner is not None and held:
            _remove(self._owner)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()


def hold_bench(
    name: str, resources: Iterable[Resource], command: str, folder: Path | None = None
) -> Lock:
    """Lock all parts of a bench, or none.

    ``resources``: parts of the bench; see :func:`rig.wiring.connect.resources`. If empty, nothing
    is locked. ``folder``: folder of the lock files; :data:`LOCK_FOLDER` by default.

    Raises:
        InUseError: Another program holds the lock of a part of the bench.
        StorageError: A lock file cannot be used.
    """
    what, folder = f"bench {name}", folder or LOCK_FOLDER
    parts = {part.key: part for part in resources}
    places = [
        _Place(f"{what} ({parts[key].label})", what, folder, file_name(key), True)
        for key in sorted(parts)
    ]
    return _hold(places, command)


def lock_files(resources: Iterable[Resource], folder: Path | None = None) -> list[Path]:
    """Return the lock files of parts of a bench, whether they exist or not."""
    return [(folder or LOCK_FOLDER) / file_name(part.key) for part in resources]


def hold_folder(folder: Path, command: str) -> Lock:
    """Lock a run folder.

    Raises:
        InUseError: Another program holds the lock.
        StorageError: The lock file cannot be written.
    """
    if not os.path.isdir(folder):
        raise InputError(f"{folder}: no such folder; give the folder of a run")
    place = _Place(
        f"run folder {folder}", f"run folder {os.path.realpath(folder)}", folder, OWNER_FILE, False
    )
    return _hold([place], command, owner=Path(os.path.realpath(folder)) / OWNER_FILE)


def inherited(descriptors: Iterable[int], folder: Path | None = None) -> Lock:
    """Return the inherited locks; :meth:`Lock.note` writes this process as their holder."""
    return Lock(
        [_Held(descriptor) for descriptor in descriptors],
        owner=None if folder is None else folder / OWNER_FILE,
    )


def file_name(key: str) -> str:
    """Return the name of a resource's lock file: a readable part and a digest of the key."""
    digest = sha256(key.encode("utf-8", "surrogatepass")).hexdigest()[:20]
    return f"{sub('[^A-Za-z0-9]+', '-', key)[-_READABLE:].strip('-')}-{digest}.lock"


@dataclass(frozen=True)
class _Place:
    """A lock file: subject in messages, ``what`` it says it locks; ``shared`` by all users."""

    subject: str
    what: str
    folder: Path
    file: str
    shared: bool


class _Held:
    """A locked file, and the content written by this process."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._written = b""

    def read(self) -> bytes:
        """Return the content of the lock file; empty if the file cannot be read."""
        with suppress(OSError):
            return os.pread(self.descriptor, _CONTENT_BYTES, 0)
        return b""

    def write(self, holder: Holder) -> None:
        """Write the holder to the file; an error, such as a full disk, is ignored."""
        self._written = holder.content()
        with suppress(OSError):
            os.ftruncate(self.descriptor, 0)
            os.pwrite(self.descriptor, self._written, 0)

    def close(self) -> None:
        """Erase the content that this process wrote, and release the lock."""
        # No LOCK_UN, which would also release the lock of a child that has inherited the file.
        with suppress(OSError):
            if self._written.startswith(self.read()):
                os.ftruncate(self.descriptor, 0)
        with suppress(OSError):
            os.close(self.descriptor)


def _hold(places: Sequence[_Place], command: str, owner: Path | None = None) -> Lock:
    """Lock all given files in the given order; if one cannot be locked, release all others."""
    held: list[_Held] = []
    taken_over: list[str] = []
    try:
        for place in places:
            item, left = _take(place)
            held.append(item)
            if left.strip():
                holder = Holder.parse(left)
                who = "an unknown program"
                if holder is not None:
                    who = holder.words(place.what, utc_now())
                taken_over.append(
                    f"{place.subject} was left locked by {who}, which no longer holds the lock; "
                    "the lock is taken over"
                )
            item.write(Holder.here(command, place.what))
    except BaseException:
        Lock(held, owner=owner).release()
        raise
    return Lock(held, "\n".join(dict.fromkeys(taken_over)) or None, owner)


def _take(place: _Place) -> tuple[_Held, bytes]:
    """Lock one file; return it with the content that its last holder left."""
    holder: Holder | None = None
    for attempt in range(_ATTEMPTS):
        if attempt:
            time.sleep(_PAUSE_S)
        try:
            found = _attempt(place)
        except FileExistsError:
            # Another program created the file at the same moment.
            continue
        except OSError as error:
            raise StorageError(_unusable(place, error.strerror or str(error))) from error
        if isinstance(found, _Held):
            return found, found.read()
        holder = found
        if holder is not None and holder.alive():
            break
    raise InUseError(_refusal(place, holder))


def _attempt(place: _Place) -> _Held | Holder | None:
    """Return the locked file, else its holder, or None if holder or file do not exist."""
    fcntl = _fcntl(place)
    with _folder(place) as folder:
        item = _Held(_open(place, folder, fcntl))
        locked = False
        try:
            if not _locked(item.descriptor, fcntl):
                return Holder.parse(item.read())
            with suppress(FileNotFoundError):
                named = os.stat(place.file, dir_fd=folder, follow_symlinks=False)
                locked = os.path.samestat(named, os.fstat(item.descriptor))
            return item if locked else None
        finally:
            if not locked:
                os.close(item.descriptor)


def _fcntl(place: _Place) -> ModuleType:
    """Return the module that locks files."""
    try:
        import fcntl
    except ImportError as error:
        # Windows has no fcntl; a bench is not used without a lock.
        raise StorageError(
            f"{place.subject}: this system cannot lock files; use Linux or macOS. Without fcntl "
            f"two programs could drive one bench. Recordings can be identified, diagnosed, "
            f"simulated, exported and inspected on this system"
        ) from error
    return fcntl


def _locked(descriptor: int, fcntl: ModuleType) -> bool:
    """Lock an open file, unless another program has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextmanager
def _folder(place: _Place) -> Iterator[int]:
    """Open the folder of a lock file; the shared folder is made, and must not be a link."""
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
    if place.shared:
        flags |= os.O_NOFOLLOW
        with suppress(FileExistsError):
            os.mkdir(place.folder, _FOLDER_MODE)
    descriptor = os.open(place.folder, flags)
    try:
        if place.shared:
            _open_to_all(descriptor, _FOLDER_MODE)
        yield descriptor
    finally:
        os.close(descriptor)


def _open(place: _Place, folder: int, fcntl: ModuleType) -> int:
    """Open or create a lock file; returns a descriptor above the standard streams."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        # First without O_CREAT, because in a sticky folder, fs.protected_regular refuses to open a
        # file of another user with O_CREAT.
        descriptor = os.open(place.file, flags, dir_fd=folder)
    except FileNotFoundError:
        descriptor = os.open(place.file, flags | os.O_CREAT | os.O_EXCL, _FILE_MODE, dir_fd=folder)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or (place.shared and status.st_nlink > 1):
            raise StorageError(_unusable(place, "not a regular file with one name"))
        _open_to_all(descriptor, _FILE_MODE)
        # If a standard stream is closed, the lock could get its number, and printed text would go
        # into the file.
        above: int = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 3)
        return above
    finally:
        os.close(descriptor)


def _open_to_all(descriptor: int, mode: int) -> None:
    """Set the mode of a file of this user regardless of the umask."""
    status = os.fstat(descriptor)
    if status.st_uid == os.geteuid() and stat.S_IMODE(status.st_mode) != mode:
        with suppress(OSError):
            os.fchmod(descriptor, mode)


def _remove(path: Path) -> None:
    """Remove the lock file of a run folder, unless the file is locked or names a holder."""
    import fcntl

    with suppress(OSError):
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            status = os.fstat(descriptor)
            if (
                _locked(descriptor, fcntl)
                and os.path.samestat(status, os.lstat(path))
                and not os.fstat(descriptor).st_size
            ):
                os.unlink(path)
        finally:
            os.close(descriptor)


def _refusal(place: _Place, holder: Holder | None) -> str:
    """Return the reason why a lock is refused, and the remedy."""
    if holder is None:
        file = place.folder / place.file
        return (
            f"{place.subject} is in use by a program that has not written its name; "
            f"`fuser {file}` finds the program"
        )
    who = holder.words(place.what, utc_now())
    if holder.alive():
        return f"{place.subject} is in use by {who}; wait for it to end, or stop it{_off(place)}"
    return (
        f"{place.subject} is in use: {who} is gone, but a process that it started, such as the "
        "guardian of a drive that is not off yet, still holds the lock; wait for the end of that "
        f"process{_off(place)}"
    )


def _off(place: _Place) -> str:
    """Return the command that makes a bench safe although it is locked."""
    return "; `rig off BENCH` ends it and makes the bench safe" if place.shared else ""


def _unusable(place: _Place, reason: str) -> str:
    """Return the problem of a lock file or its folder, and the remedy."""
    if place.shared:
        remedy = (
            f"{place.folder} must be a folder that everyone may write to (mode 1777); remove or "
            f"rename what has this name"
        )
    else:
        remedy = "let this user write to it, or use a folder on a local disk"
    return f"{place.subject}: {place.folder / place.file} cannot be used: {reason}; {remedy}"
