"""The onset of what would otherwise begin with a jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def eased(time_s: Array, ramp_s: float) -> Array:
    """Quintic ease-in from 0 to 1 over ``ramp_s`` > 0."""
    s = np.clip(time_s / ramp_s, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 + s * (6.0 * s - 15.0)))
