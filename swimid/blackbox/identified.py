"""Identification of an ARX or ARMAX model: working point, orders, estimate, and errors of its predictions.

A model without a constant term describes deviations. Data recorded around a working point (20 degrees, half
throttle) need its means subtracted. Data that obey the model as they are must not be changed. The predictions
are one step ahead, several steps ahead, and the free run (simulation), which uses no output after its start.
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
from swimid.blackbox.difference import INTEGRATING, Orders, Pole, Record, best_level, lagged, simulate_all
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import Data
from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as rt
from swimid.fitting.metrics import Score, score
from swimid.notices import warn
from swimid.progress import Progress, silent

#: |t| of a constant term above which the working point is subtracted.
CLEAR_T = 5.0
#: Minimum |t| if the free run improves by :data:`CLEAR_GAIN`. Data that need no constant reach both less than
#: once in a hundred records by chance, also those of slow systems.
LIKELY_T = 3.5
#: Minimum |t| if the output is far from zero and the free run improves at all. A missing constant then biases
#: the other coefficients (a spurious pole at 1), so that its own t is small.
WEAK_T = 2.0
#: Minimum relative improvement of the free-run error.
CLEAR_GAIN = 0.1
#: Mean of the output, in its standard deviations, above which it is far from zero.
FAR = 3.0
#: Maximum ratio of the free-run error on held-out data to that on the fitted data (SWM015).
MAX_RATIO = 2.0
#: Maximum number of rows whose recursive estimates are kept.
MAX_KEPT = 1000


@dataclass(frozen=True)
class WorkingPoint:
    """Means subtracted from input and output, zero where none were."""

    source: float
    output: float
    #: Constant term of the regression over its standard error.
    t: float
    removed: bool


def find_working_point(records: Sequence[Record], orders: Orders, mode: str = "auto") -> WorkingPoint:
    """Decide whether the means of the fitted records must be subtracted.

    Parameters
    ----------
    mode : {"auto", "none", "mean"}
        ``none`` and ``mean`` never and always subtract them. ``auto`` does so in four cases. Two concern the
        constant term beside A and B: |t| above :data:`CLEAR_T`, or above :data:`LIKELY_T` while the free run
        improves by :data:`CLEAR_GAIN`. Two concern an output whose mean is more than :data:`FAR` standard
        deviations from zero: the free run improves by :data:`CLEAR_GAIN` (with |t| above :data:`WEAK_T`: at
        all), or a pole at 1 disappears.

    Raises
    ------
    NoTrustworthyResult
        When there are not more rows than coefficients, or the output is constant.
    """
    data = regression(records, replace(orders, nc=0))
    check_enough(data, orders)
    source, output = (float(np.nanmean(np.concatenate(part))) for part in _columns(records))
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


def _columns(records: Sequence[Record]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return [r.source for r in records], [r.output for r in records]


def _helps(
    records: Sequence[Record], orders: Orders, point: WorkingPoint, *, far: bool, likely: bool
) -> bool:
    """Return whether subtracting the means improves the free run, or removes a spurious integrator.

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
    """Return the constant term beside A and B, and that over its standard error.

    They are NaN and 0 where the data do not determine it.
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
    """Return the records relative to a working point."""
    if not point.removed:
        return list(records)
    return [replace(r, source=r.source - point.source, output=r.output - point.output) for r in records]


def predict(record: Record, orders: Orders, theta: np.ndarray, *, steps: int = 1) -> np.ndarray:
    """Return the prediction ``steps`` samples ahead, shape (n,).

    The input is known throughout. The output is known up to the sample at which the prediction is made, and
    the prediction is NaN where this output is missing.
    """
    a, b, c = orders.split(theta)
    driven = np.zeros(len(record))
    for j, value in enumerate(b):
        driven = driven + value * lagged(record.source, orders.nk + j)
    errors = np.zeros(len(record))  # zero where there is no complete row, as in the fit
    if orders.nc:
        data = regression([record], orders)
        found, _ = errors_and_gradient(theta, data.rows, data.outputs, data.fresh, orders.nc)
        errors[data.sample] = np.nan_to_num(found)
    recent: list[np.ndarray] = []  # the predictions 1, 2, ... steps before
    for ahead in range(1, steps + 1):
        total = driven.copy()
        known = [*recent, *[record.output] * orders.na]
        for i, value in enumerate(a, start=1):
            total -= value * lagged(known[i - 1], i)
        for i in range(ahead, orders.nc + 1):
            total += c[i - 1] * np.nan_to_num(lagged(errors, i))
        recent = [total, *recent][: max(orders.na, 1)]
    return recent[0]


def about_own_level(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[list[Record], float]:
    """Return records relative to the output level that minimises their free-run error, and that level.

    Held-out data can have a working point of their own. The free run starts from ``y - level``, too.
    """
    measured, run = simulate_all(records, orders, theta)
    _, raised = simulate_all([replace(r, output=r.output - 1.0) for r in records], orders, theta)
    level = best_level(measured, run, raised + 1.0)
    return [replace(r, output=r.output - level) for r in records], level


@dataclass(frozen=True)
class Scores:
    """Errors of the predictions on one set of records."""

    one_step: Score
    k_step: Score
    free_run: Score
    #: Whether the free run of a model that is not stable leaves the data.
    diverged: bool
    #: Own output level of the records, relative to that of the fitted part.
    level: float = 0.0
    #: Error of the free run at the level of the fitted part; the other errors are about the own level.
    strict: Score | None = None

    def as_dict(self, unit: str, steps: int) -> dict[str, Any]:
        """Return the errors as the parameter file contains them."""
        free = {**self.free_run.as_dict(unit), "diverged": self.diverged}
        if self.strict is not None:
            free |= {"level_shift": self.level, "at_predicted_level": self.strict.as_dict(unit)}
        k_step = {"steps": steps, **self.k_step.as_dict(unit)}
        return {"one_step": self.one_step.as_dict(unit), "k_step": k_step, "free_run": free}


def score_records(records: list[Record], model: ArxEstimate, poles: list[Pole], horizon: int) -> Scores:
    """Return the errors one step ahead, ``horizon`` steps ahead and in free run.

    Raises
    ------
    NoTrustworthyResult
        When no record is longer than the past samples that the model needs.
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
    one, many = (
        score(measured, np.concatenate([predict(r, orders, theta, steps=steps) for r in records]))
        for steps in (1, horizon)
    )
    free = score(measured, np.concatenate(runs))
    stopped = False
    for record, run in zip(records, runs, strict=True):
        last = np.flatnonzero(np.isfinite(run))[-1:]
        stopped |= bool(len(last) and np.isfinite(record.source[last[0] + 1 :]).any())
    at_risk = any(pole.state != "stable" for pole in poles)
    return Scores(one, many, free, bool(at_risk and (stopped or free.fit_percent < 0)))


def frequency_response(
    orders: Orders, theta: np.ndarray, covariance: np.ndarray, sample_time_s: float, omega_rad_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frequency response B / A with its standard errors.

    Parameters
    ----------
    theta, covariance : ndarray, shape (p,) and (p, p)
        Coefficients and their covariance.
    sample_time_s : float
    omega_rad_s : ndarray, shape (m,)

    Returns
    -------
    response : ndarray of complex, shape (m,)
    log_gain, phase_rad : ndarray, shape (m,)
        Standard errors of the logarithm of the gain and of the phase, rad.
    """
    a, b, _ = orders.split(theta)
    backward = np.exp(-1j * np.asarray(omega_rad_s) * sample_time_s)
    past = [backward**i for i in range(1, orders.na + 1)]
    driven = [backward ** (orders.nk + j) for j in range(orders.nb)]
    denominator = 1.0 + sum(value * power for value, power in zip(a, past, strict=True))
    numerator = sum(value * power for value, power in zip(b, driven, strict=True))
    # d ln G: -z^-i / A for a_i, z^-(nk+j) / B for b_j
    gradient = np.array([-power / denominator for power in past] + [power / numerator for power in driven])
    used = covariance[: orders.na + orders.nb, : orders.na + orders.nb]
    log_gain, phase = (
        np.sqrt(np.maximum(np.einsum("im,ij,jm->m", part, used, part), 0.0))
        for part in (gradient.real, gradient.imag)
    )
    return numerator / denominator, log_gain, phase


@dataclass(frozen=True)
class Identified:
    """Model with its data and errors, the data relative to the working point."""

    options: RwlsOptions
    data: Data
    point: WorkingPoint
    fit: list[Record]
    #: By the name of the data; about a level of their own if a working point was subtracted.
    held_out: Mapping[str, list[Record]]
    estimate: ArxEstimate
    #: Largest first.
    poles: list[Pole]
    fit_scores: Scores
    #: Errors on the held-out data.
    scores: Mapping[str, Scores]
    #: Orders of the search with their BIC, least first; empty without a search.
    candidates: Sequence[tuple[Orders, float]]

    @property
    def kind(self) -> str:
        """``ARX``, or ``ARMAX`` with a noise polynomial."""
        return "ARMAX" if self.estimate.orders.nc else "ARX"

    @cached_property
    def residual_series(self) -> tuple[np.ndarray, np.ndarray, int]:
        """One-step residuals and input of the fitted records on one time grid, and the lags to test."""
        data, lags = self.estimate.data, rt.default_lags(len(self.estimate.data))
        gap = 2 * lags + self.estimate.orders.lag
        source = rt.joined([r.source for r in self.fit], gap=gap)
        return data.on_grid(self.estimate.residuals, gap=gap), source, lags

    @cached_property
    def independent(self) -> rt.TestResult:
        """Test that the residuals are independent of past inputs."""
        residuals, source, lags = self.residual_series
        return rt.independence(residuals, source, lags=lags, first=self.estimate.orders.nk)

    @property
    def worse(self) -> list[str]:
        """Names of the held-out data whose free-run error exceeds :data:`MAX_RATIO` times that of the fit."""
        limit = MAX_RATIO * self.fit_scores.free_run.rmse
        return [name for name, s in self.scores.items() if s.free_run.rmse > limit]

    @property
    def critical_pole(self) -> Pole | None:
        """Pole that decides on the stability: an unstable one, else an integrating one, else the largest."""
        states = ("unstable", "integrating", "stable")
        return min(self.poles, key=lambda pole: states.index(pole.state), default=None)


def identify(data: Data, options: RwlsOptions, progress: Progress) -> Identified:
    """Choose the orders where they are not given, fit the model, and compute its errors.

    Raises
    ------
    NoTrustworthyResult
        As :func:`swimid.blackbox.arx.estimate`.
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
        stride=max(1, -(-len(regression(fit, orders)) // MAX_KEPT)),
    )
    a, _, _ = orders.split(fitted.theta)
    poles = difference.poles(a, fitted.covariance[: orders.na, : orders.na], data.sample_time_s)
    held, scores = {}, {}
    for name, part in data.held_out.items():
        held[name] = shifted(part, point)
        scores[name] = score_records(held[name], fitted, poles, options.horizon)
        if point.removed:
            strict = scores[name].free_run
            held[name], level = about_own_level(held[name], orders, fitted.theta)
            own = score_records(held[name], fitted, poles, options.horizon)
            scores[name] = replace(own, level=level, strict=strict)
    fit_scores = score_records(fit, fitted, poles, options.horizon)
    return Identified(options, data, point, fit, held, fitted, poles, fit_scores, scores, candidates)


def _search(data: Data, options: RwlsOptions, progress: Progress) -> list[tuple[Orders, float]]:
    """Rank the orders of the grid; warn where the best ones lie at its edge."""
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
        Orders and Bayesian information criterion ``n ln(RSS / n) + p ln n``, least first. Of equal ones, the
        model with fewer coefficients is first.

    Raises
    ------
    NoTrustworthyResult
        When there are too few rows, or the output is constant.

    Notes
    -----
    All models are fitted to the same n rows, those complete for the longest lags of the grid, so that their
    criteria can be compared. One QR factor of the widest regression serves them all.
    """
    widest = Orders(largest, delays[-1] + largest, 0)
    data = regression(records, widest)
    check_enough(data, widest)
    n = len(data)
    factor = np.asarray(np.linalg.qr(np.column_stack((data.rows, data.outputs)), mode="r"))
    # without a minimum, noise-free data would favour ever more coefficients
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
