"""Campaigns on the simulated machine, with physics hidden in it, for tests of the diagnosis."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import record
from identification.diagnosis.joint import Joint, fit
from identification.estimate.default import free_names, solve_stages
from identification.prepare import prepare
from identification.recording import Array, Bench, Model, Recording
from identification.views.nominal import Nominal
from identification.views.view import views

CYCLE_S = 0.001
PAUSE_S = 2.0
BENCH = Bench(
    torque_constant=0.03,
    back_emf_constant=0.02588,
    resistance=1.56,
    inductance=0.00132,
    gear_ratio=100.0,
    moment_arm=0.095,
    lever_ratio=10.0,
)
CHANNELS = (
    "command",
    "motor_angle",
    "angle",
    "current",
    "voltage",
    "supply_voltage",
    "temperature",
)
PLAN = (
    (0.0, ((22.0, 0.2),), "fit"),
    (0.0, ((9.0, 0.7), (3.0, 2.3)), "fit"),
    (10.0, ((22.0, 0.2),), "fit"),
    (20.0, ((9.0, 0.7), (3.0, 2.3)), "fit"),
    (30.6, ((22.0, 0.2),), "fit"),
    (20.0, ((15.0, 0.35), (4.0, 1.3)), "validate"),
)
"""Weight in kg, tones as (deg, Hz) or a function of the duration, role."""
FEW = (*PLAN[:2], PLAN[3], PLAN[5])
"""Both motions, a weight and a recording set aside: enough for an effect, and quicker, since a
diagnosis takes its time by recording.
"""


def sines(tones: Sequence[tuple[float, float]], seconds: float) -> Array:
    time = np.arange(round(seconds / CYCLE_S)) * CYCLE_S
    ramp = np.clip(np.minimum(time, seconds - time), 0.0, 1.0)
    total = sum(np.deg2rad(a) * np.sin(2.0 * np.pi * f * time) for a, f in tones)
    return np.asarray(ramp**2 * (3.0 - 2.0 * ramp) * total)


def ladder(seconds: float) -> Array:
    """Return short moves after rests of several durations, in mixed order."""
    rng, place, forward, parts = np.random.default_rng(0), 0.0, 1.0, [np.zeros(100)]
    share = np.arange(500) / 500.0
    while sum(map(len, parts)) < seconds / CYCLE_S:
        parts.append(np.full(round(float(rng.choice((0.1, 0.2, 0.4, 0.8, 1.6))) / CYCLE_S), place))
        forward = -np.sign(place) if abs(place) > 0.3 else float(rng.choice((-forward, forward)))
        move = forward * np.deg2rad(rng.uniform(5.0, 9.0))
        parts.append(place + move * share**2 * (3.0 - 2.0 * share))
        place += move
    return np.concatenate(parts)[: round(seconds / CYCLE_S)]


def campaign(
    effects: Mapping[str, Mapping[str, float]],
    seed: int,
    seconds: float = 12.0,
    plan: Sequence[Any] = (),
) -> tuple[Recording, ...]:
    """Record a plan on a machine that hides ``effects``; the last campaigns are kept."""
    return _campaign(json.dumps(effects), seed, seconds, tuple(plan or PLAN))


@lru_cache(maxsize=24)
def _campaign(
    effects: str, seed: int, seconds: float, plan: tuple[Any, ...]
) -> tuple[Recording, ...]:
    machine = SimulatedMachine(
        Machine(effects=json.loads(effects), warming_K=10.0), np.random.default_rng(seed)
    )
    recordings, began = [], 0.0
    for number, (mass, tones, role) in enumerate(plan, 1):
        machine.hang(mass)
        machine.power(True)
        command = tones(seconds) if callable(tones) else sines(tones, seconds)
        samples = record(machine, command, CYCLE_S)
        machine.power(False)
        machine.rest(PAUSE_S)
        channels = {name: getattr(samples, name) for name in CHANNELS}
        channels["time"] = samples.time + began
        began += float(samples.time[-1]) + PAUSE_S
        recordings.append(
            Recording(
                name=f"r{number}",
                channels=channels,
                bench=BENCH,
                stage="loaded" if mass else "unloaded",
                weight_mass=mass,
                role=role,
                averaged=frozenset({"current", "voltage"}),
            )
        )
    return tuple(recordings)


SMOOTH = 15
"""Samples over which the speed of an added torque is averaged."""


def with_torque(
    recordings: Sequence[Recording], torque: Callable[[Array, Array, Array], Array]
) -> tuple[Recording, ...]:
    """Return recordings of which the current supplies one more torque: a function of angle, rad,
    speed, rad/s, and time, s, that acts against the motor, N m.
    """
    out = []
    for r in recordings:
        time, angle = r.channels["time"], r.channels["motor_angle"] / r.bench.gear_ratio
        speed = np.convolve(np.gradient(angle, time), np.ones(SMOOTH) / SMOOTH, "same")
        more = torque(angle, speed, time) / r.bench.ampere_torque
        out.append(replace(r, channels={**r.channels, "current": r.channels["current"] + more}))
    return tuple(out)


@lru_cache
def honest() -> tuple[Recording, ...]:
    """Return a campaign that hides nothing."""
    return campaign({}, 1)


class Same(tuple[Recording, ...]):
    """Recordings as the key of a cache: compared by identity."""

    def __hash__(self) -> int:
        return hash(tuple(map(id, self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and list(map(id, self)) == list(map(id, other))


def nominal_fit(recordings: Sequence[Recording], bandwidth_Hz: float = 25.0) -> Joint:
    """Fit the nominal model alone to those recordings that are to be fitted."""
    return _nominal_fit(Same(recordings), bandwidth_Hz)


@lru_cache(maxsize=32)
def _nominal_fit(recordings: Same, bandwidth_Hz: float) -> Joint:
    fitted = [r for r in recordings if r.role == "fit"]
    prepared = [prepare(r, bandwidth_Hz) for r in fitted]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    values, _ = solve_stages(unloaded, loaded, Model(), lambda _stage, _share: None)
    start = Nominal(values, free_names(values, Model()), 2.0)
    return fit(views(fitted, bandwidth_Hz, campaign=recordings), "N m", start)
