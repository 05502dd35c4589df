"""Report blocks that recur in every room: checks, tables and figures, from plain numbers.

A room brings its numbers and its captions; how a check is decided, a table laid out and a residual drawn is
said here once. Nothing here knows a model or a fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from swimid.notices import Notice
from swimid.results import numbers
from swimid.results.evidence import (
    Check,
    Evidence,
    Figure,
    Mark,
    NoticeRecord,
    Panel,
    Table,
    Trace,
    thinned,
)

#: Points of one trial in a figure that shows many.
POINTS = 400

Cell = str | float | int | bool | None


#: One channel of one trial: ``trial``, ``role`` ("fit" or "validate"), and arrays ``time_s``, ``measured``,
#: ``simulated`` and ``weighted`` (measured minus simulated over the noise's standard deviation).
Series = Any
#: A correlation function: ``lags``, ``values`` and ``bound``, the half-width of its 95 % band.
Correlogram = Any


# ---------------------------------------------------------------- words


def check(
    name: str,
    value: str,
    limit: str,
    passed: bool,
    *,
    otherwise: Literal["warn", "fail"] = "warn",
    text: str = "",
) -> Check:
    """A test of the result against a limit."""
    return Check(name=name, value=value, limit=limit, verdict="pass" if passed else otherwise, text=text)


def p_text(p: float) -> str:
    """A p-value as a check shows it.

    >>> p_text(0.0321), p_text(1e-20)
    ('p = 0.032', 'p < 10⁻¹⁶')
    """
    return f"p = {numbers.number(p, 2)}" if p >= 1e-16 else "p < 10⁻¹⁶"


def judgement(evidence: Evidence) -> str:
    """The checks in one line for the terminal."""
    failed = [c.name for c in evidence.checks if c.verdict in ("warn", "fail")]
    return f"look at {', '.join(failed)}" if failed else "every check passes"


def notices(recorded: Sequence[Notice]) -> list[NoticeRecord]:
    """Recorded warnings as evidence."""
    return [NoticeRecord(code=n.code, text=n.text) for n in recorded]


# ---------------------------------------------------------------- tables


def table(
    id: str, title: str, rows: Sequence[Mapping[str, Cell]], caption: str = "", columns: Sequence[str] = ()
) -> Table:
    """A table of rows that name their columns.

    Parameters
    ----------
    columns : sequence of str
        Of a table that may be empty; by default those of the first row.
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
    """A figure of one panel; what else a :class:`Panel` takes by keyword."""
    one = Panel(x_label=x_label, y_label=y_label, traces=list(traces), **panel)
    return Figure(id=id, title=title, caption=caption, panels=[one])


def panels(id: str, title: str, caption: str, panels: Sequence[Panel], columns: int = 2) -> Figure:
    """A figure of several panels, so many side by side."""
    return Figure(id=id, title=title, caption=caption, panels=list(panels), columns=columns)


def panel(x_label: str, y_label: str, traces: Sequence[Trace], **more: Any) -> Panel:
    """One panel; what else a :class:`Panel` takes by keyword."""
    return Panel(x_label=x_label, y_label=y_label, traces=list(traces), **more)


def band(x: Any, y: Any, half: Any, **trace: Any) -> Trace:
    """A curve with a band of this half-width about it."""
    return Trace(x=x, y=y, lower=y - half, upper=y + half, **trace)


def points(runs: Sequence[Any], x: Callable[[Any], Any], y: Callable[[Any], Any], **trace: Any) -> Trace:
    """A point for each run."""
    return Trace(x=[x(run) for run in runs], y=[y(run) for run in runs], style="points", **trace)


def measured_and_simulated(
    id: str, title: str, caption: str, x_label: str, y_label: str, shown: Sequence[Series]
) -> Figure:
    """The trials' measurements as points, their simulations as lines, dashed where held out."""
    traces = []
    for group, s in enumerate(shown):
        held_out = "" if s.role == "fit" else ", held out"
        x, y = thinned(s.time_s, s.measured, POINTS)
        traces.append(Trace(x=x, y=y, style="points", label=f"{s.trial}{held_out}", group=group))
        x, y = thinned(s.time_s, s.simulated, POINTS)
        traces.append(Trace(x=x, y=y, style="line" if s.role == "fit" else "dashed", group=group))
    return figure(id, title, caption, x_label, y_label, traces)


def residuals(
    id: str, title: str, caption: str, x_label: str, shown: Sequence[Series], correlation: Correlogram
) -> Figure:
    """The trials' residuals over their standard deviation, and the autocorrelation of all."""
    traces = []
    for group, s in enumerate(shown):
        x, y = thinned(s.time_s, s.weighted, POINTS)
        traces.append(Trace(x=x, y=y, style="points", label=s.trial, group=group))
    marks = [Mark(at=-2.0), Mark(at=0.0), Mark(at=2.0)]
    over_time = Panel(x_label=x_label, y_label="residual / sd", traces=traces, marks=marks)
    stems, null = correlogram_traces(correlation, skip_zero=True)
    lagged = Panel(
        x_label="lag (samples)", y_label="autocorrelation", traces=[stems, null], marks=[Mark(at=0.0)]
    )
    return Figure(id=id, title=title, caption=caption, columns=2, panels=[over_time, lagged])


def correlogram(correlation: Correlogram, y_label: str, label: str, *, skip_zero: bool) -> Panel:
    """A correlation function as stems over its band."""
    stems, null = correlogram_traces(correlation, skip_zero=skip_zero)
    stems.label, stems.group, null.group = label, 0, 1
    return Panel(x_label="lag (samples)", y_label=y_label, traces=[null, stems], marks=[Mark(at=0.0)])


def correlogram_traces(correlation: Correlogram, *, skip_zero: bool) -> tuple[Trace, Trace]:
    """Stems at the lags, and the 95 % band."""
    keep = correlation.lags != 0 if skip_zero else np.ones(len(correlation.lags), dtype=bool)
    lags = correlation.lags[keep]
    stems = Trace(x=lags, y=correlation.values[keep], style="stems")
    return stems, band(lags, np.zeros(len(lags)), correlation.bound[keep], label="95 % band")
