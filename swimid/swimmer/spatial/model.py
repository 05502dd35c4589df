"""The robot in space as a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.fitting.hooks import Hooks
from swimid.fitting.model import Array, Trial
from swimid.logs.rotation import angles, from_angles
from swimid.robots.spatial import Hydrostatics
from swimid.swimmer.lanes.kernel import Engine
from swimid.swimmer.model import Run, Swimmer
from swimid.swimmer.planar.engine import FILLED
from swimid.swimmer.spatial import engine
from swimid.swimmer.spatial.assembly import Assembly, Lifted

#: Signs of roll, pitch (nose up) and yaw against rotation about x, y and z.
SIGNS = np.array([1.0, -1.0, 1.0])


class MultibodyModel(Swimmer):
    """A robot with links in space (:mod:`swimid.swimmer.spatial.engine`).

    A robot of a planar file moves in space as in its plane.

    Parameters
    ----------
    robot : Robot
        With a ``multibody`` or a ``multilink`` part.
    max_step : float, s
        Each sampling interval is cut into equal steps no longer than this.
    """

    name = "multibody"
    offers = frozenset({"command", "tables", "output", "clock"})
    in_space = True
    coordinates, speeds = 7, 6
    engine = Engine(
        engine.derivative,
        engine.shapes,
        settled=engine.settled,
        filled=FILLED,
        energetics=engine.energetics,
    )
    pose = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    velocity = ("u_m_s", "v_m_s", "w_m_s", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
    places = ("x", "y", "z", "roll", "pitch", "yaw")
    rates = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
    tree: Assembly | Lifted

    def _tree(self) -> Assembly | Lifted:
        if self.robot.multibody is not None:
            return Assembly(self.robot.multibody, self.robot.fluid)
        assert self.robot.multilink is not None
        return Lifted(self.robot.multilink, self.robot.fluid)

    def _offsets(self) -> tuple[str, ...]:
        # the run begins over the origin, heading along x
        return ("start_x", "start_y", "start_yaw")

    def opening(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Velocities at the first sample; still where no channel tells (see :meth:`Swimmer.opening`)."""
        names = [f"initial_{name}" for name in self.rates]
        found = {name: seen(column, 0) for name, column in zip(names, self.velocity, strict=True)}
        turned = [seen(column, 0) or 0.0 for column in self.pose[3:]]
        rates = [seen(column, 1) for column in self.pose]
        if any(r is not None for r in rates[:3]):
            body = from_angles(*([a] for a in turned))[0].inv().apply([r or 0.0 for r in rates[:3]])
            # rates of the angles stand for those about the axes: at the start the body is nearly level
            moved = [*(float(v) for v in body), *rates[3:]]
            found = {n: v if found[n] is None else found[n] for n, v in zip(names, moved, strict=True)}
        return found

    def initial(self, measured: Collection[str]) -> list[str]:
        """The start velocities, angles and rates that channels can tell: of a side view, in its plane."""
        blind = [
            f"initial_{name}"
            for name, place, speed in zip(self.rates, self.pose, self.velocity, strict=True)
            if place not in measured and speed not in measured
        ]
        return [p.name for p in self.parameters if p.name.startswith("initial_") and p.name not in blind]

    def with_buoyancy(self, factor: float) -> MultibodyModel | None:
        """The same model with every volume that displaces water multiplied; None where none does."""
        body = self.robot.multibody
        if body is None or not any(isinstance(e, Hydrostatics) and e.volume_m3 for e in body.elements):
            return None
        elements = [
            e.model_copy(update={"volume_m3": _times(factor, e.volume_m3)})
            if isinstance(e, Hydrostatics)
            else e
            for e in body.elements
        ]
        changed = body.model_copy(update={"elements": elements})
        other = MultibodyModel(self.robot.model_copy(update={"multibody": changed}), max_step=self.max_step)
        other.parameters = self.parameters
        return other

    # -------------------------------------------------------- simulation

    def _posed(self, values: Array, trial: Trial) -> Array:
        """Pose of the reference point at the first sample, shape (6,)."""
        pose = np.array(trial.swim.posed(6), dtype=float)
        return pose + [self._value(values, name) for name in self.starts]

    def _begin(self, start: Array, values: Array, trial: Trial, begin_s: float, hooks: Hooks) -> None:
        start[3] = 1.0
        if not self.free_base:
            return
        passives = len(self.passive)
        _, _, z, roll, pitch, _ = self._posed(values, trial)
        turn = from_angles([roll], [pitch], [0.0])[0]
        place = -turn.apply(self.tree.reference)
        start[2] = z + place[2]
        start[3:7] = np.roll(turn.as_quat(), 1)
        speed = np.array([self._value(values, f"initial_{name}") for name in self.rates])
        spin = speed[3:] * SIGNS
        start[7 + passives : 10 + passives] = speed[:3] - np.cross(spin, self.tree.reference)
        start[10 + passives : 13 + passives] = spin

    def _integrate(self, run: Run) -> tuple[Array, Array]:
        states, rates = engine.integrate(run.start, run.step_s, run.drive.table, *run.tables.values())
        return states, rates

    def _seen(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        passives = len(self.passive)
        turn = Rotation.from_quat(_sound(states[:, [4, 5, 6, 3]]))
        place = states[:, :3] + turn.apply(self.tree.reference)
        x, y, _, _, _, yaw = self._posed(values, trial)
        c, s = math.cos(yaw), math.sin(yaw)
        dx, dy = place[:, 0] - place[0, 0], place[:, 1] - place[0, 1]
        spin = states[:, 10 + passives : 13 + passives]
        velocity = states[:, 7 + passives : 10 + passives] + np.cross(spin, self.tree.reference)
        broken = ~np.isfinite(states[:, 3])
        roll, pitch, heading = (np.where(broken, np.nan, a) for a in angles(turn))
        pose = (x + c * dx - s * dy, y + s * dx + c * dy, place[:, 2], roll, pitch, heading + yaw)
        return dict(zip((*self.pose, *self.velocity), (*pose, *velocity.T, *(spin * SIGNS).T), strict=True))


def _times(factor: float, quantity: float | str) -> float | str:
    """A quantity of a robot file, multiplied."""
    return f"{factor!r} * {quantity}" if isinstance(quantity, str) else factor * quantity


def _sound(quaternions: Array) -> Array:
    """Quaternions with those of a broken run replaced by none at all."""
    broken = ~np.isfinite(quaternions).all(axis=1, keepdims=True)
    return np.where(broken, [0.0, 0.0, 0.0, 1.0], quaternions)
