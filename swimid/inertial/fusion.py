"""Motion from an inertial unit and another log of the same trial, a camera's for instance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError, NoTrustworthyResult
from swimid.inertial import aiding, alignment, alone, smoother
from swimid.inertial.aiding import Fixes
from swimid.inertial.alignment import Fit, Offset
from swimid.inertial.alone import Estimate, likeliest_class, shown_class
from swimid.inertial.record import Array, Finding, Poses
from swimid.inertial.setup import BAND, DEG, Sensor, Setup
from swimid.inertial.smoother import FUSED, PARTS, Nominal, Observation, Prior, Smoothed, State
from swimid.logs.sampling import white_noise_sd

#: Deviations before anything is seen: lever, m; mounting, rad; tilt of the other log's world, rad;
#: its clock, s.
LEVER_SD, MOUNT_SD, FITTED_MOUNT_SD, TILT_SD, CLOCK_SD = 0.3, 3 * DEG, 6 * DEG, 2 * DEG, 0.05
#: Of what is given: lever, m, and mounting, rad; and of a clock that is held, s.
GIVEN_LEVER_SD, GIVEN_MOUNT_SD, HELD_CLOCK_SD = 1e-3, 0.5 * DEG, 1e-9
#: A planar log: the reference point stays in its plane this well, m.
PLANE_SD = 0.05
#: Least noise of a fix, m and rad, and turns of estimating it.
LEAST_M, LEAST_RAD, NOISE_TURNS = 1e-4, 1e-3, 3
#: More fixes than this share beyond the gate: not they are wrong, but the path they are held against.
FEW = 0.05
#: Errors of fixes that last widen a band by this much before they are warned of: four tell no more than one.
LASTING = 2.0
#: Fixes foretold worse than by this many of their deviations (rms) do not move with the sensor.
FORETOLD = 1.5
#: Fixes are left out together for so long, s; fewer than this tell nothing.
HOLD_S, FEWEST_HELD_OUT = 0.5, 20


@dataclass(frozen=True)
class HeldOut:
    """How well fixes that were left out are foretold."""

    fixes: int
    #: Of position, every coordinate; None without positions.
    rms_m: float | None
    #: Rms in the deviations that were stated; every band is widened by it where it is more than 1.
    deviations: float


@dataclass(frozen=True)
class Fused(Estimate):
    """The smoothed motion, and what fusing told."""

    #: From the comparison of the two logs before fusing.
    clocks: Fit
    #: Of the fused motion itself: the final answer.
    offset: Offset
    #: Whether clocks that agree explain both logs as well as an offset does (Bayesian information criterion).
    agree: bool
    #: With the noise and the weights they were found to have.
    fixes: Fixes
    #: Fixes beyond :data:`swimid.inertial.aiding.GATE` deviations.
    stray: int
    #: What errors of the fixes that last widen every band by; 1 where each is off by itself.
    lasting: float
    #: None where there are too few fixes to leave some out.
    held_out: HeldOut | None


@dataclass(frozen=True, kw_only=True)
class _Problem(Setup):
    """Both logs, and everything that is known before they are smoothed together.

    ``body_to_sensor``: where the search for the mounting begins, with its deviation, rad.
    """

    poses: Poses
    fixes: Fixes
    body_to_sensor: Rotation
    mount_sd: float


@dataclass(frozen=True)
class _Trial:
    """One smoothing of both logs, the clock held or free.

    ``setup`` has its attitude in the world of the other log.
    """

    setup: Setup
    prior: Prior
    fixes: Fixes
    sensor: Sensor
    smoothed: Smoothed

    @property
    def likelihood(self) -> float:
        return self.smoothed.errors.likelihood


def estimate(setup: Setup, poses: Poses) -> Fused:
    """Set the clocks, place the sensor, and smooth both logs together.

    An offset between the clocks has to earn its place: clocks that agree compete with every offset found, and
    win where it does not make both logs clearly likelier. Bands are held against fixes that were left out.

    Raises
    ------
    NoTrustworthyResult
        The two logs do not move together.
    InputError
        Axes mirrored against the other log.
    """
    poses, clocks, findings, refusal = _clocks(setup, poses)
    if clocks[0].handed < 0:
        text = "its turns are the mirror image of those in the other log: an axis is flipped in one of them"
        hint = "put the axes right in a mapping (--map), with factor -1 for a flipped one"
        raise InputError(text, file=setup.record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    rotation, mount_sd, turned = _mount(setup, clocks[0])
    problem = _Problem(
        **vars(setup),
        poses=poses,
        fixes=_fixes(setup, poses, clocks),
        body_to_sensor=rotation,
        mount_sd=mount_sd,
    )
    trial, offset, agree = _set_clocks(problem, clocks)
    wrong = _contradictions(trial)
    if wrong and setup.still.rests:
        fewer = replace(problem, still=setup.still.without(setup.still.rests))
        again = _set_clocks(fewer, clocks)
        if not _contradictions(again[0]):
            (trial, offset, agree), problem = again, fewer
            findings.append(Finding("rests", "handled", f"{'; '.join(wrong)}: none is used"))
            wrong = []
    held_out = _hold_out(problem, trial, setup.options.clock_offset_s is not None or agree)
    if refusal is not None and not _foretold(held_out, poses):
        raise refusal
    lasting = _lasting(trial)
    errors = trial.smoothed.errors
    factor = lasting * (1.0 if held_out is None else max(held_out.deviations, 1.0))
    return Fused(
        smoothed=replace(trial.smoothed, errors=replace(errors, covariance=errors.covariance * factor**2)),
        still=problem.still,
        sensor=trial.sensor,
        findings=[*findings, *shown_class(setup.sensor, trial.sensor), *turned],
        impossible=wrong,
        clocks=clocks[0],
        offset=replace(
            offset,
            stderr_s=factor * offset.stderr_s,
            low_s=offset.value_s - factor * (offset.value_s - offset.low_s),
            high_s=offset.value_s + factor * (offset.high_s - offset.value_s),
        ),
        agree=agree,
        fixes=trial.fixes,
        stray=int(np.sum(trial.fixes.stray.any(axis=1))),
        lasting=lasting,
        held_out=held_out,
    )


def _clocks(setup: Setup, poses: Poses) -> tuple[Poses, list[Fit], list[Finding], NoTrustworthyResult | None]:
    """Offsets found, the surest first; the sign of pitch turned where turns fit better so.

    Where none is found the clocks are taken to agree, and the refusal is kept until fixes that are left out
    have told whether the logs move together.
    """
    record, source, given_s = setup.record, setup.source, setup.options.clock_offset_s
    if given_s is not None:
        return poses, [alignment.fit_at(record, poses, given_s)], [], None
    try:
        fits = alignment.fit_clocks(record, source, poses)
    except NoTrustworthyResult as refusal:
        return poses, [alignment.fit_at(record, poses, 0.0)], [], refusal
    fit = fits[0]
    if poses.full and fit.by == "turn rates":
        turned = replace(poses, angles=poses.angles * [1.0, -1.0, 1.0])
        others = alignment.fit_clocks(record, source, turned)
        other = others[0]
        if other.by == fit.by and other.offset.explained > fit.offset.explained + 0.05 and other.handed >= 0:
            text = "pitch in the other log counts nose down as positive; its sign is turned"
            return turned, others, [Finding("sign of pitch", "handled", text)], None
    return poses, fits, [], None


def _mount(setup: Setup, fit: Fit) -> tuple[Rotation, float, list[Finding]]:
    """Where to start the mounting: given ones stay; three angles tell it; else by gravity."""
    by_gravity = setup.mount.rotation
    if setup.mount.by == "given":
        return by_gravity, GIVEN_MOUNT_SD, []
    if fit.mount is None:
        return by_gravity, MOUNT_SD, []
    off = float((fit.mount * by_gravity.inv()).magnitude())
    text = f"the sensor is turned by {off / DEG:.0f} deg against the body of the other log, as turns tell"
    # Mounting within this of what was given or told by gravity counts as the same, rad.
    findings = [Finding("swapped or flipped axes", "handled", text)] if off > (15 * DEG) else []
    return fit.mount, FITTED_MOUNT_SD, findings


def _fixes(setup: Setup, poses: Poses, clocks: list[Fit]) -> Fixes:
    """The poses with a first guess of their noise.

    Those within the record by every clock count: likelihoods are compared over the same ones.
    """
    fix_sd_m = setup.options.fix_sd_m
    position = poses.position.copy()
    sd = np.array([white_noise_sd(position[:, k], LEAST_M) for k in range(3)])
    # between sparse fixes the third difference holds motion too: the start is no more than a centimetre
    sd = np.minimum(sd, 0.01) if fix_sd_m is None else np.full(3, fix_sd_m)
    for axis in (1, 2):
        if not np.isfinite(position[:, axis]).any():
            position[np.isfinite(position).any(axis=1), axis] = 0.0
            sd[axis] = PLANE_SD
    noises = [white_noise_sd(angle, LEAST_RAD) for angle in poses.angles.T[poses.measured]]
    rotation_sd = min(max(noises, default=LEAST_RAD), 0.1)
    noise, weight, t = np.append(sd, [rotation_sd] * 3), np.ones((len(position), 2)), setup.record.time_s
    offsets, margin = [0.0, *(fit.offset.value_s for fit in clocks)], BAND * CLOCK_SD
    counted = (poses.time_s + min(offsets) - margin >= t[0]) & (poses.time_s + max(offsets) + margin <= t[-1])
    return Fixes(poses.time_s, position, poses.angles, noise, weight, counted)


# ---------------------------------------------------------------- clocks and noise


def _set_clocks(problem: _Problem, clocks: list[Fit]) -> tuple[_Trial, Offset, bool]:
    """The likeliest of clocks that agree and of every offset found; whether they agree."""
    sensor, given_s = problem.sensor, problem.options.clock_offset_s
    if given_s is not None:
        trial = _smooth(problem, given_s, sensor, held=True)
        return trial, _offset(trial.smoothed, clocks[0]), False
    starts: list[Offset] = []
    for one in (fit.offset for fit in clocks):
        if all(abs(one.value_s - s.value_s) / np.hypot(one.stderr_s, s.stderr_s) > BAND for s in starts):
            starts.append(one)
    trials = [_smooth(problem, start.value_s, sensor, held=False) for start in starts]
    free = max(trials, key=lambda trial: trial.likelihood)
    counted = problem.fixes.counted.sum()
    if not counted:
        return free, _offset(free.smoothed, clocks[0]), False
    # Schwarz (1978, doi:10.1214/aos/1176344136): an offset is one number more
    price = 0.5 * float(np.log(counted))
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
    setup, prior = _begin(problem, offset_s)
    if after is not None:
        path, origin = replace(after.smoothed.path, clock_s=offset_s), after.smoothed.origin
        smoothed = replace(after.smoothed, path=path, origin=replace(origin, clock_s=offset_s))
        begun = _Trial(setup, prior, after.fixes.unweighted(), sensor, smoothed)
        return _settled(begun, held=held, noise_known=True)

    def first(gate: float) -> _Trial:
        # while the path is not yet known the clock is held: what an offset does is a matter of velocity
        smoothed = _fuse(setup, prior, sensor, problem.fixes, held=True, passes=2, gate=gate)
        return _Trial(setup, prior, problem.fixes, sensor, smoothed)

    begun = first(aiding.GATE)
    gated = _settled(begun, held=held)
    if begun.smoothed.errors.rejected <= FEW * len(problem.fixes.time_s):
        return gated
    # a gate that shuts out many: either they are wrong, or the path they were held against was
    return max(gated, _settled(first(np.inf), held=held), key=lambda trial: trial.likelihood)


def _begin(problem: _Problem, offset_s: float) -> tuple[Setup, Prior]:
    """What is known besides the fixes, in the world of the other log, and where the search begins."""
    poses, rotation = problem.poses, problem.body_to_sensor
    on_record = replace(poses, time_s=poses.time_s + offset_s)
    guide = (
        alignment.world_turn(problem.record, problem.source, on_record, rotation) * problem.source.rotation
    )
    fixed = poses.position[np.isfinite(poses.position).any(axis=1)]
    state = State(
        rotation=guide[0],
        position=np.nan_to_num(fixed[0]) if len(fixed) else np.zeros(3),
        rate_bias=problem.still_rate,
        lever=problem.lever(rotation),
        mount=rotation,
        clock_s=offset_s,
    )
    sd = {
        "position": 1.0 + float(np.max(np.nan_to_num(np.ptp(fixed, axis=0)))) if len(fixed) else 1.0,
        "velocity": 1.0,
        "rotation": (0.05, 0.05, 0.05 if poses.measured[2] else 0.2),
        "lever": LEVER_SD if problem.options.lever_m is None else GIVEN_LEVER_SD,
        "mount": problem.mount_sd,
        "tilt": TILT_SD,
        "clock_s": CLOCK_SD,
    }
    source = replace(problem.source, rotation=guide, heading=False)
    return replace(problem, source=source), Prior(guide, state, sd)


def _fuse(
    setup: Setup,
    prior: Prior,
    sensor: Sensor,
    fixes: Fixes,
    *,
    held: bool,
    after: Smoothed | None = None,
    passes: int = 1,
    gate: float = np.inf,
) -> Smoothed:
    """Smooth both logs once; ``held``: the clock stays as it is."""
    if held:
        prior = replace(prior, sd={**prior.sd, "clock_s": HELD_CLOCK_SD})

    def observe(path: Nominal) -> list[Observation]:
        return [*aiding.known(setup, path), *aiding.against(fixes, path, gate)]

    smoothed = smoother.smooth(
        setup.record, prior, sensor, setup.still.noise, observe, states=FUSED, after=after, passes=passes
    )
    setup.advance()
    return smoothed


def _settled(begun: _Trial, *, held: bool, noise_known: bool = False) -> _Trial:
    """Noise, weights and the sensor's class by turns with the motion, until they stay."""
    setup, prior, fixes, shown = begun.setup, begun.prior, begun.fixes, begun.sensor
    smoothed = begun.smoothed
    for turn in range(NOISE_TURNS):
        better = fixes if noise_known and not turn else _noise_seen(smoothed, fixes, setup.options.fix_sd_m)
        # Noise estimates that change by less than this share are settled.
        if turn > 1 and np.nanmax(np.abs(np.log(better.noise / fixes.noise))) < 0.1:
            break
        fixes = better
        smoothed = _fuse(setup, prior, shown, fixes, held=held, after=smoothed)
        if turn != 1 or noise_known:
            continue
        attempt = partial(_fuse, setup, prior, fixes=fixes, held=held, after=smoothed)
        smoothed, shown = likeliest_class(smoothed, begun.sensor, attempt)
    return _Trial(setup, prior, fixes, shown, smoothed)


def _residuals(fixes: Fixes, smoothed: Smoothed) -> tuple[Array, Array]:
    """What is left of every coordinate and angle, and its variance by the motion's, each shape (m, 6).

    NaN where it was not measured or lies outside the record.
    """
    residual, variance = np.full((2, len(fixes.time_s), 6), np.nan)
    covariance, turns = smoothed.errors.covariance, fixes.turns
    for seen in aiding.against(fixes.unweighted(), smoothed.path):
        place = seen.kind == "position"
        measured = np.isfinite(fixes.position[seen.fix]) if place else turns[seen.fix]
        columns = np.flatnonzero(measured) + (0 if place else 3)
        h = seen.sensitivity
        residual[seen.fix, columns] = seen.residual
        variance[seen.fix, columns] = np.einsum("ij,jk,ik->i", h, covariance[seen.node], h)
    return residual, variance


def _measured(fixes: Fixes, residual: Array) -> np.ndarray:
    """Where a residual is of something measured, shape (m, 6); a plane taken for granted is not."""
    plane = np.append(fixes.noise[:3] == PLANE_SD, np.zeros(3, dtype=bool))
    return np.asarray(np.isfinite(residual) & ~plane)


def _noise_seen(smoothed: Smoothed, fixes: Fixes, fix_sd_m: float | None) -> Fixes:
    """Noise and weights of the fixes by what is left of them.

    Noise by one step of expectation-maximisation (Shumway and Stoffer 1982, sec. 3) over those that are not
    stray. A stray one keeps a weight that falls with the square of its distance (the redescending weights of
    Cauchy's kind): none is shut out, so that a path gone astray finds back.
    """
    residual, variance = _residuals(fixes, smoothed)
    (place_sd, place), (turn_sd, turn) = (
        _noise_and_weight(residual[:, half], variance[:, half], fixes.noise[half])
        for half in (slice(3), slice(3, 6))
    )
    usual = fixes.noise[:3]
    known = (usual == PLANE_SD) | ~np.isfinite(place_sd) | (fix_sd_m is not None)
    place_sd = np.where(known, usual, np.maximum(np.nan_to_num(place_sd), LEAST_M))
    turns = turn_sd[np.isfinite(turn_sd)]
    rotation_sd = max(float(np.sqrt(np.mean(turns**2))), LEAST_RAD) if len(turns) else fixes.noise[3]
    noise = np.append(place_sd, [rotation_sd] * 3)
    return replace(fixes, noise=noise, weight=np.column_stack([place, turn]))


def _noise_and_weight(residual: Array, variance: Array, sd: Array) -> tuple[Array, Array]:
    """Deviation of every column, shape (3,), NaN where there is none, and the weight of every row."""
    left = [column[np.isfinite(column)] for column in residual.T]
    usual = [np.median(np.abs(values)) / 0.6745 if len(values) else np.nan for values in left]
    far = np.abs(residual) / np.fmax(sd, usual)
    weight = np.minimum(1.0, (aiding.GATE / np.fmax(np.fmax.reduce(far, axis=1), 1e-12)) ** 2)
    squares = np.where(weight[:, None] == 1, residual**2 + variance, np.nan)
    count = np.isfinite(squares).sum(axis=0)
    mean = np.nansum(squares, axis=0) / np.maximum(count, 1)
    return np.sqrt(np.where(count > 0, mean, np.nan)), weight


def _offset(smoothed: Smoothed, clocks: Fit) -> Offset:
    """The clock offset with the whole motion, widened where the innovations are larger than stated."""
    scores = smoothed.errors.scores
    seen = [score for kind in ("position", "orientation") for score in scores.get(kind, ())]
    widening = max(float(np.sqrt(np.mean(np.concatenate(seen) ** 2))), 1.0) if seen else 1.0
    value = float(smoothed.path.clock_s)
    clock_s = PARTS["clock_s"].start
    sd = widening * float(np.sqrt(smoothed.errors.covariance[-1, clock_s, clock_s]))
    return replace(
        clocks.offset, value_s=value, stderr_s=sd, low_s=value - BAND * sd, high_s=value + BAND * sd
    )


# ---------------------------------------------------------------- whether it can be


def _contradictions(trial: _Trial) -> list[str]:
    contradictions = alone.contradictions(trial.setup, trial.smoothed)
    stray = trial.fixes.stray[np.isfinite(trial.fixes.position).any(axis=1), 0]
    if len(stray) and np.mean(stray) > 0.5:
        contradictions.append(
            f"{100 * np.mean(stray):.0f} % of the fixes lie beyond {aiding.GATE:g} deviations of it"
        )
    return contradictions


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
    count = int(np.sum(out & there))
    if count < FEWEST_HELD_OUT:
        return None
    setup, prior = _begin(problem, trial.smoothed.path.clock_s)
    smoothed = _fuse(setup, prior, trial.sensor, trial.fixes.take(~out), held=held, after=trial.smoothed)
    left_out = trial.fixes.take(out)
    residual, variance = _residuals(left_out, smoothed)
    measured = _measured(left_out, residual)
    # stray fixes weigh as little as in the smoothing
    squares = (residual**2 / (variance + left_out.sd**2))[measured]
    places = residual[:, :3][measured[:, :3]]
    rms = float(np.sqrt(np.mean(places**2))) if len(places) else None
    return HeldOut(count, rms, float(np.sqrt(np.mean(squares))))


def _foretold(held_out: HeldOut | None, poses: Poses) -> bool:
    """Whether fixes that were left out come out well enough to say that both logs move together."""
    if held_out is None or held_out.rms_m is None or held_out.deviations > FORETOLD:
        return False
    place = poses.position[:, np.isfinite(poses.position).any(axis=0)]
    rows = np.isfinite(place).all(axis=1)
    fast = alignment.without_slow(poses.time_s[rows], place[rows], alignment.SLOW_WAY_S)
    return held_out.rms_m**2 < (1 - alignment.LEAST_EXPLAINED) * float(np.mean(fast**2))


def _lasting(trial: _Trial) -> float:
    """By how much errors of the fixes that last make a mean of them worse than if each were off by itself.

    The root of the integrated autocorrelation of what is left of them, summed while it is positive (initial
    sequence of Geyer 1992, doi:10.1214/ss/1177011137).
    """
    fixes = trial.fixes
    residual, _ = _residuals(fixes, trial.smoothed)
    kept = _measured(fixes, residual) & ~np.repeat(fixes.stray, 3, axis=1)
    longest = 1.0
    for left, rows in zip(residual.T, kept.T, strict=True):
        if rows.sum() < FEWEST_HELD_OUT:
            continue
        x = left[rows] - np.mean(left[rows])
        power = float(x @ x)
        total = 1.0
        for lag in range(1, len(x) // 4 if power else 0):
            shared = float(x[lag:] @ x[:-lag]) / power
            if shared <= 0:
                break
            total += 2 * shared
        longest = max(longest, total)
    return float(np.sqrt(longest))
