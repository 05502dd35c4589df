"""Draws of the coefficients from what a parameter file knows of them."""

from __future__ import annotations

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult
from swimid.fitting.model import Array, Model
from swimid.simulation.applied import Applied

#: Times as many draws as are wanted that are tried at most.
TRIED = 20


def drawn(applied: Applied, count: int, seed: int) -> tuple[list[Array], int]:
    """Parameter vectors from the coefficients' covariance, and how many were refused on the way.

    A draw outside the bounds of a coefficient, or with masses no body has, is replaced by another: the normal
    distribution is cut off there.

    Raises
    ------
    NoTrustworthyResult
        Where hardly a draw is possible: the covariance says nothing.
    """
    model = applied.model
    names, covariance = applied.uncertain()
    centre = applied.values()
    index = [model.index(name) for name in names]
    sd = np.sqrt(np.diag(covariance))
    # a root of the correlation, which may be singular where coefficients share a value
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    refused = 0
    while len(found) < count:
        if refused > TRIED * count:
            raise NoTrustworthyResult(
                "hardly a draw of the coefficients from their covariance is possible",
                hint="they lie at their bounds or are hardly known; hold them (--set) or fit them better",
            )
        moved = centre.copy()
        moved[index] += root @ rng.standard_normal(len(names))
        if _possible(model, moved, index):
            found.append(moved)
        else:
            refused += 1
    return found, refused


def _possible(model: Model, values: Array, index: list[int]) -> bool:
    if any(not model.parameters[k].lower <= values[k] <= model.parameters[k].upper for k in index):
        return False
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True
