"""The blind cases of rigs and cruises: their own physics against closed forms, and the runner and scorer."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from validation.blind import cruises, decays, rig_effects, rigs, runner, score

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


def test_a_linear_damping_decays_exponentially() -> None:
    t, roll = decays.Decay(0.002, 0.12, 0.0, 0.0008, 0.2, np.random.default_rng(0)).swing()
    envelope = 0.2 * np.exp(-0.0008 / 0.004 * t)
    peaks = (roll[1:-1] > roll[:-2]) & (roll[1:-1] > roll[2:])
    assert roll[1:-1][peaks] == pytest.approx(envelope[1:-1][peaks], rel=2e-3)


def test_a_cruise_reaches_the_published_speed() -> None:
    # 3825Rect at 4 Hz: 14.06 cm/s published at 31 % efficiency, of which R_v = 0.688 on the average
    mean = 115.0 / _session(efficiency=0.31).times()[2]
    assert mean == pytest.approx(0.688 * 14.06, rel=0.02)


def test_a_clean_case_has_no_gap_and_tells_nothing_in_its_folder(tmp_path) -> None:
    label = rigs.make_case(
        tmp_path, robot="falling-weight", effect=None, size=0.0, rng=np.random.default_rng(1)
    )
    assert label["gap_over_floor"]["overall"] == 0.0
    assert label["noncentrality"] == 0.0
    files = {path.name for path in tmp_path.iterdir()}
    assert files <= {"trials.yaml", "params_prior.yaml"} | {f"run{k:02d}.csv" for k in range(1, 12)}


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
