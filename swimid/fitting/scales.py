"""Typical sizes of what trials show, from which the scales of parameters are taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from swimid.fitting.model import Array, Model, Trial

#: Columns that hold a position, and the one of a timed run's mean speed.
POSITIONS = ("x_m", "y_m", "z_m")
MEAN_SPEED = "mean_speed_m_s"
#: Stretches into which a track is cut to find its speed, so that noise does not lengthen it.
STRETCHES = 12


class Scales:
    """Typical sizes of a model's trials; a model that knows more of its forces and masses overrides them.

    Parameters
    ----------
    model : Model
        Its parameters at their start values.
    trials : sequence of Trial
    """

    #: Channels whose range is the extent of the motion.
    places: tuple[str, ...] = POSITIONS

    def __init__(self, model: Model, trials: Sequence[Trial]) -> None:
        self.model = model
        self.trials = trials

    @property
    def duration(self) -> float:
        """Median length of a trial, s; 1 where that is not known."""
        found = [float(t.time_s[-1] - t.time_s[0]) for t in self.trials if len(t.time_s) > 1]
        return float(np.median(found)) or 1.0 if found else 1.0

    @property
    def speed(self) -> float:
        """Typical speed, m/s (rad/s for an angle); 0.1 where nothing tells."""
        found = [v for t in self.trials if (v := _speed(t)) is not None]
        return float(np.median(found)) or 0.1 if found else 0.1

    @property
    def span(self) -> float:
        """Typical extent of the motion, m (rad for an angle); 1 where nothing tells."""
        found = [
            float(np.nanmax(t.measured[name]) - np.nanmin(t.measured[name]))
            for t in self.trials
            for name in self.places
            if name in t.measured and np.isfinite(t.measured[name]).any()
        ]
        return float(np.median(found)) or 1.0 if found else 1.0

    @property
    def inertia(self) -> float:
        """What has to be accelerated: kg, kg m2 for an angle; 1 where nothing tells."""
        return 1.0

    @property
    def force(self) -> float:
        """Typical force that moves the robot, in :attr:`Model.force_unit`."""
        return 0.1 * self.speed**2

    @property
    def brake(self) -> float:
        """Size of a drag or friction that one begins to see: a tenth of what moves the robot."""
        return 0.1 * self.force

    @property
    def quadratic(self) -> float:
        """The quadratic drag the model has, the least of all trials; 0 where it has no such coefficient."""
        return 0.0


def _speed(trial: Trial) -> float | None:
    for name in ("u_m_s", MEAN_SPEED):
        if name in trial.measured:
            return float(np.sqrt(np.nanmean(trial.measured[name] ** 2)))
    time, place = _track(trial)
    every = slice(None, None, max(len(time) // STRETCHES, 1))
    if len(time) > 1 and time[every][-1] > time[0]:
        path = float(np.linalg.norm(np.diff(place[every], axis=0), axis=1).sum())
        return path / float(time[every][-1] - time[0])
    return None


def _track(trial: Trial) -> tuple[Array, Array]:
    """Times and positions where all measured coordinates are there, shapes (n,) and (n, coordinates)."""
    names = [name for name in POSITIONS if name in trial.measured]
    if not names:
        return np.zeros(0), np.zeros((0, 1))
    values = np.column_stack([trial.measured[name] for name in names])
    there = np.isfinite(values).all(axis=1)
    return trial.time_s[there], values[there]
