"""Simulation of many gaits of a robot at once, and code that the optimisation commands share.

A study is the computation of one map, stiffness rule or best gait. A quantity is a result of a simulation,
such as the mean speed.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance, yamlio
from swimid.files.atomic import Checkpoint
from swimid.files.provenance import Input
from swimid.fitting import fit_common
from swimid.fitting.model import Array, SwimInput
from swimid.fitting.problem import choose_step, map_in_threads
from swimid.notices import Notice, Progress, silent
from swimid.optimisation.options import GaitOptions
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.robots import file as robot_format
from swimid.simulation import cases, catalogue
from swimid.simulation.cases import BEAT, STROKE, SwimRun, check_drive, list_drive_options, swim_input
from swimid.simulation.catalogue import Applied
from swimid.swimmer.model import Swimmer

#: Minimum and maximum allowed values of drive parameters, by name. The units are in the names.
LIMITS = {"frequency_hz": (0.0, math.inf), "amplitude_deg": (0.0, 180.0), "asymmetry": (-0.8, 0.8)}
#: Number of gaits that are simulated in one batch.
BATCH_GAITS = 8
#: Maximum number of times that the integration step is halved for a single gait that diverges.
MAX_STEP_HALVINGS = 2

Point = Mapping[str, float]
#: Codes of two warnings about coefficients. The first warns of coefficients outside their bounds. The second
#: warns that the fit did not converge or could not identify a coefficient.
DOUBTFUL_CODES = ("SWM053", "SWM062")
#: Default values of drive parameters that a gait does not state.
NEUTRAL_DRIVE = {"bias_deg": 0.0, "asymmetry": 0.0, "lag_deg": 0.0, "scale": 1.0}
#: Minimum fraction of random samples of the coefficients that lie within the bounds of the coefficients.
MIN_INSIDE = 0.5
REFERENCES = [
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
    "D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu: Performance Optimization for Bionic Robotic "
    "Dolphin with Active Variable Stiffness Control",
    "Deb, Pratap, Agarwal, Meyarivan (2002): A fast and elitist multiobjective genetic algorithm: NSGA-II. "
    "IEEE Transactions on Evolutionary Computation 6, doi:10.1109/4235.996017",
]


@dataclass(frozen=True)
class Performance:
    """Robot with its coefficients and its drive, for simulations of gaits.

    A gait has values for the varied drive parameters and coefficients. The other parameters keep their
    values.

    Attributes
    ----------
    applied : Applied
        Model and coefficients of a robot with links.
    drive : mapping of str to float
        Values of the parameters in :data:`BEAT`, or in :data:`STROKE` for a stroke. Each gait must state the
        parameters that this mapping lacks.
    options : GaitOptions
        Waveform or stroke, ramp, and duration of each simulation. Simulations start from rest.
    """

    applied: Applied
    drive: Mapping[str, float]
    options: GaitOptions

    @classmethod
    def of_options(cls, options: GaitOptions) -> Performance:
        """Return the robot and the drive that the options of a command describe.

        Raises
        ------
        UsageError, InputError
            If an option is missing, or if a file is invalid.
        """
        file = None
        if options.params is not None:
            file, _ = catalogue.read_parameters(options.params)
            if file.model not in ("multilink", "multibody"):
                raise UsageError(f"the model '{file.model}' has no gait: only robots with links have one")
        made = cls(catalogue.load_robot(options, file), list_drive_options(options), options)
        if not made.model.driven:
            raise UsageError(f"the robot '{made.model.robot.name}' has no driven joint, which a gait needs")
        return made

    @property
    def model(self) -> Swimmer:
        """Simulation model of the robot."""
        assert self.applied.model.swimmer is not None
        return self.applied.model.swimmer

    @property
    def turn(self) -> str:
        """Name of the rotation in the plane in which the robot swims: ``yaw`` or ``pitch``."""
        return self.model.pose[2].removesuffix("_rad")

    @cached_property
    def values(self) -> Array:
        """Parameter vector of the model: given coefficients, and neutral values of per-trial parameters."""
        return self.applied.values()

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of the quantities of a simulation by their names, in the order of :meth:`table`."""
        return cases.units_of(self.model)

    @property
    def axes(self) -> dict[str, str]:
        """Units of the drive parameters and coefficients that gaits may vary, by their names."""
        drive = STROKE if self.options.stroke is not None else BEAT
        shared = {p.name: p.unit for p in self.model.parameters if not p.per_trial}
        return {**drive, **shared}

    @property
    def trial_ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each drive parameter in the trials of the fit, by name; empty if no range is known."""
        file = self.applied.file
        if file is None or file.fit is None:
            return {}
        drives = (file.fit.model_extra or {}).get("drives", {})
        return {name: (float(low), float(high)) for name, (low, high) in drives.items()}

    def check(self, varied: Mapping[str, tuple[float, float]], option: str) -> None:
        """Raise an error for parameters that gaits cannot vary, and for impossible ranges.

        Raises
        ------
        UsageError
        """
        parameters = {p.name: p for p in self.model.parameters}
        for name, (low, high) in varied.items():
            if name not in self.axes:
                text = f"{option}: the gait has no parameter '{name}'"
                raise UsageError(text, hint=suggestion(name, list(self.axes)))
            if name in self.applied.chosen:
                raise UsageError(f"{option}: {name} is fixed by --set and cannot be varied: omit either")
            if not low < high:
                raise UsageError(f"{option} {name}: {low:g} is not below {high:g}")
            least, most = LIMITS.get(name, (-math.inf, math.inf))
            if name in parameters:
                least, most = parameters[name].lower, parameters[name].upper
            if low < least or high > most or (name == "frequency_hz" and low == 0):
                raise UsageError(f"{option} {name}: the range must be within {least:g} to {most:g}")

    def check_gaits(self, varied: Mapping[str, tuple[float, float]], option: str) -> None:
        """Raise an error for parameters that gaits cannot vary, impossible ranges, or an incomplete drive."""
        self.check(varied, option)
        check_drive(self.options, varied, option)

    def at_step(self, ranges: Mapping[str, tuple[float, float]]) -> Performance:
        """Return the same robot with an integration step that is small enough at the ends of all ranges.

        Parameters
        ----------
        ranges : mapping of str to (float, float)
            Ranges of the varied parameters.
        """
        corners = points_of(ranges)
        runs = [(self.at(point), self.run(point).trial) for point in corners]
        chosen = choose_step(self.applied.model, runs)
        self.model.forget([trial for _, trial in runs])
        fit_common.step_check([trial.id for _, trial in runs], chosen.changes)
        return replace(self, applied=self.applied.at_step(chosen.model))

    def swim(self, point: Point) -> SwimInput:
        """Return the drive of the robot's joints over time for a gait."""
        varied = {name: value for name, value in point.items() if name in BEAT | STROKE}
        return swim_input(self.model, self.options, {**self.drive, **varied})

    def run(self, point: Point) -> SwimRun:
        """Return the simulation of a gait from rest, ready to be computed."""
        name = " ".join(f"{key}={value!r}" for key, value in point.items() if key in BEAT | STROKE)
        return SwimRun.simulate_drive(self.model, f"gait {name}", self.swim(point), self.options.duration_s)

    def at(self, point: Point, values: Array | None = None) -> Array:
        """Return the parameter vector of the model with the coefficients of a gait."""
        if values is None:
            values = self.values
        moved = values.copy()
        for name, value in point.items():
            if name not in BEAT | STROKE:
                moved[self.model.index(name)] = value
        return moved

    def table(self, points: Sequence[Point], values: Sequence[Array] | None = None) -> Array:
        """Simulate gaits, and return their quantities, shape (n, quantities). Unavailable quantities are NaN.

        Parameters
        ----------
        values : sequence of ndarray, optional
            Parameter vector for each gait. Coefficients that the gait varies replace its entries.
        """
        runs = [self.run(point) for point in points]
        given = [self.values] * len(points) if values is None else values
        vectors = [self.at(point, vector) for point, vector in zip(points, given, strict=True)]
        found = cases.quantities_of(self.model, runs, vectors)
        for k in np.flatnonzero(~np.isfinite(found).any(axis=1)):
            own = choose_step(self.applied.model, [(vectors[k], runs[k].trial)], halvings=MAX_STEP_HALVINGS)
            if own.halvings:
                found[k] = cases.quantities_of(own.model.swimmer, [runs[k]], [vectors[k]])[0]
        self.model.forget([run.trial for run in runs])
        return found

    def many(self, points: Sequence[Point], values: Sequence[Array] | None = None) -> Array:
        """Simulate gaits in several threads, and return their quantities in the form of :meth:`table`."""
        given = [self.values] * len(points) if values is None else values
        parts = [slice(k, k + BATCH_GAITS) for k in range(0, len(points), BATCH_GAITS)]
        tables = in_parallel(
            lambda k: self.table(points[parts[k]], given[parts[k]]), len(parts), self.options.jobs
        )
        return np.concatenate(tables)

    def with_errors(self, point: Point) -> Array:
        """Simulate a gait, and return its quantities and their standard errors, shape (quantities, 2)."""
        return np.column_stack(
            self.applied.with_errors(
                self.at(point), lambda vectors: self.table([point] * len(vectors), vectors)
            )
        )

    def insist(self, table: Array) -> None:
        """Raise an error if every simulation in a table diverged, or if the robot never moves.

        Parameters
        ----------
        table : ndarray, shape (n, quantities)

        Raises
        ------
        NoTrustworthyResult
        """
        if not np.isfinite(table).any():
            raise NoTrustworthyResult(
                "every simulation diverges",
                hint="check the parameters' signs and units, narrow the ranges, or take a smaller --dt",
            )
        units = list(self.units)
        if "mean_speed_m_s" in units and not np.nanmax(table[:, units.index("mean_speed_m_s")]) > 0:
            raise NoTrustworthyResult(
                "the robot does not swim with any of the beats that were simulated",
                hint="give a beat with which the robot swims, for example another --amplitude-deg",
            )


def points_of(axes: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Return the points of a grid with the given axes. The value on the last axis varies fastest."""
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


# ------------------------------------------------------------ study


class StudyFile(yamlio.ResultFile):
    """Base class of the contents of map, rule and gait files."""

    format: str
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    #: Parameters of the drive that the gaits do not vary.
    drive: dict[str, Any]
    duration_s: float
    #: Range of each drive parameter in the identification trials. Gaits outside this range are extrapolation.
    identified: dict[str, tuple[float, float]] = {}


Made = TypeVar("Made", bound=FileResult[Any])


@dataclass(frozen=True)
class OptimisationStudy:
    """Output path, checkpoint, provenance and first file keys for computing a map, rule or best gait.

    Attributes
    ----------
    origin : dict
        Provenance with the time and the command.
    head : dict
        First keys of the result file. Their provenance has no time, so that equal inputs give equal files.
    """

    output: Path | None
    checkpoint: Checkpoint
    origin: dict[str, Any]
    head: dict[str, Any]

    def save(self, made: type[Made], file: Any, evidence: ev.Evidence) -> Made:
        """Write file content and evidence to the output, if one is given; return both as a result."""
        file.verdict = evidence.verdict.level
        result = made.of(file, evidence).write_output(self.output)
        self.checkpoint.finish()
        return result


def study_of(performance: Performance, options: GaitOptions, output: Path | None) -> OptimisationStudy:
    """Return output path, checkpoint, provenance and first file keys for the options of a command.

    Raises
    ------
    InputError
        If the output cannot be written.
    """
    applied, given = performance.applied, options.params
    inputs: list[Input] = []
    name, folder, params = options.robot, None, None
    if given is not None:
        inputs.append(parameters_format.origin(given))
        place = parameters_format.source_path(given)
        params = place.name
        if name is None and applied.file is not None:
            name, folder = applied.file.robot, place.parent
    inputs.append(robot_format.locate(str(name), folder))
    if output is not None:
        atomic.check_writable(output, inputs=inputs)
    origin = provenance.collect(inputs, settings=options.settings())
    drive: dict[str, Any] = {"stroke": options.stroke, **performance.drive}
    if options.stroke is None:
        drive = {"waveform": options.waveform, **performance.drive, "ramp_s": options.ramp_s}
    head = {
        "verdict": "caution",
        "robot": performance.model.robot.name,
        "model": performance.model.name,
        "params": params,
        "drive": drive,
        "duration_s": options.duration_s,
        "identified": performance.trial_ranges,
        "provenance": {key: origin[key] for key in ("version", "inputs", "settings")},
    }
    return OptimisationStudy(
        output, Checkpoint.of_output(output, [origin["inputs"], origin["settings"]]), origin, head
    )


def in_parallel(
    work: Callable[[int], Array], count: int, jobs: int | None, label: str = "", progress: Progress = silent
) -> list[Array]:
    """Return the results of ``work`` for the indices from 0 to ``count`` - 1, computed in several threads.

    ``jobs`` is the number of threads, by default one per processor.
    """
    done = []
    with (
        progress(label, total=count) as step,
        map_in_threads(work, range(count), jobs or os.cpu_count() or 1) as results,
    ):
        for found in results:
            done.append(found)
            step()
    return done


# ------------------------------------------------------------ evidence


def make_evidence(
    file: Any,
    command: str,
    answer: str,
    checks: Sequence[ev.Check],
    facts: Mapping[str, str],
    notices: Sequence[Notice],
    origin: dict[str, Any],
    **shown: Any,
) -> ev.Evidence:
    """Return the evidence of a map, rule or best gait, with facts and a check that all three have.

    This check warns if the fit of the coefficients did not converge or could not identify them.
    """
    doubts = "; ".join(n.text for n in notices if n.code in DOUBTFUL_CODES)
    if doubts:
        name, limit = "coefficients are those of a sound fit", "converged, identified, within bounds"
        checks = [*checks, ev.make_check(name, "no", False, limit, reason=doubts)]
    robot = {"Robot": file.robot, "Parameters": file.params or "the robot file's"}
    return ev.Evidence(
        command=command,
        title=f"{file.kind.removesuffix(' file').capitalize()} of {file.robot}",
        verdict=ev.make_verdict(answer, checks),
        facts={**robot, "Runs": f"{file.duration_s:g} s from rest", **facts},
        checks=list(checks),
        notices=list(notices),
        references=REFERENCES,
        provenance=origin,
        **shown,
    )


def count_check(name: str, passed: int, count: int, text: str, noun: str, fault: str) -> ev.Check:
    """Return a check that passes if all of ``count`` runs, gaits or points pass.

    ``text`` is shown if some do not pass. The reason of the check states the number of items (``noun``) that
    have the ``fault``.
    """
    which = f"{count - passed} of {count} {noun}s"
    if count == 1:
        which = f"the {noun}"
    value, text = f"{passed} of {count}", text * (passed < count)
    return ev.make_check(name, value, passed == count, "all", text, reason=f"{which} {fault}")


def draws_check(inside: float) -> ev.Check:
    """Check that most random samples of the coefficients lie within the bounds of the coefficients."""
    value, passed = numbers.percent(inside, 2), inside >= MIN_INSIDE
    text = "the coefficients have large standard errors: add trials that identify them" * (not passed)
    name = "draws within the coefficients' bounds"
    reason = f"only {value} of the random draws of the coefficients lie within their bounds"
    return ev.make_check(name, value, passed, "half or more", text, reason=reason)


def make_undefined_check(name: str) -> ev.Check:
    """Return a check, for information only, which states that the uncertainty ``name`` is unknown."""
    return ev.make_check(name, "not known", None, text="give a parameter file with standard errors: --params")


def steady_check(steady: int, count: int) -> ev.Check:
    """Check that the speed is steady at the end of each simulation."""
    text = "the speeds are those after --duration-s from rest, not steady speeds: raise --duration-s"
    fault = "did not become steady before the end"
    return count_check("steady at the end of the run", steady, count, text, "run", fault)


def region_check(
    region: Mapping[str, tuple[float, float]], points: Sequence[Mapping[str, float]]
) -> ev.Check:
    """Check that gaits lie inside the range of each drive parameter in the identification trials."""
    name = "inside the range of the identification trials"
    if not region:
        return ev.make_check(name, "not known", None, text="give the parameter file of a fit: --params")
    outside = [find_outside(region, at) for at in points]
    names = ", ".join(name for name in region if any(name in one for one in outside))
    text = "gaits outside the range are extrapolations: the coefficients were not identified there"
    inside = sum(not one for one in outside)
    fault = f"lay outside the range of the identification trials in {names}"
    return count_check(name, inside, len(points), text, "gait", fault)


def find_outside(region: Mapping[str, tuple[float, float]], at: Mapping[str, float]) -> list[str]:
    """Return the parameters of a gait that lie outside the range of the identification trials.

    >>> find_outside({"frequency_hz": (1.0, 1.8), "bias_deg": (0.0, 15.0)}, {"frequency_hz": 2.0})
    ['frequency_hz']
    """
    found = []
    for name, (low, high) in region.items():
        slack = 1e-9 * (1.0 + max(abs(low), abs(high)))
        # Skip a parameter that the gait does not state, such as the frequency of a predefined stroke.
        value = at.get(name, NEUTRAL_DRIVE.get(name))
        if value is not None and not low - slack <= value <= high + slack:
            found.append(name)
    return found


def forwards_check(surge_m_s: Sequence[float | None]) -> list[ev.Check]:
    """Check that the robot swims nose first. Its speed along the path does not show this direction.

    Parameters
    ----------
    surge_m_s : sequence of float or None
        Mean forward speed of each gait; None if unknown.
    """
    known = [surge for surge in surge_m_s if surge is not None]
    if not known:
        return []
    backwards = sum(surge <= 0 for surge in known)
    fault = "moved the robot tail first"
    check = count_check("swims nose first", len(known) - backwards, len(known), "", "gait", fault)
    if backwards == len(known):
        check.verdict = "fail"
    return [check]
