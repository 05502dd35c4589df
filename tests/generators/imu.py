"""Runs of a long-fin vehicle with an inertial unit and a camera, from first principles.

Nothing here is swimid's: motion is written down as functions of time in the naval frame (x forward, y
starboard, z down), differentiated numerically on a dense grid with direction cosines, and turned into sensor
readings; the axes are changed to z up at the very end. Noise is that of a MicroStrain 3DM-GX1 as its
data sheet and Shang et al. (2012), Table I, give it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

G = 9.80665
#: Naval axes (forward, starboard, down) to forward, port, up.
NAVAL = np.diag([1.0, -1.0, -1.0])
DENSE = 2e-3


@dataclass(frozen=True)
class Errors:
    """What is wrong with the unit; the defaults are a 3DM-GX1's."""

    acceleration_noise: float = 0.4e-3 * G  # per square root of Hz
    rate_noise: float = np.radians(3.5) / 60
    acceleration_bias: float = 10e-3 * G  # deviation of each axis
    rate_bias: float = np.radians(0.7)
    acceleration_drift: float = 0.2e-3 * G  # over 100 s
    rate_drift: float = np.radians(0.02)
    tilt: float = np.radians(2.0)  # how far the unit is off the body's axes
    attitude: float = np.radians(2.0)  # rms of its own quaternions


QUIET = Errors(1e-4, 1e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Run:
    """One run: readings, and the truth at the same times in axes with z up.

    ``quaternion`` is w, x, y, z, body to world.
    """

    time_s: np.ndarray
    acceleration: np.ndarray
    rate: np.ndarray
    quaternion: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    body_velocity: np.ndarray
    attitude: np.ndarray  # matrices, body to world
    yaw: np.ndarray
    frequency_hz: float

    def columns(self, *, quaternions: bool = False) -> dict[str, np.ndarray]:
        """The columns of its log."""
        names = ("ax_m_s2", "ay_m_s2", "az_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s")
        out = {
            "t_s": self.time_s,
            **dict(zip(names, np.hstack([self.acceleration, self.rate]).T, strict=True)),
        }
        if quaternions:
            out |= dict(zip(("qw", "qx", "qy", "qz"), self.quaternion.T, strict=True))
        return out


def marching(
    rng: np.random.Generator,
    *,
    errors: Errors | None = None,
    speed_m_s: float = 0.3,
    frequency_hz: float = 1.2,
    swim_s: float = 18.0,
    rest_s: float = 4.0,
    turn_rad: float = 0.3,
    roll_rad: float = 0.05,
    rate_hz: float = 100.0,
) -> Run:
    """March from rest to rest: speed, a stroke's surge and sway, and a slow turn."""
    errors = errors or Errors()
    end = 2 * rest_s + swim_s
    fine = np.arange(-5 * DENSE, end + 5 * DENSE, DENSE)
    go = _eased(fine, rest_s, 3.0) * (1 - _eased(fine, rest_s + swim_s - 3.0, 3.0))
    phase = 2 * np.pi * frequency_hz * fine
    surge = go * (speed_m_s + 0.08 * speed_m_s * np.sin(2 * phase + 0.4))
    sway = go * 0.02 * np.sin(phase)
    heave = go * 0.01 * np.sin(phase + 1.0)
    roll = go * roll_rad * np.sin(phase + 0.7)
    pitch = go * (0.03 * np.sin(2 * phase) + 0.02)
    yaw = turn_rad * _eased(fine, rest_s + 4.0, max(swim_s - 8.0, 1.0)) + go * 0.07 * np.sin(phase + 0.2)
    turn = cosines(roll, pitch, yaw)
    velocity = np.einsum("nij,nj->ni", turn, np.column_stack([surge, sway, heave]))
    position = np.cumsum(velocity, axis=0) * DENSE
    acceleration = np.gradient(velocity, DENSE, axis=0)
    spin = np.einsum("nji,njk->nik", turn, np.gradient(turn, DENSE, axis=0))
    rate = np.column_stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    force = np.einsum("nji,nj->ni", turn, acceleration - [0.0, 0.0, G])
    time = np.arange(0.0, end, 1 / rate_hz)

    def at(series: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(time, fine, c) for c in series.T])

    true_turn = at(turn.reshape(-1, 9)).reshape(-1, 3, 3)
    true_turn = _orthonormal(true_turn)
    tilt = cosines(*(np.atleast_1d(a) for a in errors.tilt * rng.choice([-1, 1], 3) * [0.7, 0.7, 0.0]))[0]
    n, step = len(time), 1 / rate_hz

    def seen(true: np.ndarray, density: float, bias: float, drift: float) -> np.ndarray:
        walk = np.cumsum(rng.normal(0, drift * np.sqrt(step / 100), (n, 3)), axis=0)
        return true @ tilt + rng.normal(0, bias, 3) + walk + rng.normal(0, density * np.sqrt(rate_hz), (n, 3))

    readings_a = seen(
        at(force), errors.acceleration_noise, errors.acceleration_bias, errors.acceleration_drift
    )
    readings_w = seen(at(rate), errors.rate_noise, errors.rate_bias, errors.rate_drift)
    wrong = _slow(rng, n, step, errors.attitude)
    told = np.einsum("nij,njk->nik", _small(wrong), true_turn)
    up = NAVAL
    world_turn = up @ true_turn @ up
    place = at(position)
    return Run(
        time,
        readings_a @ up,
        readings_w @ up,
        _quaternions(up @ told @ up),
        (place - place[0]) @ up,
        at(velocity) @ up,
        at(np.column_stack([surge, sway, heave])) @ up,
        world_turn,
        -np.interp(time, fine, yaw),
        frequency_hz,
    )


def camera(
    run: Run,
    rng: np.random.Generator,
    *,
    offset_s: float = 0.0,
    rate_hz: float = 30.0,
    position_sd: float = 0.001,
    yaw_sd: float = np.radians(0.3),
    lost: tuple[float, float] | None = None,
    with_yaw: bool = True,
) -> dict[str, np.ndarray]:
    """What a camera above sees; its clock shows ``offset_s`` less than the unit's."""
    true = np.arange(run.time_s[0] + 0.05, run.time_s[-1] - 0.05, 1 / rate_hz)
    out = {"t_s": true - offset_s}
    for k, name in enumerate(("x_m", "y_m")):
        out[name] = np.interp(true, run.time_s, run.position[:, k]) + rng.normal(0, position_sd, len(true))
    if with_yaw:
        out["yaw_rad"] = np.interp(true, run.time_s, run.yaw) + rng.normal(0, yaw_sd, len(true))
    if lost is not None:
        hidden = (true > lost[0]) & (true < lost[1])
        for name in out:
            if name != "t_s":
                out[name][hidden] = np.nan
    return out


def _eased(t: np.ndarray, start: float, duration: float) -> np.ndarray:
    x = np.clip((t - start) / duration, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x**2)


def cosines(roll: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Body to world, naval angles, shape (n, 3, 3)."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _orthonormal(matrices: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd(matrices)
    return u @ vt


def _small(vectors: np.ndarray) -> np.ndarray:
    """Turns by small vectors, to second order and made orthonormal."""
    x, y, z = vectors.T
    o = np.zeros_like(x)
    skew = np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), -1, 0)
    return _orthonormal(np.eye(3) + skew + skew @ skew / 2)


def _slow(rng: np.random.Generator, n: int, step: float, rms: float, memory_s: float = 5.0) -> np.ndarray:
    """A wandering error of given rms, shape (n, 3)."""
    keep = np.exp(-step / memory_s)
    out = np.empty((n, 3))
    out[0] = rng.normal(0, rms, 3)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + rng.normal(0, rms * np.sqrt(1 - keep**2), 3)
    return out


def _quaternions(matrices: np.ndarray) -> np.ndarray:
    """w, x, y, z by the largest component's formula."""
    out = np.empty((len(matrices), 4))
    for k, m in enumerate(matrices):
        squares = np.array([1 + np.trace(m), *(1 + 2 * m[i, i] - np.trace(m) for i in range(3))])
        i = int(np.argmax(squares))
        s = 2 * np.sqrt(squares[i])
        w = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1])
        if i == 0:
            q = [0.25 * s, *(v / s for v in w)]
        else:
            a, b, c = i - 1, i % 3, (i + 1) % 3
            q = [w[a] / s, 0, 0, 0]
            q[1 + a] = 0.25 * s
            q[1 + b] = (m[a, b] + m[b, a]) / s
            q[1 + c] = (m[a, c] + m[c, a]) / s
        out[k] = q
    return out
