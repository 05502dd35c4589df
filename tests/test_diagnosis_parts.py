"""The algebra under a diagnosis: what is held out, how residuals are weighed, what failed, where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from swimid.diagnosis import (
    answer,
    candidates,
    chain,
    conclusion,
    dropouts,
    folds,
    gram,
    places,
    result,
    shrinkage,
)
from swimid.diagnosis.bench import START_PRIOR, Bench, errors
from swimid.diagnosis.candidates import Refitted, _allowed, own_gains
from swimid.diagnosis.chance import CHANCE, kinds, spread
from swimid.diagnosis.floor import floors, quiet, split
from swimid.diagnosis.gram import Drawn, Folded
from swimid.diagnosis.lens import Lens, brief, coloured
from swimid.diagnosis.shrinkage import closed
from swimid.effects.base import Effect
from swimid.fitting.hooks import Hooks
from swimid.fitting.inputs import RigInput, SwimInput
from swimid.fitting.model import Model, Parameter, Trial
from swimid.fitting.problem import Problem
from tests.toy_models import Toy, parameter

LINE = (parameter("a", 0.5), parameter("b", 0.5), parameter("start", 0.0, per_trial=True))


def line(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    a, b, start = values
    return {"y": a * np.sin(t) + b * t + start, "v": a * np.cos(t) + b}


def plain(k: int, *, force: float) -> Trial:
    return Trial(f"t{k}", "fit", np.arange(5.0), {}, rig=RigInput(force=force))


@pytest.fixture
def bench(rng: np.random.Generator) -> Bench:
    """A linear model with two coefficients and a start of its own for each of five trials."""
    trials = []
    for k in range(5):
        t = np.linspace(0.0, 4.0 + k, 60 + 5 * k)
        clean = line(np.array([1.0, 0.2, 0.1 * k]), t)
        found = {c: clean[c] + 0.05 * rng.normal(size=len(t)) for c in clean}
        trials.append(Trial(f"t{k}", "fit", t, found, rig=RigInput(force=1.0 + max(k, 1))))
    return Bench(Toy(line, LINE, ("y", "v")), LINE, trials, {"a": (0.8, 0.2)})


# ---------------------------------------------------------------- folds


def test_repeats_stay_together() -> None:
    trials = [plain(k, force=f) for k, f in enumerate((1.0, 2.0, 1.0, 3.0, 4.0))]
    found = folds.folds(trials, [7, 3, 5, 2, 4])
    assert found.whole
    assert found.count == 4
    assert found.labels[0] == "t0 t2"
    assert [len(o) for o in found.owner] == [7, 3, 5, 2, 4]
    assert [set(o.tolist()) for o in found.owner] == [{0}, {1}, {0}, {2}, {3}]


def test_few_trials_are_cut_into_stretches() -> None:
    """Two trials, four stretches each; what is missing from a channel shifts no sample to another stretch."""
    trials = [plain(0, force=1.0), plain(1, force=2.0)]
    times = [np.linspace(0.0, 8.0, 81), np.linspace(0.0, 8.0, 81)[40:]]
    found = folds.folds(trials, [122, 122])
    assert not found.whole
    assert found.count == 8
    for k in range(2):
        owner = folds.stretches(found, k, times)
        stacked = np.concatenate(times)
        for part in range(4):
            inside = stacked[owner == 4 * k + part]
            assert inside.min() >= 2.0 * part - 1e-9
            assert inside.max() <= 2.0 * part + 2.0
    assert (folds.stretches(found, 0, times) < 4).all()


def test_a_table_is_left_out_in_parts() -> None:
    found = folds.folds([plain(k, force=float(k)) for k in range(25)], [1] * 25)
    assert found.count == folds.TABLE_FOLDS
    counts = np.bincount(np.concatenate(found.owner), minlength=found.count)
    assert counts.sum() == 25
    assert set(counts.tolist()) == {2, 3}


# ---------------------------------------------------------------- lens


def _problem(values: np.ndarray) -> Problem:
    time = np.arange(len(values), dtype=float)
    trial = Trial("t", "fit", time, {"y": values})
    model = Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    return Problem(model, (), [trial])


def _autoregression(rng: np.random.Generator, n: int, sd: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, innovations = np.array([-1.2, 0.5]), sd * rng.normal(size=n)
    return a, innovations, lfilter([1.0], [1.0, *a], innovations)


def test_the_lens_gives_back_the_innovations(rng: np.random.Generator) -> None:
    a, innovations, x = _autoregression(rng, 300, 0.3)
    problem = _problem(x)
    lens = Lens(problem.sd, {"y": a}, {"y": 0.3}, {"y": 2.0})
    seen = lens.through(problem, 0, x)
    np.testing.assert_allclose(seen[2:], innovations[2:] / 0.3, rtol=1e-10, atol=1e-10)
    # the first sample has no past, and the second not enough of it
    np.testing.assert_array_equal(seen[:2], [x[0] / 2.0, 0.0])
    both = lens.through(problem, 0, np.column_stack((x, -2.0 * x)))
    np.testing.assert_allclose(both, np.column_stack((seen, -2.0 * seen)), rtol=1e-12, atol=1e-12)


def test_no_colour_leaks_over_a_missing_sample(rng: np.random.Generator) -> None:
    a, innovations, x = _autoregression(rng, 100, 1.0)
    x[[40, 41]] = np.nan
    problem = _problem(x)
    kept = np.isfinite(x)
    seen = np.full(100, np.nan)
    seen[kept] = Lens(problem.sd, {"y": a}, {"y": 1.0}, {"y": 2.0}).through(problem, 0, x[kept])
    np.testing.assert_array_equal(seen[[0, 1, 42, 43]], [x[0] / 2.0, 0.0, x[42] / 2.0, 0.0])
    clean = [i for i in range(100) if i not in (0, 1, 40, 41, 42, 43)]
    np.testing.assert_allclose(seen[clean], innovations[clean], atol=1e-10)


def test_the_colour_is_found(rng: np.random.Generator) -> None:
    a, _, x = _autoregression(rng, 6000, 0.3)
    problem = _problem(x)
    lens = coloured(problem, [x], Lens(problem.sd))
    seen = lens.through(problem, 0, x)[10:]
    np.testing.assert_allclose(lens.colour["y"][:2], a, atol=0.05)
    assert lens.size["y"] == pytest.approx(0.3, rel=0.05)
    assert lens.whole["y"] == pytest.approx(np.std(x), rel=0.01)
    assert np.var(seen) == pytest.approx(1.0, abs=0.08)
    for lag in (1, 2, 3):
        assert abs(np.corrcoef(seen[lag:], seen[:-lag])[0, 1]) < 4.0 / np.sqrt(len(seen))


def test_chance_differences_are_sized(rng: np.random.Generator) -> None:
    n, count, true = 40, 60, np.array([0.5, 0.0])
    chance = [rng.normal(size=(n, 2)) for _ in range(count)]
    residuals = [c @ (true * rng.normal(size=2)) + rng.normal(size=n) for c in chance]
    sd = spread(lambda k, rows: rows, residuals, [np.empty((n, 0))] * count, chance)
    assert sd[0] == pytest.approx(0.5, rel=0.35)
    assert sd[1] < 0.1


def test_differences_beyond_chance_are_told_and_are_none(rng: np.random.Generator) -> None:
    """The noise has no more of them than chance may make."""
    count, time = 60, np.linspace(0.0, 1.0, 200)
    noises = [0.2 * rng.normal(size=len(time)) for _ in range(count)]
    trials = [
        Trial(f"t{k}", "fit", time, {"y": 3.0 * rng.normal() * time + noise}, rig=RigInput(force=1.0 + k))
        for k, noise in enumerate(noises)
    ]
    bench = Bench(Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials, {})
    fit = bench.at((), Lens(bench.shape.sd), np.empty(0))
    lens, (kind,) = chain.see(bench, fit, Lens(bench.shape.sd), fit.residuals, [Tilt()], 0, common=0)
    # the error of a median absolute deviation of 60 values is 15 %
    assert kind.sd == pytest.approx(3.0, rel=0.45)
    assert [k.sd for k in lens.chance] == [CHANCE]
    (number,) = lens.chance[0].acting.parameters(bench.model, trials)
    assert number.per_trial
    assert number.scale == CHANCE
    assert number.upper == -number.lower == pytest.approx(3.0 * np.hypot(CHANCE, 0.1))


def test_of_two_like_chance_differences_the_clearer_one_is_told(rng: np.random.Generator) -> None:
    """What a start state and a kind already known take is not seen again in a kind like them."""
    n, count = 60, 60
    time = np.linspace(0.0, 1.0, n)
    chance = [np.column_stack((5.0 * time, 5.0 * time + 0.5 * np.sin(9.0 * time)))] * count
    own = [np.ones((n, 1))] * count
    residuals = [0.4 * rng.normal() * c[:, 0] + 3.0 * rng.normal() + rng.normal(size=n) for c in chance]
    sd = spread(lambda k, rows: rows, residuals, own, chance)
    assert sd[0] == pytest.approx(0.4, rel=0.4)
    assert sd[1] == 0.0


@pytest.mark.parametrize("cautious", [True, False])
def test_of_few_trials_the_one_that_differs_counts_once_a_cause_is_found(
    cautious: bool, rng: np.random.Generator
) -> None:
    """Four trims alike within a tenth and one far off: an odd trial, or how far trims may go."""
    trims, n = (-0.1, -0.05, 0.05, 0.1, 7.0), 60
    chance = [rng.normal(size=(n, 1)) for _ in trims]
    residuals = [2.0 * trim * c[:, 0] for trim, c in zip(trims, chance, strict=True)]
    sd = spread(lambda k, rows: rows, residuals, [np.empty((n, 0))] * 5, chance, cautious=cautious)
    # far off: at most three of the median absolute deviations, which the four tell
    robust = 1.4826 * 0.2 * (1.0 + 0.8 / 5)
    clipped = np.std([2.0 * t for t in trims[:4]] + [0.1 + 3.0 * robust], ddof=1)
    found = np.sqrt(max((robust if cautious else clipped) ** 2 - 1.0 / n, 0.0))
    assert sd[0] == pytest.approx(found, rel=0.05)


def test_a_spread_grows_until_trials_agree_with_it(rng: np.random.Generator) -> None:
    """Ten times too small a spread pulls slopes of trials to zero; a right one stays."""
    size, time = 0.4, np.linspace(0.0, 1.0, 100)
    trials = [
        Trial(f"t{k}", "fit", time, {"y": size * rng.normal() * time + 0.02 * rng.normal(size=100)})
        for k in range(30)
    ]
    model = Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    bench = Bench(model, (), trials, {})
    (kind,) = kinds(model, (), trials, [Tilt()], {})
    lens = Lens([[np.full(100, 0.02)] for _ in trials])
    for begun in (0.1 * size, size):
        lens = replace(lens, chance=(replace(kind, sd=begun),))
        fit = bench.fit((), lens, [bench.problem((), lens.chance).start])
        (settled,) = chain.settled(bench, fit, lens).chance
        # 30 trials tell their spread to 13 %, and it stops within a factor of two below
        assert settled.sd == begun if begun == size else 0.37 * size < settled.sd < 1.4 * size


def test_slow_motion_is_not_taken_for_noise(rng: np.random.Generator) -> None:
    """White noise under a large slow wave: the wave stands out of noise of short memory."""
    n, sd = 2000, 0.2
    x = 3.0 * np.sin(2 * np.pi * np.arange(n) / 200.0) + sd * rng.normal(size=n)
    problem = _problem(x)
    lens = brief(coloured(problem, [x], Lens(problem.sd)), problem, [x], ["y"])
    # of white noise, a little less than all is taken: its second differences are larger than of coloured
    assert lens.whole["y"] == pytest.approx(sd * np.sqrt(6.0 / (6.0 - 8.0 * 0.32 + 2.0 * 0.256)), rel=0.05)
    pole = 0.8 ** np.arange(7.0) * 0.4
    pole[0] = 1.0
    np.testing.assert_allclose(pole[1:] + toeplitz(pole[:6]) @ lens.colour["y"], 0.0, atol=1e-12)


def test_what_single_trials_may_have_is_noise_of_those_to_come(rng: np.random.Generator) -> None:
    """A trim and the noise around it: within the trials the noise alone, for a further one both."""
    n, count, size = 400, 30, 0.7
    time = np.linspace(0.0, 1.0, n)
    trims = [size * rng.normal() * time + 0.1 * rng.normal(size=n) for _ in range(count)]
    trials = [Trial(f"t{k}", "fit", time, {"y": y}) for k, y in enumerate(trims)]
    model = Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    bench = Bench(model, (), trials, {})
    (kind,) = kinds(model, (), trials, [Tilt()], {})
    lens = Lens([[np.full(n, 0.1)] for _ in trials], chance=(replace(kind, sd=size),))
    fit = bench.fit((), lens, [bench.problem((), lens.chance).start])
    left = quiet(fit, [fit.bare(k) for k in range(count)], [time[:, None]] * count)
    assert np.std(np.concatenate(left)) == pytest.approx(1.0, rel=0.05)
    floor, _ = floors(bench, fit, left, 0.0)
    # 30 trims tell their size to 13 %
    between = size**2 * np.mean(time**2)
    assert floor["y"] == pytest.approx(np.sqrt(between + 0.01), rel=0.3)


@pytest.mark.parametrize("factor, allowed", [(0.5, 0.5), (3.0, 2.0), (-1.0, 0.0)])
def test_a_size_out_of_bounds_ends_there(factor: float, allowed: float) -> None:
    null, step = np.array([0.0, 1.0]), np.array([0.5, 0.0])
    assert _allowed(null, step, factor, np.array([0.0, 1.0]), np.array([1.0, 1.0])) == allowed


def test_two_trials_show_no_chance(rng: np.random.Generator) -> None:
    columns = [rng.normal(size=(9, 1))] * 2
    residuals = [rng.normal(size=9) for _ in range(2)]
    np.testing.assert_array_equal(spread(lambda k, rows: rows, residuals, columns, columns), 0.0)


# ---------------------------------------------------------------- held-out comparisons


@pytest.fixture
def blocks(rng: np.random.Generator) -> list[np.ndarray]:
    """Columns of four folds: three shared numbers, two more, the residual."""
    return [rng.normal(size=(n, 6)) for n in (12, 9, 15, 8)]


PRIOR, PULL = np.array([0.0, 4.0, 0.25]), np.array([0.0, 0.3, -0.7])


def _folded(blocks: list[np.ndarray]) -> Folded:
    return Folded(np.array([b.T @ b for b in blocks]), PRIOR, PULL, np.array([float(len(b)) for b in blocks]))


def _refit(blocks: list[np.ndarray], at: list[int], weights: np.ndarray) -> np.ndarray:
    """Least squares over rows and priors, in one system."""
    root, pull = np.sqrt(weights), np.concatenate((PULL, np.zeros(len(at) - 3)))
    rows = np.concatenate([*(b[:, at] for b in blocks), np.diag(root)])
    target = np.concatenate([*(b[:, -1] for b in blocks), root * pull])
    return np.linalg.lstsq(rows, target)[0]


@pytest.mark.parametrize("chosen, weights", [((), ()), ((0,), (0.5,)), ((1, 0), (0.5, 2.0))])
@pytest.mark.parametrize("lean", [0.0, gram.LEAN])
def test_held_out_is_a_refit_without_the_fold(
    blocks: list[np.ndarray],
    chosen: tuple[int, ...],
    weights: tuple[float, ...],
    lean: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With so much of what all folds tell of the shared numbers as its prior."""
    monkeypatch.setattr(gram, "LEAN", lean)
    at = [0, 1, 2, *(3 + c for c in chosen)]
    found = gram.held_out(_folded(blocks), chosen, weights)
    prior = np.concatenate((PRIOR, weights))
    whole = _refit(blocks, at, prior)
    shared = np.concatenate(blocks)[:, :3] * np.sqrt(lean)
    known = np.column_stack((shared, np.zeros((len(shared), 2)), shared @ whole[:3]))
    for f, block in enumerate(blocks):
        theta = _refit([*blocks[:f], *blocks[f + 1 :], known], at, prior)
        strain = float(PRIOR @ (theta[:3] - PULL) ** 2) / len(blocks)
        misfit = float(np.sum((block[:, -1] - block[:, at] @ theta) ** 2))
        assert found[f] == pytest.approx(misfit + strain, rel=1e-8)
    np.testing.assert_allclose(gram.together(_folded(blocks), chosen, weights), whole, rtol=1e-8)


def test_held_out_of_other_residuals(blocks: list[np.ndarray], rng: np.random.Generator) -> None:
    """Draws of noise, against refits to them: the misfit less that of the residuals themselves."""
    others = [rng.normal(size=(len(b), 3)) for b in blocks]
    right = np.array([b[:, :-1].T @ o for b, o in zip(blocks, others, strict=True)])
    pull = rng.normal(size=(3, 3))
    found = gram.held_out(_folded(blocks), (1,), (0.5,), Drawn(right, pull))
    for m in range(3):
        swapped = [np.column_stack((b[:, :-1], o[:, m])) for b, o in zip(blocks, others, strict=True)]
        one = replace(_folded(blocks), pull=pull[:, m], products=_folded(swapped).products)
        whole = gram.held_out(one, (1,), (0.5,))
        size = [float(o[:, m] @ o[:, m]) for o in others]
        np.testing.assert_allclose(found[:, m], whole - size, rtol=1e-8, atol=1e-9)


def test_projection_leaves_what_the_shared_numbers_cannot_imitate(blocks: list[np.ndarray]) -> None:
    rows = np.concatenate([*(b for b in blocks), np.zeros((3, 6))])
    rows[-3:, :3] = np.diag(np.sqrt(PRIOR))
    rest = rows[:, 3:] - rows[:, :3] @ np.linalg.lstsq(rows[:, :3], rows[:, 3:])[0]
    np.testing.assert_allclose(gram.projected(_folded(blocks)), rest.T @ rest, rtol=1e-7, atol=1e-8)


def test_drawn_noise_has_the_columns_covariance(blocks: list[np.ndarray], rng: np.random.Generator) -> None:
    drawn = gram.noise(_folded(blocks), rng, 40_000)
    np.testing.assert_allclose(drawn.pull.std(axis=1), [0.0, 0.5, 2.0], rtol=0.03)
    for f, block in enumerate(blocks):
        covariance = drawn.right[f] @ drawn.right[f].T / 40_000
        exact = block[:, :-1].T @ block[:, :-1]
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        np.testing.assert_allclose(covariance / scale, exact / scale, atol=0.03)


def test_what_nothing_tells_stays_at_zero() -> None:
    normal = np.array([[4.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 3.0]])
    found = gram.solved(normal, np.array([[1.0], [0.0], [2.0]]))[:, 0]
    assert found[1] == 0.0
    np.testing.assert_allclose(
        found[[0, 2]], np.linalg.solve([[4.0, 2.0], [2.0, 3.0]], [1.0, 2.0]), rtol=1e-8
    )


def test_each_trials_own_start_is_projected_out(bench: Bench) -> None:
    """Folded products equal those of the rows less what the trial's start state takes."""
    lens = Lens(bench.shape.sd)
    fit = bench.at((), lens, bench.problem(()).start)
    found = gram.folded(bench, fit, lens)
    assert found.shared == 2
    assert bench.folds.count == 4
    expected = np.zeros((4, 3, 3))
    for k, trial in enumerate(bench.trials):
        t = trial.time_s
        shared = np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones_like(t)]])
        one = np.r_[np.ones_like(t), np.zeros_like(t)]
        modelled = line(np.array([0.5, 0.5, 0.0]), t)
        left = np.r_[trial.measured["y"] - modelled["y"], trial.measured["v"] - modelled["v"]]
        # a start known beforehand to START_PRIOR is one more row
        rows = np.vstack([np.column_stack([shared, left]), np.zeros(3)])
        own = np.append(one, 1.0 / START_PRIOR)
        left_over = rows - np.outer(own, own @ rows) / (own @ own)
        expected[max(k - 1, 0)] += left_over.T @ left_over
    np.testing.assert_allclose(found.products, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.prior, [25.0, 0.0], rtol=1e-12)
    np.testing.assert_allclose(found.pull, [0.3, 0.0], rtol=1e-12)


class Tilt(Effect):
    """A slope that differs between trials."""

    name, stage, meaning, sources, needs = "tilt", "sensing", "a slope", (), frozenset[str]()
    scatters = True

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        return (parameter("slope", 0.0),)

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        def more(found: dict[str, np.ndarray], time: np.ndarray) -> dict[str, np.ndarray]:
            return {**found, "y": found["y"] + values[0] * time}

        return Hooks(output=(more,))


def test_chance_differences_are_numbers_with_their_spread_as_prior(bench: Bench) -> None:
    """Products, fit and errors are those of residuals whose noise has the covariance the differences add."""
    model = Hooked(line, LINE, ("y", "v"))
    mixed = Bench(model, LINE, bench.trials, {"a": (0.8, 0.2)})
    (kind,) = kinds(model, LINE, bench.trials, [Tilt()], {})
    assert (kind.name, kind.size) == ("tilt", 1.0)
    sd = 0.3
    lens = Lens([[np.full(len(t.time_s), 0.5)] * 2 for t in bench.trials], chance=(replace(kind, sd=sd),))
    fit = mixed.fit((), lens, [mixed.problem((), lens.chance).start])
    folded = gram.folded(mixed, fit, lens)
    theta = np.array([fit.value("a"), fit.value("b")])
    normal, right = np.diag([25.0, 0.0]), np.array([25.0 * 0.8, 0.0])
    for k, trial in enumerate(bench.trials):
        t, n = trial.time_s, len(trial.time_s)
        nil = np.zeros(n)
        shared = np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones(n)]])
        one, slope = np.r_[np.ones(n), nil], np.r_[t, nil]
        covariance = 0.25 * np.eye(2 * n) + sd**2 * np.outer(slope, slope)
        covariance += START_PRIOR**2 * np.outer(one, one)
        inverse = np.linalg.inv(covariance)
        y = np.r_[trial.measured["y"], trial.measured["v"]]
        normal = normal + shared.T @ inverse @ shared
        right = right + shared.T @ inverse @ y
        if k > 1:
            both = np.column_stack((shared, y - shared @ theta))
            np.testing.assert_allclose(folded.products[k - 1], both.T @ inverse @ both, rtol=1e-3, atol=1e-3)
    exact = np.linalg.solve(normal, right)
    # the conditional optimum of a linear mixed model is the marginal one
    np.testing.assert_allclose(theta, exact, atol=1e-4)
    at = [fit.labels.index(name) for name in ("a", "b")]
    stderr = errors(fit, lens, mixed.expected(fit.problem)[1])[at]
    np.testing.assert_allclose(stderr, np.sqrt(np.diag(np.linalg.inv(normal))), rtol=1e-3)
    # without the differences what is left is what the start state alone leaves
    for k, trial in enumerate(bench.trials):
        t, n = trial.time_s, len(trial.time_s)
        modelled = line(np.array([*theta, 0.0]), t)
        y = (trial.measured["y"] - modelled["y"]) / 0.5
        unaided = fit.unaided(["tilt"])[k]
        np.testing.assert_allclose(unaided[:n], y - y.mean(), atol=1e-4)


def test_a_linear_fit_is_least_squares(bench: Bench) -> None:
    lens = Lens(bench.shape.sd)
    fit = bench.fit((), lens, [bench.problem(()).start])
    rows, target = [], []
    for k, trial in enumerate(bench.trials):
        t, n = trial.time_s, len(trial.time_s)
        own = np.zeros((2 * n, 5))
        own[:n, k] = 1.0
        rows.append(np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones(n)], own]))
        target.append(np.r_[trial.measured["y"], trial.measured["v"]])
    # one coefficient is known beforehand to 0.2, the starts to thirty times their typical size
    prior = np.vstack([[5.0, *[0.0] * 6], np.eye(7)[2:] / START_PRIOR])
    system = np.vstack([*rows, prior])
    exact = np.linalg.lstsq(system, np.concatenate([*target, [5.0 * 0.8], np.zeros(5)]))[0]
    np.testing.assert_allclose(fit.theta, exact, atol=1e-4)
    weight = bench.expected(fit.problem)[1]
    np.testing.assert_allclose(
        errors(fit, lens, weight), np.sqrt(np.diag(np.linalg.inv(system.T @ system))), rtol=1e-4
    )


# ---------------------------------------------------------------- failed samples

TIME = np.arange(0.0, 12.0, 0.04)
TRUE = 0.3 * TIME + 0.02 * np.sin(2 * np.pi * TIME)


def _looked(values: np.ndarray, simulated: np.ndarray = TRUE) -> dropouts.Dropouts:
    return dropouts.look([Trial("t", "fit", TIME, {"x_m": values})], [{"x_m": simulated}])


@pytest.fixture
def tracked(rng: np.random.Generator) -> np.ndarray:
    """White noise and a wander that a wrong model would leave."""
    walk = lfilter([1.0], [1.0, -0.95], rng.normal(size=len(TIME)))
    return TRUE + 0.002 * rng.normal(size=len(TIME)) + 0.0005 * walk


@pytest.mark.parametrize("seed", range(8))
def test_nothing_failed_in_clean_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = 0.002 * lfilter([1.0], [1.0, -0.6], rng.normal(size=len(TIME)))
    assert _looked(TRUE + noise).count == 0
    # nor where the model is wrong by a twentieth, and drifts
    assert _looked(TRUE + noise, 0.95 * TRUE + 0.02 * np.sin(TIME)).count == 0


def test_a_frozen_marker(tracked: np.ndarray) -> None:
    hit = (TIME >= 4.0) & (TIME < 5.0)
    tracked[hit] = tracked[np.argmax(hit)]
    found = _looked(tracked)
    mask = found.masks["t"]["x_m"]
    assert mask[hit][1:].all()
    assert mask.sum() <= hit.sum() + 5
    assert {kind for *_, kind in found.stretches} == {"frozen"}
    ((_, _, begin, end, _),) = found.stretches
    assert begin == pytest.approx(4.0, abs=0.1)
    assert end == pytest.approx(4.96, abs=0.1)
    blank = found.without([Trial("t", "fit", TIME, {"x_m": tracked})])[0].measured["x_m"]
    np.testing.assert_array_equal(np.isnan(blank), mask)
    np.testing.assert_array_equal(blank[~mask], tracked[~mask])


def test_single_spikes(tracked: np.ndarray) -> None:
    at = [50, 51, 133, 240]
    tracked[at] += [0.1, -0.15, 0.08, 0.2]
    found = _looked(tracked)
    np.testing.assert_array_equal(np.flatnonzero(found.masks["t"]["x_m"]), at)
    assert {kind for *_, kind in found.stretches} == {"spike"}


@pytest.mark.parametrize("begin, end", [(4.0, 5.5), (9.0, 12.0)])
def test_a_displaced_stretch(tracked: np.ndarray, begin: float, end: float) -> None:
    """A reflection is followed for a while, or to the end."""
    hit = (begin <= TIME) & (end > TIME)
    tracked[hit] += 0.2
    mask = _looked(tracked).masks["t"]["x_m"]
    assert (mask != hit).sum() <= 4


def test_a_resting_body_is_not_frozen(rng: np.random.Generator) -> None:
    """Equal values one after another are right where the body does not move."""
    values = np.round(TRUE + 0.002 * rng.normal(size=len(TIME)), 3)
    rest = TIME < 1.0
    values[rest] = 0.0
    simulated = np.where(rest, 0.0, TRUE)
    assert not _looked(values, simulated).masks.get("t", {"x_m": np.zeros(1, bool)})["x_m"][:25].any()


# ---------------------------------------------------------------- where the gap is


def _residual_map(series: list[np.ndarray], floor: float, **known: list) -> places.Map:
    """A map of given residuals, one channel."""
    time = np.linspace(0.0, 10.0, len(series[0]))
    trials = [
        Trial(f"t{k}", "fit", time, {"y": s}, **{n: v[k] for n, v in known.items()})
        for k, s in enumerate(series)
    ]
    problem = Problem(Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials)
    fit = SimpleNamespace(problem=problem)
    return places.Map(SimpleNamespace(trials=trials), fit, series, {"y": floor})  # type: ignore[arg-type]


def test_a_cell_is_residual_over_floor() -> None:
    found = places.regimes(
        _residual_map(
            [np.full(50, 0.1), np.full(50, 0.3)], 0.1, rig=[RigInput(force=1.0), RigInput(force=2.0)]
        )
    )
    by = {c.label: c for c in found if c.kind == "force"}
    assert by["1 N"].ratio == pytest.approx(1.0)
    assert by["2 N"].ratio == pytest.approx(3.0)
    assert by["2 N"].share == pytest.approx(1.0)
    assert found[0].label in ("2 N", "t1")


def test_start_up_and_steady_share_the_gap_out() -> None:
    time = np.linspace(0.0, 10.0, 201)
    found = places.times(_residual_map([np.where(time <= 2.0, 0.4, 0.2)] * 3, 0.1))
    by = {c.label: c for c in found}
    assert by["start-up"].ratio == pytest.approx(4.0)
    assert by["steady"].ratio == pytest.approx(2.0)
    assert sum(c.share for c in found if c.kind == "time") == pytest.approx(1.0)


def test_a_change_is_dated(rng: np.random.Generator) -> None:
    quiet, broken = 0.1 * rng.normal(size=(2, 201))
    broken[120:] += 1.5
    found = places.times(_residual_map([quiet, broken], 0.1))
    (change,) = (c for c in found if c.kind == "change")
    assert change.label == "t1 from 6 s"
    assert change.share > 0.95


def test_the_phase_of_the_stroke() -> None:
    """A gap in the first eighth of the stroke is found there, whatever the frequency."""
    time, series, beats = np.linspace(0.0, 10.0, 2001), [], []
    for f in (1.0, 1.7):
        series.append(np.where((time * f) % 1.0 < 0.125, 0.5, 0.1))
        beats.append(SimpleNamespace(frequency_hz=f, amplitude_rad=0.3, bias_rad=0.0))
    first, *others = places.phases(_residual_map(series, 0.1, swim=[SwimInput(b) for b in beats]))
    assert first.label == "0-45 deg"
    assert first.ratio == pytest.approx(5.0, rel=0.02)
    assert all(c.ratio == pytest.approx(1.0, abs=0.1) for c in others)


# ---------------------------------------------------------------- floor and shrinkage


def test_repeats_set_the_floor(rng: np.random.Generator) -> None:
    """What repeats do not share is noise; what they share is not."""
    time, n = np.linspace(0.0, 10.0, 2000), 2000
    shared = np.sin(time)
    trials = [
        Trial(f"t{k}", "fit", time, {"y": shared + 0.1 * rng.normal(size=n)}, rig=RigInput(force=force))
        for k, force in enumerate((1.0, 1.0, 1.0, 2.0, 3.0, 4.0))
    ]
    model = Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    bench = Bench(model, (), trials, {})
    fit = bench.at((), Lens(bench.shape.sd), np.empty(0))
    floor, how = floors(bench, fit, fit.residuals, 0.0)
    assert floor["y"] == pytest.approx(0.1, rel=0.1)
    assert how == "3 repeats of 1 settings"
    np.testing.assert_allclose(split(fit, 0, fit.residuals[0])["y"], trials[0].measured["y"])


@pytest.mark.parametrize(
    "before, after, floor, share", [(3.0, 1.0, 1.0, 1.0), (3.0, 2.0, 1.0, 0.5), (3.0, 4.0, 1.0, -0.5)]
)
def test_closed(before: float, after: float, floor: float, share: float) -> None:
    assert closed(before, after, floor) == pytest.approx(share)
    assert np.isnan(closed(floor, after, floor))


# ---------------------------------------------------------------- chain


def test_a_fit_also_begins_at_what_is_known(bench: Bench) -> None:
    problem = bench.problem(())
    near, far = np.array(problem.start), np.array(problem.start)
    at = problem.labels.index("a")
    near[at], far[at] = 1.1, 1.3  # known as 0.8 +- 0.2
    assert len(bench.begins(problem, near)) == 1
    own, known = bench.begins(problem, far)
    np.testing.assert_array_equal(own, far)
    assert known[at] == 0.8
    others = np.arange(len(far)) != at
    np.testing.assert_array_equal(known[others], far[others])


def test_where_the_trials_told_the_prior_a_fit_begins_at_published_numbers(bench: Bench) -> None:
    published = tuple(replace(p, known=2.0) if p.name == "a" else p for p in LINE)
    loose = Bench(bench.model, published, bench.trials, {"a": (0.8, 0.6)})
    problem = loose.problem(())
    at = problem.labels.index("a")
    assert loose.begins(problem, np.array(problem.start))[1][at] == 2.0
    tight = Bench(bench.model, published, bench.trials, {"a": (0.8, 0.2)})
    assert len(tight.begins(problem, np.array(problem.start))) == 1


class Seen(Effect):
    """Adds a curve to what is measured."""

    stage, meaning, sources, needs = "sensing", "a curve", (), frozenset[str]()

    def __init__(self, name: str, curve: Callable[[np.ndarray], np.ndarray]) -> None:
        self.name, self.curve = name, curve

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        return (parameter("size", 0.0),)

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        def more(found: dict[str, np.ndarray], time: np.ndarray) -> dict[str, np.ndarray]:
            return {**found, "y": found["y"] + values[0] * self.curve(time)}

        return Hooks(output=(more,))


class Hooked(Toy):
    def hooked(self, values: np.ndarray, trial: Trial, hooks: Hooks) -> dict[str, np.ndarray]:
        return hooks.seen(self.simulate(values, trial), trial.time_s)


def test_what_stood_in_for_two_effects_is_taken_back(rng: np.random.Generator) -> None:
    """A curve like the sum of two others is found first, and is no cause once both are there."""

    def rise(t: np.ndarray) -> np.ndarray:
        return np.tanh(t)

    def ring(t: np.ndarray) -> np.ndarray:
        return np.sin(2.0 * t)

    def both(t: np.ndarray) -> np.ndarray:
        return rise(t) + ring(t) + 0.4 * np.cos(5.0 * t)

    def plainly(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.exp(-t)}

    model = Hooked(plainly, (parameter("a", 0.5),), ("y",))
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0 + 0.3 * k, 200)
        y = np.exp(-t) + 1.0 * rise(t) + 1.4 * ring(t) + 0.02 * rng.normal(size=len(t))
        trials.append(Trial(f"t{k}", "fit", t, {"y": y}, rig=RigInput(force=1.0 + k)))
    effects = [Seen("rise", rise), Seen("ring", ring), Seen("both", both)]
    state = chain.run(model, model.parameters, trials, {"a": (1.0, 0.1)}, effects)
    assert {e.name for e in state.base.effects} == {"rise", "ring"}
    assert list(state.taken_back) == ["both"]
    assert [r.ranked[0].tried.effect.name for r in state.rounds[:2]] == [e.name for e in state.base.effects]


class Fragile(Seen):
    """What a curve adds, and a simulation that breaks down in the first trial."""

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        found = super().hooks(values, trial, model)
        return (
            found
            if trial.id != "t0"
            else Hooks(output=(lambda seen, t: {c: np.full(len(t), np.nan) for c in seen},))
        )


def test_a_trial_that_breaks_down_leaves_an_effect_to_the_others(rng: np.random.Generator) -> None:
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0, 100)
        trials.append(Trial(f"t{k}", "fit", t, {"y": np.tanh(t) + 0.02 * rng.normal(size=len(t))}))
    bench = Bench(Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials, {})
    lens = Lens([[np.full(100, 0.02)] for _ in trials])
    base = bench.fit((), lens, [bench.shape.start])
    (found,) = candidates.simulate(bench, base, [Fragile("fragile", np.tanh)])
    assert found.points
    for _, changes in found.points:
        assert not changes[0].any()
        assert all(np.abs(c).max() > 1.0 for c in changes[1:])


def test_the_share_that_stays_in_a_channel_of_some_trials(bench: Bench) -> None:
    trials = [replace(bench.trials[0], measured={"y": bench.trials[0].measured["y"]}), *bench.trials[1:]]
    some = Bench(bench.model, bench.parameters, trials, bench.prior)
    lens = Lens([[np.full(len(t.time_s), 0.05)] * len(t.measured) for t in trials])
    fit = some.fit((), lens, [some.shape.start])
    half = replace(fit, residuals=[0.5 * r for r in fit.residuals])
    state = SimpleNamespace(rounds=[SimpleNamespace(base=fit)], base=half)
    assert conclusion.stays(state, "v") == pytest.approx(0.25)  # type: ignore[arg-type]


def test_a_start_that_changes_nothing_is_no_obstacle(bench: Bench) -> None:
    fit = bench.fit((), Lens([[np.full(len(t.time_s), 0.05)] * 2 for t in bench.trials]), [bench.shape.start])
    without = replace(fit, rows=[np.zeros_like(rows) for rows in fit.rows])
    own = [[r.copy() for r in fit.residuals]]
    gains = own_gains(bench, without, Lens(fit.problem.sd), own)
    assert np.isfinite(gains).all()


@pytest.mark.parametrize(
    ("gains", "why"),
    [
        ([60.0, 50.0, 40.0, 0.5], ""),
        ([10.0, 5.0, 4.0, 3.0], "no more than noise"),
        ([90.0, 80.0, -30.0, -30.0], "loses in others"),
        ([250.0, 150.0, -5.0, -10.0], "too many"),
        ([2500.0, 1500.0, -5.0, -10.0], ""),
        ([200.0, 5.0, 4.0, 3.0], "one held-out fold"),
    ],
)
def test_what_counts(gains: list[float], why: str) -> None:
    tried = SimpleNamespace(effect=SimpleNamespace(name="wall"), parameters=(parameter("force", 0.0),))
    fit = SimpleNamespace(labels=["wall/force"], theta=np.array([1.0]))
    found = SimpleNamespace(threshold=30.0)
    best = Refitted(tried, fit, np.array(gains))  # type: ignore[arg-type]
    said = chain.why_not(SimpleNamespace(rounds=[]), found, best)  # type: ignore[arg-type]
    assert why in said
    assert bool(said) == bool(why)


@pytest.mark.parametrize(("left", "rivals"), [(1e6, ("wall",)), (5e3, ())])
def test_a_rival_that_leaves_many_times_what_the_best_leaves_is_none(
    left: float, rivals: tuple[str, ...]
) -> None:
    """It gains 16 000 less: twice what form may explain, and thrice what the best leaves in all."""

    def refitted(name: str, gain: float) -> Refitted:
        tried = SimpleNamespace(effect=SimpleNamespace(name=name), parameters=())
        return Refitted(tried, SimpleNamespace(cost=left), np.full(4, gain / 4))  # type: ignore[arg-type]

    found = SimpleNamespace(ranked=[refitted("tether", 1e5), refitted("wall", 8.4e4)])
    assert conclusion.named(SimpleNamespace(), found, 0.0).equivalent == rivals  # type: ignore[arg-type]


def piece(before: float, after: float) -> shrinkage.Piece:
    """A held-out trial whose errors are these, in units of the noise, beside it."""
    time = np.arange(200) / 20
    measured = np.sin(time) + np.random.default_rng(4).normal(0.0, 0.01, len(time))
    return shrinkage.Piece(
        Trial("held", "validate", time, {}), "x_m", time, measured, measured,
        np.sin(time) + 0.01 * before, np.sin(time) + 0.01 * after,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("before", "after", "helps"),
    [(5.0, 0.0, True), (5.0, 4.9, True), (5.0, 4.98, False), (5.0, 6.0, False), (5.0, np.nan, False)],
)
def test_a_cause_closes_more_than_a_trace(before: float, after: float, helps: bool) -> None:
    """Of a squared gap of 25 a closed 1 counts, a closed 0.2 (less than 2 %) does not."""
    assert shrinkage.helps([piece(before, after)], {"x_m": 0.01}) is helps


@pytest.mark.parametrize(
    ("before", "after", "clear", "much"),
    [
        pytest.param(8.0, 3.2, 7.8, True, id="a third of the gap, three times the noise"),
        pytest.param(53.0, 2.9, 73.0, False, id="nearly all of it is closed"),
        pytest.param(3.0, 1.8, 2.9, False, id="what is left is near the noise"),
        pytest.param(4.7, 4.2, 1.9, False, id="most of the gap is what differs between trials by chance"),
    ],
)
def test_a_gap_that_stays_wide_open_is_told(before: float, after: float, clear: float, much: bool) -> None:
    largest, small = (
        result.Shrinkage(name, b, a, b, 1.0, closed(b, a, 1.0), (np.nan, np.nan))
        for name, b, a in (("x_m", before, after), ("y_m", 1.5, 1.4))
    )
    assert shrinkage.wide_open([small, largest], {"x_m": clear, "y_m": 1.5}) is (largest if much else None)
    # in fitted trials the gap is largest in the other channel, and closed
    assert shrinkage.wide_open([small, largest], {"x_m": clear, "y_m": 2 * clear}) is None


@pytest.mark.parametrize(("after", "probabilities"), [(5.0, [0.8 * 3 / 7]), (7.8, []), (9.0, [])])
def test_of_a_gap_that_stays_open_a_cause_is_told_as_far_as_it_closes_it(
    after: float, probabilities: list[float]
) -> None:
    best = SimpleNamespace(tried=SimpleNamespace(effect=SimpleNamespace(name="tether")))
    cause = conclusion.Named(best, (), 0.8, 0.8, found=None)  # type: ignore[arg-type]
    open_channel = result.Shrinkage("x_m", 8.0, after, 8.0, 1.0, closed(8.0, after, 1.0), (np.nan, np.nan))
    kept, said = answer._partly([cause], open_channel)
    assert [c.probability for c in kept] == pytest.approx(probabilities)
    assert f"tether: with it, held-out trials still miss x_m by {after} times the noise" in said


def test_a_gap_without_a_channel_to_close_is_not_wide_open() -> None:
    nothing = result.Shrinkage("x_m", 1.0, 1.0, 1.0, 1.0, np.nan, (np.nan, np.nan))
    assert shrinkage.wide_open([nothing], {"x_m": 5.0}) is None


def test_few_samples_need_less_gain_and_never_less_than_noise_may_give() -> None:
    assert [candidates.least_gain(n) for n in (10, 60, 5000)] == [25.0, 30.0, 50.0]


def test_a_base_held_in_a_poor_optimum_begins_anew_from_known_coefficients(rng: np.random.Generator) -> None:
    """A swim's phase has an optimum in every turn; the one near the known frequency is the lowest."""

    def turning(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": np.sin(values[0] * t) * np.exp(-0.05 * t)}

    known = (replace(parameter("rate", 1.0), known=1.0),)
    trials = [
        Trial(f"t{k}", "fit", t, {"y": turning(np.array([1.05]), t)["y"] + 0.05 * rng.normal(size=len(t))})
        for k, t in enumerate(np.linspace(0.0, 20.0 + k, 200) for k in range(4))
    ]
    bench = Bench(Toy(turning, known, ("y",)), known, trials, {"rate": (1.0, 0.5)})
    lens = Lens([[np.full(200, 0.05)] for _ in trials])
    trapped = bench.fit((), lens, [np.array([2.5])])
    assert abs(trapped.value("rate") - 1.05) > 0.5
    based = chain._based(bench, (), lens, trapped.theta)
    # five standard errors: a sample moves by some five of its units with the rate
    assert based.value("rate") == pytest.approx(1.05, abs=5 * 0.05 / np.sqrt(800) / 5)
    assert based.cost < trapped.cost


@pytest.mark.parametrize(
    ("before", "after", "sound"),
    [(5.0, 500.0, True), (5.0, 1e5, False), (5.0, np.nan, False), (1e5, 2e5, True), (np.nan, np.nan, True)],
)
def test_a_cause_with_which_a_held_out_trial_breaks_down_is_told(
    before: float, after: float, sound: bool
) -> None:
    """The trial's range is 200 times its noise; beside it another one that is well with the cause."""
    assert shrinkage.sound([piece(5.0, 0.0), piece(before, after)]) is sound


@pytest.mark.parametrize(
    ("gains", "steady"), [([30.0, 5.0, 80.0], True), ([30.0, -0.5, 80.0], True), ([30.0, -9.0, 80.0], False)]
)
def test_a_steady_cause_helps_in_every_fold(gains: list[float], steady: bool) -> None:
    best = Refitted(None, None, np.array(gains))  # type: ignore[arg-type]
    assert conclusion.Named(best, (), 0.8, 0.9, None).steady is steady  # type: ignore[arg-type]
