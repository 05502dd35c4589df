"""Choosing the orders of an ARX model: information criteria and free-run error over a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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
    one_step_rmse : float
        On the rows all candidates share, unit of the output.
    aic, bic : float
        Akaike's and the Bayesian information criterion.
    free_run_fit : float
        Fit of the free run on held-out data, per cent; minus infinity when it runs away.
    """

    orders: Orders
    one_step_rmse: float
    aic: float
    bic: float
    free_run_fit: float
    stable: bool

    def as_dict(self) -> dict[str, Any]:
        """For the result as data."""
        return {
            **{name: getattr(self.orders, name) for name in ("na", "nb", "nk")},
            "aic": float(self.aic),
            "bic": float(self.bic),
            "free_run_fit_percent": float(self.free_run_fit),
            "stable": self.stable,
        }

    def score(self, criterion: str) -> float:
        """What ``criterion`` ("bic", "aic" or "free-run") minimises."""
        return {"bic": self.bic, "aic": self.aic, "free-run": -self.free_run_fit}[criterion]


def search(
    records: Sequence[Record],
    held_out: Sequence[Sequence[Record]],
    *,
    max_na: int,
    max_nb: int,
    max_nk: int,
    level_removed: bool = False,
    progress: Progress = silent,
) -> list[Candidate]:
    """Every ARX model with na <= max_na, 1 <= nb <= max_nb, 0 <= nk <= max_nk.

    Parameters
    ----------
    records : sequence of Record
        The fit part.
    held_out : sequence of sequence of Record
        Sets on which the free run is judged; the fit part when empty.
    level_removed : bool
        Judge the free run about each set's own level.

    Notes
    -----
    All candidates are fitted on the same rows, those whole for the longest lags of the grid, so
    that their criteria can be compared. One QR factor of the widest regression serves them all.
    ``aic = n ln(RSS / n) + 2 p``, ``bic = n ln(RSS / n) + p ln n``.
    """
    widest = Orders(max_na, max_nk + max_nb, 0)
    data = regression(records, widest)
    check_enough(data, widest)
    n = len(data)
    factor: np.ndarray = np.asarray(np.linalg.qr(np.column_stack((data.rows, data.outputs)), mode="r"))
    floor = n * (EXACT * float(np.std(data.outputs))) ** 2
    judged = [list(part) for part in held_out if part] or [list(records)]
    grid = [
        Orders(na, nb, nk)
        for na in range(max_na + 1)
        for nb in range(1, max_nb + 1)
        for nk in range(max_nk + 1)
    ]
    candidates = []
    with progress("trying orders", total=len(grid)) as step:
        for orders in grid:
            chosen = [*range(orders.na), *range(max_na + orders.nk, max_na + orders.nk + orders.nb)]
            theta = np.linalg.lstsq(factor[:, chosen], factor[:, -1], rcond=None)[0]
            rss = float(np.sum((factor[:, -1] - factor[:, chosen] @ theta) ** 2))
            # Below rounding all fits are equal; without a floor noise-free data would
            # reward ever more parameters.
            fitted = n * np.log(max(rss, floor, np.finfo(float).tiny) / n)
            parts = [about_own_level(r, orders, theta)[0] if level_removed else r for r in judged]
            measured, run = simulate_all([r for part in parts for r in part], orders, theta)
            error = score(measured, run)
            complete = error.samples > 0.5 * np.count_nonzero(np.isfinite(measured))
            roots = np.roots(np.concatenate(([1.0], theta[: orders.na])))
            candidates.append(
                Candidate(
                    orders,
                    float(np.sqrt(rss / n)),
                    fitted + 2 * orders.count,
                    fitted + np.log(n) * orders.count,
                    error.fit_percent if complete and np.isfinite(error.fit_percent) else -np.inf,
                    bool(np.all(np.abs(roots) < 1)),
                )
            )
            step()
    return candidates


def best(candidates: Sequence[Candidate], criterion: str) -> Candidate:
    """The candidate of least score; of equals, the one with fewest parameters.

    Raises
    ------
    NoTrustworthyResult
        When no candidate has a finite score.
    """
    finite = [c for c in candidates if np.isfinite(c.score(criterion))]
    if not finite:
        raise NoTrustworthyResult("no model of the order grid has a free run that stays finite")
    return min(finite, key=lambda c: (c.score(criterion), c.orders.count, c.orders.nk))


def on_edge(chosen: Orders, *, max_na: int, max_nb: int, max_nk: int) -> list[str]:
    """Names of the orders that sit at the largest value of the grid (nk = 0 is no edge: none is less)."""
    limits = {"na": max_na, "nb": max_nb, "nk": max_nk}
    return [name for name, limit in limits.items() if getattr(chosen, name) == limit]
