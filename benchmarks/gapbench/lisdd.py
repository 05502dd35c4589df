"""A peer: the method of LISDD, localised discovery of a discrepancy with an exact test.

Y. Wang, *Where Is My Physics Wrong? Localized and Identifiable Discovery of Model Discrepancy*,
arXiv 2606.23215, 2026. The nominal terms are fitted in a clean regime, which is found automatically. Regimes
whose residual energy that fit does not predict are discrepant (G. C. Chow, Econometrica 28(3), 1960). In each
discrepant region held-out data choose one term among all, and an F test on samples of its own confirms it.
The false-discovery rate is controlled over regimes and over regions (Y. Benjamini and Y. Hochberg, 1995).
Equations and library are those of :mod:`benchmarks.gapbench.regression`; the regimes are ranges of speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.gapbench import regression
from benchmarks.gapbench.peers import Case, gap
from benchmarks.gapbench.regression import Array, Rows

#: Number of regimes, each with as many samples, and number of neighbours that are the clean regime.
REGIMES, CLEAN = 4, 2
#: Parts of the samples: coefficients of terms are fitted, terms are chosen, and the chosen ones are tested.
FIT, CHOOSE, TEST = range(3)
#: False-discovery rate.
RATE = 0.05


def diagnose(case: Case) -> dict[str, Any]:
    """Return the part of a gap file that the localised discovery gives."""
    return discover(regression.equations(case))


def discover(rows: Rows) -> dict[str, Any]:
    """Return the part of a gap file that states the confirmed terms of discrepant regions.

    The verdict is ``none`` without a discrepant region, and ``unexplained`` without a confirmed term.
    """
    regime = np.argsort(np.argsort(rows.speed, kind="stable")) * REGIMES // len(rows.speed)
    part = np.arange(len(rows.speed)) % 3
    starts = range(REGIMES - CLEAN + 1)
    first = min(starts, key=lambda k: _variance(rows, (part != TEST) & _within(regime, range(k, k + CLEAN))))
    clean = _within(regime, range(first, first + CLEAN))
    regions = _discrepant(rows, regime, clean, part)
    library = regression.library(rows)
    causes, p_values = [], []
    for region in regions:
        names = _choose(rows, library, clean, region, part)
        if names:
            causes.append({"effect": names[0], "equivalent": list(names[1:])})
            p_values.append(_test(rows, library[names], clean, region, part))
    confirmed: dict[str, dict[str, Any]] = {}
    for k in np.argsort(p_values):
        if stats.false_discovery_control(p_values)[k] <= RATE:
            confirmed.setdefault(causes[k]["effect"], causes[k])
    return gap(list(confirmed.values()), otherwise="unexplained" if regions else "none")


def _within(regime: Array, some: Sequence[int]) -> Array:
    return np.isin(regime, list(some))


def _discrepant(rows: Rows, regime: Array, clean: Array, part: Array) -> list[Array]:
    """Samples of each run of neighbouring regimes that the fit in the clean regime does not predict."""
    search = part != TEST
    others = [k for k in range(REGIMES) if not clean[regime == k].all()]
    own = _fit(rows.nominal[clean & search], rows.left[clean & search])
    p_values = []
    for k in others:
        both = (clean | (regime == k)) & search
        p_values.append(_f_test(_fit(rows.nominal[both], rows.left[both]), own))
    flagged = [k for k, p in zip(others, stats.false_discovery_control(p_values), strict=True) if p <= RATE]
    runs = [[k for _, k in run] for _, run in groupby(enumerate(flagged), key=lambda pair: pair[1] - pair[0])]
    return [_within(regime, run) for run in runs]


def _choose(
    rows: Rows, library: dict[tuple[str, ...], Array], clean: Array, region: Array, part: Array
) -> tuple[str, ...]:
    """Effects of the term with the least held-out error in a region; none if no term lowers it."""
    known = clean & (part != TEST)
    weights = _weights(rows.nominal[known], rows.left[known])
    left = rows.left - rows.nominal @ weights
    fit, held = region & (part == FIT), region & (part == CHOOSE)
    errors = {(): float(np.sum(left[held] ** 2))}
    for names, term in library.items():
        errors[names] = float(np.sum((left[held] - term[held] @ _weights(term[fit], left[fit])) ** 2))
    return min(errors, key=errors.__getitem__)


def _test(rows: Rows, term: Array, clean: Array, region: Array, part: Array) -> float:
    """p-value of a term that acts in a region, beside nominal terms that hold in the clean regime, too."""
    pick = (clean | region) & (part == TEST)
    local = np.where(region[pick, None, None], term[pick], 0.0)
    nominal, left = rows.nominal[pick], rows.left[pick]
    return _f_test(_fit(nominal, left), _fit(np.concatenate([nominal, local], axis=2), left))


def _weights(terms: Array, left: Array) -> Array:
    """Least-squares coefficients of terms of shape (n, equations, k)."""
    flat = terms.reshape(left.size, -1)
    scale = np.linalg.norm(flat, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    return np.linalg.lstsq(flat / scale, left.ravel(), rcond=1e-8)[0] / scale


def _fit(terms: Array, left: Array) -> tuple[float, int]:
    """Sum of squared residuals of least squares, and their degrees of freedom."""
    free = left.size - int(np.linalg.matrix_rank(terms.reshape(left.size, -1)))
    if free <= 0:
        raise SystemExit(f"a regime has {left.size} samples, too few for the nominal terms")
    return float(np.sum(regression.residuals(terms, left) ** 2)), free


def _variance(rows: Rows, pick: Array) -> float:
    total, free = _fit(rows.nominal[pick], rows.left[pick])
    return total / free


def _f_test(restricted: tuple[float, int], full: tuple[float, int]) -> float:
    """p-value of the restricted one of two nested fits."""
    extra = restricted[1] - full[1]
    if extra <= 0:
        return 1.0
    ratio = (restricted[0] - full[0]) / extra / (full[0] / full[1])
    return float(stats.f.sf(ratio, extra, full[1]))
