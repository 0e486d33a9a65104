"""Torque against speed: means of excitations only, bounded in number; the curve of the newest
identification.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.model.parameters import NOMINAL
from rig.common.provenance import IDENTIFY_SCHEMA, RESULT_FILE
from rig.console.followed import BLOCK, DEG, MOST, TorqueSpeed, curves


def samples(segments: list[int]) -> dict[str, Any]:
    segment = np.array(segments, dtype=float)
    return {
        "segment": segment,
        "velocity": 0.1 * segment,
        "current": 2.0 * segment,
    }


def test_points_are_means_within_one_excitation() -> None:
    found = TorqueSpeed()
    # 25 samples of the first excitation, a rest, 15 of the second: one block has both.
    for part in ([1] * 13, [1] * 12 + [0] * 30, [2] * 15):
        found.add(samples(part), 3.0)
    np.testing.assert_allclose(
        found.points, [[0.1 * DEG, 6.0, 1], [0.1 * DEG, 6.0, 1], [0.2 * DEG, 12.0, 2]]
    )


def test_their_number_is_bounded_and_every_part_of_the_run_stays() -> None:
    found = TorqueSpeed()
    for segment in range(1, 9):
        found.add(samples([segment] * BLOCK * (MOST // 2)), 1.0)
    assert MOST // 2 < len(found.points) <= MOST
    assert found.version > 0
    counts = [np.count_nonzero(found.points[:, 2] == segment) for segment in range(1, 9)]
    assert max(counts) - min(counts) <= 2


@pytest.mark.parametrize("identified", [False, True])
def test_the_curve_is_that_of_an_identification_of_this_bench(
    runner: Any, fake_bench: Any, identified: bool
) -> None:
    folder, _ = runner(fake_bench())
    if identified:
        result = {
            "schema": IDENTIFY_SCHEMA,
            "motion": "rotary",
            "parameters": {name: {"value": value} for name, value in NOMINAL.items()},
            "alpha": 2.0,
        }
        (folder.path / RESULT_FILE).write_text(json.dumps(result))
    found = curves(folder.record, folder.path)
    if not identified:
        assert found is None
        return
    assert found is not None
    assert [line["mass_kg"] for line in found["lines"]] == [0, 10]
    light, heavy = (np.array(line["torque"]) for line in found["lines"])
    assert np.all(heavy > light)
    assert light[-1] == pytest.approx(NOMINAL["Mc"] + 2.0 * NOMINAL["sigma_2"], rel=1e-3)


def test_a_place_without_a_run_has_no_curve(runner: Any, fake_bench: Any, tmp_path: Path) -> None:
    folder, _ = runner(fake_bench())
    assert curves(folder.record, tmp_path / "elsewhere" / "run") is None
