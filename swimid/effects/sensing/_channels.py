"""Which channels which sensor shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Model, Trial
from swimid.propulsion.model import SPEED
from swimid.rig.model import RigModel
from swimid.swimmer.planar.model import MultilinkModel

#: What a camera, or an encoder on a rig, measures as a length.
POSITIONS = ("x_m", "y_m", "z_m")
SPEEDS = ("u_m_s", "v_m_s", "w_m_s", SPEED)
#: What a gyroscope in the body measures.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def measured(names: Sequence[str], trials: Sequence[Trial]) -> list[str]:
    """Those of the channels that some trial has samples of."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]


def origin(model: Model, trial: Trial) -> dict[str, float]:
    """Where a trial's positions start, by channel; zero for those that are not named."""
    if isinstance(model, MultilinkModel):
        pose = trial.settings.get("pose", (0.0, 0.0, 0.0))
        return dict(zip(model.plane.pose, (float(p) for p in pose), strict=True))
    if isinstance(model, RigModel):
        return {model.coordinate: float(trial.settings.get("x0", 0.0))}
    return {}


def estimates(model: Model, name: str) -> bool:
    """Whether the model itself has this parameter free."""
    return any(p.name == name and p.free for p in model.parameters)
