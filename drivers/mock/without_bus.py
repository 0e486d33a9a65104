"""Simulates recordings of a bench without its bus, with the same samples, two hundred times faster.

If no frame is lost or late, the bus determines only the timing, which is the same in every cycle:
drive and encoder latch at the SYNC, and the drive interpolates to the target of that SYNC within
the next cycle. The function `record` applies this timing and the units of the devices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.drive import Rating
from drivers.mock.encoder import PRESSURE_UNIT_PA, transmitted
from drivers.mock.plant.machine import DrivenMachine
from drivers.mock.sampler import encoder_resolution

SLOW_EVERY = 10  # period, in cycles, of the frames with supply voltage and temperature

Channel = NDArray[np.float64]


class Samples(NamedTuple):
    """A recording with the values that the host's drivers return: SI units, arrays of shape (n,).

    ``velocity`` is the drive's estimate at the joint; ``angle`` is that of the joint encoder, and
    ``motor_angle`` that of the motor encoder. ``current`` and ``voltage`` are means over the cycle
    that ends at the sample. While no gas generator burns, ``pressure`` is the pressure downstream
    of the valve.
    """

    time: Channel
    command: Channel
    motor_angle: Channel
    angle: Channel
    velocity: Channel
    current: Channel
    voltage: Channel
    supply_voltage: Channel
    temperature: Channel
    pressure: Channel


def record(
    machine: DrivenMachine,
    command_rad: Channel,
    cycle_s: float = 0.001,
    slow_phase: int = 0,
    pressure_rng: np.random.Generator | None = None,
) -> Samples:
    """Record an energised machine that follows one joint angle per cycle, from its present state.

    Args:
        machine: The machine with power on, the own one or another
            (:class:`drivers.mock.plant.hosted.HostedMachine`); the limits of its control loops
            apply.
        command_rad: Joint angle sent with each SYNC, shape (n,).
        cycle_s: Control cycle, s; a whole number of loop periods.
        slow_phase: Cycles since the last frame with supply voltage and temperature.
        pressure_rng: Random generator of the pressure transmitter's noise, or None for no noise.

    Raises:
        ValueError: The cycle is not a whole number of loop periods.
        MachineError: Another machine fails.
    """
    gear = machine.constants.motor.gear_ratio
    increments, turns = encoder_resolution(machine.constants)
    motor_unit_rad = 2.0 * np.pi / (increments / turns)
    sent = np.rint(command_rad / (motor_unit_rad / gear))
    latches = machine.record(sent, round(cycle_s * 1e9))
    speed = np.rint(latches.joint_velocity_rad_s * gear * (increments / turns / (2.0 * np.pi)))
    cycle = np.arange(len(sent))
    held = np.maximum(cycle - (cycle + slow_phase) % SLOW_EVERY, 0)
    return Samples(
        np.asarray(cycle * cycle_s, dtype=np.float64),
        np.asarray(command_rad, dtype=np.float64),
        latches.motor_counts * motor_unit_rad,
        latches.joint_counts * machine.joint_count_rad,
        speed * (motor_unit_rad / gear),
        _int16(latches.current_A * (1e3 / Rating.current_A)) * (Rating.current_A / 1e3),
        _int16(latches.voltage_V * 1e2) * 0.01,
        np.rint(latches.supply_V * 1e3)[held] * 1e-3,
        np.rint(machine.temperature(latches.run_s) * 1e1)[held] * 0.1,
        transmitted(machine.constants.gas.transmitter, latches.pressure_Pa, pressure_rng)[0]
        * PRESSURE_UNIT_PA,
    )


def _int16(units: Channel) -> Channel:
    """Round and clamp to the range of the drive's 16-bit objects."""
    return np.asarray(np.clip(np.rint(units), -0x8000, 0x7FFF))
