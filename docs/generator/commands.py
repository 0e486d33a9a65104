"""Page of the commands, from their click definitions."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import click
from keys import table

from rig.cli import entry as cli


def page() -> str:
    """Return the page."""
    parts = [
        "# Commands",
        "`rig` is the one command. `rig --verbose COMMAND` also shows what the bus libraries log.",
        "Every command ends with one of six statuses: "
        "[how a command ends](../guides/command_line.md).",
    ]
    for name in cli.COMMANDS:
        parts += _command(name)
    return "\n\n".join(parts) + "\n"


def _command(name: str) -> Iterator[str]:
    command = cli.cli.get_command(click.Context(cli.cli), name)
    assert command is not None
    yield from _section(name, command)
    if isinstance(command, click.Group):
        for below, inner in command.commands.items():
            yield from _section(f"{name} {below}", inner)


def _section(name: str, command: click.Command) -> Iterator[str]:
    words, example = _help(command)
    yield f"## rig {name}"
    yield words
    context = click.Context(command, info_name=f"rig {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    yield f"<!-- not run: usage and examples of `rig {name} --help` -->"
    yield (
        f"```console\n$ rig {name} {usage}\n\n"
        + "\n".join(f"$ {line}" for line in example)
        + "\n```"
    )
    rows = [
        _option(option, context)
        for option in command.params
        if isinstance(option, click.Option) and not option.hidden
    ]
    if rows:
        yield table(("option", "value", "default", "meaning"), [row for row in rows if row])


def _help(command: click.Command) -> tuple[str, list[str]]:
    """Return the paragraphs of the help text, and the lines of its example."""
    text = inspect.cleandoc(command.help or "")
    words, _, example = text.partition("\b\nExample:")
    return words.strip(), [line.strip() for line in example.splitlines() if line.strip()]


def _option(option: click.Option, context: click.Context) -> tuple[str, ...]:
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    words = re.sub(r"\s*\[default: (.*?)\]", "", option.help or "")
    stated = re.search(r"\[default: (.*?)\]", option.help or "")
    default = _marked(stated[1]) if stated else _default(option, context)
    return names, _value(option), default, _marked(words)


def _marked(text: str) -> str:
    """Return text with commands, options and file names set as code."""
    if re.fullmatch(r"\S*[/<]\S*", text):
        return f"`{text}`"
    return re.sub(r"(?<![`\w-])(--[a-z][a-z-]*|\./[\w-]+|[A-Z]+/[a-z]+)(?![`\w])", r"`\1`", text)


def _value(option: click.Option) -> str:
    if option.is_flag:
        return "on or off" if option.secondary_opts else "switch"
    kind: Any = option.type
    if isinstance(kind, click.Choice):
        return " or ".join(f"`{choice}`" for choice in kind.choices)
    known = {"path": "file", "directory": "folder", "integer": "whole number", "float": "number"}
    words = kind.name if kind.name in ("number", "numbers") else known.get(kind.name, "text")
    if isinstance(kind, click.Path) and not kind.file_okay:
        words = "folder"
    if isinstance(kind, click.IntRange | click.FloatRange):
        words = "whole number" if isinstance(kind, click.IntRange) else "number"
        if kind.min is not None:
            words += f" {'>' if kind.min_open else '≥'} {kind.min:g}"
        if kind.max is not None:
            words += f" {'<' if kind.max_open else '≤'} {kind.max:g}"
    return words + (", may be repeated" if option.multiple else "")


def _default(option: click.Option, context: click.Context) -> str:
    value = option.get_default(context)
    if option.required:
        return "**required**"
    if option.is_flag or value is None or value == () or "UNSET" in repr(value):
        return ""
    return f"`{value}`"
