"""Approximate cross-validation of a fit by linear algebra, without refits.

Near an optimum the simulation is linear in the parameters. A refit without one fold is then one Gauss-Newton
step from the fit to all data (Rad and Maleki 2020, J. R. Stat. Soc. B 82(4)). This step and the squared
residuals of the held-out fold follow from the inner products of a few columns in each fold: derivatives with
respect to shared parameters, changes by effects, and residuals. The gain that noise alone would reach follows
from the same inner products. The noise model is not re-estimated without the fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from swimid.diagnosis.context import Fit, FitContext
from swimid.diagnosis.noise_model import NoiseModel
from swimid.fitting.model import Array

#: Weight, in a refit without one fold, of the information that all folds give on the shared parameters. It
#: matters if the other folds hardly determine a parameter. Without it the held-out fold would be predicted
#: arbitrarily badly, which would hide the gain of an effect.
SHRINKAGE = 0.1


@dataclass(frozen=True)
class NormalEquations:
    """Inner products, in each fold, of parameter derivatives, changes by effects, and residuals.

    The initial states of single trials are projected out.

    Attributes
    ----------
    products : ndarray, shape (folds, c, c)
        Inner products of c columns: first the ``shared`` parameters, then changes by effects, last the
        residual.
    prior : ndarray, shape (shared, shared)
        Prior precision of the shared parameters.
    pull : ndarray, shape (shared,)
        Prior mean minus estimate of the shared parameters.
    samples : ndarray, shape (folds,)
        Number of samples in each fold.
    """

    products: Array
    prior: Array
    pull: Array
    samples: Array

    @property
    def shared(self) -> int:
        """Return the number of shared parameters."""
        return len(self.prior)


@dataclass(frozen=True)
class Drawn:
    """Random samples of noise residuals and of prior means, which replace those of a fit.

    Attributes
    ----------
    right : ndarray, shape (folds, c - 1, m)
        Inner products of the columns with m random noise residuals.
    pull : ndarray, shape (shared, m)
        Random deviations of the prior means.
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
    """Return whitened columns of a trial, with the parameters that only this trial has projected out.

    Parameters
    ----------
    block : ndarray, shape (n_k, c)
        Columns divided by the noise standard deviation; the last column is the residual.
    to : ndarray of int, optional
        Indices of the parameters that are projected out. By default these are all parameters that only this
        trial has and that are not at a bound.

    Returns
    -------
    ndarray, shape (n_k + m, c)
        One row for each sample, then one row for the prior of each of the m projected parameters. Inner
        products of the columns account for the uncertainty of these parameters.
    """
    problem = fit.problem
    mine = fit.free_of_trial(k) if to is None else to
    if not len(mine):
        return noise_model.whiten(problem, k, block)
    mean, weight = context.expected(problem)
    n, scale = len(block), problem.scale[mine]
    seen = noise_model.whiten(problem, k, np.column_stack((fit.columns(k, mine) * scale, block)))
    own = np.vstack((seen[:, : len(mine)], np.diag(weight[mine] * scale)))
    wanted = np.vstack((seen[:, len(mine) :], np.zeros((len(mine), block.shape[1]))))
    wanted[n:, -1] = weight[mine] * (mean - fit.theta)[mine]
    normal = own.T @ own
    return np.asarray(wanted - own @ solved(normal, own.T @ wanted))


def normal_equations(
    context: FitContext, fit: Fit, noise_model: NoiseModel, columns: Sequence[Sequence[Array]] = ()
) -> NormalEquations:
    """Return the inner products in each fold of parameter derivatives, further columns and residuals.

    Parameters
    ----------
    columns : sequence of lists of ndarray
        Each item is a change of all trials, divided by the noise standard deviation: one array of shape
        (n_k,) for each trial.
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
        block = np.column_stack([fit.columns(k, shared), *(c[k] for c in columns), fit.residuals[k]])
        seen = project_out(context, fit, noise_model, k, block, to=mine)
        owner = context.folds.owner[k]
        if whole:
            f = int(owner[0]) if len(owner) else 0
            products[f] += seen.T @ seen
            samples[f] += len(block)
        else:
            # The samples determine an initial state so well that the rows of its prior are left out.
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
    """Return the sum of squared residuals of each fold, with all parameters fitted to the other folds.

    The prior of the shared parameters counts as data. The squared distance of the parameters from their prior
    means is divided equally among the folds.

    Parameters
    ----------
    chosen : sequence of int
        Further columns that are fitted as well. Index 0 is the first column after the shared parameters.
    prior : sequence of float
        Inverse prior variance of the factor of each chosen column.
    draws : Drawn, optional
        Random noise residuals that replace the residuals of the fit. The result then excludes the sum of
        squares of these random residuals themselves.

    Returns
    -------
    ndarray, shape (folds,) or (folds, m)
        Sums of squared residuals.
    """
    at, ridge = _fitted(equations, chosen, prior)
    inner = equations.products[:, at[:, None], at[None, :]]
    off = equations.pull[:, None] if draws is None else draws.pull
    pull = np.concatenate((equations.prior @ off, np.zeros((len(chosen), off.shape[1]))))
    right = equations.products[:, at, -1][:, :, None] if draws is None else draws.right[:, at, :]
    total, all_right, shared = inner.sum(axis=0), right.sum(axis=0), equations.shared
    whole = solved(total + ridge, all_right + pull)
    # Keep a small weight of the held-out fold's information on the shared parameters (see SHRINKAGE).
    lean = np.zeros_like(total)
    lean[:shared, :shared] = SHRINKAGE * total[:shared, :shared]
    theta = solved(total - inner + ridge + lean, all_right - right + pull + lean @ whole)
    apart = theta[:, :shared] - off
    strain = np.einsum("jk,fjm,fkm->fm", equations.prior, apart, apart) / len(theta)
    misfit = np.sum(theta * (inner @ theta - 2.0 * right), axis=1) + strain
    return misfit[:, 0] + equations.products[:, -1, -1] if draws is None else misfit


def _fitted(
    equations: NormalEquations, chosen: Sequence[int], prior: Sequence[float]
) -> tuple[NDArray[np.intp], Array]:
    """Return the indices of the fitted columns, and their prior precision matrix.

    The fitted columns are those of the shared parameters and those of the chosen changes.
    """
    at = [*range(equations.shared), *(equations.shared + i for i in chosen)]
    return np.array(at, dtype=np.intp), block_diag(equations.prior, np.diag(np.asarray(prior, dtype=float)))


def predictive(equations: NormalEquations) -> Array:
    """Return the squared Mahalanobis distance of each fold from its prediction by the other folds.

    The distance is the increase of the squared residuals if the fold is added to a fit of the other folds.
    The result has shape (folds,).
    """
    shared = equations.shared
    off = float(equations.pull @ equations.prior @ equations.pull)

    def left(products: Array) -> float:
        normal = products[:shared, :shared] + equations.prior
        right = (products[:shared, -1] + equations.prior @ equations.pull)[:, None]
        return float(products[-1, -1] + off - (right.T @ solved(normal, right))[0, 0])

    whole = equations.products.sum(axis=0)
    return np.array([left(whole) - left(whole - fold) for fold in equations.products])


def held_out_less(equations: NormalEquations, column: int, factor: float = 1.0) -> Array:
    """Return the squared held-out residuals of each fold with a multiple of one column subtracted.

    The residual is reduced by ``factor`` times the further column ``column``. Everything else is as in
    :func:`held_out`.
    """
    products = equations.products.copy()
    change = equations.shared + column
    products[:, :, -1] -= factor * products[:, :, change]
    products[:, -1, :] -= factor * products[:, change, :]
    return held_out(replace(equations, products=products))


def solved(normal: Array, right: Array) -> Array:
    """Solve scaled normal equations. Undetermined directions of the solution stay at zero.

    Parameters
    ----------
    normal : ndarray, shape (..., n, n)
        One matrix or a stack of matrices.
    right : ndarray, shape (..., n, m)
        Right-hand sides.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = scale[..., :, None] * normal * scale[..., None, :]
    scaled = scaled + 1e-11 * np.eye(normal.shape[-1])
    try:
        return np.asarray(scale[..., :, None] * np.linalg.solve(scaled, scale[..., :, None] * right))
    except np.linalg.LinAlgError:
        return np.asarray(scale[..., :, None] * (np.linalg.pinv(scaled) @ (scale[..., :, None] * right)))


def together(equations: NormalEquations, chosen: Sequence[int], prior: Sequence[float]) -> Array:
    """Fit the shared parameters together with a factor for each chosen column, to all folds.

    The result has shape (shared + chosen,): first the steps of the shared parameters, then the factors.
    """
    at, ridge = _fitted(equations, chosen, prior)
    total = equations.products.sum(axis=0)
    normal = total[np.ix_(at, at)] + ridge
    right = total[at, -1] + np.concatenate((equations.prior @ equations.pull, np.zeros(len(chosen))))
    return solved(normal, right[:, None])[:, 0]


def projected(equations: NormalEquations) -> Array:
    """Return inner products of the further columns and the residual, summed over folds.

    All shared parameters are projected out.

    Returns
    -------
    ndarray, shape (m + 1, m + 1)
        The residual comes after the m further columns.
    """
    total = equations.products.sum(axis=0)
    s = equations.shared
    normal = total[:s, :s] + equations.prior
    mixed = total[:s, s:]
    return np.asarray(total[s:, s:] - mixed.T @ solved(normal, mixed))


def noise_draws(equations: NormalEquations, rng: np.random.Generator, count: int) -> Drawn:
    """Return random samples of noise residuals and of prior means, for use in :func:`held_out`."""
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
