"""Posterior probabilities of sets of causes, of no gap, and of a cause outside the catalogue."""

from __future__ import annotations

import numpy as np
import pytest

from swimid.diagnosis.posterior import (
    Candidate,
    DataSize,
    Posterior,
    PosteriorConstants,
    compute_posterior_probabilities,
    compute_tolerance,
)


def candidate(
    names: str, deviance: float, *, parts: int = 5, alike: float = 0.0, strain: float = 0.0
) -> Candidate:
    """Return the hypothesis of effects of one letter each, whose deviance all folds share equally."""
    return Candidate(
        names=frozenset(names),
        deviances=np.full(parts, deviance / parts),
        strain=strain,
        numbers=len(names),
        alike=dict.fromkeys(names, alike) if len(names) > 1 else {},
    )


def compared(null: float, *others: tuple[str, float], samples: float = 1000.0) -> Posterior:
    """Return the probabilities of hypotheses with given deviances."""
    found = [candidate(names, deviance) for names, deviance in others]
    return compute_posterior_probabilities(candidate("", null), found, record=DataSize(samples, 8, 20))


def test_probabilities_sum_to_one() -> None:
    found = compared(5000.0, ("a", 1010.0), ("b", 2000.0), ("ab", 1000.0))
    assert sum(found.sets.values()) + found.none + found.outside == pytest.approx(1.0)
    assert sum(found.beside.values()) == pytest.approx(found.outside)
    assert sum(found.probabilities.values()) <= 1.0 + 1e-9


def test_the_excess_that_refutes_nothing_is_the_sum_of_its_parts() -> None:
    """Directions of each part, one percent and two deviations of the noise, and a share of the gap."""
    known = PosteriorConstants(7.0, 0.2, -2.0)
    record = DataSize(samples=2000.0, parts=6, effects=20)
    noise = 7.0 * 6 + 20.0 + 2.0 * np.sqrt(2.0 * 2000.0)
    assert compute_tolerance(record, 500.0, known) == pytest.approx(noise + 0.2 * 500.0)
    assert compute_tolerance(record, -500.0, known) == pytest.approx(noise)


def test_trials_of_noise_have_no_gap() -> None:
    found = compared(1000.0, ("a", 1000.0), ("b", 1001.0), ("ab", 1000.0))
    assert found.none > 0.9


def test_an_effect_that_leaves_several_times_more_is_no_rival() -> None:
    found = compared(20000.0, ("a", 1000.0), ("b", 1900.0), ("c", 1000.0))
    assert found.instead("a", frozenset("a"))["b"] < 0.01
    assert found.sets[frozenset("a")] == pytest.approx(found.sets[frozenset("c")])


def test_causes_that_leave_a_similar_share_are_uncertain() -> None:
    found = compared(20000.0, ("a", 9000.0), ("b", 9500.0))
    assert found.instead("a", frozenset("a"))["b"] > 0.1
    assert found.outside > 0.5


def test_a_gap_that_no_effect_closes_has_another_cause() -> None:
    found = compared(5000.0, ("a", 4900.0), ("b", 4950.0))
    assert found.outside > 0.9
    assert found.none < 0.1


def test_a_second_cause_must_be_probable() -> None:
    assert compared(20000.0, ("a", 1400.0), ("ab", 1250.0)).best == frozenset("a")
    assert compared(20000.0, ("a", 3000.0), ("ab", 1000.0)).best == frozenset("ab")


@pytest.mark.parametrize("alike, left, named", [(0.0, 0.0, "ab"), (0.95, 0.0, "a"), (0.0, 300.0, "a")])
def test_a_second_cause_is_no_error_of_form_of_the_first(alike: float, left: float, named: str) -> None:
    """The second effect must close nearly all of the rest, and change the trials in another way."""
    null, *found = (
        candidate("", 101e3),
        candidate("a", 1900.0),
        candidate("b", 95e3),
        candidate("ab", 1000.0 + left, alike=alike),
    )
    best = compute_posterior_probabilities(
        null, found, record=DataSize(1000.0, 5, 20), calibration=PosteriorConstants(8.7, 0.16, -2.5)
    ).best
    assert best == frozenset(named)


def test_a_gain_in_one_fold_is_uncertain() -> None:
    """The sums of the gains are equal."""
    null, even = candidate("", 1300.0, parts=6), candidate("a", 1000.0, parts=6)
    deviances = np.full(6, 1300.0 / 6) - np.array([900.0, *[-120.0] * 5])
    lone = Candidate(names=frozenset("a"), deviances=deviances, numbers=1)
    sure, unsure = (
        compute_posterior_probabilities(null, [c], record=DataSize(1000.0, 6, 20)).none for c in (even, lone)
    )
    assert unsure > 2.0 * sure


def test_a_gain_of_less_than_a_parameter_costs_is_none() -> None:
    """The deviance of noise falls by 1 for each parameter that is fitted to it."""
    found = compared(1000.0, *((name, 998.0) for name in "abcdefgh"))
    assert found.none > 0.9


def test_parameters_far_from_their_priors_are_improbable() -> None:
    """The trials are described as well without an effect, at values that the file excludes."""
    null, other = candidate("", 1000.0, strain=400.0), candidate("a", 1000.0)
    found = compute_posterior_probabilities(null, [other], record=DataSize(1000.0, 5, 20))
    assert found.sets[frozenset("a")] > found.none
    assert (
        compute_posterior_probabilities(candidate("", 1000.0), [other], record=DataSize(1000.0, 5, 20)).none
        > 0.9
    )


def test_twins_share_one_prior_probability() -> None:
    """A hypothesis that is listed twice under two names is as probable as the hypothesis alone."""
    once = compared(1500.0, ("d", 1010.0), ("w", 1040.0))
    twice = compared(1500.0, ("d", 1010.0), ("v", 1010.0), ("w", 1040.0))
    assert twice.none == pytest.approx(once.none)
    assert twice.compute_probability("w") == pytest.approx(once.compute_probability("w"))
    assert twice.compute_probability("d", "v") == pytest.approx(once.compute_probability("d"))


def test_an_effect_may_act_beside_a_cause_outside_the_catalogue() -> None:
    lag, slip = frozenset({"servo-lag"}), frozenset({"slip"})
    found = Posterior(
        sets={lag: 0.7, slip: 0.1},
        none=0.1,
        outside=0.1,
        beside={frozenset(): 0.02, lag: 0.06, slip: 0.02},
        excess={frozenset(): 1.0},
        candidates=(),
    )
    assert found.compute_probability("servo-lag") == pytest.approx(0.76)
    assert found.compute_probability("servo-lag", "slip") == pytest.approx(0.88)
    assert found.best == lag
