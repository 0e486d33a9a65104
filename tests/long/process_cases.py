"""What can befall the process of a run, its adapter, its terminal or its disk, and what must come
of each.

All times in s of real time, with the benches of :mod:`tests.long.benches` at 100 Hz. A limit is
stated once, here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

CAN_WATCH_S = 0.25
"""The drive's own watch of 0.1 s, a heartbeat or command up to 50 ms old, the ramp, and 20 ms to
settle.
"""
GUARD_S = 0.25
"""The guardian sees the end of its pipe, brakes, and takes the power off."""
GUARD_DEADLINE_S = 0.45
"""The guardian is not fed for 0.2 s, and looks every few hundredths of a second; then as above."""
STOP_S = 0.4
"""A stop: the ramp, and up to 20 cycles until the state is read again."""
NOW_S = 0.3
"""A stop that does not wait for the ramp; enabling or a request under way is finished first."""
STORAGE_S = 0.6
"""A recording that cannot be written shows at the next flush; then as a stop."""
LINE_S = 0.6
"""A line that says nonsense shows at once or when samples get too old (0.15 s); then as a stop."""
TOLD_S = 3.0
"""From what happened under power to the verdict on the terminal."""
SUSPENDED_S = 2.0
OUT_S = 2.0
"""How long the adapter is out."""
BACK_S = 1.0
"""From the plug: the guardian tries five times a second; then the ramp, and the state read back."""
ANSWER_S = 0.65
"""A guardian that does not answer is noticed after 0.2 s; then as a stop."""
LEFT_S = 1.0
"""How long a drive that nobody can switch off is left, until the operator uses `rig off`."""
RIG_OFF_S = 4.0
"""From the start of `rig off`: the program starts, ends what is frozen, and stops the drive."""
GONE_S = 1.0
"""A deleted run folder is noticed within 1 s; then as a stop."""
LOG_GAP_S = 0.2
LIMITS = (
    "The power stage must be off for good within these times: "
    f"{STOP_S:g} s after SIGHUP, SIGTERM, SIGTSTP, a lost terminal or an input that ends; "
    f"{NOW_S:g} s after SIGQUIT; "
    f"{GUARD_S:g} s after SIGKILL on the serial bench, by the guardian; "
    f"{CAN_WATCH_S:g} s after SIGKILL or a lost adapter on a CAN bus, by the drive's own watchdog; "
    f"{GUARD_DEADLINE_S:g} s after a suspension on the serial bench, and {CAN_WATCH_S:g} s on a "
    "CAN bus; "
    f"{LINE_S:g} s after garbage that ends a run; {STORAGE_S:g} s after the disk is full; "
    f"{BACK_S:g} s after the adapter of the serial bench is back; {ANSWER_S:g} s after its "
    f"guardian hangs; {STOP_S:g} s after a sleep of the computer; {GONE_S + STOP_S:g} s after the "
    "run folder is deleted. A drive without a watchdog whose program and guardian are frozen or "
    f"dead stays on until `rig off`, and is off within {RIG_OFF_S:g} s of its start; the run says "
    "before its first prompt that nothing protects then. "
    "If the drive had power, the terminal must show the last message of the run, with the state of "
    f"the drive, within another {TOLD_S:g} s."
)

PHASES: Mapping[str, tuple[str, str, float]] = {
    "prompt": ("one", "load", 0.1),
    "prepare": ("one", "prepare", 0.0),
    "enable": ("one", "enable", 0.0),
    "first pass": ("one", "first pass", 0.4),
    "approach": ("one", "approach", 0.1),
    "settle": ("one", "settle", 0.1),
    "excite": ("one", "excite", 0.2),
    "ramp_out": ("one", "excite", 0.65),
    "hold": ("one", "hold", 0.03),
    "disable": ("one", "release", 0.0),
    "between": ("two", "load", 0.1),
}
"""Phase to stage and phase as the run calls them, and how long after its beginning it happens; 0 at
the very beginning. At a prompt it happens once that is on the screen.
"""
ASKING = ("prompt", "between")
NO_POWER = ("prompt", "prepare", "enable", "between")
"""Where the drive has no power when it happens; ``enable`` may give it some right after."""
CYCLING = ("first pass", "approach", "settle", "excite", "ramp_out", "hold")
SEQUENCE = """\
sequence: 1
name: processes
first_pass: {amplitude: 0.5, duration_s: 0.6}
stages:
  - {name: one, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 1.5}], duration_s: 0.8,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.3}
"""
SECOND_STAGE = SEQUENCE.split("stages:\n")[1].replace("name: one", "name: two")


@dataclass(frozen=True)
class Must:
    """What must come of it.

    Attributes:
        statuses: Exit statuses that are right.
        off_s: How soon the power is off for good; None where the run goes on, and ends by itself.
        verified: Whether the state is read back; None where either may be, as long as it is said.
        words: What the terminal must show.
        told: Whether there is a terminal and a program left to tell.
        stays_on: Whether nothing can reach the drive, so that it stays on and the operator must
            switch it off.
        record: States of run.json that are true.
    """

    statuses: tuple[int, ...]
    off_s: float | None = None
    verified: bool | None = True
    words: str = ""
    told: bool = True
    stays_on: bool = False
    record: tuple[str, ...] = ()


STATES: Mapping[int, str] = {0: "done", 1: "tripped", 3: "stopped", 4: "failed"}
DONE = Must((0,))
MAY_GO_ON = Must((0, 4), None, verified=None)


STOPPED = Must((3,), STOP_S)
LEFT_ALONE = Must((-9,), LEFT_S + RIG_OFF_S, told=False, record=("running",))


def _killed(transport: str, phase: str) -> Must:
    off_s = GUARD_S if transport == "serial" else CAN_WATCH_S
    return Must((-9,), off_s, told=False, record=("running",))


def _adapter_gone(transport: str, phase: str) -> Must:
    words = r"could NOT be verified[\s\S]*main supply"
    if transport == "serial" and phase in (*CYCLING, "disable"):
        return Must((4,), None, verified=False, words=words, stays_on=True)
    return Must((4,), CAN_WATCH_S, verified=False, words=words)


def _adapter_back(transport: str, phase: str) -> Must:
    if phase not in (*CYCLING, "disable"):
        return Must((0, 4), None, verified=None)
    words = r"could NOT be verified[\s\S]*main supply"
    if transport == "serial":
        # The run ends before the adapter is back; the guardian speaks last.
        words += r"[\s\S]*guardian: the program [\s\S]*read back"
        return Must((4,), OUT_S + BACK_S, verified=None, words=words)
    return Must((4,), CAN_WATCH_S, verified=False, words=words)


def _guardian_hangs(transport: str, phase: str) -> Must:
    if phase in ("ramp_out", "hold"):
        # The stage may end before the guardian is missed.
        return Must((0, 4), ANSWER_S)
    return Must((4,), ANSWER_S, words="did not answer")


def _stdin(transport: str, phase: str) -> Must:
    return Must((3,), STOP_S, words="prompt") if phase in ASKING else DONE


DISK_FULL = Must(
    (4,),
    STORAGE_S,
    words="storage error|cannot be written|No space left",
    record=("failed", "running"),
)


def _suspended(transport: str, phase: str) -> Must:
    off_s = GUARD_DEADLINE_S if transport == "serial" else CAN_WATCH_S
    if phase in (*CYCLING, "disable"):
        must = Must((4,), off_s)
        return must if phase != "disable" else replace(must, statuses=(0, 4))
    return DONE if phase in ASKING else MAY_GO_ON


@dataclass(frozen=True)
class Column:
    """Something that happens.

    Attributes:
        must: What must come of it, or transport and phase to that.
        words: What it is, in a sentence of the page.
        transports: Where it can happen.
        phases: When it is tried.
        busy: Whether words on lateness then mean that the machine was too busy, rather than that it
            happened.
    """

    must: Must | Callable[[str, str], Must]
    words: str
    busy: bool = True
    transports: tuple[str, ...] = ("serial", "slcan", "dbc", "socketcand")
    phases: tuple[str, ...] = tuple(PHASES)

    def required(self, transport: str, phase: str) -> Must:
        """Return what must come of it on a transport in a phase."""
        return self.must if isinstance(self.must, Must) else self.must(transport, phase)


ALONE = ("both frozen", "both killed")
"""After these nobody is left who could switch off a drive without a watchdog, or say so."""
COLUMNS: Mapping[str, Column] = {
    "adapter gone": Column(
        _adapter_gone,
        "the harness closes the other end of the drive's pseudo-terminal, so that every call fails "
        "with EIO; over socketcand the server closes the connection",
        busy=False,
    ),
    "line garbage": Column(
        Must((0, 4), LINE_S, verified=None),
        "the drive's line delivers some 200 bytes of noise and of broken lines of the adapter's "
        "protocol",
        busy=False,
    ),
    "second program": Column(DONE, "a second program, `rig jog`, opens the same bench"),
    "SIGHUP": Column(STOPPED, "the process of the run gets SIGHUP"),
    "SIGTERM": Column(STOPPED, "the process of the run gets SIGTERM"),
    "SIGTSTP": Column(STOPPED, "the process of the run gets SIGTSTP, as by Ctrl-Z"),
    "SIGQUIT": Column(
        Must((3,), NOW_S), "the process of the run gets SIGQUIT, as by Ctrl-backslash"
    ),
    "SIGKILL": Column(_killed, "the process of the run gets SIGKILL"),
    "terminal stalled": Column(
        DONE,
        "Ctrl-S stops the output of the terminal; Ctrl-Q releases it after the run, or after 1 s "
        "at a prompt",
    ),
    "terminal gone": Column(
        replace(STOPPED, told=False), "the terminal is hung up, as by an ssh connection that drops"
    ),
    # A run that is done says so on its standard output.
    "stdout closed": Column(
        replace(DONE, told=False), "the pipe of the standard output loses its reader"
    ),
    "stdin closed": Column(_stdin, "the pipe of the standard input ends"),
    "disk full": Column(DISK_FULL, "the file system of the run folder is full"),
    "HOME not writable": Column(
        DONE,
        "HOME is no folder any more; in the column *prompt* it is none from the start, and the "
        "program's own folder cannot be written either",
    ),
    "suspended 2 s": Column(
        _suspended, "the process of the run gets SIGSTOP, and SIGCONT 2 s later", busy=False
    ),
    "adapter out 2 s": Column(
        _adapter_back,
        "the drive's pseudo-terminal is closed as in *adapter gone*; 2 s later there is another "
        "one under the same name, as under /dev/serial/by-id",
        busy=False,
        transports=("serial", "slcan", "dbc"),
    ),
    "guardian hangs": Column(
        _guardian_hangs,
        "the guardian gets SIGSTOP",
        busy=False,
        transports=("serial",),
        phases=CYCLING,
    ),
    "both frozen": Column(
        LEFT_ALONE,
        "guardian and run get SIGSTOP at once; 1 s later the operator uses `rig off`",
        busy=False,
        transports=("serial",),
        phases=CYCLING,
    ),
    "both killed": Column(
        LEFT_ALONE,
        "guardian and run get SIGKILL at once; 1 s later the operator uses `rig off`",
        busy=False,
        transports=("serial",),
        phases=CYCLING,
    ),
    "computer asleep": Column(
        Must((4,), STOP_S, words="the computer slept for 5.0 s"),
        "the clock since boot jumps by 5 s in the process of the run, and the monotonic clock does "
        "not, as after a sleep of the computer",
        phases=CYCLING,
    ),
    "folder deleted": Column(
        Must((4,), GONE_S + STOP_S, words="was deleted during the run|no longer in"),
        "the run folder is deleted",
        busy=False,
        phases=CYCLING,
    ),
}

START = "start"
STARTS: Mapping[str, tuple[tuple[str, str], bool, Must]] = {
    "<&-": (("closed", "tty"), False, Must((2, 3), 0.0, verified=None)),
    "--yes <&-": (("closed", "tty"), True, DONE),
    "--yes > /dev/full": (
        ("tty", "/dev/full"),
        True,
        Must((0, 4), told=False, record=("done", "failed")),
    ),
    "--yes >&-": (("tty", "closed"), True, Must((0, 4), told=False, record=("done", "failed"))),
}
"""What a run may be started with: standard input and output, whether with ``--yes``, and what must
come of it.
"""
