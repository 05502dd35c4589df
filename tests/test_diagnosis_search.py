"""Search for causes: starting points, refits of hypotheses, and causes found among toy trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from swimid.diagnosis import answer, nominal, odd, search
from swimid.diagnosis.nominal import ParameterChange
from swimid.diagnosis.study import GapStudy
from swimid.effects.base import Inside
from swimid.files.atomic import Checkpoint
from swimid.fitting.model import Hooks, Model, Parameter, Trial
from swimid.results.parameters import Estimate
from tests.diagnosis_models import (
    PLAIN,
    Hooked,
    Seen,
    line_study,
    plain_study,
    plainly,
    ring,
    rise,
    seen_trials,
    trial,
    with_sd,
)
from tests.toy_models import Toy, parameter


@pytest.fixture
def study(rng: np.random.Generator) -> GapStudy:
    """Return a linear model with two coefficients, and five trials that each have a start value."""
    return line_study(rng)


def searched(
    trials: Sequence[Trial],
    effects: Sequence[Seen],
    own: Sequence[Parameter] = PLAIN,
    prior: tuple[float, float] = (1.0, 0.1),
    asked: list[str] | None = None,
) -> search.SearchResult:
    """Return the result of a search for the causes of the gap of a model that decays."""
    return search.search_causes(
        GapStudy(Hooked(plainly, own, ("y",)), own, trials, {"a": prior}), effects, asked=asked
    )


# ---------------------------------------------------------------- starting points


def test_a_base_in_a_poor_optimum_restarts_from_the_prior(rng: np.random.Generator) -> None:
    """The cost has an optimum in every turn; the lowest one is near the known frequency."""

    def turning(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": np.sin(values[0] * t) * np.exp(-0.05 * t)}

    known = (replace(parameter("rate", 1.0), known=1.0),)
    trials = [
        Trial(f"t{k}", "fit", t, {"y": turning(np.array([1.05]), t)["y"] + 0.05 * rng.normal(size=len(t))})
        for k, t in enumerate(np.linspace(0.0, 20.0 + k, 200) for k in range(4))
    ]
    study = with_sd(GapStudy(Toy(turning, known, ("y",)), known, trials, {"rate": (1.0, 0.5)}), 0.05)
    trapped = study.fit((), [np.array([2.5])])
    assert abs(trapped.value("rate") - 1.05) > 0.5
    based = search.HypothesisSearch(study, (), (), rng=rng).begin(trapped.theta)
    # five standard errors: a sample changes by about five of its units with the rate
    assert based.value("rate") == pytest.approx(1.05, abs=5 * 0.05 / np.sqrt(800) / 5)
    assert based.cost < trapped.cost


# ---------------------------------------------------------------- hypotheses


def test_a_smaller_set_is_refitted_from_the_optimum_of_a_larger_one(rng: np.random.Generator) -> None:
    """The first search ends in a side lobe of the tone; a larger set finds the main lobe."""

    class Tone(Seen):
        """Effect that adds a tone of unknown frequency."""

        def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
            """Return the size and the frequency."""
            return parameter("size", 0.0), parameter("frequency", 2.0)

        def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
            """Return the hook that adds the tone."""
            return Seen("", lambda t: np.sin(values[1] * t)).hooks(values[:1], trial, model)

    tone, slope = Tone("tone", ring), Seen("slope", rise)
    study = plain_study(seen_trials(rng, 0.0, 0.3), 0.02)
    own = {"tone/size": 0.05, "tone/frequency": 7.5}
    found = search.HypothesisSearch(study, [tone, slope], [], rng=rng)
    null = found.begin(np.array([1.0]))
    found.screen(null)
    caught = study.fit((tone,), [study.start((tone,), null, own)])
    own["tone/frequency"] = 2.1
    whole = study.fit((tone, slope), [study.start((tone, slope), null, own)])
    assert abs(caught.value("tone/frequency") - 2.0) > 1.0
    found.pool |= {h.key: h for h in (caught, whole)}
    assert found.refit_without(whole, slope).value("tone/frequency") == pytest.approx(2.0, abs=0.01)
    assert found.pool[caught.key].cost < caught.cost
    found.compare()
    assert found.base.names == {"tone"}


def test_an_effect_lowers_the_deviance_of_trials_in_which_it_acts(rng: np.random.Generator) -> None:
    study = plain_study(seen_trials(rng, 0.3, 0.0), 0.02)
    found = search.HypothesisSearch(study, [Seen("rise", rise), Seen("ring", ring)], [], rng=rng)
    null = found.begin(np.array([1.0]))
    found.add_effects([null])
    first, second = found.best(1)
    assert (first.names, second.names) == ({"rise"}, {"ring"})
    assert first.deviance < second.deviance
    # the model with the effect that acts leaves noise
    distance = first.deviance - first.log_determinant.sum()
    assert distance == pytest.approx(1200.0, abs=5.0 * np.sqrt(2400.0))
    assert found.compute_posterior().best == {"rise"}


def test_the_search_beside_an_interrupted_one_has_the_same_fits(rng: np.random.Generator) -> None:
    """The checkpoint keeps the fits of the first search."""
    study = plain_study(seen_trials(rng, 0.3, 0.2), 0.02)
    effects = [Seen("rise", rise), Seen("ring", ring)]
    kept = Checkpoint()
    results = []
    for _ in range(2):
        found = search.HypothesisSearch(study, effects, [], rng=rng, checkpoint=kept)
        found.add_effects([found.begin(np.array([1.0]))])
        results.append({h.names: h.deviance for h in found.pool.values()})
    assert results[0] == results[1]


# ---------------------------------------------------------------- causes


def test_nothing_is_found_in_trials_of_the_model_itself(rng: np.random.Generator) -> None:
    state = searched(seen_trials(rng, 0.0, 0.0), [Seen("rise", rise), Seen("ring", ring)])
    assert state.posterior.none > 0.5
    assert state.odd_trials == {}


def test_two_effects_are_found_beside_one_that_imitates_both(rng: np.random.Generator) -> None:
    """An effect like the sum of two others fits better than either, but worse than both together."""

    def both(t: np.ndarray) -> np.ndarray:
        return rise(t) + ring(t) + 0.4 * np.cos(5.0 * t)

    effects = [Seen("rise", rise), Seen("ring", ring), Seen("both", both)]
    state = searched(seen_trials(rng, 1.0, 1.4), effects)
    assert {e.name for e in state.base.effects} == {"rise", "ring"}
    assert state.posterior.sets[frozenset({"rise", "ring"})] > 0.5


def test_an_effect_asked_alone_and_among_all_has_the_same_fit(rng: np.random.Generator) -> None:
    """Further candidates do not change the fit of an effect."""
    trials = seen_trials(rng, 0.3, 0.0)
    effects = [Seen("rise", rise), Seen("ring", ring), Seen("wave", lambda t: np.cos(3.0 * t))]
    whole, alone = searched(trials, effects), searched(trials, effects, asked=["rise"])
    assert [e.name for e in whole.base.effects] == [e.name for e in alone.base.effects] == ["rise"]
    np.testing.assert_array_equal(whole.base.theta, alone.base.theta)
    assert whole.base.cost == alone.base.cost
    rows = {r.last_screening.effect.name: r for r in whole.singles}
    (own,) = alone.singles
    np.testing.assert_array_equal(own.gains, rows["rise"].gains)


class Bounded(Seen):
    """Effect that counts only while its size is below 0.5."""

    inside: ClassVar[Inside] = {"size": "upper"}

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the size of the curve, with bounds."""
        return (replace(parameter("size", 0.0), lower=-0.5, upper=0.5, scale=0.05),)


@pytest.mark.parametrize(("size", "told"), [(0.3, ["rise"]), (-0.7, ["rise"]), (0.7, [])])
def test_an_effect_that_ends_at_an_imitating_bound_is_no_hypothesis(
    rng: np.random.Generator, size: float, told: list[str]
) -> None:
    effects = [Bounded("rise", rise), Seen("wave", lambda t: np.cos(9.0 * t))]
    state = searched(seen_trials(rng, size, 0.0), effects)
    assert [e.name for e in state.base.effects if e.name == "rise"] == told
    assert any(r.last_screening.effect.name == "rise" for r in state.singles) == bool(told)
    assert told or state.posterior.outside > 0.5


@pytest.mark.parametrize(
    ("given", "rising", "causes"),
    [(1.0, 0.0, []), (0.8, 0.0, ["parameter:a"]), (0.8, 0.3, ["parameter:a", "slope"])],
)
def test_a_parameter_that_changed_is_a_cause_alone_and_beside_an_effect(
    given: float, rising: float, causes: list[str], rng: np.random.Generator
) -> None:
    """The true value is 1. The parameter file has a standard error of 0.005."""
    own = (parameter("a", given),)
    effects = [ParameterChange(own[0]), Seen("slope", rise), Seen("ring", ring)]
    state = searched(seen_trials(rng, rising, 0.0), effects, own, (given, 0.005))
    told = [r.name for r in state.comparisons] if state.posterior.none < 0.1 else []
    assert told == causes
    if causes:
        now = state.base.value("a") + state.base.value("parameter:a/change")
        stderr = answer.compute_stderr(state.study, state.base)
        assert now == pytest.approx(1.0, abs=4 * stderr["parameter:a"])
        # the trials alone determine the new value, the file determines the old one
        assert stderr["parameter:a"] < 0.7 * stderr["parameter:a/change"]


def test_a_change_stays_within_the_bounds_of_its_parameter() -> None:
    own = (parameter("a", 0.5, lower=0.0, upper=1.0),)
    model = Toy(plainly, own).with_effects([ParameterChange(own[0])], [])
    trial = Trial("start", "fit", np.zeros(1), {})
    assert model.run(np.array([0.6, 0.2]), trial)["y"][0] == pytest.approx(0.8)
    assert model.run(np.array([0.6, 0.5]), trial)["y"][0] == 1.0
    assert model.parameters[1].bounds == (-0.5, 0.5)


@pytest.mark.parametrize(("value", "status"), [(0.995, "at-bound"), (0.9, "estimated"), (0.005, "estimated")])
def test_a_size_within_its_error_of_a_bound_is_at_the_bound(value: float, status: str) -> None:
    """A bound at which the effect vanishes does not count."""
    tried = SimpleNamespace(
        effect=SimpleNamespace(name="slip", adds_to=None),
        parameters=(parameter("loss", 0.0, lower=0.0, upper=1.0),),
    )
    base = SimpleNamespace(labels=["slip/loss"], value=lambda label: value)
    found = answer.estimate_sizes(base, tried, {"slip/loss": 0.01}, {})["loss"]  # type: ignore[arg-type]
    assert (found.status, found.stderr) == (status, 0.01 if status == "estimated" else None)


# ---------------------------------------------------------------- odd trials


def odd_one(rng: np.random.Generator, values: Sequence[float], rising: Sequence[float]) -> list[Trial]:
    """Return trials that decay from given values, and rise by given sizes."""
    t = np.linspace(0.0, 5.0, 200)
    return [
        trial(k, t, a * np.exp(-t) + size * rise(t) + 0.02 * rng.normal(size=200))
        for k, (a, size) in enumerate(zip(values, rising, strict=True))
    ]


@pytest.mark.parametrize("place", [0, 4])
def test_an_odd_trial_is_found_and_left_out(place: int, rng: np.random.Generator) -> None:
    values = [1.0] * 7
    values[place] = 1.5
    state = searched(odd_one(rng, values, [0.0] * 7), [Seen("rise", rise), Seen("ring", ring)])
    assert list(state.odd_trials) == [f"t{place}"]
    name, value, rest = state.odd_trials[f"t{place}"].split(maxsplit=2)
    assert (name, float(value)) == ("a", pytest.approx(1.5, abs=0.02))
    assert "in place of 1" in rest
    assert [t.id for t in state.study.trials] == [f"t{k}" for k in range(7) if k != place]
    assert state.posterior.none > 0.5
    assert state.base.value("a") == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("other", [2.2, 3.0, 4.0])
def test_an_odd_trial_does_not_hide_an_effect(other: float, rng: np.random.Generator) -> None:
    values = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, other]
    state = searched(odd_one(rng, values, [0.3] * 7), [Seen("rise", rise), Seen("ring", ring)])
    assert list(state.odd_trials) == ["t6"]
    assert [e.name for e in state.base.effects] == ["rise"]


def test_a_trial_that_no_parameters_explain_is_not_left_out(rng: np.random.Generator) -> None:
    """It has a curve of its own, which no value of the parameter and no effect describes."""
    trials = odd_one(rng, [1.0] * 7, [0.0] * 7)
    trials[3].measured["y"] += 0.5 * np.cos(9.0 * trials[3].time_s)
    state = searched(trials, [Seen("rise", rise), Seen("ring", ring)])
    assert state.odd_trials == {}
    assert len(state.study.trials) == 7
    assert odd.describe(odd.OddTrial("t3", state.null)) is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("rising", [0.0, 0.3])
def test_clean_trials_have_no_odd_trial(seed: int, rising: float) -> None:
    rng = np.random.default_rng(seed)
    state = searched(odd_one(rng, [1.0] * 7, [rising] * 7), [Seen("rise", rise), Seen("ring", ring)])
    assert state.odd_trials == {}


def test_an_effect_that_grows_with_the_setting_is_no_odd_trial(rng: np.random.Generator) -> None:
    """The effect is largest in the last trial."""

    class Forced(Seen):
        """Effect in proportion to the square of the force."""

        def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
            """Return the hook that adds the curve."""
            return super().hooks(values * trial.rig.force**2, trial, model)

    sizes = [0.02 * (1.0 + k) ** 2 for k in range(7)]
    state = searched(odd_one(rng, [1.0] * 7, sizes), [Forced("drag", rise), Seen("ring", ring)])
    assert state.odd_trials == {}
    assert [e.name for e in state.base.effects] == ["drag"]


def test_three_trials_have_no_odd_one(rng: np.random.Generator) -> None:
    """None of them is in a majority."""
    state = searched(odd_one(rng, [1.0, 1.0, 1.6], [0.0] * 3), [Seen("rise", rise)])
    assert state.odd_trials == {}


def test_the_prior_is_wide_at_a_bound_of_a_fit_to_the_same_trials() -> None:
    """A fit in which a cause is missing moves coefficients to their bounds. Other trials say more."""
    p = parameter("c", 0.0, scale=2.0)
    at_bound, estimated = (Estimate(value=0.0, unit="1", status=s) for s in ("at-bound", "estimated"))
    sd = {
        (e.status, own): nominal.select_priors([p], {"c": e}, own_data=own)["c"][1]
        for e in (at_bound, estimated)
        for own in (True, False)
    }
    assert sd["at-bound", True] == pytest.approx(10.0 * sd["at-bound", False])
    assert sd["estimated", True] == sd["estimated", False] == sd["at-bound", False]
