"""Files of maps, stiffness rules, gaits, fins and controllers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from swimid.optimisation import controller, fins, gait_file, map_file, rule
from swimid.optimisation.controller import ControllerFile
from swimid.optimisation.fins import FinFile
from swimid.optimisation.gait_file import GaitFile
from swimid.optimisation.map_file import MapFile
from swimid.optimisation.rule import RuleFile
from swimid.results import numbers
from swimid.results.evidence import Evidence, Verdict
from swimid.results.reader import reader
from swimid.results.sections import Section

ALONE = "No evidence file, so its checks cannot be shown."


def _section(path: Path, file: Any, kind: str, title: str, facts: list[tuple[str, str]]) -> Section:
    return Section(
        path=path,
        kind=kind,
        title=title,
        verdict=Verdict(level=file.verdict, text=ALONE),
        facts=facts,
        provenance=file.provenance,
        data=file.model_dump(mode="json"),
    )


@reader(format=map_file.FORMAT, read=MapFile.read)
def of_map(path: Path, file: MapFile, evidence: Evidence | None) -> Section:
    """The section of a map file."""
    axes = ", ".join(
        f"{a.name} {numbers.number(a.values[0])} to {numbers.number(a.values[-1])} × {len(a.values)}"
        for a in file.axes
    )
    return _section(
        path,
        file,
        "Map",
        f"Map of {file.robot}",
        [
            ("Robot", file.robot),
            ("Parameters", file.params or "the robot file's"),
            ("Grid", axes),
            ("Runs", f"{file.duration_s:g} s from rest"),
            ("Trials beside it", str(len(file.measured))),
        ],
    )


@reader(format=rule.FORMAT, read=RuleFile.read)
def of_rule(path: Path, file: RuleFile, evidence: Evidence | None) -> Section:
    """The section of a rule file."""
    low, high = (numbers.number(k) for k in file.between)
    return _section(
        path,
        file,
        "Stiffness rule",
        f"Stiffness rule of {file.robot}",
        [
            ("Robot", file.robot),
            ("Parameters", file.params or "the robot file's"),
            ("Stiffness", f"{file.coefficient}, {low} to {high} {numbers.unit_text(file.unit)}"),
            ("Objective", file.objective),
            ("Frequency", f"{numbers.interval(*file.frequency_hz)} Hz"),
            ("Amplitude", f"{numbers.interval(*file.amplitude_deg)} deg"),
        ],
    )


@reader(format=gait_file.FORMAT, read=GaitFile.read)
def of_gait(path: Path, file: GaitFile, evidence: Evidence | None) -> Section:
    """The section of a gait file."""
    limits = [
        f"{name} {numbers.number(limit.at_most or limit.at_least, 4, limit.unit)}"
        for name, limit in file.limits.items()
    ]
    return _section(
        path,
        file,
        "Gait",
        f"Gait of {file.robot}",
        [
            ("Robot", file.robot),
            ("Parameters", file.params or "the robot file's"),
            ("Goal", ", ".join(file.goals)),
            ("Varied", ", ".join(file.vary)),
            ("Limits", ", ".join(limits) or "none"),
            ("Draws", str(file.draws) if file.draws else "none"),
        ],
    )


@reader(format=fins.FORMAT, read=FinFile.read)
def of_fins(path: Path, file: FinFile, evidence: Evidence | None) -> Section:
    """The section of a fin file."""
    return _section(
        path,
        file,
        "Fin",
        f"Fin of {file.robot}",
        [
            ("Robot", file.robot),
            ("Parameters", file.params),
            ("Speed", numbers.number(file.speed_m_s, 4, "m/s")),
            ("Ranges", file.ranges),
        ],
    )


@reader(format=controller.FORMAT, read=ControllerFile.read)
def of_controller(path: Path, file: ControllerFile, evidence: Evidence | None) -> Section:
    """The section of a controller file."""
    return _section(
        path,
        file,
        "Controller",
        f"Controller of {file.output}",
        [
            ("Parameters", file.params),
            ("Input", file.input),
            ("Output", file.output),
            ("Sample time", numbers.number(file.sample_time_s, 4, "s")),
            ("Steady gain", numbers.number(file.steady_gain, 4)),
        ],
    )
