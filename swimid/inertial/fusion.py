"""Motion from an inertial unit and another log of the same trial, for instance from a camera.

The poses in the other log are called fixes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError, NoTrustworthyResult
from swimid.inertial import alignment, alone, smoother
from swimid.inertial.alignment import Alignment, Offset
from swimid.inertial.alone import GATE, Estimate, class_findings, most_likely_class
from swimid.inertial.record import Array, Finding, Flags, Poses, resampled, turn_to_angles
from swimid.inertial.setup import BAND, DEG, Sensor, Setup
from swimid.inertial.smoother import Nominal, Observation, Prior, Smoothed, State, jacobian
from swimid.logs.kinematics import angles
from swimid.logs.sampling import white_noise_sd

#: Standard deviations before any observation: lever, m; mounting from gravity and from rotations, rad; tilt
#: of the world of the other log, rad; offset of its clock, s.
LEVER_SD, MOUNT_SD, TURNS_MOUNT_SD, TILT_SD, CLOCK_SD = 0.3, 3 * DEG, 6 * DEG, 2 * DEG, 0.05
#: Standard deviations of a stated lever, m, of a stated mounting, rad, and of a fixed clock offset, s.
STATED_LEVER_SD, STATED_MOUNT_SD, HELD_CLOCK_SD = 1e-3, 0.5 * DEG, 1e-9
#: Standard deviations at the first sample: velocity, m/s; tilt, rad; and yaw, rad, if the other log has a yaw
#: and if it has none.
VELOCITY_SD, TILT_START_SD, YAW_SD, FREE_YAW_SD = 1.0, 0.05, 0.05, 0.2
#: Standard deviation of the reference point about the plane of motion, m, if the other log is planar.
PLANE_SD = 0.05
#: Minimum standard deviation of a fix, m and rad, and maximum of its first estimate, m and rad. The maximum
#: is needed because the third differences of sparse fixes contain motion.
MIN_SD_M, MIN_SD_RAD, MAX_START_M, MAX_START_RAD = 1e-4, 1e-3, 0.01, 0.1
#: Maximum number of noise iterations, and convergence tolerance of the logarithm of the standard deviations.
NOISE_STEPS, NOISE_TOL = 3, 0.1
#: Maximum fraction of outliers among the fixes. With more outliers, a second path is estimated without
#: rejecting them, and a warning is given.
MAX_STRAY = 0.05
#: Maximum fraction of outliers among the fixes. With more outliers, the motion is impossible.
MAX_WRONG = 0.5
#: Maximum factor by which correlated errors of the fixes widen the bands. A check fails for a larger factor.
#: At this value four fixes count as one.
MAX_LASTING = 2.0
#: Maximum root-mean-square error of held-out fixes, in standard deviations.
MAX_HELD_OUT = 1.5
#: Duration of a block of held-out fixes, s, and minimum number of held-out fixes.
BLOCK_S, MIN_HELD_OUT = 0.5, 20
#: Minimum difference between the mountings from rotations and from gravity that is reported, rad.
MIN_MOUNT_CHANGE = 15 * DEG
#: Minimum gain in the explained fraction of the rotations for a change of the sign of the pitch.
MIN_GAIN = 0.05
#: Median absolute value of normally distributed noise, divided by its standard deviation.
MEDIAN_SHARE = 0.6745


@dataclass(frozen=True)
class Fixes(Poses):
    """Poses measured by another log (fixes), with their noise."""

    #: Standard deviations of the three coordinates, m, and the three angles, rad, shape (6,).
    noise: Array
    #: Weights of position and attitude, shape (m, 2). A weight is 1, or less for an outlier. It divides the
    #: variance.
    weight: Array
    #: Flags of the poses that are within the record for every candidate clock offset, shape (m,). Only these
    #: poses contribute to the log-likelihood.
    counted: Flags

    @property
    def sd(self) -> Array:
        """Standard deviations of coordinates and angles after weighting, shape (m, 6)."""
        return np.asarray(self.noise / np.sqrt(np.repeat(self.weight, 3, axis=1)))

    @property
    def stray(self) -> Flags:
        """Flags of positions and attitudes that are outliers, shape (m, 2)."""
        return self.weight < 1

    def take(self, rows: Flags) -> Fixes:
        """Return the poses that are selected by ``rows``, flags of shape (m,)."""
        each = ("time_s", "position", "angles", "weight", "counted")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})

    def unweighted(self) -> Fixes:
        """Return the poses with all weights reset to 1."""
        return replace(self, weight=np.ones_like(self.weight))


def observe_fixes(seen: Fixes, path: Nominal, gate: float = np.inf) -> list[Observation]:
    """Return an observation for every pose within the time range of a path.

    Parameters
    ----------
    gate : float
        Maximum innovation, in standard deviations. Larger innovations are outliers.
    """
    t = path.time_s
    clock_times = seen.time_s + path.clock_s
    inside = np.flatnonzero((clock_times >= t[0]) & (clock_times <= t[-1]))
    when = clock_times[inside]
    velocity, place = resampled(when, t, path.velocity), resampled(when, t, path.position)
    row, node = _nearest(t, when), _nearest(path.node_s, when)
    turn = Rotation.from_rotvec(path.rate[row] * (when - t[row])[:, None])
    rotation = path.rotation[row] * turn
    lever, spin = rotation.apply(path.lever), rotation.apply(path.rate[row])
    matrices = rotation.as_matrix()
    place_sd, turn_sd = np.hsplit(seen.sd[inside], 2)
    by_place = jacobian(
        path.states,
        *place.shape,
        position=np.eye(3),
        velocity=np.eye(3) * (when - path.node_s[node])[:, None, None],
        rotation=-smoother.cross_matrix(lever),
        lever=matrices,
        clock_s=(velocity + np.cross(spin, lever))[:, :, None],
    )
    away = seen.position[inside] - place - lever
    kinds = [("position", away, np.isfinite(away), by_place, place_sd)]
    turns = np.isfinite(seen.angles[inside])
    if turns.any():
        used = turns.any(axis=0)
        off, by_turn = _turned(seen.rotation[inside], turns, rotation * path.mount)
        off, by_turn = off[:, used], by_turn[:, used]
        by_angle = jacobian(
            path.states,
            *off.shape,
            rotation=by_turn,
            mount=by_turn @ matrices,
            clock_s=by_turn @ spin[:, :, None],
        )
        kinds.append(("orientation", off, turns[:, used], by_angle, turn_sd[:, used]))
    observations = []
    for k, index in enumerate(inside.tolist()):
        for kind, off, measured, h, sd in kinds:
            one = measured[k]
            if one.any():
                counted = bool(seen.counted[index])
                values = off[k, one], h[k, one], sd[k, one]
                observations.append(Observation(int(node[k]), kind, *values, gate, counted, index))
    return observations


def _nearest(times: Array, when: Array) -> np.ndarray:
    """Return, for each time in ``when``, the index of the nearest element of ``times``."""
    index = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    return index - ((when - times[index - 1]) < (times[index] - when))


def _turned(measured: Rotation, turns: Flags, body: Rotation) -> tuple[Array, Array]:
    """Return measured minus estimated attitude and its derivative with respect to a small rotation.

    The difference has shape (k, 3), its derivative shape (k, 3, 3). If all three angles are measured, the
    difference is a small rotation about world axes. A single measured angle is compared as an angle, because
    the yaw of a tilted body differs from its rotation about the vertical.
    """
    if turns.all(axis=1).any():
        return (measured * body.inv()).as_rotvec(), np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    off = np.column_stack(angles(measured)) - np.column_stack(angles(body))
    by_turn, pitch = turn_to_angles(body), angles(body)[1][:, None]
    # at a pitch other than 0, a rotation about the heading direction changes roll by 1/cos(pitch), and also
    # yaw
    by_turn[:, 0] /= np.maximum(np.cos(pitch), 0.1)
    by_turn[:, 2] -= np.sin(pitch) * by_turn[:, 0]
    return np.angle(np.exp(1j * off)), by_turn


@dataclass(frozen=True)
class HeldOut:
    """Errors of held-out fixes that are predicted from the other fixes."""

    fixes: int
    #: Root-mean-square error of the coordinates; None if the other log has no positions.
    rms_m: float | None
    #: Root-mean-square error divided by the predicted standard deviation. If it exceeds 1, it multiplies
    #: every band.
    deviations: float


@dataclass(frozen=True)
class Fused(Estimate):
    """Most likely motion, with the relation between the two logs."""

    #: Clock offset estimated together with the motion.
    offset: Offset
    #: Whether both logs have equal clocks. This is decided by the Bayesian information criterion.
    agree: bool
    #: Fixes with their estimated noise and weights.
    fixes: Fixes
    #: Number of fixes with a residual above :data:`swimid.inertial.alone.GATE`.
    stray: int
    #: Factor by which correlated errors of the fixes widen every band; 1 if the errors are independent.
    lasting: float
    #: Errors of held-out fixes; None if there are too few fixes.
    held_out: HeldOut | None


@dataclass(frozen=True)
class _Problem:
    """Both logs, with the initial mounting (body to sensor) and its standard deviation, rad."""

    setup: Setup
    poses: Poses
    fixes: Fixes
    mount: Rotation
    mount_sd: float


@dataclass(frozen=True)
class _Trial:
    """Result of smoothing both logs. The attitude in ``setup`` refers to the world of the other log."""

    setup: Setup
    prior: Prior
    fixes: Fixes
    #: Result of the last smoothing; None before the first.
    smoothed: Smoothed = None  # type: ignore[assignment]

    @property
    def likelihood(self) -> float:
        return self.smoothed.errors.likelihood


def estimate(setup: Setup, poses: Poses) -> Fused:
    """Align the two logs, and smooth both together.

    Equal clocks are compared with every offset that the alignment found. They are used unless an offset
    clearly increases the likelihood of both logs. The bands are compared with the errors of held-out fixes.

    Raises
    ------
    NoTrustworthyResult
        When the two logs do not move together.
    InputError
        When the axes of one log are mirrored.
    """
    poses, alignments, flipped, refusal = _align(setup, poses)
    first = alignments[0]
    if first.handed < 0:
        text = "its turns are the mirror image of those in the other log: an axis is flipped in one of them"
        hint = "put the axes right in a mapping (--map), with factor -1 for a flipped one"
        raise InputError(text, file=setup.record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    mount, mount_sd, findings = _start_mount(setup, first)
    findings = [*flipped, *findings]
    problem = _Problem(setup, poses, _first_fixes(setup, poses, alignments), mount, mount_sd)
    trial, offset, agree = _set_clocks(problem, alignments)
    wrong = _contradictions(trial)
    if wrong and setup.rests:
        fewer = replace(problem, setup=setup.without(setup.rests))
        again = _set_clocks(fewer, alignments)
        if not _contradictions(again[0]):
            (trial, offset, agree), problem = again, fewer
            findings.append(Finding("rests", "handled", f"{'; '.join(wrong)}: none is used"))
            wrong = []
    held_out = _hold_out(problem, trial, setup.options.clock_offset_s is not None or agree)
    if refusal is not None and not _predicts(held_out, poses):
        raise refusal
    lasting = _lasting_factor(trial)
    errors, factor = trial.smoothed.errors, lasting
    if held_out is not None:
        factor *= max(held_out.deviations, 1.0)
    low, high = (offset.value_s + factor * (end - offset.value_s) for end in (offset.low_s, offset.high_s))
    return Fused(
        smoothed=replace(trial.smoothed, errors=replace(errors, covariance=errors.covariance * factor**2)),
        setup=problem.setup,
        findings=[*findings, *class_findings(trial.smoothed)],
        impossible=wrong,
        offset=replace(offset, stderr_s=factor * offset.stderr_s, low_s=low, high_s=high),
        agree=agree,
        fixes=trial.fixes,
        stray=int(np.sum(trial.fixes.stray.any(axis=1))),
        lasting=lasting,
        held_out=held_out,
    )


def _align(
    setup: Setup, poses: Poses
) -> tuple[Poses, list[Alignment], list[Finding], NoTrustworthyResult | None]:
    """Return poses, alignments in order of increasing standard error, findings, and an exception or None.

    The sign of the pitch in the other log is changed if the rotations of both logs agree better with it.

    If no offset is found, equal clocks are assumed. The exception is raised later if the held-out fixes also
    show that the logs do not move together.
    """
    stated_s = setup.options.clock_offset_s
    if stated_s is not None:
        return poses, [alignment.align_at(setup.record, poses, stated_s)], [], None
    try:
        found = alignment.align(setup.record, setup.source, poses)
    except NoTrustworthyResult as refusal:
        return poses, [alignment.align_at(setup.record, poses, 0.0)], [], refusal
    first = found[0]
    if first.mount is not None:
        flipped = replace(poses, angles=poses.angles * [1.0, -1.0, 1.0])
        others = alignment.align(setup.record, setup.source, flipped)
        gain = others[0].offset.explained - first.offset.explained
        if others[0].mount is not None and gain > MIN_GAIN and others[0].handed >= 0:
            text = "the pitch in the other log is positive nose down; its sign is changed"
            return flipped, others, [Finding("sign of pitch", "handled", text)], None
    return poses, found, [], None


def _start_mount(setup: Setup, found: Alignment) -> tuple[Rotation, float, list[Finding]]:
    """Return the initial mounting, its standard deviation (rad), and findings.

    The mounting is the stated one. Otherwise it follows from the three angles of the other log or, if these
    are missing, from gravity.
    """
    by_gravity = setup.mount.rotation
    if setup.mount.by == "given":
        return by_gravity, STATED_MOUNT_SD, []
    if found.mount is None:
        return by_gravity, MOUNT_SD, []
    off = float((found.mount * by_gravity.inv()).magnitude())
    findings = []
    if off > MIN_MOUNT_CHANGE:
        text = f"the sensor is turned by {off / DEG:.0f} deg against the body of the other log, as turns show"
        findings.append(Finding("swapped or flipped axes", "handled", text))
    return found.mount, TURNS_MOUNT_SD, findings


def _first_fixes(setup: Setup, poses: Poses, alignments: list[Alignment]) -> Fixes:
    """Return the poses with a first estimate of their noise.

    Only poses within the record for every candidate offset contribute to the log-likelihood, so that offsets
    are compared on the same poses.
    """
    position = poses.position.copy()
    sd = np.array([white_noise_sd(position[:, k], MIN_SD_M) for k in range(3)])
    sd = np.minimum(sd, MAX_START_M)
    if setup.options.fix_sd_m is not None:
        sd[:] = setup.options.fix_sd_m
    for axis in (1, 2):
        if not np.isfinite(position[:, axis]).any():
            position[np.isfinite(position).any(axis=1), axis] = 0.0
            sd[axis] = PLANE_SD
    noises = [white_noise_sd(angle, MIN_SD_RAD) for angle in poses.angles.T[poses.measured]]
    noise = np.append(sd, [min(max(noises, default=MIN_SD_RAD), MAX_START_RAD)] * 3)
    t, margin = setup.record.time_s, BAND * CLOCK_SD
    offsets = [0.0, *(found.offset.value_s for found in alignments)]
    counted = (poses.time_s + min(offsets) - margin >= t[0]) & (poses.time_s + max(offsets) + margin <= t[-1])
    return Fixes(poses.time_s, position, poses.angles, noise, np.ones((len(position), 2)), counted)


# ---------------------------------------------------------------- clocks and noise


def _set_clocks(problem: _Problem, alignments: list[Alignment]) -> tuple[_Trial, Offset, bool]:
    """Return the most likely result, its clock offset, and whether it assumes equal clocks."""
    stated_s = problem.setup.options.clock_offset_s
    if stated_s is not None:
        trial = _smooth(problem, stated_s, held=True)
        return trial, _final_offset(trial.smoothed), False
    starts: list[Offset] = []
    for one in (found.offset for found in alignments):
        if all(abs(one.value_s - s.value_s) / np.hypot(one.stderr_s, s.stderr_s) > BAND for s in starts):
            starts.append(one)
    trials = [_smooth(problem, start.value_s, held=False) for start in starts]
    free = max(trials, key=lambda trial: trial.likelihood)
    counted = problem.fixes.counted.sum()
    if not counted:
        return free, _final_offset(free.smoothed), False
    # half of the penalty of the Bayesian information criterion (Schwarz 1978, doi:10.1214/aos/1176344136) for
    # one additional parameter, the offset
    price = 0.5 * float(np.log(counted))
    if abs(free.smoothed.path.clock_s) <= BAND * CLOCK_SD:
        equal = _smooth(problem, 0.0, held=True, after=free)
    else:
        equal = _smooth(problem, 0.0, held=True)
        if free.likelihood <= equal.likelihood + price:
            free = _smooth(problem, 0.0, held=False, after=equal)
    offset = _final_offset(free.smoothed)
    if free.likelihood > equal.likelihood + price:
        return free, offset, False
    low, high = min(offset.low_s, 0.0), max(offset.high_s, 0.0)
    return equal, replace(offset, value_s=0.0, low_s=low, high_s=high), True


def _smooth(problem: _Problem, offset_s: float, *, held: bool, after: _Trial | None = None) -> _Trial:
    """Smooth both logs, and estimate noise, weights and error class of the sensor from the residuals.

    Parameters
    ----------
    offset_s : float
        Initial clock offset.
    held : bool
        Whether the clock offset is fixed at its initial value.
    after : _Trial, optional
        Result from which the iteration continues.
    """
    setup, prior = _start(problem, offset_s, held)
    if after is not None:
        path, origin = replace(after.smoothed.path, clock_s=offset_s), after.smoothed.origin
        smoothed = replace(after.smoothed, path=path, origin=replace(origin, clock_s=offset_s))
        return _with_noise(_Trial(setup, prior, after.fixes.unweighted(), smoothed), noise_known=True)
    # the effect of a clock offset depends on the velocity: the offset is fixed until the velocity is known
    fixed = replace(prior, sd={**prior.sd, "clock_s": HELD_CLOCK_SD})
    begun = _Trial(setup, fixed, problem.fixes)
    gated = replace(_fuse(begun, setup.sensor, 2, GATE), prior=prior)
    trials = [_with_noise(gated)]
    if gated.smoothed.errors.rejected > MAX_STRAY * len(problem.fixes.time_s):
        # with many outliers, either the fixes or the path can be wrong: compare both assumptions
        trials.append(_with_noise(replace(_fuse(begun, setup.sensor, 2), prior=prior)))
    return max(trials, key=lambda trial: trial.likelihood)


def _start(problem: _Problem, offset_s: float, held: bool) -> tuple[Setup, Prior]:
    """Return the setup in the world of the other log, and the prior of the smoother.

    If ``held``, the clock offset is fixed.
    """
    setup, poses, mount = problem.setup, problem.poses, problem.mount
    on_record = replace(poses, time_s=poses.time_s + offset_s)
    guide = alignment.find_world_turn(setup.record, setup.source, on_record, mount) * setup.source.rotation
    place, place_sd = np.zeros(3), 1.0
    fixed = poses.position[np.isfinite(poses.position).any(axis=1)]
    if len(fixed):
        place = np.nan_to_num(fixed[0])
        place_sd += float(np.max(np.nan_to_num(np.ptp(fixed, axis=0))))
    state = State(
        rotation=guide[0],
        position=place,
        rate_bias=setup.still_rate,
        lever=setup.lever(mount),
        mount=mount,
        clock_s=offset_s,
    )
    sd = {
        "position": place_sd,
        "velocity": VELOCITY_SD,
        "rotation": (TILT_START_SD, TILT_START_SD, YAW_SD if poses.measured[2] else FREE_YAW_SD),
        "lever": LEVER_SD if setup.options.lever_m is None else STATED_LEVER_SD,
        "mount": problem.mount_sd,
        "tilt": TILT_SD,
        "clock_s": HELD_CLOCK_SD if held else CLOCK_SD,
    }
    source = replace(setup.source, rotation=guide, heading=False)
    return replace(setup, source=source), Prior(guide, state, sd)


def _fuse(trial: _Trial, sensor: Sensor | None = None, passes: int = 1, gate: float = np.inf) -> _Trial:
    """Smooth both logs with known noise; the sensor is by default that of the last smoothing."""
    setup, last = trial.setup, trial.smoothed
    given = setup.record, trial.prior, sensor or last.sensor, setup.noise

    def observe(path: Nominal) -> list[Observation]:
        return [*alone.observe_alone(setup, path), *observe_fixes(trial.fixes, path, gate)]

    smoothed = smoother.smooth(*given, observe, states=smoother.FUSED, after=last, passes=passes)
    setup.advance()
    return replace(trial, smoothed=smoothed)


def _with_noise(trial: _Trial, *, noise_known: bool = False) -> _Trial:
    """Iterate noise, weights, error class of the sensor and motion until the noise converges."""
    for step in range(NOISE_STEPS):
        fixes = trial.fixes
        if step or not noise_known:
            fixes = _estimate_noise(trial.smoothed, fixes, trial.setup.options.fix_sd_m)
        if step > 1 and np.nanmax(np.abs(np.log(fixes.noise / trial.fixes.noise))) < NOISE_TOL:
            break
        trial = now = _fuse(replace(trial, fixes=fixes))
        if step == 1 and not noise_known:
            best = most_likely_class(now.smoothed, lambda sensor: _fuse(now, sensor).smoothed)  # noqa: B023
            trial = replace(now, smoothed=best)
    return trial


def _residuals(fixes: Fixes, smoothed: Smoothed) -> tuple[Array, Array]:
    """Return residuals of coordinates and angles, and their variances due to the motion, each shape (m, 6).

    Elements are NaN where nothing was measured and for fixes outside of the record.
    """
    residual, variance = np.full((2, len(fixes.time_s), 6), np.nan)
    measured = np.hstack([np.isfinite(fixes.position), np.isfinite(fixes.angles)])
    for seen in observe_fixes(fixes.unweighted(), smoothed.path):
        half = slice(0, 3) if seen.kind == "position" else slice(3, 6)
        columns = np.flatnonzero(measured[seen.fix, half]) + half.start
        h = seen.sensitivity
        residual[seen.fix, columns] = seen.residual
        variance[seen.fix, columns] = np.einsum("ij,jk,ik->i", h, smoothed.errors.covariance[seen.node], h)
    return residual, variance


def _is_measured(fixes: Fixes, residual: Array) -> Flags:
    """Return flags of the residuals of measured values, shape (m, 6).

    In a planar log, the coordinates across the plane are assumed and not measured.
    """
    plane = np.append(fixes.noise[:3] == PLANE_SD, np.zeros(3, dtype=bool))
    return np.asarray(np.isfinite(residual) & ~plane)


def _estimate_noise(smoothed: Smoothed, fixes: Fixes, fix_sd_m: float | None) -> Fixes:
    """Return the fixes with noise and weights that are estimated from their residuals.

    The noise follows from one step of expectation maximisation (Shumway and Stoffer 1982, sec. 3) over the
    fixes that are not outliers. The weight of an outlier decreases with the square of its residual (Cauchy).
    No fix is excluded, so that a path that follows outliers can recover.
    """
    residual, variance = _residuals(fixes, smoothed)
    (place_sd, place), (turn_sd, turn) = (
        _noise_and_weight(residual[:, half], variance[:, half], fixes.noise[half])
        for half in (slice(3), slice(3, 6))
    )
    noise = fixes.noise.copy()
    if fix_sd_m is None:
        known = (noise[:3] == PLANE_SD) | ~np.isfinite(place_sd)
        noise[:3] = np.where(known, noise[:3], np.maximum(np.nan_to_num(place_sd), MIN_SD_M))
    if np.isfinite(turn_sd).any():
        noise[3:] = max(float(np.sqrt(np.nanmean(turn_sd**2))), MIN_SD_RAD)
    return replace(fixes, noise=noise, weight=np.column_stack([place, turn]))


def _noise_and_weight(residual: Array, variance: Array, sd: Array) -> tuple[Array, Array]:
    """Return the standard deviation of every column, shape (3,), and the weight of every row.

    The standard deviation of a column without values is NaN.
    """
    usual = np.ma.median(np.ma.masked_invalid(np.abs(residual)), axis=0).filled(np.nan) / MEDIAN_SHARE
    far = np.abs(residual) / np.fmax(sd, usual)
    weight = np.minimum(1.0, (GATE / np.fmax(np.fmax.reduce(far, axis=1), 1e-12)) ** 2)
    squares = np.where(weight[:, None] == 1, residual**2 + variance, np.nan)
    return np.sqrt(np.ma.masked_invalid(squares).mean(axis=0).filled(np.nan)), weight


def _final_offset(smoothed: Smoothed) -> Offset:
    """Return the final clock offset, with an interval that is widened if innovations are too large."""
    scores = smoothed.errors.scores
    seen = [score for kind in ("position", "orientation") for score in scores.get(kind, ())]
    widening = 1.0
    if seen:
        widening = max(float(np.sqrt(np.mean(np.concatenate(seen) ** 2))), 1.0)
    value, place = float(smoothed.path.clock_s), smoother.PARTS["clock_s"].start
    sd = widening * float(np.sqrt(smoothed.errors.covariance[-1, place, place]))
    return Offset(value, sd, value - BAND * sd, value + BAND * sd)


# ---------------------------------------------------------------- tests of the result


def _contradictions(trial: _Trial) -> list[str]:
    contradictions = alone.find_contradictions(trial.setup, trial.smoothed)
    stray = trial.fixes.stray[np.isfinite(trial.fixes.position).any(axis=1), 0]
    if len(stray) and np.mean(stray) > MAX_WRONG:
        share = 100 * np.mean(stray)
        contradictions.append(f"{share:.0f} % of the fixes lie beyond {GATE:g} deviations of it")
    return contradictions


def _hold_out(problem: _Problem, trial: _Trial, held: bool) -> HeldOut | None:
    """Predict every fourth block of fixes from the other blocks; return None for too few fixes.

    A block lasts half a second, because neighbouring fixes would determine a single fix.
    """
    fixes = trial.fixes
    block = np.floor((fixes.time_s - fixes.time_s[0]) / BLOCK_S).astype(int)
    if len(block) > 1 and np.median(np.diff(fixes.time_s)) > BLOCK_S:
        block = np.arange(len(block))
    out = block % 4 == 2
    count = int(np.sum(out & (np.isfinite(fixes.position).any(axis=1) | fixes.turned)))
    if count < MIN_HELD_OUT:
        return None
    setup, prior = _start(problem, trial.smoothed.path.clock_s, held)
    smoothed = _fuse(_Trial(setup, prior, fixes.take(~out), trial.smoothed)).smoothed
    left_out = fixes.take(out)
    residual, variance = _residuals(left_out, smoothed)
    measured = _is_measured(left_out, residual)
    squares = (residual**2 / (variance + left_out.sd**2))[measured]
    places = residual[:, :3][measured[:, :3]]
    rms = float(np.sqrt(np.mean(places**2))) if len(places) else None
    return HeldOut(count, rms, float(np.sqrt(np.mean(squares))))


def _predicts(held_out: HeldOut | None, poses: Poses) -> bool:
    """Return whether the errors of held-out fixes are small enough to show that both logs move together."""
    if held_out is None or held_out.rms_m is None or held_out.deviations > MAX_HELD_OUT:
        return False
    place = poses.position[:, np.isfinite(poses.position).any(axis=0)]
    rows = np.isfinite(place).all(axis=1)
    fast = alignment.without_slow(poses.time_s[rows], place[rows], alignment.SLOW_PATH_S)
    return held_out.rms_m**2 < (1 - alignment.MIN_EXPLAINED) * float(np.mean(fast**2))


def _lasting_factor(trial: _Trial) -> float:
    """Return the factor by which correlated errors of the fixes enlarge the standard error of their mean.

    It is the square root of the integrated autocorrelation of the residuals. The sum ends before the first
    autocorrelation that is not positive (initial sequence of Geyer 1992, doi:10.1214/ss/1177011137).
    """
    fixes = trial.fixes
    residual, _ = _residuals(fixes, trial.smoothed)
    used = _is_measured(fixes, residual) & ~np.repeat(fixes.stray, 3, axis=1)
    longest = 1.0
    for values, rows in zip(residual.T, used.T, strict=True):
        if rows.sum() < MIN_HELD_OUT:
            continue
        x = values[rows] - np.mean(values[rows])
        shared = np.correlate(x, x, "full")[len(x) - 1 :][: len(x) // 4]
        end = int(np.argmax(np.append(shared, 0.0) <= 0))
        longest = max(longest, float(2 * shared[:end].sum() / shared[0] - 1))
    return float(np.sqrt(longest))
