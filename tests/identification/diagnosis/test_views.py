"""Which motion of a recording is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.rows.view import LEAST_STEADY_ROWS, View, views

from .benches import honest


def shortened(samples: int) -> View:
    """Return a view of the first samples of a recording with several reversals."""
    whole = honest()[1]
    channels = {name: values[:samples] for name, values in whole.channels.items()}
    (view,) = views([replace(whole, channels=channels)], 25.0)
    return view


@pytest.mark.parametrize(("samples", "enough"), [(1500, False), (3000, True)])
def test_unsteady_motion_is_used_where_steady_motion_determines_nothing(
    samples: int, enough: bool
) -> None:
    view = shortened(samples)
    assert (np.sum(view.moving) < np.sum(view.unsteady)) == enough
    assert (np.sum(view.moving) >= LEAST_STEADY_ROWS) == enough
