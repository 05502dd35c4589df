"""Faults of a recording: each is searched for, and repaired or refused, in the order of :data:`FAULTS`.

First those of the samples; then units and axes that are not as stated, for which gravity, gyroscope and
quaternions are compared with each other.
"""

from __future__ import annotations

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
)
from swimid.inertial.setup import DEG, MOST_ACCELERATION
from swimid.logs import sampling
from swimid.logs.clock import in_order
from swimid.logs.log import runs
from swimid.logs.rotation import rearranged

#: Maximum share of rows without a usable time, and of missing cells in a channel.
MAX_MISSING = 0.5
#: Readings this many spans of all others away are wrong; single ones among `WINDOW` samples, or marks.
SPANS, WINDOW = 30.0, 7
#: A channel that keeps one value for longer than this while others move is stuck, s and samples.
STUCK_S, STUCK_SAMPLES = 0.5, 25
#: A step longer than this many sample times has lost samples; a hole longer than this, s, is refused.
LONG_STEP, MAX_HOLE_S = 1.6, 2.0

Mended = tuple[Record, list[Finding]]


def mend(record: Record) -> Mended:
    """Return the record with every fault found and repaired, and the findings.

    Raises
    ------
    InputError
        Of the first fault that cannot be repaired.
    """
    findings: list[Finding] = []
    for check in FAULTS:
        record, new = check(record)
        findings += new
    return record, findings


def bridged(record: Record, bad: Flags) -> Record:
    """Return the record with the bad samples, shape (n, 6), interpolated, and marked as filled."""
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


def _channels(flags: Flags) -> str:
    """Return the names of the channels in which a flag is set."""
    return ", ".join(name for name, bad in zip(CHANNELS, flags.T, strict=True) if bad.any())


def stamps(record: Record) -> Mended:
    """Keep the first of each repeated stamp, put late rows in place; refuse a clock that was reset."""
    order = in_order(record.time_s, dict(zip(CHANNELS, record.channels.T, strict=True)))
    if order.reset_row is not None:
        row = order.reset_row
        text = f"time goes back at t = {record.time_s[row]:g} s (sample {row + 1}) and counts on from there"
        hint = "was the clock reset or wrapped? cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    gone = order.untimed + order.repeated + order.clashing
    if gone > MAX_MISSING * len(record):
        text = f"{gone} of {len(record)} samples have no time of their own"
        hint = "the stamps are too coarse: give the time with more decimals, or by 'rate_hz' in a mapping"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    if not order.changed:
        return record, []
    text = f"{gone} samples without a time of their own left out, {order.late} out of order put in place"
    return record.take(order.index), [Finding("repeated stamps", "handled", text, gone + order.late)]


def wild(record: Record) -> Mended:
    """Take readings that no motion makes as missing: marks for "no sample", and glitches of transmission."""
    values = record.channels
    bad = np.column_stack([_wild(column) for column in values.T])
    if not bad.any():
        return record, []
    largest, count = float(np.max(np.abs(values[bad]))), int(bad.any(axis=1).sum())
    text = f"{count} samples in {_channels(bad)} that no motion makes (up to {largest:.4g}) taken as missing"
    finding = Finding("wild readings", "handled", text, count)
    return record.with_channels(np.where(bad, np.nan, values)), [finding]


def _wild(values: Array) -> Flags:
    # No sensor shows more, in any unit its readings come in.
    flags = np.abs(np.nan_to_num(values)) > 1e5
    there = np.flatnonzero(np.isfinite(values) & ~flags)
    if len(there) < 2 * WINDOW:
        return flags
    # a mark, however often it comes, is one value far from all the others
    for extreme in (float(values[there].max()), float(values[there].min())):
        others = values[there][values[there] != extreme]
        if len(others) > WINDOW and abs(extreme - np.median(others)) > SPANS * np.ptp(others) > 0:
            flags |= values == extreme
    there = np.flatnonzero(np.isfinite(values) & ~flags)
    calm = median_filter(values[there], size=WINDOW, mode="nearest")
    span = float(np.ptp(calm))
    if span > 0:
        flags[there] |= np.abs(values[there] - calm) > SPANS * span
    return flags


def missing(record: Record) -> Mended:
    """Bridge missing cells; their stretch of the path is known worse."""
    bad = ~np.isfinite(record.channels)
    share = bad.mean(axis=0)
    worst = int(np.argmax(share))
    if share[worst] > MAX_MISSING:
        text = f"{100 * share[worst]:.0f} % of the samples are missing"
        raise InputError(text, file=record.name, column=CHANNELS[worst])
    count = int(bad.any(axis=1).sum())
    if not count:
        return record, []
    text = f"{count} samples with missing cells, bridged from their neighbours"
    return bridged(record, bad), [Finding("missing cells", "handled", text, count)]


def dead(record: Record) -> Mended:
    """Refuse a dead accelerometer or gyroscope axis; bridge stuck samples; do not use a dead compass.

    A magnetometer, or an attitude, that comes at a lower rate is interpolated between its samples.
    """
    values = record.channels
    stuck = np.column_stack([_stuck(record, column) for column in values.T])
    for name, column, share in zip(CHANNELS, values.T, stuck.mean(axis=0), strict=True):
        constant = np.ptp(column) == 0
        # Maximum share of a channel that is stuck.
        if constant or share > 0.3:
            text = f"the channel is dead: one value for {100 * max(share, constant):.0f} % of the time"
            hint = "three accelerations and three turn rates are needed; mend the sensor or its wiring"
            raise InputError(text, file=record.name, column=name, hint=hint)
    texts, count = [], int(stuck.any(axis=1).sum())
    if count:
        texts.append(f"{count} samples stuck at one value in {_channels(stuck)}, bridged")
        record = bridged(record, stuck)
    field, q, t = record.magnetic, record.quaternion, record.time_s
    if field is not None:
        rows = _measured(record, field)
        if len(rows) == 0 or np.any(np.ptp(field[rows], axis=0) == 0):
            texts.append("the magnetometer is dead or has holes, not used")
            record = replace(record, magnetic=None)
        else:
            record = replace(record, magnetic=resampled(t, t[rows], field[rows]))
    if q is not None:
        rows = _measured(record, q)
        lengths = np.linalg.norm(q[rows], axis=1)
        if len(rows) == 0 or np.ptp(q[rows], axis=0).max() == 0 or np.max(np.abs(lengths - 1)) > 0.05:
            texts.append("the quaternions are constant, have holes or are not of length 1, not used")
            record = replace(record, quaternion=None)
        elif len(rows) < len(record):
            between = Slerp(t[rows], rotations(q[rows]))(np.clip(t, t[rows[0]], t[rows[-1]]))
            record = replace(record, quaternion=between.as_quat()[:, [3, 0, 1, 2]])
    return record, [Finding("dead channel", "handled", text, count) for text in texts]


def _measured(record: Record, values: Array) -> np.ndarray:
    """Return the rows in which a slower sensor has values; none where a hole is too long to bridge."""
    rows = np.flatnonzero(np.isfinite(values).all(axis=1))
    times = np.concatenate([record.time_s[:1], record.time_s[rows], record.time_s[-1:]])
    return rows if len(rows) > 1 and np.max(np.diff(times)) <= max(STUCK_S, 2 * record.step_s) else rows[:0]


def _stuck(record: Record, values: Array) -> Flags:
    """Return the long runs of one value, unless the channel is so coarse that it often repeats itself."""
    flags = np.zeros(len(values), dtype=bool)
    least = max(round(STUCK_S / record.step_s), STUCK_SAMPLES)
    for first, last in runs(np.concatenate(([False], np.diff(values) == 0))):
        if last - first < least:
            continue
        inside = np.zeros(len(values), dtype=bool)
        inside[max(first - 1, 0) : last] = True
        # at a level the channel often shows, it may just be at rest
        if not inside.all() and np.mean(values[~inside] == values[first]) < 0.01:
            flags |= inside
    return flags


def held(record: Record) -> Mended:
    """Bridge samples that repeat the one before: the logger asks faster than the sensor answers."""
    same = np.concatenate(([False], np.all(np.diff(record.channels, axis=0) == 0, axis=1)))
    count = int(same.sum())
    # Below this share samples repeat by chance, at rest and with few digits.
    if count < 0.005 * len(same) or count > 0.9 * len(same):
        return record, []
    text = f"{count} samples repeat the one before in every channel; bridged from the true ones"
    bad = np.repeat(same[:, None], 6, axis=1)
    return bridged(record, bad), [Finding("repeated samples", "handled", text, count)]


def saturated(record: Record) -> Mended:
    """Bridge clipped samples, which hide how far the motion went; refuse where they are many."""
    values = record.channels
    clipped = np.column_stack([_clipped(column) for column in values.T])
    share = clipped.mean(axis=0)
    if not share.any():
        return record, []
    worst = int(np.argmax(share))
    # Maximum share of clipped samples in a channel.
    if share[worst] > 0.1:
        limit = float(np.max(np.abs(values[:, worst])))
        text = f"{100 * share[worst]:.1f} % of the samples are clipped at {limit:.4g}"
        hint = "use a sensor, or a setting, with a larger range"
        raise InputError(text, file=record.name, column=CHANNELS[worst], hint=hint)
    count = int(clipped.any(axis=1).sum())
    text = f"{count} samples clipped at the end of the range in {_channels(clipped)}, bridged"
    return bridged(record, clipped), [Finding("saturated channel", "handled", text, count)]


def _clipped(values: Array) -> Flags:
    flags = np.zeros(len(values), dtype=bool)
    for extreme in (float(np.max(values)), float(np.min(values))):
        at = values == extreme
        held_runs = [(a, b) for a, b in runs(at) if b - a >= 2]
        # the tail of an open range thins out; a closed one is held and piles up over the last 1 %
        below = np.abs(values[~at] - extreme)
        near = below <= max(0.01 * np.ptp(values), float(np.min(below)))
        if len(held_runs) >= 3 and at.sum() > 2.0 * near.sum():
            flags |= at
    return flags


def dropped(record: Record) -> Mended:
    """Count samples that are missing; the trapezoid spans them, and the errors grow there."""
    steps = np.diff(record.time_s)
    wide = steps > LONG_STEP * record.step_s
    if not wide.any():
        return record, []
    longest = float(steps.max())
    if longest > MAX_HOLE_S:
        text = f"no samples for {longest:.2f} s after t = {record.time_s[int(np.argmax(steps))]:.3f} s"
        hint = "motion in between is unknown: cut the log there, one file for each piece"
        raise InputError(text, file=record.name, column="t_s", hint=hint)
    count = int(np.sum(np.round(steps[wide] / record.step_s) - 1))
    text = f"{count} samples dropped in {int(wide.sum())} places, the longest {longest:.3f} s; spanned"
    return record, [Finding("dropped samples", "handled", text, count)]


def jitter(record: Record) -> Mended:
    """Report uneven steps; every integral uses the samples' own stamps."""
    uneven = sampling.rate(record.time_s).jitter
    single = np.diff(record.time_s)
    single = single[single < LONG_STEP * record.step_s]
    uneven = max(uneven, float(np.std(single)) / record.step_s) if uneven else 0.0
    # Jitter worth a warning, in sample times.
    if uneven < 0.05:
        return record, []
    text = f"time steps vary by {100 * uneven:.0f} % (rms) of {1e3 * record.step_s:.3g} ms; stamps are used"
    return record, [Finding("clock jitter", "handled", text)]


# ---------------------------------------------------------------- units and axes


#: Relative deviation from 1 g at rest: sensors are off by a few percent, a swimmer that glides adds some.
NEAR = 0.12
UNITS = {"g": GRAVITY_M_S2, "mg": 1e-3 * GRAVITY_M_S2, "ft/s2": 0.3048, "cm/s2": 0.01}
#: Windows in which specific force is judged, s, and their maximum number for turn rates.
WINDOW_S, MAX_WINDOWS = 0.5, 200
#: Turns of gravity are seen between means over this long, s, so many of them apart: about a second, long
#: enough that accelerations weigh less than turns.
BLOCK_S, BLOCKS = 0.3, 3
#: Minimum number of windows that tell.
MIN_BLOCKS = 16
#: A turn of gravity over a second that can be seen, rad.
VISIBLE = 0.02
#: A unit or convention that leaves this share of what the other leaves is the right one.
CLEARLY = 0.5
#: Another arrangement of axes must leave this much less of gravity's turning than the one in the log, and
#: less than the runner-up among those that do the same to the axes that turn. An arrangement that explains
#: more than half of the turning stays: what it leaves is acceleration (a yawing swimmer's ``u r`` looks like
#: roll).
BETTER, DECIDED, EXPLAINED = 0.5, 0.8, 0.5


def acceleration_unit(record: Record) -> Mended:
    """Compare the specific force of quiet samples with gravity.

    The stated unit is believed unless quiet samples show gravity in another one. A sensor that is shaken all
    the time has no quiet samples: its unit is not doubted, because its readings can have any size.
    """
    size = _at_rest(record)
    if size is None:
        # without quiet samples gravity shows in the mean, or of a tumbling sensor in the typical size
        sizes = np.linalg.norm([record.acceleration.mean(axis=0), *record.acceleration], axis=1)
        size = float(max(sizes[0], np.median(sizes)))
        if size >= 0.5 * GRAVITY_M_S2:
            return record, []
    elif abs(size / GRAVITY_M_S2 - 1) <= NEAR:
        return record, []
    else:
        # mg and cm/s2 differ by 2 %: the nearer is taken, an error of scale at worst
        off = {name: abs(np.log(size * factor / GRAVITY_M_S2)) for name, factor in UNITS.items()}
        name = min(off, key=lambda unit: off[unit])
        if off[name] <= NEAR:
            text = f"accelerations are in {name} ({size:.4g} at rest), converted by {UNITS[name]:.6g}"
            finding = Finding("acceleration unit", "handled", text)
            return replace(record, acceleration=record.acceleration * UNITS[name]), [finding]
    hint = "say the unit in a mapping (--map)"
    if size < 0.5 * GRAVITY_M_S2:
        hint = "gravity seems to be taken out already: give the accelerometer's own readings"
    text = f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81"
    raise InputError(text, file=record.name, column="ax_m_s2 ... az_m_s2", hint=hint)


def _at_rest(record: Record) -> float | None:
    """Return the median size of the specific force in windows in which it hardly changes; None without any.

    A window is quiet where the specific force deviates from its mean by less, relative to it, than that of a
    sensor at rest may deviate from gravity.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    count = len(record) // size
    windows = record.acceleration[: count * size].reshape(count, size, 3)
    sizes = np.linalg.norm(windows.mean(axis=1), axis=1)
    quiet = np.sqrt(windows.var(axis=1).sum(axis=1)) <= MOST_ACCELERATION / GRAVITY_M_S2 * sizes
    return float(np.median(sizes[quiet])) if quiet.any() else None


def rate_unit(record: Record) -> Mended:
    """Convert turn rates that are in degrees, as judged by how gravity or the quaternions turn.

    Where neither tells, the stated unit is believed.
    """
    scale = _against_quaternion(record)
    by = "the quaternions"
    if scale is None:
        scale, by = _where_gravity_stays(record), "gravity in the accelerometer"
    if scale is None:
        scale = _against_gravity(record)
    if scale is None:
        fast = float(np.quantile(np.linalg.norm(record.rate, axis=1), 0.99))
        text = (
            f"turn rates reach {fast:.0f} rad/s as stated, and nothing else in the log tells their unit; for "
            "another one, say it in a mapping (--map)"
        )
        # Where nothing else tells the unit, faster turns (99th percentile) are doubted, rad/s.
        return record, [Finding("turn-rate unit", "handled", text)] if fast > 12.0 else []
    if abs(np.log(scale / DEG)) < abs(np.log(scale)):
        text = f"turn rates are in deg/s (judged by {by}), converted"
        return replace(record, rate=record.rate * DEG), [Finding("turn-rate unit", "handled", text)]
    return record, []


def _where_gravity_stays(record: Record) -> float | None:
    """1 or a degree: the unit that makes specific force, turned back by the turn rates, stand still.

    Holds for turns of any size and speed. None where neither is clearly better than the other and than no
    turn at all: small turns, turns about the vertical, and axes that are not what they say.
    """
    size = max(round(WINDOW_S / record.step_s), 4)
    starts = np.arange(0, len(record) - size, size)
    starts = starts[:: max(len(starts) // MAX_WINDOWS, 1)]
    left = {1.0: 0.0, DEG: 0.0, 0.0: 0.0}
    for first in starts.tolist():
        rows = slice(first, first + size)
        for factor in left:
            turned = integrated_attitude(
                record.time_s[rows], factor * record.rate[rows], Rotation.identity()
            ).apply(record.acceleration[rows])
            left[factor] += float(np.sum((turned - turned.mean(axis=0)) ** 2))
    best = min(left, key=lambda factor: left[factor])
    others = min(value for factor, value in left.items() if factor != best)
    return best if best and left[best] < CLEARLY * others else None


def _against_gravity(record: Record) -> float | None:
    """Factor from logged rates to rates that turn gravity as seen; None where it hardly turns."""
    seen, up, turned = _up_turning(record)
    if len(seen) < MIN_BLOCKS:
        return None
    expected = -np.cross(turned - np.median(turned, axis=0), up)
    seen = seen - np.median(seen, axis=0)
    power = float(np.sum(expected**2))
    if power == 0 or np.sqrt(np.mean(np.sum(seen**2, axis=1))) < VISIBLE:
        return None
    agreement = float(np.sum(expected * seen)) / np.sqrt(power * float(np.sum(seen**2)))
    if abs(agreement) < 0.5:
        return None
    return abs(float(np.sum(expected * seen)) / power)


def _against_quaternion(record: Record) -> float | None:
    if record.quaternion is None:
        return None
    stride = max(round(0.1 / record.step_s), 1)
    rotation = rotations(record.quaternion[::stride])
    steps = (rotation[:-1].inv() * rotation[1:]).as_rotvec()
    if np.sqrt(np.mean(np.sum(steps**2, axis=1))) < 1e-3:
        return None
    total = np.concatenate([[np.zeros(3)], np.cumsum(record.rate, axis=0)]) * record.step_s
    turned = np.diff(total[: len(record) : stride], axis=0)[: len(steps)]
    return float(np.sqrt(np.sum(steps**2) / max(np.sum((turned - turned.mean(axis=0)) ** 2), 1e-30)))


def axes(record: Record) -> Mended:
    """Try all 48 arrangements of the gyroscope's axes on how gravity turns in the accelerometer.

    A turn about the vertical, and one that is too small to see against accelerations, tells nothing;
    then this says that it cannot.
    """
    seen, up, turned = _up_turning(record)
    if len(seen) < MIN_BLOCKS or np.sqrt(np.mean(np.sum(seen**2, axis=1))) < VISIBLE:
        text = "the body hardly tilts: gyroscope axes cannot be held against the accelerometer's"
        return record, [Finding("swapped or flipped axes", "noted", text)]
    scores = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        left = seen + np.cross(turned[:, order] * signs, up)
        scores.append((_spread(left) / _spread(seen), order, signs))
    as_is = scores[0][0]
    (best, order, signs), (runner_up, _, _) = sorted(scores, key=lambda entry: entry[0])[:2]
    if best > BETTER * as_is or best > EXPLAINED or as_is < EXPLAINED:
        return record, []
    arrangement = ", ".join(
        f"w{'xyz'[i]} from {'-' if s < 0 else ''}w{'xyz'[o]}"
        for i, (o, s) in enumerate(zip(order, signs, strict=True))
        if o != i or s < 0
    )
    if best > DECIDED * runner_up:
        text = f"axes are swapped or flipped; the tilting does not tell which ({arrangement} fits best)"
        hint = "put the axes right in a mapping (--map), with factor -1 for a flipped one"
        raise InputError(text, file=record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    text = (
        f"the gyroscope's axes do not fit the accelerometer's: {arrangement} leaves {100 * best:.0f} % of "
        f"gravity's turning unexplained, as logged {100 * as_is:.0f} %; rearranged so"
    )
    return replace(record, rate=record.rate[:, order] * np.asarray(signs)), [
        Finding("swapped or flipped axes", "handled", text)
    ]


def _spread(values: Array) -> float:
    return float(np.sum((values - values.mean(axis=0)) ** 2))


def quaternions(record: Record) -> Mended:
    """Compare the turns of the quaternions with those of the gyroscope; leave them aside if they contradict.

    Each order of the elements, with each direction, is tried. A convention that leaves less than half of the
    difference that the one in the log leaves is named.
    """
    if record.quaternion is None:
        return record, []
    size = max(round(BLOCK_S / record.step_s), 1)
    sensed = _turns(integrated_attitude(record.time_s, record.rate, Rotation.identity())[::size])
    if len(sensed) < MIN_BLOCKS:
        return record, []
    every = record.quaternion[::size]
    left = {}
    for order, direction in product(("wxyz", "xyzw"), ("body-to-world", "world-to-body")):
        told = _turns(rotations(rearranged(every, order, direction)))
        left[order, direction] = float(np.sum((told - sensed) ** 2))
    as_is = left["wxyz", "body-to-world"]
    order, direction = min(left, key=lambda name: left[name])
    if left[order, direction] >= CLEARLY * as_is:
        return record, []
    power = float(np.sum(sensed**2))
    stated = [f"order: {order}"] * (order != "wxyz") + [f"direction: {direction}"] * (
        direction != "body-to-world"
    )
    text = (
        f"the quaternions turn otherwise than the gyroscope: as wxyz from body to world they differ by "
        f"{100 * as_is / power:.0f} % of its turning, as {order} from {direction.replace('-', ' ')} by "
        f"{100 * left[order, direction] / power:.0f} %; they are not used. State their convention in a "
        f"mapping (--map) with the line 'quaternion: {{{', '.join(stated)}}}'"
    )
    return replace(record, quaternion=None), [Finding("quaternions", "refuted", text)]


def _turns(rotation: Rotation) -> Array:
    """Return the turns from each attitude to the next about body axes, rad, shape (n - 1, 3)."""
    return np.asarray((rotation[:-1].inv() * rotation[1:]).as_rotvec())


def _up_turning(record: Record) -> tuple[Array, Array, Array]:
    """Return how the direction of gravity turns in the sensor, by accelerometer and by gyroscope.

    Returns
    -------
    seen : ndarray, shape (m, 3)
        Change of the unit vector of specific force over each window, slowly varying parts only.
    up, turned : ndarray, shape (m, 3)
        That vector, and the integral of the turn rate over each window: the change should be
        ``-turned x up``.
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


#: A new fault is a function here that returns the record, repaired where it can be, and findings, or raises
#: an InputError.
FAULTS = (
    stamps,
    wild,
    missing,
    dead,
    held,
    saturated,
    acceleration_unit,
    dropped,
    jitter,
    rate_unit,
    axes,
    quaternions,
)
