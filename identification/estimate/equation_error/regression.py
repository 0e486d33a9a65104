"""Formulates the linear regression of the measured torque on the model's terms, unloaded (M7) and
loaded (M8).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.model.friction import stribeck_shape
from identification.model.ladder import LADDER, bears_load, rises
from identification.numerics.arrays import Array, BoolArray
from identification.numerics.bounded_least_squares import Design
from identification.prepare import Prepared
from identification.recording import Model, RecordingError

HIGHEST_SHARE = 1.0 / 3.0
"""Greatest Stribeck speed that is tried, relative to the greatest recorded speed; with a higher
Stribeck speed the falling part cannot be distinguished from a straight line.
"""
LEAST_MOTION = 40
"""Least number of moving samples, over all recordings of a stage, for a fit."""
LOWEST_SHARE = 1e-3
"""Least Stribeck speed that is tried, relative to the greatest recorded speed."""


def samples_in_motion(prepared: Sequence[Prepared]) -> int:
    """Return the number of samples in motion that a fit uses, over all recordings."""
    return sum(int(np.sum(_moving(p))) for p in prepared)


def _moving(p: Prepared) -> BoolArray:
    """Return whether each sample is used and in motion, shape (n,)."""
    return np.asarray(p.used & (p.velocity != 0.0))


def _reversals_per_s(prepared: Sequence[Prepared]) -> float:
    """Return the mean number of reversals per second of motion, over all recordings."""
    moving = [p.raw_velocity[p.raw_velocity != 0.0] for p in prepared]
    seconds = sum(len(v) * p.recording.period for v, p in zip(moving, prepared, strict=True))
    count = sum(int(np.count_nonzero(np.diff(np.sign(v)))) for v in moving)
    return count / seconds if seconds > 0.0 else 0.0


def require_motion(prepared: Sequence[Prepared]) -> None:
    """Check that a stage has moving samples with nonzero torque.

    Raises:
        RecordingError: Too few samples are in motion, or the drive's torque is zero in all of them.
    """
    moving = [_moving(p) for p in prepared]
    count = samples_in_motion(prepared)
    names = ", ".join(p.recording.name for p in prepared)
    if count < LEAST_MOTION:
        bandwidth, reversals = prepared[0].bandwidth_Hz, _reversals_per_s(prepared)
        remedy = (
            f"the motion reverses {reversals:.3g} times per second, so that nearly every window of "
            "the filter contains rest; choose a greater bandwidth, or add recordings with fewer "
            "reversals per second"
            if reversals > bandwidth
            else "add recordings in which the joint moves longer or further"
        )
        raise RecordingError(
            f"{names}: at a bandwidth of {bandwidth:.3g} Hz, {count} samples are in motion; a fit "
            f"needs at least {LEAST_MOTION} samples in motion: {remedy}"
        )
    if not any(np.any(p.drive_torque[rows]) for p, rows in zip(prepared, moving, strict=True)):
        raise RecordingError(
            f"{names}: the drive's torque is zero at all samples in motion; check which column is "
            "declared as the torque"
        )


def filtered_shape(p: Prepared, omega_s: float, alpha: float) -> Array:
    """Return sgn(omega) exp(-|omega/omega_s|^alpha), passed through the recording's filter, shape
    (n,).
    """
    return p.filter(stribeck_shape(p.raw_velocity, omega_s, alpha))


def filtered_sign(p: Prepared) -> Array:
    """Return sgn(omega), passed through the recording's filter, shape (n,)."""
    return p.filter(np.sign(p.raw_velocity))


def gear_sign(p: Prepared) -> Array:
    """Return |pendulum torque| sgn(omega), passed through the recording's filter, N m, (n,)."""
    return p.filter(p.raw_load * np.sign(p.raw_velocity))


def gear_shape(p: Prepared, omega_s: float, alpha: float) -> Array:
    """Return |pendulum torque| sgn(omega) exp(-|omega/omega_s|^alpha), passed through the
    recording's filter, N m, shape (n,).
    """
    return p.filter(p.raw_load * stribeck_shape(p.raw_velocity, omega_s, alpha))


def friction_torque(p: Prepared, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return the modelled friction plus offset (eq. 9 + 13), passed through the recording's filter,
    N m, shape (n,).

    Parameters that are absent count as zero.
    """
    q = parameters
    sign = filtered_sign(p)
    total = q.get("Mc", 0.0) * sign + q.get("sigma_2", 0.0) * p.velocity + q.get("offset", 0.0)
    if q.get("Ms", 0.0) > q.get("Mc", 0.0) and q.get("omega_sf", 0.0) > 0.0:
        total = total + (q["Ms"] - q["Mc"]) * filtered_shape(p, q["omega_sf"], alpha)
    if np.any(p.moment != 0.0):
        load = q.get("mu_c", 0.0) * sign + q.get("mu_2", 0.0) * p.velocity
        if q.get("mu_s", 0.0) > q.get("mu_c", 0.0) and q.get("omega_sL", 0.0) > 0.0:
            load = load + (q["mu_s"] - q["mu_c"]) * filtered_shape(p, q["omega_sL"], alpha)
        total = total + p.moment * load
    if "mu_gc" in q and np.any(p.raw_load != 0.0):
        total = total + q["mu_gc"] * gear_sign(p)
        if q.get("mu_gs", 0.0) > q["mu_gc"]:
            total = total + (q["mu_gs"] - q["mu_gc"]) * gear_shape(p, q["omega_sf"], alpha)
    return np.asarray(total)


def model_torque(p: Prepared, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return the torque of the model (eq. 15), N m, shape (n,)."""
    return friction_torque(p, parameters, alpha) + parameters.get("J", 0.0) * p.acceleration


@dataclass(frozen=True)
class Stage:
    """One stage of the equation error: the names of its parameters, and its linear problem.

    The rise dM = Ms - Mc (dmu = mu_s - mu_c) is a coefficient in place of the static level, so that
    its lower bound can be 0.

    Attributes:
        name: ``unloaded`` or ``loaded``.
        coulomb: Mc or mu_c.
        static: Ms or mu_s, or None if the model has no static friction above Coulomb friction.
        speed: omega_sf or omega_sL, or None if the model has no Stribeck speed.
        others: Names of the remaining coefficients.
        prepared: Recordings of the stage.
        model: Declared terms, fixed values and alpha.
        known: Parameters from the unloaded stage, which are fixed in the loaded stage.
    """

    name: str
    coulomb: str
    static: str | None
    speed: str | None
    others: tuple[str, ...]
    prepared: tuple[Prepared, ...]
    model: Model
    known: Mapping[str, float]

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the fitted coefficients in column order.

        ``rise`` is the static less the Coulomb level; ``gear_rise`` is mu_gs less mu_gc.
        """
        fixed = self.model.fixed
        names = [] if self.coulomb in fixed else [self.coulomb]
        names += [] if self.static is None or self.static in fixed else ["rise"]
        return tuple(names + [n for n in self.others if n not in fixed])

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and greatest value of each coefficient in column order.

        Only the offset may be negative. The rise is at most the greatest recorded torque, because a
        joint that moved has overcome its static friction. Without this bound the rise would be
        unbounded if no sample lies on the falling branch of friction.
        """
        low = np.array([-np.inf if name == "offset" else 0.0 for name in self.free])
        high = np.full(len(self.free), np.inf)
        if "rise" in self.free:
            scales = [
                float(np.max(p.moment)) if self.name == "loaded" else 1.0 for p in self.prepared
            ]
            peaks = [
                float(np.max(np.abs(p.torque))) / s
                for p, s in zip(self.prepared, scales, strict=True)
            ]
            high[self.free.index("rise")] = max(*peaks, 1e-300)
        if "gear_rise" in self.free:
            peak = max(float(np.max(np.abs(p.torque))) for p in self.prepared)
            load = max(float(np.max(p.raw_load)) for p in self.prepared)
            high[self.free.index("gear_rise")] = peak / load if load > 0.0 else np.inf
        return low, high

    def speed_range(self) -> tuple[float, float]:
        """Return the least and the greatest Stribeck speed that are tried, rad/s; (1, 1) if the
        model has no Stribeck speed.
        """
        if self.speed is None:
            return 1.0, 1.0
        if self.speed in self.model.fixed:
            held = float(self.model.fixed[self.speed])
            return held, held
        top = max(float(np.max(np.abs(p.velocity[p.used]), initial=0.0)) for p in self.prepared)
        return LOWEST_SHARE * top, HIGHEST_SHARE * top

    def design(self, omega_s: float) -> Design:
        """Return the linear least-squares problem at one Stribeck speed."""
        alpha, fixed = self.model.alpha, self.model.fixed
        columns: list[list[Array]] = [[] for _ in self.free]
        targets: list[Array] = []
        for p in self.prepared:
            scale = p.moment if self.name == "loaded" else np.ones(len(p.time))
            sign = scale * filtered_sign(p)
            shape = scale * filtered_shape(p, omega_s, alpha)
            basis = {
                "sigma_2": p.velocity,
                "mu_2": scale * p.velocity,
                "J": p.acceleration,
                "offset": np.ones(len(p.time)),
                "rise": shape,
                # If the static level is fixed, a higher Coulomb level reduces the rise by as much
                # as it is higher.
                self.coulomb: sign - shape if self.static in fixed else sign,
            }
            if "mu_gc" in self.free:
                basis["mu_gc"] = gear_sign(p)
            if "gear_rise" in self.free:
                basis["gear_rise"] = gear_shape(p, omega_s, alpha)
            target = p.torque - model_torque(p, self.known, alpha)
            for name in self.others:
                if name in fixed:
                    target = target - fixed[name] * basis[name]
            if self.coulomb in fixed:
                base = sign - shape if self.static in fixed else sign
                target = target - fixed[self.coulomb] * base
            if self.static is not None and self.static in fixed:
                target = target - fixed[self.static] * shape
            targets.append(target[p.used])
            for k, name in enumerate(self.free):
                columns[k].append(basis[name][p.used])
        stack = [np.concatenate(c) for c in columns]
        target = np.concatenate(targets)
        return Design(
            np.column_stack(stack) if stack else np.zeros((len(target), 0)), target, *self.bounds()
        )

    def named(self, omega_s: float, coefficients: Array) -> dict[str, float]:
        """Return the parameters of the stage by name, for coefficients at one Stribeck speed."""
        found = dict(zip(self.free, (float(c) for c in coefficients), strict=True))
        rise, gear_rise = found.pop("rise", None), found.pop("gear_rise", None)
        values = {**{n: float(v) for n, v in self.model.fixed.items() if n in self.names}, **found}
        if self.speed is not None:
            values[self.speed] = omega_s
        if self.static is not None and rise is not None:
            values[self.static] = values[self.coulomb] + rise
        if gear_rise is not None:
            values["mu_gs"] = values["mu_gc"] + gear_rise
        return values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stage's parameters."""
        falling = () if self.static is None or self.speed is None else (self.static, self.speed)
        others = ("mu_gs" if name == "gear_rise" else name for name in self.others)
        return (self.coulomb, *falling, *others)


def unloaded_stage(prepared: Sequence[Prepared], model: Model) -> Stage:
    """Return the unloaded stage (eq. 16) with the declared friction model. Its parameters are Mc,
    Ms, omega_sf, sigma_2, J and, if declared, mu_gc, mu_gs and the offset.

    Raises:
        RecordingError: The friction model depends on a pendulum's torque, and no recording has a
            pendulum.
    """
    terms = LADDER[model.friction]
    if bears_load(model.friction) and not any(np.any(p.raw_load > 0.0) for p in prepared):
        raise RecordingError(
            f"the friction model {model.friction!r} depends on the torque of a pendulum, but no "
            "unloaded recording with role `fit` has a pendulum; declare the pendulum under "
            "`gravity`"
        )
    gear = [
        {"mu_gc": "mu_gc", "mu_gs": "gear_rise"}[name] for name in terms if name.startswith("mu_g")
    ]
    others = ("sigma_2", "J", *gear, *(("offset",) if "offset" in model.terms else ()))
    static, speed = ("Ms", "omega_sf") if rises(model.friction) else (None, None)
    return Stage("unloaded", "Mc", static, speed, others, tuple(prepared), model, {})


def loaded_stage(prepared: Sequence[Prepared], model: Model, known: Mapping[str, float]) -> Stage:
    """Return the loaded stage (eq. 15) with fixed system parameters: mu_c, mu_s, omega_sL, mu_2."""
    return Stage(
        "loaded", "mu_c", "mu_s", "omega_sL", ("mu_2",), tuple(prepared), model, dict(known)
    )
