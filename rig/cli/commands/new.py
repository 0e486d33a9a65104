"""``rig new`` and ``rig schema``: write files to start from, and the JSON Schemas of such files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import click

from drivers.mock.plant.parts.constants import Joint
from rig.cli import options as shared
from rig.cli.authoring import campaign as campaigns
from rig.cli.authoring.questions import Answers, Listed, Quantity, Question, ask_all, options, shown
from rig.cli.authoring.schema import KINDS, json_schema
from rig.cli.authoring.writing import RefusedError, fill, require_new, write_new, write_schema
from rig.config.bench import Bench, Constants, load_bench
from rig.config.campaign import load_campaign
from rig.config.configuration import Document
from rig.config.sequence import load_sequence
from rig.config.serial_bus import SerialBus, overload
from rig.config.simulated_machine import PAPER_TORQUE_N_M, derived
from rig.planning.plan import make_plan
from rig.terminal.prompt import Prompt
from rig.terminal.screen import Screen

_PATH = click.argument("path", type=shared.PATH)
_YES = shared.flag("--yes", "Ask no questions: values that no option gives have their defaults.")
_GRAVITY_M_S2: Final[float] = Constants.model_fields["gravity_m_s2"].default
_SPEED_SHARE, _GREATEST_SPEED_DEG_S = 0.8, 120.0
"""Default speed limit: a share of the no-load speed at the supply voltage, and at most this."""
_OVER_RATED: Final = 5.0 / 3.0
_OVER_WEIGHT: Final = 1.2
_HARD_SHARE: Final = 0.8
"""Share of the torque limit above which the friction under a weight is a remark."""
_PERIODS_MS: Final = (2, 4, 5, 8, 10, 20, 25, 40, 50, 100, 125, 200, 250, 500)
"""Control cycles, ms, from which one is chosen for a serial line; all rates in Hz are round."""
_ROTOR_SHARE: Final = 0.8
"""Largest share of the rotor's inertia in the joint's inertia of a simulated bench."""
_PERIODS, _SHORTEST_S, _RAMP_S = 4.0, 20.0, 1.0
"""Default duration of a stage: so many periods, at least this time; fade-in and fade-out."""
_DATA_SHEET = (
    "torque_constant",
    "resistance",
    "inductance",
    "gear_ratio",
    "rated_current",
    "motor_counts",
    "moment_arm",
)
"""Answers of `rig new bench` that are properties of the machine."""


def _real(answers: Mapping[str, Any]) -> bool:
    return bool(answers["devices"] == "real")


def _serial(answers: Mapping[str, Any]) -> bool:
    return bool(answers["drive"] == "epos4-serial")


def _real_can(answers: Mapping[str, Any]) -> bool:
    return _real(answers) and not _serial(answers)


def _real_serial(answers: Mapping[str, Any]) -> bool:
    return _real(answers) and _serial(answers)


def _torque_N_m(answers: Mapping[str, Any]) -> float:
    return float(answers["torque_constant"] * answers["gear_ratio"] * answers["current_limit"])


def _free_speed_deg_s(answers: Mapping[str, Any]) -> float:
    """Return the default speed limit, deg/s: a share of the no-load speed, at most 120 deg/s."""
    free = answers["supply"] / (answers["back_emf_constant"] * answers["gear_ratio"])
    return min(_GREATEST_SPEED_DEG_S, float(f"{_SPEED_SHARE * math.degrees(free):.2g}"))


def _simulated(answers: Mapping[str, Any], part: str) -> dict[str, float]:
    """Return the default values of a part of the simulated machine."""
    machine, limits = {"gear_ratio": answers["gear_ratio"]}, {"torque_N_m": _torque_N_m(answers)}
    values = derived({"machine": machine, "limits": limits})[part]
    assert isinstance(values, dict)
    return values


_WHOLE: Final = click.IntRange(1)
_WEIGHTS: Final = Question(
    "weights", "Weights to hang in turn after the empty lever, or none", "kg", (2.0, 5.0), Listed()
)
BENCH: Final = (
    Question(
        "drive",
        "Kind of drive",
        default="canopen",
        kind=click.Choice(("canopen", "epos4-serial", "dbc")),
    ),
    Question(
        "devices",
        "Simulated or real devices",
        default="simulated",
        kind=click.Choice(("simulated", "real")),
    ),
    Question("interface", "Interface of python-can", "", "socketcan", click.STRING, _real_can),
    Question("channel", "Channel of that interface", "", "can0", click.STRING, _real_can),
    Question("port", "Serial port of the drive", "", "/dev/ttyUSB0", click.STRING, _real_serial),
    Question(
        "encoder_port",
        "Serial port of the AMT21 joint encoder",
        "",
        "/dev/ttyUSB1",
        click.STRING,
        _real_serial,
    ),
    Question(
        "baud",
        "Baud rate of the drive's port",
        "Bd",
        1_000_000,
        click.IntRange(9_600, 12_000_000),
        _real_serial,
    ),
    Question(
        "round_trip",
        "Time that adapter (FTDI: 16 ms, in low-latency mode 6 ms) and drive add to a request and "
        "its answer",
        "ms",
        1.0,
        Quantity(min=0.0),
        _real_serial,
    ),
    Question(
        "servo_eds",
        "EDS file of the drive, from its maker, relative to the bench file",
        kind=click.STRING,
        when=lambda a: _real(a) and a["drive"] != "dbc",
    ),
    Question(
        "encoder_eds",
        "EDS file of the joint encoder, from its maker, relative to the bench file",
        kind=click.STRING,
        when=_real_can,
    ),
    Question("torque_constant", "Torque constant of the motor", "N m/A", 0.03),
    Question(
        "back_emf_constant",
        "Back-EMF constant of the motor (in SI units equal to the torque constant)",
        "V s/rad",
        lambda a: a["torque_constant"],
    ),
    Question("resistance", "Winding resistance", "ohm", 1.56),
    Question("inductance", "Winding inductance", "H", 0.00132),
    Question("gear_ratio", "Gear ratio, motor turns per turn of the joint", "", 100.0),
    Question("supply", "Supply voltage", "V", 60.0),
    Question(
        "rated_current",
        "Rated current of the motor, as the drive holds it in object 6075h",
        "A",
        15.0,
    ),
    Question(
        "current_limit",
        "Limit on the motor current",
        "A",
        lambda a: float(f"{_OVER_RATED * a['rated_current']:.3g}"),
    ),
    Question(
        "rotor_inertia",
        "Inertia of the simulated motor's rotor",
        "kg m^2",
        lambda a: float(f"{_simulated(a, 'motor')['rotor_inertia_kg_m2']:.3g}"),
        Quantity(min=0.0),
        lambda a: not _real(a),
    ),
    Question(
        "motor_counts",
        "Counts of the motor encoder per turn of the motor, all edges counted",
        "",
        4096,
        _WHOLE,
    ),
    Question(
        "joint_counts",
        "Counts of the joint encoder per turn",
        "",
        262144,
        _WHOLE,
        lambda a: not _serial(a),
    ),
    Question("moment_arm", "Radius at which the load presses on the joint", "m", 0.095),
    Question(
        "lever_ratio",
        "Lever ratio, contact force over weight; 1 if the weight itself is the contact force",
    ),
    Question("weights", "Weights that can be hung, or none", "kg", (2.0, 5.0), Listed()),
    Question("angle_limit", "Largest joint angle to either side", "deg", 30.0),
    Question("speed_limit", "Limit on the joint speed", "deg/s", _free_speed_deg_s),
    Question("following_error", "Largest following error", "deg", 2.0),
)
"""Questions of ``rig new bench``, in order."""
SEQUENCE: Final = (
    _WEIGHTS,
    Question("amplitude", "Amplitude of the sine at the joint", "deg", 20.0),
    Question("frequency", "Frequency of the sine", "Hz", 0.2),
    Question(
        "duration",
        "Duration of each stage",
        "s",
        lambda a: max(_SHORTEST_S, float(math.ceil(_PERIODS / a["frequency"] + 2 * _RAMP_S))),
    ),
    Question("center", "Angle about which the joint swings", "deg", 0.0, Quantity()),
)
"""Questions of ``rig new sequence``, in order."""


@click.group("new")
def new() -> None:
    """Write a bench, sequence or campaign file to start from, after a few questions or from
    options.

    Comments explain the keys of the file. The first line of the file names a JSON Schema, which is
    written to the folder schemas next to the file; editors use the schema to complete and check the
    file.

    \b
    Example:
      rig new bench bench.yaml
      rig new sequence sequence.yaml --bench bench.yaml
      rig new campaign campaign.yaml log_0kg.csv log_5kg.csv
    """


@new.command("bench")
@_PATH
@options(BENCH)
@_YES
def bench(path: Path, yes: bool, **given: Any) -> None:
    """Write a bench file to PATH. The command asks for every value that no option gives, and
    proposes a default.

    The machine of a simulated bench has the values of the file, with friction in proportion to the
    torque limit, so that sequences can be tried before there is hardware.

    \b
    Example:
      rig new bench bench.yaml --drive canopen --torque-constant 0.0259 --gear-ratio 51 --supply 24
      rig new bench bench.yaml --yes --lever-ratio 1 --weights 2,5
    """
    _write(
        path,
        "bench",
        BENCH,
        lambda answers: fill("bench", _bench_values(_name(path), answers)),
        load_bench,
        given,
        yes,
        f"rig check {path}",
        lambda answers: remarks(answers, given if yes else answers),
    )


@new.command("sequence")
@_PATH
@options(SEQUENCE)
@click.option(
    "--bench",
    "bench_name",
    metavar="BENCH",
    help="Bench file or packaged name whose limits the sequence must keep.",
)
@_YES
def sequence(path: Path, bench_name: str | None, yes: bool, **given: Any) -> None:
    """Write a sequence file to PATH, with one sine in each stage: one stage with the empty lever,
    and one stage for each weight.

    \b
    Example:
      rig new sequence sequence.yaml --bench bench.yaml --weights 2,5 --amplitude 15 --frequency 0.3
    """
    require_new(path, "sequence")
    limits: Document[Bench] | None = None if bench_name is None else load_bench(bench_name)

    def load(draft: Path) -> None:
        document = load_sequence(draft)
        if limits is not None:
            make_plan(document, limits)

    def text(answers: Answers) -> str:
        names: list[str] = []
        stages = []
        for mass in (0.0, *answers["weights"]):
            name = f"weight-{mass:g}kg" if mass else "unloaded"
            same = names.count(name)
            names.append(name)
            stages.append({"name": f"{name}-{same + 1}" if same else name, "weight_kg": mass})
        more = {"name": _name(path), "stages": stages, "ramp_s": _RAMP_S}
        return fill("sequence", {**answers, **more})

    following = f"rig run {path} --bench {bench_name or 'BENCH'} --dry-run"
    _write(path, "sequence", SEQUENCE, text, load, given, yes, following)


@new.command("campaign")
@_PATH
@click.argument("files", nargs=-1, required=True, type=shared.PATH)
@options(campaigns.questions())
@_YES
def campaign(path: Path, files: tuple[Path, ...], yes: bool, **given: Any) -> None:
    """Write a campaign file to PATH that describes FILES, which are recordings made elsewhere.

    The command reads the columns from the files and proposes a channel for each column, with a
    scale to SI if a name states a unit. A mass in a file's name, such as log_5kg.csv, is used as
    the mass on the lever. On a linear bench, units are m instead of rad and N instead of N m.

    \b
    Example:
      rig new campaign campaign.yaml log_0kg.csv log_5kg.csv --current i_meas --lever-ratio 1
      rig new campaign slide.yaml a.csv b.csv --motion linear --terms offset --validate b.csv
    """
    require_new(path, "campaign")
    tables = campaigns.read_names(files)
    named = [name for name in tables[0].names if name]
    columns = ", ".join(named) if named else f"{len(tables[0].names)} without a name"
    click.echo(f"columns of {tables[0].path.name}: {columns}", err=True)
    _write(
        path,
        "campaign",
        campaigns.questions(tables),
        lambda answers: campaigns.campaign_text(path, tables, answers),
        load_campaign,
        given,
        yes,
        f"rig identify {path}",
    )


def _write(
    path: Path,
    kind: str,
    questions: tuple[Question, ...],
    text: Callable[[Answers], str],
    load: Callable[[Path], object],
    given: Mapping[str, Any],
    yes: bool,
    following: str,
    notes: Callable[[Answers], list[str]] = lambda answers: [],
) -> None:
    """Ask until the answers give a valid file, write the file, and print the next command."""
    require_new(path, kind)
    answers: Answers = {}
    with closing(Screen()) as screen:
        asker = None if yes else Prompt(screen)
        while True:
            answers = ask_all(questions, given, asker, screen.say, answers)
            try:
                written = write_new(path, kind, text(answers), load)
                break
            except RefusedError as error:
                if asker is None or all(given.get(name) is not None for name in answers):
                    raise
                for line in error.problems:
                    screen.say(line)
                screen.say("The questions are asked again; your answers are now the defaults.")
        for note in notes(answers):
            screen.say(note)
    for file in written:
        click.echo(f"wrote {file}")
    click.echo(f"next: {following}")


def _name(path: Path) -> str:
    """Return a name for a file's content: letters, digits, dot, dash and underscore."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in path.stem)


def _bench_values(name: str, answers: Answers) -> dict[str, Any]:
    """Return the values for the template of a bench file.

    Raises:
        RefusedError: The drive is a real one with frames of its own, whose signals nobody asked.
    """
    if _real(answers) and answers["drive"] == "dbc":
        raise RefusedError(
            "--devices real: the signals of a drive of kind dbc are not known; give --devices "
            "simulated, then replace bus, DBC file and signals in the file"
        )
    real, heaviest = _real(answers), max(answers["weights"], default=0.0)
    values: dict[str, Any] = {
        "interface": "mock",
        "port": "mock",
        "encoder_port": "mock",
        "baud": 1_000_000,
        "round_trip": 0.0,
        **answers,
        "name": name,
        "real": real,
        "torque_N_m": _torque_N_m(answers),
        "cycle_Hz": 1000.0,
        "heaviest_kg": _OVER_WEIGHT * heaviest,
        "force_N": math.ceil(_OVER_WEIGHT * answers["lever_ratio"] * heaviest * _GRAVITY_M_S2),
    }
    if _serial(answers):
        # The fastest control cycle that fits the line.
        line = {"baud": values["baud"], "round_trip_ms": values["round_trip"]}
        bus = SerialBus(interface="epos_serial", port=values["port"], **line)
        fitting = (p for p in _PERIODS_MS if next(overload(bus, p * 1e-3), None) is None)
        values["cycle_Hz"] = 1e3 / next(fitting, _PERIODS_MS[-1])
    if not real:
        joint = _simulated(answers, "joint")
        of_rotor = answers["rotor_inertia"] * answers["gear_ratio"] ** 2
        if of_rotor > _ROTOR_SHARE * joint["inertia_kg_m2"]:
            joint = {**joint, "inertia_kg_m2": of_rotor / _ROTOR_SHARE}
        values["joint"] = joint
    return values


def remarks(answers: Answers, given: Mapping[str, Any]) -> list[str]:
    """Return remarks on the answers of ``rig new bench`` that are not part of the file."""
    found = []
    torque = _torque_N_m(answers)
    heaviest = max(answers["weights"], default=0.0)
    arm_N_m = answers["lever_ratio"] * heaviest * _GRAVITY_M_S2
    needed = Joint.Ms_N_m * torque / PAPER_TORQUE_N_M + Joint.mu_s * arm_N_m * answers["moment_arm"]
    if not _real(answers) and needed > _HARD_SHARE * torque:
        found.append(
            f"note: with {heaviest:g} kg the simulated friction reaches {needed:.3g} N m, of a "
            f"torque limit of {torque:.3g} N m: use less weight, or a smaller lever ratio"
        )
    if answers["drive"] == "dbc":
        found.append(
            "note: signals, states and orders in the file are those of the simulated drive; "
            "replace DBC file and names by those of your drive"
        )
    assumed = [
        f"{question.option} {shown(answers[question.name])} {question.unit}".rstrip()
        for question in BENCH
        if question.name in _DATA_SHEET and given.get(question.name) is None
    ]
    if assumed:
        found.append(
            f"note: assumed, because no option states it: {', '.join(assumed)}; compare with the "
            "data sheet"
        )
    return found


@click.command("schema")
@click.argument("kind", required=False, type=click.Choice(list(KINDS)))
@shared.path(
    "--out",
    "Write KIND.schema.json into this folder; without KIND, the schemas of all kinds of file.",
    type=shared.FOLDER,
    metavar="DIR",
)
def schema(kind: str | None, out: Path | None) -> None:
    """Write the JSON Schema of bench, sequence, campaign or faults files; editors use the schema to
    complete and check these files.

    The first line of a file that `rig new` writes names the schema; the last example adds such a
    line to a file written by hand.

    \b
    Example:
      rig schema bench
      rig schema --out schemas
      sed -i '1i # yaml-language-server: $schema=schemas/bench.schema.json' bench.yaml
    """
    if out is None:
        if kind is None:
            raise click.UsageError(
                f"name a KIND ({', '.join(KINDS)}), or give --out DIR for all of them"
            )
        click.echo(json.dumps(json_schema(kind), indent=1))
        return
    for name in (kind,) if kind else KINDS:
        click.echo(f"wrote {write_schema(name, out)}")
