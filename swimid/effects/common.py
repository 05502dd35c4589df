"""What several effects are made of: their parameters, what they ask of a model, and hooks of one kind."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numba
import numpy as np
from scipy.interpolate import CubicSpline

from swimid.effects.base import Array, Effect, Effects, Hooks, Model, Parameter, Trial, Trials
from swimid.fitting.hooks import Command, Force, Stroke
from swimid.fitting.model import MEAN_SPEED, POSITIONS

if TYPE_CHECKING:
    from swimid.swimmer.planar.model import Body

#: Where no command says how large: an angle a servo turns, rad.
USUAL_ANGLE = 0.3
SPEEDS = ("u_m_s", "v_m_s", "w_m_s", MEAN_SPEED)
#: What a camera, or an encoder on a rig, measures as a length.
LENGTHS = (*POSITIONS, *SPEEDS)
#: What a camera tells of a swimmer's pose.
POSES = (*POSITIONS, "yaw_rad", "pitch_rad")
#: What a gyroscope in the body measures.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def parameter(
    name: str,
    unit: str,
    scale: float,
    meaning: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    start: float = 0.0,
    per_trial: bool = False,
) -> Parameter:
    """A parameter of an effect; most vanish at zero."""
    return Parameter(name, unit, lower, upper, start, scale, per_trial=per_trial, meaning=meaning)


# ---------------------------------------------------------------- models


def rotates(model: Model) -> bool:
    """Whether it has one coordinate, and that is an angle."""
    return model.rig is not None and model.rig.rotation


def pulled(model: Model) -> bool:
    """Whether it is a body on a rig that is pulled from place to place."""
    return model.rig is not None and not model.rig.swings


def with_pulley(trials: Trials) -> bool:
    """Whether some trial has a pulley."""
    return any(trial.rig.pulley for trial in trials)


def free_body(model: Model) -> Body | None:
    """Its links where the base moves."""
    return model.body if model.body is not None and model.body.free else None


def links(model: Model) -> Body:
    """Its links, for an effect that applies to nothing else."""
    assert model.body is not None
    return model.body


# ---------------------------------------------------------------- hooks


def more(coefficient: str, value: float) -> Hooks:
    """More of one coefficient of a model's equation."""

    def change(coefficients: dict[str, float]) -> None:
        coefficients[coefficient] += value

    return Hooks(coefficients=(change,))


def at_hull(body: Body, function: Any, constants: Array) -> Force:
    """A force at the centre of mass of the heaviest link."""
    x, y = body.centre(body.hull)
    return Force(function, constants, body.hull, x, y)


class RigCoefficient(Effect, ABC):
    """More of one coefficient of a rig's equation, where the model does not estimate it.

    Attributes
    ----------
    coefficient : str
        In the model's equation.
    own : tuple of str
        Parameters of the model that stand for the same.
    pulley : bool
        Whether it acts only in trials that have one.
    """

    needs = frozenset({"coefficients"})
    smooth = True
    coefficient: ClassVar[str]
    own: ClassVar[tuple[str, ...]] = ()
    pulley: bool = False

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Rigs whose model does not estimate it, of a pulley's those with one."""
        applies = model.rig is not None and not model.estimates(*self.own)
        return [self] if applies and (not self.pulley or with_pulley(trials)) else []

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Adds to the coefficient."""
        acts = trial.rig.pulley or not self.pulley
        return more(self.coefficient, values[0]) if acts else Hooks()


# ---------------------------------------------------------------- commands


class Actuation(Effect, ABC):
    """An effect of the actuator; it applies where a command, not a measured joint angle, drives the model.

    Of one parameter, the same for every driven joint, an effect says what it makes of a command and, where it
    ``needs`` the stroke, of a steady beat's amplitude.
    """

    needs = frozenset({"command", "stroke"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where some trial is driven by a command."""
        return [self] if self.needs & model.offers and any(model.commanded(t) for t in trials) else []

    def followed(self, value: float, time_s: Array, angle: Array) -> Array:
        """What a joint does on a command, shape (n,), without missing samples."""
        raise NotImplementedError

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """What is left of the amplitude of a steady beat, rad."""
        raise NotImplementedError

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """What becomes of the commands, and of a steady beat."""
        value = float(values[0])

        def command(time_s: Array, angle: Array) -> Array:
            return bridged(lambda time, whole: self.followed(value, time, whole), time_s, angle)

        def beaten(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=self.amplitude(value, stroke))

        return Hooks(
            command=(every_joint(command),) if model.commanded(trial) else (),
            stroke=(beaten,) if "stroke" in self.needs else (),
        )


def every_joint(change: Callable[[Array, Array], Array]) -> Command:
    """A hook that does the same to every joint: joints that are told the same cost it once."""
    last: tuple[Array, Array, Array] | None = None

    def command(time_s: Array, angle: Array, joint: int) -> Array:
        nonlocal last
        known = last
        if known is None or known[0] is not time_s or known[1] is not angle:
            known = last = time_s, angle, change(time_s, angle)
            known[2].flags.writeable = False
        return known[2]

    return command


def held_back(signal: Array, half: Array) -> Array:
    """What follows a signal only where it is farther away than friction holds: the play operator.

    A position servo of stiffness k against a dry friction T stands still while ``k |command - angle| < T``.

    Parameters
    ----------
    signal : ndarray, shape (n,)
    half : ndarray, shape (n,)
        The distance ``T / k``; it may change in time.

    Returns
    -------
    ndarray, shape (n,)
        It starts on the signal.
    """
    return np.asarray(_play(signal, half))


@numba.njit(cache=True, nogil=True)
def _play(signal, half):  # type: ignore[no-untyped-def]
    output = signal.copy()
    for i in range(1, len(signal)):
        output[i] = min(max(output[i - 1], signal[i] - half[i]), signal[i] + half[i])
    return output


def bridged(change: Callable[[Array, Array], Array], time_s: Array, signal: Array) -> Array:
    """``change`` of a signal whose missing samples are bridged by straight lines, and missing again after."""
    there = np.isfinite(signal)
    if there.all():
        return change(time_s, signal)
    if not there.any():
        return signal
    filled = np.interp(time_s, time_s[there], signal[there])
    return np.where(there, change(time_s, filled), np.nan)


def _signals(model: Model, trials: Trials) -> Iterator[tuple[Array, Array, float]]:
    """Time, command and its fastest known rate, of each driven joint of each trial."""
    for trial in trials:
        if model.commanded(trial):
            yield from model.commands(trial)


def _strokes(trials: Trials) -> tuple[Array, Array]:
    """Frequency (Hz) and amplitude (rad) of every steady beat."""
    beats = [np.zeros((2, 0)), *(np.stack(trial.steady) for trial in trials)]
    frequency, amplitude = np.concatenate(beats, axis=1)
    there = np.isfinite(frequency) & np.isfinite(amplitude) & (frequency > 0) & (amplitude > 0)
    return frequency[there], amplitude[there]


def amplitude(model: Model, trials: Trials) -> float:
    """Typical amplitude of a driven joint, rad (or the unit of a black box's input)."""
    sizes = [0.5 * float(np.ptp(s)) for _, s, _ in _signals(model, trials) if len(s) and np.ptp(s) > 0]
    if not sizes:
        sizes = list(_strokes(trials)[1])
    return float(np.median(sizes)) if sizes else USUAL_ANGLE


def fastest(model: Model, trials: Trials) -> float:
    """Largest commanded rate, rad/s (or the unit of a black box's input, per second)."""
    rates = [r for _, _, r in _signals(model, trials)]
    for time, signal, _ in _signals(model, trials):
        if len(time) > 1:
            rates.append(float(np.max(np.abs(np.diff(signal) / np.diff(time)))))
    frequency, amplitude_rad = _strokes(trials)
    rates.extend(2 * math.pi * frequency * amplitude_rad)
    return float(max(rates, default=0.0)) or 1.0


def period(model: Model, trials: Trials) -> float:
    """Typical period of the beat, s; one second where none is known."""
    beats = [f for f in (*model.beats(trials), *_strokes(trials)[0]) if f > 0]
    return 1.0 / float(np.median(beats)) if beats else 1.0


# ---------------------------------------------------------------- channels


def measured(names: Sequence[str], trials: Trials) -> list[str]:
    """Those of the channels that some trial has samples of."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]


def clocks_apart(model: Model, trials: Trials) -> bool:
    """Whether a camera's poses stand beside the robot's own turn rates, each with a clock of its own."""
    measured = {c for t in trials for c in t.measured}
    rates = any(c.endswith("_rate_rad_s") for c in measured)
    return "output" in model.offers and rates and bool(measured & set(POSES))


def poses_at(trial: Trial, happened: Callable[[Array], Array]) -> Hooks:
    """Poses of a camera whose clock is not the robot's: at each time those of when it ``happened``."""

    def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
        # a cubic carries on for two samples beyond the run, not for more
        end = time_s[-1] + 2.0 * np.median(np.diff(time_s))
        then = np.clip(happened(time_s), time_s[0], end)
        poses = [c for c in POSES if c in channels]
        values = np.column_stack([channels[c] for c in poses])
        # a simulation that broke down is missing altogether
        sound = np.isfinite(values).all(axis=0)
        shifted = np.full(values.shape, np.nan)
        shifted[:, sound] = CubicSpline(time_s, values[:, sound])(then)
        return {**channels, **dict(zip(poses, shifted.T, strict=True))}

    return Hooks(output=(seen,) if len(trial.time_s) > 3 else ())


class Sensing(Effect, ABC):
    """An effect on each of some channels by itself; it applies where one of them is measured."""

    needs = frozenset({"output"})
    channels: ClassVar[tuple[str, ...]]

    def variants(self, model: Model, trials: Trials) -> Effects:
        """The effect itself where such a channel is measured."""
        return super().variants(model, trials) if measured(self.channels, trials) else []

    def shown(self, change: Callable[[str, Array], Array]) -> Hooks:
        """The hooks of ``change(name, simulated)``, the same for every channel."""

        def seen(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            return {n: change(n, v) if n in self.channels else v for n, v in channels.items()}

        return Hooks(output=(seen,))
