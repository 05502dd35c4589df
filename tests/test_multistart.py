"""Many starts: the global minimum, agreement, failures."""

from __future__ import annotations

import signal

import numpy as np
import pytest

from swimid.errors import NoTrustworthyResult
from swimid.fitting import output_error
from swimid.fitting.global_search import count_agreeing, multistart
from tests.toy_models import FRICTION, FRICTION_TRUTH, Toy, friction, parameter, trials


def well(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return x^3 - 3x: the cost has two minima if the data lie beyond the hump of this at -1."""
    return {"y": (values[0] ** 3 - 3 * values[0]) * np.ones_like(t)}


WELL = (parameter("x", -1.5, -1.9, 3.0),)
TRUTH = 2.2  # x^3 - 3x = 4.05, beyond the hump's 2: from the left of -1 the search ends at the hump


class TestTwoMinima:
    def test_the_global_one_is_found(self, rng: np.random.Generator) -> None:
        model = Toy(well, WELL)
        data = trials(model, [TRUTH], {"y": 0.1}, rng)
        # one search, without restarts around its end
        single = output_error.fit_output_error(model, data, tested=False)
        assert single.value("x") == pytest.approx(-1.0, abs=1e-3)
        best, ends = multistart(model, data, starts=8, seed=1)
        # 600 samples of 0.1 with slope 3 x^2 - 3
        assert best.value("x") == pytest.approx(TRUTH, abs=4 * 0.1 / np.sqrt(600) / (3 * TRUTH**2 - 3))
        assert best.parameters == WELL
        assert len(ends) == 8
        assert ends[0].start == pytest.approx([-1.5])
        assert all(-1.9 <= e.start[0] <= 3.0 for e in ends)
        good = [e for e in ends if e.end[0] > 0]
        assert 1 <= len(good) < 8
        assert count_agreeing(ends) == len(good)
        again = multistart(model, data, starts=8, seed=1)[1]
        assert [e.start[0] for e in again] == [e.start[0] for e in ends]

    def test_failed_starts_have_infinite_cost(self, rng: np.random.Generator) -> None:
        def breaks(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
            return {"y": well(values, t)["y"] if values[0] > 0 else np.full(len(t), np.nan)}

        model = Toy(breaks, WELL)
        data = trials(model, [TRUTH], {"y": 0.1}, rng)
        best, ends = multistart(model, data, starts=8, seed=1)
        assert best.converged
        assert not ends[0].converged
        assert ends[0].cost == np.inf
        failed = [e for e in ends if e.start[0] <= 0]
        assert all(np.isinf(e.cost) and np.isnan(e.end).all() for e in failed)
        assert count_agreeing(ends) == sum(e.start[0] > 1 for e in ends)

    def test_no_start_that_can_be_simulated_is_an_error(self, rng: np.random.Generator) -> None:
        data = trials(Toy(well, WELL), [TRUTH], {"y": 0.1}, rng)
        model = Toy(lambda v, t: {"y": np.full(len(t), np.nan)}, WELL)
        with pytest.raises(NoTrustworthyResult, match="diverges"):
            multistart(model, data, starts=3)


def test_equal_minima_may_differ_in_parameters_without_influence(rng: np.random.Generator) -> None:
    model = Toy(friction, FRICTION)
    _, ends = multistart(model, trials(model, FRICTION_TRUTH, {"y": 0.05}, rng), starts=5)
    assert count_agreeing(ends) == 5
    assert np.ptp([e.end[2] for e in ends]) > 0.1


def test_a_side_without_a_bound_starts_within_one_scale(rng: np.random.Generator) -> None:
    parameters = (parameter("a", 5.0, scale=0.5), parameter("b", 0.2, lower=0.0, scale=1.0))
    model = Toy(lambda v, t: {"y": v[0] + v[1] * t}, parameters)
    _, ends = multistart(model, trials(model, (5.0, 0.2), {"y": 0.1}, rng), starts=20)
    a, b = np.array([e.start for e in ends]).T
    assert np.all((a >= 4.5) & (a <= 5.5))
    assert np.all((b >= 0.0) & (b <= 1.2))
    assert np.ptp(a) > 0.5
    assert count_agreeing(ends) == 20


def test_interrupted_it_keeps_the_best(rng: np.random.Generator) -> None:
    data = trials(Toy(well, WELL), [TRUTH], {"y": 0.1}, rng)
    count = 0

    def before() -> None:
        nonlocal count
        count += 1
        if count == 200:
            signal.raise_signal(signal.SIGINT)

    best, ends = multistart(Toy(well, WELL, before=before), data, starts=50, seed=1)
    assert len(ends) < 50
    assert not ends[-1].converged
    assert best.converged
