"""The blind swimmers are what they claim: right equations, causes that vanish, files a user would have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from swimid.fitting.fit_common import load_experiment
from tests.generators import swimmer
from validation.blind import swim_actuation as actuation
from validation.blind import swim_body, swimmers
from validation.blind.swim_case import Act, Trial
from validation.blind.swim_tables import Water

#: They test the generators of blind cases, not the package.
pytestmark = pytest.mark.slow

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
