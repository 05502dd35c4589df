"""Servos and linkages that do not follow their command, as tables of angle, rate and acceleration.

Every function takes and returns (3, joints, n) on a uniform grid that starts with the joints at rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lsim

from tests.blind.swim_case import Act, Trial

Joints = np.ndarray


def command(drive: dict[str, float], gain: np.ndarray, t: np.ndarray) -> Joints:
    """A sine with bias eased in by the quintic step 10 x^3 - 15 x^4 + 6 x^5."""
    turn = 2.0 * np.pi * drive["frequency_hz"]
    swing, bias = np.radians(drive["amplitude_deg"]), np.radians(drive.get("bias_deg", 0.0))
    wave = swing * np.exp(1j * (turn * t - 0.5 * np.pi))
    angle, rate, bend = wave.real + bias, (1j * turn * wave).real, (-(turn**2) * wave).real
    ramp = drive.get("ramp_s", 1.0)
    step = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    x = np.clip(t / ramp, 0.0, 1.0)
    s0, s1, s2 = step(x), step.deriv()(x) / ramp, step.deriv(2)(x) / ramp**2
    whole = np.array([s0 * angle, s1 * angle + s0 * rate, s2 * angle + 2.0 * s1 * rate + s0 * bend])
    return whole[:, None, :] * gain[None, :, None]


def shared(rng: np.random.Generator, joints: int, spread: float) -> np.ndarray:
    """Factors of mean one that differ between joints."""
    found = 1.0 + spread * rng.uniform(-1.0, 1.0, joints)
    return found / found.mean()


def second_order(t: np.ndarray, q: Joints, rate: float, damping: float) -> Joints:
    """Each joint is a second-order servo behind its command."""
    out = np.empty_like(q)
    a = np.array([[0.0, 1.0], [-(rate**2), -2.0 * damping * rate]])
    system = (a, np.array([[0.0], [rate**2]]), np.eye(2), np.zeros((2, 1)))
    for j in range(q.shape[1]):
        _, y, _ = lsim(system, q[0, j], t, X0=[q[0, j, 0], 0.0])
        out[:2, j] = y.T
        out[2, j] = rate**2 * (q[0, j] - y[:, 0]) - 2.0 * damping * rate * y[:, 1]
    return out


def delayed(t: np.ndarray, q: Joints, delay_s: float) -> Joints:
    """A pure delay, then commands of regular ticks joined by straight lines that the servo rounds off."""
    period = min(0.020, 0.5 * delay_s)
    rounding = 0.3 * period
    pure = delay_s - period - rounding
    tick = np.floor(t / period) * period
    share = (t - tick) / period
    out = np.zeros_like(q)
    for j in range(q.shape[1]):
        curve = CubicHermiteSpline(t, q[0, j], q[1, j])
        old, new = (curve(np.maximum(at - pure, 0.0)) for at in (tick - period, tick))
        out[0, j] = old + share * (new - old)
    return second_order(t, out, 2.0 / rounding, 1.0)


@njit(cache=True)
def follow_limited(command, step, limit, stiffness):  # type: ignore[no-untyped-def]
    """Rate of a follower that saturates as a tanh, by Heun's rule; rows angle, rate, acceleration."""
    n = command.shape[1]
    out = np.empty((3, n))
    angle = command[0, 0]
    for i in range(n):
        wanted = (command[1, i] + stiffness * (command[0, i] - angle)) / limit
        rate = limit * np.tanh(wanted)
        out[0, i], out[1, i] = angle, rate
        out[2, i] = (1.0 - np.tanh(wanted) ** 2) * (command[2, i] + stiffness * (command[1, i] - rate))
        if i + 1 < n:
            guess = angle + step * rate
            after = (command[1, i + 1] + stiffness * (command[0, i + 1] - guess)) / limit
            angle += 0.5 * step * (rate + limit * np.tanh(after))
    return out


@njit(cache=True)
def play_rate(e, rate, width, slow):  # type: ignore[no-untyped-def]
    share = min(abs(e / width), 1.0) ** 4
    return rate * (1.0 - 0.5 * (1.0 + np.tanh(8.0 * rate * e / (width * slow))) * share)


@njit(cache=True)
def follow_with_play(command, step, width, slow):  # type: ignore[no-untyped-def]
    """Bouc and Wen's hysteresis as a play of half-width ``width``: gap by Heun's rule, in rows 0 and 1."""
    n = command.shape[1]
    out = np.empty((2, n))
    e = 0.0
    for i in range(n):
        opening = play_rate(e, command[1, i], width, slow)
        out[0, i], out[1, i] = command[0, i] - e, command[1, i] - opening
        if i + 1 < n:
            after = play_rate(e + step * opening, command[1, i + 1], width, slow)
            e = min(max(e + 0.5 * step * (opening + after), -width), width)
    return out


def servo_lag(rng: np.random.Generator, size: float, robot: str) -> Act:
    """A second-order servo whose lag at low frequency is 2 damping / rate."""
    damping = rng.uniform(0.7, 1.0)
    lag = size * 0.055
    return Act(joints=lambda trial, t, q: second_order(t, q, 2.0 * damping / lag, damping))


def servo_delay(rng: np.random.Generator, size: float, robot: str) -> Act:
    return Act(joints=lambda trial, t, q: delayed(t, q, size * 0.070))


def play(width_rad: Sequence[float]) -> Act:
    """Play of a given half-width in each driven joint, rad."""

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        out = q.copy()
        for j in range(q.shape[1]):
            if np.ptp(q[0, j]) > 0:
                out[:2, j] = follow_with_play(q[:, j].copy(), t[1], width_rad[j], 0.3)
                out[2, j] = np.gradient(out[1, j], t[1])
        return out

    return Act(joints=joints)


def servo_backlash(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Half-width of the play per driven joint, rad."""
    return play(size * np.radians({"tfish": 1.3, "dolphin": 2.2}[robot]) * shared(rng, 3, 0.2))


def amplitude_loss(rng: np.random.Generator, size: float, robot: str) -> Act:
    left = 1.0 - min({"tfish": 0.12, "dolphin": 0.12}[robot] * size, 0.45) * shared(rng, 4, 0.25)
    return Act(joints=lambda trial, t, q: q * left[None, : q.shape[1], None])


def rate_limit(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Saturation at a share of the fastest rate these trials ask for."""
    fastest = {"tfish": 2.0, "dolphin": 5.5}[robot]
    limit = fastest / {"tfish": 1.1 + 0.6 * size, "dolphin": 0.5 + 0.4 * size}[robot]
    stiffness = rng.uniform(30.0, 60.0)

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        out = q.copy()
        for j in range(q.shape[1]):
            if np.ptp(q[0, j]) > 0:
                out[:, j] = follow_limited(q[:, j].copy(), t[1], limit, stiffness)
        return out

    return Act(joints=joints)


def moved(robot: str) -> np.ndarray:
    """Which joints a trim turns."""
    return np.array([1.0, 1.0, 1.0, 0.0]) / 3.0 if robot == "tfish" else np.array([0.0, 1.0, 0.0])


def amplitude_offset(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Trim of the whole tail, not the same at every joint."""
    total = size * np.radians({"tfish": 2.5, "dolphin": 1.2}[robot]) * rng.choice([-1.0, 1.0])
    trim = total * moved(robot) * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, len(moved(robot))))

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        out = q.copy()
        out[0] += trim[: q.shape[1], None]
        return out

    return Act(joints=joints)


def battery_droop(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The drive weakens towards a lower level in every trial."""
    loss, time = min(0.10 * size, 0.6), rng.uniform(4.0, 7.0)

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        s, d = 1.0 - loss * (1.0 - np.exp(-t / time)), -loss / time * np.exp(-t / time)
        return np.array([s * q[0], s * q[1] + d * q[0], s * q[2] + 2.0 * d * q[1] - d / time * q[0]])

    return Act(joints=joints)


def held_joint(rng: np.random.Generator) -> Act:
    """One of the fish's three servos stays where it stuck."""
    stuck, where = int(rng.integers(3)), np.radians(rng.uniform(-3.0, 3.0))

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        out = q.copy()
        out[:, stuck] = 0.0
        out[0, stuck] = where
        return out

    return Act(joints=joints, facts={"joint": stuck + 1})
