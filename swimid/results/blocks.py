"""Tables and figures that several packages use. The functions take numbers, not models or fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from swimid.notices import Notice
from swimid.results import numbers
from swimid.results.evidence import Figure, Mark, NoticeRecord, Panel, Span, Table, Trace, thinned

#: Maximum number of points of one trial in a figure of several trials.
POINTS = 400
#: Number of measured points over the width of a panel that also shows a line, for a straight curve.
MAX_MARKS = 50
#: Maximum number of trials in a figure of residuals, and largest residual in it. Each trial is a row of the
#: figure, which shows weighted residuals between -ROW_SD and ROW_SD standard deviations of the noise.
MAX_ROWS, ROW_SD = 12, 4.0
#: Distance of ROW_SD standard deviations from the middle of a row, in rows.
HALF_ROW = 0.45

Cell = str | float | int | bool | None


#: Channel of one trial, an object with ``trial``, ``role`` ("fit" or "validate"), and the arrays ``time_s``,
#: ``measured``, ``simulated`` and ``weighted`` (measured minus simulated, divided by the standard deviation
#: of the noise).
Series = Any
#: Correlation function, an object with ``lags``, ``values`` and ``bound``. The bound is the half-width of the
#: 95 % band of white noise.
Correlogram = Any


# ---------------------------------------------------------------- words


def p_text(p: float) -> str:
    """Return a p-value as text.

    >>> p_text(0.0321), p_text(1e-20)
    ('p = 0.032', 'p < 10⁻¹⁶')
    """
    if p < 1e-16:
        return "p < 10⁻¹⁶"
    return f"p = {numbers.number(p, 2)}"


def notices(recorded: Sequence[Notice]) -> list[NoticeRecord]:
    """Return recorded warnings as entries of the evidence."""
    return [NoticeRecord(code=n.code, text=n.text) for n in recorded]


# ---------------------------------------------------------------- tables


def table(
    id: str, title: str, rows: Sequence[Mapping[str, Cell]], caption: str = "", columns: Sequence[str] = ()
) -> Table:
    """Return a table from rows, each a mapping of column names to cells.

    Parameters
    ----------
    columns : sequence of str
        Names of the columns, required if there may be no rows. The default is the columns of the first row.
    """
    names = list(columns or rows[0])
    return Table(
        id=id, title=title, columns=names, rows=[[row[n] for n in names] for row in rows], caption=caption
    )


# ---------------------------------------------------------------- figures


def figure(
    id: str,
    title: str,
    caption: str,
    x_label: str,
    y_label: str,
    traces: Sequence[Trace],
    **panel: Any,
) -> Figure:
    """Return a figure with one panel. Further keyword arguments are fields of :class:`Panel`."""
    one = Panel(x_label=x_label, y_label=y_label, traces=list(traces), **panel)
    return Figure(id=id, title=title, caption=caption, panels=[one])


def panels(id: str, title: str, caption: str, panels: Sequence[Panel]) -> Figure:
    """Return a figure with several panels."""
    return Figure(id=id, title=title, caption=caption, panels=list(panels))


def panel(x_label: str, y_label: str, traces: Sequence[Trace], **more: Any) -> Panel:
    """Return a panel. Further keyword arguments are fields of :class:`Panel`."""
    return Panel(x_label=x_label, y_label=y_label, traces=list(traces), **more)


def band(x: Any, y: Any, half: Any, **trace: Any) -> Trace:
    """Return a curve with a band of half-width ``half`` around the curve."""
    return Trace(x=x, y=y, lower=y - half, upper=y + half, **trace)


def points(runs: Sequence[Any], x: Callable[[Any], Any], y: Callable[[Any], Any], **trace: Any) -> Trace:
    """Return a trace with one point for each of ``runs``, at the coordinates that ``x`` and ``y`` compute."""
    return Trace(x=[x(run) for run in runs], y=[y(run) for run in runs], style="points", **trace)


def measured_and_simulated(
    id: str,
    title: str,
    caption: str,
    x_label: str,
    y_label: str,
    shown: Sequence[Series],
    factor: float = 1.0,
) -> Figure:
    """Return a figure of measured points and simulated lines for the worst and the best trial.

    There is a panel for the fitted trial with the largest root-mean-square weighted residual, for the fitted
    trial with the smallest, and for the held-out trial with the largest. ``factor`` converts values to the
    unit of the figure.
    """
    drawn: list[Panel] = []
    for name, s in _extremes(shown).items():
        known = apart(s.time_s, s.measured)
        x, y = thinned(s.time_s, factor * s.simulated, POINTS)
        measured = factor * s.measured[known]
        traces = [
            Trace(x=s.time_s[known], y=measured, style="points", label="measured", group=0),
            Trace(x=x, y=y, label="simulated", group=0),
        ]
        drawn.append(panel(x_label, y_label, traces, title=name))
    return panels(id, title, caption, drawn)


def apart(x: Any, y: Any) -> Any:
    """Return the indices of samples that are 1 / MAX_MARKS of the panel's width apart along the curve.

    A curve that rises and falls gets more points than a straight one, at most :data:`POINTS`. The panel is
    twice as wide as it is high.
    """
    known = np.flatnonzero(np.isfinite(y))
    if not len(known):
        return known
    steps = np.hypot(
        np.diff(x[known]) / max(float(np.ptp(x[known])), 1e-300),
        np.diff(y[known]) / max(2.0 * float(np.ptp(y[known])), 1e-300),
    )
    number = np.floor(np.concatenate(([0.0], np.cumsum(steps))) * MAX_MARKS)
    marks = known[np.unique(number, return_index=True)[1]]
    return marks[:: -(-len(marks) // POINTS)]


def _extremes(shown: Sequence[Series]) -> dict[str, Series]:
    """Return the worst and the best fitted trial and the worst held-out trial, by panel title."""
    ranked = sorted(shown, key=lambda s: _rms(s.weighted))
    fitted = [s for s in ranked if s.role == "fit"]
    held_out = [s for s in ranked if s.role != "fit"]
    if len(fitted) == 1:
        found = {fitted[0].trial: fitted[0]}
    else:
        found = {
            f"{s.trial} ({word})": s
            for word, s in zip(("largest error", "smallest error"), fitted[-1:] + fitted[:1], strict=False)
        }
    return found | {f"{s.trial} (held out)": s for s in held_out[-1:]}


def _rms(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.sum(known**2) / max(len(known), 1)))


def residuals(
    id: str, title: str, caption: str, x_label: str, shown: Sequence[Series], correlation: Correlogram | None
) -> Figure:
    """Return a figure of the weighted residuals of the worst trials, and of a given autocorrelation."""
    worst = sorted(range(len(shown)), key=lambda k: -_rms(shown[k].weighted))[:MAX_ROWS]
    rows = [shown[k] for k in sorted(worst)]
    mixed = len({s.role for s in rows}) > 1
    traces: list[Trace] = []
    for k, s in enumerate(rows):
        x, y = thinned(s.time_s, np.clip(s.weighted, -ROW_SD, ROW_SD), POINTS)
        group, label = 0, "fitted" if mixed else "residuals"
        if s.role != "fit":
            group, label = 1, "held out"
        traces.append(Trace(x=x, y=k - y * HALF_ROW / ROW_SD, style="points", label=label, group=group))
    over_time = Panel(
        x_label=x_label,
        y_label="trial",
        y_categories=[s.trial for s in rows],
        invert_y=True,
        traces=traces,
        spans=[
            Span(start=k - HALF_ROW / 2, end=k + HALF_ROW / 2, axis="y", label=f"±{ROW_SD / 2:g} sd")
            for k in range(len(rows))
        ],
    )
    caption += f" Each row is a trial; the band is ±{ROW_SD / 2:g} standard deviations."
    if correlation is None:
        return panels(id, title, caption, [over_time])
    lagged = correlogram(correlation, "autocorrelation", "residuals", skip_zero=True)
    caption += " The autocorrelation is of all fitted trials, with the 95 % band of white noise."
    return panels(id, title, caption, [over_time, lagged])


def correlogram(correlation: Correlogram, y_label: str, label: str, *, skip_zero: bool) -> Panel:
    """Return a panel with a correlation function as stems, and with the 95 % band of white noise."""
    keep = np.ones(len(correlation.lags), dtype=bool)
    if skip_zero:
        keep = correlation.lags != 0
    lags = correlation.lags[keep]
    stems = Trace(x=lags, y=correlation.values[keep], style="stems", label=label, group=0)
    null = band(lags, np.zeros(len(lags)), correlation.bound[keep], label="95 % band", group=1)
    return panel("lag (samples)", y_label, [stems, null], marks=[Mark(at=0.0)])
