"""Simulators of the user: files of MuJoCo and functions in Python are fitted, compared and diagnosed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.integrate import solve_ivp

from swimid.effects.catalogue import applicable, list_effects
from swimid.errors import InputError
from swimid.fitting.fit_common import load_experiment
from swimid.simulators.repaired import edit
from tests.generators import mujoco_robots

mujoco = pytest.importorskip("mujoco")

PENDULUM = """<mujoco model="pendulum">
  <!-- a rod that swings about its end -->
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="rod">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.02"/>
      <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.007 0.007 0.0001"/>
      <site name="tip" pos="0 0 -0.4"/>
    </body>
  </worldbody>
</mujoco>
"""

#: Fish with a servo and a passive fin, and its light off the axis.
FISH = mujoco_robots.FISH.replace('timestep="0.002"', 'timestep="0.004"')
FISH = FISH.replace('pos="0 0 0.05"', 'pos="0.02 0.01 0.05"')


def written(folder: Path, text: str, name: str, model: dict[str, Any], logs: list[Any], **keys: Any) -> Path:
    """Write a simulator, logs and a trials file, and return the path of the trials file."""
    (folder / name).write_text(text, encoding="utf-8")
    trials = []
    for k, log in enumerate(logs):
        pd.DataFrame(log).to_csv(folder / f"run{k}.csv", index=False)
        role = "validate" if len(logs) > 1 and k == len(logs) - 1 else "fit"
        trials.append({"log": f"run{k}.csv", "role": role, **keys})
    document = {"format": "swimid-trials/1", "experiment": "mjcf" if name.endswith(".xml") else "python"}
    (folder / "trials.yaml").write_text(
        yaml.safe_dump({**document, "model": model, "trials": trials}, sort_keys=False)
    )
    return folder / "trials.yaml"


def swing(seed: int, start: float, rate: float = 0.0) -> dict[str, Any]:
    """Return a swing of the pendulum with a damping of 0.035 N m s/rad, by another integrator."""
    time = np.arange(0.0, 4.0, 0.01)
    inertia, moment = 0.007 + 0.5 * 0.2**2, 0.5 * 9.81 * 0.2

    def rates(_: float, y: Any) -> list[float]:
        return [y[1], (-moment * math.sin(y[0]) - 0.035 * y[1]) / inertia]

    angle = solve_ivp(rates, (0.0, 4.0), [start, rate], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    rng = np.random.default_rng(seed)
    # a turn about y moves the tip of a hanging rod to negative x
    return {
        "t_s": time,
        "hinge_rad": angle + rng.normal(0.0, 0.002, len(time)),
        "x_m": -0.4 * np.sin(angle) + rng.normal(0.0, 0.001, len(time)),
    }


PENDULUM_MODEL = {
    "mjcf": "pendulum.xml",
    "parameters": {"damping": {"path": "joint/hinge/damping", "bounds": [0.0, 1.0]}},
    "outputs": {"hinge_rad": "joint/hinge", "x_m": "site/tip/x"},
}


@pytest.fixture
def pendulum(tmp_path: Path) -> Path:
    logs = [swing(1, 0.6), swing(2, 0.9, -1.0), swing(3, -0.4, 2.0)]
    return written(tmp_path, PENDULUM, "pendulum.xml", PENDULUM_MODEL, logs)


def fish_model(**parameters: str) -> dict[str, Any]:
    paths = parameters or {"k_fin": "joint/fin/stiffness"}
    return {
        "mjcf": "fish.xml",
        "parameters": {name: {"path": path, "bounds": [0.0, 10.0]} for name, path in paths.items()},
        "inputs": {"servo": "cmd_rad"},
        "outputs": {
            "x_m": "site/led/x",
            "y_m": "site/led/y",
            "yaw_rad": "body/head/yaw",
            "fin_rad": "joint/fin",
        },
    }


def swum(
    text: str,
    seconds: float = 3.0,
    *,
    seed: int | None = None,
    play: float = 0.0,
    beat: float = 1.4,
    every_s: float = 0.004,
) -> Any:
    """Return a swim of a fish by MuJoCo itself, step after step, from a pose away from the origin."""
    model = mujoco.MjModel.from_xml_string(text)
    data, h = mujoco.MjData(model), model.opt.timestep
    data.qpos[:3] = 0.7, -0.3, 2.0
    rows, held, stride = [], 0.0, round(every_s / h)
    for k in range(round(seconds / h)):
        command = min(k * h, 1.0) * 0.4 * math.sin(2.0 * math.pi * beat * k * h)
        held = min(max(held, command - 0.5 * play), command + 0.5 * play)
        if k % stride == 0:
            mujoco.mj_forward(model, data)
            matrix = data.body("head").xmat
            yaw = math.atan2(matrix[3], matrix[0])
            rows.append([k * h, *data.site("led").xpos[:2], yaw, data.joint("fin").qpos[0], command])
        data.ctrl[0] = held
        mujoco.mj_step(model, data)
    found = pd.DataFrame(rows, columns=["t_s", "x_m", "y_m", "yaw_rad", "fin_rad", "cmd_rad"])
    found["yaw_rad"] = np.unwrap(found["yaw_rad"])
    if seed is not None:
        rng = np.random.default_rng(seed)
        for name, sd in (("x_m", 0.001), ("y_m", 0.001), ("yaw_rad", 0.005), ("fin_rad", 0.005)):
            found[name] += rng.normal(0.0, sd, len(found))
    return found


class TestFit:
    def test_a_pendulum_of_another_integrator(self, swimid, pendulum, monkeypatch):
        monkeypatch.chdir(pendulum.parent)
        ran = swimid("fit", "trials.yaml", "-o", "p.yaml", "--json")
        assert ran.status == 0, ran.err
        found = ran.json["result"]["parameters"]["damping"]
        assert found["value"] == pytest.approx(0.035, abs=3 * found["stderr"])
        assert found["stderr"] < 0.001
        assert found["unit"] == "N m s/rad"
        # the second trial begins in motion, the first one at rest
        names = set(ran.json["result"]["parameters"])
        assert "initial_hinge_rad_s[run1.csv]" in names
        assert "initial_hinge_rad_s[run0.csv]" not in names
        ran = swimid("compare", "trials.yaml", "--params", "p.yaml", "--json")
        assert ran.json["verdict"]["level"] == "good"

    def test_fit_graybox_is_the_same_fit(self, swimid, pendulum):
        both = [
            swimid(name, pendulum, "--json").json["result"]["parameters"] for name in ("fit", "fit-graybox")
        ]
        assert both[0] == both[1]
        ran = swimid("fit-graybox", pendulum, "--starts", "3")
        assert ran.status == 2
        assert "--starts has no effect" in ran.err

    def test_a_trial_begins_at_its_first_pose(self, tmp_path):
        logs = [swum(FISH)]
        trials = load_experiment(
            written(tmp_path, FISH, "fish.xml", fish_model(), logs, start_state="rest")
        ).trials
        assert trials[0].starts == pytest.approx(
            {"start_x_m": 0.7, "start_y_m": -0.3, "start_turn_rad": 2.0, "start_fin_rad": 0.0}, abs=1e-6
        )

    def test_a_batch_equals_mujoco_step_by_step(self, tmp_path):
        log = swum(FISH)
        experiment = load_experiment(
            written(tmp_path, FISH, "fish.xml", fish_model(), [log], start_state="rest")
        )
        model, trial = experiment.model, experiment.trials[0]
        values = np.array([trial.starts.get(p.name, p.start) for p in model.parameters])
        simulated = model.run(values, trial)
        for name in ("x_m", "y_m", "yaw_rad", "fin_rad"):
            # The start is that of the log to 1e-9.
            assert np.max(np.abs(simulated[name] - log[name])) < 1e-6


class TestEffects:
    """Each form of an effect changes the simulation as the edited file does."""

    @pytest.mark.parametrize(
        "effect, value, before, after",
        [
            ("joint-damping", 0.004, '0.06" damping="0.0015"', '0.06" damping="0.0055"'),
            ("joint-friction", 0.003, 'stiffness="0.06"', 'stiffness="0.06" frictionloss="0.003"'),
            ("joint-armature", 2e-4, 'stiffness="0.06"', 'stiffness="0.06" armature="0.0002"'),
            ("joint-stiffness", 0.5, 'stiffness="0.06"', 'stiffness="0.09"'),
            ("joint-locked", 0.5, 'stiffness="0.06"', 'stiffness="0.12"'),
            ("hardening", 30.0, 'stiffness="0.06"', 'stiffness="0.06 0 1.8"'),
            ("linear-drag", 0.3, 'axis="1 0 0" damping="0"', 'axis="1 0 0" damping="0.3"'),
            ("quadratic-drag", 1.0, 'density="1000"/>', 'density="1000" fluidcoef="1 0.5 3 1 1"/>'),
            ("water-ingress", 0.2, 'pos="0.02 0.01 0.05"/>', 'pos="0.02 0.01 0.05"/><geom type="sphere" '
             'size="0.001" mass="0.2" fluidshape="none" pos="-0.1 0 0"/>'),
            ("water-ingress", (0.2, 0.06), 'pos="0.02 0.01 0.05"/>', 'pos="0.02 0.01 0.05"/>'
             '<geom type="sphere" size="0.001" mass="0.2" fluidshape="none" pos="-0.04 0 0"/>'),
            ("current", 0.05, 'viscosity="0.001"', 'viscosity="0.001" wind="0.05 0 0"'),
            ("com-offset", 0.01, 'axis="1 0 0" damping="0"/>', 'axis="1 0 0" damping="0"/>INERTIAL'),
        ],
    )  # fmt: skip
    def test_as_the_edited_file(self, tmp_path, effect, value, before, after):
        assert before in FISH
        text = FISH.replace(before, after)
        if effect == "linear-drag":
            text = text.replace('axis="0 1 0" damping="0"', 'axis="0 1 0" damping="0.3"')
        if "INERTIAL" in text:
            own = mujoco.MjModel.from_xml_string(FISH).body("head")
            mass, inertia, at = (
                float(own.mass[0]),
                " ".join(map(str, own.inertia)),
                own.ipos + np.array([0.01, 0.0, 0.0]),
            )
            words = f'<inertial pos="{at[0]} {at[1]} {at[2]}" mass="{mass}" diaginertia="{inertia}"/>'
            text = text.replace("INERTIAL", words)
        log = swum(text, 2.0)
        experiment = load_experiment(
            written(tmp_path, FISH, "fish.xml", fish_model(), [log], start_state="rest")
        )
        model, (trial,) = experiment.model, experiment.trials
        effects = [e for e in list_effects() if e.name == effect]
        forms = applicable(effects, model, [trial])
        form = next(f for f in forms if getattr(f, "joint", "fin") == "fin")
        acted = model.with_effects([form], [trial])
        values = np.array([trial.starts.get(p.name, p.start) for p in acted.parameters])
        plain = acted.run(values, trial)
        own = np.atleast_1d(value)
        values[len(model.parameters) : len(model.parameters) + len(own)] = own
        simulated = acted.run(values, trial)
        for name in ("x_m", "y_m", "fin_rad"):
            error = np.max(np.abs(simulated[name] - log[name]))
            change = np.max(np.abs(plain[name] - log[name]))
            assert error < 1e-3 * change + 1e-6, (name, error, change)

    def test_those_without_a_form_are_named(self, tmp_path):
        experiment = load_experiment(written(tmp_path, FISH, "fish.xml", fish_model(), [swum(FISH, 1.0)]))
        found = {e.name for e in applicable(list_effects(), experiment.model, experiment.trials)}
        assert {
            "servo-backlash",
            "servo-lag",
            "servo-delay",
            "camera-scale",
            "marker-offset",
            "added-mass",
        } <= found
        assert not found & {"wall", "waves", "tether", "wake-lift", "pulley-friction"}

    def test_forms_of_mujoco_do_not_act_on_other_models(self):
        experiment = load_experiment("sample_logs/tfish/trials.yaml")
        found = applicable(list_effects(), experiment.model, experiment.trials)
        assert all(effect.of_model is None for effect in found)


class TestRepaired:
    def test_it_compiles_to_the_model_and_keeps_the_text(self, tmp_path):
        model = fish_model(k_fin="joint/fin/stiffness", blunt="geom/fin/fluidcoef[0]", kp="actuator/servo/kp")
        experiment = load_experiment(written(tmp_path, FISH, "fish.xml", model, [swum(FISH, 1.0)]))
        effects = [e for e in list_effects() if e.name in ("water-ingress", "current", "joint-friction")]
        chosen = [
            f
            for f in applicable(effects, experiment.model, experiment.trials)
            if getattr(f, "joint", "fin") == "fin"
        ]
        acted = experiment.model.with_effects(chosen, experiment.trials)
        values = np.array([p.start for p in acted.parameters])
        values[:3] = 0.09, 0.7, 5.0
        named = {p.name: k for k, p in enumerate(acted.parameters)}
        sizes = {"water-ingress/mass_kg": 0.3, "water-ingress/along_m": 0.05, "current/cx_m_s": 0.04}
        for name, value in {**sizes, "joint-friction/fin_friction_N_m": 0.002}.items():
            values[named[name]] = value
        hooks = acted.hooks(values, experiment.trials[0])
        edited = edit(acted, values[: acted.acting[0].first], hooks)
        assert edited.left_out == []
        assert "<!-- A fish with a servo in the peduncle" in edited.text
        compiled = mujoco.MjModel.from_xml_string(edited.text)
        assert compiled.joint("fin").stiffness[0] == 0.09
        assert compiled.joint("fin").frictionloss[0] == 0.002
        assert compiled.actuator("servo").gainprm[0] == 5.0
        assert compiled.opt.wind[0] == 0.04
        assert compiled.body("head").mass[0] == pytest.approx(
            0.3 + mujoco.MjModel.from_xml_string(FISH).body("head").mass[0]
        )
        # every other line is as it was
        assert len(set(FISH.splitlines()) - set(edited.text.splitlines())) <= 5

    def test_a_gain_without_an_attribute_of_its_own_is_named(self, tmp_path):
        text = FISH.replace(
            '<position name="servo" joint="servo" kp="6" kv="0.05"/>',
            '<general name="servo" joint="servo" gainprm="6" biastype="affine" biasprm="0 -6 -0.05"/>',
        )
        model = fish_model(gain="actuator/servo/gainprm[0]", k_fin="joint/fin/stiffness")
        experiment = load_experiment(written(tmp_path, text, "fish.xml", model, [swum(text, 1.0)]))
        values = np.array([p.start for p in experiment.model.parameters])
        values[:2] = 5.0, 0.09
        edited = edit(experiment.model, values, experiment.model.hooks(values, experiment.trials[0]))
        assert mujoco.MjModel.from_xml_string(edited.text).joint("fin").stiffness[0] == 0.09
        assert any("kp of the actuator 'servo'" in one for one in edited.left_out)


SIMULATOR = '''"""A boat with thrust and drag."""
import numpy as np


def simulate(parameters, inputs, times):
    speed, way = np.zeros(len(times)), np.zeros(len(times))
    for k in range(1, len(times)):
        h = (times[k] - times[k - 1]) / 4
        u, x = speed[k - 1], way[k - 1]
        for _ in range(4):
            u += h * (parameters["gain"] * inputs["cmd"][k - 1] - parameters["drag"] * u * abs(u)) / 4.0
            x += h * u
        speed[k], way[k] = u, x
    return {"x_m": way, "u_m_s": speed}
'''
BOAT = {
    "python": "sim.py:simulate",
    "parameters": {
        "gain": {"start": 1.5, "bounds": [0, 10], "unit": "N"},
        "drag": {"start": 1.0, "bounds": [0, 10]},
    },
    "inputs": ["cmd"],
    "outputs": ["x_m", "u_m_s"],
}


def sailed(seed: int, size: float, period: float, lag_s: float) -> dict[str, Any]:
    """Return a log of the boat whose thruster lags, by another integrator."""
    time = np.arange(0.0, 12.0, 0.02)
    command = size * np.sign(np.sin(2.0 * np.pi * time / period)) * (0.7 + 0.3 * np.sin(time)) * (time > 0.3)

    def rates(t: float, y: Any) -> list[float]:
        told = command[min(int(t / 0.02), len(time) - 1)]
        thrust = y[2] if lag_s else told
        return [y[1], (2.0 * thrust - 1.5 * y[1] * abs(y[1])) / 4.0, (told - y[2]) / (lag_s or 1.0)]

    y = solve_ivp(rates, (0.0, 12.0), [0.0, 0.0, 0.0], t_eval=time, rtol=1e-7, max_step=0.01).y
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, [[0.004], [0.01]], (2, len(time)))
    return {"t_s": time, "x_m": y[0] + noise[0], "u_m_s": y[1] + noise[1], "cmd": command}


class TestPython:
    def test_a_lag_is_found(self, swimid, tmp_path, monkeypatch):
        logs = [
            sailed(k, size, period, 0.4) for k, (size, period) in enumerate([(1, 6), (2, 8), (3, 7), (2, 5)])
        ]
        written(tmp_path, SIMULATOR, "sim.py", BOAT, logs)
        monkeypatch.chdir(tmp_path)
        ran = swimid("diagnose", "trials.yaml", "-o", "gap.yaml", "--json")
        assert ran.status == 0, ran.err
        result = ran.json["result"]
        assert result["verdict"] == "explained"
        (cause,) = result["causes"]
        assert cause["effect"] == "servo-lag"
        size = cause["parameters"]["time_constant_s"]
        assert size["value"] == pytest.approx(0.4, abs=max(3 * size["stderr"], 0.02))
        assert "wall" in result["left_out"]
        ran = swimid("compare", "trials.yaml", "--params", "repaired.yaml", "--json")
        assert ran.json["verdict"]["level"] == "good"
        assert "--experiment" not in ran.out
        ran = swimid("sensitivity", "trials.yaml", "--samples", "8", "--json")
        assert {one["quantity"] for one in ran.json["result"]["outputs"]} == {"misfit_x_m", "misfit_u_m_s"}

    def test_in_memory(self, tmp_path):
        import swimid as package

        (tmp_path / "sim.py").write_text(SIMULATOR)
        model = {**BOAT, "python": f"{tmp_path / 'sim.py'}:simulate"}
        logs = [{"log": pd.DataFrame(sailed(k, 1.0 + k, 6.0, 0.0))} for k in range(3)]
        fit = package.fit(package.load(logs, experiment="python", model=model))
        assert fit["drag"].value == pytest.approx(1.5, abs=0.03)


class TestErrors:
    """Each error names the file, the value and what is there."""

    @pytest.mark.parametrize(
        "change, text, hint",
        [
            ({"parameters": {"k": {"path": "joint/hing/damping"}}}, "has no joint 'hing'", "hinge"),
            (
                {"parameters": {"k": {"path": "joint/hinge/dampin"}}},
                "'dampin' of joint/hinge/dampin cannot",
                "damping",
            ),
            ({"parameters": {"k": {"path": "body/rod/ipos"}}}, "has several values", "ipos[0]"),
            (
                {"parameters": {"k": {"path": "joint/hinge/damping", "bounds": [1, 2]}}},
                "outside the bounds",
                None,
            ),
            (
                {"parameters": {"k": {"path": "joint/hinge/damping", "bounds": [2, 1]}}},
                "increasing order",
                None,
            ),
            ({"outputs": {"hinge_rad": "joint/hing"}}, "has no joint 'hing'", "hinge"),
            ({"outputs": {"hinge_rad": "joints/hinge"}}, "is not a valid output", "joint/NAME"),
            ({"inputs": {"motor": "cmd"}}, "has no actuator 'motor'", None),
            ({"mjcf": "other.xml"}, "there is no such file", None),
            ({"keyframe": "home"}, "has no key 'home'", None),
        ],
    )
    def test_of_a_file_of_mujoco(self, swimid, tmp_path, change, text, hint):
        path = written(tmp_path, PENDULUM, "pendulum.xml", {**PENDULUM_MODEL, **change}, [swing(1, 0.6)])
        ran = swimid("fit", path)
        assert ran.status == 3
        assert text in ran.err
        assert hint is None or hint in ran.err

    def test_of_the_xml(self, swimid, tmp_path):
        path = written(
            tmp_path, "<mujoco>\n<oops/></mujoco>", "pendulum.xml", PENDULUM_MODEL, [swing(1, 0.6)]
        )
        ran = swimid("fit", path)
        assert ran.status == 3
        assert "pendulum.xml" in ran.err
        assert "line 2" in ran.err

    @pytest.mark.parametrize(
        "python, text",
        [
            ("sim.py:simulat", "has no function 'simulat'"),
            ("sim.py", "must have the form module:function"),
            ("no_such_module:simulate", "cannot be imported"),
            ("other.py:simulate", "there is no such file"),
        ],
    )
    def test_of_a_function(self, swimid, tmp_path, python, text):
        path = written(tmp_path, SIMULATOR, "sim.py", {**BOAT, "python": python}, [sailed(1, 1.0, 6.0, 0.0)])
        ran = swimid("fit", path)
        assert ran.status == 3
        assert text in ran.err

    @pytest.mark.parametrize(
        "code, text",
        [
            ("return {}", "returns no 'x_m'"),
            ("return {'x_m': times[:3], 'u_m_s': times}", "with the shape (3,)"),
        ],
    )
    def test_of_what_a_function_returns(self, swimid, tmp_path, code, text):
        source = f"def simulate(parameters, inputs, times):\n    {code}\n"
        path = written(tmp_path, source, "sim.py", BOAT, [sailed(1, 1.0, 6.0, 0.0)])
        ran = swimid("fit", path)
        assert ran.status == 2
        assert text in ran.err

    def test_of_a_function_with_noise_of_its_own(self, swimid, tmp_path):
        noisy = SIMULATOR.replace('{"x_m": way', '{"x_m": way + 0.002 * np.random.normal(size=len(way))')
        ran = swimid("fit", written(tmp_path, noisy, "sim.py", BOAT, [sailed(1, 1.0, 6.0, 0.0)]))
        assert ran.status == 3
        assert "returns other values for equal arguments" in ran.err
        assert "seed its random numbers" in ran.err

    def test_of_an_input(self, tmp_path):
        log = swum(FISH, 1.0)
        log.loc[10:20, "cmd_rad"] = np.nan
        with pytest.raises(InputError, match="the input lacks more than 4 samples"):
            load_experiment(written(tmp_path, FISH, "fish.xml", fish_model(), [log], start_state="rest"))


@pytest.mark.slow
class TestDiagnosis:
    def test_play_of_a_servo_is_found_and_the_file_repaired(self, swimid, tmp_path, monkeypatch):
        fine = FISH.replace(
            'timestep="0.004" integrator="implicitfast"', 'timestep="0.0005" integrator="RK4"'
        )
        logs = [
            swum(fine, 4.0, seed=k, play=0.08, beat=beat, every_s=0.02)
            for k, beat in enumerate((1.0, 1.4, 1.8, 1.2))
        ]
        model = fish_model(k_fin="joint/fin/stiffness", blunt="geom/head/fluidcoef[0]")
        written(tmp_path, FISH, "fish.xml", model, logs)
        monkeypatch.chdir(tmp_path)
        ran = swimid("diagnose", "trials.yaml", "-o", "gap.yaml", "--json")
        assert ran.status == 0, ran.err
        assert ran.json["result"]["causes"][0]["effect"] == "servo-backlash"
        size = ran.json["result"]["causes"][0]["parameters"]["backlash_rad"]
        assert size["value"] == pytest.approx(0.08, abs=0.01)
        text = (tmp_path / "repaired.xml").read_text()
        assert "servo-backlash, which acts outside the file" in text
        assert mujoco.MjModel.from_xml_string(text).joint("fin").stiffness[0] == pytest.approx(0.06, rel=0.1)
