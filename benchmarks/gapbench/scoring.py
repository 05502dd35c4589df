"""Answers held against labels: which of them are right, and the figures that count."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from benchmarks.gapbench import answers, labels
from benchmarks.gapbench.answers import Answer, Cause
from benchmarks.gapbench.labels import Label
from validation.blind.score import LARGEST_SET, closed_share

#: A gap is large from the second of these on, and to be seen from the first: noise alone is 1.
SEEN, LARGE = 1.5, 3.0
#: Stated probabilities are compared with the truth between these.
PROBABILITIES = (0.0, 0.5, 0.8, 0.95, 1.0)
#: A stated share of the gap that is closed is right within this.
CLOSE = 0.05


@dataclass(frozen=True)
class Scored:
    """One case: what is true, what was said."""

    label: Label
    answer: Answer
    answered: bool = True

    @property
    def causes(self) -> list[Cause]:
        """Those that the answer says act."""
        return self.answer.causes if self.answer.named else []

    @property
    def within(self) -> bool:
        """Whether a true cause is in the first set, and that is small enough to name anything."""
        return bool(self.causes) and self.holds and len(self.causes[0].set) <= LARGEST_SET

    @property
    def holds(self) -> bool:
        """Whether a true cause is in the first set, of whatever size."""
        return bool(self.causes) and not set(self.label.effects).isdisjoint(self.causes[0].set)

    @property
    def other(self) -> bool:
        """Whether causes are named, and none of their sets has a true one."""
        named = {name for cause in self.causes for name in cause.set}
        return bool(self.causes) and named.isdisjoint(self.label.effects)

    @property
    def both(self) -> bool:
        """Whether both causes of a pair are named, in a small set each."""
        small = [set(cause.set) for cause in self.causes if len(cause.set) <= LARGEST_SET]
        one, two = self.label.effects
        return any(one in a and two in b for a, b in itertools.permutations(small, 2))

    def closed(self) -> tuple[float, tuple[float, float] | None, float] | None:
        """Share of the gap closed as stated, its interval, and as it is with the true noise.

        Of the channel with the largest gap; None where nothing is stated or there was no gap to speak of.
        """
        if not self.causes:
            return None
        first, floor = self.causes[0], self.label.floor
        known = [name for name in first.closed if floor.get(name) and name in first.errors]
        if not known:
            return None
        name = max(known, key=lambda n: first.errors[n][0] / floor[n])
        true = closed_share(*first.errors[name], floor[name])
        return None if true is None else (*first.closed[name], true)


def scored(folder: Path, path: Path) -> list[Scored]:
    """Every case of a benchmark with its answer; one that has none counts as failed.

    Raises
    ------
    BadAnswer
        For a line that is no answer, or of a case that there is not.
    """
    truth = labels.read(folder)
    if not truth:
        raise SystemExit(f"{folder} has no labels: it is no benchmark, or not a whole one")
    said = answers.read(path, truth)
    return [
        Scored(label, said.get(case, Answer(case=case, verdict="failed")), case in said)
        for case, label in truth.items()
    ]


def common(entries: Mapping[str, Sequence[Scored]]) -> dict[str, list[Scored]]:
    """The entries on the cases that each of them answers: of a slow tool only some may be asked."""
    answered = set.intersection(*({r.label.case for r in rows if r.answered} for rows in entries.values()))
    return {name: [r for r in rows if r.label.case in answered] for name, rows in entries.items()}


class Figure(NamedTuple):
    """One row of the table for one entry."""

    name: str
    text: str


def share(count: int, of: int) -> str:
    """A count, its share, and Wilson's 95 % interval of that.

    >>> share(9, 10)
    '9 of 10, 90 % [60, 98]'
    """
    if not of:
        return "–"
    low, high = binomtest(count, of).proportion_ci(method="wilson")
    return f"{count} of {of}, {100 * count / of:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def figures(rows: Sequence[Scored]) -> list[Figure]:
    """All figures of one entry, real cases apart."""
    made = [r for r in rows if r.label.kind != "real"]
    kinds = {k: [r for r in made if r.label.kind == k] for k in ("clean", "single", "pair", "outside")}
    single = kinds["single"]
    large = [r for r in single if _gap(r) >= LARGE]
    middle = [r for r in single if SEEN <= _gap(r) < LARGE]
    outside = [r for r in kinds["outside"] if _gap(r) >= SEEN]

    def of(group: Sequence[Scored], right: Callable[[Scored], bool]) -> str:
        return share(sum(map(right, group)), len(group))

    return [
        Figure("cases answered", of(made, lambda r: r.answer.verdict != "failed")),
        Figure(f"one effect, gap {LARGE:g} x or more: true cause in the set", of(large, lambda r: r.within)),
        Figure(f"one effect, gap {SEEN:g} to {LARGE:g} x: the same", of(middle, lambda r: r.within)),
        Figure("one effect, any gap: only others named", of(single, lambda r: r.other)),
        Figure("nothing hidden: a cause named", of(kinds["clean"], lambda r: r.answer.named)),
        Figure(
            f"outside the catalogue, gap {SEEN:g} x or more: `unexplained` or `partial`",
            of(outside, lambda r: r.answer.doubts),
        ),
        Figure("the same: a cause named", of(outside, lambda r: r.answer.named)),
        Figure("two effects: both named", of(kinds["pair"], lambda r: r.both)),
        Figure(
            "one effect, a cause named: a second one made up",
            of([r for r in single if r.causes], lambda r: len(r.causes) > 1),
        ),
        *_closed(made),
        *_calibration(made),
        Figure(
            f"one effect, gap {LARGE:g} x or more: mean size of the set",
            _mean([len(r.causes[0].set) for r in large if r.causes]),
        ),
        *_times(made),
    ]


def _gap(row: Scored) -> float:
    """Gap over noise; of one that is not known, as if there were none."""
    return row.label.gap or 1.0


def _closed(rows: Sequence[Scored]) -> list[Figure]:
    stated = [found for r in rows if (found := r.closed()) is not None]
    close = sum(abs(share - true) <= CLOSE for share, _, true in stated)
    ranged = [(interval, true) for _, interval, true in stated if interval is not None]
    inside = sum(low <= true <= high for (low, high), true in ranged)
    return [
        Figure(f"closed share within {100 * CLOSE:g} points", share(close, len(stated))),
        Figure("true closed share in its 95 % interval", share(inside, len(ranged))),
    ]


def _calibration(rows: Sequence[Scored]) -> list[Figure]:
    """How often the cause is in a first set of a stated probability; of all cases in which one is named."""
    found = []
    for low, high in itertools.pairwise(PROBABILITIES):
        # the last class has its upper end
        inside = [
            (p, r.holds)
            for r in rows
            if r.causes and (p := r.causes[0].probability) is not None and (low <= p < high or p == high == 1)
        ]
        stated = f"{statistics.mean(p for p, _ in inside):.2f}: " if inside else ""
        text = stated + share(sum(holds for _, holds in inside), len(inside))
        found.append(Figure(f"stated probability {low:g} to {high:g}, mean: cause in the set", text))
    return found


def _mean(sizes: Sequence[int]) -> str:
    return f"{statistics.mean(sizes):.2f} (of {len(sizes)})" if sizes else "–"


def _times(rows: Sequence[Scored]) -> list[Figure]:
    known = [r.answer.wall_s for r in rows if r.answer.wall_s is not None]
    middle, late = np.quantile(known, [0.5, 0.9]) if known else (np.nan, np.nan)
    shown = [f"{value:.1f} s" if known else "–" for value in (middle, late)]
    return [Figure("wall time, median", shown[0]), Figure("wall time, 90 % quantile", shown[1])]


def real_text(row: Scored) -> str:
    """What was said of a real case, and whether it is right."""
    sets = " + ".join("/".join(cause.set) for cause in row.causes)
    right = row.within if row.label.effects else row.answer.doubts
    return f"{'right' if right else 'wrong'}: {' '.join([row.answer.verdict, sets]).strip()}"
