"""Export of causes: servos, filters, masses, forces and currents; random samples of the parameters."""

from __future__ import annotations

import csv
import json
import math
import runpy
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.effects.base import Effect
from swimid.effects.catalogue import list_effects
from swimid.exporters.mjcf import water
from swimid.files import yamlio
from swimid.fitting.drives import TailBeat
from swimid.fitting.model import SwimInput, Trial
from swimid.results import parameters
from swimid.robots import file as robot
from swimid.swimmer.planar.model import MultilinkModel
from tests.conftest import ROOT, Ran
from validation import export_trials

Swimid = Callable[..., Ran]
Causes = dict[str, dict[str, float]]
#: Effects of the actuators, with parameters that change a beat of 25 deg and 1.4 Hz clearly.
ACTUATION: Causes = {
    "amplitude-loss": {"loss": 0.2},
    "amplitude-offset": {"offset_rad": 0.03},
    "joint-locked": {"locked_joint2": 0.5},
    "load-friction": {"held_rad_N_m": 0.4},
    "rate-limit": {"rate_limit_rad_s": 0.8},
    "servo-backlash": {"backlash_rad": 0.05},
    "servo-delay": {"delay_s": 0.0531},
    "servo-lag": {"time_constant_s": 0.06},
    "slip": {"loss": 0.3, "begin_s": 1.5},
    "stribeck": {"stick_rad": 0.04, "stribeck_rad_s": 0.4},
}
#: Effects that the actuators of MuJoCo express.
NATIVE = ("amplitude-loss", "amplitude-offset", "joint-locked", "rate-limit", "servo-backlash", "servo-delay")
#: Filters with another law than the effect, and their maximum error as a share of the influence. Those of
#: friction take the rate of the command from its past only. The onset of the slip lasts 0.25 s, not a quarter
#: of the beat.
ROUGH = {"load-friction": 0.1, "slip": 0.1, "stribeck": 0.05}
#: Effects of structure, water and environment that change the path of this beat by more than 5 mm.
SWIMMING: Causes = {
    "added-mass": {"surge_kg": 1.0, "sway_kg": 1.0, "tail_kg": 0.0},
    "com-offset": {"along_m": 0.03, "across_m": 0.01},
    "current": {"cx_m_s": 0.02, "cy_m_s": -0.01},
    "fin-flexibility": {"compliance_rad_N": 0.5},
    "hardening": {"hardening_rad_2": 20.0},
    "joint-damping": {"damping_N_m_s_rad": 0.003},
    "joint-locked": {"locked_joint4": 0.3},
    "joint-stiffness": {"change": 0.5, "hardening_rad_2": 3.0},
    "lift-damping": {"lift_N_s2_m2": 20.0},
    "linear-drag": {"linear_N_s_m": 1.0},
    "tether": {"stiffness_N_m": 0.3, "slack_m": 0.05, "line_drag_N_s2_m3": 1.0, "behind_m": 0.1},
    "wake-lift": {"added_mass_kg_m": 2.0},
    "water-ingress": {"mass_kg": 1.0, "along_m": -0.05},
}
TIME = np.arange(0.0, 3.0, 0.002)
BEAT = TailBeat("sine", 1.4, math.radians(25.0))
TRIAL = Trial("run", "fit", TIME, {}, swim=SwimInput(BEAT))
GIVEN = ROOT / "sample_logs" / "gap" / "params.yaml"


@pytest.fixture
def mujoco() -> Iterator[Any]:
    """Return MuJoCo, and clear its callbacks afterwards."""
    module = pytest.importorskip("mujoco")
    module.set_mjcb_passive(None)
    yield module
    module.set_mjcb_passive(None)


def _write(folder: Path, causes: Causes, stderr: float = 0.1, **entries: Any) -> Path:
    """Write the parameters of the T-Fish, or of another robot, with causes."""
    data = yamlio.plain(yamlio.load(GIVEN))
    data["effects"] = list(causes)
    name = entries.pop("robot", "tfish")
    if name != "tfish":
        stated = robot.read(name).multilink
        assert stated is not None
        data["robot"] = name
        data["parameters"] = {
            key: {"value": c.value, "unit": c.unit, "status": "fixed"}
            for key, c in stated.coefficients.items()
        }
    for effect, values in causes.items():
        for key, value in values.items():
            one = {"value": value, "stderr": stderr * abs(value), "unit": "1", "status": "estimated"}
            data["parameters"][f"{effect}/{key}"] = one
    path = folder / "repaired.yaml"
    yamlio.write(path, data | entries)
    return path


def _exported(swimid: Swimid, path: Path, target: str, *words: str) -> ET.Element:
    ran = swimid("export", path, "--to", target, "-q", *words)
    assert ran.status == 0, ran.err
    return ET.fromstring(ran.out)


def _model() -> MultilinkModel:
    """Return the T-Fish with the parameters of the sample."""
    model, held = MultilinkModel(robot.read("tfish")), parameters.read(GIVEN).parameters
    starts = {p.name: p.start for p in model.parameters} | {n: one.value for n, one in held.items()}
    model.parameters = tuple(replace(p, start=starts[p.name]) for p in model.parameters)
    return model


def _form(name: str, values: dict[str, float], model: MultilinkModel) -> tuple[Effect, np.ndarray]:
    """Return the form of an effect that has the given parameters, and their values in its order."""
    effect = next(e for e in list_effects() if e.name == name)
    for form in effect.variants(model, [TRIAL]):
        names = [p.name for p in form.parameters(model, [TRIAL])]
        if set(names) == set(values):
            return form, np.array([values[n] for n in names])
    raise AssertionError(name)


def _followed(name: str, command: np.ndarray) -> np.ndarray:
    """Return the angles of the T-Fish's driven joints with an effect of swimid, shape (3, n)."""
    model = _model()
    form, values = _form(name, ACTUATION[name], model)
    hooks = form.hooks(values, TRIAL, model)
    return np.array([hooks.actuate(TIME, command.copy(), k) for k in range(3)])


def _command() -> np.ndarray:
    return BEAT.motion(TIME, gain=1.0 / 3.0)[0]


# ------------------------------------------------------------ servos


@pytest.mark.parametrize("name", ACTUATION)
def test_filters_follow_the_command_as_the_effect_does(name: str, tmp_path: Path, swimid: Swimid) -> None:
    """No target but MuJoCo has laws of servos; a Python file without swimid takes their place."""
    out = tmp_path / "fish.sdf"
    ran = swimid("export", _write(tmp_path, {name: ACTUATION[name]}), "--to", "gazebo", "-v", "-o", out)
    assert ran.status == 0, ran.err
    assert name in ran.err
    filters = tmp_path / "fish_gazebo_causes.py"
    assert "import swimid" not in filters.read_text()
    causes, command = runpy.run_path(str(filters))["Causes"](), _command()
    found = np.array([
        [causes.command(t, f"joint{k}", one) for t, one in zip(TIME.tolist(), command.tolist(), strict=True)]
        for k in (1, 2, 3)
    ])  # fmt: skip
    truth = _followed(name, command)
    influence = np.abs(truth - command).max()
    assert influence > math.radians(0.5)
    # the effect takes the rates at the end of the trial from fewer samples
    assert np.abs(found - truth)[:, :-5].max() < ROUGH.get(name, 1e-3) * influence


@pytest.mark.parametrize("name", [*NATIVE, "servo-lag"])
def test_mujoco_servos_follow_the_command_as_the_effect_does(
    name: str, tmp_path: Path, swimid: Swimid, mujoco: Any
) -> None:
    path, words = tmp_path / "fish.xml", ("--to", "mjcf", "--servo-hz", "80", "--added-mass", "fold")
    ran = swimid("export", _write(tmp_path, {name: ACTUATION[name]}), *words, "-o", path)
    assert ran.status == 0, ran.err
    assert not (tmp_path / "fish_mjcf_causes.py").exists()
    model = mujoco.MjModel.from_xml_path(str(path))
    data, command = mujoco.MjData(model), _command()
    joints = [model.joint(f"joint{k}").qposadr[0] for k in (1, 2, 3)]
    found = np.empty((3, len(TIME)))
    for i, one in enumerate(command):
        found[:, i] = data.qpos[joints]
        data.ctrl[:] = one
        mujoco.mj_step(model, data)
    truth = _followed(name, command)
    influence, error = (np.sqrt(np.mean((x - truth) ** 2)) for x in (command, found))
    # a critically damped servo of 80 Hz lags by 4 ms, which is 0.2 deg of this beat
    assert error < 0.3 * influence or error < math.radians(0.25)


def test_a_law_that_mujoco_cannot_combine_is_a_filter(tmp_path: Path, swimid: Swimid) -> None:
    causes = {name: ACTUATION[name] for name in ("servo-lag", "rate-limit")}
    out = tmp_path / "fish.xml"
    assert swimid("export", _write(tmp_path, causes), "--to", "mjcf", "-o", out).status == 0
    filters = tmp_path / "fish_mjcf_causes.py"
    assert "RateLimitFilter(rate_limit_rad_s=0.8)" in filters.read_text()
    assert "ServoLag" not in filters.read_text()
    servo = ET.fromstring(out.read_text()).find(".//actuator/general")
    assert servo is not None
    assert float(servo.get("dynprm", "nan")) == 0.06
    # filters that are no longer needed do not stay
    assert swimid("export", _write(tmp_path, {}), "--to", "mjcf", "-o", out).status == 0
    assert not filters.exists()


@pytest.mark.parametrize("target", ["mjcf", "gazebo"])
def test_an_effect_without_influence_changes_nothing(target: str, tmp_path: Path, swimid: Swimid) -> None:
    causes: Causes = {"servo-backlash": {"backlash_rad": 0.0}, "servo-lag": {"time_constant_s": 0.0}}
    plain = _exported(swimid, _write(tmp_path, {}), target)
    changed = _exported(swimid, _write(tmp_path, causes), target)
    assert ET.tostring(changed) == ET.tostring(plain)


def test_a_file_of_others_is_not_replaced_by_filters(tmp_path: Path, swimid: Swimid) -> None:
    own = tmp_path / "fish_mjcf_causes.py"
    own.write_text("mine\n")
    path = _write(tmp_path, {"slip": ACTUATION["slip"]})
    ran = swimid("export", path, "--to", "mjcf", "-o", tmp_path / "fish.xml")
    assert ran.status == 2
    assert own.read_text() == "mine\n"
    assert not (tmp_path / "fish.xml").exists()


# ------------------------------------------------------------ structure, water and environment


def test_mujoco_carries_water_in_the_head_and_its_place(tmp_path: Path, swimid: Swimid, mujoco: Any) -> None:
    def head(causes: Causes) -> tuple[float, float, float]:
        model = mujoco.MjModel.from_xml_string(
            ET.tostring(_exported(swimid, _write(tmp_path, causes), "mjcf"), encoding="unicode")
        )
        body = model.body("head")
        return float(body.mass[0]), float(body.ipos[0]), float(body.ipos[1])

    mass, x, y = head({})
    assert head({"water-ingress": {"mass_kg": 0.5, "along_m": -0.05}}) == pytest.approx(
        (mass + 0.5, x - 0.05 * 0.5 / (mass + 0.5), y)
    )
    moved = head({"com-offset": {"along_m": 0.02, "across_m": -0.01}})
    assert moved == pytest.approx((mass, x + 0.02, y - 0.01))


def test_springs_and_dampers_of_causes_are_those_of_the_joint(tmp_path: Path, swimid: Swimid) -> None:
    causes: Causes = {
        "joint-stiffness": {"change": 0.5, "hardening_rad_2": 2.0},
        "joint-damping": {"damping_N_m_s_rad": 0.003},
    }
    path = _write(tmp_path, causes)
    # the wire of the T-Fish has 0.136 N m/rad at small angles
    joint = _exported(swimid, path, "mjcf").find(".//joint[@name='joint4']")
    assert joint is not None
    stiffness = [float(word) for word in joint.get("stiffness", "").split()]
    assert stiffness == pytest.approx([0.068, 0.0, 0.272], rel=1e-5)
    assert float(joint.get("damping", "nan")) == pytest.approx(0.003)
    spring = _exported(swimid, path, "gazebo").find(".//joint[@name='joint4']/axis/dynamics")
    assert spring is not None
    assert float(spring.findtext("spring_stiffness", "nan")) == pytest.approx(1.5 * 0.136, rel=1e-5)


def _forces(mujoco: Any, root: ET.Element, move: Callable[[Any], None]) -> np.ndarray:
    """Return the passive forces on the base of an export that is moved by ``move(data)``."""
    mujoco.set_mjcb_passive(None)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    move(data)
    mujoco.set_mjcb_passive(water(model))
    mujoco.mj_forward(model, data)
    return np.array(data.qfrc_passive[:3])


def test_linear_drag_and_a_tether_pull_as_their_equations_say(
    tmp_path: Path, swimid: Swimid, mujoco: Any
) -> None:
    def move(data: Any) -> None:
        data.qpos[:3], data.qvel[:3] = (1.2, 0.9, 0.7), (0.2, -0.1, 0.0)

    plain = _forces(mujoco, _exported(swimid, _write(tmp_path, {}), "mjcf"), move)
    drag = _write(tmp_path, {"linear-drag": {"linear_N_s_m": 0.4}})
    changed = _forces(mujoco, _exported(swimid, drag, "mjcf"), move) - plain
    # at the centre of mass of the head, 0.192 m behind the joints of the base
    arm = -0.192 * np.array([math.cos(0.7), math.sin(0.7)])
    force = -0.4 * np.array([0.2, -0.1])
    assert changed == pytest.approx([*force, arm[0] * force[1] - arm[1] * force[0]])
    # the anchor is 0.3 m behind the origin, so 1.5 m and 0.9 m away
    values = {"stiffness_N_m": 0.2, "slack_m": 0.1, "line_drag_N_s2_m3": 0.0, "behind_m": 0.3}
    tether = _exported(swimid, _write(tmp_path, {"tether": values}), "mjcf")
    pull = 0.2 * (math.hypot(1.5, 0.9) - 0.1) / math.hypot(1.5, 0.9)
    assert _forces(mujoco, tether, move) - plain == pytest.approx([-1.5 * pull, -0.9 * pull, 0.0])


@pytest.mark.parametrize("reading", ["isotropic", "lateral"])
def test_a_current_is_a_motion_of_the_water(
    reading: str, tmp_path: Path, swimid: Swimid, mujoco: Any
) -> None:
    """At rest in a current there are the forces of the opposite motion in still water."""

    def rest(data: Any) -> None:
        data.qpos[2] = 0.6

    def swim(data: Any) -> None:
        data.qpos[2], data.qvel[:2] = 0.6, (-0.03, 0.05)

    entries, fold = {"settings": {"readings": {"added_mass": reading}}}, ("--added-mass", "fold")
    still = _exported(swimid, _write(tmp_path, {}, **entries), "mjcf", *fold)
    truth = _forces(mujoco, still, swim)
    path = _write(tmp_path, {"current": {"cx_m_s": 0.03, "cy_m_s": -0.05}}, **entries)
    assert _forces(mujoco, _exported(swimid, path, "mjcf", *fold), rest) == pytest.approx(truth)
    plugins = _exported(swimid, path, "gazebo").iter("default_current")
    assert {plugin.text for plugin in plugins} == {"0.03 -0.05 0.0"}


def test_buoyancy_in_the_vertical_plane_pulls_up_and_rights(
    tmp_path: Path, swimid: Swimid, mujoco: Any
) -> None:
    def pitch(data: Any) -> None:
        data.qpos[2] = 0.3

    plain = _forces(mujoco, _exported(swimid, _write(tmp_path, {}, robot="dolphin"), "mjcf"), pitch)
    causes = {"buoyancy": {"force_N": 0.5, "righting_N_m": 0.2}}
    path = _write(tmp_path, causes, robot="dolphin")
    changed = _forces(mujoco, _exported(swimid, path, "mjcf"), pitch) - plain
    assert changed[:2] == pytest.approx([0.0, 0.5])
    # the moment rights the hull, apart from that of the force at the hull's centre of mass
    only = _write(tmp_path, {"buoyancy": {"force_N": 0.0, "righting_N_m": 0.2}}, robot="dolphin")
    righting = _forces(mujoco, _exported(swimid, only, "mjcf"), pitch) - plain
    assert righting == pytest.approx([0.0, 0.0, -0.2 * math.sin(0.3)])


def test_a_wall_needs_the_place_that_the_file_states(tmp_path: Path, swimid: Swimid, mujoco: Any) -> None:
    """Constants of an effect stand in the settings of the parameter file."""

    def move(data: Any) -> None:
        data.qvel[:3] = (0.2, -0.1, 0.0)

    causes = {"wall": {"x_max_push_N_s2_m2": 2.0, "x_max_decay_m": 0.5}}
    ran = swimid("export", _write(tmp_path, causes), "--to", "mjcf")
    assert ran.status == 0
    assert "wall is left out" in ran.err
    settings = {"effects": {"wall": {"side": "x_max", "extreme_m": 0.4}}}
    root = _exported(swimid, _write(tmp_path, causes, settings=settings), "mjcf")
    plain = _forces(mujoco, _exported(swimid, _write(tmp_path, {}), "mjcf"), move)
    push = 2.0 * (0.2**2 + 0.1**2) * math.exp(-0.4 / 0.5)
    assert (_forces(mujoco, root, move) - plain)[:2] == pytest.approx([-push, 0.0])


def test_json_names_every_cause(tmp_path: Path, swimid: Swimid) -> None:
    causes: Causes = {
        "linear-drag": {"linear_N_s_m": 0.4},
        "servo-lag": {"time_constant_s": 0.05},
        "camera-scale": {"scale_error": 0.02},
    }
    ran = swimid("export", _write(tmp_path, causes), "--to", "json")
    assert ran.status == 0, ran.err
    data = json.loads(ran.out)
    assert [(c["name"], c["contained"]) for c in data["causes"]] == [
        ("linear-drag", True),
        ("servo-lag", False),
        ("camera-scale", False),
    ]
    assert data["causes"][1]["parameters"] == {"time_constant_s": 0.05}
    assert [p["linear_x"] for p in data["drag_points"] if p["linear_x"]] == [0.4]
    assert "an error of the measurement" in ran.err


# ------------------------------------------------------------ faults in the file


def test_faults_of_causes_are_reported_with_their_place(tmp_path: Path, swimid: Swimid) -> None:
    faults: dict[str, tuple[Causes, dict[str, Any], str]] = {
        "unknown": ({"servo-lags": {"time_constant_s": 0.1}}, {}, "servo-lag"),
        "parameters": ({"servo-lag": {"delay_s": 0.1}}, {}, "servo-lag/time_constant_s"),
        "negative": ({"servo-delay": {"delay_s": -0.1}}, {}, "-0.1 is negative"),
        "unnamed": ({"servo-lag": {"time_constant_s": 0.1}}, {"effects": []}, "effects: [servo-lag]"),
    }
    for causes, entries, words in faults.values():
        ran = swimid("export", _write(tmp_path, causes, **entries), "--to", "mjcf")
        assert ran.status == 3
        assert "repaired.yaml" in ran.err
        assert words in " ".join(ran.err.split())


# ------------------------------------------------------------ random samples


def _draws(path: Path) -> tuple[list[str], np.ndarray]:
    rows = list(csv.reader(line for line in path.read_text().splitlines() if not line.startswith("#")))
    return rows[0], np.array(rows[1:], dtype=float)


def test_draws_have_the_covariance_and_one_of_them_is_exported(tmp_path: Path, swimid: Swimid) -> None:
    names = ["c_ma", "servo-lag/time_constant_s"]
    correlation = {"names": names, "matrix": [[1.0, -0.8], [-0.8, 1.0]]}
    causes: Causes = {"servo-lag": {"time_constant_s": 0.05}, "slip": ACTUATION["slip"]}
    path = _write(tmp_path, causes, correlation=correlation)
    out = tmp_path / "fish.xml"
    for count in ("20", "2000"):  # its own files may be replaced
        ran = swimid("export", path, "--to", "mjcf", "--draws", count, "-o", out, "--json")
        assert ran.status == 0, ran.err
    names_beside = ["fish.xml", "fish_mjcf_causes.py", "fish_draws.csv"]
    assert ran.json["outputs"] == [str(tmp_path / name) for name in names_beside]
    head, table = _draws(tmp_path / "fish_draws.csv")
    assert head[0] == "draw"
    assert "d_p_m" in head
    assert table[:, 0].tolist() == list(range(1, 2001))
    mass, lagging = (table[:, head.index(name)] for name in names)
    assert lagging.mean() == pytest.approx(0.05, abs=0.0005)
    assert lagging.std() == pytest.approx(0.005, rel=0.06)
    assert np.corrcoef(mass, lagging)[0, 1] == pytest.approx(-0.8, abs=0.04)
    assert np.ptp(table[:, head.index("d_p_m")]) == 0.0
    # the number of samples does not change a sample
    ran = swimid("export", path, "--to", "json", "--draw", "17")
    data = json.loads(ran.out)
    held = {name: one["value"] for name, one in data["parameters"].items()}
    assert list(held.values()) == table[16, 1:].tolist()
    assert "draw 17 of seed 1" in data["source"]["draw"]
    other = json.loads(swimid("export", path, "--to", "json", "--draw", "17", "--seed", "2").out)
    assert other["parameters"]["c_ma"]["value"] != held["c_ma"]


def test_draws_lie_within_the_bounds_of_the_file(tmp_path: Path, swimid: Swimid) -> None:
    path = _write(tmp_path, {"servo-lag": {"time_constant_s": 0.05}}, stderr=2.0)
    data = yamlio.plain(yamlio.load(path))
    data["parameters"]["servo-lag/time_constant_s"]["bounds"] = [0.0, 0.2]
    yamlio.write(path, data)
    ran = swimid("export", path, "--to", "mjcf", "--draws", "300", "-o", tmp_path / "fish.xml")
    assert ran.status == 0
    assert "SWM069" in ran.err
    head, table = _draws(tmp_path / "fish_draws.csv")
    lagging = table[:, head.index("servo-lag/time_constant_s")]
    assert 0.0 <= lagging.min() < lagging.max() <= 0.2


def test_draws_need_standard_errors_and_a_file(tmp_path: Path, swimid: Swimid) -> None:
    path = _write(tmp_path, {})
    assert swimid("export", path, "--to", "mjcf", "--draws", "3").status == 2
    assert swimid("export", path, "--to", "mjcf", "--draw", "0").status == 2
    ran = swimid("export", _write(tmp_path, {}, robot="dolphin"), "--to", "json", "--draw", "1")
    assert ran.status == 2
    assert "standard error" in ran.err


# ------------------------------------------------------------ trials with a known cause


@pytest.mark.slow
@pytest.mark.parametrize("name", export_trials.CASES)
def test_the_repaired_export_is_nearer_to_the_trial(
    name: str, tmp_path_factory: pytest.TempPathFactory, mujoco: Any
) -> None:
    """The trial is swum by an engine of its own; the commands are those of the trial."""
    found = export_trials.errors(name, tmp_path_factory.mktemp(name))
    assert found.given > 20.0
    assert found.repaired <= 0.5 * found.given


@pytest.mark.slow
@pytest.mark.parametrize("name", SWIMMING)
def test_mujoco_swims_with_a_cause_as_swimid_does(
    name: str, tmp_path: Path, swimid: Swimid, mujoco: Any
) -> None:
    """The difference is a small part of the influence of the cause."""

    def swum(causes: Causes) -> np.ndarray:
        words = ("--added-mass", "fold", "--servo-hz", "80")
        root = _exported(swimid, _write(tmp_path, causes), "mjcf", *words)
        mujoco.set_mjcb_passive(None)
        model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
        data, found = mujoco.MjData(model), np.empty((2, len(time)))
        mujoco.set_mjcb_passive(water(model))
        for i, one in enumerate(drive.motion(time, gain=1.0 / 3.0, bias_gain=1.0 / 3.0)[0]):
            found[:, i] = data.qpos[:2]
            data.ctrl[:] = one
            mujoco.mj_step(model, data)
        return found

    time, drive = np.arange(0.0, 5.0, 0.002), replace(BEAT, bias_rad=0.1)
    trial = Trial("run", "fit", time, {}, swim=SwimInput(drive))
    model = _model()
    form, values = _form(name, SWIMMING[name], model)
    affected = model.with_effects([form], [trial])
    null = np.array([p.start for p in affected.parameters])
    simulated = affected.run(np.concatenate([null[: -len(values)], values]), trial)
    plain = affected.run(null, trial)
    truth, without = (np.array([found["x_m"], found["y_m"]]) for found in (simulated, plain))
    influence, error = (
        float(np.sqrt(np.mean((path - truth) ** 2))) for path in (without, swum({name: SWIMMING[name]}))
    )
    assert influence > 0.005
    assert error < 0.2 * influence or error < 0.002


@pytest.mark.slow
def test_the_export_itself_loses_little(tmp_path: Path, mujoco: Any) -> None:
    assert export_trials.own_loss_mm(tmp_path) < 10.0
