"""Options of the commands ``compare`` and ``simulate``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import swimid.options as fits
from swimid.options import Options, Source, option
from swimid.swimmer import options as swimmers


def other_robot(help: str = "Accept the parameters for this robot.") -> Any:
    """Return the option ``--robot``, which names a robot other than that of the parameter file."""
    return option(None, metavar="NAME|FILE", help=help, recorded=False)


def parameter_values(help: str = "Use this value of a parameter. Repeatable.") -> Any:
    """Return the option ``--set``, whose parameter values replace those of the parameter file."""
    return option({}, flag="--set", metavar="NAME=VALUE", help=help, recorded="set")


def own_effects() -> Any:
    """Return the option ``--effect``, which reads effects that a user defines."""
    help = "Python file with effects of one's own that the parameter file names. Repeatable."
    return option((), flag="--effect", metavar="FILE", help=help, recorded=False)


class CompareOptions(Options, makes="comparison", metrics=("channels.*.nrmse",)):
    """Compare recorded trials with their simulation.

    TRIALS is a trials file of any experiment that the model of the parameter file describes. The result has
    errors by channel and trial, and the means of every stroke. For a robot in space, trials that repeat a
    motion are averaged, with the tables of the sea lion paper.

    Examples:
      swimid compare trials.yaml --params tfish.yaml -o comparison.yaml
      swimid compare trials.yaml --params drag.yaml
      swimid report comparison.yaml -o comparison.html
    """

    params: Source = option(help="Parameter file, of any model.", recorded=False)
    robot: str | None = other_robot()
    channels: tuple[str, ...] = option((), separated=True, metavar="A,B", help="Compare these columns only.")
    refit_start: bool = option(
        True,
        flag="--refit-start/--no-refit-start",
        help="Estimate the start state of trials the parameter file does not know.",
    )
    start_state: swimmers.SwimStart = swimmers.start_state()
    chosen: Mapping[str, float] = parameter_values()
    own_effects: tuple[Path, ...] = own_effects()
    own_experiments: tuple[Path, ...] = fits.own_experiments()
    readings: Mapping[str, str] = swimmers.readings()
    dt: float = swimmers.step()


class DriveOptions(Options):
    """Options of every command that simulates a robot with links under a commanded motion (drive)."""

    params: Source = option(None, help="Parameter file of a robot with links.", recorded=False)
    robot: str | None = other_robot("Robot; without --params the values of its file are used.")
    frequency_hz: float | None = option(None, gt=0, help="Beat frequency.")
    amplitude_deg: float | None = option(None, ge=0, help="Beat amplitude (T-Fish: of the whole tail).")
    waveform: Literal["sine", "hopf", "a-cpg"] = option("sine", help="Waveform of the beat.")
    bias_deg: float | None = option(None, help="Turning bias.")
    asymmetry: float | None = option(None, gt=-1, lt=1, help="Asymmetry of an a-cpg beat (T-Fish, Eq 10).")
    lag_deg: float | None = option(None, help="Phase by which each driven joint lags the one before it.")
    ramp_s: float = option(1.0, ge=0, help="Time in which the beat grows to its amplitude.")
    stroke: str | None = option(None, metavar="NAME", help="Stroke of the robot file instead of a beat.")
    scale: float | None = option(None, ge=0, help="Factor on the angles of the stroke.")
    chosen: Mapping[str, float] = parameter_values("Hold a parameter at this value. Repeatable.")
    own_effects: tuple[Path, ...] = own_effects()
    readings: Mapping[str, str] = swimmers.readings()
    dt: float = swimmers.step()


class SimulateOptions(
    DriveOptions, argument="", output="Log to write (.csv or .parquet).", beside=(), makes="log"
):
    """Simulate any robot from any parameter file.

    A robot with links swims under a beat, a stroke or recorded joint angles. A falling weight, a cruise and a
    discrete-time model have options of their own. Standard errors follow from those of the parameter file.

    Examples:
      swimid simulate --params tfish.yaml --frequency-hz 1 --amplitude-deg 20 --duration-s 15 -o sim.csv
      swimid simulate --robot dolphin --frequency-hz 2.5 --amplitude-deg 27 --animate swim.mp4
      swimid simulate --robot sealion --stroke characteristic --cycles 3 -o stroke.csv
      swimid simulate --params tfish.yaml --trials trials.yaml -o simulated
      swimid simulate --params drag.yaml --pulling-mass-kg 0.02 --duration-s 8 -o drop.csv
      swimid simulate --params arma.yaml --input run.csv -o free_run.csv
    """

    params: Source = option(None, help="Parameter file, of any model.")
    duration_s: float | None = option(None, gt=0, help="Length of the run  [default: 15]")
    sample_rate_hz: float | None = option(None, gt=0, help="Samples a second of the log  [default: 50]")
    input: Path | None = option(
        None, help="Log that drives the run in place of a beat: joint angles or commands, or an arma input."
    )
    cycles: float | None = option(None, gt=0, help="Cycles of the stroke; then its joints rest.")
    pulling_mass_kg: float | None = option(None, gt=0, help="Weight of a falling-weight rig.")
    fin: str | None = option(None, help="Fin of a cruise.")
    distance_m: float | None = option(None, gt=0, help="Course of a cruise from rest, for its mean speed.")
    trials: Source = option(
        None, help="Simulate these recorded trials' own drives and start states; -o is then a folder."
    )
    trial: str | None = option(None, metavar="ID", help="Only this one of --trials; -o is then a log.")
    own_experiments: tuple[Path, ...] = fits.own_experiments()
    animate: Path | None = option(None, written=True, help="Film of the links: .mp4 or .gif.")
