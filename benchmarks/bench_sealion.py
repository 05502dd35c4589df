"""Speed of the engine in space beside MuJoCo, and of the genetic search beside pymoo's own loop.

::

    python -m benchmarks.bench_sealion [--only engine search] [--generations 50]

Engine times are CPU seconds of the process, the best of several runs taken in turn. MuJoCo gets the sea
lion's links and hinges (links without mass a gram), each link with mass an ellipsoid with its own fluid
forces, and the same steps of its Runge-Kutta method of fourth order: a tree of the same size in water, not
the same equations.

The search is the paper's: 80 points, 50 generations, one trial for each of two strokes, on all processors.
Its peer is ``pymoo.optimize.minimize`` on the same objectives, one point after the other, over a few
generations.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from swimid.fitting.drives import Cycle
from swimid.fitting.global_search import BROKEN_OBJECTIVE, GENERATIONS, POPULATION, nsga2
from swimid.fitting.model import NONE, SwimInput, Trial
from swimid.robots import file as robot
from swimid.swimmer.front import Profiles
from swimid.swimmer.spatial.engine import SPATIAL_ENGINE as engine
from swimid.swimmer.spatial.model import MultibodyModel

try:
    import mujoco
except ImportError:
    mujoco = None

DURATION_S, STEP_S, FRAMES_HZ = 8.7, 0.005, 30.0
STROKES = ("characteristic", "characteristic-pelvis")
REPEATS = 7
#: Generations of the peer, and of the search it is compared with.
FEW = 3


def best(*functions: Callable[[], Any]) -> list[float]:
    """Smallest CPU time of each, s, run in turn."""
    found = [math.inf] * len(functions)
    for _ in range(REPEATS):
        for k, function in enumerate(functions):
            begin = time.process_time()
            function()
            found[k] = min(found[k], time.process_time() - begin)
    return found


def trials(model: MultibodyModel) -> list[Trial]:
    """A side view of each stroke with noise; the truth is the robot file's, moved a little."""
    body = model.robot.multibody
    assert body is not None
    clock = np.arange(round(DURATION_S * FRAMES_HZ) + 1) / FRAMES_HZ
    values = np.array([1.2 * p.start if p.name == "z_drag" else p.start for p in model.parameters])
    rng = np.random.default_rng(1)
    found = []
    for name in STROKES:
        swim = SwimInput(stroke=Cycle(name, body.strokes[name], 1.0 / body.strokes[name].period_s))
        seen = model.simulate(values, Trial(name, "fit", clock, {}, swim=swim))
        noise = {"x_m": 0.002, "z_m": 0.002, "pitch_rad": 0.0035}
        measured = {c: seen[c] + rng.normal(0.0, sd, len(clock)) for c, sd in noise.items()}
        found.append(Trial(name, "fit", clock, measured, swim=swim))
    return found


def mujoco_xml(model: MultibodyModel) -> str:
    """The tree as MuJoCo bodies."""
    body = model.robot.multibody
    assert body is not None
    links = {link.name: link for link in body.links}

    def written(name: str, place: str, hinge: str) -> str:
        link = links[name]
        mass = float(link.mass_kg) or 1e-3
        turning = " ".join(f"{max(float(i), 1e-6):.6g}" for i in link.inertia_kg_m2[:3])
        at = " ".join("0" if isinstance(c, str) else f"{c:g}" for c in link.com_m)
        long = math.sqrt(5.0 * max(float(i) for i in link.inertia_kg_m2[:3]) / mass) if link.mass_kg else 0.0
        text = f'<body {place}>{hinge}<inertial pos="{at}" mass="{mass:g}" diaginertia="{turning}"/>'
        if long:
            text += (
                f'<geom type="ellipsoid" pos="{at}" size="{long:.4g} {0.3 * long:.4g} {0.3 * long:.4g}" '
                'fluidshape="ellipsoid" contype="0" conaffinity="0"/>'
            )
        for joint in (j for j in body.joints if j.parent == name):
            turned = (
                ""
                if joint.driven is None
                else f'<joint axis="{" ".join(map(str, joint.axis))}" damping="1"/>'
            )
            text += written(joint.child, f'pos="{" ".join(map(str, joint.at_m))}"', turned)
        return text + "</body>"

    return (
        f'<mujoco><option timestep="{STEP_S}" integrator="RK4" density="1000" gravity="0 0 0"/>'
        f"<worldbody>{written(body.links[0].name, '', '<freejoint/>')}</worldbody></mujoco>"
    )


def bench_engine(model: MultibodyModel) -> None:
    """Right-hand side and stroke, beside MuJoCo's steps."""
    values = np.array([p.start for p in model.parameters])
    trial = trials(model)[0]
    steps = round(DURATION_S / STEP_S)
    run_asked = model.request(values, trial, NONE)
    table, start = run_asked.drive.table[: 2 * steps + 1], run_asked.start
    tables = model.tree.tables(values[: len(model.coefficients)])

    def run() -> None:
        engine.integrate(start, STEP_S, table, tuple(tables.values()), None, 0.0)

    def whole() -> None:
        model.forget([trial])
        model.simulate(values, trial)

    run()
    whole()
    functions = [run, whole]
    if mujoco is not None:
        theirs = mujoco.MjModel.from_xml_string(mujoco_xml(model))
        data = mujoco.MjData(theirs)

        def peer() -> None:
            mujoco.mj_resetData(theirs, data)
            mujoco.mj_step(theirs, data, steps)

        functions.append(peer)
    found = best(*functions)
    print(
        f"sea lion, {len(model.tree.links)} links, {len(model.driven)} hinges driven, {DURATION_S} s, "
        "5 ms a step"
    )
    print(f"  right-hand side            {1e6 * found[0] / (4 * steps):8.2f} us CPU")
    print(f"  stroke, all of simulate    {1e3 * found[1]:8.2f} ms CPU")
    if len(found) > 2:
        print(f"  MuJoCo, same steps         {1e3 * found[2]:8.2f} ms CPU   ratio {found[1] / found[2]:.2f}")
    else:
        print("  MuJoCo is not installed: no peer")


def bench_search(model: MultibodyModel, generations: int) -> None:
    """The paper's search of both profiles, and a few generations beside pymoo's loop."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import ElementwiseProblem
    from pymoo.optimize import minimize

    both = trials(model)
    jobs = os.cpu_count() or 1
    profiles = Profiles(model, model.parameters, both, {t.id: t.id for t in both}, jobs=jobs)

    def search(count: int) -> float:
        begin = time.perf_counter()
        for name in profiles.names:
            nsga2(
                lambda points, name=name: profiles.evaluate(points, name),  # type: ignore[misc]
                profiles.lower,
                profiles.upper,
                objectives=2,
                generations=count,
            )
        return time.perf_counter() - begin

    class OneByOne(ElementwiseProblem):  # type: ignore[misc]
        def __init__(self, name: str) -> None:
            super().__init__(n_var=len(profiles.lower), n_obj=2, xl=profiles.lower, xu=profiles.upper)
            self.name = name

        def _evaluate(self, x: np.ndarray, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = np.nan_to_num(profiles.evaluate(x[None], self.name)[0], nan=BROKEN_OBJECTIVE)

    def peer(count: int) -> float:
        begin = time.perf_counter()
        for name in profiles.names:
            minimize(OneByOne(name), NSGA2(pop_size=POPULATION), ("n_gen", count), seed=0)
        return time.perf_counter() - begin

    search(1)
    few, theirs = search(FEW), peer(FEW)
    whole = search(generations)
    print(f"search, {POPULATION} x {generations} x {len(profiles.names)} profiles, {jobs} threads")
    print(f"  wall                       {whole:8.1f} s")
    print(f"  pymoo.minimize, {FEW} gen.    {theirs:8.1f} s, here {few:.1f} s   ratio {few / theirs:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=["engine", "search"], default=["engine", "search"])
    parser.add_argument("--generations", type=int, default=GENERATIONS)
    options = parser.parse_args()
    model = MultibodyModel(robot.read("sealion"))
    if "engine" in options.only:
        bench_engine(model)
    if "search" in options.only:
        bench_search(model, options.generations)


if __name__ == "__main__":
    main()
