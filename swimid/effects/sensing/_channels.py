"""Which channels which sensor shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from swimid.fitting.model import Trial
from swimid.fitting.scales import MEAN_SPEED

#: What a camera, or an encoder on a rig, measures as a length.
POSITIONS = ("x_m", "y_m", "z_m")
SPEEDS = ("u_m_s", "v_m_s", "w_m_s", MEAN_SPEED)
#: What a gyroscope in the body measures.
TURN_RATES = ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")


def measured(names: Sequence[str], trials: Sequence[Trial]) -> list[str]:
    """Those of the channels that some trial has samples of."""
    return [n for n in names if any(n in t.measured and np.isfinite(t.measured[n]).any() for t in trials)]
