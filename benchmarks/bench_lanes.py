"""Runs of one robot side by side against the scalar engine, alone and in the commands that run many.

::

    python -m benchmarks.bench_lanes [--only engine effects compile commands]

Engine: CPU seconds of 20 s at 5 ms a step, the smallest of several taken in turn, kernels compiled before;
one run alone and eight at once, each with its own coefficients, packing included.
``benchmarks/bench_multilink.py`` and ``bench_sealion.py`` set the scalar engine beside MuJoCo and SciPy.

Effects: CPU seconds of 16 such runs of the tendon fish at unlike coefficients, as a refit asks for them, with
each effect of the catalogue and a smooth force; on the scalar engine, and as it runs with kernels compiled.

Compile: the first start with nothing on disk and the next one, each in a process of its own.

Commands: CPU seconds of each command in a process of its own, with ``SWIMID_LANES=never`` and with the kernel
on disk, in turn; trials of 20 s by the independent simulator of the tests.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_diagnose import settings
from swimid.diagnosis.remainder import ResidualForce
from swimid.effects import catalogue
from swimid.fitting.drives import Cycle, TailBeat
from swimid.fitting.model import NONE, SwimInput, Trial
from swimid.robots import file as robot
from swimid.swimmer.lanes import Kernel
from swimid.swimmer.model import Swimmer
from swimid.swimmer.planar.model import MultilinkModel
from swimid.swimmer.spatial.model import MultibodyModel
from tests.generators import gap_trials
from validation.blind import swim_actuation

DURATION_S, REPEATS, LANES = 20.0, 7, 8
BATCH = 16
SEED = 1


def best(*functions: Callable[[], Any]) -> list[float]:
    """Smallest CPU time of each, s, run in turn."""
    least = [math.inf] * len(functions)
    for _ in range(REPEATS):
        for k, function in enumerate(functions):
            begin = time.process_time()
            function()
            least[k] = min(least[k], time.process_time() - begin)
    return least


def model_of(name: str) -> tuple[Swimmer, Trial]:
    """A built-in robot and a swim of it."""
    known = robot.read(name)
    clock = np.arange(0.0, DURATION_S + 1e-9, 0.02)
    if known.multibody is None:
        swim = SwimInput(TailBeat("sine", 1.4, math.radians(30.0)))
        return MultilinkModel(known), Trial(name, "fit", clock, {}, swim=swim)
    stroke = next(iter(known.multibody.strokes.values()))
    return MultibodyModel(known), Trial(
        name, "fit", clock, {}, swim=SwimInput(stroke=Cycle("stroke", stroke, 1.0 / stroke.period_s))
    )


def kernels_of(name: str) -> Swimmer:
    """A built-in robot with its kernels, not compiled."""
    catalogue.list_effects()
    return model_of(name)[0]


def together(kernel: Kernel, runs: Sequence[Any]) -> Any:
    """Runs at once."""
    return list(kernel.run([(r.start, r.grid.step_s, r.drive.table, r.tables) for r in runs]))


def operations_in(kernel: Kernel, run: Any) -> float:
    """Traced operations that a run takes: four evaluations a step."""
    return 4.0 * (len(run.drive.table) // 2) * len(kernel.equations.operations)


def bench_engine() -> None:
    """One run and eight, scalar and in lanes."""
    print(
        f"{DURATION_S:g} s at 5 ms a step, ms CPU a run{'scalar':>12}{'one run':>10}{'ratio':>7}"
        f"{'of eight':>10}{'ratio':>7}{'operations':>12}{'scalar, ns each':>17}"
    )
    for name in ("tfish", "dolphin", "sealion"):
        model, trial = model_of(name)
        given = np.array([model.get_file_values().get(p.name, p.start) for p in model.parameters])
        runs = [model.request(given * (1.0 + 1e-3 * k), trial, NONE) for k in range(LANES)]
        kernel = Kernel(model.tree)
        kernel.compile_module()
        model.integrate(runs[0])

        scalar, one, eight = best(
            partial(model.integrate, runs[0]),
            *(partial(together, kernel, runs[:count]) for count in (1, LANES)),
        )
        print(
            f"  {name:<38}{1e3 * scalar:>11.2f}{1e3 * one:>10.2f}{scalar / one:>7.1f}"
            f"{1e3 * eight / LANES:>10.2f}{LANES * scalar / eight:>7.1f}"
            f"{len(kernel.equations.operations):>12}{1e9 * scalar / operations_in(kernel, runs[0]):>17.2f}"
        )


def bench_effects() -> None:
    """A batch of runs with each effect, scalar and as they run."""
    lanes, trial = model_of("tfish")
    scalar, _ = model_of("tfish")
    assert isinstance(lanes, MultilinkModel)
    given = np.array([lanes.get_file_values().get(p.name, p.start) for p in lanes.parameters])
    swims = [replace(trial, id=f"swim {k}", measured=scalar.simulate(given, trial)) for k in range(2)]
    effects = [*catalogue.list_effects(), ResidualForce("surge", 0.05, 0.3)]
    scalar.kernels.used = False
    lanes.prepare(effects=True)
    print(
        f"{BATCH} runs of {DURATION_S:g} s, ms CPU{'scalar':>26}{'as it runs':>12}"
        f"{'ratio':>8}{'off lanes':>11}"
    )
    for effect in [None, *effects]:
        forms = [] if effect is None else list(catalogue.forms(effect, lanes, swims))
        if effect is not None and not forms:
            continue
        chosen = forms[:1]
        own = [p for form in chosen for p in form.parameters(lanes, swims)]
        point = np.array([np.clip(p.start + 0.3 * p.scale, p.lower, p.upper) for p in own])
        runs = [(np.concatenate([given * (1.0 + 1e-6 * k), point]), swims[k % 2]) for k in range(BATCH)]
        models = [model.with_effects(chosen, swims) for model in (scalar, lanes)]
        off = sum(
            lanes.kernels.choose(
                lanes.request(values[: len(given)], swim, models[1].hooks(values, swim)), lanes.frame
            )
            is None
            for values, swim in runs
        )

        def fresh(model: Any, runs: Any = runs) -> None:
            model.forget(swims)
            model.run_many(runs)

        slow, fast = best(*(partial(fresh, model) for model in models))
        name = "none" if effect is None else effect.name
        print(f"  {name:<38}{1e3 * slow:>9.0f}{1e3 * fast:>12.0f}{slow / fast:>8.1f}{off:>11}", flush=True)


def child(words: Sequence[str], folder: Path, **environment: str) -> tuple[float, float]:
    """Wall and CPU seconds of a process."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        words, cwd=folder, check=True, env={**os.environ, **environment}, stdout=subprocess.DEVNULL
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def bench_compile() -> None:
    """Cold and warm start of a kernel."""
    print("a kernel's start, s CPU             cold    warm   cold, ms an operation")
    for name, kind in (
        *((name, "own") for name in ("tfish", "dolphin", "sealion")),
        *((name, "wide") for name in ("tfish", "dolphin")),
    ):
        with tempfile.TemporaryDirectory() as cache:
            code = (
                f"from benchmarks.bench_lanes import kernels_of\nk = kernels_of({name!r})\n"
                f"{{}}k.kernels.{kind}.compile_module()"
            )
            # the second of them: importing has compiled what it needs
            _, alone = (
                child([sys.executable, "-c", code.format("0 and ")], Path.cwd(), NUMBA_CACHE_DIR=cache)[1]
                for _ in range(2)
            )
            cold, warm = (
                child([sys.executable, "-c", code.format("")], Path.cwd(), NUMBA_CACHE_DIR=cache)[1] - alone
                for _ in range(2)
            )
        operations = len(getattr(kernels_of(name).kernels, kind).equations.operations)
        words = f"{name}, with effects" if kind == "wide" else name
        print(f"  {words:<32}{cold:>6.1f}{warm:>8.2f}{1e3 * cold / operations:>12.1f}")


def bench_commands(count: int = 6) -> None:
    """Whole commands on six trials of 20 s, and a fit of one."""
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        play = swim_actuation.servo_backlash(rng, 2.0, "tfish")
        for part, effects, trials in (("one", [], 1), ("fit", [], count), ("gap", [play], count)):
            (folder / part).mkdir()
            own = settings(trials)
            gap_trials.write(folder / part, "tfish", effects, settings=own, duration_s=DURATION_S, seed=SEED)
        start = [sys.executable, "-m", "swimid"]
        commands = {
            "fit-graybox, one trial": ["fit-graybox", "one/trials.yaml", "-o", "one.yaml", "-q", "--force"],
            "fit-graybox": ["fit-graybox", "fit/trials.yaml", "-o", "fit.yaml", "-q", "--force"],
            "fit-graybox --method nsga2, 10 generations": [
                "fit-graybox", "fit/trials.yaml", "--method", "nsga2", "--generations", "10", "-q",
            ],
            "sensitivity, Sobol, 64 rows": [
                "sensitivity", "fit/trials.yaml", "--params", "fit/params.yaml", "--samples", "64", "-q",
            ],
            "diagnose": ["diagnose", "gap/trials.yaml", "--params", "gap/params.yaml", "-q"],
        }  # fmt: skip
        print(f"{count} trials of {DURATION_S:g} s, s CPU (wall){'scalar':>22}{'lanes':>16}{'ratio':>8}")
        model, _ = model_of("tfish")
        Kernel(model.tree).compile_module()
        for what, words in commands.items():
            command = [*start, *words]
            scalar, lanes = (child(command, folder, SWIMID_LANES=mode) for mode in ("never", ""))
            print(
                f"  {what:<44}{scalar[1]:>8.1f} ({scalar[0]:.1f}){lanes[1]:>9.1f} ({lanes[0]:.1f})"
                f"{scalar[1] / lanes[1]:>8.2f}",
                flush=True,
            )


PARTS = {
    "engine": bench_engine,
    "effects": bench_effects,
    "compile": bench_compile,
    "commands": bench_commands,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=tuple(PARTS))
    only = parser.parse_args().only or PARTS
    for part in only:
        PARTS[part]()


if __name__ == "__main__":
    main()
