"""Trials of a black-box model; records that ``swimid rwls`` reads on one time grid, fitted and held out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from swimid.blackbox.difference import Record
from swimid.blackbox.model import ArxModel, sine_input
from swimid.errors import InputError, UsageError
from swimid.files.provenance import Input
from swimid.fitting import noise as rt
from swimid.fitting.experiment import Experiment, read_log
from swimid.fitting.model import Trial
from swimid.logs import log as log_format
from swimid.logs import sampling
from swimid.logs import trials as trials_format
from swimid.logs.log import TIME, Log
from swimid.logs.sampling import SAME_RATE, Held, find_held, quantum, step_of, usual_step
from swimid.logs.trials import Arma as ArmaTrials
from swimid.logs.trials import Trial as TrialEntry
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.results import numbers
from swimid.results.parameters import ParameterFile

if TYPE_CHECKING:
    import pandas as pd

Array = np.ndarray
#: Share of the measurements that must last for the same number of samples: a logger slips now and then.
REGULAR_SHARE = 0.9
#: Median change of a signal, in rounding steps, below which rounding alone repeats many samples.
COARSE_STEPS = 5.0


@dataclass(frozen=True)
class _Even:
    """Rows of a column's measurements, their times (s), and the time between them."""

    rows: Array
    times_s: Array
    period_s: float


def at_own_rate(log: Log, source: str | None, output: str) -> tuple[Log, list[str]]:
    """Return a log at the rate at which its input and output are measured.

    With it comes a sentence for each column that repeated its samples.

    A discrete-time model of a log in which each measurement is written several times describes the logger:
    its poles are wrong. Cells that are filled in every n-th row only are brought to their own rate, too. An
    input of a few levels, or of independent levels, is a command that is constant by design, and stays.

    Parameters
    ----------
    log : Log
        Columns ``source`` (None for a computed input) and ``output``.

    Notes
    -----
    The slower of two columns sets the rate. The output keeps the first sample of each measurement. The input
    of each row is its mean until the next row, which is the input of a zero-order hold. Where measurements
    come at no even rate, the repeated samples are emptied instead.
    """
    repeats, slowest, emptied = [], None, {}
    for column in (output, source):
        if column is None:
            continue
        values = log[column]
        held = find_held(log.time_s, [values])
        empty = np.isnan(values)
        # independent values between the repeats are the levels of a random staircase
        if column == source and rt.ljung_box(values[~held.repeated & ~empty]).passed:
            continue
        even = _even_times(log.time_s, values, held)
        if even is None and (column == source or not _is_lossy(values[~empty], held.repeated[~empty])):
            continue
        what = "repeat the measurement before" if held.repeated.any() else "are empty"
        text = f"{int(np.sum(held.repeated | empty))} of {len(log)} samples of {column} {what}"
        if even is None:
            emptied[column] = np.where(held.repeated, np.nan, values)
            text += f" at no even rate: they are left out, and the others may be {held.lateness_s:.6g} s late"
        else:
            text += f": it is measured every {even.period_s:.6g} s, and the model is fitted at that rate"
            if slowest is None or even.period_s > (1 + SAME_RATE) * slowest[1].period_s:
                slowest = (column, even)
        warn("SWM058", f"{log.path.name}: {text}; log each measurement once, with its own time")
        repeats.append(text)
    if emptied:
        log = replace(log, columns={**log.columns, **emptied})
    if slowest is not None:
        log = _resampled(log, slowest[1], source, slowest[0] == source)
    return log, repeats


def _even_times(time_s: Array, values: Array, held: Held) -> _Even | None:
    """Return the measurements of a column that come at an even rate below that of the log; else None."""
    flags = held.repeated | np.isnan(values)
    rows = np.flatnonzero(~flags)
    lasts = np.diff(rows)
    if not (lasts > 1).any():
        return None
    factor = int(np.median(lasts[lasts > 1]))
    # a rest repeats itself without a repeated measurement: it counts neither for nor against the factor
    shown = lasts[(lasts > 1) | (values[rows[1:]] != values[rows[1:] - 1])]
    if np.mean(shown == factor) >= REGULAR_SHARE:
        kept = _every(rows, lasts, factor)
        times = time_s[kept]
        return _Even(kept, times, usual_step(times))
    if held.even:
        times = held.measured_s[rows]
        return _Even(rows, times + float(np.min(time_s[rows] - times)), held.period_s)
    return None


def _every(rows: Array, lasts: Array, factor: int) -> Array:
    """Return the rows to keep: of a rest, too, only every ``factor``-th one."""
    kept: list[int] = []
    for row, length in zip(rows.tolist(), [*lasts.tolist(), 1], strict=True):
        if length > 1 or not kept or row - kept[-1] >= factor:
            kept.append(row)
    return np.array(kept)


def _resampled(log: Log, even: _Even, source: str | None, by_source: bool) -> Log:
    """Return the log at the times of the measurements of its output, or of its input (``by_source``)."""
    columns = {}
    for name, values in log.columns.items():
        if name == source and not by_source:
            columns[name] = _means(log.time_s, values, even.times_s)
        elif by_source and name != source:
            columns[name] = np.interp(even.times_s, log.time_s, values)
        else:
            columns[name] = values[even.rows]
    return replace(log, columns={**columns, TIME: even.times_s})


def _means(time_s: Array, values: Array, times: Array) -> Array:
    """Return the means of a held signal from each time to the next; NaN where a sample is missing."""
    steps, missing = np.diff(time_s), np.isnan(values)
    held = np.column_stack([np.where(missing, 0.0, values), missing])
    total = np.vstack([[0.0, 0.0], np.cumsum(held[:-1] * steps[:, None], axis=0)])
    ends = np.append(times, 2 * times[-1] - times[-2])
    row = np.clip(np.searchsorted(time_s, ends + 1e-6 * steps.min(), side="right") - 1, 0, None)
    integral = total[row] + held[row] * (ends - time_s[row])[:, None]
    mean, empty = (np.diff(integral, axis=0) / np.diff(ends)[:, None]).T
    return np.where(empty > 1e-3, np.nan, mean)


def _is_lossy(values: Array, repeated: Array) -> bool:
    """Return whether a signal repeats samples at no even rate, and moves by more than its rounding."""
    changes = np.abs(np.diff(values[~repeated]))
    return bool(repeated.any() and np.median(changes) >= COARSE_STEPS * (step_of(values) or quantum(values)))


#: The keys of a trials file that are used, by experiment.
USES = {"arma": trials_format.EVERYWHERE | {"input", "output"}}


def model_of(file: ParameterFile, path: Path) -> ArxModel:
    """The model a parameter file holds.

    Raises
    ------
    InputError
        With the file's name, when it lacks delay, sample time or coefficients.
    """
    try:
        return ArxModel.from_file(file)
    except InputError as error:
        raise InputError(error.reason, file=path, column=error.column, hint=error.hint) from error


def load(source: str | Path | TrialSet, file: ParameterFile, parameters_path: Path) -> Experiment:
    """Read trials of the experiment ``arma`` for the model of a parameter file.

    Input and output are the columns the model was fitted with; a trials file that names others is refused.

    Raises
    ------
    InputError
        For anything wrong in the trials file, the parameter file or a log.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, ArmaTrials, uses=USES)
    robot = trials_format.robot_of(entries, path)
    model = model_of(file, parameters_path)
    for key, mine in (("input", None if model.sine else model.source), ("output", model.output)):
        named = getattr(entries, key)
        if mine is not None and named is not None and named != mine:
            words = f"these trials name the {key} '{named}', the parameters are of '{mine}'"
            raise InputError(words, file=path, column=key)
    read = () if model.sine else (model.source,)
    inputs: list[Input] = [] if entries._in_memory else [path]
    trials = []
    for entry in entries.trials:
        log = read_log(entry, path.parent, required=(*read, model.output))
        log, _ = at_own_rate(log, None if model.sine else model.source, model.output)
        inputs.append(log.source)
        measured, given = {model.output: log[model.output]}, {name: log[name] for name in read}
        trials.append(Trial(entry.id, entry.role, log.time_s, measured, given))
    return Experiment("arma", robot, model, trials, inputs)


# ------------------------------------------------------------ records for rwls


@dataclass(frozen=True)
class Columns:
    """Where input and output come from."""

    source: str
    output: str
    sine: tuple[float, float, float] | None

    @property
    def units(self) -> tuple[str, str]:
        """Units of input and output by their names' endings, ``"1"`` where there is none."""
        pair = (numbers.split_unit(name)[1] or "1" for name in (self.source, self.output))
        return next(pair), next(pair)

    @property
    def gain_unit(self) -> str:
        """Unit of b: output over input."""
        u, y = self.units
        if u == "1":
            return y
        if u == y:
            return "1"
        return "/".join(f"({unit})" if "/" in unit or " " in unit else unit for unit in (y, u))


@dataclass(frozen=True)
class _Part:
    """A stretch of a log, as a trials file lists it; a log given by itself is one whole stretch.

    ``folder`` is the one that ``entry.log`` is relative to, ``listing`` the trials file.
    """

    entry: TrialEntry
    folder: Path
    listing: Path | None = None

    @property
    def path(self) -> Path:
        return self.folder / self.entry.log

    @property
    def origin(self) -> Input:
        """What stands for it in the provenance."""
        held = self.entry._held
        return self.path if held is None else held.source


@dataclass(frozen=True)
class Data:
    """The logs on their grids; ``repeats`` has a sentence for each column that repeated its samples."""

    columns: Columns
    sample_time_s: float
    fit: list[Record]
    held_out: dict[str, list[Record]]
    logs: list[str]
    files: list[Input]
    robot: str | None
    repeats: list[str]


#: A log: its file, or its samples in memory; or trials of the experiment ``arma``.
Source = Any


def read(
    logs: Sequence[Source],
    validate: Sequence[Source | float],
    input_column: str | None,
    output_column: str | None,
    input_model: str | None,
) -> Data:
    """Read logs and trials files of the experiment ``arma``, and hold parts of them out.

    Parameters
    ----------
    logs : sequence of paths, Log, DataFrame or TrialSet
    validate : sequence
        At most one share of every log, and any number of further logs.
    input_column, output_column, input_model : str or None
        See :func:`swimid.blackbox.rwls.rwls`.

    Raises
    ------
    UsageError
        When the options contradict each other.
    InputError
        When a file cannot be used: unreadable, columns missing, no constant rate.
    """
    share, other = _held_out(validate)
    parts: list[_Part] = []
    listings: dict[Path, ArmaTrials] = {}
    for source in logs:
        named = isinstance(source, str | Path) and Path(source).suffix.lower() in (".yaml", ".yml")
        if named or isinstance(source, TrialSet):
            path = trials_format.place(source)
            listings[path] = listed = trials_format.read(source, ArmaTrials, uses=USES)
            parts += [_Part(trial, path.parent, path) for trial in listed.trials]
        else:
            parts.append(_alone(source, "fit", f"table {len(parts) + 1}"))
    parts += [_alone(source, "validate", f"held-out table {k}") for k, source in enumerate(other, start=1)]
    robot = _agreed(listings, "robot")
    columns = _columns(
        input_column or _agreed(listings, "input"), output_column or _agreed(listings, "output"), input_model
    )
    if all(part.entry.role == "validate" for part in parts):
        raise UsageError("every trial is a validation trial; at least one must be fitted")
    _check_apart(parts)
    names = _names(parts)
    required = (columns.output,) if columns.sine else (columns.source, columns.output)
    read: dict[str, log_format.Log] = {}
    repeats: list[str] = []
    for name, part in zip(names, parts, strict=True):
        log = read_log(part.entry, part.folder, required=required)
        _check_distinct(log, columns)
        read[name], found = at_own_rate(log, None if columns.sine else columns.source, columns.output)
        repeats += found
    step = _sample_time(read)
    fitted = [name for name, part in zip(names, parts, strict=True) if part.entry.role == "fit"]
    fit: list[Record] = []
    held: dict[str, list[Record]] = {}
    for name, part in zip(names, parts, strict=True):
        log = read[name]
        if part.entry.role == "validate":
            held[name] = _records(log, name, columns, step, slice(None))
            continue
        cut = len(log) - round(share * len(log))
        fit += _records(log, name, columns, step, slice(0, cut))
        if share:
            label = "held-out part" if len(fitted) == 1 else f"held-out part of {name}"
            held[label] = _records(log, name, columns, step, slice(cut, None))
    files: list[Input] = [path for path, listed in listings.items() if not listed._in_memory]
    files += [part.origin for part in parts]
    return Data(columns, step, fit, held, fitted, files, robot, repeats)


def _alone(
    source: str | Path | log_format.Log | pd.DataFrame, role: Literal["fit", "validate"], name: str
) -> _Part:
    """A log that no trials file lists; a bare table has the name given."""
    held = None
    if not isinstance(source, str | Path):
        held = source if isinstance(source, log_format.Log) else log_format.Log.from_frame(source, name=name)
    path = held.path if held is not None else Path(cast(str | Path, source))
    part = _Part(TrialEntry(id=path.name, log=path.name, role=role), path.parent)
    part.entry._held = held
    return part


def _agreed(listings: dict[Path, ArmaTrials], key: str) -> str | None:
    """What the trials files say of a key, which must be the same in all that have it."""
    stated = [(path, getattr(listed, key)) for path, listed in listings.items()]
    stated = [(path, value) for path, value in stated if value is not None]
    for path, value in stated:
        if value != stated[0][1]:
            contradiction = f"'{value}' contradicts '{stated[0][1]}' of {stated[0][0].name}"
            raise InputError(contradiction, file=path, column=key)
    return stated[0][1] if stated else None


def _check_apart(parts: list[_Part]) -> None:
    """Hold against each other what the command line and several trials files say of one log."""
    for one, other in itertools.combinations(parts, 2):
        # those of one trials file are apart already
        listed = one.listing is not None and one.listing == other.listing
        if not listed and trials_format.same_recording(one.entry, one.path, other.entry, other.path):
            trials_format.check_apart(one.entry, other.entry, one.path)


def _names(parts: list[_Part]) -> list[str]:
    """A name for each: its id, or with the log's path where that is not the only one."""
    ids = [part.entry.id for part in parts]
    names = [i if ids.count(i) == 1 else f"{part.path}" for i, part in zip(ids, parts, strict=True)]
    return [n if names.count(n) == 1 else f"{n} ({k + 1})" for k, n in enumerate(names)]


def _held_out(validate: Sequence[Source | float]) -> tuple[float, list[Source]]:
    """Return the share to hold out, 0 if none, and the logs to hold out."""
    shares: list[float] = []
    logs: list[Source] = []
    for item in validate:
        try:
            shares.append(float(item))
        except (TypeError, ValueError):
            logs.append(item)
    if len(shares) > 1:
        raise UsageError("--validate: only one share can be given, besides any number of logs")
    if shares and not 0 < shares[0] < 1:
        hint = "0.25 is the last quarter"
        raise UsageError(f"--validate {shares[0]:g}: a share must lie between 0 and 1", hint=hint)
    return sum(shares), logs


def _columns(source: str | None, output: str | None, model: str | None) -> Columns:
    if output is None:
        raise UsageError("give the output column with --output COLUMN")
    if (model is None) == (source is None):
        raise UsageError(
            "give the input column with --input COLUMN, or compute it with --input-model sine:A,F"
        )
    if source == output:
        raise UsageError(f"input and output are the same column '{source}'")
    return Columns(source or "F_u", output, None if model is None else _sine(model))


def _sine(text: str) -> tuple[float, float, float]:
    kind, _, rest = text.partition(":")
    try:
        values = [float(part) for part in rest.split(",")]
    except ValueError:
        values = []
    if kind != "sine" or len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        hint = "for example sine:30,1.2"
        raise UsageError(f"--input-model '{text}' is not sine:A,F or sine:A,F,PHASE", hint=hint)
    if values[0] == 0 or values[1] <= 0:
        raise UsageError(f"--input-model '{text}': amplitude must not be 0 and frequency must be above 0 Hz")
    return values[0], values[1], values[2] if len(values) == 3 else 0.0


def _check_distinct(log: log_format.Log, columns: Columns) -> None:
    """Refuse an output that is the input under another name (an output that moves, that is)."""
    if columns.sine:
        return
    u, y = log[columns.source], log[columns.output]
    both = np.isfinite(u) & np.isfinite(y)
    if np.any(both) and np.ptp(y[both]) > 0 and np.array_equal(u[both], y[both]):
        text = f"holds the same values as the input column '{columns.source}' in every row"
        hint = "one of the two is a copy: name the measured output with --output"
        raise InputError(text, file=log.path, column=columns.output, hint=hint)


def _sample_time(logs: dict[str, log_format.Log]) -> float:
    """Return the common sample time of all logs, s."""
    steps: list[float] = []
    for name, log in logs.items():
        rate = sampling.rate(log.time_s)
        steps.append(rate.step_s)
        text = ""
        if not rate.uniform:
            text = (
                f"is not sampled at a constant rate: only {100 * rate.on_grid:.0f} % of its steps are whole "
                f"multiples of {rate.step_s:.6g} s"
            )
        elif abs(rate.step_s / steps[0] - 1) > sampling.SAME_RATE:
            text = f"is sampled every {rate.step_s:.6g} s, the first log every {steps[0]:.6g} s"
        if text:
            text += "; a discrete-time model needs one rate"
            hint = "resample the logs to one sample time"
            raise InputError(text, file=log.path, column="t_s", hint=hint)
        if rate.jitter > sampling.NOTABLE_JITTER:
            text = f"time steps scatter by {100 * rate.jitter:.1f} % around {rate.step_s:.6g} s"
            warn("SWM003", f"{name}: {text}; the model takes them as equal")
    return steps[0]


def _records(log: log_format.Log, name: str, columns: Columns, step_s: float, rows: slice) -> list[Record]:
    time = log.time_s[rows]
    result = []
    for piece in sampling.pieces(time, step_s) if len(time) > 1 else []:
        u = sine_input(piece.time_s, *columns.sine) if columns.sine else piece.take(log[columns.source][rows])
        result.append(Record(name, piece.time_s, u, piece.take(log[columns.output][rows])))
    return result
