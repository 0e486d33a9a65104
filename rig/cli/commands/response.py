"""``rig response`` and ``rig tune``: the frequency response of a bench, and gains for margins."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli import options as shared
from rig.cli.entry import BAD_VERDICT, DONE, STOPPED
from rig.common.errors import InputError
from rig.common.places import read_json, require_folder, usable, write_text
from rig.common.provenance import Provenance, sha256_file, utc_now, versions

if TYPE_CHECKING:
    from identification.simulation.frequency_response import Gains, Spectra, Wanted
    from rig.config.bench import Bench
    from rig.config.configuration import Document
    from rig.planning.predicted_load import FrictionModel
    from rig.results.response.measure import LoopPlace, Response
    from rig.results.response.tuning import Tuning, Written

_PASSED = ("yes", "realtime", "seed", "operator_name", "first_pass", "reset_fault")


def _of_a_run(command: Callable[..., int]) -> Callable[..., int]:
    """Add the options that both commands pass on to their runs."""
    for option in (
        shared.result_file,
        shared.reset_fault(),
        shared.first_pass,
        shared.operator_name,
        shared.simulated_seed,
        click.option(
            "--amplitude",
            type=shared.Number(min=0.01, max=1.0),
            default=1.0,
            help="Factor on the tones, for a joint that would reverse.",
        ),
        shared.realtime,
        shared.yes,
        shared.out_folder(
            "Folder for run, result and report. [default: ./BENCH-response, ./BENCH-tune]"
        ),
    ):
        command = option(command)
    return command


@click.command("response")
@click.argument("bench")
@shared.path(
    "--result",
    "Result of `rig identify --json` whose model is drawn beside the measurement, and whose "
    "friction is used to plan the run.",
    type=shared.FILE,
)
@_of_a_run
def response(
    bench: str, result: Path | None, out: Path | None, json_file: Path | None, **passed: Any
) -> int:
    """Measure plant, open and closed loop of BENCH, and report the margins of the open loops.

    A run of three stages moves the joint on a slow sine and adds small tones at two amplitudes,
    with the limits, prompts and safety of `rig run`. Where the joint does not reverse, friction is
    constant, so that the loops are linear. Margins are those of the opened position and speed loop,
    with 90 % intervals; a crossing beyond the highest line is not reported. The page shows Bode and
    Nyquist plots beside the nominal model.

    \b
    Example:
      rig response practical --yes --out response
      rig response practical --yes --result runs/demo/identify.json
    """
    from rig.config.bench import load_bench
    from rig.results.document import PAGE_FILE, shown, write_record
    from rig.results.response.measure import RESULT_FILE, response_document, response_record

    bench_file = load_bench(bench)
    folder = out or Path(f"{bench_file.path.stem}-response")
    status, found = _measure(bench_file, folder, _friction(bench_file, result), passed)
    if found is None:
        return status
    write_record(response_record(found), folder / RESULT_FILE, json_file)
    click.echo(shown(response_document(found), folder / PAGE_FILE))
    return DONE


def _friction(bench: Document[Bench], result: Path | None) -> FrictionModel:
    from rig.planning.predicted_load import friction_model
    from rig.runs.run import bench_constants

    return friction_model(bench_constants(bench.value), result, option="--result")


def _measure(
    bench: Document[Bench],
    folder: Path,
    friction: FrictionModel,
    passed: dict[str, Any],
    **excited: Any,
) -> tuple[int, Response | None]:
    """Run an excitation by `rig run` and evaluate it; return the exit status of the run."""
    from rig.cli.commands.run import run
    from rig.results.response.excitation import excitation
    from rig.results.response.measure import evaluate, loop_place

    require_folder(folder, "--out")
    loop_place(bench)
    made = excitation(bench.value, friction, passed["seed"], passed["amplitude"], **excited)
    sequence = folder / "response.yaml"
    with usable(folder, "written", "give --out another place"):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(sequence, made.text)
    status = click.get_current_context().invoke(
        run,
        sequence=str(sequence),
        bench=str(bench.path),
        out=folder / "run",
        **{name: passed[name] for name in _PASSED},
    )
    if status != DONE:
        return int(status), None
    return DONE, evaluate(bench, folder / "run", made, friction, passed["seed"])


@click.command("tune")
@click.argument("bench")
@click.option(
    "--phase-margin",
    "phase_deg",
    metavar="DEG",
    type=shared.Number(min=20.0, max=85.0),
    default=60.0,
    help="Least phase margin of each loop.",
)
@click.option(
    "--gain-margin",
    "gain_dB",
    metavar="DB",
    type=shared.Number(min=3.0, max=40.0),
    default=8.0,
    help="Least gain margin of each loop.",
)
@shared.bandwidth("Crossover of the position loop. [default: the highest with these margins]")
@shared.path(
    "--result",
    "Result of `rig response`, or of `rig identify` for a bench whose gains are known; then "
    "nothing is run. [default: a new measurement]",
    type=shared.FILE,
)
@shared.flag(
    "--write",
    "Try the gains in two steps, and write them into a new bench file if both keep their margins.",
)
@_of_a_run
def tune(
    bench: str,
    phase_deg: float,
    gain_dB: float,
    bandwidth: float | None,
    result: Path | None,
    write: bool,
    out: Path | None,
    json_file: Path | None,
    **passed: Any,
) -> int:
    """Propose gains for BENCH with stated margins, and state the expected step response.

    The gains follow from a response that is measured as by `rig response`, or from --result. With
    --write, the gains are tried in two runs, halfway and in full. After a limit, a lost margin or
    an oscillation the old gains remain; otherwise a new bench file holds the new ones. Gains inside
    a real drive are only printed, in the units of its maker's tool.

    The status is 1 if margins or bandwidth cannot be reached, or the gains failed the trial.

    \b
    Example:
      rig tune practical --yes --phase-margin 60 --gain-margin 8 --out tune
      rig tune bench.yaml --result response/response.json --bandwidth 8
      rig tune bench.yaml --yes --write
    """
    from identification.simulation.frequency_response import NoResponseError, Wanted
    from rig.config.bench import load_bench
    from rig.config.configuration import beside
    from rig.results.document import PAGE_FILE, shown, write_record
    from rig.results.response import tuning
    from rig.results.response.measure import (
        RESPONSE_SCHEMA,
        loop_place,
        read_response,
        require_response_of,
    )

    bench_file = load_bench(bench)
    place = loop_place(bench_file)
    folder = out or Path(f"{bench_file.path.stem}-tune")
    require_folder(folder, "--out")
    if write:
        tuning.keys_of(bench_file, place)
        if (tuned := beside(bench_file, folder, "tuned")).exists():
            raise InputError(f"{tuned}: exists; move it away, so that no bench file is overwritten")
    ripple = None
    if result is None:
        friction = _friction(bench_file, None)
        status, measured = _measure(bench_file, folder, friction, passed)
        if measured is None:
            return status
        source, ripple = (measured.seen, measured.fitted.gains), measured.ripple_N_m
    else:
        record = read_json(result)
        if isinstance(record, dict) and record.get("schema") == RESPONSE_SCHEMA:
            seen, gains, ripple = read_response(result)
            require_response_of(result, bench_file, place)
            source = seen, gains
        else:
            source = tuning.modelled(bench_file, place, _friction(bench_file, result))
    if write and ripple is None:
        raise InputError(
            f"--write: {result} does not state the ripple of the torque, with which an oscillation "
            "is seen; leave --result out, or give a result of `rig response`"
        )
    wanted = Wanted(phase_deg, gain_dB, bandwidth)
    try:
        found = _proposed(bench_file, place, source, wanted, result, folder, passed["seed"])
        if ripple is not None and write and not found.proposal.problem:
            found = _tried(bench_file, found, folder, ripple, passed)
    except NoResponseError as error:
        raise InputError(f"{bench_file.path}: {error}") from error
    write_record(tuning.tune_record(found), folder / tuning.RESULT_FILE, json_file)
    click.echo(shown(tuning.tune_document(found, bench_file), folder / PAGE_FILE))
    return DONE if found.good else BAD_VERDICT


def _proposed(
    bench: Document[Bench],
    place: LoopPlace,
    source: tuple[Spectra, Gains],
    wanted: Wanted,
    result: Path | None,
    folder: Path,
    seed: int,
) -> Tuning:
    from identification.simulation.frequency_response import loops, margins, propose
    from rig.results.response.tuning import Tuning

    seen, old = source
    read = result or folder / "run" / "run.json"
    created = utc_now().isoformat(timespec="seconds")
    return Tuning(
        bench.value.name,
        place,
        "a measured response" if result is None else str(result),
        seen,
        old,
        {name: margins(loop) for name, loop in loops(seen, old).items()},
        wanted,
        propose(seen, old, wanted),
        None,
        Provenance(seed, {str(read): sha256_file(read)}, 0.0, created, versions()),
    )


def _tried(
    bench: Document[Bench],
    found: Tuning,
    folder: Path,
    ripple_N_m: float,
    passed: dict[str, Any],
) -> Tuning:
    """Try the proposed gains step by step; keep the new bench file if all steps are good."""
    from rig.config.configuration import beside
    from rig.results.response.tuning import RAMP, Written, between, with_gains

    path, written = beside(bench, folder, "tuned"), Written()
    try:
        for number, share in enumerate(RAMP, 1):
            gains = between(found.old, found.proposal.gains, share)
            text = with_gains(bench, found.place, found.old, gains)
            step = folder / f"step-{number}"
            why = _step(bench, path, text, found, gains, step, ripple_N_m, passed, written)
            if why:
                written.why = f"step {number} of {len(RAMP)}: {why}; the old gains remain"
                break
        else:
            written.state, written.file = "written", str(path)
            written.why = f"{path} holds the new gains; {bench.path} is unchanged"
    finally:
        if written.state != "written":
            path.unlink(missing_ok=True)
    return dataclasses.replace(found, written=written)


def _step(
    bench: Document[Bench],
    path: Path,
    text: str,
    found: Tuning,
    gains: Gains,
    folder: Path,
    ripple_N_m: float,
    passed: dict[str, Any],
    written: Written,
) -> str:
    """Run the bench with other gains; return why they failed, empty if they are good."""
    from identification.simulation.frequency_response import margins, with_gains
    from rig.config.bench import load_bench
    from rig.results.response.excitation import LARGE
    from rig.results.response.tuning import LOST_DEG, RIPPLE

    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    tried = load_bench(path)
    try:
        status, seen = _measure(
            tried, folder, _friction(bench, None), passed, windows=6, stages=(LARGE,)
        )
    except InputError as error:
        return "; ".join(error.problems)
    if status == STOPPED:
        raise KeyboardInterrupt
    if seen is None:
        return "a limit tripped" if status == BAD_VERDICT else f"the run ended with status {status}"
    assert status == DONE
    phase = seen.margins["position"]["phase_deg"].value
    expected = margins(with_gains(found.seen, found.old, gains)["position"]).phase_deg
    written.steps.append(
        {"phase_deg": phase, "expected_deg": expected, "ripple_N_m": seen.ripple_N_m}
    )
    if phase is None or expected is None or phase < expected - LOST_DEG:
        return f"phase margin {phase} deg where {expected} deg were expected"
    old = found.old
    grown = gains.speed / old.speed if old.speed else gains.position / old.position
    if seen.ripple_N_m > RIPPLE * max(grown, 1.0) * ripple_N_m:
        return f"the torque oscillates: {seen.ripple_N_m:.3g} N m from sample to sample"
    return ""
