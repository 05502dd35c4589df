"""Motion from an inertial unit and another log of the same trial, a camera's for instance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError, NoTrustworthyResult
from swimid.inertial import aiding, alignment, clock, plausible, smoother
from swimid.inertial.aiding import Fixes, Seen
from swimid.inertial.alignment import Fit, Poses
from swimid.inertial.alone import (
    STRONG,
    Declared,
    Stillness,
    attitude_sd,
    common_aids,
    lever_to_reference,
    shown_class,
    without,
)
from swimid.inertial.attitude import Source, still_rate
from swimid.inertial.clock import Offset
from swimid.inertial.errorstate import CLOCK
from swimid.inertial.faults.base import Finding
from swimid.inertial.mounting import Mount
from swimid.inertial.record import Array, Record
from swimid.inertial.sensor import DEG, Sensor
from swimid.inertial.smoother import Aid, Mounting, Smoothed, Start
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
#: More fixes than this share beyond the gate: not they are wrong, but the path they are held against.
FEW = 0.05
#: Errors of fixes that last widen a band by this much before they are warned of: four tell no more than one.
LASTING = 2.0
#: Fixes foretold worse than by this many of their deviations (rms) do not move with the sensor.
FORETOLD = 1.5
#: A clock that is held, s; fixes that are left out together, s, and how few tell nothing.
HELD_CLOCK_SD, HOLD_S, FEWEST_HELD_OUT = 1e-9, 0.5, 20
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
    agree : bool
        Whether clocks that agree explain both logs as well as an offset does (Bayesian information
        criterion).
    fixes : Fixes
        With the noise and the weights they were found to have.
    stray : int
        Fixes beyond :data:`swimid.inertial.aiding.GATE` deviations.
    lasting : float
        What errors of the fixes that last widen every band by; 1 where each is off by itself.
    held_out : HeldOut or None
        None where there are too few fixes to leave some out.
    still : Stillness
        With the rests that were believed.
    sensor : Sensor
        With the errors the logs show it to have.
    findings : list of Finding
    impossible : list of str
        Why none of it can be; empty where it can.
    """

    smoothed: Smoothed
    clocks: Fit
    offset: Offset
    agree: bool
    fixes: Fixes
    stray: int
    lasting: float
    held_out: HeldOut | None
    still: Stillness
    sensor: Sensor
    findings: list[Finding]
    impossible: list[str]


@dataclass(frozen=True)
class HeldOut:
    """How well fixes that were left out are foretold.

    Attributes
    ----------
    count : int
    rms_m : float
        Of position, every coordinate; NaN without positions.
    deviations : float
        Rms in the deviations that were stated; every band is widened by it where it is more than 1.
    """

    count: int
    rms_m: float
    deviations: float


@dataclass(frozen=True)
class _Problem:
    """Both logs, and everything that is known before they are smoothed together."""

    record: Record
    source: Source
    still: Stillness
    poses: Poses
    mount: Mount
    rotation: Rotation
    mount_sd: float
    declared: Declared
    fix_sd_m: float | None
    counted: np.ndarray
    advance: Callable[[], None]


@dataclass(frozen=True)
class _Trial:
    """One smoothing of both logs: with a held clock, or a free one."""

    smoothed: Smoothed
    fixes: Fixes
    sensor: Sensor
    source: Source

    @property
    def likelihood(self) -> float:
        return self.smoothed.errors.likelihood


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

    An offset between the clocks has to earn its place: clocks that agree compete with every offset found, and
    win where it does not make both logs clearly likelier. Bands are held against fixes that were left out.

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
    poses, clocks, findings, refusal = _clocks(record, source, poses, clock_offset_s)
    findings += _handedness(record, clocks[0])
    rotation, mount_sd, told = _mount(mount, clocks[0])
    counted = _inside_for_all(record, poses, clocks)
    problem = _Problem(
        record, source, still, poses, mount, rotation, mount_sd, declared, fix_sd_m, counted, advance
    )
    trial, offset, agree = _set_clocks(problem, clocks, sensor, clock_offset_s)
    wrong = _contradictions(problem, trial)
    if wrong and still.used:
        fewer = replace(problem, still=without(still, still.used))
        again = _set_clocks(fewer, clocks, sensor, clock_offset_s)
        if not _contradictions(fewer, again[0]):
            (trial, offset, agree), problem = again, fewer
            findings.append(Finding("rests", "handled", f"{'; '.join(wrong)}: none is used"))
            wrong = []
    findings += shown_class(sensor, trial.sensor)
    held_out = _hold_out(problem, trial, clock_offset_s is not None or agree)
    if refusal is not None and not _foretold(held_out, poses):
        raise refusal
    lasting = _lasting(trial)
    factor = lasting * (1.0 if held_out is None else max(held_out.deviations, 1.0))
    offset = replace(
        offset,
        stderr_s=factor * offset.stderr_s,
        low_s=offset.value_s - factor * (offset.value_s - offset.low_s),
        high_s=offset.value_s + factor * (offset.high_s - offset.value_s),
    )
    stray = int(np.sum((trial.fixes.place_weight < 1) | (trial.fixes.turn_weight < 1)))
    return Fused(
        smoother.widened(trial.smoothed, factor),
        clocks[0],
        offset,
        agree,
        trial.fixes,
        stray,
        lasting,
        held_out,
        problem.still,
        trial.sensor,
        [*findings, *told],
        wrong,
    )


def _set_clocks(
    problem: _Problem, clocks: list[Fit], sensor: Sensor, given_s: float | None
) -> tuple[_Trial, Offset, bool]:
    """The likeliest of clocks that agree and of every offset found; whether they agree."""
    if given_s is not None:
        trial = _smooth(problem, given_s, sensor, held=True)
        return trial, _offset(trial.smoothed, clocks[0]), False
    starts: list[Offset] = []
    for fit in clocks:
        apart = [
            abs(fit.offset.value_s - s.value_s) / np.hypot(fit.offset.stderr_s, s.stderr_s) for s in starts
        ]
        if all(distance > BAND for distance in apart):
            starts.append(fit.offset)
    free = max(
        (_smooth(problem, start.value_s, sensor, held=False) for start in starts),
        key=lambda trial: trial.likelihood,
    )
    if not problem.counted.any():
        return free, _offset(free.smoothed, clocks[0]), False
    # Schwarz (1978, doi:10.1214/aos/1176344136): an offset is one number more
    price = 0.5 * float(np.log(problem.counted.sum()))
    if abs(free.smoothed.path.clock_s) <= BAND * CLOCK_SD:
        agreeing = _smooth(problem, 0.0, free.sensor, held=True, after=free)
    else:
        agreeing = _smooth(problem, 0.0, sensor, held=True)
        if free.likelihood <= agreeing.likelihood + price:
            free = _smooth(problem, 0.0, agreeing.sensor, held=False, after=agreeing)
    offset = _offset(free.smoothed, clocks[0])
    if free.likelihood > agreeing.likelihood + price:
        return free, offset, False
    low, high = min(offset.low_s, 0.0), max(offset.high_s, 0.0)
    return agreeing, replace(offset, value_s=0.0, low_s=low, high_s=high), True


def _smooth(
    problem: _Problem, offset_s: float, sensor: Sensor, *, held: bool, after: _Trial | None = None
) -> _Trial:
    """Smooth both logs, the clock held or free; noise, weights and the sensor's class from what is left."""
    start, mounting, turned, aids = _begin(problem, offset_s)
    firm = replace(mounting, clock_sd=HELD_CLOCK_SD)
    fixes = _fixes(problem) if after is None else _unweighted(after.fixes)

    def smooth(
        sensor: Sensor, mounting: Mounting, fixes: Fixes, after: Smoothed | None, passes: int, gate: float
    ) -> Smoothed:
        known = aids(sensor)
        return smoother.run(
            problem.record,
            start,
            mounting,
            sensor,
            problem.still.noise,
            [*known, aiding.fixes(fixes, gate)],
            fused=True,
            after=after,
            passes=passes,
            advance=problem.advance,
        )

    def settled(smoothed: Smoothed, sensor: Sensor, fixes: Fixes) -> _Trial:
        moving, shown = firm if held else mounting, sensor
        for turn in range(NOISE_TURNS):
            better = _noise_seen(smoothed, fixes, problem.fix_sd_m) if after is None or turn else fixes
            change = np.abs(
                np.log(
                    np.append(better.position_sd / fixes.position_sd, better.rotation_sd / fixes.rotation_sd)
                )
            )
            if turn > 1 and np.nanmax(change) < SETTLED:
                break
            fixes = better
            smoothed = smooth(shown, moving, fixes, smoothed, 1, np.inf)
            if turn != 1 or after is not None:
                continue
            stated = smoothed
            for other in sensor.classes().values():
                attempt = smooth(other, moving, fixes, stated, 1, np.inf) if other != sensor else stated
                gain = attempt.errors.likelihood - smoothed.errors.likelihood
                if gain > (STRONG if smoothed is stated else 0.0):
                    smoothed, shown = attempt, other
        return _Trial(smoothed, fixes, shown, turned)

    if after is not None:
        return settled(smoother.with_clock(after.smoothed, offset_s), sensor, fixes)
    # while the path is not yet known the clock is held: what an offset does is a matter of velocity
    smoothed = smooth(sensor, firm, fixes, None, 2, aiding.GATE)
    gated = settled(smoothed, sensor, fixes)
    if sum(smoothed.errors.rejected.values()) <= FEW * len(fixes.time_s):
        return gated
    # a gate that shuts out many: either they are wrong, or the path they were held against was
    smoothed = smooth(sensor, firm, fixes, None, 2, np.inf)
    return max(gated, settled(smoothed, sensor, fixes), key=lambda trial: trial.likelihood)


def _begin(
    problem: _Problem, offset_s: float
) -> tuple[Start, Mounting, Source, Callable[[Sensor], list[Aid]]]:
    """Where the search begins with this offset, and everything known besides the fixes."""
    record, source, poses, declared = problem.record, problem.source, problem.poses, problem.declared
    on_record = replace(poses, time_s=poses.time_s + offset_s)
    turn = _world_turn(record, source, on_record, problem.rotation)
    first = np.flatnonzero(np.isfinite(poses.position).any(axis=1))
    place = np.nan_to_num(poses.position[first[0]]) if len(first) else np.zeros(3)
    start = Start(
        turn * source.rotation,
        position=place,
        position_sd=1.0 + float(np.max(np.nan_to_num(np.ptp(poses.position[first], axis=0))))
        if len(first)
        else 1.0,
        velocity_sd=1.0,
        rotation_sd=(0.05, 0.05, 0.05 if poses.yaw is not None else 0.2),
        rate_bias=still_rate(record, problem.still.found),
    )
    mounting = Mounting(
        problem.rotation,
        lever_to_reference(Mount(problem.rotation, "", problem.mount.up), declared),
        problem.mount_sd,
        LEVER_SD if declared.lever_m is None else 1e-3,
        TILT_SD,
        offset_s,
        CLOCK_SD,
    )
    turned = Source(turn * source.rotation, False, source.kind)

    def aids(sensor: Sensor) -> list[Aid]:
        return common_aids(record, turned, problem.still, sensor, declared)

    return start, mounting, turned, aids


def _contradictions(problem: _Problem, trial: _Trial) -> list[str]:
    found = plausible.contradictions(
        problem.record,
        trial.smoothed,
        problem.still.used,
        trial.source,
        attitude_sd(trial.source, trial.sensor),
    )
    weights = trial.fixes.place_weight[np.isfinite(trial.fixes.position).any(axis=1)]
    if len(weights) and np.mean(weights < 1) > 0.5:
        found.append(
            f"{100 * np.mean(weights < 1):.0f} % of the fixes lie beyond {aiding.GATE:g} deviations of it"
        )
    return found


def _hold_out(problem: _Problem, trial: _Trial, held: bool) -> HeldOut | None:
    """Foretell every fourth block of fixes from the others.

    Blocks last half a second, so that neighbours do not give a fix away.
    """
    t = trial.fixes.time_s
    block = np.floor((t - t[0]) / HOLD_S).astype(int)
    if len(t) > 1 and np.median(np.diff(t)) > HOLD_S:
        block = np.arange(len(t))
    out = block % 4 == 2
    there = np.isfinite(trial.fixes.position).any(axis=1) | trial.fixes.turns.any(axis=1)
    if np.sum(out & there) < FEWEST_HELD_OUT:
        return None
    start, mounting, _, aids = _begin(problem, trial.smoothed.path.clock_s)
    smoothed = smoother.run(
        problem.record,
        start,
        replace(mounting, clock_sd=HELD_CLOCK_SD) if held else mounting,
        trial.sensor,
        problem.still.noise,
        [*aids(trial.sensor), aiding.fixes(trial.fixes.take(~out))],
        fused=True,
        after=trial.smoothed,
        passes=1,
        advance=problem.advance,
    )
    squares: list[float] = []
    places: list[float] = []
    covariance = smoothed.errors.covariance
    left_out = trial.fixes.take(out)
    for one in aiding.against(left_out, smoothed.path, smoothed.nodes, covariance.shape[1]):
        o, seen = one.observation, _measured(left_out, one)
        # stray fixes weigh as little as in the smoothing
        spread = np.einsum("ij,jk,ik->i", o.sensitivity, covariance[o.node], o.sensitivity) + o.sd**2
        squares += (o.residual**2 / spread)[seen].tolist()
        places += o.residual[seen].tolist() if o.kind == "position" else []
    rms = float(np.sqrt(np.mean(np.square(places)))) if places else np.nan
    return HeldOut(int(np.sum(out & there)), rms, float(np.sqrt(np.mean(squares))))


def _clocks(
    record: Record, source: Source, poses: Poses, given: float | None
) -> tuple[Poses, list[Fit], list[Finding], NoTrustworthyResult | None]:
    """Offsets found, the surest first; the sign of pitch turned where turns fit better so.

    Where none is found the clocks are taken to agree, and the refusal is kept until fixes that are left out
    have told whether the logs move together.
    """
    if given is not None:
        return poses, [alignment.fit_at(record, source, poses, given)], [], None
    try:
        fits = alignment.fit_clocks(record, source, poses)
    except NoTrustworthyResult as refusal:
        return poses, [alignment.fit_at(record, source, poses, 0.0)], [], refusal
    fit = fits[0]
    if not poses.full or fit.by != "turn rates":
        return poses, fits, [], None
    turned = poses.with_pitch_turned()
    others = alignment.fit_clocks(record, source, turned)
    other = others[0]
    if other.by == fit.by and other.offset.explained > fit.offset.explained + 0.05 and other.handed >= 0:
        text = "pitch in the other log counts nose down as positive; its sign is turned"
        return turned, others, [Finding("sign of pitch", "handled", text)], None
    return poses, fits, [], None


def _inside_for_all(record: Record, poses: Poses, clocks: list[Fit]) -> np.ndarray:
    """Fixes within the record by every clock, shape (m,): likelihoods are compared over the same ones."""
    offsets = [0.0, *(fit.offset.value_s for fit in clocks)]
    margin = BAND * CLOCK_SD
    first = poses.time_s + min(offsets) - margin >= record.time_s[0]
    return np.asarray(first & (poses.time_s + max(offsets) + margin <= record.time_s[-1]))


def _foretold(held_out: HeldOut | None, poses: Poses) -> bool:
    """Whether fixes that were left out come out well enough to say that both logs move together."""
    if held_out is None or not np.isfinite(held_out.rms_m) or held_out.deviations > FORETOLD:
        return False
    there = np.isfinite(poses.position)
    rows = there[:, there.any(axis=0)].all(axis=1)
    fast = clock.without_slow(
        poses.time_s[rows], poses.position[rows][:, there.any(axis=0)], alignment.SLOW_WAY_S
    )
    return held_out.rms_m**2 < (1 - alignment.LEAST_EXPLAINED) * float(np.mean(fast**2))


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


def _fixes(problem: _Problem) -> Fixes:
    poses, fix_sd_m = problem.poses, problem.fix_sd_m
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
    weight = np.ones(len(poses.time_s))
    return Fixes(
        poses.time_s,
        position,
        sd,
        poses.rotation if seen else None,
        turns,
        rotation_sd,
        weight,
        weight,
        problem.counted,
    )


def _unweighted(fixes: Fixes) -> Fixes:
    weight = np.ones(len(fixes.time_s))
    return replace(fixes, place_weight=weight, turn_weight=weight)


def _measured(fixes: Fixes, one: Seen) -> np.ndarray:
    """Which rows of an observation were measured, shape (k,); a plane taken for granted is not."""
    if one.observation.kind != "position":
        return np.ones(len(one.observation.residual), dtype=bool)
    return np.asarray((fixes.position_sd != PLANE_SD)[np.isfinite(fixes.position[one.index])])


def _lasting(trial: _Trial) -> float:
    """By how much errors of the fixes that last make a mean of them worse than if each were off by itself.

    The root of the integrated autocorrelation of what is left of them, summed while it is positive (initial
    sequence of Geyer 1992, doi:10.1214/ss/1177011137).
    """
    seen = aiding.against(
        _unweighted(trial.fixes),
        trial.smoothed.path,
        trial.smoothed.nodes,
        trial.smoothed.errors.mean.shape[1],
    )
    left: dict[tuple[str, int], list[float]] = {}
    for one in seen:
        weight = trial.fixes.place_weight if one.observation.kind == "position" else trial.fixes.turn_weight
        if weight[one.index] == 1:
            residual = one.observation.residual[_measured(trial.fixes, one)]
            for axis, value in enumerate(residual.tolist()):
                left.setdefault((one.observation.kind, axis), []).append(value)
    longest = 1.0
    for values in left.values():
        x = np.asarray(values) - np.mean(values)
        power = float(x @ x)
        if len(x) < FEWEST_HELD_OUT or power == 0:
            continue
        total = 1.0
        for lag in range(1, len(x) // 4):
            shared = float(x[lag:] @ x[:-lag]) / power
            if shared <= 0:
                break
            total += 2 * shared
        longest = max(longest, total)
    return float(np.sqrt(longest))


def _noise_seen(smoothed: Smoothed, fixes: Fixes, fix_sd_m: float | None) -> Fixes:
    """Noise and weights of the fixes by what is left of them.

    Noise by one step of expectation-maximisation (Shumway and Stoffer 1982, sec. 3) over those that are not
    stray. A stray one keeps a weight that falls with the square of its distance (the redescending weights of
    Cauchy's kind): none is shut out, so that a path gone astray finds back.
    """
    covariance = smoothed.errors.covariance
    seen = aiding.against(_unweighted(fixes), smoothed.path, smoothed.nodes, covariance.shape[1])
    count = len(fixes.time_s)
    residual = {kind: np.full((count, 3), np.nan) for kind in ("position", "orientation")}
    spread = {kind: np.full((count, 3), np.nan) for kind in residual}
    for one in seen:
        o = one.observation
        measured = np.isfinite(fixes.position[one.index]) if o.kind == "position" else fixes.turns[one.index]
        residual[o.kind][one.index, measured] = o.residual
        spread[o.kind][one.index, measured] = np.einsum(
            "ij,jk,ik->i", o.sensitivity, covariance[o.node], o.sensitivity
        )
    sd, place_weight = _noise_and_weight(residual["position"], spread["position"], fixes.position_sd)
    known = (fixes.position_sd == PLANE_SD) | ~np.isfinite(sd) | (fix_sd_m is not None)
    sd = np.where(known, fixes.position_sd, np.maximum(np.nan_to_num(sd), LEAST_M))
    turn_sd, turn_weight = _noise_and_weight(
        residual["orientation"], spread["orientation"], np.full(3, fixes.rotation_sd)
    )
    turns = turn_sd[np.isfinite(turn_sd)]
    rotation_sd = max(float(np.sqrt(np.mean(turns**2))), LEAST_RAD) if len(turns) else fixes.rotation_sd
    return replace(
        fixes, position_sd=sd, rotation_sd=rotation_sd, place_weight=place_weight, turn_weight=turn_weight
    )


def _noise_and_weight(residual: Array, spread: Array, sd: Array) -> tuple[Array, Array]:
    """Deviation of every column, shape (3,), NaN where there is none, and the weight of every row."""
    there = np.isfinite(residual)
    usual = np.full(3, np.nan)
    for axis in np.flatnonzero(there.any(axis=0)):
        usual[axis] = np.median(np.abs(residual[there[:, axis], axis])) / 0.6745
    far = np.abs(residual) / np.fmax(sd, usual)
    farthest = np.max(np.where(there, far, 0.0), axis=1)
    weight = np.minimum(1.0, (aiding.GATE / np.maximum(farthest, 1e-12)) ** 2)
    counted = np.where(weight[:, None] == 1, residual**2 + spread, np.nan)
    return np.sqrt(_mean_square(counted)), weight


def _mean_square(squares: Array) -> Array:
    there = np.isfinite(squares)
    return np.where(there.any(axis=0), np.nansum(squares, axis=0) / np.maximum(there.sum(axis=0), 1), np.nan)


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
