"""Random logs of every format: read to the last bit, or something is said; and damaged files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings

from tests.rig.formats.shapes import PROPERTIES


@pytest.mark.parametrize("kind", PROPERTIES)
def test_any_log_is_read_right_or_something_is_said(kind: str, tmp_path: Path) -> None:
    logs, holds = PROPERTIES[kind]

    @settings(max_examples=40, suppress_health_check=list(HealthCheck))
    @given(logs)
    def run(case: Any) -> None:
        holds(case, tmp_path)

    run()
