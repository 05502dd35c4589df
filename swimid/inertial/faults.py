"""Faults of a recording: :data:`FAULTS` contains the test of each fault and its messages.

The tests run in the order of :data:`FAULTS`. Faults of single samples come first. Faults of units and axes
follow: they show as contradictions between gravity, turn rates and quaternions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp

from swimid.errors import InputError
from swimid.inertial.record import (
    CHANNELS,
    GRAVITY_M_S2,
    Array,
    Finding,
    Flags,
    Record,
    integrated_attitude,
    resampled,
    rotations,
    turns_of,
)
from swimid.inertial.setup import DEG, MAX_REST_ACCELERATION
from swimid.logs import sampling
from swimid.logs.log import runs
from swimid.logs.mapping import in_order
from swimid.logs.rotation import rearranged


@dataclass(frozen=True)
class Found:
    """Result of a test: message to use, values to insert in it, and repaired record."""

    #: Name of the message: "handled", "noted", "refuted" or "refused". It is empty for a repair without a
    #: message.
    words: str
    record: Record | None = None
    #: Number of affected samples; 0 if the fault does not concern single samples.
    count: int = 0
    #: Name of the column that made the record unusable.
    column: str = ""
    values: dict[str, Any] = field(default_factory=dict)


Test = Callable[[Record], Found | None]


@dataclass(frozen=True)
class Fault:
    """Fault of a recording, with a message for each result of its test (see :class:`Finding`)."""

    test: Test
    handled: str = ""
    noted: str = ""
    refuted: str = ""
    #: Message for a record that cannot be repaired, and hint for the user.
    refused: str = ""
    hint: str = ""


def repair(record: Record) -> tuple[Record, list[Finding]]:
    """Return the record with every fault repaired, and the faults that were found.

    Raises
    ------
    InputError
        For the first fault that cannot be repaired.
    """
    findings: list[Finding] = []
    for name, fault in FAULTS.items():
        found = fault.test(record)
        if found is None:
            continue
        record = found.record or record
        if not found.words:
            continue
        text = getattr(fault, found.words).format(**found.values, count=found.count)
        if found.words == "refused":
            raise InputError(text, file=record.name, column=found.column, hint=fault.hint or None)
        findings.append(Finding(name, found.words, text, found.count))  # type: ignore[arg-type]
    return record, findings


# ---------------------------------------------------------------- samples

#: Maximum fraction of samples without a time, and of missing values in a channel.
MAX_MISSING = 0.5
#: Maximum magnitude of a sensor reading, in any unit. Larger values are not measurements.
MAX_READING = 1e5
#: Maximum distance of a reading from the median of the others, in units of their range, and number of samples
#: in the running median.
WILD_RANGES, WINDOW = 30.0, 7
#: Minimum length of a stuck period, s and samples, and maximum fraction of the other samples with the same
#: value.
STUCK_S, STUCK_SAMPLES, STUCK_SHARE = 0.5, 25, 0.01
#: Maximum fraction of stuck samples in a channel.
MAX_STUCK = 0.3
#: Minimum and maximum fraction of samples that repeat the previous one. A smaller fraction occurs by chance;
#: a larger one means a recording without motion.
MIN_REPEATED, MAX_REPEATED = 0.005, 0.9
#: Maximum fraction of clipped samples in a channel.
MAX_CLIPPED = 0.1
#: Minimum time step that contains lost samples, in median sample times, and maximum time step over which the
#: motion can be estimated, s.
LONG_STEP, MAX_STEP_S = 1.6, 2.0
#: Minimum root-mean-square jitter of the time stamps for a warning, in sample times.
MIN_JITTER = 0.05
#: Maximum deviation of the norm of a quaternion from 1.
QUATERNION_TOL = 0.05


def find_clock_reset(record: Record) -> Found | None:
    """Find a clock that jumps back and continues from the earlier time."""
    row = in_order(record.time_s, {}).reset_row
    if row is None:
        return None
    return Found("refused", column="t_s", values={"time_s": record.time_s[row], "sample": row + 1})


def find_stamps(record: Record) -> Found | None:
    """Find time stamps that repeat or are out of order.

    The repaired record is in order of time and has the first sample of each repeated time stamp.
    """
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    gone = order.untimed + order.repeated + order.clashing
    values = {"gone": gone, "late": order.late, "total": len(record)}
    if gone > MAX_MISSING * len(record):
        return Found("refused", column="t_s", values=values)
    if not order.changed:
        return None
    return Found("handled", record.take(order.index), gone + order.late, values=values)


def bridge(record: Record, bad: Flags) -> Record:
    """Return the record with bad samples, shape (n, 6), interpolated linearly and flagged as filled."""
    values = record.channels
    for column, hole in zip(values.T, bad.T, strict=True):
        if hole.any() and not hole.all():
            column[hole] = np.interp(record.time_s[hole], record.time_s[~hole], column[~hole])
    acceleration, rate = (half.any(axis=1) for half in np.hsplit(bad, 2))
    return replace(
        record.with_channels(values),
        filled_acceleration=record.filled_acceleration | acceleration,
        filled_rate=record.filled_rate | rate,
    )


def find_samples(is_bad: Callable[[Record], Flags], max_share: float) -> Test:
    """Return a test that interpolates bad samples and refuses a channel with too many of them.

    Parameters
    ----------
    is_bad : callable
        Returns flags of the bad samples of a record, shape (n, 6).
    max_share : float
        Maximum fraction of bad samples in a channel.
    """

    def test(record: Record) -> Found | None:
        bad = is_bad(record)
        share = bad.mean(axis=0)
        worst = int(np.argmax(share))
        if share[worst] > max_share:
            size = np.max(np.abs(np.nan_to_num(record.channels[bad[:, worst], worst])))
            values = {"percent": 100 * share[worst], "largest": size}
            return Found("refused", column=CHANNELS[worst], values=values)
        if not bad.any():
            return None
        names = [name for name, flags in zip(CHANNELS, bad.T, strict=True) if flags.any()]
        size = np.max(np.abs(np.nan_to_num(record.channels[bad])))
        values = {"channels": ", ".join(names), "largest": size}
        return Found("handled", bridge(record, bad), int(bad.any(axis=1).sum()), values=values)

    return test


def _by_channel(is_bad: Callable[[Record, Array], Flags]) -> Callable[[Record], Flags]:
    return lambda record: np.column_stack([is_bad(record, values) for values in record.channels.T])


def is_wild(_: Record, values: Array) -> Flags:
    """Return flags of readings that no motion causes: glitches, and codes that mean "no sample"."""
    flags = np.abs(np.nan_to_num(values)) > MAX_READING
    known = np.flatnonzero(np.isfinite(values) & ~flags)
    if len(known) < 2 * WINDOW:
        return flags
    # a code is a single value far from all others, however often it occurs
    for extreme in (float(values[known].max()), float(values[known].min())):
        others = values[known][values[known] != extreme]
        if len(others) > WINDOW and abs(extreme - np.median(others)) > WILD_RANGES * np.ptp(others) > 0:
            flags |= values == extreme
    known = np.flatnonzero(np.isfinite(values) & ~flags)
    calm = median_filter(values[known], size=WINDOW, mode="nearest")
    span = float(np.ptp(calm))
    if span > 0:
        flags[known] |= np.abs(values[known] - calm) > WILD_RANGES * span
    return flags


def is_stuck(record: Record, values: Array) -> Flags:
    """Return flags of samples in long runs of one value.

    A value that also occurs often outside the run is excluded: it results from coarse rounding.
    """
    if np.ptp(values) == 0:
        return np.ones(len(values), dtype=bool)
    flags = np.zeros(len(values), dtype=bool)
    least = max(round(STUCK_S / record.step_s), STUCK_SAMPLES)
    for first, last in runs(np.concatenate(([False], np.diff(values) == 0))):
        if last - first < least:
            continue
        inside = np.zeros(len(values), dtype=bool)
        inside[max(first - 1, 0) : last] = True
        if np.mean(values[~inside] == values[first]) < STUCK_SHARE:
            flags |= inside
    return flags


def is_repeated(record: Record) -> Flags:
    """Return flags of samples that repeat the previous one because the logger is faster than the sensor."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    if not MIN_REPEATED <= np.mean(same) <= MAX_REPEATED:
        same[:] = False
    return np.repeat(same[:, None], 6, axis=1)


def is_clipped(_: Record, values: Array) -> Flags:
    """Return flags of samples that are clipped at the maximum or minimum of a channel.

    Without clipping, values become rare towards the maximum. A clipped channel stays at its maximum for two
    samples or more, at least three times, and has the maximum more than twice as often as values within 1 %
    of the range below it. The same holds for the minimum.
    """
    flags = np.zeros(len(values), dtype=bool)
    for extreme in (float(np.max(values)), float(np.min(values))):
        at = values == extreme
        holds = [(first, last) for first, last in runs(at) if last - first >= 2]
        below = np.abs(values[~at] - extreme)
        near = below <= max(0.01 * np.ptp(values), float(np.min(below)))
        if len(holds) >= 3 and at.sum() > 2.0 * near.sum():
            flags |= at
    return flags


def find_dead_magnetometer(record: Record) -> Found | None:
    """Find a magnetometer without measurements, and remove its readings.

    If the magnetometer has a lower sample rate than the log, its readings are interpolated.
    """
    if record.magnetic is None:
        return None
    rows = _measured_rows(record, record.magnetic)
    if len(rows) == 0 or np.any(np.ptp(record.magnetic[rows], axis=0) == 0):
        return Found("handled", replace(record, magnetic=None))
    slow = resampled(record.time_s, record.time_s[rows], record.magnetic[rows])
    return Found("", replace(record, magnetic=slow))


def find_dead_quaternion(record: Record) -> Found | None:
    """Find quaternions that are not a measured attitude, and remove them.

    Quaternions with a lower sample rate than the log are interpolated.
    """
    q, t = record.quaternion, record.time_s
    if q is None:
        return None
    rows = _measured_rows(record, q)
    wrong = np.abs(np.linalg.norm(q[rows], axis=1) - 1) > QUATERNION_TOL
    if len(rows) == 0 or np.ptp(q[rows], axis=0).max() == 0 or wrong.any():
        return Found("handled", replace(record, quaternion=None))
    if len(rows) == len(record):
        return None
    between = Slerp(t[rows], rotations(q[rows]))(np.clip(t, t[rows[0]], t[rows[-1]]))
    return Found("", replace(record, quaternion=between.as_quat(scalar_first=True)))


def _measured_rows(record: Record, values: Array) -> np.ndarray:
    """Return the indices of rows with values; none if a gap is too long for interpolation."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    times = np.concatenate([record.time_s[:1], record.time_s[rows], record.time_s[-1:]])
    if len(rows) < 2 or np.max(np.diff(times)) > max(STUCK_S, 2 * record.step_s):
        return rows[:0]
    return rows


def find_dropped(record: Record) -> Found | None:
    """Find missing samples. The integrals span the gaps, and the noise model accounts for them."""
    steps = np.diff(record.time_s)
    wide, row = steps > LONG_STEP * record.step_s, int(np.argmax(steps))
    if not wide.any():
        return None
    values = {"places": int(wide.sum()), "longest": steps[row], "time_s": record.time_s[row]}
    if steps[row] > MAX_STEP_S:
        return Found("refused", column="t_s", values=values)
    return Found("handled", count=int(np.sum(np.round(steps[wide] / record.step_s) - 1)), values=values)


def find_jitter(record: Record) -> Found | None:
    """Find uneven time steps. All integrals use the time stamps of the samples."""
    steps = np.diff(record.time_s)
    single = steps[steps < LONG_STEP * record.step_s]
    jitter = sampling.rate(record.time_s).jitter
    if jitter:
        jitter = max(jitter, float(np.std(single)) / record.step_s)
    if jitter < MIN_JITTER:
        return None
    return Found("handled", values={"percent": 100 * jitter, "step_ms": 1e3 * record.step_s})


# ---------------------------------------------------------------- units and axes

#: Maximum relative difference between the specific force at rest and g. Scale errors are some percent, and
#: gliding adds some.
GRAVITY_RTOL = 0.12
#: Minimum magnitude of a specific force that includes gravity, in g.
MIN_GRAVITY = 0.5
#: Units of acceleration, in m/s^2. The nearest unit is chosen; mg and cm/s2 differ by 2 %.
UNITS = {"g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}
#: Length of the windows in which the specific force is analysed, s, and maximum number of windows for turn
#: rates.
WINDOW_S, MAX_WINDOWS = 0.5, 200
#: Length of the blocks over which the specific force is averaged, s, and distance in blocks between compared
#: averages. Over about a second, rotation changes the average more than acceleration does.
BLOCK_S, BLOCKS = 0.3, 3
#: Minimum number of compared averages, and minimum root-mean-square rotation of gravity between them, rad.
MIN_BLOCKS, MIN_TURN = 16, 0.02
#: Maximum ratio between the residual of the chosen unit or convention and that of the alternative.
CLEAR_RATIO = 0.5
#: Minimum correlation coefficient between the rotation of gravity and the turn rates.
MIN_CORRELATION = 0.5
#: Criteria for rearranging the axes of the gyroscope. BETTER and DECIDED are the maximum residuals of the
#: best arrangement, divided by those of the logged and of the second-best arrangement. EXPLAINED is the
#: maximum unexplained fraction of the rotation of gravity. The axes stay as logged if their unexplained
#: fraction is below EXPLAINED: this residual can be acceleration (in a yawing swimmer ``u r`` looks like
#: roll).
BETTER, DECIDED, EXPLAINED = 0.5, 0.8, 0.5
#: Threshold of the turn rate (99th percentile), rad/s. Faster turn rates in an unconfirmed unit cause a
#: warning.
FAST_RAD_S = 12.0
#: Interval between compared quaternions, s, and minimum root-mean-square rotation between them, rad.
STRIDE_S, MIN_STEP_RAD = 0.1, 1e-3


def _compare_gravity(record: Record) -> tuple[float, str]:
    """Return the magnitude of the specific force, in the logged unit, and the name of the actual unit.

    The name is "m/s2", a key of :data:`UNITS`, or empty if no unit fits. The stated unit is assumed unless
    samples at rest show gravity in another unit. If the sensor moves all the time, the magnitude only has to
    exceed a minimum. Gravity then shows in the mean of the readings or, if the sensor tumbles, in their
    median magnitude.
    """
    size = _size_at_rest(record)
    if size is None:
        sizes = np.linalg.norm([record.acceleration.mean(axis=0), *record.acceleration], axis=1)
        size = float(max(sizes[0], np.median(sizes)))
        return size, "m/s2" if size >= MIN_GRAVITY * GRAVITY_M_S2 else ""
    if abs(size / GRAVITY_M_S2 - 1) <= GRAVITY_RTOL:
        return size, "m/s2"
    off = {name: abs(np.log(size * factor / GRAVITY_M_S2)) for name, factor in UNITS.items()}
    name = min(off, key=lambda unit: off[unit])
    return size, name if off[name] <= GRAVITY_RTOL else ""


def _size_at_rest(record: Record) -> float | None:
    """Return the median magnitude of the specific force at rest, or None if the sensor is never at rest.

    A window is at rest if the standard deviation divided by the magnitude is at most that of a sensor at
    rest.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    count = len(record) // size
    windows = record.acceleration[: count * size].reshape(count, size, 3)
    sizes = np.linalg.norm(windows.mean(axis=1), axis=1)
    quiet = np.sqrt(windows.var(axis=1).sum(axis=1)) <= MAX_REST_ACCELERATION / GRAVITY_M_S2 * sizes
    return float(np.median(sizes[quiet])) if quiet.any() else None


def find_acceleration_unit(record: Record) -> Found | None:
    """Find accelerations that are not in the stated unit or not in any known unit."""
    size, unit = _compare_gravity(record)
    if unit == "m/s2":
        return None
    if not unit:
        return Found("refused", column="ax_m_s2 ... az_m_s2", values={"size": size})
    values = {"unit": unit, "size": size, "factor": UNITS[unit]}
    return Found("handled", replace(record, acceleration=record.acceleration * UNITS[unit]), values=values)


def find_rate_unit(record: Record) -> Found | None:
    """Find turn rates in degrees, by comparison with the rotation of the quaternions or of gravity."""
    scale, judge = _rate_scale(record)
    if scale is None or abs(np.log(scale / DEG)) >= abs(np.log(scale)):
        return None
    return Found("handled", replace(record, rate=record.rate * DEG), values={"judge": judge})


def find_unconfirmed_rates(record: Record) -> Found | None:
    """Find fast turn rates whose unit cannot be confirmed by other columns."""
    fast = float(np.quantile(np.linalg.norm(record.rate, axis=1), 0.99))
    if fast <= FAST_RAD_S or _rate_scale(record)[0] is not None:
        return None
    return Found("handled", values={"fast": fast})


def _rate_scale(record: Record) -> tuple[float | None, str]:
    """Return the factor from logged to true turn rates, or None, and the name of the signal that shows it."""
    scale = _scale_by_quaternion(record)
    if scale is not None:
        return scale, "the quaternions"
    scale = _scale_by_constant_gravity(record)
    if scale is None:
        scale = _scale_by_gravity(record)
    return scale, "gravity in the accelerometer"


def _scale_by_constant_gravity(record: Record) -> float | None:
    """Return the turn-rate unit for which the specific force is constant in the world.

    The unit is 1, or a degree in rad.
    The method works for rotations of any size and speed. The result is None unless one unit is clearly better
    than both the other unit and no rotation at all. It is None for small rotations, rotations about the
    vertical, and swapped axes.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    starts = np.arange(0, len(record) - size, size)
    starts = starts[:: max(len(starts) // MAX_WINDOWS, 1)]
    residual = {1.0: 0.0, DEG: 0.0, 0.0: 0.0}
    for first in starts.tolist():
        rows = slice(first, first + size)
        for factor in residual:
            attitude = integrated_attitude(
                record.time_s[rows], factor * record.rate[rows], Rotation.identity()
            )
            residual[factor] += _spread(attitude.apply(record.acceleration[rows]))
    best = min(residual, key=lambda factor: residual[factor])
    others = min(value for factor, value in residual.items() if factor != best)
    return best if best and residual[best] < CLEAR_RATIO * others else None


def _scale_by_gravity(record: Record) -> float | None:
    """Return the factor from turn rates to the rotation of gravity, or None if gravity hardly rotates."""
    seen, up, turned = _up_turning(record)
    if len(seen) < MIN_BLOCKS:
        return None
    expected = -np.cross(turned - np.median(turned, axis=0), up)
    seen = seen - np.median(seen, axis=0)
    power, shared = float(np.sum(expected**2)), float(np.sum(expected * seen))
    if power == 0 or _rms_size(seen) < MIN_TURN:
        return None
    if abs(shared) < MIN_CORRELATION * np.sqrt(power * np.sum(seen**2)):
        return None
    return abs(shared / power)


def _scale_by_quaternion(record: Record) -> float | None:
    """Return the factor from turn rates to the rotation of the quaternions, or None if they hardly rotate."""
    if record.quaternion is None:
        return None
    stride = max(round(STRIDE_S / record.step_s), 1)
    steps = turns_of(rotations(record.quaternion[::stride]))
    if _rms_size(steps) < MIN_STEP_RAD:
        return None
    total = np.concatenate([[np.zeros(3)], np.cumsum(record.rate, axis=0)]) * record.step_s
    turned = np.diff(total[: len(record) : stride], axis=0)[: len(steps)]
    return float(np.sqrt(np.sum(steps**2) / max(_spread(turned), 1e-30)))


def _spread(values: Array) -> float:
    return float(np.sum((values - values.mean(axis=0)) ** 2))


def _rms_size(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def find_swapped_axes(record: Record) -> Found | None:
    """Find the arrangement of the gyroscope's axes, out of 48, that explains the rotation of gravity.

    Rotations about the vertical carry no information, nor do rotations that are small compared with
    accelerations.
    """
    seen, up, turned = _up_turning(record)
    if len(seen) < MIN_BLOCKS or _rms_size(seen) < MIN_TURN:
        return Found("noted")
    scores = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        residual = _spread(seen + np.cross(turned[:, order] * signs, up))
        scores.append((residual / _spread(seen), order, signs))
    as_is = scores[0][0]
    (best, order, signs), (runner_up, _, _) = sorted(scores, key=lambda entry: entry[0])[:2]
    if best > BETTER * as_is or best > EXPLAINED or as_is < EXPLAINED:
        return None
    changed = [
        f"w{to} from {'-' * (sign < 0)}w{'xyz'[place]}"
        for to, place, sign in zip("xyz", order, signs, strict=True)
        if to != "xyz"[place] or sign < 0
    ]
    values = {"axes": ", ".join(changed), "best": 100 * best, "as_is": 100 * as_is}
    if best > DECIDED * runner_up:
        return Found("refused", column="wx_rad_s ... wz_rad_s", values=values)
    return Found("handled", replace(record, rate=record.rate[:, order] * np.asarray(signs)), values=values)


def _up_turning(record: Record) -> tuple[Array, Array, Array]:
    """Return the rotation of gravity in the sensor, by the accelerometer and by the gyroscope.

    Returns
    -------
    seen : ndarray, shape (m, 3)
        Change of the unit vector along the averaged specific force.
    up, turned : ndarray, shape (m, 3)
        Unit vector and integral of the turn rate, rad. The change should be ``-turned x up``.
    """
    size = max(round(BLOCK_S / record.step_s), 1)
    m = len(record) // size
    if m < 8:
        return (np.zeros((0, 3)),) * 3
    block = record.acceleration[: m * size].reshape(m, size, 3).mean(axis=1)
    up = block / np.maximum(np.linalg.norm(block, axis=1, keepdims=True), 1e-9)
    turn = np.concatenate([[np.zeros(3)], np.cumsum(record.rate[: m * size], axis=0)]) * record.step_s
    centres = turn[size // 2 : m * size : size][:m]
    before, after = slice(-BLOCKS), slice(BLOCKS, None)
    return up[after] - up[before], 0.5 * (up[after] + up[before]), centres[after] - centres[before]


def find_wrong_quaternions(record: Record) -> Found | None:
    """Find quaternions of another convention by comparison with the gyroscope, and remove them.

    Each order of the elements is tried with each direction of the rotation.
    """
    if record.quaternion is None:
        return None
    size = max(round(BLOCK_S / record.step_s), 1)
    sensed = turns_of(integrated_attitude(record.time_s, record.rate, Rotation.identity())[::size])
    if len(sensed) < MIN_BLOCKS:
        return None
    stated = ("wxyz", "body-to-world")
    residual = {}
    for convention in product(("wxyz", "xyzw"), ("body-to-world", "world-to-body")):
        turned = turns_of(rotations(rearranged(record.quaternion[::size], *convention)))
        residual[convention] = float(np.sum((turned - sensed) ** 2))
    best = min(residual, key=lambda convention: residual[convention])
    if residual[best] >= CLEAR_RATIO * residual[stated]:
        return None
    keys = zip(("order", "direction"), best, stated, strict=True)
    power = float(np.sum(sensed**2))
    values = {
        "as_is": 100 * residual[stated] / power,
        "best": 100 * residual[best] / power,
        "order": best[0],
        "direction": best[1].replace("-", " "),
        "line": ", ".join(f"{key}: {value}" for key, value, usual in keys if value != usual),
    }
    return Found("refuted", replace(record, quaternion=None), values=values)


FAULTS = {
    "clock reset": Fault(
        find_clock_reset,
        refused="time goes back at t = {time_s:g} s (sample {sample}) and counts on from there",
        hint="was the clock reset or wrapped? cut the log there, one file for each piece",
    ),
    "repeated stamps": Fault(
        find_stamps,
        "{gone} samples without a time of their own left out, {late} out of order put in place",
        refused="{gone} of {total} samples have no time of their own",
        hint="the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping",
    ),
    "wild readings": Fault(
        find_samples(_by_channel(is_wild), MAX_MISSING),
        "{count} samples in {channels} that no motion causes (up to {largest:.4g}), interpolated",
        refused="{percent:.0f} % of the samples are readings that no motion causes (up to {largest:.4g})",
    ),
    "missing cells": Fault(
        find_samples(lambda record: ~np.isfinite(record.channels), MAX_MISSING),
        "{count} samples with missing cells, interpolated",
        refused="{percent:.0f} % of the samples are missing",
    ),
    "dead channel": Fault(
        find_samples(_by_channel(is_stuck), MAX_STUCK),
        "{count} samples stuck at one value in {channels}, interpolated",
        refused="the channel is dead: one value for {percent:.0f} % of the time",
        hint="three accelerations and three turn rates are needed; repair the sensor or its wiring",
    ),
    "dead magnetometer": Fault(find_dead_magnetometer, "the magnetometer is constant or has gaps, not used"),
    "dead quaternions": Fault(
        find_dead_quaternion,
        "the quaternions are constant, have gaps or are not of length 1, not used",
    ),
    "repeated samples": Fault(
        find_samples(is_repeated, MAX_REPEATED),
        "{count} samples repeat the one before in every channel, interpolated",
    ),
    "saturated channel": Fault(
        find_samples(_by_channel(is_clipped), MAX_CLIPPED),
        "{count} samples clipped at the end of the range in {channels}, interpolated",
        refused="{percent:.1f} % of the samples are clipped at {largest:.4g}",
        hint="use a sensor, or a setting, with a larger range",
    ),
    "acceleration unit": Fault(
        find_acceleration_unit,
        "accelerations are in {unit} ({size:.4g} at rest), converted by {factor:.6g}",
        refused="the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81",
        hint="state the unit in a mapping (--map); gravity must not be subtracted from the readings",
    ),
    "dropped samples": Fault(
        find_dropped,
        "{count} samples missing in {places} places, the longest {longest:.3f} s; integrals span them",
        refused="no samples for {longest:.2f} s after t = {time_s:.3f} s",
        hint="the motion in between is unknown: cut the log there, one file for each piece",
    ),
    "clock jitter": Fault(
        find_jitter,
        "time steps vary by {percent:.0f} % (rms) of {step_ms:.3g} ms; the time stamps are used",
    ),
    "turn-rate unit": Fault(
        find_rate_unit, "turn rates are in deg/s (judged by {judge}), converted to rad/s"
    ),
    "unconfirmed turn rates": Fault(
        find_unconfirmed_rates,
        "turn rates reach {fast:.0f} rad/s in the stated unit, which nothing else in the log confirms; state "
        "another one in a mapping (--map)",
    ),
    "swapped or flipped axes": Fault(
        find_swapped_axes,
        "the gyroscope's axes contradict the accelerometer's: {axes} leaves {best:.0f} % of gravity's "
        "turning unexplained, as logged {as_is:.0f} %; rearranged in this way",
        "the body hardly tilts, so that the axes of gyroscope and accelerometer cannot be compared",
        refused="axes are swapped or flipped, and the tilting does not show which ({axes} fits best)",
        hint="put the axes right in a mapping (--map), with factor -1 for a flipped one",
    ),
    "quaternions": Fault(
        find_wrong_quaternions,
        refuted="the quaternions contradict the gyroscope: as wxyz from body to world they differ by "
        "{as_is:.0f} % of its turning, as {order} from {direction} by {best:.0f} %; they are not used. State "
        "their convention in a mapping (--map) with the line 'quaternion: {{{line}}}'",
    ),
}
