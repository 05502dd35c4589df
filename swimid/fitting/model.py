"""Interface of models: parameters, channels, trials, and the simulation of a trial.

A model describes one robot in one kind of experiment. It has parameters with units and bounds, output
channels, and a function that simulates a trial from parameter values. Fits, comparisons, diagnoses and
reports use only this interface, so that a new model needs only one new class.
"""

from __future__ import annotations

import copy
import hashlib
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar

import numpy as np
from numba.core.errors import NumbaExperimentalFeatureWarning
from numpy.typing import NDArray

from swimid.errors import UsageError, suggestion
from swimid.files.kernels import numba
from swimid.notices import Progress, silent

if TYPE_CHECKING:
    from swimid.effects.base import Effect
    from swimid.fitting.drives import Cycle, Motion, TailBeat

Array = NDArray[np.float64]
#: Names of the position channels along the axes x, y and z.
POSITIONS = ("x_m", "y_m", "z_m")
#: Name of the channel of the mean speed over a timed course.
MEAN_SPEED = "mean_speed_m_s"
#: Number of segments into which a track is divided to compute the mean speed. Few long segments keep
#: measurement noise from lengthening the path.
N_SPEED_SEGMENTS = 12
Outcome = TypeVar("Outcome")
Entry = TypeVar("Entry")


@dataclass(frozen=True)
class Parameter:
    """Parameter of a model, which a fit may estimate.

    Attributes
    ----------
    name, unit : str
        Name, and unit in SI; ``"1"`` if the parameter has no unit.
    lower, upper : float
        Bounds; infinite if there is no bound.
    start : float
        Start value of the search. A fixed parameter has this value.
    scale : float
        Typical scale of the parameter. The steps of finite differences are proportional to it. A parameter is
        identifiable if its standard error is below a fraction of its absolute value, or of the scale if that
        is larger.
    free : bool
        Whether a fit estimates the parameter by default.
    per_trial : bool
        Whether each trial has its own value of the parameter (a start offset, for example).
    meaning, source : str
        Description and source of the parameter, for the report.
    known : float, optional
        Known value from another source: published, or measured in another way.
    kinked : bool
        Whether the simulation is a non-smooth function of the parameter, as for a body that sticks and slips.
        Searches then start from several values.
    members : tuple of str
        Names of the parameters of the model that have the value of this parameter of a fit. Empty if the
        parameter itself is one of the model.
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
    kinked: bool = False
    members: tuple[str, ...] = ()

    @property
    def bounds(self) -> tuple[float | None, float | None]:
        """Lower and upper bound as a parameter file stores them; None for an infinite bound."""
        lower, upper = (b if math.isfinite(b) else None for b in (self.lower, self.upper))
        return lower, upper


@dataclass(frozen=True)
class Channel:
    """Channel of a log: a quantity that is measured and simulated.

    Attributes
    ----------
    name : str
        Name of the column in a log, with the unit as its suffix: ``"u_m_s"``.
    unit : str
        Unit in SI: ``"m/s"``.
    meaning : str
        Description for figures and tables.

    Examples
    --------
    >>> Channel("u_m_s", "m/s", "surge").unit
    'm/s'
    """

    name: str
    unit: str
    meaning: str = ""


# ---------------------------------------------------------------- inputs of trials


@dataclass(frozen=True)
class RigInput:
    """Known quantities of a trial with a body on a test rig."""

    #: Known inertia, including pulling mass and pulley, kg or kg m2. NaN if unknown.
    inertia: float = math.nan
    #: Known constant force, N.
    force: float | None = None
    #: Whether the body is pulled over a pulley, whose friction acts on it.
    pulley: bool = False
    #: Factor ``rho A / 2`` of the drag coefficient, kg/m. It is 0 if the quadratic coefficient itself is
    #: estimated.
    area_factor: float = 0.0
    #: Time of release, s. None means time zero.
    release_s: float | None = None
    #: Displacement at the time of release, m or rad.
    x0: float = 0.0

    @property
    def pull(self) -> float:
        """Known constant force on the body, N; 0 if there is none."""
        return self.force or 0.0

    @property
    def begin_s(self) -> float:
        """Time at which the body is released, s; 0 if it is not stated."""
        return self.release_s or 0.0


@dataclass(frozen=True)
class SwimInput:
    """Drive, initial pose and own coefficients of a robot with links in one trial."""

    beat: TailBeat | None = None
    stroke: Cycle | None = None
    #: Functions that return the motion of each driven joint at given times (s). They replace a beat or
    #: stroke.
    joints: Sequence[Callable[[Array], Motion]] | None = None
    #: Whether the motions in ``joints`` are commands to the actuators; otherwise they were measured.
    commanded: bool = False
    #: Functions that return the value of each input of the robot at given times (s), by the name of the
    #: input. A missing input is zero.
    inputs: Mapping[str, Callable[[Array], Array]] = field(default_factory=dict)
    #: Pose of the robot's reference point at the first sample. If a fit estimates the initial pose, it
    #: estimates offsets that are added to this pose.
    pose: tuple[float, ...] | None = None
    #: Coefficients of the robot whose values differ in this trial, by name.
    coefficients: Mapping[str, float] | None = None

    @property
    def drive(self) -> TailBeat | Cycle | None:
        """Tail beat or stroke that drives the robot. None for joint angles from a log, or without a drive."""
        return self.beat or self.stroke

    @property
    def steady(self) -> bool:
        """Whether the simulation begins on the limit cycle of the drive."""
        return self.drive is not None and self.drive.steady

    def make_steady(self) -> SwimInput:
        """Return a copy of the input for steady swimming, which begins on the limit cycle of the drive."""
        if self.stroke is not None:
            return replace(self, stroke=replace(self.stroke, steady=True, ramp_s=0.0, cycles=math.inf))
        if self.beat is None:
            return self
        return replace(self, beat=replace(self.beat, steady=True, ramp_s=0.0))

    def get_pose(self, count: int = 3) -> tuple[float, ...]:
        """Return the initial pose of the robot, or ``count`` zeros if the pose is unknown."""
        return self.pose or (0.0,) * count


@dataclass(frozen=True)
class CruiseInput:
    """Known quantities of a trial of timed cruising with one fin."""

    fin: str = ""
    #: Hydrodynamic inertia of the fin; None if unknown.
    inertia_kg_m2: float | None = None
    #: Reference frequency (Hz) and amplitude (rad) of the power law of the thrust.
    middle: tuple[float, float] = (1.0, 1.0)


@dataclass(frozen=True)
class SurgeInput:
    """Steady tail beat of a trial for models that simulate only averages over a beat."""

    #: Frequency of the tail beat, Hz; NaN if there is no beat.
    frequency_hz: float = math.nan
    amplitude_rad: float = math.nan
    #: Time of the first sample, s.
    start_s: float = 0.0


@dataclass(frozen=True)
class Trial:
    """Recorded trial with its samples and known quantities, in the form that models use.

    Attributes
    ----------
    id : str
    role : str
        Role in a fit: ``"fit"`` or ``"validate"``.
    time_s : ndarray, shape (n,)
    measured : dict of channel name to ndarray, each shape (n,)
        Measured values; NaN for missing samples.
    inputs : dict of name to ndarray
        Measured inputs at the same sample times.
    rig, swim, cruise, surge : RigInput, SwimInput, CruiseInput, SurgeInput
        Known quantities in addition to the samples (a pulling force, a beat), with the values for the robot.
    starts : dict of parameter name to float
        Start values of per-trial parameters, estimated from the log.
    held : tuple of str
        Per-trial parameters that are not estimated in this trial.
    value_sd : dict of channel name to ndarray or float
        Known standard deviation of the measurement error, up to a factor. A fit estimates the factor. If
        neither ``value_sd`` nor ``time_sd_s`` is given, the error of a channel has a constant standard
        deviation.
    time_sd_s : float
        Known standard deviation of the time stamps, s.
    stamps_uncertain : bool
        Whether the time stamps have an error of unknown size. A fit estimates this size together with the
        size of the error of the measured values.
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

    @cached_property
    def digest(self) -> str:
        """SHA-256 hash of the samples of the trial. A trial has the same hash under any name."""
        found = hashlib.sha256(self.time_s.tobytes())
        for name, values in sorted((*self.measured.items(), *self.inputs.items())):
            # Use one bit pattern for all NaN values, and one for 0.0 and -0.0.
            same = np.where(np.isnan(values), np.nan, np.asarray(values, dtype=float) + 0.0)
            found.update(name.encode() + same.tobytes())
        return found.hexdigest()

    def split_rows(self) -> list[Trial]:
        """Return one trial for each sample, named ``id/1``, ``id/2``, ..., for a table of timed runs."""

        def row(columns: Mapping[str, Any], k: int) -> dict[str, Any]:
            return {name: np.broadcast_to(v, len(self.time_s))[k : k + 1] for name, v in columns.items()}

        return [
            replace(
                self,
                id=f"{self.id}/{k + 1}",
                time_s=self.time_s[k : k + 1],
                measured=row(self.measured, k),
                inputs=row(self.inputs, k),
                value_sd=row(self.value_sd, k),
            )
            for k in range(len(self.time_s))
        ]

    @property
    def steady(self) -> tuple[Array, Array]:
        """Frequency (Hz) and amplitude (rad) of the steady beat; NaN without a steady beat.

        A table of steady swimming has one value for each of its n rows, shape (n,). Other trials have one
        value.
        """
        frequency = self.inputs.get("frequency_hz", self.surge.frequency_hz)
        amplitude = self.inputs.get("amplitude_rad", self.surge.amplitude_rad)
        found, size = np.broadcast_arrays(np.atleast_1d(frequency), np.atleast_1d(amplitude))
        return found.astype(float), size.astype(float)


@dataclass(frozen=True)
class RigCoordinate:
    """Coordinate of a body on a test rig, which has one degree of freedom.

    Attributes
    ----------
    displacement, speed : Channel
    rotation : bool
        Whether the coordinate is an angle. Otherwise it is a position.
    swings : bool
        Whether a restoring force moves the body back (free decay). Otherwise an applied force moves the body.
    """

    displacement: Channel
    speed: Channel
    rotation: bool
    swings: bool


# ---------------------------------------------------------------- hooks of effects


# Suppress numba's warning that compiled functions as arguments of compiled functions are experimental.
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

#: Numba signature ``force(t, pose, velocity, constants, wrench)`` of functions in a :class:`ExternalForce`.
FORCE_SIGNATURE = numba.types.void(
    numba.types.float64,
    numba.types.float64[::1],
    numba.types.float64[::1],
    numba.types.float64[::1],
    numba.types.float64[::1],
)
#: Maximum number of additional forces in a compiled integration step. Three effects of a hypothesis, and one
#: that is tested in addition to them, may have one force each.
MOST_FORCES = 4


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def no_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Leave the wrench unchanged. This function replaces a force that does not act in a simulation."""


@dataclass(frozen=True)
class Traceable:
    """Function of a :class:`ExternalForce` that can also be traced with symbols to simulate batches of
    trials.

    Attributes
    ----------
    function : compiled function
    on : str
        Link on which the force acts, in a robot with links: the base, the heaviest link (``hull``) or the
        last link.
    constants : int
        Number of constants that the function takes.
    """

    function: Any
    on: Literal["base", "hull", "last"]
    constants: int


#: Traceable functions of forces in all imported modules, by module and function name.
TRACEABLE: dict[str, Traceable] = {}


def traceable(on: Literal["base", "hull", "last"], constants: int) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that compiles a function of a :class:`ExternalForce` that can be traced.

    The function must branch on values only by ``max``, ``min`` and ``abs``. It may use the heading only in
    sine and cosine. See :class:`Traceable`.
    """

    def compile_force(function: Callable[..., None]) -> Any:
        made = numba.cfunc(FORCE_SIGNATURE, cache=True)(function)
        TRACEABLE[f"{function.__module__}.{function.__qualname__}"] = Traceable(made, on, constants)
        return made

    return compile_force


@dataclass(frozen=True)
class ExternalForce:
    """Force on one link of a robot, evaluated inside the compiled integration step."""

    #: Numba cfunc with :data:`FORCE_SIGNATURE`. If batches of simulations use it, :func:`traceable` must
    #: compile it. It adds a force (fx, fy, N) and a moment (N m) at the point to ``wrench``, in the axes of
    #: the link. Its arguments are the time (s), the ``pose``, the ``velocity`` and the ``constants``. The
    #: ``pose`` is x and y (m) of the reference point of the base in the world, and the heading (rad) of the
    #: link. The ``velocity`` is that of the point through the water in the axes of the link (m/s), and the
    #: yaw rate of the link (rad/s). A rig has one coordinate, in pose[0], velocity[0] and wrench[0];
    #: velocity[2] is the speed of the body over ground.
    function: Any
    #: Constants that are passed to the function, shape (c,).
    constants: Array
    #: Index of the link on which the force acts: 0 for the base, -1 for the last link.
    link: int = 0
    #: Coordinates of the point at which the force acts, in the axes of the link, m.
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True)
class Stroke:
    """Steady tail beat for models that average over a beat.

    Each field has one value, or one value for each row of a table of steady swimming.

    Attributes
    ----------
    frequency_hz, amplitude_rad
    thrust : factor on the force or power of the fin; 1 without effects.
    inertia_kg_m2 : hydrodynamic inertia of the fin, NaN if unknown.
    """

    frequency_hz: Array
    amplitude_rad: Array
    thrust: Array
    inertia_kg_m2: float = float("nan")


#: Type of a hook that returns the output of an actuator. Its arguments are the time (s), the command (angle
#: or signal) and the index of the driven joint.
Command = Callable[[Array, Array, int], Array]
#: Type of a hook that returns the channels as the sensors measure them. Its arguments are the simulated
#: channels and their times (s).
Output = Callable[[dict[str, Array], Array], dict[str, Array]]
#: Type of a hook that returns the displacement (m) and the velocity (m/s) of the water in the world at given
#: times (s), shape (n, 2) each.
Flow = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Hooks:
    """Functions (hooks) by which effects change a simulation.

    Several functions for the same part of the simulation act in the given order.
    """

    #: Functions that change the command of each driven joint, or the input column of a black-box model.
    command: tuple[Command, ...] = ()
    #: Functions that change the steady beat of a model that averages over a beat.
    stroke: tuple[Callable[[Stroke], Stroke], ...] = ()
    #: Functions that change in place the arrays of body properties (dict of name to array) from which a robot
    #: with links is simulated. :mod:`swimid.swimmer.planar.engine` defines their columns (``INERTIA``,
    #: ``PASSIVE``, ``DRAG`` ...).
    tables: tuple[Callable[[dict[str, Any]], None], ...] = ()
    #: Functions that change in place the coefficients (dict of name to float) of a model with one equation.
    coefficients: tuple[Callable[[dict[str, float]], None], ...] = ()
    #: Forces that are added to those of the model, at most :data:`MOST_FORCES`.
    force: tuple[ExternalForce, ...] = ()
    #: Motions of the water. All fluid forces depend on the velocity relative to the water.
    flow: tuple[Flow, ...] = ()
    #: Functions that change the output of the sensors.
    output: tuple[Output, ...] = ()
    #: Time by which the clock of the log shows events too early, s.
    clock_s: float = 0.0
    #: Drift of the clock of the log: further time by which it shows events too early, as a fraction of the
    #: time in the log.
    clock_drift: float = 0.0
    #: Identifier of the simulated motion: simulations whose hooks have the same key have the same motion.
    key: bytes = b""
    #: Identifier of the changed joint commands: simulations whose hooks have the same key have the same
    #: commands.
    command_key: bytes = b""

    def __add__(self, other: Hooks) -> Hooks:
        if self is NONE:
            return other
        if other is NONE:
            return self
        return Hooks(*(getattr(self, name) + getattr(other, name) for name in _FIELDS))

    @property
    def moves(self) -> bool:
        """Whether a hook changes the motion of the robot itself, and not only its measurement."""
        return bool(
            self.command or self.stroke or self.tables or self.coefficients or self.force or self.flow
        )

    def actuate(self, time_s: Array, command: Array, joint: int = 0) -> Array:
        """Return the output of the actuator of a driven joint, after all ``command`` hooks."""
        for change in self.command:
            command = change(time_s, command, joint)
        return command

    def change_stroke(self, stroke: Stroke) -> Stroke:
        """Return the steady beat after all ``stroke`` hooks."""
        for change in self.stroke:
            stroke = change(stroke)
        return stroke

    def change_values(self, values: dict[str, Any], hooks: str) -> dict[str, Any]:
        """Apply all ``tables`` or all ``coefficients`` hooks to ``values`` in place, and return them."""
        for change in getattr(self, hooks):
            change(values)
        return values

    @property
    def late(self) -> bool:
        """Whether the clock of the log differs from the clock of the drive."""
        return self.clock_s != 0.0 or self.clock_drift != 0.0

    def compute_event_times(self, time_s: Array) -> Array:
        """Return the true times of the events that the log shows at the given times, s."""
        return time_s - (self.clock_s + self.clock_drift * time_s) if self.late else time_s

    def sense(self, channels: Mapping[str, Array], time_s: Array) -> dict[str, Array]:
        """Return the simulated channels as the sensors show them, after all ``output`` hooks."""
        found = dict(channels)
        for change in self.output:
            found = change(found, time_s)
        return found


_FIELDS = tuple(field.name for field in fields(Hooks))
#: Hooks that change nothing in a simulation.
NONE = Hooks()
#: Type of the arguments of a simulation: values of the parameters, trial, and hooks of its effects.
Request = tuple[Array, Trial, Hooks]


# ---------------------------------------------------------------- model


class Acting:
    """Effect that acts in the simulations of a model.

    Parameters
    ----------
    effect : Effect
    model : Model
        Model without this effect.
    parameters : tuple of Parameter
        Parameters of the effect.
    first : int
        Index of the first parameter of the effect among the parameters of the model with all effects.
    """

    def __init__(self, effect: Effect, model: Model, parameters: tuple[Parameter, ...], first: int) -> None:
        self.effect, self.model, self.parameters, self.first = effect, model, parameters, first
        #: Index of the parameter of the model to which the effect is added; None if it has hooks instead.
        self.adds_to = None if effect.adds_to is None else model.index(effect.adds_to)
        self._null = [p.start for p in parameters]
        self._content = effect.content()
        self._latest: dict[str, tuple[Trial, list[float], Hooks]] = {}

    def hooks(self, values: Array, trial: Trial) -> Hooks:
        """Return the hooks of the effect at given values of all parameters. The latest hooks are cached."""
        own = values[self.first : self.first + len(self.parameters)]
        point = own.tolist()
        if self.adds_to is not None or point == self._null:
            return NONE
        known = self._latest.get(trial.id)
        if known is not None and known[0] is trial and known[1] == point:
            return known[2]
        hooks = self.effect.hooks(own, trial, self.model)
        if hooks.moves:
            key = self._content + own.tobytes()
            hooks = replace(hooks, key=key, command_key=key if hooks.command else b"")
        # Hooks that change model coefficients may store the values that they read. Create them anew for each
        # simulation.
        if not (hooks.tables or hooks.coefficients):
            self._latest[trial.id] = trial, point, hooks
        return hooks

    def forget(self, trials: Iterable[str]) -> None:
        """Remove the cached hooks of the trials with the given identifiers."""
        for name in trials:
            self._latest.pop(name, None)


class RobotFacts:
    """Facts about the robot of a model and about its drive. A model overrides the facts that it knows.

    Attributes
    ----------
    force_unit : str
        Unit of the forces in the equation of motion: N, N m for an angle, m/s^2 for a force per mass.
    timed_runs : bool
        Whether each trial is a table of cruises that are timed over ``distance_m``. The only channel is the
        mean speed of each cruise.
    has_gaps : bool
        Whether the output is missing at the samples at which the input is missing.
    in_space : bool
        Whether the model is a robot with links that moves in 3-D, and not in a plane. It is simulated for one
        stroke cycle after the other.
    file_ending : str
        File name ending of the files in which users define a simulator; empty if the model has no such files.
    fluid_density_kg_m3 : float or None
        Density of the fluid in the robot file; None if unknown.
    """

    force_unit: str = "N"
    timed_runs: bool = False
    has_gaps: bool = False
    in_space: bool = False
    file_ending: str = ""
    fluid_density_kg_m3: float | None = None

    @property
    def rig(self) -> RigCoordinate | None:
        """Coordinate of the body if the model is a test rig; None for other models."""
        return None

    @property
    def body(self) -> Any:
        """Links of a planar robot (:class:`swimid.swimmer.planar.model.PlanarBody`); None otherwise."""
        return None

    @property
    def swimmer(self) -> Any:
        """Model itself if it is a robot with links (:class:`swimid.swimmer.model.Swimmer`); else None."""
        return None

    @property
    def planar_pose(self) -> tuple[str, ...]:
        """Channels of two positions and the heading of a body that moves in a plane; empty otherwise."""
        if self.body is None or not self.body.free:
            return ()
        return tuple(self.body.pose)

    @property
    def axes(self) -> tuple[str, ...]:
        """World axes along which the body can travel."""
        return ("x",)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Return the initial position in a trial, by channel. Channels without an entry start at 0."""
        return {}

    def get_file_values(self) -> dict[str, float]:
        """Return the parameter values of the robot file by name; empty if the model has no such values."""
        return {}

    def is_commanded(self, trial: Trial) -> bool:
        """Return whether the input of a trial is a command, and not the measured output of the actuators."""
        return True

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Yield for each commanded actuator the times (s), the command, and its known maximum rate (1/s)."""
        return iter(())

    def onset(self, trial: Trial) -> float:
        """Return the start time of the simulation, s: zero with a drive, else the first sample of the log."""
        if trial.swim.drive is not None:
            return 0.0
        return float(trial.time_s[0])

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """Return the known drive frequencies of the trials, Hz."""
        return [float(t.swim.drive.frequency_hz) for t in trials if t.swim.drive is not None]

    def list_input_channels(self, trial: Trial) -> list[str]:
        """Return the measured channels of a trial that are inputs of the model, which it does not predict."""
        return []


class Model(RobotFacts):
    """Interface of a model for fits, comparisons and diagnoses.

    A user-defined model needs ``name``, ``parameters``, ``channels`` and :meth:`simulate`. It overrides
    :meth:`simulate_hooked` instead of :meth:`simulate` if it supports other hooks than ``output`` and
    ``clock``. Other members state properties that only some models have: the coordinate on a :attr:`rig`, the
    links (:attr:`body`), the :attr:`axes`, the typical scales (:meth:`scales`) and the :meth:`commands`.

    Effects act on a copy of the model (:meth:`with_effects`). :meth:`run` and :meth:`run_many` simulate
    trials with all effects of the model.

    Attributes
    ----------
    name : str
        Name of the model in the parameter file.
    parameters : tuple of Parameter
        Parameters, in the order of the values that :meth:`run` takes. Those of the effects come last.
    channels : tuple of Channel
        Channels that the model simulates.
    offers : frozenset of str
        Names of the hooks (:class:`swimid.fitting.model.Hooks`) that :meth:`simulate_hooked` supports.
    acting : tuple of Acting
        Effects that act on the model.

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
    >>> Drifting().run(np.array([0.25]), run)["x_m"].tolist()
    [0.0, 0.25, 0.5]
    """

    name: str
    parameters: tuple[Parameter, ...]
    channels: tuple[Channel, ...]
    offers: frozenset[str] = frozenset({"output", "clock"})
    acting: tuple[Acting, ...] = ()

    def scales(self, trials: Sequence[Trial]) -> Scales:
        """Return the typical scales of speed, force and other quantities in the given trials."""
        return Scales(self, trials)

    # -------------------------------------------------------- effects

    def with_effects(self, effects: Sequence[Effect], trials: Sequence[Trial]) -> Model:
        """Return a copy of the model on which further effects act.

        The parameters of the copy are those of the model, followed by those of each effect as
        ``effect/parameter``. With the effect parameters at their start values, the simulation is that of the
        model. An effect may replace the model by another one (:meth:`Effect.in_place_of`).

        Parameters
        ----------
        effects : sequence of Effect
        trials : sequence of Trial
            Trials from which the effects take the scales of their parameters.
        """
        model = self
        for effect in effects:
            model = effect.in_place_of(model)
        return model._with_acting([(effect, effect.parameters(self, trials)) for effect in effects])

    def _with_acting(self, effects: Iterable[tuple[Effect, tuple[Parameter, ...]]]) -> Self:
        """Return a copy of the model on which further effects act with given parameters."""
        other = copy.copy(self)
        for effect, parameters in effects:
            other.acting = (*other.acting, Acting(effect, self, parameters, len(other.parameters)))
            named = (replace(p, name=f"{effect.name}/{p.name}") for p in parameters)
            other.parameters = (*other.parameters, *named)
        return other

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects that act on the model."""
        return tuple(acting.effect for acting in self.acting)

    def _add_changes(self, values: Array) -> Array:
        """Return parameter values with the changes by effects added, limited to the bounds."""
        # A later effect may change the parameter of an earlier one.
        for acting in reversed(self.acting):
            if acting.adds_to is not None:
                p, values = self.parameters[acting.adds_to], values.copy()
                changed = values[acting.adds_to] + values[acting.first]
                values[acting.adds_to] = np.clip(changed, p.lower, p.upper)
        return values

    def hooks(self, values: Array, trial: Trial) -> Hooks:
        """Return the combined hooks of all effects in one trial at the given parameter values."""
        values = self._add_changes(values)
        return sum((acting.hooks(values, trial) for acting in self.acting), NONE)

    def _arguments(self, values: Array, trial: Trial, *, measured: bool = True) -> Request:
        """Return the arguments with which :meth:`simulate_hooked` simulates a trial with all effects of the
        model.

        Parameters
        ----------
        measured : bool
            Whether effects of sensors and clocks act.
        """
        hooks = self.hooks(values, trial)
        if not measured and (hooks.output or hooks.late):
            # Sensors and clocks change only the measurement.
            hooks = replace(hooks, output=(), clock_s=0.0, clock_drift=0.0)
        own = self.acting[0].first if self.acting else len(values)
        return self._add_changes(values)[:own], trial, hooks

    # -------------------------------------------------------- simulation

    def run(self, values: Array, trial: Trial, *, measured: bool = True) -> dict[str, Array]:
        """Simulate one trial with all effects (see :meth:`run_many`)."""
        return self.run_many([(values, trial)], measured=measured)[0]

    def run_many(
        self, runs: Sequence[tuple[Array, Trial]], *, measured: bool = True
    ) -> list[dict[str, Array]]:
        """Simulate several trials with all effects of the model.

        Parameters
        ----------
        runs : sequence of (values, trial)
            One value for each of :attr:`parameters`. A per-trial parameter has the value of the trial.
        measured : bool
            Whether effects of sensors and clocks act. Without them the result is the motion of the robot.

        Returns
        -------
        list of dict of channel name to ndarray, each shape (n,)
            Simulated values at the sample times of the trial. If a simulation diverges, all values of this
            trial are NaN.
        """
        requests = unless_broken(partial(self._arguments, measured=measured), runs)
        simulated = iter(self.simulate_many([one for one in requests if one is not None]))
        return [
            self.make_broken(trial) if one is None else next(simulated)
            for one, (_, trial) in zip(requests, runs, strict=True)
        ]

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Simulate one trial without effects. A model overrides this method or :meth:`simulate_hooked`.

        Parameters
        ----------
        values : ndarray, shape (k,)
            One value for each parameter of the model, without those of effects. A per-trial parameter has the
            value of this trial.
        trial : Trial

        Returns
        -------
        dict of channel name to ndarray, each shape (n,)
            Simulated values at the sample times of the trial. NaN where the simulation diverges.
        """
        if type(self).simulate_hooked is Model.simulate_hooked:
            raise NotImplementedError(f"the model {self.name} has no method 'simulate'")
        return self.simulate_hooked(values, trial, NONE)

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate one trial with the given hooks (see :meth:`simulate`).

        A model that supports other hooks than ``output`` and ``clock`` overrides this method.
        """
        late = replace(trial, time_s=hooks.compute_event_times(trial.time_s)) if hooks.late else trial
        return hooks.sense(self.simulate(values, late), trial.time_s)

    def simulate_many(self, runs: Sequence[Request]) -> list[dict[str, Array]]:
        """Simulate several trials, each with its hooks (see :meth:`simulate_hooked`).

        A model that simulates batches faster overrides this method. If a simulation diverges, all values of
        this trial are NaN.
        """
        found = unless_broken(self.simulate_hooked, runs)
        return [one or self.make_broken(trial) for one, (_, trial, _) in zip(found, runs, strict=True)]

    @property
    def batch_size(self) -> int:
        """Number of trials that the model simulates together in about the time of one trial."""
        return 1

    def prepare(self, progress: Progress = silent, *, effects: bool = False) -> None:
        """Compile the simulation if this machine does not have it yet, and show the progress.

        Without this call the first simulation compiles it.

        Parameters
        ----------
        effects : bool
            Whether effects add forces, or elements that the model does not have, to the simulations. The
            modules of all effects, including those of the user, must have been imported.
        """

    def at_own_level(self, values: Array, trial: Trial) -> tuple[Model, dict[str, float]]:
        """Return the model with the output offset of one trial, and this offset by parameter name.

        A model whose output has no offset for each trial is returned unchanged.
        """
        return self, {}

    def make_broken(self, trial: Trial) -> dict[str, Array]:
        """Return the channels of a simulation that diverged: NaN at every sample."""
        return {c.name: np.full(len(trial.time_s), np.nan) for c in self.channels}

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Return the time derivative of each simulated channel, for trials with uncertain time stamps."""
        step = 1e-4
        late = self.run(values, replace(trial, time_s=trial.time_s + step))
        early = self.run(values, replace(trial, time_s=np.maximum(trial.time_s - step, 0)))
        width = trial.time_s + step - np.maximum(trial.time_s - step, 0)
        return {name: (late[name] - early[name]) / width for name in late}

    def refine(self) -> Model | None:
        """Return the model with half the integration step; None if the model does not integrate."""
        return None

    def coarser(self) -> Model | None:
        """Return the model with twice the integration step, for searches; None if that saves no time."""
        return None

    # -------------------------------------------------------- parameters

    def start(self, *names: str) -> float:
        """Return the start value of the first named parameter that the model has; 0 if it has none."""
        found = {p.name: p.start for p in self.parameters}
        return next((found[name] for name in names if name in found), 0.0)

    def estimates(self, *names: str) -> bool:
        """Return whether the model estimates one of the named parameters."""
        return any(p.name in names and p.free for p in self.parameters)

    def index(self, name: str) -> int:
        """Return the index of a parameter by name.

        Raises
        ------
        UsageError
            If the model has no such parameter. The hint has the nearest name.
        """
        names = [p.name for p in self.parameters]
        if name not in names:
            hint = suggestion(name, names, "it has")
            raise UsageError(f"the model {self.name} has no parameter '{name}'", hint=hint)
        return names.index(name)


def unless_broken(compute: Callable[..., Outcome], runs: Iterable[tuple[Any, ...]]) -> list[Outcome | None]:
    """Call a function with each tuple of arguments, and return None where the computation fails.

    Warnings of numpy are suppressed.
    """

    def one(arguments: tuple[Any, ...]) -> Outcome | None:
        try:
            return compute(*arguments)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return [one(arguments) for arguments in runs]


def choose_parameters(
    parameters: Sequence[Parameter],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Parameter, ...]:
    """Return model parameters with the choices of the user: fixed values, freed parameters, and bounds.

    Raises
    ------
    UsageError
        For an unknown name, bounds in the wrong order, or a fixed value outside the bounds.
    """
    fixed, bounds, names = dict(fixed or {}), dict(bounds or {}), [p.name for p in parameters]
    for name in (*fixed, *freed, *bounds):
        if name not in names:
            raise UsageError(f"the model has no parameter '{name}'", hint=suggestion(name, names, "it has"))
    result = []
    for parameter in parameters:
        if parameter.name in bounds:
            lower, upper = bounds[parameter.name]
            if not lower < upper:
                raise UsageError(f"{parameter.name}: the lower bound {lower} must be below {upper}")
            start = min(max(parameter.start, lower), upper)
            parameter = replace(parameter, lower=lower, upper=upper, start=start)
        if parameter.name in fixed:
            value = float(fixed[parameter.name])
            if not parameter.lower <= value <= parameter.upper:
                limits = f"it must lie between {parameter.lower:g} and {parameter.upper:g}"
                raise UsageError(f"{parameter.name} cannot be {value:g}; {limits}")
            parameter = replace(parameter, start=value, free=False)
        elif parameter.name in freed:
            parameter = replace(parameter, free=True)
        result.append(parameter)
    return tuple(result)


def share(parameters: Sequence[Parameter], groups: Mapping[str, Sequence[str]]) -> tuple[Parameter, ...]:
    """Return parameters in which each group is replaced by one shared parameter.

    The shared parameter has the index of the first member of its group. Its start value is the mean of the
    members' start values. Its bounds are the intersection of the members' bounds. Its scale is the largest
    scale of the members.

    Parameters
    ----------
    groups : mapping of name to sequence of str
        Name of each shared parameter, and the names of its members.

    Raises
    ------
    UsageError
        If a member is unknown or belongs to two groups, if the name is already used, or if members differ in
        unit or have no common value within their bounds.
    """
    known = {p.name: p for p in parameters}
    owner: dict[str, str] = {}
    for name, members in groups.items():
        for member in members:
            if member not in known:
                hint = suggestion(member, list(known), "it has")
                raise UsageError(f"the model has no parameter '{member}'", hint=hint)
            if member in owner:
                raise UsageError(f"{member} is shared twice: as {owner[member]} and as {name}")
            owner[member] = name
        if name in known and name not in members:
            raise UsageError(f"{name} is the name of a parameter outside the group: choose another name")
    found: dict[str, Parameter] = {}
    for p in parameters:
        name = owner.get(p.name, p.name)
        if name not in found:
            found[name] = _merge_members(name, [known[m] for m in groups[name]]) if p.name in owner else p
    return tuple(found.values())


def _merge_members(name: str, members: Sequence[Parameter]) -> Parameter:
    """Return the parameter that its members share."""
    first = members[0]
    for other in members[1:]:
        if (other.unit, other.per_trial) != (first.unit, first.per_trial):
            both = f"{first.name} ({first.unit}) and {other.name} ({other.unit})"
            raise UsageError(f"{both} cannot share a value: they differ in unit or per_trial")
    names = tuple(m.name for m in members)
    lower, upper = max(m.lower for m in members), min(m.upper for m in members)
    if lower > upper:
        raise UsageError(f"no value lies within the bounds of all of {', '.join(names)}")
    return replace(
        first,
        name=name,
        lower=lower,
        upper=upper,
        start=float(np.clip(np.mean([m.start for m in members]), lower, upper)),
        scale=max(m.scale for m in members),
        free=any(m.free for m in members),
        meaning=f"one value for {', '.join(names)}",
        source="",
        members=names,
    )


def groups_by_prefix(parameters: Sequence[Parameter], prefix: str) -> dict[str, tuple[str, ...]]:
    """Return one group with all parameters whose name is the prefix followed by digits.

    Raises
    ------
    UsageError
        If fewer than two parameters match. The hint has the nearest prefix.
    """
    members = tuple(p.name for p in parameters if re.fullmatch(re.escape(prefix) + r"\d+", p.name))
    if len(members) < 2:
        stems = [re.sub(r"\d+$", "", p.name) for p in parameters if re.search(r"\d+$", p.name)]
        several = sorted({s for s in stems if stems.count(s) > 1})
        hint = suggestion(prefix, several)
        raise UsageError(f"fewer than two parameters have a name of '{prefix}' and a number", hint=hint)
    return {prefix: members}


def values_of(model: Model, parameters: Sequence[Parameter], known: Mapping[str, float]) -> Array:
    """Return the values of a model's parameters from the known value of each parameter of a fit."""
    expanded = expand(parameters, known)
    return np.array([expanded[p.name] for p in model.parameters])


def expand(parameters: Sequence[Parameter], entries: Mapping[str, Entry]) -> dict[str, Entry]:
    """Return estimates or other entries by parameter, with shared parameters replaced by their members.

    The keys are parameter names or ``name[trial]``. Each member has the entry of the shared parameter, and
    therefore its standard error. The members are fully correlated.
    """
    groups = {p.name: p.members for p in parameters if p.members}
    found: dict[str, Entry] = {}
    for label, entry in entries.items():
        name, bracket, rest = label.partition("[")
        for member in groups.get(name, (name,)):
            found[member + bracket + rest] = entry
    return found


class Scales:
    """Typical scales of the quantities in the trials of a model.

    A model with more information on its forces and masses overrides these properties.

    Parameters
    ----------
    model : Model
        Model whose parameters have their start values.
    trials : sequence of Trial
    """

    #: Names of the channels whose measured range is the extent of the motion.
    places: tuple[str, ...] = POSITIONS

    def __init__(self, model: Model, trials: Sequence[Trial]) -> None:
        self.model = model
        self.trials = trials

    @property
    def duration(self) -> float:
        """Median duration of the trials, s; 1 if unknown."""
        return typical([float(t.time_s[-1] - t.time_s[0]) for t in self.trials if len(t.time_s) > 1], 1.0)

    @property
    def speed(self) -> float:
        """Typical speed of the robot, m/s (rad/s for a rotation); 0.1 if unknown."""
        return typical([v for t in self.trials if (v := _speed(t)) is not None], 0.1)

    @property
    def span(self) -> float:
        """Typical extent of the motion in a trial, m (rad for a rotation); 1 if unknown."""
        series = [t.measured[name] for t in self.trials for name in self.places if name in t.measured]
        return typical([float(np.nanmax(s) - np.nanmin(s)) for s in series if np.isfinite(s).any()], 1.0)

    @property
    def inertia(self) -> float:
        """Typical inertia of the robot with added mass, kg (kg m2 for a rotation); 1 if unknown."""
        return 1.0

    @property
    def force(self) -> float:
        """Typical force that moves the robot, in the unit :attr:`Model.force_unit`."""
        return 0.1 * self.speed**2

    @property
    def brake(self) -> float:
        """Typical size of an additional drag or friction: a tenth of the force that moves the robot."""
        return 0.1 * self.force

    @property
    def quadratic(self) -> float:
        """Smallest quadratic drag coefficient of the model among the trials; 0 if it has none."""
        return 0.0


def typical(values: Sequence[float], otherwise: float) -> float:
    """Return the median of ``values``. If there is no value or the median is 0, return ``otherwise``."""
    if not len(values):
        return otherwise
    return float(np.median(values)) or otherwise


def _speed(trial: Trial) -> float | None:
    """Return the typical speed of a trial, m/s; None if unknown."""
    for name in ("u_m_s", MEAN_SPEED):
        if name in trial.measured:
            return float(np.sqrt(np.nanmean(trial.measured[name] ** 2)))
    names = [name for name in POSITIONS if name in trial.measured]
    if not names:
        return None
    place = np.column_stack([trial.measured[name] for name in names])
    there = np.isfinite(place).all(axis=1)
    time, place = trial.time_s[there], place[there]
    every = slice(None, None, max(len(time) // N_SPEED_SEGMENTS, 1))
    if len(time) > 1 and time[every][-1] > time[0]:
        path = float(np.linalg.norm(np.diff(place[every], axis=0), axis=1).sum())
        return path / float(time[every][-1] - time[0])
    return None
