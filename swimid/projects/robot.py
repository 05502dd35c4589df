"""Command ``swimid robot``: draft of a robot file from a file in MJCF or URDF.

The draft has links, joints, masses, inertias, springs, actuators and markers of the file. The drafted robot
and the model in MuJoCo are simulated without water with the same commands, and the difference is stated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.files import atomic, yamlio
from swimid.fitting.model import Array, SwimInput, Trial
from swimid.options import takes
from swimid.projects.options import RobotOptions
from swimid.results.result import Result
from swimid.robots.file import Robot, schema_of
from swimid.simulators.mjcf import HINGE, base_joints, compile_spec, element_name, mujoco, read_spec
from swimid.swimmer.planar.model import MultilinkModel

#: Root element of a file in MJCF or URDF.
ROOT = re.compile(r"<(mujoco|robot)[\s>]")
#: Part of a robot file that is drafted.
DRAFTED_PARTS = frozenset({"multilink"})
#: Simulations without water that compare a draft with MuJoCo: duration (s), time step (s), and frequency of
#: the commands (Hz).
COMPARED_S, STEP_S, COMPARED_HZ = 2.0, 5e-4, 1.0
#: Motions in these simulations: amplitude of the command of an actuator without a range (COMMAND), and joint
#: angle from which a robot without actuators is released, rad (RELEASED_RAD).
COMMAND, RELEASED_RAD = 0.2, 0.3
#: Initial velocity (m/s, m/s, rad/s) of a robot without joints in these simulations.
DRIFT = np.array([0.2, 0.1, 0.5])
#: Maximum difference of a coordinate between a draft and MuJoCo without water, relative to the range of the
#: coordinate. A draft within this limit counts as equal.
MAX_RELATIVE_DIFFERENCE = 1e-3
#: Maximum range of a coordinate that counts as constant, m or rad.
STILL_RANGE = 1e-6
#: Tolerance for parallel axes: maximum norm of the cross product of two unit vectors, and maximum deviation
#: of the magnitude of their scalar product from 1.
PARALLEL = 1e-6
#: Start values and bounds of the coefficients of the drafted forces of the water.
WATER = {
    "c_ma": (
        1.0,
        (0.0, 3.0),
        "added mass over that of an ellipsoid of equal extent",
        "Lamb 1932, section 114",
    ),
    "c_n": (
        1.2,
        (0.0, 6.0),
        "drag across a link, over its side area",
        "Hoerner 1965, chapter 3: flat plates",
    ),
    "c_x": (0.1, (0.0, 2.0), "drag along a link, over its front area", "Hoerner 1965, chapter 6: bodies"),
}


class DraftedRobot(Result):
    """Result of ``robot``. Its ``data`` has the questions, what the draft leaves out, and the differences.

    No command follows: a fit needs trials, which the draft does not know.
    """


@dataclass
class _Body:
    """Body of the file as a link of the draft: axes in the plane of motion, with x forward."""

    name: str
    number: int
    #: Front end and forward direction in the plane, in the world at the reference configuration.
    front: Array
    forward: Array
    length: float
    height: float
    width: float
    joint: int | None
    parent: _Body | None = None

    def local(self, point: Array) -> Array:
        """Return forward and sideward coordinates of a point of the plane from the front end, m."""
        side = np.array([-self.forward[1], self.forward[0]])
        return np.array([(point - self.front) @ self.forward, (point - self.front) @ side])


@takes(RobotOptions)
def robot(file: str | Path, *, options: RobotOptions, output: Path | None = None) -> DraftedRobot:
    """Draft a robot file from a file in MJCF or URDF.

    Parameters
    ----------
    file : path
        File in MJCF or URDF. The hinges of the robot must be parallel to each other.
    output : path, optional
        Robot file to write. Without it, the draft is only described.

    Returns
    -------
    DraftedRobot
        ``.data`` has the questions (``asks``), what the draft leaves out (``left_out``), and the largest
        difference of each coordinate from MuJoCo without water, as a fraction of its range (``differences``).

    Raises
    ------
    InputError
        If the file cannot be read, or the robot does not move in a plane.
    UsageError
        If MuJoCo is not installed.

    References
    ----------
    .. [1] H. Lamb, *Hydrodynamics*, 6th edition, 1932, section 114: added mass of ellipsoids.
    .. [2] S. F. Hoerner, *Fluid-Dynamic Drag*, 1965: drag coefficients to start from.

    Examples
    --------
    >>> made = robot("sample_logs/simulator/fish.xml")  # doctest: +SKIP
    >>> max(made.data["differences"].values()) < 1e-3  # doctest: +SKIP
    True
    """
    path = Path(file)
    if output is not None:
        atomic.check_writable(output, inputs=[path])
    draft, text, differences = _draft_robot(path, options)
    outputs = []
    if output is not None:
        atomic.write_text(output, text)
        outputs.append(output)
    data = {
        "robot": path.stem, "plane": draft.plane, "asks": draft.asks, "left_out": draft.left_out,
        "differences": differences,
    }  # fmt: skip
    return DraftedRobot("robot", _describe_draft(draft, differences), data, outputs)


def find_robot(folder: Path) -> tuple[Path, str, list[str]] | None:
    """Return the only file in MJCF or URDF in a folder, the robot file drafted from it, and its questions.

    The result is None if there is no such file, or several.

    Raises
    ------
    InputError
        If no robot file can be drafted from the file.
    """
    paths = [path for ending in ("xml", "urdf") for path in sorted(folder.rglob(f"*.{ending}"))]
    paths = [path for path in paths if ROOT.search(path.read_text(encoding="utf-8", errors="replace"))]
    if len(paths) != 1:
        return None
    draft, text, _ = _draft_robot(paths[0], RobotOptions())
    return paths[0], text, draft.asks


def _draft_robot(path: Path, options: RobotOptions) -> tuple[_Draft, str, dict[str, float]]:
    """Return the draft from a file, its text, and its differences from MuJoCo in motion without water."""
    draft = _Draft(path, options)
    document = draft.document()
    try:
        made = schema_of(DRAFTED_PARTS).model_validate(document)
    except ValueError as error:
        raise InputError(f"no robot file can be made from this file: {error}", file=path) from error
    differences = _compare(draft, made)
    return draft, draft.text(document, differences), differences


class _Draft:
    """Links, joints and forces of a robot file that is drafted from a file of MuJoCo."""

    def __init__(self, path: Path, options: RobotOptions) -> None:
        self.path, self.options = path, options
        self.asks: list[str] = []
        self.left_out: list[str] = []
        spec = read_spec(path)
        if path.suffix.lower() == ".urdf" and not options.fixed:
            self.asks.append("the root of a URDF is taken as free: --fixed holds it")
            root = spec.worldbody.first_body()
            if root is not None and not list(root.joints):
                root.add_freejoint()
        self.compiled = compile_spec(spec, path)
        self.data = mujoco().MjData(self.compiled)
        mujoco().mj_forward(self.compiled, self.data)
        self.base = base_joints(self.compiled)
        self.normal, self.plane = self._plane()
        #: World coordinates of the two axes of the plane: x, and y or z.
        self.axes = np.array([[1.0, 0.0, 0.0], np.cross(self.normal, [1.0, 0.0, 0.0])])
        self.free = bool(self.base)
        self.bodies = self._bodies()

    # ------------------------------------------------------------ geometry

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element, or a name made of its kind and index."""
        return element_name(self.compiled, kind, number) or f"{kind}{number}"

    def _hinges(self) -> list[int]:
        return [k for k in range(self.compiled.njnt) if k not in self.base]

    def _plane(self) -> tuple[Array, str]:
        """Return the normal of the plane of motion, and the name of the plane.

        Raises
        ------
        InputError
            If the joints are no hinges, or their axes are not parallel.
        """
        axes = []
        for k in self._hinges():
            if self.compiled.jnt_type[k] != HINGE:
                text = (
                    f"the joint '{self.name('joint', k)}' is not a hinge; a robot file can have hinges only"
                )
                raise InputError(
                    text,
                    file=self.path,
                    hint="fit the MuJoCo file itself: write 'experiment: mjcf' in a trials file",
                )
            axes.append(self.data.xaxis[k])
        upright = np.array([0.0, 0.0, 1.0])
        if not axes:
            slides = [self.data.xaxis[k] for k in self.base if self.compiled.jnt_type[k] == HINGE]
            axes = slides or [upright]
        first = axes[0]
        if any(np.linalg.norm(np.cross(first, axis)) > PARALLEL for axis in axes):
            raise InputError(
                "the hinges are not parallel: the robot does not move in a plane",
                file=self.path,
                hint="fit the MuJoCo file itself ('experiment: mjcf'), or write a multibody robot file",
            )
        if abs(first @ upright) > 1.0 - PARALLEL:
            return upright, "horizontal"
        if abs(first @ np.array([0.0, 1.0, 0.0])) > 1.0 - PARALLEL:
            # x forward, z up: a positive turn goes from x to z
            return np.array([0.0, -1.0, 0.0]), "vertical"
        text = "the hinges are parallel to neither z nor y: turn the robot into the xy or the xz plane"
        raise InputError(text, file=self.path)

    def flat(self, point: Array) -> Array:
        """Return the coordinates of a point in the plane of motion."""
        return np.asarray(self.axes @ point)

    def _extent(self, body: int) -> Array:
        """Return the corners of the geometries of a body in world coordinates, shape (n, 3)."""
        geoms = np.flatnonzero(self.compiled.geom_bodyid == body)
        corners = [self.data.xpos[body]]
        if not len(geoms):
            # A body without geometry is taken to extend as far beyond its centre of mass as its origin lies
            # before it.
            corners.append(2.0 * self.data.xipos[body] - self.data.xpos[body])
        for geom in geoms:
            centre, half = np.split(self.compiled.geom_aabb[geom], 2)
            signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
            turn = self.data.geom_xmat[geom].reshape(3, 3)
            corners += list(self.data.geom_xpos[geom] + (centre + signs * half) @ turn.T)
        corners += [
            self.data.xpos[child] for child in np.flatnonzero(self.compiled.body_parentid == body) if child
        ]
        return np.array(corners)

    def _bodies(self) -> list[_Body]:
        """Return the bodies with mass or joints as links, parents before children."""
        compiled, found = self.compiled, dict[int, _Body]()
        first = True
        for number in range(1, compiled.nbody):
            joints = [k for k in self._hinges() if compiled.jnt_bodyid[k] == number]
            if len(joints) > 1:
                text = f"the body '{self.name('body', number)}' has {len(joints)} joints"
                raise InputError(text, file=self.path, hint="give each joint a body of its own")
            corners = self._extent(number)
            anchor = self.data.xanchor[joints[0]] if joints else self.data.xpos[number]
            away = self.flat(corners.mean(axis=0) - anchor)
            if (first and self.free) or np.linalg.norm(away) < 1e-9:
                forward = self.flat(self.data.xmat[number].reshape(3, 3)[:, 0])
            else:
                forward = -away
            forward = forward / max(float(np.linalg.norm(forward)), 1e-12)
            places = np.array([self.flat(c) for c in corners])
            along = places @ forward
            start = self.flat(anchor)
            if first and self.free:
                start = start + (along.max() - start @ forward) * forward
            side = np.array([-forward[1], forward[0]])
            width = float(np.ptp(places @ side))
            height = float(np.ptp(corners @ self.normal))
            length = max(float(start @ forward - along.min()), 1e-3)
            body = _Body(
                self.name("body", number), number, start, forward, length, height, width,
                joints[0] if joints else None, found.get(int(compiled.body_parentid[number])),
            )  # fmt: skip
            found[number] = body
            first = False
        return list(found.values())

    # ------------------------------------------------------------ entries

    def document(self) -> dict[str, Any]:
        """Return the content of the robot file."""
        fixed = not self.free
        bodies = self.bodies
        links = [self._link(body) for body in bodies]
        if fixed:
            # The first link of a robot file is the base.
            links.insert(0, {"name": "base", "length_m": 0.1, "mass_kg": 1.0, "com_m": 0.05,
                             "inertia_kg_m2": 0.001, "inertia_about": "com"})  # fmt: skip
        inputs, torques, gains = self._actuators()
        joints = [self._joint(body, torques, gains) for body in bodies if body.parent is not None or fixed]
        density = self.options.density
        if density is None:
            density = float(self.compiled.opt.density)
        elements, coefficients = _draft_forces(self, density)
        about: dict[str, Any] = {"plane": self.plane}
        if fixed:
            about["base"] = "fixed"
        multilink = {**about, **self._markers(), "coefficients": coefficients, "inputs": inputs,
                     "links": links, "joints": joints, "elements": elements}  # fmt: skip
        self._note_left_out()
        gravity = float(np.linalg.norm(self.compiled.opt.gravity)) or 9.81
        return {
            "format": "swimid-robot/1",
            "name": self.path.stem,
            "description": f"Drafted from {self.path.name}.",
            "sources": [self.path.name],
            "fluid": {"density_kg_m3": density or 1000.0, "gravity_m_s2": round(gravity, 9)},
            "multilink": {key: value for key, value in multilink.items() if value},
        }

    def _note_left_out(self) -> None:
        """Note constraints, limits and contacts, which the draft leaves out."""
        if "equality" in self.path.read_text(encoding="utf-8", errors="replace"):
            self.left_out.append("equality constraints")
        limited = [self.name("joint", k) for k in self._hinges() if self.compiled.jnt_limited[k]]
        if limited:
            self.left_out.append(f"limits of {', '.join(limited)}")
        if self.compiled.geom_contype.any() and self.compiled.ngeom > 1:
            self.left_out.append("contacts")

    def _link(self, body: _Body) -> dict[str, Any]:
        compiled, number = self.compiled, body.number
        centre = body.local(self.flat(self.data.xipos[number]))
        turn = self.data.ximat[number].reshape(3, 3)
        inertia = float(self.normal @ turn @ np.diag(compiled.body_inertia[number]) @ turn.T @ self.normal)
        mass = float(compiled.body_mass[number])
        if mass <= 0.0:
            self.asks.append(f"mass of the link {body.name}: the file states none")
        return {
            "name": body.name, "length_m": _round(body.length), "mass_kg": _round(mass),
            "com_m": _round(-centre[0]), "com_offset_m": _round(centre[1]),
            "inertia_kg_m2": _round(inertia), "inertia_about": "com",
        }  # fmt: skip

    def sign(self, joint: int) -> float:
        """Return 1 if a joint angle has the same sign in the file and in the draft, and -1 if not."""
        return float(np.sign(self.data.xaxis[joint] @ self.normal))

    def _joint(self, body: _Body, torques: Mapping[int, Any], gains: Mapping[int, Array]) -> dict[str, Any]:
        parent, k, compiled = body.parent, body.joint, self.compiled
        entry: dict[str, Any] = {"name": f"to-{body.name}" if k is None else self.name("joint", k)}
        heading = math.atan2(body.forward[1], body.forward[0])
        if parent is None:
            entry |= {"parent": "base", "child": body.name, "at_m": 0.0}
        else:
            heading -= math.atan2(parent.forward[1], parent.forward[0])
            at = parent.local(body.front)
            entry |= {"parent": parent.name, "child": body.name, "at_m": _round(-at[0]),
                      "offset_m": _round(at[1])}  # fmt: skip
        entry["mount_deg"] = _round(math.degrees(math.remainder(heading, 2.0 * math.pi)))
        if k is None:
            return entry
        dof = int(compiled.jnt_dofadr[k])
        stiff, damp = gains.get(k, np.zeros(2))
        rest = self.sign(k) * float(compiled.qpos_spring[compiled.jnt_qposadr[k]])
        own = float(compiled.jnt_stiffness[k])
        if own and stiff and rest:
            self.left_out.append(f"the rest angle of {entry['name']}, which has a servo and a spring")
        if compiled.dof_armature[dof]:
            self.left_out.append(f"armature of {entry['name']}, {compiled.dof_armature[dof]:.3g} kg m^2")
        law = {
            "stiffness_N_m_rad": own + stiff,
            "damping_N_m_s_rad": float(compiled.dof_damping[dof]) + damp,
            "friction_N_m": float(compiled.dof_frictionloss[dof]),
            "rest_deg": math.degrees(rest) if own else 0.0,
            "cubic_N_m_rad3": float(compiled.jnt_stiffnesspoly[k, 1]),
        }
        entry["passive"] = {name: _round(value) for name, value in law.items() if value}
        if k in torques:
            entry["torque"] = torques[k]
        return entry

    def _actuators(self) -> tuple[dict[str, Any], dict[int, Any], dict[int, Array]]:
        """Return the inputs, and the torque and the additional spring and damper of each driven joint.

        A servo with the torque ``k (u - q) - d q'`` (command u, joint angle q) becomes a torque ``k u``, a
        spring k and a damper d.
        """
        compiled, module = self.compiled, mujoco()
        inputs: dict[str, Any] = {}
        torques: dict[int, Any] = {}
        gains: dict[int, Array] = {}
        for number in range(compiled.nu):
            name = self.name("actuator", number)
            joints = self._joints_of(number)
            if not joints or compiled.actuator_dyntype[number] != module.mjtDyn.mjDYN_NONE:
                self.left_out.append(f"actuator {name}")
                continue
            if any(joint in torques for joint, _ in joints):
                self.left_out.append(f"actuator {name}, the second one of its joint")
                continue
            gain, bias = compiled.actuator_gainprm[number], compiled.actuator_biasprm[number]
            inputs[name] = {"column": f"cmd_{name}"}
            for joint, share in joints:
                sign = self.sign(joint)
                torques[joint] = {"input": name, "gain_N_m": _round(sign * share * gain[0])}
                gains[joint] = np.array([-bias[1], -bias[2]]) * share**2
            if len(joints) > 1 and (bias[1] or bias[2]):
                self.left_out.append(f"the servo {name} on a tendon of several joints, which couples them")
        if inputs:
            self.asks.append(
                f"columns of the log of the actuators: {', '.join(v['column'] for v in inputs.values())}"
            )
        return inputs, torques, gains

    def _joints_of(self, actuator: int) -> list[tuple[int, float]]:
        """Return the joints that an actuator moves, with the torque per force of each."""
        compiled, module = self.compiled, mujoco()
        kind, target = compiled.actuator_trntype[actuator], int(compiled.actuator_trnid[actuator, 0])
        gear = float(compiled.actuator_gear[actuator, 0])
        if kind == module.mjtTrn.mjTRN_JOINT and target not in self.base:
            return [(target, gear)]
        if kind != module.mjtTrn.mjTRN_TENDON:
            return []
        first, count = int(compiled.tendon_adr[target]), int(compiled.tendon_num[target])
        wraps = range(first, first + count)
        if any(compiled.wrap_type[w] != module.mjtWrap.mjWRAP_JOINT for w in wraps):
            return []
        return [(int(compiled.wrap_objid[w]), gear * float(compiled.wrap_prm[w])) for w in wraps]

    def _markers(self) -> dict[str, Any]:
        """Return the entry ``points`` of the draft: link and position on the link, for each site."""
        points = {}
        for site in range(self.compiled.nsite):
            body = next((b for b in self.bodies if b.number == self.compiled.site_bodyid[site]), None)
            if body is not None:
                at = body.local(self.flat(self.data.site_xpos[site]))
                points[self.name("site", site)] = {"link": body.name, "at_m": [_round(v) for v in at]}
        return {"points": points}

    def text(self, document: dict[str, Any], differences: Mapping[str, float]) -> str:
        """Return the robot file with comments on what is asked and left out."""
        lines = [f"Drafted from {self.path.name} by swimid robot."]
        lines += [f"ASK: {one}" for one in self.asks]
        lines += [f"not expressed: {one}" for one in self.left_out]
        if differences:
            words = ", ".join(f"{name} {value:.2g}" for name, value in differences.items())
            lines.append(f"without water, differences from MuJoCo over the range of each coordinate: {words}")
        return "".join(f"# {line}\n" for line in lines) + yamlio.dumps(document)


def _draft_forces(draft: _Draft, density: float) -> tuple[list[Any], dict[str, Any]]:
    """Return the forces of the water on each link, and their coefficients.

    For its added mass, each link is taken as an ellipsoid of the same extent; for its drag, as a plate.
    """
    elements: list[Any] = []
    if draft.plane == "vertical" and np.any(draft.compiled.opt.gravity):
        elements += [{"kind": "hydrostatics", "link": body.name} for body in draft.bodies]
        if density > 0.0:
            draft.asks.append("volume_m3 of each link: without it no buoyancy acts")
    if density <= 0.0:
        draft.left_out.append(
            "forces of the water: the file has no fluid (option density); --density adds them"
        )
        return elements, {}
    for body in draft.bodies:
        a, b, c = (max(0.5 * v, 1e-4) for v in (body.length, body.width, body.height))
        surge, sway, turn = _compute_added_mass(a, b, c, density)
        middle = _round(0.5 * body.length)
        elements.append(
            {"kind": "added-mass", "link": body.name, "surge_kg": f"{surge:.4g} * c_ma",
             "sway_kg": f"{sway:.4g} * c_ma", "inertia_kg_m2": f"{turn:.4g} * c_ma", "at_m": middle}
        )  # fmt: skip
        elements.append(
            {"kind": "drag", "link": body.name, "strips": 3,
             "normal_area_m2": _round(body.length * body.height), "normal_coefficient": "c_n",
             "axial_area_m2": _round(math.pi / 4.0 * body.width * body.height),
             "axial_coefficient": "c_x"}
        )  # fmt: skip
    return elements, {
        name: {"value": value, "bounds": list(bounds), "meaning": meaning, "source": source}
        for name, (value, bounds, meaning, source) in WATER.items()
    }


def _round(value: float) -> float:
    """Return a number with eight digits, and a clean zero."""
    return float(f"{value:.8g}") if abs(value) > 1e-12 else 0.0


def _compute_added_mass(a: float, b: float, c: float, density: float) -> tuple[float, float, float]:
    """Return the added mass along a and b (kg), and the added inertia about c (kg m2), of an ellipsoid.

    The semi-axes are a (along the link), b (across it in the plane) and c, m. The integrals are those of
    Lamb, section 114, with a substitution to a finite interval.
    """
    nodes, weights = np.polynomial.legendre.leggauss(200)
    theta = 0.5 * (nodes + 1.0)
    # t = s / (1 - s), which maps 0 to 1 onto all positive numbers
    scale = (a * b * c) ** (2.0 / 3.0)
    t = scale * (theta / (1.0 - theta)) ** 2
    jacobian = scale * 2.0 * theta / (1.0 - theta) ** 3 * 0.5
    root = np.sqrt((a**2 + t) * (b**2 + t) * (c**2 + t))
    alpha, beta = (a * b * c * float(weights @ (jacobian / ((own**2 + t) * root))) for own in (a, b))
    displaced = density * 4.0 / 3.0 * math.pi * a * b * c
    surge, sway = (displaced * share / (2.0 - share) for share in (alpha, beta))
    over = (a**2 - b**2) ** 2 * (beta - alpha)
    under = 2.0 * (a**2 - b**2) + (a**2 + b**2) * (alpha - beta)
    turn = displaced / 5.0 * over / under if abs(a - b) > 1e-9 * a else 0.0
    return surge, sway, turn


# ---------------------------------------------------------------- comparison without water


def _compare(draft: _Draft, made: Robot) -> dict[str, float]:
    """Return the differences of the drafted robot from MuJoCo without water.

    Each difference is divided by the range of its coordinate. Both models get the same commands.
    """
    times = np.arange(0.0, COMPARED_S + 0.5 * STEP_S, STEP_S)
    commands = _commands(draft, times)
    model = _dry_model(made)
    names, values = [p.name for p in model.parameters], np.array([p.start for p in model.parameters])
    released = 0.0 if commands else RELEASED_RAD
    drifts = bool(draft.base) and draft.compiled.jnt_type[draft.base[0]] == 0 and not model.passive
    simulated = _simulate_mujoco(draft, model.pose, times, commands, released, drifts=drifts)
    for axis in model.passive:
        values[names.index(f"initial_angle_{axis.name}")] = released
    if drifts:
        for name, value in zip(model.rates, _front_velocity(draft), strict=True):
            values[names.index(f"initial_{name}")] = value
    known: dict[str, Any] = {
        name: (lambda t, series=commands[name]: np.interp(t, times, series))
        for name in getattr(made.multilink, "inputs", {})
    }
    pose = tuple(float(simulated[name][0]) for name in model.pose) if draft.free else None
    ran = model.run(values, Trial("draft", "fit", times, {}, swim=SwimInput(inputs=known, pose=pose)))
    columns = {axis.name: axis.column for axis in model.passive}
    found = {}
    for name, series in simulated.items():
        span = float(np.ptp(np.unwrap(series)))
        if span > STILL_RANGE:
            found[name] = float(np.max(np.abs(np.unwrap(series) - ran[columns.get(name, name)]))) / span
    return found


def _dry_model(made: Robot) -> MultilinkModel:
    """Return the model of a drafted robot without forces of the water."""
    document = made.model_dump(mode="python")
    weights = [e for e in document["multilink"]["elements"] if e["kind"] == "hydrostatics"]
    document["multilink"] |= {"elements": weights, "coefficients": {}}
    document["fluid"]["density_kg_m3"] = 1.0
    return MultilinkModel(schema_of(DRAFTED_PARTS).model_validate(document), max_step=STEP_S)


def _front_velocity(draft: _Draft) -> tuple[float, float, float]:
    """Return the velocity of the front end of a drifting robot, in the axes of the first link."""
    base = draft.bodies[0]
    lever = base.front - draft.flat(draft.data.xpos[base.number])
    world = DRIFT[:2] + DRIFT[2] * np.array([-lever[1], lever[0]])
    side = np.array([-base.forward[1], base.forward[0]])
    return float(world @ base.forward), float(world @ side), float(DRIFT[2])


def _commands(draft: _Draft, times: Array) -> dict[str, Array]:
    """Return the commands of the comparison for each actuator: a sine that sets in gradually."""
    compiled, found = draft.compiled, {}
    for number in range(compiled.nu):
        low, high = compiled.actuator_ctrlrange[number]
        size = 0.2 * (high - low) if compiled.actuator_ctrllimited[number] else COMMAND
        wave = np.sin(2.0 * math.pi * COMPARED_HZ * times) * np.minimum(times / 0.5, 1.0)
        found[draft.name("actuator", number)] = size * wave
    return found


def _simulate_mujoco(
    draft: _Draft, pose: Sequence[str], times: Array, commands: Mapping[str, Array], released: float, *,
    drifts: bool,
) -> dict[str, Array]:  # fmt: skip
    """Return pose and joint angles in MuJoCo without water, contacts and limits.

    MuJoCo holds a command over a step, so that it gets the command at the middle of the step.
    """
    module, compiled, base = mujoco(), draft.compiled, draft.bodies[0]
    for name, value in (("density", 0.0), ("viscosity", 0.0), ("timestep", STEP_S)):
        setattr(compiled.opt, name, value)
    compiled.opt.integrator = module.mjtIntegrator.mjINT_RK4
    compiled.opt.disableflags |= module.mjtDisableBit.mjDSBL_CONTACT | module.mjtDisableBit.mjDSBL_LIMIT
    data, front = module.MjData(compiled), _in_body(draft, base)
    joints = [body.joint for body in draft.bodies if body.joint is not None]
    addresses = [int(compiled.jnt_qposadr[k]) for k in joints]
    signs = np.array([draft.sign(k) for k in joints])
    data.qpos[addresses] += signs * released
    if drifts:
        turn = draft.data.xmat[base.number].reshape(3, 3)
        data.qvel[:3], data.qvel[3:6] = draft.axes.T @ DRIFT[:2], turn.T @ draft.normal * DRIFT[2]
    rows = []
    for k in range(len(times)):
        module.mj_kinematics(compiled, data)
        turn = data.xmat[base.number].reshape(3, 3)
        place, ahead = draft.flat(data.xpos[base.number] + turn @ front), draft.flat(turn[:, 0])
        rows.append([*place, math.atan2(ahead[1], ahead[0]), *(signs * data.qpos[addresses])])
        for number, name in enumerate(commands):
            data.ctrl[number] = commands[name][k : k + 2].mean()
        module.mj_step(compiled, data)
    names = [*(pose if draft.free else ("", "", "")), *(draft.name("joint", k) for k in joints)]
    return {name: series for name, series in zip(names, np.array(rows).T, strict=True) if name}


def _in_body(draft: _Draft, base: _Body) -> Array:
    """Return the front end of the first link in the axes of its body, m."""
    turn = draft.data.xmat[base.number].reshape(3, 3)
    offset = draft.axes.T @ (base.front - draft.flat(draft.data.xpos[base.number]))
    return np.asarray(turn.T @ offset)


def _describe_draft(draft: _Draft, differences: Mapping[str, float]) -> str:
    """Return a description of the draft, as the command prints it."""
    lines = [f"Robot of {draft.path.name}: {len(draft.bodies)} links in the {draft.plane} plane"]
    lines += [f"  ASK {one}" for one in draft.asks]
    lines += [f"  not expressed: {one}" for one in draft.left_out]
    if differences:
        worst = max(differences, key=lambda name: differences[name])
        share = f"{100 * differences[worst]:.3g} % of its range"
        lines.append(
            f"  without water, {worst} differs from MuJoCo (RK4) by {share} in {COMPARED_S:g} s; all others "
            "by less"
        )
        if differences[worst] > MAX_RELATIVE_DIFFERENCE:
            lines.append(
                "  CAUTION: the draft does not move as the file does: a robot file has no armature, no servo "
                "on several joints, and no motion out of its plane"
            )
    return "\n".join(lines)
