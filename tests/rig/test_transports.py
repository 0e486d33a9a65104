"""A run over real pseudo-terminals and sockets gives the very samples of the simulated bus or
line.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from rig.cli.entry import status
from rig.runs.mcap.reader import read_run

SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: heavy, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 4, frequency_Hz: 1}],
     duration_s: 0.3,
     center_deg: 2, ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.02}
"""
SCRIPT = Path(__file__).parents[1] / "long" / "transports.py"


@pytest.fixture(scope="module")
def transports() -> ModuleType:
    spec = importlib.util.spec_from_file_location("long_transports", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("transport", ["slcan on a pty", "socketcand on loopback"])
def test_the_same_samples(transports: ModuleType, tmp_path: Path, transport: str) -> None:
    (tmp_path / "s.yaml").write_text(SEQUENCE)
    for name, wire in (("plain", "CANopen"), ("wired", transport)):
        with transports.wired(wire):
            assert (
                status(["run", str(tmp_path / "s.yaml"), "--yes", "--out", str(tmp_path / name)])
                == 0
            )
    plain, wired = (
        read_run(tmp_path / name / "recording.mcap").samples for name in ("plain", "wired")
    )
    assert len(plain["time"]) > 300
    for field in (
        "time",
        "command",
        "angle",
        "motor_angle",
        "current",
        "velocity",
        "statusword",
        "fresh",
    ):
        np.testing.assert_array_equal(plain[field], wired[field])


def test_an_epos_and_an_amt21_on_pseudo_terminals(transports: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(SEQUENCE)
    out = tmp_path / "out"
    with transports.wired("EPOS serial, AMT21"):
        assert (
            status(
                [
                    "run",
                    str(tmp_path / "s.yaml"),
                    "--bench",
                    "practical_serial",
                    "--yes",
                    "--out",
                    str(out),
                ]
            )
            == 0
        )
    samples = read_run(out / "recording.mcap").samples
    moving = samples["segment"] == 1
    assert samples["fresh"][moving].all()
    assert np.abs(samples["angle"] - samples["command"])[moving].max() < np.radians(1.0)


@pytest.mark.parametrize(
    ("transport", "bench"),
    [
        ("slcan on a pty", "practical"),
        ("socketcand on loopback", "practical"),
        ("EPOS serial, AMT21", "practical_serial"),
    ],
)
def test_a_bench_is_checked_over_its_wire(
    transports: ModuleType, capsys: pytest.CaptureFixture[str], transport: str, bench: str
) -> None:
    with transports.wired(transport):
        assert status(["check", bench]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-2:] for line in lines if line.startswith("supply voltage ")] == [
        ["60.0", "V"]
    ]
    assert lines[-1] == "verdict: good: a run would start"
