"""What ``swimid rwls`` reads: logs on one time grid, fitted and held-out parts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swimid.errors import InputError, UsageError
from swimid.formats import log as log_format
from swimid.formats import trials
from swimid.models.arx import sine_input
from swimid.models.difference import Record
from swimid.notices import warn
from swimid.reporting import numbers
from swimid.signals import sampling


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
class Data:
    """The logs on their grids."""

    columns: Columns
    sample_time_s: float
    fit: list[Record]
    held_out: dict[str, list[Record]]
    logs: list[str]
    files: list[Path]
    robot: str | None


def read(
    logs: Sequence[str | Path],
    validate: Sequence[str | Path | float],
    input_column: str | None,
    output_column: str | None,
    input_model: str | None,
) -> Data:
    """Read logs and trials files, and hold parts of them out.

    Parameters
    ----------
    logs : sequence of paths
        Logs, or trials files of the experiment ``arma``.
    validate : sequence
        At most one share of every log, and any number of further logs.
    input_column, output_column, input_model : str or None
        See :func:`swimid.verbs.rwls.rwls`.

    Raises
    ------
    UsageError
        When the options contradict each other.
    InputError
        When a file cannot be used: unreadable, columns missing, no constant rate.
    """
    share, other = _held_out(validate)
    fit_paths: list[Path] = []
    check_paths = list(other)
    files: list[Path] = []
    robot = None
    for path in map(Path, logs):
        if path.suffix.lower() not in (".yaml", ".yml"):
            fit_paths.append(path)
            continue
        listed = trials.read(path, trials.Arma)
        files.append(path)
        robot = listed.robot
        input_column, output_column = input_column or listed.input, output_column or listed.output
        for trial in listed.trials:
            (fit_paths if trial.role == "fit" else check_paths).append(path.parent / trial.log)
    if not fit_paths:
        raise UsageError("every trial is a validation trial; at least one must be fitted")
    columns = _columns(input_column, output_column, input_model)
    read = {path: _log(path, columns) for path in dict.fromkeys([*fit_paths, *check_paths])}
    step = _sample_time({path: log.time_s for path, log in read.items()})
    for path, log in read.items():
        _check_distinct(path, log, columns)
    names = _short_names(list(read))
    fit: list[Record] = []
    held: dict[str, list[Record]] = {}
    for path in fit_paths:
        cut = len(read[path]) - (round(share * len(read[path])) if share else 0)
        fit += _records(read[path], names[path], columns, step, slice(0, cut))
        if share:
            label = "held-out part" if len(fit_paths) == 1 else f"held-out part of {names[path]}"
            held[label] = _records(read[path], names[path], columns, step, slice(cut, None))
    for path in check_paths:
        held[names[path]] = _records(read[path], names[path], columns, step, slice(None))
    logs_used = [names[path] for path in fit_paths]
    return Data(columns, step, fit, held, logs_used, [*files, *read], robot)


def _held_out(validate: Sequence[str | Path | float]) -> tuple[float, list[Path]]:
    share, logs = 0.0, []
    for item in validate:
        try:
            value = float(item)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            logs.append(Path(item))  # type: ignore[arg-type]
            continue
        if not 0 < value < 1:
            raise UsageError(
                f"--validate {item}: a share must lie between 0 and 1", hint="0.25 is the last quarter"
            )
        if share:
            raise UsageError("--validate: only one share can be given, besides any number of logs")
        share = value
    return share, logs


def _columns(source: str | None, output: str | None, model: str | None) -> Columns:
    if output is None:
        raise UsageError("give the output column with --output COLUMN")
    if model is not None:
        if source is not None:
            raise UsageError("give --input or --input-model, not both")
        return Columns("F_u", output, _sine(model))
    if source is None:
        raise UsageError(
            "give the input column with --input COLUMN, or compute it with --input-model sine:A,F"
        )
    if source == output:
        raise UsageError(f"input and output are the same column '{source}'")
    return Columns(source, output, None)


def _sine(text: str) -> tuple[float, float, float]:
    kind, _, rest = text.partition(":")
    try:
        values = [float(part) for part in rest.split(",")]
    except ValueError:
        values = []
    if kind != "sine" or len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise UsageError(
            f"--input-model '{text}' is not sine:A,F or sine:A,F,PHASE", hint="for example sine:30,1.2"
        )
    if values[0] == 0 or values[1] <= 0:
        raise UsageError(f"--input-model '{text}': amplitude must not be 0 and frequency must be above 0 Hz")
    return values[0], values[1], values[2] if len(values) == 3 else 0.0


def _log(path: Path, columns: Columns) -> log_format.Log:
    required = (columns.output,) if columns.sine else (columns.source, columns.output)
    return log_format.read(path, required=required, optional=())


def _check_distinct(path: Path, log: log_format.Log, columns: Columns) -> None:
    """Refuse an output that is the input under another name (an output that moves, that is)."""
    if columns.sine:
        return
    u, y = log[columns.source], log[columns.output]
    both = np.isfinite(u) & np.isfinite(y)
    if np.any(both) and np.ptp(y[both]) > 0 and np.array_equal(u[both], y[both]):
        raise InputError(
            f"holds the same values as the input column '{columns.source}' in every row",
            file=path,
            column=columns.output,
            hint="one of the two is a copy: name the measured output with --output",
        )


def _sample_time(times: dict[Path, np.ndarray]) -> float:
    """The common sample time of all logs, s."""
    first: float | None = None
    for path, time_s in times.items():
        rate = sampling.rate(time_s)
        if not rate.uniform:
            raise InputError(
                f"is not sampled at a constant rate: only {100 * rate.on_grid:.0f} % of its steps are whole "
                f"multiples of {rate.step_s:.6g} s; a discrete-time model needs one rate",
                file=path,
                column="t_s",
                hint="resample the log onto a uniform time base first",
            )
        if rate.jitter > sampling.NOTABLE_JITTER:
            warn(
                "SWM003",
                f"{path.name}: time steps scatter by {100 * rate.jitter:.1f} % around {rate.step_s:.6g} "
                "s; the model "
                "takes them as equal",
            )
        if first is None:
            first = rate.step_s
        elif abs(rate.step_s / first - 1) > 0.01:
            raise InputError(
                f"is sampled every {rate.step_s:.6g} s, the first log every {first:.6g} s; a "
                "discrete-time model "
                "needs one rate",
                file=path,
                column="t_s",
                hint="resample the logs onto the same time base first",
            )
    assert first is not None
    return first


def _short_names(paths: list[Path]) -> dict[Path, str]:
    short = [path.name for path in paths]
    return {path: path.name if short.count(path.name) == 1 else str(path) for path in paths}


def _records(log: log_format.Log, name: str, columns: Columns, step_s: float, rows: slice) -> list[Record]:
    time = log.time_s[rows]
    if len(time) < 2:
        return []
    y = log[columns.output][rows]
    result = []
    for piece in sampling.pieces(time, step_s):
        u = sine_input(piece.time_s, *columns.sine) if columns.sine else piece.take(log[columns.source][rows])
        result.append(Record(name, piece.time_s, u, piece.take(y)))
    return result
