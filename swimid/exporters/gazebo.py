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

import numpy as np

from swimid.errors import InputError
from swimid.exporters import common
from swimid.exporters.base import Exported
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Element, Source, about, behind_joint, central, surge
from swimid.fitting.model import Array
from swimid.swimmer.planar import engine

#: Letters of force and velocity (SNAME) and sign of turning, by plane; swimid turns from x towards z.
HORIZONTAL = (("x", "y", "n"), ("U", "V", "R"), (1.0, 1.0, 1.0))
VERTICAL = (("x", "z", "m"), ("U", "W", "Q"), (1.0, 1.0, -1.0))
#: Rows and columns of ``<fluid_added_mass>``.
SIX = ("x", "y", "z", "p", "q", "r")
#: Mass of a helper link over that of the link it sits on.
HELPER = 1e-6


def export(source: Source, options: ExportOptions) -> Exported:
    """SDF of a multi-link robot, or of one rigid body; see :class:`swimid.exporters.Target`."""
    root = ET.Element("sdf", version="1.10")
    model = ET.SubElement(root, "model", name=source.robot.name)
    if not source.multilink:
        limits, dangers = _rigid(source, options, model)
    else:
        limits, dangers = _tree(source, options, model)
    limits.append(common.NO_ERRORS)
    return Exported(common.document(root, source, limits), tuple(limits), tuple(dangers))


def _text(parent: ET.Element, tag: str, text: str, **attributes: str) -> ET.Element:
    node = ET.SubElement(parent, tag, attributes)
    node.text = text
    return node


def _pose(source: Source, x: float, y: float, turn: float = 0.0) -> str:
    if source.vertical:
        return common.number(x, 0.0, y, 0.0, -turn, 0.0)
    return common.number(x, y, 0.0, 0.0, 0.0, turn)


def _link(
    source: Source, model: ET.Element, name: str, mass: float, moments: tuple[float, float, float]
) -> ET.Element:
    link = ET.SubElement(model, "link", name=name)
    # the robot floats: its weight and buoyancy are taken to cancel
    _text(link, "gravity", "false")
    inertial = ET.SubElement(link, "inertial")
    _text(inertial, "mass", common.number(mass))
    inertia = ET.SubElement(inertial, "inertia")
    for tag, value in zip(("ixx", "iyy", "izz"), moments, strict=True):
        _text(inertia, tag, common.number(value))
    for tag in ("ixy", "ixz", "iyz"):
        _text(inertia, tag, "0")
    return inertial


def _tree(source: Source, options: ExportOptions, model: ET.Element) -> tuple[list[str], list[str]]:
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    centres = [central(g)[1] for g in inertias]
    dangers = []
    if source.body.base == "fixed":
        model.append(_posed(_pose(source, 0.0, 0.0, math.radians(source.body.heading_deg))))
    for i, link in enumerate(source.links):
        mass, centre, moment = central(inertias[i])
        inertial = _link(source, model, link.name, mass, (moment, moment, moment))
        node = model.findall("link")[-1]
        if link.parent < 0:
            node.insert(0, _posed(_pose(source, *centre)))
        else:
            assert link.joint is not None
            node.insert(0, _posed(_pose(source, *centre), relative_to=_joint_name(source, link.joint.name)))
        added = about(link.added, *centre)
        added[np.abs(added) < 1e-12 * np.abs(added).max()] = 0.0
        if options.added_mass == "native" and np.any(link.added):
            _fluid(source, inertial, added)
        derivatives = added if options.added_mass == "plugin" else np.zeros((3, 3))
        drag = [e for e in source.elements if e.kind == "drag" and e.link == i]
        here = [e for e in drag if math.dist(e.at, centre) < 1e-9 or not _pushes(e)]
        _plugin(source, model, link.name, here, derivatives)
        for k, element in enumerate(e for e in drag if e not in here):
            _helper(source, model, (link.name, f"{link.name}_drag{k}"), centre, element, HELPER * mass)
        ratio = _ratio(added, np.diag([mass, mass, moment]))
        if options.added_mass == "plugin" and ratio >= 1.0:
            dangers.append(
                f"the added mass of {link.name} is {ratio:.3g} times its own inertia: the plugin applies it "
                "one step late and is unstable from 1 on (gz-sim#1923); leave it in fluid_added_mass"
            )
    _joints(source, model, centres)
    _servos(source, inertias, model, options.servo_hz)
    return _limits(source, options), dangers


def _joint_name(source: Source, name: str) -> str:
    """A joint's name; links and joints of a model share one set of names in SDF."""
    return f"{name}_joint" if any(link.name == name for link in source.links) else name


def _posed(text: str, **attributes: str) -> ET.Element:
    node = ET.Element("pose", attributes)
    node.text = text
    return node


def _ratio(added: Array, body: Array) -> float:
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(body, added))).max())


def _fluid(source: Source, inertial: ET.Element, added: Array) -> None:
    """The added mass in six dimensions, positive, about the link's frame."""
    index, sign = ([0, 2, 4], (1.0, 1.0, -1.0)) if source.vertical else ([0, 1, 5], (1.0, 1.0, 1.0))
    six = np.zeros((6, 6))
    six[np.ix_(index, index)] = added * np.outer(sign, sign)
    fluid = ET.SubElement(inertial, "fluid_added_mass")
    for i in range(6):
        for j in range(i, 6):
            _text(fluid, SIX[i] + SIX[j], common.number(six[i, j]))


def _pushes(element: Element) -> bool:
    """Whether a drag row has a force, not only a moment."""
    return any(element.numbers[k] for k in ("quadratic_x", "quadratic_y", "linear_x", "linear_y"))


def _helper(
    source: Source,
    model: ET.Element,
    names: tuple[str, str],
    centre: tuple[float, float],
    element: Element,
    mass: float,
) -> None:
    """A link welded on where a drag row acts."""
    owner, name = names
    small = mass * 1e-4  # radius of gyration 1 cm
    _link(source, model, name, mass, (small, small, small))
    place = _pose(source, element.at[0] - centre[0], element.at[1] - centre[1])
    model.findall("link")[-1].insert(0, _posed(place, relative_to=owner))
    joint = ET.SubElement(model, "joint", name=f"{name}_weld", type="fixed")
    _text(joint, "parent", owner)
    _text(joint, "child", name)
    _plugin(source, model, name, [element], np.zeros((3, 3)))


def _plugin(source: Source, model: ET.Element, link: str, drag: list[Element], added: Array) -> None:
    plugin = ET.SubElement(
        model, "plugin", filename="gz-sim-hydrodynamics-system", name="gz::sim::systems::Hydrodynamics"
    )
    _text(plugin, "link_name", link)
    _text(plugin, "water_density", common.number(source.robot.fluid.density_kg_m3))
    forces, speeds, sign = VERTICAL if source.vertical else HORIZONTAL
    for i, (force, speed, key) in enumerate(zip(forces, speeds, "xyr", strict=True)):
        for j, other in enumerate(speeds):
            if added[i, j] != 0.0:
                _text(plugin, f"{force}Dot{other}", common.number(-sign[i] * sign[j] * added[i, j]))
        linear = sum(e.numbers[f"linear_{key}"] for e in drag)
        quadratic = sum(e.numbers[f"quadratic_{key}"] for e in drag)
        if linear:
            _text(plugin, f"{force}{speed}", common.number(-linear))
        if quadratic:
            _text(plugin, f"{force}{speed}abs{speed}", common.number(-quadratic))


def _joints(source: Source, model: ET.Element, centres: list[tuple[float, float]]) -> None:
    if source.body.base == "fixed":
        joint = ET.SubElement(model, "joint", name="world_weld", type="fixed")
        _text(joint, "parent", "world")
        _text(joint, "child", source.links[0].name)
    for link in source.links[1:]:
        assert link.joint is not None
        moving = link.joint.driven is not None or link.joint.passive is not None
        name = _joint_name(source, link.joint.name)
        joint = ET.SubElement(model, "joint", name=name, type="revolute" if moving else "fixed")
        parent, (cx, cy) = source.links[link.parent], centres[link.parent]
        place = _pose(source, link.at[0] - cx, link.at[1] - cy, link.mount_rad)
        _text(joint, "pose", place, relative_to=parent.name)
        _text(joint, "parent", parent.name)
        _text(joint, "child", link.name)
        if not moving:
            continue
        axis = ET.SubElement(joint, "axis")
        _text(axis, "xyz", "0 -1 0" if source.vertical else "0 0 1")
        limit = ET.SubElement(axis, "limit")
        _text(limit, "lower", common.number(-math.pi))
        _text(limit, "upper", common.number(math.pi))
        law = source.laws.get(link.joint.name)
        if law is not None:
            dynamics = ET.SubElement(axis, "dynamics")
            _text(dynamics, "damping", common.number(law.damping))
            _text(dynamics, "friction", common.number(law.friction))
            _text(dynamics, "spring_reference", common.number(law.rest))
            _text(dynamics, "spring_stiffness", common.number(law.stiffness + law.wire_stiffness))


def _servos(source: Source, inertias: list[Array], model: ET.Element, default_hz: float) -> None:
    moments = behind_joint(source.links, inertias)
    for axis in source.assembly.driven:
        omega, ratio = source.servo(axis.joint, default_hz)
        plugin = ET.SubElement(
            model, "plugin", filename="gz-sim-joint-position-controller-system",
            name="gz::sim::systems::JointPositionController",
        )  # fmt: skip
        _text(plugin, "joint_name", _joint_name(source, axis.joint.name))
        _text(plugin, "p_gain", common.number(moments[axis.link] * omega**2))
        _text(plugin, "i_gain", "0")
        _text(plugin, "d_gain", common.number(2.0 * ratio * omega * moments[axis.link]))


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = common.added_mass_limits(source, options.added_mass)
    wet = [link for link in source.links if np.any(link.added)]
    if wet and options.added_mass == "native":
        limits.append("fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it")
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
    mass, length, width, height = body.inertial_mass_kg, body.length_m, body.width_m, body.height_m
    assert mass is not None
    assert length is not None
    assert width is not None
    assert height is not None
    drag = surge(source)
    whole = mass + (drag["added_mass"] if options.added_mass == "fold" else 0.0)
    box = (
        body.roll_inertia_kg_m2 or mass * (width**2 + height**2) / 12.0,
        body.pitch_inertia_kg_m2 or mass * (length**2 + height**2) / 12.0,
        body.yaw_inertia_kg_m2 or mass * (length**2 + width**2) / 12.0,
    )
    inertial = _link(source, model, "body", whole, box)
    added = np.diag([drag["added_mass"], 0.0, 0.0])
    row = dict.fromkeys(engine.DRAG, 0.0) | {
        "quadratic_x": drag["quadratic"],
        "linear_x": drag["linear"],
    }
    if options.added_mass == "native":
        _fluid(source, inertial, added)
    _plugin(
        source,
        model,
        "body",
        [Element("drag", 0, row)],
        added if options.added_mass == "plugin" else np.zeros((3, 3)),
    )
    limits = [
        "a rig identifies surge only: no drag and no added mass in sway, heave, roll, pitch and yaw",
        "moments of inertia the robot file does not give are those of a solid box",
    ]
    left = [
        n
        for n in source.parameters.parameters
        if n not in ("drag_coefficient", "quadratic_drag", "linear_drag", "added_mass")
    ]
    if left:
        limits.append(f"belong to the rig, not to the body: {', '.join(left)}")
    if options.added_mass == "fold":
        limits.append("added mass is part of the body's mass, in every direction")
    if options.added_mass == "none":
        limits.append("added mass is left out, as asked")
    if options.added_mass == "native":
        limits.append("fluid_added_mass acts with the DART engine only (Gazebo's default); others ignore it")
    dangers = []
    if options.added_mass == "plugin" and drag["added_mass"] >= mass:
        dangers.append(
            f"the added mass, {drag['added_mass']:.4g} kg, is not below the body's {mass:.4g} kg: the plugin "
            "applies it one step late and is unstable then (gz-sim#1923); leave it in fluid_added_mass"
        )
    return limits, dangers
