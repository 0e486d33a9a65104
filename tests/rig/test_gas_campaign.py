"""Campaigns of pressure and valve angle, and what `rig diagnose` makes of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from drivers.mock.plant.gas import burn
from drivers.mock.plant.parts.constants import Machine
from identification.diagnosis.gas import CONSTANTS
from identification.model.gas_generator import GasGenerator, ValveGeometry
from identification.recording import Dataset, RecordingError
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.campaign import load_campaign
from rig.results.diagnose.diagnose import burning, without_torque
from rig.results.diagnose.exports import GAS_FILE
from rig.sources.build import load_source

TIME = np.arange(0.0, 6.0, 0.01)
STEPS = np.repeat([4.0, 20.0, 9.0, 26.0, 6.0, 14.0], 100)
EASED = np.convolve(np.pad(STEPS, 12, mode="edge"), np.hanning(25) / np.hanning(25).sum(), "valid")
ANGLES = (np.radians(15.0 - 12.0 * np.cos(2.5 * TIME)), np.radians(EASED))
CHANNELS = {"time": "t", "angle": "theta", "pressure": {"column": "p", "scale": 1e6}}


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    """Three burns of a generator that leaks; the last to validate."""
    rng = np.random.default_rng(4)
    machine = Machine(effects={"leakage": {"area_m2": 2e-5}})
    machine = replace(machine, gas=replace(machine.gas, energy_J_kg=GasGenerator().RT))
    for name, angle in zip("abc", (*ANGLES, ANGLES[0]), strict=True):
        p = burn(machine, angle, 0.01, steps=20).pressure_Pa + 4e3 * rng.standard_normal(len(angle))
        np.savez(tmp_path / f"{name}.npz", t=TIME, theta=angle, p=p * 1e-6)
    files = [{"file": "[ab].npz"}, {"file": "c.npz", "role": "validate"}]
    text = {
        "campaign": 1,
        "bench": {"gas_generator": {}},
        "defaults": {"channels": CHANNELS},
        "recordings": files,
    }
    path = tmp_path / "burns.yaml"
    path.write_text(yaml.safe_dump(text))
    return path


def test_a_leak_is_found_from_a_campaign(campaign: Path) -> None:
    out, result = campaign.parent / "out", campaign.parent / "d.json"
    assert status(["diagnose", str(campaign), "--out", str(out), "--json", str(result)]) == 0
    record = json.loads(result.read_text())
    assert record["schema"] == "loadrig.diagnose/1"
    assert record["verdict"] == "named"
    (effect,) = record["effects"]
    assert effect["name"] == "leakage"
    assert effect["parameters"]["area_m2"]["value"] == pytest.approx(2e-5, rel=0.1)
    assert record["fit"]["equation"] == "pressure"
    assert record["fit"]["validate_final_rms"] < record["fit"]["validate_baseline_rms"]
    assert set(record["parameter_shift"]) == {*CONSTANTS, "V_0"}
    block = yaml.safe_load((out / GAS_FILE).read_text())
    assert block["gas_generator"]["characteristic_velocity"] == record["parameters"]["C_r"]
    assert block["effects"] == {"leakage": {"area_m2": effect["parameters"]["area_m2"]["value"]}}
    assert "mismatch of the pressure equation" in (out / "report.html").read_text()
    text = yaml.safe_load(campaign.read_text())
    text["bench"]["gas_generator"] = block["gas_generator"]
    campaign.write_text(yaml.safe_dump(text))
    assert load_campaign(campaign).value.bench.bench().gas_generator != GasGenerator()


def test_of_a_run_only_hot_firings_show_the_gas(campaign: Path) -> None:
    recordings = load_source(campaign).recordings
    current = np.zeros(len(recordings[0].time))
    hot, cold = (
        replace(recordings[0], stage=stage, channels={**recordings[0].channels, "current": current})
        for stage in ("loaded", "unloaded")
    )
    assert not without_torque(Dataset((*recordings, hot)))
    assert burning(Dataset((*recordings, hot, cold))).recordings == (*recordings, hot)
    with pytest.raises(RecordingError, match="no recording is a hot firing"):
        burning(Dataset((cold,)))


def test_the_block_of_a_campaign(tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    path.write_text(
        "campaign: 1\n"
        "bench:\n"
        "  moment_arm: 0.1\n"
        "  gas_generator:\n"
        "    burning_coefficient: 0.007\n"
        "    back_pressure: 300000\n"
        "    valve: {hole_diameter: 0.02}\n"
        "recordings:\n"
        "  - {file: a.csv, stage: loaded, channels: {time: 0, angle: 1, pressure: 2}}\n"
    )
    bench = load_campaign(path).value.bench.bench()
    valve = ValveGeometry(d=0.02, L1=0.1)
    assert bench.gas_generator == GasGenerator(a=0.007, p_c0=3e5, valve=valve)


@pytest.mark.parametrize(
    ("bench", "channels", "words"),
    [
        ("{}", "{time: 0, angle: 1, pressure: 2}", "add bench.gas_generator"),
        ("{gas_generator: {}}", "{time: 0, angle: 1}", "or `pressure` of a gas generator"),
        (
            "{gas_generator: {pressure_exponent: 1.2}}",
            "{time: 0, angle: 1, pressure: 2}",
            "less than 1",
        ),
    ],
)
def test_what_is_wrong_is_told_with_its_place(tmp_path, bench, channels, words):
    path = tmp_path / "c.yaml"
    path.write_text(
        f"campaign: 1\nbench: {bench}\nrecordings:\n  - file: a.csv\n    channels: {channels}\n"
    )
    with pytest.raises(InputError) as caught:
        load_campaign(path)
    (problem,) = caught.value.problems
    assert words in problem
    assert problem.startswith(f"{path}:")
