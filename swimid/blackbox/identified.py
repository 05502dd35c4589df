"""Identification of an ARX or ARMAX model: orders, working point, estimate and errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from swimid.blackbox import difference, prediction, working_point
from swimid.blackbox.arx import EXACT, ArxEstimate, check_enough, estimate, regression
from swimid.blackbox.difference import Orders, Pole, Record, simulate_all
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.prediction import Scores, about_own_level
from swimid.blackbox.trials import Data
from swimid.blackbox.working_point import WorkingPoint
from swimid.errors import NoTrustworthyResult
from swimid.fitting import noise as rt
from swimid.fitting.metrics import score
from swimid.notices import warn
from swimid.progress import Progress, silent

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
    free_run_fit : float
        Fit of the free run on held-out data, per cent; minus infinity when it runs away.
    """

    orders: Orders
    aic: float
    bic: float
    free_run_fit: float
    stable: bool

    def score(self, criterion: str) -> float:
        """Return what ``criterion`` ("bic", "aic" or "free-run") minimises."""
        return {"bic": self.bic, "aic": self.aic, "free-run": -self.free_run_fit}[criterion]


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
    point = working_point.centre(data.fit, orders, options.centre)
    fit = working_point.shifted(data.fit, point)
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
        held[name], scores[name] = prediction.held_out_scores(
            working_point.shifted(part, point), fitted, poles, options.horizon, own_level=point.removed
        )
    fit_scores = prediction.scores(fit, fitted, poles, options.horizon)
    return Identified(options, data, point, fit, held, fitted, poles, fit_scores, scores, candidates)


def _search(data: Data, options: RwlsOptions, progress: Progress) -> list[Candidate]:
    """Fit every order of the grid; warn where the best one lies at its edge or uses the held-out data up."""
    widest = Orders(options.max_na, options.max_nb, options.max_nk)
    point = working_point.centre(data.fit, replace(widest, nk=1), options.centre)
    fit = working_point.shifted(data.fit, point)
    held = [working_point.shifted(part, point) for part in data.held_out.values()]
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
