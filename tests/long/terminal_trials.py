"""What an operator tries at the terminal; each function is a trial at a desk."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from .console import Console, Streams, unwrapped
from .desk import END_S, START_S, Desk, MissedError, answer, check_screen, tidy
from .process_cases import ASKING, PHASES, SECOND_STAGE, SEQUENCE

JOG_PROMPT = re.compile(r"^Joint angle[^:\n]*: ?$", re.MULTILINE)
PAUSE_PROMPT = re.compile(r"^What now[^:\n]*: ?$", re.MULTILINE)
WEIGHTS = """\
sequence: 1
name: weights
stages:
  - {name: one, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 1.5}], duration_s: 0.8,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.3}
  - {name: two, stage: loaded, weight_kg: 5, tones: [{amplitude_deg: 4, frequency_Hz: 1.5}],
     duration_s: 0.8,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.3}
"""
RUN = "rig run sequence.yaml --bench bench.yaml --out run"
_SLOW_S = 60.0
_GAP_S = 0.25
_WATCHED_S = 1.5


def ordinary(desk: Desk) -> None:
    """Run two stages from beginning to end."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    desk.capture("The first prompt")
    answer(desk)
    desk.wait_for("excite")
    time.sleep(0.3)
    desk.capture("In motion")
    desk.wait_for_prompt(2)
    desk.capture("The second prompt")
    answer(desk)
    check_screen(desk, desk.wait_for_end(), 0)
    desk.capture("At the end")


def type_ahead(desk: Desk) -> None:
    """Type answers before they are asked for: none may count."""
    desk.tmux.command(RUN)
    for _ in range(3):
        desk.tmux.type("0")
        desk.tmux.press("Enter")
        time.sleep(0.2)
    desk.wait_for_prompt(1)
    time.sleep(_WATCHED_S)
    desk.expect(
        not desk.answered("one"), "the first prompt was answered by what was typed before it"
    )
    desk.capture("Typed ahead of the first prompt: it waits")
    if not desk.answered("one"):
        answer(desk)
    desk.wait_for("excite")
    desk.tmux.type("0")
    desk.tmux.press("Enter")
    desk.tmux.type("0")
    desk.tmux.press("Enter")
    if not desk.tmux.until(lambda: desk.reached("between"), END_S):
        raise MissedError(f"there was no second prompt: {desk.tmux.everything()[-400:]}")
    time.sleep(_WATCHED_S)
    desk.capture("Typed ahead of the second prompt, under power: it waits")
    desk.expect(
        not desk.answered("two"), "the second prompt was answered by what was typed under power"
    )
    if desk.status() is None and not desk.answered("two"):
        desk.wait_for_prompt(1)
        answer(desk)
    check_screen(desk, desk.wait_for_end(), 0)


def weights(desk: Desk) -> None:
    """Type masses as people write them, and a wrong one."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for_prompt(2)
    desk.bench.hang(5.0)
    answer(desk, "50")
    time.sleep(0.5)
    desk.capture("A mass that is not the planned one")
    desk.expect(not desk.answered("two"), "50 kg was taken for 5 kg")
    desk.wait_for_prompt(3)
    answer(desk, "5,01 kg")
    time.sleep(0.5)
    desk.capture("A mass with a comma and a unit")
    said = desk.tmux.everything()
    read = "is not a mass" not in said and said.count("Mass on the lever") == 3
    desk.expect(read, "'5,01 kg' is not read as a mass")
    if desk.status() is None and not desk.answered("two"):
        desk.wait_for_prompt(1)
        answer(desk, "5")
    status = desk.wait_for_end()
    check_screen(desk, status, 0)
    if status == 0:
        record = json.loads((desk.folder / "run" / "run.json").read_text())
        mass = record["stages"][1]["confirmed_kg"]
        desk.expect(mass == 5.01, f"5.01 kg was typed, and run.json holds {mass}")


def resized(desk: Desk) -> None:
    """Change the size of the terminal again and again while it moves."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for("first pass")
    for columns in (60, 100, 48, 120, 80, 64):
        desk.tmux.resize(columns)
        time.sleep(0.15)
    desk.capture("In motion, after six changes of size, now 64 columns")
    desk.wait_for_prompt(2)
    desk.tmux.resize(70)
    time.sleep(0.3)
    desk.capture("The prompt after another one, now 70 columns")
    answer(desk)
    desk.wait_for_end()
    desk.tmux.resize(80)
    text = desk.tmux.everything()
    check_screen(desk, desk.status(), 0)
    desk.expect(
        text.count("Mass on the lever") == 2,
        "prompts are on the screen more often than they were asked",
    )


def narrow(desk: Desk) -> None:
    """Run two stages on 40 columns."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    desk.capture("40 columns, the first prompt")
    answer(desk)
    desk.wait_for("excite")
    time.sleep(0.3)
    desk.capture("40 columns, in motion")
    screen = desk.tmux.screen()
    desk.problems += tidy(desk.tmux.everything(), 40)
    desk.expect(
        len(re.findall(r"\d+ ?/ ?\d+ s", screen)) <= 1,
        f"more than one line of progress: {screen[-300:]}",
    )
    desk.wait_for_prompt(2)
    answer(desk)
    check_screen(desk, desk.wait_for_end(), 0)
    desk.capture("40 columns, at the end")


def narrow_stop(desk: Desk) -> None:
    """Press Ctrl-C on 40 columns."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for("excite")
    desk.tmux.press("C-c")
    check_screen(desk, desk.wait_for_end(), 3)
    desk.capture("40 columns, stopped by Ctrl-C")


def slow(desk: Desk) -> None:
    """Run two stages over a line of 9600 baud."""
    desk.tmux.command(RUN.replace("rig", "slow", 1))
    desk.wait_for_prompt(timeout_s=_SLOW_S)
    answer(desk)
    desk.wait_for("excite")
    time.sleep(0.3)
    desk.capture("9600 baud, in motion")
    desk.wait_for_prompt(2, timeout_s=_SLOW_S)
    answer(desk)
    check_screen(desk, desk.wait_for_end(_SLOW_S), 0)
    desk.capture("9600 baud, at the end")


def suspended(desk: Desk) -> None:
    """Press Ctrl-Z in motion: the run ends as by Ctrl-C."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for("excite")
    ns = time.monotonic_ns()
    desk.tmux.press("C-z")
    status = desk.wait_for_end()
    off_s = desk.bench.account().off_after_s(ns)
    desk.expect(off_s is not None and off_s < 0.5, f"off {off_s} s after Ctrl-Z")
    check_screen(desk, status, 3)
    desk.capture("Ctrl-Z in motion")


def quit_key(desk: Desk) -> None:
    """Press Ctrl-backslash in motion: power off without the ramp."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for("excite")
    ns = time.monotonic_ns()
    desk.tmux.press("C-\\")
    status = desk.wait_for_end()
    off_s = desk.bench.account().off_after_s(ns)
    desk.expect(off_s is not None and off_s < 0.4, f"off {off_s} s after Ctrl-backslash")
    check_screen(desk, status, 3)
    desk.capture("Ctrl-backslash in motion")


def flow_stopped(desk: Desk) -> None:
    """Press Ctrl-S in motion and Ctrl-Q later: nothing changes."""
    desk.tmux.command(RUN)
    desk.wait_for_prompt()
    answer(desk)
    desk.wait_for("excite")
    desk.tmux.press("C-s")
    if not desk.tmux.until(lambda: desk.reached("between"), END_S):
        desk.problems.append("the run does not go on after Ctrl-S")
    time.sleep(0.5)
    desk.expect(not desk.bench.account().on, "the drive is on at the second prompt")
    desk.capture("Ctrl-S in motion: the screen stands, the run has gone on to the second prompt")
    desk.tmux.press("C-q")
    desk.wait_for_prompt(2)
    desk.capture("Ctrl-Q: the second prompt")
    answer(desk)
    check_screen(desk, desk.wait_for_end(), 0)


def second_program(desk: Desk) -> None:
    """Start a jog while a run waits at its prompt."""
    words = ["run", "sequence.yaml", "--bench", "bench.yaml", "--out", "first"]
    first = Console(words, desk.folder, desk.bench.env, Streams())
    first.hold = True
    try:
        first.until(lambda: first.asked_ns or first.ended, START_S)
        desk.tmux.command("rig jog bench.yaml --to 10")
        status = desk.wait_for_end(START_S)
        desk.capture("A second program on a bench that a run holds")
        check_screen(desk, status, 4, verdict=False)
        desk.expect(
            str(first.pid) in desk.tmux.everything(),
            "it does not name the process that holds the bench",
        )
        account = desk.bench.account()
        desk.expect(not any(on for _, on in account.powered), "it has energised the drive")
        first.hold = False
        first.until(lambda: first.ended, END_S)
        desk.expect(first.status == 0, f"the first ended with {first.status}")
    finally:
        first.close()


def interrupted(phase: str, count: int) -> Callable[[Desk], None]:
    """Return what presses Ctrl-C so often in a phase or at a prompt of a run."""

    def tried(desk: Desk) -> None:
        dice = random.Random(f"{phase}{count}")
        stage, name, after_s = PHASES[phase]
        gate = f"GATE={stage}/{name} " if not after_s else ""
        extra = " --no-first-pass" if phase == "approach" else ""
        desk.tmux.type(f"{gate}go {RUN}{extra}")
        desk.tmux.press("Enter")
        desk.wait_for_prompt()
        if phase != "prompt":
            answer(desk)
        if phase == "between":
            desk.wait_for_prompt(2)
        elif phase != "prompt":
            desk.wait_for(phase)
        ns = time.monotonic_ns()
        for press in range(count):
            desk.tmux.press("C-c")
            if not press and not after_s:
                desk.open_gate()
            if press + 1 < count:
                time.sleep(dice.uniform(0.0, _GAP_S))
        status = desk.wait_for_end()
        check_screen(desk, status, 3)
        _check_stopped(desk, phase, ns)
        if (phase, count) in (("excite", 1), ("excite", 5), ("prompt", 1), ("between", 3)):
            desk.capture(f"Ctrl-C, {count} times, in phase {phase}")

    return tried


def _check_stopped(desk: Desk, phase: str, ns: int) -> None:
    """Check that a stop left everything behind that it should."""
    account = desk.bench.account()
    off_s = account.off_after_s(ns)
    desk.expect(off_s is not None and off_s < 0.5, f"off {off_s} s after the first Ctrl-C")
    if phase in ASKING:
        desk.expect(
            not account.ever_on(ns, time.monotonic_ns()),
            "it was energised after Ctrl-C at the prompt",
        )
    run = desk.folder / "run"
    desk.expect((run / "run.html").exists(), "there is no run.html")
    record = json.loads((run / "run.json").read_text())
    desk.expect(record["state"] == "stopped", f"run.json says {record['state']}")
    desk.expect(
        record["de_energised"] is True, f"run.json says de_energised {record['de_energised']}"
    )
    desk.expect(
        "read back" in unwrapped(desk.tmux.everything()),
        "it does not say that the state was read back",
    )
    desk.expect(
        re.search(r"^one +unloaded", desk.tmux.everything(), re.MULTILINE),
        "the table of stages is missing",
    )


def jog_interrupted(count: int) -> Callable[[Desk], None]:
    """Return what presses Ctrl-C so often at the prompt of a jog, and then types an angle."""

    def tried(desk: Desk) -> None:
        desk.tmux.command("rig jog bench.yaml")
        if not desk.tmux.until(lambda: JOG_PROMPT.search(desk.tmux.screen()), START_S):
            raise MissedError(f"no prompt of the jog: {desk.tmux.screen()}")
        ns = time.monotonic_ns()
        for _ in range(count):
            desk.tmux.press("C-c")
            time.sleep(0.05)
        time.sleep(0.3)
        if count == 1:
            desk.capture("Ctrl-C at the prompt of a jog")
        desk.tmux.type("5")
        desk.tmux.press("Enter")
        desk.wait_for_end()
        desk.expect(not desk.power_since_s(ns), "it was energised after Ctrl-C at the prompt")
        check_screen(desk, desk.status(), 0, 3, verdict=False)

    return tried


def pause_interrupted(count: int) -> Callable[[Desk], None]:
    """Return what presses Ctrl-C so often at the prompt of a pause."""

    def tried(desk: Desk) -> None:
        desk.tmux.command(RUN)
        desk.wait_for_prompt()
        answer(desk)
        desk.wait_for("first pass")
        for pid in processes(desk):
            os.kill(pid, signal.SIGUSR1)
        if not desk.tmux.until(lambda: PAUSE_PROMPT.search(desk.tmux.screen()), END_S):
            raise MissedError(f"no prompt of a pause: {desk.tmux.screen()}")
        if count == 1:
            desk.capture("Paused between two stages")
        ns = time.monotonic_ns()
        for _ in range(count):
            desk.tmux.press("C-c")
            time.sleep(0.05)
        check_screen(desk, desk.wait_for_end(), 3)
        desk.expect(not desk.power_since_s(ns), "it was energised after Ctrl-C at the prompt")

    return tried


def processes(desk: Desk) -> list[int]:
    """Return the processes of runs that were started in this folder; the guardian is none."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                words = Path("/proc", entry, "cmdline").read_bytes().split(b"\0")
                here = Path("/proc", entry, "cwd").resolve() == desk.folder.resolve()
            except OSError:
                continue
            if here and b"tests.long.witness" in words:
                found.append(int(entry))
    return found


Trial = Callable[[Desk], None]


def trials() -> Mapping[str, tuple[Trial, int, str]]:
    """Return everything that is tried: name to what it is, the columns of its terminal, and its
    sequence.
    """
    both = SEQUENCE + SECOND_STAGE
    found: dict[str, tuple[Trial, int, str]] = {
        "ordinary": (ordinary, 80, both),
        "type-ahead": (type_ahead, 80, both),
        "weights": (weights, 80, WEIGHTS),
        "resize": (resized, 80, both),
        "40 columns": (narrow, 40, both),
        "40 columns, Ctrl-C": (narrow_stop, 40, both),
        "9600 baud": (slow, 80, both),
        "Ctrl-Z": (suspended, 80, both),
        "Ctrl-backslash": (quit_key, 80, both),
        "Ctrl-S": (flow_stopped, 80, both),
        "second program": (second_program, 80, both),
    }
    for count in range(1, 6):
        for phase in PHASES:
            found[f"Ctrl-C x{count} {phase}"] = (interrupted(phase, count), 80, both)
        found[f"Ctrl-C x{count} jog prompt"] = (jog_interrupted(count), 80, both)
        found[f"Ctrl-C x{count} pause prompt"] = (pause_interrupted(count), 80, both)
    return found
