"""States which clock the times of a run follow: the host's clock, or the time of the simulated
bench.
"""

from __future__ import annotations

from rig.runs.run_record import RunRecord

HOST, SIMULATED = "host time", "simulated time"
_NOT_LATE = (
    "Lateness of the control cycle is not drawn: the times of the samples are simulated time, in "
    "which every cycle of this recording started on time."
)

ON_TIME = (
    "Every cycle started on time, because simulated time waits for the program: there is no "
    "lateness to show."
)


def clock_of(record: RunRecord) -> str:
    """Return the name of the clock by which the samples of a run are timed."""
    return SIMULATED if record.simulated else HOST


def axis_words(record: RunRecord) -> str:
    """Return a sentence on the time axes of a run's charts."""
    if not record.simulated:
        return "Time axis: time of the host's clock since the start of this recording."
    pace = ", in step with real time" if record.realtime else ""
    return f"Time axis: simulated time since the start of this recording{pace}."


def not_late_words(record: RunRecord) -> str:
    """Return the message that replaces the chart of lateness on a simulated bench."""
    if record.realtime:
        return (
            f"{_NOT_LATE} The lateness of this computer, which paces the simulation, is in the "
            "table `How late cycles started`."
        )
    return f"{_NOT_LATE} A recording in simulated time does not show how late this computer is."


def lateness_heading(record: RunRecord) -> str:
    """Return the heading of the histogram of lateness."""
    words = "How late cycles started"
    if not record.simulated:
        return words
    return f"{words}, by the clock of this computer" if record.realtime else f"{words}, {SIMULATED}"


def answer_heading(record: RunRecord) -> str:
    """Return the heading of the histogram of answers."""
    words = "Age of a sample when the program checks it"
    return f"{words}, {SIMULATED}" if record.simulated else words


def no_lateness(record: RunRecord, worst_us: float) -> bool:
    """Return whether a histogram of lateness would only show that simulated time is never late."""
    return record.simulated and not record.realtime and worst_us == 0.0
