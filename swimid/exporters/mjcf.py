"""MuJoCo MJCF: bodies, joints, springs, wires and servos; the water by a callback.

MuJoCo's own fluid models have no added-mass inertia, and their drag acts along the velocity
instead of separately along and across the link. What the water does is therefore written into
sites (``user`` data), from which :func:`water` applies it exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import (
    NO_ERRORS,
    Element,
    Exported,
    Law,
    Link,
    Source,
    added_mass_limits,
    bodies,
    central,
    document,
    joint_limits,
)
from swimid.swimmer.planar import engine

#: Numbers a site holds: its kind, then the row of its table without the point.
KINDS = ("drag", "foil", "force", "wake")
USER = 1 + max(len(engine.DRAG), len(engine.FOIL), len(engine.FORCE), len(engine.WAKE)) - 2
PREFIX = "water:"


def export(source: Source, options: ExportOptions) -> Exported:
    """MJCF of a multi-link robot; see :class:`swimid.exporters.export.Target`."""
    limits = _limits(source, options)
    inertias = bodies(source, fold=options.added_mass == "fold")
    text = document(
        "mjcf.xml",
        source,
        limits,
        point=lambda x, y: (x, 0.0, y) if source.vertical else (x, y, 0.0),
        rigid=[central(inertia) for inertia in inertias],
        user=_user,
        user_size=USER,
        prefix=PREFIX,
        wires=[_wire(link, i, law) for i, link, law in _wired(source)],
        servos=source.servos(inertias, options.servo_hz),
    )
    return Exported(text, limits)


def _user(element: Element) -> list[float]:
    """The kind of an element's site, and the numbers of its law."""
    row = [value for name, value in element.numbers.items() if name not in ("x", "y")]
    return [KINDS.index(element.kind), *row]


def _wired(source: Source) -> Iterator[tuple[int, Link, Law]]:
    """The links pulled straight by wire and spring."""
    for i, link in enumerate(source.links):
        law = source.laws.get(link.joint.name) if link.joint else None
        if law is not None and law.spring:
            yield i, link, law


def _wire(link: Link, i: int, law: Law) -> dict[str, Any]:
    """Wire and spring as a spatial tendon: its path is ``D`` and a constant, so the law is exact."""
    assert link.joint is not None
    # tension K_t (D + constant): a path longer by the constant, or a rest length
    constant = law.pretension - law.arm + law.crank
    (x, y), c, s = link.at, math.cos(link.mount_rad), math.sin(link.mount_rad)
    ends = [("wire", link.parent, (x + law.arm, y)), ("crank", i, (law.crank * c, -law.crank * s))]
    if constant > 0.0:
        ends.append(("spool", link.parent, (x + law.arm, y + constant)))
    return {
        "name": link.joint.name,
        "stiffness": law.spring,
        "length": max(-constant, 0.0),
        "ends": ends,
        "path": [*(["spool"] if constant > 0.0 else []), "wire", "crank"],
    }


def _limits(source: Source, options: ExportOptions) -> list[str]:
    limits = added_mass_limits(source, options.added_mass)
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
    return [*limits, *joint_limits(source, options.servo_hz), NO_ERRORS]


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
