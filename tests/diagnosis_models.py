"""Closed-form models, effects and trials for tests of the diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from swimid.diagnosis.noise import NoiseModel, RandomEffect, Scatter
from swimid.diagnosis.study import GapStudy
from swimid.effects.base import Effect
from swimid.fitting.model import Hooks, Model, Parameter, RigInput, Trial
from swimid.fitting.problem import Problem
from tests.toy_models import Toy, parameter

LINE = (parameter("a", 0.5), parameter("b", 0.5), parameter("start", 0.0, per_trial=True))
PLAIN = (parameter("a", 0.5),)


def line(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return two channels that are linear in two coefficients and a start value."""
    a, b, start = values
    return {"y": a * np.sin(t) + b * t + start, "v": a * np.cos(t) + b}


def nothing(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return one channel that is zero."""
    return {"y": np.zeros_like(t)}


def plainly(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return one channel that decays from a given value."""
    return {"y": values[0] * np.exp(-t)}


def rise(t: np.ndarray) -> np.ndarray:
    """Return a curve that saturates."""
    return np.tanh(t)


def ring(t: np.ndarray) -> np.ndarray:
    """Return a curve that oscillates."""
    return np.sin(2.0 * t)


class Hooked(Toy):
    """Closed-form model to which effects can be added."""

    def simulate_hooked(self, values: np.ndarray, trial: Trial, hooks: Hooks) -> dict[str, np.ndarray]:
        """Simulate a trial, and change what is measured by an effect."""
        return hooks.sense(self.simulate(values, trial), trial.time_s)


class Seen(Effect):
    """Effect that adds a curve to the measured channel."""

    stage, meaning, sources, needs = "sensing", "a curve", (), frozenset[str]()

    def __init__(self, name: str, curve: Callable[[np.ndarray], np.ndarray]) -> None:
        self.name, self.curve = name, curve

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the size of the curve."""
        return (parameter("size", 0.0),)

    def hooks(self, values: np.ndarray, trial: Trial, model: Model) -> Hooks:
        """Return the hook that adds the curve."""

        def more(found: dict[str, np.ndarray], time: np.ndarray) -> dict[str, np.ndarray]:
            return {**found, "y": found["y"] + values[0] * self.curve(time)}

        return Hooks(output=(more,))


class Apart(Seen):
    """Effect that adds a curve whose size differs between trials."""

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the size of the curve in each trial."""
        return (parameter("size", 0.0, per_trial=True),)


class Tilt(Seen):
    """Effect that adds a slope, which may differ by chance between trials."""

    scatters = True

    def __init__(self) -> None:
        super().__init__("tilt", lambda t: t)


def differing(effect: Effect, sd: float) -> RandomEffect:
    """Return an effect of one parameter, of scale 1, as a random effect."""
    return RandomEffect(effect.name, sd, Scatter(effect, np.zeros(1), 0, effect.name, 1.0))


def trial(k: int, time: np.ndarray, y: np.ndarray) -> Trial:
    """Return a trial of one channel at a setting of its own."""
    return Trial(f"t{k}", "fit", time, {"y": y}, rig=RigInput(force=1.0 + k))


def seen_trials(rng: np.random.Generator, rising: float, ringing: float) -> list[Trial]:
    """Return six trials that contain two curves of given sizes."""
    trials = []
    for k in range(6):
        t = np.linspace(0.0, 5.0 + 0.3 * k, 200)
        y = np.exp(-t) + rising * rise(t) + ringing * ring(t) + 0.02 * rng.normal(size=len(t))
        trials.append(trial(k, t, y))
    return trials


def line_study(rng: np.random.Generator) -> GapStudy:
    """Return a linear model with two coefficients, and five trials that each have a start value."""
    trials = []
    for k in range(5):
        t = np.linspace(0.0, 4.0 + k, 60 + 5 * k)
        clean = line(np.array([1.0, 0.2, 0.1 * k]), t)
        found = {c: clean[c] + 0.05 * rng.normal(size=len(t)) for c in clean}
        trials.append(Trial(f"t{k}", "fit", t, found, rig=RigInput(force=1.0 + max(k, 1))))
    return GapStudy(Hooked(line, LINE, ("y", "v")), LINE, trials, {"a": (0.8, 0.2)})


def plain_study(trials: Sequence[Trial], sd: float, prior: tuple[float, float] | None = None) -> GapStudy:
    """Return a study of a model that decays, with independent noise of a known standard deviation."""
    study = GapStudy(Hooked(plainly, PLAIN, ("y",)), PLAIN, trials, {} if prior is None else {"a": prior})
    return with_sd(study, sd)


def noise_of(problem: Problem, sd: float) -> NoiseModel:
    """Return independent noise of a standard deviation in all channels."""
    weights = [[np.full(len(one), sd) for one in each] for each in problem.sd]
    return NoiseModel(weights, channels=problem.channels)


def with_sd(study: GapStudy, sd: float) -> GapStudy:
    """Return a study with independent noise of a standard deviation in all channels."""
    return study.with_noise(noise_of(study.shape, sd))
