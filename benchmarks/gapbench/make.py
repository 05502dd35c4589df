"""Cases, each in a folder of its own, and their labels apart from them."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from benchmarks.gapbench import labels, real
from validation.blind import runner


def make(folder: Path, *, cases: int, seed: int, robots: Sequence[str] = ()) -> int:
    """Write a benchmark; what is there of it already is kept. The number of cases.

    Parameters
    ----------
    folder : Path
        Gets ``cases/NNNN/`` for tools to see, ``robots/`` with the files of built-in robots, and, sealed,
        ``labels/NNNN.json`` and ``plan.json``.
    cases : int
        Of the generators; real ones come on top.
    robots : sequence of str
        Only these; then there are no real cases.
    """
    plan = runner.plan(cases, seed, robots=robots)
    if not robots:
        plan += plan_real(cases)
    folder.mkdir(parents=True, exist_ok=True)
    _keep(folder / "plan.json", json.dumps({"seed": seed, "cases": plan}, indent=1) + "\n")
    for case in plan:
        name = f"{case['number']:04d}"
        label = folder / "labels" / f"{name}.json"
        # the label is written last
        if label.exists() and "gap" in json.loads(label.read_text()):
            continue
        if case["kind"] == "real":
            real.write(case, folder / "cases" / name, label, Path(os.environ["SWIMID_DATA"]))
        else:
            runner.make(case, folder, seed)
            raw = json.loads(label.read_text())
            label.write_text(json.dumps({**raw, "gap": labels.gap_of(raw)}, indent=1) + "\n")
        print(f"{name} {case['robot']}", file=sys.stderr, flush=True)
    _robots(folder / "robots")
    return len(plan)


def plan_real(number: int) -> list[dict[str, Any]]:
    data = os.environ.get("SWIMID_DATA")
    if not data:
        print("SWIMID_DATA is unset: the recordings of others are left out", file=sys.stderr)
        return []
    return real.plan(Path(data), number)


def _keep(path: Path, text: str) -> None:
    if path.exists() and path.read_text() != text:
        raise SystemExit(f"{path.parent} holds cases of another plan")
    path.write_text(text)


def _robots(folder: Path) -> None:
    """The files of the built-in robots, for tools that have none of their own."""
    folder.mkdir(exist_ok=True)
    for path in Path(str(resources.files("swimid.robots"))).glob("*.yaml"):
        shutil.copy2(path, folder)
