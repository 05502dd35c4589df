"""Recorded inputs of ``batch`` and of results that state their inputs, with what should become of them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from tests.conftest import ROOT, Ran

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
