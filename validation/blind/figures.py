"""Figures by which a diagnosis is judged, with counts and intervals, and the comparison of two runs."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from scipy.stats import binomtest

Row = dict[str, Any]
#: Gaps (error in the worst channel over the noise) from which an effect is visible, and large.
VISIBLE, LARGE = 1.5, 3.0
#: Noncentrality, after a refit with any single effect, from which the noise-free data exclude each of them.
EXCLUDED = 150.0
#: Squared distance, in standard deviations, from which the trials show which parameter has changed: without
#: noise they exclude the parameters as given, and the change of any other parameter.
SHOWN = 25.0
#: Number of standard errors within which the size of a changed parameter is right.
STANDARD_ERRORS = 2.0
#: Difference within which a closed share is right.
CLOSE = 0.05
#: Classes of the stated probability.
PROBABILITIES = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)
#: Largest number of effects in a set that names one.
LARGEST_SET = 3
#: Confidence level of the intervals.
LEVEL = 0.90


class Figure(NamedTuple):
    """One line of the table."""

    name: str
    text: str


def share(count: int, of: int) -> str:
    """Return a count, its share, and the Wilson interval of the share at the level `LEVEL`.

    >>> share(9, 10)
    '9 of 10, 90 % [65, 98]'
    """
    if not of:
        return "–"
    low, high = binomtest(count, of).proportion_ci(LEVEL, method="wilson")
    return f"{count} of {of}, {100 * count / of:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _of(rows: Sequence[Row], right: Callable[[Row], bool]) -> str:
    return share(sum(map(right, rows)), len(rows))


def is_named(row: Row) -> bool:
    """Return whether the verdict names a cause."""
    return row["verdict"] in ("explained", "ambiguous", "partial") and row["named"] is not None


def is_doubted(row: Row) -> bool:
    """Return whether the verdict says that a cause outside the catalogue acts."""
    return row["verdict"] in ("unexplained", "partial")


def is_within(row: Row) -> bool:
    """Return whether a true effect is in the first set, and the set has at most `LARGEST_SET` effects."""
    return is_named(row) and bool(set(row["truth"]) & set(row["set"])) and len(row["set"]) <= LARGEST_SET


def is_sized(row: Row) -> bool:
    """Return whether the changed parameter is the first cause and its estimate is right."""
    if not (is_named(row) and row["first"]) or row["stated"] is None or not row["stderr"]:
        return False
    return abs(row["stated"] - row["value"]) <= STANDARD_ERRORS * row["stderr"]


def figures(rows: Sequence[Row]) -> list[Figure]:
    """Return all figures of one run, in the order of the table."""
    kinds = {
        k: [r for r in rows if r["kind"] == k]
        for k in ("clean", "single", "pair", "outside", "changed", "odd")
    }
    singles, changed = kinds["single"], kinds["changed"]
    shown = [r for r in changed if (r["singles"] or 0.0) >= SHOWN]
    large = [r for r in singles if (r["gap"] or 1.0) >= LARGE]
    sizes = [len(r["set"]) for r in large if is_named(r)]
    foreign = [r for r in kinds["outside"] if (r["gap"] or 1.0) >= VISIBLE]
    plain = [r for r in rows if r["kind"] != "odd"]
    right = [r for r in singles if is_within(r)]
    excluded = [r for r in kinds["pair"] if (r["singles"] or 0.0) >= EXCLUDED]
    closed = [r for r in rows if is_named(r) and None not in (r["closed"], r["claimed"])]
    ranged = [r for r in closed if r["interval"] is not None]
    mean = "–"
    if sizes:
        mean = f"{statistics.mean(sizes):.2f}"
    return [
        Figure("a changed parameter: named first", _of(changed, lambda r: is_named(r) and r["first"])),
        Figure("a changed parameter: named first, sized within 2 standard errors", _of(changed, is_sized)),
        Figure("the same, if the noise-free data exclude the change of any other", _of(shown, is_sized)),
        Figure(
            f"one effect, gap {LARGE:g} x or more: in a set of at most three; mean size",
            f"{_of(large, is_within)}; {mean}",
        ),
        Figure("clean: a cause named", _of(kinds["clean"], is_named)),
        Figure("clean: `unexplained` or `partial`", _of(kinds["clean"], is_doubted)),
        Figure(
            f"outside the catalogue, gap {VISIBLE:g} x or more: `unexplained` or `partial`",
            _of(foreign, is_doubted),
        ),
        Figure("one effect: `unexplained` or `partial`", _of(large, is_doubted)),
        Figure("one effect: another cause named", _of(singles, lambda r: is_named(r) and not r["found"])),
        Figure("one effect, named: a second one made up", _of(right, lambda r: r["causes"] > 1)),
        Figure(
            "two effects, of which the noise-free data exclude each single one: both named",
            _of(excluded, lambda r: is_named(r) and r["both"]),
        ),
        Figure("an odd trial: named", _of(kinds["odd"], lambda r: bool(r["odd"]))),
        Figure(
            "the same beside an effect: the effect in a set of at most three",
            _of([r for r in kinds["odd"] if r["truth"]], is_within),
        ),
        Figure("a trial said to be odd that is not", _of(plain, lambda r: bool(r["odd"]))),
        Figure(
            "closed share within 5 points", _of(closed, lambda r: abs(r["claimed"] - r["closed"]) <= CLOSE)
        ),
        Figure(
            "closed share in the stated interval",
            _of(ranged, lambda r: r["interval"][0] <= r["closed"] <= r["interval"][1]),
        ),
        Figure("stated probability against truth", calibration(rows)),
        Figure("failed", _of(rows, lambda r: r["verdict"] == "failed")),
    ]


def calibration(rows: Sequence[Row]) -> str:
    """Return the calibration error of the stated probabilities and, by class, how often the set is right.

    The error is the mean over all stated probabilities of the difference, within each class, between the mean
    probability and the share of right sets. Clean cases are left out.
    """
    stated = [r for r in rows if is_named(r) and r["probability"] is not None and r["kind"] != "clean"]
    error, texts = 0.0, []
    for low, high in itertools.pairwise(PROBABILITIES):
        last = high == PROBABILITIES[-1]
        own = [r for r in stated if low <= r["probability"] < high or (last and r["probability"] >= high)]
        if own:
            mean = statistics.mean(r["probability"] for r in own)
            right = sum(bool(set(r["truth"]) & set(r["set"])) for r in own)
            error += abs(mean - right / len(own)) * len(own) / len(stated)
            texts.append(f"{mean:.2f}: {share(right, len(own))}")
    if not texts:
        return "–"
    return f"error {100 * error:.0f} points ({'; '.join(texts)})"


def _lines(head: Sequence[str], body: Sequence[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in body])


def table(rows: Sequence[Row]) -> str:
    """Return the table of the figures of one run."""
    return _lines(["figure", "value"], figures(rows))


def _said(row: Row) -> str:
    if not is_named(row):
        return str(row["verdict"])
    return f"{row['verdict']}: {' / '.join(row['set'])} ({row['causes']})"


def compared(rows: Sequence[Row], others: Sequence[Row]) -> str:
    """Return the figures of two runs beside each other, and the cases whose answers differ.

    Only cases that both runs have are counted. The cases must be of the same plan.
    """
    theirs = {row["number"]: row for row in others}
    pairs = [(row, theirs[row["number"]]) for row in rows if row["number"] in theirs]
    for one, other in pairs:
        if (one["robot"], one["truth"], one["size"]) != (other["robot"], other["truth"], other["size"]):
            raise SystemExit(f"case {one['number']} of the two runs is not the same: their plans differ")
    mine, those = figures([one for one, _ in pairs]), figures([other for _, other in pairs])
    lines = [(a.name, b.text, a.text) for a, b in zip(mine, those, strict=True)]
    times = [f"{statistics.median(row['wall_s'] for row in side):.1f} s" for side in zip(*pairs, strict=True)]
    lines.append(("wall time, median", times[1], times[0]))
    changed = [
        [one["number"], one["robot"], " + ".join(one["truth"]) or "clean", _said(other), _said(one)]
        for one, other in pairs
        if _said(one) != _said(other)
    ]
    head = f"## The same {len(pairs)} cases in the other run\n\n"
    texts = _lines(["figure", "other run", "this run"], lines)
    answers = _lines(["case", "robot", "truth", "other run", "this run"], changed)
    return f"{head}{texts}\n\n{len(changed)} answers differ.\n\n{answers}\n"
