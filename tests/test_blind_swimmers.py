"""The blind swimmers are what they claim: right equations, causes that vanish, files a user would have."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swimid.fitting.fit_common import load_experiment
from swimid.results import parameters as parameter_format
from tests.generators import swimmer
from validation.blind import swim_actuation as actuation
from validation.blind import swim_body, swim_gap, swimmers
from validation.blind.swim_case import Act, Trial
from validation.blind.swim_tables import Water

#: They test the generators of blind cases, not the package.
pytestmark = pytest.mark.slow

#: Of a case that comes with an earlier calibration.
SEED_WITH_PRIOR = 5
ROBOTS = ("tfish", "dolphin")
DRIVE = {
    "tfish": {"frequency_hz": 1.4, "amplitude_deg": 25.0, "bias_deg": 8.0},
    "dolphin": {"frequency_hz": 2.0, "amplitude_deg": 20.0},
}


def trial(robot: str, duration_s: float = 2.0) -> Trial:
    return Trial("one", 5, robot, dict(DRIVE[robot]), duration_s, 50.0, (0.2, -0.3, 0.1), 7)


def entries(robot: str) -> dict[str, swimmers.Entry]:
    return {**swimmers.CATALOGUE[robot], **swimmers.OUTSIDE[robot]}


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases of three trials of 4 s."""
    whole = swimmers.plan

    def plan(robot: str, rng: np.random.Generator) -> list[Trial]:
        return [replace(one, duration_s=4.0) for one in whole(robot, rng)[:3]]

    monkeypatch.setattr(swimmers, "plan", plan)


def furthest(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> float:
    return max(float(np.abs(a[name] - b[name]).max()) for name in a)


def joints(kind: str, t: np.ndarray) -> np.ndarray:
    robot = swimmer.KINDS[kind]()
    return actuation.command(DRIVE[kind], robot.gain, t)


def test_nothing_comes_from_the_package_under_test() -> None:
    for path in (Path(__file__).parent / "blind").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            assert not any(name.split(".")[0] == "swimid" for name in names), path


@pytest.mark.slow
@pytest.mark.parametrize("kind", ROBOTS)
def test_agrees_with_the_adaptive_generator(kind: str) -> None:
    options = {"drag_at": "slices"} if kind == "tfish" else {}
    known = swimmer.swim(swimmer.KINDS[kind](slices=16, **options), DRIVE[kind], 0.8, rtol=1e-6)
    t = np.arange(801) * 0.001
    table = np.ascontiguousarray(joints(kind, t).transpose(2, 0, 1))
    poses, angles = swim_body.run(swim_body.of(kind, {}, drag_at="slices"), Water(), table, 0.002, (0, 0, 0))
    up, turn = ("y", "yaw") if kind == "tfish" else ("z", "pitch")
    for column, name in enumerate(("x_m", f"{up}_m", f"{turn}_rad")):
        np.testing.assert_allclose(poses[::10, column], known[name], atol=2e-6)
    last = f"joint{angles.shape[1]}_rad"
    np.testing.assert_allclose(angles[::10, -1], known[last], atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ROBOTS)
def test_steps_are_short_enough(kind: str) -> None:
    fine, coarse = (swimmers.swim(trial(kind), {}, step_s=h) for h in (0.001, 0.002))
    assert furthest(fine, coarse) < 2e-5


@pytest.mark.slow
def test_without_water_momentum_stays() -> None:
    body = swim_body.of("tfish", {})
    body.along, body.across = 0.0 * body.along, 0.0 * body.across
    t = np.arange(1001) * 0.001
    table = np.ascontiguousarray(joints("tfish", t).transpose(2, 0, 1))
    poses, angles = swim_body.run(body, Water(), table, 0.002, (0.0, 0.0, 0.0))
    turned = poses[:, 2:3] + np.concatenate([np.zeros((len(poses), 1)), np.cumsum(angles, axis=1)], axis=1)
    chain = body.chain()
    centre = poses[:, 0] + 1j * poses[:, 1] - np.exp(1j * turned) @ chain.moment / chain.mass
    assert np.abs(centre - centre[0]).max() < 1e-8


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", sorted(swimmers.CATALOGUE["dolphin"] | swimmers.OUTSIDE["tfish"]))
def test_a_cause_fades_with_its_size_and_acts_at_one(robot: str, name: str) -> None:
    if name not in entries(robot) or name == "joint-locked":
        pytest.skip("not of this robot, or not of a size")
    coefficients = {key: value for key, (value, _) in swimmers.FITTED[robot].items()}

    def change(size: float) -> float:
        act = entries(robot)[name].make(np.random.default_rng(1), size, robot)
        one = trial(robot, 1.5)
        if act.start is not None:
            act.start(one, np.random.default_rng(1))
        with_it, without = (swimmers.swim(one, coefficients, acts) for acts in ([act], []))
        if act.broken is not None:
            own = [n for n in range(8) if _broken(act, n, with_it)]
            return float(len(own))
        return furthest(with_it, without)

    if name == "marker-dropout":
        assert 0 < change(0.3) < change(2.0)
    else:
        whole = change(1.0)
        assert whole > 1e-4
        assert change(0.1) < 0.5 * whole


def _broken(act: Act, index: int, channels: dict[str, np.ndarray]) -> bool:
    one = trial("tfish", 4.0)
    one.index = index
    assert act.broken is not None
    names = ("x_m", "y_m", "yaw_rad") if "y_m" in channels else ("x_m", "z_m", "pitch_rad")
    one.robot = "tfish" if "y_m" in channels else "dolphin"
    log = {name: channels[name] for name in names}
    after = act.broken(one, log, channels["t_s"])
    return any(not np.array_equal(after[name], log[name], equal_nan=True) for name in names)


def test_a_second_order_servo_lags_as_it_says() -> None:
    t = np.arange(8001) * 0.001
    ramp = np.array([t, np.ones_like(t), np.zeros_like(t)])[:, None, :]
    lagged = actuation.second_order(t, ramp, 20.0, 0.9)
    assert ramp[0, 0, -1] - lagged[0, 0, -1] == pytest.approx(2 * 0.9 / 20.0, rel=1e-6)
    held = actuation.delayed(t, ramp, 0.05)
    assert ramp[0, 0, -1] - held[0, 0, 4000:].mean() - (t[-1] - t[4000:].mean()) == pytest.approx(
        0.05, abs=2e-3
    )


def test_the_play_is_as_wide_as_it_says() -> None:
    t = np.arange(20001) * 0.0005
    wave = np.array([np.sin(t), np.cos(t), -np.sin(t)])
    angle = actuation.follow_with_play(wave, t[1], 0.05, 0.3)[0]
    assert np.abs(wave[0] - angle).max() == pytest.approx(0.05, rel=1e-2)
    assert angle[t > 3].max() == pytest.approx(0.95, rel=5e-3)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.usefixtures("brief")
def test_a_case_is_read_and_its_clean_channels_are_the_models(robot: str, tmp_path: Path) -> None:
    """The nominal model of the package, at the true coefficients, makes the same noiseless channels."""
    label = swimmers.make_case(tmp_path, robot=robot, effect=None, size=1.0, rng=np.random.default_rng(5))
    found = load_experiment(tmp_path / "trials.yaml")
    assert [t.id for t in found.trials] == [t.id for t in label["trials"]]
    assert label["gap_over_floor"]["overall"] == 0.0
    model = found.model
    for one, hidden in list(zip(found.trials, label["trials"], strict=True))[:2]:
        values = np.array([p.start for p in model.parameters])
        for name, value in label["coefficients"].items():
            values[model.index(name)] = value
        for name, value, at in zip(model.starts, hidden.start, one.swim.pose, strict=True):
            values[model.index(name)] = value - at
        hidden.amplitude = hidden.thrust = hidden.trim = hidden.late = 0.0
        clean = swimmers.swim(hidden, label["coefficients"])
        seen = model.simulate(values, one)
        for name in label["channels"][:3]:
            assert np.abs(seen[name] - clean[name]).max() < 0.3 * label["noise_sd"][name]


@pytest.mark.usefixtures("brief")
def test_a_pair_has_both_and_a_prior_is_read(tmp_path: Path) -> None:
    folder, rng = tmp_path, np.random.default_rng(SEED_WITH_PRIOR)
    label = swimmers.make_case(folder, robot="tfish", effect=("current", "imu-bias"), size=0.5, rng=rng)
    assert "yaw_rate_rad_s" in label["channels"]
    assert label["stages"] == ["environment", "sensing"]
    prior = parameter_format.read(folder / "params_prior.yaml", model="multilink")
    assert prior.robot == "tfish"
    for name, value in label["coefficients"].items():
        assert prior.value(name) == pytest.approx(value, rel=0.35)
    text = "".join(path.read_text(encoding="utf-8") for path in folder.iterdir())
    assert "current" not in text
    assert "bias:" not in text


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_changed_spring_stands_in_the_file_as_it_was(robot: str, tmp_path: Path, brief: None) -> None:
    spring, published, _, _ = swimmers.SPRING[robot]
    label = swimmers.make_case(
        tmp_path, robot=robot, effect=f"parameter:{spring}", size=-0.2, rng=np.random.default_rng(4)
    )
    file = parameter_format.read(tmp_path / "params_prior.yaml")
    estimate = file.parameters[spring]
    assert abs(estimate.value - published) < 4.0 * estimate.stderr
    assert file.correlation is not None
    assert file.correlation.names == [*swimmers.FITTED[robot], spring]
    assert label["factors"] == {spring: pytest.approx(0.8)}
    softer = {**label["coefficients"], spring: 0.8 * published}
    trial = label["trials"][0]
    assert furthest(label["with"][trial.id], swimmers.swim(trial, softer)) == 0.0
    found = swim_gap.refit_gap(label)
    assert found["noncentrality"] > 25.0
    assert set(found["singles"]) == {f"parameter:{name}" for name in swimmers.FITTED[robot]}


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_noise_free_data_exclude_each_effect_of_a_visible_pair(
    robot: str, tmp_path: Path, brief: None
) -> None:
    pair = ("camera-scale", "joint-stiffness")
    label = swimmers.make_case(tmp_path, robot=robot, effect=pair, size=3.0, rng=np.random.default_rng(4))
    left = swim_gap.refit_gap(label)["singles"]
    assert set(pair) <= set(left)
    assert 0.0 < min(left.values()) < swim_gap.refit_gap(label)["noncentrality"]


def test_the_same_seed_makes_the_same_case(tmp_path: Path) -> None:
    for name in ("a", "b"):
        rng = np.random.default_rng(3)
        swimmers.make_case(tmp_path / name, robot="dolphin", effect="waves", size=1.0, rng=rng)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


@pytest.mark.usefixtures("brief")
def test_a_change_that_the_nominal_model_imitates_is_no_gap(tmp_path: Path) -> None:
    label = swimmers.make_case(tmp_path, robot="dolphin", effect=None, size=1.0, rng=np.random.default_rng(5))
    other = {k: v * 1.02 for k, v in label["coefficients"].items()}
    moved = {t.id: swimmers.swim(t, other) for t in label["trials"]}
    left = swim_gap.Refit(label).left(moved, label["without"])
    assert left["raw"] > 50.0
    assert left["noncentrality"] < 5.0
