"""The blind cases of rigs and cruises: their own physics against closed forms, and the runner and scorer."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from validation.blind import cruises, decays, figures, noise_free, rig_effects, rigs, runner, score
from validation.blind.common import STAGE_OF, draw_fit, left_by_each, left_by_refit

BLIND = Path(rigs.__file__).parent


def _rig(**changes) -> rig_effects.Rig:
    known = {"weight": 25.0, "drag": 24.5, "added": 685.0, "friction": 3080.0, "clicks": False}
    return rig_effects.Rig(**(known | changes), rng=np.random.default_rng(0))


def _session(**changes) -> cruises.Session:
    fin = np.array(["2925Rect", "2925Rect", "3825Rect"])
    known = {
        "fin": fin,
        "frequency": np.array([1.5, 3.0, 4.0]),
        "command": np.radians([16.0, 12.0, 16.0]),
        "inertia": np.array([cruises.plate_inertia(*cruises.FINS[f]) for f in fin]),
        "distance": 115.0,
        "drag": 0.5 * 0.997 * 0.705 * 69.8,
        "added": 685.0,
        "efficiency": 0.341,
        "offset": np.radians(5.42),
    }
    return cruises.Session(**(known | changes), rng=np.random.default_rng(0))


def test_the_generators_do_not_know_the_package() -> None:
    for path in BLIND.glob("*.py"):
        assert not re.search(r"^\s*(from|import) swimid", path.read_text(), re.MULTILINE), path.name


@pytest.mark.parametrize("weight", [10.0, 40.0])
def test_a_rig_without_effects_falls_as_the_closed_form(weight: float) -> None:
    t, x = _rig(weight=weight).fall()
    assert x == pytest.approx(rigs.nominal(t, weight, 24.5, 685.0, 3080.0), abs=1e-2)
    assert x[-1] == pytest.approx(rigs.TRAVEL, abs=0.05)


def test_without_drag_and_friction_a_rig_falls_as_galilei_says() -> None:
    t, x = _rig(drag=0.0, friction=0.0).fall()
    total = rigs.MASS + 685.0 + 25.0 + rigs.PULLEY
    assert x == pytest.approx(0.5 * 25.0 * rigs.GRAVITY / total * t**2, rel=1e-5, abs=1e-5)


def test_moving_water_carries_the_terminal_speed_along() -> None:
    still, moved = _rig(weight=40.0), _rig(weight=40.0)
    moved.flow.append(lambda _, __: (-2.0, 0.0))
    speeds = []
    for rig in (still, moved):
        t, x = rig.fall()
        speeds.append(np.gradient(x, t)[-10:].mean())
    assert speeds[1] - speeds[0] == pytest.approx(-2.0, abs=0.3)


def test_a_stiff_string_is_a_rod_and_a_soft_one_stretches_by_its_tension() -> None:
    rod, stiff, soft = _rig(), _rig(string=4e6), _rig(string=2e4)
    (t, x), (ts, xs), (_, xw) = (rig.fall() for rig in (rod, stiff, soft))
    assert np.interp(t[:-20], ts, xs) == pytest.approx(x[:-20], abs=0.1)
    # at terminal speed the string holds what the weight pulls with
    assert xw[-1] - rigs.TRAVEL == pytest.approx((25.0 * rigs.GRAVITY - 3080.0) / 2e4, abs=0.15)


def test_an_undamped_roll_swings_at_its_natural_frequency() -> None:
    swing = decays.Decay(0.002, 0.12, 0.0, 0.0, 0.2, np.random.default_rng(0))
    t, roll = swing.swing()
    assert roll == pytest.approx(0.2 * np.cos(np.sqrt(0.12 / 0.002) * t), abs=1e-5)


def test_a_linear_damping_decays_exponentially() -> None:
    t, roll = decays.Decay(0.002, 0.12, 0.0, 0.0008, 0.2, np.random.default_rng(0)).swing()
    envelope = 0.2 * np.exp(-0.0008 / 0.004 * t)
    peaks = (roll[1:-1] > roll[:-2]) & (roll[1:-1] > roll[2:])
    assert roll[1:-1][peaks] == pytest.approx(envelope[1:-1][peaks], rel=2e-3)


def test_a_cruise_reaches_the_published_speed() -> None:
    # 3825Rect at 4 Hz: 14.06 cm/s published at 31 % efficiency, of which R_v = 0.688 on the average
    mean = 115.0 / _session(efficiency=0.31).times()[2]
    assert mean == pytest.approx(0.688 * 14.06, rel=0.02)


def test_cruise_speed_goes_as_the_cube_root_of_power() -> None:
    whole, half = _session().times(), _session(efficiency=0.341 / 8).times()
    assert half == pytest.approx(2 * whole, rel=1e-3)


@pytest.mark.parametrize("robot", ["falling-weight", "free-decay", "cruise"])
def test_every_effect_has_a_pinned_name(robot: str) -> None:
    module = cruises if robot == "cruise" else rigs
    assert set(module.CATALOGUE[robot]) <= set(STAGE_OF)
    assert not set(module.OUTSIDE[robot]) & set(STAGE_OF)


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "name"), [("falling-weight", "wall"), ("free-decay", "waves")])
def test_a_dominant_effect_shows_in_its_label(robot: str, name: str, tmp_path) -> None:
    label = rigs.make_case(tmp_path, robot=robot, effect=name, size=3.0, rng=np.random.default_rng(4))
    assert label["stages"] == [STAGE_OF[name]]
    assert label["gap_over_floor"]["overall"] > 3.0
    assert label["noncentrality"] > 150.0


@pytest.mark.parametrize("name", ["servo-lag", "current"])
def test_a_larger_effect_shows_more(name: str, tmp_path) -> None:
    small, large = (
        cruises.make_case(
            tmp_path / str(size), robot="cruise", effect=name, size=size, rng=np.random.default_rng(4)
        )
        for size in (0.3, 3.0)
    )
    for figure in ("gap_over_floor", "gap_refit"):
        assert large[figure]["overall"] > 2 * small[figure]["overall"] > 0


def test_a_clean_case_has_no_gap_and_tells_nothing_in_its_folder(tmp_path) -> None:
    label = rigs.make_case(
        tmp_path, robot="falling-weight", effect=None, size=0.0, rng=np.random.default_rng(1)
    )
    assert label["gap_over_floor"]["overall"] == 0.0
    assert label["noncentrality"] == 0.0
    files = {path.name for path in tmp_path.iterdir()}
    assert files <= {"trials.yaml", "params_prior.yaml"} | {f"run{k:02d}.csv" for k in range(1, 12)}


def test_a_refit_takes_all_that_lies_in_its_columns_and_nothing_else() -> None:
    t = np.linspace(0.0, 1.0, 50)
    column, sd = np.stack([1e3 * t], axis=1), [np.full(50, 0.1)]
    none = [np.zeros((50, 1))]
    rms, noncentrality, _ = left_by_refit([3.0 * t], [column], none, sd)
    assert rms < 1e-5
    assert noncentrality < 1e-4
    # a wave over whole periods about its mean is left by a constant
    wave = np.sin(2 * np.pi * np.arange(50) / 25)
    rms, noncentrality, _ = left_by_refit([wave], [np.full((50, 1), 1e3)], none, sd)
    assert rms == pytest.approx(np.sqrt(0.5))
    assert noncentrality == pytest.approx(25.0 / 0.1**2)


def test_a_candidate_explains_its_own_change_and_not_that_of_another() -> None:
    t = np.linspace(0.0, 1.0, 200)
    one, two = np.sin(9.0 * t), np.cos(14.0 * t)
    system = np.vstack([t[:, None], [[1.0]]])
    padded = {name: np.append(v, 0.0)[:, None] for name, v in (("one", one), ("two", two))}
    left = left_by_each(system, np.append(30.0 * one + 0.5 * t, 0.0), padded)
    assert left["one"] < 1.0
    assert left["two"] > 5e3


@pytest.mark.parametrize("robot", ["falling-weight", "free-decay"])
def test_the_file_of_a_changed_parameter_is_near_the_truth_of_the_other_day(robot: str, tmp_path) -> None:
    name = rigs.CHANGED[robot][0]
    label = rigs.make_case(
        tmp_path, robot=robot, effect=f"parameter:{name}", size=-0.2, rng=np.random.default_rng(8)
    )
    file = YAML(typ="safe").load(tmp_path / "params_prior.yaml")
    for key, truth in label["truth"].items():
        row = file["parameters"][key]
        assert abs(row["value"] - truth) < 4.0 * row["stderr"]
    assert label["factors"] == {name: pytest.approx(0.8)}
    assert label["stages"] == ["parameter"]
    matrix = np.array(file["correlation"]["matrix"])
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    assert file["correlation"]["names"] == list(label["truth"])
    assert label["noncentrality"] > 25.0
    assert f"parameter:{name}" not in label["singles"]


def test_noise_free_drops_have_the_changed_drag(tmp_path) -> None:
    label = rigs.make_case(
        tmp_path,
        robot="falling-weight",
        effect="parameter:drag_coefficient",
        size=0.25,
        rng=np.random.default_rng(8),
    )
    trial = YAML(typ="safe").load(tmp_path / "trials.yaml")["trials"][-1]
    t, x = np.loadtxt(label["noise_free"][trial["log"]].splitlines(), delimiter=",", skiprows=1).T
    cd, added, friction = label["truth"].values()
    drag = 0.5 * rig_effects.DENSITY * 1.25 * cd * rig_effects.AREA
    fall = rigs.nominal(t, 1000.0 * trial["pulling_mass_kg"], drag, 1000.0 * added, 1e5 * friction)
    assert 100.0 * x == pytest.approx(fall, abs=0.02)


def test_drawn_fits_scatter_by_their_covariance() -> None:
    covariance = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    rng, values = np.random.default_rng(3), np.array([2.0, 50.0])
    drawn = [draw_fit(values, covariance, 3.0 * values, rng) for _ in range(2000)]
    relative = np.array([estimates for estimates, _, _ in drawn]) / values - 1.0
    assert np.cov(relative.T) == pytest.approx(covariance, rel=0.15)
    # the standard error is that of the true parameters, whatever estimate is drawn
    assert drawn[0][1] == pytest.approx([0.02 * 2.0, 0.03 * 50.0])


# ------------------------------------------------------------ runner and scorer

FAKE = """
import os, sys
from pathlib import Path
verb, output = sys.argv[1], Path(sys.argv[sys.argv.index("-o") + 1])
assert not any("labels" in part for part in Path.cwd().parts), "labels are near"
if verb == "diagnose":
    assert Path(sys.argv[sys.argv.index("--params") + 1]).exists()
    Path("repaired.yaml").write_text("parameters")
    output.write_text('''
verdict: explained
closed: {share: 0.9, ci95: [0.8, 0.95]}
where: {channels: [{channel: x_m, nrmse: 0.1, floor: 0.02, share: 1.0, rmse: 0.115}]}
causes:
- {effect: wall, probability: 0.97, equivalent: [tether], parameters: {}, shrinkage: [
    {channel: x_m, shipped: 0.1, after: 0.03, floor: 0.02, closed: 0.875, ci95: [0.8, 0.9]}]}
''')
elif verb == "compare":
    assert "1.15," in Path("speeds.csv").read_text()
    error = 0.02 if "repaired" in output.name else 0.1
    output.write_text("channels: {mean_speed_m_s: {rmse: %g}, other: {rmse: 9}}" % error)
else:
    output.write_text("parameters")
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("blind")
    program = folder / "fake.py"
    program.write_text(FAKE)
    out = folder / "out"
    cases = [
        {"number": 0, "robot": "cruise", "kind": "clean", "effects": [], "size": 0.0},
        {"number": 1, "robot": "cruise", "kind": "single", "effects": ["tether"], "size": 1.0},
        {"number": 2, "robot": "cruise", "kind": "single", "effects": ["servo-lag"], "size": 1.0},
        {"number": 3, "robot": "cruise", "kind": "pair", "effects": ["tether", "current"], "size": 1.0},
        {"number": 4, "robot": "cruise", "kind": "outside", "effects": ["loose-fin"], "size": 1.0},
    ]
    runner.run(cases, out, 1, program=(sys.executable, str(program)))
    return out


@pytest.mark.slow
def test_a_case_runs_apart_from_its_label(finished: Path) -> None:
    record = json.loads((finished / "results" / "0001" / "result.json").read_text())
    assert [step["status"] for step in record["steps"]] == [0] * len(record["steps"])
    assert record["steps"][-1]["command"][:2] == ["diagnose", "trials.yaml"]
    assert not list((finished / "cases").iterdir())
    label = json.loads((finished / "labels" / "0001.json").read_text())
    assert label["effects"] == ["tether"]
    assert "arrays" not in label
    assert "arrays/runs/mean_speed_m_s" in np.load(finished / "labels" / "0001.npz")


@pytest.mark.slow
def test_a_finished_case_is_not_run_again(finished: Path) -> None:
    case = {"number": 2, "robot": "cruise", "kind": "single", "effects": ["servo-lag"], "size": 1.0}
    runner.run([case], finished, 1, program=("/nowhere",))
    label = finished / "labels" / "0002.json"
    label.unlink()
    runner.run([case], finished, 1, program=("false",), relabel=True)
    assert json.loads(label.read_text())["effects"] == ["servo-lag"]


@pytest.mark.slow
def test_right_and_wrong_answers_are_distinguished(finished: Path) -> None:
    rows = {row["number"]: row for row in score.read(finished)}
    assert [rows[k]["first"] for k in range(5)] == [False] * 5
    assert [rows[k]["within"] for k in range(5)] == [False, True, False, True, False]
    assert rows[3]["found"] == 1
    assert rows[1]["tool_ratio"] == pytest.approx(5.0)
    found = score.summary(list(rows.values()))
    assert found["false_alarms"] == 1.0
    assert found["in_set"] == 0.5
    assert found["first"] == 0.0
    assert found["wrong_explained"] == 0.5
    assert found["outside_sure"] == 1.0
    assert found["outside_abstained"] == 0.0
    text = score.write(finished)
    assert "| servo-lag | 1 |" in text
    assert "| one effect: another cause named | 1 of 2, 50 %" in text
    assert "| clean: a cause named | 1 of 1, 100 %" in text
    pair = json.loads((finished / "labels" / "0003.json").read_text())
    assert set(pair["effects"]) <= set(pair["singles"])
    assert max(pair["singles"].values()) <= pair["noncentrality"] * (1.0 + 1e-6)
    assert (finished / "score.json").exists()


def test_a_set_of_more_than_three_names_nothing() -> None:
    gap = {
        "verdict": "ambiguous",
        "where": {"channels": []},
        "causes": [{"effect": "wall", "probability": 0.5, "equivalent": ["tether", "waves", "current"]}],
    }
    label = {"number": 0, "robot": "x", "kind": "single", "effects": ["tether"], "size": 1.0}
    record = {"steps": [{"status": 0, "wall_s": 1.0}], "ended": True}
    assert not score.scored(label, gap, record)["within"]
    gap["causes"][0]["equivalent"].pop()
    assert score.scored(label, gap, record)["within"]


def test_closed_is_recomputed_with_the_labels_floor() -> None:
    gap = {
        "verdict": "explained",
        "where": {"channels": [{"channel": "x_m", "nrmse": 0.10, "rmse": 0.2, "floor": 0.01}]},
        "causes": [
            {
                "effect": "wall",
                "probability": 1.0,
                "shrinkage": [
                    {"channel": "x_m", "shipped": 0.1, "after": 0.05, "floor": 0.01, "closed": 0.556}
                ],
            }
        ],
    }
    label = {
        "number": 0,
        "robot": "x",
        "kind": "single",
        "effects": ["wall"],
        "size": 1.0,
        "floor": {"x_m": 0.04},
    }
    row = score.scored(label, gap, {"steps": [{"status": 0, "wall_s": 1.0}], "ended": True})
    assert row["closed"] == pytest.approx((0.1**2 - 0.05**2) / (0.1**2 - (0.04 / 2.0) ** 2))


@pytest.mark.slow
def test_the_true_closed_share_comes_from_the_noise_free_motions(finished: Path) -> None:
    row = next(r for r in score.read(finished) if r["number"] == 1)
    assert (row["claimed"], row["interval"]) == (0.9, (0.8, 0.95))
    assert row["closed"] == pytest.approx(1.0 - 0.2**2)


def test_noise_free_logs_are_those_of_the_held_out_trials(tmp_path: Path) -> None:
    lines = "trials:\n  - {log: a.csv, id: a}\n  - {log: b.csv, id: b, role: validate}\n"
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "trials.yaml").write_text(lines)
    noise_free.write(tmp_path / "case", tmp_path / "label", {"a.csv": "one", "b.csv": "two"})
    trials = YAML(typ="safe").load(tmp_path / "label" / "trials.yaml")["trials"]
    assert trials == [{"log": "b.csv", "id": "b_noise_free"}]
    assert (tmp_path / "label" / "b.csv").read_text() == "two"


def test_estimates_of_a_fitted_trial_do_not_apply_to_its_noise_free_motion(tmp_path: Path) -> None:
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "trials.yaml").write_text("trials:\n  - {log: a.csv, id: a}\n")
    noise_free.write(tmp_path / "case", tmp_path / "label", {"a.csv": "one"})
    trials = YAML(typ="safe").load(tmp_path / "label" / "trials.yaml")["trials"]
    assert [trial["id"] for trial in trials] == ["a_noise_free"]


def _changed(value: float, effect: str = "parameter:K_s") -> dict:
    """Return the row of a case in which K_s fell from 0.31 to 0.27, and its estimate is ``value``."""
    label = {
        "number": 5000,
        "robot": "dolphin",
        "kind": "changed",
        "effects": ["parameter:K_s"],
        "size": -0.129,
        "truth": {"K_s": 0.31},
        "factors": {"K_s": 0.27 / 0.31},
        "singles": {"parameter:c_m0": 90.0},
    }
    estimate = {"value": value, "stderr": 0.004, "from": 0.312, "unit": "N m/rad"}
    name = effect.removeprefix("parameter:")
    gap = {
        "verdict": "explained",
        "where": {"channels": []},
        "causes": [{"effect": effect, "probability": 0.96, "equivalent": [], "parameters": {name: estimate}}],
    }
    return score.scored(label, gap, {"steps": [{"status": 0, "wall_s": 1.0}], "ended": True})


def test_a_changed_parameter_must_be_named_first_and_sized() -> None:
    rows = [_changed(0.276), _changed(0.281), _changed(0.27, "parameter:c_m0")]
    found = dict(figures.figures(rows))
    assert found["a changed parameter: named first"].startswith("2 of 3")
    assert found["a changed parameter: named first, sized within 2 standard errors"].startswith("1 of 3")


def test_two_runs_are_compared_by_the_cases_that_both_have() -> None:
    other = {**_changed(0.27), "verdict": "none"}
    text = figures.compared([_changed(0.27)], [other, {**other, "number": 5001}])
    assert "| a changed parameter: named first | 0 of 1, 0 % [0, 73] | 1 of 1, 100 % [27, 100] |" in text
    assert "| 5000 | dolphin | parameter:K_s | none | explained: parameter:K_s (1) |" in text
    with pytest.raises(SystemExit, match="plans differ"):
        figures.compared([_changed(0.27)], [{**other, "size": 0.2}])


def test_cases_of_changed_parameters_leave_the_others_as_they_are(capsys: pytest.CaptureFixture) -> None:
    plans = []
    for more in ([], ["--changed", "20"]):
        runner.main(["--cases", "30", "--seed", "4", "--out", "unused", "--plan", *more])
        plans.append(json.loads(capsys.readouterr().out)["cases"])
    assert plans[1][:30] == plans[0]
    changed = plans[1][30:]
    assert changed == runner.plan_changed(20, 4)
    assert [c["number"] for c in changed] == list(range(5000, 5020))
    assert all(0.08 <= abs(c["size"]) <= 0.25 for c in changed)
    assert {c["robot"] for c in changed} == set(runner.CHANGED_SHARES)


def test_shares_add_up() -> None:
    number = runner.counts(160, runner.SHARES)
    assert sum(number.values()) == 160
    assert all(abs(number[k] - 160 * v) < 1 for k, v in runner.SHARES.items())


def test_a_plan_is_the_same_for_the_same_seed_and_cycles_through_all_effects() -> None:
    cases = runner.plan(60, 5, robots=["falling-weight"])
    assert cases == runner.plan(60, 5, robots=["falling-weight"])
    assert cases != runner.plan(60, 6, robots=["falling-weight"])
    singles = {c["effects"][0] for c in cases if c["kind"] == "single"}
    assert singles == set(rigs.CATALOGUE["falling-weight"])
    assert {len(c["effects"]) for c in cases if c["kind"] == "pair"} == {2}


def test_a_cause_that_upsets_a_swim_is_drawn_smaller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def make_case(folder: Path, *, size: float, **_) -> dict[str, object]:
        if size > 1.5:
            raise FloatingPointError("run01: the swim is unstable")
        return {"gap_over_floor": {"overall": 2.0}, "noncentrality": 100.0}

    fake = type("Fake", (), {"make_case": staticmethod(make_case)})
    monkeypatch.setattr(runner, "generators", lambda: {"dolphin": fake})
    case = {"number": 3, "robot": "dolphin", "kind": "outside", "effects": ["spring-drift"], "size": 3.0}
    runner.make(case, tmp_path, 1)
    label = json.loads((tmp_path / "labels" / "0003.json").read_text())
    assert label["size"] == pytest.approx(3.0 * 0.7**2)
    with pytest.raises(FloatingPointError, match="unstable"):
        runner.make({**case, "size": 100.0}, tmp_path, 1)
