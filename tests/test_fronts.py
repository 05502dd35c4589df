"""Pareto fronts: the search, its resumption, the choice of a point, and the command."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError
from swimid.files.atomic import Checkpoint
from swimid.fitting import global_search
from swimid.results import evidence
from swimid.results import parameters as parameters_format
from swimid.swimmer import front as fronts
from swimid.swimmer.front import Profiles
from tests.conftest import SAMPLES, Ran
from tests.generators import swimmer

Run = Callable[..., Ran]
FEW = ("--population", "6", "--generations", "3")


def _two_bowls(points: np.ndarray) -> np.ndarray:
    """Return squared distances from (1, 0) and (-1, 0). The front is the straight line between them."""
    x, y = points.T
    return np.column_stack([(x - 1.0) ** 2 + y**2, (x + 1.0) ** 2 + y**2])


BOX = (np.array([-3.0, -3.0]), np.array([3.0, 3.0]))


def test_the_front_of_two_bowls() -> None:
    found = global_search.nsga2(_two_bowls, *BOX, objectives=2, population=40, generations=40, seed=3)
    # on the front sqrt(f1) + sqrt(f2) = 2; forty points stand 2 / 40 apart on it and hide no more than that
    assert np.abs(np.sqrt(found.objectives).sum(axis=1) - 2.0).max() < 0.05
    assert np.ptp(found.points[:, 0]) > 1.5
    assert found.evaluations == 1600
    assert (np.diff(found.objectives[:, 0]) >= 0).all()
    assert abs(found.points[global_search.knee(found.objectives), 0]) < 0.2


def test_the_same_seed_gives_the_same_front() -> None:
    settings = {"objectives": 2, "population": 12, "generations": 5}
    first, again, other = (global_search.nsga2(_two_bowls, *BOX, seed=s, **settings) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.points, again.points)
    assert not np.array_equal(first.points, other.points)


def test_an_interrupted_search_continues_to_the_same_front(tmp_path: Path) -> None:
    settings = {"objectives": 2, "population": 12, "generations": 8, "seed": 5}
    whole = global_search.nsga2(_two_bowls, *BOX, **settings)
    calls = 0

    def stopped(points: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls == 4:
            raise KeyboardInterrupt
        return _two_bowls(points)

    path = tmp_path / "front.partial"
    with pytest.raises(KeyboardInterrupt):
        global_search.nsga2(stopped, *BOX, checkpoint=Checkpoint(path, "a"), **settings)
    # an incomplete last line of a killed run is ignored
    path.write_text(path.read_text() + '["front: generation 3", [0.1, 0.')
    calls = 100
    rest = global_search.nsga2(stopped, *BOX, checkpoint=Checkpoint(path, "a"), **settings)
    assert calls == 105
    for name in ("points", "objectives"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name))


def test_points_that_break_down_are_not_on_the_front() -> None:
    def broken(points: np.ndarray) -> np.ndarray:
        found = _two_bowls(points)
        found[points[:, 0] > 0] = math.nan
        return found

    found = global_search.nsga2(broken, *BOX, objectives=2, population=16, generations=6)
    assert (found.points[:, 0] <= 0).all()
    assert (found.objectives < global_search.BROKEN_OBJECTIVE).all()


def test_rules_that_choose_a_point() -> None:
    front = np.array([[1.0, 10.0], [2.0, 3.0], [6.0, 1.0]])
    assert global_search.knee(front) == 1
    assert global_search.least_worst(front) == 1
    assert global_search.least_worst(np.array([[1.0, 1.0]])) == 0


def test_a_distance_allows_a_late_clock_within_its_band() -> None:
    time = np.arange(200) / 50.0
    wave = {"x_m": np.sin(2 * np.pi * time), "z_m": np.cos(2 * np.pi * time)}
    late = {"x_m": np.sin(2 * np.pi * (time - 0.1)), "z_m": np.cos(2 * np.pi * (time - 0.1))}
    names, sizes = ["x_m", "z_m"], [0.05, 0.05]
    # 0.1 s are 5 of 200 samples: a shift of 6 is allowed, so that only the ends do not match
    near, far = (fronts.distance(wave, late, names, sizes, band=b) for b in (0.03, 0.005))
    assert near < math.sqrt(2 * 5 / 200) * far
    still = {n: v.copy() for n, v in wave.items()}
    still["x_m"][3] = math.nan
    assert fronts.distance(still, wave, names, sizes) < 1e-12
    assert math.isnan(fronts.distance(wave, {n: v * math.nan for n, v in wave.items()}, names, sizes))


def _trials(folder: Path, duration: float = 1.5) -> Path:
    """Write a trials file with the first part of one repeat of each stroke of the sample."""
    lines = ["format: swimid-trials/1", "experiment: multibody", "robot: sealion", "trials:"]
    for name in ("characteristic", "characteristic-pelvis"):
        lines.append(
            f"  - {{id: {name}, log: {SAMPLES / 'sealion' / name}-1.csv, end_s: {duration}, "
            f"drive: {{stroke: {name}}}}}"
        )
    path = folder / "trials.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


ONLY = ("--fix", "z_drag=1.2", "--fix", "com_offset=0.016", "--no-progress")


@pytest.mark.kernels
def test_the_command_writes_a_front_and_a_point_of_it(swimid: Run, tmp_path: Path) -> None:
    trials, out = _trials(tmp_path), tmp_path / "p.yaml"
    ran = swimid("fit-graybox", trials, "--method", "nsga2", *FEW, *ONLY, "-o", out)
    assert ran.status == 0, ran.err
    table = pd.read_csv(tmp_path / "p.front.csv")
    scored = [
        f"{k}[{p}]" for p in ("characteristic", "characteristic-pelvis") for k in ("position", "orientation")
    ]
    assert list(table.columns) == ["index", "profile", "water_volume", "z_added_mass", *scored]
    assert set(table["profile"]) <= {"characteristic", "characteristic-pelvis"}
    values = table[scored].to_numpy()
    chosen = table.iloc[global_search.least_worst(values)]
    file = parameters_format.read(out)
    for name in ("water_volume", "z_added_mass"):
        assert file.parameters[name].value == chosen[name]
        assert file.parameters[name].stderr is None or file.parameters[name].stderr > 0
    assert file.fit is not None
    shown = evidence.read(evidence.sidecar(out))
    assert "stages" in {t.id for t in shown.tables}
    assert "front" in {f.id for f in shown.figures}
    assert not (tmp_path / "p.yaml.partial").exists()
    # another point by its index, without a search
    again = tmp_path / "again.yaml"
    front = ("--front", tmp_path / "p.front.csv")
    ran = swimid("fit-graybox", trials, "--method", "nsga2", *front, "--pick", "0", *ONLY, "-o", again)
    assert ran.status == 0, ran.err
    assert parameters_format.read(again).parameters["water_volume"].value == table["water_volume"][0]
    assert swimid("fit-graybox", trials, "--method", "nsga2", *front, "--pick", "999", *ONLY).status == 2
    assert swimid("fit-graybox", trials, "--method", "nsga2", *front, "--pick", "best", *ONLY).status == 2
    other = swimid("fit-graybox", trials, "--method", "nsga2", *front, "--no-progress")
    assert other.status == 3
    assert "com_offset" in other.err


@pytest.mark.kernels
def test_an_interrupted_command_resumes_to_the_same_front(
    swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = _trials(tmp_path)
    command = ("fit-graybox", trials, "--method", "nsga2", *FEW, *ONLY, "--seed", "4")
    whole, out = tmp_path / "whole.yaml", tmp_path / "p.yaml"
    assert swimid(*command, "-o", whole).status == 0
    known = Profiles.evaluate
    calls = 0

    def stopped(self: Profiles, points: np.ndarray, profile: str | None = None) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls == 5:
            raise KeyboardInterrupt
        return known(self, points, profile)

    monkeypatch.setattr(Profiles, "evaluate", stopped)
    ran = swimid(*command, "-o", out)
    assert ran.status == 130
    assert "4 of 6 generations" in ran.err
    assert re.search(r"they are kept in .*p\.yaml\.partial", " ".join(ran.err.split()))
    assert not out.exists()
    assert (tmp_path / "p.yaml.partial").exists()
    ran = swimid(*command, "-o", out)
    assert ran.status == 0, ran.err
    assert calls == 8  # the two remaining generations, and all points in both profiles
    assert (tmp_path / "p.front.csv").read_bytes() == (tmp_path / "whole.front.csv").read_bytes()
    assert not (tmp_path / "p.yaml.partial").exists()


@pytest.mark.slow
@pytest.mark.kernels
def test_hybrid_ends_with_least_squares(swimid: Run, tmp_path: Path) -> None:
    trials, out = _trials(tmp_path), tmp_path / "p.yaml"
    ran = swimid("fit-graybox", trials, "--method", "hybrid", *FEW, *ONLY, "-o", out)
    assert ran.status == 0, ran.err
    shown = evidence.read(evidence.sidecar(out))
    stages = next(t for t in shown.tables if t.id == "stages")
    assert stages.columns[2:] == ["untuned", "chosen on the front", "least squares"]
    file = parameters_format.read(out)
    assert file.fit is not None
    assert file.fit.method == "output error"
    plain = tmp_path / "plain.yaml"
    assert swimid("fit-graybox", trials, *ONLY, "-o", plain).status == 0
    straight = parameters_format.read(plain)
    for name in ("water_volume", "z_added_mass"):
        first, second = file.parameters[name], straight.parameters[name]
        assert first.stderr is not None
        # one minimum, found from both sides
        assert abs(first.value - second.value) < 0.1 * first.stderr


@pytest.mark.kernels
def test_one_front_of_speed_and_turning_for_a_planar_fish(swimid: Run, tmp_path: Path) -> None:
    out = tmp_path / "p.yaml"
    drive = {"frequency_hz": 1.0, "amplitude_deg": 20.0}
    runs = [swimmer.Run("one", drive, swimmer.simulate("tfish", None, drive, 3.0, rtol=1e-6))]
    noise = {"u_m_s": 0.01, "yaw_rate_rad_s": 0.02}
    trials = swimmer.write_trials(tmp_path, "tfish", runs, noise, 5, columns=tuple(noise))
    ran = swimid(
        "fit-graybox", trials, "--channels", "u_m_s,yaw_rate_rad_s", "--method",
        "nsga2", *FEW, "--scale", "u_m_s=0.02", "--share", "c_f",
        "--pick", "knee", "-o", out, "--no-progress",
    )  # fmt: skip
    assert ran.status == 0, ran.err
    table = pd.read_csv(tmp_path / "p.front.csv")
    scored = [c for c in table.columns if "[" in c]
    assert [c.split("[")[0] for c in scored] == ["speed", "turning"]
    shown = evidence.read(evidence.sidecar(out))
    stages = next(t for t in shown.tables if t.id == "stages")
    assert stages.columns == ["quantity", "of", "untuned", "chosen on the front"]
    chosen = table.iloc[global_search.knee(table[scored].to_numpy())]
    assert [row[0] for row in stages.rows[:2]] == ["DTW distance, speed", "DTW distance, turning"]
    assert [row[3] for row in stages.rows[:2]] == pytest.approx(chosen[scored].tolist(), rel=1e-3)
    assert all(row[2] > 0 for row in stages.rows[:2])
    assert all("m/s" in text for text in stages.rows[2][2:])
    methods = " ".join(shown.methods)
    assert "NSGA-II" in methods
    assert "population 6, 3 generations" in methods
    assert "18 points in all" in methods
    assert "rule knee" in methods
    assert shown.facts["Front"].startswith(f"{len(table)} points, {chosen.name} chosen (knee")


def test_options_of_a_front_need_its_method(swimid: Run, tmp_path: Path) -> None:
    trials = _trials(tmp_path)
    assert swimid("fit-graybox", trials, "--front", "x.csv").status == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "is not a front of this fit"),
        ("index,profile,c,position[p]\n0,p,x,1\n", "'x' is not a finite number"),
        ("", "is no table"),
    ],
)
def test_a_file_that_is_no_front_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "front.csv"
    path.write_text(text)
    profiles = SimpleNamespace(labels=["c"], columns=["position[p]"])
    with pytest.raises(InputError, match=said):
        fronts.read(path, profiles)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no such file"):
        fronts.read(tmp_path / "none.csv", profiles)  # type: ignore[arg-type]
