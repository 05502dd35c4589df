"""Hooks: the places where an effect changes the simulation of a model.

The simulation runs from command over actuation, structure, fluid, environment and sensing to the log. An
effect enters at one of these places as a hook. A model without hooks runs as fast as if there were none.
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

# numba still calls compiled functions as arguments of compiled functions experimental
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

#: ``force(t, pose, velocity, constants, wrench)``: see :class:`Force`.
FORCE_SIGNATURE = types.void(
    types.float64, types.float64[::1], types.float64[::1], types.float64[::1], types.float64[::1]
)
#: Maximum number of forces in a compiled step: those of three effects, and of one that is tried beside them.
MOST_FORCES = 4


@cfunc(FORCE_SIGNATURE, cache=True)
def no_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add nothing to the wrench."""


@dataclass(frozen=True)
class Traceable:
    """A function of a :class:`Force` that can also be traced with symbols, for batches of simulations.

    Attributes
    ----------
    function : compiled function
    on : str
        Link of a robot with links on which it acts: the base, the heaviest or the last.
    constants : int
        Number of its constants.
    """

    function: Any
    on: Literal["base", "hull", "last"]
    constants: int


#: Traceable functions of all modules that have been imported, by module and name.
TRACEABLE: dict[str, Traceable] = {}


def traceable(on: Literal["base", "hull", "last"], constants: int) -> Callable[[Callable[..., None]], Any]:
    """Compile a function of a :class:`Force` that can be traced (see :class:`Traceable`).

    The function branches on values only by ``max``, ``min`` and ``abs``, and uses only sine and cosine of the
    heading.
    """

    def compiled(function: Callable[..., None]) -> Any:
        made = cfunc(FORCE_SIGNATURE, cache=True)(function)
        TRACEABLE[f"{function.__module__}.{function.__qualname__}"] = Traceable(made, on, constants)
        return made

    return compiled


@dataclass(frozen=True)
class Force:
    """A force on one link, computed inside the compiled step."""

    #: Numba cfunc of :data:`FORCE_SIGNATURE`, by :func:`traceable` if batches of simulations use it. It adds
    #: to ``wrench`` (fx, fy, moment) at the point, in the axes of the link, N and N m. Its arguments are the
    #: time (s), the ``pose`` (x, y of the reference point of the base in the world, heading of the link, m
    #: and rad), the ``velocity`` of the point through the water in the axes of the link and the yaw rate of
    #: the link, m/s and rad/s, and its ``constants``. A rig has one coordinate: pose[0], velocity[0],
    #: wrench[0]; velocity[2] is its speed over ground.
    function: Any
    #: Shape (c,).
    constants: Array
    #: Index of the link of a robot with links, 0 for the base, -1 for the last.
    link: int = 0
    #: The point in the axes of the link, m.
    x: float = 0.0
    y: float = 0.0


@dataclass(frozen=True)
class Stroke:
    """A steady beat, for models that average over it; arrays over runs, or single values.

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


#: From time (s), angle or signal, and number of the driven joint to the output of the actuator.
Command = Callable[[Array, Array, int], Array]
#: From the simulated channels and their times to the channels that the sensors show.
Output = Callable[[dict[str, Array], Array], dict[str, Array]]
#: From time (s) to displacement (m) and velocity (m/s) of the water in the world, shape (n, 2) each.
Flow = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Hooks:
    """Functions at the places of a simulation; the functions of each place act in their order."""

    #: Change the command of each driven joint, or of the input column of a black-box model.
    command: tuple[Command, ...] = ()
    #: Change the steady beat of models of the average over a beat.
    stroke: tuple[Callable[[Stroke], Stroke], ...] = ()
    #: Change the tables of a multi-link engine in place: dict of name to array
    #: (:mod:`swimid.swimmer.planar.engine`, columns ``INERTIA``, ``PASSIVE``, ``DRAG`` ...).
    tables: tuple[Callable[[dict[str, Any]], None], ...] = ()
    #: Change the coefficients of a model of one equation in place: dict of name to float.
    coefficients: tuple[Callable[[dict[str, float]], None], ...] = ()
    #: Add forces, at most :data:`MOST_FORCES`.
    force: tuple[Force, ...] = ()
    #: Move the water, relative to which all fluid forces act.
    flow: tuple[Flow, ...] = ()
    #: Change the output of the sensors.
    output: tuple[Output, ...] = ()
    #: The log shows events this much earlier.
    clock_s: float = 0.0
    #: The log shows events earlier by this share of its time.
    clock_drift: float = 0.0
    #: Identifies the motion: hooks with one key move the robot alike.
    key: bytes = b""
    #: Identifies the commands in the same way.
    command_key: bytes = b""

    def __add__(self, other: Hooks) -> Hooks:
        return Hooks(*(getattr(self, name) + getattr(other, name) for name in _FIELDS))

    @property
    def moves(self) -> bool:
        """Whether anything changes the motion itself, and not only how it is seen."""
        return bool(
            self.command or self.stroke or self.tables or self.coefficients or self.force or self.flow
        )

    def actuated(self, time_s: Array, command: Array, joint: int = 0) -> Array:
        """Return the command after all actuation hooks."""
        for change in self.command:
            command = change(time_s, command, joint)
        return command

    def beaten(self, stroke: Stroke) -> Stroke:
        """Return the stroke after all stroke hooks."""
        for change in self.stroke:
            stroke = change(stroke)
        return stroke

    def changed(self, values: dict[str, Any], hooks: str) -> dict[str, Any]:
        """Return ``values`` after all ``tables`` or ``coefficients`` hooks, which work in place."""
        for change in getattr(self, hooks):
            change(values)
        return values

    @property
    def late(self) -> bool:
        """Whether the clock of the log differs from that of the drive."""
        return self.clock_s != 0.0 or self.clock_drift != 0.0

    def happened(self, time_s: Array) -> Array:
        """Return the times, s, of the events that a log shows at these times."""
        return time_s - (self.clock_s + self.clock_drift * time_s) if self.late else time_s

    def seen(self, channels: Mapping[str, Array], time_s: Array) -> dict[str, Array]:
        """Return the channels after all sensing hooks."""
        found = dict(channels)
        for change in self.output:
            found = change(found, time_s)
        return found


_FIELDS = tuple(field.name for field in fields(Hooks))
#: Hooks that change nothing.
NONE = Hooks()
