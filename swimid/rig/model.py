"""The single-degree-of-freedom rig: falling weight, towing and free decay.

One equation serves all three::

    (m + m_added + m_pull + m_pulley) x'' = F - dry sgn(x') - linear x'
                                            - quadratic x' |x'| - stiffness (x - x_rest)

with ``quadratic = rho C_d A / 2`` for a body of known frontal area (boxfish paper, Eqs 7, 8).
For a rotation, moments of inertia take the place of masses and moments that of forces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np

from swimid.fitting.hooks import MOST_FORCES, Hooks, no_force
from swimid.fitting.inputs import RigInput
from swimid.fitting.model import Array, Channel, Model, Parameter, Rig, Trial
from swimid.fitting.scales import Scales
from swimid.rig.dry_friction import MOST_EVENTS, breakaway
from swimid.rig.forced import integrate_forced, step_ends

#: Coordinates a rig may log, with unit, unit of speed and whether it is a rotation.
COORDINATES: dict[str, tuple[str, str, bool]] = {
    "x_m": ("m", "m/s", False),
    "z_m": ("m", "m/s", False),
    "roll_rad": ("rad", "rad/s", True),
    "pitch_rad": ("rad", "rad/s", True),
    "yaw_rad": ("rad", "rad/s", True),
}
#: Largest integration step, s, before the accuracy check refines it.
DEFAULT_STEP = 0.01
#: A trial so long that it would take more such steps starts with longer ones.
MOST_STEPS = 5_000
#: Coefficients of the equation of motion, in the order :func:`integrate` takes them.
EQUATION = ("inertia", "quadratic", "linear", "dry", "stiffness", "rest")


@numba.njit(cache=True, nogil=True)
def _acceleration(x, v, side, force, inertia, quadratic, linear, dry, stiffness, rest):  # type: ignore[no-untyped-def]
    push = force - linear * v - quadratic * v * abs(v) - stiffness * (x - rest)
    return (push - dry * side) / inertia


@numba.njit(cache=True, nogil=True)
def _rk4(x, v, side, h, f0, f1, inertia, quadratic, linear, dry, stiffness, rest):  # type: ignore[no-untyped-def]
    fm = 0.5 * (f0 + f1)
    a1 = _acceleration(x, v, side, f0, inertia, quadratic, linear, dry, stiffness, rest)
    v2 = v + 0.5 * h * a1
    a2 = _acceleration(x + 0.5 * h * v, v2, side, fm, inertia, quadratic, linear, dry, stiffness, rest)
    v3 = v + 0.5 * h * a2
    a3 = _acceleration(x + 0.5 * h * v2, v3, side, fm, inertia, quadratic, linear, dry, stiffness, rest)
    v4 = v + h * a3
    a4 = _acceleration(x + h * v3, v4, side, f1, inertia, quadratic, linear, dry, stiffness, rest)
    return x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0, v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0


@numba.njit(cache=True, nogil=True)
def _with_friction(x, v, h, f0, f1, inertia, quadratic, linear, dry, stiffness, rest):  # type: ignore[no-untyped-def]
    """One step under dry friction, cut where the body stops and where it gets loose again."""
    slope = (f1 - f0) / h
    done = 0.0
    for _ in range(MOST_EVENTS):
        f = f0 + slope * done
        if v == 0.0:
            after, side = breakaway(f - stiffness * (x - rest), slope, dry, h - done)
            if side == 0.0:
                return x, v
            done += after
            f = f0 + slope * done
        else:
            side = 1.0 if v > 0 else -1.0
        left = h - done
        x1, v1 = _rk4(x, v, side, left, f, f1, inertia, quadratic, linear, dry, stiffness, rest)
        if v1 * side >= 0.0:
            return x1, v1
        low, high = 0.0, left
        cut = left * v / (v - v1) if v != 0.0 else 0.5 * left
        for _ in range(40):
            x1, v1 = _rk4(
                x, v, side, cut, f, f + slope * cut, inertia, quadratic, linear, dry, stiffness, rest
            )
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
def integrate(  # type: ignore[no-untyped-def]
    time, start, max_step, force, inertia, quadratic, linear, dry, stiffness, rest, x0, v0
):
    """Positions and speeds at given times, by fixed-step fourth-order Runge-Kutta.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing. Samples before ``start`` hold the initial state.
    start : float, s
        Time of release.
    max_step : float, s
        Each interval between samples is cut into equal steps no longer than this, so that
        the steps do not depend on the parameters and finite differences stay smooth.
    force : ndarray, shape (n,) or (1,)
        Applied force at the samples (linear in between), or one constant value.
    inertia, quadratic, linear, dry, stiffness, rest, x0, v0 : float
        Coefficients of the equation of motion; initial position and speed.

    Returns
    -------
    x, v : ndarray, shape (n,)

    Notes
    -----
    Dry friction holds its sign within a step; a step in which the speed would change sign is
    cut at the reversal, where the body sticks while the net force is below the friction, and where
    it gets loose again. Both instants move with the parameters: kept to the grid of steps, the
    motion would be a staircase of the friction, and its derivative wrong.
    """
    n = len(time)
    positions = np.empty(n)
    speeds = np.empty(n)
    x, v, now = x0, v0, start
    constant = len(force) == 1
    for i in range(n):
        if time[i] > now:
            f_start = force[0] if constant or i == 0 else force[i - 1]
            f_end = force[0] if constant else force[i]
            width = time[i] - now
            steps = max(1, math.ceil(width / max_step - 1e-9))
            h = width / steps
            for j in range(steps):
                f0 = f_start + (f_end - f_start) * (j / steps)
                f1 = f_start + (f_end - f_start) * ((j + 1) / steps)
                if dry == 0.0:
                    x, v = _rk4(x, v, 0.0, h, f0, f1, inertia, quadratic, linear, dry, stiffness, rest)
                    continue
                x, v = _with_friction(x, v, h, f0, f1, inertia, quadratic, linear, dry, stiffness, rest)
            now = time[i]
        positions[i] = x
        speeds[i] = v
    return positions, speeds


@numba.njit(cache=True, nogil=True)
def falling_weight_closed_form(time, start, inertia, quadratic, force):  # type: ignore[no-untyped-def]
    """Displacement and speed of a body pulled from rest by a constant force.

    Parameters
    ----------
    time : ndarray, shape (n,), s
    start : float, s
        Time of release.
    inertia : float, kg
        M of Eq 8.
    quadratic : float, N s2/m2
        ``rho C_d A / 2``; zero is allowed.
    force : float, N
        Net force ``m_w g - f_c``; the body stays where it is when it is not positive.

    Returns
    -------
    x, v : ndarray, shape (n,), m and m/s

    Notes
    -----
    Eqs 9 and 10 of the boxfish paper. (Its Eq 14 misprints the argument: it is
    ``sqrt(a1 a2) t``, not ``sqrt(a1 a2 t)``.)

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
            # series of ln cosh and tanh: no division by a vanishing drag
            x[i] = 0.5 * a2 * t * t * (1.0 - phi * phi / 6.0)
            v[i] = a2 * t * (1.0 - phi * phi / 3.0)
        else:
            # one exponential serves ln cosh, without overflow, and tanh
            decay = math.exp(-2.0 * phi)
            x[i] = (phi + math.log1p(decay) - math.log(2.0)) / a1
            v[i] = math.sqrt(a2 / a1) * (1.0 - decay) / (1.0 + decay)
    return x, v


class RigScales(Scales):
    """Typical sizes of a rig's trials."""

    model: RigModel

    def __init__(self, model: RigModel, trials: Sequence[Trial]) -> None:
        super().__init__(model, trials)
        self.places = (model.coordinate,)

    @property
    def speed(self) -> float:
        """Typical speed; of a decay, the extent of the motion times its natural frequency."""
        if not self.model.rig.swings:
            return super().speed
        rate = math.sqrt(max(self.model.start("stiffness"), 1e-12) / self.inertia)
        return self.span * rate or 0.1

    @property
    def inertia(self) -> float:
        """The known inertia and the added, kg or kg m2; 1 where nothing tells."""
        known = [t.rig.inertia for t in self.trials if not math.isnan(t.rig.inertia)]
        return float(np.median(known)) + self.model.start("added_mass", "added_inertia") if known else 1.0

    @property
    def force(self) -> float:
        """The pull, or the restoring force over the extent of the motion, N or N m."""
        if self.model.rig.swings:
            return max(self.model.start("stiffness"), 1e-12) * self.span
        known = [float(np.sqrt(np.mean(np.square(t.inputs.get("force_N", t.rig.pull))))) for t in self.trials]
        return float(np.median(known)) or 0.1 if known else 0.1

    @property
    def brake(self) -> float:
        """A tenth of the force; a hundredth in a free decay, where losses add up over many swings."""
        return (0.01 if self.model.rig.swings else 0.1) * self.force

    @property
    def quadratic(self) -> float:
        """The quadratic drag at the start values, the least of all trials."""
        start = np.array([p.start for p in self.model.parameters])
        return min((self.model.coefficients(start, t.rig)["quadratic"] for t in self.trials), default=0.0)


class RigModel(Model):
    """A rig experiment of one robot.

    Build it with :func:`falling_weight`, :func:`towed` or :func:`free_decay`.

    What is known of a trial is its :attr:`Trial.rig`; a measured force is its input ``force_N``.
    """

    offers = frozenset({"coefficients", "force", "flow", "output", "clock"})

    def __init__(
        self, name: str, parameters: tuple[Parameter, ...], coordinate: str, *, max_step: float = DEFAULT_STEP
    ) -> None:
        unit, speed_unit, rotation = COORDINATES[coordinate]
        self.name = name
        self.parameters = parameters
        self.coordinate = coordinate
        self.speed = "u_m_s" if not rotation else coordinate.replace("_rad", "_rate_rad_s")
        self.channels = (Channel(coordinate, unit, "displacement"), Channel(self.speed, speed_unit, "speed"))
        self.force_unit = "N m" if rotation else "N"
        self.max_step = max_step
        self._at = {p.name: i for i, p in enumerate(parameters)}

    @property
    def rig(self) -> Rig:
        """Its coordinate."""
        displacement, speed = self.channels
        return Rig(displacement, speed, COORDINATES[self.coordinate][2], self.name == "free-decay")

    @property
    def axes(self) -> tuple[str, ...]:
        """The axis along which it moves; none for a rotation."""
        return () if self.rig.rotation else (self.coordinate.removesuffix("_m"),)

    def scales(self, trials: Sequence[Trial]) -> RigScales:
        """Typical sizes of trials."""
        return RigScales(self, trials)

    def origin(self, trial: Trial) -> dict[str, float]:
        """Where a trial's displacement starts."""
        return {self.coordinate: trial.rig.x0}

    def _value(self, values: Array, *names: str) -> float:
        for name in names:
            if name in self._at:
                return float(values[self._at[name]])
        return 0.0

    def coefficients(self, values: Array, known: RigInput) -> dict[str, float]:
        """Coefficients of the equation of motion for what is known of one trial."""
        drag = self._value(values, "drag_coefficient")
        friction = 0.0
        if known.pulley:
            friction = self._value(values, "pulley_friction") + self._value(values, "friction_deviation")
        return {
            "inertia": known.inertia + self._value(values, "added_mass", "added_inertia"),
            "quadratic": drag * known.area_factor
            + self._value(values, "quadratic_drag", "quadratic_damping"),
            "linear": self._value(values, "linear_drag", "linear_damping"),
            "dry": friction + self._value(values, "dry_friction"),
            "stiffness": self._value(values, "stiffness"),
            "rest": self._value(values, "rest_position"),
        }

    def _whole(self, values: Array, trial: Trial) -> dict[str, float]:
        """The coefficients, the constant force and the initial state."""
        return {
            **self.coefficients(values, trial.rig),
            "force": self._value(values, "force_offset") + trial.rig.pull,
            "x0": trial.rig.x0 + self._value(values, "start_offset"),
            "v0": self._value(values, "initial_speed"),
        }

    def _release(self, values: Array, trial: Trial) -> float:
        return trial.rig.begin_s + self._value(values, "clock_offset")

    def _step(self, time_s: Array) -> float:
        # from the log's times alone: a step that moved with the parameters would roughen derivatives
        longest = float(time_s[-1] - time_s[0]) / MOST_STEPS
        return self.max_step * max(1.0, longest / DEFAULT_STEP)

    def _broken(self, trial: Trial) -> dict[str, Array]:
        broken = np.full(len(trial.time_s), np.nan)
        return {self.coordinate: broken, self.speed: broken}

    def _moved(self, c: dict[str, float], trial: Trial, release: float) -> dict[str, Array]:
        """Displacement and speed under the coefficients of :meth:`_whole`."""
        if c["inertia"] <= 0 or not np.isfinite(list(c.values())).all():
            return self._broken(trial)
        force, known = trial.inputs.get("force_N"), c["force"]
        constant = c["linear"] == c["stiffness"] == c["v0"] == 0 and known >= 0 and c["quadratic"] >= 0
        if force is None and constant:
            x, v = falling_weight_closed_form(
                trial.time_s, release, c["inertia"], c["quadratic"], known - c["dry"]
            )
            return {self.coordinate: x + c["x0"], self.speed: v}
        x, v = integrate(
            trial.time_s,
            release,
            self._step(trial.time_s),
            np.array([known]) if force is None else force + known,
            *(c[name] for name in EQUATION),
            c["x0"],
            c["v0"],
        )
        return {self.coordinate: x, self.speed: v}

    def simulate(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Displacement and speed at the trial's samples (see :meth:`Model.simulate`)."""
        if not np.isfinite(values).all():
            return self._broken(trial)
        return self._moved(self._whole(values, trial), trial, self._release(values, trial))

    def hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """The same with what else acts on the rig (see :meth:`Model.hooked`).

        ``coefficients`` holds those of :meth:`coefficients`, the constant ``force`` (N) and the initial
        state ``x0``, ``v0``; it is changed before the forces act.

        Raises
        ------
        ValueError
            For more than :data:`swimid.fitting.hooks.MOST_FORCES` forces.
        """
        late = trial
        if hooks.clock_s:
            time = trial.time_s - hooks.clock_s
            inputs = {name: np.interp(time, trial.time_s, data) for name, data in trial.inputs.items()}
            late = replace(trial, time_s=time, inputs=inputs)
        if not np.isfinite(values).all():
            return self._broken(trial)
        c = hooks.changed(self._whole(values, trial), "coefficients")
        release = self._release(values, trial)
        if hooks.force or hooks.flow:
            return hooks.seen(self._forced(c, late, release, hooks), trial.time_s)
        return hooks.seen(self._moved(c, late, release), trial.time_s)

    def _forced(self, c: dict[str, float], trial: Trial, release: float, hooks: Hooks) -> dict[str, Array]:
        if len(hooks.force) > MOST_FORCES:
            raise ValueError(f"{len(hooks.force)} forces act at once, at most {MOST_FORCES} may")
        if c["inertia"] <= 0 or not np.isfinite(list(c.values())).all():
            return self._broken(trial)
        step = self._step(trial.time_s)
        ends = step_ends(trial.time_s, release, step)
        water = np.zeros(len(ends))
        for flow in hooks.flow:
            water = water + flow(ends)[1][:, 0]
        acting = [(f.function, f.constants) for f in hooks.force]
        idle = [(no_force, np.zeros(1))] * (MOST_FORCES - len(acting))
        force = trial.inputs.get("force_N")
        x, v = integrate_forced(
            trial.time_s,
            release,
            step,
            np.array([c["force"]]) if force is None else force + c["force"],
            water,
            c["x0"],
            c["v0"],
            tuple(c[name] for name in EQUATION),
            len(acting),
            *(part for pair in acting + idle for part in pair),
        )
        return {self.coordinate: x, self.speed: v}

    def refined(self) -> RigModel:
        """The same model with half the integration step."""
        return RigModel(self.name, self.parameters, self.coordinate, max_step=0.5 * self.max_step)

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Speed is the rate of the displacement; the rate of the speed is its difference quotient."""
        simulated = self.simulate(values, trial)
        rate = np.gradient(simulated[self.speed], trial.time_s) if len(trial.time_s) > 1 else np.zeros(1)
        return {self.coordinate: simulated[self.speed], self.speed: rate}


def _nuisances(coordinate: str, *, length: float, speed: float, free_start: bool) -> tuple[Parameter, ...]:
    unit, speed_unit, _ = COORDINATES[coordinate]
    inf = math.inf
    return (
        Parameter("start_offset", unit, -inf, inf, 0.0, length, free_start, True, "displacement at release"),
        Parameter("initial_speed", speed_unit, -inf, inf, 0.0, speed, free_start, True, "speed at release"),
        Parameter("clock_offset", "s", -inf, inf, 0.0, 0.1, False, True, "release against the log's clock"),
    )


def falling_weight(*, mass_kg: float, force_N: float, area_known: bool, pulley: bool) -> RigModel:
    """The falling-weight model (boxfish paper, Eqs 7, 8).

    Parameters
    ----------
    mass_kg, force_N : float
        Typical inertia and driving force, for starting values and scales.
    area_known : bool
        Estimate the drag coefficient; else the quadratic coefficient itself.
    pulley : bool
        Whether a pulley's friction acts; without one it is fixed at zero.
    """
    inf = math.inf
    drag = (
        Parameter("drag_coefficient", "1", 0.0, 5.0, 1.0, 0.5, meaning="drag coefficient C_d", source="Eq 7")
        if area_known
        else Parameter(
            "quadratic_drag", "N s^2/m^2", 0.0, inf, 1.0, 1.0, meaning="quadratic drag", source="Eq 7"
        )
    )
    parameters = (
        drag,
        Parameter(
            "added_mass",
            "kg",
            0.0,
            inf,
            0.5 * mass_kg,
            0.5 * mass_kg,
            meaning="added mass m_a",
            source="Eq 8",
        ),
        Parameter(
            "pulley_friction",
            "N",
            0.0,
            inf,
            0.1 * force_N if pulley else 0.0,
            0.2 * force_N,
            free=pulley,
            meaning="pulley friction f_c",
            source="Eq 7",
        ),
        Parameter("linear_drag", "N s/m", 0.0, inf, 0.0, 0.1, free=False, meaning="linear drag"),
        Parameter(
            "friction_deviation",
            "N",
            -inf,
            inf,
            0.0,
            0.05 * force_N,
            free=False,
            per_trial=True,
            meaning="pulley friction of a trial against the common one",
        ),
        *_nuisances("x_m", length=0.01, speed=0.05, free_start=False),
    )
    return RigModel("falling-weight", parameters, "x_m")


def towed(*, mass_kg: float, force_N: float, area_known: bool) -> RigModel:
    """A body under a measured force: added mass and drag; friction and offset on request."""
    inf = math.inf
    drag = (
        Parameter("drag_coefficient", "1", 0.0, 5.0, 1.0, 0.5, meaning="drag coefficient C_d")
        if area_known
        else Parameter("quadratic_drag", "N s^2/m^2", 0.0, inf, 1.0, 1.0, meaning="quadratic drag")
    )
    scale = max(mass_kg, 0.1)
    parameters = (
        drag,
        Parameter("added_mass", "kg", 0.0, inf, 0.5 * scale, 0.5 * scale, meaning="added mass"),
        Parameter("linear_drag", "N s/m", 0.0, inf, 0.0, 1.0, free=False, meaning="linear drag"),
        Parameter(
            "dry_friction", "N", 0.0, inf, 0.0, 0.2 * force_N, free=False, meaning="dry friction", kinked=True
        ),
        Parameter(
            "force_offset", "N", -inf, inf, 0.0, 0.1 * force_N, free=False, meaning="force sensor offset"
        ),
        *_nuisances("x_m", length=0.01, speed=0.05, free_start=True),
    )
    return RigModel("towed", parameters, "x_m")


def free_decay(
    coordinate: str, *, inertia: float, stiffness: float | None, guess: float, amplitude: float
) -> RigModel:
    """Free decay of one coordinate.

    Parameters
    ----------
    coordinate : str
        A key of :data:`COORDINATES`.
    inertia : float
        Known inertia, kg or kg m2.
    stiffness : float or None
        Known stiffness, N/m or N m/rad: the added inertia is then estimated. Where it is
        unknown the stiffness is estimated and the added inertia stays fixed, because a decay
        determines ratios only.
    guess : float
        Stiffness suggested by the period.
    amplitude : float
        Of the first swing, for scales.
    """
    unit, _, rotation = COORDINATES[coordinate]
    inf = math.inf
    rate = math.sqrt(guess / inertia)
    force, moment = ("N m", "N m") if rotation else ("N", "N")
    per_speed, per_speed2 = f"{force} s/{unit}", f"{force} s^2/{unit}^2"
    names = (
        ("added_inertia", "quadratic_damping", "linear_damping")
        if rotation
        else ("added_mass", "quadratic_drag", "linear_drag")
    )
    damping = 0.01 * inertia * rate
    parameters = (
        Parameter(
            names[0],
            "kg m^2" if rotation else "kg",
            0.0,
            inf,
            0.0,
            0.3 * inertia,
            free=stiffness is not None,
            meaning="added inertia" if rotation else "added mass",
        ),
        Parameter(
            names[1],
            per_speed2,
            0.0,
            inf,
            damping / (amplitude * rate),
            damping / (amplitude * rate),
            meaning="quadratic damping",
        ),
        Parameter(names[2], per_speed, 0.0, inf, damping, damping, meaning="linear damping"),
        Parameter(
            "stiffness",
            f"{moment}/{unit}",
            0.0,
            inf,
            guess if stiffness is None else stiffness,
            guess,
            free=stiffness is None,
            meaning="restoring stiffness",
        ),
        Parameter(
            "dry_friction",
            force,
            0.0,
            inf,
            0.0,
            0.01 * guess * amplitude,
            free=False,
            meaning="dry friction",
            kinked=True,
        ),
        Parameter(
            "rest_position", unit, -inf, inf, 0.0, 0.05 * amplitude, per_trial=True, meaning="rest position"
        ),
        *_nuisances(coordinate, length=amplitude, speed=amplitude * rate, free_start=True),
    )
    return RigModel("free-decay", parameters, coordinate)


def warm_up() -> None:
    """Compile the kernels of this module."""
    time = np.array([0.0, 0.1])
    integrate(time, 0.0, 0.1, np.array([1.0]), 1.0, 1.0, 1.0, 0.1, 1.0, 0.0, 0.0, 0.0)
    falling_weight_closed_form(time, 0.0, 1.0, 1.0, 1.0)
