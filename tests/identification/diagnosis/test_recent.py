"""Series of one diagnosis do not stay in memory during the next ones."""

from __future__ import annotations

import gc
import weakref

import pytest

from identification.diagnosis.diagnose import diagnose
from identification.effects import MOTION
from identification.recording import Dataset, Model, RecordingError
from identification.views.view import views

from .benches import honest, nominal_fit


def test_the_next_diagnosis_releases_the_recordings_of_the_one_before() -> None:
    joint = nominal_fit(honest()[:1])
    (view,) = views(honest()[:1], 25.0)
    term = next(t for t in MOTION if t.name == "presliding")
    term.columns["torque"](view, joint.nominal, (1e4,))
    kept = weakref.ref(view)
    del view
    gc.collect()
    assert kept() is not None
    with pytest.raises(RecordingError):
        diagnose(Dataset((), Model()))
    gc.collect()
    assert kept() is None
