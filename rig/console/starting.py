"""Starts runs from the console: shows a dry run, then starts a run with unchanged files."""

from __future__ import annotations

import asyncio
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from rig.common.errors import InputError
from rig.common.provenance import sha256_file, utc_now
from rig.common.text import valid
from rig.config.bench import load_bench
from rig.config.configuration import names, resolve

COMMAND: Final = (sys.executable, "-c", "from rig.cli.entry import main; main()")
DRY_RUN_S: Final = 180.0
_SHOWN: Final = 4000  # number of characters of output that are shown of a run that failed to start
_NOT_STARTABLE: Final = frozenset({0, 1})
_KEPT: Final = 20
_LONGEST_NAME: Final = 100


async def output_of(
    command: Sequence[str], timeout_s: float | None = None, keep: bool = False
) -> tuple[int, str]:
    """Run a command, which may outlive this console; return exit status and output.

    Raises TimeoutError (it was killed) or OSError.
    """
    child = await asyncio.create_subprocess_exec(
        *command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=keep,
    )
    try:
        output, _ = await asyncio.wait_for(child.communicate(), timeout_s)
    finally:
        if child.returncode is None and not keep:
            child.kill()
            await child.wait()
    assert child.returncode is not None
    return child.returncode, output.decode(errors="replace")


class StartError(Exception):
    """A run cannot be started; the message states the reason and the remedy."""


@dataclass(frozen=True)
class Wish:
    """Run that a page requests: bench, sequence, operator and options of ``rig run``."""

    bench: str
    sequence: str
    operator: str = ""
    realtime: bool = True
    yes: bool = False
    acceptance: str = ""

    @staticmethod
    def of(message: Mapping[str, Any]) -> Wish:
        """Return the run that the message of a page requests; StartError if a field is wrong."""
        try:
            wish = Wish(**message)
        except TypeError as error:
            raise StartError(f"the request does not describe a run: {error}") from error
        texts = (wish.bench, wish.sequence, wish.operator, wish.acceptance)
        if not all(isinstance(text, str) and len(text) < 500 for text in texts):
            raise StartError("bench, sequence, operator and file of limits must be short texts")
        if not isinstance(wish.realtime, bool) or not isinstance(wish.yes, bool):
            raise StartError("realtime and yes must be true or false")
        if any(text.startswith("-") for text in (wish.sequence, wish.bench, wish.acceptance)):
            raise StartError("the name of a bench or of a file must not begin with a minus")
        return wish

    @property
    def arguments(self) -> list[str]:
        """Arguments that the dry run and the run have in common."""
        limits = ["--acceptance", self.acceptance] if self.acceptance else []
        return ["run", self.sequence, "--bench", self.bench, "--console", *limits]


@dataclass(frozen=True)
class Shown:
    """Dry run whose result was shown to the operator."""

    wish: Wish
    digests: tuple[str, ...]
    real: bool
    name: str


@dataclass
class Starter:
    """Starts runs on the benches of this console."""

    benches: Sequence[str]
    runs: Path = Path("runs")
    command: Sequence[str] = COMMAND
    choices: dict[str, list[str]] = field(init=False)
    _shown: dict[str, Shown] = field(default_factory=dict)
    _children: list[tuple[subprocess.Popen[bytes], Path]] = field(default_factory=list)
    _offs: dict[str, asyncio.Task[dict[str, Any]]] = field(default_factory=dict)
    _resumed: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.choices = {"benches": list(self.benches), "sequences": names("sequences")}

    async def dry_run(self, wish: Wish) -> dict[str, Any]:
        """Run ``rig run --dry-run``; ``shown`` is the key of a start, or None (or a StartError)."""
        if wish.bench not in self.benches:
            raise StartError(
                f"{wish.bench}: this console was started without this bench; "
                "start the console with this bench"
            )
        try:
            bench = load_bench(wish.bench)
            digests = _digests(wish)
        except (InputError, OSError) as error:
            return _refused(str(error))
        yes = ["--yes"] if wish.yes else []
        command = [*self.command, *wish.arguments, "--dry-run", *yes]
        try:
            status, words = await output_of(command, DRY_RUN_S)
        except TimeoutError as error:
            raise StartError(f"the dry run took more than {DRY_RUN_S:g} s") from error
        if status not in _NOT_STARTABLE:
            return _refused(words)
        key = secrets.token_hex(16)
        self._shown[key] = Shown(wish, digests, not bench.value.simulated, bench.value.name)
        for old in list(self._shown)[:-_KEPT]:
            del self._shown[old]
        return {
            "shown": key,
            "words": words,
            "status": status,
            "real": not bench.value.simulated,
            "bench": bench.value.name,
        }

    def start(self, key: str, typed_bench: str) -> Path:
        """Start the run whose dry run was shown, in the folder that is returned.

        A real bench needs its name typed. Raises a StartError if it is wrong, the dry run unknown
        or a file changed.
        """
        shown = self._shown.pop(key, None)
        if shown is None:
            raise StartError("make a dry run first; each dry run permits one start")
        wish = shown.wish
        if shown.real and typed_bench.strip() != shown.name:
            self._shown[key] = shown
            raise StartError(f"type the name of the REAL bench, {shown.name}, to start the run")
        try:
            changed = _digests(wish) != shown.digests
        except (InputError, OSError) as error:
            raise StartError(str(error)) from error
        if changed:
            raise StartError("a file of this run has changed since the dry run; make a new dry run")
        name = Path(wish.sequence).stem
        folder = self.runs / f"{utc_now():%Y%m%dT%H%M%SZ}-{name}"
        arguments = [*wish.arguments, "--out", str(folder)]
        if not shown.real:
            arguments += ["--realtime"] * wish.realtime + ["--yes"] * wish.yes
        if wish.operator.strip():
            arguments += ["--operator", valid(wish.operator).strip()]
        self._spawn(arguments)
        return folder

    def resume(self, about: Mapping[str, Any], typed_bench: str, operator: str = "") -> None:
        """Continue a run that stopped, in its folder, unless it is being continued already.

        A real bench needs its name typed; a StartError if it is wrong.
        """
        if about["real"] and typed_bench.strip() != about["bench"]:
            raise StartError(
                f"type the name of the REAL bench, {about['bench']}, to continue the run"
            )
        folder = str(about["folder"])
        child = self._resumed.get(folder)
        if child is not None and child.poll() is None:
            return
        who = valid(operator).strip()[:_LONGEST_NAME]
        named = ["--operator", who] if who else []
        self._resumed[folder] = self._spawn(["resume", folder, "--console", *named])

    async def off(self, bench: str) -> dict[str, Any]:
        """Make a bench safe with ``rig off``, once: ``words``, and whether it is ``proved`` off."""
        task = self._offs.get(bench)
        if task is None:
            task = self._offs[bench] = asyncio.create_task(self._make_off(bench))
            task.add_done_callback(lambda _: self._offs.pop(bench))
        return await asyncio.shield(task)

    async def _make_off(self, bench: str) -> dict[str, Any]:
        status, words = await output_of([*self.command, "off", "--", bench], keep=True)
        return {"words": words.strip()[-_SHOWN:], "proved": status == 0}

    def failures(self) -> list[str]:
        """Return the last output of started runs that have ended with invalid input or a crash."""
        words = []
        for child, log in list(self._children):
            status = child.poll()
            if status is None:
                continue
            self._children.remove((child, log))
            if status not in (0, 1, 3):
                text = log.read_text(encoding="utf-8", errors="replace")[-_SHOWN:]
                words.append(f"a run ended with status {status}:\n{text}")
            log.unlink(missing_ok=True)
        return words

    def _spawn(self, arguments: list[str]) -> subprocess.Popen[bytes]:
        """Start ``rig`` in its own session, so that the run continues when this console ends."""
        handle, name = tempfile.mkstemp(prefix="loadrig-console-", suffix=".log")
        with open(handle, "wb") as log:
            child = subprocess.Popen(
                [*self.command, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._children.append((child, Path(name)))
        return child


def _digests(wish: Wish) -> tuple[str, ...]:
    """Return the SHA-256 of bench file, sequence file and, if any, file of limits."""
    return (
        sha256_file(resolve(wish.bench, "benches")),
        sha256_file(resolve(wish.sequence, "sequences")),
        *((sha256_file(Path(wish.acceptance)),) if wish.acceptance else ()),
    )


def _refused(words: str) -> dict[str, Any]:
    return {"shown": None, "words": words, "status": 2, "real": False, "bench": ""}
