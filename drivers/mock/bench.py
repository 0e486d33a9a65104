"""Builds a simulated CANopen bench: clock, bus, machine, drive and joint encoder."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drivers.clock import SimulatedClock
from drivers.mock.dbc_drive import DbcDrive
from drivers.mock.drive import Rating, SimulatedDrive
from drivers.mock.encoder import SimulatedEncoder, SimulatedTransmitter
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.sampler import Sampler
from drivers.mock.traits import Traits
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.serial_line import SimulatedLine

DRIVE_NODE: Final = 1
ENCODER_NODE: Final = 2
TRANSMITTER_NODE: Final = 4


@dataclass(frozen=True)
class SimulatedBench:
    """The parts of one simulated bench.

    ``lines`` are the serial lines of ``drive`` and ``encoder``, if the bench has any;
    ``transmitter`` measures the chamber pressure, if the bench has a transmitter.
    """

    clock: SimulatedClock
    bus: SimulatedBus
    machine: SimulatedMachine
    drive: SimulatedDrive
    encoder: SimulatedEncoder
    sampler: Sampler
    transmitter: SimulatedTransmitter | None = None
    lines: dict[str, SimulatedLine] = field(default_factory=dict)


def simulated_bench(
    machine: constants.Machine,
    seed: int,
    bitrate: int = 1_000_000,
    drive_node: int = DRIVE_NODE,
    encoder_node: int = ENCODER_NODE,
    transmitter_node: int | None = None,
    rating: Rating | None = None,
    traits: Traits | None = None,
) -> SimulatedBench:
    """Build a bench and boot its devices. The same seed gives the same bytes on the bus.

    Args:
        machine: Constants of the machine.
        seed: Seed of the machine's noise and of the devices' clock offsets.
        bitrate: Bit rate of the bus, bit/s.
        drive_node: CANopen node identifier of the drive.
        encoder_node: CANopen node identifier of the encoder.
        transmitter_node: Node identifier of the pressure transmitter, or None for a bench without
            one.
        rating: Rated values of the drive; a rated current of 15 A unless given.
        traits: Differences of the drive from the usual simulated drive.

    Returns:
        The bench, at rest at angle 0, with power off; all devices are in PRE-OPERATIONAL after
        their boot-up frames.
    """
    noise, offsets, pressure = np.random.default_rng(seed).spawn(3)
    clock = SimulatedClock()
    bus = SimulatedBus(clock, bitrate)
    plant = SimulatedMachine(machine, noise)
    sampler = Sampler(plant)
    offset_us = int(offsets.integers(1 << 32))
    drive = SimulatedDrive(bus, clock, drive_node, sampler, offset_us, rating, traits)
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, int(offsets.integers(1 << 32)))
    drive.boot()
    encoder.boot()
    transmitter = None
    if transmitter_node is not None:
        transmitter = SimulatedTransmitter(bus, clock, transmitter_node, sampler, pressure)
        transmitter.boot()
    return SimulatedBench(clock, bus, plant, drive, encoder, sampler, transmitter)


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
