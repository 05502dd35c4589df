"""Options of the command ``export``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, option


class ExportOptions(
    Options,
    argument="PARAMS",
    output="The file to write. Without it, or with -o -, it goes to stdout.",
    stdout={},
    beside=("_mjcf_causes.py", "_gazebo_causes.py", "_draws.csv"),
):
    """Write coefficients and causes for MuJoCo or Gazebo, or as JSON.

    PARAMS is a parameter file of a robot with links in one plane, or for Gazebo of a vehicle with one link.
    Its causes are the effects that a diagnosis found. A warning names each thing that the simulator cannot
    carry. Beside tfish.xml, tfish_mjcf_causes.py filters the commands if the simulator lacks a law of the
    servos, and tfish_draws.csv has the samples of --draws.

    Examples:
      swimid export tfish.yaml --to mjcf --added-mass fold -o tfish.xml
      swimid export tfish.yaml --to gazebo -o tfish.sdf
      swimid export repaired.yaml --to mjcf --added-mass fold --draws 100 -o tfish.xml
    """

    to: Literal["mjcf", "gazebo", "json"] = option(help="Format to write.")
    added_mass: Literal["native", "fold", "none"] = option(
        "native",
        help="native: as the simulator itself models it, if it does. fold: part of the masses of the bodies. "
        "none: left out.",
    )
    servo_hz: float = option(
        20.0,
        gt=0,
        help="Natural frequency of the servos of driven joints, if the robot file gives none.",
    )
    draws: int | None = option(
        None,
        ge=1,
        help="Also write this number of random samples of all parameters, from their standard errors and "
        "correlation, for domain randomisation.",
    )
    draw: int | None = option(
        None,
        ge=1,
        help="Export the values of this random sample, counted from 1 as in the column draw of --draws.",
    )
    seed: int = option(1, ge=0, help="Seed of the random samples.")
