"""Model of a test rig with one degree of freedom: falling weight, towing and free decay.

One equation of motion describes the falling weight, towing and free decay::

    (m + m_added + m_pull + m_pulley) x'' = F - dry sgn(x') - linear x'
                                            - quadratic x' |x'| - R(x - x_rest)

with ``R(d) = stiffness d + gravity sin(d) + cubic d^3``, and ``quadratic = rho C_d A / 2`` for a body of
known frontal area (boxfish paper, Eqs 7, 8). For a rotation, moments of inertia replace masses, and moments
replace forces; ``gravity`` is m g l of a pendulum. In water that moves with the velocity w, the velocities on
the right are relative to the water. The left side is then ``M (v' - w')``, because accelerating water moves
the body as it moves a neutrally buoyant body.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import PositiveFloat

from swimid.errors import InputError
from swimid.files.kernels import numba
from swimid.fitting.model import (
    MOST_FORCES,
    Array,
    Channel,
    Hooks,
    Model,
    Parameter,
    RigCoordinate,
    Scales,
    Trial,
    no_force,
)
from swimid.logs.experiments import TrialEntry
from swimid.logs.sampling import step_of
from swimid.robots.file import Robot

#: Coordinates in which a body can move on a rig. Each has its unit, the unit of its rate, and whether the
#: coordinate is an angle.
COORDINATES: dict[str, tuple[str, str, bool]] = {
    "x_m": ("m", "m/s", False),
    "z_m": ("m", "m/s", False),
    "roll_rad": ("rad", "rad/s", True),
    "pitch_rad": ("rad", "rad/s", True),
    "yaw_rad": ("rad", "rad/s", True),
}
#: Groups of rig parameters with a similar effect on the motion. In a fit, one parameter of a group can
#: replace the other parameters of the group.
SIMILAR_PARAMETERS = (
    (
        *("drag_coefficient", "quadratic_drag", "quadratic_damping"),
        *("linear_drag", "linear_damping", "dry_friction"),
    ),
    ("stiffness", "gravity_stiffness"),
)
#: Initial maximum integration step of a rig simulation, s. If the simulation is not accurate enough, the fit
#: halves the step.
DEFAULT_STEP = 0.01
#: Maximum number of steps of :data:`DEFAULT_STEP` in a trial. Longer trials have longer steps.
MAX_STEPS = 5_000
#: Names of the coefficients of the equation of motion, in the order of the argument ``c`` of
#: :func:`integrate_rig`.
EQUATION = ("inertia", "quadratic", "linear", "dry", "stiffness", "rest", "gravity", "cubic")


class RigScales(Scales):
    """Typical sizes of speed, force, stiffness and inertia in rig trials, for the scaling of parameters."""

    model: RigModel

    def __init__(self, model: RigModel, trials: Sequence[Trial]) -> None:
        super().__init__(model, trials)
        self.places = (model.coordinate,)

    @property
    def speed(self) -> float:
        """Typical speed of the body on the rig, m/s or rad/s.

        In a free decay the typical speed is the range of motion times the natural angular frequency.
        """
        if not self.model.rig.swings:
            return super().speed
        rate = math.sqrt(max(self.stiffness, 1e-12) / self.inertia)
        return self.span * rate or 0.1

    @property
    def stiffness(self) -> float:
        """Sum of the start values of linear stiffness and gravity stiffness, N/m or N m/rad."""
        return self.model.start("stiffness") + self.model.start("gravity_stiffness")

    @property
    def inertia(self) -> float:
        """Typical inertia of body and added water, kg or kg m2; 1 if no trial has a known inertia."""
        known = [t.rig.inertia for t in self.trials if not math.isnan(t.rig.inertia)]
        if not known:
            return 1.0
        return float(np.median(known)) + self.model.start("added_mass", "added_inertia")

    @property
    def force(self) -> float:
        """Typical applied force of the trials, N or N m.

        In a free decay this is the restoring force at a displacement equal to the range of motion.
        """
        if self.model.rig.swings:
            return max(self.stiffness, 1e-12) * self.span
        known = [float(np.sqrt(np.mean(np.square(t.inputs.get("force_N", t.rig.pull))))) for t in self.trials]
        return float(np.median(known or [0.1])) or 0.1

    @property
    def brake(self) -> float:
        """Typical force of friction or damping, N or N m: a tenth of the typical applied force.

        In a free decay the size is a hundredth of the typical force, because losses add up over many swings.
        """
        if self.model.rig.swings:
            return 0.01 * self.force
        return super().brake

    @property
    def quadratic(self) -> float:
        """Smallest quadratic drag of all trials, in N s2/m2 or N m s2/rad2, at the parameter start values."""
        start = np.array([p.start for p in self.model.parameters])
        return min((self.model.equation(start, t)["quadratic"] for t in self.trials), default=0.0)


class RigModel(Model):
    """Model of one robot on a test rig.

    Create the model with :func:`falling_weight`, :func:`make_towed_model` or :func:`free_decay`.
    :attr:`Trial.rig` has the known quantities of a trial. The input ``force_N`` of a trial is a measured
    force.
    """

    offers = frozenset({"coefficients", "force", "flow", "output", "clock"})

    def __init__(self, name: str, parameters: tuple[Parameter, ...], coordinate: str) -> None:
        unit, speed_unit, rotation = COORDINATES[coordinate]
        self.name = name
        self.parameters = parameters
        self.coordinate = coordinate
        self.speed, self.force_unit = "u_m_s", "N"
        if rotation:
            self.speed, self.force_unit = coordinate.replace("_rad", "_rate_rad_s"), "N m"
        self.channels = (Channel(coordinate, unit, "displacement"), Channel(self.speed, speed_unit, "speed"))
        self.max_step = DEFAULT_STEP
        self._at = {p.name: i for i, p in enumerate(parameters)}

    @property
    def rig(self) -> RigCoordinate:
        """Displacement channel and speed channel of the rig, with flags for a rotation and a free decay."""
        displacement, speed = self.channels
        return RigCoordinate(displacement, speed, COORDINATES[self.coordinate][2], self.name == "free-decay")

    @property
    def axes(self) -> tuple[str, ...]:
        """Name of the axis along which the body moves, such as ``x``; empty if the body rotates."""
        if self.rig.rotation:
            return ()
        return (self.coordinate.removesuffix("_m"),)

    def scales(self, trials: Sequence[Trial]) -> RigScales:
        """Return the typical sizes of speed, force, stiffness and inertia in trials of this rig."""
        return RigScales(self, trials)

    def onset(self, trial: Trial) -> float:
        """Return the time at which the body of a trial is released, s."""
        return trial.rig.begin_s

    def origin(self, trial: Trial) -> dict[str, float]:
        """Return the initial displacement of a trial, m or rad. The key is the name of the channel."""
        return {self.coordinate: trial.rig.x0}

    def _value(self, values: Array, *names: str) -> float:
        for name in names:
            if name in self._at:
                return float(values[self._at[name]])
        return 0.0

    def equation(self, values: Array, trial: Trial) -> dict[str, float]:
        """Return the coefficients of the equation of motion of one trial for given parameter values.

        The key is the name of the coefficient. Further keys are the constant force ``force`` (N) and its
        rate ``drift`` (N/s), and the initial displacement ``x0`` and speed ``v0`` of the trial.
        """
        known, friction = trial.rig, 0.0
        if known.pulley:
            friction = self._value(values, "pulley_friction") + self._value(values, "friction_deviation")
        drag = self._value(values, "drag_coefficient") * known.area_factor
        drag += self._value(values, "quadratic_drag", "quadratic_damping")
        return {
            "inertia": known.inertia + self._value(values, "added_mass", "added_inertia"),
            "quadratic": drag * (1.0 + self._value(values, "relative_drag_deviation")),
            "linear": self._value(values, "linear_drag", "linear_damping"),
            "dry": friction + self._value(values, "dry_friction"),
            "stiffness": self._value(values, "stiffness"),
            "rest": self._value(values, "rest_position"),
            "gravity": self._value(values, "gravity_stiffness"),
            "cubic": self._value(values, "cubic_stiffness"),
            "force": self._value(values, "force_offset") + known.pull,
            "drift": self._value(values, "force_drift"),
            "x0": known.x0 + self._value(values, "start_offset"),
            "v0": self._value(values, "initial_speed"),
        }

    def _simulate_motion(
        self, c: dict[str, float], trial: Trial, release: float, hooks: Hooks
    ) -> dict[str, Array]:
        """Simulate a trial and return its displacement and speed.

        ``c`` has the coefficients of the equation of motion, the constant force, its drift and the initial
        state.
        """
        if c["inertia"] <= 0 or not np.isfinite(list(c.values())).all():
            return self.make_broken(trial)
        time, measured, known = trial.time_s, trial.inputs.get("force_N"), c["force"]
        forced = bool(hooks.force or hooks.flow)
        simple = c["linear"] == c["stiffness"] == c["gravity"] == c["cubic"] == c["v0"] == 0
        closed = simple and known >= 0 and c["quadratic"] >= 0
        if measured is None and closed and not forced:
            x, v = falling_weight_closed_form(time, release, c["inertia"], c["quadratic"], known - c["dry"])
            return {self.coordinate: x + c["x0"], self.speed: v}
        force = np.array([known])
        if measured is not None:
            force = measured + known + c["drift"] * (time - trial.rig.begin_s)
        # Choose a step that does not depend on the parameters, so that the simulation is a smooth function of
        # the parameters.
        step = self.max_step * max(1.0, float(time[-1] - time[0]) / MAX_STEPS / DEFAULT_STEP)
        water = extra = None
        if forced:
            ends = step_ends(time, release, step)
            water = np.zeros(len(ends))
            for flow in hooks.flow:
                water = water + flow(ends)[1][:, 0]
            acting = [(f.constants, f.function) for f in hooks.force]
            idle = [(np.zeros(1), no_force)] * (MOST_FORCES - len(acting))
            extra = (np.zeros((3, 3)), len(acting), *acting, *idle)
        equation = tuple(c[name] for name in EQUATION)
        x, v = integrate_rig(time, release, step, force, c["x0"], c["v0"], equation, water, extra)
        return {self.coordinate: x, self.speed: v}

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Return displacement and speed of a trial, simulated with effects (see
        :meth:`Model.simulate_hooked`).

        ``coefficients`` hooks change the values of :meth:`equation`. Forces of effects are added afterwards.

        Raises
        ------
        ValueError
            If there are more than :data:`swimid.fitting.model.MOST_FORCES` forces.
        """
        late = trial
        if hooks.late:
            time = hooks.compute_event_times(trial.time_s)
            inputs = {name: np.interp(time, trial.time_s, data) for name, data in trial.inputs.items()}
            late = replace(trial, time_s=time, inputs=inputs)
        if not np.isfinite(values).all():
            return self.make_broken(trial)
        if len(hooks.force) > MOST_FORCES:
            raise ValueError(f"{len(hooks.force)} forces act at once; at most {MOST_FORCES} are possible")
        release = trial.rig.begin_s + self._value(values, "clock_offset")
        equation = hooks.change_values(self.equation(values, trial), "coefficients")
        moved = self._simulate_motion(equation, late, release, hooks)
        return hooks.sense(moved, trial.time_s)

    def refine(self) -> RigModel:
        """Return a copy of the model with half the integration step."""
        other = copy.copy(self)
        other.max_step = 0.5 * self.max_step
        return other

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Return the time derivatives of simulated displacement and speed at the samples of a trial.

        These derivatives are the simulated speed and the numerical derivative of the speed.
        """
        simulated = self.run(values, trial)
        rate = np.zeros(1)
        if len(trial.time_s) > 1:
            rate = np.gradient(simulated[self.speed], trial.time_s)
        return {self.coordinate: simulated[self.speed], self.speed: rate}


def compute_terminal_speed(c: Mapping[str, float], force: float) -> float:
    """Return the terminal speed of a body under a constant force, m/s.

    At this speed drag and friction balance the force. Return NaN if the force does not exceed the friction,
    or if there is no drag.
    """
    push = force - c["dry"]
    brake = c["linear"] + math.sqrt(c["linear"] ** 2 + 4 * max(c["quadratic"], 0.0) * max(push, 0.0))
    return 2 * push / brake if push > 0 and brake > 0 else math.nan


def _parameter(
    name: str, unit: str, start: float, scale: float, meaning: str, *, lower: float = 0.0, **more: Any
) -> Parameter:
    """Return a parameter of a rig model without an upper bound. Its lower bound is 0 by default."""
    return Parameter(name, unit, lower, math.inf, start, scale, meaning=meaning, **more)


def _free_parameter(name: str, unit: str, scale: float, meaning: str, **more: Any) -> Parameter:
    """Return a parameter of a rig model without bounds and with the start value zero."""
    return _parameter(name, unit, 0.0, scale, meaning, lower=-math.inf, **more)


def _drag(area_known: bool, source: str = "") -> Parameter:
    """Return the parameter of quadratic drag.

    This is the drag coefficient if the frontal area is known, and else the quadratic drag in N s2/m2.
    """
    if area_known:
        return Parameter(
            "drag_coefficient", "1", 0.0, 5.0, 1.0, 0.5, meaning="drag coefficient C_d", source=source
        )
    return _parameter("quadratic_drag", "N s^2/m^2", 1.0, 1.0, "quadratic drag", source=source)


def _start(coordinate: str, *, length: float, speed: float, free: bool) -> tuple[Parameter, ...]:
    """Return the per-trial parameters of a release: initial displacement, initial speed and clock offset."""
    unit, speed_unit, _ = COORDINATES[coordinate]
    own: dict[str, Any] = {"per_trial": True}
    return (
        _free_parameter("start_offset", unit, length, "displacement at release", free=free, **own),
        _free_parameter("initial_speed", speed_unit, speed, "speed at release", free=free, **own),
        _free_parameter("clock_offset", "s", 0.1, "release against the log's clock", free=False, **own),
    )


def _drag_deviation() -> Parameter:
    meaning = "drag of a trial against the common one, as a fraction"
    return _free_parameter("relative_drag_deviation", "1", 0.05, meaning, free=False, per_trial=True)


def falling_weight(
    *, mass_kg: float, force_N: float, area_known: bool, pulley: bool, speed_m_s: float = 0.3
) -> RigModel:
    """Return the model of a body that a falling weight pulls (boxfish paper, Eqs 7, 8).

    The start values and scales of its parameters follow from typical inertia, force and speed.

    Parameters
    ----------
    area_known : bool
        Whether the frontal area is known, so that the drag coefficient is estimated. If it is unknown, the
        quadratic drag is estimated.
    pulley : bool
        Whether the friction of the pulley is estimated. If false, this friction is zero.
    """
    half, friction = 0.5 * mass_kg, 0.1 * force_N * pulley
    common = "pulley friction of a trial against the common one"
    parameters = (
        _drag(area_known, "Eq 7"),
        _parameter("added_mass", "kg", half, half, "added mass m_a", source="Eq 8"),
        _parameter(
            "pulley_friction", "N", friction, 0.2 * force_N, "pulley friction f_c", free=pulley, source="Eq 7"
        ),
        _parameter("linear_drag", "N s/m", 0.0, 0.1 * force_N / speed_m_s, "linear drag", free=False),
        _free_parameter("friction_deviation", "N", 0.05 * force_N, common, free=False, per_trial=True),
        _drag_deviation(),
        *_start("x_m", length=0.01, speed=0.05, free=False),
    )
    return RigModel("falling-weight", parameters, "x_m")


def make_towed_model(*, mass_kg: float, force_N: float, area_known: bool, speed_m_s: float = 0.3) -> RigModel:
    """Return the model of a body towed by a measured force, with added mass and drag as free parameters."""
    half = 0.5 * max(mass_kg, 0.1)
    parameters = (
        _drag(area_known),
        _parameter("added_mass", "kg", half, half, "added mass"),
        _parameter("linear_drag", "N s/m", 0.0, 0.1 * force_N / speed_m_s, "linear drag", free=False),
        _parameter("dry_friction", "N", 0.0, 0.2 * force_N, "dry friction", free=False, kinked=True),
        _free_parameter("force_offset", "N", 0.1 * force_N, "force added to the measured one", free=False),
        _free_parameter("force_drift", "N/s", 0.01 * force_N, "rate of the force added to it", free=False),
        _drag_deviation(),
        *_start("x_m", length=0.01, speed=0.05, free=True),
    )
    return RigModel("towed", parameters, "x_m")


def free_decay(
    coordinate: str,
    *,
    inertia: float,
    stiffness: float | None,
    guess: float,
    amplitude: float,
    gravity: float = 0.0,
) -> RigModel:
    """Return the model of a free decay of a body in one coordinate, such as roll.

    Parameters
    ----------
    coordinate : str
        Name of the coordinate, one of :data:`COORDINATES`.
    inertia : float
        Known inertia, kg or kg m2.
    stiffness : float or None
        Known stiffness, N/m or N m/rad; the added inertia is then estimated. If the stiffness is None, it is
        estimated and the added inertia is held, because a decay determines only their ratio.
    guess : float
        Stiffness that follows from the period of the decay.
    amplitude : float
        Amplitude of the first swing, for the typical scales of the parameters.
    gravity : float
        Known gravity stiffness m g l in roll and pitch, N m/rad.
    """
    unit, _, rotation = COORDINATES[coordinate]
    force, mass, kind, loss = "N", "kg", "mass", "drag"
    if rotation:
        force, mass, kind, loss = "N m", "kg m^2", "inertia", "damping"
    rate = math.sqrt(guess / inertia)
    known, spring, whole = stiffness is not None, stiffness, inertia
    if spring is None:
        spring = guess - gravity
    else:
        # total inertia with which the known stiffness gives the measured period of the decay
        whole = max((spring + gravity) / rate**2, inertia)
    damping, speed = 0.01 * whole * rate, amplitude * rate
    quadratic = damping / speed
    restoring = f"{force}/{unit}"
    cubic = guess / (6.0 * amplitude**2)
    meaning = "m g l of a restoring moment m g l sin(angle)"
    pendulum = _parameter("gravity_stiffness", restoring, gravity, guess, meaning, free=False)
    parameters = (
        _parameter(f"added_{kind}", mass, whole - inertia, 0.3 * whole, f"added {kind}", free=known),
        _parameter(f"quadratic_{loss}", f"{force} s^2/{unit}^2", quadratic, quadratic, "quadratic damping"),
        _parameter(f"linear_{loss}", f"{force} s/{unit}", damping, damping, "linear damping"),
        _parameter("stiffness", restoring, spring, guess, "stiffness of a linear spring", free=not known),
        _free_parameter("cubic_stiffness", f"{restoring}^3", cubic, "cubic restoring stiffness", free=False),
        *[pendulum] * (coordinate in ("roll_rad", "pitch_rad")),
        _parameter(
            "dry_friction", force, 0.0, 0.01 * guess * amplitude, "dry friction", free=False, kinked=True
        ),
        _free_parameter("rest_position", unit, 0.05 * amplitude, "rest position", per_trial=True),
        *_start(coordinate, length=amplitude, speed=speed, free=True),
    )
    return RigModel("free-decay", parameters, coordinate)


# ---------------------------------------------------------------- integration


#: Maximum number of times that a body with dry friction stops or starts to move within one integration step.
MAX_EVENTS = 8


@numba.njit(cache=True, nogil=True)
def breakaway(push, slope, dry, left):  # type: ignore[no-untyped-def]
    """Return the time until a body at rest overcomes dry friction, s, and the sign of its motion.

    The sign is 0 if the body stays at rest.

    Parameters
    ----------
    push, slope : float
        Net force without friction, N, and its rate, N/s.
    dry : float
        Maximum force of dry friction, N.
    left : float, s
        Duration of the search for a start. If the body stays at rest, this duration is returned as the time.

    >>> breakaway(0.5, 2.0, 1.0, 1.0)
    (0.25, 1.0)
    """
    if abs(push) > dry:
        return 0.0, math.copysign(1.0, push)
    if slope == 0.0:
        return left, 0.0
    side = math.copysign(1.0, slope)
    after = (side * dry - push) / slope
    return (after, side) if after < left else (left, 0.0)


@numba.njit(cache=True, nogil=True)
def restoring(x, c):  # type: ignore[no-untyped-def]
    """Return the restoring force or moment that opposes a displacement from the rest position, N or N m.

    The result has the sign of the displacement, and is subtracted from the applied force. ``c`` has the
    coefficients of the equation of motion in the order of :data:`EQUATION`.
    """
    _, _, _, _, stiffness, rest, gravity, cubic = c
    away = x - rest
    pull = stiffness * away
    if gravity != 0.0:
        pull += gravity * math.sin(away)
    if cubic != 0.0:
        pull += cubic * away * away * away
    return pull


# The argument ``extra`` of the following functions is None if the water is still and no added effect exerts a
# force. Numba then compiles the functions without the code for moving water and such forces.


@numba.njit(cache=True, nogil=True)
def _acceleration(t, x, v, side, force, w, dw, c, extra):  # type: ignore[no-untyped-def]
    inertia, quadratic, linear, dry, _, _, _, _ = c
    if extra is None:
        push = force - linear * v - quadratic * v * abs(v) - restoring(x, c)
        return (push - dry * side) / inertia
    through = v - w
    scratch, acting, (c1, f1), (c2, f2), (c3, f3), (c4, f4) = extra
    pose, velocity, wrench = scratch[0], scratch[1], scratch[2]
    pose[0], velocity[0], velocity[2], wrench[0] = x, through, v, 0.0
    if acting > 0:
        f1(t, pose, velocity, c1, wrench)
    if acting > 1:
        f2(t, pose, velocity, c2, wrench)
    if acting > 2:
        f3(t, pose, velocity, c3, wrench)
    if acting > 3:
        f4(t, pose, velocity, c4, wrench)
    push = force + wrench[0] - linear * through - quadratic * through * abs(through) - restoring(x, c)
    return (push - dry * side) / inertia + dw


@numba.njit(cache=True, nogil=True)
def _rk4(t, x, v, side, h, f0, f1, w0, dw, c, extra):  # type: ignore[no-untyped-def]
    fm, wm, w1 = 0.5 * (f0 + f1), w0 + 0.5 * h * dw, w0 + h * dw
    mid = t + 0.5 * h
    a1 = _acceleration(t, x, v, side, f0, w0, dw, c, extra)
    v2 = v + 0.5 * h * a1
    a2 = _acceleration(mid, x + 0.5 * h * v, v2, side, fm, wm, dw, c, extra)
    v3 = v + 0.5 * h * a2
    a3 = _acceleration(mid, x + 0.5 * h * v2, v3, side, fm, wm, dw, c, extra)
    v4 = v + h * a3
    a4 = _acceleration(t + h, x + h * v3, v4, side, f1, w1, dw, c, extra)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@numba.njit(cache=True, nogil=True)
def _with_friction(t, x, v, h, f0, f1, w0, dw, c, extra):  # type: ignore[no-untyped-def]
    """Integrate the motion of a body with dry friction over one step.

    The step is divided at the times at which the body stops or starts to move.
    """
    inertia, dry = c[0], c[3]
    slope = (f1 - f0) / h
    done = 0.0
    for _ in range(MAX_EVENTS):
        f, w = f0 + slope * done, w0 + dw * done
        if v == 0.0:
            left = h - done
            if extra is None:
                after, side = breakaway(f - restoring(x, c), slope, dry, left)
            else:
                # Approximate the sum of all forces as linear in time over the rest of the step.
                push = inertia * _acceleration(t + done, x, v, 0.0, f, w, dw, c, extra)
                end = inertia * _acceleration(t + h, x, v, 0.0, f1, w0 + dw * h, dw, c, extra)
                after, side = breakaway(push, (end - push) / left, dry, left)
            if side == 0.0:
                return x, v
            done += after
            f, w = f0 + slope * done, w0 + dw * done
        else:
            side = math.copysign(1.0, v)
        left = h - done
        x1, v1 = _rk4(t + done, x, v, side, left, f, f1, w, dw, c, extra)
        if v1 * side >= 0.0:
            return x1, v1
        low, high = 0.0, left
        cut = left * v / (v - v1) if v != 0.0 else 0.5 * left
        for _ in range(40):
            x1, v1 = _rk4(t + done, x, v, side, cut, f, f + slope * cut, w, dw, c, extra)
            if v1 * side > 0:
                low = cut
            else:
                high = cut
            if high - low < 1e-14:
                break
            cut = 0.5 * (low + high)
        x, v = x1, 0.0
        done += cut
        if h - done <= 1e-14:
            break
    return x, v


@numba.njit(cache=True, nogil=True)
def integrate_rig(  # type: ignore[no-untyped-def]
    time, start, max_step, force, x0, v0, c, water=None, extra=None
):
    """Integrate the equation of motion of a rig with the fourth-order Runge-Kutta method and fixed steps.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing sample times. Samples before ``start`` have the initial state.
    start : float, s
        Time of release.
    max_step : float, s
        Maximum step. Each interval between samples is divided into equal steps. The steps do not depend on
        the parameters, so that finite differences are smooth.
    force : ndarray, shape (n,) or (1,)
        Applied force at the samples, between which it is interpolated linearly, or one constant value.
    x0, v0 : float
        Initial position and speed.
    c : tuple of float
        Coefficients of the equation of motion, in the order of :data:`EQUATION`.

    water : ndarray, shape (steps + 1,), m/s, or None
        Velocity of the water at :func:`step_ends`, between which it is interpolated linearly.
    extra : tuple or None
        Working memory of shape (3, 3), number of forces that act on the body, and :data:`MOST_FORCES` pairs
        of constants and compiled function of a force (:class:`swimid.fitting.model.ExternalForce`). None in
        still water without further forces.

    Returns
    -------
    x, v : ndarray, shape (n,)
        Displacements and speeds at the sample times.

    Notes
    -----
    The sign of dry friction is constant within a step. A step in which the speed changes sign is divided at
    the reversal. At the reversal the body sticks as long as the net force is below the friction. The times of
    reversal and of breakaway are exact. If they were rounded to the steps, the motion would be a
    discontinuous function of the friction.
    """
    n = len(time)
    positions, speeds = np.empty(n), np.empty(n)
    x, v, now = x0, v0, start
    constant = len(force) == 1
    at = 0
    for i in range(n):
        if time[i] > now:
            before = force[0] if constant or i == 0 else force[i - 1]
            after = force[0] if constant else force[i]
            width = time[i] - now
            steps = max(1, math.ceil(width / max_step - 1e-9))
            h = width / steps
            for j in range(steps):
                t = now + j * h
                f0 = before + (after - before) * (j / steps)
                f1 = before + (after - before) * ((j + 1) / steps)
                w0, dw = 0.0, 0.0
                if extra is not None:
                    w0, dw = water[at], (water[at + 1] - water[at]) / h
                    at += 1
                if c[3] == 0.0:
                    x, v = _rk4(t, x, v, 0.0, h, f0, f1, w0, dw, c, extra)
                else:
                    x, v = _with_friction(t, x, v, h, f0, f1, w0, dw, c, extra)
            now = time[i]
        positions[i], speeds[i] = x, v
    return positions, speeds


@numba.njit(cache=True, nogil=True)
def step_ends(time, start, max_step):  # type: ignore[no-untyped-def]
    """Return the times at which the integration steps of :func:`integrate_rig` begin and end, s.

    >>> step_ends(np.array([-1.0, 0.1, 0.15]), 0.0, 0.05)
    array([0.  , 0.05, 0.1 , 0.15])
    """
    ends, now = [start], start
    for t in time:
        if t > now:
            steps = max(1, math.ceil((t - now) / max_step - 1e-9))
            h = (t - now) / steps
            for j in range(1, steps):
                ends.append(now + j * h)
            ends.append(t)
            now = t
    return np.array(ends)


@numba.njit(cache=True, nogil=True)
def falling_weight_closed_form(time, start, inertia, quadratic, force):  # type: ignore[no-untyped-def]
    """Return displacement (m) and speed (m/s) of a body with quadratic drag under a constant force.

    The body starts at rest.

    Parameters
    ----------
    time : ndarray, shape (n,), s
    start : float, s
        Time of release.
    inertia : float, kg
        Inertia M of Eq 8.
    quadratic : float, N s2/m2
        Coefficient ``rho C_d A / 2``; zero is allowed.
    force : float, N
        Net force ``m_w g - f_c``. The body stays at rest unless it is positive.

    Notes
    -----
    The formulas are Eqs 9 and 10 of the boxfish paper. The argument in its Eq 14 is a misprint: ``sqrt(a1 a2)
    t`` is correct, and ``sqrt(a1 a2 t)`` is wrong.

    >>> x, v = falling_weight_closed_form(np.array([100.0]), 0.0, 2.0, 4.0, 1.0)
    >>> float(v[0])
    0.5
    """
    x = np.zeros(len(time))
    v = np.zeros(len(time))
    if force <= 0.0:
        return x, v
    a1 = quadratic / inertia
    a2 = force / inertia
    rate = math.sqrt(a1 * a2)
    for i in range(len(time)):
        t = max(time[i] - start, 0.0)
        phi = rate * t
        if phi < 1e-4:
            # Use the Taylor series of ln cosh and tanh, which avoid a division by zero drag.
            x[i] = 0.5 * a2 * t * t * (1.0 - phi * phi / 6.0)
            v[i] = a2 * t * (1.0 - phi * phi / 3.0)
        else:
            # Compute ln cosh and tanh from the same exponential, so that ln cosh does not overflow.
            decay = math.exp(-2.0 * phi)
            x[i] = (phi + math.log1p(decay) - math.log(2.0)) / a1
            v[i] = math.sqrt(a2 / a1) * (1.0 - decay) / (1.0 + decay)
    return x, v


def warm_up() -> None:
    """Compile the numba functions of this module before their first use."""
    time = np.array([0.0, 0.1])
    integrate_rig(time, 0.0, 0.1, np.array([1.0]), 0.0, 0.0, (1.0, 1.0, 1.0, 0.1, 1.0, 0.0, 0.0, 0.0))
    falling_weight_closed_form(time, 0.0, 1.0, 1.0, 1.0)


# ---------------------------------------------------------------- trials


MASS_KEY = "inertial_mass_kg"


class RigTrial(TrialEntry):
    """Keys of a trial on a single-degree-of-freedom rig. Their values replace those of the robot file."""

    inertial_mass_kg: PositiveFloat | None = None
    frontal_area_m2: PositiveFloat | None = None
    fluid_density_kg_m3: PositiveFloat | None = None


def mass_of(entry: RigTrial, robot: Robot, path: Path) -> float:
    """Return the inertial mass that a trial states, or else the mass of the robot, kg.

    Raises
    ------
    InputError
        If neither the trial nor the robot file states a mass.
    """
    mass = entry.inertial_mass_kg
    if mass is None:
        mass = robot.body.inertial_mass_kg
    if mass is None:
        raise InputError(
            f"the trial '{entry.id}' has no inertial mass",
            file=path,
            column=MASS_KEY,
            hint=f"give it in the trial, or as body.inertial_mass_kg of the robot '{robot.name}'",
        )
    return mass


def area_factors(entries: Sequence[RigTrial], robot: Robot, path: Path) -> list[float]:
    """Return the factor ``rho A / 2`` of the drag law for each trial, kg/m; zeros without a frontal area.

    ``rho`` is the density of the fluid, and ``A`` the frontal area of the body.

    Raises
    ------
    InputError
        If only some of the trials have a frontal area, or if one states a density without an area.
    """
    factors: list[float] = []
    for entry in entries:
        area = entry.frontal_area_m2 or robot.body.frontal_area_m2 or 0.0
        factors.append(0.5 * (entry.fluid_density_kg_m3 or robot.fluid.density_kg_m3) * area)
        if not area and entry.fluid_density_kg_m3 is not None:
            raise InputError(
                f"the density of the fluid in '{entry.id}' has no effect without a frontal area",
                file=path,
                column="fluid_density_kg_m3",
                hint="give frontal_area_m2 in the trial or in the robot file",
            )
    if any(factors) and not all(factors):
        missing = entries[factors.index(0.0)].id
        text = f"the trial '{missing}' has no frontal area, but other trials have one"
        hint = "give frontal_area_m2 in every trial, or in the robot file"
        raise InputError(text, file=path, column="frontal_area_m2", hint=hint)
    return factors


# ------------------------------------------------------------ encoder


@dataclass(frozen=True)
class Displacement:
    """Displacement record of a trial on a rig, with its known measurement errors.

    Attributes
    ----------
    kind : str
        ``continuous``: there is no encoder. ``clicks``: there is one row for each step of the encoder, so
        that the displacement is exact and the time has an error. ``sampled``: the rows are the count of the
        encoder at regular times.
    time_s, position : ndarray, shape (n,)
        Samples of the record. If ``rounded`` is 0 or 1, these are the times at which a sampled count changed.
    time_sd_s : float or ndarray, shape (n,)
        Standard deviation of the times, due to the sampling interval.
    position_sd : float
        Standard deviation of the positions, due to the step of the encoder.
    shifts : dict of str to float
        True position minus ``position`` for each possible rounding of the count (:data:`ROUNDINGS`); empty
        unless ``kind`` is ``sampled``.
    """

    kind: Literal["continuous", "clicks", "sampled"]
    time_s: Array
    position: Array
    time_sd_s: float | Array = 0.0
    position_sd: float = 0.0
    shifts: Mapping[str, float] = field(default_factory=dict)


#: Possible roundings of an encoder count. Each has the difference of true position and count, in encoder
#: steps, in three cases: when the count rises, when it falls, and on average while it is constant.
ROUNDINGS = {"floor": (0.0, 1.0, 0.5), "nearest": (-0.5, 0.5, 0.0), "ceil": (-1.0, 0.0, -0.5)}


def read_encoder(time_s: Array, position: Array, resolution: float | None = None) -> Displacement:
    """Detect an encoder in a displacement record, and return the record with its measurement errors.

    Parameters
    ----------
    resolution : float, optional
        Known step of the encoder, which is needed for records that move several steps per sample.
    """
    plain = Displacement("continuous", time_s, position)
    step = step_of(position)
    if step is None:
        return plain
    counts = np.round((position - position[0]) / step).astype(int)
    moves = np.diff(counts)
    forward = moves[moves != 0]
    if len(forward) < 3 or np.mean(np.sign(forward) == np.sign(np.median(forward))) < 0.98:
        # Rounded noisy values rise and fall, but the count of an encoder moves in one direction.
        return plain
    if np.mean(np.abs(moves) == 1) > 0.9 and np.std(np.diff(time_s)) >= 0.02 * np.mean(np.diff(time_s)):
        return Displacement("clicks", time_s, position)
    if np.median(np.abs(moves)) <= 1 and np.mean(moves == 0) > 0.05:
        at = np.flatnonzero(moves) + 1
        gap = time_s[at] - time_s[at - 1]
        # If the count changed by m steps within an interval, assign the middle one of these m steps to the
        # middle of the interval.
        middle = position[at] - 0.5 * (moves[at - 1] - np.sign(moves[at - 1])) * step
        times = time_s[at] - 0.5 * gap
        # The time of the change is uniformly distributed between two samples. Its standard deviation is the
        # sampling interval divided by sqrt(12).
        falls = int(middle[-1] < middle[0])
        shifts = {name: step * shares[falls] for name, shares in ROUNDINGS.items()}
        return Displacement("sampled", times, middle, time_sd_s=gap / np.sqrt(12.0), shifts=shifts)
    if np.median(np.abs(moves)) <= 3 or (resolution is not None and abs(step / resolution - 1) < 0.02):
        shifts = {name: step * shares[2] for name, shares in ROUNDINGS.items()}
        return Displacement("sampled", time_s, position, position_sd=step / np.sqrt(12.0), shifts=shifts)
    return plain


def true_position(record: Displacement, rounding: str) -> Array:
    """Return the true positions of an encoder record under an assumed rounding of its counts.

    The rounding is a key of :data:`ROUNDINGS`. A record that was not counted is returned unchanged.
    """
    return record.position + record.shifts.get(rounding, 0.0)
