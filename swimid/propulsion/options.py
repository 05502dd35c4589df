"""Options of the command ``swimid fit-propulsion``."""

from __future__ import annotations

from collections.abc import Mapping

import swimid.options as fits
from swimid.options import Options, Source, option


class FitPropulsionOptions(Options, makes="parameters"):
    """Identify the propulsion of a caudal fin.

    TRIALS is a trials file of a cruise experiment (energy recoil law: efficiency and amplitude
    offset), or of straight free-swim trials (beat-averaged thrust and surge drag).

    Examples:
      swimid fit-propulsion cruise.yaml --drag drag.yaml -o propulsion.yaml
      swimid fit-propulsion straight_runs.yaml -o surge.yaml
    """

    drag: Source = option(None, help="Drag file of the rig (fit-drag); needed for a cruise.", recorded=False)
    keep_departures: bool = option(False, help="Keep frequencies that depart from the law in the fit.")
    fixed: Mapping[str, float] = fits.fix_option()
    freed: tuple[str, ...] = fits.free_option()
