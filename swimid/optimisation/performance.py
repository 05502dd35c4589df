"""What a robot comes to under given gaits, many drives and coefficients at once, and what a study says."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError, suggestion
from swimid.fitting.drives import Beat, SwimInput
from swimid.fitting.model import Array
from swimid.fitting.parallel import map_in_threads
from swimid.logs.trials import StrokeDrive
from swimid.optimisation.options import GaitOptions
from swimid.results import parameters as parameters_format
from swimid.simulation import catalogue, swim_quantities
from swimid.simulation.catalogue import Applied, Quantity
from swimid.simulation.swim_quantities import Steady
from swimid.swimmer import trials as swimmer
from swimid.swimmer.model import Swimmer

#: What of a drive may be varied, with its unit: of a beat, and of a stroke.
BEAT = {"frequency_hz": "Hz", "amplitude_deg": "deg", "bias_deg": "deg", "asymmetry": "1", "lag_deg": "deg"}
STROKE = {"frequency_hz": "Hz", "scale": "1"}
#: What each may be at most and at least, where that is not told by its nature alone.
LIMITS = {"frequency_hz": (0.0, math.inf), "amplitude_deg": (0.0, 180.0), "asymmetry": (-0.8, 0.8)}
#: Runs that are simulated by one call: those that take no longer than one.
TOGETHER = 8

Point = Mapping[str, float]


@dataclass(frozen=True)
class Performance:
    """A robot with its coefficients, and the drive that gaits depart from.

    Attributes
    ----------
    applied : Applied
        Of a robot with links.
    drive : mapping of str to float
        Of :data:`BEAT`, or of :data:`STROKE` where ``stroke`` is named; what is missing must be varied.
    waveform, stroke : str
    ramp_s, duration_s : float
        Each run starts from rest.
    """

    applied: Applied
    drive: Mapping[str, float]
    waveform: str = "sine"
    stroke: str | None = None
    ramp_s: float = 1.0
    duration_s: float = 15.0

    @classmethod
    def of_options(cls, options: GaitOptions) -> Performance:
        """The robot and the drive that the options of a verb describe.

        Raises
        ------
        UsageError, InputError
            For anything missing, and for anything wrong in a file.
        """
        path = None if options.params is None else parameters_format.place(options.params)
        file = None if options.params is None else catalogue.read_parameters(options.params)
        if file is not None and file.model not in ("multilink", "multibody"):
            raise UsageError(f"gaits are those of a robot with links, not of the model '{file.model}'")
        if file is None and options.robot is None:
            raise UsageError("name a parameter file (--params) or a robot (--robot)")
        if file is None or path is None:
            name, folder, known = str(options.robot), None, {}
        else:
            name, folder = catalogue.robot_of_parameters(file, path, options.robot)
            known = file.settings.get("readings", {})
        _, model = swimmer.robot_model(
            name, folder, readings={**known, **options.readings}, max_step=options.dt
        )
        if not model.driven:
            raise UsageError(f"the robot '{model.robot.name}' has no driven joint: there is no gait")
        names = STROKE if options.stroke is not None else BEAT
        given = {n: float(v) for n in names if (v := getattr(options, n)) is not None}
        made = cls(
            Applied(model, file, path, options.chosen),
            given,
            options.waveform,
            options.stroke,
            options.ramp_s,
            options.duration_s,
        )
        try:
            model.check(made.applied.values())
        except InputError as error:
            raise InputError(f"with these parameters, {error.reason}", file=path) from error
        return made

    @property
    def model(self) -> Swimmer:
        """The robot's model."""
        assert self.applied.model.swimmer is not None
        return self.applied.model.swimmer

    @property
    def turn(self) -> str:
        """What turning is called in the robot's plane."""
        return self.model.pose[2].removesuffix("_rad")

    @cached_property
    def values(self) -> Array:
        """The coefficients as they are given, with the rest at its neutral values."""
        return self.applied.values()

    @cached_property
    def units(self) -> dict[str, str]:
        """The quantities of a run with their units, in the order of :meth:`table`."""
        return swim_quantities.known(self.model)

    @property
    def axes(self) -> dict[str, str]:
        """What may be varied, with its unit: the drive, and every coefficient of the robot."""
        drive = STROKE if self.stroke is not None else BEAT
        shared = {p.name: p.unit for p in self.model.parameters if not p.per_trial}
        return {**drive, **shared}

    @property
    def identified(self) -> dict[str, tuple[float, float]]:
        """The range of the drives that the coefficients were identified from; empty where it is not told."""
        fit = self.applied.file.fit if self.applied.file is not None else None
        told = (fit.model_extra or {}).get("drives", {}) if fit is not None else {}
        return {name: (float(low), float(high)) for name, (low, high) in told.items()}

    def check(self, varied: Mapping[str, tuple[float, float]], option: str) -> None:
        """Refuse what cannot be varied over these ranges.

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
        """Refuse a drive with something missing that is not varied either.

        Raises
        ------
        UsageError
        """
        # a stroke has a frequency and a size of its own
        for name in ("frequency_hz", "amplitude_deg") if self.stroke is None else ():
            if name not in varied and name not in self.drive:
                flag = name.replace("_", "-")
                raise UsageError(f"the drive needs --{flag}, or {name} among what is varied ({option})")

    def swim(self, point: Point) -> tuple[SwimInput, float]:
        """The drive at a point, and its frequency in Hz."""
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

    def steady(self, point: Point) -> Steady:
        """The run at a point."""
        swim, frequency = self.swim(point)
        name = " ".join(f"{key}={value!r}" for key, value in point.items() if key in BEAT | STROKE)
        return Steady.driven(self.model, f"gait {name}", swim, frequency, self.duration_s)

    def at(self, point: Point, values: Array | None = None) -> Array:
        """The parameter vector at a point."""
        moved = (self.values if values is None else values).copy()
        for name, value in point.items():
            if name not in BEAT | STROKE:
                moved[self.model.index(name)] = value
        return moved

    def quantities(
        self, points: Sequence[Point], values: Sequence[Array] | None = None
    ) -> list[dict[str, Quantity]]:
        """What runs come to; nothing where one breaks down.

        Parameters
        ----------
        values : sequence of ndarray, optional
            The coefficients of each point; what the point says itself wins.
        """
        runs = [self.steady(point) for point in points]
        vectors = [self.at(p, None if values is None else values[k]) for k, p in enumerate(points)]
        pairs = [(vector, run.trial) for vector, run in zip(vectors, runs, strict=True)]
        simulated = self.model.with_energetics(pairs, [run.window.length_s for run in runs])
        found: list[dict[str, Quantity]] = [
            {} if energetics is None else run.quantities(self.model, vector, columns, energetics)
            for run, vector, (columns, energetics) in zip(runs, vectors, simulated, strict=True)
        ]
        self.model.forget([run.trial for run in runs])
        return found

    def table(self, points: Sequence[Point], values: Sequence[Array] | None = None) -> Array:
        """The quantities of points, shape (n, quantities); NaN where there is none."""
        found = self.quantities(points, values)
        return np.array([[q[n].value if n in q else math.nan for n in self.units] for q in found])

    def many(self, points: Sequence[Point], values: Sequence[Array] | None = None, *, jobs: int) -> Array:
        """The same, shared among threads."""
        parts = [slice(k, k + TOGETHER) for k in range(0, len(points), TOGETHER)]

        def one(part: slice) -> Array:
            return self.table(points[part], None if values is None else values[part])

        with map_in_threads(one, parts, jobs) as results:
            return np.concatenate(list(results))

    def with_errors(self, point: Point) -> Array:
        """The quantities of a point and their standard errors, shape (quantities, 2)."""
        values = self.at(point)
        ends = self.applied.neighbours(values)
        vectors = [values, *(vector for pair in ends for vector in pair)]
        centre, *sides = self.quantities([point] * len(vectors), vectors)
        pairs = list(zip(sides[::2], sides[1::2], strict=True))
        carried = self.applied.carried(values, centre, pairs)
        lost = Quantity(math.nan, "1", math.nan)
        told = [carried.get(name, lost) for name in self.units]
        return np.array([[q.value, math.nan if q.stderr is None else q.stderr] for q in told])

    def insist(self, table: Array) -> None:
        """Refuse a study of which every run broke down, or in which the robot rests throughout.

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
        if "mean_speed_m_s" in self.units:
            self.insist_motion(table[:, list(self.units).index("mean_speed_m_s")])

    @staticmethod
    def insist_motion(speed_m_s: Array) -> None:
        """Refuse a study of a robot that does not move under any of its beats.

        Raises
        ------
        NoTrustworthyResult
        """
        if not np.nanmax(speed_m_s) > 0:
            raise NoTrustworthyResult(
                "the robot rests under each of these beats", hint="give a beat it swims by: --amplitude-deg"
            )


def points_of(axes: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the points of a grid, the last axis fastest."""
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]
