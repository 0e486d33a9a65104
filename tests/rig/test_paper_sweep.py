"""Fig. 4: the current falls with pressure and impacted area while the valve opens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.parts.constants import GasGenerator, Joint, Machine
from rig.results.paper.loop import PAPER_DEG_S, SLOW_DEG_S, sweep


@pytest.mark.parametrize(
    ("speed", "lag"), [(PAPER_DEG_S, (0.45, 0.60)), (SLOW_DEG_S, (0.02, 0.08))]
)
def test_the_current_falls_with_pressure_and_area(speed: float, lag: tuple[float, float]) -> None:
    found = sweep(Machine(), speed)
    assert found.rank_pressure > 0.95
    assert found.rank_area > 0.95
    assert lag[0] < found.lag < lag[1]
    assert found.uniform.mean() > 0.85
    assert np.rad2deg(found.angle[-1]) == pytest.approx(30.0, abs=1.0)
    rows = found.at(np.array([5.0, 10.0, 15.0, 20.0, 25.0, 29.0]))
    assert np.all(np.diff(rows[:, 1:], axis=0) < 0.0)


def test_without_pressure_behind_it_the_valve_is_moved_at_one_current() -> None:
    """What falls in the current is the load: behind a valve under equal pressure on both sides it
    does not.
    """
    found = sweep(replace(Machine(), gas=GasGenerator(back_pressure_Pa=10e6)), PAPER_DEG_S)
    assert np.ptp(found.at(np.array([5.0, 15.0, 25.0]))[:, 1]) < 0.1


def test_where_there_are_no_samples_there_are_no_values() -> None:
    assert np.isnan(sweep(Machine(), PAPER_DEG_S).at(np.array([40.0]))[0, 1:]).all()


def test_a_joint_that_never_moves_uniformly_says_so() -> None:
    with pytest.raises(ValueError, match="at 50 deg/s the joint never moves uniformly"):
        sweep(replace(Machine(), joint=Joint(Ms_N_m=200.0)), PAPER_DEG_S)
