"""Describes the plan of a run as text and tables, for ``rig run --dry-run``."""

from __future__ import annotations

import math

from rig.common.tables import table
from rig.planning.limits import GasLimits
from rig.planning.plan import Plan, PlannedStage


def describe(plan: Plan) -> str:
    """Return the plan as text, with tables of the stages and of the limits that apply."""
    stages = table(
        [
            "stage",
            "load",
            "repeats",
            "duration s",
            "weight kg",
            "force N",
            "peak deg/s",
            "peak deg",
        ],
        [
            [
                s.name,
                s.stage,
                str(s.repeats),
                f"{s.duration_s:g}",
                f"{s.weight_kg:g}",
                f"{s.contact_force_N:.1f}",
                f"{math.degrees(s.peak_speed_rad_s):.2f}",
                f"{math.degrees(s.peak_angle_rad):+z.2f}",
            ]
            for s in plan.stages
        ],
        right=range(2, 8),
    )
    limits = plan.limits
    held = table(
        ["limit", "value", "unit"],
        [
            [
                "joint angle",
                f"{math.degrees(limits.angle_min):g} to {math.degrees(limits.angle_max):g}",
                "deg",
            ],
            ["joint speed", f"{math.degrees(limits.speed):g}", "deg/s"],
            ["joint torque", f"{limits.torque:g}", "N m"],
            ["motor current", f"{limits.current:g}", "A"],
            ["following error", f"{math.degrees(limits.following_error):g}", "deg"],
            ["encoder against drive", f"{math.degrees(limits.encoder_disagreement):g}", "deg"],
            ["motor temperature", _stated(f"{limits.temperature:g}"), "deg C"],
            ["DC link", _stated(f"{limits.supply_min:g} to {limits.supply_max:g}"), "V"],
            *(_gas_rows(limits.gas) if limits.gas else []),
            ["sample age", f"{limits.sample_age * 1e3:g}", "ms"],
            ["lateness of a cycle", f"{limits.lateness * 1e3:g}", "ms"],
        ],
    )
    head = (
        f"{plan.name}: {plan.duration_s:.1f} s at {1.0 / plan.cycle_s:g} Hz, and moves to the start"
    )
    passes = "\n".join(
        line for stage in plan.stages for line in (_first_pass(stage), *_feedforward(stage))
    )
    return f"{head}\n\n{stages}\n\n{passes}\n\n{held}"


def _stated(value: str) -> str:
    return "not reported" if "inf" in value else value


def _gas_rows(limits: GasLimits) -> list[list[str]]:
    return [
        ["chamber pressure", f"{limits.pressure * 1e-6:g}", "MPa"],
        ["contact force", f"{limits.contact_force:g}", "N"],
    ]


def _feedforward(stage: PlannedStage) -> list[str]:
    if stage.offsets is None:
        return []
    peak, damping = max(abs(stage.offsets.torque)), max(stage.offsets.damping)
    held = (
        f"stiffness {max(stage.offsets.stiffness):.4g} N m/rad up to {stage.offsets.reach:.3g} N m"
    )
    return [
        f"{stage.name}: feed-forward up to {peak:.3g} N m, damping {damping:.3g} N m s/rad, {held}"
    ]


def _first_pass(stage: PlannedStage) -> str:
    bound = f"at most {stage.time_limit_s:.1f} s under power"
    if stage.stage == "hot_fire":
        return f"{stage.name}: {bound}; the gas generator loads the valve, no weight is hung"
    if not stage.first_passes:
        return (
            f"{stage.name}: {bound}; no first pass at low amplitude, so the weight is not "
            f"checked before the stage"
        )
    low, *larger = stage.first_passes
    limits = low.limits
    again = (
        f" (at {', '.join(f'{p.amplitude:.0%}' for p in larger)} while the joint does not move)"
        if larger
        else ""
    )
    return (
        f"{stage.name}: {bound}; first {low.duration_s:.1f} s at {low.amplitude:.0%} "
        f"amplitude{again} within "
        f"{math.degrees(limits.angle_min):z.1f} to {math.degrees(limits.angle_max):z.1f} deg, "
        f"{math.degrees(limits.speed):.3g} deg/s, {limits.torque:.3g} N m, then the weight is "
        f"checked"
    )
