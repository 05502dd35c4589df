"""The one interface of every model.

A model is a robot plus an experiment: it has parameters with unit and bounds, output
channels, and it simulates a trial from parameter values. Fitting, comparing, diagnosing and
reporting are written once against this interface; a new model is one new file here.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError, suggestion
from swimid.files.checkpoint import Checkpoint
from swimid.fitting.body import Body
from swimid.fitting.hooks import NONE, Hooks
from swimid.fitting.inputs import CruiseInput, RigInput, SurgeInput, SwimInput
from swimid.fitting.scales import Scales
from swimid.progress import Progress, silent

if TYPE_CHECKING:
    from swimid.fitting.swimmer import Swimmer

Array = NDArray[np.float64]
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
    #: Parameters that share one value, by the name of that (:class:`swimid.fitting.tied.Tied`).
    groups: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    #: A robot with links that moves in space, stroke by stroke, not in a plane.
    in_space: bool = False

    @property
    def rig(self) -> Rig | None:
        """The one coordinate it has on a test rig; None elsewhere."""
        return None

    @property
    def body(self) -> Body | None:
        """The links of a planar robot; None where there are none, or where they move in space."""
        return None

    @property
    def swimmer(self) -> Swimmer | None:
        """Itself where it is a robot with links; None elsewhere."""
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
