"""A model together with its trials, as read from a trials file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.files.provenance import Input
from swimid.fitting.model import POSITIONS, Array, Model, Trial
from swimid.logs import log as log_format
from swimid.logs.log import Log
from swimid.logs.sampling import LONG_HOLD, find_frozen, find_held
from swimid.logs.trials import Trial as TrialEntry
from swimid.logs.trials import Trials
from swimid.notices import warn
from swimid.robots.file import Robot, locate

#: Angles that a camera may measure in addition to a position.
ANGLES = ("yaw_rad", "pitch_rad", "roll_rad")


@dataclass(frozen=True)
class Experiment:
    """A model with the trials from which its parameters are estimated."""

    #: Value of ``experiment`` in the trials file.
    name: str
    robot: Robot
    model: Model
    trials: list[Trial]
    #: All inputs for the provenance: the trials file, the robot file, the logs, and data in memory.
    inputs: list[Input]
    #: Alternative interpretations of the same logs by name (for example, how an encoder rounds). The fit
    #: selects the one with the smallest residuals. Empty if there is only one interpretation.
    variants: Mapping[str, list[Trial]] = field(default_factory=dict)
    #: Facts for the report that were found while the logs were read.
    facts: Mapping[str, Any] = field(default_factory=dict)
    #: Path of the robot file; None if the result does not refer to it.
    robot_path: Path | None = None


def inputs_of(path: Path, entries: Trials, logs: Sequence[Input]) -> list[Input]:
    """Return the trials file, the robot file and the logs for the provenance."""
    files = [locate(entries.robot, path.parent), *logs]
    return files if entries._in_memory else [path, *files]


def read_log(
    entry: TrialEntry, folder: Path, *, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> Log:
    """Read the log of a trial, cut it to the interval of its entry, and blank repeated positions."""
    if entry._held is not None:
        log = entry._held.chosen(required, optional)
    else:
        log = log_format.read(folder / entry.log, required=required, optional=optional)
    log = _measured_anew(log)
    if entry.start_s is None and entry.end_s is None:
        return log
    low = -np.inf if entry.start_s is None else entry.start_s
    high = np.inf if entry.end_s is None else entry.end_s
    keep = (log.time_s >= low) & (log.time_s <= high)
    if keep.sum() < 2:
        raise InputError(
            f"no samples between start_s {low:g} and end_s {high:g}; the log runs from {log.time_s[0]:g} to "
            f"{log.time_s[-1]:g} s",
            file=log.path,
        )
    return replace(log, columns={k: v[keep] for k, v in log.columns.items()})


def _measured_anew(log: Log) -> Log:
    """Return the log with empty cells where a position only repeats the previous camera picture."""
    places = [name for name in POSITIONS if name in log]
    held = find_held(log.time_s, [log[name] for name in places])
    repeats = held.repeated.copy()
    for first, end in log_format.runs(repeats):
        # keep long repetitions: a camera that stopped is a fault of the recording, which must show in the
        # residuals
        if log.time_s[end - 1] - log.time_s[first] > LONG_HOLD * held.period_s:
            repeats[first:end] = False
    for name, (start, stop) in find_frozen(log.time_s, {name: log[name] for name in places}).items():
        warn("SWM035", f"{log.path.name}: {name} holds one value from {start:.4g} to {stop:.4g} s")
    at = np.flatnonzero(repeats)
    if not len(at):
        return log

    def repeated(values: Array) -> bool:
        return bool((values[at] == values[at - 1]).all())

    # an angle is repeated if all its values at the repeated positions equal the value before
    shown = [*places, *(n for n in ANGLES if n in log and repeated(log[n]))]
    warn(
        "SWM058",
        f"{log.path.name}: {len(at)} of {len(log)} samples repeat the position before and are left out: the "
        "log is written faster than it is measured",
    )
    masked = {n: np.where(repeats, np.nan, log[n]) for n in shown}
    return replace(log, columns={**log.columns, **masked})


def warn_mass(name: str, value: float, against: float, file: Path) -> None:
    """Warn if a mass is so large that it may be in grams."""
    if against > 0 and value >= against:
        warn(
            "SWM002",
            f"{file.name}: {name} {value:g} kg is not small against the body's {against:g} kg; is it in "
            "grams (a factor of 1000)?",
        )
