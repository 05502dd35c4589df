"""Coverage of ``fit-drag`` where trials differ, where noise is slow or uneven, and where trials are few.

A weight pulls a body from rest. The motion has a closed form, and each condition changes what one trial has
or how its displacement is measured.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import swimid
from tests.coverage.rows import inside

Array = NDArray[np.float64]
Noise = Callable[[np.random.Generator, Array, Array], Array]
REPEATS = 400
BODY_KG, DENSITY, AREA_M2, GRAVITY, LENGTH_M = 1.2, 1000.0, 0.007, 9.81, 1.15
ROBOT = (
    "format: swimid-robot/1\nname: body\n"
    f"body: {{inertial_mass_kg: {BODY_KG}, frontal_area_m2: {AREA_M2}}}\n"
    f"fluid: {{density_kg_m3: {DENSITY}, gravity_m_s2: {GRAVITY}}}\n"
)
TRUTH = {"drag_coefficient": 0.7, "added_mass": 0.7, "pulley_friction": 0.03}


def fallen(time: Array, weight_kg: float, values: dict[str, float]) -> Array:
    """Return the displacement of the body, m: ``m/c ln cosh(t sqrt(c F) / m)``, shape (n,)."""
    mass = BODY_KG + values["added_mass"] + weight_kg
    drag = 0.5 * DENSITY * AREA_M2 * values["drag_coefficient"]
    force = weight_kg * GRAVITY - values["pulley_friction"]
    phase = np.sqrt(drag * force) / mass * time
    return mass / drag * (phase + np.log1p(np.exp(-2.0 * phase)) - np.log(2.0))


def slow(rng: np.random.Generator, count: int, memory: float) -> Array:
    """Return a stationary first-order autoregression of unit variance, shape (count,)."""
    noise = rng.normal(size=count)
    noise[1:] *= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise))


def white(rng: np.random.Generator, time: Array, place: Array) -> Array:
    return rng.normal(size=len(time))


def remembering(memory: float) -> Noise:
    """Return autoregressive noise with a given coefficient."""
    return lambda rng, time, place: slow(rng, len(time), memory)


def white_and_slow(rng: np.random.Generator, time: Array, place: Array) -> Array:
    return rng.normal(size=len(time)) + slow(rng, len(time), float(np.exp(-(time[1] - time[0]) / 2.0)))


def growing(rng: np.random.Generator, time: Array, place: Array) -> Array:
    return (0.2 + 3.0 * place / LENGTH_M) * rng.normal(size=len(time))


def with_outliers(rng: np.random.Generator, time: Array, place: Array) -> Array:
    return rng.normal(size=len(time)) * np.where(rng.random(len(time)) < 0.02, 8.0, 1.0)


@dataclass(frozen=True)
class Condition:
    """Trials of one set: pulling masses, what differs between them, noise, and rate."""

    weights_g: Sequence[float]
    #: Relative standard deviation of a parameter between trials, by name.
    differs: dict[str, float] = field(default_factory=dict)
    noise: Noise = white
    noise_m: float = 5e-4
    rate_hz: float = 50.0
    louder: float = 1.0
    held_out: int = 0
    fixed: tuple[str, ...] = ()


SIX, FOUR, THREE, TWO = (12, 16, 20, 26, 32, 40), (12, 20, 30, 40), (12, 22, 40), (12, 40)
REPEAT = ("pulley_friction",)
CONDITIONS = {
    "white, 6 trials": Condition(SIX),
    "AR 0.9, 6 trials": Condition(SIX, noise=remembering(0.9)),
    "outliers, 6 trials": Condition(SIX, noise=with_outliers),
    "10 Hz, 3 trials": Condition(THREE, rate_hz=10.0),
    "drag 3 %, 2 repeats": Condition((20, 20), {"drag_coefficient": 0.03}, fixed=REPEAT),
    "drag 3 %, 3 repeats": Condition((20,) * 3, {"drag_coefficient": 0.03}, fixed=REPEAT),
    "drag 3 %, 4 repeats": Condition((20,) * 4, {"drag_coefficient": 0.03}, fixed=REPEAT),
    "drag 1 %, 2 repeats": Condition((20, 20), {"drag_coefficient": 0.01}, fixed=REPEAT),
    "drag 1 %, 3 repeats": Condition((20,) * 3, {"drag_coefficient": 0.01}, fixed=REPEAT),
    "drag 1 %, 4 repeats": Condition((20,) * 4, {"drag_coefficient": 0.01}, fixed=REPEAT),
    "friction 10 %, 6 trials": Condition(SIX, {"pulley_friction": 0.1}),
    "friction 10 %, 4 trials": Condition(FOUR, {"pulley_friction": 0.1}),
    "friction 10 %, 3 trials": Condition(THREE, {"pulley_friction": 0.1}),
    "friction 10 %, 2 trials": Condition(TWO, {"pulley_friction": 0.1}),
    "friction 1 %, 6 trials": Condition(SIX, {"pulley_friction": 0.01}),
    "AR 0.99, 6 trials": Condition(SIX, noise=remembering(0.99)),
    "AR 0.99, 2 trials": Condition(TWO, noise=remembering(0.99)),
    "white and slow, 50 Hz, 6 trials": Condition(SIX, noise=white_and_slow),
    "white and slow, 200 Hz, 6 trials": Condition(SIX, noise=white_and_slow, rate_hz=200.0),
    "noise grows, 6 trials": Condition(SIX, noise=growing),
    "one trial 10 times noisier": Condition(SIX, louder=10.0),
    "drag 3 %, 2 repeats, 1 held out": Condition(
        (20, 20, 20), {"drag_coefficient": 0.03}, held_out=1, fixed=REPEAT
    ),
}  # fmt: skip


def measure(condition: Condition, rng: np.random.Generator) -> dict[str, float]:
    """Return by parameter whether the interval holds the mean of all trials, and its width.

    The width is half of the interval, divided by the true value. A good verdict on a wrong interval is an
    alarm.
    """
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: robot.yaml", "trials:"]
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        (folder / "robot.yaml").write_text(ROBOT)
        loud = int(rng.integers(len(condition.weights_g)))
        for k, weight in enumerate(condition.weights_g):
            own = {n: v * (1.0 + condition.differs.get(n, 0.0) * rng.normal()) for n, v in TRUTH.items()}
            time = np.arange(0.0, 60.0, 1.0 / condition.rate_hz)
            place = fallen(time, weight / 1000, own)
            time, place = time[place <= LENGTH_M], place[place <= LENGTH_M]
            size = condition.noise_m * (condition.louder if k == loud else 1.0)
            seen = place + size * condition.noise(rng, time, place)
            np.savetxt(folder / f"{k}.csv", np.c_[time, seen], "%.7f", ",", header="t_s,x_m", comments="")
            role = ", role: validate" * (k >= len(condition.weights_g) - condition.held_out)
            lines.append(f"  - {{log: {k}.csv, pulling_mass_kg: {weight / 1000:g}{role}}}")
        (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
        held = {n: TRUTH[n] for n in condition.fixed}
        fit = swimid.fit_drag(folder / "trials.yaml", fixed=held)
    found = {n: fit.data["parameters"][n] for n in TRUTH if n not in held}
    hits = {n: inside(estimate, TRUTH[n]) for n, estimate in found.items()}
    for n, estimate in found.items():
        if estimate["status"] == "estimated":
            hits[f"width: {n}"] = 1.96 * estimate["stderr"] / TRUTH[n]
    hits["alarm: good and wrong"] = float(fit.verdict == "good" and any(hits[n] == 0.0 for n in found))
    return hits


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the truth under each condition."""
    hits = {}
    for number, (name, condition) in enumerate(CONDITIONS.items()):
        found = measure(condition, np.random.default_rng([seed, 31, number]))
        hits |= {f"{name}: {key}": value for key, value in found.items() if not key.startswith("width")}
    return hits
