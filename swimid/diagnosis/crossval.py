"""Normal equations of a fit in each cross-validation fold, and predictions that they give without a refit.

Near an optimum the simulation is linear in the parameters. A refit without one fold is then one Gauss-Newton
step from the fit to all data (Rad and Maleki 2020, J. R. Stat. Soc. B 82(4)). The step and the predictive
density of the fold follow from the inner products of a few columns in each fold, with and without an effect.
The columns are derivatives with respect to shared parameters, changes due to effects, and residuals. The
noise model is not re-estimated without the fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.linalg import block_diag

from swimid.fitting.intervals import NORMAL
from swimid.fitting.model import Array

if TYPE_CHECKING:
    from swimid.diagnosis.noise import NoiseModel
    from swimid.diagnosis.study import GapStudy, Hypothesis

#: Weight, in a refit without one fold, of the information that all folds give on the shared parameters.
#: Without this weight, a parameter that the other folds hardly determine would make the prediction of the
#: held-out fold arbitrarily bad, which would hide the gain of an effect.
SHRINKAGE = 0.1


@dataclass(frozen=True)
class NormalEquations:
    """Inner products, in each fold, of parameter derivatives, changes due to effects, and residuals.

    The parameters of single trials are projected out.

    Attributes
    ----------
    products : ndarray, shape (folds, c, c)
            Inner products of c columns: first the ``shared`` parameters, then changes due to effects, last
            the residual.
    prior : ndarray, shape (shared, shared)
        Prior precision of the shared parameters.
    pull : ndarray, shape (shared,)
        Prior mean minus estimate of the shared parameters.
    samples : ndarray, shape (folds,)
        Number of samples in each fold.
    own : ndarray, shape (folds,)
        Logarithm of the ratio of posterior and prior precision of the values that an effect has in the single
        trials of the fold.
    of_effects : ndarray of bool, shape (shared,)
        Mask of the shared parameters that belong to effects.
    random : ndarray, shape (folds, q, c)
            For each fold, the sums over its trials of the q random effects whose mean is held at 0: the
            change of each sum by a step in each column, and in the last column its value.
    spread : ndarray, shape (folds, q, q)
            Sums, over the trials of the fold, of the covariance matrices of these random effects.
    """

    products: Array
    prior: Array
    pull: Array
    samples: Array
    own: Array
    of_effects: NDArray[np.bool_]
    random: Array
    spread: Array

    @property
    def n_shared(self) -> int:
        """Return the number of shared parameters."""
        return len(self.prior)

    @cached_property
    def whole(self) -> Array:
        """Return the inner products of all folds, shape (c, c)."""
        total = self.products.sum(axis=0)
        return np.asarray(total + _of_mean(self.random.sum(axis=0), self.spread.sum(axis=0)))

    @cached_property
    def rest(self) -> Array:
        """Return the inner products of all folds but one, for each fold, shape (folds, c, c)."""
        random, spread = (part.sum(axis=0) - part for part in (self.random, self.spread))
        return np.asarray(self.products.sum(axis=0) - self.products + _of_mean(random, spread))


def _of_mean(random: Array, spread: Array) -> Array:
    """Return the inner products of the constraint that holds the mean of random effects at 0.

    The constraint belongs to the least-squares problem, from which the random effects of each trial are
    eliminated.
    """
    return np.swapaxes(random, -1, -2) @ solve_normal(spread, random)


@dataclass(frozen=True)
class NoiseDraws:
    """Random samples of noise residuals and of prior means, which replace those of a fit.

    Attributes
    ----------
    right : ndarray, shape (folds, c - 1, m)
            Inner products of the columns of :class:`NormalEquations` with m random noise residuals.
    pull : ndarray, shape (shared, m)
        Random deviations of the prior means.
    """

    right: Array
    pull: Array


def project_out(
    study: GapStudy,
    fit: Hypothesis,
    k: int,
    block: Array,
    *,
    to: NDArray[np.intp] | None = None,
    noise: NoiseModel | None = None,
) -> Array:
    """Return whitened columns of a trial, with the parameters that only this trial has projected out.

    Parameters
    ----------
    block : ndarray, shape (n_k, c)
            Columns for the n_k samples of trial ``k``, divided by the weights; the last column is the
            residual.
    to : ndarray of int, optional
        Indices of the parameters that are projected out. By default these are all parameters that only
        this trial has and that are not at a bound.
    noise : NoiseModel, optional
        Default: the noise of the study.

    Returns
    -------
    ndarray, shape (n_k + m, c)
        One row for each sample, then one row for the prior of each of the m projected parameters. Inner
        products of the columns account for the uncertainty of these parameters.
    """
    problem, noise = fit.problem, noise or study.noise
    inside = fit.inside
    mine = np.array([j for j in problem.own(k) if inside[j]], dtype=int) if to is None else to
    if not len(mine):
        return noise.whiten(problem, k, block)
    mean, weight = study.compute_prior(problem)
    n, scale = len(block), problem.scale[mine]
    seen = noise.whiten(problem, k, np.column_stack((fit.columns(k, mine) * scale, block)))
    own = np.vstack((seen[:, : len(mine)], np.diag(weight[mine] * scale)))
    wanted = np.vstack((seen[:, len(mine) :], np.zeros((len(mine), block.shape[1]))))
    wanted[n:, -1] = weight[mine] * (mean - fit.theta)[mine]
    return np.asarray(wanted - own @ solve_normal(own.T @ own, own.T @ wanted))


def form_normal_equations(
    study: GapStudy, fit: Hypothesis, columns: Sequence[Sequence[Array]] = ()
) -> NormalEquations:
    """Return the inner products in each fold of parameter derivatives, further columns and residuals.

    Parameters
    ----------
    columns : sequence of lists of ndarray
            Each item is a change of all trials, divided by the weights: one array of shape (n_k,) for each
            trial with n_k samples.
    """
    problem, folds = fit.problem, study.folds
    mean, _ = study.compute_prior(problem)
    shared, centred = study.select_shared(fit), study.zero_mean_names
    width = len(shared) + len(columns) + 1
    products = np.zeros((folds.count, width, width))
    samples, own = np.zeros(folds.count), np.zeros(folds.count)
    random, spread = (np.zeros((folds.count, len(centred), size)) for size in (width, len(centred)))
    for k in range(len(study.trials)):
        mine = study.select_own(fit, k)
        block = np.column_stack([fit.columns(k, shared), *(c[k] for c in columns), fit.residuals[k]])
        seen = project_out(study, fit, k, block, to=mine)
        owner = folds.owner[k]
        if folds.whole:
            f = int(owner[0]) if len(owner) else 0
            products[f] += seen.T @ seen
            samples[f] += len(block)
            names = [problem.parameters[problem.slots[j][0]].name for j in mine]
            ratio, covariance = _own_precision(study, fit, k, mine, names)
            own[f] += ratio
            # The rows of the priors hold the random effects in units of their prior standard deviations.
            at = np.array([names.index(name) for name in centred], dtype=int)
            random[f] += seen[len(block) :][at]
            spread[f] += covariance[np.ix_(at, at)]
        else:
            # The samples determine an initial state so well that the rows of its prior are left out.
            for f in np.unique(owner):
                part = seen[: len(block)][owner == f]
                products[f] += part.T @ part
                samples[f] += len(part)
    prior = study.precision(problem)[np.ix_(shared, shared)]
    of_effects = np.array(["/" in fit.labels[j] for j in shared], dtype=bool)
    pull = (mean - fit.theta)[shared]
    return NormalEquations(products, prior, pull, samples, own, of_effects, random, spread)


def _own_precision(
    study: GapStudy, fit: Hypothesis, k: int, mine: NDArray[np.intp], names: Sequence[str]
) -> tuple[float, Array]:
    """Return the logarithm of the ratio of posterior and prior precision of the values that effects have in
    one trial, and the covariance matrix of all its own parameters in units of their priors.
    """
    is_effect = np.array(["/" in name for name in names], dtype=bool)
    if not is_effect.any():
        return 0.0, np.eye(len(mine))
    weight = study.compute_prior(fit.problem)[1][mine]
    rows = study.noise.whiten(fit.problem, k, fit.columns(k, mine)) / weight
    seen: Array = np.asarray(np.linalg.qr(rows, mode="r"))
    # Use singular values: in normal equations, the prior is lost beside large derivatives of a few samples.
    _, sizes, axes = np.linalg.svd(seen)
    gained = np.zeros(len(mine))
    gained[: len(sizes)] = sizes**2
    others = np.linalg.svd(seen[:, ~is_effect], compute_uv=False) ** 2
    ratio = float(np.log1p(gained).sum() - np.log1p(others).sum())
    return ratio, (axes.T / (1.0 + gained)) @ axes


def compute_deviances(equations: NormalEquations) -> tuple[Array, Array]:
    """Return minus twice the log predictive density of each fold, given the other folds, up to a constant.

    The first part is the squared Mahalanobis distance of the fold from its prediction. Noise, shared
    parameters and parameters of single trials are uncertain in the prediction. For a correct model its
    expectation is the number of samples. The second part is the log-determinant of the covariance of the
    prediction.

    Returns
    -------
    distance, log_determinant : ndarray, shape (folds,)
    """
    shared, prior = equations.n_shared, equations.prior
    if not shared:
        return equations.products[:, -1, -1], equations.own
    scale = 1.0 / np.sqrt(np.maximum(np.diag(equations.whole[:shared, :shared] + prior), 1e-300))

    def fit(products: Array) -> tuple[Array, Array]:
        """Return the log-determinants of normal equations, and by how much their fits reduce the squares."""
        normal = products[:, :shared, :shared] + prior
        right = products[:, :shared, -1] + prior @ equations.pull
        scaled = scale[:, None] * normal * scale + 1e-11 * np.eye(shared)
        steps = solve_normal(normal, right[..., None])[..., 0]
        return np.linalg.slogdet(scaled)[1], np.sum(steps * right, axis=-1)

    log, taken = fit(equations.rest + equations.products)
    rest, other = fit(equations.rest)
    distance = equations.products[:, -1, -1] - taken + other
    return np.asarray(distance), np.asarray(log - rest + equations.own)


def compute_strain(equations: NormalEquations) -> float:
    """Return the squared distance of the model's parameters, at the optimum of all folds, from their priors.

    The distance is in units of the prior covariance. Parameters of effects are not counted.
    """
    s, prior = equations.n_shared, equations.prior
    total = equations.whole
    right = total[:s, -1] + prior @ equations.pull
    away = solve_normal(total[:s, :s] + prior, right[:, None])[:, 0] - equations.pull
    away[equations.of_effects] = 0.0
    return float(away @ prior @ away)


def compute_held_out(
    equations: NormalEquations,
    chosen: Sequence[int] = (),
    prior: Sequence[float] = (),
    draws: NoiseDraws | None = None,
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
    draws : NoiseDraws, optional
        Random noise residuals that replace the residuals of the fit. The result then excludes the sum of
        squares of these random residuals themselves.

    Returns
    -------
    ndarray, shape (folds,) or (folds, m)
        Sums of squared residuals.
    """
    at, ridge = _select_columns(equations, chosen, prior)
    off = equations.pull[:, None] if draws is None else draws.pull
    pull = np.concatenate((equations.prior @ off, np.zeros((len(chosen), off.shape[1]))))
    shared, square = equations.n_shared, np.ix_(at, at)
    inner, rest = (part[:, at[:, None], at] for part in (equations.products, equations.rest))
    if draws is None:
        parts = equations.products, equations.whole, equations.rest
        right, all_right, other = (part[..., at, -1:] for part in parts)
    else:
        right = draws.right[:, at, :]
        all_right = right.sum(axis=0)
        other = all_right - right
    total = equations.whole[square]
    whole = solve_normal(total + ridge, all_right + pull)
    # Keep a small weight of the held-out fold's information on the shared parameters (see SHRINKAGE).
    lean = np.zeros_like(total)
    lean[:shared, :shared] = SHRINKAGE * total[:shared, :shared]
    theta = solve_normal(rest + ridge + lean, other + pull + lean @ whole)
    apart = theta[:, :shared] - off
    strain = np.einsum("jk,fjm,fkm->fm", equations.prior, apart, apart) / len(theta)
    misfit = np.sum(theta * (inner @ theta - 2.0 * right), axis=1) + strain
    return misfit[:, 0] + equations.products[:, -1, -1] if draws is None else misfit


def _select_columns(
    equations: NormalEquations, chosen: Sequence[int], prior: Sequence[float]
) -> tuple[NDArray[np.intp], Array]:
    """Return the indices of the fitted columns, and their prior precision matrix.

    The fitted columns are those of the shared parameters and those of the chosen changes.
    """
    at = [*range(equations.n_shared), *(equations.n_shared + i for i in chosen)]
    return np.array(at, dtype=np.intp), block_diag(equations.prior, np.diag(np.asarray(prior, dtype=float)))


def compute_held_out_less(equations: NormalEquations, column: int, factor: float = 1.0) -> Array:
    """Return the squared held-out residuals of each fold with a multiple of one column subtracted.

    The residual is reduced by ``factor`` times the further column ``column``. Everything else is as in
    :func:`compute_held_out`.
    """
    products, random = equations.products.copy(), equations.random.copy()
    change = equations.n_shared + column
    products[:, :, -1] -= factor * products[:, :, change]
    products[:, -1, :] -= factor * products[:, change, :]
    random[:, :, -1] -= factor * random[:, :, change]
    return compute_held_out(replace(equations, products=products, random=random))


def fit_columns(equations: NormalEquations, chosen: Sequence[int], prior: Sequence[float]) -> Array:
    """Fit the shared parameters together with a factor for each chosen column, to all folds.

    The result has shape (shared + chosen,): first the steps of the shared parameters, then the factors.
    """
    at, ridge = _select_columns(equations, chosen, prior)
    total = equations.whole
    normal = total[np.ix_(at, at)] + ridge
    right = total[at, -1] + np.concatenate((equations.prior @ equations.pull, np.zeros(len(chosen))))
    return solve_normal(normal, right[:, None])[:, 0]


def project_columns(equations: NormalEquations) -> Array:
    """Return inner products of the further columns and the residual, summed over folds.

    All shared parameters are projected out.

    Returns
    -------
    ndarray, shape (m + 1, m + 1)
        The residual comes after the m further columns.
    """
    total, s = equations.whole, equations.n_shared
    normal = total[:s, :s] + equations.prior
    mixed = total[:s, s:]
    return np.asarray(total[s:, s:] - mixed.T @ solve_normal(normal, mixed))


def compute_covariances(equations: NormalEquations) -> tuple[Array, Array]:
    """Return the covariance of the shared parameters from all folds, and without each fold.

    Returns
    -------
    ndarray, shapes (shared, shared) and (folds, shared, shared)
    """
    s, count = equations.n_shared, len(equations.products)
    whole, rest = (part[..., :s, :s] + equations.prior for part in (equations.whole, equations.rest))
    return solve_normal(whole, np.eye(s)), solve_normal(rest, np.broadcast_to(np.eye(s), (count, s, s)))


def compute_covariance(study: GapStudy, fit: Hypothesis) -> Array:
    """Return the covariance matrix of the parameters of a fit, shape (p, p).

    The standard errors of shared parameters are at least those of the jackknife over folds, with Student's
    distribution [1]_. They therefore include errors of the assumed form of an effect, and differences between
    the folds. The standard error of the sum of a parameter and its change has the same minimum. The data
    determine the sum well, although its two parts are uncertain.

    References
    ----------
    .. [1] J. G. MacKinnon, H. White, "Some heteroskedasticity-consistent covariance matrix estimators with
       improved finite sample properties", Journal of Econometrics 29 (1985), 305-325. Jackknife (HC3), here
       of clusters.
    """
    normal = study.precision(fit.problem)
    for k, rows in enumerate(fit.derivatives):
        seen, own = study.noise.whiten(fit.problem, k, rows), fit.problem.taken[k]
        normal[np.ix_(own, own)] += seen.T @ seen
    found = invert_normal(normal)
    equations = form_normal_equations(study, fit)
    shared, count = study.select_shared(fit), study.folds.count
    if count < 2 or not len(shared):
        return found
    s, pulled = equations.n_shared, equations.prior @ equations.pull

    rest, whole = (
        solve_normal(part[..., :s, :s] + equations.prior, (part[..., :s, -1] + pulled)[..., None])
        for part in (equations.rest, equations.whole)
    )
    steps = (rest - whole)[..., 0]
    # Replace each change by its sum with the parameter, for the comparison with the jackknife.
    sums = np.eye(len(found))
    for name, change in fit.changes.items():
        if name in fit.labels:
            sums[fit.labels.index(change), fit.labels.index(name)] = 1.0
    found, steps = sums @ found @ sums.T, steps @ sums[np.ix_(shared, shared)].T
    few = float(special.stdtrit(count - 1, 0.975)) / NORMAL
    jackknife = few * np.sqrt((count - 1) / count * np.sum(steps**2, axis=0))
    factor = np.ones(len(found))
    factor[shared] = np.fmax(jackknife / np.sqrt(np.maximum(np.diag(found)[shared], 1e-300)), 1.0)
    back = 2.0 * np.eye(len(found)) - sums
    return np.asarray(back @ (factor[:, None] * found * factor) @ back.T)


def draw_noise(equations: NormalEquations, rng: np.random.Generator, count: int) -> NoiseDraws:
    """Return random samples of noise residuals and of prior means, for use in :func:`compute_held_out`."""
    found = np.empty((len(equations.products), equations.products.shape[1] - 1, count))
    for f, inner in enumerate(equations.products[:, :-1, :-1]):
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        sizes, vectors = np.linalg.eigh(inner / np.outer(scale, scale))
        root = vectors * np.sqrt(np.maximum(sizes, 0.0))
        found[f] = scale[:, None] * (root @ rng.standard_normal((len(scale), count)))
    known = np.flatnonzero(np.diag(equations.prior) > 0)
    root = np.linalg.cholesky(equations.prior[np.ix_(known, known)])
    off = np.zeros((equations.n_shared, count))
    drawn = rng.standard_normal((equations.n_shared, count))
    off[known] = np.linalg.solve(root.T, drawn[known])
    return NoiseDraws(found, off)


# ---------------------------------------------------------------- linear algebra


def invert_normal(normal: Array) -> Array:
    """Return the inverse of a normal matrix, without the directions that the data do not determine."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = scale[:, None] * normal * scale
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    return np.asarray(scale[:, None] * inverse * scale)


def solve_normal(normal: Array, right: Array) -> Array:
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
