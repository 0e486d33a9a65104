"""How often the check for a load that changed within a stage is right: simulated stages of benches
with the effects of the blind proof, on stiff and soft drives, with and without a weight taken off.

Run from the root of the repository; takes five minutes.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.without_bus import record
from identification.recording import Bench, Dataset, Recording
from rig.config.bench import load_bench
from rig.results.prove.draw import OUTSIDE_SIZES, SIZES, Kind, Rig, draw
from rig.weighing.load_change import Change, changed_loads

Array = NDArray[np.float64]
CYCLE_S = 1e-3
_EFFECTS = [name for name in (*SIZES, *OUTSIDE_SIZES) if name != "load_dependent_friction"]
"""Without the effect that exists only for a weight fixed to the joint."""


def _tones(duration_s: float, *tones: tuple[float, float]) -> Array:
    t = np.arange(round(duration_s / CYCLE_S)) * CYCLE_S
    fade = np.minimum(1.0, np.minimum(t, duration_s - t))
    degrees = np.sum([a * np.sin(2 * np.pi * f * t) for a, f in tones], axis=0)
    return np.asarray(np.deg2rad(degrees * fade), dtype=np.float64)


def _ramps() -> Array:
    t = np.arange(round(72.0 / CYCLE_S)) * CYCLE_S % 18.0
    return np.asarray(np.deg2rad(np.clip(np.minimum(t, 17.0 - t), 0.0, 8.0)), dtype=np.float64)


COMMANDS: Mapping[str, Callable[[], Array]] = {
    "figure10": lambda: _tones(20.0, (20.0, 0.2)),
    "quick_check": lambda: _tones(12.0, (8.0, 0.5)),
    "three tones": lambda: _tones(20.0, (10.0, 0.2), (3.0, 0.73), (0.8, 2.3)),
    "slow ramps": _ramps,
}


@dataclass(frozen=True)
class Trial:
    """One simulated stage, and what was found."""

    command: str
    effect: str
    soft: bool
    mass_kg: float
    left_kg: float | None
    found: Change | None


def trials(count: int, removed: bool) -> Iterator[Trial]:
    """Simulate stages."""
    rng = np.random.default_rng([7, removed])
    soft_loops = load_bench("practical_soft").value.mock.loops  # type: ignore[union-attr]
    for number in range(count):
        command = list(COMMANDS)[number % len(COMMANDS)]
        effect = _EFFECTS[number // len(COMMANDS) % len(_EFFECTS)] if number % 5 else ""
        kind: Kind = "nothing" if not effect else "one" if effect in SIZES else "outside"
        rig = draw(kind, [effect] if effect else [], [5, number, removed])
        soft = number % 7 == 3
        if soft:
            rig = rig._replace(machine=replace(rig.machine, loops=soft_loops))
        mass = float(rng.uniform(5.0, 40.0))
        left = mass * (1.0 - float(rng.uniform(0.15, 1.0))) if removed else None
        at, rest_s = float(rng.uniform(0.3, 0.7)), float(rng.choice([0.0, 60.0, 600.0]))
        recording = _simulated(rig, COMMANDS[command](), mass, left, at, rest_s)
        found = changed_loads(Dataset((recording,)), ["loaded"]).get("loaded")
        yield Trial(command, effect, soft, mass, left, None if found is None else found[0])


def _simulated(
    rig: Rig, command: Array, mass: float, left: float | None, at: float, rest_s: float
) -> Recording:
    machine = SimulatedMachine(rig.machine, np.random.default_rng(rig.seed))
    machine.power(False)
    machine.hang(mass)
    machine.rest(rest_s)
    machine.power(True)
    record(machine, np.zeros(500), CYCLE_S)
    split = round(at * len(command))
    parts = [record(machine, command[:split], CYCLE_S)]
    if left is not None:
        machine.hang(left)
    parts.append(record(machine, command[split:], CYCLE_S))
    motor = rig.machine.motor
    return Recording(
        name="loaded",
        channels={
            "time": np.arange(len(command), dtype=np.float64) * CYCLE_S,
            "angle": np.concatenate([part.angle for part in parts]),
            "current": np.concatenate([part.current for part in parts]),
            "command": command,
        },
        bench=Bench(torque_constant=motor.torque_constant_N_m_A, gear_ratio=motor.gear_ratio),
        stage="loaded",
        weight_mass=mass,
    )


def main() -> None:
    """Print how many stages were misjudged, and which."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sound", type=int, default=600)
    parser.add_argument("--removed", type=int, default=200)
    asked = parser.parse_args()
    for removed, count in ((False, asked.sound), (True, asked.removed)):
        alarms = 0
        for trial in trials(count, removed):
            alarms += trial.found is not None
            if (trial.found is not None) is not removed:
                print(trial, flush=True)
        print(f"{'removed' if removed else 'sound'}: {alarms} alarms in {count} stages")


if __name__ == "__main__":
    main()
