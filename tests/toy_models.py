"""Closed-form models for tests of estimators, and noisy trials of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from swimid.fitting.model import Channel, Model, Parameter, Trial

Formula = Callable[[np.ndarray, np.ndarray], dict[str, np.ndarray]]


class Toy(Model):
    """A model whose channels are a formula of the parameter values and the time."""

    name = "toy"

    def __init__(
        self,
        formula: Formula,
        parameters: Sequence[Parameter],
        channels: Sequence[str] = ("y",),
        before: Callable[[], None] = lambda: None,
    ) -> None:
        self.formula = formula
        self.parameters = tuple(parameters)
        self.channels = tuple(Channel(c, "m") for c in channels)
        self.before = before
        self.threads: set[int] = set()

    def simulate(self, values: np.ndarray, trial: Trial) -> dict[str, np.ndarray]:
        self.threads.add(threading.get_ident())
        self.before()
        return self.formula(np.asarray(values), trial.time_s)


def parameter(
    name: str, start: float, lower: float = -np.inf, upper: float = np.inf, scale: float = 1.0, **more: bool
) -> Parameter:
    return Parameter(name, "1", lower, upper, start, scale, **more)


def trials(
    model: Toy,
    truth: Sequence[float],
    sd: Mapping[str, float],
    rng: np.random.Generator,
    *,
    count: int = 3,
    samples: int = 200,
) -> list[Trial]:
    found = []
    for k in range(count):
        time = np.linspace(0.0, 5.0 + k, samples)
        clean = model.formula(np.asarray(truth, dtype=float), time)
        noisy = {c: clean[c] + rng.normal(0.0, s, samples) for c, s in sd.items()}
        found.append(Trial(f"t{k}", "fit", time, noisy))
    return found


def decay(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return a decaying oscillation from size, rate and frequency, with its speed as second channel."""
    size, rate, frequency = values
    y = size * np.exp(-rate * t) * np.cos(frequency * t)
    speed = -rate * y - size * frequency * np.exp(-rate * t) * np.sin(frequency * t)
    return {"y": y, "v": speed}


DECAY = (
    parameter("size", 0.6, 0.0, 5.0),
    parameter("rate", 0.6, 0.0, 3.0),
    parameter("frequency", 2.3, 0.5, 6.0),
)
TRUTH = (1.0, 0.3, 2.0)
WEIGHTS = (1.0, 0.31, 0.08)


def friction(values: np.ndarray, t: np.ndarray) -> dict[str, np.ndarray]:
    """Return thrust less three frictions, of which only the weighted sum matters."""
    total = np.dot(WEIGHTS, values[1:4])
    return {"y": values[0] * np.sin(3 * t) - total * t * np.exp(-0.3 * t)}


FRICTION = (
    parameter("thrust", 1.0, 0.0, 5.0),
    parameter("c_f0", 1.0, 0.0, 10.0),
    parameter("c_f13", 1.0, 0.0, 10.0),
    parameter("c_f4", 1.0, 0.0, 10.0),
)
FRICTION_TRUTH = (2.0, 0.4, 0.3, 0.2)
