"""Search for a common recording mistake that explains why a model does not fit a trial.

Examples are a heading of the tail instead of the body, a mirrored axis, a wrong unit and a wrong sign. Such a
mistake makes every fit bad and looks like a missing effect. Each known mistake is undone in turn by a
transformation of the data or of the drive. The fit of the corrected trials is compared with the original fit
(:mod:`swimid.fitting.rivals`). The data stay unchanged: the result is a sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, rivals
from swimid.fitting.drives import Motion
from swimid.fitting.fit_common import GOOD, USABLE
from swimid.fitting.model import Array, Model, Trial
from swimid.fitting.output_error import FitResult, Series
from swimid.notices import record_warnings
from swimid.results import evidence as ev
from swimid.results import numbers

#: Factors between units of length that are often confused in recordings.
UNIT_FACTORS = (10.0, 100.0, 1000.0, 0.1, 0.01, 0.001)
RAD_PER_DEGREE = math.pi / 180.0
#: Factors that undo common mistakes in the amplitude of a drive (AMPLITUDES) and in the motion of all driven
#: joints (JOINTS), by the description of the correction.
AMPLITUDES = {
    "twice the amplitude of the drive": 2.0,
    "half the amplitude of the drive": 0.5,
    "the amplitude of the drive taken as radians": 1.0 / RAD_PER_DEGREE,
    "the amplitude of the drive multiplied by pi/180": RAD_PER_DEGREE,
}
JOINTS = {
    "the signs of all driven joints changed": -1.0,
    "the driven joints taken as degrees": RAD_PER_DEGREE,
    "the driven joints multiplied by 180/pi": 1.0 / RAD_PER_DEGREE,
    "the driven joints multiplied by 2": 2.0,
    "the driven joints multiplied by 0.5": 0.5,
}
#: Maximum number of recording mistakes whose correction is tested by a new fit.
MAX_REFITS = 4
#: Relative tolerance of the cost when initial states are estimated during the search for mistakes.
SCREEN_START_RTOL = 1e-3


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


@dataclass(frozen=True)
class Explanation:
    """Recording mistake that explains the error of a model, with the errors before and after correction.

    Attributes
    ----------
    says : str
        Description of the mistake.
    where : str
        Trials in which the mistake was undone, as text.
    channel : str
        Channel whose error falls most.
    before, after : float
        Error of the channel before and after the correction, divided by its measured range.
    score : float
        Score of the fit to the corrected trials, compared with the original fit.
    """

    says: str
    where: str
    channel: str
    before: float
    after: float
    score: float

    @property
    def sentence(self) -> str:
        """Sentence of the report that describes the correction and the change of the error."""
        return (
            f"With {self.says} in {self.where} the error of {self.channel} falls from "
            f"{numbers.percent(self.before)} to {numbers.percent(self.after)}."
        )


#: Type of changes of channels by description: factor and offset of each channel.
Changes = dict[str, Mapping[str, tuple[float, float]]]
#: Type of a mapping from the id of each trial to its simulated and measured series.
TrialSeries = Mapping[str, Sequence[Series]]


# ------------------------------------------------------------ catalogue


def list_mistakes(model: Model, trials: Sequence[Trial]) -> list[Mistake]:
    """Return all recording mistakes that can occur in the trials of a model."""
    pose, units = fit_common.pose_channels(model), {c.name: c.unit for c in model.channels}
    names = dict.fromkeys(c for t in trials for c in (*t.measured, *t.inputs))
    changes = _list_reflections(pose) | _list_channel_changes(pose, units, [n for n in names if n in units])
    found = [Mistake(says, partial(_change_channels, pose, change)) for says, change in changes.items()]
    found += [Mistake(says, partial(_scale_amplitude, factor)) for says, factor in AMPLITUDES.items()]
    found += _list_joint_mistakes(max((len(t.swim.joints or ()) for t in trials), default=0))
    found += _list_input_mistakes(model, trials, units)
    if model.swimmer is not None and not model.in_space:
        found.append(Mistake("a start in steady swimming (start_state: steady)", _steady))
    return found


def _list_input_mistakes(model: Model, trials: Sequence[Trial], units: Mapping[str, str]) -> list[Mistake]:
    """Return the mistakes of a wrong sign in inputs that are not channels."""
    columns = {}
    if model.swimmer is not None:
        columns = {name: law.column for name, law in model.swimmer.inputs.items()}
    names = dict.fromkeys(n for t in trials for n in (*t.swim.inputs, *t.inputs) if n not in units)
    signs = {name: f"the sign of {columns.get(name, name)} changed" for name in names}
    return [Mistake(says, partial(_reverse_input, name)) for name, says in signs.items()]


def _list_joint_mistakes(count: int) -> list[Mistake]:
    """Return the mistakes of a wrong sign or unit in the logged motions of driven joints."""
    signs = [(f"the sign of driven joint {k + 1} changed", -1.0, [k]) for k in range(count)]
    units = [(says, factor, range(count)) for says, factor in JOINTS.items() if count]
    return [Mistake(says, partial(_joint, factor, joints)) for says, factor, joints in (*signs, *units)]


def _list_reflections(pose: Sequence[str]) -> Changes:
    """Return the changes of the pose channels by a mirrored film, or by a reversed heading."""
    if {"x_m", "y_m", "yaw_rad"} <= set(pose):
        return {
            "yaw + 180 degrees": {"yaw_rad": (1.0, math.pi)},
            "yaw mirrored": {"yaw_rad": (-1.0, 0.0)},
            "y mirrored": {"y_m": (-1.0, 0.0)},
            "the film mirrored": {"y_m": (-1.0, 0.0), "yaw_rad": (-1.0, 0.0)},
        }
    if {"x_m", "z_m", "pitch_rad"} <= set(pose):
        return {"the film mirrored": {"z_m": (-1.0, 0.0), "pitch_rad": (-1.0, 0.0)}}
    return {}


def _list_channel_changes(pose: Sequence[str], units: Mapping[str, str], names: Sequence[str]) -> Changes:
    """Return the changes of channels by a wrong sign or a wrong unit, by their description."""
    changes: Changes = {f"the sign of {n} changed": {n: (-1.0, 0.0)} for n in names if n not in pose}
    for name in (n for n in names if units[n] == "rad"):
        changes[f"{name} taken as degrees"] = {name: (RAD_PER_DEGREE, 0.0)}
        changes[f"{name} multiplied by 180/pi"] = {name: (1.0 / RAD_PER_DEGREE, 0.0)}
    place = [name for name in pose if units[name] == "m"]
    groups = [place, *([name] for name in names if name not in place)]
    for group in (group for group in groups if group and units[group[0]] != "rad"):
        for factor in UNIT_FACTORS:
            says = f"{' and '.join(group)} multiplied by {factor:g}"
            changes[says] = dict.fromkeys(group, (factor, 0.0))
    return changes


def _change_channels(
    pose: Sequence[str], change: Mapping[str, tuple[float, float]], trial: Trial
) -> Trial | None:
    """Return a copy of the trial with channels and initial pose changed to ``factor * value + offset``.

    Return None if the trial has none of these channels.
    """
    if not any(name in trial.measured for name in change):
        return None

    def convert(name: str, values: Any) -> Any:
        factor, offset = change.get(name, (1.0, 0.0))
        return factor * values + offset

    swim = trial.swim
    if swim.pose is not None:
        moved = [convert(name, at) for name, at in zip(pose, swim.pose, strict=False)]
        swim = replace(swim, pose=(*moved, *swim.pose[len(moved) :]))
    measured, inputs = (
        {name: convert(name, values) for name, values in series.items()}
        for series in (trial.measured, trial.inputs)
    )
    # Discard the initial velocities, which were estimated from the uncorrected channels.
    starts = {n: v for n, v in trial.starts.items() if not n.startswith("initial_")}
    return replace(trial, measured=measured, inputs=inputs, swim=swim, starts=starts)


def _scale_amplitude(factor: float, trial: Trial) -> Trial | None:
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
        joints[k] = partial(_scale_motion, joints[k], factor)
    return replace(trial, swim=replace(trial.swim, joints=joints))


def _reverse_input(name: str, trial: Trial) -> Trial | None:
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


def _scale_motion(motion: Callable[[Array], Motion], factor: float, time_s: Array) -> Motion:
    """Return angle, rate and acceleration of a joint at given times, multiplied by a factor."""
    angle, rate, bend = motion(time_s)
    return factor * angle, factor * rate, factor * bend


def _steady(trial: Trial) -> Trial | None:
    """Return a copy of the trial that starts in steady swimming.

    Return None if the trial already starts so, or if it has no drive.
    """
    if trial.swim.drive is None or trial.swim.steady:
        return None
    return replace(trial, swim=trial.swim.make_steady())


# ------------------------------------------------------------ search


def series_of(trial: Trial, simulated: Mapping[str, Array]) -> list[Series]:
    """Pair each measured channel of a trial with its simulation. Skip channels that are not simulated."""
    one = np.ones(len(trial.time_s))
    return [
        Series(trial.id, trial.role, name, trial.time_s, measured, simulated[name], one)
        for name, measured in trial.measured.items()
        if name in simulated
    ]


def compute_trial_errors(series: Sequence[Series]) -> dict[str, float]:
    """Return the errors of the channels of a trial in its own axes, divided by their measured ranges."""
    measured, simulated = fit_common.own_axes(
        {s.channel: s.measured for s in series}, {s.channel: s.simulated for s in series}
    )
    errors = {name: fit_common.compute_score(measured[name], simulated[name]).nrmse for name in measured}
    return {name: error for name, error in errors.items() if math.isfinite(error)}


def search(
    trials: Sequence[Trial],
    known: Sequence[Mistake],
    before: TrialSeries,
    simulate: Callable[[Trial], Iterable[Mapping[str, Array]]],
    refit: Callable[[Sequence[Trial]], FitResult | None] | None = None,
) -> Explanation | None:
    """Return the recording mistake that explains the errors of a model best; None if no mistake does.

    Each mistake is undone in each trial. A trial counts as corrected if there is strong evidence for the
    correction. The mistake is then undone in these trials, or with ``refit`` in all trials that can have it.

    Parameters
    ----------
    before : mapping of trial id to sequence of Series
        Measured and simulated series of the uncorrected trials.
    simulate : callable
        Function that simulates a corrected trial with one or several sets of parameters.
    refit : callable, optional
        Function that fits corrected trials. The most promising corrections are then judged by such a fit.
    """
    screened = []
    for mistake in known:
        each = {t.id: _correct(mistake, t, before, simulate) for t in trials if t.id in before}
        corrected = {name: one for name, one in each.items() if one is not None}
        screened.append((sum(max(gain, 0.0) for _, _, gain in corrected.values()), mistake, corrected))
    screened = sorted(screened, key=lambda one: -one[0])[: None if refit is None else MAX_REFITS]
    explain = partial(_explain, trials=trials, alternatives=len(known) * (len(trials) + 1), before=before)
    found = []
    for _, mistake, corrected in screened:
        gained = tuple(name for name, (_, _, gain) in corrected.items() if gain > rivals.STRONG)
        after = {gained: {name: corrected[name][1] for name in gained}}
        if refit is not None:
            sets = dict.fromkeys((gained, tuple(corrected)) if gained else ())
            after = {ids: _refit_series(refit, trials, corrected, ids) for ids in sets}
        found += [explain(mistake, ids, after=series) for ids, series in after.items() if series]
    return max(filter(None, found), key=lambda one: one.score, default=None)


def _refit_series(
    refit: Callable[[Sequence[Trial]], FitResult | None],
    trials: Sequence[Trial],
    corrected: Mapping[str, tuple[Trial, list[Series], float]],
    ids: Collection[str],
) -> dict[str, list[Series]]:
    """Return the series of a fit with some trials corrected, by trial id; empty if the fit fails."""
    fit = refit([corrected[t.id][0] if t.id in ids else t for t in trials])
    if fit is None:
        return {}
    parts = zip(trials, fit.trials, strict=True)
    return {t.id: [s for s in fit.series if s.trial == changed.id] for t, changed in parts}


def _correct(
    mistake: Mistake,
    trial: Trial,
    before: TrialSeries,
    simulate: Callable[[Trial], Iterable[Mapping[str, Array]]],
) -> tuple[Trial, list[Series], float] | None:
    """Return the corrected trial, its series, and the gain in likelihood; None if it cannot be corrected."""
    changed = mistake.undo(trial)
    if changed is None:
        return None
    # Give the corrected trial an id of its own, because models cache simulations by the id of the trial.
    changed = replace(changed, id=f"{trial.id} ({mistake.says})")
    try:
        # Ignore a correction with which the trial cannot be simulated.
        with record_warnings():
            found = [series_of(changed, simulated) for simulated in simulate(changed)]
    except (NoTrustworthyResult, np.linalg.LinAlgError):
        return None
    gains = [_compute_gain([trial.id], before, {trial.id: series}) for series in found]
    best = int(np.argmax(gains))
    return changed, found[best], gains[best]


def _compute_gain(trials: Iterable[str], before: TrialSeries, after: TrialSeries) -> float:
    """Return the gain (:func:`swimid.fitting.rivals.compute_gain`) by the correction of some trials."""
    known = [s for name in trials for s in before[name]]
    return rivals.compute_gain(known, [replace(s, trial=name) for name in trials for s in after[name]])


def _explain(
    mistake: Mistake,
    corrected: Sequence[str],
    trials: Sequence[Trial],
    alternatives: int,
    before: TrialSeries,
    after: TrialSeries,
) -> Explanation | None:
    """Return the mistake as an explanation if its correction lowers the errors enough; None otherwise.

    The evidence for the correction must be strong. Before the correction, the errors of the corrected trials
    must exceed those of a good model. After the correction no trial may exceed them, because a mistake in one
    trial does not explain why the model fails in all of them.

    Parameters
    ----------
    corrected : sequence of str
        Trials in which the mistake was undone.
    alternatives : int
        Number of corrections that were tested.
    """
    if not corrected:
        return None
    score = _compute_gain(list(after), before, after) - 2.0 * math.log(alternatives)
    final = {name: compute_trial_errors(series) for name, series in {**before, **after}.items()}
    errors = [(compute_trial_errors(before[name]), final[name]) for name in corrected]
    if score <= rivals.STRONG or any(error > GOOD for trial in final.values() for error in trial.values()):
        return None
    if any(max(early.values(), default=0.0) <= GOOD for early, _ in errors):
        return None
    falls = {}
    for channel in errors[0][0].keys() & errors[0][1].keys():
        pairs = [(old[channel], late[channel]) for old, late in errors if channel in old and channel in late]
        falls[channel] = np.sqrt(np.mean(np.square(pairs), axis=0))
    channel = max(sorted(falls), key=lambda name: float(falls[name][0] - falls[name][1]))
    first, last = falls[channel].tolist()
    where = f"trial {', '.join(corrected)}"
    if len(corrected) == len(trials) > 1:
        where = "all trials"
    return Explanation(mistake.says, where, channel, first, last, score)


def check_mistakes(found: Explanation | None, count: int) -> ev.Check:
    """Return a check with the result of the search for recording mistakes.

    The argument ``count`` is the number of mistakes that were tested.
    """
    if found is None:
        return ev.make_check("usual mistakes", f"none of {count} found", None)
    text = f"{found.sentence} Check how these data were recorded; nothing was changed"
    reason = f"a usual mistake explains the error: {found.says}"
    return ev.make_check("usual mistakes", found.says, False, "none", text, otherwise="fail", reason=reason)


def is_suspect(checks: Iterable[ev.Check], before: TrialSeries) -> bool:
    """Return whether to search for recording mistakes.

    A search is worth while if a check fails, or if the error of a trial exceeds ``USABLE``.
    """
    return any(c.verdict == "fail" for c in checks) or any(
        error > USABLE for series in before.values() for error in compute_trial_errors(series).values()
    )
