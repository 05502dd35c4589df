"""Decide the verdict of a diagnosis from one table.

Each row of the table asks one question. A row that does not pass states the strongest verdict that is then
possible, and which causes are still named. The verdict is the weakest of these. The table depends on the
facts in the gap file only (:class:`~swimid.diagnosis.gap_file.Facts`), so that it can be computed again from
the file.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from swimid.diagnosis.gap_file import Closed, Facts, HeldOutTrial, Shrinkage, Verdict
from swimid.fitting.model import Array
from swimid.results import numbers
from swimid.results.numbers import listed, number, percent, probability_text

#: Model whose squared error is the reference of a closed share: with the parameters as given, or refitted
#: without the causes.
Reference = Literal["as_given", "before"]
#: The models whose squared gap the causes must close for the verdict "explained", with words for each.
REFERENCES: dict[Reference, str] = {"before": "after a refit", "as_given": "of the model as given"}
#: Verdicts from the strongest to the weakest.
ORDER: tuple[Verdict, ...] = ("none", "explained", "ambiguous", "unexplained")
#: Minimum probability of causes in the catalogue, divided by that of all causes, for the verdict "explained".
SURE = 0.8
#: Minimum share of the squared gap that the causes must close for the verdict "explained".
MOST = 0.5
#: Minimum probability that the causes reduce the errors on held-out data.
CLEAR = 0.95
#: Minimum squared gap, as a fraction of the squared error, for a closed share. A smaller gap is a difference
#: of nearly equal numbers.
LEAST_GAP = 0.04
#: Number of random samples of the weights of the held-out trials (Bayesian bootstrap).
WEIGHTINGS = 1000


@dataclass(frozen=True)
class Row:
    """Row of the table from which the verdict follows.

    Attributes
    ----------
    question, found, needed : str
        Name of the question, the answer, and the answer that the strongest verdict needs.
    passed : bool
    otherwise : Verdict
        Strongest verdict that is possible if the row does not pass.
    names : {"all", "closing", "none"}
        Causes that are named if the row does not pass: all of them, those that close part of the gap with a
        probability above one half, or none.
    reason : str
        Clause that states why the row does not pass.
    """

    question: str
    found: str
    needed: str
    passed: bool
    otherwise: Verdict
    names: Literal["all", "closing", "none"] = "all"
    reason: str = ""


@dataclass(frozen=True)
class Decision:
    """Verdict, and names of the causes that the answer states."""

    verdict: Verdict
    causes: tuple[str, ...]


def decide(facts: Facts, *, without: str = "") -> Decision:
    """Return the verdict that follows from the facts: the weakest verdict of the rows that do not pass.

    Parameters
    ----------
    without : str, optional
        Question of the rows that are left out, to measure what they contribute.
    """
    failed = [row for row in rows(facts) if not row.passed and row.question != without]
    verdicts: list[Verdict] = ["none", *(row.otherwise for row in failed)]
    causes = facts.proposed
    for row in failed:
        if row.names == "none":
            causes = {}
        if row.names == "closing":
            causes = {name: c for name, c in causes.items() if c.closing > 0.5}
    if causes or facts.failed_samples:
        verdicts.append("explained")
    return Decision(max(verdicts, key=ORDER.index), tuple(causes))


def rows(facts: Facts) -> Iterator[Row]:
    """Yield the rows of the table. A question that does not apply to the trials has no row."""
    if facts.unreproduced:
        found = listed([f"{percent(v, 2)} of {c}" for c, v in facts.unreproduced.items()])
        reason = f"the model reproduces {found}"
        yield Row("output reproduced", found, "≥ 50 %", False, "unexplained", "none", reason)
    if facts.proposed:
        yield from _of_causes(facts)
    else:
        yield from _of_no_cause(facts)
    for trial, times in facts.odd_trial.items():
        reason = f"{trial} contradicts the other trials, with {number(times, 2)} times their error"
        yield Row("trials agree", trial, "all", False, "unexplained", "none", reason)


def _of_no_cause(facts: Facts) -> Iterator[Row]:
    """Yield the rows of a model to which the fits add no cause."""
    none, outside = facts.no_gap or 0.0, facts.outside or 0.0
    found = f"no gap {probability_text(none)}, a cause outside the catalogue {probability_text(outside)}"
    reason = "a cause outside the catalogue is more probable than no gap"
    yield Row("gap", found, "no gap likelier", none >= outside, "unexplained", "none", reason)
    yield _predicted(facts.unpredicted, "unexplained")
    found = listed(facts.differing) or "by chance"
    reason = f"trials differ more than by chance: {found}"
    yield Row(
        "differences between trials", found, "by chance", not facts.differing, "unexplained", "none", reason
    )


def _of_causes(facts: Facts) -> Iterator[Row]:
    """Yield the rows of a model to which the fits add causes."""
    names = listed(list(facts.proposed))
    name, first = next(iter(facts.proposed.items()))
    inside, outside = facts.catalogue or 0.0, facts.outside or 0.0
    share = inside / max(inside + outside, 1e-300)
    verdict: Verdict = "ambiguous"
    kept: Literal["all", "closing"] = "all"
    if share <= 0.5:
        verdict, kept = "unexplained", "closing"
    found = f"{probability_text(share)} of the probability of a gap"
    reason = f"a cause outside the catalogue has {percent(1.0 - share, 2)} of the probability of a gap"
    yield Row("cause in the catalogue", found, f"≥ {percent(SURE)}", share >= SURE, verdict, kept, reason)
    rivals = listed(first.equivalent, "or")
    reason = f"these trials cannot tell {name} from {rivals or 'other effects'}"
    passed = first.alone > 0.5 and not first.crowded
    found = f"{probability_text(first.alone)} of the probability of cause and rivals"
    yield Row("cause against its rivals", found, "> 50 %", passed, "ambiguous", "all", reason)
    if facts.imitated:
        reason = f"the refitted parameters of the file imitate {names} on held-out data"
        yield Row("cause against the parameters", "imitated", "distinct", False, "ambiguous", "all", reason)
    yield from _held_out(facts, names)
    yield _predicted(facts.unpredicted, "ambiguous")
    left = facts.left or 0.0
    reason = f"{percent(left, 2)} of the squared gap remains in the fit with {names}"
    found = f"{percent(left, 2)} of the squared gap"
    yield Row("remaining gap", found, f"≤ {percent(MOST)}", left <= MOST, "unexplained", "closing", reason)


def _predicted(unpredicted: dict[str, float], otherwise: Verdict) -> Row:
    """Return the row about validation trials that the model does not predict."""
    found = listed([f"{trial} is off by {number(t, 2)} times" for trial, t in unpredicted.items()])
    reason = f"{found} the expected error"
    return Row(
        "validation trials", found or "predicted", "predicted", not unpredicted, otherwise, "all", reason
    )


def _held_out(facts: Facts, names: str) -> Iterator[Row]:
    """Yield the rows about the decrease of the squared error on held-out data."""
    if facts.diverged:
        reason = f"a simulation of held-out data diverges with {names}"
        yield Row("held-out simulation", "diverges", "finite", False, "unexplained", "none", reason)
    if not facts.gains:
        return
    lower = probability_of_decrease(facts)
    needed, found = f"probability ≥ {percent(CLEAR)}", f"probability {probability_text(lower)}"
    reason = f"held-out errors do not clearly fall with {names} ({found})"
    yield Row("held-out errors fall", found, needed, lower >= CLEAR, "unexplained", "none", reason)
    each = [(*closes_most(closed_share(facts, r)), words) for r, words in REFERENCES.items()]
    passed, found, words = min(each, key=lambda one: one[0])
    reason = f"less than half of the squared gap {words} closes on held-out data: {found}"
    yield Row("squared gap closed", found, f"≥ {percent(MOST)}", passed, "ambiguous", "all", reason)


def closes_most(closed: Closed) -> tuple[bool, str]:
    """Return whether the causes close most of the squared gap, and the closed share as text."""
    if closed.share is None:
        return False, "unknown, because held-out data have no gap"
    return closed.share >= MOST, f"{percent(closed.share, 2)} {interval_text(closed)}".strip()


def probability_of_decrease(facts: Facts) -> float:
    """Return the probability that the causes reduce the errors on held-out data.

    It is computed from the distances of the cross-validation folds and validation trials from their
    predictions. If most of the squared error of the held-out trials is a gap, or if the causes are compared
    with the model as given and not with its refit, it is also computed from these squared errors. One of the
    two probabilities is then enough, unless the squared errors clearly grow in a gap of that size.

    The folds and trials get random weights (Bayesian bootstrap).
    """
    of_distances = _probability(list(facts.gains.values()))
    closed = closed_share(facts, "before")
    is_clear = closed.before is not None and closed.before > 1.0 / (1.0 - MOST)
    if not is_clear and any(t.before != t.as_given for t in facts.held_out.values()):
        return of_distances
    of_errors = _probability([t.before - t.after for t in facts.held_out.values()])
    if is_clear and of_errors <= 1.0 - CLEAR:
        return of_errors
    return max(of_distances, of_errors)


def _probability(lowered: Sequence[float | None]) -> float:
    """Return the probability that a sum of decreases with random weights is positive."""
    values = np.array(lowered, dtype=float)
    return float(np.mean(_weights(len(values)) @ values > 0.0))


def closed_share(facts: Facts, reference: Reference = "as_given") -> Closed:
    """Return the closed share of the squared gap over all channels, with its interval.

    See :func:`closed_gap` for the reference.
    """
    return closed_gap(facts.held_out, facts.noise, reference)


def _weights(count: int) -> Array:
    """Return random weights of trials, shape (WEIGHTINGS, count)."""
    return np.random.default_rng(0).dirichlet(np.ones(count), WEIGHTINGS)


# ---------------------------------------------------------------- closed share


def share_closed(before: float, after: float, floor: float) -> float:
    """Return the closed share of the squared gap, at most 1; NaN without a gap.

    The share is ``(before**2 - after**2) / (before**2 - floor**2)``.
    """
    gap = before**2 - floor**2
    if gap <= LEAST_GAP * max(before**2, 1e-300):
        return math.nan
    return float(min((before**2 - after**2) / gap, 1.0))


def closed_gap(
    trials: Mapping[str, HeldOutTrial], noise: Mapping[str, float], reference: Reference = "as_given"
) -> Closed:
    """Return the closed share of the squared gap of held-out trials, with its 95 % interval.

    Parameters
    ----------
    trials : mapping of trial to HeldOutTrial
        Squared errors, in units of the noise variance.
    noise : mapping of trial to float
        Mean squared noise of each fitted trial, divided by that of all fitted trials.
    reference : {"as_given", "before"}
        Model whose gap closes: the model with the parameters as given, or the refitted model without causes.
    """
    count = sum(t.samples for t in trials.values())
    if not count:
        return Closed(before=None, after=None, share=None)
    before = sum(getattr(t, reference) for t in trials.values()) / count
    after = sum(t.after for t in trials.values()) / count
    share = share_closed(math.sqrt(before), math.sqrt(after), 1.0)
    return Closed(before=before, after=after, share=share, ci95=interval(share, before, trials, noise))


def interval(
    share: float, before: float, trials: Collection[str], noise: Mapping[str, float]
) -> tuple[float | None, float | None]:
    """Return the 95 % interval of the closed share of these held-out trials; unknown without a gap.

    The share is uncertain because the errors contain the noise of the held-out trials, and because the floor
    is estimated. The mean squared noise of a trial has a variance v, which is estimated from the fitted
    trials. The variance of a mean squared error 1 + e is then v (1 + 2 e), as that of a noncentral
    chi-squared variable. The interval uses Student's distribution. It is unknown from fewer than three fitted
    trials.

    Parameters
    ----------
    before : float
        Mean squared error without the causes, in units of the noise variance.
    trials : collection of str
        Names of the held-out trials.
    noise : mapping of trial to float
        Mean squared noise of each fitted trial, divided by that of all fitted trials.
    """
    fitted = len(noise)
    if fitted < 3 or not math.isfinite(share):
        return None, None
    gap, left = before - 1.0, max(1.0 - share, 0.0)
    # Both errors contain the same noise, so that the part that the closed share multiplies is common to them.
    variance = (share**2 + 2.0 * left * (1.0 + left) * gap) / len(trials)
    if not noise.keys() & set(trials):
        variance += share**2 / fitted
    variance *= float(np.var(list(noise.values()), ddof=1))
    half = float(special.stdtrit(fitted - 1, 0.975)) * math.sqrt(variance) / gap
    return share - half, min(share + half, 1.0)


def over_channels(found: Sequence[Shrinkage]) -> Closed:
    """Return the closed share of the squared gap over channels from their errors, with equal weights."""
    known = [s for s in found if s.floor and s.shipped is not None and s.after is not None]
    if not known:
        return Closed(before=None, after=None, share=None)
    errors = np.array([[s.shipped, s.after] for s in known]) / np.array([[s.floor] for s in known])
    before, after = np.mean(errors**2, axis=0).tolist()
    return Closed(before=before, after=after, share=share_closed(math.sqrt(before), math.sqrt(after), 1.0))


def interval_text(s: Closed | Shrinkage) -> str:
    """Return the 95 % interval of a closed share as text, for example ``(81 … 94 %)``."""
    low, high = s.ci95
    if low is None or high is None:
        return ""
    return f"({numbers.interval(100.0 * low, 100.0 * high, 100.0 * (high - low), '%')})"
