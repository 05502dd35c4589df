"""Options of the command ``diagnose``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import swimid.options as fits
from swimid.options import Options, Source, option
from swimid.simulation import options as simulations
from swimid.swimmer import options as swimmers


class DiagnoseOptions(Options, makes="gap|power", metrics=("closed.share",)):
    """Name the unmodelled effect behind a gap between trials and simulation.

    TRIALS is a trials file of any experiment. The parameter file states the model of the trials; without one
    the robot file does. The model is refitted without an effect, and with each effect that applies to it.
    Each fit gets a posterior probability. Two further hypotheses get one as well: no gap, and a cause outside
    the catalogue. The answer is one effect, a combination, several that the trials cannot distinguish, or
    none. Every answer is a result: exit status 0.
    exit status 0.

    Examples:
      swimid diagnose trials.yaml -o gap.yaml
      swimid diagnose trials.yaml --params tfish.yaml -o gap.yaml
      swimid diagnose trials.yaml --params tfish.yaml --effects servo-lag,servo-delay,time-offset
      swimid diagnose trials.yaml --params drag.yaml --effect my_effect.py -o gap.yaml
      swimid diagnose trials.yaml --params tfish.yaml -o gap.yaml --next next.csv --tank-length-m 3
      swimid diagnose trials.yaml --params tfish.yaml --power -o power.yaml
      swimid report gap.yaml -o gap.html
    """

    params: Source = option(
        None,
        recorded=False,
        help="Parameter file, of any model. Default: the values of the robot file.",
    )
    effects: tuple[str, ...] = option(
        (),
        separated=True,
        metavar="A,B",
        help="Try these effects of the catalogue, or other readings of the robot (reading:NAME=OPTION), only."
        " Repeatable. Default: all that apply to the model.",
    )
    own_effects: tuple[Path, ...] = option(
        (),
        flag="--effect",
        metavar="FILE",
        help="Try the effects of this Python file as well. Repeatable.",
    )
    own_experiments: tuple[Path, ...] = fits.own_experiments()
    jobs: int | None = fits.jobs("Effects refitted at the same time. Default: one for each processor core.")
    seed: int = option(0, ge=0, help="Of the random draws behind intervals.")
    max_causes: int = option(3, ge=1, le=5, help="Largest number of effects that act together.")
    power: bool = option(
        False,
        recorded=False,
        help="Say what these trials could show, not what they do: the smallest size of each effect that is "
        "seen, and which effects are never distinguished.",
    )
    repaired: Path | None = option(
        None,
        written=True,
        recorded=False,
        help="Parameter file to write for the model with the causes  [default: repaired.yaml beside the gap "
        "file].",
    )
    next: Path | None = option(
        None,
        written=True,
        recorded=False,
        help="Write the trial that would separate rival causes best, as a log (.csv or .parquet) of commands."
        " It stays within 1.4 times the settings of the trials and the joint limits of the robot file.",
    )
    robot: str | None = simulations.other_robot()
    readings: Mapping[str, str] = swimmers.readings()
    dt: float = swimmers.step("max_step_s")
    tank_length_m: float | None = option(
        None, gt=0, help="Longest path of a proposed trial. Default: the longest of the trials."
    )
    max_frequency_hz: float | None = option(None, gt=0, help="Highest beat frequency of a proposed trial.")
    max_amplitude_deg: float | None = option(
        None,
        gt=0,
        help="Largest beat amplitude of a proposed trial; for strokes and logged commands of each joint.",
    )
