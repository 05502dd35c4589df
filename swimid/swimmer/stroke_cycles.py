"""What a robot does in each cycle of a stroke, as the sea lion paper tells it (Tables I and II)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array
from swimid.logs.rotation import from_angles

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
