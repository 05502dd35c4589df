"""Runs of one plan in several ways, which must leave the same folder: ``python -m validation.batch_runs``.

The run is undisturbed, killed several times, and in shards. Every file but
the times of inputs and the logs must have the same content.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click
import numpy as np

from tests.conftest import ROOT
from tests.generators import archive

#: Files with times, memory and hosts, and what libraries print, with addresses in memory.
COSTS = ("stamps.json", "log.txt")
#: Time of results, and the engine: the batched kernel agrees with the scalar one to fourteen digits only.
FIXED = {"SOURCE_DATE_EPOCH": "1700000000", "SWIMID_LANES": "never", "PYTHONPATH": str(ROOT)}
ENVIRONMENT = {**os.environ, **FIXED}


def hashes(run: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a run that does not state costs."""
    files = sorted(path for path in run.rglob("*") if path.is_file() and path.name not in COSTS)
    return {str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def command(plan: Path, run: Path, *options: str) -> list[str]:
    """Return the command line of a run."""
    return [sys.executable, "-m", "swimid", "batch", str(plan), "-o", str(run), *options]


def undisturbed(plan: Path, run: Path, *options: str) -> float:
    """Do a run, and return its time in s."""
    began = time.perf_counter()
    ended = subprocess.run(command(plan, run, *options), env=ENVIRONMENT, capture_output=True, text=True)
    assert ended.returncode in (0, 4), ended.stderr
    return time.perf_counter() - began


def started(plan: Path, run: Path) -> subprocess.Popen[str]:
    """Start a run, in which Ctrl-C is handled as in a terminal."""
    return subprocess.Popen(
        command(plan, run),
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def killed(plan: Path, run: Path, *, kills: int, within_s: float, seed: int = 0) -> int:
    """Do a run that is killed several times at random points. Return the number of kills that took place.

    ``within_s`` is the time of an undisturbed run, over which the kills are spread.
    """
    rng, count = np.random.default_rng(seed), 0
    for _ in range(kills):
        process = started(plan, run)
        try:
            process.communicate(timeout=rng.uniform(0.5, 1.5) * within_s / kills)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.communicate()
            count += 1
    undisturbed(plan, run)
    return count


def sharded(plan: Path, run: Path, count: int) -> None:
    """Do a run in shards, two at a time, and collect it."""
    todo = [f"{k}/{count}" for k in range(1, count + 1)]
    while todo:
        pair = [
            subprocess.Popen(command(plan, run, "--shard", one, "--jobs", "1"), env=ENVIRONMENT, stdout=-3)
            for one in todo[:2]
        ]
        assert all(process.wait() in (0, 4) for process in pair)
        todo = todo[2:]
    undisturbed(plan, run, "--collect")


@click.command(help=__doc__)
@click.option("--items", default=60, show_default=True, help="Number of items.")
@click.option("--kills", default=5, show_default=True, help="Number of kills.")
@click.option("--jobs", default=1, show_default=True, help="Items at a time of the undisturbed run.")
def main(items: int, kills: int, jobs: int) -> None:
    """Do the runs, and print what differs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fit = [sys.executable, "-m", "swimid", "fit-drag", str(ROOT / "sample_logs/rig/trials.yaml")]
        drag = folder / "drag.yaml"
        subprocess.run([*fit, "-o", str(drag)], env=ENVIRONMENT, check=True, capture_output=True)
        plan = archive.write(folder / "lab", items, drag.read_text())
        print(f"{items} items")
        one = undisturbed(plan, folder / "one", "--jobs", str(jobs))
        expected = hashes(folder / "one")
        print(f"{jobs} job(s): {one:.0f} s, {len(expected)} files", flush=True)

        def show(what: str, run: str) -> None:
            found = hashes(folder / run)
            names = sorted(n for n in {*expected, *found} if expected.get(n) != found.get(n))
            print(f"{what}: {len(names)} files differ {names[:3] or ''}", flush=True)

        two = one
        if jobs == 1:
            two = undisturbed(plan, folder / "two", "--jobs", "2")
            show(f"two jobs: {two:.0f} s, throughput {one / two:.2f} of one job", "two")
        count = killed(plan, folder / "killed", kills=kills, within_s=two)
        show(f"killed {count} times", "killed")
        sharded(plan, folder / "shards", 4)
        show("in 4 shards", "shards")


if __name__ == "__main__":
    main()
