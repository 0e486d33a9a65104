"""Data types of recordings, in SI units, and of the bench on which recordings were made."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from identification.model.gas_generator import GasGenerator
from identification.model.parameters import (
    GEAR_PARAMETERS,
    LADDER,
    LOAD_PARAMETERS,
    SYSTEM_PARAMETERS,
    UNITS_ROTARY,
)
from identification.numerics.arrays import Array as Array

CHANNELS: Mapping[str, str] = {
    "time": "s",
    "voltage": "V",
    "supply_voltage": "V",
    "current": "A",
    "torque": "N m",
    "motor_angle": "rad",
    "angle": "rad",
    "velocity": "rad/s",
    "command": "rad",
    "feedforward": "1",
    "load_force": "N",
    "temperature": "deg C",
    "pressure": "Pa",
    "enabled": "1",
}
"""Canonical channels and their units on a rotary bench. On a linear bench m replaces rad and N
replaces N m; only the angle of the motor stays in rad.

``torque``, ``angle``, ``velocity`` and ``command`` are at the joint, after the gear;
``motor_angle``, ``current`` and ``voltage`` are at the motor; ``feedforward`` is added to the
controller's output and has the unit of this output.
"""


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the recording, the channel and the row."""


def not_one_of(name: str, value: object, words: Iterable[str]) -> list[str]:
    """Return what is wrong with a value that must be one of some words, or nothing."""
    known = tuple(words)
    return [] if value in known else [f"{name} must be {', '.join(known)} (got {value!r})"]


def refuse(place: str, wrong: Iterable[str]) -> None:
    """Raise an error with all that is wrong at a place, if anything is.

    Raises:
        RecordingError: Something is wrong.
    """
    if words := "; ".join(wrong):
        raise RecordingError(f"{place}: {words}")


@dataclass(frozen=True)
class Bench:
    """Known constants of the machine on which a recording was made.

    Attributes:
        motion: ``rotary`` (rad, N m) or ``linear`` (m, N).
        torque_constant: Km, N m/A at the motor shaft, or None if the recordings have a torque
            channel or the fit is in amperes.
        back_emf_constant: Ke, V s/rad of the motor shaft.
        resistance: R, ohm.
        inductance: L, H.
        supply_voltage: Voltage of the supply without load, V, or None if unknown.
        gear_ratio: i, motor turns per joint turn (assumption 5, theta = i theta_r); on a linear
            bench rad/m.
        moment_arm: L1, m (eq. 13).
        lever_ratio: L3/L4 (eq. 17).
        gravity: Local acceleration of free fall, m/s^2.
        gas_generator: Nominal constants of the valve (Fig. 3), the downstream pressure and the gas
            generator (eq. 2 to 8); needed for hot firings only.
    """

    motion: Literal["rotary", "linear"] = "rotary"
    torque_constant: float | None = None
    back_emf_constant: float | None = None
    resistance: float | None = None
    inductance: float | None = None
    supply_voltage: float | None = None
    gear_ratio: float = 1.0
    moment_arm: float | None = None
    lever_ratio: float = 10.0
    gravity: float = 9.80665
    gas_generator: GasGenerator | None = None

    @property
    def ampere_torque(self) -> float:
        """Joint torque of one motor ampere, Km i; 1 with unknown Km, for a fit in amperes."""
        return 1.0 if self.torque_constant is None else self.torque_constant * self.gear_ratio

    def contact_force(self, weight_mass: float) -> float:
        """Contact force F'_P = (L3/L4) m_w g of the lever-weight device, N (eq. 17)."""
        return self.lever_ratio * weight_mass * self.gravity


@dataclass(frozen=True)
class Pendulum:
    """A known weight that turns with the joint: torque -m g l sin(angle - zero), inertia m l^2.

    Attributes:
        mass: kg.
        length: m, from the axis to the centre of mass.
        zero: rad, the joint angle at which the weight hangs straight down.
    """

    mass: float
    length: float
    zero: float = 0.0

    @property
    def inertia(self) -> float:
        """Inertia m l^2 about the joint, kg m^2."""
        return self.mass * self.length**2

    def moment(self, gravity: float) -> float:
        """Return the greatest torque m g l, N m, with ``gravity`` in m/s^2."""
        return self.mass * gravity * self.length

    def torque(self, angle: Array, gravity: float) -> Array:
        """Return the weight's torque on the joint at ``angle``, N m, with ``gravity`` in m/s^2."""
        return np.asarray(-self.moment(gravity) * np.sin(angle - self.zero))


@dataclass(frozen=True)
class Hoist:
    """A known mass that the joint lifts when it moves forward: torque -m g r, inertia m r^2.

    Attributes:
        mass: kg.
        radius: m, of the drum or pulley; negative where forward motion lowers the mass. On a
            linear bench 1 or -1.
    """

    mass: float
    radius: float = 1.0

    @property
    def inertia(self) -> float:
        """Inertia m r^2 about the joint, kg m^2."""
        return self.mass * self.radius**2

    def torque(self, gravity: float) -> float:
        """Return the mass's torque on the joint, N m, with ``gravity`` in m/s^2."""
        return -self.mass * gravity * self.radius


@dataclass(frozen=True)
class Controller:
    """The position loop in which a recording was made: output = clip(kp (command - angle) - kv
    velocity, limit).

    Attributes:
        output: ``duty`` (share of the supply voltage), ``voltage`` (V at the motor) or ``torque``
            (N m at the joint).
        position_gain: kp, output per rad.
        velocity_gain: kv, output per rad/s.
        limit: Greatest magnitude of the output, or None if it is not limited.
    """

    output: Literal["duty", "voltage", "torque"]
    position_gain: float
    velocity_gain: float = 0.0
    limit: float | None = None

    def __post_init__(self) -> None:
        """Check the kind of the output.

        Raises:
            RecordingError: It is unknown.
        """
        refuse("controller", not_one_of("output", self.output, ("duty", "voltage", "torque")))


@dataclass(frozen=True)
class Model:
    """What is fitted: the nine nominal parameters, those that are fixed, bounded, or known with an
    uncertainty, and declared terms.

    Attributes:
        terms: Catalogue names of the effects that the bench is declared to have, or ``offset``;
            declared terms are fitted, and a diagnosis does not report them.
        fixed: Parameters that are not fitted: name to value.
        priors: Parameters known with an uncertainty: name to value and standard deviation.
        alpha: Stribeck exponent (eq. 9), 2 in eq. 13.
        friction: Model of :data:`identification.model.parameters.LADDER` that is fitted to the
            unloaded recordings.
        bounds: Parameters known to be in a range: name to lowest and greatest value, each
            infinite where there is no limit. An estimate beyond its bound is set to the bound, and
            the other parameters are fitted again with this value; no interval exceeds a bound.

    >>> Model(fixed={"J": 0.2}, bounds={"sigma_2": (0.0, 10.0)}, friction="coulomb_viscous").free
    ('Mc', 'sigma_2', 'mu_c', 'mu_s', 'omega_sL', 'mu_2')
    """

    terms: tuple[str, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    alpha: float = 2.0
    friction: str = "stribeck"
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the names and the bounds.

        Raises:
            RecordingError: A name is unknown, a parameter is both fixed and bounded or known with
                an uncertainty, or a bound or an uncertainty is none.
        """
        wrong = not_one_of("friction", self.friction, LADDER)
        unknown = {*self.fixed, *self.priors, *self.bounds} - UNITS_ROTARY.keys()
        if unknown:
            known = ", ".join(UNITS_ROTARY)
            wrong.append(f"unknown {', '.join(sorted(unknown))}; the parameters are {known}")
        if both := self.fixed.keys() & {*self.priors, *self.bounds}:
            wrong.append(f"{', '.join(sorted(both))}: either fixed, or bounded or with a prior")
        for name, (low, high) in self.bounds.items():
            if not low < high:
                wrong.append(f"bounds of {name}: the lower must be below the upper ({low}, {high})")
        for name, (_, deviation) in self.priors.items():
            if not 0.0 < deviation < math.inf:
                wrong.append(f"prior of {name}: its deviation must be above 0 (got {deviation})")
        refuse("model", wrong)

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that a fit estimates; the load's only if one is loaded."""
        own = {*LADDER[self.friction], "J", *LOAD_PARAMETERS}
        own |= {"omega_sf"} if "Ms" in own else set()
        own |= {"offset"} & {*self.terms}
        order = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS, *GEAR_PARAMETERS, "offset")
        return tuple(n for n in order if n in own and n not in self.fixed)


@dataclass(frozen=True, init=False)
class Recording:
    """Channels of one excitation under one load, evenly or unevenly sampled.

    Signals are anything that numpy makes an array of: arrays, lists, columns of pandas or xarray;
    time may be stamps (``datetime64``). A whole table is given as ``channels``: its columns have
    the names of :data:`CHANNELS`; the time may be its index or coordinate ``time``.

    >>> t = np.linspace(0.0, 1.0, 101)
    >>> one = Recording(t, angle=np.sin(t), torque=np.cos(t))
    >>> sorted(one.channels), round(one.period, 6)
    (['angle', 'time', 'torque'], 0.01)
    >>> Recording(channels={"time": t, "angle": np.sin(t)}, weight_mass=30.6, name="b").stage
    'loaded'

    Attributes:
        name: Short name for tables and legends.
        channels: Canonical name to samples, shape (n,), SI units; always holds ``time``, strictly
            increasing. NaN marks samples that were not measured (``voltage`` while the power stage
            is off).
        bench: Constants of the machine.
        stage: ``unloaded`` or ``loaded``; unless stated, ``loaded`` with a weight or a measured
            force.
        weight_mass: m_w on the lever, kg; 0 in a hot firing, where gas pressure loads the valve.
        pendulum: Known weight that turns with the joint, or None.
        hoist: Known mass that the joint lifts, or None.
        constant_torque: Known constant torque on the joint, N m; a positive torque drives the joint
            forward.
        controller: Position loop in which the recording was made, or None if unknown; needed for
            simulations only.
        role: ``fit``; ``validate``, for a recording that tests the effects of a diagnosis and is
            not fitted; or ``unused``, for a recording of which only the duration is used.
        averaged: Channels whose samples are means over the period that ends at their time.
        source: File from which the samples were read.
        sha256: SHA-256 digest of that file.
        notes: Statement of each correction made on reading.
        partial: Whether the run stopped before the end of the command of this recording.
        start: Session time of the first sample, s, or None if only the recording's own time stamps
            are known.
        session: Name of the session, if a dataset has recordings of several; each session has a
            clock of its own, at whose zero the machine was cold.
        unit: Name of the machine, if a dataset has recordings of several of one kind.
        uncertainties: Standard deviations of known constants, by their place in this record
            (``bench.torque_constant``, ``pendulum.mass``, ``weight_mass``); constants that are not
            listed count as exact.
    """

    name: str
    channels: Mapping[str, Array]
    bench: Bench
    stage: Literal["unloaded", "loaded"]
    weight_mass: float
    pendulum: Pendulum | None
    hoist: Hoist | None
    constant_torque: float
    controller: Controller | None
    role: Literal["fit", "validate", "unused"]
    averaged: frozenset[str]
    source: str
    sha256: str
    notes: tuple[str, ...]
    partial: bool
    start: float | None
    session: str
    unit: str
    uncertainties: Mapping[str, float]

    def __init__(
        self,
        time: ArrayLike | None = None,
        angle: ArrayLike | None = None,
        current: ArrayLike | None = None,
        *,
        torque: ArrayLike | None = None,
        voltage: ArrayLike | None = None,
        supply_voltage: ArrayLike | None = None,
        motor_angle: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        command: ArrayLike | None = None,
        feedforward: ArrayLike | None = None,
        load_force: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        pressure: ArrayLike | None = None,
        enabled: ArrayLike | None = None,
        channels: Any = None,
        name: str = "recording",
        bench: Bench | None = None,
        stage: Literal["unloaded", "loaded"] | None = None,
        weight_mass: float = 0.0,
        pendulum: Pendulum | None = None,
        hoist: Hoist | None = None,
        constant_torque: float = 0.0,
        controller: Controller | None = None,
        role: Literal["fit", "validate", "unused"] = "fit",
        averaged: Iterable[str] = (),
        source: str = "",
        sha256: str = "",
        notes: tuple[str, ...] = (),
        partial: bool = False,
        start: float | None = None,
        session: str = "",
        unit: str = "",
        uncertainties: Mapping[str, float] | None = None,
    ) -> None:
        """Take signals by the names and in the units of :data:`CHANNELS`, or as a table
        ``channels``; the other arguments are the attributes.

        Raises:
            RecordingError: A channel is unknown, its length differs from that of the time, time
                does not increase, or another argument is not what it must be.
        """
        given = dict(locals())  # the arguments by name
        table = {} if channels is None else {str(n): channels[n] for n in channels}
        if channels is not None and "time" not in table:
            # xarray lists coordinates apart from the variables, pandas an index apart from columns.
            index = getattr(channels, "index", None)
            own = {"time": index} if getattr(index, "name", None) == "time" else {}
            table |= {n: v for n, v in getattr(channels, "coords", own).items() if n == "time"}
        table |= {n: given[n] for n in CHANNELS if given[n] is not None}
        series = {n: _series(name, n, values) for n, values in table.items()}
        pressed = "load_force" in series and bool(np.any(series["load_force"] != 0.0))
        given |= {
            "channels": series,
            "bench": bench or Bench(),
            "stage": stage or ("loaded" if weight_mass > 0.0 or pressed else "unloaded"),
            "averaged": frozenset(averaged),
            "uncertainties": uncertainties or {},
        }
        for item in dataclasses.fields(self):
            object.__setattr__(self, item.name, given[item.name])
        self._check()

    def _check(self) -> None:
        wrong = not_one_of("role", self.role, ("fit", "validate", "unused"))
        wrong += not_one_of("stage", self.stage, ("unloaded", "loaded"))
        refuse(self.name, wrong)
        if "time" not in self.channels:
            raise RecordingError(f"{self.name}: no channel 'time'")
        n = len(self.channels["time"])
        if n < 2:
            raise RecordingError(f"{self.name}: {n} samples; at least 2 are needed")
        for channel, values in self.channels.items():
            if channel not in CHANNELS:
                raise RecordingError(
                    f"{self.name}: unknown channel {channel!r}; the known channels are "
                    f"{', '.join(CHANNELS)}"
                )
            if values.shape != (n,):
                raise RecordingError(
                    f"{self.name}: channel {channel!r} has shape {values.shape}, time has ({n},)"
                )
        steps = np.diff(self.channels["time"])
        bad = np.flatnonzero(~(steps > 0))
        if bad.size:
            row = int(bad[0]) + 1
            raise RecordingError(
                f"{self.name}: time does not increase at sample {row} (step {steps[row - 1]:.6g} s)"
            )

    @property
    def time(self) -> Array:
        """Time stamps, s, shape (n,)."""
        return self.channels["time"]

    @cached_property
    def period(self) -> float:
        """Median sample period, s."""
        return float(np.median(np.diff(self.time)))

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of the recording, s: session time if known, else its time stamps."""
        first, last = float(self.time[0]), float(self.time[-1])
        return (first, last) if self.start is None else (self.start, self.start + last - first)

    @property
    def known_load(self) -> bool:
        """Whether a known torque other than the drive's acts on the joint."""
        return self.pendulum is not None or self.hoist is not None or self.constant_torque != 0.0

    @property
    def known_inertia(self) -> float:
        """Inertia of the known weights about the joint, kg m^2."""
        return sum((w.inertia for w in (self.pendulum, self.hoist) if w is not None), 0.0)

    @property
    def steady_torque(self) -> float:
        """Known torque on the joint that is the same at every angle, N m."""
        lifted = 0.0 if self.hoist is None else self.hoist.torque(self.bench.gravity)
        return self.constant_torque + lifted

    def known_torque(self, angle: Array) -> Array:
        """Return the torque of the known loads on the joint at ``angle``, N m, shape (n,)."""
        steady = np.full(len(angle), self.steady_torque)
        return (
            steady
            if self.pendulum is None
            else (steady + self.pendulum.torque(angle, self.bench.gravity))
        )

    @property
    def hot_fire(self) -> bool:
        """Whether a gas generator, and not a weight, loads the valve."""
        return self.stage == "loaded" and self.weight_mass == 0.0 and "pressure" in self.channels

    @property
    def contact_force(self) -> float:
        """Contact force F'_P of the weight, N (eq. 17)."""
        return self.bench.contact_force(self.weight_mass)


def _series(recording: str, channel: str, values: Any) -> Array:
    """Return the samples of a channel, or seconds since the first of its time stamps."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64:
        return values
    given = np.asarray(values)
    if given.dtype.kind in "mM":
        return np.asarray((given - given[:1]) / np.timedelta64(1, "s"))
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordingError(
            f"{recording}: channel {channel!r} must be numbers (got {given.dtype}): {error}"
        ) from error


@dataclass(frozen=True, init=False)
class Dataset:
    """Recordings of one bench and the model to be fitted to them.

    Attributes:
        recordings: The recordings.
        model: The model.
        tables: Tables that list the recordings: file to SHA-256.
    """

    recordings: tuple[Recording, ...]
    model: Model
    tables: Mapping[str, str]

    def __init__(
        self,
        recordings: Recording | Iterable[Recording],
        model: Model | None = None,
        tables: Mapping[str, str] | None = None,
    ) -> None:
        """Take one recording or several."""
        several = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
        for name, value in (
            ("recordings", several),
            ("model", model or Model()),
            ("tables", tables or {}),
        ):
            object.__setattr__(self, name, value)

    def part(self, role: Literal["fit", "validate"]) -> tuple[Recording, ...]:
        """Return the recordings of one role."""
        return tuple(r for r in self.recordings if r.role == role)
