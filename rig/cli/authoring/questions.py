"""Questions whose answers, typed, given as options or default, fill a template."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import click

from rig.cli.options import Number
from rig.common.errors import InputError
from rig.terminal.prompt import Asker, InputEndedError

Answers = dict[str, Any]


class Quantity(Number):
    """A number that may have a decimal comma."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number, or fail with a message."""
        typed: Any = value.strip().replace(",", ".") if isinstance(value, str) else value
        return super().convert(typed, param, ctx)


POSITIVE = Quantity(min=0.0, min_open=True)
UNKNOWN = "none"


class Known(Quantity):
    """A positive number, or `none` for a constant that is not known."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number, or :data:`UNKNOWN`, or fail with a message."""
        if isinstance(value, str) and value.strip() == UNKNOWN:
            return UNKNOWN
        return super().convert(value, param, ctx)


class Listed(click.ParamType):  # type: ignore[type-arg] # older versions of click have no type argument
    """Values separated by commas, numbers also by blanks; `none` is an empty list."""

    def __init__(self, each: click.ParamType = POSITIVE) -> None:  # type: ignore[type-arg]
        self.name = "numbers" if isinstance(each, Number) else "names"
        self._each = each
        self._separator = r"[,\s]+" if isinstance(each, Number) else r"\s*,\s*"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Any, ...]:
        """Return the values in the order given, or fail with a message."""
        if isinstance(value, tuple):
            return value
        words = [word for word in re.split(self._separator, str(value).strip()) if word]
        if words == ["none"]:
            return ()
        return tuple(self._each.convert(word, param, ctx) for word in words)


@dataclass(frozen=True)
class Question:
    """A question to the user."""

    name: str  # name of the answer; with dashes, name of the option
    words: str  # text for the prompt and the help of the option
    unit: str = ""  # unit of the answer; empty for none
    default: Any = None  # a value, or a function of the earlier answers; None if there is none
    kind: click.ParamType = POSITIVE  # type: ignore[type-arg] # reads the answer
    # Function of the earlier answers that decides whether the question applies.
    when: Callable[[Mapping[str, Any]], bool] = lambda answers: True
    # Function of an answer that returns why the answer is refused, or None.
    refusal: Callable[[Any], str | None] = lambda answer: None

    @property
    def option(self) -> str:
        """Name of the option that answers the question."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def text(self) -> str:
        """The question with the unit of the answer."""
        return f"{self.words}, {self.unit}" if self.unit else self.words


def shown(value: Any) -> str:
    """Return an answer in the form in which a user types it."""
    if isinstance(value, tuple):
        return ",".join(shown(item) for item in value) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def options(questions: Iterable[Question]) -> Callable[[Any], Any]:
    """Return a decorator that gives a command an option for each question."""

    def decorate(command: Any) -> Any:
        for question in reversed(tuple(questions)):
            static = question.default is not None and not callable(question.default)
            default = f" [default: {shown(question.default)}]" if static else ""
            command = click.option(
                question.option,
                question.name,
                type=question.kind,
                help=f"{question.text}.{default}",
            )(command)
        return command

    return decorate


def ask_all(
    questions: Iterable[Question],
    given: Mapping[str, Any],
    asker: Asker | None,
    tell: Callable[[str], None],
    before: Mapping[str, Any],
) -> Answers:
    """Return the answer to every question that applies.

    ``given``: answers given as options, by name, or None for options not given. ``asker``: asks the
    user the other questions; None to use the defaults. ``tell``: shows what is wrong with an
    answer. With an ``asker``, a refused option is reported and asked for again, so that no typed
    answer is lost. ``before``: answers of an earlier round, used as defaults.
    """
    answers: Answers = {}
    problems: list[str] = []
    refuse = problems.append if asker is None else tell
    for question in questions:
        value = given.get(question.name)
        if not question.when(answers):
            if value is not None:
                refuse(f"{question.option}: does not apply to the other choices; leave it out")
            continue
        default = question.default
        default = before.get(question.name, default(answers) if callable(default) else default)
        reason = None if value is None else question.refusal(value)
        if reason is not None:
            refuse(f"{question.option}: {reason}")
        if asker is None:
            value = default if value is None else value
        elif value is None or reason is not None:
            value = _ask(question, default, asker, tell)
        if value is None:
            problems.append(f"{question.option}: missing; state: {question.text}")
            # The later questions are checked as well.
            value = 1.0 if isinstance(question.kind, Number) else ""
        answers[question.name] = value
    if problems:
        raise InputError(problems)
    return answers


def _ask(question: Question, default: Any, asker: Asker, tell: Callable[[str], None]) -> Any:
    """Ask one question until a valid answer is given."""
    kind = question.kind
    choices = f" ({', '.join(kind.choices)})" if isinstance(kind, click.Choice) else ""
    proposed = "" if default is None else f" [{shown(default)}]"
    while True:
        try:
            typed = asker.ask(f"{question.text}{choices}{proposed}: ")
        except InputEndedError as error:
            raise InputError(
                f"{question.option}: {error} before this question was answered; give the options, "
                "or --yes for the defaults"
            ) from error
        if not typed and default is None:
            tell("an answer is needed, because the value has no default")
            continue
        try:
            answer = kind.convert(typed, None, None) if typed else default
        except click.BadParameter as error:
            tell(error.message)
            continue
        reason = question.refusal(answer)
        if reason is None:
            return answer
        tell(reason)
