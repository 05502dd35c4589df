"""Motions of the driven joints and values of the inputs of a robot, as input of the simulation.

The motions follow from beats, strokes or measured angles. The inputs of loads follow from columns of a log.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator, make_smoothing_spline
from scipy.optimize import minimize_scalar

from swimid.files.kernels import numba
from swimid.fitting import drives
from swimid.fitting.drives import Array, Motion
from swimid.fitting.model import NONE, Hooks, SwimInput, Trial
from swimid.notices import warn
from swimid.robots.joints import Driven, Input
from swimid.robots.quantities import Polynomial, use_default
from swimid.swimmer.engine import interpolate_states
from swimid.swimmer.tree import Actuated, Tree

Value = TypeVar("Value")
#: Maximum remaining fraction of the initial transient of a servo when a simulation begins in steady swimming.
SERVO_RTOL = 1e-10
#: Maximum number of cached joint motions per trial. The finite differences of a Jacobian use the same few
#: motions again and again.
MAX_MOTIONS = 2
#: Maximum number of cached commanded motions per trial.
MAX_COMMANDS = 2
#: Time step at which the commanded joint angles are sampled, s.
READ_S = 0.0025
#: Knot spacing of the B-spline kernel that smooths the deviation of an actuator from its command, in s
#: (BELL_S), and minimum of this spacing in grid steps (MIN_BELL_STEPS). The deviation is smoothed because a
#: joint angle cannot jump.
BELL_S, MIN_BELL_STEPS = 0.0075, 1.5


class Grid(NamedTuple):
    """Time grid of an integration: ``steps`` equal steps of ``step_s`` from ``begin_s`` on."""

    begin_s: float
    step_s: float
    steps: int

    def times(self, parts: int) -> Array:
        """Return the grid times, with each step divided into ``parts`` parts, shape (parts steps + 1,)."""
        return self.begin_s + self.step_s / parts * np.arange(parts * self.steps + 1.0)


class Laws(NamedTuple):
    """Laws of the actuators and inputs of a robot at values of its coefficients.

    Attributes
    ----------
    servos : tuple
        Natural frequency (Hz) and damping ratio of the servo of each actuator; None for an actuator without a
        servo.
    ratios : tuple of float
        Ratio of the transmission of each driven joint.
    inputs : tuple
        Power, dead band, factor for negative values, and time constant (s) of each input.
    """

    servos: tuple[tuple[float, float] | None, ...]
    ratios: tuple[float, ...]
    inputs: tuple[tuple[float, ...], ...]


class TrialCache(Generic[Value]):
    """Cache of the latest results of each trial. Several threads may use it."""

    def __init__(self, maximum: int) -> None:
        self.maximum = maximum
        self._kept: dict[str, OrderedDict[Hashable, Value]] = {}
        self._lock = threading.Lock()

    def get(self, trial: str, key: Hashable) -> Value | None:
        """Return the cached result of a trial with this key; None if it is not cached."""
        with self._lock:
            kept = self._kept.get(trial, OrderedDict())
            if key in kept:
                kept.move_to_end(key)
            return kept.get(key)

    def put(self, trial: str, key: Hashable, value: Value) -> Value:
        """Store a result, remove the oldest results beyond the maximum number, and return the result."""
        with self._lock:
            kept = self._kept.setdefault(trial, OrderedDict())
            kept[key] = value
            while len(kept) > self.maximum:
                kept.popitem(last=False)
        return value

    def forget(self, trials: Collection[str]) -> None:
        """Remove the cached results of these trials."""
        with self._lock:
            for name in trials:
                self._kept.pop(name, None)


@dataclass(frozen=True)
class DrivenMotion:
    """Motion of the driven joints, and values of the inputs, during a simulation.

    Attributes
    ----------
    table : ndarray, shape (2 steps + 1, driven joints + inputs, 5)
        Input array for the integration, at every half step (see :func:`drive_table`).
    joints : int
        Number of driven joints.
    """

    table: Array
    joints: int
    _kept: dict[bytes, Array] = field(init=False, repr=False, compare=False, default_factory=dict)

    def interpolate_states(self, time_s: Array, grid: Grid) -> Array:
        """Return the joint angles interpolated at given times, shape (driven joints, n).

        The latest result is cached.
        """
        key = time_s.tobytes()
        found = self._kept.get(key)
        if found is None:
            angles, rates = (self.table[::2, : self.joints, k] for k in (0, 1))
            found = interpolate_states(time_s, grid.begin_s, grid.step_s, angles, rates).T
            self._kept.clear()
            self._kept[key] = found
        return found.copy()


class Transmission:
    """Angle of a joint as a function of the angle of its actuator.

    Between the rows of a table the function is a monotone cubic (PCHIP, Fritsch and Butland 1984). Beyond the
    table the function is the tangent at the last row, so that the rate of the joint does not jump.

    Parameters
    ----------
    law : Driven
        Law of the joint. Without an actuator of several joints, the joint has the angle of its own actuator.

    Attributes
    ----------
    ratio : Polynomial
        Joint angle divided by actuator angle. It may depend on the coefficients of the robot.
    range_rad : (float, float)
        First and last actuator angle of the table, rad. They are infinite without a table.
    """

    def __init__(self, law: Driven) -> None:
        self.ratio = Polynomial.of(law.ratio)
        self.range_rad = -np.inf, np.inf
        self._curves: list[PchipInterpolator] = []
        if law.table_deg is not None:
            actuator, joint = np.radians(law.table_deg).T
            self.range_rad = float(actuator[0]), float(actuator[-1])
            curve = PchipInterpolator(actuator, joint)
            self._curves = [curve, curve.derivative(), curve.derivative(2)]

    def motion(self, actuator: Motion, ratio: float) -> Motion:
        """Return angle, rate and acceleration of the joint (rad, rad/s, rad/s2), shape (n,) each.

        Parameters
        ----------
        actuator : (angle, rate, acceleration)
            Motion of the actuator in the same units and with the same shapes.
        ratio : float
            Value of :attr:`ratio`. It has no effect if the law is a table.
        """
        angle, rate, acceleration = actuator
        if not self._curves:
            if ratio == 1.0:
                return actuator
            return ratio * angle, ratio * rate, ratio * acceleration
        inside = np.clip(angle, *self.range_rad)
        value, slope, bend = (np.asarray(curve(inside)) for curve in self._curves)
        bend = np.where(inside == angle, bend, 0.0)
        return value + slope * (angle - inside), slope * rate, slope * acceleration + bend * rate**2

    def slope(self, ratio: float) -> float:
        """Return the rate of the joint divided by that of the actuator at the actuator angle zero."""
        at_zero: Array = np.zeros(1)
        return float(self.motion((at_zero, at_zero + 1.0, at_zero), ratio)[1][0])


class DrivenJoints:
    """Driven joints and inputs of a robot, which compute their motion and values from the input of a trial.

    Parameters
    ----------
    tree : Tree
        Links of the robot, with its actuators, driven joints and inputs. The properties of servos, ratios of
        transmissions and laws of inputs may depend on the coefficients.
    mounts_rad : sequence of float
        Mounting angle that :func:`drive_table` adds to the angle of each joint.
    """

    def __init__(self, tree: Tree, mounts_rad: Sequence[float]) -> None:
        self.actuators, self.mounts_rad = tree.actuators, mounts_rad
        self._tree = tree
        self.inputs: Mapping[str, Input] = tree.body.inputs
        self._servos = [_servo(axis) for axis in self.actuators]
        self._transmissions = [Transmission(axis.joint.driven) for axis in tree.driven]
        self._beyond: set[str] = set()
        self._inputs = [
            [Polynomial.of(entry) for entry in (law.power, law.dead_band, law.reverse, law.lag_s)]
            for law in self.inputs.values()
        ]
        self._motions: TrialCache[DrivenMotion] = TrialCache(MAX_MOTIONS)
        self._commands: TrialCache[tuple[Array, list[Motion]]] = TrialCache(MAX_COMMANDS)
        self._read: dict[str, tuple[SwimInput, Array, list[tuple[Array, Array, float]]]] = {}

    def forget(self, trials: Collection[str]) -> None:
        """Remove the cached results of these trials."""
        self._motions.forget(trials)
        self._commands.forget(trials)
        for name in trials:
            self._read.pop(name, None)

    def commands(self, trial: Trial) -> list[tuple[Array, Array, float]]:
        """Return time (s), command and maximum rate of the command of each actuator and each input.

        The commands of actuators are in rad, those of inputs in the unit of their column. Measured inputs
        are not commands.
        """
        known = self._read.get(trial.id)
        if known is None or known[0] is not trial.swim or known[1] is not trial.time_s:
            time = np.arange(float(trial.time_s[0]), float(trial.time_s[-1]) + READ_S, READ_S)
            motions = [joint_motion(axis, k, trial.swim, time, 0.0) for k, axis in enumerate(self.actuators)]
            found = [(time, angle, float(np.max(np.abs(rate)))) for angle, rate, _ in motions]
            for name, law in self.inputs.items():
                if not law.measured and name in trial.swim.inputs:
                    value = trial.swim.inputs[name](time)
                    found.append((time, value, float(np.max(np.abs(np.diff(value)))) / READ_S))
            known = self._read[trial.id] = trial.swim, trial.time_s, found
        return known[2]

    def motion(
        self,
        values: Array,
        trial: Trial,
        grid: Grid,
        phase_rad: float,
        hooks: Hooks = NONE,
        *,
        cached: bool = True,
    ) -> DrivenMotion:
        """Return the motion of the driven joints in the simulation of a trial.

        Coefficients of the robot affect the motion only through the properties of servos and the ratios of
        transmissions, and the inputs only through their laws.

        Parameters
        ----------
        values : ndarray
            Parameter vector that begins with the coefficients of the robot.
        trial : Trial
        grid : Grid
        phase_rad : float
            Phase of the drive at time zero, in addition to the phase that the trial states.
        hooks : Hooks
            Effects on the actuators. They do not apply to measured angles and to measured inputs, which
            already contain them.
        cached : bool
            Whether the motion is cached for later simulations.
        """
        laws = self._laws_at(values)
        key = (grid, phase_rad, laws, hooks.command_key)
        found = self._motions.get(trial.id, key)
        if found is None:
            of_joints = hooks
            if trial.swim.joints is not None and not trial.swim.commanded:
                of_joints = NONE
            found = self._compute_motion(trial, grid, phase_rad, laws, of_joints)
            if laws.inputs:
                found = self._with_inputs(found, trial, grid, laws, hooks)
            if cached:
                self._motions.put(trial.id, key, found)
        return found

    def _laws_at(self, values: Array) -> Laws:
        named = self._tree.name_values(values)
        return Laws(
            tuple(s and (s[0].at(named), s[1].at(named)) for s in self._servos),
            tuple(transmission.ratio.at(named) for transmission in self._transmissions),
            tuple(tuple(entry.at(named) for entry in law) for law in self._inputs),
        )

    def slopes(self, values: Array) -> list[float]:
        """Return the rate of each driven joint divided by that of its actuator at the actuator angle zero.

        Parameters
        ----------
        values : ndarray
            Parameter vector that begins with the coefficients of the robot.
        """
        ratios = self._laws_at(values).ratios
        return [law.slope(ratio) for law, ratio in zip(self._transmissions, ratios, strict=True)]

    def _with_inputs(
        self, found: DrivenMotion, trial: Trial, grid: Grid, laws: Laws, hooks: Hooks
    ) -> DrivenMotion:
        """Return a motion of the driven joints with the values of the inputs."""
        half, given_inputs = grid.times(2), trial.swim.inputs
        rows = np.zeros((len(half), len(laws.inputs), 5))
        for k, ((name, law), own) in enumerate(zip(self.inputs.items(), laws.inputs, strict=True)):
            if name not in given_inputs:
                continue
            value = given_inputs[name](half)
            if hooks.command and not law.measured:
                value = hooks.actuate(half, value, len(self.actuators) + k)
            rows[:, k, 0] = act(value, 0.5 * grid.step_s, *own)
            if name in self._tree.moving_inputs:
                sampled_at = trial.time_s
                motion = _smooth_positions(sampled_at, given_inputs[name](sampled_at))(half)
                if not np.array_equal(rows[:, k, 0], value) or hooks.command:
                    motion = add_deviation(motion, rows[:, k, 0], 0.5 * grid.step_s)
                rows[:, k, :3] = np.transpose(motion)
        return DrivenMotion(np.concatenate([found.table, rows], axis=1), found.joints)

    def _compute_motion(
        self, trial: Trial, grid: Grid, phase_rad: float, laws: Laws, hooks: Hooks
    ) -> DrivenMotion:
        # begin the motion earlier, so that the initial transients of servos and backlash have decayed at the
        # first step
        before = math.ceil(_memory_s(trial.swim, laws, hooks) / grid.step_s)
        grid = Grid(grid.begin_s - before * grid.step_s, grid.step_s, grid.steps + before)
        half, commands = self._compute_commands(trial, grid, phase_rad)
        motions: list[Motion] = []
        actual: list[Array] = []
        for k, (motion, servo) in enumerate(zip(commands, laws.servos, strict=True)):
            if servo is not None:
                command = np.ascontiguousarray(hooks.actuate(grid.times(4), motion[0], k))
                answer = simulate_servo(command, 0.5 * grid.step_s, 2.0 * math.pi * servo[0], servo[1])
                motions.append((answer[:, 0], answer[:, 1], answer[:, 2]))
            elif hooks.command:
                actual.append(hooks.actuate(half, motion[0], k))
                # reuse the motion object of the last joint if both joints move alike, so that their columns
                # in the array are computed once
                if len(actual) > 1 and motion is commands[k - 1] and actual[-2] is actual[-1]:
                    motions.append(motions[-1])
                else:
                    motions.append(add_deviation(motion, actual[-1], 0.5 * grid.step_s))
            else:
                motions.append(motion)
        joints = zip(self._transmissions, self._tree.actuator_of, laws.ratios, strict=True)
        moved = [law.motion(motions[k], ratio) for law, k, ratio in joints]
        return DrivenMotion(drive_table(len(half), moved, self.mounts_rad)[2 * before :], len(moved))

    def _compute_commands(self, trial: Trial, grid: Grid, phase_rad: float) -> tuple[Array, list[Motion]]:
        """Return the times of the half steps of the grid, and the commanded motion of each actuator.

        The motion is sampled at half steps of the grid, or at quarter steps for an actuator with a servo.
        """
        known = self._commands.get(trial.id, (grid, phase_rad))
        if known is not None:
            return known
        found: list[Motion] = []
        for k, (axis, servo) in enumerate(zip(self.actuators, self._servos, strict=True)):
            if k and self._is_like_last(k, trial.swim):
                found.append(found[-1])
                continue
            parts = 2 if servo is None else 4
            found.append(joint_motion(axis, k, trial.swim, grid.times(parts), phase_rad))
        self._warn_beyond_tables(trial, found)
        return self._commands.put(trial.id, (grid, phase_rad), (grid.times(2), found))

    def _warn_beyond_tables(self, trial: Trial, commands: Sequence[Motion]) -> None:
        """Warn once of each joint whose actuator is commanded to leave the table of the joint."""
        joints = zip(self._tree.driven, self._transmissions, self._tree.actuator_of, strict=True)
        for axis, law, k in joints:
            low, high = law.range_rad
            angle = commands[k][0]
            if axis.name in self._beyond or np.all((angle >= low) & (angle <= high)):
                continue
            self._beyond.add(axis.name)
            least, most, low, high = np.degrees([angle.min(), angle.max(), low, high])
            name = self.actuators[k].name
            warn(
                "SWM077",
                f"in the trial '{trial.id}' the actuator '{name}' moves from {least:.4g} to {most:.4g} deg, "
                f"beyond the table of the joint '{axis.name}', {low:.4g} to {high:.4g} deg: the tangent at "
                "the last row continues the table; add rows to 'table_deg', or reduce the amplitude",
            )

    def _is_like_last(self, k: int, swim: SwimInput) -> bool:
        """Return whether a beat moves actuator ``k`` in the same way as actuator ``k - 1``."""
        if swim.joints is not None or swim.stroke is not None or swim.beat is None:
            return False
        return swim.beat.lag_rad == 0.0 and self.actuators[k - 1].law == self.actuators[k].law


def joint_motion(actuator: Actuated, number: int, swim: SwimInput, time_s: Array, phase_rad: float) -> Motion:
    """Return the commanded motion of an actuator from logged angles, a stroke or a beat.

    Parameters
    ----------
    actuator : Actuated
    number : int
        Index of the actuator.
    swim : SwimInput
    time_s : ndarray, shape (n,)
    phase_rad : float
        Phase that is added to the phase of the drive.
    """
    if swim.joints is not None:
        return swim.joints[number](time_s)
    law = actuator.law
    phase = phase_rad - math.radians(law.phase_lag_deg)
    if swim.stroke is not None:
        return swim.stroke.motion(actuator.name, time_s, phase_rad=phase)
    if swim.beat is None:
        return drives.straight(time_s)
    bias_gain = use_default(law.bias_gain, law.gain)
    phase -= number * swim.beat.lag_rad
    return swim.beat.motion(
        time_s, gain=law.gain, bias_gain=bias_gain, phase_rad=phase, cell_s=drives.cells(time_s)
    )


def _memory_s(swim: SwimInput, laws: Laws, hooks: Hooks) -> float:
    """Return the time in which the initial transient of the actuators decays under a steady beat, s.

    The time is 0 for a simulation that does not begin in steady swimming. The transient of a servo decays
    with its damping. Backlash and rate limits repeat from the second period on.
    """
    if not swim.steady or swim.drive is None:
        return 0.0
    rates = [
        2.0 * math.pi * s[0] * min(s[1], 1.0 / max(2.0 * s[1], 1e-9)) for s in laws.servos if s is not None
    ]
    forgotten = max((-math.log(SERVO_RTOL) / max(rate, 1e-3) for rate in rates), default=0.0)
    if hooks.command:
        forgotten += 2.0 / swim.drive.frequency_hz
    return forgotten


def _servo(actuator: Actuated) -> tuple[Polynomial, Polynomial] | None:
    law = actuator.law
    if law.servo is None:
        return None
    return Polynomial.of(law.servo.natural_frequency_hz), Polynomial.of(law.servo.damping_ratio)


def fit_spline(time_s: Array, angle_rad: Array) -> BSpline:
    """Return a cubic smoothing spline through a measured joint angle.

    The angle, its rate and its acceleration are computed from this one spline. Generalised cross-validation
    selects the amount of smoothing.

    Parameters
    ----------
    time_s, angle_rad : ndarray, shape (n,)
        The angles are NaN where they are missing.

    Raises
    ------
    ValueError
        If fewer than five samples are present.
    """
    there = np.isfinite(angle_rad)
    if there.sum() < 5:
        raise ValueError(f"a measured joint angle has {there.sum()} samples; at least 5 are needed")
    times, angles = time_s[there], np.unwrap(angle_rad[there])
    # measure time in sampling intervals, so that one range of smoothing parameters suits all sampling rates
    scale = float(np.median(np.diff(times)))
    places = (times - times[0]) / scale
    spacing = np.diff(places)
    grid = np.arange(-8.0, 10.0, 0.5)
    scores = [cross_validation_score(10.0**power, spacing, angles) for power in grid]
    best = float(grid[int(np.argmin(scores))])
    around = (best - 0.5, best + 0.5)
    power = minimize_scalar(
        lambda p: cross_validation_score(10.0**p, spacing, angles), bounds=around, method="bounded"
    ).x
    found = make_smoothing_spline(places, angles, lam=10.0**power)
    return BSpline(times[0] + scale * found.t, found.c, 3)


def _smooth_positions(time_s: Array, position: Array) -> Callable[[Array], Motion]:
    """Return the motion of a mass whose positions are the samples of an input, as a function of time.

    The function is the smoothing spline that is used for measured joints. This spline takes angles, so that
    the positions are scaled.
    """
    scale = float(np.nanmax(np.abs(position))) or 1.0
    spline = fit_spline(time_s, position / scale)
    return spline_motion(BSpline(spline.t, scale * spline.c, spline.k))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cross_validation_score(smoothing, spacing, values):  # type: ignore[no-untyped-def]
    """Return the generalised cross-validation score of a natural cubic spline.

    The score is ``n |residuals|^2 / trace(I - A)^2``, where the matrix A maps the data to the spline. The
    second derivatives of the spline are the solution of Reinsch's banded system. The trace is computed from
    the bands of the inverse of that system (Hutchinson and de Hoog, Numerische Mathematik 47, 1985).
    """
    n = len(values)
    m = n - 2
    left, right = 1.0 / spacing[:-1], 1.0 / spacing[1:]
    middle = -left - right
    # with Q and R of Reinsch's system, compute the bands of Q'Q, of R + smoothing Q'Q, and of the factors of
    # the latter matrix
    square, beside, beyond = left**2 + middle**2 + right**2, np.zeros(m + 2), np.zeros(m + 2)
    pivot, first, second = np.zeros(m + 2), np.zeros(m + 2), np.zeros(m + 2)
    curvature = np.zeros(m + 2)
    for j in range(m):
        if j < m - 1:
            beside[j] = middle[j] * left[j + 1] + right[j] * middle[j + 1]
        if j < m - 2:
            beyond[j] = right[j] * left[j + 2]
    for j in range(m):
        pivot[j] = (spacing[j] + spacing[j + 1]) / 3.0 + smoothing * square[j]
        first[j] = (spacing[j + 1] / 6.0 if j < m - 1 else 0.0) + smoothing * beside[j]
        second[j] = smoothing * beyond[j]
        curvature[j] = values[j] * left[j] + values[j + 1] * middle[j] + values[j + 2] * right[j]
        if j > 0:
            pivot[j] -= first[j - 1] ** 2 * pivot[j - 1]
            first[j] -= second[j - 1] * first[j - 1] * pivot[j - 1]
            curvature[j] -= first[j - 1] * curvature[j - 1]
        if j > 1:
            pivot[j] -= second[j - 2] ** 2 * pivot[j - 2]
            curvature[j] -= second[j - 2] * curvature[j - 2]
        first[j] /= pivot[j]
        second[j] /= pivot[j]
    trace, inverse, near, far = 0.0, np.zeros(m + 2), np.zeros(m + 2), np.zeros(m + 2)
    for j in range(m - 1, -1, -1):
        curvature[j] = curvature[j] / pivot[j] - first[j] * curvature[j + 1] - second[j] * curvature[j + 2]
        near[j] = -first[j] * inverse[j + 1] - second[j] * near[j + 1]
        far[j] = -first[j] * near[j + 1] - second[j] * inverse[j + 2]
        inverse[j] = 1.0 / pivot[j] - first[j] * near[j] - second[j] * far[j]
        trace += square[j] * inverse[j] + 2.0 * (beside[j] * near[j] + beyond[j] * far[j])
    residual = np.zeros(n)
    for j in range(m):
        residual[j] += left[j] * curvature[j]
        residual[j + 1] += middle[j] * curvature[j]
        residual[j + 2] += right[j] * curvature[j]
    return n * np.sum(residual**2) / trace**2


def spline_motion(spline: BSpline) -> Callable[[Array], Motion]:
    """Return the motion of a joint whose angle is a spline, as a function of time.

    The angle is constant before the first and after the last sample of the spline.
    """
    rate, bend = spline.derivative(), spline.derivative(2)
    low, high = float(spline.t[0]), float(spline.t[-1])

    def motion(time_s: Array) -> Motion:
        inside = (time_s >= low) & (time_s <= high)
        t = np.clip(time_s, low, high)
        return spline(t), np.where(inside, rate(t), 0.0), np.where(inside, bend(t), 0.0)

    return motion


@numba.njit(cache=True, nogil=True, error_model="numpy")
def simulate_servo(command, step, omega, damping):  # type: ignore[no-untyped-def]
    """Integrate a second-order servo that starts at its commanded angle with zero rate.

    Parameters
    ----------
    command : ndarray, shape (2 m + 1,), rad
        Commanded angle, at every half step.
    step : float, s
    omega : float, rad/s
        Natural angular frequency.
    damping : float
        Damping ratio.

    Returns
    -------
    ndarray, shape (m + 1, 3)
        Angle (rad), rate (rad/s) and acceleration (rad/s2) at every step.
    """
    count = (len(command) - 1) // 2
    result = np.empty((count + 1, 3))
    a, w = command[0], 0.0
    square, loss = omega * omega, 2.0 * damping * omega
    for i in range(count + 1):
        result[i, 0], result[i, 1] = a, w
        result[i, 2] = square * (command[2 * i] - a) - loss * w
        if i == count:
            break
        c0, c1, c2 = command[2 * i], command[2 * i + 1], command[2 * i + 2]
        w1 = w
        d1 = square * (c0 - a) - loss * w1
        w2 = w + 0.5 * step * d1
        d2 = square * (c1 - (a + 0.5 * step * w1)) - loss * w2
        w3 = w + 0.5 * step * d2
        d3 = square * (c1 - (a + 0.5 * step * w2)) - loss * w3
        w4 = w + step * d3
        d4 = square * (c2 - (a + step * w3)) - loss * w4
        a += step / 6.0 * (w1 + 2.0 * (w2 + w3) + w4)
        w += step / 6.0 * (d1 + 2.0 * (d2 + d3) + d4)
    return result


def act(value: Array, step_s: float, power: float, dead_band: float, reverse: float, lag_s: float) -> Array:
    """Return the value of an input after the law of its actuator (:class:`swimid.robots.planar.Input`).

    Parameters
    ----------
    value : ndarray, shape (n,)
        Column of the log, on an even time grid.
    step_s : float
        Step of the grid.
    power, dead_band, reverse, lag_s : float
        Law of the actuator, with the time constant of its lag (see :func:`apply_lag`).

    >>> act(np.array([-3.0, 0.5, 3.0]), 0.1, 2.0, 1.0, 0.5, 0.0).tolist()
    [-2.0, 0.0, 4.0]
    """
    size = np.maximum(np.abs(value) - dead_band, 0.0) ** power
    found = np.where(value < 0.0, -reverse * size, size)
    return np.asarray(apply_lag(step_s * np.arange(len(found)), found, lag_s))


@numba.njit(cache=True, nogil=True)
def apply_lag(time, signal, tau):  # type: ignore[no-untyped-def]
    """Apply a first-order lag to a signal. The result is exact for a signal that is linear between its
    samples.

    Parameters
    ----------
    time : ndarray, shape (n,), s
        Increasing times.
    signal : ndarray, shape (n,)
        Input. The lag starts at rest at the first value of the signal.
    tau : float, s
        Time constant. With zero the output is the signal.

    Returns
    -------
    ndarray, shape (n,)
    """
    output = signal.copy()
    if tau <= 0.0:
        return output
    for i in range(1, len(signal)):
        ratio = (time[i] - time[i - 1]) / tau
        kept = math.exp(-ratio)
        mean = -math.expm1(-ratio) / ratio
        output[i] = kept * output[i - 1] + (mean - kept) * signal[i - 1] + (1.0 - mean) * signal[i]
    return output


def add_deviation(motion: Motion, actual: Array, step_s: float) -> Motion:
    """Return the motion of an actuator whose angle deviates from its command.

    The deviation may have corners. It is smoothed by a cubic B-spline kernel and added to the command, so
    that the angle has a rate and an acceleration. Before the first sample the deviation counts as constant.
    After the last sample it continues with its rate, as the mirror image of its end.

    Parameters
    ----------
    motion : (angle, rate, acceleration), each shape (n,)
        Command on an even time grid.
    actual : ndarray, shape (n,)
        Angle that the actuator reaches, rad.
    step_s : float
        Step of the time grid.
    """
    deviation = actual - motion[0]
    if not deviation.any():
        return motion
    bells = _bells(step_s)
    reach = len(bells[0]) // 2
    before_last = np.maximum(len(deviation) - 2 - np.arange(reach), 0)
    mirrored = 2.0 * deviation[-1] - deviation[before_last]
    padded = np.concatenate((np.full(reach, deviation[0]), deviation, mirrored))
    parts = [np.convolve(padded, bell, mode="valid") for bell in bells]
    return motion[0] + parts[0], motion[1] + parts[1], motion[2] + parts[2]


@lru_cache(maxsize=32)
def _bells(step_s: float) -> list[Array]:
    """Return the smoothing kernel and its first two derivatives, each over ``reach`` samples on either side.

    Each has the shape (2 reach + 1,).
    """
    spacing = max(BELL_S, MIN_BELL_STEPS * step_s)
    reach = math.ceil(2.0 * spacing / step_s)
    at = np.arange(-reach, reach + 1) * step_s / spacing
    bell = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
    found = []
    for order in range(3):
        kernel = np.nan_to_num(bell(at, nu=order)) / spacing**order
        # correct the moments of the sampled kernel, so that it reproduces constants and straight lines
        # exactly
        if order:
            kernel -= kernel.mean()
        found.append(kernel / float(kernel @ ((-at * spacing) ** order / math.factorial(order))))
    return found


def drive_table(count: int, motions: Sequence[Motion], mounts_rad: Sequence[float]) -> Array:
    """Return joint motions as an input array for the integration, shape (count, joints, 5).

    The columns are angle (rad), rate (rad/s), acceleration (rad/s2), and the cosine and the sine of the sum
    of joint angle and mounting angle.
    """
    found = np.empty((count, len(motions), 5))
    joints = zip(motions, mounts_rad, range(len(motions)), strict=True)
    # fill the columns of neighbouring joints in one pass if these joints have the same motion
    for _, group in groupby(joints, key=lambda joint: (id(joint[0]), joint[1])):
        (motion, mount, first), *others = group
        parts = (np.ascontiguousarray(part, dtype=float) for part in motion)
        _columns(found, first, first + 1 + len(others), *parts, mount)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _columns(found, first, end, angle, rate, acceleration, mount):  # type: ignore[no-untyped-def]
    for i in range(len(found)):
        c, s = math.cos(angle[i] + mount), math.sin(angle[i] + mount)
        for k in range(first, end):
            found[i, k, 0], found[i, k, 1], found[i, k, 2] = angle[i], rate[i], acceleration[i]
            found[i, k, 3], found[i, k, 4] = c, s
