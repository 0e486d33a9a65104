"""A command on a terminal of its own, started as a shell starts it, with an operator at the
keyboard.
"""

import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.cli.entry import status

ROOT = Path(__file__).resolve().parents[2]
RIG = ("-c", "from rig.cli.entry import main; main()")
WITNESS = ("-m", "tests.long.witness")
PROMPT = re.compile(r"Mass on the lever[^\r\n]*: ?$")
STOP_KEY, START_KEY = b"\x13", b"\x11"
_ANSI = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b\][^\x07]*\x07|\x1b[=>]")
_THOUGHT_S = 0.05
_MARK = "LOADRIG_HARNESS"
_SHELL = """
import json, os, select, signal, socket, sys
told = json.loads(sys.argv[1])
control = socket.socket(fileno=told["control"])
tty = os.open(told["tty"], os.O_RDWR)
try:
    # A computer at a bench has little else to do; here it may.
    os.setpriority(os.PRIO_PROCESS, 0, -5)
except PermissionError:
    pass
for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU):
    signal.signal(number, signal.SIG_IGN)
pid = os.fork()
if not pid:
    os.setpgid(0, 0)
    os.tcsetpgrp(tty, os.getpid())
    # The harness itself may have been started with some of them ignored, as by nohup.
    for number in range(1, signal.SIGSYS + 1):
        if number not in (signal.SIGKILL, signal.SIGSTOP):
            signal.signal(number, signal.SIG_DFL)
    for at, stream in enumerate(told["streams"]):
        if stream is None:
            os.close(at)
        else:
            os.dup2(os.open(stream, os.O_RDWR) if isinstance(stream, str) else stream, at)
    control.close()
    os.execvp(told["words"][0], told["words"])
signal.signal(signal.SIGHUP, lambda *_: os.kill(-pid, signal.SIGHUP))
def tell(words):
    try:
        control.send(words)
    except OSError:
        pass  # the harness is done with it
tell(b"pid %d\\n" % pid)
while True:
    if select.select([control], [], [], 0.02)[0]:
        os.kill(-pid, signal.SIGKILL)  # the harness itself is gone
        sys.exit()
    found, status = os.waitpid(pid, os.WNOHANG | os.WUNTRACED)
    if found and not os.WIFSTOPPED(status):
        break
    if found:
        tell(b"stopped %d\\n" % os.WSTOPSIG(status))
tell(b"ended %d\\n" % os.waitstatus_to_exitcode(status))
control.recv(1)
"""
"""What a shell does: a session and a process group of its own, the terminal in its hands, a look at
how it ended.
"""


def unwrapped(text: str) -> str:
    """Return text with each end of a line as a blank, so that words are found however wide the
    terminal is.
    """
    return re.sub(r"\s*[\r\n]+\s*", " ", text)


def rig_off(bench: Path, env: Mapping[str, str]) -> str:
    """Use `rig off`, before other programs of a busy computer."""
    words = ["nice", "-n", "-5", sys.executable, *RIG, "off", str(bench)]
    environment = os.environ | {"PYTHONPATH": str(ROOT), **env}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    good = done.returncode == 0 and "read back" in done.stdout
    return "" if good else f"rig off ended with {done.returncode}: {done.stderr[-200:]}"


def rig(*words: str, check: bool = True) -> str:
    """Run a command in this process; returns what it says, and ends the program where it fails."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = status(list(words))
    if code and check:
        raise SystemExit(f"rig {' '.join(words)} ended with status {code}: {said.getvalue()}")
    return said.getvalue()


@dataclass(frozen=True)
class Streams:
    """What standard input and output are: ``tty``, ``pipe``, ``closed``, or a path."""

    stdin: str = "tty"
    stdout: str = "tty"


class Console:
    """A command, its terminal, and what came of it.

    Args:
        words: Of the command, without ``rig``.
        folder: It is started in.
        env: Additions to the environment.
        streams: Its standard input and output.
        gate: The phase at whose beginning it waits for :meth:`open_gate`.
        program: What Python runs: the witness, or `rig` itself.
        prefix: Put before the interpreter.
        columns: Of the terminal.

    Attributes:
        answers: What the operator types at the next prompts for a mass, in order; the last again
            and again.
        hold: While true, no prompt is answered.
        reading: While false, nothing is read from the terminal.
        notices: What the witness told, in order.
        status: Exit status, negative for a signal; None while it lives.
        stops: Signals that stopped it, as a shell would see.
        asked_ns: When a prompt was on the screen, for each.
    """

    def __init__(
        self,
        words: Sequence[str],
        folder: Path,
        env: Mapping[str, str],
        streams: Streams = Streams(),
        gate: str = "",
        program: Sequence[str] = WITNESS,
        prefix: Sequence[str] = (),
        columns: int = 120,
    ) -> None:
        self.answers: list[str] = ["0"]
        self.hold = False
        self.reading = True
        self.notices: list[dict[str, Any]] = []
        self.status: int | None = None
        self.stops: list[int] = []
        self.asked_ns: list[int] = []
        self.pid = 0
        self._chunks: list[tuple[int, bytes]] = []
        self._answered_at = 0
        self._token = uuid.uuid4().hex
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        path = os.ttyname(slave)
        control, theirs = socket.socketpair()
        self._control = control
        self._notices, notices = os.pipe()
        gate_in, self._gate = os.pipe()
        handed = [theirs.fileno(), notices, gate_in]
        ends: list[int] = []
        self._stdin, stdin = self._stream(streams.stdin, path, 0, ends)
        self._stdout, stdout = self._stream(streams.stdout, path, 1, ends)
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "PYTHONUNBUFFERED": "",
            "OPENBLAS_NUM_THREADS": "1",
            "TERM": "xterm",
            _MARK: self._token,
            "WITNESS": str(notices),
            "WITNESS_GATE": f"{gate}@{gate_in}",
            **env,
        }
        told = {
            "control": theirs.fileno(),
            "tty": path,
            "streams": [stdin, stdout, path],
            "words": [*prefix, sys.executable, *program, *words],
        }
        self._shell = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", _SHELL, json.dumps(told)],
            env=environment,
            cwd=folder,
            pass_fds=[*handed, *ends],
            start_new_session=True,
        )
        theirs.close()
        for descriptor in (notices, gate_in, *ends):
            os.close(descriptor)
        # As long as it is open here, reading the other end does not fail, whoever else has closed
        # it.
        self._slave = slave
        self._pending = {self._notices: b"", control.fileno(): b""}

    def _stream(
        self, kind: str, path: str, number: int, ends: list[int]
    ) -> tuple[int | None, int | str | None]:
        """Return our end of a stream, where it has one, and what the command gets."""
        if kind == "tty":
            return None, path
        if kind == "closed":
            return None, None
        if kind != "pipe":
            return None, kind
        readable, writable = os.pipe()
        ours, theirs = (writable, readable) if number == 0 else (readable, writable)
        ends.append(theirs)
        return ours, theirs

    def pump(self, timeout_s: float = 0.05) -> None:
        """Move whatever has come in within the time, and answer prompts."""
        sources = [self._notices, self._control.fileno()]
        sources += [
            end for end in (self._master if self.reading else None, self._stdout) if end is not None
        ]
        ready, _, _ = select.select([end for end in sources if end >= 0], [], [], timeout_s)
        for end in ready:
            try:
                data = os.read(end, 65536)
            except OSError:
                data = b""
            if not data:
                self._forget(end)
            elif end in self._pending:
                *lines, self._pending[end] = (self._pending[end] + data).split(b"\n")
                for line in lines:
                    self._hear(line.decode(), end == self._notices)
            else:
                self._chunks.append((time.monotonic_ns(), data))
        self._attend()

    def _forget(self, end: int) -> None:
        if end == self._notices:
            os.close(end)
            self._notices = -1
        elif end == self._master:
            self.hang_up()
        elif end == self._stdout:
            self.close_stdout()
        else:
            raise RuntimeError("the shell of the harness has died")

    def _hear(self, line: str, notice: bool) -> None:
        if notice:
            self.notices.append(json.loads(line))
            return
        word, _, number = line.partition(" ")
        if word == "pid":
            self.pid = int(number)
        elif word == "stopped":
            self.stops.append(int(number))
        else:
            self.status = int(number)

    def _attend(self) -> None:
        text = self.text()
        if len(text) > self._answered_at and PROMPT.search(text[self._answered_at :]):
            if len(self.asked_ns) == 0 or self._answered_at > self._asked_from:
                self.asked_ns.append(time.monotonic_ns())
                self._asked_from = self._answered_at or 1
            if (
                self.hold
                or time.monotonic_ns() - self.asked_ns[-1] < _THOUGHT_S * 1e9
                or self.status is not None
            ):
                return
            self._answered_at = len(text)
            answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
            self.type(answer + "\n")

    _asked_from = 0

    def until(self, reached: Callable[[], object], timeout_s: float) -> bool:
        """Go on until something is so; False where it is not so in time."""
        limit = time.monotonic() + timeout_s
        while not reached():
            if time.monotonic() > limit:
                return False
            self.pump(0.005)
        return True

    def pause(self, seconds: float) -> None:
        """Go on for so long."""
        self.until(lambda: False, seconds)

    def at(self, stage: str, phase: str) -> int | None:
        """Return when a phase of a stage first began, ns."""
        for notice in self.notices:
            if notice.get("stage") == stage and notice["phase"] == phase:
                return int(notice["ns"])
        return None

    @property
    def ended(self) -> bool:
        """Whether the command has ended."""
        return self.status is not None

    def text(self, since_ns: int = 0) -> str:
        """Return what came on the terminal and on the standard output, without control
        sequences.
        """
        return _ANSI.sub(
            "",
            b"".join(data for ns, data in self._chunks if ns >= since_ns).decode(errors="replace"),
        )

    def said_ns(self, pattern: str, since_ns: int = 0) -> int | None:
        """Return when words that match had come, ns; None where they have not."""
        data = b""
        for ns, chunk in self._chunks:
            if ns < since_ns:
                continue
            data += chunk
            if re.search(pattern, unwrapped(_ANSI.sub("", data.decode(errors="replace")))):
                return ns
        return None

    def type(self, text: str | bytes) -> None:
        """Type."""
        data = text.encode() if isinstance(text, str) else text
        try:
            os.write(self._master if self._stdin is None else self._stdin, data)
        except OSError:
            # Nobody listens any more; what is on the screen tells.
            return

    def key(self, data: bytes) -> None:
        """Press a key on the terminal, whatever the standard input is."""
        if self._master >= 0:
            os.write(self._master, data)

    def signal(self, number: int) -> int:
        """Send the command a signal; returns when, ns."""
        ns = time.monotonic_ns()
        os.kill(self.pid, number)
        return ns

    def open_gate(self) -> None:
        """Let it go on."""
        os.write(self._gate, b"x")

    def stuff(self) -> None:
        """Stop reading the terminal, and leave no room in it for what the command may write."""
        self.reading = False
        writer = os.open(os.ttyname(self._slave), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(writer, b"." * 256)
        with suppress(BlockingIOError):
            while True:
                os.write(writer, b".")
        os.close(writer)

    def hang_up(self) -> None:
        """Take the terminal away, as a connection that drops."""
        if self._master >= 0:
            os.close(self._master)
            self._master = -1

    def close_stdin(self) -> None:
        """End the pipe that is its standard input."""
        if self._stdin is not None:
            os.close(self._stdin)
            self._stdin = None

    def close_stdout(self) -> None:
        """Stop reading the pipe that is its standard output."""
        if self._stdout is not None:
            os.close(self._stdout)
            self._stdout = None

    def family(self) -> list[int]:
        """Return the processes that were started from here and still live, the shell aside."""
        mark = f"{_MARK}={self._token}".encode()
        found = []
        for entry in os.listdir("/proc"):
            if entry.isdigit() and int(entry) != self._shell.pid:
                try:
                    environment = Path("/proc", entry, "environ").read_bytes()
                except OSError:
                    continue
                if mark in environment.split(b"\0"):
                    found.append(int(entry))
        return found

    def guardians(self) -> list[int]:
        """Return the guardians of the command."""
        words = b"\0rig.wiring.guardian\0"
        return [p for p in self.family() if words in Path(f"/proc/{p}/cmdline").read_bytes()]

    def close(self) -> list[int]:
        """End everything; returns what had to be killed."""
        left = self.family()
        for pid in left:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        self._control.close()
        self._shell.wait(10)
        self.hang_up()
        self.close_stdin()
        self.close_stdout()
        os.close(self._gate)
        os.close(self._slave)
        if self._notices >= 0:
            os.close(self._notices)
        return left
