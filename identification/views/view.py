"""Preprocesses a recording for the diagnosis: signals at the full sample rate on an even grid, and
the filter to the stated bandwidth.

Every regressor is computed from these signals at the full sample rate and then passes the filter
that the mismatch passes, so that the filter does not cause an apparent effect.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from identification.model.parameters import LINEAR
from identification.numerics.series import delayed_series
from identification.prepare import (
    POSITION_BANDWIDTH,
    contact_moment,
    drive_torque,
    finer_joint,
    irregular,
    joint_angle,
    least_samples,
    resting,
    uniform_grid,
    widened,
    without_rare,
)
from identification.recording import Array, Recording, RecordingError
from identification.signals import (
    BoolArray,
    Decimator,
    central_difference,
    decimator,
    quantum,
    resample,
    smooth,
    values_at_ends,
)

RISE_SAMPLES = 5
"""Number of samples before a breakaway over which the torque's rate of rise is averaged."""
STEADY_SHARE = 0.7
"""Peak-to-peak speed around a sample over the speed, from which motion counts as unsteady."""
HUNTING_SHARE = 0.09
"""Rms of the speed that the filter removes over the speed, from which motion is unsteady."""
QUICK_SAMPLES = 2
"""Number of samples before and after a sample over which the unfiltered speed is computed."""
BEYOND_FILTER = 3.0
"""Ratio of the bandwidth of the unfiltered speed to the cut-off of the filter, from which an
oscillation of the drive can be distinguished from motion just above the cut-off.
"""
THIRD_DIFFERENCE = math.sqrt(20.0)
"""Standard deviation of the third differences of white noise of unit variance."""
LEAST_REST_S = 0.02
"""Least duration of a rest, s; a shorter one is not told from slow passage through zero."""


def breakaways(still: BoolArray, rest: Array, torque: Array, sense: Array) -> NDArray[np.int64]:
    """Return the samples at which rests end in breakaways, shape (e,)."""
    ends = np.flatnonzero(still[:-1] & ~still[1:]) + 1
    # Motion against the torque at the end of a rest is not a breakaway: a reading of the encoder
    # changes by noise, or the shaft springs back.
    pushed = np.sign(torque)
    kept = [
        k
        for k in ends
        if rest[k - 1] >= LEAST_REST_S and k > RISE_SAMPLES + 1 and pushed[k - 1] == sense[k]
    ]
    return np.array(kept, dtype=np.int64)


class Quick(NamedTuple):
    """The speed, computed by differences over few samples, and the noise of this speed, rad/s."""

    velocity: Array
    noise: float


def quick_speed(series: Array, rate: float) -> Quick:
    """Return the speed by differences over :data:`QUICK_SAMPLES` on either side of a sample."""
    span = 2 * QUICK_SAMPLES / rate
    padded = np.pad(series, QUICK_SAMPLES, mode="edge")
    rough = 1.4826 * float(np.median(np.abs(np.diff(series, n=3)))) / THIRD_DIFFERENCE
    scatter = max(rough, quantum(series) / math.sqrt(12.0))
    return Quick(
        (padded[2 * QUICK_SAMPLES :] - padded[: -2 * QUICK_SAMPLES]) / span,
        math.sqrt(2.0) * scatter / span,
    )


def unsteady(velocity: Array, quick: Quick, rate: float, cutoff: float) -> BoolArray:
    """Mark moving samples whose friction is not a function of the filtered speed.

    A sample is unsteady if the speed around it varies by more than a share of the speed, because
    the shaft slips and nearly sticks within the filter's window. A sample is also unsteady if the
    speed varies faster than the filter resolves, as with a drive that oscillates at up to 100 Hz on
    the falling branch of friction. In both cases the mean of friction is not the friction at the
    mean speed.

    Args:
        velocity: Speed filtered to ``cutoff``, rad/s.
        quick: Speed by differences over few samples.
        rate: Sample rate, Hz.
        cutoff: Cut-off of the filter, Hz.
    """
    reach = round(0.5 * rate / cutoff)
    size = 2 * reach + 1
    swing = ndimage.maximum_filter1d(velocity, size) - ndimage.minimum_filter1d(velocity, size)
    found = swing >= STEADY_SHARE * np.abs(velocity)
    if rate >= 2 * QUICK_SAMPLES * BEYOND_FILTER * cutoff:
        hidden = ndimage.uniform_filter1d((quick.velocity - velocity) ** 2, size)
        found |= hidden - quick.noise**2 >= (HUNTING_SHARE * velocity) ** 2
    return np.asarray(found)


def sense(velocity: Array, torque: Array, still: BoolArray) -> Array:
    """Return the sign of friction: the direction of motion, or at rest the sign of the torque."""
    here = np.where(still, np.sign(torque), np.sign(velocity))
    return np.asarray(here[last_marked(here != 0.0)])


def reversals(sense: Array) -> BoolArray:
    """Mark samples whose direction differs from that of the previous sample."""
    return np.concatenate(([False], sense[1:] != sense[:-1]))


def last_marked(marks: BoolArray) -> NDArray[np.int64]:
    """Return the last marked sample up to each sample, or else the first sample, shape (m,)."""
    return np.maximum.accumulate(np.where(marks, np.arange(len(marks)), 0))


LEAST_STEADY = 0.1
"""Samples in unsteady motion are omitted only if this share of all is in steady motion."""
SAME_ENCODER = 1e-9
"""Greatest difference of two angles, relative to the travel, of one and the same encoder."""
USUAL_TORQUE_N_M, USUAL_SPEED_RAD_S, USUAL_TRAVEL_RAD = 40.0, 0.5, 0.8
"""Greatest torque and speed, and the travel, on the practical bench."""
AS_COMPUTED = 1e-3
"""Greatest difference of a recorded voltage from the voltage of the control law, relative to the
greatest voltage, at which the recorded voltage counts as computed.
"""
NEEDED = ("command", "angle", "voltage", "supply_voltage")
MEASURED = ("torque", "current")
WITHIN_STEP = 0.3
"""Standard deviation of the instant of a breakaway within its sample, relative to the sample period
(0.29 for a uniform distribution).
"""
SURE_N_M = 0.1  # approximate torque noise of one sample on the practical bench
P = ParamSpec("P")
R = TypeVar("R")
KEPT = 128  # number of results kept for each function; hundreds of trial parameters use one series
_CACHES: list[Any] = []


def recent(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the latest results of a function; the arguments of the function must be hashable."""
    kept = lru_cache(maxsize=KEPT)(function)
    _CACHES.append(kept)
    return cast(Callable[P, R], kept)


def forget() -> None:
    """Remove all results from the caches."""
    for kept in _CACHES:
        kept.cache_clear()


@dataclass(frozen=True, eq=False)
class View:
    """Signals of one recording on its even grid, SI, at the joint; arrays have shape (m,) unless
    stated otherwise.

    Instances are compared by identity, as keys of caches.
    """

    recording: Recording
    index: int  # index among the recordings under diagnosis
    time: Array  # time stamps, s
    run_time: Array  # time since the start of the first recording, s
    angle: Array  # joint angle by the finer encoder, rad
    velocity: Array  # joint velocity, rad/s
    acceleration: Array  # joint acceleration, rad/s^2
    torque: Array  # drive torque less known loads, N m
    raw_torque: Array  # unfiltered `torque`, for events within a few samples, N m
    # Motor acceleration over the gear ratio less joint acceleration, rad/s^2; zero if friction is a
    # function of the motor's motion.
    twist: Array
    known: Array  # known loads (a declared weight that turns with the joint), N m
    hanging: Array  # known loads without their inertia torque, N m
    moment: Array  # F_P L1, N m
    sense: Array  # sign of friction: direction of motion, or at rest the sign of the torque
    still: BoolArray  # samples at rest
    rest_time: Array  # duration of the present or last rest, s
    reversal_time: Array  # time since the last reversal, s
    reversal_travel: Array  # travel since the last reversal, rad
    # Angle of the motor shaft, rad; without a motor encoder computed from the joint angle.
    motor: Array
    motor_speed: Array  # speed of the motor shaft, rad/s
    # Drive side less joint side, motor_angle/i - angle, rad; None without both encoders.
    lag: Array | None
    current: Array | None  # motor current, A, or None if not recorded
    voltage: Array | None  # voltage, V, NaN while the power stage is off, or None if not recorded
    supply: Array | None  # supply voltage, V, or None if not recorded
    temperature: Array | None  # temperature, deg C, or None if not recorded
    low_pass: Decimator  # filter to the stated bandwidth
    # Mask of the filter outputs that depend on no sample at rest, at a reversal or in unsteady
    # motion, shape (n,).
    moving: BoolArray
    # Mask of the filter outputs that depend on no sample at rest or at a reversal, for machines
    # that hardly move steadily, such as in slow motion against cogging, shape (n,).
    unsteady: BoolArray
    breakaways: np.ndarray  # samples at which a rest ends, shape (e,)
    # View of the recording before this one on the same clock, or None.
    before: View | None = field(default=None, repr=False)
    # Cache of the view with delayed motion that was computed last: delay, s, to view.
    behind: dict[float, View] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def step(self) -> float:
        """Grid step, s."""
        return float(self.time[1] - self.time[0])

    @cached_property
    def rotor_acceleration(self) -> Array:
        """Motor acceleration over the gear ratio, rad/s^2."""
        return np.asarray(
            central_difference(self.motor_speed, self.step) / self.recording.bench.gear_ratio
        )

    @cached_property
    def transmitted(self) -> Array:
        """Torque through the transmission, including declared loads, N m."""
        return np.asarray(self.torque - self.known)

    @cached_property
    def drive_angle(self) -> Array:
        """Motor angle over the gear ratio, rad."""
        return np.asarray(self.motor / self.recording.bench.gear_ratio)

    @cached_property
    def burdened(self) -> bool:
        """Whether a declared load turns with the joint."""
        return bool(np.any(self.known))

    @cached_property
    def loaded(self) -> bool:
        """Whether a contact moment acts on the joint."""
        return bool(np.any(self.moment != 0.0))

    @cached_property
    def voltage_is_computed(self) -> bool:
        """Whether the torque is computed from a voltage that the control law computed."""
        return voltage_is_computed(self.recording)

    def command_delay_error(self, late_s: float) -> Array:
        """Return the torque error because the voltage's command is not delayed, N m, shape (m,)."""
        recording, law = self.recording, _law(self.recording, late_s)
        volts = np.where(np.isfinite(recording.channels["voltage"]), law, np.nan)
        together = replace(recording, channels={**recording.channels, "voltage": volts})
        here, there = (drive_torque(r, self.time, self.velocity) for r in (recording, together))
        return np.asarray(here - there)

    def with_velocity(self, velocity: Array) -> View:
        """Return the view with another velocity of the joint."""
        return replace(self, velocity=velocity)

    @property
    def kept_times(self) -> Array:
        """Times of the filter's outputs, s, shape (n,)."""
        half = self.low_pass.half
        return self.time[half : len(self.time) - half : self.low_pass.factor]


class _Origin(NamedTuple):
    """Start of a recording in running time, s, and offset of its joint angle, rad."""

    start: float
    shift: float


def views(
    recordings: Sequence[Recording],
    bandwidth_Hz: float,
    valve_side: bool = False,
    campaign: Sequence[Recording] = (),
) -> tuple[View, ...]:
    """Return a view of each recording.

    Args:
        recordings: Recordings.
        bandwidth_Hz: Bandwidth of the filter.
        valve_side: Whether angle and speed are from the joint encoder even if the motor encoder is
            finer: with a flexible transmission, friction depends on the motion of the valve.
        campaign: All recordings of the campaign in order; the machine also warms during recordings
            that are not used, and all of them show whether the encoders keep their origins.
    """
    every = campaign or recordings
    starts = run_starts(every)
    shifts = _shifts_of_zero(every, starts, valve_side)
    origins = {id(r): _Origin(*o) for r, *o in zip(every, starts, shifts, strict=True)}
    found = _one_origin(
        [_view(r, k, bandwidth_Hz, valve_side, origins[id(r)]) for k, r in enumerate(recordings)],
        every,
    )
    if sum(np.sum(v.moving) for v in found) < LEAST_STEADY * sum(np.sum(v.unsteady) for v in found):
        found = tuple(replace(v, moving=v.unsteady) for v in found)
    return _linked(found)


def _linked(found: Sequence[View]) -> tuple[View, ...]:
    """Return the views, each with the view before it; without a common clock there is none."""
    last: dict[str | None, View] = {}
    linked: dict[int, View] = {}
    for k in sorted(range(len(found)), key=lambda k: float(found[k].run_time[0])):
        view, before = found[k], last.get(found[k].recording.session)
        if before is not None and before.run_time[-1] < view.run_time[0]:
            view = replace(view, before=before)
        linked[k] = last[view.recording.session] = view
    return tuple(linked[k] for k in range(len(found)))


def _shifts_of_zero(
    recordings: Sequence[Recording], starts: Sequence[float], valve_side: bool
) -> list[float]:
    """Return the offset that is added to the joint angle of each recording, rad, so that the angles
    of all recordings have one zero.

    The joint angle is computed from the motor encoder, with the zero of the joint encoder in each
    recording (:func:`joint_angle`). If the motor encoder kept its origin, the zero of the first
    recording is valid for all recordings, even if the joint encoder slipped later.
    """
    lags = [None if valve_side or finer_joint(r) else _encoder_lag(r) for r in recordings]
    known = [(start, lag) for start, lag in zip(starts, lags, strict=True) if lag is not None]
    if len(known) < 2 or _origin_is_lost([lag for _, lag in known]):
        return [0.0] * len(recordings)
    first = float(np.median(min(known, key=lambda k: k[0])[1]))
    return [0.0 if lag is None else float(np.median(lag)) - first for lag in lags]


def _origin_is_lost(lags: Sequence[Array]) -> bool:
    """Whether the encoders' difference changes more between recordings than within any."""
    within = max(float(np.ptp(lag)) for lag in lags)
    return float(np.ptp([np.median(lag) for lag in lags])) > within


def _one_origin(found: Sequence[View], campaign: Sequence[Recording]) -> tuple[View, ...]:
    """Return the views with motor angles from a common origin, which the joint encoder determines.

    A motor encoder that counts from power-on loses its origin between recordings, and effects that
    are periodic in the motor angle lose their phase. The origin counts as lost if the difference of
    the encoders changes more between recordings of the campaign than within any of them.
    """
    lags = [lag for lag in map(_encoder_lag, campaign) if lag is not None]
    if len(lags) < 2 or not _origin_is_lost(lags):
        return tuple(found)
    return tuple(
        v
        if v.lag is None
        else replace(v, motor=v.motor - v.recording.bench.gear_ratio * float(np.median(v.lag)))
        for v in found
    )


def _view(
    recording: Recording, index: int, bandwidth_Hz: float, valve_side: bool, origin: _Origin
) -> View:
    grid, rate = uniform_grid(recording), 1.0 / recording.period
    low_pass = decimator(rate, bandwidth_Hz)
    if len(grid) < least_samples(rate, bandwidth_Hz):
        raise RecordingError(
            f"{recording.name}: the recording has {len(grid)} samples, but the filter for a "
            f"bandwidth of {bandwidth_Hz:.3g} Hz needs at least {2 * low_pass.half + 8}; state a "
            "higher bandwidth"
        )
    cutoff = POSITION_BANDWIDTH * bandwidth_Hz
    angle, velocity, quick, still = _motion(recording, grid, cutoff, valve_side)
    angle = np.asarray(angle + origin.shift)
    acceleration = central_difference(velocity, 1.0 / rate)
    drive = drive_torque(recording, grid, velocity)
    hanging = recording.known_torque(angle)
    known = hanging - recording.known_inertia * acceleration
    torque = smooth(drive, rate, cutoff) + known
    senses = sense(velocity, torque, still)
    turned = reversals(senses)
    margin = round(1.5 * rate / cutoff)
    stopped = still | turned
    hasty = unsteady(velocity, quick, rate, cutoff)
    late = widened(irregular(recording.time, grid), margin)
    rest = np.asarray(grid - grid[last_marked(~still)])
    last = last_marked(turned)
    motor = _motor(recording, grid, angle)
    return View(
        recording=recording,
        index=index,
        time=grid,
        run_time=origin.start + grid - grid[0],
        angle=angle,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque,
        raw_torque=np.asarray(drive + known),
        twist=_twist(recording, grid, cutoff, valve_side),
        known=known,
        hanging=hanging,
        moment=contact_moment(recording, grid, angle),
        sense=senses,
        still=still,
        rest_time=np.asarray(rest[last_marked(still)]),
        reversal_time=np.asarray(grid - grid[last]),
        reversal_travel=np.asarray(np.abs(angle - angle[last])),
        motor=motor,
        motor_speed=_speed(recording, motor, velocity, cutoff),
        lag=_lag(recording, grid),
        current=_channel(recording, "current", grid),
        voltage=_voltage(recording, grid),
        supply=_channel(recording, "supply_voltage", grid),
        temperature=_channel(recording, "temperature", grid),
        low_pass=low_pass,
        moving=without_rare(low_pass, widened(stopped | hasty, margin), late),
        unsteady=without_rare(low_pass, widened(stopped, margin), late),
        breakaways=breakaways(still, rest, drive + known, senses),
    )


def _motion(
    recording: Recording, grid: Array, cutoff: float, valve_side: bool
) -> tuple[Array, Array, Quick, BoolArray]:
    rate = 1.0 / recording.period
    position = recording.channels.get("angle") if valve_side else joint_angle(recording)
    if position is not None:
        series = resample(recording.time, position, grid)
        still = resting(series)
        angle = smooth(series, rate, cutoff)
        return angle, central_difference(angle, 1.0 / rate), quick_speed(series, rate), still
    if "velocity" not in recording.channels:
        raise RecordingError(f"{recording.name}: no angle, motor_angle or velocity channel")
    velocity = smooth(resample(recording.time, recording.channels["velocity"], grid), rate, cutoff)
    angle = np.concatenate(([0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1])))) / rate
    return angle, velocity, Quick(velocity, 0.0), np.asarray(velocity == 0.0)


def _channel(recording: Recording, name: str, grid: Array) -> Array | None:
    values = recording.channels.get(name)
    if values is None or not np.all(np.isfinite(values)):
        return None
    if name in recording.averaged:
        values = values_at_ends(recording.time, values, recording.period)
    return resample(recording.time, values, grid)


def _voltage(recording: Recording, grid: Array) -> Array | None:
    """Return the voltage, NaN with the power stage off; None if it or the current is unknown."""
    values = recording.channels.get("voltage")
    if values is None or "current" not in recording.channels:
        return None
    off = ~np.isfinite(values)
    if "enabled" in recording.channels:
        off |= recording.channels["enabled"] < 0.5
    known = np.where(off, 0.0, values)
    if "voltage" in recording.averaged:
        known = values_at_ends(recording.time, known, recording.period, ~off)
        off = off | np.append(off[1:], off[-1:])
    dark = resample(recording.time, off.astype(np.float64), grid) > 0.0
    return np.where(dark, np.nan, resample(recording.time, known, grid))


def _speed(recording: Recording, motor: Array, velocity: Array, cutoff: float) -> Array:
    if "motor_angle" not in recording.channels:
        return np.asarray(recording.bench.gear_ratio * velocity)
    rate = 1.0 / recording.period
    return central_difference(smooth(motor, rate, cutoff), 1.0 / rate)


def _twist(recording: Recording, grid: Array, cutoff: float, valve_side: bool) -> Array:
    lag = _lag(recording, grid) if valve_side else None
    if lag is None:
        return np.zeros(len(grid))
    rate = 1.0 / recording.period
    return central_difference(central_difference(smooth(lag, rate, cutoff), 1.0 / rate), 1.0 / rate)


def _motor(recording: Recording, grid: Array, angle: Array) -> Array:
    if "motor_angle" in recording.channels:
        return resample(recording.time, recording.channels["motor_angle"], grid)
    return np.asarray(recording.bench.gear_ratio * angle)


def _lag(recording: Recording, grid: Array) -> Array | None:
    lag = _encoder_lag(recording)
    return None if lag is None else resample(recording.time, lag, grid)


def _encoder_lag(recording: Recording) -> Array | None:
    """Return motor angle over gear ratio less joint angle, rad; None without both encoders."""
    channels = recording.channels
    if "motor_angle" not in channels or "angle" not in channels:
        return None
    lag = channels["motor_angle"] / recording.bench.gear_ratio - channels["angle"]
    if float(np.ptp(lag)) < SAME_ENCODER * float(np.ptp(channels["angle"])):
        return None
    return np.asarray(lag)


def rise_rate(view: View) -> Array:
    """Return the rate of rise of the torque over a few samples before each sample, N m/s."""
    before = np.roll(view.raw_torque, 1)
    return np.asarray(
        (before - np.roll(view.raw_torque, 1 + RISE_SAMPLES)) / (RISE_SAMPLES * view.step)
    )


def sharpness(view: View) -> Array:
    """Return weights of breakaways: the faster the torque rises, the less a sample states."""
    last = view.raw_torque[view.breakaways - 1], view.raw_torque[view.breakaways - 1 - RISE_SAMPLES]
    unsure = np.abs((last[0] - last[1]) / (RISE_SAMPLES * view.step)) * view.step * WITHIN_STEP
    return np.asarray(1.0 / np.sqrt(1.0 + (unsure / SURE_N_M) ** 2))


def lacks_common_origin(views: Sequence[View]) -> bool:
    """Whether only the speed was recorded, so that angles have no common origin."""
    unknown = [v for v in views if not v.recording.channels.keys() & {"angle", "motor_angle"}]
    return len(views) > 1 and len(unknown) > 0


def one_clock(recordings: Sequence[Recording]) -> bool:
    """Whether the recordings of each session, by starts or time stamps, follow one another on one
    clock.
    """
    return all(
        ended < began
        for session in {r.session for r in recordings}
        for (_, ended), (began, _) in itertools.pairwise(
            sorted(r.span for r in recordings if r.session == session)
        )
    )


def run_starts(recordings: Sequence[Recording]) -> list[float]:
    """Return the running time at which each recording begins, s.

    If starts or time stamps of a session follow one another, running time counts from the zero of
    their clock, at which the machine was cold, provided that this zero precedes the first recording
    by no more than the total duration of the recordings; otherwise running time counts from the
    start of the first recording. The order of recordings without a common clock is unknown; each
    recording is then assumed to start cold, with running time 0.
    """
    starts = [0.0] * len(recordings)
    for session in {r.session for r in recordings}:
        here = [k for k, r in enumerate(recordings) if r.session == session]
        spans = [recordings[k].span for k in here]
        if (len(here) > 1 or session) and one_clock([recordings[k] for k in here]):
            first, last = (min(s[0] for s in spans), max(s[1] for s in spans))
            zero = 0.0 if 0.0 <= first < last - first else first
            for k, span in zip(here, spans, strict=True):
                starts[k] = span[0] - zero
    return starts


def torque_scale(views: Sequence[View]) -> float:
    """Return the greatest torque over that of the practical bench."""
    return max(float(np.max(np.abs(v.torque))) for v in views) / USUAL_TORQUE_N_M


def speed_scale(views: Sequence[View]) -> float:
    """Return the greatest speed over that of the practical bench."""
    return max(float(np.max(np.abs(v.velocity))) for v in views) / USUAL_SPEED_RAD_S


def travel_scale(views: Sequence[View]) -> float:
    """Return the travel over that of the practical bench."""
    return max(float(np.ptp(v.angle)) for v in views) / USUAL_TRAVEL_RAD


def at_scale(angles_rad: Sequence[float], views: Sequence[View]) -> list[float]:
    """Return trial values of angles of the transmission at the joint: in rad, the same for benches
    of any size; on a linear axis in m, in proportion to the travel.
    """
    scale = travel_scale(views) if views[0].recording.bench.motion == LINEAR else 1.0
    return [scale * angle for angle in angles_rad]


def voltage_is_computed(recording: Recording) -> bool:
    """Whether the torque comes from a voltage that the control law gave from the samples."""
    channels, loop = recording.channels, recording.controller
    if (
        loop is None
        or loop.output != "duty"
        or loop.velocity_gain
        or any(name in channels for name in MEASURED)
    ):
        return False
    if not all(name in channels for name in NEEDED):
        return False
    volts = channels["voltage"]
    known = np.isfinite(volts)
    if not known.any():
        return False
    greatest = float(np.max(np.abs(volts[known])))
    return float(np.max(np.abs(volts - _law(recording, 0.0))[known])) <= AS_COMPUTED * greatest


DELAYED = (
    *("angle", "velocity", "acceleration", "known", "hanging", "moment", "sense", "motor"),
    "motor_speed",
)
"""Signals of the motion, which are delayed like the samples of the torque."""


def delayed_view(view: View, late_s: float) -> View:
    """Return a view whose motion is delayed like the samples of the torque, for effects that depend
    on the angle.

    The view is not delayed if the torque is computed from a computed voltage. The last result is
    cached, because most trial parameters use one delay.
    """
    known = view.behind.get(late_s)
    if known is None:
        known = view if voltage_is_computed(view.recording) else _moved(view, late_s)
        view.behind.clear()
        view.behind[late_s] = known
    return known


def _moved(view: View, late_s: float) -> View:
    def late(series: Array) -> Array:
        return delayed_series(series, view.step, late_s)

    moved: dict[str, Any] = {name: late(getattr(view, name)) for name in DELAYED}
    return replace(view, **{**moved, "sense": np.clip(moved["sense"], -1.0, 1.0)})


def _law(recording: Recording, late_s: float) -> Array:
    """Return the voltage of the control law for a command delayed by ``late_s``, V, shape (m,)."""
    channels, loop = recording.channels, recording.controller
    assert loop is not None
    command = np.interp(recording.time - late_s, recording.time, channels["command"])
    duty = loop.position_gain * (command - channels["angle"])
    if loop.limit is not None:
        duty = np.clip(duty, -loop.limit, loop.limit)
    return np.asarray(channels["supply_voltage"] * duty)
