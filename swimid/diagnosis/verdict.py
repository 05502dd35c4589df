"""Definition of the verdicts of a diagnosis.

The verdict follows from the facts in the gap file (:class:`~swimid.diagnosis.gap_file.Facts`) alone, so that
it can be computed again from the file. :func:`list_rows` compares the facts with thresholds, one row for each
question. A row that does not pass states the strongest verdict that is then possible, and whether causes are
still named. The verdict is the weakest one of all rows. From the strongest to the weakest:

none
        The fits propose no cause, because the probability of no gap is above 50 %, and no held-out part has a
        squared error above its limit.
explained
        The fits propose causes, and all rows pass. The probability of no gap is at most 10 %. Known causes
        have at least 80 % of the probability of a gap, and the first cause has at least 80 % of the
        probability of itself and its rivals. Held-out errors fall with a probability of at least 95 %, and
        not in one part alone. The causes leave at most 22 % of the squared gap on held-out data, and make no
        part worse. This gap is the one that a refit without causes leaves, or that of the parameters as given
        if it is smaller. Changed parameters, and causes that a refit imitates, are compared with the
        parameters as given. Failed samples alone are explained as well.
ambiguous
        Causes are named, but the probability of no gap is above 10 %, the first cause has less than 80 % of
        the probability of itself and its rivals, a refit closes the gap as well, one held-out part alone
        carries the decrease of the error, the causes make a part worse, or held-out data have no gap that
        could close.
partial
    Causes are named and held-out errors fall, but more than 22 % of the squared gap remains, or a cause
    outside the catalogue has more than 20 % of the probability of a gap.
unexplained
    There is a gap, or a held-out part above its limit, and no cause that lowers the held-out errors clearly;
    or the simulation of held-out data diverges with the causes; or a black-box model reproduces less than
    half of an output.

The exception: if the probability of no gap is above 10 %, and noise explains the held-out errors without the
causes, the verdict is ambiguous and not weaker. The level of the result is bad if a row that allows only
``unexplained`` does not pass, caution if another check does not pass, and good otherwise. So ``none`` and
``explained`` are good unless a check warns, ``ambiguous`` and ``partial`` are cautions, and ``unexplained``
is bad.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from swimid.diagnosis.gap_file import Closed, Facts, HeldOutTrial, Verdict
from swimid.diagnosis.nominal import PREFIX
from swimid.diagnosis.posterior import CALIBRATED, MAX_NO_GAP_PROBABILITY
from swimid.fitting.rivals import STRONG
from swimid.results import numbers
from swimid.results.numbers import format_number, join_names, percent, probability_text

#: Verdicts from the strongest to the weakest.
VERDICT_ORDER: tuple[Verdict, ...] = ("none", "explained", "ambiguous", "partial", "unexplained")
#: Minimum value of two shares for the verdict "explained": the probability of causes in the catalogue divided
#: by that of all causes, and the probability of a cause divided by that of the cause and its rivals.
MIN_SURE_PROBABILITY = 0.8
#: Minimum share of the squared gap that failed samples, or a black-box model, must close.
MIN_CLOSED_SHARE = 0.5
#: Minimum probability that the causes reduce the errors on held-out data.
MIN_DECREASE_PROBABILITY = 0.95
#: Number of random samples of the weights of the held-out parts.
N_PART_WEIGHTS = 1000


@dataclass(frozen=True)
class VerdictRow:
    """Row of the table from which the verdict follows.

    Attributes
    ----------
    question, found, needed : str
        Name of the question, the answer, and the answer that the strongest verdict needs.
    passed : bool
    otherwise : Verdict
        Strongest verdict that is possible if the row does not pass.
    named : bool
        Whether causes are named if the row does not pass.
    reason : str
        Clause that states why the row does not pass.
    """

    question: str
    found: str
    needed: str
    passed: bool
    otherwise: Verdict
    named: bool = True
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
    failed = [row for row in list_rows(facts) if not row.passed and row.question != without]
    causes = tuple(facts.proposed) if all(row.named for row in failed) else ()
    if _is_doubtful(facts, failed):
        return Decision("ambiguous", causes)
    verdicts: list[Verdict] = ["none", *(row.otherwise for row in failed)]
    if causes or facts.failed_samples:
        verdicts.append("explained")
    weakest = max(verdicts, key=VERDICT_ORDER.index)
    if weakest == "partial" and not causes:
        # A partial verdict needs a cause that closes a part of the gap.
        weakest = "unexplained"
    return Decision(weakest, causes)


def _is_doubtful(facts: Facts, failed: Sequence[VerdictRow]) -> bool:
    """Return whether there may be no gap, so that nothing is left unexplained."""
    within = sum(t.before - t.limit for t in facts.held_out.values()) <= 0.0
    doubts = facts.proposed and any(row.question == "gap" for row in failed)
    return bool(doubts) and within and not (facts.diverged or facts.unreproduced)


def list_rows(facts: Facts) -> Iterator[VerdictRow]:
    """Yield the rows of the table. A question that does not apply to the trials has no row."""
    if facts.unreproduced:
        found = join_names([f"{percent(v, 2)} of {c}" for c, v in facts.unreproduced.items()])
        reason = f"the model reproduces only {found}"
        yield VerdictRow("output reproduced", found, "≥ 50 %", False, "unexplained", False, reason)
    if facts.proposed:
        yield from _of_causes(facts)
    else:
        yield from _of_no_cause(facts)


def _of_no_cause(facts: Facts) -> Iterator[VerdictRow]:
    """Yield the rows of a model to which the fits add no cause."""
    none = facts.no_gap or 0.0
    found = format_otherwise(facts)
    reason = f"the probability that there is no gap is only {probability_text(none)}"
    yield VerdictRow("gap", found, "no gap > 50 %", none > 0.5, "unexplained", False, reason)
    yield _inside(facts)


def format_otherwise(facts: Facts) -> str:
    """Return text with the probabilities of no gap and of a cause outside the catalogue, in percent.

    The probability of a cause outside the catalogue is stated only if the data raise it above its prior
    value, which is no finding.
    """
    none, outside = facts.no_gap or 0.0, facts.outside or 0.0
    said = "no sign of a cause outside the catalogue"
    if outside > MAX_NO_GAP_PROBABILITY:
        said = f"a cause outside the catalogue {probability_text(outside)}"
    return f"no gap {probability_text(none)}, {said}"


def _inside(facts: Facts) -> VerdictRow:
    """Return the row about held-out trials whose error noise does not explain."""
    off = {name: t for name, t in facts.held_out.items() if t.after > t.limit}
    ratios = [f"{name} has {format_number(t.after / t.expected, 2)} times" for name, t in off.items()]
    reason = f"{join_names(ratios)} the squared error that noise and uncertain parameters explain"
    found = join_names(list(off)) or "all within noise"
    return VerdictRow("held-out trials", found, "within noise", not off, "unexplained", False, reason)


def _of_causes(facts: Facts) -> Iterator[VerdictRow]:
    """Yield the rows of a model to which the fits add causes."""
    names = join_names(list(facts.proposed))
    name, first = next(iter(facts.proposed.items()))
    none, sure = facts.no_gap or 0.0, f"≥ {percent(MIN_SURE_PROBABILITY)}"
    found, needed = f"no gap {probability_text(none)}", f"≤ {percent(MAX_NO_GAP_PROBABILITY)}"
    reason = f"the probability that there is no gap is {probability_text(none)}"
    yield VerdictRow("gap", found, needed, none <= MAX_NO_GAP_PROBABILITY, "ambiguous", True, reason)
    share = _catalogue_share(facts)
    found = f"{probability_text(share)} of the probability of a gap"
    reason = f"a cause outside the catalogue has {percent(1.0 - share, 2)} of the probability of a gap"
    is_named = _is_supported(facts)
    otherwise: Verdict = "partial" if is_named else "unexplained"
    passed = share >= MIN_SURE_PROBABILITY
    yield VerdictRow("cause in the catalogue", found, sure, passed, otherwise, is_named, reason)
    rivals = join_names(first.equivalent, "or") or "other effects"
    reason = f"these trials cannot distinguish {name} from {rivals}"
    passed = first.alone >= MIN_SURE_PROBABILITY and not first.crowded
    found = f"{probability_text(first.alone)} of the probability of cause and rivals"
    yield VerdictRow("cause against its rivals", found, sure, passed, "ambiguous", True, reason)
    if facts.diverged:
        reason = f"a simulation of held-out data diverges with {names}"
        yield VerdictRow("held-out simulation", "diverges", "finite", False, "unexplained", False, reason)
    if facts.held_out:
        yield from _of_errors(facts, names)


def _catalogue_share(facts: Facts) -> float:
    """Return the probability of causes in the catalogue, divided by that of all causes."""
    inside, outside = facts.catalogue or 0.0, facts.outside or 0.0
    return inside / max(inside + outside, 1e-300)


def _is_supported(facts: Facts) -> bool:
    """Return whether causes are named although a cause outside the catalogue is probable.

    The causes must be more probable than that cause, close half of the gap, or be imitated by a refit.
    """
    share = _catalogue_share(facts)
    if share > 0.5:
        return True
    left = compute_remaining_share(facts, as_given=_is_change(facts))
    closes = left is not None and left <= 1.0 - MIN_CLOSED_SHARE
    # An effect with a separate value for each trial fits every held-out trial, too. An effect at its bound
    # compensates for a cause outside the catalogue.
    first, *_ = facts.proposed.values()
    if closes and not first.per_trial and not any(one.at_bound for one in facts.proposed.values()):
        return True
    _, before, after, _ = _sums(facts.held_out)
    return share > MAX_NO_GAP_PROBABILITY and after <= before and is_imitated(facts)


def _of_errors(facts: Facts, names: str) -> Iterator[VerdictRow]:
    """Yield the rows about the squared errors of held-out data without and with the causes.

    Every refit changes a changed parameter, too. Without this cause, the errors are therefore those of the
    parameters as given. The same errors are used for a cause that a refit imitates.
    """
    is_change = _is_change(facts)
    as_given = is_change or is_imitated(facts)
    if as_given and not is_change:
        reason = f"a refit of the parameters closes the gap on held-out data as well as {names}"
        question = "cause against the parameters"
        yield VerdictRow(question, "imitated", "distinct", False, "ambiguous", True, reason)
    yield _row_of_decrease(facts, names, as_given=as_given)
    yield _row_of_remainder(facts, names, as_given=as_given)
    worse = join_names([n for n, t in facts.held_out.items() if _is_worse(t, as_given)])
    verb = "makes" if len(facts.proposed) == 1 else "make"
    found, reason = worse or "none worse", f"{names} {verb} the error of {worse} larger"
    yield VerdictRow("held-out trials", found, "none worse", not worse, "ambiguous", True, reason)


def _row_of_decrease(facts: Facts, names: str, *, as_given: bool) -> VerdictRow:
    """Return the row about the probability that held-out errors fall with the causes."""
    falls = compute_decrease_probability(facts, as_given=as_given)
    found = f"probability {probability_text(falls)}"
    carried = "" if _is_change(facts) else find_carrying_part(facts)
    passed = falls >= MIN_DECREASE_PROBABILITY and not carried
    otherwise: Verdict = "unexplained"
    reason = f"held-out errors do not clearly fall with {names} ({found})"
    if carried:
        otherwise, reason = "ambiguous", f"the held-out errors fall with {names} only in {carried}"
    elif (facts.no_gap or 0.0) > MAX_NO_GAP_PROBABILITY:
        otherwise = "ambiguous"
    needed = f"probability ≥ {percent(MIN_DECREASE_PROBABILITY)}"
    return VerdictRow("held-out errors fall", found, needed, passed, otherwise, bool(carried), reason)


def _row_of_remainder(facts: Facts, names: str, *, as_given: bool) -> VerdictRow:
    """Return the row about the share of the squared gap on held-out data that the causes leave."""
    left, needed = compute_remaining_share(facts, as_given=as_given), f"≤ {percent(CALIBRATED.form)}"
    if left is None:
        text = "the remaining share of the gap is unknown, because held-out data have no gap"
        return VerdictRow("remaining gap", text, needed, False, "ambiguous", True, text)
    given, before, _, _ = _sums(facts.held_out)
    against = "as given" if as_given or given < before else "after a refit"
    text = f"{percent(left, 2)} of the squared gap"
    reason = f"{text} {against} remains on held-out data with {names}"
    return VerdictRow("remaining gap", text, needed, left <= CALIBRATED.form, "partial", True, reason)


def _is_change(facts: Facts) -> bool:
    """Return whether all proposed causes are changed parameters."""
    return all(name.startswith(PREFIX) for name in facts.proposed)


def _is_worse(t: HeldOutTrial, as_given: bool) -> bool:
    """Return whether the causes make both the squared error and the deviance of a held-out part larger."""
    before, gain = (t.as_given, t.gain_as_given) if as_given else (t.before, t.gain)
    return gain < 0.0 and t.after > max(t.limit, before)


def is_imitated(facts: Facts) -> bool:
    """Return whether a refit without causes predicts held-out data as well as the causes do."""
    left = compute_refit_share(facts)
    if left is None or left > CALIBRATED.form:
        return False
    falls, as_given = (compute_decrease_probability(facts, as_given=one) for one in (False, True))
    return falls < MIN_DECREASE_PROBABILITY <= as_given


def compute_decrease_probability(facts: Facts, *, as_given: bool = False) -> float:
    """Return the probability that the causes reduce the error of held-out data.

    The part whose deviance decreases most is left out, so that no part carries the decrease alone. The other
    parts get random weights (Bayesian bootstrap). The probability is at most one half if the deviances of
    these parts together decrease by less than :data:`swimid.fitting.rivals.STRONG`. The same limit applies to
    a single part, which does not show how much parts differ. The probability is zero if the sum of the
    deviances does not fall. It is also zero if the sum of the squared errors does not fall below that without
    the causes, or that of the parameters as given, unless noise explains the errors.

    Parameters
    ----------
    as_given : bool
        Whether the causes are compared with the parameters as given, and not with their refit.

    References
    ----------
    .. [1] D. B. Rubin, "The Bayesian bootstrap", Annals of Statistics 9(1), 1981.
    """
    lowered = _gains(facts, as_given)
    given, before, after, _ = _sums(facts.held_out)
    grows = not after < (given if as_given else min(given, before)) and any(
        t.after > t.limit for t in facts.held_out.values()
    )
    if grows or not lowered.sum() > 0.0:
        return 0.0
    rest = np.sort(lowered)[:-1]
    if not len(rest):
        return 0.5
    weights = np.random.default_rng(0).dirichlet(np.ones(len(rest)), N_PART_WEIGHTS)
    falls = float(np.mean(weights @ rest > 0.0))
    return falls if rest.sum() >= STRONG else min(falls, 0.5)


def _gains(facts: Facts, as_given: bool) -> np.ndarray:
    """Return the decrease of the deviance of each held-out part by the causes."""
    return np.array([t.gain_as_given if as_given else t.gain for t in facts.held_out.values()])


def find_carrying_part(facts: Facts) -> str:
    """Return the held-out part that alone carries the decrease of the error; empty if several carry it."""
    lowered = _gains(facts, False)
    left = compute_remaining_share(facts)
    if left is None or left > 1.0 - CALIBRATED.form or not lowered.sum() > 0.0:
        return ""
    if compute_decrease_probability(facts) >= MIN_DECREASE_PROBABILITY:
        return ""
    names, largest = list(facts.held_out), int(np.argmax(lowered))
    t = facts.held_out[names[largest]]
    alone = lowered[largest] > 0.5 * np.maximum(lowered, 0.0).sum()
    return names[largest] if alone and t.before > t.limit else ""


# ---------------------------------------------------------------- closed share


def _sums(trials: Mapping[str, HeldOutTrial]) -> tuple[float, float, float, float]:
    """Return the sums of the squared errors as given, refitted, with causes, and expected."""
    rows = [(t.as_given, t.before, t.after, t.expected) for t in trials.values()] or [(0.0,) * 4]
    given, before, after, expected = (sum(column) for column in zip(*rows, strict=True))
    return given, before, after, expected


def _share_left(before: float, after: float, expected: float) -> float | None:
    """Return the share of the excess of a squared error that is left; None without an excess.

    An excess within two standard deviations of chi-squared may be noise.
    """
    gap = before - expected
    return max(after - expected, 0.0) / gap if gap > math.sqrt(8.0 * expected) else None


def compute_remaining_share(facts: Facts, *, as_given: bool = False) -> float | None:
    """Return the share of the squared gap on held-out data that the causes leave; None without a gap.

    The gap is that which a refit without causes leaves. It is that of the parameters as given if this is
    smaller or ``as_given`` is set.
    """
    given, before, after, expected = _sums(facts.held_out)
    share = _share_left(given if as_given else min(given, before), after, expected)
    # If noise explains all errors with the causes, no gap remains.
    explained = share is not None and all(t.after <= t.limit for t in facts.held_out.values())
    return 0.0 if explained else share


def compute_refit_share(facts: Facts) -> float | None:
    """Return the share of the squared gap as given that a refit leaves; None without a gap."""
    given, before, _, expected = _sums(facts.held_out)
    return _share_left(given, before, expected)


def format_interval(s: Closed) -> str:
    """Return the 95 % interval of a closed share as text, for example ``(81 … 94 %)``.

    The limits of the interval have at most one decimal.
    """
    low, high = s.ci95
    if low is None or high is None:
        return ""
    if low >= 0.9995:
        return "(at least 99.9 %)"
    return f"({numbers.interval(100.0 * low, 100.0 * high, max(100.0 * (high - low), 1.0), '%')})"
