"""Sequence file section for flow control: commanded gas flow over time and pressure controller."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rig.config.configuration import NonNegative, Positive, Schema

Array = NDArray[np.float64]


class FlowStep(Schema):
    """A gas flow that is commanded from a stated time on.

    Attributes:
        at_s: Time since the start of the excitation; the first step is at 0.
        flow_kg_s: Commanded mass flow.
    """

    at_s: NonNegative
    flow_kg_s: Positive


class FlowController(Schema):
    """PI controller of the logarithm of the ratio of measured to desired pressure (Fig. 5, 11). The
    default gains are assumptions, because the paper gives no gains.

    The commanded valve angle stays within the range, and its rate within the speed limit; while one
    of these limits acts, the integral part does not change.

    Attributes:
        gain_deg: Valve angle per unit of the logarithm; a pressure deviation of one percent is
            about 0.01 units.
        integral_1_s: Inverse reset time.
        filter_Hz: Cut-off of the low-pass on the measured pressure.
        angle_min_deg: Lowest valve angle.
        angle_max_deg: Highest valve angle.
        speed_deg_s: Highest valve speed.
    """

    gain_deg: Positive = 8.0
    integral_1_s: NonNegative = 8.0
    filter_Hz: Positive = 10.0
    angle_min_deg: float = 0.0
    angle_max_deg: float = 30.0
    speed_deg_s: Positive = 50.0

    @model_validator(mode="after")
    def _range_is_open(self) -> Self:
        if not self.angle_min_deg < self.angle_max_deg:
            raise ValueError(
                f"angle_min_deg {self.angle_min_deg:g} must be below angle_max_deg "
                f"{self.angle_max_deg:g}; exchange the two values"
            )
        return self


class FlowSection(Schema):
    """A flow command over time.

    Attributes:
        steps: Flow steps, in order.
        ramp_s: Time that each step takes.
        controller: The pressure controller.
    """

    steps: Annotated[tuple[FlowStep, ...], Field(min_length=1)]
    ramp_s: NonNegative = 0.2
    controller: FlowController = FlowController()

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times = [step.at_s for step in self.steps]
        if times[0] != 0.0:
            raise ValueError(
                f"the first step must be at 0 s, the start of the excitation (got at_s "
                f"{times[0]:g})"
            )
        for earlier, later in pairwise(times):
            if later <= earlier + self.ramp_s:
                raise ValueError(
                    f"the step at {later:g} s begins before the step at {earlier:g} s ends "
                    f"(ramp_s {self.ramp_s:g}); "
                    "list the steps in order of time, further apart than ramp_s"
                )
        return self

    def command(self, duration_s: float, cycle_s: float) -> Array:
        """Return the commanded flow in each cycle, kg/s, shape (n,)."""
        t = np.arange(round(duration_s / cycle_s)) * cycle_s
        corners = [(0.0, self.steps[0].flow_kg_s)]
        for before, step in pairwise(self.steps):
            corners += [
                (step.at_s, before.flow_kg_s),
                (step.at_s + max(self.ramp_s, cycle_s), step.flow_kg_s),
            ]
        times, flows = np.array(corners).T
        return np.asarray(np.interp(t, times, flows))
