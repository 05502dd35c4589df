"""Summary of a run: ``summary.csv``, ``metrics.csv``, and the page ``index.html``.

The summary depends only on the statuses of the items, so that it does not depend on the order of processing.
Estimates of items that are not done with the present plan and version are left out.
"""

from __future__ import annotations

import math
import os
import re
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import swimid
from swimid.files import atomic, tabular
from swimid.files.templates import environment
from swimid.results import numbers
from swimid.runs import status as states
from swimid.runs.plan import Item, Resolved, folder_of
from swimid.runs.status import Metric, Sketch

#: (1) Robust z score beyond which an estimate is an outlier (Iglewicz and Hoaglin, How to Detect and Handle
#: Outliers, ASQC 1993). (2) Standard deviation of the normal distribution divided by its median absolute
#: deviation. (3) Minimum number of items of a group at which z scores are computed.
MAX_Z, SD_OF_MAD, MIN_ITEMS = 3.5, 1.4826, 5
#: Maximum number of estimates that the page draws unfolded for a group, and of items listed on the terminal.
MAX_STRIPS, MAX_LISTED = 8, 10
#: Maximum numbers on the page: table rows, sketches of a group, and points of a strip plot. The CSV files
#: have all items.
MAX_TABLE_ROWS, MAX_SKETCHES, MAX_STRIP_POINTS = 2000, 500, 1000
#: Pattern of control and other characters that must not occur in tables and pages.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
#: Names of the files of a summary.
NAMES = ("index.html", "summary.csv", "metrics.csv")
#: First line of the CSV files of a summary, by which swimid recognises that it wrote them.
MADE_BY_LINE = "# made_by: swimid batch\n"


@dataclass
class Entry:
    """Entry of one item in the summary of a run."""

    id: str
    group: str
    files: list[str]
    state: str
    version: str = ""
    level: str = ""
    reason: str = ""
    metrics: dict[str, Metric] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    sketch: Sketch | None = None
    outputs: list[str] = field(default_factory=list)
    log: str = ""
    hint: str = ""
    #: Robust z score of each estimate that is an outlier in its group.
    outliers: dict[str, float] = field(default_factory=dict)

    @property
    def rank(self) -> tuple[Any, ...]:
        """Sort key: items that need attention come first."""
        largest = max(map(abs, self.outliers.values()), default=0.0)
        return (
            states.STATES.index(self.state),
            -bool(self.outliers),
            states.VERDICT_LEVELS.index(self.level),
            -largest,
            self.id,
        )

    @property
    def is_doubtful(self) -> bool:
        """Whether the item needs attention: it has no result, a bad verdict or an outlier."""
        return self.state not in ("done", "missing") or self.level == "bad" or bool(self.outliers)

    def plain(self) -> dict[str, Any]:
        """Return the entry as plain data, without the sketch of its figure."""
        kept = {k: v for k, v in vars(self).items() if k not in ("metrics", "sketch", "log")}
        return kept | {"metrics": {name: one.model_dump() for name, one in self.metrics.items()}}


@dataclass
class Summary:
    """Items of a run, in the order of the plan."""

    plan: str
    entries: list[Entry]

    @property
    def ranking(self) -> list[Entry]:
        """Items of the run, sorted so that items that need attention come first."""
        return sorted(self.entries, key=lambda entry: entry.rank)

    @property
    def groups(self) -> dict[str, list[Entry]]:
        """Items of the run by the name of their group."""
        found: dict[str, list[Entry]] = {}
        for entry in self.entries:
            found.setdefault(entry.group, []).append(entry)
        return found


def of_run(plan: Resolved, run: Path, problems: Mapping[str, str] | None = None) -> Summary:
    """Return the summary of a run from the statuses of its items.

    ``problems`` has the errors, by item, of items that failed in this run and have no status file.
    """
    entries = [_entry_of(item, folder_of(run, item.id), (problems or {}).get(item.id)) for item in plan.items]
    found = Summary(plan.plan, entries)
    for members in found.groups.values():
        _find_outliers(members)
    return found


def _entry_of(item: Item, folder: Path, problem: str | None) -> Entry:
    """Return the entry of an item. ``problem`` is the error of a failed item without a status file."""
    state, status = states.state_of(item, folder)
    entry = Entry(item.id, item.group, item.files, state)
    if status is not None:
        entry.version = status.version
    if state == "outdated":
        entry.reason = "the steps or inputs have changed since the results were made; they are not used"
        if entry.version != swimid.__version__:
            entry.reason = f"the results were made by swimid {entry.version} and are not used"
    elif status is not None and state != "missing":
        entry.level, entry.metrics = status.level, status.metrics
        entry.reason = status.reason.replace(f"{item.root}/", "")
        entry.warnings = sorted({code for step in status.steps for code in step.warnings})
        entry.sketch, entry.outputs = status.sketch, sorted(status.outputs)
        entry.log, entry.hint = status.error.get("log", ""), status.error.get("hint") or ""
    lock = folder / f"{states.STATUS_FILE}.lock"
    if state in ("missing", "outdated"):
        if holder := atomic.holder_of(lock):
            entry.state = "busy"
            name = f"items/{item.id}/{lock.name}"
            entry.reason = f"the item is processed by {holder}; if there is no such process, delete {name}"
        if problem is not None:
            entry.state, entry.reason = "failed", problem
    for name in ("reason", "hint", "log"):
        setattr(entry, name, _UNPRINTABLE.sub("\ufffd", getattr(entry, name)))
    return entry


def _find_outliers(members: Sequence[Entry]) -> None:
    """Add to each item of a group the robust z scores of its outlying estimates.

    The score is the distance from the median divided by the root of the sum of two variances: the variance of
    the group, from its median absolute deviation, and the variance of the estimate itself.
    """
    for name in metric_names(members):
        having = [entry for entry in members if name in entry.metrics]
        values = np.array([entry.metrics[name].value for entry in having])
        if len(values) < MIN_ITEMS:
            continue
        deviations = values - np.median(values)
        spread = SD_OF_MAD * np.median(np.abs(deviations))
        scales = np.hypot(spread, np.nan_to_num([entry.metrics[name].stderr for entry in having], posinf=0.0))
        for entry, deviation, scale in zip(having, deviations, scales, strict=True):
            if scale > 0 and abs(deviation) > MAX_Z * scale:
                entry.outliers[name] = float(deviation / scale)


def metric_names(members: Sequence[Entry]) -> list[str]:
    """Return the names of the estimates of a group, sorted by the number of items that have the estimate."""
    counts = Counter(name for entry in members for name in entry.metrics)
    order = {name: k for k, name in enumerate(counts)}
    return sorted(counts, key=lambda name: (-counts[name], order[name]))


# ---------------------------------------------------------------- tables


def write(found: Summary, run: Path) -> None:
    """Write page and tables of a summary into the folder of the run."""
    rows = [
        {
            "item": e.id, "group": e.group, "state": e.state, "verdict": e.level, "reason": e.reason,
            "outliers": "; ".join(f"{name} (z {z:.1f})" for name, z in e.outliers.items()),
            "warnings": " ".join(e.warnings), "version": e.version, "files": "; ".join(e.files),
        }
        for e in found.ranking
    ]  # fmt: skip
    values = [
        {"item": e.id, "group": e.group, "quantity": name, **m.model_dump()}
        for e in found.entries
        for name, m in e.metrics.items()
    ]
    columns = ["item", "group", "quantity", "value", "low", "high", "unit"]
    texts = page(found), _csv(pd.DataFrame(rows)), _csv(pd.DataFrame(values, columns=columns))
    with atomic.write_together():
        for name, text in zip(NAMES, texts, strict=True):
            atomic.write_text(run / name, text)


def _csv(table: pd.DataFrame) -> str:
    return MADE_BY_LINE + table.map(tabular.plain_text).to_csv(index=False, lineterminator="\n")


def text(entries: Sequence[Entry]) -> str:
    """Return the text of a summary for a terminal: number of items by state, and items to check."""
    counts = Counter(entry.state for entry in entries)
    levels = Counter(entry.level for entry in entries if entry.state == "done")
    parts = [f"{counts[state]} {state}" for state in reversed(states.STATES) if counts[state]]
    lines = [f"{len(entries)} items: {', '.join(parts)}"]
    if levels:
        shown = [f"{levels[level]} {level}" for level in ("good", "caution", "bad") if levels[level]]
        lines.append(f"  verdicts of the items that are done: {', '.join(shown)}")
    doubtful = sorted((entry for entry in entries if entry.is_doubtful), key=lambda entry: entry.rank)
    for entry in doubtful[:MAX_LISTED]:
        said = entry.reason
        if entry.outliers:
            name, z = max(entry.outliers.items(), key=lambda pair: abs(pair[1]))
            said = f"outlier: {name} is {abs(z):.1f} standard deviations from the median of its group"
        word = entry.state if entry.state != "done" else entry.level
        lines.append(f"  {word:9s} {entry.id}: {said}"[:200].splitlines()[0])
    if len(doubtful) > MAX_LISTED:
        lines.append(f"  and {len(doubtful) - MAX_LISTED} more that need attention: see the page")
    return "\n".join(lines)


# ---------------------------------------------------------------- page


def page(found: Summary) -> str:
    """Return the HTML page of a run, without scripts. Radio buttons select the order of its table."""
    style = environment("swimid.results").get_template("report.css").render()
    groups = [_group(name, members) for name, members in found.groups.items()]
    templates = environment("swimid.runs", autoescape=True, lstrip_blocks=True)
    return templates.get_template("group.html").render(
        plan=found.plan,
        version=swimid.__version__,
        style=style,
        entries=found.ranking[:MAX_TABLE_ROWS],
        total=len(found.entries),
        counts=Counter(entry.state for entry in found.entries),
        levels=Counter(entry.level for entry in found.entries if entry.state == "done"),
        states=states.STATES,
        doubtful=[entry for entry in found.ranking if entry.is_doubtful],
        orders=_orders(found.ranking[:MAX_TABLE_ROWS]),
        groups=groups,
        number=numbers.format_number,
        unit=numbers.unit_text,
    )


def _orders(entries: Sequence[Entry]) -> dict[str, dict[str, int]]:
    """Return, for each sortable column of the table, the rank of each item."""
    keys: dict[str, Any] = {
        "attention": lambda e: e.rank,
        "item": lambda e: e.id,
        "group": lambda e: (e.group, e.rank),
        "verdict": lambda e: (states.VERDICT_LEVELS.index(e.level), e.rank),
        "outlier": lambda e: (-max(map(abs, e.outliers.values()), default=0.0), e.rank),
    }
    return {
        name: {entry.id: k for k, entry in enumerate(sorted(entries, key=key))} for name, key in keys.items()
    }


#: Width and height of a strip plot of estimates, and of a sketch of a figure, in SVG units.
WIDE, HIGH, SMALL_WIDE, SMALL_HIGH = 300, 90, 120, 70


def _group(name: str, members: list[Entry]) -> dict[str, Any]:
    """Return the template variables of one group: strip plots of its estimates, sketches of its items."""
    strips = [strip for one in metric_names(members) if (strip := _strip(one, members)) is not None]
    drawn = [entry for entry in members if entry.sketch is not None]
    common = 0
    if len(drawn) > 1:
        common = len(os.path.commonprefix([entry.id for entry in drawn]))  # noqa: RUF071 - of texts
    sketches = [_sketch(entry) | {"label": entry.id[common:]} for entry in drawn[:MAX_SKETCHES]]
    axes = ""
    if sketches:
        first = next(entry.sketch for entry in members if entry.sketch is not None)
        axes = f"{first.title}: {first.y_label} over {first.x_label}"
    return {
        "name": name, "count": len(members), "strips": strips[:MAX_STRIPS], "more": strips[MAX_STRIPS:],
        "sketches": sketches, "drawn": len(drawn), "axes": axes,
    }  # fmt: skip


def _strip(name: str, members: Sequence[Entry]) -> dict[str, Any] | None:
    """Return a strip plot of one estimate over the items of a group; None for fewer than two items."""
    shown = [(k, e, e.metrics[name]) for k, e in enumerate(members) if name in e.metrics]
    if len(shown) < 2:
        return None
    values = [one.value for _, _, one in shown]
    # Scale the plot to the typical interval, and cut the intervals that are much wider.
    half = statistics.median(
        numbers.Z95 * (0.0 if math.isnan(one.stderr) else one.stderr) for _, _, one in shown
    )
    margin = 0.08 * (max(values) - min(values)) + half
    if not margin:
        margin = 0.5 * abs(values[0]) or 1.0
    low, high = min(values) - margin, max(values) + margin

    def height(value: float) -> float:
        return round(HIGH * (1 - (min(max(value, low), high) - low) / (high - low)), 1)

    step = WIDE / max(len(members), 1)
    points = []
    every = math.ceil(len(shown) / MAX_STRIP_POINTS)
    for k, entry, one in shown:
        if k % every and name not in entry.outliers:
            continue
        bar = None
        if one.low is not None and one.high is not None:
            bar = (height(one.high), height(one.low))
        points.append({
            "x": round((k + 0.5) * step, 1), "y": height(one.value), "bar": bar, "entry": entry,
            "outlier": name in entry.outliers, "value": one.value,
        })  # fmt: skip
    middle = statistics.median(values)
    return {
        "name": name, "unit": shown[0][2].unit, "points": points, "median": middle, "at": height(middle),
        "low": min(values), "high": max(values), "count": len(shown),
    }  # fmt: skip


def _sketch(entry: Entry) -> dict[str, Any]:
    """Return the lines of the sketch of an item, scaled to the size of the drawing."""
    sketch = entry.sketch
    assert sketch is not None
    traces = [np.array(trace, dtype=float) for trace in sketch.traces]
    points = np.hstack(traces) if traces else np.empty((2, 0))
    if not np.isfinite(points).any(axis=1).all():
        return {"entry": entry, "lines": []}
    low = np.nanmin(points, axis=1)
    span = np.nanmax(points, axis=1) - low
    scale = np.array([SMALL_WIDE, SMALL_HIGH]) / np.where(span > 0, span, 1.0)
    if sketch.equal_aspect:
        scale[:] = scale.min()
    lines = []
    for trace, style in zip(traces, sketch.styles, strict=True):
        x, y = (trace - low[:, None]) * scale[:, None]
        known = np.isfinite(x) & np.isfinite(y)
        words = np.where(np.r_[False, known[:-1]], "L", "M")
        parts = [f"{words[k]}{x[k]:.0f} {SMALL_HIGH - y[k]:.0f}" for k in np.flatnonzero(known)]
        lines.append({"path": "".join(parts), "dots": style in ("points", "stems", "arrows")})
    return {"entry": entry, "lines": lines}
