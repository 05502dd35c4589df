"""The options of ``fit-graybox``, and those of every verb on robots with links."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.fitting import options as fits
from swimid.options import Options, Source, option

#: Integration step of a robot with links, at most, s.
STEP_S = 0.005


def readings() -> Any:
    """A mapping of ambiguities of the robot's source to the reading that is taken."""
    return option(
        {},
        flag="--reading",
        metavar="NAME=OPTION",
        help="Read an ambiguity of the robot's source otherwise. Repeatable.",
    )


def step(recorded: str = "dt") -> Any:
    """The longest integration step, s."""
    return option(STEP_S, gt=0, help="Integration step, s.", recorded=recorded)


SwimStart = Literal["auto", "rest", "estimate", "steady"]


def start_state() -> Any:
    """State of the trials at their first samples."""
    return option(
        "auto",
        help="State at the first sample: at rest, estimated, or steady swimming under the drive (its limit "
        "cycle). auto: each trial's start_state, else at rest unless the log's first stretch moves.",
    )


#: The part of the options that the search for a front depends on.
FRONT = "front"


class FitGrayboxOptions(
    Options,
    command="fit-graybox",
    section="Identify",
    output="Parameter file to write (YAML).",
    beside=(".evidence.json", ".front.csv"),
):
    """Identify the coefficients of a multi-link swimmer.

    TRIALS is a trials file of a free-swim or multibody experiment, with a robot that has links: tfish,
    dolphin, sealion, or a robot file of your own. Ctrl-C keeps the best point so far, and the generations
    of a front.

    Examples:
      swimid fit-graybox trials.yaml -o tfish.yaml
      swimid fit-graybox trials.yaml --share c_f --starts 8 -o tfish.yaml
      swimid fit-graybox trials.yaml --channels u_m_s,yaw_rate_rad_s --free d_p -o tfish.yaml
      swimid fit-graybox strokes.yaml --method hybrid -o sealion.yaml
      swimid fit-graybox strokes.yaml --method nsga2 --front sealion.front.csv --pick 17 -o mine.yaml
    """

    fixed: Mapping[str, float] = fits.fixed()
    freed: tuple[str, ...] = fits.freed()
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
        help="Columns to fit. Default: the pose where it is logged, else velocities; passive joints.",
    )
    start_state: SwimStart = start_state()
    start_from: Source = option(None, help="Parameter file to start the search from.", recorded=False)
    loss: Literal["linear", "huber"] = option("linear", help="huber: robust loss, outliers weigh less.")
    starts: int | None = option(
        None,
        ge=1,
        help="Number of starts within the bounds. Default: 1, or 4 if a search is short or its answer bad.",
    )
    seed: int = option(0, help="Of the random starts.")
    subset: bool = option(False, help="Hold what the trials cannot tell, until all the rest is known.")
    readings: Mapping[str, str] = readings()
    dt: float = step("max_step_s")
    method: Literal["least-squares", "nsga2", "hybrid"] = option(
        "least-squares",
        help="nsga2: a Pareto front of time-warped distances, and a point chosen on it. "
        "hybrid: least squares that starts there.",
    )
    population: int = option(80, ge=4, part=FRONT, help="nsga2, hybrid: population size.")
    generations: int = option(50, ge=1, part=FRONT, help="nsga2, hybrid: number of generations.")
    crossover: float = option(0.8, ge=0, le=1, part=FRONT, help="nsga2, hybrid: probability of crossover.")
    fronts: Literal["profile", "overall"] = option(
        "profile",
        part=FRONT,
        recorded="per_profile",
        help="nsga2, hybrid: a front for each motion profile, or one over all trials.",
    )
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
    band: float = option(
        0.05, ge=0, le=1, part=FRONT, help="nsga2, hybrid: stretch time by at most this share of a record."
    )
    resume: bool | None = option(
        None,
        flag="--resume/--no-resume",
        recorded=False,
        help="nsga2, hybrid: insist on going on with an unfinished search, or begin anew. "
        "Default: go on where there is one.",
    )
    jobs: int | None = fits.jobs()

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        if self.method == "least-squares" and (self.front is not None or self.resume is not None):
            raise UsageError("--front and --resume belong to --method nsga2 or hybrid")
        return self

    @property
    def per_profile(self) -> bool:
        """Whether every motion profile has a front of its own."""
        return self.fronts == "profile"

    def settings(self, **found: Any) -> dict[str, Any]:
        """The options as the provenance records them; those of the front where one is searched."""
        every = super().settings(per_profile=self.per_profile, **found)
        if self.method != "least-squares":
            return every
        left_out = {entry.key for entry in self.declared().values() if entry.part == FRONT}
        return {key: value for key, value in every.items() if key not in left_out}
