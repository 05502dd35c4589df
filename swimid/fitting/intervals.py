"""Confidence intervals of the estimates of a fit, for autocorrelated noise and trials that differ.

The estimates are those of least squares. Their error is a mixture of Student distributions. Each distribution
belongs to a hypothesis: a noise model (:mod:`swimid.fitting.noise`), a set of shared parameters that differ
between the trials, and standard deviations of these differences. The weights are the probabilities of the
hypotheses. The standard error of an estimate is the half-width that contains 95 % of the mixture, divided by
1.96.

A difference between trials is visible only in contrasts: combinations of the trials' data in which the shared
parameters cancel. Differences without a contrast are reported as such, because no interval contains them.

References
----------
.. [1] C. Roever, "Bayesian random-effects meta-analysis using the bayesmeta R package", Journal of
   Statistical Software 93(6) (2020). Mixtures over the between-trial standard deviation.
.. [2] J. E. Pustejovsky, E. Tipton, "Small-sample methods for cluster-robust variance estimation and
   hypothesis testing in fixed effects models", Journal of Business & Economic Statistics 36 (2018), 672-683.
.. [3] J. C. Pinheiro, D. M. Bates, "Mixed-Effects Models in S and S-PLUS", Springer, 2000.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from swimid.fitting.model import Array
from swimid.fitting.noise import DERIVATIVE_RTOL, NoisePosterior, NoiseRows, compute_posterior, compute_rows
from swimid.fitting.problem import Problem
from swimid.fitting.uncertainty import VAGUE, orthogonal_part

#: Half-width of a 95 % interval, in standard errors.
NORMAL = float(special.ndtri(0.975))
#: Number of degrees of freedom above which the normal distribution replaces Student's.
MANY_DEGREES = 400
#: Total weight of the least probable hypotheses that are left out of a mixture.
NEGLIGIBLE_WEIGHT = 1e-4
#: Binary logarithm of the number of noise models that are drawn at random with their probabilities.
LOG2_FORMS = 4
#: Binary logarithms of the numbers of samples of the between-trial standard deviations, for one, two and
#: three parameters that differ.
LOG2_SIZES = (4, 7, 8)
#: Maximum number of parameters that differ together in one hypothesis. Only those that most probably differ
#: are combined.
MAX_TOGETHER = 3
#: Smallest and largest standard deviation between trials, in standard errors of the parameter in the most
#: informative trial. A smaller standard deviation changes no interval.
SMALLEST_SIZE, LARGEST_SIZE = 0.3, 1e5
#: Maximum ratio of two standard errors of a parameter for which its differences between trials count as
#: visible. The first error allows for the smallest differences that a contrast of the trials shows, and the
#: second assumes no differences.
MAX_ENLARGEMENT = 3.0
#: Correlation time of the noise, as a fraction of the duration of a trial, above which an interval is at
#: least as wide as that from the scores of the trials. The samples then hardly determine the noise model.
LONG_MEMORY = 1.0 / 15.0
#: Minimum ratio of an eigenvalue of a scaled information matrix to the largest one. A smaller eigenvalue is a
#: rounding error.
INFORMATION_RTOL = 1e-10
#: Probability of differences above which a check warns. Trials that agree exceed it in at most 1 % of all
#: cases, because a Bayes factor of 99 against the truth is that rare (Markov's inequality).
DIFFERENT = 0.99
#: Relative difference between trials that is assumed for a parameter with invisible differences. Its standard
#: error with this difference is stated.
ASSUMED_DIFFERENCE = 0.01


@dataclass(frozen=True)
class Differences:
    """Differences between the trials of a fit.

    Attributes
    ----------
    trials : int
        Number of fitted trials.
    probability : float
        Probability that a parameter differs between the trials; 0 if no difference is visible.
    sd : dict of str to float
        Standard deviation between the trials of each parameter, if it differs: posterior median, in its unit.
    chance : dict of str to float
        Probability that each parameter differs.
    hidden : dict of str to float
        Parameters whose differences these trials cannot show, with the standard error of each if it differs
        by :data:`ASSUMED_DIFFERENCE` between the trials, in its unit.
    """

    trials: int = 0
    probability: float = 0.0
    sd: Mapping[str, float] = field(default_factory=dict)
    chance: Mapping[str, float] = field(default_factory=dict)
    hidden: Mapping[str, float] = field(default_factory=dict)

    @property
    def are_likely(self) -> bool:
        """Whether the trials differ with a probability above :data:`DIFFERENT`."""
        return self.probability > DIFFERENT

    def in_units(self, unit: Mapping[str, float]) -> Differences:
        """Return the differences with each parameter multiplied by its unit."""
        sd, hidden = ({n: v * unit[n] for n, v in part.items()} for part in (self.sd, self.hidden))
        return replace(self, sd=sd, hidden=hidden)


@dataclass(frozen=True)
class Mixture:
    """Mixture, over h hypotheses, of Student distributions of the least-squares error in q coordinates.

    Attributes
    ----------
    weight : ndarray, shape (h,)
    mean : ndarray, shape (h, q)
        Estimate under each hypothesis, minus the least-squares estimate.
    covariance : ndarray, shape (h, q, q)
    degrees : int
    """

    weight: Array
    mean: Array
    covariance: Array
    degrees: int

    def half_widths(self, directions: Array) -> Array:
        """Return the 95 % half-widths of the error along each row of ``directions``, shape (m, q)."""
        mean = directions @ self.mean.T
        variance = np.einsum("mi,hij,mj->mh", directions, self.covariance, directions, optimize=True)
        sd = np.sqrt(np.maximum(variance, 1e-300))
        low, high = np.zeros(len(directions)), np.max(np.abs(mean) + 100.0 * sd, axis=1)
        for _ in range(40):
            middle = 0.5 * (low + high)
            above, below = ((sign * middle[:, None] - mean) / sd for sign in (1.0, -1.0))
            enough = (self._below(above) - self._below(below)) @ self.weight >= 0.95
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        return np.asarray(high)

    def _below(self, x: Array) -> Array:
        """Return the cumulative probability of a standardised error ``x``."""
        if self.degrees > MANY_DEGREES:
            return np.asarray(special.ndtr(x))
        return np.asarray(special.stdtr(self.degrees, x))

    def compute_covariance(self) -> Array:
        """Return a covariance whose normal distribution has the 95 % intervals of the mixture, shape (q, q).

        The intervals agree along the principal axes of the mean square of the error. The mean square itself
        is not used as the covariance, because it depends on the tails of the mixture.
        """
        square = np.einsum("h,hij->ij", self.weight, self.covariance)
        square += np.einsum("h,hi,hj->ij", self.weight, self.mean, self.mean)
        axes = np.linalg.eigh(square)[1]
        return np.asarray((axes * (self.half_widths(axes.T) / NORMAL) ** 2) @ axes.T)


class Coordinates:
    """Coordinates in which the shared unknowns have unit information for independent noise.

    Parameters
    ----------
    rows : sequence of ndarray, each shape (n_k, s)
        Derivatives of each trial with respect to the s shared unknowns. They are orthogonal to those with
        respect to the trial's own unknowns.

    Attributes
    ----------
    forward, backward : ndarray, shapes (q, s) and (s, q)
        Derivatives of the coordinates with respect to the unknowns, and the reverse.
    undetermined : ndarray of bool, shape (s,)
        Mask of the unknowns that take part in a direction without information.
    """

    def __init__(self, rows: Sequence[Array]) -> None:
        size = np.sqrt(np.maximum(sum(np.sum(part**2, axis=0) for part in rows), 1e-300))
        factors = [np.linalg.qr(part / size, mode="r") for part in rows]
        _, singular, vt = np.linalg.svd(np.concatenate(factors), full_matrices=False)
        kept = singular > 1e-8 * singular.max(initial=0.0)
        self.forward = singular[kept, None] * vt[kept] * size
        self.backward = vt[kept].T / singular[kept] / size[:, None]
        known = np.sum(vt[kept] ** 2, axis=0)
        self.undetermined = np.asarray(1.0 - known > 1e-6)


def compute_errors(
    problem: Problem,
    theta: Array,
    free: NDArray[np.bool_],
    rows: Sequence[Array],
    residuals: Sequence[Array],
) -> tuple[Array, Array, Differences]:
    """Return the errors of the free unknowns of a fit, and the differences between its trials.

    Parameters
    ----------
    theta : ndarray, shape (p,)
        Estimates.
    free : ndarray of bool, shape (p,)
        Mask of the unknowns that no bound holds. At least one of them is shared by the trials.
    rows, residuals : sequence of ndarray, each shape (n_k, m_k) and (n_k,)
        Weighted derivatives of the n_k samples of trial k with respect to its m_k scaled unknowns
        (:attr:`Problem.taken`), and weighted residuals.

    Returns
    -------
    covariance : ndarray, shape (p, p)
        Covariance of the scaled unknowns. The 95 % interval of an estimate is 1.96 square roots of the
        diagonal wide on each side. NaN for unknowns that the residuals do not determine.
    root : ndarray, shape (p, p)
        Square root of the inverse of the covariance. It is accurate even if the covariance is infinite.
    differences : Differences
        Differences between the trials, in scaled units.
    """
    shared = np.array([j for j, (_, k) in enumerate(problem.slots) if k is None and free[j]], dtype=int)
    own = [np.array([j for j in problem.own(k) if free[j]], dtype=int) for k in range(len(rows))]
    parts, apart = [], []
    for mine, part, numbers in zip(own, rows, problem.taken, strict=True):
        columns = part[:, np.searchsorted(numbers, np.concatenate((shared, mine)))]
        parts.append(columns)
        common = columns[:, : len(shared)]
        rest = orthogonal_part(columns[:, len(shared) :], common, DERIVATIVE_RTOL)
        # If the trial's own unknowns can replace a column, the remainder of the column is rounding error.
        norms = np.linalg.norm(common, axis=0)
        apart.append(np.where(np.linalg.norm(rest, axis=0) > DERIVATIVE_RTOL * norms, rest, 0.0))
    frame = Coordinates(apart)
    if not len(frame.forward):
        nothing = np.full((len(theta),) * 2, np.nan)
        return nothing, np.zeros_like(nothing), Differences(len(rows))
    series = compute_rows(problem, residuals, parts)
    scores = _Scores(series, frame.backward, [len(mine) for mine in own])
    magnitude = np.maximum(np.abs(theta) / problem.scale, 1.0)[shared]
    duration = float(np.median([np.ptp(trial.time_s) for trial in problem.trials]))
    mixture, differences = _mix(scores, frame, magnitude, [problem.labels[j] for j in shared])
    half = mixture.half_widths(frame.backward)
    if len(rows) > 1 and scores.memory_s > LONG_MEMORY * duration:
        half = np.maximum(half, _cluster_half_widths(scores, frame.backward))
    whitened = mixture.compute_covariance()
    variance = np.einsum("iq,qr,ir->i", frame.backward, whitened, frame.backward)
    factor = np.where(variance > 0.0, half / (NORMAL * np.sqrt(np.where(variance > 0.0, variance, 1.0))), 1.0)
    # Enlarge confounded unknowns by one common factor, so that their known sums keep their accuracy.
    vague = half > NORMAL * VAGUE * magnitude
    factor[vague] = np.max(factor[vague], initial=1.0)
    return *_assemble(scores, frame, whitened, factor, shared, own, len(theta)), differences


class _Scores:
    """Information matrices and scores of the trials, for several models of the noise.

    Parameters
    ----------
    series : dict of channel to dict of trial index to NoiseRows
    backward : ndarray, shape (s, q)
        Derivatives of the shared unknowns with respect to the whitened coordinates.
    own : sequence of int
        Number of own unknowns of each trial.

    Attributes
    ----------
    weight : ndarray, shape (j,)
        Probability of each of j noise models, from the residuals of each trial alone. The most probable one
        comes first.
    information, score : ndarray, shapes (j, trials, q, q) and (j, trials, q)
        Information and scores for the q whitened coordinates, with the own unknowns of each trial free.
    roots : list of (ndarray, ndarray), each shape (r_k, own) and (r_k, q)
        Square root of the information of the own unknowns of each trial under the first noise model: the
        columns of these unknowns, and the columns of the coordinates.
    degrees : int
        Degrees of freedom of the variance of the noise.
    memory_s : float
        Correlation time of the noise, s: the longest of all channels.
    """

    def __init__(
        self, series: Mapping[str, Mapping[int, NoiseRows]], backward: Array, own: Sequence[int]
    ) -> None:
        self.series, self.backward = series, backward
        self.posteriors = [compute_posterior(parts) for parts in series.values()]
        self.degrees = sum(posterior.degrees for posterior in self.posteriors)
        self.memory_s = max(posterior.memory_s for posterior in self.posteriors)
        self._white: dict[tuple[int, int], dict[int, tuple[NDArray[np.intp], Array]]] = {}
        forms, self.weight = _draw_forms(self.posteriors)
        q = backward.shape[1]
        self.information = np.zeros((len(forms), len(own), q, q))
        self.score = np.zeros((len(forms), len(own), q))
        self.roots: list[tuple[Array, Array]] = []
        for j, chosen in enumerate(forms):
            for k, (whole, score) in enumerate(self._of_trials(chosen, own)):
                starts = whole[q:, q:]
                scale = np.sqrt(np.maximum(np.diag(starts), 1e-300))
                values, vectors = np.linalg.eigh(starts / np.outer(scale, scale))
                kept = values > INFORMATION_RTOL * values.max(initial=0.0)
                # Compute a matrix whose rows are combinations of own unknowns with unit information.
                base = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
                mixed = base @ whole[q:, :q]
                self.information[j, k] = whole[:q, :q] - mixed.T @ mixed
                self.score[j, k] = score[:q] - mixed.T @ (base @ score[q:])
                if j == 0:
                    self.roots.append(((vectors[:, kept] * np.sqrt(values[kept])).T * scale, mixed))

    def _whiten(self, channel: int, form: int) -> dict[int, tuple[NDArray[np.intp], Array]]:
        """Return by trial the sample indices, and basis and residual whitened by one noise model."""
        if (channel, form) not in self._white:
            posterior, parts = self.posteriors[channel], list(self.series.values())[channel]
            noise, sd = posterior.forms[form], math.sqrt(posterior.variance[form])
            self._white[channel, form] = {
                k: (part.place, noise.whiten(part.time_s, part.place, part.columns)[0] / sd)
                for k, part in parts.items()
            }
        return self._white[channel, form]

    def _of_trials(self, chosen: Sequence[int], own: Sequence[int]) -> Iterator[tuple[Array, Array]]:
        """Yield the information and the score of each trial, for one noise model of each channel.

        Information and score refer to the whitened coordinates, followed by the trial's own unknowns.
        Residuals of different channels may be correlated, as those of one camera are. The information then
        follows from the covariance of the scores.
        """
        white = [self._whiten(c, form) for c, form in enumerate(chosen)]
        parts, s = list(self.series.values()), len(self.backward)
        correlation = _correlate(white)
        for k, count in enumerate(own):
            size = self.backward.shape[1] + count
            columns, whole, score = {}, np.zeros((size, size)), np.zeros(size)
            for c, rows in enumerate(white):
                if k not in rows:
                    continue
                factor = parts[c][k].factor
                factor = np.column_stack((factor[:, :s] @ self.backward, factor[:, s:]))
                place, values = rows[k]
                columns[c] = place, values[:, :-1] @ factor
                whole += columns[c][1].T @ columns[c][1]
                score += columns[c][1].T @ values[:, -1]
            middle = whole.copy()
            for (a, first), (b, second) in itertools.combinations(columns.items(), 2):
                if correlation[a, b]:
                    _, here, there = np.intersect1d(first[0], second[0], return_indices=True)
                    cross = correlation[a, b] * (first[1][here].T @ second[1][there])
                    middle += cross + cross.T
            if correlation.any():
                change = whole @ np.linalg.pinv(middle, rcond=1e-12, hermitian=True)
                whole, score = change @ whole, change @ score
                whole = 0.5 * (whole + whole.T)
            yield whole, score


def _draw_forms(posteriors: Sequence[NoisePosterior]) -> tuple[list[tuple[int, ...]], Array]:
    """Return noise models drawn with their probabilities, and the frequency of each.

    A model has one index for each channel. The most frequent model comes first.
    """
    points = _points(len(posteriors), LOG2_FORMS)
    drawn = [
        np.minimum(np.searchsorted(np.cumsum(p.probability), u), len(p.forms) - 1)
        for p, u in zip(posteriors, points.T, strict=True)
    ]
    forms, counts = np.unique(np.column_stack(drawn), axis=0, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    return [tuple(map(int, forms[i])) for i in order], counts[order] / counts.sum()


@lru_cache
def _points(dimension: int, log2_number: int) -> Array:
    """Return evenly distributed points in the unit cube (Sobol), shape (2 ** log2_number, dimension)."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimension, rng=np.random.default_rng(1)).random_base2(log2_number))


def _correlate(white: Sequence[Mapping[int, tuple[NDArray[np.intp], Array]]]) -> Array:
    """Return the correlation of the whitened residuals of the channels, shape (c, c); 0 if insignificant."""
    found = np.zeros((len(white),) * 2)
    for a, b in itertools.combinations(range(len(white)), 2):
        pairs = []
        for k in white[a].keys() & white[b].keys():
            _, here, there = np.intersect1d(white[a][k][0], white[b][k][0], return_indices=True)
            first, second = _remainder(white[a][k][1]), _remainder(white[b][k][1])
            pairs.append(np.column_stack((first[here], second[there])))
        both = np.concatenate([np.empty((0, 2)), *pairs])
        squares = np.sum(both**2, axis=0)
        if len(both) > 2 and squares.all():
            value = float(both[:, 0] @ both[:, 1] / math.sqrt(squares.prod()))
            if abs(value) > NORMAL / math.sqrt(len(both)):
                found[a, b] = found[b, a] = value
    return found


def _remainder(white: Array) -> Array:
    """Return the whitened residual of a series that remains after a fit of this series alone."""
    basis = np.linalg.qr(white[:, :-1])[0]
    return np.asarray(white[:, -1] - basis @ (basis.T @ white[:, -1]))


# ---------------------------------------------------------------- hypotheses of differences


def _mix(
    scores: _Scores, frame: Coordinates, magnitude: Array, labels: Sequence[str]
) -> tuple[Mixture, Differences]:
    """Return the mixture over the differences between trials, and a description of the differences.

    Notes
    -----
    The hypothesis that no parameter differs has the prior probability 1/2. All sets of parameters that may
    differ share the rest. The standard deviations between trials are uniform in their logarithms, up to the
    magnitude of the parameter. This prior gives Student's distribution with as many degrees of freedom as the
    trials have, if the differences exceed the noise [1]_.
    """
    trials = scores.information.shape[1]
    likely = np.einsum("j,jkqr->kqr", scores.weight, scores.information)
    pooled = np.linalg.pinv(likely.sum(axis=0), hermitian=True)
    enlargement, just_shown = _visibility(likely, pooled, frame.forward)
    shown = (enlargement < MAX_ENLARGEMENT) & (just_shown < magnitude) & ~frame.undetermined
    visible = np.flatnonzero(shown).tolist()
    own = np.einsum("qi,kqr,ri->ki", frame.forward, likely, frame.forward)
    error = 1.0 / np.sqrt(np.maximum(own.max(axis=0), 1e-300))
    # Above the maximum standard deviation, the information that remains would be rounding error.
    highest = np.minimum(magnitude, LARGEST_SIZE * error)
    # If no trial determines a parameter to within its magnitude, the range of standard deviations is narrow.
    lowest = np.minimum(SMALLEST_SIZE * error, 0.1 * highest)
    hypotheses, mixture, weights = _weigh_sets(scores, frame, visible, lowest, highest)
    chance, sd = {}, {}
    for i in visible:
        each = [(h, one.members.index(i)) for h, one in enumerate(hypotheses) if i in one.members]
        mass = np.concatenate([weights[h].sum(axis=0) for h, _ in each])
        sizes = np.concatenate([hypotheses[h].sizes[:, at] for h, at in each])
        chance[labels[i]] = float(mass.sum())
        order = np.argsort(sizes)
        half = np.searchsorted(np.cumsum(mass[order]), 0.5 * mass.sum())
        sd[labels[i]] = float(sizes[order][min(half, len(sizes) - 1)])
    # A parameter that acts in one of several trials cannot differ between them.
    acting = np.sum(own > 1e-9 * own.max(axis=0), axis=0)
    hidden = {}
    for i in np.flatnonzero(~frame.undetermined & ~shown & ((acting > 1) | (trials == 1))).tolist():
        size = min(ASSUMED_DIFFERENCE * magnitude[i], highest[i])
        covariance = _evaluate(scores, frame.forward, _Set((i,), np.array([[size]])))[2][0, 0]
        hidden[labels[i]] = math.sqrt(max(frame.backward[i] @ covariance @ frame.backward[i], 0.0))
    return mixture, Differences(trials, 1.0 - float(weights[0].sum()), sd, chance, hidden)


def _weigh_sets(
    scores: _Scores, frame: Coordinates, visible: Sequence[int], lowest: Array, highest: Array
) -> tuple[list[_Set], Mixture, list[Array]]:
    """Return the sets of parameters that may differ, their mixture, and the probabilities of each set.

    Each set has one probability for each noise model and each sample of the standard deviations.

    Parameters
    ----------
    visible : sequence of int
        Parameters whose differences are visible. The leading ones are combined.
    lowest, highest : ndarray
        Smallest and largest standard deviation between trials of each parameter.
    """
    hypotheses = [_Set((), np.zeros((1, 0)))]
    hypotheses += [_draw_sizes((i,), lowest, highest) for i in visible]
    found = [_evaluate(scores, frame.forward, one) for one in hypotheses]
    alone = _own_likelihood(scores.information, scores.score)[:, None]
    gains = [float(np.max(alone + one[0])) for one in found[1:]]
    leading = sorted(visible[i] for i in np.argsort(gains)[::-1][:MAX_TOGETHER])
    for count in range(2, len(leading) + 1):
        for members in itertools.combinations(leading, count):
            hypotheses.append(_draw_sizes(members, lowest, highest))
            found.append(_evaluate(scores, frame.forward, hypotheses[-1]))
    prior = np.full(len(hypotheses), 0.5 / max(len(hypotheses) - 1, 1))
    prior[0] = 0.5
    forms = np.log(scores.weight)[:, None] + alone
    logs = [forms + one[0] - math.log(one[0].shape[1]) for one in found]
    top = max(float(part.max()) for part in logs)
    weights = [p * np.exp(part - top) for p, part in zip(prior, logs, strict=True)]
    total = sum(float(part.sum()) for part in weights)
    weights = [part / total for part in weights]
    weight, q = np.concatenate([part.ravel() for part in weights]), scores.information.shape[-1]
    mean = np.concatenate([one[1].reshape(-1, q) for one in found])
    covariance = np.concatenate([one[2].reshape(-1, q, q) for one in found])
    order = np.argsort(-weight)
    kept = order[: int(np.searchsorted(np.cumsum(weight[order]), 1.0 - NEGLIGIBLE_WEIGHT)) + 1]
    mixture = Mixture(weight[kept] / weight[kept].sum(), mean[kept], covariance[kept], scores.degrees)
    return hypotheses, mixture, weights


class _Set(NamedTuple):
    """Set of parameters that may differ between trials.

    Attributes
    ----------
    members : tuple of int
        Indices of the parameters among the shared unknowns.
    sizes : ndarray, shape (h, len(members))
        Standard deviations between the trials, scaled.
    """

    members: tuple[int, ...]
    sizes: Array


def _draw_sizes(members: tuple[int, ...], lowest: Array, highest: Array) -> _Set:
    """Return a set of parameters with samples of their between-trial standard deviations.

    The samples are uniform in their logarithms between two bounds, shape (s,).
    """
    low, high = (np.log(bound[list(members)]) for bound in (lowest, highest))
    points = _points(len(members), LOG2_SIZES[len(members) - 1])
    return _Set(members, np.exp(low + points * (high - low)))


def _evaluate(scores: _Scores, forward: Array, hypotheses: _Set) -> tuple[Array, Array, Array]:
    """Return log-likelihood, estimate and covariance for all noise models j and standard deviations h.

    The log-likelihood is that of the differences between the estimates of the trials. The function
    :func:`_own_likelihood` computes the other part.

    Returns
    -------
    ndarray, shapes (j, h), (j, h, q) and (j, h, q, q)
        The estimates are in whitened coordinates, minus the least-squares estimate.

    Notes
    -----
    The scores of trial k have the covariance ``A + A E L^2 E' A`` with its information A, the directions E of
    the parameters that differ, and the diagonal matrix L of their standard deviations. The likelihood is
    restricted [3]_.
    """
    a, s = scores.information, scores.score
    directions = forward[:, list(hypotheses.members)]
    ae = a @ directions
    eae, es = directions.T @ ae, s @ directions
    found = []
    # Limit the memory of the arrays of all trials.
    chunk = max(int(4e6 / max(ae.size, 1)), 1)
    for first in range(0, len(hypotheses.sizes), chunk):
        size = hypotheses.sizes[None, first : first + chunk, None, :]
        inner = np.eye(len(directions.T)) + size[..., :, None] * eae[:, None] * size[..., None, :]
        log_inner = np.linalg.slogdet(inner)[1].sum(axis=2)
        inverse = np.linalg.inv(inner)
        scaled = size * es[:, None]
        solved = np.einsum("jhkab,jhkb->jhka", inverse, scaled)
        left = ae[:, None] * size[..., None, :]
        whole = a.sum(axis=1)[:, None] - np.einsum(
            "jhkqa,jhkab,jhkrb->jhqr", left, inverse, left, optimize=True
        )
        # Add a small diagonal, so that a matrix is invertible whose smallest eigenvalue is a rounding error.
        least = 1e-13 * np.trace(whole, axis1=2, axis2=3) + 1e-12
        whole += least[..., None, None] * np.eye(whole.shape[-1])
        score = s.sum(axis=1)[:, None] - np.einsum("jhkqa,jhka->jhq", left, solved)
        covariance = np.linalg.inv(whole)
        mean = np.einsum("jhqr,jhr->jhq", covariance, score)
        log = 0.5 * (
            np.einsum("jhka,jhka->jh", scaled, solved)
            + np.einsum("jhq,jhq->jh", score, mean)
            - log_inner
            - np.linalg.slogdet(whole)[1]
        )
        found.append((log, mean, covariance))
    log, mean, covariance = (np.concatenate(part, axis=1) for part in zip(*found, strict=True))
    return log, mean, covariance


def _own_likelihood(information: Array, score: Array) -> Array:
    """Return the sum of the parts of the log-likelihood from each trial alone, shape (j,)."""
    values, vectors = np.linalg.eigh(information)
    kept = values > 1e-9 * values[..., -1:]
    safe = np.where(kept, values, 1.0)
    along = np.einsum("jkqr,jkq->jkr", vectors, score)
    squares = np.where(kept, along**2 / safe, 0.0)
    return np.asarray(0.5 * (np.log(safe).sum(axis=(1, 2)) - squares.sum(axis=(1, 2))))


def _visibility(information: Array, pooled: Array, forward: Array) -> tuple[Array, Array]:
    """Return the factor by which differences of each parameter enlarge its standard error, and their size.

    Parameters
    ----------
    information : ndarray, shape (trials, q, q)
    pooled : ndarray, shape (q, q)
        Inverse of the sum of the information of all trials.

    Returns
    -------
    enlargement, size : ndarray, shape (s,)
        Ratio of the standard errors with and without the smallest differences that a contrast of the trials
        shows, and size of these differences; infinite without a contrast.
    """
    enlargement, size = np.full(forward.shape[1], np.inf), np.full(forward.shape[1], np.inf)
    for i, e in enumerate(forward.T):
        ae = information @ e
        contrast = np.diag(ae @ e) - ae @ pooled @ ae.T
        largest = float(np.linalg.eigvalsh(contrast)[-1])
        if len(information) < 2 or largest <= 1e-9 * float(np.max(ae @ e)):
            continue
        size[i] = 1.0 / math.sqrt(largest)
        weight = size[i] ** 2 / (1.0 + size[i] ** 2 * (ae @ e))
        whole = information.sum(axis=0) - np.einsum("k,kq,kr->qr", weight, ae, ae)
        before, after = (float(e @ part @ e) for part in (pooled, np.linalg.pinv(whole, hermitian=True)))
        if before > 0.0:
            enlargement[i] = math.sqrt(max(after, before) / before)
    return enlargement, size


def _cluster_half_widths(scores: _Scores, directions: Array) -> Array:
    """Return half-widths of 95 % intervals along ``directions``, from the scores of the trials.

    No noise model is assumed. The covariance is the bias-reduced cluster estimate of Bell and McCaffrey, with
    its degrees of freedom [2]_.

    Parameters
    ----------
    directions : ndarray, shape (m, q)
    """
    a, s = scores.information[0], scores.score[0]
    pooled = np.linalg.pinv(a.sum(axis=0), hermitian=True)
    mean = pooled @ s.sum(axis=0)
    roots, left = [], []
    for whole, score in zip(a, s, strict=True):
        values, vectors = np.linalg.eigh(whole)
        kept = values > 1e-9 * values[-1]
        root = (vectors[:, kept] * np.sqrt(values[kept])).T
        roots.append(root)
        left.append((vectors[:, kept] / np.sqrt(values[kept])).T @ score - root @ mean)
    stacked = np.concatenate(roots)
    hat = np.eye(len(stacked)) - stacked @ pooled @ stacked.T
    ends = np.cumsum([0, *map(len, roots)])
    adjusted = []
    for root in roots:
        values, vectors = np.linalg.eigh(np.eye(len(root)) - root @ pooled @ root.T)
        inverse = np.where(values > 1e-6, 1.0 / np.sqrt(np.maximum(values, 1e-6)), 0.0)
        adjusted.append(pooled @ root.T @ (vectors * inverse) @ vectors.T)
    found = np.zeros(len(directions))
    for i, direction in enumerate(directions):
        rows = [direction @ part for part in adjusted]
        variance = sum(float(row @ r) ** 2 for row, r in zip(rows, left, strict=True))
        images = [hat[:, b:e] @ row for b, e, row in zip(ends, ends[1:], rows, strict=False)]
        gram = np.array(images) @ np.array(images).T
        degrees = max(float(np.trace(gram)) ** 2 / max(float(np.sum(gram**2)), 1e-300), 1.0)
        found[i] = special.stdtrit(degrees, 0.975) * math.sqrt(variance)
    return found


def _assemble(
    scores: _Scores,
    frame: Coordinates,
    whitened: Array,
    factor: Array,
    shared: NDArray[np.intp],
    own: Sequence[NDArray[np.intp]],
    unknowns: int,
) -> tuple[Array, Array]:
    """Return the covariance of all unknowns, and the square root of its inverse.

    Parameters
    ----------
    whitened : ndarray, shape (q, q)
        Covariance of the whitened coordinates.
    factor : ndarray, shape (s,)
        Factor that is applied to the standard error of each shared unknown.
    """
    values, vectors = np.linalg.eigh(whitened)
    values = np.maximum(values, 1e-14 * values[-1])
    q, root = len(whitened), np.zeros((unknowns, unknowns))
    root[:q, shared] = (vectors / np.sqrt(values)).T @ frame.forward / factor
    covariance = np.full((unknowns, unknowns), np.nan)
    change = np.zeros((unknowns, q))
    change[shared] = factor[:, None] * frame.backward
    spread = np.zeros((unknowns, unknowns))
    known = np.zeros(unknowns, dtype=bool)
    known[shared] = ~frame.undetermined
    few = float(special.stdtrit(scores.degrees, 0.975)) / NORMAL
    first = q
    for mine, (starts, mixed) in zip(own, scores.roots, strict=True):
        last = first + len(starts)
        root[first:last, mine] = starts / few
        root[first:last, shared] = mixed @ frame.forward / few / factor
        inverse = np.linalg.pinv(starts)
        change[mine] = -inverse @ mixed
        spread[np.ix_(mine, mine)] = few**2 * inverse @ inverse.T
        known[mine] = np.sum((inverse @ starts) ** 2, axis=1) > 1.0 - 1e-6
        first = last
    whole = change @ whitened @ change.T + spread
    covariance[np.ix_(known, known)] = whole[np.ix_(known, known)]
    return covariance, root
