"""Describe the remaining residuals without physics: smooth forces, strokes and sensor terms.

They show whether structure is left and where it acts. They are never a cause. After Kennedy and O'Hagan
(2001): a model discrepancy with a prior of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numba import cfunc

from swimid.effects.base import Effect, Stage
from swimid.fitting.hooks import FORCE_SIGNATURE, Force, Hooks, traceable
from swimid.fitting.model import Array, Model, Parameter, Trial

#: Variables of a residual force, in the order of its factors.
TERMS = (
    "constant", "speed", "speed squared", "sway", "yaw rate", "time", "cos phase", "sin phase", "cos 2 phase",
    "sin 2 phase", "cos phase x time", "sin phase x time",
)  # fmt: skip
#: A setting of a table is a level of its own if at least this many runs share it, within this relative
#: tolerance, and there are at most this many levels.
SHARED, LEVEL, LEVELS = 3, 1e-3, 12
AXES = {"surge": 0, "sway": 1, "yaw": 2}


@traceable(on="base", constants=17)
def smooth_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Return a smooth force for (axis, beat frequency (Hz), start and length of the trial, typical speed,
    factors).
    """
    u, v, r = velocity[0] / constants[4], velocity[1] / constants[4], velocity[2]
    late = (t - constants[2]) / constants[3]
    phase = 2.0 * math.pi * constants[1] * t
    c, s = math.cos(phase), math.sin(phase)
    f = constants[5] + constants[6] * u + constants[7] * u * abs(u) + constants[8] * v + constants[9] * r
    f += constants[10] * late + constants[11] * c + constants[12] * s
    f += constants[13] * (c * c - s * s) + constants[14] * 2.0 * c * s
    f += (constants[15] * c + constants[16] * s) * late
    # Only the requested axis has a force.
    for axis in range(3):
        wrench[axis] += f * max(1.0 - abs(constants[0] - axis), 0.0)


#: Variables of a residual force on a body with one coordinate.
RIG_TERMS = (
    "constant", "speed", "speed squared", "speed cubed", "place", "place squared", "place cubed", "time",
)  # fmt: skip
#: Terms of the error of a channel.
SENSOR_TERMS = ("gain", "drift", "drift squared", "cos phase", "sin phase", "quadratic")


@cfunc(FORCE_SIGNATURE, cache=True)
def smooth_push(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Return a smooth force on a rig for (start and length of the trial, typical speed and place,
    factors).
    """
    late = (t - constants[0]) / constants[1]
    u, x = velocity[0] / constants[2], pose[0] / constants[3]
    f = constants[4] + constants[5] * u + constants[6] * u * abs(u) + constants[7] * u**3
    wrench[0] += f + constants[8] * x + constants[9] * x * x + constants[10] * x**3 + constants[11] * late


class Description(Effect):
    """A description without physics."""

    stage: ClassVar[Stage] = "fluid"
    meaning: ClassVar[str] = "what is left, without physics"
    #: Place where it acts, in words.
    place: str = ""
    #: Terms, prefix of their names, and unit and typical size of their factors.
    terms: tuple[str, ...] = ()
    prefix: str = ""
    unit: str = "1"
    size: float

    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return one factor for each term."""
        return tuple(
            Parameter(f"{self.prefix}{term}", self.unit, -math.inf, math.inf, 0.0, self.size)
            for term in self.terms
        )

    def tries(self, parameters: Sequence[Parameter]) -> list[Array]:
        """Return each parameter at its typical size: the change is nearly linear."""
        return [np.eye(len(parameters))[k] * p.scale for k, p in enumerate(parameters)]


class ResidualForce(Description):
    """A smooth force on the base link, or on the body of a rig, along one axis."""

    name: ClassVar[str] = "residual-force"
    needs: ClassVar[frozenset[str]] = frozenset({"force"})

    terms = TERMS

    def __init__(self, axis: str, size: float, speed: float) -> None:
        self.axis, self.size, self.speed = axis, size, speed
        self.prefix = f"{axis} "
        self.unit, kind = ("N m", "moment") if axis == "yaw" else ("N", "force")
        self.place = f"{axis} {kind}"

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the force of one trial."""
        known = [AXES[self.axis], beat_hz(trial), *_window(trial), self.speed]
        return Hooks(force=(Force(smooth_force, np.concatenate((known, values))),))


class ResidualPush(Description):
    """A smooth force on the body of a rig."""

    name: ClassVar[str] = "residual-push"
    needs: ClassVar[frozenset[str]] = frozenset({"force"})
    place = "surge force"
    terms = RIG_TERMS
    prefix = "surge "
    unit = "N"

    def __init__(self, size: float, speed: float, span: float) -> None:
        self.size, self.speed, self.span = size, speed, span

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the force of one trial."""
        known = [*_window(trial), self.speed, self.span]
        return Hooks(force=(Force(smooth_push, np.concatenate((known, values))),))


class StrokeDeviation(Description):
    """A smooth change of the actuator motion: harmonics of the command and their drift."""

    name: ClassVar[str] = "residual-stroke"
    stage: ClassVar[Stage] = "actuation"
    needs: ClassVar[frozenset[str]] = frozenset({"command"})
    place = "stroke"
    terms = ("gain", "gain x time", "bias", "bias x time", "quarter-beat", "cubic")
    size = 0.03

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the stroke of one trial."""
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
    """A smooth error of one channel."""

    name: ClassVar[str] = "residual-sensor"
    stage: ClassVar[Stage] = "sensing"
    needs: ClassVar[frozenset[str]] = frozenset({"output"})

    size = 0.02

    def __init__(self, channel: str, top: float, *, dynamic: bool) -> None:
        self.channel, self.top = channel, top
        self.terms = SENSOR_TERMS if dynamic else ("gain", "quadratic")
        self.prefix = f"{channel} "
        self.place = f"sensor of {channel}"

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the channel of one trial."""
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
    """A factor on the thrust of a table of steady runs: smooth in frequency, amplitude and order, and one
    for each fin and each setting.
    """

    name: ClassVar[str] = "residual-thrust"
    stage: ClassVar[Stage] = "actuation"
    needs: ClassVar[frozenset[str]] = frozenset({"stroke"})
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
        """Return the thrust of one trial."""

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
    """Return settings that several runs of a table share; none if there are many."""
    rounded = np.unique(values.round(6))
    shared = [float(v) for v in rounded if np.isclose(values, v, rtol=LEVEL).sum() >= SHARED]
    return shared if 1 < len(shared) <= LEVELS else []


def _window(trial: Trial) -> tuple[float, float]:
    """Return the start of a trial and its length."""
    return float(trial.time_s[0]), max(float(trial.time_s[-1] - trial.time_s[0]), 1e-9)


def beat_hz(trial: Trial) -> float:
    """Return the frequency of the drive, or the lowest one that the trial resolves without a drive."""
    drive = trial.swim.drive
    if drive is not None and drive.frequency_hz > 0:
        return float(drive.frequency_hz)
    if trial.surge.frequency_hz > 0:
        return trial.surge.frequency_hz
    length = float(trial.time_s[-1] - trial.time_s[0])
    return 1.0 / length if length > 0 else 1.0


def descriptions(model: Model, trials: Sequence[Trial]) -> list[Description]:
    """Return all descriptions that the model's hooks allow and the trials can determine."""
    found: list[Description] = []
    dynamic = any(len(t.time_s) > 1 for t in trials)
    channels = sorted({c for t in trials for c in t.measured})

    def top(name: str, least: float) -> float:
        """Return the largest distance of a channel from its start."""
        series = (t.measured[name][np.isfinite(t.measured[name])] for t in trials if name in t.measured)
        return max([least, *(float(np.max(np.abs(y - y[0]))) for y in series if len(y) > 1)])

    length = max((float(t.time_s[-1] - t.time_s[0]) for t in trials), default=1.0) or 1.0
    if "force" in model.offers and dynamic:
        if model.body is None:
            span = max((top(c, 1e-3) for c in channels if not c.endswith(("_s", "_s2"))), default=1.0)
            inertia = [t.rig.inertia for t in trials if not math.isnan(t.rig.inertia)]
            mass = float(np.median(inertia)) if inertia else 1.0
            pushes = [abs(t.rig.pull) for t in trials]
            swing = [0.01 * mass * span * (2 * math.pi * beat_hz(t)) ** 2 for t in trials]
            found.append(ResidualPush(0.02 * max(*pushes, *swing, 1e-9), max(span / length, 1e-3), span))
        elif model.body.free:
            arm = sum(model.body.lengths_m)
            distance = max((top(c, 1e-3) for c in channels if c.endswith("_m")), default=1.0)
            speed = max(distance / length, 1e-3)
            push = 0.02 * model.scales(trials).inertia * speed**2 / max(arm, 1e-3)
            for axis in AXES:
                found.append(ResidualForce(axis, push * (arm if axis == "yaw" else 1.0), speed))
    if "command" in model.offers and dynamic:
        found.append(StrokeDeviation())
    if "stroke" in model.offers and any({"frequency_hz", "amplitude_rad"} <= t.inputs.keys() for t in trials):
        found.append(StrokeTable(trials))
    found += [SensorTerm(channel, top(channel, 1e-6), dynamic=dynamic) for channel in channels]
    return found
