"""Diagnoses of models of MuJoCo with hidden causes: ``python -m tests.blind_simulators --cases 60``.

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
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from tests.generators.mujoco_robots import CAUSES, POSSIBLE, ROBOTS, record, write

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


def main() -> None:
    """Diagnose all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("demo_out/blind_simulators"))
    given = parser.parse_args()
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
