"""Estimate the noise floor of each channel, which repeats of one setting limit."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from swimid.diagnosis.context import Fit, FitContext, beyond
from swimid.diagnosis.noise_model import NoiseModel
from swimid.diagnosis.random_effects import LEVEL
from swimid.diagnosis.settings import repeated
from swimid.fitting.model import Array

#: Minimum number of samples in the longest trial for a noise floor from repeats.
MIN_SAMPLES = 20


def split(fit: Fit, k: int, residual: Array) -> dict[str, Array]:
    """Split the stacked weighted residuals of a trial into one series for each channel, in its unit.

    The series are NaN where the channel has no sample.
    """
    found = {}
    for (channel, mask, part), sd in zip(fit.problem.by_channel(k, residual), fit.problem.sd[k], strict=True):
        found[channel] = np.full(len(mask), np.nan)
        found[channel][mask] = part * sd[mask]
    return found


def repeats(context: FitContext) -> list[list[int]]:
    """Return the indices of the trials at each setting that was repeated.

    A recording that is given twice counts once. Repeats have the same setting, but need not have different
    samples: an encoder logs the same positions in every drop, at other times.
    """
    groups: dict[str, list[int]] = {}
    seen: set[tuple[str, ...]] = set()
    for k, trial in enumerate(context.trials):
        setting = repeated(trial)
        samples = ("", trial.time_s), *sorted(trial.measured.items())
        recording = (setting, *(f"{name} {values.tobytes()!r}" for name, values in samples))
        if recording not in seen:
            groups.setdefault(setting, []).append(k)
        seen.add(recording)
    return [g for g in groups.values() if len(g) > 1]


def nuisance_residuals(fit: Fit, residuals: Sequence[Array], random_effects: Sequence[Array]) -> list[Array]:
    """Return weighted residuals after a fit of initial state, trims, gains and clock to each trial.

    Parameters
    ----------
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals before this fit.
    random_effects : sequence of ndarray, shape (n_k, q)
        Weighted changes of each trial by the q quantities that may differ between trials.

    Returns
    -------
    list of ndarray, shape (n_k,)
        Residuals of the fit. A trial with too few samples keeps its residuals.
    """
    found = []
    for k, r in enumerate(residuals):
        columns = np.column_stack((fit.own(k), random_effects[k]))
        found.append(beyond(columns, r) if len(r) >= 4 * columns.shape[1] + 20 else r)
    return found


def by_channel(fit: Fit, residuals: Sequence[Array]) -> dict[str, Array]:
    """Return the residuals of all trials by channel, in the channel's unit."""
    parts: dict[str, list[Array]] = {}
    for k, r in enumerate(residuals):
        for channel, series in split(fit, k, r).items():
            parts.setdefault(channel, []).append(series[np.isfinite(series)])
    return {c: np.concatenate(p) for c, p in parts.items()}


def measured(context: FitContext, fit: Fit) -> dict[str, Array]:
    """Return the measured samples of all trials by channel, in the channel's unit."""
    parts: dict[str, list[Array]] = {}
    for k, trial in enumerate(context.trials):
        for channel, mask in zip(fit.problem.channels[k], fit.problem.masks[k], strict=True):
            parts.setdefault(channel, []).append(trial.measured[channel][mask])
    return {c: np.concatenate(p) for c, p in parts.items()}


def rms(values: Array) -> float:
    """Return the root mean square of an array."""
    return float(np.sqrt(np.mean(values**2)))


def excess(fit: Fit, residuals: Sequence[Array], floor: Mapping[str, float]) -> dict[str, float]:
    """Return for each channel the sum of squared residuals minus that of the noise, in noise variances."""
    found = by_channel(fit, residuals)
    more = {c: float(np.sum((v / max(floor[c], 1e-300)) ** 2 - 1.0)) for c, v in found.items()}
    return {c: m if m > 1e-9 * len(found[c]) else 0.0 for c, m in more.items()}


@dataclass(frozen=True)
class Floor:
    """Noise floor of each channel: the root-mean-square error that noise and between-trial variation cause.

    Attributes
    ----------
    levels : dict of channel to float
        Noise floor, in the channel's unit. It is the noise within trials (without the fraction that has
        structure) together with the random effects. It is never larger than the residuals of the model
        without random effects. It includes the noise that fitted parameters absorb (:func:`taken_up`). If
        settings are repeated, its between-trial variance is at most that of the repeats (upper 95 %
        confidence bound).
    inside : dict of channel to float
        Noise floor without the noise that fitted parameters absorb, for comparison with residuals of the fit.
    within : dict of channel to float
        Noise floor without between-trial variation.
    squares : dict of channel to dict of trial to (float, int)
        Contribution of each trial to the squared noise floor (up to a common factor), and number of samples
        of the trial.
    how : str
        Text that states from which data the noise floor was computed.
    repeated : bool
        Whether the noise floor was computed from repeated trials at one setting.
    """

    levels: dict[str, float]
    inside: dict[str, float]
    within: dict[str, float]
    squares: dict[str, dict[str, tuple[float, int]]]
    how: str
    repeated: bool = False

    def of_trials(self, channels: Collection[str]) -> dict[str, float]:
        """Return the mean squared noise of each fitted trial, divided by that of all fitted trials.

        It is the mean over the samples of the channels, each in units of its own noise variance.
        """
        sums: dict[str, Array] = {}
        for each in (self.squares[c] for c in channels if c in self.squares):
            total, count = np.sum(list(each.values()), axis=0)
            for trial, (squared, samples) in each.items():
                own = np.array([squared * count / max(total, 1e-300), samples])
                sums[trial] = sums.get(trial, 0.0) + own
        return {trial: float(squared / samples) for trial, (squared, samples) in sums.items() if samples}

    def of_held_out(self, chance: Mapping[str, float]) -> dict[str, float]:
        """Return the noise floor of held-out trials, by channel.

        Parameters
        ----------
        chance : mapping of channel to float
            Mean square of the between-trial variation in these trials, in the channel's unit squared. It
            replaces the between-trial variation of the fitted trials.
        """
        return {
            c: math.hypot(self.within[c], math.sqrt(chance[c])) if c in chance else v
            for c, v in self.levels.items()
        }


def _mean_squares(fit: Fit, residuals: Sequence[Array]) -> dict[str, float]:
    return {c: float(np.mean(v**2)) for c, v in by_channel(fit, residuals).items()}


def taken_up(context: FitContext, fit: Fit, noise_model: NoiseModel) -> dict[str, float]:
    """Return for each channel the factor of the noise variance that corrects for absorbed noise.

    A fit absorbs part of the noise in its parameters, so that its residuals are smaller than the noise.

    Let h be the leverage of a fold. The expected squared residuals of the fold are 1 - h times the noise
    variance if the fold is fitted, and 1 / (1 - h) times the noise variance if the fold is held out (deletion
    residuals). The noise variance is the geometric mean of the two.

    References
    ----------
    R. D. Cook, S. Weisberg, *Residuals and Influence in Regression*, 1982, section 2.2.
    """
    inside, outside = [np.zeros_like(r) for r in fit.residuals], [np.zeros_like(r) for r in fit.residuals]
    for f, theta in enumerate(context.without_each(fit, noise_model)):
        for k, r in enumerate(fit.residuals):
            mine = context.folds.owner[k] == f
            if not np.any(mine):
                continue
            missed = fit.problem.trial_residuals(theta, k)
            own = fit.own(k)
            inside[k][mine], outside[k][mine] = (
                (beyond(own, v) if context.folds.whole else v)[mine] for v in (r, missed)
            )
    first, second = _mean_squares(fit, inside), _mean_squares(fit, outside)
    return {c: max(float(np.sqrt(second[c] / max(first[c], 1e-300))), 1.0) for c in first}


def floors(
    context: FitContext,
    last: Fit,
    residuals: Sequence[Array],
    share: float,
    alike: Fit,
    noise_model: NoiseModel,
    drifting: Mapping[str, float] | None = None,
) -> Floor:
    """Return the noise floor of each channel, the smallest error that a model of these trials can have.

    Parameters
    ----------
    last : Fit
        The model with all causes.
    residuals : sequence of ndarray, shape (n_k,)
        Weighted residuals of ``last`` without between-trial variation.
    share : float
        Fraction of the squared whitened residuals of ``last`` that smooth terms without physics still
        explain.
    alike : Fit
        The model with all causes, refitted without random effects.
    noise_model : NoiseModel
        Noise model for refits of ``alike`` without each fold.
    drifting : mapping of channel to float, optional
        Fraction of the noise variance that is drift in these channels, and does not count as noise.
    """
    drifting = drifting or {}
    rest = max(1.0 - share, 0.05)
    marginal_residuals = last.marginal_residuals()
    kinds = (residuals, last.residuals, marginal_residuals)
    noise, known, whole = (_mean_squares(last, r) for r in kinds)
    squares: dict[str, dict[str, tuple[float, int]]] = {}
    for k, trial in enumerate(context.trials):
        inner, bare, outer = (split(last, k, r[k]) for r in kinds)
        for c, series in outer.items():
            summed = rest * np.nansum(inner[c] ** 2) + max(np.nansum(series**2 - bare[c] ** 2), 0.0)
            squares.setdefault(c, {})[trial.id] = float(summed), int(np.isfinite(series).sum())
    reached = _mean_squares(alike, alike.residuals)
    more = taken_up(context, alike, noise_model)
    model = {c: min(rest * noise[c] + max(whole[c] - known[c], 0.0), whole[c], reached[c]) for c in noise}
    how = "the noise that the model with all that was found leaves, and what differs from trial to trial"
    chance, degrees, told = _between_repeats(context, last, marginal_residuals)
    left = {c: float(np.sqrt(1.0 - drifting.get(c, 0.0))) for c in model}

    def level(c: str, times: float) -> float:
        smallest = times * model[c]
        if c in chance:
            inner = min(rest * noise[c], chance[c])
            most = inner + (chance[c] - inner) * degrees / float(special.chdtri(degrees, LEVEL))
            smallest = min(smallest, times * most)
        return left[c] * float(np.sqrt(smallest))

    levels = {c: level(c, more[c]) for c in model}
    within = {c: min(left[c] * float(np.sqrt(more[c] * rest * v)), levels[c]) for c, v in noise.items()}
    return Floor(levels, {c: level(c, 1.0) for c in model}, within, squares, told or how, told is not None)


def _between_repeats(
    context: FitContext, last: Fit, residuals: Sequence[Array]
) -> tuple[dict[str, float], int, str | None]:
    """Return for each channel the variance between repeats, its degrees of freedom, and a text.

    Repeats are trials at the same setting. The result is empty if there are no repeats, or too few samples in
    every trial. The degrees of freedom are those of the between-trial variation.
    """
    groups = repeats(context)
    if not groups or all(len(r) < MIN_SAMPLES for r in last.residuals):
        return {}, 0, None
    parts: dict[str, list[Array]] = {}
    for group in groups:
        series: dict[str, list[tuple[Array, Array]]] = {}
        for k in group:
            for channel, values in split(last, k, residuals[k]).items():
                there = np.isfinite(values)
                series.setdefault(channel, []).append((context.trials[k].time_s[there], values[there]))
        for channel, mine in series.items():
            if len(mine) > 1:
                parts.setdefault(channel, []).append(disagreement(mine))
    found = {c: float(np.mean(np.concatenate(v))) for c, v in parts.items() if any(map(len, v))}
    trials = sum(len(g) for g in groups)
    return found, trials - len(groups), f"{trials} repeats of {len(groups)} settings"


def disagreement(series: Sequence[tuple[Array, Array]]) -> Array:
    """Return the variance between repeats of a trial at the common times.

    The common times are the times of the first repeat within the time ranges of all others.

    The result has shape (n,). The other repeats are interpolated linearly. An interpolated sample is a
    weighted mean of two samples, and has less noise variance than each of them. The variance is therefore
    divided by the mean fraction of the noise variance that remains after interpolation.

    Parameters
    ----------
    series : sequence of (ndarray, ndarray), shapes (n_i,)
        Times (s, increasing) and values of each repeat.

    Examples
    --------
    >>> first = np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 0.0])
    >>> disagreement([first, (first[0], first[1] + 2.0)]).tolist()
    [2.0, 2.0, 2.0]
    """
    if any(len(t) < 2 for t, _ in series):
        return np.empty(0)
    begin, end = max(t[0] for t, _ in series), min(t[-1] for t, _ in series)
    at = series[0][0]
    at = at[(at >= begin) & (at <= end)]
    values, shares = [], []
    for time, own in series:
        after = np.clip(np.searchsorted(time, at, side="right"), 1, len(time) - 1)
        share = (at - time[after - 1]) / (time[after] - time[after - 1])
        values.append((1.0 - share) * own[after - 1] + share * own[after])
        shares.append((1.0 - share) ** 2 + share**2)
    return np.asarray(np.var(values, axis=0, ddof=1) / np.mean(shares, axis=0))
