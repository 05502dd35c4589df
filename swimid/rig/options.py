"""Options of the command ``swimid fit-drag``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import swimid.options as fits
from swimid.options import Options, StartState, option


class FitDragOptions(Options, makes="parameters"):
    """Identify drag, added mass and friction from a rig.

    TRIALS is a trials file of a falling-weight, towed or free-decay experiment.

    Examples:
      swimid fit-drag trials.yaml -o drag.yaml
      swimid fit-drag trials.yaml --method two-point --points 0.293,0.584 -o drag.yaml
      swimid fit-drag towed.yaml --free linear_drag --free dry_friction -o rig.yaml
    """

    method: Literal["ml", "two-point"] = option(
        "ml", help="ml: maximum likelihood over all samples. two-point: the boxfish paper's Eqs 13-19."
    )
    start_state: StartState = option(
        "auto",
        help="Start of the trials. auto: at rest at their first sample, unless the data clearly contradict.",
    )
    fixed: Mapping[str, float] = fits.fix_option()
    freed: tuple[str, ...] = fits.free_option()
    bounds: Mapping[str, tuple[float, float]] = fits.bounds()
    points_m: tuple[float, float] | None = option(
        None,
        flag="--points",
        metavar="X1,X2",
        help="Displacements of the two-point method, m; 0.293,0.584 in the paper.",
        recorded=False,
    )
    coordinate: str | None = option(
        None,
        metavar="COLUMN",
        help="Coordinate of a free decay, if the logs hold several.",
        recorded=False,
    )
