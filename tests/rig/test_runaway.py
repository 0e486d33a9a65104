"""A joint that runs away is cut, not braked: true peak and travel of the simulated machine."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.mock.plant.machine import LOOPS, Loop
from rig.cli.entry import status

from .true_motion import watch_machines

MOST = {"practical": (25.0, 0.4), "practical_serial": (35.0, 0.4), "practical_dbc": (45.0, 0.5)}
"""Bench to the greatest true speed, deg/s, and travel, deg, of a jog at 5 deg/s whose loop has the
wrong sign. A full current adds 21 deg/s to the speed in each millisecond.
"""


@pytest.mark.parametrize("bench", MOST)
@pytest.mark.parametrize("loop", LOOPS)
def test_a_jog_that_runs_away_is_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loop: Loop, bench: str
) -> None:
    monkeypatch.chdir(tmp_path)
    found = watch_machines(monkeypatch, loop)
    assert status(["jog", bench, "--to", "5", "--json", "jog.json"]) == 1
    record = json.loads(Path("jog.json").read_text())
    peak_deg_s, travel_deg = MOST[bench]
    assert found.peak_deg_s < peak_deg_s, found
    assert found.travel_deg < travel_deg, found
    assert "two swapped motor phases" in json.dumps(record)


@pytest.mark.parametrize("bench", MOST)
def test_a_jog_with_loops_of_the_right_sign_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bench: str
) -> None:
    monkeypatch.chdir(tmp_path)
    found = watch_machines(monkeypatch, None)
    assert status(["jog", bench, "--to", "5", "--to", "0"]) == 0
    assert found.peak_deg_s < 10.0
