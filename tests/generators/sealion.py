"""A robot with prescribed hinges in space, made without the models of swimid.

All hinges are prescribed, so the robot is one body of changing shape. Its state is the total impulse
(Kirchhoff: momentum of the robot, of the water inside it and of the water it sets in motion), linear
and angular about the origin of the world, in the world's axes, and the pose of the base link. In
these coordinates the rate of the impulse is the external wrench and nothing else: no accelerations,
no second derivatives of the hinges, no Coriolis or Munk terms are ever written down. With the twist
``V = (velocity of the base's material point at the world's origin, rate of turn)``

    impulse = M(pose, angles) V + h(pose, angles, angular rates)

is solved for V at every evaluation, and DOP853 integrates from break to break of the hinges' splines.

The flow is not that of the package's elements in everything:

- Lamb's integrals by quadrature;
- drag along y and z of a round link acts along the cross-flow, ``rho/2 A |v_yz| (C_y v_y, C_z v_z)``, with
  ``|v| = sqrt(v.v + smoothing^2)``, over fine slices as wide as an ellipse on the file's row of strips (or on
  the link's spheroid where the file has but a point), of the file's area. While nothing moves sideways this
  is the file's law ``rho/2 C A |v| v`` but for the smoothing and the slimmer ends;
- drag of the flippers is integrated along their span;
- what comes out of the water loses the share of a spherical cap.

Whoever fits the file's law to both strokes is off by a few per cent with data of no noise.

Robot: a ``swimid-robot/1`` file's ``multibody`` part, as plain data ("Tuning hydrodynamic coefficients
using a genetic algorithm for a numerical model of a bio-robotic sea lion"; Eqs 3 to 9).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline, PPoly
from scipy.spatial.transform import Rotation

ROBOT_FILE = Path(__file__).parents[2] / "swimid" / "robots" / "sealion.yaml"
FRAMES_HZ = 30.0
#: Standard deviations of a camera's positions and angles, and of an encoder's angles. A good film from the
#: side is tracked to half a millimetre and a few hundredths of a degree.
POSITION_M, ANGLE_RAD, ENCODER_RAD = 0.001, np.radians(0.1), np.radians(0.05)


@dataclass(frozen=True)
class Coefficients:
    """What the trials are to tell, and what else is not as in the robot file; SI."""

    water_volume: float = 0.0085
    com_offset: float = 0.016
    z_added_mass: float = 1.35
    z_drag: float = 1.65
    buoyancy: float = 1.0
    others: dict[str, float] = field(default_factory=dict)

    def values(self) -> dict[str, float]:
        """All of them by name."""
        named = asdict(self)
        return {**named.pop("others"), **named}


@dataclass(frozen=True)
class Water:
    """The water and how finely it is cut; ``gravity`` 0 leaves weight and buoyancy out.

    With ``slices`` None drag is as in the robot file: Gauss's strips, each axis for itself. The factors of
    a spheroid multiply its added masses along the axes and its added inertias, that about y with the factor
    along z and the other way round: every slice moves that much more water.
    """

    density: float = 1000.0
    gravity: float = 9.81
    slices: int | None = 60
    flipper_slices: int = 20
    smoothing_m_s: float = 0.002


@dataclass(frozen=True)
class Motion:
    """Angles of the driven hinges, rad, in the file's order, as piecewise polynomials of time.

    ``pieces`` has shape (degree + 1, len(breaks) - 1, hinges), highest power first, of the time since
    the piece's break.
    """

    breaks: np.ndarray
    pieces: np.ndarray

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Angles and rates at one time."""
        piece = int(np.clip(np.searchsorted(self.breaks, time, side="right") - 1, 0, len(self.breaks) - 2))
        since = time - self.breaks[piece]
        angle, rate = self.pieces[0, piece], np.zeros(self.pieces.shape[2])
        for coefficient in self.pieces[1:, piece]:
            rate = rate * since + angle
            angle = angle * since + coefficient
        return angle, rate

    def angles(self, time: np.ndarray) -> np.ndarray:
        """Shape (n, hinges)."""
        return np.asarray(PPoly(self.pieces, self.breaks)(time))


# ---------------------------------------------------------------- the robot file


def read_robot(path: Path = ROBOT_FILE) -> dict[str, Any]:
    """A robot file's ``multibody`` part, as plain data."""
    body: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))["multibody"]
    return body


def driven_hinges(body: Mapping[str, Any]) -> list[str]:
    """Names, in the file's order."""
    return [j["name"] for j in body["joints"] if j.get("driven") is not None]


def lamb(semi_major: float, semi_minor: float) -> tuple[float, float, float]:
    """Added mass along and across a prolate spheroid, and added inertia about a short axis.

    Over the mass of the water displaced, and over that water's moment of inertia (Lamb, articles 114, 373).
    """
    a, b = 1.0, semi_minor / semi_major

    # the half-line onto (0, 1): lam = s / (1 - s)
    def integral(powers: tuple[float, float]) -> float:
        def integrand(s: float) -> float:
            lam = s / (1.0 - s)
            return a * b**2 / ((a**2 + lam) ** powers[0] * (b**2 + lam) ** powers[1] * (1.0 - s) ** 2)

        value, _ = quad(integrand, 0.0, 1.0, epsabs=1e-13, epsrel=1e-12, limit=400)
        return float(value)

    alpha, beta = integral((1.5, 1.0)), integral((0.5, 2.0))
    less, more = a**2 - b**2, a**2 + b**2
    turning = less**2 * (beta - alpha) / (more * (2.0 * less - more * (beta - alpha)))
    return alpha / (2.0 - alpha), beta / (2.0 - beta), turning


def _cross(a: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


@dataclass(frozen=True)
class _Points:
    """Points at which water or weight acts, an entry each.

    ``strength`` is the force upwards, or rho/2 C A along each axis of the link; ``together`` says whether y
    and z act on the cross-flow. ``maps``, shape (3 points, 6 links), makes velocities of points of twists of
    links and, transposed, wrenches of forces, all in the links' axes.
    """

    link: np.ndarray
    at: np.ndarray
    strength: np.ndarray
    half_height: np.ndarray
    together: np.ndarray
    stays: np.ndarray
    maps: np.ndarray

    @classmethod
    def of(cls, rows: list[tuple[Any, ...]], links: int) -> _Points:
        """From rows of the first five; an infinite height never leaves the water."""
        link, at, strength, half_height, together = (np.array(c) for c in zip(*rows, strict=True))
        maps = np.zeros((len(rows), 3, links, 6))
        for i, (k, place) in enumerate(zip(link, at, strict=True)):
            maps[i, :, k] = np.hstack([np.eye(3), -_cross(place)])
        stays = np.isinf(half_height)
        return cls(link, at, strength, half_height, together, stays, maps.reshape(3 * len(rows), 6 * links))


class Robot:
    """Arrays of a robot in the water.

    Parameters
    ----------
    body : mapping
        The ``multibody`` part of a robot file: rigid and driven hinges; water, hydrostatics, spheroids,
        plates and drag without linear part; at least one each of hydrostatics and drag.
    values : mapping of coefficient to float
        Over the file's own.
    water : Water
    """

    def __init__(
        self, body: Mapping[str, Any], values: Mapping[str, float] | None = None, water: Water | None = None
    ) -> None:
        own = {name: c["value"] for name, c in body.get("coefficients", {}).items()}
        unknown = set(values or {}) - set(own)
        if unknown:
            raise ValueError(f"the robot has no coefficient {sorted(unknown)}")
        self.values = {**own, **(values or {})}
        self.body, self.water = body, water or Water()
        self.hinges = driven_hinges(body)
        self.links = self._in_order()
        self._index = {link["name"]: k for k, link in enumerate(self.links)}
        self._tree()
        self._spheroids = {e["link"]: e for e in body["elements"] if e["kind"] == "spheroid"}
        self.inertia = np.zeros((len(self.links), 6, 6))
        for k, link in enumerate(self.links):
            mass, central = self.number(link.get("mass_kg", 0.0)), self._tensor(link)
            self._add(k, mass * np.eye(3), central, self.vector(link.get("com_m")))
        points: dict[str, list[tuple[Any, ...]]] = {"lift": [], "drag": []}
        for element in body["elements"]:
            kind = element["kind"]
            {
                "water": self._water,
                "spheroid": self._spheroid,
                "plate": self._plate,
                "hydrostatics": lambda e: points["lift"].extend(self._hydrostatics(e)),
                "drag": lambda e: points["drag"].extend(self._drag(e)),
            }[kind](element)
        self.lifts = _Points.of(points["lift"], len(self.links))
        self.drags = _Points.of(points["drag"], len(self.links))
        surface = body.get("surface_z_m")
        self.surface = np.inf if surface is None else float(surface)

    def number(self, quantity: Any) -> float:
        """A quantity's value: a number, or a product of numbers and coefficients."""
        product = 1.0
        for factor in str(quantity).split("*"):
            word = factor.strip()
            product *= self.values[word] if word in self.values else float(word)
        return product

    def vector(self, quantities: Sequence[Any] | None, default: float = 0.0) -> np.ndarray:
        """Three quantities."""
        return np.array([self.number(q) for q in (quantities or (default, default, default))])

    def _in_order(self) -> list[Mapping[str, Any]]:
        """Links, each after the one that holds it."""
        parent = {j["child"]: j["parent"] for j in self.body["joints"]}
        done: list[Mapping[str, Any]] = []
        waiting = list(self.body["links"])
        while waiting:
            ready = [w for w in waiting if parent.get(w["name"]) in {None, *(d["name"] for d in done)}]
            if not ready or sum(w["name"] not in parent for w in [*done, *waiting]) != 1:
                raise ValueError("the links form no tree with one base")
            done += ready
            waiting = [w for w in waiting if w not in ready]
        return done

    def _tree(self) -> None:
        count = len(self.links)
        self.parent, self.hinge = np.full(count, -1), np.full(count, -1)
        self.place, self.axis = np.zeros((count, 3)), np.zeros((count, 3))
        self.mount = np.tile(np.eye(3), (count, 1, 1))
        for joint in self.body["joints"]:
            if joint.get("passive") is not None:
                raise ValueError(f"the hinge {joint['name']} yields: only prescribed ones here")
            k = self._index[joint["child"]]
            self.parent[k] = self._index[joint["parent"]]
            self.place[k] = self.vector(joint.get("at_m"))
            self.axis[k] = np.array(joint["axis"], dtype=float) / np.linalg.norm(joint["axis"])
            turn = Rotation.from_euler("xyz", joint.get("mount_deg", (0.0, 0.0, 0.0)), degrees=True)
            self.mount[k] = turn.as_matrix()
            if joint.get("driven") is not None:
                self.hinge[k] = self.hinges.index(joint["name"])
        about = np.array([_cross(a) for a in self.axis])
        turns = np.array([self.mount, self.mount @ about, self.mount @ about @ about])
        #: Rodrigues: a link's frame on its parent, straight, and what the angle's sine and versine add.
        self.turning = np.zeros((3, count, 4, 4))
        self.turning[:, :, :3, :3] = turns
        self.turning[0, :, :3, 3], self.turning[0, :, 3, 3] = self.place, 1.0
        #: Which links (columns) lie between a link (rows) and the base, itself among them.
        self.beyond = np.eye(count)
        for k in range(1, count):
            self.beyond[k] += self.beyond[self.parent[k]]

    def _tensor(self, link: Mapping[str, Any]) -> np.ndarray:
        xx, yy, zz, xy, xz, yz = ([self.number(q) for q in link.get("inertia_kg_m2", (0, 0, 0))] + [0.0] * 3)[
            :6
        ]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def _add(self, link: int, mass: np.ndarray, turning: np.ndarray, at: np.ndarray) -> None:
        """Apparent mass at a point of a link and inertia about it, both tensors in the link's axes."""
        at_point = np.hstack([np.eye(3), -_cross(at)])
        self.inertia[link] += at_point.T @ mass @ at_point
        self.inertia[link, 3:, 3:] += turning

    def _water(self, e: Mapping[str, Any]) -> None:
        if e.get("weighs"):
            raise ValueError("water that weighs is not simulated here")
        mass = self.water.density * self.number(e["volume_m3"])
        radii = np.array(e.get("gyration_m", (0.0, 0.0, 0.0)))
        self._add(
            self._index[e["link"]], mass * np.eye(3), mass * np.diag(radii**2), self.vector(e.get("at_m"))
        )

    def _spheroid(self, e: Mapping[str, Any]) -> None:
        a, b = e["semi_major_m"], e["semi_minor_m"]
        along, across, turning = lamb(a, b)
        displaced = 4.0 / 3.0 * np.pi * self.water.density * a * b**2
        factors = self.vector(e.get("factors"), 1.0)
        mass = displaced * np.array([along, across, across]) * factors
        moved = turning * displaced * (a**2 + b**2) / 5.0 if e.get("turning", True) else 0.0
        turns = moved * np.diag([0.0, factors[2], factors[1]])
        self._add(self._index[e["link"]], np.diag(mass), turns, self.vector(e.get("at_m")))

    def _plate(self, e: Mapping[str, Any]) -> None:
        mass = (
            np.pi / 4.0 * self.water.density * self.number(e.get("k", 1.0)) * e["span_m"] * e["chord_m"] ** 2
        )
        normal = np.array(e.get("normal", (0.0, 0.0, 1.0)), dtype=float)
        normal /= np.linalg.norm(normal)
        self._add(
            self._index[e["link"]],
            mass * np.outer(normal, normal),
            np.zeros((3, 3)),
            self.vector(e.get("at_m")),
        )

    def _hydrostatics(self, e: Mapping[str, Any]) -> list[tuple[Any, ...]]:
        """Points with a force upwards: weight, and buoyancy with the height over which it goes."""
        k = self._index[e["link"]]
        com = self.vector(self.links[k].get("com_m"))
        weight = self.water.gravity * self.number(self.links[k].get("mass_kg", 0.0))
        buoyancy = self.water.gravity * self.water.density * self.number(e.get("volume_m3", 0.0))
        middle = self.vector(e["buoyancy_at_m"]) if e.get("buoyancy_at_m") else com
        return [(k, com, -weight, np.inf, False), (k, middle, buoyancy, _height(e), False)]

    def _drag(self, e: Mapping[str, Any]) -> list[tuple[Any, ...]]:
        """Points with rho/2 C A along each axis, whether y and z act together, and the height."""
        if any(e.get("linear_N_s_m", ())):
            raise ValueError("linear drag is not simulated here")
        k, start = self._index[e["link"]], self.vector(e.get("at_m"))
        area, coefficient = self.vector(e.get("area_m2")), self.vector(e.get("coefficient"), 1.0)
        whole = 0.5 * self.water.density * area * coefficient
        end = self.vector(e["to_m"]) if e.get("to_m") else start
        middle, half = (start + end) / 2.0, (end - start) / 2.0
        round_link = self.water.slices is not None and area[1] > 0 and area[2] > 0
        places, shares = np.zeros(1), np.ones(1)
        if self.water.slices is None:
            places, weights = np.polynomial.legendre.leggauss(e.get("strips", 1))
            shares = weights / 2.0
        elif round_link and e["link"] in self._spheroids:
            # Gauss-Chebyshev of the second kind: its weight is the outline of an ellipse
            n = self.water.slices
            angle = np.pi * np.arange(1, n + 1) / (n + 1)
            places, shares = np.cos(angle), 2.0 / (n + 1) * np.sin(angle) ** 2
            if not half.any():
                half = np.array([self._spheroids[e["link"]]["semi_major_m"], 0.0, 0.0])
        elif np.any(half):
            places, weights = np.polynomial.legendre.leggauss(self.water.flipper_slices)
            shares = weights / 2.0
        return [
            (k, middle + p * half, share * whole, _height(e), round_link)
            for p, share in zip(places, shares, strict=True)
        ]


def _height(element: Mapping[str, Any]) -> float:
    height = element.get("half_height_m")
    return np.inf if height is None else float(height)


# ---------------------------------------------------------------- mechanics


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion / math.sqrt(quaternion @ quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@dataclass(frozen=True)
class _Moment:
    """A robot at one moment; twists are (velocity of a material point, rate of turn).

    ``turn`` and ``origin`` place the links; ``local`` turns a twist at the world's origin, in its axes, into
    that at a link's origin, in the link's. ``twist`` is such of every link, ``base`` that of the base at the
    world's origin.
    """

    turn: np.ndarray
    origin: np.ndarray
    local: np.ndarray
    twist: np.ndarray
    base: np.ndarray


def _shape(
    robot: Robot, motion: Motion, time: float, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``turn``, ``origin`` and ``local`` of the links, and their twists against the base at the origin."""
    found = np.zeros((2, len(robot.hinges) + 1))  # a hinge of number -1 is rigid
    found[:, :-1] = motion.at(time)
    angle, rate = found[:, robot.hinge]
    straight, sine, versine = robot.turning
    steps = straight + np.sin(angle)[:, None, None] * sine + (1.0 - np.cos(angle))[:, None, None] * versine
    steps[0, :3, :3], steps[0, :3, 3] = _matrix(pose[3:]), pose[:3]
    frames = [steps[0]]
    for parent, step in zip(robot.parent[1:], steps[1:], strict=True):
        frames.append(frames[parent] @ step)
    placed = np.array(frames)
    turn, origin = placed[:, :3, :3], placed[:, :3, 3]
    x, y, z = origin.T
    lever = np.zeros_like(turn)  # minus the cross product with the origin
    lever[:, 0, 1], lever[:, 0, 2], lever[:, 1, 2] = z, -y, x
    lever[:, 1, 0], lever[:, 2, 0], lever[:, 2, 1] = -z, y, -x
    local = np.zeros((len(turn), 6, 6))
    local[:, :3, :3] = local[:, 3:, 3:] = turn.transpose(0, 2, 1)
    local[:, :3, 3:] = turn.transpose(0, 2, 1) @ lever
    spin = (turn @ robot.axis[:, :, None]) * rate[:, None, None]
    own = np.concatenate([-lever @ spin, spin], axis=1)[:, :, 0]
    return turn, origin, local, robot.beyond @ own


def _impulse(robot: Robot, local: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M and h, about the world's origin in its axes."""
    own = local.transpose(0, 2, 1) @ robot.inertia @ local
    return own.sum(axis=0), (own @ twist[:, :, None]).sum(axis=0)[:, 0]


def _moment(robot: Robot, motion: Motion, time: float, state: np.ndarray) -> _Moment:
    turn, origin, local, twist = _shape(robot, motion, time, state[6:])
    whole, carried = _impulse(robot, local, twist)
    base = np.linalg.solve(whole, state[:6] - carried)
    return _Moment(turn, origin, local, (local @ (twist + base)[:, :, None])[:, :, 0], base)


def _afloat(robot: Robot, now: _Moment, points: _Points) -> np.ndarray:
    """Share of a sphere about each point that is below the surface."""
    height = now.origin[points.link, 2] + (now.turn[points.link, 2] * points.at).sum(axis=1)
    with np.errstate(invalid="ignore"):  # no surface, and never out of the water
        depth = np.where(points.stays, 1.0, (robot.surface - height) / points.half_height)
    depth = np.minimum(np.maximum(depth, -1.0), 1.0)
    return 0.25 * (1.0 + depth) ** 2 * (2.0 - depth)


def point_velocities(robot: Robot, now: _Moment) -> np.ndarray:
    """Velocities of the points with drag, in the axes of their links, shape (points, 3)."""
    return (robot.drags.maps @ now.twist.ravel()).reshape(-1, 3)


def _wrench(robot: Robot, now: _Moment) -> np.ndarray:
    """Weight, buoyancy and drag, and their moment about the world's origin."""
    lifts, drags = robot.lifts, robot.drags
    lift = (lifts.strength * _afloat(robot, now, lifts))[:, None] * now.turn[lifts.link, 2]
    v = point_velocities(robot, now)
    square = v**2
    square[:, 1:] += drags.together[:, None] * square[:, :0:-1]
    speed = np.sqrt(square + robot.water.smoothing_m_s**2)
    drag = -_afloat(robot, now, drags)[:, None] * drags.strength * speed * v
    of_links = lift.ravel() @ lifts.maps + drag.ravel() @ drags.maps
    return (of_links.reshape(-1, 1, 6) @ now.local).sum(axis=0)[0]


def _derivative(time: float, state: np.ndarray, robot: Robot, motion: Motion) -> np.ndarray:
    """Rate of (impulse 6, place of the base 3, quaternion of the base w, x, y, z)."""
    now = _moment(robot, motion, time, state)
    velocity, (p, q, r), (w, x, y, z) = now.base[:3], now.base[3:], state[9:]
    rate = np.empty(13)
    rate[:6] = _wrench(robot, now)
    rate[6:9] = velocity + _cross(now.base[3:]) @ state[6:9]
    rate[9] = -0.5 * (p * x + q * y + r * z)
    rate[10] = 0.5 * (w * p + q * z - r * y)
    rate[11] = 0.5 * (w * q + r * x - p * z)
    rate[12] = 0.5 * (w * r + p * y - q * x)
    return rate


def start_state(
    robot: Robot,
    motion: Motion,
    *,
    place: Sequence[float] = (0.0, 0.0, 0.0),
    attitude: Rotation | None = None,
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
    time: float = 0.0,
) -> np.ndarray:
    """State of a base with the given pose, velocity and rate of turn (world axes), its hinges moving."""
    quaternion = np.roll((attitude or Rotation.identity()).as_quat(), 1)
    pose = np.concatenate([place, quaternion]).astype(float)
    _, _, local, twist = _shape(robot, motion, time, pose)
    whole, carried = _impulse(robot, local, twist)
    base = np.concatenate([velocity, np.zeros(3)])
    return np.concatenate([whole @ base + carried, pose])


def states(
    robot: Robot, motion: Motion, start: np.ndarray, time: np.ndarray, *, rtol: float = 1e-9
) -> np.ndarray:
    """States at the given times, shape (n, 13); the first is ``start``.

    Raises
    ------
    ArithmeticError
        When the integrator gives up.
    """
    inner = motion.breaks[(motion.breaks > time[0]) & (motion.breaks < time[-1])]
    ends = np.concatenate([[time[0]], inner, [time[-1]]])
    found, state = [start[None]], start
    for low, high in pairwise(ends):
        wanted = time[(time > low) & (time <= high)]
        run = solve_ivp(
            _derivative,
            (low, high),
            state,
            method="DOP853",
            t_eval=np.union1d(wanted, [high]),
            rtol=rtol,
            atol=1e-2 * rtol,
            args=(robot, motion),
        )
        if not run.success:
            raise ArithmeticError(run.message)
        found.append(run.y[:, : len(wanted)].T)
        state = run.y[:, -1].copy()
    return np.ascontiguousarray(np.concatenate(found))


def pose_columns(time: np.ndarray, state: np.ndarray) -> dict[str, np.ndarray]:
    """Time and pose of the base; pitch is nose up (a turn of -pitch about y), roll port side up."""
    w, x, y, z = (state[:, 9:] / np.linalg.norm(state[:, 9:], axis=1)[:, None]).T
    return {
        "t_s": time,
        "x_m": state[:, 6],
        "y_m": state[:, 7],
        "z_m": state[:, 8],
        "roll_rad": np.arctan2(2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)),
        "pitch_rad": np.arcsin(np.clip(2 * (x * z - w * y), -1.0, 1.0)),
        "yaw_rad": np.unwrap(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y**2 + z**2))),
    }


# ---------------------------------------------------------------- hinges


def stroke(body: Mapping[str, Any], name: str, duration_s: float, *, clock_s: float = 0.0) -> Motion:
    """A stroke of the robot file over and over; at time 0 it is ``clock_s`` after its first knot."""
    law = body["strokes"][name]
    knots, period = np.array(law["knots_s"], dtype=float), law["period_s"]
    angles = np.zeros((len(knots), len(driven_hinges(body))))
    for hinge, degrees in law["angles_deg"].items():
        angles[:, driven_hinges(body).index(hinge)] = np.radians(degrees)
    spline = CubicSpline(knots, angles, bc_type="periodic")
    first, last = np.floor(clock_s / period), np.floor((clock_s + duration_s) / period)
    cycles = np.arange(first, last + 1)
    breaks = np.concatenate([*(knots[:-1] + c * period for c in cycles), [(last + 1) * period]])
    return Motion(breaks - clock_s, np.tile(spline.c, (1, len(cycles), 1)))


def bend(body: Mapping[str, Any], degrees: Mapping[str, float], within_s: float) -> Motion:
    """Hinges brought from straight to an angle by a quintic without jerks at its ends, and held there."""
    pieces = np.zeros((6, 2, len(driven_hinges(body))))
    for hinge, angle in degrees.items():
        k = driven_hinges(body).index(hinge)
        pieces[:3, 0, k] = np.radians(angle) * np.array([6.0, -15.0, 10.0]) / within_s ** np.array([5, 4, 3])
        pieces[5, 1, k] = np.radians(angle)
    return Motion(np.array([0.0, within_s, 2.0 * within_s]), pieces)


# ---------------------------------------------------------------- trials


@dataclass(frozen=True)
class Scenario:
    """One trial: how the robot is let go, and what its hinges do; SI, angles in degrees.

    A ``stroke`` of the robot file, or else ``bent``: hinges brought to an angle within ``within_s``. The
    stroke is ``clock_s`` ahead of the log's clock.
    """

    id: str
    duration_s: float
    stroke: str = ""
    bent: dict[str, float] = field(default_factory=dict)
    within_s: float = 1.5
    clock_s: float = 0.0
    place_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch_deg: float = 0.0
    speed_m_s: float = 0.0
    role: str = "fit"
    coefficients: Coefficients = Coefficients()

    def motion(self, body: Mapping[str, Any]) -> Motion:
        """Its hinges."""
        if self.stroke:
            return stroke(body, self.stroke, self.duration_s, clock_s=self.clock_s)
        return bend(body, self.bent, self.within_s)

    def run(self) -> dict[str, np.ndarray]:
        """Columns without noise: time, pose and every driven hinge's angle."""
        body = read_robot()
        motion = self.motion(body)
        robot = Robot(body, self.coefficients.values())
        start = start_state(
            robot,
            motion,
            place=self.place_m,
            attitude=Rotation.from_rotvec([0.0, -np.radians(self.pitch_deg), 0.0]),
            velocity=(self.speed_m_s, 0.0, 0.0),
        )
        time = np.arange(round(self.duration_s * FRAMES_HZ) + 1) / FRAMES_HZ
        columns = pose_columns(time, states(robot, motion, start, time))
        angles = motion.angles(time).T
        return {**columns, **{f"joint{k}_rad": angle for k, angle in enumerate(angles, start=1)}}


#: Half widths within which repeats differ: pitch at release, speed there, the clock, buoyancy.
SCATTER = {"pitch_deg": 0.5, "speed_m_s": 0.005, "clock_s": 1.0 / FRAMES_HZ, "buoyancy": 0.001}
#: Head up and tail up: the flow pushes the nose up and the tail down.
NOSE_UP = {"neck_pitch": -60.0, "pelvis_pitch": 60.0}
CYCLES, PERIOD_S = 3, 2.9


def strokes(seed: int, *, repeats: int = 3) -> list[Scenario]:
    """Repeats of both strokes from rest, each let go a little otherwise."""
    rng = np.random.default_rng(seed)
    true = Coefficients()
    found = []
    for name in ("characteristic", "characteristic-pelvis"):
        for number in range(1, repeats + 1):
            off = {key: width * rng.uniform(-1.0, 1.0) for key, width in SCATTER.items()}
            own = replace(true, buoyancy=true.buoyancy + off.pop("buoyancy"))
            found.append(Scenario(f"{name}-{number}", CYCLES * PERIOD_S, name, coefficients=own, **off))
    return found


def pitch_manoeuvre() -> Scenario:
    """Head and pelvis brought to 60 deg at 0.31 m/s (sea lion, section II); deep, since it climbs."""
    return Scenario("pitch", 6.0, bent=NOSE_UP, place_m=(0.0, 0.0, -1.0), speed_m_s=0.31, role="validate")


def write(folder: Path, seed: int, *, repeats: int = 3) -> Path:
    """Write trials of both `strokes` and of the held-out `pitch_manoeuvre`, and return the trials file.

    The seed is that of the noise, and of how the repeats differ. A trial without a stroke has the measured
    angles of its hinges in the log.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng([seed, 1])
    noise = {"x_m": POSITION_M, "z_m": POSITION_M, "pitch_rad": ANGLE_RAD}
    entries = []
    for scenario in (*strokes(seed, repeats=repeats), pitch_manoeuvre()):
        columns = scenario.run()
        joints = [] if scenario.stroke else [name for name in columns if name.startswith("joint")]
        spread = {**noise, **dict.fromkeys(joints, ENCODER_RAD)}
        count = len(columns["t_s"])
        table = {n: columns[n] + sd * rng.standard_normal(count) for n, sd in spread.items()}
        np.savetxt(
            folder / f"{scenario.id}.csv",
            np.column_stack([columns["t_s"], *table.values()]),
            delimiter=",",
            header="# source: simulated (tests/generators/sealion.py)\n" + ",".join(["t_s", *table]),
            comments="",
            fmt=["%.6f", *["%.5f"] * len(spread)],
        )
        entry: dict[str, Any] = {"id": scenario.id, "log": f"{scenario.id}.csv", "role": scenario.role}
        if scenario.stroke:
            entry["drive"] = {"stroke": scenario.stroke, "cycles": CYCLES}
        entries.append(entry)
    path = folder / "trials.yaml"
    head = {"format": "swimid-trials/1", "experiment": "multibody", "robot": "sealion"}
    path.write_text(yaml.safe_dump({**head, "trials": entries}, sort_keys=False), encoding="utf-8")
    return path


def write_sample(folder: Path) -> None:
    """``sample_logs/sealion``: each stroke twice, and the held-out pitch manoeuvre."""
    write(folder, 11, repeats=2)
