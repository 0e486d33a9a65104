"""``rig new``: what it writes is valid, explained, run and identified at once; nothing is
overwritten.
"""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from jsonschema import Draft7Validator

from rig.cli.authoring.bench import QUESTIONS, bench_text, remarks
from rig.cli.authoring.questions import Number, Numbers, Question, ask_all
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.yaml_tree import parse
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.sequence import load_sequence
from rig.runs.run import load_run
from rig.sources.load import load_source
from rig.terminal.prompt import InputEndedError

SMALL = (
    *("--lever-ratio", "1", "--moment-arm", "0.15", "--supply", "24", "--gear-ratio", "51"),
    *("--torque-constant", "0.0259", "--resistance", "0.6", "--inductance", "0.0002"),
    *("--rated-current", "3.2", "--current-limit", "5", "--weights", "2,5", "--yes"),
)


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


class Answering:
    """Answers from a list, then the input ends."""

    def __init__(self, answers: Iterable[str]) -> None:
        self.answers = list(answers)
        self.asked: list[str] = []

    def ask(self, words: str) -> str:
        self.asked.append(words)
        if not self.answers:
            raise InputEndedError("the input has ended")
        return self.answers.pop(0)


def schema_accepts(path: Path) -> bool:
    first = path.read_text().splitlines()[0]
    place = first.removeprefix("# yaml-language-server: $schema=")
    schema = json.loads((path.parent / place).read_text())
    return Draft7Validator(schema).is_valid(parse(path.read_text())[0].plain())


@pytest.mark.parametrize("drive", ["canopen", "epos4-serial", "dbc"])
def test_the_small_bench_runs_at_once(drive: str) -> None:
    assert status(["new", "bench", "bench.yaml", "--drive", drive, *SMALL]) == 0
    bench = load_bench(Path("bench.yaml")).value
    assert bench.simulated
    assert bench.mock is not None
    assert (bench.machine.gear_ratio, bench.mock.motor.gear_ratio, bench.mock.supply_V) == (
        51,
        51,
        24,
    )
    assert schema_accepts(Path("bench.yaml"))
    sequence = ("--weights", "2,5", "--amplitude", "15", "--frequency", "0.5", "--duration", "2.2")
    assert status(["new", "sequence", "s.yaml", "--bench", "bench.yaml", *sequence, "--yes"]) == 0
    assert schema_accepts(Path("s.yaml"))
    assert status(["run", "s.yaml", "--bench", "bench.yaml", "--yes", "--out", "run"]) == 0
    assert [r.weight_mass for r in load_run(Path("run")).recordings] == [0, 2, 5]


def test_a_recording_made_elsewhere_is_described_from_its_columns() -> None:
    for mass in (0, 5):
        Path(f"log_{mass}kg.csv").write_text(
            "t [ms];i_meas [mA];pos [deg];P_supply\n"
            + "".join(f"{n};{100 + n};{0.01 * n * n};1\n" for n in range(50))
        )
    options = ("--moment-arm", "0.1", "--lever-ratio", "2", "--yes")
    assert status(["new", "campaign", "c.yaml", "log_0kg.csv", "log_5kg.csv", *options]) == 0
    assert schema_accepts(Path("c.yaml"))
    recordings = load_campaign(Path("c.yaml")).value.recordings
    assert [(r.file, r.stage, r.weight_mass) for r in recordings] == [
        ("log_0kg.csv", "unloaded", 0),
        ("log_5kg.csv", "loaded", 5),
    ]
    channels = recordings[0].channels
    assert {name: (c.column, c.scale) for name, c in channels.items()} == {
        "time": ("t [ms]", 1e-3),
        "current": ("i_meas [mA]", 1e-3),
        "angle": ("pos [deg]", pytest.approx(0.017453292519943295, rel=1e-11)),
    }
    loaded = load_source(Path("c.yaml")).recordings[1]
    assert loaded.channels["current"][1] == pytest.approx(0.101)


def test_a_campaign_says_which_column_is_not_there_and_which_value_is_missing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("a.csv").write_text("x,y\n1,2\n2,3\n")
    assert (
        status(
            [
                "new",
                "campaign",
                "c.yaml",
                "a.csv",
                "--time",
                "0",
                "--torque",
                "z",
                "--angle",
                "y",
                "--yes",
            ]
        )
        == 2
    )
    assert "--torque: a.csv has no column 'z'; it has x, y" in capsys.readouterr().err
    assert (
        status(["new", "campaign", "c.yaml", "a.csv", "--masses", "5", "--angle", "y", "--yes"])
        == 2
    )
    errors = capsys.readouterr().err
    assert all(
        f"{option}: missing" in errors for option in ("--rate", "--moment-arm", "--lever-ratio")
    )
    assert status(["new", "campaign", "c.yaml", "a.csv", "b.csv", "--yes"]) == 2
    assert "b.csv: no such file" in capsys.readouterr().err
    assert not Path("c.yaml").exists()


def test_a_linear_campaign_has_scales_terms_and_a_recording_to_validate() -> None:
    for name in ("a", "b"):
        Path(f"{name}.csv").write_text(
            "t,vir,pos [mm],F\n" + "".join(f"{n},{n},{n * n},1\n" for n in range(50))
        )
    options = (
        *("--time-scale", "0.001", "--torque", "vir", "--torque-scale", "-35.15", "--validate"),
        *("b.csv", "--terms", "offset", "--yes"),
    )
    assert status(["new", "campaign", "c.yaml", "a.csv", "b.csv", *options]) == 0
    assert schema_accepts(Path("c.yaml"))
    campaign = load_campaign(Path("c.yaml")).value
    assert campaign.bench.motion == "linear"
    assert campaign.model.terms == ("offset",)
    assert [recording.role for recording in campaign.recordings] == ["fit", "validate"]
    channels = campaign.recordings[1].channels
    assert {name: (c.column, c.scale) for name, c in channels.items()} == {
        "time": ("t", 1e-3),
        "torque": ("vir", -35.15),
        "angle": ("pos [mm]", 1e-3),
    }


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--terms", "backlash", "unknown: backlash; known are offset"),
        ("--validate", "c.csv", "--validate: no recording c.csv; there are a.csv"),
        ("--validate", "a.csv", "at least one recording must be left to fit"),
        ("--time-scale", "0", "a scale of 0 makes all samples 0"),
        ("--motion", "round", "round"),
    ],
)
def test_a_campaign_refuses_options_that_make_no_file(
    option: str, value: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("a.csv").write_text("t,torque,angle\n0,1,2\n1,2,3\n")
    assert status(["new", "campaign", "c.yaml", "a.csv", option, value, "--yes"]) == 2
    assert words in capsys.readouterr().err
    assert not Path("c.yaml").exists()


def test_a_refused_answer_is_asked_for_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("a.csv").write_text("t,y,z\n0,1,2\n1,2,3\n")
    given = ("--motion", "rotary", "--time", "t", "--current", "-", "--voltage", "-")
    given += ("--motor-angle", "-", "--velocity", "-", "--command", "-", "--masses", "0")
    given += ("--gear-ratio", "1", "--validate", "none", "--terms", "none", "--time-scale", "1")
    # No such column; then no torque at all, which only the whole file shows.
    typed = ["nowhere", "-", "z", "2", "y", "", "", ""]
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(typed) + "\n"))
    assert status(["new", "campaign", "c.yaml", "a.csv", *given]) == 0
    shown = "".join(capsys.readouterr())
    assert "a.csv has no column 'nowhere'; it has t, y, z" in shown
    assert "no `torque`, `current` or `voltage`; add at least one" in shown
    assert "c.yaml:" not in shown
    channels = load_campaign(Path("c.yaml")).value.recordings[0].channels
    assert {name: (c.column, c.scale) for name, c in channels.items()} == {
        "time": ("t", 1.0),
        "torque": ("y", 1.0),
        "angle": ("z", 2.0),
    }


@pytest.mark.parametrize("rotor", [1e-5, 1.4e-4])
def test_the_rotor_of_the_simulated_motor_is_written(rotor: float) -> None:
    options = ("--lever-ratio", "1", "--rotor-inertia", str(rotor), "--yes")
    assert status(["new", "bench", "b.yaml", *options]) == 0
    mock = load_bench(Path("b.yaml")).value.mock
    assert mock is not None
    assert mock.motor.rotor_inertia_kg_m2 == rotor
    # The joint's inertia contains it.
    assert mock.joint.inertia_kg_m2 > rotor * 100**2


@pytest.mark.parametrize("kind", ["bench", "sequence"])
def test_nothing_is_overwritten(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--lever-ratio", "1"] if kind == "bench" else []
    assert status(["new", kind, "a.yaml", "--yes", *options]) == 0
    before = Path("a.yaml").read_bytes()
    assert status(["new", kind, "a.yaml", "--yes", *options]) == 2
    assert "exists already and is not overwritten" in capsys.readouterr().err
    assert Path("a.yaml").read_bytes() == before
    # A schema of another origin is not overwritten either, and then nothing is written.
    Path(f"schemas/{kind}.schema.json").write_text("{}")
    assert status(["new", kind, "b.yaml", "--yes", *options]) == 2
    assert "no schema of this program" in capsys.readouterr().err
    assert not Path("b.yaml").exists()


def test_answers_that_make_no_valid_file_leave_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["new", "bench", "b.yaml", *SMALL]) == 0
    assert (
        status(["new", "sequence", "s.yaml", "--bench", "b.yaml", "--weights", "20", "--yes"]) == 2
    )
    text = capsys.readouterr().err
    assert "not written: stages[1].weight_kg: " in text
    assert "above the bench limit weight_kg" in text
    assert "s.yaml" not in text
    assert sorted(path.name for path in Path().glob("*")) == ["b.yaml", "schemas"]


def test_every_key_is_explained_with_unit_and_default() -> None:
    assert status(["new", "bench", "b.yaml", *SMALL]) == 0
    lines = Path("b.yaml").read_text().splitlines()
    for number, line in enumerate(lines):
        if not line.lstrip().startswith("#"):
            assert lines[number - 1].lstrip().startswith("#"), line
    text = " ".join(line.strip(" #") for line in lines)
    assert "Highest joint speed. Unit: deg/s." in text
    assert "CANopen node number. Default: 1." in text
    assert max(map(len, lines)) <= 100


def test_lever_ratio_has_no_default(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["new", "bench", "b.yaml", "--yes"]) == 2
    assert "--lever-ratio: missing" in capsys.readouterr().err


def test_real_devices_name_what_cannot_be_guessed(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["new", "bench", "b.yaml", "--devices", "real", *SMALL]) == 2
    errors = capsys.readouterr().err
    assert "--servo-eds: missing" in errors
    assert "--encoder-eds: missing" in errors
    real = (
        "--devices",
        "real",
        "--servo-eds",
        "d.eds",
        "--encoder-eds",
        "e.eds",
        "--channel",
        "can1",
    )
    assert status(["new", "bench", "b.yaml", *real, *SMALL]) == 0
    bench = load_bench(Path("b.yaml")).value
    assert not bench.simulated
    assert bench.mock is None
    serial = (
        "--devices",
        "real",
        "--drive",
        "epos4-serial",
        "--servo-eds",
        "d.eds",
        "--baud",
        "115200",
    )
    assert status(["new", "bench", "c.yaml", *serial, *SMALL]) == 0
    assert load_bench(Path("c.yaml")).value.cycle_Hz == 40


def test_questions_are_put_until_they_are_answered(capsys: pytest.CaptureFixture[str]) -> None:
    said: list[str] = []
    questions = (
        Question("gear", "Gear ratio", default=100.0),
        Question("lever", "Lever ratio"),
        Question("weights", "Weights", "kg", kind=Numbers(), default=lambda a: (a["gear"],)),
        Question("arm", "Arm", "m", when=lambda a: bool(a["weights"])),
    )
    answering = Answering(["ten", "-1", "51,5", "", "2", "none"])
    answers = ask_all(questions, {}, answering, said.append)
    assert answers == {"gear": 51.5, "lever": 2.0, "weights": ()}
    assert answering.asked[0] == "Gear ratio [100]: "
    assert answering.asked[-1] == "Weights, kg [51.5]: "
    assert said == [
        "'ten' is not a number",
        "-1 must be above 0",
        "an answer is needed: the value has no default",
    ]
    with pytest.raises(
        InputError,
        match=r"--lever: the input has ended before this question was answered; give the option",
    ):
        ask_all(questions, {"gear": 1.0}, Answering([]), said.append)


def test_where_the_input_ends_the_options_without_default_are_named() -> None:
    with pytest.raises(InputError) as caught:
        ask_all(QUESTIONS, {}, Answering(["canopen"]), str)
    assert caught.value.problems == (
        "--devices: the input has ended before this question was answered; give the options; "
        "--yes takes the defaults, but --lever-ratio must be given",
    )
    with pytest.raises(InputError, match="give the option, or --yes for the defaults"):
        ask_all(QUESTIONS, {"lever_ratio": 1.0}, Answering([]), str)


def test_options_that_cannot_be_taken_are_told_and_asked_for() -> None:
    questions = (
        Question("a", "A", refusal=lambda value, _: "too large" if value > 5 else None),
        Question("b", "B", default=2.0, when=lambda answers: answers["a"] > 5),
    )
    said: list[str] = []
    given = {"a": 7.0, "b": 3.0}
    assert ask_all(questions, given, Answering(["8", "4"]), said.append) == {"a": 4.0}
    assert said == [
        "--a: too large",
        "too large",
        "--b: does not apply to the other choices; leave it out",
    ]
    with pytest.raises(InputError, match="--a: too large"):
        ask_all(questions, given, None, str)


def test_options_are_not_asked_for_and_those_that_do_not_apply_are_refused() -> None:
    questions = (
        Question("a", "A", default=1.0),
        Question("b", "B", default=2.0, when=lambda answers: answers["a"] > 5),
    )
    answering = Answering(["7", ""])
    assert ask_all(questions, {"b": 3.0}, answering, str) == {"a": 7.0, "b": 3.0}
    assert len(answering.asked) == 1
    with pytest.raises(InputError, match="--b: does not apply"):
        ask_all(questions, {"a": 1.0, "b": 3.0}, None, str)


def test_typed_answers_make_the_same_file_as_options(monkeypatch: pytest.MonkeyPatch) -> None:
    assert status(["new", "sequence", "a.yaml", "--weights", "3", "--amplitude", "8", "--yes"]) == 0
    Path("a.yaml").rename("b.yaml")
    monkeypatch.setattr(sys, "stdin", io.StringIO("3\n8\n\n\n\n"))
    assert status(["new", "sequence", "a.yaml"]) == 0
    assert Path("a.yaml").read_bytes() == Path("b.yaml").read_bytes()
    assert [stage.weight_kg for stage in load_sequence(Path("a.yaml")).value.stages] == [0, 3]


@pytest.mark.parametrize("typed", ["nan", "inf", "1e999", "0", "-3", "x", ""])
def test_numbers_that_no_machine_has_are_refused(typed: str) -> None:
    import click

    with pytest.raises(click.BadParameter):
        Number().convert(typed, None, None)


def test_a_load_that_the_simulated_motor_cannot_move_is_told() -> None:
    answers = ask_all(
        QUESTIONS, {"lever_ratio": 10.0, "moment_arm": 1.0, "weights": (50.0,)}, None, str
    )
    (note,) = remarks(answers)
    assert "use less weight, or a smaller lever ratio" in note
    assert remarks(ask_all(QUESTIONS, {"lever_ratio": 1.0}, None, str)) == []
    assert "bench: 1" in bench_text("x", answers)


def test_machine_data_that_no_option_gives_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    given = [*SMALL[: SMALL.index("--resistance")], *SMALL[SMALL.index("--inductance") :]]
    assert status(["new", "bench", "b.yaml", *given]) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert "no option states it: --resistance 1.56 ohm, --motor-counts 4096; compare" in said
    assert status(["new", "bench", "c.yaml", *SMALL, "--motor-counts", "4096"]) == 0
    assert "no option states it" not in "".join(capsys.readouterr())
