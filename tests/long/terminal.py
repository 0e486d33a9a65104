"""Trials of the operator's screen in tmux: typing ahead, Ctrl-C, resizing, narrow or slow terminal.

`python -m tests.long.terminal [--only WORDS] [--jobs N]` uses the serial bench unless `--transport`
names another. A run of all trials writes a selection of screens to out/terminal.md. The command
needs tmux.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.clock import NS

from .benches import TRANSPORTS, Bench, bench_process
from .console import unwrapped
from .desk import MissedError, sit_down
from .process_checks import BUSY
from .terminal_trials import processes, trials
from .tmux import HINT, available

PAGE = Path("out/terminal.md")
_REPEATS = 4


@dataclass(frozen=True)
class Result:
    """How a trial went: what is not as it must be or could be nicer, the screens, and how often it
    was repeated.
    """

    problems: tuple[str, ...]
    remarks: tuple[str, ...]
    captures: Mapping[str, str]
    repeats: int


def trial(name: str, bench: Bench, folder: Path) -> Result:
    """Do a trial, again where the computer was too busy for it."""
    do, columns, sequence = trials()[name]
    problems: list[str] = ["never done"]
    captures: Mapping[str, str] = {}
    for attempt in range(_REPEATS):
        place = folder / f"{re.sub('[^A-Za-z0-9]', '_', name)}{attempt}"
        place.mkdir()
        desk = sit_down(bench, place, columns, sequence)
        began = time.monotonic_ns()
        with desk.tmux:
            try:
                do(desk)
                problems = desk.problems
            except MissedError as error:
                problems = [*desk.problems, f"it did not come to it: {error}"]
            busy = BUSY.search(unwrapped(desk.tmux.everything())) or any(
                when > began + NS for when, _ in bench.account().pauses
            )
        captures = desk.captures
        for pid in processes(desk):
            os.kill(pid, signal.SIGKILL)
        if not problems or not busy:
            break
    return Result(tuple(dict.fromkeys(problems)), tuple(desk.remarks), captures, attempt)


def worker(transport: str, todo: queue.Queue[str], results: dict[str, Result]) -> None:
    """Do trials on a bench of one's own until none is left."""
    with tempfile.TemporaryDirectory() as name, bench_process(transport) as bench:
        while True:
            try:
                what = todo.get_nowait()
            except queue.Empty:
                return
            result = results[what] = trial(what, bench, Path(name))
            again = f" ({result.repeats} repeats)" if result.repeats else ""
            print(f"{what}: {'BAD' if result.problems else 'good'}{again}", flush=True)
            for problem in result.problems:
                print(f"    {problem}", flush=True)


def main() -> int:
    """Try everything; 1 where something is not as it must be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="what the name of a trial must hold")
    parser.add_argument("--transport", choices=TRANSPORTS, default="serial")
    parser.add_argument("--jobs", type=int, default=3, help="terminals side by side")
    options = parser.parse_args()
    if not available():
        print(HINT)
        return 2
    names = [name for name in trials() if options.only in name]
    todo: queue.Queue[str] = queue.Queue()
    for name in names:
        todo.put(name)
    results: dict[str, Result] = {}
    began = time.monotonic()
    jobs = min(options.jobs, len(names))
    threads = [
        threading.Thread(target=worker, args=(options.transport, todo, results))
        for _ in range(jobs)
    ]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    finally:
        todo.queue.clear()
    bad = sum(bool(result.problems) for result in results.values())
    again = sum(result.repeats for result in results.values())
    words = (
        f"{len(results)} of {len(names)} trials in {(time.monotonic() - began) / 60:.1f} min, "
        f"{bad} bad; done again on "
        f"a computer too busy: {again}"
    )
    print(words)
    for remark in sorted({remark for result in results.values() for remark in result.remarks}):
        print(f"remark: {remark}")
    lines = page(names, results)
    if options.only:
        print("\n".join(lines))
    else:
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text("\n".join([f"{words}.", "", *lines]), encoding="utf-8")
    return 1 if bad or len(results) < len(names) else 0


def page(names: list[str], results: Mapping[str, Result]) -> list[str]:
    """Return the captured screens as lines of the page."""
    lines = []
    for name in names:
        for title, screen in results[name].captures.items() if name in results else ():
            shown = re.sub(r"/dev/pts/\d+", "/dev/pts/N", screen)
            lines += [f"## {title}", "", "```text", *shown.splitlines(), "```", ""]
    return lines


if __name__ == "__main__":
    sys.exit(main())
