"""The shared real recordings, read in place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.recording import Dataset
from rig.sources import load_source

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT.parent / "shared" / "recordings"
CAMPAIGNS = ROOT / "tests" / "campaigns"

pytestmark = [pytest.mark.recordings, pytest.mark.usefixtures("recordings")]


def write(folder: Path, text: str) -> Dataset:
    path = folder / "campaign.yaml"
    path.write_text(text.replace("RECORDINGS", str(RECORDINGS)))
    return load_source(path)


def test_every_sts3032_file_loads_and_falls_freely_while_off(tmp_path: Path) -> None:
    data = write(
        tmp_path,
        "campaign: 1\n"
        "bench: {torque_constant: 0.4934, back_emf_constant: 0.4934, resistance: 4.0916}\n"
        "recordings:\n"
        "  - file: RECORDINGS/sts3032_lever/m*.csv\n"
        "    gravity: {mass: 0.3, length: 0.07}\n"
        "    channels: {time: time_s, angle: angle_rad, enabled: torque_enabled, voltage: "
        "voltage_V}\n",
    )
    assert len(data.recordings) == 96
    for recording in data.recordings:
        off = recording.channels["enabled"] == 0
        assert bool(off.any()) == ("lift_and_drop" in recording.name)
        np.testing.assert_array_equal(np.isnan(recording.channels["voltage"]), off)


@pytest.mark.parametrize(("skip_rows", "time", "torque"), [(14, "0", "2"), (13, "ms", "'%'")])
def test_epos_exports_as_they_are(tmp_path: Path, skip_rows: int, time: str, torque: str) -> None:
    data = write(
        tmp_path,
        "campaign: 1\n"
        "bench: {}\n"
        "defaults:\n"
        f"  read: {{delimiter: ';', skip_rows: {skip_rows}}}\n"
        "  channels:\n"
        f"    time: {{column: {time}, scale: 1e-3}}\n"
        "    velocity: {column: 1, scale: -0.10471975511965977}\n"
        f"    torque: {{column: {torque}, scale: -9.84e-5}}\n"
        "recordings:\n"
        "  - file: RECORDINGS/screw_drives/driveNo*/steady_state/0.096kg/[!n]*.csv\n"
        "  - file: RECORDINGS/screw_drives/driveNo*/steady_state/0.096kg/n[13-9]*.csv\n"
        "  - file: RECORDINGS/screw_drives/driveNo*/steady_state/0.096kg/n2?*.csv\n"
        "  - file: RECORDINGS/screw_drives/driveNo1/steady_state/0.096kg/n2.csv\n"
        f"    read: {{skip_rows: {skip_rows - 2}}}\n"
        "  - file: RECORDINGS/screw_drives/driveNo*/start_stop/*.csv\n",
    )
    assert len(data.recordings) == len(list((RECORDINGS / "screw_drives").rglob("*.csv")))
    for recording in data.recordings:
        assert len(recording.time) == 500
        if "start_stop" not in recording.source:
            speed = float(Path(recording.source).stem.replace("n", "-")) * np.pi / 30
            assert np.mean(recording.channels["velocity"]) == pytest.approx(
                speed, rel=0.15, abs=0.1
            )
