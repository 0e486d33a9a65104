"""Worlds for any plant: what is drawn, what the logger makes of signals, what is judged."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.__main__ import MUJOCO, OWN, THIRD, main, plant_named
from benchmarks.worlds.coverage import WORDS, uncovered
from benchmarks.worlds.draw import draw_world, without_effects, worlds_assignment
from benchmarks.worlds.files import truth_of_world, write_world
from benchmarks.worlds.logger import columns
from benchmarks.worlds.motion import MOTIONS, Reach, command
from benchmarks.worlds.mujoco_plant.plant import MujocoPlant
from benchmarks.worlds.own_plant.plant import OwnPlant
from benchmarks.worlds.seal import log_of, seal_worlds, strength_of
from benchmarks.worlds.sizes import SIZES
from benchmarks.worlds.torque import Course
from benchmarks.worlds.world import COMMAND_S, Planned, Signals, World
from rig.cli.entry import status
from rig.results.prove.engine import Processes
from rig.results.prove.run import SUMS_FILE, sealed_rigs
from rig.results.prove.truth import load_truth
from rig.sources import load_source
from tests.worlds.test_plants import carriage

IN_CATALOGUE = [name for name in SIZES if not name.startswith("x_")]


class Follower:
    """A machine that follows its command exactly, with a current in proportion to its speed."""

    effects = frozenset(IN_CATALOGUE)
    outside = frozenset({"x_timed_torque"})
    not_scored = frozenset({"backlash.gap_rad"})

    def play(self, world: World) -> Iterator[Signals]:
        session_s = 0.0
        for planned in world.recordings:
            session_s += planned.pause_s
            rate = world.drive.rate_Hz
            at = np.arange(round(len(planned.command) * COMMAND_S * rate)) / rate
            path = np.interp(at, np.arange(len(planned.command)) * COMMAND_S, planned.command)
            speed = np.gradient(path, 1.0 / rate)
            first = round(planned.lead_s * rate)
            kept = (speed, 2.0 * speed, 2.0 * speed, 0.0 * speed + 24.0)
            angles = (path * world.motor.gear_ratio, path, path)
            yield Signals(*(x[first:] for x in (*kept, *angles)), session_s + planned.lead_s)
            session_s += len(at) / rate


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "SHORTEST_S", 1.0)
    monkeypatch.setattr(drawing, "LONGEST_S", 2.0)
    monkeypatch.setattr(drawing, "MOST", 3)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have short recordings, whose number is drawn as ever."""
    monkeypatch.setattr(drawing, "SHORTEST_S", 1.0)
    monkeypatch.setattr(drawing, "LONGEST_S", 1.5)


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_motion_begins_at_rest_and_stays_within_reach(motion: str) -> None:
    reach = Reach(0.4, 1.5, 20.0)
    for seed in range(5):
        path = command(np.random.default_rng(seed), motion, 6.0, 1.0, reach)
        speed = np.gradient(path, COMMAND_S)
        assert (len(path), path[0]) == (7000, 0.0)
        asked = [np.abs(x).max() for x in (path, speed, np.gradient(speed, COMMAND_S))]
        shares = [a / limit for a, limit in zip(asked, reach, strict=True)]
        assert max(shares) <= 1.0 + 1e-9
        assert max(shares) > 0.5
        assert abs(speed[0]) < 0.01 * reach.speed


def test_a_world_repeats_with_its_seed_and_effects_do_not_change_the_machine() -> None:
    first, again = (draw_world("one", ("cogging",), (3, k)) for k in (1, 1))
    assert first.effects == again.effects
    assert np.array_equal(first.recordings[0].command, again.recordings[0].command)
    plain = draw_world("nothing", (), (3, 1))
    assert (plain.constants, plain.drive, plain.axes) == (first.constants, first.drive, first.axes)
    assert draw_world("nothing", (), (3, 2)).constants != plain.constants


def test_a_machine_has_one_coupling() -> None:
    coupling = {"backlash", "compliance", "coupling_hysteresis"}
    drawn = worlds_assignment(600, 5, sorted({*coupling, "cogging"}), ("x_bursts",))
    pairs = [set(names) for kind, names in drawn if kind == "two"]
    assert len(pairs) == 60
    assert all(len(pair & coupling) == 1 for pair in pairs)


def test_make_prove_covers_every_axis_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The axes do not depend on the courses of the motions, which take most of the time."""
    makefile = (Path(__file__).parents[2] / "Makefile").read_text()
    found = re.search(r"PROVE_WORLDS := --plant mujoco --rigs (\d+) --seed (\d+)", makefile)
    rigs, seed = int(found[1]), int(found[2])
    path = np.linspace(0.0, 0.1, 50)
    monkeypatch.setattr(drawing, "command", lambda *_: path)
    monkeypatch.setattr(drawing, "course", lambda *_: Course(path, path))
    assigned = worlds_assignment(rigs, seed, MujocoPlant.effects, MujocoPlant.outside)
    axes = [draw_world(*a, (seed, n)).axes for n, a in enumerate(assigned, start=1)]
    assert uncovered(axes) == {}
    assert "load" in uncovered(axes[:4])
    assert uncovered([]).keys() == WORDS.keys()


def world_with(effects: dict[str, dict[str, float]], **log: object) -> World:
    world = draw_world("nothing", (), (8, 3))
    still = np.zeros(500)
    sensing = replace(
        world.sensing,
        motor_bits=20,
        joint_bits=22,
        flicker=0.0,
        lines_error=0.0,
        current_noise_A=0.0,
        current_quantum_A=1e-9,
    )
    return replace(
        world,
        effects=effects,
        motion="rotary",
        sensing=sensing,
        drive=replace(world.drive, rate_Hz=4000, kind="cascade"),
        log=replace(world.log, rate_Hz=500, jitter=0.0, clock=False, supply=False, **log),
        recordings=(
            Planned("a", "fit", "sine", still, 0.0),
            Planned("b", "fit", "sine", still, 0.0),
        ),
    )


def swinging(frequency_Hz: float = 3.0) -> Signals:
    t = np.arange(4000) / 4000.0
    wave = np.sin(2.0 * np.pi * frequency_Hz * t)
    return Signals(wave, wave, wave, 0.0 * t, 50.0 * wave, wave, wave, 0.0)


def logged(world: World, k: int = 0) -> dict[str, np.ndarray]:
    return columns(world, k, swinging(), np.random.default_rng(1))


def lag_s(moved: np.ndarray, reference: np.ndarray) -> float:
    """Return by how much a sine of 3 Hz at 500 Hz is late, from its phase."""
    turn = np.exp(-2j * np.pi * 3.0 * np.arange(len(moved)) / 500.0)
    return float(np.angle(np.sum(reference * turn) / np.sum(moved * turn)) / (2.0 * np.pi * 3.0))


def test_each_way_of_logging_a_current_is_as_late_as_it_says() -> None:
    exact = logged(world_with({}, current="sampled"))["current"]
    averaged = logged(world_with({}, current="averaged"))["current"]
    filtered = logged(world_with({}, current="filtered", filter_Hz=100.0))["current"]
    assert lag_s(averaged, exact) == pytest.approx(0.5 / 500.0, rel=0.02)
    assert lag_s(filtered, exact) == pytest.approx(1.0 / (2.0 * np.pi * 100.0), rel=0.15)


@pytest.mark.proof
@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("name", ["time_skew", "current_loop_lag"])
def test_a_world_with_a_late_current_does_not_filter_it(name: str) -> None:
    """A filter has a delay too, so that a diagnosis could not be judged."""
    ways = {draw_world("one", (name,), (8, k)).log.current for k in range(25)}
    assert ways == {"sampled", "averaged"}


@pytest.mark.parametrize("way", ["sampled", "filtered"])
def test_a_lateness_of_the_logger_s_filter_is_no_wrong_name(way: Any) -> None:
    world = draw_world("nothing", (), (3, 1))
    truth = truth_of_world(replace(world, log=replace(world.log, current=way)), (), {})
    assert truth["not_scored"] == (["time_skew", "current_loop_lag"] if way == "filtered" else [])


def test_effects_of_sensing_change_their_channel_alone() -> None:
    plain = logged(world_with({}, current="sampled"))

    def change(name: str, k: int = 0, **given: float) -> dict[str, np.ndarray]:
        other = logged(world_with({name: given}, current="sampled"), k)
        return {c: other[c] for c in other if not np.allclose(other[c], plain[c], atol=1e-5)}

    late = change("time_skew", time_s=0.01)
    assert late.keys() == {"current"}
    assert lag_s(late["current"], plain["current"]) == pytest.approx(0.01, rel=0.05)
    early = change("time_skew", time_s=-0.01)
    assert early.keys() == {"motor_angle", "angle"}
    assert lag_s(early["angle"], plain["angle"]) == pytest.approx(0.01, rel=0.05)
    delayed = change("transport_delay", time_s=0.004)
    assert delayed.keys() == {"angle"}
    offset = change("current_offset", current_A=0.3)
    assert np.allclose(offset["current"] - plain["current"], 0.3, atol=1e-6)
    drift = change("current_drift", rate_A_s=0.5)["current"] - plain["current"]
    assert np.polyfit(plain["time"], drift, 1)[0] == pytest.approx(0.5, rel=1e-3)
    slip = {"angle_rad": 0.02, "at_s": 0.5, "recording": 1.0}
    step = change("encoder_slip", **slip)["angle"] - plain["angle"]
    assert (abs(step[0]) < 1e-5, step[-1]) == (True, pytest.approx(0.02, abs=1e-5))
    assert np.allclose(change("encoder_slip", 1, **slip)["angle"] - plain["angle"], 0.02, atol=1e-5)
    seat = change("encoder_eccentricity", amplitude_rad=0.01, phase_rad=0.5)["angle"]
    expected = 0.01 * np.sin(plain["angle"] + 0.5)
    assert np.allclose(seat - plain["angle"], expected, atol=1e-5)


@pytest.mark.usefixtures("short")
def test_sealed_worlds_are_campaigns_that_tell_nothing(tmp_path: Path) -> None:
    rigs = seal_worlds(tmp_path, Follower(), 8, 21, Processes(1), lambda what, share: None)
    assert [rig.name for rig in rigs] == [f"rig-{n:04d}" for n in range(1, 9)]
    kinds = []
    for rig in rigs:
        truth = load_truth(rig.truth)
        kinds.append(truth.kind)
        assert rig.reference.is_file() is bool(truth.effects)
        text = rig.campaign.read_text()
        assert not [name for name in truth.effects if name in text]
        dataset = load_source(rig.campaign)
        assert len(dataset.recordings) == truth.axes["recordings"]
        channels = dataset.recordings[0].channels
        encoders = {word for word in ("motor", "joint") if word in truth.axes["encoders"]}
        recorded = {"motor": "motor_angle", "joint": "angle"}
        assert {recorded[word] for word in encoders} == {"motor_angle", "angle"} & set(channels)
        assert all(channels[recorded[word]].size > 50 for word in encoders)
    assert kinds.count("nothing") == 2
    before = [rig.truth.stat().st_mtime_ns for rig in rigs]
    seal_worlds(tmp_path, Follower(), 8, 21, Processes(1), lambda what, share: None)
    assert [rig.truth.stat().st_mtime_ns for rig in rigs] == before, "what is there is kept"


@pytest.mark.usefixtures("short")
def test_the_reference_has_the_noise_of_the_rig() -> None:
    world = draw_world("one", ("current_offset",), (8, 4))
    a, b = log_of(Follower(), world), log_of(Follower(), without_effects(world))
    offset = world.effects["current_offset"]["current_A"]
    for one, other in zip(a, b, strict=True):
        rounded = world.sensing.current_quantum_A
        assert np.allclose(one["current"] - other["current"], offset, atol=1.01 * rounded)
        assert np.array_equal(one["time"], other["time"])


def test_a_mass_that_is_lifted_is_a_load_of_the_campaign(tmp_path: Path) -> None:
    for load in ("carriage", "hoisted", "force"):
        world = carriage(load)
        logged = [
            columns(world, k, signals, np.random.default_rng(k))
            for k, signals in enumerate(Follower().play(world))
        ]
        dataset = load_source(write_world(tmp_path / load, world, logged))
        for planned, read in zip(world.recordings, dataset.recordings, strict=True):
            assert read.bench.motion == "linear"
            assert read.bench.gear_ratio == world.motor.gear_ratio
            assert read.steady_torque == pytest.approx(planned.steady_N_m(world.gravity_m_s2))
            assert read.known_inertia == planned.hoisted_kg
            assert read.contact_force == pytest.approx(
                planned.weight_kg * world.lever_ratio * world.gravity_m_s2
            )


PLANT = OwnPlant()
CHANNELS = ("current", "voltage", "motor_angle", "angle")


@pytest.mark.proof
@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("name", sorted({*PLANT.effects, *PLANT.outside}))
def test_every_effect_leaves_a_trace(name: str) -> None:
    """Sizes begin near the noise: of three machines one at least shows the effect."""
    found = []
    for seed in range(3):
        world = draw_world("outside" if name in PLANT.outside else "one", (name,), (3, seed))
        logged, plain = log_of(PLANT, world), log_of(PLANT, without_effects(world))
        for channels in (*logged, *plain):
            assert all(np.isfinite(values).all() for values in channels.values())
        strength = strength_of(world, logged, plain)
        # A set's order would differ by process, and with it the bytes of the truth.
        assert list(strength) == [channel for channel in CHANNELS if channel in logged[0]]
        found.append(max(strength.values()))
    assert max(found) > 2.0


PROOF = pytest.mark.proof


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize(
    "plant", [OWN, pytest.param(THIRD, marks=PROOF), pytest.param(MUJOCO, marks=PROOF)]
)
def test_the_program_seals_worlds_goes_on_and_they_are_judged(plant: str, tmp_path: Path) -> None:
    if plant == MUJOCO:
        pytest.importorskip("mujoco")
    home, out = tmp_path / "sealed", tmp_path / "proof"
    asked = [str(home), "--plant", plant, "--rigs", "2", "--seed", "6"]
    made = CliRunner().invoke(main, asked)
    assert made.exit_code == 0
    rigs, machine = sealed_rigs(home), plant_named(plant)
    assert [rig.name for rig in rigs] == ["rig-0001", "rig-0002"]
    for rig in rigs:
        assert rig.digest in made.stdout
        truth = load_truth(rig.truth)
        assert truth.effects.keys() <= {*machine.effects, *machine.outside}
        assert load_source(rig.campaign).recordings[0].bench.motion == truth.axes["machine"]
    rigs[1].truth.unlink()
    kept = rigs[0].truth.stat().st_mtime_ns
    assert CliRunner().invoke(main, asked).exit_code == 0
    assert rigs[1].truth.is_file()
    assert rigs[0].truth.stat().st_mtime_ns == kept
    judging = ["prove", "--from", str(home), "--out", str(out)]
    assert status(judging) == 0
    first = (out / SUMS_FILE).read_text()
    rows = json.loads((out / "prove.json").read_text())["rigs"]
    assert [row["axes"]["machine"] for row in rows] == [
        load_truth(r.truth).axes["machine"] for r in rigs
    ]
    assert status(judging) == 0
    assert (out / SUMS_FILE).read_text() == first
