"""Figures of logs: channels over time, the track from above, spectra, one trial seen by two sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from swimid.logs import rhythm
from swimid.logs.log import TIME, Log, runs
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import longest_even, usual_step
from swimid.notices import warn
from swimid.results import numbers
from swimid.results.evidence import MAX_POINTS, Figure, Mark, Panel, Span, Trace, thinned

Array = NDArray[np.float64]
#: More channels than this are listed in the table and not drawn.
MAX_PANELS = 12
#: More gaps than this are drawn by the longest of them.
MAX_SPANS = 60
#: A pause longer than this many sample times is a gap.
PAUSE = 6.0
#: Heading arrows along a track.
ARROWS = 24
#: Channels whose spectra are drawn, and how far beyond the stroke.
MAX_SPECTRA, BEYOND = 6, 6.5
#: Columns two sensors have different names for.
SAME = {"wz_rad_s": "yaw_rate_rad_s"}


def figures(logs: Sequence[Log], *, found: Rhythm | None = None) -> list[Figure]:
    """Every figure the columns of one or several logs allow.

    Parameters
    ----------
    logs : sequence of Log
        Several are drawn over each other, each on its own clock.
    found : Rhythm, optional
        The stroke of a single log, where the caller knows it already.
    """
    result = [channels(logs)] if len(logs) == 1 else [together(logs)]
    result += [figure for figure in (track(logs),) if figure is not None]
    for record in logs:
        stroke = found if found is not None else rhythm.find(record.time_s, _signals(record))
        drawn = spectra(record, stroke)
        if drawn is not None:
            result.append(drawn)
    return [figure for figure in result if figure.panels]


def _signals(record: Log) -> dict[str, Array]:
    return {name: values for name, values in record.columns.items() if name != TIME}


def pauses(time: Array) -> NDArray[np.int64]:
    """Samples after which nothing was logged for longer than :data:`PAUSE` sample times."""
    return (
        np.flatnonzero(np.diff(time) > PAUSE * usual_step(time)) if len(time) > 3 else np.empty(0, dtype=int)
    )


def missing(time: Array, values: Array) -> list[tuple[float, float]]:
    """Stretches between two samples that lack what lies between them, s."""
    empty = np.isnan(values)
    quiet = [(float(time[k]), float(time[k + 1])) for k in pauses(time)]
    if not empty.any():
        return quiet
    last = len(time) - 1
    blank = {(float(time[max(first - 1, 0)]), float(time[min(end, last)])) for first, end in runs(empty)}
    return sorted({*blank, *quiet})


def _broken(time: Array, values: Array) -> tuple[Array, Array]:
    """The samples with an empty one in every pause, so that no line is drawn across it."""
    after = pauses(time)
    if not len(after):
        return time, values
    middle = 0.5 * (time[after] + time[after + 1])
    return np.insert(time, after + 1, middle), np.insert(values, after + 1, np.nan)


def _line(time: Array, values: Array, label: str = "", *, few: bool = False) -> Trace:
    x, y = thinned(*_broken(time, values))
    return Trace(x=x, y=y, label=label, style="dashed" if few else "line")


def channels(logs: Sequence[Log]) -> Figure:
    """The channels of one log over time, gaps shaded."""
    (record,) = logs
    signals = _signals(record)
    panels = []
    for name in list(signals)[:MAX_PANELS]:
        spans = sorted(missing(record.time_s, signals[name]), key=lambda gap: gap[0] - gap[1])[:MAX_SPANS]
        panels.append(
            Panel(
                x_label="time (s)",
                y_label=numbers.column_title(name),
                traces=[_line(record.time_s, signals[name])],
                spans=[Span(start=start, end=end, label="missing") for start, end in sorted(spans)],
            )
        )
    remarks = [
        "Each channel over time; shaded where samples are missing. Good: smooth curves without jumps, "
        "and gaps that are few and short.",
        *_reduced([record]),
    ]
    if len(signals) > MAX_PANELS:
        remarks.append(f"{len(signals) - MAX_PANELS} further channels are in the table only.")
    return Figure(id="channels", title="Channels over time", caption=" ".join(remarks), panels=panels)


def _reduced(logs: Sequence[Log]) -> list[str]:
    remarks = []
    for record in logs:
        if len(record) > MAX_POINTS:
            text = f"{record.path.name}: {len(record)} samples drawn as their envelope of {MAX_POINTS} points"
            warn("SWM051", text)
            remarks.append(
                f"{len(record)} samples are drawn as their envelope of at most {MAX_POINTS} points."
            )
    return remarks


def together(logs: Sequence[Log]) -> Figure:
    """The channels of several logs over each other; those that only one has, below."""
    names = _names(logs)
    by_channel: dict[str, list[tuple[str, Log, str]]] = {}
    for name, record in zip(names, logs, strict=True):
        for column in _signals(record):
            by_channel.setdefault(SAME.get(column, column), []).append((name, record, column))
    order = sorted(by_channel, key=lambda channel: -len(by_channel[channel]))
    panels = []
    for channel in order[:MAX_PANELS]:
        traces = [
            Trace(**{**_line(record.time_s, record[column], name).model_dump(), "group": names.index(name)})
            for name, record, column in by_channel[channel]
        ]
        gaps = [
            Span(start=start, end=end, label=f"missing in {name}")
            for name, record, column in by_channel[channel]
            for start, end in missing(record.time_s, record[column])
        ]
        longest = sorted(gaps, key=lambda gap: gap.start - gap.end)[:MAX_SPANS]
        panels.append(
            Panel(
                x_label="time (s)",
                y_label=numbers.column_title(channel),
                traces=traces,
                spans=sorted(longest, key=lambda gap: gap.start),
            )
        )
    shared = sum(len(found) > 1 for found in by_channel.values())
    remarks = [
        "The logs over each other, each on its own clock. Good: curves that lie on each other; a constant "
        "shift along the axis is an offset between the clocks.",
        f"{shared} channels are in more than one log." if shared else "The logs have no channel in common.",
        *_reduced(logs),
    ]
    if len(order) > MAX_PANELS:
        remarks.append(f"{len(order) - MAX_PANELS} further channels are not drawn.")
    title = "Channels over each other" if shared else "Channels of each log"
    return Figure(id="channels", title=title, caption=" ".join(remarks), panels=panels)


def _names(logs: Sequence[Log]) -> list[str]:
    """A short name for every log, its folder put before it where two are called the same."""
    stems = [record.path.name for record in logs]
    return [
        stem if stems.count(stem) == 1 else f"{record.path.parent.name}/{stem}"
        for stem, record in zip(stems, logs, strict=True)
    ]


def track(logs: Sequence[Log]) -> Figure | None:
    """The path from above (or from the side), to scale, with arrows along the heading."""
    traces: list[Trace] = []
    across = ""
    for name, record in zip(_names(logs), logs, strict=True):
        up = next((column for column in ("y_m", "z_m") if column in record and "x_m" in record), None)
        if up is None or (across and up != across):
            continue
        across = up
        x, y = record["x_m"], record[up]
        step = len(x) // MAX_POINTS + 1
        broken_x, broken_y = _broken(record.time_s, x)[1], _broken(record.time_s, y)[1]
        several = len(logs) > 1
        traces.append(Trace(x=broken_x[::step], y=broken_y[::step], label=name if several else "path"))
        there = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        if len(there) and not several:
            traces.append(Trace(x=x[there[:1]], y=y[there[:1]], label="start", style="points"))
        heading = {"y_m": "yaw_rad", "z_m": "pitch_rad"}[up]
        if heading in record and len(there) > 1:
            traces.append(_arrows(x, y, record[heading], f"heading, {name}" if several else "heading"))
    if not traces:
        return None
    panel = Panel(x_label="x (m)", y_label=numbers.column_title(across), traces=traces, equal_aspect=True)
    view = "from above" if across == "y_m" else "from the side"
    return Figure(
        id="path",
        title=f"Path {view}",
        caption="The path to scale, arrows along the heading. Good: one continuous line inside the pool, the "
        "arrows along it; a constant angle between them is a heading offset or drift by a current.",
        panels=[panel],
    )


def _arrows(x: Array, y: Array, angle: Array, label: str) -> Trace:
    """Arrows as one broken line: shaft and two barbs each."""
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(angle))
    rows = good[np.linspace(0, len(good) - 1, min(ARROWS, len(good))).astype(int)] if len(good) else good
    size = 0.06 * max(float(np.ptp(x[good])), float(np.ptp(y[good])), 1e-9) if len(good) else 0.0
    across, up = [], []
    for row in rows:
        turn = np.array([0.0, np.pi - 0.45, np.pi + 0.45]) + angle[row]
        tip = np.array([x[row] + size * np.cos(angle[row]), y[row] + size * np.sin(angle[row])])
        barbs = [tip + 0.4 * size * np.array([np.cos(t), np.sin(t)]) for t in turn[1:]]
        points = [np.array([x[row], y[row]]), tip, barbs[0], tip, barbs[1], np.array([np.nan, np.nan])]
        across += [float(p[0]) for p in points]
        up += [float(p[1]) for p in points]
    return Trace(x=np.array(across), y=np.array(up), label=label, style="arrows")


def spectra(record: Log, stroke: Rhythm | None) -> Figure | None:
    """Amplitude spectra of the channels that tell of the stroke, the stroke and its harmonics marked."""
    signals = {
        n: v
        for n, v in _signals(record).items()
        if rhythm.SIDEWAYS.fullmatch(n) or rhythm.PUSHED.fullmatch(n)
    }
    if stroke is not None:
        signals = dict(sorted(signals.items(), key=lambda item: item[0] not in stroke.channels))
        track = rhythm.swing(record.columns)
        if stroke.channel in track:
            signals = {f"{stroke.channel}_m": track[stroke.channel], **signals}
    panels = []
    for name in list(signals)[:MAX_SPECTRA]:
        drawn = _spectrum(record.time_s, signals[name], stroke)
        if drawn is None:
            continue
        marks = []
        if stroke is not None:
            marks.append(Mark(at=stroke.beat.frequency_hz, axis="x", label="stroke"))
            last = float(drawn[0][-1])
            marks += [
                Mark(at=k * stroke.beat.frequency_hz, axis="x", label="2 ×, 3 ×")
                for k in (2, 3)
                if k * stroke.beat.frequency_hz <= last
            ]
        panels.append(
            Panel(
                x_label="frequency (Hz)",
                y_label=f"amplitude of {numbers.column_title(name)}",
                traces=[Trace(x=drawn[0], y=drawn[1])],
                y_scale="log",
                marks=marks,
            )
        )
    if not panels:
        return None
    found = "No stroke was found."
    if stroke is not None:
        frequency = numbers.measured(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")
        found = f"The stroke found in {stroke.channel} is {frequency}."
    return Figure(
        id=f"spectra-{record.path.stem}",
        title=f"Spectra of {record.path.name}",
        caption=f"{found} Amplitude spectra (Hann window) of the longest stretch without a gap. Good: a "
        "peak at the stroke in the channels that swing sideways, at twice of it in surge.",
        panels=panels,
        columns=2 if len(panels) > 1 else 1,
    )


def _spectrum(time: Array, values: Array, stroke: Rhythm | None) -> tuple[Array, Array] | None:
    from scipy import signal

    even_s, even = longest_even(time, values, rhythm.FASTEST_HZ)
    if len(even) < 32 or np.ptp(even) == 0:
        return None
    rate = (len(even_s) - 1) / (even_s[-1] - even_s[0])
    length = 1 << int(np.ceil(np.log2(2 * len(even))))
    frequency, power = signal.periodogram(
        even, rate, window="hann", detrend="linear", scaling="spectrum", nfft=length
    )
    amplitude = np.sqrt(2 * power)
    highest = frequency[-1] if stroke is None else min(BEYOND * stroke.beat.frequency_hz, frequency[-1])
    shown = (frequency > 0) & (frequency <= highest)
    if not np.any(amplitude[shown] > 0):
        return None
    floor = 1e-5 * float(amplitude[shown].max())
    return thinned(frequency[shown], np.maximum(amplitude[shown], floor))
