"""How long ``swimid diagnose`` takes, and how that grows with the number of trials.

    PYTHONPATH=. python benchmarks/bench_diagnose.py [--plot FILE] [TRIALS ...]

Tendon fish with play in its servos, made by the independent simulator of the tests: 20 s trials at 25 Hz of
unlike settings, the whole catalogue, one thread per processor. Each size runs in a process of its own, whose
largest resident memory is read; "over linear" is the wall time per trial against that of the smallest size.
``--plot`` draws the wall time over the trials beside a straight line through the smallest size.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from swimid.diagnosis.gap_file import GapFile
from tests.generators import gap_trials
from validation.blind import swim_actuation

COUNTS = (3, 6, 12, 24)
DURATION_S, SIZE, SEED = 20.0, 2.0, 1


def settings(count: int) -> list[tuple[float, float, float]]:
    """Frequency (Hz), amplitude (deg) and bias (deg) of each trial; every sixth repeats the one before."""
    rng = np.random.default_rng(SEED)
    found: list[tuple[float, float, float]] = []
    for k in range(count):
        fresh = (rng.uniform(0.8, 1.9), rng.uniform(18.0, 32.0), rng.choice([0.0, 0.0, -10.0, 10.0]))
        found.append(found[-1] if k % 6 == 5 else tuple(round(float(v), 2) for v in fresh))  # type: ignore[arg-type]
    return found


def measured(count: int) -> tuple[float, float, float, GapFile]:
    """Wall and processor seconds, largest resident memory (MB), and the answer."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        play = swim_actuation.servo_backlash(np.random.default_rng(SEED), SIZE, "tfish")
        gap_trials.write(folder, "tfish", [play], settings=settings(count), duration_s=DURATION_S, seed=SEED)
        words = ["diagnose", "trials.yaml", "--params", "params.yaml", "-o", "gap.yaml", "-q"]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-m", "swimid", *words], cwd=folder, check=True)
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        # the largest of all children so far: sizes must grow
        return wall, cpu, after.ru_maxrss / 1024.0, GapFile.read(folder / "gap.yaml")


def plot(path: Path, counts: list[int], walls: list[float]) -> None:
    """Wall time over trials."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    axes.plot(counts, walls, "o-", label="swimid diagnose")
    axes.plot(
        [0, counts[-1]], [0, walls[0] / counts[0] * counts[-1]], "--", label=f"linear from {counts[0]} trials"
    )
    axes.set(xlabel=f"trials of {DURATION_S:g} s", ylabel="wall time (s)", xlim=(0, None), ylim=(0, None))
    axes.legend()
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("trials", nargs="*", type=int, default=list(COUNTS))
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    counts = sorted(options.trials)
    first, walls = 0.0, []
    print(f"{'trials':>6}{'wall s':>9}{'cpu s':>9}{'over linear':>13}{'MB':>7}  answer")
    for count in counts:
        wall, cpu, memory, found = measured(count)
        first = first or wall / count
        answer = f"{found.verdict}: {', '.join(c.effect for c in found.causes) or '-'}"
        over = wall / count / first
        print(f"{count:>6}{wall:>9.1f}{cpu:>9.1f}{over:>13.2f}{memory:>7.0f}  {answer}", flush=True)
        walls.append(wall)
    if options.plot:
        plot(options.plot, counts, walls)


if __name__ == "__main__":
    main()
