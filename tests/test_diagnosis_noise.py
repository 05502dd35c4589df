"""Noise of a diagnosis: whitening, its estimate from residuals, and random effects of trials."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from swimid.diagnosis import crossval, noise
from swimid.diagnosis.noise import NoiseModel
from swimid.diagnosis.study import START_PRIOR, GapStudy, Hypothesis
from swimid.fitting.model import Trial
from swimid.fitting.noise import NoiseForm
from swimid.fitting.problem import Problem
from tests.diagnosis_models import (
    Hooked,
    Seen,
    Tilt,
    differing,
    line_study,
    noise_of,
    nothing,
    trial,
    with_sd,
)
from tests.toy_models import Toy, parameter

STEP_S = 0.02


def problem_of(values: np.ndarray, time: np.ndarray | None = None) -> Problem:
    """Return the problem of a model that is zero, and one trial."""
    time = STEP_S * np.arange(len(values)) if time is None else time
    return Problem(Toy(nothing, (), ("y",)), (), [Trial("t", "fit", time, {"y": values})])


def slow(rng: np.random.Generator, time: np.ndarray, sd: float, memory_s: float) -> np.ndarray:
    """Return a first-order process with a given standard deviation and time constant."""
    values = np.empty(len(time))
    values[0] = rng.normal()
    for i, kept in enumerate(np.exp(-np.diff(time) / memory_s), 1):
        values[i] = kept * values[i - 1] + np.sqrt(1.0 - kept**2) * rng.normal()
    return sd * values


def level(known: NoiseModel) -> float:
    """Return the standard deviation of the noise of a sample, in units of its weight."""
    return float(np.sqrt(known.covariance("y", np.zeros(1), np.ones((1, 1)))[0, 0]))


# ---------------------------------------------------------------- whitening


def test_whitened_white_and_slow_noise_is_independent_and_has_unit_variance(rng: np.random.Generator) -> None:
    """The samples have uneven times. Ten thousand variances have a mean within five standard errors."""
    time = np.cumsum(STEP_S * rng.uniform(0.2, 1.8, 10_000))
    x = 0.3 * (rng.normal(size=len(time)) + slow(rng, time, 2.0, 0.5))
    problem = problem_of(x, time)
    known = NoiseModel(problem.sd, {"y": NoiseForm(4.0, 0.5)}, {"y": 0.09})
    seen = known.whiten(problem, 0, x)
    assert np.mean(seen**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / len(x)))
    for lag in (1, 5, 25, 100):
        assert abs(np.mean(seen[lag:] * seen[:-lag])) < 5.0 / np.sqrt(len(x))
    assert level(known) == pytest.approx(0.3 * np.sqrt(5.0))


def test_whitened_products_are_those_with_the_covariance_of_the_noise(rng: np.random.Generator) -> None:
    """The noise is white in one channel, and slow in the other one."""
    study = line_study(rng)
    problem, n = study.shape, len(study.trials[0].time_s)
    columns = rng.normal(size=(2 * n, 3))
    known = replace(noise_of(problem, 1.0), forms={"v": NoiseForm(3.0, 0.7)}, variance={"v": 0.25, "y": 2.0})
    seen = known.whiten(problem, 0, columns)
    time = study.trials[0].time_s
    lag = np.abs(np.subtract.outer(time, time))
    whole = np.zeros((2 * n, 2 * n))
    whole[:n, :n] = 2.0 * np.eye(n)
    whole[n:, n:] = 0.25 * (np.eye(n) + 3.0 * np.exp(-lag / 0.7))
    np.testing.assert_allclose(seen.T @ seen, columns.T @ np.linalg.solve(whole, columns), rtol=1e-8)


# ---------------------------------------------------------------- estimate


def estimated(
    trials: list[Trial], generic: tuple[np.ndarray, ...] = (), sd: float = 1.0, brief: bool = True
) -> tuple[NoiseModel, Hypothesis]:
    """Estimate the noise of trials of a model that is zero, with generic terms that equal curves."""
    study = with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), sd)
    fit = study.at((), np.empty(0))
    terms = [[curve] * len(trials) for curve in generic]
    return noise.estimate_measurement_noise(study, fit, terms, [], brief=brief), fit


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_is_told_as_white_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = STEP_S * np.arange(1000)
    known, fit = estimated([trial(k, time, 0.3 * rng.normal(size=1000)) for k in range(4)], sd=0.1)
    seen = np.concatenate([known.whiten(fit.problem, k, r) for k, r in enumerate(fit.residuals)])
    # the level is in units of the weights
    assert level(known) == pytest.approx(3.0, rel=5.0 / np.sqrt(8000))
    assert np.mean(seen**2) == pytest.approx(1.0, abs=0.03)
    assert known.forms["y"].time_s < 2.1 * STEP_S


@pytest.mark.parametrize("memory_s", [0.1, 1.0])
def test_the_memory_of_the_noise_is_estimated(memory_s: float, rng: np.random.Generator) -> None:
    """Ninety memories determine the standard deviation to about 10 %."""
    time = STEP_S * np.arange(3000)
    series = [rng.normal(size=3000) + slow(rng, time, 1.5, memory_s) for _ in range(3)]
    known, fit = estimated([trial(k, time, y) for k, y in enumerate(series)])
    seen = [known.whiten(fit.problem, k, r) for k, r in enumerate(fit.residuals)]
    assert level(known) == pytest.approx(np.sqrt(1.0 + 1.5**2), rel=0.2)
    assert np.mean(np.concatenate(seen) ** 2) == pytest.approx(1.0, abs=0.05)
    for lag in (1, 3, 10, 50):
        assert abs(np.mean([np.mean(x[lag:] * x[:-lag]) for x in seen])) < 5.0 / np.sqrt(9000)


def test_slow_motion_that_generic_terms_describe_is_no_noise(rng: np.random.Generator) -> None:
    """A wave is much larger than the noise, and has another size in each trial."""
    time = STEP_S * np.arange(2000)
    wave = np.sin(2 * np.pi * time / 4.0)
    trials = [trial(k, time, size * wave + 0.2 * rng.normal(size=2000)) for k, size in enumerate((3, 5, -2))]
    known, _ = estimated(trials, (wave,))
    assert level(known) == pytest.approx(0.2, rel=5.0 / np.sqrt(12_000))


@pytest.mark.parametrize("brief", [True, False])
def test_a_memory_that_is_long_compared_with_a_trial_may_be_a_gap(
    brief: bool, rng: np.random.Generator
) -> None:
    """The memory is a third of a trial of 20 s."""
    time = STEP_S * np.arange(1000)
    trials = [trial(k, time, 0.1 * rng.normal(size=1000) + slow(rng, time, 1.0, 7.0)) for k in range(6)]
    known, _ = estimated(trials, brief=brief)
    memory_s = known.forms["y"].time_s
    assert memory_s < 0.2 if brief else memory_s > 3.0


def repeats(number: int, time: np.ndarray, values: list[np.ndarray]) -> list[Trial]:
    """Return repeats of one setting."""
    each = [trial(number, time, y) for y in values]
    return [replace(one, id=f"{one.id}{letter}") for one, letter in zip(each, "abc", strict=False)]


@pytest.mark.parametrize("shift_s", [0.0, 0.4 * STEP_S])
def test_what_repeats_have_in_common_is_no_noise(shift_s: float, rng: np.random.Generator) -> None:
    """Each setting has a slow pattern of its own. The clocks of repeats may be apart by less than a step."""
    time = STEP_S * np.arange(600)
    trials = []
    for number in range(4):
        pattern = slow(rng, time, 1.0, 3.0)
        series = [pattern + 0.1 * rng.normal(size=600) for _ in range(3)]
        one = repeats(number, time, series)
        trials += [replace(t, time_s=time + k * shift_s / 2) for k, t in enumerate(one)]
    known, _ = estimated(trials, brief=False)
    assert known.forms["y"].ratio == 0.0
    assert level(known) == pytest.approx(0.1, rel=5.0 / np.sqrt(2 * 8 * 600))


def test_slow_noise_that_differs_between_repeats_is_noise(rng: np.random.Generator) -> None:
    """Its memory is a third of a trial, which may be a gap if no setting is repeated."""
    time = STEP_S * np.arange(1000)
    trials = []
    for number in range(4):
        series = [0.1 * rng.normal(size=1000) + slow(rng, time, 1.0, 7.0) for _ in range(2)]
        trials += repeats(number, time, series)
    known, _ = estimated(trials)
    assert known.forms["y"].time_s > 2.0


def test_repeated_rows_of_a_table_tell_their_noise(rng: np.random.Generator) -> None:
    """A model of zero misses a level of each setting that is ten times the noise."""
    levels = []
    for _ in range(20):
        trials = []
        for number in range(30):
            values = [np.array([10.0 * np.sin(number) + rng.normal()]) for _ in range(2)]
            trials += repeats(number, np.zeros(1), values)
        known, _ = estimated(trials)
        levels.append(level(known) ** 2)
    assert np.mean(levels) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (20 * 30)))


def test_a_copy_of_a_recording_is_no_repeat(rng: np.random.Generator) -> None:
    """The difference of a recording and its copy is zero, which is not its noise."""
    time = STEP_S * np.arange(400)
    trials = [trial(k, time, 0.1 * rng.normal(size=400)) for k in range(4)]
    known, _ = estimated([*trials, *(replace(t, id=f"{t.id} again") for t in trials)])
    assert level(known) == pytest.approx(0.1, rel=5.0 / np.sqrt(2 * 1600))


def test_few_repeats_do_not_tell_the_noise(rng: np.random.Generator) -> None:
    """Three trials of eight are repeats. Their slow pattern counts as noise, as that of all others does."""
    time = STEP_S * np.arange(1000)
    trials = [trial(k, time, 0.1 * rng.normal(size=1000) + slow(rng, time, 1.0, 7.0)) for k in range(7)]
    known, _ = estimated([*trials, replace(trials[0], id="again")], brief=False)
    assert known.forms["y"].time_s > 2.0


def test_own_parameters_of_each_trial_take_no_noise(rng: np.random.Generator) -> None:
    """Each trial has 24 samples and eight generic terms. They leave two thirds of the squares."""
    time = np.arange(24.0)
    terms = tuple(rng.normal(size=(8, 24)) * 10.0)
    levels = []
    for _ in range(40):
        known, _ = estimated([trial(k, time, rng.normal(size=24)) for k in range(6)], terms)
        levels.append(level(known) ** 2)
    assert np.mean(levels) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (40 * 6 * 16)))


def test_a_table_shares_its_generic_terms(rng: np.random.Generator) -> None:
    """A trial of one sample determines no term of its own."""
    x = np.linspace(-1.0, 1.0, 60)
    levels = []
    for _ in range(20):
        trials = [trial(k, np.zeros(1), np.array([0.5 * x[k] + rng.normal()])) for k in range(60)]
        study = with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), 1.0)
        terms = [[np.array([v**power]) for v in x] for power in (0, 1, 2, 3)]
        known = noise.estimate_measurement_noise(study, study.at((), np.empty(0)), terms, [])
        levels.append(level(known) ** 2)
    assert np.mean(levels) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (20 * 56)))


# ---------------------------------------------------------------- random effects


def tilted(rng: np.random.Generator, tilts: np.ndarray, sd: float = 0.05) -> GapStudy:
    """Return a study of a model that is zero, and of trials with given slopes."""
    time = np.linspace(0.0, 1.0, 100)
    trials = [trial(k, time, tilt * time + sd * rng.normal(size=100)) for k, tilt in enumerate(tilts)]
    return with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), sd)


def scattering(
    study: GapStudy, effects: list[Seen], acting: tuple[Seen, ...] = (), largest: float = noise.LARGEST_SD
) -> NoiseModel:
    """Return the noise with random effects of a study whose measurement noise is known."""
    problem = study.problem(acting)
    fit = study.fit(acting, [problem.start])
    possible = noise.list_random_candidates(study, fit, effects)
    return noise.with_random_effects(study, fit, study.noise, possible, largest=largest)


@pytest.mark.parametrize("sd", [0.05, 0.2, 0.4])
def test_a_random_effect_is_found_with_its_standard_deviation(sd: float, rng: np.random.Generator) -> None:
    study = tilted(rng, sd * rng.normal(size=40))
    known = scattering(study, [Tilt()])
    (found,) = known.random_effects
    assert found.name == "tilt"
    # 40 tilts determine a standard deviation to 11 %, and the steps of its values are a factor of 2
    assert sd / 1.9 < found.sd < 1.9 * sd
    random = study.with_noise(known)
    fit = random.fit((), [random.problem(()).start])
    for k, one in enumerate(study.trials):
        columns = fit.columns(k, random.random(fit.problem, k))
        np.testing.assert_allclose(columns[:, 0], one.time_s / 0.05, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_clean_trials_have_no_random_effect(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert scattering(tilted(rng, np.zeros(8)), [Tilt()]).random_effects == ()


def test_what_repeats_have_in_common_is_no_random_effect(rng: np.random.Generator) -> None:
    """The slope differs between settings, and much less between the repeats of one."""
    common, own = rng.normal(size=4), 0.05 * rng.normal(size=(4, 3))
    study = tilted(rng, (common[:, None] + own).ravel(), sd=0.02)
    trials = [replace(t, rig=study.trials[k // 3 * 3].rig) for k, t in enumerate(study.trials)]
    study = with_sd(study.copy_with(study.model, trials), 0.02)
    (found,) = scattering(study, [Tilt()]).random_effects
    assert found.sd in (0.02, 0.05, 0.1)


def test_repeats_of_unlike_length_and_with_gaps_are_compared_at_equal_times(rng: np.random.Generator) -> None:
    """Each setting has a slow pattern, and no quantity differs. A shift by one sample would leave a slope."""
    time = np.linspace(0.0, 1.0, 200)
    trials = []
    for number in range(5):
        pattern = 3.0 * np.sin(40.0 * time + number)
        for k in range(2):
            kept = np.arange(200) < 200 - 30 * k
            kept[40 + 10 * k : 50 + 10 * k] = False
            y = pattern + 0.02 * rng.normal(size=200)
            trials.append(replace(trial(number, time[kept], y[kept]), id=f"{number}{k}"))
    study = with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), 0.02)
    assert scattering(study, [Tilt()]).random_effects == ()


def test_of_two_similar_random_effects_one_is_found(rng: np.random.Generator) -> None:
    """It is the one that describes the trials."""
    other = Tilt()
    other.name, other.curve = "bend", lambda t: t**2
    study = tilted(rng, 0.3 * rng.normal(size=30))
    assert [e.name for e in scattering(study, [other, Tilt()]).random_effects] == ["tilt"]


@pytest.mark.parametrize(("common", "apart", "found"), [(0.4, 0.0, []), (0.4, 0.4, ["tilt"])])
def test_what_all_trials_share_is_no_random_effect(
    common: float, apart: float, found: list[str], rng: np.random.Generator
) -> None:
    """The model has the common tilt as an effect."""
    study = tilted(rng, common + apart * np.resize([-1.0, 1.0], 8))
    known = scattering(study, [Tilt()], (Seen("tilt", lambda t: t),))
    assert [e.name for e in known.random_effects] == found


@pytest.mark.parametrize("largest", [noise.BESIDE_GAP, noise.LARGEST_SD])
def test_a_random_effect_is_at_most_as_large_as_allowed(largest: float, rng: np.random.Generator) -> None:
    """The tilts are larger than either limit. A gap may remain in place of the larger random effect."""
    assert noise.BESIDE_GAP < noise.LARGEST_SD
    (found,) = scattering(tilted(rng, 2.0 * rng.normal(size=8)), [Tilt()], largest=largest).random_effects
    assert found.sd == largest


def test_the_random_effects_of_earlier_noise_do_not_count(rng: np.random.Generator) -> None:
    study = tilted(rng, 0.3 * rng.normal(size=8))
    known = scattering(study, [Tilt()])
    again = scattering(study.with_noise(known), [Tilt()])
    assert again.random_effects == known.random_effects


def test_two_trials_have_no_random_effect(rng: np.random.Generator) -> None:
    assert scattering(tilted(rng, np.array([-1.0, 1.0])), [Tilt()]).random_effects == ()


def test_only_effects_that_scatter_are_random(rng: np.random.Generator) -> None:
    study = tilted(rng, 0.3 * rng.normal(size=8))
    assert scattering(study, [Seen("tilt", lambda t: t)]).random_effects == ()


def test_random_effects_are_no_part_of_the_noise_floor(rng: np.random.Generator) -> None:
    """The value of each trial takes up one sample of a hundred."""
    study = tilted(rng, 0.4 * rng.normal(size=200))
    assert noise.with_floors(study, study.at((), np.empty(0))).floor("y") == pytest.approx(1.0)
    study = study.with_noise(scattering(study, [Tilt()]))
    fit = study.at((), study.problem(()).start)
    assert noise.with_floors(study, fit).floor("y") == pytest.approx(np.sqrt(0.99), rel=1e-6)


def test_the_noise_floor_is_what_a_fit_of_the_initial_state_leaves(rng: np.random.Generator) -> None:
    """The initial state of a trial takes up slow noise, and one of sixty independent samples."""

    def start(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.ones_like(t)}

    own, time = (parameter("start", 0.0, per_trial=True),), np.arange(60.0)
    for form in (NoiseForm(), NoiseForm(50.0, 300.0)):
        left = []
        for _ in range(300):
            y = rng.normal(size=60) + slow(rng, time, np.sqrt(form.ratio), max(form.time_s, 1.0))
            left.append(np.mean((y - y.mean()) ** 2))
        study = GapStudy(Hooked(start, own, ("y",)), own, [trial(0, time, y)], {})
        study = study.with_noise(replace(noise_of(study.shape, 1.0), forms={"y": form}))
        floor = noise.with_floors(study, study.at((), study.shape.start)).floor("y")
        error = 5.0 * np.std(left) / np.sqrt(len(left))
        assert floor**2 == pytest.approx(np.mean(left), abs=error)


def test_a_fit_with_random_effects_is_that_of_their_marginal_covariance(rng: np.random.Generator) -> None:
    """Fit and products of the folds equal those of generalised least squares."""
    given = line_study(rng)
    sd, slopes = 0.3, [np.r_[t.time_s, np.zeros(len(t.time_s))] for t in given.trials]
    known = replace(noise_of(given.shape, 0.5), random_effects=(differing(Tilt(), sd),))
    study = given.with_noise(known)
    fit = study.fit((), [study.problem(()).start])
    folded = crossval.form_normal_equations(study, fit)
    theta = np.array([fit.value("a"), fit.value("b")])
    normal, right = np.diag([25.0, 0.0]), np.array([25.0 * 0.8, 0.0])
    for k, one in enumerate(study.trials):
        t, n = one.time_s, len(one.time_s)
        shared = np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones(n)]])
        start = np.r_[np.ones(n), np.zeros(n)]
        covariance = 0.25 * np.eye(2 * n) + sd**2 * np.outer(slopes[k], slopes[k])
        inverse = np.linalg.inv(covariance + START_PRIOR**2 * np.outer(start, start))
        y = np.r_[one.measured["y"], one.measured["v"]]
        normal = normal + shared.T @ inverse @ shared
        right = right + shared.T @ inverse @ y
        if k > 1:
            both = np.column_stack((shared, y - shared @ theta))
            np.testing.assert_allclose(folded.products[k - 1], both.T @ inverse @ both, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(theta, np.linalg.solve(normal, right), atol=1e-4)
    (whole, _) = crossval.compute_covariances(folded)
    np.testing.assert_allclose(whole, np.linalg.inv(normal), rtol=1e-3)


def test_a_random_effect_may_have_the_mean_zero(rng: np.random.Generator) -> None:
    """Fits to all folds, and to all but one, equal those of least squares with this constraint."""
    given = line_study(rng)
    sd = 0.3
    one = replace(differing(Tilt(), sd), is_centred=True)
    study = given.with_noise(replace(noise_of(given.shape, 0.5), random_effects=(one,)))
    fit = study.fit((), [study.problem(()).start], tolerance=1e-10)
    whole, rest = crossval.compute_covariances(crossval.form_normal_equations(study, fit))
    without = study.refit_folds(fit)
    place = [fit.labels.index(name) for name in ("a", "b")]
    for left_out in (None, *range(study.folds.count)):
        kept = [t for t, f in zip(study.trials, study.folds.owner, strict=True) if f[0] != left_out]
        rows, target = [np.array([[5.0, *[0.0] * (1 + 2 * len(kept))]])], [[5.0 * 0.8]]
        for k, each in enumerate(kept):
            t, n = each.time_s, len(each.time_s)
            part = np.zeros((2 * n + 2, 2 + 2 * len(kept)))
            part[:n, 0], part[n:-2, 0] = np.sin(t), np.cos(t)
            part[:n, 1], part[n:-2, 1] = t, 1.0
            part[:n, 2 + 2 * k] = 1.0
            part[:n, 3 + 2 * k] = t
            part[:-2] /= 0.5
            part[-2, 2 + 2 * k], part[-1, 3 + 2 * k] = 1.0 / START_PRIOR, 1.0 / sd
            rows.append(part)
            target.append([*(np.r_[each.measured["y"], each.measured["v"]] / 0.5), 0.0, 0.0])
        rows.append(1e4 * np.r_[0.0, 0.0, np.tile([0.0, 1.0], len(kept))][None])
        target.append([0.0])
        system = np.concatenate(rows)
        expected = np.linalg.lstsq(system, np.concatenate(target))[0][:2]
        covariance = np.linalg.inv(system.T @ system)[:2, :2]
        theta, found = (fit.theta, whole) if left_out is None else (without[left_out], rest[left_out])
        np.testing.assert_allclose(found, covariance, rtol=2e-3)
        np.testing.assert_allclose(theta[place], expected, atol=0.02 * np.sqrt(covariance[0, 0]))
