"""What models of robots with links have in common, in a plane or in space."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from swimid.fitting.body import Axis
from swimid.fitting.energetics import Energetics
from swimid.fitting.inputs import SwimInput
from swimid.fitting.model import Array, Model, Trial
from swimid.robots.file import Robot


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
