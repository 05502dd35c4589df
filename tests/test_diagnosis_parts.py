"""Numerical methods of the diagnosis, compared with direct computations and with analytic values."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from swimid.diagnosis import (
    answer,
    candidates,
    crossval,
    dropouts,
    facts,
    places,
    posterior,
    remainder,
    search,
    settings,
    shrinkage,
    verdict,
    weighting,
)
from swimid.diagnosis.candidates import own_gains
from swimid.diagnosis.context import START_PRIOR, Fit, FitContext, beyond
from swimid.diagnosis.context import covariance as covariance_of
from swimid.diagnosis.crossval import Drawn, NormalEquations
from swimid.diagnosis.floor import Floor, disagreement, floors, nuisance_residuals, repeats, split
from swimid.diagnosis.gap_file import ChannelGap, Facts, HeldOutTrial, Shrinkage
from swimid.diagnosis.noise_model import NoiseModel, brief, coloured
from swimid.diagnosis.nominal import ParameterChange
from swimid.diagnosis.random_effects import LARGEST_SD, RandomEffect, kinds, spread
from swimid.diagnosis.verdict import share_closed
from swimid.effects.base import Affected, Effect, Inside
from swimid.fitting.model import CruiseInput, Hooks, Model, Parameter, RigInput, Stroke, SwimInput, Trial
from swimid.fitting.problem import Problem
from swimid.logs.sampling import white_noise_sd
from tests.toy_models import Toy, parameter

LINE = (parameter("a", 0.5), parameter("b", 0.5), parameter("start", 0.0, per_trial=True))


def line(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    a, b, start = values
    return {"y": a * np.sin(t) + b * t + start, "v": a * np.cos(t) + b}


def plain(k: int, *, force: float) -> Trial:
    return Trial(f"t{k}", "fit", np.arange(5.0), {}, rig=RigInput(force=force))


@pytest.fixture
def context(rng: np.random.Generator) -> FitContext:
    """Return a linear model with two coefficients, and five trials that each have a start value."""
    trials = []
    for k in range(5):
        t = np.linspace(0.0, 4.0 + k, 60 + 5 * k)
        clean = line(np.array([1.0, 0.2, 0.1 * k]), t)
        found = {c: clean[c] + 0.05 * rng.normal(size=len(t)) for c in clean}
        trials.append(Trial(f"t{k}", "fit", t, found, rig=RigInput(force=1.0 + max(k, 1))))
    return FitContext(Toy(line, LINE, ("y", "v")), LINE, trials, {"a": (0.8, 0.2)})


# ---------------------------------------------------------------- folds


def test_repeats_stay_together() -> None:
    trials = [plain(k, force=f) for k, f in enumerate((1.0, 2.0, 1.0, 3.0, 4.0))]
    found = settings.folds(trials, [np.arange(float(n)) for n in (7, 3, 5, 2, 4)])
    assert found.whole
    assert found.count == 4
    assert [len(o) for o in found.owner] == [7, 3, 5, 2, 4]
    assert [set(o.tolist()) for o in found.owner] == [{0}, {1}, {0}, {2}, {3}]


def test_few_trials_are_divided_into_stretches() -> None:
    """Two trials give four segments each. A missing sample does not move other samples to another segment."""
    trials = [plain(0, force=1.0), plain(1, force=2.0)]
    times = [np.linspace(0.0, 8.0, 81), np.linspace(0.0, 8.0, 81)[40:]]
    stacked = np.concatenate(times)
    found = settings.folds(trials, [stacked, stacked])
    assert not found.whole
    assert found.count == 8
    for k in range(2):
        owner = found.owner[k]
        for part in range(4):
            inside = stacked[owner == 4 * k + part]
            assert inside.min() >= 2.0 * part - 1e-9
            assert inside.max() <= 2.0 * part + 2.0
    assert (found.owner[0] < 4).all()


def test_a_table_is_left_out_in_parts() -> None:
    found = settings.folds([plain(k, force=float(k)) for k in range(25)], [np.zeros(1)] * 25)
    assert found.count == settings.TABLE_FOLDS
    counts = np.bincount(np.concatenate(found.owner), minlength=found.count)
    assert counts.sum() == 25
    assert set(counts.tolist()) == {2, 3}


# ---------------------------------------------------------------- noise_model


def _problem(values: np.ndarray) -> Problem:
    time = np.arange(len(values), dtype=float)
    trial = Trial("t", "fit", time, {"y": values})
    model = Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    return Problem(model, (), [trial])


def _autoregression(rng: np.random.Generator, n: int, sd: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, innovations = np.array([-1.2, 0.5]), sd * rng.normal(size=n)
    return a, innovations, lfilter([1.0], [1.0, *a], innovations)


def test_whitening_returns_the_innovations(rng: np.random.Generator) -> None:
    a, innovations, x = _autoregression(rng, 300, 0.3)
    problem = _problem(x)
    noise_model = NoiseModel(problem.sd, {"y": a}, {"y": 0.3}, {"y": 2.0})
    seen = noise_model.whiten(problem, 0, x)
    np.testing.assert_allclose(seen[2:], innovations[2:] / 0.3, rtol=1e-10, atol=1e-10)
    # the first sample has no predecessor, and the second has fewer than the order
    np.testing.assert_array_equal(seen[:2], [x[0] / 2.0, 0.0])
    both = noise_model.whiten(problem, 0, np.column_stack((x, -2.0 * x)))
    np.testing.assert_allclose(both, np.column_stack((seen, -2.0 * seen)), rtol=1e-12, atol=1e-12)


def test_whitening_restarts_after_a_missing_sample(rng: np.random.Generator) -> None:
    a, innovations, x = _autoregression(rng, 100, 1.0)
    x[[40, 41]] = np.nan
    problem = _problem(x)
    kept = np.isfinite(x)
    seen = np.full(100, np.nan)
    seen[kept] = NoiseModel(problem.sd, {"y": a}, {"y": 1.0}, {"y": 2.0}).whiten(problem, 0, x[kept])
    np.testing.assert_array_equal(seen[[0, 1, 42, 43]], [x[0] / 2.0, 0.0, x[42] / 2.0, 0.0])
    clean = [i for i in range(100) if i not in (0, 1, 40, 41, 42, 43)]
    np.testing.assert_allclose(seen[clean], innovations[clean], atol=1e-10)


def test_the_autoregression_is_estimated(rng: np.random.Generator) -> None:
    a, _, x = _autoregression(rng, 6000, 0.3)
    problem = _problem(x)
    noise_model = coloured(problem, [x], NoiseModel(problem.sd))
    seen = noise_model.whiten(problem, 0, x)[10:]
    np.testing.assert_allclose(noise_model.colour["y"][:2], a, atol=0.05)
    assert noise_model.size["y"] == pytest.approx(0.3, rel=0.05)
    assert noise_model.whole["y"] == pytest.approx(np.std(x), rel=0.01)
    assert np.var(seen) == pytest.approx(1.0, abs=0.08)
    for lag in (1, 2, 3):
        assert abs(np.corrcoef(seen[lag:], seen[:-lag])[0, 1]) < 4.0 / np.sqrt(len(seen))


def test_between_trial_variation_is_estimated(rng: np.random.Generator) -> None:
    n, count, true = 40, 60, np.array([0.5, 0.0])
    random_effects = [rng.normal(size=(n, 2)) for _ in range(count)]
    residuals = [c @ (true * rng.normal(size=2)) + rng.normal(size=n) for c in random_effects]
    first, second = spread(lambda k, rows: rows, residuals, [np.empty((n, 0))] * count, random_effects)
    assert first.sd == pytest.approx(0.5, rel=0.35)
    assert second.sd < 0.1


@pytest.mark.parametrize("repeated", [True, False])
def test_repeats_limit_the_between_trial_variation(repeated: bool, rng: np.random.Generator) -> None:
    """The bound comes from repeats (standard deviation 0.3), not from settings (standard deviation 2).

    With 40 degrees of freedom the 95 % bound is 23 % above the estimate.
    """
    n, settings, count = 40, 20, 60
    random_effects = [rng.normal(size=(n, 1)) for _ in range(count)]
    sizes = np.repeat(2.0 * rng.normal(size=settings), 3) + 0.3 * rng.normal(size=count)
    residuals = [size * c[:, 0] + rng.normal(size=n) for size, c in zip(sizes, random_effects, strict=True)]
    groups = [list(range(k, k + 3)) for k in range(0, count, 3)] if repeated else []
    (found,) = spread(
        lambda k, rows: rows, residuals, [np.empty((n, 0))] * count, random_effects, repeats=groups
    )
    assert found.sd == pytest.approx(2.0, rel=0.4)
    # the estimate of one trial has a standard error of 1 / sqrt(n) in addition
    within = np.hypot(0.3, 1.0 / np.sqrt(n))
    assert found.most == (pytest.approx(1.23 * within, rel=0.25) if repeated else LARGEST_SD)


def test_a_recording_given_twice_is_no_repeat(context: FitContext) -> None:
    """A recording that is given twice has no noise between its copies and says nothing about chance."""
    context.trials[1:4] = [replace(context.trials[0], id=f"again{k}") for k in range(3)]
    assert repeats(context) == []
    context.trials[1] = replace(
        context.trials[1], measured={c: y + 0.1 for c, y in context.trials[0].measured.items()}
    )
    assert repeats(context) == [[0, 1]]


def test_the_better_of_two_similar_random_effects_is_chosen(rng: np.random.Generator) -> None:
    """Two random effects are equally significant; the one that fits the residuals far better is chosen."""
    n, count = 100, 12
    time = np.linspace(0.0, 1.0, n)
    random_effects = [np.column_stack((time**2, 50.0 * time))] * count
    residuals = [200.0 * rng.normal() * c[:, 0] + rng.normal(size=n) for c in random_effects]
    first, second = spread(lambda k, rows: rows, residuals, [np.empty((n, 0))] * count, random_effects)
    assert first.sd > 50.0
    assert second.sd == 0.0


def test_differences_beyond_chance_are_reported_and_limited(rng: np.random.Generator) -> None:
    """The noise model contains only the part of the variation that may be chance."""
    count, time = 60, np.linspace(0.0, 1.0, 200)
    noises = [0.2 * rng.normal(size=len(time)) for _ in range(count)]
    trials = [
        Trial(f"t{k}", "fit", time, {"y": 3.0 * rng.normal() * time + noise}, rig=RigInput(force=1.0 + k))
        for k, noise in enumerate(noises)
    ]
    context = FitContext(Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials, {})
    fit = context.at((), NoiseModel(context.shape.sd), np.empty(0))
    noise_model, (kind,) = weighting.see(
        context, fit, NoiseModel(context.shape.sd), fit.residuals, [Tilt()], 0, common=0
    )
    # the error of a median absolute deviation of 60 values is 15 %
    assert kind.sd == pytest.approx(3.0, rel=0.45)
    assert [k.sd for k in noise_model.random_effects] == [LARGEST_SD]
    (number,) = noise_model.random_effects[0].acting.parameters(context.model, trials)
    assert number.per_trial
    assert number.scale == LARGEST_SD
    assert number.upper == -number.lower == pytest.approx(3.0 * np.hypot(LARGEST_SD, 0.1))


def test_of_two_similar_random_effects_the_more_significant_is_reported(rng: np.random.Generator) -> None:
    """A random effect that imitates the start state or a known random effect is not estimated again."""
    n, count = 60, 60
    time = np.linspace(0.0, 1.0, n)
    random_effects = [np.column_stack((5.0 * time, 5.0 * time + 0.5 * np.sin(9.0 * time)))] * count
    own = [np.ones((n, 1))] * count
    residuals = [
        0.4 * rng.normal() * c[:, 0] + 3.0 * rng.normal() + rng.normal(size=n) for c in random_effects
    ]
    first, second = spread(lambda k, rows: rows, residuals, own, random_effects)
    assert first.sd == pytest.approx(0.4, rel=0.4)
    assert second.sd == 0.0


@pytest.mark.parametrize("cautious", [True, False])
def test_with_few_trials_an_odd_one_counts_once_a_cause_is_found(
    cautious: bool, rng: np.random.Generator
) -> None:
    """Four trims agree within a tenth and one is far off: an outlier trial or a wide distribution."""
    trims, n = (-0.1, -0.05, 0.05, 0.1, 7.0), 60
    random_effects = [rng.normal(size=(n, 1)) for _ in trims]
    residuals = [2.0 * trim * c[:, 0] for trim, c in zip(trims, random_effects, strict=True)]
    (told,) = spread(
        lambda k, rows: rows, residuals, [np.empty((n, 0))] * 5, random_effects, cautious=cautious
    )
    # the deviation is limited to three median absolute deviations, estimated from the four trials
    robust = 1.4826 * 0.2 * (1.0 + 0.8 / 5)
    clipped = np.std([2.0 * t for t in trims[:4]] + [0.1 + 3.0 * robust], ddof=1)
    found = np.sqrt(max((robust if cautious else clipped) ** 2 - 1.0 / n, 0.0))
    assert told.sd == pytest.approx(found, rel=0.05)


def test_a_standard_deviation_grows_until_trials_agree_with_it(rng: np.random.Generator) -> None:
    """A standard deviation that is ten times too small grows; a correct one stays."""
    size, time = 0.4, np.linspace(0.0, 1.0, 100)
    trials = [
        Trial(f"t{k}", "fit", time, {"y": size * rng.normal() * time + 0.02 * rng.normal(size=100)})
        for k in range(30)
    ]
    model = Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    context = FitContext(model, (), trials, {})
    (kind,) = kinds(model, (), trials, [Tilt()], {})
    noise_model = NoiseModel([[np.full(100, 0.02)] for _ in trials])
    for begun in (0.1 * size, size):
        noise_model = replace(noise_model, random_effects=(replace(kind, sd=begun),))
        fit = context.fit((), noise_model, [context.problem((), noise_model.random_effects).start])
        (settled,) = weighting.settled(context, fit, noise_model).random_effects
        # 30 trials determine a standard deviation to 13 %; the growth stops within a factor of two
        assert settled.sd == begun if begun == size else 0.37 * size < settled.sd < 1.4 * size


def test_slow_motion_is_not_taken_for_noise(rng: np.random.Generator) -> None:
    """A large slow wave is larger than short-memory noise estimated from second differences."""
    n, sd = 2000, 0.2
    x = 3.0 * np.sin(2 * np.pi * np.arange(n) / 200.0) + sd * rng.normal(size=n)
    problem = _problem(x)
    noise_model = brief(coloured(problem, [x], NoiseModel(problem.sd)), problem, [x], ["y"])
    # second differences of white noise are larger than those of coloured noise, so slightly less is removed
    assert noise_model.whole["y"] == pytest.approx(
        sd * np.sqrt(6.0 / (6.0 - 8.0 * 0.32 + 2.0 * 0.256)), rel=0.05
    )
    pole = 0.8 ** np.arange(7.0) * 0.4
    pole[0] = 1.0
    np.testing.assert_allclose(pole[1:] + toeplitz(pole[:6]) @ noise_model.colour["y"], 0.0, atol=1e-12)


def test_between_trial_variation_is_part_of_the_noise_floor(rng: np.random.Generator) -> None:
    """The floor within trials is the noise alone; for a new trial it includes the between-trial variation."""
    n, count, size = 400, 30, 0.7
    time = np.linspace(0.0, 1.0, n)
    trims = [size * rng.normal() * time + 0.1 * rng.normal(size=n) for _ in range(count)]
    trials = [Trial(f"t{k}", "fit", time, {"y": y}) for k, y in enumerate(trims)]
    model = Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    context = FitContext(model, (), trials, {})
    (kind,) = kinds(model, (), trials, [Tilt()], {})
    noise_model = NoiseModel([[np.full(n, 0.1)] for _ in trials], random_effects=(replace(kind, sd=size),))
    fit = context.fit((), noise_model, [context.problem((), noise_model.random_effects).start])
    left = nuisance_residuals(
        fit, [fit.fixed_effects_residual(k) for k in range(count)], [time[:, None]] * count
    )
    assert np.std(np.concatenate(left)) == pytest.approx(1.0, rel=0.05)
    plain = NoiseModel(noise_model.sd)
    alike = context.fit((), plain, [context.problem(()).start])
    floor = floors(context, fit, left, 0.0, alike, plain).levels
    # 30 trims determine the standard deviation to 13 %
    between = size**2 * np.mean(time**2)
    assert floor["y"] == pytest.approx(np.sqrt(between + 0.01), rel=0.3)


@pytest.mark.parametrize("common, apart, widens", [(0.4, 0.0, False), (0.0, 0.4, True)])
def test_a_value_that_all_trials_share_is_no_random_effect(
    rng: np.random.Generator, common: float, apart: float, widens: bool
) -> None:
    """Only the per-trial part of a tilt increases the between-trial standard deviation of 0.05."""
    time = np.linspace(0.0, 1.0, 200)
    tilts = common + apart * np.resize([-1.0, 1.0], 8)
    trials = [
        Trial(f"t{k}", "fit", time, {"y": tilt * time + 0.01 * rng.normal(size=200)})
        for k, tilt in enumerate(tilts)
    ]
    model = Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    context = FitContext(model, (), trials, {})
    (kind,) = kinds(model, (), trials, [Tilt()], {})
    noise_model = NoiseModel([[np.full(200, 0.01)] for _ in trials], random_effects=(replace(kind, sd=0.05),))
    fit = context.fit((), noise_model, [context.problem((), noise_model.random_effects).start])
    (found,) = weighting.settled(context, fit, noise_model).random_effects
    assert (found.sd > 0.1) == widens


def test_two_trials_give_no_between_trial_variation(rng: np.random.Generator) -> None:
    columns = [rng.normal(size=(9, 1))] * 2
    residuals = [rng.normal(size=9) for _ in range(2)]
    (found,) = spread(lambda k, rows: rows, residuals, columns, columns)
    assert found.sd == 0.0


# ---------------------------------------------------------------- held-out comparisons


@pytest.fixture
def blocks(rng: np.random.Generator) -> list[np.ndarray]:
    """Return the columns of four folds: three shared parameters, two further columns, the residual."""
    return [rng.normal(size=(n, 6)) for n in (12, 9, 15, 8)]


PRIOR, PULL = np.array([0.0, 4.0, 0.25]), np.array([0.0, 0.3, -0.7])


def _folded(blocks: list[np.ndarray]) -> NormalEquations:
    return NormalEquations(
        np.array([b.T @ b for b in blocks]), np.diag(PRIOR), PULL, np.array([float(len(b)) for b in blocks])
    )


def _refit(blocks: list[np.ndarray], at: list[int], weights: np.ndarray) -> np.ndarray:
    """Return the least-squares solution of rows and priors in one system."""
    root, pull = np.sqrt(weights), np.concatenate((PULL, np.zeros(len(at) - 3)))
    rows = np.concatenate([*(b[:, at] for b in blocks), np.diag(root)])
    target = np.concatenate([*(b[:, -1] for b in blocks), root * pull])
    return np.linalg.lstsq(rows, target)[0]


@pytest.mark.parametrize("chosen, weights", [((), ()), ((0,), (0.5,)), ((1, 0), (0.5, 2.0))])
def test_held_out_residuals_equal_those_of_a_refit_without_the_fold(
    blocks: list[np.ndarray],
    chosen: tuple[int, ...],
    weights: tuple[float, ...],
) -> None:
    """The information of the full fit on the shared parameters counts as prior, by a known fraction."""
    at = [0, 1, 2, *(3 + c for c in chosen)]
    found = crossval.held_out(_folded(blocks), chosen, weights)
    prior = np.concatenate((PRIOR, weights))
    whole = _refit(blocks, at, prior)
    shared = np.concatenate(blocks)[:, :3] * np.sqrt(crossval.SHRINKAGE)
    known = np.column_stack((shared, np.zeros((len(shared), 2)), shared @ whole[:3]))
    for f, block in enumerate(blocks):
        theta = _refit([*blocks[:f], *blocks[f + 1 :], known], at, prior)
        strain = float(PRIOR @ (theta[:3] - PULL) ** 2) / len(blocks)
        misfit = float(np.sum((block[:, -1] - block[:, at] @ theta) ** 2))
        assert found[f] == pytest.approx(misfit + strain, rel=1e-8)
    np.testing.assert_allclose(crossval.together(_folded(blocks), chosen, weights), whole, rtol=1e-8)


def test_the_predictive_distance_is_the_increase_of_the_total_cost(blocks: list[np.ndarray]) -> None:
    """Compare with the covariance of the prediction by the other folds, computed in one system."""
    found = crossval.predictive(_folded(blocks))
    for f, block in enumerate(blocks):
        others = np.concatenate([*blocks[:f], *blocks[f + 1 :]])[:, :3]
        covariance = np.linalg.inv(others.T @ others + np.diag(PRIOR))
        error = block[:, -1] - block[:, :3] @ _refit([*blocks[:f], *blocks[f + 1 :]], [0, 1, 2], PRIOR)
        predicted = np.eye(len(block)) + block[:, :3] @ covariance @ block[:, :3].T
        assert found[f] == pytest.approx(error @ np.linalg.solve(predicted, error), rel=1e-8)


@pytest.mark.parametrize("count", [0, 1, 3, 10])
def test_few_samples_do_not_determine_their_noise(count: int, rng: np.random.Generator) -> None:
    assert white_noise_sd(rng.normal(size=count), 0.5) == 0.5
    assert white_noise_sd(rng.normal(size=4000), 0.5) == pytest.approx(1.0, rel=0.1)


def test_a_held_out_fold_takes_no_part_in_the_refit(rng: np.random.Generator) -> None:
    """The model is so nonlinear that one step from the fit to all folds would be far off."""

    def decaying(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.exp(-values[1] * t)}

    coefficients = (parameter("a", 1.0), parameter("rate", 1.0, lower=0.0, upper=3.0))
    trials, t = [], np.linspace(0.0, 3.0, 60)
    for k in range(5):
        y = np.exp(-(2.5 if k == 0 else 0.4) * t) * (3.0 if k == 0 else 0.3) + 0.01 * rng.normal(size=len(t))
        trials.append(Trial(f"t{k}", "fit", t, {"y": y}, rig=RigInput(force=1.0 + k)))

    def fitted(fit_trials: list[Trial]) -> tuple[FitContext, NoiseModel, Fit]:
        found = FitContext(Toy(decaying, coefficients), coefficients, fit_trials, {})
        noise_model = NoiseModel([[np.full(60, 0.01)]] * len(fit_trials))
        return found, noise_model, found.fit((), noise_model, [np.array([1.0, 1.0])], tolerance=1e-8)

    context, noise_model, fit = fitted(trials)
    without = context.without_each(fit, noise_model)
    for k, theta in enumerate(without):
        _, _, rest = fitted([trial for trial in trials if trial is not trials[k]])
        np.testing.assert_allclose(theta, rest.theta, rtol=0.01)


@pytest.mark.parametrize("held", ["validation", "folds"])
def test_errors_within_the_uncertainty_of_coefficients_refute_no_model(
    held: str, rng: np.random.Generator
) -> None:
    """A slope known from one second predicts minutes badly, but no slope explains a step there."""
    near, far = np.linspace(0.0, 1.0, 50), np.linspace(100.0, 200.0, 50)

    def measured(time: np.ndarray, step: float = 0.0) -> dict[str, np.ndarray]:
        return {"y": 2.0 * time + step * (time > time.mean()) + rng.normal(size=len(time))}

    def off(step: float) -> float:
        known = [Trial(f"t{k}", "fit", near, measured(near), rig=RigInput(force=float(k))) for k in range(4)]
        last = Trial("far", "validate", far, measured(far, step))
        if held == "folds":
            known.append(replace(last, role="fit"))
        slope = (parameter("slope", 0.0),)
        context = FitContext(Toy(lambda v, t: {"y": v[0] * t}, slope, ("y",)), slope, known, {})
        noise_model = NoiseModel([[np.ones(50)]] * len(known))
        fit = context.fit((), noise_model, [np.array([1.0])])
        folds, validation = shrinkage.predictions(context, fit, noise_model, [last])
        return shrinkage.total(validation if held == "validation" else folds).distance

    samples = 50 if held == "validation" else 250
    # five standard deviations of chance
    assert off(0.0) < samples + 5.0 * np.sqrt(2.0 * samples)
    # the part of the step that the best slope does not fit
    assert off(20.0) > samples + 0.2 * 50 * 10.0**2


def test_per_trial_values_say_nothing_about_a_held_out_trial() -> None:
    """Each trial has a curve of its own size. A held-out trial of another size is not mispredicted."""
    time = np.linspace(0.0, 6.0, 200)

    class Apart(Seen):
        def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
            return (parameter("size", 0.0, per_trial=True),)

    def distance(more: float) -> float:
        rng = np.random.default_rng(5)
        first, second, last = (
            Trial(f"t{k}", "fit", time, {"y": np.exp(-time) + k * ring(time) + 0.1 * rng.normal(size=200)})
            for k in (1, -2, 3)
        )
        last.measured["y"] += more * np.cos(7.0 * time)
        context = FitContext(Hooked(plainly, PLAIN, ("y",)), PLAIN, [first, second], {})
        noise_model = NoiseModel([[np.full(200, 0.1)]] * 2)
        fit = context.fit((Apart("ring", ring),), noise_model, [np.array([1.0, 1.0, -2.0])])
        return shrinkage.predictions(context, fit, noise_model, [last])[1]["t3"].distance

    assert distance(0.0) == pytest.approx(200.0, abs=5.0 * np.sqrt(400.0))
    assert distance(1.0) > 200.0 + 0.5 * 200.0 * 0.5 / 0.1**2


@pytest.mark.parametrize(
    ("more", "noise", "off"), [(0.0, 1.0, False), (0.0, 4.0, False), (0.3, 1.0, True), (0.3, 4.0, False)]
)
def test_a_validation_trial_beyond_the_noise_is_not_predicted(
    more: float, noise: float, off: bool, rng: np.random.Generator
) -> None:
    """Slow errors of three times the noise are not predicted; a trial that is only noisier is."""
    time = np.linspace(0.0, 6.0, 200)

    def trial(name: str, sd: float, added: float) -> Trial:
        y = 2.0 * np.exp(-time) + added * ring(time) + sd * rng.normal(size=200)
        return Trial(name, "fit", time, {"y": y})

    known = [trial(f"t{k}", 0.1, 0.0) for k in range(4)]
    context = FitContext(Hooked(plainly, PLAIN, ("y",)), PLAIN, known, {})
    noise_model = NoiseModel([[np.full(200, 0.1)]] * 4)
    fit = context.fit((), noise_model, [np.array([1.0])])
    held = [trial("as-ever", 0.1, 0.0), trial("other", 0.1 * noise, more)]
    found = shrinkage.unpredicted(shrinkage.predictions(context, fit, noise_model, held)[1])
    assert list(found) == (["other"] if off else [])
    if off:
        # root mean square of a sine of amplitude 0.3 and of the noise, divided by the noise
        assert found["other"] == pytest.approx(np.hypot(1.0, 0.3 / np.sqrt(2.0) / 0.1), rel=0.15)


def test_held_out_residuals_of_noise_draws(blocks: list[np.ndarray], rng: np.random.Generator) -> None:
    """The held-out residuals of noise draws equal those of refits to the draws."""
    others = [rng.normal(size=(len(b), 3)) for b in blocks]
    right = np.array([b[:, :-1].T @ o for b, o in zip(blocks, others, strict=True)])
    pull = rng.normal(size=(3, 3))
    found = crossval.held_out(_folded(blocks), (1,), (0.5,), Drawn(right, pull))
    for m in range(3):
        swapped = [np.column_stack((b[:, :-1], o[:, m])) for b, o in zip(blocks, others, strict=True)]
        one = replace(_folded(blocks), pull=pull[:, m], products=_folded(swapped).products)
        whole = crossval.held_out(one, (1,), (0.5,))
        size = [float(o[:, m] @ o[:, m]) for o in others]
        np.testing.assert_allclose(found[:, m], whole - size, rtol=1e-8, atol=1e-9)


def test_projection_removes_what_shared_parameters_imitate(blocks: list[np.ndarray]) -> None:
    rows = np.concatenate([*(b for b in blocks), np.zeros((3, 6))])
    rows[-3:, :3] = np.diag(np.sqrt(PRIOR))
    rest = rows[:, 3:] - rows[:, :3] @ np.linalg.lstsq(rows[:, :3], rows[:, 3:])[0]
    np.testing.assert_allclose(crossval.projected(_folded(blocks)), rest.T @ rest, rtol=1e-7, atol=1e-8)


def test_noise_draws_have_the_covariance_of_the_columns(
    blocks: list[np.ndarray], rng: np.random.Generator
) -> None:
    drawn = crossval.noise_draws(_folded(blocks), rng, 40_000)
    np.testing.assert_allclose(drawn.pull.std(axis=1), [0.0, 0.5, 2.0], rtol=0.03)
    for f, block in enumerate(blocks):
        covariance = drawn.right[f] @ drawn.right[f].T / 40_000
        exact = block[:, :-1].T @ block[:, :-1]
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        np.testing.assert_allclose(covariance / scale, exact / scale, atol=0.03)


def test_an_undetermined_direction_stays_at_zero() -> None:
    normal = np.array([[4.0, 0.0, 2.0], [0.0, 0.0, 0.0], [2.0, 0.0, 3.0]])
    found = crossval.solved(normal, np.array([[1.0], [0.0], [2.0]]))[:, 0]
    assert found[1] == 0.0
    np.testing.assert_allclose(
        found[[0, 2]], np.linalg.solve([[4.0, 2.0], [2.0, 3.0]], [1.0, 2.0]), rtol=1e-8
    )


def test_the_start_state_of_each_trial_is_projected_out(context: FitContext) -> None:
    """The products equal those of rows from which the start state of the trial is projected out."""
    noise_model = NoiseModel(context.shape.sd)
    fit = context.at((), noise_model, context.problem(()).start)
    found = crossval.normal_equations(context, fit, noise_model)
    assert found.shared == 2
    assert context.folds.count == 4
    expected = np.zeros((4, 3, 3))
    for k, trial in enumerate(context.trials):
        t = trial.time_s
        shared = np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones_like(t)]])
        one = np.r_[np.ones_like(t), np.zeros_like(t)]
        modelled = line(np.array([0.5, 0.5, 0.0]), t)
        left = np.r_[trial.measured["y"] - modelled["y"], trial.measured["v"] - modelled["v"]]
        # a start state with prior standard deviation START_PRIOR is one more row
        rows = np.vstack([np.column_stack([shared, left]), np.zeros(3)])
        own = np.append(one, 1.0 / START_PRIOR)
        left_over = rows - np.outer(own, own @ rows) / (own @ own)
        expected[max(k - 1, 0)] += left_over.T @ left_over
    np.testing.assert_allclose(found.products, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.prior, np.diag([25.0, 0.0]), rtol=1e-12)
    np.testing.assert_allclose(found.pull, [0.3, 0.0], rtol=1e-12)


def test_a_table_has_a_factor_for_each_setting_and_each_fin() -> None:
    """A level is a setting that three runs share; frequencies that all differ have no levels."""
    amplitude = np.repeat([0.2, 0.3], 6)
    trials = [
        Trial(
            f"run{k}", "fit", np.zeros(1), {},
            inputs={"frequency_hz": np.array([1.0 + 0.1 * k]), "amplitude_rad": np.array([a])},
            cruise=CruiseInput(fin="ab"[k % 2]),
        )
        for k, a in enumerate(amplitude)
    ]  # fmt: skip
    table = remainder.StrokeTable(trials)
    assert table.terms[len(table.curve) :] == ("amplitude 0.2", "amplitude 0.3", "fin a", "fin b")
    values = np.zeros(len(table.terms))
    values[table.terms.index("amplitude 0.3")] = 0.1
    values[table.terms.index("fin b")] = -0.2
    for k, (trial, a) in enumerate(zip(trials, amplitude, strict=True)):
        (change,) = table.hooks(values, trial, SimpleNamespace()).stroke
        stroke = change(Stroke(trial.inputs["frequency_hz"], trial.inputs["amplitude_rad"], np.ones(1)))
        expected = (0.1 if a == 0.3 else 0.0) - (0.2 if k % 2 else 0.0)
        np.testing.assert_allclose(np.log(stroke.thrust), expected, atol=1e-12)


class Tilt(Effect):
    """Add a slope that differs between trials."""

    name, stage, meaning, sources, needs = "tilt", "sensing", "a slope", (), frozenset[str]()
    scatters = True

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        return (parameter("slope", 0.0),)

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        def more(found: dict[str, np.ndarray], time: np.ndarray) -> dict[str, np.ndarray]:
            return {**found, "y": found["y"] + values[0] * time}

        return Hooks(output=(more,))


@pytest.mark.parametrize("repeated", [False, True])
def test_fixed_parameters_of_trials_may_differ_at_random(context: FitContext, repeated: bool) -> None:
    """A tenth of the friction is the scale of its deviation; a drag may differ between repeats only."""

    def own(name: str, scale: float, *, free: bool = False, per_trial: bool = True) -> Parameter:
        return parameter(name, 0.0, scale=scale, free=free, per_trial=per_trial)

    parameters = (
        own("pulley_friction", 0.1, free=True, per_trial=False),
        own("friction_deviation", 0.5),
        own("relative_drag_deviation", 0.05),
        own("start_offset", 0.01),
        own("initial_speed", 0.02, free=True),
        own("clock_offset", 0.3),
    )
    known = {"pulley_friction": -0.03}
    found = kinds(context.model, parameters, context.trials, [], known, repeated=repeated)
    expected = {"friction_deviation": (0.003, 1), "start_offset": (0.01, 3)}
    if repeated:
        expected["relative_drag_deviation"] = (0.05, 2)
    assert {k.name: (pytest.approx(k.size), k.place) for k in found} == expected
    assert all(k.label == k.name and k.effect is None for k in found)
    (unknown, *_) = kinds(context.model, parameters, context.trials, [], {})
    assert (unknown.name, unknown.size) == ("friction_deviation", 0.5)


def test_random_effects_are_parameters_with_a_prior(context: FitContext) -> None:
    """Fit, products and standard errors equal those of noise with the marginal covariance."""
    model = Hooked(line, LINE, ("y", "v"))
    mixed = FitContext(model, LINE, context.trials, {"a": (0.8, 0.2)})
    (kind,) = kinds(model, LINE, context.trials, [Tilt()], {})
    assert (kind.name, kind.size) == ("tilt", 1.0)
    sd = 0.3
    noise_model = NoiseModel(
        [[np.full(len(t.time_s), 0.5)] * 2 for t in context.trials], random_effects=(replace(kind, sd=sd),)
    )
    fit = mixed.fit((), noise_model, [mixed.problem((), noise_model.random_effects).start])
    folded = crossval.normal_equations(mixed, fit, noise_model)
    theta = np.array([fit.value("a"), fit.value("b")])
    normal, right = np.diag([25.0, 0.0]), np.array([25.0 * 0.8, 0.0])
    for k, trial in enumerate(context.trials):
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
    # the conditional optimum of a linear mixed model equals the marginal one
    np.testing.assert_allclose(theta, exact, atol=1e-4)
    at = [fit.labels.index(name) for name in ("a", "b")]
    stderr = np.sqrt(covariance_of(fit, noise_model, mixed.precision(fit.problem))[at, at])
    np.testing.assert_allclose(stderr, np.sqrt(np.diag(np.linalg.inv(normal))), rtol=1e-3)
    # with random effects at their mean, the residual is that of the start state alone
    for k, trial in enumerate(context.trials):
        t, n = trial.time_s, len(trial.time_s)
        modelled = line(np.array([*theta, 0.0]), t)
        y = (trial.measured["y"] - modelled["y"]) / 0.5
        marginal_residuals = fit.marginal_residuals(["tilt"])[k]
        np.testing.assert_allclose(marginal_residuals[:n], y - y.mean(), atol=1e-4)


def test_a_linear_fit_is_least_squares(context: FitContext) -> None:
    noise_model = NoiseModel(context.shape.sd)
    fit = context.fit((), noise_model, [context.problem(()).start])
    rows, target = [], []
    for k, trial in enumerate(context.trials):
        t, n = trial.time_s, len(trial.time_s)
        own = np.zeros((2 * n, 5))
        own[:n, k] = 1.0
        rows.append(np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones(n)], own]))
        target.append(np.r_[trial.measured["y"], trial.measured["v"]])
    # one coefficient has a prior of 0.2, and the start states have thirty times their typical scale
    prior = np.vstack([[5.0, *[0.0] * 6], np.eye(7)[2:] / START_PRIOR])
    system = np.vstack([*rows, prior])
    exact = np.linalg.lstsq(system, np.concatenate([*target, [5.0 * 0.8], np.zeros(5)]))[0]
    np.testing.assert_allclose(fit.theta, exact, atol=1e-4)
    found, exact = (
        covariance_of(fit, noise_model, context.precision(fit.problem)),
        np.linalg.inv(system.T @ system),
    )
    np.testing.assert_allclose(found, exact, atol=1e-4 * exact.diagonal().min())


def test_correlated_priors_constrain_the_ratio_of_coefficients(context: FitContext) -> None:
    """Two coefficients are known to 0.2 and 0.5, and their weighted difference to a tenth of that."""
    known = FitContext(
        context.model, context.parameters, context.trials, {"a": (0.8, 0.2), "b": (0.3, 0.5)},
        correlation=(["b", "a"], np.array([[1.0, 0.98], [0.98, 1.0]])),
    )  # fmt: skip
    precision = known.precision(known.problem(()))
    sd = np.array([0.2, 0.5])
    expected = np.linalg.inv(np.outer(sd, sd) * np.array([[1.0, 0.98], [0.98, 1.0]]))
    np.testing.assert_allclose(precision[:2, :2], expected, rtol=1e-3)
    np.testing.assert_allclose(precision[2:, 2:], np.eye(5) / START_PRIOR**2)


# ---------------------------------------------------------------- failed samples

TIME = np.arange(0.0, 12.0, 0.04)
TRUE = 0.3 * TIME + 0.02 * np.sin(2 * np.pi * TIME)


def test_a_frame_that_failed_in_one_channel_is_blank_in_all_of_the_camera() -> None:
    """A wrong marker may be off by little along one axis, so all channels of the frame are blank."""
    mask = np.arange(6) == 2
    trial = Trial("t", "fit", np.arange(6.0), {"x_m": np.ones(6), "y_m": np.ones(6), "u_m_s": np.ones(6)})
    (left,) = dropouts.Dropouts({"t": {"x_m": mask}}, []).without([trial])
    for channel, values in left.measured.items():
        np.testing.assert_array_equal(np.isnan(values), mask if channel in ("x_m", "y_m") else False)


def _looked(values: np.ndarray, simulated: np.ndarray = TRUE) -> dropouts.Dropouts:
    return dropouts.look([Trial("t", "fit", TIME, {"x_m": values})], [{"x_m": simulated}])


@pytest.fixture
def tracked(rng: np.random.Generator) -> np.ndarray:
    """Return white noise and a slow motion as a wrong model leaves it."""
    walk = lfilter([1.0], [1.0, -0.95], rng.normal(size=len(TIME)))
    return TRUE + 0.002 * rng.normal(size=len(TIME)) + 0.0005 * walk


@pytest.mark.parametrize("seed", range(8))
def test_no_sample_fails_in_clean_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise = 0.002 * lfilter([1.0], [1.0, -0.6], rng.normal(size=len(TIME)))
    assert _looked(TRUE + noise).count == 0
    # nor if the model is wrong by a twentieth and drifts
    assert _looked(TRUE + noise, 0.95 * TRUE + 0.02 * np.sin(TIME)).count == 0


def test_a_frozen_marker_is_detected(tracked: np.ndarray) -> None:
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


def test_single_spikes_are_detected(tracked: np.ndarray) -> None:
    at = [50, 51, 133, 240]
    tracked[at] += [0.1, -0.15, 0.08, 0.2]
    found = _looked(tracked)
    np.testing.assert_array_equal(np.flatnonzero(found.masks["t"]["x_m"]), at)
    assert {kind for *_, kind in found.stretches} == {"spike"}


@pytest.mark.parametrize("begin, end", [(4.0, 5.5), (9.0, 12.0)])
def test_a_displaced_stretch_is_detected(tracked: np.ndarray, begin: float, end: float) -> None:
    """The tracker follows a reflection for a while, or to the end of the trial."""
    hit = (begin <= TIME) & (end > TIME)
    tracked[hit] += 0.2
    mask = _looked(tracked).masks["t"]["x_m"]
    assert (mask != hit).sum() <= 4


def test_a_resting_body_is_not_frozen(rng: np.random.Generator) -> None:
    """Equal consecutive values are correct while the body does not move."""
    values = np.round(TRUE + 0.002 * rng.normal(size=len(TIME)), 3)
    rest = TIME < 1.0
    values[rest] = 0.0
    simulated = np.where(rest, 0.0, TRUE)
    assert not _looked(values, simulated).masks.get("t", {"x_m": np.zeros(1, bool)})["x_m"][:25].any()


# ---------------------------------------------------------------- where the gap is


def _residual_map(series: list[np.ndarray], floor: float, **known: list) -> places.Map:
    """Return the map of given residuals with one channel."""
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
    assert max(found, key=lambda c: c.ratio).label in ("2 N", "t1")


def test_start_up_and_steady_motion_share_the_gap() -> None:
    time = np.linspace(0.0, 10.0, 201)
    found = places.times(_residual_map([np.where(time <= 2.0, 0.4, 0.2)] * 3, 0.1))
    by = {c.label: c for c in found}
    assert by["start-up"].ratio == pytest.approx(4.0)
    assert by["steady"].ratio == pytest.approx(2.0)
    assert sum(c.share for c in found if c.kind == "time") == pytest.approx(1.0)


def test_the_gap_is_located_in_the_phase_of_the_stroke() -> None:
    """A gap in the first eighth of the stroke is located there at every frequency."""
    time, series, beats = np.linspace(0.0, 10.0, 2001), [], []
    for f in (1.0, 1.7):
        series.append(np.where((time * f) % 1.0 < 0.125, 0.5, 0.1))
        beats.append(SimpleNamespace(frequency_hz=f, amplitude_rad=0.3, bias_rad=0.0))
    found = places.phases(_residual_map(series, 0.1, swim=[SwimInput(b) for b in beats]))
    first, *others = sorted(found, key=lambda c: -c.ratio)
    assert first.label == "0-45 deg"
    assert first.ratio == pytest.approx(5.0, rel=0.02)
    assert all(c.ratio == pytest.approx(1.0, abs=0.1) for c in others)


# ---------------------------------------------------------------- floor and shrinkage


def test_repeats_set_the_floor(rng: np.random.Generator) -> None:
    """The difference between repeats is noise; their common part is not."""
    time, n = np.linspace(0.0, 10.0, 2000), 2000
    shared = np.sin(time)
    trials = [
        Trial(f"t{k}", "fit", time, {"y": shared + 0.1 * rng.normal(size=n)}, rig=RigInput(force=force))
        for k, force in enumerate((1.0, 1.0, 1.0, 2.0, 3.0, 4.0))
    ]
    model = Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    context = FitContext(model, (), trials, {})
    noise_model = NoiseModel(context.shape.sd)
    fit = context.at((), noise_model, np.empty(0))
    floor = floors(context, fit, fit.residuals, 0.0, fit, noise_model)
    assert floor.levels["y"] == pytest.approx(0.1, rel=0.1)
    assert floor.how == "3 repeats of 1 settings"
    np.testing.assert_allclose(split(fit, 0, fit.residuals[0])["y"], trials[0].measured["y"])


def test_an_encoder_counts_the_same_clicks_in_every_repeat(rng: np.random.Generator) -> None:
    """Two drops that are logged at the same positions are repeats; their times differ."""
    clicks = np.arange(0.0, 1.0, 0.01)
    times = [np.sqrt(clicks) + np.r_[0.0, 1e-3 * rng.normal(size=len(clicks) - 1)] for _ in range(3)]
    trials = [
        Trial(f"t{k}", "fit", np.sort(t), {"y": clicks}, rig=RigInput(force=force))
        for k, (t, force) in enumerate(zip(times, (1.0, 1.0, 2.0), strict=True))
    ]
    assert repeats(FitContext(Toy(plainly, PLAIN), PLAIN, trials, {})) == [[0, 1]]


@pytest.mark.parametrize("shift", [0.0, 0.3, 0.5])
def test_repeats_are_compared_as_functions_of_time(shift: float, rng: np.random.Generator) -> None:
    """Two repeats are sampled at different times. Interpolation removes no noise variance."""
    times = [0.01 * (np.arange(4000) + part) for part in (0.0, shift)]
    series = [(t, np.sin(t) + 0.1 * rng.normal(size=len(t))) for t in times]
    found = disagreement(series)
    assert np.sqrt(np.mean(found)) == pytest.approx(0.1, rel=0.05)
    # only where both repeats have samples
    assert len(found) == 4000 - (shift > 0)


def test_repeats_without_overlap_give_no_floor() -> None:
    early, late = np.arange(3.0), np.arange(5.0, 8.0)
    assert len(disagreement([(early, early), (late, late)])) == 0
    assert len(disagreement([(early[:1], early[:1]), (late, late)])) == 0


def test_one_pair_sets_the_floor(rng: np.random.Generator) -> None:
    time, n = np.linspace(0.0, 10.0, 2000), 2000
    trials = [
        Trial(f"t{k}", "fit", time, {"y": np.sin(time) + 0.1 * rng.normal(size=n)}, rig=RigInput(force=force))
        for k, force in enumerate((1.0, 1.0, 2.0, 3.0, 4.0))
    ]
    model = Toy(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",))
    context = FitContext(model, (), trials, {})
    noise_model = NoiseModel(context.shape.sd)
    fit = context.at((), noise_model, np.empty(0))
    floor = floors(context, fit, fit.residuals, 0.0, fit, noise_model)
    assert (floor.repeated, floor.how) == (True, "2 repeats of 1 settings")
    assert floor.levels["y"] == pytest.approx(0.1, rel=0.1)


def test_the_floor_includes_noise_that_parameters_absorb(rng: np.random.Generator) -> None:
    """Eight parameters fitted to eight trials of six samples leave 5/6 of the squared noise."""
    numbers, count, n, draws = 8, 8, 6, 30
    parameters = tuple(parameter(f"a{j}", 0.0) for j in range(numbers))
    left, told = [], []
    for _ in range(draws):
        columns = rng.normal(size=(count, n, numbers))
        trials = [
            Trial(f"t{k}", "fit", np.arange(n) + 100.0 * k, {"y": rng.normal(size=n)},
                  rig=RigInput(force=float(k)))
            for k in range(count)
        ]  # fmt: skip
        model = Toy(lambda v, t, x=columns: {"y": x[int(t[0]) // 100] @ v}, parameters)
        context = FitContext(model, parameters, trials, {})
        noise_model = NoiseModel([[np.ones(n)] for _ in trials])
        fit = context.fit((), noise_model, [np.zeros(numbers)])
        found = floors(context, fit, fit.residuals, 0.0, fit, noise_model)
        left.append(np.mean(np.concatenate(fit.residuals) ** 2))
        told.append(found.levels["y"] ** 2)
        assert found.inside["y"] ** 2 == pytest.approx(left[-1])
    # the variance of a draw is known to sqrt(2/40); unequal leverage adds a tenth of h at most
    error = 3.0 * np.sqrt(2.0 / (count * n - numbers) / draws)
    assert np.mean(left) == pytest.approx(1.0 - numbers / (count * n), abs=error)
    assert np.mean(told) == pytest.approx(1.0, abs=error + 0.1 * numbers / (count * n))


def test_the_noise_of_each_trial_is_relative_to_that_of_its_channels() -> None:
    squares = {"x": {"a": (2.0, 10), "b": (6.0, 10)}, "y": {"a": (30.0, 5), "b": (10.0, 5)}}
    noise = Floor({}, {}, {}, squares, "")
    assert noise.of_trials(["x"]) == pytest.approx({"a": 0.5, "b": 1.5})
    assert noise.of_trials(["x", "y", "z"]) == pytest.approx({"a": 12.5 / 15.0, "b": 17.5 / 15.0})


def test_noise_is_no_more_than_held_out_errors_with_the_causes() -> None:
    floor = shrinkage.capped({"x_m": 0.03, "y_m": 0.01}, [piece(5.0, 1.0)])
    # errors of 1 and noise of 1, in hundredths, have a root mean square of 1.4
    assert floor["x_m"] == pytest.approx(0.01 * np.sqrt(2.0), rel=0.2)
    assert floor["y_m"] == 0.01


@pytest.mark.parametrize("size", [0.0, 0.2, -2.0])
def test_random_effects_of_a_validation_trial_are_estimated_from_it(
    size: float, rng: np.random.Generator
) -> None:
    """The variation of the trial counts up to the 97.5 % quantile for a standard deviation of 0.1."""
    time = np.linspace(0.0, 6.0, 200)

    class Sized(Seen):
        def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
            return (parameter("size", 0.0, scale=0.1),)

    def trial(name: str, size: float) -> Trial:
        return Trial(name, "fit", time, {"y": np.exp(-time) + size * ring(time) + 0.1 * rng.normal(size=200)})

    known = [trial(f"t{k}", size) for k, size in enumerate((0.1, -0.1, 0.15, -0.15))]
    kind = RandomEffect("ring", "chance/ring size", 0.1, Sized("ring", ring), 0, (0.0,), 1.0, 1.0)
    context = FitContext(Hooked(plainly, PLAIN, ("y",)), PLAIN, known, {})
    noise_model = NoiseModel([[np.full(200, 0.1)]] * 4, random_effects=(kind,))
    fit = context.fit((), noise_model, [np.array([1.0, *[0.0] * 4])])
    found = shrinkage.predictions(context, fit, noise_model, [trial("last", size)])[1]["last"].chance["y"]
    square = float(np.mean(ring(time) ** 2))
    likely = min(size**2, chi2.ppf(0.975, 1) * 0.1**2) * square
    # standard error: noise divided by the root of the summed squares; the same for the mean of four
    sd = 0.1 / np.sqrt(200 * square)
    assert found == pytest.approx(likely, abs=3.0 * square * (2.0 * abs(size) * sd * 1.5 + 3.0 * sd**2))


@pytest.mark.parametrize("by_chance", [False, True])
def test_a_trial_that_differs_by_chance_is_no_outlier(by_chance: bool, rng: np.random.Generator) -> None:
    """One trial has an own value of a random effect, of twice its standard deviation."""
    time = np.linspace(0.0, 6.0, 200)
    sizes = (0.02, -0.02, 0.01, -0.01, 0.0, 1.0)
    known = [
        Trial(f"t{k}", "fit", time, {"y": np.exp(-time) + size * ring(time) + 0.05 * rng.normal(size=200)})
        for k, size in enumerate(sizes)
    ]
    kind = RandomEffect("ring", "chance/ring size", 1.0, Seen("ring", ring), 0, (0.0,), 0.5, 0.5)
    context = FitContext(Hooked(plainly, PLAIN, ("y",)), PLAIN, known, {})
    kinds = (kind,) if by_chance else ()
    noise_model = NoiseModel([[np.full(200, 0.05)]] * 6, random_effects=kinds)
    count = len(context.problem((), kinds).labels)
    fit = context.fit((), noise_model, [np.array([1.0, *[0.0] * (count - 1)])])
    found = facts.contradicting(context, fit, {"y": 0.05})
    assert list(found) == ["t5"] * (not by_chance)


def test_errors_are_shares_of_the_fitted_range() -> None:
    """A held-out trial with little motion has the same unit as the other trials."""
    (found,) = shrinkage.shrinkages([piece(5.0, 1.0)], {"x_m": 0.01}, no_noise, {"x_m": 4.0})
    assert found.floor == pytest.approx(0.01 / 4.0)
    assert found.before == pytest.approx(0.01 * np.sqrt(26.0) / 4.0, rel=0.2)


def test_a_channel_of_held_out_trials_only_has_no_closed_share() -> None:
    """The noise of such a channel is unknown."""
    (found,) = shrinkage.shrinkages([piece(5.0, 1.0)], {}, no_noise, {})
    assert (found.floor, found.closed, found.ci95) == (None, None, (None, None))
    assert shrinkage.by_trial([piece(5.0, 1.0)], {}) == {}


def test_channels_have_equal_weights_in_a_share_without_trials() -> None:
    rows = [
        Shrinkage(channel="x_m", shipped=5.0, before=2.0, after=1.0, floor=1.0, closed=1.0),
        Shrinkage(channel="y_m", shipped=0.3, before=0.3, after=0.2, floor=0.1, closed=5 / 8),
        Shrinkage(channel="z_m", shipped=1.0, before=1.0, after=1.0, floor=None, closed=None),
    ]
    found = verdict.over_channels(rows)
    assert (found.before, found.after) == (pytest.approx(17.0), pytest.approx(2.5))
    assert found.share == pytest.approx(14.5 / 16.0)
    assert verdict.over_channels(rows[2:]).share is None


def test_the_closed_share_of_all_channels_is_that_of_the_squared_errors() -> None:
    """Errors of 5 and 3 noise standard deviations as given, and of 1 and 0 with the causes; noise adds 1."""
    held = [as_given(piece(5.0, 1.0)), replace(as_given(piece(3.0, 0.0)), channel="y_m")]
    found = verdict.closed_share(Facts(held_out=shrinkage.by_trial(held, {"x_m": 0.01, "y_m": 0.01})))
    # 400 samples of a mean square of 18 have a standard error of 2 * sqrt(17 / 400)
    assert found.before == pytest.approx(18.0, abs=3 * 0.42)
    assert found.after == pytest.approx(1.5, abs=3 * 0.12)
    assert found.share == pytest.approx((found.before - found.after) / (found.before - 1.0))
    assert found.ci95 == (None, None)


def test_the_interval_of_a_share_includes_the_uncertain_floor() -> None:
    """One held-out trial is enough, because the interval comes from the noise of the fitted trials."""
    wide, narrow = (
        shrinkage.shrinkages([as_given(piece(3.0, 1.0))], {"x_m": 0.01}, lambda _, v=v: v, {})[0].ci95
        for v in ({str(k): v for k, v in enumerate(each)} for each in ((0.1, 0.5, 1.5, 1.9), (1.0,) * 4))
    )
    assert narrow[1] - narrow[0] < 1e-9
    assert wide[1] - wide[0] > 0.1


@pytest.mark.parametrize(("count", "fitted"), [(1, 6), (2, 6), (7, 7)])
@pytest.mark.parametrize(("gap", "left"), [(3.0, 0.0), (10.0, 0.3), (100.0, 0.02)])
def test_the_interval_of_a_share_contains_the_noise_free_share(
    count: int, fitted: int, gap: float, left: float, rng: np.random.Generator
) -> None:
    """The noise of a trial has two to ten independent components, as between-trial variation has.

    Seven trials are held out of the fit in turn. A level of 95 % has a standard error of 1.1 points.
    """
    inside = []
    for parts in rng.integers(2, 11, 400):
        noise = rng.normal(size=(fitted, parts)) / np.sqrt(parts)
        floor = np.mean(np.sum(noise**2, axis=1))
        own = rng.normal(size=(count, parts)) / np.sqrt(parts)
        if count == fitted:
            own = noise
        given, causes = (
            size * np.sqrt(count) * e / np.linalg.norm(e)
            for size, e in zip(np.sqrt([gap, left * gap]), rng.normal(size=(2, count, parts)), strict=True)
        )
        squares = (np.sum((own + e) ** 2, axis=1) / floor for e in (given, causes))
        held = {
            str(k): HeldOutTrial(samples=100, as_given=100.0 * b, before=0.0, after=100.0 * a)
            for k, (b, a) in enumerate(zip(*squares, strict=True), fitted - count)
        }
        if count < fitted:
            held = {f"held {name}": trial for name, trial in held.items()}
        relative = {str(k): float(v) for k, v in enumerate(np.sum(noise**2, axis=1) / floor)}
        low, high = verdict.closed_gap(held, relative).ci95
        if low is not None:
            inside.append(low <= 1.0 - left <= high)
    assert len(inside) > 350
    assert np.mean(inside) >= 0.95 - 5 * 0.011


@pytest.mark.parametrize(
    "before, after, floor, share",
    [(3.0, 1.0, 1.0, 1.0), (3.0, 2.0, 1.0, 5 / 8), (3.0, 4.0, 1.0, -7 / 8), (3.0, 0.9, 1.0, 1.0)],
)
def test_the_closed_share_by_hand(before: float, after: float, floor: float, share: float) -> None:
    assert share_closed(before, after, floor) == pytest.approx(share)
    assert np.isnan(share_closed(floor, after, floor))


# ---------------------------------------------------------------- search


def test_a_fit_also_starts_at_the_prior_means(context: FitContext) -> None:
    problem = context.problem(())
    near, far = np.array(problem.start), np.array(problem.start)
    at = problem.labels.index("a")
    near[at], far[at] = 1.1, 1.3  # the prior is 0.8 +- 0.2
    assert len(context.begins(problem, near)) == 1
    own, known, _ = context.begins(problem, far)
    np.testing.assert_array_equal(own, far)
    assert known[at] == 0.8
    others = np.arange(len(far)) != at
    np.testing.assert_array_equal(known[others], far[others])


def test_initial_states_also_restart_with_the_prior_means(context: FitContext) -> None:
    """Distorted coefficients come with distorted initial states, from which the prior means may diverge."""
    problem = context.problem(())
    far = np.array(problem.start)
    far[problem.labels.index("a")], far[problem.labels.index("start[t2]")] = 1.3, 40.0
    starts = context.begins(problem, far)
    assert [start[problem.labels.index("start[t2]")] for start in starts] == [40.0, 40.0, 0.0]
    assert [start[problem.labels.index("a")] for start in starts] == [1.3, 0.8, 0.8]


def test_a_prior_from_the_same_trials_is_not_a_start(context: FitContext) -> None:
    published = tuple(replace(p, known=2.0) if p.name == "a" else p for p in LINE)
    loose = FitContext(context.model, published, context.trials, {"a": (0.8, 0.6)})
    problem = loose.problem(())
    at = problem.labels.index("a")
    assert loose.begins(problem, np.array(problem.start))[1][at] == 2.0
    tight = FitContext(context.model, published, context.trials, {"a": (0.8, 0.2)})
    assert len(tight.begins(problem, np.array(problem.start))) == 1


class Seen(Effect):
    """Effect that adds a curve to the measured channel."""

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


def rise(t: np.ndarray) -> np.ndarray:
    return np.tanh(t)


def ring(t: np.ndarray) -> np.ndarray:
    return np.sin(2.0 * t)


def plainly(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    return {"y": values[0] * np.exp(-t)}


PLAIN = (parameter("a", 0.5),)


def seen_trials(rng: np.random.Generator, rising: float, ringing: float) -> list[Trial]:
    """Return six trials that contain two curves of given sizes."""
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0 + 0.3 * k, 200)
        y = np.exp(-t) + rising * rise(t) + ringing * ring(t) + 0.02 * rng.normal(size=len(t))
        trials.append(Trial(f"t{k}", "fit", t, {"y": y}, rig=RigInput(force=1.0 + k)))
    return trials


def test_a_smaller_set_is_refitted_from_the_optimum_of_a_larger_one(rng: np.random.Generator) -> None:
    """The first search ends in a side lobe of the tone; a larger set finds the main lobe."""

    class Tone(Seen):
        def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
            return parameter("size", 0.0), parameter("frequency", 2.0)

        def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
            return Seen("", lambda t: np.sin(values[1] * t)).hooks(values[:1], trial, model)

    tone, slope = Tone("tone", ring), Seen("slope", rise)
    context = FitContext(Hooked(plainly, PLAIN, ("y",)), PLAIN, seen_trials(rng, 0.0, 0.3), {})
    noise_model, own = NoiseModel([[np.full(200, 0.02)]] * 6), {"tone/size": 0.05, "tone/frequency": 7.5}
    found = search.Search(context, noise_model, [tone, slope], [], rng=rng)
    null = found.begin(np.array([1.0]))
    caught = context.fit((tone,), noise_model, [context.start((tone,), noise_model, null.fit, own)])
    own["tone/frequency"] = 2.1
    whole = context.fit(
        (tone, slope), noise_model, [context.start((tone, slope), noise_model, null.fit, own)]
    )
    assert abs(caught.value("tone/frequency") - 2.0) > 1.0
    single, pair = found.judged(caught), found.judged(whole)
    found.pool |= {h.key: h for h in (single, pair)}
    assert found.without(pair, slope).fit.value("tone/frequency") == pytest.approx(2.0, abs=0.01)
    assert found.pool[single.key].fit.cost < caught.cost
    assert found.lessened().best == {"tone"}


def test_two_effects_are_found_beside_one_that_imitates_both(rng: np.random.Generator) -> None:
    """An effect like the sum of two others fits better than either, but worse than both together."""

    def both(t: np.ndarray) -> np.ndarray:
        return rise(t) + ring(t) + 0.4 * np.cos(5.0 * t)

    model = Hooked(plainly, PLAIN, ("y",))
    effects = [Seen("rise", rise), Seen("ring", ring), Seen("both", both)]
    state = search.run(FitContext(model, PLAIN, seen_trials(rng, 1.0, 1.4), {"a": (1.0, 0.1)}), effects)
    assert {e.name for e in state.base.effects} == {"rise", "ring"}
    assert state.posterior.sets[frozenset({"rise", "ring"})] > 0.5


def test_an_effect_asked_alone_and_among_all_has_the_same_fit(rng: np.random.Generator) -> None:
    """Further candidates do not change the fit of an effect."""
    model = Hooked(plainly, PLAIN, ("y",))
    trials = seen_trials(rng, 0.3, 0.0)
    effects = [Seen("rise", rise), Seen("ring", ring), Seen("wave", lambda t: np.cos(3.0 * t))]
    whole = search.run(FitContext(model, PLAIN, trials, {"a": (1.0, 0.1)}), effects)
    alone = search.run(FitContext(model, PLAIN, trials, {"a": (1.0, 0.1)}), effects, asked=["rise"])
    assert [e.name for e in whole.base.effects] == [e.name for e in alone.base.effects] == ["rise"]
    np.testing.assert_array_equal(whole.base.theta, alone.base.theta)
    assert whole.base.cost == alone.base.cost
    rows = {r.tried.effect.name: r for r in whole.singles}
    (own,) = alone.singles
    np.testing.assert_array_equal(own.gains, rows["rise"].gains)


class Bounded(Seen):
    """Effect that counts only while its size is below 0.5."""

    inside: ClassVar[Inside] = {"size": "upper"}

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        return (replace(parameter("size", 0.0), lower=-0.5, upper=0.5, scale=0.05),)


@pytest.mark.parametrize(("size", "told"), [(0.3, ["rise"]), (-0.7, ["rise"]), (0.7, [])])
def test_an_effect_that_ends_at_an_imitating_bound_is_no_hypothesis(
    rng: np.random.Generator, size: float, told: list[str]
) -> None:
    model = Hooked(plainly, PLAIN, ("y",))
    effects = [Bounded("rise", rise), Seen("wave", lambda t: np.cos(9.0 * t))]
    state = search.run(FitContext(model, PLAIN, seen_trials(rng, size, 0.0), {"a": (1.0, 0.1)}), effects)
    assert [e.name for e in state.base.effects if e.name == "rise"] == told
    assert any(r.tried.effect.name == "rise" for r in state.singles) == bool(told)
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
    changed, slope = ParameterChange(own[0]), Seen("slope", rise)
    model, trials = Hooked(plainly, own, ("y",)), seen_trials(rng, rising, 0.0)
    prior, effects = {"a": (given, 0.005)}, [changed, slope, Seen("ring", ring)]
    state = search.run(FitContext(model, own, trials, prior), effects)
    told = [r.ranked[0].tried.effect.name for r in state.rounds] if state.posterior.none < 0.1 else []
    assert told == causes
    if causes:
        now = state.base.value("a") + state.base.value("parameter:a/change")
        stderr = answer.parameter_errors(state, state.base)
        assert now == pytest.approx(1.0, abs=4 * stderr["parameter:a"])
        # the trials alone determine the new value, the file determines the old one
        assert stderr["parameter:a"] < 0.7 * stderr["parameter:a/change"]


def test_a_change_stays_within_the_bounds_of_its_parameter() -> None:
    own = (parameter("a", 0.5, lower=0.0, upper=1.0),)
    model = Affected(Toy(plainly, own), [ParameterChange(own[0])], [])
    assert model.shifted(np.array([0.6, 0.2]))[0] == pytest.approx(0.8)
    assert model.shifted(np.array([0.6, 0.5]))[0] == 1.0
    assert model.parameters[1].bounds == (-0.5, 0.5)


def test_nothing_is_found_in_trials_of_the_model_itself(rng: np.random.Generator) -> None:
    model = Hooked(plainly, PLAIN, ("y",))
    effects = [Seen("rise", rise), Seen("ring", ring)]
    state = search.run(FitContext(model, PLAIN, seen_trials(rng, 0.0, 0.0), {"a": (1.0, 0.1)}), effects)
    assert state.posterior.none > 0.5


def _posterior(null: float, *others: tuple[str, float], samples: float = 1000.0) -> posterior.Posterior:
    def made(names: frozenset[str], score: float) -> posterior.Candidate:
        return posterior.Candidate(names, score, np.full(5, score / 5), len(names))

    found = [made(frozenset(names.split("+")), score) for names, score in others]
    return posterior.posterior(made(frozenset(), null), found, record=posterior.Record(samples, 8, 20))


class TestPosterior:
    def test_probabilities_sum_to_one(self) -> None:
        found = _posterior(5000.0, ("a", 1010.0), ("b", 2000.0), ("a+b", 1000.0))
        assert sum(found.sets.values()) + found.none + found.outside == pytest.approx(1.0)

    def test_the_excess_that_refutes_nothing_is_the_sum_of_its_parts(self) -> None:
        """Directions in each part, one percent of the squared noise, and a share of the gap."""
        known = posterior.Calibration(7.0, 0.2, 0.0, 12.0, -2.0, 1.5, 0.5)
        record = posterior.Record(samples=2000.0, parts=6, effects=20)
        assert posterior.unit(record, 500.0, known) == pytest.approx(7.0 * 6 + 20.0 + 0.2 * 500.0)
        assert posterior.unit(record, -500.0, known) == pytest.approx(7.0 * 6 + 20.0)

    def test_an_effect_that_leaves_several_times_more_is_no_rival(self) -> None:
        found = _posterior(20000.0, ("a", 1000.0), ("b", 1900.0), ("c", 1000.0))
        assert found.instead("a", frozenset({"a"}))["b"] < 0.01
        assert found.sets[frozenset("a")] == pytest.approx(found.sets[frozenset("c")])

    def test_causes_that_leave_a_similar_share_are_uncertain(self) -> None:
        found = _posterior(20000.0, ("a", 9000.0), ("b", 9500.0))
        assert found.instead("a", frozenset({"a"}))["b"] > 0.2
        assert found.outside > 0.5

    def test_a_gap_that_no_effect_closes_has_another_cause(self) -> None:
        found = _posterior(5000.0, ("a", 4900.0), ("b", 4950.0))
        assert found.outside > 0.9

    def test_a_second_cause_must_be_probable(self) -> None:
        assert _posterior(20000.0, ("a", 1400.0), ("a+b", 1250.0)).best == frozenset("a")
        assert _posterior(20000.0, ("a", 3000.0), ("a+b", 1000.0)).best == frozenset("ab")

    @pytest.mark.parametrize("alike, left, named", [(0.0, 0.0, "ab"), (0.95, 0.0, "a"), (0.0, 250.0, "a")])
    def test_a_second_cause_is_no_error_of_form_of_the_first(
        self, alike: float, left: float, named: str
    ) -> None:
        """The second effect must close nearly all of the rest, and change the trials in another way."""

        def made(names: str, score: float) -> posterior.Candidate:
            shares = dict.fromkeys(names, alike if len(names) > 1 else 0.0)
            return posterior.Candidate(
                frozenset(names), score, np.full(5, score / 5), len(names), alike=shares
            )

        null, *found = (made("", 101e3), made("a", 1500.0), made("b", 95e3), made("ab", 1000.0 + left))
        record = posterior.Record(1000.0, 5, 20)
        # a calibration in which the second cause must close this much
        known = posterior.Calibration(6.9, 0.16, 2.0, 7.7, -2.5, 3.3, 0.5)
        found_best = posterior.posterior(null, found, record=record, calibration=known).best
        assert found_best == frozenset(named)

    @pytest.mark.parametrize(
        "exact, left, named", [(True, 0.0, True), (False, 0.0, False), (True, 40.0, False)]
    )
    def test_a_changed_parameter_has_no_error_of_form(self, exact: bool, left: float, named: bool) -> None:
        """It takes up a gap of less than a tenth of the noise, and must leave nothing of it."""

        def made(names: str, score: float, exact: bool) -> posterior.Candidate:
            counts = np.full(6, score / 6)
            return posterior.Candidate(frozenset(names), score, counts, len(names), exact=exact)

        null, *found = made("", 8045.0, False), made("a", 8000.0 + left, exact), made("b", 8000.0, False)
        known = posterior.posterior(null, found, record=posterior.Record(8000.0, 6, 45))
        assert (known.closing("a") > 0.9) == named

    def test_a_gain_in_one_fold_is_uncertain(self) -> None:
        null = posterior.Candidate(frozenset(), 1060.0, np.full(6, 1060.0 / 6), 0)
        even = posterior.Candidate(frozenset("a"), 1000.0, np.full(6, 1000.0 / 6), 1)
        one = np.array([-50.0, *[10.0] * 5])
        lone = posterior.Candidate(frozenset("a"), 1000.0, 1000.0 / 6 + one, 1)
        sure, unsure = (
            posterior.posterior(null, [c], record=posterior.Record(1000.0, 8, 20)).none for c in (even, lone)
        )
        assert unsure > sure

    def test_the_remainder_is_a_share_of_the_squared_gap(self) -> None:
        assert _posterior(3000.0, ("a", 1500.0)).left == pytest.approx(0.25)


class Fragile(Seen):
    """Effect that adds a curve, and with which the simulation of the first trial diverges."""

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        found = super().hooks(values, trial, model)
        return (
            found
            if trial.id != "t0"
            else Hooks(output=(lambda seen, t: {c: np.full(len(t), np.nan) for c in seen},))
        )


def test_a_trial_that_diverges_leaves_an_effect_to_the_others(rng: np.random.Generator) -> None:
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0, 100)
        trials.append(Trial(f"t{k}", "fit", t, {"y": np.tanh(t) + 0.02 * rng.normal(size=len(t))}))
    context = FitContext(Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials, {})
    noise_model = NoiseModel([[np.full(100, 0.02)] for _ in trials])
    base = context.fit((), noise_model, [context.shape.start])
    (found,) = candidates.simulate(context, base, [Fragile("fragile", np.tanh)])
    assert found.points
    for _, changes in found.points:
        assert not changes[0].any()
        assert all(np.abs(c).max() > 1.0 for c in changes[1:])


class InUnits(Seen):
    """Effect that adds a curve, with its size in another unit."""

    def __init__(self, name: str, unit: float) -> None:
        super().__init__(name, lambda t: 0.001 / unit * np.tanh(t))
        self.unit = unit

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        return (parameter("size", 0.0, scale=self.unit),)


def test_the_screening_does_not_depend_on_the_unit_of_a_parameter(rng: np.random.Generator) -> None:
    """The changes are small against the noise, so that the prior of the size matters."""
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0, 100)
        trials.append(Trial(f"t{k}", "fit", t, {"y": 0.004 * np.tanh(t) + 0.02 * rng.normal(size=len(t))}))
    context = FitContext(Hooked(lambda v, t: {"y": np.zeros_like(t)}, (), ("y",)), (), trials, {})
    noise_model = NoiseModel([[np.full(100, 0.02)] for _ in trials])
    base = context.fit((), noise_model, [context.shape.start])
    effects = [InUnits("metres", 1.0), InUnits("millimetres", 1000.0), InUnits("kilometres", 1e-3)]
    found = candidates.screen(context, base, noise_model, candidates.simulate(context, base, effects))
    first, *others = found.tried
    assert len(others) == 2
    for other in others:
        np.testing.assert_allclose(other.gains, first.gains, rtol=1e-6)
    # a single direction with the prior standard deviation of five typical sizes, by Bayes's rule
    information = sum(np.sum((0.001 * np.tanh(t.time_s) / 0.02) ** 2) for t in trials)
    seen = sum(np.sum(0.001 * np.tanh(t.time_s) * t.measured["y"] / 0.02**2) for t in trials)
    one = next(t for t in found.tried if t.effect.name == "metres")
    assert one.point[0] == pytest.approx(seen / (information + 1 / 25), rel=1e-6)


def test_a_start_without_a_change_is_skipped(context: FitContext) -> None:
    fit = context.fit(
        (), NoiseModel([[np.full(len(t.time_s), 0.05)] * 2 for t in context.trials]), [context.shape.start]
    )
    fit.problem.hold_derivatives(fit.problem, [np.zeros_like(rows) for rows in fit.derivatives])
    without = replace(fit)
    own = [[r.copy() for r in fit.residuals]]
    gains = own_gains(context, without, NoiseModel(fit.problem.sd), own)
    assert np.isfinite(gains).all()


def piece(before: float, after: float) -> shrinkage.Piece:
    """Return a held-out trial with given errors without and with causes, in units of the noise."""
    time = np.arange(200) / 20
    measured = np.sin(time) + np.random.default_rng(4).normal(0.0, 0.01, len(time))
    return shrinkage.Piece(
        Trial("held", "validate", time, {}), "x_m", time, measured, measured,
        np.sin(time) + 0.01 * before, np.sin(time) + 0.01 * after,
    )  # fmt: skip


def as_given(held: shrinkage.Piece) -> shrinkage.Piece:
    """Return a held-out trial whose refit without causes is the model as given."""
    return replace(held, shipped=held.before)


def no_noise(channels: Collection[str]) -> dict[str, float]:
    """Return the relative noise of no fitted trial."""
    return {}


@pytest.mark.parametrize(
    ("before", "after", "helps"),
    [(5.0, 0.0, True), (5.0, 3.4, True), (5.0, 3.7, False), (5.0, 6.0, False), (5.0, np.nan, False)],
)
def test_causes_close_most_of_the_gap(before: float, after: float, helps: bool) -> None:
    """Errors of 3.5 leave half of a squared gap of 25."""
    held = shrinkage.by_trial([piece(before, after)], {"x_m": 0.01})
    assert verdict.closes_most(verdict.closed_share(Facts(held_out=held), "before"))[0] is helps


def test_each_model_predicts_by_its_better_fit() -> None:
    first, second = [piece(5.0, 3.0)], [piece(4.0, 6.0)]
    (found,) = shrinkage.better([first, second], {"x_m": 0.01})
    np.testing.assert_array_equal(found.before, second[0].before)
    np.testing.assert_array_equal(found.after, first[0].after)


def test_the_worst_held_out_trial_is_complete_and_in_time_order() -> None:
    early, late, other = piece(5.0, 3.0), piece(4.0, 3.0), piece(9.0, 1.0)
    late = replace(late, time_s=late.time_s - 10.0)
    other = replace(other, trial=replace(other.trial, id="other"))
    (found,) = shrinkage.worst([early, late, other], {"x_m": 0.01}, with_causes=True)
    assert found.trial.id == "held"
    np.testing.assert_array_equal(found.time_s, np.concatenate((late.time_s, early.time_s)))
    np.testing.assert_array_equal(found.before, np.concatenate((late.before, early.before)))
    (found,) = shrinkage.worst([early, late, other], {"x_m": 0.01}, with_causes=False)
    assert found.trial.id == "other"


def test_beside_an_outside_cause_an_effect_has_its_calibrated_probability() -> None:
    """The probability does not depend on the probability of the outside cause itself."""
    lag, slip = frozenset({"servo-lag"}), frozenset({"slip"})
    found = posterior.Posterior(
        {lag: 0.8, slip: 0.1},
        0.0,
        0.1,
        {frozenset(): 0.02, lag: 0.06, slip: 0.02},
        {frozenset(): 1.0},
        (),
        0.2,
    )
    assert found.beside_outside("servo-lag") == pytest.approx(0.2 * 0.6)
    assert found.beside_outside("servo-lag", "slip") == pytest.approx(0.2 * 0.8)


@pytest.mark.parametrize(("value", "status"), [(0.995, "at-bound"), (0.9, "estimated"), (0.005, "estimated")])
def test_a_size_within_its_error_of_a_bound_is_at_the_bound(value: float, status: str) -> None:
    """A bound at which the effect vanishes does not count."""
    tried = SimpleNamespace(
        effect=SimpleNamespace(name="slip", adds_to=None),
        parameters=(parameter("loss", 0.0, lower=0.0, upper=1.0),),
    )
    cause = SimpleNamespace(best=SimpleNamespace(tried=tried))
    base = SimpleNamespace(labels=["slip/loss"], value=lambda label: value)
    found = answer.sizes(base, cause, {"slip/loss": 0.01}, {})["loss"]
    assert (found.status, found.stderr) == (status, 0.01 if status == "estimated" else None)


def test_slow_rounding_errors_are_no_gap() -> None:
    """A slow error of known rounding size keeps its autocorrelation; one three times as large does not."""
    time = np.arange(400) / 50
    problem = FitContext(
        Hooked(plainly, PLAIN, ("y",)), PLAIN, seen_trials(np.random.default_rng(3), 0.0, 0.0), {}
    ).shape
    error = [
        np.sqrt(2.0) * np.sin(2 * np.pi * 0.5 * time[: sum(int(m.sum()) for m in masks)])
        for masks in problem.masks
    ]
    known = NoiseModel(problem.sd, rounding={"y": 1.0})
    seen = coloured(problem, error, known)
    assert brief(seen, problem, error, ["y"]).colour["y"] is seen.colour["y"]
    larger = [3.0 * e for e in error]
    seen = coloured(problem, larger, known)
    short = brief(seen, problem, larger, ["y"])
    assert short.colour["y"] is not seen.colour["y"]
    assert short.whole["y"] == pytest.approx(1.0)


def test_few_samples_need_less_gain_but_more_than_noise() -> None:
    assert [remainder.least_gain(n) for n in (10, 60, 5000)] == [25.0, 30.0, 50.0]


def test_a_base_in_a_poor_optimum_restarts_from_the_prior(rng: np.random.Generator) -> None:
    """The cost has an optimum in every turn; the lowest one is near the known frequency."""

    def turning(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": np.sin(values[0] * t) * np.exp(-0.05 * t)}

    known = (replace(parameter("rate", 1.0), known=1.0),)
    trials = [
        Trial(f"t{k}", "fit", t, {"y": turning(np.array([1.05]), t)["y"] + 0.05 * rng.normal(size=len(t))})
        for k, t in enumerate(np.linspace(0.0, 20.0 + k, 200) for k in range(4))
    ]
    context = FitContext(Toy(turning, known, ("y",)), known, trials, {"rate": (1.0, 0.5)})
    noise_model = NoiseModel([[np.full(200, 0.05)] for _ in trials])
    trapped = context.fit((), noise_model, [np.array([2.5])])
    assert abs(trapped.value("rate") - 1.05) > 0.5
    based = search.Search(context, noise_model, (), (), rng=rng).begin(trapped.theta).fit
    # five standard errors: a sample changes by about five of its units with the rate
    assert based.value("rate") == pytest.approx(1.05, abs=5 * 0.05 / np.sqrt(800) / 5)
    assert based.cost < trapped.cost


def test_of_many_starting_points_the_best_optimum_is_found(rng: np.random.Generator) -> None:
    """The starting points lie in several optima of a parameter of an effect. The worse half is dropped."""

    def turning(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.sin(values[1] * t) * np.exp(-0.05 * t)}

    parameters = (parameter("size", 1.0), parameter("turn/rate", 1.0))
    trials = [
        Trial(f"t{k}", "fit", t, {"y": turning([1.3, 1.05], t)["y"] + 0.05 * rng.normal(size=len(t))})
        for k, t in enumerate(np.linspace(0.0, 20.0 + k, 200) for k in range(4))
    ]
    context = FitContext(Toy(turning, parameters, ("y",)), parameters, trials, {"size": (1.0, 0.5)})
    noise_model = NoiseModel([[np.full(200, 0.05)] for _ in trials])
    warm = context.fit((), noise_model, [np.array([1.0, 0.5])])
    starts = [np.array([1.0, rate]) for rate in (0.3, 2.5, 0.6, 3.1, 1.0, 1.7, 1.1)]
    for rough, tolerance in ((False, 0.002), (True, 0.02)):
        found = context.multistart((), noise_model, starts, warm=warm, rough=rough)
        assert found.value("turn/rate") == pytest.approx(1.05, abs=tolerance)
    assert found.value("size") == pytest.approx(1.3, abs=0.1)
    alone = context.multistart((), noise_model, [np.array([1.0, 2.5])], warm=warm)
    assert abs(alone.value("turn/rate") - 1.05) > 0.5


@pytest.mark.parametrize(
    ("before", "after", "sound"),
    [(5.0, 500.0, True), (5.0, 1e5, False), (5.0, np.nan, False), (1e5, 2e5, True), (np.nan, np.nan, True)],
)
def test_a_cause_with_which_a_held_out_trial_diverges_is_reported(
    before: float, after: float, sound: bool
) -> None:
    """The range of the trial is 200 times its noise. Another trial is predicted well with the cause."""
    assert shrinkage.sound([piece(5.0, 0.0), piece(before, after)]) is sound


@pytest.mark.parametrize(
    ("within", "nrmse", "differs"),
    [(0.7, 1.0, True), (0.72, 1.0, False), (0.07, 0.1, True), (None, 1.0, False), (0.1, None, False)],
)
def test_trials_differ_if_most_of_the_squared_error_is_between_them(
    within: float | None, nrmse: float | None, differs: bool
) -> None:
    gap = ChannelGap(channel="x_m", nrmse=nrmse, floor=0.01, share=1.0, within=within)
    assert gap.differs is differs


def test_residuals_of_columns_of_any_size_and_of_equal_columns(rng: np.random.Generator) -> None:
    """The columns differ by 16 orders of size, two are equal and one is zero."""
    raw = rng.normal(size=(40, 3))
    values = rng.normal(size=40)
    columns = np.column_stack([1e-8 * raw[:, 0], 1e8 * raw[:, 1], raw[:, 2], raw[:, 2], np.zeros(40)])
    basis = np.linalg.qr(raw)[0]
    np.testing.assert_allclose(beyond(columns, values), values - basis @ (basis.T @ values), atol=1e-12)


def test_twins_share_one_prior_probability() -> None:
    """A hypothesis that is listed twice under two names is as probable as the hypothesis alone."""

    def made(*scores: tuple[str, float]) -> posterior.Posterior:
        null, *others = (
            posterior.Candidate(frozenset(name.split()), score, np.full(5, score / 5), len(name.split()))
            for name, score in (("", 1500.0), *scores)
        )
        return posterior.posterior(null, others, record=posterior.Record(1000.0, 5, 20))

    once = made(("drag", 1010.0), ("waves", 1040.0))
    twice = made(("drag", 1010.0), ("viscous", 1010.0), ("waves", 1040.0))
    assert twice.none == pytest.approx(once.none)
    assert twice.having("waves") == pytest.approx(once.having("waves"))
    assert twice.having("drag", "viscous") == pytest.approx(once.having("drag"))
