"""Draws one world: its axes, its machine, its motions and its injected effects."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.worlds.machines import (
    GRAVITY_M_S2,
    Body,
    draw_body,
    draw_drive,
    draw_log,
    draw_sensing,
)
from benchmarks.worlds.motion import MOTIONS, Reach, command
from benchmarks.worlds.sizes import NEEDS, SIZES, Scale
from benchmarks.worlds.torque import Load, centring, course
from benchmarks.worlds.world import (
    Drive,
    Log,
    Motion,
    Pendulum,
    Planned,
    Sensing,
    World,
)
from rig.results.prove.draw import Assigned, Kind, apportion, in_turn, log
from rig.results.prove.truth import Axis

FEWEST, MOST = 2, 16
SHORTEST_S, LONGEST_S = 5.0, 30.0
MOST_ROWS = 300_000
"""Approximate number of rows of all recordings of a world; at a high sample rate a world has fewer
recordings, not shorter ones.
"""
COUPLING = frozenset({"backlash", "compliance", "coupling_hysteresis"})
"""Effects of the one coupling between motor and joint."""
SHARES: dict[Kind, float] = {"one": 60.0, "nothing": 25.0, "two": 10.0, "outside": 5.0}
"""Number of trials of each kind in a proof of a hundred trials; other proofs have equal shares."""
LOADS: dict[Motion, dict[str, float]] = {
    "rotary": {"none": 0.25, "lever": 0.5, "pendulum": 0.25},
    "linear": {"none": 0.2, "lever": 0.3, "carriage": 0.2, "hoisted": 0.2, "force": 0.1},
}
"""Loads of each kind of machine and their shares. ``lever``: weights that press on the joint by a
lever; ``pendulum``: a weight that turns with the joint; ``carriage``: masses on a level carriage;
``hoisted``: masses that a carriage lifts; ``force``: constant forces.
"""
LINEAR_SHARE = 0.35
HUNG_SHARES = (0.3, 0.6, 0.45)
"""Torques of three weights on the joint, in units of 0.6 times the machine's greatest torque."""
STEADY_SHARES = (0.0, 0.35, 0.2, -0.25)
"""Ratios of the constant forces to the greatest force of the machine; the weights of lifted masses
have the magnitudes of these ratios.
"""
CARRIED = (0.0, 1.0, 0.5, 0.25)
"""Ratios of the masses on a carriage to the heaviest mass, which equals the mass of the machine."""


def worlds_assignment(
    rigs: int, seed: int, effects: Collection[str], outside: Collection[str]
) -> list[Assigned]:
    """Return kind and effects of each world, in random order.

    Args:
        rigs: Number of worlds.
        seed: Seed of the draws.
        effects: Effects of the catalogue that the plant can have, which are taken in turn.
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
    """Return two effects that one machine can have; a machine has either a lever or another load
    with a known torque, and one coupling.
    """
    while True:
        first, second = (names[k] for k in rng.choice(len(names), 2, replace=False))
        needs = NEEDS.get(first, frozenset()) | NEEDS.get(second, frozenset())
        two_loads = "known torque" in needs and needs & {"lever", "two weights"}
        if not two_loads and not {first, second} <= COUPLING:
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
    linear = chain.uniform() < LINEAR_SHARE and "turning joint" not in needs
    body = draw_body(parts, "fall" in needs, "linear" if linear else "rotary")
    drive = draw_drive(chain)
    sensing = draw_sensing(chain, body.motor, needs, body.motion)
    log_ = draw_log(chain, drive, _voltages(needs), "unfiltered current" in needs)
    load, loads = _loads(chain, needs, body.motion)
    if load == "carriage":
        body = body._replace(lever_ratio=1.0, heaviest_kg=body.constants.J)
    drive, recordings = _recordings(chain, motions, body, (drive, log_), (load, loads))
    scale = scale_of(body, recordings)
    effects = {name: SIZES[name](sizes, scale) for name in names}
    known = (r.weight_kg or r.pendulum or r.hoisted_kg or r.pull_N_m for r in recordings)
    loaded = load if any(known) else "none"
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
        body.motion,
    )


def without_effects(world: World) -> World:
    """Return a copy of a world without its injected effects."""
    return replace(world, effects={})


def _voltages(needs: Collection[str]) -> tuple[str, ...]:
    """Return the kinds of voltage channel with which the effects can show."""
    if "commanded voltage" in needs:
        return ("commanded",)
    return ("commanded", "measured") if "voltage" in needs else ("commanded", "measured", "absent")


def _loads(rng: np.random.Generator, needs: Collection[str], motion: Motion) -> tuple[str, int]:
    """Draw the kind of load and the number of loads."""
    shares = LOADS[motion]
    load, loads = str(rng.choice(list(shares), p=list(shares.values()))), int(rng.integers(1, 4))
    if "known torque" in needs:
        return ("pendulum", loads) if motion == "rotary" else ("hoisted", max(loads, 2))
    if "two weights" in needs:
        return "lever", max(loads, 2)
    if "lever" in needs:
        return "lever", loads
    return load, 0 if load == "none" else loads


def _recordings(
    chain: np.random.Generator,
    motions: np.random.Generator,
    body: Body,
    electronics: tuple[Drive, Log],
    load: tuple[str, int],
) -> tuple[Drive, tuple[Planned, ...]]:
    """Draw the recordings; of three or more recordings, one in four has role validate.

    Returns:
        The drive, with the spring of a host that sends torques, and the recordings.
    """
    (kind, loads), (drive, log_) = load, electronics
    count = round(log(FEWEST - 0.4, MOST + 0.4)(chain))
    affordable = int(MOST_ROWS / (0.5 * (SHORTEST_S + LONGEST_S) * log_.rate_Hz))
    # The fit has each load once and, unless the loads are weights on the joint, no load once.
    each = loads if kind in ("pendulum", "none") else loads + 1
    count = max(min(count, affordable), each + (kind == "lever"), FEWEST)
    used = list(chain.permutation(list(MOTIONS))[: int(chain.integers(1, 4))])
    moving = bool(chain.uniform() < 0.4)
    aside = max(1, count // 4) if count > FEWEST else 0
    sends_torque = drive.kind == "torque"
    known = [_loaded(k, kind, loads, body, sends_torque) for k in range(count)]
    if sends_torque:
        static = max(_load_of(r, body).static(body.constants) for r in known)
        stiffness = centring(motions, body.constants, static, body.travel)
        drive = replace(drive, centring_N_m_rad=stiffness)
    kept: list[Planned] = []
    for k, empty in enumerate(known):
        motion, duration = str(used[k % len(used)]), float(motions.uniform(SHORTEST_S, LONGEST_S))
        lead = float(motions.uniform(1.0, 2.5)) if moving else 0.0
        duration, lead = round(duration, 2), round(lead, 2)
        planned = replace(
            empty,
            name=f"rec{k:02d}",
            role="validate" if k >= count - aside else "fit",
            motion=motion,
            lead_s=lead,
        )
        kept.append(_commanded(motions, planned, duration, body, drive))
    return drive, tuple(kept)


def _commanded(
    rng: np.random.Generator, planned: Planned, duration_s: float, body: Body, drive: Drive
) -> Planned:
    """Draw the angle or torque that is sent in a recording, and the pause before the recording."""
    reach, times = _reach(body, planned), (duration_s, planned.lead_s)
    if drive.kind == "torque":
        machine = (body.constants, body.peak_N_m, reach, drive.centring_N_m_rad)
        drawn = course(rng, planned.motion, times, machine, _load_of(planned, body))
        planned = replace(planned, command=drawn.angle, torque=drawn.torque)
    else:
        planned = replace(planned, command=command(rng, planned.motion, *times, reach))
    return replace(planned, pause_s=round(float(rng.uniform(3.0, 30.0)), 2))


def _loaded(k: int, kind: str, loads: int, body: Body, sends_torque: bool) -> Planned:
    """Return recording ``k`` with its known load; command and times are still empty. The first
    recording has no known load, unless the loads are weights on the joint (pendulums).

    If a host sends the torques, a weak spring that the host computes pulls the joint to angle zero;
    the weight therefore hangs straight down at zero.
    """
    empty = Planned("", "fit", "", np.zeros(0), 0.0)
    if kind == "lever":
        place = k % (loads + 1)
        return replace(empty, weight_kg=round(body.heaviest_kg * place / loads, 4))
    if kind == "pendulum":
        share, length = HUNG_SHARES[k % loads], 0.02 + 0.1 * body.peak_N_m / 40.0
        mass = share * 0.6 * body.peak_N_m / (GRAVITY_M_S2 * length)
        zero = 0.0 if sends_torque else (0.0, -0.7, 0.9)[k % loads]
        return replace(empty, pendulum=Pendulum(round(mass, 4), length, zero))
    steady = STEADY_SHARES[k % (loads + 1)] * body.peak_N_m if loads else 0.0
    if kind == "hoisted":
        return replace(empty, hoisted_kg=round(abs(steady) / GRAVITY_M_S2, 4))
    if kind == "force":
        return replace(empty, pull_N_m=round(steady, 3))
    if kind == "carriage":
        # The guide bears the weight, which adds friction and inertia but no force along the axis.
        mass = round(CARRIED[k % (loads + 1)] * body.heaviest_kg, 4)
        return replace(empty, weight_kg=mass, hoisted_kg=mass, pull_N_m=mass * GRAVITY_M_S2)
    return empty


def _load_of(planned: Planned, body: Body) -> Load:
    """Return the known load of a recording, at the joint."""
    force = body.lever_ratio * planned.weight_kg * GRAVITY_M_S2
    hung = planned.pendulum
    inertia = planned.hoisted_kg + (0.0 if hung is None else hung.mass_kg * hung.length_m**2)
    return Load(
        force * body.moment_arm_m,
        inertia,
        _torque_of(hung),
        0.0 if hung is None else hung.zero_rad,
        planned.steady_N_m(GRAVITY_M_S2),
    )


def _reach(body: Body, planned: Planned) -> Reach:
    """Return the limits of a command; half of the torque that friction and a steady load leave may
    accelerate the joint.
    """
    constants = body.constants
    friction = constants.Mc + constants.sigma_2 * body.speed
    load = constants.mu_c * body.heaviest_kg * body.lever_ratio * GRAVITY_M_S2 * body.moment_arm_m
    held = friction + 1.5 * load + abs(planned.steady_N_m(GRAVITY_M_S2))
    spare = max(body.peak_N_m - held, 0.2 * body.peak_N_m)
    return Reach(body.travel, body.speed, 0.5 * spare / (constants.J + planned.hoisted_kg))


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
    hung += max(abs(r.steady_N_m(GRAVITY_M_S2)) for _, r in fitted)
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
        unit=1.0 if body.motion == "rotary" else abs(farthest),
    )


def _torque_of(hung: Pendulum | None) -> float:
    return 0.0 if hung is None else hung.mass_kg * GRAVITY_M_S2 * hung.length_m


def _axes(
    body: Body, drive: Drive, sensing: Sensing, log_: Log, recordings: Sequence[Planned]
) -> dict[str, Axis]:
    """Return the values of a world on all axes, as words and numbers."""
    encoders = (("motor", sensing.motor_bits), ("joint", sensing.joint_bits))
    return {
        "machine": body.motion,
        "peak_Nm" if body.motion == "rotary" else "peak_N": float(f"{body.peak_N_m:.3g}"),
        "loop": drive.kind,
        "loop_Hz": float(drive.rate_Hz),
        "host_Hz": float(drive.host_Hz),
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
        "loads": float(
            len({(r.weight_kg, r.pendulum, r.hoisted_kg, r.pull_N_m) for r in recordings})
        ),
        "friction": "falls" if body.constants.Ms > body.constants.Mc else "flat",
    }
