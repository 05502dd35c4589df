"""Draws of the coefficients from what a parameter file knows of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from swimid.errors import InputError, NoTrustworthyResult
from swimid.fitting.model import Array, Model
from swimid.simulation.applied import Applied

#: Times as many independent draws as are wanted that are tried at most.
TRIED = 20
#: Draws of a Gibbs sampler by which its sweeps are chosen, and how far neighbours among them may be
#: correlated: three standard errors of draws that are independent.
FEWEST, ALIKE = 200, 3.0 / 200**0.5
#: Sweeps between draws at most; a sampler that needs more does not get round.
SWEEPS = 256
#: Halvings of the way from inside the bounds to the estimates.
NEARER = 20


@dataclass(frozen=True)
class Draws:
    """Draws of the coefficients.

    Attributes
    ----------
    vectors : list of ndarray
        Parameters of the model.
    inside, refused : int
        Independent draws within the bounds, and outside. Where fewer are inside than there are vectors, a
        Gibbs sampler drew these.
    """

    vectors: list[Array]
    inside: int
    refused: int


def drawn(applied: Applied, count: int, seed: int) -> Draws:
    """Parameter vectors from the coefficients' covariance.

    The normal distribution is cut off at the bounds of each coefficient, and where a body would have masses
    no body has: a draw there is replaced by another. Where hardly one is possible, of coefficients that lie
    at their bounds or are hardly known, a Gibbs sampler moves within what is possible (Geweke 1991).

    Raises
    ------
    NoTrustworthyResult
        Where the estimates themselves are not possible, or the sampler does not get round.
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
            sampled = _sampled(model, centre, index, root, count, rng)
            return Draws(sampled, len(found), refused)
        moved = centre.copy()
        moved[index] += root @ rng.standard_normal(len(names))
        if _possible(model, moved, index):
            found.append(moved)
        else:
            refused += 1
    return Draws(found, count, refused)


def _sampled(
    model: Model, centre: Array, index: list[int], root: Array, count: int, rng: np.random.Generator
) -> list[Array]:
    """Draws of a Gibbs sampler in the independent normal numbers behind the coefficients.

    It has as many sweeps between draws as make them no more alike than independent ones.
    """
    own = [model.parameters[k] for k in index]
    lower, upper = np.array([p.lower for p in own]), np.array([p.upper for p in own])

    def vector(z: Array) -> Array:
        moved = centre.copy()
        moved[index] = np.clip(centre[index] + root @ z, lower, upper)
        return moved

    def possible(z: Array) -> bool:
        return _possible(model, vector(z), index)

    def chain(z: Array, sweeps: int) -> Array:
        found = np.empty((max(count, FEWEST), len(z)))
        for k in range(len(found)):
            for _ in range(sweeps):
                z = _swept(z, root, lower - centre[index], upper - centre[index], possible, rng)
            found[k] = z
        return found

    if not _possible(model, centre, index):
        raise _impossible()
    draws = chain(_inside(root, lower - centre[index], upper - centre[index], possible), 1)
    sweeps = 1
    while sweeps <= SWEEPS:
        draws = chain(draws[-1], sweeps)
        values = draws @ root.T
        if np.all(np.ptp(values, axis=0) > 0.0):
            away = values - values.mean(axis=0)
            alike = np.sum(away[1:] * away[:-1], axis=0) / np.sum(away**2, axis=0)
            if np.max(alike) <= ALIKE:
                return [vector(z) for z in draws[:count]]
        sweeps *= 2
    raise _impossible()


def _swept(
    z: Array,
    root: Array,
    lower: Array,
    upper: Array,
    possible: Callable[[Array], bool],
    rng: np.random.Generator,
) -> Array:
    """Each number drawn anew between the ends that the bounds leave it, the others as they are.

    Parameters
    ----------
    z : ndarray, shape (q,)
    root : ndarray, shape (p, q)
    lower, upper : ndarray, shape (p,)
        Bounds of ``root @ z``.
    possible : callable
        Whether numbers are possible beyond their bounds: a draw that is not is not taken.
    """
    from scipy.stats import truncnorm

    for j in range(len(z)):
        column = root[:, j]
        rest = root @ z - column * z[j]
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(lower - rest) / column, (upper - rest) / column], axis=0)[:, column != 0.0]
        low, high = np.max(ends[0], initial=-np.inf), np.min(ends[1], initial=np.inf)
        if low < high:
            tried = z.copy()
            tried[j] = truncnorm.ppf(rng.random(), low, high)
            z = tried if possible(tried) else z
    return z


def _inside(root: Array, lower: Array, upper: Array, possible: Callable[[Array], bool]) -> Array:
    """Numbers as far inside all bounds as can be, in shares of their widths, or on the way to the estimates.

    In a corner no number alone may be free to move, though all together are.
    """
    q = root.shape[1]
    sd = np.linalg.norm(root, axis=1)
    width = np.where(np.isfinite(upper - lower), upper - lower, sd)[:, None]
    rows = np.block([[root, width], [-root, width]])
    ends = np.concatenate([upper, -lower])
    there = np.isfinite(ends)
    sides = [(None, None)] * q + [(0.0, 0.5)]
    found = linprog(np.r_[np.zeros(q), -1.0], A_ub=rows[there], b_ub=ends[there], bounds=sides)
    if found.success:
        for share in 0.5 ** np.arange(NEARER):
            z = share * found.x[:q]
            if possible(z):
                return np.asarray(z)
    raise _impossible()


def _impossible() -> NoTrustworthyResult:
    return NoTrustworthyResult(
        "hardly a draw of the coefficients from their covariance is possible",
        hint="they lie at their bounds or are hardly known; hold them (--set) or fit them better",
    )


def _possible(model: Model, values: Array, index: list[int]) -> bool:
    if any(not model.parameters[k].lower <= values[k] <= model.parameters[k].upper for k in index):
        return False
    try:
        if model.swimmer is not None:
            model.swimmer.check(values)
    except InputError:
        return False
    return True
