"""Describe the settings of trials, find repeats, and divide the data into folds.

A fold consists of the repeats of one setting, of some rows of a table of steady trials, or of a segment of a
trial.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from swimid.fitting.model import Array, Trial
from swimid.kinematics.frequency import find_beat
from swimid.logs.log import FREQUENCY_RTOL


@dataclass(frozen=True, eq=False)
class SettingValue:
    """Quantity that the experimenter set in a trial, for example the beat frequency.

    Attributes
    ----------
    against : float
            Reference for the relative difference of two values, if this reference is larger than the values.
            For a bias it is the amplitude about the bias.
    digits : int
        Number of significant digits in a text.
    """

    value: float
    unit: str
    against: float = 0.0
    digits: int = 3

    def __str__(self) -> str:
        return f"{self.value:.{self.digits}g} {self.unit}"

    def __eq__(self, other: object) -> bool:
        """Return whether two values are equal to within the tolerance of beat frequencies."""
        if not isinstance(other, SettingValue):
            return False
        size = max(abs(self.value), abs(other.value), self.against, other.against)
        return abs(self.value - other.value) <= FREQUENCY_RTOL * size


def list_settings(trial: Trial) -> dict[str, SettingValue | str]:
    """Return the settings of a trial by name.

    For joints that follow a log, the settings are those of the beat found in their motion.
    """
    found: dict[str, SettingValue | str] = {}
    swim = trial.swim
    if swim.beat is not None:
        found |= _list_beat(swim.beat.frequency_hz, swim.beat.amplitude_rad, swim.beat.bias_rad)
    elif swim.stroke is not None:
        found |= {
            "stroke": swim.stroke.name,
            "frequency": SettingValue(swim.stroke.frequency_hz, "Hz"),
            "scale": SettingValue(swim.stroke.scale, "times"),
        }
    elif swim.joints is not None:
        found |= _list_logged(trial)
    frequency_hz, amplitude_rad = _steady(trial)
    if not math.isnan(frequency_hz):
        found["frequency"] = SettingValue(frequency_hz, "Hz")
    if not math.isnan(amplitude_rad):
        found["amplitude"] = SettingValue(math.degrees(amplitude_rad), "deg")
    if trial.cruise.fin:
        found["fin"] = trial.cruise.fin
    if trial.rig.force is not None:
        found["force"] = SettingValue(trial.rig.force, "N")
    return found


def _list_beat(
    frequency_hz: float, amplitude_rad: float, bias_rad: float, digits: int = 3
) -> dict[str, SettingValue | str]:
    amplitude, bias = math.degrees(amplitude_rad), math.degrees(bias_rad)
    return {
        "frequency": SettingValue(frequency_hz, "Hz", digits=digits),
        "amplitude": SettingValue(amplitude, "deg", digits=digits),
        "bias": SettingValue(bias, "deg", abs(amplitude), digits),
    }


def _list_logged(trial: Trial) -> dict[str, SettingValue | str]:
    """Return frequency, amplitude and bias of the joint that moves most.

    The result is empty if the motion of that joint has no beat.
    """
    angles = [motion(trial.time_s)[0] for motion in trial.swim.joints or ()]
    largest = max(angles, key=lambda angle: float(np.std(angle)), default=np.zeros(0))
    beat = find_beat(trial.time_s, largest)
    if beat is None:
        return {}
    return _list_beat(beat.frequency_hz, beat.amplitude, float(np.mean(largest)), 2)


def _steady(trial: Trial) -> tuple[float, float]:
    """Return frequency (Hz) and amplitude (rad) of a trial with one steady beat; NaN for other trials."""
    frequency_hz, amplitude_rad = trial.steady
    if len(frequency_hz) != 1:
        return math.nan, math.nan
    return float(frequency_hz[0]), float(amplitude_rad[0])


def describe_settings(trial: Trial) -> dict[str, str]:
    """Return the settings of a trial as texts."""
    return {name: str(value) for name, value in list_settings(trial).items()}


def describe_setting(trial: Trial) -> str:
    """Return a text of the settings of a trial. Two trials are repeats if their texts are equal.

    Repeats differ only by random effects and noise.
    """
    swim = trial.swim
    parts = []
    if swim.beat is not None:
        parts.append(repr(swim.beat))
    if trial.cruise.fin:
        parts.append(trial.cruise.fin)
    if swim.stroke is not None:
        own = swim.stroke
        # Leave out the kinematic law of the stroke, because it belongs to the robot and is equal in all
        # trials.
        parts.append(repr((own.name, own.frequency_hz, own.scale, own.ramp_s, own.cycles, own.phase_rad)))
    if swim.joints is not None and swim.commanded:
        # Compare logged commands exactly: a command that was replayed is identical to the last digit.
        parts.append(repr([motion(trial.time_s)[0].tobytes() for motion in swim.joints]))
    known = {**_drop(trial), **dict(zip(("frequency_hz", "amplitude_rad"), _steady(trial), strict=True))}
    parts += [f"{name}={value:.6g}" for name, value in known.items() if not math.isnan(value)]
    if parts and swim.coefficients:
        parts.append(f"coefficients={swim.coefficients}")
    return "; ".join(parts) or trial.id


def count_settings(trials: Sequence[Trial]) -> int:
    """Return the number of different settings among the trials.

    Each trial without known settings counts as one setting. Trials with the same replayed command count once.
    """
    kinds: list[dict[str, SettingValue | str]] = []
    unknown: set[str] = set()
    for trial in trials:
        beat = trial.swim.beat
        own = {**(trial.swim.coefficients or {}), **_drop(trial)}
        mine = {**list_settings(trial), **{name: SettingValue(value, "") for name, value in own.items()}}
        if beat is not None:
            mine |= {"waveform": beat.waveform, "asymmetry": SettingValue(beat.asymmetry, "", 1.0)}
        if not mine:
            unknown.add(describe_setting(trial))
        elif mine not in kinds:
            kinds.append(mine)
    return len(kinds) + len(unknown)


def _drop(trial: Trial) -> dict[str, float]:
    """Return the force, the moving mass and the drag area in a trial of a body that a known force pulls.

    The result is empty for other trials.
    """
    rig = trial.rig
    if rig.force is None:
        return {}
    known = {"force": rig.force, "inertia": rig.inertia, "area": rig.area_factor}
    return {name: value for name, value in known.items() if not math.isnan(value)}


#: Minimum number of settings or trials for cross-validation folds of whole trials. With fewer settings and
#: trials, the folds are segments of trials.
MIN_WHOLE_FOLDS = 4
#: Minimum total number of cross-validation folds if the folds are segments of trials.
MIN_SEGMENT_FOLDS = 8
#: Maximum number of cross-validation folds of a table of steady trials. A table with fewer settings has one
#: fold for each setting.
TABLE_FOLDS = 10


@dataclass(frozen=True)
class Folds:
    """Cross-validation folds: parts of the data that are held out of a fit, one after another.

    Attributes
    ----------
    whole : bool
        True if whole trials are held out; the initial state of a held-out trial is then fitted to this trial.
        False if segments of trials are held out.
    owner : list of ndarray of int
            Fold of each of the n_k rows of each trial, shape (n_k,).
    count : int
        Number of folds.
    """

    whole: bool
    owner: list[Array]
    count: int


def divide_folds(trials: Sequence[Trial], times: Sequence[Array]) -> Folds:
    """Divide trials into cross-validation folds.

    Each fold has whole trials. If there are only a few trials, each fold is a segment of one trial, and all
    segments of a trial have equal duration.

    Parameters
    ----------
    times : sequence of ndarray, shape (n_k,)
        Time of each row of each trial. The rows are the samples of all channels.
    """
    names = [describe_setting(t) for t in trials]
    groups = list(dict.fromkeys(names))
    if len(groups) < MIN_WHOLE_FOLDS <= len(trials):
        names = [t.id for t in trials]
        groups = list(dict.fromkeys(names))
    if len(groups) >= MIN_WHOLE_FOLDS:
        count = len(groups)
        if all(len(t) == 1 for t in times):
            # Assign the rows of a table to the folds in rotation, so that neighbouring rows are in different
            # folds.
            count = min(count, TABLE_FOLDS)
        owner = [np.full(len(t), groups.index(n) % count) for t, n in zip(times, names, strict=True)]
        return Folds(True, owner, count)
    per = -(-MIN_SEGMENT_FOLDS // len(trials))
    owner = []
    for k, time in enumerate(times):
        begin = np.min(time, initial=np.inf)
        span = max(np.max(time, initial=-np.inf) - begin, 1e-12)
        owner.append(per * k + np.minimum(((time - begin) / span * per).astype(int), per - 1))
    return Folds(False, owner, per * len(trials))
