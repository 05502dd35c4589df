"""The options of ``sensitivity``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from swimid.fitting import options as fits
from swimid.options import Options, Source, option
from swimid.simulation import options as simulations
from swimid.swimmer import options as swimmers

Method = Literal["sobol", "morris", "none"]


class SensitivityOptions(
    Options,
    command="sensitivity",
    section="Diagnose",
    output="Sensitivity file to write (YAML).",
):
    r"""Rank the coefficients of a swimmer by their effect on each output; sweep its drive.

    TRIALS is a trials file of a free-swim or multibody experiment. Each output (speeds, rates, the misfit
    of each measured channel) is told which coefficients it is sensitive to, over ranges of all at once.
    A run that was stopped goes on where it was when it is started again.

    Examples:
      swimid sensitivity trials.yaml -o sens.yaml
      swimid sensitivity trials.yaml --params tfish.yaml --range stderr -o sens.yaml
      swimid sensitivity trials.yaml --range 20% --range c_d4=2,6 --samples 512 -o sens.yaml
      swimid sensitivity strokes.yaml --method morris -o screening.yaml
      swimid sensitivity strokes.yaml --params sealion.yaml --method none \
          --sweep frequency_hz=0.2:0.6:5 --sweep scale=0.6:1.2:5 -o sweep.yaml
    """

    params: Source = option(None, help="Parameter file of these trials' robot.", recorded=False)
    robot: str | None = simulations.robot()
    method: Method = option("sobol", help="Shares of variance, elementary effects, or a sweep alone.")
    samples: int | None = option(
        None, ge=2, help="Rows of the Sobol design, a power of two (256), or Morris trajectories (32)."
    )
    ranges: tuple[str, ...] = option(
        (),
        flag="--range",
        metavar="RULE|NAME=LOW,HIGH",
        recorded="range",
        help="bounds (default), stderr (two standard errors of --params), 20% of each value; or of one "
        "coefficient. Repeatable.",
    )
    coefficients: tuple[str, ...] = option((), separated=True, metavar="A,B", help="Vary these only.")
    sweep: Mapping[str, tuple[float, float, int]] = option(
        {},
        metavar="NAME=LOW:HIGH:COUNT",
        help="Vary the drive: frequency_hz, and scale of a stroke or amplitude_deg of a beat. At most two.",
    )
    trial: str | None = option(
        None, metavar="ID", help="Whose drive is swept. Default: the first that has one."
    )
    chosen: Mapping[str, float] = simulations.chosen("Hold a parameter at this value. Repeatable.")
    readings: Mapping[str, str] = swimmers.readings()
    seed: int = option(0, ge=0, help="Of the design.")
    jobs: int | None = fits.jobs()
    dt: float = swimmers.step()
