"""The catalogue in words, one module per group of effects; a new effect needs an entry, a term and
tests.
"""

from __future__ import annotations

from collections.abc import Mapping

from identification.diagnosis.catalogue.device import DEVICE
from identification.diagnosis.catalogue.entry import Entry
from identification.diagnosis.catalogue.friction import FRICTION
from identification.diagnosis.catalogue.gas import GAS
from identification.diagnosis.catalogue.motor import MOTOR
from identification.diagnosis.catalogue.sensing import SENSING
from identification.diagnosis.catalogue.transmission import TRANSMISSION

MOTION: Mapping[str, Entry] = {
    e.name: e for e in (*MOTOR, *TRANSMISSION, *FRICTION, *DEVICE, *SENSING)
}
"""Effects of machine and sensors; effects of the gas generator are computed by another model
(:mod:`identification.model.gas_generator`).
"""
ENTRIES: Mapping[str, Entry] = {**MOTION, **{e.name: e for e in GAS}}
"""Name to entry, in the order of the catalogue."""
