"""Trials of a black-box model, and the records that ``swimid rwls`` fits or holds out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.blackbox.difference import Record
from swimid.blackbox.model import ArxModel, sine_input
from swimid.blackbox.options import RwlsOptions
from swimid.errors import InputError, UsageError
from swimid.files.provenance import Input
from swimid.fitting import uncertainty as rt
from swimid.fitting.fit_common import Experiment, read_log
from swimid.fitting.model import Trial
from swimid.logs import sampling
from swimid.logs import trials as trials_format
from swimid.logs.log import TIME, Log
from swimid.logs.sampling import SAME_RATE, Held, find_held, quantum, step_of, usual_step
from swimid.logs.trials import Trial as TrialEntry
from swimid.logs.trials import TrialSet
from swimid.notices import warn
from swimid.results import numbers
from swimid.results.parameters import ParameterFile

Array = np.ndarray
#: Minimum fraction of the measurements that are repeated for the same number of samples, for a constant
#: measurement rate.
REGULAR_SHARE = 0.9
#: Minimum median change between measurements, in rounding steps. With smaller changes, rounding alone causes
#: many repeated samples.
MIN_CHANGE = 5.0
#: Maximum fraction of an averaging interval of the input, in time, in which samples are missing.
MAX_MISSING = 1e-3


@dataclass(frozen=True)
class _Even:
    """Evenly spaced measurements of a column: row numbers, times (s), and time between measurements."""

    rows: Array
    times_s: Array
    period_s: float


def at_own_rate(log: Log, source: str | None, output: str) -> tuple[Log, list[str]]:
    """Return a log at the rate of its measurements, and a sentence for each column with repeated samples.

    If a log contains each measurement several times, a discrete-time model fitted to it describes the logger,
    and its poles are wrong. Columns with a value in every n-th row only are also resampled. An input with few
    levels, or with independent levels, is a command that is constant by design. It is not resampled for its
    own sake.

    Parameters
    ----------
    log : Log
    source : str or None
        Name of the input column; None for a computed input.
    output : str
        Output column.

    Notes
    -----
    The output sets the rate. Of each measurement of the output, the first sample is used. The input of a row
    is the mean of the input until the next row, as for a zero-order hold. If the measurements of the output
    have no constant rate, the repeated samples are set to NaN instead. An input with repeated samples is used
    as it is.
    """
    repeats, even, columns = [], None, dict(log.columns)
    for column in (output, source):
        if column is None:
            continue
        values = log[column]
        held, empty = find_held(log.time_s, [values]), np.isnan(values)
        # independent values between the repeated samples are the levels of a random command
        if column == source and rt.ljung_box(values[~held.repeated & ~empty]).passed:
            continue
        own = _even_times(log.time_s, values, held)
        if own is None and (column == source or not _is_lossy(values[~empty], held.repeated[~empty])):
            continue
        what = "repeat the measurement before" if held.repeated.any() else "are empty"
        text = f"{int(np.sum(held.repeated | empty))} of {len(log)} samples of {column} {what}"
        if own is None:
            columns[column] = np.where(held.repeated, np.nan, values)
            text += f" at no even rate: they are left out, and the others may be {held.lateness_s:.6g} s late"
        else:
            text += f": it is measured every {own.period_s:.6g} s"
        if column == output and own is not None:
            even = own
            text += ", and the model is fitted at that rate"
        warn("SWM058", f"{log.path.name}: {text}; log each measurement once, with its own time")
        repeats.append(text)
    if even is not None:
        columns = {name: values[even.rows] for name, values in log.columns.items()}
        columns[TIME] = even.times_s
        if source is not None:
            columns[source] = _means(log.time_s, log[source], even.times_s)
    return replace(log, columns=columns), repeats


def _even_times(time_s: Array, values: Array, held: Held) -> _Even | None:
    """Return a column's measurements if their rate is constant and below the rate of the log; else None."""
    rows = np.flatnonzero(~(held.repeated | np.isnan(values)))
    lasts = np.diff(rows)
    if not (lasts > 1).any():
        return None
    factor = int(np.median(lasts[lasts > 1]))
    # samples at which a resting robot repeats its value are new measurements, so they are not counted
    shown = lasts[(lasts > 1) | (values[rows[1:]] != values[rows[1:] - 1])]
    if np.mean(shown == factor) >= REGULAR_SHARE:
        kept: list[int] = []
        for row, length in zip(rows.tolist(), [*lasts.tolist(), 1], strict=True):
            if length > 1 or not kept or row - kept[-1] >= factor:
                kept.append(row)
        return _Even(np.array(kept), time_s[kept], usual_step(time_s[kept]))
    if held.even:
        times = held.measured_s[rows]
        return _Even(rows, times + float(np.min(time_s[rows] - times)), held.period_s)
    return None


def _means(time_s: Array, values: Array, times: Array) -> Array:
    """Return the mean of a held signal from each time to the next; NaN if too many samples are missing."""
    steps, missing = np.diff(time_s), np.isnan(values)
    held = np.column_stack([np.where(missing, 0.0, values), missing])
    total = np.vstack([[0.0, 0.0], np.cumsum(held[:-1] * steps[:, None], axis=0)])
    ends = np.append(times, 2 * times[-1] - times[-2])
    row = np.clip(np.searchsorted(time_s, ends + 1e-6 * steps.min(), side="right") - 1, 0, None)
    integral = total[row] + held[row] * (ends - time_s[row])[:, None]
    mean, empty = (np.diff(integral, axis=0) / np.diff(ends)[:, None]).T
    return np.where(empty > MAX_MISSING, np.nan, mean)


def _is_lossy(values: Array, repeated: Array) -> bool:
    """Return whether a signal repeats samples although its other changes are larger than its rounding."""
    changes = np.abs(np.diff(values[~repeated]))
    return bool(repeated.any() and np.median(changes) >= MIN_CHANGE * (step_of(values) or quantum(values)))


#: Keys of a trials file that are used, by experiment.
USES = {"arma": trials_format.EVERYWHERE | {"input", "output"}}


def load(source: str | Path | TrialSet, file: ParameterFile, parameters_path: Path) -> Experiment:
    """Read trials of the experiment ``arma`` for the model of a parameter file.

    Input and output are the columns to which the model was fitted.

    Raises
    ------
    InputError
        The trials file names other columns, or a file cannot be used.
    """
    path = trials_format.place(source)
    entries = trials_format.read(source, trials_format.Arma, uses=USES)
    robot = trials_format.robot_of(entries, path)
    model = ArxModel.from_file(file, parameters_path)
    read = [model.source] * (model.sine is None)
    for key, columns in (("input", read), ("output", [model.output])):
        named = getattr(entries, key)
        if columns and named is not None and named != columns[0]:
            words = f"these trials name the {key} '{named}', the parameters are of '{columns[0]}'"
            raise InputError(words, file=path, column=key)
    inputs: list[Input] = []
    if not entries._in_memory:
        inputs.append(path)
    trials = []
    for entry in entries.trials:
        log = read_log(entry, path.parent, required=(*read, model.output))
        log, _ = at_own_rate(log, next(iter(read), None), model.output)
        inputs.append(log.source)
        measured, given = {model.output: log[model.output]}, {name: log[name] for name in read}
        trials.append(Trial(entry.id, entry.role, log.time_s, measured, given))
    return Experiment("arma", robot, model, trials, inputs)


# ------------------------------------------------------------ records for rwls


@dataclass(frozen=True)
class Columns:
    """Names of the input and output columns, and the sine that replaces the input column, if any."""

    source: str
    output: str
    #: Amplitude, frequency (Hz) and phase (rad) of a computed input.
    sine: tuple[float, float, float] | None

    @property
    def unit(self) -> str:
        """Unit of the output, from the ending of its name; ``"1"`` if the name has no unit."""
        return numbers.split_unit(self.output)[1] or "1"

    @property
    def gain_unit(self) -> str:
        """Unit of the coefficients of B: unit of the output divided by that of the input."""
        source = numbers.split_unit(self.source)[1] or "1"
        if source == "1":
            return self.unit
        if source == self.unit:
            return "1"
        parts = [f"({unit})" if {"/", " "} & set(unit) else unit for unit in (self.unit, source)]
        return "/".join(parts)

    @property
    def measured_source(self) -> str | None:
        """Name of the input column; None for a computed input."""
        return None if self.sine else self.source


@dataclass(frozen=True)
class Data:
    """Records of the fitted logs and of the held-out data."""

    columns: Columns
    sample_time_s: float
    fit: list[Record]
    #: Held-out records by the name of the data.
    held_out: dict[str, list[Record]]
    #: Names of the fitted logs.
    logs: list[str]
    #: Paths or objects of all inputs, for the provenance.
    files: list[Input]
    robot: str | None
    #: Sentences about repeated samples, one for each column that has them.
    repeats: list[str]


#: Type of an input: a log or trials of the experiment ``arma``, as a file or as an object in memory.
Source = Any


def read(logs: Sequence[Source], options: RwlsOptions) -> Data:
    """Read logs and trials files of the experiment ``arma``, and hold out parts of them.

    Parameters
    ----------
    logs : sequence of paths, Log, DataFrame or TrialSet
    options : RwlsOptions
        Options that state the columns and the data to hold out.

    Raises
    ------
    UsageError
        When the options contradict each other.
    InputError
        A file is unreadable, columns are missing, the rate is not constant, or held-out rows are also fitted.
    """
    share, held_out = _split_held_out(options.held_out)
    entries: list[TrialEntry] = []
    files: list[Input] = []
    listings: dict[Path, trials_format.Arma] = {}
    for number, (source, role) in enumerate([(s, "fit") for s in logs] + [(s, "validate") for s in held_out]):
        file = isinstance(source, str | Path)
        if isinstance(source, TrialSet) or (file and Path(source).suffix.lower() in (".yaml", ".yml")):
            path = trials_format.place(source)
            listed = listings[path] = trials_format.read(source, trials_format.Arma, uses=USES)
            if not listed._in_memory:
                files.append(path)
            found = [_at(entry, path.parent) for entry in listed.trials]
        else:
            found = [_single(source, role, f"table {number + 1}")]
        for one, other in product(entries, found):
            if trials_format.same_recording(one, Path(one.log), other, Path(other.log)):
                trials_format.check_apart(one, other, Path(one.log))
        entries += found
    columns = _columns(options, listings)
    if all(entry.role == "validate" for entry in entries):
        raise UsageError("every trial is a validation trial; at least one must be fitted")
    ids = [entry.id for entry in entries]
    names = [entry.id if ids.count(entry.id) == 1 else entry.log for entry in entries]
    required = tuple(name for name in (columns.measured_source, columns.output) if name)
    contents, repeats = [], []
    for entry in entries:
        log = read_log(entry, Path(), required=required)
        _check_distinct(log, columns)
        log, found_repeats = at_own_rate(log, columns.measured_source, columns.output)
        contents.append(log)
        repeats += found_repeats
    step_s = _common_step(names, contents)
    fitted = [name for name, entry in zip(names, entries, strict=True) if entry.role == "fit"]
    fit: list[Record] = []
    held: dict[str, list[Record]] = {}
    for name, entry, log in zip(names, entries, contents, strict=True):
        if entry.role == "validate":
            held[name] = _records(log, name, columns, step_s, slice(None))
            continue
        cut = len(log) - round(share * len(log))
        fit += _records(log, name, columns, step_s, slice(0, cut))
        if share:
            label = "held-out part" if len(fitted) == 1 else f"held-out part of {name}"
            held[label] = _records(log, name, columns, step_s, slice(cut, None))
    files += [Path(entry.log) if entry._held is None else entry._held.source for entry in entries]
    return Data(columns, step_s, fit, held, fitted, files, _agreed(listings, "robot"), repeats)


def _at(entry: TrialEntry, folder: Path) -> TrialEntry:
    """Return an entry of a trials file, with the path of its log relative to the working folder."""
    placed = entry.model_copy(update={"log": str(folder / entry.log)})
    placed._held = entry._held
    return placed


def _single(source: Source, role: Any, name: str) -> TrialEntry:
    """Return the entry of a log without a trials file; ``name`` is the name of a table without a name."""
    if isinstance(source, str | Path):
        return TrialEntry(id=Path(source).name, log=str(source), role=role)
    held = source if isinstance(source, Log) else Log.from_frame(source, name=name)
    entry = TrialEntry(id=held.path.name, log=str(held.path), role=role)
    entry._held = held
    return entry


def _agreed(listings: dict[Path, trials_format.Arma], key: Literal["input", "output", "robot"]) -> str | None:
    """Return the value of a key in the trials files that state it; raise an error if the values differ."""
    stated = {path: getattr(listed, key) for path, listed in listings.items() if getattr(listed, key)}
    for path, value in stated.items():
        first = next(iter(stated))
        if value != stated[first]:
            text = f"'{value}' contradicts '{stated[first]}' of {first.name}"
            raise InputError(text, file=path, column=key)
    return next(iter(stated.values()), None)


def _split_held_out(given: Sequence[Source | float]) -> tuple[float, list[Source]]:
    """Return the fraction to hold out (0 if none is given), and the logs to hold out."""
    shares: list[float] = []
    logs: list[Source] = []
    for item in given:
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


def _columns(options: RwlsOptions, listings: dict[Path, trials_format.Arma]) -> Columns:
    source = options.input_column or _agreed(listings, "input")
    output = options.output_column or _agreed(listings, "output")
    if output is None:
        raise UsageError("give the output column with --output COLUMN")
    if (options.input_sine is None) == (source is None):
        raise UsageError(
            "give the input column with --input COLUMN, or compute it with --input-sine A F PHASE"
        )
    if source == output:
        raise UsageError(f"input and output are the same column '{source}'")
    return Columns(source or "F_u", output, options.input_sine)


def _check_distinct(log: Log, columns: Columns) -> None:
    """Raise an error if the output is a copy of the input and not constant."""
    if columns.sine:
        return
    u, y = log[columns.source], log[columns.output]
    both = np.isfinite(u) & np.isfinite(y)
    if np.any(both) and np.ptp(y[both]) > 0 and np.array_equal(u[both], y[both]):
        text = f"holds the same values as the input column '{columns.source}' in every row"
        hint = "one of the two is a copy: name the measured output with --output"
        raise InputError(text, file=log.path, column=columns.output, hint=hint)


def _common_step(names: Sequence[str], logs: Sequence[Log]) -> float:
    """Return the common sample time of all logs, s; raise an error if the rates differ or vary."""
    rates = [sampling.rate(log.time_s) for log in logs]
    first_s = rates[0].step_s
    for name, log, rate in zip(names, logs, rates, strict=True):
        text = ""
        if not rate.uniform:
            text = (
                f"is not sampled at a constant rate: only {100 * rate.on_grid:.0f} % of its steps are whole "
                f"multiples of {rate.step_s:.6g} s"
            )
        elif abs(rate.step_s / first_s - 1) > SAME_RATE:
            text = f"is sampled every {rate.step_s:.6g} s, the first log every {first_s:.6g} s"
        if text:
            hint = "resample the logs to one sample time"
            text += "; a discrete-time model needs one rate"
            raise InputError(text, file=log.path, column="t_s", hint=hint)
        if rate.jitter > sampling.NOTABLE_JITTER:
            text = f"time steps scatter by {100 * rate.jitter:.1f} % around {rate.step_s:.6g} s"
            warn("SWM003", f"{name}: {text}; the model takes them as equal")
    return first_s


def _records(log: Log, name: str, columns: Columns, step_s: float, rows: slice) -> list[Record]:
    """Return the gap-free parts of the given rows of a log, on the time grid."""
    time = log.time_s[rows]
    if len(time) < 2:
        return []
    records = []
    for piece in sampling.pieces(time, step_s):
        y = piece.take(log[columns.output][rows])
        if columns.sine:
            u = sine_input(piece.time_s, *columns.sine)
        else:
            u = piece.take(log[columns.source][rows])
        records.append(Record(name, piece.time_s, u, y))
    return records
