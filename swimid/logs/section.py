"""Logs (CSV or Parquet), from tracking or from anywhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from swimid.files import parquet
from swimid.logs import figures as log_figures
from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.sampling import pauses
from swimid.results import numbers
from swimid.results.evidence import Evidence, Verdict
from swimid.results.reader import reader
from swimid.results.sections import LONG_TABLE, Block, Cell, Grid, Section, mapping_grid


@reader(endings=(".csv", *parquet.ENDINGS), read=log.read)
def section(path: Path, record: Log, evidence: Evidence | None) -> Section:
    """The section of a log; without evidence its channels over time, gaps shaded."""
    time = record.time_s
    channels = {name: values for name, values in record.columns.items() if name != log.TIME}
    blocks: list[Block] = [_summary(record, channels)]
    if evidence is None:
        blocks += log_figures.figures([record])
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
        facts=[
            ("Samples", str(len(record))),
            ("Duration", numbers.number(float(time[-1] - time[0]), unit="s")),
            ("Median rate", numbers.number(1.0 / float(np.median(np.diff(time))), unit="Hz")),
        ],
        blocks=blocks,
        data={"metadata": record.metadata, "samples": len(record), "channels": list(channels)},
    )


def _summary(record: Log, channels: dict[str, NDArray[np.float64]]) -> Grid:
    rows, after = [], pauses(record.time_s)
    for name, values in channels.items():
        known = values[np.isfinite(values)]
        gaps = log_figures.missing(record.time_s, values, after)
        told = (
            numbers.number(float(known.min()) if len(known) else None),
            numbers.number(float(known.max()) if len(known) else None),
            numbers.percent(1 - len(known) / len(values)),
            numbers.number(max((end - start for start, end in gaps), default=0.0), 3, "s"),
        )
        unit = numbers.unit_text(numbers.split_unit(name)[1])
        rows.append([Cell(name, "code"), Cell(unit), *(Cell(text, numeric=True) for text in told)])
    columns = ["Channel", "Unit", "Smallest", "Largest", "Missing", "Longest gap"]
    caption = "Good: few samples missing, in gaps short against one stroke."
    return Grid("Channels", columns, rows, caption, folded=len(rows) > LONG_TABLE)
