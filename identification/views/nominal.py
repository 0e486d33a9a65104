"""Computes torque, friction level and tangent of the nominal model at the full sample rate, for
regressors and joint fits.

The parameters are the rise dM = Ms - Mc and log omega_s, with which a joint fit converges to the
right basin more often.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.model.parameters import STRIBECK_TERMS as _RISES
from identification.recording import Array
from identification.signals import central_difference, resample
from identification.views.view import View, recent

RISE = 0.5  # assumed rise of static over Coulomb friction, as a share of Coulomb friction
LARGEST_STEP = 0.4  # greatest change of log omega_s in one iteration
_AT_LIMIT = 1e-9
LEAST_RISE = 1e-6  # least rise of static over Coulomb friction, as a share of Coulomb friction
LEAST_FALL = 1e-3
"""Rise, as a share of Coulomb friction, below which dry friction counts as constant with speed."""
STATICS, SPEEDS = tuple(r[1] for r in _RISES), ("omega_sf", "omega_sL")


class NominalTorque:
    """Torque of the nominal model in a view: load terms (eq. 9, eq. 13) and inertia."""

    values: Mapping[str, float]
    alpha: float
    undeclared: tuple[float, float, float, float]
    zero_A: float
    ripple: tuple[tuple[float, ...], ...]
    efficiency: float
    presliding_stiffness: float

    def get(self, name: str) -> float:
        """Return the value of a nominal parameter; 0 if the bench has no such parameter."""
        return float(self.values.get(name, 0.0))

    @recent
    def level(self, view: View) -> Array:
        """Return the magnitude of the system friction (eq. 9), N m.

        If load-dependent friction is declared, the level includes the friction of the gear due to a
        weight that turns with the joint.
        """
        total = self._level(view, _RISES[0], "sigma_2")
        if any(self.get(name) for name in _RISES[2][:2]):
            total = total + self.borne(view) * self.gear(view)
        return _frozen(total)

    def gear(self, view: View) -> Array:
        """Return the coefficient of declared load-dependent friction, or 0 if none is declared."""
        return self._level(view, _RISES[2], "")

    def coefficient(self, view: View) -> Array:
        """Return the magnitude of m_L, eq. 12."""
        return self._level(view, _RISES[1], "mu_2")

    @recent
    def borne(self, view: View) -> Array:
        """Return the magnitude of the torque of loads that turn with the joint, N m; the gear
        transmits this torque.

        The torque excludes the inertia torque of a weight, on which load-dependent friction does
        not depend in eq. 9, in the friction ladder and on the bench.
        """
        hanging = view.hanging
        if any(self.undeclared):
            hanging = hanging - _unknown(view, self.undeclared)
        return _frozen(np.abs(hanging))

    @recent
    def helping(self, view: View) -> Array:
        """Return the torque of loads that turn with the joint, declared or identified, N m;
        positive if this torque drives the joint forward.
        """
        if not any(self.undeclared):
            return view.known
        return _frozen(view.known - _unknown(view, self.undeclared))

    def helped(self, view: View) -> bool:
        """Whether a declared or identified load that turns with the joint acts here."""
        return any(self.undeclared) or view.burdened

    @recent
    def drive(self, view: View) -> Array:
        """Return the torque that the drive must produce, with loads that turn with it, N m."""
        return _frozen(self.torque(view) - self.helping(view))

    @recent
    def friction(self, view: View) -> Array:
        """Return the sum of system load and working load with its sign (eq. 9 and 13), N m."""
        total = self.level(view)
        if view.loaded:
            total = total + view.moment * self.coefficient(view)
        return _frozen(view.sense * total)

    @recent
    def torque(self, view: View) -> Array:
        """Return the torque of the model (eq. 15), N m."""
        inertia = self.get("J") * view.acceleration
        return _frozen(self.friction(view) + inertia + self.get("offset"))

    def _level(self, view: View, names: tuple[str, str, str], viscous: str) -> Array:
        coulomb, static, omega = (self.get(n) for n in names)
        total = coulomb + self.get(viscous) * np.abs(view.velocity)
        if omega > 0.0:
            total = total + (static - coulomb) * _fall(view, omega, self.alpha)[1]
        return np.asarray(total)


@dataclass(frozen=True, eq=False)
class Nominal(NominalTorque):
    """Values of the nominal parameters.

    Instances are compared by identity, as keys of caches: hundreds of trial parameters use the same
    series of a recording.
    """

    values: Mapping[str, float]  # name to value, at the joint
    free: tuple[str, ...]  # names of the estimated parameters
    alpha: float  # Stribeck exponent
    # Load torque of identified effects that turn with the joint: coefficients of sin(angle),
    # cos(angle), angle and 1, N m. The gear transmits this torque like that of a declared load.
    undeclared: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    zero_A: float = 0.0  # zero offset of the logged current, from identified effects, A
    # Ripple of the torque constant, from identified effects: cycles per motor turn (and the number
    # of recordings, if each recording has its own origin of angles), and coefficients; empty
    # without ripple.
    ripple: tuple[tuple[float, ...], ...] = ()
    efficiency: float = 1.0  # efficiency of the transmission, from identified effects
    # Stribeck exponent of an identified effect that replaces `alpha` in derivatives with respect to
    # rises and Stribeck speeds; None without such an effect.
    fitted_alpha: float | None = None
    # Delay of the torque samples relative to the angle samples, from an identified effect, s; 0
    # without such an effect.
    late_s: float = 0.0
    # Presliding stiffness of friction, from an identified effect, N m/rad; 0 without such an
    # effect.
    presliding_stiffness: float = 0.0
    # Width of a play before friction, from an identified effect, rad; 0 without one.
    play: float = 0.0
    # Name of each static level to its greatest value by the recordings; empty for no limits.
    most: Mapping[str, float] = field(default_factory=dict)

    def without_effects(self) -> Nominal:
        """Return the values without those of identified effects that other effects depend on."""
        return replace(
            self, undeclared=(0.0, 0.0, 0.0, 0.0), zero_A=0.0, ripple=(), efficiency=1.0, play=0.0
        )

    def limited(self, views: Sequence[View]) -> Nominal:
        """Return the values with static levels limited to the greatest torque at a breakaway.

        Without these limits a fit may diverge in the static levels if no row is slow.
        """
        unloaded = [v for v in views if not v.loaded] or views
        most = {"Ms": max(float(np.max(np.abs(v.raw_torque))) for v in unloaded)}
        loaded = [
            float(np.max(np.abs(v.raw_torque))) / float(np.median(v.moment[v.moment != 0.0]))
            for v in views
            if v.loaded
        ]
        return replace(self, most={**most, **({"mu_s": max(loaded)} if loaded else {})})

    def at_most(self, step: Array) -> frozenset[str]:
        """Return the static levels at their limit that ``step`` would move beyond it."""
        return frozenset(
            name
            for name, change in zip(self.free, step, strict=True)
            if name in self.most
            and change > 0.0
            and self.get(name) >= (1.0 - _AT_LIMIT) * self.most[name]
        )

    def tangent(self, view: View) -> Array:
        """Return the torque's derivatives by the free parameters, shape (len(free), m)."""
        return np.stack([self._direction(view, name) for name in self.free])

    def moved(self, linear_step: Array, speed_step: Array, share: float = 1.0) -> Nominal:
        """Return the values after a step of the free parameters, within physical limits.

        Args:
            linear_step: Changes of the parameters in which the torque is linear, with fixed
                Stribeck speeds.
            speed_step: Changes of all parameters, of which only the changes of the Stribeck speeds
                are used. They are scaled by the ratio of the previous to the new rise.
            share: Share of the changes of the Stribeck speeds that is applied.
        """
        values = dict(self.values)
        for name, change in zip(self.free, (float(s) for s in linear_step), strict=True):
            if name in (*SPEEDS, *STATICS):
                continue
            values[name] = (
                values[name] + change if name == "offset" else max(0.0, values[name] + change)
            )
        for coulomb, static, _ in _RISES:
            if static in values:
                rise = self._rise(coulomb, static)
                if static in self.free:
                    rise += float(linear_step[self.free.index(static)])
                level = values[coulomb] + max(rise, LEAST_RISE * values[coulomb])
                values[static] = max(min(level, self.most.get(static, math.inf)), values[coulomb])
        for name in set(SPEEDS) & set(self.free):
            before = sum(self._rise(c, s) for c, s, speed in _RISES if speed == name)
            after = sum(
                values.get(s, 0.0) - values.get(c, 0.0) for c, s, speed in _RISES if speed == name
            )
            if before > 0.0 and after > 2.0 * LEAST_RISE * sum(
                values.get(c, 0.0) for c, _, w in _RISES if w == name
            ):
                change = share * float(speed_step[self.free.index(name)]) * before / after
                values[name] *= math.exp(max(-LARGEST_STEP, min(LARGEST_STEP, change)))
        return replace(self, values=values)

    def _rise(self, coulomb: str, static: str) -> float:
        return self.get(static) - self.get(coulomb)

    @property
    def flat(self) -> bool:
        """Whether the system friction does not fall with speed."""
        return self._rise("Mc", "Ms") < LEAST_FALL * self.get("Mc")

    def raised(self, omega_s: float, fixed: Collection[str]) -> Nominal:
        """Return the values with an assumed rise of static over Coulomb friction and the Stribeck
        speed ``omega_s``; all parameters except ``fixed`` are free.
        """
        values = dict(self.values)
        for coulomb, static, speed in _RISES:
            if static in values and static not in fixed:
                values[static] = (1.0 + RISE) * values[coulomb]
            if speed in values and speed not in fixed:
                values[speed] = omega_s
        return replace(self, values=values, free=tuple(n for n in values if n not in fixed))

    def _direction(self, view: View, name: str) -> Array:
        load = view.moment * view.sense
        if name == "J":
            return view.acceleration
        if name == "offset":
            return np.ones(len(view.time))
        if name == "sigma_2":
            return view.velocity
        if name == "mu_2":
            return np.asarray(view.moment * view.velocity)
        total = np.zeros(len(view.time))
        for scale, names in zip(
            (view.sense, load, view.sense * self.borne(view)), _RISES, strict=True
        ):
            if name in names and names[0] in self.values:
                total += scale * self._slope(view, name, names)
        return total

    def _slope(self, view: View, name: str, names: tuple[str, str, str]) -> Array:
        """Return the derivative of a level by Coulomb part, rise or log Stribeck speed."""
        coulomb, static, omega = (self.get(n) for n in names)
        if name == names[0]:
            return np.ones(len(view.time))
        if omega <= 0.0:
            return np.zeros(len(view.time))
        alpha = self.fitted_alpha or self.alpha
        power, fall = _fall(view, omega, alpha)
        return np.asarray(fall if name == names[1] else (static - coulomb) * fall * alpha * power)


def _unknown(view: View, undeclared: tuple[float, float, float, float]) -> Array:
    sine, cosine, slope, constant = undeclared
    return np.asarray(
        sine * np.sin(view.angle) + cosine * np.cos(view.angle) + slope * view.angle + constant
    )


@recent
def _fall(view: View, omega: float, alpha: float) -> tuple[Array, Array]:
    """Return |omega/omega_s|^alpha and exp(-|omega/omega_s|^alpha)."""
    power = _frozen((np.abs(view.velocity) / omega) ** alpha)
    return power, _frozen(np.exp(-power))


def _frozen(series: Array) -> Array:
    """Return the series, made read-only because several callers use it."""
    series.flags.writeable = False
    return series


def has_winding_voltage(view: View) -> bool:
    """Whether the voltage equation (eq. 1) can be computed from a recording."""
    bench = view.recording.bench
    known = (view.voltage, view.current, bench.resistance, bench.back_emf_constant)
    return all(value is not None for value in known)


def winding_voltage(view: View) -> Array:
    """Return R I + L dI/dt + Ke omega of the logged current, V (eq. 1); unknown: 0."""
    assert view.current is not None
    bench = view.recording.bench
    change = central_difference(view.current, view.step)
    resistive = (bench.resistance or 0.0) * view.current
    emf = (bench.back_emf_constant or 0.0) * view.motor_speed
    return np.asarray(resistive + (bench.inductance or 0.0) * change + emf)


def voltage_change(view: View) -> Array:
    """Return the change of the voltage over one sample period, V, shape (n,); zero for an averaged
    channel.

    A drive holds its voltage for one cycle, which may be before or after the time stamp. Unless the
    channel is declared as averaged, start and duration of this cycle are unknown; therefore the
    delay of the voltage is a parameter of the voltage equation.
    """
    assert view.voltage is not None
    if "voltage" in view.recording.averaged:
        return np.zeros(len(view.time))
    return central_difference(np.where(np.isnan(view.voltage), 0.0, view.voltage), 1.0)


def command_ripple(view: View) -> Array:
    """Return the acceleration of the command, rad/s^2 or m/s^2, shape (n,); zero without a command,
    or if voltage and current are averaged.

    A loop that receives a command at intervals changes the current in steps. With feed-forward the
    steps are in proportion to the acceleration of the command. If log and loop are synchronised,
    all samples are taken at one phase of the steps, so that their difference from the mean over a
    sample period is in proportion to this acceleration.
    """
    recording = view.recording
    command = recording.channels.get("command")
    if command is None or {"voltage", "current"} <= recording.averaged:
        return np.zeros(len(view.time))
    speed = central_difference(resample(recording.time, command, view.time), view.step)
    return central_difference(speed, view.step)


INSTANTS: Mapping[str, Callable[[View], Array]] = {"hold": voltage_change, "ripple": command_ripple}
"""Parameters that sampling at instants adds to the voltage equation, with their columns."""
