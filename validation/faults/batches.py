"""Attack on batches.

Plans and statuses are damaged, inputs change, links and foreign locks stand in the way, files have hostile
names, signals come at random times, and two processes or two plans meet in one run.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import tempfile
import time
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from swimid.files import yamlio
from tests.generators import archive
from validation import batch_runs
from validation.faults.runner import Attack, Finding, check_ending, command, invoked, mutated

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


def _changed(rng: np.random.Generator, folder: Path) -> bool:
    """Change, touch, remove or replace an input of a finished run: only other content is outdated."""
    run, plan = _finished(folder / "run", folder)
    log = folder / "logs" / f"log{rng.integers(2)}.csv"
    before = log.read_bytes()
    kind = int(rng.integers(6))
    if kind == 0:
        log.write_bytes(mutated(before, rng, ["1", ","]))
    elif kind == 1:
        os.utime(log, ns=(int(rng.integers(1 << 60)),) * 2)
    elif kind == 2:
        log.unlink()
    elif kind == 3:
        log.rename(folder / "moved.csv")
        log.symlink_to("../moved.csv")
    elif kind == 4:
        (folder / "new.csv").write_bytes(before[: int(rng.integers(1, len(before) + 1))])
        (folder / "new.csv").replace(log)
    elif kind == 5:
        shutil.copytree(folder / "logs", folder / "copied", copy_function=shutil.copyfile)
        shutil.rmtree(folder / "logs")
        (folder / "copied").rename(folder / "logs")
    same = log.is_file() and log.read_bytes() == before
    if not log.exists():
        return command("batch", plan, "-o", run, "--collect")[0] == 0
    states = _states(plan, run)
    expected = dict.fromkeys(states, "done")
    if not same:
        expected[f"logs_{log.name}"] = "outdated"
    if states != expected:
        raise Finding(f"kind {kind}: the states are {states}")
    return same


def _link(rng: np.random.Generator, folder: Path) -> bool:
    """Replace a part of a finished run by a link: the target keeps its files, and nothing else is read."""
    run, plan = _finished(folder / "run", folder)
    precious = folder / "precious"
    (precious / "sub").mkdir(parents=True)
    (precious / "status.json").write_text("{}")
    names = [path.name for path in (run / "items").iterdir()]
    place = [run, run / "items", run / "items" / str(rng.choice(names)), folder / "logs"][
        int(rng.integers(4))
    ]
    whole = place in (run, folder / "logs")
    target = precious
    if whole or rng.random() < 0.5:
        target = folder / "moved"
        place.rename(target)
    else:
        shutil.rmtree(place)
    place.symlink_to(os.path.relpath(target, place.parent))
    before = sorted((path, path.is_file() and path.read_bytes()) for path in target.rglob("*"))
    states = _states(
        plan, run, *(["--retry", "failed"] if rng.random() < 0.5 and not whole else ["--collect"])
    )
    after = sorted((path, path.is_file() and path.read_bytes()) for path in target.rglob("*"))
    if not whole and before != after:
        raise Finding(f"the files behind the link {place} have changed")
    if whole and set(states.values()) != {"done"}:
        raise Finding(f"with the link {place} the states are {states}")
    if not whole and "failed" not in states.values():
        raise Finding(f"the link {place} is not named: {states}")
    return whole


def _lock(rng: np.random.Generator, folder: Path) -> bool:
    """Leave the lock of another machine, or a damaged one, with an item that is not done."""
    run, plan = _finished(folder / "run", folder)
    item = next((run / "items").iterdir())
    (item / "status.json").unlink()
    content = f"{rng.integers(1, 99999)}\nnode{rng.integers(9)}\n{rng.integers(1 << 40)}\n".encode()
    damaged = rng.random() < 0.5
    if damaged:
        content = mutated(content, rng, ["\n", "x", "1e9", "-"])
    (item / "status.json.lock").write_bytes(content)
    status, _ = command("batch", plan, "-o", run, "--collect", "--json")
    state = _states(plan, run)[item.name]
    if not damaged and (state != "busy" or status != 4):
        raise Finding(f"the lock of another machine: state {state}, status {status}")
    if state not in ("busy", "missing"):
        raise Finding(f"a damaged lock: state {state}")
    return state == "missing"


PARTS = [
    "a", "A", " ", "_", "-", "--", ".", "é", "e\u0301", "漢" * 30, "x" * 60, "'", '"', "$(id)", "\n", "\t",
    "\u00a0", "🐟", "%s", "{0}", "*", "[a]", "\udcff", "\u202e", "CON", "\x7f", "~", "#", "&", "\\",
]  # fmt: skip


def _names(rng: np.random.Generator, folder: Path) -> bool:
    """Resolve a plan for files of hostile names, with loops of links: one item for each file."""
    _emptied(folder)
    files = set()
    for _ in range(int(rng.integers(1, 9))):
        parts = ["".join(rng.choice(PARTS, int(rng.integers(1, 4)))) for _ in range(int(rng.integers(1, 3)))]
        path = folder.joinpath("logs", *(part.strip(".") or "d" for part in parts[:-1]), f"{parts[-1]}.csv")
        if path.name.startswith(".") or any(part.startswith(".") for part in parts):
            continue
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("t_s,x_m\n0,1\n1,2\n")
            files.add(path.resolve())
    (folder / "logs").mkdir(exist_ok=True)
    for number in range(int(rng.integers(3))):
        (folder / "logs" / f"loop{number}").symlink_to(str(rng.choice([".", "..", "loop0", "nowhere"])))
    plan = folder / "plan.yaml"
    plan.write_text("format: swimid-plan/1\nitems: [{files: logs/**/*.csv, steps: [plot]}]\n")
    ran = invoked("batch", plan, "-o", folder / "run", "--dry-run", "--json")
    bad = any("\udcff" in str(path) for path in files)
    if not files or bad:
        if ran.exit_code != 3:
            raise Finding(f"status {ran.exit_code} for {files}")
        return False
    if ran.exit_code != 0:
        raise Finding(f"status {ran.exit_code} for {files}: {ran.stderr}")
    items = json.loads(ran.stdout)["result"]["items"]
    idents = {item["id"].casefold() for item in items}
    if len(items) != len(files) or len(idents) != len(files):
        raise Finding(f"{len(items)} items with {len(idents)} names for {len(files)} files: {files}")
    if any(len(name.encode()) > 140 or "/" in name or not name.strip(".") for name in idents):
        raise Finding(f"names of folders: {idents}")
    return True


VALUES = [
    -1, 0, 1e18, float("inf"), float("nan"), True, None, "", "x", "../..", [], {}, [[]], {"a": 1}, "plot",
]  # fmt: skip


def _shape(rng: np.random.Generator, folder: Path) -> bool:
    """Replace values of a plan by values of other kinds."""
    plan = _write(folder, 2)
    content = yamlio.plain(yamlio.load(plan))
    for _ in range(int(rng.integers(1, 3))):
        node: Any = content
        while True:
            keys = [*node] if isinstance(node, dict) else [*range(len(node))]
            key = keys[int(rng.integers(len(keys)))]
            inner = node[key]
            if not isinstance(inner, dict | list) or not inner or rng.random() < 0.2:
                node[key] = VALUES[int(rng.integers(len(VALUES)))]
                break
            node = inner
    plan.write_text(json.dumps(content).replace("Infinity", ".inf").replace("NaN", ".nan"))
    return command("batch", plan, "-o", folder / "run", "--dry-run")[0] == 0


def _replaced(rng: np.random.Generator, folder: Path) -> bool:
    """Replace an input while its item runs: the item is outdated, and done again."""
    plan, log = _write(folder, 2), folder / "logs" / "log0.csv"
    reference = folder / "other"
    archive.write_log(folder / "new.csv", 7)
    process = batch_runs.started(plan, folder / "run")
    while not (folder / "run/items/logs_log0.csv/rwls.yaml").exists() and process.poll() is None:
        time.sleep(0.02)
    shutil.copy(folder / "new.csv", log)
    _, messages = process.communicate()
    check_ending(process.returncode, messages)
    batch_runs.undisturbed(plan, folder / "run")
    batch_runs.undisturbed(plan, reference)
    if batch_runs.hashes(folder / "run" / "items") != batch_runs.hashes(reference / "items"):
        raise Finding("an input that was replaced while its item ran: the result is of the former one")
    return True


def _two_plans(rng: np.random.Generator, folder: Path) -> bool:
    """Start two different plans on one folder: one of them is refused, and the other is complete."""
    first = _write(folder, 2)
    second = folder / "second.yaml"
    second.write_text(PLAN.replace("logs/*.csv", "logs/log1.csv").replace("overrides", "# "))
    pair = [batch_runs.started(first, folder / "run")]
    time.sleep(float(rng.uniform(0.0, 4.0)))
    pair.append(batch_runs.started(second, folder / "run"))
    for process in pair:
        _, messages = process.communicate()
        check_ending(process.returncode, messages)
    if [process.returncode for process in pair].count(2) != 1:
        raise Finding(f"two plans end with {[process.returncode for process in pair]}")
    return True


def _states(plan: Path, run: Path, *options: str) -> dict[str, str]:
    """Return the states of the items of a run, from its summary."""
    ran = invoked("batch", plan, "-o", run, *(options or ["--collect"]), "--json")
    if ran.exit_code not in (0, 4):
        raise Finding(f"status {ran.exit_code}: {ran.stderr}")
    return {entry["id"]: entry["state"] for entry in json.loads(ran.stdout)["result"]["entries"]}


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
    Attack("batch: names and link loops", _names, time_s=300.0),
    Attack("batch: shape of a plan", _shape, time_s=300.0),
    Attack("batch: input changed", _changed, count=300, time_s=300.0),
    Attack("batch: symbolic link", _link, count=300, time_s=300.0),
    Attack("batch: lock of another machine", _lock, count=300, time_s=300.0),
    Attack("batch: input replaced while its item runs", _replaced, count=3, time_s=600.0),
    Attack("batch: two plans in one folder", _two_plans, count=3, time_s=600.0),
]
