"""What is exported: a parameter file and its robot, with every quantity evaluated."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.results.parameters import Estimate, ParameterFile
from swimid.robots.file import Robot
from swimid.robots.planar import Joint, Multilink
from swimid.swimmer.planar import engine
from swimid.swimmer.planar.assembly import Assembly
from swimid.swimmer.tree import Polynomial

#: Origin of a file that is exported.
Origin = Mapping[str, str]


@dataclass(frozen=True)
class Link:
    """A link with its numbers; the frame sits at its front end, x forward, y to port.

    Attributes
    ----------
    name : str
    parent : int
        Its parent's number, -1 for the base.
    joint : Joint or None
        The joint that holds it.
    at : (float, float), m
        Where the joint sits in the parent's frame.
    mount_rad : float
        Angle against the parent when the joint's own angle is zero.
    length_m : float
    rigid, added : ndarray, shape (3, 3)
        Inertia of the body and of the water over (u, v, r) at the link's origin; kg, kg m, kg m2.
    """

    name: str
    parent: int
    joint: Joint | None
    at: tuple[float, float]
    mount_rad: float
    length_m: float
    rigid: Array
    added: Array

    @property
    def moves(self) -> bool:
        """Whether it turns against its parent."""
        return self.joint is not None and bool(self.joint.driven or self.joint.passive)


@dataclass(frozen=True)
class Law:
    """A passive joint's law; columns of :data:`swimid.swimmer.planar.engine.PASSIVE`."""

    stiffness: float
    cubic: float
    damping: float
    quadratic_damping: float
    rest: float
    spring: float
    pretension: float
    arm: float
    crank: float
    friction: float
    friction_below: float

    @property
    def wire_stiffness(self) -> float:
        """Stiffness of wire and spring for small angles, ``K_t d_p l_3 l_cr / (l_3 - l_cr)``, N m/rad."""
        if self.spring == 0.0:
            return 0.0
        return self.spring * self.pretension * self.arm * self.crank / (self.arm - self.crank)


@dataclass(frozen=True)
class Element:
    """One row of an element table.

    Attributes
    ----------
    kind : {"drag", "foil", "force", "wake"}
    link : int
    numbers : dict of str to float
        Columns of ``engine.DRAG``, ``engine.FOIL``, ``engine.FORCE`` or ``engine.WAKE``.
    """

    kind: Literal["drag", "foil", "force", "wake"]
    link: int
    numbers: dict[str, float]

    @property
    def at(self) -> tuple[float, float]:
        """Where it acts in the link's frame, m."""
        return self.numbers["x"], self.numbers["y"]


@dataclass(frozen=True)
class Servo:
    """A position servo: its joint, N m/rad and N m s/rad."""

    joint: str
    stiffness: float
    damping: float


@dataclass(frozen=True)
class Source:
    """A parameter file, its robot and where they come from.

    Attributes
    ----------
    parameters : ParameterFile
    robot : Robot
    origin : mapping
        ``file`` (name of the parameter file), ``sha256``, ``version``, ``robot`` (path or name).
    readings : mapping
        Readings of the robot file's ambiguities that the parameters were found with.
    """

    parameters: ParameterFile
    robot: Robot
    origin: Origin
    readings: Mapping[str, str]

    @property
    def multilink(self) -> bool:
        """Whether this is a multi-link robot, not the drag of one rigid body."""
        return self.parameters.model == "multilink"

    @property
    def body(self) -> Multilink:
        """The robot's multi-link part."""
        assert self.robot.multilink is not None
        return self.robot.multilink

    @property
    def vertical(self) -> bool:
        """Whether it swims in the vertical plane."""
        return self.multilink and self.body.plane == "vertical"

    @property
    def heading_rad(self) -> float | None:
        """Heading of a fixed base; None where it is free."""
        return math.radians(self.body.heading_deg) if self.body.base == "fixed" else None

    @cached_property
    def assembly(self) -> Assembly:
        """The robot's checked tables."""
        return Assembly(self.body, self.robot.fluid)

    @cached_property
    def values(self) -> Array:
        """The coefficients, from the parameter file; those it does not hold from the robot file."""
        held = self.parameters.parameters
        return np.array(
            [held[n].value if n in held else self.body.coefficients[n].value for n in self.assembly.names]
        )

    @cached_property
    def tables(self) -> dict[str, Any]:
        """The engine's tables at these values."""
        return self.assembly.tables(self.values)

    @cached_property
    def links(self) -> list[Link]:
        """The links, parents before children."""
        bare = Assembly(self.body.model_copy(update={"elements": []}), self.robot.fluid)
        rigid = np.asarray(bare.tables(self.values)["inertia"])
        tables = self.tables
        joint_of = {j.child: j for j in self.body.joints}
        links = []
        for i, link in enumerate(self.assembly.links):
            x, y, cos, sin = tables["joint"][i]
            body = full(rigid[i])
            links.append(
                Link(
                    link.name, int(tables["topology"][i, 0]), joint_of.get(link.name), (float(x), float(y)),
                    math.atan2(sin, cos), link.length_m, body, full(tables["inertia"][i]) - body,
                )
            )  # fmt: skip
        return links

    @cached_property
    def laws(self) -> dict[str, Law]:
        """The laws of the passive joints, by joint."""
        rows = self.tables["passive"]
        return {
            axis.joint.name: Law(*(float(v) for v in row))
            for axis, row in zip(self.assembly.passive, rows, strict=True)
        }

    @cached_property
    def elements(self) -> list[Element]:
        """Drag points, foils, forces and trailing edges."""
        elements = []
        tables = {
            "drag": engine.DRAG, "foil": engine.FOIL, "force": engine.FORCE, "wake": engine.WAKE,
        }  # fmt: skip
        for kind, columns in tables.items():
            for owner, row in zip(self.tables[f"{kind}_link"], self.tables[kind], strict=True):
                numbers = {c: float(v) for c, v in zip(columns, row, strict=True)}
                elements.append(Element(kind, int(owner), numbers))  # type: ignore[arg-type]
        return elements

    def servos(self, inertias: list[Array], default_hz: float) -> list[Servo]:
        """Position servos of the driven joints, whose gains move the bodies behind them as their laws say."""
        moments = behind_joint(self.links, inertias)
        values = dict(zip(self.assembly.names, self.values, strict=True))
        servos = []
        for axis in self.assembly.driven:
            law = axis.joint.driven.servo if axis.joint.driven else None
            frequency, ratio = default_hz, 1.0
            if law is not None:
                frequency = Polynomial.of(law.natural_frequency_hz).at(values)
                ratio = Polynomial.of(law.damping_ratio).at(values)
            omega, moment = 2.0 * math.pi * frequency, moments[axis.link]
            servos.append(Servo(axis.joint.name, moment * omega**2, 2.0 * ratio * omega * moment))
        return servos


def surge(source: Source) -> dict[str, float]:
    """Surge drag and added mass of one rigid body, from a rig identification.

    Returns
    -------
    dict
        ``quadratic`` (N s2/m2), ``linear`` (N s/m), ``added_mass`` (kg); force
        ``-(quadratic |u| + linear) u``, ``quadratic = rho C_d A / 2`` (boxfish paper, Eq 7).

    Raises
    ------
    InputError
        Without a drag coefficient and frontal area, or a quadratic drag.
    """
    held = source.parameters.parameters
    if "quadratic_drag" in held:
        quadratic = held["quadratic_drag"].value
    elif "drag_coefficient" not in held:
        raise InputError(
            "holds no surge drag", file=source.origin["file"], column="parameters.drag_coefficient"
        )
    else:
        area = source.robot.body.frontal_area_m2
        if area is None:
            raise InputError(
                "the drag coefficient needs a frontal area",
                file=source.origin["robot"],
                column="body.frontal_area_m2",
            )
        quadratic = 0.5 * source.robot.fluid.density_kg_m3 * area * held["drag_coefficient"].value
    return {
        "quadratic": quadratic,
        "linear": held["linear_drag"].value if "linear_drag" in held else 0.0,
        "added_mass": held["added_mass"].value if "added_mass" in held else 0.0,
    }


def full(row: Array) -> Array:
    """The symmetric matrix of a row of :data:`engine.INERTIA`."""
    a, b, c, d, e, f = (float(v) for v in row)
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def about(inertia: Array, x: float, y: float) -> Array:
    """An inertia over (u, v, r) at the origin, seen from the point (x, y).

    >>> about(np.diag([2.0, 2.0, 1.0]), 0.5, 0.0)[2, 2]
    np.float64(1.5)
    """
    move = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
    return np.asarray(move.T @ inertia @ move)


def central(inertia: Array) -> tuple[float, tuple[float, float], float]:
    """Mass, centre (m) and central moment (kg m2) of a planar inertia.

    A mass that differs by direction counts with its mean.
    """
    along, across = inertia[0, 0], inertia[1, 1]
    x = inertia[1, 2] / across if across > 0 else 0.0
    y = -inertia[0, 2] / along if along > 0 else 0.0
    moment = inertia[2, 2] - across * x * x - along * y * y
    return float(0.5 * (along + across)), (float(x), float(y)), float(moment)


def isotropic(inertia: Array) -> bool:
    """Whether a planar inertia is that of a rigid body, up to rounding."""
    size = max(abs(inertia[0, 0]), abs(inertia[1, 1]))
    return bool(abs(inertia[0, 0] - inertia[1, 1]) <= 1e-9 * size and abs(inertia[0, 1]) <= 1e-9 * size)


def behind_joint(links: list[Link], inertias: list[Array]) -> list[float]:
    """Moment of inertia of everything behind each link's joint, about it, joints straight; kg m2."""
    sums = [np.array(g) for g in inertias]
    for i in range(len(links) - 1, 0, -1):
        link = links[i]
        c, s = math.cos(link.mount_rad), math.sin(link.mount_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        x, y = link.at
        sums[link.parent] = sums[link.parent] + about(turn.T @ sums[i] @ turn, -x, -y)
    return [float(g[2, 2]) for g in sums]


NO_ERRORS = "standard errors and correlations stand in a comment only; --to json keeps them as numbers"


@dataclass(frozen=True)
class Exported:
    """A finished export.

    Attributes
    ----------
    text : str
        The file.
    limits : sequence of str
        What the target cannot carry, one sentence each.
    """

    text: str
    limits: Sequence[str] = ()


def number(*values: float) -> str:
    """Numbers as XML wants them, to the last bit.

    >>> number(0.1, -0.0)
    '0.1 0.0'
    """
    return " ".join(repr(float(v) + 0.0) for v in values)


def document(template: str, source: Source, limits: Iterable[str], **more: Any) -> str:
    """The XML text of a template, with the source of the numbers and the limits in a comment.

    Parameters
    ----------
    template : str
        Its file in ``templates``. It is given ``source``, and numbers and tuples stand in it as they are.
    limits : iterable of str
    **more
        What else it is given.
    """
    environment = Environment(
        loader=PackageLoader("swimid.exporters"), autoescape=True, undefined=StrictUndefined, finalize=_shown
    )
    root = ET.fromstring(environment.get_template(template).render(source=source, **more))
    for element in root.iter():
        element.text = element.text if element.text and element.text.strip() else None
    ET.indent(root)
    held = [f"  {name} = {_told(e)}" for name, e in source.parameters.parameters.items()]
    lines = [
        f"Written by swimid {source.origin['version']}.",
        f"Parameters: {source.origin['file']}, sha256 {source.origin['sha256']}.",
        f"Robot: {source.robot.name}.",
        *held,
        "Not carried by this format:",
        *(f"  {limit}" for limit in limits),
    ]
    # a comment must not hold two hyphens in a row
    note = "\n".join(lines).replace("--", "- -")
    return f'<?xml version="1.0"?>\n<!--\n{note}\n-->\n{ET.tostring(root, encoding="unicode")}\n'


def _shown(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return number(*value) if isinstance(value, list | tuple) else number(value)


def _told(estimate: Estimate) -> str:
    error = "" if estimate.stderr is None else f" +- {estimate.stderr!r}"
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    return f"{estimate.value!r}{error}{unit} ({estimate.status})"


def bodies(source: Source, *, fold: bool) -> list[Array]:
    """Inertia each link's body gets, over (u, v, r) at its origin; with ``fold`` the water's is in it.

    An anisotropic added mass is folded with its mean.
    """
    inertias = []
    for link in source.links:
        inertia = link.rigid
        if fold and np.any(link.added):
            mass, (x, y), moment = central(link.added)
            inertia = inertia + about(np.diag([mass, mass, moment]), -x, -y)
        inertias.append(inertia)
    return inertias


def added_mass_limits(source: Source, choice: str) -> list[str]:
    """Limits of folding or leaving out the added mass, for a target without one of its own."""
    wet = [link for link in source.links if np.any(link.added)]
    if not wet:
        return []
    if choice == "none":
        return ["added mass and inertia are left out, as asked"]
    if choice != "fold":
        return []
    limits = [
        "added mass is part of the bodies' masses: their weight, where gravity acts, is that much too large"
    ]
    uneven = [
        f"{link.name} {link.added[0, 0]:.4g} kg forward, {link.added[1, 1]:.4g} kg sideways"
        for link in wet
        if not isotropic(link.added)
    ]
    if uneven:
        limits.append(f"added mass that differs by direction is folded with its mean: {', '.join(uneven)}")
    return limits


def joint_limits(source: Source, servo_hz: float) -> list[str]:
    """Limits of dry friction, which swimid rounds off, and of driven joints, whose motion it prescribes."""
    limits = [
        f"{name}: swimid rounds the dry friction of {law.friction:.4g} N m off below "
        f"{law.friction_below:g} rad/s; the target holds the joint still there"
        for name, law in source.laws.items()
        if law.friction
    ]
    driven = [axis.joint for axis in source.assembly.driven]
    assumed = [joint.name for joint in driven if joint.driven and joint.driven.servo is None]
    if assumed:
        limits.append(
            f"driven joints follow their command exactly in swimid; here a position servo of {servo_hz:g} Hz "
            f"moves them: {', '.join(assumed)}"
        )
    return limits
