"""What maps, rules and gaits share: what their files say first, work in parallel, evidence and checks."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from swimid.files import provenance, yamlio
from swimid.files.provenance import Input
from swimid.fitting.model import Array
from swimid.fitting.parallel import map_in_threads
from swimid.notices import Notice
from swimid.optimisation.options import GaitOptions
from swimid.optimisation.performance import Performance
from swimid.progress import Progress
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.robots import file as robot_format


class StudyFile(yamlio.ResultFile):
    """What the files of all studies of gaits begin with."""

    format: str
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    #: What is not varied.
    drive: dict[str, Any]
    duration_s: float
    #: Range of drive and axes in the trials the coefficients were identified from; beyond is extrapolation.
    identified: dict[str, tuple[float, float]] = {}


@dataclass(frozen=True)
class Study:
    """What a study of gaits says of itself.

    Attributes
    ----------
    inputs : list of Input
        What was read.
    origin : dict
        The provenance, with the time and the command.
    said : dict
        The first keys of its file, with the part of the provenance that is the same whenever the study is
        made again: a file of results is the same to the last byte.
    """

    inputs: list[Input]
    origin: dict[str, Any]
    said: dict[str, Any]

    @property
    def key(self) -> list[Any]:
        """What an unfinished study belongs to."""
        return [self.origin["inputs"], self.origin["settings"]]


def study_of(performance: Performance, options: GaitOptions, more: Sequence[Input] = ()) -> Study:
    """Return what a study with these options says of itself."""
    applied, given = performance.applied, options.params
    inputs: list[Input] = [*more]
    name, folder = options.robot, None
    if given is not None:
        inputs.append(parameters_format.origin(given))
        if name is None and applied.file is not None:
            name, folder = applied.file.robot, parameters_format.place(given).parent
    inputs.append(robot_format.locate(str(name), folder))
    origin = provenance.collect(inputs, settings=options.settings())
    if performance.stroke is None:
        drive = {"waveform": performance.waveform, **performance.drive, "ramp_s": performance.ramp_s}
    else:
        drive = {"stroke": performance.stroke, **performance.drive}
    said = {
        "verdict": "caution",
        "robot": performance.model.robot.name,
        "model": performance.model.name,
        "params": None if given is None else parameters_format.place(given).name,
        "drive": drive,
        "duration_s": performance.duration_s,
        "identified": performance.identified,
        "provenance": {key: origin[key] for key in ("version", "inputs", "settings")},
    }
    return Study(inputs, origin, said)


def in_parallel(
    work: Callable[[int], Array], numbers: Sequence[int], jobs: int | None, label: str, progress: Progress
) -> list[Array]:
    """Return the results of work on numbered items, by all processors unless jobs are given."""
    done = []
    with (
        progress(label, total=len(numbers)) as step,
        map_in_threads(work, numbers, jobs or os.cpu_count() or 1) as results,
    ):
        for found in results:
            done.append(found)
            step()
    return done


#: Warnings that coefficients are not vouched for: outside their bounds, or by a fit that did not converge or
#: could not identify them.
DOUBTFUL = ("SWM053", "SWM062")
#: Values of a drive where it does not say.
NEUTRAL = {"bias_deg": 0.0, "asymmetry": 0.0, "lag_deg": 0.0, "scale": 1.0}
REFERENCES = [
    "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin",
    "D. Chen, Y. Xiong, B. Wang, R. Tong, Y. Meng, J. Yu: Performance Optimization for Bionic Robotic "
    "Dolphin with Active Variable Stiffness Control",
    "Deb, Pratap, Agarwal, Meyarivan (2002): A fast and elitist multiobjective genetic algorithm: NSGA-II. "
    "IEEE Transactions on Evolutionary Computation 6, doi:10.1109/4235.996017",
    "Rockafellar, Uryasev (2000): Optimization of conditional value-at-risk. Journal of Risk 2, "
    "doi:10.21314/JOR.2000.038",
]
#: The range of the identification trials, by the name of what was varied in them.
Region = Mapping[str, tuple[float, float]]


def evidence(
    file: Any,
    verb: str,
    answer: str,
    checks: Sequence[ev.Check],
    facts: Mapping[str, str],
    notices: Sequence[Notice],
    origin: dict[str, Any],
    **shown: Any,
) -> ev.Evidence:
    """Return the evidence of a study of gaits, with the facts and the check that every study has."""
    checks = [*checks, *coefficients_check(notices)]
    robot = {"Robot": file.robot, "Parameters": file.params or "the robot file's"}
    return ev.Evidence(
        verb=verb,
        title=f"{file.kind.removesuffix(' file').capitalize()} of {file.robot}",
        verdict=ev.judged(answer, checks),
        facts={**robot, "Runs": f"{file.duration_s:g} s from rest", **facts},
        checks=checks,
        notices=blocks.notices(notices),
        references=REFERENCES,
        provenance=origin,
        **shown,
    )


def coefficients_check(notices: Sequence[Notice]) -> list[ev.Check]:
    """Return a check that stands only where the coefficients are in doubt."""
    doubts = [n.text for n in notices if n.code in DOUBTFUL]
    if not doubts:
        return []
    name = "coefficients are those of a sound fit"
    return [ev.check(name, "no", False, "converged, identified, within bounds", reason="; ".join(doubts))]


def draws_check(inside: float) -> ev.Check:
    """Check that most draws of the coefficients lie within their bounds."""
    text = "" if inside >= 0.5 else "the coefficients are hardly known: fit them better"
    value = numbers.percent(inside, 2)
    name, reason = "draws within the coefficients' bounds", f"only {value} of draws lie within them"
    return ev.check(name, value, inside >= 0.5, "half or more", text, reason=reason)


def unknown_check(name: str) -> ev.Check:
    """Tell that an uncertainty is not known."""
    return ev.check(name, "not known", None, text="give a parameter file with standard errors: --params")


def steady_check(steady: int, count: int) -> ev.Check:
    """Check that runs are steady at their end."""
    name, value = "steady at the end of the run", f"{steady} of {count}"
    text = "" if steady == count else "speeds are those after --duration-s from rest, not steady ones"
    reason = f"{value} runs are steady at their end"
    return ev.check(name, value, steady == count, "all", text, reason=reason)


def region_check(region: Region, points: Sequence[Mapping[str, float]]) -> ev.Check:
    """Check that gaits lie inside the range of the identification trials."""
    name = "inside the range of the identification trials"
    if not region:
        return ev.check(name, "not known", None, text="give the parameter file of a fit: --params")
    out = [beyond(region, at) for at in points]
    inside = sum(not names for names in out)
    text = ""
    if inside < len(points):
        names = ", ".join(name for name in region if any(name in one for one in out))
        text = f"elsewhere it is extrapolation in {names}: the coefficients were not identified there"
    value = f"{inside} of {len(points)}"
    reason = f"{value} gaits lie inside the range of the identification trials"
    return ev.check(name, value, inside == len(points), "all", text, reason=reason)


def beyond(region: Region, at: Mapping[str, float]) -> list[str]:
    """Return what of a gait lies outside the range of the identification trials.

    >>> beyond({"frequency_hz": (1.0, 1.8), "bias_deg": (0.0, 15.0)}, {"frequency_hz": 2.0})
    ['frequency_hz']
    """
    found = []
    for name, (low, high) in region.items():
        slack = 1e-9 * (1.0 + max(abs(low), abs(high)))
        value = at.get(name, NEUTRAL.get(name))  # a stroke has a frequency of its own
        if value is not None and not low - slack <= value <= high + slack:
            found.append(name)
    return found


def forwards_check(surge_m_s: Sequence[float | None]) -> list[ev.Check]:
    """Check that gaits swim nose first: speed is that along the path, whichever way the robot faces.

    Parameters
    ----------
    surge_m_s : sequence of float or None
        Mean forward speed of each; None where there is none.
    """
    known = [surge for surge in surge_m_s if surge is not None]
    back = sum(surge <= 0 for surge in known)
    if not known:
        return []
    text = "elsewhere the robot is driven tail first: its speed there is none of swimming" if back else ""
    ahead = f"{len(known) - back} of {len(known)}"
    grade: Literal["warn", "fail"] = "fail" if back == len(known) else "warn"
    reason = f"{ahead} gaits swim nose first"
    return [ev.check("swims nose first", ahead, not back, "all", text, otherwise=grade, reason=reason)]
