"""Draws of the coefficients from the covariance in a parameter file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult
from swimid.fitting.model import Array, Model
from swimid.simulation.applied import Applied

#: Number of draws that are made at once, and the largest number in all.
BLOCK, MAX_DRAWS = 50_000, 5_000_000


@dataclass(frozen=True)
class Draws:
    """Draws of the coefficients.

    Attributes
    ----------
    vectors : list of ndarray
        Parameters of the model.
    inside : float
        Share of the draws that were within the bounds; the others were replaced.
    """

    vectors: list[Array]
    inside: float


def drawn(applied: Applied, count: int, seed: int) -> Draws:
    """Draw parameter vectors from the coefficients' covariance.

    The normal distribution is cut off at the bounds of each coefficient, and where a body would have masses
    no body has: a draw there is replaced by another.

    Raises
    ------
    NoTrustworthyResult
        When hardly a draw is possible.
    """
    model, centre = applied.model, applied.values()
    names, covariance = applied.uncertain()
    index = [model.index(name) for name in names]
    lower = np.array([model.parameters[k].lower for k in index])
    upper = np.array([model.parameters[k].upper for k in index])
    sd = np.sqrt(np.diag(covariance))
    # a root of the correlation, which may be singular where coefficients share a value
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    for made in range(0, MAX_DRAWS, BLOCK):
        moved = centre[index] + rng.standard_normal((BLOCK, len(names))) @ root.T
        for k in np.flatnonzero(((moved >= lower) & (moved <= upper)).all(axis=1)):
            vector = centre.copy()
            vector[index] = moved[k]
            if _is_possible(model, vector):
                found.append(vector)
            if len(found) == count:
                return Draws(found, count / (made + int(k) + 1))
    raise NoTrustworthyResult(
        "hardly a draw of the coefficients from their covariance is possible",
        hint="they lie at their bounds or are hardly known; hold them (--set) or fit them better",
    )


def _is_possible(model: Model, values: Array) -> bool:
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True
