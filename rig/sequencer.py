"""Runs a plan on a bench: a transition table, one handler a phase, and a teardown that always happens."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from drivers.errors import DeviceError, StateError
from rig.cycle import Cycle, Devices, Progress, TripError
from rig.operator import Operator, OperatorStopError, StopButton
from rig.phases import Event, Phase, next_phase
from rig.plan import HOLD_S, Plan, PlannedStage
from rig.recorder import Recorder
from rig.safety import Check, Trip
from rig.sequence import approach
from rig.teardown import SafeState, make_safe


class Ending(Enum):
    """How a run ended."""

    DONE = "done"
    TRIPPED = "tripped"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class Outcome:
    """The end of a run: how, why, what to do, and how the drive was left."""

    ending: Ending
    message: str
    safe: SafeState
    trip: Trip | None = None


class Journal(Protocol):
    """Keeps the state of the run on disk."""

    def stage_started(self, index: int) -> None:
        """Stage ``index`` begins."""
        ...

    def stage_finished(self, index: int) -> None:
        """Stage ``index`` is complete and de-energised."""
        ...

    def segment_started(self, stage: int, segment: int, time: float) -> None:
        """The excitation numbered ``segment`` begins at ``time`` s of the run."""
        ...

    def segment_finished(self, segment: int, time: float) -> None:
        """It is complete."""
        ...


class Sequencer:
    """One run of one plan.

    Args:
        plan: What to do.
        devices: What to do it with; the link is open.
        operator: Who hangs the weights.
        recorder: Open recording.
        journal: State on disk.
        stop: Looked at every cycle.
        progress: Told how it goes.
    """

    def __init__(
        self,
        plan: Plan,
        devices: Devices,
        operator: Operator,
        recorder: Recorder,
        journal: Journal,
        stop: StopButton,
        progress: Progress,
    ) -> None:
        self._plan = plan
        self._devices = devices
        self._operator = operator
        self._recorder = recorder
        self._journal = journal
        self._stop = stop
        self._cycle = Cycle(plan, devices, recorder, stop, progress)
        self._handlers: Mapping[Phase, Callable[[], Event]] = {
            Phase.LOAD: self._load,
            Phase.PREPARE: self._prepare,
            Phase.ENABLE: self._enable,
            Phase.APPROACH: self._approach,
            Phase.SETTLE: self._settle,
            Phase.EXCITE: self._excite,
            Phase.HOLD: self._hold,
            Phase.RELEASE: self._release,
        }
        self._stage_index = 0
        self._repeat = 0
        self._segment = 0
        self._target = 0.0
        self.phase = Phase.LOAD

    @property
    def cycle(self) -> Cycle:
        """The control cycle, with its counts."""
        return self._cycle

    @property
    def _stage(self) -> PlannedStage:
        return self._plan.stages[self._stage_index]

    def run(self) -> Outcome:
        """Run to the end, or to the first thing that stops it. The drive is made safe in every case.

        Raises:
            Exception: Only what is not foreseen (a defect in this program), after the drive was made safe.
        """
        ending = None
        try:
            ending, message, trip = self._attempt()
        finally:
            brake = ending is not Ending.DONE
            safe = make_safe(self._devices.servo, self._cycle.watch, self._plan.cycle_ns, brake=brake)
        if ending is Ending.DONE and not safe.verified:
            ending = Ending.FAILED
        outcome = Outcome(ending, f"{message}; {safe.message}", safe, trip)
        return self._note_end(outcome)

    def _attempt(self) -> tuple[Ending, str, Trip | None]:
        try:
            while self.phase is not Phase.FINISHED:
                self._stop.check()
                self.phase = next_phase(self.phase, self._handlers[self.phase]())
        except TripError as error:
            ending = Ending.FAILED if error.trip.check in (Check.SAMPLE_AGE, Check.DRIVE_STATE) else Ending.TRIPPED
            return ending, self._where(str(error)), error.trip
        except OperatorStopError as error:
            return Ending.STOPPED, self._where(str(error)), None
        except KeyboardInterrupt:
            return Ending.STOPPED, self._where("stopped by the operator"), None
        except DeviceError as error:
            return Ending.FAILED, self._where(str(error)), None
        except OSError as error:
            reason = error.strerror or str(error)
            return (
                Ending.FAILED,
                self._where(f"the run folder cannot be written ({reason}); free disk space, then run again"),
                None,
            )
        return Ending.DONE, f"all {len(self._plan.stages)} stages done", None

    def _where(self, message: str) -> str:
        return f"stage {self._stage.name}, phase {self.phase.value}: {message}"

    def _note_end(self, outcome: Outcome) -> Outcome:
        """Put the ending into the recording, unless it is the recording that failed."""
        try:
            self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
            self._recorder.event(
                self._cycle.now_ns, outcome.ending.value, message=outcome.message, phase=self.phase.value
            )
        except OSError as error:
            if outcome.ending is Ending.DONE:
                text = f"the recording's end cannot be written ({error.strerror}); {outcome.safe.message}"
                return Outcome(Ending.FAILED, text, outcome.safe)
        return outcome

    def _load(self) -> Event:
        devices, stage = self._devices, self._stage
        state = devices.servo.state()
        if state.energised:
            raise StateError(f"the drive is in {state.value!r} before the weight prompt; it must be de-energised")
        self._journal.stage_started(self._stage_index)
        self._recorder.event(self._cycle.now_ns, "prompt", stage=stage.name, weight_kg=stage.weight_kg)
        with self._stop.interruptible():
            confirmed = self._operator.confirm_weight(stage.name, stage.weight_kg)
        self._recorder.event(self._cycle.now_ns, "answer", stage=stage.name, weight_kg=confirmed)
        if devices.hang is not None:
            devices.hang(stage.weight_kg)
        return Event.DONE

    def _prepare(self) -> Event:
        devices, plan = self._devices, self._plan
        devices.servo.prepare(plan.cycle_s)
        devices.encoder.prepare(plan.cycle_s)
        devices.servo.write_limits(plan.servo_limits)
        self._recorder.event(self._cycle.now_ns, "stage start", stage=self._stage.name)
        return Event.DONE

    def _enable(self) -> Event:
        servo = self._devices.servo
        servo.enable()
        self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
        self._target = servo.sample().motor_angle_rad / self._plan.limits.gear_ratio
        self._cycle.begin(self._target)
        return Event.DONE

    def _approach(self) -> Event:
        end = float(self._stage.targets[0])
        self._follow(approach(self._target, end, self._plan.approach_speed, self._plan.cycle_s).tolist())
        return Event.DONE

    def _settle(self) -> Event:
        self._rest(self._stage.settle_s)
        return Event.DONE

    def _excite(self) -> Event:
        self._segment += 1
        self._journal.segment_started(self._stage_index, self._segment, self._cycle.next_s)
        self._follow(self._stage.targets.tolist(), self._segment)
        self._journal.segment_finished(self._segment, self._cycle.next_s)
        return Event.DONE

    def _hold(self) -> Event:
        self._rest(HOLD_S)
        self._repeat += 1
        return Event.NEXT_REPEAT if self._repeat < self._stage.repeats else Event.DONE

    def _release(self) -> Event:
        self._devices.servo.disable()
        self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
        self._recorder.event(self._cycle.now_ns, "stage end", stage=self._stage.name)
        self._journal.stage_finished(self._stage_index)
        if self._stage_index + 1 == len(self._plan.stages):
            return Event.DONE
        self._stage_index += 1
        self._repeat = 0
        return Event.NEXT_STAGE

    def _rest(self, duration_s: float) -> None:
        self._follow([self._target] * round(duration_s / self._plan.cycle_s))

    def _follow(self, targets: list[float], segment: int = 0) -> None:
        self._cycle.follow(targets, segment, self._stage.name)
        if targets:
            self._target = targets[-1]
