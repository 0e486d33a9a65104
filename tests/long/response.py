"""Margins that `rig response` measures, and gains that `rig tune` proposes, on 20 simulated benches
against the linearised truth: from the constants of the machine and the loops of the drive alone, at
the drive's own sampling, by code of this module.

Run from the root of the repository; takes some minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.linalg import expm

from drivers.mock.plant.parts.constants import Machine
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.configuration import packaged
from rig.results.response.measure import loop_place

from .console import rig

Array = NDArray[Any]
CYCLES_HZ = (50, 100, 200, 250, 500, 1000)
MODES = ("csp", "csp", "csp", "csp", "csv", "csp", "csp", "csp", "csp", "cst")
WITHIN_DEG, WITHIN, TUNED_DEG = 3.0, 0.1, 5.0
PHASE_DEG, GAIN_DB = 60.0, 8.0
WANTED_TUNED = 18
SHAFT_DAMPING = 0.08
HARD_N_M_RAD = 1e6


def draw(number: int, seed: int) -> dict[str, Any]:
    """Return the bench file of one bench, as data."""
    rng = np.random.default_rng([seed, number])
    bench: dict[str, Any] = yaml.safe_load(packaged("practical", "benches").read_text())
    mode = MODES[number % len(MODES)]
    cycle = CYCLES_HZ[number % len(CYCLES_HZ)]
    if mode != "csp":
        cycle = 500 if mode == "csv" else 1000
        loop = {"inertia_kg_m2": 0.204, "drive_limits_speed": True} if mode == "cst" else {}
        bench["servo"] |= {"mode": mode, "position_loop": loop}
    mock = bench["mock"]
    joint, loops = mock["joint"], mock["loops"]
    for name in ("Mc_N_m", "sigma_2_N_m_s_rad", "omega_sf_rad_s"):
        joint[name] *= float(rng.uniform(0.6, 1.4))
    rise = float(rng.uniform(1.2, 1.9))
    # Soft loops and those of mode cst stick and slip with more; there is nothing linear then.
    soft = mode == "cst" or cycle <= 100
    joint["Ms_N_m"] = joint["Mc_N_m"] * (min(rise, 1.4) if soft else rise)
    inertia = joint["inertia_kg_m2"] = joint["inertia_kg_m2"] * float(rng.uniform(0.8, 1.6))
    if mode == "cst":
        bench["servo"]["position_loop"]["inertia_kg_m2"] = inertia
    position_Hz = min(max(cycle / rng.uniform(18.0, 35.0), 2.0), 12.0)
    position = 2.0 * math.pi * position_Hz
    speed = position * rng.uniform(5.0 if soft else 3.0, 6.0)
    loops |= {
        "position_gain": float(position),
        "velocity_gain_N_m_s_rad": float(inertia * speed),
        "velocity_integral_1_s": float(position * rng.uniform(0.15, 0.4)),
        "velocity_filter_Hz": float(min(speed / 2.0 / math.pi * rng.uniform(1.5, 6.0), 400.0)),
        "velocity_feedforward": float(rng.choice([0.0, 0.5, 1.0])),
    }
    # In mode cst a gap makes the joint hunt at rest, which the safety ends.
    kind = int(rng.integers(4)) if mode != "cst" else 0
    reduced = 0.1 * (inertia - 0.1) / inertia
    stiffness = reduced * (2.0 * math.pi * position_Hz * rng.uniform(8.0, 30.0)) ** 2
    if kind in (1, 3):
        mock["effects"]["compliance"] = {"stiffness_Nm_rad": float(np.clip(stiffness, 300.0, 1e6))}
    if kind in (2, 3):
        mock["effects"]["backlash"] = {"gap_rad": float(rng.uniform(0.0005, 0.004))}
    mock["sensing"]["cycle_s"] = 1.0 / cycle
    bench |= {"cycle_Hz": cycle, "name": f"response-{number}"}
    bench["limits"]["following_error_deg"] = 25.0
    return bench


class Linear:
    """The simulated machine and its drive in one period of the drive's loops, at a sliding speed:
    linear, because friction has a slope there and the joint does not reverse.

    State: current, speed and angle of the motor, speed and angle of the joint if it is elastic;
    integrals of the current and the speed controller, speed estimate, last angle.
    """

    def __init__(self, machine: Machine, speed: float) -> None:
        m, joint, self.loops = machine.motor, machine.joint, machine.loops
        self.period = 1.0 / self.loops.rate_Hz
        self.torque = m.torque_constant_N_m_A * m.gear_ratio
        emf = m.back_emf_constant_V_s_rad * m.gear_ratio
        x = speed / joint.omega_sf_rad_s
        fall = (joint.Ms_N_m - joint.Mc_N_m) * joint.alpha / joint.omega_sf_rad_s
        damping = joint.sigma_2_N_m_s_rad - fall * x ** (joint.alpha - 1.0) * math.exp(
            -(x**joint.alpha)
        )
        rotor = m.rotor_inertia_kg_m2 * m.gear_ratio**2
        total = joint.inertia_kg_m2
        winding = [-m.resistance_ohm / m.inductance_H, -emf / m.inductance_H]
        if machine.effects:
            k = machine.effects.get("compliance", {}).get("stiffness_Nm_rad", HARD_N_M_RAD)
            link = total - rotor
            c = 2.0 * SHAFT_DAMPING * math.sqrt(k * rotor * link / total)
            a = [
                [*winding, 0.0, 0.0, 0.0],
                [self.torque / rotor, -c / rotor, -k / rotor, c / rotor, k / rotor],
                [0.0, 1.0, 0.0, 0.0, 0.0],
                [0.0, c / link, k / link, -(c + damping) / link, -k / link],
                [0.0, 0.0, 0.0, 1.0, 0.0],
            ]
        else:
            a = [[*winding, 0.0], [self.torque / total, -damping / total, 0.0], [0.0, 1.0, 0.0]]
        self.size = n = len(a)
        b = np.zeros((n, 1))
        b[0] = 1.0 / m.inductance_H
        held = expm(np.block([[np.array(a), b], [np.zeros((1, n + 1))]]) * self.period)
        self._a, self._b = held[:n, :n], held[:n, n]

    def step(self, x: Array, kind: str, command: float) -> Array:
        """Return the state one period later.

        ``kind``: what is commanded: the torque, the speed or the position.
        """
        loops, n, t = self.loops, self.size, self.period
        plant, (current, integral, speed, last) = x[:n], x[n:]
        share = 1.0 - math.exp(-2.0 * math.pi * loops.velocity_filter_Hz * t)
        speed = speed + share * ((plant[2] - last) / t - speed)
        wanted, integral = command, integral if kind != "torque" else 0.0
        if kind != "torque":
            asked = loops.position_gain * (command - plant[2]) if kind == "position" else command
            error = asked - speed
            integral = integral + loops.velocity_integral_1_s * t * error
            wanted = loops.velocity_gain_N_m_s_rad * (error + integral)
        error = wanted / self.torque - plant[0]
        gain = loops.current_gain_V_A
        current = current + gain * loops.current_integral_1_s * t * error
        moved = self._a @ plant + self._b * (gain * error + current)
        return np.concatenate([moved, [current, integral, speed, plant[2]]])

    def matrices(self, kind: str, periods: int = 1) -> tuple[Array, Array]:
        """Return A and B over some periods with a held command."""
        n = self.size + 4
        a = np.array([self.step(row, kind, 0.0) for row in np.eye(n)]).T
        b = self.step(np.zeros(n), kind, 1.0)
        total, power = np.zeros(n), np.eye(n)
        for _ in range(periods):
            total, power = total + power @ b, a @ power
        return power, total

    def response(self, kind: str, z: Array, periods: int = 1) -> Array:
        """Return the angle of the motor over a held command, (f,)."""
        a, b = self.matrices(kind, periods)
        return np.array([np.linalg.solve(each * np.eye(len(b)) - a, b)[2] for each in z])


class Truth:
    """True open loops of a bench, and whether its closed loop is stable."""

    def __init__(self, path: Path, speed: float) -> None:
        document = load_bench(path)
        self.bench, place = document.value, loop_place(document)
        assert self.bench.mock is not None
        assert place.stated is not None
        self.linear, self.host, self.gains = (
            Linear(self.bench.mock, speed),
            place.host,
            place.stated,
        )
        self.periods = round(self.bench.cycle_s / self.linear.period)

    def loops(self, f: Array) -> dict[str, Array]:
        """Return the open loops, (f,)."""
        linear, loops = self.linear, self.linear.loops
        if self.host:
            t, gains = self.bench.cycle_s, self.gains
            z = np.exp(2j * np.pi * f * t)
            plant = linear.response(self.host, z, self.periods)
            if self.host == "speed":
                return {"position": gains.position * plant / z}
            drive = gains.speed * (1.0 + gains.reset * t * z / (z - 1.0))
            speed = drive * plant / z * (1.0 - z**-2) / (2.0 * t)
            return {"position": gains.position / z * drive * plant / (1.0 + speed), "speed": speed}
        t = linear.period
        z = np.exp(2j * np.pi * f * t)
        position = loops.position_gain * linear.response("speed", z)
        share = 1.0 - math.exp(-2.0 * math.pi * loops.velocity_filter_Hz * t)
        estimate = share * (1.0 - 1.0 / z) / t / (1.0 - (1.0 - share) / z)
        drive = loops.velocity_gain_N_m_s_rad * (
            1.0 + loops.velocity_integral_1_s * t * z / (z - 1.0)
        )
        return {"position": position, "speed": drive * estimate * linear.response("torque", z)}

    @property
    def stable(self) -> bool:
        """Whether the closed position loop is stable."""
        if not self.host:
            a, _ = self.linear.matrices("position")
            return bool(np.max(np.abs(np.linalg.eigvals(a))) < 1.0)
        a, b = self.linear.matrices(self.host, self.periods)
        n, t, gains = len(b), self.bench.cycle_s, self.gains
        # The host adds the angles of the last three samples, and the integral of its controller.
        whole = np.zeros((n + 4, n + 4))
        whole[:n, :n] = a
        whole[n, 2] = whole[n + 1, n] = whole[n + 2, n + 1] = 1.0
        row = np.zeros(n + 4)
        row[n] = -gains.position
        if self.host == "torque":
            row[n] -= 0.5 / t
            row[n + 2] += 0.5 / t
            whole[n + 3] = gains.reset * t * row
            whole[n + 3, n + 3] = 1.0
            row = gains.speed * (row + whole[n + 3])
        whole[:n] += np.outer(b, row)
        return bool(np.max(np.abs(np.linalg.eigvals(whole))) < 1.0)


def true_margins(f: Array, loop: Array) -> dict[str, tuple[float, float] | None]:
    """Return the least phase margin, deg, with its crossover, and the least gain margin, dB, with
    its frequency, from a dense response.
    """
    size, phase = np.abs(loop), np.degrees(np.unwrap(np.angle(loop)))
    phase -= 360.0 * np.ceil((phase[0] - 90.0) / 360.0)
    at = np.flatnonzero((size[1:] < 1.0) != (size[:-1] < 1.0))
    phases = [(float((phase[k] + 360.0) % 360.0 - 180.0), float(f[k])) for k in at]
    turns = np.floor((phase + 180.0) / 360.0)
    at = np.flatnonzero((np.diff(turns) != 0.0) & (size[1:] < 1.0))
    gains = [(float(-20.0 * np.log10(size[k])), float(f[k])) for k in at]
    least = min(phases, key=lambda each: abs(each[0])) if phases else None
    return {"phase": least, "gain": min(gains) if gains else None}


def dense(truth: Truth) -> dict[str, dict[str, tuple[float, float] | None]]:
    """Return the true margins of each loop, up to half of the frequency of its samples."""
    top = 0.499 / (truth.bench.cycle_s if truth.host else truth.linear.period)
    f = np.geomspace(0.1, min(top, 4000.0), 6000)
    return {name: true_margins(f, loop) for name, loop in truth.loops(f).items()}


def measured(number: int, seed: int, folder: Path) -> list[str]:
    """Measure and tune one bench; return the cells of its row."""
    data = draw(number, seed)
    path = folder / f"bench-{number}.yaml"
    path.write_text(yaml.safe_dump(data))
    found, tuned = folder / f"response-{number}.json", folder / f"tune-{number}.json"
    out, words = str(folder / f"out-{number}"), ["--seed", str(seed + number), "--json"]
    said = rig("response", str(path), "--yes", "--out", out, *words, str(found), check=False)
    if not found.exists():
        print(said[-300:])
        return [*cells(number, data), "0", "0", *["-"] * 3, "no", *["-"] * 2, "no", "no"]
    result = json.loads(found.read_text())
    # The carrier of a bench whose Stribeck speed is unknown; friction is linear at its middle.
    speed = 0.85 * 4.5 * 0.0557
    truth = dense(Truth(path, speed))
    names = {name: result["margins"][name] for name in result["margins"] if name in truth}
    errors: dict[str, list[float]] = {"deg": [], "crossover": [], "gain": []}
    missing = held = 0
    for name, each in names.items():
        top = each["highest_line_Hz"]
        phase, gain = truth[name]["phase"], truth[name]["gain"]
        if phase is not None and phase[1] < top and name == "position":
            missing += each["phase_deg"]["value"] is None
        # What lies beyond the lines is not measured, and not reported.
        if phase is not None and phase[1] < top and each["phase_deg"]["value"] is not None:
            errors["deg"].append(each["phase_deg"]["value"] - phase[0])
            errors["crossover"].append(each["crossover_Hz"]["value"] / phase[1] - 1.0)
            low, high = (each["phase_deg"][end] for end in ("low", "high"))
            held += low is not None and low <= phase[0] <= high
        if gain is not None and each["gain_dB"]["value"] is not None:
            errors["gain"].append(10.0 ** ((each["gain_dB"]["value"] - gain[0]) / 20.0) - 1.0)
    worst = {key: max(map(abs, values), default=0.0) for key, values in errors.items()}
    good = (
        not missing
        and "position" in names
        and worst["deg"] <= WITHIN_DEG
        and max(worst["crossover"], worst["gain"]) <= WITHIN
    )
    margins = ["--phase-margin", str(PHASE_DEG), "--gain-margin", str(GAIN_DB)]
    tune = ("tune", str(path), "--result", str(found), "--out", out, *margins)
    rig(*tune, "--json", str(tuned), check=False)
    proposal = json.loads(tuned.read_text())
    trial = folder / f"tuned-{number}.yaml"
    trial.write_text(yaml.safe_dump(with_gains(data, proposal["gains"], path)))
    after = Truth(trial, speed)
    reached = {n: m["phase"][0] for n, m in dense(after).items() if m["phase"] is not None}
    expected = {n: m["phase_deg"] for n, m in proposal["margins"]["proposed"].items()}
    off = max(
        [abs(reached[n] - e) for n, e in expected.items() if e is not None and n in reached],
        default=math.inf,
    )
    least = min(reached.values())
    met = off <= TUNED_DEG and least >= PHASE_DEG - TUNED_DEG and not proposal["problem"]
    return [
        *cells(number, data),
        f"{len(errors['deg'])}",
        f"{held}",
        f"{worst['deg']:.2f}",
        f"{100.0 * worst['crossover']:.1f}",
        f"{100.0 * worst['gain']:.1f}" if errors["gain"] else "-",
        "yes" if good else "no",
        f"{off:.2f}",
        f"{least:.1f}",
        "yes" if met else "no",
        "yes" if after.stable else "no",
    ]


def cells(number: int, data: dict[str, Any]) -> list[str]:
    """Return the cells of a row that describe the bench."""
    return [
        str(number),
        data["servo"].get("mode", "csp"),
        str(data["cycle_Hz"]),
        "+".join(data["mock"]["effects"]) or "-",
        f"{data['mock']['loops']['velocity_feedforward']:g}",
    ]


def with_gains(data: dict[str, Any], gains: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a bench file whose gains have changed by the ratio that was proposed."""
    changed: dict[str, Any] = json.loads(json.dumps(data))
    old, new = gains["old"], gains["proposed"]
    host = "position_loop" in changed["servo"]
    stated = loop_place(load_bench(path)).stated
    section = changed["servo"]["position_loop"] if host else changed["mock"]["loops"]
    names = ("position_gain", "velocity_gain_N_m_s_rad", "velocity_integral_1_s")
    if host:
        names = ("position_gain_1_s", "speed_gain_N_m_s_rad", "reset_1_s")
    for name, key in zip(("position", "speed", "reset"), names, strict=True):
        if old[name]["value"]:
            section[key] = getattr(stated, name) * new[name]["value"] / old[name]["value"]
    return changed


HEADER = (
    "bench",
    "mode",
    "cycle Hz",
    "effects",
    "ahead",
    "loops",
    "inside interval",
    "worst deg",
    "crossover %",
    "gain margin %",
    "within",
    "tuned off deg",
    "least deg",
    "tuned",
    "stable",
)


def main() -> int:
    """Measure and tune all benches; print a row for each, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--benches", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for number in range(asked.benches):
            rows.append(measured(number, asked.seed, Path(folder)))
            print("  ".join(rows[-1]), flush=True)
    print(table(HEADER, rows, right=range(len(HEADER))))
    within, tuned, stable = (sum(row[k] == "yes" for row in rows) for k in (10, 13, 14))
    print(
        f"margins within {WITHIN_DEG:g} deg and {WITHIN:.0%}: {within} of {len(rows)}; gains "
        f"within {TUNED_DEG:g} deg: {tuned}; stable: {stable}"
    )
    least = WANTED_TUNED * asked.benches // 20
    return 0 if (within, stable) == (len(rows),) * 2 and tuned >= least else 1


if __name__ == "__main__":
    sys.exit(main())
