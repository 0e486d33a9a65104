"""Shows the progress of a run in its terminal, opens its control socket, and states bench, plan and
limits to ``rig console``.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import Bench
from rig.control.session import Inputs
from rig.planning.limits import Limits
from rig.planning.plan import Plan
from rig.terminal.control_socket import ControlSocket
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.devices import Devices, watcher_of

_BAR = 12


class RunProgress:
    """Shows elapsed and remaining time in motion, stage, angle error and current at a terminal."""

    def __init__(self, cycle_s: float, duration_s: float, screen: Screen | None = None) -> None:
        self._cycle_s = cycle_s
        self._total_s = duration_s
        self._done_s = 0.0
        self._screen = screen or Screen()

    @property
    def left_s(self) -> float:
        """Expected remaining time in motion, s."""
        return self._total_s - self._done_s

    def __call__(self, stage: str, cycles: int, sample: Sample) -> None:
        """Advance by this many cycles and show the latest sample."""
        self._done_s = min(self._done_s + cycles * self._cycle_s, self._total_s)
        if not self._screen.has_status:
            self._screen.pump()
            return
        share = self._done_s / self._total_s if self._total_s else 1.0
        bar = "#" * round(_BAR * share)
        error_deg = math.degrees(sample.angle - sample.command)
        self._screen.status(
            f"{stage} |{bar:<{_BAR}}| {self._total_s - self._done_s:.0f} s left, "
            f"error {error_deg:+z.3f} deg, {sample.current:+z.2f} A"
        )


def reachable(
    stop: StopButton, screen: Screen, inputs: Inputs, plan: Plan, path: Path, required: bool = False
) -> AbstractContextManager[ControlSocket | None]:
    """Open the control socket of a run, and close it at the end.

    If the socket cannot be created, a run at a terminal continues without it, with a message.

    Raises:
        InputError: The socket is required and cannot be created.
    """
    return _opened(stop, screen, about_run(inputs, plan, path), required)


def stoppable(
    stop: StopButton, screen: Screen, bench: Bench, name: str
) -> AbstractContextManager[ControlSocket | None]:
    """Open the control socket of a program that moves a bench without a run, such as a jog."""
    about = {"name": name, "bench": bench.name, "real": not bench.simulated}
    return _opened(stop, screen, about, False)


@contextmanager
def _opened(
    stop: StopButton, screen: Screen, about: Mapping[str, Any], required: bool
) -> Iterator[ControlSocket | None]:
    try:
        control = ControlSocket(stop, about, screen.say)
    except OSError as error:
        words = f"`rig console` cannot reach this program: {error.strerror or error}"
        if required:
            raise InputError(words) from error
        screen.say(words)
        yield None
        return
    with control:
        yield control


def observed(devices: Devices, control: ControlSocket | None, progress: RunProgress) -> Devices:
    """Wrap the devices so that a control socket, if any, states phases and progress of the run."""
    if control is None:
        return devices
    control.left_s = lambda: progress.left_s
    return dataclasses.replace(
        devices, observer=lambda stage, phase: control.entered(stage, phase.value)
    )


def about_run(inputs: Inputs, plan: Plan, path: Path) -> dict[str, Any]:
    """Return the description of a run for a program that attaches to it, as JSON values.

    The description does not contain the planned masses, because the operator must type the mass
    that the scales show.
    """
    bench = inputs.bench.value
    return {
        "folder": os.path.abspath(path),
        "name": plan.name,
        "bench": bench.name,
        "bench_file": os.path.abspath(inputs.bench.path),
        "real": not bench.simulated,
        "realtime": inputs.realtime or not bench.simulated,
        "operator": inputs.operator,
        "cycle_s": plan.cycle_s,
        "total_s": plan.duration_s,
        "torque_per_ampere": plan.limits.torque_per_ampere,
        "gear_ratio": plan.limits.gear_ratio,
        "limits": limit_records(plan.limits),
        "written": {
            name: value
            for name, value in dataclasses.asdict(plan.servo_limits).items()
            if isinstance(value, float) and math.isfinite(value)
        },
        "watched_by": watcher_of(bench).words,
        "stages": [stage.name for stage in plan.stages],
        "judged": bool(inputs.acceptance or inputs.sequence.value.acceptance),
    }


def limit_records(limits: Limits) -> list[dict[str, Any]]:
    """Return the limits that every cycle checks, SI units; an end without a limit is None."""
    both: Mapping[str, tuple[float, float]] = {
        "angle": (limits.angle_min, limits.angle_max),
        "velocity": (-limits.speed, limits.speed),
        "current": (-limits.current, limits.current),
        "torque": (-limits.torque, limits.torque),
        "following_error": (-limits.following_error, limits.following_error),
        "disagreement": (-limits.encoder_disagreement, limits.encoder_disagreement),
    }
    rows = dict(both)
    if limits.reports_temperature:
        rows["temperature"] = (-math.inf, limits.temperature)
    if limits.reports_supply:
        rows["supply_voltage"] = (limits.supply_min, limits.supply_max)
    if limits.gas is not None:
        rows["pressure"] = (-math.inf, limits.gas.pressure)
    return [
        {"channel": name, "low": _finite(low), "high": _finite(high)}
        for name, (low, high) in rows.items()
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
