"""Hand-made diagnoses, one of each verdict: what a report must show whatever the numerics find."""

import dataclasses
import math

import numpy as np

from identification.diagnosis.result import (
    Curve,
    Diagnosis,
    Estimate,
    Fit,
    IdentifiedEffect,
    Location,
    Map,
    ResidualTrace,
    Rival,
    Shift,
    Step,
    Verdict,
)
from identification.diagnosis.statement import finding
from identification.effects import EFFECTS

NOMINAL = {
    "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3, "J": 0.204,
    "mu_c": 0.052, "mu_s": 0.086, "omega_sL": 0.0326, "mu_2": 0.032,
}  # fmt: skip
TIME = np.arange(0.0, 10.0, 0.02)
SQUARE = np.sign(np.sin(1.3 * TIME))


def effect(
    name: str, parameters: dict[str, Estimate], rivals: tuple[Rival, ...], group: tuple[str, ...]
) -> IdentifiedEffect:
    entry = EFFECTS[name]
    where = Location("travel since reversal", "rad", ((0.0, 0.0073),), 0.71, ("free", "heavy"))
    said = finding(entry, parameters, where.recordings)
    return IdentifiedEffect(
        name, group, 0.96, said, entry.assumption, where, parameters, rivals, entry.experiment
    )


GAP = Estimate(math.radians(0.42), math.radians(0.39), math.radians(0.45), "rad")
BACKLASH = effect(
    "backlash",
    {"gap_rad": GAP},
    (
        Rival("compliance", 0.03, "the lag does not grow with the torque: p = 0.002"),
        Rival("transport_delay", 0.01, "the lag does not grow with the speed: p = 1e-06"),
    ),
    ("backlash",),
)
DRAG = effect(
    "quadratic_drag",
    {"coefficient_Nms2_rad2": Estimate(1.9, 1.6, 2.2, "N m s^2/rad^2")},
    (),
    ("quadratic_drag",),
)
OFFSET = effect(
    "current_offset",
    {"current_A": Estimate(-0.21, -0.24, -0.18, "A")},
    (
        Rival("asymmetric_coulomb", 0.45, ""),
        Rival("gravity_imbalance", 0.02, "it does not change with the angle"),
    ),
    ("current_offset", "asymmetric_coulomb"),
)


def map_of(coordinate: str, unit: str, share: float, equation: str) -> Map:
    x = np.linspace(-0.4, 0.4, 21)
    mean = share * 0.004 * np.tanh(9.0 * x)
    spread = 0.0006 * np.ones_like(x)
    residual_unit = "rad" if equation == "transmission" else "N m"
    return Map(
        equation,
        coordinate,
        unit,
        residual_unit,
        x,
        mean,
        mean - spread,
        mean + spread,
        0.1 * mean,
        share,
    )


MAPS = tuple(
    map_of(coordinate, unit, share, equation)
    for equation in ("transmission", "torque")
    for coordinate, unit, share in (
        ("angle", "rad", 0.12), ("speed", "rad/s", 0.31), ("travel since reversal", "rad", 0.71),
         ("time", "s", 0.02),
    )
)  # fmt: skip
TRACES = tuple(
    ResidualTrace(name, role, equation, unit, TIME, 0.0036 * SQUARE, 0.0002 * np.cos(9.0 * TIME))
    for equation, unit in (("transmission", "rad"), ("torque", "N m"))
    for name, role in (("free", "fit"), ("later", "validate"))
)
FIT = Fit("transmission", "rad", 20.0, 0.0036, 0.0002, 0.00018, 0.0037, 0.00021)
TORQUE_FIT = Fit("torque", "N m", 20.0, 0.61, 0.09, 0.08, 0.62, 0.09)
STEPS = (
    Step("tested", "anything missing", 0.0005, 0.0, "omnibus test, 40 blocks"),
    Step("added", "backlash", 0.0005, 0.71, "the best of 39"),
    Step("kept", "backlash", 0.0005, 0.69, "taken out again the error rises"),
)
NAMED = Diagnosis(
    verdict=Verdict.NAMED,
    statement=f"{BACKLASH.statement}. Torque error on recordings set aside 0.62 -> 0.09 N m; noise "
    f"floor 0.08.",
    effects=(BACKLASH, DRAG),
    fit=FIT,
    fits=(FIT, TORQUE_FIT),
    parameters=NOMINAL,
    parameter_shift={
        "Mc": Shift(7.1, 6.8, "N m"),
        "J": Shift(None, 0.204, "kg m^2"),
        "mu_c": Shift(0.055, 0.052, "1"),
    },
    p_value=0.0005,
    location=BACKLASH.where,
    maps=MAPS,
    steps=STEPS,
    traces=TRACES,
    warnings=("free: 3 % of the samples are <unused>",),
)
AMBIGUOUS = dataclasses.replace(
    NAMED,
    verdict=Verdict.AMBIGUOUS,
    statement=f"{OFFSET.statement}; or asymmetric Coulomb friction: these recordings cannot tell",
    effects=(OFFSET,),
    fit=TORQUE_FIT,
)
OUTSIDE = dataclasses.replace(
    NAMED,
    verdict=Verdict.OUTSIDE_CATALOGUE,
    statement="a torque of 0.4 N m is missing against angle, and no name of the catalogue fits it",
    effects=(),
    fit=TORQUE_FIT,
    location=Location("angle", "rad", ((-0.2, 0.1),), 0.6, ("free",)),
    curve=Curve(
        "torque",
        "angle",
        "rad",
        "N m",
        np.linspace(-0.4, 0.4, 33),
        0.4 * np.cos(np.linspace(-9, 9, 33)),
    ),
)
NOTHING = dataclasses.replace(
    NAMED,
    verdict=Verdict.NOTHING_MISSING,
    statement="nothing is missing: the torque error of 0.081 N m is the noise",
    effects=(),
    fit=Fit("torque", "N m", 20.0, 0.081, 0.081, 0.08),
    fits=(),
    parameter_shift={},
    p_value=0.43,
    location=None,
    steps=STEPS[:1],
    warnings=(),
)
EACH = {d.verdict.value: d for d in (NAMED, AMBIGUOUS, OUTSIDE, NOTHING)}
