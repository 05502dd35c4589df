"""Options of the command ``export``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, option


class ExportOptions(
    Options,
    command="export",
    section="Publish",
    argument="PARAMS",
    output="The file to write. Without it, or with -o -, it goes to stdout.",
    stdout={},
    beside=(),
):
    """Write estimated coefficients for MuJoCo or Gazebo, or as JSON.

    PARAMS is a parameter file of a robot with links in one plane. A warning names each thing that the
    simulator cannot carry.

    Examples:
      swimid export tfish.yaml --to mjcf --added-mass fold -o tfish.xml
      swimid export tfish.yaml --to gazebo -o tfish.sdf
      swimid export tfish.yaml --to json -o tfish.json
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
