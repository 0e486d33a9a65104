"""Reads files in a second process, because the libraries of some formats end the process, or ask
for all of its memory, on a damaged file.

One process serves all files of a command: its start takes 0.2 s, the library of MDF 0.4 s more.
It ends with the program that started it. A request is one line of JSON; an answer is one line of
JSON, followed by the values of the arrays that the line announces.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from rig.common.errors import InputError
from rig.sources.table import Array, Table, damaged, undamaged

Answer = tuple[dict[str, Any], list[Array]]
_START = "import sys; sys.path[:] = sys.argv[1:]; from rig.sources.served import serve; serve()"


class ServedTable(Table):
    """A table that the second process reads; InputError if it cannot, or has ended."""

    def __init__(self, path: Path, options: dict[str, Any]) -> None:
        self.path = path
        self._options = options
        opened, _ = self._ask("open")
        self.names = tuple(opened["names"])
        self.units = tuple(opened["units"])
        self.bases = tuple(opened["bases"])
        self.base_names = tuple(opened["base_names"])
        self.counts = {int(k): (factor, offset) for k, factor, offset in opened["counts"]}
        self.remedy = opened["remedy"]

    def _read(self, columns: Sequence[int]) -> list[Array]:
        return self._ask("read", list(columns))[1]

    def stamps(self, base: int) -> Array | None:
        """Return the time stamps of a time base; see :meth:`Table.stamps`."""
        return next(iter(self._ask("stamps", base)[1]), None)

    def _ask(self, verb: str, argument: Any = None) -> Answer:
        request = {"path": str(self.path), "options": self._options, "verb": verb}
        answer, arrays = READER.ask({**request, "argument": argument})
        if "problems" in answer:
            raise InputError(answer["problems"])
        if "damage" in answer:
            raise damaged(self.path, answer["damage"], self.remedy)
        for note in answer["notes"]:
            self.note(note)
        return answer, arrays


class Reader:
    """The second process; it is started by the first request, and again after it has died."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._owner = 0

    def ask(self, request: dict[str, Any]) -> Answer:
        """Return the answer to a request, and its arrays; of a process that dies, the damage."""
        with self._lock:
            if self.process is not None and self.process.poll() is not None:
                self.close()
            if self.process is None or self._owner != os.getpid():
                # A process that was forked off must not share the pipes.
                self._owner = os.getpid()
                self.process = subprocess.Popen(
                    [sys.executable, "-c", _START, *sys.path],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                )
            try:
                return self._exchange(self.process, request)
            except EOFError:
                code = self.process.wait()
                how = signal.Signals(-code).name if code < 0 else f"status {code}"
                self.close()
                return {"damage": f"the library of this format broke down with {how}"}, []
            except BaseException:
                # Half an answer may be in the pipe.
                self.process.kill()
                self.close()
                raise

    def _exchange(self, process: subprocess.Popen[bytes], request: dict[str, Any]) -> Answer:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
        except BrokenPipeError:
            raise EOFError from None
        head = process.stdout.readline()
        if not head.endswith(b"\n"):
            raise EOFError
        answer: dict[str, Any] = json.loads(head)
        arrays = []
        for length in answer.get("lengths", ()):
            values = np.empty(length)
            if process.stdout.readinto(values.view(np.uint8)) < values.nbytes:  # type: ignore[attr-defined]
                raise EOFError
            arrays.append(values)
        return answer, arrays

    def close(self) -> None:
        """End the process."""
        process, self.process = self.process, None
        if process is not None:
            for stream in (process.stdin, process.stdout):
                assert stream is not None
                with suppress(BrokenPipeError):
                    stream.close()
            process.wait()


READER = Reader()
atexit.register(READER.close)


def serve() -> None:
    """Answer requests on standard input until it is closed: the second process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # What a library prints must not get between the answers.
    with os.fdopen(os.dup(1), "wb") as out, open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        opened: dict[str, Table] = {}
        for line in sys.stdin.buffer:
            answer, arrays = _answer(json.loads(line), opened)
            out.write(json.dumps(answer | {"lengths": [len(a) for a in arrays]}).encode() + b"\n")
            for values in arrays:
                out.write(np.ascontiguousarray(values, np.float64).data)
            out.flush()


def _answer(request: dict[str, Any], opened: dict[str, Table]) -> Answer:
    """Return the answer to a request; ``opened`` keeps the table of the last file."""
    from rig.sources.formats import open_here

    verb, argument = request["verb"], request["argument"]
    key = json.dumps([request["path"], request["options"]])
    try:
        if verb == "open" or key not in opened:
            opened.clear()
            opened[key] = open_here(Path(request["path"]), _options(request["options"]))
        table = opened[key]
        answer: dict[str, Any] = {}
        arrays: list[Array] = []
        if verb == "open":
            names = ("names", "units", "bases", "base_names", "remedy")
            answer = {name: getattr(table, name) for name in names}
            answer["counts"] = [(k, *scale) for k, scale in table.counts.items()]
        elif verb == "read":
            arrays = table.read(argument)
        else:
            with undamaged(table.path, table.remedy):
                found = table.stamps(argument)
            arrays = [] if found is None else [found]
        return answer | {"notes": table.notes}, arrays
    except InputError as error:
        return {"problems": error.problems}, []


def _options(given: dict[str, Any]) -> Any:
    if not given:
        return None
    # Imported here, because only bus logging needs it.
    from rig.config.campaign_sections import ReadSection

    return ReadSection(**given)
