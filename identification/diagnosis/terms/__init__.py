"""All effects with their regressors, in the order of the catalogue's groups."""

from __future__ import annotations

from identification.diagnosis.terms import device, friction, joint_encoder, motor, transmission
from identification.diagnosis.terms.term import Term

TERMS: tuple[Term, ...] = (
    *motor.TERMS,
    *transmission.TERMS,
    *joint_encoder.TERMS,
    *friction.TERMS,
    *device.TERMS,
)
