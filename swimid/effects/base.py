"""Base class of effects (unmodelled physics), and parts of which effects are made.

An effect has a name, parameters without influence at their start values, and hooks. Hooks are functions that
change a simulation (:class:`~swimid.fitting.model.Hooks`). The ``stage`` of an effect is the part of the
simulated system on which the effect acts.
"""

from __future__ import annotations

import itertools
import math
import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from swimid.files.kernels import numba
from swimid.fitting.model import (
    MEAN_SPEED,
    POSITIONS,
    Array,
    Command,
    ExternalForce,
    Hooks,
    Model,
    Parameter,
    Stroke,
    Trial,
    typical,
)

if TYPE_CHECKING:
    from swimid.swimmer.planar.model import PlanarBody

Choice = TypeVar("Choice")
Stage = Literal["actuation", "structure", "fluid", "environment", "sensing", "rig"]
STAGES: tuple[Stage, ...] = ("actuation", "structure", "fluid", "environment", "sensing", "rig")
Trials = Sequence[Trial]
Parameters = tuple[Parameter, ...]
#: Type of :attr:`Effect.inside`: for each parameter name, the bound from which an estimate must keep a
#: distance.
Inside = Mapping[str, Literal["lower", "upper"]]
#: Parameter values at which an effect is simulated before a fit, in units of the parameters' scales.
SIZES = (0.5, 1.2, 3.0)

#: Effects that are identified by their Python id, because their attributes cannot be compared. They are kept
#: alive, so that no other object gets the same id.
_KEPT: dict[int, Effect] = {}


class Effect(ABC):
    """Physical effect that a model may lack, and that then causes differences between model and trials.

    Attributes
    ----------
    name : str
        Name in the gap file, with hyphens.
    stage : str
        Part of the simulated system on which the effect acts. For an effect of this package it is the name of
        the module.
    meaning : str
        One sentence for the report.
    sources : tuple of str
        Papers and sections that describe the effect.
    needs : frozenset of str
        Names of hooks, of which a model must offer at least one. Effects with their own :meth:`applies` or
        :meth:`variants` need none.
    scatters : bool
        Whether the effect may differ at random between trials, as a trim or a clock does. A diagnosis then
        also considers it as a random effect.
    smooth : bool
        Whether the change of the simulation is nearly proportional to the parameters. A simulation with one
        size of the effect is then enough.
    inside : mapping of name to end
        Bounds, ``lower`` or ``upper``, from which an estimate must keep at least the parameter's scale.
        Closer to the bound the effect could imitate others, and is not accepted as a hypothesis.
    own : tuple of str
        Parameters of a model with the same meaning as the effect. A model that estimates one of them does not
        lack the effect.
    of_model : str or None
            Kind of model, such as ``"mjcf"``, for which this effect is a special form. For such models it
            replaces the general effect of the same name. None for the general effect.
    adds_to : str or None
        Name of the model parameter to which the only parameter of the effect is added. Such an effect has no
        hooks.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    meaning: ClassVar[str]
    sources: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[frozenset[str]] = frozenset()
    scatters: ClassVar[bool] = False
    smooth: ClassVar[bool] = False
    inside: ClassVar[Inside] = {}
    own: ClassVar[tuple[str, ...]] = ()
    of_model: ClassVar[str | None] = None
    adds_to: ClassVar[str | None] = None

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        package, _, module = cls.__module__.rpartition(".")
        if package == "swimid.effects" and module in STAGES:
            cls.stage = module

    @abstractmethod
    def parameters(self, model: Model, trials: Sequence[Trial]) -> tuple[Parameter, ...]:
        """Return the parameters of the effect. At their ``start`` values the effect has no influence."""

    @abstractmethod
    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return the hooks by which the effect changes the simulation of one trial.

        Parameters
        ----------
        values : ndarray, shape (len(parameters),)
            Values of the effect's parameters. A per-trial parameter has the value of this trial.
        """

    def applies(self, model: Model, trials: Sequence[Trial]) -> bool:
        """Return whether the effect can act on the given model in the given trials."""
        return bool(self.needs & model.offers) and not model.estimates(*self.own)

    def variants(self, model: Model, trials: Sequence[Trial]) -> Sequence[Effect]:
        """Return the forms of the effect that apply to a model, for example one form for each joint or wall.

        The result is empty if the effect does not apply.
        """
        return [self] if self.applies(model, trials) else []

    def joins(self, effects: Sequence[Effect]) -> bool:
        """Return whether the effect may act together with the given effects. No effect acts twice."""
        return self.name not in {e.name for e in effects}

    def in_place_of(self, model: Model) -> Model:
        """Return the model on which all effects act. An effect may replace the given model by another one."""
        return model

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors, within bounds, at which the effect is simulated before a fit.

        For a smooth effect these are a small and a large value of each parameter. The small value has one
        sign only.
        """
        null = np.array([p.start for p in parameters])
        points: list[Array] = []
        for k, p in enumerate(parameters):
            near = 0
            for size, sign in itertools.product(SIZES[::2] if self.smooth else SIZES, (1.0, -1.0)):
                value = p.start + sign * size * p.scale
                if not p.lower <= value <= p.upper or (self.smooth and size == SIZES[0] and near):
                    continue
                near += size == SIZES[0]
                point = null.copy()
                point[k] = value
                points.append(point)
        return points

    def content(self) -> bytes:
        """Return bytes that identify the effect.

        Effects of one class with equal attributes have the same identity.
        """
        kind = type(self)
        try:
            return pickle.dumps((kind.__module__, kind.__qualname__, sorted(vars(self).items())))
        except (pickle.PicklingError, AttributeError, TypeError):
            # The attributes of an effect that contains a function cannot be compared. It is identified by its
            # id.
            _KEPT[id(self)] = self
            return f"{kind.__qualname__} {id(self)}".encode()

    def __repr__(self) -> str:
        return f"<effect {self.name}>"


#: Type of the result of :meth:`Effect.variants`: the forms of an effect that apply to a model.
Effects = Sequence[Effect]


# ---------------------------------------------------------------- parts of effects

#: Assumed amplitude of a servo or joint, rad, if the trials state none.
USUAL_ANGLE = 0.3
SPEEDS = ("u_m_s", "v_m_s", "w_m_s", MEAN_SPEED)
#: Channels whose unit contains a length.
LENGTHS = (*POSITIONS, *SPEEDS)
#: Channels of a swimmer's pose that a camera measures.
POSES = (*POSITIONS, "yaw_rad", "pitch_rad")
#: Channels of a gyroscope that is fixed to the body.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def parameter(
    name: str,
    unit: str,
    scale: float,
    meaning: str,
    lower: float = -math.inf,
    upper: float = math.inf,
    *,
    start: float = 0.0,
    per_trial: bool = False,
) -> Parameter:
    """Return a parameter of an effect. By default it starts at 0, where the effect has no influence."""
    return Parameter(name, unit, lower, upper, start, scale, per_trial=per_trial, meaning=meaning)


# ---------------------------------------------------------------- models


def pick_by_motion(model: Model, along: Choice, about: Choice) -> Choice:
    """Return ``about`` if the model is a rig whose only coordinate is an angle, otherwise ``along``."""
    return about if model.rig is not None and model.rig.rotation else along


def is_pulled(model: Model) -> bool:
    """Return whether a model is a body on a rig that is pulled over a distance."""
    return model.rig is not None and not model.rig.swings


def has_pulley(trials: Trials) -> bool:
    """Return whether the rig of some trial has a pulley."""
    return any(trial.rig.pulley for trial in trials)


def is_held(model: Model) -> bool:
    """Return whether a model is a robot with links in a plane whose base is fixed."""
    return model.body is not None and not model.body.free


def free_body(model: Model) -> PlanarBody | None:
    """Return the body of a swimmer whose base moves; None for other models."""
    return model.body if model.body is not None and model.body.free else None


# ---------------------------------------------------------------- hooks


def add_to_coefficient(value: float, *names: str) -> Hooks:
    """Return hooks that add a value to a coefficient of a model's equation of motion.

    The coefficient is the first one among ``names`` that the equation has.
    """

    def change(coefficients: dict[str, float]) -> None:
        coefficients[next(name for name in names if name in coefficients)] += value

    return Hooks(coefficients=(change,))


def force_at_hull(body: PlanarBody, function: Any, constants: Array) -> ExternalForce:
    """Return a force that acts at the centre of mass of the heaviest link of a swimmer."""
    x, y = body.centre(body.hull)
    return ExternalForce(function, constants, body.hull, x, y)


def force_on_rig(function: Any, constants: Sequence[float] | Array, **places: int) -> Hooks:
    """Return hooks that add a force to the body of a rig.

    Parameters
    ----------
    **places : int
        Indices of the constants that are coefficients of the model, by the name of the coefficient.
    """
    values = np.array(constants, dtype=float)

    def take(coefficients: dict[str, float]) -> None:
        for name, place in places.items():
            values[place] = coefficients[name]

    return Hooks(coefficients=(take,), force=(ExternalForce(function, values),))


def change_springs(body: PlanarBody, change: Callable[[float], dict[str, float]]) -> Hooks:
    """Return hooks that change the springs and dampers of all passive joints.

    Parameters
    ----------
    change : callable
        Function that returns the changes (``stiffness``, ``cubic``, ``damping``, ``friction``) for a given
        stiffness.
    """

    def springs(tables: dict[str, Any]) -> None:
        for k in range(len(body.passive)):
            body.stiffen(tables, k, **change(body.stiffness(tables, k)))

    return Hooks(tables=(springs,))


class RigCoefficient(Effect, ABC):
    """Effect that adds to one coefficient of a rig's equation of motion, which the model does not estimate.

    Attributes
    ----------
    coefficient : str
        Name of the coefficient in the model's equation of motion.
    pulley : bool
        Whether the effect acts only in trials with a pulley.
    """

    smooth = True
    coefficient: ClassVar[str]
    pulley: bool = False

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must be a rig that does not estimate the coefficient.

        An effect of the pulley applies only if some trial has a pulley.
        """
        known = model.rig is None or model.estimates(*self.own)
        return not known and (not self.pulley or has_pulley(trials))

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the effect's parameter to the coefficient of the rig."""
        if self.pulley and not trial.rig.pulley:
            return Hooks()
        return add_to_coefficient(values[0], self.coefficient)


# ---------------------------------------------------------------- commands


class Actuation(Effect, ABC):
    """Effect of the actuator, for models in which joints follow a command and not a measured angle.

    A subclass with one parameter for all driven joints defines :meth:`follow`. It also defines
    :meth:`amplitude` if its ``needs`` include the stroke.
    """

    needs = frozenset({"command", "stroke"})
    #: Whether the effect is about angles. It then does not act on the inputs of a robot, such as thrusts.
    of_angles: ClassVar[bool] = False

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: a command must drive joints or inputs in some trial."""
        if self.of_angles and model.swimmer is not None and not model.swimmer.driven:
            return False
        return super().applies(model, trials) and any(model.is_commanded(t) for t in trials)

    def follow(self, value: float, time_s: Array, angle: Array) -> Array:
        """Return the motion of a joint that follows the command ``angle`` with the effect, shape (n,).

        Neither the command nor the motion has missing samples.
        """
        raise NotImplementedError

    def amplitude(self, value: float, stroke: Stroke) -> Array:
        """Return the joint amplitude of a steady beat with the effect, rad."""
        raise NotImplementedError

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that change the commands of the joints, and the amplitude of a steady beat."""
        value = float(values[0])

        def change_beat(stroke: Stroke) -> Stroke:
            return replace(stroke, amplitude_rad=self.amplitude(value, stroke))

        hooks = follow_commands(model, trial, partial(self.follow, value), of_angles=self.of_angles)
        return replace(hooks, stroke=(change_beat,)) if "stroke" in self.needs else hooks


def on_command(model: Model, trial: Trial, change: Command, *, of_angles: bool = False) -> Hooks:
    """Return hooks that apply ``change`` to the commands of a trial; no hooks without a command.

    A change of angles applies to the commands of joints, and not to the inputs of a robot.
    """
    if not model.is_commanded(trial):
        return Hooks()
    joints = len(model.swimmer.actuators) if of_angles and model.swimmer is not None else math.inf

    def command(time_s: Array, value: Array, number: int) -> Array:
        return change(time_s, value, number) if number < joints else value

    return Hooks(command=(command,))


def for_every_joint(change: Callable[[Array, Array], Array]) -> Command:
    """Return a hook that applies ``change`` to the command of every joint.

    For joints with the same command, the change is computed once.
    """
    last: tuple[Array, Array, Array] | None = None

    def command(time_s: Array, angle: Array, joint: int) -> Array:
        nonlocal last
        # Read the stored result once, because another thread may replace it.
        kept = last
        if kept is None or kept[0] is not time_s or kept[1] is not angle:
            kept = last = time_s, angle, change(time_s, angle)
            kept[2].flags.writeable = False
        return kept[2]

    return command


def follow_commands(
    model: Model, trial: Trial, change: Callable[[Array, Array], Array], *, of_angles: bool = False
) -> Hooks:
    """Return hooks that apply ``change`` to the command of every joint, across missing samples."""
    return on_command(model, trial, for_every_joint(partial(bridge_missing, change)), of_angles=of_angles)


@numba.njit(cache=True, nogil=True)
def hold_back(signal, half):  # type: ignore[no-untyped-def]
    """Follow a signal with play (backlash): the output moves only to stay within ``half`` of the signal.
    A position servo of stiffness k with dry friction T stands still while ``k |command - angle| < T``.

    Parameters
    ----------
    signal : ndarray, shape (n,)
    half : ndarray, shape (n,)
        Half the width of the play: ``T / k`` for a servo. It may change in time.

    Returns
    -------
    ndarray, shape (n,)
        Output, whose first value is that of the signal.
    """
    output = signal.copy()
    for i in range(1, len(signal)):
        output[i] = min(max(output[i - 1], signal[i] - half[i]), signal[i] + half[i])
    return output


def bridge_missing(change: Callable[[Array, Array], Array], time_s: Array, signal: Array) -> Array:
    """Apply ``change`` to a signal that has missing samples.

    Missing samples are interpolated before the change, and are missing again after the change.
    """
    there = np.isfinite(signal)
    if there.all():
        return change(time_s, signal)
    if not there.any():
        return signal
    filled = np.interp(time_s, time_s[there], signal[there])
    return np.where(there, change(time_s, filled), np.nan)


def _signals(model: Model, trials: Trials) -> Iterator[tuple[Array, Array, float]]:
    """Yield time, command and largest known rate of the command, for each driven joint of each trial."""
    for trial in trials:
        if model.is_commanded(trial):
            yield from model.commands(trial)


def _strokes(trials: Trials) -> tuple[Array, Array]:
    """Return the frequencies (Hz) and amplitudes (rad) of all steady beats of the trials."""
    beats = [np.zeros((2, 0)), *(np.stack(trial.steady) for trial in trials)]
    frequency, amplitude = np.concatenate(beats, axis=1)
    there = np.isfinite(frequency) & np.isfinite(amplitude) & (frequency > 0) & (amplitude > 0)
    return frequency[there], amplitude[there]


def typical_amplitude(model: Model, trials: Trials) -> float:
    """Return the typical amplitude of a driven joint, rad.

    For a black-box model it is the typical amplitude of the input, in the unit of the input.
    """
    sizes = [0.5 * float(np.ptp(s)) for _, s, _ in _signals(model, trials) if len(s) and np.ptp(s) > 0]
    return typical(sizes or list(_strokes(trials)[1]), USUAL_ANGLE)


def largest_rate(model: Model, trials: Trials) -> float:
    """Return the largest rate of change of the joint commands, rad/s.

    For a black-box model it is that of the input, in the unit of the input per second.
    """
    rates = []
    for time, signal, rate in _signals(model, trials):
        rates.append(rate)
        if len(time) > 1:
            rates.append(float(np.max(np.abs(np.diff(signal) / np.diff(time)))))
    frequency, amplitude_rad = _strokes(trials)
    rates.extend(2 * math.pi * frequency * amplitude_rad)
    return float(max(rates, default=0.0)) or 1.0


def typical_period(model: Model, trials: Trials) -> float:
    """Return the typical period of the beat in the trials, s; one second if it is unknown."""
    return 1.0 / typical([f for f in (*model.beats(trials), *_strokes(trials)[0]) if f > 0], 1.0)


# ---------------------------------------------------------------- channels


def select_measured(names: Sequence[str], trials: Trials) -> list[str]:
    """Return those of the named channels that have samples in some trial."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]


class ClockError(Effect, ABC):
    """Error of the clock of a log, or only of the clock of the camera.

    Parameters
    ----------
    camera : bool
        Whether only the poses have the clock with the error.
    """

    needs = frozenset({"clock"})
    smooth = True

    def __init__(self, *, camera: bool = False) -> None:
        self.camera = camera

    def variants(self, model: Model, trials: Trials) -> Sequence[Effect]:
        """Return the form for the clock of the whole log, and the form for the clock of the camera.

        The camera may have its own clock if the log has turn rates or joint angles in addition to poses.
        Joint angles that drive the simulation do not count, because the clock of the log is relative to them.
        """
        forms = [*super().variants(model, trials)]
        measured = {c for t in trials for c in t.measured if c not in model.list_input_channels(t)}
        aboard = any(c.endswith(("_rad", "_rate_rad_s")) for c in measured - set(POSES))
        if "output" in model.offers and aboard and measured & set(POSES):
            forms.append(type(self)(camera=True))
        return forms


def shift_poses(trial: Trial, happened: Callable[[Array], Array]) -> Hooks:
    """Return hooks for a camera with its own clock.

    A sample with time stamp ``time_s`` has the pose of the time ``happened(time_s)``.
    """

    def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
        # A cubic spline extrapolates well over two samples, but not further.
        end = time_s[-1] + 2.0 * np.median(np.diff(time_s))
        then = np.clip(happened(time_s), time_s[0], end)
        poses = [c for c in POSES if c in channels]
        values = np.column_stack([channels[c] for c in poses])
        # Interpolate only channels without missing samples. The spline cannot handle missing samples.
        sound = np.isfinite(values).all(axis=0)
        shifted = np.full(values.shape, np.nan)
        shifted[:, sound] = CubicSpline(time_s, values[:, sound])(then)
        return {**channels, **dict(zip(poses, shifted.T, strict=True))}

    return Hooks(output=(observe,) * (len(trial.time_s) > 3))


class Sensing(Effect, ABC):
    """Effect of a sensor that changes each of its log channels independently of the others.

    The effect applies if one of these channels is measured.
    """

    needs = frozenset({"output"})
    channels: ClassVar[tuple[str, ...]]

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: one of the channels that it changes must be measured."""
        return super().applies(model, trials) and bool(select_measured(self.channels, trials))

    def show(self, change: Callable[[str, Array], Array]) -> Hooks:
        """Return hooks that apply ``change(name, simulated)`` to every channel of the effect."""

        def observe(channels: dict[str, Array], time_s: Array) -> dict[str, Array]:
            mine = {n: change(n, v) for n, v in channels.items() if n in self.channels}
            return {**channels, **mine}

        return Hooks(output=(observe,))
