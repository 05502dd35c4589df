"""Kalman filter and Rauch-Tung-Striebel smoother of the errors of a dead-reckoned path.

States are the true minus the reckoned: position, velocity and attitude (a small turn about world
axes), the biases of accelerometer and gyroscope (sensor axes) and their errors of scale and alignment, and
for fusion the lever from the sensor to the reference point, the mounting turn, the tilt of the world against
gravity, and the offset between the clocks.

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
#: Errors of scale and alignment of accelerometer and gyroscope, matrices by rows.
SA, SG = slice(15, 24), slice(24, 33)
LEVER, MOUNT, TILT, CLOCK = slice(33, 36), slice(36, 39), slice(39, 41), 41
#: States without and with another log.
ALONE, FUSED = 33, 42
#: States that move from node to node by themselves; the others stay or wander.
MOVING = 9


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
    counted : bool
        Whether it counts in the likelihood; one that another clock leaves outside the record does not.
    fix : int
        Which pose of another log it is of; -1 for none.
    """

    node: int
    kind: str
    residual: Array
    sensitivity: Array
    sd: Array
    gate: float = np.inf
    counted: bool = True
    fix: int = -1


@dataclass(frozen=True)
class Errors:
    """Smoothed errors.

    Attributes
    ----------
    mean : ndarray, shape (nodes, states)
    covariance : ndarray, shape (nodes, states, states)
    likelihood : float
        Log likelihood of the observations that were used and count.
    scores : dict of str to ndarray
        Normalised innovations of every kind of observation, one row each (NaN beyond its width).
    rejected : int
        Observations beyond their gate.
    """

    mean: Array
    covariance: Array
    likelihood: float
    scores: dict[str, Array]
    rejected: int


def transitions(
    dt: Array, turn: Array, force_w: Array, turn_by_force: Array, turn_by_rate: Array, states: int
) -> Array:
    """Transition matrices of the errors from node to node, exp(F dt) to third order in dt.

    Parameters
    ----------
    dt : ndarray, shape (steps,)
    turn : ndarray, shape (steps, 3, 3)
        Rotation matrix, sensor to world; this and the rest are means over the step.
    force_w : ndarray, shape (steps, 3)
        Specific force, world axes, m/s^2.
    turn_by_force, turn_by_rate : ndarray, shape (steps, 3, 9)
        Every column of the rotation matrix times every component of specific force, and of the turn rate
        (sensor axes; the component runs fastest).

    Returns
    -------
    ndarray, shape (steps, states, states)
    """
    f = np.zeros((len(dt), states, states))
    f[:, P, V] = np.eye(3)
    f[:, V, T] = -cross_matrix(force_w)
    f[:, V, BA] = f[:, T, BG] = -turn
    f[:, V, SA] = -turn_by_force
    f[:, T, SG] = -turn_by_rate
    if states > ALONE:
        f[:, 3, TILT.start] = f[:, 4, TILT.start + 1] = -GRAVITY_M_S2
    f *= dt[:, None, None]
    moving = f[:, :MOVING, :MOVING]
    square = moving @ f[:, :MOVING]
    out = np.broadcast_to(np.eye(states), f.shape).copy()
    out[:, :MOVING] += f[:, :MOVING] + square / 2 + moving @ square / 6
    return out


def driving_noise(dt: Array, white: tuple[Array, Array], walk: tuple[float, float], states: int) -> Array:
    """Covariance each step adds, shape (steps, states, states).

    Parameters
    ----------
    white : ndarray, ndarray, each shape (steps,)
        Variance of the velocity and of the angle that one step adds, (m/s)^2 and rad^2.
    walk : float, float
        Power of the random walk of the biases, (m/s^2)^2/s and (rad/s)^2/s.
    """
    q = np.zeros((len(dt), states, states))
    for i in range(3):
        q[:, 3 + i, 3 + i] = white[0]
        q[:, i, i] = white[0] * dt**2 / 3
        q[:, i, 3 + i] = q[:, 3 + i, i] = white[0] * dt / 2
        q[:, 6 + i, 6 + i] = white[1]
        q[:, 9 + i, 9 + i] = walk[0] * dt
        q[:, 12 + i, 12 + i] = walk[1] * dt
    return q


@threadpool_limits.wrap(limits=1)  # threads cost more than they bring at this size
def smooth(
    start_mean: Array,
    start: Array,
    transition: Array,
    noise: Array,
    observations: list[Observation],
    defect: Array,
) -> Errors:
    """Filter forwards and smooth backwards.

    Parameters
    ----------
    start_mean, start : ndarray, shape (states,) and (states, states)
        Mean and covariance of the errors at the first node before anything is seen.
    transition, noise : ndarray, shape (nodes - 1, states, states)
    observations : list of Observation
    defect : ndarray, shape (nodes - 1, 9)
        What each step adds to the errors of position, velocity and attitude besides.
    """
    nodes, states = len(transition) + 1, len(start)
    at: dict[int, list[Observation]] = {}
    for observation in observations:
        at.setdefault(observation.node, []).append(observation)
    predicted = np.zeros((nodes, states))
    predicted_cov = np.empty((nodes, states, states))
    mean, cov = start_mean.copy(), start.copy()
    means, covs = np.empty((nodes, states)), np.empty((nodes, states, states))
    scores: dict[str, list[Array]] = {}
    rejected, likelihood = 0, 0.0
    for k in range(nodes):
        if k:
            mean = transition[k - 1] @ mean
            mean[:MOVING] += defect[k - 1]
            cov = transition[k - 1] @ cov @ transition[k - 1].T + noise[k - 1]
        predicted[k], predicted_cov[k] = mean, cov
        for seen in at.get(k, ()):
            mean, cov, score, likely = _update(mean, cov, seen)
            if score is None:
                rejected += 1
            else:
                scores.setdefault(seen.kind, []).append(score)
                likelihood += likely if seen.counted else 0.0
        means[k], covs[k] = mean, cov
    for k in range(nodes - 2, -1, -1):
        gain = np.linalg.solve(predicted_cov[k + 1] + 1e-18 * np.eye(states), transition[k] @ covs[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - predicted[k + 1])
        covs[k] = covs[k] + gain @ (covs[k + 1] - predicted_cov[k + 1]) @ gain.T
        covs[k] = 0.5 * (covs[k] + covs[k].T)
    return Errors(means, covs, likelihood, {kind: _padded(rows) for kind, rows in scores.items()}, rejected)


def _update(mean: Array, cov: Array, seen: Observation) -> tuple[Array, Array, Array | None, float]:
    h = seen.sensitivity
    innovation = seen.residual - h @ mean
    shared = h @ cov
    spread = shared @ h.T + np.diag(seen.sd**2)
    score = innovation / np.sqrt(np.diag(spread))
    if np.any(np.abs(score) > seen.gate):
        return mean, cov, None, 0.0
    inverse = np.linalg.inv(spread)
    gain = shared.T @ inverse
    left = np.eye(len(mean)) - gain @ h
    cov = left @ cov @ left.T + (gain * seen.sd**2) @ gain.T  # Joseph's form stays positive
    size = len(innovation) * np.log(2 * np.pi) + np.log(np.linalg.det(spread))
    likely = -0.5 * float(size + innovation @ inverse @ innovation)
    return mean + gain @ innovation, 0.5 * (cov + cov.T), score, likely


def _padded(rows: list[Array]) -> Array:
    width = max(len(row) for row in rows)
    return np.array([np.pad(row, (0, width - len(row)), constant_values=np.nan) for row in rows])


def cross_matrix(vectors: Array) -> Array:
    """Matrices of the cross products ``v x``, shape (..., 3, 3)."""
    return np.swapaxes(np.cross(vectors[..., None, :], np.eye(3)), -1, -2)
