"""Interface through which the sequencer stores the progress of a run."""

from __future__ import annotations

from typing import Protocol

from rig.runs.run_record import Weighing


class Journal(Protocol):
    """Object that keeps the state of the run on disk."""

    def stage_started(self, index: int) -> None:
        """Stage ``index`` begins."""
        ...

    def stage_finished(self, index: int) -> None:
        """Stage ``index`` is complete, and the drive is de-energised."""
        ...

    def weight_confirmed(self, index: int, weight_kg: float) -> None:
        """The operator confirmed a mass for stage ``index``."""
        ...

    def weighed(self, weighing: Weighing) -> None:
        """The weight of a stage was checked."""
        ...

    def ended(self, state: str, message: str, de_energised: bool) -> None:
        """The run has ended with this state and message; the drive was left de-energised or not.

        Raises:
            StorageError: The file cannot be written.
        """
        ...

    def segment_started(self, stage: int, repeat: int, segment: int, time: float) -> None:
        """The excitation numbered ``segment``, the stage's ``repeat``-th, begins at ``time`` s of
        the recording.
        """
        ...

    def segment_finished(self, segment: int, time: float) -> None:
        """The excitation that was started last is complete."""
        ...
