"""Folds of a diagnosis, and what follows from the normal equations of a fit in each of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special
from scipy.stats import multivariate_normal

from swimid.diagnosis import crossval, settings
from swimid.diagnosis.crossval import NormalEquations
from swimid.diagnosis.study import START_PRIOR, GapStudy, Hypothesis
from swimid.fitting.model import RigInput, Trial
from tests.diagnosis_models import (
    PLAIN,
    Apart,
    Hooked,
    Seen,
    line_study,
    noise_of,
    plainly,
    rise,
    seen_trials,
    trial,
    with_sd,
)
from tests.toy_models import Toy, parameter


def plain(k: int, *, force: float) -> Trial:
    """Return a trial without measured samples."""
    return Trial(f"t{k}", "fit", np.arange(5.0), {}, rig=RigInput(force=force))


@pytest.fixture
def study(rng: np.random.Generator) -> GapStudy:
    """Return a linear model with two coefficients, and five trials that each have a start value."""
    return line_study(rng)


# ---------------------------------------------------------------- folds


def test_repeats_stay_together() -> None:
    trials = [plain(k, force=f) for k, f in enumerate((1.0, 2.0, 1.0, 3.0, 4.0))]
    found = settings.divide_folds(trials, [np.arange(float(n)) for n in (7, 3, 5, 2, 4)])
    assert found.whole
    assert found.count == 4
    assert [len(o) for o in found.owner] == [7, 3, 5, 2, 4]
    assert [set(o.tolist()) for o in found.owner] == [{0}, {1}, {0}, {2}, {3}]


def test_few_trials_are_divided_into_stretches() -> None:
    """Two trials give four segments each. A missing sample does not move other samples to another segment."""
    trials = [plain(0, force=1.0), plain(1, force=2.0)]
    times = [np.linspace(0.0, 8.0, 81), np.linspace(0.0, 8.0, 81)[40:]]
    stacked = np.concatenate(times)
    found = settings.divide_folds(trials, [stacked, stacked])
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
    found = settings.divide_folds([plain(k, force=float(k)) for k in range(25)], [np.zeros(1)] * 25)
    assert found.count == settings.TABLE_FOLDS
    counts = np.bincount(np.concatenate(found.owner), minlength=found.count)
    assert counts.sum() == 25
    assert set(counts.tolist()) == {2, 3}


# ---------------------------------------------------------------- held-out residuals


@pytest.fixture
def blocks(rng: np.random.Generator) -> list[np.ndarray]:
    """Return the columns of four folds: three shared parameters, two further columns, the residual."""
    return [rng.normal(size=(n, 6)) for n in (12, 9, 15, 8)]


PRIOR, PULL = np.array([0.0, 4.0, 0.25]), np.array([0.0, 0.3, -0.7])


def folded(blocks: list[np.ndarray]) -> NormalEquations:
    """Return the normal equations of given columns. The last shared parameter belongs to an effect."""
    return NormalEquations(
        products=np.array([b.T @ b for b in blocks]),
        prior=np.diag(PRIOR),
        pull=PULL,
        samples=np.array([float(len(b)) for b in blocks]),
        own=np.zeros(len(blocks)),
        of_effects=np.array([False, False, True]),
        random=np.zeros((len(blocks), 0, blocks[0].shape[1])),
        spread=np.zeros((len(blocks), 0, 0)),
    )


def refit(blocks: list[np.ndarray], at: list[int], weights: np.ndarray) -> np.ndarray:
    """Return the least-squares solution of rows and priors in one system."""
    root, pull = np.sqrt(weights), np.concatenate((PULL, np.zeros(len(at) - 3)))
    rows = np.concatenate([*(b[:, at] for b in blocks), np.diag(root)])
    target = np.concatenate([*(b[:, -1] for b in blocks), root * pull])
    return np.linalg.lstsq(rows, target)[0]


@pytest.mark.parametrize("chosen, weights", [((), ()), ((0,), (0.5,)), ((1, 0), (0.5, 2.0))])
def test_held_out_residuals_equal_those_of_a_refit_without_the_fold(
    blocks: list[np.ndarray], chosen: tuple[int, ...], weights: tuple[float, ...]
) -> None:
    """The information of the full fit on the shared parameters counts as prior, by a known fraction."""
    at = [0, 1, 2, *(3 + c for c in chosen)]
    found = crossval.compute_held_out(folded(blocks), chosen, weights)
    prior = np.concatenate((PRIOR, weights))
    whole = refit(blocks, at, prior)
    shared = np.concatenate(blocks)[:, :3] * np.sqrt(crossval.SHRINKAGE)
    known = np.column_stack((shared, np.zeros((len(shared), 2)), shared @ whole[:3]))
    for f, block in enumerate(blocks):
        theta = refit([*blocks[:f], *blocks[f + 1 :], known], at, prior)
        strain = float(PRIOR @ (theta[:3] - PULL) ** 2) / len(blocks)
        misfit = float(np.sum((block[:, -1] - block[:, at] @ theta) ** 2))
        assert found[f] == pytest.approx(misfit + strain, rel=1e-8)
    np.testing.assert_allclose(crossval.fit_columns(folded(blocks), chosen, weights), whole, rtol=1e-8)


def test_projection_removes_what_shared_parameters_imitate(blocks: list[np.ndarray]) -> None:
    rows = np.concatenate([*(b for b in blocks), np.zeros((3, 6))])
    rows[-3:, :3] = np.diag(np.sqrt(PRIOR))
    rest = rows[:, 3:] - rows[:, :3] @ np.linalg.lstsq(rows[:, :3], rows[:, 3:])[0]
    np.testing.assert_allclose(crossval.project_columns(folded(blocks)), rest.T @ rest, rtol=1e-7, atol=1e-8)


def test_noise_draws_have_the_covariance_of_the_columns(
    blocks: list[np.ndarray], rng: np.random.Generator
) -> None:
    drawn = crossval.draw_noise(folded(blocks), rng, 40_000)
    np.testing.assert_allclose(drawn.pull.std(axis=1), [0.0, 0.5, 2.0], rtol=0.03)
    for f, block in enumerate(blocks):
        covariance = drawn.right[f] @ drawn.right[f].T / 40_000
        exact = block[:, :-1].T @ block[:, :-1]
        scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
        np.testing.assert_allclose(covariance / scale, exact / scale, atol=0.03)


def test_a_held_out_fold_takes_no_part_in_the_refit(rng: np.random.Generator) -> None:
    """The model is so nonlinear that one step from the fit to all folds would be far off."""

    def decaying(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.exp(-values[1] * t)}

    coefficients = (parameter("a", 1.0), parameter("rate", 1.0, lower=0.0, upper=3.0))
    trials, t = [], np.linspace(0.0, 3.0, 60)
    for k in range(5):
        y = np.exp(-(2.5 if k == 0 else 0.4) * t) * (3.0 if k == 0 else 0.3) + 0.01 * rng.normal(size=len(t))
        trials.append(trial(k, t, y))

    def fitted(fit_trials: list[Trial]) -> tuple[GapStudy, Hypothesis]:
        found = with_sd(GapStudy(Toy(decaying, coefficients), coefficients, fit_trials, {}), 0.01)
        return found, found.fit((), [np.array([1.0, 1.0])], tolerance=1e-8)

    study, fit = fitted(trials)
    for k, theta in enumerate(study.refit_folds(fit)):
        _, rest = fitted([one for one in trials if one is not trials[k]])
        np.testing.assert_allclose(theta, rest.theta, rtol=0.03)


# ---------------------------------------------------------------- predictive density


@pytest.mark.parametrize("apart", [False, True])
def test_deviances_equal_the_log_predictive_density_of_a_linear_gaussian_model(
    apart: bool, rng: np.random.Generator
) -> None:
    """Each trial follows from the other ones by the rule of conditional densities.

    The model has a coefficient with a prior, and an effect with a shared size or with sizes of its own in
    each trial.
    """
    trials = seen_trials(rng, 0.3, 0.0)
    study = GapStudy(Hooked(plainly, PLAIN, ("y",)), PLAIN, trials, {"a": (0.8, 0.2)})
    study = study.with_noise(noise_of(study.shape, 0.02))
    effect = (Apart if apart else Seen)("rise", rise)
    problem = study.problem((effect,))
    fit = study.fit((effect,), [problem.start], tolerance=1e-12)
    distance, log_determinant = crossval.compute_deviances(crossval.form_normal_equations(study, fit))
    assert study.folds.count == 6
    # covariance of all samples without knowledge of the parameters; EFFECT_PRIOR is 5 typical scales
    whole = [np.concatenate([c(t.time_s) for t in trials]) for c in (lambda t: np.exp(-t), rise)]
    owner = np.repeat(np.arange(6), 200)
    covariance = 0.02**2 * np.eye(1200) + 0.2**2 * np.outer(whole[0], whole[0])
    together = np.equal.outer(owner, owner) if apart else True
    covariance += np.where(together, 25.0 * np.outer(whole[1], whole[1]), 0.0)
    y = np.concatenate([t.measured["y"] for t in trials])
    mean = 0.8 * whole[0]
    found = distance + log_determinant
    expected = []
    for f in range(6):
        rest = multivariate_normal(mean[owner != f], covariance[np.ix_(owner != f, owner != f)])
        expected.append(-2.0 * (multivariate_normal(mean, covariance).logpdf(y) - rest.logpdf(y[owner != f])))
    # up to the normalisation of noise alone
    noise = 200 * np.log(2 * np.pi * 0.02**2)
    np.testing.assert_allclose(found, np.array(expected) - noise, atol=2e-2)


def test_the_strain_is_the_distance_of_the_model_s_parameters_from_their_prior_means(
    blocks: list[np.ndarray],
) -> None:
    """The size of an effect does not count."""
    away = refit(blocks, [0, 1, 2], PRIOR) - PULL
    assert crossval.compute_strain(folded(blocks)) == pytest.approx(float(PRIOR[1] * away[1] ** 2), rel=1e-8)


# ---------------------------------------------------------------- standard errors


def test_a_linear_fit_is_least_squares(study: GapStudy) -> None:
    """The covariance is that of least squares, but larger if the trials disagree more than by noise."""
    fit = study.fit((), [study.problem(()).start])
    rows, target = [], []
    for k, one in enumerate(study.trials):
        t, n = one.time_s, len(one.time_s)
        own = np.zeros((2 * n, 5))
        own[:n, k] = 1.0
        rows.append(np.column_stack([np.r_[np.sin(t), np.cos(t)], np.r_[t, np.ones(n)], own]))
        target.append(np.r_[one.measured["y"], one.measured["v"]])
    # one coefficient has a prior of 0.2, and the start states have thirty times their typical scale
    prior = np.vstack([[5.0, *[0.0] * 6], np.eye(7)[2:] / START_PRIOR])
    system = np.vstack([*rows, prior])
    exact = np.linalg.lstsq(system, np.concatenate([*target, [5.0 * 0.8], np.zeros(5)]))[0]
    np.testing.assert_allclose(fit.theta, exact, atol=1e-4)
    # the noise is a twentieth of the assumed one, so that the trials agree very well
    found, exact = crossval.compute_covariance(study, fit), np.linalg.inv(system.T @ system)
    np.testing.assert_allclose(found, exact, atol=1e-4 * exact.diagonal().min())


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_standard_errors_are_at_least_those_of_the_jackknife(
    scatter: float, rng: np.random.Generator
) -> None:
    """The coefficient differs between trials by more than the noise explains."""
    t = np.linspace(0.0, 3.0, 100)
    trials = [
        trial(k, t, (1.0 + scatter * rng.normal()) * np.exp(-t) + 0.02 * rng.normal(size=100))
        for k in range(6)
    ]
    study = with_sd(GapStudy(Hooked(plainly, PLAIN, ("y",)), PLAIN, trials, {}), 0.02)
    fit = study.fit((), [study.problem(()).start])
    stderr = float(np.sqrt(crossval.compute_covariance(study, fit)[0, 0]))
    by_noise = 0.02 / np.sqrt(6 * np.sum(np.exp(-2.0 * t)))
    steps = np.array([theta[0] for theta in study.refit_folds(fit)]) - fit.theta[0]
    few = special.stdtrit(5, 0.975) / special.ndtri(0.975)
    jackknife = few * np.sqrt(5.0 / 6.0 * np.sum(steps**2))
    assert stderr == pytest.approx(max(by_noise, jackknife), rel=0.02)
    assert (stderr > 5.0 * by_noise) == (scatter > 0.0)


def test_correlated_priors_constrain_the_ratio_of_coefficients(study: GapStudy) -> None:
    """Two coefficients are known to 0.2 and 0.5, and their weighted difference to a tenth of that."""
    known = GapStudy(
        study.model, study.parameters, study.trials, {"a": (0.8, 0.2), "b": (0.3, 0.5)},
        correlation=(["b", "a"], np.array([[1.0, 0.98], [0.98, 1.0]])),
    )  # fmt: skip
    precision = known.precision(known.problem(()))
    sd = np.array([0.2, 0.5])
    expected = np.linalg.inv(np.outer(sd, sd) * np.array([[1.0, 0.98], [0.98, 1.0]]))
    np.testing.assert_allclose(precision[:2, :2], expected, rtol=1e-3)
    np.testing.assert_allclose(precision[2:, 2:], np.eye(5) / START_PRIOR**2)
