"""Fault schedules: read with every error at its place, brought about on a run, and judged."""

import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.faults import FAULTS, FaultRow, load_faults
from rig.fault_injection.inject import ACTIONS
from rig.fault_injection.scene import ACTIONS as BENCH_ACTIONS
from rig.fault_injection.scene import impossible
from rig.runs.mcap.reader import read_run
from rig.runs.run import read_record

from ..long import fault_matrix, fuzz

YAML = """\
faults: 1
rows:
  - {time_s: 0.5, target: bus, fault: lost, count: 3, frames: {device: drive, function: motion}}
  - {phase: excite, after_s: 0.25, target: encoder, fault: jump, value: -3,
     expect: {deenergised_within_s: 0.1, exit_status: 1, words: "encoder against drive"}}
  - {state: quick_stop_active, target: drive, fault: fault, value: 0x7320}
"""
CSV = """\
time_s,phase,state,after_s,target,fault,value,count,device,function,deenergised_within_s,exit_status,words
0.5,,,,bus,lost,,3,drive,motion,,,
,excite,,0.25,encoder,jump,-3,,,,0.1,1,encoder against drive

,,quick_stop_active,,drive,fault,0x7320,,,,,,
"""


pytestmark = pytest.mark.usefixtures("elsewhere", "unpaged")


def schedule(*rows: str) -> Path:
    path = Path("faults.yaml")
    path.write_text("faults: 1\nrows:\n" + "".join(f"  - {{{row}}}\n" for row in rows))
    return path


def run(*rows: str, options: tuple[str, ...] = ("--yes",)) -> tuple[int, list[dict[str, Any]]]:
    Path("sequence.yaml").write_text(fault_matrix.SEQUENCE)
    code = status(
        ["run", "sequence.yaml", *options, "--out", "out", "--faults", str(schedule(*rows))]
    )
    return code, json.loads(Path("out/faults.json").read_text())["faults"]


def test_yaml_and_csv_say_the_same() -> None:
    Path("a.yaml").write_text(YAML)
    Path("a.csv").write_text(CSV)
    assert load_faults(Path("a.yaml")).value == load_faults(Path("a.csv")).value
    assert load_faults(Path("a.csv")).value.rows[2].amount == 0x7320


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("target: bus, fault: lost", "exactly one of time_s, phase and state"),
        ("phase: hold, target: bus, fault: lots", "did you mean 'lost'"),
        ("phase: hold, target: drive, fault: restart, value: 1", "takes no value"),
        ("phase: hold, target: drive, fault: fault, frames: {device: drive}", "'frames'"),
        ("phase: hold, target: bus, fault: lost, expect: {words: '('}", "regular expression"),
        ("phase: hold, target: bus, fault: lost, cuont: 3", "did you mean 'count'"),
        ("phase: hold, target: drive, fault: restart, count: 3", "takes no count"),
        ("time_s: 1, stage: a, target: bus, fault: lost", "'stage' needs 'phase'"),
        ("phase: hold, target: encoder, fault: bit, value: -1", "0 to 65535"),
        ("phase: hold, target: drive, fault: fault, value: 70000", "0 to 65535"),
    ],
)
def test_every_error_is_at_its_place(row: str, words: str) -> None:
    path = schedule("phase: hold, target: bus, fault: lost", row)
    with pytest.raises(InputError) as caught:
        load_faults(path)
    (problem,) = caught.value.problems
    assert problem.startswith(f"{path}:4:")
    assert words in problem


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("phase,target,fault\nhold,bus,lost\nhold,bus,lots\n", "3:1", "did you mean 'lost'"),
        ("phase,target,fault,count\nhold,bus,lost,many\n", "2:15", "valid integer"),
        ("phase,target,fault\nhold,bus\n", "2:1", "2 cells under 3 columns"),
        ('phase,target,fault\nhold,"bus"x,lost\n', "2:1", "not valid CSV"),
    ],
)
def test_errors_in_csv_have_a_place_too(text: str, place: str, words: str) -> None:
    path = Path("faults.csv")
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_faults(path)
    assert f"{path}:{place}: " in caught.value.problems[0]
    assert words in caught.value.problems[0]


def test_every_kind_of_fault_can_be_brought_about_and_is_in_the_matrix() -> None:
    assert set(ACTIONS) | set(BENCH_ACTIONS) == set(FAULTS)
    assert not set(ACTIONS) & set(BENCH_ACTIONS)
    used: set[tuple[str, str]] = set()
    for transport in fault_matrix.TRANSPORTS.values():
        rows = [
            FaultRow(phase="hold", **row) for case in transport.cases.values() for row in case.rows
        ]
        used |= {(row.target, row.fault) for row in rows}
        bench = load_bench(transport.bench).value
        possible = {
            fault
            for fault in FAULTS
            if impossible(
                FaultRow(
                    phase="hold",
                    target=fault[0],
                    fault=fault[1],
                    value=2 if FAULTS[fault].unit else None,
                ),
                bench,
            )
            is None
        }
        assert {(row.target, row.fault) for row in rows} == possible
    assert used == set(FAULTS)


@pytest.mark.parametrize(
    ("bench", "row", "words"),
    [
        ("practical", "phase: hold, target: line, fault: cut", "no line; it has bus"),
        ("practical_serial", "phase: hold, target: bus, fault: lost", "line and encoder_line"),
        ("practical", "phase: hold, target: drive, fault: counter_stuck", "of kind dbc"),
        ("practical_dbc", "phase: hold, target: drive, fault: fault", "(got 29472)"),
        ("practical_dbc", "state: switched_on, target: bus, fault: lost", "no state switched_on"),
    ],
)
def test_a_fault_that_a_bench_cannot_have_is_refused(bench, row, words, capsys):
    Path("sequence.yaml").write_text(fault_matrix.SEQUENCE)
    path = schedule("phase: hold, target: operator, fault: stop", row)
    options = ["--bench", bench, "--yes", "--out", "out", "--faults", str(path)]
    assert status(["run", "sequence.yaml", *options]) == 2
    told = capsys.readouterr().err
    assert f"{path}:4:" in told
    assert words in told
    assert not Path("out").exists()


def test_the_reaction_is_judged_and_told(capsys: pytest.CaptureFixture[str]) -> None:
    code, (good, bad, never) = run(
        "phase: excite, after_s: 0.1, target: encoder, fault: jump, "
        "expect: {deenergised_within_s: 0.1, exit_status: 1, words: against}",
        "phase: excite, after_s: 0.1, target: bus, fault: repeated, "
        "expect: {deenergised_within_s: 0.001, exit_status: 0, words: nothing}",
        "phase: hold, target: bus, fault: lost",
    )
    assert code == 1
    assert good["as_expected"] is True
    assert 0 < good["off_after_s"] < 0.1
    assert bad["as_expected"] is False
    assert [remark.split(":")[0] for remark in bad["remarks"]] == [
        "de-energised after",
        "exit status",
        "words",
    ]
    assert (never["applied_s"], never["as_expected"]) == (None, False)
    told = capsys.readouterr().out
    assert "row 2: exit status: expected 0, found 1" in told
    assert "row 3: the fault was never triggered" in told


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("target: operator, fault: stop", 3),
        ("target: operator, fault: weight_removed, value: 0", 0),
        ("target: bus, fault: lost, count: 1", 0),
    ],
)
def test_a_fault_at_the_first_moment_meets_a_run(fault: str, code: int) -> None:
    found, (finding,) = run(f"time_s: 0, {fault}")
    assert found == code
    assert finding["applied_s"] is not None


def test_a_recording_that_fails_at_the_first_moment_energises_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(FileNotFoundError):
        run("time_s: 0, target: host, fault: recorder_fails")
    assert "nothing was energised" in capsys.readouterr().err


def test_faults_are_for_simulated_benches_only(capsys: pytest.CaptureFixture[str]) -> None:
    Path("sequence.yaml").write_text(fault_matrix.SEQUENCE)
    text = resolve("practical", "benches").read_text().split("mock:  ")[0]
    Path("bench.yaml").write_text(
        text.replace("interface: mock", "interface: virtual, channel: nobody")
    )
    path = schedule("phase: hold, target: bus, fault: lost")
    options = ["--bench", "bench.yaml", "--yes", "--out", "out", "--faults", str(path)]
    assert status(["run", "sequence.yaml", *options]) == 2
    assert "only be injected on a simulated bench" in capsys.readouterr().err


def test_a_prompt_that_nobody_answers_in_time() -> None:
    code, (finding,) = run(
        "phase: prompt, target: operator, fault: unanswered, value: 3600",
        options=("--yes", "--prompt-timeout", "60"),
    )
    assert (code, finding["off_after_s"]) == (3, 0.0)
    record = read_record(Path("out"))
    assert "nobody answered the prompt within 60 s" in record.message
    assert record.de_energised


def test_a_step_of_the_wall_clock_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("sequence.yaml").write_text(fault_matrix.SEQUENCE)
    assert status(["run", "sequence.yaml", "--yes", "--out", "calm"]) == 0
    wall, calls = time.time, itertools.count()
    monkeypatch.setattr(time, "time", lambda: wall() + 3600 * (-1) ** next(calls))
    assert status(["run", "sequence.yaml", "--yes", "--out", "stepped"]) == 0
    calm, stepped = (
        read_run(Path(folder) / "recording.mcap").messages["/sample"]
        for folder in ("calm", "stepped")
    )
    assert calm == stepped


def _reduced() -> list[tuple[str, str, str]]:
    """Return every fault once, transports and phases in turn; `make fault-matrix` runs all."""
    phases = itertools.cycle(fault_matrix.PHASES)
    lines = fault_matrix.TRANSPORTS
    names = dict.fromkeys(name for t in lines.values() for name in t.cases)
    able = [[line for line, t in lines.items() if name in t.cases] for name in names]
    return [
        (of[n % len(of)], name, next(phases))
        for n, (name, of) in enumerate(zip(names, able, strict=True))
    ]


@pytest.mark.parametrize(("line", "name", "phase"), _reduced())
def test_reduced_matrix(line: str, name: str, phase: str, tmp_path: Path) -> None:
    transport = fault_matrix.TRANSPORTS[line]
    assert (
        fault_matrix.run_case(
            transport.cases[name], phase, transport.bench, tmp_path / "case"
        ).problems
        == ()
    )


@pytest.mark.parametrize(
    ("line", "state"),
    [(line, state) for line, t in fault_matrix.TRANSPORTS.items() for state in t.states],
)
def test_a_drive_fault_in_every_state(line: str, state: str, tmp_path: Path) -> None:
    transport = fault_matrix.TRANSPORTS[line]
    rows, must = fault_matrix.state_rows(state, transport)
    assert fault_matrix.run_rows(rows, must, transport.bench, tmp_path / "case").problems == ()


@pytest.mark.parametrize("decoder", fuzz.DECODERS)
def test_fuzzed_frames(decoder: str) -> None:
    counts = fuzz.DECODERS[decoder](2_000, np.random.default_rng(1))
    assert max(counts["frames"], counts["bytes"]) >= 2_000


def test_fuzzed_recordings(tmp_path: Path) -> None:
    counts = fuzz.fuzz_recording(2_000, np.random.default_rng(1), tmp_path)
    assert counts["damage reported"] > 20
