"""The multi-link robot in a plane as a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.fitting.drives import Beat, SwimInput
from swimid.fitting.hooks import TRACEABLE, Hooks
from swimid.fitting.model import Array, Parameter, Trial
from swimid.progress import Progress, silent
from swimid.robots.planar import Multilink
from swimid.swimmer.lanes.kernel import Engine
from swimid.swimmer.lanes.wide import Room
from swimid.swimmer.model import Run, Swimmer, joint_motion, of_trial
from swimid.swimmer.planar import drive, engine
from swimid.swimmer.planar.assembly import Assembly
from swimid.swimmer.planar.body import Body, SwimmerScales

#: Grid on which the command of a drive is read, s.
READ_S = 0.0025

#: By plane of motion: its second axis, the velocity along that in the body's axes and in words, and the turn.
PLANES = {"horizontal": ("y", "v", "sway", "yaw"), "vertical": ("z", "w", "heave", "pitch")}


class MultilinkModel(Swimmer):
    """A planar multi-link robot (:mod:`swimid.swimmer.planar.engine`).

    Parameters
    ----------
    robot : Robot
        With a ``multilink`` part.
    max_step : float, s
        Each sampling interval is cut into equal steps no longer than this.
    """

    name = "multilink"
    offers = frozenset({"command", "tables", "force", "flow", "output", "clock"})
    coordinates, speeds = 3, 3
    engine = Engine(
        engine.derivative,
        engine.shapes,
        extra=(None, 0.0),
        filled=engine.FILLED,
        energetics=engine.energetics,
    )
    camera = (
        of_trial(
            "camera_rotation", "rad", 0.02, "axes of the measured position against those of the heading"
        ),
    )
    pose: tuple[str, str, str]
    velocity: tuple[str, str, str]
    tree: Assembly
    #: With the parameters it was made of.
    _body: tuple[tuple[Parameter, ...], Body] | None = None

    def _tree(self) -> Assembly:
        second, v, sideways, turn = PLANES[self.links.plane]
        self.pose = ("x_m", f"{second}_m", f"{turn}_rad")
        self.velocity = ("u_m_s", f"{v}_m_s", f"{turn}_rate_rad_s")
        self.places, self.rates = ("x", second, turn), ("surge", sideways, f"{turn}_rate")
        return Assembly(self.links, self.robot.fluid)

    def _offsets(self) -> tuple[str, ...]:
        return self.starts

    # -------------------------------------------------------- what it offers

    @property
    def links(self) -> Multilink:
        """The robot's multi-link part."""
        assert self.robot.multilink is not None
        return self.robot.multilink

    @property
    def reference_m(self) -> tuple[float, float]:
        """The reference point in the base's axes, m."""
        return -self.links.reference.station_m, self.links.reference.offset_m

    @property
    def body(self) -> Body:
        """Its links."""
        known = self._body
        if known is None or known[0] is not self.parameters:
            known = self._body = self.parameters, Body(self)
        return known[1]

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the plane of motion; none where the base is held."""
        return tuple(name.removesuffix("_m") for name in self.pose[:2]) if self.free_base else ()

    def scales(self, trials: Sequence[Trial]) -> SwimmerScales:
        """Typical sizes of trials."""
        return SwimmerScales(self, trials)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Pose at the first sample."""
        return dict(zip(self.pose, (float(p) for p in trial.swim.posed()), strict=True))

    def commanded(self, trial: Trial) -> bool:
        """Whether a drive or a recorded command moves the joints, not their measured angles."""
        swim = trial.swim
        return swim.beat is not None if swim.joints is None else swim.commanded

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """What each driven joint is told to do."""
        known = self._commands.get(trial.id)
        if known is None or known[0] is not trial.swim or known[1] is not trial.time_s:
            time = np.arange(float(trial.time_s[0]), float(trial.time_s[-1]) + READ_S, READ_S)
            motions = [joint_motion(axis, k, trial.swim, time, 0.0) for k, axis in enumerate(self.driven)]
            told = [(time, angle, float(np.max(np.abs(rate)))) for angle, rate, _ in motions]
            known = self._commands[trial.id] = trial.swim, trial.time_s, told
        yield from known[2]

    def prepare(self, progress: Progress = silent, **how: Any) -> None:
        """Compile the kernels (see :meth:`Swimmer.prepare`)."""
        prepare(progress)
        super().prepare(progress, **how)

    def opening(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Velocities at the first sample, by parameter (see :meth:`Swimmer.opening`)."""
        names = [f"initial_{name}" for name in self.rates]
        found = {name: seen(column, 0) for name, column in zip(names, self.velocity, strict=True)}
        heading = seen(self.pose[2], 0)
        along, across, turn = (seen(column, 1) for column in self.pose)
        if heading is not None and along is not None and across is not None:
            c, s = math.cos(heading), math.sin(heading)
            moved = (c * along + s * across, c * across - s * along, turn)
            found = {n: v if found[n] is None else found[n] for n, v in zip(names, moved, strict=True)}
        return found

    def initial(self, measured: Collection[str]) -> list[str]:
        """The start velocities, angles and rates that these channels can tell: all."""
        return [p.name for p in self.parameters if p.name.startswith("initial_")]

    # -------------------------------------------------------- simulation

    def _influences(self, hooks: Hooks) -> list[int]:
        if self._heading_matters() or hooks.force or hooks.flow:
            return [*self._dynamic, *(self._at[n] for n in self.starts[2:] if n in self._at)]
        return self._dynamic

    def _heading_matters(self) -> bool:
        return self.tree.world_forces and self.free_base

    def _attitude(self) -> list[int]:
        return [2] if self._heading_matters() else []

    def _heading(self, values: Array, trial: Trial) -> float:
        """At the first sample."""
        return float(trial.swim.posed()[2]) + self._value(values, self.starts[2])

    def _mounts(self) -> list[float]:
        return [math.radians(a.joint.mount_deg) for a in self.driven]

    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        n = self.tree.unknowns
        if not self.free_base:
            start[2] = math.radians(self.links.heading_deg)
            return
        u, v, r = (values[self._at[f"initial_{name}"]] for name in self.rates)
        x, y = self.reference_m
        start[n : n + 3] = u + r * y, v - r * x, r
        if hooks.flow:
            _, water = _flows(hooks, np.array([begin_s]))
            heading = self._heading(values, trial)
            start[n : n + 2] -= _turned(float(water[0, 0]), float(water[0, 1]), -heading)
        if self._heading_matters():
            start[2] = self._heading(values, trial)

    def _integrate(self, run: Run) -> tuple[Array, Array]:
        forced = None
        if run.hooks.force:
            forced = engine.outside(run.hooks.force, self._frame(run), len(self.tree.links))
        tables = run.tables.values()
        states, rates = engine.integrate(run.start, run.step_s, run.drive.table, *tables, forced, run.begin_s)
        return states, rates

    def _frame(self, run: Run) -> Array:
        x, y, _ = run.trial.swim.posed()
        heading = 0.0 if self._heading_matters() else self._heading(run.values, run.trial)
        return engine.placed((x, y, heading), self.reference_m)

    def _room(self) -> Room:
        body = self.body
        links = {"base": 0, "hull": body.hull, "last": body.last}
        # a mass that moves, and the weights that move with it
        filled = {"inertia": body.hull, "force": np.s_[:, :2]}
        return Room(body.room(), filled, [(known, links[known.on]) for _, known in sorted(TRACEABLE.items())])

    def _carried(self, found: dict[str, Array], hooks: Hooks, begin_s: float, time_s: Array) -> None:
        moved, speed = _flows(hooks, np.append(begin_s, time_s))
        x, y, heading = self.pose
        found[x] = found[x] + moved[1:, 0] - moved[0, 0]
        found[y] = found[y] + moved[1:, 1] - moved[0, 1]
        u, v = _turned(speed[1:, 0], speed[1:, 1], -found[heading])
        along, across, _ = self.velocity
        found[along], found[across] = found[along] + u, found[across] + v

    def _seen(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        # in the camera's axes
        pose = trial.swim.posed()
        x, y, turned = (self._value(values, name) for name in self.starts)
        # the run starts at the origin, along x unless the world's axes matter
        heading = 0.0 if self._heading_matters() else float(pose[2]) + turned
        spin = heading + self._value(values, "camera_rotation")
        origin = (float(pose[0]) + x, float(pose[1]) + y)
        seen = engine.seen(states, self.tree.unknowns, self.reference_m, origin, heading, spin)
        return dict(zip((*self.pose, *self.velocity), seen, strict=True))


def _flows(hooks: Hooks, time_s: Array) -> tuple[Array, Array]:
    """Displacement and velocity of the water in the world, shape (n, 2) each."""
    parts = [flow(time_s) for flow in hooks.flow]
    return np.asarray(sum(p[0] for p in parts)), np.asarray(sum(p[1] for p in parts))


def _turned(x: Array | float, y: Array | float, angle: Array | float) -> Array:
    """A vector turned by an angle, shape (2, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * x - s * y, s * x + c * y])


def prepare(progress: Progress) -> None:
    """Compile the kernels where that has not been done on this machine, under a bar that says so."""
    line = engine.integrate.py_func.__code__.co_firstlineno
    cache = Path(engine.integrate.stats.cache_path)
    if engine.integrate.signatures or any(cache.glob(f"engine.integrate-{line}.*.nbi")):
        return
    with progress("compiling the simulation (on first use only)"):
        warm_up()


def warm_up() -> None:
    """Compile the kernels."""
    from swimid.robots import file as robot_format

    model = MultilinkModel(robot_format.read("tfish"))
    time = np.linspace(0.0, 0.1, 6)
    beat = Beat("a-cpg", 1.0, 0.3)
    model.simulate(
        np.array([p.start for p in model.parameters]), Trial("warm", "fit", time, {}, swim=SwimInput(beat))
    )
    drive.servo(np.zeros(5), 0.1, 1.0, 1.0)
    drive.measured(np.arange(6.0), np.zeros(6))
    engine.seen(np.zeros((1, 6)), 3, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0)
    engine.sampled(np.array([0.0101]), 0.0, 0.005, np.zeros((3, 1)), np.zeros((3, 1)))
