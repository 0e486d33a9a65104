"""Runs a plan on a bench: a transition table, one handler a phase, and a teardown that always
happens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from drivers.errors import DeviceError, DriveFault
from drivers.interfaces import ServoLimits, ServoState
from rig.common.errors import StorageError
from rig.common.phase import Phase
from rig.common.sample import Sample
from rig.config.sequence import approach
from rig.control.cycle import Cycle, Progress, TripError
from rig.control.operator import Operator, Verb
from rig.control.phases import Event, next_phase
from rig.control.safety import Check, Trip
from rig.planning.feedforward import Compensator
from rig.planning.flow_control import Regulator
from rig.planning.hot_fire import hot_fire_words
from rig.planning.plan import APPROACH_SPEED_SHARE, HOLD_S, Plan, PlannedStage, with_mass
from rig.runs.journal import Journal
from rig.runs.recorder import Recorder
from rig.runs.run_record import Ending, Verdict
from rig.terminal.stop_button import OperatorStopError, StopButton
from rig.weighing.scale import Scale, measured_level
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import require_held, require_within_own
from rig.wiring.preflight import RESET_HINT, energised, require_ready
from rig.wiring.teardown import SafeState, attempt_all, give_back, make_safe, words_of


@dataclass(frozen=True)
class Outcome:
    """The end of a run: how, why, what to do, and how the drive was left.

    ``error`` is what nobody foresaw: a defect of this program, to be raised once everything is
    written down.
    """

    ending: Ending
    message: str
    safe: SafeState
    trip: Trip | None = None
    error: BaseException | None = None


class WeightError(Exception):
    """The friction of a stage is not that of the confirmed mass."""


_FAILURES = frozenset({Check.SAMPLE_AGE, Check.DRIVE_STATE, Check.LATENESS})
"""Trips that say that a device, the bus or this computer failed, rather than that the bench went
too far.
"""


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
        scale: Checks the weights.
        start: Index of the stage to begin with.
        segment: Number of the last excitation of an earlier part of the run.
        reset_fault: Clear a fault that the drive is in, once the operator has answered the weight
            prompt.
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
        scale: Scale,
        start: int = 0,
        segment: int = 0,
        reset_fault: bool = False,
    ) -> None:
        self._plan = plan
        self._scale = scale
        self._devices = devices
        self._operator = operator
        self._recorder = recorder
        self._journal = journal
        self._stop = stop
        self._cycle = Cycle(plan.limits, plan.cycle_ns, devices, recorder, stop, progress)
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
        self._stage_index = start
        self._repeat = 0
        self._segment = segment
        self._reset_fault = reset_fault
        self._pass = 0
        self._first_samples: list[Sample] = []
        self._own_limits: ServoLimits | None = None
        self._target = 0.0
        self.phase = Phase.LOAD

    @property
    def cycle(self) -> Cycle:
        """The control cycle, with its counts."""
        return self._cycle

    @property
    def _stage(self) -> PlannedStage:
        return self._stages[self._stage_index]

    def run(self) -> Outcome:
        """Run to the end, or to the first thing that stops it, and make the drive safe.

        How the drive was left is shown and written down the moment it is known. Never raises; what
        nobody foresaw is the outcome's ``error``.
        """
        ending, message, trip, error = self._attempt()
        presses = self._stop.presses
        safe = make_safe(
            self._devices.servo,
            self._cycle.watch,
            self._plan.cycle_ns,
            brake=ending is not Ending.DONE,
            hurry=lambda: self._stop.presses > presses,
            watched=self._devices.link.has_watchdog,
        )
        if ending is Ending.DONE and not safe.verified:
            ending = Ending.FAILED
        outcome = Outcome(ending, f"{message}; {safe.message}", safe, trip, error)
        unforeseen = [*safe.unforeseen, *self._announce(outcome)]
        if self._own_limits is not None:
            unforeseen += give_back(self._devices.servo, self._own_limits, safe)
        noted: list[Outcome] = []
        unforeseen += attempt_all(lambda: noted.append(self._note_end(outcome)))
        outcome = noted[0] if noted else outcome
        if unforeseen:
            outcome = replace(outcome, ending=Ending.CRASHED, error=outcome.error or unforeseen[0])
        return outcome

    def _attempt(self) -> tuple[Ending, str, Trip | None, BaseException | None]:
        """Run the phases; returns how they ended, in words, with the trip or the defect that ended
        them.
        """
        try:
            while self.phase is not Phase.FINISHED:
                self._stop.check()
                # What went over the wire outside the control cycle, before anything else can go
                # wrong.
                self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
                if self._devices.observer is not None:
                    self._devices.observer(self._stage.name, self.phase)
                self.phase = next_phase(self.phase, self._handlers[self.phase]())
        except TripError as trip:
            ending = Ending.FAILED if trip.trip.check in _FAILURES else Ending.TRIPPED
            return ending, self._where(str(trip)), trip.trip, None
        except WeightError as wrong:
            return Ending.TRIPPED, self._where(str(wrong)), None, None
        except OperatorStopError as stop:
            return Ending.STOPPED, self._where(str(stop)), None, None
        except KeyboardInterrupt:
            return Ending.STOPPED, self._where(self._stop.words), None, None
        except DeviceError as failure:
            hint = (
                RESET_HINT if isinstance(failure, DriveFault) and self.phase is Phase.ENABLE else ""
            )
            return Ending.FAILED, self._where(str(failure)) + hint, None, None
        except StorageError as failure:
            return Ending.FAILED, self._where(str(failure)), None, None
        except BaseException as defect:  # noqa: BLE001 the drive is made safe first; the session raises it again
            words = f"the program broke down ({words_of(defect)})"
            return Ending.CRASHED, self._where(words), None, defect
        return Ending.DONE, f"all {len(self._plan.stages)} stages done", None, None

    def _announce(self, outcome: Outcome) -> tuple[BaseException, ...]:
        """Show and write down how the drive was left, at once: nothing that follows can hide it."""
        ending = outcome.ending
        return attempt_all(
            lambda: self._operator.result(
                f"{ending.value}: {outcome.message}", ending is Ending.DONE
            ),
            lambda: self._journal.ended(ending.value, outcome.message, outcome.safe.verified),
        )

    def _where(self, message: str) -> str:
        return f"stage {self._stage.name}, phase {self.phase.value}: {message}"

    def _note_end(self, outcome: Outcome) -> Outcome:
        """Put the ending into the recording, unless it is the recording that failed."""
        try:
            self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
            self._recorder.event(
                self._cycle.now_ns,
                outcome.ending.value,
                message=outcome.message,
                phase=self.phase.value,
            )
        except StorageError as error:
            if outcome.ending is Ending.DONE:
                text = f"the recording lacks its end: {error}; {outcome.safe.message}"
                return replace(outcome, ending=Ending.FAILED, message=text)
        return outcome

    def _load(self) -> Event:
        devices, stage = self._devices, self._plan.stages[self._stage_index]
        if (error := energised(devices.servo.state())) is not None:
            raise error
        if devices.hang is None and self._own_limits is None:
            # Before a person hangs a weight for a run that would be refused.
            require_ready(devices, self._plan.servo_limits, self._plan.cycle_s, self._reset_fault)
        self._journal.stage_started(self._stage_index)
        self._recorder.event(
            self._cycle.now_ns,
            "prompt",
            stage=stage.name,
            index=self._stage_index,
            weight_kg=stage.weight_kg,
        )
        hot = stage.stage == "hot_fire"
        if hot:
            self._operator.tell(hot_fire_words(stage.name, devices.ignite is not None))
        with self._stop.interruptible():
            confirmed = self._operator.confirm_weight(stage.name, stage.weight_kg)
        if isinstance(confirmed, Verb):
            return self._go_back()
        self._recorder.event(self._cycle.now_ns, "answer", stage=stage.name, weight_kg=confirmed)
        self._journal.weight_confirmed(self._stage_index, confirmed)
        # What was weighed, not what was planned, is what force, feed-forward and weight check go
        # by.
        self._stages[self._stage_index] = stage = with_mass(
            self._plan, self._plan.stages[self._stage_index], confirmed
        )
        # Having confirmed the weight, the operator asks for the drive to be enabled, and so for the
        # latch's reset.
        self._cycle.ask_reset()
        if self._reset_fault and devices.servo.state() is ServoState.FAULT:
            devices.servo.reset_fault()
            self._recorder.event(self._cycle.now_ns, "fault reset", stage=stage.name)
            self._operator.tell(
                "the drive was in fault; the fault is cleared, and the drive is still off"
            )
        if devices.hang is not None:
            devices.hang(self._operator.hangs(stage.name, stage.weight_kg))
        if hot and devices.ignite is not None:
            devices.ignite()
            self._recorder.event(self._cycle.now_ns, "ignition", stage=stage.name)
        return Event.DONE

    def _go_back(self) -> Event:
        if self._stage_index:
            self._stage_index -= 1
            self._recorder.event(self._cycle.now_ns, "repeat", stage=self._stage.name)
        else:
            self._operator.tell("there is no stage before this one")
        return Event.REPEAT_STAGE

    def _prepare(self) -> Event:
        devices, plan = self._devices, self._plan
        devices.prepare(plan.cycle_s)
        steps = devices.servo.limit_steps()
        if self._own_limits is None:
            own = devices.servo.read_limits()
            require_within_own(plan.servo_limits, own, steps)
            self._own_limits = own
        devices.servo.write_limits(plan.servo_limits)
        require_held(devices.servo.read_limits(), plan.servo_limits, steps)
        self._recorder.event(self._cycle.now_ns, "stage start", stage=self._stage.name)
        return Event.DONE

    def _enable(self) -> Event:
        servo = self._devices.servo
        servo.enable()
        self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
        self._target = servo.sample().motor_angle_rad / self._plan.limits.gear_ratio
        self._cycle.begin(self._target, self._stage.time_limit_s)
        self._pass = 0
        return Event.FIRST_PASS if self._stage.first_passes else Event.DONE

    def _first_pass(self) -> Event:
        planned = self._stage.first_passes[self._pass]
        cycle, plan = self._cycle, self._plan
        self._recorder.event(
            cycle.now_ns, "first pass", stage=self._stage.name, amplitude=planned.amplitude
        )
        cycle.use(planned.move_limits)
        speed = min(plan.approach_speed, APPROACH_SPEED_SHARE * planned.move_limits.speed)
        self._follow(
            approach(self._target, float(planned.targets[0]), speed, plan.cycle_s).tolist()
        )
        self._rest(self._stage.settle_s)
        cycle.use(planned.limits)
        self._first_samples = []
        self._follow(planned.targets.tolist(), keep=self._first_samples.append)
        cycle.use(plan.limits)
        return Event.DONE

    def _weigh(self) -> Event:
        """Compare the friction met at low amplitude with the confirmed mass, while the drive holds
        still.

        That takes milliseconds, far less than its heartbeat watch allows. Where the joint has not
        moved there is nothing to compare, and a larger pass follows.
        """
        level = measured_level(self._first_samples, self._plan)
        self._first_samples = []
        if level is None and self._pass + 1 < len(self._stage.first_passes):
            self._pass += 1
            self._cycle.resume()
            return Event.FIRST_PASS
        weighing = self._scale.weigh(self._stage, level)
        self._recorder.event(
            self._cycle.now_ns,
            "weight check",
            stage=self._stage.name,
            verdict=weighing.verdict.value,
            measured_kg=weighing.measured_kg,
            message=weighing.message,
        )
        self._journal.weighed(weighing)
        self._cycle.resume()
        if weighing.verdict is Verdict.WRONG:
            raise WeightError(weighing.message)
        if weighing.verdict is Verdict.UNCHECKED:
            self._operator.tell(weighing.message)
        return Event.DONE

    def _approach(self) -> Event:
        end = float(self._stage.targets[0])
        self._follow(
            approach(self._target, end, self._plan.approach_speed, self._plan.cycle_s).tolist()
        )
        return Event.DONE

    def _settle(self) -> Event:
        self._rest(self._stage.settle_s)
        return Event.DONE

    def _excite(self) -> Event:
        self._segment += 1
        start = {"stage": self._stage.name, "index": self._stage_index, "repeat": self._repeat + 1}
        self._recorder.event(self._cycle.now_ns, "segment", number=self._segment, **start)
        self._journal.segment_started(
            self._stage_index, self._repeat + 1, self._segment, self._cycle.next_s
        )
        if self._stage.flow is None:
            self._follow(
                self._stage.targets.tolist(), self._segment, compensate=self._compensator()
            )
        else:
            flow = self._stage.flow
            regulator = Regulator(flow.law, flow.pressures.tolist(), self._target)
            self._cycle.follow(regulator.targets(), self._segment, self._stage.name, regulator.see)
            self._target = self._cycle.target
        self._journal.segment_finished(self._segment, self._cycle.next_s)
        return Event.DONE

    def _hold(self) -> Event:
        self._rest(HOLD_S)
        self._repeat += 1
        return Event.NEXT_REPEAT if self._repeat < self._stage.repeats else Event.DONE

    def _release(self) -> Event:
        self._devices.servo.disable()
        self._cycle.end()
        if self._stage.stage == "hot_fire" and self._devices.hang is not None:
            self._devices.hang(0.0)
        self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
        self._recorder.event(self._cycle.now_ns, "stage end", stage=self._stage.name)
        self._journal.stage_finished(self._stage_index)
        self._repeat = 0
        return Event.DONE

    def _boundary(self) -> Event:
        """Pause between two stages, or after the last, if that was asked for; the drive is
        de-energised.
        """
        verb = Verb.GO_ON
        if self._stop.pausing:
            self._recorder.event(self._cycle.now_ns, "paused", stage=self._stage.name)
            with self._stop.interruptible():
                verb = self._operator.paused(self._stage.name, self._stop)
            self._recorder.event(self._cycle.now_ns, verb.value, stage=self._stage.name)
        if verb is Verb.ABORT:
            raise OperatorStopError("aborted by the operator between stages")
        if verb is Verb.REPEAT:
            return Event.REPEAT_STAGE
        if self._stage_index + 1 == len(self._plan.stages):
            return Event.DONE
        self._stage_index += 1
        return Event.NEXT_STAGE

    def _rest(self, duration_s: float) -> None:
        self._follow([self._target] * round(duration_s / self._plan.cycle_s))

    def _compensator(self) -> Compensator | None:
        offsets, plan = self._stage.offsets, self._plan
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
        self._cycle.follow(targets, segment, self._stage.name, keep, compensate)
        if targets:
            self._target = targets[-1]
