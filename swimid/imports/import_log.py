"""Command ``swimid import``, which converts logs of other programs to the log format."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.imports import consistency, mapping
from swimid.imports.averaging import RowStatistics
from swimid.imports.consistency import (
    ANGLES,
    MAX_JUMPED,
    ColumnComparison,
    Jumped,
    find_jumped,
    find_unmeasured,
)
from swimid.imports.mapping import MappedLog, Order
from swimid.imports.options import ImportOptions
from swimid.kinematics import speed as track_speed
from swimid.kinematics import stroke as strokes
from swimid.kinematics import wave
from swimid.kinematics.frequency import Beat, contradiction, read_frequency
from swimid.kinematics.jumps import Cleaning, clean_track
from swimid.kinematics.logged import Logged
from swimid.kinematics.plot import figures_of
from swimid.kinematics.speed import TrackSpeed, measure_speed
from swimid.kinematics.stroke import StrokeEstimate, find_stroke
from swimid.logs import log, sampling
from swimid.logs.log import TIME, Doubt, Log, LogLike, runs
from swimid.logs.sampling import LONG_ENOUGH, SET, find_frozen, may_freeze
from swimid.notices import Notice, Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.points import point_evidence, point_files
from swimid.points.point_files import Request
from swimid.points.points import Posed, pose_of
from swimid.results import numbers
from swimid.results.evidence import POSSIBLE, Check, Evidence, Table, make_check, make_verdict

Array = NDArray[np.float64]


@takes(ImportOptions)
def import_log(
    source: LogLike, *, options: ImportOptions, output: str | Path | None = None, progress: Progress = silent
) -> Logged:
    """Convert a recording of another program to a log in SI units, with rows in order and jumps removed.

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
        Path of the log, CSV or Parquet by its file name extension. ``<stem>.evidence.json`` (checks and
        results) is written to the same folder. Without a path nothing is written;
        :meth:`~swimid.results.result.Result.save` writes both files later.
    progress : Progress
        Shows the progress of reading and writing.

    Returns
    -------
    Logged
        ``.log`` and ``.frame`` hold the columns, each shape (n,), in SI units. ``.data`` holds the speed
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
    rules = None if map_path is None else mapping.read_mapping(map_path)
    inputs: list[provenance.Input] = [given]
    if rules is not None:
        inputs.append(map_path if isinstance(map_path, str | Path) else rules)
    request = None
    if options.robot is not None or options.points is not None:
        request = Request(options.robot, options.points, options.calibrate_points)
        inputs += request.inputs
    if output is not None:
        output = atomic.check_writable(output, inputs=inputs)
    with record_warnings(repeat=True) as notices:
        read = mapping.apply(rules, given, options.file_values, every=options.every or 1, progress=progress)
        found = examine(read, options, request)
        settings = options.settings(clean=found.cleaned)
        origin = provenance.collect(inputs, settings=settings)
        proof = _evidence(found, origin, notices)
    name = found.log.path.with_suffix(".csv").name if output is None else output.name
    made = replace(found.log, path=Path(name))
    return Logged("import", "", _data(found, proof), evidence=proof, document=made).write_output(output)


# ---------------------------------------------------------------- examination

#: Pattern of the columns that ``swimid track`` writes for a pose before smoothing, and pattern of all columns
#: of a pose or of its rates of change.
_RAW = re.compile(r"(x|y|z|yaw|pitch|roll)_raw_(.+)")
_OF_POSE = re.compile(r"(x|y|z|yaw|pitch|roll)_.+|(u|v|w|vx|vy|vz)_(sd_)?(m|px)_s2?")


@dataclass(frozen=True)
class Examined:
    """Imported log with its rows in order of time, and the results of all checks.

    Attributes
    ----------
    mapped : MappedLog
        Log as it was read. Its columns are changed in place to those that are written.
    log : Log
        Log as it is written.
    order : Order
        Order of the rows, with the number of rows that were moved or left out.
    cleaning : Cleaning or None
        Repeated samples, jumps and gaps of the track; None without a track.
    cleaned : bool
        Whether repeated samples and jumps were left out of the track.
    jumped : dict of str to Jumped
        Jumps and spikes of the channels other than the track. The key is a message on them.
    speed : TrackSpeed or None
        Speed of the track.
    stroke : StrokeEstimate
        Stroke, or the reason why none is found.
    against : str
        Message on how the stroke contradicts the metadata; empty if the two agree.
    doubts : list of Doubt
        Columns with values that no swimmer reaches.
    comparisons : list of ColumnComparison
        Comparisons of columns that show the same motion.
    uneven : str
        Range of the time steps, as text for a message; empty for even sampling.
    bursts : bool
        Whether the time stamps come in bursts.
    posed : Posed or None
        Pose and joint angles from tracked points; None if they were not requested.
    wave : Wave or None
        Body wave at the stroke frequency, from the tracked points.
    """

    mapped: MappedLog
    log: Log
    order: Order
    cleaning: Cleaning | None
    cleaned: bool
    jumped: dict[str, Jumped]
    speed: TrackSpeed | None
    stroke: StrokeEstimate
    against: str
    doubts: list[Doubt]
    comparisons: list[ColumnComparison]
    uneven: str
    bursts: bool
    posed: Posed | None = None
    wave: wave.Wave | None = None

    @property
    def unit(self) -> str:
        """Unit of the positions in the imported log: m or px."""
        return "px" if {"x_px", "y_px", "z_px"} & set(strokes.coordinate_columns(self.log.columns)) else "m"

    @property
    def treatment(self) -> str:
        """Participle for messages: whether repeated samples and jumps of the track are left out or kept."""
        return "left out" if self.cleaned else "kept"


def examine(source: MappedLog, options: ImportOptions, request: Request | None = None) -> Examined:
    """Sort the rows and clean the track of a foreign log, and estimate its speed and stroke.

    ``source.columns`` is changed in place, so that a long log is in memory only once.

    Raises
    ------
    InputError
        No sample has a time, or the clock is reset within the log.
    NoTrustworthyResult
        A cleaned track has fewer samples than :data:`swimid.kinematics.speed.MIN_SAMPLES_SPEED`.
    """
    name, columns = source.path.name, source.columns
    order = _sort_rows(source)
    uneven = sampling.find_uneven(columns[TIME])
    metadata = dict(source.metadata) | {"source": name, "imported_by": "swimid import"}
    posed, markers = _add_pose(source, request, metadata)
    coordinates, known = strokes.coordinate_columns(columns), _select_measured(columns)
    cleaned = options.clean
    if cleaned is None:
        cleaned = len(coordinates) > 1 and not log.is_written_by(source.metadata, "swimid track")
    cleaned = cleaned and bool(coordinates)
    jumped = _remove_jumps(source, source.rows[order.index], options.clean)
    cleaning = speed = None
    stamps, track = columns[TIME], [known[column] for column in coordinates]
    if len(track) > 1 or cleaned:
        cleaning = clean_track(stamps, track, [log.unwrap(known[name]) for name in ANGLES if name in columns])
    if options.clean is not False:
        _take_out(columns, cleaning if cleaned else None, list(jumped.values()), name, metadata)
    measured = _select_measured(columns).items()
    channels = {key: values for key, values in measured if key not in (TIME, *markers)}
    times, times_sd_s = _find_picture_times(columns[TIME], stamps, cleaning)
    stated_hz = read_frequency(metadata)
    stroke = find_stroke(
        times, channels, range_hz=options.stroke_hz, stated_hz=stated_hz, time_sd_s=times_sd_s
    )
    against, periodic_hz = _check_stroke(stroke, stated_hz, name), stroke.frequency_hz or stroke.slow_hz
    if cleaning is not None:
        speed = measure_speed(
            cleaning.held.measured_s,
            np.where(cleaning.good, track, np.nan).T,
            periodic_hz,
            offset_rows=cleaning.offset_rows,
            stamp_sd_s=cleaning.held.measured_sd_s,
        )
    if posed is not None:
        posed.centre(columns, stroke.frequency_hz)
    doubts = [*log.doubts(columns[TIME], columns), *_doubt_amplitudes(stroke)]
    for doubt in doubts:
        warn("SWM002", f"{name}, '{doubt.column}': {doubt.text}")
    period_s = None if stroke.frequency_hz is None else 1.0 / stroke.frequency_hz
    comparisons = _compare_columns(columns, period_s, name)
    made = Log(source.path, metadata, columns, None)
    body_wave = point_evidence.wave_of(posed, periodic_hz)
    track_results = cleaning, cleaned, jumped, speed
    return Examined(
        source, made, order, *track_results, stroke, against, doubts, comparisons, *uneven, posed, body_wave
    )


def _find_picture_times(times: Array, stamps: Array, cleaning: Cleaning | None) -> tuple[Array, float]:
    """Return the times at which the pictures of a track were taken, s, and their standard deviation, s.

    ``times`` has the times of the samples that are kept, and ``stamps`` the times of all samples of the
    track.
    """
    if cleaning is None:
        return times, 0.0
    measured_s = np.interp(times, stamps, cleaning.held.measured_s)
    if (np.diff(measured_s) > 0).all():  # equal times occur if other channels have rows between pictures
        return measured_s, cleaning.held.measured_sd_s
    return times, cleaning.held.lateness_s / np.sqrt(12.0)


def _sort_rows(source: MappedLog) -> Order:
    """Sort the rows of a foreign log by time, in place; return their order.

    Raises
    ------
    InputError
        Fewer than two rows have a time that no other row has, or the clock was reset.
    """
    channels = {name: values for name, values in source.columns.items() if name != TIME}
    order = mapping.in_order(source.time_s, channels)
    if len(order.index) < 2:
        text = (
            f"only {len(order.index)} of {len(source)} rows have a time that no other row has; 2 are needed"
        )
        hint = "check that the column of the time is complete and has enough digits"
        raise InputError(text, file=source.path, column=TIME, hint=hint)
    if order.reset_row is not None:
        last = np.nanmax(source.time_s[: order.reset_row])
        text = f"the clock starts again: {source.time_s[order.reset_row]:g} s after {last:g} s"
        line = int(source.rows[order.reset_row])
        hint = "split the file there, or state the range of a counter under 'time:': 'wraps_at: 4294967296'"
        raise InputError(text, file=source.path, line=line, column=TIME, hint=hint)
    for note in source.notes:
        warn("SWM057", f"{source.path.name}: {note}")
    if order.summary:
        _keep(source.columns, order.index)
        warn("SWM057", f"{source.path.name}: {order.summary}")
    return order


def _add_pose(
    source: MappedLog, request: Request | None, metadata: dict[str, Any]
) -> tuple[Posed | None, list[str]]:
    """Add pose and joint angles from tracked points to a log and its metadata, in place, if requested.

    The second result has the columns of the points, whose motion is that of the pose and the joints.
    """
    if request is None:
        return None, []
    columns = source.columns
    if log.is_written_by(metadata, "swimid track"):
        metadata["tracked_by"] = metadata.pop("made_by")
        point_files.keep_markers(columns)
    found = pose_of(columns, request, source.path)
    metadata |= found.metadata
    source.sources.update(dict.fromkeys(found.columns, ("tracked points", 1.0, 0.0)))
    rest = {name: columns.pop(name) for name in list(columns) if name not in (TIME, *found.columns)}
    columns |= found.columns | rest
    markers = tuple(f"{name}_" for name in found.fit.linkage.names)
    return found, [name for name in rest if name.startswith(markers)]


def _keep(columns: dict[str, Array], rows: NDArray[Any]) -> None:
    """Keep only the given rows in all columns of a log, in place."""
    for name in columns:
        columns[name] = columns[name][rows]


def _doubt_amplitudes(stroke: StrokeEstimate) -> list[Doubt]:
    """Return a :class:`Doubt` about each angle that oscillates with an amplitude above 180 degrees.

    No joint of a robot can move so far, so that the values of such an angle are probably in degrees.
    """
    text = "swings by ±{:.3g} rad: state the unit if it is degrees (a factor of 57.3)"
    beats = {name: beat.amplitude for name, beat in stroke.channels.items() if name.endswith("_rad")}
    return [Doubt(name, text.format(size)) for name, size in beats.items() if size > np.pi]


def _compare_columns(columns: dict[str, Array], period_s: float | None, name: str) -> list[ColumnComparison]:
    """Return the comparisons of columns that show the same motion; warn of those that contradict."""
    comparisons = consistency.compare_columns(columns, period_s)
    for one in comparisons:
        if one.doubtful:
            warn("SWM063", f"{name}, '{one.column}': {one.text}")
        elif one.text:
            warn("SWM090", f"{name}, '{one.column}': {one.text} (against {one.against}: {one.gain:.3g})")
    return comparisons


def _remove_jumps(source: MappedLog, lines: NDArray[np.int64], clean: bool | None) -> dict[str, Jumped]:
    """Return the jumps and spikes of the channels of a log, each by a message on it; warn of them.

    A track that swimid computed is not searched, unless ``clean`` asks for it.
    """
    if not clean and log.is_written_by(source.metadata, "swimid track"):
        return {}
    found = {_describe(one, source, lines, clean is not False): one for one in find_jumped(source.columns)}
    for text in found:
        warn("SWM058", f"{source.path.name}: {text}")
    return found


def _describe(one: Jumped, source: MappedLog, lines: NDArray[np.int64], cleaned: bool) -> str:
    """Return a message on the jumps of a channel: their number, their lines, and the code of missing samples.

    ``lines`` has the line of each row of the log in the file of ``source``.
    """
    ends = runs(one.out)
    places = [
        f"{lines[first]} to {lines[end - 1]}".removesuffix(f" to {lines[first]}") for first, end in ends[:5]
    ]
    more, told = ", ..." * (len(ends) > 5), []
    if len(ends):
        left, count = ("kept", "left out")[int(cleaned)], int(one.out.sum())
        told.append(f"{count} samples in {len(ends)} jumps {left} (lines {', '.join(places)}{more})")
    if one.elsewhere:
        told.append(f"goes on at another value in line {', '.join(map(str, lines[one.elsewhere[:5]]))}")
    codes = {consistency.find_code(source.columns[column][one.out]) for column in one.columns if len(ends)}
    if len(codes) == 1 and (code := codes.pop()) is not None:
        _, factor, offset = source.sources.get(one.columns[0], ("", 1.0, 0.0))
        value = f"{(code - offset) / factor + 0.0:.6g}"
        hint = f"if it marks missing samples, write reader: {{missing: [{value}]}} in the mapping"
        told.append(f"they hold exactly {value}: {hint}")
    return f"{', '.join(one.columns)}: {'; '.join(told)}"


def _take_out(
    columns: dict[str, Array],
    cleaning: Cleaning | None,
    jumped: list[Jumped],
    name: str,
    metadata: dict[str, Any],
) -> None:
    """Remove jumps and spikes of channels, and repeated samples and jumps of a track, from a log, in place.

    Each such sample becomes NaN. A row in which no value is left is removed.
    """
    columns |= {n: np.where(one.out, np.nan, columns[n]) for one in jumped for n in one.columns}
    # A reader that unwraps attitudes counts a full turn for a jump of the heading by more than half a turn.
    columns |= {n: log.unwrap(columns[n]) for one in jumped for n in one.columns if n in ANGLES}
    empty = np.any([np.zeros(len(columns[TIME]), dtype=bool), *(one.out for one in jumped)], axis=0)
    if cleaning is not None:
        empty |= _take_out_track(columns, cleaning, name, metadata)
    for column, values in columns.items():
        if column != TIME and empty.any():
            empty &= np.isnan(values)
    if empty.any():
        _keep(columns, ~empty)


def _take_out_track(
    columns: dict[str, Array], cleaning: Cleaning, name: str, metadata: dict[str, Any]
) -> NDArray[np.bool_]:
    """Set repeated samples and jumps of a track to NaN, in place; return flags of these samples."""
    done = metadata["track_cleaned"] = {**cleaning.counts, "gaps": len(cleaning.gaps)}
    elsewhere = [float(columns[TIME][row]) for row in cleaning.offset_rows]
    if elsewhere:
        at = ", ".join(f"{time:.6g} s" for time in elsewhere[:5])
        warn("SWM059", f"{name}: the track jumps to another position at {at}")
        done["elsewhere_s"] = elsewhere
    out, good = cleaning.repeated | cleaning.jumped, int(cleaning.good.sum())
    if not out.any():
        return out
    if len(out) >= 2 * track_speed.MIN_SAMPLES_SPEED and good < track_speed.MIN_SAMPLES_SPEED:
        text = f"{name}: only {good} of {len(out)} samples are valid (no repeats, no jumps)"
        hint = "--raw keeps all samples; is this a track of positions in metres?"
        raise NoTrustworthyResult(text, hint=hint)
    lost = f"{done['samples_jumped']} samples of {done['jumps']} jumps"
    warn("SWM058", f"{name}: {done['repeats']} repeated samples and {lost} are left out of the track")
    for column in columns:
        if re.fullmatch(r"[xyz]_(m|px)", column) or column in ANGLES:
            columns[column] = np.where(out, np.nan, columns[column])
    return out


def _check_stroke(stroke: StrokeEstimate, stated_hz: float | None, name: str) -> str:
    """Return a message if the stroke contradicts the metadata; warn of this and of a doubtful stroke."""
    against = ""
    if stroke.beat and stated_hz is not None and (text := contradiction(stroke.beat, stated_hz)):
        against = f"{stroke.channel} {text}; the metadata say {stated_hz:g} Hz"
        warn("SWM032", f"{name}: {against}")
    if stroke.doubt:
        warn("SWM033", f"{name}: {stroke.doubt}")
    return against


def _select_measured(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the columns of a log, with the poses as they were before smoothing and interpolation.

    A log written by ``swimid track`` has the positions before smoothing in separate columns. Interpolated
    samples become NaN.
    """
    raw = {_RAW.sub(r"\1_\2", name): values for name, values in columns.items() if _RAW.fullmatch(name)}
    bridged = columns.get("interpolated")
    if not raw or bridged is None:
        return columns
    pose = {name: raw.get(name, values) for name, values in columns.items() if _OF_POSE.fullmatch(name)}
    return columns | {name: np.where(bridged == 1, np.nan, values) for name, values in pose.items()}


# ---------------------------------------------------------------- evidence

#: Minimum number of samples of a log, and of values of each channel, for the checks of an imported log.
MIN_SAMPLES_STROKE = LONG_ENOUGH + 1
#: Minimum number of track samples per stroke. With fewer samples the path of the robot between two samples is
#: not known.
MIN_SAMPLES_PER_STROKE = 6.0
#: Limits of a usable log. MAX_DROPPED is the maximum fraction of its rows that are left out because of a
#: missing or repeated time. MAX_FROZEN is the maximum fraction of its duration in which a channel is frozen.
#: Frozen samples stay in the log: a fraction of 1 % changes an amplitude or a mean speed by at most 1 %,
#: which is the accuracy of both in a track (docs/tracking.md).
MAX_DROPPED, MAX_FROZEN = 0.1, 0.01
#: Pattern of the columns whose values are compared with the limits of a swimmer
#: (:func:`swimid.logs.log.doubts`).
LIMITED = re.compile(r"[xyz]_m|.*_(rad|rad_s|m_s)")
IMPORT_METHODS = [
    "Repeated pictures and jumps of a track are found by a Hampel identifier on its steps. The mean speed is "
    "taken along cubic smoothing splines and corrected for the noise by a parametric bootstrap.",
    "The stroke frequency is the slope of the phases of a sine fitted in windows of two cycles beside a "
    "cubic drift, by generalised least squares.",
]
MEAN_METHOD = (
    "Every {} successive rows of the recording were averaged, which suppresses frequencies above the new "
    "rate. A pause in the time stamps ends an average."
)
MEAN_NOTE = "The checks of all rows ran on the {} rows of the recording, the other checks on their {} means."
REFERENCES = [
    "Pearson, R. K., Neuvo, Y., Astola, J., Gabbouj, M. (2016). Generalized Hampel filters. EURASIP "
    "Journal on Advances in Signal Processing 2016:87. doi:10.1186/s13634-016-0383-6",
    "Craven, P., Wahba, G. (1979). Smoothing noisy data with spline functions. Numerische Mathematik 31, "
    "377-403. doi:10.1007/BF01404567",
]


def _evidence(found: Examined, origin: dict[str, Any], notices: Sequence[Notice]) -> Evidence:
    """Return the evidence of an imported log: checks, tables, figures and notices."""
    checks = [*_amount_checks(found), *_value_checks(found), *_track_checks(found), *_stroke_checks(found)]
    methods, references = [*IMPORT_METHODS], [] if found.cleaning is None else [*REFERENCES]
    notes = []
    if found.mapped.all_rows is not None:
        checks += _all_rows_checks(found.mapped.all_rows)
        methods.insert(0, MEAN_METHOD.format(found.mapped.all_rows.every))
        notes.append(MEAN_NOTE.format(found.mapped.all_rows.rows, len(found.mapped)))
    with record_warnings(repeat=True) as drawn:
        shown = figures_of([found.log], found=found.stroke)
    if found.posed is not None:
        checks += point_evidence.checks(found.posed)
        shown += point_evidence.figures(found.posed, found.wave)
        methods += point_evidence.POINT_METHODS
        references += point_evidence.REFERENCES
    return Evidence(
        command="import",
        title=f"Log imported from {found.log.path.name}",
        verdict=make_verdict(
            f"{len(found.log.time_s)} samples in {len(found.log.columns) - 1} channels.", checks
        ),
        facts=_facts(found),
        checks=checks,
        tables=_tables(found),
        figures=shown,
        notices=[*notices, *drawn],
        notes=notes,
        methods=methods,
        references=references,
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
    """Return a check of an imported log, whose verdict is pass, warn, fail or "not judged".

    The verdict is "not judged" if nothing is wrong but the data do not allow the check (``made`` is False).
    ``reason`` says what is wrong if the check does not pass. By default ``value`` is the reason, or the limit
    if the check passes. A check that does not pass is a warning, or a failure with ``fails``.
    """
    if passed and not made:
        return make_check(name, "not judged", None, limit, "no channel allows it, or the samples are too few")
    text = "" if passed or value in reason else reason
    value = value or (limit if passed else reason)
    return make_check(name, value, passed, limit, text, otherwise="fail" if fails else "warn", reason=reason)


def _amount_checks(found: Examined) -> list[Check]:
    """Return the checks that the rows, the columns and the times of an imported log are complete."""
    time, n, rows = found.log.time_s, len(found.log.time_s), len(found.mapped)
    counts = {name: int(np.isfinite(values).sum()) for name, values in found.log.signals.items()}
    scarce = [f"{name} ({count} of {n})" for name, count in counts.items() if count < MIN_SAMPLES_STROKE]
    few = f"too few values to judge {', '.join(scarce)}: a channel needs {MIN_SAMPLES_STROKE}"
    if n < MIN_SAMPLES_STROKE:
        few = f"{n} samples are too few to judge a log, which needs {MIN_SAMPLES_STROKE}"
    last = int(np.argmax(np.diff(time)))
    pause_s = float(time[last + 1] - time[last])
    long = n >= MIN_SAMPLES_STROKE and pause_s > 0.5 * (time[-1] - time[0])
    pause = (
        f"no sample lies between {time[last]:.6g} s and {time[last + 1]:.6g} s, more than half of the log: "
        "do the times count from two origins?"
    )
    counted, notes = found.order.counts, found.mapped.notes
    odd, dropped = sum(counted.values()), counted["untimed"] + counted["clashing"]
    many = dropped > MAX_DROPPED * rows
    remarks = "; ".join([found.order.summary] * (odd > 0) + notes)
    if many:
        remarks = f"{dropped} of {rows} rows have no time, or that of another row: is the time complete?"
    names = ", ".join(found.mapped.unknown)
    open_ = f"the quantity of {names} is not stated: map each to a name with a unit, or to unit: '1'"
    least, longest = str(min(counts.values())), numbers.format_number(pause_s, 3, "s")
    checks = [
        _check(
            "Samples",
            not scarce,
            f"≥ {MIN_SAMPLES_STROKE} in a channel",
            few,
            least,
            fails=not any(counts.values()),
        ),
        _check("Longest pause", not long, "≤ half of the log", pause, longest, made=n >= MIN_SAMPLES_STROKE),
        _check("Rows in order", not (odd or notes), "none", remarks, f"{odd} of {rows} odd", fails=many),
        _check("Quantity of every column", not names, "known", open_, names, fails=True),
    ]
    # Fail the check of the sample rate if the metadata of a mapping say that the rate is assumed.
    if found.log.metadata.get("sample_rate") == "assumed":
        why = "the sample rate is assumed, and its error is an error of all speeds and frequencies"
        checks.append(_check("Sample rate", False, "stated", why, "assumed", fails=True))
    for name, count in found.mapped.unlikely.items():
        why = f"{count} of {rows} samples are left empty for their {name}"
        checks.append(_check(f"Samples by {name}", False, "none", why, f"{count} of {rows}"))
    return checks


def _value_checks(found: Examined) -> list[Check]:
    """Return the checks for uneven sampling and for contradicting, frozen, faulty or unusual channels."""
    stuck = find_frozen(found.log.time_s, _select_measured(found.log.columns))
    scales = {target: factor for target, (_, factor, _) in found.mapped.sources.items()}
    wrong = [one for one in found.comparisons if one.text]
    failed = not all(one.doubtful for one in wrong)
    disagree = "; ".join(f"{one.column} {one.text} (against {one.against})" for one in wrong)
    holds = "; ".join(f"{name} from {a:.4g} to {b:.4g} s" for name, (a, b) in stuck.items())
    faults = "; ".join(f"{name} {text}" for name, text in find_unmeasured(found.log.columns, scales).items())
    doubts = "; ".join(f"{doubt.column} {doubt.text}" for doubt in found.doubts)
    frozen, faulty = f"channels hold one value amid their motion: {holds}", f"channels look faulty: {faults}"
    span_s, jumps = np.ptp(found.log.time_s), "; ".join(found.jumped)
    lossy = any(one.out.mean() > MAX_JUMPED for one in found.jumped.values())
    long_held = any(end - begin > MAX_FROZEN * span_s for begin, end in stuck.values())
    uneven = f"the sampling is uneven{', in bursts' * found.bursts}: {found.uneven}"
    enough = len(found.log.time_s) >= MIN_SAMPLES_STROKE
    channels = {name: values for name, values in found.log.signals.items() if not SET.fullmatch(name)}
    long = any(np.isfinite(values).sum() >= MIN_SAMPLES_STROKE for values in channels.values())
    continuous = any(may_freeze(*channel) for channel in found.log.signals.items())
    limited = enough and any(map(LIMITED.fullmatch, found.log.signals))
    return [
        _check("Columns agree", not wrong, "all", disagree, made=bool(found.comparisons), fails=failed),
        _check("Sampling", not found.uneven, "even", uneven, found.uneven, made=enough, fails=found.bursts),
        _check("Jumps of channels", not jumps, "none", jumps, jumps, made=long, fails=lossy),
        _check("Frozen channels", not holds, "none", frozen, holds, made=continuous, fails=long_held),
        _check("Faulty channels", not faults, "none", faulty, faults, made=long),
        _check(POSSIBLE, not doubts, "within", doubts, "beyond" if doubts else "", made=limited),
    ]


def _all_rows_checks(all_rows: RowStatistics) -> list[Check]:
    """Return the checks that ran on all rows of a recording whose rows were averaged."""
    rows, odd = all_rows.rows, all_rows.backwards + all_rows.repeated + all_rows.untimed
    counts = f"{all_rows.backwards} go back, {all_rows.repeated} repeat, {all_rows.untimed} are missing"
    times, lost = f"of the {rows} time stamps before averaging, {counts}", odd > MAX_DROPPED * rows
    faults = "; ".join(f"{name} {text}" for name, text in all_rows.faults().items())
    faulty = f"channels look faulty in the rows before averaging: {faults}"
    return [
        _check("Time stamps of all rows", not odd, "increase", times, counts, fails=lost),
        _check("Values of all rows", not faults, "no outlier, not cut off", faulty, faults),
    ]


def _track_checks(found: Examined) -> list[Check]:
    cleaning = found.cleaning
    if cleaning is None:
        return []
    lost, repeats = cleaning.counts["samples_jumped"], cleaning.counts["repeats"]
    seen, done = int(cleaning.good.sum()) + repeats + lost, found.treatment
    held = "the track holds repeated pictures (--clean leaves them out)"
    jumps = f"the track jumps {cleaning.jumps} times ({lost} samples {done})"
    if cleaning.offset_rows:
        jumps += f" and continues at another place {len(cleaning.offset_rows)} times"
    lossy = lost > MAX_JUMPED * seen or not found.cleaned
    longest_s = max((end - start for start, end in cleaning.gaps), default=0.0)
    gaps = f"{len(cleaning.gaps)}, longest {numbers.format_number(longest_s, 3, 's')}"
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
    if stroke.beat is None:
        return []
    checks = []
    if found.speed is not None and found.cleaning is not None:
        count = float(found.cleaning.good.sum()) / found.speed.covered_s / stroke.beat.frequency_hz
        value, limit = numbers.format_number(count, 3), f"≥ {MIN_SAMPLES_PER_STROKE:g}"
        why = f"the track has {value} samples a stroke, too few to know the path between them"
        checks.append(_check("Samples a stroke", count >= MIN_SAMPLES_PER_STROKE, limit, why, value))
    value = " against ".join(f"{b.frequency_hz:.4g} Hz" for b in (stroke.beat, *stroke.rivals.values()))
    limit = "no channel beats at another frequency"
    checks.append(_check("One stroke", not stroke.doubt, limit, stroke.doubt, value))
    if "frequency_hz" in found.log.metadata:
        name, stated = "Stroke against the metadata", f"{found.log.metadata['frequency_hz']} Hz"
        checks.append(_check(name, not found.against, stated, found.against, _frequency(stroke.beat)))
    return checks


def _facts(found: Examined) -> dict[str, str]:
    """Return stroke, track and speed of an imported log as texts, for the list of facts in its report."""
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    facts = {"Stroke": f"unknown: {stroke.unknown}"}
    if stroke.beat is not None:
        facts["Stroke"] = f"{_frequency(stroke.beat)} in {stroke.channel}"
        if stroke.maybe_double:
            facts["Stroke"] += ", may be twice the stroke: no channel that swings sideways is there"
    if cleaning is not None:
        counts, gaps = cleaning.counts, f"{len(cleaning.gaps)} gaps kept"
        facts["Track"] = f"{counts['repeats']} repeats and {counts['jumps']} jumps {found.treatment}, {gaps}"
    if speed is not None:
        path, straight = (f"{mean.value:.4g} {found.unit}/s" for mean in (speed.path, speed.line))
        facts["Speed"] = f"{path} along the path, {straight} along the line"
    for name, one in found.log.metadata.get("clock_offsets", {}).items():
        offset = numbers.format_estimate(one["offset_s"], one["sd_s"], "s")
        facts[f"Clock of {name}"] = f"{offset} added, by {one['by']}, with any lag between them"
    if found.posed is not None:
        facts |= point_evidence.facts(found.posed)
    return facts


def _tables(found: Examined) -> list[Table]:
    """Return two tables of an imported log: its mean speeds, and the source of each of its columns."""
    tables, speed, unit = [], found.speed, found.unit
    if speed is not None:
        rows: list[list[Any]] = [
            ["along the path", speed.path.value, speed.path.low, speed.path.high],
            ["along the line from start to end", speed.line.value, speed.line.low, speed.line.high],
        ]
        noise = numbers.format_number(speed.noise, 3, unit)
        caption = f"Over {speed.covered_s:.4g} s without the gaps; the noise of a coordinate is {noise}."
        columns = ["mean speed", f"{unit}/s", "95 % from", "to"]
        tables.append(Table(id="speed", title="Mean speed", columns=columns, rows=rows, caption=caption))
    if found.mapped.all_rows is not None:
        tables.append(_all_rows_table(found.mapped.all_rows))
    rows = [[name, *found.mapped.sources.get(name, (name, 1.0, 0.0))] for name in found.log.columns]
    columns, title = ["column", "source", "factor", "offset"], "Sources of the columns"
    if found.posed is not None:
        # The first table is printed.
        tables += point_evidence.tables(found.posed, found.wave)
        tables.sort(key=lambda table: table.id != "places")
    return [*tables, Table(id="columns", title=title, columns=columns, rows=rows, folded=True)]


def _all_rows_table(all_rows: RowStatistics) -> Table:
    """Return the table of the statistics of all rows of a recording, before they were averaged."""
    columns = ["channel", "samples", "missing", "mean", "standard deviation", "minimum", "maximum", "hold"]
    rows = [[name, *one.data.values()] for name, one in all_rows.channels.items()]
    caption = (
        f"Of all {all_rows.rows} rows. The time steps are {all_rows.shortest_s:.6g} to "
        f"{all_rows.longest_s:.6g} s, {all_rows.pauses} of them pauses. A hold is the maximum number of "
        "successive samples with one value."
    )
    return Table(id="all-rows", title="Statistics of all rows", columns=columns, rows=rows, caption=caption)


def _frequency(beat: Beat) -> str:
    return numbers.format_estimate(beat.frequency_hz, beat.stderr_hz, "Hz")


def _all_rows_data(all_rows: RowStatistics) -> dict[str, Any]:
    """Return the statistics of all rows of a recording as plain data."""
    channels = {name: one.data for name, one in all_rows.channels.items()}
    counts = ("every", "rows", "untimed", "backwards", "repeated", "pauses", "shortest_s", "longest_s")
    return {name: getattr(all_rows, name) for name in counts} | {"channels": channels}


def _data(found: Examined, proof: Evidence) -> dict[str, Any]:
    """Return the results of the import of a log as plain data (numbers, text, lists and dicts)."""
    time, unit = found.log.time_s, found.unit
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    made: dict[str, Any] = {
        "file": str(found.log.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": 1 / sampling.rate(time).step_s,
        "columns": list(found.log.columns),
        "missing": {name: int(np.isnan(values).sum()) for name, values in found.log.signals.items()},
        "rows": found.order.counts,
        "notes": found.mapped.notes,
        "profile": found.mapped.profile,
        "unlikely": found.mapped.unlikely,
        "jumps": {", ".join(one.columns): int(one.out.sum()) for one in found.jumped.values()},
        "contradictions": [asdict(one) for one in found.comparisons if one.text],
        "stroke": {"unknown": stroke.unknown},
        **dict.fromkeys(("track", "speed", "points", "wave")),
        "verdict": proof.verdict.model_dump(),
        "checks": [check.model_dump() for check in proof.checks],
    }
    if found.mapped.all_rows is not None:
        made["all_rows"] = _all_rows_data(found.mapped.all_rows)
    if cleaning is not None:
        made["track"] = {
            "cleaned": found.cleaned,
            **cleaning.counts,
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        }
    if speed is not None:
        made["speed"] = {f"noise_{unit}": speed.noise, "covered_s": speed.covered_s}
        for name, mean in (("path", speed.path), ("line", speed.line)):
            made["speed"] |= {f"{name}_{unit}_s": mean.value, f"{name}_ci95": [mean.low, mean.high]}
    if found.posed is not None:
        made["points"] = found.posed.data
        if found.wave is not None:
            made["wave"] = point_evidence.wave_data(found.wave, found.posed.unit)
    if stroke.beat is not None:
        made["stroke"] = {
            "frequency_hz": stroke.beat.frequency_hz,
            "stderr_hz": stroke.beat.stderr_hz,
            "ci95_hz": list(stroke.beat.interval_hz),
            "period_s": 1.0 / stroke.beat.frequency_hz,
            "cycles": stroke.beat.cycles,
            "channel": stroke.channel,
            "maybe_double": stroke.maybe_double,
            "channels_hz": {n: b.frequency_hz for n, b in stroke.channels.items()},
            "rivals_hz": {n: b.frequency_hz for n, b in stroke.rivals.items()},
            "contradiction": found.against or None,
        }
    return made
