"""A bench of fakes: the driver interfaces in simulated time, with an ideal joint and faults on
demand.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import Clock, SimulatedClock
from drivers.errors import StateError
from drivers.interfaces import (
    Encoder,
    EncoderSample,
    Identity,
    Link,
    Measuring,
    RawFrame,
    Servo,
    ServoLimits,
    ServoReadings,
    ServoSample,
    ServoState,
)
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Sequence
from rig.control.operator import AutomaticOperator
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.planning.plan import Plan, make_plan
from rig.runs.run import RunFolder
from rig.terminal.stop_button import StopButton
from rig.wiring.devices import Devices

GEAR = 100.0
STATUSWORDS = {
    ServoState.SWITCH_ON_DISABLED: 0x0250,
    ServoState.OPERATION_ENABLED: 0x0637,
    ServoState.QUICK_STOP_ACTIVE: 0x0617,
    ServoState.FAULT: 0x0218,
}


@dataclass
class FakeBench(Link, Servo, Encoder):
    """Link, servo and encoder in one; the joint goes where it is told at once.

    Attributes:
        faults: (verb, n) to an action called when that verb is called for the n-th time, from 1.
        overrides: Replaces fields of the servo sample.
        leak_A: Current that flows while the drive reports off.
    """

    clock: SimulatedClock = field(default_factory=SimulatedClock)
    faults: dict[tuple[str, int], Callable[[], None]] = field(default_factory=dict)
    overrides: dict[str, Any] = field(default_factory=dict)
    leak_A: float = 0.0
    angle_error: float = 0.0
    drive_state: ServoState = ServoState.SWITCH_ON_DISABLED
    calls: Counter[str] = field(default_factory=Counter)
    order: list[str] = field(default_factory=list)
    hung: list[float] = field(default_factory=list)
    targets: list[float] = field(default_factory=list)
    joint: float = 0.1
    target: float = 0.1
    speed: float = 0.0
    exchanged_ns: int = 0
    fresh: bool = True
    limits: ServoLimits | None = None
    pacer: Clock | None = None

    def _call(self, verb: str) -> None:
        self.calls[verb] += 1
        if verb not in ("exchange", "set_target"):
            self.order.append(verb)
        fault = self.faults.get((verb, self.calls[verb]))
        if fault is not None:
            fault()

    def open(self) -> None:
        self._call("open")

    def close(self) -> None:
        self._call("close")

    def exchange(self) -> None:
        now_ns, before = self.clock.now_ns(), self.joint
        self.clock.sleep_until_ns(now_ns + 400_000)
        self._call("exchange")
        if self.drive_state is ServoState.OPERATION_ENABLED:
            self.joint = self.target
            self.speed = (self.joint - before) * 1e9 / max(now_ns - self.exchanged_ns, 1_000_000)
            self.exchanged_ns = now_ns
        elif self.drive_state is ServoState.QUICK_STOP_ACTIVE and self.calls["exchange"] % 50 == 0:
            self.drive_state = ServoState.SWITCH_ON_DISABLED

    def take_frames(self) -> list[RawFrame]:
        return [
            RawFrame(self.clock.now_ns(), 0x80, b"", True),
            RawFrame(self.clock.now_ns(), 0x181, b"12345678", False),
        ]

    def identity(self) -> Identity:
        return Identity("fake", 1, 2, 3, 4)

    def state(self) -> ServoState:
        self._call("state")
        return self.drive_state

    def read_limits(self) -> ServoLimits:
        return self.limits or ServoLimits(-1.0, 1.0, 3.0, 80.0, 30.0, None, 2, 10.0)

    def write_limits(self, limits: ServoLimits) -> None:
        self._call("write_limits")
        self.limits = limits

    def prepare(self, cycle_s: float) -> None:
        self._call("prepare")

    def enable(self) -> None:
        self._call("enable")
        self.target = self.joint
        self.drive_state = ServoState.OPERATION_ENABLED

    def disable(self) -> None:
        self._call("disable")
        if self.drive_state is ServoState.OPERATION_ENABLED and self.overrides.get("stuck"):
            raise StateError("the drive still reports operation enabled")
        self.drive_state = ServoState.SWITCH_ON_DISABLED

    def sent_state(self) -> ServoState | None:
        return None

    def quick_stop(self, *, at_once: bool = True) -> None:
        self._call("quick_stop")
        if self.drive_state is ServoState.OPERATION_ENABLED:
            self.drive_state = ServoState.QUICK_STOP_ACTIVE

    def reset_fault(self) -> None:
        self._call("reset_fault")

    def set_target(self, angle_rad: float) -> None:
        self._call("set_target")
        self.target = angle_rad
        self.targets.append(angle_rad)

    def sample(self) -> Any:
        values = {
            "device_time_s": self.clock.now_ns() * 1e-9,
            "motor_angle_rad": self.joint * GEAR,
            "velocity_rad_s": self.speed,
            "current_A": 1.5,
            "voltage_V": 3.0,
            "supply_voltage_V": 60.0,
            "temperature_C": 25.0,
            "following_error_rad": 0.0,
            "statusword": STATUSWORDS[self.drive_state],
            "fresh": self.fresh,
        }
        values.update((k, v) for k, v in self.overrides.items() if k in values)
        return ServoSample(**values)

    def glance(self) -> ServoReadings:
        self.clock.sleep_until_ns(self.clock.now_ns() + 1_000_000)
        return ServoReadings(self.joint * GEAR, current_A=self.leak_A)

    def measuring(self) -> Measuring:
        return Measuring(1e-5, GEAR, 0.015, 15.0)

    def hang(self, mass_kg: float) -> None:
        assert not self.drive_state.energised
        self.order.append("hang")
        self.hung.append(mass_kg)

    def devices(self) -> Devices:
        return Devices(self, self, FakeEncoder(self), self.hang, self.pacer)


@dataclass
class FakeEncoder(Encoder):
    """The joint encoder of a :class:`FakeBench`."""

    bench: FakeBench

    def identity(self) -> Identity:
        return Identity("fake encoder", 1, 2, 3, 5)

    def prepare(self, cycle_s: float) -> None:
        self.bench._call("encoder.prepare")

    def reading(self) -> float:
        return self.bench.joint + self.bench.angle_error

    def sample(self) -> EncoderSample:
        bench = self.bench
        return EncoderSample(
            bench.clock.now_ns() * 1e-9, bench.joint + bench.angle_error, bench.fresh
        )


SHORT = """\
sequence: 1
name: short
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05, repeats: 2}
  - {name: heavy, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 5, frequency_Hz: 2,
     phase_deg: 90}],
     duration_s: 0.5, ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
"""


@dataclass
class Runner:
    """Runs the short sequence on a fake bench, as the command line would."""

    folder: Path
    inputs: Inputs
    plan: Plan

    def __call__(
        self, bench: FakeBench, operator: Any = None, stop: StopButton | None = None
    ) -> tuple[RunFolder, Outcome]:
        self.folder.mkdir(exist_ok=True)
        return execute(
            self.inputs,
            self.plan,
            bench.devices(),
            self.folder,
            operator or AutomaticOperator(),
            stop or StopButton(),
            lambda stage, cycles, sample: None,
        )


IDENTIFIED: dict[str, Any] = {
    "schema": "loadrig.identify/1",
    "method": "default",
    "parameters": {"Mc": {"value": 6.8, "low": 6.7, "high": 6.9, "unit": "N m"}},
    "fit": {"unit": "N m", "train_rms": 0.02},
}
"""Content of an ``identify.json``."""


def runner_of(sequence_file: Path, operator: str = "") -> Runner:
    """Return the runner of a sequence, whose run is beside the sequence's file."""
    bench, sequence = load_bench("practical"), load_located(sequence_file, Sequence)
    inputs = Inputs(bench, sequence, 0, False, operator)
    return Runner(sequence_file.with_name("run"), inputs, make_plan(sequence, bench))


def run_in(folder: Path, extra: str = "", operator: str = "Ada") -> RunFolder:
    """Return a run of the short sequence with ``extra`` lines, in a folder of its own."""
    path = folder / "short.yaml"
    path.write_text(SHORT + extra)
    return runner_of(path, operator)(FakeBench())[0]


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render no figure, which takes half of an identification, in tests that look at none."""
    monkeypatch.setattr("identification.plots.style.png", lambda made, dpi=110: b"\x89PNG")


@pytest.fixture
def unpaged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write no page of a run, which takes a sixth of a short one, in tests that look at none."""
    monkeypatch.setattr("rig.cli.aftermath.write_run_report", lambda folder, record: folder)


@pytest.fixture
def fake_bench() -> type[FakeBench]:
    return FakeBench


@pytest.fixture
def short_sequence(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of the short sequence by the command line, which is not to be changed."""
    folder = tmp_path_factory.mktemp("finished")
    (folder / "short.yaml").write_text(SHORT)
    assert status(["run", str(folder / "short.yaml"), "--yes", "--out", str(folder / "run")]) == 0
    return folder / "run"


@pytest.fixture
def runner(short_sequence: Path) -> Runner:
    return runner_of(short_sequence)
