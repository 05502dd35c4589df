"""How large the noise is, without asking the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.diagnosis.bench import Bench, Fit
from swimid.diagnosis.folds import setting
from swimid.models.base import Array

#: Third differences of white noise have this variance.
THIRD = 20.0


def split(fit: Fit, k: int, residual: Array) -> dict[str, Array]:
    """A trial's stacked weighted residual by channel, in the channels' units; NaN where missing."""
    found, at = {}, 0
    for i, (channel, mask) in enumerate(zip(fit.problem.channels[k], fit.problem.masks[k], strict=True)):
        count = int(mask.sum())
        series = np.full(len(mask), np.nan)
        series[mask] = residual[at : at + count] * fit.problem.sd[k][i][mask]
        at += count
        found[channel] = series
    return found


def repeats(bench: Bench) -> list[list[int]]:
    """Trials of one setting, where there are several."""
    groups: dict[str, list[int]] = {}
    for k, trial in enumerate(bench.trials):
        groups.setdefault(setting(trial), []).append(k)
    return [g for g in groups.values() if len(g) > 1]


def floors(bench: Bench, fit: Fit, bare: Sequence[Array]) -> tuple[dict[str, float], dict[str, float], str]:
    """Noise of each channel, in its unit.

    Parameters
    ----------
    fit : Fit
        Nominal, refitted.
    bare : sequence of ndarray
        Weighted residuals of a saturated fit.

    Returns
    -------
    floor : dict of channel to float
        What no model of these trials can get below: from repeats of one setting where there are some (what
        two of them do not share), else what a saturated description leaves.
    rough : dict of channel to float
        Of it, what changes from sample to sample (third differences).
    how : str
    """
    saturated: dict[str, list[Array]] = {}
    rough_parts: dict[str, list[Array]] = {}
    for k, residual in enumerate(bare):
        for channel, series in split(fit, k, residual).items():
            saturated.setdefault(channel, []).append(series[np.isfinite(series)])
            third = np.diff(series, 3)
            rough_parts.setdefault(channel, []).append(third[np.isfinite(third)])
    floor = {c: float(np.sqrt(np.mean(np.concatenate(p) ** 2))) for c, p in saturated.items()}
    rough = {}
    for channel, parts in rough_parts.items():
        values = np.concatenate(parts)
        rough[channel] = (
            float(1.4826 * np.median(np.abs(values)) / np.sqrt(THIRD)) if len(values) > 10 else floor[channel]
        )
    groups = repeats(bench)
    if not groups or all(len(r) < 20 for r in bare):
        return floor, rough, "what a saturated description of the residuals leaves"
    between: dict[str, list[Array]] = {}
    for group in groups:
        parts = [split(fit, k, fit.residuals[k]) for k in group]
        for channel in parts[0]:
            n = min(len(p[channel]) for p in parts if channel in p)
            stack = np.array([p[channel][:n] for p in parts if channel in p])
            if len(stack) > 1:
                with np.errstate(all="ignore"):
                    spread = np.nanvar(stack, axis=0, ddof=1)
                between.setdefault(channel, []).append(spread[np.isfinite(spread)])
    for channel, variances in between.items():
        values = np.concatenate(variances)
        if len(values) > 20:
            # repeats that differ by more than a saturated fit leaves differ by chance, which no model explains
            floor[channel] = float(np.sqrt(np.mean(values)))
    return floor, rough, f"{sum(len(g) for g in groups)} repeats of {len(groups)} settings"
