"""The catalogue in words, one module per group; adding an effect means adding one entry, its term
and their tests.
"""

from __future__ import annotations

from collections.abc import Mapping

from identification.diagnosis.entries.device import DEVICE
from identification.diagnosis.entries.entry import Entry
from identification.diagnosis.entries.friction import FRICTION
from identification.diagnosis.entries.gas import GAS
from identification.diagnosis.entries.motor import MOTOR
from identification.diagnosis.entries.sensing import SENSING
from identification.diagnosis.entries.transmission import TRANSMISSION

MOTION: Mapping[str, Entry] = {
    e.name: e for e in (*MOTOR, *TRANSMISSION, *FRICTION, *DEVICE, *SENSING)
}
"""What shows in the motion; what hides in a gas generator has a model of its own
(:mod:`identification.model`).
"""
ENTRIES: Mapping[str, Entry] = {**MOTION, **{e.name: e for e in GAS}}
"""Name to entry, in the order of the catalogue."""
