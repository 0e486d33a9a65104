"""Plant, drive loops and gas generator together, compiled and without the bus: times real time, and
the step's error.

The valve swings from closed to open and back at 0.2 Hz for 20 s under the pressure that it makes.
The error is what halving the steps changes: those of eq. 1 (``steps_per_loop``) and those in which
pressure and contact force are renewed (``loops_per_step``), with exact sensors and without noise,
so that nothing else differs.

    python benchmarks/hotfire_speed.py
"""

from __future__ import annotations

from dataclasses import replace
from statistics import median
from time import process_time

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.gas_direct import burn
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import GasGenerator, Machine, Sensing
from drivers.mock.without_bus import record
from rig.common.tables import table

Array = NDArray[np.float64]

DURATION_S = 20.0
REPEATS = 7
WANTED = 100.0
"""Times real time, at least."""
EXACT = Sensing(motor_counts_per_turn=0, joint_counts_per_turn=0, current_noise_A=0.0)


def command(rate_Hz: float) -> Array:
    """Return the joint angle asked for, rad."""
    t = np.arange(round(DURATION_S * rate_Hz)) / rate_Hz
    return np.asarray(np.deg2rad(15.0 * (1.0 - np.cos(0.4 * np.pi * t))))


def firing(machine: Machine) -> SimulatedMachine:
    """Return a machine under power with its gas generator lit."""
    rig = SimulatedMachine(machine, np.random.default_rng(0))
    rig.ignite()
    rig.power(True)
    return rig


def followed(machine: Machine) -> None:
    """Run the plant with its loops, one target a loop."""
    firing(machine).follow(command(machine.loops.rate_Hz))


def recorded(machine: Machine) -> None:
    """Record it with the samples of the bus."""
    record(firing(machine), command(1e3), pressure_rng=np.random.default_rng(1))


def weighed(machine: Machine) -> None:
    """Run the same motion under a weight, for comparison."""
    rig = SimulatedMachine(machine, np.random.default_rng(0))
    rig.hang(30.6)
    rig.power(True)
    rig.follow(command(machine.loops.rate_Hz))


def trace(machine: Machine) -> Array:
    """Return angle, current, pressure and contact force every 10 ms, shape (4, n)."""
    rig, path = firing(machine), command(machine.loops.rate_Hz)
    span = round(0.01 * machine.loops.rate_Hz)
    rows = []
    for at in range(0, len(path), span):
        rig.follow(path[at : at + span])
        truth = rig.truth()
        rows.append((truth.angle_rad, truth.current_A, truth.pressure_Pa, truth.contact_force_N))
    return np.array(rows).T


def stepped(steps_per_loop: int, loops_per_step: int) -> Machine:
    """Return the exact machine with these steps."""
    gas = GasGenerator(loops_per_step=loops_per_step)
    return replace(Machine(), sensing=EXACT, gas=gas, steps_per_loop=steps_per_loop)


def speeds() -> list[float]:
    """Print times real time by processor time, medians over alternating repeats; return those of
    hot firings.
    """
    machine = Machine()
    hiding = replace(machine, effects={"asymmetric_coulomb": {"torque_Nm": 0.5}})
    hot = {
        "hot firing": lambda: followed(machine),
        "the same, pressure renewed every loop": lambda: followed(
            replace(machine, gas=GasGenerator(loops_per_step=1))
        ),
        "recording without the bus": lambda: recorded(machine),
        "the same, hiding asymmetric friction": lambda: recorded(hiding),
    }
    jobs = {"30.6 kg instead": lambda: weighed(machine), **hot}
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()  # compiles
    for _ in range(REPEATS):
        for name, job in jobs.items():
            began = process_time()
            job()
            seconds[name].append(process_time() - began)
    times = {name: DURATION_S / median(s) for name, s in seconds.items()}
    print(
        table(
            ["plant, drive loops and", "times real time"],
            [[name, f"{x:.0f}"] for name, x in times.items()],
        )
    )
    return [times[name] for name in hot]


def errors() -> None:
    """Print what every step changes against steps of a quarter."""
    finest = trace(stepped(8, 1))
    rows = []
    for steps_per_loop, loops_per_step in ((2, 4), (2, 2), (2, 1), (4, 2), (4, 1)):
        off = trace(stepped(steps_per_loop, loops_per_step)) - finest
        rms = np.sqrt(np.mean(off**2, axis=1)) * [np.rad2deg(1.0) * 1e3, 1e3, 1.0, 1.0]
        worst = np.max(np.abs(off), axis=1) * [np.rad2deg(1.0) * 1e3, 1e3, 1.0, 1.0]
        cells = [f"{a:.2g} / {b:.2g}" for a, b in zip(rms, worst, strict=True)]
        rows.append([f"{50.0 / steps_per_loop:g}", f"{50 * loops_per_step}", *cells])
    names = ["eq. 1 step us", "gas step us", "angle mdeg", "current mA", "pressure Pa", "force N"]
    print(table(names, rows))
    print("rms / worst, against 6.25 and 50 us")
    angle = command(1e3)
    fine = burn(Machine(), angle, 1e-3, 80).pressure_Pa
    changes = [
        np.max(np.abs(burn(Machine(), angle, 1e-3, n).pressure_Pa / fine - 1.0))
        for n in (5, 10, 20)
    ]
    shown = ", ".join(
        f"{error:.1e} at {1000 / n:g} us" for n, error in zip((5, 10, 20), changes, strict=True)
    )
    print(f"gas generator alone, worst relative error of the pressure: {shown}")


def main() -> int:
    """Print both; 1 where a hot firing is slower than it should be."""
    slowest = min(speeds())
    print()
    errors()
    return 0 if slowest >= WANTED else 1


if __name__ == "__main__":
    raise SystemExit(main())
