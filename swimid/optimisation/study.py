"""Common parts of maps, rules and gaits: keys of their files, parallel work, evidence and checks.

A study is the computation of one map, stiffness rule or best gait.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from swimid.files import provenance, yamlio
from swimid.files.provenance import Input
from swimid.fitting.model import Array
from swimid.fitting.problem import map_in_threads
from swimid.notices import Notice, Progress
from swimid.optimisation.options import GaitOptions
from swimid.optimisation.performance import Performance
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results import parameters as parameters_format
from swimid.robots import file as robot_format

#: Warnings about the coefficients: they lie outside their bounds, or their fit did not converge or could not
#: identify them.
DOUBTFUL_CODES = ("SWM053", "SWM062")
#: Default values of the drive parameters.
NEUTRAL = {"bias_deg": 0.0, "asymmetry": 0.0, "lag_deg": 0.0, "scale": 1.0}
#: Minimum fraction of the random coefficient samples that lie within the bounds of the coefficients.
MIN_INSIDE = 0.5
REFERENCES = [
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
    "D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu: Performance Optimization for Bionic Robotic "
    "Dolphin with Active Variable Stiffness Control",
    "Deb, Pratap, Agarwal, Meyarivan (2002): A fast and elitist multiobjective genetic algorithm: NSGA-II. "
    "IEEE Transactions on Evolutionary Computation 6, doi:10.1109/4235.996017",
]


class StudyFile(yamlio.ResultFile):
    """Base class of the files of maps, rules and gaits."""

    format: str
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    #: Parameters of the drive that are not varied.
    drive: dict[str, Any]
    duration_s: float
    #: Range of each drive parameter in the identification trials. Gaits outside this range are extrapolation.
    identified: dict[str, tuple[float, float]] = {}


@dataclass(frozen=True)
class Study:
    """Inputs, provenance and first keys of the file of a map, rule or gait.

    Attributes
    ----------
    inputs : list of Input
        Files that were read.
    origin : dict
        Provenance with the time and the command.
    head : dict
        First keys of the file. The provenance in the file has no time, so that equal inputs give equal files.
    """

    inputs: list[Input]
    origin: dict[str, Any]
    head: dict[str, Any]

    @property
    def key(self) -> list[Any]:
        """Key of the checkpoint, by which an unfinished study is resumed."""
        return [self.origin["inputs"], self.origin["settings"]]


def study_of(performance: Performance, options: GaitOptions, more: Sequence[Input] = ()) -> Study:
    """Return inputs, provenance and first file keys for the study that these options describe."""
    applied, given = performance.applied, options.params
    inputs: list[Input] = [*more]
    name, folder, params = options.robot, None, None
    if given is not None:
        inputs.append(parameters_format.origin(given))
        place = parameters_format.place(given)
        params = place.name
        if name is None and applied.file is not None:
            name, folder = applied.file.robot, place.parent
    inputs.append(robot_format.locate(str(name), folder))
    origin = provenance.collect(inputs, settings=options.settings())
    drive: dict[str, Any] = {"stroke": performance.stroke, **performance.drive}
    if performance.stroke is None:
        drive = {"waveform": performance.waveform, **performance.drive, "ramp_s": performance.ramp_s}
    head = {
        "verdict": "caution",
        "robot": performance.model.robot.name,
        "model": performance.model.name,
        "params": params,
        "drive": drive,
        "duration_s": performance.duration_s,
        "identified": performance.identified,
        "provenance": {key: origin[key] for key in ("version", "inputs", "settings")},
    }
    return Study(inputs, origin, head)


def in_parallel(
    work: Callable[[int], Array], items: Sequence[int], jobs: int | None, label: str, progress: Progress
) -> list[Array]:
    """Return the results of work on numbered items, in ``jobs`` threads (default: one per processor)."""
    done = []
    with (
        progress(label, total=len(items)) as step,
        map_in_threads(work, items, jobs or os.cpu_count() or 1) as results,
    ):
        for found in results:
            done.append(found)
            step()
    return done


def evidence(
    file: Any,
    command: str,
    answer: str,
    checks: Sequence[ev.Check],
    facts: Mapping[str, str],
    notices: Sequence[Notice],
    origin: dict[str, Any],
    **shown: Any,
) -> ev.Evidence:
    """Return the evidence of a study, with the facts and the check that are common to all studies."""
    doubts = "; ".join(n.text for n in notices if n.code in DOUBTFUL_CODES)
    if doubts:
        name, limit = "coefficients are those of a sound fit", "converged, identified, within bounds"
        checks = [*checks, ev.check(name, "no", False, limit, reason=doubts)]
    robot = {"Robot": file.robot, "Parameters": file.params or "the robot file's"}
    return ev.Evidence(
        command=command,
        title=f"{file.kind.removesuffix(' file').capitalize()} of {file.robot}",
        verdict=ev.judged(answer, checks),
        facts={**robot, "Runs": f"{file.duration_s:g} s from rest", **facts},
        checks=list(checks),
        notices=ev.notices(notices),
        references=REFERENCES,
        provenance=origin,
        **shown,
    )


def count_check(name: str, passed: int, count: int, text: str, reason: str = "") -> ev.Check:
    """Check that all of ``count`` items pass. The text is shown if they do not."""
    value, text = f"{passed} of {count}", text * (passed < count)
    return ev.check(name, value, passed == count, "all", text, reason=f"{value} {reason}" * bool(reason))


def draws_check(inside: float) -> ev.Check:
    """Check that most random coefficient samples lie within the bounds of the coefficients."""
    value, passed = numbers.percent(inside, 2), inside >= MIN_INSIDE
    text = "the coefficients have large standard errors: add trials that identify them" * (not passed)
    name, reason = "draws within the coefficients' bounds", f"only {value} of draws lie within them"
    return ev.check(name, value, passed, "half or more", text, reason=reason)


def unknown_check(name: str) -> ev.Check:
    """Return a check entry which states that an uncertainty is not known."""
    return ev.check(name, "not known", None, text="give a parameter file with standard errors: --params")


def steady_check(steady: int, count: int) -> ev.Check:
    """Check that the speed is steady at the end of each simulation."""
    text = "speeds are those after --duration-s from rest, not steady ones"
    return count_check("steady at the end of the run", steady, count, text, "runs are steady at their end")


def region_check(
    region: Mapping[str, tuple[float, float]], points: Sequence[Mapping[str, float]]
) -> ev.Check:
    """Check that gaits lie inside the range of each parameter in the identification trials."""
    name = "inside the range of the identification trials"
    if not region:
        return ev.check(name, "not known", None, text="give the parameter file of a fit: --params")
    outside = [find_outside(region, at) for at in points]
    names = ", ".join(name for name in region if any(name in one for one in outside))
    text = f"elsewhere it is extrapolation in {names}: the coefficients were not identified there"
    inside = sum(not one for one in outside)
    reason = "gaits lie inside the range of the identification trials"
    return count_check(name, inside, len(points), text, reason)


def find_outside(region: Mapping[str, tuple[float, float]], at: Mapping[str, float]) -> list[str]:
    """Return the parameters of a gait that lie outside the range of the identification trials.

    >>> find_outside({"frequency_hz": (1.0, 1.8), "bias_deg": (0.0, 15.0)}, {"frequency_hz": 2.0})
    ['frequency_hz']
    """
    found = []
    for name, (low, high) in region.items():
        slack = 1e-9 * (1.0 + max(abs(low), abs(high)))
        # a stroke without a stated frequency has its own frequency
        value = at.get(name, NEUTRAL.get(name))
        if value is not None and not low - slack <= value <= high + slack:
            found.append(name)
    return found


def forwards_check(surge_m_s: Sequence[float | None]) -> list[ev.Check]:
    """Check that the robot swims nose first, because its speed along the path does not show the direction.

    Parameters
    ----------
    surge_m_s : sequence of float or None
        Mean forward speed of each gait; None if unknown.
    """
    known = [surge for surge in surge_m_s if surge is not None]
    if not known:
        return []
    backwards = sum(surge <= 0 for surge in known)
    text = "with the other gaits the robot moves tail first"
    check = count_check("swims nose first", len(known) - backwards, len(known), text, "gaits swim nose first")
    if backwards == len(known):
        check.verdict = "fail"
    return [check]
