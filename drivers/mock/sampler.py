"""Common access of the simulated devices to one machine: integrates it and samples it in time."""

from __future__ import annotations

import math

from drivers.mock.plant.machine import DrivenMachine, Reading
from drivers.mock.plant.parts import constants


class Sampler:
    """Integrates the machine up to the simulated time.

    The machine advances in whole loop periods; the sampled values therefore belong to the time
    :attr:`time_ns`, which is at most one loop period before the requested time.
    """

    def __init__(self, machine: DrivenMachine, now_ns: int = 0) -> None:
        # The machine; `advance` must be called before a command to the machine.
        self.machine = machine
        self.time_ns = now_ns  # simulated time up to which the machine is integrated
        self._loop_ns = machine.loop_ns
        self._last: Reading | None = None
        self._last_ns = now_ns
        self._parts = 0
        self._pending_ns = 0
        self._pending_current = 0.0
        self._pending_voltage = 0.0

    def advance(self, now_ns: int) -> None:
        """Integrate to the last loop period that ends by ``now_ns``."""
        step = now_ns - self.time_ns
        step -= step % self._loop_ns
        if step > 0:
            self.machine.advance(step)
            self.time_ns += step

    def peek(self, now_ns: int) -> Reading:
        """Return the reading at ``now_ns`` without ending the averaging period."""
        if now_ns - self.time_ns >= self._loop_ns:
            self.advance(now_ns)
        if self._last is not None and self._last_ns == self.time_ns:
            return self._last
        span = self.time_ns - self._last_ns
        reading = self.machine.latch()
        self._parts += 1
        self._pending_ns += span
        self._pending_current += reading.current_A * span
        self._pending_voltage += reading.voltage_V * span
        self._last, self._last_ns = reading, self.time_ns
        return reading

    def latch(self, now_ns: int) -> Reading:
        """Return the reading with means since the last call, and start new means."""
        reading = self.peek(now_ns)
        span = self._pending_ns
        if self._parts > 1 and span:
            reading = reading._replace(
                current_A=self._pending_current / span, voltage_V=self._pending_voltage / span
            )
        self._parts = self._pending_ns = 0
        self._pending_current = self._pending_voltage = 0.0
        return reading


def encoder_resolution(machine: constants.Machine) -> tuple[int, int]:
    """Return a number of motor encoder increments and the corresponding motor turns (608Fh).

    With an exact sensor the machine counts microradians of the joint; with 100 turns this ratio is
    exact to about 1e-9.
    """
    counts = machine.sensing.motor_counts_per_turn
    if counts:
        return counts, 1
    return round(2e8 * math.pi / machine.motor.gear_ratio), 100
