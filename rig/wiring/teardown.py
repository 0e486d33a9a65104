"""Takes the power off at every end of a run, and reports whether the drive was proved off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from drivers.clock import NS, Clock
from drivers.interfaces import Servo, ServoLimits, ServoState
from rig.wiring.braking import brake as brake_with_ramp
from rig.wiring.off import HANDS_OFF, PATIENCE_S, OffProof, Proof, Steps, seen_words

DISABLE_ATTEMPTS = 2
INSISTENT_ATTEMPTS = 5
REPEATED_S = 0.05  # time for which cycles repeat an unanswered command in the process data
MOST_REPEATED = 50


@dataclass(frozen=True)
class SafeState:
    """Final state of the drive, and whether it was proved to be off."""

    verified: bool  # whether state, current and motion show that the drive is off
    state: str
    problems: tuple[str, ...] = ()
    watched: bool = True  # whether the drive de-energises itself when it is no longer commanded
    # Exceptions of the steps, except device errors, storage errors and Ctrl-C; they are defects of
    # this program, and are raised again after the operator was informed of the state of the drive.
    unforeseen: tuple[BaseException, ...] = field(default=(), repr=False, compare=False)
    # Motor current at the end, A; None if it was not reported or not read.
    current_A: float | None = None
    # Speed of the joint at the end, rad/s; None if no angle was read.
    motion_rad_s: float | None = None
    # Why the drive does not count as off; empty if it does, or if its state is unknown or
    # energised.
    doubt: str = ""
    cut: str = ""  # why the power was cut instead of a ramp; empty if it was not
    # Whether the joint encoder was read at the end; None if it was not observed.
    joint_read: bool | None = None

    @property
    def message(self) -> str:
        """One sentence for the operator."""
        if self.verified:
            seen = seen_words(self.current_A, self.motion_rad_s, self.joint_read)
            off = f"the drive is de-energised (read back: {self.state}){seen}"
            return f"{self.cut}; {off}" if self.cut else off
        cut = (self.cut,) if self.cut else ()
        if self.doubt:
            words = "; ".join((*cut, self.doubt, *self.problems))
            return f"it could NOT be verified that the drive is de-energised: {words}; {HANDS_OFF}"
        by_itself = (
            "its own watchdog takes the power off; switch the main supply off before "
            "approaching the bench"
            if self.watched
            else (
                "it has no watchdog and may go on HOLDING UNDER POWER: switch the main supply "
                "off now"
            )
        )
        return (
            "it could NOT be verified that the drive is de-energised "
            f"(state {self.state}; {'; '.join((*cut, *self.problems))}); {by_itself}"
        )

    def record(self) -> dict[str, Any]:
        """Return the record for a result file."""
        return {
            "verified": self.verified,
            "state": self.state,
            "problems": list(self.problems),
            "watched": self.watched,
            "current_A": self.current_A,
            "motion_rad_s": self.motion_rad_s,
            "doubt": self.doubt,
            "joint_read": self.joint_read,
        }


def _repeat(steps: Steps, watch: Callable[[], object], clock: Clock) -> None:
    """Run cycles for :data:`REPEATED_S`: their process data contain the last command."""
    cycles = Steps()
    end_ns = clock.now_ns() + round(REPEATED_S * NS)
    for _ in range(MOST_REPEATED):
        if clock.now_ns() >= end_ns:
            break
        cycles.attempt(watch)
    steps.unforeseen += cycles.unforeseen


def make_safe(
    servo: Servo,
    watch: Callable[[], ServoState | None],
    clock: Clock,
    cycle_ns: int,
    *,
    brake: bool,
    hurry: Callable[[], bool],
    watched: bool = True,
    insistent: bool = False,
    off: OffProof | None = None,
    insist: Callable[[], object] = lambda: None,
) -> SafeState:
    """Brake if ``brake``, take the power off and prove that it is off. The function never raises an
    error.

    Each step has its own time-out and is carried out even if earlier steps raised errors. If the
    drive is not proved off, the program tries again to take the power off.

    Args:
        servo: The drive.
        watch: Runs one control cycle; called while the drive brakes, also so that the recording
            contains the braking. The result is the state that the drive sent in this cycle, or
            None.
        clock: Clock of the link, which measures the time of the braking.
        cycle_ns: Control cycle, ns.
        brake: Whether to start with a quick stop, as after every end of a run but a regular end.
        hurry: Whether the operator has pressed Ctrl-C again; the power then goes off without
            waiting for the end of the ramp.
        watched: Whether the drive de-energises itself when it is no longer commanded.
        insistent: Whether to make more attempts to take the power off, with cycles after each
            command without answer: the process data of these cycles repeat the command.
        off: Observer of the drive; None to observe the motor alone, without the limits of a bench.
        insist: Called if the drive is not proved off: a guardian goes on.

    Returns:
        The final state of the drive; unexpected exceptions are in ``unforeseen``.
    """
    steps = Steps()
    if brake:
        brake_with_ramp(servo, watch, clock, cycle_ns, hurry, steps, watched)
    off = off or OffProof(servo, clock)
    state, proof = None if brake else steps.state(servo), None
    patience_s = PATIENCE_S
    for _ in range(INSISTENT_ATTEMPTS if insistent else DISABLE_ATTEMPTS):
        known = len(steps.problems)
        if state is not ServoState.SWITCH_ON_DISABLED or proof is not None:
            steps.attempt(servo.disable)
        if insistent and len(steps.problems) > known:
            steps.attempt(lambda: _repeat(steps, watch, clock))
        state = steps.state(servo)
        if state is None or state.energised:
            continue
        proof = off.prove(steps, patience_s)
        patience_s = 0.0
        if proof.off:
            break
    if proof is None or state is None or state.energised:
        proof = Proof(state, doubt="its state could not be read")
    if not proof.off:
        steps.attempt(insist)
    return observed(proof, steps, watched)


def observed(proof: Proof, steps: Steps | None = None, watched: bool = True) -> SafeState:
    """Return what was observed as the final state of the drive, with the errors of the steps."""
    state, steps = proof.state, steps or Steps()
    return SafeState(
        verified=proof.off,
        state="unknown" if state is None else state.value,
        problems=tuple(dict.fromkeys(steps.problems)),
        watched=watched,
        unforeseen=tuple(steps.unforeseen),
        current_A=proof.current_A,
        motion_rad_s=proof.motion_rad_s,
        doubt="" if state is None or state.energised else proof.doubt,
        cut=steps.cut,
        joint_read=proof.joint_read,
    )


def attempt_all(*steps: Callable[[], object]) -> tuple[BaseException, ...]:
    """Run every step, also after steps that raised errors; return the unexpected errors."""
    taken = Steps()
    for step in steps:
        taken.attempt(step)
    return tuple(taken.unforeseen)


def give_back(servo: Servo, own: ServoLimits, safe: SafeState) -> tuple[BaseException, ...]:
    """Write the drive's own limits back, so that a run's tighter limits do not restrict the next
    run.

    The limits are written only if the drive is verified off. A drive that rejects its own limits
    keeps the tighter limits, which is safe.

    Returns:
        Unexpected exceptions, as in :attr:`SafeState.unforeseen`.
    """
    return attempt_all(lambda: servo.write_limits(own)) if safe.verified else ()
