"""Oscillatory (orbital) flow: waves, and their reflections in a pool."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.constants import g
from scipy.interpolate import CubicSpline

from swimid.effects.base import (
    Array,
    Effect,
    Effects,
    Hooks,
    Inside,
    Model,
    Parameter,
    Parameters,
    Trial,
    Trials,
)
from swimid.effects.common import parameter

#: Frequencies looked at, Hz.
LOWEST, HIGHEST = 0.15, 3.0
#: A wave has so many periods in a trial: of fewer nothing tells it from a force that changes slowly.
PERIODS = 1.5
#: Lines of the tracks' spectrum that are tried, and the order of the slow course taken out before.
LINES, ORDER = 4, 5
#: Most frequencies looked at.
FINEST = 120
#: Lines that are tried with an amplitude that differs from place to place.
TRAVELLED = 1
#: A shallow pool, m.
DEPTH = 0.5
#: An oscillation makes more than this share of the variance of a track.
MOST = 0.5


class Waves(Effect):
    """Orbital velocity ``a cos(2 pi f t) + b sin(2 pi f t)`` along one axis of the world.

    The frequency is common; amplitude and phase, counted from the start, are each trial's own. The cosine
    sets in with ``1 - exp(-2 pi f t)``: a body that floats at the start moves with the water. It is
    tried at the strongest lines in what the model leaves of the track that are no harmonics of the beat.

    Parameters
    ----------
    axis : str
        ``x``, ``y`` or ``z``.
    frequency_hz : float
        Where it is tried.
    """

    name = "waves"
    meaning = "oscillatory (orbital) flow: waves or their reflections"
    sources = ("dolphin paper, section 4.2.1", "tendon fish paper, section V")
    needs = frozenset({"flow"})
    inside: ClassVar[Inside] = {"frequency_hz": "lower"}

    def __init__(self, axis: str = "x", frequency_hz: float = 1.0) -> None:
        self.axis = axis
        self.frequency_hz = frequency_hz

    def variants(self, model: Model, trials: Trials) -> Effects:
        """One per axis and line of the track, for a body that moves in time from place to place."""
        if "force" not in model.offers:
            return []  # an average over beats or runs has no motion within a wave's period
        found: list[Waves] = []
        along = f"{model.axes[0]}_m" if len(model.axes) == 2 else ""
        tracked = all(along in t.measured and np.isfinite(t.measured[along]).sum() > ORDER for t in trials)
        for axis in model.axes:
            strongest = lines(model, trials, axis)
            found += [Waves(axis, line) for line in strongest]
            if tracked:
                found += [_Travelling(axis, line) for line in strongest[:TRAVELLED]]
        return found

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Frequency, Hz, and each trial's cosine and sine amplitudes, m/s."""
        scales, along = model.scales(trials), f"amplitude of the water's velocity along {self.axis}"
        size = 0.1 * scales.speed
        near, words = 0.2 / scales.duration, "frequency of the waves"
        # within its scale of a bound it is no hypothesis
        least = max(0.5 * LOWEST, PERIODS / scales.duration - near)
        band = least, max(2.0 * HIGHEST, 2.0 * least)
        return (
            Parameter("frequency_hz", "Hz", *band, self.frequency_hz, near, meaning=words),
            *(
                parameter(f"{part}_{self.axis}_m_s", "m/s", size, f"{part} {along}", per_trial=True)
                for part in ("cos", "sin")
            ),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """The scale of each amplitude: the answer is linear in these, and nothing without them."""
        frequency, size = parameters[0].start, parameters[1].scale
        return [np.array([frequency, *part]) for part in ((size, 0.0), (0.0, size))]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Water that moves."""
        frequency, a, b = (float(v) for v in values)
        omega = 2.0 * math.pi * frequency
        column = 0 if self.axis == "x" else 1
        release = trial.rig.release_s
        begin = float(trial.time_s[0]) if release is None else release

        def flow(time_s: Array) -> tuple[Array, Array]:
            moved, velocity = np.zeros((len(time_s), 2)), np.zeros((len(time_s), 2))
            phase = omega * np.maximum(time_s - begin, 0.0)
            c, s, onset = np.cos(phase), np.sin(phase), np.exp(-phase)
            moved[:, column] = (a * (s + onset - 1.0) + b * (1.0 - c)) / omega
            velocity[:, column] = a * (c - onset) + b * s
            return moved, velocity

        return Hooks(flow=(flow,))


class _Travelling(Waves):
    """The same with another amplitude and phase in each place: a travelling, standing or reflected wave.

    Orbital velocity ``(a cos(k s) + c sin(k s)) cos(2 pi f t) + (b cos(k s) + d sin(k s)) sin(2 pi f t)``,
    *s* the place along the wave where the log has the body. The wave runs in a direction of its own where the
    body moves in a horizontal plane, along x where that is vertical.
    """

    meaning = "oscillatory (orbital) flow that differs from place to place: waves or their reflections"

    def variants(self, model: Model, trials: Trials) -> Effects:
        """None but those of the effect itself."""
        return []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Frequency (Hz), wavenumber (rad/m), of a horizontal plane direction (rad); amplitudes, m/s."""
        frequency, cosine, sine = super().parameters(model, trials)
        deep, shallow = wavenumbers(self.frequency_hz)
        track = [t.measured[f"{model.axes[0]}_m"] for t in trials]
        long = max(float(np.nanmax(x) - np.nanmin(x)) for x in track)
        size = min(0.5 / max(long, 1e-3), deep)
        shared = [
            frequency,
            parameter(
                "wavenumber_rad_m", "rad/m", size, "wavenumber", lower=0.0, upper=4.0 * shallow, start=deep
            ),
        ]
        if model.axes[1] == "y":
            toward = 0.0 if self.axis == "x" else 0.5 * math.pi
            shared.append(parameter("direction_rad", "rad", 0.2, "direction of the waves", start=toward))
        where = ("", "_quarter")
        return (
            *shared,
            *(replace(p, name=p.name.replace("_m_s", f"{at}_m_s")) for at in where for p in (cosine, sine)),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """The scale of each amplitude, in deep water and in shallow."""
        found = []
        for wavenumber in wavenumbers(self.frequency_hz):
            for j, p in enumerate(parameters):
                if p.per_trial:
                    point = np.array([q.start for q in parameters])
                    point[1], point[j] = wavenumber, p.scale
                    found.append(point)
        return found

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Water that moves, each place in its own way."""
        frequency, wavenumber, *direction = (float(v) for v in values[:-4])
        omega = 2.0 * math.pi * frequency
        first, second = (trial.measured.get(f"{axis}_m") for axis in model.axes)
        time = np.linspace(trial.time_s[0], trial.time_s[-1], max(len(trial.time_s), 2))
        place = _along(trial, first, time) * (math.cos(direction[0]) if direction else 1.0)
        unit = np.array([1.0, 0.0] if self.axis == "x" else [0.0, 1.0])
        if direction:
            unit = np.array([math.cos(direction[0]), math.sin(direction[0])])
            place = place + _along(trial, second, time) * unit[1]
        phase = omega * (time - time[0])
        c, s, onset = np.cos(phase), np.sin(phase), np.exp(-phase)
        a, b, quarter_a, quarter_b = values[-4:]
        here, there = np.cos(wavenumber * place), np.sin(wavenumber * place)
        speed = (a * here + quarter_a * there) * (c - onset) + (b * here + quarter_b * there) * s
        course = CubicSpline(time, speed)
        way = course.antiderivative()

        def flow(time_s: Array) -> tuple[Array, Array]:
            inside = np.clip(time_s, time[0], time[-1])
            return way(inside)[:, None] * unit, course(inside)[:, None] * unit

        return Hooks(flow=(flow,))


def wavenumbers(frequency_hz: float) -> tuple[float, float]:
    """Of surface waves in deep water and in water of `DEPTH`, rad/m, the latter to some 5 % (Eckart [1]_).

    References
    ----------
    .. [1] R. G. Dean, R. A. Dalrymple, *Water Wave Mechanics for Engineers and Scientists*, World Scientific,
       1991, chapter 3 (dispersion).
    """
    deep = (2.0 * math.pi * frequency_hz) ** 2 / g
    return deep, deep / math.sqrt(math.tanh(deep * DEPTH))


def _along(trial: Trial, series: Array | None, time_s: Array) -> Array:
    """Where the log has the body at some times; zero where it does not say."""
    if series is None or not np.isfinite(series).any():
        return np.zeros(len(time_s))
    there = np.isfinite(series)
    return np.asarray(np.interp(time_s, trial.time_s[there], series[there]))


def _simulated(model: Model, trial: Trial, channel: str) -> Array:
    """A channel as the model has it at its start values; nothing where it cannot be simulated."""
    values = np.array(
        [trial.starts.get(p.name, p.start) if p.per_trial else p.start for p in model.parameters]
    )
    with np.errstate(all="ignore"):
        series = model.simulate(values, trial).get(channel)
    return series if series is not None and np.isfinite(series).all() else np.zeros(len(trial.time_s))


def lines(model: Model, trials: Trials, axis: str) -> tuple[float, ...]:
    """The strongest lines along an axis that neither the model nor the beat explains, Hz.

    What the model leaves of each trial's track is freed of its slow course and its beat by least squares;
    the power of each frequency is its sum over the trials for whose beat it is no harmonic. The beat of a rig
    is the oscillation it is driven at: friction has harmonics of it, too.
    """
    name = f"{axis}_m"
    use = [t for t in trials if name in t.measured and np.isfinite(t.measured[name]).sum() > 4 * ORDER]
    if not use:
        return ()
    length = model.scales(trials).duration
    count = min(max(int((HIGHEST - LOWEST) * 2.0 * length), 8), FINEST)
    grid = np.linspace(max(LOWEST, PERIODS / length), HIGHEST, count)
    power, weight = np.zeros(count), np.zeros(count)
    for trial in use:
        there = np.isfinite(trial.measured[name])
        time = trial.time_s[there] - trial.time_s[0]
        width = 1.0 / max(float(time[-1]), 1e-9)
        beat = trial.swim.beat
        simulated = _simulated(model, trial, name)[there]
        base = float(beat.frequency_hz) if beat is not None else oscillation(time, simulated)
        harmonics = [k * base for k in (1, 2, 3) if base > 0.0]
        slow = np.polynomial.legendre.legvander(2.0 * time * width - 1.0, ORDER)
        waves = [f(2.0 * math.pi * h * time) for h in harmonics for f in (np.cos, np.sin)]
        known = np.linalg.qr(np.column_stack([slow, *waves]))[0]
        rest = trial.measured[name][there] - simulated
        rest = rest - known @ (known.T @ rest)
        highest = 0.5 / max(float(np.median(np.diff(time))), 1e-9)
        for k, f in enumerate(grid):
            if f > highest or any(abs(f - h) < width for h in harmonics):
                continue
            pair = np.column_stack([np.cos(2.0 * math.pi * f * time), np.sin(2.0 * math.pi * f * time)])
            pair, _ = np.linalg.qr(pair - known @ (known.T @ pair))
            power[k] += float(np.sum((pair.T @ rest) ** 2)) * f
            weight[k] += 1.0
    score = np.where(weight > 0, power / np.maximum(weight, 1.0), 0.0)
    strongest: list[float] = []
    for k in np.argsort(-score):
        if score[k] > 0 and all(abs(grid[k] - f) > 0.75 / length for f in strongest):
            strongest.append(float(grid[k]))
        if len(strongest) == LINES:
            break
    return tuple(strongest)


def oscillation(time_s: Array, series: Array) -> float:
    """Frequency of the oscillation that makes most of a series, Hz; 0 where none does."""
    from scipy.signal import lombscargle

    centred = series - series.mean()
    if len(series) < 2 * ORDER or not centred.any():
        return 0.0
    # less than two periods may as well be a slow course
    lasting = float(time_s[-1] - time_s[0])
    highest = 0.5 / float(np.median(np.diff(time_s)))
    grid = np.arange(2.0, max(lasting * min(2.0 * HIGHEST, highest), 2.5), 0.25) / lasting
    share = lombscargle(time_s, centred, 2.0 * np.pi * grid, normalize=True)
    best = int(np.argmax(share))
    return float(grid[best]) if share[best] > MOST else 0.0
