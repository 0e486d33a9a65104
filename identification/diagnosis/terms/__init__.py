"""All effects with their regressors, in the order of the catalogue's groups."""

from __future__ import annotations

from identification.diagnosis.terms import device, friction, motor, transmission
from identification.diagnosis.terms.term import Term

TERMS: tuple[Term, ...] = (*motor.TERMS, *transmission.TERMS, *friction.TERMS, *device.TERMS)
