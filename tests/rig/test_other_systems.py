"""Windows and macOS: with what they lack hidden, everything imports, and a run is refused."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.port_errors import words
from drivers.serial_port import PySerialPort
from rig.common.errors import InputError
from rig.fault_injection.inject import FileLimit

COMMANDS = """\
look a.csv
identify c.yaml --json id.json
simulate c.yaml --result id.json
diagnose c.yaml
export c.yaml --format mat
run figure10 --dry-run
check practical
run figure10 --yes --out out
"""


def write_campaign(folder: Path) -> None:
    rng = np.random.default_rng(1)
    time = np.arange(3000) * 1e-3
    angle = 0.3 * np.sin(2 * np.pi * time) * np.minimum(1.0, time / 0.5)
    speed = np.gradient(angle, 1e-3)
    torque = 0.2 * np.gradient(speed, 1e-3) + 6.8 * np.tanh(speed / 0.01) + 20 * speed
    torque += 0.05 * rng.normal(size=3000)
    table = np.column_stack([time, angle, torque])
    np.savetxt(folder / "a.csv", table, delimiter=",", header="time,angle,torque", comments="")
    (folder / "c.yaml").write_text(
        "campaign: 1\nbench: {}\nrecordings:\n"
        "  - {file: a.csv, channels: {time: time, angle: angle, torque: torque}}\n"
    )


def test_everything_imports_and_recordings_are_worked_on(tmp_path: Path) -> None:
    write_campaign(tmp_path)
    program = Path(__file__).with_name("posix_less.py")
    ended = subprocess.run(
        [sys.executable, program],
        input=COMMANDS,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = ended.stdout.splitlines()
    assert lines[0].endswith(" modules"), ended.stdout
    assert int(lines[0].split()[0]) > 300
    *worked, run = COMMANDS.splitlines()
    for command in worked:
        assert f"{command}: 0" in lines, ended.stdout + ended.stderr
    assert f"{run}: 4" in lines
    assert "this system cannot lock files" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_a_serial_line_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.serial_port.termios", None)
    with pytest.raises(OSError, match="this system has no termios, which is needed to lock"):
        PySerialPort("/dev/ttyUSB0", 115_200)


def test_an_error_has_words_without_termios(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "termios", None)
    assert words(ValueError("bad")) == "ValueError: bad"


def test_a_disk_cannot_be_filled_without_resource(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    limit = FileLimit()
    with pytest.raises(InputError, match="which this system lacks"):
        limit.fill()
    limit.restore()
