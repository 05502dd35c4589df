"""What acts on a model's chain besides the model's own equations.

The chain runs command -> actuation -> structure -> fluid and environment -> sensing -> log. An
effect that a model does not know enters at one of these places as a hook; a model without hooks
runs as fast as if there were none.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numba import cfunc, types
from numba.core.errors import NumbaExperimentalFeatureWarning
from numpy.typing import NDArray

Array = NDArray[np.float64]

# compiled functions as arguments of compiled functions have been "experimental" for years
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

#: ``force(t, pose, velocity, constants, wrench)``: see :class:`Force`.
FORCE_SIGNATURE = types.void(
    types.float64, types.float64[::1], types.float64[::1], types.float64[::1], types.float64[::1]
)
#: How many forces act at once in a compiled step: three causes and one that is tried beside them.
MOST_FORCES = 4


@cfunc(FORCE_SIGNATURE, cache=True)
def no_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Nothing."""


@dataclass(frozen=True)
class Traceable:
    """A function of a :class:`Force` that also runs on symbols, for many runs side by side.

    Attributes
    ----------
    function : compiled function
    on : str
        The link of a multi-link robot on which it acts: the base, the heaviest or the last.
    constants : int
        How many it takes.
    """

    function: Any
    on: Literal["base", "hull", "last"]
    constants: int


#: By module and name, of all modules that have been imported; a model takes them when it is prepared.
TRACEABLE: dict[str, Traceable] = {}


def traceable(on: Literal["base", "hull", "last"], constants: int) -> Callable[[Callable[..., None]], Any]:
    """Compile a function of a :class:`Force` that can be traced (see :class:`Traceable`).

    It asks no question of a value but by ``max``, ``min`` and ``abs``, and of the heading sine and cosine.
    """

    def compiled(function: Callable[..., None]) -> Any:
        made = cfunc(FORCE_SIGNATURE, cache=True)(function)
        TRACEABLE[f"{function.__module__}.{function.__qualname__}"] = Traceable(made, on, constants)
        return made

    return compiled


@dataclass(frozen=True)
class Force:
    """A force on one link, computed inside the compiled step."""

    #: Numba cfunc of :data:`FORCE_SIGNATURE`, by :func:`traceable` where lanes shall take it. Adds to
    #: ``wrench`` (fx, fy, moment) at the point, in the link's axes, N and N m. It is given the time (s), the
    #: ``pose`` (x, y of the reference point of the base in the world, heading of the link, m and rad), the
    #: ``velocity`` of the point through the water in the link's axes and the yaw rate of the link, m/s and
    #: rad/s, and its ``constants``. A rig has one coordinate: pose[0], velocity[0], wrench[0]; velocity[2]
    #: is its speed over ground.
    function: Any
    #: Shape (c,).
    constants: Array
    #: Of a multi-link robot, 0 the base; -1 the last.
    link: int = 0
    #: The point in the link's axes, m.
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True)
class Stroke:
    """A steady beat, for models that average over it; arrays over runs, or numbers.

    Attributes
    ----------
    frequency_hz, amplitude_rad
    thrust : factor on the force or power the fin delivers; 1 where nothing acts on it.
    inertia_kg_m2 : hydrodynamic inertia of the fin, NaN where it is not known.
    """

    frequency_hz: Array
    amplitude_rad: Array
    thrust: Array
    inertia_kg_m2: float = float("nan")


#: time (s), angle or signal, number of the driven joint -> what the actuator really does.
Command = Callable[[Array, Array, int], Array]
#: The simulated channels and their times -> what the sensors say.
Output = Callable[[dict[str, Array], Array], dict[str, Array]]
#: Time (s) -> displacement (m) and velocity (m/s) of the water in the world, shape (n, 2) each.
Flow = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Hooks:
    """Functions at the places of the chain; each tuple acts in its order."""

    #: Actuation: of each driven joint, or of the input column of a black-box model.
    command: tuple[Command, ...] = ()
    #: The same for models of the average over a beat.
    stroke: tuple[Callable[[Stroke], Stroke], ...] = ()
    #: Change the tables of a multi-link engine in place: dict of name to array
    #: (:mod:`swimid.swimmer.planar.engine`, columns ``INERTIA``, ``PASSIVE``, ``DRAG`` ...).
    tables: tuple[Callable[[dict[str, Any]], None], ...] = ()
    #: Change the coefficients of a model of one equation in place: dict of name to float.
    coefficients: tuple[Callable[[dict[str, float]], None], ...] = ()
    #: At most :data:`MOST_FORCES`.
    force: tuple[Force, ...] = ()
    #: Water that moves; all fluid forces act relative to it.
    flow: tuple[Flow, ...] = ()
    #: Sensing.
    output: tuple[Output, ...] = ()
    #: The log shows what happened this much earlier ...
    clock_s: float = 0.0
    #: ... and earlier by this share of its time.
    clock_drift: float = 0.0
    #: Tells one motion from another; two hooks of one key move the robot alike.
    key: bytes = b""
    #: The same of the commands alone.
    command_key: bytes = b""

    def __add__(self, other: Hooks) -> Hooks:
        return Hooks(*(getattr(self, name) + getattr(other, name) for name in _FIELDS))

    @property
    def moves(self) -> bool:
        """Whether anything acts on the motion itself, not only on how it is seen."""
        return bool(
            self.command or self.stroke or self.tables or self.coefficients or self.force or self.flow
        )

    def actuated(self, time_s: Array, command: Array, joint: int = 0) -> Array:
        """The command after all actuation hooks."""
        for change in self.command:
            command = change(time_s, command, joint)
        return command

    def beaten(self, stroke: Stroke) -> Stroke:
        """The stroke after all stroke hooks."""
        for change in self.stroke:
            stroke = change(stroke)
        return stroke

    def changed(self, values: dict[str, Any], hooks: str) -> dict[str, Any]:
        """``values`` after all ``tables`` or ``coefficients`` hooks; the hooks work in place."""
        for change in getattr(self, hooks):
            change(values)
        return values

    @property
    def late(self) -> bool:
        """Whether the clock of the log is not the drive's."""
        return self.clock_s != 0.0 or self.clock_drift != 0.0

    def happened(self, time_s: Array) -> Array:
        """When what a log shows at these times happened, s."""
        return time_s - (self.clock_s + self.clock_drift * time_s) if self.late else time_s

    def seen(self, channels: Mapping[str, Array], time_s: Array) -> dict[str, Array]:
        """The channels after all sensing hooks."""
        found = dict(channels)
        for change in self.output:
            found = change(found, time_s)
        return found


_FIELDS = tuple(field.name for field in fields(Hooks))
#: Nothing acts.
NONE = Hooks()
