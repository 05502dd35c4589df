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
from swimid.exporters.common import Exported, node, number
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import Link, Source, behind_joint, central
from swimid.fitting.model import Array
from swimid.swimmer.planar import engine

#: Numbers a site holds: its kind, then the row of its table without the point.
KINDS = ("drag", "foil", "force", "wake")
USER = 1 + max(len(engine.DRAG), len(engine.FOIL), len(engine.FORCE), len(engine.WAKE)) - 2
PREFIX = "water:"


def export(source: Source, options: ExportOptions) -> Exported:
    """MJCF of a multi-link robot; see :class:`swimid.exporters.Target`."""
    limits = _limits(source, options)
    inertias = common.bodies(source, fold=options.added_mass == "fold")
    bodies = _bodies(source, inertias)
    _sites(source, bodies)
    tendons = _wires(source, bodies)
    servos = _servos(source, inertias, options.servo_hz)
    root = node(
        "mujoco",
        node("compiler", angle="radian", autolimits="true"),
        node("option", timestep=0.002, integrator="implicitfast", gravity="0 0 0", density="0"),
        node("size", nuser_site=str(USER)),
        node("custom", node("text", name="swimid_plane", data=source.body.plane)),
        node("worldbody", bodies[0]),
        node("tendon", *tendons) if tendons else None,
        node("actuator", *servos) if servos else None,
        model=source.robot.name,
    )
    return Exported(common.document(root, source, limits), limits)


def _point(source: Source, x: float, y: float) -> tuple[float, float, float]:
    return (x, 0.0, y) if source.vertical else (x, y, 0.0)


def _axis(source: Source) -> str:
    # positive from the x axis towards the link's upper or port side
    return "0 -1 0" if source.vertical else "0 0 1"


def _turned(source: Source, angle: float) -> str | None:
    return f"{_axis(source)} {number(angle)}" if angle else None


def _bodies(source: Source, inertias: list[Array]) -> list[ET.Element]:
    """The links as bodies, each within its parent."""
    side = "0 0 1" if source.vertical else "0 1 0"
    names = ("base_x", "base_z", "base_pitch") if source.vertical else ("base_x", "base_y", "base_yaw")
    free = source.body.base == "free"
    bodies: list[ET.Element] = []
    for link, inertia in zip(source.links, inertias, strict=True):
        base = link.parent < 0
        turn = link.mount_rad if not base else 0.0 if free else math.radians(source.body.heading_deg)
        mass, centre, moment = central(inertia)
        body = node(
            "body",
            node("inertial", pos=_point(source, *centre), mass=mass, diaginertia=(moment, moment, moment)),
            name=link.name,
            pos="0 0 0" if base else _point(source, *link.at),
            axisangle=_turned(source, turn),
        )
        if base and free:
            body.append(node("joint", name=names[0], type="slide", axis="1 0 0"))
            body.append(node("joint", name=names[1], type="slide", axis=side))
            body.append(node("joint", name=names[2], type="hinge", axis=_axis(source)))
        if link.moves:
            body.append(_hinge(source, link))
        end = f"0 0 0 {number(-link.length_m, 0.0, 0.0)}"
        look = {"type": "capsule", "size": number(0.05 * link.length_m), "mass": "0", "fromto": end}
        body.append(node("geom", **look, contype="0", conaffinity="0"))
        if not base:
            bodies[link.parent].append(body)
        bodies.append(body)
    return bodies


def _hinge(source: Source, link: Link) -> ET.Element:
    assert link.joint is not None
    hinge = {"name": link.joint.name, "type": "hinge", "axis": _axis(source)}
    law = source.laws.get(link.joint.name)
    if law is None:
        return node("joint", **hinge)
    sprung, damped = law.stiffness or law.cubic, law.damping or law.quadratic_damping
    # the third number is the cubic term
    cubic = (0.0, law.cubic) if law.cubic else ()
    square = (law.quadratic_damping,) if law.quadratic_damping else ()
    return node(
        "joint",
        **hinge,
        stiffness=(law.stiffness, *cubic) if sprung else None,
        springref=law.rest if sprung else None,
        damping=(law.damping, *square) if damped else None,
        frictionloss=law.friction or None,
    )


def _sites(source: Source, bodies: list[ET.Element]) -> None:
    for k, element in enumerate(source.elements):
        row = [value for name, value in element.numbers.items() if name not in ("x", "y")]
        user, place = [KINDS.index(element.kind), *row], _point(source, *element.at)
        bodies[element.link].append(node("site", name=f"{PREFIX}{k}", pos=place, user=user, size=0.002))


def _wires(source: Source, bodies: list[ET.Element]) -> list[ET.Element]:
    """Wire and spring as a spatial tendon: its path is ``D`` and a constant, so the law is exact."""
    tendons = []
    for body, link in zip(bodies, source.links, strict=True):
        law = source.laws.get(link.joint.name) if link.joint else None
        if law is None or not law.spring:
            continue
        assert link.joint is not None
        name = link.joint.name
        # tension K_t (D + constant): a path longer by the constant, or a rest length
        constant = law.pretension - law.arm + law.crank
        parent, x, y = bodies[link.parent], *link.at
        c, s = math.cos(link.mount_rad), math.sin(link.mount_rad)
        ends = {"wire": (parent, x + law.arm, y), "crank": (body, law.crank * c, -law.crank * s)}
        path = ["wire", "crank"]
        if constant > 0.0:
            ends["spool"] = (parent, x + law.arm, y + constant)
            path = ["spool", *path]
        for end, (owner, *place) in ends.items():
            owner.append(node("site", name=f"{name}:{end}", pos=_point(source, *place), size=0.001))
        sites, slack = [node("site", site=f"{name}:{end}") for end in path], max(-constant, 0.0)
        wire = node("spatial", *sites, name=f"{name}:wire", stiffness=law.spring, springlength=slack)
        wire.set("width", "0.0005")
        tendons.append(wire)
    return tendons


def _servos(source: Source, inertias: list[Array], default_hz: float) -> list[ET.Element]:
    moments = behind_joint(source.links, inertias)
    servos = []
    for axis in source.assembly.driven:
        omega, ratio = source.servo(axis.joint, default_hz)
        moment, name = moments[axis.link], axis.joint.name
        gains = {"kp": moment * omega**2, "kv": 2.0 * ratio * omega * moment}
        servos.append(node("position", name=name, joint=name, **gains))
    return servos


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
