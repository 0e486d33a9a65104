"""Carries out the phases of a run (load, prepare, enable, ...); one function for each phase."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from drivers.interfaces import ServoLimits, ServoState
from rig.common.sample import Phase, Sample
from rig.config.sequence import Array, approach
from rig.control.cycle import Cycle, Progress
from rig.control.operator import Operator, Verb
from rig.planning.feedforward import Compensator
from rig.planning.hot_fire import Regulator, hot_fire_words
from rig.planning.plan import APPROACH_SPEED_SHARE, HOLD_S, Plan, PlannedStage, with_mass
from rig.runs.recorder import Recorder
from rig.runs.run import RunFolder
from rig.runs.run_record import Verdict
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.weighing.weight_check import Scale, measured_level
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import require_within_own, require_written
from rig.wiring.off import BEFORE_PROMPT
from rig.wiring.preflight import require_ready


class Event(Enum):
    """How a phase ended."""

    DONE = "done"
    FIRST_PASS = "first pass"
    NEXT_REPEAT = "next repeat"
    NEXT_STAGE = "next stage"
    REPEAT_STAGE = "repeat stage"


TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = {
    (Phase.LOAD, Event.DONE): Phase.PREPARE,
    (Phase.LOAD, Event.REPEAT_STAGE): Phase.LOAD,
    (Phase.PREPARE, Event.DONE): Phase.ENABLE,
    (Phase.ENABLE, Event.DONE): Phase.APPROACH,
    (Phase.ENABLE, Event.FIRST_PASS): Phase.FIRST_PASS,
    (Phase.FIRST_PASS, Event.DONE): Phase.WEIGH,
    (Phase.WEIGH, Event.DONE): Phase.APPROACH,
    (Phase.WEIGH, Event.FIRST_PASS): Phase.FIRST_PASS,
    (Phase.APPROACH, Event.DONE): Phase.SETTLE,
    (Phase.SETTLE, Event.DONE): Phase.EXCITE,
    (Phase.EXCITE, Event.DONE): Phase.HOLD,
    (Phase.HOLD, Event.NEXT_REPEAT): Phase.APPROACH,
    (Phase.HOLD, Event.DONE): Phase.RELEASE,
    (Phase.RELEASE, Event.DONE): Phase.BOUNDARY,
    (Phase.BOUNDARY, Event.NEXT_STAGE): Phase.LOAD,
    (Phase.BOUNDARY, Event.REPEAT_STAGE): Phase.LOAD,
    (Phase.BOUNDARY, Event.DONE): Phase.FINISHED,
}


def next_phase(phase: Phase, event: Event) -> Phase:
    """Return the next phase by the transition table; a ValueError names an illegal move."""
    try:
        return TRANSITIONS[phase, event]
    except KeyError:
        raise ValueError(
            f"no transition from phase {phase.value!r} on event {event.value!r}"
        ) from None


class WeightError(Exception):
    """The friction of a stage does not fit the confirmed mass."""


@dataclass(frozen=True)
class Console:
    """The operator's interface: prompts, stop button and progress display."""

    operator: Operator
    stop: StopButton
    progress: Progress


@dataclass(frozen=True)
class StartingPoint:
    """The point at which a run starts: stage, last excitation before, clearing of a fault."""

    stage: int = 0
    segment: int = 0
    reset_fault: bool = False


PREPARED: Final = frozenset({ServoState.READY, ServoState.SWITCHED_ON})
"""States without torque from which one or two commands give power."""


class PhaseHandlers:
    """The handlers of the phases of a run; ``own_limits`` of the drive are None until read."""

    def __init__(
        self,
        plan: Plan,
        devices: Devices,
        console: Console,
        recorder: Recorder,
        journal: RunFolder,
        scale: Scale,
        start: StartingPoint,
    ) -> None:
        self._plan = plan
        self._scale = scale
        self._devices = devices
        self._operator = console.operator
        self._recorder = recorder
        self._journal = journal
        self._stop = console.stop
        self.cycle = Cycle(
            plan.limits, plan.cycle_ns, devices, recorder, console.stop, console.progress
        )
        self.off = devices.off_proof(plan.limits)
        self._handlers: Mapping[Phase, Callable[[], Event]] = {
            Phase.LOAD: self._load,
            Phase.PREPARE: self._prepare,
            Phase.ENABLE: self._enable,
            Phase.FIRST_PASS: self._first_pass,
            Phase.WEIGH: self._weigh,
            Phase.APPROACH: self._approach,
            Phase.SETTLE: self._settle,
            Phase.EXCITE: self._excite,
            Phase.HOLD: self._hold,
            Phase.RELEASE: self._release,
            Phase.BOUNDARY: self._boundary,
        }
        self._stages = list(plan.stages)
        self._stage_index = start.stage
        self._repeat = 0
        self._segment = start.segment
        self._reset_fault = start.reset_fault
        self._pass = 0
        self._first_samples: list[Sample] = []
        self.own_limits: ServoLimits | None = None
        self._target = 0.0

    @property
    def stage(self) -> PlannedStage:
        """The present stage."""
        return self._stages[self._stage_index]

    def handle(self, phase: Phase) -> Event:
        """Execute a phase and return how it ended.

        Raises:
            TripError: A sample is outside a limit.
            WeightError: The friction of the stage does not fit the confirmed mass.
            OperatorStopError: The operator stopped the run.
            DeviceError: A device failed.
            StorageError: The recording or the journal cannot be written.
        """
        return self._handlers[phase]()

    def _load(self) -> Event:
        devices, stage = self._devices, self._plan.stages[self._stage_index]
        proof = self.off.require(BEFORE_PROMPT)
        if proof.state in PREPARED:
            # A person comes near the joint: a single command must not give power.
            devices.servo.disable()
            proof = self.off.require(BEFORE_PROMPT)
        seen = proof.seen
        if devices.hang is None and self.own_limits is None:
            # The devices are checked before a person hangs a weight, so that no weight is hung
            # for a run that does not start.
            limits, cycle_s = self._plan.servo_limits, self._plan.cycle_s
            for words in require_ready(devices, limits, cycle_s, self._reset_fault):
                self._operator.tell(f"warning: {words}")
        self._journal.stage_started(self._stage_index)
        planned = {"index": self._stage_index, "weight_kg": stage.weight_kg}
        self._event("prompt", **planned, **seen)
        hot = stage.stage == "hot_fire"
        if hot:
            self._operator.tell(hot_fire_words(stage.name, devices.ignite is not None))
        with self._stop.interruptible():
            confirmed = self._operator.confirm_weight(stage.name, stage.weight_kg)
        if isinstance(confirmed, Verb):
            if self._stage_index:
                self._stage_index -= 1
                self._event("repeat")
            else:
                self._operator.tell("there is no stage before this one")
            return Event.REPEAT_STAGE
        self._event("answer", weight_kg=confirmed)
        self._journal.weight_confirmed(self._stage_index, confirmed)
        # Force, feed-forward and weight check use the weighed mass, not the planned mass.
        self._stages[self._stage_index] = stage = with_mass(self._plan, stage, confirmed)
        # With the confirmation of the weight, the operator requests the enabling and the reset of
        # the latch.
        self.cycle.ask_reset()
        if self._reset_fault and devices.servo.state() is ServoState.FAULT:
            devices.servo.reset_fault()
            self._event("fault reset")
            self._operator.tell(
                "the drive was in fault; the fault is cleared, and the drive is still off"
            )
        if devices.hang is not None:
            devices.hang(self._operator.hangs(stage.name, stage.weight_kg))
        if hot and devices.ignite is not None:
            devices.ignite()
            self._event("ignition")
        return Event.DONE

    def _prepare(self) -> Event:
        devices, plan = self._devices, self._plan
        devices.prepare(plan.cycle_s)
        servo = devices.servo
        if self.own_limits is None:
            own, unheld = servo.read_limits(), servo.lacks(plan.cycle_s).limits
            steps, places = servo.limit_steps(), servo.limit_places
            require_within_own(plan.servo_limits, own, steps, places, unheld)
            self.own_limits = own
        servo.write_limits(plan.servo_limits)
        require_written(servo, plan.servo_limits, plan.cycle_s)
        self._event("stage start")
        return Event.DONE

    def _enable(self) -> Event:
        servo = self._devices.servo
        servo.enable()
        self._recorder.frames(self.cycle.now_ns, self._devices.link.take_frames())
        self._target = servo.sample().motor_angle_rad / self._plan.limits.gear_ratio
        self.cycle.begin(self._target, self.stage.time_limit_s)
        self._pass = 0
        return Event.FIRST_PASS if self.stage.first_passes else Event.DONE

    def _first_pass(self) -> Event:
        planned = self.stage.first_passes[self._pass]
        cycle, plan = self.cycle, self._plan
        self._event("first pass", amplitude=planned.amplitude)
        cycle.use(planned.move_limits)
        speed = min(plan.approach_speed, APPROACH_SPEED_SHARE * planned.move_limits.speed)
        self._go(planned.targets, speed)
        self._rest(self.stage.settle_s)
        cycle.use(planned.limits)
        self._first_samples = []
        self._follow(planned.targets.tolist(), keep=self._first_samples.append)
        self._prove_units()
        cycle.use(plan.limits)
        return Event.DONE

    def _prove_units(self) -> None:
        """Compare the reports of the devices; after too little motion, go on in the next pass."""
        if self.cycle.units is None:
            return
        proof = self.cycle.units.require()
        shown = {
            name: None if math.isnan(factor) else factor for name, factor in proof.found.items()
        }
        self._event("units", factors=shown)
        if proof.moved:
            self.cycle.units = None
            if proof.unproven:
                self._operator.tell(proof.unproven)
        self.cycle.resume()

    def _weigh(self) -> Event:
        """Compare friction at low amplitude with the mass; without motion, ask for another pass."""
        level = measured_level(self._first_samples, self._plan)
        self._first_samples = []
        undecided = level is None or self.cycle.units is not None
        if undecided and self._pass + 1 < len(self.stage.first_passes):
            self._pass += 1
            self.cycle.resume()
            return Event.FIRST_PASS
        weighing = self._scale.weigh(self.stage, level)
        self._event(
            "weight check",
            verdict=weighing.verdict.value,
            measured_kg=weighing.measured_kg,
            message=weighing.message,
        )
        self._journal.weighed(weighing)
        self.cycle.resume()
        if weighing.verdict is Verdict.WRONG:
            raise WeightError(weighing.message)
        if weighing.verdict is Verdict.UNCHECKED:
            self._operator.tell(weighing.message)
        return Event.DONE

    def _approach(self) -> Event:
        self._go(self.stage.targets, self._plan.approach_speed)
        return Event.DONE

    def _settle(self) -> Event:
        self._rest(self.stage.settle_s)
        return Event.DONE

    def _excite(self) -> Event:
        self._segment += 1
        place = {"index": self._stage_index, "repeat": self._repeat + 1}
        self._event("segment", number=self._segment, **place)
        self._journal.segment_started(
            self._stage_index, self._repeat + 1, self._segment, self.cycle.next_s
        )
        if self.stage.flow is None:
            self._follow(self.stage.targets.tolist(), self._segment, compensate=self._compensator())
        else:
            flow = self.stage.flow
            regulator = Regulator(flow.law, flow.pressures.tolist(), self._target)
            self.cycle.follow(regulator.targets(), self._segment, self.stage.name, regulator.see)
            self._target = self.cycle.target
        self._journal.segment_finished(self._segment, self.cycle.next_s)
        return Event.DONE

    def _hold(self) -> Event:
        self._rest(HOLD_S)
        self._repeat += 1
        return Event.NEXT_REPEAT if self._repeat < self.stage.repeats else Event.DONE

    def _release(self) -> Event:
        self._devices.servo.disable()
        self.cycle.end()
        if self.stage.stage == "hot_fire" and self._devices.hang is not None:
            self._devices.hang(0.0)
        self._recorder.frames(self.cycle.now_ns, self._devices.link.take_frames())
        self._journal.stage_finished(self._stage_index)
        seen = self.off.require("at the end of the stage").seen
        self._event("stage end", **seen)
        self._repeat = 0
        return Event.DONE

    def _boundary(self) -> Event:
        verb = Verb.GO_ON
        if self._stop.pausing:
            self._event("paused")
            with self._stop.interruptible():
                verb = self._operator.paused(self.stage.name, self._stop)
            self._event(verb.value)
        if verb is Verb.ABORT:
            raise OperatorStopError("aborted by the operator between stages")
        if verb is Verb.REPEAT:
            return Event.REPEAT_STAGE
        if self._stage_index + 1 == len(self._plan.stages):
            return Event.DONE
        self._stage_index += 1
        return Event.NEXT_STAGE

    def _event(self, name: str, **details: Any) -> None:
        self._recorder.event(self.cycle.now_ns, name, stage=self.stage.name, **details)

    def _go(self, targets: Array, speed: float) -> None:
        """Move the joint to the first of the targets."""
        self._follow(approach(self._target, float(targets[0]), speed, self._plan.cycle_s).tolist())

    def _rest(self, duration_s: float) -> None:
        self._follow([self._target] * round(duration_s / self._plan.cycle_s))

    def _compensator(self) -> Compensator | None:
        offsets, plan = self.stage.offsets, self._plan
        return (
            None if offsets is None else Compensator(offsets, plan.limits.gear_ratio, plan.cycle_s)
        )

    def _follow(
        self,
        targets: list[float],
        segment: int = 0,
        keep: Callable[[Sample], object] | None = None,
        compensate: Compensator | None = None,
    ) -> None:
        self.cycle.follow(targets, segment, self.stage.name, keep, compensate)
        if targets:
            self._target = targets[-1]
