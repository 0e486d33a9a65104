"""Off is proved by state, current and motion, on every transport and wherever off is said."""

import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import NS, SimulatedClock
from drivers.errors import LinkError, StateError
from drivers.interfaces import Measuring, ServoReadings, ServoState
from drivers.mock.plant.machine import Reading, SimulatedMachine
from rig.cli.aftermath import status_of
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.planning.plan import bench_limits
from rig.runs.run_file import read_record
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import connect
from rig.wiring.off import DECAY_WINDOWS, PATIENCE_S, WINDOW_S, OffProof, Steps
from rig.wiring.teardown import SafeState, make_safe

from .benches import stages, swing, variant

RATED_A = 10.0
STEP_RAD = 1e-4


class Drive:
    """A drive that reports off; current and joint angle are functions of the time since then, s."""

    prepared = False

    def __init__(
        self,
        current: Callable[[float], float] = lambda t: 0.0,
        angle: Callable[[float], float] = lambda t: 0.0,
        read_s: float = 0.001,
        current_step_A: float = 0.01,
    ) -> None:
        self.clock = SimulatedClock()
        self.current, self.angle, self.read_s = current, angle, read_s
        self.power = ServoState.SWITCH_ON_DISABLED
        self.gear, self.step = 100.0, current_step_A
        self.disabled = 0

    @property
    def now(self) -> float:
        return self.clock.now_ns() / NS

    def state(self) -> ServoState:
        return self.power

    def disable(self) -> None:
        self.disabled += 1

    def glance(self) -> ServoReadings:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(self.read_s * NS))
        return ServoReadings(self.angle(self.now) * self.gear, current_A=self.current(self.now))

    def measuring(self) -> Measuring:
        return Measuring(STEP_RAD, self.gear, self.step, RATED_A)


class Encoder:
    """A joint encoder that shows an angle as a function of time, s."""

    def __init__(self, drive: Drive, angle: Callable[[float], float]) -> None:
        self.drive, self.angle = drive, angle

    def reading(self) -> float:
        return self.angle(self.drive.now)

    def step_rad(self) -> float:
        return STEP_RAD


def proof_of(drive: Any, encoder: Any = None) -> OffProof:
    return OffProof(drive, drive.clock, encoder, speed_limit_rad_s=2.0)


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(n, marks=pytest.mark.proof) for n in range(8, 200))]
)
def test_a_sound_drive_is_proved_off_at_once_and_again(seed: int) -> None:
    """With the offset, noise and dither of real sensors, at any speed of the requests."""
    rng = random.Random(seed)
    offset, noise = rng.uniform(-0.01, 0.01) * RATED_A, rng.uniform(0, 0.005) * RATED_A
    drift = rng.uniform(-0.002, 0.002) * RATED_A

    def current(t: float) -> float:
        return rng.gauss(offset + drift * min(t, 1.0), noise)

    drive = Drive(
        current, lambda t: STEP_RAD * rng.randint(-1, 1), read_s=rng.choice((0.0005, 0.002, 0.04))
    )
    off = proof_of(drive, Encoder(drive, lambda t: STEP_RAD * rng.randint(-1, 1)))
    for _ in range(5):
        proof = off.prove()
        assert proof.off, proof.doubt
        drive.clock.sleep_until_ns(drive.clock.now_ns() + NS)
    assert off.zero_A == pytest.approx(offset, abs=0.01 * RATED_A)


@pytest.mark.parametrize("current", [3.98, -2.46])
def test_current_is_told_with_its_sign_and_limit(current: float) -> None:
    drive = Drive(lambda t: current)
    off = proof_of(drive)
    proof = off.prove()
    assert not proof.off
    assert proof.state is ServoState.SWITCH_ON_DISABLED
    assert proof.current_A == pytest.approx(current)
    assert f"{abs(current):.2f} A flow (limit {off.current_limit_A:.2f} A)" in proof.doubt
    assert drive.now < 0.1 * DECAY_WINDOWS


def test_a_learned_zero_narrows_the_limit() -> None:
    drive = Drive()
    off = proof_of(drive)
    assert off.prove().off
    drive.current = lambda t: 0.15  # within the limit of an unknown zero
    assert proof_of(drive).prove().off
    assert not off.prove().off


def test_a_decaying_current_is_waited_for() -> None:
    drive = Drive(lambda t: 5.0 * math.exp(-t / 0.005))
    assert proof_of(drive).prove().off
    assert drive.now < 0.2


@pytest.mark.parametrize("frequency_Hz", [0.5, 2.0])
@pytest.mark.parametrize("phase", [n / 4 for n in range(8)])
def test_a_joint_that_swings_does_not_rest_at_its_turning_points(phase, frequency_Hz):
    drive = Drive(
        angle=lambda t: math.radians(5.0) * math.sin(math.pi * (2.0 * frequency_Hz * t + phase))
    )
    off = proof_of(drive)
    for patience_s in (PATIENCE_S, 0.0, 0.0, 0.0):
        proof = off.prove(patience_s=patience_s)
        assert not proof.off
        assert "the joint moves" in proof.doubt
    drive.angle = lambda t: 0.0
    assert off.prove().off


@pytest.mark.parametrize(("counts", "windows"), [(0, 1), (2, 1), (3, 2)])
def test_only_a_joint_that_leaves_its_resolution_is_observed_for_longer(counts, windows):
    def angle(t: float) -> float:
        return counts * STEP_RAD * float(t > 0.02)

    drive = Drive(lambda t: math.nan, current_step_A=math.nan, read_s=0.0)
    off = proof_of(drive, Encoder(drive, angle))
    assert off.prove().off
    assert windows * WINDOW_S <= drive.now < windows * WINDOW_S + 0.011


def test_a_coasting_joint_is_waited_for_with_the_current_that_it_generates() -> None:
    speed = 2.0

    def angle(t: float) -> float:
        t = min(t, 1.0)
        return speed * t * (1.0 - 0.5 * t)

    drive = Drive(lambda t: 2.0 * max(0.0, 1.0 - t), angle)
    proof = proof_of(drive, Encoder(drive, angle)).prove()
    assert proof.off
    assert proof.motion_rad_s == pytest.approx(0.0, abs=0.01)
    assert 0.9 < drive.now < 1.3


@pytest.mark.parametrize("by", ["motor", "joint"])
def test_a_joint_that_goes_on_moving_is_not_off(by: str) -> None:
    moving, still = (lambda t: 0.05 * t), (lambda t: 0.0)
    drive = Drive(angle=moving if by == "motor" else still)
    proof = proof_of(drive, Encoder(drive, moving if by == "joint" else still)).prove()
    assert not proof.off
    assert proof.motion_rad_s == pytest.approx(0.05, rel=0.2)
    assert PATIENCE_S <= drive.now < PATIENCE_S + 0.1


def test_current_that_flowed_at_rest_is_not_forgotten() -> None:
    drive = Drive(lambda t: 3.0)
    off = proof_of(drive)
    assert not off.prove().off
    drive.current = lambda t: 0.0
    proof = off.prove()
    assert not proof.off
    assert "3.00 A" in proof.doubt


def test_what_a_drive_does_not_report_proves_nothing_and_a_lost_value_disproves() -> None:
    proof = proof_of(Drive(lambda t: math.nan, current_step_A=math.nan)).prove()
    assert (proof.off, proof.current_A) == (True, None)
    assert "current not reported" in SafeState(True, "x", motion_rad_s=0.0).message
    assert not proof_of(Drive(lambda t: math.nan)).prove().off
    proof = proof_of(Drive(angle=lambda t: math.nan)).prove()
    assert (proof.off, proof.motion_rad_s) == (False, None)


def test_a_lost_encoder_leaves_the_motor() -> None:
    drive = Drive()

    def lost(t: float) -> float:
        raise LinkError("gone")

    steps = Steps()
    assert proof_of(drive, Encoder(drive, lost)).prove(steps).off
    assert steps.problems == ["gone"]


def test_an_energised_state_is_not_waited_for() -> None:
    drive = Drive()
    drive.power = ServoState.OPERATION_ENABLED
    proof = proof_of(drive).prove()
    assert (proof.off, proof.state) == (False, ServoState.OPERATION_ENABLED)
    assert drive.now < 0.1
    with pytest.raises(StateError, match=r"^here: the drive is in 'operation enabled'"):
        proof_of(drive).require("here")


def test_make_safe_tries_again_and_tells_current_and_what_to_do() -> None:
    drive = Drive(lambda t: 3.98)
    found = make_safe(
        drive,  # type: ignore[arg-type]
        lambda: None,
        drive.clock,
        NS // 1000,
        brake=False,
        hurry=lambda: False,
    )
    assert (found.verified, found.state) == (False, "switch on disabled")
    assert found.current_A == pytest.approx(3.98)
    assert found.motion_rad_s == 0.0
    assert "switch the main supply off" in found.message
    assert drive.disabled == 1


# ----- the whole program, on simulated benches -----

BENCHES = ("practical", "practical_serial", "practical_dbc", "odrive_can", "mit_mini")
SEQUENCE = stages(
    swing("one", 4, 2, 0.4, more=", center_deg: 8"),
    swing("two", 4, 2, 0.4, weight_kg=10, more=", center_deg: 8"),
)


@pytest.fixture
def stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every simulated power stage stays on once it is on."""
    monkeypatch.setattr(SimulatedMachine, "stuck", True)


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch, stuck: None) -> None:
    """Every simulated power stage is on from the start, against the friction of the joint."""
    made = SimulatedMachine.__init__

    def energised(self: SimulatedMachine, *arguments: Any, **more: Any) -> None:
        made(self, *arguments, **more)
        self.power(True)
        self.track(200.0, NS // 100)

    monkeypatch.setattr(SimulatedMachine, "__init__", energised)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("two.yaml").write_text(SEQUENCE)
    return tmp_path


@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize("broken", [False, True])
def test_every_transport_shows_it(name: str, broken: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedMachine, "stuck", broken)
    document = load_bench(name)
    bench = document.value
    with connect(document, 0, realtime=False) as devices:
        off = devices.off_proof(bench_limits(bench))
        assert off.prove().off
        devices.prepare(bench.cycle_s)
        devices.servo.enable()
        start = devices.servo.sample().motor_angle_rad / bench.machine.gear_ratio
        clock, cycle_ns = devices.link.clock, bench.cycle_ns
        for number in range(60):
            clock.sleep_until_ns(clock.now_ns() + cycle_ns)
            devices.servo.set_target(start + 2e-5 * number)
            devices.link.exchange()
        devices.servo.disable()
        proof = off.prove()
    assert proof.state is ServoState.SWITCH_ON_DISABLED
    assert proof.off is not broken, proof
    assert proof.current_A is not None
    assert (abs(proof.current_A) > off.current_limit_A) is broken


COMMISSION = ("commission", "practical", "--yes", "--angle", "0", "--out", "out")


@pytest.mark.parametrize(
    ("arguments", "file", "words"),
    [
        (("check", "practical", "--json", "out.json"), "out.json", ""),
        (("jog", "practical", "--to", "5", "--json", "out.json"), "out.json", "before the jog"),
        (("run", "two.yaml", "--out", "out"), "out/run.json", "before the weight prompt"),
        (COMMISSION, "out/commission.json", "do not touch"),
    ],
)
@pytest.mark.usefixtures("here", "live")
def test_no_command_begins_with_it(arguments: tuple[str, ...], file: str, words: str) -> None:
    assert status([*arguments]) == 4
    record = json.loads(Path(file).read_text())
    assert words in record.get("message", "")
    if arguments[0] == "check":
        assert (record["good"], record["off"]["off"]) == (False, False)
        assert record["causes"] == ["a drive that is not proved off"]


@pytest.mark.parametrize("kind", ["practical", "practical_serial"])
@pytest.mark.parametrize(
    ("offset_A", "stated_A", "code"), [(0.6, 0.0, 4), (0.6, 0.6, 0), (-0.6, -0.6, 0)]
)
def test_an_offset_of_the_current_sensor_can_be_stated(
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    offset_A: float,
    stated_A: float,
    code: int,
) -> None:
    """The limit is 2 % of the rated 15 A about the stated offset."""
    latch = SimulatedMachine.latch

    def biased(self: SimulatedMachine) -> Reading:
        found = latch(self)
        return found._replace(current_A=found.current_A + offset_A)

    monkeypatch.setattr(SimulatedMachine, "latch", biased)
    stated = ("servo: {node: 1", f"servo: {{current_offset_A: {stated_A}, node: 1")
    variant(here, stated, source=kind)
    assert status(["check", "bench.yaml", "--json", "check.json"]) == code
    off = json.loads(Path("check.json").read_text())["off"]
    assert off["off"] is (code == 0)
    assert off["current_A"] == pytest.approx(offset_A - stated_A, abs=0.03)


def test_the_weight_prompt_between_stages(runner: Any, fake_bench: Any) -> None:
    bench = fake_bench()
    finished = bench.hang

    def hang(mass_kg: float) -> None:
        finished(mass_kg)
        bench.faults["disable", 1] = lambda: bench.clock.call_at(
            bench.clock.now_ns() + 7 * NS // 100, lambda: setattr(bench, "leak_A", 3.0)
        )

    bench.hang = hang
    folder, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert bench.hung == [0.0]
    assert (outcome.safe.verified, status_of(outcome)) == (False, 4)
    assert outcome.safe.current_A == pytest.approx(3.0)
    assert folder.record.de_energised is False


def test_a_stopped_run_that_is_not_off_ends_with_4(runner: Any, fake_bench: Any) -> None:
    bench, stop = fake_bench(), StopButton()
    bench.faults["exchange", 300] = stop.press
    bench.faults["disable", 1] = lambda: setattr(bench, "leak_A", 3.0)
    bench.faults["quick_stop", 1] = lambda: setattr(bench, "leak_A", 3.0)
    _, outcome = runner(bench, stop=stop)
    assert (outcome.ending, outcome.safe.verified) == (Ending.STOPPED, False)
    assert status_of(outcome) == 4


@pytest.mark.parametrize("options", [(), ("--home", "37")])
def test_a_commissioning_ends_with_4(here: Path, stuck: None, options: tuple[str, ...]) -> None:
    assert status([*COMMISSION, *options]) == 4
    record = json.loads(Path("out/commission.json").read_text())
    assert record["drive"]["verified"] is False


@pytest.mark.parametrize("bench", BENCHES[:3])
@pytest.mark.usefixtures("here", "stuck")
def test_a_jog_ends_with_4(bench: str) -> None:
    assert status(["jog", bench, "--to", "5", "--json", "jog.json"]) == 4
    record = json.loads(Path("jog.json").read_text())
    assert (record["state"], record["de_energised"]) == ("failed", False)
    current_A = record["drive"]["current_A"]
    assert abs(current_A) > 1.0
    assert f"{abs(current_A):.2f} A flow" in record["message"]
    assert "could NOT be verified" in record["message"]


def test_a_resumed_run_does_not_begin(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("faults.yaml").write_text(
        "faults: 1\nrows: [{phase: prompt, stage: two, target: operator, fault: stop}]\n"
    )
    assert status(["run", "two.yaml", "--yes", "--out", "out", "--faults", "faults.yaml"]) == 3
    monkeypatch.setattr(SimulatedMachine, "stuck", True)
    assert status(["resume", "out", "--yes"]) == 4
    record = read_record(Path("out"))
    assert record.de_energised is False
    assert "could NOT be verified" in record.message
