"""Options of the command ``swimid sensitivity``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import swimid.options as fits
from swimid.options import Options, Source, option
from swimid.simulation import options as simulations
from swimid.swimmer import options as swimmers


class SensitivityOptions(Options, makes="sensitivity"):
    """Rank the coefficients of a model by their effect on each output.

    TRIALS is a trials file of any experiment. All coefficients vary at once over their ranges. Outputs are
    the root-mean-square error of each measured channel, and for a robot with links speeds and rates. A run
    that was stopped continues when it is started again.

    Examples:
      swimid sensitivity trials.yaml -o sens.yaml
      swimid sensitivity trials.yaml --params tfish.yaml --range stderr -o sens.yaml
      swimid sensitivity trials.yaml --range 20% --range c_d4=2,6 --samples 512 -o sens.yaml
    """

    params: Source = option(None, help="Parameter file of these trials' robot.", recorded=False)
    robot: str | None = simulations.other_robot()
    samples: int = option(256, ge=2, help="Rows of the Sobol design, a power of two.")
    ranges: tuple[str, ...] = option(
        (),
        flag="--range",
        metavar="RULE|NAME=LOW,HIGH",
        recorded="range",
        help="bounds (default), stderr (two standard errors of --params), 20% of each value; or of one "
        "coefficient. Repeatable.",
    )
    coefficients: tuple[str, ...] = option((), separated=True, metavar="A,B", help="Vary these only.")
    chosen: Mapping[str, float] = simulations.parameter_values("Hold a parameter at this value. Repeatable.")
    own_effects: tuple[Path, ...] = simulations.own_effects()
    readings: Mapping[str, str] = swimmers.readings()
    seed: int = option(0, ge=0, help="Seed of the design.")
    jobs: int | None = fits.jobs()
    dt: float = swimmers.step()
