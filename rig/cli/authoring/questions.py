"""Questions whose answers make a file: put at the terminal, given as options, or left at their
defaults.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import click

from rig.common.errors import InputError
from rig.terminal.prompt import Asker, InputEndedError

if TYPE_CHECKING:
    Kind = click.ParamType[Any]
else:
    # Older versions of click have no type argument.
    Kind = click.ParamType

Answers = dict[str, Any]
Derived = Callable[[Mapping[str, Any]], Any]
"""A default that follows from the answers before."""


class Number(Kind):
    """A finite number above a bound; a decimal comma is read as well.

    Args:
        above: What it must be greater than; None for any.
        at_least: What it may not be less than; None for any.
    """

    name = "number"

    def __init__(self, above: float | None = 0.0, at_least: float | None = None) -> None:
        self._above = above if at_least is None else None
        self._at_least = at_least

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or fail with words."""
        try:
            number = float(str(value).strip().replace(",", "."))
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not finite", param, ctx)
        if self._above is not None and not number > self._above:
            self.fail(f"{number:g} must be above {self._above:g}", param, ctx)
        if self._at_least is not None and number < self._at_least:
            self.fail(f"{number:g} must be at least {self._at_least:g}", param, ctx)
        return number


class Numbers(Kind):
    """Positive numbers between commas or blanks; none is an empty list."""

    name = "numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers in the order given, or fail with words."""
        if isinstance(value, tuple):
            return value
        words = str(value).replace(",", " ").split()
        if words == ["none"]:
            return ()
        return tuple(Number().convert(word, param, ctx) for word in words)


@dataclass(frozen=True)
class Question:
    """One thing to know.

    Attributes:
        name: Of the answer; with dashes, of the option.
        words: What is asked for, for the prompt and the help of the option.
        unit: Unit of the answer; empty for none.
        kind: Reads the answer.
        default: Taken when nothing is typed: a value, or a function of the answers before; None for
            an answer that must be given.
        when: Whether it is asked at all, from the answers before.
        why: What to do where it has no default, for the message.
    """

    name: str
    words: str
    unit: str = ""
    kind: Kind = field(default_factory=Number)
    default: Any = None
    when: Callable[[Mapping[str, Any]], bool] = lambda answers: True
    why: str = "it has no default"

    @property
    def option(self) -> str:
        """The option that answers it."""
        return f"--{self.name.replace('_', '-')}"

    def default_for(self, answers: Mapping[str, Any]) -> Any:
        """Return the default after the answers before; None for none."""
        return self.default(answers) if callable(self.default) else self.default

    def prompt(self, default: Any) -> str:
        """Return what is shown at the terminal."""
        unit = f", {self.unit}" if self.unit else ""
        choices = (
            f" ({', '.join(self.kind.choices)})" if isinstance(self.kind, click.Choice) else ""
        )
        return f"{self.words}{unit}{choices}{'' if default is None else f' [{shown(default)}]'}: "


def shown(value: Any) -> str:
    """Return an answer as it would be typed."""
    if isinstance(value, tuple):
        return ",".join(shown(item) for item in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def options(questions: Iterable[Question]) -> Callable[[Any], Any]:
    """Return a decorator that gives a command an option for each question."""

    def decorate(command: Any) -> Any:
        for question in reversed(tuple(questions)):
            unit = f", {question.unit}" if question.unit else ""
            static = question.default is not None and not callable(question.default)
            default = f" [default: {shown(question.default)}]" if static else ""
            text = f"{question.words}{unit}.{default}"
            command = click.option(question.option, question.name, type=question.kind, help=text)(
                command
            )
        return command

    return decorate


def ask_all(
    questions: Iterable[Question],
    given: Mapping[str, Any],
    asker: Asker | None,
    tell: Callable[[str], None],
) -> Answers:
    """Return the answer to every question that applies.

    Args:
        questions: In order.
        given: Answers by name that were given as options; None for those that were not.
        asker: Puts the others to the user; None to take the defaults.
        tell: Says what is wrong with an answer.

    Raises:
        InputError: A question without default is not answered; lists them all. Or an option is
            given that does not apply.
    """
    answers: Answers = {}
    missing = []
    for question in questions:
        value = given.get(question.name)
        if not question.when(answers):
            if value is not None:
                missing.append(
                    f"{question.option}: does not apply to the other choices; leave it out"
                )
            continue
        default = question.default_for(answers)
        if value is None and asker is not None:
            value = _ask(question, default, asker, tell)
        if value is None:
            value = default
        if value is None:
            missing.append(f"{question.option}: missing; {question.why}")
            # The questions that follow are still looked at, so that all that is missing is told at
            # once.
            value = 1.0 if isinstance(question.kind, Number) else ""
        answers[question.name] = value
    if missing:
        raise InputError(missing)
    return answers


def _ask(question: Question, default: Any, asker: Asker, tell: Callable[[str], None]) -> Any:
    """Put one question until the answer can be read."""
    while True:
        try:
            typed = asker.ask(question.prompt(default))
        except InputEndedError as error:
            raise InputError(
                f"{question.option}: {error} before this was answered; give the option, or --yes "
                f"for the defaults"
            ) from error
        if not typed:
            if default is not None:
                return default
            tell(f"an answer is needed: {question.why}")
            continue
        try:
            return question.kind.convert(typed, None, None)
        except click.BadParameter as error:
            tell(error.message)
