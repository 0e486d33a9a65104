"""The confirming experiment: predicted by the corrected model before it runs, compared after;
fitted only if the prediction failed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from identification.design.separation import REJECTED, Weighed, experiment_views, predicted_band
from identification.effects import EFFECTS
from identification.numerics.arrays import Array, plain
from identification.recording import Dataset, RecordingError
from identification.views.view import views
from rig.common.errors import InputError
from rig.config.sequence import Sequence as Stages
from rig.investigate.choice import Progress
from rig.investigate.experiments import (
    Part,
    SimulatedBench,
    as_document,
    bench_seconds,
    family,
    in_order,
    weight_changes,
)
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.model_file import model_of, read_result

Trace = tuple[Array, Array, Array, Array]
BAND = 0.90
"""Share of the samples that the band of a prediction is made to hold."""
MOTIONS = ("tones", "medium", "ends", "wide-fast")
"""Motions of the confirming experiment, the first one possible, without load and with the heaviest
weight; several tones cover speeds and angles that the fits weigh differently.
"""


@dataclass(frozen=True)
class Prediction:
    """The torque of an experiment before it runs.

    Attributes:
        sequence: The experiment.
        sealed: Content of the sealed file: ``bandwidth_Hz`` of the torque, ``band``, ``floor_rms``
            (noise floor of the torque in the recordings so far, N m), and for each of the
            ``recordings`` times in steady motion since the start of the excitation, ``time_s``,
            ``torque_N_m`` and ``half_width_N_m`` of the band.
        seconds: Time of the bench and its operator, s.
        weight_changes: How often a weight is hung or taken off.
    """

    sequence: Stages
    sealed: Mapping[str, Any]
    seconds: float
    weight_changes: int

    @property
    def reason(self) -> str:
        """Why the experiment is run."""
        samples = sum(len(r["time_s"]) for r in self.sealed["recordings"])
        return (
            f"confirms the model: {samples} samples of torque are predicted with a {BAND:.0%} band "
            f"before it runs; {self.seconds / 60.0:.1f} min of the bench"
        )


@dataclass(frozen=True)
class Confirmation:
    """What came of a prediction.

    Attributes:
        band_held: Share of the samples inside the band.
        error_rms: Rms error of the prediction, N m.
        floor_rms: Noise floor, N m.
        samples: Number of samples that are compared.
        predicted: Number of samples that were predicted.
        traces: Name of each recording to its time, s, prediction, half width and measurement, N m,
            each of shape (n,).
    """

    band_held: float
    error_rms: float
    floor_rms: float
    samples: int
    predicted: int
    traces: Mapping[str, Trace]

    def record(self) -> dict[str, Any]:
        """Return the confirmation as JSON values."""
        return dict(plain(self, "traces"))


def predict(
    bench: SimulatedBench,
    outcome: Outcome,
    weighed: Weighed,
    rng: np.random.Generator,
    progress: Progress,
    result: str = "",
    avoided: Collection[str] = (),
) -> Prediction | str:
    """Return the prediction of a confirming experiment, or why there is none: the model cannot be
    simulated, or no experiment is within the limits of the bench for it and for every hypothesis
    that is not rejected.

    Args:
        bench: The bench.
        outcome: Diagnosis whose model predicts, unless ``result`` is given.
        weighed: Hypotheses, of which the first one states the errors of the parameters.
        rng: Random generator of the parts.
        progress: Called with the present step.
        result: Path of another result, whose model predicts; empty for none.
        avoided: Names of stages that have tripped.
    """
    recordings = [r.name for r in outcome.dataset.recordings]
    joint, diagnosis = weighed.hypotheses[0].joint, outcome.diagnosis
    torque = next((f for f in diagnosis.fits if f.equation == "torque"), diagnosis.fit)
    parts = family(bench.document.value, rng)
    try:
        record = read_result(Path(result)) if result else outcome.record()
        model = model_of(record, recordings)
        # A mistake in one recording does not come again.
        lasting = {n: e for n, e in model.effects.items() if EFFECTS[n].place is None}
        model = replace(model, effects=lasting)
        machine = bench.machine(model)
    except InputError as error:
        return str(error)
    open_models = [h.model for h in weighed.hypotheses if h.preference < REJECTED]
    machines = list(bench.machines(open_models).values())
    # Without loaded recordings the friction under a load is not known.
    heaviest = max(p.weight_kg for p in parts) if bench.knows_load(model) else 0.0
    why = "every motion has a stage that has tripped"
    for motion in MOTIONS:
        progress("predicting the confirming experiment", 0.0)
        chosen = in_order(
            [p for p in parts if _motion(p) == motion and p.weight_kg in (0.0, heaviest)]
        )
        if any(stage.name in avoided for p in chosen for stage in p.stages):
            continue
        document = as_document("confirm", chosen)
        try:
            plan = bench.plan(document, [model, *open_models])
            simulated = bench.simulate(plan, machine)
            near = [simulated.problem, *(bench.simulate(plan, m).problem for m in machines)]
            if any(near):
                why = next(filter(None, near))
                continue
            here = experiment_views(simulated.recordings, joint, torque.bandwidth_Hz)
            band = predicted_band(joint, here)
        except (InputError, RecordingError) as error:
            why = str(error)
            continue
        wide = float(stats.norm.ppf(0.5 + 0.5 * BAND))
        series = zip(simulated.recordings, *band, strict=True)
        sealed = {
            "bandwidth_Hz": torque.bandwidth_Hz,
            "band": BAND,
            "floor_rms": torque.noise_floor_rms,
            "recordings": [
                {
                    "name": recording.name,
                    "time_s": plain(time),
                    "torque_N_m": plain(predicted),
                    "half_width_N_m": plain(wide * error),
                }
                for recording, time, predicted, error in series
            ],
        }
        changes = weight_changes(plan.stages)
        return Prediction(document.value, sealed, bench_seconds(plan), changes)
    return why


def _motion(part: Part) -> str:
    return part.name.rpartition("-")[0]


def compare(sealed: Mapping[str, Any], measured: Dataset) -> Confirmation | None:
    """Compare a prediction, the content of its sealed file, with the recordings of its experiment,
    where both move steadily; None if they never do.
    """
    traces: dict[str, Trace] = {}
    found = views(measured.recordings, sealed["bandwidth_Hz"])
    for view, predicted in zip(found, sealed["recordings"], strict=True):
        time, torque, half = (
            np.array(predicted[key]) for key in ("time_s", "torque_N_m", "half_width_N_m")
        )
        since = view.kept_times - view.time[0]
        moving = np.interp(time, since, view.moving.astype(np.float64)) > 0.999
        seen = np.interp(time, since, view.low_pass(view.torque))
        traces[predicted["name"]] = time[moving], torque[moving], half[moving], seen[moving]
    torque, half, seen = (np.concatenate([t[k] for t in traces.values()]) for k in (1, 2, 3))
    if not len(torque):
        return None
    error = seen - torque
    return Confirmation(
        float(np.mean(np.abs(error) <= half)),
        float(np.sqrt(np.mean(error**2))),
        sealed["floor_rms"],
        len(error),
        sum(len(r["time_s"]) for r in sealed["recordings"]),
        traces,
    )
