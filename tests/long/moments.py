"""A run is killed, suspended, sent Ctrl-Z, loses its terminal's reader, its adapter or its
guardian, or is suspended together with its guardian, at random moments.

`python -m tests.long.moments [--moments N] [--jobs N] [--kinds KIND,...]`. The drive of the serial
bench has no watchdog, so that power must be gone within 0.5 s of the moment from which the control
loop cannot run: SIGSTOP at once; SIGTSTP ends the run as Ctrl-C does. A terminal that is stalled
(Ctrl-S, or one that nobody reads and that is full) changes nothing: the run is done, the drive is
never under power without being spoken to for longer than that, and off within that time of the end
of motion. An adapter that is out for 2 s must leave the drive off 1 s after it is back, by the
guardian, and a guardian that is suspended within 0.65 s, by the run. Where both are suspended
nobody is left: the operator uses `rig off` 1 s later, which has 4 s.

A run that is killed must leave the drive off, by the guardian of the serial bench and by the
watchdog of the drive over slcan, and a recording that ends no more than 0.2 s earlier. Over slcan
every third one is resumed: it must begin at the first unfinished stage and end with all done.
"""

import argparse
import os
import queue
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from drivers.clock import NS
from rig.common.errors import InputError
from rig.runs.mcap.reader import read_run
from rig.runs.recover import recover
from rig.runs.run_file import read_record
from rig.wiring.guardian import REPORT_FILE

from .benches import Account, Bench, bench_process
from .console import RIG, START_KEY, STOP_KEY, Console, rig_off
from .process_cases import ANSWER_S, BACK_S, GUARD_S, LEFT_S, LOG_GAP_S, OUT_S, RIG_OFF_S
from .process_checks import BUSY, MissedError, recorded_until_ns, verified

OFF_S = 0.5
LATEST_S, LATEST_OF_TWO_S = 1.9, 3.8
"""From the enabling of the drive; a run of one stage, and one of two, take about as long."""
EARLY_SHARE, EARLY_S = 0.15, 1.0
"""Share of the moments that come so long after its preparation began instead, most of them before
it has power.
"""
_STAGE = """\
  - {name: %s, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 1.5}], duration_s: 1.0,
     center_deg: 6, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.1}
"""
SEQUENCE = "sequence: 1\nname: moments\nstages:\n" + _STAGE % "one"
ADAPTER, GUARDIAN, BOTH = "adapter out 2 s", "guardian stopped", "both stopped"
KILLED, KILLED_CAN = "killed", "killed on CAN"
SILENCES = ("Ctrl-S", "terminal full")
KINDS = (KILLED, KILLED_CAN, "SIGSTOP", "SIGTSTP", *SILENCES, ADAPTER, GUARDIAN, BOTH)
LIMIT_S = {
    KILLED: GUARD_S,
    KILLED_CAN: 0.2,
    ADAPTER: OUT_S + BACK_S,
    GUARDIAN: ANSWER_S,
    BOTH: LEFT_S + RIG_OFF_S,
}
"""From what happened to off; :data:`OFF_S` for every other kind. The drive's heartbeat watch on CAN
is 0.1 s, a heartbeat up to 25 ms old, the ramp 30 ms and settling 20 ms.
"""
_START_S = 60.0
_END_S = 15.0
_WATCHED_S = 1.0
_FAILURES = 12
_RESUME_EVERY, _ATTEMPTS = 3, 8


@dataclass(frozen=True)
class Moment:
    """What came of one moment.

    Attributes:
        kind: What happened.
        after_s: When, s after the preparation of the drive began.
        phase: In what phase of the run.
        powered: Whether the drive was under power.
        off_s: When it no longer was, s; for a stalled terminal the longest it was under power
            without being spoken to.
        problems: What is not as it must be.
    """

    kind: str
    after_s: float
    phase: str
    powered: bool
    off_s: float | None
    problems: tuple[str, ...]


def once(bench: Bench, folder: Path, kind: str, base: str, after_s: float) -> tuple[Moment, bool]:
    """Run, and let it happen at a moment after the beginning of a phase."""
    bench.renew()
    fast = {"cycle_Hz": 250, "sample_age_ms": 90} if kind == KILLED_CAN else {}
    file = bench.write_file(folder, **fast)
    stages = SEQUENCE + (_STAGE % "two" if kind == KILLED_CAN else "")
    (folder / "sequence.yaml").write_text(stages)
    words = ["run", "sequence.yaml", "--bench", str(file), "--yes", "--no-first-pass"]
    words += ["--out", "run"]
    console = Console(words, folder, bench.env)
    try:
        console.until(lambda: console.at("one", base) or console.ended, _START_S)
        began = console.at("one", base)
        if began is not None:
            console.pause(max(0.0, after_s - (time.monotonic_ns() - began) / NS))
        if began is None or console.ended:
            raise MissedError(console.text()[-300:])
        ns = _happen(bench, console, kind)
        phase = console.notices[-1]["phase"]
        account, problems = _see(bench, console, kind, ns, file)
        problems += _broken(console, account, kind, ns)
        silence = kind in SILENCES
        off_s = _longest_silence_s(account) if silence else account.off_after_s(ns)
        if off_s is None or off_s > LIMIT_S.get(kind, OFF_S):
            problems.append(
                f"power without a running loop for {'ever' if off_s is None else f'{off_s:.3f} s'}"
            )
        # A trip by what the joint does shows that cycles were late; nothing that happens here moves
        # it.
        busy = (
            any(ns < when < ns + NS for when, _ in account.pauses) or "tripped: " in console.text()
        )
        return Moment(kind, after_s, phase, account.on_at(ns), off_s, tuple(problems)), busy
    except ProcessLookupError as error:
        raise MissedError("the run had ended before the signal came") from error
    finally:
        console.close()


def _happen(bench: Bench, console: Console, kind: str) -> int:
    ns = time.monotonic_ns()
    if kind == ADAPTER:
        return bench.unplug()
    if kind in (GUARDIAN, BOTH):
        guardians = console.guardians()
        if not guardians:
            raise MissedError("the drive had no guardian yet")
        for pid in guardians:
            os.kill(pid, signal.SIGSTOP)
        return ns if kind == GUARDIAN else console.signal(signal.SIGSTOP)
    if kind in (KILLED, KILLED_CAN):
        return console.signal(signal.SIGKILL)
    if kind in ("SIGSTOP", "SIGTSTP"):
        return console.signal(getattr(signal, kind))
    if kind == "Ctrl-S":
        console.key(STOP_KEY)
    else:
        console.stuff()
    return ns


def _see(
    bench: Bench, console: Console, kind: str, ns: int, file: Path
) -> tuple[Account, list[str]]:
    """Wait for what must come."""
    problems: list[str] = []
    if kind in (KILLED, KILLED_CAN):
        return _killed(bench, console, kind, ns, file.parent / "run")
    if kind in (ADAPTER, GUARDIAN, BOTH):
        return _left_to_others(bench, console, kind, ns, file)
    if kind == "SIGSTOP":
        console.pause(_WATCHED_S)
        account = bench.account()
        console.signal(signal.SIGCONT)
        console.until(lambda: console.ended, _END_S)
        return account, problems
    if kind == "SIGTSTP":
        console.until(lambda: console.ended or console.stops, _END_S)
        console.pause(_WATCHED_S if console.stops else 0.0)
        return bench.account(), problems
    limit = time.monotonic() + 6.0
    while bench.account().on or time.monotonic_ns() - ns < NS:
        if time.monotonic() > limit:
            problems.append("the drive is on 6 s later")
            break
        console.pause(0.1)
    account = bench.account()
    console.reading = True
    console.key(START_KEY)
    console.until(lambda: console.ended, _END_S)
    return account, problems


def _left_to_others(
    bench: Bench, console: Console, kind: str, ns: int, file: Path
) -> tuple[Account, list[str]]:
    """See what comes of a lost adapter, and of a guardian that is suspended."""
    problems: list[str] = []
    powered = bench.account().on_at(ns)
    if kind == ADAPTER:
        console.pause(OUT_S - (time.monotonic_ns() - ns) / NS)
        bench.plug()
    if kind == BOTH:
        console.pause(LEFT_S)
        if problem := rig_off(file, bench.env):
            problems.append(problem)
    # A guardian that hangs while it starts, before there is power, is waited for.
    if not console.until(lambda: console.ended, 2.0 * _END_S):
        problems.append("the run did not end")
    report = file.parent / "run" / REPORT_FILE
    if kind == ADAPTER and powered:
        console.until(lambda: verified(report), _WATCHED_S)
        if not verified(report) and bench.account().off_after_s(ns) not in (None, 0.0):
            problems.append("the guardian has not written that it took the power off")
    return bench.account(), problems


def _killed(
    bench: Bench, console: Console, kind: str, ns: int, run: Path
) -> tuple[Account, list[str]]:
    """See what comes of a killed run: the drive, the guardian's report, the recording; resume."""
    console.pause(1.5 if kind == KILLED else 0.5)
    account = bench.account()
    problems = []
    if abs(account.speed) > 1e-3:
        problems.append(f"the joint turns at {account.speed:.3g} rad/s")
    if kind == KILLED and account.on_at(ns) and not verified(run / REPORT_FILE):
        problems.append("the guardian has not written that it took the power off")
    lost_s = _lost_s(run, [when for when in account.heard_ns if when <= ns])
    if lost_s > LOG_GAP_S:
        problems.append(f"the recording ends {lost_s:.3f} s early")
    if kind == KILLED_CAN and int(run.parent.name) % _RESUME_EVERY == 0:
        problems += _resumed(bench, run)
    return account, problems


def _lost_s(run: Path, cycles_ns: list[int]) -> float:
    """Recover the recording."""
    try:
        recover(run)
    except InputError:
        return 0.0
    if not cycles_ns:
        return 0.0
    end_ns = recorded_until_ns(read_run(run / "recording.mcap")) or cycles_ns[0]
    unrecorded = [end_ns, *(when for when in cycles_ns if when > end_ns)]
    pause_ns = max((later - earlier for earlier, later in pairwise(unrecorded)), default=0)
    return (cycles_ns[-1] - end_ns - pause_ns) / NS


def _resume(bench: Bench, run: Path, more: list[str]) -> tuple[int | None, str]:
    words = ["resume", str(run), "--yes", "--no-first-pass", *more]
    console = Console(words, run.parent, bench.env, program=RIG)
    try:
        console.until(lambda: console.ended, _START_S)
        return console.status, console.text()
    finally:
        console.close()


def _resumed(bench: Bench, run: Path) -> list[str]:
    """Go on with a killed run on the bench as it was left."""
    said = ""
    for attempt in range(_ATTEMPTS):
        try:
            before = read_record(run)
        except InputError:
            return []
        wanted = [stage.name for stage in before.stages if stage.state != "done"]
        if not wanted:
            return []
        status, said = _resume(bench, run, ["--reset-fault"] * (attempt > 0))
        after = read_record(run)
        again = [
            after.stages[s.stage_index].name for s in after.segments if s.part == len(after.parts)
        ]
        if again != wanted[: len(again)]:
            return [f"resumed, it did {again} instead of {wanted}"]
        if status == 0 and again == wanted:
            return []
        if not BUSY.search(said):
            break
    return [f"resumed, it was not finished: {said[-300:].strip()}"]


def _broken(console: Console, account: Account, kind: str, ns: int) -> list[str]:
    """Return what is wrong with how it ended."""
    problems = []
    right = {
        "SIGSTOP": (0, 4),
        "SIGTSTP": (3,),
        ADAPTER: (0, 4),
        GUARDIAN: (0, 4),
        **dict.fromkeys((BOTH, KILLED, KILLED_CAN), (-9,)),
    }.get(kind, (0,))
    over = any(
        notice["phase"] == "between stages" and notice["ns"] <= ns for notice in console.notices
    )
    # A run that is over, its drive off, may be suspended as any program.
    suspended = over and kind == "SIGTSTP" and bool(console.stops) and not account.on
    if console.status not in right and not (over and console.status == 0) and not suspended:
        last = " / ".join(console.text().split("\n"))[-200:].strip()
        problems.append(
            f"exit status {console.status}, must be {' or '.join(map(str, right))}: {last}"
        )
    if "Traceback (most recent call last)" in console.text():
        problems.append("a traceback")
    if kind == "SIGTSTP" and console.stops and not suspended:
        problems.append("it was stopped, and stood")
    return problems


def _longest_silence_s(account: Account) -> float:
    """Return the longest time under power in which the drive was not spoken to, s."""
    longest = 0.0
    ends = [
        *(when for when, _ in account.powered),
        account.powered[-1][0] + (10 * NS if account.on else 0),
    ]
    for (began, on), end in zip(account.powered, ends[1:], strict=True):
        if on:
            times = [began, *(heard for heard in account.heard_ns if began < heard < end), end]
            longest = max(longest, *((later - earlier) / NS for earlier, later in pairwise(times)))
    return longest


@dataclass
class Tally:
    """What has been done, and what did not count.

    Attributes:
        done: The moments.
        missed: How many runs were over or failed by themselves before the moment.
        busy: How many moments were bad on a computer too busy for them, and were done again.
    """

    done: list[Moment]
    missed: int = 0
    busy: int = 0


Plan = tuple[str, str, float]


def draw(dice: random.Random, kind: str) -> Plan:
    """Return a moment at random: what happens, after the beginning of which phase, and how long
    after, s.
    """
    if dice.random() < EARLY_SHARE:
        return kind, "prepare", dice.uniform(0.0, EARLY_S)
    latest_s = LATEST_OF_TWO_S if kind == KILLED_CAN else LATEST_S
    return kind, "enable", dice.uniform(0.0, latest_s)


def worker(number: int, todo: queue.Queue[Plan], tally: Tally) -> None:
    """Do moments on a bench of one's own until none is left."""
    dice = random.Random(number)
    benches: dict[str, Bench] = {}
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        count = 0
        while True:
            try:
                plan = todo.get_nowait()
            except queue.Empty:
                return
            for _ in range(_FAILURES):
                folder = Path(name) / f"{count}"
                folder.mkdir()
                count += 1
                try:
                    transport = "slcan" if plan[0] == KILLED_CAN else "serial"
                    if transport not in benches:
                        benches[transport] = stack.enter_context(bench_process(transport))
                    bench = benches[transport]
                    moment, busy = once(bench, folder, *plan)
                except MissedError:
                    tally.missed += 1
                    plan = draw(dice, plan[0])
                    continue
                if not busy or not moment.problems:
                    tally.done.append(moment)
                    break
                tally.busy += 1
            else:
                tally.done.append(
                    Moment(plan[0], plan[2], "?", False, None, ("it never came to it",))
                )


def distribution(moments: Sequence[Moment]) -> Iterator[str]:
    """Yield the figures of each kind in words."""
    for kind in KINDS:
        mine = [moment for moment in moments if moment.kind == kind]
        if not mine:
            continue
        powered = sorted(m.off_s for m in mine if m.powered and m.off_s is not None)
        what = "longest without a word under power" if kind in SILENCES else "off after"
        shares = ""
        if powered:
            at95 = powered[min(len(powered) - 1, round(0.95 * len(powered)))]
            shares = (
                f"; {what} {powered[0]:.3f} to {powered[-1]:.3f} s, median "
                f"{median(powered):.3f}, 95 % {at95:.3f}"
            )
            tenths = [sum(0.1 * n <= off < 0.1 * (n + 1) for off in powered) for n in range(5)]
            beyond = len(powered) - sum(tenths)
            shares += f"; by tenths of a second {' '.join(map(str, tenths))}, beyond {beyond}"
        bad = sum(bool(moment.problems) for moment in mine)
        yield (
            f"{kind}: {len(mine)} moments, {sum(m.powered for m in mine)} under power{shares}; "
            f"{bad} bad"
        )


def main() -> int:
    """Do the moments, print the distribution; 1 where one is bad."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--moments", type=int, default=200, help="of each kind; the stalled terminal is one kind"
    )
    parser.add_argument("--jobs", type=int, default=3, help="benches side by side")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    dice = random.Random(options.seed)
    todo: queue.Queue[Plan] = queue.Queue()
    plans = []
    for kind in options.kinds.split(","):
        count = options.moments // 2 if kind in SILENCES else options.moments
        plans += [draw(dice, kind) for _ in range(count)]
    dice.shuffle(plans)
    for plan in plans:
        todo.put(plan)
    tally = Tally([])
    began = time.monotonic()
    threads = [threading.Thread(target=worker, args=(n, todo, tally)) for n in range(options.jobs)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    finally:
        todo.queue.clear()
    for moment in tally.done:
        if moment.problems:
            print(
                f"BAD {moment.kind} {moment.after_s:.3f} s, {moment.phase}: "
                f"{'; '.join(moment.problems)}"
            )
    print("\n".join(distribution(tally.done)))
    bad = sum(bool(moment.problems) for moment in tally.done)
    print(
        f"{len(tally.done)} of {len(plans)} moments in {(time.monotonic() - began) / 60:.1f} min; "
        f"{bad} bad; "
        f"done again: {tally.missed} whose run ended before, {tally.busy} on a computer too busy"
    )
    return 1 if bad or len(tally.done) < len(plans) else 0


if __name__ == "__main__":
    sys.exit(main())
