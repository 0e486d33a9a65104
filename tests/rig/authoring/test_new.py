"""``rig new``: what it writes is valid, explained and run at once; guesses of columns."""

import io
import json
import math
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest
from jsonschema import Draft7Validator

from rig.cli.authoring.questions import Listed, Question, ask_all
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.yaml_tree import parse
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.sequence import load_sequence
from rig.runs.run import load_run
from rig.sources.build import load_source
from rig.sources.columns import guess_channels, guess_mass, is_linear
from rig.terminal.prompt import InputEndedError

pytestmark = pytest.mark.usefixtures("elsewhere")

SMALL = (
    *("--lever-ratio", "1", "--moment-arm", "0.15", "--supply", "24", "--gear-ratio", "51"),
    *("--torque-constant", "0.0259", "--resistance", "0.6", "--inductance", "0.0002"),
    *("--rated-current", "3.2", "--current-limit", "5", "--weights", "2,5", "--yes"),
)
REAL = ("--devices", "real", "--servo-eds", "d.eds")


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


def new(kind: str, *arguments: str) -> int:
    return status(["new", kind, *arguments])


def schema_accepts(name: str) -> bool:
    text = Path(name).read_text()
    place = text.splitlines()[0].removeprefix("# yaml-language-server: $schema=")
    schema = json.loads(Path(place).read_text())
    return Draft7Validator(schema).is_valid(parse(text)[0].plain())


@pytest.mark.parametrize("drive", ["canopen", "epos4-serial", "dbc"])
def test_the_small_bench_runs_at_once(drive: str) -> None:
    assert new("bench", "bench.yaml", "--drive", drive, *SMALL) == 0
    mock = load_bench(Path("bench.yaml")).value.mock
    assert (mock.motor.gear_ratio, mock.supply_V) == (51, 24)
    assert schema_accepts("bench.yaml")
    motion = ("--weights", "2,5", "--amplitude", "15", "--frequency", "0.5", "--duration", "2.2")
    assert new("sequence", "s.yaml", "--bench", "bench.yaml", *motion, "--yes") == 0
    assert schema_accepts("s.yaml")
    assert status(["run", "s.yaml", "--bench", "bench.yaml", "--yes", "--out", "run"]) == 0
    assert [r.weight_mass for r in load_run(Path("run")).recordings] == [0, 2, 5]


def test_a_real_drive_of_own_frames_is_refused_with_the_way_to_it(capsys) -> None:
    real = ("--drive", "dbc", "--devices", "real", "--encoder-eds", "e.eds")
    assert new("bench", "bench.yaml", *real, *SMALL) == 2
    assert "--devices simulated" in capsys.readouterr().err
    assert not Path("bench.yaml").exists()


def test_every_key_is_explained_with_unit_and_default() -> None:
    assert new("bench", "b.yaml", *SMALL) == 0
    lines = Path("b.yaml").read_text().splitlines()
    keys = [n for n, line in enumerate(lines) if not line.lstrip().startswith("#")]
    assert [lines[n] for n in keys if not lines[n - 1].lstrip().startswith("#")] == []
    text = " ".join(line.strip(" #") for line in lines)
    assert "Highest joint speed. Unit: deg/s." in text
    assert "CANopen node number. Default: 1." in text
    assert max(map(len, lines)) <= 100


@pytest.mark.parametrize(
    ("options", "cycle_Hz"),
    [
        ((*REAL, "--encoder-eds", "e.eds", "--channel", "can1"), 1000),
        ((*REAL, "--drive", "epos4-serial", "--baud", "115200"), 40),
    ],
)
def test_a_real_bench_has_no_simulated_machine(options: tuple[str, ...], cycle_Hz: float) -> None:
    assert new("bench", "b.yaml", *options, *SMALL) == 0
    assert schema_accepts("b.yaml")
    bench = load_bench(Path("b.yaml")).value
    assert (bench.simulated, bench.mock, bench.cycle_Hz) == (False, None, cycle_Hz)


@pytest.mark.parametrize(
    ("options", "lacking"),
    [
        (("--yes",), ["--lever-ratio"]),
        (("--devices", "real", *SMALL), ["--servo-eds", "--encoder-eds"]),
    ],
)
def test_values_that_cannot_be_guessed_are_asked_for(options, lacking, capsys):
    assert new("bench", "b.yaml", *options) == 2
    assert [line.split(":")[0] for line in capsys.readouterr().err.splitlines()] == lacking
    assert not Path("b.yaml").exists()


@pytest.mark.parametrize("kind", ["bench", "sequence"])
def test_nothing_is_overwritten(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--yes", *(["--lever-ratio", "1"] if kind == "bench" else [])]
    assert new(kind, "a.yaml", *options) == 0
    before = Path("a.yaml").read_bytes()
    assert new(kind, "a.yaml", *options) == 2
    assert Path("a.yaml").read_bytes() == before
    # A schema of another origin is not overwritten either, and then nothing is written.
    Path(f"schemas/{kind}.schema.json").write_text("{}")
    capsys.readouterr()
    assert new(kind, "b.yaml", *options) == 2
    assert capsys.readouterr().err.startswith(f"schemas/{kind}.schema.json: ")
    assert not Path("b.yaml").exists()


def test_answers_that_make_no_valid_file_leave_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert new("bench", "b.yaml", *SMALL) == 0
    assert new("sequence", "s.yaml", "--bench", "b.yaml", "--weights", "20", "--yes") == 2
    text = capsys.readouterr().err
    assert "stages[1].weight_kg: " in text
    assert "s.yaml" not in text
    assert sorted(path.name for path in Path().glob("*")) == ["b.yaml", "schemas"]


def test_typed_answers_make_the_same_file_as_options(monkeypatch: pytest.MonkeyPatch) -> None:
    assert new("sequence", "a.yaml", "--weights", "3", "--amplitude", "8", "--yes") == 0
    Path("a.yaml").rename("b.yaml")
    monkeypatch.setattr(sys, "stdin", io.StringIO("3\n8\n\n\n\n"))
    assert new("sequence", "a.yaml") == 0
    assert Path("a.yaml").read_bytes() == Path("b.yaml").read_bytes()
    assert [stage.weight_kg for stage in load_sequence(Path("a.yaml")).value.stages] == [0, 3]


def channels(place: int) -> dict[str, tuple[str | int, object]]:
    sections = load_campaign(Path("c.yaml")).value.recordings[place].channels
    return {name: (channel.column, channel.scale) for name, channel in sections.items()}


def test_a_recording_made_elsewhere_is_described_from_its_columns() -> None:
    for mass in (0, 5):
        Path(f"log_{mass}kg.csv").write_text(
            "t [ms];i_meas [mA];pos [deg];P_supply\n"
            + "".join(f"{n};{100 + n};{0.01 * n * n};1\n" for n in range(50))
        )
    options = ("--moment-arm", "0.1", "--lever-ratio", "2", "--yes")
    assert new("campaign", "c.yaml", "log_0kg.csv", "log_5kg.csv", *options) == 0
    assert schema_accepts("c.yaml")
    recordings = load_campaign(Path("c.yaml")).value.recordings
    assert [(r.file, r.stage, r.weight_mass) for r in recordings] == [
        ("log_0kg.csv", "unloaded", 0),
        ("log_5kg.csv", "loaded", 5),
    ]
    assert channels(0) == {
        "time": ("t [ms]", 1e-3),
        "current": ("i_meas [mA]", 1e-3),
        "angle": ("pos [deg]", pytest.approx(0.017453292519943295, rel=1e-11)),
    }
    loaded = load_source(Path("c.yaml")).recordings[1]
    assert loaded.channels["current"][1] == pytest.approx(0.101)


def test_a_linear_campaign_has_scales_terms_and_a_recording_to_validate() -> None:
    for name in ("a", "b"):
        Path(f"{name}.csv").write_text(
            "t,vir,pos [mm],F\n" + "".join(f"{n},{n},{n * n},1\n" for n in range(50))
        )
    options = (
        *("--time-scale", "0.001", "--torque", "vir", "--torque-scale", "-35.15", "--validate"),
        *("b.csv", "--terms", "offset", "--yes"),
    )
    assert new("campaign", "c.yaml", "a.csv", "b.csv", *options) == 0
    assert schema_accepts("c.yaml")
    campaign = load_campaign(Path("c.yaml")).value
    assert (campaign.bench.motion, campaign.model.terms) == ("linear", ("offset",))
    assert [recording.role for recording in campaign.recordings] == ["fit", "validate"]
    assert channels(1) == {
        "time": ("t", 1e-3),
        "torque": ("vir", -35.15),
        "angle": ("pos [mm]", 1e-3),
    }


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--terms", "backlash"), ["--terms", "backlash"]),
        (("--validate", "c.csv"), ["--validate: ", "c.csv", "a.csv"]),
        (("--validate", "a.csv"), ["--validate: "]),
        (("--time-scale", "0"), ["--time-scale: "]),
        (("--motion", "round"), ["--motion", "round"]),
        (("--masses", "1,2"), ["--masses: ", "2 masses for 1"]),
        (("--torque", "z"), ["--torque: a.csv", "'z'", "t, torque, angle"]),
        (("--time", "-", "--masses", "5"), ["--rate: ", "--moment-arm: ", "--lever-ratio: "]),
        (("b.csv",), ["b.csv: "]),
    ],
)
def test_a_campaign_refuses_options_that_make_no_file(options, named, capsys):
    Path("a.csv").write_text("t,torque,angle\n0,1,2\n1,2,3\n")
    assert new("campaign", "c.yaml", "a.csv", *options, "--yes") == 2
    told = capsys.readouterr().err
    assert [name for name in named if name not in told] == []
    assert not Path("c.yaml").exists()


QUESTIONS = (
    Question("gear", "Gear ratio", default=100.0),
    Question("lever", "Lever ratio", refusal=lambda value: "too large" if value > 5 else None),
    Question("weights", "Weights", "kg", lambda a: (a["gear"],), Listed()),
    Question("arm", "Arm", "m", when=lambda a: bool(a["weights"])),
)


def test_questions_are_put_until_they_are_answered() -> None:
    said: list[str] = []
    answering = Answering(["ten", "-1", "51,5", "", "7", "2", "none"])
    given = {"arm": 3.0}
    answers = ask_all(QUESTIONS, given, answering, said.append, {})
    assert answers == {"gear": 51.5, "lever": 2.0, "weights": ()}
    assert answering.asked[0] == "Gear ratio [100]: "
    assert answering.asked[-1] == "Weights, kg [51.5]: "
    assert len(said) == 5
    assert (said[3], said[4].split(":")[0]) == ("too large", "--arm")
    # An option that is refused is asked for, and no option is asked for otherwise.
    answering = Answering(["3", "", "1"])
    assert ask_all(QUESTIONS, {"gear": 1.0, "lever": 9.0}, answering, said.append, {}) == {
        "gear": 1.0,
        "lever": 3.0,
        "weights": (1.0,),
        "arm": 1.0,
    }
    assert said[5] == "--lever: too large"
    with pytest.raises(InputError, match="--lever: "):
        ask_all(QUESTIONS, {"gear": 1.0}, Answering([]), said.append, {})


@pytest.mark.parametrize(
    ("name", "channel", "scale"),
    [
        ("t_ms", "time", 1e-3),
        ("Timestamp (us)", "time", 1e-6),
        ("current [mA]", "current", 1e-3),
        ("pos/deg", "angle", math.pi / 180),
        ("speed [rpm]", "velocity", math.pi / 30),
        ("pos_ref", "command", 1.0),
        ("motor_position_deg", "motor_angle", math.pi / 180),
        ("temperature [°C]", "temperature", 1.0),
        ("current [deg]", None, 1.0),
        ("comment", None, 1.0),
    ],
)
def test_guesses(name: str, channel: str | None, scale: float) -> None:
    guesses = guess_channels([name])
    assert list(guesses) == ([channel] if channel else [])
    if channel:
        assert guesses[channel].scale == pytest.approx(scale)


def test_a_column_is_taken_once_and_the_first_that_fits() -> None:
    guesses = guess_channels(["t", "time", "angle", "", "phi"])
    assert [(name, guess.column) for name, guess in guesses.items()] == [
        ("time", "t"),
        ("angle", "angle"),
    ]


@pytest.mark.parametrize(
    ("stem", "mass"),
    [("log_5kg", 5.0), ("run-2.5 kg", 2.5), ("a0p5kg", 0.5), ("empty", 0.0), ("kg5", 0.0)],
)
def test_a_mass_in_the_name_of_a_file(stem: str, mass: float) -> None:
    assert guess_mass(stem) == mass


@pytest.mark.parametrize(
    ("name", "channel", "scale"),
    [
        ("pos [mm]", "angle", 1e-3),
        ("speed [m/s]", "velocity", 1.0),
        ("force_kN", "torque", 1e3),
        ("pos [deg]", None, 1.0),
    ],
)
def test_guesses_on_a_linear_bench(name: str, channel: str | None, scale: float) -> None:
    guesses = guess_channels([name], linear=True)
    assert list(guesses) == ([channel] if channel else [])
    if channel:
        assert guesses[channel].scale == pytest.approx(scale)
    assert is_linear([name]) is (name in ("pos [mm]", "speed [m/s]"))
