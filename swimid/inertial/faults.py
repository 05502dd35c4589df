"""Tests for faults of an inertial recording. A test reports or repairs its fault, or refuses the recording.

The tests run in the order of :data:`TESTS`. Faults of single samples come first. Faults of units and axes
follow. Such faults show as contradictions between gravity, turn rates and quaternions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate, permutations, product
from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.imports.mapping import in_order
from swimid.inertial import record as recording
from swimid.inertial.record import CHANNELS, DEG, GRAVITY_M_S2, Array, Finding, Flags, ImuRecord, turns_of
from swimid.kinematics.attitude import reorder_quaternion
from swimid.logs import sampling
from swimid.logs.log import runs

#: Type of a test for a fault. A test returns the record, repaired if the fault was found, and a finding on
#: the fault (None if the fault was not found). It raises an InputError for a fault that cannot be repaired.
Test = Callable[[ImuRecord], tuple[ImuRecord, Finding | None]]


def repair(record: ImuRecord) -> tuple[ImuRecord, list[Finding]]:
    """Repair every fault of a record that can be repaired; return the record and findings on the faults.

    Raises
    ------
    InputError
        A fault cannot be repaired. The error names the first one.
    """
    findings = []
    for test in TESTS:
        record, found = test(record)
        if found is not None:
            findings.append(found)
    return record, findings


# ---------------------------------------------------------------- samples

#: Maximum fraction of samples without a time stamp, and maximum fraction of missing values in a channel. With
#: more, the recording is refused.
MAX_MISSING_SHARE = 0.5
#: Maximum magnitude of a sensor reading, in any unit. Larger values are not measurements.
MAX_READING = 1e5
#: WILD_RANGES is the maximum distance of a reading from the median of the other readings, divided by their
#: range. WINDOW is the number of samples in the running median.
WILD_RANGES, WINDOW = 30.0, 7
#: A stuck channel holds one value for at least STUCK_S seconds and STUCK_SAMPLES samples. STUCK_SHARE is the
#: maximum fraction of the other samples that have the same value.
STUCK_S, STUCK_SAMPLES, STUCK_SHARE = 0.5, 25, 0.01
#: Maximum fraction of samples in a channel that belong to stuck periods. With more, the recording is refused.
MAX_STUCK = 0.3
#: Minimum and maximum fraction of samples that repeat the previous one because the logger is faster than the
#: sensor. A smaller fraction occurs by chance. A larger one means a recording without motion.
MIN_REPEATED, MAX_REPEATED = 0.005, 0.9
#: Maximum fraction of clipped samples in a channel. With more, the recording is refused.
MAX_CLIPPED = 0.1
#: LONG_STEP is the minimum time step that counts as a loss of samples, in median sample times. MAX_STEP_S is
#: the maximum time step over which the motion can be estimated, s.
LONG_STEP, MAX_STEP_S = 1.6, 2.0
#: Minimum root-mean-square jitter of the time stamps for a warning, in median sample times.
MIN_JITTER = 0.05
#: Maximum deviation of the norm of a valid quaternion from 1.
QUATERNION_TOL = 0.05
#: Maximum ratio of the deviation of a reading from the running median to the deviation of its surroundings. A
#: reading with a larger ratio is corrupt. The deviation of the surroundings is one that a fifth of the
#: readings in the same second exceed, but neither neighbour. Noise with a Laplace distribution reaches the
#: ratio once in 10^7 readings.
GLITCH = 10.0
#: Deviation of a single turn rate from the running median, divided by the range of the running median, above
#: which no motion causes it. In a real recording of a hand-held sensor at 1 kHz this ratio is 2.3 at most.
MAX_JERK = 3.0
#: The difference between quaternions and gyroscope is compared with its median in a window of JUMP_S seconds,
#: but at most JUMP_SAMPLES samples. JUMP_SD is the minimum deviation from the median of a corrupt quaternion,
#: in standard deviations. MAX_JUMPS is the maximum fraction of corrupt quaternions.
JUMP_S, JUMP_SAMPLES, JUMP_SD, MAX_JUMPS = 2.0, 101, 6.0, 0.1


def find_stamps(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find time stamps that repeat or are out of order, and repair them; refuse a clock that was reset.

    A clock counts as reset if the time jumps back and continues from there. The repaired record is in order
    of time. Of several samples with the same time stamp, the repaired record has only the first.
    """
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    row, late = order.reset_row, order.counts["late"]
    gone = sum(order.counts.values()) - late
    if row is not None:
        text = f"time goes back at t = {record.time_s[row]:g} s (sample {row + 1}) and counts on from there"
        hint = "was the clock reset or wrapped? cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    if gone > MAX_MISSING_SHARE * len(record):
        text = f"{gone} of {len(record)} samples have no time, or that of another sample"
        hint = "the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    if not order.summary:
        return record, None
    text = f"{gone} samples with a missing or repeated time left out, {late} late samples sorted by time"
    return record.take(order.index), Finding("repeated stamps", "handled", text, gone + late)


def find_samples(
    name: str,
    is_bad: Callable[[ImuRecord, Array], Flags],
    max_share: float,
    text: str,
    hint: str | None = None,
) -> Test:
    """Return a test that interpolates the bad samples of each channel and flags them as interpolated.

    The test refuses a recording with too many bad samples in a channel.

    Parameters
    ----------
    name : str
        Name of the fault.
    is_bad : callable
        Returns flags of the bad samples of a channel, shape (n,), from the record and the channel.
    max_share : float
        Maximum fraction of bad samples in a channel.
    text : str
        Clause of the message about the bad samples; ``{largest}`` is their largest absolute value.
    hint : str, optional
        Hint of the error for a refused channel.
    """

    def test(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
        bad = np.column_stack([is_bad(record, values) for values in record.channels.T])
        share, sizes = bad.mean(axis=0), np.abs(np.nan_to_num(record.channels)) * bad
        worst = int(np.argmax(share))
        if share[worst] > max_share:
            said = f"{100 * share[worst]:.1f} % of the samples {text.format(largest=sizes[:, worst].max())}"
            raise InputError(said, file=record.name, column=CHANNELS[worst], hint=hint)
        return interpolate_samples(record, bad, name, text.format(largest=sizes.max()))

    return test


def interpolate_samples(
    record: ImuRecord, bad: Flags, name: str, text: str
) -> tuple[ImuRecord, Finding | None]:
    """Return a record in which the samples flagged as bad, shape (n, 6), are interpolated, and a finding."""
    if not bad.any():
        return record, None
    values, count = record.channels, int(bad.any(axis=1).sum())
    for column, hole in zip(values.T, bad.T, strict=True):
        if hole.any() and not hole.all():
            column[hole] = np.interp(record.time_s[hole], record.time_s[~hole], column[~hole])
    filled = record.filled | bad.reshape(-1, 2, 3).any(axis=2)
    fixed = replace(record, acceleration=values[:, :3], rate=values[:, 3:], filled=filled)
    said = f"{count} samples in {', '.join(np.array(CHANNELS)[bad.any(axis=0)])} {text}, interpolated"
    return fixed, Finding(name, "handled", said, count)


def is_empty(record: ImuRecord, _: Array) -> Flags:
    """Return flags of samples that hold one value in every channel."""
    return np.asarray(np.ptp(record.channels, axis=1) == 0)


def is_wild(_: ImuRecord, values: Array) -> Flags:
    """Return flags of readings that no motion can cause: glitches, and codes for a missing sample."""
    flags = np.abs(np.nan_to_num(values)) > MAX_READING
    known = np.flatnonzero(np.isfinite(values) & ~flags)
    if len(known) < 2 * WINDOW:
        return flags
    # Flag codes for a missing sample: the maximum or minimum of the channel if it is far from all other
    # values, however often it occurs.
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


def is_stuck(record: ImuRecord, values: Array) -> Flags:
    """Return flags of samples in which a channel is stuck, that is, holds one value for a long time.

    A value that also occurs often in other samples results from coarse rounding and is not flagged.
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


def is_repeated(record: ImuRecord, _: Array) -> Flags:
    """Return flags of samples that repeat the previous one, because the logger is faster than the sensor."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    return same & (MIN_REPEATED <= np.mean(same) <= MAX_REPEATED)


def is_clipped(_: ImuRecord, values: Array) -> Flags:
    """Return flags of samples that are clipped at the maximum or minimum of a channel.

    Without clipping, values become rare towards the maximum. A channel counts as clipped under two
    conditions. It stays at its maximum for two samples or more, at least three times. It also has the maximum
    more than twice as often as values within 1 % of the range below the maximum. The same holds for the
    minimum.
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


def is_glitch(record: ImuRecord, values: Array) -> Flags:
    """Return flags of single readings that differ from their neighbours far more than other readings do."""
    off = np.abs(values - median_filter(values, size=WINDOW, mode="nearest"))
    size = max(round(1.0 / record.step_s), 4 * WINDOW)
    blocks = np.array_split(off, max(len(off) // size, 1))
    usual = np.concatenate([np.full(len(block), np.quantile(block, 0.8)) for block in blocks])
    beside = np.pad(off, 1)
    beside = np.maximum(usual, np.maximum(beside[:-2], beside[2:]))
    return np.asarray(off > GLITCH * np.maximum(beside, np.min(off[off > 0], initial=np.inf)))


def find_glitches(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find single corrupt readings, and interpolate them if some of them occur while the sensor rests.

    While the sensor moves, a single high reading may be a real jerk and not corrupt. But no jerk turns a
    robot for one sample much faster than the whole range of its turn rates. Therefore such turn rates are
    always interpolated.
    """
    name, text = "corrupt readings", "differ from the readings around them"
    bad = np.column_stack([is_glitch(record, values) for values in record.channels.T])
    fixed, found = interpolate_samples(record, bad, name, text)
    if found is None or any(bad[rest.rows].any() for rest in recording.find_rests(fixed)):
        return fixed, found
    ranges = np.ptp(median_filter(record.rate, size=(WINDOW, 1), mode="nearest"), axis=0)
    far = np.abs(fixed.rate - record.rate) > MAX_JERK * ranges
    return interpolate_samples(record, np.hstack([np.zeros_like(far), far]), name, text)


def find_dead(column: str, fault: str, combine: Callable[[Flags], Any], text: str) -> Test:
    """Return a test that removes a column of the record if it holds no measurements.

    A column with a lower sample rate than the log is interpolated instead.

    Parameters
    ----------
    column : str
        Attribute of the record, an array of shape (n, k) or None.
    fault, text : str
        Name of the fault, and sentence about it for the user.
    combine : callable
        Returns whether the column is dead, from the flags of its k constant components.
    """

    def test(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
        values, t = getattr(record, column), record.time_s
        if values is None:
            return record, None
        there, finding = np.isfinite(values).all(axis=1), None
        if column == "quaternion":
            long = there & (np.abs(np.linalg.norm(values, axis=1) - 1) > QUATERNION_TOL)
            there &= ~long
            if long.any():
                finding = _corrupt_quaternions(int(long.sum()), "are not of length 1")
        rows = np.flatnonzero(there)
        is_dead = len(rows) < 2 or combine(np.ptp(values[rows], axis=0) == 0)
        gap_s = np.max(np.diff(np.concatenate([t[:1], t[rows], t[-1:]])))
        if is_dead or gap_s > max(STUCK_S, 2 * record.step_s):
            return replace(record, **{column: None}), Finding(fault, "handled", text)  # type: ignore[arg-type]
        known = values[rows]
        if column == "quaternion":
            known = _align_signs(known)
        known = recording.resampled(t, t[rows], known)
        return replace(record, **{column: known}), finding  # type: ignore[arg-type]

    return test


def _align_signs(quaternion: Array) -> Array:
    """Return quaternions with signs for which the interpolation between successive ones is short.

    The quaternions q and -q describe the same attitude.
    """
    same = np.sign(np.sum(quaternion[1:] * quaternion[:-1], axis=1, keepdims=True))
    return np.vstack([quaternion[:1], quaternion[1:] * np.cumprod(np.where(same, same, 1.0), axis=0)])


def _corrupt_quaternions(count: int, text: str) -> Finding:
    return Finding("corrupt quaternions", "handled", f"{count} quaternions {text}, interpolated", count)


def find_quaternion_jumps(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find quaternions that jump to another attitude though the gyroscope does not turn; interpolate them."""
    if record.quaternion is None:
        return record, None
    sensed = recording.integrate_attitude(record.time_s, record.rate, Rotation.identity())
    apart = (recording.rotations(record.quaternion) * sensed.inv()).as_quat()
    size = min(round(JUMP_S / record.step_s), JUMP_SAMPLES) | 1
    # Align all signs with the first median, because a jump would reverse those after it.
    apart *= np.sign(apart @ np.median(_align_signs(apart[:size]), axis=0))[:, None]
    usual = median_filter(apart, size=(size, 1), mode="nearest")
    away = (Rotation.from_quat(apart) * Rotation.from_quat(usual).inv()).magnitude()
    bad = away > JUMP_SD * recording.QUATERNION_SD
    if not bad.any() or bad.mean() > MAX_JUMPS:
        return record, None
    known = recording.resampled(record.time_s, record.time_s[~bad], _align_signs(record.quaternion[~bad]))
    text = f"jump by up to {np.max(away) / DEG:.0f} deg against the gyroscope"
    return replace(record, quaternion=known), _corrupt_quaternions(int(bad.sum()), text)


def find_dropped(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find gaps in the time stamps of a record and report them; refuse a gap that is too long.

    Later integrals span the shorter gaps, and the noise model of the smoother accounts for them.
    """
    steps = np.diff(record.time_s)
    wide, row = steps > LONG_STEP * record.step_s, int(np.argmax(steps))
    if not wide.any():
        return record, None
    if steps[row] > MAX_STEP_S:
        text = f"no samples for {steps[row]:.2f} s after t = {record.time_s[row]:.3f} s"
        hint = "the motion in between is unknown: cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    count = int(np.sum(np.round(steps[wide] / record.step_s) - 1))
    text = f"{count} samples missing in {wide.sum()} gaps of up to {steps[row]:.3f} s, which are bridged"
    return record, Finding("dropped samples", "handled", text, count)


def find_jitter(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find uneven time steps in a record and report them.

    No repair is needed, because all integrals use the time stamps of the samples.
    """
    jitter = sampling.rate(record.time_s).jitter
    if jitter < MIN_JITTER:
        return record, None
    step = f"{1e3 * record.step_s:.3g} ms"
    text = f"time steps vary by {100 * jitter:.0f} % (rms) of {step}; the time stamps are used"
    return record, Finding("clock jitter", "handled", text)


# ---------------------------------------------------------------- units and axes

#: Maximum relative difference between the specific force at rest and g for a unit that is recognised. Errors
#: of the sensor's scale are some percent, and gliding adds some percent.
GRAVITY_RTOL = 0.12
#: Minimum magnitude of the specific force of a valid recording, in g. A smaller magnitude shows that gravity
#: was subtracted.
MIN_GRAVITY = 0.5
#: Units of acceleration that are recognised, in m/s^2. The unit nearest to the measured gravity is chosen; mg
#: and cm/s2 differ by 2 %.
UNITS = {"m/s2": 1.0, "g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}
#: Length of the windows in which the magnitude of the specific force is analysed, s.
WINDOW_S = 0.5
#: Length of the blocks over which the specific force is averaged, s, and number of blocks in a window. The
#: averages of a window show the rotation of gravity, because over about a second rotation of the sensor
#: changes the average more than acceleration does.
BLOCK_S, BLOCKS = 0.3, 4
#: Limits of the comparison between turn rates and the rotation of gravity. MIN_WINDOWS and MAX_WINDOWS limit
#: the number of windows. MIN_TURN is the minimum root-mean-square rotation of gravity in these windows (rad).
MIN_WINDOWS, MAX_WINDOWS, MIN_TURN = 4, 100, 0.02
#: Maximum residual of a recognised unit of turn rate, relative to the residual of the other unit (rad/s or
#: deg/s) and to the residual without any rotation.
CLEAR_UNIT = 0.75
#: CLEAR_CONVENTION is the maximum residual of another convention of the quaternions, relative to the residual
#: of the stated convention, for which the stated one is rejected. MIN_ROTATIONS is the minimum number of
#: compared rotations.
CLEAR_CONVENTION, MIN_ROTATIONS = 0.5, 16
#: Criteria for rearranging the axes of the gyroscope. They use the fraction of the rotation of gravity that
#: an arrangement leaves unexplained. MAX_BEST is the maximum fraction for the best arrangement. MIN_LOGGED is
#: the minimum fraction for the axes as logged. DECIDED is the maximum ratio of the best to the second-best
#: fraction. For the axes as logged, a fraction below MIN_LOGGED can result from acceleration (in a yawing
#: swimmer the centripetal acceleration ``u r`` looks like roll).
MAX_BEST, MIN_LOGGED, DECIDED = 0.25, 0.5, 0.7
#: Maximum turn rate (99th percentile) in a unit that the log does not confirm, rad/s. Faster turn rates cause
#: a warning.
FAST_RAD_S = 12.0
#: Arrangements of three axes: the 48 orders and signs. Each arrangement is a matrix from the axes as logged
#: to the true axes. The first one is the identity.
ARRANGEMENTS = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
]


def find_acceleration_unit(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find accelerations that are not in m/s^2; convert them from a known unit, or refuse the recording.

    The unit follows from the magnitude of the specific force at rest, which is that of gravity. This
    magnitude is the median over windows at rest. A window is at rest if the standard deviation divided by the
    magnitude is at most that of a sensor at rest. If the sensor moves all the time, the stated unit is
    assumed, and the magnitude only has to exceed a minimum. Gravity then shows in the mean of the readings
    or, if the sensor tumbles, in their median magnitude.
    """
    rows = max(round(WINDOW_S / record.step_s), 4)
    count = len(record) // rows
    windows = record.acceleration[: count * rows].reshape(count, rows, 3)
    sizes = np.linalg.norm(windows.mean(axis=1), axis=1)
    quiet = np.sqrt(windows.var(axis=1).sum(axis=1)) <= recording.MAX_REST_ACCELERATION / GRAVITY_M_S2 * sizes
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
        text = f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone gives 9.81"
        hint = "state the unit in a mapping (--map); gravity must not be subtracted from the readings"
        raise InputError(text, file=record.name, column="ax_m_s2 ... az_m_s2", hint=hint)
    if unit == "m/s2":
        return record, None
    factor = UNITS[unit]
    text = f"accelerations are in {unit} ({size:.4g} at rest), converted by {factor:.6g}"
    fixed = replace(record, acceleration=record.acceleration * factor)
    return fixed, Finding("acceleration unit", "handled", text)


def find_rate_unit(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find turn rates in degrees per second, by comparison with gravity or quaternions, and convert them.

    The rotation of gravity in sensor axes, or of the quaternions, must agree with the integrated turn rates.
    Fast turn rates whose unit cannot be confirmed in this way are reported.
    """
    for residuals in (_gravity_residuals, _quaternion_residuals):
        radians, degrees = (min(residuals(record, unit).values(), default=1.0) for unit in (1.0, DEG))
        if degrees < CLEAR_UNIT * min(radians, 1.0):
            text = "turn rates are in deg/s, as the rotation of gravity or quaternions shows; converted"
            return replace(record, rate=record.rate * DEG), Finding("turn-rate unit", "handled", text)
        if radians < CLEAR_UNIT * min(degrees, 1.0):
            return record, None
    fast = float(np.quantile(np.linalg.norm(record.rate, axis=1), 0.99))
    if fast <= FAST_RAD_S:
        return record, None
    text = (
        f"turn rates reach {fast:.0f} rad/s in the stated unit, which nothing else in the log confirms; "
        "state another unit in a mapping (--map)"
    )
    return record, Finding("unconfirmed turn rates", "handled", text)


def _gravity_residuals(record: ImuRecord, unit: float = 1.0) -> dict[int, float]:
    """Return the relative change of specific force in world axes, by order and sign of the gyroscope axes.

    The keys are indices in :data:`ARRANGEMENTS`. The specific force is averaged over blocks. If unit and axes
    of the turn rates are right, its changes between the blocks of a window are those of the true
    acceleration. The returned values are these changes, divided by the changes along sensor axes. If there
    are no windows, or if gravity hardly rotates, the result is empty.

    Parameters
    ----------
    unit : float
        Unit of the turn rates, rad/s.
    """
    size = max(round(BLOCK_S / record.step_s), 1)
    count = len(record) // (BLOCKS * size)
    if count < MIN_WINDOWS:
        return {}
    windows = record.channels[: count * BLOCKS * size].reshape(count, -1, 6)
    force, rate = np.split(windows[:: max(count // MAX_WINDOWS, 1)], 2, axis=2)

    def changes(turned: Array) -> float:
        blocks = turned.reshape(len(force), BLOCKS, size, 3).mean(axis=2)
        blocks -= blocks.mean(axis=1, keepdims=True)
        return float(np.mean((blocks - blocks.mean(axis=0)) ** 2))

    still, found = changes(force), {}
    if still < (MIN_TURN * GRAVITY_M_S2) ** 2 / 3:
        return {}
    for sign in (1.0, -1.0):
        steps = Rotation.from_rotvec(sign * unit * record.step_s * rate.reshape(-1, 3)).as_matrix()
        steps = steps.reshape(*rate.shape, 3).swapaxes(0, 1)
        attitude = np.swapaxes(list(accumulate(steps, np.matmul)), 0, 1)
        for k, axes in enumerate(ARRANGEMENTS):
            # Use the same integrated attitude for all arrangements of one handedness. A rotation of the axes,
            # without a mirror image, rotates all attitudes in the same way.
            if np.linalg.det(axes) * sign > 0:
                found[k] = changes((attitude @ (force @ (sign * axes))[..., None])[..., 0]) / still
    return found


def _quaternion_residuals(record: ImuRecord, unit: float = 1.0) -> dict[tuple[str, str], float]:
    """Return the difference between rotations by quaternions and by gyroscope, for each convention.

    A convention is the order of the elements of a quaternion and the direction of its rotation. The sum of
    the squared differences is divided by the sum of the squared rotations of the gyroscope.

    Parameters
    ----------
    unit : float
        Unit of the turn rates, rad/s.
    """
    size = max(round(BLOCK_S / record.step_s), 1)
    if record.quaternion is None or len(record) <= MIN_ROTATIONS * size:
        return {}
    sensed = turns_of(
        recording.integrate_attitude(record.time_s, unit * record.rate, Rotation.identity())[::size]
    )
    found = {}
    for convention in product(("wxyz", "xyzw"), ("body-to-world", "world-to-body")):
        turned = turns_of(recording.rotations(reorder_quaternion(record.quaternion[::size], *convention)))
        found[convention] = float(np.sum((turned - sensed) ** 2) / max(np.sum(sensed**2), 1e-300))
    return found


def find_swapped_axes(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find swapped or mirrored axes of the gyroscope, by comparison with the rotation of gravity.

    Of the 48 arrangements of the axes, the one that clearly explains the rotation of gravity is applied to
    the gyroscope. Rotations about the vertical carry no information, nor do rotations that are small compared
    with accelerations.
    """
    name, residuals = "swapped or flipped axes", _gravity_residuals(record)
    if not residuals:
        text = "the body hardly tilts, so that the axes of gyroscope and accelerometer cannot be compared"
        return record, Finding(name, "noted", text)
    as_is = residuals[0]
    chosen, second = sorted(residuals, key=lambda k: residuals[k])[:2]
    best = residuals[chosen]
    if best > MAX_BEST or as_is < MIN_LOGGED:
        return record, None
    axes = ARRANGEMENTS[chosen]
    places = np.abs(axes).argmax(axis=1)
    changed = ", ".join(
        f"w{to} from {'-' * bool(row[place] < 0)}w{'xyz'[place]}"
        for to, place, row in zip("xyz", places, axes, strict=True)
        if to != "xyz"[place] or row[place] < 0
    )
    if best > DECIDED * residuals[second]:
        text = f"axes are swapped or flipped, and the tilting does not show which ({changed} fits best)"
        hint = "correct the axes in a mapping (--map), with factor: -1 for a flipped axis"
        raise InputError(text, file=record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    text = (
        f"the gyroscope's axes contradict the accelerometer's: {changed} leaves {100 * best:.0f} % of "
        f"gravity's turning unexplained, as logged {100 * as_is:.0f} %; rearranged in this way"
    )
    return replace(record, rate=record.rate @ axes.T), Finding(name, "handled", text)


def find_wrong_quaternions(record: ImuRecord) -> tuple[ImuRecord, Finding | None]:
    """Find quaternions that contradict the gyroscope in the stated convention, and remove them.

    The quaternions are removed only if they clearly agree with the gyroscope in another convention.
    """
    off, stated = _quaternion_residuals(record), ("wxyz", "body-to-world")
    best = min(off, key=lambda convention: off[convention], default=stated)
    if best == stated or off[best] >= CLEAR_CONVENTION * off[stated]:
        return record, None
    keys = zip(("order", "direction"), best, stated, strict=True)
    line = ", ".join(f"{key}: {value}" for key, value, usual in keys if value != usual)
    text = (
        f"the quaternions are not used, because as wxyz from body to world they differ from the gyroscope by "
        f"{100 * off[stated]:.0f} % of its turning, but as {best[0]} from {best[1].replace('-', ' ')} only "
        f"by {100 * off[best]:.0f} %. State their convention in a mapping (--map) with the "
        f"line 'quaternion: {{{line}}}'"
    )
    return replace(record, quaternion=None), Finding("quaternions", "refuted", text)


#: Texts on faults of an inertial recording, for messages.
WIRING_HINT = "repair the sensor or its wiring: three accelerations and three turn rates are needed"
NO_QUATERNIONS = "the quaternions are constant, have gaps or are not of length 1, not used"
CLIPPED = "are clipped at the end of the range, {largest:.4g}"
CLIPPED_HINT = "use a sensor, or a setting, with a larger range"
#: Tests for faults of an inertial recording, in the order in which they run.
TESTS: tuple[Test, ...] = (
    find_stamps,
    find_samples(
        "empty samples", is_empty, MAX_MISSING_SHARE, "hold one value in every channel, {largest:.4g}"
    ),
    find_samples("wild readings", is_wild, MAX_MISSING_SHARE, "exceed any motion (up to {largest:.4g})"),
    find_samples("missing cells", lambda _, values: ~np.isfinite(values), MAX_MISSING_SHARE, "are missing"),
    find_samples("dead channel", is_stuck, MAX_STUCK, "are stuck at one value", WIRING_HINT),
    find_dead("magnetic", "dead magnetometer", np.any, "the magnetometer is constant or has gaps, not used"),
    find_dead("quaternion", "dead quaternions", np.all, NO_QUATERNIONS),
    find_samples("repeated samples", is_repeated, MAX_REPEATED, "repeat the ones before in every channel"),
    find_samples("saturated channel", is_clipped, MAX_CLIPPED, CLIPPED, CLIPPED_HINT),
    find_glitches,
    find_acceleration_unit,
    find_dropped,
    find_jitter,
    find_rate_unit,
    find_swapped_axes,
    find_wrong_quaternions,
    find_quaternion_jumps,
)
