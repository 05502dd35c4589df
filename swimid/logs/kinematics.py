"""Attitudes, quantities of a swim over whole cycles, and speed and stroke of a swimmer from its track.

Each quantity has one name and one definition, for simulations, logs and tracks alike. :data:`QUANTITIES`
lists the names with their units and meanings. The beat frequency itself is estimated by
:mod:`swimid.logs.beat`.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.logs import tracks
from swimid.logs.beat import Beat, explain_missing, find_stroke, waves
from swimid.logs.log import runs
from swimid.logs.sampling import slope
from swimid.logs.tracks import Cleaning, Estimate, gaps, mean_of_blocks

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


# ---------------------------------------------------------------- attitudes


def angles(rotation: Rotation) -> tuple[Array, Array, Array]:
    """Return the roll, pitch and yaw angles of rotations, rad.

    The rotation is by yaw about z, then by pitch, then by roll. Pitch is positive with the nose up, which is
    counter-clockwise in the x-z plane. Roll is positive with the port side up. Roll and yaw are
    unwrapped.

    >>> from scipy.spatial.transform import Rotation
    >>> nose_up = Rotation.from_rotvec([0.0, -0.1, 0.0])
    >>> [round(float(a[0]), 3) for a in angles(Rotation.concatenate([nose_up]))]
    [0.0, 0.1, 0.0]
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # scipy warns at a pitch of ±90 degrees
        yaw, pitch, roll = np.atleast_2d(rotation.as_euler("ZYX")).T
    return np.unwrap(roll), -pitch, np.unwrap(yaw)


def from_angles(roll: Any, pitch: Any, yaw: Any) -> Rotation:
    """Return the rotations with given roll, pitch and yaw, rad, shape (n,): the inverse of :func:`angles`."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", np.column_stack((yaw, -np.asarray(pitch), roll)))


#: Columns of a log with the attitude quaternion, which rotates from body to world. The real part is the
#: first.
AXES = ("qw", "qx", "qy", "qz")


def rearranged(q: Array, order: str = "wxyz", direction: str = "body-to-world") -> Array:
    """Convert quaternions, shape (n, 4), to real part first and to the rotation from body to world.

    >>> rearranged(np.array([[0.0, 0.0, 0.6, 0.8]]), "xyzw", "world-to-body").tolist()
    [[0.8, -0.0, -0.0, -0.6]]
    """
    if order == "xyzw":
        q = np.roll(q, 1, axis=1)
    if direction == "world-to-body":
        q = q * [1.0, -1.0, -1.0, -1.0]
    return q


def from_frd(columns: dict[str, Array]) -> dict[str, Array]:
    """Convert columns from body axes forward, right, down to body axes forward, left, up.

    The y and z components of vectors and quaternions change their sign, and so does yaw. Roll (right side
    down is port side up), pitch (nose up), and the real and the x component of a quaternion keep theirs.
    """
    turned = re.compile(r"(desired_)?([awvmq]?[yz]|yaw)(_.*)?")
    return {name: -values if turned.fullmatch(name) else values for name, values in columns.items()}


def from_y_up(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Convert a vector from axes with y up to axes with z up: x stays, y becomes z, and z becomes -y.

    The vector part of a quaternion is converted likewise if world and body have the same convention.
    """
    return x, -z, y


def with_angles(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the columns of a log, with roll, pitch and yaw computed from the quaternion columns.

    Samples whose quaternion is not of unit length have no angles (NaN). If no sample has a valid quaternion,
    the quaternion columns are removed.
    """
    if not set(AXES) <= set(columns):
        return columns
    q = np.column_stack([columns[axis] for axis in AXES])
    there = np.abs(np.linalg.norm(q, axis=1) - 1.0) < 0.05
    if not there.any():
        return {name: values for name, values in columns.items() if name not in AXES}
    from scipy.spatial.transform import Rotation

    turned = np.full((len(q), 3), np.nan)
    turned[there] = np.column_stack(angles(Rotation.from_quat(q[there], scalar_first=True)))
    return columns | dict(zip(("roll_rad", "pitch_rad", "yaw_rad"), turned.T, strict=True))


# ---------------------------------------------------------------- names of quantities


class Kind(NamedTuple):
    """Unit and meaning of a quantity of a swim, and the kinds of motion for which it is computed.

    ``of`` names one or several kinds of motion: ``plane`` (a free swim in a plane), ``cycle`` (one cycle in
    the vertical plane), ``power`` (driven joints).
    """

    unit: str
    meaning: str
    of: str


#: Quantities of a swim, by name. Quantities of the rotation exist for yaw (horizontal plane) and for pitch
#: (vertical plane). The amplitude of a passive joint is not listed here; its name is
#: ``amplitude_<joint>_rad``.
QUANTITIES = {
    "mean_speed_m_s": Kind(
        "m/s", "length of the path through the mean positions of cycles, over time", "plane cycle"
    ),
    "mean_speed_BL_s": Kind("BL/s", "mean speed in body lengths", "plane"),
    "stride_BL": Kind("BL", "mean speed over frequency, in body lengths", "plane"),
    "strouhal": Kind("1", "frequency times tail excursion over mean speed", "plane"),
    "tail_excursion_m": Kind("m", "peak-to-peak excursion of the tail across the path", "plane"),
    "turning_radius_m": Kind("m", "mean speed over the magnitude of the mean turning rate", "plane"),
    "mean_yaw_rate_rad_s": Kind("rad/s", "change of the yaw over whole cycles, over time", "plane"),
    "mean_pitch_rate_rad_s": Kind("rad/s", "change of the pitch over whole cycles, over time", "plane cycle"),
    "max_yaw_rate_rad_s": Kind("rad/s", "maximum magnitude of the yaw rate", "plane"),
    "max_pitch_rate_rad_s": Kind("rad/s", "maximum magnitude of the pitch rate", "plane cycle"),
    "yaw_rate_range_rad_s": Kind("rad/s", "range of the yaw rate (tendon fish, F2 of Eq 12)", "plane"),
    "pitch_rate_range_rad_s": Kind("rad/s", "range of the pitch rate", "plane"),
    "yaw_range_in_beat_rad": Kind("rad", "range of yaw in the last beat (tendon fish, Table V)", "plane"),
    "pitch_range_in_beat_rad": Kind("rad", "range of the pitch in the last beat", "plane"),
    "mean_surge_m_s": Kind("m/s", "mean forward speed", "plane"),
    "max_surge_m_s": Kind("m/s", "maximum forward speed", "plane"),
    "mean_surge_from_start_m_s": Kind("m/s", "mean surge of the whole run (tendon fish, F1)", "plane"),
    "speed_change_per_beat_m_s": Kind("m/s", "mean change of the speed from beat to beat", "plane"),
    "settling_time_s": Kind("s", "time after which the mean surge stays within 5 % of its last", "plane"),
    "path_extent_m": Kind("m", "longer side of the box around the path", "plane"),
    "max_speed_m_s": Kind("m/s", "maximum speed in the plane (sea lion, Table I)", "cycle"),
    "path_speed_m_s": Kind("m/s", "mean of the speed in the plane (sea lion, Table I)", "cycle"),
    "final_pitch_rad": Kind("rad", "pitch at the end of the cycle (sea lion, Table II)", "cycle"),
    "surge_m": Kind("m", "displacement along x in the cycle", "cycle"),
    "heave_m": Kind("m", "displacement along z in the cycle", "cycle"),
    "cost_of_transport_J_m": Kind("J/m", "mean positive power over mean speed (dolphin, Eq 11)", "power"),
    "mean_positive_power_W": Kind("W", "mean power of the joints, negative power as zero", "power"),
    "mean_power_W": Kind("W", "mean power of the joints", "power"),
    "peak_torque_N_m": Kind("N m", "maximum magnitude of a joint torque", "power"),
    "peak_joint_rate_rad_s": Kind("rad/s", "maximum magnitude of a joint rate", "power"),
}
#: Names of the quantities of one stroke cycle in the vertical plane (Kadapa et al., bio-robotic sea lion,
#: Tables I and II).
CYCLE_QUANTITIES = tuple(name for name, kind in QUANTITIES.items() if "cycle" in kind.of)

#: Maximum number of cycles, at the end of a trial, from which the quantities of a swim are computed.
N_CYCLES = 4
#: Number of samples per stroke cycle from which the quantities of a simulated trial are computed.
PER_CYCLE = 64
#: Minimum number of samples in a stroke cycle whose quantities are computed.
MIN_SAMPLES = 6
#: Conditions under which the Strouhal number of a swim is computed: minimum speed, body lengths per second,
#: and maximum change of the heading from beat to beat, rad.
MIN_SPEED_BL_S, MAX_TURN_IN_BEAT = 0.05, math.radians(15.0)
#: Minimum turning rate, rad/s, for which a turning radius is computed if the robot is not commanded to turn.
MIN_TURNING_RATE = math.radians(2.0)
#: Maximum change of the speed from beat to beat in a swim that counts as steady, divided by the speed.
UNSTEADY = 0.005
#: Relative tolerance of the settling time: maximum deviation of the mean surge from its last value, divided
#: by that value.
SETTLED_RTOL = 0.05
#: Maximum change of the course between successive blocks of a path, rad. If the course changes by more, the
#: speed is not corrected for the curvature of the path.
MAX_TURN_OF_COURSE = 1.0


# ---------------------------------------------------------------- whole cycles


@dataclass(frozen=True)
class Window:
    """Time window in a record that holds whole cycles of the stroke.

    Attributes
    ----------
    begin_s, end_s : float
        Start and end of the window, s.
    cycles : int
        Number of stroke cycles in the window.
    frequency_hz : float
        Frequency of the stroke, Hz.
    """

    begin_s: float
    end_s: float
    cycles: int
    frequency_hz: float

    @property
    def duration_s(self) -> float:
        """Duration of the window of whole cycles, s."""
        return self.end_s - self.begin_s

    @property
    def edges_s(self) -> Array:
        """Times at which the cycles in the window start and the last one ends, s, shape (cycles + 1,)."""
        return np.linspace(self.begin_s, self.end_s, self.cycles + 1)

    def times(self) -> Array:
        """Return :data:`PER_CYCLE` evenly spaced times per cycle, s, from start to end of the window."""
        return np.linspace(self.begin_s, self.end_s, self.cycles * PER_CYCLE + 1)


def last_cycles(begin_s: float, end_s: float, frequency_hz: float) -> Window | None:
    """Return the window of the last :data:`N_CYCLES` whole cycles of a trial, or of fewer in a short trial.

    Return None if the trial holds no whole cycle.

    Parameters
    ----------
    begin_s : float
        Earliest start of the window, s: the end of the ramp of the drive.
    """
    count = min(N_CYCLES, int((end_s - begin_s) * frequency_hz + 1e-9))
    if count < 1:
        return None
    return Window(end_s - count / frequency_hz, end_s, count, frequency_hz)


def whole_cycles(time_s: Array, frequency_hz: float, *, begin_s: float = 0.0) -> list[Window]:
    """Return one window for each whole cycle of a record, counted from the time at which the stroke begins.

    >>> [window.end_s for window in whole_cycles(np.arange(0, 8.8, 0.1), 1 / 2.9)]
    [2.9, 5.8, 8.7]
    """
    period = 1.0 / frequency_hz
    first = max(int(np.ceil((time_s[0] - begin_s) / period - 1e-6)), 0)
    last = int(np.floor((time_s[-1] - begin_s) / period + 1e-6))
    return [
        Window(float(begin_s + k * period), float(round(begin_s + (k + 1) * period, 9)), 1, frequency_hz)
        for k in range(first, last)
    ]


def cycle_means(time_s: Array, values: Array, edges_s: Array) -> Array:
    """Return the means of a channel between successive times ``edges_s``, shape (..., edges - 1).

    The channel is interpolated linearly between its samples.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    values : ndarray, shape (n,) or (k, n)
        Without NaN.

    >>> cycle_means(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 2.0]), np.array([0.0, 1.0, 2.0])).tolist()
    [1.0, 2.0]
    """
    areas = np.cumsum(0.5 * np.diff(time_s) * (values[..., 1:] + values[..., :-1]), axis=-1)
    areas = np.concatenate((np.zeros((*values.shape[:-1], 1)), areas), axis=-1)
    at_edges = np.apply_along_axis(lambda area: np.interp(edges_s, time_s, area), -1, areas)
    return np.asarray(np.diff(at_edges, axis=-1) / np.diff(edges_s))


# ---------------------------------------------------------------- speeds


def block_speeds(place: Array, duration_s: float, turn_rad: Array | None = None) -> Array:
    """Return the speeds along a path between its mean positions over successive blocks, shape (m - 1,).

    Parameters
    ----------
    place : ndarray, shape (2, m)
        Mean positions over blocks of equal duration.
    duration_s : float
        Duration of a block, s.
    turn_rad : ndarray, shape (m - 1,), optional
        Rotation of the course from each block to the next, rad. By default it is the change of the course, if
        below :data:`MAX_TURN_OF_COURSE`.

    Notes
    -----
    The path between successive blocks is taken for an arc of a circle. The chord is shorter than the arc by
    the factor ``sin(turn / 2) / (turn / 2)``. The mean position over an arc lies inside the circle by the
    same factor.
    """
    steps = np.diff(place, axis=1)
    speed = np.hypot(*steps) / duration_s
    if turn_rad is None:
        turn_rad = np.zeros(len(speed))
        if len(speed) > 1:
            turn_rad = np.abs(np.gradient(np.unwrap(np.arctan2(steps[1], steps[0]))))
            turn_rad = np.where(turn_rad < MAX_TURN_OF_COURSE, turn_rad, 0.0)
    return np.asarray(speed / np.sinc(turn_rad / (2.0 * np.pi)) ** 2)


def cycle_speeds(time_s: Array, place: Array, window: Window, heading_rad: Array | None = None) -> Array:
    """Return the speeds between the mean positions of successive stroke cycles, shape (cycles - 1,).

    The mean of these speeds is the mean speed of a swim.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    place : ndarray, shape (2, n)
        Positions, m, without NaN.
    heading_rad : ndarray, shape (n,), optional
        Unwrapped heading, rad, which gives the rotation between cycles.

    Notes
    -----
    In a window of one cycle the speed is computed from its first and its last position.
    """
    edges, turn = window.edges_s, None
    if window.cycles > 1:
        if heading_rad is not None:
            turn = np.diff(cycle_means(time_s, heading_rad, edges))
        return block_speeds(cycle_means(time_s, place, edges), 1.0 / window.frequency_hz, turn)
    ends = [np.diff(np.interp(edges, time_s, row)) for row in place]
    speed = np.hypot(*ends) / window.duration_s
    if heading_rad is not None:
        speed = speed / np.sinc(np.diff(np.interp(edges, time_s, heading_rad)) / (2.0 * np.pi))
    return np.asarray(speed)


def settling_time(time_s: Array, surge_m_s: Array, frequency_hz: float) -> float:
    """Return the time, s, after which the forward speed averaged over a beat stays near its last value.

    The tolerance of the deviation from the last value is :data:`SETTLED_RTOL`.

    Parameters
    ----------
    time_s, surge_m_s : ndarray, shape (n,)
        Times, s, and forward speed, with :data:`PER_CYCLE` samples per beat.

    Returns
    -------
    float
        Settling time, s. NaN if the surge still changes over the last beat, or if the trial is too short.
    """
    mean = np.convolve(surge_m_s, np.full(PER_CYCLE, 1.0 / PER_CYCLE), "valid")
    if len(mean) < PER_CYCLE + 1 or not np.isfinite(mean).all():
        return math.nan
    off = np.abs(mean - mean[-1]) > SETTLED_RTOL * abs(mean[-1])
    if off[-PER_CYCLE - 1 :].any():
        return math.nan
    settled = int(np.max(np.flatnonzero(off) + 1, initial=0))
    return float(time_s[settled] - time_s[0] + 0.5 / frequency_hz)


def body_velocity(time_s: Array, pose: Sequence[Array], half_width_s: float) -> list[Array]:
    """Return surge speed, sway speed and turning rate, computed from the pose in m and rad.

    The derivatives are those of :func:`swimid.logs.sampling.slope`.

    Parameters
    ----------
    pose : sequence of ndarray, each shape (n,)
        Two positions, m, and the heading, rad.
    half_width_s : float
        Half width of the window in which the derivative is fitted, s.
    """
    dx, dy, rate = (slope(time_s, values, half_width_s) for values in pose)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return [c * dx + s * dy, -s * dx + c * dy, rate]


def world_velocity(time_s: Array, channels: Mapping[str, Array]) -> Array | None:
    """Return the velocity along the world's x and z axes, m/s, shape (2, n); None if no channel gives it.

    Notes
    -----
    Logged velocities have precedence: ``vx_m_s`` and ``vz_m_s``, then the velocities along the axes of the
    body, rotated into the world frame. Without logged velocities, central differences of the positions are
    used. At a frequency f a central difference is too small by the relative error ``(2 pi f / rate)^2 / 6``,
    and its noise is the noise of a position times ``rate / sqrt 2``.
    """
    if "vx_m_s" in channels and "vz_m_s" in channels:
        return np.array([channels["vx_m_s"], channels["vz_m_s"]])
    if "x_m" not in channels or "z_m" not in channels:
        return None
    if not {"u_m_s", "w_m_s", "pitch_rad"} <= channels.keys():
        return np.array([_differences(time_s, channels[name]) for name in ("x_m", "z_m")])
    zero = np.zeros(len(time_s))
    body = np.column_stack([channels.get(name, zero) for name in ("u_m_s", "v_m_s", "w_m_s")])
    angles = np.column_stack([channels.get(name, zero) for name in ("roll_rad", "pitch_rad", "yaw_rad")])
    known = np.isfinite(body).all(axis=1) & np.isfinite(angles).all(axis=1)
    world = np.full((2, len(time_s)), np.nan)
    if known.any():
        world[:, known] = from_angles(*angles[known].T).apply(body[known])[:, [0, 2]].T
    return world


def _differences(time_s: Array, values: Array) -> Array:
    """Return the time derivative of a channel by central differences; NaN where a sample is missing."""
    known = np.isfinite(values)
    rates = np.full(len(values), np.nan)
    if known.sum() > 1:
        rates[known] = np.gradient(values[known], time_s[known])
    return rates


# ---------------------------------------------------------------- quantities of a swim


def plane_quantities(
    pose: Sequence[Array],
    velocity: Sequence[Array],
    window: Window,
    *,
    length_m: float,
    turn: str,
    commanded_turn: bool,
) -> dict[str, float]:
    """Return the quantities of a swim in a plane over whole cycles, by name (see :data:`QUANTITIES`).

    Parameters
    ----------
    pose, velocity : sequence of three ndarray, each shape (n,)
        Pose (two positions and heading), and velocity (surge, sway and turning rate), at the times
        ``window.times()``.
    length_m : float
        Body length.
    turn : str
        Name of the rotation, ``"yaw"`` or ``"pitch"``.
    commanded_turn : bool
        Whether the drive has a bias or an asymmetry. If it has neither, a turning radius is returned only for
        a turning rate above :data:`MIN_TURNING_RATE`.
    """
    heading, (surge, _, turning) = pose[2], velocity
    speeds = cycle_speeds(window.times(), np.array(pose[:2]), window, heading)
    speed = float(speeds.mean())
    rate = float(heading[-1] - heading[0]) / window.duration_s
    found = {
        "mean_speed_m_s": speed,
        "mean_speed_BL_s": speed / length_m,
        "stride_BL": speed / window.frequency_hz / length_m,
        "mean_surge_m_s": float(np.mean(surge[:-1])),
        "max_surge_m_s": float(np.max(surge)),
        f"max_{turn}_rate_rad_s": float(np.max(np.abs(turning))),
        f"{turn}_rate_range_rad_s": float(np.ptp(turning)),
        f"{turn}_range_in_beat_rad": float(np.ptp(heading[-PER_CYCLE - 1 :])),
    }
    if len(speeds) > 1:
        found["speed_change_per_beat_m_s"] = float(speeds[-1] - speeds[0]) / (len(speeds) - 1)
    if commanded_turn or abs(rate) > MIN_TURNING_RATE:
        found[f"mean_{turn}_rate_rad_s"] = rate
        if rate:
            found["turning_radius_m"] = speed / abs(rate)
    return found


def is_straight(heading_rad: Array, speed_m_s: float, length_m: float) -> bool:
    """Return whether a swim is fast and straight enough to have a defined Strouhal number.

    Parameters
    ----------
    heading_rad : ndarray, shape (n,)
        :data:`PER_CYCLE` samples per cycle.
    """
    turn = np.abs(np.diff(heading_rad[::PER_CYCLE]))
    return bool(speed_m_s > MIN_SPEED_BL_S * length_m and np.max(turn) < MAX_TURN_IN_BEAT)


def tail_excursion(x_m: Array, y_m: Array) -> float:
    """Return the peak-to-peak excursion of the tail across its path, averaged over the cycles, m.

    Parameters
    ----------
    x_m, y_m : ndarray, shape (n,)
        Positions of the tail, :data:`PER_CYCLE` samples per cycle.
    """
    excursions = []
    for first in range(0, len(x_m) - PER_CYCLE, PER_CYCLE):
        x, y = (values[first : first + PER_CYCLE + 1] - values[first] for values in (x_m, y_m))
        across = (y * x[-1] - x * y[-1]) / math.hypot(x[-1], y[-1])
        excursions.append(float(np.ptp(across)))
    return float(np.mean(excursions))


def cycle_quantities(time_s: Array, channels: Mapping[str, Array], window: Window) -> dict[str, float]:
    """Return those :data:`CYCLE_QUANTITIES` of one stroke cycle that the channels of a log determine.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    channels : mapping of str to ndarray, each shape (n,)
        Known channels among ``x_m``, ``z_m``, ``pitch_rad`` and their rates (see :func:`world_velocity`).

    Notes
    -----
    A quantity is computed only if the cycle has at least :data:`MIN_SAMPLES` samples. The pitch rate is the
    channel ``pitch_rate_rad_s``, or the central difference of the pitch.
    """
    inside = (time_s >= window.begin_s - 1e-9) & (time_s <= window.end_s + 1e-9)
    found: dict[str, float] = {}

    def within(values: Array | None) -> tuple[Array, Array] | None:
        """Return the times and samples of a channel in the cycle; None for fewer than MIN_SAMPLES."""
        if values is None:
            return None
        there = inside & np.isfinite(np.atleast_2d(values)).all(axis=0)
        if there.sum() < MIN_SAMPLES:
            return None
        return time_s[there], values[..., there]

    moving = within(world_velocity(time_s, channels))
    if moving is not None:
        t, speed = moving[0], np.hypot(*moving[1])
        found["max_speed_m_s"] = float(speed.max())
        found["path_speed_m_s"] = float(np.trapezoid(speed, t) / (t[-1] - t[0]))
    for name, way in (("x_m", "surge_m"), ("z_m", "heave_m")):
        place = within(channels.get(name))
        if place is not None:
            found[way] = float(place[1][-1] - place[1][0])
    if "surge_m" in found and "heave_m" in found:
        found["mean_speed_m_s"] = math.hypot(found["surge_m"], found["heave_m"]) / window.duration_s
    pitch = within(channels.get("pitch_rad"))
    if pitch is not None:
        t, angle = pitch
        rate = channels.get("pitch_rate_rad_s")
        if rate is None:
            rate = _differences(time_s, channels["pitch_rad"])
        found["final_pitch_rad"] = float(angle[-1])
        if np.isfinite(rate[inside]).sum() >= MIN_SAMPLES:
            found["max_pitch_rate_rad_s"] = float(np.nanmax(np.abs(rate[inside])))
        found["mean_pitch_rate_rad_s"] = float((angle[-1] - angle[0]) / (t[-1] - t[0]))
    return {name: found[name] for name in CYCLE_QUANTITIES if name in found}


# ---------------------------------------------------------------- swimming motion from a track

#: Number of blocks into which a track without a stroke is divided, and maximum number of blocks of any track.
#: In a track with more strokes each block has several strokes.
N_BLOCKS, MAX_BLOCKS = 20, 200
#: Minimum number of measured samples in the window of a track from which speeds are computed.
MIN_WINDOW_SAMPLES = 12
#: Minimum number of blocks in a period of steady swimming. With fewer blocks a trend of the speed cannot be
#: distinguished from random variation.
MIN_BLOCKS = 5
#: Minimum speed of a block of a track that belongs to the cruise, divided by the 90th percentile of the block
#: speeds. Slower blocks are start, coasting or rest.
MIN_CRUISE = 0.5
#: Maximum change of the speed over a period of steady swimming, divided by the mean speed. A larger change is
#: accepted if it does not differ significantly from zero.
MAX_CHANGE = 0.02
#: Maximum magnitude of the limits of the 95 % interval of the speed change over a period of steady swimming,
#: divided by the mean speed.
MAX_CHANGE_REACH = 0.2
#: Maximum fraction of the cruise blocks of a track that are left out as the start of the motion, and maximum
#: fraction of the remaining blocks that are left out as its end.
MAX_START, MAX_END = 1 / 2, 1 / 3
#: Number of strokes in each segment of a track to which a sine is fitted, for the amplitude of the stroke.
N_STROKES = 2.0
#: Minimum ratio of a significant stroke amplitude to its standard error, and to the systematic error of the
#: track.
AMPLITUDE_Z = 3.0
#: Minimum ratio of the lowest speed of a tracked point to its mean speed. Below this ratio the point nearly
#: stops, and its course is not defined at all times.
MIN_SPEED_SHARE = 0.2


@dataclass(frozen=True)
class Track:
    """Measured and smoothed positions and headings of a robot, with all lengths in the same unit.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Sample times, s.
    measured : ndarray of bool, shape (n,)
        Whether each sample is measured, not interpolated.
    raw, smooth, velocity : ndarray, shape (2, n)
        Measured position, smoothed position, and velocity; NaN where missing.
    raw_angle, angle : ndarray, shape (n,), or None
        Measured heading and smoothed heading, unwrapped, rad.
    error, angle_error : float
        Standard deviation of the systematic errors of position and of heading (rad), which do not average
        out.
    """

    time_s: Array
    measured: Flags
    raw: Array
    smooth: Array
    velocity: Array
    raw_angle: Array | None
    angle: Array | None
    error: float = 0.0
    angle_error: float = 0.0


@dataclass(frozen=True)
class Swimming:
    """Speeds, accelerations and stroke in one window of a track, in the track's unit of length, s and rad.

    Attributes
    ----------
    begin_s, end_s : float
        Start and end of the window, s.
    window : str
        Choice of the window: ``given`` by the user, ``steady part`` of the track, or ``whole track`` if no
        part is steady.
    path_speed : Estimate or None
        Mean of the speed along the path, including sway; None if no segment is long enough.
    advance : Estimate or None
        Mean speed along the path averaged over strokes. In a steady window this is the steady speed. Without
        a stroke it is the displacement divided by the duration, or, if the course makes a full rotation, the
        mean speed of the blocks.
    change : Estimate or None
        Change of the advance speed from the start to the end of the window.
    acceleration : Estimate or None
        Mean rate of change of the advance speed.
    acceleration_xy : tuple of Estimate, or None
        Mean rates of change of the coordinates of the velocity.
    stroke : Beat or None
        Stroke in the window; None if none is found.
    frequency_hz : Estimate or None
        Frequency of the stroke, Hz, with its 95 % interval.
    amplitudes : dict of str to Estimate
        Significant amplitudes at the stroke frequency: ``sway`` across the mean heading (across the path if
        there is no heading), and ``turn``, the amplitude of the heading (rad).
    doubt : str
        Reason to doubt the stroke; empty if there is no doubt.
    unknown : str
        Reason why no stroke is found; empty if one is found.
    """

    begin_s: float
    end_s: float
    window: Literal["given", "steady part", "whole track"]
    path_speed: Estimate | None
    advance: Estimate | None
    change: Estimate | None
    acceleration: Estimate | None
    acceleration_xy: tuple[Estimate, Estimate] | None
    stroke: Beat | None
    frequency_hz: Estimate | None
    amplitudes: dict[str, Estimate]
    doubt: str = ""
    unknown: str = ""

    @property
    def steady(self) -> bool:
        """Whether the change of the swimming speed over the window is small or not significant."""
        if self.advance is None or self.change is None:
            return False
        return _is_level(self.change, self.advance.value)


@dataclass(frozen=True)
class _Blocks:
    """Speeds in successive blocks of a track, each of one or several strokes.

    The fields are the middle of each block (s), its velocity, shape (2, n), its speed along the arc, and the
    duration of a block (s).
    """

    middle: Array
    velocity: Array
    speed: Array
    duration_s: float

    @property
    def turn_round(self) -> bool:
        """Whether the course of the track makes at least one full rotation."""
        course = np.unwrap(np.arctan2(self.velocity[1], self.velocity[0]))
        return len(course) > 1 and bool(abs(course[-1] - course[0]) >= 2.0 * np.pi)


@dataclass(frozen=True)
class _Stroke:
    """Stroke in a window of a track with a reason to doubt it, or the reason why no stroke is found.

    Without a stroke, ``beat`` is None, ``unknown`` is the reason, and ``slow_hz`` is the frequency of a slow
    motion, Hz, if there is one.
    """

    beat: Beat | None = None
    doubt: str = ""
    unknown: str = ""
    slow_hz: float | None = None

    @property
    def period_s(self) -> float | None:
        """Period of the stroke, s; None if there is no stroke."""
        return None if self.beat is None else 1.0 / self.beat.frequency_hz


def measure(track: Track, window_s: tuple[float | None, float | None] = (None, None)) -> Swimming:
    """Measure the speeds, the accelerations and the stroke of a track.

    Parameters
    ----------
    track : Track
    window_s : (float or None, float or None)
        Start and end of the window, s. If both are None, the steady part is used.

    Notes
    -----
    The path is averaged over one stroke, which removes the oscillation of the body. It is then cut into
    blocks of one stroke, each of which is taken for an arc of a circle (:func:`block_speeds`). The steady
    part lies in the longest sequence of blocks that are not slower than :data:`MIN_CRUISE` of the cruise
    speed. The start and the end of this sequence are cut off by the marginal standard error rule [1]_. This
    rule cuts off the smallest number of blocks for which the standard error of the mean of the remaining
    blocks is minimal, within the uncertainty of that error. The steady part must have :data:`MIN_BLOCKS`
    blocks. The change of its speed must not be significant, or must be at most :data:`MAX_CHANGE`.

    References
    ----------
    .. [1] White, K. P. (1997). An effective truncation heuristic for bias reduction in simulation output.
       Simulation 69(6), 323-334. doi:10.1177/003754979706900601
    """
    known = track.time_s[np.isfinite(track.smooth).all(axis=0)]
    begin, end = float(known[0]), float(known[-1])
    kind: Literal["given", "steady part", "whole track"] = "given"
    if window_s == (None, None):
        steady = _steady_part(_blocks(track, begin, end, _find_stroke(track, begin, end).period_s))
        kind = "whole track" if steady is None else "steady part"
        begin, end = steady or (begin, end)
    if window_s[0] is not None:
        begin = max(window_s[0], begin)
    if window_s[1] is not None:
        end = min(window_s[1], end)
    stroke = _find_stroke(track, begin, end)
    blocks = _blocks(track, begin, end, stroke.period_s)
    advance = change = acceleration = across = frequency = None
    # Do not compute speeds if a periodic motion is slower than the blocks, because the block speeds oscillate
    # with it. Laps of the path are no such motion.
    if len(blocks.middle) >= 3 and (stroke.slow_hz is None or blocks.turn_round):
        durations = np.full(len(blocks.speed), blocks.duration_s)
        advance = _not_negative(mean_of_blocks(blocks.speed, durations))
        change = _change(blocks.middle, blocks.speed)
        acceleration = _slope(blocks.middle, blocks.speed)
        across = (_slope(blocks.middle, blocks.velocity[0]), _slope(blocks.middle, blocks.velocity[1]))
    inside = (track.time_s >= begin) & (track.time_s <= end)
    if stroke.beat is None and not blocks.turn_round:
        rows = inside & track.measured & np.isfinite(track.raw).all(axis=0)
        net = tracks.net_speed(track.time_s[rows], track.raw[:, rows].T, stroke.slow_hz)
        advance = _not_negative(net)
    amplitudes = {}
    if stroke.beat is not None:
        frequency = Estimate(stroke.beat.frequency_hz, *stroke.beat.interval_hz)
        amplitudes = _amplitudes(track, begin, end, stroke.beat.frequency_hz)
    time, good, none = track.time_s[inside], track.measured[inside], np.zeros(int(inside.sum()), dtype=bool)
    cleaning = Cleaning(good, none, none, 0, [], gaps(time, good))
    speeds = tracks.speed(time, list(track.raw[:, inside]), cleaning)
    return Swimming(
        begin_s=begin,
        end_s=end,
        window=kind,
        path_speed=_not_negative(None if speeds is None else speeds.path),
        advance=advance,
        change=change,
        acceleration=acceleration,
        acceleration_xy=across,
        stroke=stroke.beat,
        frequency_hz=frequency,
        amplitudes=amplitudes,
        doubt=stroke.doubt,
        unknown=stroke.unknown,
    )


def _is_level(change: Estimate, speed: float) -> bool:
    """Return whether a change of the swimming speed is so small that the speed counts as constant.

    The 95 % interval of the change must be small relative to the speed. In addition the change itself must be
    small or not significant.
    """
    if max(-change.low, change.high) > MAX_CHANGE_REACH * abs(speed):
        return False
    return abs(change.value) <= MAX_CHANGE * abs(speed) or change.low <= 0 <= change.high


def _not_negative(speed: Estimate | None) -> Estimate | None:
    """Return the estimate of a speed with its 95 % interval cut off at zero."""
    if speed is None:
        return None
    return Estimate(speed.value, max(speed.low, 0.0), speed.high)


# ---------------------------------------------------------------- stroke


def _find_stroke(track: Track, begin: float, end: float) -> _Stroke:
    """Find the stroke in a window of a track.

    In a track without a heading, the direction of travel is searched for the stroke instead.
    """
    rows = np.flatnonzero((track.time_s >= begin) & (track.time_s <= end))
    if len(rows) < 3:
        return _Stroke(unknown="too few samples")
    raw, (vx, vy) = track.raw[:, rows], track.velocity[:, rows]
    # Use the column names of the log format, even if the unit of length is not the metre.
    columns = {"x_m": raw[0], "y_m": raw[1]}
    if track.angle is not None and track.raw_angle is not None:
        angle = track.angle[rows]
        columns["yaw_rad"] = track.raw_angle[rows]
        columns["v_m_s"] = vy * np.cos(angle) - vx * np.sin(angle)
    elif _is_under_way(track.velocity[:, rows]):
        columns["yaw_rad"] = np.unwrap(np.arctan2(vy, vx))
    elif _stays(raw):
        columns = {"sway": _long_axis(raw) @ raw}
    columns = {name: np.where(track.measured[rows], values, np.nan) for name, values in columns.items()}
    found = find_stroke(track.time_s[rows], columns)
    if found is None:
        reason, slow_hz = explain_missing(track.time_s[rows], columns)
        if track.angle is None:
            reason = reason.replace("yaw_rad", "the course")
        return _Stroke(unknown=reason, slow_hz=slow_hz)
    if found.maybe_double:
        return _Stroke(unknown="only motions that may swing twice a stroke keep a beat")

    # Accept a stroke only if its amplitude is significant in the track. Any bend of a path deviates from a
    # cubic polynomial and may look like a beat.
    def is_significant(beat: Beat) -> bool:
        return bool(_amplitudes(track, begin, end, beat.frequency_hz))

    if is_significant(found.beat):
        rivals = {name: beat for name, beat in found.rivals.items() if is_significant(beat)}
        return _Stroke(found.beat, replace(found, rivals=rivals).doubt)
    for other in sorted(found.channels.values(), key=lambda beat: -beat.share):
        if is_significant(other):
            return _Stroke(other)
    return _Stroke(unknown="no beat stands clear of the noise of the track")


def _is_under_way(velocity: Array) -> bool:
    """Return whether a point of the robot never stops, so that its course is defined at all times."""
    speed = np.hypot(*velocity)
    return bool(np.isfinite(speed).all() and speed.min() > MIN_SPEED_SHARE * float(speed.mean()))


def _stays(place: Array) -> bool:
    """Return whether a point of the robot oscillates about one place.

    The criterion is the distance between the mean positions of the first and the second half of the track. It
    must be smaller than half of the distance for a motion at constant speed.
    """
    along = _long_axis(place) @ place[:, np.isfinite(place).all(axis=0)]
    half = len(along) // 2
    return bool(abs(along[half:].mean() - along[:half].mean()) < 0.25 * np.ptp(along))


def _long_axis(place: Array) -> Array:
    """Return the unit vector along which positions, shape (2, n), have the largest variance."""
    known = place[:, np.isfinite(place).all(axis=0)]
    return np.asarray(np.linalg.eigh(np.cov(known))[1][:, -1])


def _amplitudes(track: Track, begin: float, end: float, frequency: float) -> dict[str, Estimate]:
    """Return the amplitudes of sway and heading at a frequency, if they are significant.

    The sway is the motion across the mean heading. Without a heading it is the motion across the mean path,
    or, for a point that stays in place, along the direction of its largest motion.
    """
    time = track.time_s
    rows = (time >= begin) & (time <= end)
    mean = np.array([_running_mean(time, row, 1 / frequency) for row in track.smooth])
    channels, errors = {}, {"sway": track.error, "turn": track.angle_error}
    if track.angle is not None:
        heading = _running_mean(time, track.angle, 1 / frequency)
        across = np.array([-np.sin(heading), np.cos(heading)])
        if track.raw_angle is not None:
            channels["turn"] = track.raw_angle - heading
    elif not _is_under_way(track.velocity[:, rows]) and _stays(track.raw[:, rows]):
        across = _long_axis(track.raw[:, rows])[:, None]
    else:
        way = np.gradient(mean, time, axis=1)
        across = np.array([-way[1], way[0]]) / np.maximum(np.hypot(*way), 1e-300)
    channels = {"sway": np.sum((track.raw - mean) * across, axis=0), **channels}
    found = {}
    for name, values in channels.items():
        inside = rows & track.measured & np.isfinite(values)
        amplitude = _amplitude(time[inside], values[inside], frequency)
        if amplitude is not None and amplitude.value >= AMPLITUDE_Z * errors[name]:
            found[name] = amplitude
    return found


def _amplitude(time: Array, values: Array, frequency: float) -> Estimate | None:
    """Return the mean amplitude of sines fitted to successive strokes; None if it is not significant."""
    if not len(time):
        return None
    strokes = min(N_STROKES, float(time[-1] - time[0]) * frequency)
    if strokes < 1:
        return None
    length = strokes / frequency
    sizes, variances = [], []
    for start in time[0] + length * np.arange(int((time[-1] - time[0]) / length * (1 + 1e-6))):
        rows = (time >= start) & (time < start + length)
        if rows.sum() < 8:
            continue
        t = time[rows] - start
        design = np.column_stack((waves(t, frequency), np.ones(len(t)), t - t.mean()))
        weights = np.linalg.lstsq(design, values[rows], rcond=None)[0]
        residual = values[rows] - design @ weights
        sizes.append(float(np.hypot(weights[0], weights[1])))
        variances.append(2 * float(residual @ residual) / max(len(t) - 4, 1) / len(t))
    if not sizes:
        return None
    mean, error = float(np.mean(sizes)), math.sqrt(float(np.mean(variances)))
    if mean < AMPLITUDE_Z * error:
        return None
    if len(sizes) < 3:
        half = 1.96 * error / math.sqrt(len(sizes))
        return Estimate(mean, mean - half, mean + half)
    return mean_of_blocks(np.array(sizes), np.ones(len(sizes)))


# ---------------------------------------------------------------- blocks


def _running_mean(time: Array, values: Array, period: float) -> Array:
    """Return the running mean of a channel over one period; NaN where the period has missing samples."""
    known = np.isfinite(values)
    safe = np.where(known, values, 0.0)
    area = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (safe[1:] + safe[:-1]))))
    holes = np.concatenate(([0], np.cumsum(~known)))
    low, high = time - period / 2, time + period / 2
    mean = (np.interp(high, time, area) - np.interp(low, time, area)) / period
    inside = (low >= time[0]) & (high <= time[-1])
    whole = holes[np.searchsorted(time, high, "right")] == holes[np.searchsorted(time, low)]
    return np.where(inside & whole, mean, np.nan)


def _blocks(track: Track, begin: float, end: float, period: float | None) -> _Blocks:
    """Return the speeds of a track in successive blocks of whole strokes, without blocks that have gaps.

    Without a stroke the blocks have equal durations.
    """
    time = track.time_s
    if period is None or period > (end - begin) / 3:
        period = (end - begin) / N_BLOCKS
    # Use measured samples where there are any, because the errors of smoothed samples are correlated.
    filled = np.where(track.measured & np.isfinite(track.raw), track.raw, track.smooth)
    path = np.array([_running_mean(time, row, period) for row in filled])
    known = np.isfinite(path[0])
    if not known.any():
        return _Blocks(np.zeros(0), np.zeros((2, 0)), np.zeros(0), period)
    begin, end = max(begin, float(time[known][0])), min(end, float(time[known][-1]))
    length = period * max(math.ceil((end - begin) / period / MAX_BLOCKS), 1)
    edges = end - length * np.arange(int((end - begin) / length + 1e-6), -1, -1)
    place = np.array([np.interp(edges, time[known], row[known]) for row in path])
    step = float(np.median(np.diff(time)))
    holes = np.concatenate(([0], np.cumsum(~known)))
    first, last = np.searchsorted(time, edges[:-1] - step / 2), np.searchsorted(time, edges[1:] + step / 2)
    whole = holes[np.minimum(last, len(time))] == holes[first]
    velocity = np.diff(place, axis=1) / length
    speed = block_speeds(place, length)
    middle = 0.5 * (edges[:-1] + edges[1:])
    return _Blocks(middle[whole], velocity[:, whole], speed[whole], length)


def _steady_part(blocks: _Blocks) -> tuple[float, float] | None:
    """Return start and end of the period of steady swimming, s; None if no period is steady."""
    if len(blocks.speed) < MIN_BLOCKS:
        return None
    under_way = blocks.speed >= MIN_CRUISE * float(np.percentile(blocks.speed, 90))
    first, end = max(runs(under_way).tolist(), key=lambda run: run[1] - run[0])
    first += _transient(blocks.speed[first:end], MAX_START)
    end -= _transient(blocks.speed[first:end][::-1], MAX_END)
    middle, speed = blocks.middle[first:end], blocks.speed[first:end]
    if len(speed) < MIN_BLOCKS or not _is_level(_change(middle, speed), float(speed.mean())):
        return None
    half = 0.5 * blocks.duration_s
    return float(middle[0]) - half, float(middle[-1]) + half


def _transient(speed: Array, most: float) -> int:
    """Return the number of blocks at the beginning of a track that belong to the start of the motion.

    At most the fraction ``most`` of all blocks is cut off. The result is the smallest number for which the
    squared standard error of the mean speed of the remaining blocks is within one standard error of its
    minimum.
    """
    counts = len(speed) - np.arange(int(most * len(speed)) + 1)
    counts = counts[counts >= 3]
    if not len(counts):
        return 0
    scores = np.array([float(np.var(speed[len(speed) - n :], ddof=1)) / n for n in counts])
    best = int(np.argmin(scores))
    # Allow for the relative standard error of a variance that is estimated from n samples, sqrt(2 / (n - 1)).
    return int(np.argmax(scores <= scores[best] * (1 + math.sqrt(2 / (counts[best] - 1)))))


def _change(middle: Array, speed: Array) -> Estimate:
    """Return the change of speed from the first to the last block of a track, according to a fitted line."""
    span, slope = float(middle[-1] - middle[0]), _slope(middle, speed)
    return Estimate(span * slope.value, span * slope.low, span * slope.high)


def _slope(time: Array, values: Array) -> Estimate:
    """Return the slope of a line fitted to values over time, with its 95 % interval.

    The interval is widened for correlated residuals.
    """
    design = np.column_stack([np.ones(len(time)), time - time.mean()])
    weights = np.linalg.lstsq(design, values, rcond=None)[0]
    residual = values - design @ weights
    freedom = max(len(time) - 2, 1)
    squares = float(residual @ residual)
    stderr = math.sqrt(squares / freedom / float(design[:, 1] @ design[:, 1]))
    from scipy import special

    half = float(special.stdtrit(freedom, 0.975)) * stderr * tracks.widening(residual)
    return Estimate(float(weights[1]), float(weights[1]) - half, float(weights[1]) + half)
