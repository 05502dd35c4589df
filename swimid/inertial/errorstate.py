"""Kalman filter and Rauch-Tung-Striebel smoother of the errors of a dead-reckoned path.

States are the true minus the reckoned: position, velocity and attitude (a small turn about world
axes), the biases of accelerometer and gyroscope (sensor axes), and for fusion the lever from the
sensor to the reference point, the mounting turn, the tilt of the world against gravity, and the offset
between the clocks.

Sources: error equations after Groves (2013), Principles of GNSS, Inertial, and Multisensor
Integrated Navigation Systems, 2nd ed., sec. 14.2, on a world that does not turn; smoother after Rauch,
Tung and Striebel (1965, doi:10.2514/3.3166).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.inertial.record import GRAVITY_M_S2, Array

P, V, T = slice(0, 3), slice(3, 6), slice(6, 9)
BA, BG = slice(9, 12), slice(12, 15)
LEVER, MOUNT, TILT, CLOCK = slice(15, 18), slice(18, 21), slice(21, 23), 23
#: States without and with another log.
ALONE, FUSED = 15, 24


@dataclass(frozen=True)
class Observation:
    """A measurement of the error at one node.

    Attributes
    ----------
    node : int
    kind : str
        What it is, for the account kept of each kind.
    residual : ndarray, shape (m,)
        Measured minus reckoned.
    sensitivity : ndarray, shape (m, states)
    sd : ndarray, shape (m,)
        Standard deviations, independent of each other.
    gate : float
        A residual beyond this many deviations is an outlier and not used; infinite for none.
    """

    node: int
    kind: str
    residual: Array
    sensitivity: Array
    sd: Array
    gate: float = np.inf


@dataclass(frozen=True)
class Driving:
    """What makes the errors grow, per step between nodes.

    Attributes
    ----------
    acceleration, rate : ndarray, shape (steps,)
        Variance of the velocity and of the angle that one step adds, (m/s)^2 and rad^2.
    acceleration_bias, rate_bias : float
        Power of the random walk of the biases, (m/s^2)^2/s and (rad/s)^2/s.
    """

    acceleration: Array
    rate: Array
    acceleration_bias: float
    rate_bias: float


@dataclass(frozen=True)
class Errors:
    """Smoothed errors.

    Attributes
    ----------
    mean : ndarray, shape (nodes, states)
    covariance : ndarray, shape (nodes, states, states)
    scores : dict of str to ndarray
        Normalised innovations of every kind of observation, one row each (NaN beyond its width).
    rejected : dict of str to int
        Observations beyond their gate, of every kind.
    """

    mean: Array
    covariance: Array
    scores: dict[str, Array]
    rejected: dict[str, int]


def transitions(time_s: Array, turn: Array, specific_force_w: Array, states: int) -> Array:
    """Transition matrices of the errors from node to node.

    Parameters
    ----------
    time_s : ndarray, shape (nodes,)
    turn : ndarray, shape (nodes - 1, 3, 3)
        Mean rotation matrix, sensor to world, over each step.
    specific_force_w : ndarray, shape (nodes - 1, 3)
        Mean specific force over each step, world axes, m/s^2.

    Returns
    -------
    ndarray, shape (nodes - 1, states, states)
        exp(F dt) to third order in dt.
    """
    dt = np.diff(time_s)
    n = len(dt)
    f = np.zeros((n, states, states))
    eye = np.eye(3)
    f[:, P, V] = eye
    f[:, V, T] = -cross_matrix(specific_force_w)
    f[:, V, BA] = -turn
    f[:, T, BG] = -turn
    if states > ALONE:
        f[:, 3, 21] = f[:, 4, 22] = -GRAVITY_M_S2
    f *= dt[:, None, None]
    square = f @ f
    return np.eye(states) + f + square / 2 + square @ f / 6


def driving_noise(time_s: Array, driving: Driving, states: int) -> Array:
    """Covariance each step adds, shape (nodes - 1, states, states)."""
    dt = np.diff(time_s)
    q = np.zeros((len(dt), states, states))
    for i in range(3):
        q[:, 3 + i, 3 + i] = driving.acceleration
        q[:, i, i] = driving.acceleration * dt**2 / 3
        q[:, i, 3 + i] = q[:, 3 + i, i] = driving.acceleration * dt / 2
        q[:, 6 + i, 6 + i] = driving.rate
        q[:, 9 + i, 9 + i] = driving.acceleration_bias * dt
        q[:, 12 + i, 12 + i] = driving.rate_bias * dt
    return q


def smooth(
    start_mean: Array, start: Array, transition: Array, noise: Array, observations: list[Observation]
) -> Errors:
    """Filter forwards and smooth backwards.

    Parameters
    ----------
    start_mean, start : ndarray, shape (states,) and (states, states)
        Mean and covariance of the errors at the first node before anything is seen.
    transition, noise : ndarray, shape (nodes - 1, states, states)
    observations : list of Observation
    """
    with threadpool_limits(1):  # threads cost more than they bring at this size
        return _smooth(start_mean, start, transition, noise, observations)


def _smooth(
    start_mean: Array, start: Array, transition: Array, noise: Array, observations: list[Observation]
) -> Errors:
    nodes, states = len(transition) + 1, len(start)
    at: dict[int, list[Observation]] = {}
    for observation in observations:
        at.setdefault(observation.node, []).append(observation)
    predicted = np.zeros((nodes, states))
    predicted_cov = np.empty((nodes, states, states))
    mean, cov = start_mean.copy(), start.copy()
    means, covs = np.empty((nodes, states)), np.empty((nodes, states, states))
    scores: dict[str, list[Array]] = {}
    rejected: dict[str, int] = {}
    for k in range(nodes):
        if k:
            mean = transition[k - 1] @ mean
            cov = transition[k - 1] @ cov @ transition[k - 1].T + noise[k - 1]
        predicted[k], predicted_cov[k] = mean, cov
        for seen in at.get(k, ()):
            mean, cov, score = _update(mean, cov, seen)
            if score is None:
                rejected[seen.kind] = rejected.get(seen.kind, 0) + 1
            else:
                scores.setdefault(seen.kind, []).append(score)
        means[k], covs[k] = mean, cov
    for k in range(nodes - 2, -1, -1):
        gain = np.linalg.solve(predicted_cov[k + 1] + 1e-18 * np.eye(states), transition[k] @ covs[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - predicted[k + 1])
        covs[k] = covs[k] + gain @ (covs[k + 1] - predicted_cov[k + 1]) @ gain.T
        covs[k] = 0.5 * (covs[k] + covs[k].T)
    return Errors(means, covs, {kind: _padded(rows) for kind, rows in scores.items()}, rejected)


def _update(mean: Array, cov: Array, seen: Observation) -> tuple[Array, Array, Array | None]:
    h = seen.sensitivity
    innovation = seen.residual - h @ mean
    spread = h @ cov @ h.T + np.diag(seen.sd**2)
    score = innovation / np.sqrt(np.diag(spread))
    if np.any(np.abs(score) > seen.gate):
        return mean, cov, None
    gain = np.linalg.solve(spread, h @ cov).T
    left = np.eye(len(mean)) - gain @ h
    cov = left @ cov @ left.T + (gain * seen.sd**2) @ gain.T  # Joseph's form stays positive
    return mean + gain @ innovation, 0.5 * (cov + cov.T), score


def _padded(rows: list[Array]) -> Array:
    width = max(len(row) for row in rows)
    return np.array([np.pad(row, (0, width - len(row)), constant_values=np.nan) for row in rows])


def cross_matrix(vectors: Array) -> Array:
    """Matrices of the cross products ``v x``, shape (n, 3, 3)."""
    x, y, z = np.moveaxis(np.atleast_2d(vectors), -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2
    )
