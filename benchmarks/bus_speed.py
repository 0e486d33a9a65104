"""Cycles per second of the mock bench, whole exchange over the simulated bus, against the plant
alone and real time; and the same with a machine in Python in place of the own plant.

python benchmarks/bus_speed.py
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
import yaml

from drivers.clock import NS
from drivers.mock.plant.hosted import HostedMachine, python_plant
from drivers.mock.plant.machine import DrivenMachine, SimulatedMachine
from rig.common.tables import table
from rig.config.bench import Bench, bench_from_text, load_bench
from rig.config.configuration import Document, resolve
from rig.wiring.connect import connect

NOMINAL = Path(__file__).parents[1] / "tests" / "drivers" / "machines" / "nominal.py"
CYCLES = 10_000
REPEATS = 5
COUNTS_PER_RAD = 4096 * 100 / (2.0 * np.pi)


def targets(cycle_s: float) -> np.ndarray:
    """Return one joint angle a cycle, rad."""
    time = np.arange(1, CYCLES + 1) * cycle_s
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))


def exchange(document: Document[Bench], cycle_s: float) -> float:
    """Return the seconds that the cycles take with drive, encoder and every frame between them and
    the host.
    """
    with connect(document, seed=0, realtime=False) as devices:
        link, servo, encoder = devices.link, devices.servo, devices.encoder
        servo.prepare(cycle_s)
        encoder.prepare(cycle_s)
        servo.enable()
        path = targets(cycle_s).tolist()
        due = link.clock.now_ns()
        began = perf_counter()
        for target in path:
            due += round(cycle_s * NS)
            link.clock.sleep_until_ns(due)
            servo.set_target(target)
            link.exchange()
            servo.sample()
            encoder.sample()
            link.take_frames()
        spent = perf_counter() - began
        servo.disable()
    return spent


def plant_alone(document: Document[Bench], cycle_s: float) -> float:
    """Return the seconds that the machine alone takes, tracked and latched every cycle."""
    assert document.value.mock is not None
    rng = np.random.default_rng(0)
    machine: DrivenMachine = SimulatedMachine(document.value.mock, rng)
    if name := document.value.mock.plant.get("class"):
        machine = HostedMachine(document.value.mock, rng, python_plant(NOMINAL, name), 0)
    machine.power(True)
    path = (targets(cycle_s) * COUNTS_PER_RAD).tolist()
    step = round(cycle_s * NS)
    began = perf_counter()
    for target in path:
        machine.track(target, step)
        machine.advance(step)
        machine.latch()
    return perf_counter() - began


def in_python() -> Document[Bench]:
    """Return the bench with the machine of :data:`NOMINAL`."""
    tree = yaml.safe_load(resolve("practical", "benches").read_text())
    tree["mock"] = {"plant": {"python": NOMINAL.name, "class": "Nominal"}}
    return bench_from_text(yaml.safe_dump(tree), NOMINAL)


def main() -> None:
    """Print cycles per second, medians over alternating repeats."""
    document = load_bench("practical")
    cycle_s = 1.0 / document.value.cycle_Hz
    jobs = {
        "plant alone": partial(plant_alone, document, cycle_s),
        "whole exchange": partial(exchange, document, cycle_s),
        "machine in Python alone": partial(plant_alone, in_python(), cycle_s),
        "whole exchange with it": partial(exchange, in_python(), cycle_s),
    }
    seconds: dict[str, list[float]] = {name: [] for name in jobs}
    for job in jobs.values():
        job()  # compiles
    for _ in range(REPEATS):
        for name, job in jobs.items():
            seconds[name].append(job())
    floor = median(seconds["plant alone"])
    rows = [
        [
            name,
            f"{median(s) / floor:.2f}",
            f"{CYCLES * cycle_s / median(s):.1f}",
            f"{CYCLES / median(s):.0f}",
        ]
        for name, s in seconds.items()
    ]
    print(table(["loop", "time over plant alone", "times real time", "cycles/s"], rows))


if __name__ == "__main__":
    main()
