"""A peer: sparse identification of the residual force (SINDy).

Sequentially thresholded least squares (S. L. Brunton et al., PNAS 113(15), 2016) on what the nominal terms
leave (K. Kaheman et al., arXiv 1909.08574). The BIC selects the threshold (N. M. Mangan et al., Proc. R. Soc.
A 473, 2017). Equations and library are those of :mod:`benchmarks.gapbench.regression`. The terms of one
effect are thresholded together. It cannot say that something else is missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.gapbench import regression
from benchmarks.gapbench.peers import Case, gap
from benchmarks.gapbench.regression import Array, Rows

#: Thresholds of the root-mean-square force of an effect, as shares of the residual force.
THRESHOLDS = np.geomspace(0.02, 1.0, 25)


def diagnose(case: Case) -> dict[str, Any]:
    """Return the part of a gap file that the sparse regression gives."""
    return discover(regression.equations(case))


def discover(rows: Rows) -> dict[str, Any]:
    """Return the part of a gap file that states the effects of the sparse equation, the largest first."""
    library = regression.library(rows)
    terms = {names: regression.residuals(rows.nominal, term) for names, term in library.items()}
    left = regression.residuals(rows.nominal, rows.left)
    supports = [tuple(select(terms, left, least)) for least in THRESHOLDS]

    def bic(names: tuple[tuple[str, ...], ...]) -> float:
        chosen = [library[name] for name in names]
        return regression.compute_bic(np.concatenate([rows.nominal, *chosen], axis=2), rows.left)

    best = min(dict.fromkeys(supports), key=bic)
    return gap([{"effect": first, "equivalent": others} for first, *others in best])


def select(terms: Mapping[tuple[str, ...], Array], left: Array, least: float) -> list[tuple[str, ...]]:
    """Return the effects that sequential thresholding keeps, the largest force first.

    Parameters
    ----------
    terms : mapping of names to ndarray of shape (n, equations, k)
        Terms of effects, orthogonal to the nominal ones.
    left : ndarray, shape (n, equations)
        Residual force.
    least : float
        Root-mean-square force below which an effect is dropped, as a share of the residual force.
    """
    kept = dict(terms)
    while kept:
        force = _forces(kept, left)
        stays = sorted((name for name in kept if force[name] >= least), key=force.__getitem__, reverse=True)
        if len(stays) == len(kept):
            return stays
        kept = {name: kept[name] for name in stays}
    return []


def _forces(terms: Mapping[tuple[str, ...], Array], left: Array) -> dict[tuple[str, ...], float]:
    """Root-mean-square force of each effect in the least-squares fit of all, as a share of the residual."""
    flat = {name: term.reshape(left.size, -1) for name, term in terms.items()}
    both = np.concatenate(list(flat.values()), axis=1)
    scale = np.linalg.norm(both, axis=0)
    weights = np.linalg.lstsq(both / scale, left.ravel(), rcond=1e-8)[0] / scale
    parts = np.split(weights, np.cumsum([term.shape[1] for term in flat.values()])[:-1])
    size = np.linalg.norm(left)
    return {n: float(np.linalg.norm(t @ w) / size) for (n, t), w in zip(flat.items(), parts, strict=True)}
