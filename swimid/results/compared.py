"""Several fits of one model side by side: one table and one figure of their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from swimid.results import numbers
from swimid.results.evidence import Evidence, Figure, Panel, Table, Trace, Verdict
from swimid.results.fitted import Fitted, interval95, value_text
from swimid.results.parameters import Estimate
from swimid.results.result import Result

#: Maximum number of parameters drawn.
MAX_PANELS = 6


def compared(results: Sequence[Result]) -> list[tuple[list[Fitted], Evidence]]:
    """Return each group of two or more fits of one model, with a table and a figure of their parameters.

    Fits are compared only where they have the same parameters in the same units.
    """
    groups: dict[Any, list[Fitted]] = {}
    for result in results:
        if isinstance(result, Fitted):
            shared = frozenset((n, e.unit) for n, e in result.file.parameters.items() if "[" not in n)
            groups.setdefault((result.file.model, shared), []).append(result)
    return [(fits, _side_by_side(fits)) for fits in groups.values() if len(fits) > 1]


def _side_by_side(fits: Sequence[Fitted]) -> Evidence:
    names = [fit.path.stem for fit in fits]
    rows: list[list[Any]] = []
    panels = []
    for name, first in fits[0].file.parameters.items():
        if "[" in name:
            continue
        held = [fit.file.parameters[name] for fit in fits]
        if not any(e.status == "estimated" for e in held):
            continue
        rows.append([name, *map(value_text, held)])
        panels.append(_panel(name, numbers.unit_text(first.unit), held, names))
    levels = [fit.verdict for fit in fits]
    level: Literal["good", "caution", "bad"] = "good" if set(levels) == {"good"} else "caution"
    caption = "Estimates of each file; bars are 95 % intervals."
    columns = ["parameter", *names]
    return Evidence(
        verb="report",
        title=f"{len(fits)} fits of {fits[0].file.model} side by side",
        verdict=Verdict(
            level="bad" if "bad" in levels else level,
            text=f"{levels.count('good')} of {len(fits)} fits are good.",
        ),
        tables=[Table(id="compared", title="Parameters", columns=columns, rows=rows)],
        figures=[
            Figure(id="compared", title="Estimates", caption=caption, panels=panels[:MAX_PANELS], columns=2)
        ],
    )


def _panel(name: str, unit: str, held: Sequence[Estimate], names: list[str]) -> Panel:
    """Return the estimates of one parameter with their intervals."""
    known = [(k, e) for k, e in enumerate(held) if e.status == "estimated"]
    ends = [interval95(e) for _, e in known]
    points = Trace(
        x=[k for k, _ in known],
        y=[e.value for _, e in known],
        y_error=[(end[1] - end[0]) / 2 if end else None for end in ends],
        style="points",
    )
    return Panel(x_label="", y_label=f"{name} ({unit or '1'})", traces=[points], x_categories=names)
