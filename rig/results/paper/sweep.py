"""Exhibit of Fig. 4: current, pressure and impacted area of the simulated valve sweep."""

from __future__ import annotations

import numpy as np

from identification.plots import regulator
from rig.results.document import Picture
from rig.results.paper.exhibit import Exhibit, Rows, columns, true_machine
from rig.results.paper.sweep_simulation import PAPER_DEG_S, SLOW_DEG_S, Sweep, sweep

_ENDS_DEG = np.array([5.0, 29.0])


def sweep_exhibit(seed: int) -> Exhibit:
    """Return Fig. 4 at the speed of the paper, and at a lower speed, at which the pressure follows
    the throat area.
    """
    machine = true_machine("practical_hot")
    sweeps = [sweep(machine, speed, seed) for speed in (PAPER_DEG_S, SLOW_DEG_S)]
    return Exhibit(
        "fig_4",
        "Fig. 4: the motor's current falls with pressure and impacted area",
        "The valve turns from 0 to 30 deg at 50 deg/s under a stable pressure; the curve of the "
        "current falls as the "
        "pressure and the impacted area fall. The text gives no values of the curve.",
        tuple(_words(found) for found in sweeps),
        (
            Picture.of(
                "fig_4",
                "Fig. 4: an opening valve, at the speed of the paper and slowly",
                _figure(sweeps),
            ),
        ),
        {name: _data(found) for name, found in zip(("fig_4", "fig_4_slow"), sweeps, strict=True)},
    )


def _words(found: Sweep) -> str:
    (_, current, pressure, area), (_, last_current, last_pressure, last_area) = found.at(_ENDS_DEG)
    return (
        f"At {found.speed_deg_s:g} deg/s: from {_ENDS_DEG[0]:g} to {_ENDS_DEG[1]:g} deg the "
        f"current falls from "
        f"{current:.2f} to {last_current:.2f} A, the pressure from {pressure:.2f} to "
        f"{last_pressure:.2f} MPa, the area "
        f"from {area:.0f} to {last_area:.0f} mm^2. Rank correlation of the current with the "
        f"pressure "
        f"{found.rank_pressure:.3f}, with the area {found.rank_area:.3f}. The pressure stays up to "
        f"{100.0 * found.lag:.0f} % above the steady pressure."
    )


def _figure(sweeps: list[Sweep]) -> regulator.Figure:
    return regulator.sweep(
        [
            (
                f"{found.speed_deg_s:g} deg/s",
                np.rad2deg(found.angle),
                np.where(found.uniform, found.current, np.nan),
                1e-6 * found.pressure,
                1e-6 * found.steady_pressure,
                1e6 * found.area,
            )
            for found in sweeps
        ]
    )


def _data(found: Sweep) -> Rows:
    return columns(
        time_s=found.time,
        angle_rad=found.angle,
        current_A=found.current,
        pressure_Pa=found.pressure,
        steady_pressure_Pa=found.steady_pressure,
        impacted_area_m2=found.area,
        uniform=found.uniform.astype(np.float64),
    )
