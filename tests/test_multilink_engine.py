"""The multi-link engine against Lagrange's equations, MuJoCo, conservation laws and closed forms."""

from __future__ import annotations

import importlib.util
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

import swimid
from swimid.fitting import drives
from swimid.fitting.model import SwimInput, Trial
from swimid.robots import file as robot_format
from swimid.robots.file import Fluid, schema_of
from swimid.robots.planar import MultilinkRobot
from swimid.swimmer import engine as shared
from swimid.swimmer import lanes
from swimid.swimmer.planar.engine import PLANAR_ENGINE as engine
from swimid.swimmer.planar.model import MultilinkModel, PlanarTree
from tests import lanes_forms
from tests.generators import lagrange

pytestmark = pytest.mark.kernels

WATER = 1000.0
needs_casadi = pytest.mark.skipif(
    importlib.util.find_spec("casadi") is None, reason="casadi derives the equations of the oracle"
)


def assembly(body: dict[str, Any], **fluid: float) -> PlanarTree:
    return PlanarTree(MultilinkRobot.model_validate(body), Fluid(density_kg_m3=WATER, **fluid))


def defaults(model: PlanarTree) -> np.ndarray:
    return np.array([c.value for c in model.body.coefficients.values()])


def accelerations(model: PlanarTree, state: np.ndarray, motion: np.ndarray | None = None) -> np.ndarray:
    """The engine's acceleration of the base (in its own axes) and of the passive joints.

    ``motion`` holds angle, rate and acceleration of each driven joint. The scratch arrays are full of
    NaN: nothing may depend on what an earlier call has left in them.
    """
    n = model.unknowns
    row = np.zeros((len(model.driven), 5))
    for k, axis in enumerate(model.driven):
        assert motion is not None
        row[k, :3] = motion[k]
        angle = motion[k, 0] + math.radians(axis.joint.mount_deg)
        row[k, 3:] = math.cos(angle), math.sin(angle)
    scratch = [np.full(shape, np.nan) for shape in ((len(model.links), 19), (n, n), (n,), (2 * n,))]
    tables = model.tables(defaults(model))
    engine.compute_rate(state, row, tuple(tables.values()), None, 0.0, *scratch)
    kernel = lanes.Kernel(model)
    traced = lanes_forms.rate(kernel, state, row, tables)
    size = np.abs(scratch[-1]).max()
    assert traced == pytest.approx(scratch[-1], rel=1e-9, abs=1e-11 * size)
    return scratch[-1][n:]


def integrated(
    model: PlanarTree, start: np.ndarray, step: float, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    steps = round(duration / step)
    table = np.zeros((2 * steps + 1, 0, 5))
    tables = tuple(model.tables(defaults(model)).values())
    states, rates = engine.integrate(start, step, table, tables, None, 0.0)
    return states, rates


def in_world(state: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Return the base acceleration in the world; joint accelerations are unchanged."""
    n = len(acceleration)
    c, s = math.cos(state[2]), math.sin(state[2])
    u, v, r = state[n : n + 3]
    a, b = acceleration[0] - r * v, acceleration[1] + r * u
    return np.r_[c * a - s * b, s * a + c * b, acceleration[2:]]


def world_rates(state: np.ndarray) -> np.ndarray:
    n = len(state) // 2
    c, s = math.cos(state[2]), math.sin(state[2])
    return np.r_[c * state[n] - s * state[n + 1], s * state[n] + c * state[n + 1], state[n + 2 :]]


def chain(links: int = 5, *, water: bool = False) -> dict[str, Any]:
    """Return a chain with springs and without losses; ``water`` adds mass off each link's axis."""
    bodies = [
        {
            "name": f"link{i}", "length_m": 0.1, "mass_kg": 0.3 - 0.04 * i, "com_m": 0.045,
            "com_offset_m": 0.004 * (-1) ** i, "inertia_kg_m2": 3e-4, "inertia_about": "com",
        }
        for i in range(links)
    ]  # fmt: skip
    joints = [
        {
            "name": f"joint{i}", "parent": f"link{i - 1}", "child": f"link{i}",
            "passive": {"stiffness_N_m_rad": 0.08, "cubic_N_m_rad3": 0.05},
        }
        for i in range(1, links)
    ]  # fmt: skip
    elements = [
        {
            "kind": "added-mass", "link": f"link{i}", "surge_kg": 0.03, "sway_kg": 0.5, "inertia_kg_m2": 1e-4,
            "at_m": 0.06, "offset_m": 0.01,
        }
        for i in range(links if water else 0)
    ]  # fmt: skip
    return {"plane": "horizontal", "links": bodies, "joints": joints, "elements": elements}


def one_link(*elements: dict[str, Any], plane: str = "horizontal", **link: Any) -> PlanarTree:
    """Return one link of 0.4 m, 2 kg and 0.03 kg m2 with its centre of mass at its front end."""
    body = {
        "name": "body", "length_m": 0.4, "mass_kg": 2.0, "com_m": 0.0, "inertia_kg_m2": 0.03,
        "inertia_about": "com",
    }  # fmt: skip
    return assembly(
        {"plane": plane, "links": [{**body, **link}], "elements": [{"link": "body", **e} for e in elements]}
    )


def wrench(
    model: PlanarTree, u: float = 0.0, v: float = 0.0, r: float = 0.0, heading: float = 0.0
) -> np.ndarray:
    """Return forces along and across the body of :func:`one_link`, and the moment about its front end."""
    u_dot, v_dot, r_dot = accelerations(model, np.array([0.0, 0.0, heading, u, v, r]))
    return np.array([2.0 * (u_dot - r * v), 2.0 * (v_dot + r * u), 0.03 * r_dot])


# ------------------------------------------------------------ Lagrange's equations


@needs_casadi
class TestLagrange:
    @pytest.mark.parametrize("base", ["free", "fixed"])
    def test_random_trees(self, base: str) -> None:
        """Random trees with every element agree with Lagrange's equations to 1e-10."""
        rng = np.random.default_rng(20)
        branched = 0
        for _ in range(30):
            links = int(rng.integers(2, 8))
            yielding = int(rng.integers(base == "fixed", min(links - 1, 3) + 1))
            body = {**lagrange.random_tree(rng, links, yielding), "base": base}
            parents = [j["parent"] for j in body["joints"]]
            branched += len(set(parents)) < len(parents)
            oracle, model = lagrange.Lagrange(body, density=WATER), assembly(body)
            n, driven = model.unknowns, len(model.driven)
            for _ in range(3):
                q, qd, told = (
                    rng.normal(size=n + driven),
                    rng.normal(size=n + driven),
                    rng.normal(size=driven),
                )
                if base == "fixed":
                    q[:3], qd[:3] = 0.0, 0.0
                c, s = math.cos(q[2]), math.sin(q[2])
                state = np.r_[q[:n], c * qd[0] + s * qd[1], c * qd[1] - s * qd[0], qd[2:n]]
                found = accelerations(model, state, np.column_stack([q[n:], qd[n:], told]))
                expected = oracle.acceleration(q, qd, told)
                np.testing.assert_allclose(
                    in_world(state, found), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
                )
        assert branched > 8

    @pytest.mark.parametrize("water", [False, True], ids=["dry", "added mass"])
    def test_momentum_and_energy_are_conserved(self, water: bool) -> None:
        """Energy and impulses drift with the fourth power of the step, and so does the motion.

        The energy of a small oscillation drifts with the fifth: the modulus of Runge-Kutta's growth
        factor departs from one by (omega h)^6 / 144 in a step.
        """
        oracle, model = lagrange.Lagrange(chain(water=water)), assembly(chain(water=water))
        rng = np.random.default_rng(3)
        bent, turning = rng.uniform(-0.3, 0.3, 4), rng.uniform(-1.0, 1.0, 4)
        start = np.r_[0.0, 0.0, 0.3, bent, 0.3, -0.2, 0.5, turning]
        steps = (0.005, 0.0025, 0.00125)
        energies, impulses, motions = [], [], []
        for step in (*steps, 0.0003125):
            states, _ = integrated(model, start, step, 10.0)
            states = states[:: round(0.02 / step)]
            pairs = [oracle.conserved(s[: model.unknowns], world_rates(s)) for s in states]
            energy, impulse = np.array([e for e, _ in pairs]), np.array([p for _, p in pairs])
            energies.append(np.sqrt(np.mean((energy / energy[0] - 1) ** 2)))
            impulses.append(np.abs(impulse - impulse[0]).max() / np.abs(impulse[0]).max())
            motions.append(states)
        errors = [np.abs(m - motions[-1]).max() for m in motions[:3]]
        np.testing.assert_allclose(np.log2(np.divide(impulses[:2], impulses[1:3])), 4.0, atol=0.3)
        np.testing.assert_allclose(np.log2(np.divide(errors[:2], errors[1:])), 4.0, atol=0.3)
        orders = np.log2(np.divide(energies[:2], energies[1:3]))
        assert (orders > 3.7).all()
        assert (orders < 5.3).all()
        assert energies[0] < 2e-6
        assert impulses[0] < 1e-6


# ------------------------------------------------------------ the tendon fish, with everything


def tfish_body() -> dict[str, Any]:
    path = Path(swimid.__file__).parent / "robots" / "tfish.yaml"
    return YAML(typ="safe", pure=True).load(path)["multilink"]


def values_of(model: MultilinkModel) -> np.ndarray:
    """Return start values with the published coefficients."""
    body = model.robot.multilink
    assert body is not None
    published = {name: c.value for name, c in body.coefficients.items()}
    return np.array([published.get(p.name, p.start) for p in model.parameters])


def swim(
    times: np.ndarray,
    step: float = 0.005,
    values: np.ndarray | None = None,
    pose: tuple[float, ...] = (0, 0, 0),
) -> np.ndarray:
    """Return the state of the built-in fish at 1.4 Hz and 30 degrees."""
    model = MultilinkModel(robot_format.read("tfish"), max_step=step)
    beat = drives.TailBeat("sine", 1.4, math.radians(30.0))
    trial = Trial("run", "fit", times, {}, swim=SwimInput(beat, pose=pose))
    found = model.simulate(values_of(model) if values is None else values, trial)
    names = ("x_m", "y_m", "yaw_rad", "joint4_rad", "u_m_s", "v_m_s", "yaw_rate_rad_s", "joint4_rate_rad_s")
    return np.column_stack([found[name] for name in names])


GRID = np.arange(0.0, 20.0 + 1e-9, 0.02)
#: Between the grid points of every step tried.
BETWEEN = GRID[:-1] + 0.00731


@pytest.fixture(scope="module")
def reference() -> tuple[np.ndarray, np.ndarray]:
    """Return 20 s of the fish by Lagrange's equations and DOP853, on the grid and between."""
    pytest.importorskip("casadi", reason="casadi derives the equations of the oracle")

    oracle = lagrange.Lagrange(tfish_body(), density=WATER)
    times = np.sort(np.r_[GRID, BETWEEN])
    states = oracle.swim(lagrange.sine(1.4, math.radians(30.0), 1.0), times, breaks=(1.0,), rtol=1e-12)
    on = np.isin(times, GRID)
    return states[on], states[~on]


def test_velocities_are_the_derivatives_of_the_pose_of_any_reference_point() -> None:
    robot = robot_format.read("tfish").model_copy(deep=True)
    robot.multilink.reference.station_m, robot.multilink.reference.offset_m = 0.15, 0.06
    model, time = MultilinkModel(robot), np.arange(0.0, 2.0, 0.005)
    beat = SwimInput(drives.TailBeat("sine", 1.4, math.radians(30.0)), pose=(0.3, -0.2, 0.7))
    begun = {"initial_surge": 0.2, "initial_sway": -0.1, "initial_yaw_rate": 0.5}
    values = [begun.get(p.name, v) for p, v in zip(model.parameters, values_of(model), strict=True)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = model.simulate(np.array(values), Trial("run", "fit", time, {}, swim=beat))
    path, heading = found["x_m"] + 1j * found["y_m"], found["yaw_rad"]
    assert (path[0], heading[0]) == pytest.approx((0.3 - 0.2j, 0.7))
    first = [found[name][0] for name in ("u_m_s", "v_m_s", "yaw_rate_rad_s")]
    assert first == pytest.approx(list(begun.values()))
    velocity = (found["u_m_s"] + 1j * found["v_m_s"]) * np.exp(1j * heading)
    # central differences: the third derivative times the square of the step over 6
    np.testing.assert_allclose(velocity[1:-1], (path[2:] - path[:-2]) / 0.01, atol=1e-3)
    np.testing.assert_allclose(found["yaw_rate_rad_s"][1:-1], (heading[2:] - heading[:-2]) / 0.01, atol=1e-2)
    assert np.abs(found["yaw_rate_rad_s"]).max() > 0.5


class TestTendonFish:
    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("step", "speed_m_s", "yaw_rate_deg_s", "angle_deg"),
        [
            (0.02, 9e-5, 2e-2, 4e-2),
            (0.01, 6e-6, 2e-3, 3e-3),
            (0.005, 8e-7, 2e-4, 4e-4),
            (0.0025, 2e-7, 2e-5, 5e-5),
            (0.001, 8e-9, 2e-6, 4e-6),
        ],
    )
    def test_error_against_step(
        self, step: float, speed_m_s: float, yaw_rate_deg_s: float, angle_deg: float, reference: Any
    ) -> None:
        """The error is at most twice that of the table in the documentation."""
        error = np.abs(swim(GRID, step) - reference[0]).max(axis=0)
        assert max(error[4], error[5]) < speed_m_s
        assert math.degrees(error[6]) < yaw_rate_deg_s
        assert math.degrees(error[3]) < angle_deg

    def test_uneven_sample_times(self, reference: Any) -> None:
        """Interpolation between steps adds no more than the integration itself has lost.

        The fin's rate, whose drag has a kink at every reversal, is interpolated about as well as it is
        integrated; all else much better.
        """
        model = MultilinkModel(robot_format.read("tfish"))
        trial = Trial(
            "run", "fit", GRID, {}, swim=SwimInput(drives.TailBeat("sine", 1.4, math.radians(30.0)))
        )
        run = model.trajectory(values_of(model), trial)
        found = shared.interpolate_states(BETWEEN, run.grid.begin_s, run.grid.step_s, run.states, run.rates)
        grid_error = np.abs(run.states[:: round(0.02 / run.grid.step_s)] - reference[0]).max(axis=0)
        between_error = np.abs(found - reference[1]).max(axis=0)
        assert (between_error < np.r_[np.full(7, 1.1), 3.0] * grid_error).all()
        # an uneven record, whose samples lie on no grid
        order = np.argsort(np.r_[GRID, BETWEEN])
        uneven = np.abs(swim(np.r_[GRID, BETWEEN][order]) - np.vstack([*reference])[order]).max(axis=0)
        assert (uneven < 3 * grid_error).all()

    def test_start_pose_turns_and_moves_the_run(self) -> None:
        times = np.linspace(0.0, 3.0, 61)
        straight, turned = swim(times), swim(times, pose=(1.0, -2.0, 0.7))
        c, s = math.cos(0.7), math.sin(0.7)
        np.testing.assert_allclose(turned[:, 0], 1.0 + c * straight[:, 0] - s * straight[:, 1], atol=1e-12)
        np.testing.assert_allclose(turned[:, 1], -2.0 + s * straight[:, 0] + c * straight[:, 1], atol=1e-12)
        np.testing.assert_allclose(turned[:, 2], 0.7 + straight[:, 2], atol=1e-12)
        np.testing.assert_allclose(turned[:, 3:], straight[:, 3:], atol=1e-12)

    @pytest.mark.slow
    @needs_casadi
    def test_sensitivities(self) -> None:
        """Finite differences of the engine agree with variations of the independent equations."""
        times = np.linspace(0.0, 4.0, 201)
        model = MultilinkModel(robot_format.read("tfish"))
        names, base = [p.name for p in model.parameters], values_of(model)
        # the flow depends on friction weakly: a wide variation of it is still a straight line
        for name, width in {"c_ma": 1e-3, "c_Ia": 1e-3, "c_d4": 1e-3, "c_f0": 3e-2, "d_p": 1e-3}.items():
            k = names.index(name)
            size = max(abs(base[k]), model.parameters[k].scale)
            sides = []
            for sign in (-1, 1):
                moved = {name: base[k] + sign * width * size}
                oracle = lagrange.Lagrange(tfish_body(), density=WATER, values=moved)
                beat = lagrange.sine(1.4, math.radians(30.0), 1.0)
                sides.append(oracle.swim(beat, times, breaks=(1.0,)))
            variation = (sides[1] - sides[0]) / (2 * width * size)
            values = base.copy()
            values[k] += 1e-6 * size
            for step, tolerance in ((0.005, 2e-3), (0.00125, 2e-4)):
                forward = (swim(times, step, values) - swim(times, step)) / (1e-6 * size)
                assert np.linalg.norm(forward - variation) < tolerance * np.linalg.norm(variation), name


class TestBreakdown:
    def test_an_unstable_run_ends_in_nan(self) -> None:
        body = chain(3)
        for joint in body["joints"]:
            joint["passive"]["stiffness_N_m_rad"] = 1e4
        model = assembly(body)
        start = np.r_[0.0, 0.0, 0.0, 0.1, -0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
        states, rates = integrated(model, start, 0.005, 5.0)
        good = np.isfinite(states).all(axis=1)
        first = int(np.argmin(good))
        assert 0 < first < len(states)
        assert good[:first].all()
        assert np.isnan(states[first:]).all()
        assert np.isnan(rates[first:]).all()
        assert np.abs(states[:first]).max() < shared.MAX_STATE

    def test_a_robot_without_inertia_is_nan(self) -> None:
        """An apparent inertia that is not positive definite gives NaN, not numbers."""
        times = np.linspace(0.0, 1.0, 51)
        model = MultilinkModel(robot_format.read("tfish"))
        values = values_of(model)
        values[0] = -5.0
        assert np.isnan(swim(times, values=values)[:, :3]).any()


# ------------------------------------------------------------ elements against closed forms


class TestElements:
    @pytest.mark.parametrize("chord_deg", [0.0, 30.0, -75.0])
    def test_foil_in_all_quadrants(self, chord_deg: float) -> None:
        """Eq 9 with C_l = cl sin 2a and C_d = cd0 + cd1 (1 - cos 2a); the force opposes the motion."""
        area, cl, cd0, cd1 = 0.01, 1.2, 0.05, 0.9
        foil = one_link(
            {"kind": "foil", "area_m2": area, "at_m": 0.3, "chord_deg": chord_deg, "lift_coefficient": cl,
             "drag_coefficient_0": cd0, "drag_coefficient_1": cd1}
        )  # fmt: skip
        for attack_deg in range(-175, 180, 10):
            attack = math.radians(attack_deg)
            course = attack + math.radians(chord_deg)
            speed = 0.7
            u, v = speed * math.cos(course), speed * math.sin(course)
            fx, fy, moment = wrench(foil, u, v)
            pressure = 0.5 * WATER * area * speed**2
            along = (fx * u + fy * v) / speed
            right = (fx * v - fy * u) / speed
            assert along == pytest.approx(-pressure * (cd0 + cd1 * (1 - math.cos(2 * attack))), rel=1e-12)
            assert right == pytest.approx(pressure * cl * math.sin(2 * attack), rel=1e-9, abs=1e-12)
            assert moment == pytest.approx(-0.3 * fy, rel=1e-12)
            # across the chord the water pushes back, whichever way the fin moves
            c, s = math.cos(math.radians(chord_deg)), math.sin(math.radians(chord_deg))
            assert (fy * c - fx * s) * (v * c - u * s) < 0

    def test_hydrostatics_right_the_body(self) -> None:
        """A centre of mass 12 mm below the centre of buoyancy: -m g d sin(pitch) about the former."""
        body = one_link(
            {"kind": "hydrostatics", "volume_m3": 2.0 / WATER, "buoyancy_at_m": 0.1},
            plane="vertical", com_m=0.1, com_offset_m=-0.012,
        )  # fmt: skip
        for pitch in np.radians([-170.0, -60.0, -5.0, 0.0, 5.0, 60.0, 180.0]):
            acceleration = accelerations(body, np.array([0.0, 0.0, pitch, 0.0, 0.0, 0.0]))
            assert acceleration[2] == pytest.approx(-2.0 * 9.81 * 0.012 * math.sin(pitch) / 0.03, abs=1e-12)

    def test_weight_less_buoyancy(self) -> None:
        body = one_link({"kind": "hydrostatics", "volume_m3": 0.0005}, plane="vertical")
        heading = 0.8
        fx, fy, moment = wrench(body, heading=heading)
        net = 9.81 * (WATER * 0.0005 - 2.0)
        np.testing.assert_allclose(
            [fx, fy, moment], [net * math.sin(heading), net * math.cos(heading), 0.0], atol=1e-12
        )

    def test_slender_body_of_linear_taper(self) -> None:
        """Added mass c rho pi h^2 / 4 with its moments, and drag, integrated by hand."""
        length, h0, h1, p0, p1 = 0.4, 0.12, 0.04, 0.36, 0.13
        c_m, c_f, c_d = 0.3, 0.04, 2.5
        sections = [
            {"station_m": 0.0, "height_m": h0, "perimeter_m": p0},
            {"station_m": length, "height_m": h1, "perimeter_m": p1},
        ]
        element = {
            "kind": "slender-body", "sections": sections, "added_mass_coefficient": c_m,
            "friction_coefficient": c_f, "drag_coefficient": c_d,
        }  # fmt: skip
        slope = (h1 - h0) / length
        # integral of x^k (h0 + slope x)^2 over the length
        moments = [
            h0**2 * length ** (k + 1) / (k + 1)
            + 2 * h0 * slope * length ** (k + 2) / (k + 2)
            + slope**2 * length ** (k + 3) / (k + 3)
            for k in range(3)
        ]
        gain = c_m * WATER * math.pi / 4
        both = one_link(element)
        sideways = one_link({**element, "added_mass_direction": "normal"})
        (inertia,) = both.tables(np.zeros(0))["inertia"]  # type: ignore[misc]
        (normal,) = sideways.tables(np.zeros(0))["inertia"]  # type: ignore[misc]
        expected = [
            2.0 + gain * moments[0],
            0.0,
            0.0,
            2.0 + gain * moments[0],
            -gain * moments[1],
            0.03 + gain * moments[2],
        ]
        np.testing.assert_allclose(inertia, expected, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(normal, [2.0, *expected[1:]], rtol=1e-12, atol=1e-15)
        ahead, across = wrench_of(both, 0.5, 0.0)[0], wrench_of(both, 0.0, -0.4)[1]
        assert ahead == pytest.approx(-0.5 * WATER * c_f * 0.5 * (p0 + p1) * length * 0.5**2, rel=1e-12)
        assert across == pytest.approx(0.5 * WATER * c_d * 0.5 * (h0 + h1) * length * 0.4**2, rel=1e-12)

    def test_strips_of_a_turning_link(self) -> None:
        """About its front end at rate r: moment rho/2 c S r^2 L^2 / 4, force rho/2 c S r^2 L / 3."""
        body = one_link({"kind": "drag", "normal_area_m2": 0.02, "normal_coefficient": 1.5, "strips": 3})
        for r in (2.0, -3.0):
            _, fy, moment = wrench(body, r=r)
            pressure = 0.5 * WATER * 1.5 * 0.02 * abs(r) * r
            assert moment == pytest.approx(-pressure * 0.4**3 / 4, rel=1e-12)
            assert fy == pytest.approx(pressure * 0.4**2 / 3, rel=1e-12)

    def test_drag_on_part_of_a_link(self) -> None:
        body = one_link(
            {
                "kind": "drag",
                "normal_area_m2": 0.02,
                "normal_coefficient": 1.5,
                "from_m": 0.1,
                "to_m": 0.3,
                "strips": 2,
            }
        )
        _, fy, moment = wrench(body, v=0.5)
        assert fy == pytest.approx(-0.5 * WATER * 1.5 * 0.02 * 0.25, rel=1e-12)
        assert moment == pytest.approx(-0.2 * fy, rel=1e-12)

    def test_linear_drag_decays_exponentially(self) -> None:
        body = one_link(
            {"kind": "drag", "strips": 1, "at_m": 0.0, "axial_linear_N_s_m": 1.5, "normal_linear_N_s_m": 3.0}
        )
        states, _ = integrated(body, np.array([0.0, 0.0, 0.0, 0.8, -0.5, 0.0]), 0.005, 2.0)
        assert states[-1, 3] == pytest.approx(0.8 * math.exp(-1.5 * 2.0 / 2.0), rel=1e-10)
        assert states[-1, 4] == pytest.approx(-0.5 * math.exp(-3.0 * 2.0 / 2.0), rel=1e-10)

    def test_damping_of_rotation(self) -> None:
        linear = one_link({"kind": "damping", "linear_N_m_s_rad": 0.02})
        states, _ = integrated(linear, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0]), 0.005, 2.0)
        assert states[-1, 5] == pytest.approx(3.0 * math.exp(-0.02 * 2.0 / 0.03), rel=1e-10)
        quadratic = one_link({"kind": "damping", "quadratic_N_m_s2_rad2": 0.01})
        states, _ = integrated(quadratic, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -3.0]), 0.005, 2.0)
        assert states[-1, 5] == pytest.approx(-3.0 / (1.0 + 3.0 * 0.01 * 2.0 / 0.03), rel=1e-9)

    def test_dry_friction_stops_a_joint(self) -> None:
        """I w' = -f w / sqrt(w^2 + e^2): the time to any rate in closed form, and no turning back."""
        friction, below, moment = 0.02, 0.1, 0.003
        law = {"friction_N_m": friction, "friction_below_rad_s": below}
        rod = {
            "length_m": 0.1, "mass_kg": 0.5, "com_m": 0.0, "inertia_kg_m2": moment, "inertia_about": "com",
        }  # fmt: skip
        model = assembly(
            {"plane": "horizontal", "base": "fixed",
             "links": [{"name": "wall", **rod}, {"name": "rotor", **rod}],
             "joints": [{"name": "hub", "parent": "wall", "child": "rotor", "passive": law}]}
        )  # fmt: skip
        for sign in (1.0, -1.0):
            start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, sign * 3.0])
            rate = sign * integrated(model, start, 0.001, 1.0)[0][:, -1]

            def elapsed(w: Any) -> Any:
                whole = np.sqrt(w**2 + below**2)
                return -moment / friction * (whole + below * np.log(w / (below + whole)))

            times = np.linspace(0.0, 1.0, len(rate))
            np.testing.assert_allclose(elapsed(rate) - elapsed(3.0), times, atol=1e-6)
            assert 0.0 < rate[-1] < below

    def test_constant_forces(self) -> None:
        fixed = one_link({"kind": "force", "at_m": 0.2, "forward_N": 1.5, "port_N": -0.7})
        np.testing.assert_allclose(wrench(fixed, heading=1.1), [1.5, -0.7, 0.14], atol=1e-12)
        world = one_link(
            {
                "kind": "force",
                "at_m": 0.2,
                "offset_m": 0.05,
                "forward_N": 1.5,
                "port_N": -0.7,
                "frame": "world",
            }
        )
        c, s = math.cos(1.1), math.sin(1.1)
        fx, fy = 1.5 * c - 0.7 * s, -0.7 * c - 1.5 * s
        np.testing.assert_allclose(wrench(world, heading=1.1), [fx, fy, -0.2 * fy - 0.05 * fx], atol=1e-12)

    def test_munk_moment(self) -> None:
        """A body with more added mass sideways turns broadside: N = -(m_sway - m_surge) u v."""
        body = one_link({"kind": "added-mass", "surge_kg": 0.2, "sway_kg": 1.7, "at_m": 0.0})
        assert 0.03 * accelerations(body, np.array([0.0, 0.0, 0.0, 0.6, 0.1, 0.0]))[2] == pytest.approx(
            -1.5 * 0.6 * 0.1, rel=1e-12
        )

    def test_tendon_is_the_slope_of_its_energy(self) -> None:
        """Eqs 3 and 4; the small-angle stiffness is K_t d_p l_3 l_cr / (l_3 - l_cr)."""
        spring, pretension, arm, crank = 85.0, 0.03, 0.032, 0.02

        def energy(angle: float) -> float:
            length = math.hypot(arm - crank * math.cos(angle), crank * math.sin(angle))
            return 0.5 * spring * (pretension + length - (arm - crank)) ** 2

        for angle in np.linspace(-2.5, 2.5, 21):
            slope = (energy(angle + 1e-5) - energy(angle - 1e-5)) / 2e-5
            found = shared.tendon_torque(angle, spring, pretension, arm, crank)
            assert found == pytest.approx(-slope, rel=1e-7, abs=1e-9)
        stiffness = -shared.tendon_torque(1e-6, spring, pretension, arm, crank) / 1e-6
        assert stiffness == pytest.approx(spring * pretension * arm * crank / (arm - crank), rel=1e-6)


# ------------------------------------------------------------ trailing edges


#: A slender body of 1 m in 20 links: its mass, added mass per length, and the wave's frequency and speed.
#: (As heavy as the water it carries along it would keep any turn: no force of the edge opposes it.)
JOINTED, MASS_KG, ADDED_KG_M, BEAT_HZ, WAVE_M_S = 20, 1.0, 2.0, 1.0, 0.8


def slender(drag_N_s_m: float) -> MultilinkModel:
    """Return a slender body with lateral added mass and a trailing edge only, and its bending wave."""
    long = 1.0 / JOINTED
    names = [f"s{i}" for i in range(JOINTED)]
    water = {"sway_kg": ADDED_KG_M * long, "inertia_kg_m2": ADDED_KG_M * long**3 / 12}
    body = {
        "plane": "horizontal",
        "links": [
            {"name": n, "length_m": long, "mass_kg": MASS_KG * long, "com_m": 0.5 * long,
             "inertia_kg_m2": MASS_KG * long**3 / 12, "inertia_about": "com"}
            for n in names
        ],
        # the wave's amplitude grows towards the tail
        "joints": [
            {"name": f"j{i}", "parent": names[i - 1], "child": names[i],
             "driven": {"gain": (i * long) ** 2, "phase_lag_deg": 360.0 * BEAT_HZ * i * long / WAVE_M_S}}
            for i in range(1, JOINTED)
        ],
        "elements": [
            *({"kind": "added-mass", "link": n, "at_m": 0.5 * long, **water} for n in names),
            {"kind": "trailing-edge", "link": names[-1], "added_mass_kg_m": ADDED_KG_M},
            {"kind": "drag", "link": names[0], "strips": 1, "at_m": 0.0, "axial_linear_N_s_m": drag_N_s_m},
        ],
    }  # fmt: skip
    document = {"format": "swimid-robot/1", "name": "s", "multilink": body}
    return MultilinkModel(schema_of().model_validate(document))


def undulate(model: MultilinkModel, speed: float, times: np.ndarray) -> dict[str, np.ndarray]:
    """Simulate the wave with joint angles of up to 4 degrees, from a given speed."""
    values = np.array([speed if p.name == "initial_surge" else p.start for p in model.parameters])
    beat = drives.TailBeat("sine", BEAT_HZ, math.radians(4.0))
    return model.simulate(values, Trial("run", "fit", times, {}, swim=SwimInput(beat)))


class TestTrailingEdge:
    def test_force(self) -> None:
        """(m w^2 / 2, -m u w) at the edge, by default the link's rear end; m |u| w^2 / 2 is lost."""
        m = 3.0
        for place, station in (({}, 0.4), ({"at_m": 0.3}, 0.3)):
            edge = one_link({"kind": "trailing-edge", "added_mass_kg_m": m, **place})
            for u, v, r in ((0.7, 0.2, 0.0), (0.5, -0.3, 1.1), (0.0, 0.4, -2.0), (-0.6, 0.3, 0.4)):
                w = v - station * r
                fx, fy, moment = wrench(edge, u, v, r)
                assert fx == pytest.approx(0.5 * m * w**2, rel=1e-12)
                assert fy == pytest.approx(-m * max(u, 0.0) * w, rel=1e-12, abs=1e-15)
                assert moment == pytest.approx(-station * fy, rel=1e-9, abs=1e-15)
                assert fx * u + fy * w == pytest.approx(-0.5 * m * abs(u) * w**2, rel=1e-12, abs=1e-15)

    @needs_casadi
    def test_energy_goes_into_the_wake(self) -> None:
        """The energy of springs goes into motion, drag and the wake (m u w^2 / 2 per time) only."""
        body = chain(4, water=True)
        drag = {"kind": "drag", "link": "link0", "strips": 1, "at_m": 0.0, "axial_linear_N_s_m": 0.1}
        body["elements"] += [drag, {"kind": "trailing-edge", "link": "link3", "added_mass_kg_m": 4.0}]
        oracle, model = lagrange.Lagrange(body), assembly(body)
        n = model.unknowns
        start = np.r_[0.0, 0.0, 0.3, 0.4, -0.3, 0.5, 0.4, 0.1, 0.2, -1.0, 1.0, 2.0]
        step = 0.001
        states, _ = integrated(model, start, step, 4.0)
        energy = np.array([oracle.conserved(s[:n], world_rates(s))[0] for s in states[::10]])
        # velocity of the last link's rear end, by differences of where it is
        heading = states[:, 2, None] + np.c_[np.zeros(len(states)), np.cumsum(states[:, 3:n], axis=1)]
        rear = states[:, :2] - 0.1 * np.stack([np.cos(heading), np.sin(heading)]).sum(axis=2).T
        velocity = np.gradient(rear, step, axis=0, edge_order=2)
        c, s = np.cos(heading[:, -1]), np.sin(heading[:, -1])
        u, w = c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]
        wake, lost = 0.5 * 4.0 * np.abs(u) * w**2, 0.1 * states[:, n] ** 2
        spent = np.r_[0.0, np.cumsum(0.5 * step * ((wake + lost)[1:] + (wake + lost)[:-1]))][::10]
        assert np.sum(wake) * step > 0.3 * (energy[0] - energy[-1])
        # differences and sums err by a few (omega h)^2 of what is spent, omega up to 20 rad/s
        np.testing.assert_allclose(energy + spent, energy[0], atol=1e-4 * energy[0])

    @pytest.mark.parametrize("drag", [0.0, 0.05, 0.2])
    def test_thrust_of_a_travelling_wave(self, drag: float) -> None:
        """Lighthill 1960: mean thrust m (h_t^2 - U^2 h_x^2) / 2 from the tail's motion.

        It is the drag and what gains speed; the theory is of second order in the tail's slope, which
        is 0.18 at most.
        """
        model = slender(drag)
        times = np.arange(0.0, 40.0, 0.01)
        run = undulate(model, 0.4, times)
        frames = model.body.frames(np.array([p.start for p in model.parameters]), run)
        x, y = (ends[-1] for ends in model.body.rear_ends(frames))
        # the last ten beats
        late, last = slice(-1000, None), len(times) - 1
        way = np.array([x[last] - x[last - 1000], y[last] - y[last - 1000]])
        speed, course = np.hypot(*way) / 10.0, math.atan2(way[1], way[0])
        aside = (math.cos(course) * np.gradient(y, 0.01) - math.sin(course) * np.gradient(x, 0.01))[late]
        slope = (frames[2][-1] - course)[late]
        largest = 0.5 * ADDED_KG_M * np.mean(aside**2)
        thrust = largest - 0.5 * ADDED_KG_M * speed**2 * np.mean(slope**2)
        u = run["u_m_s"]
        found = np.mean(drag * u[late]) + MASS_KG * (u[-100:].mean() - u[-1000:-900].mean()) / 9.0
        assert 0.1 < np.abs(slope).max() < 0.2
        assert found == pytest.approx(thrust, abs=0.5 * np.abs(slope).max() ** 2 * largest)
        assert 0.0 < speed < WAVE_M_S

    def test_thrust_changes_sign_when_the_body_is_faster_than_the_wave(self) -> None:
        """Without drag, a body at rest gains speed, and a body faster than its wave loses speed."""
        times = np.arange(0.0, 10.0 + 1e-9, 0.01)
        for speed, sign in ((0.0, 1.0), (0.5, 1.0), (1.6, -1.0)):
            u = undulate(slender(0.0), speed, times)["u_m_s"]
            assert sign * (np.mean(u[-100:]) - np.mean(u[:100])) > 0.0, speed


def wrench_of(model: PlanarTree, u: float, v: float) -> np.ndarray:
    """Return the force on a single link with added mass, at a velocity without rotation."""
    a, b, c, d, e, f = model.tables(defaults(model))["inertia"][0]  # type: ignore[index]
    matrix = np.array([[a, b, c], [b, d, e], [c, e, f]])
    momentum = matrix @ [u, v, 0.0]
    turning = np.array([0.0, 0.0, u * momentum[1] - v * momentum[0]])
    return matrix @ accelerations(model, np.array([0.0, 0.0, 0.0, u, v, 0.0])) + turning


def test_double_pendulum() -> None:
    """Two equal rods on a wall swing at omega^2 = (3 -+ 6 / sqrt 7) g / l, one mode at a time."""
    length, mass, gravity = 0.3, 0.5, 9.81
    rod = {
        "length_m": length,
        "mass_kg": mass,
        "com_m": 0.15,
        "inertia_kg_m2": mass * length**2 / 12,
        "inertia_about": "com",
    }
    body = {
        "plane": "vertical", "base": "fixed", "heading_deg": 90.0,
        "links": [{**rod, "name": "wall"}, {**rod, "name": "upper"}, {**rod, "name": "lower"}],
        "joints": [
            {"name": "hinge", "parent": "wall", "child": "upper", "at_m": 0.0, "passive": {}},
            {"name": "knee", "parent": "upper", "child": "lower", "passive": {}},
        ],
        "elements": [{"kind": "hydrostatics", "link": n} for n in ("wall", "upper", "lower")],
    }  # fmt: skip
    robot = schema_of().model_validate({"format": "swimid-robot/1", "name": "pendulum", "multilink": body})
    model = MultilinkModel(robot, max_step=0.0025)
    at = {p.name: i for i, p in enumerate(model.parameters)}
    times = np.linspace(0.0, 10.0, 2001)
    for sign in (-1, 1):
        omega = math.sqrt((3 + sign * 6 / math.sqrt(7)) * gravity / length)
        # the lower rod's angle in the world for an upper one of 1, from the equation of the hinge
        lower = (3 / 2 * gravity / length - 4 / 3 * omega**2) / (omega**2 / 2)
        bend = 1e-4 * np.array([1.0, lower - 1.0])
        values = np.array([p.start for p in model.parameters])
        values[at["initial_angle_hinge"]], values[at["initial_angle_knee"]] = bend
        found = model.simulate(values, Trial(f"mode {sign}", "fit", times, {}))
        angles = np.column_stack([found["joint1_rad"], found["joint2_rad"]])
        np.testing.assert_allclose(
            angles, np.outer(np.cos(omega * times), bend), atol=3e-5 * np.abs(bend).max()
        )
