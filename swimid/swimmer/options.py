"""Options of ``fit-graybox``, and those that all commands on robots with links share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import model_validator

import swimid.options as fits
from swimid.errors import UsageError
from swimid.options import Options, Source, option

#: Default of the maximum integration step for a robot with links, s.
STEP_S = 0.005


def readings() -> Any:
    """Return the option ``--reading``, which selects interpretations of the robot's source."""
    return option(
        {},
        flag="--reading",
        metavar="NAME=OPTION",
        help="Read an ambiguity of the robot's source otherwise. Repeatable.",
    )


def step(recorded: str = "dt") -> Any:
    """Return the option for the maximum integration step, s."""
    return option(
        STEP_S,
        gt=0,
        help="Maximum integration step, s. It is halved until the result hardly changes.",
        recorded=recorded,
    )


SwimStart = Literal["auto", "rest", "estimate", "steady"]


def start_state() -> Any:
    """Return the option for the state of trials at their first samples."""
    return option(
        "auto",
        help="State at the first sample: at rest, estimated, or steady swimming under the drive (its limit "
        "cycle). auto: each trial's start_state, else at rest unless the log's first stretch moves.",
    )


#: Name of the group of options that affect only the search of a Pareto front.
FRONT = "front"


class FitGrayboxOptions(Options, beside=(".evidence.json", ".front.csv"), makes="parameters"):
    """Identify the coefficients of a multi-link swimmer.

    TRIALS is a trials file of a free-swim or multibody experiment, with a robot that has links: tfish,
    dolphin, sealion, or a robot file of your own. Ctrl-C keeps the best point so far. The generations of a
    front are kept beside the output, and the same command goes on from there.

    Examples:
      swimid fit-graybox trials.yaml -o tfish.yaml
      swimid fit-graybox trials.yaml --share c_f --starts 8 -o tfish.yaml
      swimid fit-graybox trials.yaml --channels u_m_s,yaw_rate_rad_s --free d_p -o tfish.yaml
      swimid fit-graybox strokes.yaml --method hybrid -o sealion.yaml
      swimid fit-graybox strokes.yaml --method nsga2 --front sealion.front.csv --pick 17 -o mine.yaml
    """

    fixed: Mapping[str, float] = fits.fix_option()
    freed: tuple[str, ...] = fits.free_option()
    bounds: Mapping[str, tuple[float, float]] = fits.bounds()
    share: tuple[str, ...] = option(
        (),
        metavar="PREFIX",
        help="One value for all coefficients of this name and a number (c_f: c_f0, c_f13, c_f4).",
    )
    channels: tuple[str, ...] = option(
        (),
        separated=True,
        metavar="A,B",
        help="Columns to fit. Default: the pose if it is logged, else velocities; passive joints.",
    )
    start_state: SwimStart = start_state()
    start_from: Source = option(None, help="Parameter file to start the search from.", recorded=False)
    starts: int | None = option(
        None,
        ge=1,
        help="Number of starts within the bounds. Default: 1, or 4 if a fit is quick or its result bad.",
    )
    max_iterations: int = option(
        75,
        ge=1,
        help="Iterations after which an unconverged search ends (at least one for each noise estimate). "
        "Its result is written and marked.",
    )
    seed: int = option(0, help="Seed of the random starts and of the front.")
    readings: Mapping[str, str] = readings()
    dt: float = step("max_step_s")
    method: Literal["least-squares", "nsga2", "hybrid"] = option(
        "least-squares",
        help="nsga2: a Pareto front of time-warped distances, and a point chosen on it. "
        "hybrid: least squares that starts at that point.",
    )
    population: int = option(80, ge=4, part=FRONT, help="nsga2, hybrid: population size.")
    generations: int = option(50, ge=1, part=FRONT, help="nsga2, hybrid: number of generations.")
    pick: str = option(
        "least-worst",
        metavar="RULE|INDEX",
        recorded=False,
        help="nsga2, hybrid: choose a point by least-worst or knee, or by its index.",
    )
    front: Path | None = option(
        None,
        metavar="FILE",
        recorded=False,
        help="nsga2, hybrid: choose from this front of an earlier run; no search.",
    )
    scales: Mapping[str, float] = option(
        {},
        flag="--scale",
        metavar="CHANNEL=SIZE",
        part=FRONT,
        help="nsga2, hybrid: an error of this size counts as one. "
        "Default: 0.05 m, 0.05 m/s, 5 deg, 10 deg/s.",
    )
    jobs: int | None = fits.jobs()

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        if self.method == "least-squares" and self.front is not None:
            raise UsageError(
                "--front is valid only with --method nsga2 or hybrid: omit it, or choose one of them"
            )
        return self

    def settings(self, **found: Any) -> dict[str, Any]:
        """Return the options that the provenance records.

        The options for the search of a Pareto front are included only if a front is searched.
        """
        every = super().settings(**found)
        if self.method != "least-squares":
            return every
        left_out = {entry.key for entry in self.declarations().values() if entry.part == FRONT}
        return {key: value for key, value in every.items() if key not in left_out}
