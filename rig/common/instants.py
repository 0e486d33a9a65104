"""Reads dates and times in configuration files."""

from __future__ import annotations

from datetime import UTC, datetime


def instant(text: str) -> datetime:
    """Return the date and time that an ISO 8601 text states; a text without a zone is in UTC.

    Raises:
        ValueError: The text is not an ISO 8601 date and time, or is a date without a time.
    """
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        found = None
    if found is None or len(text) < len("2026-01-31T12:00"):
        raise ValueError(
            "not an ISO time with date and time of day; write 2026-01-31T12:00:00, or seconds"
        )
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def iso_time(text: str) -> str:
    """Return the text if it is an ISO 8601 date and time.

    Raises:
        ValueError: The text is not an ISO 8601 date and time.
    """
    instant(text)
    return text
