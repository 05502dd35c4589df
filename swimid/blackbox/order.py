"""The search for the orders of an ARX model: information criteria and free-run error over a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from swimid.blackbox.arx import EXACT, check_enough, regression
from swimid.blackbox.difference import Orders, Record, simulate_all
from swimid.blackbox.prediction import about_own_level
from swimid.errors import NoTrustworthyResult
from swimid.fitting.metrics import score
from swimid.progress import Progress, silent


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


def search(
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


def best(candidates: Sequence[Candidate], criterion: str) -> Candidate:
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
