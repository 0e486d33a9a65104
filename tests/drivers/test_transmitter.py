"""The pressure transmitter over the wire: unit, noise, range, and what a wrong one is told."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia404Transmitter, unit_of
from drivers.errors import ConfigurationError
from drivers.mock.bench import TRANSMITTER_NODE, SimulatedBench, simulated_bench
from drivers.mock.encoder import PRESSURE_UNIT_PA, TRANSMITTER_EDS
from drivers.mock.plant.parts.constants import GasGenerator, Machine, Transmitter


def fitted(
    built: Transmitter | None = None, unit_Pa: float = PRESSURE_UNIT_PA
) -> tuple[SimulatedBench, CanopenLink, Cia404Transmitter]:
    machine = replace(Machine(), gas=GasGenerator(transmitter=built or Transmitter()))
    bench = simulated_bench(machine, seed=3, transmitter_node=TRANSMITTER_NODE)
    link = CanopenLink(bench.clock, lambda: bench.bus, "simulated bus")
    transmitter = Cia404Transmitter(link.add_node(TRANSMITTER_NODE, TRANSMITTER_EDS), unit_Pa)
    link.open()
    return bench, link, transmitter


def readings(
    bench: SimulatedBench, link: CanopenLink, transmitter: Cia404Transmitter, count: int
) -> list[float]:
    found = []
    for _ in range(count):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000)
        link.exchange()
        sample = transmitter.sample()
        assert sample.fresh
        found.append(sample.pressure_Pa)
    return found


def test_it_sends_the_chamber_pressure_with_its_noise() -> None:
    bench, link, transmitter = fitted()
    assert transmitter.identity().product_code == 0x404
    bench.machine.ignite()
    transmitter.prepare(0.001)
    found = np.array(readings(bench, link, transmitter, 800))
    assert found.mean() == pytest.approx(bench.machine.truth().pressure_Pa, abs=200.0)
    assert found.std() == pytest.approx(Transmitter().noise_Pa, rel=0.1)
    np.testing.assert_allclose(
        found / PRESSURE_UNIT_PA, np.rint(found / PRESSURE_UNIT_PA), atol=1e-6
    )


def test_beyond_its_range_nothing_is_fresh() -> None:
    bench, link, transmitter = fitted(Transmitter(range_Pa=4e6))
    transmitter.prepare(0.001)
    assert readings(bench, link, transmitter, 3) == pytest.approx([0.5e6] * 3, abs=1e4)
    bench.machine.ignite()
    for _ in range(2):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000)
        link.exchange()
    assert transmitter.sample() == (4e6, False)
    with pytest.raises(ConfigurationError, match="above its range"):
        transmitter.prepare(0.001)


def test_a_frame_may_be_lost_but_not_two() -> None:
    bench, link, transmitter = fitted()
    transmitter.prepare(0.001)
    readings(bench, link, transmitter, 3)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 500_000)
    bench.bus.frame_filters.append(
        lambda _t, identifier, data, _h: None if identifier == 0x184 else (identifier, data)
    )
    seen = []
    for _ in range(4):
        bench.clock.sleep_until_ns(bench.clock.now_ns() + 1_000_000)
        link.exchange()
        seen.append(transmitter.sample().fresh)
    assert seen == [True, False, False, False]


@pytest.mark.parametrize(
    ("code", "digits", "pascals"),
    [
        (0x004E0000, 3, 100.0),
        (0x00220000, 0, 1.0),
        (0x03220000, 1, 100.0),
        (0xFD4E0000, 0, 100.0),
        (0x00AB0000, 0, 6894.757),
    ],
)
def test_units_of_pressure(code: int, digits: int, pascals: float) -> None:
    assert unit_of(code, digits) == pytest.approx(pascals)


@given(code=st.integers(0, 0xFFFFFFFF), digits=st.integers(0, 255))
def test_any_unit_is_decoded_or_refused(code: int, digits: int) -> None:
    found = unit_of(code, digits)
    assert found is None or found >= 0.0
