"""The run folder: writes ``run.json`` during a run, and reads the recordings for identification."""

from __future__ import annotations

import dataclasses
import shutil
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from identification.recording import Array, Dataset, Recording, RecordingError
from identification.recording import Bench as BenchConstants
from rig.common.errors import InputError, StorageError
from rig.common.locks import OWNER_FILE, Lock, hold_folder
from rig.common.places import usable, write_json
from rig.common.provenance import sha256_file
from rig.runs.alignment import aligned
from rig.runs.mcap.reader import Block, Damage, Log, NotARecordingError, read_run, run_items
from rig.runs.recorder import remedy
from rig.runs.run_file import read_record, recorded_bench
from rig.runs.run_record import RECORDING_FILE, RUN_FILE, RunRecord, SegmentRecord, Weighing

if TYPE_CHECKING:
    from rig.config.bench import Bench

LEAST_DRIFT_PPM = 1.0  # least drift that is reported, ppm; drifts of crystals are 20 to 100 ppm
LATE_PERIODS = 1.0  # number of periods after which an answer counts as late


def drift_ppm(reference: Array, other: Array) -> float | None:
    """Return the drift of the other clock against the reference clock, ppm, positive if the other
    clock is faster, or None if a clock does not run forward.

    The drift is computed from the medians of the first and last fifth, so that single late stamps
    have no influence.

    Args:
        reference: Times of the reference clock, s, shape (n,).
        other: Times of the other clock at the same samples, s, shape (n,).
    """
    fifth = len(reference) // 5
    if fifth < 1 or not (np.all(np.diff(reference) > 0.0) and np.all(np.diff(other) > 0.0)):
        return None
    first, last = slice(None, fifth), slice(-fifth, None)
    gone = float(
        np.median(other[last] - reference[last]) - np.median(other[first] - reference[first])
    )
    return 1e6 * gone / float(np.mean(reference[last]) - np.mean(reference[first]))


def describe(time: Array, host: Array, drive: Array, encoder: Array) -> list[str]:
    """Return messages on gaps, late answers and drifting clocks; empty if there is nothing to
    report.

    If drive and encoder latch at one SYNC, a drift between their clocks does not affect the
    samples; if the encoder is free-running, :mod:`rig.runs.alignment` corrects the drift.

    Args:
        time: Start of each cycle, s, shape (n,).
        host: Time at which the answers of each cycle had been collected, s, shape (n,).
        drive: The drive's own stamps, s, shape (n,).
        encoder: The joint encoder's own stamps, s, shape (n,).
    """
    notes = []
    steps = np.diff(time)
    period = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps > 1.5 * period
    if np.any(gaps):
        lost = round(float(np.sum(steps[gaps] / period - 1.0)))
        notes.append(
            f"{int(gaps.sum())} gaps, {lost} samples lost, the longest gap "
            f"{1e3 * float(steps.max()):.4g} ms"
        )
    late = host - time > LATE_PERIODS * period
    if np.any(late):
        notes.append(
            f"{100.0 * float(np.mean(late)):.2g} % of the answers came more than one period late"
        )
    for ours, theirs, words in (
        (time, drive, "drive's clock {} host's"),
        (drive, encoder, "encoder's clock {} drive's"),
    ):
        drift = drift_ppm(ours, theirs)
        if drift is not None and abs(drift) >= LEAST_DRIFT_PPM:
            notes.append("the " + words.format(f"runs {drift:+.1f} ppm against the"))
    return notes


STAMPS = ("time", "host_time", "device_time", "encoder_time", "fresh")
LEFT_OUT = ("velocity", "voltage", "supply_voltage", "temperature")
"""Channels that an identification does not need."""
CHANNELS = (
    "command",
    "motor_angle",
    "angle",
    "velocity",
    "current",
    "voltage",
    "supply_voltage",
    "temperature",
)
MOST_SAMPLES = 5_000_000
"""Samples above which :data:`LEFT_OUT` are not read; ten hours at 1 kHz fit into 4 GiB."""

Samples = dict[str, Array]


def by_segment(
    path: Path, segments: Sequence[SegmentRecord]
) -> tuple[dict[int, Samples], str | None]:
    """Return the samples by index of the segment, including stale samples, and a message on damage.

    The recording is read in blocks, and each field grows in place, because a long run does not fit
    into memory twice.
    """
    total = sum(segment.samples for segment in segments)
    fields = {segment.index: _fields(segment, total) for segment in segments}
    wanted = sorted({name for names in fields.values() for name in names})
    held = {k: {name: array("d") for name in names} for k, names in fields.items()}
    damage = None
    with readable(path):
        for item in run_items(path, ["segment", *wanted], only_samples=True):
            if isinstance(item, Damage):
                damage = item.words
            elif isinstance(item, Block):
                for k, values in held.items():
                    mine = item.samples["segment"] == k
                    if not mine.any():
                        continue
                    for name, grown in values.items():
                        grown.frombytes(item.samples[name][mine].tobytes())
    return {
        k: {name: np.asarray(grown) for name, grown in values.items()} for k, values in held.items()
    }, damage


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Name a file that cannot be read or is not a recording."""
    try:
        with usable(path, "read"):
            yield
    except NotARecordingError as error:
        raise InputError(f"{path}: {error}") from error


def read_log(path: Path) -> Log:
    """Read a recording as a whole."""
    with readable(path):
        return read_run(path)


def _fields(segment: SegmentRecord, total: int) -> tuple[str, ...]:
    channels = (
        CHANNELS if total <= MOST_SAMPLES else tuple(c for c in CHANNELS if c not in LEFT_OUT)
    )
    return (*STAMPS, *channels, *(["pressure"] if segment.stage == "hot_fire" else []))


AVERAGED = frozenset({"current", "voltage"})
"""Channels whose samples are means over the cycle that ends at their time."""
PARTIAL = " (partial)"  # suffix of the name of an unfinished excitation
LEAST_SAMPLES = 2  # least number of fresh samples for a recording from an unfinished excitation


RESERVE_FILE = ".reserve"
"""File of a run in progress whose space is used for ``run.json`` if the disk is full."""
RESERVED_BYTES = 1 << 20
CYCLE_BYTES = 400
"""Greatest size of a recorded cycle; measured: 220 bytes over CAN, 330 over serial."""
_MARGIN_BYTES = 16 << 20  # space for the page, results and `run.json`


def require_space(path: Path, cycles: float) -> None:
    """Check that the disk has the space for a whole run."""
    above = path
    while not above.exists() and above != above.parent:
        above = above.parent
    try:
        free = shutil.disk_usage(above).free
    except (OSError, AttributeError):
        # AttributeError: without POSIX modules; such a run is refused with its cause.
        return
    needed = round(cycles * CYCLE_BYTES) + _MARGIN_BYTES
    if free < needed:
        raise InputError(
            f"{path}: the run needs about {needed / 1e6:.0f} MB, and {free / 1e6:.0f} MB are free "
            f"on this disk; free disk space, or record on another disk (--out)"
        )


class RunFolder:
    """A run folder that is being written: the state of the run on disk."""

    def __init__(self, path: Path, record: RunRecord, told: frozenset[str] = frozenset()) -> None:
        self.path = path
        self.record = record
        self.told = told

    @property
    def recording(self) -> Path:
        """Path of the recording that is being written."""
        return self.path / self.record.parts[-1].file

    def save(self) -> None:
        """Replace ``run.json`` as a whole, so that no reader sees an incomplete file."""
        try:
            write_json(self.path / RUN_FILE, dataclasses.asdict(self.record))
        except OSError as error:
            raise StorageError(
                f"{RUN_FILE} cannot be written ({error.strerror or error}); {remedy(error)}"
            ) from error

    def reserve(self) -> None:
        """Occupy the space for the last version of ``run.json``, until :meth:`ended`, so that the
        state of a run that ended because the disk is full can be stored.
        """
        try:
            (self.path / RESERVE_FILE).write_bytes(bytes(RESERVED_BYTES))
        except OSError as error:
            raise StorageError(
                f"{self.path} cannot be written ({error.strerror or error}); {remedy(error)}"
            ) from error

    def release(self) -> None:
        """Give the reserved space back."""
        with suppress(OSError):
            (self.path / RESERVE_FILE).unlink(missing_ok=True)

    def ended(self, state: str, message: str, de_energised: bool) -> None:
        """Write how the run ended as soon as the ending is known."""
        self.release()
        record = self.record
        record.state, record.message, record.de_energised = state, message, de_energised
        record.stage_ended(state)
        self.save()

    def stage_started(self, index: int) -> None:
        """Store that a stage begins; earlier recordings of this stage are no longer used."""
        discard(self.record, index)
        self.record.stages[index].state = "running"
        self.record.stages[index].load_change_kg = None
        self.save()

    def weight_confirmed(self, index: int, weight_kg: float) -> None:
        """Store the mass that the operator confirmed."""
        self.record.stages[index].confirmed_kg = weight_kg

    def weighed(self, weighing: Weighing) -> None:
        """Store the result of a weight check."""
        self.record.weights.append(
            {**dataclasses.asdict(weighing), "verdict": weighing.verdict.value}
        )

    def stage_finished(self, index: int) -> None:
        """Store that a stage is complete and the drive is de-energised."""
        self.record.stages[index].state = "done"
        self.save()

    def segment_started(self, stage: int, repeat: int, segment: int, time: float) -> None:
        """Store that an excitation begins at ``time`` s of the recording."""
        record = self.record
        record.segments.append(
            record.stages[stage].segment(segment, stage, repeat, time, len(record.parts))
        )
        self.save()

    def segment_finished(self, segment: int, time: float) -> None:
        """Store that the excitation is complete."""
        next(item for item in self.record.segments if item.index == segment).end = time
        self.save()


def discard(record: RunRecord, stage: int) -> None:
    """Mark the stage's earlier recordings as not to be used."""
    for segment in record.segments:
        if segment.stage_index == stage:
            segment.kept = False


def first_unfinished(record: RunRecord) -> int | None:
    """Return the index of the first unfinished stage, or None if all stages are done."""
    return next((index for index, stage in enumerate(record.stages) if stage.state != "done"), None)


def part_file(number: int) -> str:
    """Return the file name of a recording of a run; ``number`` counts from 1."""
    return RECORDING_FILE if number == 1 else f"recording-{number}.mcap"


def bench_constants(bench: Bench) -> BenchConstants:
    """Return the constants of a bench that an identification needs."""
    m, generator = bench.machine, bench.gas_generator
    return BenchConstants(
        motion="rotary",
        torque_constant=m.torque_constant_N_m_A,
        back_emf_constant=m.back_emf_constant_V_s_rad,
        resistance=m.resistance_ohm,
        inductance=m.inductance_H,
        gear_ratio=m.gear_ratio,
        moment_arm=m.moment_arm_m,
        lever_ratio=m.lever_ratio,
        gravity=m.gravity_m_s2,
        gas_generator=None if generator is None else generator.generator(m.moment_arm_m),
    )


def create_folder(path: Path, purpose: str) -> Lock:
    """Make the folder of a new run, and lock it; the caller must release the lock.

    Raises:
        InUseError: Another program uses the folder.
        StorageError: The folder cannot be locked.
    """
    with usable(path, "used as a run folder"):
        path.mkdir(parents=True, exist_ok=True)
    lock = hold_folder(path, purpose)
    try:
        # Checked under the lock, so that only one of two programs can find the folder empty.
        require_unused(path)
    except BaseException:
        lock.release()
        raise
    return lock


def require_unused(path: Path) -> None:
    """Check that a folder does not exist, or contains nothing but the lock."""
    with usable(path, "used as a run folder"):
        items = path.iterdir() if path.exists() else ()
        occupied = next((item.name for item in items if item.name != OWNER_FILE), None)
    if occupied is not None:
        raise InputError(
            f"{path}: not empty (holds {occupied}); give --out a new folder, so that no run is "
            f"overwritten"
        )


def load_run(folder: Path, *, partial: bool = False) -> Dataset:
    """Read a run folder for identification: one recording per finished excitation.

    Samples whose answer was incomplete are left out, with a note in the recording. If a stage was
    run more than once, its last run counts.

    ``partial``: whether to also take unfinished excitations, up to their last fresh sample;
    excitations that are too short for a recording are left out.
    """
    record = read_record(folder)
    wanted = [s for s in record.segments if s.kept and (s.end is not None or partial)]
    if not wanted:
        raise _nothing(folder, record, partial)
    bench = recorded_bench(record)
    recordings: list[Recording] = []
    for number in sorted({segment.part for segment in wanted}):
        part = record.parts[number - 1]
        path = folder / part.file
        mine = [segment for segment in wanted if segment.part == number]
        samples, damage = by_segment(path, mine)
        if damage is not None and part.state == "done":
            raise InputError(
                f"{path}: damaged though the run was finished: {damage}; use `rig recover {folder}`"
            )
        mine = [
            s
            for s in mine
            if s.end is not None or np.count_nonzero(samples[s.index]["fresh"]) >= LEAST_SAMPLES
        ]
        digest = sha256_file(path)
        try:
            recordings += [
                _recording(s, samples.pop(s.index), damage, bench, path, digest) for s in mine
            ]
        except RecordingError as error:
            raise InputError(f"{path}: {error}") from error
    if not recordings:
        raise _nothing(folder, record, partial)
    return Dataset(tuple(recordings))


def _nothing(folder: Path, record: RunRecord, partial: bool) -> InputError:
    """Return the error for a run without a usable recording."""
    # An unreadable recording is reported first.
    read_log(folder / RECORDING_FILE)
    state = f"(state {record.state}: {record.message or 'writer died'})"
    if partial:
        return InputError(
            f"{folder}: no excitation was recorded {state}; this run has no data to evaluate"
        )
    unfinished = any(segment.kept for segment in record.segments)
    remedy = (
        "--partial uses the recorded part of unfinished excitations"
        if unfinished
        else "no excitation has begun"
    )
    return InputError(f"{folder}: no stage was finished {state}; {remedy}")


def _recording(
    segment: SegmentRecord,
    samples: dict[str, Array],
    damage: str | None,
    bench: BenchConstants,
    path: Path,
    digest: str,
) -> Recording:
    """Return one excitation; ``samples`` is emptied, because it does not fit in memory twice."""
    fresh = samples.pop("fresh") != 0.0
    partial = segment.end is None
    if partial:
        stop = int(np.flatnonzero(fresh)[-1]) + 1
        fresh, samples = fresh[:stop], {name: values[:stop] for name, values in samples.items()}
    elif len(fresh) != segment.samples:
        raise InputError(
            f"{path}: {segment.name}: {len(fresh)} of {segment.samples} samples are in the "
            "recording, although the excitation was finished"
            f" ({damage or 'run.json says otherwise'}); use `rig recover {path.parent}`"
        )
    if not fresh.all():
        for name in samples:
            samples[name] = samples[name][fresh]
    encoder_time = samples.pop("encoder_time")
    time, notes = _times(samples, encoder_time)
    if partial:
        seconds = f"{time[-1] - time[0]:.4g} s"
        notes.insert(
            0,
            f"partial: the run stopped after {len(fresh)} of {segment.samples} samples, {seconds}",
        )
    if not fresh.all():
        notes.append(
            f"{int(np.sum(~fresh))} samples left out, because the answer of a device was missing"
        )
    left_out = [name for name in LEFT_OUT if name not in samples]
    if left_out:
        notes.append(
            f"{', '.join(left_out)} not read: with these channels, a run of this length would "
            "not fit into memory"
        )
    channels, words = aligned({**samples, "time": time}, encoder_time, AVERAGED, bench.gear_ratio)
    if words:
        notes.append(words)
    return Recording(
        name=f"{segment.name}{PARTIAL}" if partial else segment.name,
        channels=channels,
        bench=bench,
        stage="unloaded" if segment.stage == "unloaded" else "loaded",
        weight_mass=segment.weight_kg,
        role=segment.role,
        averaged=AVERAGED,
        source=str(path),
        sha256=digest,
        notes=tuple(notes),
        partial=partial,
    )


def _times(samples: dict[str, Array], encoder_time: Array) -> tuple[Array, list[str]]:
    """Return the times of the samples, s, and notes on the clocks, which leave ``samples``."""
    time, device_time = samples.pop("time"), samples.pop("device_time")
    notes = describe(time, samples.pop("host_time"), device_time, encoder_time)
    # The drive's time stamps are those of its latch; the host's times have the jitter of its
    # scheduler.
    if device_time.size > 1 and np.all(np.diff(device_time) > 0):
        device_time += time[0] - device_time[0]
        time = device_time
    else:
        notes.insert(0, "the drive's time stamps do not increase; the host's times are used")
    return time, notes
