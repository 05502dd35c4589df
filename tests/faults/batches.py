"""Attack on batches: damaged plans and statuses, signals at random times, two processes on a run."""

from __future__ import annotations

import shutil
import signal
import tempfile
import time
from functools import cache, partial
from pathlib import Path

import numpy as np

from tests import batch_runs
from tests.faults.runner import Attack, Finding, check_ending, command, mutated
from tests.generators import archive

PLAN = """format: swimid-plan/1
limits: {time_s: 60, memory_mb: 4000}
items:
  - name: logs
    files: logs/*.csv
    exclude: none.csv
    steps: [{rwls: {input: cmd1_rad, output: u_m_s, na: 2, nb: 1}}, plot, report]
defaults: {rwls: {max-order: 3}}
overrides: {logs/log1.csv: {rwls: {na: 3}}}
"""
PIECES = ["*", "..", "/", "{}", "[]", "null", "steps:", "-", "1e308", "swimid-plan/2", "as:", "!!python/x"]


def _emptied(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()


def _write(folder: Path, logs: int) -> Path:
    """Write a plan and its logs into a folder, which has nothing else then."""
    _emptied(folder)
    (folder / "logs").mkdir()
    for number in range(logs):
        archive.write_log(folder / "logs" / f"log{number}.csv", number)
    (folder / "plan.yaml").write_text(PLAN)
    return folder / "plan.yaml"


def _plan(rng: np.random.Generator, folder: Path) -> bool:
    plan = _write(folder, 2)
    plan.write_bytes(mutated(plan.read_bytes(), rng, PIECES))
    status, _ = command("batch", plan, "-o", folder / "run", "--dry-run")
    if (folder / "run").exists():
        raise Finding("a dry run leaves a folder")
    return status == 0


def _stop(rng: np.random.Generator, folder: Path, *, how: signal.Signals) -> bool:
    plan, reference = _write(folder, 3), folder / "reference"
    seconds = batch_runs.undisturbed(plan, reference)
    process = batch_runs.started(plan, folder / "run")
    time.sleep(float(rng.uniform(0.2, 1.0)) * seconds)
    process.send_signal(how)
    _, messages = process.communicate()
    if how == signal.SIGINT:
        check_ending(process.returncode, messages)
    done = {path: path.stat().st_mtime_ns for path in (folder / "run").glob("items/*/status.json")}
    batch_runs.undisturbed(plan, folder / "run")
    if any(path.stat().st_mtime_ns != then for path, then in done.items()):
        raise Finding("a finished item was done again")
    if batch_runs.hashes(folder / "run") != batch_runs.hashes(reference):
        raise Finding("the resumed run left other files")
    return process.returncode == 0


def _twice(rng: np.random.Generator, folder: Path) -> bool:
    plan = _write(folder, 4)
    pair = [batch_runs.started(plan, folder / "run")]
    time.sleep(float(rng.uniform(0.0, 1.0)))
    pair.append(batch_runs.started(plan, folder / "run"))
    for process in pair:
        _, messages = process.communicate()
        check_ending(process.returncode, messages)
    batch_runs.undisturbed(plan, folder / "run")
    batch_runs.undisturbed(plan, folder / "reference")
    if batch_runs.hashes(folder / "run") != batch_runs.hashes(folder / "reference"):
        raise Finding("two processes on one run left other files")
    return True


def _status(rng: np.random.Generator, folder: Path) -> bool:
    """Damage the statuses of a finished run: its summary is written, and a damaged item counts as missing."""
    run = folder / "run"
    _, plan = _finished(run, folder)
    for path in run.glob("items/*/status.json"):
        path.write_bytes(mutated(path.read_bytes(), rng, ['"', "{", "null", "1e999", "-1"]))
    status, _ = command("batch", plan, "-o", run, "--collect")
    return status == 0


@cache
def _copy() -> tuple[tempfile.TemporaryDirectory[str], Path]:
    holder = tempfile.TemporaryDirectory(prefix="faults-")
    plan = _write(Path(holder.name), 2)
    batch_runs.undisturbed(plan, plan.parent / "run")
    return holder, plan.parent


def _finished(run: Path, folder: Path) -> tuple[Path, Path]:
    """Copy a finished run and its plan into a folder, which has nothing else then."""
    _emptied(folder)
    shutil.copytree(_copy()[1], folder, dirs_exist_ok=True)
    return run, folder / "plan.yaml"


ATTACKS = [
    Attack("plan", _plan),
    Attack("status of an item", _status, count=200, time_s=120.0),
    *(
        Attack(f"{how.name} in batch", partial(_stop, how=how), count=3, time_s=300.0)
        for how in (signal.SIGINT, signal.SIGKILL)
    ),
    Attack("two processes on one run", _twice, count=3, time_s=300.0),
]
