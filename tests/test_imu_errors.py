"""Smoother of the errors of an inertial path, against one dense Gaussian distribution of all nodes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from swimid.inertial import estimate, smoother
from swimid.inertial.smoother import Observation

STATES, NODES = 10, 4


@pytest.fixture(scope="module")
def system() -> dict[str, Any]:
    """Return a random linear system, and the mean and covariance of the stacked errors of all nodes."""
    rng = np.random.default_rng(5)

    def covariance(size: int, scale: float) -> np.ndarray:
        root = rng.normal(size=(size, size))
        return scale * (root @ root.T + 0.5 * np.eye(size))

    start, mean = covariance(STATES, 1.0), rng.normal(size=STATES)
    transition = np.eye(STATES) + 0.2 * rng.normal(size=(NODES - 1, STATES, STATES))
    noise = np.array([covariance(STATES, 0.1) for _ in range(NODES - 1)])
    defect = rng.normal(size=(NODES - 1, 9))
    observations = [
        Observation(node, "seen", rng.normal(size=2), rng.normal(size=(2, STATES)), rng.uniform(0.3, 1.0, 2))
        for node in (0, 1, 1, 3)
    ]
    # the errors of all nodes are a linear function of independent draws
    total = NODES * STATES
    whole, centre = np.zeros((total, total)), np.zeros(total)
    blocks = [slice(k * STATES, (k + 1) * STATES) for k in range(NODES)]
    whole[blocks[0], blocks[0]], centre[blocks[0]] = start, mean
    for k in range(NODES - 1):
        here, after = blocks[k], blocks[k + 1]
        centre[after] = transition[k] @ centre[here] + np.append(defect[k], 0.0)
        whole[after, : after.start] = transition[k] @ whole[here, : after.start]
        whole[: after.start, after] = whole[after, : after.start].T
        whole[after, after] = transition[k] @ whole[here, here] @ transition[k].T + noise[k]
    return {
        "given": (mean, start, transition, noise, observations, defect),
        "centre": centre, "whole": whole, "blocks": blocks,
    }  # fmt: skip


def conditioned(system: dict[str, Any], used: list[Observation]) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean and covariance of all errors given the observations, and their log-likelihood."""
    h = np.zeros((2 * len(used), NODES * STATES))
    for k, one in enumerate(used):
        h[2 * k : 2 * k + 2, system["blocks"][one.node]] = one.sensitivity
    seen, sd = np.concatenate([o.residual for o in used]), np.concatenate([o.sd for o in used])
    spread = h @ system["whole"] @ h.T + np.diag(sd**2)
    gain = system["whole"] @ h.T @ np.linalg.inv(spread)
    off = seen - h @ system["centre"]
    likelihood = multivariate_normal(cov=spread).logpdf(off)
    return system["centre"] + gain @ off, system["whole"] - gain @ h @ system["whole"], float(likelihood)


def test_the_smoother_conditions_all_errors_on_all_observations(system: dict[str, Any]) -> None:
    observations = system["given"][4]
    found = smoother.smooth_errors(*system["given"])
    mean, covariance, likelihood = conditioned(system, observations)
    np.testing.assert_allclose(found.mean, mean.reshape(NODES, STATES), rtol=1e-6, atol=1e-6)
    for k, block in enumerate(system["blocks"]):
        np.testing.assert_allclose(found.covariance[k], covariance[block, block], rtol=1e-5, atol=1e-6)
    # the smoother gain relates successive nodes: cov(k, k + 1) = G cov(k + 1)
    for k, (here, after) in enumerate(zip(system["blocks"], system["blocks"][1:], strict=False)):
        np.testing.assert_allclose(
            found.gain[k] @ found.covariance[k + 1], covariance[here, after], rtol=1e-5, atol=1e-5
        )
    assert found.likelihood == pytest.approx(likelihood, rel=1e-9)
    assert found.rejected == 0
    assert {kind: len(scores) for kind, scores in found.scores.items()} == {"seen": 4}
    # the first score is normalised by the prior
    first = observations[0]
    off = first.residual - first.sensitivity @ system["given"][0]
    spread = first.sensitivity @ system["given"][1] @ first.sensitivity.T + np.diag(first.sd**2)
    np.testing.assert_allclose(found.scores["seen"][0], off / np.sqrt(np.diag(spread)))


def test_an_outlier_is_left_out_and_some_observations_are_not_counted(system: dict[str, Any]) -> None:
    *given, observations, defect = system["given"]
    wild = Observation(2, "wild", np.full(2, 1e3), observations[0].sensitivity, np.ones(2), gate=5.0)
    silent = Observation(1, "silent", *vars_of(observations[1]), counted=False)
    found = smoother.smooth_errors(*given, [observations[0], silent, wild], defect)
    mean, _, likelihood = conditioned(system, [observations[0]])
    assert found.likelihood == pytest.approx(likelihood, rel=1e-9)
    assert found.rejected == 1
    assert set(found.scores) == {"seen", "silent"}
    mean, _, _ = conditioned(system, [observations[0], silent])
    np.testing.assert_allclose(found.mean, mean.reshape(NODES, STATES), rtol=1e-6, atol=1e-6)


def vars_of(one: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return one.residual, one.sensitivity, one.sd


def test_drawn_errors_have_the_smoothed_covariance(system: dict[str, Any]) -> None:
    """Two functions of the errors at each node, in 20000 draws: variances to 4 %."""
    found = smoother.smooth_errors(*system["given"])
    _, covariance, _ = conditioned(system, system["given"][4])
    rng = np.random.default_rng(2)
    functions = rng.normal(size=(NODES, 2, STATES))
    drawn = found.draw(functions, 20_000)
    assert drawn.shape == (NODES, 2, 20_000)
    wide = np.zeros((2 * NODES, NODES * STATES))
    for k, block in enumerate(system["blocks"]):
        wide[2 * k : 2 * k + 2, block] = functions[k]
    expected = wide @ covariance @ wide.T
    size = np.sqrt(np.diag(expected))
    # four standard errors of a correlation of 20000 draws
    np.testing.assert_allclose(
        np.cov(drawn.reshape(2 * NODES, -1)) / np.outer(size, size),
        expected / np.outer(size, size),
        atol=0.04,
    )
    np.testing.assert_array_equal(found.draw(functions, 3), found.draw(functions, 3))


# ---------------------------------------------------------------- contradictions


def estimated(
    tilt_rad: float, *, yaw_rad: float = 0.0, stray: float = 0.0, mean: float = 0.0
) -> estimate.MotionEstimate:
    """Return an estimate whose tilt departs from that of a filter, of 0.01 rad as its own is of 0.014 rad."""
    count, tilt = 50, smoother.ERROR_SLICES["rotation"]
    covariance = np.zeros((count, tilt.stop, tilt.stop))
    for k in (0, 1):
        covariance[:, tilt.start + k, tilt.start + k] = 2e-4
    covariance[:, tilt.start + 2, tilt.start + 2] = 1.0  # of the yaw, which is no tilt
    turn = Rotation.from_euler("ZX", np.tile([yaw_rad, tilt_rad], (count, 1)))
    known = np.arange(100) < 80
    found: Any = SimpleNamespace(
        setup=SimpleNamespace(
            rests=[],
            attitude_sd=0.01,
            source=SimpleNamespace(kind="filter", rotation=Rotation.identity(count)),
        ),
        smoothed=SimpleNamespace(
            errors=SimpleNamespace(mean=np.full((count, 9), mean), covariance=covariance),
            path=SimpleNamespace(rotation=turn),
        ),
        fixes=SimpleNamespace(
            position=np.where(known, 0.0, np.nan)[:, None] * np.ones(3),
            stray=(np.arange(100) < stray * 80)[:, None] * np.ones(2, dtype=bool),
        ),
    )
    return found


@pytest.mark.parametrize(
    ("estimated_with", "words"),
    [
        # six standard deviations, sqrt(2 * 0.01^2 + 2 * 2e-4) each, are 0.147 rad or 8.4 degrees
        ({"tilt_rad": 0.140, "yaw_rad": 2.0}, []),
        ({"tilt_rad": -0.154}, ["its tilt differs from that of the filter by 9 deg rms, more than 6"]),
        ({"tilt_rad": 0.0, "stray": 0.4}, []),
        ({"tilt_rad": 0.0, "stray": 0.6}, ["60 % of the fixes lie beyond 6 deviations"]),
        ({"tilt_rad": 0.0, "mean": math.nan}, ["the smoothing has no finite result"]),
    ],
)
def test_contradictions_of_a_motion(estimated_with: dict[str, float], words: list[str]) -> None:
    found = estimate.find_contradictions(estimated(**estimated_with))
    assert len(found) == len(words)
    assert all(word in text for word, text in zip(words, found, strict=True))
