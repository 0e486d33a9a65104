"""Predictions of a fitted model with 90 % bands: its response in a position loop or to a torque,
and the torque that a recorded motion requires; where they leave what was recorded.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

from identification.effects.model import CorrectedModel, views_for
from identification.numerics.arrays import Array, BoolArray
from identification.numerics.spread import CONFIDENCE, NO_SPREAD, Spread, quantile
from identification.prepare import contact_moment, default_bandwidth
from identification.recording import Recording
from identification.simulation.closed_loop import Response, replay
from identification.views.view import View, forget

T = TypeVar("T")
Given = Literal["command", "torque", "motion"]
SIGNALS = ("angle", "velocity", "torque")
KEPT = frozenset({"supply_voltage", "temperature", "load_force", "pressure", "command"})
"""Channels of a recording that its simulated response has too."""
ROUNDS, STILL = 30, 1e-3
"""Greatest number of simulations in which the torque of effects is found that depends on the motion
it causes, and change of this torque, relative to its greatest, at which it counts as found.
"""
LEAST_SHARE = 0.05
"""Least share of its value that a drawn parameter has which is positive by its nature."""


@dataclass(frozen=True)
class Fitted:
    """A model with what is known of its errors.

    Attributes:
        model: Nominal parameters, effects and curve.
        covariance: Covariance of its parameters.
        noise: Standard deviation of what the model leaves of a measured signal, by its name.
        ranges: Least and greatest value of ``angle``, ``velocity`` and ``moment`` in the recordings
            that were fitted; empty if they are not known.
        bandwidth_Hz: Bandwidth of the fit, or None for the default of a recording.
    """

    model: CorrectedModel
    covariance: Spread = NO_SPREAD
    noise: Mapping[str, float] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    bandwidth_Hz: float | None = None

    def changed(self, values: Mapping[str, float]) -> Fitted:
        """Return the model with other values of some parameters, which then count as exact."""
        kept = self.covariance.only([n for n in self.covariance.names if n not in values])
        return dataclasses.replace(self, model=self.model.changed(values), covariance=kept)

    def of_every_recording(self) -> tuple[Fitted, str]:
        """Return the model without effects of one recording, and their names."""
        model = self.model
        lost = [n for n in model.effects if model.catalogue[n].place is not None]
        kept = {n: own for n, own in model.effects.items() if n not in lost}
        names = [n for n in self.covariance.names if n.partition(".")[0] not in lost]
        left = dataclasses.replace(model, effects=kept)
        return dataclasses.replace(
            self, model=left, covariance=self.covariance.only(names)
        ), ", ".join(lost)

    def draws(self, count: int, rng: np.random.Generator) -> Iterator[CorrectedModel]:
        """Yield models whose parameters are drawn from the covariance; none without one."""
        names, freedom = self.covariance.names, self.covariance.freedom
        if not names:
            return
        scale, vectors = np.linalg.eigh(self.covariance.matrix)
        root = vectors * np.sqrt(np.maximum(scale, 0.0))
        middle = self.model.values
        for _ in range(count):
            tail = 1.0 if freedom == math.inf else math.sqrt(freedom / rng.chisquare(freedom))
            step = tail * root @ rng.standard_normal(len(names))
            drawn = {}
            for name, change in zip(names, step, strict=True):
                effect, _, own = name.rpartition(".")
                least, most = LEAST_SHARE * abs(middle[name]), math.inf
                if effect:
                    least, most = self.model.catalogue[effect].physical_range(own)
                elif name == "offset":
                    least = -math.inf
                drawn[name] = min(max(middle[name] + change, least), most)
            yield self.model.changed(drawn)


@dataclass(frozen=True)
class Simulation:
    """A predicted response, shape (n,) each, SI, at the joint.

    Attributes:
        given: What was given: ``command``, ``torque`` or ``motion``.
        time: s.
        angle: rad.
        velocity: rad/s.
        torque: Torque of the drive, N m. Of a given motion it is that at the bandwidth of the fit,
            and NaN at rest, where friction may have any value up to its limit.
        low: Lower end of the 90 % band of each signal by its name, of a motion that of the torque
            alone: from the covariance of the parameters and the noise of the model. The noise of
            a torque is that at the bandwidth of the fit, so that a response has none of the noise
            above it; a velocity has no noise.
        high: Upper end of this band.
        outside: Samples at which angle, velocity or load are outside the recordings of the fit.
        warnings: What the response lacks, and which ranges it leaves.
        measured: The measured torque of a given motion at the bandwidth of ``torque``; None if it
            was not measured.
    """

    given: Given
    time: Array
    angle: Array
    velocity: Array
    torque: Array
    low: Mapping[str, Array]
    high: Mapping[str, Array]
    outside: BoolArray
    warnings: tuple[str, ...] = ()
    measured: Array | None = None


def predict(
    fitted: Fitted,
    recording: Recording,
    given: Given | None = None,
    *,
    draws: int = 100,
    rng: np.random.Generator,
    seen: View | None = None,
) -> Simulation:
    """Predict the response of a model to what a recording gives.

    Args:
        fitted: The model.
        recording: Its ``command`` and ``controller`` give a position loop; its ``torque`` or
            ``current`` drives the joint; or its ``angle`` or ``velocity`` is the motion whose
            torque is predicted. A response starts from rest at the first angle, or without an
            angle at the first command.
        given: Which of these; None for the first that the recording has, but a torque only without
            a motion.
        draws: Number of parameter sets from which the band is made; 0 for the band of the noise
            alone.
        rng: Random generator of these draws.
        seen: View of a given motion among other recordings, at the bandwidth of the fit; None for
            that of the recording alone, on a cold machine.

    Raises:
        RecordingError: The recording does not have what is asked for.
    """
    channels = recording.channels
    moves = bool({"angle", "motor_angle", "velocity"} & channels.keys())
    if given is None:
        looped = recording.controller is not None and "command" in channels
        given = "command" if looped else "motion" if moves else "torque"
    if given == "motion":
        return _required(fitted, recording, draws, rng, seen)

    def run(model: CorrectedModel, disturbance: Array | float = 0.0) -> Response:
        driven = given == "torque"
        return replay(
            recording, model.parameters, model.alpha, driven=driven, disturbance=disturbance
        )

    middle, disturbance, warnings = _with_effects(fitted.model, recording, run)
    view = _view_of(fitted.model, recording, middle) if fitted.model.effects else None

    def other(model: CorrectedModel) -> Response:
        return run(model, disturbance if view is None else _disturbance(model, view, middle.time))

    others = _drawn(fitted, draws, rng, other)
    bands = {n: _band(getattr(middle, n), [getattr(o, n) for o in others]) for n in SIGNALS}
    moment = contact_moment(recording, recording.time, middle.angle)
    return _simulation(fitted, given, middle, bands, moment, warnings)


def _with_effects(
    model: CorrectedModel, recording: Recording, run: Callable[..., Response]
) -> tuple[Response, Array | float, list[str]]:
    """Return the response with the effects, their torque on the joint, and warnings.

    The effects' torque depends on the motion that it changes; it is computed from the last
    response, and the response with it, until it no longer changes (waveform relaxation).
    """
    found, disturbance = run(model), np.zeros(len(recording.time))
    if not model.effects and model.curve is None:
        return found, disturbance, []
    acting = {r.effect.name for r in model.responses("torque")}
    lost = ", ".join(name for name in model.effects if name not in acting)
    warnings = [f"the response is without {lost}: no torque on the joint"] if lost else []
    for _ in range(ROUNDS):
        before, disturbance = (
            disturbance,
            _disturbance(model, _view_of(model, recording, found), found.time),
        )
        found = run(model, disturbance)
        change = float(np.max(np.abs(disturbance - before)))
        if change <= STILL * float(np.max(np.abs(disturbance))):
            return found, disturbance, warnings
    warnings.append(
        "the torque of the effects and the motion do not settle on each other (last change "
        f"{change:.2g} N m): near rest the response is approximate"
    )
    return found, disturbance, warnings


def _view_of(model: CorrectedModel, recording: Recording, found: Response) -> View:
    """Return the signals of a response as those of a recording."""
    bench = recording.bench
    own = {
        "time": found.time,
        "angle": found.angle,
        "motor_angle": bench.gear_ratio * found.angle,
        "torque": found.torque,
        "current": found.torque / bench.ampere_torque,
    }
    beside = {n: v for n, v in recording.channels.items() if n in KEPT}
    made = dataclasses.replace(recording, channels={**beside, **own}, averaged=frozenset())
    return views_for([made], default_bandwidth(made), model)[0]


def _disturbance(model: CorrectedModel, view: View, time: Array) -> Array:
    """Return the torque on the joint by effects and curve, N m, at ``time``."""
    return np.asarray(-np.interp(time, view.time, model.added_torque(view)))


def _required(
    fitted: Fitted,
    recording: Recording,
    draws: int,
    rng: np.random.Generator,
    seen: View | None,
) -> Simulation:
    """Return the torque that the recorded motion requires, at the bandwidth of the fit."""
    bench, known = recording.bench, {"torque", "current", "voltage"} & recording.channels.keys()
    if bench.resistance is None or bench.back_emf_constant is None:
        known.discard("voltage")
    if not known:
        nothing = {"torque": np.zeros(len(recording.time))}
        recording = dataclasses.replace(recording, channels={**recording.channels, **nothing})
    bandwidth = fitted.bandwidth_Hz or default_bandwidth(recording)
    view = seen or views_for([recording], bandwidth, fitted.model)[0]

    def steady(series: Array) -> Array:
        return np.where(view.moving, view.low_pass(series), np.nan)

    def torque(model: CorrectedModel) -> Array:
        # What effects change in the drive is measured too.
        return steady(model.torque(view) - view.known + view.transmitted - model.drive(view))

    motion = view.low_pass(view.angle), view.low_pass(view.velocity)
    middle = Response(view.kept_times, *motion, torque(fitted.model))
    band = _band(middle.torque, _drawn(fitted, draws, rng, torque))
    moment = view.low_pass(view.moment)
    made = _simulation(fitted, "motion", middle, {"torque": band}, moment, [])
    return dataclasses.replace(made, measured=steady(view.transmitted)) if known else made


def _drawn(
    fitted: Fitted, draws: int, rng: np.random.Generator, response: Callable[[CorrectedModel], T]
) -> list[T]:
    """Return the response of each drawn model; the caches keep none of what it needs."""
    found = []
    for model in fitted.draws(draws, rng):
        found.append(response(model))
        forget()
    return found


def _band(middle: Array, others: list[Array]) -> tuple[Array, Array]:
    """Return the distances of the band's ends below and above the middle, from other draws."""
    if not others:
        return np.zeros(len(middle)), np.zeros(len(middle))
    tail = 0.5 - 0.5 * CONFIDENCE
    low, high = np.quantile(np.stack(others), [tail, 1.0 - tail], axis=0)
    return np.maximum(middle - low, 0.0), np.maximum(high - middle, 0.0)


def _simulation(
    fitted: Fitted,
    given: Given,
    middle: Response,
    bands: Mapping[str, tuple[Array, Array]],
    moment: Array,
    warnings: list[str],
) -> Simulation:
    """Return the response with bands of measured signals, and where it leaves the recordings."""
    low, high = {}, {}
    for name, (below, above) in bands.items():
        value, noise = getattr(middle, name), quantile(math.inf) * fitted.noise.get(name, 0.0)
        low[name], high[name] = value - np.hypot(below, noise), value + np.hypot(above, noise)
    outside = np.zeros(len(middle.time), dtype=bool)
    signals = {"angle": middle.angle, "velocity": middle.velocity, "moment": moment}
    for name, (least, most) in fitted.ranges.items():
        edge = 1e-3 * max(abs(least), abs(most))
        beyond = (signals[name] < least - edge) | (signals[name] > most + edge)
        if np.any(beyond):
            outside |= beyond
            warnings.append(
                f"{name} is from {np.min(signals[name]):.3g} to {np.max(signals[name]):.3g}, but "
                f"only {least:.3g} to {most:.3g} was recorded: beyond, the model is extrapolated"
            )
    return Simulation(
        given,
        middle.time,
        middle.angle,
        middle.velocity,
        middle.torque,
        low,
        high,
        outside,
        tuple(warnings),
    )
