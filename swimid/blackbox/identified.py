"""A model that was identified, with all that its result needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swimid.blackbox.arx import ArxEstimate
from swimid.blackbox.difference import Pole, Record
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.order import Candidate
from swimid.blackbox.prediction import Scores
from swimid.blackbox.trials import Data
from swimid.blackbox.working_point import WorkingPoint
from swimid.fitting import residual_tests as rt

#: Ratio of the free-run error on held-out data to that on the fitted data above which SWM015 is raised.
WORSE = 2.0


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
    def diverged(self) -> bool:
        """Whether a free run diverges on any of the data."""
        return any(s.diverged for s in (self.fit_scores, *self.scores.values()))

    @property
    def worse(self) -> list[str]:
        """Names of the held-out data with a free-run error more than :data:`WORSE` times that of the fit."""
        limit = WORSE * self.fit_scores.free_run.rmse
        return [name for name, s in self.scores.items() if s.free_run.rmse > limit]

    @property
    def stability(self) -> str:
        """``stable``, ``integrating`` or ``unstable``."""
        states = {p.state for p in self.poles}
        return next((state for state in ("unstable", "integrating") if state in states), "stable")
