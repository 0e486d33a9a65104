"""Builds a simulated bench with an ODrive or MIT-style drive and a CANopen joint encoder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from drivers.clock import SimulatedClock
from drivers.mock.candr import CanDrive
from drivers.mock.can_drives.mit_motor import MIT_DBC, MitMotor
from drivers.mock.can_drives.odrive import ODRIVE_DBC, ODriveAxis
from drivers.mock.encoder import SimulatedEncoder
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

CanDriveKind = Literal["odrive", "mit"]
CAN_DRIVE_FILES: Final[Mapping[CanDriveKind, Path]] = {"odrive": ODRIVE_DBC, "mit": MIT_DBC}
"""The DBC file of each kind of drive."""
_KINDS: Final[
    Mapping[CanDriveKind, Callable[[SimulatedBus, SimulatedClock, Sampler], CanDrive]]
] = {"odrive": ODriveAxis, "mit": MitMotor}


@dataclass(frozen=True)
class SimulatedCanBench:
    """The parts of one simulated bench."""

    clock: SimulatedClock
    bus: SimulatedBus
    machine: SimulatedMachine
    drive: CanDrive
    encoder: SimulatedEncoder


def simulated_can_bench(
    kind: CanDriveKind, machine: constants.Machine, seed: int, bitrate: int, encoder_node: int
) -> SimulatedCanBench:
    """Build a bench and boot its devices; the same seed gives the same bytes on the bus.

    Args:
        kind: Kind of the drive.
        machine: Constants of the machine.
        seed: Seed of the machine's noise and of the encoder's clock offset.
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
    drive = _KINDS[kind](bus, clock, sampler)
    encoder = SimulatedEncoder(bus, clock, encoder_node, sampler, int(offsets.integers(1 << 32)))
    drive.boot()
    encoder.boot()
    return SimulatedCanBench(clock, bus, plant, drive, encoder)
