"""What a swimming robot's run comes to: speed, stride, turning, amplitudes, power.

The one place where the performance of a swim is measured: ``simulate``, ``map`` and ``optimise`` give the
quantities computed here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from swimid.fitting.drives import SwimInput
from swimid.fitting.model import Array, Trial
from swimid.simulation.catalogue import Quantity
from swimid.swimmer import run_quantities
from swimid.swimmer.model import Swimmer
from swimid.swimmer.planar.model import Body
from swimid.swimmer.run_quantities import Energetics

#: Whole beats at the end of a run over which it is judged, and samples of each.
BEATS, PER_BEAT = 4, 64
#: A Strouhal number is given above this speed, body lengths per second, ...
SLOWEST = 0.05
#: ... and where the robot turns less than this in a beat, rad.
STRAIGHT = math.radians(15.0)
#: A turning radius is given where the robot turns faster than this without being told to, rad/s.
TURNING = math.radians(2.0)
#: Largest change of the speed from beat to beat, over the speed, of a steady run.
UNSTEADY = 0.005
#: A run has settled where its mean surge over a beat stays within this share of its last.
SETTLED = 0.05


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

    @property
    def length_s(self) -> float:
        """From its begin to its end."""
        return self.end_s - self.begin_s

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


@dataclass(frozen=True)
class Steady:
    """A run under a beat or a stroke, sampled so that its end can be judged by whole beats.

    Attributes
    ----------
    trial : Trial
        The run at :data:`PER_BEAT` samples a beat from its start on.
    window : Window
        Its last whole beats; of a robot in space its last whole cycle.
    told_to_turn : bool
        The drive has a bias or an asymmetry.
    """

    trial: Trial
    window: Window
    told_to_turn: bool

    @classmethod
    def of(cls, model: Swimmer, trial: Trial, frequency_hz: float) -> Steady | None:
        """A trial's drive over the trial's time; None where not one beat fits."""
        begin, end = float(trial.time_s[0]), float(trial.time_s[-1])
        beat = trial.swim.beat
        if model.in_space:
            cycles = run_quantities.windows(trial.time_s, frequency_hz)
            if not cycles:
                return None
            window = Window(cycles[-1].begin_s, cycles[-1].end_s, 1, frequency_hz)
        else:
            ramp = max(begin, beat.ramp_s) if beat is not None else begin
            found = last_beats(ramp, end, frequency_hz)
            if found is None:
                return None
            window = found
        times = window.times()
        # the run itself begins where the trial does
        lead = np.arange(begin, times[0] - 1e-9, times[1] - times[0])
        return cls(
            Trial(f"{trial.id} (last beats)", "fit", np.concatenate((lead, times)), {}, swim=trial.swim),
            window,
            beat is not None and bool(beat.bias_rad or beat.asymmetry),
        )

    @classmethod
    def driven(
        cls, model: Swimmer, name: str, swim: SwimInput, frequency_hz: float, duration_s: float
    ) -> Steady:
        """A run from rest of a time, longer where that holds no whole beat after the ramp.

        Parameters
        ----------
        name : str
            A model keeps what it simulated by this name: another drive needs another.

        Notes
        -----
        Its samples are counted from its end, so that what it comes to is a smooth function of the frequency;
        it begins up to one sample before the drive does. A stroke is counted from its beginning, and the run
        rounded up to whole cycles.
        """
        end = duration_s
        if swim.beat is not None:
            end = max(end, swim.beat.ramp_s + (1.0 + 1e-6) / frequency_hz)
        if model.in_space:
            end = max(math.ceil(end * frequency_hz - 1e-9), 1) / frequency_hz
        count = math.ceil(end * PER_BEAT * frequency_hz - 1e-9)
        time = end - np.arange(count, -1, -1) / (PER_BEAT * frequency_hz)
        made = cls.of(model, Trial(name, "fit", time, {}, swim=swim), frequency_hz)
        assert made is not None
        return made

    def quantities(
        self, model: Swimmer, values: Array, columns: Mapping[str, Array], energetics: Energetics | None
    ) -> dict[str, Quantity]:
        """What the run comes to.

        Parameters
        ----------
        columns : mapping of str to ndarray
            The model's channels at the samples of :attr:`trial`.
        energetics : Energetics or None
            Of the window.
        """
        body, time = model.body, self.trial.time_s
        if body is None:
            last = run_quantities.Window(self.window.begin_s, self.window.end_s)
            units = run_quantities.QUANTITIES
            found = {
                name: Quantity(value, units[name])
                for name, value in run_quantities.quantities(time, columns, last).items()
            }
        else:
            count = self.window.beats * PER_BEAT + 1
            seen = {name: v[-count:] for name, v in columns.items()}
            found = quantities(body, values, seen, self.window, told_to_turn=self.told_to_turn)
            if body.free:
                surge, whole = columns[body.velocity[0]], float(time[-1] - time[0])
                mean = float(np.trapezoid(surge, time)) / whole
                found["mean_surge_from_start_m_s"] = Quantity(mean, "m/s")
                settled = settling_time(time, surge, self.window.frequency_hz)
                found["settling_time_s"] = Quantity(settled, "s")
                extent = max(float(np.ptp(columns[name])) for name in body.pose[:2])
                found["path_extent_m"] = Quantity(extent, "m")
        if energetics is not None and model.driven:
            found |= powers(energetics, found.get("mean_speed_m_s"))
        return found


def known(model: Swimmer) -> dict[str, str]:
    """Every quantity a run of this robot may come to, with its unit."""
    units: dict[str, str] = {}
    if model.in_space:
        units |= run_quantities.QUANTITIES
    elif model.free_base:
        turn = model.pose[2].removesuffix("_rad")
        units |= {
            "mean_speed_m_s": "m/s",
            "mean_speed_BL_s": "BL/s",
            "stride_BL": "BL",
            "strouhal": "1",
            "tail_excursion_m": "m",
            "turning_radius_m": "m",
            f"mean_{turn}_rate_rad_s": "rad/s",
            f"peak_{turn}_rate_rad_s": "rad/s",
            f"{turn}_rate_range_rad_s": "rad/s",
            f"{turn}_range_in_beat_rad": "rad",
            "mean_surge_m_s": "m/s",
            "largest_surge_m_s": "m/s",
            "mean_surge_from_start_m_s": "m/s",
            "speed_change_per_beat_m_s": "m/s",
            "settling_time_s": "s",
            "path_extent_m": "m",
        }
    if not model.in_space:
        units |= {f"amplitude_{axis.name}_rad": "rad" for axis in model.passive}
    if model.driven:
        units |= {
            "cost_of_transport_J_m": "J/m",
            "mean_positive_power_W": "W",
            "mean_power_W": "W",
            "peak_torque_N_m": "N m",
            "peak_joint_rate_rad_s": "rad/s",
        }
    return units


def settling_time(time_s: Array, surge_m_s: Array, frequency_hz: float) -> float:
    """When the mean surge over a beat comes within :data:`SETTLED` of its last for good, s; NaN for never.

    Parameters
    ----------
    time_s, surge_m_s : ndarray, shape (n,)
        :data:`PER_BEAT` samples a beat.

    Notes
    -----
    Speed that is still rising at the end of the run has not settled: the end is then no limit.
    """
    mean = np.convolve(surge_m_s, np.ones(PER_BEAT) / PER_BEAT, "valid")
    if len(mean) < PER_BEAT + 1 or not np.isfinite(mean).all():
        return math.nan
    off = np.abs(mean - mean[-1]) > SETTLED * abs(mean[-1])
    if off[-PER_BEAT - 1 :].any():
        return math.nan
    last = int(np.flatnonzero(off)[-1]) + 1 if off.any() else 0
    return float(time_s[last] - time_s[0] + 0.5 / frequency_hz)


def powers(energetics: Energetics, speed: Quantity | None) -> dict[str, Quantity]:
    """Power, torque and rate of the driven joints, and the cost of transport.

    Notes
    -----
    ``COT = P / V`` (dolphin, Eq 11), with the mean positive mechanical power of the joints: servos give
    nothing back to the battery. Losses of gear and motor are not in it.
    """
    positive = energetics.mean_positive_power_W()
    found = {
        "mean_power_W": Quantity(energetics.mean_power_W(), "W"),
        "mean_positive_power_W": Quantity(positive, "W"),
        "peak_torque_N_m": Quantity(float(np.abs(energetics.torque_N_m).max()), "N m"),
        "peak_joint_rate_rad_s": Quantity(float(np.abs(energetics.rate_rad_s).max()), "rad/s"),
    }
    if speed is not None and speed.value > 0:
        found["cost_of_transport_J_m"] = Quantity(positive / speed.value, "J/m")
    return found


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
        time, its arc between two beats taken as one of a circle. The range of the heading in the last beat
        is the tendon fish's xi (Table V): the smaller, the steadier the robot steers.
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
    duration = window.length_s
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
        f"{turn}_rate_range_rad_s": Quantity(float(np.ptp(columns[velocity[2]])), "rad/s"),
        f"{turn}_range_in_beat_rad": Quantity(float(np.ptp(heading[-PER_BEAT - 1 :])), "rad"),
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
