"""The campaign file: recordings made elsewhere, and how to read them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, PositiveFloat, field_validator, model_validator

from identification.model.ladder import LADDER, NOMINAL, bears_load, rises
from identification.model.parameters import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.model.valve import PAPER
from identification.recording import CHANNELS, Bench, Controller, Model, Pendulum
from rig.common.yaml_tree import Node
from rig.config.campaign_gas import Constant, GasGeneratorSection
from rig.config.catalogue import EFFECTS
from rig.config.configuration import Document, Loc, Schema, load_located, nearest

FITTED_TERMS = ("offset", "load_dependent_friction")
"""Terms that the estimators of this version can fit."""
_BEARING_LOAD = {"coulomb_viscous": "load_dependent", "stribeck": "stribeck_load_dependent"}
"""Rung to the one with `load_dependent_friction` declared beside it."""
PARAMETERS = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS, "offset")


def _known_term(name: str) -> str:
    if name in FITTED_TERMS:
        return name
    if name in EFFECTS:
        remedy = (
            "; a known weight is declared by `gravity:` of a recording"
            if name == "gravity_imbalance"
            else ""
        )
        raise ValueError(
            f"this version cannot fit the effect {name!r}, only {', '.join(FITTED_TERMS)}{remedy}"
        )
    raise ValueError(f"unknown effect; {nearest(name, [*FITTED_TERMS, *EFFECTS])}")


ANGLE_TIME = "angle_time"
"""Channel of the joint encoder's own stamps, s; used on reading, and gone then."""


def _known_friction(name: str) -> str:
    if name not in LADDER:
        raise ValueError(f"unknown friction; {nearest(name, list(LADDER))}")
    return name


def _known_parameter(name: str) -> str:
    if name not in PARAMETERS:
        raise ValueError(f"unknown parameter; {nearest(name, list(PARAMETERS))}")
    return name


def _known_channel(name: str) -> str:
    if name not in (*CHANNELS, ANGLE_TIME):
        raise ValueError(f"unknown channel; {nearest(name, [*CHANNELS, ANGLE_TIME])}")
    return name


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("a scale of zero erases the channel")
    return value


class BenchSection(Schema):
    """Constants of the machine, SI; field meanings as in :class:`identification.recording.Bench`.

    Attributes:
        motion: `rotary`: angles in rad, torques in N m. `linear`: positions in m, forces in N,
            masses in kg; read N for N m and m for rad throughout.
        torque_constant: Motor torque per ampere, N m/A. Without it and without a `torque` channel
            the fit is in amperes.
        back_emf_constant: Voltage per rad/s of the motor, V s/rad; needed where only the voltage
            was measured.
        resistance: Winding resistance, ohm; needed where only the voltage was measured.
        inductance: Winding inductance, H.
        gear_ratio: Motor turns per turn of the joint.
        moment_arm: Radius L1 at which the contact force acts, m; needed for the working load.
        lever_ratio: Contact force over the weight on the lever, L3/L4; needed where a recording
            has a `weight_mass`.
        gravity: Local gravity, m/s^2.
        gas_generator: The gas generator, where pressure was recorded.
    """

    motion: Literal["rotary", "linear"] = "rotary"
    torque_constant: Constant | None = None
    back_emf_constant: Constant | None = None
    resistance: Constant | None = None
    inductance: Constant | None = None
    gear_ratio: Constant = 1.0
    moment_arm: Constant | None = None
    lever_ratio: Constant | None = None
    gravity: Constant = 9.80665
    gas_generator: GasGeneratorSection | None = None

    def bench(self) -> Bench:
        """Return the record the numerics use."""
        constants = self.model_dump(exclude={"gas_generator"}, exclude_none=True)
        if self.gas_generator is None:
            return Bench(**constants)
        return Bench(
            **constants, gas_generator=self.gas_generator.generator(self.moment_arm or PAPER.L1)
        )


class ModelSection(Schema):
    """Declared physics beyond the nominal nine, and values that are not fitted.

    Attributes:
        friction: Friction model, from the ladder of friction models.
        terms: Further physics that is fitted: `offset` (a constant torque) or
            `load_dependent_friction` (friction grows with the torque of a pendulum).
        fixed: Parameter to value, not fitted.
    """

    friction: Annotated[str, AfterValidator(_known_friction)] = NOMINAL
    terms: tuple[Annotated[str, AfterValidator(_known_term)], ...] = ()
    fixed: dict[Annotated[str, AfterValidator(_known_parameter)], float] = Field(
        default_factory=dict
    )

    @field_validator("terms")
    @classmethod
    def _once(cls, terms: tuple[str, ...]) -> tuple[str, ...]:
        repeated = sorted({name for name in terms if terms.count(name) > 1})
        if repeated:
            raise ValueError(f"{', '.join(repeated)} listed more than once")
        return terms

    @field_validator("fixed")
    @classmethod
    def _physical(cls, fixed: dict[str, float]) -> dict[str, float]:
        negative = [
            f"{name} = {value:g}" for name, value in fixed.items() if value < 0 and name != "offset"
        ]
        if negative:
            raise ValueError(f"must not be negative: {', '.join(negative)}")
        return fixed

    def model(self) -> Model:
        """Return the record the numerics use."""
        return Model(terms=self.terms, fixed=dict(self.fixed), friction=self.rung)

    @property
    def rung(self) -> str:
        """The rung of the ladder after `terms`."""
        if "load_dependent_friction" in self.terms:
            return _BEARING_LOAD.get(self.friction, self.friction)
        return self.friction


class GravitySection(Schema):
    """A known weight that turns with the joint: torque -m g l sin(angle - zero).

    Attributes:
        mass: Mass m, kg.
        length: Distance l of its centre from the axis, m.
        zero: Angle at which it hangs straight down, rad.
    """

    mass: Constant
    length: Constant
    zero: float = 0.0

    def pendulum(self) -> Pendulum:
        """Return the record the numerics use."""
        return Pendulum(self.mass, self.length, self.zero)


class ControllerSection(Schema):
    """The position loop: output = clip(position_gain (command - angle) - velocity_gain velocity,
    limit).

    Attributes:
        output: `duty`: share of the supply voltage; `voltage`: at the motor, V; `torque`: at the
            joint, N m.
        position_gain: Output per rad.
        velocity_gain: Output per rad/s.
        limit: Greatest magnitude of the output.
    """

    output: Literal["duty", "voltage", "torque"]
    position_gain: PositiveFloat
    velocity_gain: Annotated[float, Field(ge=0.0)] = 0.0
    limit: PositiveFloat | None = None

    def controller(self) -> Controller:
        """Return the record the numerics use."""
        return Controller(**self.model_dump())


class ReadSection(Schema):
    """How to read a delimited text file; other formats need nothing.

    Attributes:
        delimiter: One character; found from the first line where not given.
        skip_rows: Lines before the header, or before the first row of numbers where there is no
            header.
        decimal: What separates the decimals.
    """

    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0)
    decimal: Literal[".", ","] = "."

    @model_validator(mode="after")
    def _told_apart(self) -> ReadSection:
        if self.delimiter == self.decimal == ",":
            raise ValueError("delimiter and decimal are both a comma; numbers cannot be told apart")
        return self


class ChannelSection(Schema):
    """Where a channel comes from: SI value = scale * column + offset.

    Attributes:
        column: Name, or index from 0.
        scale: SI units per unit of the column; a negative scale turns the sign.
        offset: Added after the scale, SI.
        average: Whether each sample is the mean over the period that ends at its time.
    """

    column: str | Annotated[int, Field(ge=0)]
    scale: Annotated[float, AfterValidator(_not_zero)] = 1.0
    offset: float = 0.0
    average: bool = False

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: object) -> object:
        return (
            {"column": data} if isinstance(data, str | int) and not isinstance(data, bool) else data
        )


class RecordingSection(Schema):
    """One entry of `recordings`; may stand for several files.

    Attributes:
        file: File name or glob relative to the campaign file, or a list of them: csv, mat, npz,
            mcap or parquet; text files may be gzipped.
        stage: The load condition.
        weight_mass: Mass on the lever, kg. The contact force is lever_ratio m g (Fig. 10).
        gravity: A known weight that turns with the joint.
        controller: The position loop that the recording was made in, for simulations.
        role: `validate` sets the recording aside: it is used for no decision and scored once at the
            end.
        rate: Sampling rate, Hz; only where there is no `time` channel.
        read: How to read a text file.
        channels: Canonical channel to column. A name or index alone is short for `{column: ...}`.
    """

    file: str | Annotated[tuple[str, ...], Field(min_length=1)]
    stage: Literal["unloaded", "loaded"] = "unloaded"
    weight_mass: Annotated[float, Field(ge=0.0, lt=1e9)] = 0.0
    gravity: GravitySection | None = None
    controller: ControllerSection | None = None
    role: Literal["fit", "validate"] = "fit"
    rate: Constant | None = None
    read: ReadSection = ReadSection()
    channels: dict[Annotated[str, AfterValidator(_known_channel)], ChannelSection]

    @property
    def patterns(self) -> tuple[str, ...]:
        """File names and globs as written."""
        return (self.file,) if isinstance(self.file, str) else self.file


class Campaign(Schema):
    """A campaign file, `defaults` already merged into every recording.

    Attributes:
        campaign: Version of the file format.
        bench: Constants of the machine.
        model: Declared physics.
        defaults: Keys of `recordings` that hold for every recording unless it gives its own.
        recordings: What was recorded.
    """

    campaign: Literal[1]
    bench: BenchSection
    model: ModelSection = ModelSection()
    defaults: dict[str, object] = Field(default_factory=dict)
    recordings: Annotated[tuple[RecordingSection, ...], Field(min_length=1)]


def load_campaign(path: Path) -> Document[Campaign]:
    """Read and check a campaign file; opens none of the recordings.

    Raises:
        InputError: Lists every error with its place in the file.
    """
    document = load_located(path, Campaign, _merge_defaults)
    document.require(_cross_check(document.value))
    return document


def _merge_defaults(root: Node) -> Node:
    """Merge the top-level ``defaults`` under every recording; the recording's own keys win."""
    top = root.value
    if not isinstance(top, dict) or "defaults" not in top or "recordings" not in top:
        return root
    recordings = top["recordings"]
    if not isinstance(recordings.value, list):
        return root
    merged = [_overlay(top["defaults"], item) for item in recordings.value]
    return Node({**top, "recordings": Node(merged, recordings.mark, {})}, root.mark, root.keys)


def _overlay(under: Node, over: Node) -> Node:
    if not isinstance(under.value, dict) or not isinstance(over.value, dict):
        return over
    both = {
        key: _overlay(under.value[key], child)
        for key, child in over.value.items()
        if key in under.value
    }
    return Node({**under.value, **over.value, **both}, over.mark, {**under.keys, **over.keys})


def _cross_check(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield what the schema alone cannot see, as (location, message)."""
    fixed = campaign.model.fixed
    if "Mc" in fixed and "Ms" in fixed and fixed["Ms"] < fixed["Mc"]:
        yield (
            ("model", "fixed", "Ms"),
            f"static friction below Coulomb friction Mc = {fixed['Mc']:g}; Ms >= Mc",
        )
    if not rises(campaign.model.rung):
        for name in sorted({"Ms", "omega_sf"} & fixed.keys()):
            yield (
                ("model", "fixed", name),
                f"friction {campaign.model.rung} does not rise toward rest; remove it",
            )
    # As a term it may be declared before any load is: a diagnosis may find one.
    if bears_load(campaign.model.friction) and not any(
        r.gravity and r.role == "fit" for r in campaign.recordings
    ):
        yield (
            ("model",),
            f"friction {campaign.model.friction} grows with a pendulum's torque, and no recording "
            f"to fit has `gravity`",
        )
    for index, recording in enumerate(campaign.recordings):
        for loc, message in _check_recording(recording, campaign.bench):
            yield ("recordings", index, *loc), message
    if all(recording.role == "validate" for recording in campaign.recordings):
        yield ("recordings",), "every recording has role validate; at least one must have role fit"
    yield from _check_validation(campaign)
    units = {_torque_unit(recording, campaign.bench) for recording in campaign.recordings}
    if len(units) > 1:
        yield (
            ("bench",),
            "some recordings give torque and others only amperes; add torque_constant, or a "
            "torque channel to all",
        )


def _check_validation(campaign: Campaign) -> Iterator[tuple[Loc, str]]:
    """Yield loaded recordings that would be scored by a model without working load."""
    fitted = any(r.role == "fit" and r.stage == "loaded" for r in campaign.recordings)
    if fitted or campaign.model.fixed.keys() >= set(LOAD_PARAMETERS):
        return
    for index, recording in enumerate(campaign.recordings):
        if recording.role == "validate" and recording.stage == "loaded":
            yield (
                ("recordings", index, "role"),
                "a loaded recording to validate, but none to fit, so that its working load would "
                "be unknown; fit a"
                f" loaded one, or fix {', '.join(LOAD_PARAMETERS)}",
            )


def _torque_unit(recording: RecordingSection, bench: BenchSection) -> str:
    return (
        "torque"
        if "torque" in recording.channels or bench.torque_constant is not None
        else "amperes"
    )


def _check_recording(recording: RecordingSection, bench: BenchSection) -> Iterator[tuple[Loc, str]]:
    channels: Mapping[str, ChannelSection] = recording.channels
    if "time" not in channels and recording.rate is None:
        yield ("channels",), "no `time` channel and no `rate`; give one of them"
    if "time" in channels and recording.rate is not None:
        yield ("rate",), "`rate` is only for files without time; remove it, or the `time` channel"
    if ANGLE_TIME in channels and "angle" not in channels:
        yield (
            ("channels", ANGLE_TIME),
            "stamps of an encoder whose `angle` is not there; map that too",
        )
    if not channels.keys() & {"angle", "velocity", "motor_angle"}:
        yield ("channels",), "no `angle`, `velocity` or `motor_angle`; map at least one"
    if not channels.keys() & {"torque", "current", "voltage"}:
        yield from _check_burn(channels, bench)
    elif not channels.keys() & {"torque", "current"}:
        missing = [
            name for name in ("resistance", "back_emf_constant") if getattr(bench, name) is None
        ]
        if missing:
            yield (
                ("channels", "voltage"),
                f"current from voltage, I = (U - Ke omega_motor)/R, needs bench "
                f"{' and '.join(missing)}",
            )
    if bench.motion == "linear" and recording.gravity is not None:
        yield (
            ("gravity",),
            "a turning weight on a linear bench; remove `gravity`, or set bench.motion: rotary",
        )
    yield from _check_load(recording, bench)


def _check_burn(
    channels: Mapping[str, ChannelSection], bench: BenchSection
) -> Iterator[tuple[Loc, str]]:
    """Yield what a recording lacks that has no torque: the pressure of a gas generator under a
    valve of known angle.
    """
    if "pressure" not in channels:
        yield (
            ("channels",),
            "no `torque`, `current` or `voltage`; map at least one, or `pressure` of a gas "
            "generator",
        )
    elif bench.gas_generator is None:
        yield (
            ("channels", "pressure"),
            "`pressure` without torque, current or voltage needs the constants of its source; add "
            "bench.gas_generator"
            " ({} takes the paper's)",
        )
    elif "angle" not in channels:
        yield ("channels",), "no `angle` of the valve, which makes the throat; map it"


def _check_load(recording: RecordingSection, bench: BenchSection) -> Iterator[tuple[Loc, str]]:
    loaded = recording.stage == "loaded"
    hot_fire = "pressure" in recording.channels and bench.gas_generator is not None
    if (
        loaded
        and recording.weight_mass == 0
        and "load_force" not in recording.channels
        and not hot_fire
    ):
        yield (
            ("stage",),
            "loaded, but weight_mass is 0 kg and there is no `load_force` channel; give one of "
            "them, or for a hot"
            " firing `pressure` and bench.gas_generator",
        )
    if loaded and bench.moment_arm is None:
        yield (
            ("stage",),
            "the loaded stage needs bench.moment_arm (L1, m) to turn contact force into torque",
        )
    if recording.weight_mass > 0 and bench.lever_ratio is None:
        yield (
            ("weight_mass",),
            "a weight on the lever needs bench.lever_ratio (L3/L4), contact force over weight; 1 "
            "where it presses"
            " straight on the joint's arm",
        )
    if not loaded and recording.weight_mass > 0:
        yield (
            ("weight_mass",),
            "a weight in an unloaded stage; set stage: loaded, or weight_mass: 0",
        )
