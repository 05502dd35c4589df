"""Servos and linkages that do not follow their command, as tables of angle, rate and acceleration.

Every function takes and returns (3, joints, n) on a uniform grid that starts with the joints at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from scipy.interpolate import CubicHermiteSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lsim

from validation.blind import swim_body
from validation.blind.swim_case import Act, Trial

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


def slip(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The tendons slip from about the same moment of every trial on, by unlike shares."""
    loss = min(0.15 * size, 0.8) * shared(rng, 4, 0.2)
    when, width = rng.uniform(0.35, 0.65), rng.uniform(0.1, 0.3)

    def joints(trial: Trial, t: np.ndarray, q: Joints) -> Joints:
        at = (t - when * trial.duration_s) / width
        lost = loss[: q.shape[1], None]
        bell = 1.0 / np.cosh(at) ** 2
        s, d, dd = 0.5 * (1.0 + np.tanh(at)), 0.5 * bell / width, -bell * np.tanh(at) / width**2
        left, rate, bend = 1.0 - lost * s, -lost * d, -lost * dd
        return np.array([left * q[0], left * q[1] + rate * q[0], left * q[2] + 2 * rate * q[1] + bend * q[0]])

    return Act(joints=joints, facts={"share": when, "loss": float(loss.mean())})


@njit(cache=True)
def dragged(command, level, step, lag, slow):  # type: ignore[no-untyped-def]
    """A servo of little damping against a friction that goes with tanh: angle by the implicit Euler rule.

    Solved for the rate by bisection: ``lag rate + level tanh(rate / slow) = command - angle``.
    """
    out = np.empty(len(command))
    out[0] = command[0]
    for i in range(1, len(command)):
        ahead = command[i] - out[i - 1]
        low, high = min(0.0, ahead / (lag + step)), max(0.0, ahead / (lag + step))
        for _ in range(50):
            rate = 0.5 * (low + high)
            if (lag + step) * rate + level[i] * np.tanh(rate / slow) < ahead:
                low = rate
            else:
                high = rate
        out[i] = out[i - 1] + step * 0.5 * (low + high)
    return out


def held(q: Joints, levels: Callable[[int, np.ndarray], np.ndarray], step: float) -> Joints:
    """Joints that friction holds back; ``levels(joint, motion)`` is how far, rad."""
    out = q.copy()
    for j in range(q.shape[1]):
        if np.ptp(q[0, j]) > 0:
            rough = dragged(q[0, j].copy(), levels(j, q[:, j]), step, 0.002, 0.02)
            # a joint has inertia: its rate has no steps
            out[0, j] = gaussian_filter1d(rough, 0.006 / step, mode="nearest")
            out[1, j] = np.gradient(out[0, j], step)
            out[2, j] = np.gradient(out[1, j], step)
    return out


def stribeck(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Servos held back by less the faster they turn, with an algebraic fall."""
    stick = size * np.radians({"tfish": 1.2, "dolphin": 2.5}[robot])
    slow = {"tfish": 0.4, "dolphin": 1.2}[robot] * rng.uniform(0.8, 1.25)

    def level(joint: int, motion: np.ndarray) -> np.ndarray:
        return stick / (1.0 + np.abs(motion[1] / slow) ** 3)

    return Act(joints=lambda trial, t, q: held(q, level, t[1]), facts={"stick_rad": stick, "slow": slow})


def tails(robot: str) -> list[tuple[float, float]]:
    """Inertia (kg m2) and drag (N m s2) of the straight tail about each driven joint."""
    body = swim_body.of(robot, {})
    found = []
    for joint in range(len(body.gain)):
        start = np.concatenate([np.zeros(joint + 1), np.cumsum([0.0, *body.length[joint + 1 : -1]])])
        own, wet = body.mass_link > joint, body.link > joint
        reach = (start[body.mass_link] + body.mass_at.real)[own]
        inertia = body.mass[own] @ reach**2 + body.inertia[joint + 1 :].sum()
        drag = body.across[wet] @ (start[body.link] + body.behind)[wet] ** 3
        if body.foil[1] > 0.0:
            flat = body.foil[1] * (body.foil[3] + 2.0 * body.foil[4])
            drag += flat * (start[-1] + body.foil[0]) ** 3
        found.append((float(inertia), float(drag)))
    return found


def load_friction(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Servos held back in proportion to the torque of the tail behind them."""
    per = {"tfish": 0.3, "dolphin": 0.08}[robot] * size
    behind = tails(robot)

    def level(joint: int, motion: np.ndarray) -> np.ndarray:
        inertia, drag = behind[joint]
        return per * np.abs(inertia * motion[2] + drag * motion[1] * np.abs(motion[1]))

    return Act(joints=lambda trial, t, q: held(q, level, t[1]), facts={"held_rad_N_m": per})


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
