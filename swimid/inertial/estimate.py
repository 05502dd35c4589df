"""Most likely motion of an inertial recording, by itself or together with another log of the trial.

The smoother uses rests and attitudes as observations. With another log, for instance of a camera, it also
uses the poses in that log (fixes). Afterwards the motion is compared with rests and attitude. A rest implies
a velocity of 0 and, through the accelerometer, a tilt. An attitude filter also gives the tilt. If the motion
contradicts a rest or an attitude by more than its uncertainty, no position or velocity is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.errors import InputError, NoTrustworthyResult
from swimid.inertial import alignment, smoother
from swimid.inertial import record as recording
from swimid.inertial.alignment import Offset
from swimid.inertial.record import BAND, DEG, Array, Finding, Flags, ImuSetup, Poses, Sensor, resampled
from swimid.inertial.smoother import (
    MotionState,
    Nominal,
    Observation,
    SmoothedMotion,
    jacobian,
    skew_matrices,
)
from swimid.kinematics.attitude import angles
from swimid.logs.sampling import white_noise_sd

#: Standard deviation of position (m) and yaw (rad) at the first sample, before any observation. It is small
#: because the first sample defines the origin.
ORIGIN_SD = 1e-6
#: Standard deviation of roll and pitch at the first sample before any observation, rad.
START_TILT_SD = 0.05
#: Maximum number of rests that are excluded one by one because the motion contradicts them. If a
#: contradiction remains after that, all rests are excluded.
MAX_SINGLE = 2
#: Minimum increase in log-likelihood for which another error class of the sensor replaces the stated one:
#: "strong" evidence (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572, sec. 3.2).
MIN_GAIN = 3.0
#: Standard deviations of velocity (m/s) and turn rate (rad/s) of a robot that rests in drifting water.
REST_SPEED_SD, REST_RATE_SD = 0.01, 5e-4
#: Correlation times of attitude errors, s. QUATERNION_MEMORY_S is the minimum for the quaternions of a
#: sensor, FILTER_MEMORY_S the value for an attitude filter. Attitudes within this time count as one
#: measurement.
QUATERNION_MEMORY_S, FILTER_MEMORY_S = 10.0, 20.0
#: Maximum normalised residual of a fix (pose measured by the other log), in standard deviations. Fixes with
#: larger residuals are outliers.
GATE = 6.0
#: Time between successive observations for the smoother, s: REST_STEP_S for zero velocity in a rest, and
#: STEP_S for attitude and top speed.
REST_STEP_S, STEP_S = 0.5, 1.0
#: Standard deviations before any observation: lever from the sensor to the reference point (m), mounting that
#: is estimated from rotations (rad), tilt of the world axes of the other log (rad), and offset of its clock
#: (s).
LEVER_SD, TURNS_MOUNT_SD, TILT_SD, CLOCK_SD = (0.3, 0.3, 0.05), 6 * DEG, 2 * DEG, 0.05
#: Standard deviations of a lever that the user states (m), and of a clock offset that is fixed (s).
STATED_LEVER_SD, HELD_CLOCK_SD = 1e-3, 1e-9
#: Standard deviations at the first sample if there is another log: velocity (m/s), yaw if the other log has a
#: yaw (rad), and yaw if it has none (rad).
VELOCITY_SD, YAW_SD, FREE_YAW_SD = 1.0, 0.05, 0.2
#: Standard deviation of the distance between reference point and plane of motion, m, if the other log is
#: planar.
PLANE_SD = 0.05
#: Limits of the standard deviation of a fix: minimum (m and rad), and maximum of the first estimate (m and
#: rad). The maximum is needed because the first estimate comes from third differences, and those of sparse
#: fixes contain motion.
MIN_SD_M, MIN_SD_RAD, MAX_START_M, MAX_START_RAD = 1e-4, 1e-3, 0.01, 0.1
#: NOISE_STEPS is the maximum number of iterations in which the noise of the fixes is estimated for a
#: candidate clock offset, FINAL_NOISE_STEPS that for the chosen offset. NOISE_TOL is the convergence
#: tolerance of the logarithm of the noise standard deviations.
NOISE_STEPS, FINAL_NOISE_STEPS, NOISE_TOL = 3, 12, 0.1
#: Minimum fraction of the noise variance of the fixes that remains in their residuals. It keeps the estimated
#: noise finite if the path follows every fix.
MIN_NOISE_LEFT = 0.1
#: Maximum fraction of outliers among the fixes. With more outliers, a warning is given, and a second path is
#: estimated for which no fix counts as an outlier.
MAX_STRAY = 0.05
#: Maximum fraction of outliers among the fixes for which the motion counts as possible. With more outliers,
#: positions and velocities are left empty.
MAX_WRONG = 0.5
#: Maximum factor by which correlated errors of the fixes widen the 95 % bands. A check fails for a larger
#: factor. At a factor of 2, four fixes count as one.
MAX_LASTING = 2.0
#: Maximum root-mean-square error of held-out fixes, divided by the predicted standard deviation.
MAX_HELD_OUT = 1.5
#: Duration of a block of fixes that are held out together, s, and minimum number of held-out fixes.
BLOCK_S, MIN_HELD_OUT = 0.5, 20
#: Minimum angle between the mounting from rotations and the mounting from gravity for a report of wrong axes,
#: rad.
MIN_MOUNT_CHANGE = 15 * DEG
#: Median of the absolute value of a standard normal variable. It converts a median absolute residual to a
#: standard deviation.
MEDIAN_SHARE = 0.6745
#: Clock offset of 0, which is assumed before the offset is estimated.
NO_OFFSET = Offset(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Fixes(Poses):
    """Fixes: poses that another log measured, with the noise of these measurements."""

    #: Standard deviations of the noise of the fixes, shape (6,): three coordinates (m) and three angles
    #: (rad).
    noise: Array
    #: Weights of position and attitude of each pose, shape (m, 2): 1, or less for an outlier. The variance of
    #: the noise is divided by the weight.
    weight: Array
    #: Flags of the fixes that are within the recording for every candidate clock offset, shape (m,). Only
    #: these fixes contribute to the log-likelihood.
    counted: Flags

    @property
    def sd(self) -> Array:
        """Standard deviations of the coordinates (m) and angles (rad) of each fix, shape (m, 6).

        The standard deviations of outliers are enlarged by the weights.
        """
        return np.asarray(self.noise / np.sqrt(np.repeat(self.weight, 3, axis=1)))

    @property
    def stray(self) -> Flags:
        """Flags of the fixes whose position, or whose attitude, is an outlier, shape (m, 2)."""
        return self.weight < 1

    def take(self, rows: Flags) -> Fixes:
        """Return the fixes that are selected by ``rows``, flags of shape (m,)."""
        each = ("time_s", "position", "angles", "weight", "counted")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})


@dataclass(frozen=True)
class MotionEstimate:
    """Estimated motion of a recording, with the rests that it assumes and its relation to another log."""

    #: Setup of the recording, with the rests that were used. While two logs are smoothed together, its
    #: attitude refers to the world axes of the other log.
    setup: ImuSetup
    #: State at the first sample before any observation, and standard deviations of its quantities.
    start: MotionState
    sd: dict[str, Any]
    #: Poses in the other log, with their estimated noise and weights; None without another log.
    fixes: Fixes = None  # type: ignore[assignment]
    #: Result of the last application of the smoother; None before the first.
    smoothed: SmoothedMotion = None  # type: ignore[assignment]
    findings: Sequence[Finding] = ()
    #: Reasons why the estimated motion is impossible; empty if it is possible.
    impossible: Sequence[str] = ()
    #: Clock offset of the other log, and whether the clocks of the two logs count as synchronised
    #: (``agree``). The Bayesian information criterion decides between an offset and synchronised clocks.
    offset: Offset = NO_OFFSET
    agree: bool = False
    #: Factor by which correlated errors of the fixes widen every 95 % band; 1 if the errors are independent.
    lasting: float = 1.0
    #: Errors of held-out fixes; None for too few fixes. ``fixes`` is their number, ``rms_m`` the
    #: root-mean-square error of the position, and ``deviations`` the root-mean-square error divided by the
    #: predicted standard deviation. If ``deviations`` exceeds 1, every band is multiplied by it.
    held_out: dict[str, float] | None = None

    @property
    def likelihood(self) -> float:
        """Log-likelihood of the observations, as the smoother computes it."""
        return self.smoothed.errors.likelihood

    @property
    def stray(self) -> int:
        """Number of fixes with a normalised residual above :data:`GATE`, which are outliers."""
        return int(np.sum(self.fixes.stray.any(axis=1)))


def estimate_motion(setup: ImuSetup, poses: Poses | None = None) -> MotionEstimate:
    """Estimate the motion of a recording, with the error class of the sensor and the accepted rests.

    Rests that contradict the motion are excluded. With another log, synchronised clocks are compared with
    every clock offset that the alignment found. The clocks count as synchronised unless an offset clearly
    increases the likelihood of the two logs. The 95 % bands are compared with the errors of held-out fixes.

    Raises
    ------
    NoTrustworthyResult
        The two logs do not show the same motion.
    InputError
        The axes of one log are mirrored.
    """
    if poses is not None:
        return _fuse(setup, poses)
    return _with_rests(setup, smooth_alone)


def _with_rests(setup: ImuSetup, attempt: Callable[[ImuSetup], MotionEstimate]) -> MotionEstimate:
    """Estimate the motion with only those rests that the estimated motion does not contradict.

    The result also holds findings, and the contradictions that remain. ``attempt`` estimates the motion from
    a setup.

    If the motion contradicts several rests, the rest with the largest contradiction is excluded first, then
    the next one, and finally all rests. If contradictions remain without rests, the motion counts as
    impossible.
    """
    used, found = setup, attempt(setup)
    first = found
    wrong = doubts = find_contradictions(found)
    reasons: list[str] = []
    while doubts and used.rests:
        dropped, reason = used.rests, "no rest is used"
        doubted = _find_doubtful_rests(found)
        if doubted and len(reasons) < MAX_SINGLE:
            _, reason, rest = max(doubted, key=lambda doubt: doubt[0])
            dropped = [rest]
        reasons.append(reason)
        used = used.drop_rests(dropped)
        found = attempt(used)
        doubts = find_contradictions(found)
    if doubts:
        return replace(first, setup=setup, impossible=wrong)
    classes = [name for name, sensor in recording.CLASSES.items() if sensor == found.smoothed.sensor]
    text = "the log shows the errors of {}; the error bands are computed for such a sensor"
    findings = [Finding("sensor class", "noted", text.format(name)) for name in classes]
    if wrong:
        count = len(setup.rests)
        text = f"{'; '.join(reasons)}: {count - len(used.rests)} of {count} rests are not used"
        findings.append(Finding("rests", "handled", text))
    return replace(found, setup=used, findings=findings)


def _smooth(
    found: MotionEstimate, sensor: Sensor | None = None, passes: int = 1, gate: float = np.inf
) -> MotionEstimate:
    """Apply the smoother with the noise in the estimate, and return the estimate with the smoothed motion.

    The iteration starts from the last result of the smoother, if there is one. The default error class of the
    sensor is that of this last result.
    """
    setup, last, fixes = found.setup, found.smoothed, found.fixes
    states = smoother.ALONE if fixes is None else smoother.FUSED

    def observe(path: Nominal) -> list[Observation]:
        if fixes is None:
            more = _speed_limit(setup.options.top_speed_m_s, path)
        else:
            more = _fixes(fixes, path, gate)
        return [*_rests(setup, path), *_attitudes(setup, path), *more]

    given = setup, found.start, found.sd, sensor or last.sensor
    smoothed = smoother.smooth_motion(*given, observe, states=states, after=last, passes=passes)
    setup.advance()
    return replace(found, smoothed=smoothed)


def _most_likely_class(found: MotionEstimate) -> MotionEstimate:
    """Estimate the motion with each error class of the sensor, and return the most likely estimate.

    The class changes only if the log-likelihood increases by more than ``MIN_GAIN``.
    """
    sensors = [sensor for sensor in recording.CLASSES.values() if sensor != found.smoothed.sensor]
    others = [_smooth(found, sensor) for sensor in sensors]
    best = max(others, key=lambda other: other.likelihood)
    return best if best.likelihood > found.likelihood + MIN_GAIN else found


def smooth_alone(setup: ImuSetup) -> MotionEstimate:
    """Estimate the most likely motion of a recording without another log.

    The path starts at the origin of the world.
    """
    stated = _smooth(_start(setup), setup.sensor, smoother.PASSES)
    best = _most_likely_class(stated)
    if best is stated:
        return stated
    return _smooth(best, passes=smoother.PASSES - 1)


# ---------------------------------------------------------------- observations


def _rests(setup: ImuSetup, path: Nominal) -> list[Observation]:
    """Return observations of zero velocity in rests, and of the gyroscope bias in still periods.

    The method is that of Skog et al. (2010).
    """
    record = setup.record
    observations = []
    by_velocity = jacobian(path.states, 3, velocity=np.eye(3))
    by_bias = jacobian(path.states, 3, rate_bias=np.eye(3))
    for rest in setup.still:
        nodes = rest_nodes(rest, path)
        if not len(nodes):
            continue
        if rest in setup.rests:
            for node in _space_nodes(path, nodes, REST_STEP_S):
                off, sd = -path.velocity[path.nodes[node]], np.full(3, REST_SPEED_SD)
                observations.append(Observation(int(node), "rest", off, by_velocity, sd))
        duration = path.time_s[rest.last - 1] - path.time_s[rest.first]
        middle = int(nodes[len(nodes) // 2])
        off = record.rate[rest.rows].mean(axis=0) - path.rate_bias[path.nodes[middle]]
        rate_sd = setup.noise.rate_rad_s_per_rt_hz / np.sqrt(max(duration, record.step_s))
        sd = np.full(3, np.hypot(rate_sd, REST_RATE_SD))
        observations.append(Observation(middle, "gyroscope at rest", off, by_bias, sd))
    return observations


def _attitudes(setup: ImuSetup, path: Nominal) -> list[Observation]:
    """Return observations for the smoother of the attitude that was estimated before smoothing.

    The standard deviations account for errors of this attitude that are correlated in time.

    The tilt of an attitude filter is wrong for some seconds while the body accelerates. The quaternions of a
    sensor may have the same rotation error throughout a log, so that all of them together count as one
    measurement.
    """
    source = setup.source
    nodes = _space_nodes(path, np.arange(len(path.nodes)), STEP_S)
    axes = slice(0, 3 if source.heading else 2)
    at = path.nodes[nodes]
    off = (source.rotation[at] * path.rotation[at].inv()).as_rotvec()[:, axes]
    memory_s = FILTER_MEMORY_S
    if source.kind == recording.QUATERNIONS:
        memory_s = max(QUATERNION_MEMORY_S, 0.5 * float(np.ptp(path.time_s)))
    sd = np.full(axes.stop, setup.attitude_sd * np.sqrt(2 * memory_s))
    h = jacobian(path.states, 3, rotation=np.eye(3))[axes]
    return [Observation(int(n), "attitude", turn, h, sd) for n, turn in zip(nodes, off, strict=True)]


def _speed_limit(top_m_s: float, path: Nominal) -> list[Observation]:
    """Return observations for the smoother that limit the speed of the robot to its top speed.

    Each observation is a velocity of 0 with half of the top speed as standard deviation. All observations of
    a log together have the weight of a single one, so that they do not reduce the speed of a steady cruise.
    """
    nodes = _space_nodes(path, np.arange(len(path.nodes)), STEP_S)
    h = jacobian(path.states, 3, velocity=np.eye(3))
    sd = np.full(3, 0.5 * top_m_s * np.sqrt(len(nodes)))
    velocity = path.velocity[path.nodes]
    return [Observation(int(node), "top speed", -velocity[node], h, sd) for node in nodes]


def rest_nodes(rest: recording.Rest, path: Nominal) -> np.ndarray:
    """Return the indices of the nodes of a path that lie within a rest."""
    return np.flatnonzero((path.nodes >= rest.first) & (path.nodes < rest.last))


def _space_nodes(path: Nominal, nodes: np.ndarray, step_s: float) -> np.ndarray:
    """Return a subset of the nodes of a path, with at least ``step_s`` between successive nodes."""
    times = path.node_s[nodes]
    marks = np.arange(times[0], times[-1] + 1e-9, step_s)
    return nodes[np.unique(np.clip(np.searchsorted(times, marks), 0, len(nodes) - 1))]


def _fixes(seen: Fixes, path: Nominal, gate: float = np.inf) -> list[Observation]:
    """Return observations for the smoother of all fixes of another log within the time range of a path.

    Parameters
    ----------
    gate : float
        Maximum innovation, in standard deviations. Larger innovations are outliers.
    """
    index, nodes, off, by_error = _differences(seen, path)
    sd, counted = seen.sd[index], seen.counted[index].tolist()
    observations = []
    for k, node in enumerate(nodes.tolist()):
        for kind, first in (("position", 0), ("orientation", 3)):
            rows = first + np.flatnonzero(np.isfinite(off[k, first : first + 3]))
            if len(rows):
                values = off[k, rows], by_error[k, rows], sd[k, rows]
                observations.append(Observation(node, kind, *values, gate, counted[k]))
    return observations


def _differences(seen: Poses, path: Nominal) -> tuple[np.ndarray, np.ndarray, Array, Array]:
    """Return the differences between measured poses and a path, for poses within its time range.

    Returns
    -------
    index, nodes : ndarray of int, shape (k,)
        Index of each pose in ``seen``, and the node of the path nearest to it in time.
    off : ndarray, shape (k, 6)
        Differences of position, m, and attitude, rad; NaN where not measured.
    by_error : ndarray, shape (k, 6, states)
        Derivatives of the pose with respect to the errors of the path.
    """
    t = path.time_s
    clock_times = seen.time_s + path.clock_s
    index = np.flatnonzero((clock_times >= t[0]) & (clock_times <= t[-1]))
    when = clock_times[index]
    velocity, place = resampled(when, t, path.velocity), resampled(when, t, path.position)
    row, nodes = _nearest(t, when), _nearest(path.node_s, when)
    turn = Rotation.from_rotvec(path.rate[row] * (when - t[row])[:, None])
    rotation = path.rotation[row] * turn
    lever, spin = rotation.apply(path.lever), rotation.apply(path.rate[row])
    matrices, turns = rotation.as_matrix(), np.isfinite(seen.angles[index])
    turned, by_turn = _compare_attitudes(seen.rotation[index], turns, rotation * path.mount)
    by_place = jacobian(
        path.states,
        *place.shape,
        position=np.eye(3),
        velocity=np.eye(3) * (when - path.node_s[nodes])[:, None, None],
        rotation=-skew_matrices(lever),
        lever=matrices,
        clock_s=(velocity + np.cross(spin, lever))[:, :, None],
    )
    by_angle = jacobian(
        path.states,
        *turned.shape,
        rotation=by_turn,
        mount=by_turn @ matrices,
        clock_s=by_turn @ spin[:, :, None],
    )
    off = np.hstack([seen.position[index] - place - lever, np.where(turns, turned, np.nan)])
    return index, nodes, off, np.concatenate([by_place, by_angle], axis=1)


def _nearest(times: Array, when: Array) -> np.ndarray:
    """Return the index of the element of ``times`` that is nearest to each time in ``when``."""
    index = np.clip(np.searchsorted(times, when), 1, len(times) - 1)
    return index - ((when - times[index - 1]) < (times[index] - when))


def _compare_attitudes(measured: Rotation, turns: Flags, body: Rotation) -> tuple[Array, Array]:
    """Return measured minus estimated attitude (rad), and its derivative for a small rotation of the body.

    The difference has shape (k, 3), its derivative shape (k, 3, 3). If all three angles are measured, the
    difference is a small rotation about world axes. A single measured angle is compared as an angle, because
    the yaw of a tilted body differs from its rotation about the vertical.
    """
    if turns.all(axis=1).any():
        return (measured * body.inv()).as_rotvec(), np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    off = np.column_stack(angles(measured)) - np.column_stack(angles(body))
    by_turn, pitch = recording.turn_to_angles(body), angles(body)[1][:, None]
    # Correct the derivatives for pitch: at a pitch other than 0, a rotation about the heading direction
    # changes roll by 1/cos(pitch), and also changes yaw.
    by_turn[:, 0] /= np.maximum(np.cos(pitch), 0.1)
    by_turn[:, 2] -= np.sin(pitch) * by_turn[:, 0]
    return np.angle(np.exp(1j * off)), by_turn


# ---------------------------------------------------------------- contradictions


def find_contradictions(found: MotionEstimate) -> list[str]:
    """Return a sentence for each contradiction of the motion with rests, attitude or most of the fixes."""
    setup, smoothed, fixes = found.setup, found.smoothed, found.fixes
    if not np.isfinite(smoothed.errors.mean).all():
        return ["the smoothing has no finite result"]
    sentences = [text for _, text, _ in _find_doubtful_rests(found)]
    up, other = (r.inv().apply([0.0, 0.0, 1.0]) for r in (smoothed.path.rotation, setup.source.rotation))
    away = np.arctan2(np.linalg.norm(np.cross(up, other), axis=1), np.sum(up * other, axis=1))
    tilt = slice(smoother.ERROR_SLICES["rotation"].start, smoother.ERROR_SLICES["rotation"].start + 2)
    own = float(np.mean(np.trace(smoothed.errors.covariance[:, tilt, tilt], axis1=1, axis2=2)))
    off = float(np.sqrt(np.mean(away**2)))
    limit = GATE * float(np.sqrt(2 * setup.attitude_sd**2 + own))
    if off > limit:
        sentences.append(
            f"its tilt differs from that of the {setup.source.kind} by {off / DEG:.0f} deg rms, "
            f"more than {GATE:g} deviations ({limit / DEG:.0f} deg)"
        )
    if fixes is not None:
        stray = fixes.stray[np.isfinite(fixes.position).any(axis=1), 0]
        if len(stray) and np.mean(stray) > MAX_WRONG:
            share = 100 * np.mean(stray)
            sentences.append(f"{share:.0f} % of the fixes lie beyond {GATE:g} deviations of it")
    return sentences


def _find_doubtful_rests(found: MotionEstimate) -> list[tuple[float, str, recording.Rest]]:
    """Return the rests that the motion contradicts by more than ``GATE`` standard deviations.

    Each entry holds the contradiction in standard deviations, a sentence about it, and the rest.
    """
    doubted = []
    for rest in found.setup.rests:
        size = _departure(found.setup, found.smoothed, rest)
        if size > GATE:
            begin, end = found.setup.record.time_s[[rest.first, rest.last - 1]]
            text = f"the rest from {begin:.1f} to {end:.1f} s contradicts the motion by {size:.0f} deviations"
            doubted.append((size, text, rest))
    return doubted


def _departure(setup: ImuSetup, smoothed: SmoothedMotion, rest: recording.Rest) -> float:
    """Return the deviation of the estimated motion from standstill in a rest, in standard deviations.

    The result is the largest deviation of velocity, turn rate and acceleration.
    """
    record, path, errors = setup.record, smoothed.path, smoothed.errors
    nodes = rest_nodes(rest, path)
    if not len(nodes):
        return 0.0
    middle = int(nodes[len(nodes) // 2])
    covariance = errors.covariance[middle]
    variance = np.diag(covariance)

    def mean(values: Array) -> Array:
        return np.asarray(values[rest.rows].mean(axis=0))

    moving = np.abs(mean(path.velocity)) / np.sqrt(
        variance[smoother.ERROR_SLICES["velocity"]] + REST_SPEED_SD**2
    )
    turning = np.abs(mean(path.rate)) / np.sqrt(
        variance[smoother.ERROR_SLICES["rate_bias"]] + REST_RATE_SD**2
    )
    duration = max(float(path.time_s[rest.last - 1] - path.time_s[rest.first]), record.step_s)
    force = path.rotation[rest.rows].apply(path.force[rest.rows]).mean(axis=0)
    turn = path.rotation[int(path.nodes[middle])].as_matrix()
    h = jacobian(
        path.states,
        3,
        rotation=-skew_matrices(force),
        acceleration_bias=-turn,
        acceleration_scale=-np.kron(turn, mean(record.acceleration)),
    )
    spread = np.diag(h @ covariance @ h.T) + 2 * (REST_SPEED_SD / duration) ** 2
    return float(np.max([moving, turning, np.abs(mean(path.acceleration)) / np.sqrt(spread)]))


# ---------------------------------------------------------------- another log


def _fuse(setup: ImuSetup, poses: Poses) -> MotionEstimate:
    """Align the recording with another log, and estimate the motion from the two logs together."""
    refusal = None
    try:
        offsets = alignment.align(setup.record, setup.source, poses, setup.options.clock_offset_s)
    except NoTrustworthyResult as error:
        # Assume a clock offset of zero. The data may not determine the offset although the clocks are
        # synchronised. Held-out positions can still show that both logs record the same motion.
        refusal, offsets = error, alignment.align(setup.record, setup.source, poses, 0.0)
    if offsets[0].handed < 0:
        text = "the turns mirror those in the camera log: an axis is flipped in either log"
        hint = "correct the axes in a mapping (--map), with factor: -1 for a flipped axis"
        raise InputError(text, file=setup.record.name, column="wx_rad_s ... wz_rad_s", hint=hint)
    setup, findings = _start_mount(setup, offsets[0])
    start = _first_fixes(setup, poses, offsets)
    found = _with_rests(setup, lambda setup: _set_clocks(setup, start, offsets))
    errors, offset, held_out = found.smoothed.errors, found.offset, _hold_out(found)
    if refusal is not None and not _predicts(held_out, poses):
        raise refusal
    factor = lasting = _lasting_factor(found)
    if held_out is not None:
        factor *= max(held_out["deviations"], 1.0)
    low, high = (offset.value_s + factor * (end - offset.value_s) for end in (offset.low_s, offset.high_s))
    return replace(
        found,
        smoothed=replace(found.smoothed, errors=replace(errors, covariance=errors.covariance * factor**2)),
        findings=[*findings, *found.findings],
        offset=replace(offset, stderr_s=factor * offset.stderr_s, low_s=low, high_s=high),
        lasting=lasting,
        held_out=held_out,
    )


def _start_mount(setup: ImuSetup, found: Offset) -> tuple[ImuSetup, list[Finding]]:
    """Return the setup with an initial mounting of the sensor, and findings about the mounting.

    The mounting is the one that the user states. Otherwise it follows from the three angles of the other log
    or, if these are missing, from gravity.
    """
    if setup.mount.by == "given" or found.mount is None:
        return setup, []
    off = float((found.mount * setup.mount.rotation.inv()).magnitude())
    findings = []
    if off > MIN_MOUNT_CHANGE:
        text = (
            f"the sensor is turned by {off / DEG:.0f} deg against the body of the camera log (by turn rates)"
        )
        findings.append(Finding("swapped or flipped axes", "handled", text))
    return replace(setup, mount=replace(setup.mount, rotation=found.mount, sd=TURNS_MOUNT_SD)), findings


def _first_fixes(setup: ImuSetup, poses: Poses, candidates: list[Offset]) -> Fixes:
    """Return the poses of another log as fixes, with a first estimate of their noise.

    Only poses within the record for every candidate clock offset contribute to the log-likelihood. Thus the
    offsets are compared on the same poses.
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
    noises = [white_noise_sd(angle, MIN_SD_RAD) for angle in poses.angles.T[poses.has_angle]]
    noise = np.append(sd, [min(max(noises, default=MIN_SD_RAD), MAX_START_RAD)] * 3)
    t, margin = setup.record.time_s, BAND * CLOCK_SD
    offsets = [0.0, *(found.value_s for found in candidates)]
    counted = (poses.time_s + min(offsets) - margin >= t[0]) & (poses.time_s + max(offsets) + margin <= t[-1])
    return Fixes(poses.time_s, position, poses.angles, noise, np.ones((len(position), 2)), counted)


# ---------------------------------------------------------------- clocks and noise


def _set_clocks(setup: ImuSetup, fixes: Fixes, candidates: list[Offset]) -> MotionEstimate:
    """Estimate the motion with the most likely clock offset, or with synchronised clocks."""
    stated_s = setup.options.clock_offset_s
    if stated_s is not None:
        found = _at_offset(setup, fixes, stated_s, held=True)
        found = _with_noise(found, FINAL_NOISE_STEPS, noise_known=True)
        return replace(found, offset=_final_offset(found.smoothed))
    starts: list[Offset] = []
    for one in candidates:
        if all(abs(one.value_s - s.value_s) / np.hypot(one.stderr_s, s.stderr_s) > BAND for s in starts):
            starts.append(one)
    attempts = [_at_offset(setup, fixes, start.value_s, held=False) for start in starts]
    free = _with_noise(max(attempts, key=lambda found: found.likelihood), FINAL_NOISE_STEPS, noise_known=True)
    # Choose an offset over synchronised clocks only if it increases the log-likelihood by more than half of
    # the penalty of the Bayesian information criterion for one additional parameter (Schwarz 1978,
    # doi:10.1214/aos/1176344136). Without common fixes the two hypotheses cannot be compared.
    price = 0.5 * float(np.log(max(fixes.counted.sum(), 1)))
    if abs(free.smoothed.path.clock_s) <= BAND * CLOCK_SD:
        equal = _at_offset(setup, fixes, 0.0, held=True, after=free)
    else:
        equal = _at_offset(setup, fixes, 0.0, held=True)
        if free.likelihood <= equal.likelihood + price:
            free = _at_offset(setup, fixes, 0.0, held=False, after=equal)
    offset = _final_offset(free.smoothed)
    if free.likelihood > equal.likelihood + price or not fixes.counted.any():
        return replace(free, offset=offset)
    low, high = min(offset.low_s, 0.0), max(offset.high_s, 0.0)
    equal = _with_noise(equal, FINAL_NOISE_STEPS, noise_known=True)
    return replace(equal, offset=replace(offset, value_s=0.0, low_s=low, high_s=high), agree=True)


def _at_offset(
    setup: ImuSetup, fixes: Fixes, offset_s: float, *, held: bool, after: MotionEstimate | None = None
) -> MotionEstimate:
    """Estimate the motion from two logs, with the given clock offset as initial or fixed value.

    Noise and weights of the fixes, and the error class of the sensor, are estimated from the residuals.

    Parameters
    ----------
    offset_s : float
        Initial clock offset of the other log, s.
    held : bool
        Whether the clock offset is fixed at its initial value.
    after : Estimate, optional
        Result from which the iteration continues.
    """
    begun = _start(setup, fixes, offset_s, held=held)
    if after is not None:
        path, origin = replace(after.smoothed.path, clock_s=offset_s), after.smoothed.origin
        smoothed = replace(after.smoothed, path=path, origin=replace(origin, clock_s=offset_s))
        known = replace(after.fixes, weight=np.ones_like(after.fixes.weight))
        return _with_noise(replace(begun, fixes=known, smoothed=smoothed), noise_known=True)
    # Fix the clock offset in the first iterations, because its effect depends on the velocity, which is not
    # yet known.
    fixed = replace(begun, sd={**begun.sd, "clock_s": HELD_CLOCK_SD})
    gated = replace(_smooth(fixed, setup.sensor, 2, GATE), sd=begun.sd)
    attempts = [_with_noise(gated)]
    if gated.smoothed.errors.rejected > MAX_STRAY * len(fixes.time_s):
        # With many outliers, either the fixes or the path can be wrong. Estimate the motion also without
        # excluding outliers, and compare the likelihoods.
        attempts.append(_with_noise(replace(_smooth(fixed, setup.sensor, 2), sd=begun.sd)))
    return max(attempts, key=lambda found: found.likelihood)


def _start(
    setup: ImuSetup, fixes: Fixes | None = None, offset_s: float = 0.0, *, held: bool = True
) -> MotionEstimate:
    """Return the estimate before smoothing: initial state, its standard deviations, and fixes.

    The setup is in the world axes of the other log. Without another log, the path starts at the origin of the
    world. If ``held`` is true, the clock offset is fixed.
    """
    source, place, velocity_sd = setup.source, np.zeros(3), VELOCITY_SD
    place_sd, yaw_sd = ORIGIN_SD, ORIGIN_SD
    if fixes is None:
        velocity_sd = 0.5 * setup.options.top_speed_m_s
        if setup.rests and setup.rests[0].first == 0:
            velocity_sd = REST_SPEED_SD
        if source.heading:
            yaw_sd = recording.QUATERNION_SD
    else:
        on_record = replace(fixes, time_s=fixes.time_s + offset_s)
        turn = alignment.find_world_turn(setup.record, source, on_record, setup.mount.rotation)
        source = replace(source, rotation=turn * source.rotation, heading=False)
        fixed, place_sd, yaw_sd = fixes.position[np.isfinite(fixes.position).any(axis=1)], 1.0, FREE_YAW_SD
        if len(fixed):
            place = np.nan_to_num(fixed[0])
            place_sd += float(np.max(np.nan_to_num(np.ptp(fixed, axis=0))))
        if fixes.has_angle[2]:
            yaw_sd = YAW_SD
    lever_sd = np.full(3, STATED_LEVER_SD)
    if setup.options.lever_m is None:
        # Convert the variances along body axes to those along sensor axes.
        lever_sd = np.sqrt(setup.mount.rotation.as_matrix() ** 2 @ np.square(LEVER_SD))
    state = MotionState(
        rotation=source.rotation[0],
        position=place,
        rate_bias=setup.still_rate,
        lever=setup.lever,
        mount=setup.mount.rotation,
        clock_s=offset_s,
    )
    sd = {
        "position": place_sd,
        "velocity": velocity_sd,
        "rotation": (START_TILT_SD, START_TILT_SD, yaw_sd),
        "lever": lever_sd,
        "mount": setup.mount.sd,
        "tilt": TILT_SD,
        "clock_s": HELD_CLOCK_SD if held else CLOCK_SD,
    }
    return MotionEstimate(replace(setup, source=source), state, sd, fixes)  # type: ignore[arg-type]


def _with_noise(
    found: MotionEstimate, steps: int = NOISE_STEPS, *, noise_known: bool = False
) -> MotionEstimate:
    """Iterate noise and weights of the fixes, error class of the sensor and motion until convergence."""
    for step in range(steps):
        fixes = last = found.fixes
        if step or not noise_known:
            fixes = _estimate_noise(found.smoothed, fixes, found.setup.options.fix_sd_m)
        if step > 1 - noise_known and np.nanmax(np.abs(np.log(fixes.noise / last.noise))) < NOISE_TOL:
            break
        found = _smooth(replace(found, fixes=fixes))
        if step == 1 and not noise_known:
            found = _most_likely_class(found)
    return found


def _residuals(fixes: Fixes, smoothed: SmoothedMotion) -> tuple[Array, Array]:
    """Return the residuals of the fixes, and the part of their variances that results from the motion.

    Both arrays have one column for each coordinate and angle, shape (m, 6).

    Residuals are NaN where nothing was measured, and for fixes outside of the record.
    """
    residual, variance = np.full((2, len(fixes.time_s), 6), np.nan)
    index, nodes, _, by_error = _differences(fixes, replace(smoothed.about, clock_s=smoothed.path.clock_s))
    off = _differences(fixes, smoothed.path)[2]
    spread = np.einsum("nij,njk,nik->ni", by_error, smoothed.errors.covariance[nodes], by_error)
    residual[index], variance[index] = off, np.where(np.isfinite(off), spread, np.nan)
    return residual, variance


def _is_measured(fixes: Fixes, residual: Array) -> Flags:
    """Return whether each residual compares a measured value with the motion, shape (m, 6).

    In a planar log, the coordinates across the plane are assumed and not measured.
    """
    plane = np.append(fixes.noise[:3] == PLANE_SD, np.zeros(3, dtype=bool))
    return np.asarray(np.isfinite(residual) & ~plane)


def _estimate_noise(smoothed: SmoothedMotion, fixes: Fixes, fix_sd_m: float | None) -> Fixes:
    """Return a copy of the fixes with noise and weights estimated from their residuals.

    The fixes that are not outliers give the noise: the sum of their squared residuals, divided by the number
    of degrees of freedom that the motion leaves them (MacKay 1992, doi:10.1162/neco.1992.4.3.415, eq. 2.24).
    This iteration converges to the same noise as expectation maximisation, which needs many more iterations.
    The weight of an outlier decreases with the square of its residual (Cauchy). No fix is excluded, so that a
    path that follows outliers can recover.
    """
    residual, variance = _residuals(fixes, smoothed)
    place_sd, place = _noise_and_weight(residual[:, :3], variance[:, :3], fixes.noise[:3])
    turn_sd, turn = _noise_and_weight(residual[:, 3:], variance[:, 3:], fixes.noise[3:])
    noise = fixes.noise.copy()
    if fix_sd_m is None:
        known = (noise[:3] == PLANE_SD) | ~np.isfinite(place_sd)
        noise[:3] = np.where(known, noise[:3], np.maximum(np.nan_to_num(place_sd), MIN_SD_M))
    if np.isfinite(turn_sd).any():
        noise[3:] = max(float(np.sqrt(np.nanmean(turn_sd**2))), MIN_SD_RAD)
    return replace(fixes, noise=noise, weight=np.column_stack([place, turn]))


def _noise_and_weight(residual: Array, variance: Array, sd: Array) -> tuple[Array, Array]:
    """Return the standard deviation of each column of residuals, and the weight of each row (fix).

    The standard deviations have the shape (3,). The standard deviation of a column without values is NaN.
    """
    usual = np.ma.median(np.ma.masked_invalid(np.abs(residual)), axis=0).filled(np.nan) / MEDIAN_SHARE
    far = np.abs(residual) / np.fmax(sd, usual)
    weight = np.minimum(1.0, (GATE / np.fmax(np.fmax.reduce(far, axis=1), 1e-12)) ** 2)
    used = np.where(weight[:, None] == 1, [residual**2, variance / sd**2], np.nan)
    squares, absorbed = np.ma.masked_invalid(used).mean(axis=1).filled(np.nan)
    return np.sqrt(squares / np.maximum(1.0 - absorbed, MIN_NOISE_LEFT)), weight


def _final_offset(smoothed: SmoothedMotion) -> Offset:
    """Return the clock offset that the smoother estimated, with its 95 % interval.

    The interval is widened if the innovations exceed their standard deviations.
    """
    scores = smoothed.errors.scores
    seen = [score for kind in ("position", "orientation") for score in scores.get(kind, ())]
    widening = 1.0
    if seen:
        widening = max(float(np.sqrt(np.mean(np.concatenate(seen) ** 2))), 1.0)
    value, place = float(smoothed.path.clock_s), smoother.ERROR_SLICES["clock_s"].start
    sd = widening * float(np.sqrt(smoothed.errors.covariance[-1, place, place]))
    return Offset(value, sd, value - BAND * sd, value + BAND * sd)


# ---------------------------------------------------------------- tests of the result


def _hold_out(found: MotionEstimate) -> dict[str, float] | None:
    """Predict every fourth block of fixes from the other blocks, and return the errors of the prediction.

    Return None for too few fixes.

    A block lasts half a second, because the neighbours of a single held-out fix would determine its pose.
    """
    fixes = found.fixes
    block = np.floor((fixes.time_s - fixes.time_s[0]) / BLOCK_S).astype(int)
    if len(block) > 1 and np.median(np.diff(fixes.time_s)) > BLOCK_S:
        block = np.arange(len(block))
    out = block % 4 == 2
    count = int(np.sum(out & (np.isfinite(fixes.position).any(axis=1) | fixes.has_attitude)))
    if count < MIN_HELD_OUT:
        return None
    held = found.setup.options.clock_offset_s is not None or found.agree
    begun = _start(found.setup, fixes, found.smoothed.path.clock_s, held=held)
    smoothed = _smooth(replace(begun, fixes=fixes.take(~out), smoothed=found.smoothed)).smoothed
    left_out = fixes.take(out)
    residual, variance = _residuals(left_out, smoothed)
    measured = _is_measured(left_out, residual)
    squares = (residual**2 / (variance + left_out.sd**2))[measured]
    places = residual[:, :3][measured[:, :3]]
    return {
        "fixes": count,
        "rms_m": float(np.sqrt(np.sum(places**2) / max(len(places), 1))),
        "deviations": float(np.sqrt(np.mean(squares))),
    }


def _predicts(held_out: dict[str, float] | None, poses: Poses) -> bool:
    """Return whether held-out fixes are predicted well enough to show the same motion in both logs."""
    if held_out is None or held_out["deviations"] > MAX_HELD_OUT:
        return False
    place = poses.position[:, np.isfinite(poses.position).any(axis=0)]
    rows = np.isfinite(place).all(axis=1)
    fast = alignment.remove_drift(poses.time_s[rows], place[rows], alignment.SLOW_PATH_S)
    return held_out["rms_m"] ** 2 < (1 - alignment.MIN_EXPLAINED) * float(np.mean(fast**2))


def _lasting_factor(found: MotionEstimate) -> float:
    """Return the factor by which correlated errors of the fixes enlarge the standard error of their mean.

    The factor is the square root of the integrated autocorrelation of the residuals. The sum ends before the
    first autocorrelation that is not positive (initial sequence of Geyer 1992, doi:10.1214/ss/1177011137).
    """
    fixes = found.fixes
    residual, _ = _residuals(fixes, found.smoothed)
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
