"""The recording without the bus: the same samples as over the bus, for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import record

from .host import CYCLE_S, enabled, make_host

SEED = 5
HIDING = {
    "backlash": {"gap_rad": 0.003},
    "transport_delay": {"time_s": 0.0041},
    "current_offset": {"current_A": 0.2},
    "supply_sag": {"resistance_ohm": 0.3},
}


def load(machine: SimulatedMachine, weight: float | None) -> None:
    """Hang a weight, or light the gas generator."""
    if weight is None:
        machine.ignite()
    else:
        machine.hang(weight)


@pytest.mark.parametrize("effects", [{}, HIDING], ids=["nominal", "hiding"])
@pytest.mark.parametrize("weight", [0.0, 30.6, None], ids=["unloaded", "30.6 kg", "hot firing"])
def test_it_gives_the_samples_that_go_over_the_bus(effects, weight):
    constants = replace(Machine(), effects=effects, warming_K=900.0, warming_s=50.0)
    cycles = 1500
    command = 0.2 * (1.0 - np.cos(2.0 * np.pi * np.arange(cycles) * CYCLE_S))
    host = make_host(SEED, constants)
    machine, sampler = host.bench.machine, host.bench.sampler
    load(machine, weight)
    switched: list[int] = []
    switch = machine.power

    def power(on: bool) -> None:
        if on:
            switched.append(sampler.time_ns)
        switch(on)

    machine.power = power  # type: ignore[method-assign]
    enabled(host)
    due = host.clock.now_ns() + 1_000_000
    rows, latched_ns = [], []
    for target in command:
        host.clock.sleep_until_ns(due)
        due += 1_000_000
        host.servo.set_target(float(target))
        host.link.exchange()
        servo, encoder = host.servo.sample(), host.encoder.sample()
        latched_ns.append(sampler.time_ns)
        instant = (servo.motor_angle_rad, encoder.angle_rad, servo.velocity_rad_s)
        rows.append(
            (
                *instant,
                servo.current_A,
                servo.voltage_V,
                servo.supply_voltage_V,
                servo.temperature_C,
            )
        )
    host.link.close()
    assert len(switched) == 1
    assert set(np.diff(latched_ns)) == {1_000_000}

    bus = np.array(rows).T
    phase = (9 - np.flatnonzero(np.diff(bus[6]))[0]) % 10
    simulated = SimulatedMachine(constants, np.random.default_rng(SEED).spawn(2)[0])
    load(simulated, weight)
    simulated.advance(switched[0])
    simulated.power(True)
    simulated.advance(latched_ns[0] - 1_000_000 - switched[0])
    simulated.latch()
    fast = record(simulated, command, slow_phase=int(phase))
    assert np.ptp(fast.angle) > 0.35
    assert np.ptp(fast.temperature) > 10.0
    np.testing.assert_array_equal(np.array([fast.motor_angle, fast.angle, fast.velocity]), bus[:3])
    assert simulated.truth() == machine.truth()
    # The means of the first cycle began with another latch, and the slow frame before it is not
    # known here.
    np.testing.assert_array_equal(np.array([fast.current, fast.voltage])[:, 1:], bus[3:5, 1:])
    np.testing.assert_array_equal(
        np.array([fast.supply_voltage, fast.temperature])[:, 10:], bus[5:, 10:]
    )


def test_a_cycle_between_loop_periods_is_refused() -> None:
    machine = SimulatedMachine(Machine(), np.random.default_rng(0))
    with pytest.raises(ValueError, match="whole number of loop periods"):
        record(machine, np.zeros(3), cycle_s=0.00102)


def test_noise_is_the_same_however_it_is_taken() -> None:
    """A recording longer than a block of noise, after a start within one, draws what single steps
    draw.
    """
    found = []
    for steps in ((7_000, 3_500, 300), (10_800,)):
        machine = SimulatedMachine(Machine(), np.random.default_rng(3))
        machine.advance(1_000_000)
        machine.power(True)
        found.append(np.concatenate([record(machine, np.zeros(n)).current for n in steps]))
    np.testing.assert_array_equal(found[0], found[1])
