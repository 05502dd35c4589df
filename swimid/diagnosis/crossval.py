"""Linear algebra of held-out comparisons: approximate leave-group-out cross-validation.

Near an optimum everything a comparison asks (refits without a fold, the misfit of that fold, what noise
alone would do) follows from the inner products of a few columns in each fold: derivatives to shared
numbers, changes by effects, residuals. A fold is left out by one Gauss-Newton step from the fit to all
(Rad and Maleki 2020, J. R. Stat. Soc. B 82(4)); noise colour and spreads stay those of all trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.noise_model import NoiseModel
from swimid.fitting.model import Array

#: Where the other folds hardly tell a shared number, it leans on all of them by this share of what they
#: tell together: left to itself it would throw the held-out fold anywhere, and hide what an effect gains.
SHRINKAGE = 0.1


@dataclass(frozen=True)
class NormalEquations:
    """Inner products of columns in each fold, start states of single trials projected out.

    Attributes
    ----------
    products : ndarray, shape (folds, c, c)
        Columns: shared numbers first (``shared`` of them), then others, the residual last.
    prior : ndarray, shape (shared, shared)
        Precision of what is known of the shared numbers.
    pull : ndarray, shape (shared,)
        Prior mean less the present value, of the shared numbers.
    samples : ndarray, shape (folds,)
    """

    products: Array
    prior: Array
    pull: Array
    samples: Array

    @property
    def shared(self) -> int:
        """How many columns are shared numbers."""
        return len(self.prior)


@dataclass(frozen=True)
class Drawn:
    """Draws of what noise alone would show.

    Attributes
    ----------
    right : ndarray, shape (folds, c - 1, m)
        Inner products of the columns with m other residuals.
    pull : ndarray, shape (shared, m)
        What the prior means would be off.
    """

    right: Array
    pull: Array


def project_out(
    context: FitContext,
    fit: Fit,
    noise_model: NoiseModel,
    k: int,
    block: Array,
    *,
    to: NDArray[np.intp] | None = None,
) -> Array:
    """Whitened columns of a trial, what its own numbers imitate taken out of them.

    Parameters
    ----------
    block : ndarray, shape (n_k, c)
        Weighted; the last column is the residual.
    to : ndarray of int, optional
        Own numbers that are taken out; default all of this trial that are free to move.

    Returns
    -------
    ndarray, shape (n_k + m, c)
        The trial's samples, then the prior of its own numbers: all inner products are those of columns in the
        noise that the numbers, unknown, add to.
    """
    problem = fit.problem
    mine = fit.free_of_trial(k) if to is None else to
    if not len(mine):
        return noise_model.whiten(problem, k, block)
    mean, weight = context.expected(problem)
    n, scale = len(block), problem.scale[mine]
    seen = noise_model.whiten(problem, k, np.column_stack((fit.rows[k][:, mine] * scale, block)))
    own = np.vstack((seen[:, : len(mine)], np.diag(weight[mine] * scale)))
    wanted = np.vstack((seen[:, len(mine) :], np.zeros((len(mine), block.shape[1]))))
    wanted[n:, -1] = weight[mine] * (mean - fit.theta)[mine]
    normal = own.T @ own
    return np.asarray(wanted - own @ solved(normal, own.T @ wanted))


def normal_equations(
    context: FitContext, fit: Fit, noise_model: NoiseModel, columns: Sequence[Sequence[Array]] = ()
) -> NormalEquations:
    """Inner products of a fit's derivatives, further columns and its residuals, fold by fold.

    Parameters
    ----------
    columns : sequence of lists of ndarray
        Each a change of all trials, weighted, shape (n_k,) each.
    """
    problem = fit.problem
    whole = context.folds.whole
    mean, _ = context.expected(problem)
    shared = context.shared(fit)
    count = context.folds.count
    width = len(shared) + len(columns) + 1
    products = np.zeros((count, width, width))
    samples = np.zeros(count)
    for k in range(len(context.trials)):
        mine = context.apart(fit, k)
        block = np.column_stack([fit.rows[k][:, shared], *(c[k] for c in columns), fit.residuals[k]])
        seen = project_out(context, fit, noise_model, k, block, to=mine)
        owner = context.folds.owner[k]
        if whole:
            f = int(owner[0]) if len(owner) else 0
            products[f] += seen.T @ seen
            samples[f] += len(block)
        else:
            # of a start state the trials tell so much that what was known of it before is nothing
            for f in np.unique(owner):
                part = seen[: len(block)][owner == f]
                products[f] += part.T @ part
                samples[f] += len(part)
    prior = context.precision(problem)[np.ix_(shared, shared)]
    return NormalEquations(products, prior, (mean - fit.theta)[shared], samples)


def held_out(
    equations: NormalEquations,
    chosen: Sequence[int] = (),
    prior: Sequence[float] = (),
    draws: Drawn | None = None,
) -> Array:
    """Misfit of each fold with everything fitted on the other folds.

    What is known of the shared numbers from elsewhere are data, too: each fold bears its part of how far the
    others' fit is from it.

    Parameters
    ----------
    chosen : sequence of int
        Further columns that take part, counted from the first one after the shared numbers.
    prior : sequence of float
        Inverse variance of each of their factors.
    draws : Drawn, optional
        Of m other residuals; the misfit is then less that of the residuals themselves.

    Returns
    -------
    ndarray, shape (folds,) or (folds, m)
        Squared residuals.
    """
    at = np.concatenate(
        (np.arange(equations.shared), equations.shared + np.asarray(chosen, dtype=int))
    ).astype(int)
    inner = equations.products[:, at[:, None], at[None, :]]
    ridge = block_diag(equations.prior, np.diag(np.asarray(prior, dtype=float)))
    off = equations.pull[:, None] if draws is None else draws.pull
    pull = np.concatenate((equations.prior @ off, np.zeros((len(chosen), off.shape[1]))))
    right = equations.products[:, at, -1][:, :, None] if draws is None else draws.right[:, at, :]
    theta = _without(inner, ridge, right, pull, equations.shared)
    misfit = np.sum(theta * (inner @ theta - 2.0 * right), axis=1) + _strain(equations, theta, off)
    return misfit[:, 0] + equations.products[:, -1, -1] if draws is None else misfit


def predictive(equations: NormalEquations) -> Array:
    """Squared Mahalanobis distance of each fold in what the others predict, shape (folds,): by how much it
    raises the squared residuals of the fit to all.
    """
    shared = equations.shared
    off = float(equations.pull @ equations.prior @ equations.pull)

    def left(products: Array) -> float:
        normal = products[:shared, :shared] + equations.prior
        right = (products[:shared, -1] + equations.prior @ equations.pull)[:, None]
        return float(products[-1, -1] + off - (right.T @ solved(normal, right))[0, 0])

    whole = equations.products.sum(axis=0)
    return np.array([left(whole) - left(whole - fold) for fold in equations.products])


def _without(inner: Array, ridge: Array, right: Array, pull: Array, shared: int) -> Array:
    """Numbers fitted without each fold, shape (folds, c, m); shared ones lean on all folds by `SHRINKAGE`."""
    total, all_right = inner.sum(axis=0), right.sum(axis=0)
    whole = solved(total + ridge, all_right + pull)
    lean = np.zeros_like(total)
    lean[:shared, :shared] = SHRINKAGE * total[:shared, :shared]
    return solved(total - inner + ridge + lean, all_right - right + pull + lean @ whole)


def _strain(equations: NormalEquations, theta: Array, off: Array) -> Array:
    """Each fold's part of how far numbers are from what is known of them, shape (folds, m)."""
    apart = theta[:, : equations.shared] - off
    return np.asarray(np.einsum("jk,fjm,fkm->fm", equations.prior, apart, apart) / len(theta))


def held_out_less(equations: NormalEquations, column: int, factor: float = 1.0) -> Array:
    """Misfit of each fold, as :func:`held_out`, once so much of a further column is off the residuals."""
    at = np.arange(equations.shared)
    c = equations.shared + column
    inner = equations.products[:, at[:, None], at[None, :]]
    right = (equations.products[:, at, -1] - factor * equations.products[:, at, c])[:, :, None]
    off = equations.pull[:, None]
    theta = _without(inner, equations.prior, right, equations.prior @ off, equations.shared)
    misfit = (np.sum(theta * (inner @ theta - 2.0 * right), axis=1) + _strain(equations, theta, off))[:, 0]
    products = equations.products
    return np.asarray(
        misfit + products[:, -1, -1] - 2.0 * factor * products[:, c, -1] + factor**2 * products[:, c, c]
    )


def solved(normal: Array, right: Array) -> Array:
    """Solutions of scaled normal equations, stacked or single; directions nothing tells stay at zero.

    Parameters
    ----------
    normal : ndarray, shape (..., n, n)
    right : ndarray, shape (..., n, m)
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = scale[..., :, None] * normal * scale[..., None, :]
    scaled = scaled + 1e-11 * np.eye(normal.shape[-1])
    try:
        return np.asarray(scale[..., :, None] * np.linalg.solve(scaled, scale[..., :, None] * right))
    except np.linalg.LinAlgError:
        return np.asarray(scale[..., :, None] * (np.linalg.pinv(scaled) @ (scale[..., :, None] * right)))


def together(equations: NormalEquations, chosen: Sequence[int], prior: Sequence[float]) -> Array:
    """Factors of shared numbers and chosen columns fitted to all folds at once, shape (shared + chosen,)."""
    at = np.concatenate(
        (np.arange(equations.shared), equations.shared + np.asarray(chosen, dtype=int))
    ).astype(int)
    total = equations.products.sum(axis=0)
    normal = total[np.ix_(at, at)] + block_diag(equations.prior, np.diag(np.asarray(prior, dtype=float)))
    right = total[at, -1] + np.concatenate((equations.prior @ equations.pull, np.zeros(len(chosen))))
    return solved(normal, right[:, None])[:, 0]


def projected(equations: NormalEquations) -> Array:
    """Inner products of the further columns and the residual with all shared numbers projected out.

    Returns
    -------
    ndarray, shape (m + 1, m + 1)
    """
    total = equations.products.sum(axis=0)
    s = equations.shared
    normal = total[:s, :s] + equations.prior
    mixed = total[:s, s:]
    return np.asarray(total[s:, s:] - mixed.T @ solved(normal, mixed))


def noise_draws(equations: NormalEquations, rng: np.random.Generator, count: int) -> Drawn:
    """So many draws of pure noise, and of what is known from elsewhere."""
    found = np.empty((len(equations.products), equations.products.shape[1] - 1, count))
    for f, inner in enumerate(equations.products[:, :-1, :-1]):
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        sizes, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
        root = vectors * np.sqrt(np.maximum(sizes, 0.0))
        found[f] = scale[:, None] * (root @ rng.standard_normal((len(scale), count)))
    known = np.flatnonzero(np.diag(equations.prior) > 0)
    root = np.linalg.cholesky(equations.prior[np.ix_(known, known)])
    off = np.zeros((equations.shared, count))
    drawn = rng.standard_normal((equations.shared, count))
    off[known] = np.linalg.solve(root.T, drawn[known])
    return Drawn(found, off)
