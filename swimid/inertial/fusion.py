"""Motion from an inertial unit and another log of the same trial, a camera's for instance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.inertial import aiding, alignment, smoother
from swimid.inertial.aiding import Fixes
from swimid.inertial.alignment import Fit, Poses
from swimid.inertial.alone import Declared, Stillness, common_aids, lever_to_reference
from swimid.inertial.attitude import Source, still_rate
from swimid.inertial.clock import Offset
from swimid.inertial.errorstate import CLOCK, P, T
from swimid.inertial.faults.base import Finding
from swimid.inertial.mounting import Mount
from swimid.inertial.record import Array, Record
from swimid.inertial.sensor import DEG, Sensor
from swimid.inertial.smoother import Mounting, Smoothed, Start
from swimid.inertial.trust import BAND

#: Deviations before anything is seen: lever, m; mounting, rad; tilt of the other log's world, rad;
#: its clock, s.
LEVER_SD, MOUNT_SD, FITTED_MOUNT_SD, TILT_SD, CLOCK_SD = 0.3, 3 * DEG, 6 * DEG, 2 * DEG, 0.05
#: A planar log: the reference point stays in its plane this well, m.
PLANE_SD = 0.05
#: Least noise of a fix, m and rad, and turns of estimating it.
LEAST_M, LEAST_RAD, NOISE_TURNS = 1e-4, 1e-3, 3
#: Noise estimates that change by less than this share are settled.
SETTLED = 0.1
#: Mounting within this of what was given or told by gravity counts as the same, rad.
SAME_MOUNT = 15 * DEG


@dataclass(frozen=True)
class Fused:
    """The smoothed motion, and what fusing told.

    Attributes
    ----------
    smoothed : Smoothed
    clocks : Fit
        From the comparison of the two logs before fusing.
    offset : Offset
        Of the fused motion itself: the final answer.
    fixes : Fixes
        With the noise they were found to have.
    findings : list of Finding
    """

    smoothed: Smoothed
    clocks: Fit
    offset: Offset
    fixes: Fixes
    findings: list[Finding]


def run(
    record: Record,
    source: Source,
    still: Stillness,
    mount: Mount,
    poses: Poses,
    sensor: Sensor,
    declared: Declared,
    *,
    clock_offset_s: float | None = None,
    fix_sd_m: float | None = None,
    advance: Callable[[], None] = lambda: None,
) -> Fused:
    """Set the clocks, place the sensor, and smooth both logs together.

    Parameters
    ----------
    clock_offset_s : float, optional
        What to add to the other log's times, where it is known; estimated without it.
    fix_sd_m : float, optional
        Noise of its positions, m; estimated without it.

    Raises
    ------
    NoTrustworthyResult
        The two logs do not move together.
    InputError
        Axes mirrored against the other log.
    """
    poses, clocks, findings = _clocks(record, source, poses, clock_offset_s)
    findings += _handedness(record, clocks)
    on_record = replace(poses, time_s=poses.time_s + clocks.offset.value_s)
    rotation, mount_sd, told = _mount(mount, clocks)
    findings += told
    turn = _world_turn(record, source, on_record, rotation)
    fixes = _fixes(poses, fix_sd_m)
    first = np.flatnonzero(np.isfinite(poses.position).any(axis=1))
    place = np.nan_to_num(poses.position[first[0]]) if len(first) else np.zeros(3)
    heading_sd = 0.05 if poses.yaw is not None else 0.2
    start = Start(
        turn * source.rotation[0],
        position=place,
        position_sd=1.0 + float(np.max(np.nan_to_num(np.ptp(poses.position[first], axis=0))))
        if len(first)
        else 1.0,
        velocity_sd=1.0,
        rotation_sd=(0.05, 0.05, heading_sd),
        rate_bias=still_rate(record, still.found),
    )
    mounting = Mounting(
        rotation,
        lever_to_reference(Mount(rotation, "", mount.up), declared),
        mount_sd,
        LEVER_SD if declared.lever_m is None else 1e-3,
        TILT_SD,
        clocks.offset.value_s,
        CLOCK_SD if clock_offset_s is None else 1e-6,
    )
    turned = Source(turn * source.rotation, False, source.kind)
    aids = common_aids(record, turned, still, sensor, declared)
    smoothed: Smoothed | None = None
    for turn_number in range(NOISE_TURNS):
        smoothed = smoother.run(
            record,
            start,
            mounting,
            sensor,
            still.noise,
            [*aids, aiding.fixes(fixes)],
            fused=True,
            after=smoothed,
            passes=2 if smoothed is None else 1,
            advance=advance,
        )
        if turn_number == NOISE_TURNS - 1:
            break
        better = _noise_seen(smoothed, fixes, fix_sd_m)
        change = np.abs(
            np.log(np.append(better.position_sd / fixes.position_sd, better.rotation_sd / fixes.rotation_sd))
        )
        if np.nanmax(change) < SETTLED:
            break
        fixes = better
    assert smoothed is not None
    return Fused(smoothed, clocks, _offset(smoothed, clocks), fixes, findings)


def _clocks(
    record: Record, source: Source, poses: Poses, given: float | None
) -> tuple[Poses, Fit, list[Finding]]:
    """Clocks set; the sign of pitch turned where turns fit better so."""
    if given is not None:
        return poses, alignment.fit_at(record, source, poses, given), []
    fit = alignment.fit_clocks(record, source, poses)
    if not poses.full or fit.by != "turn rates":
        return poses, fit, []
    turned = poses.with_pitch_turned()
    other = alignment.fit_clocks(record, source, turned)
    if other.by == fit.by and other.offset.explained > fit.offset.explained + 0.05 and other.handed >= 0:
        text = "pitch in the other log counts nose down as positive; its sign is turned"
        return turned, other, [Finding("sign of pitch", "handled", text)]
    return poses, fit, []


def _handedness(record: Record, fit: Fit) -> list[Finding]:
    if fit.handed < 0:
        raise InputError(
            "its turns are the mirror image of those in the other log: an axis is flipped in one of them",
            file=record.name,
            column="wx_rad_s ... wz_rad_s",
            hint="put the axes right in a mapping (--map), with factor -1 for a flipped one",
        )
    return []


def _mount(mount: Mount, fit: Fit) -> tuple[Rotation, float, list[Finding]]:
    """Where to start the mounting: given ones stay; three angles tell it; else by gravity."""
    if mount.by == "given":
        return mount.rotation, 0.5 * DEG, []
    if fit.mount is None:
        return mount.rotation, MOUNT_SD, []
    off = float((fit.mount * mount.rotation.inv()).magnitude())
    if off <= SAME_MOUNT:
        return fit.mount, FITTED_MOUNT_SD, []
    text = (
        f"the sensor is turned by {off / DEG:.0f} deg against the body of the other log; its turns tell how"
    )
    return fit.mount, FITTED_MOUNT_SD, [Finding("swapped or flipped axes", "handled", text)]


def _world_turn(record: Record, source: Source, poses: Poses, mount: Rotation) -> Rotation:
    """From the source's world to the other log's: by its angles, else by the shapes of the two paths."""
    if poses.yaw is not None:
        return alignment.world_turn(source, record, poses, mount)
    return alignment.turn_of_paths(record, source, poses)


def _fixes(poses: Poses, fix_sd_m: float | None) -> Fixes:
    position = poses.position.copy()
    sd = np.array([alignment.noise(position[:, k], LEAST_M) for k in range(3)])
    # between sparse fixes the third difference holds motion too: the start is no more than a centimetre
    sd = np.minimum(sd, 0.01) if fix_sd_m is None else np.full(3, fix_sd_m)
    for axis in (1, 2):
        if not np.isfinite(position[:, axis]).any():
            there = np.isfinite(position).any(axis=1)
            position[there, axis] = 0.0
            sd[axis] = PLANE_SD
    seen = [a for a in (poses.roll, poses.pitch, poses.yaw) if a is not None]
    turns = np.zeros((len(poses.time_s), 3), dtype=bool)
    if poses.full:
        turns[:] = poses.turned[:, None]
    elif poses.yaw is not None:
        turns[:, 2] = poses.turned
    elif poses.pitch is not None:
        turns[:, 1] = poses.turned
    rotation_sd = min(max((alignment.noise(a, LEAST_RAD) for a in seen), default=LEAST_RAD), 0.1)
    return Fixes(poses.time_s, position, sd, poses.rotation if seen else None, turns, rotation_sd)


def _noise_seen(smoothed: Smoothed, fixes: Fixes, fix_sd_m: float | None) -> Fixes:
    """Noise of the fixes by one step of expectation-maximisation (Shumway and Stoffer 1982, sec. 3)."""
    path, covariance = smoothed.path, smoothed.errors.covariance
    states = covariance.shape[1]
    nodes = smoothed.nodes
    squares: dict[str, list[Array]] = {"position": [], "orientation": []}
    for o in aiding.fixes(fixes)(path, nodes, states):
        spread = np.einsum("ij,jk,ik->i", o.sensitivity, covariance[o.node], o.sensitivity)
        full = np.full(3, np.nan)
        part = P if o.kind == "position" else T
        axes = np.array([int(np.argmax(row[part])) for row in o.sensitivity])
        value = o.residual**2 + spread
        full[axes] = np.where(value < (6 * o.sd) ** 2 * 4, value, np.nan)
        squares[o.kind].append(full)
    sd = fixes.position_sd
    if squares["position"] and fix_sd_m is None:
        mean = _mean_square(squares["position"])
        planar = ~np.isfinite(mean) | (fixes.position_sd == PLANE_SD)
        sd = np.where(planar, sd, np.maximum(np.sqrt(np.where(planar, 1.0, mean)), LEAST_M))
    rotation_sd = fixes.rotation_sd
    if squares["orientation"]:
        rotation_sd = max(float(np.sqrt(np.nanmean(_mean_square(squares["orientation"])))), LEAST_RAD)
    return replace(fixes, position_sd=sd, rotation_sd=rotation_sd)


def _mean_square(rows: list[Array]) -> Array:
    stacked = np.array(rows)
    there = np.isfinite(stacked)
    return np.where(there.any(axis=0), np.nansum(stacked, axis=0) / np.maximum(there.sum(axis=0), 1), np.nan)


def _offset(smoothed: Smoothed, clocks: Fit) -> Offset:
    """The clock offset with the whole motion, widened where the innovations are larger than stated."""
    scores = [
        s[np.isfinite(s)] for k, s in smoothed.errors.scores.items() if k in ("position", "orientation")
    ]
    widening = max(float(np.sqrt(np.mean(np.concatenate(scores) ** 2))), 1.0) if scores else 1.0
    value = smoothed.path.clock_s
    sd = widening * float(np.sqrt(smoothed.errors.covariance[-1][CLOCK, CLOCK]))
    return replace(
        clocks.offset, value_s=value, stderr_s=sd, low_s=value - BAND * sd, high_s=value + BAND * sd
    )
