"""Friction feed-forward: what is sent in which cycle, what is refused, what it does to a run."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mock.plant.machine import SimulatedMachine
from identification.estimate.paper_method import identify_paper
from identification.model.parameters import NOMINAL
from identification.recording import Array, Recording
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.control.remote import RunProgress
from rig.planning.feedforward import (
    Compensator,
    Feedforward,
    Offsets,
    load_feedforward,
    require_torque_offset,
    stage_offsets,
)
from rig.planning.plan import make_plan
from rig.results.identify.identify import METHODS
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.run import bench_constants, load_run, read_record

CYCLE_S = 1e-3
KNOWN = Feedforward(NOMINAL, 2.0, 0.095 * 10 * 9.80665, "known.json", "0" * 64)
RAMPS = """\
sequence: 1
name: ramps
stages:
  - {name: slow, stage: unloaded, ramp: {travel_deg: 2, speed_deg_s: 2, rest_s: 0.2},
     duration_s: 2.4}
  - {name: fast, stage: loaded, weight_kg: 30.6, ramp: {travel_deg: 4, speed_deg_s: 8,
     rest_s: 0.2}, duration_s: 1.4}
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ramps.yaml").write_text(RAMPS)


def result_file(name: str = "result.json", **changes: Any) -> Path:
    """Write a result of ``rig identify`` with the true values, but for ``changes``."""
    values = {**NOMINAL, **changes}
    raw = {
        "schema": "loadrig.identify/1",
        "motion": "rotary",
        "alpha": 2.0,
        "parameters": {key: {"value": value} for key, value in values.items()},
    }
    path = Path(name)
    path.write_text(json.dumps(raw))
    return path


def test_a_hot_firing_is_without_feed_forward() -> None:
    """Its load is that of the gas, which the model does not know."""
    bench = load_bench("practical_hot")
    plan = make_plan(load_sequence("hotfire"), bench, feedforward=KNOWN)
    hot = {s.name for s in plan.stages if s.stage == "hot_fire"}
    assert hot
    assert {s.name for s in plan.stages if s.offsets is None} == hot


def sample(motor_angle: float, fresh: bool = True) -> Sample:
    return Sample(*([0.0] * 5), motor_angle, *([0.0] * 8), 1, fresh)


def load(path: Path) -> Feedforward:
    return load_feedforward(path, bench_constants(load_bench("practical").value))


def offsets_of(targets: Array, weight_kg: float = 0.0, model: Feedforward = KNOWN) -> Offsets:
    return stage_offsets(model, targets, weight_kg, CYCLE_S, 75.0, np.deg2rad(120.0))


def test_what_is_not_identified_is_named() -> None:
    with pytest.raises(InputError) as caught:
        load(result_file(Mc=None, J=None))
    assert [p.split(": ")[1] for p in caught.value.problems] == ["parameters.Mc", "parameters.J"]
    assert all("not identified, but feed-forward needs it" in p for p in caught.value.problems)


def test_the_load_is_needed_only_for_loaded_stages() -> None:
    found = load(result_file(mu_c=None))
    targets = np.linspace(0.0, 0.1, 100)
    assert np.any(offsets_of(targets, model=found).torque)
    with pytest.raises(InputError, match=r"parameters\.mu_c: not identified"):
        offsets_of(targets, 10.0, found)


def test_a_rise_that_is_open_is_none_and_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """Kinetic friction is fed forward, and stiffness brings up the rest."""
    found = load(result_file(Ms=None, omega_sL=None))
    assert found.left_open == ("Ms", "omega_sL")
    targets = 0.02 * CYCLE_S * np.arange(500)
    p = NOMINAL
    kinetic = (
        p["Mc"] + 0.02 * p["sigma_2"] + 30.6 * KNOWN.moment_per_kg * (p["mu_c"] + 0.02 * p["mu_2"])
    )
    bare, whole = (offsets_of(targets, 30.6, model) for model in (found, KNOWN))
    assert bare.torque[200:206] == pytest.approx(np.full(6, kinetic))
    assert bare.stiffness[200] == whole.stiffness[200]
    path = result_file("open.json", Ms=None, omega_sL=None)
    assert status(["run", "ramps.yaml", "--feedforward", str(path), "--dry-run"]) == 0
    assert (
        "open.json leaves Ms, omega_sL undetermined: the feed-forward torque contains no rise"
        in capsys.readouterr().err
    )
    assert load(result_file()).remark is None


def test_the_torque_of_a_cycle_goes_with_its_target() -> None:
    """Eq. 15 for the period in which the target is reached; feedback of the last two samples."""
    targets = 0.05 * np.sin(np.linspace(0.0, 6.0, 3000))
    offsets = offsets_of(targets)
    give = Compensator(offsets, 100.0, CYCLE_S)
    arrived = np.concatenate([[0.0], targets[:-1]])
    sent = [give(None)] + [give(sample(100.0 * angle)) for angle in arrived[:-1]]
    np.testing.assert_allclose(sent, offsets.torque, atol=1e-9)


def test_a_joint_that_lags_is_pulled_and_pushed() -> None:
    """At 0.1 rad/s: K times what it lags by, two cycles late, and D times the whole speed."""
    offsets = offsets_of(0.1 * CYCLE_S * np.arange(50))
    give = Compensator(offsets, 100.0, CYCLE_S)
    standing = [give(None)] + [give(sample(0.0)) for _ in range(49)]
    assert offsets.stiffness[20] == pytest.approx(5463, rel=1e-3)
    assert offsets.damping[20] == pytest.approx(78.9, rel=1e-3)
    added = 0.1 * CYCLE_S * 18 * offsets.stiffness[20] + 0.1 * offsets.damping[20]
    assert standing[20] - offsets.torque[20] == pytest.approx(added)


def test_a_joint_far_off_is_brought_back_slowly() -> None:
    offsets = offsets_of(0.01 * CYCLE_S * np.arange(50))
    for off, way in ((0.1, -1.0), (-0.1, 1.0)):
        give = Compensator(offsets, 100.0, CYCLE_S)
        sent = [give(None)] + [give(sample(100.0 * off)) for _ in range(49)]
        pull = sent[20] - offsets.torque[20] - 0.01 * offsets.damping[20]
        assert pull == pytest.approx(way * offsets.damping[20] * np.deg2rad(12.0), rel=1e-6)


def test_a_sample_that_is_not_fresh_adds_nothing() -> None:
    offsets = offsets_of(0.02 * CYCLE_S * np.arange(50))
    give = Compensator(offsets, 100.0, CYCLE_S)
    fresh = [True] * 20 + [False] + [True] * 28
    sent = np.array([give(None)] + [give(sample(0.0, f)) for f in fresh])
    added = sent - offsets.torque
    assert added[21] == 0.0
    # The next sample is fresh: its angle counts, its speed not yet.
    assert added[22] == pytest.approx(0.02 * CYCLE_S * 20 * offsets.stiffness[22])
    assert np.all(added[23:] > added[22])
    assert np.all(added[5:21] > 0.0)


def test_more_than_the_limit_is_not_sent() -> None:
    ten, none = np.full(10, 10.0), np.zeros(10)
    give = Compensator(Offsets(ten, none, np.full(10, 80.0), none, none, 0.0, 12.0), 100.0, CYCLE_S)
    assert give(None) == 10.0
    assert give(sample(0.0)) == 10.0
    assert give(sample(10.0)) == -12.0  # 0.1 rad in a cycle
    assert give(sample(0.0)) == 12.0


@pytest.mark.parametrize(
    ("bench", "key"),
    [("practical_dbc", "servo.torque_offset"), ("practical_serial", "bus.interface")],
)
def test_transports_without_it_refuse(bench: str, key: str) -> None:
    with pytest.raises(InputError, match=rf": {key}: "):
        require_torque_offset(load_bench(bench))


def test_more_torque_than_the_limit_is_refused_beforehand(capsys):
    heavy = str(result_file(mu_c=0.3))
    assert status(["run", "ramps.yaml", "--feedforward", heavy, "--dry-run"]) == 2
    err = capsys.readouterr().err
    assert "stages[1].weight_kg: " in err
    assert "limit torque_N_m 75 N m" in err


def test_the_longer_frame_must_fit_the_bus() -> None:
    """At 800 kbit/s a cycle fits, by a hair, and with two more bytes it does not."""
    text = resolve("practical", "benches").read_text()
    Path("bench.yaml").write_text(text.replace("bitrate: 1000000", "bitrate: 830000"))
    with pytest.raises(InputError, match=r"bus\.bitrate: too slow: a cycle of 1 ms takes"):
        require_torque_offset(load_bench("bench.yaml"))
    require_torque_offset(load_bench("practical"))


def tracking_rms(recording: Recording) -> float:
    """Rms of the command, which arrives one cycle later, less the measured angle, rad."""
    command: Array = recording.channels["command"]
    arrived = np.concatenate([command[:1], command[:-1]])
    return float(np.sqrt(np.mean((arrived - recording.channels["angle"]) ** 2)))


def test_a_soft_drive_follows_a_slow_ramp() -> None:
    """With the true parameters; identified ones are tried in ``benchmarks/feedforward.py``."""
    options = ["ramps.yaml", "--bench", "practical_soft", "--yes"]
    assert status(["run", *options, "--out", "plain"]) == 0
    assert status(["run", *options, "--feedforward", str(result_file()), "--out", "fed"]) == 0
    plain, fed = (load_run(Path(folder)).recordings for folder in ("plain", "fed"))
    assert all(
        tracking_rms(one) > 100 * tracking_rms(other) for one, other in zip(plain, fed, strict=True)
    )
    record = read_record(Path("fed"))
    assert record.inputs["feedforward.json"]["file"] == str(Path("result.json").absolute())
    assert (
        json.loads(read_run(Path("fed/recording.mcap")).attachments["feedforward.json"])["alpha"]
        == 2.0
    )
    assert "feedforward.json" not in read_record(Path("plain")).inputs


@pytest.mark.usefixtures("undrawn")
def test_a_log_recorded_with_it_is_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "paper", partial(identify_paper, generations=2))
    Path("sine.yaml").write_text(
        "sequence: 1\nname: sine\nstages:\n"
        "  - {name: sine, stage: unloaded, tones: [{amplitude_deg: 20, frequency_Hz: 0.4}], "
        "duration_s: 4}\n"
    )
    options = ["--yes", "--feedforward", str(result_file()), "--out", "fed"]
    assert status(["run", "sine.yaml", *options]) == 0
    found = ["--method", "paper", "--out", "report", "--json", "fed.json"]
    assert status(["identify", "fed", *found]) == 0
    warnings = json.loads(Path("fed.json").read_text())["warnings"]
    assert any("recorded with feed-forward" in w for w in warnings)


def test_a_run_is_resumed_with_the_same_identification(monkeypatch: pytest.MonkeyPatch) -> None:
    path = result_file()

    def press(self: RunProgress, name: str, *rest: Any) -> None:
        if name == "fast":
            raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(RunProgress, "__call__", press)
        assert (
            status(["run", "ramps.yaml", "--yes", "--feedforward", str(path), "--out", "out"]) == 3
        )
    assert status(["resume", "out", "--yes"]) == 0
    again = load_run(Path("out")).recordings[1]
    assert tracking_rms(again) < 1e-4


@pytest.mark.parametrize(
    "fault", ["drive, fault: fault, value: 0x7320", "encoder, fault: jump, value: 3"]
)
def test_a_fault_ends_without_power_and_without_offset(fault: str) -> None:
    """The drive's ramp brakes; the offset neither drives on nor is left behind in the drive."""
    Path("faults.yaml").write_text(
        f"faults: 1\nrows:\n  - {{phase: excite, after_s: 0.5, target: {fault}}}\n"
    )
    options = ["--yes", "--feedforward", str(result_file()), "--faults", "faults.yaml"]
    assert status(["run", "ramps.yaml", *options, "--out", "out"]) in (1, 4)
    record = read_record(Path("out"))
    assert record.de_energised
    log = read_run(Path("out/recording.mcap"))
    sent = [f for message in log.messages["/frames"] for f in decode_frames(message.data) if f.sent]
    fed = [k for k, f in enumerate(sent) if f.identifier == 0x201 and f.data[6:8] != bytes(2)]
    assert len(fed) > 400
    assert {sent[k].data[:2] for k in fed} == {b"\x0f\x00"}
    cleared = b"\x2b\xb2\x60\x00" + bytes(4)
    assert any(f.identifier == 0x601 and f.data == cleared for f in sent[fed[-1] :])


def drive_by_hand(targets: Array, start: float, released_s: float) -> tuple[float, float]:
    """Run the soft bench under 30.6 kg without a bus, from ``start`` rad, and take the weight off
    at ``released_s``.

    Returns:
        Greatest speed over a cycle, rad/s, and greatest current, A.
    """
    machine = load_bench("practical_soft").value.mock
    assert machine is not None
    plant = SimulatedMachine(machine, np.random.default_rng(0))
    plant.hang(30.6)
    plant.power(True)
    count = plant.motor_count_rad
    give = Compensator(offsets_of(targets, 30.6), 100.0, CYCLE_S)
    before: Sample | None = None
    speeds, currents = [], []
    for k, target in enumerate(targets.tolist()):
        if k == round(released_s / CYCLE_S):
            plant.hang(0.0)
        torque = give(before)
        reading = plant.latch()
        angle = reading.motor_counts * count + start
        speeds.append(0.0 if before is None else abs(angle - before.motor_angle / 100.0) / CYCLE_S)
        currents.append(abs(reading.current_A))
        plant.track((target - start) / count, 1_000_000)
        plant.feed(torque / 3.0)
        plant.advance(1_000_000)
        before = sample(100.0 * angle)
    return max(speeds), max(currents)


@pytest.mark.parametrize(("start", "speed_deg_s"), [(0.0, 0.3), (-0.06, 1.0), (0.06, 8.0)])
def test_neither_a_released_lever_nor_a_standing_error_makes_it_run_away(start, speed_deg_s):
    targets = np.deg2rad(speed_deg_s) * CYCLE_S * np.arange(1500)
    fastest, current = drive_by_hand(targets, start, 0.7)
    assert fastest < 0.5 * np.deg2rad(120.0)
    assert current < 25.0
