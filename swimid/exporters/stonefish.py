"""Stonefish: a scenario file with the robot's links as boxes.

Stonefish sums the water's forces over the faces of a body's shape. Each link becomes a box that
displaces its own mass, and its two drag vectors are set so that the forces along and across the
link are the identified ones. Axes are Stonefish's: x forward, y to starboard, z down.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from swimid.exporters import common
from swimid.exporters.common import Exported
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Link, Source, central
from swimid.fitting.model import Array
from swimid.robots.planar import Drag, SlenderBody
from swimid.swimmer.polynomial import Polynomial

#: Height over length of a link whose elements give no area.
SLENDER = 0.3


def export(source: Source, options: ExportOptions) -> Exported:
    """Scenario of a multi-link robot; see :class:`swimid.exporters.export.Target`."""
    limits = _limits(source, options)
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    text = common.document(
        "stonefish.scn",
        source,
        limits,
        native=options.added_mass == "native",
        boxes=[_box(source, i, inertia) for i, inertia in enumerate(inertias)],
        point=partial(_point, source),
        turned=lambda angle: (0.0, angle, 0.0) if source.vertical else (0.0, 0.0, -angle),
    )
    return Exported(text, limits)


def _point(source: Source, x: float, y: float) -> tuple[float, float, float]:
    return (x, 0.0, -y) if source.vertical else (x, -y, 0.0)


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


def _box(source: Source, i: int, inertia: Array) -> dict[str, Any]:
    """A link as a box that displaces its mass and drags as it does."""
    link, density = source.links[i], source.robot.fluid.density_kg_m3
    mass, centre, moment = central(inertia)
    length, height = link.length_m, _height(source, link)
    width = mass / (density * length * height)
    drag = [e.numbers for e in source.elements if e.kind == "drag" and e.link == i]
    along, across = 0.5 * density * (height * width), 0.5 * density * (length * height)
    wet_along, wet_across = 2.0 * length * (height + width), 2.0 * width * (length + height)
    quadratic = sum(n["quadratic_x"] for n in drag) / along, sum(n["quadratic_y"] for n in drag) / across
    viscous = (
        sum(n["linear_x"] for n in drag) / (density * wet_along),
        sum(n["linear_y"] for n in drag) / (density * wet_across),
    )

    def three(x: float, y: float) -> tuple[float, float, float]:
        return (x, 0.0, y) if source.vertical else (x, y, 0.0)

    return {
        "link": link,
        # horizontal plane: the height is along z, across the link is y
        "dimensions": (length, height, width) if source.vertical else (length, width, height),
        "centre": _point(source, *centre),
        "mass": mass,
        "moment": moment,
        "viscous": three(*viscous),
        "quadratic": three(*quadratic),
    }


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
