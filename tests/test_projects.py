"""``swimid init`` on folders as laboratories leave them, and ``swimid sample``."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from swimid.logs import log
from swimid.results.result import load_result
from tests.conftest import SAMPLES, Ran
from tests.generators import lab_folders
from tests.test_import import _mcap
from tests.test_vehicle import _bag

Run = Callable[..., Ran]


def answer(file: Path, *answers: tuple[str, str]) -> None:
    """Replace text of a drafted file, as a user does. Each text must be there."""
    text = file.read_text()
    for asked, stated in answers:
        assert asked in text, f"{asked} is not in {text}"
        text = text.replace(asked, stated)
    file.write_text(text)


@pytest.fixture
def project(swimid: Run, tmp_path: Path) -> Callable[..., tuple[Path, dict]]:
    """Draft a project of a folder that a generator writes; return its folder and the answer."""

    def run(write: Callable[[Path], None], *options: str) -> tuple[Path, dict]:
        write(tmp_path / "lab")
        ran = swimid("init", tmp_path / "lab", "-o", tmp_path / "project", "--json", *options)
        assert ran.status == 0, ran.err
        return tmp_path / "project", ran.json["result"]

    return run


def done(swimid: Run, folder: Path, names: set[str]) -> None:
    """Run the plan of a project, and check that the logs of these recordings are there."""
    ran = swimid("batch", folder / "plan.yaml", "-o", folder / "run", "--json")
    assert ran.status == 0, ran.out
    assert {path.stem for path in (folder / "run/items").glob("*/*.csv")} == names


@pytest.mark.slow
def test_films_become_a_setup_and_logs(project, swimid: Run) -> None:
    folder, found = project(lab_folders.films)
    assert [one["kind"] for one in found["recordings"]] == ["film"] * 2 + ["other"]
    film, setup = folder.parent / "lab/swim 1.mp4", folder / "film-1.setup.yaml"
    refused = swimid("track", "video", film, "--setup", setup, "-o", folder / "run.csv")
    assert refused.status == 3
    assert re.search(r"film-1.setup.yaml, line \d+, 'markers.at_m': is still ASK", refused.err)
    answer(
        folder / "film-1.setup.yaml",
        ("metres_per_pixel: ASK", "metres_per_pixel: 0.002"),
        ("  at_m: [ASK, ASK]", "  # at_m: "),
    )
    done(swimid, folder, {"swim_1", "swim_2"})
    answer(
        folder / "film-1.trials.yaml", ("experiment: ASK", "experiment: arma"), ("robot: ASK", "robot: tfish")
    )
    logs = re.findall(r"log: ['\"]?([^,'\"}]+)", (folder / "film-1.trials.yaml").read_text())
    assert [len(log.read(folder / name)) for name in logs] == [60] * 2


@pytest.mark.slow
@pytest.mark.parametrize("films", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_tables_of_a_tracker_become_pose_and_joints(project, swimid: Run, films: bool) -> None:
    folder, found = project(lambda lab: lab_folders.tracked(lab, films=films), "--robot", "tfish")
    file = folder / "points-1.points.yaml"
    for name, (link, ahead, port) in lab_folders.point_films.PLACES.items():
        answer(
            file,
            (f"{name}: {{link: ASK, at_m: [ASK, 0]}}", f"{name}: {{link: {link}, at_m: [{ahead}, {port}]}}"),
        )
    asked = [one["file"] for one in found["questions"]]
    assert ("plan.yaml" in asked) is not films  # the films state their rate
    if films:
        answer(folder / "plan.yaml", ("rate-hz: 30.0", "rate-hz: 60.0"))
    else:
        answer(folder / "plan.yaml", ("rate-hz: ASK", "rate-hz: 60"))
    done(swimid, folder, {"fish1DLC_resnet50", "fish2DLC_resnet50"})
    trials = folder / "points-1.trials.yaml"
    answer(trials, ("experiment: ASK", "experiment: multibody"))
    path = re.search(r"log: ([^,}]+)", trials.read_text())
    assert "joint4_rad" in log.read(folder / path[1])


def test_rate_of_a_film_with_another_number_of_frames_is_not_taken(project) -> None:
    """A tracker may have seen every sixth frame: its table has fewer rows, and another rate."""

    def write(lab: Path) -> None:
        lab_folders.tracked(lab, films=True)
        for table in lab.glob("*.csv"):
            lines = table.read_text().splitlines(keepends=True)
            table.write_text("".join(lines[:3] + lines[3::6]))

    _, found = project(write, "--robot", "tfish")
    assert "plan.yaml" in [one["file"] for one in found["questions"]]


@pytest.mark.slow
def test_chain_of_a_body_without_a_robot(project, swimid: Run) -> None:
    folder, _ = project(lab_folders.tracked)
    answer(
        folder / "points-1.points.yaml",
        ("chain: [ASK]", "chain: [snout, back, hip, tip]"),
        ("metres_per_pixel: ASK", "metres_per_pixel: 0.000667"),
    )
    answer(folder / "plan.yaml", ("rate-hz: ASK", "rate-hz: 60"))
    done(swimid, folder, {"fish1DLC_resnet50", "fish2DLC_resnet50"})


@pytest.mark.slow
def test_rig_logs_with_a_table_of_masses_are_fitted(project, swimid: Run) -> None:
    folder, found = project(lab_folders.rig, "--robot", "boxfish", "--experiment", "falling-weight")
    assert found["questions"] == []
    assert found["missing"] == []
    done(swimid, folder, {*lab_folders.MASSES})
    for line in found["commands"][1:3]:
        ran = swimid(*(folder / word if "." in word else word for word in shlex.split(line)[1:]))
        assert ran.status == 0, ran.err
    drag = load_result(folder / "table-1.yaml")["drag_coefficient"]
    assert abs(drag.value - 0.70531) < 3 * drag.stderr  # of the same logs in SI units
    assert "validate" in (folder / "table-1.trials.yaml").read_text()


@pytest.mark.slow
def test_bag_of_a_vehicle(project, swimid: Run, rng) -> None:
    def write(lab: Path) -> None:
        lab.mkdir()
        os.rename(_bag(lab, rng, 5.0), lab / "dive.db3")

    folder, _ = project(write, "--robot", "bluerov2")
    assert "/thrusts" in (folder / "table-1.map.yaml").read_text()  # which the mapping may join
    done(swimid, folder, {"dive"})


def test_bag_with_two_unknown_topics_asks_for_one(project, swimid: Run) -> None:
    def write(lab: Path) -> None:
        lab.mkdir()
        _mcap(lab / "bag.mcap")

    folder, found = project(write)
    (missing,) = found["missing"]
    assert "/depth, /pose" in missing
    words = shlex.split(re.search(r"swimid (import .*)", missing)[1])
    words = [str(folder / word) if word.endswith((".mcap", ".yaml")) else word for word in words]
    assert swimid(*("/pose" if word == "NAME" else word for word in words)).status == 0
    drafted = folder / "choice-1.map.yaml"
    text = re.sub(r"(?m)^  - .*source: \"(at.[yz]|ms)\".*\n", "", drafted.read_text())
    text = re.sub(r"(?m)^time: .*", "time: {source: ms, unit: ms}", text)
    text = text.replace("target: ASK", "target: x_m", 1)
    text = re.sub(r"unit: ASK", "unit: mm", text, count=1)
    drafted.write_text(re.sub(r"unit: ASK", "unit: deg", text))
    done(swimid, folder, {"bag"})


@pytest.mark.slow
def test_mixture(project, swimid: Run) -> None:
    folder, found = project(lab_folders.mixture)
    kinds = {one["file"].rpartition("/")[2]: one["kind"] for one in found["recordings"]}
    assert kinds["cut.mp4"] == "damaged"
    assert kinds["speeds.csv"] == "cruise"
    assert kinds["trials.yaml"] == "swimid"
    groups = {name.partition(".")[0] for name in found["files"] if name.endswith("trials.yaml")}
    assert groups == {"film-1", "table-1", "points-1", "log-1", "cruise-1"}
    readme = (folder / "README.md").read_text()
    assert "cut.mp4: is not a video" in readme
    for one in found["questions"]:
        line = (folder / one["file"]).read_text().splitlines()[one["line"] - 1]
        assert "ASK" in line
        assert line.strip() in readme
    assert swimid("fit-drag", SAMPLES / "rig/trials.yaml", "-o", folder / "drag.yaml").status == 0
    answer(
        folder / "cruise-1.trials.yaml", ("robot: ASK", "robot: boxfish"), ("drag: ASK", "drag: drag.yaml")
    )
    assert swimid("fit-propulsion", folder / "cruise-1.trials.yaml").status == 0
    answer(folder / "log-1.trials.yaml", ("robot: ASK", "robot: tfish"))
    refused = swimid("fit-graybox", folder / "log-1.trials.yaml")
    assert refused.status == 3
    assert "log-1.trials.yaml, line 3, 'experiment': is still ASK" in refused.err


@pytest.mark.slow
def test_drafted_robot_is_a_robot_once_it_is_answered(project, swimid: Run) -> None:
    folder, _ = project(lab_folders.films)
    answer(
        folder / "robot.yaml",
        ("name: ASK", "name: fish"),
        ("inertia_kg_m2: ASK", "inertia_kg_m2: 0.0004"),
        ("com_m: ASK", "com_m: 0.05"),
        ("station_m: ASK", "station_m: 0.1"),
        ("density_kg_m3: ASK", "density_kg_m3: 997"),
        ("added_mass_kg_m: ASK", "added_mass_kg_m: 7.8"),
        ("ASK", "0.1"),
    )
    (folder / "params.yaml").write_text(
        "format: swimid-parameters/1\nmodel: multilink\nrobot: robot.yaml\nparameters:\n"
        + "".join(
            f"  {name}: {{value: {value}, stderr: 0.01, unit: '1', status: estimated}}\n"
            for name, value in (("c_a", 1.0), ("c_d", 1.5), ("c_f", 0.02))
        )
    )
    words = ("--frequency-hz", "1", "--amplitude-deg", "20", "--duration-s", "5")
    ran = swimid("simulate", "--params", folder / "params.yaml", *words, "-o", folder / "swim.csv")
    assert ran.status == 0, ran.err
    assert log.read(folder / "swim.csv")["x_m"][-1] > 0.02  # it swims forwards


def test_nothing_is_written_without_output_or_over_others(swimid: Run, tmp_path: Path) -> None:
    lab_folders.rig(tmp_path / "lab")
    before = sorted(tmp_path.rglob("*"))
    assert swimid("init", tmp_path / "lab").status == 0
    assert sorted(tmp_path.rglob("*")) == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("mine")
    assert swimid("init", tmp_path / "lab", "-o", tmp_path / "mine").status == 2
    assert swimid("init", tmp_path / "nowhere").status == 3
    (tmp_path / "empty").mkdir()
    assert "holds no file" in swimid("init", tmp_path / "empty").err
    assert swimid("init", tmp_path / "lab", "--robot", "tfsh").status == 3


def test_samples_are_copied_and_their_command_runs(
    swimid: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    listed = swimid("sample", "--json").json["result"]["samples"]
    assert {"rig", "gap", "pool", "all"} <= set(listed)
    for name in ("rig", "cruise", "longfin"):
        ran = swimid("sample", name, f"my {name}", "--json")
        assert ran.status == 0, ran.err
        assert swimid(*shlex.split(ran.json["next"][0])[1:]).status == 0
    again = swimid("sample", "rig", "my rig")
    assert again.status == 2
    assert "not empty" in again.err
    assert "did you mean 'rig'" in swimid("sample", "rgi").err
    assert swimid("sample", "all", "-o", "everything").status == 0
    assert swimid("batch", "everything/plan.yaml", "-o", "run", "--dry-run").status == 0


def test_logs_of_one_swim_are_one_trial(project) -> None:
    """Commands, inertial log and camera log of a swim have one name, and a table names frequencies."""
    folder, found = project(lab_folders.one_robot)
    assert sorted(path.name for path in folder.glob("*.trials.yaml")) == ["log-1.trials.yaml"]
    trials = (folder / "log-1.trials.yaml").read_text()
    assert "experiment: free-swim" in trials
    assert "The drive is in the logs: cmd1_rad, cmd2_rad, cmd3_rad." in trials
    assert "swims.csv: not used: comment" in trials
    joined = (folder / "log-1.map.yaml").read_text()
    assert "{stem}_arduino.txt" in joined
    assert "align: {this: yaw_rad, that: cmd1_rad}" in joined
    assert any("track imu" in line and "--with" in line for line in found["commands"])
    robot = (folder / "robot.yaml").read_text()
    assert [f"name: {name}," in robot for name in ("body", "segment1", "segment2", "tail")] == [True] * 4


def test_table_of_swims_states_the_drive(project) -> None:
    def write(lab: Path) -> None:
        lab_folders.one_robot(lab)
        for path in [*lab.glob("*_arduino.txt"), *lab.glob("*_imu.csv")]:
            path.unlink()

    folder, _ = project(write, "--robot", "tfish")
    trials = (folder / "log-1.trials.yaml").read_text()
    assert "drive: {frequency_hz: 0.8, amplitude_deg: 25.0, bias_deg: 0.0}" in trials
    assert "ASK" not in trials.partition("trials:")[2]
