"""Makes the warnings for results from unfinished recordings of a stopped run (``--partial``)."""

from __future__ import annotations

from identification.recording import Dataset


def partial_names(dataset: Dataset) -> list[str]:
    """Return the names of the recordings that were not finished."""
    return [recording.name for recording in dataset.recordings if recording.partial]


def partial_warnings(dataset: Dataset) -> tuple[str, ...]:
    """Return the warning of a result from recordings that were not finished; empty if all were
    finished.
    """
    names = partial_names(dataset)
    if not names:
        return ()
    were = "was" if len(names) == 1 else "were"
    return (
        f"partial result: the run stopped before {', '.join(names)} {were} finished; the "
        "result does not use the motion that was not recorded, and with a shortened motion "
        "the intervals can be too narrow; `rig resume` finishes the run",
    )


def without_partial(dataset: Dataset) -> str:
    """Return the remedy of an error that an unfinished recording may cause, if finished recordings
    exist as well.
    """
    finished = any(not recording.partial for recording in dataset.recordings)
    return (
        "; without --partial, only finished excitations are used"
        if partial_names(dataset) and finished
        else ""
    )
