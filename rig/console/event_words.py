"""Texts of recorded events for the operator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

_WORDS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "prompt": lambda e: f"{e['stage']}: the operator is asked for the weight; the drive is off",
    "answer": lambda e: f"{e['stage']}: {e['weight_kg']:g} kg confirmed",
    "repeat": lambda e: f"{e['stage']}: the stage will be repeated",
    "stage start": lambda e: f"{e['stage']}: the stage begins",
    "first pass": lambda e: f"{e['stage']}: first pass at {100 * e['amplitude']:.0f} % amplitude",
    "weight check": lambda e: f"{e['stage']}: weight check: {e['verdict']}. {e['message']}",
    "segment": lambda e: f"{e['stage']}: excitation {e['number']} begins",
    "stage end": lambda e: f"{e['stage']}: the stage is done; the drive is off",
    "paused": lambda e: f"{e['stage']}: pause; the drive is off",
    "go on": lambda e: f"{e['stage']}: the run continues",
    "abort": lambda e: f"{e['stage']}: the operator aborted the run",
    "ignition": lambda e: f"{e['stage']}: ignition",
    "fault reset": lambda e: (
        f"{e['stage']}: the fault of the drive is cleared; the drive is still off"
    ),
}


def event_words(event: Mapping[str, Any]) -> str:
    """Return an event with its time as one line of text; for an unknown event, its name and
    details.
    """
    name = str(event.get("event"))
    try:
        words = _WORDS[name](event)
    except (KeyError, TypeError, ValueError):
        details = ", ".join(
            f"{key} {value}" for key, value in event.items() if key not in ("time", "event")
        )
        words = f"{name}: {event['message']}" if "message" in event else f"{name} {details}".strip()
    time = event.get("time")
    return f"{time:.1f} s  {words}" if isinstance(time, float | int) else words
