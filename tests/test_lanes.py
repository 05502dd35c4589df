"""Batches of runs against the scalar engines: every element, held bases, different lengths, effects."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from swimid.effects import catalogue as effect_catalogue
from swimid.fitting import drives
from swimid.fitting.model import SwimInput, Trial, share
from swimid.fitting.problem import Problem
from swimid.robots import file as robot_format
from swimid.robots.file import Fluid
from swimid.robots.planar import MultilinkRobot
from swimid.robots.spatial import MultibodyRobot
from swimid.swimmer import lanes
from swimid.swimmer.lanes import Kernel
from swimid.swimmer.model import Swimmer
from swimid.swimmer.planar.engine import PLANAR_ENGINE as planar_engine
from swimid.swimmer.planar.model import MultilinkModel, PlanarTree
from swimid.swimmer.spatial.engine import SPATIAL_ENGINE as spatial_engine
from swimid.swimmer.spatial.model import MultibodyModel, SpatialTree
from tests import lanes_forms
from tests.conftest import ROOT
from tests.generators import gap_trials, lagrange
from validation.blind import swim_actuation

ENGINES: dict[type[Swimmer], ModuleType] = {MultilinkModel: planar_engine, MultibodyModel: spatial_engine}


def drive_of(rng: np.random.Generator, joints: int, steps: int, step: float) -> np.ndarray:
    """Return a smooth table of driven joints on the half-step grid."""
    time = 0.5 * step * np.arange(2 * steps + 1)
    table = np.empty((len(time), joints, 5))
    for k in range(joints):
        size, omega, phase = rng.uniform(0.1, 0.6), rng.uniform(3.0, 12.0), rng.uniform(0.0, 6.0)
        angle = size * np.sin(omega * time + phase)
        table[:, k, 0], table[:, k, 2] = angle, -(omega**2) * angle
        table[:, k, 1] = size * omega * np.cos(omega * time + phase)
        table[:, k, 3], table[:, k, 4] = np.cos(angle), np.sin(angle)
    return table


def scalar(form: type[Swimmer], start: np.ndarray, step: float, drive: np.ndarray, tables: Any) -> Any:
    """Return states and rates of a run by the scalar engine."""
    return ENGINES[form].integrate(start, step, drive, tuple(tables.values()), None, 0.0)


def planar_tree(seed: int, **changed: Any) -> PlanarTree:
    rng = np.random.default_rng(seed)
    body = lagrange.random_tree(rng, int(rng.integers(3, 6)), int(rng.integers(1, 4)))
    return PlanarTree(MultilinkRobot.model_validate({**body, **changed}), Fluid(density_kg_m3=1000.0))


def sea_lion() -> SpatialTree:
    robot = robot_format.read("sealion")
    assert robot.multibody is not None
    return SpatialTree(robot.multibody, robot.fluid)


def hinged(**changed: Any) -> SpatialTree:
    """Return a weight with two passive fins, and every kind of element."""
    inertia = [0.02, 0.03, 0.03, 0.0, 0.001, 0.0]
    fins = [
        {
            "kind": "foil", "link": f"fin{k}", "area_m2": 0.01, "lift_coefficient": 1.2,
            "drag_coefficient_0": 0.1, "drag_coefficient_1": 0.9, "at_m": [-0.05, 0.02, 0.0],
        }
        for k in range(2)
    ]  # fmt: skip
    body = {
        "links": [
            {"name": n, "mass_kg": m, "com_m": c, "inertia_kg_m2": [m * i for i in inertia]}
            for n, m, c in (("body", 2.0, [0.0, 0.0, -0.01]), ("fin0", 0.3, [-0.04, 0.0, 0.0]),
                            ("fin1", 0.2, [-0.03, 0.0, 0.01]))
        ],
        "joints": [
            {
                "name": f"hinge{k}", "parent": "body", "child": f"fin{k}",
                "at_m": [-0.1, 0.1 * (-1) ** k, 0.0], "axis": [0.1, 1.0, 0.2 * k],
                "passive": {"stiffness_N_m_rad": 0.5, "damping_N_m_s_rad": 0.01},
            }
            for k in range(2)
        ],
        "elements": [
            {"kind": "hydrostatics", "link": "body", "volume_m3": 0.0021},
            {"kind": "added-mass", "link": "body", "mass_kg": [0.2, 0.9, 1.1],
             "inertia_kg_m2": [0.01, 0.02, 0.02]},
            {"kind": "damping", "link": "body", "quadratic_N_m_s2_rad2": [0.01, 0.02, 0.03]},
            *fins,
        ],
        **changed,
    }  # fmt: skip
    return SpatialTree(MultibodyRobot.model_validate(body), Fluid(density_kg_m3=1000.0))


CASES: dict[str, tuple[type[Swimmer], Any]] = {
    **{f"planar tree {seed}": (MultilinkModel, lambda seed=seed: planar_tree(seed)) for seed in range(4)},
    "planar tree, held": (MultilinkModel, lambda: planar_tree(7, base="fixed")),
    "sea lion": (MultibodyModel, sea_lion),
    "weight with fins": (MultibodyModel, lambda: hinged()),
    "weight with fins, held": (MultibodyModel, lambda: hinged(base="fixed")),
}


def spread(form: type[Swimmer], tree: Any, kernel: Kernel, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    """Return runs that differ in start, step, length, drive and coefficients."""
    given = np.array([c.value for c in tree.body.coefficients.values()])
    runs = []
    for k in range(11):
        start = np.zeros(kernel.size)
        start[-3:] = rng.normal(0.0, 0.2, 3)
        if form is MultibodyModel:
            start[3:7] = 1.0, 0.1 * k, 0.0, 0.02
            start[3:7] /= np.linalg.norm(start[3:7])
        step, steps = 0.002 + 0.0005 * (k % 3), 20 + 3 * k
        values = given * rng.uniform(0.9, 1.1, len(given))
        runs.append((start, step, drive_of(rng, len(tree.driven), steps, step), tree.tables(values)))
    return runs


#: Names of the cases. Those that take long run behind ``make check-all``.
NAMED = [pytest.param(name, marks=[pytest.mark.slow] * (name == "sea lion")) for name in CASES]


@pytest.mark.parametrize("name", NAMED)
def test_the_uncompiled_module_agrees_with_the_engine(name: str, rng: np.random.Generator) -> None:
    """The generated module, run as Python, moves every robot like the scalar engine."""
    form, make = CASES[name]
    tree = make()
    kernel = Kernel(tree)
    kernel.module = lanes_forms.uncompiled(kernel)
    runs = spread(form, tree, kernel, rng)[:3]
    runs = [(start, step, drive[:9], tables) for start, step, drive, tables in runs]
    compare(form, kernel, runs)


def compare(form: type[Swimmer], kernel: Kernel, runs: list[tuple[Any, ...]]) -> None:
    assert all(kernel.fits(tables) for *_, tables in runs)
    found = {k: (states.copy(), rates.copy()) for k, (states, rates) in kernel.run(runs)}
    assert sorted(found) == list(range(len(runs)))
    for k, (states, rates) in found.items():
        run = runs[k]
        expected, slopes = scalar(form, *run)
        assert states.shape == expected.shape
        np.testing.assert_array_equal(np.isnan(states), np.isnan(expected))
        # rounding grows along a run, as fast as the motion itself is sensitive
        size = np.nanmax(np.abs(expected), axis=0) + 1e-3
        assert np.nanmax(np.abs(states - expected) / size) < 1e-10
        assert np.nanmax(np.abs(rates - slopes) / (np.nanmax(np.abs(slopes), axis=0) + 1e-3)) < 1e-9


@pytest.fixture(scope="module")
def fish() -> Swimmer:
    """Return the tendon fish with a compiled kernel."""
    model = MultilinkModel(robot_format.read("tfish"))
    model.kernels.used = True
    model.prepare()
    return model


@pytest.mark.kernels
def test_a_run_that_diverges_does_not_change_the_others(
    fish: MultilinkModel, rng: np.random.Generator
) -> None:
    runs = spread(MultilinkModel, fish.tree, fish.kernels.own, rng)
    start, step, drive, tables = runs[2]
    runs[2] = (start, step, drive, {**tables, "drag": -2e3 * tables["drag"] - 1e3 * (tables["drag"] != 0)})
    broken = scalar(MultilinkModel, *runs[2])[0]
    assert np.isnan(broken).any()
    assert not np.isnan(broken[0]).any()
    compare(MultilinkModel, fish.kernels.own, runs)


@pytest.mark.slow
@pytest.mark.kernels
def test_a_batch_of_a_robot_in_space_agrees_with_the_engine(rng: np.random.Generator) -> None:
    tree = sea_lion()
    kernel = Kernel(tree)
    compare(MultibodyModel, kernel, spread(MultibodyModel, tree, kernel, rng))


def trials(count: int = 3) -> list[Trial]:
    swims = [SwimInput(drives.TailBeat("sine", 1.0 + 0.2 * k, 0.3, 0.05 * k)) for k in range(count)]
    return [
        Trial(f"run{k}", "fit", np.arange(0.0, 2.0 + 0.3 * k, 0.02), {}, swim=s) for k, s in enumerate(swims)
    ]


def test_many_runs_agree_with_single_runs(fish: MultilinkModel) -> None:
    """Repeats, trials and values are mixed, and effects of every stage act."""
    plain = MultilinkModel(robot_format.read("tfish"))
    names = {e.name: e for e in effect_catalogue.list_effects()}
    own = trials()
    start = np.array([fish.get_file_values().get(p.name, p.start) for p in fish.parameters])
    for chosen in (
        (),
        ("tether",),
        ("servo-lag", "marker-offset"),
        ("linear-drag",),
        ("current",),
        ("added-mass",),
        ("clock-rate", "slip"),
        ("stribeck", "hardening"),
        ("load-friction", "lift-damping"),
    ):
        effects = [names[n] for n in chosen]
        one, many = plain.with_effects(effects, own), fish.with_effects(effects, own)
        added = one.parameters[len(plain.parameters) :]
        scale = np.array([p.scale for p in added])
        null = np.array([p.start for p in added])
        upper = np.array([p.upper for p in added])
        acting = np.minimum(null + 0.3 * scale, upper)
        runs = [(np.r_[start * (1 + 0.01 * k), acting if k % 2 else null], own[k % 3]) for k in range(8)]
        runs += runs[:2]
        for (values, trial), simulated in zip(runs, many.run_many(runs), strict=True):
            for channel, series in one.run(values, trial).items():
                np.testing.assert_allclose(simulated[channel], series, rtol=0, atol=1e-9, err_msg=f"{chosen}")


def test_a_single_run_takes_the_kernel_too(fish: MultilinkModel) -> None:
    """A simulation does not depend on the other runs of its batch."""
    own = trials()
    start = np.array([fish.get_file_values().get(p.name, p.start) for p in fish.parameters])
    runs = [(start * (1 + 0.01 * k), own[k % 3]) for k in range(8)]
    together = fish.run_many(runs)
    for values, trial in runs:
        fish.forget([trial])
        alone = fish.simulate(values, trial)
        expected = together.pop(0)
        for channel, series in alone.items():
            np.testing.assert_array_equal(series, expected[channel])


def test_a_run_that_cannot_be_simulated_is_nan_among_others(fish: MultilinkModel) -> None:
    class Failing(MultilinkModel):
        def request(self, values: Any, trial: Any, hooks: Any) -> Any:
            if trial.id == "run1":
                raise FloatingPointError("no drive")
            return super().request(values, trial, hooks)

    for side_by_side in (False, True):
        model = Failing(robot_format.read("tfish"))
        model.kernels.own, model.kernels.used = fish.kernels.own, side_by_side
        start = np.array([fish.get_file_values().get(p.name, p.start) for p in fish.parameters])
        seen = model.run_many([(start, t) for t in trials()])
        assert [bool(np.isfinite(s["x_m"]).all()) for s in seen] == [True, False, True]


def test_derivatives_with_shared_coefficients_agree_with_the_engine(fish: MultilinkModel) -> None:
    """The derivatives of a fit with shared coefficients are those of the scalar engine."""
    plain = MultilinkModel(robot_format.read("tfish"))
    groups = {"c_f": ("c_f0", "c_f4")}
    rng = np.random.default_rng(2)
    measured = [replace(t, measured={"x_m": rng.normal(size=len(t.time_s))}) for t in trials()]
    slopes = []
    for model in (plain, fish):
        problem = Problem(model, share(model.parameters, groups), measured, jobs=2)
        problem._typical_s = 1.0
        slopes.append(np.concatenate(problem.trial_jacobians(problem.start)))
    # trajectories agree to 1e-14; forward differences divide by a step of 1e-6 of each number
    sizes = np.maximum(np.abs(problem.start), problem.scale)
    assert np.max(np.abs(slopes[1] - slopes[0]) * sizes) < 4e-8


def test_a_cached_run_outlives_later_batches(fish: MultilinkModel) -> None:
    """The offset of the start pose needs no new simulation. The cached one must be unchanged."""
    own = trials()
    start = np.array([fish.get_file_values().get(p.name, p.start) for p in fish.parameters])
    fish.forget(own)
    before = fish.simulate(start, own[0])
    fish.run_many([(start * (1 + 0.01 * k), own[1 + k % 2]) for k in range(24)])
    start[fish.index("start_x")] += 0.1
    after = fish.simulate(start, own[0])
    np.testing.assert_allclose(after["x_m"], before["x_m"] + 0.1, rtol=0, atol=1e-12)


def test_tables_with_filled_zeros_do_not_fit_the_kernel(fish: MultilinkModel) -> None:
    start = np.array([fish.get_file_values()[name] for name in fish.coefficients])
    tables = fish.tree.tables(start)
    assert fish.kernels.own.fits(tables)
    nought = np.argwhere((tables["drag"] == 0.0) & ~np.isnan(fish.kernels.own.fixed["drag"]))[0]
    filled = tables["drag"].copy()
    filled[tuple(nought)] = 0.1
    assert not fish.kernels.own.fits({**tables, "drag": filled})
    assert not fish.kernels.own.fits({**tables, "drag": tables["drag"][:-1]})
    assert not fish.kernels.own.fits({**tables, "drag_link": tables["drag_link"][::-1].copy()})


@pytest.mark.parametrize(("mode", "together"), [("never", 1), ("", lanes.LANES)])
def test_the_environment_alone_chooses_the_engine(
    mode: str, together: int, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The choice depends neither on the compiled modules on disk nor on the work ahead."""
    monkeypatch.setenv("SWIMID_LANES", mode)
    monkeypatch.setattr(lanes, "folder", lambda: tmp_path)
    model = MultilinkModel(robot_format.read("tfish"))
    assert model.batch_size == together
    if mode == "never":
        model.prepare(effects=True)
        assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_diagnosis_with_an_empty_cache_folder_gives_the_same_bytes_as_the_next_one(tmp_path: Path) -> None:
    """Both runs have the same engine, whether or not they compile it."""
    play = swim_actuation.servo_backlash(np.random.default_rng(1), 2.0, "tfish")
    swims = ((1.0, 20.0, 0.0), (1.4, 25.0, 5.0))
    gap_trials.write(tmp_path, "tfish", [play], settings=swims, duration_s=2.0, seed=1)
    given = {k: v for k, v in os.environ.items() if k != "SWIMID_LANES"}
    given |= {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "SOURCE_DATE_EPOCH": "1700000000"}
    given["PYTHONPATH"] = str(ROOT)
    words = ["diagnose", "trials.yaml", "--params", "params.yaml", "--effects", "servo-backlash"]
    files = []
    for _ in range(2):
        run_it = [sys.executable, "-m", "swimid", *words, "-o", "gap.yaml", "--force", "-q"]
        subprocess.run(run_it, cwd=tmp_path, env=given, check=True)
        files.append([(tmp_path / name).read_bytes() for name in ("gap.yaml", "gap.evidence.json")])
    assert files[0] == files[1]
    assert list((tmp_path / "cache").rglob("lanes_*.nbc"))


def test_the_compiled_module_is_kept_on_disk(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiled module is on disk, so that no later process compiles it."""
    monkeypatch.setattr(lanes, "folder", lambda: tmp_path)
    text = (
        "import numba\nSIGNATURE = 'f8(f8)'\n@numba.njit(cache=True)\ndef integrate(x):\n    return 2.0 * x\n"
    )
    assert not lanes.on_disk(text)
    module = lanes.load_module(text)
    module.integrate.compile(module.SIGNATURE)
    assert lanes.on_disk(text)
    assert module.integrate(2.0) == 4.0
