"""Builds a simulated bench with the generic DBC drive and a CANopen joint encoder on one bus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.clock import SimulatedClock
from drivers.mock.bench import ENCODER_NODE
from drivers.mock.dbc_drive import DbcDrive
from drivers.mock.encoder import SimulatedEncoder
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus


@dataclass(frozen=True)
class SimulatedDbcBench:
    """The parts of one simulated bench."""

    clock: SimulatedClock
    bus: SimulatedBus
    machine: SimulatedMachine
    drive: DbcDrive
    encoder: SimulatedEncoder
    sampler: Sampler


def simulated_dbc_bench(
    machine: constants.Machine,
    seed: int,
    bitrate: int = 1_000_000,
    encoder_node: int = ENCODER_NODE,
) -> SimulatedDbcBench:
    """Build a bench and boot its devices.

    The same seed gives the same bytes on the bus, and the same noise as the CANopen bench.

    Args:
        machine: Constants of the machine.
        seed: Seed of the machine's noise and of the devices' clock offsets.
        bitrate: Bit rate of the bus, bit/s.
        encoder_node: CANopen node identifier of the encoder.

    Returns:
        The bench, at rest at angle 0, with power off.
    """
    noise, offsets = np.random.default_rng(seed).spawn(2)
    clock = SimulatedClock()
    bus = SimulatedBus(clock, bitrate)
    plant = SimulatedMachine(machine, noise)
    sampler = Sampler(plant)
    drive = DbcDrive(bus, clock, sampler, int(offsets.integers(1 << 32)))
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, int(offsets.integers(1 << 32)))
    drive.boot()
    encoder.boot()
    return SimulatedDbcBench(clock, bus, plant, drive, encoder, sampler)
