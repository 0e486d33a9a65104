"""Computes a share with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scipy.stats import beta

Row = Mapping[str, Any]
LEVEL = 0.95


def rate(hits: int, of: int) -> dict[str, Any]:
    """Return a share with its Clopper-Pearson interval at 95 %."""
    tail = (1.0 - LEVEL) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, of - hits + 1))
    high = 1.0 if hits == of else float(beta.ppf(1.0 - tail, hits + 1, of - hits))
    return {"n": hits, "of": of, "share": hits / of if of else None, "low": low, "high": high}
