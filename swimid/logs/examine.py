"""Cleaning and examination of a foreign log: row order, track, speed and stroke."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.logs import clock, log, rhythm, sampling, tracks
from swimid.logs.beat import contradiction
from swimid.logs.clock import Order
from swimid.logs.consistency import Comparison, compare_columns
from swimid.logs.log import TIME, Doubt
from swimid.logs.mapping import MappedLog
from swimid.logs.options import ImportOptions
from swimid.logs.rhythm import Rhythm
from swimid.logs.tracks import Cleaning, TrackSpeed
from swimid.notices import warn

Array = NDArray[np.float64]
METRES = ("x_m", "y_m", "z_m")
PIXELS = ("x_px", "y_px", "z_px")
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
#: Beginnings of the names of pose columns, and of the rates that are computed from a pose.
_POSE, _POSE_RATES = ("x", "y", "z", "yaw", "pitch", "roll"), ("u", "v", "w", "vx", "vy", "vz")


@dataclass(frozen=True)
class Examined:
    """Foreign log with its rows in order, together with the findings of the examination.

    Attributes
    ----------
    mapped : MappedLog
        The log. Its columns are changed to those that are written to the log.
    metadata : dict
        Metadata as they are written to the log.
    order : Order
        Rows that were moved or left out.
    cleaning : Cleaning or None
        Repeated samples, jumps and gaps of the track; None without a track.
    cleaned : bool
        Whether repeated samples and jumps were left out of the log.
    speed : TrackSpeed or None
        Speed of the track.
    stroke : Rhythm or None
        Stroke; None if none is found.
    against : str
        Words that say how the stroke contradicts the metadata; empty if both agree.
    unknown : str
        Reason why no stroke is found; empty if one is found.
    doubts : list of Doubt
        Columns with values that no swimmer reaches.
    comparisons : list of Comparison
        Comparisons of columns that show the same motion.
    uneven : str
        Range of the time steps of uneven sampling, in words; empty for even sampling.
    bursts : bool
        Whether the samples are stamped in bursts.
    """

    mapped: MappedLog
    metadata: dict[str, Any]
    order: Order
    cleaning: Cleaning | None
    cleaned: bool
    speed: TrackSpeed | None
    stroke: Rhythm | None
    against: str
    unknown: str
    doubts: list[Doubt]
    comparisons: list[Comparison]
    uneven: str
    bursts: bool

    @property
    def path(self) -> Path:
        """Path of the foreign log."""
        return self.mapped.path

    @property
    def columns(self) -> dict[str, Array]:
        """Columns as they are written to the log."""
        return self.mapped.columns

    @property
    def time_s(self) -> Array:
        """Sample times, s, shape (n,)."""
        return self.columns[TIME]

    @property
    def unit(self) -> str:
        """Unit of the track: m or px."""
        return "px" if set(_track(self.columns)) & set(PIXELS) else "m"

    @property
    def channels(self) -> dict[str, Array]:
        """Columns of the log except the time."""
        return {name: values for name, values in self.columns.items() if name != TIME}

    @property
    def done(self) -> str:
        """Words for the treatment of repeated samples and jumps of the track."""
        return "left out" if self.cleaned else "kept"

    @property
    def contradictions(self) -> list[Comparison]:
        """Comparisons of columns that disagree."""
        return [one for one in self.comparisons if one.text]


def examine(source: MappedLog, options: ImportOptions) -> Examined:
    """Clean a foreign log and its track, and find the speed and the stroke.

    ``source.columns`` is changed in place, so that a long log is in memory only once.

    Raises
    ------
    InputError
        No sample has a time, or the clock is reset within the log.
    NoTrustworthyResult
        A cleaned track has fewer samples than :data:`swimid.logs.tracks.MIN_SAMPLES`.
    """
    name, columns = source.path.name, source.columns
    order = _in_order(source)
    for note in source.notes:
        warn("SWM057", f"{name}: {note}")
    if order.changed:
        _keep(columns, order.index)
        warn("SWM057", f"{name}: rows {order.summary}")
    uneven = sampling.find_uneven(columns[TIME])
    metadata = dict(source.metadata) | {"source": name, "imported_by": "swimid import"}
    coordinates, known = _track(columns), measured(columns)
    cleaned = options.clean
    if cleaned is None:
        cleaned = len(coordinates) > 1 and not log.written_by(source.metadata, "swimid track")
    cleaned = cleaned and bool(coordinates)
    cleaning = speed = None
    if len(coordinates) > 1 or cleaned:
        track = [known[column] for column in coordinates]
        angles = [known[column] for column in ANGLES if column in columns]
        stamps = columns[TIME]
        cleaning = tracks.clean(stamps, track, angles)
        if cleaned:
            _take_out(columns, cleaning, name, metadata)
    channels = {column: v for column, v in measured(columns).items() if column != TIME}
    times, times_sd_s = columns[TIME], 0.0
    if cleaning is not None and cleaning.held is not None:
        times_sd_s = cleaning.held.lateness_s / np.sqrt(12.0)
        measured_s = np.interp(times, stamps, cleaning.held.measured_s)
        if (np.diff(measured_s) > 0).all():  # false if other channels have rows between pictures
            times, times_sd_s = measured_s, cleaning.held.measured_sd_s
    stated_hz = metadata.get("frequency_hz")
    if isinstance(stated_hz, bool) or not isinstance(stated_hz, int | float) or not stated_hz > 0:
        stated_hz = None
    stroke = rhythm.find(times, channels, range_hz=options.stroke_hz, stated_hz=stated_hz)
    unknown, against, periodic_hz, period_s = "", "", None, None
    if stroke is None:
        unknown, periodic_hz = rhythm.explain_missing(columns[TIME], channels)
    else:
        stroke = rhythm.add_time_error(stroke, times_sd_s, times)
        periodic_hz, period_s = stroke.beat.frequency_hz, stroke.period_s[0]
        against = _against(stroke, stated_hz, name)
    if cleaning is not None:
        speed = tracks.speed(stamps, track, cleaning, periodic_hz)
    doubts = [*log.doubts(columns[TIME], columns), *_bent(stroke)]
    for doubt in doubts:
        warn("SWM002", f"{name}, '{doubt.column}': {doubt.text}")
    comparisons = compare_columns(columns, period_s)
    for one in comparisons:
        if one.text:
            warn("SWM090", f"{name}, '{one.column}': {one.text} (against {one.against}: {one.gain:.3g})")
    return Examined(
        source,
        metadata,
        order,
        cleaning,
        cleaned,
        speed,
        stroke,
        against,
        unknown,
        doubts,
        comparisons,
        *uneven,
    )


def _in_order(source: MappedLog) -> Order:
    """Return the row order with strictly increasing times; raise an error if the clock was reset."""
    channels = {name: values for name, values in source.columns.items() if name != TIME}
    order = clock.in_order(source.time_s, channels)
    if len(order.index) < 2:
        text = f"{len(order.index)} of {len(source)} rows have a time of their own; at least 2 are needed"
        raise InputError(text, file=source.path, column=TIME, hint="is the time complete?")
    if order.reset_row is not None:
        last = np.nanmax(source.time_s[: order.reset_row])
        text = f"the clock starts again: {source.time_s[order.reset_row]:g} s after {last:g} s"
        line = int(source.rows[order.reset_row])
        hint = "split the file there, or state the range of a counter: 'wraps_at: 65536' under 'time:'"
        raise InputError(text, file=source.path, line=line, column=TIME, hint=hint)
    return order


def _keep(columns: dict[str, Array], rows: NDArray[Any]) -> None:
    """Reduce all columns to the given rows, in place."""
    for name in columns:
        columns[name] = columns[name][rows]


def _track(columns: dict[str, Array]) -> list[str]:
    """Return the names of the track's columns: in metres if the log has them, else in pixels."""
    return [n for n in METRES if n in columns] or [n for n in PIXELS if n in columns]


def _bent(stroke: Rhythm | None) -> list[Doubt]:
    """Return a doubt for each angle that oscillates over more than 180 degrees, which no joint can."""
    if stroke is None:
        return []
    text = "swings by ±{:.3g} rad: state the unit if it is degrees (a factor of 57.3)"
    beats = {name: beat.amplitude for name, beat in stroke.channels.items() if name.endswith("_rad")}
    return [Doubt(name, text.format(size)) for name, size in beats.items() if size > np.pi]


def _take_out(columns: dict[str, Array], cleaning: Cleaning, name: str, metadata: dict[str, Any]) -> None:
    """Empty the pose of repeated samples and of jumps in place, and remove rows that hold nothing else."""
    done = metadata["track_cleaned"] = {**cleaning.counts, "gaps": len(cleaning.gaps)}
    elsewhere = [float(columns[TIME][row]) for row in cleaning.offset_rows]
    if elsewhere:
        at = ", ".join(f"{time:.6g} s" for time in elsewhere[:5])
        warn("SWM059", f"{name}: the track goes on elsewhere at {at}")
        done["elsewhere_s"] = elsewhere
    out, good = cleaning.repeated | cleaning.jumped, int(cleaning.good.sum())
    if not out.any():
        return
    if len(out) >= 2 * tracks.MIN_SAMPLES and good < tracks.MIN_SAMPLES:
        text = f"{name}: of {len(out)} samples {good} are no repeats or jumps: no track"
        raise NoTrustworthyResult(text, hint="--raw keeps them all; is this a track of positions in metres?")
    lost = f"{done['samples_jumped']} samples of {done['jumps']} jumps"
    warn("SWM058", f"{name}: {done['repeats']} repeated samples and {lost} left out of the track")
    empty = out.copy()
    for column, values in columns.items():
        if column in (*METRES, *PIXELS, *ANGLES):
            columns[column] = np.where(out, np.nan, values)
        elif column != TIME:
            empty &= np.isnan(values)
    _keep(columns, ~empty)


def _against(stroke: Rhythm, stated_hz: float | None, name: str) -> str:
    """Return words that say how a stroke contradicts the metadata; warn of this and of a doubtful stroke."""
    against = ""
    if stated_hz is not None and (text := contradiction(stroke.beat, stated_hz)):
        against = f"{stroke.channel} {text}; the metadata say {stated_hz:g} Hz"
        warn("SWM032", f"{name}: {against}")
    if stroke.doubt:
        warn("SWM033", f"{name}: {stroke.doubt}")
    return against


def measured(columns: dict[str, Array]) -> dict[str, Array]:
    """Return the columns as they were measured.

    In a log written by ``swimid track`` the measured positions are those before smoothing, with NaN where a
    gap was interpolated.
    """
    raw = {name: columns[raw] for name in columns if (raw := _raw(name)) in columns}
    bridged = columns.get("interpolated")
    if not raw or bridged is None:
        return columns
    pose = {name: raw.get(name, values) for name, values in columns.items() if _of_pose(name)}
    return columns | {name: np.where(bridged == 1, np.nan, values) for name, values in pose.items()}


def _raw(name: str) -> str:
    """Return the name of the raw column (before smoothing) of a pose column; empty for other columns."""
    stem, _, unit = name.partition("_")
    return f"{stem}_raw_{unit}" if stem in _POSE else ""


def _of_pose(name: str) -> bool:
    """Return whether a column is part of a pose or a rate of change of the pose."""
    stem, _, rest = name.partition("_")
    if stem in _POSE:
        return bool(rest)
    return stem in _POSE_RATES and rest.replace("sd_", "") in ("m_s", "px_s", "m_s2", "px_s2")
