"""Interface of models of robots with links, in a plane or in space."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from swimid.fitting.drives import SwimInput
from swimid.fitting.model import Array, Model, Trial
from swimid.robots.file import Robot
from swimid.robots.planar import Driven


@dataclass(frozen=True)
class Axis:
    """A joint (or hinge) of a robot file that moves, its column in a log, and the link it turns."""

    joint: Any
    column: str
    link: int

    @property
    def name(self) -> str:
        """Of the joint."""
        return str(self.joint.name)

    @property
    def driven(self) -> Driven | None:
        """How it follows the drive; None where it yields."""
        law: Driven | None = self.joint.driven
        return law

    @property
    def rate(self) -> str:
        """The column of its rate."""
        return self.column.replace("_rad", "_rate_rad_s")


@dataclass(frozen=True)
class Energetics:
    """What the joints of a run do, over its integration grid.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Even.
    torque_N_m, rate_rad_s : ndarray, shape (m, driven joints)
        Generalised force of each driven joint, on the link behind it, and its rate.
    passive_torque_N_m, passive_rate_rad_s : ndarray, shape (m, passive joints)
        The same of joints that yield: what spring, wire and damper do.
    kinetic_J : ndarray, shape (m,)
        Kinetic energy of the robot and of the water it carries along.
    stored_J : ndarray, shape (m,)
        In the springs of passive joints.
    water_W : ndarray, shape (m,)
        Power given to the water by drag, foils and trailing edges.
    weight_W : ndarray, shape (m,)
        Power given to constant forces: weight and buoyancy.
    dissipated_W : ndarray, shape (m,)
        Power lost in the dampers of passive joints.
    """

    time_s: Array
    torque_N_m: Array
    rate_rad_s: Array
    passive_torque_N_m: Array
    passive_rate_rad_s: Array
    kinetic_J: Array
    stored_J: Array
    water_W: Array
    weight_W: Array
    dissipated_W: Array

    @property
    def power_W(self) -> Array:
        """Mechanical power of each driven joint, shape (m, driven joints)."""
        return self.torque_N_m * self.rate_rad_s

    def mean(self, power_W: Array) -> float:
        """Mean of a power over the whole time, W; of even samples, by the trapezoidal rule."""
        return float(np.trapezoid(power_W, self.time_s) / (self.time_s[-1] - self.time_s[0]))

    def mean_power_W(self) -> float:
        """Mean mechanical power of all driven joints, W: what they give less what they take back."""
        return self.mean(self.power_W.sum(axis=1))

    def mean_positive_power_W(self) -> float:
        """The same for motors that give nothing back: each joint's negative power counts as none, W."""
        return self.mean(np.maximum(self.power_W, 0.0).sum(axis=1))

    def balance_J(self) -> tuple[float, float]:
        """Energy the driven joints gave, and what went into water, weight, dampers, springs and motion, J."""
        duration = self.time_s[-1] - self.time_s[0]
        gone = duration * self.mean(self.water_W + self.weight_W + self.dissipated_W)
        kept = self.kinetic_J + self.stored_J
        return duration * self.mean_power_W(), gone + float(kept[-1] - kept[0])


class Cruise(NamedTuple):
    """Steady swimming of a model.

    Attributes
    ----------
    speed_m_s : float
        Path length over one period of the drive, over the period; NaN where the speed never settles.
    settling_s : float
        Time in which a difference from the steady speed falls by a factor e; infinite where it never settles.
    """

    speed_m_s: float
    settling_s: float


class Swimmer(Model):
    """A robot with links: driven and passive joints, on a base that moves or is held."""

    robot: Robot
    #: Longest step of the integration, s.
    max_step: float
    #: Channels of the reference point.
    pose: tuple[str, ...]
    velocity: tuple[str, ...]
    driven: Sequence[Axis]
    passive: Sequence[Axis]
    free_base: bool
    #: Those of the robot file, the first of the parameters.
    coefficients: list[str]
    #: Per-trial offsets of the start pose.
    starts: tuple[str, ...]

    @property
    def swimmer(self) -> Swimmer:
        """Itself."""
        return self

    @abstractmethod
    def refined(self) -> Swimmer:
        """The same model with half the integration step."""

    @abstractmethod
    def read_otherwise(self, robot: Robot) -> Swimmer:
        """The same model of the same robot, of whose source something was read otherwise.

        Its parameters are this model's where both have the same.
        """

    @abstractmethod
    def check(self, values: Array) -> None:
        """Refuse coefficients that make masses no body has.

        Raises
        ------
        InputError
        """

    @abstractmethod
    def command(self, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Array:
        """What a driven joint is told to do, rad."""

    @abstractmethod
    def with_energetics(
        self, runs: Sequence[tuple[Array, Trial]], last_s: Sequence[float]
    ) -> list[tuple[dict[str, Array], Energetics | None]]:
        """Several runs, each as :meth:`simulate`, with torques and powers over its last stretch each.

        Parameters
        ----------
        last_s : sequence of float
            Length of that stretch of each, s; rounded to whole integration steps.

        Returns
        -------
        list of (channels, Energetics)
            NaN throughout, and None, where a run breaks down.
        """

    def cruise(self, values: Array, trial: Trial) -> Cruise | None:
        """Speed at which the model settles under a trial's drive.

        Returns
        -------
        Cruise or None
            None where the question has no answer: no periodic drive, a fixed base, or motion in space.
        """
        return None

    @abstractmethod
    def forget(self, trials: Sequence[Trial]) -> None:
        """Let go of what is kept of trials that will not be simulated again."""

    @abstractmethod
    def yielding(self) -> list[str]:
        """The coefficients that stand in the law of a passive joint."""

    @abstractmethod
    def final_state(self, columns: Mapping[str, Array]) -> dict[str, float]:
        """Velocities, passive angles and rates at the end of a run, by the parameters of a start."""

    def with_buoyancy(self, factor: float) -> Swimmer | None:
        """The same model with every volume that displaces water multiplied; None where none does."""
        return None

    def stated(self) -> dict[str, float]:
        """The robot file's values of its coefficients."""
        body = self.robot.multibody or self.robot.multilink
        return {name: c.value for name, c in body.coefficients.items()} if body else {}

    def given(self, trial: Trial) -> list[str]:
        """Measured joints that drive the run where no servo follows them."""
        if trial.swim.joints is None:
            return []
        return [a.column for a in self.driven if a.driven is not None and a.driven.servo is None]
