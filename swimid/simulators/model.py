"""Model of a simulator of the user: parameters, inputs and outputs are those of a trials file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.files.provenance import Input
from swimid.fitting.fit_common import TRIALS_FILE, Experiment, read_trial_log
from swimid.fitting.model import POSITIONS, Array, Channel, Model, Parameter, Trial
from swimid.logs import log as log_format
from swimid.logs.experiments import Trials
from swimid.logs.log import longest_run
from swimid.notices import warn
from swimid.results.numbers import split_unit
from swimid.robots.file import Robot

#: Maximum number of successive missing samples of an input. Gaps up to this length are filled by a straight
#: line.
MAX_INPUT_GAP = 4
#: Channels of a pose in the horizontal plane.
PLANE = ("x_m", "y_m", "yaw_rad")
#: Scale of a parameter whose start value is zero, as a fraction of the range of its bounds.
SCALE = 0.1


class SimulatorParameter(yamlio.Document):
    """Parameter of a simulator in a trials file."""

    #: Lower and upper bound.
    bounds: tuple[float, float] | None = None
    #: Start value of a fit; by default that of the simulator, or the middle of the bounds.
    start: float | None = None
    unit: str = ""
    #: Typical size of the parameter. By default it is the start value, or a tenth of the range of the bounds.
    scale: Annotated[float, Field(gt=0)] | None = None
    #: Whether each trial has a value of its own.
    per_trial: bool = False
    #: Whether the parameter keeps its start value.
    fixed: bool = False
    meaning: str = ""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"the bounds {list(self.bounds)} are not in increasing order")
        if self.bounds and self.start is not None and not self.bounds[0] <= self.start <= self.bounds[1]:
            raise ValueError(f"the start {self.start:g} lies outside the bounds {list(self.bounds)}")
        return self

    def to_parameter(
        self, name: str, *, start: float | None = None, unit: str = "1", source: str = ""
    ) -> Parameter:
        """Return the parameter of a model.

        Parameters
        ----------
        start, unit : float, str
                Value and unit that the simulator states. A value or unit in the trials file has precedence.

        Raises
        ------
        ValueError
            If no start value is known, or the value that the simulator states lies outside the bounds.
        """
        lower, upper = self.bounds or (-math.inf, math.inf)
        begin = self.start if self.start is not None else start
        if begin is None:
            if not math.isfinite(upper - lower):
                raise ValueError(f"the parameter '{name}' needs a start or bounds")
            begin = 0.5 * (lower + upper)
        if not lower <= begin <= upper:
            raise ValueError(f"the model states {begin:g} for '{name}', outside the bounds {[lower, upper]}")
        width = SCALE * (upper - lower) if math.isfinite(upper - lower) else 1.0
        scale = self.scale or abs(begin) or width
        return Parameter(
            name, self.unit or unit, lower, upper, begin, scale,
            free=not self.fixed, per_trial=self.per_trial, meaning=self.meaning, source=source,
        )  # fmt: skip


class SimulatorModel(Model):
    """Model of a simulator whose inputs are columns of a log.

    Attributes
    ----------
    columns : tuple of str
        Columns of the log that are the inputs, in the order of the simulator.
    """

    offers = frozenset({"output", "clock", "command"})
    columns: tuple[str, ...] = ()

    def __init__(
        self, parameters: Sequence[Parameter], columns: Sequence[str], outputs: Sequence[str]
    ) -> None:
        self.parameters, self.columns = tuple(parameters), tuple(columns)
        self.channels = tuple(
            Channel(name, split_unit(name)[1] or "1", split_unit(name)[0]) for name in outputs
        )

    @property
    def planar_pose(self) -> tuple[str, ...]:
        """Channels of two positions and the heading; empty if the simulator lacks one of them."""
        names = {channel.name for channel in self.channels}
        return PLANE if names.issuperset(PLANE) else ()

    @property
    def axes(self) -> tuple[str, ...]:
        """World axes along which a position is simulated."""
        names = {channel.name for channel in self.channels}
        return tuple(name[0] for name in POSITIONS if name in names) or ("x",)

    def is_commanded(self, trial: Trial) -> bool:
        """Return whether the simulator has inputs, which are the commands of the trial."""
        return bool(self.columns)

    def commands(self, trial: Trial) -> Iterator[tuple[Array, Array, float]]:
        """Yield time (s), values and largest rate (1/s) of each input."""
        for name in self.columns:
            values = trial.inputs[name]
            rates = np.abs(np.diff(values) / np.diff(trial.time_s))
            yield trial.time_s, values, float(np.max(rates, initial=0.0))

    def beats(self, trials: Sequence[Trial]) -> list[float]:
        """Return the strongest frequency of the inputs of each trial, Hz."""
        found = []
        for trial in trials:
            frequencies = [_strongest(time, values) for time, values, _ in self.commands(trial)]
            found += [frequency for frequency in frequencies[:1] if frequency > 0]
        return found

    def origin(self, trial: Trial) -> dict[str, float]:
        """Return the first measured position of a trial, by channel."""
        found = {}
        for name in POSITIONS:
            known = trial.measured.get(name)
            if known is not None and np.isfinite(known).any():
                found[name] = float(known[np.isfinite(known)][0])
        return found


def _strongest(time_s: Array, values: Array) -> float:
    """Return the strongest frequency of a signal, Hz; 0 if it is constant."""
    if len(values) < 8 or not np.ptp(values) > 0:
        return 0.0
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    signal = np.interp(even, time_s, values)
    spectrum = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(signal))))
    return float(np.argmax(spectrum) / (even[-1] - even[0]))


class SimulatorTrials(Trials):
    """Trials of a simulator of the user. A derived class has the key ``model``, and builds this model."""

    robot_form = ""
    commands = ("fit", "fit-graybox")
    robot: str = ""
    trials: Any

    def read_robot(self, folder: Path) -> Robot:
        """Return a robot that has a name only. By default the name is that of the simulator."""
        return Robot(format="swimid-robot/1", name=self.robot or self.simulator_name())

    def simulator_name(self) -> str:
        """Return the name of the simulator."""
        raise NotImplementedError

    def read_trials(
        self, path: Path, inputs: Sequence[str], outputs: Sequence[str]
    ) -> tuple[list[Trial], Sequence[Input]]:
        """Read the inputs of the simulator from the logs, and those of its outputs that a log has.

        Raises
        ------
        InputError
            If a log has none of the outputs, lacks an input, or an input is missing for many samples.
        """
        trials, sources = [], []
        for entry in self.trials:
            log = read_trial_log(entry, path.parent, required=tuple(inputs), optional=tuple(outputs))
            sources.append(log.source)
            measured = {name: log[name] for name in outputs if name in log}
            if not measured:
                hint = f"outputs: {', '.join(outputs)}; the log has: {', '.join(log.columns)}"
                raise InputError("has no column of an output of the model", file=log.path, hint=hint)
            given = {name: _fill_gaps(log, name) for name in inputs}
            trials.append(Trial(entry.id, entry.role, log.time_s, measured, given))
        return trials, sources

    def error_at(self, path: Path, keys: Sequence[str], text: object, hint: str | None = None) -> InputError:
        """Return the error for a key of the trials file, with file and line."""
        line = None if self._data is None else yamlio.line_of(self._data, list(keys))
        return InputError(str(text), file=path, line=line, column=".".join(keys), hint=hint)

    def make_experiment(
        self, path: Path, model: SimulatorModel, trials: list[Trial], sources: Sequence[Input]
    ) -> Experiment:
        """Return the experiment of the model with its trials."""
        inputs = list(sources) if self._in_memory else [path, *sources]
        robot = self.read_robot(path.parent)
        return Experiment(self.experiment, robot, model, trials, inputs, values_from=TRIALS_FILE)


def _fill_gaps(log: log_format.Log, name: str) -> Array:
    """Return an input of a log, with short gaps filled by a line."""
    values = log[name]
    missing = np.isnan(values)
    if not missing.any():
        return values
    if longest_run(missing) > MAX_INPUT_GAP:
        first = int(np.flatnonzero(missing)[0])
        text = f"the input lacks more than {MAX_INPUT_GAP} samples: cut the log with start_s and end_s"
        raise InputError(text, file=log.path, line=log.line(first), column=name)
    warn("SWM058", f"{log.path.name}: {int(missing.sum())} missing samples of {name} are interpolated")
    return np.interp(log.time_s, log.time_s[~missing], values[~missing])
