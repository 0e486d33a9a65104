"""Options and numbers of files: judged before anything is done, completed by the shell."""

import json
import os
import shutil
import stat
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import click
import pytest
import yaml
from click.shell_completion import BashComplete

from rig.cli.entry import cli, status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.configuration import names, packaged
from rig.config.sequence import load_sequence

NOT_NUMBERS = ("nan", "-inf", "1e999")


def _commands(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for sub in command.list_commands(context):
            found = command.get_command(context, sub)
            assert found is not None
            yield from _commands(found, f"{name} {sub}")


def _real(parameter: click.Parameter) -> bool:
    """Whether an option takes real numbers: one that reads a number with a fraction as such."""
    kinds = parameter.type.types if isinstance(parameter.type, click.Tuple) else [parameter.type]
    for kind in kinds:
        try:
            value = kind.convert("1.5", None, None)
        except (click.BadParameter, click.UsageError):
            continue
        if any(
            isinstance(each, float) for each in (value if isinstance(value, tuple) else [value])
        ):
            return True
    return False


OPTIONS = {
    f"{name} {parameter.opts[0]}": parameter
    for name, command in _commands(cli, "rig")
    for parameter in command.params
    if _real(parameter)
}


@pytest.mark.parametrize("text", NOT_NUMBERS)
def test_no_option_takes_what_is_no_finite_number(text: str) -> None:
    assert {"rig jog --to", "rig run --prompt-timeout", "rig watch --last"} <= OPTIONS.keys()
    for parameter in OPTIONS.values():
        with pytest.raises((click.BadParameter, InputError)):
            parameter.type.convert(text, parameter, None)


CAMPAIGN = """\
campaign: 1
bench: {motion: rotary, torque_constant: 0.03, gear_ratio: 100.0, moment_arm: 0.095, gravity: 9.81}
recordings:
  - file: a.csv
    stage: loaded
    weight_mass: {value: 100.0, std: 0.5}
    window: [0.5, 9.5]
    rate: 1000.0
    start: 0.1
    channels: {current: {column: i, scale: 0.001, offset: 0.1}, angle: a}
"""


def _places(node: object, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _places(value, (*place, key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from _places(value, (*place, index))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield place


def _numbers() -> Iterator[tuple[str, object, str, tuple[str | int, ...]]]:
    """Yield each number of the packaged files and of a campaign, every key of a schema once."""
    seen: set[tuple[object, ...]] = set()
    files = [
        *((name, load_bench, packaged(name, "benches").read_text()) for name in names("benches")),
        *(
            (name, load_sequence, packaged(name, "sequences").read_text())
            for name in names("sequences")
        ),
        ("campaign", load_campaign, CAMPAIGN),
    ]
    for name, load, text in files:
        for place in _places(yaml.safe_load(text)):
            key = (load, *(part for part in place if isinstance(part, str)))
            if key not in seen:
                seen.add(key)
                yield name, load, text, place


def test_no_number_of_a_file_may_be_nan_or_infinite(tmp_path: Path) -> None:
    values = cycle((float("nan"), float("inf"), float("-inf")))
    count = 0
    for name, load, text, place in _numbers():
        tree = yaml.safe_load(text)
        node = tree
        for key in place[:-1]:
            node = node[key]
        node[place[-1]] = value = next(values)
        path = tmp_path / f"{name}.yaml"
        path.write_text(yaml.safe_dump(tree))
        with pytest.raises(InputError) as caught:
            load(path)  # type: ignore[operator]
        named = next(key for key in reversed(place) if isinstance(key, str))
        assert named in str(caught.value), (place, value)
        count += 1
    assert count > 150


def variables(*words: str) -> dict[str, str]:
    return {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}


def answered(text: str) -> list[str]:
    """Return the words that are offered in an answer to bash."""
    return [line.partition(",")[2] for line in text.splitlines()]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("rig", "ru"), ["run", "runs"]),
        (("rig", "new", "bench", "--torque-c"), ["--torque-constant"]),
        (("rig", "new", "bench", "b.yaml", "--drive", "epos"), ["epos4-serial"]),
    ],
)
def test_commands_and_options_are_completed(words, found, monkeypatch):
    for name, value in variables(*words).items():
        monkeypatch.setenv(name, value)
    completion = BashComplete(cli, {}, "rig", "_RIG_COMPLETE")
    assert answered(completion.complete()) == found


@pytest.mark.parametrize(
    ("typed", "nearest"), [("chekc", "'check'"), ("Identify", "'identify'"), ("zzz", "diagnose")]
)
def test_a_mistyped_command_gets_the_nearest_name(typed, nearest, capsys):
    """Without a near name, all names are listed."""
    assert status([typed]) == 2
    assert nearest in capsys.readouterr().err


RUN = ("run", "short.yaml", "--yes", "--out", "out")
CHECK = ("check", "practical")
JOG = ("jog", "practical", "--to", "1")
RECOVER = ("recover", "done")
RESUME = ("resume", "done")


@pytest.fixture
def elsewhere(short_sequence: Path, monkeypatch: pytest.MonkeyPatch, finished_run: Path) -> None:
    monkeypatch.chdir(short_sequence.parent)
    shutil.copytree(finished_run, "done")


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("command", [RUN, CHECK, JOG, RECOVER, RESUME], ids=lambda c: c[0])
def test_a_missing_folder_is_bad_input_before_anything_is_done(command, capsys, monkeypatch):
    def connected(*arguments: Any) -> None:
        raise AssertionError("a bench was connected to")

    for name in ("rig.control.attendance", "rig.cli.commands.bench"):
        monkeypatch.setattr(f"{name}.connect", connected)
    assert status([*command, "--json", "missing/x.json"]) == 2
    assert "missing/x.json: the folder missing does not exist" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("command", [RUN, CHECK, JOG], ids=lambda c: c[0])
def test_a_negative_seed_is_bad_input(command, capsys):
    assert status([*command, "--seed", "-1"]) == 2
    assert "-1 is not in the range x>=0" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize("command", [RUN, CHECK, JOG, RECOVER], ids=lambda c: c[0])
def test_what_is_no_plain_file_is_written_through(command: tuple[str, ...]) -> None:
    """A pipe stands for every device node: one that is replaced is gone for the whole machine."""
    os.mkfifo("pipe")
    reader = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert status([*command, "--json", "pipe"]) == 0
        assert json.loads(os.read(reader, 1 << 16))["schema"].startswith("loadrig.")
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(Path("pipe").stat().st_mode)
