"""Squared errors of held-out data, and those that a correct model would have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from swimid.diagnosis import held_out, noise, places
from swimid.diagnosis.held_out import Prediction
from swimid.diagnosis.posterior import CALIBRATED
from swimid.diagnosis.study import GapStudy
from swimid.fitting.model import RigInput, Trial
from swimid.fitting.noise import NoiseForm
from tests.diagnosis_models import (
    PLAIN,
    Apart,
    Hooked,
    Seen,
    differing,
    noise_of,
    nothing,
    plain_study,
    plainly,
    ring,
    rise,
    seen_trials,
    trial,
    with_sd,
)
from tests.toy_models import Toy, parameter

DECAY = (*PLAIN, parameter("start", 0.0, per_trial=True))


def decaying(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return a decay with an offset of each trial."""
    return {"y": values[0] * np.exp(-t) + values[1]}


def predicted(
    study: GapStudy, effects: Sequence[Seen] = (), validation: Sequence[Trial] = ()
) -> list[Prediction]:
    """Return the held-out predictions of the model with effects."""
    fit = study.fit(effects, [study.problem(effects).start])
    known = noise.with_floors(study, fit)
    (found,) = held_out.predict_parts([fit], validation, known)
    return found


def slow(rng: np.random.Generator, n: int, form: NoiseForm, step_s: float) -> np.ndarray:
    """Return noise of a form with independent samples of unit variance."""
    kept = np.exp(-step_s / form.time_s) if form.time_s else 0.0
    value, values = rng.normal(), np.empty(n)
    for i in range(n):
        values[i] = value
        value = kept * value + np.sqrt(1.0 - kept**2) * rng.normal()
    return rng.normal(size=n) + np.sqrt(form.ratio) * values


# ---------------------------------------------------------------- expected errors of a correct model


@pytest.mark.parametrize("held", ["validation", "folds"])
@pytest.mark.parametrize("form", [NoiseForm(), NoiseForm(4.0, 0.3)])
def test_a_correct_linear_model_has_the_expected_squared_error(
    held: str, form: NoiseForm, rng: np.random.Generator
) -> None:
    """The trials are few and short, so that coefficients and start values take up much of the noise.

    The mean ratio of squared errors to their expectation is 1 within five standard errors.
    """
    time, ratios, normal = 0.1 * np.arange(12.0), [], []
    for _ in range(60):
        trials = [
            trial(k, time, 2.0 * np.exp(-time) + rng.normal() + 0.1 * slow(rng, 12, form, 0.1))
            for k in range(6)
        ]
        last = replace(trials[-1], role="validate")
        trials = trials if held == "folds" else trials[:-1]
        study = GapStudy(Toy(decaying, DECAY), DECAY, trials, {})
        study = study.with_noise(replace(noise_of(study.shape, 0.1), forms={"y": form}))
        found = predicted(study, (), [last] if held == "validation" else ())
        found = [p for p in found if (p.trial.role == "validate") == (held == "validation")]
        assert found
        for p in found:
            ratios.append(p.squared / p.expected)
            normal.append((p.squared - p.expected) / np.sqrt(2.0 * p.expected))
    error = np.std(ratios) / np.sqrt(60)
    assert np.mean(ratios) == pytest.approx(1.0, abs=max(5.0 * error, 0.05))
    # the errors of the parts scatter as stated, or less
    assert np.std(normal) < 1.0 + 5.0 / np.sqrt(2.0 * len(normal))
    assert np.mean([abs(v) > 4.0 for v in normal]) < 0.02


@pytest.mark.parametrize("held", ["validation", "folds"])
@pytest.mark.parametrize("form", [NoiseForm(), NoiseForm(4.0, 0.3)])
def test_the_deviance_of_a_held_out_trial_is_that_of_its_gaussian_prediction(
    held: str, form: NoiseForm, rng: np.random.Generator
) -> None:
    """The offset of the trial is unknown, and the coefficient is known from the other trials."""
    time = np.linspace(0.0, 2.0, 40)
    trials = [
        trial(k, time, 2.0 * np.exp(-time) + rng.normal() + 0.1 * slow(rng, 40, form, time[1]))
        for k in range(5)
    ]
    last, fitted = replace(trials[-1], role="validate"), trials if held == "folds" else trials[:-1]
    study = GapStudy(Toy(decaying, DECAY), DECAY, fitted, {})
    study = study.with_noise(replace(noise_of(study.shape, 0.1), forms={"y": form}))
    found = predicted(study, (), [last] if held == "validation" else ())[-1]
    assert found.part == "t4"
    lag = np.abs(np.subtract.outer(time, time))
    covariance = 0.01 * (np.eye(40) + form.ratio * np.exp(-lag / max(form.time_s, 1e-9)) * (form.ratio > 0.0))
    # an orthonormal basis of what an offset does not change
    free = np.linalg.qr(np.column_stack((np.ones(40), rng.normal(size=(40, 39)))))[0][:, 1:].T
    known, column = free @ covariance @ free.T, free @ np.exp(-time)
    ys = [free @ one.measured["y"] for one in trials]
    information = column @ np.linalg.solve(known, column)
    a = sum(column @ np.linalg.solve(known, y) for y in ys[:-1]) / (4.0 * information)
    whole, error = known + np.outer(column, column) / (4.0 * information), ys[-1] - a * column
    sizes = [np.linalg.slogdet(one)[1] for one in (whole, known)]
    expected = error @ np.linalg.solve(whole, error) + sizes[0] - sizes[1]
    assert found.deviance == pytest.approx(expected, abs=0.05)


def test_a_trial_pays_for_its_random_values(rng: np.random.Generator) -> None:
    """The model lacks a ring that all trials share. Its own values of the ring are five deviations off."""
    time, form = np.linspace(0.0, 3.0, 50), Seen("ring", ring)
    trials = [trial(k, time, np.exp(-time) + ring(time) + 0.1 * rng.normal(size=50)) for k in range(7)]
    last = replace(trials[-1], role="validate", id="last")
    study = plain_study(trials[:-1], 0.1)
    known = replace(study.noise, random_effects=(differing(form, 0.2),))
    study = study.with_noise(known)
    fits = [study.fit(effects, [study.problem(effects).start]) for effects in ((), (form,))]
    before, after = held_out.predict_parts(fits, [last], known)
    for one, other in zip(before, after, strict=True):
        assert other.squared < other.limit(7)
        assert one.squared - other.squared > 10.0
        # the residuals have the ring that is missing in all trials, and then noise
        assert np.nanstd(one.residuals["y"]) > 0.5
        assert np.nanstd(other.residuals["y"]) == pytest.approx(0.1, rel=0.35)


@pytest.mark.parametrize("count", [4, 12])
def test_few_correct_models_exceed_the_limit(count: int, rng: np.random.Generator) -> None:
    """One part of all of them exceeds its limit in at most one of forty experiments."""
    time, above = np.linspace(0.0, 3.0, 60), 0
    for _ in range(80):
        trials = [trial(k, time, np.exp(-time) + 0.1 * rng.normal(size=60)) for k in range(count)]
        found = predicted(plain_study(trials, 0.1))
        above += any(p.squared > p.limit(count) for p in found)
    # binomial: five standard deviations above two of 80
    assert above <= 2 + 5 * np.sqrt(2)


def test_random_effects_are_expected_in_held_out_trials(rng: np.random.Generator) -> None:
    """The ring has a random size in each trial, of which the noise model knows the standard deviation."""
    time, ratios = np.linspace(0.0, 3.0, 50), {"validate": [], "fit": []}
    for _ in range(100):
        trials = [
            trial(k, time, np.exp(-time) + 0.2 * rng.normal() * ring(time) + 0.1 * rng.normal(size=50))
            for k in range(7)
        ]
        last = replace(trials[-1], role="validate", id="last")
        study = plain_study(trials[:-1], 0.1)
        known = replace(noise_of(study.shape, 0.1), random_effects=(differing(Seen("ring", ring), 0.2),))
        for p in predicted(study.with_noise(known), (), [last]):
            ratios[p.trial.role].append(p.squared / p.expected)
    for found in ratios.values():
        error = np.std(found) / np.sqrt(100)
        assert np.mean(found) == pytest.approx(1.0, abs=5.0 * error)


@pytest.mark.parametrize("held", ["validation", "folds"])
def test_errors_within_the_uncertainty_of_coefficients_refute_no_model(
    held: str, rng: np.random.Generator
) -> None:
    """A slope known from one second predicts minutes badly, but no slope explains a step there."""
    near, far = np.linspace(0.0, 1.0, 50), np.linspace(100.0, 200.0, 50)

    def measured(time: np.ndarray, step: float = 0.0) -> dict[str, np.ndarray]:
        return {"y": 2.0 * time + step * (time > time.mean()) + rng.normal(size=len(time))}

    def last(step: float) -> Prediction:
        known = [Trial(f"t{k}", "fit", near, measured(near), rig=RigInput(force=float(k))) for k in range(4)]
        far_trial = Trial("far", "validate", far, measured(far, step))
        if held == "folds":
            known.append(replace(far_trial, role="fit"))
        slope = (parameter("slope", 0.0),)
        study = with_sd(GapStudy(Toy(lambda v, t: {"y": v[0] * t}, slope, ("y",)), slope, known, {}), 1.0)
        found = predicted(study, (), [far_trial] if held == "validation" else ())
        return next(p for p in found if p.part == "far")

    assert last(0.0).squared <= last(0.0).limit(5)
    # far from the slope's expected error of a hundred times the noise
    assert last(2000.0).squared > last(2000.0).limit(5)


def test_per_trial_values_say_nothing_about_a_held_out_trial() -> None:
    """Each trial has a curve of its own size. A held-out trial of another size is not mispredicted."""
    time = np.linspace(0.0, 6.0, 200)

    def last(more: float) -> Prediction:
        rng = np.random.default_rng(5)
        first, second, held = (
            trial(k, time, np.exp(-time) + k * ring(time) + 0.1 * rng.normal(size=200)) for k in (1, -2, 3)
        )
        held.measured["y"] += more * np.cos(7.0 * time)
        found = predicted(plain_study([first, second], 0.1), (Apart("ring", ring),), [held])
        return next(p for p in found if p.part == "t3")

    assert last(0.0).squared == pytest.approx(200.0, abs=5.0 * np.sqrt(400.0))
    assert last(0.0).squared < last(0.0).limit(3)
    assert last(1.0).squared > 200.0 + 0.5 * 200.0 * 0.5 / 0.1**2
    assert last(1.0).squared > last(1.0).limit(3)


@pytest.mark.parametrize(("more", "off"), [(0.0, False), (0.3, True)])
def test_a_validation_trial_beyond_the_noise_is_above_its_limit(
    more: float, off: bool, rng: np.random.Generator
) -> None:
    time = np.linspace(0.0, 6.0, 200)

    def made(name: str, added: float) -> Trial:
        y = 2.0 * np.exp(-time) + added * ring(time) + 0.1 * rng.normal(size=200)
        return Trial(name, "fit", time, {"y": y})

    study = plain_study([made(f"t{k}", 0.0) for k in range(4)], 0.1)
    held = [made("as-ever", 0.0), made("other", more)]
    found = predicted(study, (), held)[-2:]
    assert [p.squared > p.limit(6) for p in found] == [False, off]
    # squares of a sine of amplitude 0.3 and of the noise, divided by the noise
    expected = 1.0 + 0.5 * (more / 0.1) ** 2
    assert found[1].squared / found[1].expected == pytest.approx(expected, rel=0.3)


def test_the_parts_of_few_trials_are_named(rng: np.random.Generator) -> None:
    time = np.linspace(0.0, 3.0, 80)
    trials = [trial(k, time, np.exp(-time) + 0.1 * rng.normal(size=80)) for k in range(2)]
    found = predicted(plain_study(trials, 0.1))
    assert [p.part for p in found] == [f"t{k}, part {n}" for k in range(2) for n in range(1, 5)]
    assert sum(p.samples for p in found) == 160


def test_validation_trials_are_held_out_beside_the_folds(rng: np.random.Generator) -> None:
    time = np.linspace(0.0, 3.0, 80)
    trials = [trial(k, time, np.exp(-time) + 0.1 * rng.normal(size=80)) for k in range(5)]
    found = predicted(plain_study(trials[:4], 0.1), (), trials[4:])
    assert [p.part for p in found] == [f"t{k}" for k in range(5)]


def test_the_model_as_given_keeps_its_shared_parameters(rng: np.random.Generator) -> None:
    """Only the start values are fitted. The true coefficient is 2, and the given one is 0.5."""
    time = np.linspace(0.0, 3.0, 80)
    trials = [trial(k, time, 2.0 * np.exp(-time) + k + 0.1 * rng.normal(size=80)) for k in range(5)]
    study = with_sd(GapStudy(Toy(decaying, DECAY), DECAY, trials, {}), 0.1)
    given = held_out.fit_as_given(study)
    assert given.value("a") == 0.5
    refitted = study.fit((), [study.problem(()).start])
    before, after = held_out.predict_parts([given, refitted], [], study.noise)
    for k, (b, a) in enumerate(zip(before, after, strict=True)):
        left = trials[k].measured["y"] - 0.5 * np.exp(-time)
        assert b.squared == pytest.approx(np.sum((left - left.mean()) ** 2) / 0.1**2, rel=0.01)
        assert b.squared > 10.0 * a.squared


# ---------------------------------------------------------------- tables of the answer


def made(
    squared: float,
    *,
    part: str = "t0",
    expected: int = 200,
    channel: str = "x_m",
    size: float = 0.01,
    deviance: float = 0.0,
) -> Prediction:
    """Return a prediction of 200 samples with a given squared error of one channel."""
    time = np.arange(200) / 20
    error = size * np.sqrt(squared / 200) * np.where(np.arange(200) % 2, 1.0, -1.0)
    whole = Trial(part.split(",")[0], "fit", time, {channel: np.sin(time)})
    return Prediction(whole, part, {channel: error}, squared, expected, 200, deviance)


def test_the_limit_is_a_quantile_of_chi_squared() -> None:
    """It is that of 200 degrees of freedom for one of 40, a hundredth of the noise, and a discrepancy."""
    limit = made(200.0).limit(1)
    assert limit == pytest.approx(241.06 + 2.0 + CALIBRATED.directions, abs=0.1)
    assert limit < made(200.0).limit(10)


@pytest.mark.parametrize(
    ("before", "after", "share"), [(9.0, 1.0, 1.0), (9.0, 4.0, 5 / 8), (9.0, 16.0, -7 / 8), (9.0, 0.8, 1.0)]
)
def test_the_closed_share_of_a_squared_gap(before: float, after: float, share: float) -> None:
    assert held_out.compute_closed_share(before, after, 1.0) == pytest.approx(share)


def test_errors_of_noise_have_no_closed_share() -> None:
    assert held_out.compute_closed_share(1.0, 0.5, 1.0) is None
    assert held_out.compute_closed_share(1.03, 0.5, 1.0) is None


def test_samples_without_noise_have_no_prediction(rng: np.random.Generator) -> None:
    """A validation trial has a channel that the fitted trials do not have."""
    time = np.linspace(0.0, 3.0, 50)

    def both(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"y": values[0] * np.exp(-t), "v": values[0] * t}

    trials = [trial(k, time, np.exp(-time) + 0.1 * rng.normal(size=50)) for k in range(4)]
    last = Trial("last", "validate", time, {"y": trials[0].measured["y"], "v": 5.0 * time})
    study = with_sd(GapStudy(Toy(both, PLAIN, ("y", "v")), PLAIN, trials, {}), 0.1)
    found = predicted(study, (), [last])[-1]
    assert found.samples == 50
    assert list(found.residuals) == ["y"]


@pytest.mark.parametrize("known", [0.01, 0.2])
def test_the_closed_share_has_the_true_motion_as_its_end(known: float, rng: np.random.Generator) -> None:
    """The share and its interval are compared with the motion that made the trials, which has no noise."""
    time, form, inside, errors = np.linspace(0.0, 5.0, 60), Seen("ring", ring), [], []
    for _ in range(60):
        size = 0.3
        trials = [
            trial(k, time, np.exp(-time) + own * ring(time) + 0.05 * rng.normal(size=60))
            for k, own in enumerate(size + 0.1 * rng.normal(size=6))
        ]
        given = 1.0 + known * rng.normal()
        parameters = (replace(PLAIN[0], start=given),)
        study = GapStudy(Hooked(plainly, parameters, ("y",)), parameters, trials, {"a": (given, known)})
        noisy = replace(noise_of(study.shape, 0.05), random_effects=(differing(form, 0.1),))
        study = study.with_noise(noisy)
        fits = [held_out.fit_as_given(study)]
        fits += [study.fit(effects, [study.problem(effects).start]) for effects in ((), (form,))]
        floors = noise.with_floors(study, fits[-1])
        closed = held_out.compute_closed(*fits, [], floors, held_out.predict_parts(fits, [], floors))
        before = (given - 1.0) * np.exp(-time) - size * ring(time)
        found = fits[-1]
        after = (found.value("a") - 1.0) * np.exp(-time) + (found.value("ring/size") - size) * ring(time)
        true = 1.0 - np.sum(after**2) / np.sum(before**2)
        low, high = closed.ci95
        if low is not None:
            inside.append(low <= true <= high)
        errors.append(closed.share - true)
    assert len(inside) > 40
    # binomial: five standard deviations below 95 %
    assert np.mean(inside) > 0.95 - 5.0 * np.sqrt(0.05 * 0.95 / len(inside))
    assert abs(np.mean(errors)) < 5.0 * np.std(errors) / np.sqrt(60)


def test_the_worst_held_out_trial_has_the_largest_ratio() -> None:
    """Its parts are joined in the order of time."""
    first, second = np.arange(200) < 100, np.arange(200) >= 100
    before, after = [], []
    for name, squared in (("t0", 900.0), ("t1", 1800.0)):
        for chosen, part in ((first, "part 1"), (second, "part 2")):
            for value, found in ((4.0 * squared, before), (squared, after)):
                one = made(value, part=f"{name}, {part}", expected=1000 if name == "t1" else 200)
                found.append(replace(one, residuals={"x_m": np.where(chosen, one.residuals["x_m"], np.nan)}))
    (found,) = held_out.select_worst(before, after)
    assert found.trial.id == "t0"
    error = found.measured - found.after
    np.testing.assert_allclose(np.abs(error), 0.01 * np.sqrt(900.0 / 200.0))
    np.testing.assert_allclose(np.abs(found.measured - found.before), 2.0 * np.abs(error))
    assert held_out.select_worst([], []) == []


def test_a_diverged_simulation_has_a_finite_error(rng: np.random.Generator) -> None:
    class Diverging(Seen):
        """Effect with which the simulation of one trial diverges."""

        def hooks(self, values, trial, model):  # type: ignore[no-untyped-def]
            """Return the hook that adds infinite values to the held-out trial."""
            if trial.id != "last":
                return super().hooks(values, trial, model)
            return Seen("", lambda t: np.full(len(t), np.inf)).hooks(values, trial, model)

    trials = seen_trials(rng, 0.3, 0.0)
    last = replace(trials[-1], id="last", role="validate")
    study = plain_study(trials[:-1], 0.02)
    effect = Diverging("rise", rise)
    fits = [study.fit(e, [study.problem(e).start]) for e in ((), (effect,))]
    with np.errstate(invalid="ignore"):
        before, after = held_out.predict_parts(fits, [last], study.noise)
    assert np.isfinite(after[-1].squared)
    assert not held_out.is_finite(before, after)


def test_the_noise_floor_of_a_channel_is_in_its_unit(rng: np.random.Generator) -> None:
    time = np.linspace(0.0, 3.0, 50)
    trials = [trial(k, time, 0.3 * rng.normal(size=50)) for k in range(4)]
    study = with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), 0.3)
    fit = study.at((), np.empty(0))
    study = study.with_noise(replace(study.noise, variance={"y": 4.0}))
    study = study.with_noise(noise.with_floors(study, fit))
    assert places.compute_floors(study, fit) == {"y": pytest.approx(0.6)}
    assert study.noise.floor("y") == pytest.approx(2.0)
