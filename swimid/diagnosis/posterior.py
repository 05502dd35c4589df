"""Compute the posterior probability of each set of causes, of no gap, and of a cause outside the catalogue.

The deviance of a hypothesis is minus twice its log predictive density of held-out data, with the noise of the
noise model (:func:`swimid.diagnosis.crossval.compute_deviances`). Its excess over that of noise alone is the
gap that the hypothesis leaves. No hypothesis has exactly the form of the true cause. The excess is therefore
modelled as a discrepancy of unknown variance, with a fixed number of directions in each fold. At the most
likely variance, the log-evidence decreases by half the number of directions times the logarithm of the excess
(a Student likelihood instead of a Gaussian one). A hypothesis is improbable only if its excess is several
times larger than that of another one.

A further cause is compared with the form error of the causes already in the set, which has this number of
directions in the whole record. A cause whose change of the trials is similar to theirs adds no evidence. A
cause outside the catalogue is such a further cause, which closes the whole remaining gap. The folds get
random weights (Bayesian bootstrap), so that an effect that helps in one fold only is uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from swimid.fitting.model import Array

#: Maximum root-mean-square error of the model, divided by that of the noise, that counts as no gap.
MODEL_ERROR_SHARE = 0.1
#: Prior odds of each further cause in a set of causes. The value is chosen, not estimated: a gap with several
#: causes is assumed to be rarer.
FURTHER_CAUSE_ODDS = 0.1
#: Probability of no gap below which a diagnosis reports a gap.
MAX_NO_GAP_PROBABILITY = 0.1
#: Relative difference of deviances below which two hypotheses count as the same. It is the tolerance of their
#: fits.
TWIN_RTOL = 1e-4
#: Number of random samples of the weights of the cross-validation folds (Bayesian bootstrap).
N_FOLD_WEIGHTS = 200


@dataclass(frozen=True)
class PosteriorConstants:
    """Constants of the posterior probabilities, calibrated on trials with known causes.

    Attributes
    ----------
    directions : float
        Number of directions, in each fold, of the discrepancy between a true effect and its form in the
        catalogue.
    form : float
        Fraction of the squared gap that a true effect may leave because its form is not exact.
    outside : float
            Log-odds of a cause outside the catalogue if the excess is zero.
    """

    directions: float
    form: float
    outside: float


#: Constants of the posterior probabilities as ``python -m validation.calibrate`` computes them. The
#: calibration uses trials that independent code simulates. Each case is also diagnosed with its
#: true effect removed from the catalogue.
CALIBRATED = PosteriorConstants(11.4, 0.22, -3.7)


@dataclass(frozen=True)
class Candidate:
    """Hypothesis with its deviances.

    Attributes
    ----------
    names : frozenset of str
        Names of the effects in the hypothesis.
    deviances : ndarray, shape (folds,)
        Minus twice the log predictive density of each fold.
    strain : float
        Squared distance of the parameters from their prior means, in units of the prior covariance.
    numbers : int
        Number of shared parameters of the effects.
    widening : float
            Logarithm of the ratio of the prior volumes of the coefficients with and without the effects.
    alike : mapping of str to float
        For each effect of a set, the largest squared cosine between its change of the trials and the change
        by another effect of the set. The model's parameters are projected out.
    """

    names: frozenset[str]
    deviances: Array
    strain: float = 0.0
    numbers: int = 0
    widening: float = 0.0
    alike: Mapping[str, float] = field(default_factory=dict)

    @property
    def deviance(self) -> float:
        """Sum of the deviances of all folds."""
        return float(self.deviances.sum())


def are_twins(first: Candidate, second: Candidate) -> bool:
    """Return whether two hypotheses leave the same residuals, so that no similar trial can separate them.

    Linear drag and viscous friction of the pulley are such twins in falling-weight trials.
    """
    if len(first.names) != len(second.names):
        return False
    difference = np.abs(first.deviances - second.deviances)
    return bool((difference <= TWIN_RTOL * np.abs(second.deviances)).all())


@dataclass(frozen=True)
class Posterior:
    """Posterior probabilities of the sets of causes, of no gap, and of a cause outside the catalogue.

    The values of ``sets``, ``none`` and ``outside`` sum to one.

    Attributes
    ----------
    sets : dict of frozenset of str to float
        Probability that exactly these effects are missing in the model.
    none : float
        Probability that nothing is missing.
    outside : float
        Probability of a cause outside the catalogue, alone or together with a set of effects.
    beside : dict of frozenset of str to float
        Probability that a cause outside the catalogue acts and that this set closes most of the closed part
        of the gap. The empty set stands for no effect.
    excess : dict of frozenset of str to float
        Deviance with each set minus that of the noise. The excess of the empty set is the squared gap.
    candidates : tuple of Candidate
        All hypotheses, the model without effects first.
    """

    sets: dict[frozenset[str], float]
    none: float
    outside: float
    beside: dict[frozenset[str], float]
    excess: dict[frozenset[str], float]
    candidates: tuple[Candidate, ...]

    @property
    def probabilities(self) -> dict[frozenset[str], float]:
        """Return for each set the probability that it closes most of the gap without other known effects.

        Known effects are those of the catalogue. A cause outside the catalogue may act in addition.
        """
        return {names: p + self.beside[names] for names, p in self.sets.items()}

    @property
    def best(self) -> frozenset[str]:
        """Return the most probable set of effects.

        Its size is the smallest one that suffices with a probability above one half.
        """
        known = self.probabilities
        total = sum(known.values())
        size, fewer = 1, 0.0
        while size < max((len(names) for names in known), default=1):
            fewer += sum(p for names, p in known.items() if len(names) == size)
            if fewer > 0.5 * total:
                break
            size += 1
        mine = {names: p for names, p in known.items() if len(names) == size}
        return max(mine, key=lambda names: mine[names], default=frozenset())

    def compute_probability(self, *names: str) -> float:
        """Return the probability that at least one of the named effects closes most of the gap.

        A cause outside the catalogue may act in addition.
        """
        return min(sum(p for found, p in self.probabilities.items() if found & set(names)), 1.0)

    def instead(self, name: str, among: frozenset[str]) -> dict[str, float]:
        """Return the probability of each effect that could replace ``name`` in the hypothesis ``among``.

        The other effects of the hypothesis are assumed to act. The probabilities sum to one.
        """
        rest = among - {name}
        found: dict[str, float] = {}
        for names, p in self.probabilities.items():
            if len(names) == len(among) and rest < names:
                (other,) = names - rest
                found[other] = p
        total = sum(found.values())
        return {n: p / total for n, p in sorted(found.items(), key=lambda item: -item[1])}


def compute_prior_log_odds(size: int, effects: int) -> float:
    """Return the prior log-odds of a set of ``size`` out of ``effects`` effects, against no effect."""
    return math.log((1.0 - FURTHER_CAUSE_ODDS) * FURTHER_CAUSE_ODDS ** (size - 1) / math.comb(effects, size))


@dataclass(frozen=True)
class DataSize:
    """Size of the data set: numbers of residuals, of cross-validation folds, and of applicable effects.

    Attributes
    ----------
    samples : float
        Number of residuals.
    parts : int
        Number of cross-validation folds: settings, or time segments if there are only a few trials.
    effects : int
        Number of effects that apply to the model and its trials.
    """

    samples: float
    parts: int
    effects: int


def compute_tolerance(record: DataSize, gap: float, known: PosteriorConstants = CALIBRATED) -> float:
    """Return the largest excess at which no hypothesis is refuted.

    It is the sum of four terms: a discrepancy as large as the noise in all its directions, a model error of a
    tenth of the noise, two standard deviations of the squared noise, and the form error of a true effect.
    """
    noise = MODEL_ERROR_SHARE**2 * record.samples
    noise = known.directions * record.parts + noise + math.sqrt(8.0 * record.samples)
    return noise + known.form * max(gap, 0.0)


def compute_price(
    candidate: Candidate, null: Candidate, record: DataSize, known: PosteriorConstants = CALIBRATED
) -> float:
    """Return the decrease of the log-evidence of a hypothesis due to the number and the priors of its
    parameters.

    Held-out data alone select too many parameters, because no fold is new to a hypothesis that was selected
    by all of them. Each parameter therefore costs as much as in the Bayesian information criterion. A wider
    prior costs the logarithm of its volume, because held-out data hardly depend on a prior once the other
    folds are known. The prior counts as one more part of the data: a true effect may leave a share of the
    squared distance from the prior means that the model without effects has.

    Parameters
    ----------
    null : Candidate
        The model without effects.
    """
    directions = known.directions * record.parts
    far = 0.5 * directions * math.log1p(candidate.strain / (directions + known.form * null.strain))
    return 0.5 * math.log(record.samples) * candidate.numbers + candidate.widening + far


def compute_largest_gain(excess: float, record: DataSize) -> float:
    """Return the maximum log-evidence that a further effect can add to a set of effects with this excess."""
    return 0.5 * CALIBRATED.directions * math.log1p(max(excess, 0.0) / compute_tolerance(record, 0.0))


def compute_posterior_probabilities(
    null: Candidate,
    candidates: Sequence[Candidate],
    *,
    record: DataSize,
    calibration: PosteriorConstants = CALIBRATED,
    seed: int = 0,
) -> Posterior:
    """Return the posterior probabilities of all hypotheses.

    Parameters
    ----------
    null : Candidate
        The model without effects.
    candidates : sequence of Candidate
        At most one hypothesis for each set of effects.
    record : DataSize
        Amount of data.

    References
    ----------
    .. [1] Y. Yao, A. Vehtari, D. Simpson, A. Gelman, "Using stacking to average Bayesian predictive
       distributions", Bayesian Analysis 13(3), 2018: weights by the Bayesian bootstrap.
    .. [2] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t
       distribution", J. Am. Stat. Assoc. 84(408), 1989.
    """
    every = [null, *candidates]
    totals, folds = np.array([c.deviance for c in every]), np.array([c.deviances for c in every])
    excess = totals - min(float(totals.min()), record.samples)
    count = folds.shape[1]
    weight = np.random.default_rng(seed).dirichlet(np.ones(count), N_FOLD_WEIGHTS) * count
    leader = int(np.argmin(excess))
    drawn = excess[:, None] + (folds - folds[leader]) @ (weight - 1.0).T
    drawn -= np.minimum(drawn.min(axis=0), 0.0)
    size = np.log1p(drawn / compute_tolerance(record, float(excess[0]), calibration))
    small = np.log1p(drawn / compute_tolerance(record, 0.0, calibration))
    # Twins count as one hypothesis, and share its prior probability.
    better = [c for c in candidates if c.deviance < null.deviance]
    same = [max(sum(are_twins(c, other) for other in better), 1) for c in candidates]
    known = np.array([0.0, *(compute_prior_log_odds(len(c.names), record.effects) for c in candidates)])
    known[1:] -= np.log(same)
    known -= [compute_price(c, null, record, calibration) for c in every]
    closes = known[:, None] + 0.5 * calibration.directions * record.parts * (size[0] - size)
    _further(every, known, closes, small, calibration.directions)
    evidence = np.vstack((closes, closes + calibration.outside + 0.5 * calibration.directions * size))
    p = np.exp(evidence - logsumexp(evidence, axis=0)).mean(axis=1)
    inside, beside = np.split(p, 2)
    return Posterior(
        {c.names: float(v) for c, v in zip(candidates, inside[1:], strict=True)},
        float(inside[0]),
        float(beside.sum()),
        {c.names: float(v) for c, v in zip(every, beside, strict=True)},
        {c.names: float(e) for c, e in zip(every, excess, strict=True)},
        tuple(every),
    )


def _further(
    candidates: Sequence[Candidate], known: Array, closes: Array, small: Array, directions: float
) -> None:
    """Limit, in place, the log-evidence that a larger set gains over the most probable smaller set within it.

    Parameters
    ----------
    known : ndarray, shape (c,)
            Prior log-probability of each of the c hypotheses.
    closes : ndarray, shape (c, m)
            Log-evidence of each hypothesis for each of the m samples of the fold weights.
    small : ndarray, shape (c, m)
        ``log(1 + excess / unit)`` of the hypotheses, where the unit contains no form error.
    """
    place = {c.names: i for i, c in enumerate(candidates)}
    for i in sorted(range(len(candidates)), key=lambda i: len(candidates[i].names)):
        c = candidates[i]
        within = [(place[c.names - {n}], n) for n in sorted(c.names) if c.names - {n} in place]
        if len(c.names) < 2 or not within:
            continue
        j, last = max(within, key=lambda w: float(closes[w[0]].mean()))
        gained = 0.5 * directions * (1.0 - c.alike.get(last, 0.0)) * (small[j] - small[i])
        closes[i] = closes[j] - known[j] + known[i] + gained
