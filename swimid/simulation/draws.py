"""Random samples of the parameters of a model from their covariance."""

from __future__ import annotations

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting.model import Array
from swimid.simulation.catalogue import Applied, is_possible

#: Number of random samples of the coefficients that are drawn at once, and maximum number of samples that are
#: drawn.
BLOCK, MAX_DRAWS = 50_000, 5_000_000


def draw_parameters(applied: Applied, count: int, seed: int) -> tuple[list[Array], float]:
    """Draw random parameter vectors from the covariance of the coefficients.

    The normal distribution is truncated at the bounds of each coefficient, and at physically impossible
    masses.

    Returns
    -------
    vectors : list of ndarray
        Parameter vectors of the model.
    inside : float
        Fraction of the samples that lay within the bounds. The others were replaced.

    Raises
    ------
    NoTrustworthyResult
        If fewer than ``count`` of MAX_DRAWS samples are possible.
    """
    model, centre = applied.model, applied.values()
    names, covariance = applied.uncertain()
    index = [model.index(name) for name in names]
    lower = np.array([model.parameters[k].lower for k in index])
    upper = np.array([model.parameters[k].upper for k in index])
    sd = np.sqrt(np.diag(covariance))
    # use eigenvectors, because the correlation matrix is singular if coefficients share a value
    values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
    root = sd[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    for made in range(0, MAX_DRAWS, BLOCK):
        moved = centre[index] + rng.standard_normal((BLOCK, len(names))) @ root.T
        for k in np.flatnonzero(((moved >= lower) & (moved <= upper)).all(axis=1)):
            vector = centre.copy()
            vector[index] = moved[k]
            if is_possible(model, vector):
                found.append(vector)
            if len(found) == count:
                return found, count / (made + int(k) + 1)
    raise NoTrustworthyResult(
        "hardly a draw of the coefficients from their covariance is possible",
        hint="they lie at their bounds or have large standard errors; hold them (--set) or add trials",
    )
