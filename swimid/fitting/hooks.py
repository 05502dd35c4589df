"""Hooks: functions by which an effect changes the simulation of a model.

A simulation has these parts, in order: command, actuation, structure, fluid, environment, sensing, log. An
effect changes one or more of these parts by a hook. Without hooks a model simulates at its full speed.
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

# suppress numba's warning that compiled functions as arguments of compiled functions are experimental
warnings.filterwarnings("ignore", category=NumbaExperimentalFeatureWarning)

#: Signature ``force(t, pose, velocity, constants, wrench)`` of the function of a :class:`Force`.
FORCE_SIGNATURE = types.void(
    types.float64, types.float64[::1], types.float64[::1], types.float64[::1], types.float64[::1]
)
#: Maximum number of forces in a compiled step: one for each of three effects, and one for an effect that is
#: tested in addition to them.
MOST_FORCES = 4


@cfunc(FORCE_SIGNATURE, cache=True)
def no_force(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Leave the wrench unchanged."""


@dataclass(frozen=True)
class Traceable:
    """A function of a :class:`Force` that can also be traced with symbols to simulate batches of trials.

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


#: Traceable functions of all imported modules, by module and function name.
TRACEABLE: dict[str, Traceable] = {}


def traceable(on: Literal["base", "hull", "last"], constants: int) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that compiles a function of a :class:`Force` that can be traced.

    The function must branch on values only by ``max``, ``min`` and ``abs``. It may use the heading only in
    sine and cosine. See :class:`Traceable`.
    """

    def compiled(function: Callable[..., None]) -> Any:
        made = cfunc(FORCE_SIGNATURE, cache=True)(function)
        TRACEABLE[f"{function.__module__}.{function.__qualname__}"] = Traceable(made, on, constants)
        return made

    return compiled


@dataclass(frozen=True)
class Force:
    """A force on one link, evaluated inside the compiled integration step."""

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
    """A steady tail beat for models that average over a beat; fields are single values or one value per run.

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


#: Function of time (s), command (angle or signal) and index of the driven joint that returns the output of
#: the actuator.
Command = Callable[[Array, Array, int], Array]
#: Function of the simulated channels and their times (s) that returns the channels as the sensors measure
#: them.
Output = Callable[[dict[str, Array], Array], dict[str, Array]]
#: Function of time (s) that returns displacement (m) and velocity (m/s) of the water in the world, shape (n,
#: 2) each.
Flow = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Hooks:
    """Functions that change a simulation. Several functions of one kind act in the given order."""

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
    #: Forces that are added, at most :data:`MOST_FORCES`.
    force: tuple[Force, ...] = ()
    #: Motions of the water. All fluid forces depend on the velocity relative to the water.
    flow: tuple[Flow, ...] = ()
    #: Functions that change the output of the sensors.
    output: tuple[Output, ...] = ()
    #: Time by which the log shows events too early, s.
    clock_s: float = 0.0
    #: Time by which the log shows events too early, as a fraction of the time in the log. This time is
    #: added to ``clock_s``.
    clock_drift: float = 0.0
    #: Identifier of the motion: simulations whose hooks have the same key have the same motion.
    key: bytes = b""
    #: Identifier of the commands: simulations whose hooks have the same key have the same commands.
    command_key: bytes = b""

    def __add__(self, other: Hooks) -> Hooks:
        return Hooks(*(getattr(self, name) + getattr(other, name) for name in _FIELDS))

    @property
    def moves(self) -> bool:
        """Whether a hook changes the motion itself, and not only its measurement."""
        return bool(
            self.command or self.stroke or self.tables or self.coefficients or self.force or self.flow
        )

    def actuated(self, time_s: Array, command: Array, joint: int = 0) -> Array:
        """Return the output of the actuator of a driven joint, after all ``command`` hooks."""
        for change in self.command:
            command = change(time_s, command, joint)
        return command

    def beaten(self, stroke: Stroke) -> Stroke:
        """Return the steady beat after all ``stroke`` hooks."""
        for change in self.stroke:
            stroke = change(stroke)
        return stroke

    def changed(self, values: dict[str, Any], hooks: str) -> dict[str, Any]:
        """Return ``values`` after all ``tables`` or ``coefficients`` hooks, which change them in place."""
        for change in getattr(self, hooks):
            change(values)
        return values

    @property
    def late(self) -> bool:
        """Whether the clock of the log differs from the clock of the drive."""
        return self.clock_s != 0.0 or self.clock_drift != 0.0

    def happened(self, time_s: Array) -> Array:
        """Return the true times of the events that the log shows at the given times, s."""
        return time_s - (self.clock_s + self.clock_drift * time_s) if self.late else time_s

    def seen(self, channels: Mapping[str, Array], time_s: Array) -> dict[str, Array]:
        """Return the channels after all ``output`` hooks."""
        found = dict(channels)
        for change in self.output:
            found = change(found, time_s)
        return found


_FIELDS = tuple(field.name for field in fields(Hooks))
#: Hooks that change nothing.
NONE = Hooks()
