"""Diagnoses of models of MuJoCo with hidden causes: ``python -m validation.blind_simulators --cases 60``.

Each case is a robot, a cause and a size, drawn with one seed (:mod:`tests.generators.mujoco_robots`). The
command line diagnoses it without the cause. A run is taken up again. The table says how often a right effect
is named.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import swimid
from tests.generators.mujoco_robots import CAUSES, POSSIBLE, ROBOTS, record, write

#: Rod of 0.5 kg with the inertia 0.027 kg m2 about its hinge.
PENDULUM = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"/><worldbody>
<body><joint name="hinge" type="hinge" axis="0 1 0" damping="0.02" armature="0.005"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.007 0.007 0.0001"/></body></worldbody></mujoco>
"""
#: Share of the cases without a cause.
CLEAN = 0.2


def cases(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Draw cases: number, robot, cause and size."""
    rng = np.random.default_rng(seed)
    names = list(ROBOTS)
    for number in range(count):
        robot = names[number % len(names)]
        causes = [c for c in POSSIBLE[robot] if c != "clean"]
        cause = "clean" if rng.random() < CLEAN else str(rng.choice(causes))
        yield {"number": number, "robot": robot, "cause": cause, "size": float(rng.uniform(0.7, 1.6)),
               "seed": int(rng.integers(2**31))}  # fmt: skip


def diagnosed(case: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Make the recordings of a case, diagnose them, and return the case with the answer."""
    place = folder / f"{case['number']:03d}"
    done = place / "answer.json"
    if not done.exists():
        robot = ROBOTS[case["robot"]]
        trials = write(place, robot, record(robot, case["cause"], case["size"], case["seed"]))
        words = [
            "-m",
            "swimid",
            "diagnose",
            str(trials),
            "-o",
            str(place / "gap.yaml"),
            "--json",
            "--force",
            "--jobs",
            "1",
        ]
        ran = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
        done.write_text(ran.stdout or json.dumps({"error": ran.stderr}))
    answer = json.loads(done.read_text()).get("result", {})
    named = [cause["effect"] for cause in answer.get("causes", [])]
    sets = [named, *([cause["effect"], *cause.get("equivalent", [])] for cause in answer.get("causes", []))]
    return case | {
        "verdict": answer.get("verdict", "error"),
        "named": named,
        "set": sorted({n for s in sets for n in s}),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Return the counts by cause and robot."""
    lines = ["| cause | cases | named first | in the answer | none | verdicts |", "|---|---|---|---|---|---|"]
    for name, effects in CAUSES.items():
        own = [row for row in rows if row["cause"] == name]
        if not own:
            continue
        first = sum(bool(row["named"]) and row["named"][0] in effects for row in own)
        inside = sum(bool(set(row["set"]) & set(effects)) for row in own)
        none = sum(not row["named"] for row in own)
        verdicts = ", ".join(sorted({row["verdict"] for row in own}))
        lines.append(f"| {name} | {len(own)} | {first} | {inside} | {none} | {verdicts} |")
    gaps = [row for row in rows if row["cause"] != "clean"]
    right = sum(bool(set(row["set"]) & set(CAUSES[row["cause"]])) for row in gaps)
    clean = [row for row in rows if row["cause"] == "clean"]
    false = sum(bool(row["named"]) for row in clean)
    said = f"{right} of {len(gaps)} causes are in the answer"
    lines.append(f"\n{said}; a cause is named in {false} of {len(clean)} clean cases")
    return "\n".join(lines)


def covered(count: int, correlation: float, seed: int) -> str:
    """Return how often 95 % intervals of a fit hold the truth, in words.

    The recordings are swings of a pendulum, integrated by SciPy, with noise of first-order correlation.
    """
    rng, inside, total = np.random.default_rng(seed), 0, 0
    time = np.arange(0.0, 4.0, 0.01)
    for _ in range(count):
        logs = []
        for start, rate in ((0.6, 0.0), (0.9, -1.0), (-0.4, 2.0)):
            angle = solve_ivp(
                lambda t, y: [y[1], (-0.981 * np.sin(y[0]) - 0.035 * y[1]) / 0.029],
                (0.0, 4.0), [start, rate], t_eval=time, rtol=1e-9, atol=1e-12,
            ).y[0]  # fmt: skip
            noise = lfilter(
                [np.sqrt(1.0 - correlation**2)], [1.0, -correlation], rng.normal(size=2 * len(time))
            )
            logs.append(
                {"log": pd.DataFrame({"t_s": time, "hinge_rad": angle + 0.003 * noise[-len(time) :]})}
            )
        with TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            path = Path(folder) / "pendulum.xml"
            path.write_text(PENDULUM)
            model = {
                "mjcf": str(path),
                "parameters": {
                    "damping": {"path": "joint/hinge/damping", "bounds": [0.0, 1.0]},
                    "armature": {"path": "joint/hinge/armature", "bounds": [0.0, 0.1]},
                },
                "outputs": {"hinge_rad": "joint/hinge"},
            }
            fit = swimid.fit(swimid.load(logs, experiment="mjcf", model=model))
        for name, truth in (("damping", 0.035), ("armature", 0.002)):
            half = 1.96 * float(fit[name].stderr or np.nan)
            low, high = fit[name].value - half, fit[name].value + half
            inside += low <= truth <= high
            total += 1
    return f"{inside} of {total} intervals hold the truth at a correlation of {correlation:g} between samples"


def main() -> None:
    """Diagnose all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("demo_out/blind_simulators"))
    parser.add_argument("--coverage", type=int, default=0, help="number of fits, in place of diagnoses")
    given = parser.parse_args()
    if given.coverage:
        for correlation in (0.0, 0.8, 0.9):
            print(covered(given.coverage, correlation, given.seed), flush=True)
        return
    given.out.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        rows = []
        for row in pool.map(lambda case: diagnosed(case, given.out), cases(given.cases, given.seed)):
            rows.append(row)
            what = f"{row['number']:3d} {row['robot']:5s} {row['cause']:9s} {row['size']:.2f}"
            print(f"{what} {row['verdict']:11s} {row['named']}", flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
