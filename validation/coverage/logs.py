"""False alarms of the examination of logs: clean recordings of swims, and beats that are found in noise.

The swims are written down here as sums of sines, splines and noise; no model of swimid makes them.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import interpolate, signal

import swimid
from swimid.kinematics.frequency import find_beats
from validation.coverage.rows import ALARM, alarms

Array = NDArray[np.float64]
REPEATS = 400
#: Noise without a beat: coefficients of the recursive filters of white noise.
NOISES = {"white noise": [1.0], "AR 0.9": [1.0, -0.9], "AR 0.98": [1.0, -0.98], "random walk": [1.0, -1.0]}


def noise(rng: np.random.Generator, count: int, feedback: list[float]) -> Array:
    """Return a channel of noise, shape (count,), after the filter has forgotten its start."""
    return signal.lfilter([1.0], feedback, rng.normal(size=count + 500))[500:]


def wander(rng: np.random.Generator, time: Array, size: float) -> Array:
    """Return a slow random curve of a given size, shape (n,), with a knot about every six seconds."""
    knots = np.linspace(time[0], time[-1], max(int(np.ptp(time) / 6.0), 4))
    return interpolate.CubicSpline(knots, size * rng.normal(size=len(knots)))(time)


def swim(rng: np.random.Generator) -> pd.DataFrame:
    """Return a recording of a robot with two driven joints, with rests at its ends in a third of all draws.

    Its pose has white noise and slow noise. Its speed and its course change slowly.
    """
    rate, stroke_hz = rng.choice([20.0, 30.0, 60.0, 100.0]), rng.uniform(0.4, 2.0)
    time = np.arange(0.0, rng.uniform(6.0, 30.0) / stroke_hz, 1.0 / rate)
    active = np.ones(len(time))
    if rng.random() < 1 / 3:
        begin, end = rng.uniform(0.05, 0.2) * time[-1], rng.uniform(0.8, 0.95) * time[-1]
        active = np.clip(stroke_hz * (time - begin), 0.0, 1.0) * np.clip(stroke_hz * (end - time), 0.0, 1.0)
    phase = 2 * np.pi * stroke_hz * time + 0.1 * wander(rng, time, 1.0)
    course = rng.uniform(-np.pi, np.pi) + np.cumsum(active * wander(rng, time, 0.15)) / rate
    speed = active * np.clip(rng.uniform(0.05, 0.5) * (1.0 + wander(rng, time, 0.1)), 0.0, None)
    sway = active * rng.uniform(0.002, 0.02) * np.sin(phase)
    path = np.cumsum(speed * np.exp(1j * course)) / rate + 1j * sway * np.exp(1j * course)
    yaw = course + active * rng.uniform(0.02, 0.2) * np.sin(phase + 0.7)
    wave = rng.uniform(0.1, 0.6) * active
    columns = {"x_m": path.real, "y_m": path.imag, "yaw_rad": yaw}
    errors = {"x_m": 1e-3, "y_m": 1e-3, "yaw_rad": 0.01}
    for number, lag in ((1, 0.0), (2, 0.9)):
        columns[f"joint{number}_rad"], errors[f"joint{number}_rad"] = wave * np.sin(phase - lag), 0.005
        columns[f"cmd{number}_rad"] = wave * np.sin(phase - lag + 0.2)
    if rng.random() < 0.5:
        columns["yaw_rate_rad_s"], errors["yaw_rate_rad_s"] = np.gradient(yaw, time), 0.02
    for name, size in errors.items():
        slow = noise(rng, len(time), NOISES["AR 0.98"])
        size *= rng.uniform(0.2, 1.5)
        columns[name] = columns[name] + size * (rng.normal(size=len(time)) + 0.5 * slow / np.std(slow))
    if rng.random() < 1 / 3:
        time = np.round(time, 3)  # a clock in milliseconds
    return pd.DataFrame({"t_s": time, **columns})


def one(seed: int) -> dict[str, float]:
    """Return for each check whether it warns of a clean recording, and for each noise whether it beats."""
    rng = np.random.default_rng([seed, 29])
    found = alarms(swimid.import_log(swim(rng)), "swim, ")
    for name, feedback in NOISES.items():
        time = np.arange(rng.integers(300, 2000)) / rng.choice([20.0, 50.0, 200.0])
        found[f"{name}, {ALARM}beat"] = float(bool(find_beats(time, noise(rng, len(time), feedback))))
    return found
