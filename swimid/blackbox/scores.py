"""How well a fitted model does: errors on every set of records, and residual tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from swimid.blackbox import difference, prediction
from swimid.blackbox.arx import Estimate
from swimid.blackbox.difference import Record
from swimid.errors import NoTrustworthyResult
from swimid.fitting import residual_tests as rt
from swimid.fitting.metrics import Score, score


@dataclass(frozen=True)
class Scores:
    """Errors on one set of records.

    Attributes
    ----------
    one_step, k_step, free_run : metrics.Score
    strict : metrics.Score or None
        The free run at the level the fitted part predicts, where all else is about the data's
        own level.
    level : float
        That own level less the predicted one, unit of the output.
    diverged : bool
    horizons : list of (int, float)
        RMSE over the prediction horizon.
    """

    one_step: Score
    k_step: Score
    free_run: Score
    strict: Score | None
    level: float
    diverged: bool
    horizons: list[tuple[int, float]]

    def as_dict(self, unit: str, steps: int) -> dict[str, Any]:
        """As the parameter file holds it."""
        block: dict[str, Any] = {
            "one_step": self.one_step.as_dict(unit),
            "k_step": {"steps": steps, **self.k_step.as_dict(unit)},
            "free_run": {**self.free_run.as_dict(unit), "diverged": self.diverged},
        }
        if self.strict is not None:
            block["free_run"]["level_shift"] = self.level
            block["free_run"]["at_predicted_level"] = self.strict.as_dict(unit)
        return block


def _check_long(records: list[Record], found: Estimate) -> int:
    """Length of the longest record, which the model's memory must fit into."""
    longest = max((len(r) for r in records), default=0)
    if longest <= found.orders.lag:
        raise NoTrustworthyResult(
            f"a held-out part has {longest} samples, the model looks back over {found.orders.lag}",
            hint="hold out a larger share, or validate on a longer log",
        )
    return longest


def scores(records: list[Record], found: Estimate, poles: list[difference.Pole], horizon: int) -> Scores:
    """Errors one step ahead, ``horizon`` steps ahead and in free run.

    Raises
    ------
    NoTrustworthyResult
        When the records are shorter than the model looks back.
    """
    steps = sorted({1, 2, 5, 10, 20, 50, 100, horizon})
    longest = _check_long(records, found)
    steps = [s for s in steps if s in (1, horizon) or s < longest // 4]
    errors = prediction.horizon_errors(records, found.orders, found.theta, steps)
    by_step = dict(zip(steps, errors, strict=True))
    measured = np.concatenate([r.output for r in records])
    runs = [difference.simulate(r, found.orders, found.theta) for r in records]
    simulated = np.concatenate(runs)
    free = score(measured, simulated)
    at_risk = any(p.unstable or p.integrating for p in poles)
    gave_up = any(
        np.isfinite(r.source[np.isfinite(run).nonzero()[0][-1] + 1 :]).any()
        for r, run in zip(records, runs, strict=True)
        if np.isfinite(run).any() and not np.isfinite(run[-1])
    )
    diverged = bool((gave_up and at_risk) or (at_risk and free.fit_percent < 0))
    return Scores(
        by_step[1],
        by_step[horizon],
        free,
        None,
        0.0,
        diverged,
        [(s, by_step[s].rmse) for s in steps],
    )


def pooled(sets: list[list[Record]], found: Estimate) -> Score:
    """Free-run score over several sets of records together."""
    records = [r for records in sets for r in records]
    runs = [difference.simulate(r, found.orders, found.theta) for r in records]
    return score(np.concatenate([r.output for r in records]), np.concatenate(runs))


def about_own_level(
    records: list[Record], found: Estimate, poles: list[difference.Pole], horizon: int
) -> tuple[list[Record], Scores]:
    """Held-out records about their own level, with their errors there and at the predicted level."""
    _check_long(records, found)
    strict = score(
        np.concatenate([r.output for r in records]),
        np.concatenate([difference.simulate(r, found.orders, found.theta) for r in records]),
    )
    moved, level = prediction.about_own_level(records, found.orders, found.theta)
    return moved, replace(scores(moved, found, poles, horizon), strict=strict, level=level)


@dataclass(frozen=True)
class Tests:
    """Residual tests on the fit part."""

    __test__ = False

    autocorrelation: rt.Correlation
    cross: rt.Correlation
    white: rt.TestResult
    independent: rt.TestResult


def tests(fit: list[Record], found: Estimate) -> Tests:
    """Test the residuals of the fitted part."""
    lags = rt.default_lags(len(found.data))
    gap = 2 * lags + found.orders.lag
    residuals = rt.joined([_on_record(found, i, r) for i, r in enumerate(fit)], gap=gap)
    source = rt.joined([r.source for r in fit], gap=gap)
    return Tests(
        rt.autocorrelation(residuals, max_lag=lags),
        rt.cross_correlation(residuals, source, max_lag=lags),
        found.whiteness,
        rt.independence(residuals, source, lags=lags, first=found.orders.nk),
    )


def _on_record(found: Estimate, index: int, record: Record) -> np.ndarray:
    values = np.full(len(record), np.nan)
    mine = found.data.record == index
    values[found.data.sample[mine]] = found.residuals[mine]
    return values
