"""Model of a robot in 3-D."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.fitting.model import Array, Hooks, Trial
from swimid.logs.kinematics import angles, from_angles
from swimid.swimmer.model import Run, Swimmer
from swimid.swimmer.spatial import engine
from swimid.swimmer.spatial.assembly import Assembly

#: Signs of roll, pitch (positive nose up) and yaw relative to rotations about x, y and z.
SIGNS = np.array([1.0, -1.0, 1.0])


class MultibodyModel(Swimmer):
    """Model of a robot with links in 3-D (:mod:`swimid.swimmer.spatial.engine`).

    Parameters
    ----------
    robot : Robot
        The robot must have a ``multibody`` part.
    max_step : float, s
        Each sampling interval is divided into equal steps no longer than this.
    """

    name = "multibody"
    offers = frozenset({"command", "tables", "output", "clock"})
    in_space = True
    coordinates, speeds = 7, 6
    engine = engine
    pose = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    velocity = ("u_m_s", "v_m_s", "w_m_s", "roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
    places = ("x", "y", "z", "roll", "pitch", "yaw")
    rates = ("surge", "sway", "heave", "roll_rate", "pitch_rate", "yaw_rate")
    tree: Assembly

    def _tree(self) -> Assembly:
        assert self.robot.multibody is not None
        return Assembly(self.robot.multibody, self.robot.fluid)

    def _offsets(self) -> tuple[str, ...]:
        # a simulation begins at x = y = 0 with its heading along x, so that these offsets do not affect it
        return ("start_x", "start_y", "start_yaw")

    def start_velocities(self, seen: Callable[[str, int], float | None]) -> dict[str, float | None]:
        """Return start values of the velocities at the first sample, by parameter name.

        If the velocity along an axis is unknown while others are known, it is taken as 0.
        """
        names = [f"initial_{name}" for name in self.rates]
        found = {name: seen(column, 0) for name, column in zip(names, self.velocity, strict=True)}
        turned = [seen(column, 0) or 0.0 for column in self.pose[3:]]
        rates = [seen(column, 1) for column in self.pose]
        if any(r is not None for r in rates[:3]):
            body = from_angles(*([a] for a in turned))[0].inv().apply([r or 0.0 for r in rates[:3]])
            # the rates of roll, pitch and yaw approximate those about the body axes, since the body is nearly
            # level
            moved = [*(float(v) for v in body), *rates[3:]]
            found.update((n, v) for n, v in zip(names, moved, strict=True) if found[n] is None)
        return found

    def determined_starts(self, measured: Collection[str]) -> list[str]:
        """Return the names of the initial velocities, angles and rates that these channels determine.

        A side view determines only the velocities in its plane.
        """
        blind = [
            f"initial_{name}"
            for name, place, speed in zip(self.rates, self.pose, self.velocity, strict=True)
            if place not in measured and speed not in measured
        ]
        return [p.name for p in self.parameters if p.name.startswith("initial_") and p.name not in blind]

    def _posed(self, values: Array, trial: Trial) -> Array:
        """Return the pose of the reference point at the first sample, shape (6,)."""
        pose = np.array(trial.swim.posed(6), dtype=float)
        return pose + [self.value(values, name) for name in self.starts]

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
        speed = np.array([self.value(values, f"initial_{name}") for name in self.rates])
        spin = speed[3:] * SIGNS
        start[7 + passives : 10 + passives] = speed[:3] - np.cross(spin, self.tree.reference)
        start[10 + passives : 13 + passives] = spin

    def integrate(self, run: Run) -> tuple[Array, Array]:
        """Integrate the equations of motion, and return the states and their time derivatives."""
        states, rates = engine.integrate(run.start, run.grid.step_s, run.drive.table, *run.tables.values())
        return states, rates

    def observed(self, values: Array, trial: Trial, states: Array) -> dict[str, Array]:
        """Return the channels of pose and velocity of the reference point."""
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


def _sound(quaternions: Array) -> Array:
    """Return quaternions in which those of a simulation that broke down are replaced by the identity."""
    broken = ~np.isfinite(quaternions).all(axis=1, keepdims=True)
    return np.where(broken, [0.0, 0.0, 0.0, 1.0], quaternions)
