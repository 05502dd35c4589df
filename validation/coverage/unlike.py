"""Coverage of intervals where trials differ, where noise is slow or uneven, and where trials are few.

A weight pulls a body from rest. The motion has a closed form, and each condition changes what one trial has
or how it is measured. The width of an interval is compared with that of an oracle: generalised least squares
with the true covariances of noise and differences. ``fit-drag`` is measured under one condition, with its
verdict.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import swimid
from swimid import Channel, Model, Parameter, Trial
from swimid.fitting import output_error
from validation.coverage.rows import SHARE, inside

Array = NDArray[np.float64]
Noise = Callable[[np.random.Generator, Array, Array], Array]
#: Covariance matrix of the noise of a series, from its times and the displacement of the body.
Covariance = Callable[[Array, Array], Array]
REPEATS = 400
BODY_KG, DENSITY, AREA_M2, GRAVITY, LENGTH_M = 1.2, 1000.0, 0.007, 9.81, 1.15
TRUTH = {"drag_coefficient": 0.7, "added_mass": 0.7, "pulley_friction": 0.03}
ROBOT = (
    "format: swimid-robot/1\nname: body\n"
    f"body: {{inertial_mass_kg: {BODY_KG}, frontal_area_m2: {AREA_M2}}}\n"
    f"fluid: {{density_kg_m3: {DENSITY}, gravity_m_s2: {GRAVITY}}}\n"
)


def fallen(time: Array, weight_kg: float, values: Sequence[float]) -> tuple[Array, Array]:
    """Return displacement and speed of the body, m and m/s, shape (n,): ``m/c ln cosh(t sqrt(c F) / m)``.

    The values are those of drag coefficient, added mass and pulley friction.
    """
    coefficient, added, friction = values
    mass = BODY_KG + added + weight_kg
    drag, force = 0.5 * DENSITY * AREA_M2 * coefficient, weight_kg * GRAVITY - friction
    phase = np.sqrt(drag * force) / mass * time
    place = mass / drag * (phase + np.log1p(np.exp(-2.0 * phase)) - np.log(2.0))
    return place, np.sqrt(force / drag) * np.tanh(phase)


class Falling(Model):
    """Model of the falling weight, in closed form. The input of a trial is its pulling mass."""

    name = "falling"
    channels = (Channel("x_m", "m"), Channel("u_m_s", "m/s"))

    def __init__(self, fixed: Sequence[str]) -> None:
        scales = {"drag_coefficient": 1.0, "added_mass": 1.0, "pulley_friction": 0.05}
        units = {"drag_coefficient": "1", "added_mass": "kg", "pulley_friction": "N"}
        self.parameters = tuple(
            Parameter(name, units[name], 0.0, np.inf, value, scales[name], free=name not in fixed)
            for name, value in TRUTH.items()
        )

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        place, speed = fallen(trial.time_s, float(trial.inputs["weight_kg"][0]), values)
        return {"x_m": place, "u_m_s": speed}


# ---------------------------------------------------------------- noise


def slow(rng: np.random.Generator, count: int, memory: float) -> Array:
    """Return a stationary first-order autoregression of unit variance, shape (count,)."""
    noise = rng.normal(size=count)
    noise[1:] *= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], noise))


def white(rng: np.random.Generator, time: Array, place: Array) -> Array:
    return rng.normal(size=len(time))


def independent(time: Array, place: Array) -> Array:
    return np.eye(len(time))


def remembering(memory: float) -> tuple[Noise, Covariance]:
    """Return autoregressive noise with a given coefficient, and its covariance."""
    return (
        lambda rng, time, place: slow(rng, len(time), memory),
        lambda time, place: toeplitz(memory ** np.arange(len(time))),
    )


def decay_of(time: Array) -> float:
    """Return the factor by which noise with a memory of 2 s decays from one sample to the next."""
    return float(np.exp(-(time[1] - time[0]) / 2.0))


WHITE_AND_SLOW: tuple[Noise, Covariance] = (
    lambda rng, time, place: rng.normal(size=len(time)) + slow(rng, len(time), decay_of(time)),
    lambda time, place: np.eye(len(time)) + toeplitz(decay_of(time) ** np.arange(len(time))),
)
GROWING: tuple[Noise, Covariance] = (
    lambda rng, time, place: (0.2 + 3.0 * place / LENGTH_M) * rng.normal(size=len(time)),
    lambda time, place: np.diag((0.2 + 3.0 * place / LENGTH_M) ** 2),
)
#: Two in a hundred samples have eight times the noise.
OUTLIERS: tuple[Noise, Covariance] = (
    lambda rng, time, place: rng.normal(size=len(time)) * np.where(rng.random(len(time)) < 0.02, 8.0, 1.0),
    lambda time, place: np.eye(len(time)) * (0.98 + 0.02 * 64.0),
)


@dataclass(frozen=True)
class Condition:
    """Trials of one set: pulling masses, what differs between them, noise, rate, and what is recorded."""

    weights_g: Sequence[float]
    #: Relative standard deviation of a parameter between trials, by name.
    differs: dict[str, float] = field(default_factory=dict)
    noise: tuple[Noise, Covariance] = (white, independent)
    noise_m: float = 5e-4
    rate_hz: float = 50.0
    louder: float = 1.0
    held_out: int = 0
    fixed: tuple[str, ...] = ()
    missing: float = 0.0
    #: Fraction of the drop that each trial records; all of it by default.
    lengths: Sequence[float] = ()
    #: Whether the speed is measured, too, with one error for both channels.
    common_error: bool = False
    #: Maximum width of an interval, relative to that of the oracle, that is wanted. None if none is.
    widest: float | None = None
    #: Whether the differences leave no trace in these trials, so that no interval contains them.
    hidden: bool = False
    #: Smallest and largest share of intervals that hold the truth, per cent. Where few trials differ, or
    #: where noise is slow, an interval may be too wide, but not too narrow.
    share: tuple[int, int] = (92, 98)


SIX, FOUR, THREE, TWO = (12, 16, 20, 26, 32, 40), (12, 20, 30, 40), (12, 22, 40), (12, 40)
REPEAT = ("pulley_friction",)
CONDITIONS = {
    "white, 6 trials": Condition(SIX, widest=1.3),
    "white, 3 trials": Condition(THREE),
    "AR 0.9, 6 trials": Condition(SIX, noise=remembering(0.9)),
    "outliers, 6 trials": Condition(SIX, noise=OUTLIERS, share=(92, 100)),
    "gaps of 30 %, 6 trials": Condition(SIX, missing=0.3),
    "10 Hz, 3 trials": Condition(THREE, rate_hz=10.0),
    "drag 3 %, 2 repeats": Condition((20, 20), {"drag_coefficient": 0.03}, fixed=REPEAT, share=(92, 100)),
    "drag 3 %, 3 repeats": Condition((20,) * 3, {"drag_coefficient": 0.03}, fixed=REPEAT, share=(92, 100)),
    "drag 3 %, 4 repeats": Condition((20,) * 4, {"drag_coefficient": 0.03}, fixed=REPEAT, share=(92, 100)),
    "drag 1 %, 2 repeats": Condition((20, 20), {"drag_coefficient": 0.01}, fixed=REPEAT, share=(92, 100)),
    "drag 1 %, 3 repeats": Condition((20,) * 3, {"drag_coefficient": 0.01}, fixed=REPEAT, share=(92, 100)),
    "drag 1 %, 4 repeats": Condition((20,) * 4, {"drag_coefficient": 0.01}, fixed=REPEAT, share=(92, 100)),
    "friction 10 %, 6 trials": Condition(SIX, {"pulley_friction": 0.1}, share=(90, 100)),
    "friction 10 %, 4 trials": Condition(FOUR, {"pulley_friction": 0.1}, share=(90, 100)),
    "friction 10 %, 3 trials": Condition(THREE, {"pulley_friction": 0.1}, share=(90, 100)),
    "friction 10 %, 2 trials": Condition(TWO, {"pulley_friction": 0.1}, hidden=True),
    "friction 1 %, 6 trials": Condition(SIX, {"pulley_friction": 0.01}, share=(92, 100)),
    "friction 10 %, lengths 1 to 10": Condition(
        SIX, {"pulley_friction": 0.1}, lengths=(0.1, 0.2, 0.4, 0.6, 0.8, 1.0), share=(90, 100)
    ),
    "drag 3 % and friction 10 %, 6 trials": Condition(
        SIX, {"drag_coefficient": 0.03, "pulley_friction": 0.1}, share=(90, 100)
    ),
    "AR 0.99, 6 trials": Condition(SIX, noise=remembering(0.99), widest=2.2, share=(90, 100)),
    "AR 0.99, 2 trials": Condition(TWO, noise=remembering(0.99), share=(90, 100)),
    "white and slow, 50 Hz, 6 trials": Condition(SIX, noise=WHITE_AND_SLOW, widest=2.2, share=(90, 100)),
    "white and slow, 200 Hz, 6 trials": Condition(
        SIX, noise=WHITE_AND_SLOW, rate_hz=200.0, widest=2.2, share=(90, 100)
    ),
    "noise grows, 6 trials": Condition(SIX, noise=GROWING, widest=1.3, share=(92, 100)),
    "one trial 10 times noisier": Condition(SIX, louder=10.0, widest=1.3, share=(92, 100)),
    "one slow error in two channels": Condition(
        SIX, noise=WHITE_AND_SLOW, common_error=True, share=(92, 100)
    ),
}  # fmt: skip


# ---------------------------------------------------------------- one set of trials


@dataclass(frozen=True)
class Drop:
    """Drop of one trial: its weight, times, motion, measurements, and covariance of their noise."""

    weight_kg: float
    time: Array
    measured: dict[str, Array]
    covariance: Array
    there: NDArray[np.bool_]

    def trial(self, name: str) -> Trial:
        """Return the drop as a trial of :class:`Falling`."""
        weight = np.full(len(self.time), self.weight_kg)
        return Trial(name, "fit", self.time, self.measured, inputs={"weight_kg": weight})


def draw(condition: Condition, rng: np.random.Generator) -> list[Drop]:
    """Draw the drops of one set of trials."""
    loud, drops = int(rng.integers(len(condition.weights_g))), []
    noise, covariance = condition.noise
    for k, weight in enumerate(condition.weights_g):
        own = [v * (1.0 + condition.differs.get(n, 0.0) * rng.normal()) for n, v in TRUTH.items()]
        time = np.arange(0.0, 60.0, 1.0 / condition.rate_hz)
        length = LENGTH_M * (condition.lengths[k] if condition.lengths else 1.0)
        time = time[fallen(time, weight / 1000, own)[0] <= length]
        place, speed = fallen(time, weight / 1000, own)
        size = condition.noise_m * (condition.louder if k == loud else 1.0)
        error = noise(rng, time, place)
        there = rng.random(len(time)) >= condition.missing
        seen = {"x_m": np.where(there, place + size * error, np.nan)}
        if condition.common_error:
            seen["u_m_s"] = speed + size * (error + 0.3 * rng.normal(size=len(time)))
        drops.append(Drop(weight / 1000, time, seen, size**2 * covariance(time, place), there))
    return drops


def oracle(condition: Condition, drops: Sequence[Drop]) -> dict[str, float]:
    """Return the standard errors of generalised least squares with the true covariances, by parameter."""
    names = [n for n in TRUTH if n not in condition.fixed]
    whole = np.zeros((len(names),) * 2)
    for drop in drops:
        columns = []
        for name in names:
            ends = []
            for sign in (1.0, -1.0):
                values = {**TRUTH, name: TRUTH[name] * (1.0 + 1e-4 * sign)}
                ends.append(fallen(drop.time, drop.weight_kg, list(values.values()))[0])
            columns.append((ends[0] - ends[1]) / (2e-4 * TRUTH[name]))
        rows = np.column_stack(columns)[drop.there]
        spread = np.array([condition.differs.get(n, 0.0) * TRUTH[n] for n in names])
        covariance = drop.covariance[np.ix_(drop.there, drop.there)] + (rows * spread**2) @ rows.T
        whole += rows.T @ np.linalg.solve(covariance, rows)
    return dict(zip(names, np.sqrt(np.diag(np.linalg.inv(whole))), strict=True))


def measure(condition: Condition, rng: np.random.Generator) -> dict[str, float]:
    """Return by parameter whether the interval holds the mean of all trials, and its relative width.

    For differences that leave no trace, return whether the fit says so.
    """
    drops = draw(condition, rng)
    trials = [drop.trial(str(k)) for k, drop in enumerate(drops)]
    # Leave out the searches around the estimates. This cost is smooth.
    fit = output_error.complete_fit(
        output_error.fit_output_error(Falling(condition.fixed), trials, tested=False)
    )
    assert fit.differences is not None
    if condition.hidden:
        name = f"hidden differences of friction are reported{SHARE.format(95, 100)}"
        return {name: float("pulley_friction" in fit.differences.hidden)}
    found = {n: fit.stderr(n) or np.nan for n in fit.labels if fit.status[n] == "estimated"}
    share = SHARE.format(*condition.share)
    hits = {f"{n}{share}": float(abs(fit.value(n) - TRUTH[n]) <= 1.96 * e) for n, e in found.items()}
    if not condition.differs:
        hits["alarm: trials differ"] = float(fit.differences.are_likely)
    if condition.widest is not None:
        best = oracle(condition, drops)
        widths = np.median([error / best[n] for n, error in found.items()])
        hits[f"width over that of the oracle, at most {condition.widest:g}"] = float(widths)
    return hits


def measure_fit_drag(rng: np.random.Generator) -> dict[str, float]:
    """Return coverage and verdict of ``fit-drag`` for two repeats, and a third that is held out.

    Their drag differs by 1 to 3 %.
    """
    differs = {"drag_coefficient": float(rng.uniform(0.01, 0.03))}
    condition = Condition((20, 20, 20), differs, fixed=REPEAT)
    lines = ["format: swimid-trials/1", "experiment: falling-weight", "robot: robot.yaml", "trials:"]
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name)
        (folder / "robot.yaml").write_text(ROBOT)
        for k, drop in enumerate(draw(condition, rng)):
            table = np.c_[drop.time, drop.measured["x_m"]]
            np.savetxt(folder / f"{k}.csv", table, "%.7f", ",", header="t_s,x_m", comments="")
            role = ", role: validate" * (k == 2)
            lines.append(f"  - {{log: {k}.csv, pulling_mass_kg: {drop.weight_kg:g}{role}}}")
        (folder / "trials.yaml").write_text("\n".join(lines) + "\n")
        fit = swimid.fit_drag(folder / "trials.yaml", fixed={n: TRUTH[n] for n in REPEAT})
    share = SHARE.format(90, 100)
    hits = {f"{n}{share}": inside(fit.data["parameters"][n], TRUTH[n]) for n in TRUTH if n not in REPEAT}
    return {**hits, "alarm: good and wrong": float(fit.verdict == "good" and 0.0 in hits.values())}


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals hold the truth under each condition."""
    hits = {}
    for number, (name, condition) in enumerate(CONDITIONS.items()):
        found = measure(condition, np.random.default_rng([seed, 31, number]))
        hits |= {f"{name}: {key}": value for key, value in found.items()}
    drag = measure_fit_drag(np.random.default_rng([seed, 37]))
    return hits | {f"fit-drag, 2 repeats and 1 held out: {key}": value for key, value in drag.items()}
