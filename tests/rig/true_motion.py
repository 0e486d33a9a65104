"""The true motion of the simulated machines of a test, with one loop of the drive reversed."""

import math
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.mock.plant.machine import Loop, SimulatedMachine

FINE_LOOPS = 2
"""Loop periods between two looks at a machine that moves."""


@dataclass
class TrueMotion:
    """Greatest true speed and travel of the joint, by what the program did."""

    speeds_deg_s: list[float] = field(default_factory=lambda: [0.0], repr=False)
    angles_deg: list[float] = field(default_factory=lambda: [0.0], repr=False)

    @property
    def peak_deg_s(self) -> float:
        return max(self.speeds_deg_s)

    @property
    def travel_deg(self) -> float:
        return max(self.angles_deg) - min(self.angles_deg)

    def __str__(self) -> str:
        return f"peak {self.peak_deg_s:.1f} deg/s, travel {self.travel_deg:.2f} deg"


def watch_machines(monkeypatch: pytest.MonkeyPatch, loop: Loop | None = None) -> TrueMotion:
    """Reverse a loop in every machine that is built from now on, and return its true motion."""
    found, build, advance = TrueMotion(), SimulatedMachine.__init__, SimulatedMachine.advance

    def built(self: SimulatedMachine, *arguments: Any, **keys: Any) -> None:
        build(self, *arguments, **keys)
        if loop is not None:
            self.reverse(loop)

    def looked(self: SimulatedMachine, duration_ns: int) -> None:
        while duration_ns > 0:
            moving = self.truth().velocity_rad_s != 0.0
            step = min(duration_ns, FINE_LOOPS * self.loop_ns) if moving else duration_ns
            advance(self, step)
            duration_ns -= step
            truth = self.truth()
            found.speeds_deg_s.append(abs(math.degrees(truth.velocity_rad_s)))
            found.angles_deg.append(math.degrees(truth.angle_rad))

    monkeypatch.setattr(SimulatedMachine, "__init__", built)
    monkeypatch.setattr(SimulatedMachine, "advance", looked)
    return found
