"""Screening of effects: predicted decreases of held-out residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from swimid.diagnosis import screening
from swimid.diagnosis.study import GapStudy
from swimid.fitting.model import Hooks, Model, Parameter, Trial
from tests.diagnosis_models import Apart, Hooked, Seen, nothing, plain_study, ring, trial, with_sd
from tests.toy_models import parameter


def rising(rng: np.random.Generator, size: float) -> GapStudy:
    """Return a study of a model that is zero, and of trials that rise."""
    time = np.linspace(0.0, 5.0, 100)
    trials = [trial(k, time, size * np.tanh(time) + 0.02 * rng.normal(size=100)) for k in range(6)]
    return with_sd(GapStudy(Hooked(nothing, (), ("y",)), (), trials, {}), 0.02)


class Fragile(Seen):
    """Effect that adds a curve, and with which the simulation of the first trial diverges."""

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        """Return the hook that adds the curve, or values that do not exist."""
        if trial.id != "t0":
            return super().hooks(values, trial, model)
        return Hooks(output=(lambda seen, t: {c: np.full(len(t), np.nan) for c in seen},))


def test_a_trial_that_diverges_leaves_an_effect_to_the_others(rng: np.random.Generator) -> None:
    study = rising(rng, 1.0)
    base = study.fit((), [study.shape.start])
    (found,) = screening.simulate_effects(study, base, [Fragile("fragile", np.tanh)])
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
        """Return the size of the curve."""
        return (parameter("size", 0.0, scale=self.unit),)


def test_the_screening_does_not_depend_on_the_unit_of_a_parameter(rng: np.random.Generator) -> None:
    """The changes are small against the noise, so that the prior of the size matters."""
    study = rising(rng, 0.004)
    base = study.fit((), [study.shape.start])
    effects = [InUnits("metres", 1.0), InUnits("millimetres", 1000.0), InUnits("kilometres", 1e-3)]
    found, _ = screening.screen_effects(study, base, screening.simulate_effects(study, base, effects))
    first, *others = found
    assert len(others) == 2
    for other in others:
        np.testing.assert_allclose(other.gains, first.gains, rtol=1e-6)
    # a single direction with the prior standard deviation of five typical sizes, by Bayes's rule
    information = sum(np.sum((0.001 * np.tanh(t.time_s) / 0.02) ** 2) for t in study.trials)
    seen = sum(np.sum(0.001 * np.tanh(t.time_s) * t.measured["y"] / 0.02**2) for t in study.trials)
    one = next(t for t in found if t.effect.name == "metres")
    assert one.point[0] == pytest.approx(seen / (information + 1 / 25), rel=1e-6)


def test_the_own_value_of_a_trial_is_tested_in_the_same_trial(rng: np.random.Generator) -> None:
    """Three quarters of a trial predict the last one, if the curve has a size in each trial."""
    time = np.linspace(0.0, 5.0, 200)
    gains = []
    for size in (0.3, 0.0):
        trials = [
            trial(k, time, np.exp(-time) + size * (-1) ** k * ring(time) + 0.02 * rng.normal(size=200))
            for k in range(6)
        ]
        study = plain_study(trials, 0.02)
        base = study.fit((), [study.shape.start])
        found, _ = screening.screen_effects(
            study, base, screening.simulate_effects(study, base, [Apart("ring", ring)])
        )
        gains.append(found[0].gain)
    # 1200 squares of a sine of amplitude 15 times the noise
    assert gains[0] == pytest.approx(0.5 * 15.0**2 * 1200, rel=0.15)
    assert abs(gains[1]) < 50.0
