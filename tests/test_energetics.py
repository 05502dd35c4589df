"""Joint torques against Lagrange's equations, and derived quantities."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable

import numpy as np
import pytest

from swimid.fitting.drives import TailBeat
from swimid.fitting.model import SwimInput, Trial
from swimid.kinematics.cycles import settling_time
from swimid.robots import file as robot_format
from swimid.robots.file import Fluid
from swimid.robots.joints import Yielding
from swimid.robots.planar import MultilinkRobot
from swimid.swimmer.model import Energetics, Swimmer
from swimid.swimmer.planar.engine import PLANAR_ENGINE as engine
from swimid.swimmer.planar.model import MultilinkModel, PlanarTree
from swimid.swimmer.spatial.engine import SPATIAL_ENGINE as space_engine
from swimid.swimmer.spatial.model import MultibodyModel
from tests.conftest import Ran
from tests.generators import lagrange
from tests.lifted import LiftedModel

WATER = 1000.0
needs_casadi = pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="casadi is missing")


def values_of(model: Swimmer) -> np.ndarray:
    stated = model.get_file_values()
    return np.array([stated.get(p.name, p.start) for p in model.parameters])


def swum(model: Swimmer, swim: SwimInput, duration_s: float, last_s: float) -> Energetics:
    time = np.arange(round(duration_s * 100) + 1) / 100
    trial = Trial("run", "fit", time, {}, swim=swim)
    columns, found = model.with_energetics([(values_of(model), trial)], [last_s])[0]
    assert found is not None
    simulated = model.simulate(values_of(model), trial)
    assert all(np.array_equal(columns[name], simulated[name]) for name in simulated)
    return found


@needs_casadi
@pytest.mark.parametrize("base", [pytest.param("free", marks=pytest.mark.slow), "fixed"])
def test_torques_of_random_trees(base: str) -> None:
    """Trees with every element agree with the driven rows of Lagrange's equations to 1e-10."""
    rng, compared = np.random.default_rng(5), 0
    for _ in range(20):
        links = int(rng.integers(3, 8))
        yielding = int(rng.integers(base == "fixed", min(links - 2, 3) + 1))
        body = {**lagrange.random_tree(rng, links, yielding), "base": base}
        tree = PlanarTree(MultilinkRobot.model_validate(body), Fluid(density_kg_m3=WATER))
        oracle, tables = lagrange.Lagrange(body, density=WATER), tree.tables(np.zeros(0))
        n, driven = tree.unknowns, len(tree.driven)
        compared += driven
        q, qd, told = (rng.normal(size=size) for size in (n + driven, n + driven, driven))
        if base == "fixed":
            q[:3], qd[:3] = 0.0, 0.0
        c, s = math.cos(q[2]), math.sin(q[2])
        state = np.r_[q[:n], c * qd[0] + s * qd[1], c * qd[1] - s * qd[0], qd[2:n]]
        mounts = np.radians([a.joint.mount_deg for a in tree.driven])
        row = np.column_stack([q[n:], qd[n:], told, np.cos(q[n:] + mounts), np.sin(q[n:] + mounts)])
        rate, scratch = np.empty(2 * n), tuple(np.zeros(shape) for shape in engine.shapes(tables)[1])
        engine.compute_rate(state, row, tuple(tables.values()), None, 0.0, *scratch, rate)
        expected = oracle.torque(q, qd, np.r_[oracle.acceleration(q, qd, told), told])
        torque, _ = engine.compute_torques(
            state[None], rate[None], row[None], tuple(tables.values()), None, 0.0, 0.0
        )
        found = torque[0, [a.link for a in tree.driven]]
        size = np.abs(torque).max()
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * size)
        if base == "free":
            assert abs(torque[0, 0]) < 1e-10 * size
    assert compared > 20


def test_both_engines_give_the_same_torques() -> None:
    swim = SwimInput(TailBeat("sine", 1.4, 0.5))
    flat, space = (swum(f(robot_format.read("tfish")), swim, 5.0, 1.0) for f in (MultilinkModel, LiftedModel))
    assert space.torque_N_m == pytest.approx(flat.torque_N_m, abs=1e-9)


@pytest.mark.slow
def test_torques_in_space_follow_the_laws_of_passive_hinges() -> None:
    """Inverse dynamics of the sea lion with a sprung hinge gives back the torque of its spring."""
    robot = robot_format.read("sealion")
    assert robot.multibody is not None
    joints = [j.model_copy() for j in robot.multibody.joints]
    law = Yielding(stiffness_N_m_rad=2.0, damping_N_m_s_rad=0.3)
    joints[-1] = joints[-1].model_copy(update={"driven": None, "passive": law})
    body = robot.multibody.model_copy(update={"joints": joints, "strokes": {}})
    model = MultibodyModel(robot.model_copy(update={"multibody": body}))
    tables = model.tree.tables(np.array(list(model.get_file_values().values())))
    rng, size = np.random.default_rng(3), 13 + 2 * len(model.passive)
    state, row = rng.normal(size=size), rng.normal(size=(len(model.driven), 5))
    row[:, 3], row[:, 4] = np.cos(row[:, 0]), np.sin(row[:, 0])
    rate = np.empty(size)
    scratch = tuple(np.zeros(shape) for shape in space_engine.shapes(tables)[1])
    space_engine.compute_rate(state, row, tuple(tables.values()), None, 0.0, *scratch, rate)
    torque, _ = space_engine.compute_torques(
        state[None], rate[None], row[None], tuple(tables.values()), None, 0.0, 0.0
    )
    (axis,) = model.passive
    expected = -2.0 * state[7] - 0.3 * state[-1]
    assert torque[0, axis.link] == pytest.approx(expected, abs=1e-9 * np.abs(torque).max())


def test_a_run_that_diverges_has_no_energetics() -> None:
    model = MultilinkModel(robot_format.read("tfish"))
    values = values_of(model)
    values[model.index("c_d4")] = -1e6
    trial = Trial("run", "fit", np.arange(101) / 20, {}, swim=SwimInput(TailBeat("sine", 2.0, 0.5)))
    columns, found = model.with_energetics([(values, trial)], [1.0])[0]
    assert found is None
    assert np.isnan(columns["u_m_s"]).all()


def test_settling_time_of_a_first_order_rise() -> None:
    """``1 - exp(-t / tau)`` is within 5 % at ``tau log 20``. A signal that still rises has not settled."""
    time = np.arange(64 * 60 + 1) / 64.0
    rise = 1.0 - np.exp(-time / 5.0)
    found = settling_time(time, rise, 1.0)
    assert found == pytest.approx(5.0 * math.log(20.0), abs=0.1)
    assert math.isnan(settling_time(time[:640], time[:640], 1.0))


def test_simulate_tells_power_and_cost_of_transport(swimid: Callable[..., Ran]) -> None:
    args = ("--frequency-hz", "2.5", "--amplitude-deg", "27", "--duration-s", "15", "--json")
    found = swimid("simulate", "--robot", "dolphin", *args).json["result"]["runs"][0]["quantities"]
    positive, speed = found["mean_positive_power_W"]["value"], found["mean_speed_m_s"]["value"]
    assert found["cost_of_transport_J_m"]["value"] == pytest.approx(positive / speed)
    assert positive >= found["mean_power_W"]["value"] > 0
    assert found["peak_joint_rate_rad_s"]["value"] == pytest.approx(
        math.radians(27) * 2 * math.pi * 2.5, rel=1e-3
    )
