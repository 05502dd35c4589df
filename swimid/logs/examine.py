"""A foreign log put in order: cut, scaled and projected as asked, its track cleaned, its stroke found."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.logs import (
    clock,
    consistency,
    log,
    rhythm,
    tracks,
)
from swimid.logs.beat import contradiction
from swimid.logs.clock import Order
from swimid.logs.consistency import Contradiction
from swimid.logs.log import Doubt
from swimid.logs.mapping import MappedLog
from swimid.logs.options import ImportOptions, direction
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import find_frozen, find_uneven
from swimid.logs.tracks import Cleaning, TrackSpeed
from swimid.notices import warn

Array = NDArray[np.float64]
METRES = ("x_m", "y_m", "z_m")
PIXELS = ("x_px", "y_px", "z_px")
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
#: What columns of a pose begin with, and those that follow from it.
_POSE, _POSE_SPEEDS = ("x", "y", "z", "yaw", "pitch", "roll"), ("u", "v", "w", "vx", "vy", "vz")


@dataclass(frozen=True)
class Projection:
    """A track along a line.

    Attributes
    ----------
    along : ndarray, shape (n,)
        Distance travelled along it from the first sample, NaN where the track has none.
    direction : ndarray, shape (d,)
        Unit vector.
    across : float
        Root mean square distance from the line through the mean place.
    extent : float
        Range of ``along``.
    """

    along: Array
    direction: Array
    across: float
    extent: float


@dataclass(frozen=True)
class Examined:
    """A foreign log in order, and what was found in it.

    Attributes
    ----------
    metadata, columns : dict
        As they are written.
    order : Order
        What was done to the rows.
    cleaning : Cleaning or None
        What was found in the track; None without one.
    cleaned : bool
        Whether that was left out of the log.
    speed : TrackSpeed or None
    stroke : Rhythm or None
    against : str or None
        How the stroke contradicts the metadata.
    unknown : str
        Why there is no stroke; empty where there is one.
    doubts : list of Doubt
        Values no swimmer reaches.
    projection : Projection or None
        The line the track was projected on.
    unit : str
        Of the track: m or px.
    mapped : MappedLog
        How the file was read; its columns are these.
    contradictions : list of Contradiction
        Columns that contradict each other.
    frozen : dict of str to (float, float)
        Longest stretch of each channel that is frozen, s (:func:`swimid.logs.sampling.find_frozen`).
    uneven : str
        How the sampling departs from an even one, in words; empty where it does not.
    bursts : bool
        Whether the stamps come in bursts.
    """

    metadata: dict[str, Any]
    columns: dict[str, Array]
    order: Order
    cleaning: Cleaning | None
    cleaned: bool
    speed: TrackSpeed | None
    stroke: Rhythm | None
    against: str | None
    unknown: str
    doubts: list[Doubt]
    projection: Projection | None
    unit: str
    mapped: MappedLog
    contradictions: list[Contradiction]
    frozen: dict[str, tuple[float, float]] = field(default_factory=dict)
    uneven: str = ""
    bursts: bool = False

    @property
    def path(self) -> Path:
        """The foreign log."""
        return self.mapped.path

    @property
    def time_s(self) -> Array:
        """Sample times, s."""
        return self.columns[log.TIME]


def examine(source: MappedLog, options: ImportOptions) -> Examined:
    """Put a foreign log in order, clean its track, and find its speed and stroke.

    ``source.columns`` is emptied on the way: a log of many samples is held once, not twice.

    Raises
    ------
    InputError
        No sample has a time, or the clock starts again within the log.
    NoTrustworthyResult
        Fewer samples of a cleaned track than :data:`swimid.logs.tracks.MIN_SAMPLES` stay of many.
    """
    name, columns = source.path.name, source.columns
    order = _in_order(source)
    for note in source.notes:
        warn("SWM057", f"{name}: {note}")
    if order.changed:
        _keep(columns, order.index)
        warn("SWM057", f"{name}: rows {order.summary}")
    _cut(columns, options, source)
    _to_metres(columns, options, source)
    uneven, bursts = find_uneven(columns[log.TIME])
    metadata = dict(source.metadata) | {"source": name, "imported_by": "swimid import"}
    coordinates, known = _track(columns), _measured(columns)
    cleaned = options.clean
    if cleaned is None:
        cleaned = len(coordinates) > 1 and not log.written_by(source.metadata, "swimid track")
    cleaned = cleaned and bool(coordinates)
    cleaning = speed = None
    if len(coordinates) > 1 or cleaned:
        track = [known[column] for column in coordinates]
        angles = [known[column] for column in ANGLES if column in columns]
        stamps = columns[log.TIME]
        cleaning = tracks.clean(stamps, track, angles)
        if cleaned:
            _take_out(columns, cleaning, name, metadata)
    telling = {column: v for column, v in _measured(columns).items() if column != log.TIME}
    times, times_sd_s = columns[log.TIME], 0.0
    if cleaning is not None and cleaning.held is not None:
        times_sd_s = cleaning.held.lateness_s / np.sqrt(12.0)
        measured_s = np.interp(times, stamps, cleaning.held.measured_s)
        if (np.diff(measured_s) > 0).all():  # else rows of other channels stand between the pictures
            times, times_sd_s = measured_s, cleaning.held.measured_sd_s
    stated = _stated(metadata)
    stroke = rhythm.find(times, telling, range_hz=options.stroke_hz, stated_hz=stated)
    unknown, against, periodic_hz, period_s = "", None, None, None
    if stroke is None:
        unknown, periodic_hz = rhythm.explain_missing(columns[log.TIME], telling)
    else:
        stroke = rhythm.add_time_error(stroke, times_sd_s, times)
        periodic_hz, period_s = stroke.beat.frequency_hz, stroke.period_s[0]
        against = _against(stroke, stated, name)
    if cleaning is not None:
        speed = tracks.speed(stamps, track, cleaning, periodic_hz)
    doubts = [*log.doubts(columns[log.TIME], columns), *_bent(stroke)]
    for doubt in doubts:
        warn("SWM002", f"{name}, '{doubt.column}': {doubt.text}")
    contradictions = consistency.contradictions(columns, period_s)
    for one in contradictions:
        warn("SWM090", f"{name}, '{one.column}': {one.text} (against {one.against}: {one.gain:.3g})")
    frozen = find_frozen(columns[log.TIME], telling)
    line = _along(columns, options, source)
    if line is not None:
        metadata["along"] = [float(part) for part in line.direction]
    return Examined(
        metadata=metadata,
        columns=columns,
        order=order,
        cleaning=cleaning,
        cleaned=cleaned,
        speed=speed,
        stroke=stroke,
        against=against,
        unknown=unknown,
        doubts=doubts,
        projection=line,
        unit=_unit(coordinates),
        mapped=source,
        contradictions=contradictions,
        frozen=frozen,
        uneven=uneven,
        bursts=bursts,
    )


def _in_order(source: MappedLog) -> Order:
    """How the rows get strictly increasing times; an error where they cannot."""
    channels = {name: values for name, values in source.columns.items() if name != log.TIME}
    order = clock.in_order(source.time_s, channels)
    if len(order.index) < 2:
        text = f"{len(order.index)} of {len(source)} rows have a time of their own; at least 2 are needed"
        raise InputError(text, file=source.path, column=log.TIME, hint="is the time complete?")
    if order.reset_row is not None:
        last = np.nanmax(source.time_s[: order.reset_row])
        text = f"the clock starts again: {source.time_s[order.reset_row]:g} s after {last:g} s"
        line, hint = int(source.rows[order.reset_row]), source.hint or "split the file there"
        raise InputError(text, file=source.path, line=line, column=log.TIME, hint=hint)
    return order


def _keep(columns: dict[str, Array], rows: NDArray[Any]) -> None:
    """Leave only these rows, in place."""
    for name in columns:
        columns[name] = columns[name][rows]


def _track(columns: dict[str, Array]) -> list[str]:
    """The columns of the track, in metres where both are there."""
    return [n for n in METRES if n in columns] or [n for n in PIXELS if n in columns]


def _unit(coordinates: list[str]) -> str:
    return "px" if coordinates and coordinates[0] in PIXELS else "m"


def _bent(stroke: Rhythm | None) -> list[Doubt]:
    """Return the angles that swing by more than half a turn to either side: a joint goes through itself."""
    beats = {} if stroke is None else stroke.channels
    text = "swings by ±{:.3g} rad: state the unit if it is degrees (a factor of 57.3)"
    bent = {n: b.amplitude for n, b in beats.items() if n.endswith("_rad") and b.amplitude > np.pi}
    return [Doubt(name, text.format(amplitude)) for name, amplitude in bent.items()]


def _take_out(columns: dict[str, Array], cleaning: Cleaning, name: str, metadata: dict[str, Any]) -> None:
    """Empty the pose cells of repeats and jumps; rows that hold nothing else go."""
    done = metadata["track_cleaned"] = {**cleaning.counts, "gaps": len(cleaning.gaps)}
    elsewhere = [float(columns[log.TIME][row]) for row in cleaning.offset_rows]
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
        elif column != log.TIME:
            empty &= np.isnan(values)
    _keep(columns, ~empty)


def _against(stroke: Rhythm, stated_hz: float | None, name: str) -> str | None:
    """Return in words how a stroke contradicts the metadata; warn of that, and of what makes it doubtful."""
    against = None if stated_hz is None else contradiction(stroke.beat, stated_hz)
    if against is not None:
        against = f"{stroke.channel} {against}; the metadata say {stated_hz:g} Hz"
        warn("SWM032", f"{name}: {against}")
    if stroke.doubt:
        warn("SWM033", f"{name}: {stroke.doubt}")
    return against


def _stated(metadata: dict[str, Any]) -> float | None:
    """The stroke frequency the metadata tell, Hz."""
    stated = metadata.get("frequency_hz")
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not stated > 0:
        return None
    return float(stated)


def _cut(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> None:
    """Keep the part of the log that was asked for, in place."""
    if options.start_s is None and options.end_s is None:
        return
    time = columns[log.TIME]
    low = -np.inf if options.start_s is None else options.start_s
    high = np.inf if options.end_s is None else options.end_s
    kept = (time >= low) & (time <= high)
    if kept.sum() < 2:
        text = f"{int(kept.sum())} samples lie between --start and --end; the log goes from {time[0]:g} s "
        raise InputError(f"{text}to {time[-1]:g} s", file=source.path)
    _keep(columns, kept)


def _measured(columns: dict[str, Array]) -> dict[str, Array]:
    """The columns as they were measured: of a track of swimid the positions before smoothing.

    What was bridged there, and is no measurement, is NaN.
    """
    raw = {name: columns[raw] for name in columns if (raw := _raw(name)) in columns}
    bridged = columns.get("interpolated")
    if not raw or bridged is None:
        return columns
    return {
        name: np.where(bridged == 1, np.nan, raw.get(name, values)) if _of_pose(name) else values
        for name, values in columns.items()
    }


def _to_metres(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> None:
    """Convert the pose of a track in pixels, in place."""
    if options.scale is None:
        return
    if not any(name in columns for name in PIXELS):
        raise InputError("--scale is for a track in pixels: there is no column x_px", file=source.path)
    taken = [name for name in METRES if name in columns]
    if taken:
        raise InputError("there is a track in metres already", file=source.path, column=taken[0])
    for name in [name for name in columns if "_px" in name and _of_pose(name)]:
        columns[name.replace("_px", "_m")] = columns.pop(name) * options.scale


def _along(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> Projection | None:
    """Put the distance along a line in the place of the pose, in place."""
    if options.along is None:
        return None
    names = _track(columns)
    if not names:
        raise InputError("--along needs a track: x_m, y_m, z_m, or those in px", file=source.path)
    stated = direction(options.along)
    towards = None
    if stated is not None:
        towards = np.array(stated)[["xyz".index(name[0]) for name in names]]
        if not np.isclose(np.linalg.norm(towards), 1.0):
            text = f"--along {options.along} points out of the plane of {', '.join(names)}"
            raise InputError(text, file=source.path)
    place = np.column_stack([_measured(columns)[name] for name in names])
    there: NDArray[np.bool_] = np.asarray(np.isfinite(place).all(axis=1))
    if there.sum() < 2 or not np.ptp(place[there], axis=0).any():
        raise InputError("the track does not move", file=source.path)
    line = _project(place, there, towards)
    rest = {name: values for name, values in columns.items() if not _of_pose(name)}
    columns.clear()
    columns.update({log.TIME: rest.pop(log.TIME), f"x_{_unit(names)}": line.along} | rest)
    return line


def _project(place: Array, there: NDArray[np.bool_], towards: Array | None) -> Projection:
    """Project a track on a line: by default the one it keeps closest to, in the sense of its travel."""
    centred = place - place[there].mean(axis=0)
    if towards is None:
        towards = np.linalg.svd(centred[there], full_matrices=False)[2][0]
        travel = place[there][-1] - place[there][0]
        forward = float(travel @ towards)
        if forward < 0 or (forward == 0 and towards[np.argmax(np.abs(towards))] < 0):
            towards = -towards
    along = centred @ towards
    across = centred[there] - np.outer(along[there], towards)
    rms = float(np.sqrt(np.mean(np.sum(across**2, axis=1))))
    return Projection(along - along[there][0], towards, rms, float(np.ptp(along[there])))


def _raw(name: str) -> str:
    """Name of the column of a track before it was smoothed."""
    stem, _, unit = name.partition("_")
    return f"{stem}_raw_{unit}" if stem in _POSE else ""


def _of_pose(name: str) -> bool:
    """Whether a column is a pose or follows from it."""
    stem, _, rest = name.partition("_")
    if stem in _POSE:
        return bool(rest)
    return stem in _POSE_SPEEDS and rest.replace("sd_", "") in ("m_s", "px_s", "m_s2", "px_s2")
