"""Does the proposed experiment tighten the weakest parameter? Random benches, measured end to end.

Each bench: the nine constants of the practical bench each within 40 % (redrawn until the static
limits stand at least 20 % above the Coulomb levels). `rig run figure10`, `rig identify`,
`rig identify --plan figure10` on that result, `rig run` of the proposal, `rig identify` of it. The
weakest parameter is that with the widest relative interval after Figure 10; its interval then over
its interval after the proposal is the gain. The proposal lasts no longer than Figure 10. One run of
Figure 10 may state twice what the next one does, as a single stroke in which the shaft all but
stops tells much: both are run with several noises, and the gain is that of the median intervals.
The proposal knows of the first run alone.

    python benchmarks/plan_study.py --benches 20
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from drivers.mock.plant.parts.constants import Joint
from identification.estimate.default import identify
from identification.result import Identification
from rig.cli import entry as cli
from rig.common.places import write_json
from rig.common.provenance import Provenance
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.results.document import write_texts
from rig.results.identify.design import (
    PROPOSAL_FILE,
    excitation_words,
    plan_experiment,
    proposal_text,
)
from rig.results.identify.identify import identification_record
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run

SPREAD = 0.4
LEAST_RISE = 1.2
_CONSTANTS = (
    "Mc_N_m",
    "Ms_N_m",
    "omega_sf_rad_s",
    "sigma_2_N_m_s_rad",
    "inertia_kg_m2",
    "mu_c",
    "mu_s",
    "omega_sL_rad_s",
    "mu_2_s_rad",
)


def random_bench(seed: int, path: Path) -> None:
    """Write the practical bench with other constants behind it."""
    rng = np.random.default_rng(seed)
    usual = dataclasses.asdict(Joint())
    while True:
        drawn = {
            name: usual[name] * float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))
            for name in _CONSTANTS
        }
        if (
            drawn["Ms_N_m"] > LEAST_RISE * drawn["Mc_N_m"]
            and drawn["mu_s"] > LEAST_RISE * drawn["mu_c"]
        ):
            break
    tree = yaml.safe_load(resolve("practical", "benches").read_text(encoding="utf-8"))
    tree["mock"]["joint"].update(drawn)
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")


def identified(sequence: str, bench: Path, seed: int, folder: Path) -> Identification:
    """Run a sequence through the whole simulated chain and identify its log; keep the result as a
    file.

    A run that ends with a verdict, such as a doubted weight, is a whole one.
    """
    status = cli.status(
        ["run", sequence, "--bench", str(bench), "--yes", "--seed", str(seed), "--out", str(folder)]
    )
    if status not in (0, 1):
        raise SystemExit(f"bench {bench}, {sequence}: rig run ended with status {status}")
    dataset = load_run(folder)
    result = identify(dataset)
    record = identification_record(result, Provenance.of(0, dataset.recordings, result.seconds))
    write_json(folder / "identify.json", record)
    return result


def widths(result: Identification) -> dict[str, float]:
    """Return relative half widths of the intervals; infinite where a parameter was not
    identified.
    """
    return {
        name: np.inf
        if p.value is None or p.low is None or p.high is None
        else 0.5 * (p.high - p.low) / p.value
        for name, p in result.parameters.items()
    }


def median_widths(results: Sequence[Identification]) -> dict[str, float]:
    """Return the median relative half widths over several runs of one experiment."""
    found = [widths(r) for r in results]
    return {name: float(np.median([w[name] for w in found])) for name in found[0]}


def study(seed: int, scratch: Path, runs: int) -> list[str]:
    """Return one row of the table."""
    bench = scratch / "bench.yaml"
    random_bench(seed, bench)
    first = [
        identified("figure10", bench, seed + 100 * k, scratch / f"first{k}") for k in range(runs)
    ]
    nominal = scratch / "first0" / "identify.json"
    sequence, document = load_sequence("figure10"), load_bench(bench)
    experiment = plan_experiment(
        sequence, document, nominal, None, seed, lambda _what, _share: None
    )
    write_texts({PROPOSAL_FILE: proposal_text(experiment, "random")}, scratch / "plan")
    proposal = scratch / "plan" / PROPOSAL_FILE
    second = [
        identified(str(proposal), bench, seed + 1000 + 100 * k, scratch / f"second{k}")
        for k in range(runs)
    ]
    before, after = median_widths(first), median_widths(second)
    weakest = experiment.proposal.weakest
    left = max(after, key=lambda name: after[name])
    present, proposed = (
        p.half_widths[weakest] for p in (experiment.proposal.present, experiment.proposal.pinned)
    )
    truth = truth_of(scratch / "second0")
    assert truth is not None
    held = [
        p.value is not None
        and p.low is not None
        and p.high is not None
        and p.low <= truth[name] <= p.high
        for result in second
        for name, p in result.parameters.items()
    ]
    errors = [
        abs(r.parameters[weakest].value / truth[weakest] - 1.0)
        for r in second
        if r.parameters[weakest].value
    ]
    refused = sum(r.noise is None for r in second)
    stages = experiment.proposed.stages
    commands = "; ".join(
        f"{s.duration_s:.3g} s, {s.weight_kg:g} kg: {excitation_words(s)}" for s in stages
    )
    return [
        str(seed),
        weakest,
        " ".join(f"{100 * widths(r)[weakest]:.2f}" for r in first),
        " ".join(f"{100 * widths(r)[weakest]:.2f}" for r in second),
        f"{before[weakest] / after[weakest]:.2f}",
        f"{present / proposed:.1f}",
        f"{100 * after[left]:.2f} ({left})",
        f"{before[weakest] / after[left]:.1f}",
        f"{sum(held)}/{len(held)}",
        " ".join(f"{100 * e:.2f}" for e in errors),
        commands,
        f"{refused} refused" if refused else "-",
    ]


def main() -> None:
    """Run all benches and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--runs", type=int, default=3, help="noises of each experiment")
    arguments = parser.parse_args()
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.benches):
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(study(seed, Path(scratch), arguments.runs))
        print("row:", *rows[-1], flush=True)
    header = [
        "bench",
        "weakest",
        "Fig. 10, %",
        "proposed, %",
        "gain",
        "promised",
        "widest by the proposal, %",
        "gain of the widest",
        "true inside",
        "errors, %",
        "proposal",
        "refinement",
    ]
    print(table(header, rows, (2, 3, 4, 5)))
    gains = [float(row[4]) for row in rows]
    reached = sum(gain >= 3.0 for gain in gains)
    print(
        f"at least threefold on {reached} of {len(gains)}; least {min(gains)}, median "
        f"{np.median(gains):.1f}"
    )


if __name__ == "__main__":
    main()
