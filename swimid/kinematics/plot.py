"""Figures of logs, and the command ``swimid plot``, which draws them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from swimid.errors import UsageError
from swimid.files import atomic
from swimid.kinematics.options import PlotOptions
from swimid.kinematics.stroke import MAX_RATE_HZ, PUSHED, SIDEWAYS, StrokeEstimate, find_stroke, swing
from swimid.logs import log
from swimid.logs.log import Log, LogLike, runs
from swimid.logs.sampling import longest_even, pauses
from swimid.notices import record_warnings, warn
from swimid.options import takes
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.evidence import (
    MAX_TRACE_POINTS,
    Evidence,
    Figure,
    Mark,
    Panel,
    Span,
    Trace,
    Verdict,
    thin_curve,
)
from swimid.results.result import Result

Array = NDArray[np.float64]
PICTURES = (".svg", ".png")


class Drawn(Result):
    """Result of ``plot``: figures of one or several logs, which are saved as one picture."""

    kind = "Log"
    next_step = "python -m webbrowser {file}"

    def save(self, path: str | Path) -> Self:
        """Write the figures to a file that ends in ``.svg`` or ``.png``.

        Raises
        ------
        InputError
            The folder does not exist, or files cannot be written to it.
        UsageError
            The path has an ending other than ``.svg`` or ``.png``.
        """
        path = _picture(path)
        assert self.evidence is not None
        from swimid.results import drawing

        drawing.write(path, self.evidence.figures, title=self.evidence.title)
        return replace(self, outputs=(*self.outputs, path))


@takes(PlotOptions)
def plot(
    logs: LogLike | Sequence[LogLike], *, options: PlotOptions, output: str | Path | None = None
) -> Drawn:
    """Draw logs: channels over time, the track from above, and spectra of the channels.

    Parameters
    ----------
    logs : path, Log or DataFrame, or a sequence of these
            Logs. Several logs are drawn over each other, each with its own origin of the time axis. A table
            has the k columns of a log, shape (n, k), in SI units. The default title lists the names of the
            logs.
    output : path, optional
        File that ends in ``.svg`` or ``.png``. Without this path nothing is written.

    Returns
    -------
    Drawn
        Its method ``figures()`` returns all figures in matplotlib; ``plot(name, axes)`` draws one of
        ``figure_names``.

    Raises
    ------
    InputError
        A log cannot be read.
    UsageError
            The output does not end in ``.svg`` or ``.png``.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(200) / 50
    >>> plot(pd.DataFrame({"t_s": t, "yaw_rad": 0.2 * np.sin(9 * t)})).figure_names
    ['channels', 'spectra-log']
    """
    if isinstance(logs, str) or not isinstance(logs, Sequence):
        logs = [logs]
    if not logs:
        raise UsageError("no log is given", hint="name at least one log to draw")
    if output is not None:
        paths = [one for one in logs if isinstance(one, str | Path)]
        output = atomic.check_writable(_picture(output), inputs=paths)
    records: list[log.Log] = []
    with record_warnings(repeat=True) as notices:
        for number, given in enumerate(logs, start=1):
            name = "log"
            if len(logs) > 1:
                name = f"log {number}"
            records.append(log.as_log(given, name=name))
        figures = figures_of(records)
    proof = Evidence(
        command="plot",
        title=options.title or " and ".join(record.name for record in records),
        verdict=Verdict(level="good", text="The logs are drawn as recorded. They were not checked."),
        facts={record.name: f"{len(record)} samples" for record in records},
        figures=figures,
        notices=list(notices),
    )
    data = {"logs": [str(record.path) for record in records], "figures": [figure.id for figure in figures]}
    told = "\n".join(f"{record.name}: {len(record)} samples, drawn as logged" for record in records)
    return Drawn("plot", told, data, evidence=proof, document=records).write_output(output)


def _picture(path: str | Path) -> Path:
    if Path(path).suffix.lower() not in PICTURES:
        raise UsageError(f"{path}: the name of a picture must end in {' or '.join(PICTURES)}")
    return Path(path)


# ---------------------------------------------------------------- figures

#: Maximum number of channels that a figure of logs draws. The caption states the number of further channels.
MAX_PANELS = 12
#: Limits for the figures of logs: maximum number of shaded gaps in a panel, of spectra in a figure, and of
#: arrows along a path.
MAX_GAPS, MAX_SPECTRA, MAX_ARROWS = 60, 6, 24


def figures_of(logs: Sequence[Log], *, found: StrokeEstimate | None = None) -> list[Figure]:
    """Return the figures of one or several logs: channels, path and spectra.

    Parameters
    ----------
    logs : sequence of Log
        Logs to draw. Several logs are drawn over each other, each with its own time axis origin.
    found : StrokeEstimate, optional
        Stroke of a single log, if it is already known.
    """
    spectra = [_spectra(record, found or find_stroke(record.time_s, record.signals)) for record in logs]
    drawn = [channels(logs), track(logs), *spectra]
    return [figure for figure in drawn if figure is not None and figure.panels]


def _find_missing(time: Array, values: Array, after: NDArray[np.intp]) -> list[tuple[float, float]]:
    """Return start and end times, s, of each gap in a channel.

    A gap is a sequence of NaN values, or a pause in the time stamps. ``after`` has the index of the last
    sample before each pause.
    """
    empty = np.isnan(values)
    blank = np.add(runs(empty if empty.any() else empty[:0]), [-1, 0])
    ends = np.vstack([blank, np.add.outer(after, [0, 1])]).clip(0, len(time) - 1)
    return sorted({(float(time[first]), float(time[last])) for first, last in ends})


def _insert_pauses(time: Array, values: Array, after: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return times and values of a channel, with a NaN sample inserted in each pause of the time stamps.

    No line is then drawn across the pause. ``after`` has the index of the last sample before each pause.
    """
    if not len(after):
        return time, values
    middle = 0.5 * (time[after] + time[after + 1])
    return np.insert(time, after + 1, middle), np.insert(values, after + 1, np.nan)


def channels(logs: Sequence[Log]) -> Figure:
    """Return the figure of log channels over time, with shaded gaps. Several logs share the panels."""
    names, several = _names(logs), len(logs) > 1
    after = [pauses(record.time_s) for record in logs]
    # Draw the channels that the largest number of logs have in common first.
    order = [name for name, _ in Counter(n for record in logs for n in record.signals).most_common()]
    panels = []
    for channel in order[:MAX_PANELS]:
        traces, gaps = [], []
        for number, record in enumerate(logs):
            if channel not in record.signals:
                continue
            values = record.signals[channel]
            x, y = thin_curve(*_insert_pauses(record.time_s, values, after[number]))
            label, group, lacking = ("", None, "missing")
            if several:
                label, group, lacking = names[number], number, f"missing in {names[number]}"
            traces.append(Trace(x=x, y=y, label=label, group=group))
            ends = _find_missing(record.time_s, values, after[number])
            gaps += [Span(start=start, end=end, label=lacking) for start, end in ends]
        longest = sorted(gaps, key=lambda gap: gap.start - gap.end)[:MAX_GAPS]
        title, spans = numbers.column_title(channel), sorted(longest, key=lambda gap: gap.start)
        panels.append(Panel(x_label="time (s)", y_label=title, traces=traces, spans=spans))
    title, caption = "Channels over time", "Samples are missing where it is shaded."
    if several:
        title = "Channels of several logs"
        caption += " Each log is on its own clock: a constant shift along the axis is their offset."
    for record in logs:
        if len(record) > MAX_TRACE_POINTS:
            text = f"{len(record)} samples drawn as their envelope of {MAX_TRACE_POINTS} points"
            warn("SWM051", f"{record.path.name}: {text}")
    if len(order) > MAX_PANELS:
        caption += f" {len(order) - MAX_PANELS} further channels are not drawn."
    return Figure(id="channels", title=title, caption=caption, panels=panels)


def _names(logs: Sequence[Log]) -> list[str]:
    """Return a short name for each log. If two logs have the same name, their folder precedes it."""
    names = [record.path.name for record in logs]
    folders = [record.path.parent.name for record in logs]
    return [n if names.count(n) == 1 else f"{f}/{n}" for n, f in zip(names, folders, strict=True)]


def track(logs: Sequence[Log]) -> Figure | None:
    """Return the figure of the robot's path, to scale, from above or from the side; None without a path.

    Arrows along the path show the heading.
    """
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
        step, after = len(x) // MAX_TRACE_POINTS + 1, pauses(record.time_s)
        line = [_insert_pauses(record.time_s, values, after)[1][::step] for values in (x, y)]
        traces.append(Trace(x=line[0], y=line[1], label=path))
        heading = {"y_m": "yaw_rad", "z_m": "pitch_rad"}[up]
        if heading in record and np.isfinite(x + y).sum() > 1:
            traces.append(_arrows(x, y, record[heading], arrows))
    if not traces:
        return None
    title = {"y_m": "Path from above", "z_m": "Path from the side"}[across]
    caption, y_label = "The path.", numbers.column_title(across)
    if any(trace.style == "arrows" for trace in traces):
        caption = "The path, with arrows along the heading."
    return ev.make_figure("path", title, caption, "x (m)", y_label, traces, equal_aspect=True)


def _arrows(x: Array, y: Array, angle: Array, label: str) -> Trace:
    """Return arrows along the heading at points of a path, drawn as one line with interruptions."""
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


def _spectra(record: Log, stroke: StrokeEstimate) -> Figure:
    """Return the figure of the spectra of channels that may oscillate with the stroke.

    The harmonics of the stroke are marked, if a stroke was found.
    """
    told = (SIDEWAYS, PUSHED)
    signals = {n: v for n, v in record.signals.items() if any(names.fullmatch(n) for names in told)}
    caption = "No stroke was found."
    beats: list[tuple[str, float]] = []
    if stroke.beat is not None:
        signals = dict(sorted(signals.items(), key=lambda item: item[0] not in stroke.channels))
        track = swing(record.columns)
        if stroke.channel in track:
            signals = {f"{stroke.channel}_m": track[stroke.channel], **signals}
        frequency = numbers.format_estimate(stroke.beat.frequency_hz, stroke.beat.stderr_hz, "Hz")
        caption = f"The stroke in {stroke.channel} is {frequency}."
        labels = ("stroke", "2 ×, 3 ×", "2 ×, 3 ×")
        beats = [(label, k * stroke.beat.frequency_hz) for k, label in enumerate(labels, start=1)]
    panels = []
    for name in list(signals)[:MAX_SPECTRA]:
        drawn = _spectrum(record.time_s, signals[name], stroke)
        if drawn is None:
            continue
        shown = [beat for beat in beats if beat[0] == "stroke" or beat[1] <= drawn[0][-1]]
        marks = [Mark(at=beat_hz, axis="x", label=label) for label, beat_hz in shown]
        traces, label = [Trace(x=drawn[0], y=drawn[1])], f"amplitude of {numbers.column_title(name)}"
        panels.append(ev.panel("frequency (Hz)", label, traces, y_scale="log", marks=marks))
    caption += " Amplitudes (Hann window) of the longest stretch without a gap."
    path = record.path
    return ev.panels(f"spectra-{path.stem}", f"Spectra of {path.name}", caption, panels)


def _spectrum(time: Array, values: Array, stroke: StrokeEstimate) -> tuple[Array, Array] | None:
    """Return the spectrum of a channel: frequencies, Hz, and amplitudes; None if too short or constant."""
    even_s, even = longest_even(time, values, MAX_RATE_HZ)
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
    if stroke.beat is not None:
        highest = min(6.5 * stroke.beat.frequency_hz, highest)
    shown = (frequency > 0) & (frequency <= highest)
    if not np.any(amplitude[shown] > 0):
        return None
    floor = 1e-5 * float(amplitude[shown].max())
    return thin_curve(frequency[shown], np.maximum(amplitude[shown], floor))
