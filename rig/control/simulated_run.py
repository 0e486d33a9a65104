"""Runs a sequence on a simulated bench without an operator and returns its recordings."""

from __future__ import annotations

from pathlib import Path

from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.sequence import Sequence
from rig.control.operator import AutomaticOperator
from rig.control.session import Inputs, execute
from rig.planning.feedforward import Feedforward
from rig.planning.plan import make_plan
from rig.runs.run import create_folder, load_run
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import connect


class _Unattended(AutomaticOperator):
    """Operator of a simulated run, who answers every prompt with the plan and shows no messages."""

    def tell(self, words: str, typed: str = "") -> None:
        """Show nothing."""

    def result(self, words: str, good: bool) -> None:
        """Show nothing."""


def run_simulated(
    bench: Document[Bench],
    sequence: Document[Sequence],
    seed: int,
    folder: Path,
    feedforward: Feedforward | None = None,
) -> Dataset:
    """Run a sequence on a simulated bench with the planned weights, and return its recordings.

    Args:
        bench: A simulated bench.
        sequence: The sequence to run.
        seed: Seed of the bench's noise.
        folder: The run folder; new or empty.
        feedforward: Model of the feed-forward torque that the drive adds, or None for none.

    Raises:
        InputError: The bench is a real bench, or the run did not end regularly.
        KeyboardInterrupt: The run was stopped.
    """
    if not bench.value.simulated:
        raise InputError(
            bench.problem(
                ("bus",),
                "this command runs without an operator, so the bench must be simulated",
            )
        )
    plan = make_plan(sequence, bench, feedforward=feedforward)
    inputs = Inputs(bench, sequence, seed, realtime=False, feedforward=feedforward)
    with (
        create_folder(folder, "rig"),
        connect(bench, seed, realtime=False, torque_offset=feedforward is not None) as devices,
    ):
        _, outcome = execute(inputs, plan, devices, folder, _Unattended(), StopButton(), _silent)
    if outcome.error is not None:
        raise outcome.error
    if outcome.ending is Ending.STOPPED:
        raise KeyboardInterrupt
    if outcome.ending is not Ending.DONE:
        raise InputError(f"{sequence.value.name} on {bench.value.name}: {outcome.message}")
    return load_run(folder)


def _silent(stage: str, cycles: int, sample: Sample) -> None:
    pass
