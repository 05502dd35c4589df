"""Quantities of a swim over whole cycles, with one definition for simulations, logs and tracks.

:data:`QUANTITIES` lists the names with their units and meanings. :mod:`swimid.kinematics.frequency` and
:mod:`swimid.kinematics.stroke` estimate the frequency of the stroke.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from swimid.kinematics.attitude import from_angles
from swimid.logs.sampling import slope

Array = NDArray[np.float64]


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
MIN_SAMPLES_CYCLE = 6
#: Conditions under which the Strouhal number of a swim is computed: minimum speed, body lengths per second
#: (MIN_SPEED_BL_S), and maximum change of the heading from beat to beat, rad (MAX_TURN_IN_BEAT).
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
            One channel or k channels, without NaN.

    >>> cycle_means(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2.0, 2.0]), np.array([0.0, 1.0, 2.0])).tolist()
    [1.0, 2.0]
    """
    areas = np.cumsum(0.5 * np.diff(time_s) * (values[..., 1:] + values[..., :-1]), axis=-1)
    areas = np.concatenate((np.zeros((*values.shape[:-1], 1)), areas), axis=-1)
    at_edges = np.apply_along_axis(lambda area: np.interp(edges_s, time_s, area), -1, areas)
    return np.asarray(np.diff(at_edges, axis=-1) / np.diff(edges_s))


def block_speeds(place: Array, duration_s: float, turn_rad: Array | None = None) -> Array:
    """Return the speeds along a path between its mean positions over successive blocks, shape (m - 1,).

    Parameters
    ----------
    place : ndarray, shape (2, m)
            Mean positions over m blocks of equal duration.
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
    A quantity is computed only if the cycle has at least :data:`MIN_SAMPLES_CYCLE` samples. The pitch rate is
    the channel ``pitch_rate_rad_s``, or the central difference of the pitch.
    """
    inside = (time_s >= window.begin_s - 1e-9) & (time_s <= window.end_s + 1e-9)
    found: dict[str, float] = {}

    def samples_in_cycle(values: Array | None) -> tuple[Array, Array] | None:
        """Return the times and samples of a channel in the cycle; None for fewer than MIN_SAMPLES_CYCLE."""
        if values is None:
            return None
        there = inside & np.isfinite(np.atleast_2d(values)).all(axis=0)
        if there.sum() < MIN_SAMPLES_CYCLE:
            return None
        return time_s[there], values[..., there]

    moving = samples_in_cycle(world_velocity(time_s, channels))
    if moving is not None:
        t, speed = moving[0], np.hypot(*moving[1])
        found["max_speed_m_s"] = float(speed.max())
        found["path_speed_m_s"] = float(np.trapezoid(speed, t) / (t[-1] - t[0]))
    for name, way in (("x_m", "surge_m"), ("z_m", "heave_m")):
        place = samples_in_cycle(channels.get(name))
        if place is not None:
            found[way] = float(place[1][-1] - place[1][0])
    if "surge_m" in found and "heave_m" in found:
        found["mean_speed_m_s"] = math.hypot(found["surge_m"], found["heave_m"]) / window.duration_s
    pitch = samples_in_cycle(channels.get("pitch_rad"))
    if pitch is not None:
        t, angle = pitch
        rate = channels.get("pitch_rate_rad_s")
        if rate is None:
            rate = _differences(time_s, channels["pitch_rad"])
        found["final_pitch_rad"] = float(angle[-1])
        if np.isfinite(rate[inside]).sum() >= MIN_SAMPLES_CYCLE:
            found["max_pitch_rate_rad_s"] = float(np.nanmax(np.abs(rate[inside])))
        found["mean_pitch_rate_rad_s"] = float((angle[-1] - angle[0]) / (t[-1] - t[0]))
    return {name: found[name] for name in CYCLE_QUANTITIES if name in found}
