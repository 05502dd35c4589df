"""What a single trial of a swimmer may have of its own, whatever the others have."""

from __future__ import annotations

import numpy as np

from validation.blind.swim_case import Act, Channels, Trial
from validation.blind.swim_sensing import UP


def mirrored(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The film is mirrored."""

    def seen(trial: Trial, channels: Channels, t: np.ndarray) -> Channels:
        if not trial.is_odd:
            return channels
        return {**channels, **{name: -channels[name] for name in UP[robot][:2]}}

    return Act(seen=seen)


def entry(rng: np.random.Generator, size: float, robot: str) -> Act:
    """The stroke is a quarter larger than the one in the trials file."""
    return Act(joints=lambda trial, t, joints: joints * 1.25 if trial.is_odd else joints)


def thrust(rng: np.random.Generator, size: float, robot: str) -> Act:
    """Another fin is mounted: a fifth less thrust."""

    def water(trial: Trial) -> dict[str, float]:
        return {"thrust": 0.8 * (1.0 + trial.thrust)} if trial.is_odd else {}

    return Act(water=water)
