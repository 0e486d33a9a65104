"""Two programs on one bench, or on one run folder, in all ordered pairs of commands, on every
transport.

`python -m tests.long.pairs [--times N] [--only FIRST,SECOND,TRANSPORT]`. The second must be refused
with status 4 and the name of the first, and the first must end as it would alone. A bench and a run
folder are two things: `recover` uses a folder and no bench, so that it and a `jog` or `check` do
not meet, and both must be done.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.runs.mcap.reader import read_run

from .benches import TRANSPORTS, Bench, bench_process
from .console import Console, Streams, unwrapped
from .process_checks import BUSY

COMMANDS = ("run", "jog", "check", "resume", "recover")
ON_THE_BENCH = frozenset({"run", "jog", "check", "resume"})
SEQUENCE = """\
sequence: 1
name: pairs
stages:
  - {name: one, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 1.5}], duration_s: 1.2,
     center_deg: 6, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.1}
"""
HELD: Mapping[str, str] = {"check": "connected", "recover": "reading"}
"""Commands that are done at once, and where the harness holds them while the second one tries."""
_BEGINS: Mapping[str, str] = {"run": "prepare", "resume": "prepare", "jog": "connected"}
_LONGEST_S: Mapping[str, float] = {"run": 1.5, "resume": 1.5, "jog": 0.6}
"""How long after that the second one may come."""
_START_S = 60.0
_END_S = 20.0
_REPEATS = 6


_stopping = threading.Event()


class MissedError(Exception):
    """The two did not meet."""


@dataclass
class Stage:
    """A bench with what two commands need, for one transport.

    Attributes:
        bench: The bench.
        file: Its file.
        folder: Everything goes here.
        stopped: A run that was stopped, to resume.
        killed: A run that was killed, to recover.
    """

    bench: Bench
    file: Path
    folder: Path
    stopped: Path | None = None
    killed: Path | None = None

    def words(self, command: str, run: Path) -> list[str]:
        """Return a command line; ``run`` is the run folder that it makes or uses."""
        quick = ["--yes", "--no-first-pass"]
        match command:
            case "run":
                return [
                    "run",
                    str(self.folder / "sequence.yaml"),
                    "--bench",
                    str(self.file),
                    *quick,
                    "--out",
                    str(run),
                ]
            case "jog":
                return ["jog", str(self.file), "--to", "4", "--to", "0", "--speed", "10"]
            case "check":
                return ["check", str(self.file)]
            case _:
                return [command, str(run), *(quick if command == "resume" else [])]

    def make_ready(self) -> None:
        """Make the runs that can be resumed and recovered."""
        self.stopped = self._broken("stopped", signal.SIGTERM)
        self.killed = self._broken("killed", signal.SIGKILL)

    def _broken(self, name: str, number: int) -> Path:
        for attempt in range(_REPEATS):
            self.bench.renew()
            run = self.folder / f"{name}{attempt}"
            console = Console(self.words("run", run), self.folder, self.bench.env)
            try:
                console.until(lambda: console.at("one", "excite") or console.ended, _START_S)  # noqa: B023
                console.pause(0.3)
                if not console.ended:
                    console.signal(number)
                    console.until(lambda: console.ended, _END_S)  # noqa: B023
                    return run
            finally:
                console.close()
        raise SystemExit(f"no run can be {name} on {self.bench.transport}")


def shared(first: str, second: str) -> bool:
    """Whether the two use one thing: the bench, or the folder."""
    return (first in ON_THE_BENCH and second in ON_THE_BENCH) or (
        first in ("run", "resume", "recover") and second in ("resume", "recover")
    )


def folders(stage: Stage, first: str, second: str, number: int, place: Path) -> tuple[Path, Path]:
    """Return the run folders of the two, one and the same where they can meet there."""
    place.mkdir()
    one, two = place / "first", place / "second"
    template = {"resume": stage.stopped, "recover": stage.killed}
    if template.get(first) is not None:
        shutil.copytree(template[first], one)  # type: ignore[arg-type]
    if second in ("resume", "recover"):
        meets = first in ("run", "resume", "recover")
        # Two that meet on the bench as well do so on one folder and on two, in turn.
        if meets and (second == "recover" or first == "recover" or number % 2 == 0):
            return one, one
        shutil.copytree(template[second], two)  # type: ignore[arg-type]
    return one, two


def once(
    stage: Stage, first: str, second: str, number: int, place: Path, dice: random.Random
) -> list[str]:
    """Let two programs meet; returns what is not as it must be.

    Raises:
        MissedError: They did not.
    """
    stage.bench.renew()
    one, two = folders(stage, first, second, number, place)
    held = HELD.get(first, "")
    a = Console(stage.words(first, one), place, stage.bench.env, Streams("closed"), held)
    b = Console(
        stage.words(second, two),
        place,
        stage.bench.env | {"WITNESS_READY": "1"},
        Streams("closed"),
        gate="ready",
    )
    try:
        begins = held or _BEGINS[first]
        _until(a, lambda: any(n["phase"] == begins for n in a.notices) or a.ended, b)
        _until(b, lambda: b.notices or b.ended, a)
        a.pause(dice.uniform(0.0, _LONGEST_S.get(first, 0.2)))
        if a.ended:
            raise MissedError(f"{first} was over: {_last(a)}")
        b.open_gate()
        _until(b, lambda: b.ended, a)
        if a.ended and not held:
            raise MissedError(f"{first} was over: {_last(a)}")
        if held:
            a.open_gate()
        _until(a, lambda: a.ended, b)
        problems = list(_of_the_second(first, second, a, b)) + list(_of_the_first(first, a, one))
        if stage.bench.account().on:
            problems.append("the drive is still energised")
        alone = a.text() + ("" if shared(first, second) else b.text())
        if problems and (stage.bench.account().pauses or BUSY.search(alone)):
            # On a busy computer a run may fail by itself; one that was disturbed shows that again.
            raise MissedError("; ".join(problems))
        return problems
    finally:
        a.close()
        b.close()


def _until(console: Console, reached: Any, other: Console) -> None:
    """Wait for something at one terminal and keep the other one going."""
    limit = time.monotonic() + _START_S
    while not reached():
        if time.monotonic() > limit:
            raise MissedError(f"nothing happens: {_last(console)}")
        console.pump(0.005)
        other.pump(0.0)


def _last(console: Console) -> str:
    return " / ".join(line.strip() for line in console.text().splitlines() if line.strip())[-240:]


def _of_the_second(first: str, second: str, a: Console, b: Console) -> Iterator[str]:
    if not shared(first, second):
        if b.status != 0:
            yield (
                f"{second} ended with {b.status} beside a {first} that shares nothing with it: "
                f"{_last(b)}"
            )
        return
    if b.status != 4:
        yield f"{second} ended with {b.status}, must be refused with 4: {_last(b)}"
    elif not re.search(rf"\b{a.pid}\b", unwrapped(b.text())) or first not in b.text():
        yield f"{second} does not name the holder ({first}, process {a.pid}): {_last(b)}"
    if "Traceback (most recent call last)" in b.text():
        yield f"a traceback of {second}"


def _of_the_first(first: str, a: Console, run: Path) -> Iterator[str]:
    if a.status != 0:
        yield f"{first} was disturbed and ended with {a.status}: {_last(a)}"
        return
    if "Traceback (most recent call last)" in a.text():
        yield f"a traceback of {first}"
    if first in ("run", "resume"):
        record = json.loads((run / "run.json").read_text())
        if record["state"] != "done":
            yield f"{first}: run.json says {record['state']}"
        for part in record["parts"][-1:]:
            log = read_run(run / part["file"])
            if log.damage is not None:
                yield f"{first}: the recording is damaged: {log.damage}"
            wanted = record["stages"][-1]["samples"]
            number = record["segments"][-1]["index"]
            if (found := int((log.samples["segment"] == number).sum())) != wanted:
                yield f"{first}: {found} samples of {wanted}"


@dataclass
class Tally:
    """How the trials went."""

    good: Counter[tuple[str, str]]
    bad: list[str]
    missed: int = 0


def on_transport(transport: str, options: Any) -> Tally:
    """Do all pairs on one transport."""
    tally = Tally(Counter(), [])
    dice = random.Random(f"{transport}{options.seed}")
    wanted = [word for word in options.only.split(",") if word]
    if wanted and any(word in TRANSPORTS for word in wanted) and transport not in wanted:
        return tally
    pair = [word for word in wanted if word in COMMANDS]
    with tempfile.TemporaryDirectory() as name, bench_process(transport) as bench:
        folder = Path(name)
        (folder / "sequence.yaml").write_text(SEQUENCE)
        stage = Stage(bench, bench.write_file(folder), folder)
        stage.make_ready()
        for first in COMMANDS:
            for second in COMMANDS:
                if pair and pair != [first, second][: len(pair)]:
                    continue
                for number in range(0 if _stopping.is_set() else options.times):
                    _trial(stage, first, second, number, dice, tally)
                good = tally.good[first, second]
                print(f"{transport}: {first}, then {second}: {good} of {options.times}", flush=True)
    return tally


def _trial(
    stage: Stage, first: str, second: str, number: int, dice: random.Random, tally: Tally
) -> None:
    words = "never met"
    for attempt in range(_REPEATS):
        place = stage.folder / f"{first}-{second}-{number}-{attempt}"
        try:
            problems = once(stage, first, second, number, place, dice)
        except MissedError as error:
            tally.missed += 1
            words = str(error)
            continue
        finally:
            shutil.rmtree(place, ignore_errors=True)
        if problems:
            break
        tally.good[first, second] += 1
        return
    else:
        problems = [words]
    tally.bad.append(
        f"{stage.bench.transport}: {first}, then {second}, {number}: {'; '.join(problems)}"
    )
    print(f"BAD {tally.bad[-1]}", flush=True)


def main() -> int:
    """Do the pairs; 1 where one is bad."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=20, help="each pair on each transport")
    parser.add_argument(
        "--only", default="", help="a transport, a first and a second command, with commas between"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    began = time.monotonic()
    with ThreadPoolExecutor(len(TRANSPORTS)) as pool:
        futures = [pool.submit(on_transport, transport, options) for transport in TRANSPORTS]
        try:
            tallies = [future.result() for future in futures]
        finally:
            _stopping.set()
    good = sum(sum(tally.good.values()) for tally in tallies)
    bad = [words for tally in tallies for words in tally.bad]
    missed = sum(tally.missed for tally in tallies)
    print(
        f"{good + len(bad)} meetings in {(time.monotonic() - began) / 60:.1f} min; {len(bad)} "
        f"bad; done again, as "
        f"they did not meet or the computer was too busy: {missed}"
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
