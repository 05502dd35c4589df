"""Gazebo: an SDF model with Hydrodynamics plugins.

The plugin takes stability derivatives: a coefficient is what the force is multiplied by, so that
what resists is negative (gz-sim, ``Hydrodynamics.hh``, after Fossen 1994). ``<fluid_added_mass>``
holds the added mass itself, positive; engines disagree on whether it is about the link's origin or
its centre of mass, so every link's frame is put at its centre of mass. A plugin knows the velocity
of its link's frame only: a drag point elsewhere sits on a helper link of negligible mass, welded on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import (
    NO_ERRORS,
    Element,
    Exported,
    Link,
    Source,
    about,
    added_mass_limits,
    bodies,
    central,
    document,
    joint_limits,
    surge,
)
from swimid.fitting.model import Array
from swimid.swimmer.planar import engine

#: Letters of force and velocity (SNAME) by plane.
HORIZONTAL, VERTICAL = ("xyn", "UVR"), ("xzm", "UWQ")
#: Mass of a helper link over that of the link it sits on.
HELPER = 1e-6
DART_ONLY = "fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it"


def export(source: Source, options: ExportOptions) -> Exported:
    """SDF of a multi-link robot, or of one rigid body; see :class:`swimid.exporters.export.Target`."""
    inertias = bodies(source, fold=options.added_mass == "fold") if source.multilink else []
    heading = source.heading_rad if source.multilink else None
    if source.multilink:
        links = _tree(source, options, inertias)
        limits = _limits(source, options)
    else:
        links, limits = _rigid(source, options)
    limits.append(NO_ERRORS)
    text = document(
        "gazebo.sdf",
        source,
        limits,
        pi=math.pi,
        heading=None if heading is None else _pose(source, 0.0, 0.0, heading),
        links=links,
        joints=[_joint(source, link, inertias) for link in source.links[1:]] if inertias else [],
        servos=source.servos(inertias, options.servo_hz) if inertias else [],
        name_of=partial(_joint_name, source),
    )
    return Exported(text, limits)


def _pose(source: Source, x: float, y: float, turn: float = 0.0) -> tuple[float, ...]:
    return (x, 0.0, y, 0.0, -turn, 0.0) if source.vertical else (x, y, 0.0, 0.0, 0.0, turn)


@dataclass(frozen=True)
class Part:
    """A link of the model: the added mass is over six axes, derivatives are those of the plugin."""

    name: str
    mass: float
    moments: Sequence[float]
    derivatives: list[tuple[str, float]]
    fluid: list[list[float]] | None = None
    pose: Sequence[float] = ()
    relative_to: str = ""
    welded_to: str = ""


def _tree(source: Source, options: ExportOptions, inertias: list[Array]) -> list[Part]:
    parts = []
    native = options.added_mass == "native"
    for i, link in enumerate(source.links):
        mass, (x, y), moment = central(inertias[i])
        added = about(link.added, x, y)
        added[np.abs(added) < 1e-12 * np.abs(added).max()] = 0.0
        drag = [e for e in source.elements if e.kind == "drag" and e.link == i]
        here = [e for e in drag if math.dist(e.at, (x, y)) < 1e-9 or not _pushes(e)]
        part = Part(
            link.name,
            mass,
            [moment] * 3,
            _derivatives(source, here),
            _six(source, added) if native and np.any(link.added) else None,
            _pose(source, x, y),
            relative_to=_joint_name(source, link.joint.name) if link.joint else "",
        )
        parts.append(part)
        for k, element in enumerate(e for e in drag if e not in here):
            name, small = f"{link.name}_drag{k}", [HELPER * mass * 1e-4] * 3  # radius of gyration 1 cm
            pose = _pose(source, element.at[0] - x, element.at[1] - y)
            tags = _derivatives(source, [element])
            parts.append(Part(name, HELPER * mass, small, tags, None, pose, link.name, welded_to=link.name))
    return parts


def _joint_name(source: Source, name: str) -> str:
    """A joint's name; links and joints of a model share one set of names in SDF."""
    return f"{name}_joint" if any(link.name == name for link in source.links) else name


def _six(source: Source, added: Array) -> list[list[float]]:
    """The added mass in six dimensions, positive, about the link's frame; swimid turns from x towards z."""
    index, sign = ([0, 2, 4], (1.0, 1.0, -1.0)) if source.vertical else ([0, 1, 5], (1.0, 1.0, 1.0))
    six = np.zeros((6, 6))
    six[np.ix_(index, index)] = added * np.outer(sign, sign)
    return six.tolist()


def _pushes(element: Element) -> bool:
    """Whether a drag row has a force, not only a moment."""
    return any(element.numbers[k] for k in ("quadratic_x", "quadratic_y", "linear_x", "linear_y"))


def _derivatives(source: Source, drag: list[Element]) -> list[tuple[str, float]]:
    """Stability derivatives of drag by their tag in the plugin."""
    tags = []
    for force, speed, key in zip(*(VERTICAL if source.vertical else HORIZONTAL), "xyr", strict=True):
        for kind, tag in (("linear", speed), ("quadratic", f"{speed}abs{speed}")):
            total = sum(e.numbers[f"{kind}_{key}"] for e in drag)
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
    limits = added_mass_limits(source, options.added_mass)
    wet = [link for link in source.links if np.any(link.added)]
    if wet and options.added_mass == "native":
        limits.append(DART_ONLY)
    for kind, what in (
        ("foil", "lift and drag of foils"),
        ("wake", "thrust and side force of trailing edges"),
        ("force", "weight, buoyancy and constant forces"),
    ):
        left = [source.links[e.link].name for e in source.elements if e.kind == kind]
        if left:
            limits.append(f"{what} are left out: {', '.join(dict.fromkeys(left))}")
    for name, law in source.laws.items():
        if law.spring:
            limits.append(
                f"{name}: wire and spring become their small-angle stiffness {law.wire_stiffness:.6g} N m/rad"
            )
        if law.cubic:
            limits.append(f"{name}: the cubic stiffness is left out")
        if law.quadratic_damping:
            limits.append(f"{name}: the quadratic damping is left out")
    out = "roll, yaw and sway" if source.vertical else "roll, pitch and heave"
    return [
        *limits,
        *joint_limits(source, options.servo_hz),
        f"{out} were not identified: no drag and no added mass there, the moments of inertia are assumed",
    ]


def _rigid(source: Source, options: ExportOptions) -> tuple[list[Part], list[str]]:
    """One rigid body with surge drag only."""
    body = source.robot.body
    for key in ("inertial_mass_kg", "length_m", "width_m", "height_m"):
        if not getattr(body, key):
            raise InputError("an SDF link needs it", file=source.origin["robot"], column=f"body.{key}")
    sizes = body.inertial_mass_kg, body.length_m, body.width_m, body.height_m
    mass, length, width, height = (float(size or 0.0) for size in sizes)
    drag, choice = surge(source), options.added_mass
    box = (
        body.roll_inertia_kg_m2 or mass * (width**2 + height**2) / 12.0,
        body.pitch_inertia_kg_m2 or mass * (length**2 + height**2) / 12.0,
        body.yaw_inertia_kg_m2 or mass * (length**2 + width**2) / 12.0,
    )
    added = np.diag([drag["added_mass"], 0.0, 0.0])
    whole = mass + (drag["added_mass"] if choice == "fold" else 0.0)
    row = dict.fromkeys(engine.DRAG, 0.0) | {"quadratic_x": drag["quadratic"], "linear_x": drag["linear"]}
    tags = _derivatives(source, [Element("drag", 0, row)])
    part = Part("body", whole, box, tags, _six(source, added) if choice == "native" else None)
    limits = [
        "a rig identifies surge only: no drag and no added mass in sway, heave, roll, pitch and yaw",
        "moments of inertia the robot file does not give are those of a solid box",
    ]
    known = ("drag_coefficient", "quadratic_drag", "linear_drag", "added_mass")
    left = [name for name in source.parameters.parameters if name not in known]
    if left:
        limits.append(f"belong to the rig, not to the body: {', '.join(left)}")
    limits.append(
        {
            "fold": "added mass is part of the body's mass, in every direction",
            "none": "added mass is left out, as asked",
            "native": DART_ONLY,
        }[choice]
    )
    return [part], limits
