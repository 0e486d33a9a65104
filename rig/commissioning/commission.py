"""A whole commissioning: all steps, again from the start after each corrected value."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Final

import yaml

from drivers.errors import DeviceError
from rig.commissioning import moving, signs, still
from rig.commissioning.homing import announced, homing
from rig.commissioning.record import SkippedError, StepRecord, Verdict, WrongError
from rig.commissioning.setup import FASTEST_DEG_S, HomeRequest, Interview, Setup
from rig.common.errors import InputError, StorageError
from rig.config.bench import Bench, bench_from_text
from rig.config.configuration import Document
from rig.control.cycle import TripError
from rig.control.motion_proof import Change
from rig.runs.recorder import Recorder
from rig.runs.run_record import Ending
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.wiring.devices import Devices
from rig.wiring.off import words_of
from rig.wiring.teardown import SafeState


def patched(text: str, changes: tuple[Change, ...]) -> str:
    """Return the text of a bench file with these values set (or InputError); None removes a key."""
    for change in changes:
        text = _set(text, change)
    return text


def _set(text: str, change: Change) -> str:
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    section = next((value for name, value in root.value if name.value == change.section), None)
    if section is None:
        if change.value is None:
            return text
        return f"{text.rstrip()}\n{change.section}: {{{change.key}: {_scalar(change)}}}\n"
    if not isinstance(section, yaml.MappingNode):
        raise InputError(
            f"{change.section}: must consist of keys with values, so that {change} can be set in "
            "this section; correct the section"
        )
    found = next(((n, v) for n, v in section.value if n.value == change.key), None)
    if change.value is None:
        return text if found is None else _without(text, section, *found)
    if found is not None:
        _, value = found
        return text[: value.start_mark.index] + _scalar(change) + text[value.end_mark.index :]
    line = f"{change.key}: {_scalar(change)}"
    if section.flow_style:
        at = section.start_mark.index + 1
        return f"{text[:at]}{line}{', ' if section.value else ''}{text[at:]}"
    first = section.value[0][0].start_mark
    return f"{text[: first.index]}{line}\n{' ' * first.column}{text[first.index :]}"


def _without(text: str, section: yaml.MappingNode, name: yaml.Node, value: yaml.Node) -> str:
    begin, end = name.start_mark.index, value.end_mark.index
    if section.flow_style:
        rest = text[end:]
        ahead = rest.lstrip(", ") if rest.lstrip().startswith(",") else rest
        return text[:begin] + ahead
    if len(section.value) == 1:
        return f"{text[:begin]}{{}}{text[end:]}"
    stop = text.find("\n", end)
    return text[: begin - name.start_mark.column] + (text[stop + 1 :] if stop >= 0 else "")


def _scalar(change: Change) -> str:
    value = change.value
    return f"{value:.12g}" if isinstance(value, float) else str(value)


MOST_CORRECTIONS: Final = 12
HOMING: Final = "homing"  # name of the step that exists only if a homing is requested
STILL: Final = "Nothing moves, and the drive stays off."
Connect = Callable[[Document[Bench]], AbstractContextManager[Devices]]


@dataclass(frozen=True)
class Step:
    """One step of a commissioning."""

    name: str
    announced: str
    do: Callable[[Setup, StepRecord], None]
    asks: bool = True


STEPS: Final = (
    Step("identity", f"Reads the identities of the devices. {STILL}", still.identity, asks=False),
    Step("readings", f"Reads values, state and settings. {STILL}", still.readings, asks=False),
    Step("zero", f"Compares both angles with the true angle. {STILL}", still.zero, asks=False),
    Step("limits", f"Writes low limits into the drive and reads them back. {STILL}", still.limits),
    Step("signs", signs.ANNOUNCED, signs.signs),
    Step(
        "hold",
        f"The drive is energised for {2 * moving.HOLD_S:g} s and holds the joint at rest. "
        "Then the power is off, and the joint must stay at rest.",
        moving.hold,
    ),
    Step(
        "watchdog",
        "The drive is energised and holds the joint at rest, then this program sends nothing until "
        "the drive has switched the power off by itself.",
        moving.watchdog,
    ),
    Step(
        "small move",
        f"The joint turns by {moving.SMALL_DEG:g} deg at {moving.SLOW_DEG_S:g} deg/s and back, "
        f"twice; if it does not follow, the joint turns further, up to {moving.LARGE_DEG:g} deg.",
        moving.small_move,
    ),
    Step(
        "stop",
        f"The joint turns at up to {0.5 * FASTEST_DEG_S:g} deg/s and a quick stop ends the motion.",
        moving.stop,
    ),
    Step(
        "large move",
        f"The joint turns by {moving.LARGE_DEG:g} deg at up to {0.5 * FASTEST_DEG_S:g} deg/s and "
        "back, twice.",
        moving.large_move,
    ),
)
"""The steps in their order; each step relies on the results of the steps before it."""


def steps_of(setup: Setup) -> Iterator[Step]:
    """Yield the steps with the requested homing: a homing without motion comes before the first
    step in which the drive follows a position, any other homing after the steps on units, watchdog
    and stop. The drive is asked which homing it supports only when the homing is the next step.
    """
    home = setup.home
    before = "" if home is None else "limits" if home.in_place else "stop"
    for step in STEPS:
        yield step
        if home is not None and step.name == before:
            refused = setup.homing_offer.problem(home.method)
            words = f"Not done: {refused}. {STILL}" if refused else announced(setup, home)
            yield Step(HOMING, words, homing, asks=not refused)


@dataclass
class Commissioning:
    """The result of a commissioning."""

    ending: Ending  # kind of the ending; `done` if every step succeeded or was skipped
    words: str
    text: str  # text of the bench file with all corrections
    changes: list[Change] = field(default_factory=list)
    # Steps of each connection; after a correction, a new connection begins.
    sessions: list[list[StepRecord]] = field(default_factory=list)
    # State in which the drive was left, or None if the drive was never energised.
    safe: SafeState | None = None
    # A defect of this program, which is raised after all results are stored.
    error: BaseException | None = None

    @property
    def not_homed(self) -> str:
        """Why a requested homing was not done; empty if it was done or not requested."""
        for step in self.sessions[-1]:
            if step.name == HOMING and step.verdict is Verdict.SKIPPED:
                return f"the homing requested by --home was not done: {step.words}"
        return ""

    @property
    def untried(self) -> list[str]:
        """Steps of the last connection that were not tried."""
        return [s.name for s in self.sessions[-1] if s.verdict is Verdict.SKIPPED]

    def record(self) -> dict[str, Any]:
        """Return the record for the result file."""
        return {
            "state": self.ending.value,
            "message": self.words,
            "changes": [change.record() for change in self.changes],
            "sessions": [[step.record() for step in steps] for steps in self.sessions],
            "drive": None if self.safe is None else self.safe.record(),
        }


def commission(
    document: Document[Bench],
    connect: Connect,
    interview: Interview,
    stop: StopButton,
    record_in: Callable[[int], Recorder],
    fastest_deg_s: float = FASTEST_DEG_S,
    home: HomeRequest | None = None,
) -> Commissioning:
    """Commission a bench. The function raises only the errors of a connection, before the drive is
    energised.

    Raises:
        InputError: A connection to the bench is impossible.
    """
    text = document.path.read_text(encoding="utf-8-sig")
    result = Commissioning(Ending.DONE, "", text)

    def setup_of(bench: Bench, devices: Devices, recorder: Recorder) -> Setup:
        return Setup.of(bench, devices, interview, stop, recorder, fastest_deg_s, home)

    while True:
        wrong = _session(document, connect, setup_of, record_in, result)
        if wrong is None or not wrong.changes or result.ending is not Ending.TRIPPED:
            break
        if result.safe is not None and not result.safe.verified:
            break  # nothing is asked while the drive may be under power
        changes = tuple(c for c in wrong.changes if patched(result.text, (c,)) != result.text)
        if len(result.sessions) > MOST_CORRECTIONS or set(changes) <= set(result.changes):
            result.words += "; this value was already corrected once: check the machine itself"
            break
        shown = ", ".join(map(str, changes))
        try:
            if not interview.agrees(f"Go on from the start with {shown} in a new bench file?"):
                break
        except OperatorStopError as stopped:
            result.ending, result.words = Ending.STOPPED, f"{result.words}; {stopped}"
            break
        text = patched(result.text, changes)
        try:
            document = bench_from_text(text, document.path)
        except InputError as error:
            result.words += f"; the bench file cannot have {shown}: {error}"
            break
        result.text = text
        result.changes += changes
        result.ending, result.words = Ending.DONE, ""
    return result


def _session(
    document: Document[Bench],
    connect: Connect,
    setup_of: Callable[[Bench, Devices, Recorder], Setup],
    record_in: Callable[[int], Recorder],
    result: Commissioning,
) -> WrongError | None:
    steps: list[StepRecord] = []
    result.sessions.append(steps)
    wrong: WrongError | None = None
    with connect(document) as devices:
        recorder = record_in(len(result.sessions))
        try:
            setup = setup_of(document.value, devices, recorder)
            try:
                wrong = _steps(setup, steps, result)
            except StorageError as error:
                # The code that reports this error also states in which state the drive was left.
                error.__dict__["safe"] = setup.safe
                raise
            finally:
                setup.give_back()
                result.safe = setup.safe or result.safe
                if setup.safe is not None and not setup.safe.verified:
                    setup.interview.tell(setup.safe.message)
        finally:
            try:
                recorder.close()
            except StorageError as error:
                # Protocol and state of the drive are still reported.
                result.words = f"{result.words}; {error}".removeprefix("; ")
                if result.ending in (Ending.DONE, Ending.TRIPPED):
                    result.ending = Ending.FAILED
    return wrong


def _steps(setup: Setup, steps: list[StepRecord], result: Commissioning) -> WrongError | None:
    for step in steps_of(setup):
        record = StepRecord(step.name, step.announced)
        steps.append(record)
        setup.recorder.event(setup.cycle.now_ns, "step", step=step.name)
        try:
            setup.stop.check()
            setup.interview.tell(f"Step {step.name}. {step.announced}")
            if step.asks:
                if not setup.interview.agrees("Go on with this step?"):
                    raise OperatorStopError(
                        "the operator did not agree to this step; the following steps depend on it"
                    )
                record.consent = setup.interview.how
            step.do(setup, record)
        except SkippedError as skipped:
            record.verdict, record.words = Verdict.SKIPPED, str(skipped)
        except (WrongError, TripError, DeviceError) as error:
            record.verdict, record.words = Verdict.WRONG, str(error)
            record.changes = error.changes if isinstance(error, WrongError) else ()
            result.ending, result.words = Ending.TRIPPED, f"{step.name}: {error}"
            _say(setup, record)
            return WrongError(str(error), record.changes)
        except (OperatorStopError, KeyboardInterrupt) as stopped:
            record.verdict, record.words = Verdict.SKIPPED, str(stopped) or setup.stop.words
            result.ending, result.words = Ending.STOPPED, f"{step.name}: {record.words}"
            return None
        except StorageError:
            raise
        except BaseException as defect:  # noqa: BLE001 - raised again by the command
            record.verdict, record.words = Verdict.WRONG, words_of(defect)
            result.ending, result.error = Ending.CRASHED, defect
            result.words = f"{step.name}: the program broke down ({words_of(defect)})"
            return None
        _say(setup, record)
    return None


def _say(setup: Setup, record: StepRecord) -> None:
    for item in record.measured:
        setup.interview.tell(f"  {item.name}: {item.value} {item.unit}".rstrip())
    setup.interview.tell(f"  {record.verdict.value}: {record.words}")
