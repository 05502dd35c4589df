"""A foreign log put in order: cut, scaled and projected as asked, its track cleaned, its stroke found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.logs import log, plausible, projection, rhythm, time_order, track_cleaning, track_speed
from swimid.logs.beat import contradiction
from swimid.logs.mapping import MappedLog
from swimid.logs.options import ImportOptions
from swimid.logs.plausible import Doubt
from swimid.logs.projection import Projection
from swimid.logs.rhythm import Rhythm
from swimid.logs.time_order import Order
from swimid.logs.track_cleaning import Cleaning
from swimid.logs.track_speed import TrackSpeed
from swimid.notices import warn

Array = NDArray[np.float64]
METRES = ("x_m", "y_m", "z_m")
PIXELS = ("x_px", "y_px", "z_px")
#: Columns that follow from a pose, beside those that begin with its coordinates.
_POSE_SPEEDS = ("u", "v", "w", "vx", "vy", "vz")
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
#: An angle of a body or a joint that swings farther to either side goes through itself.
HALF_TURN = np.pi


@dataclass(frozen=True)
class Examined:
    """A foreign log in order, and what was found in it.

    Attributes
    ----------
    path : Path
        The foreign log.
    notes : list of str
        What its reader has to say.
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
    """

    path: Path
    notes: list[str]
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
        Fewer samples of a cleaned track than :data:`swimid.logs.track_speed.FEWEST` stay of many.
    """
    columns = source.columns
    time = columns[log.TIME]
    order = time_order.in_order(time, {name: v for name, v in columns.items() if name != log.TIME})
    _check_order(order, source)
    if order.changed:
        for name in list(columns):
            columns[name] = columns[name][order.index]
    notes = list(source.notes)
    for note in notes:
        warn("SWM057", f"{source.path.name}: {note}")
    _warn_order(order, source.path.name)
    cut(columns, options, source)
    to_metres(columns, options, source)
    own = log.written_by(source.metadata, "swimid track")
    clean = options.clean
    cleaning, speed, cleaned = _track(columns, not own if clean is None else clean, clean)
    metadata = dict(source.metadata) | {"source": source.path.name, "imported_by": "swimid import"}
    if cleaning is not None and cleaned:
        _take_out(columns, cleaning, source.path.name, metadata)
    unit = "px" if any(n in columns for n in PIXELS) and not any(n in columns for n in METRES) else "m"
    telling = {n: v for n, v in measured(columns).items() if n != log.TIME}
    stated = _stated(metadata)
    stroke = rhythm.find(columns[log.TIME], telling, range_hz=options.stroke_hz, stated_hz=stated)
    unknown = "" if stroke is not None else rhythm.unknown(columns[log.TIME], telling)
    doubts = [*plausible.doubts(columns[log.TIME], columns), *_bent(stroke)]
    for doubt in doubts:
        warn("SWM002", f"{source.path.name}, '{doubt.column}': {doubt.text}")
    against = _contradiction(stroke, stated, source.path.name)
    if stroke is not None and stroke.doubt:
        warn("SWM033", f"{source.path.name}: {stroke.doubt}")
    line = along(columns, options, source)
    if line is not None:
        metadata["along"] = [float(part) for part in line.direction]
    return Examined(
        source.path,
        notes,
        metadata,
        columns,
        order,
        cleaning,
        cleaned,
        speed,
        stroke,
        against,
        unknown,
        doubts,
        line,
        unit,
    )


def _track(
    columns: dict[str, Array], clean: bool, asked: bool | None
) -> tuple[Cleaning | None, TrackSpeed | None, bool]:
    """What was found in the track as it was measured, its speed, and whether to take jumps out."""
    known = measured(columns)
    names = [n for n in METRES if n in columns] or [n for n in PIXELS if n in columns]
    cleaned = clean and (len(names) > 1 or bool(asked and names))
    if len(names) < 2 and not cleaned:
        return None, None, False
    track = [known[name] for name in names]
    found = track_cleaning.clean(columns[log.TIME], track, [known[n] for n in ANGLES if n in columns])
    return found, track_speed.speed(columns[log.TIME], track, found), cleaned


def _bent(stroke: Rhythm | None) -> list[Doubt]:
    """Angles that swing by more than half a turn to either side of their drift."""
    beats = {} if stroke is None else stroke.channels
    return [
        Doubt(name, f"swings by ±{beat.amplitude:.3g} rad: looks like degrees (a factor of 57.3)")
        for name, beat in beats.items()
        if name.endswith("_rad") and beat.amplitude > HALF_TURN
    ]


def _check_order(order: Order, source: MappedLog) -> None:
    if len(order.index) == 0:
        raise InputError("no sample has a time", file=source.path, column=log.TIME)
    if order.reset_row is not None:
        raise InputError(
            f"the clock starts again: {source.time_s[order.reset_row]:g} s after "
            f"{np.nanmax(source.time_s[: order.reset_row]):g} s",
            file=source.path,
            line=int(source.rows[order.reset_row]),
            column=log.TIME,
            hint="split the file there, and import the parts one by one",
        )


def _warn_order(order: Order, name: str) -> None:
    parts = [
        f"{count} {what}"
        for count, what in (
            (order.untimed, "without a time left out"),
            (order.repeated, "repeated left out"),
            (order.clashing, "with the time of the row before but other values left out"),
            (order.late, "that came late put in their place"),
        )
        if count
    ]
    if parts:
        warn("SWM057", f"{name}: rows {'; '.join(parts)}")


def _take_out(columns: dict[str, Array], cleaning: Cleaning, name: str, metadata: dict[str, Any]) -> None:
    """Empty the pose cells of repeats and jumps; rows that hold nothing else go."""
    metadata["track_cleaned"] = {
        "repeats": int(cleaning.repeated.sum()),
        "jumps": cleaning.jumps,
        "samples_jumped": int(cleaning.jumped.sum()),
        "gaps": len(cleaning.gaps),
    }
    out = cleaning.repeated | cleaning.jumped
    if cleaning.offset_rows:
        at = ", ".join(f"{columns[log.TIME][row]:.6g} s" for row in cleaning.offset_rows[:5])
        warn("SWM059", f"{name}: the track goes on elsewhere at {at}")
        metadata["track_cleaned"]["elsewhere_s"] = [
            float(columns[log.TIME][row]) for row in cleaning.offset_rows
        ]
    if not out.any():
        return
    if len(out) >= 2 * track_speed.FEWEST and cleaning.good.sum() < track_speed.FEWEST:
        raise NoTrustworthyResult(
            f"{name}: of {len(out)} samples {int(cleaning.good.sum())} are no repeats or jumps: no track",
            hint="--raw keeps them all; is this a track of positions in metres?",
        )
    warn(
        "SWM058",
        f"{name}: {int(cleaning.repeated.sum())} repeated samples and {int(cleaning.jumped.sum())} samples "
        f"of {cleaning.jumps} jumps left out of the track",
    )
    blank = [n for n in (*METRES, *PIXELS, *ANGLES) if n in columns]
    for column in blank:
        columns[column] = np.where(out, np.nan, columns[column])
    empty = out.copy()
    for column, values in columns.items():
        if column != log.TIME and column not in blank:
            empty &= np.isnan(values)
    if empty.any():
        for column in list(columns):
            columns[column] = columns[column][~empty]


def _stated(metadata: dict[str, Any]) -> float | None:
    """The stroke frequency the metadata tell, Hz."""
    stated = metadata.get("frequency_hz")
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not stated > 0:
        return None
    return float(stated)


def _contradiction(stroke: Rhythm | None, stated_hz: float | None, name: str) -> str | None:
    if stroke is None or stated_hz is None:
        return None
    against = contradiction(stroke.beat, stated_hz)
    if against is not None:
        against = f"{stroke.channel} {against}; the metadata say {stated_hz:g} Hz"
        warn("SWM032", f"{name}: {against}")
    return against


def cut(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> None:
    """Keep the part of the log that was asked for.

    Raises
    ------
    InputError
        No two samples lie in it.
    """
    if options.start_s is None and options.end_s is None:
        return
    time = columns[log.TIME]
    low = -np.inf if options.start_s is None else options.start_s
    high = np.inf if options.end_s is None else options.end_s
    kept = (time >= low) & (time <= high)
    if kept.sum() < 2:
        raise InputError(
            f"{int(kept.sum())} samples lie between --start and --end; the log goes from {time[0]:g} s "
            f"to {time[-1]:g} s",
            file=source.path,
        )
    for name in list(columns):
        columns[name] = columns[name][kept]


def measured(columns: dict[str, Array]) -> dict[str, Array]:
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


def to_metres(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> None:
    """Convert the pose of a track in pixels, in place.

    Raises
    ------
    InputError
        There is none.
    """
    if options.scale is None:
        return
    if not any(name in columns for name in PIXELS):
        raise InputError("--scale is for a track in pixels: there is no column x_px", file=source.path)
    taken = [name for name in METRES if name in columns]
    if taken:
        raise InputError("there is a track in metres already", file=source.path, column=taken[0])
    for name in [name for name in columns if "_px" in name and _of_pose(name)]:
        columns[name.replace("_px", "_m")] = columns.pop(name) * options.scale


def along(columns: dict[str, Array], options: ImportOptions, source: MappedLog) -> Projection | None:
    """Put the distance along a line in the place of the pose, in place.

    Raises
    ------
    InputError
        There is no track, or it does not move.
    """
    if options.along is None:
        return None
    unit = "m" if any(name in columns for name in METRES) else "px"
    names = [name for name in (METRES if unit == "m" else PIXELS) if name in columns]
    if not names:
        raise InputError("--along needs a track: x_m, y_m, z_m, or those in px", file=source.path)
    towards = projection.direction(options.along)
    if towards is not None:
        axes = [METRES.index(name.replace("_px", "_m")) for name in names]
        if not np.isclose(np.linalg.norm(towards[axes]), 1.0):
            raise InputError(
                f"--along {options.along} points out of the plane of {', '.join(names)}", file=source.path
            )
        towards = towards[axes]
    try:
        found = projection.project([measured(columns)[name] for name in names], towards)
    except ValueError as error:
        raise InputError(str(error), file=source.path) from error
    for name in [name for name in columns if _of_pose(name)]:
        del columns[name]
    rest = dict(columns)
    columns.clear()
    columns[log.TIME] = rest.pop(log.TIME)
    columns[f"x_{unit}"] = found.along
    columns.update(rest)
    return found


def _raw(name: str) -> str:
    """Name of the column of a track before it was smoothed."""
    stem, _, unit = name.partition("_")
    return f"{stem}_raw_{unit}" if stem in ("x", "y", "z", "yaw", "pitch", "roll") else ""


def _of_pose(name: str) -> bool:
    """Whether a column is a pose or follows from it."""
    stem, _, rest = name.partition("_")
    if stem in ("x", "y", "z", "yaw", "pitch", "roll"):
        return bool(rest)
    return stem in _POSE_SPEEDS and rest.replace("sd_", "") in ("m_s", "px_s", "m_s2", "px_s2")
