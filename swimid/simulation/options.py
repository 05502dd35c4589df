"""The options of ``compare`` and ``simulate``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from swimid.options import Options, Source, option
from swimid.swimmer import options as swimmers


def robot(help: str = "Accept the parameters for this robot.") -> Any:
    """A robot in place of the one the parameter file names."""
    return option(None, metavar="NAME|FILE", help=help, recorded=False)


def chosen(help: str = "Use this value of a parameter. Repeatable.") -> Any:
    """A mapping of parameters to values that win over the file's."""
    return option({}, flag="--set", metavar="NAME=VALUE", help=help, recorded="set")


class CompareOptions(Options):
    """What ``compare`` can be told."""

    params: Source = option(help="Parameter file, of any model.", recorded=False)
    robot: str | None = robot()
    channels: tuple[str, ...] = option((), separated=True, metavar="A,B", help="Compare these columns only.")
    refit_start: bool = option(
        True,
        flag="--refit-start/--no-refit-start",
        help="Estimate the start state of trials the parameter file does not know.",
    )
    chosen: Mapping[str, float] = chosen()
    readings: Mapping[str, str] = swimmers.readings()
    dt: float = swimmers.step()
    buoyancy_band_percent: float = option(
        2.0,
        ge=0,
        le=50,
        flag="--buoyancy-band",
        metavar="PERCENT",
        help="Shade what so much less and more buoyancy changes (robots in space). 0 for none.",
        recorded="buoyancy_band",
    )
