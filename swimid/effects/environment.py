"""Effects of the place the robot swims in."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numba import cfunc
from scipy.constants import g
from scipy.interpolate import CubicSpline

from swimid.effects import common
from swimid.effects.base import (
    SIZES,
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
from swimid.fitting.hooks import FORCE_SIGNATURE, Force, traceable


@traceable(on="hull", constants=2)
def rise(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A force upwards and a righting moment; constants force and moment per sine of pitch."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] += constants[0] * s
    wrench[1] += constants[0] * c
    wrench[2] -= constants[1] * s


class Buoyancy(Effect):
    """Buoyancy beyond weight, and its righting moment ``-m sin(pitch)``, on the heaviest link."""

    name = "buoyancy"
    meaning = "buoyancy beyond weight, and its righting moment"
    sources = ("dolphin paper, section 4.1", "sea lion paper, discussion")
    needs = frozenset({"force", "coefficients"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers in the vertical plane; rigs along z whose rest position is known."""
        if model.rig is not None:
            known = not model.estimates("rest_position")
            return [self] if model.axes == ("z",) and known else []
        body = common.free_body(model)
        return [self] if body is not None and body.vertical else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force upwards, N, and righting moment, N m."""
        size = 0.03 * model.scales(trials).force
        force = parameter("force_N", "N", size, "buoyancy beyond weight")
        body = model.body
        if body is None:
            return (force,)
        moment = size * body.lengths_m[body.hull]
        return force, parameter("righting_N_m", "N m", moment, "righting moment per sine of pitch")

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A constant force, and a moment."""
        body = model.body
        if body is not None:
            return Hooks(force=(common.at_hull(body, rise, np.array(values, dtype=float)),))
        return common.more("force", values[0])


#: Largest current, in typical speeds of the robot.
MOST_CURRENT = 3.0


class Current(Effect):
    """Water that moves evenly and steadily in the world; along the track where the model has one axis."""

    name = "current"
    meaning = "steady current of the water"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 8.3",)
    needs = frozenset({"flow"})
    smooth = True

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Models of a body that moves from place to place."""
        return super().variants(model, trials) if model.axes else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Its components in the world, m/s."""
        size = model.scales(trials).speed
        most, words = MOST_CURRENT * size, "velocity of the water along"
        return tuple(
            parameter(f"c{axis}_m_s", "m/s", 0.1 * size, f"{words} {axis}", lower=-most, upper=most)
            for axis in model.axes
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Water that moves."""
        velocity = np.zeros(2)
        velocity[: len(values)] = values

        def flow(time_s: Array) -> tuple[Array, Array]:
            return np.outer(time_s, velocity), np.tile(velocity, (len(time_s), 1))

        return Hooks(flow=(flow,))


#: Height over which the force sets in, m.
ROUND = 0.002


@traceable(on="hull", constants=5)
def sink(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Weight of what has left the water; constants force per height, level, place of the point, lever."""
    s, c = math.sin(pose[2]), math.cos(pose[2])
    middle = pose[1] + constants[2] * s + constants[3] * c - constants[1]
    for side in (-1.0, 1.0):
        above = middle + side * constants[4] * s
        down = -0.25 * constants[0] * (above + math.sqrt(above * above + ROUND * ROUND))
        wrench[0] += down * s
        wrench[1] += down * c
        wrench[2] += side * constants[4] * down * c


class SurfaceBreach(Effect):
    """Above a level the hull is pulled down by the weight of the water it no longer displaces.

    Half of it acts a quarter of the hull's length ahead of its centre of mass, half as far behind.
    """

    name = "surface-breach"
    meaning = "buoyancy lost above the surface"
    sources = ("dolphin paper, section 4.1",)
    needs = frozenset({"force"})

    def __init__(self, levels_m: tuple[float, ...] = (0.0,)) -> None:
        """Take the levels at which it is tried."""
        self.levels_m = levels_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Free swimmers in the vertical plane whose height is measured."""
        heights = [t.measured["z_m"] for t in trials if "z_m" in t.measured]
        body = common.free_body(model)
        if body is None or not body.vertical or not heights:
            return []
        values = np.concatenate(heights)
        return [SurfaceBreach(tuple(float(q) for q in np.nanquantile(values, (0.85, 0.5, 0.97))))]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force per height, N/m, and level of the reference point, m."""
        size = 0.2 * model.scales([_heights(t) for t in trials]).span
        slope = 0.1 * model.scales(trials).force / size
        words = "height of the reference point above which buoyancy is lost"
        return (
            parameter("force_N_m", "N/m", slope, "buoyancy lost per height", lower=0.0),
            parameter("level_m", "m", size, words, start=self.levels_m[0]),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Sizes of the force at each level."""
        return [np.array([s * parameters[0].scale, level]) for level in self.levels_m for s in SIZES[1:]]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force and its moment on the heaviest link."""
        body = common.links(model)
        hull = body.hull
        x, y = body.centre(hull)
        a, b = body.reference_m if hull == 0 else (x, y)
        quarter = 0.25 * body.lengths_m[hull]
        constants = np.array([*values, x - a, y - b, quarter])
        return Hooks(force=(common.at_hull(body, sink, constants),))


def _heights(trial: Trial) -> Trial:
    """The trial with its height alone."""
    measured = {name: value for name, value in trial.measured.items() if name == "z_m"}
    return Trial(trial.id, trial.role, trial.time_s, measured)


#: Less than any distance that can be told from none, m.
TINY = 1e-30


@traceable(on="base", constants=5)
def pull_back(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A spring to a point of the world and a line that drags; stiffness, slack, line drag, the point."""
    dx, dy = pose[0] - constants[3], pose[1] - constants[4]
    distance = math.sqrt(dx * dx + dy * dy)
    u, v = velocity[0], velocity[1]
    drag = constants[2] * distance * math.sqrt(u * u + v * v)
    wrench[0] -= drag * u
    wrench[1] -= drag * v
    # at the anchor itself there is no direction, and no pull
    pull = constants[0] * max(distance - constants[1], 0.0) / max(distance, TINY)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= pull * (c * dx + s * dy)
    wrench[1] -= pull * (c * dy - s * dx)


class Tether(Effect):
    """``-k (d - slack)`` towards its anchor, d the distance from it, once d exceeds the slack.

    The anchor is where the run starts; that of a swimmer may lie behind it, so that the line pulls from the
    beginning. The line paid out drags, ``-c d v |v|``. A cruise feels the mean of the pull over the run.
    """

    name = "tether"
    meaning = "cable that pulls the robot back the more the farther it is"
    sources = ("dolphin paper, section 1",)
    needs = frozenset({"force", "coefficients"})

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Falling weights, towed bodies, cruises and free swimmers."""
        return [self] if common.pulled(model) or model.timed_runs or common.free_body(model) else []

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Stiffness, N/m, slack, m; drag of the line, N s2/m3, for what moves in time; for a swimmer the
        distance of the anchor behind the start, m.
        """
        scales, size = model.scales(trials), _reach(model, trials)
        stiffness = 0.3 * scales.force / size
        pull = (
            parameter("stiffness_N_m", "N/m", stiffness, "pull of the tether per length", lower=0.0),
            parameter("slack_m", "m", 0.2 * size, "length before it pulls", lower=0.0, upper=size),
        )
        if model.timed_runs:
            return pull
        drag = 0.3 * scales.force / (size * scales.speed**2)
        words = "drag of the line per length"
        line = parameter("line_drag_N_s2_m3", "N s^2/m^3", drag, words, lower=0.0)
        if model.body is None:
            return (*pull, line)
        words = "distance of the anchor behind the start"
        return (*pull, line, parameter("behind_m", "m", 0.2 * size, words, lower=0.0, upper=size))

    def tries(self, parameters: Parameters) -> list[Array]:
        """A stiffness, without slack and with, or an anchor behind the start; a drag of the line."""
        scale = np.array([p.scale for p in parameters])
        steps = [(SIZES[1],), (SIZES[1], 2.0), (0.0, 0.0, SIZES[1]), (SIZES[1], 0.0, 0.0, 2.0)]
        return [
            scale * np.pad(step, (0, len(scale) - len(step))) for step in steps if len(step) <= len(scale)
        ]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force on the base, or on the mean of a run."""
        if model.timed_runs:
            way = np.asarray(trial.inputs["distance_m"], dtype=float)
            mean = float(np.mean(0.5 * values[0] * np.maximum(way - values[1], 0.0) ** 2 / way))
            return common.more("dry", mean)
        if model.body is not None:
            *line, behind = values
            start_x, start_y, heading = trial.swim.posed()
            anchor = (start_x - behind * math.cos(heading), start_y - behind * math.sin(heading))
            x, y = model.body.reference_m
            return Hooks(force=(Force(pull_back, np.array([*line, *anchor]), x=x, y=y),))
        origin = trial.rig.x0
        return Hooks(force=(Force(pull_back, np.array([*values, origin, 0.0])),))


def _reach(model: Model, trials: Trials) -> float:
    """Typical distance from the start, m."""
    if model.timed_runs:
        ways = [w for t in trials for w in np.atleast_1d(t.inputs["distance_m"])]
        return float(np.median(ways)) or 1.0
    return model.scales(trials).span


#: Largest exponent: a start beyond the extreme of the measured tracks is not far beyond.
STEEPEST = 2.0


@traceable(on="hull", constants=5)
def push_off(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """A force along a world axis; constants force, decay length, direction to the wall, extreme along it."""
    along, across = constants[2], constants[3]
    gap = constants[4] - (along * pose[0] + across * pose[1])
    push = constants[0] * math.exp(min(-gap / constants[1], STEEPEST))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= push * (c * along + s * across)
    wrench[1] -= push * (c * across - s * along)


@cfunc(FORCE_SIGNATURE, cache=True)
def blockage(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """More drag towards the end of a run; constants drag, gain, decay length and end."""
    grown = constants[1] * math.exp(min(-(constants[3] - pose[0]) / constants[2], STEEPEST))
    wrench[0] -= constants[0] * grown * velocity[0] * abs(velocity[0])


class Wall(Effect):
    """A wall at one side of the pool, felt as ``exp(-d / l)``, d the distance from the tracks' extreme.

    A swimmer is pushed away from it (drawn to it where the force is negative); the quadratic drag of a
    body on a rig grows towards it by the factor ``1 + gain exp(-d / l)``.

    Parameters
    ----------
    side : str
        ``x_max``, ``x_min``, ``y_max`` and so on.
    extreme_m : float
        The tracks' extreme coordinate on that side.
    """

    name = "wall"
    meaning = "wall near the tracks"
    sources = ("tendon fish paper, section V", "dolphin paper, section 4.2.1")
    needs = frozenset({"force"})

    def __init__(self, side: str = "x_max", extreme_m: float = 0.0) -> None:
        self.side = side
        self.extreme_m = extreme_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """One per side for free swimmers; the far end for falling weights and towed bodies."""
        names = tuple(f"{axis}_m" for axis in model.axes)
        if common.free_body(model):
            ends: tuple[str, ...] = ("max", "min")
        elif common.pulled(model):
            ends = ("max",)
        else:
            return []
        walls: list[Effect] = []
        for name in names:
            values = np.concatenate([np.zeros(0), *(t.measured[name] for t in trials if name in t.measured)])
            values = values[np.isfinite(values)]
            for end in ends if len(values) else ():
                extreme = float(values.max() if end == "max" else values.min())
                kind = _Push if common.free_body(model) else Wall
                walls.append(kind(f"{name.removesuffix('_m')}_{end}", extreme))
        return walls

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Force at the tracks' extreme, N (gain of the drag on a rig), and its decay length, m."""
        if model.body is not None:
            length = sum(model.body.lengths_m)
            size = 0.05 * model.scales(trials).force
            words = "push of the wall at the extreme"
            first = parameter(f"{self.side}_force_N", "N", size, words)
        else:
            length = 0.4 * model.scales(trials).span
            words = "relative growth of drag at the extreme"
            first = parameter(f"{self.side}_gain", "1", 1.0, words, lower=0.0)
        lower, upper, start, size = (share * length for share in (0.1, 3.0, 0.5, 0.2))
        words = "length over which it decays"
        name = f"{self.side}_decay_m"
        return first, parameter(name, "m", size, words, lower=lower, upper=upper, start=start)

    def tries(self, parameters: Parameters) -> list[Array]:
        """The force, in which the change is nearly linear, at two decay lengths."""
        force, decay = parameters
        return [np.array([SIZES[1] * force.scale, share * decay.start]) for share in (0.5, 1.5)]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """A force at the centre of mass of the heaviest link."""
        body = model.body
        if body is not None:
            axis, end = self.side.split("_")
            side = 1.0 if end == "max" else -1.0
            place = [side if axis == "x" else 0.0, 0.0 if axis == "x" else side, side * self.extreme_m]
            return Hooks(force=(common.at_hull(body, push_off, np.array([*values, *place])),))
        constants = np.array([0.0, *values, self.extreme_m])

        def take(c: dict[str, float]) -> None:
            constants[0] = c["quadratic"]

        return Hooks(coefficients=(take,), force=(Force(blockage, constants),))


class _Push(Wall):
    """Of a free swimmer: a push felt three lengths of its body away could stand for any slow force."""

    inside: ClassVar[Inside] = {f"{axis}_{end}_decay_m": "upper" for axis in "xyz" for end in ("min", "max")}


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
