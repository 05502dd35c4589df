"""What a swimming robot's run comes to: speed, stride, turning, amplitudes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from swimid.fitting.body import Body
from swimid.fitting.model import Array
from swimid.simulation.applied import Quantity

#: Whole beats at the end of a run over which it is judged, and samples of each.
BEATS, PER_BEAT = 4, 64
#: A Strouhal number is given above this speed, body lengths per second, ...
SLOWEST = 0.05
#: ... and where the robot turns less than this in a beat, rad.
STRAIGHT = math.radians(15.0)
#: A turning radius is given where the robot turns faster than this without being told to, rad/s.
TURNING = math.radians(2.0)


@dataclass(frozen=True)
class Window:
    """The last whole beats of a run.

    Attributes
    ----------
    begin_s, end_s : float
    beats : int
    frequency_hz : float
    """

    begin_s: float
    end_s: float
    beats: int
    frequency_hz: float

    def times(self) -> Array:
        """Even times over the window, both ends included."""
        return np.linspace(self.begin_s, self.end_s, self.beats * PER_BEAT + 1)


def last_beats(begin_s: float, end_s: float, frequency_hz: float) -> Window | None:
    """The last :data:`BEATS` whole beats, fewer in a short run; None where not one fits.

    Parameters
    ----------
    begin_s : float
        End of the drive's ramp.
    """
    count = min(BEATS, int((end_s - begin_s) * frequency_hz + 1e-9))
    return None if count < 1 else Window(end_s - count / frequency_hz, end_s, count, frequency_hz)


def quantities(
    body: Body, values: Array, columns: Mapping[str, Array], window: Window, *, told_to_turn: bool
) -> dict[str, Quantity]:
    """Quantities of the last whole beats.

    Parameters
    ----------
    columns : mapping of str to ndarray
        The model's channels at ``window.times()``.
    told_to_turn : bool
        The drive has a bias or an asymmetry.

    Returns
    -------
    dict of str to Quantity
        SI; names end in their unit. Mean speed is the path length of the beat-to-beat motion over
        time, its arc between two beats taken as one of a circle.
    """
    quantities: dict[str, Quantity] = {}
    if body.free:
        quantities |= _speeds(body, values, columns, window, told_to_turn)
    for axis in body.passive:
        quantities[f"amplitude_{axis.name}_rad"] = Quantity(0.5 * float(np.ptp(columns[axis.column])), "rad")
    return quantities


def _speeds(
    body: Body, values: Array, columns: Mapping[str, Array], window: Window, told_to_turn: bool
) -> dict[str, Quantity]:
    pose, velocity = body.pose, body.velocity
    turn = pose[2].removesuffix("_rad")
    x, y, heading = (columns[name] for name in pose)
    whole = slice(None, None, PER_BEAT)
    chord = np.hypot(np.diff(x[whole]), np.diff(y[whole]))
    bend = np.diff(heading[whole])
    arc = chord / np.sinc(bend / (2 * np.pi))
    duration = window.end_s - window.begin_s
    speed = float(arc.sum()) / duration
    length = body.length(values)
    rate = float(heading[-1] - heading[0]) / duration
    surge = columns[velocity[0]]
    quantities = {
        "mean_speed_m_s": Quantity(speed, "m/s"),
        "mean_speed_BL_s": Quantity(speed / length, "BL/s"),
        "stride_BL": Quantity(speed / window.frequency_hz / length, "BL"),
        "mean_surge_m_s": Quantity(float(np.mean(surge[:-1])), "m/s"),
        "largest_surge_m_s": Quantity(float(np.max(surge)), "m/s"),
        f"peak_{turn}_rate_rad_s": Quantity(float(np.max(np.abs(columns[velocity[2]]))), "rad/s"),
    }
    if window.beats > 1:
        gain = (arc[-1] - arc[0]) / (len(arc) - 1) * window.frequency_hz
        quantities["speed_change_per_beat_m_s"] = Quantity(float(gain), "m/s")
    if told_to_turn or abs(rate) > TURNING:
        quantities[f"mean_{turn}_rate_rad_s"] = Quantity(rate, "rad/s")
        if rate:
            quantities["turning_radius_m"] = Quantity(speed / abs(rate), "m")
    if speed > SLOWEST * length and np.max(np.abs(bend)) < STRAIGHT:
        wake = _tail_excursion(body, values, columns)
        quantities["tail_excursion_m"] = Quantity(wake, "m")
        quantities["strouhal"] = Quantity(window.frequency_hz * wake / speed, "1")
    return quantities


def _tail_excursion(body: Body, values: Array, columns: Mapping[str, Array]) -> float:
    """Peak-to-peak excursion of the rearmost point across the path, mean over the beats, m."""
    rear = int(np.argmax(body.straight(values)[1]))
    x, y = body.rear_ends(body.frames(values, columns))
    excursions = []
    for first in range(0, len(x[rear]) - PER_BEAT, PER_BEAT):
        beat = slice(first, first + PER_BEAT + 1)
        px, py = x[rear][beat], y[rear][beat]
        ux, uy = px[-1] - px[0], py[-1] - py[0]
        across = (-(px - px[0]) * uy + (py - py[0]) * ux) / math.hypot(ux, uy)
        excursions.append(float(np.ptp(across)))
    return float(np.mean(excursions))
