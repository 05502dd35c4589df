"""The noise model of an output-error fit, estimated from its own residuals.

A measured value is off by a constant error, by a known shape times a factor, or (where time
stamps are free) by the speed times the stamp's error; what is left is an autoregression.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize

from swimid.estimators.problem import Problem
from swimid.estimators.residual_tests import fit_autoregression, joined
from swimid.models.base import Array


def weigh_first(problem: Problem, even: bool) -> None:
    """First weights: each channel by its own size, known error shapes as they are.

    ``even`` leaves all weights equal.
    """
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
    problem: Problem, theta: Array, previous: dict[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Size of value and stamp errors by channel, from the residuals; sets the problem's weights.

    Parameters
    ----------
    theta : ndarray, shape (p,)
        Where the residuals are taken.
    previous : dict of channel name to (float, float)
        The sizes of the round before; empty in the first.

    Returns
    -------
    dict of channel name to (value, stamp)
        Standard deviation in the channel's unit (a factor where the shape of the error is
        known) and in seconds.
    """
    found: dict[str, tuple[float, float]] = {}
    names = sorted({c for channels in problem.channels for c in channels})
    for channel in names:
        residuals, rates, shapes, uncertain, places = [], [], [], [], []
        for k, trial in enumerate(problem.trials):
            if channel not in problem.channels[k]:
                continue
            i = problem.channels[k].index(channel)
            values = problem.vector(theta, k)
            simulated = problem.model.simulate(values, trial)[channel]
            needs_rate = trial.stamps_uncertain or trial.time_sd_s > 0
            rate = (
                problem.model.sensitivity_to_time(values, trial)[channel]
                if needs_rate
                else np.zeros_like(simulated)
            )
            residuals.append(trial.measured[channel] - simulated)
            rates.append(np.abs(rate))
            known = np.broadcast_to(
                np.asarray(trial.value_sd.get(channel, 0.0), dtype=float), simulated.shape
            )
            shapes.append(np.sqrt(known**2 + (trial.time_sd_s * rate) ** 2))
            uncertain.append(trial.stamps_uncertain)
            places.append((k, i))
        constant, stamp = _components(residuals, rates, shapes, uncertain, previous.get(channel))
        found[channel] = (constant, stamp)
        for (k, i), shape, rate, free in zip(places, shapes, rates, uncertain, strict=True):
            if np.any(shape > 0):
                sd = np.maximum(shape, 0.05 * np.median(shape)) * (constant or 1e-15)
            else:
                sd = np.sqrt(constant**2 + (stamp * rate) ** 2) if free else np.full(len(rate), constant)
            problem.sd[k][i] = np.maximum(
                sd, 1e-12 * max(1e-6, np.nanmax(np.abs(problem.trials[k].measured[channel])))
            )
    return found


def _components(
    residuals: list[Array],
    rates: list[Array],
    shapes: list[Array],
    uncertain: list[bool],
    previous: tuple[float, float] | None,
) -> tuple[float, float]:
    """Standard deviations of value and stamp; the first is a factor where the shape is known."""
    r = np.concatenate(residuals)
    there = np.isfinite(r)
    shape = np.concatenate(shapes)
    if np.any(shape > 0):
        floor = np.where(shape > 0, np.maximum(shape, 0.05 * np.median(shape[shape > 0])), 1.0)
        return float(np.sqrt(np.mean((r[there] / floor[there]) ** 2))), 0.0
    square = r[there] ** 2
    if not any(uncertain):
        return float(np.sqrt(np.mean(square))), 0.0
    rate2 = np.concatenate([q**2 if u else np.zeros_like(q) for q, u in zip(rates, uncertain, strict=True)])[
        there
    ]
    variance = np.full(len(square), max(float(np.mean(square)), 1e-300))
    if previous is not None:
        variance = np.maximum(previous[0] ** 2 + previous[1] ** 2 * rate2, 1e-3 * variance)
    design = np.column_stack((np.ones_like(rate2), rate2)) / variance[:, None]
    size = np.linalg.norm(design, axis=0)
    size[size == 0] = 1.0
    parts = optimize.nnls(design / size, square / variance)[0] / size
    # neither part may vanish altogether: a sample with no error would outweigh all others
    least = 1e-4 * float(np.mean(square))
    return math.sqrt(max(float(parts[0]), least)), math.sqrt(max(float(parts[1]), 0.0))


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
    """Autoregression of the weighted residuals, pooled over trials, by channel; empty where white.

    Parameters
    ----------
    residuals : list of ndarray
        Weighted residuals of each trial, as :meth:`Problem.trial_residuals` gives them.
    """
    parts: dict[str, list[Array]] = {}
    for k, values in enumerate(residuals):
        at = 0
        for channel, mask in zip(problem.channels[k], problem.masks[k], strict=True):
            series = np.full(len(mask), np.nan)
            series[mask] = values[at : at + int(mask.sum())]
            at += int(mask.sum())
            parts.setdefault(channel, []).append(series)
    found = {}
    for channel, series_list in parts.items():
        x = joined(series_list, gap=30)
        if np.isfinite(x).sum() < 12 or np.nanstd(x) == 0:
            found[channel] = np.empty(0)
            continue
        longest = max(len(s) for s in series_list)
        fitted = fit_autoregression(x, max_order=max(1, min(25, longest // 5)))
        found[channel] = fitted.coefficients
    return found
