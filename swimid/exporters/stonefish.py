"""Stonefish: a scenario file with the robot's links as boxes.

Stonefish sums the water's forces over the faces of a body's shape. Each link becomes a box that
displaces its own mass, and its two drag vectors are set so that the forces along and across the
link are the identified ones. Axes are Stonefish's: x forward, y to starboard, z down.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from swimid.exporters import common
from swimid.exporters.common import Exported, node
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Link, Source, central
from swimid.fitting.model import Array
from swimid.robots.planar import Drag, SlenderBody
from swimid.swimmer.polynomial import Polynomial

#: Height over length of a link whose elements give no area.
SLENDER = 0.3


def export(source: Source, options: ExportOptions) -> Exported:
    """Scenario of a multi-link robot; see :class:`swimid.exporters.Target`."""
    limits = _limits(source, options)
    density = source.robot.fluid.density_kg_m3
    fixed = source.body.base == "fixed"
    robot = node("robot", name=source.robot.name, fixed=str(fixed).lower(), self_collisions="false")
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    robot.extend(_link(source, i, inertia, options) for i, inertia in enumerate(inertias))
    robot.extend(_joint(source, link) for link in source.links[1:])
    for axis in source.assembly.driven:
        name = axis.joint.name
        # shares of the error removed per step by Stonefish's joint motor, as in its manual; no N m/rad
        controller = node("controller", position_gain=1.0, velocity_gain=0.5, max_torque=1000.0)
        robot.append(
            node("actuator", controller, node("joint", name=name), name=f"{name}_servo", type="servo")
        )
    heading = math.radians(source.body.heading_deg) if fixed else 0.0
    robot.append(node("world_transform", xyz=(0.0, 0.0, 1.0), rpy=_rpy(source, heading)))
    root = node(
        "scenario",
        node(
            "environment",
            node("ned", latitude=0.0, longitude=0.0),
            node("ocean", node("water", density=density, jerlov=0.2), node("waves", height=0.0)),
        ),
        node(
            "materials",
            node("material", name="body", density=density, restitution=0.5),
            node(
                "friction_table",
                node("friction", material1="body", material2="body", static=0.5, dynamic=0.3),
            ),
        ),
        node("looks", node("look", name="body", rgb=(0.9, 0.6, 0.1), roughness=0.5)),
        robot,
    )
    return Exported(common.document(root, source, limits), limits)


def _point(source: Source, x: float, y: float) -> tuple[float, float, float]:
    return (x, 0.0, -y) if source.vertical else (x, -y, 0.0)


def _rpy(source: Source, turn: float) -> tuple[float, float, float]:
    return (0.0, turn, 0.0) if source.vertical else (0.0, 0.0, -turn)


def _height(source: Source, link: Link) -> float:
    """Height of a link from the areas of its drag, m."""
    values = dict(zip(source.assembly.names, source.values, strict=True))
    for element in source.body.elements:
        if element.link != link.name:
            continue
        if isinstance(element, Drag):
            area = Polynomial.of(element.normal_area_m2).at(values)
            if area > 0:
                return area / link.length_m
        if isinstance(element, SlenderBody):
            at, high = [s.station_m for s in element.sections], [s.height_m for s in element.sections]
            return float(np.trapezoid(high, at)) / (at[-1] - at[0])
    return SLENDER * link.length_m


def _link(source: Source, i: int, inertia: Array, options: ExportOptions) -> ET.Element:
    link, density = source.links[i], source.robot.fluid.density_kg_m3
    mass, centre, moment = central(inertia)
    length, height = link.length_m, _height(source, link)
    width = mass / (density * length * height)
    drag = [e.numbers for e in source.elements if e.kind == "drag" and e.link == i]
    along, across = 0.5 * density * (height * width), 0.5 * density * (length * height)
    quadratic = sum(n["quadratic_x"] for n in drag) / along, sum(n["quadratic_y"] for n in drag) / across
    wet_along, wet_across = 2.0 * length * (height + width), 2.0 * width * (length + height)
    viscous = (
        sum(n["linear_x"] for n in drag) / (density * wet_along),
        sum(n["linear_y"] for n in drag) / (density * wet_across),
    )

    def three(x: float, y: float) -> tuple[float, float, float]:
        return (x, 0.0, y) if source.vertical else (x, y, 0.0)

    place = {"xyz": _point(source, *centre), "rpy": (0.0, 0.0, 0.0)}
    return node(
        "link" if link.parent >= 0 else "base_link",
        # horizontal plane: the height is along z, across the link is y
        node("dimensions", xyz=(length, height, width) if source.vertical else (length, width, height)),
        node("origin", **place),
        node("material", name="body"),
        node("look", name="body"),
        node("mass", value=mass),
        node("inertia", xyz=(moment, moment, moment)),
        node("cg", **place),
        node("hydrodynamics", viscous_drag=three(*viscous), quadratic_drag=three(*quadratic)),
        name=link.name,
        type="box",
        # without added mass of its own where that is in the body or not wanted
        physics="submerged" if options.added_mass == "native" else "floating",
        buoyant="true",
    )


def _joint(source: Source, link: Link) -> ET.Element:
    assert link.joint is not None
    joint = node(
        "joint",
        node("parent", name=source.links[link.parent].name),
        node("child", name=link.name),
        node("origin", xyz=_point(source, *link.at), rpy=_rpy(source, link.mount_rad)),
        name=link.joint.name,
        type="revolute" if link.moves else "fixed",
    )
    if link.moves:
        joint.append(node("axis", xyz=(0.0, 1.0, 0.0) if source.vertical else (0.0, 0.0, -1.0)))
        law = source.laws.get(link.joint.name)
        if law is not None and (law.damping or law.friction):
            joint.append(node("damping", constant=law.friction, viscous=law.damping))
    return joint


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = common.added_mass_limits(source, options.added_mass)
    if options.added_mass == "native" and any(np.any(link.added) for link in source.links):
        limits.append(
            "the identified added mass is left out: Stonefish computes its own from the boxes and applies "
            "the mean of the directions; --added-mass fold puts the identified one into the bodies"
        )
    limits.append(
        "each link is a box at its centre of mass that displaces the link's mass; its length and height are "
        "the robot file's, its thickness is not"
    )
    drag = [e for e in source.elements if e.kind == "drag"]
    if any(e.numbers["quadratic_x"] or e.numbers["quadratic_y"] for e in drag):
        limits.append(
            "Morison drag: Stonefish sums over the faces of the box, at the box; its form drag has grown "
            "with the cube of the speed since 2024, and the coefficients give the identified force at 1 m/s"
        )
    if any(e.numbers["quadratic_r"] or e.numbers["linear_r"] for e in drag):
        limits.append("moments against rotation are left out")
    limits += common.element_limits(source)
    for name, law in source.laws.items():
        stiffness = law.stiffness + law.wire_stiffness
        if stiffness or law.cubic:
            limits.append(
                f"{name}: Stonefish has no joint spring; {stiffness:.6g} N m/rad at small angles, rest at "
                f"{math.degrees(law.rest):g} deg, must come from a controller"
            )
        if law.quadratic_damping:
            limits.append(f"{name}: the quadratic damping is left out")
    limits += common.friction_limits(source)
    if source.assembly.driven:
        joints = ", ".join(a.joint.name for a in source.assembly.driven)
        limits.append(f"driven joints are moved by Stonefish's servo with the gains of its manual: {joints}")
    return [*limits, *common.reading_limits(source), common.NO_ERRORS]
