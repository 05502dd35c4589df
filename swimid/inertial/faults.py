"""Faults of a recording: tests that find each fault and repair it, or refuse the recording.

The tests run in the order of :data:`TESTS`. Faults of single samples come first. Faults of units and axes
follow: they show as contradictions between gravity, turn rates and quaternions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import permutations, product

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
from swimid.logs.kinematics import rearranged
from swimid.logs.log import runs
from swimid.logs.mapping import in_order

#: Test of a fault. It returns the record, repaired if the fault was found, and the fault or None. It raises
#: an InputError for a fault that cannot be repaired.
Test = Callable[[Record], tuple[Record, Finding | None]]


def repair(record: Record) -> tuple[Record, list[Finding]]:
    """Return the record with every fault repaired, and the faults that were found.

    Raises
    ------
    InputError
        For the first fault that cannot be repaired.
    """
    findings = []
    for test in TESTS:
        record, found = test(record)
        if found is not None:
            findings.append(found)
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


def find_stamps(record: Record) -> tuple[Record, Finding | None]:
    """Find time stamps that repeat or are out of order, and refuse a clock that jumps back and counts on.

    The repaired record is in order of time and has the first sample of each repeated time stamp.
    """
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    row, late = order.reset_row, order.counts["late"]
    gone = sum(order.counts.values()) - late
    if row is not None:
        text = f"time goes back at t = {record.time_s[row]:g} s (sample {row + 1}) and counts on from there"
        hint = "was the clock reset or wrapped? cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    if gone > MAX_MISSING * len(record):
        text = f"{gone} of {len(record)} samples have no time of their own"
        hint = "the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    if not order.summary:
        return record, None
    text = f"{gone} samples without a time of their own left out, {late} out of order put in place"
    return record.take(order.index), Finding("repeated stamps", "handled", text, gone + late)


def find_samples(
    name: str, is_bad: Callable[[Record, Array], Flags], max_share: float, text: str, hint: str | None = None
) -> Test:
    """Return a test that interpolates bad samples, flags them, and refuses a channel with too many of them.

    Parameters
    ----------
    name : str
        Name of the fault.
    is_bad : callable
        Returns flags of the bad samples of a channel, shape (n,), from the record and the channel.
    max_share : float
        Maximum fraction of bad samples in a channel.
    text : str
        Clause about the bad samples; ``{largest}`` is their largest absolute value.
    hint : str, optional
        Remedy for a refused channel.
    """

    def test(record: Record) -> tuple[Record, Finding | None]:
        bad = np.column_stack([is_bad(record, values) for values in record.channels.T])
        if not bad.any():
            return record, None
        share, sizes = bad.mean(axis=0), np.abs(np.nan_to_num(record.channels)) * bad
        worst = int(np.argmax(share))
        if share[worst] > max_share:
            said = f"{100 * share[worst]:.1f} % of the samples {text.format(largest=sizes[:, worst].max())}"
            raise InputError(said, file=record.name, column=CHANNELS[worst], hint=hint)
        names = ", ".join(np.array(CHANNELS)[bad.any(axis=0)])
        count = int(bad.any(axis=1).sum())
        said = f"{count} samples in {names} {text.format(largest=sizes.max())}, interpolated"
        values = record.channels
        for column, hole in zip(values.T, bad.T, strict=True):
            if hole.any() and not hole.all():
                column[hole] = np.interp(record.time_s[hole], record.time_s[~hole], column[~hole])
        fixed = replace(
            record,
            acceleration=values[:, :3],
            rate=values[:, 3:],
            filled_acceleration=record.filled_acceleration | bad[:, :3].any(axis=1),
            filled_rate=record.filled_rate | bad[:, 3:].any(axis=1),
        )
        return fixed, Finding(name, "handled", said, count)

    return test


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


def is_repeated(record: Record, _: Array) -> Flags:
    """Return flags of samples that repeat the previous one because the logger is faster than the sensor."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    return same & (MIN_REPEATED <= np.mean(same) <= MAX_REPEATED)


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


def find_dead_magnetometer(record: Record) -> tuple[Record, Finding | None]:
    """Find a magnetometer without measurements, and remove its readings.

    If the magnetometer has a lower sample rate than the log, its readings are interpolated.
    """
    if record.magnetic is None:
        return record, None
    rows = _measured_rows(record, record.magnetic)
    if len(rows) == 0 or np.any(np.ptp(record.magnetic[rows], axis=0) == 0):
        text = "the magnetometer is constant or has gaps, not used"
        return replace(record, magnetic=None), Finding("dead magnetometer", "handled", text)
    return replace(
        record, magnetic=resampled(record.time_s, record.time_s[rows], record.magnetic[rows])
    ), None


def find_dead_quaternion(record: Record) -> tuple[Record, Finding | None]:
    """Find quaternions that are not a measured attitude, and remove them.

    Quaternions with a lower sample rate than the log are interpolated.
    """
    q, t = record.quaternion, record.time_s
    if q is None:
        return record, None
    rows = _measured_rows(record, q)
    wrong = np.abs(np.linalg.norm(q[rows], axis=1) - 1) > QUATERNION_TOL
    if len(rows) == 0 or np.ptp(q[rows], axis=0).max() == 0 or wrong.any():
        text = "the quaternions are constant, have gaps or are not of length 1, not used"
        return replace(record, quaternion=None), Finding("dead quaternions", "handled", text)
    if len(rows) < len(record):
        q = Slerp(t[rows], rotations(q[rows]))(np.clip(t, t[rows[0]], t[rows[-1]])).as_quat(scalar_first=True)
    return replace(record, quaternion=q), None


def _measured_rows(record: Record, values: Array) -> np.ndarray:
    """Return the indices of rows with values; none if a gap is too long for interpolation."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    times = np.concatenate([record.time_s[:1], record.time_s[rows], record.time_s[-1:]])
    if len(rows) < 2 or np.max(np.diff(times)) > max(STUCK_S, 2 * record.step_s):
        return rows[:0]
    return rows


def find_dropped(record: Record) -> tuple[Record, Finding | None]:
    """Find missing samples. The integrals span the gaps, and the noise model accounts for them."""
    steps = np.diff(record.time_s)
    wide, row = steps > LONG_STEP * record.step_s, int(np.argmax(steps))
    if not wide.any():
        return record, None
    if steps[row] > MAX_STEP_S:
        text = f"no samples for {steps[row]:.2f} s after t = {record.time_s[row]:.3f} s"
        hint = "the motion in between is unknown: cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    count = int(np.sum(np.round(steps[wide] / record.step_s) - 1))
    text = f"{count} samples missing in {wide.sum()} places, up to {steps[row]:.3f} s; integrals span them"
    return record, Finding("dropped samples", "handled", text, count)


def find_jitter(record: Record) -> tuple[Record, Finding | None]:
    """Find uneven time steps. All integrals use the time stamps of the samples."""
    steps = np.diff(record.time_s)
    single = steps[steps < LONG_STEP * record.step_s]
    jitter = sampling.rate(record.time_s).jitter
    if jitter:
        jitter = max(jitter, float(np.std(single)) / record.step_s)
    if jitter < MIN_JITTER:
        return record, None
    step = f"{1e3 * record.step_s:.3g} ms"
    text = f"time steps vary by {100 * jitter:.0f} % (rms) of {step}; the time stamps are used"
    return record, Finding("clock jitter", "handled", text)


# ---------------------------------------------------------------- units and axes

#: Maximum relative difference between the specific force at rest and g. Scale errors are some percent, and
#: gliding adds some.
GRAVITY_RTOL = 0.12
#: Minimum magnitude of a specific force that includes gravity, in g.
MIN_GRAVITY = 0.5
#: Units of acceleration, in m/s^2. The nearest unit is chosen; mg and cm/s2 differ by 2 %.
UNITS = {"m/s2": 1.0, "g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}
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


def find_acceleration_unit(record: Record) -> tuple[Record, Finding | None]:
    """Find accelerations that are not in the stated unit or not in any known unit.

    The magnitude of the specific force is the median over windows at rest. A window is at rest if the
    standard deviation divided by the magnitude is at most that of a sensor at rest. If the sensor moves all
    the time, the stated unit is assumed, and the magnitude only has to exceed a minimum. Gravity then shows
    in the mean of the readings or, if the sensor tumbles, in their median magnitude.
    """
    rows = max(round(WINDOW_S / record.step_s), 4)
    count = len(record) // rows
    windows = record.acceleration[: count * rows].reshape(count, rows, 3)
    sizes = np.linalg.norm(windows.mean(axis=1), axis=1)
    quiet = np.sqrt(windows.var(axis=1).sum(axis=1)) <= MAX_REST_ACCELERATION / GRAVITY_M_S2 * sizes
    if quiet.any():
        size = float(np.median(sizes[quiet]))
        off = {name: abs(size * factor / GRAVITY_M_S2 - 1) for name, factor in UNITS.items()}
        unit = min(off, key=lambda name: off[name])
        known = off[unit] <= GRAVITY_RTOL
    else:
        sizes = np.linalg.norm([record.acceleration.mean(axis=0), *record.acceleration], axis=1)
        size, unit = float(max(sizes[0], np.median(sizes))), "m/s2"
        known = size >= MIN_GRAVITY * GRAVITY_M_S2
    if not known:
        text = f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81"
        hint = "state the unit in a mapping (--map); gravity must not be subtracted from the readings"
        raise InputError(text, file=record.name, column="ax_m_s2 ... az_m_s2", hint=hint)
    if unit == "m/s2":
        return record, None
    factor = UNITS[unit]
    text = f"accelerations are in {unit} ({size:.4g} at rest), converted by {factor:.6g}"
    fixed = replace(record, acceleration=record.acceleration * factor)
    return fixed, Finding("acceleration unit", "handled", text)


def find_rate_unit(record: Record) -> tuple[Record, Finding | None]:
    """Find turn rates in degrees, by comparison with the rotation of the quaternions or of gravity.

    Fast turn rates whose unit cannot be confirmed by other columns are reported.
    """
    estimates = (_scale_by_quaternion, _scale_by_constant_gravity, _scale_by_gravity)
    scale = next((found for find in estimates if (found := find(record)) is not None), None)
    if scale is None:
        fast = float(np.quantile(np.linalg.norm(record.rate, axis=1), 0.99))
        if fast <= FAST_RAD_S:
            return record, None
        text = (
            f"turn rates reach {fast:.0f} rad/s in the stated unit, which nothing else in the log confirms; "
            "state another one in a mapping (--map)"
        )
        return record, Finding("unconfirmed turn rates", "handled", text)
    if abs(np.log(scale / DEG)) >= abs(np.log(scale)):
        return record, None
    text = "turn rates are in deg/s, as the turning of gravity or quaternions shows; converted to rad/s"
    return replace(record, rate=record.rate * DEG), Finding("turn-rate unit", "handled", text)


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
        part = record.take(slice(first, first + size))
        for factor in residual:
            attitude = integrated_attitude(part.time_s, factor * part.rate, Rotation.identity())
            residual[factor] += _spread(attitude.apply(part.acceleration))
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


def find_swapped_axes(record: Record) -> tuple[Record, Finding | None]:
    """Find the arrangement of the gyroscope's axes, out of 48, that explains the rotation of gravity.

    Rotations about the vertical carry no information, nor do rotations that are small compared with
    accelerations.
    """
    name = "swapped or flipped axes"
    seen, up, turned = _up_turning(record)
    if len(seen) < MIN_BLOCKS or _rms_size(seen) < MIN_TURN:
        text = "the body hardly tilts, so that the axes of gyroscope and accelerometer cannot be compared"
        return record, Finding(name, "noted", text)
    scores = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        residual = _spread(seen + np.cross(turned[:, order] * signs, up))
        scores.append((residual / _spread(seen), order, signs))
    as_is = scores[0][0]
    (best, order, signs), (runner_up, _, _) = sorted(scores, key=lambda entry: entry[0])[:2]
    if best > BETTER * as_is or best > EXPLAINED or as_is < EXPLAINED:
        return record, None
    changed = ", ".join(
        f"w{to} from {'-' * (sign < 0)}w{'xyz'[place]}"
        for to, place, sign in zip("xyz", order, signs, strict=True)
        if to != "xyz"[place] or sign < 0
    )
    if best > DECIDED * runner_up:
        text = f"axes are swapped or flipped, and the tilting does not show which ({changed} fits best)"
        hint = "put the axes right in a mapping (--map), with factor -1 for a flipped one"
        raise InputError(text, file=record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    text = (
        f"the gyroscope's axes contradict the accelerometer's: {changed} leaves {100 * best:.0f} % of "
        f"gravity's turning unexplained, as logged {100 * as_is:.0f} %; rearranged in this way"
    )
    fixed = replace(record, rate=record.rate[:, order] * np.asarray(signs))
    return fixed, Finding(name, "handled", text)


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


def find_wrong_quaternions(record: Record) -> tuple[Record, Finding | None]:
    """Find quaternions of another convention by comparison with the gyroscope, and remove them.

    Each order of the elements is tried with each direction of the rotation.
    """
    if record.quaternion is None:
        return record, None
    size = max(round(BLOCK_S / record.step_s), 1)
    sensed = turns_of(integrated_attitude(record.time_s, record.rate, Rotation.identity())[::size])
    if len(sensed) < MIN_BLOCKS:
        return record, None
    stated = ("wxyz", "body-to-world")
    off = {}
    for convention in product(("wxyz", "xyzw"), ("body-to-world", "world-to-body")):
        turned = turns_of(rotations(rearranged(record.quaternion[::size], *convention)))
        off[convention] = float(np.sum((turned - sensed) ** 2) / max(np.sum(sensed**2), 1e-300))
    best = min(off, key=lambda convention: off[convention])
    if off[best] >= CLEAR_RATIO * off[stated]:
        return record, None
    keys = zip(("order", "direction"), best, stated, strict=True)
    line = ", ".join(f"{key}: {value}" for key, value, usual in keys if value != usual)
    text = (
        f"the quaternions contradict the gyroscope: as wxyz from body to world they differ by "
        f"{100 * off[stated]:.0f} % of its turning, as {best[0]} from {best[1].replace('-', ' ')} by "
        f"{100 * off[best]:.0f} %; they are not used. State their convention in a mapping (--map) with the "
        f"line 'quaternion: {{{line}}}'"
    )
    return replace(record, quaternion=None), Finding("quaternions", "refuted", text)


#: Tests in the order in which they run.
TESTS: tuple[Test, ...] = (
    find_stamps,
    find_samples("wild readings", is_wild, MAX_MISSING, "exceed any motion (up to {largest:.4g})"),
    find_samples("missing cells", lambda _, values: ~np.isfinite(values), MAX_MISSING, "are missing"),
    find_samples(
        "dead channel",
        is_stuck,
        MAX_STUCK,
        "are stuck at one value",
        "repair the sensor or its wiring: three accelerations and three turn rates are needed",
    ),
    find_dead_magnetometer,
    find_dead_quaternion,
    find_samples("repeated samples", is_repeated, MAX_REPEATED, "repeat the ones before in every channel"),
    find_samples(
        "saturated channel",
        is_clipped,
        MAX_CLIPPED,
        "are clipped at the end of the range, {largest:.4g}",
        "use a sensor, or a setting, with a larger range",
    ),
    find_acceleration_unit,
    find_dropped,
    find_jitter,
    find_rate_unit,
    find_swapped_axes,
    find_wrong_quaternions,
)
