"""A model that was identified, with all that its result needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.blackbox.arx import ArxEstimate
from swimid.blackbox.difference import Pole, Record
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.order import Candidate
from swimid.blackbox.prediction import Scores
from swimid.blackbox.trials import Data
from swimid.blackbox.working_point import WorkingPoint
from swimid.fitting import residual_tests as rt


@dataclass(frozen=True)
class Tests:
    """Residual tests on the fit part."""

    __test__ = False

    autocorrelation: rt.Correlation
    cross: rt.Correlation
    white: rt.TestResult
    independent: rt.TestResult


def tests(fit: list[Record], estimate: ArxEstimate) -> Tests:
    """Test the residuals of the fitted part."""
    lags = rt.default_lags(len(estimate.data))
    gap = 2 * lags + estimate.orders.lag
    residuals = rt.joined([_on_record(estimate, i, r) for i, r in enumerate(fit)], gap=gap)
    source = rt.joined([r.source for r in fit], gap=gap)
    return Tests(
        rt.autocorrelation(residuals, max_lag=lags),
        rt.cross_correlation(residuals, source, max_lag=lags),
        estimate.whiteness,
        rt.independence(residuals, source, lags=lags, first=estimate.orders.nk),
    )


def _on_record(estimate: ArxEstimate, index: int, record: Record) -> np.ndarray:
    values = np.full(len(record), np.nan)
    mine = estimate.data.record == index
    values[estimate.data.sample[mine]] = estimate.residuals[mine]
    return values


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
    tests: Tests

    @property
    def kind(self) -> str:
        """``ARX``, or ``ARMAX`` with a noise polynomial."""
        return "ARMAX" if self.estimate.orders.nc else "ARX"

    @property
    def stability(self) -> str:
        """``stable``, ``integrating`` or ``unstable``."""
        states = {p.state for p in self.poles}
        return next((state for state in ("unstable", "integrating") if state in states), "stable")
