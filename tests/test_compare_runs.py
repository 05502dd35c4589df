"""Runs are compared by their estimates: a change beyond the errors is named, chance is not."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import swimid as package
from swimid.errors import InputError, UsageError
from tests.conftest import SAMPLES, Ran
from tests.generators import archive
from tests.test_batch import PLAN, written

Run = Callable[..., Ran]


def parameters(path: Path, values: dict[str, tuple[float, float]]) -> Path:
    """Write a parameter file with values and standard errors."""
    rest = "unit: '1', bounds: [null, null], status: estimated"
    lines = [
        f"  {name}: {{value: {value!r}, stderr: {error!r}, {rest}}}"
        for name, (value, error) in values.items()
    ]
    path.write_text("\n".join(["format: swimid-parameters/1", "model: x", "parameters:", *lines]) + "\n")
    return path


def days(folder: Path, rng: np.random.Generator, *, changed: float, count: int = 200) -> list[Path]:
    """Write results of three days. The first tenth of the parameters changes on the last day."""
    truth, errors = rng.normal(size=count), rng.uniform(0.01, 0.1, count)
    files = []
    for day in range(3):
        moved = truth.copy()
        if day == 2:
            moved[: count // 10] += changed * errors[: count // 10]
        drawn = moved + errors * rng.normal(size=count)
        pairs = {f"p{k}": (float(drawn[k]), float(errors[k])) for k in range(count)}
        files.append(parameters(folder / f"day{day}.yaml", pairs))
    return files


@pytest.mark.slow
def test_chance_is_not_a_change(tmp_path: Path, rng: np.random.Generator) -> None:
    """In a family without changes, the probability of any false alarm is the false discovery rate."""
    alarms = 0
    for number in range(20):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = package.compare_runs(days(folder, rng, changed=0.0, count=20))
        alarms += any(quantity.changed for quantity in found.file.quantities)
    # Of 20 families at 5 %, more than 4 have an alarm with a probability of 0.3 %.
    assert alarms <= 4


@pytest.mark.slow
def test_a_change_is_named(tmp_path: Path, rng: np.random.Generator) -> None:
    found = package.compare_runs(days(tmp_path, rng, changed=8.0), output=tmp_path / "week.yaml")
    changed = [int(quantity.quantity[1:]) for quantity in found.file.quantities if quantity.changed]
    assert len(set(changed) & set(range(20))) >= 19
    assert len(set(changed) - set(range(20))) <= 4  # 5 % of 20 are expected
    assert found.verdict == "caution"
    assert "differ between the runs" in found.summary()
    again = package.load_result(tmp_path / "week.yaml")
    assert again.summary() == found.summary()
    assert found.evidence.figures[0].panels[0].x_categories == ["day0.yaml", "day1.yaml", "day2.yaml"]


def test_estimates_without_errors_are_not_tested(tmp_path: Path) -> None:
    files = [parameters(tmp_path / f"{k}.yaml", {"a": (float(k), 0.0)}) for k in (1, 2)]
    for file in files:
        file.write_text(file.read_text().replace("stderr: 0.0", "stderr: null"))
    found = package.compare_runs(files)
    assert found.verdict == "caution"
    assert "no change can be tested" in found.summary()


def test_wrong_use(tmp_path: Path, swimid: Run) -> None:
    one = parameters(tmp_path / "a.yaml", {"a": (1.0, 0.1)})
    other = parameters(tmp_path / "b.yaml", {"b": (1.0, 0.1)})
    with pytest.raises(UsageError, match="needs two runs"):
        package.compare_runs([one])
    with pytest.raises(InputError, match="the runs share no estimate"):
        package.compare_runs([one, other])
    ran = swimid("compare-runs", one, tmp_path / "absent.yaml")
    assert ran.status == 3
    assert "absent.yaml" in ran.err


@pytest.mark.slow
def test_runs_that_differ_in_inputs_and_steps(tmp_path: Path, swimid: Run) -> None:
    (tmp_path / "logs").mkdir()
    archive.write_log(tmp_path / "logs/a.csv", 1)
    archive.write_log(tmp_path / "logs/b.csv", 2)
    plan = written(tmp_path, PLAN)
    package.batch(plan, output=tmp_path / "run1")
    archive.write_log(tmp_path / "logs/b.csv", 3)
    written(tmp_path, PLAN + "overrides:\n  logs/a.csv: {rwls: {na: 3}}\n")
    package.batch(plan, output=tmp_path / "run2")
    ran = swimid("compare-runs", tmp_path / "run1", tmp_path / "run2", "-o", tmp_path / "c.yaml", "--json")
    assert ran.status == 0, ran.err
    differences = ran.json["result"]["differences"]
    assert differences["logs_a.csv"] == ["other steps, options or version"]
    assert differences["logs_b.csv"] == ["other content of b.csv"]
    # The truth of both recordings is the same system.
    b1 = [
        q
        for q in ran.json["result"]["quantities"]
        if q["item"] == "logs_b.csv" and q["quantity"].endswith("b1")
    ]
    assert not b1[0]["changed"]
    assert swimid("report", tmp_path / "c.yaml", "-o", tmp_path / "c.html").status == 0


def test_a_run_and_a_result_have_names(tmp_path: Path) -> None:
    shutil.copy(SAMPLES / "gap/params.yaml", tmp_path / "params.yaml")
    found = package.compare_runs([SAMPLES / "gap/params.yaml", tmp_path / "params.yaml"])
    assert len(set(found.file.runs)) == 2
    assert "equal to the last digit" in " ".join(found.summary().split())
