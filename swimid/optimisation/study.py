"""What every study of gaits says of itself: robot, drive, settings, inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from swimid.files import provenance
from swimid.files.provenance import Input
from swimid.optimisation.performance import Performance
from swimid.options import Options
from swimid.results import parameters as parameters_format
from swimid.robots import file as robot_format


@dataclass(frozen=True)
class Study:
    """A study of gaits.

    Attributes
    ----------
    inputs : list of Input
        What was read.
    settings : dict
        The options it was made with.
    said : dict
        The first keys of its file.
    repeatable : dict
        The part of the provenance that is the same whenever the study is made again: a file of results has
        it, and is the same to the last byte; the evidence beside it also says when, and by which command.
    """

    inputs: list[Input]
    settings: dict[str, Any]
    said: dict[str, Any]
    repeatable: dict[str, Any]

    @property
    def key(self) -> list[Any]:
        """What an unfinished study belongs to."""
        return [self.repeatable["inputs"], self.settings]


def study_of(performance: Performance, options: Options, more: Sequence[Input] = ()) -> Study:
    """What a study made with these options says of itself."""
    applied, given = performance.applied, options.params  # type: ignore[attr-defined]
    inputs: list[Input] = [*more]
    if given is not None:
        inputs.append(parameters_format.origin(given))
        name = applied.file.robot if applied.file is not None else None
        folder = parameters_format.place(given).parent
    else:
        name, folder = options.robot, None  # type: ignore[attr-defined]
    name = options.robot or name  # type: ignore[attr-defined]
    inputs.append(robot_format.locate(str(name), None if options.robot else folder))  # type: ignore[attr-defined]
    settings = options.settings()
    block = provenance.collect(inputs, settings=settings)
    said = {
        "robot": performance.model.robot.name,
        "model": performance.model.name,
        "params": None if given is None else parameters_format.place(given).name,
        "drive": {
            **({} if performance.stroke is None else {"stroke": performance.stroke}),
            **({"waveform": performance.waveform} if performance.stroke is None else {}),
            **performance.drive,
            **({"ramp_s": performance.ramp_s} if performance.stroke is None else {}),
        },
        "duration_s": performance.duration_s,
        "identified": performance.identified,
    }
    repeatable = {key: block[key] for key in ("version", "inputs", "settings")}
    return Study(inputs, settings, said, repeatable)
