"""The functions of the library, as ``import identification as lr`` exports them.

They take recordings, return frozen results, print nothing, and keep no state.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from identification.design.simulated import (
    NAMES,
    Intervals,
    PlannedModel,
    PlannedStage,
    Sensors,
    expected,
    with_drives,
)
from identification.diagnosis import diagnose as diagnosis
from identification.diagnosis.result import Diagnosis
from identification.effects import EFFECTS, with_own
from identification.effects.effect import Effect as CatalogueEffect
from identification.effects.model import CorrectedModel, Curve
from identification.effects.own import OwnEffect
from identification.effects.own import effect as effect
from identification.effects.prediction import Fitted, Given, Simulation, predict
from identification.estimate.default import identify_any_length
from identification.model.parameters import SYSTEM_PARAMETERS
from identification.numerics.arrays import Progress
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.result import HEADLINES, Identification
from identification.views.view import forget

Source = Dataset | Recording | Iterable[Recording]
Result = Identification | Diagnosis | CorrectedModel | Mapping[str, Any]
Seed = int | np.random.Generator | None
"""What :func:`numpy.random.default_rng` takes: a seed, a generator, or None for other draws in each
call.
"""
Effect = OwnEffect
"""What an effect of one's own is derived from."""
catalogue: Mapping[str, CatalogueEffect] = EFFECTS
"""Effects that a diagnosis knows, by name."""
MAY_LACK = ("voltage", "supply_voltage", "temperature", "pressure")
"""Channels in which NaN means that a sample was not measured."""


def identify(
    source: Source,
    model: Model | None = None,
    *,
    bandwidth_Hz: float | None = None,
    rng: Seed = None,
    progress: Progress | None = None,
    profile: bool = False,
    draws: int = 0,
) -> Identification:
    """Identify friction and inertia from recordings, as ``rig identify`` does.

    Args:
        source: A dataset, a recording, or several of one machine; those with role ``validate`` are
            not fitted.
        model: What is fitted, fixed, bounded or known with an uncertainty; None for the model of
            the dataset.
        bandwidth_Hz: Bandwidth of torque and regressors; None to choose it from the recordings.
        rng: Seed or generator of the simulated replicates and of the bootstrap.
        progress: Called with the name of a step and the share of it that is done.
        profile: Whether to compute profile likelihoods as well.
        draws: Number of bootstrap samples.

    Raises:
        RecordingError: The recordings do not determine the model; the message says what is missing.

    >>> import identification as lr
    >>> t = np.arange(4000) / 250.0
    >>> angle, velocity = np.sin(t), np.cos(t)
    >>> torque = 2.0 * np.sign(velocity) + 0.5 * velocity - 0.3 * np.sin(t)
    >>> found = lr.identify(lr.Recording(t, angle, torque=torque), rng=0)
    >>> {name: round(value, 2) for name, value in found.values.items()}
    {'Mc': 2.0, 'sigma_2': 0.5, 'J': 0.3}
    """
    found = identify_any_length(
        dataset_of(source, model),
        bandwidth_Hz=bandwidth_Hz,
        rng=np.random.default_rng(rng),
        progress=progress,
        profile=profile,
        draws=draws,
    )
    forget()
    if not found.misfit:
        return found
    first = f"{HEADLINES[found.misfit[0]]}: {found.misfit_words}"
    return replace(found, warnings=(first, *found.warnings))


def diagnose(
    source: Source,
    model: Model | None = None,
    *,
    effects: Sequence[Effect] = (),
    bandwidth_Hz: float | None = None,
    rng: Seed = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Test whether the model lacks an effect, and identify it, as ``rig diagnose`` does.

    Args:
        source: As in :func:`identify`; with recordings of role ``validate``, an effect is kept only
            if it lowers their error.
        model: As in :func:`identify`.
        effects: Effects of one's own, sought beside those of the catalogue.
        bandwidth_Hz: Bandwidth of all errors; None to choose it from the recordings.
        rng: Seed or generator.
        progress: Called with the name of a step and the share of it that is done.

    Raises:
        RecordingError: The recordings do not determine the nominal model or a declared term.
    """
    stated = dataset_of(source, model)
    exact, warnings = diagnosis.as_exact(stated)
    chance = np.random.default_rng(rng)
    first = copy.deepcopy(chance)
    own: dict[str, Any] = {"effects": tuple(effects)} if effects else {}
    found = diagnosis.diagnose(
        exact,
        bandwidth_Hz=bandwidth_Hz,
        rng=chance,
        progress=progress,
        estimate=lambda _exact: identify_any_length(stated, rng=first, progress=progress),
        **own,
    )
    forget()
    return replace(found, warnings=(*found.warnings, *warnings))


def simulate(
    result: Result,
    recording: Recording,
    *,
    values: Mapping[str, float] | None = None,
    given: Given | None = None,
    effects: Sequence[Effect] = (),
    draws: int = 100,
    rng: Seed = None,
) -> Simulation:
    """Predict the response of a fitted model, with a 90 % band.

    A recording without an angle is a plan: ``Recording(t, command=c, controller=...)`` is a
    position loop that follows a command, ``Recording(t, torque=u)`` a joint that a torque drives.

    Args:
        result: Result of :func:`identify` or :func:`diagnose`, a corrected model, parameters by
            name, SI, those of effects as ``effect.name``, or the content of a ``model.yaml``.
        recording: What is given to the model, and its loads; the machine is cold at its start.
        values: Other values of some parameters: ``{"J": 0.3}`` for another inertia.
        given: ``command``: the position loop is simulated; ``torque``: the joint is driven by the
            recorded torque or current; ``motion``: the torque that the recorded motion requires.
            None for the first that the recording has, a torque only without a motion.
        effects: Effects of one's own that parameters by name, or a file, contain.
        draws: Number of parameter sets from which the band is made.
        rng: Seed or generator of these sets.

    Raises:
        RecordingError: The recording does not have what is asked for or lacks a sample, or a name
            in ``values`` is unknown.

    >>> import identification as lr
    >>> t = np.arange(1000) / 500.0
    >>> push = lr.Recording(t, torque=np.full(1000, 2.0))
    >>> friction = {"Mc": 1.0, "sigma_2": 0.1, "J": 0.5}
    >>> light, heavy = (lr.simulate(friction, push, values={"J": j}) for j in (0.5, 1.0))
    >>> bool(light.velocity[-1] > heavy.velocity[-1] > 0.0)
    True
    """
    (recording,) = dataset_of(recording).recordings
    fitted = fitted_of(result, effects)
    if values:
        fitted = fitted.changed(values)
    fitted, lost = fitted.of_every_recording()
    found = predict(fitted, recording, given, draws=draws, rng=np.random.default_rng(rng))
    forget()
    if not lost:
        return found
    warning = f"the response is without {lost}: in one recording of the fit alone"
    return replace(found, warnings=(*found.warnings, warning))


def plan(
    result: Result,
    recordings: Recording | Iterable[Recording],
    *,
    torque_noise: float | None = None,
    joint_step: float | None = None,
    torque_limit: float = math.inf,
) -> Intervals:
    """Return how accurately an experiment would determine the parameters, before it is run.

    The experiment is simulated in the loop of a stiff drive with sensors of these errors, and its
    Fisher information computed at the simulated values.

    Args:
        result: Assumed parameters: a result, or the nominal parameters by name, SI.
        recordings: Planned recordings of one machine: time, command, bench and weight.
        torque_noise: Noise of the measured torque, N m rms at the joint; None for that of the
            result.
        joint_step: Joint angle of one step of the encoder, rad; None for that of the result.
        torque_limit: Greatest torque of the drive, N m.

    Raises:
        RecordingError: A parameter, a command, a sample or a property of the sensors is not known.
    """
    planned = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    noise = result.noise if isinstance(result, Identification) else None
    if noise is not None:
        if torque_noise is None:
            torque_noise = math.hypot(noise.torque, noise.correlated)
        joint_step = noise.encoder_step_rad if joint_step is None else joint_step
    if not torque_noise or not joint_step:
        raise RecordingError(
            "a plan needs torque_noise (N m rms) and joint_step (rad), both above 0, as the result "
            "states none"
        )
    lacking = [r.name for r in planned if "command" not in r.channels]
    if lacking or not planned:
        missing = ", ".join(lacking) or "no recording"
        raise RecordingError(
            f"a plan needs recordings with a `command` channel (lacking: {missing})"
        )
    planned = dataset_of(planned).recordings
    first = planned[0]
    unlike = [
        r.name
        for r in planned
        if not math.isclose(r.period, first.period, rel_tol=1e-6)
        or r.bench != first.bench
        or r.known_load
        or "load_force" in r.channels
    ]
    if unlike:
        raise RecordingError(
            f"{unlike[0]}: the recordings of a plan have one sample period, one bench, and weights "
            "as their only load"
        )
    fitted = fitted_of(result)
    names = NAMES if any(r.weight_mass for r in planned) else SYSTEM_PARAMETERS
    unknown = [n for n in names if not fitted.model.parameters.get(n)]
    if unknown:
        raise RecordingError(
            f"a plan needs a value above 0 of {', '.join(unknown)}; assume one for those that the "
            "recordings have not determined yet"
        )
    sensors = Sensors(planned[0].period, joint_step, torque_noise)
    nominal = PlannedModel(
        fitted.model.parameters, planned[0].bench, sensors, torque_limit, fitted.model.alpha
    )
    stages = [PlannedStage(r.channels["command"], r.weight_mass) for r in planned]
    return expected(stages, with_drives(nominal))[0]


def dataset_of(source: Source, model: Model | None = None) -> Dataset:
    """Return recordings as a dataset whose recordings have different names.

    Raises:
        RecordingError: A sample is missing, or the recordings are of several units.
    """
    whole = source if isinstance(source, Dataset) else Dataset(source)
    if len(units := list(dict.fromkeys(r.unit for r in whole.recordings))) > 1:
        raise RecordingError(
            f"recordings of {len(units)} units ({units[0]}, ...); give those of one"
        )
    taken: dict[str, int] = {}
    recordings = []
    for recording in whole.recordings:
        for channel, values in recording.channels.items():
            bad = np.flatnonzero(~np.isfinite(values))
            if channel not in MAY_LACK and bad.size:
                raise RecordingError(
                    f"{recording.name}: channel {channel!r} has no value in {bad.size} samples "
                    f"(first: sample {bad[0]}, {recording.time[bad[0]]:.6g} s); interpolate short "
                    "gaps, leave the channel out, or cut the recording there"
                )
        taken[recording.name] = number = taken.get(recording.name, 0) + 1
        name = recording.name if number == 1 else f"{recording.name} {number}"
        recordings.append(recording if number == 1 else replace(recording, name=name))
    return Dataset(recordings, model or whole.model, whole.tables)


def fitted_of(result: Result, own: Sequence[Effect] = ()) -> Fitted:
    """Return a result as a model with what is known of its errors.

    Args:
        result: As in :func:`simulate`.
        own: Effects of one's own that parameters by name, or a file, contain.

    Raises:
        RecordingError: The result has no model of a motion, or an effect is unknown or lacks a
            parameter.
    """
    if isinstance(result, Identification):
        model = CorrectedModel(result.fitted, result.alpha)
        noise = {"torque": result.fit.train_rms} if result.fit.unit == result.torque_unit else {}
        if result.noise is not None:
            step = result.noise.encoder_step_rad / math.sqrt(12.0)
            noise["angle"] = math.hypot(result.noise.angle_rad, step)
        return Fitted(
            model,
            result.covariance,
            noise=noise,
            ranges=result.ranges,
            bandwidth_Hz=result.fit.bandwidth_Hz,
        )
    if isinstance(result, Diagnosis):
        if result.model is None:
            raise RecordingError("a diagnosis of a gas generator has no model of a motion")
        fit = next((f for f in result.fits if f.equation == "torque"), result.fit)
        return Fitted(
            result.model,
            result.covariance,
            {"torque": fit.final_rms} if fit.equation == "torque" else {},
            result.ranges,
            fit.bandwidth_Hz,
        )
    if isinstance(result, CorrectedModel):
        return Fitted(result)
    effects: dict[str, dict[str, float]] = {}
    for name, value in _by_name(result).items():
        effect, dot, parameter = name.partition(".")
        effects.setdefault(effect if dot else "", {})[parameter if dot else name] = value
    nominal, known = effects.pop("", {}), with_own(own)
    for name, given in effects.items():
        if name not in known:
            raise RecordingError(
                f"{name!r} is no effect of the catalogue; give an effect of your own as "
                "effects=[...]"
            )
        if lacking := [q.name for q in known[name].parameters if q.name not in given]:
            raise RecordingError(f"{name} lacks {', '.join(lacking)}")
    alpha = nominal.pop("alpha", 2.0)
    return Fitted(CorrectedModel(nominal, alpha, effects, _curve_of(result), known))


def _curve_of(given: Mapping[str, Any]) -> Curve | None:
    """Return the empirical curve of a file, if it has one."""
    found = given.get("curve")
    if found is None:
        return None
    try:
        series = {n: np.array(found[n], dtype=float) for n in ("grid", "value")}
        return Curve(**{**found, **series})
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"curve: must be that of a model.yaml ({error})") from error


def _by_name(given: Mapping[str, Any]) -> dict[str, float]:
    """Return parameters by name, those of effects as ``effect.name``; also of a file, in which they
    are in groups and may have units and intervals.
    """
    if "parameters" in given:
        effects = given.get("effects") or {}
        found = {f"{e}.{n}": value for e, own in effects.items() for n, value in own.items()}
        given = {"alpha": given.get("alpha", 2.0), **given["parameters"], **found}
    return {n: float(v["value"] if isinstance(v, Mapping) else v) for n, v in given.items()}
