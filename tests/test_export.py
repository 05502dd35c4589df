"""Exports: MuJoCo moves as the engine does, derivatives of Gazebo resist, and JSON has every number."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.exporters import mjcf
from swimid.exporters.export import load
from swimid.exporters.source import ExportSource, central
from swimid.files import yamlio
from swimid.fitting import drives
from swimid.fitting.model import SwimInput, Trial
from swimid.results import parameters
from swimid.results.parameters import Correlation, Estimate, ParameterFile
from swimid.robots import file as robot
from swimid.swimmer.planar.engine import PLANAR_ENGINE as engine
from swimid.swimmer.planar.model import MultilinkModel
from tests.conftest import Ran

#: A branched tree with every kind of joint; its elements are inserted.
TREE = """
format: swimid-robot/1
name: tree
fluid: {density_kg_m3: 1000}
multilink:
  plane: PLANE
  coefficients:
    c_a: {value: 0.8}
    k: {value: 0.5, unit: N m/rad}
  links:
    - name: trunk
      length_m: 0.2
      mass_kg: 1.1
      com_m: 0.09
      com_offset_m: 0.01
      inertia_kg_m2: 0.004
      inertia_about: com
    - {name: left, length_m: 0.1, mass_kg: 0.3, com_m: 0.04, inertia_kg_m2: 4.0e-4, inertia_about: com}
    - name: right
      length_m: 0.1
      mass_kg: 0.2
      com_m: 0.05
      com_offset_m: -0.004
      inertia_kg_m2: 9.0e-4
      inertia_about: front
    - {name: plate, length_m: 0.05, mass_kg: 0.1, com_m: 0.02, inertia_kg_m2: 3.0e-5, inertia_about: com}
    - {name: tip, length_m: 0.08, mass_kg: 0.1, com_m: 0.03, inertia_kg_m2: 8.0e-5, inertia_about: com}
  joints:
    - {name: j1, parent: trunk, child: left, mount_deg: 20, driven: {servo: {natural_frequency_hz: 8}}}
    - name: j2
      parent: trunk
      child: right
      at_m: 0.15
      offset_m: 0.02
      mount_deg: -30
      passive:
        stiffness_N_m_rad: k
        cubic_N_m_rad3: 2.0
        damping_N_m_s_rad: 0.01
        quadratic_damping_N_m_s2_rad2: 0.003
        rest_deg: 5
    - {name: j3, parent: left, child: plate, mount_deg: 10}
    - name: j4
      parent: plate
      child: tip
      mount_deg: 15
      passive: {tendon: {spring_N_m: 60, pretension_m: PRETENSION, arm_m: 0.03, crank_m: 0.02}}
  elements:
ELEMENTS
"""
WATER = """
    - kind: added-mass
      link: trunk
      surge_kg: 1.5 * c_a
      sway_kg: 1.5 * c_a
      inertia_kg_m2: 0.002
      at_m: 0.12
      offset_m: 0.005
    - {kind: added-mass, link: tip, surge_kg: 0.2 * c_a, sway_kg: 0.2 * c_a, inertia_kg_m2: 1.0e-4}
    - kind: drag
      link: trunk
      axial_area_m2: 0.01
      axial_coefficient: 0.1
      normal_area_m2: 0.02
      normal_coefficient: 1.2
      normal_linear_N_s_m: 0.3
      offset_m: 0.01
      strips: 4
    - {kind: damping, link: left, linear_N_m_s_rad: 0.002, quadratic_N_m_s2_rad2: 0.001}
    - kind: foil
      link: tip
      area_m2: 0.004
      at_m: 0.05
      offset_m: 0.002
      chord_deg: 12
      lift_coefficient: 1.1
      drag_coefficient_0: 0.05
      drag_coefficient_1: 1.3
    - {kind: force, link: right, at_m: 0.03, forward_N: 0.2, port_N: -0.1}
    - {kind: force, link: plate, at_m: 0.02, forward_N: -0.1, port_N: 0.3, frame: world}
    - {kind: hydrostatics, link: trunk, volume_m3: 0.0011, buoyancy_at_m: 0.08}
    - {kind: trailing-edge, link: tip, added_mass_kg_m: 2.5, offset_m: 0.003}
"""
#: The same added mass, but other forward than sideways.
DIRECTIONAL = WATER.replace("surge_kg: 1.5 * c_a", "surge_kg: 0.2 * c_a").replace("surge_kg: 0.2 * c_a, ", "")
#: One body whose centre of mass is the origin of its frame, where MuJoCo has a diagonal mass matrix.
PLATE = """
format: swimid-robot/1
name: plate
fluid: {density_kg_m3: 1000}
multilink:
  plane: PLANE
  coefficients: {c_a: {value: 0.8}}
  links: [{name: plate, length_m: 0.1, mass_kg: 1.0, com_m: 0, inertia_kg_m2: 0.004, inertia_about: com}]
  elements: [{kind: added-mass, link: plate, sway_kg: c_a}]
"""
#: A slender robot whose added mass acts across its links only.
SLENDER = """
format: swimid-robot/1
name: slender
fluid: {density_kg_m3: 997}
multilink:
  plane: horizontal
  coefficients: {c_a: {value: 1.0}}
  links:
    - {name: head, length_m: 0.2, mass_kg: 1.0, com_m: 0.1, inertia_kg_m2: 0.004, inertia_about: com}
    - {name: mid, length_m: 0.1, mass_kg: 0.3, com_m: 0.05, inertia_kg_m2: 3.0e-4, inertia_about: com}
    - {name: tail, length_m: 0.12, mass_kg: 0.1, com_m: 0.05, inertia_kg_m2: 1.2e-4, inertia_about: com}
  joints:
    - {name: joint1, parent: head, child: mid, driven: {gain: 0.5}}
    - {name: joint2, parent: mid, child: tail, driven: {gain: 0.5}}
  elements:
    - {kind: slender-body, link: head, LAW, sections: [
        {station_m: 0, height_m: 0.05, perimeter_m: 0.15}, {station_m: 0.2, height_m: 0.1, perimeter_m: 0.3}]}
    - {kind: slender-body, link: mid, LAW, sections: [
        {station_m: 0, height_m: 0.1, perimeter_m: 0.3}, {station_m: 0.1, height_m: 0.05, perimeter_m: 0.12}]}
    - {kind: slender-body, link: tail, LAW, sections: [
        {station_m: 0, height_m: 0.05, perimeter_m: 0.12},
        {station_m: 0.12, height_m: 0.12, perimeter_m: 0.24}]}
    - {kind: trailing-edge, link: tail, added_mass_kg_m: 11.0}
""".replace(
    "LAW",
    "added_mass_coefficient: c_a, added_mass_direction: normal, drag_coefficient: 1.5, "
    "friction_coefficient: 0.02",
)


def _write(folder: Path, text: str, values: dict[str, float] | None = None) -> Path:
    """Write a robot file and a parameter file that names it; return the path of the latter."""
    (folder / "robot.yaml").write_text(text)
    held = {
        name: Estimate(value=value, stderr=0.01, unit="1", status="estimated")
        for name, value in (values or {"c_a": 0.7}).items()
    }
    path = folder / "params.yaml"
    ParameterFile(model="multilink", robot="robot.yaml", parameters=held).write(path)
    return path


def _tree(plane: str, elements: str, pretension: float = 0.02) -> str:
    body = TREE.replace("PLANE", plane).replace("PRETENSION", str(pretension))
    return body.replace("  elements:\nELEMENTS", f"  elements:{elements}" if elements else "")


def _tfish(folder: Path, **changes: Any) -> Path:
    held = {
        name: Estimate(value=value, stderr=0.1, unit="1", status="estimated")
        for name, value in {"c_ma": 1.2, "c_Ia": 1.1, "c_d0": 4.8, "c_f0": 0.012}.items()
    }
    names = list(held)
    file = ParameterFile(
        model="multilink", robot="tfish", parameters=held,
        correlation=Correlation(names=names, matrix=np.eye(4).tolist()), **changes,
    )  # fmt: skip
    path = folder / "tfish.yaml"
    file.write(path)
    return path


# ------------------------------------------------------------ MuJoCo


@pytest.fixture
def mujoco() -> Iterator[Any]:
    """Return MuJoCo, and clear its callbacks afterwards."""
    module = pytest.importorskip("mujoco")
    yield module
    module.set_mjcb_passive(None)


def _rate(source: ExportSource, state: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return the rate of the state from the engine."""
    tables = source.assembly.tables(source.values).values()
    n = source.assembly.unknowns
    rate = np.zeros(2 * n)
    work = np.zeros((len(source.links), 19))
    engine.compute_rate(state, row, tuple(tables), None, 0.0, work, np.zeros((n, n)), np.zeros(n), rate)
    return rate


def _residual(
    mujoco: Any, source: ExportSource, text: str, rng: np.random.Generator, *, water: bool
) -> float:
    """Return the maximum force that MuJoCo lacks for the accelerations of the engine, as a share of all."""
    mujoco.set_mjcb_passive(None)  # MuJoCo compiles no model while a Python callback is set
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.set_mjcb_passive(mjcf.water(model) if water else None)
    driven, passive, n = source.assembly.driven, source.assembly.passive, source.assembly.unknowns
    pose = [
        model.joint(name).dofadr[0]
        for name in (f"base_{k}" for k in (("x", "z", "pitch") if source.vertical else ("x", "y", "yaw")))
    ]
    hinges = [model.joint(a.joint.name).dofadr[0] for a in passive]
    worst = 0.0
    for _ in range(20):
        state = rng.normal(size=2 * n)
        moved = rng.normal(size=(len(driven), 3))
        row = np.zeros((len(driven), 5))
        row[:, :3] = moved
        mounts = np.radians([a.joint.mount_deg for a in driven])
        row[:, 3], row[:, 4] = np.cos(moved[:, 0] + mounts), np.sin(moved[:, 0] + mounts)
        rate = _rate(source, state, row)
        c, s, (u, v, r) = math.cos(state[2]), math.sin(state[2]), state[n : n + 3]
        du, dv, dr = rate[n : n + 3]
        data.qpos[pose] = state[:3]
        data.qvel[pose] = c * u - s * v, s * u + c * v, r
        ax, ay = du - r * v, dv + r * u
        data.qacc[pose] = c * ax - s * ay, s * ax + c * ay, dr
        data.qpos[hinges], data.qvel[hinges] = state[3:n], state[n + 3 :]
        data.qacc[hinges] = rate[n + 3 :]
        for axis, (angle, speed, bend) in zip(driven, moved, strict=True):
            at = model.joint(axis.joint.name).dofadr[0]
            data.qpos[at], data.qvel[at], data.qacc[at] = angle, speed, bend
        moves, force = np.array(data.qacc), np.empty(model.nv)
        mujoco.mj_forward(model, data)
        for _ in range(2):  # a step that keeps the positions changes nothing
            mujoco.mj_mulM(model, data, force, moves)
            lacking = force + data.qfrc_bias - data.qfrc_passive
            size = np.abs(lacking + data.qfrc_passive).max() + np.abs(data.qfrc_passive).max()
            worst = max(worst, float(np.abs(lacking[[*pose, *hinges]]).max() / size))
            mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_POS, 0)
    return worst


def _exported(swimid: Callable[..., Ran], path: Path, *words: str) -> str:
    ran = swimid("export", path, *words)
    assert ran.status == 0, ran.err
    return ran.out


@pytest.mark.parametrize("plane", ["horizontal", "vertical"])
@pytest.mark.parametrize("pretension", [0.02, 0.004])
def test_mujoco_moves_the_dry_tree_as_the_engine_does(
    plane: str,
    pretension: float,
    tmp_path: Path,
    swimid: Callable[..., Ran],
    mujoco: Any,
    rng: np.random.Generator,
) -> None:
    """Bodies, mounts, springs, dampers and wire agree to rounding, without fluid."""
    path = _write(tmp_path, _tree(plane, "", pretension))
    text = _exported(swimid, path, "--to", "mjcf")
    assert _residual(mujoco, load(path), text, rng, water=False) < 1e-9


@pytest.mark.parametrize("elements", [WATER, DIRECTIONAL])
@pytest.mark.parametrize("plane", ["horizontal", "vertical"])
def test_mujoco_moves_the_wet_tree_as_the_engine_does(
    plane: str,
    elements: str,
    tmp_path: Path,
    swimid: Callable[..., Ran],
    mujoco: Any,
    rng: np.random.Generator,
) -> None:
    """With folded added mass and the callback of the water there is no difference."""
    path = _write(tmp_path, _tree(plane, elements))
    text = _exported(swimid, path, "--to", "mjcf", "--added-mass", "fold")
    source = load(path)
    assert _residual(mujoco, source, text, rng, water=True) < 1e-9
    # each of the two is necessary
    assert _residual(mujoco, source, text, rng, water=False) > 1e-3
    dry = _exported(swimid, path, "--to", "mjcf", "--added-mass", "none")
    assert _residual(mujoco, source, dry, rng, water=True) > 1e-3


@pytest.mark.parametrize("plane", ["horizontal", "vertical"])
def test_mujoco_moves_one_body_with_added_mass_sideways_as_the_engine_does(
    plane: str, tmp_path: Path, swimid: Callable[..., Ran], mujoco: Any, rng: np.random.Generator
) -> None:
    path = _write(tmp_path, PLATE.replace("PLANE", plane))
    text = _exported(swimid, path, "--to", "mjcf", "--added-mass", "fold")
    assert _residual(mujoco, load(path), text, rng, water=True) < 1e-9
    mean = text.replace('"mass:', '"other:')
    assert _residual(mujoco, load(path), mean, rng, water=True) > 1e-3


def _swims(
    mujoco: Any, path: Path, text: str, time_s: float, beat: drives.TailBeat
) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y and yaw of a swim in MuJoCo and in swimid, each of shape (3, n), at the steps of MuJoCo."""
    mujoco.set_mjcb_passive(None)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.set_mjcb_passive(mjcf.water(model))
    source = load(path)
    time = np.arange(0.0, time_s, model.opt.timestep)
    gain = float(source.assembly.driven[0].joint.driven.gain)
    found, angle = np.empty((3, len(time))), beat.motion(time, gain=gain)[0]
    for i in range(len(time)):
        found[:, i] = data.qpos[:3]
        data.ctrl[:] = angle[i]
        mujoco.mj_step(model, data)
    twin = MultilinkModel(source.robot)
    values = np.array([p.start for p in twin.parameters])
    values[: len(source.values)] = source.values
    truth = twin.simulate(values, Trial("t", "fit", time, {}, swim=SwimInput(beat)))
    return found, np.array([truth[name] for name in ("x_m", "y_m", "yaw_rad")])


def test_mujoco_swims_as_far_as_the_model_with_added_mass_sideways_only(
    tmp_path: Path, swimid: Callable[..., Ran], mujoco: Any
) -> None:
    path = _write(tmp_path, SLENDER, {"c_a": 0.9})
    text = _exported(swimid, path, "--to", "mjcf", "--added-mass", "fold", "--servo-hz", "60")
    beat = drives.TailBeat("sine", 1.5, math.radians(30))
    found, truth = _swims(mujoco, path, text, 2.0, beat)
    mean, _ = _swims(mujoco, path, text.replace('"mass:', '"other:'), 2.0, beat)
    length = np.hypot(*truth[:2, -1])
    assert length > 0.1
    off, off_mean = (np.hypot(*(path[:2] - truth[:2])).max() / length for path in (found, mean))
    # 60 Hz lags by 5 ms, and MuJoCo's integrator is of first order in its step of 2 ms
    assert off < 0.02
    assert off_mean > 0.1
    assert np.abs(found[2] - truth[2]).max() < math.radians(1.0)


def test_the_difference_from_mujoco_is_stated(
    tmp_path: Path, swimid: Callable[..., Ran], mujoco: Any
) -> None:
    path = _write(tmp_path, SLENDER, {"c_a": 0.9})
    out = tmp_path / "fish.xml"
    ran = swimid(
        "export", path, "--to", "mjcf", "--added-mass", "fold", "--servo-hz", "60", "-o", out, "--json"
    )
    stated = ran.json["result"]["compared"]
    found, truth = _swims(mujoco, path, out.read_text(), 6.0, drives.TailBeat("sine", 1.0, math.radians(20)))
    assert stated["way_m"] == pytest.approx(np.hypot(*truth[:2, -1]), rel=0.01)
    # the two runs give MuJoCo the commands of the middle and of the start of a step
    assert abs(stated["difference_m"] - np.hypot(*(found - truth)[:2, -1])) < 0.01 * stated["way_m"]
    assert stated["difference_m"] < 0.01 * stated["way_m"]


def test_mujoco_keeps_total_mass_and_centre(tmp_path: Path, swimid: Callable[..., Ran], mujoco: Any) -> None:
    path = _tfish(tmp_path)
    model = mujoco.MjModel.from_xml_string(_exported(swimid, path, "--to", "mjcf"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    masses = [2.133, 0.081, 0.081, 0.081, 0.096]
    stations = [0.192, 0.286, 0.318, 0.350, 0.393]
    assert model.body_mass.sum() == pytest.approx(sum(masses), rel=1e-12)
    assert data.subtree_com[0][0] == pytest.approx(-np.dot(masses, stations) / sum(masses), rel=1e-12)
    folded = mujoco.MjModel.from_xml_string(_exported(swimid, path, "--to", "mjcf", "--added-mass", "fold"))
    assert folded.body_mass.sum() == pytest.approx(2.2 * sum(masses), rel=1e-12)


# ------------------------------------------------------------ Gazebo


def _plugins(text: str) -> dict[str, dict[str, float]]:
    found = {}
    for plugin in ET.fromstring(text).iter("plugin"):
        if plugin.get("name") == "gz::sim::systems::Hydrodynamics":
            tags = {t.tag: t.text or "" for t in plugin}
            name = tags.pop("link_name")
            found[name] = {k: float(v) for k, v in tags.items() if k != "water_density"}
    return found


def _number(node: ET.Element | None) -> float:
    assert node is not None
    return float(node.text or "nan")


def test_gazebo_numbers_can_be_traced(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _tfish(tmp_path)
    text = _exported(swimid, path, "--to", "gazebo")
    plugins = _plugins(text)
    # drag of head and fin acts at the middle of the link, away from the centre of mass
    assert list(plugins) == ["head", "head_drag0", "tail1", "tail2", "tail3", "fin", "fin_drag0"]
    assert plugins["head"] == {}
    # half of 1000 kg/m3, Table II's areas, the parameter file's coefficients; resistance is negative
    assert plugins["head_drag0"]["xUabsU"] == pytest.approx(-500 * 0.012727 * 0.012, rel=1e-12)
    assert plugins["head_drag0"]["yVabsV"] == pytest.approx(-500 * 0.028909 * 4.8, rel=1e-12)
    root = ET.fromstring(text)
    head = root.find(".//link[@name='head']/inertial")
    assert head is not None
    assert _number(head.find("mass")) == 2.133
    assert _number(head.find("fluid_added_mass/xx")) == pytest.approx(1.2 * 2.133, rel=1e-12)
    assert _number(head.find("fluid_added_mass/yy")) == pytest.approx(1.2 * 2.133, rel=1e-12)
    assert _number(head.find("fluid_added_mass/rr")) == pytest.approx(1.1 * 0.012969, rel=1e-9)
    stiffness = root.find(".//joint[@name='joint4']/axis/dynamics/spring_stiffness")
    assert _number(stiffness) == pytest.approx(85 * 0.030 * 0.032 * 0.020 / 0.012, rel=1e-12)
    joint = root.find(".//joint[@name='joint1']/pose")
    assert joint is not None
    assert joint.get("relative_to") == "head"
    assert (joint.text or "").split()[0] == repr(-0.27 + 0.192)


def _plugin_force(tags: dict[str, float], nu: np.ndarray, names: tuple[str, str]) -> np.ndarray:
    """Return what the plugin computes: force i = coefficient v_j |v_k|, in its own axes."""
    forces, speeds = names
    wrench = np.zeros(3)
    for tag, value in tags.items():
        i, rest = forces.index(tag[0]), tag[1:]
        first, _, second = rest.partition("abs")
        size = abs(nu[speeds.index(second)]) if second else 1.0
        wrench[i] += value * nu[speeds.index(first)] * size
    return wrench


@pytest.mark.parametrize(
    ("plane", "names", "signs"),
    [("horizontal", ("xyn", "UVR"), (1, 1, 1)), ("vertical", ("xzm", "UWQ"), (1, 1, -1))],
)
def test_gazebo_drag_equals_that_of_the_engine(
    plane: str,
    names: tuple[str, str],
    signs: tuple[int, int, int],
    tmp_path: Path,
    swimid: Callable[..., Ran],
    rng: np.random.Generator,
) -> None:
    """The sum of the plugins of a link and of its helpers equals the drag of the engine."""
    path = _write(tmp_path, _tree(plane, WATER))
    text = _exported(swimid, path, "--to", "gazebo")
    plugins, root = _plugins(text), ET.fromstring(text)
    source, flip = load(path), np.array(signs, dtype=float)
    across = 2 if plane == "vertical" else 1
    for i, link in enumerate(source.links):
        centre = central(link.rigid)[1]
        frames = {link.name: (0.0, 0.0)}
        for name in plugins:
            if name.startswith(f"{link.name}_drag"):
                pose = root.find(f".//link[@name='{name}']/pose")
                assert pose is not None
                place = [float(w) for w in (pose.text or "").split()]
                frames[name] = (place[0], place[across])
        for nu in rng.normal(size=(20, 3)):
            truth = np.zeros(3)
            for e in (e for e in source.elements if e.kind == "drag" and e.link == i):
                n, x, y = e.numbers, e.at[0] - centre[0], e.at[1] - centre[1]
                u, v, r = nu[0] - nu[2] * y, nu[1] + nu[2] * x, nu[2]
                fx = -(n["quadratic_x"] * abs(u) + n["linear_x"]) * u
                fy = -(n["quadratic_y"] * abs(v) + n["linear_y"]) * v
                turn = -(n["quadratic_r"] * abs(r) + n["linear_r"]) * r
                truth += [fx, fy, x * fy - y * fx + turn]
            found = np.zeros(3)
            for name, (x, y) in frames.items():
                there = np.array([nu[0] - nu[2] * y, nu[1] + nu[2] * x, nu[2]])
                fx, fy, moment = flip * _plugin_force(plugins[name], flip * there, names)
                found += [fx, fy, moment + x * fy - y * fx]
            assert found == pytest.approx(truth, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    ("plane", "axes", "signs"), [("horizontal", "xyr", (1, 1, 1)), ("vertical", "xzq", (1, 1, -1))]
)
def test_gazebo_added_mass_has_the_right_energy(
    plane: str,
    axes: str,
    signs: tuple[int, int, int],
    tmp_path: Path,
    swimid: Callable[..., Ran],
    rng: np.random.Generator,
) -> None:
    """An anisotropic added mass is away from the centre of mass; velocities are those of the frame."""
    element = "{kind: added-mass, link: right, surge_kg: 0.1, sway_kg: 0.7 * c_a, at_m: 0.08, offset_m: 0.01}"
    water = f"\n    - {element}"
    path = _write(tmp_path, _tree(plane, water))
    node = ET.fromstring(_exported(swimid, path, "--to", "gazebo")).find(
        ".//link[@name='right']//fluid_added_mass"
    )
    assert node is not None
    tags = {t.tag: float(t.text or "nan") for t in node}
    assert len(tags) == 21
    link = next(k for k in load(path).links if k.name == "right")
    x, y = central(link.rigid)[1]
    for nu in rng.normal(size=(10, 3)):
        origin = np.array([nu[0] + nu[2] * y, nu[1] - nu[2] * x, nu[2]])
        speeds = dict(zip(axes, np.array(signs) * nu, strict=True))
        twice = sum(
            (1 if tag[0] == tag[1] else 2) * value * speeds.get(tag[0], 0.0) * speeds.get(tag[1], 0.0)
            for tag, value in tags.items()
        )
        assert twice == pytest.approx(float(origin @ link.added @ origin), rel=1e-9)


def test_gazebo_names_are_unique(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    """Links and joints of SDF share their names, but a robot file may use a name for both."""
    path = _write(tmp_path, _tree("horizontal", WATER).replace("name: j2", "name: right"))
    root = ET.fromstring(_exported(swimid, path, "--to", "gazebo"))
    names = [node.get("name") for tag in ("link", "joint") for node in root.iter(tag) if node.get("name")]
    assert len(set(names)) == len(names)
    known = {n for n in names if n}
    assert {p.get("relative_to") for p in root.iter("pose")} <= known | {None}


# ------------------------------------------------------------ JSON


def test_json_holds_everything(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _tfish(tmp_path)
    data = json.loads(_exported(swimid, path, "--to", "json"))
    file, source = parameters.read(path), load(path)
    assert {k: v["value"] for k, v in data["parameters"].items()} == {
        k: v.value for k, v in file.parameters.items()
    }
    assert all(v["stderr"] == 0.1 and v["unit"] == "1" for v in data["parameters"].values())
    assert file.correlation is not None
    assert data["correlation"]["matrix"] == file.correlation.matrix
    # coefficients that the parameter file does not hold come from the robot file
    assert data["coefficients"]["c_d4"] == 5.76034
    apparent = np.array([k["apparent_inertia"] for k in data["links"]])
    rows = source.tables["inertia"]
    assert np.array_equal(apparent[:, 0, 0], rows[:, 0])
    assert np.allclose(apparent[:, 2, 2], rows[:, 5], rtol=1e-15)
    assert [d["link"] for d in data["drag_points"]] == ["head", "tail1", "tail2", "tail3", "fin"]
    assert data["joints"][3]["passive"]["wire_stiffness"] == pytest.approx(0.136)
    assert data["readings"]["head_inertia"] == "front"
    assert "SWM060" not in swimid("export", path, "--to", "json").err


def test_readings_of_the_fit_are_kept(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _tfish(tmp_path, settings={"readings": {"added_mass": "lateral"}})
    data = json.loads(_exported(swimid, path, "--to", "json"))
    assert data["readings"]["added_mass"] == "lateral"
    assert data["links"][0]["added_inertia"][0][0] == 0.0
    ran = swimid("export", path, "--to", "mjcf", "--added-mass", "fold")
    assert "head 0 kg forward" in ran.err
    ran = swimid("export", path, "--to", "gazebo", "--added-mass", "fold", "--json")
    (limit,) = (one for one in ran.json["result"]["limits"] if "differs by direction" in one)
    assert "swimid.exporters.mjcf.water of MuJoCo or --added-mass native of Gazebo" in limit


# ------------------------------------------------------------ the command


def test_every_limit_is_a_warning_and_is_in_the_result(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _write(tmp_path, _tree("horizontal", WATER))
    for target, words in {
        "mjcf": ("added-mass inertia", "lift and drag of foils", "standard errors"),
        "gazebo": ("foils", "wire and spring", "cubic", "quadratic damping", "DART", "standard errors"),
    }.items():
        out = tmp_path / f"out.{target}"
        ran = swimid("export", path, "--to", target, "-o", out, "--json")
        result = ran.json["result"]
        told = [w["text"] for w in ran.json["warnings"] if w["code"] == "SWM060"]
        assert [t.partition(": ")[2] for t in told] == result["limits"]
        for word in words:
            assert any(word in limit for limit in result["limits"]), (target, word)
        assert ran.json["outputs"] == [str(out)]
        ET.fromstring(out.read_text())
        assert swimid("export", path, "--to", target, "-o", out).status == 0  # its own output may be replaced


def test_outputs_are_protected(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _tfish(tmp_path)
    other = tmp_path / "other.xml"
    other.write_text("<mujoco/>")
    assert swimid("export", path, "--to", "mjcf", "-o", other).status == 2
    assert other.read_text() == "<mujoco/>"
    assert swimid("export", path, "--to", "mjcf", "-o", path).status == 2
    assert swimid("export", path, "--to", "mjcf", "-o", other, "--force").status == 0


def test_bad_use_is_refused(tmp_path: Path, swimid: Callable[..., Ran], samples: Path) -> None:
    path = _tfish(tmp_path)
    assert swimid("export", path, "--to", "mjcf", "--added-mass", "plugin").status == 2
    assert swimid("export", path, "--to", "mjcf", "--servo-hz", "-1").status == 2
    assert swimid("export", tmp_path / "no.yaml", "--to", "mjcf").status == 3
    for name in ("nobody", "boxfish"):
        other = tmp_path / f"{name}.yaml"
        other.write_text(path.read_text().replace("robot: tfish", f"robot: {name}"))
        wrong = swimid("export", other, "--to", "mjcf")
        assert wrong.status == 3
    assert "multilink" in wrong.err


def test_an_impossible_value_is_reported_with_the_line_of_the_robot_file(
    tmp_path: Path, swimid: Callable[..., Ran]
) -> None:
    path = _write(tmp_path, _tree("horizontal", WATER), {"c_a": -5.0})
    ran = swimid("export", path, "--to", "mjcf")
    assert ran.status == 3
    assert "robot.yaml, line" in ran.err
    assert "not positive definite" in ran.err


def test_parameters_of_another_robot_are_refused(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _write(tmp_path, _tree("horizontal", WATER), {"c_a": 0.7, "c_other": 1.0})
    ran = swimid("export", path, "--to", "json")
    assert ran.status == 3
    assert "no coefficient 'c_other'" in ran.err
    # initial states of single trials do not belong to the robot
    path = _write(tmp_path, _tree("horizontal", WATER), {"c_a": 0.7, "initial_surge[t1]": 0.1})
    assert swimid("export", path, "--to", "json").status == 0


def test_an_unidentifiable_parameter_is_named(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    path = _tfish(tmp_path)
    data = yamlio.plain(yamlio.load(path))
    data["parameters"]["c_f0"]["status"] = "unidentifiable"
    yamlio.write(path, data)
    ran = swimid("export", path, "--to", "json")
    assert ran.status == 0
    assert "SWM010" in ran.err
    assert "c_f0" in ran.err


def test_built_in_multilink_robots_export(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    for name in robot.list_built_in_robots():
        body = robot.read(name).multilink
        if body is None:
            continue
        coefficients = {
            k: Estimate(value=c.value, unit=c.unit, status="fixed") for k, c in body.coefficients.items()
        }
        path = tmp_path / f"{name}.yaml"
        ParameterFile(model="multilink", robot=name, parameters=coefficients).write(path)
        for target in ("mjcf", "gazebo", "json"):
            assert swimid("export", path, "--to", target).status == 0, (name, target)


@pytest.mark.parametrize("target", ["mjcf", "gazebo", "json"])
def test_dry_friction_and_trailing_edges(target: str, tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    """All formats carry Coulomb friction; only JSON and the callback of MuJoCo carry trailing edges."""
    tree = _tree("horizontal", WATER).replace("rest_deg: 5", "friction_N_m: 0.0125")
    ran = swimid("export", _write(tmp_path, tree), "--to", target, "-v")
    assert ran.status == 0
    if target == "json":
        data = json.loads(ran.out)
        (j2,) = (j["passive"] for j in data["joints"] if j["name"] == "j2")
        assert (j2["friction"], j2["friction_below"]) == (0.0125, 0.02)
        assert data["trailing_edges"] == [{"link": "tip", "x": -0.08, "y": 0.003, "half_mass": 1.25}]
        return
    assert "SWM060" in ran.err
    assert "trailing edges" in ran.err
    assert "dry friction of 0.0125 N m" in ran.err
    joint = ET.fromstring(ran.out).find(".//joint[@name='j2']")
    assert joint is not None
    if target == "mjcf":
        assert joint.get("frictionloss") == "0.0125"
    else:
        assert _number(joint.find("axis/dynamics/friction")) == 0.0125
