"""Export of a robot to Gazebo as an SDF model with the plugin Hydrodynamics.

The plugin multiplies velocities by stability derivatives, so that a resistance has a negative coefficient
(gz-sim, ``Hydrodynamics.hh``, after Fossen 1994). The tag ``<fluid_added_mass>`` has the added mass itself,
with a positive sign. Physics engines differ in the reference point of this added mass: the origin of the link
or its centre of mass. Therefore the frame of each link is placed at its centre of mass. The plugin knows only
the velocity of the frame of its link. Therefore drag at another point is applied to a helper link of
negligible mass, which is fixed to the link at that point.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Exported, ExportedElement, ExportSource, about, central, export_xml

TITLE = "Gazebo SDF"
#: Components of force and velocity in the plane of the robot, for the horizontal plane (False) and the
#: vertical plane (True). Each plane has the SNAME letters of the forces and of the velocities, the indices
#: among the six components in SDF, and the signs relative to swimid.
SDF_PLANES = {
    False: ("xyn", "UVR", (0, 1, 5), (1.0, 1.0, 1.0)),
    True: ("xzm", "UWQ", (0, 2, 4), (1.0, 1.0, -1.0)),
}
#: Names of the motions out of the plane of the robot, for the horizontal plane (False) and the vertical plane
#: (True).
OUT_OF_PLANE = {False: "roll, pitch and heave", True: "roll, yaw and sway"}
#: Mass of a helper link divided by the mass of the link to which it is fixed, and radius of gyration of the
#: helper link, m. Drag is applied to helper links.
HELPER_MASS, HELPER_RADIUS_M = 1e-6, 0.01
#: Kinds of force elements that an export to Gazebo leaves out, because Gazebo has no plugin for them. Each
#: has its description in a warning.
LEFT_OUT_FORCES = {
    "foil": "lift and drag of foils",
    "wake": "thrust and side force of trailing edges",
    "force": "weight, buoyancy and constant forces",
}
#: Terms in the law of a passive joint that an export to Gazebo leaves out. Each has its description in a
#: warning.
LEFT_OUT_OF_JOINTS = {"cubic": "cubic stiffness", "quadratic_damping": "quadratic damping"}
DART_ONLY = "fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it"


def export(source: ExportSource, options: ExportOptions) -> Exported:
    """Return the SDF document of a multi-link robot, and sentences on what SDF cannot represent."""
    inertias = source.inertias(fold=options.added_mass == "fold")
    rigid = [central(inertia) for inertia in inertias]
    return export_xml(
        "gazebo.sdf",
        source,
        options,
        DART_ONLY,
        _limits(source),
        [cause for cause in source.causes if cause.hooks.command],
        forces=False,
        pi=math.pi,
        pose=partial(_pose, source),
        joint_name=partial(_joint_name, source),
        rigid=rigid,
        parts=_parts(source, options, rigid),
        servos=source.servos(inertias, options.servo_hz),
    )


def _pose(source: ExportSource, x: float, y: float, turn: float = 0.0) -> tuple[float, ...]:
    """Convert the position (m) and angle (rad) of a frame in the plane of the robot to an SDF pose.

    An SDF pose has three coordinates and three angles.
    """
    if source.vertical:
        return (x, 0.0, y, 0.0, -turn, 0.0)
    return (x, y, 0.0, 0.0, 0.0, turn)


def _joint_name(source: ExportSource, name: str) -> str:
    """Return the name of a joint in SDF, which must differ from the names of all links."""
    return f"{name}_joint" if any(link.name == name for link in source.links) else name


def _parts(source: ExportSource, options: ExportOptions, rigid: list[Any]) -> list[dict[str, Any]]:
    """Return the links of the SDF model: each link of the robot, followed by the helper links for its drag.

    A link has ``name``, ``mass`` (kg), ``moment`` (kg m2), ``derivatives`` (tags of the plugin with their
    values), ``fluid`` (added mass, shape (6, 6), if there is any) and ``pose`` in the frame ``relative_to``.
    A helper link is fixed to the link ``welded_to``.
    """
    parts = []
    _, _, axes, signs = SDF_PLANES[source.vertical]
    for i, (link, (mass, (x, y), moment)) in enumerate(zip(source.links, rigid, strict=True)):
        part: dict[str, Any] = {
            "name": link.name,
            "mass": mass,
            "moment": moment,
            "pose": _pose(source, x, y),
        }
        if options.added_mass == "native" and np.any(link.added):
            # Multiply by signs, because a positive rotation in the vertical plane is from x towards z in
            # swimid, and from z towards x in Gazebo.
            added, fluid = about(link.added, x, y) * np.outer(signs, signs), np.zeros((6, 6))
            added[np.abs(added) < 1e-12 * np.abs(added).max()] = 0.0
            fluid[np.ix_(axes, axes)] = added
            part["fluid"] = fluid.tolist()
        if link.joint:
            part["relative_to"] = _joint_name(source, link.joint.name)
        drag = [element for element in source.elements if element.kind == "drag" and element.link == i]
        # The plugin of a link can apply moments, which have no point of application, and drag at the frame of
        # the link. Drag at other points needs a helper link.
        pushes = ("quadratic_x", "quadratic_y", "linear_x", "linear_y")
        away = [e for e in drag if math.dist(e.at, (x, y)) >= 1e-9 and any(e.numbers[key] for key in pushes)]
        part["derivatives"] = _derivatives(source, [element for element in drag if element not in away])
        parts.append(part)
        for k, element in enumerate(away):
            helper = {
                "name": f"{link.name}_drag{k}",
                "mass": HELPER_MASS * mass,
                "moment": HELPER_MASS * mass * HELPER_RADIUS_M**2,
                "derivatives": _derivatives(source, [element]),
                "pose": _pose(source, element.at[0] - x, element.at[1] - y),
            }
            parts.append({**helper, "relative_to": link.name, "welded_to": link.name})
    return parts


def _derivatives(source: ExportSource, drag: list[ExportedElement]) -> dict[str, float]:
    """Return the stability derivatives that represent drag elements at the frame of a link.

    The key is the tag of the Hydrodynamics plugin.
    """
    tags = {}
    forces, speeds, _, _ = SDF_PLANES[source.vertical]
    for force, speed, key in zip(forces, speeds, "xyr", strict=True):
        for kind, tag in (("linear", speed), ("quadratic", f"{speed}abs{speed}")):
            total = sum(element.numbers[f"{kind}_{key}"] for element in drag)
            if total:
                tags[f"{force}{tag}"] = -total
    return tags


def _limits(source: ExportSource) -> list[str]:
    owners = {what: source.links_with(kind) for kind, what in LEFT_OUT_FORCES.items()}
    limits = [f"{what} are left out: {links}" for what, links in owners.items() if links]
    for name, law in source.laws.items():
        if law["spring"]:
            stiffness = f"{law['wire_stiffness']:.6g} N m/rad"
            limits.append(f"{name}: wire and spring become their small-angle stiffness {stiffness}")
        limits += [
            f"{name}: the {words} is left out" for key, words in LEFT_OUT_OF_JOINTS.items() if law[key]
        ]
    out = OUT_OF_PLANE[source.vertical]
    text = f"{out} were not identified: no drag and no added mass there, the moments of inertia are assumed"
    return [*limits, text]
