"""Computes the regressors of those errors of the joint encoder that show in the angle alone."""

from __future__ import annotations

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.term import EXACT, Context, Shape, Term, everywhere, polar, rows
from identification.recording import Array

SLIPS_PER_RECORDING = 12


def _joint_encoder(view: View) -> bool:
    return view.lag is not None


def _eccentric(view: View, _nominal: Nominal, _shape: Shape) -> Array:
    return rows(-np.sin(view.angle), -np.cos(view.angle))


def _read_eccentric(c: Array, _shape: Shape, _context: Context) -> dict[str, float]:
    amplitude, phase = polar(float(c[0]), float(c[1]))
    return {"amplitude_rad": amplitude, "phase_rad": phase}


def _slip(view: View, _nominal: Nominal, shape: Shape) -> Array:
    here = view.index == round(shape[0])
    return rows(np.where(here & (view.time - view.time[0] >= shape[1]), -1.0, 0.0))


def _slips(context: Context) -> list[Shape]:
    shapes: list[Shape] = []
    for view in context.views:
        if view.lag is not None:
            length = float(view.time[-1] - view.time[0])
            times = np.linspace(0.0, length, SLIPS_PER_RECORDING + 2)[1:-1]
            shapes += [(float(view.index), float(t)) for t in times]
    return shapes


TERMS = (
    Term(
        "encoder_eccentricity",
        {"transmission": _eccentric},
        _read_eccentric,
        lambda context: everywhere(context, _joint_encoder, ((),)),
        shape_error=EXACT,
    ),
    Term(
        "encoder_slip",
        {"transmission": _slip},
        lambda c, shape, _context: {"angle_rad": float(c[0]), "at_s": shape[1]},
        _slips,
        place=0,
        refine={1: 3.0},
        shape_error=EXACT,
    ),
)
