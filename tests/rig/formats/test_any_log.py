"""Random logs of every format: read to the last bit, or something is said; and damaged files."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.rig.formats.shapes import PROPERTIES


@pytest.mark.parametrize("kind", PROPERTIES)
def test_any_log_is_read_right_or_something_is_said(kind: str, tmp_path: Path) -> None:
    logs, holds = PROPERTIES[kind]

    @settings(max_examples=40, suppress_health_check=list(HealthCheck))
    @given(st.integers(0, 2**63))
    def run(number: int) -> None:
        holds(logs(Random(number)), tmp_path)

    run()
