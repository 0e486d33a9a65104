"""Random EDS files, DBC files and maps: read as they state, or refused in words."""

from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from . import dbc_shapes, eds_shapes, map_shapes

TEXTS = {**eds_shapes.TEXTS, **dbc_shapes.TEXTS, **map_shapes.TEXTS}


@pytest.mark.parametrize("kind", TEXTS)
def test_any_text_is_read_as_it_states_or_refused(kind: str, tmp_path: Path) -> None:
    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.integers(0, 2**63))
    def run(number: int) -> None:
        TEXTS[kind](Random(number), tmp_path / f"text.{kind[:3].lower()}")

    run()
