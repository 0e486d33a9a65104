"""``rig identify --ladder`` on a voltage bench: the fits to the simulated angle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.estimate.simulated_ladder import climb_simulated
from identification.model.parameters import DIRECTIONAL, TRANSMITTED
from rig.sources import load_source

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"


@pytest.mark.proof
@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "declared_mrad", "free_mrad"),
    [("sts3032_to_light.yaml", 12.0, 7.7), ("sts3032_to_heavy.yaml", 22.8, 17.5)],
)
def test_sts3032_predicts_the_angle_of_the_other_mass(
    recordings: Path, name: str, declared_mrad: float, free_mrad: float
) -> None:
    """Mean absolute errors of the loop simulated from its command, supply and first sample."""
    rungs = {
        (r.friction, r.free): r
        for r in climb_simulated(
            load_source(CAMPAIGNS / name),
            bandwidth_Hz=None,
            rng=np.random.default_rng(0),
            replicates=2,
        )
    }
    for friction in (TRANSMITTED, DIRECTIONAL):
        declared, free = (rungs[friction, way].scored for way in (False, True))
        assert declared is not None
        assert free is not None
        assert 1e3 * declared.value < declared_mrad
        assert 1e3 * free.value < free_mrad
        drive = next(c for c in rungs[friction, True].constants if c.name == "torque_per_volt")
        assert 0.15 < drive.change < 0.45
        assert drive.moved
