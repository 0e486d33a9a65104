"""Frequency response of a drive's control loops, from recordings of a moving joint.

While a slow carrier moves the joint, small tones on many lines are added to the command. In windows
in which the joint does not reverse, Coulomb friction is a constant torque, and the loops are linear
at small amplitude: plant Y/tau and closed loop Y/R are ratios of the amplitudes on each line. With
the error E and the feed-forward A (the rate of the command), the speed command is
U = Kp E + ka A, and the loops that are opened at the position error and at the speed error are

    Lp = Kp Y / U,    Lv = V / (U - V).

Without feed-forward Lp is Y/E = T/(1 - T). All lines have the command as their common instrument,
so that noise in the loops does not bias the ratios (Söderström and Stoica, System Identification,
1989, section 10.5). A margin of a closed loop means nothing: :func:`margins` refuses it.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.interpolate import CubicSpline, UnivariateSpline
from scipy.optimize import least_squares
from scipy.stats import t as student

from identification.numerics.arrays import Array
from identification.recording import Recording

Complex = NDArray[np.complex128]
Window = tuple[float, float]

DEGREE: Final = 5
"""Degree of the polynomial that describes the carrier in a window."""
DECAYS: Final = (0.25, 0.08)
"""Time constants, over the window, of what the reversal before the window leaves."""
WORST_NOISE, WORST_NOISE_FAR, FAR = 0.1, 0.05, 0.3
"""Greatest relative standard error of a line of an open loop that margins use; the same where the
gain is below the third number, because a gain margin depends on the error of the gain itself.
"""
LEVEL: Final = 0.9  # probability of the intervals
_GRID: Final = 2000  # points of the interpolation between the lines
_LEAST_WINDOWS, _LEAST_LINES = 3, 4
_LOOKS: Final = 100  # parts of a window in each of which the joint must move on
_SLOWEST: Final = 0.15  # least speed in them, as a share of the mean commanded speed
_MISFIT: Final = 0.15
"""Greatest rms of torque less modelled torque of an accepted controller, relative to the torque."""
_ALIKE: Final = 0.15
"""Distance of the feed-forward share from one within which position gain and reset are alike."""
_AS_GOOD: Final = 1.5
"""Factor on the misfit of the cascade up to which a position controller alone is preferred."""
_AGREE: Final = 0.1  # greatest difference from the gains of the drive's tool, relative
_NEAR: Final = 1.5  # ratio of position gain and reset below which these are near each other
_REWEIGHTED: Final = 2  # fits with the noise that the fit before leaves
_CLEAR: Final = 20.0  # least power of the torque over that of the noise
_SMOOTH: Final = 41  # frequencies over which a power is averaged


def laplace(frequency_Hz: Array) -> Complex:
    """Return the Laplace variable on lines, rad/s, (f,)."""
    return np.asarray(2j * np.pi * frequency_Hz, dtype=np.complex128)


class NotOpenLoopError(TypeError):
    """Margins of a response that is not that of an open loop were requested."""


class NoResponseError(ValueError):
    """The recordings do not contain a usable response; the message says why."""


@dataclass(frozen=True)
class OpenLoop:
    """Response of an opened loop, (f,), negative feedback: the critical point is -1.

    ``error`` is the relative standard error, (f,), or None if the response is exact.
    """

    frequency_Hz: Array
    response: Complex
    error: Array | None = None


@dataclass(frozen=True)
class ClosedLoop:
    """Response of a closed loop from command to angle, (f,)."""

    frequency_Hz: Array
    response: Complex

    def opened(self, ahead_s: float = 0.0) -> OpenLoop:
        """Return the loop opened at its error, T / (1 + a s - T).

        Args:
            ahead_s: Feed-forward of the command's rate over the position gain, s. It helps the
                closed loop, but is outside the opened one: T = L (1 + a s) / (1 + L).
        """
        s, t = laplace(self.frequency_Hz), self.response
        return OpenLoop(self.frequency_Hz, t / (1.0 + ahead_s * s - t))


@dataclass(frozen=True)
class Margins:
    """The least margins of an open loop; None where no crossing is inside the measured lines.

    Attributes:
        phase_deg: Phase margin.
        crossover_Hz: Frequency of the gain 1 to which the phase margin belongs.
        gain_dB: Factor on the gain to the limit of stability.
        phase_crossing_Hz: Frequency of the phase -180 deg to which the gain margin belongs.
        highest_Hz: Highest line, up to which crossings are seen.
        roll_off_dB: Gain below 1 at the highest line: without a crossing of -180 deg, and if the
            gain falls from there on, the gain margin is at least this.
        stable: Whether the closed loop is stable, by the turns of the open loop around -1; None if
            the gain is above 1 at the highest line.
    """

    phase_deg: float | None
    crossover_Hz: float | None
    gain_dB: float | None
    phase_crossing_Hz: float | None
    highest_Hz: float
    roll_off_dB: float
    stable: bool | None

    def values(self) -> dict[str, float | None]:
        """Return the four values that have an interval, by name."""
        names = ("phase_deg", "crossover_Hz", "gain_dB", "phase_crossing_Hz")
        return {name: getattr(self, name) for name in names}

    def reach(self, phase_deg: float, gain_dB: float, unseen_dB: float = 0.0) -> bool:
        """Whether the closed loop is known to be stable, and both margins to be at least these.

        ``unseen_dB``: gain that a resonance beyond the lines may have.
        """
        if self.phase_deg is None or not self.stable:
            return False
        least = self.roll_off_dB - unseen_dB if self.gain_dB is None else self.gain_dB
        return self.phase_deg >= phase_deg and least >= gain_dB


def margins(loop: OpenLoop) -> Margins:
    """Return the margins of an open loop, by cubic splines of gain and phase over the logarithm of
    frequency; with standard errors, by the smoothest ones within these errors.

    Raises:
        NotOpenLoopError: The response is that of a closed loop. Its phase at gain 1 is not a
            margin: a loop with 78 deg may show 163 deg.
    """
    if not isinstance(loop, OpenLoop):
        raise NotOpenLoopError("margins are those of an open loop: use ClosedLoop.opened first")
    f, gain, phase = _dense(loop)
    crossings = [(float(at), float(180.0 + angle)) for at, angle in _crossings(f, gain, phase)]
    turns = -180.0 - 360.0 * np.arange(-1, 4)
    passes = [
        (float(at), float(-level))
        for turn in turns
        for at, level in _crossings(f, phase - turn, gain)
        if level < 0.0
    ]
    # A crossover at which the phase is above 0 or below -360 deg counts with the nearest turn.
    near = [(at, (m + 180.0) % 360.0 - 180.0) for at, m in crossings]
    least = min(near, key=lambda each: abs(each[1]), default=(None, None))
    first = min(passes, key=lambda each: each[1], default=(None, None))
    stable = None if gain[-1] > 0.0 else _turns(gain, phase) == 0
    return Margins(least[1], least[0], first[1], first[0], float(f[-1]), -float(gain[-1]), stable)


def _turns(gain: Array, phase: Array) -> int:
    """Return by how many turns an open loop encircles -1, by its crossings of the phase -180 deg at
    gains above 1; integrators lead from the phase 0 to the first line.
    """
    sheet, loud = np.floor((phase + 180.0) / 360.0), gain > 0.0
    both = loud[1:] & loud[:-1]
    return int(sheet[0] * loud[0] + np.sum(np.diff(sheet)[both]))


def _dense(loop: OpenLoop) -> tuple[Array, Array, Array]:
    """Return frequency, Hz, gain, dB, and continuous phase, deg, on a fine grid."""
    at = np.log(loop.frequency_Hz)
    gain = 20.0 * np.log10(np.abs(loop.response))
    angle = np.angle(loop.response)
    # The first line has a phase between -315 and 45 deg.
    start = angle[0] - (2.0 * np.pi if angle[0] > 0.25 * np.pi else 0.0)
    phase = np.degrees(np.unwrap(np.concatenate([[start], angle[1:]])))
    if len(at) < _LEAST_LINES:
        return loop.frequency_Hz, gain, phase
    fine = np.linspace(at[0], at[-1], _GRID)
    if loop.error is None:
        return np.exp(fine), CubicSpline(at, gain)(fine), CubicSpline(at, phase)(fine)
    error = np.maximum(loop.error, 0.5 * np.median(loop.error)) + 1e-4
    spread = math.sqrt(0.5) * error
    with warnings.catch_warnings():
        # A spline that cannot become as smooth as the errors allow is still within them.
        warnings.simplefilter("ignore", UserWarning)
        size = UnivariateSpline(at, gain, w=math.log(10.0) / 20.0 / spread, s=len(at))
        turn = UnivariateSpline(at, phase, w=math.pi / 180.0 / spread, s=len(at))
    return np.exp(fine), size(fine), turn(fine)


def _crossings(f: Array, values: Array, others: Array) -> Iterator[tuple[float, float]]:
    """Yield frequency and other value at each zero of ``values``, by linear interpolation."""
    for k in np.flatnonzero(np.signbit(values[1:]) != np.signbit(values[:-1])):
        share = values[k] / (values[k] - values[k + 1])
        yield (
            math.exp(math.log(f[k]) + share * math.log(f[k + 1] / f[k])),
            others[k] + share * (others[k + 1] - others[k]),
        )


@dataclass(frozen=True)
class Spectra:
    """Amplitudes on the lines in each window over that of the command: (w, f), at the joint.

    Attributes:
        frequency_Hz: The lines, (f,).
        amplitude_rad: Amplitude of the command on each line, (f,).
        angle: Angle that the position loop feeds back.
        error: Position error.
        rate: Rate of the command, 1/s.
        speed: Speed that the speed loop feeds back, without a filter of the drive, 1/s.
        torque: Torque of the motor, N m/rad.
        motor: Angle of the motor over the gear ratio, as it is at the sample.
    """

    frequency_Hz: Array
    amplitude_rad: Array
    angle: Complex
    error: Complex
    rate: Complex
    speed: Complex
    torque: Complex
    motor: Complex

    @property
    def windows(self) -> int:
        """Number of windows."""
        return len(self.angle)

    @property
    def s(self) -> Complex:
        """Laplace variable on the lines, rad/s."""
        return laplace(self.frequency_Hz)

    def mean(self, without: int | None = None) -> Spectra:
        """Return the mean over all windows, or all but one, as one window."""
        keep = np.arange(self.windows) != (-1 if without is None else without)
        return self._each(lambda values: values[keep].mean(axis=0, keepdims=True))

    def only(self, lines: NDArray[np.bool_]) -> Spectra:
        """Return a part of the lines."""
        found = self._each(lambda values: values[:, lines])
        return dataclasses.replace(
            found,
            frequency_Hz=self.frequency_Hz[lines],
            amplitude_rad=self.amplitude_rad[lines],
        )

    def together(self, other: Spectra) -> Spectra:
        """Return the windows of both."""
        parts: dict[str, Any] = {
            n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in _SIGNALS
        }
        return dataclasses.replace(self, **parts)

    def _each(self, change: Callable[[Complex], Complex]) -> Spectra:
        parts: dict[str, Any] = {n: change(getattr(self, n)) for n in _SIGNALS}
        return dataclasses.replace(self, **parts)

    @property
    def plant(self) -> Complex:
        """Response from torque to angle, mean of the windows, rad/(N m), (f,)."""
        return np.asarray(self.motor.mean(axis=0) / self.torque.mean(axis=0))

    @property
    def closed(self) -> Complex:
        """Response from the command that the loop sees to the angle it feeds back, (f,)."""
        angle = self.angle.mean(axis=0)
        return np.asarray(angle / (angle + self.error.mean(axis=0)))

    def coherence(self) -> Array:
        """Return the squared coherence of command and angle over the windows, (f,)."""
        power = np.mean(np.abs(self.angle) ** 2, axis=0)
        return np.asarray(np.abs(self.angle.mean(axis=0)) ** 2 / power)


_SIGNALS: Final = ("angle", "error", "rate", "speed", "torque", "motor")


def amplitudes(time: Array, values: Array, frequency_Hz: Array, window: Window) -> Complex:
    """Return the complex amplitudes of signals on the lines in one window, (c, f), by least squares
    with a polynomial beside the lines; a signal is Re(amplitude exp(j 2 pi f t)).

    Args:
        time: Time since the start of the excitation, s, (n,).
        values: Signals, (c, n).
        frequency_Hz: Lines, (f,).
        window: Begin and end, s.
    """
    keep = (time >= window[0]) & (time < window[1])
    t = time[keep]
    angle = 2.0 * np.pi * np.outer(t, frequency_Hz)
    scaled = 2.0 * (t - window[0]) / (window[1] - window[0]) - 1.0
    carrier = np.polynomial.legendre.legvander(scaled, DEGREE)
    decays = np.exp(-np.outer(t - window[0], 1.0 / (np.array(DECAYS) * (window[1] - window[0]))))
    design = np.hstack([np.cos(angle), np.sin(angle), carrier, decays])
    if design.shape[0] < 1.3 * design.shape[1]:
        raise NoResponseError(f"{len(t)} samples in a window are too few for these lines")
    found = np.linalg.lstsq(design, values[:, keep].T, rcond=None)[0]
    lines = len(frequency_Hz)
    return np.asarray((found[:lines] - 1j * found[lines : 2 * lines]).T)


def _stops(time: Array, command: Array, angle: Array, window: Window) -> bool:
    """Whether the joint falls below a share of the mean commanded speed in a window."""
    inside = (time >= window[0]) & (time < window[1])
    every = max(1, int(np.count_nonzero(inside)) // _LOOKS)
    steps, asked = (np.diff(values[inside][::every]) for values in (angle, command))
    mean = float(np.mean(asked))
    return bool(np.min(steps * np.sign(mean)) < _SLOWEST * abs(mean))


def background(recording: Recording, frequency_Hz: Array, windows: Sequence[Window]) -> Array:
    """Return the rms amplitude of the angle of the motor on the lines while no tones are commanded,
    rad at the joint, (f,).
    """
    motor = recording.channels["motor_angle"] / recording.bench.gear_ratio
    time = recording.time - recording.time[0]
    found = [amplitudes(time, motor[np.newaxis], frequency_Hz, w)[0] for w in windows]
    return np.asarray(np.sqrt(np.mean(np.abs(found) ** 2, axis=0)))


def ripple(recording: Recording, windows: Sequence[Window]) -> float:
    """Return the rms of the torque's changes from sample to sample in the windows, N m; it grows
    when a loop oscillates.
    """
    time = recording.time - recording.time[0]
    steps = np.diff(recording.bench.ampere_torque * recording.channels["current"])
    inside = np.any([(time[1:] >= a) & (time[1:] < b) for a, b in windows], axis=0)
    return float(np.sqrt(np.mean(steps[inside] ** 2)))


SPEED_OVER: Final = 2  # cycles over which the host computes a speed


def spectra(
    recordings: Sequence[Recording],
    frequency_Hz: Array,
    windows: Sequence[Window],
    step_rad: float = 0.0,
    host: Literal["", "speed", "torque"] = "",
) -> Spectra:
    """Return the amplitudes on the lines in all windows of some recordings.

    At a sample the drive has reached the command of the sample before. A host that closes the
    position loop uses the angle of the sample before, and as speed the mean over two cycles.

    Args:
        recordings: Repeats of one excitation.
        frequency_Hz: Its lines, (f,).
        windows: Begin and end of each window since the start of the excitation, s. Two consecutive
            windows, one way and back, count as one: what the carrier leaves on a line that is a
            multiple of its double frequency has opposite signs in them.
        step_rad: Joint angle of one unit of the drive's position, to which targets are rounded.
        host: What a host that closes the position loop commands; empty if the drive closes it.

    Raises:
        NoResponseError: A channel is missing, a window has too few samples, or the joint stops.
    """
    rows: list[Complex] = []
    for recording in recordings:
        needed = {"command", "motor_angle", "current"}
        if missing := sorted(needed - recording.channels.keys()):
            raise NoResponseError(f"{recording.name}: no {', '.join(missing)} in the recording")
        c, bench = recording.channels, recording.bench
        torque = bench.ampere_torque * c["current"]
        motor = c["motor_angle"] / bench.gear_ratio
        sent = c["command"] if not step_rad else np.rint(c["command"] / step_rad) * step_rad
        signals = np.vstack([sent, motor, torque])
        time = recording.time - recording.time[0]
        if any(_stops(time, sent, motor, w) for w in windows):
            raise NoResponseError(
                f"{recording.name}: the joint nearly stops where it should move on; it sticks "
                "and slips, or the tones are too large"
            )
        each = [amplitudes(time, signals, frequency_Hz, w) for w in windows]
        rows += [0.5 * (there + back) for there, back in zip(each[::2], each[1::2], strict=True)]
    command, motor, torque = np.moveaxis(np.array(rows), 1, 0)
    s, period = laplace(frequency_Hz), recordings[0].period
    back = np.exp(-s * period)
    # A logged current is the mean over the period that ends at its sample.
    torque = torque / _mean(s, period)
    if host:
        fed = motor * back
        error, rate = command - fed, command * (1.0 - back) / period
    else:
        # The drive moves linearly from target to target.
        seen = command * back
        fed, error, rate = motor, seen - motor, s * seen
    speed = s * fed
    if host == "torque":
        speed = fed * (1.0 - back**SPEED_OVER) / (SPEED_OVER * period)
    size = np.abs(command).mean(axis=0)
    parts = {
        name: values / command
        for name, values in zip(_SIGNALS, (fed, error, rate, speed, torque, motor), strict=True)
    }
    return Spectra(frequency_Hz, size, **parts)


@dataclass(frozen=True)
class Gains:
    """Gains of the cascade position P, speed PI, or of a position controller alone.

    Attributes:
        position: Speed command per position error, 1/s; torque per position error, N m/rad, where
            ``speed`` is 0.
        speed: Torque per speed error, N m s/rad; 0 for a position controller alone.
        reset: Inverse reset time of the speed loop, 1/s.
        ahead: Share of the command's rate in the speed command.
        delay_s: Delay of the torque behind the controller's output, s.
        filter_Hz: Cut-off of the first-order filter on the drive's speed; infinite if the program
            knows the speed that the loop uses.
    """

    position: float
    speed: float = 0.0
    reset: float = 0.0
    ahead: float = 0.0
    delay_s: float = 0.0
    filter_Hz: float = math.inf

    def filtered(self, s: Complex) -> Complex:
        """Return the response of the filter on the speed, (f,)."""
        return np.asarray(1.0 / (1.0 + s / (2.0 * math.pi * self.filter_Hz)))


class Fitted(NamedTuple):
    """Gains with the relative rms of the torque that they leave, and whether position gain and
    reset cannot be told apart, because the whole rate of the command is fed forward.
    """

    gains: Gains
    misfit: float
    alike: bool


def fit_gains(
    recordings: Sequence[Recording], highest_Hz: float, step_rad: float, known: Gains | None = None
) -> Fitted:
    """Return the drive's gains from the spectra of whole excitations,

        tau = Kv (1 + Ki / s) (Kp E + ka s R - s Y / (1 + s / wf)) exp(-s d),

    or tau = K E exp(-s d), if it describes the torque as well. A controller has no noise of its
    own, so that friction, which disturbs the plant at each reversal, excites it as the tones do.

    Args:
        recordings: Excitations with and without tones.
        highest_Hz: Highest frequency that is used.
        step_rad: Joint angle of one unit of the drive's position, to which targets are rounded.
        known: Gains as the drive's own tool shows them. They only tell apart a position gain and a
            reset that are alike; without them the greater one is the position gain.

    Raises:
        NoResponseError: No such controller describes the torque.
    """
    parts = [_bands(recording, highest_Hz, step_rad) for recording in recordings]
    s, torque, *signals = (np.concatenate(each) for each in zip(*parts, strict=True))
    error, error_sum, rate, seen, pace, angle = signals
    weight: Array = np.ones(len(s))  # replaced below, for all that follows

    def cascade(p: Array) -> Complex:
        kp, ki, cut = np.exp(p[:3])
        drive = kp * (error + ki * error_sum) + p[3] * (rate + ki * seen)
        drive = drive - (pace + ki * angle) / (1.0 + s / cut)
        return np.asarray(drive * np.exp(-s * p[4] * 1e-3))

    def alone(p: Array) -> Complex:
        return np.asarray(error * np.exp(-s * p[0] * 1e-3))

    def factor(shape: Complex) -> float:
        a, b = weight * shape, weight * torque
        return max(float(np.real(np.vdot(a, b)) / np.real(np.vdot(a, a))), 1e-12)

    def least(shape: Callable[[Array], Complex], start: Any, low: Any, high: Any) -> Any:
        def residual(p: Array) -> Array:
            made = shape(p)
            left = weight * (torque - factor(made) * made)
            return np.concatenate([left.real, left.imag])

        return least_squares(residual, start, bounds=(low, high), x_scale="jac", max_nfev=100)

    top = 2.0 * math.pi * highest_Hz
    low = (math.log(1e-3 * top), math.log(1e-6 * top), math.log(0.3 * top), -0.1, 0.0)
    high = (math.log(2.0 * top), math.log(2.0 * top), math.log(100.0 * top), 1.5, 20.0)
    starts = [
        (math.log(kp * top), math.log(ki * top), math.log(3.0 * top), ahead, 0.3)
        for kp in (0.01, 0.05, 0.25)
        for ki in (0.001, 0.05)
        for ahead in (0.0, 0.95)
    ]

    def weigh(shape: Callable[[Array], Complex], p: Array) -> None:
        """Weigh by the noise that a fit leaves, where the torque is clear of it."""
        nonlocal weight
        made = shape(p)
        noise = _smooth(np.abs(torque - factor(made) * made) ** 2)
        # What is not well above the noise would bias the gains: the angles are noisy as well.
        clear = np.abs(torque) ** 2 > _CLEAR * noise
        weight = clear / np.sqrt(noise) if np.any(clear) else 1.0 / np.sqrt(noise)

    def refined(shape: Callable[[Array], Complex], p: Array, low: Any, high: Any) -> Array:
        """Return parameters after fits with the noise that the fit before leaves."""
        for _ in range(_REWEIGHTED):
            weigh(shape, p)
            p = np.asarray(least(shape, p, low, high).x)
        return p

    weight = 1.0 / np.sqrt(_smooth(np.abs(torque) ** 2))
    best = min((least(cascade, p, low, high) for p in starts), key=lambda found: found.cost)
    single = refined(alone, np.array([0.3]), (0.0,), (20.0,))
    p = refined(cascade, best.x, low, high)
    # Both are judged where the torque is clear of what the cascade leaves.
    weigh(cascade, p)
    size = float(np.linalg.norm(torque[weight > 0.0]))
    misfits, factors = [], []
    for made in (alone(single), cascade(p)):
        factors.append(factor(made))
        left = (factors[-1] * made - torque)[weight > 0.0]
        misfits.append(float(np.linalg.norm(left)) / size)
    simple = misfits[0] <= _AS_GOOD * misfits[1]
    misfit, speed = (misfits[0], factors[0]) if simple else (misfits[1], factors[1])
    if misfit > _MISFIT:
        raise NoResponseError(
            "the torque is not that of a position and a speed controller in cascade, nor of a "
            f"position controller alone: {misfit:.0%} of it are left"
        )
    if simple:
        return Fitted(Gains(speed, delay_s=float(single[0]) * 1e-3), misfit, False)
    kp, ki, cut = (float(v) for v in np.exp(p[:3]))
    gains = Gains(kp, speed, ki, float(p[3]), float(p[4]) * 1e-3, cut / (2.0 * math.pi))
    alike = abs(gains.ahead - 1.0) < _ALIKE
    if alike:
        gains = _told_apart(gains, known)
    return Fitted(gains, misfit, alike)


def _told_apart(gains: Gains, known: Gains | None) -> Gains:
    """Return gains whose position gain and reset, of which only sum and product are seen, are in
    the order of the tool's; if these are near each other, where sum and product do not tell them
    apart, and agree, the tool's own.
    """
    kp, ki = gains.position, gains.reset
    if known is None or not known.reset:
        return dataclasses.replace(gains, position=max(kp, ki), reset=min(kp, ki))
    others = known.position, known.reset
    seen, stated = np.array([kp + ki, kp * ki]), np.array([sum(others), math.prod(others)])
    near = max(others) < _NEAR * min(others)
    if near and np.all(np.abs(seen / stated - 1.0) < _AGREE):
        return dataclasses.replace(gains, position=known.position, reset=known.reset)
    first, second = sorted((kp, ki), reverse=known.position >= known.reset)
    return dataclasses.replace(gains, position=first, reset=second)


def _bands(recording: Recording, highest_Hz: float, step_rad: float) -> tuple[Complex, ...]:
    """Return s, torque, error, its integral, rate of the command, command, speed and angle as
    spectra of a recording with a squared Hann window; each (m,).
    """
    c, bench, period = recording.channels, recording.bench, recording.period
    sent = c["command"] if not step_rad else np.rint(c["command"] / step_rad) * step_rad
    seen = np.concatenate([sent[:1], sent[:-1]])
    angle = c["motor_angle"] / bench.gear_ratio
    error = seen - angle
    total = np.cumsum(error) - 0.5 * error
    steps = [np.diff(values, prepend=values[0]) for values in (seen, angle)]
    torque = bench.ampere_torque * c["current"]
    signals = np.vstack([torque, error, period * (total - total.mean()), *steps, seen, angle])
    signals = signals - signals.mean(axis=1, keepdims=True)
    window = np.hanning(signals.shape[1]) ** 2
    spectrum = np.fft.rfft(signals * window)
    frequency = np.fft.rfftfreq(signals.shape[1], period)
    keep = (frequency > 6.0 * frequency[1]) & (frequency <= highest_Hz)
    s, spectrum = laplace(frequency[keep]), spectrum[:, keep]
    back = np.exp(-s * period)
    of_torque, of_error, total, rate, pace, of_seen, of_angle = spectrum
    slope = s / (1.0 - back)
    # A logged current is the mean over the period that ends at its sample.
    of_torque = of_torque / _mean(s, period)
    return s, of_torque, of_error, total, rate * slope, of_seen, pace * slope, of_angle


def _smooth(power: Array) -> Array:
    """Return the moving mean of a power, with a floor, (m,)."""
    share = np.full(_SMOOTH, 1.0 / _SMOOTH)
    held = np.pad(power, _SMOOTH // 2, mode="edge")
    found = np.convolve(held, share, "valid")[: len(power)]
    return np.asarray(np.maximum(found, 1e-12 * np.max(found)))


def _closed(s: Complex, gains: Gains, plant: Complex, fed: complex | Complex = 1.0) -> Complex:
    """Return the torque over the command, N m/rad, of a loop with these gains, (f,).

    ``fed``: angle that the controller uses over the angle of the plant.
    """
    drive: Any = (gains.speed or gains.position) * np.exp(-s * gains.delay_s)
    if not gains.speed:
        return np.asarray(drive / (1.0 + plant * fed * drive))
    drive = drive * (1.0 + gains.reset / s)
    back = fed * drive * (gains.position + s * gains.filtered(s))
    return np.asarray(drive * (gains.position + gains.ahead * s) / (1.0 + plant * back))


def modelled(frequency_Hz: Array, gains: Gains, plant: Complex, late_s: float = 0.0) -> Spectra:
    """Return the spectra that a plant would give with these gains, as one window.

    Args:
        frequency_Hz: Lines, (f,).
        gains: Gains of the controller.
        plant: Response from torque to angle, (f,).
        late_s: Age of the angle that the controller uses, s.
    """
    s = laplace(frequency_Hz)
    late = np.exp(-s * late_s)
    torque = _closed(s, gains, plant, late)
    angle = plant * torque * late
    signals = (angle, 1.0 - angle, s, s * angle, torque, plant * torque)
    each = (np.asarray(values, dtype=np.complex128)[np.newaxis] for values in signals)
    parts = dict(zip(_SIGNALS, each, strict=True))
    return Spectra(frequency_Hz, np.ones(len(s)), **parts)


def without_images(seen: Spectra, gains: Gains, period_s: float) -> Spectra:
    """Return spectra of a drive that moves linearly from target to target, without the images.

    Sampled targets contain each line with the factor sinc^2(f T), and images at f + m / T, which
    the samples of the angle take for the line. The images' part follows from the gains and a rigid
    joint, whose inertia and damping fit the measured plant.
    """
    inertia, damping = rigid_fit(seen)
    f, s = seen.frequency_Hz, seen.s
    back, mean = np.exp(-s * period_s), _mean(s, period_s)
    angle: Complex = np.zeros_like(back)
    torque: Complex = np.zeros_like(back)
    for turn in (-2, -1, 1, 2):
        at = f + turn / period_s
        plant = rigid_plant(at, inertia, damping)
        other = np.sinc(at * period_s) ** 2 * _closed(laplace(at), gains, plant)
        angle = angle + plant * other
        torque = torque + other * _mean(laplace(at), period_s)
    asked = np.sinc(f * period_s) ** 2 * back
    true = seen.angle - angle * back
    return dataclasses.replace(
        seen,
        angle=true,
        error=asked - true,
        rate=np.broadcast_to(s * asked, true.shape),
        speed=s * true,
        torque=seen.torque - torque * back / mean,
        motor=true,
    )


def _mean(s: Complex, period_s: float) -> Complex:
    """Return the response of the mean over the period that ends at a sample, (f,)."""
    return np.asarray((1.0 - np.exp(-s * period_s)) / (s * period_s))


def rigid_fit(seen: Spectra) -> tuple[float, float]:
    """Return inertia, kg m^2, and damping, N m s/rad, of the rigid joint that fits the plant."""
    inverse, s = 1.0 / seen.plant, seen.s
    design = np.column_stack([s**2 / inverse, s / inverse])
    real = np.vstack([design.real, design.imag])
    ones = np.concatenate([np.ones(len(s)), np.zeros(len(s))])
    inertia, damping = np.linalg.lstsq(real, ones, rcond=None)[0]
    return max(float(inertia), 1e-12), max(float(damping), 0.0)


def loops(seen: Spectra, gains: Gains) -> dict[str, OpenLoop]:
    """Return the open loops, mean of the windows, on the lines that are certain enough:
    ``position`` and, if its gain is known, ``speed``.
    """
    return _certain(seen, lambda one: _loops(one, gains))


def _certain(
    seen: Spectra, compute: Callable[[Spectra], Mapping[str, Complex]]
) -> dict[str, OpenLoop]:
    """Return responses of the mean on the lines with a relative standard error, by the jackknife
    over the windows, below :data:`WORST_NOISE` or :data:`WORST_NOISE_FAR`.
    """
    f, whole = seen.frequency_Hz, compute(seen.mean())
    if seen.windows < _LEAST_WINDOWS:
        return {name: OpenLoop(f, value) for name, value in whole.items()}
    parts = [compute(seen.mean(without=k)) for k in range(seen.windows)]
    found = {}
    for name, value in whole.items():
        each = np.array([part[name] for part in parts])
        size = np.abs(value)
        error = _jackknife(each) / size
        keep = error < np.where(size < FAR, WORST_NOISE_FAR, WORST_NOISE)
        if np.count_nonzero(keep) >= _LEAST_LINES:
            found[name] = OpenLoop(f[keep], value[keep], error[keep])
    return found


def _loops(one: Spectra, gains: Gains) -> dict[str, Complex]:
    angle, error, speed = one.angle[0], one.error[0], one.speed[0]
    if not gains.speed and not gains.ahead:
        return {"position": angle / error}
    asked = gains.position * error + gains.ahead * one.rate[0]
    found = {"position": gains.position * angle / asked}
    if gains.speed:
        speed = speed * gains.filtered(one.s)
        found["speed"] = speed / (asked - speed)
    return found


def _jackknife(parts: Complex | Array) -> Array:
    """Return the standard error of values from those without one window each, (f,) or scalar."""
    n, away = len(parts), parts - parts.mean(axis=0)
    return np.asarray(np.sqrt((n - 1) / n * np.sum(np.abs(away) ** 2, axis=0)))


def bent(small: Spectra, large: Spectra) -> Array:
    """Return by how many standard errors the plant differs between two amplitudes, (f,)."""
    found = []
    for one in (small, large):
        plants = np.array([one.mean(without=k).plant for k in range(one.windows)])
        found.append((one.mean().plant, _jackknife(plants)))
    (first, error), (second, other) = found
    return np.asarray(np.abs(first - second) / np.hypot(error, other))


class Estimate(NamedTuple):
    """A value with its interval; None where it is not inside the measured lines."""

    value: float | None
    low: float | None
    high: float | None


def with_intervals(
    seen: Spectra, compute: Callable[[Spectra], Mapping[str, float | None]]
) -> dict[str, Estimate]:
    """Return values with intervals by the jackknife over the windows (Efron and Stein, 1981).

    Args:
        seen: Spectra with at least two windows.
        compute: Values of the mean of some windows.
    """
    n, found = seen.windows, {}
    parts = [compute(seen.mean(without=k)) for k in range(n)]
    wide = float(student.ppf(0.5 + 0.5 * LEVEL, n - 1))
    for name, value in compute(seen).items():
        each = np.array([part[name] for part in parts], dtype=np.float64)  # None becomes NaN
        half = wide * float(_jackknife(each))
        if value is None or not math.isfinite(half):
            found[name] = Estimate(value, None, None)
        else:
            found[name] = Estimate(value, value - half, value + half)
    return found


def rigid_plant(frequency_Hz: Array, inertia: float, damping: float) -> Complex:
    """Return the response from torque to angle of a rigid joint, 1 / (s (J s + b)), (f,)."""
    s = laplace(frequency_Hz)
    return np.asarray(1.0 / (s * (inertia * s + damping)))


def with_plant(seen: Spectra, gains: Gains, plant: Complex) -> dict[str, OpenLoop]:
    """Return the open loops with another plant behind the same controllers; none where the program
    does not know the speed loop.
    """
    if gains.ahead and not gains.speed:
        return {}

    def compute(one: Spectra) -> dict[str, Complex]:
        found, ratio = _loops(one, gains), plant / one.plant
        if "speed" not in found:
            return {"position": found["position"] * ratio}
        return _cascade(one, gains, found["speed"] * ratio)

    return {name: OpenLoop(seen.frequency_Hz, v) for name, v in compute(seen.mean()).items()}


def _cascade(one: Spectra, gains: Gains, speed: Complex) -> dict[str, Complex]:
    """Return the loops of a cascade from its speed loop; Lp = Kp (Y/V) Lv / (1 + Lv)."""
    ratio = one.angle[0] / (one.speed[0] * gains.filtered(one.s))
    return {"position": gains.position * ratio * speed / (1.0 + speed), "speed": speed}


def with_gains(seen: Spectra, old: Gains, new: Gains) -> dict[str, OpenLoop]:
    """Return the open loops with other gains; feed-forward, filter and delay stay."""

    def compute(one: Spectra) -> dict[str, Complex]:
        found = _loops(one, old)
        if "speed" not in found:
            return {"position": found["position"] * (new.position / old.position)}
        factor = new.speed / old.speed * (one.s + new.reset) / (one.s + old.reset)
        return _cascade(one, new, found["speed"] * factor)

    return _certain(seen, compute)


@dataclass(frozen=True)
class Wanted:
    """Margins that each loop must have at least, and the crossover of the position loop, Hz, or
    None for the highest that the margins allow.
    """

    phase_deg: float = 60.0
    gain_dB: float = 8.0
    bandwidth_Hz: float | None = None


class Proposal(NamedTuple):
    """Proposed gains with the margins they give, and what stands in the way; empty if nothing."""

    gains: Gains
    margins: dict[str, Margins]
    problem: str


RESET_SHARE: Final = 0.2
"""Inverse reset time as a share of the crossover of the speed loop, rad/s: 11 deg of its phase."""
_FACTORS: Final = np.geomspace(8.0, 1.0 / 64.0, 181)
"""Factors on a gain that are tried, from the greatest on."""
_UNSEEN_DB: Final = 6.0
"""Gain of a resonance beyond the lines for which a higher gain of the speed loop leaves room."""
_INSIDE: Final = 0.7  # greatest crossover as a share of the highest line


def propose(seen: Spectra, old: Gains, wanted: Wanted) -> Proposal:
    """Return the greatest gains with which each loop has the wanted margins.

    The speed loop comes first, if its crossover is among the lines; otherwise its gains stay. A
    crossover is at most :data:`_INSIDE` of the highest line, so that what lies beyond the lines is
    not needed.

    Raises:
        NoResponseError: The position loop is not certain enough on its lines.
    """
    best, now = old, loops(seen, old)
    if "position" not in now:
        raise NoResponseError("the noise hides the position loop on nearly all lines")
    if "speed" in now and margins(now["speed"]).phase_deg is not None:
        best = _greatest(seen, old, wanted, _speed_candidates(seen, old), "speed") or old
    scaled = (dataclasses.replace(best, position=best.position * f) for f in _FACTORS)
    found, problem = _greatest(seen, old, wanted, scaled, "position"), ""
    if found is None:
        found, problem = best, "no gains among those tried have the wanted margins"
    elif wanted.bandwidth_Hz is not None:
        loop = with_gains(seen, old, found)["position"]
        highest = margins(loop).crossover_Hz
        assert highest is not None
        f, gain, _ = _dense(loop)
        if highest < wanted.bandwidth_Hz:
            problem = f"with these margins the position loop reaches {highest:.3g} Hz"
        elif wanted.bandwidth_Hz < f[0]:
            problem = f"the lowest certain line of the position loop is at {f[0]:.3g} Hz"
        else:
            # The gain of the position loop at its new crossover must be one.
            down = 10.0 ** (-float(np.interp(wanted.bandwidth_Hz, f, gain)) / 20.0)
            found = dataclasses.replace(found, position=found.position * down)
    known = {name: margins(loop) for name, loop in with_gains(seen, old, found).items()}
    lacking = [name for name, each in known.items() if _lacks(name, each, wanted)]
    if lacking and not problem:
        problem = f"with these gains the wanted margins are missing: {', '.join(lacking)}"
    return Proposal(found, known, problem)


def _lacks(name: str, found: Margins, wanted: Wanted) -> bool:
    """Whether a loop is not known to have the wanted margins; of a speed loop whose crossover is
    not among the lines only the gain margin is known.
    """
    if name == "speed" and found.phase_deg is None:
        return found.gain_dB is not None and found.gain_dB < wanted.gain_dB
    return not found.reach(wanted.phase_deg, wanted.gain_dB)


def _speed_candidates(seen: Spectra, old: Gains) -> Iterator[Gains]:
    """Yield gains of the speed loop, each with the reset that belongs to its crossover."""
    for factor in _FACTORS:
        speed = old.speed * factor
        new = dataclasses.replace(old, speed=speed)
        loop = with_gains(seen, old, new).get("speed")
        at = None if loop is None else margins(loop).crossover_Hz
        if at is not None:
            yield dataclasses.replace(new, reset=RESET_SHARE * 2.0 * math.pi * at)


def _greatest(
    seen: Spectra, old: Gains, wanted: Wanted, candidates: Iterator[Gains], name: str
) -> Gains | None:
    """Return the first candidate whose loop ``name`` has the wanted margins inside the lines."""
    for new in candidates:
        loop = with_gains(seen, old, new).get(name)
        if loop is None:
            continue
        found = margins(loop)
        at = found.crossover_Hz
        inside = at is not None and at <= _INSIDE * found.highest_Hz
        unseen = _UNSEEN_DB if name == "speed" and new.speed > old.speed else 0.0
        if inside and found.reach(wanted.phase_deg, wanted.gain_dB, unseen):
            return new
    return None


def step_response(loop: OpenLoop, time: Array) -> Array:
    """Return the unit step of the closed loop L / (1 + L) without feed-forward, (n,).

    y(t) = (2 / pi) int Re T(w) sin(w t) / w dw. Below the lines T is 1 at its limit; above them it
    falls with the square of the frequency.

    Args:
        loop: The open loop.
        time: Times after the step, s, (n,).
    """
    at, t = np.log(loop.frequency_Hz), loop.response / (1.0 + loop.response)
    low, high = at[0] - 7.0, at[-1] + 4.0
    grid = np.linspace(low, high, 8000)
    real = np.interp(grid, np.concatenate([[low], at]), np.concatenate([[1.0], t.real]))
    beyond = grid > at[-1]
    real[beyond] = t.real[-1] * np.exp(-2.0 * (grid[beyond] - at[-1]))
    omega = 2.0 * np.pi * np.exp(grid)
    waves = np.sin(np.outer(time, omega))
    return np.asarray(2.0 / np.pi * trapezoid(real * waves, grid, axis=1))


def describing_damping(level: float, speed: Array) -> Array:
    """Return the damping that Coulomb friction has around rest, 4 M / (pi v), N m s/rad (Gelb and
    Vander Velde, Multiple-Input Describing Functions, 1968); it vanishes while the joint moves on.

    Args:
        level: Coulomb friction, N m.
        speed: Amplitude of the speed, rad/s, any shape.
    """
    return np.asarray(4.0 * level / (np.pi * speed))
