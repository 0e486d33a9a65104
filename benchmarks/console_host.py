"""The process whose runs ``benchmarks/console.py`` stops: it runs a sequence many times, and prints
one line of JSON for each event.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.common.sample import Phase, Sample
from rig.common.timing import Histogram
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Sequence
from rig.control.operator import AutomaticOperator
from rig.control.remote import RunProgress, observed, reachable
from rig.control.session import Inputs, execute
from rig.planning import plan as planning
from rig.planning.limits import Limits
from rig.planning.plan import make_plan
from rig.runs.run import create_folder
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring import teardown
from rig.wiring.connect import connect

SEQUENCE = """\
sequence: 1
name: pressed
limits: {speed_deg_s: 60}
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 2, frequency_Hz: 1}], repeats: 300,
     duration_s: 1, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.2}
"""


class TimedOperator(AutomaticOperator):
    """Notes when the final state of the drive is known."""

    def result(self, words: str, good: bool) -> None:
        """Note the moment, then show as usual."""
        self.known_ns = time.monotonic_ns()
        super().result(words, good)


class Announcer:
    """Prints the first beginning of an excitation, and passes every phase on."""

    def __init__(self, following: Callable[[str, Phase], None] | None) -> None:
        self._following = following
        self._said = False

    def __call__(self, stage: str, phase: Phase) -> None:
        """Note the start of a phase."""
        if self._following is not None:
            self._following(stage, phase)
        if phase is Phase.EXCITE and not self._said:
            self._said = True
            say(phase=phase.value)


def host(bench_name: str, count: int, realtime: bool, log: bool) -> None:
    """Run the sequence ``count`` times, and print one line of JSON per event: the process that is
    pressed.
    """
    # The computer is shared while this is measured; lateness is recorded, and ends no run.
    limits = planning._limits
    planning._limits = lambda values, bench: _patient(limits(values, bench))
    marks: dict[str, int] = {}
    _noted(marks)
    late: list[tuple[int, int]] = []
    if log:
        note = Histogram.note
        Histogram.note = lambda self, value: (  # type: ignore[method-assign]
            late.append((time.monotonic_ns(), value)),
            note(self, value),
        )[1]
    bench = load_bench(bench_name)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "pressed.yaml"
        path.write_text(SEQUENCE)
        sequence = load_located(path, Sequence)
        plan = make_plan(sequence, bench, False)
        inputs = Inputs(bench, sequence, 0, realtime, reset_fault=True)
        for number in range(count):
            folder = Path(name) / str(number)
            marks.clear()
            screen = Screen()
            with (
                StopButton() as stop,
                reachable(stop, screen, inputs, plan, folder, required=True) as control,
                create_folder(folder, "benchmark"),
                connect(bench, 0, realtime) as devices,
            ):
                assert control is not None
                operator = TimedOperator(screen=screen, control=control)
                progress = RunProgress(plan.cycle_s, plan.duration_s, screen)
                say(run=control.run)
                devices = observed(devices, control, progress)
                devices = dataclasses.replace(devices, observer=Announcer(devices.observer))
                _, outcome = execute(inputs, plan, devices, folder, operator, stop, _silent)
            phase = re.search(r"phase ([^:]+):", outcome.message)
            say(
                **marks,
                known_ns=operator.known_ns,
                verified=outcome.safe.verified,
                ending=outcome.ending.value,
                message=outcome.message,
                phase=phase[1] if phase else "",
            )
    say(late=late[::2])


def _noted(marks: dict[str, int]) -> None:
    """Note when the loop takes a press, and when the shaft stands, ns."""
    press, wait = StopButton.press, teardown.brake_with_ramp

    def pressed(button: StopButton, cause: str = "") -> None:
        marks.setdefault("taken_ns", time.monotonic_ns())
        press(button, cause)

    def stood(*given: Any) -> None:
        wait(*given)
        marks["stood_ns"] = time.monotonic_ns()

    StopButton.press = pressed  # type: ignore[method-assign]
    teardown.brake_with_ramp = stood


def _patient(limits: Limits) -> Limits:
    return dataclasses.replace(limits, lateness=60.0)


def _silent(stage: str, cycles: int, sample: Sample) -> None:
    pass


def say(**values: object) -> None:
    """Print one line of JSON."""
    print(json.dumps(values), flush=True)


if __name__ == "__main__":
    host(sys.argv[1], int(sys.argv[2]), sys.argv[3] == "1", sys.argv[4] == "1")
