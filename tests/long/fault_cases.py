"""Faults of a run over CANopen, and what must come of each in each phase."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

EMPTY = """\
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 2}], duration_s: 0.6,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.05}
"""
LOADED = """\
  - {name: loaded, stage: loaded, weight_kg: 15, tones: [{amplitude_deg: 8, frequency_Hz: 1}],
     duration_s: 8, settle_s: 0.05}
"""
PHASES: Mapping[str, float] = {
    "prompt": 0.0,
    "prepare": 0.005,
    "enable": 0.003,
    "approach": 0.1,
    "excite": math.nan,
    "ramp_out": 0.0,
    "hold": 0.02,
    "disable": 0.0,
}
"""Phase to how long after its start the fault comes, s; that of the excitation is the case's."""
STATES = (
    "switch_on_disabled",
    "ready",
    "switched_on",
    "operation_enabled",
    "quick_stop_active",
    "fault_reaction",
)
BRAKE_S = 0.1
"""Trip, quick stop at 2000 deg/s^2, and up to 20 cycles until the state is read again."""
WATCH_S = 0.2
"""Heartbeat watch of 0.1 s, 25 ms between heartbeats, ramp and 20 ms to settle."""
SILENCE_S = 0.35
"""A device counts as silent after 0.2 s without its heartbeat, 50 ms apart; then as BRAKE_S."""
STANDSTILL_S = 1.1
"""A drive that stays in QUICK STOP ACTIVE is waited for 1 s, then disabled."""
LATENT_S = 1.5
"""Shows only when it is next needed, at the latest as the drive is disabled; the whole run takes
1.3 s.
"""


@dataclass(frozen=True)
class Must:
    """The reaction asked for: exit status, words of the run, and for what is not ridden out the
    time to power off.

    ``verified`` is whether the host can prove the drive off by state, current and motion;
    ``stays_on`` is for a drive that nobody stops.
    """

    exit_status: int
    words: str = ""
    within_s: float | None = None
    verified: bool = True
    stays_on: bool = False


RIDES = Must(0, "all 1 stages done")


@dataclass(frozen=True)
class Case:
    """A fault: its rows in the schedule, and what must follow, by phase or for the rest of them."""

    rows: tuple[Mapping[str, Any], ...]
    rest: Must
    by_phase: Mapping[str, Must] = field(default_factory=dict)
    stage: str = EMPTY
    excite_s: float = 0.15

    def must(self, phase: str) -> Must:
        """Return what must follow in this phase."""
        return self.by_phase.get(phase, self.rest)


def fault(target: str, name: str, **more: Any) -> Mapping[str, Any]:
    """Return a row of a schedule, without its time."""
    return {"target": target, "fault": name, **more}


def at(phases: str, must: Must) -> dict[str, Must]:
    """Ask for one reaction in several phases."""
    return dict.fromkeys(phases.split(), must)


NO_ANSWER = Must(4, "no SDO response", WATCH_S)
NOT_DISABLED = Must(4, "no SDO response", WATCH_S + 0.15)
"""The command that takes the power off may be answered 0.15 s late; the signs of the control loop
end then, and the drive stops by itself.
"""
REFUSED = Must(4, "refuses", BRAKE_S)
FOUND_LATER = Must(1, "encoder against drive", 0.5)
FOUND = Must(1, "encoder against drive", BRAKE_S)
MOTION = {"device": "drive", "function": "motion"}
STALE = Must(4, "sample age", BRAKE_S)
NOT_RUNNING = Must(4, "not OPERATION ENABLED", BRAKE_S)
STUCK = Must(4, r"could NOT be verified.* A flow", verified=False, stays_on=True)
NO_POWER = "prompt prepare enable"


RUNS_AWAY = Must(1, "runs away", LATENT_S)


def _stopping(option: int) -> Case:
    rows = (fault("drive", "quick_stop_option", value=option), fault("operator", "stop"))
    within = {0: 0.05, 1: 0.35, 2: BRAKE_S, 5: STANDSTILL_S, 6: STANDSTILL_S}[option]
    return Case(rows, Must(3, "stopped by the operator", within))


SIGNS: Mapping[str, Case] = {
    "speed loop of the wrong sign": Case(
        (fault("drive", "velocity_sign"),), RUNS_AWAY, at("disable", RIDES)
    ),
    # A joint at rest does not show it.
    "position loop of the wrong sign": Case(
        (fault("drive", "position_sign"),), RUNS_AWAY, at("hold disable", RIDES)
    ),
    "motor phases swapped": Case(
        (fault("drive", "phases_swapped"),), RUNS_AWAY, at("disable", RIDES)
    ),
}
CASES: Mapping[str, Case] = {
    "one frame lost": Case(
        (fault("bus", "lost"),), RIDES, at("prepare", NO_ANSWER) | at("disable", NOT_DISABLED)
    ),
    "the drive's frames lost, 40 of them": Case(
        (fault("bus", "lost", frames={"device": "drive"}, count=40),),
        Must(4, "sample age", WATCH_S),
        at("enable prepare", NO_ANSWER)
        | at("disable", NOT_DISABLED)
        | at("prompt", replace(NO_ANSWER, verified=False)),
    ),
    "cable pulled": Case(
        (fault("bus", "lost", count=0),),
        Must(4, "sample age.*could NOT be verified", WATCH_S, verified=False),
        at(
            "prompt prepare enable disable",
            Must(4, "no SDO response.*could NOT be verified", WATCH_S, verified=False),
        ),
    ),
    "10 frames repeated": Case((fault("bus", "repeated", count=10),), RIDES),
    "a frame 3 ms late": Case((fault("bus", "late", value=0.003),), RIDES),
    "the drive's positions 20 ms late, 60 of them": Case(
        (fault("bus", "late", frames=MOTION, value=0.02, count=60),),
        Must(4, "sample age", BRAKE_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "target with a bit wrong": Case(
        (fault("bus", "flipped", frames={"device": "host", "function": "output"}, value=29),), RIDES
    ),
    "position with a bit wrong": Case(
        (fault("bus", "flipped", frames=MOTION, value=29),),
        Must(1, "beyond its limit", BRAKE_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "process data cut short": Case((fault("bus", "short", frames=MOTION),), RIDES),
    "bus-off": Case(
        (fault("bus", "bus_off"),),
        Must(4, "bus-off.*could NOT be verified", WATCH_S, verified=False),
    ),
    "error frames": Case(
        (fault("bus", "error_frames", count=3),),
        Must(4, "error frame", BRAKE_S),
        at("disable", RIDES),
    ),
    "host's heartbeat lost": Case(
        (fault("bus", "lost", frames={"device": "host", "function": "heartbeat"}, count=0),),
        Must(4, "8130h", WATCH_S),
        at("prompt prepare hold disable", RIDES),
    ),
    "drive's heartbeat lost": Case(
        (fault("bus", "lost", frames={"device": "drive", "function": "heartbeat"}, count=0),),
        Must(4, "sent no heartbeat", SILENCE_S),
        at("prompt prepare", Must(4, "did not report the NMT state OPERATIONAL", 0.0))
        | at("hold disable", RIDES),
    ),
    "EMCY": Case((fault("drive", "emcy"),), Must(4, "2310h", BRAKE_S), at("disable", RIDES)),
    "drive fault": Case(
        (fault("drive", "fault"),),
        Must(4, "7320h", BRAKE_S),
        at("disable", Must(0, "read back: fault", BRAKE_S)),
    ),
    "drive restarts": Case(
        (fault("drive", "restart"),),
        Must(4, "restarted", BRAKE_S),
        # Which setting the restart falls into differs with the number of settings.
        at("prompt disable", RIDES)
        | at("prepare", Must(4, "did not report the NMT state OPERATIONAL|refuses", 0.0)),
    ),
    "power stage stuck": Case((fault("drive", "stuck"),), STUCK),
    "power stage stuck, then Ctrl-C": Case(
        (fault("drive", "stuck"), fault("operator", "stop")),
        STUCK,
        # A power stage that is on, but holds a joint without current, cannot be seen.
        at("prompt prepare", Must(3, "stopped by the operator", 0.0))
        | at("enable", Must(3, "stopped by the operator", stays_on=True)),
    ),
    **{f"quick stop, 605Ah = {option}": _stopping(option) for option in (0, 1, 2, 5, 6)},
    **SIGNS,
    "mode refused": Case(
        (fault("drive", "mode_refused"),),
        RIDES,
        at("prompt prepare enable", Must(4, "6061h still reads 0", 0.0)),
    ),
    "SDO abort": Case(
        (fault("drive", "sdo_abort"),),
        Must(4, "refuses", LATENT_S),
        # Before the prompt, a value that is refused once is read again.
        at("prompt", RIDES) | at("prepare enable disable", REFUSED),
    ),
    "SDO time-out": Case(
        (fault("drive", "sdo_timeout"),),
        Must(4, "no SDO response", LATENT_S),
        at("prompt", RIDES) | at("prepare enable", NO_ANSWER) | at("disable", NOT_DISABLED),
    ),
    "encoder bit": Case(
        (fault("encoder", "bit"),), FOUND, at("prompt prepare enable disable", RIDES)
    ),
    "encoder jump": Case(
        (fault("encoder", "jump"),),
        FOUND,
        at("prompt prepare enable", FOUND_LATER) | at("disable", RIDES),
    ),
    "encoder frozen": Case((fault("encoder", "frozen"),), FOUND_LATER, at("hold disable", RIDES)),
    "encoder reversed": Case((fault("encoder", "reversed"),), FOUND_LATER, at("disable", RIDES)),
    "control loop hangs 0.5 s": Case(
        (fault("host", "hangs"),), Must(4, "8130h", WATCH_S), at("prompt prepare disable", RIDES)
    ),
    "control loop pauses 22 ms": Case((fault("host", "hangs", value=0.022),), RIDES),
    "controller killed": Case((fault("host", "killed"),), Must(-9, "", WATCH_S, verified=False)),
    "clock steps 1 s ahead": Case(
        (fault("host", "clock_step", value=1.0),),
        Must(4, "sent no heartbeat", BRAKE_S),
        at("disable", RIDES),
    ),
    "clock steps 1 s back": Case(
        (fault("host", "clock_step", value=-1.0),),
        Must(4, "8130h", WATCH_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "recorder fails": Case((fault("host", "recorder_fails"),), Must(4, "Input/output error", 0.25)),
    "disk full": Case((fault("disk", "full"),), Must(4, "cannot be written", 0.25)),
    "Ctrl-C": Case((fault("operator", "stop"),), Must(3, "stopped by the operator", BRAKE_S)),
    "prompt unanswered": Case(
        (fault("operator", "unanswered", value=30.0),),
        RIDES,
        at("prompt", Must(3, "without an answer", 0.0)),
    ),
    "10 of 15 kg fall off": Case(
        (fault("operator", "weight_removed", value=5.0),),
        RIDES,
        at("excite", Must(1, "all 1 stages done")),
        LOADED,
        3.7,
    ),
    "60 kg instead of none": Case((fault("operator", "wrong_weight", value=60.0),), RIDES),
    "300 kg instead of none": Case(
        (fault("operator", "wrong_weight", value=300.0),),
        Must(1, "beyond its limit", 0.7),
        at("approach excite ramp_out hold disable", RIDES),
    ),
}


@dataclass(frozen=True)
class Transport:
    """A packaged bench file, and which faults exist on it.

    Attributes:
        bench: Its name.
        cases: Fault to what must come of it.
        states: Those of CiA 402 in which its drive can be.
        code: An error code of its drive.
        in_reaction: Words of the run whose drive faults twice.
    """

    bench: str
    cases: Mapping[str, Case]
    states: tuple[str, ...] = STATES
    code: int = 0x7320
    in_reaction: str = "7330h"
