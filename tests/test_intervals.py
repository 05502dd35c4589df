"""Intervals of a fit: noise with a memory, differences between trials, and what trials cannot show."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import toeplitz

import swimid
from swimid import Channel, Model, Parameter, Trial
from swimid.fitting import output_error
from swimid.fitting.noise import Autoregression, NoiseForm
from swimid.fitting.output_error import FitResult
from validation.coverage import unlike


class Line(Model):
    """Model of a constant and a slope, which both trials share."""

    name = "line"
    channels = (Channel("y", "1"),)

    def __init__(self, *, slope: bool = True) -> None:
        self.parameters = (
            Parameter("level", "1", -math.inf, math.inf, 1.0, 1.0),
            Parameter("slope", "1/s", -math.inf, math.inf, 0.0, 1.0, free=slope),
        )

    def simulate(self, values: np.ndarray, trial: Trial) -> dict[str, np.ndarray]:
        return {"y": values[0] + values[1] * trial.time_s}


def line_trials(levels: list[float], noise: list[np.ndarray]) -> list[Trial]:
    return [
        Trial(f"t{k}", "fit", 0.02 * np.arange(len(e)), {"y": level + e})
        for k, (level, e) in enumerate(zip(levels, noise, strict=True))
    ]


def fit(model: Model, trials: list[Trial]) -> FitResult:
    return output_error.complete_fit(output_error.fit_output_error(model, trials, tested=False))


@pytest.mark.parametrize("ratio, memory_s", [(0.5, 0.1), (40.0, 2.0)])
def test_slow_noise_is_whitened_as_by_its_covariance(
    rng: np.random.Generator, ratio: float, memory_s: float
) -> None:
    time = np.sort(rng.uniform(0.0, 3.0, 80))
    rows = rng.normal(size=(80, 3))
    white, log_determinant = NoiseForm(ratio, memory_s).whiten(time, np.arange(80), rows)
    covariance = np.eye(80) + ratio * np.exp(-np.abs(time[:, None] - time) / memory_s)
    assert white.T @ white == pytest.approx(rows.T @ np.linalg.solve(covariance, rows), rel=1e-9)
    assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_an_autoregression_is_whitened_as_by_its_covariance(rng: np.random.Generator) -> None:
    coefficients = np.array([-1.2, 0.5])
    rho = np.ones(60)
    rho[1] = -coefficients[0] / (1.0 + coefficients[1])
    for lag in range(2, 60):
        rho[lag] = -coefficients @ rho[lag - 1 : lag - 3 if lag > 2 else None : -1]
    place = np.concatenate((np.arange(25), np.arange(30, 60)))
    rows = rng.normal(size=(55, 2))
    form = NoiseForm(0.0, 1.0, Autoregression.of(coefficients))
    white, log_determinant = form.whiten(0.02 * place, place, rows)
    covariance = toeplitz(rho)[np.ix_(place, place)]
    covariance[:25, 25:] = covariance[25:, :25] = 0.0
    assert white.T @ white == pytest.approx(rows.T @ np.linalg.solve(covariance, rows), rel=1e-9)
    assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


@pytest.mark.parametrize("form", [NoiseForm(), NoiseForm(0.5, 0.1), NoiseForm(40.0, 2.0)])
def test_columns_are_multiplied_by_the_covariance_of_the_noise(
    form: NoiseForm, rng: np.random.Generator
) -> None:
    """The samples have uneven times. Columns of any layout are not changed themselves."""
    time = np.sort(rng.uniform(0.0, 3.0, 80))
    columns = rng.normal(size=(3, 80)).T
    given = columns.copy()
    covariance = np.eye(80)
    if form.ratio:
        covariance += form.ratio * np.exp(-np.abs(time[:, None] - time) / form.time_s)
    np.testing.assert_allclose(form.correlate(time, columns), covariance @ columns, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(columns, given)
    np.testing.assert_allclose(form.correlate(time[:1], columns[:1]), (1.0 + form.ratio) * columns[:1])


def test_an_autoregression_is_correlated_by_its_slowest_mode(rng: np.random.Generator) -> None:
    """That is exact for one of the first order, which decays by the same factor in each sample."""
    law = Autoregression.of(np.array([-0.8]))
    form, time = NoiseForm(0.0, 0.02 * law.memory, law), 0.02 * np.arange(60)
    columns = rng.normal(size=(60, 2))
    expected = toeplitz(0.8 ** np.arange(60)) @ columns
    np.testing.assert_allclose(form.correlate(time, columns), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "form", [NoiseForm(), NoiseForm(40.0, 2.0), NoiseForm(0.0, 1.0, Autoregression.of(np.array([-1.2, 0.5])))]
)
def test_a_filter_whitens_any_columns_of_its_samples(form: NoiseForm, rng: np.random.Generator) -> None:
    place = np.concatenate((np.arange(25), np.arange(30, 60)))
    seen = form.filter(0.02 * place, place)
    for count in (1, 3):
        columns = rng.normal(size=(55, count))
        white, log_determinant = form.whiten(0.02 * place, place, columns)
        again, other = seen(columns)
        np.testing.assert_array_equal(again, white)
        assert other == log_determinant


@pytest.mark.parametrize("count, least", [(2, 0.4), (3, 0.8), (5, 0.8)])
def test_large_differences_have_the_interval_of_students_distribution(
    rng: np.random.Generator, count: int, least: float
) -> None:
    """The mean of levels that differ by 100 times their noise has one degree of freedom less than levels.

    That a level differs by more than its size is excluded, which shortens the interval of two levels.
    """
    levels = (1.0 + 0.05 * rng.normal(size=count)).tolist()
    result = fit(Line(slope=False), line_trials(levels, [5e-3 * rng.normal(size=100) for _ in levels]))
    half = stats.t.ppf(0.975, count - 1) * np.std(levels, ddof=1) / math.sqrt(count)
    assert least * half < 1.96 * (result.stderr("level") or 0.0) < 1.2 * half
    assert result.differences is not None
    assert result.differences.are_likely


def test_trials_that_agree_have_the_classical_standard_errors(rng: np.random.Generator) -> None:
    noise = [0.1 * rng.normal(size=150) for _ in range(6)]
    result = fit(Line(), line_trials([1.0] * 6, noise))
    design = np.tile(np.c_[np.ones(150), 0.02 * np.arange(150)], (6, 1))
    classical = 0.1 * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    for name, error in zip(("level", "slope"), classical, strict=True):
        assert result.stderr(name) == pytest.approx(error, rel=0.2)
    assert result.differences is not None
    assert result.differences.probability < 0.5
    root = result.information_root
    assert np.linalg.inv(root.T @ root) == pytest.approx(result.covariance, rel=1e-6)


def test_the_parameter_that_differs_is_named_with_its_standard_deviation() -> None:
    condition = unlike.Condition((20,) * 8, {"drag_coefficient": 0.03}, fixed=unlike.REPEAT)
    trials = [d.trial(str(k)) for k, d in enumerate(unlike.draw(condition, np.random.default_rng(1)))]
    found = fit(unlike.Falling(unlike.REPEAT), trials).differences
    assert found is not None
    assert found.are_likely
    assert max(found.chance, key=lambda name: found.chance[name]) == "drag_coefficient"
    assert 0.5 * 0.021 < found.sd["drag_coefficient"] < 2.0 * 0.021


def test_trials_that_agree_are_hardly_ever_said_to_differ(rng: np.random.Generator) -> None:
    alarms = 0
    for _ in range(20):
        result = fit(Line(), line_trials([1.0] * 5, [0.1 * rng.normal(size=60) for _ in range(5)]))
        alarms += result.differences is not None and result.differences.are_likely
    assert alarms <= stats.binom.ppf(0.99, 20, 0.01)


def test_slow_noise_widens_the_interval(rng: np.random.Generator) -> None:
    """One hundred errors with a memory of fifty samples are few independent ones."""
    inside = []
    for _ in range(25):
        noise = [0.1 * unlike.slow(rng, 200, 0.98) for _ in range(4)]
        result = fit(Line(slope=False), line_trials([1.0] * 4, noise))
        inside.append(abs(result.value("level") - 1.0) < 1.96 * (result.stderr("level") or 0.0))
    assert sum(inside) >= stats.binom.ppf(0.01, 25, 0.95)


def test_repeats_that_differ_hold_the_truth() -> None:
    """Two repeats whose drag differs by 3 %: the classical interval holds the truth in half of the cases."""
    condition = unlike.CONDITIONS["drag 3 %, 2 repeats"]
    found = [unlike.measure(condition, np.random.default_rng([3, s])) for s in range(25)]
    hits = [share for one in found for name, share in one.items() if name.startswith("drag_coefficient")]
    assert len(hits) == 25
    assert sum(hits) >= stats.binom.ppf(0.01, 25, 0.95)


def test_a_noisy_trial_counts_less(rng: np.random.Generator) -> None:
    noise = [sd * rng.normal(size=200) for sd in (0.1, 0.1, 0.1, 1.0)]
    result = fit(Line(slope=False), line_trials([1.0] * 4, noise))
    best = 1.0 / math.sqrt(200 * (3 / 0.1**2 + 1 / 1.0**2))
    assert best / 1.3 < (result.stderr("level") or 0.0) < 1.3 * best


def test_what_the_trials_cannot_show_is_said() -> None:
    """Two drops with different weights determine two sums, in which a difference of friction has no trace."""
    condition = unlike.CONDITIONS["friction 10 %, 2 trials"]
    drops = unlike.draw(condition, np.random.default_rng(1))
    trials = [drop.trial(str(k)) for k, drop in enumerate(drops)]
    with pytest.warns(swimid.SwimidWarning):
        found = swimid.fit_model(unlike.Falling(()), trials)
    check = next(c for c in found.evidence.checks if c.name == "differences between trials visible")
    assert check.verdict == "warn"
    assert "pulley_friction" in check.value
    assert "if pulley_friction differs by 1 %" in check.text
    assert found.verdict == "caution"
    between = found.data["fit"]["between_trials"]
    assert between["trials"] == 2
    assert set(between["hidden"]) == set(unlike.TRUTH)
    with pytest.warns(swimid.SwimidWarning, match="one trial was fitted"):
        swimid.fit_model(unlike.Falling(("added_mass", "pulley_friction")), trials[:1])


class Random(Model):
    """Model with random terms in each channel, of which some are alike, and some act in no channel."""

    name = "random"

    def __init__(self, rng: np.random.Generator, shared: int, own: int, channels: int) -> None:
        self.terms = rng.normal(size=(channels, shared + own, 5))
        if rng.random() < 0.3:
            self.terms[:, shared - 1] = self.terms[:, 0]
        if rng.random() < 0.2:
            self.terms[:, 0] = 0.0
        self.channels = tuple(Channel(f"y{c}", "1") for c in range(channels))
        self.parameters = tuple(
            Parameter(f"a{i}", "1", rng.choice([-math.inf, 0.0]), math.inf, 1.0, 1.0, per_trial=i >= shared)
            for i in range(shared + own)
        )

    def simulate(self, values: np.ndarray, trial: Trial) -> dict[str, np.ndarray]:
        t, u = trial.time_s, float(trial.inputs["u"][0])
        basis = np.stack([np.ones_like(t), t, np.sin(3 * t), np.cos(5 * t), t**2])
        basis *= u ** np.arange(5)[:, None]
        return {
            c.name: (np.sin(values) + values) @ self.terms[k] @ basis for k, c in enumerate(self.channels)
        }


@pytest.mark.parametrize("seed", range(15))
def test_any_data_have_intervals_or_are_refused(seed: int) -> None:
    """Few samples, gaps, rounded and noise-free values, random walks, and parameters that act alike."""
    rng = np.random.default_rng(seed)
    model = Random(rng, *rng.integers((1, 0, 1), (6, 3, 4)))
    trials = []
    for k in range(rng.integers(1, 7)):
        time = 0.02 * np.arange(rng.choice([4, 8, 30, 200]))
        trial = Trial(f"t{k}", "fit", time, {}, inputs={"u": np.full(len(time), rng.uniform(0.5, 2.0))})
        measured = {}
        for name, exact in model.simulate(np.ones(len(model.parameters)), trial).items():
            noise = rng.normal(size=len(time))
            if rng.random() < 0.4:
                noise = np.cumsum(noise)
            values = exact + rng.choice([0.0, 1e-9, 1e-3, 0.1, 3.0]) * noise
            values[rng.random(len(time)) < rng.choice([0.0, 0.0, 0.4])] = np.nan
            measured[name] = np.round(values, rng.choice([0, 12, 12, 12]))
        trials.append(Trial(f"t{k}", "fit", time, measured, inputs=trial.inputs))
    try:
        result = output_error.complete_fit(
            output_error.fit_output_error(model, trials, tested=False, max_iterations=40)
        )
    except swimid.NoTrustworthyResult:
        return
    for label in result.common_labels:
        error = result.stderr(label)
        assert result.status[label] != "estimated" or (error is not None and math.isfinite(error))
