"""Experiment ``free-decay``: the robot is displaced and released."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError
from swimid.files.tabular import column_error
from swimid.fitting.fit_common import Experiment, read_trial_log
from swimid.fitting.model import Array, RigInput, Trial
from swimid.logs.experiments import EVERYWHERE, Params, Trials
from swimid.logs.log import Log, unwrap_angle
from swimid.logs.sampling import white_noise_sd
from swimid.notices import warn
from swimid.rig import model as rig
from swimid.rig.model import MASS_KEY, RigTrial, mass_of
from swimid.robots.file import Robot

#: Relative tolerance in a free decay. A sample within this tolerance of the extreme of a swing counts as the
#: extreme. A swing within this tolerance of the largest swing counts as equally large.
EXTREME_RTOL = 0.05
#: Minimum duration near the extreme of a swing, as a fraction of a period, at which the body is assumed to
#: have been held there before release. A free swing stays within 5 % of its extreme for 0.1 of a period,
#: ``2 arccos(0.95) / (2 pi)``.
HELD_PERIODS = 0.1
#: Maximum creep (slow drift) of the rest position after the only overshoot of a free decay, as a fraction of
#: the overshoot. The relative error of the damping ratio is about this fraction divided by the logarithmic
#: decrement of a half swing, which is about 1 or more if the second overshoot is hidden.
MAX_CREEP = 0.2


class FreeDecay(Trials):
    """Trials file of a free-decay experiment: the robot is displaced and released.

    Example::

        format: swimid-trials/1
        experiment: free-decay
        robot: boxfish
        trials:
          - {log: roll1.csv, start_s: 1.5}
          - {log: roll2.csv, role: validate}
    """

    about = "the robot is displaced and released"
    models = ("free-decay",)
    commands = ("fit-drag",)
    needs = (("x_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad"),)
    uses = EVERYWHERE | {f"trials.{MASS_KEY}"}

    experiment: Literal["free-decay"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]

    def load(
        self, path: Path, *, params: Params | None = None, coordinate: str | None = None, **options: Any
    ) -> Experiment:
        """Read the decays (see :meth:`Trials.load`).

        Parameters
        ----------
        params : (Path, ParameterFile), optional
            Parameter file, which states the coordinate.
        coordinate : str, optional
            Coordinate of the decay, which is required if the logs have several coordinates.
        """
        robot = self.read_robot(path.parent)
        if params is not None and params[1].fit is not None and len(params[1].fit.channels) == 1:
            coordinate = next(iter(params[1].fit.channels))
        logs = [
            read_trial_log(e, path.parent, required=(), optional=tuple(rig.COORDINATES)) for e in self.trials
        ]
        name = coordinate or _coordinate(logs)
        rotation = rig.COORDINATES[name][2]
        axis = name.removesuffix("_rad")
        trials, periods, amplitudes = [], [], []
        for entry, log in zip(self.trials, logs, strict=True):
            if name not in log:
                raise column_error(name, list(log.columns), log.path, None)
            time, values, period, amplitude = _decay(log, name)
            periods.append(period)
            amplitudes.append(amplitude)
            inertia = _inertia(entry, robot, axis, rotation, path)
            known = RigInput(inertia, release_s=float(time[0]), x0=float(values[0]))
            trials.append(Trial(entry.id, entry.role, time, {name: values}, rig=known))
        inertia = trials[0].rig.inertia
        stiffness = robot.rig.stiffness_N_m
        if rotation:
            stiffness = getattr(robot.rig, f"{axis}_stiffness_N_m_rad", None)
        gravity = getattr(robot.rig, f"{axis}_gravity_stiffness_N_m_rad", None)
        if gravity is not None and stiffness is None:
            stiffness = 0.0
        if stiffness is None:
            warn(
                "SWM019",
                "the restoring stiffness is unknown, so the decay determines only ratios to the inertia "
                f"{inertia:g}; added inertia is held at zero, and the stiffness is estimated",
            )
        model = rig.free_decay(
            name,
            inertia=inertia,
            stiffness=stiffness,
            guess=inertia * (2 * math.pi / float(np.median(periods))) ** 2,
            amplitude=float(np.median(amplitudes)),
            gravity=gravity or 0.0,
        )
        sources = [log.source for log in logs]
        return Experiment.of(self, path, model, trials, sources, robot)


def _coordinate(logs: list[Log]) -> str:
    common = [c for c in rig.COORDINATES if all(c in log for log in logs)]
    if len(common) != 1:
        raise InputError(
            f"the logs must share exactly one coordinate, but share {len(common)} ({', '.join(common)})",
            file=logs[0].path,
            hint=f"choose one of {', '.join(rig.COORDINATES)} with --coordinate",
        )
    return common[0]


def _inertia(entry: RigTrial, robot: Robot, axis: str, rotation: bool, path: Path) -> float:
    """Return the known mass or moment of inertia of a free decay; 1 for an unknown moment of inertia."""
    if not rotation:
        return mass_of(entry, robot, path)
    if entry.inertial_mass_kg is not None:
        raise InputError(
            f"the mass of '{entry.id}' has no effect on a free decay in {axis}",
            file=path,
            column=MASS_KEY,
            hint=f"the inertia is {axis}_inertia_kg_m2 of the robot file",
        )
    inertia = getattr(robot.body, f"{axis}_inertia_kg_m2")
    if not inertia:
        warn(
            "SWM019",
            f"the robot '{robot.name}' has no {axis}_inertia_kg_m2: all parameters are per unit of "
            "total inertia",
        )
    return float(inertia or 1.0)


def _swings(values: Array, noise: float, log: Log, name: str) -> tuple[Array, Array]:
    """Divide the record of a free decay into half swings, which alternate about the rest position.

    Returns
    -------
    crossings : ndarray, shape (n - 1,)
        Index of the first sample of each half swing except the first.
    extremes : ndarray, shape (n,)
        Value of each half swing that is farthest from the rest position.

    Raises
    ------
    InputError
        If the record has fewer than three half swings, and no overshoot after which it comes to rest.
    """
    found = None
    # Most records end with the body at rest, so that the last quarter of the record gives the rest position.
    # If no swings are found about this level, try the middle of the range of the record.
    end = float(np.median(values[len(values) * 3 // 4 :]))
    for level in (end, 0.5 * float(values.max() + values.min())):
        for _ in range(3):
            crossings, extremes = _half_swings(values, level, noise)
            if len(extremes) < 3:
                break
            found = crossings, extremes
            # Estimate the rest position by a weighted mean of three successive extremes. The error of this
            # mean is of second order in the decay per half swing.
            level = float(extremes[-3:] @ (0.25, 0.5, 0.25))
        if found is not None:
            return found
    # Swings after the first overshoot are hidden by a creep of the rest position, or missing with strong
    # damping. One overshoot shorter than the first swing still determines period and damping.
    crossings, extremes = _half_swings(values, end, noise)
    if len(extremes) == 2 and abs(extremes[1] - end) < abs(extremes[0] - end):
        after = values[np.argmin(np.abs(values - extremes[1])) :]
        creep = abs(float(np.median(after[len(after) // 2 :]) - np.median(after[: len(after) // 2 + 1])))
        if len(after) > len(values) // 4 and creep < MAX_CREEP * abs(extremes[1] - end):
            return crossings, extremes
    raise InputError(
        "does not oscillate: it has no overshoot, or creeps instead of coming to rest",
        file=log.path,
        column=name,
        hint="cut off a slow creep with end_s in the trials file; for strong damping use 'experiment: towed' "
        "with a measured force",
    )


def _half_swings(values: Array, level: float, noise: float) -> tuple[Array, Array]:
    """Return the indices at which a record crosses a level, and the extreme value between two crossings.

    An extreme is the value that is farthest from the level. The ends of the record count as crossings.
    """
    away = values - level
    amplitude = float(np.max(np.abs(away)))
    # Ignore values within a band around the level, so that noise does not count as a crossing.
    band = min(max(0.1 * amplitude, 4.0 * noise), 0.25 * amplitude)
    state = np.sign(away) * (np.abs(away) > band)
    marked = np.flatnonzero(state)
    crossings = marked[1:][np.diff(state[marked]) != 0]
    extremes = [part[np.argmax(np.abs(part))] for part in np.split(away, crossings)]
    return crossings, np.array(extremes) + level


def _period(time: Array, values: Array, crossings: Array, extremes: Array) -> float:
    """Return the mean period of a free decay, s, over the swings before the first irregular swing.

    The arguments ``crossings`` and ``extremes`` begin at the first swing (:func:`_swings`).
    """
    if len(crossings) == 1:
        # The extremes of two successive half swings are half a period apart.
        before, after = values[: crossings[0]], values[crossings[0] :]
        near = np.abs(before - extremes[0]) <= EXTREME_RTOL * abs(extremes[0] - extremes[1])
        turns = np.flatnonzero(near)[-1], crossings[0] + np.argmin(np.abs(after - extremes[1]))
        return 2.0 * float(np.ptp(time[[*turns]]))
    halves = np.diff(time[crossings])
    regular = np.abs(halves / np.median(halves) - 1.0) < 0.3
    count = max(int(np.argmin([*regular, False])), 1)
    # Use an even number of half swings, because the two half swings of a period differ in duration if the
    # crossed level is not the rest position.
    count = max(count - count % 2, 1)
    return 2.0 * float(np.sum(halves[:count])) / count


def _decay(log: Log, name: str) -> tuple[Array, Array, float, float]:
    """Return the record of a free decay from its release on, its period (s) and its first amplitude.

    The record consists of times and values. Swings of a free decay do not grow, so that the decay begins with
    the first of the largest swings. If the body was held at an excursion before its release, or was at rest
    before it was deflected, the decay begins at the end of this time.
    """
    column = unwrap_angle(name, log[name])
    there = np.isfinite(column)
    time, values = log.time_s[there], column[there]
    noise = white_noise_sd(values, 0.0)
    crossings, extremes = _swings(values, noise, log, name)
    heights = np.abs(np.diff(extremes))
    largest = float(heights.max())
    slack = max(EXTREME_RTOL * largest, 3.0 * math.sqrt(2.0) * noise)
    first = int(np.argmax(heights >= largest - slack))
    begin, end = ([0, *crossings.tolist()][first + k] for k in (0, 1))
    period = _period(time, values, crossings[first:], extremes[first:])
    amplitude = 0.5 * float(heights[first])
    part, since = values[begin:end], time[begin:end] - time[begin]
    margin = max(EXTREME_RTOL * amplitude, 3.0 * noise)
    near = np.flatnonzero(np.abs(part - extremes[first]) <= margin)
    held = since[near[-1]] - since[near[0]] > HELD_PERIODS * period
    moving = since[np.abs(part - part[0]) > margin]
    waits = first == 0 and len(moving) > 0 and moving[0] > HELD_PERIODS * period
    late = since[near[0]] > 0.5 * period
    if held:
        level = float(np.median(part[near]))
        spread = 1.4826 * float(np.median(np.abs(part[near] - level)))
        # The release lies between the last sample at this level and the next one.
        begin += int(np.flatnonzero(np.abs(part - level) <= max(3.0 * spread, 1e-3 * amplitude))[-1]) + 1
    elif first or waits or late:
        begin += int(np.argmax(np.abs(part - part[-1])))
    if begin > 0.5 * len(values):
        raise InputError(
            f"the largest excursion is at {time[begin]:g} s; it must be in the first half of the log",
            file=log.path,
            column=name,
            hint="cut the log with start_s and end_s in the trials file",
        )
    if begin > 3:
        warn(
            "SWM018",
            f"{log.path.name}: {time[begin] - time[0]:.3g} s before the release from the largest excursion "
            "are left out",
        )
    start = int(np.flatnonzero(there)[begin])
    return log.time_s[start:], column[start:], period, amplitude
