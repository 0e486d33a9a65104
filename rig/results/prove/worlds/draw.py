"""Draws one world: its axes, its machine, its motions and its injected effects."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from rig.results.prove.draw import Assigned, Kind, apportion, in_turn
from rig.results.prove.sizes import log
from rig.results.prove.truth import Axis
from rig.results.prove.worlds.machines import (
    GRAVITY_M_S2,
    Body,
    draw_body,
    draw_drive,
    draw_log,
    draw_sensing,
)
from rig.results.prove.worlds.motion import MOTIONS, Reach, command
from rig.results.prove.worlds.sizes import NEEDS, SIZES, Scale
from rig.results.prove.worlds.world import Drive, Log, Pendulum, Planned, Sensing, World

FEWEST, MOST = 2, 16
SHORTEST_S, LONGEST_S = 5.0, 30.0
MOST_ROWS = 300_000
"""Approximate number of rows of all recordings of a world; at a high sample rate a world has fewer
recordings, not shorter ones.
"""
SHARES: dict[Kind, float] = {"one": 60.0, "nothing": 25.0, "two": 10.0, "outside": 5.0}
"""Number of trials of each kind in a hundred; proofs of other sizes have the same proportions."""
LOADS = ("none", "lever", "pendulum")


def worlds_assignment(
    rigs: int, seed: int, effects: Collection[str], outside: Collection[str]
) -> list[Assigned]:
    """Return kind and effects of each world, in random order.

    Args:
        rigs: Number of worlds.
        seed: Seed of the draws.
        effects: Effects of the catalogue that the plant can have; drawn in turn.
        outside: Effects outside the catalogue that the plant can have.
    """
    rng = np.random.default_rng([seed, 0])
    counts = apportion(rigs, SHARES)
    names = sorted(effects)
    drawn: list[Assigned] = [("nothing", ())] * counts["nothing"]
    drawn += [("one", (name,)) for name in in_turn(names, counts["one"], rng)]
    drawn += [("outside", (name,)) for name in in_turn(sorted(outside), counts["outside"], rng)]
    drawn += [("two", _pair(names, rng)) for _ in range(counts["two"])]
    return [drawn[k] for k in rng.permutation(len(drawn))]


def _pair(names: Sequence[str], rng: np.random.Generator) -> tuple[str, str]:
    """Return two effects that one machine can have; a machine has either a lever or a pendulum as
    load.
    """
    while True:
        first, second = (names[k] for k in rng.choice(len(names), 2, replace=False))
        needs = NEEDS.get(first, frozenset()) | NEEDS.get(second, frozenset())
        if not ("pendulum" in needs and needs & {"lever", "two weights"}):
            return first, second


def draw_world(kind: Kind, names: Sequence[str], seed: Sequence[int]) -> World:
    """Draw one world.

    Args:
        kind: Kind of trial.
        names: Effects to inject.
        seed: Entropy of the draws; equal entropy results in equal worlds. Axes, machine, motions
            and sizes have streams of their own.
    """
    needs: set[str] = set().union(*(NEEDS.get(name, frozenset()) for name in names))
    chain, parts, motions, sizes = (
        np.random.default_rng(stream) for stream in np.random.SeedSequence(list(seed)).spawn(4)
    )
    body = draw_body(parts, "fall" in needs)
    drive = draw_drive(chain)
    sensing = draw_sensing(chain, body.motor, needs)
    log_ = draw_log(chain, drive, _voltages(needs))
    load, loads = _loads(chain, needs)
    recordings = _recordings(chain, motions, body, log_, (load, loads))
    scale = scale_of(body, recordings)
    effects = {name: SIZES[name](sizes, scale) for name in names}
    loaded = load if any(r.weight_kg or r.pendulum for r in recordings) else "none"
    return World(
        kind,
        effects,
        body.constants,
        body.motor,
        drive,
        sensing,
        log_,
        recordings,
        body.moment_arm_m,
        body.lever_ratio,
        GRAVITY_M_S2,
        _axes(body, drive, sensing, log_, recordings) | {"load": loaded},
        tuple(seed),
    )


def without_effects(world: World) -> World:
    """Return the same world without injected effects."""
    return replace(world, effects={})


def _voltages(needs: Collection[str]) -> tuple[str, ...]:
    """Return the kinds of voltage channel with which the effects can show."""
    if "commanded voltage" in needs:
        return ("commanded",)
    return ("commanded", "measured") if "voltage" in needs else ("commanded", "measured", "absent")


def _loads(rng: np.random.Generator, needs: Collection[str]) -> tuple[str, int]:
    """Draw the kind of load and the number of loads."""
    load, loads = str(rng.choice(LOADS, p=(0.25, 0.5, 0.25))), int(rng.integers(1, 4))
    if "pendulum" in needs:
        return "pendulum", loads
    if "two weights" in needs:
        return "lever", max(loads, 2)
    if "lever" in needs:
        return "lever", loads
    return load, 0 if load == "none" else loads


def _recordings(
    chain: np.random.Generator,
    motions: np.random.Generator,
    body: Body,
    log_: Log,
    load: tuple[str, int],
) -> tuple[Planned, ...]:
    """Draw the recordings; of three or more recordings, one in four has role validate."""
    kind, loads = load
    count = round(log(FEWEST - 0.4, MOST + 0.4)(chain))
    affordable = int(MOST_ROWS / (0.5 * (SHORTEST_S + LONGEST_S) * log_.rate_Hz))
    # Each load once in the fit, for a lever also no load.
    count = max(min(count, affordable), loads + 2 if kind == "lever" else loads, FEWEST)
    used = list(chain.permutation(list(MOTIONS))[: int(chain.integers(1, 4))])
    moving = bool(chain.uniform() < 0.4)
    reach = _reach(body)
    kept: list[Planned] = []
    aside = max(1, count // 4) if count > FEWEST else 0
    for k in range(count):
        motion, duration = str(used[k % len(used)]), float(motions.uniform(SHORTEST_S, LONGEST_S))
        lead = float(motions.uniform(1.0, 2.5)) if moving else 0.0
        duration, lead = round(duration, 2), round(lead, 2)
        path = command(motions, motion, duration, lead, reach)
        weight, pendulum = _load_of(k, kind, loads, body)
        pause = round(float(motions.uniform(3.0, 30.0)), 2)
        role = "validate" if k >= count - aside else "fit"
        kept.append(
            Planned(f"rec{k:02d}", role, motion, path, lead, weight, pendulum, pause)  # type: ignore[arg-type]
        )
    return tuple(kept)


def _load_of(k: int, kind: str, loads: int, body: Body) -> tuple[float, Pendulum | None]:
    """Return the weight on the lever, or on the joint, in recording ``k``; the first recording with
    a lever has no weight.
    """
    if kind == "lever":
        place = k % (loads + 1)
        return round(body.heaviest_kg * place / loads, 4) if loads else 0.0, None
    if kind == "pendulum":
        share, length = (0.3, 0.6, 0.45)[k % loads], 0.02 + 0.1 * body.peak_N_m / 40.0
        mass = share * 0.6 * body.peak_N_m / (GRAVITY_M_S2 * length)
        return 0.0, Pendulum(round(mass, 4), length, (0.0, -0.7, 0.9)[k % loads])
    return 0.0, None


def _reach(body: Body) -> Reach:
    """Return the limits of a command; half of the torque that friction leaves may accelerate the
    joint.
    """
    constants = body.constants
    friction = constants.Mc + constants.sigma_2 * body.speed
    load = constants.mu_c * body.heaviest_kg * body.lever_ratio * GRAVITY_M_S2 * body.moment_arm_m
    spare = max(body.peak_N_m - friction - 1.5 * load, 0.2 * body.peak_N_m)
    return Reach(body.travel, body.speed, 0.5 * spare / constants.J)


def scale_of(body: Body | World, recordings: Sequence[Planned]) -> Scale:
    """Return the scales for the sizes of effects, from the machine and from the motions of the
    recordings with role fit.
    """
    fitted = [(k, r) for k, r in enumerate(recordings, start=1) if r.role == "fit"]
    steps = [np.abs(np.diff(r.command)).max() for _, r in fitted]
    ends = [end for _, r in fitted for end in (r.command.min(), r.command.max())]
    farthest = float(max(ends, key=abs))
    speed = float(max(steps)) / 1e-3
    constants = body.constants
    torque = constants.Mc + constants.sigma_2 * speed
    heaviest = max(r.weight_kg for _, r in fitted)
    force = body.lever_ratio * heaviest * GRAVITY_M_S2
    hung = max((_torque_of(r.pendulum) for _, r in fitted), default=0.0)
    torque += body.moment_arm_m * force * constants.mu_c + hung
    return Scale(
        Mc=constants.Mc,
        sigma_2=constants.sigma_2,
        J=constants.J,
        travel=abs(farthest),
        farthest=farthest,
        speed=speed,
        current=torque / body.motor.torque_per_A,
        resistance=body.motor.resistance_ohm,
        supply=body.motor.supply_V,
        heaviest=heaviest,
        loaded=tuple((k, r.weight_kg) for k, r in fitted if r.weight_kg > 0.0),
        recordings=len(fitted),
        shortest_s=min(r.duration_s for _, r in fitted),
    )


def _torque_of(hung: Pendulum | None) -> float:
    return 0.0 if hung is None else hung.mass_kg * GRAVITY_M_S2 * hung.length_m


def _axes(
    body: Body, drive: Drive, sensing: Sensing, log_: Log, recordings: Sequence[Planned]
) -> dict[str, Axis]:
    """Return the values of a world on all axes, as words and numbers."""
    encoders = (("motor", sensing.motor_bits), ("joint", sensing.joint_bits))
    return {
        "peak_Nm": float(f"{body.peak_N_m:.3g}"),
        "loop": drive.kind,
        "loop_Hz": float(drive.rate_Hz),
        "gain_Hz": float(f"{drive.position_Hz:.3g}"),
        "feedforward": drive.feedforward > 0.0,
        "log_Hz": float(log_.rate_Hz),
        "current": log_.current,
        "voltage": log_.voltage,
        "encoders": " and ".join(f"{name} {bits} bit" for name, bits in encoders if bits),
        "two_encoders": all(bits for _, bits in encoders),
        "flicker": sensing.flicker,
        "jitter": float(f"{log_.jitter:.3g}"),
        "clock": log_.clock,
        "motion": ", ".join(sorted({r.motion for r in recordings})),
        "starts": "moving" if any(r.lead_s for r in recordings) else "at rest",
        "recordings": float(len(recordings)),
        "seconds": float(round(sum(r.duration_s for r in recordings))),
        "loads": float(len({(r.weight_kg, r.pendulum) for r in recordings})),
        "friction": "falls" if body.constants.Ms > body.constants.Mc else "flat",
    }
