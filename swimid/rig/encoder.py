"""What a rotary encoder does to a displacement, and what its samples are worth.

Two kinds of log come from an encoder. *Clicks*: one row each time the displacement passes
another step, so that the displacement is exact and the time stamp carries the error.
*Sampled*: the count read at regular times, so that the displacement stands still between
steps; only the samples at which it changes say something, and each says that a step was
passed within the last sampling interval.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from swimid.fitting.model import Array
from swimid.logs.sampling import step_of

Kind = Literal["continuous", "clicks", "sampled"]


@dataclass(frozen=True)
class Displacement:
    """A displacement record brought into a form whose errors are known.

    Attributes
    ----------
    kind : str
        ``continuous`` (no encoder seen), ``clicks`` or ``sampled``.
    time_s, position : ndarray, shape (n,)
        For ``sampled``: the instants at which steps were passed (``events``), or the samples themselves
        where the body moves more than a step per sample.
    resolution : float or None
        Encoder step, in the unit of the displacement.
    time_sd_s : float or ndarray, shape (n,)
        Known part of the errors of the times, from the sampling interval.
    position_sd : float
        The same of the positions, from the step.
    """

    kind: Kind
    time_s: Array
    position: Array
    resolution: float | None = None
    time_sd_s: float | Array = 0.0
    position_sd: float = 0.0
    events: bool = False


#: How a count may be rounded (``floor`` shows a step once it is passed), and the true position minus the
#: count, in steps: at the instant the count changes, rising and falling, and averaged over the time it shows.
ROUNDINGS = {"floor": (0.0, 1.0, 0.5), "nearest": (-0.5, 0.5, 0.0), "ceil": (-1.0, 0.0, -0.5)}


def understand(time_s: Array, position: Array, resolution: float | None = None) -> Displacement:
    """Tell the kind of a displacement record without missing samples and bring it into usable form.

    The encoder's ``resolution``, where it is known, decides for records that move several steps a sample.
    """
    plain = Displacement("continuous", time_s, position)
    step = step_of(position)
    if step is None:
        return plain
    counts = np.round((position - position[0]) / step).astype(int)
    moves = np.diff(counts)
    forward = moves[moves != 0]
    if len(forward) < 3 or np.mean(np.sign(forward) == np.sign(np.median(forward))) < 0.98:
        return plain  # a record that wanders is rounding, not counting
    if np.mean(np.abs(moves) == 1) > 0.9 and np.std(np.diff(time_s)) >= 0.02 * np.mean(np.diff(time_s)):
        # every row is the next click; before the first one the body stood still
        return Displacement("clicks", time_s, position, step)
    if np.median(np.abs(moves)) <= 1 and np.mean(moves == 0) > 0.05:
        at = np.flatnonzero(moves) + 1
        gap = time_s[at] - time_s[at - 1]
        # a count that jumped by m passed m steps within the interval; take the middle one
        middle = position[at] - 0.5 * (moves[at - 1] - np.sign(moves[at - 1])) * step
        times = time_s[at] - 0.5 * gap
        # where between the two samples nobody knows: gaps differ where a log was written at its own events
        return Displacement("sampled", times, middle, step, gap / np.sqrt(12.0), 0.0, events=True)
    if np.median(np.abs(moves)) <= 3 or (resolution is not None and abs(step / resolution - 1) < 0.02):
        return Displacement("sampled", time_s, position, step, 0.0, step / np.sqrt(12.0))
    return plain


def third_difference_sd(values: Array) -> float:
    """Return the standard deviation of white noise on a smooth signal, from its third differences.

    >>> round(third_difference_sd(np.random.default_rng(0).normal(0.0, 2.0, 4000)), 1)
    2.0
    """
    rough = np.abs(np.diff(values, 3))
    # normal noise: 0.6745 standard deviations to the median, and 1 + 9 + 9 + 1 variances in a difference
    return float(np.median(rough)) / (0.6745 * float(np.sqrt(20.0))) if len(rough) else 0.0


def true_position(record: Displacement, rounding: str) -> Array:
    """Positions behind the counts, shape (n,), if the count is rounded that way."""
    if record.kind != "sampled" or record.resolution is None:
        return record.position
    at_change_rising, at_change_falling, shown = ROUNDINGS[rounding]
    falling = record.position[-1] < record.position[0]
    shift = (at_change_falling if falling else at_change_rising) if record.events else shown
    return record.position + shift * record.resolution
