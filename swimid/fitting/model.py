"""The one interface of every model.

A model is a robot plus an experiment: it has parameters with unit and bounds, output
channels, and it simulates a trial from parameter values. Fitting, comparing, diagnosing and
reporting are written once against this interface; a new model is one new file here.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError, suggestion
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.drives import CruiseInput, RigInput, SurgeInput, SwimInput
from swimid.fitting.hooks import NONE, Hooks
from swimid.progress import Progress, silent

Array = NDArray[np.float64]
#: Columns that hold a position, and the one of a timed run's mean speed.
POSITIONS = ("x_m", "y_m", "z_m")
MEAN_SPEED = "mean_speed_m_s"
#: Stretches into which a track is cut to find its speed, so that noise does not lengthen it.
STRETCHES = 12
Entry = TypeVar("Entry")
Outcome = TypeVar("Outcome")


@dataclass(frozen=True)
class Parameter:
    """One number a fit may estimate.

    Attributes
    ----------
    name, unit : str
        Unit in SI, ``"1"`` where there is none.
    lower, upper : float
        Bounds; infinite where there is none.
    start : float
        Where the search starts, and the value while it is fixed.
    scale : float
        A typical size: sets finite-difference steps, and how large an uncertainty is still
        called an estimate where the value is near zero.
    free : bool
        Estimated unless the user says otherwise.
    per_trial : bool
        Each trial has a value of its own (a start offset, say).
    meaning, source : str
        For the report.
    known : float, optional
        What it was elsewhere: published, or measured otherwise.
    spread : float
        A number of each trial that differs by chance is a random effect: normal about the start with this
        standard deviation. Infinite where nothing is known of it beforehand.
    kinked : bool
        The motion has corners in it (a body that sticks and slips), so that searches are begun from several
        sizes.
    """

    name: str
    unit: str
    lower: float
    upper: float
    start: float
    scale: float
    free: bool = True
    per_trial: bool = False
    meaning: str = ""
    source: str = ""
    known: float | None = None
    spread: float = math.inf
    kinked: bool = False

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Bounds with None for infinity, as files hold them."""
        return (
            self.lower if math.isfinite(self.lower) else None,
            self.upper if math.isfinite(self.upper) else None,
        )


@dataclass(frozen=True)
class Channel:
    """One measured and simulated quantity.

    Attributes
    ----------
    name : str
        Its column in a log, with the unit as its suffix: ``"u_m_s"``.
    unit : str
        In SI: ``"m/s"``.
    meaning : str
        For figures and tables.

    Examples
    --------
    >>> Channel("u_m_s", "m/s", "surge").unit
    'm/s'
    """

    name: str
    unit: str
    meaning: str = ""


@dataclass(frozen=True)
class Trial:
    """One recorded trial as a model sees it.

    Attributes
    ----------
    id : str
    role : str
        ``"fit"`` or ``"validate"``.
    time_s : ndarray, shape (n,)
    measured : dict of channel name to ndarray, each shape (n,)
        NaN where missing.
    inputs : dict of name to ndarray
        Measured inputs on the same samples.
    rig, swim, cruise, surge : RigInput, SwimInput, CruiseInput, SurgeInput
        What is known of it beside its samples (a pulling force, a beat), resolved against the robot.
    starts : dict of parameter name to float
        Where the search for its own parameters begins, where its log suggests that.
    held : tuple of str
        Parameters of single trials that are not estimated in this one.
    value_sd : dict of channel name to ndarray or float
        Known shape of the measurement error (its overall size is still estimated). Without it
        and without ``time_sd_s`` the error is taken as constant over each channel.
    time_sd_s : float
        Known standard deviation of the time stamps.
    stamps_uncertain : bool
        The stamps carry an error of unknown size: value and stamp errors are both estimated.
    """

    id: str
    role: str
    time_s: Array
    measured: Mapping[str, Array]
    inputs: Mapping[str, Array] = field(default_factory=dict)
    rig: RigInput = field(default_factory=RigInput)
    swim: SwimInput = field(default_factory=SwimInput)
    cruise: CruiseInput = field(default_factory=CruiseInput)
    surge: SurgeInput = field(default_factory=SurgeInput)
    starts: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    value_sd: Mapping[str, Array | float] = field(default_factory=dict)
    time_sd_s: float | Array = 0.0
    stamps_uncertain: bool = False

    @property
    def steady(self) -> tuple[Array, Array]:
        """Frequency (Hz) and amplitude (rad) of each run's steady beat, shape (runs,); NaN without one."""
        frequency = self.inputs.get("frequency_hz", self.surge.frequency_hz)
        amplitude = self.inputs.get("amplitude_rad", self.surge.amplitude_rad)
        found, size = np.broadcast_arrays(np.atleast_1d(frequency), np.atleast_1d(amplitude))
        return found.astype(float), size.astype(float)


@dataclass(frozen=True)
class Rig:
    """The one coordinate of a body on a test rig.

    Attributes
    ----------
    displacement, speed : Channel
    rotation : bool
        It turns about the coordinate, otherwise it moves along it.
    swings : bool
        A restoring force brings it back (free decay), otherwise it is pulled from place to place.
    """

    displacement: Channel
    speed: Channel
    rotation: bool
    swings: bool


class Model(ABC):
    """What a fit, a comparison and a diagnosis need of a model.

    What models differ in beyond that they say themselves: whether they move on a :attr:`rig` or have a
    :attr:`body` of links, along which :attr:`axes`, on which :meth:`scales` and by which :meth:`commands`.
    One of your own needs ``name``, ``parameters``, ``channels`` and :meth:`simulate`.

    Attributes
    ----------
    name : str
        In the parameter file.
    parameters : tuple of Parameter
        What may be estimated, in the order of the values :meth:`simulate` is given.
    channels : tuple of Channel
        What it simulates.
    abscissa : str
        What a trial's ``time_s`` counts, for axes.
    offers : frozenset of str
        Hooks (:class:`swimid.fitting.hooks.Hooks`) that :meth:`hooked` obeys.
    force_unit : str
        Unit of the forces in its equation: N, N m of an angle, m/s^2 where it is per mass.
    timed_runs, has_gaps, in_space : bool
        Its trials are tables of timed runs; its output may be missing by design; it moves in space.
    groups : mapping of str to tuple of str
        Parameters that share one value, by the name of that.

    Examples
    --------
    >>> class Drifting(Model):
    ...     name = "drifting"
    ...     parameters = (Parameter("drift_m_s", "m/s", lower=-1.0, upper=1.0, start=0.0, scale=0.1),)
    ...     channels = (Channel("x_m", "m", "way"),)
    ...
    ...     def simulate(self, values, trial):
    ...         return {"x_m": values[0] * trial.time_s}
    >>> run = Trial("run 1", "fit", time_s=np.array([0.0, 1.0, 2.0]), measured={})
    >>> Drifting().simulate(np.array([0.25]), run)["x_m"].tolist()
    [0.0, 0.25, 0.5]
    """

    #: Name in the parameter file.
    name: str
    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    #: What a trial's ``time_s`` counts, for axes.
    abscissa: str = "time (s)"
    #: Hooks (:class:`swimid.fitting.hooks.Hooks`) that :meth:`hooked` obeys.
    offers: frozenset[str] = frozenset({"output", "clock"})
    #: Unit of the forces in its equation: N, N m of an angle, m/s^2 where it is per mass.
    force_unit: str = "N"
    #: Its trials are tables of runs timed over ``distance_m``; the one channel is their mean speed.
    timed_runs: bool = False
    #: Its output may be missing by design, where the input is.
    has_gaps: bool = False
    #: Parameters that share one value, by the name of that (:class:`Tied`).
    groups: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    #: A robot with links that moves in space, stroke by stroke, not in a plane.
    in_space: bool = False

    @property
    def rig(self) -> Rig | None:
        """The one coordinate it has on a test rig; None elsewhere."""
        return None

    @property
    def body(self) -> Any:
        """The links of a planar robot (:class:`swimid.swimmer.planar.model.Body`); None elsewhere."""
        return None

    @property
    def swimmer(self) -> Any:
        """Itself where it is a robot with links (:class:`swimid.swimmer.model.Swimmer`); None elsewhere."""
        return None

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the world along which the body moves from place to place."""
        return ("x",)

    def scales(self, trials: Sequence[Trial]) -> Scales:
        """Typical sizes of trials."""
        return Scales(self, trials)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Where a trial's positions start, by channel; at zero for those that are not named."""
        return {}

    def stated(self) -> dict[str, float]:
        """What a robot file says of its parameters; a fit starts elsewhere."""
        return {}

    # -------------------------------------------------------- what drives it

    def commanded(self, trial: Trial) -> bool:
        """Whether a trial's actuators follow a command; a measured joint angle is past them already."""
        return True

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Time (s), command and its fastest known rate (per s) of each actuator that follows one."""
        return iter(())

    def onset(self, trial: Trial) -> float:
        """When the run begins, s: a drive at time zero, a recorded command with its log."""
        return float(trial.time_s[0]) if trial.swim.drive is None else 0.0

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """Frequencies of the drive as far as they are known, Hz."""
        return [float(t.swim.drive.frequency_hz) for t in trials if t.swim.drive is not None]

    def given(self, trial: Trial) -> list[str]:
        """Channels that a trial's run is driven by as they were measured: it does not predict them."""
        return []

    # -------------------------------------------------------- simulation

    def at_own_level(self, values: Array, trial: Trial) -> tuple[Model, dict[str, float]]:
        """The model at the working point of one trial, and what was estimated for it; itself without one."""
        return self, {}

    def prepare(  # noqa: B027
        self,
        progress: Progress = silent,
        *,
        simulated_s: float = 0.0,
        affected_s: float = 0.0,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        """Compile what it needs to be fast, under a bar that says so.

        Parameters
        ----------
        simulated_s : float, s
            How much time of all trials together is about to be simulated: what compiling may cost.
        affected_s : float, s
            How much of that with effects that bring forces, or elements that the model does not have; their
            modules have been imported, a user's own too.
        checkpoint : Checkpoint, optional
            A run that is taken up again goes on with what it began with.
        """

    @abstractmethod
    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate one trial.

        Parameters
        ----------
        values : ndarray, shape (len(self.parameters),)
            One value per parameter, in the order of :attr:`parameters`; per-trial
            parameters hold this trial's value.
        trial : Trial

        Returns
        -------
        dict of channel name to ndarray, each shape (n,)
            At the trial's sample times. NaN where the model breaks down.
        """

    def attempt(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate one trial without numpy's warnings where the model breaks down."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self.simulate(values, trial)

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate one trial with what else acts on the chain.

        A model that offers more than sensing and a late clock overrides this.
        """
        late = replace(trial, time_s=hooks.happened(trial.time_s)) if hooks.late else trial
        return hooks.seen(self.simulate(values, late), trial.time_s)

    def simulate_many(self, runs: Sequence[tuple[Array, Trial]]) -> list[dict[str, Array]]:
        """Simulate several runs, each as :meth:`simulate`; NaN throughout where one breaks down."""
        return self.hooked_many([(values, trial, NONE) for values, trial in runs])

    @property
    def together(self) -> int:
        """How many runs take no longer than one."""
        return 1

    def hooked_many(self, runs: Sequence[tuple[Array, Trial, Hooks]]) -> list[dict[str, Array]]:
        """The same with what else acts on the chain of each.

        A model that runs faster side by side overrides this.
        """

        def simulated(values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
            return self.simulate(values, trial) if hooks is NONE else self.hooked(values, trial, hooks)

        return [
            self.broken_down(trial) if one is None else one
            for one, (_, trial, _) in zip(unless_broken(simulated, runs), runs, strict=True)
        ]

    def broken_down(self, trial: Trial) -> dict[str, Array]:
        """The channels of a simulation that came to nothing."""
        return {c.name: np.full(len(trial.time_s), np.nan) for c in self.channels}

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Rate of change of each channel with time, for trials whose stamps are uncertain."""
        step = 1e-4
        late = self.simulate(values, replace(trial, time_s=trial.time_s + step))
        early = self.simulate(values, replace(trial, time_s=np.maximum(trial.time_s - step, 0)))
        width = trial.time_s + step - np.maximum(trial.time_s - step, 0)
        return {name: (late[name] - early[name]) / width for name in late}

    def refined(self) -> Model | None:
        """The same model integrated with half the step; None where nothing is integrated."""
        return None

    def coarser(self) -> Model | None:
        """The same model integrated with twice the step, for searches; None where that gains nothing."""
        return None

    def apart(self, trial: Trial) -> list[Trial]:
        """A trial that is a table of runs as one trial for each of them; others as they are."""
        return [trial]

    # -------------------------------------------------------- parameters

    def start(self, *names: str) -> float:
        """Start value of the first of these parameters that it has; 0 where it has none."""
        found = {p.name: p.start for p in self.parameters}
        return next((found[name] for name in names if name in found), 0.0)

    def expanded(self, entries: Mapping[str, Entry]) -> dict[str, Entry]:
        """What is known by parameter name or ``name[trial]``, each member of :attr:`groups` with its own."""
        return dict(entries)

    def estimates(self, *names: str) -> bool:
        """Whether one of these parameters is free."""
        return any(p.name in names and p.free for p in self.parameters)

    def index(self, name: str) -> int:
        """Position of a parameter by name.

        Raises
        ------
        UsageError
            With the nearest name, when there is none.
        """
        names = [p.name for p in self.parameters]
        if name not in names:
            hint = suggestion(name, names, "it has")
            raise UsageError(f"the model {self.name} has no parameter '{name}'", hint=hint)
        return names.index(name)


def unless_broken(compute: Callable[..., Outcome], runs: Iterable[tuple[Any, ...]]) -> list[Outcome | None]:
    """What a function computes of each run's arguments, without numpy's warnings; None where that run breaks
    down in it.
    """

    def one(arguments: tuple[Any, ...]) -> Outcome | None:
        try:
            return compute(*arguments)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return [one(arguments) for arguments in runs]


def chosen(
    parameters: tuple[Parameter, ...],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: tuple[str, ...] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Parameter, ...]:
    """The parameters with the user's choices applied: some fixed, some freed, some bounded."""
    fixed = dict(fixed or {})
    bounds = dict(bounds or {})
    names = [p.name for p in parameters]
    for name in (*fixed, *freed, *bounds):
        if name not in names:
            raise UsageError(f"there is no parameter '{name}'", hint=suggestion(name, names))
    result = []
    for parameter in parameters:
        if parameter.name in bounds:
            lower, upper = bounds[parameter.name]
            if not lower < upper:
                raise UsageError(f"the bounds of {parameter.name} are the wrong way round: {lower} {upper}")
            start = min(max(parameter.start, lower), upper)
            parameter = replace(parameter, lower=lower, upper=upper, start=start)
        if parameter.name in fixed:
            if not parameter.lower <= fixed[parameter.name] <= parameter.upper:
                raise UsageError(
                    f"{parameter.name} cannot be {fixed[parameter.name]:g}: "
                    f"it lies between {parameter.lower:g} and {parameter.upper:g}"
                )
            parameter = replace(parameter, start=float(fixed[parameter.name]), free=False)
        elif parameter.name in freed:
            parameter = replace(parameter, free=True)
        result.append(parameter)
    return tuple(result)


class Scales:
    """Typical sizes of a model's trials; a model that knows more of its forces and masses overrides them.

    Parameters
    ----------
    model : Model
        Its parameters at their start values.
    trials : sequence of Trial
    """

    #: Channels whose range is the extent of the motion.
    places: tuple[str, ...] = POSITIONS

    def __init__(self, model: Model, trials: Sequence[Trial]) -> None:
        self.model = model
        self.trials = trials

    @property
    def duration(self) -> float:
        """Median length of a trial, s; 1 where that is not known."""
        found = [float(t.time_s[-1] - t.time_s[0]) for t in self.trials if len(t.time_s) > 1]
        return float(np.median(found)) or 1.0 if found else 1.0

    @property
    def speed(self) -> float:
        """Typical speed, m/s (rad/s for an angle); 0.1 where nothing tells."""
        found = [v for t in self.trials if (v := _speed(t)) is not None]
        return float(np.median(found)) or 0.1 if found else 0.1

    @property
    def span(self) -> float:
        """Typical extent of the motion, m (rad for an angle); 1 where nothing tells."""
        found = [
            float(np.nanmax(t.measured[name]) - np.nanmin(t.measured[name]))
            for t in self.trials
            for name in self.places
            if name in t.measured and np.isfinite(t.measured[name]).any()
        ]
        return float(np.median(found)) or 1.0 if found else 1.0

    @property
    def inertia(self) -> float:
        """What has to be accelerated: kg, kg m2 for an angle; 1 where nothing tells."""
        return 1.0

    @property
    def force(self) -> float:
        """Typical force that moves the robot, in :attr:`Model.force_unit`."""
        return 0.1 * self.speed**2

    @property
    def brake(self) -> float:
        """Size of a drag or friction that one begins to see: a tenth of what moves the robot."""
        return 0.1 * self.force

    @property
    def quadratic(self) -> float:
        """The quadratic drag the model has, the least of all trials; 0 where it has no such coefficient."""
        return 0.0


def _speed(trial: Trial) -> float | None:
    for name in ("u_m_s", MEAN_SPEED):
        if name in trial.measured:
            return float(np.sqrt(np.nanmean(trial.measured[name] ** 2)))
    time, place = _track(trial)
    every = slice(None, None, max(len(time) // STRETCHES, 1))
    if len(time) > 1 and time[every][-1] > time[0]:
        path = float(np.linalg.norm(np.diff(place[every], axis=0), axis=1).sum())
        return path / float(time[every][-1] - time[0])
    return None


def _track(trial: Trial) -> tuple[Array, Array]:
    """Times and positions where all measured coordinates are there, shapes (n,) and (n, coordinates)."""
    names = [name for name in POSITIONS if name in trial.measured]
    if not names:
        return np.zeros(0), np.zeros((0, 1))
    values = np.column_stack([trial.measured[name] for name in names])
    there = np.isfinite(values).all(axis=1)
    return trial.time_s[there], values[there]


class Tied(Model):
    """A model in which each group of parameters is replaced by one they share.

    The shared parameter stands where the group's first member stood. It starts at the
    members' mean, its bounds are what all members' bounds allow, its scale is the largest.

    Parameters
    ----------
    model : Model
    groups : mapping of name to sequence of str
        The shared parameter's name, and the members it stands for.

    Raises
    ------
    UsageError
        For an unknown member, one in two groups, a group of one, a name already taken, and
        members of different unit or with no common value.
    """

    def __init__(self, model: Model, groups: Mapping[str, Sequence[str]]) -> None:
        self.model = model
        self.groups = {name: tuple(members) for name, members in groups.items()}
        self.name = model.name
        self.channels = model.channels
        self.abscissa = model.abscissa
        owner: dict[str, str] = {}
        for name, members in self.groups.items():
            if len(members) < 2:
                raise UsageError(f"{name} needs at least two parameters to be shared by")
            for member in members:
                model.index(member)
                if member in owner:
                    raise UsageError(f"{member} is shared twice: as {owner[member]} and as {name}")
                owner[member] = name
        parameters: list[Parameter] = []
        places: dict[str, int] = {}
        for parameter in model.parameters:
            name = owner.get(parameter.name, parameter.name)
            if parameter.name not in owner and name in self.groups:
                raise UsageError(f"the name {name} is taken by a parameter that does not share it")
            if name not in places:
                places[name] = len(parameters)
                parameters.append(self._shared(name) if name in self.groups else parameter)
        self.parameters = tuple(parameters)
        self._places = np.array([places[owner.get(p.name, p.name)] for p in model.parameters], dtype=int)

    @property
    def body(self) -> Any:
        """The links of the untied model."""
        return self.model.body

    @property
    def swimmer(self) -> Any:
        """The untied model where it is a robot with links."""
        return self.model.swimmer

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate with every member at its group's value (see :meth:`Model.simulate`)."""
        return self.model.simulate(self.members(values), trial)

    @property
    def together(self) -> int:
        """As of the untied model."""
        return self.model.together

    def hooked_many(self, runs: Sequence[tuple[Array, Trial, Hooks]]) -> list[dict[str, Array]]:
        """Several runs (see :meth:`Model.hooked_many`)."""
        return self.model.hooked_many([(self.members(values), trial, hooks) for values, trial, hooks in runs])

    def prepare(self, progress: Progress = silent, **how: Any) -> None:
        """As the untied model (see :meth:`Model.prepare`)."""
        self.model.prepare(progress, **how)

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Rate of change of each channel (see :meth:`Model.sensitivity_to_time`)."""
        return self.model.sensitivity_to_time(self.members(values), trial)

    def refined(self) -> Tied | None:
        """The same with half the integration step; None where nothing is integrated."""
        finer = self.model.refined()
        return None if finer is None else Tied(finer, self.groups)

    def members(self, values: Array) -> Array:
        """Values of the untied model's parameters, shape (len(self.model.parameters),)."""
        return np.asarray(values, dtype=float)[self._places]

    def expanded(self, entries: Mapping[str, Entry]) -> dict[str, Entry]:
        """What is known of each parameter, by the names of the untied model.

        A shared one is repeated for every member; its standard error is each member's, all of them fully
        correlated.
        """
        found: dict[str, Entry] = {}
        for label, entry in entries.items():
            name, bracket, rest = label.partition("[")
            for member in self.groups.get(name, (name,)):
                found[member + bracket + rest] = entry
        return found

    def _shared(self, name: str) -> Parameter:
        members = [self.model.parameters[self.model.index(m)] for m in self.groups[name]]
        first = members[0]
        for other in members[1:]:
            if (other.unit, other.per_trial) != (first.unit, first.per_trial):
                raise UsageError(
                    f"{first.name} ({first.unit}) and {other.name} ({other.unit}) cannot share a value"
                )
        lower, upper = max(m.lower for m in members), min(m.upper for m in members)
        if lower > upper:
            raise UsageError(f"no value lies within the bounds of all of {', '.join(self.groups[name])}")
        start = float(np.clip(np.mean([m.start for m in members]), lower, upper))
        return replace(
            first,
            name=name,
            lower=lower,
            upper=upper,
            start=start,
            scale=max(m.scale for m in members),
            free=any(m.free for m in members),
            meaning=f"one value for {', '.join(self.groups[name])}",
            source="",
        )


def groups_by_prefix(model: Model, prefix: str) -> dict[str, tuple[str, ...]]:
    """The group of all parameters whose name is the prefix followed by digits.

    Raises
    ------
    UsageError
        With the nearest prefix, when fewer than two parameters have it.
    """
    members = tuple(p.name for p in model.parameters if re.fullmatch(re.escape(prefix) + r"\d+", p.name))
    if len(members) < 2:
        stems = [re.sub(r"\d+$", "", p.name) for p in model.parameters if re.search(r"\d+$", p.name)]
        several = sorted({s for s in stems if stems.count(s) > 1})
        hint = suggestion(prefix, several)
        raise UsageError(f"the model {model.name} has no parameters to share as '{prefix}'", hint=hint)
    return {prefix: members}
