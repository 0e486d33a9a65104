"""Recordings that several files share; simulated once."""

from __future__ import annotations

import pytest

from identification.recording import Recording

from .practical import logged, simulated


@pytest.fixture(scope="session")
def practical_pair() -> tuple[Recording, Recording]:
    """The two cases on the practical bench, as logged."""
    return logged(simulated(0, 0.0), 0.0), logged(simulated(10, 30.6), 30.6)
