"""What is known of a trial beside its samples, by the family of its experiment.

Every trial has all of them; where an experiment knows nothing of a kind, its fields are at their defaults,
which say so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from swimid.fitting.drives import Array, Beat, Cycle, Motion


@dataclass(frozen=True)
class RigInput:
    """A body on a test rig."""

    #: Known part, kg or kg m2, pulling mass and pulley included; NaN where none is known.
    inertia: float = math.nan
    #: Constant known force, N.
    force: float | None = None
    #: A pulley's friction acts.
    pulley: bool = False
    #: ``rho A / 2``, kg/m; 0 where the quadratic coefficient itself is estimated.
    area_factor: float = 0.0
    #: Time of release; zero where none is stated.
    release_s: float | None = None
    #: Displacement at release, m or rad.
    x0: float = 0.0

    @property
    def pull(self) -> float:
        """The constant force, N; 0 where there is none."""
        return 0.0 if self.force is None else self.force

    @property
    def begin_s(self) -> float:
        """Time of release, s."""
        return 0.0 if self.release_s is None else self.release_s


@dataclass(frozen=True)
class SwimInput:
    """A robot with links."""

    beat: Beat | None = None
    stroke: Cycle | None = None
    #: Of each driven joint, in place of a drive: its motion at given times, s.
    joints: Sequence[Callable[[Array], Motion]] | None = None
    #: The joints' motions are what they were told, not what was measured of them.
    commanded: bool = False
    #: Of the reference point at the first sample, from which the start offsets count.
    pose: tuple[float, ...] | None = None
    #: Those that were set otherwise in this trial.
    coefficients: Mapping[str, float] | None = None

    @property
    def drive(self) -> Beat | Cycle | None:
        """The beat or the stroke; None where measured joints, or nothing, move it."""
        return self.stroke if self.beat is None else self.beat

    @property
    def steady(self) -> bool:
        """Whether the run begins on the limit cycle of its drive."""
        return self.drive is not None and self.drive.steady

    def begun(self) -> SwimInput:
        """Return the same run in steady swimming: it begins on the limit cycle of its drive."""
        if self.stroke is not None:
            return replace(self, stroke=replace(self.stroke, steady=True, ramp_s=0.0, cycles=math.inf))
        if self.beat is None:
            return self
        return replace(self, beat=replace(self.beat, steady=True, ramp_s=0.0))

    @property
    def measured(self) -> bool:
        """Measured joints move it: they are what the actuators did."""
        return self.joints is not None and not self.commanded

    def posed(self, count: int = 3) -> tuple[float, ...]:
        """The start pose; at the origin where none is known."""
        return (0.0,) * count if self.pose is None else self.pose


@dataclass(frozen=True)
class CruiseInput:
    """Timed runs of one fin."""

    fin: str = ""
    #: Hydrodynamic inertia of the fin, where it is known.
    inertia_kg_m2: float | None = None
    #: Frequency (Hz) and amplitude (rad) about which the exponents of the law count.
    middle: tuple[float, float] = (1.0, 1.0)
    #: Rows of the table.
    rows: NDArray[np.intp] | None = None


@dataclass(frozen=True)
class SurgeInput:
    """A steady beat of which only the mean over each beat is looked at."""

    #: NaN where there is no such beat.
    frequency_hz: float = math.nan
    amplitude_rad: float = math.nan
    #: Time of the first sample.
    start_s: float = 0.0
