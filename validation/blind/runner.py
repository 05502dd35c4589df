"""Plans blind cases, makes them, and has the command line diagnose each in a folder of its own.

The labels never lie where a command runs: a case is copied to a temporary folder, the commands run there
with a clean environment, and only what they wrote comes back.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind import noise_free
from validation.blind.common import ODD, PARAMETER

#: Modules of generators, each with CATALOGUE, OUTSIDE and make_case.
GENERATORS = ("rigs", "cruises", "swimmers")
#: Share of the cases; a family's robots divide its share evenly unless they have their own.
SHARES = {"falling-weight": 0.21, "free-decay": 0.04, "cruise": 0.15, "tfish": 0.35, "dolphin": 0.25}
#: Kinds of cases. A plan numbers its cases of a changed parameter from `CHANGED_FROM` on, and those with an
#: odd trial from `ODD_FROM` on.
KINDS = {"clean": 0.12, "single": 0.60, "pair": 0.13, "outside": 0.15}
CHANGED_FROM, ODD_FROM = 5000, 7000
#: Share of the cases of a changed parameter.
CHANGED_SHARES = {"falling-weight": 0.2, "free-decay": 0.1, "tfish": 0.4, "dolphin": 0.3}
#: Share of the cases with an odd trial.
ODD_SHARES = {"falling-weight": 0.5, "tfish": 0.3, "dolphin": 0.2}
#: Smallest and largest relative change of a parameter.
CHANGE = (0.08, 0.25)
#: A cause that makes a swim unstable is drawn so much smaller, so often at most.
SMALLER, UNSTABLE = 0.7, 6
FITS = {
    "falling-weight": "fit-drag",
    "towed": "fit-drag",
    "free-decay": "fit-drag",
    "cruise": "fit-propulsion",
    "free-swim": "fit-graybox",
    "multibody": "fit-graybox",
}
#: Effects outside the catalogue of which a robot file asks: there the answer is another reading of it.
READINGS = {"spread-drag": "reading:drag_point=strips"}
#: Exit status of a command that has written a result and does not trust it.
UNTRUSTED = 4
PROGRAM = (sys.executable, "-m", "swimid")


def generators() -> dict[str, Any]:
    """Module that makes the cases of each robot, of the generators that are there."""
    found = {}
    for name in GENERATORS:
        try:
            module = import_module(f"validation.blind.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"validation.blind.{name}":
                raise
            print(f"validation/blind/{name}.py is not there; its robots are left out", file=sys.stderr)
            continue
        found.update(dict.fromkeys(module.CATALOGUE, module))
    return found


def counts(total: int, shares: dict[str, float]) -> dict[str, int]:
    """Whole numbers of the given shares that add up to the total (largest remainders)."""
    whole = sum(shares.values())
    exact = {name: total * share / whole for name, share in shares.items()}
    number = {name: int(value) for name, value in exact.items()}
    by_rest = sorted(exact, key=lambda name: number[name] - exact[name])
    for name in by_rest[: total - sum(number.values())]:
        number[name] += 1
    return number


def plan(
    total: int, seed: int, *, robots: Sequence[str] = (), effects: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """The cases of a run: number, robot, kind, effects and size of each.

    With ``effects`` only single cases of these are made.
    """
    modules = generators()
    unknown = set(robots) - set(modules)
    if unknown:
        raise SystemExit(f"no generator for {', '.join(sorted(unknown))}; there are {', '.join(modules)}")
    shares = {name: SHARES.get(name, 0.05) for name in modules if not robots or name in robots}
    if effects:
        shares = {r: s for r, s in shares.items() if set(effects) & set(modules[r].CATALOGUE[r])}
        if not shares:
            raise SystemExit(f"no robot has the effects {', '.join(effects)}")
    rng = np.random.default_rng([seed, 0])
    cases = []
    for robot, number in counts(total, shares).items():
        catalogue = [e for e in modules[robot].CATALOGUE[robot] if not effects or e in effects]
        outside = list(modules[robot].OUTSIDE[robot])
        singles = itertools.cycle(rng.permutation(catalogue).tolist())
        others = itertools.cycle(rng.permutation(outside).tolist())
        kinds = {"single": 1.0} if effects else KINDS
        for kind, many in counts(number, kinds).items():
            for _ in range(many):
                if kind == "pair":
                    chosen = rng.choice(catalogue, 2, replace=False).tolist()
                else:
                    chosen = {"clean": [], "single": [singles], "outside": [others]}[kind]
                    chosen = [next(names) for names in chosen]
                low = 0.7 if kind in ("outside", "pair") else 0.3
                size = float(np.exp(rng.uniform(np.log(low), np.log(4.0)))) if chosen else 0.0
                cases.append({"robot": robot, "kind": kind, "effects": chosen, "size": round(size, 4)})
    order = rng.permutation(len(cases))
    return [{"number": i, **cases[int(k)]} for i, k in enumerate(order)]


def plan_changed(total: int, seed: int, *, robots: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the plan of cases in which a parameter differs from the parameter file.

    The size of a case is the relative change of the parameter. The cases depend neither on the number of the
    other cases of a run nor change they them.
    """
    shares = {name: share for name, share in CHANGED_SHARES.items() if not robots or name in robots}
    rng = np.random.default_rng([seed, 2])
    cases = []
    for robot, number in counts(total, shares).items():
        names = itertools.cycle(rng.permutation(generators()[robot].CHANGED[robot]).tolist())
        for _ in range(number):
            change = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(*np.log(CHANGE))))
            truth = [f"{PARAMETER}{next(names)}"]
            cases.append({"robot": robot, "kind": "changed", "effects": truth, "size": round(change, 4)})
    order = rng.permutation(len(cases))
    return [{"number": CHANGED_FROM + i, **cases[int(k)]} for i, k in enumerate(order)]


def plan_odd(total: int, seed: int, *, robots: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return the plan of cases in which one trial has something of its own, half of them beside an effect."""
    shares = {name: share for name, share in ODD_SHARES.items() if not robots or name in robots}
    rng = np.random.default_rng([seed, 3])
    cases = []
    for robot, number in counts(total, shares).items():
        module = generators()[robot]
        alone = itertools.cycle(rng.permutation(module.ODD_TRIALS[robot]).tolist())
        causes = itertools.cycle(rng.permutation(list(module.CATALOGUE[robot])).tolist())
        for i in range(number):
            truth = [next(alone)] if i % 2 else [next(causes), next(alone)]
            size = round(float(np.exp(rng.uniform(0.0, np.log(3.0)))), 4)
            cases.append({"robot": robot, "kind": "odd", "effects": truth, "size": size})
    order = rng.permutation(len(cases))
    return [{"number": ODD_FROM + i, **cases[int(k)]} for i, k in enumerate(order)]


def separated(label: dict[str, Any], place: str = "") -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What of a label JSON can hold, and its arrays by the place where they were."""
    arrays: dict[str, np.ndarray] = {}
    rest: dict[str, Any] = {}
    for key, value in label.items():
        path = f"{place}{key}"
        if isinstance(value, np.ndarray):
            arrays[path] = value
        elif isinstance(value, dict):
            kept, inner = separated(value, f"{path}/")
            arrays |= inner
            rest |= {key: kept} if kept else {}
        else:
            value = value.item() if isinstance(value, np.generic) else value
            if _plain(value):
                rest[key] = value
    return rest, arrays


def label_of(path: Path) -> dict[str, Any]:
    """A case's label, with the reading that would be the answer as its effect."""
    label: dict[str, Any] = json.loads(path.read_text())
    label["effects"] = [name for name in label["effects"] if not name.startswith(ODD)]
    if set(label["effects"]) & READINGS.keys():
        label["effects"] = [READINGS.get(name, name) for name in label["effects"]]
        label["kind"] = "single" if len(label["effects"]) == 1 else "pair"
    return label


def _plain(value: Any) -> bool:
    """Whether JSON can hold it: what else a generator's label has serves the generator itself."""
    if isinstance(value, list | tuple):
        return all(_plain(v) for v in value)
    return value is None or isinstance(value, str | int | float | bool)


def make(case: dict[str, Any], out: Path, seed: int) -> Path:
    """Write a case's folder and, apart from it, its label; a cause that upsets a swim is drawn smaller."""
    for smaller in range(UNSTABLE):
        try:
            return _made({**case, "size": case["size"] * SMALLER**smaller}, out, seed)
        except FloatingPointError as error:
            unstable = error
    raise unstable


def _made(case: dict[str, Any], out: Path, seed: int) -> Path:
    name = f"{case['number']:04d}"
    folder, labels = out / "cases" / name, out / "labels"
    shutil.rmtree(folder, ignore_errors=True)
    labels.mkdir(parents=True, exist_ok=True)
    effects = case["effects"]
    label = generators()[case["robot"]].make_case(
        folder,
        robot=case["robot"],
        effect=None if not effects else effects[0] if len(effects) == 1 else tuple(effects),
        size=case["size"],
        rng=np.random.default_rng([seed, 1, case["number"]]),
    )
    noise_free.write(folder, labels / name, label.pop("noise_free", {}))
    rest, arrays = separated({**label, **_left_by_refit(label)})
    np.savez_compressed(labels / f"{name}.npz", **arrays)  # type: ignore[arg-type]
    # what was asked for says what is true; the generator adds what it knows of it
    (labels / f"{name}.json").write_text(json.dumps({**rest, **case}, indent=1) + "\n")
    return folder


def _left_by_refit(label: dict[str, Any]) -> dict[str, Any]:
    """What a refit of the nominal model leaves over the noise, of a generator that does not say so itself."""
    if "noncentrality" in label or not np.isfinite(label["gap_over_floor"]["overall"]):
        return {}
    from validation.blind.swim_gap import floors, refit_gap

    found = refit_gap(label)
    # no refit takes up samples of a marker that fails
    broken = any(act.broken is not None for act in label["acts"])
    left = label["gap_over_floor"] if broken else found["refit_over_floor"]
    singles = found.get("singles", {})
    return {
        "noncentrality": found["noncentrality"],
        "gap_refit": left,
        "floor": floors(label),
        "singles": singles,
    }


def commands(folder: Path) -> list[list[str]]:
    """What is run on a case: a fit where no parameter file is given, then the diagnosis."""
    prior = folder / "params_prior.yaml"
    steps = []
    if not prior.exists():
        lines = (folder / "trials.yaml").read_text().splitlines()
        experiment = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("experiment:"))
        steps.append([FITS[experiment], "trials.yaml", "-o", "params.yaml", "--no-progress"])
        if experiment == "cruise":
            steps[-1] += ["--drag", "drag.yaml"]
    params = prior.name if prior.exists() else "params.yaml"
    # The runner has a thread for each core.
    more = ["--jobs", "1", "--no-progress"]
    steps.append(["diagnose", "trials.yaml", "--params", params, "-o", "gap.yaml", *more])
    return steps


def diagnose(
    folder: Path,
    results: Path,
    *,
    program: Sequence[str] = PROGRAM,
    timeout_s: float = 900.0,
    search: Path | None = None,
) -> dict[str, Any]:
    """Run a case's commands in a copy of its folder; exit statuses, times and messages.

    What the commands wrote comes into ``results``, with result.json. Python looks for packages in ``search``
    first, where it is given: the program may be that of another checkout.
    """
    record: dict[str, Any] = {"steps": [], "ended": False}
    with tempfile.TemporaryDirectory(prefix="trials_") as temporary:
        work = Path(temporary) / "run"
        shutil.copytree(folder, work)
        given = {path.name for path in work.iterdir()}
        environment = noise_free.environment(temporary, search)
        for command in commands(work):
            begun = time.perf_counter()
            try:
                done = subprocess.run(
                    [*program, *command],
                    cwd=work,
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=timeout_s,
                    check=False,
                )
                status, said = done.returncode, done.stderr
            except subprocess.TimeoutExpired:
                status, said = "timeout", ""
            step = {"command": command, "status": status, "wall_s": round(time.perf_counter() - begun, 2)}
            record["steps"].append({**step, "stderr": said[-3000:]})
            wrote = (work / command[command.index("-o") + 1]).exists()
            if status != 0 and not (status == UNTRUSTED and wrote):
                break
        else:
            record["ended"] = True
        shutil.rmtree(results, ignore_errors=True)
        results.mkdir(parents=True)
        for path in work.iterdir():
            if path.name not in given and path.is_file():
                shutil.copy2(path, results)
    (results / "result.json").write_text(json.dumps(record, indent=1) + "\n")
    return record


def run(
    cases: Sequence[dict[str, Any]],
    out: Path,
    seed: int,
    *,
    jobs: int = 2,
    keep: bool = False,
    program: Sequence[str] = PROGRAM,
    timeout_s: float = 900.0,
    search: Path | None = None,
    relabel: bool = False,
) -> None:
    """Make and diagnose the cases that have no result yet, in ``jobs`` threads.

    With ``relabel`` the labels of the other cases, and the errors against their noise-free motions, are
    written anew. See :func:`diagnose` for ``search``.
    """
    begun = time.perf_counter()

    def one(case: dict[str, Any]) -> str:
        name = f"{case['number']:04d}"
        results = out / "results" / name
        is_done = (results / "result.json").exists()
        if is_done and not relabel:
            return ""
        folder = make(case, out, seed)
        if is_done:
            record = json.loads((results / "result.json").read_text())
        else:
            record = diagnose(folder, results, program=program, timeout_s=timeout_s, search=search)
        noise_free.compare(out / "labels" / name, results, program=program, search=search)
        if not keep:
            shutil.rmtree(folder)
        told = " + ".join(case["effects"]) or "clean"
        last = record["steps"][-1]
        took = sum(step["wall_s"] for step in record["steps"])
        state = "" if record["ended"] else f"  {last['command'][0]} ended with {last['status']}"
        return f"{name} {case['robot']:15} {told:34} {took:6.1f} s{state}"

    with ThreadPoolExecutor(jobs) as pool:
        for future in as_completed([pool.submit(one, case) for case in cases]):
            if future.result():
                print(f"{time.perf_counter() - begun:6.0f} s  {future.result()}", flush=True)


def arguments(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line of ``python -m validation.blind``."""
    parser = argparse.ArgumentParser(prog="python -m validation.blind", description=__doc__)
    parser.add_argument("--cases", type=int, default=160, help="how many")
    parser.add_argument("--changed", type=int, default=0, help="how many more with a changed parameter")
    parser.add_argument("--odd", type=int, default=0, help="how many more with an odd trial")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", nargs="+", default=[], help="only these")
    parser.add_argument("--effects", nargs="+", default=[], help="only single cases of these")
    parser.add_argument("--only", nargs="+", type=int, default=[], help="only the cases of these numbers")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--timeout", type=float, default=900.0, help="per command, s")
    parser.add_argument("--search", type=Path, help="folder with another version of the program")
    parser.add_argument("--out", type=Path, required=True, help="folder; a run there is taken up again")
    parser.add_argument("--keep", action="store_true", help="keep the case folders")
    parser.add_argument("--relabel", action="store_true", help="write the labels of finished cases anew")
    parser.add_argument("--plan", action="store_true", help="print the cases of the plan and run nothing")
    parser.add_argument("--score", action="store_true", help="score what is there, run nothing")
    parser.add_argument(
        "--compare", type=Path, metavar="OUT", help="folder of the same cases to compare the score with"
    )
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None, *, program: Sequence[str] = PROGRAM) -> None:
    """Plan, run and score."""
    from validation.blind import score

    chosen = arguments(argv)
    out: Path = chosen.out.resolve()
    if not chosen.score:
        cases = plan(chosen.cases, chosen.seed, robots=chosen.robots, effects=chosen.effects)
        cases += plan_changed(chosen.changed, chosen.seed, robots=chosen.robots)
        cases += plan_odd(chosen.odd, chosen.seed, robots=chosen.robots)
        text = json.dumps({"seed": chosen.seed, "cases": cases}, indent=1) + "\n"
        if chosen.plan:
            print(text, end="")
            return
        out.mkdir(parents=True, exist_ok=True)
        kept = out / "plan.json"
        if kept.exists() and kept.read_text() != text:
            raise SystemExit(f"{out} holds a run of another plan")
        kept.write_text(text)
        picked = [c for c in cases if not chosen.only or c["number"] in chosen.only]
        run(
            picked,
            out,
            chosen.seed,
            jobs=chosen.jobs,
            keep=chosen.keep,
            program=program,
            timeout_s=chosen.timeout,
            search=chosen.search and chosen.search.resolve(),
            relabel=chosen.relabel,
        )
    print(score.write(out, chosen.compare))
