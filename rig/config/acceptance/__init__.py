"""Limits of acceptance: converts each line of text to a validated record."""

from rig.config.acceptance.limits import (
    CONSTANTS,
    MEASURES,
    NOTHING_MISSING,
    UNITS,
    WEIGHT_CHECK,
    Bound,
    Limit,
    LimitLine,
    Measure,
    Range,
    Required,
    limits_of,
    parse_limit,
)

__all__ = [
    "CONSTANTS",
    "MEASURES",
    "NOTHING_MISSING",
    "UNITS",
    "WEIGHT_CHECK",
    "Bound",
    "Limit",
    "LimitLine",
    "Measure",
    "Range",
    "Required",
    "limits_of",
    "parse_limit",
]
