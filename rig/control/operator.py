"""Prompts to the operator, who hangs the weights and types their mass, and automatic answers."""

from __future__ import annotations

import re
from enum import Enum
from typing import Protocol

from drivers.clock import NS, Clock, RealClock
from rig.terminal.control_socket import ControlSocket, Topic
from rig.terminal.prompt import Asker, InputEndedError, Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton

WEIGHT_TOLERANCE = 0.005  # default tolerance of the typed mass, relative to the planned mass
LEAST_TOLERANCE_KG = 0.001
"""Difference that is always allowed, kg: the resolution of scales; needed for an empty lever."""
_LOOK_NS = NS // 20
_PAUSE_QUESTION = "What now (go on, repeat, abort) [go on]: "
_ROUNDING = 1e-9
_MASS = re.compile(r"([+-]?\d+(?:[.,]\d*)?|[+-]?[.,]\d+)\s*(kg|g)?", re.IGNORECASE)
_UNIT_KG = {"kg": 1.0, "g": 1e-3}


class Verb(Enum):
    """Requests of the operator between stages, while the drive is de-energised."""

    GO_ON = "go on"
    REPEAT = "repeat"
    ABORT = "abort"


class Operator(Protocol):
    """Interface of the person or program that hangs the weights."""

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Return the confirmed mass, kg, or :attr:`Verb.REPEAT`; the drive is off."""
        ...

    def hangs(self, stage: str, weight_kg: float) -> float:
        """Return the mass that hangs on a simulated lever, kg."""
        ...

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Wait after ``stage`` until the operator chooses how to continue."""
        ...

    def tell(self, words: str) -> None:
        """Show a message that needs no answer, without blocking."""
        ...

    def result(self, words: str, good: bool) -> None:
        """Show how the run ended as soon as this is known, without blocking."""
        ...


class AutomaticOperator:
    """Answers every prompt with the plan (``--yes``); a second pause signal ends a pause."""

    def __init__(
        self,
        clock: Clock | None = None,
        screen: Screen | None = None,
        control: ControlSocket | None = None,
    ) -> None:
        self._control = control
        self._clock = clock or RealClock()
        self._screen = screen or Screen()

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Confirm the planned weight."""
        return weight_kg

    def hangs(self, stage: str, weight_kg: float) -> float:
        """Return the confirmed mass."""
        return weight_kg

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Wait for the next pause signal, or an answer on the control socket."""
        control = self._control
        if control is not None:
            control.begin(Topic.PAUSE)
        page = "" if control is None else "press `Go on` on the page of `rig console`, or "
        self.tell(
            f"Paused after stage {stage}; the drive is off.",
            f" To continue, {page}send SIGUSR1; to stop the run, press Ctrl-C.",
        )
        if control is not None:
            control.ask(_PAUSE_QUESTION)
        verb = Verb.GO_ON
        while stop.pausing:
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)
            self._screen.pump()
            if control is None or (answer := control.answered()) is None:
                continue
            known = _verb_of(answer)
            if known is None:
                control.ask(_PAUSE_QUESTION)
            else:
                verb, stop.pausing = known, False
        if control is not None:
            control.close_prompt()
        return verb

    def tell(self, words: str, typed: str = "") -> None:
        """Show a message, and what can be ``typed`` at the terminal; keep it for watchers."""
        self._screen.say(words + typed)
        if self._control is not None:
            self._control.tell(words)

    def result(self, words: str, good: bool) -> None:
        """Show how a run ended, on stdout if it is good, else on stderr, and on the socket."""
        if self._control is not None:
            self._control.ended(words, good)
        self._screen.say(words, err=not good)


class ConsoleOperator(AutomaticOperator):
    """Asks the operator at the terminal, with a relative tolerance of the typed mass."""

    def __init__(
        self,
        screen: Screen | None = None,
        asker: Asker | None = None,
        tolerance: float = WEIGHT_TOLERANCE,
        control: ControlSocket | None = None,
    ) -> None:
        super().__init__(screen=screen, control=control)
        self._asker = asker or Prompt(self._screen)
        self._tolerance = tolerance

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Ask until the typed mass is within the tolerance of the planned mass, or a verb is typed.

        The planned mass is not shown before the first answer, so that the operator reads the mass
        from the scales.

        Raises:
            OperatorStopError: The operator pressed Ctrl-C, typed ``abort`` or did not answer in
                time, or the input ended.
        """
        if self._control is not None:
            self._control.begin(Topic.WEIGHT)
        action = (
            "Hang the weight that is planned for this stage"
            if weight_kg
            else "Take every weight off the lever"
        )
        self.tell(
            f"Stage {stage}: the drive is off. {action}, and wait until the lever is at rest. "
            f"The run waits for your answer.",
            "\nThen type the mass that the scales show (0 for an empty lever), `repeat` or "
            "`abort`.",
        )
        allowed_kg = max(self._tolerance * weight_kg, LEAST_TOLERANCE_KG) * (1.0 + _ROUNDING)
        while True:
            try:
                typed = self._asker.ask("Mass on the lever, kg: ").lower()
            except InputEndedError as error:
                raise OperatorStopError(f"stopped at the weight prompt: {error}") from error
            except KeyboardInterrupt as error:
                raise OperatorStopError("stopped by the operator at the weight prompt") from error
            if typed == Verb.ABORT.value:
                raise OperatorStopError("aborted at the weight prompt")
            if typed == Verb.REPEAT.value:
                return Verb.REPEAT
            mass = parse_mass_kg(typed)
            if mass is None:
                self.tell(f"{typed!r} is not a mass such as 30.6 kg", ", `repeat` or `abort`")
            elif abs(mass - weight_kg) <= allowed_kg:
                return mass
            else:
                self.tell(
                    f"{mass:g} kg is not the planned {weight_kg:g} kg (tolerance {allowed_kg:.3g} "
                    f"kg): change the weight and type its mass",
                    ", or `abort`",
                )

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Ask the operator how to continue; no answer in time stops the run (OperatorStopError)."""
        if self._control is not None:
            self._control.begin(Topic.PAUSE)
        self.tell(f"Paused after stage {stage}; the drive is off.")
        try:
            answer = self._verb()
        except (InputEndedError, KeyboardInterrupt):
            answer = Verb.ABORT
        stop.pausing = False
        return answer

    def _verb(self) -> Verb:
        while True:
            typed = self._asker.ask(_PAUSE_QUESTION).lower()
            verb = _verb_of(typed)
            if verb is not None:
                return verb
            self.tell(f"{typed!r} is not one of the answers", " `go on`, `repeat`, `abort`")


def _verb_of(typed: str) -> Verb | None:
    """Return the verb that was typed, `go on` for an empty line; None if there is none."""
    return {"": Verb.GO_ON, **{verb.value: verb for verb in Verb}}.get(typed.lower())


def operator_for(
    yes: bool,
    screen: Screen,
    patience_s: float | None,
    tolerance: float,
    control: ControlSocket | None = None,
    only_there: bool = False,
) -> AutomaticOperator:
    """Return who answers the prompts of a run; ``only_there``: only on the control socket."""
    if yes:
        return AutomaticOperator(screen=screen, control=control)
    asker = Prompt(screen, patience_s=patience_s, control=control, only_there=only_there)
    return ConsoleOperator(screen, asker, tolerance=tolerance, control=control)


def parse_mass_kg(text: str) -> float | None:
    """Return a typed mass in kg (``30.6``, ``30,6``, ``30.6 kg``, ``30600 g``), or None."""
    found = _MASS.fullmatch(text.strip())
    if found is None:
        return None
    number, unit = found.groups()
    return float(number.replace(",", ".")) * _UNIT_KG[(unit or "kg").lower()]
