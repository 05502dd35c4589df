"""Cameras, clocks, markers and gyros that do not tell the truth."""

from __future__ import annotations

import numpy as np

from validation.blind.swim_case import Act, Channels, Trial

#: Names of the second coordinate and the angle, and of the gyro's rate.
UP = {"tfish": ("y_m", "yaw_rad", "yaw_rate_rad_s"), "dolphin": ("z_m", "pitch_rad", "pitch_rate_rad_s")}


def _placed(trial: Trial, channels: Channels, place: np.ndarray) -> Channels:
    up = UP[trial.robot][0]
    return {**channels, "x_m": place.real, up: place.imag}


def _place(trial: Trial, channels: Channels) -> np.ndarray:
    return channels["x_m"] + 1j * channels[UP[trial.robot][0]]


def camera_scale(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A wrong scale, and a lens whose scale changes a little towards the edge."""
    off_by = {"tfish": 0.08, "dolphin": 0.02}[robot] * size
    scale = 1.0 + off_by * rng.choice([-1.0, 1.0])
    centre, bent = complex(rng.normal(), rng.normal()), 0.05 * off_by * rng.uniform(-1.0, 1.0)

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        off = _place(trial, channels) - centre
        return _placed(trial, channels, scale * off * (1.0 + bent * np.abs(off) ** 2) + centre)

    return Act(seen=seen)


def camera_rotation(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The picture's axes are turned against those of the heading; the camera also looks a little aslant."""
    turn = np.radians(1.2 * size) * rng.choice([-1.0, 1.0])
    squeeze = np.cos(np.radians(rng.uniform(0.0, 3.0)))

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        place = _place(trial, channels) * np.exp(1j * turn)
        return _placed(trial, channels, place.real + 1j * squeeze * place.imag)

    return Act(seen=seen)


def time_offset(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The camera's clock is late, and runs at a slightly other rate."""
    late, drift = 0.060 * size * rng.choice([-1.0, 1.0]), 5e-4 * size * rng.uniform(-1.0, 1.0)
    return Act(clock=lambda trial, t: t - late - drift * t)


def drifted(t: np.ndarray, rate: float, warm_s: float) -> np.ndarray:
    """True time of a clock whose rate settles as its oscillator warms up: a fifth less at first."""
    return t - rate * (t - 0.2 * warm_s * -np.expm1(-t / warm_s))


def clock_rate(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The camera's clock runs fast or slow."""
    rate, warm = 0.010 * size * rng.choice([-1.0, 1.0]), rng.uniform(1.0, 4.0)
    return Act(clock=lambda trial, t: drifted(t, rate, warm))


def marker_offset(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The tracked marker is not on the nose."""
    off = {"tfish": 0.05, "dolphin": 0.02}[robot] * size * np.exp(1j * rng.uniform(-np.pi, np.pi))

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        angle = channels[UP[robot][1]]
        return _placed(trial, channels, _place(trial, channels) + off * np.exp(1j * angle))

    return Act(seen=seen)


def imu_tilt(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A gyro whose axes are turned about all three; the hull rolls a little with the stroke."""
    tilt, cross = np.radians(22.0) * np.sqrt(size), rng.uniform(-0.05, 0.05)
    rate = UP[robot][2]

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        turning = channels[rate]
        roll = cross * np.gradient(turning, t) / (2.0 * np.pi * trial.drive["frequency_hz"])
        return {**channels, rate: np.cos(tilt) * turning + np.sin(tilt) * roll}

    return Act(seen=seen, gyro=True)


def imu_bias(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A gyro's zero that is off and wanders."""
    bias, rate = np.radians(0.8) * size * rng.choice([-1.0, 1.0]), UP[robot][2]

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        own = trial.rng("bias")
        walk = np.cumsum(own.normal(size=len(t))) * 0.04 * abs(bias) / np.sqrt(trial.rate_hz)
        return {**channels, rate: channels[rate] + bias * (1.0 + 0.05 * own.normal()) + walk}

    return Act(seen=seen, gyro=True)


def marker_dropout(rng: np.random.Generator, size: float, robot: str) -> Act:
    """From some second on the tracker freezes, jumps to a reflection, or loses the marker in bursts."""
    way = rng.choice(["freeze", "reflection", "bursts"])
    affected = rng.choice(8, size=min(2 + round(2 * size), 6), replace=False)

    def broken(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        if trial.index not in affected:
            return channels
        own = trial.rng("dropout")
        found = {name: values.copy() for name, values in channels.items()}
        camera = [name for name in ("x_m", *UP[robot][:2]) if name in found]
        begin = own.uniform(0.35, 0.7) * t[-1]
        length = {"freeze": 0.8, "reflection": 0.6, "bursts": 2.5}[way] * np.sqrt(size)
        hit = (t >= begin) & (t < begin + length)
        if way == "freeze":
            for name in camera:
                found[name][hit] = found[name][np.argmax(hit)]
        elif way == "reflection":
            jump = own.uniform(0.1, 0.4) * np.exp(1j * own.uniform(-np.pi, np.pi))
            found["x_m"][hit] += jump.real
            found[UP[robot][0]][hit] += jump.imag
        else:
            lost = hit & (own.random(len(t)) < 0.5)
            stray = hit & ~lost & (own.random(len(t)) < 0.25)
            for name in camera:
                found[name][stray] += own.normal(size=int(stray.sum())) * (
                    0.15 if name.endswith("_m") else 0.5
                )
                found[name][lost] = np.nan
        return found

    return Act(broken=broken, facts={"way": str(way)})
