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
from swimid.exporters.base import Exported
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
    root = ET.Element("scenario")
    environment = ET.SubElement(root, "environment")
    ET.SubElement(environment, "ned", latitude="0.0", longitude="0.0")
    ocean = ET.SubElement(environment, "ocean")
    density = source.robot.fluid.density_kg_m3
    ET.SubElement(ocean, "water", density=common.number(density), jerlov="0.2")
    ET.SubElement(ocean, "waves", height="0.0")
    materials = ET.SubElement(root, "materials")
    ET.SubElement(materials, "material", name="body", density=common.number(density), restitution="0.5")
    table = ET.SubElement(materials, "friction_table")
    ET.SubElement(table, "friction", material1="body", material2="body", static="0.5", dynamic="0.3")
    looks = ET.SubElement(root, "looks")
    ET.SubElement(looks, "look", name="body", rgb="0.9 0.6 0.1", roughness="0.5")
    fixed = "true" if source.body.base == "fixed" else "false"
    robot = ET.SubElement(root, "robot", name=source.robot.name, fixed=fixed, self_collisions="false")
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    for i, link in enumerate(source.links):
        _link(source, robot, i, link, inertias[i], options)
    for link in source.links[1:]:
        _joint(source, robot, link)
    for axis in source.assembly.driven:
        actuator = ET.SubElement(robot, "actuator", name=f"{axis.joint.name}_servo", type="servo")
        # shares of the error removed per step by Stonefish's joint motor, as in its manual; no N m/rad
        ET.SubElement(actuator, "controller", position_gain="1.0", velocity_gain="0.5", max_torque="1000.0")
        ET.SubElement(actuator, "joint", name=axis.joint.name)
    heading = math.radians(source.body.heading_deg) if fixed == "true" else 0.0
    ET.SubElement(robot, "world_transform", xyz="0.0 0.0 1.0", rpy=_rpy(source, heading))
    return Exported(common.document(root, source, limits), tuple(limits))


def _point(source: Source, x: float, y: float) -> str:
    return common.number(x, 0.0, -y) if source.vertical else common.number(x, -y, 0.0)


def _rpy(source: Source, turn: float) -> str:
    return common.number(0.0, turn, 0.0) if source.vertical else common.number(0.0, 0.0, -turn)


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


def _link(
    source: Source, robot: ET.Element, i: int, link: Link, inertia: Array, options: ExportOptions
) -> None:
    mass, centre, moment = central(inertia)
    density = source.robot.fluid.density_kg_m3
    length, height = link.length_m, _height(source, link)
    width = mass / (density * length * height)
    # without added mass of its own where that is in the body or not wanted
    physics = "submerged" if options.added_mass == "native" else "floating"
    tag = "link" if link.parent >= 0 else "base_link"
    node = ET.SubElement(robot, tag, name=link.name, type="box", physics=physics, buoyant="true")
    sides = (length, height, width) if not source.vertical else (length, width, height)
    # horizontal plane: the height is along z, across the link is y
    dims = (sides[0], sides[2], sides[1])
    ET.SubElement(node, "dimensions", xyz=common.number(*dims))
    ET.SubElement(node, "origin", xyz=_point(source, *centre), rpy="0.0 0.0 0.0")
    ET.SubElement(node, "material", name="body")
    ET.SubElement(node, "look", name="body")
    ET.SubElement(node, "mass", value=common.number(mass))
    ET.SubElement(node, "inertia", xyz=common.number(moment, moment, moment))
    ET.SubElement(node, "cg", xyz=_point(source, *centre), rpy="0.0 0.0 0.0")
    drag = [e.numbers for e in source.elements if e.kind == "drag" and e.link == i]
    total = {k: sum(n[k] for n in drag) for k in ("quadratic_x", "quadratic_y", "linear_x", "linear_y")}
    face_x, face_y = height * width, length * height
    quadratic = (
        total["quadratic_x"] / (0.5 * density * face_x),
        total["quadratic_y"] / (0.5 * density * face_y),
    )
    wet_x, wet_y = 2.0 * length * (height + width), 2.0 * width * (length + height)
    viscous = (total["linear_x"] / (density * wet_x), total["linear_y"] / (density * wet_y))

    def three(pair: tuple[float, float]) -> str:
        return common.number(pair[0], 0.0, pair[1]) if source.vertical else common.number(*pair, 0.0)

    ET.SubElement(node, "hydrodynamics", viscous_drag=three(viscous), quadratic_drag=three(quadratic))


def _joint(source: Source, robot: ET.Element, link: Link) -> None:
    assert link.joint is not None
    moving = link.joint.driven is not None or link.joint.passive is not None
    joint = ET.SubElement(robot, "joint", name=link.joint.name, type="revolute" if moving else "fixed")
    ET.SubElement(joint, "parent", name=source.links[link.parent].name)
    ET.SubElement(joint, "child", name=link.name)
    ET.SubElement(joint, "origin", xyz=_point(source, *link.at), rpy=_rpy(source, link.mount_rad))
    if moving:
        ET.SubElement(joint, "axis", xyz="0.0 1.0 0.0" if source.vertical else "0.0 0.0 -1.0")
        law = source.laws.get(link.joint.name)
        if law is not None and (law.damping or law.friction):
            constant, viscous = common.number(law.friction), common.number(law.damping)
            ET.SubElement(joint, "damping", constant=constant, viscous=viscous)


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
