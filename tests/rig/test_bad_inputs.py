"""Every command, given every kind of file that it cannot use: `file: message`, status 2, and
nothing else.
"""

from __future__ import annotations

import gzip
import json
import os
import random
import shutil
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from drivers.mock.dbc_drive import DRIVE_DBC
from rig.cli.entry import BAD_INPUT, BAD_VERDICT, DEVICE_FAILED, DONE, status
from rig.config.configuration import resolve
from rig.wiring.connect import DRIVE_EDS

from .ordinary import ordinary_user

SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: a, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
"""
CAMPAIGN = """\
campaign: 1
bench: {{torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095, lever_ratio: 10}}
recordings:
  - {{file: {file}, stage: unloaded, channels: {{time: time, current: current,
     motor_angle: motor_angle}}}}
"""
FAULTS = """\
faults: 1
rows:
  - {phase: excite, after_s: 0.25, target: encoder, fault: jump, value: 5}
"""
FAULTS_CSV = "phase,after_s,target,fault,value\nexcite,0.25,encoder,jump,5\n"
PATIENCE_S = 30
"""A file that is waited for, or that never ends, takes longer."""

Arguments = Callable[[str], list[str]]
COMMANDS: Mapping[str, tuple[str, Arguments]] = {
    "run": ("sequence.yaml", lambda file: ["run", file, "--yes", "--out", "out"]),
    "run --bench": (
        "bench.yaml",
        lambda file: ["run", "sequence.yaml", "--bench", file, "--yes", "--out", "out"],
    ),
    "run --faults": (
        "faults.yaml",
        lambda file: ["run", "sequence.yaml", "--faults", file, "--yes", "--out", "out"],
    ),
    "run --faults csv": (
        "faults.csv",
        lambda file: ["run", "sequence.yaml", "--faults", file, "--out", "out"],
    ),
    "run --identification": (
        "found.json",
        lambda file: ["run", "sequence.yaml", "--identification", file],
    ),
    "run --feedforward": (
        "found.json",
        lambda file: ["run", "sequence.yaml", "--feedforward", file],
    ),
    "resume": ("sequence.yaml", lambda file: ["resume", file, "--yes"]),
    "recover": ("sequence.yaml", lambda file: ["recover", file]),
    "jog": ("bench.yaml", lambda file: ["jog", file, "--to", "1"]),
    "check": ("bench.yaml", lambda file: ["check", file]),
    "identify": ("campaign.yaml", lambda file: ["identify", file, "--out", "out"]),
    "identify --score": (
        "campaign.yaml",
        lambda file: ["identify", "campaign.yaml", "--score", file, "--out", "out"],
    ),
    "identify --plan": (
        "sequence.yaml",
        lambda file: ["identify", "--plan", file, "--nominal", "nothing.json"],
    ),
    "identify --bench": (
        "bench.yaml",
        lambda file: ["identify", "--plan", "sequence.yaml", "--bench", file],
    ),
    "identify --nominal": (
        "found.json",
        lambda file: ["identify", "--plan", "sequence.yaml", "--nominal", file],
    ),
    "diagnose": ("campaign.yaml", lambda file: ["diagnose", file, "--out", "out"]),
    "simulate": (
        "campaign.yaml",
        lambda file: ["simulate", file, "--result", "found.json", "--out", "out"],
    ),
    "simulate --result": (
        "found.json",
        lambda file: ["simulate", "campaign.yaml", "--result", file, "--out", "out"],
    ),
    "export": ("campaign.yaml", lambda file: ["export", file, "--out", "out.csv"]),
    "prove --from": (
        "sequence.yaml",
        lambda file: ["prove", "--from", file, "--out", "out", "--rigs", "1"],
    ),
    "effects": ("sequence.yaml", lambda file: ["effects", file]),
}
"""Name to an example of the file that is asked for, and the command line."""


def missing(path: Path, content: bytes) -> None:
    pass


def a_folder(path: Path, content: bytes) -> None:
    path.mkdir()


def unreadable(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    path.chmod(0)


def empty(path: Path, content: bytes) -> None:
    path.write_bytes(b"")


def binary(path: Path, content: bytes) -> None:
    path.write_bytes(random.Random(1).randbytes(3000))


def zeros(path: Path, content: bytes) -> None:
    path.write_bytes(bytes(3000))


def truncated(path: Path, content: bytes) -> None:
    path.write_bytes(content[: len(content) // 4])


def latin_1(path: Path, content: bytes) -> None:
    path.write_bytes(b"# \xfc\n" + content)


def nested(path: Path, content: bytes) -> None:
    path.write_bytes(b"[" * 100_000)


def a_list(path: Path, content: bytes) -> None:
    path.write_bytes(b"[1, 2]\n")


def a_pipe(path: Path, content: bytes) -> None:
    os.mkfifo(path)


def a_device(path: Path, content: bytes) -> None:
    path.symlink_to("/dev/zero")


def a_loop_of_links(path: Path, content: bytes) -> None:
    path.symlink_to(path)


KINDS = (
    missing, a_folder, unreadable, empty, binary, zeros, truncated, latin_1, nested, a_list,
    a_pipe, a_device,
    a_loop_of_links,
)  # fmt: skip


@pytest.fixture
def place(tmp_path: Path, files: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a folder with good files of every sort, which is the current one."""
    here = tmp_path / "here"
    shutil.copytree(files, here)
    monkeypatch.chdir(here)
    yield here
    for path in tmp_path.rglob("*"):
        if path.is_file() or path.is_dir():
            path.chmod(0o700)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with good files of every sort."""
    folder = tmp_path_factory.mktemp("files")
    time = np.arange(2000) / 1000.0
    rows = np.column_stack((time, np.cos(6.0 * time), 50.0 * np.sin(6.0 * time)))
    np.savetxt(
        folder / "data.csv", rows, delimiter=",", header="time,current,motor_angle", comments=""
    )
    (folder / "data.csv.gz").write_bytes(gzip.compress((folder / "data.csv").read_bytes()))
    np.savez(folder / "data.npz", time=time, current=rows[:, 1], motor_angle=rows[:, 2])
    texts = {
        "sequence.yaml": SEQUENCE,
        "campaign.yaml": CAMPAIGN.format(file="data.csv"),
        "faults.yaml": FAULTS,
        "faults.csv": FAULTS_CSV,
        "bench.yaml": resolve("practical", "benches").read_text(encoding="utf-8"),
        "found.json": json.dumps(result()),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    assert (
        status(["run", str(folder / "sequence.yaml"), "--yes", "--out", str(folder / "run")])
        == DONE
    )
    for kind in ("mat", "parquet"):
        assert (
            status(
                [
                    "export",
                    str(folder / "run"),
                    "--format",
                    kind,
                    "--out",
                    str(folder / f"data.{kind}"),
                ]
            )
            == DONE
        )
    return folder


def result() -> dict[str, object]:
    """Return a result of `rig identify`, as far as other commands read it."""
    values = {"J": 0.2, "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3}
    values |= {"mu_c": 0.052, "mu_s": 0.086, "omega_sL": 0.033, "mu_2": 0.032}
    parameters = {
        name: {"value": v, "low": 0.99 * v, "high": 1.01 * v, "unit": ""}
        for name, v in values.items()
    }
    return {
        "schema": "loadrig.identify/1",
        "motion": "rotary",
        "alpha": 2.0,
        "parameters": parameters,
        "inputs": [],
    }


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_cannot_be_used_is_bad_input(
    place: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    kind: Callable[[Path, bytes], None],
) -> None:
    example, arguments = COMMANDS[command]
    name = f"bad{Path(example).suffix}"
    kind(place / name, (place / example).read_bytes())
    assert call(arguments(name)) == BAD_INPUT
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert name in shown or command in ("identify --plan",), shown


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_in_a_folder_that_may_not_be_searched(
    place: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    example, arguments = COMMANDS[command]
    folder = place / "locked"
    folder.mkdir()
    shutil.copy(place / example, folder / example)
    folder.chmod(0)
    assert call(arguments(f"locked/{example}")) == BAD_INPUT
    assert_in_words(capsys.readouterr().err, place)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".yaml", "campaign.yaml/inside.yaml"], ids=["too long", "through a file"]
)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_name_that_no_file_can_have(
    place: Path, capsys: pytest.CaptureFixture[str], command: str, name: str
) -> None:
    assert call(COMMANDS[command][1](name)) == BAD_INPUT
    assert_in_words(capsys.readouterr().err, place)


@pytest.mark.parametrize(
    "command", ["identify", "diagnose", "export", "simulate", "recover", "resume"]
)
def test_a_run_folder_that_may_not_be_read(
    place: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    (place / "run").chmod(0)
    # What works on the folder locks it first, and that is a failure of storage.
    locks = command in ("recover", "resume")
    assert call(COMMANDS[command][1]("run")) == (DEVICE_FAILED if locks else BAD_INPUT)
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert "Permission denied" in shown


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("file", ["run.json", "recording.mcap"])
@pytest.mark.parametrize("command", ["identify", "diagnose", "export", "recover", "resume"])
def test_a_run_folder_with_a_damaged_file(
    place: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    file: str,
    kind: Callable[[Path, bytes], None],
) -> None:
    content = (place / "run" / file).read_bytes()
    (place / "run" / file).unlink()
    kind(place / "run" / file, content)
    code = call(COMMANDS[command][1]("run"))
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    # What can be mended is; a resumed run goes on then, and says what happened.
    assert code in ((BAD_INPUT, DONE) if command in ("recover", "resume") else (BAD_INPUT,)), shown


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("ending", ["csv", "csv.gz", "npz", "mat", "parquet"])
def test_a_recording_that_cannot_be_used(
    place: Path,
    capsys: pytest.CaptureFixture[str],
    ending: str,
    kind: Callable[[Path, bytes], None],
) -> None:
    kind(place / f"bad.{ending}", (place / f"data.{ending}").read_bytes())
    (place / "bad.yaml").write_text(CAMPAIGN.format(file=f"bad.{ending}"), encoding="utf-8")
    # Half a table is a table, and a degree sign of a vendor in a comment does no harm.
    usable = ending == "csv" and kind in (truncated, latin_1)
    code = call(["export", "bad.yaml", "--out", "out.csv"])
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert code in ((BAD_INPUT, DONE) if usable else (BAD_INPUT,)), shown
    assert code == DONE or f"bad.{ending}" in shown


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_dbc_file_that_cannot_be_used(
    place: Path, capsys: pytest.CaptureFixture[str], kind: Callable[[Path, bytes], None]
) -> None:
    kind(place / "bad.dbc", DRIVE_DBC.read_bytes())
    bench = resolve("practical_dbc", "benches").read_text(encoding="utf-8")
    assert "  file: null " in bench
    (place / "dbc.yaml").write_text(
        bench.replace("  file: null ", "  file: bad.dbc "), encoding="utf-8"
    )
    code = call(["check", "dbc.yaml"])
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert code == BAD_INPUT, shown


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("command", ["run --bench", "jog", "check"])
def test_an_eds_file_that_cannot_be_used(
    place: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    kind: Callable[[Path, bytes], None],
) -> None:
    kind(place / "bad.eds", DRIVE_EDS.read_bytes())
    bench = (place / "bench.yaml").read_text(encoding="utf-8")
    assert "\nservo: {" in bench
    (place / "eds.yaml").write_text(
        bench.replace("\nservo: {", "\nservo: {eds: bad.eds, "), encoding="utf-8"
    )
    code = call(COMMANDS[command][1]("eds.yaml"))
    shown = capsys.readouterr()
    assert_in_words(shown.err, place)
    if kind is not latin_1:
        assert code == BAD_INPUT, shown.err
        assert "bad.eds" in shown.out + shown.err


NUMBERS = ("1e999", "9" * 400, ".nan", "-.inf", "-1e300", "1e300", "1e-300", "0", '"x"', "null")
PLACES: Mapping[str, tuple[str, ...]] = {
    "run": (
        "amplitude_deg: ",
        "frequency_Hz: ",
        "duration_s: ",
        "ramp_in_s: ",
        "settle_s: ",
        "sequence: ",
    ),
    "run --bench": (
        "gear_ratio: ",
        "cycle_Hz: ",
        "bitrate: ",
        "rate_Hz: ",
        "motor_counts_per_turn: ",
        "angle_max_deg: ",
        "rated_current_A: ",
        "inertia_kg_m2: ",
        "supply_V: ",
    ),
    "run --faults": ("after_s: ", "value: ", "faults: "),
    "export": ("torque_constant: ", "gear_ratio: ", "campaign: "),
}
"""Command to the keys whose numbers are replaced."""


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(
    ("command", "key"), [(command, key) for command, keys in PLACES.items() for key in keys]
)
def test_numbers_that_no_bench_has(
    place: Path, capsys: pytest.CaptureFixture[str], command: str, key: str, number: str
) -> None:
    example, arguments = COMMANDS[command]
    before, found, after = (place / example).read_text(encoding="utf-8").partition(key)
    assert found, f"{key} is not in the example"
    rest = after.lstrip("-+.0123456789e")
    (place / "bad.yaml").write_text(f"{before}{key}{number}{rest}", encoding="utf-8")
    code = call(arguments("bad.yaml"))
    assert_in_words(capsys.readouterr().err, place)
    # Some of these are allowed, and some the simulated drive refuses.
    assert code in (DONE, BAD_VERDICT, BAD_INPUT, DEVICE_FAILED)


@pytest.mark.parametrize(
    "number", ["NaN", "Infinity", "-Infinity", "1e999", "9" * 400, "-1e300", "1e-300", '"x"']
)
@pytest.mark.parametrize(
    ("command", "key"),
    [
        *(
            (command, key)
            for command in ("run --identification", "run --feedforward")
            for key in ("alpha", "value", "low")
        ),
        *(("simulate --result", key) for key in ("alpha", "value")),
        ("identify --nominal", "value"),
    ],
)
def test_results_with_numbers_that_none_has(
    place: Path, capsys: pytest.CaptureFixture[str], command: str, key: str, number: str
) -> None:
    raw = json.dumps(result(), indent=1)
    before, found, after = raw.partition(f'"{key}": ')
    rest = after.lstrip("-+.0123456789e")
    (place / "bad.json").write_text(f"{before}{found}{number}{rest}", encoding="utf-8")
    arguments = COMMANDS[command][1]("bad.json")
    code = call([*arguments, "--yes", "--out", "out"] if command.startswith("run") else arguments)
    assert_in_words(capsys.readouterr().err, place)
    assert code in (DONE, BAD_VERDICT, BAD_INPUT, DEVICE_FAILED)
    if (key, number) in (("alpha", "NaN"), ("alpha", '"x"')):
        assert code == BAD_INPUT


def call(arguments: list[str]) -> int:
    """Return the exit status of a command that an ordinary user gives."""
    with in_time(), ordinary_user():
        return status(arguments)


@contextmanager
def in_time() -> Iterator[None]:
    """Fail where a file is waited for that never comes, or read that never ends."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"took longer than {PATIENCE_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def assert_in_words(shown: str, place: Path) -> None:
    assert "Traceback" not in shown
    assert "the program broke down" not in shown, shown
    assert not list(place.rglob("crash-*.txt"))
