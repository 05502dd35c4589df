"""Search for a common recording mistake that explains why a model does not fit a trial.

Examples are a heading of the tail instead of the body, a mirrored axis, a wrong unit and a wrong sign. Such a
mistake makes every fit bad and looks like a missing effect. Each known mistake is undone in turn by a
transformation of the data or of the drive, and the model is compared with the trial again. The data stay
unchanged: the result is a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common
from swimid.fitting.drives import Motion
from swimid.fitting.fit_common import GOOD, USABLE
from swimid.fitting.model import Array, Model, Trial
from swimid.fitting.uncertainty import autocorrelation
from swimid.notices import recorded
from swimid.results import evidence as ev
from swimid.results import numbers

#: Factors between units of length that are often confused in recordings.
FACTORS = (10.0, 100.0, 1000.0, 0.1, 0.01, 0.001)
DEGREE = math.pi / 180.0
#: Factors that undo common mistakes in the amplitude of a drive (AMPLITUDES) and in the motion of all driven
#: joints (JOINTS), by the description of the correction.
AMPLITUDES = {
    "twice the amplitude of the drive": 2.0,
    "half the amplitude of the drive": 0.5,
    "the amplitude of the drive taken as radians": 1.0 / DEGREE,
    "the amplitude of the drive multiplied by pi/180": DEGREE,
}
JOINTS = {
    "the signs of all driven joints changed": -1.0,
    "the driven joints taken as degrees": DEGREE,
    "the driven joints multiplied by 180/pi": 1.0 / DEGREE,
    "the driven joints multiplied by 2": 2.0,
    "the driven joints multiplied by 0.5": 0.5,
}
#: Minimum evidence for a mistake: twice the logarithm of a decisive Bayes factor (Kass and Raftery, J. Am.
#: Stat. Assoc. 90, 1995). The allowance for the number of alternatives is subtracted from the evidence first.
DECISIVE = 10.0
#: Maximum number of recording mistakes whose correction is tested by a new fit.
MAX_REFITS = 4
#: Relative tolerance of the cost when initial states are estimated during the search for mistakes.
START_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Mistake:
    """Recording mistake with the transformation that undoes it.

    Attributes
    ----------
    says : str
        Description of the correction, which follows the word "With" in a sentence: ``yaw + 180 degrees``.
    undo : callable
        Function from a trial to the corrected trial. It returns None if the trial has nothing to correct.
    """

    says: str
    undo: Callable[[Trial], Trial | None]


class Misfit(NamedTuple):
    """Error of the simulation of one channel in one trial."""

    #: Root-mean-square error divided by the measured range of the channel.
    nrmse: float
    #: For a coordinate of a position: root-mean-square error of both coordinates, divided by their joint
    #: range, which does not depend on the direction of the axes. For other channels: ``nrmse``.
    relative: float
    #: Number of independent samples in the residual.
    independent: float


class Explanation(NamedTuple):
    """Recording mistake that explains the error of a model, with the errors before and after correction.

    Attributes
    ----------
    says : str
        Description of the mistake.
    trials : tuple of str
        Trials in which the mistake was undone.
    everywhere : bool
        Whether the mistake was undone in all trials.
    channel : str
        Channel whose error falls most.
    before, after : float
        Error of the channel before and after the correction, divided by its measured range.
    gain : float
        Twice the logarithm of the likelihood ratio, minus twice the logarithm of the number of alternatives.
    """

    says: str
    trials: tuple[str, ...]
    everywhere: bool
    channel: str
    before: float
    after: float
    gain: float

    @property
    def sentence(self) -> str:
        """Sentence of the report that describes the correction and the change of the error."""
        where = "all trials" if self.everywhere else f"trial {', '.join(self.trials)}"
        return (
            f"With {self.says} in {where} the error of {self.channel} falls from "
            f"{numbers.percent(self.before)} to {numbers.percent(self.after)}."
        )


Errors = Mapping[str, Misfit]
Evaluate = Callable[[Trial], Errors]


# ------------------------------------------------------------ catalogue


def catalogue(model: Model, trials: Sequence[Trial]) -> list[Mistake]:
    """Return all recording mistakes that can occur in the trials of a model."""
    names = list(dict.fromkeys(c for t in trials for c in (*t.measured, *t.inputs)))
    pose = fit_common.pose_channels(model)
    units = {c.name: c.unit for c in model.channels}
    place = [name for name in pose if units[name] == "m"]
    known = [name for name in names if name in units]
    changes: dict[str, Mapping[str, tuple[float, float]]] = {}
    if {"x_m", "y_m", "yaw_rad"} <= set(pose):
        changes["yaw + 180 degrees"] = {"yaw_rad": (1.0, math.pi)}
        changes["yaw mirrored"] = {"yaw_rad": (-1.0, 0.0)}
        changes["y mirrored"] = {"y_m": (-1.0, 0.0)}
    changes |= {f"the sign of {name} changed": {name: (-1.0, 0.0)} for name in known if name not in pose}
    for name in (n for n in known if units[n] == "rad"):
        changes[f"{name} taken as degrees"] = {name: (DEGREE, 0.0)}
        changes[f"{name} multiplied by 180/pi"] = {name: (1.0 / DEGREE, 0.0)}
    groups = [place, *([name] for name in known if name not in place)]
    for group in (group for group in groups if group and units[group[0]] != "rad"):
        for factor in FACTORS:
            says = f"{' and '.join(group)} multiplied by {factor:g}"
            changes[says] = dict.fromkeys(group, (factor, 0.0))
    found = [Mistake(says, partial(_changed, pose, change)) for says, change in changes.items()]
    found += [Mistake(says, partial(_driven, factor)) for says, factor in AMPLITUDES.items()]
    joints = max((len(t.swim.joints) for t in trials if t.swim.joints is not None), default=0)
    for k in range(joints):
        found.append(Mistake(f"the sign of driven joint {k + 1} changed", partial(_joint, -1.0, [k])))
    if joints:
        found += [Mistake(says, partial(_joint, by, range(joints))) for says, by in JOINTS.items()]
    swimmer = model.swimmer
    columns = {} if swimmer is None else {name: law.column for name, law in swimmer.inputs.items()}
    for name in dict.fromkeys(n for t in trials for n in (*t.swim.inputs, *t.inputs) if n not in units):
        found.append(Mistake(f"the sign of {columns.get(name, name)} changed", partial(_reversed, name)))
    if swimmer is not None and not swimmer.in_space:
        found.append(Mistake("a start in steady swimming (start_state: steady)", _steady))
    return found


def _changed(pose: Sequence[str], change: Mapping[str, tuple[float, float]], trial: Trial) -> Trial | None:
    """Return a copy of the trial with channels and initial pose changed to ``factor * value + offset``.

    Return None if the trial has none of these channels.
    """
    if not any(name in trial.measured for name in change):
        return None

    def changed(name: str, values: Any) -> Any:
        factor, offset = change.get(name, (1.0, 0.0))
        return factor * values + offset

    swim = trial.swim
    if swim.pose is not None:
        moved = [changed(name, at) for name, at in zip(pose, swim.pose, strict=False)]
        swim = replace(swim, pose=(*moved, *swim.pose[len(moved) :]))
    measured, inputs = (
        {name: changed(name, values) for name, values in series.items()}
        for series in (trial.measured, trial.inputs)
    )
    # Discard the initial velocities, which were estimated from the uncorrected channels.
    starts = {n: v for n, v in trial.starts.items() if not n.startswith("initial_")}
    return replace(trial, measured=measured, inputs=inputs, swim=swim, starts=starts)


def _driven(factor: float, trial: Trial) -> Trial | None:
    """Return a copy of the trial with the amplitude of its beat multiplied by a factor.

    Return None if the trial has no beat.
    """
    beat = trial.swim.beat
    if beat is None or not beat.amplitude_rad:
        return None
    beat = replace(beat, amplitude_rad=factor * beat.amplitude_rad)
    return replace(trial, swim=replace(trial.swim, beat=beat))


def _joint(factor: float, numbers: Sequence[int], trial: Trial) -> Trial | None:
    """Return a copy of the trial with the logged motions of some joints multiplied by a factor.

    Return None if the trial has no joint motions from a log.
    """
    if trial.swim.joints is None:
        return None
    joints = list(trial.swim.joints)
    for k in (k for k in numbers if k < len(joints)):
        joints[k] = partial(_scaled, joints[k], factor)
    return replace(trial, swim=replace(trial.swim, joints=joints))


def _reversed(name: str, trial: Trial) -> Trial | None:
    """Return a copy of the trial with the sign of one input changed; None if it has no such input."""
    inputs, given = dict(trial.inputs), dict(trial.swim.inputs)
    if name in given:
        given[name] = partial(_negative, given[name])
    elif name in inputs:
        inputs[name] = -inputs[name]
    else:
        return None
    return replace(trial, inputs=inputs, swim=replace(trial.swim, inputs=given))


def _negative(value: Callable[[Array], Array], time_s: Array) -> Array:
    """Return the value of an input at given times with its sign changed."""
    return -value(time_s)


def _scaled(motion: Callable[[Array], Motion], factor: float, time_s: Array) -> Motion:
    """Return angle, rate and acceleration of a joint at given times, multiplied by a factor."""
    angle, rate, bend = motion(time_s)
    return factor * angle, factor * rate, factor * bend


def _steady(trial: Trial) -> Trial | None:
    """Return a copy of the trial that starts in steady swimming.

    Return None if the trial already starts so, or if it has no drive.
    """
    if trial.swim.drive is None or trial.swim.steady:
        return None
    return replace(trial, swim=trial.swim.begun())


# ------------------------------------------------------------ search


def misfits(trial: Trial, simulated: Mapping[str, Array]) -> dict[str, Misfit]:
    """Compute the errors of the measured channels of a trial, with positions in the trial's own axes."""
    measured, simulated = fit_common.own_axes(trial.measured, simulated)
    known = [name for name in measured if name in simulated]
    scores = {name: fit_common.score(measured[name], simulated[name]) for name in known}
    ranges = {
        name: float(np.ptp(y[np.isfinite(y)])) for name in known if np.isfinite(y := measured[name]).any()
    }
    place = [name for name in ("x_m", "y_m") if name in ranges]
    found = {}
    for name in (n for n in ranges if math.isfinite(scores[n].nrmse)):
        group: Sequence[str] = place
        if name not in place:
            group = [name]
        error = math.hypot(*(scores[n].rmse for n in group)) / math.hypot(*(ranges[n] for n in group))
        residual = measured[name] - simulated[name]
        found[name] = Misfit(max(scores[name].nrmse, 1e-9), max(error, 1e-9), _independent(residual))
    return found


def _independent(residual: Array) -> float:
    """Return the number of independent samples in a series of coloured residuals.

    It is ``n / (1 + 2 sum rho_k^2)`` for n samples with the autocorrelation rho_k at lag k.

    This is Bartlett's formula for the variance of a sample variance. Lags up to a quarter of the record are
    used.
    """
    count = int(np.isfinite(residual).sum())
    if count < 8 or not np.nanvar(residual) > 0.0:
        return float(count)
    rho = autocorrelation(residual, max_lag=count // 4).values
    # Subtract the sum of squared correlations that white noise has on average: their number divided by n.
    excess = float(np.nansum(rho[1:] ** 2)) - (len(rho) - 1) / count
    return count / (1.0 + 2.0 * max(excess, 0.0))


def gain(before: Errors, after: Errors) -> float:
    """Return twice the logarithm of the likelihood ratio by which a correction improves a trial.

    The likelihoods are computed from the errors before and after the correction, and from the number of
    independent samples.
    """
    pairs = [(before[name], after[name]) for name in after if name in before]
    return float(sum(2.0 * late.independent * math.log(old.relative / late.relative) for old, late in pairs))


def screened(
    trials: Sequence[Trial], mistakes: Sequence[Mistake], before: Mapping[str, Errors], evaluate: Evaluate
) -> list[tuple[Mistake, dict[str, tuple[Trial, Errors, float]]]]:
    """Undo each recording mistake in each trial, and compute the errors of the corrected trials.

    Returns
    -------
    list of (Mistake, dict of trial id to (Trial, Errors, gain))
        Mistakes with the corrected trials, sorted by the sum of the gains of the trials in which the error
        falls.
    """
    found = []
    for mistake in mistakes:
        each: dict[str, tuple[Trial, Errors, float]] = {}
        for trial in trials:
            changed = mistake.undo(trial)
            if changed is None or trial.id not in before:
                continue
            # Give the corrected trial an id of its own, because models cache simulations by the id of the
            # trial.
            changed = replace(changed, id=f"{trial.id} ({mistake.says})")
            try:
                # Ignore a correction with which the trial cannot be simulated.
                with recorded():
                    after = evaluate(changed)
            except (NoTrustworthyResult, np.linalg.LinAlgError):
                continue
            if after:
                each[trial.id] = (changed, after, gain(before[trial.id], after))
        if each:
            found.append((mistake, each))
    return sorted(found, key=lambda pair: -sum(max(g, 0.0) for _, _, g in pair[1].values()))


def explained(
    says: str,
    trials: Sequence[str],
    count: int,
    tried: int,
    before: Mapping[str, Errors],
    after: Mapping[str, Errors],
) -> Explanation | None:
    """Return the mistake as an explanation if its correction lowers the errors enough; None otherwise.

    The evidence must be decisive, and the errors must fall to those of a good model.

    Parameters
    ----------
    trials : sequence of str
        Trials in which the mistake was undone.
    count, tried : int
        Number of all trials, and number of alternatives that were tested.
    before, after : mapping of trial id to Errors
        Errors of all corrected trials, before and after the correction.
    """
    total = sum(gain(before[k], after[k]) for k in after) - 2.0 * math.log(max(tried, 1))
    if not trials or total < DECISIVE or any(m.nrmse > GOOD for k in trials for m in after[k].values()):
        return None
    falls = {}
    for name in (n for n in after[trials[0]] if n in before[trials[0]]):
        squares = [[m[k][name].nrmse ** 2 for k in trials if name in m[k]] for m in (before, after)]
        first, last = (math.sqrt(np.mean(of_trials)) for of_trials in squares)
        falls[name] = first, last
    channel = max(falls, key=lambda name: falls[name][0] - falls[name][1])
    everywhere = len(trials) == count and count > 1
    return Explanation(says, tuple(trials), everywhere, channel, *falls[channel], total)


def check(found: Explanation | None, count: int) -> ev.Check:
    """Return a check with the result of the search for recording mistakes.

    The argument ``count`` is the number of mistakes that were tested.
    """
    if found is None:
        return ev.check("usual mistakes", f"none of {count} found", None)
    text = f"{found.sentence} Check how these data were recorded; nothing was changed"
    reason = f"a usual mistake explains the error: {found.says}"
    return ev.check("usual mistakes", found.says, False, "none", text, otherwise="fail", reason=reason)


def is_suspect(checks: Iterable[ev.Check], errors: Mapping[str, Errors]) -> bool:
    """Return whether to search for recording mistakes.

    A search is worth while if a check fails, or if the error of a trial exceeds ``USABLE``.
    """
    return any(c.verdict == "fail" for c in checks) or any(
        m.nrmse > USABLE for trial in errors.values() for m in trial.values()
    )
