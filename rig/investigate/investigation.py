"""The loop: diagnoses all recordings together, weighs the hypotheses, chooses and runs the next
experiment, until a stop rule holds; then one more experiment, predicted before it runs.

The state is one file, replaced after each step. An experiment is in the file before it runs, so
that a program that was killed finds it there, with whatever the run folder holds.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from identification.design.separation import REJECTED, Hypothesis, Weighed, weigh
from identification.diagnosis.result import Diagnosis, Rival, Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.diagnosis.statement import statement
from identification.effects import EFFECTS, MOTION
from identification.recording import Dataset, Recording
from rig.common.errors import InputError
from rig.common.places import is_file, read_json, write_json, write_text
from rig.common.provenance import sha256_file
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.sequence import Sequence as Stages
from rig.config.sequence import load_sequence, sequence_text
from rig.investigate.choice import WORTH_WHILE, Progress, Proposal, propose, spoken
from rig.investigate.confirmation import Confirmation, compare, predict
from rig.investigate.experiments import SimulatedBench, bench_seconds, weight_changes
from rig.planning.plan import make_plan
from rig.results.diagnose.diagnose import Outcome, diagnose_dataset
from rig.results.run.go_on import NOT_READ_BACK
from rig.runs.run import load_run
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE, Ending

STATE_FILE = "investigation.json"
STATE_SCHEMA = "loadrig.investigation/1"
MOST_COVERS, LEAST_SHOWN = 4, 0.05
"""Greatest number of experiments that show what no recording has shown, and the change of a
hypothesis' probability from which such an experiment has shown something.
"""
VAIN = 2
"""Number of experiments that were to separate a pair and did not, after which it is given up; and
of those that cover and show nothing, before the verdict *nothing missing*.
"""
DESIGNED = ("separate", "cover", "repeat")
"""Purposes of the experiments that the program chooses."""
LEAST_HELD = 0.8
"""Share of the samples in the band of a sealed prediction below which the prediction has failed:
the band is made for 90 %, and neighbouring samples are correlated.
"""
MOST_REFUTED = 2
"""Number of failed predictions after each of which the investigation goes on."""
MOST_EXPERIMENTS = 12
"""Greatest number of experiments that the program chooses in one investigation."""
PREDICTION_FILE = "prediction{}.json"
LEAST_S = 60.0
"""Rest of the budget below which no experiment is designed, s."""


@dataclass
class Experiment:
    """One experiment.

    Attributes:
        run: Run folder, relative to the folder of the investigation if it is inside.
        sequence: Sequence file, as `run`; empty for a run that existed.
        reason: Why it is run, one sentence with numbers.
        seconds: Time of the bench and its operator, s.
        weight_changes: How often a weight was hung or taken off.
        state: ``planned`` before it runs, then the state of the run.
        purpose: ``given``, ``first``, ``separate``, ``cover``, ``repeat`` (an experiment is run
            again in which one recording alone shows an effect), ``confirm``, or ``refute``: a
            confirming experiment whose prediction failed; it is diagnosed with the others.
        odds: Probability of each hypothesis after the experiment.
        expected: Pair of hypotheses to the expected preference, standard errors.
        verdict: Verdict of the diagnosis after the experiment.
        levels: Likelihood gap of each hypothesis to the best one after the experiment, standard
            errors.
        left: Mean square of what the best hypothesis leaves, over that of the noise.
        repeats: Run that is repeated, or empty.
    """

    run: str
    sequence: str
    reason: str
    seconds: float
    weight_changes: int
    state: str = "planned"
    purpose: str = "separate"
    odds: dict[str, float] = field(default_factory=dict)
    expected: dict[str, float] = field(default_factory=dict)
    verdict: str = ""
    levels: dict[str, float] = field(default_factory=dict)
    left: float = 1.0
    repeats: str = ""


@dataclass
class State:
    """What an investigation is resumed from.

    Attributes:
        bench: Bench file, and its SHA-256.
        seed: Seed of the investigation.
        budget_min: Budget in minutes of the bench, or None.
        question: Names of the only hypotheses, or empty.
        first: Sequence of the first run, or empty.
        confirm: Result whose model is confirmed, or empty for that of the investigation.
        experiments: All experiments in order.
        ended: Why no further experiment is run; empty while the investigation goes on.
        confirmation: Prediction of the confirming experiment and what came of it.
        refuted: The same of the predictions that failed, each sealed in a file of its own.
        cannot_separate: Pairs that are not separated, why no experiment goes on, and what would
            separate them.
        indistinct: Pair to the preference, standard errors, that all experiments of the bench
            together would show.
    """

    bench: dict[str, str]
    seed: int
    budget_min: float | None = None
    question: list[str] = field(default_factory=list)
    first: str = ""
    confirm: str = ""
    experiments: list[Experiment] = field(default_factory=list)
    ended: str = ""
    confirmation: dict[str, Any] = field(default_factory=dict)
    refuted: list[dict[str, Any]] = field(default_factory=list)
    cannot_separate: list[dict[str, Any]] = field(default_factory=list)
    indistinct: dict[str, float] = field(default_factory=dict)
    schema: str = STATE_SCHEMA

    @property
    def bench_seconds(self) -> float:
        """Time of the bench that all experiments have taken, s."""
        return sum(e.seconds for e in self.experiments)

    @property
    def left_s(self) -> float:
        """Rest of the budget, s."""
        budget = math.inf if self.budget_min is None else 60.0 * self.budget_min
        return budget - self.bench_seconds

    def given_up(self, first: str, rival: str) -> str:
        """Return why two hypotheses are not separated any more; empty if they still are."""
        pair = joined(first, rival)
        if pair in self.indistinct:
            return f"all experiments together would show {self.indistinct[pair]:.1f} sigma"
        weighed = [e for e in self.experiments if e.levels]
        vain = 0
        for before, e in pairwise(weighed):
            if e.purpose == "refute":
                vain = 0  # the prediction failed: the hypotheses are others
                continue
            hoped = max((e.expected.get(p, 0.0) for p in (pair, joined(rival, first))), default=0.0)
            gaps = [x.levels.get(rival, math.inf) - x.levels.get(first, 0.0) for x in (before, e)]
            same = not abs(gaps[1] - gaps[0]) >= WORTH_WHILE
            vain += hoped >= WORTH_WHILE and same
        return f"{vain} experiments that were to separate them did not" if vain >= VAIN else ""

    def save(self, folder: Path) -> None:
        """Replace the state file as a whole."""
        write_json(folder / STATE_FILE, asdict(self))


def load_state(folder: Path) -> State:
    """Read the state of an investigation.

    Raises:
        InputError: The file is missing, or is not the state of an investigation.
    """
    path = folder / STATE_FILE
    raw = read_json(path, "give --out the folder of the investigation to resume")
    try:
        if raw["schema"] != STATE_SCHEMA:
            raise ValueError(f"schema {raw['schema']!r}, this program reads {STATE_SCHEMA!r}")
        experiments = [Experiment(**e) for e in raw.pop("experiments")]
        return State(**raw, experiments=experiments)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: not the state of an investigation: {error}") from error


class Judgement(NamedTuple):
    """Diagnosis of all recordings, its search, and the weighed hypotheses."""

    outcome: Outcome
    found: Search
    weighed: Weighed

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis."""
        return self.outcome.diagnosis


def read_runs(folders: Sequence[Path]) -> Dataset:
    """Return the recordings of several runs as one dataset; the recorded part of a run that ended
    early is used.

    On a bench that keeps its temperature between runs, all time stamps are of one clock. A
    recording has the name of its run folder, with a number if another folder has the same name.

    Raises:
        InputError: No run has a recording, a folder is no run, or the recording of a run that was
            completed cannot be read.
    """
    recordings: list[Recording] = []
    problems: list[str] = []
    first: datetime | None = None
    labels = list[str]()
    for folder in folders:
        record = read_record(folder)
        try:
            dataset = load_run(folder, partial=True)
        except InputError as error:
            if record.state == Ending.DONE.value:
                raise
            problems += error.problems  # a run that ended before its first motion
            continue
        created = datetime.fromisoformat(record.created)
        first = first or created
        label, again = folder.name, 1
        while label in labels:
            again += 1
            label = f"{folder.name}-{again}"
        labels.append(label)
        late_s, session = (created - first).total_seconds(), ""
        if record.simulated and not record.realtime:
            late_s, session = 0.0, label  # each simulated run starts cold
        recordings += [
            dataclasses.replace(
                r,
                name=f"{label}/{r.name}",
                channels={**r.channels, "time": r.channels["time"] + late_s},
                role="fit",
                session=session,
            )
            for r in dataset.recordings
        ]
    if not recordings:
        raise InputError(problems or ["no run to investigate"])
    return Dataset(tuple(recordings))


def judge_recordings(
    dataset: Dataset,
    source: Path,
    seed: int,
    question: Sequence[str],
    progress: Progress,
    refine: bool = False,
) -> Judgement:
    """Diagnose recordings together, and weigh the hypotheses.

    Args:
        dataset: The recordings.
        source: Place of the first of them.
        seed: Seed of the investigation.
        question: Names of the only hypotheses, or empty.
        progress: Called with the present step and the share that is done.
        refine: Whether to refine the constants.

    Raises:
        InputError: The recordings cannot be diagnosed.
    """
    searches: list[Search] = []
    outcome = diagnose_dataset(
        dataset,
        source,
        seed,
        progress=progress,
        refine=refine,
        searched=searches.append,
    )
    if not searches:
        raise InputError(f"{source}: an investigation needs recordings of the drive's torque")
    progress("weighing hypotheses", 0.0)
    found = searches[0]
    flexible = any(np.any(v.twist) for v in found.baseline.views)
    terms = [t.on_the_joint() for t in MOTION] if flexible else MOTION
    weighed = weigh(found, outcome.diagnosis.verdict, terms, question)
    concluded = concluded_from(outcome.diagnosis, weighed)
    return Judgement(dataclasses.replace(outcome, diagnosis=concluded), found, weighed)


def concluded_from(diagnosis: Diagnosis, weighed: Weighed) -> Diagnosis:
    """Return a diagnosis whose verdict, rivals and confidence follow from the weighed hypotheses.

    Effects are named if they are the best hypothesis and every other one is rejected.
    """
    if not diagnosis.effects or diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE:
        return diagnosis
    names, odds = {e.name for e in diagnosis.effects}, weighed.odds
    alone = {*weighed.hypotheses[0].names} == names and not weighed.rivals
    verdict = Verdict.NAMED if alone else Verdict.AMBIGUOUS
    effects = []
    for e in diagnosis.effects:
        others = [
            (other, h)
            for h in weighed.hypotheses
            if e.name not in h.names
            for other in {*h.names} - names
        ]
        rivals = tuple(
            Rival(
                other,
                odds[h.name],
                ""
                if h.preference < REJECTED
                else f"the likelihood is lower by {h.preference:.1f} standard errors",
            )
            for other, h in others
        )
        group = (e.name, *(r.name for r in rivals if not r.why_not))
        sure = sum(odds[h.name] for h in weighed.hypotheses if e.name in h.names)
        effects.append(dataclasses.replace(e, rivals=rivals, alias_group=group, confidence=sure))
    d = diagnosis
    said = statement(verdict, effects, d.fit, d.location, d.p_value, ())
    return dataclasses.replace(d, verdict=verdict, effects=tuple(effects), statement=said)


CarryOut = Callable[[Path, Path], None]
"""Function that runs a sequence file into a new run folder, with all checks, prompts and safety of
``rig run``. It returns after a run that was completed or tripped, and raises otherwise.
"""


class Investigation:
    """An investigation in a folder.

    Args:
        bench: The bench.
        folder: Folder of the investigation.
        state: Its state, new or resumed.
        carry_out: Runs one experiment.
        say: Shows one line.
        progress: Shows the present step.
    """

    def __init__(
        self,
        bench: Document[Bench],
        folder: Path,
        state: State,
        carry_out: CarryOut,
        say: Callable[[str], None],
        progress: Progress,
    ) -> None:
        self.bench = SimulatedBench.of(bench)
        self._folder, self.state = folder, state
        self._carry_out, self._say, self._progress = carry_out, say, progress

    def run(self) -> tuple[Judgement, Confirmation | None]:
        """Run experiments until the stop rule holds, then the confirming one; return the diagnosis
        of all other recordings, with refined constants, and what came of the prediction.

        Raises:
            InputError: The first run cannot be diagnosed.
        """
        self._settle_unfinished()
        if self.state.first and not self._any_recorded():
            self._first()
        state = self.state
        while True:
            judged = self._judge()
            while not state.ended and (proposal := self._next(judged)) is not None:
                self._experiment(proposal)
                judged = self._judge()
            state.save(self._folder)
            final = self.judged(refine=True)
            if not self._confirming():
                self._confirm(final)
            found = self._compare()
            if found is None or found.band_held >= LEAST_HELD or not self._refuted():
                return final, found

    def _refuted(self) -> bool:
        """Make a confirming experiment whose prediction has failed evidence; return whether the
        investigation goes on.
        """
        state = self.state
        refuted = sum(e.purpose == "refute" for e in state.experiments)
        again = refuted < MOST_REFUTED and not state.confirm
        self._say(
            f"the prediction failed: the band held {state.confirmation['band_held']:.0%} of it"
            + ("; the diagnosis uses the recording now" if again else "")
        )
        if again:
            self._confirming()[-1].purpose = "refute"
            state.ended, state.refuted = "", [*state.refuted, state.confirmation]
            state.confirmation, state.indistinct = {}, {}
            state.save(self._folder)
        return again

    @property
    def _prediction(self) -> Path:
        number = len(self.state.refuted) + 1
        return self._folder / PREDICTION_FILE.format("" if number == 1 else f"-{number}")

    def _confirming(self) -> list[Experiment]:
        return [e for e in self.state.experiments if e.purpose == "confirm"]

    def _done(self) -> list[Path]:
        """Return the folders of the runs to diagnose, without the confirming one."""
        return [
            self._place(e.run)
            for e in self.state.experiments
            if e.state not in ("planned", "running") and e.purpose != "confirm"
        ]

    def _any_recorded(self) -> bool:
        try:
            self.dataset()
        except InputError:
            return False
        return True

    def _place(self, name: str) -> Path:
        return self._folder / name  # an absolute name stays as it is

    def _settle_unfinished(self) -> None:
        """Take the state of experiments that were interrupted from their run folders.

        An experiment that never began is planned again; an experiment that began counts, and its
        recorded part is used: it is not run twice.
        """
        for e in list(self.state.experiments):
            if e.state != "planned":
                continue
            if not is_file(self._place(e.run) / RUN_FILE):
                self.state.experiments.remove(e)
                self._say(f"{e.run}: was planned but did not begin; it is designed again")
                continue
            e.state = self.ended(self._place(e.run))
            self._say(f"{e.run}: found as {e.state}; its recordings are used, it is not repeated")
        self.state.save(self._folder)

    def judged(self, refine: bool = False) -> Judgement:
        """Diagnose all runs but the confirming one; see :func:`judge_recordings`."""
        place, state = self._done()[0], self.state
        return judge_recordings(
            self.dataset(), place, state.seed, state.question, self._progress, refine
        )

    def dataset(self) -> Dataset:
        """Return the recordings to diagnose.

        Raises:
            InputError: There is none.
        """
        return read_runs(self._done())

    def recordings(self, folder: Path) -> Dataset:
        """Return the recordings of a run."""
        return load_run(folder)

    def began(self, folder: Path) -> bool:
        """Whether a run has begun."""
        return is_file(folder / RUN_FILE)

    def ended(self, folder: Path) -> str:
        """Return the state of a run that has ended."""
        record = read_record(folder)
        return Ending.CRASHED.value if record.state == "running" else record.state

    def _first(self) -> None:
        sequence = load_sequence(self.state.first)
        plan = make_plan(sequence, self.bench.document)
        changes = weight_changes(plan.stages)
        e = _planned("the first run", bench_seconds(plan), changes, "first")
        self._carry(e, sequence.value)

    def _carry(self, e: Experiment, sequence: Stages) -> None:
        """Write the sequence, note the experiment as planned, and run it."""
        number = len(self.state.experiments) + 1
        e.run = f"{number:02d}-{e.purpose}"
        while (self._folder / e.run).exists():
            e.run += "-again"
        e.sequence = f"{e.run}.yaml"
        path = self._folder / e.sequence
        write_text(path, sequence_text(sequence, f"# {e.reason}\n"))
        self.state.experiments.append(e)
        self.state.save(self._folder)
        try:
            self._carry_out(path, self._folder / e.run)
        finally:
            if self.began(self._folder / e.run):
                e.state = self.ended(self._folder / e.run)
            else:
                self.state.experiments.remove(e)
            self.state.save(self._folder)

    def _experiment(self, proposal: Proposal) -> None:
        p = proposal
        e = _planned(p.reason, p.seconds, p.weight_changes, p.purpose)
        e.expected, e.repeats = {joined(*pair): z for pair, z in p.apart.items()}, p.repeats
        self._say(p.reason)
        self._carry(e, p.sequence.value)

    def _judge(self) -> Judgement:
        judged = self.judged()
        weighed = judged.weighed
        # An experiment that ended before its first motion has shown nothing, not even in vain.
        last = [e for e in self.state.experiments if e.purpose != "confirm" and self._moved(e)][-1]
        last.odds, last.verdict = weighed.odds, judged.diagnosis.verdict.value
        gaps = {h.name: h.preference for h in weighed.hypotheses}
        last.levels = {name: gap for name, gap in gaps.items() if math.isfinite(gap)}
        last.left = weighed.left
        self.state.save(self._folder)
        shown = ", ".join(f"{spoken(n)} {p:.0%}" for n, p in [*last.odds.items()][:4])
        self._say(f"{last.run}: {last.verdict.replace('_', ' ')}; odds: {shown}")
        return judged

    def _moved(self, e: Experiment) -> bool:
        return bool(read_record(self._place(e.run)).segments)

    def _next(self, judged: Judgement) -> Proposal | None:
        """Return the next experiment, or None, with the reason in the state."""
        state, weighed = self.state, judged.weighed
        first, rivals = weighed.hypotheses[0], weighed.rivals
        designed = [e for e in state.experiments if e.purpose in DESIGNED]
        found, why = None, ""
        if state.left_s < LEAST_S:
            why = f"the budget of {state.budget_min:g} minutes is spent"
        elif len(designed) >= MOST_EXPERIMENTS:
            why = f"{MOST_EXPERIMENTS} experiments did not suffice"
        else:
            vain = {r.name for r in rivals if state.given_up(first.name, r.name)}
            found, late = self._repetition(judged), False
            while found is None and len(vain) < len(rivals):
                # Rivals beyond the first ones are simulated when those are given up.
                before = vain
                found, late = self._proposed(judged, vain, cover=False)
                vain = {r.name for r in rivals if state.given_up(first.name, r.name)}
                if vain == before:
                    break
            if found is None and self._cover_is_worth_while():
                found, short = self._proposed(judged, vain, cover=True)
                late = late or short
            if found is None and late:
                why = f"no experiment fits in the {state.left_s / 60.0:.1f} min left of the budget"
        state.cannot_separate = [
            {
                "names": [first.name, r.name],
                "why": state.given_up(first.name, r.name) or why or "no experiment is worth while",
                "needs": needs(first, r),
            }
            for r in rivals
            if found is None or found.purpose == "cover"
        ]
        if found is None:
            covered = any(e.purpose == "cover" for e in state.experiments)
            state.ended = why or _why_no_more(judged, covered)
        return found

    def _repetition(self, judged: Judgement) -> Proposal | None:
        """Return the experiment again in which one recording alone shows an effect of the best
        hypothesis: what belongs to the machine comes again, a mistake with a weight does not.
        """
        joint, names = judged.weighed.hypotheses[0].joint, set[str]()
        for effect in joint.effects:
            if effect.term.place is not None:
                index = round(effect.shape[effect.term.place])
                names |= {v.recording.name.split("/")[0] for v in joint.views if v.index == index}
        repeated = {e.repeats for e in self.state.experiments}
        for e in self.state.experiments:
            affordable = e.state == Ending.DONE.value and e.seconds <= self.state.left_s
            if affordable and e.sequence and not e.repeats and e.run in names - repeated:
                name = " and ".join(map(spoken, judged.weighed.hypotheses[0].names))
                reason = (
                    f"repeats {e.run}: whether {name} of one recording comes again; "
                    f"{e.seconds / 60.0:.1f} min of the bench"
                )
                sequence = load_sequence(self._folder / e.sequence)
                return Proposal(
                    "repeat", sequence, reason, e.seconds, e.weight_changes, {}, {}, e.run
                )
        return None

    def _proposed(
        self, judged: Judgement, vain: Collection[str], cover: bool
    ) -> tuple[Proposal | None, bool]:
        """Return an experiment that separates, or one that covers, and whether the budget is too
        short for one; note what none separates.
        """
        state = self.state
        chosen = propose(
            self.bench,
            judged.weighed,
            judged.diagnosis.fit.bandwidth_Hz,
            state.seed,
            len(state.experiments) + 1,
            self._progress,
            state.left_s,
            self._tripped(),
            cover,
            vain,
        )
        state.indistinct |= {joined(*pair): z for pair, z in chosen.indistinct.items()}
        return chosen.proposal, chosen.late

    def _cover_is_worth_while(self) -> bool:
        """Whether to run one more experiment that covers: the last ones have shown something, or
        too few have covered since the last failed prediction.
        """
        weighed = [e for e in self.state.experiments if e.odds]
        least = VAIN if weighed[-1].verdict == Verdict.NOTHING_MISSING.value else 1
        covers = vain = 0
        for before, e in pairwise(weighed):
            if e.purpose == "refute":
                covers = vain = 0
                continue
            covered = e.purpose == "cover"
            moved = max(abs(p - before.odds.get(n, 0.0)) for n, p in e.odds.items())
            shown = moved >= LEAST_SHOWN or e.left > RULES.tested_from * before.left
            covers += covered
            vain = 0 if shown else vain + covered
        return covers < MOST_COVERS and vain < least

    def _tripped(self) -> list[str]:
        """Return the names of the stages that have tripped."""
        tripped = [e for e in self.state.experiments if e.state == Ending.TRIPPED.value]
        return tripped_stages([self._place(e.run) for e in tripped])

    def _confirm(self, final: Judgement) -> None:
        """Predict one more experiment, seal the prediction, and run the experiment."""
        state = self.state
        rng = np.random.default_rng([state.seed, len(state.experiments), 1])
        prediction = predict(
            self.bench,
            final.outcome,
            final.weighed,
            rng,
            self._progress,
            state.confirm,
            self._tripped(),
        )
        if isinstance(prediction, str):
            if state.confirm:
                raise InputError(f"{state.confirm}: no confirming experiment: {prediction}")
            self._say(f"no confirming experiment: {prediction}")
            return
        path = self._prediction
        write_json(path, prediction.sealed)
        state.confirmation = {"predicted_sha256": sha256_file(path)}
        self._say(f"prediction sealed: SHA-256 {state.confirmation['predicted_sha256']}")
        e = _planned(prediction.reason, prediction.seconds, prediction.weight_changes, "confirm")
        self._carry(e, prediction.sequence)

    def _compare(self) -> Confirmation | None:
        """Compare the confirming run, if it was completed, with its prediction."""
        runs = [e for e in self._confirming() if e.state == Ending.DONE.value]
        if not runs:
            for e in self._confirming():
                self._say(f"{e.run}: ended as {e.state}, so that the prediction is not tested")
            return None
        path, digest = self._prediction, self.state.confirmation["predicted_sha256"]
        if (now := sha256_file(path)) != digest:
            raise InputError(
                f"{path}: SHA-256 is {now}, was {digest} when sealed; the prediction was changed"
            )
        found = compare(read_json(path), self.recordings(self._place(runs[-1].run)))
        if found is None:
            self._say(f"{runs[-1].run}: the prediction is not compared: there is no steady motion")
            return None
        self.state.confirmation |= found.record()
        self.state.save(self._folder)
        return found


def tripped_stages(folders: Sequence[Path]) -> list[str]:
    """Return the names of the stages of runs that have tripped."""
    stages = [stage for folder in folders for stage in read_record(folder).stages]
    return [stage.name for stage in stages if stage.state == Ending.TRIPPED.value]


def _why_no_more(judged: Judgement, covered: bool) -> str:
    """Return why no experiment is worth while; ``covered``: whether one covered new motions."""
    first, named = judged.weighed.hypotheses[0], {e.name for e in judged.diagnosis.effects}
    if judged.weighed.rivals:
        return "no experiment within limits, weights and channels of this bench separates the rest"
    if named and named != {*first.names}:
        said = " and ".join(map(spoken, sorted(named)))
        return f"{spoken(first.name)} has the greatest likelihood, but the diagnosis selects {said}"
    rejected = "every rival is rejected, and " if first.names else ""
    if not covered:
        return f"{rejected}no experiment of this bench covers new motions"
    return f"{rejected}the last experiments that covered new motions changed nothing"


def _planned(reason: str, seconds: float, changes: int, purpose: str) -> Experiment:
    return Experiment("", "", reason, seconds, changes, purpose=purpose)


def drive_after(folder: Path, state: State) -> str:
    """Return how the last experiment of an investigation left the drive, as text."""
    runs = [e.run for e in state.experiments if e.sequence and is_file(folder / e.run / RUN_FILE)]
    if not runs:
        return "no experiment has begun: this investigation has not energised the drive"
    off = read_record(folder / runs[-1]).de_energised
    words = "the drive was read back de-energised" if off else NOT_READ_BACK
    return f"no experiment is under way; after the last one, {runs[-1]}, {words}"


def given_run(folder: Path) -> Experiment:
    """Return a run that exists as an experiment of an investigation."""
    record = read_record(folder)
    state = Ending.CRASHED.value if record.state == "running" else record.state
    changes = weight_changes(record.stages)
    return Experiment(
        str(folder.absolute()), "", "a run that existed", 0.0, changes, state, "given"
    )


def joined(first: str, rival: str) -> str:
    """Return two hypotheses as one key."""
    return f"{first} | {rival}"


def needs(first: Hypothesis, rival: Hypothesis) -> str:
    """Return what would separate two hypotheses that no experiment of the bench separates."""
    differing = sorted({*first.names} ^ {*rival.names})
    by_hand = [n for n in differing if EFFECTS[n].separation is None]
    return " ".join(EFFECTS[n].experiment for n in (by_hand or differing)[:1])
