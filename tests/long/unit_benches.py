"""Draws simulated benches, right ones and such with a mistake in units, signs or constants."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.clock import Clock
from drivers.mock import faults
from drivers.mock.bench import SimulatedBench
from drivers.mock.plant.parts.constants import Joint
from drivers.mock.traits import CSP, MAKES
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.operator import AutomaticOperator
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.fault_injection.scene import Scene
from rig.planning.plan import make_plan
from rig.runs.run import RunFolder, create_folder
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import connect
from tests.drivers.makes import description

TENFOLD = "tenfold speed"
"""A unit of the speed ten times finer than the stated one; not part of the table of the study."""
MISTAKES = ("unit of speed", "sign", "ratio", "shaft", "torque constant")
CYCLIC = tuple(name for name, make in MAKES.items() if make.modes & CSP)
"""Makes whose drives take positions in every cycle; the benches have no other mode."""
SLOWEST_HZ = 0.25
COUNTS = (1024, 2000, 4096, 8192, 16384, 65536)
RATIOS = (0.2, 0.25, 0.5, 2 / 3, 0.8, 1.25, 1.5, 2.0, 4.0, 5.0)
"""Stated over true gear ratio: a stage forgotten, edges not counted, a neighbour in the list."""


@dataclass(frozen=True)
class Drawn:
    """A bench that was drawn.

    Attributes:
        bench: Its file, as plain data.
        sequence: The sequence to run on it, as plain data.
        make: Make of its drive, "all objects" for the simulated one.
        spoil: Builds the mistakes into the simulated devices that the file doesn't hold.
        expected: Key to be set, and its value; None for words only.
        words: What the message must hold.
    """

    bench: dict[str, Any]
    sequence: dict[str, Any]
    make: str
    spoil: Callable[[SimulatedBench], None]
    expected: tuple[str, Any] | None
    words: str


def draw(rng: np.random.Generator, mistake: str | None) -> Drawn:
    """Draw a bench with a mistake, or a right one."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    serial = bool(rng.integers(2))
    make = str(rng.choice(["all objects", *CYCLIC]))
    gear = round(between(5.0, 250.0), int(rng.integers(3)))
    constant, limit_A, supply = between(0.01, 0.3), between(2.0, 40.0), float(rng.choice([24, 48]))
    torque = constant * gear * limit_A
    coulomb = between(0.02, 0.07) * torque
    scale = torque / 75.0
    motor = {
        "torque_constant_N_m_A": constant,
        "back_emf_constant_V_s_rad": constant * float(rng.uniform(0.87, 1.0)),
        "resistance_ohm": supply / (limit_A * float(rng.uniform(1.5, 5.0))),
        "gear_ratio": gear,
    }
    motor["inductance_H"] = motor["resistance_ohm"] * between(2e-4, 2e-3)
    joint = {
        "inertia_kg_m2": Joint.inertia_kg_m2 * scale * between(0.5, 2.0),
        "Mc_N_m": coulomb,
        "Ms_N_m": coulomb * float(rng.uniform(1.05, 1.7)),
        "omega_sf_rad_s": between(0.01, 0.1),
        "sigma_2_N_m_s_rad": Joint.sigma_2_N_m_s_rad * scale * between(0.3, 1.0),
    }
    rated_A = 0.6 * limit_A
    machine = {
        **{name: value * float(rng.uniform(0.93, 1.07)) for name, value in motor.items()},
        "gear_ratio": gear,
        "moment_arm_m": 0.1,
        "lever_ratio": 1,
    }
    servo: dict[str, Any] = {
        "counts_per_motor_turn": int(rng.choice([c for c in COUNTS if c * gear > 1e5])),
        "rated_current_A": float(f"{rated_A:.3f}"),
        "rated_torque_N_m": float(f"{constant * rated_A * rng.uniform(0.9, 1.0):.4f}"),
    }
    encoder: dict[str, Any] = {"counts_per_turn": int(2 ** rng.integers(14, 21))}
    if serial:
        encoder = {"kind": "amt21", "port": "mock"}
    sensing = {"current_noise_A": 0.02 * (limit_A / 25.0) * between(0.3, 3.0)}
    spoil, expected, words = _mistake(rng, mistake, machine, servo, encoder, motor)
    free_deg_s = math.degrees(supply / motor["back_emf_constant_V_s_rad"] / machine["gear_ratio"])
    speed = min(120.0, 0.5 * free_deg_s)
    bench = {
        "bench": 1,
        "name": "drawn",
        "machine": machine,
        "bus": {"interface": "epos_serial", "port": "mock"} if serial else {"interface": "mock"},
        "servo": servo,
        "encoder": encoder,
        "cycle_Hz": 500 if serial else int(rng.choice([500, 1000])),
        "limits": {
            "angle_min_deg": -30,
            "angle_max_deg": 30,
            "speed_deg_s": speed,
            "torque_N_m": 0.45 * machine["torque_constant_N_m_A"] * machine["gear_ratio"] * limit_A,
            "current_A": 0.9 * limit_A,
            "following_error_deg": 2,
            "encoder_disagreement_deg": 1,
            "weight_kg": 5,
            "contact_force_N": 100,
            "supply_min_V": 0.8 * supply,
            "supply_max_V": 1.2 * supply,
            "sample_age_ms": 10,
        },
        "mock": {
            "motor": motor,
            "joint": joint,
            "loops": {"position_gain": float(rng.uniform(20, 70)), "current_limit_A": limit_A},
            "sensing": sensing,
            "supply_V": supply,
        },
    }
    amplitude = float(rng.uniform(8, 20))
    frequency = min(float(rng.uniform(0.2, 0.8)), 0.15 * speed / (2 * math.pi * amplitude))
    if frequency < SLOWEST_HZ:
        amplitude, frequency = amplitude * frequency / SLOWEST_HZ, SLOWEST_HZ
    tone = {"amplitude_deg": amplitude, "frequency_Hz": frequency}
    stage = {"name": "empty", "stage": "unloaded", "tones": [tone], "duration_s": 1.1 / frequency}
    stage |= {"ramp_in_s": 0.4 / frequency, "ramp_out_s": 0.4 / frequency}
    first = {"amplitude": 0.1, "duration_s": 1.1 / frequency}
    sequence = {"sequence": 1, "name": "short", "stages": [stage], "first_pass": first}
    return Drawn(bench, sequence, make, spoil, expected, words)


def _mistake(
    rng: np.random.Generator,
    mistake: str | None,
    machine: dict[str, Any],
    servo: dict[str, Any],
    encoder: dict[str, Any],
    motor: dict[str, float],
) -> tuple[Callable[[SimulatedBench], None], tuple[str, Any] | None, str]:
    """Build a mistake into the sections of a bench file, or return what builds it into the
    simulated devices.
    """
    right: Callable[[SimulatedBench], None] = lambda _: None  # noqa: E731
    counts = servo["counts_per_motor_turn"]
    which = int(rng.integers(3))
    if mistake == "unit of speed":
        servo["velocity_unit"] = "counts_per_s" if which else "rpm"
        unit = counts / 60 if which else 1.0
        spoil = lambda mock: mock.drive.use_speed_unit(unit)  # noqa: E731
        if which:
            return spoil, ("servo.velocity_unit", "rpm"), "the unit of 606Ch is rpm"
        return (
            spoil,
            ("servo.velocity_unit", "counts_per_s"),
            "the unit of 606Ch is counts per second",
        )
    if mistake == TENFOLD:
        servo["velocity_unit"] = "counts_per_s" if which else "rpm"
        unit = 0.1 if which else counts / 600
        spoil = lambda mock: mock.drive.use_speed_unit(unit)  # noqa: E731
        told = ("servo.velocity_unit_rad_s", unit * 2.0 * math.pi / counts)
        return spoil, told, "unit of 606Ch is probably 0.1 "
    if mistake == "sign":
        if which == 0:
            spoil = lambda mock: setattr(mock.drive, "current_sign", -1)  # noqa: E731
            return spoil, ("servo.current_sign", -1), "the sign of the current is wrong"
        (servo if which == 1 else encoder)["sign"] = -1
        return right, ("encoder.sign", -encoder.get("sign", 1)), "the joint encoder travels -"
    if mistake == "ratio":
        machine["gear_ratio"] *= float(rng.choice(RATIOS))
        return right, ("machine.gear_ratio", motor["gear_ratio"]), "the joint encoder travels"
    if mistake == "shaft":
        return _on_motor_shaft, None, "both are on the same side of the gear"
    if mistake == "torque constant":
        machine["torque_constant_N_m_A"] = motor["torque_constant_N_m_A"] * (2.0 if which else 0.5)
        true = motor["torque_constant_N_m_A"]
        return right, ("machine.torque_constant_N_m_A", true), "the motor gives"
    return right, None, ""


def _on_motor_shaft(mock: SimulatedBench) -> None:
    faults.on_motor_shaft(Scene(mock).sensor, mock.machine)


def judged(drawn: Drawn, outcome: Outcome, folder: RunFolder) -> str:
    """Return what is wrong with the outcome of a run; empty where it is as it must be."""
    message = outcome.message
    if not outcome.safe.verified:
        return f"not de-energised: {message}"
    if not drawn.words:
        return "" if outcome.ending is Ending.DONE else message
    if outcome.ending is Ending.DONE or folder.record.segments:
        return f"not found before full amplitude: {message}"
    if drawn.words not in message:
        return f"found, but not as such: {message}"
    if drawn.expected is None:
        return ""
    key, value = drawn.expected
    told = re.search(rf"set (?:[\w.]+: [^ ]+ and )?{re.escape(key)}: ([^\s,;]+)", message)
    if told is None:
        return f"no key told: {message}"
    if isinstance(value, str):
        return "" if told[1] == value else f"{told[1]} told: {message}"
    return "" if abs(float(told[1]) / value - 1.0) < 0.15 else f"{told[1]} for {value}: {message}"


def run(drawn: Drawn, seed: int, folder: Path) -> tuple[RunFolder, Outcome]:
    """Run the sequence of a drawn bench, with its first pass."""
    folder.mkdir(parents=True)
    bench = drawn.bench
    if drawn.make != "all objects":
        (folder / "drive.eds").write_text(description(drawn.make))
        bench = {**bench, "servo": {**bench["servo"], "eds": "drive.eds", "stops_alone": True}}
    (folder / "bench.yaml").write_text(yaml.safe_dump(bench))
    (folder / "sequence.yaml").write_text(yaml.safe_dump(drawn.sequence))
    document, sequence = load_bench(folder / "bench.yaml"), load_sequence(folder / "sequence.yaml")
    plan = make_plan(sequence, document, first_pass=True)

    mocks: list[Any] = []

    def attach(mock: Any) -> Clock:
        mocks.append(mock)
        clock: Clock = mock.clock
        return clock

    with (
        create_folder(folder / "run", "study"),
        connect(document, seed, realtime=False, attach=attach) as devices,
    ):
        drawn.spoil(mocks[0])
        return execute(
            Inputs(document, sequence, seed, realtime=False),
            plan,
            devices,
            folder / "run",
            _Silent(),
            StopButton(),
            lambda *_: None,
        )


class _Silent(AutomaticOperator):
    def tell(self, words: str, typed: str = "") -> None:
        """Say nothing."""

    def result(self, words: str, good: bool) -> None:
        """Say nothing."""
