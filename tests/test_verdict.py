"""The verdict of a diagnosis follows from the facts in its gap file."""

from __future__ import annotations

from typing import Any

import pytest

from swimid.diagnosis.gap_file import HeldOutTrial, Proposed
from swimid.diagnosis.verdict import closed_share, decide, probability_of_decrease
from tests.gap_cases import facts


def gains(*each: float) -> dict[str, float]:
    """Decrease of the squared distance of each held-out part by the causes."""
    return {f"fold {k}": gain for k, gain in enumerate(each, 1)}


def held_out(*after: float, before: float = 500.0) -> dict[str, HeldOutTrial]:
    """Trials of 100 samples each, with a squared error before and after the causes."""
    return {
        str(k): HeldOutTrial(samples=100, as_given=before, before=before, after=value)
        for k, value in enumerate(after)
    }


@pytest.mark.parametrize(
    ("outside", "verdict"), [(0.1, "explained"), (0.3, "ambiguous"), (0.6, "unexplained")]
)
def test_an_explanation_is_more_probable_than_a_cause_from_outside(outside: float, verdict: str) -> None:
    assert decide(facts("waves", outside=outside)).verdict == verdict


@pytest.mark.parametrize(
    ("after", "verdict", "causes"),
    [
        ((110.0, 90.0, 105.0), "explained", ("waves",)),
        ((400.0, 390.0, 410.0), "ambiguous", ("waves",)),
        ((490.0, 520.0, 480.0), "unexplained", ()),
        ((600.0, 550.0, 700.0), "unexplained", ()),
    ],
)
def test_held_out_errors_weaken_a_verdict(after: Any, verdict: str, causes: tuple[str, ...]) -> None:
    held = held_out(*after)
    known = facts("waves", held_out=held, gains={k: t.before - t.after for k, t in held.items()})
    found = decide(known)
    assert (found.verdict, found.causes) == (verdict, causes)


@pytest.mark.parametrize(
    ("changed", "verdict", "causes"),
    [
        ({"left": 0.6}, "unexplained", ("waves",)),
        ({"left": 0.6, "proposed": {"waves": Proposed(closing=0.4, alone=0.9)}}, "unexplained", ()),
        ({"proposed": {"waves": Proposed(closing=0.9, alone=0.4)}}, "ambiguous", ("waves",)),
        ({"unpredicted": {"run01": 4.0}}, "ambiguous", ("waves",)),
        ({"diverged": True}, "unexplained", ()),
        ({"odd_trial": {"run01": 30.0}}, "unexplained", ()),
        ({"imitated": True}, "ambiguous", ("waves",)),
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


def test_trials_that_differ_more_than_by_chance_have_a_gap() -> None:
    assert decide(facts(no_gap=0.9, differing=["they vary in time-offset"])).verdict == "unexplained"
    assert decide(facts(no_gap=0.9, unpredicted={"run01": 4.0})).verdict == "unexplained"


def test_the_closed_share_is_that_of_the_squared_error_beyond_the_noise() -> None:
    """Without variation of the noise the interval is the share; two fitted trials do not show a variation."""
    known = facts("waves", held_out=held_out(200.0, 200.0, 200.0), noise={"a": 1.0, "b": 1.0, "c": 1.0})
    closed = closed_share(known)
    assert (closed.before, closed.after, closed.share) == (5.0, 2.0, pytest.approx(0.75))
    assert closed.ci95 == pytest.approx((0.75, 0.75))
    del known.noise["c"]
    assert closed_share(known).ci95 == (None, None)
    assert closed_share(facts("waves", held_out=held_out(90.0, before=100.0))).share is None


@pytest.mark.parametrize(
    "errors, as_given, refitted",
    [
        # The refit leaves a quarter of the squared gap, and the cause closes a third of that.
        ((1300.0, 400.0, 300.0), 10.0 / 12.0, 1.0 / 3.0),
        # The refit opens most of the gap that the cause closes.
        ((160.0, 400.0, 140.0), 1.0 / 3.0, 26.0 / 30.0),
    ],
)
def test_an_explained_gap_is_closed_from_the_model_as_given_and_from_its_refit(
    errors: tuple[float, float, float], as_given: float, refitted: float
) -> None:
    given, before, after = errors
    trials = {str(k): HeldOutTrial(samples=100, as_given=given, before=before, after=after) for k in range(3)}
    known = facts("waves", held_out=trials)
    assert closed_share(known).share == pytest.approx(as_given)
    assert closed_share(known, "before").share == pytest.approx(refitted)
    assert decide(known).verdict == "ambiguous"


def test_errors_that_grow_in_a_clear_gap_contradict_the_distances() -> None:
    """If held-out errors are little more than noise, the distances decide alone."""
    alike = gains(400.0, 390.0, 405.0)
    worse = facts("waves", held_out=held_out(560.0, 540.0, 590.0), gains=alike)
    assert probability_of_decrease(worse) == 0.0
    quiet = facts("waves", held_out=held_out(130.0, 140.0, 125.0, before=120.0), gains=alike)
    assert probability_of_decrease(quiet) == 1.0
    better = facts("waves", held_out=held_out(110.0, 90.0, 105.0), gains=gains(3.0, -4.0, -5.0))
    assert probability_of_decrease(better) == 1.0


@pytest.mark.parametrize("refitted, chance", [(120.0, 1.0), (119.0, 0.5)])
def test_a_small_gap_of_the_model_as_given_is_seen_in_its_errors(refitted: float, chance: float) -> None:
    """The other trials correct a changed parameter, so that the distances hardly fall."""
    trials = {
        str(k): HeldOutTrial(samples=100, as_given=120.0, before=refitted, after=after)
        for k, after in enumerate((105.0, 99.0, 110.0))
    }
    small = facts("parameter:c_d0", held_out=trials, gains=gains(5.0, -6.0, 1.0))
    assert probability_of_decrease(small) == pytest.approx(chance, abs=0.2)


def test_one_trial_that_gains_little_does_not_outweigh_two_that_lose() -> None:
    for each, low, high in (((400.0, 390.0, 405.0), 1.0, 1.0), ((20.0, -40.0, -60.0), 0.0, 0.2)):
        assert low <= probability_of_decrease(facts("waves", held_out={}, gains=gains(*each))) <= high
