"""Recordings that several files share; simulated once."""

import pytest

from identification.estimate.default import identify
from identification.recording import Dataset, Recording
from identification.result import Identification

from .practical import logged, simulated


@pytest.fixture(scope="session")
def practical_pair() -> tuple[Recording, Recording]:
    """The two cases on the practical bench, as logged."""
    return logged(simulated(0, 0.0), 0.0), logged(simulated(10, 30.6), 30.6)


@pytest.fixture(scope="session")
def practical_result(practical_pair: tuple[Recording, Recording]) -> Identification:
    """Both identified by the default method."""
    return identify(Dataset(practical_pair))
