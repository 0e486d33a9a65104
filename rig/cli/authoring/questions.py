"""Questions whose answers define a file; the answers come from the terminal, from options or from
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


class Number(Kind):
    """A finite number above a bound; a decimal comma is accepted.

    Args:
        above: Exclusive lower bound, or None for no bound.
        at_least: Inclusive lower bound, or None for no bound.
        not_zero: Whether zero is refused.
    """

    name = "number"

    def __init__(
        self, above: float | None = 0.0, at_least: float | None = None, not_zero: bool = False
    ) -> None:
        self._above = above if at_least is None else None
        self._at_least = at_least
        self._not_zero = not_zero

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or fail with a message."""
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
        if self._not_zero and number == 0.0:
            self.fail("a scale of 0 makes all samples 0", param, ctx)
        return number


class Numbers(Kind):
    """Positive numbers separated by commas or blanks; an empty answer is an empty list."""

    name = "numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers in the order given, or fail with a message."""
        if isinstance(value, tuple):
            return value
        words = str(value).replace(",", " ").split()
        if words == ["none"]:
            return ()
        return tuple(Number().convert(word, param, ctx) for word in words)


@dataclass(frozen=True)
class Question:
    """A question to the user.

    Attributes:
        name: Name of the answer; with dashes, name of the option.
        words: Text for the prompt and the help of the option.
        unit: Unit of the answer; empty for none.
        kind: Reads the answer.
        default: Default: a value, or a function of the earlier answers, or None if an answer is
            required.
        when: Function of the earlier answers that decides whether the question is asked.
        why: Advice in the message if the question has no default.
        refusal: Function of an answer and the earlier answers; returns why the answer is refused,
            or None if the answer is accepted.
    """

    name: str
    words: str
    unit: str = ""
    kind: Kind = field(default_factory=Number)
    default: Any = None
    when: Callable[[Mapping[str, Any]], bool] = lambda answers: True
    why: str = "the value has no default"
    refusal: Callable[[Any, Mapping[str, Any]], str | None] = lambda answer, answers: None

    @property
    def option(self) -> str:
        """Name of the option that answers the question."""
        return f"--{self.name.replace('_', '-')}"

    def default_for(self, answers: Mapping[str, Any]) -> Any:
        """Return the default after the earlier answers, or None if the question has no default."""
        return self.default(answers) if callable(self.default) else self.default

    def prompt(self, default: Any) -> str:
        """Return the prompt for the terminal."""
        unit = f", {self.unit}" if self.unit else ""
        choices = (
            f" ({', '.join(self.kind.choices)})" if isinstance(self.kind, click.Choice) else ""
        )
        return f"{self.words}{unit}{choices}{'' if default is None else f' [{shown(default)}]'}: "


def shown(value: Any) -> str:
    """Return an answer in the form in which a user types it."""
    if isinstance(value, tuple):
        return ",".join(shown(item) for item in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def assumed(
    questions: Iterable[Question], given: Mapping[str, Any], answers: Answers, names: Iterable[str]
) -> str:
    """Return a note on the named values that no option gave, and that are therefore defaults; empty
    if there are none.

    Args:
        questions: The questions of the file.
        given: Answers given as options, by name, or None for options not given.
        answers: The answers, defaults included.
        names: Names of the answers that only a data sheet or a measurement can state.
    """
    wanted = frozenset(names)
    found = [
        f"{q.option} {shown(answers[q.name])} {q.unit}".rstrip()
        for q in questions
        if q.name in wanted and q.name in answers and given.get(q.name) is None
    ]
    if not found:
        return ""
    return (
        f"note: assumed, because no option states it: {', '.join(found)}; compare with the data "
        "sheet"
    )


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
    before: Mapping[str, Any] | None = None,
) -> Answers:
    """Return the answer to every question that applies.

    Args:
        questions: The questions in order.
        given: Answers given as options, by name, or None for options not given.
        asker: Asks the user the other questions; None to use the defaults.
        tell: Shows what is wrong with an answer. With an ``asker``, a refused option is reported
            and asked for again, so that no typed answer is lost.
        before: Answers of an earlier round, used as defaults.

    Raises:
        InputError: A question without default is not answered, or an option is refused or does not
            apply, in which case the message lists all; or the input ended.
    """
    asked = tuple(questions)
    before = before or {}
    answers: Answers = {}
    problems: list[str] = []
    refuse = problems.append if asker is None else tell
    for place, question in enumerate(asked):
        value = given.get(question.name)
        if not question.when(answers):
            if value is not None:
                refuse(f"{question.option}: does not apply to the other choices; leave it out")
            continue
        default = before.get(question.name, question.default_for(answers))
        if value is not None and (reason := question.refusal(value, answers)) is not None:
            refuse(f"{question.option}: {reason}")
            value = None if asker is not None else value
        if value is None and asker is not None:
            try:
                value = _ask(question, default, asker, tell, answers)
            except InputEndedError as error:
                remedy = _remedy(_without_default(asked[place:], given, answers))
                raise InputError(
                    f"{question.option}: {error} before this question was answered; {remedy}"
                ) from error
        if value is None:
            value = default
        if value is None:
            problems.append(f"{question.option}: missing; {question.why}")
            value = _stand_in(question)
        answers[question.name] = value
    if problems:
        raise InputError(problems)
    return answers


def _stand_in(question: Question) -> Any:
    """Return a placeholder answer, so that the later questions can be checked as well."""
    return 1.0 if isinstance(question.kind, Number) else ""


def _without_default(
    questions: Iterable[Question], given: Mapping[str, Any], answers: Mapping[str, Any]
) -> list[str]:
    """Return the options that are required if all other questions take their defaults."""
    found, known = [], dict(answers)
    for question in questions:
        if not question.when(known):
            continue
        value = given.get(question.name)
        value = question.default_for(known) if value is None else value
        if value is None:
            found.append(question.option)
            value = _stand_in(question)
        known[question.name] = value
    return found


def _remedy(required: list[str]) -> str:
    if not required:
        return "give the option, or --yes for the defaults"
    return f"give the options; --yes takes the defaults, but {', '.join(required)} must be given"


def _ask(
    question: Question,
    default: Any,
    asker: Asker,
    tell: Callable[[str], None],
    answers: Mapping[str, Any],
) -> Any:
    """Ask one question until a valid answer is given.

    Raises:
        InputEndedError: The input has ended.
    """
    while True:
        typed = asker.ask(question.prompt(default))
        if not typed and default is None:
            tell(f"an answer is needed: {question.why}")
            continue
        try:
            answer = question.kind.convert(typed, None, None) if typed else default
        except click.BadParameter as error:
            tell(error.message)
            continue
        reason = question.refusal(answer, answers)
        if reason is None:
            return answer
        tell(reason)
