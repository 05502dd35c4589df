"""Description of an exported robot by numerical values, and functions that the export formats share."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from swimid.exporters.causes import ExportedCause, limits_of, read_causes
from swimid.exporters.options import ExportOptions
from swimid.files.templates import environment
from swimid.fitting.model import Array, ExternalForce
from swimid.results.parameters import Estimate, ParameterFile
from swimid.robots.file import Robot
from swimid.robots.planar import MultilinkRobot, PlanarJoint
from swimid.robots.quantities import Polynomial
from swimid.swimmer.engine import PASSIVE
from swimid.swimmer.planar.engine import COLUMNS as ENGINE_COLUMNS
from swimid.swimmer.planar.model import MultilinkModel, PlanarTree
from swimid.swimmer.tree import SYMMETRIC, Actuated, MovingJoint

#: Names of the numerical values that describe a force element, for each kind of force element. Their order is
#: that of the columns in the input arrays of the equations of motion (``engine``).
COLUMNS = {name: ENGINE_COLUMNS[name] for name in ("drag", "foil", "force", "wake")}
#: Sentence on a limit of the XML formats, which state standard errors and correlations only in a comment.
NO_ERRORS = "standard errors and correlations stand in a comment only; --to json keeps them as numbers"


class Exported(NamedTuple):
    """Text of an exported file, and the forces and effects that its format cannot represent.

    Attributes
    ----------
    text : str
    limits : list of str
        Sentences on the forces and effects that the format cannot represent.
    filtered : list of Cause
        Effects that a Python file next to the exported file applies as filters of the commands.
    """

    text: str
    limits: list[str]
    filtered: list[ExportedCause]


@dataclass(frozen=True)
class ExportedLink:
    """Link of an exported robot, described by numerical values.

    The frame of the link has its origin at the front end of the link, x forward and y to port.

    Attributes
    ----------
    name : str
    parent : int
        Index of the parent link; -1 for the base.
    joint : PlanarJoint or None
        Joint that connects the link to its parent.
    at : (float, float), m
        Position of the joint in the frame of the parent.
    mount_rad : float
        Angle of the link relative to its parent at zero joint angle, rad.
    length_m : float
    rigid, added : ndarray, shape (3, 3)
        Inertia matrix of the body, and added-mass matrix of the water, over (u, v, r) at the origin of the
        link; kg, kg m, kg m2.
    """

    name: str
    parent: int
    joint: PlanarJoint | None
    at: tuple[float, float]
    mount_rad: float
    length_m: float
    rigid: Array
    added: Array

    @property
    def moves(self) -> bool:
        """Whether the link can rotate relative to its parent link, by a driven or a passive joint."""
        return self.joint is not None and bool(self.joint.driven or self.joint.passive)

    @cached_property
    def directional(self) -> Array:
        """Direction-dependent part of the added-mass matrix, without its mean over the two directions."""
        mass, (x, y), moment = central(self.added)
        rest = self.added - about(np.diag([mass, mass, moment]), -x, -y)
        return rest * (np.abs(rest).max() > 1e-9 * np.abs(self.added).max())


@dataclass(frozen=True)
class ExportedElement:
    """Force element of a link of an exported robot: drag point, foil, constant force or trailing edge.

    Attributes
    ----------
    kind : str
        Key of :data:`COLUMNS`.
    link : int
        Index of the link.
    numbers : dict of str to float
        Numerical values of the element, by name.
    """

    kind: str
    link: int
    numbers: dict[str, float]

    @property
    def at(self) -> tuple[float, float]:
        """Point of application of the force, in the frame of the link, m."""
        return self.numbers["x"], self.numbers["y"]


@dataclass(frozen=True)
class ExportSource:
    """Parameter file and robot of an export, and the robot's quantities at the estimated parameter values.

    Attributes
    ----------
    parameters : ParameterFile
    robot : Robot
    origin : mapping
        ``file`` (name of the parameter file), ``sha256``, ``version``, ``robot`` (path or name), and ``draw``
        if the values are a random sample.
    path : Path
        Path of the parameter file in messages.
    """

    #: Name of the part of the robot file that describes the links.
    part: ClassVar[str] = "multilink"

    parameters: ParameterFile
    robot: Robot
    origin: Mapping[str, str]
    path: Path

    @property
    def body(self) -> MultilinkRobot:
        """Entry ``multilink`` of the robot file: links, joints and force elements of the robot in a plane."""
        assert self.robot.multilink is not None
        return self.robot.multilink

    @property
    def vertical(self) -> bool:
        """Whether the robot swims in the vertical plane."""
        return self.body.plane == "vertical"

    @property
    def heading_rad(self) -> float | None:
        """Heading of the first link, rad, if its base is fixed to the world; None for a free base."""
        if self.body.base != "fixed":
            return None
        return math.radians(self.body.heading_deg)

    @cached_property
    def assembly(self) -> PlanarTree:
        """Validated description of the robot, which computes the input arrays of the equations of motion."""
        return PlanarTree(self.body, self.robot.fluid)

    @cached_property
    def values(self) -> Array:
        """Values of all coefficients of the robot.

        A value is the estimate in the parameter file or, without an estimate, the value in the robot file.
        """
        robot = {name: coefficient.value for name, coefficient in self.body.coefficients.items()}
        values = robot | {name: estimate.value for name, estimate in self.parameters.parameters.items()}
        return np.array([values[name] for name in self.assembly.names])

    @property
    def input_limits(self) -> list[str]:
        """Sentences on inputs and hydrodynamic derivatives of the robot, which no format can represent."""
        limits = [f"the loads of the input {name} are left out" for name in self.model.inputs]
        return [*limits, *self.derivative_limits]

    @property
    def derivative_limits(self) -> list[str]:
        """Sentence on forces from products of velocities, which no format can represent; else empty."""
        count = len(self.tables["term"])
        return [f"{count} hydrodynamic derivatives (kind: derivatives) are left out"] * (count > 0)

    @cached_property
    def model(self) -> MultilinkModel:
        """Simulation model of the robot. The start values of its parameters are :attr:`values`."""
        model, starts = self.new_model(), dict(zip(self.assembly.names, self.values, strict=True))
        model.parameters = tuple(replace(p, start=starts.get(p.name, p.start)) for p in model.parameters)
        return model

    def new_model(self) -> MultilinkModel:
        """Return a simulation model of the robot as the robot file describes it."""
        return MultilinkModel(self.robot)

    @cached_property
    def causes(self) -> list[ExportedCause]:
        """Effects whose parameters the parameter file contains, with the values of these parameters."""
        return read_causes(self.parameters, self.model, self.path)

    @cached_property
    def tables(self) -> dict[str, Any]:
        """Input arrays of the robot's equations of motion (``engine``), with the changes by the effects."""
        return _change_tables(self.assembly.tables(self.values), self.causes)

    @property
    def rigid(self) -> Array:
        """Input array ``inertia`` of the links without added mass, with the changes by the effects."""
        dry = type(self.assembly)(self.body.model_copy(update={"elements": []}), self.robot.fluid)
        causes = [cause for cause in self.causes if cause.rigid]
        return np.asarray(_change_tables(dry.tables(self.values), causes)["inertia"])

    @cached_property
    def forces(self) -> list[tuple[str, ExternalForce]]:
        """Forces that the effects exert on the links, each with the name of its effect."""
        # Compute the tables first, because some forces get their constants when their effect changes the
        # tables.
        assert self.tables
        return [(cause.name, force) for cause in self.causes for force in cause.hooks.force]

    @property
    def current(self) -> tuple[float, float] | None:
        """Velocity of the water in the plane of the robot, m/s; None if no effect moves the water."""
        flows = [flow for cause in self.causes for flow in cause.hooks.flow]
        if not flows:
            return None
        x, y = sum(flow(np.zeros(1))[1][0] for flow in flows)
        return float(x), float(y)

    @cached_property
    def links(self) -> list[ExportedLink]:
        """Links of the robot with their inertias. A parent link precedes its child links."""
        rigid, total = self.rigid[:, SYMMETRIC], self.tables["inertia"][:, SYMMETRIC]
        joints = {joint.child: joint for joint in self.body.joints}
        links = []
        for i, link in enumerate(self.assembly.links):
            x, y, cos, sin = (float(value) for value in self.tables["joint"][i])
            parent, mount_rad = int(self.tables["topology"][i, 0]), math.atan2(sin, cos)
            inertias = (rigid[i], total[i] - rigid[i])
            joint = joints.get(link.name)
            links.append(ExportedLink(link.name, parent, joint, (x, y), mount_rad, link.length_m, *inertias))
        return links

    @cached_property
    def laws(self) -> dict[str, dict[str, float]]:
        """Coefficients in the law of the moment of each passive joint. The key is the name of the joint.

        The coefficients are those of ``swimid.swimmer.engine.PASSIVE`` and ``wire_stiffness``. The latter is
        the stiffness of wire and spring at small angles, ``K_t d_p l_3 l_cr / (l_3 - l_cr)``, in N m/rad.
        """
        laws = {}
        for axis, row in zip(self.assembly.passive, self.tables["passive"], strict=True):
            law = dict(zip(PASSIVE, map(float, row), strict=True))
            law["wire_stiffness"] = 0.0
            if law["spring"]:
                levers = law["arm"] * law["crank"] / (law["arm"] - law["crank"])
                law["wire_stiffness"] = law["spring"] * law["pretension"] * levers
            laws[axis.joint.name] = law
        return laws

    @cached_property
    def elements(self) -> list[ExportedElement]:
        """Force elements of the robot: drag points, foils, constant forces and trailing edges."""
        return [
            ExportedElement(kind, int(owner), dict(zip(columns, map(float, row), strict=True)))
            for kind, columns in COLUMNS.items()
            for owner, row in zip(self.tables[f"{kind}_link"], self.tables[kind], strict=True)
        ]

    def links_with(self, kind: str) -> str:
        """Return the names of the links that have force elements of the given kind, separated by commas."""
        names = [self.links[element.link].name for element in self.elements if element.kind == kind]
        return ", ".join(dict.fromkeys(names))

    def inertias(self, *, fold: bool) -> list[Array]:
        """Return the 3 x 3 inertia matrix of each link for its velocity (u, v, r).

        The velocity is that at the origin of the link. With ``fold`` the added mass is included. An added
        mass that depends on the direction is replaced by its mean over the two directions.
        """
        return [link.rigid + fold * (link.added - link.directional) for link in self.links]

    def actuator(self, axis: MovingJoint) -> Actuated:
        """Return the actuator of a driven joint."""
        return self.assembly.actuators[self.assembly.actuator_of[self.assembly.driven.index(axis)]]

    @property
    def transmissions(self) -> list[str]:
        """Sentences on driven joints that share an actuator, which no XML format can represent."""
        values = dict(zip(self.assembly.names, self.values, strict=True))
        found = []
        for axis in self.assembly.driven:
            law = axis.joint.driven
            if law.actuator is None:
                continue
            rule = f"{Polynomial.of(law.ratio).at(values):.6g} times its angle"
            if law.table_deg is not None:
                rule = "its angle by the table of the robot file"
            found.append(
                f"{axis.name} follows the actuator {law.actuator} in swimid, but has its own servo in this "
                f"format: command the servo with {rule}"
            )
        return found

    def servos(self, inertias: list[Array], default_hz: float) -> list[dict[str, Any]]:
        """Compute the gains of a position servo for each driven joint.

        The gains are ``stiffness`` (N m/rad) and ``damping`` (N m s/rad). ``moment`` is the moment of inertia
        (kg m2) of the bodies that the joint carries.

        The servo moves all bodies that the joint carries. Its gains give these bodies the natural frequency
        and the damping ratio that the robot file states. Their defaults are ``default_hz`` and 1.
        """
        moments = _moments_behind_joints(self.links, inertias)
        values = dict(zip(self.assembly.names, self.values, strict=True))
        servos = []
        for axis in self.assembly.driven:
            frequency, ratio = default_hz, 1.0
            law = self.actuator(axis).law.servo
            if law is not None:
                frequency = Polynomial.of(law.natural_frequency_hz).at(values)
                ratio = Polynomial.of(law.damping_ratio).at(values)
            omega, moment = 2.0 * math.pi * frequency, moments[axis.link]
            gains = {"stiffness": moment * omega**2, "damping": 2.0 * ratio * omega * moment}
            servos.append({"joint": axis.joint.name, "moment": moment, **gains})
        return servos


def _change_tables(tables: Mapping[str, Any], causes: Sequence[ExportedCause]) -> dict[str, Any]:
    """Return a copy of the input arrays of the equations of motion with the changes by effects."""
    found = {name: np.copy(table) for name, table in tables.items()}
    for cause in causes:
        cause.hooks.change_values(found, "tables")
    return found


# ---------------------------------------------------------------- planar inertias


def about(inertia: Array, x: float, y: float) -> Array:
    """Transform a planar inertia matrix from the origin of a link to the reference point (x, y), m.

    >>> about(np.diag([2.0, 2.0, 1.0]), 0.5, 0.0)[2, 2]
    np.float64(1.5)
    """
    move = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
    return np.asarray(move.T @ inertia @ move)


def central(inertia: Array) -> tuple[float, tuple[float, float], float]:
    """Compute mass, centre of mass and central moment of inertia from a planar inertia matrix.

    Return the mass (kg), the position of its centre (m), and the moment of inertia about the centre (kg m2).
    If the mass depends on the direction, as an added mass does, its mean over the two directions is returned.
    """
    along, across = inertia[0, 0], inertia[1, 1]
    x = y = 0.0
    if across > 0:
        x = inertia[1, 2] / across
    if along > 0:
        y = -inertia[0, 2] / along
    moment = inertia[2, 2] - across * x * x - along * y * y
    return float(0.5 * (along + across)), (float(x), float(y)), float(moment)


def _moments_behind_joints(links: list[ExportedLink], inertias: list[Array]) -> list[float]:
    """Return for each link the moment of inertia, kg m2, of all links that its joint to the parent carries.

    The moment of inertia refers to the axis of the joint and to zero angles of all joints.
    """
    sums = [np.array(inertia) for inertia in inertias]
    for i in range(len(links) - 1, 0, -1):
        link = links[i]
        c, s = math.cos(link.mount_rad), math.sin(link.mount_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        x, y = link.at
        sums[link.parent] = sums[link.parent] + about(turn.T @ sums[i] @ turn, -x, -y)
    return [float(inertia[2, 2]) for inertia in sums]


# ---------------------------------------------------------------- limits of the formats


def _describe_added_mass(source: ExportSource, choice: str, native: str) -> list[str]:
    """Return sentences on the errors that the option ``--added-mass`` causes in an export.

    ``choice`` is the value of the option. ``native`` is the sentence for the value ``native``.
    """
    wet = [link for link in source.links if np.any(link.added)]
    unfolded = {"native": [native], "none": ["added mass and inertia are left out (--added-mass none)"]}
    if not wet or choice in unfolded:
        return unfolded[choice] if wet else []
    limits = ["added mass is part of the bodies' masses: where gravity acts, the weights are too large by it"]
    directional = [
        f"{link.name} {link.added[0, 0]:.4g} kg forward, {link.added[1, 1]:.4g} kg sideways"
        for link in wet
        if np.any(link.directional)
    ]
    if directional:
        limits.append(
            f"added mass that differs by direction ({', '.join(directional)}) has its mean without the "
            "callback swimid.exporters.mjcf.water of MuJoCo or --added-mass native of Gazebo"
        )
    return limits


def _joint_limits(source: ExportSource, servo_hz: float) -> list[str]:
    """Return sentences on joints that move differently in swimid and in an exported model.

    These are passive joints with dry friction, and driven joints for which the robot file states no servo.
    """
    limits = [
        f"{name}: swimid rounds the dry friction of {law['friction']:.4g} N m off below "
        f"{law['friction_below']:g} rad/s; the target holds the joint still there"
        for name, law in source.laws.items()
        if law["friction"]
    ]
    driven = source.assembly.driven
    assumed = [axis.name for axis in driven if source.actuator(axis).law.servo is None]
    if assumed:
        limits.append(
            f"driven joints follow their command exactly in swimid; here a position servo of {servo_hz:g} Hz "
            f"moves them: {', '.join(assumed)}"
        )
    return [*limits, *source.transmissions]


# ---------------------------------------------------------------- text of XML formats


def export_xml(
    template: str,
    source: ExportSource,
    options: ExportOptions,
    native: str,
    limits: list[str],
    filtered: list[ExportedCause],
    *,
    forces: bool,
    **more: Any,
) -> Exported:
    """Create the XML document of an exported robot from a template.

    A comment in the document states the source of the values and the limits of the format.

    Parameters
    ----------
    template : str
        File name in the folder ``templates``. Its variables are ``source`` and ``more``. Numbers and
        sequences of numbers in the template are written as XML text.
    native : str
        Sentence on the error of the simulator's own model of added mass.
    limits : list of str
        Limits of the format, except those of added mass, joints, causes and standard errors.
    filtered : list of Cause
        Effects that a Python file applies as filters of the commands.
    forces : bool
        Whether the format can represent the forces of effects.
    **more
        Further variables of the template.
    """
    added = _describe_added_mass(source, options.added_mass, native)
    causes = limits_of(source.causes, filtered, forces=forces)
    joints = _joint_limits(source, options.servo_hz)
    limits = [*added, *limits, *source.input_limits, *joints, *causes, NO_ERRORS]
    return xml_text(template, source, limits, filtered, **more)


def xml_text(
    template: str, source: ExportSource, limits: list[str], filtered: list[ExportedCause], **more: Any
) -> Exported:
    """Create an XML document from a template, with a comment on its source and the limits of the format.

    See :func:`export_xml` for the parameters.
    """
    templates = environment("swimid.exporters", autoescape=True, finalize=_to_xml_text)
    root = ET.fromstring(templates.get_template(template).render(source=source, **more))
    for element in root.iter():
        element.text = (element.text or "").strip() or None
    ET.indent(root)
    lines = [
        f"Written by swimid {source.origin['version']}.",
        f"Parameters: {source.origin['file']}, sha256 {source.origin['sha256']}.",
        f"Robot: {source.robot.name}.",
        *(f"  {name} = {_describe_estimate(one)}" for name, one in source.parameters.parameters.items()),
        "Not carried by this format:",
        *(f"  {limit}" for limit in limits),
    ]
    if "draw" in source.origin:
        lines.insert(2, f"Values: {source.origin['draw']}.")
    # Separate consecutive hyphens, which an XML comment must not contain.
    note = "\n".join(lines).replace("--", "- -")
    text = ET.tostring(root, encoding="unicode")
    return Exported(f'<?xml version="1.0"?>\n<!--\n{note}\n-->\n{text}\n', limits, filtered)


def _to_xml_text(value: Any) -> Any:
    """Convert a number, or a sequence of numbers, in a template to XML text with all digits.

    >>> _to_xml_text([0.1, -0.0])
    '0.1 0.0'
    """
    if isinstance(value, str):
        return value
    return " ".join(repr(float(one) + 0.0) for one in np.atleast_1d(value))


def _describe_estimate(estimate: Estimate) -> str:
    parts = [repr(estimate.value)]
    if estimate.stderr is not None:
        parts.append(f"+- {estimate.stderr!r}")
    if estimate.unit != "1":
        parts.append(estimate.unit)
    return " ".join([*parts, f"({estimate.status})"])
