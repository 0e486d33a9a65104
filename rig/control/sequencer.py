"""Runs a plan on a bench, phase by phase, and switches the drive off at the end in every case."""

from __future__ import annotations

from dataclasses import dataclass, replace

from drivers.errors import DeviceError, DriveFault
from rig.common.errors import StorageError
from rig.common.sample import Phase
from rig.control.cycle import Cycle, TripError
from rig.control.phase_handlers import (
    Console,
    PhaseHandlers,
    StartingPoint,
    WeightError,
    next_phase,
)
from rig.control.safety import Check, Trip
from rig.planning.plan import Plan
from rig.runs.recorder import Recorder
from rig.runs.run import RunFolder
from rig.runs.run_record import Ending
from rig.terminal.stop_button import OperatorStopError
from rig.weighing.weight_check import Scale
from rig.wiring.devices import Devices
from rig.wiring.off import words_of
from rig.wiring.preflight import RESET_HINT
from rig.wiring.teardown import SafeState, attempt_all, give_back, make_safe


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run; ``error`` is a defect of this program, raised after all is recorded."""

    ending: Ending
    message: str
    safe: SafeState
    trip: Trip | None = None
    error: BaseException | None = None


_FAILURES = frozenset(
    {Check.SAMPLE_AGE, Check.PAUSE, Check.DRIVE_STATE, Check.LATENESS, Check.SLEEP}
)
"""Checks that fail by a device, the bus or the computer, not by a physical limit."""


class Sequencer:
    """One run of one plan."""

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
        self._devices = devices
        self._operator = console.operator
        self._stop = console.stop
        self._recorder = recorder
        self._journal = journal
        self._handlers = PhaseHandlers(plan, devices, console, recorder, journal, scale, start)
        self._cycle = self._handlers.cycle
        self.phase = Phase.LOAD

    @property
    def cycle(self) -> Cycle:
        """The control cycle, with its counters."""
        return self._cycle

    @property
    def stage(self) -> str:
        """Name of the present stage."""
        return self._handlers.stage.name

    def run(self) -> Outcome:
        """Run the plan until its end or the first stop, and bring the drive into a safe state.

        The final state of the drive is shown and recorded as soon as it is known. The method raises
        no error; an unexpected exception becomes the ``error`` of the outcome.
        """
        ending, message, trip, error = self._attempt()
        # Before the preparation there are no exchanges; the drive brakes all the same.
        unprepared = self.phase is Phase.LOAD and not self._cycle.count
        safe = make_safe(
            self._devices.servo,
            self._wait_cycle if unprepared else self._cycle.watch,
            self._devices.link.clock,
            self._plan.cycle_ns,
            brake=ending is not Ending.DONE,
            hurry=self._stop.hurry(),
            watched=self._devices.link.has_watchdog,
            insistent=not self._devices.link.has_watchdog,
            off=self._handlers.off,
            insist=self._devices.insist,
        )
        units = self._cycle.units
        words = [message]
        unforeseen = [*safe.unforeseen]
        if units is not None:
            unforeseen += attempt_all(lambda: words.append(units.after_braking(message)))
        message = words[-1]
        if ending is Ending.DONE and not safe.verified:
            ending = Ending.FAILED
        outcome = Outcome(ending, f"{message}; {safe.message}", safe, trip, error)
        unforeseen += self._announce(outcome)
        if self._handlers.own_limits is not None:
            unforeseen += give_back(self._devices.servo, self._handlers.own_limits, safe)
        noted: list[Outcome] = []
        unforeseen += attempt_all(lambda: noted.append(self._note_end(outcome)))
        outcome = noted[0] if noted else outcome
        if unforeseen:
            outcome = replace(outcome, ending=Ending.CRASHED, error=outcome.error or unforeseen[0])
        return outcome

    def _wait_cycle(self) -> None:
        clock = self._devices.link.clock
        clock.sleep_until_ns(clock.now_ns() + self._plan.cycle_ns)

    def _attempt(self) -> tuple[Ending, str, Trip | None, BaseException | None]:
        """Run the phases; return the ending, a text on it, and the trip or defect, if any."""
        try:
            self._recorder.begin(self._cycle.start_ns)
            while self.phase is not Phase.FINISHED:
                self._stop.check()
                # Record the frames outside the control cycle first, before a further failure is
                # possible.
                self._recorder.frames(self._cycle.now_ns, self._devices.link.take_frames())
                if self._devices.observer is not None:
                    self._devices.observer(self.stage, self.phase)
                self.phase = next_phase(self.phase, self._handlers.handle(self.phase))
        except TripError as trip:
            ending = Ending.FAILED if trip.trip.check in _FAILURES else Ending.TRIPPED
            return ending, self._where(trip.event), trip.trip, None
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
        except BaseException as defect:  # noqa: BLE001 - raised again after the drive is made safe
            words = f"the program failed ({words_of(defect)})"
            return Ending.CRASHED, self._where(words), None, defect
        return Ending.DONE, f"all {len(self._plan.stages)} stages done", None, None

    def _announce(self, outcome: Outcome) -> tuple[BaseException, ...]:
        """Show and record the final state of the drive, before a further failure is possible."""
        ending = outcome.ending
        return attempt_all(
            lambda: self._operator.result(
                f"{ending.value}: {outcome.message}", ending is Ending.DONE
            ),
            lambda: self._journal.ended(ending.value, outcome.message, outcome.safe.verified),
        )

    def _where(self, message: str) -> str:
        return f"stage {self.stage}, phase {self.phase.value}: {message}"

    def _note_end(self, outcome: Outcome) -> Outcome:
        """Write the ending into the recording, unless the recording itself failed."""
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
