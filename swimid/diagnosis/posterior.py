"""Compute the posterior probability of each set of causes, of no gap, and of a cause outside the catalogue.

Even a true effect has not exactly the form that it has in the catalogue. The excess of a hypothesis (its
squared residuals beyond the noise) is therefore treated as a discrepancy of unknown variance in some
directions of each part of the data. At the most likely variance the log-evidence decreases by half of the
number of directions times the logarithm of the excess (a Student likelihood in place of a Gaussian one). A
rival must leave several times as much, not only a few samples more.

A further cause is weighed against the error of form of the causes before it. Where its change is like theirs
it gains nothing. Elsewhere it must close nearly all of the remaining excess, because an error of form hardly
ever looks like one effect. The folds are weighted at random (Bayesian bootstrap), so that an effect that
helps in one fold only is uncertain.

A few trials do not separate slow noise from a gap. Whether there is a gap, and how much of it is closed, is
then judged with noise of short memory. The cause must also be probable with noise of long memory. The two are
pooled by their logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from swimid.fitting.model import Array

#: Model error, over the noise, that counts as no gap.
TENTH = 0.1
#: Prior odds of one further cause (chosen: a gap of several causes is assumed to be rarer).
FURTHER = 0.1
#: A gap is stated if the probability of no gap is below this.
UNSURE = 0.1
#: Number of random weightings of the folds.
WEIGHTINGS = 200


@dataclass(frozen=True)
class Calibration:
    """Constants that are calibrated on trials with known causes.

    Attributes
    ----------
    directions : float
        Number of directions, in each part of the data, of the discrepancy of a true effect of another form.
    form : float
        Share of the squared gap that a true effect may leave because of its form.
    number : float
        Cost of each kind of parameter of an effect, beyond the penalty for its parameters.
    further : float
        Number of directions, of the whole record, of the error of form of a true effect.
    outside, grows : float
        Log-evidence of a cause outside the catalogue if nothing is left, and its growth with the logarithm of
        the excess.
    acts : float
        Probability that an effect that closes most beside a cause outside the catalogue acts itself, and does
        not only imitate that cause.
    """

    directions: float
    form: float
    number: float
    further: float
    outside: float
    grows: float
    acts: float


#: From ``python -m tests.calibrate`` on trials made by other code, each also judged with its true effect
#: hidden from the catalogue.
CALIBRATED = Calibration(8.7, 0.30, 1.4, 8.0, -2.7, 4.3, 0.15)


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with its scores.

    Attributes
    ----------
    names : frozenset of str
        Of its effects.
    score : float
        Squared residuals at its optimum, in units of the noise, and the penalty for its parameters.
    folds : ndarray, shape (folds,)
        Squared residuals of each fold.
    numbers : int
        Number of kinds of parameters of its effects; the per-trial values of one parameter are one kind.
    alike : mapping of str to float
        For each effect of a set, the largest squared cosine between its change and that of another one, with
        the model's parameters projected out.
    slow : float, optional
        The score with noise of long memory, if the trials are too few to decide.
    """

    names: frozenset[str]
    score: float
    folds: Array
    numbers: int
    slow: float | None = None
    alike: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Posterior:
    """Posterior probabilities, which sum to one.

    Attributes
    ----------
    sets : dict of frozenset of str to float
        Probability that exactly these effects are missing in the model.
    none : float
        Probability that nothing is missing.
    outside : float
        Probability of a cause outside the catalogue, alone or beside a set.
    beside : dict of frozenset of str to float
        The same with each set that closes most of the closed gap; for the empty set, none does.
    excess : dict of frozenset of str to float
        Excess of each set in units of the noise; of the empty set the gap.
    candidates : tuple of Candidate
        All hypotheses, the model without effects first.
    acts : float
        As in the calibration.
    no_evidence : float
        Excess that is no evidence against a hypothesis of exact form.
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
        """Return the probability that each set closes most without other effects of the catalogue,
        whatever else acts.
        """
        return {names: p + self.beside[names] for names, p in self.sets.items()}

    @property
    def best(self) -> frozenset[str]:
        """Return the most probable set, with only effects that are more probably needed than not."""
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
        """Return the probability that one of some effects is among the causes."""
        within, beside = (
            sum(p for found, p in sets.items() if found & set(names)) for sets in (self.sets, self.beside)
        )
        return min(within + self.acts * beside, 1.0)

    def beside_outside(self, *names: str) -> float:
        """Return the probability that one of some effects acts beside a cause outside the catalogue."""
        closing = sum(p for found, p in self.beside.items() if found & set(names))
        return self.acts * closing / self.outside if self.outside > 0 else 0.0

    def closing(self, *names: str) -> float:
        """Return the probability that one of some effects closes most of the closed gap, as a cause or as
        an imitation.
        """
        return min(sum(p for found, p in self.known.items() if found & set(names)), 1.0)

    def instead(self, name: str, among: frozenset[str], *, exact: bool = False) -> dict[str, float]:
        """Return the probability of each effect in the place of one of a set, given the others; they sum to
        one.

        Parameters
        ----------
        exact : bool
            Whether the effect has no other form than its own, so that no effect that leaves more takes its
            place.
        """
        most = self.excess[among] + self.no_evidence if exact else math.inf
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
        """Return the share of the squared gap that the most probable set leaves."""
        gap = self.excess[frozenset()]
        return min(self.excess[self.best] / gap, 1.0) if gap > 0 and self.sets else 0.0


def prior(size: int, effects: int) -> float:
    """Return the prior log-odds of a set with some number of effects; 0 for no effect."""
    return math.log((1.0 - FURTHER) * FURTHER ** (size - 1) / math.comb(effects, size))


@dataclass(frozen=True)
class Record:
    """Size of the data.

    Attributes
    ----------
    samples : float
        Number of residuals.
    parts : int
        Number of folds: settings, or stretches of a few trials.
    effects : int
        Number of effects that apply.
    """

    samples: float
    parts: int
    effects: int


def unit(record: Record, gap: float, known: Calibration = CALIBRATED) -> float:
    """Return the excess that is no evidence.

    It has three terms: a discrepancy as large as the noise in all its directions, a tenth of the noise, and
    the error of form of a true effect.
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
    """Limit, in place, what larger sets gain over the most probable smaller one within each.

    Parameters
    ----------
    names : sequence of frozenset of str
        All sets, the empty one first.
    candidates : sequence of Candidate
        All but the model without effects.
    known : ndarray, shape (c,)
        Prior log-probability of each, and the cost of its parameters.
    closes : ndarray, shape (c, m)
        Log-evidence of each in each weighting.
    small : ndarray, shape (c, m)
        Logarithm of the excess of each over its unit without the error of form.
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
    """Return the penalty for parameters of effects: the logarithm of the number of samples that inform each
    [1]_.

    Parameters
    ----------
    shared, own : int
        Number of shared parameters, and of per-trial parameters of all trials.

    References
    ----------
    .. [1] M. Delattre, M. Lavielle, M.-A. Poursat, "A note on BIC in mixed-effects models", Electronic
       Journal of Statistics 8(1), 2014.
    """
    return shared * math.log(samples) + own * math.log(samples / trials)


def most(excess: float, record: Record) -> float:
    """Return the maximum gain in log-evidence of a larger set."""
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
        At most one for each set of effects.
    record : Record

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
    known = np.array([prior(len(c.names), record.effects) for c in candidates]) - costs
    known = np.concatenate(([0.0], known))
    closes = known[:, None] + 0.5 * calibration.directions * record.parts * (size[0] - size)
    closes[0] = 0.0
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


def _pooled(every: Sequence[Candidate], record: Record, known: Calibration) -> Array | None:
    """Return the log-evidence with noise of long memory, shape (candidates,); None if the trials determine
    the noise.
    """
    slow = np.array([math.nan if c.slow is None else c.slow for c in every])
    if np.isnan(slow).any():
        return None
    excess = slow - min(float(slow.min()), record.samples)
    size = np.log1p(excess / unit(record, float(excess[0]), known))
    return np.asarray(0.5 * known.directions * record.parts * (size[0] - size))


def _spread(evidence: Array, gained: Array) -> Array:
    """Redistribute log-evidence, shape (c, m), over the candidates; its sum stays."""
    if not len(evidence):
        return evidence
    moved = evidence + gained[:, None]
    return np.asarray(moved + logsumexp(evidence, axis=0) - logsumexp(moved, axis=0))
