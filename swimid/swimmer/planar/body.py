"""Links of a planar robot with changes of their tables, and the typical sizes of its trials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.model import Array, Scales
from swimid.swimmer.planar import engine
from swimid.swimmer.polynomial import Polynomial

if TYPE_CHECKING:
    from swimid.swimmer.planar.model import MultilinkModel

Point = tuple[float, float]
Frames = tuple[Array, Array, Array]
STIFFNESS, CUBIC, DAMPING = (engine.PASSIVE.index(n) for n in ("stiffness", "cubic", "damping"))
WIRE = slice(engine.PASSIVE.index("spring"), engine.PASSIVE.index("crank") + 1)
QUADRATIC = [engine.DRAG.index(n) for n in ("quadratic_x", "quadratic_y", "quadratic_r")]
#: Angle at which a joint counts as straight, rad.
SMALL = 1e-4


class Body:
    """The links of a planar robot at the start values of its model's parameters, as effects ask for them.

    Attributes
    ----------
    free : bool
        The base moves; otherwise it is held.
    pose, velocity, words : tuple of str
        Channels of the reference point: two positions and the heading, two velocities in the body's axes and
        the turning rate; the same in words.
    lengths_m : tuple of float
        Length of each link, the base first.
    reference_m : (float, float)
        The reference point in the base's axes, m.
    density_kg_m3, step_s : float
        Density of the water, and longest step of the integration.
    driven, passive : sequence of Axis
    """

    def __init__(self, model: MultilinkModel) -> None:
        self._model = model
        self.free = model.free_base
        self.pose, self.velocity = model.pose, model.velocity
        self.words = tuple(word.replace("_", " ") for word in (*model.places, *model.rates))
        self.lengths_m = tuple(link.length_m for link in model.tree.links)
        self.reference_m = model.reference_m
        self.density_kg_m3 = model.robot.fluid.density_kg_m3
        self.step_s = model.max_step
        self.driven, self.passive = model.driven, model.passive
        self._masses: dict[int, tuple[float, Point]] = {}

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

    def mass(self, link: int) -> tuple[float, Point]:
        """Mass (kg) and centre of mass (m, in its axes) of a link, without water."""
        if link not in self._masses:
            own = self._model.tree.links[link]
            values = {p.name: p.start for p in self._model.parameters}
            mass, com, y = (Polynomial.of(q).at(values) for q in (own.mass_kg, own.com_m, own.com_offset_m))
            self._masses[link] = float(mass), (float(-mass * com / mass), float(mass * y / mass))
        return self._masses[link]

    def tables(self) -> dict[str, Any]:
        """The engine's tables."""
        tree = self._model.tree
        return tree.tables(np.array([p.start for p in self._model.parameters[: len(tree.names)]]))

    # -------------------------------------------------------- where its links are

    def frames(self, values: Array, columns: Mapping[str, Array]) -> Frames:
        """Front end (x, y) and heading of every link over a run, m and rad, shape (links, n) each."""
        tree, n = self._model.tree, len(next(iter(columns.values())))
        tables = tree.tables(values[: len(tree.names)])
        topology, joint = tables["topology"], tables["joint"]
        x, y, heading = np.zeros((3, len(tree.links), n))
        if self.free:
            heading[0] = columns[self.pose[2]]
            a, b = self.reference_m
            x[0] = columns[self.pose[0]] - a * np.cos(heading[0]) + b * np.sin(heading[0])
            y[0] = columns[self.pose[1]] - a * np.sin(heading[0]) - b * np.cos(heading[0])
        else:
            heading[0] = np.radians(self._model.links.heading_deg)
        angles: dict[int, Array] = {a.link: columns[a.column] for a in (*tree.driven, *tree.passive)}
        for i in range(1, len(tree.links)):
            parent = int(topology[i, 0])
            c, s = np.cos(heading[parent]), np.sin(heading[parent])
            x[i] = x[parent] + c * joint[i, 0] - s * joint[i, 1]
            y[i] = y[parent] + s * joint[i, 0] + c * joint[i, 1]
            mount = np.arctan2(joint[i, 3], joint[i, 2])
            heading[i] = heading[parent] + mount + angles.get(i, np.zeros(n))
        return x, y, heading

    def rear_ends(self, frames: Frames) -> tuple[Array, Array]:
        """Rear end (x, y) of every link, m, shape (links, n) each."""
        x, y, heading = frames
        length = np.array(self.lengths_m)[:, None]
        return x - length * np.cos(heading), y - length * np.sin(heading)

    def straight(self, values: Array) -> tuple[Array, Array]:
        """Distance of every link's front and rear end from the first front end, all joints straight, m."""
        columns = {a.column: np.zeros(1) for a in (*self._model.driven, *self._model.passive)}
        if self.free:
            columns |= {name: np.zeros(1) for name in self.pose}
        frames = self.frames(values, columns or {"": np.zeros(1)})
        x0, y0 = frames[0][0], frames[1][0]
        front, rear = (np.hypot(x - x0, y - y0)[:, 0] for x, y in (frames[:2], self.rear_ends(frames)))
        return front, rear

    def length(self, values: Array) -> float:
        """Length of the robot, m: its file's, or from the front end to the farthest link's rear end."""
        given = self._model.robot.body.length_m
        return given if given is not None else float(self.straight(values)[1].max())

    # -------------------------------------------------------- what tables say

    def axial_mass(self, tables: dict[str, Any]) -> float:
        """Mass of all links along their axes, water included, kg."""
        return float(tables["inertia"][:, 0].sum())

    def axial_drag(self, tables: dict[str, Any]) -> float:
        """Quadratic drag of all links along their axes, N s2/m2."""
        return float(tables["drag"][:, 2].sum() + tables["foil"][:, 2] @ tables["foil"][:, 4])

    def fin(self, tables: dict[str, Any]) -> tuple[float, float, Point]:
        """Gains of the last link's normal force on ``|w| w`` and on ``|u| w``, and the point it acts at."""
        drag = tables["drag"][tables["drag_link"] == self.last]
        foil = tables["foil"][tables["foil_link"] == self.last]
        quadratic = np.concatenate([drag[:, 3], 2.0 * foil[:, 2] * foil[:, 5]])
        lift = np.concatenate([np.zeros(len(drag)), 2.0 * foil[:, 2] * foil[:, 3]])
        weight = quadratic + lift
        if weight.sum() <= 0:
            return 0.0, 0.0, (0.0, 0.0)
        place = weight @ np.concatenate([drag[:, :2], foil[:, :2]]) / weight.sum()
        return float(quadratic.sum()), float(lift.sum()), (float(place[0]), float(place[1]))

    def stiffness(self, tables: dict[str, Any], joint: int) -> float:
        """Stiffness of a passive joint where it is straight, its wire and spring included, N m/rad."""
        row = tables["passive"][joint]
        wire = row[WIRE]
        taut = -engine.tendon_torque(SMALL, *wire) / SMALL if wire[0] != 0.0 else 0.0
        return float(row[STIFFNESS] + taut)

    def damping(self, tables: dict[str, Any], joint: int) -> float:
        """Torque per rate of a passive joint, N m s/rad."""
        return float(tables["passive"][joint, DAMPING])

    def joint_inertia(self, tables: dict[str, Any], joint: int) -> float:
        """Inertia about a passive joint of the link it carries, water included, kg m2."""
        return float(tables["inertia"][self.passive[joint].link, 5])

    def carried(self, tables: dict[str, Any], joint: int) -> tuple[float, float]:
        """What a driven joint turns, all joints beyond it straight: inertia and quadratic drag about it.

        In kg m2, water included, and N m s2/rad2, of still water.
        """
        root, topology = self.driven[joint].link, tables["topology"]
        straight = {a.column: np.zeros(1) for a in (*self.driven, *self.passive)}
        straight |= {name: np.zeros(1) for name in self.pose}
        start = np.array([p.start for p in self._model.parameters])
        x, y, heading = (part[:, 0] for part in self.frames(start, straight))
        inertia, drag = 0.0, 0.0
        moved = np.zeros(len(x), dtype=bool)
        for link in range(root, len(x)):
            moved[link] = link == root or moved[topology[link, 0]]
            if not moved[link]:
                continue
            c, s = np.cos(heading[link]), np.sin(heading[link])
            dx, dy = x[link] - x[root], y[link] - y[root]
            # velocity of the link at one rad/s: along, across and turning
            along, across = s * dx - c * dy, c * dx + s * dy
            uu, uv, ur, vv, vr, rr = tables["inertia"][link]
            inertia += uu * along**2 + vv * across**2 + rr
            inertia += 2.0 * (uv * along * across + ur * along + vr * across)
            own = tables["drag"][tables["drag_link"] == link]
            drag += own[:, 2] @ np.abs(along - own[:, 1]) ** 3 + own[:, 3] @ np.abs(across + own[:, 0]) ** 3
            drag += own[:, 6].sum()
            fin = tables["foil"][tables["foil_link"] == link]
            flat = fin[:, 2] * (fin[:, 4] + 2.0 * fin[:, 5])
            drag += flat @ np.hypot(along - fin[:, 1], across + fin[:, 0]) ** 3
        return float(inertia), float(drag)

    def normal_drag(self, tables: dict[str, Any]) -> tuple[NDArray[np.int64], Array]:
        """The points where drag acts across links: link of each; place (x, y) and gain on ``|w| w``."""
        there = tables["drag"][:, 3] > 0
        return tables["drag_link"][there], tables["drag"][there][:, [0, 1, 3]]

    # -------------------------------------------------------- what changes them

    def weigh(self, tables: dict[str, Any], link: int, at: Point, along: float, across: float) -> None:
        """Add a mass (kg) at a point of a link; it may differ by direction."""
        x, y = at
        rows = tables["inertia"].copy()
        rows[link] += (along, 0.0, -along * y, across, across * x, along * y * y + across * x * x)
        tables["inertia"] = rows

    def shift(self, tables: dict[str, Any], link: int, by: Point) -> None:
        """Move the centre of mass of a link and the weight that acts there, m."""
        mass, (x, y) = self.mass(link)
        self.weigh(tables, link, (x, y), -mass, -mass)
        self.weigh(tables, link, (x + by[0], y + by[1]), mass, mass)
        force = tables["force"].copy()
        for row, owner in zip(force, tables["force_link"], strict=True):
            down = row[4] == 1.0 and row[3] < 0.0
            if owner == link and down and np.allclose(row[:2], (x, y), atol=1e-9):
                row[:2] += by
        tables["force"] = force

    def drag_more(self, tables: dict[str, Any], link: int, at: Point, linear: float) -> None:
        """Add a drag in proportion to the speed at a point of a link, N s/m."""
        tables["drag_link"] = np.append(tables["drag_link"], link)
        tables["drag"] = np.vstack([tables["drag"], [*at, 0.0, 0.0, linear, linear, 0.0, 0.0]])

    def room(self) -> dict[str, list[int]]:
        """Links of what :meth:`drag_more` at the heaviest link, :meth:`lift` and :meth:`shed` add."""
        links, _ = self.normal_drag(self.tables())
        return {"drag": [self.hull], "foil": [int(link) for link in links], "wake": [self.last]}

    def drag_times(self, tables: dict[str, Any], factor: float) -> None:
        """Multiply every quadratic drag coefficient of the links."""
        tables["drag"][:, QUADRATIC] *= factor

    def lift(self, tables: dict[str, Any], links: NDArray[np.int64], points: Array) -> None:
        """Add forces ``-k V w`` across links, V the speed of a point and w that across (m/s, k in N s2/m2).

        A fin whose lift and drag coefficients ``C_L sin(2 a)`` and ``C_L (1 - cos(2 a))`` have no resultant
        along its chord: across it, ``2 C_L sin(a)``.
        """
        one = np.ones(len(points))
        half = 0.5 * one
        rows = np.column_stack([points, half, 0.0 * one, half, one, 0.0 * one])
        tables["foil_link"] = np.append(tables["foil_link"], links)
        tables["foil"] = np.vstack([tables["foil"], rows])

    def shed(self, tables: dict[str, Any], mass_kg_m: float) -> None:
        """Add a trailing edge at the rear end of the last link, added mass per length in kg/m."""
        tables["wake_link"] = np.append(tables["wake_link"], self.last)
        tables["wake"] = np.vstack([tables["wake"], [-self.lengths_m[-1], 0.0, 0.5 * mass_kg_m]])

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
        passive = tables["passive"].copy()
        passive[joint, [STIFFNESS, CUBIC, DAMPING]] += stiffness, cubic, damping
        tables["passive"] = passive


class SwimmerScales(Scales):
    """Typical sizes of a planar robot's trials."""

    model: MultilinkModel

    @property
    def inertia(self) -> float:
        """Mass of all links along their axes, water included, kg."""
        body = self.model.body
        return body.axial_mass(body.tables())

    @property
    def force(self) -> float:
        """Drag at the typical speed, and what gets the body up to it, N."""
        body, speed = self.model.body, self.speed
        return body.axial_drag(body.tables()) * speed**2 + self.inertia * speed / self.duration
