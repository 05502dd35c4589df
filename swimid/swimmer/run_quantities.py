"""Quantities of a run: torques, powers and balance of energy, and speeds and way of each stroke cycle.

The quantities of a stroke cycle are those of the sea lion paper (Tables I and II).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array
from swimid.logs.rotation import from_angles
from swimid.swimmer.planar.engine import PASSIVE


@dataclass(frozen=True)
class Energetics:
    """What the joints of a run do, over its integration grid.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Even.
    torque_N_m, rate_rad_s : ndarray, shape (m, driven joints)
        Generalised force of each driven joint, on the link behind it, and its rate.
    passive_torque_N_m, passive_rate_rad_s : ndarray, shape (m, passive joints)
        The same of joints that yield: what spring, wire and damper do.
    kinetic_J : ndarray, shape (m,)
        Kinetic energy of the robot and of the water it carries along.
    stored_J : ndarray, shape (m,)
        In the springs of passive joints.
    water_W : ndarray, shape (m,)
        Power given to the water by drag, foils and trailing edges.
    weight_W : ndarray, shape (m,)
        Power given to constant forces: weight and buoyancy.
    dissipated_W : ndarray, shape (m,)
        Power lost in the dampers of passive joints.
    """

    time_s: Array
    torque_N_m: Array
    rate_rad_s: Array
    passive_torque_N_m: Array
    passive_rate_rad_s: Array
    kinetic_J: Array
    stored_J: Array
    water_W: Array
    weight_W: Array
    dissipated_W: Array

    @property
    def power_W(self) -> Array:
        """Mechanical power of each driven joint, shape (m, driven joints)."""
        return self.torque_N_m * self.rate_rad_s

    def mean(self, power_W: Array) -> float:
        """Mean of a power over the whole time, W; of even samples, by the trapezoidal rule."""
        return float(np.trapezoid(power_W, self.time_s) / (self.time_s[-1] - self.time_s[0]))

    def mean_power_W(self) -> float:
        """Mean mechanical power of all driven joints, W: what they give less what they take back."""
        return self.mean(self.power_W.sum(axis=1))

    def mean_positive_power_W(self) -> float:
        """The same for motors that give nothing back: each joint's negative power counts as none, W."""
        return self.mean(np.maximum(self.power_W, 0.0).sum(axis=1))

    def balance_J(self) -> tuple[float, float]:
        """Energy the driven joints gave, and what went into water, weight, dampers, springs and motion, J."""
        duration = self.time_s[-1] - self.time_s[0]
        gone = duration * self.mean(self.water_W + self.weight_W + self.dissipated_W)
        kept = self.kinetic_J + self.stored_J
        return duration * self.mean_power_W(), gone + float(kept[-1] - kept[0])


def elastic(passive: Array, angle: Array, rate: Array) -> tuple[Array, Array]:
    """Power lost in the dampers (W) and energy in the springs (J) of passive joints, shape (m,) each.

    Parameters
    ----------
    passive : ndarray, shape (joints, 11)
        Columns of :data:`swimid.swimmer.planar.engine.PASSIVE`.
    angle, rate : ndarray, shape (m, joints), rad and rad/s

    Notes
    -----
    Of a wire and spring the energy of the tendon fish's Eq 4, ``K_t d_p d_t + K_t d_t^2 / 2`` with Eq 3.
    """
    law = dict(zip(PASSIVE, passive.T, strict=True))
    speed = np.abs(rate)
    lost = (law["damping"] + law["quadratic_damping"] * speed) * rate**2
    smooth = np.sqrt(rate**2 + law["friction_below"] ** 2)
    lost += law["friction"] * rate**2 / np.where(smooth > 0, smooth, 1.0)
    off = angle - law["rest"]
    arm, crank = law["arm"], law["crank"]
    stretch = np.sqrt(arm**2 + crank**2 - 2.0 * arm * crank * np.cos(angle)) - arm + crank
    stored = 0.5 * law["stiffness"] * off**2 + 0.25 * law["cubic"] * off**4
    stored += law["spring"] * (law["pretension"] * stretch + 0.5 * stretch**2)
    return lost.sum(axis=1), stored.sum(axis=1)


#: Fewest samples of a cycle.
MIN_SAMPLES = 6
#: What is told of a cycle, with its unit.
QUANTITIES = {
    "max_speed_m_s": "m/s",
    "mean_speed_m_s": "m/s",
    "final_pitch_rad": "rad",
    "max_pitch_rate_rad_s": "rad/s",
    "mean_pitch_rate_rad_s": "rad/s",
    "surge_m": "m",
    "heave_m": "m",
}


@dataclass(frozen=True)
class Window:
    """One cycle, s."""

    begin_s: float
    end_s: float


def windows(time_s: Array, frequency_hz: float, *, begin_s: float = 0.0) -> list[Window]:
    """The whole cycles of a record, from the time the stroke begins.

    >>> [w.end_s for w in windows(np.arange(0, 8.8, 0.1), 1 / 2.9)]
    [2.9, 5.8, 8.7]
    """
    period = 1.0 / frequency_hz
    first = max(int(np.ceil((time_s[0] - begin_s) / period - 1e-6)), 0)
    last = int(np.floor((time_s[-1] - begin_s) / period + 1e-6))
    return [
        Window(float(begin_s + k * period), float(round(begin_s + (k + 1) * period, 9)))
        for k in range(first, last)
    ]


def quantities(time_s: Array, channels: Mapping[str, Array], window: Window) -> dict[str, float]:
    """Speeds in the vertical plane, pitch and its rate, and the way made in one cycle.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
    channels : mapping of str to ndarray
        ``x_m``, ``z_m`` and ``pitch_rad``, as far as they are there, and their speeds.

    Returns
    -------
    dict of str to float
        Of :data:`QUANTITIES`. Empty with too few samples.

    Notes
    -----
    Speeds are the log's own where it has them: ``vx_m_s`` and ``vz_m_s``, else those along the body's
    axes turned into the world, and ``pitch_rate_rad_s``. A simulation's are exact, and a tracked film's
    come from a smoother whose bandwidth follows from its noise. Central differences of the positions,
    taken otherwise, fall short by ``(2 pi f / rate)^2 / 6`` at a frequency f (0.7 % at 1 Hz in a film
    of 30 pictures a second), and their noise (that of a position times rate / sqrt 2) raises every
    maximum.
    """
    inside = (time_s >= window.begin_s - 1e-9) & (time_s <= window.end_s + 1e-9)
    found: dict[str, float] = {}

    def seen(values: Array | None) -> tuple[Array, Array] | None:
        """Times and values in the cycle, where there are enough; of several rows where all are there."""
        if values is None:
            return None
        there = inside & np.isfinite(np.atleast_2d(values)).all(axis=0)
        return (time_s[there], values[..., there]) if there.sum() >= MIN_SAMPLES else None

    moving = seen(velocity(time_s, channels))
    if moving is not None:
        t, speed = moving[0], np.hypot(*moving[1])
        found["max_speed_m_s"] = float(speed.max())
        found["mean_speed_m_s"] = float(np.trapezoid(speed, t) / (t[-1] - t[0]))
    for name, way in (("x_m", "surge_m"), ("z_m", "heave_m")):
        place = seen(channels.get(name))
        if place is not None:
            found[way] = float(place[1][-1] - place[1][0])
    pitch = seen(channels.get("pitch_rad"))
    if pitch is not None:
        t, angle = pitch
        rate = channels.get("pitch_rate_rad_s")
        rate = (_slope(time_s, channels["pitch_rad"]) if rate is None else rate)[inside]
        found["final_pitch_rad"] = float(angle[-1])
        if np.isfinite(rate).sum() >= MIN_SAMPLES:
            found["max_pitch_rate_rad_s"] = float(np.nanmax(np.abs(rate)))
        found["mean_pitch_rate_rad_s"] = float((angle[-1] - angle[0]) / (t[-1] - t[0]))
    return {name: found[name] for name in QUANTITIES if name in found}


def velocity(time_s: Array, channels: Mapping[str, Array]) -> Array | None:
    """Speeds along the world's x and z, shape (2, n), of a path's :func:`quantities`; None without a path."""
    if "vx_m_s" in channels and "vz_m_s" in channels:
        return np.array([channels["vx_m_s"], channels["vz_m_s"]])
    if "x_m" not in channels or "z_m" not in channels:
        return None
    if not {"u_m_s", "w_m_s", "pitch_rad"} <= channels.keys():
        return np.array([_slope(time_s, channels["x_m"]), _slope(time_s, channels["z_m"])])
    none = np.zeros(len(time_s))
    body = np.column_stack([channels.get(name, none) for name in ("u_m_s", "v_m_s", "w_m_s")])
    angles = np.column_stack([channels.get(name, none) for name in ("roll_rad", "pitch_rad", "yaw_rad")])
    known = np.isfinite(body).all(axis=1) & np.isfinite(angles).all(axis=1)
    world = np.full((2, len(time_s)), np.nan)
    if known.any():
        world[:, known] = from_angles(*angles[known].T).apply(body[known])[:, [0, 2]].T
    return world


def _slope(time_s: Array, values: Array) -> Array:
    """Central differences of the samples that are there."""
    there = np.isfinite(values)
    found = np.full(len(values), np.nan)
    if there.sum() > 1:
        found[there] = np.gradient(values[there], time_s[there])
    return found
