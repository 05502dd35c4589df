"""Rows of the table: what a measurement counts, the wanted range, and whether the count lies in it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

ALARM = "alarm: "
#: Maximum width of the 95 % interval of a share, of which a row may say that it is ok: of the coverage of
#: intervals, and of the rate of alarms. With 400 repeats a coverage of 95 % has a width of 4.5 points, and no
#: alarm at all one of 0.9 points.
MAX_WIDTH, MAX_ALARM_WIDTH = 0.06, 0.03
#: Ends of the names of quantities that state their wanted range: a share in per cent, or a ratio.
SHARE, WIDTH = " ({} to {} % wanted)", "at most "
#: Wanted coverage of a 95 % interval.
COVERAGE = (0.92, 0.98)
#: Rates of false alarms of the checks that state a significance level, by a part of the name of the check.
LEVELS = {
    "white": 0.01,
    "independent of the input": 0.01,
    "equal parameters in all trials": 0.001,
    "agree": 0.01,
}
#: Largest rate of false alarms of a check with a limit that noise alone never reaches.
NEVER = 0.01


@dataclass(frozen=True)
class Row:
    """Share of a quantity over the repeats of a measurement."""

    quantity: str
    repeats: int
    share: float
    low: float
    high: float
    wanted: tuple[float, float]

    @property
    def verdict(self) -> str:
        """``ok`` if the 95 % interval is in the wanted range, or overlaps it and is narrow.

        A wide interval that overlaps it shows nothing: ``too few repeats``.
        """
        if self.low > self.wanted[1] or self.high < self.wanted[0]:
            return "**not**"
        inside = self.low >= self.wanted[0] and self.high <= self.wanted[1]
        widest = MAX_ALARM_WIDTH if ALARM in self.quantity else MAX_WIDTH
        if not inside and self.high - self.low > widest:
            return "too few repeats"
        return "ok"

    @property
    def ok(self) -> bool:
        """Whether the verdict is ``ok``."""
        return self.verdict == "ok"

    @property
    def text(self) -> str:
        """Row of a table in Markdown."""
        share, low, high, least, most = (
            f"{100 * x:.1f}" for x in (self.share, self.low, self.high, *self.wanted)
        )
        cells = (
            self.quantity,
            self.repeats,
            f"{share} %",
            f"{low} … {high} %",
            f"{least} … {most} %",
            self.verdict,
        )
        return "| " + " | ".join(map(str, cells)) + " |"


def inside(estimate: dict[str, Any], true: float) -> float:
    """Return 1 if the 95 % interval of an estimate holds the true value, 0 if not, NaN if none is stated."""
    if estimate["status"] != "estimated":
        return float("nan")
    return float(abs(estimate["value"] - true) <= 1.96 * estimate["stderr"])


def alarms(result: Any, name: str = "") -> dict[str, float]:
    """Return for each check of a result whether it warns or fails.

    The verdict counts as a false alarm if it is not good although every check passes. That no trial is held
    out, and that differences between trials would not show, are facts of these experiments, and no alarms.
    """
    found = {f"{name}{ALARM}{c.name}": float(c.verdict in ("warn", "fail")) for c in result.evidence.checks}
    silent = not any(found.values())
    for fact in ("held-out trials", "differences between trials visible"):
        found.pop(f"{name}{ALARM}{fact}", None)
    return {**found, f"{name}{ALARM}verdict without a reason": float(silent and result.verdict != "good")}


def wanted(quantity: str) -> tuple[float, float]:
    """Return the wanted range of the share of a quantity."""
    stated = re.search(r"\((\d+) to (\d+) % wanted\)$", quantity)
    if stated is not None:
        low, high = stated.groups()
        return (int(low) / 100, int(high) / 100)
    if WIDTH in quantity:
        return (0.0, float(quantity.rpartition(WIDTH)[2]))
    if ALARM not in quantity:
        return COVERAGE
    name = quantity.split(ALARM)[1]
    level = max((level for part, level in LEVELS.items() if part in name), default=NEVER)
    if level == NEVER and not any(part in name for part in LEVELS):
        return (0.0, NEVER)
    return (0.0, 2.0 * level)


def row(quantity: str, values: list[float]) -> Row | None:
    """Return the row of a quantity from its value in each repeat; None without values.

    The interval of a share of repeats is that of Clopper and Pearson. The interval of a mean share of samples
    within each repeat is Student's.
    """
    known = np.array([value for value in values if np.isfinite(value)])
    n = len(known)
    if n < 2:
        return None
    mean = float(known.mean())
    if np.isin(known, (0.0, 1.0)).all():
        interval = stats.binomtest(int(known.sum()), n).proportion_ci(0.95, "exact")
        low, high = float(interval.low), float(interval.high)
    else:
        half = float(stats.t.ppf(0.975, n - 1) * known.std(ddof=1) / np.sqrt(n))
        low, high = max(mean - half, 0.0), mean + half
        if mean <= 1.0:
            high = min(high, 1.0)
    return Row(quantity, n, mean, low, high, wanted(quantity))
