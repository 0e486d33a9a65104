"""Steps before a run: rejects a run whose weights no person would confirm, and opens the bench so
that a stop signal interrupts the opening.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from rig.common.errors import InputError
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.planning.plan import Plan
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import Attach, connect
from rig.wiring.devices import Devices


def require_attendance(plan: Plan, bench: Document[Bench], yes: bool, terminal: bool) -> None:
    """Reject a run that hangs weights on a real bench if no person would confirm their mass.

    Args:
        plan: The planned run.
        bench: The bench of the run.
        yes: Whether the program answers prompts with the planned mass (``--yes``).
        terminal: Whether a person can be asked.

    Raises:
        InputError: The run hangs weights on a real bench, and no person would be asked.
    """
    value = bench.value
    heavy = [stage.name for stage in plan.stages if stage.weight_kg]
    if value.simulated or not heavy or value.weights_hung_by == "hoist" or (terminal and not yes):
        return
    reason = (
        "--yes would answer the weight prompts" if yes else "there is no terminal for the prompts"
    )
    raise InputError(
        f"{bench.path}: {reason}, but stages {', '.join(heavy)} have weights, which a person hangs "
        f"on this bench: "
        "run at a terminal without --yes; only if a hoist hangs the weights and reports their "
        "mass, set `weights_hung_by: hoist`"
    )


@contextmanager
def connected(
    stop: StopButton,
    document: Document[Bench],
    seed: int,
    realtime: bool,
    attach: Attach | None = None,
    torque_offset: bool = False,
    purpose: str = "rig",
) -> Iterator[Devices]:
    """Open a bench with :func:`rig.wiring.connect.connect`; a stop signal interrupts the opening,
    because no drive is energised yet.

    Raises:
        KeyboardInterrupt: The operator stopped the opening.
    """
    with ExitStack() as stack:
        with stop.interruptible():
            devices = stack.enter_context(
                connect(document, seed, realtime, attach, torque_offset, purpose)
            )
        yield devices
