"""The verdict of a diagnosis follows from the facts in its gap file."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swimid.diagnosis.gap_file import Closed, Facts, HeldOutTrial, Proposed
from swimid.diagnosis.posterior import MAX_NO_GAP_PROBABILITY
from swimid.diagnosis.verdict import (
    MIN_SURE_PROBABILITY,
    compute_decrease_probability,
    compute_refit_share,
    compute_remaining_share,
    decide,
    format_interval,
    list_rows,
)
from tests.gap_cases import facts, held_out, replace


def parts(*gains: float, after: float = 100.0) -> dict[str, HeldOutTrial]:
    """Held-out parts that a cause predicts within noise, with given decreases of their squared errors."""
    return {f"part {k}": part(after + gain, after + gain, after) for k, gain in enumerate(gains)}


def part(as_given: float, before: float, after: float) -> HeldOutTrial:
    """A held-out part with given squared errors, whose deviance decreases as much as its squared error."""
    return HeldOutTrial(
        samples=100,
        as_given=as_given,
        before=before,
        after=after,
        expected=100.0,
        limit=150.0,
        gain=before - after,
        gain_as_given=as_given - after,
    )


def random_facts(rng: np.random.Generator) -> Facts:
    """Facts of a random diagnosis.

    The noise has a memory, so that a deviance decreases less than a squared error.
    """
    none, catalogue, outside = rng.dirichlet((0.3, 0.8, 0.3))
    proposed = {
        name: Proposed(alone=1.0 - rng.uniform() ** 2, crowded=bool(rng.uniform() < 0.1))
        for name in ("waves", "current")[: rng.integers(3)]
    }
    held = {}
    (model, trial, residual), independent = rng.uniform(0.0, 1.5, 3), rng.uniform(0.3, 1.0)
    size = model * rng.normal(size=3)
    for k in range(rng.integers(12)):
        noise = trial * rng.normal() + residual * rng.normal(size=3)
        given, before, after = 100.0 * np.exp(np.maximum(size + noise, 0.1 * rng.normal(size=3)))
        one = part(given, before, after)
        gains = {name: independent * getattr(one, name) for name in ("gain", "gain_as_given")}
        held[f"t{k}"] = replace(one, **gains)
    return Facts(no_gap=none, catalogue=catalogue, outside=outside, proposed=proposed, held_out=held)


@pytest.fixture
def many(rng: np.random.Generator) -> list[Facts]:
    """Facts of many random diagnoses."""
    return [random_facts(rng) for _ in range(3000)]


# ---------------------------------------------------------------- verdicts that contradict no fact


def test_no_gap_is_probable_and_predicts_held_out_trials(many: list[Facts]) -> None:
    found = [known for known in many if decide(known).verdict == "none"]
    assert len(found) > 20
    for known in found:
        assert known.no_gap is not None
        assert known.no_gap > 0.5
        assert all(t.after <= t.limit for t in known.held_out.values())


def test_a_named_cause_lowers_held_out_deviances(many: list[Facts]) -> None:
    """They fall on average over the parts, from those of a refit or from those of the model as given."""
    found = [known for known in many if known.held_out and decide(known).causes]
    assert len(found) > 200
    for known in found:
        gains = np.array([(t.gain, t.gain_as_given) for t in known.held_out.values()])
        assert gains.mean(axis=0).max() > 0.0


def test_a_named_cause_lowers_the_sum_of_squared_held_out_errors(many: list[Facts]) -> None:
    for known in (known for known in many if known.held_out and decide(known).causes):
        given, before, after = (
            sum(getattr(t, name) for t in known.held_out.values()) for name in ("as_given", "before", "after")
        )
        assert after < max(given, before)


def test_a_gap_is_explained_only_by_a_sure_cause_that_closes_it(many: list[Facts]) -> None:
    found = [known for known in many if known.held_out and decide(known).verdict == "explained"]
    assert len(found) >= 10
    for known in found:
        assert known.no_gap is not None
        assert known.no_gap <= MAX_NO_GAP_PROBABILITY
        assert next(iter(known.proposed.values())).alone >= MIN_SURE_PROBABILITY
        left = [compute_remaining_share(known, as_given=given) for given in (False, True)]
        assert min(share for share in left if share is not None) <= 0.3


def test_a_verdict_says_what_its_causes_say(many: list[Facts]) -> None:
    """A gap without a cause is not partly closed, and no cause is named without a gap."""
    for known in many:
        found = decide(known)
        if found.verdict in ("explained", "partial"):
            assert found.causes
        if found.verdict in ("none", "unexplained"):
            assert not found.causes


# ---------------------------------------------------------------- what each fact does


@pytest.mark.parametrize(("outside", "verdict"), [(0.1, "explained"), (0.3, "partial"), (0.6, "partial")])
def test_an_explanation_is_more_probable_than_a_cause_from_outside(outside: float, verdict: str) -> None:
    found = decide(facts("waves", outside=outside))
    assert (found.verdict, found.causes) == (verdict, ("waves",))


@pytest.mark.parametrize(("outside", "verdict"), [(0.3, "partial"), (0.6, "unexplained")])
def test_an_effect_with_values_in_each_trial_must_be_probable(outside: float, verdict: str) -> None:
    """It fits its values to the held-out trial, too, so that the error falls whatever the cause is."""
    known = facts("waves", outside=outside)
    known.proposed["waves"].per_trial = True
    assert decide(known).verdict == verdict


@pytest.mark.parametrize(
    ("after", "verdict", "causes"),
    [
        ((110.0, 90.0, 105.0), "explained", ("waves",)),
        ((300.0, 290.0, 310.0), "partial", ("waves",)),
        ((510.0, 520.0, 505.0), "unexplained", ()),
        ((600.0, 550.0, 700.0), "unexplained", ()),
    ],
)
def test_held_out_errors_weaken_a_verdict(after: Any, verdict: str, causes: tuple[str, ...]) -> None:
    found = decide(facts("waves", held_out=held_out(*after, before=500.0)))
    assert (found.verdict, found.causes) == (verdict, causes)


@pytest.mark.parametrize(
    ("changed", "verdict", "causes"),
    [
        ({"proposed": {"waves": Proposed(alone=0.4)}}, "ambiguous", ("waves",)),
        ({"proposed": {"waves": Proposed(alone=0.9, crowded=True)}}, "ambiguous", ("waves",)),
        ({"no_gap": 0.2}, "ambiguous", ("waves",)),
        ({"diverged": True}, "unexplained", ()),
        ({"unreproduced": {"u_m_s": 0.1}}, "unexplained", ()),
    ],
)
def test_each_fact_weakens_a_verdict(changed: Any, verdict: str, causes: tuple[str, ...]) -> None:
    found = decide(facts("waves", **changed))
    assert (found.verdict, found.causes) == (verdict, causes)


@pytest.mark.parametrize(
    ("no_gap", "failed", "verdict"),
    [(0.8, False, "none"), (0.8, True, "explained"), (0.2, False, "unexplained"), (0.2, True, "unexplained")],
)
def test_failed_samples_explain_only_if_nothing_else_is_missing(
    no_gap: float, failed: bool, verdict: str
) -> None:
    known = facts(no_gap=no_gap, outside=1.0 - no_gap, failed_samples=failed)
    assert decide(known).verdict == verdict


def test_a_held_out_trial_above_its_limit_has_a_gap() -> None:
    """It has one with a probable model without a gap, too."""
    known = facts(no_gap=0.9, held_out=held_out(100.0, 105.0, 171.0, before=100.0))
    assert decide(known).verdict == "unexplained"
    (row,) = (row for row in list_rows(known) if not row.passed)
    assert row.question == "held-out trials"
    assert "f10a30" in row.reason


def test_a_cause_that_makes_one_held_out_trial_worse_is_doubtful() -> None:
    held = held_out(110.0, 90.0, 105.0) | {"other": held_out(400.0, before=300.0)["f10a15"]}
    found = decide(facts("waves", held_out=held | parts(*[400.0] * 5)))
    assert (found.verdict, found.causes) == ("ambiguous", ("waves",))


@pytest.mark.parametrize(("cause", "verdict"), [("waves", "ambiguous"), ("parameter:c_d0", "explained")])
def test_a_cause_that_the_refit_imitates_is_told_by_the_parameters_as_given(cause: str, verdict: str) -> None:
    """A changed parameter is a refit, so that a refit does not contradict it."""
    held = held_out(104.0, 100.0, 102.0, before=103.0, as_given=900.0)
    found = decide(facts(cause, held_out=held))
    assert (found.verdict, found.causes) == (verdict, (cause,))


def test_a_changed_parameter_is_compared_with_the_parameters_as_given() -> None:
    """The refit leaves more than a third of the gap, and lowers some errors further than the change."""
    held = held_out(110.0, 200.0, 105.0, before=400.0, as_given=700.0)
    held["f14a20"] = held_out(180.0, before=120.0, as_given=700.0)["f10a15"]
    for cause, verdict in (("parameter:c_d0", "explained"), ("waves", "ambiguous")):
        assert decide(facts(cause, held_out=held)).verdict == verdict


def test_an_improbable_cause_that_a_refit_imitates_is_not_named() -> None:
    """The refit closes most of the gap as given, and the cause nothing of the rest."""
    held = held_out(256.0, 255.0, 257.0, before=256.0, as_given=900.0)
    found = decide(facts("waves", outside=0.99, held_out=held))
    assert (found.verdict, found.causes) == ("unexplained", ())
    worse = held_out(356.0, 355.0, 357.0, before=256.0, as_given=1900.0)
    found = decide(facts("waves", outside=0.75, held_out=worse))
    assert (found.verdict, found.causes) == ("unexplained", ())


@pytest.mark.parametrize(
    ("before", "left", "verdict", "causes"),
    [(260.0, 0.2, "ambiguous", ("waves",)), (380.0, 0.35, "unexplained", ())],
)
def test_a_refit_imitates_a_cause_only_if_it_closes_the_gap(
    before: float, left: float, verdict: str, causes: tuple[str, ...]
) -> None:
    """The cause closes no more than the refit, which leaves a share of the squared gap as given."""
    held = held_out(before + 2.0, before, before - 2.0, before=before, as_given=900.0)
    known = facts("waves", held_out=held)
    assert compute_refit_share(known) == pytest.approx(left)
    found = decide(known)
    assert (found.verdict, found.causes) == (verdict, causes)


def test_what_a_refit_imitates_closes_a_part_of_the_gap_beside_another_cause() -> None:
    """A cause outside the catalogue is likely, too."""
    held = held_out(104.0, 100.0, 102.0, before=103.0, as_given=900.0)
    found = decide(facts("parameter:c_d0", outside=0.6, held_out=held))
    assert (found.verdict, found.causes) == ("partial", ("parameter:c_d0",))


def test_a_changed_parameter_that_closes_the_gap_as_given_is_named_beside_a_form_error() -> None:
    """A real model leaves a small share of a large gap, which a refit leaves as well."""
    held = held_out(1900.0, 1700.0, 1800.0, before=1810.0, as_given=180000.0)
    found = decide(facts("parameter:c_d0", outside=0.97, held_out=held))
    assert (found.verdict, found.causes) == ("partial", ("parameter:c_d0",))
    assert decide(facts("waves", outside=0.97, held_out=held)).causes == ()


@pytest.mark.parametrize(("before", "verdict"), [(100.0, "ambiguous"), (900.0, "unexplained")])
def test_a_gap_that_may_not_be_there_leaves_nothing_unexplained(before: float, verdict: str) -> None:
    """A rig in which nothing is wrong, and one whose held-out errors are above their limits."""
    held = held_out(before + 1.0, before - 1.0, before, before=before)
    assert decide(facts("waves", no_gap=0.47, outside=0.39, held_out=held)).verdict == verdict


@pytest.mark.parametrize(("no_gap", "verdict"), [(0.05, "unexplained"), (0.3, "ambiguous")])
def test_without_a_cause_no_part_of_the_gap_is_closed(no_gap: float, verdict: str) -> None:
    """The held-out errors do not fall, and a cause outside the catalogue is less likely than the effect."""
    held = held_out(101.0, 99.0, 100.0, before=100.0)
    found = decide(facts("waves", no_gap=no_gap, outside=0.3, held_out=held))
    assert (found.verdict, found.causes) == (verdict, ())


def test_a_cause_that_adds_nothing_to_a_refit_is_not_named() -> None:
    """The refit leaves most of the gap of the model as given, and the cause closes nothing of that."""
    held = held_out(1710.0, 1700.0, 1720.0, before=1700.0, as_given=2500.0)
    assert decide(facts("waves", held_out=held)).causes == ()


def test_a_question_may_be_left_out() -> None:
    known = facts("waves", no_gap=0.2)
    assert decide(known).verdict == "ambiguous"
    assert decide(known, without="gap").verdict == "explained"


# ---------------------------------------------------------------- whether held-out errors fall


def test_a_cause_that_acts_at_some_settings_lowers_their_errors_only() -> None:
    """A drag of the head acts in the two trials that turn, and noise decides the sign of the others."""
    known = facts("waves", held_out=parts(133.0, -2.0, 5.0, -1.0, 228.0, 2.0))
    assert compute_decrease_probability(known) > 0.95


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_noise_alone_rarely_decreases_the_errors(count: int, rng: np.random.Generator) -> None:
    """Two parameters without meaning change a deviance by the difference of two chi-squared variables."""
    draws = rng.chisquare(2, (400, count)) - rng.chisquare(2, (400, count))
    passed = [
        compute_decrease_probability(facts("waves", held_out=parts(*d.tolist()))) >= 0.95 for d in draws
    ]
    assert np.mean(passed) < 0.05


def test_errors_above_those_of_the_parameters_as_given_do_not_fall() -> None:
    """The refit is worse than the parameters as given, and the cause closes a part of that only."""
    held = held_out(560.0, 540.0, 590.0, before=900.0, as_given=400.0)
    known = facts("waves", held_out=held)
    assert compute_decrease_probability(known) == 0.0
    assert decide(known).causes == ()


def test_one_part_shows_no_variation() -> None:
    known = facts("waves", held_out=parts(400.0))
    assert compute_decrease_probability(known) == 0.5
    assert decide(known).verdict != "explained"


# ---------------------------------------------------------------- closed share


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (0.999937, 1.0, "(at least 99.9 %)"),
        (0.9941, 1.0, "(99.4 … 100.0 %)"),
        (0.81, 0.94, "(81 … 94 %)"),
        (None, None, ""),
    ],
)
def test_the_interval_of_a_closed_share_has_at_most_one_decimal(
    low: float | None, high: float | None, text: str
) -> None:
    assert format_interval(Closed(before=9.0, after=1.0, share=0.9, ci95=(low, high))) == text
