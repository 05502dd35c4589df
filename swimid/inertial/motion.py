"""Motion of the reference point of the body, its standard deviations, and surge within a stroke."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import alone, fusion
from swimid.inertial.alone import GATE
from swimid.inertial.fusion import Fused
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import (
    ACCELERATION,
    RATE,
    Array,
    Finding,
    Poses,
    Record,
    integral,
    resampled,
    turn_to_angles,
)
from swimid.inertial.setup import BAND, Setup
from swimid.inertial.smoother import Nominal, Smoothed, cross_matrix, gravity, jacobian
from swimid.logs import beat
from swimid.logs.beat import Rhythm
from swimid.logs.kinematics import angles

#: Maximum half-width of the 95 % band of a usable position: in m, and relative to the distance travelled.
TRUSTED_WIDTH_M, TRUSTED_SHARE = 0.1, 0.1
#: Minimum frequency of motion within a stroke: relative to the stroke frequency, and in Hz if that is
#: unknown.
STROKE_SHARE, LOWEST_HZ = 0.5, 0.3
#: Number of random error trajectories. They give a standard deviation to 1 / sqrt(2 N_DRAWS) = 6 %.
N_DRAWS = 128
#: Minimum number of samples for the high-pass filter, and its maximum cut-off frequency in sample rates.
MIN_FILTERED, MAX_CUTOFF = 32, 0.45
#: Names of the three angles of an attitude.
ANGLES = ("roll", "pitch", "yaw")
#: Quantities that are left empty where the motion is impossible.
EMPTIED = ("position", "velocity", "body_velocity", "position_sd", "velocity_sd", "body_velocity_sd")


@dataclass(frozen=True)
class Motion:
    """Motion of the reference point at n samples. Arrays have shape (n, 3)."""

    time_s: Array
    #: Rotation from body to world axes, n elements.
    rotation: Rotation
    #: Position, m, and velocity, m/s, along world axes.
    position: Array
    velocity: Array
    #: Surge, sway and heave velocity, m/s.
    body_velocity: Array
    #: Turn rate about body axes, rad/s.
    rate: Array
    #: Acceleration of the sensor without gravity, along world axes, m/s^2.
    acceleration: Array
    #: Standard deviations, in the units of their quantities. The angles are roll, pitch and yaw, rad.
    position_sd: Array
    velocity_sd: Array
    body_velocity_sd: Array
    angle_sd: Array


def attitude_only(
    time_s: Array, rotation: Rotation, rate: Array, acceleration: Array, attitude_sd: float
) -> Motion:
    """Return a motion without position and velocity; see :class:`Motion` for shapes and units."""
    empty = np.full((len(time_s), 3), np.nan)
    sd = np.full((len(time_s), 3), attitude_sd)
    return Motion(time_s, rotation, empty, empty, empty, rate, acceleration, empty, empty, empty, sd)


def _carried(path: Nominal) -> tuple[Array, Array, Array, Array]:
    """Return the velocity at the reference point, and the derivatives of the motion there.

    The velocity is along world axes and has shape (n, 3). The derivatives are those of position, velocity and
    body rotation with respect to the errors at the nodes. Each has shape (nodes, 3, states).
    """
    rows = path.nodes
    rate, rotation = path.rate[rows], path.rotation[rows]
    matrix = rotation.as_matrix()
    shape = (path.states, len(rows), 3)
    arm, swing = rotation.apply(path.lever), rotation.apply(np.cross(rate, path.lever))
    by_place = jacobian(*shape, position=np.eye(3), rotation=-cross_matrix(arm), lever=matrix)
    by_speed = jacobian(
        *shape,
        velocity=np.eye(3),
        rotation=-cross_matrix(swing),
        rate_bias=matrix @ cross_matrix(path.lever),
        lever=matrix @ cross_matrix(rate),
    )
    by_turn = jacobian(*shape, rotation=np.eye(3), mount=matrix)
    velocity = path.velocity + path.rotation.apply(np.cross(path.rate, path.lever))
    return velocity, by_place, by_speed, by_turn


def at_reference(smoothed: Smoothed) -> Motion:
    """Return the motion of the reference point with its standard deviations."""
    path, covariance = smoothed.path, smoothed.errors.covariance
    body, rows = path.rotation * path.mount, path.nodes
    velocity, by_place, by_speed, by_turn = _carried(path)
    by_body_speed = _in_body(body[rows], velocity[rows], by_speed, by_turn)

    def sd(jacobian: Array) -> Array:
        variance = np.einsum("nij,njk,nik->ni", jacobian, covariance, jacobian)
        return resampled(path.time_s, path.node_s, np.sqrt(np.maximum(variance, 0.0)))

    return Motion(
        path.time_s,
        body,
        path.position + path.rotation.apply(path.lever),
        velocity,
        body.inv().apply(velocity),
        path.mount.inv().apply(path.rate),
        path.acceleration,
        sd(by_place),
        sd(by_speed),
        sd(by_body_speed),
        sd(turn_to_angles(body[rows]) @ by_turn),
    )


def _in_body(body: Rotation, velocity: Array, speed_error: Array, turn_error: Array) -> Array:
    """Return velocity errors along body axes, from the errors of velocity and rotation along world axes.

    ``velocity`` has shape (n, 3). The errors have shape (n, 3, m), where m counts random samples or
    derivatives.
    """
    to_body = np.swapaxes(body.as_matrix(), 1, 2)
    return np.asarray(to_body @ (speed_error + cross_matrix(velocity) @ turn_error))


def surge_within_stroke(motion: Motion, smoothed: Smoothed, cutoff_hz: float) -> tuple[Array, Array]:
    """Return the surge velocity within a stroke and its standard deviation, m/s, each of shape (n,).

    The velocity is high-pass filtered along world axes before it is converted to body axes. Otherwise drift
    would enter the surge velocity as the heading oscillates.

    Notes
    -----
    The standard deviation is that of :data:`N_DRAWS` random trajectories of the errors, filtered like the
    velocity. It contains every error above the cut-off frequency: noise, errors of scale and alignment times
    gravity and motion, and errors of the attitude times gravity.
    """
    fast = _high_pass(motion.time_s, motion.velocity, cutoff_hz)
    surge = motion.rotation.inv().apply(fast)[:, 0]
    path = smoothed.path
    nodes = len(path.nodes)
    drawn = smoothed.errors.draw(np.concatenate(_carried(path)[2:], axis=1), N_DRAWS)
    speed = _high_pass(path.node_s, drawn[:, :3].reshape(nodes, -1), cutoff_hz).reshape(nodes, 3, N_DRAWS)
    error = _in_body(motion.rotation[path.nodes], fast[path.nodes], speed, drawn[:, 3:])[:, 0]
    sd = np.interp(motion.time_s, path.node_s, np.sqrt(np.mean(error**2, axis=1)))
    return np.asarray(surge), sd


def _high_pass(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """Return channels, shape (n, k), after a high-pass filter with the cut-off frequency ``cutoff_hz``.

    The filter is a Butterworth filter of fourth order without phase shift. The result is NaN if the record is
    too short for the filter or has too low a sample rate.
    """
    from scipy import signal

    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < MIN_FILTERED or cutoff_hz >= MAX_CUTOFF / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    length = min(len(even) - 1, int(3 / (cutoff_hz * step)))
    fast = signal.sosfiltfilt(sos, resampled(even, time_s, values), axis=0, padlen=length)
    return resampled(time_s, even, fast)


def compute_by_paper(record: Record, rotation: Rotation, options: TrackImuOptions) -> tuple[Motion, Array]:
    """Compute the motion of a vehicle by the method of the long-fin paper.

    Parameters
    ----------
    record : Record
        Recording of n samples in body axes.
    rotation : Rotation
        Attitude from body to earth, shape (n,): the inverse of ``M_e^f`` of the paper.
    options : TrackImuOptions
        Thresholds ("discarded", sec. 5.2) and motion mode. In the modes ``marching`` and ``receding`` the
        constant parts of all six channels are errors and gravity, and are subtracted. In the mode
        ``rotating`` the mean yaw rate is motion, and is not subtracted.

    Returns
    -------
    Motion
        Motion without standard deviations.
    ndarray, shape (6,)
        Constant parts of the channels, m/s^2 and rad/s.

    Notes
    -----
    The method is that of Shang, Wang, Tan and Cheng (2012, doi:10.1017/S0263574711001159), section 5. The
    constant part of the readings is subtracted, small readings are set to zero, and accelerations are
    converted to the earth's axes (Eq 10). Velocity and position follow by the trapezoidal rule (Eqs 12 and
    13). The paper states neither its filter, nor the thresholds, nor an uncertainty. Because the mean
    acceleration is subtracted, the final velocity always equals the initial one.
    """
    constant = record.channels.mean(axis=0)
    if options.motion_mode == "rotating":
        constant[5] = 0.0
    readings = record.channels - constant
    thresholds = np.repeat([options.threshold_m_s2, options.threshold_rad_s], 3)
    readings[np.abs(readings) < thresholds] = 0.0
    acceleration = rotation.apply(readings[:, :3])
    velocity = integral(record.time_s, acceleration)
    moved = attitude_only(record.time_s, rotation, readings[:, 3:], acceleration, np.nan)
    body_velocity = rotation.inv().apply(velocity)
    position = integral(record.time_s, velocity)
    return replace(moved, position=position, velocity=velocity, body_velocity=body_velocity), constant


# ---------------------------------------------------------------- limits of the motion


def find_trust(time_s: Array, position: Array, position_sd: Array) -> float | None:
    """Return the time at which the horizontal 95 % band exceeds 0.1 m and 10 % of the distance travelled.

    The time is on the clock of the log, s. It is None if the whole position can be used.

    Parameters
    ----------
    position, position_sd : ndarray, shape (n, 3)
        Position and standard deviation, m. A position of NaN cannot be used.
    """
    half = BAND * np.max(position_sd[:, :2], axis=1)
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T)))
    beyond = np.flatnonzero(~(half <= np.maximum(TRUSTED_WIDTH_M, TRUSTED_SHARE * travelled)))
    return float(time_s[beyond[0]]) if len(beyond) else None


# ---------------------------------------------------------------- result


@dataclass(frozen=True, kw_only=True)
class Run:
    """Motion of a recording, with everything that the log and its evidence contain."""

    #: Setup, with the sensor and the rests that were used.
    setup: Setup
    findings: list[Finding]
    stroke: Rhythm | None
    cutoff_hz: float
    motion: Motion
    #: Surge velocity within a stroke and its standard deviation, m/s; NaN if not estimated.
    surge_osc: Array
    surge_osc_sd: Array
    poses: Poses | None = None
    fused: Fused | None = None
    #: Time up to which the position can be used, s; None if it can be used throughout.
    trusted_until_s: float | None = None
    #: Biases of accelerometer (m/s^2) and gyroscope (rad/s) at the end, shape (6,).
    bias: Array | None = None
    #: Root-mean-square innovation of the velocity at rests, in standard deviations.
    rest_score: float | None = None
    #: Reasons why positions and velocities are empty.
    impossible: tuple[str, ...] = ()

    @property
    def by_paper(self) -> bool:
        """Whether the method is that of :func:`compute_by_paper`, which has no standard deviations."""
        return self.setup.options.method == "paper"

    @property
    def alone(self) -> bool:
        """Whether the motion was estimated from the inertial unit by itself."""
        return self.fused is None and not self.by_paper

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body at rest, rad."""
        mount = self.setup.mount.rotation if self.fused is None else self.fused.smoothed.path.mount
        up = mount.inv().apply(self.setup.mount.up)
        return float(np.arctan2(up[1], up[2])), float(np.arctan2(up[0], np.hypot(up[1], up[2])))

    @property
    def stated_hz(self) -> float | None:
        """Stroke frequency in the metadata, Hz; None if absent."""
        value = self.setup.record.metadata.get("frequency_hz")
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    @property
    def contradiction(self) -> str | None:
        """Sentence on the contradiction between measured and stated stroke frequency; None if they agree."""
        stroke, stated = self.stroke, self.stated_hz
        if stroke is None or stated is None:
            return None
        if stroke.maybe_double and beat.contradiction(stroke.beat, 2 * stated) is None:
            return None
        return beat.contradiction(stroke.beat, stated)

    def columns(self) -> dict[str, Any]:
        """Return the columns of the log, in order."""
        m, record = self.motion, self.setup.record
        columns = {
            "t_s": m.time_s,
            **_named("{}_m", m.position),
            **_named("{}_rad", np.column_stack(angles(m.rotation)), ANGLES),
            **_named("{}_m_s", m.body_velocity, "uvw"),
            **_named("v{}_m_s", m.velocity),
            **_named("{}_rate_rad_s", m.rate * [1.0, -1.0, 1.0], ANGLES),
            **_named("a{}_world_m_s2", m.acceleration),
            **_named("q{}", m.rotation.as_quat(), "xyzw"),
        }
        if self.by_paper:
            return columns
        return columns | {
            "u_osc_m_s": self.surge_osc,
            **_named("{}_sd_m", m.position_sd),
            **_named("{}_sd_rad", m.angle_sd, ANGLES),
            **_named("{}_sd_m_s", m.body_velocity_sd, "uvw"),
            **_named("v{}_sd_m_s", m.velocity_sd),
            "u_osc_sd_m_s": self.surge_osc_sd,
            "bridged": (record.filled_acceleration | record.filled_rate).astype(int),
        }


def _named(name: str, values: Array, parts: Sequence[str] = "xyz") -> dict[str, Array]:
    return {name.format(part): column for part, column in zip(parts, values.T, strict=True)}


def estimate(setup: Setup, findings: list[Finding], poses: Poses | None) -> Run:
    """Estimate the motion of a recording by the method chosen in the options.

    Parameters
    ----------
    setup : Setup
    findings : list of Finding
        Faults found so far.
    poses : Poses or None
        Poses of another log of the trial.
    """
    body, record, options = setup.body, setup.record, setup.options
    t = record.time_s
    readings = dict(zip((*RATE, *ACCELERATION), np.hstack([body.rate, body.acceleration]).T, strict=True))
    stroke = beat.find_stroke(t, readings)
    cutoff = LOWEST_HZ if stroke is None else STROKE_SHARE * stroke.beat.frequency_hz
    empty = np.full(len(record), np.nan)
    known: dict[str, Any] = {"poses": poses, "stroke": stroke, "cutoff_hz": cutoff, "findings": findings}
    known |= {"surge_osc": empty, "surge_osc_sd": empty}
    if options.method == "paper":
        moved, known["bias"] = compute_by_paper(body, setup.attitude, options)
        return Run(setup=setup, motion=moved, **known)
    found = alone.estimate(setup) if poses is None else fusion.estimate(setup, poses)
    setup = replace(found.setup, sensor=found.smoothed.sensor)
    known["findings"] = [*findings, *found.findings]
    impossible = found.impossible
    if impossible:
        turning = setup.mount.rotation.inv().apply(record.rate - setup.still_rate)
        acceleration = setup.source.rotation.apply(record.acceleration) + gravity(np.zeros(2))
        moved = attitude_only(t, setup.attitude, turning, acceleration, setup.attitude_sd)
    else:
        smoothed = found.smoothed
        moved, path = at_reference(smoothed), smoothed.path
        known["surge_osc"], known["surge_osc_sd"] = surge_within_stroke(moved, smoothed, cutoff)
        known["rest_score"] = smoothed.score("rest")
        known["bias"] = np.concatenate([path.acceleration_bias[-1], path.rate_bias[-1]])
    if isinstance(found, Fused):
        known["fused"] = found
    else:
        # too fast: beyond the top speed by more than the 95 % band, or by more than GATE times the standard
        # deviation that the smoother assumes for the speed
        speed, top_m_s = np.linalg.norm(moved.velocity, axis=1), options.top_speed_m_s
        squares = np.sum((moved.velocity * moved.velocity_sd) ** 2, axis=1)
        band = BAND * np.sqrt(squares) / np.maximum(speed, 1e-9)
        fast = (speed - band > top_m_s) | (speed > GATE * 0.5 * top_m_s)
        if fast.any():
            impossible = [
                f"{100 * fast.mean():.0f} % of the samples come out faster than the robot can be, "
                f"{top_m_s:g} m/s (up to {speed.max():.1f} m/s)"
            ]
            hidden = np.where(fast[:, None], np.nan, 0.0)
            moved = replace(moved, **{name: getattr(moved, name) + hidden for name in EMPTIED})
        known["trusted_until_s"] = find_trust(t, moved.position, moved.position_sd)
    return Run(setup=setup, motion=moved, impossible=tuple(impossible), **known)
