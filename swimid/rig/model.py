"""The single-degree-of-freedom rig: falling weight, towing and free decay.

One equation serves all three::

    (m + m_added + m_pull + m_pulley) x'' = F - dry sgn(x') - linear x'
                                            - quadratic x' |x'| - R(x - x_rest)

with ``R(d) = stiffness d + gravity sin(d) + cubic d^3`` and ``quadratic = rho C_d A / 2`` for a body of
known frontal area (boxfish paper, Eqs 7, 8). For a rotation, moments of inertia take the place of masses and
moments that of forces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.fitting.drives import RigInput
from swimid.fitting.hooks import MOST_FORCES, NONE, Hooks, no_force
from swimid.fitting.model import Array, Channel, Model, Parameter, Rig, Scales, Trial
from swimid.rig.equation import falling_weight_closed_form, integrate, integrate_forced, step_ends

#: Coordinates a rig may log, with unit, unit of speed and whether it is a rotation.
COORDINATES: dict[str, tuple[str, str, bool]] = {
    "x_m": ("m", "m/s", False),
    "z_m": ("m", "m/s", False),
    "roll_rad": ("rad", "rad/s", True),
    "pitch_rad": ("rad", "rad/s", True),
    "yaw_rad": ("rad", "rad/s", True),
}
#: Coordinates in which gravity restores.
TILTS = ("roll_rad", "pitch_rad")
#: Parameters that act alike: of each group one may stand in the place of the others.
ALIKE = (
    (
        *("drag_coefficient", "quadratic_drag", "quadratic_damping"),
        *("linear_drag", "linear_damping", "dry_friction"),
    ),
    ("stiffness", "gravity_stiffness"),
)
#: Largest integration step, s, before the accuracy check refines it.
DEFAULT_STEP = 0.01
#: A trial so long that it would take more such steps starts with longer ones.
MOST_STEPS = 5_000
#: Coefficients of the equation of motion, in the order :func:`integrate` takes them.
EQUATION = ("inertia", "quadratic", "linear", "dry", "stiffness", "rest", "gravity", "cubic")


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
        rate = math.sqrt(max(self.stiffness, 1e-12) / self.inertia)
        return self.span * rate or 0.1

    @property
    def stiffness(self) -> float:
        """The stiffness of small swings, N/m or N m/rad."""
        return self.model.start("stiffness") + self.model.start("gravity_stiffness")

    @property
    def inertia(self) -> float:
        """The known inertia and the added, kg or kg m2; 1 where nothing tells."""
        known = [t.rig.inertia for t in self.trials if not math.isnan(t.rig.inertia)]
        return float(np.median(known)) + self.model.start("added_mass", "added_inertia") if known else 1.0

    @property
    def force(self) -> float:
        """The pull, or the restoring force over the extent of the motion, N or N m."""
        if self.model.rig.swings:
            return max(self.stiffness, 1e-12) * self.span
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

    def onset(self, trial: Trial) -> float:
        """The release, s."""
        return trial.rig.begin_s

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
            "gravity": self._value(values, "gravity_stiffness"),
            "cubic": self._value(values, "cubic_stiffness"),
        }

    def _whole(self, values: Array, trial: Trial) -> dict[str, float]:
        """The coefficients, the constant force and the initial state."""
        return {
            **self.coefficients(values, trial.rig),
            "force": self._value(values, "force_offset") + trial.rig.pull,
            "drift": self._value(values, "force_drift"),
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

    def _moved(
        self, c: dict[str, float], trial: Trial, release: float, hooks: Hooks = NONE
    ) -> dict[str, Array]:
        """Displacement and speed under the coefficients of :meth:`_whole`."""
        if c["inertia"] <= 0 or not np.isfinite(list(c.values())).all():
            return self._broken(trial)
        measured, known = trial.inputs.get("force_N"), c["force"]
        forced = bool(hooks.force or hooks.flow)
        unbent = c["linear"] == c["stiffness"] == c["gravity"] == c["cubic"] == c["v0"] == 0
        constant = unbent and known >= 0 and c["quadratic"] >= 0
        if measured is None and constant and not forced:
            x, v = falling_weight_closed_form(
                trial.time_s, release, c["inertia"], c["quadratic"], known - c["dry"]
            )
            return {self.coordinate: x + c["x0"], self.speed: v}
        force = np.array([known])
        if measured is not None:
            force = measured + known + c["drift"] * (trial.time_s - trial.rig.begin_s)
        equation = tuple(c[name] for name in EQUATION)
        step = self._step(trial.time_s)
        if not forced:
            place = (c["x0"], c["v0"])
            x, v = integrate(trial.time_s, release, step, force, *equation[:6], *place, *equation[6:])
            return {self.coordinate: x, self.speed: v}
        ends = step_ends(trial.time_s, release, step)
        water = np.zeros(len(ends))
        for flow in hooks.flow:
            water = water + flow(ends)[1][:, 0]
        acting = [(f.function, f.constants) for f in hooks.force]
        idle = [(no_force, np.zeros(1))] * (MOST_FORCES - len(acting))
        forces = (part for pair in acting + idle for part in pair)
        x, v = integrate_forced(
            trial.time_s, release, step, force, water, c["x0"], c["v0"], equation, len(acting), *forces
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
        if hooks.late:
            time = hooks.happened(trial.time_s)
            inputs = {name: np.interp(time, trial.time_s, data) for name, data in trial.inputs.items()}
            late = replace(trial, time_s=time, inputs=inputs)
        if not np.isfinite(values).all():
            return self._broken(trial)
        if len(hooks.force) > MOST_FORCES:
            raise ValueError(f"{len(hooks.force)} forces act at once, at most {MOST_FORCES} may")
        c = hooks.changed(self._whole(values, trial), "coefficients")
        return hooks.seen(self._moved(c, late, self._release(values, trial), hooks), trial.time_s)

    def refined(self) -> RigModel:
        """The same model with half the integration step."""
        return RigModel(self.name, self.parameters, self.coordinate, max_step=0.5 * self.max_step)

    def sensitivity_to_time(self, values: Array, trial: Trial) -> dict[str, Array]:
        """Speed is the rate of the displacement; the rate of the speed is its difference quotient."""
        simulated = self.simulate(values, trial)
        rate = np.gradient(simulated[self.speed], trial.time_s) if len(trial.time_s) > 1 else np.zeros(1)
        return {self.coordinate: simulated[self.speed], self.speed: rate}


def terminal_speed(c: Mapping[str, float], force: float) -> float:
    """Return the speed at which drag and friction hold a force, m/s; NaN where there is none."""
    push = force - c["dry"]
    brake = c["linear"] + math.sqrt(c["linear"] ** 2 + 4 * max(c["quadratic"], 0.0) * max(push, 0.0))
    return 2 * push / brake if push > 0 and brake > 0 else math.nan


def _parameter(
    name: str, unit: str, start: float, scale: float, meaning: str, *, lower: float = 0.0, **more: Any
) -> Parameter:
    """One without an upper bound."""
    return Parameter(name, unit, lower, math.inf, start, scale, meaning=meaning, **more)


def _signed(name: str, unit: str, scale: float, meaning: str, **more: Any) -> Parameter:
    """One about zero."""
    return _parameter(name, unit, 0.0, scale, meaning, lower=-math.inf, **more)


def _drag(area_known: bool, source: str = "") -> Parameter:
    """The drag coefficient; where the frontal area is not known, the quadratic coefficient itself."""
    if area_known:
        return Parameter(
            "drag_coefficient", "1", 0.0, 5.0, 1.0, 0.5, meaning="drag coefficient C_d", source=source
        )
    return _parameter("quadratic_drag", "N s^2/m^2", 1.0, 1.0, "quadratic drag", source=source)


def _start(coordinate: str, *, length: float, speed: float, free: bool) -> tuple[Parameter, ...]:
    """Where, how fast and when a trial starts."""
    unit, speed_unit, _ = COORDINATES[coordinate]
    own: dict[str, Any] = {"per_trial": True}
    return (
        _signed("start_offset", unit, length, "displacement at release", free=free, **own),
        _signed("initial_speed", speed_unit, speed, "speed at release", free=free, **own),
        _signed("clock_offset", "s", 0.1, "release against the log's clock", free=False, **own),
    )


def falling_weight(
    *, mass_kg: float, force_N: float, area_known: bool, pulley: bool, speed_m_s: float = 0.3
) -> RigModel:
    """The falling-weight model (boxfish paper, Eqs 7, 8), for a typical inertia, driving force and speed.

    ``area_known``: the drag coefficient is estimated, else the quadratic coefficient itself; without a
    ``pulley`` its friction is fixed at zero.
    """
    half, friction = 0.5 * mass_kg, 0.1 * force_N if pulley else 0.0
    common = "pulley friction of a trial against the common one"
    parameters = (
        _drag(area_known, "Eq 7"),
        _parameter("added_mass", "kg", half, half, "added mass m_a", source="Eq 8"),
        _parameter(
            "pulley_friction", "N", friction, 0.2 * force_N, "pulley friction f_c", free=pulley, source="Eq 7"
        ),
        _parameter("linear_drag", "N s/m", 0.0, 0.1 * force_N / speed_m_s, "linear drag", free=False),
        _signed("friction_deviation", "N", 0.05 * force_N, common, free=False, per_trial=True),
        *_start("x_m", length=0.01, speed=0.05, free=False),
    )
    return RigModel("falling-weight", parameters, "x_m")


def towed(*, mass_kg: float, force_N: float, area_known: bool, speed_m_s: float = 0.3) -> RigModel:
    """Return the model of a body under a measured force: added mass and drag; the others on request."""
    half = 0.5 * max(mass_kg, 0.1)
    parameters = (
        _drag(area_known),
        _parameter("added_mass", "kg", half, half, "added mass"),
        _parameter("linear_drag", "N s/m", 0.0, 0.1 * force_N / speed_m_s, "linear drag", free=False),
        _parameter("dry_friction", "N", 0.0, 0.2 * force_N, "dry friction", free=False, kinked=True),
        _signed("force_offset", "N", 0.1 * force_N, "force added to the measured one", free=False),
        _signed("force_drift", "N/s", 0.01 * force_N, "rate of the force added to it", free=False),
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
    """Return the model of a free decay of one of :data:`COORDINATES`.

    Parameters
    ----------
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
    gravity : float
        Known gravity stiffness m g l, in roll and pitch.
    """
    unit, _, rotation = COORDINATES[coordinate]
    force, mass = ("N m", "kg m^2") if rotation else ("N", "kg")
    kind, loss = ("inertia", "damping") if rotation else ("mass", "drag")
    rate = math.sqrt(guess / inertia)
    damping, speed = 0.01 * inertia * rate, amplitude * rate
    quadratic, known = damping / speed, stiffness is not None
    restoring = f"{force}/{unit}"
    cubic = guess / (6.0 * amplitude**2)
    meaning = "m g l of a restoring moment m g l sin(angle)"
    pendulum = _parameter("gravity_stiffness", restoring, gravity, guess, meaning, free=False)
    parameters = (
        _parameter(f"added_{kind}", mass, 0.0, 0.3 * inertia, f"added {kind}", free=known),
        _parameter(f"quadratic_{loss}", f"{force} s^2/{unit}^2", quadratic, quadratic, "quadratic damping"),
        _parameter(f"linear_{loss}", f"{force} s/{unit}", damping, damping, "linear damping"),
        _parameter(
            "stiffness",
            restoring,
            guess - gravity if stiffness is None else stiffness,
            guess,
            "stiffness of a linear spring",
            free=not known,
        ),
        _signed("cubic_stiffness", f"{restoring}^3", cubic, "cubic restoring stiffness", free=False),
        *([pendulum] if coordinate in TILTS else []),
        _parameter(
            "dry_friction", force, 0.0, 0.01 * guess * amplitude, "dry friction", free=False, kinked=True
        ),
        _signed("rest_position", unit, 0.05 * amplitude, "rest position", per_trial=True),
        *_start(coordinate, length=amplitude, speed=speed, free=True),
    )
    return RigModel("free-decay", parameters, coordinate)
