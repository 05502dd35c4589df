"""Coverage of the band of the surge within a stroke (``u_osc_m_s``) of ``swimid track imu``.

The robot rests, swims for 12 s and rests. Its attitude swings about three axes with random amplitudes and
frequencies, and its surge swings with the stroke. The sensor has the errors of a data sheet: white noise,
biases, nonlinearity, and errors of scale and alignment.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy import signal
from scipy.spatial.transform import Rotation

from swimid import track_imu
from swimid.errors import InputError

REPEATS = 60
RATE_HZ = 50.0
GRAVITY_M_S2 = np.array([0.0, 0.0, 9.80665])
SCALE_SD, BENDING_SD = 0.005, 0.002
DENSE = 20


def one(seed: int) -> dict[str, float]:
    """Return the shares of samples within the band: of the whole log, and while the robot moves.

    The accelerations of some vigorous swims make the gyroscope's axes look swapped. Those logs are refused.
    """
    rng = np.random.default_rng(seed)
    dense_s = np.arange(0.0, 22.0, 1 / (DENSE * RATE_HZ))
    moving = np.clip((dense_s - 5) / 2, 0, 1) * np.clip((17 - dense_s) / 2, 0, 1)
    go = moving**2 * (3 - 2 * moving)
    stroke_hz = rng.uniform(0.8, 1.6)
    angles = [
        go * rng.uniform(0.02, 0.6) * np.sin(2 * np.pi * f * dense_s + rng.uniform(0, 2 * np.pi))
        for f in (stroke_hz, rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.6))
    ]
    turn = Rotation.from_euler("ZYX", np.column_stack(angles))
    surge = go * (rng.uniform(0.1, 0.5) + rng.uniform(0.01, 0.1) * np.sin(2 * np.pi * stroke_hz * dense_s))
    body = np.column_stack([surge, 0.02 * go * np.sin(2 * np.pi * stroke_hz * dense_s + 1.0), 0 * surge])
    velocity = turn.apply(body)
    force = turn.inv().apply(np.gradient(velocity, dense_s, axis=0) + GRAVITY_M_S2)
    spin = (turn[:-1].inv() * turn[1:]).as_rotvec() * DENSE * RATE_HZ
    spin = np.vstack([spin, spin[-1:]])

    def seen(true: np.ndarray, noise: float, bias: float) -> np.ndarray:
        matrix = np.eye(3) + SCALE_SD * rng.normal(size=(3, 3))
        sampled = true[::DENSE] @ matrix.T
        sampled += BENDING_SD * rng.normal(size=3) * sampled * np.abs(sampled) / np.abs(sampled).max()
        return sampled + bias * rng.normal(size=3) + noise * rng.normal(size=sampled.shape)

    time_s = dense_s[::DENSE]
    table = pd.DataFrame({"t_s": time_s})
    table[[f"a{axis}_m_s2" for axis in "xyz"]] = seen(force, 0.02, 0.05)
    table[[f"w{axis}_rad_s" for axis in "xyz"]] = seen(spin, 0.003, 0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made = track_imu(table)
        except InputError:
            return {"alarm: refused": 1.0}
    cutoff_hz = made.data["surge_oscillation"]["above_hz"]
    sections = signal.butter(2, cutoff_hz, "high", fs=RATE_HZ, output="sos")
    fast = signal.sosfiltfilt(sections, velocity[::DENSE], axis=0)
    true = turn[::DENSE].inv().apply(fast)[:, 0]
    inside = np.abs(made.frame["u_osc_m_s"] - true) <= 1.96 * made.frame["u_osc_sd_m_s"]
    return {
        "alarm: refused": 0.0,
        "u_osc, whole log": float(inside.mean()),
        "u_osc, moving": float(inside[go[::DENSE] > 0].mean()),
    }
