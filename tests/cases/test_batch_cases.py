"""Recorded inputs of ``batch`` and of results that state their inputs, with what should become of them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import swimid as package
from swimid.files import kernels
from tests.conftest import ROOT, Ran, interrupting

Run = Callable[..., Ran]
Case = Callable[..., Path]


def states(ran: Ran) -> dict[str, str]:
    """Return the state of each item that a run answered with ``--json``."""
    return {entry["id"]: entry["state"] for entry in ran.json["result"]["entries"]}


def estimate(run: Path) -> float:
    """Return the estimate b1 of the only item of a run."""
    table = pd.read_csv(run / "metrics.csv", comment="#")
    return float(table[table.quantity == "rwls: b1"].value.iloc[0])


# ---------------------------------------------------------------- files that are inputs


@pytest.mark.slow
def test_a_search_with_an_edited_effect_begins_anew(case: Case) -> None:
    folder = case("t4-checkpoint-ignores-effect")
    effect = folder / "my_effect.py"
    given: dict[str, Any] = {
        "params": "params.yaml", "own_effects": (effect,), "amplitude_deg": 25, "jobs": 1,
        "over": {"frequency_hz": (1, 1.6, 9)}, "duration_s": 12,
    }  # fmt: skip
    with pytest.raises(KeyboardInterrupt):
        package.performance_map(output="map.yaml", progress=interrupting(4), **given)
    effect.write_text(effect.read_text().replace("-5 * rate", "-rate"))
    with pytest.warns(UserWarning, match="SWM150"):
        resumed = package.performance_map(output="map.yaml", **given)
    fresh = package.performance_map(**given)
    assert resumed.data == fresh.data | {"provenance": resumed.data["provenance"]}
    assert "my_effect.py" in resumed.evidence.provenance["inputs"]


def test_the_file_of_a_join_is_an_input(case: Case, swimid: Run) -> None:
    case("t4-joined-file-no-input")
    assert swimid("import", "a.csv", "--map", "m.yaml", "-o", "log.csv").status == 0
    inputs = json.loads(Path("log.evidence.json").read_text())["provenance"]["inputs"]
    assert set(inputs) == {"a.csv", "m.yaml", "ext.csv"}


@pytest.mark.slow
def test_a_changed_file_of_a_join_outdates_the_item(case: Case, swimid: Run) -> None:
    case("t4-joined-file-no-input")
    swimid("batch", "plan2.yaml", "-o", "run")
    other = Path("ext.csv").read_text().replace(",1.", ",5.")
    Path("ext.csv").write_text(other)
    ran = swimid("batch", "plan2.yaml", "-o", "run", "--collect", "--json")
    assert set(states(ran).values()) == {"outdated"}
    swimid("batch", "plan2.yaml", "-o", "run")
    (log,) = Path("run/items").glob("*/a.csv")
    assert log.read_text().splitlines()[-1].endswith("5.99")


@pytest.mark.slow
def test_an_input_that_is_replaced_while_its_item_runs_is_done_again(case: Case, swimid: Run) -> None:
    folder = case("t4-input-changes")
    command = [sys.executable, "-m", "swimid", "batch", "plan.yaml", "-o", "run"]
    process = subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(ROOT)})
    while not (folder / "run/items/logs_a.csv/rwls.yaml").exists() and process.poll() is None:
        time.sleep(0.02)
    shutil.copy("other.csv", "logs/a.csv")
    assert process.wait() == 4
    assert pd.read_csv("run/metrics.csv", comment="#").empty
    assert states(swimid("batch", "plan.yaml", "-o", "run", "--json")) == {"logs_a.csv": "done"}
    swimid("batch", "plan.yaml", "-o", "fresh")
    assert estimate(folder / "run") == estimate(folder / "fresh")


@pytest.mark.slow
def test_an_archive_of_pictures_that_is_copied_is_done(case: Case, swimid: Run) -> None:
    folder = case("t4-picture-folder-copied")
    assert set(states(swimid("batch", "plan.yaml", "-o", "run", "--json")).values()) == {"done"}
    copy = shutil.copytree(folder, folder.parent / "copy", copy_function=shutil.copyfile)
    ran = swimid("batch", copy / "plan.yaml", "-o", copy / "run", "--collect", "--json")
    assert set(states(ran).values()) == {"done"}
    picture = sorted((copy / "fr").iterdir())[3]
    picture.write_bytes(sorted((copy / "fr").iterdir())[4].read_bytes())
    ran = swimid("batch", copy / "plan.yaml", "-o", copy / "run", "--collect", "--json")
    assert set(states(ran).values()) == {"outdated"}


# ---------------------------------------------------------------- links and locks


@pytest.mark.slow
def test_a_run_behind_a_link_reads_the_files_of_its_plan(case: Case, swimid: Run) -> None:
    folder = case("t4-run-symlink")
    link = folder / "proj/run"
    link.unlink()
    (folder / "scratch/run").mkdir(exist_ok=True)
    link.symlink_to("../scratch/run")
    assert swimid("batch", folder / "proj/plan.yaml", "-o", link).status == 0
    assert abs(estimate(link) + 0.00387) < 1e-4
    shutil.rmtree(folder / "scratch/logs")
    again = swimid("batch", folder / "proj/plan.yaml", "-o", link, "--json")
    assert set(states(again).values()) == {"done"}


@pytest.mark.slow
def test_the_files_behind_the_link_of_an_item_stay(case: Case, swimid: Run) -> None:
    folder = case("t4-lock-of-another-host")
    swimid("batch", "plan.yaml", "-o", "run")
    precious = folder / "precious"
    (precious / "sub").mkdir(parents=True)
    (precious / "thesis.txt").write_text("keep")
    shutil.rmtree(folder / "run/items/logs_a.csv")
    (folder / "run/items/logs_a.csv").symlink_to("../../precious")
    ran = swimid("batch", "plan.yaml", "-o", "run", "--retry", "failed", "--json")
    entry = next(one for one in ran.json["result"]["entries"] if one["id"] == "logs_a.csv")
    assert ran.status == 4
    assert entry["state"] == "failed"
    assert "symbolic link" in entry["reason"]
    assert sorted(path.name for path in precious.iterdir()) == ["sub", "thesis.txt"]


@pytest.mark.slow
def test_the_lock_of_another_machine_is_named(case: Case, swimid: Run) -> None:
    folder = case("t4-lock-of-another-host")
    swimid("batch", "plan.yaml", "-o", "run")
    item = folder / "run/items/logs_a.csv"
    (item / "status.json").unlink()
    (item / "status.json.lock").write_text(
        "23454\nnode1\n976172682685976333304898709930381969727441775617145\n"
    )
    ran = swimid("batch", "plan.yaml", "-o", "run")
    assert ran.status == 4
    assert "process 23454 on node1" in ran.out
    assert "status.json.lock" in ran.out
    assert (item / "status.json.lock").exists()


# ---------------------------------------------------------------- names


@pytest.mark.slow
def test_a_name_of_many_bytes_is_cut(case: Case, swimid: Run) -> None:
    case("t4-long-utf8-name")
    ran = swimid("batch", "plan.yaml", "-o", "run", "--jobs", "1", "--json")
    assert set(states(ran).values()) == {"done"}


@pytest.mark.slow
def test_a_name_that_begins_with_a_dash_is_no_option(case: Case, swimid: Run) -> None:
    case("t4-dash-name")
    ran = swimid("batch", "plan.yaml", "-o", "run", "--json")
    assert set(states(ran).values()) == {"done"}


def test_names_that_collide_are_told_apart(case: Case, swimid: Run) -> None:
    folder = case("t4-names-collide")
    (folder / "logs/d").mkdir()
    (folder / "logs/d/loop").symlink_to("..")
    plan = (folder / "plan.yaml").read_text().replace("logs/*.csv", "logs/**/*.csv")
    (folder / "plan.yaml").write_text(plan)
    ran = swimid("batch", "plan.yaml", "-o", "run", "--dry-run", "--json")
    items = ran.json["result"]["items"]
    assert {item["files"][0] for item in items} == {"logs/run 1.csv", "logs/run_1.csv"}
    assert len({item["id"].lower() for item in items}) == len(items) == 2


# ---------------------------------------------------------------- plans and scripts


@pytest.mark.parametrize(
    ("name", "plan"),
    [
        ("t4-plan-steps-mapping", "plan.yaml"),
        ("t4-plan-steps-number", "plan.yaml"),
        ("t4-plan-steps-number", "plan2.yaml"),
    ],
)
def test_steps_are_a_list(case: Case, swimid: Run, name: str, plan: str) -> None:
    case(name)
    ran = swimid("batch", plan, "-o", "run", "--dry-run")
    assert ran.status == 3
    assert f"{plan}, line " in ran.err
    assert "steps are a list" in ran.err


def test_a_sticky_folder_holds_no_kernels(case: Case, tmp_path: Path) -> None:
    case("t4-sticky-cache")
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    assert kernels.find_fault(shared) == "can be written by other users"
    assert kernels.find_fault(shared / "inner") == "can be written by other users"
