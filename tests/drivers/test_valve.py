"""The valve's areas (Fig. 3) against polygons, against random points, and against what the paper
says of them.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.plant.gas import impacted_area, throat_area
from drivers.mock.plant.parts.constants import Machine

Array = NDArray[np.float64]

MACHINE = Machine()
HOLE, OPENING, WIDTH, ARM = 0.025, 0.040, 0.054, 0.095
ANGLES_DEG = (0.0, 4.3, 4.5, 12.0, 19.5, 19.8, 27.0, 29.6, 29.7)


def turned(points: Array, angle: float) -> Array:
    """Turn points, shape (n, 2), about the pivot, which is the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def circle(diameter: float, sides: int = 1500) -> Array:
    """Return a regular polygon of the circle's area, its centre at (L1, 0)."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    radius = 0.5 * diameter * np.sqrt(2.0 * np.pi / sides / np.sin(2.0 * np.pi / sides))
    return np.column_stack((ARM + radius * np.cos(turn), radius * np.sin(turn)))


def area(polygon: Array) -> float:
    """Return the area of a polygon given anticlockwise."""
    x, y = polygon[:, 0] - ARM, polygon[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) if len(polygon) else 0.0


def clipped(polygon: Array, by: Array) -> Array:
    """Return what a convex polygon leaves of another (Sutherland and Hodgman); both
    anticlockwise.
    """
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        if not len(polygon):
            break
        edge = end - start
        inside = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
        if np.all(inside >= 0.0):
            continue
        following, after = np.roll(polygon, -1, axis=0), np.roll(inside, -1)
        crosses = (inside >= 0.0) != (after >= 0.0)
        share = inside / np.where(crosses, inside - after, 1.0)
        cut = polygon + share[:, None] * (following - polygon)
        both = np.stack((polygon, cut), axis=1)
        polygon = both[np.stack((inside >= 0.0, crosses), axis=1)]
    return polygon


def by_polygons(angle: float) -> float:
    """Return the impacted area of a plate cut from polygons and turned about its pivot, m^2."""
    opening = circle(OPENING)
    corners = np.array([(-0.03, -0.5), (0.15, -0.5), (0.15, 0.5), (-0.03, 0.5)]) * (1.0, WIDTH)
    plate = clipped(opening, turned(corners, angle))
    return area(plate) - area(clipped(opening, turned(circle(HOLE), angle)))


@pytest.mark.parametrize("degrees", ANGLES_DEG)
def test_areas_are_those_of_polygons(degrees: float) -> None:
    angle = np.deg2rad(degrees)
    assert impacted_area(MACHINE, np.array([angle]))[0] == pytest.approx(
        by_polygons(float(angle)), abs=1e-9
    )


def test_the_closed_valve_leaves_its_hole_and_the_open_one_everything() -> None:
    angles = np.deg2rad([0.0, 29.64, 29.66, 30.0])
    covered = impacted_area(MACHINE, angles)
    assert covered[0] == pytest.approx(7.66e-4, abs=5e-7)
    assert throat_area(MACHINE, angles)[0] == pytest.approx(0.25 * np.pi * HOLE**2, rel=1e-12)
    assert covered[1] > 0.0
    assert covered[2] == covered[3] == 0.0


def test_both_areas_make_the_opening_and_the_throat_only_grows() -> None:
    angles = np.deg2rad(np.linspace(0.0, 30.0, 3001))
    throat, covered = throat_area(MACHINE, angles), impacted_area(MACHINE, angles)
    np.testing.assert_allclose(throat + covered, 0.25 * np.pi * OPENING**2, rtol=1e-15)
    assert np.all(np.diff(throat) >= 0.0)
    np.testing.assert_array_equal(throat_area(MACHINE, -angles), throat)
