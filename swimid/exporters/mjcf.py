"""Export to MuJoCo MJCF: bodies, joints, springs, wires and servos; a callback for the forces of water.

The fluid models of MuJoCo have no added-mass inertia. Their drag acts along the velocity, and not separately
along and across the link. Therefore the coefficients of the forces of the water are written as ``user`` data
of sites, and :func:`water` applies these forces exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from swimid.exporters.options import ExportOptions
from swimid.exporters.source import COLUMNS, Element, Exported, Source, central, export_xml

TITLE = "MuJoCo MJCF"
#: Kinds of force elements, with their names in the limits of an export. Their order gives the index that the
#: user data of a MuJoCo site contain.
KINDS = {
    "drag": "Morison drag at points",
    "foil": "lift and drag of foils",
    "force": "weight, buoyancy and forces",
    "wake": "momentum shed at trailing edges",
}
#: Number of user data values of a MuJoCo site: the index of the kind of element, then the values of the
#: element without its point of application.
USER_SIZE = 1 + max(len(columns) for columns in COLUMNS.values()) - 2
#: Prefix of the names of the MuJoCo sites whose user data :func:`water` reads.
PREFIX = "water:"


def export(source: Source, options: ExportOptions) -> Exported:
    """Return the MJCF document of a multi-link robot, and the effects that it cannot represent."""
    inertias = source.inertias(fold=options.added_mass == "fold")
    wet = ", ".join(link.name for link in source.links if np.any(link.added))
    native = (
        "MuJoCo has no added-mass inertia (its ellipsoid model neither): added mass and inertia of "
        f"{wet} are left out; --added-mass fold puts them into the bodies"
    )
    laws, limits = ", ".join(words for kind, words in KINDS.items() if source.links_with(kind)), []
    if laws:
        limits.append(
            f"{laws}: MuJoCo's fluid models have no such law; the numbers stand at sites and act once "
            "swimid.exporters.mjcf.water is installed as passive callback"
        )
    return export_xml(
        "mjcf.xml",
        source,
        options,
        native,
        limits,
        point=lambda x, y: (x, 0.0, y) if source.vertical else (x, y, 0.0),
        rigid=[central(inertia) for inertia in inertias],
        user=_user,
        user_size=USER_SIZE,
        prefix=PREFIX,
        wires=_wires(source),
        servos=source.servos(inertias, options.servo_hz),
    )


def _user(element: Element) -> list[float]:
    """Return the user data of a MuJoCo site: index of the kind of element, and coefficients of its force."""
    row = [value for name, value in element.numbers.items() if name not in ("x", "y")]
    return [list(KINDS).index(element.kind), *row]


def _wires(source: Source) -> list[dict[str, Any]]:
    """Return a spatial tendon for each joint that has a wire and a spring.

    The tension of the wire is ``K_t (D + constant)``, where D is the distance between the ends of the wire.
    If the constant is positive, the path of the tendon is extended by it. Otherwise the tendon has a rest
    length. The restoring moment is therefore exact at every angle.
    """
    wires = []
    owners = {link.joint.name: (i, link) for i, link in enumerate(source.links) if link.joint}
    for name, law in source.laws.items():
        if not law["spring"]:
            continue
        i, link = owners[name]
        arm, crank = law["arm"], law["crank"]
        constant = law["pretension"] - arm + crank
        (x, y), c, s = link.at, math.cos(link.mount_rad), math.sin(link.mount_rad)
        ends = [("wire", link.parent, (x + arm, y)), ("crank", i, (crank * c, -crank * s))]
        path = ["wire", "crank"]
        if constant > 0.0:
            ends.append(("spool", link.parent, (x + arm, y + constant)))
            path.insert(0, "spool")
        length = max(-constant, 0.0)
        wires.append({"name": name, "stiffness": law["spring"], "length": length, "ends": ends, "path": path})
    return wires


def water(model: Any) -> Callable[[Any, Any], None]:
    """Return a passive callback that applies drag, foils, weight, forces and trailing edges of an export.

    Parameters
    ----------
    model : mujoco.MjModel
        Model loaded from an exported file. The callback does nothing for other models.

    Returns
    -------
    callable
        Callback for ``mujoco.set_mjcb_passive``.

    Notes
    -----
    Install the callback after loading the model, because MuJoCo compiles no model while a Python callback is
    set.

    The forces are those of :func:`swimid.swimmer.planar.engine.derivative`: Morison drag along each axis
    (tendon fish, Eq 7), lift and drag of a flat plate (dolphin, Eq 9) and momentum shed at trailing edges
    (Lighthill 1971).
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
            fx, fy, moment, world = _force(row, six[3], six[3 + side], sign * six[turn])
            force, torque = np.zeros(3), np.zeros(3)
            force[0], force[side] = fx, fy
            torque[turn] = sign * moment
            if not world:
                axes = data.site_xmat[site].reshape(3, 3)
                force, torque = axes @ force, axes @ torque
            owner = given.site_bodyid[site]
            mujoco.mj_applyFT(given, data, force, torque, data.site_xpos[site], owner, data.qfrc_passive)

    return passive


def _force(row: Any, u: float, v: float, r: float) -> tuple[float, float, float, bool]:
    """Return the force of an element, its moment, and whether the force is in world axes.

    Otherwise the force is along and across the link.

    ``row`` is the data of a site. u, v and r are the velocities of the site in m/s and rad/s.
    """
    kind = list(KINDS)[int(row[0])]
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
    # lift and drag of a flat plate depend on sin(2 a) and 1 - cos(2 a), where a is the angle of attack
    along, across = (u * cos + v * sin) / speed, (v * cos - u * sin) / speed
    up, back = gain * speed * lift * 2.0 * along * across, gain * speed * (drag0 + drag1 * 2.0 * across**2)
    return up * v - back * u, -up * u - back * v, 0.0, False
