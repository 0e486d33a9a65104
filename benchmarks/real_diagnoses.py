"""What the diagnosis leaves of real recordings, beside the nominal model, greedy selection by BIC
and the noise.

For every campaign: the verdict, and the error of the main equation with the reported constants,
on the recordings that were fitted and on those set aside. Greedy selection takes effects from the
same regressors until the criterion (BIC) no longer falls; its effects are then fitted as those of
the diagnosis, within their limits if that fit is the better one.

    python benchmarks/real_diagnoses.py tests/campaigns/*.yaml
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from benchmarks.baselines import greedy_bic, library
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.held_out import validation_rms
from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.result import Diagnosis
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.within_limits import choose, views_and_fit, within_limits
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Dataset, RecordingError
from identification.views.view import views
from rig.common.tables import table
from rig.sources.build import load_source

HEADINGS = (
    "campaign", "verdict", "effects and confidence", "unit", "noise", "fitted: nominal",
    "corrected", "greedy BIC", "set aside: nominal", "corrected", "greedy BIC", "greedy's effects",
)  # fmt: skip


def greedy(dataset: Dataset, equation: str) -> tuple[int, float, float | None]:
    """Return the number of effects that greedy selection takes, and the rms errors of one equation
    on the fitted recordings and on those set aside, None without any.
    """
    dataset, bandwidth, _ = choose(dataset, None)
    fitted, aside = dataset.part("fit"), dataset.part("validate")
    nominal = views_and_fit(dataset, bandwidth)[1]
    left_out = set(dataset.model.terms)
    terms = [t for t in MOTION if t.name not in left_out]
    names = greedy_bic(library(nominal, terms))
    added = tuple(a for name in names if (a := _best(nominal, name)) is not None)
    free = nominal.again(nominal.nominal, added) if added else nominal
    # Of a dozen effects the refinement within limits may end worse than it began.
    joint = min((free, within_limits(free)), key=lambda j: j.cost)
    rows = joint.stack.part(equation)
    sigma = next(e.sigma for e in joint.equations if e.name == equation)
    error = sigma * math.sqrt(float(np.mean(joint.residual[rows] ** 2)))
    others = views((*fitted, *aside), bandwidth, campaign=dataset.recordings)[len(fitted) :]
    return len(names), error, validation_rms(joint, others).get(equation)


def _best(joint: Joint, name: str) -> Added | None:
    """Return an effect at the trial shape that explains most of the nominal model's mismatch; None
    if no shape has physical signs.
    """
    term = next(t for t in MOTION if t.name == name)
    context = Context(joint.equations[0].views, joint.nominal)
    best = max(trial_candidates(joint.stack, context, [term]), key=lambda c: c.score, default=None)
    if best is None:
        return None
    return Added(term, best.shape, tuple(float(c) for c in best.coefficients))


def row(path: Path) -> list[str]:
    """Return the table's row of one campaign."""
    try:
        dataset = load_source(path)
        found = diagnose(dataset, rng=np.random.default_rng(0))
    except RecordingError as error:
        return [path.stem, "refused", str(error).split(":")[0], *[""] * 9]
    return [path.stem, *_told(found), *_of_greedy(dataset, found)]


def _told(found: Diagnosis) -> list[str]:
    main = found.fit
    names = ", ".join(f"{e.name} {e.confidence:.2f}" for e in found.effects)
    errors = (main.noise_floor_rms, main.baseline_rms, main.final_rms)
    return [found.verdict.value, names or "-", main.unit, *map(_number, errors)]


def _of_greedy(dataset: Dataset, found: Diagnosis) -> list[str]:
    main = found.fit
    seen = (main.validate_baseline_rms, main.validate_final_rms)
    try:
        count, error, unseen = greedy(dataset, main.equation)
    except (RecordingError, np.linalg.LinAlgError, ValueError) as fault:
        return ["-", *map(_number, seen), "-", type(fault).__name__]
    return [_number(error), *map(_number, seen), _number(unseen), str(count)]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("campaigns", nargs="+", type=Path)
    paths = parser.parse_args().campaigns
    print(table(HEADINGS, [row(path) for path in paths]))


if __name__ == "__main__":
    main()
