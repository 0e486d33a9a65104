"""Builds simulated benches: clock, bus, machine, drive and joint encoder.

The same seed gives the same bytes on the bus, and benches with drives of different kinds the same
noise. A new bench is at rest at angle 0, with power off; its devices have booted.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Final, Generic, TypeVar

import numpy as np

from drivers.clock import SimulatedClock
from drivers.errors import MachineError
from drivers.mock.can_drives import CAN_DRIVES, CanDrive, CanDriveKind
from drivers.mock.dbc_drive import DbcDrive
from drivers.mock.drive import Rating, SimulatedDrive
from drivers.mock.encoder import SimulatedEncoder, SimulatedTransmitter
from drivers.mock.plant.hosted import HostedMachine, PlantFile
from drivers.mock.plant.machine import DrivenMachine, SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.sampler import Sampler
from drivers.mock.traits import Traits
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.serial_line import SimulatedLine

DRIVE_NODE: Final = 1
ENCODER_NODE: Final = 2
TRANSMITTER_NODE: Final = 4
D = TypeVar("D", SimulatedDrive, DbcDrive, CanDrive)


@dataclass(frozen=True)
class Parts(Generic[D]):
    """The parts of one simulated bench."""

    clock: SimulatedClock
    bus: SimulatedBus
    machine: DrivenMachine
    drive: D
    encoder: SimulatedEncoder
    sampler: Sampler


@dataclass(frozen=True)
class SimulatedBench(Parts[SimulatedDrive]):
    """A bench with a CANopen drive.

    ``lines`` are the serial lines of ``drive`` and ``encoder``, if the bench has any;
    ``transmitter`` measures the chamber pressure, if the bench has a transmitter.
    """

    transmitter: SimulatedTransmitter | None = None
    lines: dict[str, SimulatedLine] = field(default_factory=dict)


class SimulatedDbcBench(Parts[DbcDrive]):
    """A bench with the drive of ``dbc_drive.dbc``."""


SimulatedCanBench = Parts[CanDrive]


def simulated_bench(
    machine: constants.Machine,
    seed: int,
    bitrate: int = 1_000_000,
    drive_node: int = DRIVE_NODE,
    encoder_node: int = ENCODER_NODE,
    transmitter_node: int | None = None,
    rating: Rating | None = None,
    traits: Traits | None = None,
    plant: PlantFile | None = None,
) -> SimulatedBench:
    """Build a bench with a CANopen drive, whose devices are in PRE-OPERATIONAL.

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
        plant: Another machine behind the drive, of which ``machine`` then states what the drive
            assumes; an error in it is raised where the simulated time advances.

    Raises:
        MachineError: The other machine fails before the devices are built.
    """
    offsets, clock, bus, sampler = _basis(machine, seed, bitrate, plant)
    offset_us = _offset_us(offsets)
    drive = SimulatedDrive(bus, clock, drive_node, sampler, offset_us, rating, traits)
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, _offset_us(offsets))
    drive.boot()
    encoder.boot()
    transmitter = None
    if transmitter_node is not None:
        pressure = np.random.default_rng(seed).spawn(3)[2]
        transmitter = SimulatedTransmitter(bus, clock, transmitter_node, sampler, pressure)
        transmitter.boot()
    return SimulatedBench(clock, bus, sampler.machine, drive, encoder, sampler, transmitter)


def simulated_dbc_bench(
    machine: constants.Machine,
    seed: int,
    bitrate: int = 1_000_000,
    encoder_node: int = ENCODER_NODE,
    plant: PlantFile | None = None,
) -> SimulatedDbcBench:
    """Build a bench with the drive of ``dbc_drive.dbc``; see :func:`simulated_bench`."""
    offsets, clock, bus, sampler = _basis(machine, seed, bitrate, plant)
    drive = DbcDrive(bus, clock, sampler, _offset_us(offsets))
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, _offset_us(offsets))
    drive.boot()
    encoder.boot()
    return SimulatedDbcBench(clock, bus, sampler.machine, drive, encoder, sampler)


def simulated_can_bench(
    kind: CanDriveKind,
    machine: constants.Machine,
    seed: int,
    bitrate: int,
    encoder_node: int,
    plant: PlantFile | None = None,
) -> SimulatedCanBench:
    """Build a bench with a drive of this kind; see :func:`simulated_bench`."""
    offsets, clock, bus, sampler = _basis(machine, seed, bitrate, plant)
    drive = CAN_DRIVES[kind](bus, clock, sampler)
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, _offset_us(offsets))
    drive.boot()
    encoder.boot()
    return SimulatedCanBench(clock, bus, sampler.machine, drive, encoder, sampler)


def _basis(
    machine: constants.Machine, seed: int, bitrate: int, plant: PlantFile | None
) -> tuple[np.random.Generator, SimulatedClock, SimulatedBus, Sampler]:
    noise, offsets = np.random.default_rng(seed).spawn(2)
    clock = SimulatedClock()
    driven: DrivenMachine
    if plant is None:
        driven = SimulatedMachine(machine, noise)
    else:
        # An error is raised after the present event, so that bus and drive stay intact.
        driven = HostedMachine(
            machine,
            noise,
            plant,
            seed,
            lambda error: clock.call_at(clock.now_ns(), partial(_raise, error)),
        )
    return offsets, clock, SimulatedBus(clock, bitrate), Sampler(driven)


def _raise(error: MachineError) -> None:
    raise error


def _offset_us(offsets: np.random.Generator) -> int:
    return int(offsets.integers(1 << 32))
