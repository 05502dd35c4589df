"""Kalman filter and Rauch-Tung-Striebel smoother of the errors of a dead-reckoned path.

States are the true minus the reckoned: position, velocity and attitude (a small turn about world
axes), the biases of accelerometer and gyroscope (sensor axes) and their errors of scale and alignment, and
for fusion the lever from the sensor to the reference point, the mounting turn, the tilt of the world against
gravity, and the offset between the clocks.

After Rauch, Tung and Striebel (1965, doi:10.2514/3.3166).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from swimid.inertial.record import Array

#: Where the error of each part of the state lies; scales are matrices by rows.
PARTS = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "rotation": slice(6, 9),
    "acceleration_bias": slice(9, 12),
    "rate_bias": slice(12, 15),
    "acceleration_scale": slice(15, 24),
    "rate_scale": slice(24, 33),
    "lever": slice(33, 36),
    "mount": slice(36, 39),
    "tilt": slice(39, 41),
    "clock_s": slice(41, 42),
}
#: States without and with another log.
ALONE, FUSED = 33, 42
#: States that move from node to node by themselves; the others stay or wander.
MOVING = 9


def jacobian(states: int, *shape: int, **by: Array) -> Array:
    """Derivatives with respect to the states, shape (*shape, states), from those with respect to its parts.

    Parts that are no states, without another log, are left out.
    """
    out = np.zeros((*shape, states))
    for name, values in by.items():
        if PARTS[name].stop <= states:
            out[..., PARTS[name]] = values
    return out


@dataclass(frozen=True)
class Observation:
    """A measurement of the error at one node."""

    node: int
    #: What it is, for the account kept of each kind.
    kind: str
    #: Shape (m,). Measured minus reckoned.
    residual: Array
    #: Shape (m, states).
    sensitivity: Array
    #: Shape (m,). Standard deviations, independent of each other.
    sd: Array
    #: A residual beyond this many deviations is an outlier and not used; infinite for none.
    gate: float = np.inf
    #: Whether it counts in the likelihood; one that another clock leaves outside the record does not.
    counted: bool = True
    #: Which pose of another log it is of; -1 for none.
    fix: int = -1


@dataclass(frozen=True)
class Errors:
    """Smoothed errors."""

    #: Shape (nodes, states).
    mean: Array
    #: Shape (nodes, states, states).
    covariance: Array
    #: Shape (nodes - 1, states, states). Smoother gains: they tie the errors of successive nodes.
    gain: Array
    #: Log likelihood of the observations that were used and count.
    likelihood: float
    #: Normalised innovations of every observation, by its kind.
    scores: dict[str, list[Array]]
    #: Observations beyond their gate.
    rejected: int

    @threadpool_limits.wrap(limits=1)
    def draw(self, sensitivity: Array, count: int) -> Array:
        """Draw trajectories of the errors about their mean, as functions of them.

        Parameters
        ----------
        sensitivity : ndarray, shape (nodes, m, states)
            Derivatives of the functions with respect to the states.
        count : int
            Number of trajectories.

        Returns
        -------
        ndarray, shape (nodes, m, count)
            The seed is fixed: the same errors give the same trajectories.

        Notes
        -----
        Backward sampling (Fruehwirth-Schnatter 1994, doi:10.1111/j.1467-9892.1994.tb00184.x). Given the
        errors x at node k + 1, those at node k are Gaussian: mean G x, covariance P(k) - G P(k + 1) G',
        where G is the smoother gain and P the smoothed covariance. So the trajectories have the smoothed
        covariance at every node, and the correlation between nodes that it does not show.
        """
        rng = np.random.default_rng(0)
        nodes, states = self.mean.shape
        drawn = np.empty((nodes, sensitivity.shape[1], count))
        x = np.zeros((states, count))
        for k in range(nodes - 1, -1, -1):
            left = self.covariance[k]
            if k < nodes - 1:
                gain = self.gain[k]
                left = left - gain @ self.covariance[k + 1] @ gain.T
                x = gain @ x
            size = np.sqrt(np.maximum(np.diag(self.covariance[k]), 1e-300))
            variance, axes = np.linalg.eigh(left / np.outer(size, size))
            x = x + size[:, None] * (axes * np.sqrt(np.maximum(variance, 0.0))) @ rng.normal(size=x.shape)
            drawn[k] = sensitivity[k] @ x
        return drawn


@threadpool_limits.wrap(limits=1)  # threads cost more than they bring at this size
def smooth_errors(
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
    gains = np.empty((nodes - 1, states, states))
    for k in range(nodes - 2, -1, -1):
        gain = np.linalg.solve(predicted_cov[k + 1] + 1e-18 * np.eye(states), transition[k] @ covs[k]).T
        means[k] = means[k] + gain @ (means[k + 1] - predicted[k + 1])
        covs[k] = covs[k] + gain @ (covs[k + 1] - predicted_cov[k + 1]) @ gain.T
        gains[k] = gain
        covs[k] = 0.5 * (covs[k] + covs[k].T)
    return Errors(means, covs, gains, likelihood, scores, rejected)


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


def cross_matrix(vectors: Array) -> Array:
    """Matrices of the cross products ``v x``, shape (..., 3, 3)."""
    return np.swapaxes(np.cross(vectors[..., None, :], np.eye(3)), -1, -2)
