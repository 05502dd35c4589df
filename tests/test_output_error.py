"""The output-error fit: threads, interruption, weights, robust loss, bounds, broken simulations."""

from __future__ import annotations

import itertools
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from scipy import optimize

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.fit_common import is_still
from swimid.fitting.model import Trial
from swimid.fitting.problem import Blocks, Box, Problem, minimise
from swimid.fitting.uncertainty import sandwich
from swimid.notices import Step
from tests.toy_models import DECAY, TRUTH, Toy, decay, parameter, trials

BOTH = {"y": 0.02, "v": 0.05}


def slow() -> None:
    time.sleep(1e-3)


def blocks_of(*parts: np.ndarray) -> Blocks:
    """Return the derivatives of each trial as blocks without their zero columns."""
    ends = np.cumsum([0, *map(len, parts)]).tolist()
    columns = [np.flatnonzero(part.any(axis=0)) for part in parts]
    rows = [slice(begin, end) for begin, end in itertools.pairwise(ends)]
    blocks = [(row, at, part[:, at]) for row, at, part in zip(rows, columns, parts, strict=True)]
    return Blocks((ends[-1], parts[0].shape[1]), blocks)


def unbounded(count: int) -> Box:
    return Box(np.full(count, -np.inf), np.full(count, np.inf), np.ones(count))


class TestMinimise:
    @pytest.mark.parametrize("secant", [False, True])
    @pytest.mark.parametrize("seed", range(8))
    def test_the_optimum_is_that_of_scipy(self, seed: int, secant: bool) -> None:
        """Secant updates save derivatives."""
        rng = np.random.default_rng(seed)
        t = np.linspace(0, 4, 60)
        y = 2.0 * np.exp(-0.7 * t) + 0.5 + rng.normal(0, 0.05, 60)

        def residuals(p: np.ndarray) -> np.ndarray:
            return p[0] * np.exp(-p[1] * t) + p[2] - y

        def jacobian(p: np.ndarray) -> np.ndarray:
            return np.column_stack((np.exp(-p[1] * t), -p[0] * t * np.exp(-p[1] * t), np.ones(60)))

        # in half of the cases the optimum of the last parameter lies outside its bound
        upper = np.array([10.0, 10.0, 0.3 if seed % 2 else 5.0])
        start = rng.uniform([0.1, 0.1, 0.0], [5.0, 3.0, 0.3])
        taken = [0]

        def counted(p: np.ndarray) -> Blocks:
            taken[0] += 1
            return blocks_of(jacobian(p))

        ours = minimise(residuals, counted, start, Box(np.zeros(3), upper, np.ones(3)), secant=secant)
        if secant:
            assert taken[0] < ours.iterations
        scipys = optimize.least_squares(
            residuals, start, jac=jacobian, bounds=(np.zeros(3), upper), xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        assert ours.success
        assert ours.cost <= 2 * scipys.cost * (1 + 1e-9)
        assert ours.x == pytest.approx(scipys.x, abs=1e-5)

    def test_a_search_without_a_minimum_is_no_success(self) -> None:
        never = minimise(
            lambda p: np.array([np.exp(-p[0])]),
            lambda p: blocks_of(np.array([[-np.exp(-p[0])]])),
            np.array([0.0]),
            unbounded(1),
            max_iterations=5,
        )
        assert not never.success

    def test_a_prior_determines_what_the_data_leave_open_beside_a_large_misfit(
        self, rng: np.random.Generator
    ) -> None:
        """The data determine force over mass only. The prior counts less than the tolerance of the cost."""
        seen = 12500.0 * np.linspace(0.0, 2.0, 2000) ** 2
        measured = 9.4 * seen + 30.0 * rng.normal(size=2000)

        def residuals(p: np.ndarray) -> np.ndarray:
            return np.append(seen * p[0] / p[1] - measured, (p[0] - 0.408) / 0.004)

        def derivatives(p: np.ndarray) -> Blocks:
            data = np.column_stack((seen / p[1], -seen * p[0] / p[1] ** 2))
            return blocks_of(data, np.array([[1.0 / 0.004, 0.0]]))

        box = Box(np.array([0.05, 0.007]), np.array([2.0, 0.237]), np.array([0.4, 0.0037]))
        start = np.array([0.41, 0.037])
        found = minimise(residuals, derivatives, start, box, tolerance=1e-3, secant=True, undamped=True)
        assert found.x == pytest.approx([0.408, 0.408 / 9.4], rel=5e-4)

    def test_a_search_does_not_end_where_bounds_bend_the_undamped_step(self) -> None:
        """A column is nearly the sum of two others, beside a misfit that hides what a damped step gains."""
        rng = np.random.default_rng(209)
        columns = rng.normal(size=(30, 3))
        columns[:, 2] = (
            columns[:, 0] * rng.normal() + columns[:, 1] * rng.normal() + 1e-3 * rng.normal(size=30)
        )
        rows = np.vstack((100.0 * columns, np.zeros((300, 3))))
        measured = np.r_[rows[:30] @ rng.normal(1, 2, size=3), np.full(300, 2.0)]
        box = Box(np.zeros(3), np.full(3, 3.0), np.ones(3))
        found = minimise(
            lambda p: rows @ p - measured,
            lambda p: blocks_of(rows),
            np.ones(3),
            box,
            tolerance=1e-3,
            undamped=True,
        )
        best = optimize.lsq_linear(rows, measured, (box.lower, box.upper), tol=1e-12)
        assert found.cost == pytest.approx(2.0 * best.cost, abs=0.5)


class TestThreads:
    def test_the_result_does_not_depend_on_threads(self, rng: np.random.Generator) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        results = []
        for jobs in (1, 3):
            model = Toy(decay, DECAY, ("y", "v"), before=slow)
            results.append(output_error.fit_output_error(model, data, jobs=jobs))
            assert (len(model.threads) > 1) is (jobs > 1)
        one, three = results
        assert np.array_equal(one.estimate, three.estimate)
        assert np.array_equal(one.covariance, three.covariance)
        assert one.evaluations == three.evaluations
        assert one.cost == three.cost


class Interrupting:
    """Raises SIGINT at the given simulations."""

    def __init__(self, *at: int) -> None:
        self.at = at
        self.count = 0

    def __call__(self) -> None:
        self.count += 1
        if self.count in self.at:
            signal.raise_signal(signal.SIGINT)
            slow()


class TestInterrupt:
    @pytest.mark.parametrize("jobs", [1, 2])
    @pytest.mark.parametrize("at", [10, 17, 30, 41])
    def test_the_best_so_far_is_kept(self, rng: np.random.Generator, jobs: int, at: int) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        before = Interrupting(at)

        def pause() -> None:
            slow()
            before()

        model = Toy(decay, DECAY, ("y", "v"), before=pause)
        result = output_error.fit_output_error(model, data, jobs=jobs)
        assert result.interrupted
        assert not result.converged
        assert result.message.startswith("interrupted")
        assert np.isfinite(result.covariance).all()
        # the same weights at both points
        problem = Problem(Toy(decay, DECAY, ("y", "v")), DECAY, data)
        for k, trial in enumerate(problem.trials):
            problem.sd[k] = [
                next(s.sd for s in result.series if (s.trial, s.channel) == (trial.id, c))
                for c in problem.channels[k]
            ]
        first, last = (float(np.sum(problem.residuals(x) ** 2)) for x in (problem.start, result.estimate))
        assert last < first or np.array_equal(result.estimate, problem.start)

    def test_a_second_interrupt_is_raised(self, rng: np.random.Generator) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        model = Toy(decay, DECAY, ("y", "v"), before=Interrupting(17, 18))
        with pytest.raises(KeyboardInterrupt):
            output_error.fit_output_error(model, data, jobs=1)

    def test_an_interrupt_before_the_first_simulation_is_raised(self, rng: np.random.Generator) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        with pytest.raises(KeyboardInterrupt):
            output_error.fit_output_error(Toy(decay, DECAY, ("y", "v"), before=Interrupting(2)), data, jobs=1)

    def test_progress_shows_the_cost(self, rng: np.random.Generator) -> None:
        said: list[str] = []

        class Bar:
            def __call__(self, amount: int = 1) -> None:
                pass

            def note(self, text: str) -> None:
                said.append(text)

        @contextmanager
        def progress(description: str, total: int | None = None) -> Iterator[Step]:
            yield Bar()

        model = Toy(decay, DECAY, ("y", "v"))
        output_error.fit_output_error(model, trials(model, TRUTH, BOTH, rng), progress=progress)
        assert said[0].startswith("iteration 0, cost ")
        assert len(said) > 3


class TestWeights:
    @pytest.mark.parametrize("sd", [{"y": 1e-5, "v": 0.3}, {"y": 0.2, "v": 1e-5}])
    def test_weights_converge_from_a_bad_start(self, rng: np.random.Generator, sd: dict[str, float]) -> None:
        """Compare with maximum likelihood under known noise."""
        model = Toy(decay, DECAY, ("y", "v"))
        data = trials(model, TRUTH, sd, rng)
        result = output_error.fit_output_error(model, data)

        def residuals(x: np.ndarray) -> np.ndarray:
            return np.concatenate(
                [(t.measured[c] - decay(x, t.time_s)[c]) / s for t in data for c, s in sd.items()]
            )

        known = optimize.least_squares(residuals, TRUTH, x_scale="jac", xtol=1e-14, ftol=1e-14)
        # the error of a weight is 1 / sqrt(2 x 600), 3 %; it moves the estimate by that share of the
        # difference between the channels, which is at most a standard error of the noisier one
        stderr = np.sqrt(np.diag(np.linalg.inv(known.jac.T @ known.jac)))
        assert np.all(np.abs(result.estimate - known.x) < 0.1 * stderr)
        for channel, size in sd.items():
            assert result.noise[channel].value_sd == pytest.approx(size, rel=4 / np.sqrt(2 * 600))
        # 20 Jacobians of three columns, and a simulation for each
        assert result.evaluations <= 20 * (1 + len(TRUTH)) * len(data)


def line(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    return {"y": values[0] * t + values[1] * np.sqrt(t)}


class TestBounds:
    def _fit(
        self, truth: tuple[float, float], rng: np.random.Generator, lower: float = 0.0
    ) -> output_error.FitResult:
        model = Toy(line, (parameter("slope", 1.0), parameter("root", 1.0, lower, 5.0)))
        return output_error.fit_output_error(model, trials(model, truth, {"y": 0.1}, rng))

    def test_a_bound_holds_an_estimate(self, rng: np.random.Generator) -> None:
        result = self._fit((2.0, -1.0), rng)
        assert result.status["root"] == "at-bound"
        assert result.stderr("root") is None
        t = np.concatenate([s.time_s for s in result.series])
        alone = np.std(np.concatenate([s.residual for s in result.series])) / np.linalg.norm(t)
        assert result.stderr("slope") >= alone * 0.99

    def test_a_bound_reached_by_noise_makes_no_other_parameter_better_known(self) -> None:
        """Its standard error is that under a wider bound."""
        landed = 0
        for seed in range(6):
            held = self._fit((2.0, 0.0), np.random.default_rng(seed))
            wide = self._fit((2.0, 0.0), np.random.default_rng(seed), lower=-5.0)
            assert held.status["slope"] == "estimated"
            assert held.stderr("slope") == pytest.approx(wide.stderr("slope"), rel=0.02)
            if held.value("root") == 0.0:
                landed += 1
                assert held.status["root"] == "at-bound"
        # each seed ends at the bound with probability one half
        assert landed > 0


class TestNearlyNull:
    @pytest.mark.parametrize("apart", [1e-2, 1e-4, 1e-6, 1e-7])
    def test_the_standard_error_grows_with_confounding(self, rng: np.random.Generator, apart: float) -> None:
        """With columns a and a + eps b, a and b orthonormal, the errors are sqrt(1 + 1/eps^2) and 1/eps."""
        samples = 400
        a, b = np.linalg.qr(rng.normal(size=(samples, 2)))[0].T
        trial = Trial("t", "fit", np.arange(samples), {"y": np.zeros(samples)})
        model = Toy(line, (parameter("slope", 1.0), parameter("root", 1.0)))
        problem = Problem(model, model.parameters, [trial])
        r = rng.normal(size=samples)
        found = sandwich(problem, blocks_of(np.column_stack((a, a + apart * b))), [r], {"y": np.empty(0)})
        sd = np.sqrt(np.diag(found.covariance) / (r @ r / (samples - 2)))
        # rounding of the columns, 1e-16 over eps
        assert sd == pytest.approx([np.hypot(1, 1 / apart), 1 / apart], rel=1e-6 + 1e-15 / apart)
        assert not found.null.any()


class TestBroken:
    def _model(self, limit: float, how: Callable[[], float]) -> Toy:
        def formula(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
            found = decay(values, t)
            return {c: y * how() for c, y in found.items()} if values[2] > limit else found

        return Toy(formula, DECAY, ("y", "v"))

    def fail(self) -> float:
        raise ZeroDivisionError

    @pytest.mark.parametrize("how", ["nan", "error"])
    def test_a_start_that_cannot_be_simulated_is_refused(self, rng: np.random.Generator, how: str) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        model = self._model(2.2, self.fail if how == "error" else lambda: np.nan)
        with pytest.raises(NoTrustworthyResult, match=r"diverges.*t0, t1, t2"):
            output_error.fit_output_error(model, data)

    @pytest.mark.parametrize("how", ["nan", "error"])
    def test_a_step_that_cannot_be_simulated_costs(self, rng: np.random.Generator, how: str) -> None:
        data = trials(Toy(decay, DECAY), TRUTH, BOTH, rng)
        model = self._model(2.05, self.fail if how == "error" else lambda: np.nan)
        result = output_error.fit_output_error(model, data, begin=np.array([1.5, 0.1, 1.8]))
        whole = output_error.fit_output_error(Toy(decay, DECAY, ("y", "v")), data)
        stderr = np.sqrt(np.diag(whole.covariance))
        assert np.all(np.abs(result.estimate - whole.estimate) < 1e-3 * stderr)


def test_the_default_start_replaces_one_that_diverges(rng: np.random.Generator) -> None:
    """A start state that was estimated with other coefficients may diverge with these."""

    def formula(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        size = np.nan if values[1] > 5.0 else values[1]
        return {"y": values[0] * np.exp(-t) + size * t}

    own = parameter("rate", 0.0, per_trial=True)
    model = Toy(formula, (parameter("level", 1.0), own), ("y",))
    time = np.linspace(0.0, 4.0, 50)
    y = 1.0 * np.exp(-time) + 0.7 * time + 0.01 * rng.normal(size=50)
    trial = Trial("t", "validate", time, {"y": y}, starts={"rate": 50.0})
    found = output_error.estimate_start(model, model.parameters, trial, {"y": 0.01})
    # the standard error of the slope is 0.01 over the root of the sum of squared times
    assert found["rate[t]"] == pytest.approx(0.7, abs=4 * 0.01 / np.sqrt(np.sum(time**2)))


def test_samples_identify_a_trial_under_any_name() -> None:
    time = np.arange(5.0)
    trials = [Trial(name, "fit", time, {"x_m": time * size}) for name, size in (("a", 1), ("b", 1), ("a", 2))]
    assert trials[0].digest == trials[1].digest
    assert trials[0].digest != trials[2].digest


def test_a_channel_of_noise_alone_is_still(rng: np.random.Generator) -> None:
    noise = rng.normal(size=300)
    assert is_still([noise, noise + 5.0])
    assert not is_still([noise, noise + 5.0 * np.sin(np.arange(300) / 30)])
