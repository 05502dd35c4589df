"""Test whether the residuals of a fit have structure, and where in the simulation it may arise.

The test fits a generic description to the residuals: smooth forces, stroke changes and sensor errors without
a physical cause. These terms are never reported as a cause. They are a model discrepancy with a prior, as in
Kennedy and O'Hagan (2001, J. R. Stat. Soc. B 63(3)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from swimid.diagnosis import crossval
from swimid.diagnosis.crossval import solve_normal
from swimid.diagnosis.screening import is_sound
from swimid.diagnosis.study import GapStudy, Hypothesis
from swimid.effects.base import Effect
from swimid.files.kernels import numba
from swimid.fitting.model import (
    FORCE_SIGNATURE,
    Array,
    ExternalForce,
    Hooks,
    Model,
    Parameter,
    Trial,
    traceable,
)
from swimid.fitting.problem import map_in_processes

#: Candidates for the prior standard deviation of the terms that describe residuals without physics, in units
#: of the typical scale of each term.
WIDTHS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Maximum effective number of parameters of a generic description of residuals, as a fraction of the number
#: of samples. With more parameters, the description would fit noise.
MOST_USED = 0.5
#: Minimum decrease of the held-out squared residuals, per sample, with which a generic description shows
#: structure in the residuals. Its unit is the noise variance.
PER_SAMPLE = 0.002
#: Number of random noise records to which a generic description is fitted (DRAWS), and quantile of the
#: decreases of their squared residuals by these fits (QUANTILE). The decrease in the trials must exceed this
#: quantile to count as structure.
DRAWS, QUANTILE = 400, 0.975
#: Upper and lower limit of the minimum decrease in :func:`find_structure`, in units of the noise variance.
#: Between these limits, the minimum decrease of the held-out squared residuals is half the number of samples.
LEAST_GAIN, LEAST_OF_FEW = 50.0, 25.0


@dataclass(frozen=True)
class Structure:
    """Structure that a generic description finds in the residuals of a fit.

    Attributes
    ----------
    gain : float
            Decrease of the held-out squared residuals by all terms together, or by those of one place in the
            simulation, in units of the noise variance.
    threshold : float
        Minimum decrease for structure. The probability that pure noise exceeds it is at most 1/40.
    places : dict of place to float
        Decrease of the held-out squared residuals by the terms of each place alone.
    """

    gain: float
    threshold: float
    places: dict[str, float]

    @property
    def is_present(self) -> bool:
        """Return whether the generic description decreases the residuals by more than noise alone allows."""
        return self.gain > self.threshold


class Term(NamedTuple):
    """Generic term at its typical scale: its place in the simulation, and the weighted changes due to it."""

    place: str
    changes: list[Array]


def simulate_terms(study: GapStudy, base: Hypothesis) -> list[Term]:
    """Return the changes of the trials by generic terms, linearised about a fit.

    Terms that change nothing, or with which the simulation diverges, are left out.
    """

    def of(description: Description) -> list[Term]:
        parameters = description.parameters(study.model, study.trials)
        return [
            Term(description.place, changed)
            for changed in study.changes(base, description, description.tries(parameters))
            if all(is_sound(c) for c in changed) and sum(float(c @ c) for c in changed) > 1e-9
        ]

    found = map_in_processes(of, list_descriptions(study.model, study.trials), study.jobs)
    return [term for of_each in found for term in of_each]


def find_structure(
    study: GapStudy, base: Hypothesis, terms: Sequence[Term], *, rng: np.random.Generator
) -> Structure:
    """Fit a generic description without physics to the residuals of a fit.

    The prior standard deviation of the factors of the terms is chosen on held-out folds.
    """
    columns = [term.changes for term in terms]
    inner = crossval.form_normal_equations(study, base, columns)
    plain = crossval.compute_held_out(inner)
    draws = crossval.draw_noise(inner, rng, DRAWS)
    plain_drawn = crossval.compute_held_out(inner, draws=draws)
    every = list(range(len(columns)))
    samples = float(inner.samples.sum())
    gain, largest = 0.0, np.zeros(DRAWS)
    for width in WIDTHS:
        tried = [width**-2] * len(columns)
        if _freedom(inner, tried) > MOST_USED * samples:
            break
        gain = max(gain, float((plain - crossval.compute_held_out(inner, every, tried)).sum()))
        drawn = (plain_drawn - crossval.compute_held_out(inner, every, tried, draws)).sum(axis=0)
        largest = np.maximum(largest, drawn)
    places = {}
    for place in dict.fromkeys(term.place for term in terms):
        mine = [i for i, term in enumerate(terms) if term.place == place]
        alone = (plain - crossval.compute_held_out(inner, mine, [width**-2] * len(mine)) for width in WIDTHS)
        places[place] = max(float(gains.sum()) for gains in alone)
    least = float(np.clip(0.5 * samples, LEAST_OF_FEW, LEAST_GAIN))
    least = max(float(np.quantile(largest, QUANTILE)), PER_SAMPLE * samples, least)
    return Structure(max([gain, *places.values()]), least, places)


def _freedom(inner: crossval.NormalEquations, prior: Sequence[float]) -> float:
    """Return the effective number of parameters of the generic terms: the trace of their hat matrix."""
    normal = inner.whole[:-1, :-1]
    ridge = block_diag(inner.prior, np.diag(prior))
    return float(np.trace(solve_normal(normal + ridge, normal)[inner.n_shared :, inner.n_shared :]))


#: Terms of the residual force on a robot, in the order of their factors.
TERMS = (
    "constant", "speed", "speed squared", "sway", "yaw rate", "time", "cos phase", "sin phase", "cos 2 phase",
    "sin 2 phase", "cos phase x time", "sin phase x time",
)  # fmt: skip
#: Levels of the frequency or amplitude in a table of steady swimming: minimum number of rows that share a
#: level (SHARED), relative tolerance within a level (LEVEL), and maximum number of levels (LEVELS). If there
#: are more levels, none is used.
SHARED, LEVEL, LEVELS = 3, 1e-3, 12
FORCE_AXES = {"surge": 0, "sway": 1, "yaw": 2}


@traceable(on="base", constants=17)
def smooth_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add a smooth force along one axis (a moment for yaw) to the wrench.

    The constants are the axis, the beat frequency (Hz), the start time and duration of the trial (s), the
    typical speed (m/s), and one factor for each of :data:`TERMS`.
    """
    u, v, r = velocity[0] / constants[4], velocity[1] / constants[4], velocity[2]
    late = (t - constants[2]) / constants[3]
    phase = 2.0 * math.pi * constants[1] * t
    c, s = math.cos(phase), math.sin(phase)
    f = constants[5] + constants[6] * u + constants[7] * u * abs(u) + constants[8] * v + constants[9] * r
    f += constants[10] * late + constants[11] * c + constants[12] * s
    f += constants[13] * (c * c - s * s) + constants[14] * 2.0 * c * s
    f += (constants[15] * c + constants[16] * s) * late
    # Add the force to the selected axis only. A traceable function must not branch on values.
    for axis in range(3):
        wrench[axis] += f * max(1.0 - abs(constants[0] - axis), 0.0)


#: Terms of the residual force on the body of a rig, which has one coordinate, in the order of their factors.
RIG_TERMS = (
    "constant", "speed", "speed squared", "speed cubed", "place", "place squared", "place cubed", "time",
)  # fmt: skip
#: Names of the terms of a smooth error of a sensor channel.
SENSOR_TERMS = ("gain", "drift", "drift squared", "cos phase", "sin phase", "quadratic")


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def smooth_push(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add a smooth force on the body of a rig to the wrench.

    The constants are the start time and duration of the trial (s), the typical speed and position, and one
    factor for each of :data:`RIG_TERMS`.
    """
    late = (t - constants[0]) / constants[1]
    u, x = velocity[0] / constants[2], pose[0] / constants[3]
    f = constants[4] + constants[5] * u + constants[6] * u * abs(u) + constants[7] * u**3
    wrench[0] += f + constants[8] * x + constants[9] * x * x + constants[10] * x**3 + constants[11] * late


class Description(Effect):
    """Generic description of residuals: a smooth effect without physics, with one factor for each term."""

    name: ClassVar[str] = "residual"
    #: Place in the simulation where the effect acts, in words.
    place: str = ""
    #: Names of the terms, prefix of these names, and unit and typical scale of the factors.
    terms: tuple[str, ...] = ()
    prefix: str = ""
    unit: str = "1"
    size: float

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the parameters of the description: one factor for each smooth term."""
        ends = -math.inf, math.inf
        return tuple(Parameter(f"{self.prefix}{t}", self.unit, *ends, 0.0, self.size) for t in self.terms)

    def tries(self, parameters: Sequence[Parameter]) -> list[Array]:
        """Return the parameter vectors to simulate: one factor at its typical scale, all others zero.

        One size is enough, because the simulated trials depend nearly linearly on each factor.
        """
        return [np.eye(len(parameters))[k] * p.scale for k, p in enumerate(parameters)]


class ResidualForce(Description):
    """Smooth force on the base link of a robot along one axis (a moment for yaw)."""

    terms = TERMS

    def __init__(self, axis: str, size: float, speed: float) -> None:
        self.axis, self.size, self.speed = axis, size, speed
        self.prefix = f"{axis} "
        self.unit, kind = ("N m", "moment") if axis == "yaw" else ("N", "force")
        self.place = f"{axis} {kind}"

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hook that adds the generic force, a smooth function of time, to one trial."""
        known = [FORCE_AXES[self.axis], beat_hz(trial), *_window(trial), self.speed]
        return Hooks(force=(ExternalForce(smooth_force, np.concatenate((known, values))),))


class ResidualPush(Description):
    """Smooth force on the body of a rig, which has one coordinate."""

    place = "surge force"
    terms = RIG_TERMS
    prefix = "surge "
    unit = "N"

    def __init__(self, size: float, speed: float, span: float) -> None:
        self.size, self.speed, self.span = size, speed, span

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hook that adds the generic force, a smooth function of time, to one trial."""
        known = [*_window(trial), self.speed, self.span]
        return Hooks(force=(ExternalForce(smooth_push, np.concatenate((known, values))),))


class StrokeDeviation(Description):
    """Smooth change of the commanded joint angle: gain, bias, phase and cubic distortion.

    The gain and the bias may drift.
    """

    place = "stroke"
    terms = ("gain", "gain x time", "bias", "bias x time", "quarter-beat", "cubic")
    size = 0.03

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hook that changes the joint angles of one trial by gain, bias, phase and distortion."""
        begin, length = _window(trial)
        quarter = 0.25 / beat_hz(trial)

        def change(time: Array, angle: Array, joint: int) -> Array:
            late = (time - begin) / length
            ease = np.clip((time - begin) / 0.5, 0.0, 1.0)
            ease = ease * ease * (3.0 - 2.0 * ease)
            top = max(float(np.nanmax(np.abs(angle))), 1e-9)
            shifted = np.interp(time - quarter, time, angle)
            parts = (angle, angle * late, top * ease, top * ease * late, shifted, angle**3 / top**2)
            return np.asarray(angle + sum(v * p for v, p in zip(values, parts, strict=True)))

        return Hooks(command=(change,))


class SensorTerm(Description):
    """Smooth error of one sensor channel."""

    size = 0.02

    def __init__(self, channel: str, top: float, *, dynamic: bool) -> None:
        self.channel, self.top = channel, top
        self.terms = SENSOR_TERMS
        if not dynamic:
            self.terms = ("gain", "quadratic")
        self.prefix = f"{channel} "
        self.place = f"sensor of {channel}"

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hook that adds the weighted sum of the terms to the simulated channel of one trial."""
        begin, length = _window(trial)
        turn = 2.0 * math.pi * beat_hz(trial)

        def change(channels: dict[str, Array], time: Array) -> dict[str, Array]:
            y = channels[self.channel]
            late = (time - begin) / length
            first = y[0] if len(y) > 1 else 0.0
            by_name = {
                "gain": y - first,
                "drift": self.top * late,
                "drift squared": self.top * late**2,
                "cos phase": self.top * np.cos(turn * time),
                "sin phase": self.top * np.sin(turn * time),
                "quadratic": (y - first) * np.abs(y - first) / self.top,
            }
            error = sum(v * by_name[name] for v, name in zip(values, self.terms, strict=True))
            return {**channels, self.channel: y + error}

        return Hooks(output=(change,))


class StrokeTable(Description):
    """Smooth factor on the thrust of steady swimming, for trials from a table of swimming speeds.

    The logarithm of the factor is quadratic in the logarithms of frequency and amplitude, and linear in the
    order of the trials. It has one more term for each fin and for each level of frequency and amplitude.
    """

    place = "thrust"
    curve = (
        "frequency", "frequency squared", "amplitude", "amplitude squared", "product", "order",
    )  # fmt: skip
    size = 0.1

    def __init__(self, trials: Sequence[Trial]) -> None:
        frequency, amplitude = (
            np.concatenate([t.inputs[name] for t in trials if name in t.inputs])
            for name in ("frequency_hz", "amplitude_rad")
        )
        self.frequency_hz, self.amplitude_rad = float(np.median(frequency)), float(np.median(amplitude))
        self.order = {t.id: k / max(len(trials) - 1, 1) - 0.5 for k, t in enumerate(trials)}
        self.levels = {"frequency": _levels(frequency), "amplitude": _levels(amplitude)}
        fins = list(dict.fromkeys(t.cruise.fin for t in trials if t.cruise.fin))
        self.fins = fins if len(fins) > 1 else []
        each = [f"{kind} {level:.4g}" for kind, levels in self.levels.items() for level in levels]
        self.terms = (*self.curve, *each, *(f"fin {name}" for name in self.fins))

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hook that multiplies the thrust of a trial by the exponential of the weighted terms."""

        def change(stroke):  # type: ignore[no-untyped-def]
            f = np.log(stroke.frequency_hz / self.frequency_hz)
            a = np.log(stroke.amplitude_rad / self.amplitude_rad)
            parts = [f, f**2, a, a**2, f * a, self.order.get(trial.id, 0.0)]
            for kind, levels in self.levels.items():
                mine = trial.inputs[f"{kind}_{'hz' if kind == 'frequency' else 'rad'}"]
                parts += [np.isclose(mine, level, rtol=LEVEL) for level in levels]
            parts += [float(name == trial.cruise.fin) for name in self.fins]
            factor = np.exp(np.clip(sum(v * p for v, p in zip(values, parts, strict=True)), -3.0, 3.0))
            return replace(stroke, thrust=stroke.thrust * factor)

        return Hooks(stroke=(change,))


def _levels(values: Array) -> list[float]:
    """Return the levels of a setting: values that at least :data:`SHARED` rows of a table have in common.

    The result is empty if there is only one such level, or more than :data:`LEVELS`.
    """
    rounded = np.unique(values.round(6))
    shared = [float(v) for v in rounded if np.isclose(values, v, rtol=LEVEL).sum() >= SHARED]
    if not 1 < len(shared) <= LEVELS:
        return []
    return shared


def _window(trial: Trial) -> tuple[float, float]:
    """Return the start time and the duration of a trial, s."""
    return float(trial.time_s[0]), max(float(trial.time_s[-1] - trial.time_s[0]), 1e-9)


def beat_hz(trial: Trial) -> float:
    """Return the beat frequency of a trial in Hz. Without a beat, return one over the trial's duration."""
    drive = trial.swim.drive
    if drive is not None and drive.frequency_hz > 0:
        return float(drive.frequency_hz)
    if trial.surge.frequency_hz > 0:
        return trial.surge.frequency_hz
    length = float(trial.time_s[-1] - trial.time_s[0])
    if length <= 0:
        return 1.0
    return 1.0 / length


def list_descriptions(model: Model, trials: Sequence[Trial]) -> list[Description]:
    """Return all generic descriptions of residuals for which the model has hooks and the trials have data."""
    dynamic = any(len(t.time_s) > 1 for t in trials)
    descriptions: list[Description] = []
    if "force" in model.offers and dynamic:
        descriptions += _list_forces(model, trials)
    if "command" in model.offers and dynamic:
        descriptions.append(StrokeDeviation())
    if "stroke" in model.offers and any({"frequency_hz", "amplitude_rad"} <= t.inputs.keys() for t in trials):
        descriptions.append(StrokeTable(trials))
    for channel in _channels(trials):
        descriptions.append(SensorTerm(channel, _top(trials, channel, 1e-6), dynamic=dynamic))
    return descriptions


def _channels(trials: Sequence[Trial]) -> list[str]:
    """Return the measured channels of all trials."""
    return sorted({c for t in trials for c in t.measured})


def _top(trials: Sequence[Trial], channel: str, least: float) -> float:
    """Return the largest absolute change of a channel since the start of a trial, at least ``least``."""
    series = (t.measured[channel] for t in trials if channel in t.measured)
    present = (y[np.isfinite(y)] for y in series)
    return max([least, *(float(np.max(np.abs(y - y[0]))) for y in present if len(y) > 1)])


def _describe_push(trials: Sequence[Trial], length_s: float) -> ResidualPush:
    """Return the force on a rig, whose size follows from the pulls and from the motion of the body."""
    spans = [_top(trials, c, 1e-3) for c in _channels(trials) if not c.endswith(("_s", "_s2"))]
    span = max(spans, default=1.0)
    inertia = [t.rig.inertia for t in trials if not math.isnan(t.rig.inertia)]
    mass = float(np.median(inertia)) if inertia else 1.0
    pushes = [abs(t.rig.pull) for t in trials]
    swing = [0.01 * mass * span * (2 * math.pi * beat_hz(t)) ** 2 for t in trials]
    return ResidualPush(0.02 * max(*pushes, *swing, 1e-9), max(span / length_s, 1e-3), span)


def _list_forces(model: Model, trials: Sequence[Trial]) -> list[Description]:
    """Return the forces on a rig, or on the base of a robot that moves freely."""
    length = max((float(t.time_s[-1] - t.time_s[0]) for t in trials), default=1.0) or 1.0
    if model.swimmer is None:
        return [_describe_push(trials, length)]
    if model.body is None or not model.body.free:
        return []
    arm = sum(model.body.lengths_m)
    distance = max((_top(trials, c, 1e-3) for c in _channels(trials) if c.endswith("_m")), default=1.0)
    speed = max(distance / length, 1e-3)
    push = 0.02 * model.scales(trials).inertia * speed**2 / max(arm, 1e-3)
    sizes = {axis: push * (arm if axis == "yaw" else 1.0) for axis in FORCE_AXES}
    return [ResidualForce(axis, size, speed) for axis, size in sizes.items()]
