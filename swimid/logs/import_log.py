"""``swimid import``: logs of other programs become logs of the pinned format."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import (
    bulk,
    import_prepare,
    log,
    mapping,
    plausible,
    rhythm,
    time_order,
    track_cleaning,
    track_speed,
)
from swimid.logs.beat import contradiction
from swimid.logs.import_evidence import build, summary
from swimid.logs.import_prepare import METRES, PIXELS, Request
from swimid.logs.mapping import MappedLog, Mapping
from swimid.logs.plausible import Doubt
from swimid.logs.projection import Projection
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import usual_step
from swimid.logs.time_order import Order
from swimid.logs.track_cleaning import Cleaning
from swimid.logs.track_speed import TrackSpeed
from swimid.notices import Notice, recorded, warn
from swimid.progress import Progress, silent
from swimid.results import evidence
from swimid.results.result import Result

Array = NDArray[np.float64]
ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")
#: An angle of a body or a joint that swings farther to either side goes through itself.
HALF_TURN = np.pi


@dataclass(frozen=True)
class Imported:
    """One log, as it was read and what was found in it.

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


def import_logs(
    files: Sequence[str | Path],
    *,
    map_path: str | Path | None = None,
    output: str | Path,
    clean: bool | None = None,
    request: Request | None = None,
    progress: Progress = silent,
) -> Result:
    """Write foreign logs in the log format, each with its evidence.

    Parameters
    ----------
    files : sequence of paths
        At least one.
    map_path : path, optional
        ``swimid-mapping/1`` file; without it the columns must be named as in the log format.
    output : path
        The log, CSV or Parquet by its ending; for several files a folder, which is made.
    clean : bool, optional
        Whether repeats and jumps are taken out of the track. Default: in logs with two or more
        position columns that swimid did not track itself.
    request : Request, optional
        What is cut, scaled or projected, and where the stroke is known to lie.
    progress : Progress
        Shows reading and writing.

    Raises
    ------
    InputError
        A file or the mapping cannot be used.
    NoTrustworthyResult
        Hardly a sample is left of a track.
    """
    if not files:
        raise UsageError("name at least one log to import")
    paths = list(dict.fromkeys(Path(file) for file in files))
    rules = None if map_path is None else mapping.read(map_path)
    targets = destinations(paths, Path(output))
    done = []
    for path, target in zip(paths, targets, strict=True):
        with recorded(repeat=True) as notices:
            done.append(_one(path, target, rules, map_path, clean, request or Request(), progress, notices))
    if len(done) == 1:
        return done[0]
    return Result(
        "import",
        "\n".join(outcome.text for outcome in done),
        {"logs": [outcome.data for outcome in done]},
        [path for outcome in done for path in outcome.outputs],
    )


def destinations(paths: Sequence[Path], output: Path) -> list[Path]:
    """Where each log goes: the file named, or a file in the folder named.

    Raises
    ------
    UsageError
        Several logs and one file to write them to, or two that would have one name.
    """
    single = len(paths) == 1 and not output.is_dir() and not str(output).endswith("/")
    if single:
        atomic.check_writable(output, inputs=tuple(paths))
        return [output]
    if output.exists() and not output.is_dir():
        raise UsageError(
            f"{len(paths)} logs cannot all go to the file {output}", hint="name a folder with -o"
        )
    atomic.check_writable(output.parent / "x")
    output.mkdir(exist_ok=True)
    stems = [path.stem for path in paths]
    names = [
        s if stems.count(s) == 1 else f"{p.resolve().parent.name}-{s}"
        for s, p in zip(stems, paths, strict=True)
    ]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise UsageError(f"two logs would be written to {twice}.csv", hint="import them one by one")
    return [atomic.check_writable(output / f"{name}.csv", inputs=tuple(paths)) for name in names]


def _one(
    path: Path,
    target: Path,
    rules: Mapping | None,
    map_path: str | Path | None,
    clean: bool | None,
    request: Request,
    progress: Progress,
    notices: list[Notice],
) -> Result:
    inputs = [path] if map_path is None else [path, map_path]
    with ThreadPoolExecutor(1) as beside:
        # a long file is hashed while it is read
        digests = beside.submit(provenance.digests_of, inputs)
        found = examine(
            mapping.identity(path, progress=progress)
            if rules is None
            else mapping.apply(rules, path, progress=progress),
            clean=clean,
            request=request,
        )
        with progress(f"writing {target.name}", total=len(found.time_s)) as step:
            bulk.write(target, found.columns, found.metadata, step=step)
    source = provenance.collect(
        inputs, settings={"clean": found.cleaned, **request.settings()}, digests=digests.result()
    )
    record = build(found, target, rules, source, notices)
    proof = evidence.sidecar(target)
    evidence.write(proof, record)
    machine = facts(found, record)
    return Result("import", summary(found, machine), machine, [target, proof])


def examine(source: MappedLog, *, clean: bool | None = None, request: Request | None = None) -> Imported:
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
    request = request or Request()
    import_prepare.cut(columns, request, source)
    import_prepare.to_metres(columns, request, source)
    own = log.written_by(source.metadata, "swimid track")
    cleaning, speed, cleaned = _track(columns, not own if clean is None else clean, clean)
    metadata = dict(source.metadata) | {"source": source.path.name, "imported_by": "swimid import"}
    if cleaning is not None and cleaned:
        _take_out(columns, cleaning, source.path.name, metadata)
    unit = "px" if any(n in columns for n in PIXELS) and not any(n in columns for n in METRES) else "m"
    telling = {n: v for n, v in import_prepare.measured(columns).items() if n != log.TIME}
    stated = _stated(metadata)
    stroke = rhythm.find(columns[log.TIME], telling, range_hz=request.stroke_hz, stated_hz=stated)
    unknown = "" if stroke is not None else rhythm.unknown(columns[log.TIME], telling)
    doubts = [*plausible.doubts(columns[log.TIME], columns), *_bent(stroke)]
    for doubt in doubts:
        warn("SWM002", f"{source.path.name}, '{doubt.column}': {doubt.text}")
    against = _contradiction(stroke, stated, source.path.name)
    if stroke is not None and stroke.doubt:
        warn("SWM033", f"{source.path.name}: {stroke.doubt}")
    line = import_prepare.along(columns, request, source)
    if line is not None:
        metadata["along"] = [float(part) for part in line.direction]
    return Imported(
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
    known = import_prepare.measured(columns)
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


def facts(found: Imported, record: evidence.Evidence) -> dict[str, Any]:
    """The result for machines."""
    time = found.time_s
    step = usual_step(time)
    cleaning, speed, stroke = found.cleaning, found.speed, found.stroke
    return {
        "file": str(found.path),
        "samples": len(time),
        "duration_s": float(time[-1] - time[0]),
        "median_rate_hz": 1 / step if step > 0 else None,
        "columns": list(found.columns),
        "missing": {n: int(np.isnan(v).sum()) for n, v in found.columns.items() if n != log.TIME},
        "rows": {k: getattr(found.order, k) for k in ("untimed", "repeated", "clashing", "late")},
        "notes": found.notes,
        "track": None
        if cleaning is None
        else {
            "cleaned": found.cleaned,
            "repeats": int(cleaning.repeated.sum()),
            "jumps": cleaning.jumps,
            "samples_jumped": int(cleaning.jumped.sum()),
            "goes_on_elsewhere": len(cleaning.offset_rows),
            "gaps_s": [list(gap) for gap in cleaning.gaps],
        },
        "speed": None
        if speed is None
        else {
            f"path_{found.unit}_s": speed.path.value,
            "path_ci95": [speed.path.low, speed.path.high],
            f"line_{found.unit}_s": speed.line.value,
            "line_ci95": [speed.line.low, speed.line.high],
            f"naive_{found.unit}_s": speed.naive_m_s,
            f"noise_{found.unit}": speed.noise_m,
            "covered_s": speed.covered_s,
        },
        "stroke": {"unknown": found.unknown}
        if stroke is None
        else {
            "frequency_hz": stroke.beat.frequency_hz,
            "stderr_hz": stroke.beat.stderr_hz,
            "ci95_hz": list(stroke.interval_hz),
            "period_s": stroke.period_s[0],
            "cycles": stroke.beat.cycles,
            "channel": stroke.channel,
            "maybe_double": stroke.maybe_double,
            "harmonics": [
                {"order": h.order, "amplitude": h.amplitude, "stderr": h.stderr} for h in stroke.harmonics
            ],
            "channels_hz": {n: b.frequency_hz for n, b in stroke.channels.items()},
            "rivals_hz": {n: b.frequency_hz for n, b in stroke.rivals.items()},
            "contradiction": found.against,
        },
        "line": None
        if found.projection is None
        else {
            "direction": [float(part) for part in found.projection.direction],
            "extent": found.projection.extent,
            "across_rms": found.projection.across,
        },
        "verdict": record.verdict.model_dump(),
        "checks": [check.model_dump() for check in record.checks],
    }
