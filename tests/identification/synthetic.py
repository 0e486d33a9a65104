"""Recordings with known parameters, written from eq. 15 without the package's own friction."""

from collections.abc import Callable, Mapping

import numpy as np

from identification.model.gas_generator import (
    NOTHING,
    GasGenerator,
    constants,
    equilibrium_pressure,
    march,
    throat_derivatives,
)
from identification.numerics.least_squares import BlockArrow
from identification.recording import Array, Bench, Pendulum, Recording

TRUTH: Mapping[str, float] = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "J": 0.204,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}
SYSTEM = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
LOAD = ("mu_c", "mu_s", "omega_sL", "mu_2")
BENCH = Bench(
    torque_constant=0.03,
    back_emf_constant=0.02588,
    resistance=1.56,
    inductance=0.00132,
    gear_ratio=100.0,
    moment_arm=0.095,
)
ARM_M = 0.095


def friction(
    velocity: Array, p: Mapping[str, float], moment: float = 0.0, alpha: float = 2.0
) -> Array:
    """Eq. 9 plus 13 with the sign that the paper leaves out, N m."""
    speed = np.abs(velocity)
    dry = p["Mc"] + (p["Ms"] - p["Mc"]) * np.exp(-((speed / p["omega_sf"]) ** alpha))
    total = dry + p["sigma_2"] * speed
    if moment:
        load = p["mu_c"] + (p["mu_s"] - p["mu_c"]) * np.exp(-((speed / p["omega_sL"]) ** alpha))
        total = total + moment * (load + p["mu_2"] * speed)
    return np.asarray(np.sign(velocity) * total)


def sine(
    p: Mapping[str, float] = TRUTH,
    *,
    name: str = "sine",
    weight: float = 0.0,
    rate: float = 1000.0,
    duration: float = 5.0,
    frequency: float = 0.2,
    amplitude: float = 0.35,
    offset: float = 0.0,
    drift: float = 0.0,
    alpha: float = 2.0,
    bench: Bench = BENCH,
    pendulum: Pendulum | None = None,
    role: str = "fit",
    noise: Callable[[int], Array] | None = None,
) -> Recording:
    """Angle amplitude sin(w t) + drift t, exact angle, velocity and joint torque."""
    time = (np.arange(round(duration * rate)) + 0.37) / rate
    w = 2.0 * np.pi * frequency
    angle = amplitude * np.sin(w * time) + drift * time
    velocity = amplitude * w * np.cos(w * time) + drift
    acceleration = -amplitude * w * w * np.sin(w * time)
    moment = 10.0 * weight * 9.80665 * ARM_M
    torque = friction(velocity, p, moment, alpha) + p["J"] * acceleration + offset
    if pendulum is not None:
        torque = torque + pendulum.mass * pendulum.length**2 * acceleration
        torque = torque + pendulum.mass * 9.80665 * pendulum.length * np.sin(angle - pendulum.zero)
    if noise is not None:
        torque = torque + noise(len(time))
    return Recording(
        name=name,
        channels={"time": time, "angle": angle, "velocity": velocity, "torque": np.asarray(torque)},
        bench=bench,
        stage="loaded" if weight else "unloaded",
        weight_mass=weight,
        pendulum=pendulum,
        role=role,  # type: ignore[arg-type]
    )


def dense(matrix: BlockArrow) -> Array:
    """Return the dense matrix, shape (r, p + m)."""
    rows, p = matrix.parameters.shape
    out = np.zeros((rows, p + matrix.blocks))
    out[:, :p] = matrix.parameters
    out[np.arange(rows), p + matrix.owners] = matrix.own
    return out


def pressure_history(
    time: Array, angle: Array, g: GasGenerator, exact: bool = True
) -> tuple[Array, Array, Array]:
    """Return pressure (Pa), web burnt (m) and the pressure's rate under a moving valve."""
    areas = throat_derivatives(angle, g.valve)
    start = float(equilibrium_pressure(areas[0, 0], g, exact=exact))
    out = np.empty((3, len(time)))
    march(time, areas, constants(g, {}, start, g.V_0, exact=exact), NOTHING, out)
    return out[0], out[1], out[2]
