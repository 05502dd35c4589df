"""Speed of the multi-link engine, beside MuJoCo, SciPy's integrators, and the fits built on them.

::

    python -m benchmarks.bench_multilink [--only engine mujoco scipy fit] [--full]

Times are CPU seconds of the process, the best of several runs; those that go into a ratio are
taken in turn. The robot is the tendon fish: five links, three driven joints, one passive.

MuJoCo gets the same links: its bodies carry the apparent masses and inertias (the fish's added
mass is isotropic, so this is exact), the passive joint the tendon's stiffness at zero, and each
link an ellipsoid of the same two projected areas with MuJoCo's own fluid forces, coefficients
chosen so that it swims about as fast. The driven joints follow the same angles either by position
servos, or by an armature so large that the joint's acceleration is the command's, along the cubic
spline through the command: the second makes MuJoCo's Runge-Kutta of fourth order. Its fluid
forces are not ours, so each engine's error is taken against its own converged solution, and
engines are compared at equal error.

``solve_ivp`` integrates the same equations as the engine, written with NumPy; the two are checked
against each other.

The fits estimate the eight coefficients of Table III from six runs with noise. SciPy's peer fits
the same trials; what it takes in all is extrapolated from one Jacobian of it, and from the
iterations the same optimiser needs on the engine, unless ``--full`` runs it to its end.
``mujoco.sysid`` cannot express the engine's equations: it estimates eight parameters of the same
meaning (factors of masses and of inertias, blunt and slender drag) from runs of its own model.
Needs ``mujoco``, and for the last ``mujoco[sysid]``.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import math
import os
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from swimid.fitting import drives, fit_common, output_error
from swimid.fitting.model import Parameter, SwimInput, Trial
from swimid.robots import file as robot
from swimid.swimmer import drive
from swimid.swimmer.engine import tendon_torque
from swimid.swimmer.fit_graybox import fit_graybox
from swimid.swimmer.options import STEP_S
from swimid.swimmer.planar.engine import PLANAR_ENGINE as engine
from swimid.swimmer.planar.model import MultilinkModel
from tests.generators import swimmer

try:
    import mujoco
    from mujoco import rollout
except ImportError:
    mujoco = None

DURATION_S = 20.0
TIME = np.linspace(0.0, DURATION_S, 1001)
BEAT = drives.TailBeat("sine", 1.4, math.radians(30.0))
#: Errors, relative to each channel's range, at which engines are compared; and that of the default step.
LEVELS = (1e-3, 1e-4, 1e-5)
#: Runs are compared ten times a second.
COMPARED_S = 0.1
COMPARED = round(DURATION_S / COMPARED_S)
#: Steps per compared interval that are tried, coarse to fine.
CUTS = (
    4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20, 25, 30, 40, 50, 64, 80, 100, 130, 160, 200, 250, 320, 400, 500,
)  # fmt: skip
#: Those of the default step, and of the converged solutions.
DEFAULT_CUT = round(COMPARED_S / STEP_S)
FINE = {"engine": 320, "servo": 2000, "prescribed": 1000}
#: Six beats and the noise of the fit, m/s and rad/s.
BEATS = ((0.7, 20), (1.0, 20), (1.0, 30), (1.4, 20), (1.4, 30), (1.8, 30))
SEED = 11
NOISE = {"u_m_s": 0.01, "yaw_rate_rad_s": math.radians(1.0)}

Pair = tuple[np.ndarray, np.ndarray]


def cpu(function: Callable[[], Any], repeats: int = 5) -> tuple[float, Any]:
    """Smallest CPU time of some calls, s, and the last result."""
    best, result = math.inf, None
    for _ in range(repeats):
        begin = time.process_time()
        result = function()
        best = min(best, time.process_time() - begin)
    return best, result


def values_of(model: MultilinkModel) -> np.ndarray:
    """The robot file's coefficients, everything else at its start."""
    assert model.robot.multilink is not None
    known = model.robot.multilink.coefficients
    return np.array([known[p.name].value if p.name in known else p.start for p in model.parameters])


def distance(found: Pair, reference: Pair) -> float:
    """Largest difference of surge or yaw rate over the run, relative to the channel's range."""
    return max(
        float(np.max(np.abs(a - b)) / np.ptp(b)) if np.isfinite(a).all() else math.inf
        for a, b in zip(found, reference, strict=True)
    )


# ------------------------------------------------------------------------------------- engine


class Engine:
    """The compiled engine on one robot and beat, with nothing around it."""

    name = "swimid"

    def __init__(self, name: str = "tfish", **readings: str) -> None:
        self.model = MultilinkModel(robot.read(name, readings=readings))
        self.values = values_of(self.model)
        self.assembly = self.model.tree
        self.coefficients = self.values[: len(self.assembly.names)]

    def inputs(self, cut: int) -> tuple[float, np.ndarray]:
        """Step and the driven joints' table; a fit computes it once per trial."""
        step = COMPARED_S / cut
        half = 0.5 * step * np.arange(2 * cut * COMPARED + 1)
        gains = [a.joint.driven.gain for a in self.assembly.driven]
        motions = [BEAT.motion(half, gain=gain) for gain in gains]
        return step, drive.drive_table(len(half), motions, [0.0] * len(motions))

    def runner(self, cut: int) -> Callable[[], Pair]:
        """Tables of the coefficients, and the run."""
        step, table = self.inputs(cut)
        n = self.assembly.unknowns

        def run() -> Pair:
            arguments = tuple(self.assembly.tables(self.coefficients).values())
            states, _ = engine.integrate(np.zeros(2 * n), step, table, arguments, None, 0.0)
            return states[::cut, n], states[::cut, n + 2]

        return run


# ------------------------------------------------------------------------------------- MuJoCo

#: Makes a driven joint's acceleration the commanded one, kg m2.
ARMATURE = 1e8
#: Blunt and slender drag, angular drag, Kutta lift and Magnus lift of its ellipsoids.
FLUID = "0.1 0.01 0 1.5 0"


def mujoco_xml(plant: Engine, *, prescribed: bool, integrator: str, step_s: float) -> str:
    """The plant's links as MuJoCo bodies in a plane."""
    joint, inertia, passive = list(plant.assembly.tables(plant.coefficients).values())[1:4]
    body, density = plant.model.robot.multilink, plant.model.robot.fluid.density_kg_m3
    assert body is not None
    areas = {
        e.link: (float(e.axial_area_m2), float(e.normal_area_m2)) for e in body.elements if e.kind == "drag"
    }
    stiffness = -tendon_torque(1e-6, *passive[0, 5:9]) / 1e-6
    driven = {axis.link: k for k, axis in enumerate(plant.assembly.driven)}
    opened, actuators = [], []
    for i, link in enumerate(plant.assembly.links):
        mass, behind = inertia[i, 0], -inertia[i, 4] / inertia[i, 0]
        turning = inertia[i, 5] - mass * behind**2
        long = 0.5 * link.length_m
        front, side = areas[link.name]
        high = side / (math.pi * long)
        wide = front / (math.pi * high)
        if i == 0:
            hinges = (
                '<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint axis="0 0 1"/>'
            )
        elif i in driven:
            armature = f' armature="{ARMATURE}"' if prescribed else ""
            hinges = f'<joint name="j{i}" axis="0 0 1"{armature}/>'
            actuators.append(
                f'<general joint="j{i}" dyntype="integrator" gainprm="{ARMATURE}"/>'
                if prescribed
                else f'<position joint="j{i}" kp="20" dampratio="1"/>'
            )
        else:
            hinges = f'<joint axis="0 0 1" stiffness="{stiffness:.17g}"/>'
        opened.append(
            f'<body pos="{joint[i, 0]:.17g} 0 0">{hinges}'
            f'<inertial pos="{-behind:.17g} 0 0" mass="{mass:.17g}" '
            f'diaginertia="{turning:.17g} {turning:.17g} {turning:.17g}"/>'
            f'<geom type="ellipsoid" pos="{-long:.17g} 0 0" size="{long:.17g} {wide:.17g} {high:.17g}" '
            f'fluidshape="ellipsoid" fluidcoef="{FLUID}" contype="0" conaffinity="0"/>'
        )
    return (
        f'<mujoco><option timestep="{step_s:.17g}" integrator="{integrator}" density="{density}">'
        '<flag constraint="disable" contact="disable" gravity="disable" energy="disable"/></option>'
        f"<worldbody>{''.join(opened)}{'</body>' * len(opened)}</worldbody>"
        f"<actuator>{''.join(actuators)}</actuator></mujoco>"
    )


def mujoco_model(xml: str) -> Any:
    """The compiled model; its bodies hold the added mass, so that the fluid must not act by it again."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.geom_fluid[:, 6:] = 0.0
    return model


def mujoco_control(
    plant: Engine, beat: drives.TailBeat, step_s: float, steps: int, *, prescribed: bool
) -> Pair:
    """State (time, positions, velocities, activations) at the start, and the controls of every step."""
    gains = np.array([a.joint.driven.gain for a in plant.assembly.driven])
    n = 3 + len(plant.assembly.topology) - 1
    grid = step_s * np.arange(steps + 1)
    if not prescribed:
        # held over a step: its angle in the middle
        return np.zeros(1 + 2 * n), beat.motion(grid[:-1] + 0.5 * step_s)[0][:, None] * gains
    # the spline's second derivative is linear over a step, and so is an integrator under a constant
    # control; differences of it do not accumulate rounding errors, as its third derivative does
    spline = CubicSpline(grid, beat.motion(grid)[0], bc_type=((1, 0.0), "not-a-knot"))
    bend = spline(grid, 2)[:, None] * gains
    start = np.concatenate([np.zeros(1 + 2 * n), bend[0]])
    return start, np.diff(bend, axis=0) / step_s


@dataclass(frozen=True)
class Mujoco:
    """MuJoCo's rollout of the same links."""

    plant: Engine
    integrator: str
    prescribed: bool

    @property
    def kind(self) -> str:
        return "prescribed" if self.prescribed else "servo"

    @property
    def name(self) -> str:
        return f"mujoco.rollout, {self.kind}, {self.integrator}"

    def runner(self, cut: int) -> Callable[[], Pair]:
        step, steps = COMPARED_S / cut, cut * COMPARED
        xml = mujoco_xml(self.plant, prescribed=self.prescribed, integrator=self.integrator, step_s=step)
        model = mujoco_model(xml)
        data = mujoco.MjData(model)
        start, control = mujoco_control(self.plant, BEAT, step, steps, prescribed=self.prescribed)
        states = np.empty((1, steps, len(start)))
        roller = rollout.Rollout(nthread=0)
        n = model.nv

        def run() -> Pair:
            roller.rollout(
                [model],
                [data],
                nstep=steps,
                initial_state=start[None],
                control=control[None],
                state=states,
                skip_checks=True,
            )
            there = np.vstack([start, states[0, cut - 1 :: cut]])
            return surge_and_yaw_rate(there, n)

        return run


def surge_and_yaw_rate(states: np.ndarray, n: int) -> Pair:
    """Base surge and yaw rate of MuJoCo's states (time, positions, velocities, ...)."""
    theta, vx, vy = states[:, 3], states[:, 1 + n], states[:, 2 + n]
    return np.cos(theta) * vx + np.sin(theta) * vy, states[:, 3 + n]


# ---------------------------------------------------------------------------------- solve_ivp


class Peer:
    """The same equations with NumPy: Lagrange's, in the complex plane, for chains of isotropic mass.

    With ``e_k = exp(i psi_k)`` the points of the chain are ``z - A e`` for constant levers A; columns
    of J are the points' velocities per unknown rate (x, y, heading, passive angles).
    """

    def __init__(self, plant: Engine, values: np.ndarray, beat: drives.TailBeat) -> None:
        tables = list(plant.assembly.tables(values[: len(plant.assembly.names)]).values())
        topology, joint, inertia, passive, drag_link, drag = tables[:6]
        links = len(topology)
        assert np.array_equal(topology[1:, 0], np.arange(links - 1))
        assert np.allclose(inertia[:, 0], inertia[:, 3])
        self.beat, self.gains = beat, np.array([a.joint.driven.gain for a in plant.assembly.driven])
        self.tendon = [float(v) for v in passive[0, 5:9]]
        self.mass = inertia[:, 0].copy()
        com = -inertia[:, 4] / self.mass
        self.turning = inertia[:, 5] - self.mass * com**2
        ahead = np.append(-joint[1:, 0], 0.0)
        own = np.concatenate([np.arange(links), drag_link])
        lever = np.where(np.arange(links) < own[:, None], ahead, 0.0)
        lever[np.arange(len(own)), own] = np.concatenate([com, -drag[:, 0]])
        self.lever, self.own, self.links = lever, drag_link, links
        self.along, self.across = drag[:, 2], drag[:, 3]
        below = np.tril(np.ones((links, links - 1)), -1)  # links a joint turns
        self.turned = below[:, [a.link - 1 for a in plant.assembly.driven]] @ self.gains
        self.free = np.column_stack([np.ones(links), below[:, [a.link - 1 for a in plant.assembly.passive]]])
        self.spin = np.column_stack([np.zeros((links, 2)), self.free])
        self.weigh = self.turning[:, None] * self.spin

    def command(self, t: float) -> tuple[float, float, float]:
        """The beat and its first two derivatives."""
        omega = 2 * math.pi * self.beat.frequency_hz
        amplitude = self.beat.amplitude_rad
        s, c = amplitude * math.sin(omega * t), amplitude * math.cos(omega * t)
        ramp = self.beat.ramp_s
        if t >= ramp:
            return s, omega * c, -omega * omega * s
        x = t / ramp
        ease, slope = x**3 * (10 + x * (6 * x - 15)), 30 * x**2 * (1 - x) ** 2 / ramp
        curve = 60 * x * (1 - x) * (1 - 2 * x) / ramp**2
        return (
            s * ease,
            omega * c * ease + s * slope,
            -omega * omega * s * ease + 2 * omega * c * slope + s * curve,
        )

    def __call__(self, t: float, state: np.ndarray) -> np.ndarray:
        """Rate of (x, y, heading, passive angle, and their rates)."""
        angle, rate, bend = self.command(t)
        links = self.links
        e = np.exp(1j * (self.free @ state[2:4] + self.turned * angle))
        omega = self.free @ state[6:8] + self.turned * rate
        known = self.turned * bend
        columns = np.empty((len(self.lever), 4), dtype=complex)
        columns[:, 0], columns[:, 1] = 1.0, 1j
        columns[:, 2:] = -1j * (self.lever @ (e[:, None] * self.free))
        bodies, points = columns[:links], columns[links:]
        local = (state[4] + 1j * state[5] - 1j * (self.lever[links:] @ (omega * e))) * e[self.own].conj()
        u, v = local.real, local.imag
        force = -(self.along * np.abs(u) * u + 1j * self.across * np.abs(v) * v) * e[self.own]
        drift = self.lever[:links] @ ((omega**2 - 1j * known) * e)
        weighed = self.mass[:, None] * bodies.conj()
        right = (points.conj().T @ force - weighed.T @ drift).real - known @ self.weigh
        right[3] += tendon_torque.py_func(float(state[3]), *self.tendon)
        matrix = (weighed.T @ bodies).real + self.spin.T @ self.weigh
        return np.concatenate([state[4:], np.linalg.solve(matrix, right)])

    def solve(self, method: str, tolerance: float, time_s: np.ndarray) -> tuple[Pair, int]:
        """Surge and yaw rate at the samples, and how often the equations were evaluated."""
        found = solve_ivp(
            self, (0.0, DURATION_S), np.zeros(8), method=method, rtol=tolerance, atol=tolerance, t_eval=time_s
        )
        y = found.y
        return (np.cos(y[2]) * y[4] + np.sin(y[2]) * y[5], y[6]), found.nfev


# ----------------------------------------------------------------------------------- sections

Row = tuple[int, float, float]


def section_engine(plant: Engine) -> None:
    """What the engine costs."""
    print(f"\nEngine, {DURATION_S:g} s of a {BEAT.frequency_hz:g} Hz beat from rest")
    print(f"{'':<38}{'us/rhs':>9}{'ms/run':>9}{'links':>7}{'drag':>6}{'foil':>6}{'error':>10}")
    rows: list[tuple[str, Engine, int]] = [
        (f"tfish, dt {1e3 * COMPARED_S / c:g} ms", plant, c)
        for c in (DEFAULT_CUT // 2, DEFAULT_CUT, 2 * DEFAULT_CUT, 5 * DEFAULT_CUT)
    ]
    rows.append(("tfish, 12 strips per link, dt 5 ms", Engine("tfish", drag_point="strips"), DEFAULT_CUT))
    rows.append(("dolphin, dt 5 ms", Engine("dolphin"), DEFAULT_CUT))
    runners = [each.runner(cut) for _, each, cut in rows]
    pairs = [run() for run in runners]
    # in turn, so that a spell of load does not fall on one row alone
    times = np.array([[cpu(run, 2)[0] for run in runners] for _ in range(10)]).min(axis=0)
    for (label, each, cut), found, seconds in zip(rows, pairs, times, strict=True):
        tables = list(each.assembly.tables(each.coefficients).values())
        error = distance(found, each.runner(FINE["engine"])())
        print(
            f"{label:<38}{1e6 * seconds / (4 * cut * COMPARED):9.3f}{1e3 * seconds:9.2f}{len(tables[0]):7d}"
            f"{len(tables[5]):6d}{len(tables[7]):6d}{error:10.1e}"
        )
    seconds, _ = cpu(lambda: [plant.assembly.tables(plant.coefficients) for _ in range(200)])
    print(f"{'tables from one parameter set':<38}{'':9}{seconds / 200 * 1e3:9.3f}")
    seconds, _ = cpu(lambda: plant.inputs(DEFAULT_CUT))
    print(f"{'joint table, once per trial':<38}{'':9}{1e3 * seconds:9.2f}")
    trial = Trial("run", "fit", TIME, {}, swim=SwimInput(BEAT))
    varied = iter(range(10**6))

    def simulate() -> None:
        values = plant.values.copy()
        values[0] *= 1.0 + 1e-9 * next(varied)
        plant.model.simulate(values, trial)

    simulate()
    seconds, _ = cpu(simulate, 15)
    print(f"{'Model.simulate, new coefficients':<38}{'':9}{1e3 * seconds:9.2f}")


def curve(each: Engine | Mujoco, reference: Pair, target: float) -> list[Row]:
    """Cut, CPU time and error, from coarse to fine, until the target is reached."""
    found: list[Row] = []
    for cut in CUTS:
        run = each.runner(cut)
        run()
        seconds, pair = cpu(run, 3)
        found.append((cut, seconds, distance(pair, reference)))
        if found[-1][2] <= target and cut >= DEFAULT_CUT:
            break
    return found


def reached(rows: Sequence[Row], level: float) -> Row | None:
    """The coarsest row from which on all errors are at or below a level."""
    good = [row for k, row in enumerate(rows) if all(r[2] <= level for r in rows[k:])]
    return good[0] if good else None


def section_mujoco(plant: Engine) -> None:
    """MuJoCo at equal error."""
    print("\nmujoco.rollout of the same links, at equal error (of surge and yaw rate, relative to range)")
    if mujoco is None:
        print("  mujoco is not installed")
        return
    mujoco.set_mju_user_warning(lambda text: None)
    own = plant.runner(FINE["engine"])()
    default = distance(plant.runner(DEFAULT_CUT)(), own)
    levels = sorted({*LEVELS, default}, reverse=True)
    ours = curve(plant, own, levels[-1])
    peers: dict[str, tuple[Mujoco, list[Row]]] = {}
    print(f"  mean surge of the last 5 s: swimid {own[0][-50:].mean():.3f} m/s", end="")
    for prescribed in (False, True):
        kind = "prescribed" if prescribed else "servo"
        reference = Mujoco(plant, "RK4", prescribed).runner(FINE[kind])()
        print(f", MuJoCo {kind} {reference[0][-50:].mean():.3f}", end="")
        for integrator in ("Euler", "implicitfast", "RK4"):
            peer = Mujoco(plant, integrator, prescribed)
            peers[peer.name] = (peer, curve(peer, reference, levels[-1]))
    print(
        f"\n{'error':>9}{'swimid ms':>11}{'dt ms':>7}   "
        f"{'fastest MuJoCo':<40}{'ms':>8}{'dt ms':>7}{'ratio':>8}"
    )
    for level in levels:
        mine = reached(ours, level)
        found = [(row[1], name, row) for name, (_, rows) in peers.items() if (row := reached(rows, level))]
        assert mine is not None
        note = "   <- swimid's default step" if level == default else ""
        if not found:
            print(f"{level:9.1e}{1e3 * mine[1]:11.2f}{1e3 * COMPARED_S / mine[0]:7.2f}   none{note}")
            continue
        _, name, row = min(found)
        a, b = in_turn(plant.runner(mine[0]), peers[name][0].runner(row[0]))
        print(
            f"{level:9.1e}{1e3 * a:11.2f}{1e3 * COMPARED_S / mine[0]:7.2f}   {name:<40}{1e3 * b:8.1f}"
            f"{1e3 * COMPARED_S / row[0]:7.2f}{b / a:7.1f}x{note}"
        )
    print("  MuJoCo at 1 ms or the coarser step that was enough:")
    for name, (_, rows) in peers.items():
        cut, seconds, error = [r for r in rows if r[0] <= round(COMPARED_S / 1e-3)][-1]
        step = 1e3 * COMPARED_S / cut
        print(
            f"    {name:<40}{1e6 * seconds / (cut * COMPARED):7.2f} us per step of {step:.2f} ms, "
            f"error {error:.1e}"
        )


def in_turn(first: Callable[[], Any], second: Callable[[], Any], rounds: int = 5) -> tuple[float, float]:
    """Smallest CPU times of two calls made one after the other, so that both meet the same load."""
    first(), second()
    times = [(cpu(first, 3)[0], cpu(second, 1)[0]) for _ in range(rounds)]
    return min(t[0] for t in times), min(t[1] for t in times)


def section_scipy(plant: Engine) -> None:
    """solve_ivp on the same equations."""
    print("\nsolve_ivp on the same equations in NumPy")
    peer = Peer(plant, plant.values, BEAT)
    own = plant.runner(FINE["engine"])()
    compared = np.linspace(0.0, DURATION_S, COMPARED + 1)
    tight, _ = peer.solve("DOP853", 1e-10, compared)
    print(f"  agreement with the engine: {distance(tight, own):.1e} (DOP853, 1e-10)")
    state = np.array([0.1, 0.2, 0.3, 0.2, 0.3, 0.1, -0.4, 1.0])
    seconds, _ = cpu(lambda: [peer(2.0, state) for _ in range(1000)])
    print(f"  right-hand side {1e3 * seconds:.1f} us")
    ours = curve(plant, own, 1e-7)
    print(
        f"{'':<18}{'CPU ms':>8}{'rhs':>8}{'error':>9}   "
        f"{'swimid, dt 5 ms':>16}{'ratio':>7}   at equal error{'ratio':>7}"
    )
    for method in ("LSODA", "RK45"):
        pair, calls = peer.solve(method, 1e-6, compared)
        error = distance(pair, own)
        default, slow = in_turn(plant.runner(DEFAULT_CUT), lambda m=method: peer.solve(m, 1e-6, compared))
        equal = reached(ours, error)
        assert equal is not None
        same, slow2 = in_turn(plant.runner(equal[0]), lambda m=method: peer.solve(m, 1e-6, compared))
        print(
            f"{method + ', rtol 1e-6':<18}{1e3 * slow:8.0f}{calls:8d}{error:9.1e}   {1e3 * default:13.2f} ms"
            f"{slow / default:6.0f}x   dt {1e3 * COMPARED_S / equal[0]:4.1f} ms    {slow2 / same:6.0f}x"
        )


# ---------------------------------------------------------------------------------------- fits

NAMES = ("c_ma", "c_Ia", "c_d0", "c_d13", "c_d4", "c_f0", "c_f13", "c_f4")


def recorded(folder: str) -> Path:
    """The trials file of six runs of the tests' independent simulator, with noise."""
    drives = [{"frequency_hz": f, "amplitude_deg": a} for f, a in BEATS]
    runs = [
        swimmer.Run(f"run{k}", each, swimmer.simulate("tfish", None, each, DURATION_S))
        for k, each in enumerate(drives)
    ]
    return swimmer.write_trials(folder, "tfish", runs, NOISE, SEED)


def clocked(function: Callable[[], Any]) -> tuple[float, float, Any]:
    """Wall and CPU seconds of one call, and its result."""
    wall, begun = time.perf_counter(), time.process_time()
    result = function()
    return time.perf_counter() - wall, time.process_time() - begun, result


def line(name: str, wall: float, used: float, reference: float, note: str, estimate: Sequence[float]) -> None:
    """One row of the table of fits."""
    print(
        f"{name:<40}{wall:8.2f}{used:8.2f}{used / reference:7.1f}x  {note:<28}"
        + " ".join(f"{v:.4g}" for v in estimate)
    )


def section_fit(plant: Engine, full: bool) -> None:
    """The fit of eight coefficients to six trials of 20 s."""
    print(
        f"\nFit of {len(NAMES)} coefficients, {len(BEATS)} trials x {DURATION_S:g} s, "
        f"{os.cpu_count()} processors"
    )
    print(f"{'':<40}{'wall s':>8}{'CPU s':>8}{'CPU':>8}  {'':<28}{' '.join(NAMES)}")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = recorded(folder)
        trials = fit_common.load_experiment(file, channels=tuple(NOISE)).trials
        verb_wall, verb, outcome = clocked(lambda: fit_graybox(file, channels=tuple(NOISE)))
    fits = {
        jobs: [
            clocked(lambda jobs=jobs: output_error.fit_output_error(Engine().model, trials, jobs=jobs))
            for _ in range(3)
        ]
        for jobs in (1, None)
    }
    own = min(used for found in fits.values() for _, used, _ in found)
    for jobs, found in fits.items():
        wall, used, result = min(found, key=lambda f: f[1])
        note = f"{result.evaluations} runs"
        label = f"swimid output_error.fit{', one thread' if jobs else ''}"
        line(label, wall, used, own, note, result.estimate)
    errors = np.sqrt(np.diag(result.covariance))
    print(f"{'  standard errors':<86}" + " ".join(f"{e:.2g}" for e in errors))
    estimate = [outcome.data["parameters"][name]["value"] for name in NAMES]
    line("swimid fit-graybox, files to evidence", verb_wall, verb, own, "", estimate)
    scipy_fit(plant, trials, plant.model.parameters[: len(NAMES)], own, full)
    sysid_fit(plant, own)


def scipy_fit(
    plant: Engine, trials: Sequence[Trial], free: Sequence[Parameter], own: float, full: bool
) -> None:
    """``least_squares`` over ``solve_ivp``."""
    scale = np.array([p.scale for p in free])
    start = np.array([p.start for p in free])
    bounds = ([p.lower for p in free], [p.upper for p in free])

    def residuals(theta: np.ndarray, pair: Callable[[np.ndarray, Trial], Pair]) -> np.ndarray:
        values = plant.values.copy()
        values[: len(theta)] = theta
        return np.concatenate(
            [
                (simulated - measured) / sd
                for trial in trials
                for simulated, (measured, sd) in zip(
                    pair(values, trial), ((trial.measured[n], NOISE[n]) for n in NOISE), strict=True
                )
            ]
        )

    def slow(values: np.ndarray, trial: Trial) -> Pair:
        return Peer(plant, values, trial.swim.beat).solve("LSODA", 1e-6, TIME)[0]

    def quick(values: np.ndarray, trial: Trial) -> Pair:
        found = plant.model.simulate(values, trial)
        return found["u_m_s"], found["yaw_rate_rad_s"]

    # steps that stand clear of the adaptive integrator's own noise; the engine needs none so wide
    options: dict[str, Any] = {"bounds": bounds, "x_scale": scale, "diff_step": 1e-4}
    wall, used, counted = clocked(lambda: least_squares(residuals, start, args=(quick,), **options))
    note = f"{counted.njev} Jacobians, {counted.nfev} residuals"
    line("scipy least_squares on the engine", wall, used, own, note, counted.x)
    name = "scipy least_squares on solve_ivp LSODA"
    if full:
        wall, used, found = clocked(lambda: least_squares(residuals, start, args=(slow,), **options))
        line(name, wall, used, own, f"{found.njev} Jacobians, {found.nfev} residuals", found.x)
        return
    _, once, _ = clocked(lambda: [residuals(x, slow) for x in (start, counted.x)])
    _, one, _ = clocked(lambda: [residuals(counted.x + 1e-4 * step, slow) for step in np.diag(scale)])
    used = counted.nfev * once / 2 + counted.njev * one
    line(name, used, used, own, f"from one Jacobian, {one:.1f} s", counted.x)


# ------------------------------------------------------------------------------------ mujoco.sysid

#: Truth, lower bound, upper bound and start: factors of mass and inertia less one, blunt and
#: slender drag of the head, of links 1 to 3 and of the fin.
SYSID = {
    "mass": (1.16, 0.0, 3.0, 1.5), "inertia": (1.30, 0.0, 3.0, 1.5),
    "blunt0": (0.1, 0.0, 1.0, 0.2), "blunt13": (0.05, 0.0, 1.0, 0.1), "blunt4": (0.15, 0.0, 1.0, 0.3),
    "slender0": (0.01, 0.0, 0.1, 0.02), "slender13": (0.01, 0.0, 0.1, 0.02),
    "slender4": (0.01, 0.0, 0.1, 0.02),
}  # fmt: skip
SYSID_SCALE = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01])


def sysid_fit(plant: Engine, own: float) -> None:
    """``mujoco.sysid`` on trials of its own model, at the default step."""
    name = "mujoco.sysid, its own model"
    try:
        from mujoco import sysid

        optimise = sysid.optimize
    except (ImportError, AttributeError):
        print(f"{name:<40} mujoco[sysid] is not installed")
        return
    step, steps = STEP_S, round(DURATION_S / STEP_S)
    bare = Engine()
    bare.coefficients = np.where(np.isin(bare.assembly.names, ["c_ma", "c_Ia"]), 0.0, bare.coefficients)
    xml = mujoco_xml(bare, prescribed=True, integrator="RK4", step_s=step)
    sensors = '<sensor><user name="surge" dim="1"/><user name="yaw_rate" dim="1"/></sensor></mujoco>'
    spec = mujoco.MjSpec.from_string(xml.replace("</mujoco>", sensors))
    base = spec.compile()
    base.geom_fluid[:, 6:] = 0.0
    groups = [[0], [1, 2, 3], [4]]

    def build(parameters: Any, _: Any = None) -> Any:
        values = [float(parameters[key].value[0]) for key in SYSID]
        model = copy.copy(base)
        model.body_mass[1:] *= 1.0 + values[0]
        model.body_inertia[1:] *= 1.0 + values[1]
        for k, geoms in enumerate(groups):
            model.geom_fluid[geoms, 1], model.geom_fluid[geoms, 2] = values[2 + k], values[5 + k]
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    parameters = sysid.ParameterDict()
    for key, (truth, low, high, _) in SYSID.items():
        parameters.add(sysid.Parameter(key, truth, low, high))
        parameters[key].value[:] = truth
    true, rng = build(parameters), np.random.default_rng(SEED)
    signals = {key: (sysid.SignalType.MjSensor, np.array([k])) for k, key in enumerate(("surge", "yaw_rate"))}
    sd = np.array(list(NOISE.values()))
    every = round((TIME[1] - TIME[0]) / step)

    def seen(states: np.ndarray) -> np.ndarray:
        return np.column_stack(surge_and_yaw_rate(states[every - 1 :: every], true.nv))

    def compare(
        _: Any, __: Any, measured: Any, ___: Any, ____: Any, state: np.ndarray
    ) -> tuple[Any, Any, Any]:
        predicted = sysid.TimeSeries(measured.times, seen(state), signals)
        return (predicted.data - measured.data) / sd, predicted, measured

    starts, controls, measured = [], [], []
    for frequency, amplitude in BEATS:
        beat = drives.TailBeat("sine", frequency, math.radians(amplitude))
        start_state, control = mujoco_control(plant, beat, step, steps, prescribed=True)
        states, _ = rollout.rollout(true, mujoco.MjData(true), start_state, control)
        starts.append(start_state)
        # the last control is not applied
        controls.append(sysid.TimeSeries(step * np.arange(steps + 1), np.vstack([control, control[-1:]])))
        noisy = seen(states[0]) + sd * rng.standard_normal((len(TIME) - 1, 2))
        measured.append(sysid.TimeSeries(TIME[1:], noisy, signals))
    for key, (_, _, _, start) in SYSID.items():
        parameters[key].value[:] = start
    names = [f"run{k}" for k in range(len(BEATS))]
    sequences = sysid.ModelSequences("fish", spec, names, starts, controls, measured)
    calls = [0]

    def residual(x: np.ndarray, parameters: Any) -> Any:
        calls[0] += len(BEATS) * (1 if x.ndim == 1 else x.shape[1])
        return sysid.residual(
            x, parameters, [sequences], build_model=build, modify_residual=compare, resample_true=False
        )

    with contextlib.redirect_stdout(io.StringIO()):
        wall, used, (found, _) = clocked(
            lambda: optimise(parameters, residual, verbose=False, x_scale=SYSID_SCALE)
        )
    line(name, wall, used, own, f"{calls[0]} runs", found.as_vector())
    print(f"{'  truth':<86}" + " ".join(f"{truth:.4g}" for truth, *_ in SYSID.values()))


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    sections = ("engine", "mujoco", "scipy", "fit")
    options.add_argument("--only", nargs="+", choices=sections, default=sections)
    options.add_argument("--full", action="store_true", help="run SciPy's fit to its end")
    chosen = options.parse_args()
    plant = Engine()
    if "engine" in chosen.only:
        section_engine(plant)
    if "mujoco" in chosen.only:
        section_mujoco(plant)
    if "scipy" in chosen.only:
        section_scipy(plant)
    if "fit" in chosen.only:
        section_fit(plant, chosen.full)


if __name__ == "__main__":
    main()
