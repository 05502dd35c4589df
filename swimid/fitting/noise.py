"""The noise model of an output-error fit, estimated from its own residuals.

A measured value is off by a constant error, by a known shape times a factor, or (where time
stamps are free) by the speed times the stamp's error; what is left is an autoregression.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize, special

from swimid.fitting.model import Array
from swimid.fitting.problem import Problem
from swimid.fitting.residual_tests import fit_autoregression, joined

#: Huber's corner in standard deviations: 95 % efficient where the noise is normal after all.
CORNER = 1.345
#: Mean square of standard normal noise clipped at the corner.
CLIPPED = float(
    special.erf(CORNER / math.sqrt(2))
    - CORNER * math.sqrt(2 / math.pi) * math.exp(-(CORNER**2) / 2)
    + CORNER**2 * special.erfc(CORNER / math.sqrt(2))
)


def weigh_first(problem: Problem, even: bool) -> None:
    """First weights: each channel by its own size, known error shapes as they are; all equal if ``even``."""
    if even:
        return
    for k, trial in enumerate(problem.trials):
        for i, channel in enumerate(problem.channels[k]):
            values = trial.measured[channel]
            known = trial.value_sd.get(channel)
            if known is not None and np.any(np.asarray(known) > 0):
                problem.sd[k][i] = np.broadcast_to(np.asarray(known, dtype=float), values.shape).copy()
            else:
                spread = float(np.nanstd(values)) or 1.0
                problem.sd[k][i] = np.full(len(values), 0.01 * spread)


def estimate(
    problem: Problem, theta: Array, previous: dict[str, tuple[float, float]], *, robust: bool = False
) -> dict[str, tuple[float, float]]:
    """Size of value and stamp errors by channel, from the residuals; sets the problem's weights.

    Parameters
    ----------
    theta : ndarray, shape (p,)
    previous : dict of channel name to (float, float)
        The sizes of the round before; empty in the first.
    robust : bool
        Sizes from the median absolute deviation, and weights of Huber's loss
        ("Robust estimation of a location parameter", 1964): a sample farther off than
        :data:`CORNER` standard deviations counts by its side, not by its distance.

    Returns
    -------
    dict of channel name to (value, stamp)
        Standard deviation in the channel's unit (a factor where the shape of the error is
        known) and in seconds.
    """
    found: dict[str, tuple[float, float]] = {}
    simulations = problem.simulations(theta)
    for channel in sorted({c for channels in problem.channels for c in channels}):
        owners = [k for k, channels in enumerate(problem.channels) if channel in channels]
        errors, rates, shapes = [], [], []
        for k in owners:
            trial, simulated = problem.trials[k], simulations[k][channel]
            rate = np.zeros_like(simulated)
            if trial.stamps_uncertain or np.any(trial.time_sd_s):
                rate = problem.model.sensitivity_to_time(problem.vector(theta, k), trial)[channel]
            errors.append(trial.measured[channel] - simulated)
            rates.append(np.abs(rate))
            known = np.broadcast_to(
                np.asarray(trial.value_sd.get(channel, 0.0), dtype=float), simulated.shape
            )
            shapes.append(np.sqrt(known**2 + (trial.time_sd_s * rate) ** 2))
        uncertain = [problem.trials[k].stamps_uncertain for k in owners]
        constant, stamp = _components(errors, rates, shapes, uncertain, previous.get(channel), robust)
        found[channel] = (constant, stamp)
        for k, shape, rate, free, error in zip(owners, shapes, rates, uncertain, errors, strict=True):
            i = problem.channels[k].index(channel)
            if np.any(shape > 0):
                sd = np.maximum(shape, 0.05 * np.median(shape)) * (constant or 1e-15)
            else:
                sd = np.sqrt(constant**2 + (stamp * rate) ** 2) if free else np.full(len(rate), constant)
            largest = np.nanmax(np.abs(problem.trials[k].measured[channel]))
            problem.sd[k][i] = np.maximum(sd, 1e-12 * max(1e-6, largest))
            if robust:
                problem.damping[k][i] = huber_damping(error / problem.sd[k][i])
    return found


def huber_damping(residuals: Array) -> Array:
    """Factors of weighted residuals: what it makes of one, squared, pulls by it as Huber's loss does."""
    far = np.maximum(np.abs(np.nan_to_num(residuals, nan=0.0)) / CORNER, 1.0)
    return np.asarray(1.0 / np.sqrt(far))


def influence(problem: Problem, residuals: list[Array]) -> tuple[list[Array], list[Array]]:
    """Each trial's residuals as if from least squares, and factors of the rows of their derivatives.

    A robust loss lets a sample pull by at most its corner; its curvature vanishes beyond. With the linear
    loss these are the same residuals, and ones.
    """
    inside: dict[str, list[Array]] = {}
    for k, dampings in enumerate(problem.damping):
        for channel, damping, mask in zip(problem.channels[k], dampings, problem.masks[k], strict=True):
            inside.setdefault(channel, []).append(damping[mask] == 1.0)
    curvature = {c: max(float(np.mean(np.concatenate(parts))), 1e-3) for c, parts in inside.items()}
    factors = [
        problem.at_samples(
            k,
            [math.sqrt(curvature[c]) / d for c, d in zip(problem.channels[k], dampings, strict=True)],
        )
        for k, dampings in enumerate(problem.damping)
    ]
    return [values / factor for values, factor in zip(residuals, factors, strict=True)], factors


def weights(problem: Problem) -> list[Array]:
    """Weight of every sample of each trial, each shape (n_k,)."""
    return [problem.sample_weights(k) for k in range(len(problem.trials))]


def largest_change(problem: Problem, before: list[Array]) -> float:
    """Largest relative change of a sample's weight since ``before``, against those of all together."""
    every = np.concatenate(weights(problem)) / np.concatenate(before)
    return float(np.max(np.abs(every / np.median(every) - 1.0), initial=0.0))


def _components(
    residuals: list[Array],
    rates: list[Array],
    shapes: list[Array],
    uncertain: list[bool],
    previous: tuple[float, float] | None,
    robust: bool,
) -> tuple[float, float]:
    """Standard deviations of value and stamp; the first is a factor where the shape is known."""
    r = np.concatenate(residuals)
    there = np.isfinite(r)
    shape = np.concatenate(shapes)
    size = _robust_size if robust else _size
    if np.any(shape > 0):
        floor = np.where(shape > 0, np.maximum(shape, 0.05 * np.median(shape[shape > 0])), 1.0)
        return size(r[there] / floor[there]), 0.0
    if not any(uncertain):
        return size(r[there]), 0.0
    square = r[there] ** 2
    if robust:
        corner = CORNER * _robust_size(r[there])
        square = np.minimum(square, corner**2) / CLIPPED
    rate2 = np.concatenate([q**2 if u else np.zeros_like(q) for q, u in zip(rates, uncertain, strict=True)])[
        there
    ]
    variance = np.full(len(square), max(float(np.mean(square)), 1e-300))
    if previous is not None:
        variance = np.maximum(previous[0] ** 2 + previous[1] ** 2 * rate2, 1e-3 * variance)
    design = np.column_stack((np.ones_like(rate2), rate2)) / variance[:, None]
    norm = np.linalg.norm(design, axis=0)
    norm[norm == 0] = 1.0
    parts = optimize.nnls(design / norm, square / variance)[0] / norm
    # neither part may vanish altogether: a sample with no error would outweigh all others
    least = 1e-4 * float(np.mean(square))
    return math.sqrt(max(float(parts[0]), least)), math.sqrt(max(float(parts[1]), 0.0))


def _size(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _robust_size(errors: Array) -> float:
    """Standard deviation of the middle: that of normal noise with this median absolute size."""
    return float(np.median(np.abs(errors)) / special.ndtri(0.75)) or _size(errors)


def value_sd(problem: Problem, channel: str, constant: float) -> float:
    """Root mean square of the samples' standard deviations, stamps apart where they are free."""
    owners = [k for k, names in enumerate(problem.channels) if channel in names]
    if any(problem.trials[k].stamps_uncertain for k in owners):
        return constant
    squares = []
    for k in owners:
        i = problem.channels[k].index(channel)
        squares.append(np.mean(problem.sd[k][i][problem.masks[k][i]] ** 2))
    return float(np.sqrt(np.mean(squares)))


def autoregressions(problem: Problem, residuals: list[Array]) -> dict[str, Array]:
    """Autoregression of the trials' weighted residuals by channel, pooled over trials; empty where white."""
    found = {}
    for channel, series in problem.series(residuals).items():
        x = joined(series, gap=30)
        if np.isfinite(x).sum() < 12 or np.nanstd(x) == 0:
            found[channel] = np.empty(0)
            continue
        longest = max(len(s) for s in series)
        found[channel] = fit_autoregression(x, max_order=max(1, min(25, longest // 5))).coefficients
    return found
