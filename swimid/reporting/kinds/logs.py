"""Logs (CSV or Parquet), from tracking or from anywhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from swimid.formats import log
from swimid.formats.evidence import MAX_POINTS, Evidence, Figure, Panel, Span, Trace, Verdict, thinned
from swimid.formats.log import Log
from swimid.notices import warn
from swimid.reporting import numbers
from swimid.reporting.results import reader
from swimid.reporting.sections import LONG_TABLE, Block, Cell, Grid, Section, mapping_grid

#: More channels than this are listed in the table and not drawn.
MAX_PANELS = 12
#: More gaps than this are drawn by the longest of them.
MAX_SPANS = 60


@reader(endings=(".csv", ".parquet", ".pq"))
def section(path: Path, evidence: Evidence | None) -> Section:
    """The section of a log; without evidence its channels over time, gaps shaded."""
    record = log.read(path)
    channels = {name: values for name, values in record.columns.items() if name != log.TIME}
    blocks: list[Block] = [_summary(record, channels)]
    if evidence is None:
        blocks += _figures(record, channels)
    if record.metadata:
        blocks.append(mapping_grid("Metadata of the log", record.metadata))
    missing = max((float(np.mean(np.isnan(v))) for v in channels.values()), default=0.0)
    found = f"up to {numbers.percent(missing)} of a channel missing" if missing else "no sample missing"
    if record.metadata.get("made_by") == "swimid simulate":
        verdict = Verdict(level="good", text=f"A simulated run; {found}.")
    else:
        verdict = Verdict(level="caution", text=f"A log without evidence of how it was made; {found}.")
    return Section(
        path=path,
        kind="Log",
        title=f"Log {path.name}",
        verdict=verdict,
        facts=_facts(record),
        blocks=blocks,
        data={"metadata": record.metadata, "samples": len(record), "channels": list(channels)},
    )


def _facts(record: Log) -> list[tuple[str, str]]:
    time = record.time_s
    return [
        ("Samples", str(len(time))),
        ("Duration", numbers.number(float(time[-1] - time[0]), unit="s")),
        ("Median rate", numbers.number(1.0 / float(np.median(np.diff(time))), unit="Hz")),
    ]


def _summary(record: Log, channels: dict[str, NDArray[np.float64]]) -> Grid:
    rows = []
    for name, values in channels.items():
        known = values[np.isfinite(values)]
        ends = (float(known.min()), float(known.max())) if len(known) else (None, None)
        rows.append(
            [
                Cell(name, "code"),
                Cell(numbers.unit_text(numbers.split_unit(name)[1])),
                Cell(numbers.number(ends[0]), numeric=True),
                Cell(numbers.number(ends[1]), numeric=True),
                Cell(numbers.percent(1 - len(known) / len(values)), numeric=True),
                Cell(numbers.number(_longest_gap(record.time_s, values), 3, "s"), numeric=True),
            ]
        )
    columns = ["Channel", "Unit", "Smallest", "Largest", "Missing", "Longest gap"]
    caption = "Good: few samples missing, in gaps short against one stroke."
    return Grid("Channels", columns, rows, caption, folded=len(rows) > LONG_TABLE)


def _gaps(time: NDArray[np.float64], values: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Stretches between two samples that lack what lies between them, s."""
    lost = np.flatnonzero(np.diff(np.concatenate([[0], np.isnan(values).astype(int), [0]])))
    last = len(time) - 1
    return [
        (float(time[max(first - 1, 0)]), float(time[min(end, last)]))
        for first, end in zip(lost[::2], lost[1::2], strict=True)
    ]


def _longest_gap(time: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    return max((end - start for start, end in _gaps(time, values)), default=0.0)


def _figures(record: Log, channels: dict[str, NDArray[np.float64]]) -> list[Block]:
    figures: list[Block] = []
    shown = list(channels)[:MAX_PANELS]
    panels = [_panel(record.time_s, name, channels[name]) for name in shown]
    remarks = [
        "Each channel over time; shaded where samples are missing. Good: smooth curves without jumps, "
        "and gaps that are few and short."
    ]
    if len(record) > MAX_POINTS:
        text = f"{record.path.name}: {len(record)} samples drawn as their envelope of {MAX_POINTS} points"
        warn("SWM051", text)
        remarks.append(f"{len(record)} samples are drawn as their envelope of at most {MAX_POINTS} points.")
    if len(channels) > MAX_PANELS:
        remarks.append(f"{len(channels) - MAX_PANELS} further channels are in the table only.")
    if panels:
        figures.append(
            Figure(id="channels", title="Channels over time", caption=" ".join(remarks), panels=panels)
        )
    for across in ("y_m", "z_m"):
        if "x_m" in channels and across in channels:
            figures.append(_path(channels["x_m"], channels[across], across))
            break
    return figures


def _panel(time: NDArray[np.float64], name: str, values: NDArray[np.float64]) -> Panel:
    x, y = thinned(time, values)
    gaps = sorted(_gaps(time, values), key=lambda gap: gap[0] - gap[1])[:MAX_SPANS]
    return Panel(
        x_label="time (s)",
        y_label=numbers.column_title(name),
        traces=[Trace(x=x, y=y)],
        spans=[Span(start=start, end=end, label="missing") for start, end in sorted(gaps)],
    )


def _path(x: NDArray[np.float64], across: NDArray[np.float64], name: str) -> Figure:
    step = max(len(x) // MAX_POINTS, 0) + 1
    every = f" Every {numbers.ordinal(step)} sample is drawn." if step > 1 else ""
    panel = Panel(
        x_label="x (m)",
        y_label=numbers.column_title(name),
        traces=[
            Trace(x=x[::step], y=across[::step], label="path"),
            Trace(x=x[:1], y=across[:1], label="start", style="points"),
        ],
        equal_aspect=True,
    )
    return Figure(
        id="path",
        title="Path",
        caption="The path to scale. Good: one continuous line inside the pool." + every,
        panels=[panel],
    )
