"""Export to Gazebo: an SDF model with Hydrodynamics plugins.

The plugin multiplies velocities by stability derivatives, so that a resistance has a negative coefficient
(gz-sim, ``Hydrodynamics.hh``, after Fossen 1994). ``<fluid_added_mass>`` holds the added mass itself, with a
positive sign. Physics engines differ in the reference point of this added mass: the origin of the link or its
centre of mass. Therefore the frame of each link is placed at its centre of mass. A plugin knows only the
velocity of the frame of its link. Therefore a drag point at another position belongs to a helper link of
negligible mass, which is fixed to the link.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import (
    Element,
    Exported,
    Link,
    Source,
    about,
    added_mass_limits,
    central,
    export_xml,
    joint_limits,
)
from swimid.fitting.model import Array

TITLE = "Gazebo SDF"
#: Letters of force and velocity components (SNAME), indices of the planar components among the six
#: components, and their signs. The key says whether the plane is vertical.
PLANES = {
    False: ("xyn", "UVR", (0, 1, 5), (1.0, 1.0, 1.0)),
    True: ("xzm", "UWQ", (0, 2, 4), (1.0, 1.0, -1.0)),
}
#: Names of the motions out of the plane. The key says whether the plane is vertical.
OUT_OF_PLANE = {False: "roll, pitch and heave", True: "roll, yaw and sway"}
#: Mass of a helper link divided by the mass of its link, and radius of gyration of a helper link, m.
HELPER_MASS, HELPER_RADIUS_M = 1e-6, 0.01
#: Kinds of force elements for which Gazebo has no plugin.
LEFT_OUT = {
    "foil": "lift and drag of foils",
    "wake": "thrust and side force of trailing edges",
    "force": "weight, buoyancy and constant forces",
}
DART_ONLY = "fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it"


@dataclass(frozen=True)
class Part:
    """Link of the SDF model.

    Attributes
    ----------
    name : str
    mass : float, kg
    moment : float, kg m2
    derivatives : list of (str, float)
        Stability derivatives with the tags of the plugin.
    fluid : nested list, shape (6, 6), or None
        Added mass.
    pose : sequence of 6 floats
        Position (m) and angles (rad), in the frame ``relative_to``.
    welded_to : str
        Name of the link to which a helper link is fixed; empty for other links.
    """

    name: str
    mass: float
    moment: float
    derivatives: list[tuple[str, float]]
    fluid: list[list[float]] | None = None
    pose: Sequence[float] = ()
    relative_to: str = ""
    welded_to: str = ""


def export(source: Source, options: ExportOptions) -> Exported:
    """Return the SDF document of a multi-link robot."""
    inertias, heading = source.inertias(fold=options.added_mass == "fold"), None
    servos = source.servos(inertias, options.servo_hz)
    for servo in servos:
        servo["joint"] = _joint_name(source, servo["joint"])
    if source.heading_rad is not None:
        heading = _pose(source, 0.0, 0.0, source.heading_rad)
    variables = {
        "pi": math.pi,
        "heading": heading,
        "links": _links(source, options, inertias),
        "joints": [_joint(source, link, inertias) for link in source.links[1:]],
        "servos": servos,
    }
    return export_xml("gazebo.sdf", source, _limits(source, options), **variables)


def _pose(source: Source, x: float, y: float, turn: float = 0.0) -> tuple[float, ...]:
    """Return position and angles of a frame in the plane of the robot, as the six values of an SDF pose."""
    if source.vertical:
        return (x, 0.0, y, 0.0, -turn, 0.0)
    return (x, y, 0.0, 0.0, 0.0, turn)


def _joint_name(source: Source, name: str) -> str:
    """Return a joint name that differs from all link names: in SDF they share a name space."""
    return f"{name}_joint" if any(link.name == name for link in source.links) else name


def _links(source: Source, options: ExportOptions, inertias: list[Array]) -> list[Part]:
    """Return each link, followed by the helper links of its drag points."""
    parts = []
    for i, link in enumerate(source.links):
        mass, (x, y), moment = central(inertias[i])
        added = about(link.added, x, y)
        added[np.abs(added) < 1e-12 * np.abs(added).max()] = 0.0
        fluid = None
        if options.added_mass == "native" and np.any(link.added):
            fluid = _six_by_six(source, added)
        drag = [element for element in source.elements if element.kind == "drag" and element.link == i]
        here = [element for element in drag if math.dist(element.at, (x, y)) < 1e-9 or not _pushes(element)]
        frame = ""
        if link.joint:
            frame = _joint_name(source, link.joint.name)
        tags = _derivatives(source, here)
        parts.append(Part(link.name, mass, moment, tags, fluid, _pose(source, x, y), frame))
        for k, element in enumerate(element for element in drag if element not in here):
            small = HELPER_MASS * mass
            pose = _pose(source, element.at[0] - x, element.at[1] - y)
            tags, inertia = _derivatives(source, [element]), small * HELPER_RADIUS_M**2
            parts.append(Part(f"{link.name}_drag{k}", small, inertia, tags, None, pose, link.name, link.name))
    return parts


def _six_by_six(source: Source, added: Array) -> list[list[float]]:
    """Return a planar added mass, over (u, v, r) in the frame of the link, as a 6 x 6 matrix.

    In the vertical plane a positive rotation of swimid is from x towards z, a positive rotation of Gazebo
    from z towards x.
    """
    _, _, axes, signs = PLANES[source.vertical]
    matrix = np.zeros((6, 6))
    matrix[np.ix_(axes, axes)] = added * np.outer(signs, signs)
    return matrix.tolist()


def _pushes(element: Element) -> bool:
    """Return whether a drag element exerts a force, and not only a moment."""
    return any(element.numbers[key] for key in ("quadratic_x", "quadratic_y", "linear_x", "linear_y"))


def _derivatives(source: Source, drag: list[Element]) -> list[tuple[str, float]]:
    """Return the stability derivatives of drag elements, with the tags of the plugin."""
    tags = []
    forces, speeds, _, _ = PLANES[source.vertical]
    for force, speed, key in zip(forces, speeds, "xyr", strict=True):
        for kind, tag in (("linear", speed), ("quadratic", f"{speed}abs{speed}")):
            total = sum(element.numbers[f"{kind}_{key}"] for element in drag)
            if total:
                tags.append((f"{force}{tag}", -total))
    return tags


def _joint(source: Source, link: Link, inertias: list[Array]) -> dict[str, Any]:
    assert link.joint is not None
    x, y = central(inertias[link.parent])[1]
    return {
        "name": _joint_name(source, link.joint.name),
        "parent": source.links[link.parent].name,
        "child": link.name,
        "pose": _pose(source, link.at[0] - x, link.at[1] - y, link.mount_rad),
        "moves": link.moves,
        "law": source.laws.get(link.joint.name),
    }


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = added_mass_limits(source, options.added_mass, DART_ONLY)
    limits += [
        f"{what} are left out: {source.links_with(kind)}"
        for kind, what in LEFT_OUT.items()
        if source.links_with(kind)
    ]
    for name, law in source.laws.items():
        if law["spring"]:
            stiffness = f"{law['wire_stiffness']:.6g} N m/rad"
            limits.append(f"{name}: wire and spring become their small-angle stiffness {stiffness}")
        for key in ("cubic", "quadratic_damping"):
            if law[key]:
                words = {"cubic": "cubic stiffness", "quadratic_damping": "quadratic damping"}[key]
                limits.append(f"{name}: the {words} is left out")
    out = OUT_OF_PLANE[source.vertical]
    return [
        *limits,
        *joint_limits(source, options.servo_hz),
        f"{out} were not identified: no drag and no added mass there, the moments of inertia are assumed",
    ]
