"""Quantities of a robot under given gaits, for many drives and coefficients at once.

A quantity is a result of a simulation, such as the mean speed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.fitting.drives import Beat
from swimid.fitting.model import Array, SwimInput
from swimid.fitting.problem import map_in_threads
from swimid.logs.trials import StrokeDrive
from swimid.optimisation.options import GaitOptions
from swimid.simulation import catalogue, swim_quantities
from swimid.simulation.catalogue import Applied, Quantity
from swimid.simulation.swim_quantities import SwimRun
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

#: Drive parameters that may be varied, with their units: for a beat, and for a stroke.
BEAT = {"frequency_hz": "Hz", "amplitude_deg": "deg", "bias_deg": "deg", "asymmetry": "1", "lag_deg": "deg"}
STROKE = {"frequency_hz": "Hz", "scale": "1"}
#: Minimum and maximum values of drive parameters.
LIMITS = {"frequency_hz": (0.0, math.inf), "amplitude_deg": (0.0, 180.0), "asymmetry": (-0.8, 0.8)}
#: Number of gaits that are simulated together.
BATCH = 8

Point = Mapping[str, float]


@dataclass(frozen=True)
class Performance:
    """Robot with its coefficients and its drive. A gait varies some of the drive parameters or coefficients.

    Attributes
    ----------
    applied : Applied
        Model and coefficients of a robot with links.
    drive : mapping of str to float
        Values of the parameters in :data:`BEAT`, or in :data:`STROKE` if ``stroke`` is given. Gaits must vary
        the parameters that are missing here.
    waveform, stroke : str
    ramp_s, duration_s : float
        Ramp of the drive, and length of each simulation. Simulations start from rest.
    """

    applied: Applied
    drive: Mapping[str, float]
    waveform: str = "sine"
    stroke: str | None = None
    ramp_s: float = 1.0
    duration_s: float = 15.0

    @classmethod
    def of_options(cls, options: GaitOptions) -> Performance:
        """Return the robot and the drive that the options of a command describe.

        Raises
        ------
        UsageError, InputError
            For missing options, and for bad files.
        """
        file = None
        if options.params is not None:
            file = catalogue.read_parameters(options.params)
            if file.model not in ("multilink", "multibody"):
                raise UsageError(f"gaits are those of a robot with links, not of the model '{file.model}'")
        applied = catalogue.load_robot(options, file)
        names = STROKE if options.stroke is not None else BEAT
        stated = {name: getattr(options, name) for name in names}
        drive = {name: float(value) for name, value in stated.items() if value is not None}
        made = cls(applied, drive, options.waveform, options.stroke, options.ramp_s, options.duration_s)
        if not made.model.driven:
            raise UsageError(f"the robot '{made.model.robot.name}' has no driven joint: there is no gait")
        return made

    @property
    def model(self) -> Swimmer:
        """Model of the robot."""
        assert self.applied.model.swimmer is not None
        return self.applied.model.swimmer

    @property
    def turn(self) -> str:
        """Name of the rotation in the plane of the robot: ``yaw`` or ``pitch``."""
        return self.model.pose[2].removesuffix("_rad")

    @cached_property
    def values(self) -> Array:
        """Parameter vector with the given coefficients. Per-trial parameters have their neutral values."""
        return self.applied.values()

    @cached_property
    def units(self) -> dict[str, str]:
        """Quantities of a simulation with their units, in the order of :meth:`table`."""
        return swim_quantities.units_of(self.model)

    @property
    def axes(self) -> dict[str, str]:
        """Drive parameters and coefficients of the robot that may be varied, with their units."""
        drive = STROKE if self.stroke is not None else BEAT
        shared = {p.name: p.unit for p in self.model.parameters if not p.per_trial}
        return {**drive, **shared}

    @property
    def identified(self) -> dict[str, tuple[float, float]]:
        """Range of each drive parameter in the identification trials; empty if unknown."""
        file = self.applied.file
        if file is None or file.fit is None:
            return {}
        drives = (file.fit.model_extra or {}).get("drives", {})
        return {name: (float(low), float(high)) for name, (low, high) in drives.items()}

    def check(self, varied: Mapping[str, tuple[float, float]], option: str) -> None:
        """Raise an error for names that cannot be varied, and for impossible ranges.

        Raises
        ------
        UsageError
        """
        parameters = {p.name: p for p in self.model.parameters}
        for name, (low, high) in varied.items():
            if name not in self.axes:
                hint = suggestion(name, list(self.axes), "there are")
                raise UsageError(f"{option}: there is no '{name}'", hint=hint)
            if name in self.applied.chosen:
                raise UsageError(f"{option}: {name} is held by --set")
            if not low < high:
                raise UsageError(f"{option} {name}: {low:g} is not below {high:g}")
            least, most = LIMITS.get(name, (-math.inf, math.inf))
            if name in parameters:
                least, most = parameters[name].lower, parameters[name].upper
            if low < least or high > most or (name == "frequency_hz" and low == 0):
                raise UsageError(f"{option} {name}: lies between {least:g} and {most:g}")
        if self.waveform != "a-cpg" and ("asymmetry" in varied or self.drive.get("asymmetry")):
            raise UsageError("asymmetry belongs to --waveform a-cpg")

    def check_drive(self, varied: Collection[str], option: str) -> None:
        """Raise an error if a parameter of the drive is neither given nor varied.

        Raises
        ------
        UsageError
        """
        if self.stroke is not None:  # a stroke has its own frequency and size
            return
        for name in ("frequency_hz", "amplitude_deg"):
            if name not in varied and name not in self.drive:
                flag = name.replace("_", "-")
                raise UsageError(f"the drive needs --{flag}, or {name} among what is varied ({option})")

    def swim(self, point: Point) -> tuple[SwimInput, float]:
        """Return the drive of a gait, and its frequency in Hz."""
        drive = {**self.drive, **{name: value for name, value in point.items() if name in BEAT | STROKE}}
        pose = (0.0,) * len(self.model.pose) if self.model.free_base else None
        if self.stroke is not None:
            told = StrokeDrive(
                stroke=self.stroke,
                frequency_hz=drive.get("frequency_hz"),
                scale=drive.get("scale", 1.0),
                ramp_s=0.0,
            )
            cycle = swimmer.cycle_of(told, self.model)  # type: ignore[arg-type]
            return SwimInput(stroke=cycle, pose=pose), cycle.frequency_hz
        beat = Beat(
            self.waveform,
            drive["frequency_hz"],
            math.radians(drive["amplitude_deg"]),
            math.radians(drive.get("bias_deg", 0.0)),
            drive.get("asymmetry", 0.0),
            self.ramp_s,
            lag_rad=math.radians(drive.get("lag_deg", 0.0)),
        )
        return SwimInput(beat, pose=pose), beat.frequency_hz

    def run(self, point: Point) -> SwimRun:
        """Return the simulation settings of a gait."""
        swim, frequency = self.swim(point)
        name = " ".join(f"{key}={value!r}" for key, value in point.items() if key in BEAT | STROKE)
        return SwimRun.driven(self.model, f"gait {name}", swim, frequency, self.duration_s)

    def at(self, point: Point, values: Array | None = None) -> Array:
        """Return the parameter vector for a gait."""
        if values is None:
            values = self.values
        moved = values.copy()
        for name, value in point.items():
            if name not in BEAT | STROKE:
                moved[self.model.index(name)] = value
        return moved

    def quantities(
        self, points: Sequence[Point], values: Sequence[Array] | None = None
    ) -> list[dict[str, Quantity]]:
        """Return the quantities of gaits, by name; empty for a simulation that breaks down.

        Parameters
        ----------
        values : sequence of ndarray, optional
            Parameter vector for each gait. Coefficients that the gait varies replace its entries.
        """
        runs = [self.run(point) for point in points]
        given = [self.values] * len(points) if values is None else values
        vectors = [self.at(point, vector) for point, vector in zip(points, given, strict=True)]
        pairs = [(vector, run.trial) for vector, run in zip(vectors, runs, strict=True)]
        simulated = self.model.with_energetics(pairs, [run.window.duration_s for run in runs])
        found: list[dict[str, Quantity]] = []
        for run, vector, (columns, energetics) in zip(runs, vectors, simulated, strict=True):
            quantities = {}
            if energetics is not None:
                quantities = run.quantities(self.model, vector, columns, energetics)
            found.append(quantities)
        self.model.forget([run.trial for run in runs])
        return found

    def table(self, points: Sequence[Point], values: Sequence[Array] | None = None) -> Array:
        """Return the quantities of gaits, shape (n, quantities); NaN for a quantity that is not available."""
        lost = Quantity(math.nan, "")
        found = self.quantities(points, values)
        return np.array([[quantities.get(name, lost).value for name in self.units] for quantities in found])

    def many(self, points: Sequence[Point], values: Sequence[Array] | None = None, *, jobs: int) -> Array:
        """Return the quantities of gaits as :meth:`table` does, computed in several threads."""
        parts = [slice(k, k + BATCH) for k in range(0, len(points), BATCH)]

        given = [self.values] * len(points) if values is None else values

        def one(part: slice) -> Array:
            return self.table(points[part], given[part])

        with map_in_threads(one, parts, jobs) as results:
            return np.concatenate(list(results))

    def with_errors(self, point: Point) -> Array:
        """Return the quantities of a gait and their standard errors, shape (quantities, 2)."""
        carried = self.applied.with_errors(
            self.at(point), lambda vectors: self.quantities([point] * len(vectors), vectors)
        )
        lost = Quantity(math.nan, "")
        told = [carried.get(name, lost) for name in self.units]
        return np.array([[quantity.value, quantity.stderr] for quantity in told], dtype=float)

    def insist(self, table: Array) -> None:
        """Raise an error if every simulation breaks down, or if the robot never moves.

        Parameters
        ----------
        table : ndarray, shape (n, quantities)

        Raises
        ------
        NoTrustworthyResult
        """
        if not np.isfinite(table).any():
            raise NoTrustworthyResult(
                "every simulation breaks down",
                hint="check the parameters' signs and units, narrow the ranges, or take a smaller --dt",
            )
        units = list(self.units)
        if "mean_speed_m_s" in units and not np.nanmax(table[:, units.index("mean_speed_m_s")]) > 0:
            raise NoTrustworthyResult(
                "the robot rests under each of these beats", hint="give a beat it swims by: --amplitude-deg"
            )


def points_of(axes: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the points of a grid. The last axis varies fastest."""
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
