"""Robots with inputs: a vehicle against Fossen's equations, measured torques, and bad inputs."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from swimid.errors import InputError
from swimid.fitting.model import SwimInput, Trial
from swimid.logs import log
from swimid.results import parameters
from swimid.robots import file as robot_format
from swimid.swimmer.trials import robot_model
from tests.generators import vehicle
from tests.generators.files import write_log, write_trials
from tests.generators.vehicle import Vehicle

#: A vehicle whose buoyancy keeps it upright, 5 cm above the centre of mass.
UPRIGHT = Vehicle(buoyancy_m=(0.0, 0.0, -0.05))


def _inputs(
    thrusts: Callable[[float], np.ndarray], names: Sequence[str] = [f"thruster{k + 1}" for k in range(8)]
) -> SwimInput:
    def of(k: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda time_s: np.array([thrusts(float(t))[k] for t in time_s])

    return SwimInput(inputs={name: of(k) for k, name in enumerate(names)}, pose=(0.0,) * 6)


def _robot(**inputs: object) -> robot_format.Robot:
    """Return the robot file of the vehicle with other laws of its inputs."""
    robot = robot_format.read("bluerov2")
    body = robot.multibody
    assert body is not None
    laws = {name: law.model_copy(update=inputs) for name, law in body.inputs.items()}
    return robot.model_copy(update={"multibody": body.model_copy(update={"inputs": laws})})


@pytest.mark.parametrize("truth", [Vehicle(), vehicle.BLIMP], ids=lambda v: v.robot)
def test_vehicle_moves_as_by_the_equations_of_fossen(truth):
    robot, model = robot_model(truth.robot)
    assert robot.multibody is not None
    thrusts, time = vehicle.manoeuvre(np.random.default_rng(1), truth), np.arange(0.0, 10.01, 0.05)
    expected = vehicle.columns(time, vehicle.simulate(truth, time, thrusts), thrusts, truth.inputs)
    values = np.array([p.start for p in model.parameters])

    swim = _inputs(thrusts, list(robot.multibody.inputs))
    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    for name in (*model.pose, *model.velocity):
        assert found[name] == pytest.approx(expected[name], abs=1e-5)


def test_law_of_an_actuator():
    from swimid.swimmer.spatial.model import MultibodyModel

    # dead band 2, square law, half the thrust in reverse, first-order lag of 0.3 s
    model = MultibodyModel(_robot(dead_band=2.0, power=2.0, reverse=0.5, lag_s=0.3))
    thrusts, time = vehicle.manoeuvre(np.random.default_rng(2)), np.arange(0.0, 8.01, 0.05)

    def acted(now: float) -> np.ndarray:
        command = thrusts(now)
        size = np.clip(np.abs(command) - 2.0, 0.0, None) ** 2
        return np.where(command < 0.0, -0.5, 1.0) * size

    expected = vehicle.columns(time, vehicle.simulate(Vehicle(lag_s=0.3), time, acted), thrusts)
    values = np.array([p.start for p in model.parameters])

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=_inputs(thrusts)))

    # the corners of the dead band lie between the steps of the integration
    for name in model.pose:
        assert found[name] == pytest.approx(expected[name], abs=2e-4 * max(np.ptp(expected[name]), 1.0))


#: A vehicle with propellers whose thrust falls with the speed of advance.
ADVANCING = replace(UPRIGHT, slope=0.35)


def _rates(thrusts: Callable[[float], np.ndarray]) -> Callable[[float], np.ndarray]:
    """Return the rates (1/s) at which the propellers have these thrusts at rest."""
    static = 1000.0 * vehicle.DIAMETER_M**4 * vehicle.K_0
    return lambda now: np.sign(thrusts(now)) * np.sqrt(np.abs(thrusts(now)) / static)


def _with_propellers() -> robot_format.Robot:
    """Return the robot file of the vehicle with propellers in place of loads. Its inputs are their rates."""
    robot = robot_format.read("bluerov2")
    assert robot.multibody is not None
    told = robot.model_dump(exclude_none=True)
    body = told["multibody"]
    for k, element in enumerate(e for e in body["elements"] if e["kind"] == "load"):
        direction = vehicle.DIRECTIONS[k] * (1.0, -1.0, -1.0)
        element.update(kind="propeller", axis=tuple(direction), diameter_m=vehicle.DIAMETER_M)
        element["thrust_coefficients"] = [f"{vehicle.K_0} * k_t", "k_j"]
        for key in ("force_N", "moment_N_m", "frame"):
            element.pop(key)
    body["coefficients"] |= {
        "k_t": {"value": 1.0, "bounds": (0.2, 3.0), "start": 1.2},
        "k_j": {"value": -ADVANCING.slope, "bounds": (-2.0, 2.0), "start": -0.1, "scale": 0.2},
    }
    for law, name in zip(body["inputs"].values(), ADVANCING.inputs, strict=True):
        law["column"] = name.replace("thrust", "rate").replace("_N", "_1_s")
    return robot_format.schema_of().model_validate(told)


@pytest.mark.parametrize("kind", ["propellers", "effect"])
def test_thrust_that_falls_with_the_speed_of_advance(kind):
    from swimid.effects.fluid import ThrustLoss
    from swimid.fitting.model import NONE
    from swimid.swimmer.spatial.model import MultibodyModel

    thrusts, time = vehicle.manoeuvre(np.random.default_rng(11)), np.arange(0.0, 8.01, 0.05)
    expected = vehicle.columns(time, vehicle.simulate(ADVANCING, time, thrusts), thrusts)
    robot = robot_format.read("bluerov2") if kind == "effect" else _with_propellers()
    model, hooks = MultibodyModel(robot), NONE
    truth = {"z_b": 0.05, "k_t": 1.0, "k_j": -ADVANCING.slope}
    values = np.array([truth.get(p.name, p.start) for p in model.parameters])
    trial = Trial("run", "fit", time, {}, swim=_inputs(thrusts if kind == "effect" else _rates(thrusts)))
    if kind == "effect":
        loss = ADVANCING.slope * vehicle.DIAMETER_M * np.sqrt(1000.0 / vehicle.K_0)
        hooks = ThrustLoss().hooks(np.array([loss]), trial, model)

    found = model.simulate_hooked(values, trial, hooks)

    for name in model.pose:
        # the thrust has corners where it changes its sign, between the steps of the integration
        assert found[name] == pytest.approx(expected[name], abs=5e-4 * max(np.ptp(expected[name]), 1.0)), name


@pytest.mark.slow
def test_fit_of_propellers(swimid, tmp_path):
    """The slope of the thrust coefficient follows from the rates of the propellers.

    The thrust at rest is known, because added masses and drag may take up any factor on all forces.
    """
    rng = np.random.default_rng(12)
    robot = yaml.safe_dump(_with_propellers().model_dump(mode="json", exclude_none=True))
    (tmp_path / "rov.yaml").write_text(robot)
    lines = []
    for k in range(2):
        time, thrusts = np.arange(0.0, 15.01, 0.05), vehicle.manoeuvre(rng)
        motion = vehicle.simulate(ADVANCING, time, thrusts)
        names = tuple(f"rate{n + 1}_1_s" for n in range(8))
        found = vehicle.columns(time, motion, _rates(thrusts), names)
        kept = {n: v for n, v in found.items() if n in ("t_s", *vehicle.NOISE, *names)}
        for name, sd in vehicle.NOISE.items():
            kept[name] = kept[name] + rng.normal(0.0, sd, len(time))
        write_log(tmp_path / f"run{k}.csv", kept)
        lines.append(f"log: run{k}.csv")
    write_trials(tmp_path / "trials.yaml", "multibody", "rov.yaml", lines)

    ran = swimid("fit-graybox", tmp_path / "trials.yaml", "--fix", "k_t=1", "-o", tmp_path / "vehicle.yaml")

    assert ran.status == 0, ran.err
    found = parameters.read(tmp_path / "vehicle.yaml").parameters["k_j"]
    assert found.status == "estimated"
    assert found.value == pytest.approx(-ADVANCING.slope, abs=4.0 * found.stderr)
    assert found.stderr < 0.1 * ADVANCING.slope


@pytest.mark.slow
def test_fit_of_a_vehicle(swimid, tmp_path):
    trials = vehicle.write_trials(tmp_path, UPRIGHT, seed=3, trials=2, held_out=0, duration_s=15.0)

    ran = swimid("fit-graybox", trials, "-o", tmp_path / "vehicle.yaml")

    assert ran.status == 0, ran.err
    found = parameters.read(tmp_path / "vehicle.yaml").parameters
    truth = {f"m_{c}": v for c, v in zip("xyz", UPRIGHT.added[:3], strict=True)}
    truth |= {f"i_{c}": v for c, v in zip("xyz", UPRIGHT.added[3:], strict=True)}
    truth |= {f"q_{c}": v for c, v in zip("xyzpqr", UPRIGHT.quadratic, strict=True)}
    truth |= {"volume": UPRIGHT.volume_m3, "z_b": 0.05, "d_x": 13.7, "d_z": 33.0, "d_q": 0.8}
    for name, value in truth.items():
        assert found[name].value == pytest.approx(value, rel=0.03), name
        assert found[name].value == pytest.approx(value, abs=4.0 * found[name].stderr), name


@pytest.mark.slow
def test_all_thrusts_and_masses_together_are_not_identifiable(swimid, tmp_path):
    trials = vehicle.write_trials(tmp_path, UPRIGHT, seed=4, trials=2, held_out=0, duration_s=15.0)
    free = [word for k in range(1, 9) for word in ("--free", f"k_{k}")]

    ran = swimid("fit-graybox", trials, "--free", "mass", *free, "-o", tmp_path / "vehicle.yaml")

    # all forces may be multiplied by one factor
    assert ran.status in (0, 4)
    found = parameters.read(tmp_path / "vehicle.yaml").parameters
    assert found["mass"].status == "unidentifiable"


CHANGES = {
    "thruster": (replace(UPRIGHT, thrust=(1, 1, 0.8, 1, 1, 1, 1, 1)), "parameter:k_3", {"k_3": 0.8}),
    "mass": (replace(UPRIGHT, mass_kg=1.05 * 13.5), "parameter:mass", {"mass": 1.05 * 13.5}),
    "centre of mass": (replace(UPRIGHT, com_m=(0.02, 0.0, 0.0)), "com-offset", {"along_m": 0.02}),
    "current": (replace(UPRIGHT, current_m_s=(0.1, 0.05, 0.0)), "current", {"cx_m_s": 0.1, "cy_m_s": -0.05}),
    "lag": (replace(UPRIGHT, lag_s=0.15), "servo-lag", {"time_constant_s": 0.15}),
    "advance": (
        replace(UPRIGHT, slope=0.35),
        "thrust-loss",
        {"loss_kg05_m05": 0.35 * vehicle.DIAMETER_M * np.sqrt(1000.0 / vehicle.K_0)},
    ),
    "none": (UPRIGHT, None, {}),
}


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Parameters of the vehicle from an earlier day."""
    import swimid as library

    folder = tmp_path_factory.mktemp("vehicle")
    trials = vehicle.write_trials(folder, UPRIGHT, seed=5)
    library.fit_graybox(trials, output=folder / "vehicle.yaml")
    return folder / "vehicle.yaml"


@pytest.mark.slow
@pytest.mark.parametrize("case", CHANGES)
def test_diagnosis_of_a_vehicle(case, fitted, swimid, tmp_path):
    truth, cause, sizes = CHANGES[case]
    trials = vehicle.write_trials(tmp_path, truth, seed=20 + list(CHANGES).index(case))

    ran = swimid("diagnose", trials, "--params", fitted, "-o", tmp_path / "gap.yaml", "--json")

    found = ran.json["result"]
    if cause is None:
        assert (found["verdict"], found["causes"]) == ("none", [])
        return
    assert found["verdict"] == "explained"
    assert [one["effect"] for one in found["causes"]] == [cause]
    for name, value in sizes.items():
        estimate = found["causes"][0]["parameters"][name]
        assert estimate["value"] == pytest.approx(value, abs=3.0 * estimate["stderr"] + 0.002 * abs(value))
        assert estimate["stderr"] < 0.05 * abs(value)


PENDULUM = """
format: swimid-robot/1
name: pendulum
multilink:
  plane: horizontal
  base: fixed
  coefficients:
    k: {value: 0.30, unit: N m/rad, bounds: [0, 5], meaning: stiffness of the spring}
    c: {value: 0.02, unit: N m s/rad, bounds: [0, 1], scale: 0.02, meaning: damping of the hinge}
    g: {value: 1.0, bounds: [0, 5], meaning: torque for a current of 1 A}
  inputs:
    motor: {column: motor_A}
  links:
    - {name: frame, length_m: 0.1, mass_kg: 1.0, com_m: 0.05, inertia_kg_m2: 1.0e-2, inertia_about: com}
    - {name: arm, length_m: 0.2, mass_kg: 0.5, com_m: 0.1, inertia_kg_m2: 2.0e-3, inertia_about: com}
  joints:
    - name: hinge
      parent: frame
      child: arm
      passive: {stiffness_N_m_rad: k, damping_N_m_s_rad: c}
      torque: {input: motor, gain_N_m: g}
"""


def _swings(time: np.ndarray, torque: Callable[[float], float]) -> np.ndarray:
    """Return the angle of an arm of 0.007 kg m2 about its hinge with a spring and a damper, by SciPy."""
    inertia, stiffness, damping = 2.0e-3 + 0.5 * 0.1**2, 0.30, 0.02

    def slope(now: float, state: np.ndarray) -> list[float]:
        angle, rate = state
        return [rate, (torque(now) - stiffness * angle - damping * rate) / inertia]

    found = solve_ivp(slope, (time[0], time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, max_step=0.01)
    return np.asarray(found.y[0])


def test_bench_driven_by_a_measured_torque(swimid, tmp_path):
    rng = np.random.default_rng(6)
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    rows = []
    time = np.arange(0.0, 10.0, 0.01)
    for k, frequency in enumerate((0.6, 1.1, 1.7)):
        current = 0.2 * np.sin(2.0 * np.pi * frequency * time) + 0.1 * np.sin(2.0 * np.pi * 0.31 * time)
        angle = _swings(time, lambda now, c=current: float(np.interp(now, time, c)))
        write_log(
            tmp_path / f"run{k}.csv",
            {"t_s": time, "joint1_rad": angle + rng.normal(0.0, 0.002, len(time)), "motor_A": current},
        )
        rows.append(f"log: run{k}.csv, start_state: rest")
    write_trials(tmp_path / "trials.yaml", "free-swim", "pendulum.yaml", rows)

    ran = swimid("fit-graybox", tmp_path / "trials.yaml", "-o", tmp_path / "bench.yaml")

    assert ran.status == 0, ran.err
    found = parameters.read(tmp_path / "bench.yaml").parameters
    for name, value in {"k": 0.30, "c": 0.02, "g": 1.0}.items():
        assert found[name].value == pytest.approx(value, abs=3.0 * found[name].stderr)
        assert found[name].stderr < 0.02 * value


def test_torque_between_links_does_not_turn_the_whole(tmp_path):
    # without water, the total momentum of a free robot stays zero
    text = PENDULUM.replace("base: fixed", "base: free")
    (tmp_path / "free.yaml").write_text(text)
    _, model = robot_model(str(tmp_path / "free.yaml"))
    time = np.linspace(0.0, 1.0, 101)
    swim = SwimInput(inputs={"motor": lambda t: 0.2 * np.sin(5.0 * t)}, pose=(0.0, 0.0, 0.0))
    values = np.array([p.start for p in model.parameters])

    found = model.simulate(values, Trial("run", "fit", time, {}, swim=swim))

    heading, joint = found["yaw_rad"], found["joint1_rad"]
    front = np.column_stack([found["x_m"], found["y_m"]])
    centre_frame = front - 0.05 * np.column_stack([np.cos(heading), np.sin(heading)])
    hinge = front - 0.1 * np.column_stack([np.cos(heading), np.sin(heading)])
    centre_arm = hinge - 0.1 * np.column_stack([np.cos(heading + joint), np.sin(heading + joint)])
    centre = (1.0 * centre_frame + 0.5 * centre_arm) / 1.5
    assert np.ptp(joint) > 0.1
    assert centre == pytest.approx(np.tile(centre[0], (len(time), 1)), abs=1e-7)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("torque: {input: motor", "torque: {input: moter", "did you mean 'motor'"),
        (
            "      passive: {stiffness_N_m_rad: k, damping_N_m_s_rad: c}\n",
            "",
            "has a torque but is not passive",
        ),
        ("gain_N_m: g", "gain_N_m: h", "the robot has no coefficient 'h'"),
    ],
)
def test_faults_of_a_robot_with_inputs(old, new, said, tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(PENDULUM.replace(old, new))

    with pytest.raises(InputError) as caught:
        robot_model(str(path))

    assert said in str(caught.value) + str(caught.value.hint)


def test_faults_of_logs_with_inputs(swimid, tmp_path):
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    head = "format: swimid-trials/1\nexperiment: free-swim\nrobot: pendulum.yaml\ntrials:\n  - {log: a.csv}\n"
    (tmp_path / "trials.yaml").write_text(head)
    rows = "".join(f"{0.01 * k:.2f},{0.001 * (k % 7)}\n" for k in range(100))
    (tmp_path / "a.csv").write_text("t_s,joint1_rad\n" + rows)

    ran = swimid("fit-graybox", tmp_path / "trials.yaml", "-o", tmp_path / "fit.yaml")
    assert ran.status == 3
    assert "a.csv" in ran.err
    assert "motor_A" in ran.err

    ran = swimid("simulate", "--robot", tmp_path / "pendulum.yaml", "--duration-s", "5")
    assert ran.status == 2
    assert "--input" in ran.err
    assert "motor_A" in ran.err


def test_simulation_with_recorded_inputs(swimid, tmp_path):
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    time = np.arange(0.0, 3.0, 0.01)
    current = 0.2 * np.sin(4.0 * time)
    write_log(tmp_path / "motor.csv", {"t_s": time, "motor_A": current})

    ran = swimid(
        "simulate", "--robot", tmp_path / "pendulum.yaml", "--input", tmp_path / "motor.csv",
        "-o", tmp_path / "sim.csv",
    )  # fmt: skip

    assert ran.status == 0, ran.err
    found = log.read(tmp_path / "sim.csv")
    assert found["joint1_rad"] == pytest.approx(
        _swings(time, lambda t: float(np.interp(t, time, current))), abs=1e-5
    )


@pytest.mark.parametrize("target", ["json", "mjcf", "gazebo"])
def test_export_names_the_loads_that_it_leaves_out(target, swimid, tmp_path):
    (tmp_path / "pendulum.yaml").write_text(PENDULUM)
    (tmp_path / "params.yaml").write_text(
        "format: swimid-parameters/1\nmodel: multilink\nrobot: pendulum.yaml\n"
        "parameters:\n  k: {value: 0.3, stderr: 0.001, unit: N m/rad, status: estimated}\n"
    )

    ran = swimid("export", tmp_path / "params.yaml", "--to", target, "-o", tmp_path / "out.xml")

    assert ran.status == 0
    assert "the loads of the input motor are left out" in " ".join(ran.err.split())


def _sdf_motion(text: str, time: np.ndarray, thrusts: Callable[[float], np.ndarray]) -> np.ndarray:
    """Integrate an SDF vehicle by SciPy, and return position and rotation vector of the robot, shape (n, 6).

    The laws are those of Gazebo: Newton's and Euler's equations with the added mass at the link, the plugins
    Hydrodynamics and Thruster, and the system Buoyancy.
    """
    model = ET.fromstring(text[text.index("<sdf") :]).find("model")
    assert model is not None
    hull = model.find("link")
    assert hull is not None

    def numbers(node: ET.Element | None) -> np.ndarray:
        return np.array([float(part) for part in (node.text or "").split()])  # type: ignore[union-attr]

    def matrix(parent: ET.Element | None, letters: str, form: str) -> np.ndarray:
        found = np.zeros((len(letters), len(letters)))
        for i, a in enumerate(letters):
            for j, b in enumerate(letters[i:], start=i):
                found[i, j] = found[j, i] = float(parent.find(form.format(a, b)).text)  # type: ignore
        return found

    inertial = hull.find("inertial")
    mass = float(inertial.find("mass").text)  # type: ignore[union-attr,arg-type]
    total = matrix(inertial.find("fluid_added_mass"), "xyzpqr", "{}{}")  # type: ignore[union-attr]
    total[:3, :3] += mass * np.eye(3)
    total[3:, 3:] += matrix(inertial.find("inertia"), "xyz", "i{}{}")  # type: ignore[union-attr]
    centre = numbers(hull.find("pose"))[:3]
    boxes = [
        (numbers(c.find("pose"))[:3], np.prod(numbers(c.find(".//size")))) for c in hull.findall("collision")
    ]
    places = {link.attrib["name"]: numbers(link.find("pose"))[:3] for link in model.findall("link")[1:]}
    places[hull.attrib["name"]] = np.zeros(3)
    drags = []
    for plugin in [p for p in model.findall("plugin") if "Hydrodynamics" in p.attrib["name"]]:
        tags = {one.tag: one.text for one in plugin}
        coefficients = [
            [float(tags.get(name, 0.0)) for name in names]
            for names in (
                [f + v for f, v in zip("xyzkmn", "UVWPQR", strict=True)],
                [f"{f}{v}abs{v}" for f, v in zip("xyzkmn", "UVWPQR", strict=True)],
            )
        ]
        drags.append((places[tags["link_name"]], *np.array(coefficients)))
    joints = [j for j in model.findall("joint") if j.attrib["type"] == "revolute"]
    mixing = []
    for joint in joints:
        axis, place = numbers(joint.find("axis/xyz")), places[str(joint.findtext("child"))]
        mixing.append(np.concatenate([axis, np.cross(place, axis)]))

    def slope(now: float, state: np.ndarray) -> np.ndarray:
        turn = Rotation.from_quat(state[3:7]).as_matrix()
        v, w = state[7:10], state[10:13]
        nu = state[7:13]
        momentum = total @ nu
        force = np.array(mixing).T @ thrusts(now)
        for place, linear, quadratic in drags:
            local = np.concatenate([v + np.cross(w, place), w])
            drag = (linear + quadratic * np.abs(local)) * local
            force += np.concatenate([drag[:3], drag[3:] + np.cross(place, drag[:3])])
        force[:3] -= np.cross(w, momentum[:3])
        force[3:] -= np.cross(w, momentum[3:]) + np.cross(v, momentum[:3])
        force[:3] += turn.T @ [0.0, 0.0, -mass * 9.82]
        for place, volume in boxes:
            lift = turn.T @ [0.0, 0.0, 1000.0 * 9.82 * volume]
            force += np.concatenate([lift, np.cross(place, lift)])
        x, y, z, c = state[3:7]
        p, q, r = w
        quaternion = 0.5 * np.array(
            [c * p + y * r - z * q, c * q + z * p - x * r, c * r + x * q - y * p, -x * p - y * q - z * r]
        )
        return np.concatenate([turn @ v, quaternion, np.linalg.solve(total, force)])

    begin = np.zeros(13)
    begin[:3], begin[6] = centre, 1.0
    found = solve_ivp(
        slope, (time[0], time[-1]), begin, "DOP853", time, rtol=1e-9, atol=1e-10, max_step=0.05
    ).y.T
    turns = Rotation.from_quat(found[:, 3:7])
    return np.hstack([found[:, :3] - turns.apply(centre), turns.as_rotvec()])


def test_exported_vehicle_moves_as_the_model(swimid, tmp_path):
    # the centre of mass is not at the origin, and drag acts at another point
    text = robot_format.locate("bluerov2").read_text()
    text = text.replace(
        "{name: hull, mass_kg: mass,", "{name: hull, mass_kg: mass, com_m: [0.02, 0.01, -0.03],"
    )
    (tmp_path / "rov.yaml").write_text(text)
    (tmp_path / "params.yaml").write_text(
        "format: swimid-parameters/1\nmodel: multibody\nrobot: rov.yaml\n"
        "parameters:\n  q_x: {value: 130.0, stderr: 1.0, unit: N s2/m2, status: estimated}\n"
    )
    _, model = robot_model(str(tmp_path / "rov.yaml"))
    values = np.array([{"q_x": 130.0}.get(p.name, p.start) for p in model.parameters])
    thrusts, time = vehicle.manoeuvre(np.random.default_rng(8)), np.arange(0.0, 6.01, 0.05)

    ran = swimid("export", tmp_path / "params.yaml", "--to", "gazebo", "-o", tmp_path / "rov.sdf")

    assert ran.status == 0, ran.err
    found = _sdf_motion((tmp_path / "rov.sdf").read_text(), time, thrusts)
    expected = model.simulate(values, Trial("run", "fit", time, {}, swim=_inputs(thrusts)))
    for k, name in enumerate(model.pose[:3]):
        assert found[:, k] == pytest.approx(expected[name], abs=2e-4), name
    # pitch is positive nose up, against the rotation about y
    turn = Rotation.from_euler(
        "ZYX", np.column_stack([expected["yaw_rad"], -expected["pitch_rad"], expected["roll_rad"]])
    )
    assert (turn.inv() * Rotation.from_rotvec(found[:, 3:])).magnitude().max() < 1e-3


def test_vehicle_has_only_the_format_of_gazebo(swimid, tmp_path):
    (tmp_path / "params.yaml").write_text(
        "format: swimid-parameters/1\nmodel: multibody\nrobot: bluerov2\n"
        "parameters:\n  q_x: {value: 130.0, stderr: 1.0, unit: N s2/m2, status: estimated}\n"
    )
    ran = swimid("export", tmp_path / "params.yaml", "--to", "mjcf", "-o", tmp_path / "rov.xml")
    assert ran.status == 2
    assert "--to gazebo" in ran.err


def _bag(folder: Path, rng: np.random.Generator, duration_s: float) -> Path:
    """Write a bag of ROS 2 with odometry at 20 Hz and thrusts at 50 Hz, as the rosbags library writes it."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    make = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    thrusts, time = vehicle.manoeuvre(rng), np.arange(0.0, duration_s, 0.05)
    seen = vehicle.columns(time, vehicle.simulate(UPRIGHT, time, thrusts), thrusts)
    for name, sd in vehicle.NOISE.items():
        seen[name] = seen[name] + rng.normal(0.0, sd, len(time))
    # the sign of pitch in ROS is that of a rotation about y, to port
    angles = np.column_stack([seen["yaw_rad"], -seen["pitch_rad"], seen["roll_rad"]])
    turns = Rotation.from_euler("ZYX", angles).as_quat()
    still = make["Vector3"](0.0, 0.0, 0.0)
    twist = make["TwistWithCovariance"](make["Twist"](still, still), np.zeros(36))
    begin = 1_700_000_000_000_000_000
    with rosbag2.Writer(folder / "bag", version=8) as bag:
        odometry = bag.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
        array = bag.add_connection("/thrusts", "std_msgs/msg/Float64MultiArray", typestore=store)
        for now in np.arange(0.0, duration_s, 0.02):
            layout = make["MultiArrayLayout"]([], 0)
            message = make["Float64MultiArray"](layout, thrusts(float(now)))
            data = store.serialize_cdr(message, "std_msgs/msg/Float64MultiArray")
            bag.write(array, begin + round(1e9 * now), data)
        for k, now in enumerate(time):
            stamp = begin + round(1e9 * now)
            header = make["Header"](make["Time"](stamp // 10**9, stamp % 10**9), "world")
            place = make["Point"](*(float(seen[name][k]) for name in ("x_m", "y_m", "z_m")))
            pose = make["PoseWithCovariance"](
                make["Pose"](place, make["Quaternion"](*turns[k])), np.zeros(36)
            )
            message = make["Odometry"](header, "hull", pose, twist)
            bag.write(odometry, stamp + 2_000_000, store.serialize_cdr(message, "nav_msgs/msg/Odometry"))
    return next((folder / "bag").glob("*.db3"))


BAG_MAPPING = """
format: swimid-mapping/1
as: ros2
select: /odom
join:
  - as: db3
    select: /thrusts
    time: {source: log_time}
    columns:
"""


def test_bag_becomes_a_log_with_the_thrusts(swimid, tmp_path):
    path = _bag(tmp_path, np.random.default_rng(9), 5.0)
    lines = "".join(f'      - {{source: "data[{k}]", target: thrust{k}_N, unit: N}}\n' for k in range(1, 9))
    (tmp_path / "map.yaml").write_text(BAG_MAPPING + lines)

    ran = swimid("import", path, "--map", tmp_path / "map.yaml", "--raw", "-o", tmp_path / "run.csv")

    assert ran.status in (0, 4), ran.err
    found, thrusts = log.read(tmp_path / "run.csv"), vehicle.manoeuvre(np.random.default_rng(9))
    expected = np.array([thrusts(float(t)) for t in found.time_s])
    inside = found.time_s < 4.9
    for k in range(8):
        # the thrusts are interpolated over 0.02 s
        assert found[f"thrust{k + 1}_N"][inside] == pytest.approx(expected[inside, k], abs=5e-3)


def test_joined_table_of_another_time_is_refused(swimid, tmp_path):
    rows = "".join(f"{0.1 * k:.1f},{0.01 * k:.3f}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("t,x\n" + rows)
    late = "".join(f"{100 + 0.1 * k:.1f},{k}\n" for k in range(60))
    (tmp_path / "b.csv").write_text("t,f\n" + late)
    (tmp_path / "map.yaml").write_text(
        "format: swimid-mapping/1\ntime: {source: t}\ncolumns: [{source: x, target: x_m, unit: m}]\n"
        "join:\n  - {file: b.csv, time: {source: t}, columns: [{source: f, target: force_N, unit: N}]}\n"
    )

    ran = swimid("import", tmp_path / "a.csv", "--map", tmp_path / "map.yaml", "-o", tmp_path / "run.csv")

    assert ran.status == 3
    assert "b.csv" in ran.err
    assert "none of the 60 samples lies within the log" in " ".join(ran.err.split())


def test_export_names_a_lag_of_the_thrusters(swimid, tmp_path):
    (tmp_path / "params.yaml").write_text(
        "format: swimid-parameters/1\nmodel: multibody\nrobot: bluerov2\neffects: [servo-lag]\n"
        "parameters:\n  servo-lag/time_constant_s: {value: 0.15, stderr: 0.01, unit: s, status: estimated}\n"
    )

    ran = swimid("export", tmp_path / "params.yaml", "--to", "gazebo", "-o", tmp_path / "rov.sdf")

    assert ran.status == 0, ran.err
    assert "servo-lag acts on the commands of the thrusters, and is left out" in " ".join(ran.err.split())
    assert [path.name for path in tmp_path.glob("*.py")] == []
