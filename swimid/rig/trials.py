"""Keys and known quantities of trials on a rig, and displacements that an encoder measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import PositiveFloat

from swimid.errors import InputError
from swimid.fitting.model import Array
from swimid.logs.experiments import TrialEntry
from swimid.logs.sampling import step_of
from swimid.robots.file import Robot

MASS_KEY = "inertial_mass_kg"


class RigTrial(TrialEntry):
    """Keys of a trial on a single-degree-of-freedom rig. Their values replace those of the robot file."""

    inertial_mass_kg: PositiveFloat | None = None
    frontal_area_m2: PositiveFloat | None = None
    fluid_density_kg_m3: PositiveFloat | None = None


def mass_of(entry: RigTrial, robot: Robot, path: Path) -> float:
    """Return the inertial mass of a trial, or else that of the robot, kg.

    Raises
    ------
    InputError
        If neither the trial nor the robot file states it.
    """
    mass = entry.inertial_mass_kg
    if mass is None:
        mass = robot.body.inertial_mass_kg
    if mass is None:
        raise InputError(
            f"the trial '{entry.id}' has no inertial mass",
            file=path,
            column=MASS_KEY,
            hint=f"give it in the trial, or as body.inertial_mass_kg of the robot '{robot.name}'",
        )
    return mass


def area_factors(entries: Sequence[RigTrial], robot: Robot, path: Path) -> list[float]:
    """Return the factor ``rho A / 2`` of the drag law for each trial, kg/m; zeros without a frontal area.

    ``rho`` is the density of the fluid, and ``A`` the frontal area of the body.

    Raises
    ------
    InputError
        If only some of the trials have a frontal area, or if one states a density without an area.
    """
    factors: list[float] = []
    for entry in entries:
        area = entry.frontal_area_m2 or robot.body.frontal_area_m2 or 0.0
        factors.append(0.5 * (entry.fluid_density_kg_m3 or robot.fluid.density_kg_m3) * area)
        if not area and entry.fluid_density_kg_m3 is not None:
            raise InputError(
                f"the density of the fluid in '{entry.id}' has no effect without a frontal area",
                file=path,
                column="fluid_density_kg_m3",
                hint="give frontal_area_m2 in the trial or in the robot file",
            )
    if any(factors) and not all(factors):
        missing = entries[factors.index(0.0)].id
        raise InputError(
            f"some trials have a frontal area and '{missing}' has none", file=path, column="frontal_area_m2"
        )
    return factors


# ------------------------------------------------------------ encoder


@dataclass(frozen=True)
class Displacement:
    """Displacement record of a trial on a rig, with its known measurement errors.

    Attributes
    ----------
    kind : str
        ``continuous``: there is no encoder. ``clicks``: there is one row for each step of the encoder, so
        that the displacement is exact and the time has an error. ``sampled``: the rows are the count of the
        encoder at regular times.
    time_s, position : ndarray, shape (n,)
        Samples of the record. If ``rounded`` is 0 or 1, these are the times at which a sampled count changed.
    time_sd_s : float or ndarray, shape (n,)
        Standard deviation of the times, due to the sampling interval.
    position_sd : float
        Standard deviation of the positions, due to the step of the encoder.
    shifts : dict of str to float
        True position minus position for each possible rounding of the count (:data:`ROUNDINGS`); empty if the
        positions are not those of a sampled count.
    """

    kind: Literal["continuous", "clicks", "sampled"]
    time_s: Array
    position: Array
    time_sd_s: float | Array = 0.0
    position_sd: float = 0.0
    shifts: Mapping[str, float] = field(default_factory=dict)


#: Possible roundings of an encoder count. Each has the difference of true position and count, in encoder
#: steps, in three cases: when the count rises, when it falls, and on average while it is constant.
ROUNDINGS = {"floor": (0.0, 1.0, 0.5), "nearest": (-0.5, 0.5, 0.0), "ceil": (-1.0, 0.0, -0.5)}


def read_encoder(time_s: Array, position: Array, resolution: float | None = None) -> Displacement:
    """Detect an encoder in a displacement record, and return the record with its measurement errors.

    Parameters
    ----------
    resolution : float, optional
        Known step of the encoder. It is needed for records that move several steps per sample.
    """
    plain = Displacement("continuous", time_s, position)
    step = step_of(position)
    if step is None:
        return plain
    counts = np.round((position - position[0]) / step).astype(int)
    moves = np.diff(counts)
    forward = moves[moves != 0]
    if len(forward) < 3 or np.mean(np.sign(forward) == np.sign(np.median(forward))) < 0.98:
        # Rounded noisy values rise and fall, but the count of an encoder moves in one direction.
        return plain
    if np.mean(np.abs(moves) == 1) > 0.9 and np.std(np.diff(time_s)) >= 0.02 * np.mean(np.diff(time_s)):
        return Displacement("clicks", time_s, position)
    if np.median(np.abs(moves)) <= 1 and np.mean(moves == 0) > 0.05:
        at = np.flatnonzero(moves) + 1
        gap = time_s[at] - time_s[at - 1]
        # If the count changed by m steps within an interval, assign the middle one of these m steps to the
        # middle of the interval.
        middle = position[at] - 0.5 * (moves[at - 1] - np.sign(moves[at - 1])) * step
        times = time_s[at] - 0.5 * gap
        # The time of the change is uniformly distributed between two samples. Its standard deviation is the
        # sampling interval divided by sqrt(12).
        falls = int(middle[-1] < middle[0])
        shifts = {name: step * shares[falls] for name, shares in ROUNDINGS.items()}
        return Displacement("sampled", times, middle, time_sd_s=gap / np.sqrt(12.0), shifts=shifts)
    if np.median(np.abs(moves)) <= 3 or (resolution is not None and abs(step / resolution - 1) < 0.02):
        shifts = {name: step * shares[2] for name, shares in ROUNDINGS.items()}
        return Displacement("sampled", time_s, position, position_sd=step / np.sqrt(12.0), shifts=shifts)
    return plain


def true_position(record: Displacement, rounding: str) -> Array:
    """Return the true positions of an encoder record under an assumed rounding of its counts.

    The rounding is a key of :data:`ROUNDINGS`. A record that was not counted is returned unchanged.
    """
    return record.position + record.shifts.get(rounding, 0.0)
