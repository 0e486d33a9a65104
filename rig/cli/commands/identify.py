"""``rig identify`` and ``rig simulate``: identify a run or a campaign in stages, with tables,
figures and a report, and predict recordings from a result.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig.cli import options as shared
from rig.common.places import is_folder, require_folder, source_name
from rig.terminal.output import ShareBar

_METHODS: dict[str, tuple[str, ...]] = {
    "default": ("default",),
    "paper": ("paper",),
    "both": ("default", "paper"),
}


_OF_PLAN = ("bench", "nominal", "current_noise")
_OF_ONE_UNIT = ("ladder", "score", "profile", "draws")


@click.command("identify")
@click.argument("source", type=shared.PATH, required=False)
@click.option(
    "--method",
    type=click.Choice(list(_METHODS)),
    default="default",
    help="Estimation method; `both` shows both methods side by side.",
)
@shared.flag(
    "--compare",
    "Also run the paper's GA, differential evolution, CMA-ES and multi-start least squares, "
    "and compare the results.",
    "compared",
)
@shared.flag(
    "--profile",
    "Also compute the profile likelihood of every parameter, with its 90 % range; takes some "
    "ten seconds more.",
)
@click.option(
    "--bootstrap",
    "draws",
    metavar="N",
    type=click.IntRange(min=20),
    help="Also compute the spread over N draws of the motion segments, with replacement; each "
    "draw takes some half a second.",
)
@click.option(
    "--plan",
    "sequence",
    metavar="SEQUENCE",
    help="Instead of SOURCE: predict which parameters this sequence determines.",
)
@click.option(
    "--bench", default="practical", help="With --plan: bench for which the sequence is planned."
)
@shared.path(
    "--nominal",
    "With --plan: last accepted result of `rig identify --json`. [default: the paper's "
    "friction and the practical bench's inertia]",
)
@click.option(
    "--current-noise",
    metavar="A",
    type=shared.Number(min=0.0, min_open=True),
    help="With --plan: noise of the logged current, rms. [default: the value in the --nominal "
    "file, else a thousandth of the current limit]",
)
@shared.bandwidth("Bandwidth of torque and regressors; chosen from the recordings if left out.")
@shared.partial
@shared.flag("--ladder", "Fit and score every friction model of the ladder as well.")
@shared.path(
    "--score",
    "Another source on which the result is scored: error and noise floor of that source, "
    "and the parameters that changed.",
    metavar="SOURCE",
)
@shared.seed()
@shared.out_folder(
    "Folder for report and figures. [default: the run folder, ./CAMPAIGN-identified or "
    "./SEQUENCE-planned]"
)
@shared.result_file
def identify(
    source: Path | None,
    sequence: str | None,
    method: str,
    compared: bool,
    out: Path | None,
    json_file: Path | None,
    bench: str,
    nominal: Path | None,
    current_noise: float | None,
    bandwidth: float | None,
    **options: Any,
) -> None:
    """Identify inertia, system load and working load from SOURCE, a run folder or a campaign file.

    The recordings of a campaign may be of several units (key `unit`): each unit is identified, with
    means and spreads over the units, what they share, and which unit is odd.

    With --plan, nothing is identified: the command predicts which parameters a sequence determines,
    before it is run.

    \b
    Example:
      rig identify runs/demo
      rig identify runs/demo --compare
      rig identify runs/demo --profile
      rig identify runs/demo --bootstrap 100
      rig identify --plan figure10 --bench practical --nominal runs/demo/identify.json
      rig identify bench.yaml --method both --bandwidth 30 --json result.json
      rig identify monday.yaml --score friday.yaml
      rig identify runs/stopped --partial
    """
    if (source is None) is (sequence is None):
        raise click.UsageError(
            "give either SOURCE, the recordings, or --plan SEQUENCE, a planned experiment"
        )
    if sequence is not None:
        unused = {"method", "compared", "bandwidth", "seed", *options}
        shared.require_not_given(unused, "identifies recordings; leave it out with --plan")
        _plan(sequence, bench, nominal, current_noise, out, json_file)
        return
    assert source is not None
    shared.require_not_given(_OF_PLAN, "belongs to --plan SEQUENCE, which is not given")
    if compared and method == "paper":
        raise click.UsageError(
            "--compare compares the other methods with the default method; leave out --method paper"
        )
    if method == "paper" and any(options[n] for n in _OF_ONE_UNIT):
        raise click.UsageError(
            "--ladder, --score, --profile and --bootstrap need the default method; leave "
            "--method paper out"
        )
    # Imported late: --help must not wait for the numerics.
    from rig.results import fleet
    from rig.results.document import PAGE_FILE, shown, text, write_record
    from rig.results.identify.document import write_identification
    from rig.results.identify.identify import Request, compare_methods, identify_source
    from rig.runs.recorded_inputs import truth_of

    folder = out or (source if is_folder(source) else Path(f"{source.stem}-identified"))
    require_folder(folder, "--out")
    request = Request(_METHODS[method], bandwidth, **options)
    if (campaign := fleet.campaign_of_units(source)) is not None:
        if compared or method != "default" or any(options[n] for n in _OF_ONE_UNIT):
            raise click.UsageError(
                "the campaign has several units, which --method, --compare, --ladder, --score, "
                "--profile and --bootstrap do not take; use a campaign with one unit"
            )
        with ShareBar() as bar:
            units = fleet.identify_fleet(source, campaign, request, bar)
        write_record(fleet.fleet_record(units), folder / fleet.FLEET_FILE, json_file)
        for file, record in fleet.unit_records(units):
            write_record(record, folder / file, None)
        document = fleet.fleet_document(source_name(source), units)
        click.echo(shown(document, folder / PAGE_FILE))
        return
    with ShareBar() as bar:
        outcome = identify_source(source, request, bar)
        truth = truth_of(source)
        if compared:
            outcome = compare_methods(source, outcome, truth, bar)
        bar("writing the report", 1.0)
        _, document = write_identification(source, outcome, truth, folder, json_file)
    click.echo(text(document))
    click.echo(f"report: {folder / PAGE_FILE}")


def _plan(
    sequence: str,
    bench: str,
    nominal: Path | None,
    current_noise: float | None,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Report which parameters a sequence would determine."""
    from rig.config.bench import load_bench
    from rig.config.sequence import load_sequence
    from rig.results.document import text, write_record
    from rig.results.identify.plan import RESULT_FILE, plan_document, plan_experiment, plan_record

    folder = out or Path(f"{Path(sequence).stem}-planned")
    require_folder(folder, "--out")
    bench_file, sequence_file = load_bench(bench), load_sequence(sequence)
    with ShareBar() as bar:
        bar("simulating the experiment", 0.0)
        experiment = plan_experiment(sequence_file, bench_file, nominal, current_noise)
    write_record(plan_record(experiment, bench_file.value.name), folder / RESULT_FILE, json_file)
    click.echo(text(plan_document(experiment)))


@click.command("simulate")
@click.argument("source", type=shared.PATH)
@shared.path(
    "--result",
    "Result file of rig identify or rig diagnose.",
    type=shared.FILE,
    metavar="FILE",
    required=True,
)
@shared.own_effects
@shared.bandwidth("Bandwidth of the errors. [default: that of the result]")
@shared.out_folder("Folder for report and figures. [default: ./SOURCE-simulated]")
@shared.result_file
def simulate(
    source: Path,
    result: Path,
    effects_file: Path | None,
    bandwidth: float | None,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Predict the recordings of SOURCE with the model of a result, and compare the prediction with
    the recordings.

    The model predicts torque, voltage and the difference of the encoders from the motion, with and
    without the effects of a diagnosis. If the campaign declares a controller, the closed loop is
    also simulated, from its command alone. A 90 % band of the torque is stated with the share of
    the samples that it holds, and recordings that leave the angles, speeds and loads of the fit.
    The model as a simulated bench is written next to the report.

    \b
    Example:
      rig diagnose bench.yaml --json found.json
      rig simulate later.yaml --result found.json
    """
    # Imported late: --help must not wait for the numerics.
    from rig.results.diagnose.own_effects import read_effects
    from rig.results.document import PAGE_FILE, shown, write_record, write_texts
    from rig.results.identify import simulate as model

    folder = out or Path(f"{source_name(source)}-simulated")
    require_folder(folder, "--out")
    with ShareBar() as bar:
        own = read_effects(effects_file)
        found = model.simulate_source(source, result, bandwidth, bar, own)
        bar("writing the report", 1.0)
        write_record(model.simulation_record(found), folder / model.RESULT_FILE, json_file)
        bench, said = model.as_bench(source, found, own)
        write_texts(bench, folder)
        document = model.simulate_document(source_name(source), found, said)
        report = shown(document, folder / PAGE_FILE)
    click.echo(report)
