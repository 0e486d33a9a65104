"""Every command with every kind of file that it cannot use: a message, status 2, nothing else."""

import gzip
import json
import os
import random
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

from drivers.mock.dbc_drive import DRIVE_DBC
from rig.cli.entry import BAD_INPUT, BAD_VERDICT, DEVICE_FAILED, DONE, status
from rig.config.configuration import resolve
from rig.wiring.connect import DRIVE_EDS

from .benches import stages, swing
from .ordinary import ordinary_user

SEQUENCE = stages(swing("a"))
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

COMMANDS: Mapping[str, tuple[str, str]] = {
    "run": ("sequence.yaml", "run FILE --yes --out out"),
    "run --bench": ("bench.yaml", "run sequence.yaml --bench FILE --yes --out out"),
    "run --faults": ("faults.yaml", "run sequence.yaml --faults FILE --yes --out out"),
    "run --faults csv": ("faults.csv", "run sequence.yaml --faults FILE --out out"),
    "run --identification": ("found.json", "run sequence.yaml --identification FILE"),
    "run --feedforward": ("found.json", "run sequence.yaml --feedforward FILE"),
    "resume": ("sequence.yaml", "resume FILE --yes"),
    "recover": ("sequence.yaml", "recover FILE"),
    "jog": ("bench.yaml", "jog FILE --to 1"),
    "check": ("bench.yaml", "check FILE"),
    "identify": ("campaign.yaml", "identify FILE --out out"),
    "identify --score": ("campaign.yaml", "identify campaign.yaml --score FILE --out out"),
    "identify --plan": ("sequence.yaml", "identify --plan FILE --nominal nothing.json"),
    "identify --bench": ("bench.yaml", "identify --plan sequence.yaml --bench FILE"),
    "identify --nominal": ("found.json", "identify --plan sequence.yaml --nominal FILE"),
    "diagnose": ("campaign.yaml", "diagnose FILE --out out"),
    "simulate": ("campaign.yaml", "simulate FILE --result found.json --out out"),
    "simulate --result": ("found.json", "simulate campaign.yaml --result FILE --out out"),
    "export": ("campaign.yaml", "export FILE --out out.csv"),
    "prove --from": ("sequence.yaml", "prove --from FILE --out out --rigs 1"),
    "effects": ("sequence.yaml", "effects FILE"),
}
"""Name to an example of the file that is asked for, and the command line."""


def arguments(command: str, file: str) -> list[str]:
    return [file if word == "FILE" else word for word in COMMANDS[command][1].split()]


Spoil = Callable[[Path, bytes], object]


def unreadable(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    path.chmod(0)


KINDS: Mapping[str, Spoil] = {
    "missing": lambda path, content: None,
    "a_folder": lambda path, content: path.mkdir(),
    "unreadable": unreadable,
    "empty": lambda path, content: path.write_bytes(b""),
    "binary": lambda path, content: path.write_bytes(random.Random(1).randbytes(3000)),
    "truncated": lambda path, content: path.write_bytes(content[: len(content) // 4]),
    "latin_1": lambda path, content: path.write_bytes(b"# \xfc\n" + content),
    "nested": lambda path, content: path.write_bytes(b"[" * 100_000),
    "a_list": lambda path, content: path.write_bytes(b"[1, 2]\n"),
    "a_pipe": lambda path, content: os.mkfifo(path),
    "a_device": lambda path, content: path.symlink_to("/dev/zero"),
    "a_loop_of_links": lambda path, content: path.symlink_to(path),
}
READERS = ("run", "run --bench", "run --faults csv", "identify", "simulate --result", "recover")
"""Commands that read every kind of file between them; each of the others gets half."""


def half(*each: Iterable[str]) -> list[tuple[str, ...]]:
    """Return every second combination, as the black fields of a chessboard."""
    places = product(*(enumerate(values) for values in each))
    return [tuple(v for _, v in place) for place in places if sum(n for n, _ in place) % 2]


PAIRS = sorted({*half(COMMANDS, KINDS), *product(READERS, KINDS)})


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
    run = str(folder / "run")
    assert status(["run", str(folder / "sequence.yaml"), "--yes", "--out", run]) == DONE
    for kind in ("mat", "parquet"):
        out = str(folder / f"data.{kind}")
        assert status(["export", run, "--format", kind, "--out", out]) == DONE
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


@pytest.mark.parametrize(("command", "kind"), PAIRS)
def test_a_file_that_cannot_be_used_is_bad_input(place, capsys, command, kind):
    example = place / COMMANDS[command][0]
    name = f"bad{example.suffix}"
    KINDS[kind](place / name, example.read_bytes())
    assert call(arguments(command, name)) == BAD_INPUT
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert name in shown or command in ("identify --plan",), shown


@pytest.mark.parametrize("command", READERS)
def test_a_file_in_a_folder_that_may_not_be_searched(place, capsys, command):
    example = COMMANDS[command][0]
    folder = place / "locked"
    folder.mkdir()
    shutil.copy(place / example, folder / example)
    folder.chmod(0)
    assert call(arguments(command, f"locked/{example}")) == BAD_INPUT
    assert_in_words(capsys.readouterr().err, place)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".yaml", "campaign.yaml/inside.yaml"], ids=["too long", "through a file"]
)
@pytest.mark.parametrize("command", READERS)
def test_a_name_that_no_file_can_have(place, capsys, command, name):
    assert call(arguments(command, name)) == BAD_INPUT
    assert_in_words(capsys.readouterr().err, place)


@pytest.mark.parametrize("command", ["export", "recover", "resume"])
def test_a_run_folder_that_may_not_be_read(place, capsys, command):
    (place / "run").chmod(0)
    # What works on the folder locks it first, and that is a failure of storage.
    locks = command in ("recover", "resume")
    assert call(arguments(command, "run")) == (DEVICE_FAILED if locks else BAD_INPUT)
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert "Permission denied" in shown


@pytest.mark.parametrize(
    ("command", "file", "kind"),
    half(("export", "recover", "resume"), ("run.json", "recording.mcap"), KINDS),
)
def test_a_run_folder_with_a_damaged_file(place, capsys, command, file, kind):
    content = (place / "run" / file).read_bytes()
    (place / "run" / file).unlink()
    KINDS[kind](place / "run" / file, content)
    code = call(arguments(command, "run"))
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    # What can be mended is; a resumed run goes on then, and says what happened.
    assert code in ((BAD_INPUT, DONE) if command in ("recover", "resume") else (BAD_INPUT,)), shown


@pytest.mark.parametrize(
    ("ending", "kind"), half(("csv", "csv.gz", "npz", "mat", "parquet"), KINDS)
)
def test_a_recording_that_cannot_be_used(place, capsys, ending, kind):
    KINDS[kind](place / f"bad.{ending}", (place / f"data.{ending}").read_bytes())
    (place / "bad.yaml").write_text(CAMPAIGN.format(file=f"bad.{ending}"), encoding="utf-8")
    # Half a table is a table, and a degree sign of a vendor in a comment does no harm.
    usable = ending == "csv" and kind in ("truncated", "latin_1")
    code = call(["export", "bad.yaml", "--out", "out.csv"])
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    assert code in ((BAD_INPUT, DONE) if usable else (BAD_INPUT,)), shown
    assert code == DONE or f"bad.{ending}" in shown


DEVICE_FILES = {
    "eds": ("practical", "\nservo: {", "\nservo: {eds: bad.eds, ", DRIVE_EDS),
    "dbc": ("practical_dbc", "  file: null ", "  file: bad.dbc ", DRIVE_DBC),
}
"""Kind of a device file to a bench, what to replace in it by what, and a good file."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("device_file", "command"), [("eds", "run --bench"), ("dbc", "check")])
def test_a_device_file_that_cannot_be_used(place, capsys, device_file, command, kind):
    name, old, new, good = DEVICE_FILES[device_file]
    KINDS[kind](place / f"bad.{device_file}", good.read_bytes())
    bench = resolve(name, "benches").read_text(encoding="utf-8")
    assert old in bench
    (place / "device.yaml").write_text(bench.replace(old, new), encoding="utf-8")
    code = call(arguments(command, "device.yaml"))
    shown = capsys.readouterr().err
    assert_in_words(shown, place)
    # An EDS file may have a comment in another encoding.
    assert code == BAD_INPUT or (device_file, kind) == ("eds", "latin_1"), shown


NUMBERS = ("9" * 400, ".nan", "1e300", "0")
PLACES: Mapping[str, tuple[str, ...]] = {
    "run": ("amplitude_deg: ", "settle_s: ", "sequence: "),
    "run --bench": ("gear_ratio: ", "cycle_Hz: ", "bitrate: ", "rated_current_A: ", "supply_V: "),
    "run --faults": ("after_s: ", "faults: "),
    "export": ("torque_constant: ", "campaign: "),
}
"""Command to the keys whose numbers are replaced."""


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize(
    ("command", "key"), [(command, key) for command, keys in PLACES.items() for key in keys]
)
def test_numbers_that_no_bench_has(place, capsys, command, key, number):
    example = COMMANDS[command][0]
    before, found, after = (place / example).read_text(encoding="utf-8").partition(key)
    assert found, f"{key} is not in the example"
    rest = after.lstrip("-+.0123456789e")
    (place / "bad.yaml").write_text(f"{before}{key}{number}{rest}", encoding="utf-8")
    code = call(arguments(command, "bad.yaml"))
    assert_in_words(capsys.readouterr().err, place)
    # Some of these are allowed, and some the simulated drive refuses.
    assert code in (DONE, BAD_VERDICT, BAD_INPUT, DEVICE_FAILED)


@pytest.mark.parametrize("number", ["NaN", "9" * 400, '"x"'])
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
def test_results_with_numbers_that_none_has(place, capsys, command, key, number):
    raw = json.dumps(result(), indent=1)
    before, found, after = raw.partition(f'"{key}": ')
    rest = after.lstrip("-+.0123456789e")
    (place / "bad.json").write_text(f"{before}{found}{number}{rest}", encoding="utf-8")
    more = ["--yes", "--out", "out"] if command.startswith("run") else []
    code = call([*arguments(command, "bad.json"), *more])
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
