"""Covered and free area of the valve opening over the valve angle (Fig. 3), in closed form.

The plate is a strip of width b that swings in its own plane about a pivot at distance L1 from the
opening's centre; its centre line passes through the pivot, and the centre of its hole is on this
line at distance L1 from the pivot. At the angle theta the distance of the opening's centre is L1
sin(theta) from this line and 2 L1 sin(theta/2) from the centre of the hole, so that

    A_t = (opening beside the strip) + (opening and hole),    A_s = pi D^2/4 - A_t.

The plate covers no part of the opening beyond the angle at which L1 sin(theta) = (b + D)/2, 29.65
deg.
"""

from __future__ import annotations

import math

from drivers.mock.plant.parts.compiled import inlined


@inlined
def disc_beyond(radius: float, distance: float) -> float:
    """Return the area of a disc on the far side of a line at this signed distance from its
    centre.
    """
    t = min(max(distance / radius, -1.0), 1.0)
    return radius * radius * (math.acos(t) - t * math.sqrt(1.0 - t * t))


@inlined
def lens(large: float, small: float, distance: float) -> float:
    """Return the area common to two discs of these radii, ``large`` >= ``small``, with their
    centres ``distance`` apart.
    """
    if distance >= large + small:
        return 0.0
    if distance <= large - small:
        return math.pi * small * small
    chord = 0.5 * (distance + (large * large - small * small) / distance)
    return disc_beyond(large, chord) + disc_beyond(small, distance - chord)


@inlined
def throat_area(angle: float, arm: float, hole: float, opening: float, half_width: float) -> float:
    """Return A_t, m^2, at a valve angle.

    Args:
        angle: Valve angle, rad; the areas do not depend on its sign.
        arm: L1, m.
        hole: Radius d/2, m.
        opening: Radius D/2, m.
        half_width: b/2, m; more than the hole's radius.
    """
    aside = arm * math.sin(abs(angle))
    free = disc_beyond(opening, half_width - aside) + disc_beyond(opening, half_width + aside)
    return free + lens(opening, hole, 2.0 * arm * math.sin(0.5 * abs(angle)))
