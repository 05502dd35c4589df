"""The options of ``export``."""

from __future__ import annotations

from typing import Literal

from swimid.options import Options, option


class ExportOptions(Options):
    """What ``export`` can be told."""

    to: Literal["mjcf", "gazebo", "json"] = option(help="What to write.")
    robot: str | None = option(
        None, metavar="R", help="Built-in name or path of a robot file. Default: the one PARAMS names."
    )
    added_mass: Literal["native", "fold", "none"] = option(
        "native",
        help="native: as the simulator itself has it, if it does. fold: part of the bodies' masses. "
        "none: left out.",
    )
    servo_hz: float = option(
        20.0,
        gt=0,
        help="Natural frequency of the servos of driven joints the robot file gives none for.",
    )
