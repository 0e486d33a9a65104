"""The confirming experiment: predicted by the corrected model before it runs, compared after, and
never fitted.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from identification.design.separation import Weighed, experiment_views, predicted_band
from identification.numerics.arrays import Array
from identification.recording import Dataset, RecordingError
from identification.views.view import views
from rig.common.errors import InputError
from rig.common.places import read_json
from rig.common.provenance import plain, sha256_file
from rig.config.sequence import Sequence as Stages
from rig.config.sequence import plain_sequence
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
        bandwidth_Hz: Bandwidth of the torque.
        floor_rms: Noise floor of the torque in the recordings so far, N m.
        names: Name of each recording.
        time: Times in steady motion since the start of the excitation, s, for each recording.
        torque: Predicted torque of the drive at these times, N m.
        half_width: Half width of the band, N m.
        seconds: Time of the bench and its operator, s.
        weight_changes: How often a weight is hung or taken off.
    """

    sequence: Stages
    bandwidth_Hz: float
    floor_rms: float
    names: tuple[str, ...]
    time: tuple[Array, ...]
    torque: tuple[Array, ...]
    half_width: tuple[Array, ...]
    seconds: float
    weight_changes: int

    @classmethod
    def read(cls, path: Path, digest: str) -> Prediction:
        """Read a sealed prediction.

        Raises:
            InputError: The file cannot be read, or was changed after it was sealed.
        """
        raw = read_json(path)
        if (found := sha256_file(path)) != digest:
            raise InputError(
                f"{path}: SHA-256 is {found}, was {digest} when sealed; the prediction was changed"
            )
        each = raw["recordings"]
        return cls(
            Stages.model_validate_json(json.dumps(raw["sequence"])),
            raw["bandwidth_Hz"],
            raw["floor_rms"],
            tuple(r["name"] for r in each),
            tuple(np.array(r["time_s"]) for r in each),
            tuple(np.array(r["torque_N_m"]) for r in each),
            tuple(np.array(r["half_width_N_m"]) for r in each),
            raw["seconds"],
            raw["weight_changes"],
        )

    @property
    def reason(self) -> str:
        """Why the experiment is run."""
        return (
            f"confirms the model: {sum(map(len, self.time))} samples of torque are predicted with "
            f"a {BAND:.0%} band before it runs; {self.seconds / 60.0:.1f} min of the bench"
        )

    def record(self) -> dict[str, Any]:
        """Return the content of the sealed file."""
        series = zip(self.names, self.time, self.torque, self.half_width, strict=True)
        return {
            "bandwidth_Hz": self.bandwidth_Hz,
            "floor_rms": self.floor_rms,
            "band": BAND,
            "recordings": [
                {"name": n, "time_s": plain(t), "torque_N_m": plain(m), "half_width_N_m": plain(h)}
                for n, t, m, h in series
            ],
            "seconds": self.seconds,
            "weight_changes": self.weight_changes,
            "sequence": plain_sequence(self.sequence),
        }


@dataclass(frozen=True)
class Confirmation:
    """What came of a prediction.

    Attributes:
        band_held: Share of the samples inside the band.
        error_rms: Rms error of the prediction, N m.
        floor_rms: Noise floor, N m.
        samples: Number of samples.
        trace: Time, s, prediction, half width and measurement, N m, of the first recording, each of
            shape (n,).
    """

    band_held: float
    error_rms: float
    floor_rms: float
    samples: int
    trace: tuple[Array, Array, Array, Array]

    def record(self) -> dict[str, Any]:
        """Return the confirmation as JSON values."""
        return dict(plain(self, "trace"))


def predict(
    bench: SimulatedBench,
    outcome: Outcome,
    weighed: Weighed,
    rng: np.random.Generator,
    progress: Progress,
    result: str = "",
) -> Prediction | None:
    """Return the prediction of a confirming experiment, or None if the model cannot be simulated
    within the limits of the bench.

    Args:
        bench: The bench.
        outcome: Diagnosis whose model predicts, unless ``result`` is given.
        weighed: Hypotheses, of which the first one states the errors of the parameters.
        rng: Random generator of the parts.
        progress: Called with the present step.
        result: Path of another result, whose model predicts; empty for none.
    """
    recordings = [r.name for r in outcome.dataset.recordings]
    joint, diagnosis = weighed.hypotheses[0].joint, outcome.diagnosis
    torque = next((f for f in diagnosis.fits if f.equation == "torque"), diagnosis.fit)
    parts = family(bench.document.value, rng)
    heaviest = max(p.weight_kg for p in parts)
    try:
        record = read_result(Path(result)) if result else outcome.record()
        model = model_of(record, recordings)
        machine = bench.machine(model)
    except InputError:
        return None
    for motion in MOTIONS:
        progress("predicting the confirming experiment", 0.0)
        chosen = in_order(
            [p for p in parts if _motion(p) == motion and p.weight_kg in (0.0, heaviest)]
        )
        document = as_document("confirm", chosen)
        try:
            plan = bench.plan(document, [model])
            simulated = bench.simulate(plan, machine)
            if simulated.problem:
                continue
            here = experiment_views(simulated.recordings, joint, torque.bandwidth_Hz)
            band = predicted_band(joint, here)
        except (InputError, RecordingError):
            continue
        wide = float(stats.norm.ppf(0.5 + 0.5 * BAND))
        return Prediction(
            document.value,
            torque.bandwidth_Hz,
            torque.noise_floor_rms,
            tuple(r.name for r in simulated.recordings),
            band.time,
            band.torque,
            tuple(wide * e for e in band.error),
            bench_seconds(plan),
            weight_changes(plan.stages),
        )
    return None


def _motion(part: Part) -> str:
    return part.name.rpartition("-")[0]


def compare(prediction: Prediction, measured: Dataset) -> Confirmation:
    """Compare a prediction with the recordings of its experiment, where both move steadily."""
    traces = []
    for k, view in enumerate(views(measured.recordings, prediction.bandwidth_Hz)):
        time, torque, half = (
            each[k] for each in (prediction.time, prediction.torque, prediction.half_width)
        )
        since = view.kept_times - view.time[0]
        moving = np.interp(time, since, view.moving.astype(np.float64)) > 0.999
        seen = np.interp(time, since, view.low_pass(view.torque))
        traces.append(tuple(each[moving] for each in (time, torque, half, seen)))
    torque, half, seen = (np.concatenate([t[k] for t in traces]) for k in (1, 2, 3))
    error = seen - torque
    return Confirmation(
        float(np.mean(np.abs(error) <= half)),
        float(np.sqrt(np.mean(error**2))),
        prediction.floor_rms,
        len(error),
        traces[0],
    )
