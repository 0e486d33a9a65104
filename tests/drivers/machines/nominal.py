"""The paper's machine as somebody else would write it: its own formulas and its own integrator.

The numbers are those of the bench `practical`.
"""

import math

KM, KE, R, L, GEAR = 0.03, 0.02588, 1.56, 0.00132, 100.0
J, MC, MS, OMEGA_SF, SIGMA_2 = 0.204, 6.825, 12.025, 0.0557, 5.3462
MU_C, MU_S, OMEGA_SL, MU_2 = 0.052, 0.086, 0.0326, 0.032
ARM, LEVER, GRAVITY = 0.095, 10.0, 9.80665


class Nominal:
    """Motor, rigid gear, Stribeck friction without and with load.

    Attributes:
        steps_per_call: Steps of the integrator, which is of first order, in each call.
    """

    steps_per_call = 2

    def reset(self, seed: int) -> None:
        self.seed = seed
        self.angle = self.speed = self.current = 0.0
        self.hang(0.0)

    def hang(self, mass_kg: float) -> None:
        self.moment = LEVER * mass_kg * GRAVITY * ARM

    def hidden(self) -> float:
        """Torque at the joint that nobody knows of, N m."""
        return 0.0

    def friction(self, speed: float) -> float:
        """Eq. 9 and 12, N m, at a speed >= 0."""
        own = MC + (MS - MC) * math.exp(-((speed / OMEGA_SF) ** 2)) + SIGMA_2 * speed
        load = MU_C + (MU_S - MU_C) * math.exp(-((speed / OMEGA_SL) ** 2)) + MU_2 * speed
        return own + self.moment * load

    def step(self, dt_s: float, voltage_V: float) -> tuple[float, float, float, float]:
        h = dt_s / self.steps_per_call
        decay = math.exp(-h * R / L)
        for _ in range(self.steps_per_call):
            before = self.current
            settled = (voltage_V - KE * GEAR * self.speed) / R
            self.current = settled + (before - settled) * decay
            torque = KM * GEAR * 0.5 * (before + self.current) + self.hidden()
            free = self.speed + h * torque / J
            # Friction slows the joint down, and holds it, but does not turn it round.
            slower = h * self.friction(abs(self.speed)) / J
            self.speed = math.copysign(max(abs(free) - slower, 0.0), free)
            self.angle += h * self.speed
        return GEAR * self.angle, self.angle, GEAR * self.speed, self.current


class Cogged(Nominal):
    """The same machine with a cogging torque that no bench file states."""

    def hidden(self) -> float:
        return 1.5 * math.sin(4.0 * GEAR * self.angle + 0.4)
