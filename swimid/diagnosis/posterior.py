"""How likely is each set of causes, that there is no gap, and that the cause is none of the catalogue.

Even a true effect has not quite the form it has in the catalogue: what a hypothesis leaves beyond the noise,
its excess, is a discrepancy of unknown variance in some directions of each part of the data. With the
variance at its likeliest the logarithm of the evidence falls by half of their number times that of the excess
(a Student likelihood in place of a Gaussian one): a rival must leave several times as much, and not only a
few samples' worth more.
A further cause is weighed against the error of form of those before it: in what it changes like them it
tells nothing, and elsewhere it must close nearly all that they leave, as an error of form hardly ever looks
just so.
Folds of trials are weighted at random (the Bayesian bootstrap): what helps in one alone is unsure.

A few trials do not tell slow noise from a gap. That there is one, and how much of it is closed, is then
judged by noise of short memory, as instruments have it; which set closes it must be likely with noise of
long memory, too: the two are pooled by their logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from swimid.fitting.model import Array

#: A model whose error is a tenth of the noise has no gap to speak of.
TENTH = 0.1
#: Odds of one more cause, before any data (measured by no one: a gap of several causes is taken to be rarer).
FURTHER = 0.1
#: A gap is told where that there is none is less likely than this.
UNSURE = 0.1
#: Weightings of the folds.
WEIGHTINGS = 200


@dataclass(frozen=True)
class Calibration:
    """What is learnt from trials with known causes.

    Attributes
    ----------
    directions : float
        In each part of the data, of the discrepancy of a true effect of another form.
    form : float
        Share of the squared gap that a true effect may leave by its form alone.
    number : float
        Of the evidence for an effect, what each kind of its numbers costs beyond the noise's account.
    further : float
        Directions, of the whole record, in which what a true effect leaves by its form may lie.
    outside, grows : float
        Of the evidence that something from outside the catalogue is at work, too: its logarithm where nothing
        is left, and how much it grows with that of what is.
    acts : float
        Of the causes from outside beside which an effect of the catalogue closes most, the share beside which
        that effect is at work, too, and does not only imitate them.
    """

    directions: float
    form: float
    number: float
    further: float
    outside: float
    grows: float
    acts: float


#: By ``python -m tests.calibrate`` on trials made by other code, each also judged with its true effect
#: hidden from the catalogue.
CALIBRATED = Calibration(8.7, 0.30, 1.4, 8.0, -2.7, 4.3, 0.15)


@dataclass(frozen=True)
class Candidate:
    """A hypothesis as it is judged.

    Attributes
    ----------
    names : frozenset of str
        Of its effects.
    score : float
        Squared residuals at its optimum, in units of the noise, and what its numbers must lower them by.
    folds : ndarray, shape (folds,)
        Squared residuals of each fold.
    numbers : int
        How many kinds of them its effects have; what each trial has of its own is one kind.
    alike : mapping of str to float
        Of each effect of several, the largest squared cosine between what it changes and what another of them
        does, the numbers of the model projected out.
    slow : float, optional
        The score with noise of long memory, where trials are too few to tell which it is.
    """

    names: frozenset[str]
    score: float
    folds: Array
    numbers: int
    slow: float | None = None
    alike: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Posterior:
    """Probabilities, which sum to one.

    Attributes
    ----------
    sets : dict of frozenset of str to float
        That these effects, and no others, are what the model lacks.
    none : float
        That it lacks nothing.
    outside : float
        That it lacks something else, alone or beside a set.
    beside : dict of frozenset of str to float
        The same where each set closes most of what is closed; of the empty one, none does.
    excess : dict of frozenset of str to float
        What each leaves beyond the noise, in its units; of the empty set the gap.
    candidates : tuple of Candidate
        What was weighed, the model as it is first.
    acts : float
        As of the calibration.
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
        """How likely each set closes most with nothing else of the catalogue, whatever is beside it."""
        return {names: p + self.beside[names] for names, p in self.sets.items()}

    @property
    def best(self) -> frozenset[str]:
        """The likeliest set, of no more effects than are likelier needed than not; empty of none tried."""
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
        """Probability that one of some effects is among the causes."""
        within, beside = (
            sum(p for found, p in sets.items() if found & set(names)) for sets in (self.sets, self.beside)
        )
        return min(within + self.acts * beside, 1.0)

    def beside_outside(self, *names: str) -> float:
        """Probability that one of some effects is at work, too, where something from outside is."""
        closing = sum(p for found, p in self.beside.items() if found & set(names))
        return self.acts * closing / self.outside if self.outside > 0 else 0.0

    def closing(self, *names: str) -> float:
        """Probability that one of some effects closes most of what is closed, at work or as an imitation."""
        return min(sum(p for found, p in self.known.items() if found & set(names)), 1.0)

    def instead(self, name: str, among: frozenset[str], *, exact: bool = False) -> dict[str, float]:
        """How likely each effect is in the place of one of a set, the others given; they sum to one.

        Parameters
        ----------
        exact : bool
            The effect has no other form than its own, so that none takes its place that leaves more.
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
        """Share of the gap's squared size that the likeliest set leaves."""
        gap = self.excess[frozenset()]
        return min(self.excess[self.best] / gap, 1.0) if gap > 0 and self.sets else 0.0


def prior(size: int, effects: int) -> float:
    """Logarithm of what a set of so many effects has before any data; of no effect it is 0."""
    return math.log((1.0 - FURTHER) * FURTHER ** (size - 1) / math.comb(effects, size))


@dataclass(frozen=True)
class Record:
    """How much there is to judge by.

    Attributes
    ----------
    samples : float
        Residuals in all.
    parts : int
        Folds of the cross-validation: settings, or stretches of a few trials.
    effects : int
        How many apply.
    """

    samples: float
    parts: int
    effects: int


def unit(record: Record, gap: float, known: Calibration = CALIBRATED) -> float:
    """Excess that is no evidence: a discrepancy as small as noise in all its directions, or a tenth of it, or
    what another form of the true effect leaves of the gap.
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
    """What larger sets close, from that of the likeliest smaller one within each; in place.

    Parameters
    ----------
    names : sequence of frozenset of str
        All sets, the empty one first.
    candidates : sequence of Candidate
        All but the model as it is.
    known : ndarray, shape (c,)
        Logarithm of what each has before any data, and what its numbers cost.
    closes : ndarray, shape (c, m)
        Logarithmic evidence of each in each weighting.
    small : ndarray, shape (c, m)
        Logarithm of what each leaves, in units that the error of form takes no part in.
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
    """What numbers of effects must lower the cost by: the logarithm of the samples that tell each, of all
    trials or of one [1]_.

    Parameters
    ----------
    shared, own : int
        Numbers of all trials, and those each trial has for itself, of all trials together.

    References
    ----------
    .. [1] M. Delattre, M. Lavielle, M.-A. Poursat, "A note on BIC in mixed-effects models", Electronic
       Journal of Statistics 8(1), 2014.
    """
    return shared * math.log(samples) + own * math.log(samples / trials)


def most(excess: float, record: Record) -> float:
    """What a larger set may gain in logarithmic evidence at most."""
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
    """Weigh all hypotheses.

    Parameters
    ----------
    null : Candidate
        The model as it is.
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
    """What each gains with noise of long memory, shape (candidates,); None where trials tell the noise."""
    slow = np.array([math.nan if c.slow is None else c.slow for c in every])
    if np.isnan(slow).any():
        return None
    excess = slow - min(float(slow.min()), record.samples)
    size = np.log1p(excess / unit(record, float(excess[0]), known))
    return np.asarray(0.5 * known.directions * record.parts * (size[0] - size))


def _spread(evidence: Array, gained: Array) -> Array:
    """Logarithmic evidence, shape (c, m), spread over the candidates anew; its sum stays."""
    if not len(evidence):
        return evidence
    moved = evidence + gained[:, None]
    return np.asarray(moved + logsumexp(evidence, axis=0) - logsumexp(moved, axis=0))
