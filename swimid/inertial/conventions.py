"""Units and axes that are not as stated: gravity, gyroscope and quaternions compared with each other."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.inertial import strapdown
from swimid.inertial.record import GRAVITY_M_S2, Array, Finding, Record, rotations
from swimid.inertial.rest import MOST_ACCELERATION
from swimid.inertial.sensor import DEG
from swimid.logs.rotation import rearranged

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
#: Where nothing else tells the unit, faster turns (99th percentile) are doubted, rad/s.
FASTEST = 12.0
#: A turn of gravity over a second that can be seen, rad.
VISIBLE = 0.02
#: A unit or convention that leaves this share of what the other leaves is the right one.
CLEARLY = 0.5
#: Another arrangement of axes must leave this much less of gravity's turning than the one in the log, and
#: less than the runner-up among those that do the same to the axes that turn. An arrangement that explains
#: more than half of the turning stays: what it leaves is acceleration (a yawing swimmer's ``u r`` looks like
#: roll).
BETTER, DECIDED, EXPLAINED = 0.5, 0.8, 0.5

Mended = tuple[Record, list[Finding]]


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
    raise InputError(
        f"the typical size of the acceleration is {size:.4g} m/s2, where gravity alone makes 9.81",
        file=record.name,
        column="ax_m_s2 ... az_m_s2",
        hint=hint,
    )


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
        return record, [Finding("turn-rate unit", "handled", text)] if fast > FASTEST else []
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
            turned = strapdown.attitude(
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
        raise InputError(
            "the gyroscope's axes do not fit the accelerometer's (some are swapped or flipped), and the "
            f"tilting in this log does not tell which; {arrangement} fits best",
            file=record.name,
            column="wx_rad_s ... wz_rad_s",
            hint="put the axes right in a mapping (--map), with factor -1 for a flipped one",
        )
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
    sensed = _turns(strapdown.attitude(record.time_s, record.rate, Rotation.identity())[::size])
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
