"""Identification of an ARX or ARMAX model: working point, orders, estimate, and prediction errors.

A model without a constant term describes deviations from a working point. If data are recorded around a
working point (20 degrees, half throttle), the means must be subtracted. If data obey the model without a
constant term, they must not be changed. Predictions are one step ahead, and the free run (simulation), which
uses no measured output after its start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from swimid.blackbox import difference
from swimid.blackbox.arx import (
    EXACT,
    ArxEstimate,
    Regression,
    check_enough,
    covariance,
    errors_and_gradient,
    estimate,
    find_directions,
    regression,
)
from swimid.blackbox.difference import INTEGRATING, Orders, Pole, Record, best_level, simulate_all
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import Data
from swimid.errors import NoTrustworthyResult
from swimid.fitting import uncertainty as rt
from swimid.fitting.fit_common import Score, score
from swimid.notices import Progress, silent, warn

#: Minimum |t| of the constant term at which the working point is subtracted without further conditions.
CLEAR_T = 5.0
#: Minimum |t| of the constant term at which the working point is subtracted if this improves the free run by
#: :data:`CLEAR_GAIN`. Data that need no constant term reach both thresholds by chance in less than one of a
#: hundred records, also for slow systems.
LIKELY_T = 3.5
#: Minimum |t| of the constant term at which the working point is subtracted if the output is far from zero
#: and the free run improves at all. A missing constant term then biases the other coefficients (a spurious
#: pole at 1), so that the |t| of the constant term is small.
WEAK_T = 2.0
#: Minimum relative reduction of the root-mean-square error of the free run that counts as a clear
#: improvement.
CLEAR_GAIN = 0.1
#: Minimum ratio of the absolute mean of the output to its standard deviation, for an output that is far from
#: zero.
FAR = 3.0
#: Maximum ratio of the root-mean-square error of the free run on held-out data to that on the fitted data
#: (SWM015).
MAX_RATIO = 2.0


@dataclass(frozen=True)
class WorkingPoint:
    """Means that are subtracted from input and output; zero if none are subtracted."""

    source: float
    output: float
    #: Constant term of the regression divided by its standard error.
    t: float
    removed: bool


def find_working_point(records: Sequence[Record], orders: Orders, mode: str = "auto") -> WorkingPoint:
    """Decide whether the means of the fitted records must be subtracted.

    Parameters
    ----------
    mode : {"auto", "none", "mean"}
        ``none`` never subtracts the means, ``mean`` always does. ``auto`` subtracts them in four cases, where
        t is the t value of a constant term that is fitted together with A and B. (1) |t| is above
        :data:`CLEAR_T`. (2) |t| is above :data:`LIKELY_T`, and the free run improves by :data:`CLEAR_GAIN`.
        (3) The mean of the output is more than :data:`FAR` standard deviations from zero, and the free run
        improves by :data:`CLEAR_GAIN`, or at all if |t| is above :data:`WEAK_T`. (4) The mean of the output
        is that far from zero, and a pole at 1 disappears.

    Raises
    ------
    NoTrustworthyResult
        There are not more rows than coefficients, or the output is constant.
    """
    data = regression(records, replace(orders, nc=0))
    check_enough(data, orders)
    source = float(np.nanmean(np.concatenate([r.source for r in records])))
    output = float(np.nanmean(np.concatenate([r.output for r in records])))
    constant, t = constant_term(data)
    point = WorkingPoint(source, output, t, True)
    removed = mode != "none"
    if mode == "auto":
        size = abs(t) * bool(abs(constant) > EXACT * np.sqrt(np.mean(data.outputs**2)))
        far = bool(abs(point.output) > FAR * np.std(data.outputs))
        removed = size > CLEAR_T
        if not removed and (far or size > LIKELY_T):
            removed = _helps(records, orders, point, far=far, likely=size > WEAK_T)
    if not removed:
        return WorkingPoint(0.0, 0.0, t, False)
    return point


def _helps(
    records: Sequence[Record], orders: Orders, point: WorkingPoint, *, far: bool, likely: bool
) -> bool:
    """Return whether subtracting the means improves the free run, or removes a spurious pole at 1.

    Parameters
    ----------
    far, likely : bool
        Whether the output is far from zero, and whether a constant term is likely.
    """
    plain = replace(orders, nc=0)
    rms, largest = [], []
    for part in (records, shifted(records, point)):
        data = regression(part, plain)
        theta = np.linalg.lstsq(data.rows, data.outputs, rcond=None)[0]
        errors = np.subtract(*simulate_all(part, plain, theta))
        rms.append(float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else np.inf)
        roots = np.roots([1.0, *theta[: orders.na]])
        largest.append(float(np.max(np.abs(roots), initial=0.0)))
    if far and largest[0] > INTEGRATING >= largest[1]:
        return True
    return rms[1] < rms[0] * (1.0 - CLEAR_GAIN * (not (far and likely)))


def constant_term(data: Regression) -> tuple[float, float]:
    """Return the constant term that is fitted together with A and B, and its t value.

    They are NaN and 0 if the data do not determine the constant term.
    """
    n, p = data.rows.shape
    rows = np.hstack((data.rows, np.ones((n, 1))))
    if n <= p + 1 or not find_directions(rows, np.zeros(p + 1)).determined[-1]:
        return float("nan"), 0.0
    theta = np.linalg.lstsq(rows, data.outputs, rcond=None)[0]
    residuals = data.outputs - rows @ theta
    white = rt.ljung_box(data.on_grid(residuals, gap=rt.default_lags(n))).passed
    spread, _ = covariance(rows, residuals, np.ones(n), 0.0, data, robust=not white)
    constant, stderr = float(theta[-1]), float(np.sqrt(max(spread[-1, -1], 0.0)))
    if stderr > 0:
        return constant, constant / stderr
    return constant, 0.0 if constant == 0 else float("inf")


def shifted(records: Sequence[Record], point: WorkingPoint) -> list[Record]:
    """Return the records as deviations from a working point."""
    if not point.removed:
        return list(records)
    return [replace(r, source=r.source - point.source, output=r.output - point.output) for r in records]


def predict(record: Record, orders: Orders, theta: np.ndarray) -> np.ndarray:
    """Return the prediction one sample ahead, shape (n,); NaN where a sample that it needs is missing."""
    data = regression([record], orders)
    errors, _ = errors_and_gradient(theta, data.rows, data.outputs, data.fresh, orders.nc)
    predicted = np.full(len(record), np.nan)
    predicted[data.sample] = data.outputs - errors
    return predicted


def about_own_level(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[list[Record], float]:
    """Return records relative to the output level that minimises the free-run error, and this level.

    Held-out data can have another working point than the fitted data. The level is subtracted from all
    outputs, also from those that start the free run.
    """
    measured, run = simulate_all(records, orders, theta)
    _, raised = simulate_all([replace(r, output=r.output - 1.0) for r in records], orders, theta)
    level = best_level(measured, run, raised + 1.0)
    return [replace(r, output=r.output - level) for r in records], level


@dataclass(frozen=True)
class Scores:
    """Prediction errors on one set of records: one step ahead, and free run."""

    one_step: Score
    free_run: Score
    #: Whether the model is not stable and its free run diverges from the data.
    diverged: bool
    #: Output level of these records, relative to the level of the fitted data.
    level: float = 0.0
    #: Free-run error at the output level of the fitted data. The other errors are computed at the output
    #: level of the records themselves.
    strict: Score | None = None

    def as_dict(self, unit: str) -> dict[str, Any]:
        """Return the errors in the form in which the parameter file contains them."""
        free = {**self.free_run.as_dict(unit), "diverged": self.diverged}
        if self.strict is not None:
            free |= {"level_shift": self.level, "at_predicted_level": self.strict.as_dict(unit)}
        return {"one_step": self.one_step.as_dict(unit), "free_run": free}


def score_records(records: list[Record], model: ArxEstimate, poles: list[Pole]) -> Scores:
    """Return the prediction errors one step ahead and of the free run.

    Raises
    ------
    NoTrustworthyResult
        No record has more samples than the past samples that the model needs.
    """
    orders, theta = model.orders, model.theta
    longest = max((len(r) for r in records), default=0)
    if longest <= orders.lag:
        raise NoTrustworthyResult(
            f"a held-out part has {longest} samples, the model needs {orders.lag} past ones",
            hint="hold out a larger share, or validate on a longer log",
        )
    runs = [difference.simulate(r, orders, theta) for r in records]
    measured = np.concatenate([r.output for r in records])
    one = score(measured, np.concatenate([predict(r, orders, theta) for r in records]))
    free = score(measured, np.concatenate(runs))
    stopped = False
    for record, run in zip(records, runs, strict=True):
        last = np.flatnonzero(np.isfinite(run))[-1:]
        stopped |= bool(len(last) and np.isfinite(record.source[last[0] + 1 :]).any())
    at_risk = any(pole.state != "stable" for pole in poles)
    return Scores(one, free, bool(at_risk and (stopped or free.fit_percent < 0)))


@dataclass(frozen=True)
class Identified:
    """Identified model with its data and prediction errors. Records are relative to the working point."""

    options: RwlsOptions
    data: Data
    point: WorkingPoint
    fit: list[Record]
    #: Held-out records by the name of the data. If a working point was subtracted, they are relative to their
    #: own output level.
    held_out: Mapping[str, list[Record]]
    estimate: ArxEstimate
    #: Poles of the model, the largest magnitude first.
    poles: list[Pole]
    fit_scores: Scores
    #: Prediction errors on the held-out data, by the name of the data.
    scores: Mapping[str, Scores]
    #: Orders of the order search with their BIC, lowest first; empty without a search.
    candidates: Sequence[tuple[Orders, float]]

    @property
    def kind(self) -> str:
        """Kind of the model: ``ARX``, or ``ARMAX`` if it has a noise polynomial."""
        return "ARMAX" if self.estimate.orders.nc else "ARX"

    @cached_property
    def residual_series(self) -> tuple[np.ndarray, np.ndarray, int]:
        """One-step residuals and input of the fitted records on one time grid, and number of lags to test."""
        data, lags = self.estimate.data, rt.default_lags(len(self.estimate.data))
        gap = 2 * lags + self.estimate.orders.lag
        source = rt.joined([r.source for r in self.fit], gap=gap)
        return data.on_grid(self.estimate.residuals, gap=gap), source, lags

    @cached_property
    def independent(self) -> rt.TestResult:
        """Test of the hypothesis that the residuals are independent of past inputs."""
        residuals, source, lags = self.residual_series
        return rt.independence(residuals, source, lags=lags, first=self.estimate.orders.nk)

    @property
    def worse(self) -> list[str]:
        """Names of the held-out data whose free-run error exceeds :data:`MAX_RATIO` times that of the fit."""
        limit = MAX_RATIO * self.fit_scores.free_run.rmse
        return [name for name, s in self.scores.items() if s.free_run.rmse > limit]

    @property
    def critical_pole(self) -> Pole | None:
        """Pole that determines the stability: an unstable one, else an integrating one, else the largest."""
        states = ("unstable", "integrating", "stable")
        return min(self.poles, key=lambda pole: states.index(pole.state), default=None)


def identify(data: Data, options: RwlsOptions, progress: Progress) -> Identified:
    """Choose the orders if they are not given, fit the model, and compute its prediction errors.

    Raises
    ------
    NoTrustworthyResult
        The errors of :func:`swimid.blackbox.arx.estimate`.
    """
    candidates: list[tuple[Orders, float]] = []
    if options.na is None or options.nb is None:
        candidates = _search(data, options, progress)
        orders = replace(candidates[0][0], nc=options.nc)
    else:
        orders = Orders(options.na, options.nb, 1 if options.nk is None else options.nk, options.nc)
    point = find_working_point(data.fit, orders, options.centre)
    fit = shifted(data.fit, point)
    fitted = estimate(
        fit,
        orders,
        weight=options.weight,
        forgetting=options.forgetting,
        prior_scale=options.prior_scale,
    )
    a, _, _ = orders.split(fitted.theta)
    poles = difference.poles(a, fitted.covariance[: orders.na, : orders.na], data.sample_time_s)
    held, scores = {}, {}
    for name, part in data.held_out.items():
        held[name] = shifted(part, point)
        scores[name] = score_records(held[name], fitted, poles)
        if point.removed:
            strict = scores[name].free_run
            held[name], level = about_own_level(held[name], orders, fitted.theta)
            own = score_records(held[name], fitted, poles)
            scores[name] = replace(own, level=level, strict=strict)
    fit_scores = score_records(fit, fitted, poles)
    return Identified(options, data, point, fit, held, fitted, poles, fit_scores, scores, candidates)


def _search(data: Data, options: RwlsOptions, progress: Progress) -> list[tuple[Orders, float]]:
    """Rank the orders of the search grid by BIC; warn if the best orders lie at the edge of the grid."""
    largest = options.max_order
    delays = range(options.max_nk + 1)
    if options.nk is not None:
        delays = range(options.nk, options.nk + 1)
    point = find_working_point(data.fit, Orders(largest, largest), options.centre)
    candidates = search_orders(shifted(data.fit, point), largest, delays, progress=progress)
    best = candidates[0][0]
    edge = {name: "--max-order" for name in ("na", "nb") if getattr(best, name) == largest}
    if options.nk is None and best.nk == options.max_nk > 0:
        edge["nk"] = "--max-nk"
    if edge:
        flags = ", ".join(dict.fromkeys(edge.values()))
        warn(
            "SWM023",
            f"the order chosen ({best}) is the largest tried in {', '.join(edge)} (tried: na 0 to {largest}, "
            f"nb 1 to {largest}, nk {delays[0]} to {delays[-1]}): widen the grid with {flags}",
        )
    return candidates


def search_orders(
    records: Sequence[Record], largest: int, delays: range, *, progress: Progress = silent
) -> list[tuple[Orders, float]]:
    """Rank ARX models with na from 0 to ``largest``, nb from 1 to ``largest`` and nk in ``delays``.

    Returns
    -------
    list of (Orders, float)
        Orders and Bayesian information criterion (BIC) ``n ln(RSS / n) + p ln n``, lowest first. If criteria
        are equal, the model with fewer coefficients is first.

    Raises
    ------
    NoTrustworthyResult
        There are too few rows, or the output is constant.

    Notes
    -----
    All models are fitted to the same n rows, which are complete for the longest lags of the grid, so that the
    criteria can be compared. All fits use one QR decomposition, that of the regression with all lags.
    """
    widest = Orders(largest, delays[-1] + largest, 0)
    data = regression(records, widest)
    check_enough(data, widest)
    n = len(data)
    factor = np.asarray(np.linalg.qr(np.column_stack((data.rows, data.outputs)), mode="r"))
    # without this minimum, noise-free data would always favour more coefficients
    floor = max(n * (EXACT * float(np.std(data.outputs))) ** 2, float(np.finfo(float).tiny))
    grid = list(product(range(largest + 1), range(1, largest + 1), delays))
    found = []
    with progress("trying orders", total=len(grid)) as step:
        for na, nb, nk in grid:
            chosen = [*range(na), *range(largest + nk, largest + nk + nb)]
            theta = np.linalg.lstsq(factor[:, chosen], factor[:, -1], rcond=None)[0]
            rss = float(np.sum((factor[:, -1] - factor[:, chosen] @ theta) ** 2))
            bic = n * float(np.log(max(rss, floor) / n)) + float(np.log(n)) * (na + nb)
            found.append((Orders(na, nb, nk), bic))
            step()
    return sorted(found, key=lambda one: (one[1], one[0].count, one[0].nk))
