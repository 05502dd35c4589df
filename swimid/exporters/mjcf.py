"""MuJoCo MJCF: bodies, joints, springs, wires and servos; the water by a callback.

MuJoCo's own fluid models have no added-mass inertia, and their drag acts along the velocity
instead of separately along and across the link. What the water does is therefore written into
sites (``user`` data), from which :func:`water` applies it exactly.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import numpy as np

from swimid.exporters import common
from swimid.exporters.base import Exported
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Law, Link, Source, behind_joint, central
from swimid.swimmer.planar import engine

#: Numbers a site holds: its kind, then the row of its table without the point.
KINDS = ("drag", "foil", "force", "wake")
USER = 1 + max(len(engine.DRAG), len(engine.FOIL), len(engine.FORCE), len(engine.WAKE)) - 2
PREFIX = "water:"


def export(source: Source, options: ExportOptions) -> Exported:
    """MJCF of a multi-link robot; see :class:`swimid.exporters.Target`."""
    limits = _limits(source, options)
    root = ET.Element("mujoco", model=source.robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", timestep="0.002", integrator="implicitfast", gravity="0 0 0", density="0")
    ET.SubElement(root, "size", nuser_site=str(USER))
    custom = ET.SubElement(root, "custom")
    ET.SubElement(custom, "text", name="swimid_plane", data=source.body.plane)
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    nodes = _tree(source, inertias, ET.SubElement(root, "worldbody"))
    _sites(source, nodes)
    _wires(source, nodes, root)
    _servos(source, inertias, root, options.servo_hz)
    return Exported(common.document(root, source, limits), tuple(limits))


def _point(source: Source, x: float, y: float) -> str:
    return common.number(x, 0.0, y) if source.vertical else common.number(x, y, 0.0)


def _axis(source: Source) -> str:
    # positive from the x axis towards the link's upper or port side
    return "0 -1 0" if source.vertical else "0 0 1"


def _turned(source: Source, angle: float) -> dict[str, Any]:
    return {} if angle == 0.0 else {"axisangle": f"{_axis(source)} {common.number(angle)}"}


def _tree(source: Source, inertias: list[Any], world: ET.Element) -> list[ET.Element]:
    side = "0 0 1" if source.vertical else "0 1 0"
    names = ("base_x", "base_z", "base_pitch") if source.vertical else ("base_x", "base_y", "base_yaw")
    nodes: list[ET.Element] = []
    for link, inertia in zip(source.links, inertias, strict=True):
        if link.parent < 0:
            heading = 0.0 if source.body.base == "free" else math.radians(source.body.heading_deg)
            node = ET.SubElement(world, "body", name=link.name, pos="0 0 0", **_turned(source, heading))
        else:
            node = ET.SubElement(
                nodes[link.parent], "body", name=link.name, pos=_point(source, *link.at),
                **_turned(source, link.mount_rad),
            )  # fmt: skip
        mass, centre, moment = central(inertia)
        ET.SubElement(
            node, "inertial", pos=_point(source, *centre), mass=common.number(mass),
            diaginertia=common.number(moment, moment, moment),
        )  # fmt: skip
        if link.parent < 0 and source.body.base == "free":
            ET.SubElement(node, "joint", name=names[0], type="slide", axis="1 0 0")
            ET.SubElement(node, "joint", name=names[1], type="slide", axis=side)
            ET.SubElement(node, "joint", name=names[2], type="hinge", axis=_axis(source))
        if link.joint is not None and (link.joint.driven or link.joint.passive):
            ET.SubElement(node, "joint", _hinge(source, link))
        ET.SubElement(
            node, "geom", type="capsule", size=common.number(0.05 * link.length_m), mass="0",
            fromto=f"0 0 0 {common.number(-link.length_m, 0.0, 0.0)}", contype="0", conaffinity="0",
        )  # fmt: skip
        nodes.append(node)
    return nodes


def _hinge(source: Source, link: Link) -> dict[str, str]:
    assert link.joint is not None
    name = link.joint.name
    found = {"name": name, "type": "hinge", "axis": _axis(source)}
    law = source.laws.get(name)
    if law is None:
        return found
    if law.stiffness or law.cubic:
        # the third number is the cubic term
        cubic = (0.0, law.cubic) if law.cubic else ()
        found["stiffness"] = common.number(law.stiffness, *cubic)
        found["springref"] = common.number(law.rest)
    if law.damping or law.quadratic_damping:
        square = (law.quadratic_damping,) if law.quadratic_damping else ()
        found["damping"] = common.number(law.damping, *square)
    if law.friction:
        found["frictionloss"] = common.number(law.friction)
    return found


def _sites(source: Source, nodes: list[ET.Element]) -> None:
    for k, element in enumerate(source.elements):
        row = [value for name, value in element.numbers.items() if name not in ("x", "y")]
        user = [float(KINDS.index(element.kind)), *row]
        ET.SubElement(
            nodes[element.link], "site", name=f"{PREFIX}{k}", pos=_point(source, *element.at),
            user=common.number(*user), size="0.002",
        )  # fmt: skip


def _wires(source: Source, nodes: list[ET.Element], root: ET.Element) -> None:
    """Wire and spring as a spatial tendon: its path is ``D`` and a constant, so the law is exact."""
    wires = [(i, link) for i, link in enumerate(source.links) if _wire(source, link) is not None]
    if not wires:
        return
    tendons = ET.SubElement(root, "tendon")
    for i, link in wires:
        law = _wire(source, link)
        assert law is not None
        assert link.joint is not None
        name = link.joint.name
        # tension K_t (D + constant): a path longer by the constant, or a rest length
        constant = law.pretension - law.arm + law.crank
        parent, x, y = nodes[link.parent], *link.at
        ET.SubElement(parent, "site", name=f"{name}:wire", pos=_point(source, x + law.arm, y), size="0.001")
        c, s = math.cos(link.mount_rad), math.sin(link.mount_rad)
        crank = _point(source, law.crank * c, -law.crank * s)
        ET.SubElement(nodes[i], "site", name=f"{name}:crank", pos=crank, size="0.001")
        tendon = ET.SubElement(
            tendons, "spatial", name=f"{name}:wire", stiffness=common.number(law.spring),
            springlength=common.number(max(-constant, 0.0)), width="0.0005",
        )  # fmt: skip
        if constant > 0.0:
            spool = _point(source, x + law.arm, y + constant)
            ET.SubElement(parent, "site", name=f"{name}:spool", pos=spool, size="0.001")
            ET.SubElement(tendon, "site", site=f"{name}:spool")
        ET.SubElement(tendon, "site", site=f"{name}:wire")
        ET.SubElement(tendon, "site", site=f"{name}:crank")


def _wire(source: Source, link: Link) -> Law | None:
    law = source.laws.get(link.joint.name) if link.joint else None
    return law if law is not None and law.spring else None


def _servos(source: Source, inertias: list[Any], root: ET.Element, default_hz: float) -> None:
    if not source.assembly.driven:
        return
    moments = behind_joint(source.links, inertias)
    actuators = ET.SubElement(root, "actuator")
    for axis in source.assembly.driven:
        omega, ratio = source.servo(axis.joint, default_hz)
        moment = moments[axis.link]
        ET.SubElement(
            actuators, "position", name=axis.joint.name, joint=axis.joint.name,
            kp=common.number(moment * omega**2), kv=common.number(2.0 * ratio * omega * moment),
        )  # fmt: skip


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = common.added_mass_limits(source, options.added_mass)
    wet = [link.name for link in source.links if np.any(link.added)]
    if options.added_mass == "native" and wet:
        limits.append(
            "MuJoCo has no added-mass inertia (its ellipsoid model neither): added mass and inertia of "
            f"{', '.join(wet)} are left out; --added-mass fold puts them into the bodies"
        )
    kinds = {e.kind for e in source.elements}
    words = {
        "drag": "Morison drag at points",
        "foil": "lift and drag of foils",
        "force": "weight, buoyancy and forces",
        "wake": "momentum shed at trailing edges",
    }
    if kinds:
        what = ", ".join(words[k] for k in KINDS if k in kinds)
        limits.append(
            f"{what}: MuJoCo's fluid models have no such law; the numbers stand at sites and act once "
            "swimid.exporters.mjcf.water is installed as passive callback"
        )
    limits += common.friction_limits(source)
    limits += common.drive_limits(source, options.servo_hz)
    limits.append(common.NO_ERRORS)
    return limits


def water(model: Any) -> Callable[[Any, Any], None]:
    """A passive callback that lets the exported water act: drag, foils, weight, forces, trailing edges.

    Parameters
    ----------
    model : mujoco.MjModel
        Loaded from an exported file. Another model simulated meanwhile is left alone.

    Returns
    -------
    callable
        For ``mujoco.set_mjcb_passive``.

    Notes
    -----
    Install it after loading: MuJoCo compiles no model while a Python callback is set.

    The laws are those of :func:`swimid.swimmer.planar.engine.derivative`: Morison drag along each
    axis (tendon fish, Eq 7), a flat plate's lift and drag (dolphin, Eq 9) and momentum shed at trailing
    edges (Lighthill 1971).
    """
    import mujoco  # type: ignore[import-not-found,import-untyped,unused-ignore]

    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, i) or "" for i in range(model.nsite)]
    sites = [i for i, name in enumerate(names) if name.startswith(PREFIX)]
    rows = [np.array(model.site_user[i]) for i in sites]
    plane = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "swimid_plane")
    begin, size = int(model.text_adr[plane]), int(model.text_size[plane])
    upright = bytes(model.text_data)[begin : begin + size].rstrip(b"\0") == b"vertical"
    side, turn, sign = (2, 1, -1.0) if upright else (1, 2, 1.0)
    six = np.zeros(6)

    def passive(given: Any, data: Any) -> None:
        if given.nsite != model.nsite or given.nv != model.nv:
            return
        for site, row in zip(sites, rows, strict=True):
            mujoco.mj_objectVelocity(given, data, mujoco.mjtObj.mjOBJ_SITE, site, six, 1)
            fx, fy, moment, world = _push(row, six[3], six[3 + side], sign * six[turn])
            force, torque = np.zeros(3), np.zeros(3)
            force[0], force[side] = fx, fy
            torque[turn] = sign * moment
            if not world:
                axes = data.site_xmat[site].reshape(3, 3)
                force, torque = axes @ force, axes @ torque
            owner = given.site_bodyid[site]
            mujoco.mj_applyFT(given, data, force, torque, data.site_xpos[site], owner, data.qfrc_passive)

    return passive


def _push(row: Any, u: float, v: float, r: float) -> tuple[float, float, float, bool]:
    """Force along and across the link and moment of one site; whether it is in the world's axes."""
    kind = KINDS[int(row[0])]
    if kind == "drag":
        qx, qy, lx, ly, qr, lr = row[1:7]
        return -(qx * abs(u) + lx) * u, -(qy * abs(v) + ly) * v, -(qr * abs(r) + lr) * r, False
    if kind == "force":
        return row[1], row[2], 0.0, bool(row[3])
    if kind == "wake":
        return row[1] * v * v, -2.0 * row[1] * max(u, 0.0) * v, 0.0, False
    gain, lift, drag0, drag1, cos, sin = row[1:7]
    speed = math.hypot(u, v)
    if speed == 0.0:
        return 0.0, 0.0, 0.0, False
    # angle of attack a: sin(2 a) and 1 - cos(2 a)
    along, across = (u * cos + v * sin) / speed, (v * cos - u * sin) / speed
    up, back = gain * speed * lift * 2.0 * along * across, gain * speed * (drag0 + drag1 * 2.0 * across**2)
    return up * v - back * u, -up * u - back * v, 0.0, False
