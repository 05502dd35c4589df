"""Covariance of output-error estimates, and identifiability of parameters and of their combinations.

The covariance allows for coloured residuals, and for trials that differ by more than their noise. The
identifiability follows from the information matrix, which is the inverse of the covariance. The information
matrix is finite even if the trials do not determine a parameter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.linalg import matmul_toeplitz
from scipy.sparse import csgraph

from swimid.fitting.metrics import FitResult
from swimid.fitting.model import Array
from swimid.fitting.problem import Problem
from swimid.results import numbers

#: Significance level of the test that all trials have the same parameters, to within their noise.
HETEROGENEITY = 1e-3


def _autocorrelation(coefficients: Array, lags: int) -> Array:
    """Return the autocorrelation of an autoregression at lags 0 .. lags, shape (lags + 1,)."""
    if len(coefficients) == 0:
        return np.eye(1, lags + 1)[0]
    from scipy.signal import lfilter

    # autocorrelation of the impulse response of 1 / A, which is computed until it has decayed
    length = lags + 1 + min(20000, max(2000, 10 * lags))
    response = lfilter([1.0], np.concatenate(([1.0], coefficients)), np.eye(1, length)[0])
    spectrum = np.fft.rfft(response, 2 * length)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    return np.asarray(covariance / covariance[0])


def _correlated(problem: Problem, rows: list[Array], autoregressions: dict[str, Array]) -> list[Array]:
    """Multiply the rows of each trial by the correlation matrix of the residuals.

    The correlation follows from the autoregression of each channel. Rows after the samples of a trial belong
    to random effects. They are uncorrelated, and stay unchanged.
    """
    longest = max(len(t.time_s) for t in problem.trials)
    rho = {c: _autocorrelation(a, longest - 1) for c, a in autoregressions.items()}
    products = []
    for k, whole in enumerate(rows):
        parts = []
        for channel, mask, part in problem.by_channel(k, whole):
            even = np.zeros((len(mask), whole.shape[1]))
            even[mask] = part
            if len(autoregressions[channel]):
                even = matmul_toeplitz(rho[channel][: len(mask)], even)
            parts.append(even[mask])
        products.append(np.concatenate([*parts, whole[sum(map(len, parts)) :]]))
    return products


def orthogonal_part(others: Array, columns: Array, floor: float) -> Array:
    """Return the part of columns that is orthogonal to all combinations of other columns.

    Directions of the other columns with a singular value below ``floor`` times the largest one are ignored.
    """
    u, singular, _ = np.linalg.svd(others, full_matrices=False)
    seen = u[:, singular > floor * singular.max(initial=0.0)]
    return np.asarray(columns - seen @ (seen.T @ columns))


@dataclass(frozen=True)
class Sandwich:
    """Covariance of least-squares estimates by the sandwich formula, and the quantities that lead to it."""

    #: Covariance ``H^-1 M H^-1`` times the square of ``scatter``, shape (p, p). Rows and columns of
    #: parameters that do not affect the residuals are NaN.
    covariance: Array
    #: True for parameters that do not affect the residuals, shape (p,).
    null: NDArray[np.bool_]
    #: Square root of the information matrix, shape (p, p): ``root' root`` is the inverse of the covariance.
    #: It is accurate even if the covariance is infinite.
    root: Array
    #: Gauss-Newton step to the minimum without bounds, shape (p,).
    step: Array
    #: Mean decrease of the sum of squared residuals for each parameter that is fitted to noise alone. It is 1
    #: for white noise of unit variance, and larger for coloured noise and for trials that disagree.
    gain: float
    #: Ratio of the differences between trials to those that their noise explains, at least 1.
    scatter: float
    #: p-value of the test that the trials agree. The test compares the score of each trial (the gradient of
    #: its cost at the common optimum) with the covariance of that score.
    scatter_p: float


def sandwich(
    problem: Problem, jacobians: list[Array], residuals: list[Array], autoregressions: dict[str, Array]
) -> Sandwich:
    """Compute the covariance of estimates under coloured residuals and trials that disagree.

    Parameters
    ----------
    jacobians, residuals : list of ndarray, each shape (n_k, p) and (n_k,)
        Weighted derivatives and residuals of each trial. Columns are scaled to parameters of similar size.
    autoregressions : dict of channel name to ndarray
        Coefficients of the autoregression of the weighted residuals.

    Notes
    -----
    With the singular value decomposition ``J = U S V'`` the middle factor ``U' R U`` is computed from the
    orthogonal matrix U. A direction that the data hardly determine then has a large variance. It would
    otherwise have a small variance that is only rounding error.
    """
    j = np.concatenate(jacobians)
    samples, unknowns = j.shape
    size = np.linalg.norm(j, axis=0)
    null = size == 0
    size = np.where(null, 1.0, size)
    u, singular, vt = np.linalg.svd(j / size, full_matrices=False)
    good = (singular > 1e-8 * singular[0]) & (singular[0] > 0)
    # a parameter that takes part in an undetermined direction is not identifiable
    null |= (np.abs(vt[~good]) > 1e-3).any(axis=0)
    ends = np.cumsum([0, *(len(r) for r in residuals)])
    directions = [u[a:b] for a, b in itertools.pairwise(ends)]
    coloured = _correlated(problem, directions, autoregressions)
    r = np.concatenate(residuals)
    variance = float(r @ r) / max(samples - unknowns, 1)
    middle = np.sum([a.T @ b for a, b in zip(directions, coloured, strict=True)], axis=0)
    middle = 0.5 * (middle + middle.T)
    back = singular[:, None] * vt * size
    scatter, p_value = _scatter(
        jacobians, [b @ back for b in coloured], residuals, variance, degrees=-int(good.sum())
    )
    spread = scatter * math.sqrt(variance)
    values, vectors = np.linalg.eigh(middle)
    values = np.maximum(values, 1e-9 * values.max(initial=1e-300))
    outer = vt[good].T / singular[good] / size[:, None]
    covariance = spread**2 * outer @ middle[np.ix_(good, good)] @ outer.T
    covariance[null] = covariance[:, null] = np.nan
    return Sandwich(
        covariance=0.5 * (covariance + covariance.T),
        null=null,
        root=(vectors / np.sqrt(values)).T @ back / max(spread, 1e-30),
        step=-outer @ (u[:, good].T @ r),
        # mean of r' U U' r for noise r with the correlation R, divided by the number of columns of U
        gain=spread**2 * float(np.trace(middle[np.ix_(good, good)])) / max(int(good.sum()), 1),
        scatter=scatter,
        scatter_p=p_value,
    )


def _scatter(
    jacobians: list[Array], correlated: list[Array], residuals: list[Array], variance: float, degrees: int
) -> tuple[float, float]:
    """Return the factor by which trials differ more than noise explains, and the p-value of the test."""
    if len(jacobians) < 3:
        return 1.0, 1.0
    statistic = 0.0
    for whole, whole_b, r in zip(jacobians, correlated, residuals, strict=True):
        # leave out the unknowns of other trials: only their rounding errors would enter this score
        own = np.linalg.norm(whole, axis=0) > 0
        a, b = whole[:, own], whole_b[:, own]
        score = a.T @ r
        spread = (a.T @ b) * variance
        scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
        keep = values > 1e-6 * max(values.max(initial=0.0), 1e-300)
        part = vectors[:, keep].T @ (score / scale)
        statistic += float(np.sum(part**2 / values[keep]))
        degrees += int(keep.sum())
    if degrees < 1:
        return 1.0, 1.0
    p_value = float(special.chdtrc(degrees, statistic))
    if p_value >= HETEROGENEITY:
        return 1.0, p_value
    return max(math.sqrt(statistic / degrees), 1.0), p_value


# ---------------------------------------------------------------- identifiability


#: Maximum standard error of an identifiable parameter, as a fraction of its magnitude. The magnitude is the
#: absolute value of the estimate, or the typical scale of the parameter if that is larger.
UNIDENTIFIABLE = 0.5
#: Minimum singular value of a direction that the data determine, as a fraction of the largest singular value.
UNSEEN = 1e-7
#: Minimum standard error of a parameter in a confounded group, as a fraction of its magnitude.
VAGUE = 0.5 * UNIDENTIFIABLE
#: Minimum weight of a parameter in a combination, as a fraction of the largest weight. Smaller weights are
#: left out.
NEGLIGIBLE = 0.01


@dataclass(frozen=True)
class Combination:
    """A weighted sum of parameters that is known although the parameters themselves are not."""

    #: Weight of each label, divided by the largest weight. If the units of the parameters differ, these are
    #: weights of the parameters divided by their :attr:`divisors`.
    weights: dict[str, float]
    #: Labels of all parameters in the confounded group, including those of negligible weight.
    members: tuple[str, ...]
    value: float
    stderr: float
    #: Unit of the sum: that of the parameter whose weight is 1, or ``"1"`` if units differ.
    unit: str
    #: Magnitude of each parameter, with its unit, by which the parameter is divided. Empty if all units are
    #: equal.
    divisors: dict[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Weighted sum as text, such as ``c_f0 + 0.31 c_f13 = 0.0123 ± 0.0002``."""
        terms = ""
        for label, weight in self.weights.items():
            if label in self.divisors:
                label = f"{label}/({self.divisors[label]})"
            factor = f"{abs(weight):.2g} ".removeprefix("1 ")
            terms += f"{' - ' if weight < 0 else ' + '}{factor}{label}"
        terms = f"{terms[1]}{terms[3:]}".removeprefix("+")
        return f"{terms} = {numbers.measured(self.value, self.stderr, self.unit)}"


def unidentifiable(result: FitResult) -> list[str]:
    """Return the labels of the unknowns that the trials do not determine."""
    return [label for label in result.labels if result.status[label] == "unidentifiable"]


def confounded(result: FitResult) -> list[tuple[str, ...]]:
    """Return groups of parameters whose separate effects the trials do not determine.

    At least one parameter of a group is not identifiable, and at least one is shared by all trials. The
    members take part in the same undetermined combination, and each has a standard error above :data:`VAGUE`
    of its magnitude. Parameters that do not affect the residuals are in no group.
    """
    vague = [i for i in _usable(result) if np.linalg.norm(_marginal(result, [i])) * VAGUE < 1.0]
    if len(vague) < 2:
        return []
    _, singular, vt = np.linalg.svd(_marginal(result, vague))
    dark = vt[singular * UNIDENTIFIABLE < 1.0]
    overlap = np.abs(dark.T @ dark) > 0.02
    _, numbers = csgraph.connected_components(overlap, directed=False)
    groups = [
        tuple(result.labels[i] for i, g in zip(vague, numbers, strict=True) if g == n) for n in set(numbers)
    ]
    unknown = set(unidentifiable(result))
    groups = [g for g in groups if len(g) > 1 and unknown & set(g) and any("[" not in label for label in g)]
    return sorted(groups, key=lambda g: result.labels.index(g[0]))


def combinations(result: FitResult) -> list[Combination]:
    """Return for each group of confounded parameters the weighted sum that the trials determine best.

    A group without a known sum is left out. The sum is the leading eigenvector of the information matrix of
    the group. All other parameters are free, and all parameters are divided by their magnitudes.
    """
    found = []
    for group in confounded(result):
        index = [result.labels.index(label) for label in group]
        size = _sizes(result)[index]
        _, singular, vt = np.linalg.svd(_marginal(result, index), full_matrices=False)
        if singular[0] * UNIDENTIFIABLE < 1.0:
            continue
        kept = np.where(np.abs(vt[0]) < NEGLIGIBLE * np.abs(vt[0]).max(), 0.0, vt[0])
        direction = vt[0]
        if _sd(kept, singular, vt) * singular[0] <= 1.1:
            direction = kept
        units = [result.parameter(g).unit for g in group]
        alike = len(set(units)) == 1
        counted, divisors = np.ones(len(group)), {}
        if not alike:
            # each parameter is divided by its rounded magnitude, so that a reader can compute the sum from
            # the text
            short = [f"{s:.2g}" for s in size]
            words = [f"{t} {unit}".removesuffix(" 1") for t, unit in zip(short, units, strict=True)]
            counted, divisors = np.array([float(t) for t in short]), dict(zip(group, words, strict=True))
        weights = direction * counted / size
        one = float(weights[np.argmax(np.abs(weights))])
        weights /= one
        found.append(
            Combination(
                weights={g: float(w) for g, w in zip(group, weights, strict=True) if w != 0},
                members=group,
                value=float(weights @ (result.estimate[index] / counted)),
                stderr=_sd(direction, singular, vt) / abs(one),
                unit=units[0] if alike else "1",
                divisors=divisors,
            )
        )
    return found


def sentences(result: FitResult) -> list[str]:
    """Return sentences for the report on parameters that are not identifiable and on their known sums."""
    known = {c.members: c for c in combinations(result)}
    said, grouped = [], set()
    for group in confounded(result):
        grouped |= set(group)
        names = f"{', '.join(group[:-1])} and {group[-1]}"
        if group in known:
            said.append(f"{names} cannot be separated by these trials; known is {known[group].text}")
        else:
            said.append(f"{names} cannot be separated by these trials, and no sum of them is known")
    alone = [label for label in unidentifiable(result) if label not in grouped]
    own = [label.partition("[") for label in alone if "[" in label]
    for name in dict.fromkeys(name for name, _, _ in own):
        trials = [trial.rstrip("]") for other, _, trial in own if other == name]
        said.append(f"{name} is not identifiable in {', '.join(trials)}")
    return said + [f"{label} is not identifiable from these trials" for label in alone if "[" not in label]


def _sizes(result: FitResult) -> Array:
    """Return the magnitude of each unknown: its absolute value, or its typical scale if that is larger."""
    return np.maximum(np.abs(result.estimate), [result.parameter(label).scale for label in result.labels])


def _usable(result: FitResult) -> list[int]:
    """Return the indices of unknowns that no bound holds; empty if there is no information matrix."""
    if result.information_root.shape[1] != len(result.labels):
        return []
    return [int(i) for i in np.flatnonzero(np.isfinite(result.information_root).all(axis=0))]


def _marginal(result: FitResult, index: Sequence[int]) -> Array:
    """Return a root of the information matrix of some unknowns, scaled by magnitude; all others are free."""
    scaled = result.information_root * _sizes(result)
    others = [i for i in _usable(result) if i not in index]
    chosen = scaled[:, list(index)]
    return orthogonal_part(scaled[:, others], chosen, UNSEEN) if others else chosen


def _sd(direction: Array, singular: Array, vt: Array) -> float:
    """Return the standard error of a weighted sum of scaled parameters; the information is ``vt' s^2 vt``."""
    parts = vt @ direction
    floor = np.maximum(singular, UNSEEN * singular[0])
    return float(np.linalg.norm(parts / floor))
