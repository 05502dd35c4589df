"""Alignment of an inertial sensor with another log of the trial, in time and in attitude.

The module computes the clock offset, the mounting of the sensor, and the rotation between the world axes of
the two logs. A linear regression predicts the motion in one log from that in the other, up to slow drift. The
clock offset with the best prediction is used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from swimid.errors import NoTrustworthyResult
from swimid.inertial import record as recording
from swimid.inertial.record import BAND, Array, Poses, Record, Source, integral, resampled, turns_of
from swimid.logs.kinematics import angles

#: Minimum number of common samples for a comparison of two logs.
MIN_SAMPLES = 16
#: Maximum sample time of a compared log, as a fraction of the shortest period of drift. With a longer sample
#: time, motion cannot be distinguished from drift.
MAX_STEP = 0.2
#: Minimum overlap of the two logs in time, as a fraction of the shorter log.
MIN_OVERLAP = 0.3
#: Half-width of the grid of clock offsets that are tried, in periods of the signal; and number of offsets in
#: this grid.
SEARCH_PERIODS, N_OFFSETS = 0.6, 61
#: Maximum time between two correlated residuals of the regression, s. Residuals further apart are taken as
#: independent.
INDEPENDENT_S = 1.0
#: Minimum period of a motion that counts as drift, s: in integrated turn rates, and in accelerations
#: integrated twice.
SLOW_TURN_S, SLOW_PATH_S = 10.0, 2.0
#: Minimum fraction of the variance of one log that the other log explains if the two logs record the same
#: motion.
MIN_EXPLAINED = 0.2
#: Minimum fraction of the samples of the other log in which a coordinate is measured.
MIN_MEASURED = 0.1
#: Length of the windows over which the direction of gravity is averaged, s, and minimum length of an
#: incomplete window at the end of the log, s.
GRAVITY_S, MIN_GRAVITY_S = 1.0, 0.5
#: Minimum ratio of the smallest to the largest singular value of the correlation matrix between the rotations
#: in two logs. Below this ratio a mirrored axis cannot be detected.
MIN_SINGULAR = 0.02


@dataclass(frozen=True)
class Offset:
    """Clock offset: time to add to one log so that its clock agrees with that of the reference log."""

    value_s: float
    stderr_s: float
    #: Limits of the 95 % interval of the offset, s.
    low_s: float
    high_s: float
    #: Fraction of the variance of the other log's channels, without drift, that the reference log explains.
    explained: float = np.nan
    #: Regression coefficients of the other log's channels on the reference channels, shape (k, d).
    factors: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: Mounting of the sensor: rotation from body to sensor axes; None unless the other log has three angles.
    mount: Rotation | None = None
    #: Handedness of the axes, from the correlation between the rotations in the two logs: -1 if an axis is
    #: mirrored, 1 if none is, 0 if unknown.
    handed: float = 0.0


def clock_offset(
    time_s: Array, reference: Array, seen_time_s: Array, seen: Array, *, slow_s: float = 5.0
) -> Offset | None:
    """Estimate the offset between the clocks of two logs of the same motion.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    reference : ndarray, shape (n, k)
        Channels of the log with the higher sample rate and less noise, for instance integrated turn rates.
    seen_time_s : ndarray, shape (m,)
    seen : ndarray, shape (m, d)
        Channels of the other log: linear functions of the reference channels plus white noise and slow drift.
        NaN where missing.
    slow_s : float
        Period above which a motion is taken for drift, s. Drift is not compared.

    Returns
    -------
    Offset or None
        None if the records hardly overlap, or if one of them does not move.

    Notes
    -----
    The search starts at the maximum of the cross-correlation, summed over pairs of channels. From there the
    profile likelihood of the offset is maximised (Pawitan 2001, In All Likelihood, sec. 3.4). For each
    offset, the regression coefficients, the drift (cosines slower than ``slow_s``) and the noise of every
    channel are estimated. The standard error accounts for correlated residuals (Newey and West 1987,
    doi:10.2307/1913610).

    >>> t = np.arange(0.0, 20.0, 0.01)
    >>> wave = np.sin(6 * t) + 0.3 * np.sin(14 * t)
    >>> late = np.interp(t[::3] + 0.037, t, wave)
    >>> found = clock_offset(t, wave[:, None], t[::3], late[:, None] + 0.01 * np.cos(999 * t[::3, None] ** 2))
    >>> abs(found.value_s - 0.037) < 0.001
    True
    """
    known = np.isfinite(seen).all(axis=1)
    few = known.sum() < MIN_SAMPLES or np.ptp(time_s) == 0
    if few or np.median(np.diff(seen_time_s[known])) > MAX_STEP * slow_s:
        return None
    profile = _Profile(time_s, reference, seen_time_s[known], seen[known], slow_s)
    start = profile.correlate()
    if start is None:
        return None
    half = SEARCH_PERIODS * profile.period_s
    grid = np.linspace(start - half, start + half, N_OFFSETS)
    values = np.array([profile(shift) for shift in grid])
    if not np.isfinite(values).any():
        return None
    best, width = float(grid[np.nanargmax(values)]), float(grid[1] - grid[0])
    bounds = best - width, best + width
    found = optimize.minimize_scalar(lambda shift: -profile(shift), bounds=bounds, options={"xatol": 1e-6})
    return profile.offset(float(found.x))


class _Profile:
    """Log-likelihood of a clock offset, maximised over all other parameters of the regression."""

    def __init__(self, t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> None:
        self.t, self.reference = t, reference
        self.seen_t, self.seen, self.slow_s = seen_t, seen, slow_s
        fast = without_slow(seen_t, seen, slow_s)
        speed = np.gradient(fast, seen_t, axis=0)
        lead = int(np.argmax(np.std(fast, axis=0)))
        turning = float(np.std(speed[:, lead]))
        self.period_s = slow_s
        if turning:
            self.period_s = 2 * np.pi * float(np.std(fast[:, lead])) / turning

    def correlate(self) -> float | None:
        """Return the clock offset with the largest cross-correlation, summed over pairs of channels."""
        from scipy import signal

        step = float(np.median(np.diff(self.seen_t)))
        a_t, b_t = (np.arange(t[0], t[-1], step) for t in (self.t, self.seen_t))
        if min(len(a_t), len(b_t)) < MIN_SAMPLES:
            return None
        a = _normal(without_slow(a_t, resampled(a_t, self.t, self.reference), self.slow_s))
        b = _normal(without_slow(b_t, resampled(b_t, self.seen_t, self.seen), self.slow_s))
        ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
        overlap = signal.correlate(ones_a, ones_b)
        alike = np.zeros(len(overlap))
        for other in b.T:
            energy_b = np.maximum(signal.correlate(ones_a, other**2), 1e-3 * np.sum(other**2))
            for one in a.T:
                energy_a = np.maximum(signal.correlate(one**2, ones_b), 1e-3 * np.sum(one**2))
                alike += signal.correlate(one, other) ** 2 / (energy_a * energy_b) / b.shape[1]
        # Rank the offsets by the gain in log-likelihood instead of the correlation, so that a short overlap
        # does not win by chance.
        score = -0.5 * overlap * np.log(1 - np.clip(alike, 0.0, 0.999))
        shifts = signal.correlation_lags(len(a), len(b)) * step + a_t[0] - b_t[0]
        allowed = overlap >= MIN_OVERLAP * min(len(a), len(b))
        if not np.any(score[allowed] > 0):
            return None
        return float(shifts[allowed][np.argmax(score[allowed])])

    def fit(self, shift: float) -> tuple[Array, Array, Array, Array] | None:
        """Return the regression of the other log's channels on the reference channels at a clock offset.

        The result holds the reference channels, the channels of the other log, the regression coefficients,
        and the times in the overlap of the two logs.

        The result is None if the two logs overlap too little.
        """
        when = self.seen_t + shift
        inside = (when >= self.t[0]) & (when <= self.t[-1])
        if inside.sum() < MIN_SAMPLES:
            return None
        expected = resampled(when[inside], self.t, self.reference)
        both = without_slow(self.seen_t[inside], np.hstack([expected, self.seen[inside]]), self.slow_s)
        x, y = np.hsplit(both, [expected.shape[1]])
        factors = np.asarray(np.linalg.lstsq(x, y, rcond=1e-9)[0], dtype=float)
        return x, y, factors, self.seen_t[inside]

    def __call__(self, shift: float) -> float:
        fitted = self.fit(shift)
        if fitted is None:
            return -np.inf
        x, y, factors, _ = fitted
        variance = np.mean((y - x @ factors) ** 2, axis=0)
        # Scale the log-likelihood from the samples in the overlap to all samples, so that a smaller overlap
        # has no advantage.
        return float(-0.5 * len(self.seen_t) * np.sum(np.log(np.maximum(variance, 1e-30))))

    def offset(self, value: float) -> Offset | None:
        """Return the clock offset ``value`` with its standard error, s; None if the error is unknown."""
        tiny = 1e-3 * self.period_s
        here, after, before = (self.fit(shift) for shift in (value, value + tiny, value - tiny))
        if here is None or after is None or before is None:
            return None
        if not len(here[0]) == len(after[0]) == len(before[0]):
            return None
        x, y, factors, times = here
        residual = y - x @ factors
        slope = (after[0] @ factors - before[0] @ factors) / (2 * tiny)
        # Remove the component of the slope (derivative of the prediction by the offset) that the regression
        # coefficients can reproduce, because it has no information about the offset.
        slope = slope - x @ np.linalg.lstsq(x, slope, rcond=1e-9)[0]
        variance = np.maximum(np.mean(residual**2, axis=0), 1e-30)
        information = float(np.sum(slope**2 / variance))
        if information <= 0:
            return None
        score = np.sum(slope * residual / variance, axis=1)
        lags = min(int(INDEPENDENT_S / float(np.median(np.diff(times)))), len(score) // 4)
        total = float(score @ score)
        for lag in range(1, lags + 1):
            total += 2 * (1 - lag / (lags + 1)) * float(score[lag:] @ score[:-lag])
        stderr = float(np.sqrt(max(total / information, 1.0) / information))
        explained = 1 - float(np.sum(residual**2) / max(np.sum(y**2), 1e-30))
        return Offset(value, stderr, value - BAND * stderr, value + BAND * stderr, explained, factors)


def without_slow(t: Array, channels: Array, slow_s: float) -> Array:
    """Return channels, shape (n, k), without drift: cosines with periods above ``slow_s`` are subtracted."""
    duration = float(t[-1] - t[0])
    count = max(int(2 * duration / slow_s), 1) + 1
    basis = np.cos(np.pi * np.outer((t - t[0]) / max(duration, 1e-12), np.arange(count)))
    # Solve the normal equations, which is fast. They are accurate enough because the cosines are nearly
    # orthogonal.
    gram = basis.T @ basis
    gram[np.diag_indices(count)] *= 1 + 1e-10
    return channels - basis @ np.linalg.solve(gram, basis.T @ channels)


def _normal(channels: Array) -> Array:
    """Return the channels that are not constant, each divided by its standard deviation."""
    spread = np.std(channels, axis=0)
    return channels[:, spread > 0] / spread[spread > 0]


def align(record: Record, source: Source, poses: Poses, stated_s: float | None = None) -> list[Offset]:
    """Return up to two estimates of the clock offset: from the rotations and from the paths in the two logs.

    The estimates are in order of increasing standard error.

    Parameters
    ----------
    stated_s : float, optional
        Offset that the user states. It replaces the estimates.

    Raises
    ------
    NoTrustworthyResult
        When the two logs do not move together.
    """
    if stated_s is not None:
        return [_with_mount(record, poses, Offset(stated_s, 0.0, stated_s, stated_s))]
    found = [one for one in (_by_turns(record, source, poses), _by_path(record, source, poses)) if one]
    good = [one for one in found if one.explained >= MIN_EXPLAINED]
    if not good:
        best = max((one.explained for one in found), default=0.0)
        raise NoTrustworthyResult(
            f"the two logs do not move together (the inertial one explains {100 * best:.0f} % of the other); "
            "their clocks cannot be set",
            hint="are they of the same trial, with units and axes right? --clock-offset-s gives the offset",
        )
    return sorted(good, key=lambda one: one.stderr_s)


def _with_mount(record: Record, poses: Poses, offset: Offset) -> Offset:
    if not poses.measured.all():
        return offset
    mount, handed = _find_mount(record, replace(poses, time_s=poses.time_s + offset.value_s))
    return replace(offset, mount=mount, handed=handed)


def _by_turns(record: Record, source: Source, poses: Poses) -> Offset | None:
    rows = np.flatnonzero(poses.turned)
    if len(rows) < MIN_SAMPLES:
        return None
    seen, rate = poses.angles[rows][:, poses.measured], record.rate
    by_yaw = seen.shape[1] == 1 and bool(poses.measured[2])
    if poses.measured.all():
        seen = _summed_turns(poses.rotation[rows])
    elif by_yaw:
        rate = source.rotation.apply(record.rate)[:, 2:]
    turned = integral(record.time_s, rate - rate.mean(axis=0))
    offset = clock_offset(record.time_s, turned, poses.time_s[rows], seen, slow_s=SLOW_TURN_S)
    if offset is not None and by_yaw:
        return replace(offset, handed=float(np.sign(offset.factors[0, 0])))
    return offset and _with_mount(record, poses, offset)


def _by_path(record: Record, source: Source, poses: Poses) -> Offset | None:
    axes = np.isfinite(poses.position).mean(axis=0) > MIN_MEASURED
    if not axes.any():
        return None
    path, seen = _fast_path(record, source), poses.position[:, axes]
    return clock_offset(record.time_s, path, poses.time_s, seen, slow_s=SLOW_PATH_S)


def _summed_turns(rotation: Rotation) -> Array:
    """Return the sum of the rotation vectors from the first attitude up to each one, rad, shape (m, 3).

    The rotation vectors are those between successive attitudes, about body axes.
    """
    return np.vstack([np.zeros((1, 3)), np.cumsum(turns_of(rotation), axis=0)])


def _find_mount(record: Record, poses: Poses) -> tuple[Rotation, float]:
    """Return the mounting of the sensor (rotation from body to sensor axes) from another log with attitudes.

    The second returned value is the handedness: the sign of the determinant of the correlation between the
    rotations in the two logs.

    The mounting solves Wahba's problem (1965, doi:10.1137/1007077) by SVD (Markley 1988). The vectors are
    rotations about body axes and the direction of gravity. Gravity has the same weight as all rotations
    together, so that the mounting is also determined for a body that rotates about one axis only.
    """
    t = record.time_s
    rows = np.flatnonzero(poses.turned & (poses.time_s > t[0]) & (poses.time_s < t[-1]))
    rotation, when = poses.rotation[rows], poses.time_s[rows]
    body = without_slow(when, _summed_turns(rotation), SLOW_TURN_S)
    turned = integral(t, record.rate - record.rate.mean(axis=0))
    sensor = without_slow(when, resampled(when, t, turned), SLOW_TURN_S)
    # Average the direction of gravity over a window from each pose: in sensor axes from the integral of the
    # specific force, in body axes from the sum over poses.
    last = np.clip(np.searchsorted(when, when + GRAVITY_S), 0, len(when) - 1)
    span, count = when[last] - when, np.maximum(last - np.arange(len(when)), 1)
    long = span > MIN_GRAVITY_S
    force = resampled(when, t, integral(t, record.acceleration))
    up_sensor = (force[last] - force)[long] / span[long, None] / recording.GRAVITY_M_S2
    up = np.cumsum(rotation.inv().apply([0.0, 0.0, 1.0]), axis=0)
    up_body = (up[last] - up)[long] / count[long, None]
    cross = sensor.T @ body / max(np.sum(body**2), 1e-30)
    u, _, vt = np.linalg.svd(cross + up_sensor.T @ up_body / max(len(up_body), 1))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    singular, handed = np.linalg.svd(cross)[1], 0.0
    if singular[2] > MIN_SINGULAR * singular[0]:
        handed = float(np.sign(np.linalg.det(cross)))
    return Rotation.from_matrix(u @ proper @ vt), handed


def find_world_turn(record: Record, source: Source, poses: Poses, mount: Rotation) -> Rotation:
    """Return the rotation from the world axes of the attitude source to those of the other log.

    If the other log has a yaw, the rotation follows from its angles. Otherwise it is the rotation about the
    vertical that best aligns the path from the accelerations with the measured path.

    Parameters
    ----------
    poses : Poses
        Poses on the clock of the record.
    mount : Rotation
        Mounting from body to sensor.
    """
    inside = (poses.time_s >= record.time_s[0]) & (poses.time_s <= record.time_s[-1])
    if poses.measured[2]:
        rows = np.flatnonzero(poses.turned & inside)
        if not len(rows):
            return Rotation.identity()
        near = np.clip(np.searchsorted(record.time_s, poses.time_s[rows]), 0, len(record) - 1)
        body = source.rotation[near] * mount
        if poses.measured.all():
            return (poses.rotation[rows] * body.inv()).mean()
        turn = float(np.angle(np.mean(np.exp(1j * (poses.angles[rows, 2] - angles(body)[2])))))
    else:
        rows = np.flatnonzero(inside & np.isfinite(poses.position[:, :2]).all(axis=1))
        # Do not rotate if the other log lacks a horizontal coordinate, which is then constant.
        if len(rows) < MIN_SAMPLES or np.ptp(poses.position[rows, :2], axis=0).min() == 0:
            return Rotation.identity()
        t = poses.time_s[rows]
        path = resampled(t, record.time_s, _fast_path(record, source)[:, :2])
        both = without_slow(t, np.hstack([path, poses.position[rows, :2]]), SLOW_PATH_S)
        cross = both[:, :2].T @ both[:, 2:]
        turn = float(np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))
    return Rotation.from_rotvec([0.0, 0.0, turn])


def _fast_path(record: Record, source: Source) -> Array:
    """Return the path from accelerations along world axes (m), without drift slower than ``SLOW_PATH_S``."""
    force = source.rotation.apply(record.acceleration)
    path = integral(record.time_s, integral(record.time_s, force - force.mean(axis=0)))
    return without_slow(record.time_s, path, SLOW_PATH_S)
