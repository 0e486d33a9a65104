"""Proves investigations on sealed machines of the simulated bench, against Figure 10 repeated for
as long.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from identification.diagnosis.within_limits import choose, views_and_fit
from identification.recording import Dataset, Recording, RecordingError
from rig.common.errors import InputError
from rig.common.places import is_file, read_json, write_json
from rig.common.provenance import Provenance
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document as Located
from rig.config.sequence import load_sequence
from rig.investigate.experiments import as_document, bench_seconds, family
from rig.investigate.investigation import (
    Experiment,
    Investigation,
    Judgement,
    State,
    judge_recordings,
)
from rig.planning.plan import make_plan
from rig.results.document import Document, Section, Table, provenance_section
from rig.results.prove.document import shares
from rig.results.prove.draw import NEEDS_GRAVITY, SIZES, Assigned, Kind, Rig, assignment, draw
from rig.results.prove.engine import Engine
from rig.results.prove.run import PREFIX, PROOF_FILE, ROWS, Proof, diagnosis_seed, seals_begun
from rig.results.prove.score import NO_ALARM, REFUSED, STRONG, VERSION, rate
from rig.results.prove.simulate import left_over, truth_of
from rig.results.prove.truth import Sealed, place, repeated_salt, seal_truth, unseal
from rig.runs.run_record import Ending

BENCH, FIRST = "practical", "figure10"
SHARES: Mapping[Kind, float] = {"one": 27.0, "nothing": 4.0, "outside": 3.0}
ON_A_BENCH = tuple(
    n for n, sizes in SIZES.items() if "recording" not in sizes and n not in NEEDS_GRAVITY
)
"""Effects in every run of a bench with a lever, not in one recording of a campaign alone."""
BUDGET_MIN = 40.0
SCHEMA = "loadrig.prove_investigate/2"
Said = tuple[str, list[str]]
"""Verdict, and names of the identified effects."""
STATES = ("right", "wrong", "open", "missed")
_ONE, _REPEATED = f"one effect, strength {STRONG:g} or more", "Figure 10 repeated as long"
_RATES = {
    "right": f"{_ONE}: named alone",
    "wrong": f"{_ONE}: another one named",
    "open": f"{_ONE}: left open",
    "missed": f"{_ONE}: told that nothing is missing",
    "right_all": "one effect, any strength: named alone",
    "wrong_all": "one effect, any strength: another one named",
    "alarms": "no effect: told that something is missing",
    "outside": "outside the catalogue: told as such",
    "outside_named": "outside the catalogue: an effect named",
    "repeated_right": f"{_REPEATED}, {_ONE}: named alone",
    "repeated_wrong": f"{_REPEATED}, {_ONE}: another one named",
    "held": "samples in the sealed 90 % band, mean over machines",
}


class Trial(NamedTuple):
    """One machine: its number, its kind and effects, and its folder with the sealed truth."""

    number: int
    assigned: Assigned
    sealed: Sealed


class SimulatedInvestigation(Investigation):
    """An investigation whose experiments are simulated without a bus and kept in memory; constants
    are not refined.

    Args:
        bench: The bench as it is believed; nothing of the machine is in it.
        folder: Folder of the state and the sealed predictions.
        state: A new state.
        machine: The machine that is simulated.
    """

    def __init__(self, bench: Located[Bench], folder: Path, state: State, machine: Machine) -> None:
        self._machine = machine
        super().__init__(bench, folder, state, self._simulate, lambda _: None, lambda *_: None)
        self._kept: dict[str, tuple[Recording, ...]] = {}
        self._last: tuple[list[str], Judgement] | None = None

    def _simulate(self, sequence: Path, folder: Path) -> None:
        self._kept[folder.name] = self.simulated(str(sequence), len(self._kept), folder.name)

    def simulated(self, sequence: str, number: int, name: str) -> tuple[Recording, ...]:
        """Return the recordings of a sequence on the machine, with noise of its own."""
        plan = make_plan(load_sequence(sequence), self.bench.document)
        found = self.bench.simulate(plan, self._machine, self.state.seed + number).recordings
        return tuple(replace(r, name=f"{name}/{r.name}", session=name) for r in found)

    def strength(self) -> float:
        """Return the greatest residual of the nominal model, beyond that without effects and over
        it, in one recording of all parts of the bench's experiments that stay within the limits.
        """
        seed, without = self.state.seed, replace(self._machine, effects={})
        here, reference = list[Recording](), list[Recording]()
        for part in family(self.bench.document.value, np.random.default_rng(seed), sessions=True):
            plan = self.bench.plan(as_document("x", [part]), ())
            found, free = (
                self.bench.simulate(plan, machine, seed) for machine in (self._machine, without)
            )
            if not found.problem:
                here += found.recordings
                reference += free.recordings
        left = left_over(_residuals(here), _residuals(reference))
        return max(left.values(), default=0.0)

    def judged(self, refine: bool = False) -> Judgement:
        """Diagnose all simulated experiments but the confirming one."""
        fitted = self._fitted()
        if self._last is None or self._last[0] != fitted:
            self._last = fitted, self.judged_from(self.dataset().recordings)
        return self._last[1]

    def _fitted(self) -> list[str]:
        return [e.run for e in self.state.experiments if e.purpose != "confirm"]

    def dataset(self) -> Dataset:
        """Return the recordings to diagnose."""
        if not self._kept:
            raise InputError("nothing was simulated")
        return Dataset(tuple(r for name in self._fitted() for r in self._kept[name]))

    def judged_from(self, recordings: Sequence[Recording]) -> Judgement:
        """Diagnose recordings."""
        place, seed = self.bench.document.path, self.state.seed
        return judge_recordings(Dataset(tuple(recordings)), place, seed, [], lambda *_: None)

    def recordings(self, folder: Path) -> Dataset:
        """Return the recordings of an experiment."""
        return Dataset(self._kept[folder.name])

    def _moved(self, e: Experiment) -> bool:
        return bool(self._kept.get(e.run))

    def began(self, folder: Path) -> bool:
        """Whether an experiment was simulated."""
        return folder.name in self._kept

    def ended(self, folder: Path) -> str:
        """Return the state of an experiment that was simulated."""
        return Ending.DONE.value


def _residuals(recordings: Sequence[Recording]) -> dict[str, float]:
    """Return the rms residual of the nominal model, by equation and number of the recording; at
    least the noise of a row.
    """
    dataset, bandwidth, _ = choose(Dataset(tuple(recordings)), None)
    _, joint = views_and_fit(dataset, bandwidth)
    found = {}
    for e in joint.equations:
        rows = joint.residual[joint.stack.part(e.name)]
        for owner in np.unique(e.owner).tolist():
            rms = math.sqrt(float(np.mean(rows[e.owner == owner] ** 2)))
            found[f"{e.name} {owner}"] = e.sigma * max(rms, 1.0)
    return found


def begin(out: Path, rigs: int, seed: int) -> Proof:
    """Draw and seal all machines, or continue a proof that was begun with the same settings."""
    settings = {"rigs": rigs, "seed": seed, "investigate": True, "row_version": VERSION}
    file, sealed = out / PROOF_FILE, []
    begun = seals_begun(file, settings) if is_file(file) else {}
    for n, assigned in enumerate(_assigned(rigs, seed), start=1):
        where = place(out / "machines", f"{PREFIX}{n:04d}")
        if where.name in begun:
            sealed.append(where._replace(digest=begun[where.name]))
        else:
            truth = truth_of(_drawn(assigned, seed, n))
            sealed.append(seal_truth(where, n, truth, repeated_salt(seed, n)))
    (out / ROWS).mkdir(parents=True, exist_ok=True)
    write_json(file, {"settings": settings, "seals": {s.name: s.digest for s in sealed}})
    return Proof(out, seed, tuple(sealed))


def _assigned(rigs: int, seed: int) -> list[Assigned]:
    return assignment(rigs, seed, SHARES, ON_A_BENCH)


def _drawn(assigned: Assigned, seed: int, number: int) -> Rig:
    return draw(*assigned, (seed, number))._replace(gravity=False)


def work(
    proof: Proof, engine: Engine, progress: Callable[[str, float], None]
) -> list[dict[str, Any]]:
    """Investigate and score the machines that have no row yet; return all rows in order."""
    assigned = _assigned(len(proof.rigs), proof.seed)
    todo = [
        Trial(n, given, rig)
        for n, (given, rig) in enumerate(zip(assigned, proof.rigs, strict=True), start=1)
        if not is_file(proof.file(ROWS, rig))
    ]
    done = len(proof.rigs) - len(todo)
    for row in engine.each(partial(prove_trial, seed=proof.seed), todo):
        done += 1
        write_json(proof.out / ROWS / f"{PREFIX}{row['rig']:04d}.json", row)
        progress(f"machine {row['rig']} investigated", done / len(proof.rigs))
    return [read_json(proof.file(ROWS, rig)) for rig in proof.rigs]


def prove_trial(trial: Trial, seed: int) -> dict[str, Any]:
    """Investigate one machine, repeat Figure 10 for as long, unseal and score.

    The investigation and its designs see the recordings of the machine only.
    """
    rig, sealed = _drawn(trial.assigned, seed, trial.number), trial.sealed
    folder = sealed.campaign.parent
    folder.mkdir(parents=True, exist_ok=True)
    bench, own = load_bench(BENCH), diagnosis_seed(seed, trial.number)
    state = State({"file": str(bench.path)}, own, BUDGET_MIN, first=FIRST)
    one = SimulatedInvestigation(bench, folder, state, machine_on(bench.value, rig.machine))
    trace = ""
    found = repeated = (REFUSED, list[str]())
    try:
        judged, _ = one.run()
        found = judged.diagnosis.verdict.value, [e.name for e in judged.diagnosis.effects]
        repeated = _repeated(one)
    except InputError:
        pass
    except Exception:  # noqa: BLE001 - a failure on one machine is a result of the proof
        trace = traceback.format_exc()
    truth = unseal(sealed.truth, sealed.digest).record(trial.number)
    try:
        strength = 0.0 if truth["kind"] == "nothing" else one.strength()
    except RecordingError:
        # No experiment of the bench stays within its limits.
        strength = 0.0
    return row_of(truth, strength, state, found, repeated, sealed.digest, trace)


def machine_on(bench: Bench, drawn: Machine) -> Machine:
    """Return the simulated machine of a bench with the constants and effects of a drawn one."""
    assert bench.mock is not None
    parts = ("motor", "joint", "sensing", "effects", "temperature_C", "warming_K", "warming_s")
    return replace(bench.mock, **{name: getattr(drawn, name) for name in parts})


def _repeated(one: SimulatedInvestigation) -> Said:
    """Return what Figure 10 identifies, repeated for at least as long as an investigation."""
    each = bench_seconds(make_plan(load_sequence(FIRST), one.bench.document))
    times = max(1, math.ceil(one.state.bench_seconds / each))
    recordings = [r for k in range(times) for r in one.simulated(FIRST, k, f"{k}")]
    try:
        found = one.judged_from(recordings).diagnosis
    except InputError:
        return REFUSED, []
    return found.verdict.value, [e.name for e in found.effects]


def row_of(
    truth: Mapping[str, Any],
    strength: float,
    state: State,
    found: Said,
    repeated: Said,
    digest: str,
    trace: str = "",
) -> dict[str, Any]:
    """Score an investigation against the truth of its machine.

    ``strength``: see :meth:`SimulatedInvestigation.strength`. ``state`` and ``repeated``:
    ``right``, ``wrong``, ``open`` or ``missed``, of the investigation, and of Figure 10 repeated.
    ``to_name``: number of experiments and bench minutes after which verdict and likeliest
    hypothesis were the final ones; null unless it is right. ``held``: share of the samples in the
    sealed band.
    """
    verdict, named = found
    kind, names = truth["kind"], list(truth["effects"])
    scored = state_of(kind, names, verdict, named)
    judged = [e for e in state.experiments if e.purpose != "confirm"]
    minutes = [s / 60.0 for s in accumulate(e.seconds for e in judged)]
    said = [(e.verdict, _likeliest(e)) for e in judged]
    last = (verdict, said[-1][1] if said else "")
    at = max((k for k, each in enumerate(said) if each != last), default=-1) + 1
    return {
        "rig": truth["rig"],
        "sha256": digest,
        "kind": kind,
        "effects": names,
        "strength": strength,
        "verdict": verdict,
        "named": named,
        "state": scored,
        "repeated": state_of(kind, names, *repeated),
        "to_name": [at + 1, minutes[at]] if scored == "right" and at < len(minutes) else None,
        "experiments": len(state.experiments),
        "minutes": state.bench_seconds / 60.0,
        "held": next(
            (c["band_held"] for c in (*state.refuted, state.confirmation) if "band_held" in c), None
        ),
        "refuted": len(state.refuted),
        "traceback": trace,
    }


def _likeliest(experiment: Experiment) -> str:
    return max(experiment.odds, key=experiment.odds.__getitem__, default="")


def state_of(kind: str, names: Sequence[str], verdict: str, identified: Sequence[str]) -> str:
    """Return whether a verdict is right, wrong, open, or misses the effect."""
    if verdict == "named":
        return "right" if kind == "one" and {*names} == {*identified} else "wrong"
    own = {"nothing": "nothing_missing", "outside": "outside_catalogue"}.get(kind)
    if verdict == own:
        return "right"
    return "missed" if verdict == "nothing_missing" else "open"


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the rates of a proof, and the median and 90 % quantile of experiments and minutes."""
    kinds = {kind: [r for r in rows if r["kind"] == kind] for kind in ("one", "nothing", "outside")}
    strong = [r for r in kinds["one"] if r["strength"] >= STRONG]
    held = [r["held"] for r in rows if r["held"] is not None]

    def share(of: Sequence[Mapping[str, Any]], state: str, key: str = "state") -> dict[str, Any]:
        return rate(sum(r[key] == state for r in of), len(of))

    nothing = kinds["nothing"]
    to_name = [r["to_name"] for r in kinds["one"] if r["to_name"]]
    return {
        **{state: share(strong, state) for state in STATES},
        **{f"{state}_all": share(kinds["one"], state) for state in STATES},
        "alarms": rate(sum(r["verdict"] not in NO_ALARM for r in nothing), len(nothing)),
        "outside": share(kinds["outside"], "right"),
        "outside_named": share(kinds["outside"], "wrong"),
        **{f"repeated_{state}": share(strong, state, "repeated") for state in STATES},
        "held": rate(round(sum(held), 3), len(held)),
        **{
            key: np.quantile([t[k] for t in to_name], (0.5, 0.9)).tolist() if to_name else None
            for k, key in enumerate(("experiments_to_name", "minutes_to_name"))
        },
    }


def proof_record(rows: Sequence[Mapping[str, Any]], provenance: Provenance) -> dict[str, Any]:
    """Return the record of ``rig prove --investigate --json``; ``rigs`` has one row each."""
    return {**provenance.record(SCHEMA), **figures(rows), "rigs": list(rows)}


def proof_document(result: Mapping[str, Any], provenance: Provenance) -> Document:
    """Return the proof as a document, from its record."""
    shown = tuple(Section("", (table,)) for table in _tables(result))
    title = "The blind proof of investigations"
    said = f"{len(result['rigs'])} machines, each sealed before its investigation"
    return Document(title, said, shown, (*shown, provenance_section(provenance)))


def _tables(result: Mapping[str, Any]) -> Iterator[Table]:
    yield shares("machines", result, _RATES)
    counted = tuple(
        (words, f"{found[0]:.3g}", f"{found[1]:.3g}")
        for key, words in (("experiments_to_name", "experiments"), ("minutes_to_name", "minutes"))
        if (found := result[key])
    )
    yield Table(("to the right name", "median", "90 %"), counted, (1, 2))
    rows = tuple(
        (
            f"{r['rig']}",
            "+".join(r["effects"]) or r["kind"],
            f"{r['strength']:.3g}",
            r["state"],
            r["verdict"].replace("_", " "),
            "+".join(r["named"]),
            r["repeated"],
            f"{r['experiments']}",
            f"{r['minutes']:.1f}",
            "" if r["held"] is None else f"{r['held']:.0%}",
        )
        for r in result["rigs"]
    )
    header = ("machine", "hides", "strength", "state", "verdict", "named", "Figure 10 repeated")
    yield Table((*header, "experiments", "min", "band held"), rows, (2, 7, 8, 9))
