"""Transmissions: several joints that follow one actuator, against closed forms and an independent fish."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.effects.actuation import AmplitudeLoss, ServoBacklash, ServoDelay
from swimid.effects.base import Effect
from swimid.effects.structure import JointLocked
from swimid.errors import InputError
from swimid.files import yamlio
from swimid.fitting.drives import TailBeat
from swimid.fitting.fit_common import load_experiment
from swimid.fitting.model import SwimInput, Trial
from swimid.notices import SwimidWarning
from swimid.results.parameters import Estimate, ParameterFile
from swimid.robots import file as robot_format
from swimid.swimmer import trials as experiment
from swimid.swimmer.drive import Grid
from swimid.swimmer.fit_graybox import fit_graybox
from swimid.swimmer.model import Swimmer
from tests.conftest import Ran
from tests.effect_cases import acted, start
from tests.generators import swimmer
from tests.generators.files import write_log, write_trials

RATIOS = (0.2, 0.3, 0.5)
DRIVE = {"frequency_hz": 1.2, "amplitude_deg": 30.0, "bias_deg": 5.0}
#: Crank of radius 1 and rocker of radius 2, whose axes are 3 apart.
CRANK = 1.0, 3.0


def fish(
    folder: Path,
    laws: Sequence[dict[str, Any]],
    actuators: dict[str, dict[str, Any]] | None = None,
    **coefficients: dict[str, Any],
) -> Path:
    """Write the robot file of the tendon fish with other laws of its three driven joints."""
    data = yamlio.plain(yamlio.load(robot_format.locate("tfish")))
    del data["readings"]
    body = data["multilink"]
    if actuators is not None:
        body["actuators"] = actuators
    for known in body["coefficients"].values():
        known["free"], known["start"] = False, known["value"]
    body["coefficients"] |= coefficients
    for joint, law in zip(body["joints"], laws, strict=False):
        joint["driven"] = law
    path = folder / "fish.yaml"
    path.write_text(json.dumps(data, indent=1))
    return path


def by_ratio(*ratios: Any) -> list[dict[str, Any]]:
    return [{"actuator": "tendon", "ratio": ratio} for ratio in ratios]


def by_table(*tables: Any) -> list[dict[str, Any]]:
    return [{"actuator": "tendon", "table_deg": table} for table in tables]


def swims(columns: dict[str, np.ndarray], folder: Path, robot: Path, drive: dict[str, float] | None) -> Path:
    """Write a log with these columns and its trials file."""
    write_log(folder / "run.csv", columns, "%.12g")
    driven = "" if drive is None else f", drive: {json.dumps(drive)}"
    return write_trials(folder / "trials.yaml", "free-swim", robot, [f"id: run, log: run.csv{driven}"])


def simulated(trials: Path) -> dict[str, np.ndarray]:
    """Simulate the trial with the coefficients of the robot file."""
    loaded = load_experiment(trials, start_state="rest")
    values = np.array([p.start for p in loaded.model.parameters])
    return loaded.model.simulate(values, loaded.trials[0])


def truth(**drive: float) -> dict[str, np.ndarray]:
    """Swim of the independent tendon fish whose joints take these shares of the drive."""
    fish = replace(swimmer.tfish(), gain=np.array([*RATIOS, 0.0]))
    return swimmer.swim(fish, {**DRIVE, **drive}, 4.0)


def crank_deg(count: int) -> list[list[float]]:
    """Rows of the table of a crank and a slotted rocker, between -70 and 70 degrees of the crank."""
    radius, apart = CRANK
    angle = np.radians(np.linspace(-70.0, 70.0, count))
    rocker = np.arctan2(radius * np.sin(angle), apart - radius * np.cos(angle))
    return np.degrees(np.column_stack([angle, rocker])).tolist()


def moved(model: Swimmer, swim: SwimInput, time: np.ndarray) -> np.ndarray:
    """Return angle, rate and acceleration of the driven joints at even times, shape (n, joints, 3)."""
    step = 2.0 * (time[1] - time[0])
    grid = Grid(float(time[0]), step, (len(time) - 1) // 2)
    trial = Trial("moved", "fit", time, {}, swim=swim)
    return model.joints.motion(start(model), trial, grid, 0.0).table[:, :, :3]


class TestMotion:
    time = 2.0 + np.arange(4001) * 5e-4
    swim = SwimInput(TailBeat("sine", 1.1, 1.0, 0.1))

    def actuator(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        omega = 2 * math.pi * 1.1
        wave = omega * self.time
        return 0.1 + np.sin(wave), omega * np.cos(wave), -(omega**2) * np.sin(wave)

    def test_ratio(self, tmp_path: Path) -> None:
        _, model = experiment.robot_model(str(fish(tmp_path, by_ratio(*RATIOS), {"tendon": {}})))
        found = moved(model, self.swim, self.time)
        for k, ratio in enumerate(RATIOS):
            np.testing.assert_allclose(found[:, k], ratio * np.column_stack(self.actuator()), atol=1e-10)

    def test_table_of_a_crank(self, tmp_path: Path) -> None:
        """The table converges to the closed form of the linkage: angle, rate and acceleration."""
        radius, apart = CRANK
        a, rate, bend = self.actuator()
        far = radius**2 + apart**2 - 2 * radius * apart * np.cos(a)
        slope = radius * (apart * np.cos(a) - radius) / far
        curve = -radius * apart * np.sin(a) * (apart**2 - radius**2) / far**2
        angle = np.arctan2(radius * np.sin(a), apart - radius * np.cos(a))
        expected = np.column_stack([angle, slope * rate, slope * bend + curve * rate**2])
        errors = []
        for count in (36, 71, 141):
            path = fish(tmp_path, by_table(*[crank_deg(count)] * 3), {"tendon": {}})
            _, model = experiment.robot_model(str(path))
            found = moved(model, self.swim, self.time)[:, 1]
            errors.append(np.sqrt(np.mean((found - expected) ** 2, axis=0)) / np.ptp(expected, axis=0))
        assert np.all(errors[0] < [1e-4, 1e-3, 0.05])
        # the error falls with the third power of the spacing, and by one power for each derivative
        np.testing.assert_allclose(errors[0] / errors[1], [8.0, 4.0, 2.0], rtol=0.1)
        np.testing.assert_allclose(errors[1] / errors[2], [8.0, 4.0, 2.0], rtol=0.1)


def test_a_fish_with_a_tendon_swims_as_in_an_independent_simulation(tmp_path: Path) -> None:
    expected = truth()
    log = {name: expected[name] for name in ("t_s", "x_m", "y_m", "yaw_rad")}
    found = simulated(swims(log, tmp_path, fish(tmp_path, by_ratio(*RATIOS), {"tendon": {}}), DRIVE))
    for name in ("x_m", "y_m", "yaw_rad", "joint1_rad", "joint2_rad", "joint3_rad", "joint4_rad"):
        # fixed steps of fourth order against an adaptive method at 1e-8
        assert np.max(np.abs(found[name] - expected[name])) < 1e-5 * np.ptp(expected[name]), name


@pytest.mark.slow
@pytest.mark.parametrize("column", ["joint_tendon_rad", "cmd_tendon_rad"])
def test_a_logged_actuator_moves_its_joints_as_logged_joints_do(column: str, tmp_path: Path) -> None:
    """The path is that of the same robot with own actuators whose angles are logged, and the true one."""
    expected = truth()
    whole = expected["joint3_rad"] / RATIOS[2]
    pose = {name: expected[name] for name in ("t_s", "x_m", "y_m", "yaw_rad")}
    robot = fish(tmp_path, by_ratio(*RATIOS), {"tendon": {}})
    followed = simulated(swims({**pose, column: whole}, tmp_path, robot, None))
    joints = {f"joint{k}_rad": expected[f"joint{k}_rad"] for k in (1, 2, 3)}
    robot = fish(tmp_path, [{"gain": 1.0}] * 3)
    logged = simulated(swims({**pose, **joints}, tmp_path, robot, None))
    for name in ("x_m", "y_m", "yaw_rad"):
        size = np.ptp(expected[name])
        assert np.max(np.abs(followed[name] - logged[name])) < 1e-5 * size, name
        # the log at 50 Hz is interpolated by a cubic spline
        assert np.max(np.abs(followed[name] - expected[name])) < 1e-3 * size, name


@pytest.mark.slow
def test_a_ratio_is_estimated_from_noisy_logs(tmp_path: Path) -> None:
    """Two ratios from pose and one logged joint angle, within three standard errors."""
    runs = [
        swimmer.Run(f"r{k}", {**DRIVE, "frequency_hz": hz}, truth(frequency_hz=hz))
        for k, hz in enumerate((1.0, 1.5))
    ]
    robot = fish(
        tmp_path,
        by_ratio("k_1", 0.3, "k_3"),
        {"tendon": {}},
        k_1={"value": 0.3, "bounds": [0, 1]},
        k_3={"value": 0.3, "bounds": [0, 1]},
    )
    noise = {"x_m": 0.002, "y_m": 0.002, "yaw_rad": 0.01, "joint1_rad": 0.01}
    trials = swimmer.write_trials(tmp_path, "tfish", runs, noise, 4, columns=list(noise), robot=str(robot))
    fitted = fit_graybox(trials, starts=1).document.parameters
    for name, true in (("k_1", RATIOS[0]), ("k_3", RATIOS[2])):
        estimate = fitted[name]
        assert estimate.status == "estimated"
        assert estimate.stderr is not None
        assert estimate.stderr < 0.01
        assert abs(estimate.value - true) < 3 * estimate.stderr


class TestEffects:
    """Effects of actuators act on the actuator, and the joints follow it by the table."""

    time = np.arange(0.0, 3.0, 0.01)

    @pytest.mark.parametrize(
        ("effect", "size", "actual"),
        [
            (AmplitudeLoss(), 0.3, lambda t, a: 0.7 * a(t)),
            (JointLocked("joint_tendon_rad"), 0.4, lambda t, a: 0.6 * a(t)),
            (ServoDelay(), 0.05, lambda t, a: a(t - 0.05)),
        ],
        ids=["amplitude loss", "lock", "delay"],
    )
    def test_act_on_the_actuator(
        self, effect: Effect, size: float, actual: Callable[..., np.ndarray], tmp_path: Path
    ) -> None:
        model, trial = self.swim(tmp_path)
        found = acted(model, trial, [(effect, size)])

        def tendon(t: np.ndarray) -> np.ndarray:
            s = np.clip(t, 0.0, 1.0)
            return s**3 * (10 - 15 * s + 6 * s**2) * 0.8 * np.sin(2 * math.pi * t)

        angle = actual(self.time, tendon)
        radius, apart = CRANK
        rocker = np.arctan2(radius * np.sin(angle), apart - radius * np.cos(angle))
        np.testing.assert_allclose(found["joint1_rad"], 0.2 * angle, atol=1e-4)
        np.testing.assert_allclose(found["joint3_rad"], rocker, atol=2e-4)

    def test_all_joints_rest_in_the_play_of_the_actuator(self, tmp_path: Path) -> None:
        model, trial = self.swim(tmp_path)
        found = acted(model, trial, [(ServoBacklash(), 0.3)])
        assert 0.5 * np.ptp(found["joint1_rad"][150:]) == pytest.approx(0.2 * (0.8 - 0.15), abs=2e-3)
        still = np.abs(np.gradient(found["joint1_rad"], self.time)) < 1e-3
        assert still[150:].mean() > 0.2
        assert np.abs(np.gradient(found["joint3_rad"], self.time))[still].max() < 0.02

    def swim(self, folder: Path) -> tuple[Any, Trial]:
        laws = [*by_ratio(0.2, 0.3), *by_table(crank_deg(141))]
        _, model = experiment.robot_model(str(fish(folder, laws, {"tendon": {}})))
        swim = SwimInput(TailBeat("sine", 1.0, 0.8), pose=(0.0, 0.0, 0.0))
        return model, Trial("run", "fit", self.time, {}, swim=swim)


def test_the_load_of_an_actuator_is_that_of_all_its_joints(tmp_path: Path) -> None:
    """At an actuator rate of 1 rad/s the kinetic energy of the links and their water is half the inertia."""
    ratios = (0.2, 0.3, -0.4)
    _, model = experiment.robot_model(str(fish(tmp_path, by_ratio(*ratios), {"tendon": {}})))
    tail, behind = swimmer.tfish(), slice(1, 5)
    turns = np.cumsum([*ratios, 0.0])
    lengths, mass = tail.length[behind], tail.mass[behind] * (1.0 + swimmer.TFISH["c_ma"])
    fronts = np.concatenate([[0.0], np.cumsum(turns * lengths)[:-1]])
    speeds = fronts + turns * tail.com[behind]
    expected = mass @ speeds**2 + tail.inertia[behind] @ turns**2
    assert model.body is not None
    inertia, drag = model.body.compute_actuator_load(model.body.tables(), 0)
    assert inertia == pytest.approx(expected, rel=1e-6)
    points = tail.water.across > 0
    link, place = tail.water.link[points] - 1, tail.water.behind[points]
    moved = link >= 0
    speeds = (fronts[link] + turns[link] * place)[moved]
    assert drag == pytest.approx(tail.water.across[points][moved] @ np.abs(speeds) ** 3, rel=1e-6)


def test_the_power_of_joints_on_one_actuator_is_added(tmp_path: Path) -> None:
    """Joints on one actuator exchange energy: without recovery it supplies less than own actuators."""
    time = np.arange(401) / 100
    trial = Trial("run", "fit", time, {}, swim=SwimInput(TailBeat("sine", 1.0, 0.6), pose=(0.0, 0.0, 0.0)))
    powers = []
    for laws, actuators in ((by_ratio(0.6, -0.3, 0.5), {"tendon": {}}), ([0.6, -0.3, 0.5], None)):
        own = [law if actuators else {"gain": law} for law in laws]
        _, model = experiment.robot_model(str(fish(tmp_path, own, actuators)))
        (_, found), *_ = model.with_energetics([(start(model), trial)], [1.0])
        assert found is not None
        by_hand = (found.torque_N_m * found.rate_rad_s).sum(axis=1)
        np.testing.assert_allclose(found.power_W.sum(axis=1), by_hand, atol=1e-12)
        powers.append((found.mean_power_W(), found.mean_positive_power_W()))
    assert powers[0][0] == pytest.approx(powers[1][0], rel=1e-9)
    assert powers[0][1] < 0.99 * powers[1][1]


def test_an_actuator_beyond_a_table_follows_its_tangent_with_a_warning(tmp_path: Path) -> None:
    """The rate does not jump at the end of the table."""
    table = [[-30, -12], [0, 0], [30, 10]]
    path = fish(tmp_path, [*by_ratio(0.2, 0.3), *by_table(table)], {"tendon": {}})
    _, model = experiment.robot_model(str(path))
    swim, time = SwimInput(TailBeat("sine", 1.0, math.radians(45.0))), 2.0 + np.arange(2001) * 5e-4
    with pytest.warns(SwimidWarning, match=r"'tendon'.*-45 to 45 deg.*'joint3', -30 to 30 deg") as seen:
        found = moved(model, swim, time)[:, 2]
    assert [w.message.code for w in seen] == ["SWM077"]
    actuator = np.radians(45.0) * np.sin(2 * math.pi * time)
    beyond = actuator > math.radians(30.5)
    slopes = np.diff(found[beyond, 0]) / np.diff(actuator[beyond])
    np.testing.assert_allclose(slopes[1:-1], slopes[1], atol=1e-6)
    rate = np.gradient(found[:, 0], time)
    np.testing.assert_allclose(rate[1:-1], found[1:-1, 1], atol=2e-3)
    _, other = experiment.robot_model(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        moved(other, SwimInput(TailBeat("sine", 1.0, math.radians(30.0))), time)


TABLE = [[-30, -12], [0, 0], [30, 10]]
#: The law of the second joint, words of the reason, and of the hint.
WRONG: dict[str, tuple[dict[str, Any], str, str]] = {
    "unknown actuator": ({"actuator": "tendn"}, "no actuator 'tendn'", "'tendon'"),
    "driven twice": ({"actuator": "tendon", "gain": 2}, "'gain' would drive the joint a second time", ""),
    "own servo": (
        {"actuator": "tendon", "servo": {"natural_frequency_hz": 5}}, "'servo' would drive the joint", "",
    ),
    "ratio and table": ({"actuator": "tendon", "ratio": 0.2, "table_deg": TABLE}, "not both", ""),
    "ratio of nothing": ({"ratio": 0.2}, "'ratio' needs an 'actuator'", ""),
    "one row": ({"actuator": "tendon", "table_deg": [[0, 0]]}, "at least 2", ""),
    "repeated value": (
        {"actuator": "tendon", "table_deg": [[0, 0], [10, 2], [10, 3]]}, "but 10 follows 10", "",
    ),
    "unsorted": ({"actuator": "tendon", "table_deg": [[0, 0], [10, 2], [-10, 3]]}, "must increase", ""),
    "unknown coefficient": ({"actuator": "tendon", "ratio": "k"}, "no coefficient 'k'", ""),
}  # fmt: skip


class TestErrors:
    @pytest.mark.parametrize("name", WRONG)
    def test_wrong_law(self, name: str, tmp_path: Path) -> None:
        law, reason, hint = WRONG[name]
        path = fish(tmp_path, [*by_ratio(0.2), law], {"tendon": {}})
        with pytest.raises(InputError) as caught:
            experiment.robot_model(str(path))
        error = caught.value
        assert error.file == str(path)
        assert error.line is not None
        assert "joints" in (error.column or "")
        assert reason in error.reason
        assert hint in (error.hint or "")

    def test_driven_and_passive(self, tmp_path: Path) -> None:
        path = fish(tmp_path, by_ratio(0.2, 0.2, 0.2, 0.2), {"tendon": {}})
        with pytest.raises(InputError, match="'joint4' is both driven and passive"):
            experiment.robot_model(str(path))

    def test_name_of_a_joint(self, tmp_path: Path) -> None:
        path = fish(tmp_path, [{"actuator": "joint4"}], {"joint4": {}})
        with pytest.raises(InputError, match="an actuator and a joint have the name 'joint4'") as caught:
            experiment.robot_model(str(path))
        assert caught.value.line is not None

    def test_log_without_the_actuator(self, tmp_path: Path) -> None:
        run = truth()
        log = {name: run[name] for name in ("t_s", "x_m", "y_m", "yaw_rad", "joint1_rad")}
        trials = swims(log, tmp_path, fish(tmp_path, by_ratio(*RATIOS), {"tendon": {}}), None)
        with pytest.raises(InputError, match="'tendon' needs this column or 'cmd_tendon_rad'") as caught:
            load_experiment(trials)
        assert caught.value.column == "joint_tendon_rad"


# ------------------------------------------------------------ in space


SPACE: dict[str, Any] = {
    "format": "swimid-robot/1",
    "name": "flapper",
    "multibody": {
        "actuators": {"crank": {}},
        "links": [
            {"name": name, "mass_kg": mass, "inertia_kg_m2": [0.01, 0.01, 0.01]}
            for name, mass in (("hull", 3.0), ("left", 0.3), ("right", 0.3))
        ],
        "joints": [
            {
                "name": f"{side}_flap",
                "parent": "hull",
                "child": side,
                "at_m": [0, sign * 0.1, 0],
                "axis": [1, 0, 0],
                "driven": {"actuator": "crank", "ratio": sign * 0.5},
            }
            for side, sign in (("left", 1), ("right", -1))
        ],
        "strokes": {
            "flap": {
                "period_s": 1.0,
                "knots_s": [0, 0.25, 0.5, 0.75, 1.0],
                "angles_deg": {"crank": [0, 40, 0, -40, 0]},
            }
        },
    },
}


class TestInSpace:
    def test_hinges_follow_the_stroke_of_their_actuator(self, tmp_path: Path) -> None:
        path = tmp_path / "flapper.yaml"
        path.write_text(json.dumps(SPACE))
        robot, model = experiment.robot_model(str(path))
        assert robot.multibody is not None
        time = np.arange(0.0, 2.01, 0.25)
        stroke = experiment.cycle_of(experiment.StrokeDrive(stroke="flap", frequency_hz=1.0), model)
        trial = Trial("run", "fit", time, {}, swim=SwimInput(stroke=stroke, pose=(0.0,) * 6))
        found = model.simulate(start(model), trial)
        expected = math.radians(20.0) * np.sin(2 * math.pi * time)
        np.testing.assert_allclose(found["joint1_rad"], expected, atol=1e-9)
        np.testing.assert_allclose(found["joint2_rad"], -expected, atol=1e-9)
        # mirrored flaps neither roll nor sway the hull, but push it up and down
        np.testing.assert_allclose(found["roll_rad"], 0.0, atol=1e-12)

    def test_a_stroke_cannot_move_a_hinge_that_follows(self, tmp_path: Path) -> None:
        wrong = json.loads(json.dumps(SPACE))
        wrong["multibody"]["strokes"]["flap"]["angles_deg"] = {"left_flap": [0, 40, 0, -40, 0]}
        path = tmp_path / "flapper.yaml"
        path.write_text(json.dumps(wrong))
        with pytest.raises(InputError, match="cannot move 'left_flap': name an actuator"):
            experiment.robot_model(str(path))


# ------------------------------------------------------------ commands


BEAT = ("--frequency-hz", "1", "--amplitude-deg", "20", "--duration-s", "2")


@pytest.mark.slow
def test_simulate_writes_the_command_of_the_actuator(tmp_path: Path, swimid: Callable[..., Ran]) -> None:
    robot, out = fish(tmp_path, by_ratio(*RATIOS), {"tendon": {}}), tmp_path / "out.csv"
    ran = swimid("simulate", "--robot", robot, *BEAT, "-o", out)
    assert ran.status == 0, ran.err
    lines = [line for line in out.read_text().splitlines() if not line.startswith("#")]
    columns = dict(zip(lines[0].split(","), np.loadtxt(lines[1:], delimiter=",").T, strict=True))
    assert "cmd1_rad" not in columns
    for k, ratio in enumerate(RATIOS, 1):
        np.testing.assert_allclose(columns[f"joint{k}_rad"], ratio * columns["cmd_tendon_rad"], atol=1e-8)


@pytest.mark.parametrize("target", ["mjcf", "gazebo", "json"])
def test_an_export_says_how_to_command_the_joints(
    target: str, tmp_path: Path, swimid: Callable[..., Ran]
) -> None:
    """A cause on the actuator becomes a filter of the command of the actuator."""
    laws = [*by_ratio(0.2, "k"), *by_table(TABLE)]
    robot = fish(tmp_path, laws, {"tendon": {}}, k={"value": 0.3})
    estimates = {
        "k": Estimate(value=0.25, stderr=0.01, unit="1", status="estimated"),
        "amplitude-loss/loss": Estimate(value=0.1, stderr=0.01, unit="1", status="estimated"),
    }
    params, out = tmp_path / "fit.yaml", tmp_path / "out.txt"
    file = ParameterFile(
        model="multilink", robot=str(robot), parameters=estimates, effects=["amplitude-loss"]
    )
    file.write(params)
    ran = swimid("export", params, "--to", target, "-o", out)
    assert ran.status == 0, ran.err
    if target == "json":
        data = json.loads(out.read_text())
        assert list(data["actuators"]) == ["tendon"]
        assert [joint["driven"]["actuator"] for joint in data["joints"][:3]] == ["tendon"] * 3
        return
    text = out.read_text()
    assert "joint2 follows the actuator tendon" in text
    assert "command the servo with 0.25 times its angle" in text
    assert "command the servo with its angle by the table of the robot file" in text
    (causes,) = tmp_path.glob("*_causes.py")
    assert '"tendon": [AmplitudeLossFilter(loss=0.1)]' in causes.read_text()
