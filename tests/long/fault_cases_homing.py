"""Faults while a drive homes (``rig commission --home``), and what must come of each.

Only the steps up to the homing are done; its time, messages, protocol and recording are those of
the command. Times are simulated; "off" is when the simulated power stage went off for good.
"""

import contextlib
import io
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

from drivers.clock import NS
from drivers.homing import IN_PLACE
from drivers.mock import faults
from drivers.mock.bench import SimulatedBench
from drivers.mock.faults import MISTAKES, LineFaults, Mistake, WireFaults
from drivers.mock.power_state import POWERED, State
from rig.cli.entry import status
from rig.commissioning import commission
from rig.commissioning.commission import Step
from rig.commissioning.setup import Setup
from rig.control.cycle import Cycle
from rig.runs.mcap.reader import read_run

_NAME: Final = "home_jammed"
"""Name under which a case is built into the simulated devices."""
_MOVES: Final = ("hold", "watchdog", "small move", "stop", "large move")
METHODS: Final = (37, 17)
AFTER_S: Final = 0.2
"""Time from the start of the homing to the fault."""
_GAP_S: Final = 0.2
BRAKE_S: Final = 0.15
WATCH_S: Final = 0.25

BUS_ONLY: Final = ("EMCY", "drive restarts", "host's frames lost", "control loop hangs 0.5 s")
"""Faults that a serial line does not have, or that show there in another way."""

Spoil = Callable[[SimulatedBench, faults.Sensor], None]


@dataclass(frozen=True)
class HomingCase:
    """A fault and what must follow.

    Attributes:
        spoil: Builds it into the bench: at once, or ``AFTER_S`` after the start of the homing.
        words: Words of the message.
        later: Whether it comes after the start.
        within_s: Longest time from the fault until the drive is off; None without a limit.
        verified: Whether the host can still prove the drive off.
        exit_status: Of the command.
        methods: Homing methods of which this is a fault.
        options: More options of the command.
        needs_watchdog: Whether a drive without a watchdog goes on.
    """

    spoil: Spoil
    words: str
    later: bool = True
    within_s: float | None = BRAKE_S
    verified: bool = True
    exit_status: int = 1
    methods: tuple[int, ...] = METHODS
    options: tuple[str, ...] = ()
    needs_watchdog: bool = False


def _cable(bench: SimulatedBench, _: faults.Sensor) -> None:
    if "drive" in bench.lines:
        LineFaults(bench.lines["drive"], bench.clock).cut(None)
    else:
        WireFaults(bench.bus, bench.clock).lose(lambda _identifier, _host: True, 0)


CASES: Final[Mapping[str, HomingCase]] = {
    "it never ends": HomingCase(
        lambda bench, _: setattr(bench.drive.homing, "endless", True),
        r"has not ended after .* limit 2 s; look for",
        later=False,
        within_s=None,
        options=("--home-time", "2"),
    ),
    "the limit switch never closes": HomingCase(
        lambda bench, _: setattr(bench.drive.homing, "switches_deg", None),
        "look for a switch that does not close",
        later=False,
        within_s=None,
        methods=(17,),
    ),
    "the joint is jammed": HomingCase(
        lambda bench, _: setattr(bench.drive.homing, "jammed", True),
        "homing error .*look for a joint that is blocked",
        later=False,
        within_s=None,
        methods=(17,),
    ),
    "drive fault": HomingCase(lambda bench, _: bench.drive.fail(0x7320), "7320h|603Fh. cannot be"),
    "EMCY": HomingCase(lambda bench, _: bench.drive.emergency(0x2310, 0x01), "2310h"),
    "drive restarts": HomingCase(
        lambda bench, _: WireFaults(bench.bus, bench.clock).restart(bench.drive.node_id),
        "restarted|not OPERATION ENABLED|heartbeat|homing",
    ),
    "cable lost": HomingCase(
        _cable, "sample age|no SDO|no correct answer", within_s=WATCH_S, verified=False,
        exit_status=4, needs_watchdog=True,
    ),
    "host's frames lost": HomingCase(
        lambda bench, _: WireFaults(bench.bus, bench.clock).lose(lambda _id, host: host, 0),
        "sample age|8130h|no SDO", within_s=WATCH_S, verified=False, exit_status=4,
        needs_watchdog=True,
    ),
    "encoder frozen": HomingCase(
        lambda _, sensor: faults.freeze(sensor),
        "encoder against drive .*check the joint encoder", within_s=0.5, methods=(17,),
    ),
}  # fmt: skip
"""Name to case; the operator's stop and a loop that hangs are in :data:`HOST`."""


def _press(cycle: Cycle) -> None:
    cycle._stop.press("Ctrl-C")


def _hang(cycle: Cycle) -> None:
    clock = cycle._link.clock
    clock.sleep_until_ns(clock.now_ns() + NS // 2)


HOST: Final[Mapping[str, tuple[Callable[[Cycle], None], HomingCase]]] = {
    "Ctrl-C": (_press, HomingCase(lambda *_: None, "stopped by the operator", exit_status=3)),
    "control loop hangs 0.5 s": (
        _hang,
        HomingCase(lambda *_: None, "8130h|late|heartbeat|sample age", within_s=0.7),
    ),
}


@dataclass
class Seen:
    """What a bench showed: times in s, None for what did not happen."""

    applied_s: float | None = None
    off_s: float | None = None
    powered: bool = False


def run(case: HomingCase, method: int, bench: str, folder: Path, act: Any = None) -> list[str]:
    """Home once with a fault in a new folder; returns what is not as it must be."""
    folder.mkdir(parents=True)
    seen, calls = Seen(), [0]
    attend, steps_of = Cycle.attend, commission.steps_of

    def spoil(mock: SimulatedBench, sensor: faults.Sensor) -> None:
        def entered(state: State) -> None:
            if seen.powered and state not in POWERED:
                seen.off_s = mock.clock.now_ns() / NS
            seen.powered = state in POWERED

        def apply() -> None:
            seen.applied_s = mock.clock.now_ns() / NS
            case.spoil(mock, sensor)

        mock.drive.entered.append(entered)
        if not case.later:
            apply()
        elif act is None:
            started = mock.drive.homing.begin

            def begin(counts: int) -> None:
                started(counts)
                mock.clock.call_at(mock.clock.now_ns() + round(AFTER_S * NS), apply)

            mock.drive.homing.begin = begin  # type: ignore[method-assign]

    def counted(self: Cycle, limits: Any) -> Any:
        calls[0] += 1
        if act is not None and calls[0] == 1 + round(AFTER_S * NS / self._period_ns):
            seen.applied_s = self._link.clock.now_ns() / NS
            act(self)
        return attend(self, limits)

    def short(setup: Setup) -> Iterator[Step]:
        return (step for step in steps_of(setup) if step.name not in _MOVES)

    # Method 17 is tried after the stop, which is left out here.
    first = {"--home": str(method), "--home-angle": "0" if method in IN_PLACE else "-20"}
    words = ["commission", bench, "--yes", "--out", str(folder / "out"), "--mistake", _NAME]
    words += [item for pair in first.items() for item in pair]
    said = io.StringIO()
    with (
        patch.dict(MISTAKES, {_NAME: Mistake("", spoil)}),  # type: ignore[arg-type]
        patch.object(Cycle, "attend", counted),
        patch.object(commission, "steps_of", short),
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
    ):
        code = status([*words, *case.options])
    return list(_problems(case, code, seen, folder / "out", said.getvalue()))


def _problems(case: HomingCase, code: int, seen: Seen, out: Path, said: str) -> Iterator[str]:
    record = json.loads((out / "commission.json").read_text())
    step = record["sessions"][-1][-1]
    alone = case.needs_watchdog and "has no watchdog" in said
    if step["name"] != "homing" or seen.applied_s is None or record["drive"] is None:
        yield f"step {step['name']}, without the fault: {step['words']} {record['message']}"
        return
    if code != case.exit_status:
        yield f"exit status {code}, must be {case.exit_status}: {record['message']}"
    if re.search(case.words, record["message"]) is None:
        yield f"expected {case.words!r} in {record['message']!r}"
    if "The zero of the drive counts as not set" not in record["message"]:
        yield f"the zero is not said to be unset: {record['message']}"
    if record["drive"]["verified"] is not case.verified:
        yield f"verified {record['drive']['verified']}, must be {case.verified}"
    if not case.verified and "could NOT be verified" not in " ".join(said.split()):
        yield "the operator is not told that the drive could not be verified"
    if alone:
        return
    if seen.powered or seen.off_s is None:
        yield "the drive is still energised"
    elif case.within_s is not None and seen.off_s - seen.applied_s > case.within_s:
        yield f"off after {seen.off_s - seen.applied_s:.3f} s, at most {case.within_s:g} s"
    time = read_run(out / "recording.mcap").samples["time"]
    if len(time) == 0 or (case.later and float(time[-1]) < seen.applied_s - _GAP_S):
        yield "the recording ends before the fault"
