"""The motion of the body's reference point: its standard deviations, and its part within a stroke.

:func:`estimate` takes the method of the options: :func:`by_paper` is that of Shang, Wang, Tan and Cheng
(2012, doi:10.1017/S0263574711001159). A :class:`Run` is what it gives, for the log and its evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import alone, fusion
from swimid.inertial.aiding import GATE, turn_to_angles
from swimid.inertial.fusion import Fused
from swimid.inertial.record import ACCELERATION, RATE, Array, Finding, Poses, Record, integral, resampled
from swimid.inertial.setup import BAND, Setup
from swimid.inertial.smoother import Nominal, Smoothed, cross_matrix, gravity, jacobian
from swimid.logs import rhythm
from swimid.logs.rhythm import Rhythm
from swimid.logs.rotation import angles

#: A position is trusted while its 95 % band is narrower than this, m, or than this share of the distance
#: travelled, whichever is more.
TRUSTED_WIDTH_M, TRUSTED_SHARE = 0.1, 0.1
#: Slower than this is no motion within a stroke where no stroke is found, Hz; with one: this share of its
#: frequency.
LOWEST_HZ, STROKE_SHARE = 0.3, 0.5
#: Trajectories of errors that are drawn. They give a standard deviation to 1 / sqrt(2 DRAWS) = 6 %.
DRAWS = 128


@dataclass(frozen=True)
class Motion:
    """Motion of the reference point at every sample."""

    #: Shape (n,).
    time_s: Array
    #: Body to world.
    rotation: Rotation
    #: Shape (n, 3). World axes, world axes and body axes (surge, sway, heave); m and m/s.
    position: Array
    velocity: Array
    body_velocity: Array
    #: Shape (n, 3). Turn rate, body axes, rad/s.
    rate: Array
    #: Shape (n, 3). Of the sensor, world axes, gravity removed, m/s^2.
    acceleration: Array
    #: Shape (n, 3). Standard deviations; angles are roll, pitch, yaw, rad.
    position_sd: Array
    velocity_sd: Array
    body_velocity_sd: Array
    angle_sd: Array


def of_attitude(
    time_s: Array, rotation: Rotation, rate: Array, acceleration: Array, attitude_sd: float
) -> Motion:
    """A motion of which only the attitude is known; shapes and units as in :class:`Motion`."""
    empty = np.full((len(time_s), 3), np.nan)
    sd = np.full((len(time_s), 3), attitude_sd)
    return Motion(time_s, rotation, empty, empty, empty, rate, acceleration, empty, empty, empty, sd)


def by_paper(
    record: Record,
    rotation: Rotation,
    mode: Literal["marching", "receding", "rotating"],
    threshold_m_s2: float,
    threshold_rad_s: float,
) -> tuple[Motion, Array]:
    """Compute the motion by the steps of Shang et al. (2012), section 5; it has no standard deviations.

    The constant part of the readings is removed, small readings are set to zero, accelerations are turned to
    the earth's axes (Eq 10), and velocity and position follow by the trapezoidal rule (Eqs 12 and 13). The
    paper states neither the filter nor the threshold.

    Parameters
    ----------
    record : Record
        In body axes.
    rotation : Rotation
        Body to earth, n of them: the inverse of the paper's ``M_e^f``.
    mode : str
        ``marching`` and ``receding``: the vehicle keeps its heading, so the constant part of all six
        channels is error (and gravity). ``rotating``: it turns at a mean rate, so that of the yaw rate
        is kept.
    threshold_m_s2, threshold_rad_s : float
        Readings below these are set to 0 ("discarded", sec. 5.2).

    Returns
    -------
    Motion
    ndarray, shape (6,)
        The constant parts, m/s^2 and rad/s.

    Notes
    -----
    Removing the mean acceleration makes the last velocity equal the first, whatever the vehicle did.
    """
    constant = record.channels.mean(axis=0)
    if mode == "rotating":
        constant[5] = 0.0
    readings = record.channels - constant
    readings[np.abs(readings) < np.repeat([threshold_m_s2, threshold_rad_s], 3)] = 0.0
    acceleration = rotation.apply(readings[:, :3])
    velocity = integral(record.time_s, acceleration)
    moved = of_attitude(record.time_s, rotation, readings[:, 3:], acceleration, np.nan)
    position, in_body = integral(record.time_s, velocity), rotation.inv().apply(velocity)
    return replace(moved, position=position, velocity=velocity, body_velocity=in_body), constant


def _carried(path: Nominal) -> tuple[Array, Array, Array, Array]:
    """Carry velocity and sensitivities from the sensor to the reference point.

    The velocity, shape (n, 3), is in world axes. Derivatives of place, velocity and turn of the body with
    respect to the states at the nodes have shape (nodes, 3, states).
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
    """Carry path and covariance from the sensor to the reference point."""
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
    """Errors of the velocity along body axes, from those of the velocity and of the turn in world axes.

    ``velocity`` has shape (n, 3), the errors have shape (n, 3, m): samples, or derivatives.
    """
    to_body = np.swapaxes(body.as_matrix(), 1, 2)
    return np.asarray(to_body @ (speed_error + cross_matrix(velocity) @ turn_error))


def surge_within_stroke(motion: Motion, smoothed: Smoothed, cutoff_hz: float) -> tuple[Array, Array]:
    """Return the surge within a stroke and its standard deviation, m/s, each of shape (n,).

    The velocity is high-passed along the world's axes before it is turned to the body's: a drifting velocity
    would leak into the surge with every swing of the heading.

    Notes
    -----
    The deviation is that of :data:`DRAWS` trajectories of the smoother's errors, each high-passed like the
    velocity itself. So it holds every error that is faster than the cut-off: noise, errors of scale and
    alignment times gravity and motion, and errors of the attitude times gravity.
    """
    fast = _high_passed(motion.time_s, motion.velocity, cutoff_hz)
    surge = motion.rotation.inv().apply(fast)[:, 0]
    path = smoothed.path
    nodes = len(path.nodes)
    drawn = smoothed.errors.draw(np.concatenate(_carried(path)[2:], axis=1), DRAWS)
    speed = _high_passed(path.node_s, drawn[:, :3].reshape(nodes, -1), cutoff_hz).reshape(nodes, 3, DRAWS)
    error = _in_body(motion.rotation[path.nodes], fast[path.nodes], speed, drawn[:, 3:])[:, 0]
    sd = np.interp(motion.time_s, path.node_s, np.sqrt(np.mean(error**2, axis=1)))
    return np.asarray(surge), sd


def _high_passed(time_s: Array, values: Array, cutoff_hz: float) -> Array:
    """Return channels, shape (n, k), less everything slower than ``cutoff_hz``.

    The filter is a Butterworth filter of fourth order without a phase shift. The result is NaN for a record
    that is too short or too slow for it.
    """
    from scipy import signal

    step = float(np.median(np.diff(time_s)))
    even = np.arange(time_s[0], time_s[-1] + 0.5 * step, step)
    if len(even) < 32 or cutoff_hz >= 0.45 / step:
        return np.full_like(values, np.nan)
    sos = signal.butter(2, cutoff_hz, "high", fs=1 / step, output="sos")
    length = min(len(even) - 1, int(3 / (cutoff_hz * step)))
    fast = signal.sosfiltfilt(sos, resampled(even, time_s, values), axis=0, padlen=length)
    return resampled(time_s, even, fast)


# ---------------------------------------------------------------- how far it can be believed


def too_fast(velocity: Array, velocity_sd: Array, top_m_s: float) -> np.ndarray:
    """Samples faster than the robot can be, shape (n,).

    Above its top speed by more than the 95 % band, or by so much that what is taken of speed (0 with half the
    top speed as deviation of each component) excludes it, however wide the band.
    """
    speed = np.linalg.norm(velocity, axis=1)
    along = np.sqrt(np.sum((velocity * velocity_sd) ** 2, axis=1)) / np.maximum(speed, 1e-9)
    return (speed - BAND * along > top_m_s) | (speed > GATE * 0.5 * top_m_s)


@dataclass(frozen=True)
class Trust:
    """When the band of a position leaves the limit."""

    #: Time on the log's clock; None where it never does.
    until_s: float | None
    #: The same, counted from the end of the rest the log starts with (or from its start).
    seconds: float | None
    #: Largest half-width of the 95 % band of the horizontal position.
    widest_m: float


def reach(time_s: Array, position: Array, position_sd: Array, moving_from_s: float) -> Trust:
    """When the horizontal 95 % band first exceeds 0.1 m and 10 % of the distance travelled.

    Parameters
    ----------
    position, position_sd : ndarray, shape (n, 3)
        Missing (NaN) counts as not to be trusted.
    moving_from_s : float
        End of the rest at the start.
    """
    half = BAND * np.max(position_sd[:, :2], axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position[:, :2], axis=0).T))])
    beyond = np.flatnonzero(~(half <= np.maximum(TRUSTED_WIDTH_M, TRUSTED_SHARE * travelled)))
    widest = float(np.nanmax(half)) if np.isfinite(half).any() else np.inf
    if not len(beyond):
        return Trust(None, None, widest)
    until = float(time_s[beyond[0]])
    return Trust(until, max(until - moving_from_s, 0.0), widest)


# ---------------------------------------------------------------- a run


#: Metadata that disagrees with the stroke by more than this share, and by more than its interval, is wrong.
FREQUENCY_SHARE = 0.03
ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, kw_only=True)
class Run(Setup):
    """Everything a run found, for its log and its evidence.

    ``impossible`` says why positions and velocities of the motion are empty where they are.
    """

    findings: list[Finding]
    stroke: Rhythm | None
    cutoff_hz: float
    poses: Poses | None = None
    motion: Motion
    fused: Fused | None = None
    trust: Trust | None = None
    #: Surge within a stroke, m/s, and its standard deviation; NaN where there is none.
    surge_osc: Array
    surge_osc_sd: Array
    #: Shape (6,). Of the accelerometer (m/s^2) and the gyroscope (rad/s) at the end.
    bias: Array | None = None
    #: Root-mean-square innovation at rests, in standard deviations.
    rest_score: float | None = None
    impossible: tuple[str, ...] = ()

    @property
    def by_paper(self) -> bool:
        """Whether the motion is that of the paper's steps, without standard deviations."""
        return self.options.method == "paper"

    @property
    def body_to_sensor(self) -> Rotation:
        """The mounting: as fused with the other log, else as the rests or the user tell it."""
        return self.mount.rotation if self.fused is None else self.fused.smoothed.path.mount

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body at rest, rad."""
        up = self.body_to_sensor.inv().apply(self.mount.up)
        return float(np.arctan2(up[1], up[2])), float(np.arctan2(up[0], np.hypot(up[1], up[2])))

    @property
    def stated_hz(self) -> float | None:
        """The stroke frequency the metadata states, Hz."""
        value = self.record.metadata.get("frequency_hz")
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    @property
    def doubt(self) -> str:
        """What speaks against the stroke, where the metadata states none; empty where nothing does."""
        return self.stroke.doubt if self.stroke is not None and self.stated_hz is None else ""

    @property
    def contradicted(self) -> bool:
        """Whether the stated frequency lies outside the stroke's interval, and off by more than 3 %."""
        stroke, stated = self.stroke, self.stated_hz
        if stroke is None or stated is None:
            return False
        low, high = stroke.beat.interval_hz
        off = abs(stated / stroke.beat.frequency_hz - 1)
        if stroke.maybe_double and abs(2 * stated / stroke.beat.frequency_hz - 1) < FREQUENCY_SHARE:
            return False
        return off > FREQUENCY_SHARE and not low <= stated <= high

    def columns(self) -> dict[str, Any]:
        """The columns of the log, in order."""
        m = self.motion
        known = {
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
            return known
        return {
            **known,
            "u_osc_m_s": self.surge_osc,
            **_named("{}_sd_m", m.position_sd),
            **_named("{}_sd_rad", m.angle_sd, ANGLES),
            **_named("{}_sd_m_s", m.body_velocity_sd, "uvw"),
            **_named("v{}_sd_m_s", m.velocity_sd),
            "u_osc_sd_m_s": self.surge_osc_sd,
            "bridged": (self.record.filled_acceleration | self.record.filled_rate).astype(int),
        }


def _named(name: str, values: Array, parts: Sequence[str] = "xyz") -> dict[str, Array]:
    return {name.format(part): column for part, column in zip(parts, values.T, strict=True)}


def estimate(setup: Setup, findings: list[Finding], poses: Poses | None) -> Run:
    """Estimate the motion of a recording by the method of the options.

    Parameters
    ----------
    findings : list of Finding
        Faults found so far.
    poses : Poses or None
        Another log of the trial to fuse with.
    """
    body, o = setup.body, setup.options
    readings = dict(zip((*RATE, *ACCELERATION), np.hstack([body.rate, body.acceleration]).T, strict=True))
    stroke = rhythm.find(body.time_s, readings)
    cutoff = LOWEST_HZ if stroke is None else STROKE_SHARE * stroke.beat.frequency_hz
    empty = np.full(len(body), np.nan)
    known: dict[str, Any] = {"poses": poses, "stroke": stroke, "cutoff_hz": cutoff}
    known |= {"surge_osc": empty, "surge_osc_sd": empty}
    if o.method == "paper":
        limits = (o.threshold_m_s2, o.threshold_rad_s)
        moved, constant = by_paper(body, setup.attitude, o.motion_mode, *limits)
        return Run(**vars(setup), **known, findings=findings, motion=moved, bias=constant)
    found = alone.estimate(setup) if poses is None else fusion.estimate(setup, poses)
    setup = replace(setup, sensor=found.sensor, still=found.still)
    known["findings"] = [*findings, *found.findings]
    if isinstance(found, Fused):
        known["fused"] = found
    impossible = found.impossible
    if impossible:
        record, source = setup.record, setup.source
        turning = setup.mount.rotation.inv().apply(record.rate - setup.still_rate)
        acceleration = source.rotation.apply(record.acceleration) + gravity(np.zeros(2))
        moved = of_attitude(record.time_s, setup.attitude, turning, acceleration, setup.attitude_sd)
    else:
        smoothed = found.smoothed
        moved, path = at_reference(smoothed), smoothed.path
        surge, surge_sd = surge_within_stroke(moved, smoothed, cutoff)
        known |= {"surge_osc": surge, "surge_osc_sd": surge_sd, "rest_score": smoothed.score("rest")}
        known["bias"] = np.concatenate([path.acceleration_bias[-1], path.rate_bias[-1]])
        if poses is None:
            moved, impossible = _without_too_fast(moved, o.top_speed_m_s)
    if poses is None:
        rests, start = setup.still.rests, float(body.time_s[0])
        if rests and rests[0].first == 0:
            start = float(body.time_s[rests[0].last - 1])
        known["trust"] = reach(moved.time_s, moved.position, moved.position_sd, start)
    return Run(**vars(setup), **known, motion=moved, impossible=tuple(impossible))


def _without_too_fast(moved: Motion, top_m_s: float) -> tuple[Motion, list[str]]:
    """Empty velocity and position of the samples that are faster than the robot ever is."""
    fast = too_fast(moved.velocity, moved.velocity_sd, top_m_s)
    if not fast.any():
        return moved, []
    fastest = float(np.max(np.linalg.norm(moved.velocity, axis=1)))
    text = (
        f"{100 * fast.mean():.0f} % of the samples come out faster than the robot can be, {top_m_s:g} m/s "
        f"(up to {fastest:.1f} m/s)"
    )
    empty = np.where(fast[:, None], np.nan, 0.0)
    names = ("position", "velocity", "body_velocity", "position_sd", "velocity_sd", "body_velocity_sd")
    return replace(moved, **{name: getattr(moved, name) + empty for name in names}), [text]
