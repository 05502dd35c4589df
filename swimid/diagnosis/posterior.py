"""Compute the posterior probability of each set of causes, of no gap, and of a cause outside the catalogue.

Even a true effect does not have exactly the form that it has in the catalogue. The excess of a hypothesis is
the sum of its squared residuals minus the expected noise. The excess is modelled as a discrepancy of unknown
variance, with a fixed number of directions in each part of the data. At the most likely variance, the
log-evidence decreases by half the number of directions times the logarithm of the excess (a Student
likelihood instead of a Gaussian one). A hypothesis is therefore improbable only if its excess is several
times larger than that of another one.

A further cause is compared with the form error of the causes already in the set. If its change of the trials
is similar to theirs, it adds no evidence. Otherwise it must close nearly all of the remaining excess, because
a form error rarely looks like a single effect. The folds get random weights (Bayesian bootstrap), so that an
effect that helps in one fold only is uncertain.

A few trials do not separate low-frequency noise from a gap. The posterior with short-memory noise then
decides whether there is a gap, and how much of it is closed. The cause must also be probable with long-memory
noise. The two posteriors are pooled logarithmically.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from swimid.fitting.model import Array

#: Maximum root-mean-square error of the model, divided by that of the noise, that counts as no gap.
TENTH = 0.1
#: Prior odds of each further cause in a set of causes. The value is chosen, not estimated: a gap with several
#: causes is assumed to be rarer.
FURTHER = 0.1
#: Probability of no gap below which a diagnosis reports a gap.
UNSURE = 0.1
#: Relative difference of squared residuals below which two hypotheses count as the same. It is the tolerance
#: of their fits.
SAME_RTOL = 1e-4
#: Number of random samples of the weights of the cross-validation folds (Bayesian bootstrap).
WEIGHTINGS = 200


@dataclass(frozen=True)
class Calibration:
    """Constants of the posterior probabilities, calibrated on trials with known causes.

    Attributes
    ----------
    directions : float
        Number of directions, in each part of the data, of the discrepancy between a true effect and its form
        in the catalogue.
    form : float
        Fraction of the squared gap that a true effect may leave because its form is not exact.
    number : float
        Cost in log-evidence of each kind of parameter of an effect, in addition to the BIC penalty.
    further : float
        Number of directions, in the whole record, of the form error of a true effect, for the evidence of a
        further cause.
    outside, grows : float
        Log-evidence of a cause outside the catalogue without excess, and its increase with the logarithm of
        the excess.
    acts : float
        Probability that an effect acts if it closes most of the gap together with a cause outside the
        catalogue. Otherwise the effect only imitates that cause.
    """

    directions: float
    form: float
    number: float
    further: float
    outside: float
    grows: float
    acts: float


#: Constants of the posterior probabilities as ``python -m tests.calibrate`` computes them. The calibration
#: uses trials that independent code simulates. Each case is also diagnosed with its true effect removed from
#: the catalogue.
CALIBRATED = Calibration(8.7, 0.30, 1.4, 8.0, -2.7, 4.3, 0.15)


@dataclass(frozen=True)
class Candidate:
    """Hypothesis with its squared residuals and the penalty for its parameters.

    Attributes
    ----------
    names : frozenset of str
        Names of the effects in the hypothesis.
    score : float
        Squared residuals at the optimum, in units of the noise variance, plus the penalty for the parameters.
    folds : ndarray, shape (folds,)
        Squared residuals of each fold, in units of the noise variance.
    numbers : int
        Number of kinds of parameters of the effects. The per-trial values of one parameter are one kind.
    alike : mapping of str to float
        For each effect of a set, the largest squared cosine between its change of the trials and the change
        by another effect of the set. The model's parameters are projected out.
    slow : float, optional
        The score with long-memory noise. None if there are enough trials to estimate the noise.
    exact : bool
        Whether the form of the hypothesis is exact. It is, if only parameters of the model change.
    """

    names: frozenset[str]
    score: float
    folds: Array
    numbers: int
    slow: float | None = None
    alike: Mapping[str, float] = field(default_factory=dict)
    exact: bool = False


def are_twins(first: Candidate, second: Candidate) -> bool:
    """Return whether two hypotheses leave the same residuals, so that no trial of this kind separates them.

    Linear drag and viscous friction of the pulley are such twins in falling-weight trials.
    """
    if len(first.names) != len(second.names) or first.numbers != second.numbers:
        return False
    alike = np.allclose(first.folds, second.folds, rtol=SAME_RTOL, atol=0.0)
    return bool(alike and math.isclose(first.score, second.score, rel_tol=SAME_RTOL))


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
        Squared residuals with each set minus the expected noise, in units of the noise variance. The excess
        of the empty set is the squared gap.
    candidates : tuple of Candidate
        All hypotheses, the model without effects first.
    acts : float
        Same as :attr:`Calibration.acts`.
    no_evidence : float
        Largest excess that is no evidence against a hypothesis of exact form.
    """

    sets: dict[frozenset[str], float]
    none: float
    outside: float
    beside: dict[frozenset[str], float]
    excess: dict[frozenset[str], float]
    candidates: tuple[Candidate, ...]
    acts: float = CALIBRATED.acts
    no_evidence: float = math.inf

    @property
    def known(self) -> dict[frozenset[str], float]:
        """Return for each set the probability that it closes most of the gap without other known effects.

        Known effects are those of the catalogue.

        A cause outside the catalogue may act in addition.
        """
        return {names: p + self.beside[names] for names, p in self.sets.items()}

    @property
    def best(self) -> frozenset[str]:
        """Return the most probable set of effects.

        Its size is the smallest one that suffices with a probability above one half.
        """
        known = self.known
        total = sum(known.values())
        size, fewer = 1, 0.0
        while size < max((len(names) for names in known), default=1):
            fewer += sum(p for names, p in known.items() if len(names) == size)
            if fewer > 0.5 * total:
                break
            size += 1
        mine = {names: p for names, p in known.items() if len(names) == size}
        return max(mine, key=lambda names: mine[names], default=frozenset())

    def having(self, *names: str) -> float:
        """Return the probability that at least one of the named effects is among the causes."""
        within, beside = (
            sum(p for found, p in sets.items() if found & set(names)) for sets in (self.sets, self.beside)
        )
        return min(within + self.acts * beside, 1.0)

    def beside_outside(self, *names: str) -> float:
        """Return the probability that one of the named effects acts, given a cause outside the catalogue."""
        closing = sum(p for found, p in self.beside.items() if found & set(names))
        return self.acts * closing / max(self.outside, 1e-300)

    def closing(self, *names: str) -> float:
        """Return the probability that one of the named effects belongs to the set that closes the gap best.

        The effect may be a cause, or only imitate a cause outside the catalogue.
        """
        return min(sum(p for found, p in self.known.items() if found & set(names)), 1.0)

    def instead(self, name: str, among: frozenset[str], *, exact: bool = False) -> dict[str, float]:
        """Return the probability of each effect that could replace ``name`` in the hypothesis ``among``.

        The other effects of the hypothesis are assumed to act. The probabilities sum to one.

        Parameters
        ----------
        exact : bool
            Whether the form of the effect is exact. Effects that leave a larger excess then cannot take its
            place.
        """
        most = math.inf
        if exact:
            most = self.excess[among] + self.no_evidence
        rest = among - {name}
        found = {}
        for names, p in self.known.items():
            if len(names) == len(among) and rest < names and self.excess.get(names, 0.0) <= most:
                (other,) = names - rest
                found[other] = p
        total = sum(found.values())
        return {n: p / total for n, p in sorted(found.items(), key=lambda item: -item[1])}

    @property
    def left(self) -> float:
        """Return the fraction of the squared gap that remains with the most probable set."""
        gap = self.excess[frozenset()]
        if gap <= 0 or not self.sets:
            return 0.0
        return min(self.excess[self.best] / gap, 1.0)


def prior(size: int, effects: int) -> float:
    """Return the prior log-odds of a set of ``size`` out of ``effects`` effects, against no effect."""
    return math.log((1.0 - FURTHER) * FURTHER ** (size - 1) / math.comb(effects, size))


@dataclass(frozen=True)
class Record:
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


def unit(record: Record, gap: float, known: Calibration = CALIBRATED) -> float:
    """Return the largest excess of squared residuals over the noise that refutes no hypothesis.

    It is the sum of three terms: a discrepancy as large as the noise in all its directions, a model error of
    a tenth of the noise, and the form error of a true effect.
    """
    return known.directions * record.parts + TENTH**2 * record.samples + known.form * max(gap, 0.0)


def _further(
    names: Sequence[frozenset[str]],
    candidates: Sequence[Candidate],
    known: Array,
    closes: Array,
    small: Array,
    directions: float,
) -> None:
    """Limit, in place, the log-evidence that a larger set gains over the most probable smaller set within it.

    Parameters
    ----------
    names : sequence of frozenset of str
        All sets, the empty set first.
    candidates : sequence of Candidate
        All hypotheses except the model without effects.
    known : ndarray, shape (c,)
        Prior log-probability of each hypothesis, minus the cost of its parameters.
    closes : ndarray, shape (c, m)
        Log-evidence of each hypothesis for each sample of the fold weights.
    small : ndarray, shape (c, m)
        ``log(1 + excess / unit)`` of each hypothesis, where the unit contains no form error.
    """
    place = {n: i for i, n in enumerate(names)}
    order = sorted(range(len(candidates)), key=lambda i: len(candidates[i].names))
    for i in (i for i in order if len(candidates[i].names) > 1):
        c = candidates[i]
        within = [(place[c.names - {n}], n) for n in sorted(c.names) if c.names - {n} in place]
        if not within:
            continue
        j, last = max(within, key=lambda w: float(closes[w[0]].mean()))
        apart = 1.0 - c.alike.get(last, 0.0)
        gained = 0.5 * directions * apart * (small[j] - small[i + 1])
        closes[i + 1] = closes[j] - known[j] + known[i + 1] + gained


def penalty(shared: int, own: int, samples: float, trials: int) -> float:
    """Return the BIC penalty for the parameters of effects.

    Each parameter costs the logarithm of the number of samples that depend on it [1]_.

    Parameters
    ----------
    shared, own : int
        Number of shared parameters, and number of per-trial parameters summed over the trials.

    References
    ----------
    .. [1] M. Delattre, M. Lavielle, M.-A. Poursat, "A note on BIC in mixed-effects models", Electronic
       Journal of Statistics 8(1), 2014.
    """
    return shared * math.log(samples) + own * math.log(samples / trials)


def most(excess: float, record: Record) -> float:
    """Return the maximum log-evidence that a further effect can add to a set of effects with this excess."""
    gained = 0.5 * CALIBRATED.further * math.log1p(max(excess, 0.0) / unit(record, 0.0))
    return gained - CALIBRATED.number


def posterior(
    null: Candidate,
    candidates: Sequence[Candidate],
    *,
    record: Record,
    calibration: Calibration = CALIBRATED,
    seed: int = 0,
) -> Posterior:
    """Return the posterior probabilities of all hypotheses.

    Parameters
    ----------
    null : Candidate
        The model without effects.
    candidates : sequence of Candidate
        At most one hypothesis for each set of effects.
    record : Record
        Amount of data.

    References
    ----------
    .. [1] Y. Yao, A. Vehtari, D. Simpson, A. Gelman, "Using stacking to average Bayesian predictive
       distributions", Bayesian Analysis 13(3), 2018: weights by the Bayesian bootstrap.
    .. [2] K. L. Lange, R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t
       distribution", J. Am. Stat. Assoc. 84(408), 1989.
    .. [3] C. Genest, J. V. Zidek, "Combining probability distributions", Statistical Science 1(1), 1986.
    """
    every = [null, *candidates]
    scores = np.array([c.score for c in every])
    folds = np.array([c.folds for c in every])
    excess = scores - min(float(scores.min()), record.samples)
    count = folds.shape[1]
    weight = np.random.default_rng(seed).dirichlet(np.ones(count), WEIGHTINGS) * count
    leader = int(np.argmin(excess))
    drawn = excess[:, None] + (folds - folds[leader]) @ (weight - 1.0).T
    drawn -= np.minimum(drawn.min(axis=0), 0.0)
    size = np.log1p(drawn / unit(record, float(excess[0]), calibration))
    costs = np.array([calibration.number * c.numbers for c in candidates])
    # Twins are one hypothesis, and share its prior probability.
    better = [c for c in candidates if c.score < null.score]
    same = np.array([max(sum(are_twins(c, other) for other in better), 1) for c in candidates])
    known = np.array([prior(len(c.names), record.effects) for c in candidates]) - costs - np.log(same)
    known = np.concatenate(([0.0], known))
    closes = known[:, None] + 0.5 * calibration.directions * record.parts * (size[0] - size)
    closes[0] = 0.0
    exact = np.array([c.exact for c in every])
    closes[exact] += _exact_form(drawn[exact], drawn[0], size[exact], record, calibration)
    small = np.log1p(drawn / unit(record, 0.0, calibration))
    _further([c.names for c in every], candidates, known, closes, small, calibration.further)
    pooled = _pooled(every, record, calibration)
    beyond = closes + calibration.outside + calibration.grows * size
    if pooled is not None:
        closes[1:] = _spread(closes[1:], pooled[1:])
        beyond = _spread(beyond, pooled)
    evidence = np.vstack((closes, beyond))
    p = np.exp(evidence - logsumexp(evidence, axis=0)).mean(axis=1)
    inside, beside = np.split(p, 2)
    return Posterior(
        {c.names: float(v) for c, v in zip(candidates, inside[1:], strict=True)},
        float(inside[0]),
        float(beside.sum()),
        {c.names: float(v) for c, v in zip(every, beside, strict=True)},
        {c.names: float(e) for c, e in zip(every, excess, strict=True)},
        tuple(every),
        calibration.acts,
        unit(record, 0.0, calibration),
    )


def _exact_form(left: Array, gap: Array, size: Array, record: Record, known: Calibration) -> Array:
    """Return the log-evidence that hypotheses gain because their form is exact, shape (c, m).

    Nothing but noise may remain with such a hypothesis. In return it is compared as exactly with the model
    without effects, up to the gap that refutes no hypothesis (:func:`unit`).

    Parameters
    ----------
    left, gap : ndarray, shapes (c, m) and (m,)
        Excess of the hypotheses, and of the model without effects, for each sample of the fold weights.
    size : ndarray, shape (c, m)
        ``log(1 + excess / unit)`` of the hypotheses, where the unit contains the form error.
    """
    noise, most = known.directions * record.parts, unit(record, 0.0, known)
    shown = np.minimum(gap, most)
    gained = np.log1p(shown / noise) - np.log1p(shown / unit(record, most, known))
    return np.asarray(0.5 * noise * (gained - np.log1p(left / noise) + size))


def _pooled(every: Sequence[Candidate], record: Record, known: Calibration) -> Array | None:
    """Return the log-evidence of each hypothesis with long-memory noise, shape (candidates,).

    Return None if there are enough trials to estimate the noise.
    """
    slow = np.array([math.nan if c.slow is None else c.slow for c in every])
    if np.isnan(slow).any():
        return None
    excess = slow - min(float(slow.min()), record.samples)
    size = np.log1p(excess / unit(record, float(excess[0]), known))
    return np.asarray(0.5 * known.directions * record.parts * (size[0] - size))


def _spread(evidence: Array, gained: Array) -> Array:
    """Add ``gained`` to the log-evidence of each hypothesis, and rescale so that the total stays the same.

    Parameters
    ----------
    evidence : ndarray, shape (c, m)
        Log-evidence of each hypothesis for each sample of the fold weights.
    """
    if not len(evidence):
        return evidence
    moved = evidence + gained[:, None]
    return np.asarray(moved + logsumexp(evidence, axis=0) - logsumexp(moved, axis=0))
