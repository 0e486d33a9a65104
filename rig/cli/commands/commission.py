"""``rig commission``: guides an operator through a new bench, step by step."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Literal

import click

from drivers.clock import Clock
from drivers.mock.bench import SimulatedBench, SimulatedDbcBench
from drivers.mock.faults import MISTAKES
from rig.cli import options as shared
from rig.cli.aftermath import STATUS
from rig.cli.crash import note_drive, noting_folder
from rig.cli.entry import BAD_VERDICT, DEVICE_FAILED
from rig.commissioning.commission import Commissioning
from rig.commissioning.commission import commission as go_through
from rig.commissioning.record import StepRecord
from rig.commissioning.record import Verdict as Found
from rig.commissioning.setup import (
    FASTEST_DEG_S,
    AutomaticInterview,
    HomeRequest,
    Interview,
    TypedInterview,
)
from rig.common.errors import InputError
from rig.common.places import require_file, require_folder, usable, write_asked, write_text
from rig.common.provenance import sha256, utc_now, versions
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document, beside
from rig.control.attendance import connected
from rig.control.remote import stoppable
from rig.fault_injection.scene import Scene
from rig.results.document import (
    PAGE_FILE,
    Items,
    Note,
    Section,
    Table,
    write_page,
    write_record,
    write_texts,
)
from rig.results.document import Document as Page
from rig.results.document import Verdict as Headline
from rig.results.document import text as shown
from rig.runs.catalogue.index import COMMISSION_JSON
from rig.runs.recorder import open_recorder
from rig.runs.run import create_folder, part_file, require_unused
from rig.runs.run_record import Ending
from rig.terminal.prompt import Prompt, at_terminal
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import device_files
from rig.wiring.devices import Devices, bench_line, say_taken_over, unprotected
from rig.wiring.preflight import require_startable

RECORD_FILE = COMMISSION_JSON
PATCH_FILE = "bench.patch"
COMMISSION_SCHEMA = "loadrig.commission/1"


@click.command("commission")
@click.argument("bench")
@shared.path(
    "--out", "Folder of the protocol, new or empty. [default: runs/<utc>-commission-<name>]"
)
@shared.path(
    "--bench-out",
    "New file for the corrected bench. [default: BENCH with .commissioned before its ending]",
    type=shared.FILE,
)
@click.option(
    "--angle",
    "angle_deg",
    type=shared.Number(),
    help="True joint angle at the start, deg. Without this option the program asks for the angle; "
    "with --yes and without this option the angle is not checked.",
)
@click.option(
    "--speed-limit",
    "fastest_deg_s",
    type=shared.Number(min=1.0),
    default=FASTEST_DEG_S,
    help="Limit on the joint speed, deg/s, at most a quarter of the bench's limit; with soft "
    "gains, a joint in stick-slip moves faster than the command.",
)
@click.option(
    "--home",
    "home_method",
    type=click.IntRange(-128, 127),
    help="Let the drive set its zero by its own homing, with this method (6098h): 35 and 37 use "
    "the present position, 17 and 18 move to a limit switch; for other methods see the drive's "
    "manual.",
)
@click.option(
    "--home-angle",
    "home_deg",
    type=shared.Number(),
    help="True joint angle of the home position, deg. [default: --angle if the homing method moves "
    "nothing, else the angle of the joint encoder]",
)
@click.option(
    "--home-time",
    "home_time_s",
    type=shared.Number(min=1.0),
    help="Longest time of the homing, s. [default: 5 if the homing method moves nothing, else from "
    "the limits of angle and speed]",
)
@shared.flag("--yes", "Agree to every step; on a simulated bench only.")
@click.option(
    "--mistake",
    type=click.Choice(sorted(MISTAKES)),
    help="Build this mistake into the simulated devices, as a demonstration of the checks.",
)
@shared.simulated_seed
@shared.operator_name
@shared.record_file("Also write commission.json to this file.")
def commission(
    bench: str,
    out: Path | None,
    bench_out: Path | None,
    angle_deg: float | None,
    fastest_deg_s: float,
    home_method: int | None,
    home_deg: float | None,
    home_time_s: float | None,
    yes: bool,
    mistake: str | None,
    seed: int,
    operator_name: str | None,
    json_file: Path | None,
) -> int:
    """Go through BENCH with the operator before its first run, step by step and at low limits.

    The steps are identity, readings, zero, limits, signs, hold, watchdog, a small move, stop, and a
    larger move. Each step states what will move and which devices are under power, asks for
    consent, and shows the measured values. Take all weights off first, and keep a hand on the
    emergency stop. After every step under power, the program takes the power off and reads the
    drive's state back.

    If a value of the bench file is wrong (unit, sign, ratio, zero, torque constant), the step names
    the key and the right value; after the operator agrees, the steps begin again with this value.
    The corrected bench is written to a new file; BENCH itself is never changed. The folder contains
    protocol, recording and the corrections as a patch.

    With --home the drive sets its zero itself (CiA 402 homing), if its EDS file and the drive have
    the necessary objects. If the drive does not offer the method, the other steps are done, and the
    exit status is 1.

    \b
    Example:
      rig commission my_bench.yaml --operator Ada
      rig commission practical --yes --angle 0 --out runs/commissioned
      rig commission practical --yes --mistake rpm
      rig commission practical --yes --angle 0 --home 37
    """
    document = load_bench(bench)
    # The file may be edited while a question waits: protocol and patch are those of this text.
    original = document.path.read_bytes()
    click.echo(bench_line(document))
    _require_allowed(document, yes, mistake)
    require_startable(document, utc_now().date(), lambda words: click.echo(words, err=True))
    folder = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-commission-{document.value.name}"
    require_folder(folder, "--out")
    require_unused(folder)
    new_file = bench_out or beside(document, folder, "commissioned")
    require_file(new_file if bench_out else None, "--bench-out")
    if new_file.exists():
        raise InputError(f"{new_file}: exists already and is not overwritten; give --bench-out")
    place = document.path.parent
    near = [str(f) for f in device_files(document).values() if f.is_relative_to(place)]
    if near and new_file.resolve().parent != place.resolve():
        raise InputError(
            f"--bench-out: the bench names files relative to its own folder ({', '.join(near)}); "
            f"give a name in {place}"
        )
    home = _home(document, home_method, home_deg, home_time_s)
    screen = Screen()
    screen.silence()
    with (
        noting_folder(folder),
        closing(screen),
        StopButton(screen.say) as stop,
        stoppable(stop, screen, document.value, "commissioning") as control,
    ):
        interview: Interview = AutomaticInterview(screen, angle_deg)
        if not yes:
            interview = TypedInterview(screen, Prompt(screen, control=control), stop, angle_deg)
        with create_folder(folder, "rig commission"):
            result = go_through(
                document,
                _connections(stop, seed, mistake, screen),
                interview,
                stop,
                lambda number: open_recorder(folder / part_file(number)),
                fastest_deg_s,
                home,
            )
            written = _keep(result, original, document.path.name, folder, new_file)
            record = commission_record(
                result, document, sha256(original), seed, operator_name, written
            )
            write_record(record, folder / RECORD_FILE, None)
        protocol = commission_document(result, document, operator_name, written)
        screen.say(shown(protocol), err=False)
        write_page(protocol, folder / PAGE_FILE)
        screen.say(f"protocol: {folder / PAGE_FILE}", err=False)
    if result.error is not None:
        note_drive(result.error, "never energised" if result.safe is None else result.safe.message)
        raise result.error
    status = _status(result)
    write_asked(json_file, record)
    return status


def _home(
    document: Document[Bench], method: int | None, angle_deg: float | None, time_s: float | None
) -> HomeRequest | None:
    """Return the requested homing, or None without ``--home``."""
    for given, name in ((angle_deg, "--home-angle"), (time_s, "--home-time")):
        if method is None and given is not None:
            raise InputError(f"{name}: is an option of a homing; give --home METHOD as well")
    limits = document.value.limits
    low, high = limits.angle_min_deg, limits.angle_max_deg
    if angle_deg is not None and not low <= angle_deg <= high:
        raise InputError(
            f"--home-angle: is {angle_deg:g} deg; it must be from {low:g} to {high:g} deg, the "
            "limits of the bench"
        )
    return None if method is None else HomeRequest(method, angle_deg, time_s)


def _status(result: Commissioning) -> int:
    """Return the exit status; a requested homing that was not done is a bad verdict."""
    if result.safe is not None and not result.safe.verified:
        return DEVICE_FAILED
    if result.ending is Ending.DONE and result.not_homed:
        click.echo(f"rig commission: {result.not_homed}", err=True)
        return BAD_VERDICT
    return STATUS[result.ending]


def _require_allowed(document: Document[Bench], yes: bool, mistake: str | None) -> None:
    """Refuse options for simulated benches only, and a real bench without a person."""
    if document.value.simulated:
        any_drive = mistake is None or MISTAKES[mistake].any_drive
        if not any_drive and document.value.servo.kind != "canopen":
            raise InputError(f"--mistake {mistake}: needs a simulated drive of kind canopen")
        mock = document.value.mock
        changes = mistake is not None and MISTAKES[mistake].change is not None
        if changes and mock is not None and mock.plant:
            text = f"--mistake {mistake} changes the program's own machine, which this bench lacks"
            raise InputError(document.problem(("mock", "plant"), text))
        return
    if yes:
        raise InputError(
            f"{document.path}: --yes agrees to every step, and this bench is real: run at a "
            "terminal without --yes, with a hand on the emergency stop"
        )
    if mistake is not None:
        raise InputError("--mistake: works with simulated benches only")
    if not at_terminal():
        raise InputError(
            f"{document.path}: there is no terminal to ask at, and this bench is real: run at a "
            f"terminal"
        )


Connect = Callable[[Document[Bench]], Any]


def _connections(stop: StopButton, seed: int, mistake: str | None, screen: Screen) -> Connect:
    """Return the function that opens a bench, with a mistake built in if one is requested."""
    told: list[str] = []

    def spoiled(mock: SimulatedBench | SimulatedDbcBench) -> Clock:
        chosen = MISTAKES[mistake or ""]
        # Serial lines and their devices exist only after the host has opened the lines.
        mock.clock.call_at(mock.clock.now_ns(), lambda: chosen.build_into(mock, Scene(mock).sensor))
        return mock.clock

    @contextmanager
    def connect(document: Document[Bench]) -> Iterator[Devices]:
        attach = None
        if mistake is not None:
            attach, change = spoiled, MISTAKES[mistake].change
            mock = document.value.mock
            if change is not None and mock is not None:
                value = document.value.model_copy(update={"mock": change(mock)})
                document = dataclasses.replace(document, value=value)
        with connected(stop, document, seed, False, attach, purpose="rig commission") as devices:
            say_taken_over(devices.lock, screen)
            for words in unprotected(devices):
                if words not in told:
                    screen.say(words)
                    told.append(words)
            yield devices

    return connect


def _keep(result: Commissioning, original: bytes, name: str, folder: Path, new_file: Path) -> str:
    """Write the corrections of a bench file with this content and name; return the path of the new
    bench file, empty if there is none.
    """
    before = original.decode("utf-8-sig").replace("\r\n", "\n")
    if not result.changes:
        write_texts({"bench.yaml": before}, folder)
        return ""
    old, new = (text.splitlines(keepends=True) for text in (before, result.text))
    # A unified diff that ``patch`` accepts.
    patch = "".join(difflib.unified_diff(old, new, fromfile=name, tofile=name))
    write_texts({PATCH_FILE: patch}, folder)
    with usable(new_file, "written", f"{folder / PATCH_FILE} contains the corrections"):
        write_text(new_file, result.text)
    return str(new_file)


def commission_record(
    result: Commissioning,
    bench: Document[Bench],
    digest: str,
    seed: int,
    operator: str | None,
    new_file: str,
) -> dict[str, Any]:
    """Return the record for the result file; ``digest`` is that of the bench file."""
    return {
        "schema": COMMISSION_SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "versions": versions(),
        "seed": seed,
        "operator": operator,
        "bench": bench.value.name,
        "bench_file": str(bench.path),
        "sha256": digest,
        "real": not bench.value.simulated,
        "new_bench_file": new_file or None,
        **result.record(),
    }


def commission_document(
    result: Commissioning, bench: Document[Bench], operator: str | None, new_file: str
) -> Page:
    """Return the protocol as a document."""
    done = result.ending is Ending.DONE
    good = done and not result.not_homed
    drive = "the drive was never energised" if result.safe is None else result.safe.message
    words = result.words or "All steps are done."
    if not done:
        found = f"Not finished: {result.ending.value}"
    elif result.not_homed:
        found = "Not as asked for: no homing"
        words = f"{result.not_homed[0].upper()}{result.not_homed[1:]}."
    elif result.untried:
        found = f"Good; not tried: {', '.join(result.untried)}"
    else:
        found = "Every step was good"
    statement = f"{words} {drive[0].upper()}{drive[1:]}."
    headline = Headline(found, statement, "good" if good else "found")
    changes: tuple[Items | Note, ...] = (Note("no value of the bench file had to be corrected"),)
    if result.changes:
        values = Items(tuple((f"{c.section}.{c.key}", str(c.value)) for c in result.changes))
        place = f"with these values: {new_file}" if new_file else "no new bench file was written"
        changes = (Note("corrected values:"), values, Note(place))
    summary = Section("Commissioning", (headline, *changes))
    last = len(result.sessions)
    sections = [summary]
    for number, steps in enumerate(result.sessions, start=1):
        title = f"Steps, connection {number} of {last}" if last > 1 else "Steps"
        sections.append(Section(title, tuple(_step(step) for step in steps)))
    kind = "simulated" if bench.value.simulated else "REAL"
    who = f", by {operator}" if operator else ""
    subtitle = f"{kind} bench, {bench.path}{who}, {utc_now():%Y-%m-%d %H:%M} UTC"
    return Page(f"Commissioning of {bench.value.name}", subtitle, (summary,), tuple(sections))


def _step(step: StepRecord) -> Section:
    rows = tuple((item.name, item.value, item.unit) for item in step.measured)
    measured = (Table(("measured", "value", "unit"), rows, (1,)),) if rows else ()
    consent = f" Agreed to: {step.consent}." if step.consent else ""
    announced = Note(f"{step.announced}{consent}", "aside")
    tone: Literal["warning", "plain"] = "warning" if step.verdict is Found.WRONG else "plain"
    words = Note(f"{step.verdict.value}: {step.words}", tone)
    return Section(step.name, (announced, *measured, words))
