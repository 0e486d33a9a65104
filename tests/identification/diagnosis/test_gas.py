"""The gas generator diagnosed: what is hidden gets its name and size, what is not gets none."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.gas import GasNominal, burns, diagnose_gas
from identification.diagnosis.result import Verdict
from identification.effects import GAS
from identification.effects.effect import Context
from identification.effects.gas_generator import GasGeneratorEffect
from identification.recording import Dataset, Recording, RecordingError

from .burning import BENCH, MOVING, NOISE_PA, TRUE, honest, pauses, recordings

HIDDEN: Mapping[str, Mapping[str, float]] = {
    "throat_deposition": {"rate_m_s": 6e-6},
    "burning_area_change": {"taper_per_m": -0.06},
    "erosive_burning": {"coefficient_s_m": 0.02},
    "heat_loss": {"heat_flow_W": 8e4, "time_s": 4.0},
    "leakage": {"area_m2": 1.5e-5},
}


def test_nothing_is_missing_where_only_the_constants_are_off() -> None:
    found = diagnose_gas(honest())
    assert found.verdict is Verdict.NOTHING_MISSING
    assert not found.effects
    assert found.fit.noise_floor_rms == pytest.approx(NOISE_PA, rel=0.03)
    assert found.fit.validate_final_rms == pytest.approx(NOISE_PA, rel=0.05)
    assert {name: found.parameters[name] for name in TRUE} == pytest.approx(TRUE, rel=0.01)
    assert found.parameters["V_0"] == pytest.approx(0.011, rel=0.02)


@pytest.mark.proof
@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_is_named_and_sized(name: str) -> None:
    found = diagnose_gas(recordings({name: HIDDEN[name]}))
    assert found.verdict is Verdict.NAMED
    (effect,) = found.effects
    assert effect.name == name
    assert effect.alias_group == (name,)
    for key, true in HIDDEN[name].items():
        assert effect.parameters[key].value == pytest.approx(true, rel=0.15)
        assert (
            effect.parameters[key].low < effect.parameters[key].value < effect.parameters[key].high
        )
    assert found.fit.validate_baseline_rms is not None
    # The walls of plant and model warm by different laws: a twelfth of the noise is left of 80 kW.
    assert found.fit.validate_final_rms == pytest.approx(
        NOISE_PA, rel=0.1 if name == "heat_loss" else 0.05
    )
    assert found.fit.validate_baseline_rms > found.fit.validate_final_rms
    assert {t.role for t in found.traces} == {"fit", "validate"}


def test_a_still_valve_cannot_tell_what_a_moving_one_can() -> None:
    still = [pauses(8.0), pauses(8.0)]
    found = diagnose_gas(recordings({"throat_deposition": HIDDEN["throat_deposition"]}, still, ()))
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"throat_deposition", "burning_area_change"} <= set(found.effects[0].alias_group)
    assert "These recordings cannot distinguish" in found.statement
    assert any("hardly changes" in w for w in found.warnings)


UNKNOWN: Mapping[str, Mapping[str, float]] = {
    "x_propellant_bands": {"share": 0.03, "length_m": 0.02},
    "x_burning_wave": {"share": 0.02, "frequency_Hz": 2.0},
    "x_throat_wear": {"rate_m_s": 6e-6},
    "x_slag_puffs": {"share": 0.05, "period_s": 2.0, "length_s": 0.3},
}


@pytest.mark.parametrize(
    "name",
    [n if n == "x_slag_puffs" else pytest.param(n, marks=pytest.mark.proof) for n in UNKNOWN],
)
def test_what_is_in_no_catalogue_gets_no_name(name: str) -> None:
    found = diagnose_gas(recordings({name: UNKNOWN[name]}, MOVING[:2]))
    assert found.verdict is Verdict.OUTSIDE_CATALOGUE
    assert not found.effects
    assert len(found.curve.grid) == len(found.curve.value)
    assert found.location is not None


@pytest.mark.proof
def test_two_effects_at_once() -> None:
    both = {name: HIDDEN[name] for name in ("leakage", "burning_area_change")}
    found = diagnose_gas(recordings(both))
    assert {e.name for e in found.effects} == set(both)
    sizes = {k: e.value for effect in found.effects for k, e in effect.parameters.items()}
    assert sizes == pytest.approx({"area_m2": 1.5e-5, "taper_per_m": -0.06}, rel=0.2)


def test_a_valve_and_sensors_that_are_a_little_off_are_no_physics() -> None:
    true = honest()
    valve = replace(BENCH.gas_generator.valve, d=0.02503, D=0.03998, b=0.05402)
    bench = replace(BENCH, gas_generator=replace(BENCH.gas_generator, valve=valve))

    def off(r: Recording) -> Recording:
        late = np.interp(r.time - 1e-3, r.time, r.channels["pressure"] + 2.5e3)
        return replace(
            r,
            bench=bench,
            channels={**r.channels, "angle": r.channels["angle"] + 7e-4, "pressure": late},
        )

    found = diagnose_gas(Dataset(tuple(off(r) for r in true.recordings)))
    assert found.verdict is Verdict.NOTHING_MISSING
    assert found.parameters["angle_zero"] == pytest.approx(-7e-4, abs=2e-4)
    assert found.parameters["delay"] == pytest.approx(1e-3, abs=3e-4)
    assert not any("would need constants that differ" in w for w in found.warnings)


def test_a_belief_that_is_far_off_is_told() -> None:
    raised = tuple(
        replace(r, channels={**r.channels, "pressure": r.channels["pressure"] + 5e4})
        for r in honest().recordings[:2]
    )
    found = diagnose_gas(Dataset(raised))
    assert found.verdict is not Verdict.NOTHING_MISSING
    assert any("pressure_zero by" in w for w in found.warnings)


@pytest.mark.parametrize("term", GAS, ids=lambda t: t.name)
def test_the_response_times_the_size_is_what_an_effect_adds(term: GasGeneratorEffect) -> None:
    (burn,) = burns(honest().part("fit")[:1])
    plain = GasNominal.believed((burn,))
    values = {q.name: 0.02 * q.high for q in term.parameters}
    shape, (size,) = term.at(values, plain)
    assert term.read(np.array([size]), shape, Context((), plain)) == values
    acting = plain.with_effect(term, size, shape)
    added = acting.signal(burn) - plain.signal(burn)
    assert np.max(np.abs(added)) > 1e3
    assert size * term.pressure(burn, acting, shape)[0] == pytest.approx(added, rel=1e-9, abs=1e-6)
    small = size * term.pressure(burn, plain, shape)[0]
    assert small == pytest.approx(added, abs=0.2 * np.max(np.abs(added)))


def infeasible(**channels: np.ndarray | None) -> Dataset:
    """Return one recording with channels replaced, or left out."""
    (first, *_) = honest().recordings
    mixed = {**first.channels, **channels}
    return Dataset((replace(first, channels={k: v for k, v in mixed.items() if v is not None}),))


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ({"pressure": None}, "burn_0: the recording has no pressure"),
        ({"angle": None}, "burn_0: the recording has no angle"),
        ({"pressure": np.linspace(4e6, -1e5, 800)}, "falls to -100000 Pa"),
        ({"pressure": np.full(800, 4e6)}, "pressure channel is constant"),
    ],
)
def test_recordings_that_cannot_be_used(channels: dict[str, np.ndarray | None], words: str) -> None:
    with pytest.raises(RecordingError, match=words):
        diagnose_gas(infeasible(**channels))


def test_a_bench_without_constants_or_a_short_burn() -> None:
    (first, *_) = honest().recordings
    with pytest.raises(RecordingError, match=r"no bench\.gas_generator"):
        burns([replace(first, bench=replace(first.bench, gas_generator=None))])
    short = {name: values[:40] for name, values in first.channels.items()}
    with pytest.raises(RecordingError, match="40 samples give 40 averages over 5 ms; at least 50"):
        burns([replace(first, channels=short)])
