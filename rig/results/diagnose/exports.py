"""Files beside a diagnosis: the corrected model, and the experiment that splits a group."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from identification.diagnosis.gas import PRESSURE
from identification.diagnosis.result import Diagnosis, Verdict
from identification.effects import EFFECTS
from identification.effects.effect import Effect, Separation
from identification.effects.model import CorrectedModel
from identification.export.python import python_text
from identification.numerics.arrays import plain
from identification.recording import Bench as Constants
from identification.recording import Recording
from rig.common.errors import InputError
from rig.common.places import source_name
from rig.config.bench import Bench
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_file import model_of

TRAVEL_SHARE = 0.85
SPEED_SHARE = 0.5
WEIGHT_SHARE = 0.75  # shares of a bench's limits that an experiment uses
_LIGHT = 1.0 / 3.0
_SLOW_HZ = 0.1
_SPEED_STEPS = (0.1, 0.2, 0.4, 1.0)
_RESTS_S = (0.1, 0.5, 2.0, 8.0)
_STILL_DEG = 0.02
"""Amplitude, deg, at which friction holds the joint while its holding torque is recorded."""


@dataclass(frozen=True)
class Room:
    """Part of a bench's limits that an experiment may use."""

    travel_deg: float
    speed_deg_s: float
    weight_kg: float

    @classmethod
    def of(cls, bench: Bench) -> Room:
        """Return the part of a bench's limits for an experiment, symmetric about zero."""
        limits = bench.limits
        per_kg = bench.machine.lever_ratio * bench.machine.gravity_m_s2
        return cls(
            TRAVEL_SHARE * max(min(limits.angle_max_deg, -limits.angle_min_deg), 0.0),
            SPEED_SHARE * limits.speed_deg_s,
            WEIGHT_SHARE * min(limits.weight_kg, limits.contact_force_N / per_kg),
        )

    def frequency(self, amplitude_deg: float, share: float = 1.0) -> float:
        """Return the frequency, Hz, of a sine that reaches a share of the speed limit."""
        return share * self.speed_deg_s / (2.0 * math.pi * amplitude_deg)


@dataclass(frozen=True)
class _Stage:
    name: str
    amplitude_deg: float
    frequency_Hz: float
    periods: float = 3.0
    weight_kg: float = 0.0
    repeats: int = 1
    settle_s: float = 0.5
    center_deg: float = 0.0

    def line(self) -> str:
        duration = max(self.periods / self.frequency_Hz, 4.0)
        stage = "loaded" if self.weight_kg else "unloaded"
        return (
            f"  - {{name: {self.name}, stage: {stage}, weight_kg: {self.weight_kg:.4g}, tones: "
            f"[{{amplitude_deg: {self.amplitude_deg:.4g}, frequency_Hz: "
            f"{self.frequency_Hz:.4g}}}], duration_s: {duration:.4g}, repeats: {self.repeats}, "
            f"settle_s: {self.settle_s:g}, center_deg: {self.center_deg:.4g}}}"
        )


def recipes(room: Room) -> Mapping[Separation, Sequence[_Stage]]:
    """Return the stages of each kind of experiment within a part of a bench's limits."""
    travel, weight = room.travel_deg, room.weight_kg
    half, small = 0.5 * travel, 0.1 * travel
    fast, top = room.frequency(half), room.frequency(small)
    slow, quick = room.frequency(travel, 0.1), room.frequency(travel)
    loads = (("unloaded", 0.0), ("light", _LIGHT * weight), ("heavy", weight))
    orders = (("rising", _SPEED_STEPS), ("falling", _SPEED_STEPS[::-1]))
    rests = (_RESTS_S[2], _RESTS_S[0], _RESTS_S[3], _RESTS_S[1])
    whole = _Stage("whole-travel", travel, 0.3 * _SLOW_HZ, 2.0)
    holds = []
    for load, mass in (loads[0], loads[2]):
        for side, away in (("above", 0.6 * travel), ("below", -0.6 * travel)):
            move = _Stage(f"{load}-to-{side}", 0.2 * travel, _SLOW_HZ, 1.0, mass, center_deg=away)
            still = f"{load}-held-from-{side}"
            holds += [move, _Stage(still, _STILL_DEG, 0.25, 2.0, mass, settle_s=1.0)]
    cold, warm, rested = (
        (_Stage(f"{when}-slow", travel, slow, 2.0), _Stage(f"{when}-fast", travel, quick, 5.0))
        for when in ("cold", "warm", "rested")
    )
    work = _Stage("work", travel, quick, 120.0 * quick, weight)
    return {
        Separation.LOADS: [_Stage(n, travel, _SLOW_HZ, weight_kg=mass) for n, mass in loads],
        Separation.LOADS_AND_SPEEDS: [
            _Stage(f"{load}-{speed}", half, frequency, weight_kg=mass)
            for load, mass in (loads[0], loads[2])
            for speed, frequency in (("slow", 0.1 * fast), ("fast", fast))
        ],
        Separation.FREQUENCIES: [
            _Stage("fast", small, top, 10.0),
            _Stage("half-as-fast", small, 0.5 * top, 10.0),
            _Stage("slow-loaded", small, 0.05 * top, weight_kg=weight),
        ],
        Separation.SPEEDS: [
            _Stage(f"speed-{order}-{k}", travel, room.frequency(travel, share))
            for order, shares in orders
            for k, share in enumerate(shares, 1)
        ],
        Separation.SLOW: [
            _Stage(f"slow-{k}", 0.2 * travel, f, 2.0)
            for k, f in enumerate((0.02, 0.05, 0.1, 0.2), 1)
        ],
        Separation.RESTS: [
            _Stage(f"rest-{rest:g}s", small, 0.25, 1.0, repeats=4, settle_s=rest) for rest in rests
        ],
        Separation.SMALL_LOOPS: [
            _Stage(f"{size}-after-{rest}-rest", share * travel, 0.5, 4.0, 0.0, 2, settle)
            for size, share in (("tiny", 0.002), ("small", 0.02))
            for rest, settle in (("short", 0.2), ("long", 8.0))
        ],
        Separation.TRAVEL: [whole, replace(whole, name="whole-travel-loaded", weight_kg=weight)],
        Separation.SESSION: [*cold, work, *warm, replace(rested[0], settle_s=300.0), rested[1]],
        Separation.HOLD: [*holds, whole],
        Separation.AFTER_HANGING: [
            _Stage(f"loaded-{when}", travel, _SLOW_HZ, 2.0, weight, settle_s=settle)
            for when, settle in (("at-once", 0.1), ("after-a-minute", 60.0))
        ],
    }


def separating_sequence(
    names: Sequence[str], bench: Bench, catalogue: Mapping[str, Effect] = EFFECTS
) -> str | None:
    """Return a sequence file that splits an alias group, or None if none can."""
    known = [catalogue[name] for name in names if name in catalogue]
    kinds = [entry.separation for entry in known if entry.separation is not None]
    room = Room.of(bench)
    if not kinds or room.travel_deg <= 0.0 or room.weight_kg <= 0.0:
        return None
    lines = [stage.line() for stage in recipes(room)[kinds[0]]]
    head = [
        f"# Splits {', '.join(names)}; sized by the limits of the bench {bench.name!r}.",
        "sequence: 1",
        f"name: split-{names[0]}",
        "stages:",
    ]
    return "\n".join([*head, *lines]) + "\n"


YAML_FILE, PYTHON_FILE = "model.yaml", "model.py"


def yaml_text(model: CorrectedModel, recording: Recording) -> str:
    """Return parameters, constants of the bench, effects and curve as YAML, SI."""
    record: dict[str, Any] = {
        "model": 1,
        "parameters": {name: float(value) for name, value in model.parameters.items()},
        "alpha": float(model.alpha),
        "constants": {
            k: v
            for k, v in model.numbers(recording).items()
            if k not in model.parameters and k != "alpha"
        },
        "effects": {
            name: {k: float(v) for k, v in given.items()} for name, given in model.effects.items()
        },
    }
    if model.curve is not None:
        record["curve"] = plain(model.curve)
    return "# Corrected model, SI units, at the joint after the gear.\n" + yaml.safe_dump(
        record, sort_keys=False
    )


SEQUENCE_FILE = "split.yaml"
GAS_FILE = "gas_generator.yaml"
_KEYS = {
    "a": "burning_coefficient",
    "n": "pressure_exponent",
    "C_r": "characteristic_velocity",
    "V_0": "free_volume",
}
"""Keys in a campaign file by the names of the fitted constants."""
_VALVE_KEYS = {"d": "hole_diameter", "D": "opening_diameter", "b": "plate_width"}


class Export(NamedTuple):
    """One file: name, purpose and text."""

    name: str
    use: str
    text: str


class Exports(NamedTuple):
    """Files next to the report, with notes on files that are incomplete or could not be made."""

    files: tuple[Export, ...]
    notes: tuple[str, ...]


def exports(source: Path, outcome: Outcome, record: Mapping[str, Any]) -> Exports:
    """Return the corrected model in all formats, and the experiment that splits an alias group."""
    if outcome.diagnosis.fit.equation == PRESSURE:
        use = "the corrected gas generator, as a block of a campaign file"
        text = _gas_text(outcome.diagnosis, outcome.dataset.recordings[0].bench)
        return Exports((Export(GAS_FILE, use, text),), ())
    base = base_bench(source)
    files, notes = _models(source_name(source), base, outcome, record)
    if outcome.diagnosis.verdict is Verdict.AMBIGUOUS:
        unknown = _unknown(outcome)
        splitting = _splitting(base, outcome, unknown)
        if splitting is not None:
            files.append(splitting)
        elif unknown:
            notes.append(
                f"{SEQUENCE_FILE} is not written: no kind of experiment is stated for "
                f"{', '.join(unknown)}; state `separation` in the class of your effect"
            )
        else:
            notes.append(
                "no sequence splits this group; the experiment needs a manual change of the bench"
            )
    return Exports(tuple(files), tuple(notes))


def _models(
    name: str, base: Mapping[str, Any], outcome: Outcome, record: Mapping[str, Any]
) -> tuple[list[Export], list[str]]:
    """Return the corrected model in all possible formats, and why others are not possible."""
    files: list[Export] = []
    notes: list[str] = []
    recordings = outcome.dataset.recordings
    first = recordings[0]
    try:
        names = [r.name for r in recordings]
        model = model_of(record, names, "the corrected model", outcome.own.catalogue)
        files.append(Export(YAML_FILE, "the corrected model", yaml_text(model, first)))
        use = "the corrected model as plain Python functions; needs only numpy"
        try:
            files.append(Export(PYTHON_FILE, use, python_text(model, first, name)))
        except ValueError as error:  # a function of the user's own uses what text cannot contain
            notes.append(f"{PYTHON_FILE} is not written: {error}")
        bench, left_out = model_bench(base, model, first.bench, outcome.own)
        use = f"the corrected model as a simulated bench: rig run SEQUENCE --bench {BENCH_FILE}"
        files.append(Export(BENCH_FILE, use, bench_text(bench, left_out)))
    except InputError as error:
        return files, [*notes, *error.problems]
    return files, [*notes, *left_out]


def _unknown(outcome: Outcome) -> list[str]:
    """Return the candidates of one's own for which no kind of experiment is stated."""
    names = {n: None for e in outcome.diagnosis.effects for n in e.alias_group if e.alias_group[1:]}
    own = {e.name for e in outcome.own.effects if e.separation is None}
    return [name for name in names if name in own]


def _splitting(base: Mapping[str, Any], outcome: Outcome, unknown: Sequence[str]) -> Export | None:
    """Return the sequence that splits the first alias group that a sequence can split."""
    limits = Bench.model_validate_json(json.dumps(base), strict=True)
    for effect in outcome.diagnosis.effects:
        group = effect.alias_group
        known = len(group) > 1 and not {*group} & {*unknown}
        sequence = separating_sequence(group, limits, outcome.own.catalogue) if known else None
        if sequence is not None:
            use = (
                f"distinguishes {', '.join(group)}: rig run {SEQUENCE_FILE}, then diagnose the old "
                "and the new recordings together"
            )
            return Export(SEQUENCE_FILE, use, sequence)
    return None


def _gas_text(found: Diagnosis, bench: Constants) -> str:
    """Return the corrected gas generator as YAML, a block of a campaign file."""
    g = bench.gas_generator
    assert g is not None
    block = {
        "propellant_density": g.rho_b,
        "grain_diameter": g.D_P,
        **{key: float(found.parameters[name]) for name, key in _KEYS.items()},
        "heat_ratio": g.gamma,
        "back_pressure": g.p_c0,
        "valve": {key: float(found.parameters[name]) for name, key in _VALVE_KEYS.items()},
    }
    effects: Mapping[str, Any] = {
        e.name: {n: float(v.value) for n, v in e.parameters.items()} for e in found.effects
    }
    return (
        "# Corrected constants, for `bench:` of a campaign; free_volume is the mean over the "
        "recordings.\n"
        + yaml.safe_dump({"gas_generator": block}, sort_keys=False)
        + "# Effects that eq. 2 to 8 do not contain; `rig effects NAME` prints the equations "
        "of each.\n" + yaml.safe_dump({"effects": effects}, sort_keys=False)
    )
