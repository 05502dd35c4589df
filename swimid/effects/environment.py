"""Effects of the robot's environment: buoyancy, currents, water surface, tether, walls and waves."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
from scipy.constants import g
from scipy.interpolate import CubicSpline

from swimid.effects import base
from swimid.effects.base import SIZES, Array, Effect, Effects, Model, Parameters, Trial, Trials, parameter
from swimid.files.kernels import numba
from swimid.fitting.model import FORCE_SIGNATURE, ExternalForce, Hooks, Parameter, traceable, typical


@traceable(on="hull", constants=2)
def rise(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add an upward force and a righting moment to the wrench.

    The constants are the force, and the moment per sine of the pitch angle.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] += constants[0] * s
    wrench[1] += constants[0] * c
    wrench[2] -= constants[1] * s


class Buoyancy(Effect):
    """Buoyancy in excess of weight, and the righting moment ``-m sin(pitch)``, on the heaviest link."""

    name = "buoyancy"
    meaning = "buoyancy beyond weight, and its righting moment"
    sources = ("dolphin paper, section 4.1", "sea lion paper, discussion")
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        The model must be a free swimmer in the vertical plane, or a rig along z. A rig whose rest position
        the model estimates is excluded.
        """
        if model.rig is not None:
            return model.axes == ("z",) and not model.estimates("rest_position")
        body = base.free_body(model)
        return body is not None and body.vertical

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the upward force as a parameter, N, and for a swimmer also the righting moment, N m."""
        size = 0.03 * model.scales(trials).force
        force = parameter("force_N", "N", size, "buoyancy beyond weight")
        body = model.body
        if body is None:
            return (force,)
        moment = size * body.lengths_m[body.hull]
        return force, parameter("righting_N_m", "N m", moment, "righting moment per sine of pitch")

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the constant upward force, and on a swimmer the righting moment."""
        body = model.body
        if body is not None:
            return Hooks(force=(base.force_at_hull(body, rise, np.array(values, dtype=float)),))
        return base.add_to_coefficient(values[0], "force")


#: Maximum speed of the current, divided by the typical speed of the robot.
MOST_CURRENT = 3.0


class Current(Effect):
    """Current: water that moves with constant velocity relative to the ground.

    A model with one axis has a current along its track.
    """

    name = "current"
    meaning = "steady current of the water"
    sources = ("Fossen 2011, Handbook of Marine Craft Hydrodynamics, section 8.3",)
    needs = frozenset({"flow"})
    smooth = True

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies: the model must have a body that travels."""
        return super().applies(model, trials) and bool(model.axes)

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return as parameters the velocity components of the water relative to the ground, m/s."""
        size = model.scales(trials).speed
        most, words = MOST_CURRENT * size, "velocity of the water along"
        return tuple(
            parameter(f"c{axis}_m_s", "m/s", 0.1 * size, f"{words} {axis}", -most, most)
            for axis in model.axes
        )

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that move the water with a constant velocity."""
        velocity = np.pad(values, (0, 2 - len(values)))

        def flow(time_s: Array) -> tuple[Array, Array]:
            return np.outer(time_s, velocity), np.tile(velocity, (len(time_s), 1))

        return Hooks(flow=(flow,))


#: Height above the water level over which the loss of buoyancy increases smoothly from zero, m.
SURFACE_ROUNDING_M = 0.002


@traceable(on="hull", constants=5)
def sink(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add to the wrench the buoyancy that the hull loses above the water surface.

    The constants are the force per height, the level of the surface, the position of the centre of mass
    relative to the reference point (along, across), and the lever arm.
    """
    s, c = math.sin(pose[2]), math.cos(pose[2])
    middle = pose[1] + constants[2] * s + constants[3] * c - constants[1]
    for side in (-1.0, 1.0):
        above = middle + side * constants[4] * s
        down = (
            -0.25
            * constants[0]
            * (above + math.sqrt(above * above + SURFACE_ROUNDING_M * SURFACE_ROUNDING_M))
        )
        wrench[0] += down * s
        wrench[1] += down * c
        wrench[2] += side * constants[4] * down * c


class SurfaceBreach(Effect):
    """Loss of the hull's buoyancy above a water level.

    The weight of the water that the hull no longer displaces pulls it down. Half of the force acts a quarter
    of the hull's length ahead of the hull's centre of mass, and half at the same distance behind it.
    """

    name = "surface-breach"
    meaning = "buoyancy lost above the surface"
    sources = ("dolphin paper, section 4.1",)

    def __init__(self, levels_m: tuple[float, ...] = (0.0,)) -> None:
        """Create the effect with the water levels, m, that are simulated before a fit."""
        self.levels_m = levels_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the effect if the model is a free swimmer in the vertical plane with a measured height."""
        heights = [t.measured["z_m"] for t in trials if "z_m" in t.measured]
        body = base.free_body(model)
        if body is None or not body.vertical or not heights or is_in_gas(model):
            return []
        values = np.concatenate(heights)
        return [SurfaceBreach(tuple(float(q) for q in np.nanquantile(values, (0.85, 0.5, 0.97))))]

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters: lost buoyancy per height, N/m, and level above which it is lost, m.

        The level is a height of the robot's reference point.
        """
        size = 0.2 * model.scales([_heights(t) for t in trials]).span
        slope = 0.1 * model.scales(trials).force / size
        words = "height of the reference point above which buoyancy is lost"
        return (
            parameter("force_N_m", "N/m", slope, "buoyancy lost per height", lower=0.0),
            parameter("level_m", "m", size, words, start=self.levels_m[0]),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit: several forces at each level."""
        return [np.array([s * parameters[0].scale, level]) for level in self.levels_m for s in SIZES[1:]]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the lost buoyancy and its moment to the heaviest link."""
        body = model.body
        x, y = body.centre(body.hull)
        a, b = x, y
        if body.hull == 0:
            a, b = body.reference_m
        constants = np.array([*values, x - a, y - b, 0.25 * body.lengths_m[body.hull]])
        return Hooks(force=(base.force_at_hull(body, sink, constants),))


def _heights(trial: Trial) -> Trial:
    """Return a copy of the trial with the height as its only measured channel."""
    measured = {name: value for name, value in trial.measured.items() if name == "z_m"}
    return Trial(trial.id, trial.role, trial.time_s, measured)


#: Minimum distance from the anchor of a tether, m, in the direction of its pull. It avoids a division by
#: zero.
MIN_DISTANCE_M = 1e-30


@traceable(on="base", constants=5)
def pull_back(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the pull of a tether towards its anchor, and the drag of its line, to the wrench.

    The constants are the stiffness, the slack, the drag of the line, and the two coordinates of the anchor.
    """
    dx, dy = pose[0] - constants[3], pose[1] - constants[4]
    distance = math.sqrt(dx * dx + dy * dy)
    u, v = velocity[0], velocity[1]
    drag = constants[2] * distance * math.sqrt(u * u + v * v)
    wrench[0] -= drag * u
    wrench[1] -= drag * v
    # The pull is zero at the anchor itself.
    pull = constants[0] * max(distance - constants[1], 0.0) / max(distance, MIN_DISTANCE_M)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= pull * (c * dx + s * dy)
    wrench[1] -= pull * (c * dy - s * dx)


class Tether(Effect):
    """Tether: a pull ``-k (d - slack)`` towards an anchor at distance d, if d exceeds the slack.

    The anchor is at the start of the trial. For a swimmer it may also be behind the start, so that the line
    pulls from the beginning. The line in the water has the drag ``-c d v |v|``. In timed cruising, the mean
    of the pull over the course acts.
    """

    name = "tether"
    meaning = "cable whose pull on the robot grows with the distance from its anchor"
    sources = ("dolphin paper, section 1",)

    def applies(self, model: Model, trials: Trials) -> bool:
        """Return whether the effect applies.

        It applies to a pulled body on a rig, timed cruising or a free swimmer.
        """
        swims = model.swimmer is not None and model.swimmer.free_base
        return base.is_pulled(model) or model.timed_runs or swims

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the tether that the trials can show.

        All trials show the stiffness, N/m, and the slack, m. A motion in time also shows the drag of the
        line, N s2/m3. A swimmer also shows the distance of the anchor behind the start, m.
        """
        scales, size = model.scales(trials), _reach(model, trials)
        force = scales.force
        if model.swimmer is not None:
            force = model.swimmer.typical_force(scales)
        stiffness = 0.3 * force / size
        pull = (
            parameter("stiffness_N_m", "N/m", stiffness, "pull of the tether per length", lower=0.0),
            parameter("slack_m", "m", 0.2 * size, "slack length of the tether", 0.0, size),
        )
        drag, words = 0.3 * force / (size * scales.speed**2), "distance of the anchor behind the start"
        line = parameter("line_drag_N_s2_m3", "N s^2/m^3", drag, "drag of the line per length", lower=0.0)
        if model.timed_runs:
            return pull
        if model.swimmer is None:
            return (*pull, line)
        return (*pull, line, parameter("behind_m", "m", 0.2 * size, words, 0.0, size))

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors of the tether that are simulated before a fit.

        Three vectors have the same stiffness: without slack, with slack, and with the anchor behind the
        start. One vector has only a drag of the line.
        """
        scale = np.array([p.scale for p in parameters])
        steps = [(SIZES[1],), (SIZES[1], 2.0), (0.0, 0.0, SIZES[1]), (SIZES[1], 0.0, 0.0, 2.0)]
        return [
            scale * np.pad(step, (0, len(scale) - len(step))) for step in steps if len(step) <= len(scale)
        ]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the pull of the tether to the base, or its mean in timed cruising."""
        if model.timed_runs:
            way = np.asarray(trial.inputs["distance_m"], dtype=float)
            mean = float(np.mean(0.5 * values[0] * np.maximum(way - values[1], 0.0) ** 2 / way))
            return base.add_to_coefficient(mean, "dry")
        line, anchor, (x, y) = list(values), (trial.rig.x0, 0.0), (0.0, 0.0)
        if model.swimmer is not None:
            *line, behind = values
            start_x, start_y, heading = model.swimmer.start_course(trial)
            anchor = (start_x - behind * math.cos(heading), start_y - behind * math.sin(heading))
            x, y = model.swimmer.reference_m[:2]
        return Hooks(force=(ExternalForce(pull_back, np.array([*line, *anchor]), x=x, y=y),))


def _reach(model: Model, trials: Trials) -> float:
    """Return the typical distance that the robot moves from its start in a trial, m."""
    if model.timed_runs:
        return typical([w for t in trials for w in np.atleast_1d(t.inputs["distance_m"])], 1.0)
    return model.scales(trials).span


#: Maximum exponent of the exponential influence of a wall. It limits the influence beyond the end of the
#: measured tracks.
STEEPEST = 2.0


@traceable(on="hull", constants=5)
def push_off(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add the force by which a wall pushes the swimmer away to the wrench.

    The constants are the force per squared speed at the end of the tracks, the decay length, the direction to
    the wall (x, y), and the coordinate of the end of the tracks.
    """
    along, across = constants[2], constants[3]
    gap = constants[4] - (along * pose[0] + across * pose[1])
    squared = velocity[0] * velocity[0] + velocity[1] * velocity[1]
    push = constants[0] * squared * math.exp(min(-gap / constants[1], STEEPEST))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    wrench[0] -= push * (c * along + s * across)
    wrench[1] -= push * (c * across - s * along)


@numba.cfunc(FORCE_SIGNATURE, cache=True)
def blockage(t, pose, velocity, constants, wrench):  # type: ignore[no-untyped-def]
    """Add to the wrench the additional drag of a body on a rig near a wall.

    The constants are the quadratic drag coefficient, its relative increase, the decay length, and the
    coordinate of the end of the tracks.
    """
    grown = constants[1] * math.exp(min(-(constants[3] - pose[0]) / constants[2], STEEPEST))
    wrench[0] -= constants[0] * grown * velocity[0] * abs(velocity[0])


class Wall(Effect):
    """Wall at one side of the pool, whose influence decays exponentially with distance.

    The influence of the wall is ``exp(-d / l)``. Here l is the decay length, and d is the distance from the
    end of the tracks on that side. A swimmer with the speed V is pushed away from the wall by the force ``c
    V^2 exp(-d / l)``, or drawn to it if c is negative. The pressure of the flow between hull and wall is
    proportional to the squared speed. The quadratic drag of a body on a rig is multiplied by ``1 + gain
    exp(-d / l)``.

    Parameters
    ----------
    side : str
        Side of the pool: ``x_max``, ``x_min``, ``y_max`` and so on.
    extreme_m : float
        Coordinate of the end of the tracks on that side.
    """

    name = "wall"
    meaning = "wall near the tracks"
    sources = ("tendon fish paper, section V", "dolphin paper, section 4.2.1")

    def __init__(self, side: str = "x_max", extreme_m: float = 0.0) -> None:
        self.side = side
        self.extreme_m = extreme_m

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return the possible walls: one per side for a free swimmer, or one at the far end for a rig."""
        walls: list[Effect] = []
        for axis in model.axes:
            series = [t.measured[f"{axis}_m"] for t in trials if f"{axis}_m" in t.measured]
            values = np.concatenate([np.zeros(0), *series])
            values = values[np.isfinite(values)]
            if not len(values):
                continue
            if base.free_body(model) is not None:
                walls.append(_Push(f"{axis}_max", float(values.max())))
                walls.append(_Push(f"{axis}_min", float(values.min())))
            elif base.is_pulled(model):
                walls.append(Wall(f"{axis}_max", float(values.max())))
        return walls

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters: influence of the wall at the end of the tracks, and decay length, m.

        The influence is a force per squared speed, N s2/m2, on a swimmer, or a relative increase of drag on a
        rig.
        """
        if model.body is not None:
            length, scales = sum(model.body.lengths_m), model.scales(trials)
            size = 0.05 * scales.force / scales.speed**2
            words = "force of the wall at the extreme of the tracks per squared speed"
            first = parameter(f"{self.side}_push_N_s2_m2", "N s^2/m^2", size, words)
        else:
            length = 0.4 * model.scales(trials).span
            words = "relative growth of drag at the extreme of the tracks"
            first = parameter(f"{self.side}_gain", "1", 1.0, words, lower=0.0)
        lower, upper, start, size = (share * length for share in (0.1, 3.0, 0.5, 0.2))
        words = "decay length of the effect of the wall"
        return first, parameter(f"{self.side}_decay_m", "m", size, words, lower, upper, start=start)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return the parameter vectors that are simulated before a fit.

        The vectors have one push and one pull, or one growth of drag, at two decay lengths. One size is
        enough, because the simulated trials change nearly in proportion to it. A fit that starts at a push
        may not reach a pull, which draws the swimmer into the steep part of the influence.
        """
        force, decay = parameters
        sizes = [s * SIZES[1] * force.scale for s in (1.0, -1.0) if s * force.scale >= force.lower]
        return [np.array(point) for point in itertools.product(sizes, (0.5 * decay.start, 1.5 * decay.start))]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that add the wall's force at the hull of a swimmer, or its drag on a rig."""
        body = model.body
        if body is not None:
            axis, end = self.side.split("_")
            side = {"max": 1.0, "min": -1.0}[end]
            place = [side * (axis == "x"), side * (axis != "x"), side * self.extreme_m]
            return Hooks(force=(base.force_at_hull(body, push_off, np.array([*values, *place])),))
        return base.force_on_rig(blockage, [0.0, *values, self.extreme_m], quadratic=0)


class _Push(Wall):
    """Wall near a free swimmer, with a decay length below three body lengths.

    With a longer decay length, the force of the wall could imitate any slowly varying force.
    """

    inside = {f"{axis}_{end}_decay_m": "upper" for axis in "xyz" for end in ("min", "max")}


#: Lowest and highest frequency at which waves are searched in the measured tracks, Hz.
LOWEST, HIGHEST = 0.15, 3.0
#: Minimum number of wave periods in a trial. With fewer periods, waves cannot be distinguished from a slowly
#: varying force.
PERIODS = 1.5
#: Search for waves in the measured tracks: maximum number of spectral lines that are tried as waves (LINES),
#: and order of the polynomial in time that is removed from the tracks before (ORDER).
LINES, ORDER = 4, 5
#: Maximum number of frequencies in the spectrum of a track.
FINEST = 120
#: Number of spectral lines that are also tried as waves whose amplitude depends on the place.
TRAVELLED = 1
#: Water depth of a shallow pool for which wavenumbers are computed, m.
DEPTH = 0.5
#: Fraction of a track's variance at one frequency above which the track counts as an oscillation.
MIN_OSCILLATION_SHARE = 0.5


#: Minimum density of a fluid with a free surface, kg/m^3. Liquids in which robots swim have at least half the
#: density of water, gases at the pressure of a laboratory have at most a hundredth of it.
MIN_LIQUID_DENSITY = 100.0


def is_in_gas(model: Model) -> bool:
    """Return whether the robot moves in a gas, which has no free surface and therefore no waves."""
    density = model.fluid_density_kg_m3
    return density is not None and density < MIN_LIQUID_DENSITY


class Waves(Effect):
    """Waves: orbital water velocity ``a cos(2 pi f t) + b sin(2 pi f t)`` along one axis fixed to the ground.

    The frequency is common to all trials. Each trial has its own amplitude and phase, with the time counted
    from its start. The cosine sets in with ``1 - exp(-2 pi f t)``, because a body that floats at the start
    moves with the water. The effect is tried at the strongest spectral lines of the track that neither the
    model nor the beat explains.

    Parameters
    ----------
    axis : str
        ``x``, ``y`` or ``z``.
    frequency_hz : float
        Frequency at which the effect is tried.
    """

    name = "waves"
    meaning = "oscillatory (orbital) flow: waves or their reflections"
    sources = ("dolphin paper, section 4.2.1", "tendon fish paper, section V")
    inside = {"frequency_hz": "lower"}

    def __init__(self, axis: str = "x", frequency_hz: float = 1.0) -> None:
        self.axis = axis
        self.frequency_hz = frequency_hz

    def variants(self, model: Model, trials: Trials) -> Effects:
        """Return one form of the effect for each axis and each strong spectral line of the tracks.

        The result is empty for a model without motion in time, and in a gas.
        """
        # A model of averages over beats or courses has no motion within the period of a wave.
        if "force" not in model.offers or is_in_gas(model):
            return []
        found: list[Waves] = []
        tracked = len(model.axes) == 2 and all(
            np.isfinite(t.measured.get(f"{model.axes[0]}_m", math.nan)).sum() > ORDER for t in trials
        )
        for axis in model.axes:
            strongest = find_lines(model, trials, axis)
            found += [Waves(axis, line) for line in strongest]
            found += [_Travelling(axis, line) for line in strongest[: TRAVELLED * tracked]]
        return found

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the waves: frequency, Hz, and cosine and sine amplitude per trial, m/s."""
        scales, along = model.scales(trials), f"amplitude of the water's velocity along {self.axis}"
        size = 0.1 * scales.speed
        near, words = 0.2 / scales.duration, "frequency of the waves"
        # Extend the lower bound by the scale of the frequency. An estimate closer to the bound than the scale
        # is not accepted as a hypothesis.
        least = max(0.5 * LOWEST, PERIODS / scales.duration - near)
        band = least, max(2.0 * HIGHEST, 2.0 * least)
        return (
            Parameter("frequency_hz", "Hz", *band, self.frequency_hz, near, meaning=words),
            parameter(f"cos_{self.axis}_m_s", "m/s", size, f"cos {along}", per_trial=True),
            parameter(f"sin_{self.axis}_m_s", "m/s", size, f"sin {along}", per_trial=True),
        )

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return parameter vectors, each of which is simulated before a fit to choose its start values.

        Each vector has one amplitude at its scale, because the simulated trials change in proportion to it.
        """
        frequency, size = parameters[0].start, parameters[1].scale
        return [np.array([frequency, *part]) for part in ((size, 0.0), (0.0, size))]

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that move the water with the orbital velocity of the waves."""
        frequency, a, b = (float(v) for v in values)
        omega = 2.0 * math.pi * frequency
        column = int(self.axis != "x")
        begin = trial.rig.release_s
        if begin is None:
            begin = float(trial.time_s[0])

        def flow(time_s: Array) -> tuple[Array, Array]:
            moved, velocity = np.zeros((len(time_s), 2)), np.zeros((len(time_s), 2))
            phase = omega * np.maximum(time_s - begin, 0.0)
            c, s, onset = np.cos(phase), np.sin(phase), np.exp(-phase)
            moved[:, column] = (a * (s + onset - 1.0) + b * (1.0 - c)) / omega
            velocity[:, column] = a * (c - onset) + b * s
            return moved, velocity

        return Hooks(flow=(flow,))


class _Travelling(Waves):
    """Waves whose amplitude and phase depend on the place: travelling, standing or reflected waves.

    The orbital velocity is ``(a cos(k s) + c sin(k s)) cos(2 pi f t) + (b cos(k s) + d sin(k s)) sin(2 pi f
    t)``. Here *s* is the measured position of the body along the direction of the wave. In a horizontal plane
    this direction is a parameter. In a vertical plane the wave runs along x.
    """

    meaning = "oscillatory (orbital) flow that differs from place to place: waves or their reflections"

    def parameters(self, model: Model, trials: Trials) -> Parameters:
        """Return the parameters of the waves.

        They are the frequency (Hz), the wavenumber (rad/m), the direction in a horizontal plane (rad), and
        the amplitudes (m/s).
        """
        frequency, cosine, sine = super().parameters(model, trials)
        deep, shallow = wavenumbers(self.frequency_hz)
        track = [t.measured[f"{model.axes[0]}_m"] for t in trials]
        long = max(float(np.nanmax(x) - np.nanmin(x)) for x in track)
        size = min(0.5 / max(long, 1e-3), deep)
        shared = [
            frequency,
            parameter("wavenumber_rad_m", "rad/m", size, "wavenumber", 0.0, 4.0 * shallow, start=deep),
        ]
        if model.axes[1] == "y":
            toward = 0.5 * math.pi * (self.axis != "x")
            shared.append(parameter("direction_rad", "rad", 0.2, "direction of the waves", start=toward))
        quarter = [replace(p, name=p.name.replace("_m_s", "_quarter_m_s")) for p in (cosine, sine)]
        return (*shared, cosine, sine, *quarter)

    def tries(self, parameters: Parameters) -> list[Array]:
        """Return parameter vectors, each of which is simulated before a fit to choose its start values.

        Each vector has one amplitude at its scale, and the wavenumber in deep or in shallow water.
        """
        amplitudes = [j for j, p in enumerate(parameters) if p.per_trial]
        found = []
        for wavenumber, j in itertools.product(wavenumbers(self.frequency_hz), amplitudes):
            point = np.array([p.start for p in parameters])
            point[1], point[j] = wavenumber, parameters[j].scale
            found.append(point)
        return found

    def hooks(self, values: Array, trial: Trial, model: Model) -> Hooks:
        """Return hooks that move the water with the orbital velocity at the place of the body."""
        frequency, wavenumber, *direction = (float(v) for v in values[:-4])
        omega = 2.0 * math.pi * frequency
        first, second = (trial.measured.get(f"{axis}_m") for axis in model.axes)
        time = np.linspace(trial.time_s[0], trial.time_s[-1], max(len(trial.time_s), 2))
        place = _along(trial, first, time)
        unit = np.array([float(self.axis == "x"), float(self.axis != "x")])
        if direction:
            unit = np.array([math.cos(direction[0]), math.sin(direction[0])])
            place = place * unit[0] + _along(trial, second, time) * unit[1]
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
    """Return the wavenumbers of surface waves in deep water and in water of depth `DEPTH`, rad/m.

    The wavenumber in shallow water is accurate to about 5 % (Eckart [1]_).

    References
    ----------
    .. [1] R. G. Dean, R. A. Dalrymple, *Water Wave Mechanics for Engineers and Scientists*, World Scientific,
       1991, chapter 3 (dispersion).
    """
    deep = (2.0 * math.pi * frequency_hz) ** 2 / g
    return deep, deep / math.sqrt(math.tanh(deep * DEPTH))


def _along(trial: Trial, series: Array | None, time_s: Array) -> Array:
    """Return a measured coordinate of the body, interpolated to given times; zeros if it is unknown."""
    if series is None or not np.isfinite(series).any():
        return np.zeros(len(time_s))
    there = np.isfinite(series)
    return np.asarray(np.interp(time_s, trial.time_s[there], series[there]))


def _simulate_channel(model: Model, trial: Trial, channel: str) -> Array:
    """Return a simulated channel with the parameters at their start values; zeros if the simulation fails."""
    own = [p.name for p in model.parameters if p.per_trial]
    starts = {name: trial.starts[name] for name in own if name in trial.starts}
    values = np.array([starts.get(p.name, p.start) for p in model.parameters])
    series = model.run(values, trial).get(channel)
    if series is None or not np.isfinite(series).all():
        return np.zeros(len(trial.time_s))
    return series


def find_lines(model: Model, trials: Trials, axis: str) -> tuple[float, ...]:
    """Return the frequencies, Hz, of the strongest spectral lines of the tracks along an axis.

    Lines that the model or the beat explains are excluded. A polynomial in time and the beat are removed by
    least squares from the residuals of each trial's track. The power of a frequency is its mean over those
    trials whose beat has no harmonic at the frequency. The beat of a rig is the oscillation of the simulated
    track, because friction also has harmonics of that oscillation.
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
        time, rest, known, harmonics = _remove_beat(model, trial, name)
        width = 1.0 / max(float(time[-1]), 1e-9)
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
    return tuple(strongest[:LINES])


def _remove_beat(model: Model, trial: Trial, channel: str) -> tuple[Array, Array, Array, list[float]]:
    """Remove a polynomial in time and the harmonics of the beat from the residuals of a track.

    Returns
    -------
    time, rest : ndarray, shape (n,)
            Time since the start of the trial, s, and the remaining residuals.
    known : ndarray, shape (n, m)
            Orthonormal basis of the removed polynomial and harmonics: m columns.
    harmonics : list of float
        Frequencies of the beat, Hz.
    """
    there = np.isfinite(trial.measured[channel])
    time = trial.time_s[there] - trial.time_s[0]
    width = 1.0 / max(float(time[-1]), 1e-9)
    beat = trial.swim.beat
    simulated = _simulate_channel(model, trial, channel)[there]
    beating = find_oscillation(time, simulated) if beat is None else float(beat.frequency_hz)
    harmonics = [k * beating for k in (1, 2, 3) if beating > 0.0]
    slow = np.polynomial.legendre.legvander(2.0 * time * width - 1.0, ORDER)
    waves = [f(2.0 * math.pi * h * time) for h in harmonics for f in (np.cos, np.sin)]
    known = np.linalg.qr(np.column_stack([slow, *waves]))[0]
    rest = trial.measured[channel][there] - simulated
    return time, rest - known @ (known.T @ rest), known, harmonics


def find_oscillation(time_s: Array, series: Array) -> float:
    """Return the dominant frequency of a series, Hz.

    Return 0 if less than half of the variance is at one frequency.
    """
    from scipy.signal import lombscargle

    centred = series - series.mean()
    if len(series) < 2 * ORDER or not centred.any():
        return 0.0
    # Search only frequencies with at least two periods in the series. Fewer periods could be slow motion.
    lasting = float(time_s[-1] - time_s[0])
    highest = 0.5 / float(np.median(np.diff(time_s)))
    grid = np.arange(2.0, max(lasting * min(2.0 * HIGHEST, highest), 2.5), 0.25) / lasting
    share = lombscargle(time_s, centred, 2.0 * np.pi * grid, normalize=True)
    best = int(np.argmax(share))
    if share[best] <= MIN_OSCILLATION_SHARE:
        return 0.0
    return float(grid[best])
