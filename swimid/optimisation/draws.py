"""Draws of the coefficients from what a parameter file knows of them."""

from __future__ import annotations

import numpy as np
from scipy.stats import truncnorm

from swimid.errors import InputError
from swimid.fitting.model import Array, Model
from swimid.simulation.applied import Applied

#: Times as many independent draws as are wanted that are tried at most.
TRIED = 20
#: Sweeps of the Gibbs sampler before each draw. Of two coefficients correlated by r, draws so many sweeps
#: apart are correlated by r to the power of twice that (Roberts and Sahu 1997): below 0.02 for r = 0.9.
SWEEPS = 20


def drawn(applied: Applied, count: int, seed: int) -> tuple[list[Array], int]:
    """Parameter vectors from the coefficients' covariance, and how many independent draws were refused.

    The normal distribution is cut off at the bounds of each coefficient, and where a body would have masses
    no body has: a draw there is replaced by another. Where hardly one is possible, of coefficients that lie
    at their bounds or are hardly known, a Gibbs sampler moves within what is possible (Geweke 1991).
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
            return _sampled(model, centre, index, root, count, rng), refused
        moved = centre.copy()
        moved[index] += root @ rng.standard_normal(len(names))
        if _possible(model, moved, index):
            found.append(moved)
        else:
            refused += 1
    return found, refused


def _sampled(
    model: Model, centre: Array, index: list[int], root: Array, count: int, rng: np.random.Generator
) -> list[Array]:
    """Draws of a Gibbs sampler, from the estimates on, in the independent normal numbers behind them."""
    own = [model.parameters[k] for k in index]
    lower, upper = np.array([p.lower for p in own]), np.array([p.upper for p in own])

    def vector(z: Array) -> Array:
        moved = centre.copy()
        moved[index] = np.clip(centre[index] + root @ z, lower, upper)
        return moved

    z, found = np.zeros(root.shape[1]), []
    for _ in range(count):
        for j in [*range(len(z))] * SWEEPS:
            column = root[:, j]
            rest = centre[index] + root @ z - column * z[j]
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = np.sort([(lower - rest) / column, (upper - rest) / column], axis=0)[:, column != 0.0]
            low, high = np.max(ends[0], initial=-np.inf), np.min(ends[1], initial=np.inf)
            if low < high:
                tried = z.copy()
                tried[j] = truncnorm.ppf(rng.random(), low, high)
                z = tried if _possible(model, vector(tried), index) else z
        found.append(vector(z))
    return found


def _possible(model: Model, values: Array, index: list[int]) -> bool:
    if any(not model.parameters[k].lower <= values[k] <= model.parameters[k].upper for k in index):
        return False
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True
