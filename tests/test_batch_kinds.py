"""Plans, names, links and locks that a batch refuses or gets along with; no item is computed here."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from swimid.runs.plan import Resolved
from tests.conftest import Ran

Run = Callable[..., Ran]

PLAN = "format: swimid-plan/1\nitems: [{files: %s, steps: [plot]}]\n"
posix = pytest.mark.skipif(os.name != "posix", reason="names and links of POSIX")


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a log, as the working folder."""
    monkeypatch.chdir(tmp_path)
    log(tmp_path / "logs" / "a.csv")
    return tmp_path


def log(path: Path) -> None:
    """Write a short log."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("t_s,x_m\n0,1\n1,2\n2,3\n")


def planned(swimid: Run, text: str, *options: str) -> Ran:
    """Write a plan in the working folder, and give it to a run that does no item."""
    Path("plan.yaml").write_text(text)
    return swimid("batch", "plan.yaml", "-o", "run", *(options or ("--dry-run", "--json")))


def names(ran: Ran) -> dict[str, str]:
    """Return the first file of each item by the name of the item."""
    assert ran.status == 0, ran.err
    return {item["id"]: item["files"][0] for item in ran.json["result"]["items"]}


# ---------------------------------------------------------------- plans


@pytest.mark.parametrize("steps", ["{plot: {title: x}}", "plot", "-1", "true", "1.5", "{}", '""'])
@pytest.mark.parametrize("place", ["group", "plan"])
def test_steps_that_are_no_list_are_refused(lab: Path, swimid: Run, steps: str, place: str) -> None:
    text = f"format: swimid-plan/1\nitems:\n  - files: logs/*.csv\n    steps: {steps}\n"
    if place == "plan":
        text = f"format: swimid-plan/1\nitems: [{{files: logs/*.csv}}]\nsteps: {steps}\n"
    ran = planned(swimid, text, "--dry-run")
    assert ran.status == 3
    assert "steps are a list" in ran.err
    assert f"line {4 if place == 'group' else 3}" in ran.err


@pytest.mark.parametrize("step", ["-1", "true", "[plot]", "{plot: 3}", "{plot: {}, report: {}}", "null"])
def test_a_step_of_another_kind_is_refused(lab: Path, swimid: Run, step: str) -> None:
    ran = planned(swimid, PLAN.replace("plot", step) % "logs/*.csv", "--dry-run")
    assert ran.status == 3
    assert "a step is a command" in ran.err


@pytest.mark.parametrize("limits", ["time_s: 1e18", "time_s: .inf", "time_s: .nan", "time_s: -1"])
def test_limits_are_bounded(lab: Path, swimid: Run, limits: str) -> None:
    ran = planned(swimid, f"limits: {{{limits}}}\n" + PLAN % "logs/*.csv", "--dry-run")
    assert ran.status == 3
    assert limits.split(":")[0] in ran.err


def test_a_step_that_waits_for_a_user_is_refused(lab: Path, swimid: Run) -> None:
    ran = planned(swimid, PLAN.replace("plot", "{track setup: {pick: true}}") % "logs/*.csv", "--dry-run")
    assert ran.status == 3
    assert "waits for input of a user" in ran.err
    assert "swimid track setup --pick" in ran.err


def test_a_run_has_one_plan(lab: Path, swimid: Run) -> None:
    planned(swimid, PLAN % "logs/*.csv", "--collect")
    before = Path("run/plan.json").read_bytes()
    (lab / "other").mkdir()
    for name in ("other.yaml", "other/plan.yaml"):
        Path(name).write_text(PLAN % "../**/a.csv")
        ran = swimid("batch", name, "-o", "run", "--collect")
        assert ran.status == 2
        assert "is the run of another plan, ../plan.yaml" in ran.err
        assert Path("run/plan.json").read_bytes() == before
    log(lab / "logs" / "b.csv")
    assert planned(swimid, PLAN % "logs/*.csv", "--collect").status == 0  # a plan may change
    assert swimid("batch", "other.yaml", "-o", "run", "--collect", "--force").status == 0


# ---------------------------------------------------------------- names


@posix
def test_names_that_differ_little_are_told_apart(lab: Path, swimid: Run) -> None:
    pairs = ["A.csv", "run 1.csv", "run_1.csv", "run:1.csv", "b/c.csv", "b_c.csv", "é.csv", "e\u0301.csv"]
    for name in pairs:
        log(lab / "logs" / name)
    found = names(planned(swimid, PLAN % '"logs/**/*.csv"'))
    assert sorted(found.values()) == sorted(f"logs/{name}" for name in [*pairs, "a.csv"])
    assert len({name.casefold() for name in found}) == len(found)


@posix
def test_a_loop_of_links_gives_each_file_once(lab: Path, swimid: Run) -> None:
    log(lab / "logs" / "d" / "b.csv")
    for name, target in {"d/up": "..", "self": "self", "here": ".", "a2.csv": "a.csv", "gone": "no"}.items():
        (lab / "logs" / name).symlink_to(target)
    assert sorted(names(planned(swimid, PLAN % '"logs/**/*.csv"')).values()) == ["logs/a.csv", "logs/d/b.csv"]
    assert len(names(planned(swimid, PLAN % '"**/*.csv"'))) == 2


@pytest.mark.parametrize(
    ("pattern", "files"),
    [
        ("logs/**", {"logs/a.csv", "logs/d/b.csv"}),
        ("**/b.csv", {"logs/d/b.csv"}),
        ("*/**/d/**/*.csv", {"logs/d/b.csv"}),
        ("./logs/**/a.csv", {"./logs/a.csv"}),
    ],
)
def test_two_stars_stand_for_folders(lab: Path, swimid: Run, pattern: str, files: set[str]) -> None:
    log(lab / "logs" / "d" / "b.csv")
    log(lab / "logs" / ".hidden" / "c.csv")
    assert set(names(planned(swimid, PLAN % f'"{pattern}"')).values()) == files


def test_an_item_of_the_folder_of_the_plan_has_a_folder(lab: Path, swimid: Run) -> None:
    log(lab / "b.csv")
    log(lab.parent / "c.csv")
    for pattern in ('"*.csv", together: true', '"../*.csv", together: true'):
        (name,) = names(planned(swimid, PLAN % pattern))
        assert name.strip(".")


@posix
def test_long_and_odd_names_make_short_folders(lab: Path, swimid: Run) -> None:
    for name in ("漢" * 80, "x" * 240, "-o", "a\nb", "$(id)", "'"):
        log(lab / "logs" / f"{name}.csv")
    found = planned(swimid, PLAN % "logs/*.csv", "--dry-run")
    assert found.status == 0
    assert all(len(name.encode()) <= 130 for name in names(planned(swimid, PLAN % "logs/*.csv")))
    log(lab / "logs" / "\udcff.csv")
    ran = planned(swimid, PLAN % "logs/*.csv", "--dry-run")
    assert ran.status == 3
    assert "is not UTF-8" in ran.err


@posix
def test_results_whose_names_begin_with_a_dash_are_files(lab: Path, swimid: Run) -> None:
    log(lab / "-run.csv")
    steps = "{import: {as: -x}}, plot, report"
    ran = planned(swimid, PLAN.replace("plot", steps) % '"-run.csv"', "--dry-run")
    assert ran.status == 0, ran.err
    assert "plot ./-x.csv" in ran.out


# ---------------------------------------------------------------- links and locks


@posix
def test_nothing_is_done_behind_a_link(lab: Path, swimid: Run) -> None:
    planned(swimid, PLAN % "logs/*.csv", "--collect")
    (lab / "precious").mkdir()
    (lab / "precious" / "status.json").write_text("{}")
    for place in (lab / "run/items", lab / "run/items/logs_a.csv"):
        place.parent.mkdir(exist_ok=True)
        place.symlink_to(lab / "precious")
        ran = planned(swimid, PLAN % "logs/*.csv", "--retry", "failed")
        assert ran.status == 4
        assert "is a symbolic link" in ran.out
        place.unlink()
    assert [path.name for path in (lab / "precious").iterdir()] == ["status.json"]


@pytest.mark.parametrize(
    ("lock", "holder"),
    [("7\nnode1\n9\n", "process 7 on node1"), ("", "an unknown process"), ("x\ny\n", "an unknown process")],
)
def test_a_lock_is_named(lab: Path, swimid: Run, lock: str, holder: str) -> None:
    (lab / "run/items/logs_a.csv").mkdir(parents=True)
    (lab / "run/items/logs_a.csv/status.json.lock").write_text(lock)
    ran = planned(swimid, PLAN % "logs/*.csv", "--collect", "--force")
    table = pd.read_csv("run/summary.csv", comment="#").iloc[0]
    assert ran.status == 4
    assert table.state == "busy"
    assert holder in table.reason
    assert "delete items/logs_a.csv/status.json.lock" in ran.out


@posix
def test_the_lock_of_a_process_that_has_ended_counts_as_none(lab: Path, swimid: Run) -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    (lab / "run/items/logs_a.csv").mkdir(parents=True)
    lock = lab / "run/items/logs_a.csv/status.json.lock"
    lock.write_text(f"{process.pid}\n{socket.gethostname()}\n")
    ran = planned(swimid, PLAN % "logs/*.csv", "--collect", "--force")
    assert ran.status == 0
    assert pd.read_csv("run/summary.csv", comment="#").iloc[0].state == "missing"


def test_an_error_of_the_disk_fails_the_item_and_not_the_run(lab: Path, swimid: Run) -> None:
    planned(swimid, PLAN % "logs/*.csv", "--collect")
    (lab / "run/items").write_text("in the way of the folder")
    ran = planned(swimid, PLAN % "logs/*.csv", "--jobs", "1")
    assert ran.status == 4
    table = pd.read_csv("run/summary.csv", comment="#").iloc[0]
    assert table.state == "failed"
    assert "items" in table.reason


def test_a_summary_has_no_zero_bytes(lab: Path, swimid: Run) -> None:
    planned(swimid, PLAN % "logs/*.csv", "--collect")
    (item,) = Resolved.of_run("run").items
    folder = lab / "run/items" / item.id
    folder.mkdir(parents=True)
    error = {"message": "bad cell '\0\x07\ufffe'", "hint": "\0", "log": "\0"}
    status = {
        "id": item.id,
        "state": "refused",
        "version": "1",
        "steps_sha256": item.digest(),
        "error": error,
    }
    (folder / "status.json").write_text(json.dumps(status))
    planned(swimid, PLAN % "logs/*.csv", "--collect")
    for name in ("summary.csv", "index.html"):
        assert not set("\0\x07\ufffe") & set(Path("run", name).read_text(encoding="utf-8"))
    assert "bad cell" in Path("run/summary.csv").read_text()
