"""How a sensor sits in a body that another log follows: clock, mounting, and the first pose.

One log says how the other should look at any instant, up to unknown factors and slow drift; the offset of the
clocks is where it looks most like it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.spatial.transform import Rotation

from swimid.errors import NoTrustworthyResult
from swimid.inertial.record import Array, Poses, Record, integral, resampled
from swimid.inertial.setup import BAND, Source
from swimid.logs.rotation import angles


@dataclass(frozen=True)
class Offset:
    """What to add to the times of the seen log to have them on the reference's clock."""

    #: Estimate, standard error and 95 % interval.
    value_s: float
    stderr_s: float
    low_s: float
    high_s: float
    #: Share of the variance of the seen channels, slow parts removed, that the reference explains.
    explained: float
    #: Shape (k, d). What the reference channels were multiplied with.
    factors: Array

    @property
    def excludes_zero(self) -> bool:
        """Whether clocks that agree lie outside the interval."""
        return not self.low_s <= 0.0 <= self.high_s


def clock_offset(
    time_s: Array, reference: Array, seen_time_s: Array, seen: Array, *, slow_s: float = 5.0
) -> Offset | None:
    """Estimate the offset between two clocks.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    reference : ndarray, shape (n, k)
        Channels of the faster, smoother log (integrated turn rates, say).
    seen_time_s : ndarray, shape (m,)
    seen : ndarray, shape (m, d)
        Channels of the other that are linear in the reference's, plus white noise and slow drift;
        NaN where missing.
    slow_s : float
        Slower than this is drift, and left out of the comparison.

    Returns
    -------
    Offset or None
        None when the records hardly overlap, or nothing moves in both.

    Notes
    -----
    The start is the peak of the cross-correlation, summed over pairs of channels. From there the
    profile likelihood (Pawitan 2001, In All Likelihood, sec. 3.4) of the offset is maximised: factors,
    drift (cosines slower than ``slow_s``) and the noise of every channel are solved for at each offset.
    The standard error contains what correlated residuals add to the variance of the score (Newey and West
    1987, doi:10.2307/1913610).

    >>> t = np.arange(0.0, 20.0, 0.01)
    >>> wave = np.sin(6 * t) + 0.3 * np.sin(14 * t)
    >>> late = np.interp(t[::3] + 0.037, t, wave)
    >>> found = clock_offset(t, wave[:, None], t[::3], late[:, None] + 0.01 * np.cos(999 * t[::3, None] ** 2))
    >>> abs(found.value_s - 0.037) < 0.001
    True
    """
    there = np.isfinite(seen).all(axis=1)
    if there.sum() < 16 or np.ptp(time_s) == 0:
        return None
    if np.median(np.diff(seen_time_s[there])) > 0.2 * slow_s:
        return None  # too sparse to show anything faster than drift
    start = _correlate(time_s, reference, seen_time_s[there], seen[there], slow_s)
    if start is None:
        return None
    profile = _Profile(time_s, reference, seen_time_s[there], seen[there], slow_s)
    # The likelihood is searched this far about the start, in periods of the signal.
    half = 0.6 * profile.period_s
    grid = np.linspace(start - half, start + half, 61)
    values = np.array([profile(shift) for shift in grid])
    if not np.isfinite(values).any():
        return None
    best = float(grid[np.nanargmax(values)])
    width = float(grid[1] - grid[0])
    found = optimize.minimize_scalar(
        lambda shift: -profile(shift),
        bounds=(best - width, best + width),
        method="bounded",
        options={"xatol": 1e-6},
    )
    value = float(found.x)
    stderr = profile.spread(value)
    if not np.isfinite(stderr):
        return None
    fitted = profile.fit(value)
    assert fitted is not None
    x, y, factors, _ = fitted
    explained = 1 - float(np.sum((y - x @ factors) ** 2) / max(np.sum(y**2), 1e-30))
    return Offset(value, stderr, value - BAND * stderr, value + BAND * stderr, explained, factors)


class _Profile:
    """Log likelihood of an offset, everything else solved for."""

    def __init__(self, t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> None:
        self.t, self.reference = t, reference
        self.seen_t, self.seen, self.slow_s = seen_t, seen, slow_s
        fast = without_slow(seen_t, seen, slow_s)
        speed = np.gradient(fast, seen_t, axis=0)
        lead = int(np.argmax(np.std(fast, axis=0)))
        turning = float(np.std(speed[:, lead]))
        self.period_s = 2 * np.pi * float(np.std(fast[:, lead])) / turning if turning else slow_s

    def fit(self, shift: float) -> tuple[Array, Array, Array, NDArray[np.intp]] | None:
        when = self.seen_t + shift
        inside = (when >= self.t[0]) & (when <= self.t[-1])
        if inside.sum() < 16:
            return None
        expected = resampled(when[inside], self.t, self.reference)
        both = without_slow(self.seen_t[inside], np.hstack([expected, self.seen[inside]]), self.slow_s)
        k = expected.shape[1]
        factors = np.asarray(np.linalg.lstsq(both[:, :k], both[:, k:], rcond=1e-9)[0], dtype=float)
        return both[:, :k], both[:, k:], factors, np.flatnonzero(inside)

    def __call__(self, shift: float) -> float:
        fitted = self.fit(shift)
        if fitted is None:
            return -np.inf
        x, y, factors, _ = fitted
        left = np.mean((y - x @ factors) ** 2, axis=0)
        # per sample, so that a smaller overlap is no advantage
        return float(-0.5 * len(self.seen_t) * np.sum(np.log(np.maximum(left, 1e-30))))

    def spread(self, shift: float) -> float:
        """Standard error, widened by what correlated residuals add to the variance of the score."""
        tiny = 1e-3 * self.period_s
        here, after, before = self.fit(shift), self.fit(shift + tiny), self.fit(shift - tiny)
        if here is None or after is None or before is None or len(after[3]) != len(before[3]):
            return np.nan
        x, y, factors, rows = here
        residual = y - x @ factors
        slope = (after[0] @ factors - before[0] @ factors) / (2 * tiny)
        if len(slope) != len(residual):
            return np.nan
        # what the other unknowns can imitate tells nothing of the offset
        slope = slope - x @ np.linalg.lstsq(x, slope, rcond=1e-9)[0]
        variance = np.maximum(np.mean(residual**2, axis=0), 1e-30)
        information = float(np.sum(slope**2 / variance))
        score = np.sum(slope * residual / variance, axis=1)
        step = float(np.median(np.diff(self.seen_t[rows])))
        # Residuals this many seconds apart are taken as independent.
        lags = min(int(1.0 / step), len(score) // 4)
        total = float(score @ score)
        for lag in range(1, lags + 1):
            total += 2 * (1 - lag / (lags + 1)) * float(score[lag:] @ score[:-lag])
        if information <= 0:
            return np.nan
        return float(np.sqrt(max(total / information, 1.0) / information))


def without_slow(t: Array, channels: Array, slow_s: float) -> Array:
    """Channels less their parts slower than ``slow_s``, by cosines."""
    duration = float(t[-1] - t[0])
    count = max(int(2 * duration / slow_s), 1) + 1
    basis = np.cos(np.pi * np.outer((t - t[0]) / max(duration, 1e-12), np.arange(count)))
    gram = basis.T @ basis  # cosines are all but orthogonal: the normal equations do, and are fast
    gram[np.diag_indices(count)] *= 1 + 1e-10
    return channels - basis @ np.linalg.solve(gram, basis.T @ channels)


def _correlate(t: Array, reference: Array, seen_t: Array, seen: Array, slow_s: float) -> float | None:
    """Offset of the largest cross-correlation, summed over pairs of channels."""
    from scipy import signal

    step = float(np.median(np.diff(seen_t)))
    a_t, b_t = np.arange(t[0], t[-1], step), np.arange(seen_t[0], seen_t[-1], step)
    if len(a_t) < 16 or len(b_t) < 16:
        return None
    a = _normal(without_slow(a_t, resampled(a_t, t, reference), slow_s))
    b = _normal(without_slow(b_t, resampled(b_t, seen_t, seen), slow_s))
    lags = signal.correlation_lags(len(a), len(b))
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))
    overlap = signal.correlate(ones_a, ones_b)
    alike = np.zeros(len(lags))
    for other in b.T:
        energy_b = np.maximum(signal.correlate(ones_a, other**2), 1e-3 * np.sum(other**2))
        for one in a.T:
            energy_a = np.maximum(signal.correlate(one**2, ones_b), 1e-3 * np.sum(one**2))
            alike += signal.correlate(one, other) ** 2 / (energy_a * energy_b) / b.shape[1]
    # the likelihood's gain: a short overlap that looks alike by chance does not win
    score = -0.5 * overlap * np.log(1 - np.clip(alike, 0.0, 0.999))
    shifts = lags * step + a_t[0] - b_t[0]
    # Least share of the shorter record that must overlap.
    allowed = overlap >= 0.3 * min(len(a), len(b))
    if not allowed.any() or not np.any(score[allowed] > 0):
        return None
    return float(shifts[allowed][np.argmax(score[allowed])])


def _normal(channels: Array) -> Array:
    spread = np.std(channels, axis=0)
    return channels[:, spread > 0] / spread[spread > 0]


#: Slower than this is drift, s: of an integrated gyroscope, of a twice integrated accelerometer.
SLOW_TURN_S, SLOW_WAY_S = 10.0, 2.0
#: A reference that explains less of what was seen is of another trial.
LEAST_EXPLAINED = 0.2


@dataclass(frozen=True)
class Fit:
    """A sensor's rates against a body's."""

    #: To add to the other log's times.
    offset: Offset
    #: "turn rates", "yaw", "pitch" or "path".
    by: str
    #: Body to sensor, where three angles tell it.
    mount: Rotation | None = None
    #: Determinant of the best matrix between rates: -1 where an axis is mirrored, 0 where they cannot tell.
    handed: float = 0.0


def fit_clocks(record: Record, source: Source, poses: Poses) -> list[Fit]:
    """Clock offsets by turns and by the path, the surest first, and what turns tell of the mounting.

    Raises
    ------
    NoTrustworthyResult
        When nothing in the two logs moves together.
    """
    fits = [fit for fit in (_by_turns(record, source, poses), _by_path(record, source, poses)) if fit]
    good = [fit for fit in fits if fit.offset.explained >= LEAST_EXPLAINED]
    if not good:
        best = max((fit.offset.explained for fit in fits), default=0.0)
        raise NoTrustworthyResult(
            f"the two logs do not move together (the inertial one explains {100 * best:.0f} % of the other); "
            "their clocks cannot be set",
            hint="are they of the same trial, with units and axes right? --clock-offset-s gives the offset",
        )
    return sorted(good, key=lambda fit: fit.offset.stderr_s)


def fit_at(record: Record, poses: Poses, offset_s: float) -> Fit:
    """The same for a clock offset that is given."""
    return _fitted(
        record, poses, Offset(offset_s, 0.0, offset_s, offset_s, np.nan, np.zeros((0, 0))), "given"
    )


def _fitted(record: Record, poses: Poses, offset: Offset, by: str) -> Fit:
    """What an offset tells of the mounting, where there are three angles."""
    if not poses.full:
        return Fit(offset, by)
    mount, handed = _mount(record, replace(poses, time_s=poses.time_s + offset.value_s))
    return Fit(offset, by, mount, handed)


def _by_turns(record: Record, source: Source, poses: Poses) -> Fit | None:
    rows = np.flatnonzero(poses.turned)
    if len(rows) < 16:
        return None
    if poses.full:
        name, rate, seen = "turn rates", record.rate, _wound(poses.rotation[rows])
    else:
        world = source.rotation.apply(record.rate)
        name, rate = ("yaw", world[:, 2:]) if poses.measured[2] else ("pitch", record.rate)
        seen = poses.angles[rows][:, poses.measured]
    turned = integral(record.time_s, rate - rate.mean(axis=0))
    offset = clock_offset(record.time_s, turned, poses.time_s[rows], seen, slow_s=SLOW_TURN_S)
    if offset is None or poses.full:
        return None if offset is None else _fitted(record, poses, offset, name)
    return Fit(offset, name, None, float(np.sign(offset.factors[0, 0])) if poses.measured[2] else 0.0)


def _by_path(record: Record, source: Source, poses: Poses) -> Fit | None:
    axes = np.isfinite(poses.position).mean(axis=0) > 0.1
    if not axes.any():
        return None
    way, seen = _way(record, source), poses.position[:, axes]
    offset = clock_offset(record.time_s, way, poses.time_s, seen, slow_s=SLOW_WAY_S)
    return None if offset is None else Fit(offset, "path")


def _wound(rotation: Rotation) -> Array:
    """The body's turns added up, shape (m, 3): increments about body axes."""
    steps = (rotation[:-1].inv() * rotation[1:]).as_rotvec()
    return np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _mount(record: Record, poses: Poses) -> tuple[Rotation, float]:
    """Body to sensor from increments of turn and from the direction of gravity; handedness.

    Wahba's problem (1965, doi:10.1137/1007077), solved by SVD (Markley 1988). Gravity weighs as much as
    all turns, so that a body that turns about one axis only is placed as well.
    """
    rows = np.flatnonzero(
        poses.turned & (poses.time_s > record.time_s[0]) & (poses.time_s < record.time_s[-1])
    )
    rotation, t = poses.rotation[rows], poses.time_s[rows]
    body = without_slow(t, _wound(rotation), SLOW_TURN_S)
    turned = integral(record.time_s, record.rate - record.rate.mean(axis=0))
    sensor = without_slow(t, resampled(t, record.time_s, turned), SLOW_TURN_S)
    up_body = rotation.inv().apply([0.0, 0.0, 1.0])
    force = integral(record.time_s, record.acceleration)
    mean_force = resampled(t, record.time_s, force)
    window = np.clip(np.searchsorted(t, t + 1.0), 0, len(t) - 1)
    span = np.maximum(t[window] - t, 1e-9)[:, None]
    long = (t[window] - t) > 0.5
    up_sensor = ((mean_force[window] - mean_force) / span)[long] / 9.81
    joint = np.cumsum(up_body, axis=0)
    count = np.maximum(window - np.arange(len(t)), 1)[:, None]
    up_body = ((joint[window] - joint) / count)[long]
    cross = sensor.T @ body / max(np.sum(body**2), 1e-30)
    with_gravity = cross + (up_sensor.T @ up_body / max(len(up_body), 1) if long.any() else 0.0)
    u, _, vt = np.linalg.svd(with_gravity)
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    free = np.linalg.svd(cross)[1]
    handed = float(np.sign(np.linalg.det(cross))) if free[2] > 0.02 * free[0] else 0.0
    return Rotation.from_matrix(u @ proper @ vt), handed


def world_turn(record: Record, source: Source, poses: Poses, mount: Rotation) -> Rotation:
    """The turn from the source's world to that of the other log; poses on the record's clock.

    By its angles where there is a yaw, else the turn about the vertical that lays the reckoned path on the
    seen one.
    """
    inside = (poses.time_s >= record.time_s[0]) & (poses.time_s <= record.time_s[-1])
    if poses.measured[2]:
        rows = np.flatnonzero(poses.turned & inside)
        near = np.clip(np.searchsorted(record.time_s, poses.time_s[rows]), 0, len(record) - 1)
        if not len(rows):
            return Rotation.identity()
        body = source.rotation[near] * mount
        if poses.full:
            return (poses.rotation[rows] * body.inv()).mean()
        turn = float(np.angle(np.mean(np.exp(1j * (poses.angles[rows, 2] - angles(body)[2])))))
    else:
        rows = np.flatnonzero(inside & np.isfinite(poses.position[:, :2]).all(axis=1))
        if len(rows) < 16:
            return Rotation.identity()
        t = poses.time_s[rows]
        reckoned = resampled(t, record.time_s, _way(record, source)[:, :2])
        both = without_slow(t, np.hstack([reckoned, poses.position[rows, :2]]), SLOW_WAY_S)
        cross = both[:, :2].T @ both[:, 2:]
        turn = float(np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))
    return Rotation.from_rotvec([0.0, 0.0, turn])


def _way(record: Record, source: Source) -> Array:
    """Accelerations integrated twice, world axes, without what is slower than :data:`SLOW_WAY_S`."""
    force = source.rotation.apply(record.acceleration)
    force = force - force.mean(axis=0)
    way = integral(record.time_s, integral(record.time_s, force))
    return without_slow(record.time_s, way, SLOW_WAY_S)
