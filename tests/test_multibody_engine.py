"""Engine in space against MuJoCo, conservation laws, closed forms, and the planar engine."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting import drives
from swimid.fitting.model import TRACEABLE, ExternalForce, SwimInput, Trial
from swimid.robots import file as robot_format
from swimid.robots.file import Fluid
from swimid.robots.spatial import MultibodyRobot
from swimid.swimmer import drive, lanes
from swimid.swimmer.assembly import spheroid_coefficients
from swimid.swimmer.drive import joint_motion
from swimid.swimmer.engine import pack_forces, place_frame
from swimid.swimmer.planar.engine import PLANAR_ENGINE as planar_engine
from swimid.swimmer.planar.model import MultilinkModel
from swimid.swimmer.spatial.engine import SPATIAL_ENGINE as engine
from swimid.swimmer.spatial.model import MultibodyModel, SpatialTree, full
from tests import lanes_forms
from tests.lifted import Lifted

WATER, G = 1000.0, 9.81


def assembly(body: dict[str, Any]) -> SpatialTree:
    return SpatialTree(MultibodyRobot.model_validate(body), Fluid(density_kg_m3=WATER, gravity_m_s2=G))


def derivative(model: SpatialTree, state: np.ndarray, motion: np.ndarray | None = None) -> np.ndarray:
    """Return the rate of a state; ``motion`` has angle, rate and acceleration of every driven joint."""
    motion = np.zeros((len(model.driven), 3)) if motion is None else motion
    row = np.column_stack([motion, np.cos(motion[:, 0]), np.sin(motion[:, 0])])
    n = 6 + len(model.passive)
    rate = np.empty(len(state))
    tables = model.tables(np.zeros(0))
    scratch = np.zeros((len(model.links), 60)), np.zeros((n, n)), np.zeros(n)
    engine.compute_rate(state, row, tuple(tables.values()), None, 0.0, *scratch, rate)
    kernel = lanes.Kernel(model)
    traced = lanes_forms.rate(kernel, state, row, tables)
    assert traced == pytest.approx(rate, rel=1e-9, abs=1e-11 * np.abs(rate).max())
    return rate


def at_rest(model: SpatialTree) -> np.ndarray:
    state = np.zeros(13 + 2 * len(model.passive))
    state[3] = 1.0
    return state


def random_state(model: SpatialTree, rng: np.random.Generator) -> np.ndarray:
    state = rng.normal(size=13 + 2 * len(model.passive))
    state[3:7] /= np.linalg.norm(state[3:7])
    return state


def integrated(model: SpatialTree, start: np.ndarray, step: float, duration: float) -> np.ndarray:
    table = np.zeros((2 * round(duration / step) + 1, len(model.driven), 5))
    table[:, :, 3] = 1.0
    return engine.integrate(start, step, table, tuple(model.tables(np.zeros(0)).values()), None, 0.0)[0]


def random_tree(rng: np.random.Generator, links: int, yielding: int, *, driven: bool) -> dict[str, Any]:
    """Return rigid bodies on hinges with random places and axes, passive, driven or rigid."""

    def vector(size: float) -> list[float]:
        return [float(v) for v in rng.normal(0.0, size, 3)]

    bodies, joints = [], []
    passive = set(rng.choice(np.arange(1, links), min(yielding, links - 1), replace=False).tolist())
    for i in range(links):
        turn = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
        central = turn @ np.diag(rng.uniform(0.9, 1.3, 3) * rng.uniform(0.005, 0.02)) @ turn.T
        entries = [central[r, c] for r, c in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        bodies.append(
            {
                "name": f"l{i}", "mass_kg": float(rng.uniform(0.5, 2.0)), "com_m": vector(0.05),
                "inertia_kg_m2": [float(e) for e in entries],
            }
        )  # fmt: skip
        if i == 0:
            continue
        joint: dict[str, Any] = {
            "name": f"j{i}", "parent": f"l{int(rng.integers(0, i))}", "child": f"l{i}", "at_m": vector(0.2),
            "axis": vector(1.0), "mount_deg": [float(a) for a in rng.uniform(-170, 170, 3)],
        }  # fmt: skip
        if i in passive:
            joint["passive"] = {
                "stiffness_N_m_rad": 0.4, "damping_N_m_s_rad": 0.02, "rest_deg": float(rng.uniform(-20, 20)),
            }  # fmt: skip
        elif driven:
            joint["driven"] = {}
        joints.append(joint)
    return {"links": bodies, "joints": joints}


# ------------------------------------------------------------ MuJoCo


def mujoco_model(body: dict[str, Any], step: float) -> Any:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is the second opinion on rigid trees")
    links = {link["name"]: link for link in body["links"]}

    def written(name: str, place: str, joints: str) -> str:
        link = links[name]
        x, y, z = link["com_m"]
        inertia = " ".join(repr(e) for e in link["inertia_kg_m2"])
        text = f'<body name="{name}" {place}>{joints}<inertial pos="{x!r} {y!r} {z!r}" '
        text += f'mass="{link["mass_kg"]!r}" fullinertia="{inertia}"/>'
        for j in body["joints"]:
            if j["parent"] != name:
                continue
            q = Rotation.from_euler("xyz", j["mount_deg"], degrees=True).as_quat().tolist()
            spot = f'pos="{" ".join(map(repr, j["at_m"]))}" quat="{q[3]!r} {q[0]!r} {q[1]!r} {q[2]!r}"'
            hinge, law = "", j.get("passive")
            if law or "driven" in j:
                hinge = f'<joint name="{j["name"]}" type="hinge" axis="{" ".join(map(repr, j["axis"]))}"'
                if law:
                    hinge += (
                        f' stiffness="{law["stiffness_N_m_rad"]!r}" damping="{law["damping_N_m_s_rad"]!r}"'
                    )
                    hinge += f' springref="{math.radians(law["rest_deg"])!r}"'
                hinge += "/>"
            text += written(j["child"], spot, hinge)
        return text + "</body>"

    text = f"""<mujoco><compiler angle="radian" inertiafromgeom="false"/>
        <option timestep="{step}" integrator="RK4" gravity="0 0 -9.81"/>
        <worldbody>{written(body["links"][0]["name"], "", '<freejoint name="base"/>')}</worldbody></mujoco>"""
    return mujoco, mujoco.MjModel.from_xml_string(text)


def weighed(body: dict[str, Any]) -> dict[str, Any]:
    return {**body, "elements": [{"kind": "hydrostatics", "link": link["name"]} for link in body["links"]]}


def put(model: SpatialTree, theirs: Any, data: Any, state: np.ndarray) -> list[int]:
    """Set MuJoCo's state to ours, and return the positions of its velocities for our unknowns."""
    p = len(model.passive)
    turn = Rotation.from_quat(np.roll(state[3:7], -1))
    data.qpos[:3], data.qpos[3:7] = state[:3], state[3:7]
    data.qvel[:3], data.qvel[3:6] = turn.apply(state[7 + p : 10 + p]), state[10 + p : 13 + p]
    places = list(range(6))
    for k, axis in enumerate(model.passive):
        joint = theirs.joint(axis.name)
        data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = state[7 + k], state[13 + p + k]
        places.append(int(joint.dofadr[0]))
    return places


def accelerations(model: SpatialTree, state: np.ndarray, motion: np.ndarray | None = None) -> np.ndarray:
    """Return accelerations of the base's origin, of its rotation, and of the passive joints."""
    p = len(model.passive)
    rate = derivative(model, state, motion)
    turn = Rotation.from_quat(np.roll(state[3:7], -1))
    v, w = state[7 + p : 10 + p], state[10 + p : 13 + p]
    linear = turn.apply(rate[7 + p : 10 + p] + np.cross(w, v))
    return np.concatenate([linear, rate[10 + p :]])


class TestMujoco:
    def test_accelerations(self) -> None:
        rng = np.random.default_rng(1)
        for _ in range(8):
            body = weighed(random_tree(rng, int(rng.integers(2, 9)), int(rng.integers(1, 4)), driven=False))
            model = assembly(body)
            mujoco, theirs = mujoco_model(body, 0.001)
            data = mujoco.MjData(theirs)
            state = random_state(model, rng)
            places = put(model, theirs, data, state)
            mujoco.mj_forward(theirs, data)
            expected = data.qacc[places]
            found = accelerations(model, state)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())

    def test_forces_with_driven_joints(self) -> None:
        """Inverse dynamics of our accelerations leaves no force on the base and the passive joints."""
        rng = np.random.default_rng(2)
        for _ in range(20):
            body = weighed(random_tree(rng, int(rng.integers(3, 9)), 1, driven=True))
            model = assembly(body)
            mujoco, theirs = mujoco_model(body, 0.001)
            data = mujoco.MjData(theirs)
            state, motion = random_state(model, rng), rng.normal(size=(len(model.driven), 3))
            places = put(model, theirs, data, state)
            data.qacc[places] = accelerations(model, state, motion)
            for axis, (angle, rate, bend) in zip(model.driven, motion, strict=True):
                joint = theirs.joint(axis.name)
                data.qpos[joint.qposadr[0]] = angle
                data.qvel[joint.dofadr[0]], data.qacc[joint.dofadr[0]] = rate, bend
            mujoco.mj_inverse(theirs, data)
            scale = np.abs(data.qfrc_bias).max() + np.abs(data.qacc).max()
            np.testing.assert_allclose(data.qfrc_inverse[places], 0.0, atol=1e-10 * scale)

    def test_trajectory(self) -> None:
        """Two seconds of a falling, tumbling tree; both use fourth-order steps of 0.5 ms."""
        body = weighed(random_tree(np.random.default_rng(3), 5, 3, driven=False))
        model = assembly(body)
        mujoco, theirs = mujoco_model(body, 0.0005)
        data = mujoco.MjData(theirs)
        start = at_rest(model)
        start[7:10], start[13:16] = (0.4, -0.3, 0.2), (0.5, 1.0, -1.0)
        put(model, theirs, data, start)
        states = integrated(model, start, 0.0005, 2.0)
        for _ in range(4000):
            mujoco.mj_step(theirs, data)
        np.testing.assert_allclose(states[-1, :3], data.qpos[:3], atol=1e-7)
        assert abs(states[-1, 3:7] @ data.qpos[3:7]) == pytest.approx(1.0, abs=1e-10)


# ------------------------------------------------------------ conservation


def with_water(body: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return added masses of different size along the axes of each link, at random places."""
    elements = [
        {
            "kind": "added-mass", "link": link["name"],
            "mass_kg": [float(m) for m in rng.uniform(0.1, 3.0, 3)],
            "inertia_kg_m2": [float(m) for m in rng.uniform(0.001, 0.03, 3)],
            "at_m": [float(a) for a in rng.normal(0, 0.05, 3)],
        }
        for link in body["links"]
    ]  # fmt: skip
    return {**body, "elements": elements}


def momentum(model: SpatialTree, state: np.ndarray) -> tuple[np.ndarray, float]:
    """Return linear and angular momentum in the world, and kinetic energy, by vector mechanics."""
    p = len(model.passive)
    tables = model.tables(np.zeros(0))
    turns, places, v, w = {}, {}, {}, {}
    turns[0], places[0] = Rotation.from_quat(np.roll(state[3:7], -1)).as_matrix(), state[:3]
    v[0], w[0] = turns[0] @ state[7 + p : 10 + p], turns[0] @ state[10 + p : 13 + p]
    total, energy = np.zeros(6), 0.0
    for i, (parent, _, k, _) in enumerate(tables["topology"]):
        if i:
            row = tables["joint"][i]
            angle, rate = (state[7 + k], state[13 + p + k]) if k >= 0 else (0.0, 0.0)
            own = row[6:15].reshape(3, 3) @ Rotation.from_rotvec(angle * row[3:6]).as_matrix()
            turns[i] = turns[parent] @ own
            arm = turns[parent] @ row[:3]
            places[i], v[i] = places[parent] + arm, v[parent] + np.cross(w[parent], arm)
            w[i] = w[parent] + turns[i] @ row[3:6] * rate
        twist = np.concatenate([turns[i].T @ v[i], turns[i].T @ w[i]])
        held = full(tables["inertia"][i]) @ twist
        linear, angular = turns[i] @ held[:3], turns[i] @ held[3:]
        total += np.concatenate([linear, angular + np.cross(places[i], linear)])
        energy += 0.5 * float(twist @ held)
    return total, energy


@pytest.mark.parametrize("seed", range(3))
def test_momentum_and_energy_are_conserved_in_space(seed: int) -> None:
    """In free motion without losses the error falls with the fourth power of the step."""
    rng = np.random.default_rng(seed)
    body = with_water(random_tree(rng, 5, 3, driven=False), rng)
    for joint in body["joints"]:
        if "passive" in joint:
            joint["passive"] = {}
    model = assembly(body)
    start = random_state(model, rng)
    start[13 + 3 :] *= 2.0
    drift = []
    for step in (0.004, 0.002):
        states = integrated(model, start, step, 1.0)
        (p0, e0), (p1, e1) = momentum(model, states[0]), momentum(model, states[-1])
        drift.append(max(np.abs(p1 - p0).max() / np.abs(p0).max(), abs(e1 - e0) / e0))
    assert drift[1] < 1e-6
    assert drift[1] < drift[0] / 10.0 or drift[1] < 1e-11


# ------------------------------------------------------------ planar robots


@pytest.mark.parametrize("name", ["tfish", "dolphin"])
def test_planar_robots_move_in_space_as_in_their_plane(name: str) -> None:
    """Positions agree to 1e-9 m after 20 s of swimming, without motion off the plane."""
    robot = robot_format.read(name)
    body = robot.multilink
    assert body is not None
    planar, lifted = MultilinkModel(robot).tree, Lifted(body, robot.fluid)
    values = np.array([c.value for c in body.coefficients.values()])
    step, steps = 0.005, 4000
    half = 0.5 * step * np.arange(2 * steps + 1)
    swim = SwimInput(drives.TailBeat("sine", 1.2, 0.4, 0.1))
    motions = [joint_motion(axis, k, swim, half, 0.0) for k, axis in enumerate(planar.driven)]
    mounts = [math.radians(axis.joint.mount_deg) for axis in planar.driven]
    n = planar.unknowns
    flat = np.zeros(2 * n)
    flat[n] = 0.1
    told = drive.drive_table(len(half), motions, mounts)
    expected, _ = planar_engine.integrate(flat, step, told, tuple(planar.tables(values).values()), None, 0.0)
    start = np.zeros(13 + 2 * len(lifted.passive))
    start[3], start[7 + len(lifted.passive)] = 1.0, 0.1
    table = drive.drive_table(len(half), motions, [0.0] * len(motions))
    found, _ = engine.integrate(start, step, table, tuple(lifted.tables(values).values()), None, 0.0)
    second = 1 if body.plane == "horizontal" else 2
    np.testing.assert_allclose(found[:, 0], expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(found[:, second], expected[:, 1], atol=1e-9)
    np.testing.assert_allclose(found[:, 3 - second], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[:, 7:-6][:, : n - 3], expected[:, 3:n], atol=1e-9)


def test_forces_of_effects_act_in_space_as_in_the_plane(rng: np.random.Generator) -> None:
    """All traceable forces of effects, on a swimmer that moves in the horizontal plane."""
    robot = robot_format.read("tfish")
    assert robot.multilink is not None
    planar, lifted = MultilinkModel(robot).tree, Lifted(robot.multilink, robot.fluid)
    values = np.array([c.value for c in robot.multilink.coefficients.values()])
    n, passives = planar.unknowns, len(planar.passive)
    flat = 0.5 * rng.normal(size=2 * n)
    state = np.zeros(13 + 2 * passives)
    state[:2], state[3], state[6] = flat[:2], math.cos(0.5 * flat[2]), math.sin(0.5 * flat[2])
    state[7 : 7 + passives], state[13 + passives :] = flat[3:n], flat[n + 3 :]
    state[7 + passives : 9 + passives], state[12 + passives] = flat[n : n + 2], flat[n + 2]
    motion = rng.normal(size=(len(planar.driven), 3))
    mounts = [math.radians(axis.joint.mount_deg) for axis in planar.driven]
    frame = place_frame((0.3, -0.2, 0.7), (0.05, 0.01))
    for name, known in TRACEABLE.items():
        constants = rng.uniform(0.3, 1.0, known.constants)
        force = ExternalForce(
            known.function, constants, {"base": 0, "hull": 1, "last": -1}[known.on], 0.1, 0.02
        )
        rates = []
        for tree, start, turns in ((planar, flat, mounts), (lifted, state, [0.0] * len(mounts))):
            angles = motion[:, 0] + turns
            row = np.column_stack([motion, np.cos(angles), np.sin(angles)])
            tables, rate = tree.tables(values), np.empty(len(start))
            scratch = [np.zeros(shape) for shape in tree.engine.shapes(tables)[1]]
            forced = pack_forces([force], frame, len(tree.links))
            tree.engine.compute_rate(start, row, tuple(tables.values()), forced, 0.4, *scratch, rate)
            rates.append(rate)
        expected, found = rates[0][n:], rates[1][[7 + passives, 8 + passives, 12 + passives]]
        np.testing.assert_allclose(found, expected[:3], rtol=1e-9, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(
            rates[1][13 + passives :], expected[3:], rtol=1e-9, atol=1e-9, err_msg=name
        )


# ------------------------------------------------------------ elements


def one_body(*elements: dict[str, Any], **link: Any) -> SpatialTree:
    own = {"name": "hull", "mass_kg": 2.0, "inertia_kg_m2": [0.02, 0.05, 0.05]} | link
    return assembly({"links": [own], "elements": [{"link": "hull", **e} for e in elements]})


def wrench(model: SpatialTree, **at: Any) -> np.ndarray:
    """Return force and moment at the origin of a body that moves without rotation."""
    state = at_rest(model)
    state[2] = at.get("z", 0.0)
    if "attitude" in at:
        state[3:7] = np.roll(at["attitude"].as_quat(), 1)
    state[7:10] = at.get("velocity", (0.0, 0.0, 0.0))
    matrix = full(model.tables(np.zeros(0))["inertia"][0])
    return matrix @ derivative(model, state)[7:]


def test_spheroid_of_lamb() -> None:
    """Sphere limit 1/2, 1/2, 0; a slender body 0, 1, 1; Lamb's table at 5:1 (0.059, 0.895, 0.700)."""
    assert spheroid_coefficients(1.0, 0.999) == pytest.approx((0.5, 0.5, 0.0), abs=2e-3)
    assert spheroid_coefficients(1.0, 1e-3) == pytest.approx((0.0, 1.0, 1.0), abs=1e-4)
    assert spheroid_coefficients(5.0, 1.0) == pytest.approx((0.059, 0.895, 0.700), abs=1e-3)


def test_spheroid_and_plate_masses() -> None:
    model = one_body(
        {"kind": "spheroid", "semi_major_m": 0.5, "semi_minor_m": 0.1, "factors": [1.0, 1.0, 1.5]},
        {
            "kind": "plate",
            "span_m": 0.3,
            "chord_m": 0.1,
            "k": 0.8,
            "at_m": [0.1, 0.2, 0.0],
            "normal": [0, 0, 2],
        },
    )
    matrix = full(model.tables(np.zeros(0))["inertia"][0])
    k1, k2, _ = spheroid_coefficients(0.5, 0.1)
    hull = 4.0 / 3.0 * math.pi * WATER * 0.5 * 0.1**2
    plate = math.pi * WATER * 0.8 * 0.3 * 0.1**2 / 4.0
    np.testing.assert_allclose(
        np.diag(matrix)[:3], [2 + k1 * hull, 2 + k2 * hull, 2 + 1.5 * k2 * hull + plate]
    )
    plain = one_body({"kind": "plate", "span_m": 0.3, "chord_m": 0.1})
    flat = full(plain.tables(np.zeros(0))["inertia"][0])
    np.testing.assert_allclose(np.diag(flat)[:3], [2, 2, 2 + plate / 0.8])
    # the plate's mass at (0.1, 0.2): its heave momentum turns about x and y
    assert matrix[2, 3] == pytest.approx(0.2 * plate)
    assert matrix[2, 4] == pytest.approx(-0.1 * plate)


def test_drag_along_each_axis() -> None:
    model = one_body(
        {"kind": "drag", "area_m2": [0.01, 0.02, 0.03], "coefficient": [0.3, 1.0, 1.2], "at_m": [0.1, 0, 0]}
    )
    found = wrench(model, velocity=(0.4, -0.3, 0.2))
    half = 0.5 * WATER
    force = [-half * 0.003 * 0.16, half * 0.02 * 0.09, -half * 0.036 * 0.04]
    np.testing.assert_allclose(found[:3], force, rtol=1e-12)
    np.testing.assert_allclose(found[3:], np.cross([0.1, 0, 0], force), atol=1e-12)


@pytest.mark.parametrize("attack_deg", [-160, -60, -10, 0, 5, 45, 90, 170])
def test_foil_by_its_polar(attack_deg: float) -> None:
    area, cl, cd0, cd1 = 0.02, 1.1, 0.05, 0.8
    model = one_body(
        {"kind": "foil", "area_m2": area, "at_m": [0, 0, 0], "chord": [0, 1, 0], "normal": [0, 0, 1],
         "lift_coefficient": cl, "drag_coefficient_0": cd0, "drag_coefficient_1": cd1}
    )  # fmt: skip
    a = math.radians(attack_deg)
    velocity = np.array([0.7, 0.5 * math.cos(a), 0.5 * math.sin(a)])
    force = wrench(model, velocity=velocity)[:3]
    pressure = 0.5 * WATER * area * 0.25
    motion, side = np.array([0, math.cos(a), math.sin(a)]), np.array([0, math.sin(a), -math.cos(a)])
    assert force[0] == pytest.approx(0.0, abs=1e-12)
    assert force @ motion == pytest.approx(-pressure * (cd0 + cd1 * (1 - math.cos(2 * a))))
    assert force @ side == pytest.approx(pressure * cl * math.sin(2 * a), abs=1e-12)


def test_hydrostatics_right_the_body() -> None:
    """A centre of mass 12 mm below that of buoyancy: -m g d sin about either horizontal axis."""
    model = one_body({"kind": "hydrostatics", "volume_m3": 2.0 / WATER, "buoyancy_at_m": [0, 0, 0.012]})
    for angle in np.radians([-120.0, -20.0, 0.0, 20.0, 90.0]):
        for axis in (0, 1):
            turn = Rotation.from_rotvec(angle * np.eye(3)[axis])
            found = wrench(model, attitude=turn)
            np.testing.assert_allclose(found[:3], 0.0, atol=1e-12)
            assert found[3 + axis] == pytest.approx(-2.0 * G * 0.012 * math.sin(angle), abs=1e-12)


def test_buoyancy_and_drag_end_at_the_surface() -> None:
    body = {
        "surface_z_m": 0.5,
        "links": [{"name": "hull", "mass_kg": 2.0, "inertia_kg_m2": [0.02, 0.05, 0.05]}],
        "elements": [
            {"kind": "hydrostatics", "link": "hull", "volume_m3": 0.002, "half_height_m": 0.1},
            {"kind": "drag", "link": "hull", "area_m2": [0.01, 0, 0], "half_height_m": 0.1},
        ],
    }
    model = assembly(body)
    for z, share in ((0.0, 1.0), (0.4, 1.0), (0.5, 0.5), (0.6, 0.0), (2.0, 0.0)):
        force = wrench(model, z=z, velocity=(1.0, 0.0, 0.0))
        assert force[2] == pytest.approx(2.0 * G * (share - 1.0), abs=1e-9)
        assert force[0] == pytest.approx(-0.5 * WATER * 0.01 * share)


def test_water_inside_adds_inertia_and_weight_if_asked() -> None:
    plain = {"kind": "water", "volume_m3": 0.001, "at_m": [0.2, 0, 0], "gyration_m": [0.05, 0.1, 0.1]}
    open_hull, closed = one_body(plain), one_body({**plain, "weighs": True})
    matrix = full(open_hull.tables(np.zeros(0))["inertia"][0])
    assert matrix[0, 0] == pytest.approx(3.0)
    assert matrix[5, 5] == pytest.approx(0.05 + 0.04 + 0.01)
    np.testing.assert_allclose(wrench(open_hull), 0.0, atol=1e-12)
    np.testing.assert_allclose(wrench(closed), [0, 0, -G, 0, 0.2 * G, 0], atol=1e-12)


# ------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"links": [{"name": "a", "mass_kg": 1.0}]}, "inertia_kg_m2"),
        ({"links": [{"name": "a", "mass_kg": 1.0, "inertia_kg_m2": [0.1, 0.1, 0.5]}]}, "inertia_kg_m2"),
        ({"links": [{"name": "a", "mass_kg": -1.0, "inertia_kg_m2": [0.1, 0.1, 0.1]}]}, "mass_kg"),
        ({"elements": [{"kind": "drag", "link": "b"}]}, "elements.0.link"),
        ({"elements": [{"kind": "drag", "link": "a", "area_m2": ["c_x", 0, 0]}]}, "area_m2.0"),
        ({"joints": [{"name": "j", "parent": "a", "child": "a", "axis": [0, 0, 1]}]}, "joints.j.child"),
    ],
)
def test_impossible_robots_are_refused(change: dict[str, Any], where: str) -> None:
    body = {"links": [{"name": "a", "mass_kg": 1.0, "inertia_kg_m2": [0.1, 0.1, 0.1]}]} | change
    with pytest.raises(InputError) as caught:
        assembly(body)
    assert where in str(caught.value.column)


# ------------------------------------------------------------ what is measured


def armed(base: str, at: list[float]) -> MultibodyModel:
    """Return a block that beats an arm, as it is logged at a reference point."""
    robot = {
        "format": "swimid-robot/1",
        "name": "arm",
        "multibody": {
            "base": base,
            "reference": {"at_m": at},
            "links": [
                {"name": "block", "mass_kg": 0.5, "inertia_kg_m2": [0.01, 0.02, 0.02]},
                {"name": "arm", "mass_kg": 0.2, "com_m": [-0.1, 0.02, 0.01], "inertia_kg_m2": [1e-4] * 3},
            ],
            "joints": [
                {"name": "j", "parent": "block", "child": "arm", "at_m": [-0.05, 0.01, 0.0],
                 "axis": [0.2, 1.0, 0.3], "driven": {}},
            ],
            "elements": [
                {"kind": "hydrostatics", "link": "arm"},
                {"kind": "drag", "link": "block", "area_m2": [0.01, 0.02, 0.03], "at_m": [0.05, 0.02, 0.03]},
            ],
        },
    }  # fmt: skip
    return MultibodyModel(robot_format.schema_of().model_validate(robot))


def beaten(model: MultibodyModel, time: np.ndarray, **values: float) -> dict[str, np.ndarray]:
    swim = SwimInput(drives.TailBeat("sine", 1.2, 0.4), pose=(0.3, -0.2, 0.1, 0.2, -0.3, 2.5))
    known = np.array([values.get(p.name, p.start) for p in model.parameters])
    return model.simulate(known, Trial("t", "fit", time, {}, swim=swim))


@pytest.mark.slow
def test_a_load_cell_measures_about_the_reference_point() -> None:
    """At rest the cell has the weight of the arm; the torque about another point differs by r x F."""
    time, at = np.arange(0.0, 1.5, 0.02), np.array([0.1, -0.05, 0.2])

    def measured(reference: list[float]) -> tuple[np.ndarray, np.ndarray]:
        found = beaten(armed("fixed", reference), time)
        force, torque = ([found[f"{word}"] for word in words] for words in np.split(np.array(NAMES), 2))
        return np.transpose(force), np.transpose(torque)

    force, torque = measured([0.0, 0.0, 0.0])
    moved_force, moved_torque = measured(at.tolist())
    np.testing.assert_allclose(moved_force, force, atol=1e-12)
    np.testing.assert_allclose(moved_torque, torque - np.cross(at, force), atol=1e-12)
    np.testing.assert_allclose(force[0], [0.0, 0.0, -0.2 * G], atol=1e-9)
    np.testing.assert_allclose(torque[0], np.cross([-0.15, 0.03, 0.01], force[0]), atol=1e-9)
    assert np.ptp(force, axis=0).min() > 0.05


NAMES = [f"{word}_{axis}_{unit}" for word, unit in (("force", "N"), ("torque", "N_m")) for axis in "xyz"]


def test_velocities_and_rates_are_the_derivatives_of_the_pose() -> None:
    """At the reference point, in the axes of the body; positive pitch raises the nose."""
    time = np.arange(0.0, 1.0, 0.002)
    begun = {"surge": 0.3, "sway": -0.1, "heave": 0.2, "roll_rate": 0.5, "pitch_rate": -0.4, "yaw_rate": 0.7}
    values = {f"initial_{name}": value for name, value in begun.items()}
    moved = {"start_x": 0.01, "start_y": -0.02, "start_z": 0.03, "start_yaw": 0.1}
    found = beaten(armed("free", [0.1, -0.05, 0.2]), time, **values, **moved)
    place, body, rates = (
        np.column_stack([found[name] for name in names])
        for names in (
            ("x_m", "y_m", "z_m"),
            ("u_m_s", "v_m_s", "w_m_s"),
            ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s"),
        )
    )
    turn = Rotation.from_euler(
        "ZYX", np.column_stack([found["yaw_rad"], -found["pitch_rad"], found["roll_rad"]])
    )
    np.testing.assert_allclose(place[0], [0.31, -0.22, 0.13], atol=1e-12)
    np.testing.assert_allclose([*body[0], *rates[0]], list(begun.values()), atol=1e-12)
    angles = [found[name][0] for name in ("roll_rad", "pitch_rad", "yaw_rad")]
    np.testing.assert_allclose(angles, [0.2, -0.3, 2.6], atol=1e-12)
    # central differences: the third derivative times the square of the step over 6
    np.testing.assert_allclose(turn.apply(body)[1:-1], (place[2:] - place[:-2]) / 0.004, atol=1e-3)
    spin = (turn[:-2].inv() * turn[2:]).as_rotvec() / 0.004
    np.testing.assert_allclose(rates[1:-1] * [1, -1, 1], spin, atol=1e-2)
    assert np.ptp(rates, axis=0).min() > 0.2
