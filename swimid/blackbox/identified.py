"""Identification of an ARX or ARMAX model: working point, orders, estimate, and how well it predicts.

A model without a constant term describes deviations. Data recorded around a working point (20 degrees, half
throttle) need it removed; data that obey the model as they stand must not be touched, or the estimate would
change for nothing. Predictions are one step ahead, k steps ahead, and the free run (simulation), which sees
no output after its start.
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
    directions,
    errors_and_gradient,
    estimate,
    regression,
)
from swimid.blackbox.difference import (
    INTEGRATING,
    Orders,
    Pole,
    Record,
    best_level,
    lagged,
    simulate,
    simulate_all,
)
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import Data
from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as rt
from swimid.fitting.metrics import Score, score
from swimid.notices import warn
from swimid.progress import Progress, silent

#: |t| of a constant term from which on the working point is removed.
CLEAR_T = 5.0
#: |t| that is enough when the free run gains clearly. By chance alone, data that need no constant
#: reach both less than once in a hundred records, those of slow systems included.
LIKELY_T = 3.5
#: |t| that is enough where the data sit far from zero and the free run gains at all. There a
#: missing constant hides in the other coefficients (A(1) goes to zero: a pole at 1 that is not
#: in the robot), and shows weakly or not at all in t.
WEAK_T = 2.0
#: Gain of the free run, as a share of its error, that is clear.
CLEAR_GAIN = 0.1
#: Mean of the output over its standard deviation from which on that counts as far.
FAR = 3.0


@dataclass(frozen=True)
class WorkingPoint:
    """Means removed from the data, and why.

    Attributes
    ----------
    source, output : float
        Removed from u and y; zero where nothing was removed.
    constant, t : float
        The constant term of the regression on raw data (NaN where it was not tested), and over its standard
        error.
    removed : bool
    """

    source: float
    output: float
    constant: float
    t: float
    removed: bool


def centre(records: Sequence[Record], orders: Orders, mode: str = "auto") -> WorkingPoint:
    """Decide whether the working point must be removed; ``records`` are the fit part.

    Mode ``auto`` removes the means when a constant term beside A and B has a t value above
    :data:`CLEAR_T` in size, or above :data:`LIKELY_T` when the free run over the fit part gets
    better by :data:`CLEAR_GAIN`. Where the output's mean is more than :data:`FAR` deviations
    from zero, it also does when the free run gets better by that much whatever t is, at all
    with t above :data:`WEAK_T`, or when a pole at 1 of the raw model goes away by it. Data
    without an offset stay as they are. ``none`` and ``mean``: never, and always.
    """
    source, output = _mean([r.source for r in records]), _mean([r.output for r in records])
    data = regression(records, replace(orders, nc=0))
    constant, t = _constant(data)
    point = WorkingPoint(source, output, constant, t, True)
    removed = mode != "none"
    level = float(np.sqrt(np.mean(data.outputs**2))) if len(data) else 0.0
    size = abs(t) if abs(constant) > EXACT * level else 0.0
    if mode == "auto" and size <= CLEAR_T:
        far = len(data) > 0 and abs(output) > FAR * float(np.std(data.outputs))
        worth_trying = len(data) > orders.count and (far or size > LIKELY_T)
        removed = worth_trying and _helps(records, orders, point, far=far, likely=size > WEAK_T)
    return point if removed else WorkingPoint(0.0, 0.0, constant, t, False)


def _helps(
    records: Sequence[Record], orders: Orders, point: WorkingPoint, *, far: bool, likely: bool
) -> bool:
    """Whether removing the working point betters the free run, or takes away a spurious integrator.

    ``far`` and ``likely``: the output sits far from zero; a constant term is likely.
    """
    plain = replace(orders, nc=0)
    rms, largest = [], []
    for part in (list(records), shifted(records, point)):
        data = regression(part, plain)
        theta = np.linalg.lstsq(data.rows, data.outputs, rcond=None)[0]
        errors = np.subtract(*simulate_all(part, plain, theta))
        rms.append(float(np.sqrt(np.nanmean(errors**2))) if np.isfinite(errors).any() else float("inf"))
        roots = difference.poles(theta[: orders.na], None, 1.0)
        largest.append(roots[0].magnitude if roots else 0.0)
    if far and largest[0] > INTEGRATING >= largest[1]:
        return True
    return rms[1] < rms[0] * (1.0 if far and likely else 1.0 - CLEAR_GAIN)


def _mean(parts: list[np.ndarray]) -> float:
    values = np.concatenate(parts) if parts else np.empty(0)
    values = values[np.isfinite(values)]
    return float(np.mean(values)) if len(values) else 0.0


def _constant(data: Regression) -> tuple[float, float]:
    """Constant term beside the regression (NaN where undetermined), and that over its standard error."""
    n, p = data.rows.shape
    rows = np.hstack((data.rows, np.ones((n, 1))))
    if n <= p + 1 or not directions(rows, np.zeros(p + 1)).determined[-1]:
        return float("nan"), 0.0
    theta = np.linalg.lstsq(rows, data.outputs, rcond=None)[0]
    residuals = data.outputs - rows @ theta
    white = rt.ljung_box(data.spread(residuals, gap=rt.default_lags(n))).passed
    spread, _ = covariance(rows, residuals, np.ones(n), 0.0, None if white else data)
    constant, stderr = float(theta[-1]), float(np.sqrt(max(spread[-1, -1], 0.0)))
    if stderr > 0:
        return constant, constant / stderr
    return constant, 0.0 if constant == 0 else float("inf")


def shifted(records: Sequence[Record], point: WorkingPoint) -> list[Record]:
    """The records relative to a working point; the given ones are not touched."""
    if not point.removed:
        return list(records)
    return [replace(r, source=r.source - point.source, output=r.output - point.output) for r in records]


def predict(record: Record, orders: Orders, theta: np.ndarray, *, steps: int = 1) -> np.ndarray:
    """Return the prediction ``steps`` samples ahead, shape (n,).

    The input is known throughout; the output only up to the sample the prediction is made at, NaN where that
    is missing.
    """
    a, b, c = orders.split(theta)
    driven = np.zeros(len(record))
    for j, value in enumerate(b):
        driven = driven + value * lagged(record.source, orders.nk + j)
    # Where it has no whole row, a model with C knows no error; it takes zero, as the fit does.
    errors = np.zeros(len(record))
    if orders.nc:
        data = regression([record], orders)
        found, _ = errors_and_gradient(theta, data.rows, data.outputs, data.fresh, orders.nc)
        errors[data.sample] = np.nan_to_num(found)
    done: list[np.ndarray] = []  # the predictions 1, 2, .. steps ahead so far
    for ahead in range(1, steps + 1):
        total = driven.copy()
        for i, value in enumerate(a, start=1):
            total -= value * lagged(done[ahead - i - 1] if ahead > i else record.output, i)
        for i in range(ahead, orders.nc + 1):
            total += c[i - 1] * np.nan_to_num(lagged(errors, i))
        done.append(total)
        if ahead > orders.na:
            done[ahead - orders.na - 1] = np.empty(0)  # no longer needed
    return done[-1]


def about_own_level(
    records: Sequence[Record], orders: Orders, theta: np.ndarray
) -> tuple[list[Record], float]:
    """Return records relative to the output level about which they deviate, and that level.

    For a model of deviations on data with a working point of their own. The level is one number, best for the
    free run, so that ``y - level`` is simulated, initial samples included.
    """
    measured, run = simulate_all(records, orders, theta)
    _, raised = simulate_all([replace(r, output=r.output - 1.0) for r in records], orders, theta)
    level = best_level(measured, run, raised + 1.0)
    return [replace(r, output=r.output - level) for r in records], level


@dataclass(frozen=True)
class Scores:
    """Errors on one set of records.

    Attributes
    ----------
    strict : metrics.Score or None
        The free run at the level the fitted part predicts, where all else is about the data's
        own level.
    level : float
        That own level less the predicted one, unit of the output.
    """

    one_step: Score
    k_step: Score
    free_run: Score
    strict: Score | None
    level: float
    diverged: bool

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


def errors_on(records: list[Record], estimate: ArxEstimate, poles: list[Pole], horizon: int) -> Scores:
    """Return the errors one step ahead, ``horizon`` steps ahead and in free run.

    Raises
    ------
    NoTrustworthyResult
        When the records are shorter than the model looks back.
    """
    longest = max((len(r) for r in records), default=0)
    orders, theta = estimate.orders, estimate.theta
    if longest <= orders.lag:
        raise NoTrustworthyResult(
            f"a held-out part has {longest} samples, the model looks back over {orders.lag}",
            hint="hold out a larger share, or validate on a longer log",
        )
    measured = np.concatenate([r.output for r in records])
    one, many = (
        score(measured, np.concatenate([predict(r, orders, theta, steps=steps) for r in records]))
        for steps in (1, horizon)
    )
    runs = [simulate(r, orders, theta) for r in records]
    free = score(measured, np.concatenate(runs))
    at_risk = any(p.state != "stable" for p in poles)
    gave_up = any(
        np.isfinite(r.source[np.isfinite(run).nonzero()[0][-1] + 1 :]).any()
        for r, run in zip(records, runs, strict=True)
        if np.isfinite(run).any() and not np.isfinite(run[-1])
    )
    return Scores(one, many, free, None, 0.0, bool(at_risk and (gave_up or free.fit_percent < 0)))


def pooled(records: Sequence[Record], estimate: ArxEstimate) -> Score:
    """Return the free-run score over several records together."""
    return score(*simulate_all(records, estimate.orders, estimate.theta))


def held_out_scores(
    records: list[Record], estimate: ArxEstimate, poles: list[Pole], horizon: int, *, own_level: bool
) -> tuple[list[Record], Scores]:
    """Return held-out records with their errors.

    With ``own_level`` they are about their own level; their errors are those there and at the predicted one.
    """
    found = errors_on(records, estimate, poles, horizon)
    if not own_level:
        return records, found
    moved, level = about_own_level(records, estimate.orders, estimate.theta)
    return moved, replace(errors_on(moved, estimate, poles, horizon), strict=found.free_run, level=level)


def frequency_response(
    orders: Orders, theta: np.ndarray, covariance: np.ndarray, sample_time_s: float, omega_rad_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the frequency response B / A with its standard errors.

    Parameters
    ----------
    theta, covariance : ndarray, shape (p,) and (p, p)
        Coefficients and their covariance.
    omega_rad_s : ndarray, shape (m,)

    Returns
    -------
    response : ndarray of complex, shape (m,)
    log_gain, phase_rad : ndarray, shape (m,)
        Standard errors of ln of the gain and of the phase, rad.
    """
    a, b, _ = orders.split(theta)
    backward = np.exp(-1j * np.asarray(omega_rad_s) * sample_time_s)
    denominator = 1.0 + sum(value * backward**i for i, value in enumerate(a, start=1))
    powers = [backward ** (orders.nk + j) for j in range(orders.nb)]
    numerator = sum(value * power for value, power in zip(b, powers, strict=True))
    # d ln G: -z^-i / A for a_i, z^-(nk+j) / B for b_j.
    gradient = np.array(
        [-(backward**i) / denominator for i in range(1, orders.na + 1)]
        + [power / numerator for power in powers]
    )
    used = covariance[: orders.na + orders.nb, : orders.na + orders.nb]

    def spread(part: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(np.einsum("im,ij,jm->m", part, used, part), 0.0))

    return numerator / denominator, spread(gradient.real), spread(gradient.imag)


#: Ratio of the free-run error on held-out data to that on the fitted data above which SWM015 is raised.
WORSE = 2.0
#: Number of rows at which the parameters of the recursion are kept.
KEPT = 1000


@dataclass(frozen=True)
class Candidate:
    """One model of the grid.

    Attributes
    ----------
    aic, bic : float
        Akaike's and the Bayesian information criterion.
    free_run_fit_percent : float
        Fit of the free run on held-out data, per cent; minus infinity when it runs away.
    """

    orders: Orders
    aic: float
    bic: float
    free_run_fit_percent: float
    stable: bool

    def score(self, criterion: str) -> float:
        """Return what ``criterion`` ("bic", "aic" or "free-run") minimises."""
        return {"bic": self.bic, "aic": self.aic, "free-run": -self.free_run_fit_percent}[criterion]


@dataclass(frozen=True)
class Identified:
    """A model with the data it was fitted to and what tells of its quality.

    ``fit`` and ``held_out`` are records without the working point, held-out ones about a level of their own
    where one was removed; ``scores`` are the errors on them. The poles come with the largest first.
    """

    options: RwlsOptions
    data: Data
    point: WorkingPoint
    fit: list[Record]
    held_out: Mapping[str, list[Record]]
    estimate: ArxEstimate
    poles: list[Pole]
    fit_scores: Scores
    scores: Mapping[str, Scores]
    candidates: Sequence[Candidate]

    @property
    def kind(self) -> str:
        """``ARX``, or ``ARMAX`` with a noise polynomial."""
        return "ARMAX" if self.estimate.orders.nc else "ARX"

    @cached_property
    def residual_series(self) -> tuple[np.ndarray, np.ndarray, int]:
        """One-step residuals and input of the fitted records in one series each, and the lags to test."""
        data, lags = self.estimate.data, rt.default_lags(len(self.estimate.data))
        parts = [np.full(len(record), np.nan) for record in self.fit]
        for index, part in enumerate(parts):
            mine = data.record == index
            part[data.sample[mine]] = self.estimate.residuals[mine]
        gap = 2 * lags + self.estimate.orders.lag
        return rt.joined(parts, gap=gap), rt.joined([r.source for r in self.fit], gap=gap), lags

    @cached_property
    def independent(self) -> rt.TestResult:
        """Whether the residuals are independent of the input's past."""
        residuals, source, lags = self.residual_series
        return rt.independence(residuals, source, lags=lags, first=self.estimate.orders.nk)

    @property
    def worse(self) -> list[str]:
        """Names of the held-out data with a free-run error more than :data:`WORSE` times that of the fit."""
        limit = WORSE * self.fit_scores.free_run.rmse
        return [name for name, s in self.scores.items() if s.free_run.rmse > limit]

    @property
    def critical_pole(self) -> Pole | None:
        """The pole that decides on the stability: the largest unstable one, else the largest integrator."""
        ranked = [p for state in ("unstable", "integrating") for p in self.poles if p.state == state]
        return next(iter([*ranked, *self.poles]), None)

    @property
    def stability(self) -> str:
        """``stable``, ``integrating`` or ``unstable``."""
        return self.critical_pole.state if self.critical_pole else "stable"


def identify(data: Data, options: RwlsOptions, progress: Progress) -> Identified:
    """Choose the orders where they are not given, fit the model, and compute its errors.

    Raises
    ------
    NoTrustworthyResult
        As of :func:`swimid.blackbox.arx.estimate`, or when no model of the grid has a finite free run.
    """
    orders = Orders(options.na or 0, options.nb or 1, options.nk, options.nc)
    candidates: list[Candidate] = []
    if options.order == "auto":
        candidates = _search(data, options, progress)
        orders = replace(best_order(candidates, options.criterion).orders, nc=options.nc)
    point = centre(data.fit, orders, options.centre)
    fit = shifted(data.fit, point)
    fitted = estimate(
        fit,
        orders,
        weight=options.weight,
        forgetting=options.forgetting,
        prior_scale=options.prior_scale,
        stride=max(1, -(-len(regression(fit, orders)) // KEPT)),
    )
    a, _, _ = orders.split(fitted.theta)
    poles = difference.poles(a, fitted.covariance[: orders.na, : orders.na], data.sample_time_s)
    held, scores = {}, {}
    for name, part in data.held_out.items():
        held[name], scores[name] = held_out_scores(
            shifted(part, point), fitted, poles, options.horizon, own_level=point.removed
        )
    fit_scores = errors_on(fit, fitted, poles, options.horizon)
    return Identified(options, data, point, fit, held, fitted, poles, fit_scores, scores, candidates)


def _search(data: Data, options: RwlsOptions, progress: Progress) -> list[Candidate]:
    """Fit every order of the grid; warn where the best one lies at its edge or uses the held-out data up."""
    widest = Orders(options.max_na, options.max_nb, options.max_nk)
    point = centre(data.fit, replace(widest, nk=1), options.centre)
    fit = shifted(data.fit, point)
    held = [shifted(part, point) for part in data.held_out.values()]
    candidates = search_orders(fit, held, widest, level_removed=point.removed, progress=progress)
    best = best_order(candidates, options.criterion).orders
    # nk = 0 is no edge: none is less
    edge = [name for name in ("na", "nb", "nk") if getattr(best, name) == getattr(widest, name)]
    if edge:
        flags = ", ".join(f"--max-{name}" for name in edge)
        warn(
            "SWM023",
            f"the order chosen ({best}) is the largest tried in {', '.join(edge)} (tried: na 0 to "
            f"{widest.na}, nb 1 to {widest.nb}, nk 0 to {widest.nk}): widen the grid with {flags}",
        )
    if options.criterion == "free-run" and held:
        warn(
            "SWM023",
            "the order was chosen on the held-out data, which therefore no longer judge the model "
            "independently",
        )
    return candidates


def search_orders(
    records: Sequence[Record],
    held_out: Sequence[Sequence[Record]],
    widest: Orders,
    *,
    level_removed: bool = False,
    progress: Progress = silent,
) -> list[Candidate]:
    """Return every ARX model with na and nk from 0, and nb from 1, to those of ``widest``.

    Parameters
    ----------
    records : sequence of Record
        The fit part.
    held_out : sequence of sequence of Record
        Sets on which the free run is judged; the fit part when empty.
    widest : Orders
    level_removed : bool
        Judge the free run about each set's own level.

    Notes
    -----
    All candidates are fitted on the same rows, those whole for the longest lags of the grid, so
    that their criteria can be compared. One QR factor of the widest regression serves them all.
    ``aic = n ln(RSS / n) + 2 p``, ``bic = n ln(RSS / n) + p ln n``.
    """
    all_lags = Orders(widest.na, widest.nk + widest.nb, 0)
    data = regression(records, all_lags)
    check_enough(data, all_lags)
    n = len(data)
    factor: np.ndarray = np.asarray(np.linalg.qr(np.column_stack((data.rows, data.outputs)), mode="r"))
    # Below rounding all fits are equal; without a floor noise-free data would reward ever more parameters.
    floor = max(n * (EXACT * float(np.std(data.outputs))) ** 2, float(np.finfo(float).tiny))
    judged = [list(part) for part in held_out if part] or [list(records)]
    grid = list(product(range(widest.na + 1), range(1, widest.nb + 1), range(widest.nk + 1)))
    candidates = []
    with progress("trying orders", total=len(grid)) as step:
        for na, nb, nk in grid:
            orders = Orders(na, nb, nk)
            chosen = [*range(na), *range(widest.na + nk, widest.na + nk + nb)]
            theta = np.linalg.lstsq(factor[:, chosen], factor[:, -1], rcond=None)[0]
            rss = float(np.sum((factor[:, -1] - factor[:, chosen] @ theta) ** 2))
            fitted = n * float(np.log(max(rss, floor) / n))
            parts = [about_own_level(r, orders, theta)[0] if level_removed else r for r in judged]
            measured, run = simulate_all([r for part in parts for r in part], orders, theta)
            error = score(measured, run)
            complete = error.samples > 0.5 * np.count_nonzero(np.isfinite(measured))
            gained = error.fit_percent if complete and np.isfinite(error.fit_percent) else -np.inf
            stable = bool(np.all(np.abs(np.roots([1.0, *theta[:na]])) < 1))
            aic, bic = fitted + 2 * orders.count, fitted + float(np.log(n)) * orders.count
            candidates.append(Candidate(orders, aic, bic, gained, stable))
            step()
    return candidates


def best_order(candidates: Sequence[Candidate], criterion: str) -> Candidate:
    """Return the candidate of least score; of equals, the one with fewest parameters.

    Raises
    ------
    NoTrustworthyResult
        When no candidate has a finite score.
    """
    finite = [c for c in candidates if np.isfinite(c.score(criterion))]
    if not finite:
        raise NoTrustworthyResult("no model of the order grid has a free run that stays finite")
    return min(finite, key=lambda c: (c.score(criterion), c.orders.count, c.orders.nk))
