"""Series with faults of logging, from equations that are written out here: no code of swimid's."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

G = np.array([0.0, 0.0, 9.80665])


def motor(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a duty and the speed of a first-order motor with pole 0.9, sampled 25 times a second."""
    duty = np.repeat(rng.normal(size=-(-count // 12)), 12)[:count]
    speed = np.zeros(count)
    for k in range(1, count):
        speed[k] = 0.9 * speed[k - 1] + 0.4 * duty[k - 1] + 0.02 * rng.normal()
    return duty, speed


def motor_logged_four_times(rng: np.random.Generator) -> pd.DataFrame:
    """Return a log at 100 Hz of speeds measured at 25 Hz; the repeats have a ripple of 0.1 %."""
    duty, speed = motor(rng, 600)
    table = pd.DataFrame({"t_s": np.arange(2400) / 100, "duty": np.repeat(duty, 4)})
    table["speed_rad_s"] = np.repeat(speed, 4) + 1e-3 * rng.normal(size=2400)
    return table


def motor_with_slow_sensor(rng: np.random.Generator) -> pd.DataFrame:
    """Return a log at 33.3 Hz of a motor whose speed is measured at 25 Hz: every fourth sample repeats."""
    duty, speed = motor(rng, 600)
    shown = np.arange(800) * 3 // 4
    return pd.DataFrame({"t_s": np.arange(800) * 0.03, "duty": duty[shown], "speed_rad_s": speed[shown]})


def yaw_from_a_current(rng: np.random.Generator) -> pd.DataFrame:
    """Return a yaw rate that a wave drives, beside a random rudder that is not connected."""
    time_s = np.arange(1500) / 25
    rudder = np.repeat(rng.choice([-0.3, 0.0, 0.3], 150), 10)
    rate = 0.2 * np.sin(2 * np.pi * 0.21 * time_s) + 0.02 * rng.normal(size=1500)
    return pd.DataFrame({"t_s": time_s, "cmd1_rad": rudder, "yaw_rate_rad_s": rate})


def rolling(rng: np.random.Generator, *, rate_hz: float = 50.0) -> tuple[pd.DataFrame, Rotation]:
    """Return readings and attitude of a body that rests, turns about tilted axes, and rests."""
    time_s = np.arange(0.0, 24.0, 1 / rate_hz)
    go = np.clip((time_s - 4) / 2, 0, 1) * np.clip((20 - time_s) / 2, 0, 1)
    go = go * go * (3 - 2 * go)
    spin = go[:, None] * np.column_stack(
        [0.5 + 0.3 * np.sin(time_s), 0.4 * np.sin(1.3 * time_s), 0.3 + 0.2 * np.cos(0.7 * time_s)]
    )
    steps = Rotation.from_rotvec(0.5 * (spin[1:] + spin[:-1]) / rate_hz)
    turns = [Rotation.from_euler("ZYX", [0.3, -0.1, 0.05])]
    for k in range(len(time_s) - 1):
        turns.append(turns[-1] * steps[k])
    attitude = Rotation.concatenate(turns)
    table = pd.DataFrame({"t_s": time_s})
    force = attitude.inv().apply(np.tile(G, (len(time_s), 1)))
    table[[f"a{axis}_m_s2" for axis in "xyz"]] = force + 0.02 * rng.normal(size=force.shape)
    table[[f"w{axis}_rad_s" for axis in "xyz"]] = spin + 0.002 * rng.normal(size=spin.shape)
    return table, attitude


def hopping(rng: np.random.Generator, *, unit: float = 1.0) -> pd.DataFrame:
    """Return readings of a sensor on a tail tip that never rests; its spin about the vertical is fast."""
    time_s = np.arange(0.0, 16.0, 0.01)
    phase = 2 * np.pi * 2.3 * time_s
    force = np.column_stack([14 * np.sin(phase), 8 * np.cos(phase), 9.80665 + 7 * np.sin(2 * phase)])
    spin = np.column_stack([0 * time_s, 0 * time_s, 14 * np.sin(phase)])
    table = pd.DataFrame({"t_s": time_s})
    table[[f"a{axis}_m_s2" for axis in "xyz"]] = (force + 0.05 * rng.normal(size=force.shape)) / unit
    table[[f"w{axis}_rad_s" for axis in "xyz"]] = spin + 0.005 * rng.normal(size=spin.shape)
    return table
