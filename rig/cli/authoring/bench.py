"""``rig new bench``: makes a bench file from a few answers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import click
import yaml

from drivers.mock.plant.parts.constants import Joint, Machine, Motor
from rig.cli.authoring.questions import Answers, Number, Numbers, Question
from rig.cli.authoring.yaml_text import Block, Raw, render
from rig.common.yaml_tree import parse
from rig.config.bench import Bench, Constants, LimitsSection
from rig.config.canopen import Bus, EncoderSection, ServoSection
from rig.config.configuration import packaged
from rig.config.serial_bus import Amt21Section, SerialBus, overload
from rig.config.simulated_machine import derived

_SPEED_SHARE: Final = 0.8
"""Default speed limit as a share of the no-load speed at the supply voltage."""
_GREATEST_SPEED_DEG_S: Final = 120.0
_OVER_RATED: Final = 5.0 / 3.0
_OVER_WEIGHT: Final = 1.2
_HARD_SHARE: Final = 0.8
_PERIODS_MS: Final = (2, 4, 5, 8, 10, 20, 25, 40, 50, 100, 125, 200, 250, 500)
"""Control cycles, ms, from which one is chosen for a serial line; all rates in Hz are round."""
_SUPPLY_SHARE: Final = 0.2
_ROTOR_SHARE: Final = 0.8
"""Largest share of the rotor's inertia in the joint's inertia of a simulated bench."""
_STALE_CYCLES: Final = 5


def _real(answers: Mapping[str, Any]) -> bool:
    return bool(answers["devices"] == "real")


def _serial(answers: Mapping[str, Any]) -> bool:
    return bool(answers["drive"] == "epos4-serial")


def _real_can(answers: Mapping[str, Any]) -> bool:
    return _real(answers) and not _serial(answers)


def _free_speed_deg_s(answers: Mapping[str, Any]) -> float:
    """Return the default speed limit, deg/s: a share of the no-load speed, at most 120 deg/s."""
    free = answers["supply"] / (answers["back_emf_constant"] * answers["gear_ratio"])
    return min(_GREATEST_SPEED_DEG_S, float(f"{_SPEED_SHARE * math.degrees(free):.2g}"))


def _rotor_inertia_kg_m2(answers: Mapping[str, Any]) -> float:
    """Return the default rotor inertia of a simulation, in proportion to the joint inertia."""
    machine, limits = {"gear_ratio": answers["gear_ratio"]}, {"torque_N_m": _torque_N_m(answers)}
    motor = derived({"machine": machine, "limits": limits})["motor"]
    assert isinstance(motor, dict)
    return float(f"{motor['rotor_inertia_kg_m2']:.3g}")


_EDS: Final = "name the maker's EDS file, relative to the bench file"
QUESTIONS: Final = (
    Question(
        "drive",
        "Kind of drive",
        kind=click.Choice(("canopen", "epos4-serial", "dbc")),
        default="canopen",
    ),
    Question(
        "devices",
        "Simulated or real devices",
        kind=click.Choice(("simulated", "real")),
        default="simulated",
    ),
    Question(
        "interface",
        "Interface of python-can",
        kind=click.STRING,
        default="socketcan",
        when=_real_can,
    ),
    Question(
        "channel", "Channel of that interface", kind=click.STRING, default="can0", when=_real_can
    ),
    Question(
        "port",
        "Serial port of the drive",
        kind=click.STRING,
        default="/dev/ttyUSB0",
        when=lambda a: _real(a) and _serial(a),
    ),
    Question(
        "encoder_port",
        "Serial port of the AMT21 joint encoder",
        kind=click.STRING,
        default="/dev/ttyUSB1",
        when=lambda a: _real(a) and _serial(a),
    ),
    Question(
        "baud",
        "Baud rate of the drive's port",
        "Bd",
        kind=click.IntRange(9_600, 12_000_000),
        default=1_000_000,
        when=lambda a: _real(a) and _serial(a),
    ),
    Question(
        "round_trip",
        "Time that adapter (FTDI: 16 ms, in low-latency mode 6 ms) and drive add to a request and "
        "its answer",
        "ms",
        kind=Number(at_least=0.0),
        default=1.0,
        when=lambda a: _real(a) and _serial(a),
    ),
    Question("servo_eds", "EDS file of the drive", kind=click.STRING, when=_real, why=_EDS),
    Question(
        "encoder_eds", "EDS file of the joint encoder", kind=click.STRING, when=_real_can, why=_EDS
    ),
    Question("torque_constant", "Torque constant of the motor", "N m/A", default=0.03),
    Question(
        "back_emf_constant",
        "Back-EMF constant of the motor (in SI units equal to the torque constant)",
        "V s/rad",
        default=lambda a: a["torque_constant"],
    ),
    Question("resistance", "Winding resistance", "ohm", default=1.56),
    Question("inductance", "Winding inductance", "H", default=0.00132),
    Question("gear_ratio", "Gear ratio, motor turns per turn of the joint", default=100.0),
    Question("supply", "Supply voltage", "V", default=60.0),
    Question(
        "rated_current",
        "Rated current of the motor, as the drive holds it in object 6075h",
        "A",
        default=15.0,
    ),
    Question(
        "current_limit",
        "Limit on the motor current",
        "A",
        default=lambda a: float(f"{_OVER_RATED * a['rated_current']:.3g}"),
    ),
    Question(
        "rotor_inertia",
        "Inertia of the simulated motor's rotor",
        "kg m^2",
        kind=Number(at_least=0.0),
        default=_rotor_inertia_kg_m2,
        when=lambda a: not _real(a),
    ),
    Question(
        "motor_counts",
        "Counts of the motor encoder per turn of the motor, all edges counted",
        kind=click.IntRange(1),
        default=4096,
    ),
    Question(
        "joint_counts",
        "Counts of the joint encoder per turn",
        kind=click.IntRange(1),
        default=262144,
        when=lambda a: not _serial(a),
    ),
    Question("moment_arm", "Radius at which the load presses on the joint", "m", default=0.095),
    Question(
        "lever_ratio",
        "Lever ratio, contact force over weight; 1 if the weight itself is the contact force",
        why="the ratio scales every working load; 1 if the weight itself is the contact force",
    ),
    Question(
        "weights", "Weights that can be hung, or none", "kg", kind=Numbers(), default=(2.0, 5.0)
    ),
    Question("angle_limit", "Largest joint angle to either side", "deg", default=30.0),
    Question("speed_limit", "Limit on the joint speed", "deg/s", default=_free_speed_deg_s),
    Question("following_error", "Largest following error", "deg", kind=Number(), default=2.0),
)
"""Questions in order."""


def bench_text(name: str, answers: Answers) -> str:
    """Return the text of a bench file without its first line.

    Args:
        name: Name of the bench.
        answers: Answers to :data:`QUESTIONS`.
    """
    sections: dict[str, Any] = {
        "bench": 1,
        "name": name,
        "machine": _machine(answers),
        "bus": _bus(answers),
        "servo": _servo(answers),
        "encoder": _encoder(answers),
        "cycle_Hz": _cycle_Hz(answers),
        "limits": _limits(answers),
        "weights_kg": list(answers["weights"]),
    }
    if answers["devices"] == "simulated":
        sections["mock"] = _mock(sections, answers["rotor_inertia"])
    head = (
        f"# Bench {name}, written by `rig new bench`. A comment above each key states meaning, "
        f"unit and default.\n"
        f"# Check the bench with `rig check`, which moves nothing; then use `rig new sequence` "
        f"and `rig run`.\n"
    )
    return head + render(Block(Bench, sections, {"mock": ""}))


def remarks(answers: Answers) -> list[str]:
    """Return remarks on the answers that are not part of the file."""
    found = []
    torque = _torque_N_m(answers)
    heaviest = max(answers["weights"], default=0.0)
    arm_N_m = answers["lever_ratio"] * heaviest * Constants.model_fields["gravity_m_s2"].default
    share = torque / 75.0
    needed = Joint.Ms_N_m * share + Joint.mu_s * arm_N_m * answers["moment_arm"]
    if answers["devices"] == "simulated" and needed > _HARD_SHARE * torque:
        found.append(
            f"note: with {heaviest:g} kg the simulated friction reaches {needed:.3g} N m, of a "
            f"torque limit of "
            f"{torque:.3g} N m: use less weight, or a smaller lever ratio"
        )
    if answers["drive"] == "dbc":
        found.append(
            "note: signals, states and orders in the file are those of the simulated drive; "
            "replace DBC file and names by those of your drive"
        )
    return found


def _torque_N_m(answers: Mapping[str, Any]) -> float:
    return float(answers["torque_constant"] * answers["gear_ratio"] * answers["current_limit"])


def _machine(answers: Answers) -> Block:
    return Block(
        Constants,
        {
            "torque_constant_N_m_A": answers["torque_constant"],
            "back_emf_constant_V_s_rad": answers["back_emf_constant"],
            "resistance_ohm": answers["resistance"],
            "inductance_H": answers["inductance"],
            "gear_ratio": answers["gear_ratio"],
            "moment_arm_m": answers["moment_arm"],
            "lever_ratio": answers["lever_ratio"],
            "gravity_m_s2": Constants.model_fields["gravity_m_s2"].default,
        },
    )


def _bus(answers: Answers) -> Block:
    real = answers["devices"] == "real"
    if answers["drive"] == "epos4-serial":
        return Block(
            SerialBus,
            {
                "interface": "epos_serial",
                "port": answers["port"] if real else "mock",
                "baud": answers["baud"] if real else 1_000_000,
                "round_trip_ms": answers["round_trip"] if real else 0.0,
            },
        )
    if not real:
        return Block(Bus, {"interface": "mock", "bitrate": 1_000_000})
    return Block(
        Bus,
        {"interface": answers["interface"], "channel": answers["channel"], "bitrate": 1_000_000},
    )


def _servo(answers: Answers) -> Block | Raw:
    if answers["drive"] == "dbc":
        return _dbc_servo(answers)
    values: dict[str, Any] = {
        "kind": "canopen",
        "node": 1,
        "counts_per_motor_turn": answers["motor_counts"],
        "sign": 1,
        "offset_deg": 0.0,
        "rated_current_A": answers["rated_current"],
        "rated_torque_N_m": answers["torque_constant"] * answers["rated_current"],
    }
    if answers["devices"] == "real":
        values["eds"] = answers["servo_eds"]
    return Block(ServoSection, values)


def _dbc_servo(answers: Answers) -> Raw:
    """Return the section of the packaged bench with a DBC drive, with the limits of the answers."""
    text = packaged("practical_dbc", "benches").read_text(encoding="utf-8")
    servo = parse(text)[0].plain()["servo"]
    servo["held"].update(
        angle_min_deg=-answers["angle_limit"],
        angle_max_deg=answers["angle_limit"],
        speed_deg_s=answers["speed_limit"],
        torque_N_m=_torque_N_m(answers),
        current_A=answers["current_limit"],
        following_error_deg=answers["following_error"],
    )
    dumped = yaml.safe_dump(servo, sort_keys=False, default_flow_style=None, width=90)
    return Raw(
        "# DBC file of the drive, and what its signals mean: docs/reference/bench.md. The signals "
        "below are\n"
        "# of the simulated drive. `held`: limits set in the drive with its maker's tool.\n"
        f"{dumped}"
    )


def _encoder(answers: Answers) -> Block:
    real = answers["devices"] == "real"
    if answers["drive"] == "epos4-serial":
        port = answers["encoder_port"] if real else "mock"
        return Block(Amt21Section, {"kind": "amt21", "port": port, "sign": 1, "offset_deg": 0.0})
    values: dict[str, Any] = {
        "kind": "cia406",
        "node": 2,
        "counts_per_turn": answers["joint_counts"],
        "sign": 1,
        "offset_deg": 0.0,
    }
    if real:
        values["eds"] = answers["encoder_eds"]
    return Block(EncoderSection, values)


def _cycle_Hz(answers: Answers) -> float:
    """Return the fastest control cycle that fits the bus."""
    if answers["drive"] != "epos4-serial":
        return 1000.0
    bus = SerialBus(**_bus(answers).values)
    for period_ms in _PERIODS_MS:
        if next(overload(bus, period_ms * 1e-3), None) is None:
            break
    return 1e3 / period_ms


def _limits(answers: Answers) -> Block:
    heaviest = max(answers["weights"], default=0.0)
    gravity = Constants.model_fields["gravity_m_s2"].default
    force = answers["lever_ratio"] * heaviest * gravity
    cycle_ms = 1e3 / _cycle_Hz(answers)
    return Block(
        LimitsSection,
        {
            "angle_min_deg": -answers["angle_limit"],
            "angle_max_deg": answers["angle_limit"],
            "speed_deg_s": answers["speed_limit"],
            "torque_N_m": _torque_N_m(answers),
            "current_A": answers["current_limit"],
            "following_error_deg": answers["following_error"],
            "encoder_disagreement_deg": 1.0,
            "weight_kg": _OVER_WEIGHT * heaviest,
            "contact_force_N": float(math.ceil(_OVER_WEIGHT * force)),
            "temperature_C": 80.0,
            "supply_min_V": (1.0 - _SUPPLY_SHARE) * answers["supply"],
            "supply_max_V": (1.0 + _SUPPLY_SHARE) * answers["supply"],
            "sample_age_ms": max(5.0, _STALE_CYCLES * cycle_ms),
            "lateness_ms": 25.0,
        },
    )


def _mock(sections: Mapping[str, Any], rotor_inertia_kg_m2: float) -> Block:
    """Return the simulated machine: assumed values for the parameters to identify, and the other
    values from the bench.

    The joint's inertia includes the rotor.
    """
    plain = {
        name: dict(section.values) if isinstance(section, Block) else section
        for name, section in sections.items()
    }
    values = derived(plain)["joint"]
    assert isinstance(values, dict)
    of_rotor = rotor_inertia_kg_m2 * plain["machine"]["gear_ratio"] ** 2
    inertia = values["inertia_kg_m2"]
    if of_rotor > _ROTOR_SHARE * inertia:
        inertia = of_rotor / _ROTOR_SHARE
    friction = {
        "inertia_kg_m2": inertia,
        "Mc_N_m": values["Mc_N_m"],
        "Ms_N_m": values["Ms_N_m"],
        "omega_sf_rad_s": Joint.omega_sf_rad_s,
        "sigma_2_N_m_s_rad": values["sigma_2_N_m_s_rad"],
        "mu_c": Joint.mu_c,
        "mu_s": Joint.mu_s,
        "omega_sL_rad_s": Joint.omega_sL_rad_s,
        "mu_2_s_rad": Joint.mu_2_s_rad,
    }
    scaled = dict.fromkeys(
        ("inertia_kg_m2", "Mc_N_m", "Ms_N_m", "sigma_2_N_m_s_rad"),
        "Default: scaled by limits.torque_N_m.",
    )
    follows = {"rotor_inertia_kg_m2": "Default: computed from the joint's inertia."}
    motor = Block(Motor, {"rotor_inertia_kg_m2": rotor_inertia_kg_m2}, follows)
    return Block(Machine, {"motor": motor, "joint": Block(Joint, friction, scaled), "effects": {}})
