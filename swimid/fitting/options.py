"""Options of the command ``fit``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import swimid.options as fits
from swimid.options import Options


class FitOptions(Options, makes="parameters"):
    """Identify the model of an experiment that has no command of its own.

    TRIALS is a trials file of an experiment that is one Python file, your own or one of swimid
    (CONTRIBUTING.md). The file has the model.

    Example:
      swimid fit trials.yaml --experiment coasting_body.py -o coasting.yaml
    """

    own_experiments: tuple[Path, ...] = fits.own_experiments()
    fixed: Mapping[str, float] = fits.fix_option()
    freed: tuple[str, ...] = fits.free_option()
    bounds: Mapping[str, tuple[float, float]] = fits.bounds()
