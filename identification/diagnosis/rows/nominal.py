"""The nominal nine parameters at the full rate: torque, friction level and tangent, for regressors
and joint refits.

Written with the rise dM = Ms - Mc and log omega_s, which keep a joint fit in the right basin.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from identification.diagnosis.rows.view import View
from identification.model.parameters import STRIBECK_TERMS as _RISES
from identification.recording import Array

RISE = 0.5
"""Static over Coulomb friction, less one, where a rise is only supposed."""
LARGEST_STEP = 0.4
"""Greatest change of log omega_s in one iteration."""
_AT_LIMIT = 1e-9
KEPT = 128
"""Series of one kind that are kept, of a recording at nominal values."""
LEAST_RISE = 1e-6
"""Of static over Coulomb friction, over the latter."""
LEAST_FALL = 1e-3
"""The same, below which friction does not fall."""
STATICS, SPEEDS = tuple(r[1] for r in _RISES), ("omega_sf", "omega_sL")


@dataclass(frozen=True, eq=False)
class Nominal:
    """Values of the nominal parameters.

    Each is its own key: hundreds of trial shapes are built from what it says of a recording, which
    is kept meanwhile.

    Attributes:
        values: Name to value, at the joint.
        free: Names that the recordings are asked for.
        alpha: Stribeck exponent.
        hidden: Torque that turns with the joint and was not declared, as effects named so far say:
            coefficients of sin(angle), cos(angle), angle and 1, N m. The gear bears it like a
            declared one.
        zero_A: What the logged current reads without any, as effects named so far say, A.
        ripple: Of the motor's torque over its current, as effects named so far say: cycles a motor
            turn (and how many recordings, where each has an origin of its own), and coefficients;
            none where it is empty.
        efficiency: Share of the torque that the transmission passes, as effects named so far say.
        bent: Stribeck exponent that an effect named so far puts in the place of ``alpha``, or None:
            how torque changes with a rise or a speed is then said by it.
        late_s: By how much the torque's samples are late against the angles', as an effect named so
        far says, or 0.
        bristles: Stiffness that friction springs by before it slips, as an effect named so far
        says, N m/rad; or 0.
        most: Greatest static levels that the recordings allow; none where it is empty.
    """

    values: Mapping[str, float]
    free: tuple[str, ...]
    alpha: float
    hidden: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    zero_A: float = 0.0
    ripple: tuple[tuple[float, ...], ...] = ()
    efficiency: float = 1.0
    bent: float | None = None
    late_s: float = 0.0
    bristles: float = 0.0
    most: Mapping[str, float] = field(default_factory=dict)

    def limited(self, views: Sequence[View]) -> Nominal:
        """Return these values with static friction limited by the torque that was there to overcome
        it.

        Where no row is slow enough to tell, a fit may let it run off.
        """
        unloaded = [v for v in views if not v.loaded] or views
        most = {"Ms": max(float(np.max(np.abs(v.raw_torque))) for v in unloaded)}
        loaded = [
            float(np.max(np.abs(v.raw_torque))) / float(np.median(v.moment))
            for v in views
            if v.loaded
        ]
        return replace(self, most={**most, **({"mu_s": max(loaded)} if loaded else {})})

    def at_most(self, step: Array) -> frozenset[str]:
        """Return static levels that stand at their limit and would be moved beyond it."""
        return frozenset(
            name
            for name, change in zip(self.free, step, strict=True)
            if name in self.most
            and change > 0.0
            and self.get(name) >= (1.0 - _AT_LIMIT) * self.most[name]
        )

    def get(self, name: str) -> float:
        """Return a value; 0 where the bench has no such parameter."""
        return float(self.values.get(name, 0.0))

    def level(self, view: View) -> Array:
        """Return the system friction's magnitude, eq. 9, N m.

        Where load-dependent friction is declared, with what the gear adds under a weight that turns
        with the joint.
        """
        total = self._level(view, _RISES[0], "sigma_2")
        return total + self.borne(view) * self.gear(view) if self._geared else total

    @property
    def _geared(self) -> bool:
        """Whether load-dependent friction is declared."""
        return any(self.get(name) for name in _RISES[2][:2])

    def gear(self, view: View) -> Array:
        """Return the coefficient of declared load-dependent friction, 0 where none is declared."""
        return self._level(view, _RISES[2], "")

    def coefficient(self, view: View) -> Array:
        """Return the magnitude of m_L, eq. 12."""
        return self._level(view, _RISES[1], "mu_2")

    def borne(self, view: View) -> Array:
        """Return the magnitude of the torque that turns with the joint and that the gear bears, N
        m.

        A weight's own: what its inertia takes loads no gear in eq. 9, in the ladder of friction or
        on the bench.
        """
        return _borne(view, self.hidden)

    def helping(self, view: View) -> Array:
        """Return the torque that turns with the joint, declared or hidden, where it helps the drive
        positive, N m.
        """
        if not any(self.hidden):
            return view.known
        return _helping(view, self.hidden)

    def helped(self, view: View) -> bool:
        """Whether any torque turns with the joint."""
        return any(self.hidden) or view.burdened

    def drive(self, view: View) -> Array:
        """Return the whole torque that is asked of the drive, N m: what turns with the joint is
        part of it.
        """
        return _drive(self, view)

    def falling(self, view: View) -> Array:
        """Return exp(-|omega/omega_s|^alpha), the weight of static friction at the view's speed."""
        omega_s = self.get("omega_sf")
        if omega_s <= 0.0:
            return np.zeros(len(view.velocity))
        return np.asarray(np.exp(-(np.abs(view.velocity / omega_s) ** self.alpha)))

    def friction(self, view: View) -> Array:
        """Return friction with its sign, eq. 9 + 13, N m."""
        return _friction(self, view)

    def torque(self, view: View) -> Array:
        """Return what eq. 15 says the torque should be, N m."""
        return _torque(self, view)

    def tangent(self, view: View) -> Array:
        """Return the torque's derivatives by the free directions, shape (len(free), m)."""
        return np.stack([self._direction(view, name) for name in self.free])

    def moved(self, straight: Array, bend: Array, share: float = 1.0) -> Nominal:
        """Return the values after a step along the free directions, kept physical.

        Args:
            straight: Changes of what the torque is linear in, with the Stribeck speeds as they are.
            bend: Changes with those free as well, of which only those of the speeds count. A
                direction of a speed is as long as its rise was; the rise that was found takes its
                place.
            share: Of the speeds' changes that is taken.
        """
        values = dict(self.values)
        for name, change in zip(self.free, (float(s) for s in straight), strict=True):
            if name in (*SPEEDS, *STATICS):
                continue
            values[name] = (
                values[name] + change if name == "offset" else max(0.0, values[name] + change)
            )
        for coulomb, static, _ in _RISES:
            if static in values:
                rise = self._rise(coulomb, static)
                if static in self.free:
                    rise += float(straight[self.free.index(static)])
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
                change = share * float(bend[self.free.index(name)]) * before / after
                values[name] *= math.exp(max(-LARGEST_STEP, min(LARGEST_STEP, change)))
        return replace(self, values=values)

    def _rise(self, coulomb: str, static: str) -> float:
        return self.get(static) - self.get(coulomb)

    @property
    def flat(self) -> bool:
        """Whether the system's friction does not fall."""
        return self._rise("Mc", "Ms") < LEAST_FALL * self.get("Mc")

    def raised(self, omega_s: float, fixed: Collection[str]) -> Nominal:
        """Return these values with friction that falls from half as much again by a speed, all but
        ``fixed`` free.
        """
        values = dict(self.values)
        for coulomb, static, speed in _RISES:
            if static in values and static not in fixed:
                values[static] = (1.0 + RISE) * values[coulomb]
            if speed in values and speed not in fixed:
                values[speed] = omega_s
        return replace(self, values=values, free=tuple(n for n in values if n not in fixed))

    def _level(self, view: View, names: tuple[str, str, str], viscous: str) -> Array:
        coulomb, static, omega = (self.get(n) for n in names)
        total = coulomb + self.get(viscous) * np.abs(view.velocity)
        if omega > 0.0:
            total = total + (static - coulomb) * _fall(view, omega, self.alpha)[1]
        return np.asarray(total)

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
        """Return the derivative of one level by its Coulomb part, its rise or the logarithm of its
        Stribeck speed.
        """
        coulomb, static, omega = (self.get(n) for n in names)
        if name == names[0]:
            return np.ones(len(view.time))
        if omega <= 0.0:
            return np.zeros(len(view.time))
        alpha = self.bent or self.alpha
        power, fall = _fall(view, omega, alpha)
        return np.asarray(fall if name == names[1] else (static - coulomb) * fall * alpha * power)


@lru_cache(maxsize=KEPT)
def _helping(view: View, hidden: tuple[float, float, float, float]) -> Array:
    return _frozen(view.known - _unknown(view, hidden))


@lru_cache(maxsize=KEPT)
def _borne(view: View, hidden: tuple[float, float, float, float]) -> Array:
    return _frozen(np.abs(view.hanging - _unknown(view, hidden) if any(hidden) else view.hanging))


def _unknown(view: View, hidden: tuple[float, float, float, float]) -> Array:
    sine, cosine, slope, constant = hidden
    return np.asarray(
        sine * np.sin(view.angle) + cosine * np.cos(view.angle) + slope * view.angle + constant
    )


@lru_cache(maxsize=KEPT)
def _fall(view: View, omega: float, alpha: float) -> tuple[Array, Array]:
    """Return (|omega/omega_s|^alpha, exp of less that): a level and its slopes share them."""
    power = _frozen((np.abs(view.velocity) / omega) ** alpha)
    return power, _frozen(np.exp(-power))


@lru_cache(maxsize=KEPT)
def _friction(nominal: Nominal, view: View) -> Array:
    total = nominal.level(view)
    if view.loaded:
        total = total + view.moment * nominal.coefficient(view)
    return _frozen(view.sense * total)


@lru_cache(maxsize=KEPT)
def _torque(nominal: Nominal, view: View) -> Array:
    return _frozen(
        nominal.friction(view) + nominal.get("J") * view.acceleration + nominal.get("offset")
    )


@lru_cache(maxsize=KEPT)
def _drive(nominal: Nominal, view: View) -> Array:
    return _frozen(nominal.torque(view) - nominal.helping(view))


def _frozen(series: Array) -> Array:
    """Return a series that many share, which nobody may change."""
    series.flags.writeable = False
    return series
