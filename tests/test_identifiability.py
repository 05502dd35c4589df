"""Parameters that the trials determine alone, and those that they determine only in combination."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.fitting import output_error
from swimid.fitting import uncertainty as idn
from swimid.fitting.model import share
from swimid.fitting.output_error import FitResult
from tests.toy_models import FRICTION, FRICTION_TRUTH, WEIGHTS, Toy, friction, parameter, trials

TOTAL = float(np.dot(WEIGHTS, FRICTION_TRUTH[1:]))
FRICTIONS = ("c_f0", "c_f13", "c_f4")


def _fit(seed: int) -> FitResult:
    model = Toy(friction, FRICTION)
    return output_error.fit_output_error(
        model, trials(model, FRICTION_TRUTH, {"y": 0.05}, np.random.default_rng(seed))
    )


@pytest.fixture(scope="module")
def result() -> FitResult:
    return _fit(0)


class TestThreeFrictions:
    def test_a_parameter_at_its_bound_by_chance_stays_confounded(self, result: FitResult) -> None:
        assert result.value("c_f4") == 0.0
        assert idn.unidentifiable(result) == list(FRICTIONS)
        assert result.status["thrust"] == "estimated"

    def test_the_sum_is_named(self, result: FitResult) -> None:
        assert idn.find_confounded(result) == [FRICTIONS]
        (sum_,) = idn.combinations(result)
        assert sum_.members == FRICTIONS
        # differences of 1e-6 relative accuracy
        assert list(sum_.weights.values()) == pytest.approx(WEIGHTS, rel=1e-4)
        assert sum_.text.startswith("c_f0 + 0.31 c_f13 + 0.08 c_f4 = ")
        assert idn.sentences(result) == [
            f"c_f0, c_f13 and c_f4 cannot be separated by these trials, which determine only {sum_.text}"
        ]

    @pytest.mark.slow
    def test_the_error_of_the_sum_is_that_of_repeated_experiments(self) -> None:
        repeats = 100
        sums = [idn.combinations(_fit(seed))[0] for seed in range(repeats)]
        values = np.array([s.value for s in sums])
        stderr = np.median([s.stderr for s in sums])
        # errors are 1 / sqrt(2 n) for a sample deviation and 1 / sqrt(n) for a mean; four times each is
        # allowed
        assert np.std(values) == pytest.approx(stderr, rel=4 / np.sqrt(2 * repeats))
        assert np.mean(values) == pytest.approx(TOTAL, abs=4 * stderr / np.sqrt(repeats))

    def test_the_error_of_the_sum_is_that_of_a_shared_coefficient(self, result: FitResult) -> None:
        parameters = share(FRICTION, {"c_f": FRICTIONS})
        shared = output_error.fit_output_error(Toy(friction, FRICTION), result.trials, parameters=parameters)
        (sum_,) = idn.combinations(result)
        assert shared.status["c_f"] == "estimated"
        # the variance of the residuals is over 600 - 2 and over 600 - 4
        assert sum_.stderr == pytest.approx(shared.stderr("c_f") * sum(WEIGHTS), rel=2e-3)
        assert sum_.value == pytest.approx(shared.value("c_f") * sum(WEIGHTS), abs=1e-3 * sum_.stderr)


def _pairs(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    a, b, c, d, unseen = values
    return {"y": (a + 2 * b) * t + (c - 0.5 * d) * np.cos(4 * t) + 0.0 * unseen}


def test_a_member_that_happens_to_look_known_stays_in_its_group() -> None:
    """The estimate of a confounded parameter may be so large that half of it exceeds its standard error."""
    for seed in range(40):
        model = Toy(
            lambda v, t: {"y": v[0] * t + v[1] * (t + 0.1 * np.sin(t))},
            (parameter("a", 1.0, scale=0.1), parameter("b", 1.0, scale=0.1)),
        )
        rng = np.random.default_rng(seed)
        result = output_error.fit_output_error(model, trials(model, (0.3, 0.3), {"y": 0.5}, rng))
        vague = all(result.stderr(name) > idn.VAGUE * abs(result.value(name)) for name in ("a", "b"))
        if vague and sorted(result.status.values()) == ["estimated", "unidentifiable"]:
            assert idn.find_confounded(result) == [("a", "b")]
            (sum_,) = idn.combinations(result)
            assert sum_.stderr < 0.1 * result.stderr("a")
            return
    pytest.fail("no such seed")


class TestGroups:
    parameters = tuple(parameter(name, 1.0) for name in ("a", "b", "c", "d", "unseen"))

    def test_pairs_stay_separate_and_an_unseen_parameter_alone(self, rng: np.random.Generator) -> None:
        model = Toy(_pairs, self.parameters)
        result = output_error.fit_output_error(
            model, trials(model, (1.0, 2.0, 3.0, 1.0, 0.0), {"y": 0.1}, rng)
        )
        assert idn.unidentifiable(result) == ["a", "b", "c", "d", "unseen"]
        assert idn.find_confounded(result) == [("a", "b"), ("c", "d")]
        first, second = idn.combinations(result)
        ratio = first.weights["b"] / first.weights["a"]
        assert ratio == pytest.approx(2.0, rel=1e-4)
        assert second.weights["d"] / second.weights["c"] == pytest.approx(-0.5, rel=1e-4)
        assert abs(second.value / second.weights["c"] - 2.5) < 4 * second.stderr / abs(second.weights["c"])
        said = idn.sentences(result)
        assert len(said) == 3
        assert said[-1] == "unseen is not identifiable from these trials"
        assert result.stderr("unseen") is None

    def test_the_error_of_a_sum_includes_correlated_parameters(self, rng: np.random.Generator) -> None:
        """The error of a sum includes that of an identified parameter it is correlated with."""

        def formula(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
            a, b, offset = values
            return {"y": (a + 2 * b) * t + offset}

        model = Toy(formula, [parameter(n, 1.0) for n in ("a", "b", "offset")])
        result = output_error.fit_output_error(model, trials(model, (1.0, 2.0, 3.0), {"y": 0.1}, rng))
        (sum_,) = idn.combinations(result)
        t = np.concatenate([s.time_s for s in result.series])
        sd = result.noise["y"].value_sd
        expected = sd / np.sqrt(np.sum((t - t.mean()) ** 2)) / abs(sum_.weights["a"]) ** -1
        # two of 600 degrees of freedom in the size of the noise
        assert sum_.stderr == pytest.approx(expected, rel=1e-2)

    def test_no_sentences_if_all_parameters_are_identifiable(self, rng: np.random.Generator) -> None:
        model = Toy(lambda v, t: {"y": v[0] * t + v[1]}, [parameter("a", 1.0), parameter("b", 1.0)])
        result = output_error.fit_output_error(model, trials(model, (1.0, 2.0), {"y": 0.1}, rng))
        assert idn.sentences(result) == []
        assert idn.combinations(result) == []

    def test_without_the_information_matrix_only_the_status_counts(self, result: FitResult) -> None:
        bare = replace(result, information_root=np.empty((0, 0)))
        assert idn.combinations(bare) == []
        assert idn.sentences(bare) == [f"{name} is not identifiable from these trials" for name in FRICTIONS]

    def test_parameters_of_single_trials_are_accounted_for(self, rng: np.random.Generator) -> None:
        """A common offset that each trial's own offset can imitate has no share of its own."""

        def formula(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
            return {"y": values[0] * t + values[1] + values[2]}

        parameters = [
            parameter("slope", 1.0),
            parameter("offset", 1.0),
            parameter("own", 0.0, per_trial=True),
        ]
        model = Toy(formula, parameters)
        result = output_error.fit_output_error(model, trials(model, (1.0, 2.0, 0.0), {"y": 0.1}, rng))
        assert result.status["slope"] == "estimated"
        assert idn.find_confounded(result) == [("offset", "own[t0]", "own[t1]", "own[t2]")]


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [
        (0.012346, 0.00021, "0.01235 ± 0.00021"),
        (-2.5, 0.031, "−2.500 ± 0.031"),
        (187654.0, 910.0, "187650 ± 910"),
        (3.0, 0.0, "3"),
    ],
)
def test_values_are_written_to_two_digits_of_their_error(value: float, stderr: float, text: str) -> None:
    sum_ = idn.Combination({"a": 1.0, "b": -0.5}, ("a", "b"), value, stderr, "kg")
    assert sum_.text == f"a - 0.5 b = {text} kg"
