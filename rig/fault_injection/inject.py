"""Executes a fault schedule on a simulated bench, and records the drive's reaction."""

from __future__ import annotations

import dataclasses
import errno
import io
import math
import os
import re
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from drivers.clock import NS, Clock
from drivers.mock.bench import SimulatedBench, SimulatedDbcBench
from drivers.mock.plant.machine import Extremes
from drivers.mock.wires.bus import SteppedClock
from rig.common.errors import InputError
from rig.common.places import write_json
from rig.common.sample import Phase
from rig.common.tables import table
from rig.config.bench import Bench
from rig.config.configuration import Document, nearest
from rig.config.faults import FaultRow, FaultSchedule, load_faults
from rig.config.sequence import Sequence
from rig.control.cycle import Progress
from rig.control.operator import Operator, Verb
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.fault_injection.scene import Scene, impossible
from rig.planning.plan import Plan
from rig.runs.recorder import Recorder
from rig.runs.run import RunFolder
from rig.terminal.prompt import unanswered
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.devices import Devices


class FileLimit:
    """The limit on the size of files; :meth:`restore` restores the previous limit."""

    def __init__(self) -> None:
        self._before: tuple[int, int] | None = None

    def fill(self) -> None:
        """Make every write to a file fail, as on a full disk; InputError if impossible."""
        try:
            import resource
        except ImportError as error:
            raise InputError(
                "the fault disk_full needs a limit on the size of files, which this system lacks; "
                "use Linux or macOS, or leave the fault out"
            ) from error
        self._before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, self._before[1]))

    def restore(self) -> None:
        """Restore the previous limit, if it was changed."""
        if self._before is not None:
            import resource

            resource.setrlimit(resource.RLIMIT_FSIZE, self._before)


SCHEMA = "loadrig.faults/1"
REPORT_FILE = "faults.json"
_AFTERMATH_S = 2.0
_COASTING_S = 0.5
"""Time, s, in which a joint without power comes to rest, so that its travel is whole."""
_PHASES: Mapping[Phase, str] = {Phase.LOAD: "prompt", Phase.RELEASE: "disable"}
"""Phases of the sequencer that have another name in schedules."""


@dataclass
class Finding:
    """Result of one fault.

    Attributes:
        off_after_s: Time from the fault to the final de-energised state; None while energised, or
            if current flows or the joint moves in the simulated machine at the end.
        peak_deg_s: Greatest true speed of the joint since the last fault, deg/s.
        travel_deg: True travel of the joint since then, deg.
    """

    row: int
    when: str
    target: str
    fault: str
    value: float | None
    applied_s: float | None = None
    off_after_s: float | None = None
    as_expected: bool | None = None
    remarks: tuple[str, ...] = ()
    peak_deg_s: float | None = None
    travel_deg: float | None = None


class FaultInjector:
    """Executes one schedule in one run: :meth:`attach`, :meth:`execute`, :meth:`conclude`."""

    def __init__(
        self, schedule: FaultSchedule, sequence: Sequence, patience_s: float | None = None
    ) -> None:
        self._patience_s = patience_s
        self._rows = rows = schedule.rows
        self._ramp_out = {
            stage.name: stage.duration_s - stage.ramp_out_s for stage in sequence.stages
        }
        self._waiting = set(range(len(rows)))
        self._applied_ns: dict[int, int] = {}
        self._off_ns: int | None = 0
        self._weight_kg: float | None = None
        self._answer_after_s: float | None = None
        self._observer: Callable[[str, Phase], None] | None = None
        self._file: _DyingFile | None = None
        self._recorder_fails = False
        self._disk = FileLimit()
        self._moved: Extremes | None = None

    def attach(self, bench: SimulatedBench | SimulatedDbcBench) -> Clock:
        """Attach to a bench; returns the clock for the host."""
        self._scene = Scene(bench)
        self._clock = SteppedClock(bench.clock)
        self._attached_ns = bench.clock.now_ns()
        self._scene.watch(self._entered)
        self._schedule_timed(program=False)
        return self._clock

    def execute(
        self,
        inputs: Inputs,
        plan: Plan,
        devices: Devices,
        path: Path,
        operator: Operator,
        stop: StopButton,
        progress: Progress,
    ) -> tuple[RunFolder, Outcome]:
        """Run as :func:`rig.control.session.execute` does, with the faults of this schedule."""
        self._stop, self._folder, self._observer = stop, path, devices.observer
        devices = dataclasses.replace(devices, hang=self._hang, observer=self._observe)
        operator = _Unreliable(operator, self._answer)
        try:
            self._schedule_timed(program=True)
            return execute(
                inputs, plan, devices, path, operator, stop, progress, self._start_recording
            )
        finally:
            self._disk.restore()

    def _schedule_timed(self, program: bool) -> None:
        """Schedule the faults of the program, or those of the bench, that have a time of their own.

        Those of the program need its stop button, folder and recording.
        """
        for number, row in enumerate(self._rows):
            if row.time_s is not None and ((row.target, row.fault) in ACTIONS) is program:
                passed_s = (self._scene.clock.now_ns() - self._attached_ns) / NS
                self._schedule(number, max(0.0, row.time_s - passed_s))

    def _observe(self, stage: str, phase: Phase) -> None:
        if self._observer is not None:
            self._observer(stage, phase)
        name = _PHASES.get(phase, phase.value)
        for number in sorted(self._waiting):
            row = self._rows[number]
            if row.stage not in (None, stage):
                continue
            if row.phase == name:
                self._schedule(number, 0.0)
            elif row.phase == "ramp_out" and phase is Phase.EXCITE:
                self._schedule(number, self._ramp_out[stage])

    def _hang(self, mass_kg: float) -> None:
        self._scene.machine.hang(mass_kg if self._weight_kg is None else self._weight_kg)

    def _start_recording(self, path: Path) -> Recorder:
        self._file = _DyingFile(path, "xb")
        self._file.dead = self._recorder_fails
        return Recorder(io.BufferedWriter(self._file), path)

    def conclude(self, status: int | None, message: str) -> list[Finding]:
        """Let the devices run on and judge; ``status`` None: about to be killed."""
        clock = self._scene.clock
        if self._off_ns is None or self._scene.live:
            clock.sleep_until_ns(clock.now_ns() + round(_AFTERMATH_S * NS))
            if self._scene.live:
                self._off_ns = None
        if self._moved is not None and self._off_ns is not None:
            machine = self._scene.machine
            machine.advance(round(_COASTING_S * NS / machine.loop_ns) * machine.loop_ns)
        findings = [
            self._judge(number, row, status, message) for number, row in enumerate(self._rows)
        ]
        write_json(
            self._folder / REPORT_FILE,
            {"schema": SCHEMA, "faults": [dataclasses.asdict(f) for f in findings]},
        )
        return findings

    def _schedule(self, number: int, delay_s: float) -> None:
        self._waiting.discard(number)
        row = self._rows[number]
        delay_s += row.after_s
        if delay_s or row.state is not None:
            clock = self._scene.clock
            clock.call_at(clock.now_ns() + round(delay_s * NS), partial(self._apply, number))
        else:
            self._apply(number)

    def _entered(self, state: str, powered: bool) -> None:
        if powered:
            self._off_ns = None
        elif self._off_ns is None:
            self._off_ns = self._scene.clock.now_ns()
        for number in sorted(self._waiting):
            if self._rows[number].state == state:
                self._schedule(number, 0.0)

    def _apply(self, number: int) -> None:
        row = self._rows[number]
        self._applied_ns[number] = self._scene.clock.now_ns()
        self._moved = self._scene.machine.mark()
        action = ACTIONS.get((row.target, row.fault))
        if action is None:
            self._scene.apply(row)
        else:
            action(self, row)

    def _judge(self, number: int, row: FaultRow, status: int | None, message: str) -> Finding:
        finding = Finding(number + 1, row.when, row.target, row.fault, row.amount)
        applied, expect = self._applied_ns.get(number), row.expect
        if applied is None:
            finding.as_expected, finding.remarks = False, ("the fault was never triggered",)
            return finding
        finding.applied_s = applied / NS
        if (moved := self._moved) is not None:
            finding.peak_deg_s = math.degrees(moved.speed_rad_s)
            finding.travel_deg = math.degrees(moved.high_rad - moved.low_rad)
        remarks = []
        if self._off_ns is not None:
            finding.off_after_s = max(0, self._off_ns - applied) / NS
        limit = expect.deenergised_within_s
        if limit is not None and (finding.off_after_s is None or finding.off_after_s > limit):
            found = (
                "still energised" if finding.off_after_s is None else f"{finding.off_after_s:.3f} s"
            )
            remarks.append(f"de-energised after: expected at most {limit:g} s, found {found}")
        if status is not None and expect.exit_status not in (None, status):
            remarks.append(f"exit status: expected {expect.exit_status}, found {status}")
        if status is not None and expect.words is not None and not re.search(expect.words, message):
            remarks.append(f"words: expected {expect.words!r} in {message!r}")
        if expect != type(expect)():
            finding.as_expected = not remarks
        finding.remarks = tuple(remarks)
        return finding

    def _answer(self, stage: str) -> None:
        """Act as an operator who does not answer, if the schedule says so; raise the stop."""
        if self._answer_after_s is not None:
            clock, patience_s = self._scene.clock, self._patience_s
            waited_s = (
                self._answer_after_s
                if patience_s is None
                else min(patience_s, self._answer_after_s)
            )
            clock.sleep_until_ns(clock.now_ns() + round(waited_s * NS))
            if waited_s == patience_s:
                raise unanswered(waited_s)
            raise OperatorStopError(
                f"stopped at the weight prompt of {stage}: the input ended without an answer"
            )

    def _kill(self, row: FaultRow) -> None:
        self._wait(row)
        self.conclude(None, "")
        os.kill(os.getpid(), signal.SIGKILL)

    def _wait(self, row: FaultRow) -> None:
        clock = self._scene.clock
        clock.sleep_until_ns(clock.now_ns() + round((row.amount or 0.0) * NS))

    def _break_recorder(self, _: FaultRow) -> None:
        self._recorder_fails = True
        if self._file is not None:
            self._file.dead = True

    def _hang_wrong(self, row: FaultRow) -> None:
        self._weight_kg = row.amount
        if self._off_ns is not None and self._weight_kg is not None:
            self._scene.machine.hang(self._weight_kg)


_Action = Callable[[FaultInjector, FaultRow], None]


ACTIONS: Mapping[tuple[str, str], _Action] = {
    ("host", "killed"): FaultInjector._kill,
    ("host", "hangs"): FaultInjector._wait,
    ("host", "clock_step"): lambda s, r: s._clock.step(r.amount or 0.0),
    ("host", "recorder_fails"): FaultInjector._break_recorder,
    ("disk", "full"): lambda s, _: s._disk.fill(),
    ("operator", "stop"): lambda s, _: s._stop.press(),
    ("operator", "unanswered"): lambda s, r: setattr(s, "_answer_after_s", r.amount),
    ("operator", "weight_removed"): lambda s, r: s._scene.machine.hang(r.amount or 0.0),
    ("operator", "wrong_weight"): FaultInjector._hang_wrong,
}
"""Actions on program and operator; those on the bench are in :mod:`rig.fault_injection.scene`."""


def fault_injector(
    path: Path,
    bench: Document[Bench],
    sequence: Document[Sequence],
    patience_s: float | None = None,
) -> FaultInjector:
    """Read a schedule for a simulated bench; the run waits ``patience_s`` for answers."""
    schedule = load_faults(path)
    if not bench.value.simulated:
        text = "faults can only be injected on a simulated bench; set bus.interface to mock"
        raise InputError(bench.problem(("bus", "interface"), text))
    schedule.require(
        (("rows", number), why)
        for number, row in enumerate(schedule.value.rows)
        if (why := impossible(row, bench.value)) is not None
    )
    names = [stage.name for stage in sequence.value.stages]
    schedule.require(
        (("rows", number, "stage"), f"the sequence has no such stage; {nearest(row.stage, names)}")
        for number, row in enumerate(schedule.value.rows)
        if row.stage is not None and row.stage not in names
    )
    return FaultInjector(schedule.value, sequence.value, patience_s)


def describe(findings: list[Finding]) -> str:
    """Return the findings as a table, with a message for every unexpected reaction."""
    verdicts = {None: "", True: "yes", False: "NO"}
    rows = [
        [
            str(f.row),
            f.when,
            f"{f.target} {f.fault}",
            "" if f.value is None else f"{f.value:g}",
            "never" if f.applied_s is None else f"{f.applied_s:.3f}",
            "" if f.off_after_s is None else f"{f.off_after_s:.3f}",
            verdicts[f.as_expected],
        ]
        for f in findings
    ]
    head = ["row", "when", "fault", "value", "came at s", "off after s", "as expected"]
    remarks = [f"row {f.row}: {remark}" for f in findings for remark in f.remarks]
    return "\n".join([table(head, rows, right=(0, 3, 4, 5)), *remarks])


class _Unreliable:
    def __init__(self, inner: Operator, answer: Callable[[str], None]) -> None:
        self._inner = inner
        self._answer = answer

    def confirm_weight(self, stage: str, weight_kg: float) -> Any:
        """Ask the real operator, unless a fault of the schedule replaces the answer."""
        self._answer(stage)
        return self._inner.confirm_weight(stage, weight_kg)

    def hangs(self, stage: str, weight_kg: float) -> float:
        """Return the mass that the real operator hangs; a wrong weight is injected at the bench."""
        return self._inner.hangs(stage, weight_kg)

    def paused(self, stage: str, stop: StopButton) -> Verb:
        return self._inner.paused(stage, stop)

    def tell(self, words: str) -> None:
        self._inner.tell(words)

    def result(self, words: str, good: bool) -> None:
        self._inner.result(words, good)


class _DyingFile(io.FileIO):
    dead = False

    def write(self, data: Any) -> int:
        """Write the data, or raise an OSError as a broken medium does."""
        if self.dead:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return super().write(data)
