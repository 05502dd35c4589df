"""Command ``swimid import``: converts logs of other programs to the log format."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import log, mapping
from swimid.logs.examine import Examined, examine, measured
from swimid.logs.log import Log, LogLike
from swimid.logs.logged import Logged, figures_of
from swimid.logs.options import ImportOptions
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import LONG_ENOUGH, SET, find_frozen, find_unmeasured, may_freeze, usual_step
from swimid.notices import Notice, recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, Table, check, judged
from swimid.results.result import Result


@dataclass(frozen=True, eq=False)
class Imported(Logged):
    """Log of another program, converted to the log format: result of ``import_log``.

    Attributes
    ----------
    examined : Examined or None
        Findings on the log: order of the rows, jumps and speed of the track, stroke. None for a result read
        from a file.
    progress : Progress
        Shows the progress of the writing.
    """

    examined: Examined | None = None
    progress: Progress = field(default=silent, repr=False)

    def _write(self, path: Path) -> list[Path]:
        with self.progress(f"writing {path.name}", total=len(self.log)) as step:
            log.write(path, self.log.columns, self.log.metadata, step=step)
        return [path]


@takes(ImportOptions)
def import_log(
    source: LogLike,
    *,
    options: ImportOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Imported:
    """Convert a foreign recording to a log in SI units, with rows in order and jumps removed.

    A profile reads a file of a known format. For any other file, a mapping (file or dict) assigns a source
    column and its unit to each column of the log. Without a mapping the columns must be named as in the log
    format. Repeated samples and jumps are removed from logs with two or more position columns, except from
    tracks computed by swimid.

    Parameters
    ----------
    source : path, DataFrame or Log
        Path of a file in any format listed in ``docs/import.md``; or a table, shape (n, k), one row per
        sample.
    output : path, optional
        Path of the log, CSV or Parquet by its ending. ``<stem>.evidence.json`` is written to the same folder.
        Without a path nothing is written; :meth:`~swimid.results.result.Result.save` writes both files later.
    progress : Progress
        Shows the progress of reading and writing.

    Returns
    -------
    Imported
        ``.log`` and ``.frame`` hold the columns, each shape (n,), in SI units. ``.examined`` holds the speed
        (m/s), the stroke (Hz) and the jumps. ``.checks()`` and ``.figures()`` return the checks and the
        figures.

    Raises
    ------
    InputError
        The source or the mapping cannot be used, or neither states a time. The message names file, line and
        column.
    NoTrustworthyResult
        A cleaned track has too few samples.
    UsageError
        The output path is the path of the source.

    References
    ----------
    Pearson et al. (2016), doi:10.1186/s13634-016-0383-6, for the jumps; Craven and Wahba (1979),
    doi:10.1007/BF01404567, for the speed along the path.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> ms = 20.0 * np.arange(400)
    >>> heading = 10 * np.sin(2 * np.pi * 1.5 * ms / 1000)
    >>> table = pd.DataFrame({"Time": ms, "Heading": heading})
    >>> columns = [{"source": "Heading", "target": "yaw_rad", "unit": "deg"}]
    >>> made = import_log(table, map_path={"time": {"source": "Time", "unit": "ms"}, "columns": columns})
    >>> list(made.frame), round(made.data["stroke"]["frequency_hz"], 3)
    (['t_s', 'yaw_rad'], 1.5)
    """
    given, map_path = log.unread(source), options.map_path
    rules = None if map_path is None else mapping.of(map_path)
    inputs: list[provenance.Input] = [given]
    if rules is not None:
        inputs.append(map_path if isinstance(map_path, str | Path) else rules)
    if output is not None:
        output = atomic.check_writable(output, inputs=inputs)
    with recorded(repeat=True) as notices, ThreadPoolExecutor(1) as beside:
        # hash a long file while it is read
        digests = beside.submit(provenance.digests_of, inputs)
        read = mapping.apply(rules, given, options.stated, progress=progress)
        found = examine(read, options)
        settings = options.settings(clean=found.cleaned)
        origin = provenance.collect(inputs, settings=settings, digests=digests.result())
        name = f"{found.path.stem}.csv" if output is None else output.name
        made = Log(Path(name), found.metadata, found.columns, None)
        proof = _evidence(found, origin, notices)
    data = _data(found, proof)
    result = Imported("import", "", data, evidence=proof, document=made, examined=found, progress=progress)
    return result.saved(output)


@takes(ImportOptions)
def import_logs(
    files: Sequence[str | Path],
    *,
    options: ImportOptions,
    output: str | Path,
    progress: Progress = silent,
) -> Result:
    """Import several foreign logs, each as :func:`import_log` does.

    If a file cannot be imported, the other files are still imported.

    Parameters
    ----------
    files : sequence of paths
        Paths of the logs, at least one.
    output : path
        Path of the log, CSV or Parquet by its ending; for several files a folder, which is created.

    Raises
    ------
    InputError
        The mapping cannot be used, or some files cannot be imported. In the second case all other files are
        imported before the error is raised.
    NoTrustworthyResult
        There is only one file, and its cleaned track has too few samples.
    UsageError
        No file is named, or two logs would be written to the same file.
    """
    if not files:
        raise UsageError("name at least one log to import")
    paths = list(dict.fromkeys(Path(file) for file in files))
    if options.map_path is not None:
        mapping.of(options.map_path)  # refuse an invalid mapping before any file is read
    done: list[Imported] = []
    failed: list[InputError | NoTrustworthyResult] = []
    for path, target in zip(paths, destinations(paths, Path(output)), strict=True):
        try:
            done.append(import_log(path, options=options, output=target, progress=progress))
        except (InputError, NoTrustworthyResult) as error:
            if len(paths) == 1:
                raise
            failed.append(error)
    if failed:
        listed = ""
        for refused in failed:
            listed += f"\n  {refused}"
            if refused.hint:
                listed += f" ({refused.hint})"
        written = ", ".join(str(outcome.outputs[0]) for outcome in done) or "none"
        text = f"{len(failed)} of {len(paths)} logs cannot be imported:{listed}"
        raise InputError(text, hint=f"the others were written: {written}")
    if len(done) == 1:
        return done[0]
    text = "\n\n".join(outcome.summary() for outcome in done)
    outputs = [path for outcome in done for path in outcome.outputs]
    return Result("import", text, {"logs": [outcome.data for outcome in done]}, outputs)


def destinations(paths: Sequence[Path], output: Path) -> list[Path]:
    """Return the path of each imported log: the output file, or a file in the output folder.

    The folder is created.

    Raises
    ------
    UsageError
        Several logs would be written to the same file.
    """
    if len(paths) == 1 and not output.is_dir() and not str(output).endswith("/"):
        atomic.check_writable(output, inputs=tuple(paths))
        return [output]
    if output.exists() and not output.is_dir():
        text = f"{len(paths)} logs cannot all go to the file {output}"
        raise UsageError(text, hint="name a folder with -o")
    atomic.check_writable(output.parent / "x")
    output.mkdir(exist_ok=True)
    names = [path.stem for path in paths]
    for k, path in enumerate(paths):
        if [other.stem for other in paths].count(path.stem) > 1:
            names[k] = f"{path.resolve().parent.name}-{path.stem}"
    # some file systems do not distinguish capital letters
    folded = Counter(name.casefold() for name in names)
    twice = [name for name in names if folded[name.casefold()] > 1]
    if twice:
        raise UsageError(f"two logs would be written to {twice[0]}.csv", hint="import them one by one")
    return [atomic.check_writable(output / f"{name}.csv", inputs=tuple(paths)) for name in names]


# ---------------------------------------------------------------- evidence

#: Minimum number of values of each channel, and minimum number of samples, for the checks of a log.
MIN_SAMPLES = LONG_ENOUGH + 1
#: Minimum number of samples per stroke. With fewer samples the path between them is not known.
MIN_SAMPLES_PER_STROKE = 6.0
#: Maximum fraction of the rows that are dropped. With a larger fraction the time column is probably
#: incomplete.
MAX_DROPPED = 0.1
#: Maximum fraction of the samples in jumps. A larger fraction means that the columns are not a track.
MAX_JUMPED = 0.2
#: Columns whose values are limited for a swimmer (:func:`swimid.logs.log.doubts`).
LIMITED = re.compile(r"[xyz]_m|.*_(rad|rad_s|m_s)")
REFERENCES = [
    "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
    "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
    "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
    "377-403. doi:10.1007/BF01404567",
]


def _evidence(found: Examined, origin: dict[str, Any], notices: Sequence[Notice]) -> Evidence:
    """Return the evidence of an imported log."""
    checks = [*_amount_checks(found), *_value_checks(found), *_track_checks(found), *_stroke_checks(found)]
    with recorded(repeat=True) as drawn:
        shown = figures_of([Log(found.path, {}, found.columns)], found=found.stroke)
    return Evidence(
        command="import",
        title=f"Log imported from {found.path.name}",
        verdict=judged(f"{len(found.time_s)} samples in {len(found.columns) - 1} channels.", checks),
        facts=_facts(found),
        checks=checks,
        tables=_tables(found),
        figures=shown,
        notices=blocks.notices([*notices, *drawn]),
        methods=_methods(found),
        references=[] if found.cleaning is None else REFERENCES,
        provenance=origin,
    )


def _check(
    name: str,
    passed: bool,
    limit: str,
    reason: str,
    value: str = "",
    *,
    made: bool = True,
    fails: bool = False,
) -> Check:
    """Return a check with its verdict: pass, warn, fail, or "not judged" if the data do not allow it.

    A check is not judged if nothing is wrong and ``made`` is False. ``reason`` says what is wrong if the
    check does not pass. By default ``value`` is the reason, or the limit if the check passes. A check that
    does not pass is a warning, or a failure with ``fails``.
    """
    if passed and not made:
        return check(name, "not judged", None, limit, "no channel allows it, or the samples are too few")
    text = "" if passed or value in reason else reason
    value = value or (limit if passed else reason)
    return check(name, value, passed, limit, text, otherwise="fail" if fails else "warn", reason=reason)


def _amount_checks(found: Examined) -> list[Check]:
    """Return the checks of rows, columns and times: whether they are complete and sufficient."""
    time, n, rows = found.time_s, len(found.time_s), len(found.mapped)
    counts = {name: int(np.isfinite(values).sum()) for name, values in found.channels.items()}
    scarce = [f"{name} ({count} of {n})" for name, count in counts.items() if count < MIN_SAMPLES]
    few = f"too few values to judge {', '.join(scarce)}: a channel needs {MIN_SAMPLES}"
    if n < MIN_SAMPLES:
        few = f"{n} samples are too few to judge a log, which needs {MIN_SAMPLES}"
    last = int(np.argmax(np.diff(time)))
    pause_s = float(time[last + 1] - time[last])
    long = n >= MIN_SAMPLES and pause_s > 0.5 * (time[-1] - time[0])
    pause = (
        f"no sample lies between {time[last]:.6g} s and {time[last + 1]:.6g} s, more than half of the log: "
        "do the times count from two origins?"
    )
    order, notes = found.order, found.mapped.notes
    odd, dropped = sum(order.counts.values()), order.untimed + order.clashing
    many = dropped > MAX_DROPPED * rows
    remarks = "; ".join([f"rows {order.summary}"] * order.changed + notes)
    if many:
        remarks = f"{dropped} of {rows} rows have no time of their own: is the time complete?"
    names = ", ".join(found.mapped.unknown)
    open_ = f"nothing states the quantity of {names}: map it to a name with a unit, or to unit: '1'"
    least, longest = str(min(counts.values())), numbers.number(pause_s, 3, "s")
    checks = [
        _check(
            "Samples", not scarce, f"≥ {MIN_SAMPLES} in a channel", few, least, fails=not any(counts.values())
        ),
        _check("Longest pause", not long, "≤ half of the log", pause, longest, made=n >= MIN_SAMPLES),
        _check("Rows in order", not (odd or notes), "none", remarks, f"{odd} of {rows} odd", fails=many),
        _check("Quantity of every column", not names, "known", open_, names, fails=True),
    ]
    if found.metadata.get("sample_rate") == "assumed":
        why = "the sample rate is assumed, and speeds and frequencies are as wrong as it is"
        checks.append(_check("Sample rate", False, "stated", why, "assumed", fails=True))
    for name, count in found.mapped.unlikely.items():
        why = f"{count} of {rows} samples are left empty for their {name}"
        checks.append(_check(f"Samples by {name}", False, "none", why, f"{count} of {rows}"))
    return checks


def _value_checks(found: Examined) -> list[Check]:
    """Return the checks of the values of the samples."""
    stuck = find_frozen(found.time_s, measured(found.columns))
    scales = {target: factor for target, (_, factor, _) in found.mapped.sources.items()}
    disagree = "; ".join(f"{one.column} {one.text} (against {one.against})" for one in found.contradictions)
    holds = "; ".join(f"{name} from {a:.4g} to {b:.4g} s" for name, (a, b) in stuck.items())
    faults = "; ".join(f"{name} {text}" for name, text in find_unmeasured(found.columns, scales).items())
    doubts = "; ".join(f"{doubt.column} {doubt.text}" for doubt in found.doubts)
    frozen, faulty = f"channels hold one value amid their motion: {holds}", f"channels look faulty: {faults}"
    uneven = f"the sampling is uneven{', in bursts' * found.bursts}: {found.uneven}"
    enough = len(found.time_s) >= MIN_SAMPLES
    channels = {name: values for name, values in found.channels.items() if not SET.fullmatch(name)}
    long = any(np.isfinite(values).sum() >= MIN_SAMPLES for values in channels.values())
    continuous = any(may_freeze(*channel) for channel in found.channels.items())
    limited = enough and any(map(LIMITED.fullmatch, found.channels))
    return [
        _check("Columns agree", not disagree, "all", disagree, made=bool(found.comparisons), fails=True),
        _check("Sampling", not found.uneven, "even", uneven, found.uneven, made=enough, fails=found.bursts),
        _check("Frozen channels", not holds, "none", frozen, holds, made=continuous, fails=True),
        _check("Faulty channels", not faults, "none", faulty, faults, made=long),
        _check(POSSIBLE, not doubts, "within", doubts, "beyond" if doubts else "", made=limited),
    ]


def _track_checks(found: Examined) -> list[Check]:
    cleaning = found.cleaning
    if cleaning is None:
        return []
    lost, repeats = cleaning.counts["samples_jumped"], cleaning.counts["repeats"]
    seen, done = int(cleaning.good.sum()) + repeats + lost, found.done
    held = "the track holds repeated pictures (--clean leaves them out)"
    jumps = f"the track jumps {cleaning.jumps} times ({lost} samples {done})"
    if cleaning.offset_rows:
        jumps += f" and goes on elsewhere {len(cleaning.offset_rows)} times"
    lossy = lost > MAX_JUMPED * seen or not found.cleaned
    gaps = f"{len(cleaning.gaps)}, longest {numbers.number(cleaning.longest_gap_s, 3, 's')}"
    kept, value = f"the track has gaps ({gaps}), which are kept", f"{repeats} of {seen} {done}"
    return [
        _check("Repeated pictures", found.cleaned or not repeats, "none kept", held, value),
        _check(
            "Jumps",
            not cleaning.jumps,
            "none",
            jumps,
            f"{cleaning.jumps} ({lost} samples {done})",
            fails=lossy,
        ),
        _check("Gaps in the track", not cleaning.gaps, "none", kept, gaps),
    ]


def _stroke_checks(found: Examined) -> list[Check]:
    stroke = found.stroke
    if stroke is None:
        return []
    checks = []
    if found.speed is not None and found.cleaning is not None:
        count = float(found.cleaning.good.sum()) / found.speed.covered_s / stroke.beat.frequency_hz
        value, limit = numbers.number(count, 3), f"≥ {MIN_SAMPLES_PER_STROKE:g}"
        why = f"the track has {value} samples a stroke, too few to know the path between them"
        checks.append(_check("Samples a stroke", count >= MIN_SAMPLES_PER_STROKE, limit, why, value))
    value = " against ".join(f"{b.frequency_hz:.4g} Hz" for b in (stroke.beat, *stroke.rivals.values()))
    limit = "no channel beats at another frequency"
    checks.append(_check("One stroke", not stroke.doubt, limit, stroke.doubt, value))
    if "frequency_hz" in found.metadata:
        name, stated = "Stroke against the metadata", f"{found.metadata['frequency_hz']} Hz"
        checks.append(_check(name, not found.against, stated, found.against, _frequency(stroke)))
    return checks


def _facts(found: Examined) -> dict[str, str]:
    """Return the facts of an imported log, in addition to the facts of any log."""
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    facts = {"Stroke": f"unknown: {found.unknown}"}
    if stroke is not None:
        facts["Stroke"] = f"{_frequency(stroke)} in {stroke.channel}"
        if stroke.maybe_double:
            facts["Stroke"] += ", may be twice the stroke: no channel that swings sideways is there"
    if cleaning is not None:
        counts, gaps = cleaning.counts, f"{len(cleaning.gaps)} gaps kept"
        facts["Track"] = f"{counts['repeats']} repeats and {counts['jumps']} jumps {found.done}, {gaps}"
    if speed is not None:
        path, straight = (f"{mean.value:.4g} {found.unit}/s" for mean in (speed.path, speed.line))
        facts["Speed"] = f"{path} along the path, {straight} along the line"
    return facts


def _tables(found: Examined) -> list[Table]:
    """Return the tables of the speed, of the stroke and its channels, and of the sources of the columns."""
    tables, speed, stroke, unit = [], found.speed, found.stroke, found.unit
    if speed is not None:
        rows: list[list[Any]] = [
            ["along the path", speed.path.value, speed.path.low, speed.path.high],
            ["along the line from start to end", speed.line.value, speed.line.low, speed.line.high],
            ["naive mean of |dx/dt|", speed.naive_m_s, None, None],
        ]
        noise = numbers.number(speed.noise_m, 3, unit)
        caption = f"Over {speed.covered_s:.4g} s without the gaps; the noise of a coordinate is {noise}."
        columns = ["mean speed", f"{unit}/s", "95 % from", "to"]
        tables.append(Table(id="speed", title="Mean speed", columns=columns, rows=rows, caption=caption))
    if stroke is not None:
        rows = []
        for name, beat in stroke.channels.items():
            frequency = numbers.measured(beat.frequency_hz, beat.stderr_hz)
            rows.append([name, frequency, beat.amplitude, 100 * beat.share])
        title = "Beat of every channel"
        columns = ["channel", "frequency (Hz)", "amplitude", "share of the variance (%)"]
        tables.append(Table(id="beats", title=title, columns=columns, rows=rows, folded=True))
    rows = [[name, *found.mapped.sources.get(name, (name, 1.0, 0.0))] for name in found.columns]
    columns, title = ["column", "source", "factor", "offset"], "Sources of the columns"
    return [*tables, Table(id="columns", title=title, columns=columns, rows=rows, folded=True)]


def _frequency(stroke: Rhythm) -> str:
    return numbers.measured(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")


def _methods(found: Examined) -> list[str]:
    sentences = []
    if found.cleaned:
        sentences.append(
            "Repeated samples of the camera and jumps, found by a Hampel identifier on the steps of the "
            "track, were left out; gaps were not bridged."
        )
    if found.speed is not None:
        sentences.append(
            "The mean speed was taken along cubic smoothing splines, their smoothness chosen by "
            "cross-validation, and corrected for the noise by a parametric bootstrap."
        )
    if found.stroke is not None:
        sentences.append(
            "The stroke frequency is the slope of the phases of a sine fitted in windows of two cycles "
            "beside a cubic drift, by generalised least squares."
        )
    return sentences


def _data(found: Examined, proof: Evidence) -> dict[str, Any]:
    """Return the findings as plain data (numbers, text, lists and dicts)."""
    time, unit, step = found.time_s, found.unit, usual_step(found.time_s)
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    made: dict[str, Any] = {
        "file": str(found.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": 1 / step,
        "columns": list(found.columns),
        "missing": {name: int(np.isnan(values).sum()) for name, values in found.channels.items()},
        "rows": found.order.counts,
        "notes": found.mapped.notes,
        "profile": found.mapped.profile,
        "unlikely": found.mapped.unlikely,
        "contradictions": [asdict(one) for one in found.contradictions],
        "stroke": {"unknown": found.unknown},
        **dict.fromkeys(("track", "speed")),
        "verdict": proof.verdict.model_dump(),
        "checks": [check.model_dump() for check in proof.checks],
    }
    if cleaning is not None:
        made["track"] = {
            "cleaned": found.cleaned,
            **cleaning.counts,
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        }
    if speed is not None:
        made["speed"] = {
            f"path_{unit}_s": speed.path.value,
            "path_ci95": [speed.path.low, speed.path.high],
            f"line_{unit}_s": speed.line.value,
            "line_ci95": [speed.line.low, speed.line.high],
            f"naive_{unit}_s": speed.naive_m_s,
            f"noise_{unit}": speed.noise_m,
            "covered_s": speed.covered_s,
        }
    if stroke is not None:
        made["stroke"] = {
            "frequency_hz": stroke.beat.frequency_hz,
            "stderr_hz": stroke.beat.stderr_hz,
            "ci95_hz": list(stroke.beat.interval_hz),
            "period_s": stroke.period_s[0],
            "cycles": stroke.beat.cycles,
            "channel": stroke.channel,
            "maybe_double": stroke.maybe_double,
            "channels_hz": {n: b.frequency_hz for n, b in stroke.channels.items()},
            "rivals_hz": {n: b.frequency_hz for n, b in stroke.rivals.items()},
            "contradiction": found.against or None,
        }
    return made
