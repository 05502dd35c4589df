"""Result of the commands that write a log (tracking, import), and the figures of logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs import log, rhythm
from swimid.logs.log import TIME, Log, runs
from swimid.logs.rhythm import Rhythm
from swimid.logs.sampling import longest_even, pauses
from swimid.notices import warn
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.evidence import (
    MAX_POINTS,
    Evidence,
    Figure,
    Mark,
    Panel,
    Span,
    Table,
    Trace,
    Verdict,
    leaf_table,
    thinned,
)
from swimid.results.result import Result

if TYPE_CHECKING:
    import pandas as pd


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Logged(Result):
    """Result of ``track_video``, ``track_imu`` and ``import_log``: a log and its evidence.

    Attributes
    ----------
    table : dict of str to array_like, each shape (n,)
        Columns as they are written to the file, with text and integers. Empty if the columns of ``log`` are
        written.
    log : Log
        The log, which any function that reads logs accepts.
    frame : DataFrame
        Columns of the log, one row per sample, in SI units and radians.

    Examples
    --------
    >>> import swimid
    >>> made = swimid.load_result("sample_logs/rig/w10.csv")
    >>> isinstance(made, Logged), list(made.frame)
    (True, ['t_s', 'x_m'])
    """

    table: Mapping[str, Any] = field(default_factory=dict, repr=False)

    kind = "Log"
    ending = ".csv"

    @property
    def log(self) -> Log:
        """The log, which any function that reads logs accepts."""
        assert isinstance(self.document, Log)
        return self.document

    @property
    def frame(self) -> pd.DataFrame:
        """Columns of the log, one row per sample, in SI units and radians."""
        import pandas as pd

        return pd.DataFrame(dict(self.table or self.log.columns))

    def _write(self, path: Path) -> list[Path]:
        log.write(path, self.table or self.log.columns, self.log.metadata)
        return [path]

    @classmethod
    def _read(cls, path: str | Path) -> Log:
        return log.read(path)

    def _own_facts(self) -> dict[str, str]:
        span = float(self.log.time_s[-1] - self.log.time_s[0])
        rate = 1.0 / float(np.median(np.diff(self.log.time_s)))
        return {
            "Samples": str(len(self.log)),
            "Duration": numbers.number(span, unit="s"),
            "Median rate": numbers.number(rate, unit="Hz"),
        }

    def _own_tables(self) -> list[Table]:
        rows: list[list[Any]] = []
        for name, values in _signals(self.log).items():
            lost = numbers.percent(float(np.isnan(values).mean()))
            known = values[np.isfinite(values)]
            ends = [float(end(known)) for end in (np.min, np.max) if len(known)]
            rows.append([name, *(ends or (None, None)), lost])
        columns = ["channel", "smallest", "largest", "missing"]
        folded = self.evidence is not None
        return [Table(id="channels", title="Channels", columns=columns, rows=rows, folded=folded)]

    def bare(self) -> Evidence:
        """Return evidence for a log whose evidence file is missing."""
        verdict = Verdict(level="caution", text="A log without evidence of how it was made.")
        if self.log.metadata.get("made_by") == "swimid simulate":
            verdict = Verdict(level="good", text="A simulated run.")
        return Evidence(
            command=self.command,
            title=f"Log {self.path.name}",
            verdict=verdict,
            figures=figures_of([self.log]),
            tables=[leaf_table("metadata", "Metadata of the log", self.log.metadata)],
        )


# ---------------------------------------------------------------- figures

#: Maximum number of channels in the figure. Further channels are only listed in the table.
MAX_PANELS = 12
#: Maximum number of shaded gaps in a panel, of spectra in a figure, and of arrows along a path.
MAX_GAPS, MAX_SPECTRA, MAX_ARROWS = 60, 6, 24


def figures_of(logs: Sequence[Log], *, found: Rhythm | None = None) -> list[Figure]:
    """Return the figures of one or several logs: channels, path and spectra.

    Parameters
    ----------
    logs : sequence of Log
        Logs to draw. Several logs are drawn over each other, each with its own time axis origin.
    found : Rhythm, optional
        Stroke of a single log, if it is already known.
    """
    drawn = [channels(logs), track(logs)]
    for record in logs:
        drawn.append(_spectra(record, found or rhythm.find(record.time_s, _signals(record))))
    return [figure for figure in drawn if figure is not None and figure.panels]


def _signals(record: Log) -> dict[str, Array]:
    """Return the columns of a log except the time."""
    return {name: values for name, values in record.columns.items() if name != TIME}


def _missing(time: Array, values: Array, after: NDArray[np.intp]) -> list[tuple[float, float]]:
    """Return start and end, s, of each gap in a channel.

    A gap is a run of NaN values, or a pause in the time stamps. ``after`` has the index of the last sample
    before each pause.
    """
    empty = np.isnan(values)
    blank = np.add(runs(empty if empty.any() else empty[:0]), [-1, 0])
    ends = np.vstack([blank, np.add.outer(after, [0, 1])]).clip(0, len(time) - 1)
    return sorted({(float(time[first]), float(time[last])) for first, last in ends})


def _broken(time: Array, values: Array, after: NDArray[np.intp]) -> tuple[Array, Array]:
    """Insert a NaN sample into every pause, so that no line is drawn across the pause."""
    if not len(after):
        return time, values
    middle = 0.5 * (time[after] + time[after + 1])
    return np.insert(time, after + 1, middle), np.insert(values, after + 1, np.nan)


def channels(logs: Sequence[Log]) -> Figure:
    """Return the figure of the channels over time. Several logs share the panels, and gaps are shaded."""
    names, several = _names(logs), len(logs) > 1
    after = [pauses(record.time_s) for record in logs]
    by_channel: dict[str, list[tuple[int, Log, Array]]] = {}
    for number, record in enumerate(logs):
        for column, values in _signals(record).items():
            by_channel.setdefault(column, []).append((number, record, values))
    # list channels of several logs before the others
    order = sorted(by_channel, key=lambda channel: -len(by_channel[channel]))
    panels = []
    for channel in order[:MAX_PANELS]:
        traces, gaps = [], []
        for number, record, values in by_channel[channel]:
            x, y = thinned(*_broken(record.time_s, values, after[number]))
            label, group, lacking = ("", None, "missing")
            if several:
                label, group, lacking = names[number], number, f"missing in {names[number]}"
            traces.append(Trace(x=x, y=y, label=label, group=group))
            ends = _missing(record.time_s, values, after[number])
            gaps += [Span(start=start, end=end, label=lacking) for start, end in ends]
        longest = sorted(gaps, key=lambda gap: gap.start - gap.end)[:MAX_GAPS]
        title, spans = numbers.column_title(channel), sorted(longest, key=lambda gap: gap.start)
        panels.append(Panel(x_label="time (s)", y_label=title, traces=traces, spans=spans))
    title, caption = "Channels over time", "Samples are missing where it is shaded."
    if several:
        title = "Channels of several logs"
        caption += (
            " Each log is on its own clock: a constant shift along the axis is an offset of the clocks."
        )
    for record in logs:
        if len(record) > MAX_POINTS:
            text = f"{len(record)} samples drawn as their envelope of {MAX_POINTS} points"
            warn("SWM051", f"{record.path.name}: {text}")
    if len(order) > MAX_PANELS:
        caption += f" {len(order) - MAX_PANELS} further channels are not drawn."
    return Figure(id="channels", title=title, caption=caption, panels=panels)


def _names(logs: Sequence[Log]) -> list[str]:
    """Return a short name for each log. Logs of the same name are preceded by the name of their folder."""
    names = [record.path.name for record in logs]
    folders = [record.path.parent.name for record in logs]
    return [n if names.count(n) == 1 else f"{f}/{n}" for n, f in zip(names, folders, strict=True)]


def track(logs: Sequence[Log]) -> Figure | None:
    """Return the figure of the path from above or from the side, to scale, with arrows along the heading."""
    traces: list[Trace] = []
    across, several = "", len(logs) > 1
    for name, record in zip(_names(logs), logs, strict=True):
        up = next((column for column in ("y_m", "z_m") if column in record and "x_m" in record), None)
        if up is None or (across and up != across):
            continue
        across, path, arrows = up, "path", "heading"
        if several:
            path, arrows = name, f"heading, {name}"
        x, y = record["x_m"], record[up]
        step, after = len(x) // MAX_POINTS + 1, pauses(record.time_s)
        line = (_broken(record.time_s, values, after)[1][::step] for values in (x, y))
        traces.append(Trace(**dict(zip("xy", line, strict=True)), label=path))
        there = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        heading = {"y_m": "yaw_rad", "z_m": "pitch_rad"}[up]
        if heading in record and len(there) > 1:
            traces.append(_arrows(x, y, record[heading], arrows))
    if not traces:
        return None
    title = {"y_m": "Path from above", "z_m": "Path from the side"}[across]
    caption, y_label = "The path, with arrows along the heading.", numbers.column_title(across)
    return ev.figure("path", title, caption, "x (m)", y_label, traces, equal_aspect=True)


def _arrows(x: Array, y: Array, angle: Array, label: str) -> Trace:
    """Return arrows along the heading, drawn as one line with interruptions."""
    good = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(angle))
    rows = good[np.linspace(0, len(good) - 1, min(MAX_ARROWS, len(good))).astype(int)]
    size = 0.06 * max(float(np.ptp(x[good])), float(np.ptp(y[good])), 1e-9) if len(good) else 0.0
    sides = []
    for values, way in ((x, np.cos), (y, np.sin)):
        start, turn = values[rows], angle[rows]
        tip = start + size * way(turn)
        left, right = (tip + 0.4 * size * way(barb + turn) for barb in (np.pi - 0.45, np.pi + 0.45))
        sides.append(np.column_stack([start, tip, left, tip, right, np.full(len(rows), np.nan)]).ravel())
    return Trace(x=sides[0], y=sides[1], label=label, style="arrows")


def _spectra(record: Log, stroke: Rhythm | None) -> Figure:
    """Return the amplitude spectra of the channels that move with the stroke; its harmonics are marked."""
    told = (rhythm.SIDEWAYS, rhythm.PUSHED)
    signals = {n: v for n, v in _signals(record).items() if any(names.fullmatch(n) for names in told)}
    caption = "No stroke was found."
    beats: list[tuple[str, float]] = []
    if stroke is not None:
        signals = dict(sorted(signals.items(), key=lambda item: item[0] not in stroke.channels))
        track = rhythm.swing(record.columns)
        if stroke.channel in track:
            signals = {f"{stroke.channel}_m": track[stroke.channel], **signals}
        frequency = numbers.measured(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")
        caption = f"The stroke in {stroke.channel} is {frequency}."
        labels = ("stroke", "2 ×, 3 ×", "2 ×, 3 ×")
        beats = [(label, k * stroke.beat.frequency_hz) for k, label in enumerate(labels, start=1)]
    panels = []
    for name in list(signals)[:MAX_SPECTRA]:
        drawn = _spectrum(record.time_s, signals[name], stroke)
        if drawn is None:
            continue
        marks = []
        for label, beat_hz in beats:
            if label == "stroke" or beat_hz <= drawn[0][-1]:
                marks.append(Mark(at=beat_hz, axis="x", label=label))
        trace, y_label = Trace(x=drawn[0], y=drawn[1]), f"amplitude of {numbers.column_title(name)}"
        panels.append(
            Panel(x_label="frequency (Hz)", y_label=y_label, traces=[trace], y_scale="log", marks=marks)
        )
    return Figure(
        id=f"spectra-{record.path.stem}",
        title=f"Spectra of {record.path.name}",
        caption=f"{caption} Amplitudes (Hann window) of the longest stretch without a gap.",
        panels=panels,
    )


def _spectrum(time: Array, values: Array, stroke: Rhythm | None) -> tuple[Array, Array] | None:
    """Return frequencies, Hz, and amplitudes of the longest gap-free part of a channel; None if too short."""
    even_s, even = longest_even(time, values, rhythm.MAX_RATE_HZ)
    if len(even) < 32 or np.ptp(even) == 0:
        return None
    rate = (len(even_s) - 1) / (even_s[-1] - even_s[0])
    length = 1 << int(np.ceil(np.log2(2 * len(even))))
    sample = np.arange(len(even))
    level = even - np.polyval(np.polyfit(sample, even, 1), sample)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * sample / len(even))
    frequency = np.fft.rfftfreq(length, 1 / rate)
    amplitude = 2 * np.abs(np.fft.rfft(window * level, length)) / window.sum()
    highest = frequency[-1]
    if stroke is not None:
        highest = min(6.5 * stroke.beat.frequency_hz, highest)
    shown = (frequency > 0) & (frequency <= highest)
    if not np.any(amplitude[shown] > 0):
        return None
    floor = 1e-5 * float(amplitude[shown].max())
    return thinned(frequency[shown], np.maximum(amplitude[shown], floor))
