"""Simulates worlds with the project's own machine, and returns the signals."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

import numpy as np

from benchmarks.worlds.gains import gains
from benchmarks.worlds.own_plant.machine import machine_of
from benchmarks.worlds.own_plant.sampled import SampledMachine, Sent
from benchmarks.worlds.sizes import SIZES
from benchmarks.worlds.world import COMMAND_S, Signals, World
from drivers.mock.plant.effects.outside import OUTSIDE

NOISE_STREAM, FLICKER_STREAM = 6, 10


class OwnPlant:
    """The project's own plant; see :class:`benchmarks.worlds.seal.Plant`.

    All friction is at the joint; if motor and joint are two bodies, the motor's side has no
    friction.
    """

    effects: Collection[str] = frozenset(n for n in SIZES if not n.startswith("x_"))
    outside: Collection[str] = frozenset(n for n in OUTSIDE if n in SIZES)
    not_scored: Collection[str] = frozenset()

    def play(self, world: World) -> Iterator[Signals]:
        """Yield the signals of the machine in each recording, which begins at rest at zero.

        If the log has session times, drifts continue and the winding cools during the pauses
        between recordings; else every recording begins cold.
        """
        session_s = heat_K = 0.0
        cooling_s = world.effects.get("winding_heating", {}).get("time_s", 1.0)
        for k, planned in enumerate(world.recordings):
            session_s = session_s + planned.pause_s if world.log.clock else 0.0
            heat_K = heat_K * math.exp(-planned.pause_s / cooling_s) if world.log.clock else 0.0
            signals, heat_K = _played(world, k, session_s, heat_K)
            yield signals
            session_s += len(planned.command) * COMMAND_S


def _played(world: World, k: int, session_s: float, heat_K: float) -> tuple[Signals, float]:
    """Return the signals of recording ``k``, and the temperature rise of the winding at its
    end, K.
    """
    planned, rate, gain = world.recordings[k], world.drive.rate_Hz, gains(world)
    machine = SampledMachine(
        machine_of(world),
        np.random.default_rng([*world.seed, NOISE_STREAM, k]),
        world.loop_count_rad,
        session_s,
        heat_K,
    )
    steady = planned.steady_N_m(world.gravity_m_s2)
    machine.press(world.contact_N(k))
    if planned.pendulum is not None:
        hung = planned.pendulum
        machine.fix_weight(hung.mass_kg, hung.length_m, hung.zero_rad)
    if steady or planned.hoisted_kg:
        machine.carry(steady, planned.hoisted_kg)
    machine.power(True)
    machine.hold(-steady)
    n = round(len(planned.command) * COMMAND_S * rate)
    command, torque = planned.sent(np.arange(n) / rate)
    flicker = np.random.default_rng([*world.seed, FLICKER_STREAM, k]).standard_normal(n)
    flicker *= world.sensing.flicker * world.loop_count_rad
    law = (gain.position, gain.velocity) if world.drive.host_Hz else None
    out = machine.sample(Sent(command, torque, world.host_sends(k, n), flicker), law)
    first = round(planned.lead_s * rate)
    signals = Signals(
        current=out.current_A[first:],
        voltage=out.voltage_V[first:],
        terminal=out.terminal_V[first:],
        supply=out.supply_V[first:],
        motor_angle=out.rotor_rad[first:] * world.motor.gear_ratio,
        angle=out.joint_rad[first:],
        command=command[first:],
        start_s=session_s + planned.lead_s,
        mean_current=out.mean_current_A[first:],
    )
    return signals, machine.heat_K
