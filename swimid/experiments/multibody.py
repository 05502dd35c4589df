"""Experiment ``multibody``: any motion of a robot of rigid links, or of a vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from swimid.fitting.fit_common import Experiment
from swimid.logs.experiments import FreeSwimTrial, Trials
from swimid.swimmer import trials as swimmer


class Multibody(Trials):
    """Trials file for a robot of rigid links. The logs have joint angles, a pose, or both.

    Example::

        format: swimid-trials/1
        experiment: multibody
        robot: sealion
        trials:
          - {log: stroke1.csv, drive: {stroke: characteristic}}
          - {log: stroke2.csv, role: validate}
    """

    about = "any motion of a robot with links or of a vehicle"
    models = ("multilink", "multibody")
    commands = ("fit-graybox",)
    usual = (("joint*_rad", "x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"),)
    robot_form = "links"

    experiment: Literal["multibody"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]

    def load(self, path: Path, **options: Any) -> Experiment:
        """Read the trials. The options are those of :func:`swimid.swimmer.trials.load`."""
        return swimmer.load(self, path, **options)
