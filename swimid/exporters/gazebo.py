"""Gazebo: an SDF model with Hydrodynamics plugins.

The plugin takes stability derivatives: a coefficient is what the force is multiplied by, so that
what resists is negative (gz-sim, ``Hydrodynamics.hh``, after Fossen 1994). ``<fluid_added_mass>``
holds the added mass itself, positive; engines disagree on whether it is about the link's origin or
its centre of mass, so every link's frame is put at its centre of mass. A plugin knows the velocity
of its link's frame only: a drag point elsewhere sits on a helper link of negligible mass, welded on.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence

import numpy as np

from swimid.errors import InputError
from swimid.exporters import common
from swimid.exporters.common import Exported, node
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Element, Law, Link, Source, about, behind_joint, central, surge
from swimid.fitting.model import Array
from swimid.swimmer.planar import engine

#: Letters of force and velocity (SNAME) and sign of turning, by plane; swimid turns from x towards z.
HORIZONTAL = (("x", "y", "n"), ("U", "V", "R"), (1.0, 1.0, 1.0))
VERTICAL = (("x", "z", "m"), ("U", "W", "Q"), (1.0, 1.0, -1.0))
#: Rows and columns of ``<fluid_added_mass>``.
SIX = ("x", "y", "z", "p", "q", "r")
#: Mass of a helper link over that of the link it sits on.
HELPER = 1e-6
DART_ONLY = "fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it"


def export(source: Source, options: ExportOptions) -> Exported:
    """SDF of a multi-link robot, or of one rigid body; see :class:`swimid.exporters.Target`."""
    model = node("model", name=source.robot.name)
    parts = _tree if source.multilink else _rigid
    limits, dangers = parts(source, options, model)
    limits.append(common.NO_ERRORS)
    root = node("sdf", model, version="1.10")
    return Exported(common.document(root, source, limits), limits, dangers)


def _pose(
    source: Source, x: float, y: float, turn: float = 0.0, relative_to: str | None = None
) -> ET.Element:
    six = (x, 0.0, y, 0.0, -turn, 0.0) if source.vertical else (x, y, 0.0, 0.0, 0.0, turn)
    return node("pose", six, relative_to=relative_to)


def _link(
    name: str, pose: ET.Element | None, mass: float, moments: Sequence[float], fluid: ET.Element | None = None
) -> ET.Element:
    inertia = node("inertia")
    inertia.extend(node(tag, value) for tag, value in zip(("ixx", "iyy", "izz"), moments, strict=True))
    inertia.extend(node(tag, "0") for tag in ("ixy", "ixz", "iyz"))
    # the robot floats: its weight and buoyancy are taken to cancel
    gravity, inertial = node("gravity", "false"), node("inertial", node("mass", mass), inertia, fluid)
    return node("link", pose, gravity, inertial, name=name)


def _tree(source: Source, options: ExportOptions, model: ET.Element) -> tuple[list[str], list[str]]:
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    centres = [central(g)[1] for g in inertias]
    dangers = []
    if source.body.base == "fixed":
        model.append(_pose(source, 0.0, 0.0, math.radians(source.body.heading_deg)))
    for i, link in enumerate(source.links):
        mass, centre, moment = central(inertias[i])
        joint = None if link.joint is None else _joint_name(source, link.joint.name)
        added = about(link.added, *centre)
        added[np.abs(added) < 1e-12 * np.abs(added).max()] = 0.0
        native = options.added_mass == "native" and np.any(link.added)
        fluid = _fluid(source, added) if native else None
        model.append(_link(link.name, _pose(source, *centre, 0.0, joint), mass, [moment] * 3, fluid))
        drag = [e for e in source.elements if e.kind == "drag" and e.link == i]
        here = [e for e in drag if math.dist(e.at, centre) < 1e-9 or not _pushes(e)]
        model.append(_water(source, link.name, here, added if options.added_mass == "plugin" else None))
        for k, element in enumerate(e for e in drag if e not in here):
            name, helper = f"{link.name}_drag{k}", HELPER * mass
            pose = _pose(source, element.at[0] - centre[0], element.at[1] - centre[1], 0.0, link.name)
            model.append(_link(name, pose, helper, [helper * 1e-4] * 3))  # radius of gyration 1 cm
            model.append(_weld(f"{name}_weld", link.name, name))
            model.append(_water(source, name, [element]))
        ratio = _ratio(added, np.diag([mass, mass, moment]))
        if options.added_mass == "plugin" and ratio >= 1.0:
            dangers.append(
                f"the added mass of {link.name} is {ratio:.3g} times its own inertia: the plugin applies it "
                "one step late and is unstable from 1 on (gz-sim#1923); leave it in fluid_added_mass"
            )
    if source.body.base == "fixed":
        model.append(_weld("world_weld", "world", source.links[0].name))
    model.extend(_joint(source, link, centres[link.parent]) for link in source.links[1:])
    model.extend(_servos(source, inertias, options.servo_hz))
    return _limits(source, options), dangers


def _joint_name(source: Source, name: str) -> str:
    """A joint's name; links and joints of a model share one set of names in SDF."""
    return f"{name}_joint" if any(link.name == name for link in source.links) else name


def _weld(name: str, parent: str, child: str) -> ET.Element:
    return node("joint", node("parent", parent), node("child", child), name=name, type="fixed")


def _ratio(added: Array, body: Array) -> float:
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(body, added))).max())


def _fluid(source: Source, added: Array) -> ET.Element:
    """The added mass in six dimensions, positive, about the link's frame."""
    index, sign = ([0, 2, 4], (1.0, 1.0, -1.0)) if source.vertical else ([0, 1, 5], (1.0, 1.0, 1.0))
    six = np.zeros((6, 6))
    six[np.ix_(index, index)] = added * np.outer(sign, sign)
    upper = [node(SIX[i] + SIX[j], six[i, j]) for i in range(6) for j in range(i, 6)]
    return node("fluid_added_mass", *upper)


def _pushes(element: Element) -> bool:
    """Whether a drag row has a force, not only a moment."""
    return any(element.numbers[k] for k in ("quadratic_x", "quadratic_y", "linear_x", "linear_y"))


def _water(source: Source, link: str, drag: list[Element], added: Array | None = None) -> ET.Element:
    """The Hydrodynamics plugin of a link."""
    density = node("water_density", source.robot.fluid.density_kg_m3)
    plugin = _plugin("hydrodynamics", "Hydrodynamics", node("link_name", link), density)
    forces, speeds, sign = VERTICAL if source.vertical else HORIZONTAL
    for i, (force, speed, key) in enumerate(zip(forces, speeds, "xyr", strict=True)):
        for j, other in enumerate(speeds):
            if added is not None and added[i, j] != 0.0:
                plugin.append(node(f"{force}Dot{other}", -sign[i] * sign[j] * added[i, j]))
        for kind, tag in (("linear", speed), ("quadratic", f"{speed}abs{speed}")):
            total = sum(e.numbers[f"{kind}_{key}"] for e in drag)
            if total:
                plugin.append(node(f"{force}{tag}", -total))
    return plugin


def _plugin(file: str, name: str, *content: ET.Element) -> ET.Element:
    return node("plugin", *content, filename=f"gz-sim-{file}-system", name=f"gz::sim::systems::{name}")


def _joint(source: Source, link: Link, centre: tuple[float, float]) -> ET.Element:
    assert link.joint is not None
    parent = source.links[link.parent].name
    joint = node(
        "joint",
        _pose(source, link.at[0] - centre[0], link.at[1] - centre[1], link.mount_rad, parent),
        node("parent", parent),
        node("child", link.name),
        name=_joint_name(source, link.joint.name),
        type="revolute" if link.moves else "fixed",
    )
    if link.moves:
        direction = node("xyz", "0 -1 0" if source.vertical else "0 0 1")
        limit = node("limit", node("lower", -math.pi), node("upper", math.pi))
        joint.append(node("axis", direction, limit, _dynamics(source.laws.get(link.joint.name))))
    return joint


def _dynamics(law: Law | None) -> ET.Element | None:
    if law is None:
        return None
    return node(
        "dynamics",
        node("damping", law.damping),
        node("friction", law.friction),
        node("spring_reference", law.rest),
        node("spring_stiffness", law.stiffness + law.wire_stiffness),
    )


def _servos(source: Source, inertias: list[Array], default_hz: float) -> Iterator[ET.Element]:
    moments = behind_joint(source.links, inertias)
    for axis in source.assembly.driven:
        omega, ratio = source.servo(axis.joint, default_hz)
        yield _plugin(
            "joint-position-controller",
            "JointPositionController",
            node("joint_name", _joint_name(source, axis.joint.name)),
            node("p_gain", moments[axis.link] * omega**2),
            node("i_gain", "0"),
            node("d_gain", 2.0 * ratio * omega * moments[axis.link]),
        )


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = common.added_mass_limits(source, options.added_mass)
    wet = [link for link in source.links if np.any(link.added)]
    if wet and options.added_mass == "native":
        limits.append(DART_ONLY)
    if wet and options.added_mass == "plugin":
        limits.append(
            "added mass in the plugin is deprecated since Gazebo Ionic, and its Coriolis force leaves out "
            "products between directions"
        )
    limits += common.element_limits(source)
    for name, law in source.laws.items():
        if law.spring:
            limits.append(
                f"{name}: wire and spring become their small-angle stiffness {law.wire_stiffness:.6g} N m/rad"
            )
        if law.cubic:
            limits.append(f"{name}: the cubic stiffness is left out")
        if law.quadratic_damping:
            limits.append(f"{name}: the quadratic damping is left out")
    limits += common.friction_limits(source)
    return limits + common.drive_limits(source, options.servo_hz) + common.reading_limits(source)


def _rigid(source: Source, options: ExportOptions, model: ET.Element) -> tuple[list[str], list[str]]:
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
    model.append(_link("body", None, whole, box, _fluid(source, added) if choice == "native" else None))
    elements = [Element("drag", 0, row)]
    model.append(_water(source, "body", elements, added if choice == "plugin" else None))
    limits = [
        "a rig identifies surge only: no drag and no added mass in sway, heave, roll, pitch and yaw",
        "moments of inertia the robot file does not give are those of a solid box",
    ]
    known = ("drag_coefficient", "quadratic_drag", "linear_drag", "added_mass")
    left = [name for name in source.parameters.parameters if name not in known]
    if left:
        limits.append(f"belong to the rig, not to the body: {', '.join(left)}")
    choices = {
        "fold": "added mass is part of the body's mass, in every direction",
        "none": "added mass is left out, as asked",
        "native": DART_ONLY,
    }
    if choice in choices:
        limits.append(choices[choice])
    dangers = []
    if choice == "plugin" and drag["added_mass"] >= mass:
        dangers.append(
            f"the added mass, {drag['added_mass']:.4g} kg, is not below the body's {mass:.4g} kg: the plugin "
            "applies it one step late and is unstable then (gz-sim#1923); leave it in fluid_added_mass"
        )
    return limits, dangers
