"""A frequency sweep in one run: the drive goes from step to step, the stiffness with it or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from swimid.fitting.model import Array
from swimid.optimisation.performance import Performance
from swimid.simulation.swim_quantities import PER_BEAT, Steady


@dataclass(frozen=True)
class Sweep:
    """Runs through the same frequencies, each with a stiffness of its own.

    Attributes
    ----------
    speed_m_s : ndarray, shape (runs, frequencies)
        Mean speed at each frequency, over the way made in it.
    distance_m : ndarray, shape (runs,)
        Way made in all.
    """

    speed_m_s: Array
    distance_m: Array


def swept(
    performance: Performance,
    frequencies_hz: Sequence[float],
    amplitude_deg: float,
    coefficient: str,
    stiffness: Sequence[Callable[[float], float]],
) -> Sweep:
    """Swim through frequencies without a stop, each for the performance's duration.

    Parameters
    ----------
    stiffness : sequence of callable
        Of each run: the stiffness at a frequency.

    Notes
    -----
    A step lasts whole beats and begins with the motion the last one ended with; the drive goes on at the same
    phase.
    """
    model = performance.model
    states = [performance.values.copy() for _ in stiffness]
    speeds = []
    ways = []
    for number, frequency in enumerate(frequencies_hz):
        point = {"frequency_hz": frequency, "amplitude_deg": amplitude_deg}
        swim, _ = replace(performance, ramp_s=0.0 if number else performance.ramp_s).swim(point)
        beats = math.ceil(performance.duration_s * frequency - 1e-9)
        run = Steady.driven(model, f"sweep {number} {point!r}", swim, frequency, beats / frequency)
        for values, law in zip(states, stiffness, strict=True):
            values[model.index(coefficient)] = law(frequency)
        columns = model.simulate_many([(values, run.trial) for values in states])
        x, y = model.pose[:2]
        beat = slice(None, None, PER_BEAT)
        way = [float(np.hypot(np.diff(c[x][beat]), np.diff(c[y][beat])).sum()) for c in columns]
        ways.append(way)
        speeds.append([w / float(run.trial.time_s[-1]) for w in way])
        for values, seen in zip(states, columns, strict=True):
            for name, value in model.final_state(seen).items():
                values[model.index(name)] = value
        model.forget([run.trial])
    return Sweep(np.array(speeds).T, np.array(ways).sum(axis=0))
