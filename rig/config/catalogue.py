"""Stable names of the physical effects in the catalogue, for declarations and diagnoses."""

from __future__ import annotations

from collections.abc import Mapping

from identification.diagnosis.catalogue import ENTRIES

CATALOGUE: Mapping[str, tuple[str, ...]] = {
    group: tuple(e.name for e in ENTRIES.values() if e.group == group)
    for group in dict.fromkeys(e.group for e in ENTRIES.values())
}
"""Names of the effects in each group, in the order of the catalogue."""

EFFECTS: tuple[str, ...] = tuple(name for names in CATALOGUE.values() for name in names)
