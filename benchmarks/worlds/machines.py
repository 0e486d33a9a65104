"""Draws the machine of a world with its drive, encoders and logger: a rotary machine of a size
between a hobby servo and the valve, or a linear machine between a small actuator and a ball screw
that carries hundreds of kilograms.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.worlds.world import Constants, Drive, Log, LoopKind, Motion, Motor, Sensing
from rig.results.prove.draw import even, log

GRAVITY_M_S2 = 9.80665
SMALLEST_N_M, LARGEST_N_M = 0.2, 40.0
"""Greatest torque of the smallest and of the largest machine, N m."""
LINEAR_N, LINEAR_TRAVEL_M, LINEAR_SPEED_M_S = (20.0, 2000.0), (0.05, 0.6), (0.05, 0.8)
"""Ranges of greatest force, N, travel to either side, m, and speed, m/s, of linear machines."""
SCREW_LEAD_M, BELT_M = (0.002, 0.02), (0.06, 0.2)
"""Ranges of the travel per motor turn of a ball screw, and per turn of the pulley of a belt, m."""
BELT_GEARS = (1.0, 3.0, 5.0, 10.0)
ARM = 1.0
"""Ratio of the friction force on a carriage to the friction of the contact force."""
LOOP_RATES_HZ = (2000, 4000, 8000)
LOG_RATES_HZ = (100, 200, 250, 500, 1000, 2000, 4000)
LEAST_GAIN_HZ, MOST_GAIN_HZ = 1.0, 16.0
"""Range of the bandwidth of the position loop, Hz."""
LOOPS: dict[LoopKind, float] = {"cascade": 0.5, "pd": 0.2, "torque": 0.15, "host": 0.15}
"""Share of each kind of loop."""
HOST_RATES_HZ = (200, 500, 1000)


class Body(NamedTuple):
    """The machine without drive, encoders and logger.

    Attributes:
        peak_N_m: Greatest torque at the joint.
        travel: Greatest commanded angle, rad.
        speed: Greatest commanded speed, rad/s.
        constants: Constants of the nominal model.
        motor: Motor and gear.
        moment_arm_m: L1.
        lever_ratio: L3/L4.
        heaviest_kg: Heaviest weight on the lever.
        motion: Whether the joint turns or is a carriage; units as in
            :mod:`benchmarks.worlds.world`.
    """

    peak_N_m: float
    travel: float
    speed: float
    constants: Constants
    motor: Motor
    moment_arm_m: float
    lever_ratio: float
    heaviest_kg: float
    motion: Motion


def draw_body(rng: np.random.Generator, falls: bool, motion: Motion = "rotary") -> Body:
    """Draw a machine.

    Args:
        rng: Generator.
        falls: Whether static friction must exceed Coulomb friction; if not, the two are equal in
            one of five machines.
        motion: Kind of motion of the machine.
    """
    linear = motion == "linear"
    peak = log(*(LINEAR_N if linear else (SMALLEST_N_M, LARGEST_N_M)))(rng)
    travel = log(*(LINEAR_TRAVEL_M if linear else (0.25, 1.2)))(rng)
    speed = log(*(LINEAR_SPEED_M_S if linear else (0.8, 5.0)))(rng)
    Mc = peak * rng.uniform(0.1, 0.22)
    flat = not falls and rng.uniform() < 0.2
    arm, ratio = 0.095 * float(rng.uniform(0.5, 1.2)), float(rng.choice((1.0, 5.0, 10.0)))
    arm = ARM if linear else arm
    mu_c = float(rng.uniform(0.03, 0.08))
    constants = Constants(
        J=peak * rng.uniform(0.15, 0.5) / (speed * 2.0 * math.pi * rng.uniform(1.0, 2.5)),
        Mc=Mc,
        Ms=Mc * (1.0 if flat else 1.0 + rng.uniform(0.2, 0.9)),
        omega_sf=speed * log(0.01, 0.06)(rng),
        sigma_2=Mc * rng.uniform(0.25, 1.0) / speed,
        mu_c=mu_c,
        mu_s=mu_c * (1.0 if flat else 1.0 + rng.uniform(0.2, 0.9)),
        omega_sL=speed * log(0.01, 0.06)(rng),
        mu_2=mu_c * rng.uniform(0.2, 0.8) / speed,
    )
    heaviest = Mc * rng.uniform(0.4, 1.3) / (mu_c * arm * ratio * GRAVITY_M_S2)
    motor = _motor(rng, peak, speed, _rad_per_m(rng) if linear else None)
    return Body(peak, travel, speed, constants, motor, arm, ratio, heaviest, motion)


def _rad_per_m(rng: np.random.Generator) -> float:
    """Draw the motor angle per travel of a ball screw or of a belt with or without a gear."""
    if rng.uniform() < 0.6:
        return 2.0 * math.pi / round(log(*SCREW_LEAD_M)(rng), 3)
    return 2.0 * math.pi * float(rng.choice(BELT_GEARS)) / round(log(*BELT_M)(rng), 3)


def _motor(rng: np.random.Generator, peak: float, speed: float, rad_per_m: float | None) -> Motor:
    """Draw a motor that reaches the peak torque, and that needs half of its supply voltage for the
    greatest speed.
    """
    supply = float(rng.choice((6.0, 12.0, 24.0, 48.0, 60.0)))
    limit = 2.0 * peak * speed / supply * log(1.3, 5.0)(rng)
    gear = float(round(log(20.0, 300.0)(rng))) if rad_per_m is None else rad_per_m
    resistance = rng.uniform(0.2, 0.4) * supply / limit
    return Motor(
        resistance_ohm=resistance,
        inductance_H=resistance * log(3e-4, 1.5e-3)(rng),
        constant=peak / (limit * gear),
        gear_ratio=gear,
        supply_V=supply,
        limit_A=limit,
        rotor_share=float(rng.uniform(0.3, 0.7)),
        friction_share=float(rng.uniform(0.05, 0.3)),
    )


def draw_drive(rng: np.random.Generator) -> Drive:
    """Draw the drive loops; the gains vary by a factor of sixteen."""
    rate = int(rng.choice(LOOP_RATES_HZ))
    kind: Any = str(rng.choice(list(LOOPS), p=list(LOOPS.values())))
    position = log(LEAST_GAIN_HZ, MOST_GAIN_HZ)(rng)
    return Drive(
        kind=kind,
        rate_Hz=rate,
        position_Hz=position,
        velocity_Hz=min(position * rng.uniform(3.0, 6.0), rate / 60.0),
        current_Hz=min(log(200.0, 800.0)(rng), rate / 10.0),
        feedforward=float(rng.choice((0.0, 1.0))) if kind == "cascade" else 0.0,
        host_Hz=int(rng.choice(HOST_RATES_HZ)) if kind in ("torque", "host") else 0,
    )


def draw_sensing(
    rng: np.random.Generator, motor: Motor, needs: Collection[str], motion: Motion = "rotary"
) -> Sensing:
    """Draw encoders of 12 to 24 bits and the current sensor.

    Args:
        rng: Generator.
        motor: Motor of the machine.
        motion: Kind of motion; the scale of a linear machine has 2^17 to 2^24 counts per m.
        needs: What the effects require: ``two encoders``, ``motor encoder``.
    """
    both, at_motor = rng.uniform() < 0.5, rng.uniform() < 0.6
    both, at_motor = both or "two encoders" in needs, at_motor or "motor encoder" in needs
    motor_bits = int(rng.integers(12, 17)) if both or at_motor else None
    # A drive whose only encoder is a coarse one on the joint cannot close a velocity loop.
    fewest = 12 if motor_bits is not None and motion == "rotary" else 17
    joint_bits = int(rng.integers(fewest, 25)) if both or not at_motor else None
    return Sensing(
        motor_bits=motor_bits,
        joint_bits=joint_bits,
        flicker=float(rng.choice((0.0, 0.3, 0.7))),
        lines_error=float(rng.choice((0.0, log(3e-4, 3e-3)(rng)))),
        current_noise_A=motor.limit_A * log(3e-4, 4e-3)(rng),
        current_quantum_A=motor.limit_A / 2.0 ** int(rng.integers(9, 14)),
        voltage_noise_V=motor.supply_V * log(2e-4, 3e-3)(rng),
    )


def draw_log(
    rng: np.random.Generator, drive: Drive, voltages: Sequence[str], unfiltered: bool
) -> Log:
    """Draw the logger.

    Args:
        rng: Generator.
        drive: The drive, whose loops are at least as fast as the log.
        voltages: Ways in which the voltage may be known.
        unfiltered: Whether the current must not be filtered.
    """
    shares = (0.5, 0.5, 0.0) if unfiltered else (0.4, 0.4, 0.2)
    way: Any = str(rng.choice(("sampled", "averaged", "filtered"), p=shares))
    voltage: Any = str(rng.choice(voltages))
    return Log(
        rate_Hz=int(rng.choice([r for r in LOG_RATES_HZ if drive.rate_Hz % r == 0])),
        current=way,
        filter_Hz=log(200.0, 1000.0)(rng),
        voltage=voltage,
        supply=bool(rng.uniform() < 0.3),
        jitter=float(rng.choice((0.0, even(0.01, 0.2)(rng)))),
        clock=bool(rng.uniform() < 0.5),
        packed=bool(rng.uniform() < 0.5),
    )
