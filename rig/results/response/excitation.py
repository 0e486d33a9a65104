"""The sequence of ``rig response``: small tones on a slow carrier, at two amplitudes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from identification.numerics.arrays import Array
from identification.simulation.frequency_response import Window
from rig.common.errors import InputError
from rig.config.bench import Bench
from rig.config.sequence import Sequence, StageSection, Tone, sequence_text
from rig.planning.predicted_load import FrictionModel

QUIET, SMALL, LARGE = "quiet", "small", "large"
"""Stages: the carrier alone, the tones at half of their amplitude, the tones."""
CYCLES_PER_PERIOD: Final = 5
"""Control cycles per period of the highest line."""
FALLEN: Final = 4.5
"""Peak speed of the carrier in Stribeck speeds, from which on friction hardly falls with speed."""
SLOWEST, FASTEST = 0.05, 0.25
"""Least and greatest peak speed of the carrier, as a share of the speed limit."""
TRAVEL_SHARE: Final = 0.7  # travel of the carrier, as a share of the permitted one
LONGEST_S: Final = 12.0  # longest period of the carrier, s
PART: Final = 0.5
"""Greatest speed of the tones, as a share of the least speed of the carrier in a window."""
TORQUE_SHARE: Final = 0.15  # greatest torque of the tones for the inertia, as a share of the limit
COULOMB_SHARE: Final = 1.3
"""The same as a share of the Coulomb friction, which keeps the teeth of a gear in contact."""
FIRST, SPACING = 5, 4
"""Lowest line, and least distance of two lines, in half periods of a window; with less, the carrier
would resemble the lines.
"""
LEAST_LINES, MOST_LINES = 6, 24
SAMPLES_PER_LINE: Final = 3.2  # least samples in a window per line
WINDOWS, WINDOWS_OF_FEW = 6, 24
"""Windows of a stage with tones, and with less than :data:`FEW` samples in a window."""
FEW: Final = 400
_TRIES: Final = 40  # random sets of phases, of which the one with the least peak is taken


@dataclass(frozen=True)
class Excitation:
    """A sequence with what its evaluation needs."""

    sequence: Sequence  # its stages are `QUIET`, `SMALL` and `LARGE`, or the last alone
    text: str  # its file
    frequency_Hz: Array  # the lines, (f,)
    # Begin and end of the windows of each stage since the start of its excitation, s.
    windows: dict[str, tuple[Window, ...]]
    carrier_rad_s: float  # peak speed of the carrier


def excitation(
    bench: Bench,
    friction: FrictionModel,
    seed: int,
    amplitude: float = 1.0,
    windows: int | None = None,
    stages: tuple[str, ...] = (QUIET, SMALL, LARGE),
) -> Excitation:
    """Return the excitation for a bench, within its limits of angle, speed and torque.

    The carrier is a sine; its windows are the quarters of its period in which the speed is above
    0.7 of its peak, so that the joint does not reverse there.

    Args:
        bench: The bench.
        friction: Its Stribeck speed and inertia, assumed or identified.
        seed: Seed of the phases of the tones.
        amplitude: Factor on the tones.
        windows: Windows in a stage with tones, or None for as many as the cycle needs; the quiet
            stage has two.
        stages: Names of the stages.

    Raises:
        InputError: The travel is too small for the speed at which friction hardly falls.
    """
    limits, cycle_s = bench.limits, bench.cycle_s
    half = math.radians(0.5 * TRAVEL_SHARE * (limits.angle_max_deg - limits.angle_min_deg))
    top = math.radians(limits.speed_deg_s)
    fallen = FALLEN * friction.values["omega_sf"]
    speed = min(max(fallen, SLOWEST * top), FASTEST * top)
    period = min(2.0 * math.pi * half / speed, LONGEST_S)
    period = round(period / (8.0 * cycle_s)) * 8.0 * cycle_s
    carrier = speed * period / (2.0 * math.pi)
    window = 0.25 * period
    lines = _lines(bench.cycle_Hz / CYCLES_PER_PERIOD, window, cycle_s)
    if len(lines) < LEAST_LINES:
        raise InputError(
            f"the joint crosses its travel of {limits.angle_max_deg - limits.angle_min_deg:g} deg "
            f"so fast that {len(lines)} lines fit below a fifth of cycle_Hz, at least "
            f"{LEAST_LINES} are needed: permit more travel, or raise cycle_Hz"
        )
    phases, peak = _phases(lines, window, np.random.default_rng(seed))
    tone = PART * math.sqrt(0.5) * speed / peak
    # In phase, the torques of all tones would be their sum; random phases give about three rms.
    torque = friction.values["J"] * 2.0 * math.pi * float(np.sqrt(4.5 * np.sum(lines**2)))
    most = min(TORQUE_SHARE * limits.torque_N_m, COULOMB_SHARE * friction.values["Mc"])
    tone = amplitude * min(tone, most / torque)
    wanted = windows or (WINDOWS if window / cycle_s >= FEW else WINDOWS_OF_FEW)
    middle = math.degrees(limits.middle_rad)
    fade = 0.25 * period

    def sine(amplitude: float, frequency: float, phase: float = 0.0) -> Tone:
        degrees, phase = float(f"{math.degrees(amplitude):.6g}"), round(math.degrees(phase), 3)
        return Tone(amplitude_deg=degrees, frequency_Hz=frequency, phase_deg=phase)

    made, places = [], {}
    for name in stages:
        count = 2 if name == QUIET else wanted
        factor = {QUIET: 0.0, SMALL: 0.5, LARGE: 1.0}[name]
        tones = [sine(carrier, 1.0 / period)]
        tones += [
            sine(factor * tone / (2.0 * math.pi * f), float(f), p)
            for f, p in zip(lines, phases, strict=True)
            if factor
        ]
        stage = StageSection(
            name=name,
            stage="unloaded",
            tones=tuple(tones),
            duration_s=round((0.5 * count + 0.125) * period + fade + cycle_s, 6),
            ramp_in_s=fade,
            ramp_out_s=fade,
            cycles_per_period=CYCLES_PER_PERIOD,
            center_deg=middle,
            settle_s=0.5,
        )
        made.append(stage)
        centres = [0.5 * period * (k + 1) for k in range(count)]
        places[name] = tuple((c - 0.5 * window, c + 0.5 * window) for c in centres)
    sequence = Sequence(sequence=1, name="response", stages=tuple(made))
    head = "# Small tones on a slow carrier, at two amplitudes; made by `rig response`.\n"
    return Excitation(sequence, sequence_text(sequence, head), lines, places, speed)


def _lines(high_Hz: float, window_s: float, cycle_s: float) -> Array:
    """Return lines up to a frequency, about evenly over the logarithm, at least :data:`SPACING`
    apart, at multiples of the carrier's double frequency, (f,).
    """
    most = min(MOST_LINES, int(window_s / cycle_s / SAMPLES_PER_LINE))
    grid = 0.5 / window_s
    found = [FIRST * grid]
    while len(found) < most:
        left = most - len(found)
        following = found[-1] * (high_Hz / found[-1]) ** (1.0 / left)
        count = max(round(following / grid), round(found[-1] / grid) + SPACING)
        if count * grid > high_Hz and (count := count - 1) * grid > high_Hz:
            break
        found.append(grid * count)
    return np.array(found, dtype=np.float64)


def _phases(lines: Array, window_s: float, rng: np.random.Generator) -> tuple[Array, float]:
    """Return the phases with the least peak of the sum of equal tones of the speed, and this peak
    over the amplitude of one tone.
    """
    t = np.arange(0.0, window_s, 1.0 / (8.0 * float(lines[-1])))
    waves = np.exp(2j * np.pi * np.outer(t, lines))
    tried = rng.uniform(-np.pi, np.pi, (_TRIES, len(lines)))
    peaks = np.max(np.abs(np.real(waves @ np.exp(1j * tried).T)), axis=0)
    best = int(np.argmin(peaks))
    return tried[best], float(peaks[best])
