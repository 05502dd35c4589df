"""What a model of a robot with links tells of its body, and how its tables are changed.

The tables are those a ``tables`` hook is given (:class:`swimid.fitting.hooks.Hooks`); only the body knows
what stands where in them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from swimid.robots.planar import Driven

Array = NDArray[np.float64]
Point = tuple[float, float]
Frames = tuple[Array, Array, Array]


@dataclass(frozen=True)
class Axis:
    """A joint (or hinge) of a robot file that moves, its column in a log, and the link it turns."""

    joint: Any
    column: str
    link: int

    @property
    def name(self) -> str:
        """Of the joint."""
        return str(self.joint.name)

    @property
    def driven(self) -> Driven | None:
        """How it follows the drive; None where it yields."""
        law: Driven | None = self.joint.driven
        return law

    @property
    def rate(self) -> str:
        """The column of its rate."""
        return self.column.replace("_rad", "_rate_rad_s")


class Body(ABC):
    """Links in a plane, joined by driven and passive joints, at the start values of a model's parameters."""

    #: The base moves; otherwise it is held.
    free: bool
    #: Channels of the reference point: two positions and the heading, two velocities in the body's axes and
    #: the turning rate.
    pose: tuple[str, str, str]
    velocity: tuple[str, str, str]
    #: The same in words.
    words: tuple[str, ...]
    #: Of each link, the base first.
    lengths_m: tuple[float, ...]
    #: The reference point in the base's axes, m.
    reference_m: Point
    #: Of the water.
    density_kg_m3: float
    #: Longest step of the integration.
    step_s: float
    driven: Sequence[Axis]
    passive: Sequence[Axis]

    @property
    def vertical(self) -> bool:
        """Whether its plane of motion is vertical."""
        return "z_m" in self.pose

    @property
    def last(self) -> int:
        """The last link."""
        return len(self.lengths_m) - 1

    @property
    def masses_kg(self) -> list[float]:
        """Mass of each link, without water."""
        return [self.mass(link)[0] for link in range(len(self.lengths_m))]

    @property
    def hull(self) -> int:
        """The heaviest link."""
        return int(np.argmax(self.masses_kg))

    def centre(self, link: int) -> Point:
        """Centre of mass of a link in its axes, m."""
        return self.mass(link)[1]

    @abstractmethod
    def mass(self, link: int) -> tuple[float, Point]:
        """Mass (kg) and centre of mass (m, in its axes) of a link, without water."""

    @abstractmethod
    def tables(self) -> dict[str, Any]:
        """The tables of the equations of motion."""

    # -------------------------------------------------------- where its links are

    @abstractmethod
    def frames(self, values: Array, columns: Mapping[str, Array]) -> Frames:
        """Front end (x, y) and heading of every link over a run, m and rad, shape (links, n) each."""

    @abstractmethod
    def rear_ends(self, frames: Frames) -> tuple[Array, Array]:
        """Rear end (x, y) of every link, m, shape (links, n) each."""

    @abstractmethod
    def straight(self, values: Array) -> tuple[Array, Array]:
        """Distance of every link's front and rear end from the first front end, all joints straight, m."""

    @abstractmethod
    def length(self, values: Array) -> float:
        """Length of the robot, m."""

    # -------------------------------------------------------- what tables say

    @abstractmethod
    def axial_mass(self, tables: dict[str, Any]) -> float:
        """Mass of all links along their axes, water included, kg."""

    @abstractmethod
    def axial_drag(self, tables: dict[str, Any]) -> float:
        """Quadratic drag of all links along their axes, N s2/m2."""

    @abstractmethod
    def fin(self, tables: dict[str, Any]) -> tuple[float, float, Point]:
        """Gains of the last link's normal force on ``|w| w`` and on ``|u| w``, and the point it acts at."""

    @abstractmethod
    def stiffness(self, tables: dict[str, Any], joint: int) -> float:
        """Stiffness of a passive joint where it is straight, its wire and spring included, N m/rad."""

    @abstractmethod
    def damping(self, tables: dict[str, Any], joint: int) -> float:
        """Torque per rate of a passive joint, N m s/rad."""

    @abstractmethod
    def joint_inertia(self, tables: dict[str, Any], joint: int) -> float:
        """Inertia about a passive joint of the link it carries, water included, kg m2."""

    @abstractmethod
    def carried(self, tables: dict[str, Any], joint: int) -> tuple[float, float]:
        """What a driven joint turns, all joints beyond it straight: inertia and quadratic drag about it.

        In kg m2, water included, and N m s2/rad2, of still water.
        """

    @abstractmethod
    def normal_drag(self, tables: dict[str, Any]) -> tuple[NDArray[np.int64], Array]:
        """The points where drag acts across links: link of each; place (x, y) and gain on ``|w| w``."""

    # -------------------------------------------------------- what changes them

    @abstractmethod
    def weigh(self, tables: dict[str, Any], link: int, at: Point, along: float, across: float) -> None:
        """Add a mass (kg) at a point of a link; it may differ by direction."""

    @abstractmethod
    def shift(self, tables: dict[str, Any], link: int, by: Point) -> None:
        """Move the centre of mass of a link and the weight that acts there, m."""

    @abstractmethod
    def drag_more(self, tables: dict[str, Any], link: int, at: Point, linear: float) -> None:
        """Add a drag in proportion to the speed at a point of a link, N s/m."""

    @abstractmethod
    def drag_times(self, tables: dict[str, Any], factor: float) -> None:
        """Multiply every quadratic drag coefficient of the links."""

    @abstractmethod
    def lift(self, tables: dict[str, Any], links: NDArray[np.int64], points: Array) -> None:
        """Add forces ``-k V w`` across links, V the speed of a point and w that across.

        Parameters
        ----------
        links : ndarray of int, shape (n,)
        points : ndarray, shape (n, 3)
            Place (x, y) in the link's axes, m, and k, N s2/m2.
        """

    @abstractmethod
    def shed(self, tables: dict[str, Any], mass_kg_m: float) -> None:
        """Add a trailing edge at the rear end of the last link, added mass per length in kg/m."""

    @abstractmethod
    def stiffen(
        self,
        tables: dict[str, Any],
        joint: int,
        *,
        stiffness: float = 0.0,
        cubic: float = 0.0,
        damping: float = 0.0,
    ) -> None:
        """Add to the law of a passive joint: N m/rad, N m/rad3 and N m s/rad."""
