"""Export of a robot to MuJoCo (MJCF), and a callback that applies the forces of the water in MuJoCo.

The MJCF document has bodies, joints, springs, wires and servos. The fluid models of MuJoCo have no added-mass
inertia. Their drag acts along the velocity, and not separately along and across the link. Therefore the
coefficients of the forces of the water are written as ``user`` data of sites, and the callback :func:`water`
applies these forces exactly. A MuJoCo body has the same mass in all directions. If the added mass differs by
direction, the body gets its mean, and the callback adds the remainder to MuJoCo's mass matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from swimid.effects.catalogue import list_effects
from swimid.exporters.causes import ExportedCause, filter_arguments
from swimid.exporters.options import ExportOptions
from swimid.exporters.source import COLUMNS, Exported, ExportedElement, ExportSource, central, export_xml
from swimid.fitting.model import TRACEABLE, ExternalForce
from swimid.notices import record_warnings
from swimid.swimmer.tree import SYMMETRIC

TITLE = "MuJoCo MJCF"
#: Kinds of force elements, each with its description in a warning. The position of a kind in this list is the
#: index of the kind in the user data of a MuJoCo site.
KINDS = {
    "drag": "Morison drag at points",
    "foil": "lift and drag of foils",
    "force": "weight, buoyancy and forces",
    "wake": "momentum shed at trailing edges",
}
#: Number of user data values of a MuJoCo site. The values are the index of the kind of force element, and the
#: coefficients of the element without its point of application. A site for the force of an effect has the
#: constants of this force instead.
USER_SIZE = 1 + max(len(columns) for columns in COLUMNS.values()) - 2
#: Prefixes of the names of the MuJoCo sites whose user data the callback :func:`water` reads. The first
#: prefix is for force elements, and the second for forces of effects. The name of the force's function
#: follows the second.
PREFIX, CAUSE = "water:", "water:cause:"
#: Prefix of the names of the MuJoCo sites whose user data are an added mass that differs by direction: the
#: upper triangle of :attr:`swimid.exporters.source.ExportedLink.directional`, row by row.
MASS_PREFIX = "mass:"
#: Beat with which an exported model is compared with swimid.
COMPARED = {"frequency_hz": 1.0, "amplitude_deg": 20.0, "duration_s": 6.0}
#: Time step of the exported MuJoCo model, s.
MJCF_STEP_S = 0.002
#: Two parts of the half-width of the play of a servo, as fractions. The first part is the range of an
#: additional hinge. The second is the angle by which the dry friction in this hinge deflects the servo.
PLAY_RANGE, PLAY_HELD = 0.9, 0.1


#: Functions that compute settings of the MuJoCo actuator of a driven joint from the arguments of the command
#: filter of an effect (:data:`swimid.exporters.causes.FILTERS`). The key is the name of the effect.
SERVO_SETTINGS: dict[str, Callable[[Mapping[str, float]], Mapping[str, float]]] = {
    "amplitude-loss": lambda values: {"gain": 1.0 - values["loss"]},
    "amplitude-offset": lambda values: {"offset_rad": values["offset_rad"]},
    "joint-locked": lambda values: {"gain": 1.0 - values["lock"]},
    "rate-limit": lambda values: {"rate_rad_s": values["rate_limit_rad_s"]},
    "servo-backlash": lambda values: {"play_rad": values["backlash_rad"]},
    "servo-delay": lambda values: {"delay_s": values["delay_s"]},
    "servo-lag": lambda values: {"lag_s": values["time_constant_s"]},
}
#: Settings that a MuJoCo actuator with a limited rate cannot have.
NOT_WITH_RATE = {"gain", "lag_s", "offset_rad"}


def export(source: ExportSource, options: ExportOptions) -> Exported:
    """Return the MJCF document of a multi-link robot, and sentences on what MJCF cannot represent."""
    fold = options.added_mass == "fold"
    inertias = source.inertias(fold=fold)
    directional = [fold * link.directional for link in source.links]
    carried = list(np.add(inertias, directional))
    wet = ", ".join(link.name for link in source.links if np.any(link.added))
    native = (
        "MuJoCo has no added-mass inertia (its ellipsoid model neither): added mass and inertia of "
        f"{wet} are left out; --added-mass fold puts them into the bodies"
    )
    settings, filtered = _settings(source)
    actuators = [
        _actuator(servo, own)
        for servo, own in zip(source.servos(carried, options.servo_hz), settings, strict=True)
    ]
    return export_xml(
        "mjcf.xml",
        source,
        options,
        native,
        _limits(source),
        filtered,
        forces=True,
        step_s=MJCF_STEP_S,
        point=lambda x, y: (x, 0.0, y) if source.vertical else (x, y, 0.0),
        rigid=[central(inertia) for inertia in inertias],
        directional=[mass[np.triu_indices(3)] for mass in directional],
        mass_prefix=MASS_PREFIX,
        user=_user,
        user_size=max([USER_SIZE, *(len(force.constants) for _, force in source.forces)]),
        prefix=PREFIX,
        forces_of_causes=[(_site(force), force) for _, force in source.forces],
        wires=_wires(source),
        actuators=actuators,
        plays={play["joint"]: play for play in (one["play"] for one in actuators) if play},
    )


def _limits(source: ExportSource) -> list[str]:
    """Return a sentence on the forces that MuJoCo applies only with the callback, if there are any."""
    laws = [words for kind, words in KINDS.items() if source.links_with(kind)]
    laws += [cause.name for cause in source.causes if cause.hooks.force or cause.hooks.flow]
    if not laws:
        return []
    return [
        f"{', '.join(laws)}: MuJoCo's fluid models have no such law; the coefficients are stored at sites, "
        "and the forces act if swimid.exporters.mjcf.water is installed as passive callback"
    ]


def _site(force: ExternalForce) -> str:
    """Return the name of the MuJoCo site at which the force of an effect acts."""
    return CAUSE + next(name for name, known in TRACEABLE.items() if known.function is force.function)


def _settings(source: ExportSource) -> tuple[list[dict[str, float]], list[ExportedCause]]:
    """Return the MuJoCo settings of the actuator of each driven joint, and the effects that need a filter.

    MuJoCo applies delay, lag, gain and play in this order. An effect needs a filter of the commands if MuJoCo
    has no such setting, or if an earlier effect already uses the setting or excludes it. If several joints
    follow one actuator, every effect needs a filter, because it acts on the actuator and not on the joints.
    """
    settings: list[dict[str, float]] = [{} for _ in source.assembly.driven]
    filtered = []
    for cause in [cause for cause in source.causes if cause.hooks.command]:
        own = _settings_of(source, cause)
        names, taken = (set().union(*many) for many in (own, settings))
        limited = "rate_rad_s" in names | taken
        if not own or names & taken or (limited and (names | taken) & NOT_WITH_RATE):
            filtered.append(cause)
            continue
        for known, new in zip(settings, own, strict=True):
            known.update(new)
    return settings, filtered


def _settings_of(source: ExportSource, cause: ExportedCause) -> list[Mapping[str, float]]:
    """Return the settings of each actuator that represent an effect; empty if MuJoCo has no such setting."""
    if cause.name not in SERVO_SETTINGS or source.transmissions:
        return []
    given = [filter_arguments(cause, actuator, source.model) for actuator in source.assembly.actuators]
    return [values and SERVO_SETTINGS[cause.name](values) for values in given]


def _actuator(servo: dict[str, Any], own: dict[str, float]) -> dict[str, Any]:
    """Return the description of the MuJoCo actuator that moves a driven joint as a servo.

    The keys ``tag`` and ``attributes`` describe its XML element. The key ``play`` describes an additional
    hinge between the servo and the joint, and is None for a servo without play.
    """
    stiffness, damping, joint = servo["stiffness"], servo["damping"], servo["joint"]
    attributes: dict[str, Any] = {"name": joint, "joint": joint}
    tag, play = "position", None
    if "play_rad" in own:
        half, attributes["joint"] = 0.5 * own["play_rad"], f"{joint}_servo"
        play = {
            "joint": joint,
            "servo": f"{joint}_servo",
            "range": [-PLAY_RANGE * half, PLAY_RANGE * half],
            "friction": PLAY_HELD * half * stiffness,
            # State the moment of inertia of the carried bodies for the body between servo and joint, because
            # a constraint between bodies of very different inertia is soft in MuJoCo.
            "moment": servo["moment"],
        }
    if "delay_s" in own:
        samples = str(math.ceil(own["delay_s"] / MJCF_STEP_S))
        attributes |= {"nsample": samples, "interp": "linear", "delay": own["delay_s"]}
    if "rate_rad_s" in own:
        tag, attributes["input"] = "pid", "pos"
        attributes |= {"kp": stiffness, "kv": damping, "slewmax": own["rate_rad_s"]}
    elif own.keys() & NOT_WITH_RATE:
        tag = "general"
        if "lag_s" in own:
            attributes |= {"dyntype": "filterexact", "dynprm": own["lag_s"]}
        attributes["gainprm"] = stiffness * own.get("gain", 1.0)
        offset = stiffness * own.get("offset_rad", 0.0)
        attributes |= {"biastype": "affine", "biasprm": [offset, -stiffness, -damping]}
    else:
        attributes |= {"kp": stiffness, "kv": damping}
    return {"tag": tag, "attributes": attributes, "play": play}


def _user(element: ExportedElement) -> list[float]:
    """Return the user data of the MuJoCo site of a force element: index of its kind, and coefficients."""
    row = [value for name, value in element.numbers.items() if name not in ("x", "y")]
    return [list(KINDS).index(element.kind), *row]


def _wires(source: ExportSource) -> list[dict[str, Any]]:
    """Return a MuJoCo spatial tendon for each passive joint that has a wire with a spring.

    The tension of the wire is ``K_t (D + constant)``, where D is the distance between the ends of the wire.
    If the constant is positive, the path of the tendon is longer than D by the constant. If not, the tendon
    has a rest length. The restoring moment is therefore exact at every angle.
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


def compare_with_mujoco(source: ExportSource, params: Any, text: str) -> dict[str, float] | None:
    """Return the difference between MuJoCo with an exported file and swimid after a swim.

    Both simulate the beat :data:`COMPARED`. MuJoCo uses the callback :func:`water`. The result is None if
    MuJoCo is not installed, and for a robot with causes, without a driven joint, or with a fixed base.

    Returns
    -------
    dict or None
        ``difference_m``: distance between the two reference points at the end, m. ``way_m``: length of the
        path in swimid, m.
    """
    try:
        import mujoco
    except ImportError:
        return None
    from swimid.simulation.simulate import simulate

    columns = [axis.column for axis in source.model.driven]
    if source.causes or not columns or not source.model.free_base:
        return None
    with record_warnings():
        log = simulate(params=params, sample_rate_hz=1.0 / MJCF_STEP_S, **COMPARED).frame
    before = mujoco.get_mjcb_passive()
    mujoco.set_mjcb_passive(None)
    model = mujoco.MjModel.from_xml_string(text)
    data, side = mujoco.MjData(model), 2 if source.vertical else 1
    along, across = model.numeric("swimid_reference").data
    angles = log[columns].to_numpy()
    mujoco.set_mjcb_passive(water(model))
    try:
        for k in range(len(log) - 1):
            data.ctrl[: len(columns)] = 0.5 * (angles[k] + angles[k + 1])
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
    finally:
        mujoco.set_mjcb_passive(before)
    base = data.xmat[1].reshape(3, 3)
    place = (data.xpos[1] + along * base[:, 0] + across * base[:, side])[[0, side]]
    track = log[list(source.model.pose[:2])].to_numpy()
    start = np.array([along, across])
    off = (place - start) - (track[-1] - track[0])
    return {"difference_m": float(np.hypot(*off)), "way_m": float(np.hypot(*(track[-1] - track[0])))}


def water(model: Any) -> Callable[[Any, Any], None]:
    """Return a MuJoCo callback that applies the forces of the water and the weight to an exported robot.

    The forces are those of drag, foils, trailing edges, buoyancy, constant forces and effects. If the added
    mass is folded into the bodies, the callback also adds its direction-dependent part to the mass matrix.

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

    The forces are those of :func:`swimid.swimmer.planar.engine.compute_planar_rate`: Morison drag along each
    axis (tendon fish, Eq 7), lift and drag of a flat plate (dolphin, Eq 9) and momentum shed at trailing
    edges (Lighthill 1971). The forces of effects are the functions in :mod:`swimid.effects`. The water moves
    with the ``wind`` of the model.
    """
    return _Water(model)


class _Water:
    """Callback of :func:`water`, with the sites of a model that carry forces and masses."""

    def __init__(self, model: Any) -> None:
        import mujoco  # type: ignore[import-not-found,import-untyped,unused-ignore]

        self._mujoco, self._model = mujoco, model
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, i) or "" for i in range(model.nsite)]
        rows = list(zip(range(model.nsite), names, np.array(model.site_user), strict=True))
        self._laws = [(site, _law(name, row)) for site, name, row in rows if name.startswith(PREFIX)]
        self._masses = [(site, row[SYMMETRIC]) for site, name, row in rows if name.startswith(MASS_PREFIX)]
        plane = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "swimid_plane")
        begin, size = int(model.text_adr[plane]), int(model.text_size[plane])
        upright = bytes(model.text_data)[begin : begin + size].rstrip(b"\0") == b"vertical"
        self._side, self._turn, self._sign = (2, 1, -1.0) if upright else (1, 2, 1.0)
        self._along, self._across = (model.numeric("swimid_reference").data[k] for k in (0, 1))
        self._six, self._pose, self._moves = np.zeros(6), np.zeros(3), np.zeros((4, 3, model.nv))

    def __call__(self, given: Any, data: Any) -> None:
        """Apply forces and masses to the MuJoCo data of a model that is equal to the loaded model."""
        if given.nsite != self._model.nsite or given.nv != self._model.nv:
            return
        self._apply_forces(given, data)
        if self._masses:
            self._add_masses(given, data)

    def _apply_forces(self, given: Any, data: Any) -> None:
        """Add the forces at the sites to the passive forces."""
        mujoco, side, six, pose = self._mujoco, self._side, self._six, self._pose
        base = data.xmat[1].reshape(3, 3)
        pose[:2] = (data.xpos[1] + self._along * base[:, 0] + self._across * base[:, side])[[0, side]]
        for site, law in self._laws:
            mujoco.mj_objectVelocity(given, data, mujoco.mjtObj.mjOBJ_SITE, site, six, 1)
            axes = data.site_xmat[site].reshape(3, 3)
            u, v = (six[3:] - axes.T @ given.opt.wind)[[0, side]]
            pose[2] = math.atan2(axes[side, 0], axes[0, 0])
            fx, fy, moment, world = law(data.time, pose, u, v, self._sign * six[self._turn])
            force, torque = np.zeros(3), np.zeros(3)
            force[0], force[side] = fx, fy
            torque[self._turn] = self._sign * moment
            if not world:
                force, torque = axes @ force, axes @ torque
            owner = given.site_bodyid[site]
            mujoco.mj_applyFT(given, data, force, torque, data.site_xpos[site], owner, data.qfrc_passive)

    def _add_masses(self, given: Any, data: Any) -> None:
        """Add direction-dependent added masses to the mass matrix, and their inertial loads to the forces."""
        mujoco, side, moves = self._mujoco, self._side, self._moves
        total, axes = np.zeros((given.nv, given.nv)), np.diag([0.0, 0.0, self._sign])
        for site, mass in self._masses:
            place = data.site_xpos[site], given.site_bodyid[site]
            mujoco.mj_jac(given, data, *moves[:2], *place)
            mujoco.mj_jacDot(given, data, *moves[2:], *place)
            axes[:2, :2] = data.site_xmat[site].reshape(3, 3)[np.ix_([0, side], [0, side])].T
            own, rate = axes @ moves.reshape(2, 6, -1)[:, [0, side, 3 + self._turn]]
            u, v, r = own @ data.qvel - axes @ np.append(given.opt.wind[[0, side]], 0.0)
            px, py, _ = mass @ (u, v, r)
            # Compute the load at zero joint accelerations, which is due to the rotation of the link axes.
            load = mass @ (rate @ data.qvel + (r * v, -r * u, 0.0)) + (-r * py, r * px, u * py - v * px)
            data.qfrc_passive -= own.T @ load
            total += own.T @ mass @ own
        # Compute the mass matrix of MuJoCo again, so that no mass is added twice at unchanged positions.
        mujoco.mj_makeM(given, data)
        data.M += total[np.repeat(np.arange(given.nv), given.M_rownnz), given.M_colind]
        mujoco.mj_factorM(given, data)


#: Type of a function that computes the force at a MuJoCo site. Its arguments are the time (s), the position
#: of the robot's reference point (m) with the heading of the link (rad), and the velocities u, v (m/s) and r
#: (rad/s) of the site relative to the water. It returns two components of the force (N), the moment (N m),
#: and whether they are in world axes.
Law = Callable[[float, Any, float, float, float], tuple[float, float, float, bool]]


def _law(name: str, row: Any) -> Law:
    """Return the function that computes the force at a MuJoCo site, given the site's name and user data."""
    if not name.startswith(CAUSE):
        return lambda time_s, pose, u, v, r: _force(row, u, v, r)
    # Call the catalogue to import the modules of all effects, which register the functions of their forces.
    list_effects()
    known = TRACEABLE[name.removeprefix(CAUSE)]
    constants = row[: known.constants]

    def law(time_s: float, pose: Any, u: float, v: float, r: float) -> tuple[float, float, float, bool]:
        wrench = np.zeros(3)
        known.function(time_s, pose, np.array([u, v, r]), constants, wrench)
        return float(wrench[0]), float(wrench[1]), float(wrench[2]), False

    return law


def _force(row: Any, u: float, v: float, r: float) -> tuple[float, float, float, bool]:
    """Compute the force of a force element at its MuJoCo site.

    Return the two components of the force (N), the moment (N m), and whether the components are in world axes
    or, if False, along and across the link. ``row`` is the user data of the site. u, v and r are
    the velocities of the site relative to the water in m/s and rad/s.
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
    # Compute lift and drag of a flat plate from sin(2 a) and 1 - cos(2 a), where a is the angle of attack.
    along, across = (u * cos + v * sin) / speed, (v * cos - u * sin) / speed
    up, back = gain * speed * lift * 2.0 * along * across, gain * speed * (drag0 + drag1 * 2.0 * across**2)
    return up * v - back * u, -up * u - back * v, 0.0, False
