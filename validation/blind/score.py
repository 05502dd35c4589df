"""Scores diagnoses against the labels of their cases.

A truth counts as named where it is the first cause's effect or, with it, in a set of at most three effects
that the trials cannot tell apart.
"""

from __future__ import annotations

import itertools
import json
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from validation.blind import figures, noise_free, runner
from validation.blind.common import PARAMETER, STAGE_OF
from validation.blind.figures import LARGEST_SET

PROBABILITIES = (0.0, 0.5, 0.8, 0.95, 1.0 + 1e-9)
SURE = 0.9
#: An error that exceeds the noise by less has no share of it closed to speak of.
CLEAR = 1.2
#: Of the noncentrality: effects above it can be detected.
DETECTABLE = 150.0
Row = dict[str, Any]


def read(out: Path) -> list[Row]:
    """One row per case that has a result, with its label under ``label``."""
    rows = []
    for place in sorted((out / "results").glob("*/result.json")):
        record = json.loads(place.read_text())
        label = runner.label_of(out / "labels" / f"{place.parent.name}.json")
        path = place.parent / "gap.yaml"
        # a gap file that a failed command left is no answer
        gap = YAML(typ="safe").load(path.read_text()) if record["ended"] and path.exists() else None
        row = scored(label, gap, record)
        true = noise_free.closed_share(place.parent, label.get("floor") or {})
        stated = (gap or {}).get("closed") or {}
        if label["kind"] == "odd":
            row["closed"] = None  # the noise-free motions contain the odd trial
        elif true is not None and stated.get("share") is not None:
            row |= {"claimed": stated["share"], "closed": true, "interval": _interval(stated.get("ci95"))}
        rows.append(row)
    return rows


def sets_of(gap: Row) -> list[set[str]]:
    """The effects of each cause, with those it cannot be told from."""
    return [{c["effect"], *(c.get("equivalent") or [])} for c in gap.get("causes") or []]


def scored(label: Row, gap: Row | None, record: Row) -> Row:
    """One case: what is true, what was said, and which of it is right."""
    truth = list(label["effects"])
    row: Row = {
        "number": label["number"],
        "robot": label["robot"],
        "kind": label["kind"],
        "truth": truth,
        "size": label["size"],
        "raw": _overall(label.get("gap_over_floor")),
        "refit": _overall(label.get("gap_refit")),
        "noncentrality": label.get("noncentrality"),
        "prior": label.get("prior"),
        "wall_s": sum(step["wall_s"] for step in record["steps"]),
        "status": record["steps"][-1]["status"],
        "verdict": "failed" if gap is None else gap["verdict"],
        "named": None,
        "set": [],
        "probability": None,
        "first": False,
        "within": False,
        "found": 0,
        "claimed": None,
        "closed": None,
        "interval": None,
        "tool_ratio": None,
        "causes": 0,
        "one_suffices": False,
        "gap": _largest(label.get("gap_refit")),
        "singles": min((label.get("singles") or {}).values(), default=None),
        "both": False,
        "odd": None,
        "from": None,
        "value": None,
        "stated": None,
        "stderr": None,
    }
    for name, factor in (label.get("factors") or {}).items():
        row["from"] = label["truth"][name]
        row["value"] = row["from"] * factor
    if gap is None:
        return row
    told = list(gap.get("odd_trials") or {})
    row["odd"] = told == [label["odd"]] if label.get("odd") else bool(told)
    ratios = [c["nrmse"] / c["floor"] for c in gap["where"]["channels"] if c.get("floor") and c.get("nrmse")]
    row["tool_ratio"] = max(ratios, default=None)
    sets, causes = sets_of(gap), gap.get("causes") or []
    row["found"] = sum(any(name in named for named in sets) for name in truth)
    row["causes"] = len(causes)
    row["one_suffices"] = one_suffices(gap)
    row["both"] = has_both(truth, sets)
    if causes:
        row["named"], row["probability"] = causes[0]["effect"], causes[0].get("probability")
        row["set"] = sorted(sets[0])
        row["first"] = row["named"] in truth
        row["within"] = row["first"] or (len(sets[0]) <= LARGEST_SET and bool(sets[0] & set(truth)))
        row["claimed"], row["closed"], row["interval"] = _shrinkage(causes[0], gap, label)
        estimate = (causes[0].get("parameters") or {}).get(row["named"].removeprefix(PARAMETER)) or {}
        if row["value"] is not None and row["first"]:
            row["stated"], row["stderr"] = estimate.get("value"), estimate.get("stderr")
    return row


def has_both(truth: Sequence[str], sets: Sequence[set[str]]) -> bool:
    """Return whether two true effects are in different sets of at most `LARGEST_SET` effects."""
    if len(truth) != 2:
        return False
    small = [named for named in sets if len(named) <= LARGEST_SET]
    return any(truth[0] in a and truth[1] in b for a, b in itertools.permutations(small, 2))


def _largest(gap: Any) -> float | None:
    """Return the error in the worst channel over the noise, from what a refit leaves of the effect there."""
    if not isinstance(gap, dict):
        return None
    left = [size for name, size in gap.items() if name != "overall" and np.isfinite(size)]
    return max((float(np.hypot(1.0, size)) for size in left), default=None)


def one_suffices(gap: Row) -> bool:
    """Whether some effect alone describes the trials as well as every set of several that was fitted, what
    their numbers must gain included: then nothing tells that there is a second one.
    """
    hypotheses = gap.get("hypotheses") or []
    fitted = [(len(h["effects"]), sum(h["deviances"]) + (h.get("strain") or 0.0)) for h in hypotheses]
    alone = min((score for size, score in fitted if size == 1), default=np.inf)
    return alone <= min((score for size, score in fitted if size > 1), default=np.inf) and alone < np.inf


def _overall(value: Any) -> float | None:
    if isinstance(value, dict):
        numbers = [v for v in value.values() if isinstance(v, int | float)]
        value = value.get("overall", max(numbers, default=None))
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _shrinkage(
    cause: Row, gap: Row, label: Row
) -> tuple[float | None, float | None, tuple[float, float] | None]:
    """Share of the gap closed as claimed, and with the label's floor, and the interval stated for it: of the
    channel with the largest gap.
    """
    known = [s for s in cause.get("shrinkage") or [] if s.get("closed") is not None and s.get("shipped")]
    if not known:
        return None, None, None
    best = max(known, key=lambda s: s["shipped"] / s["floor"] if s.get("floor") else 0.0)
    name = best["channel"]
    channel = next((c for c in gap["where"]["channels"] if c["channel"] == name), {})
    width = channel["rmse"] / channel["nrmse"] if channel.get("rmse") and channel.get("nrmse") else None
    width = width or (label.get("range") or {}).get(name)
    floor = (label.get("floor") or label.get("noise_sd") or {}).get(name)
    if not width or not floor:
        return best["closed"], None, None
    true = closed_share(best["shipped"], best["after"], floor / width)
    return best["closed"], true, None


def _interval(stated: Sequence[float | None] | None) -> tuple[float, float] | None:
    low, high = stated or (None, None)
    if low is None or high is None:
        return None
    return low, high


def closed_share(before: float, after: float, floor: float) -> float | None:
    """Return the closed share of the squared gap, from errors and the true noise; None without a gap."""
    if before <= CLEAR * floor:
        return None
    return min((before**2 - after**2) / (before**2 - floor**2), 1.0)


# ------------------------------------------------------------ tables


def _share(rows: Sequence[Row], key: Callable[[Row], bool]) -> str:
    return f"{sum(map(key, rows)) / len(rows):.2f}" if rows else "–"


def _table(head: Sequence[str], body: Iterable[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(str(c) for c in row) + " |" for row in body])


def _accuracy(rows: Sequence[Row]) -> list[object]:
    wrong = [r for r in rows if r["verdict"] == "explained" and not r["within"]]
    sure = [r for r in wrong if (r["probability"] or 0) > SURE]
    answers = Counter(r["verdict"] for r in rows)
    verdicts = [answers[v] for v in ("none", "explained", "ambiguous", "partial", "unexplained", "failed")]
    first, within = (_share(rows, lambda r, k=k: _named(r) and r[k]) for k in ("first", "within"))
    return [len(rows), first, within, *verdicts, len(wrong), len(sure)]


def _named(row: Row) -> bool:
    """Whether a cause was named at all: a gap without verdict names nothing."""
    return figures.is_named(row)


HEAD = [
    "n",
    "first",
    "in set",
    "none",
    "explained",
    "ambiguous",
    "partial",
    "unexplained",
    "failed",
    "wrong",
    "sure and wrong",
]


def by_class(rows: Sequence[Row], key: str, edges: Sequence[float]) -> str:
    """Accuracy by class of a size of the gap."""
    body = []
    for low, high in itertools.pairwise(edges):
        inside = [r for r in rows if r[key] is not None and low <= r[key] < high]
        if inside:
            name = f"{low:g} – {high:g}" if np.isfinite(high) else f"above {low:g}"
            body.append([name, *_accuracy(inside)])
    return _table([key, *HEAD], body)


def by_effect(rows: Sequence[Row]) -> str:
    """Accuracy of each true effect, and what it was mistaken for."""
    body = []
    for name in sorted({r["truth"][0] for r in rows}):
        own = [r for r in rows if r["truth"] == [name]]
        mistaken = Counter(r["named"] for r in own if _named(r) and not r["within"])
        told = ", ".join(f"{k} {n}" for k, n in mistaken.most_common(3))
        body.append([name, *_accuracy(own), told])
    return _table(["effect", *HEAD, "mistaken for"], body)


def confusion(rows: Sequence[Row]) -> str:
    """True stage against the stage of the first cause."""
    stages = [*dict.fromkeys(STAGE_OF.values()), "other"]
    count = Counter(
        (
            STAGE_OF.get(r["truth"][0], "other"),
            STAGE_OF.get(r["named"], "other") if _named(r) else r["verdict"],
        )
        for r in rows
    )
    columns = [*stages, "none", "unexplained", "failed"]
    body = [[s, *(count[s, c] or "·" for c in columns)] for s in stages if any(count[s, c] for c in columns)]
    return _table(["true \\ named", *columns], body)


def calibration(rows: Sequence[Row]) -> str:
    """Stated probability of the first cause against how often it, or its set, is right."""
    named = [r for r in rows if _named(r) and r["probability"] is not None]
    body = []
    for low, high in itertools.pairwise(PROBABILITIES):
        inside = [r for r in named if low <= r["probability"] < high]
        if inside:
            stated = f"{statistics.mean(r['probability'] for r in inside):.2f}"
            right = [_share(inside, lambda r, k=k: r[k]) for k in ("first", "within")]
            body.append([f"{low:g} – {min(high, 1.0):g}", len(inside), stated, *right])
    return _table(["probability", "n", "stated", "first right", "set right"], body)


def summary(rows: Sequence[Row]) -> Row:
    """The figures that count."""
    kind = {k: [r for r in rows if r["kind"] == k] for k in ("clean", "single", "pair", "outside")}
    visible = [r for r in kind["single"] if r["tool_ratio"] is not None and r["tool_ratio"] >= 1.5]
    detectable = [r for r in kind["single"] if (r["noncentrality"] or 0.0) >= DETECTABLE]
    closed = [(r["claimed"], r["closed"]) for r in rows if _named(r) and r["closed"] is not None]
    ranged = [
        r["interval"][0] <= r["closed"] <= r["interval"][1]
        for r in rows
        if _named(r) and r["closed"] is not None and r["interval"] is not None
    ]
    times = [r["wall_s"] for r in rows]

    def share(of: Sequence[Row], key: Callable[[Row], bool]) -> float | None:
        return round(sum(map(key, of)) / len(of), 3) if of else None

    return {
        "cases": len(rows),
        "failed": sum(r["verdict"] == "failed" for r in rows),
        "false_alarms": share(kind["clean"], lambda r: r["verdict"] != "none"),
        "false_causes": share(kind["clean"], _named),
        "first": share(kind["single"], lambda r: _named(r) and r["first"]),
        "in_set": share(kind["single"], lambda r: _named(r) and r["within"]),
        "first_visible": share(visible, lambda r: _named(r) and r["first"]),
        "in_set_visible": share(visible, lambda r: _named(r) and r["within"]),
        "detectable": len(detectable),
        "first_detectable": share(detectable, lambda r: _named(r) and r["first"]),
        "in_set_detectable": share(detectable, lambda r: _named(r) and r["within"]),
        "wrong_detectable": share(detectable, lambda r: r["verdict"] == "explained" and not r["within"]),
        "wrong_explained": share(kind["single"], lambda r: r["verdict"] == "explained" and not r["within"]),
        "pairs_both": share(kind["pair"], lambda r: r["found"] == 2),
        "pairs_one": share(kind["pair"], lambda r: r["found"] == 1),
        "pairs_one_suffices": share(kind["pair"], lambda r: r["one_suffices"]),
        "spurious_second": share(kind["single"], lambda r: r["first"] and r["causes"] > 1 and _named(r)),
        "outside_abstained": share(
            kind["outside"], lambda r: r["verdict"] in ("unexplained", "partial", "none")
        ),
        "outside_sure": share(
            kind["outside"], lambda r: r["verdict"] == "explained" and (r["probability"] or 0) > SURE
        ),
        "closed_claimed_minus_true": round(statistics.median(c - t for c, t in closed), 3)
        if closed
        else None,
        "closed_within_0.05": round(float(np.mean([abs(c - t) < 0.05 for c, t in closed])), 3)
        if closed
        else None,
        "closed_in_interval": round(float(np.mean(ranged)), 3) if ranged else None,
        "closed_within_0.1": round(float(np.mean([abs(c - t) < 0.1 for c, t in closed])), 3)
        if closed
        else None,
        "wall_s_median": round(statistics.median(times), 1) if times else None,
        "wall_s_max": max(times, default=None),
    }


def markdown(rows: Sequence[Row]) -> str:
    """All tables."""
    singles = [r for r in rows if r["kind"] == "single"]
    parts = ["# Blind diagnosis", figures.table(rows), _table(["figure", "value"], summary(rows).items())]
    for title, text in (
        ("By robot, single effects", _groups(singles, "robot")),
        (
            "By gap over floor, as the tool has it",
            by_class(singles, "tool_ratio", (0, 1.1, 1.5, 2, 3, np.inf)),
        ),
        ("By gap over floor, raw", by_class(singles, "raw", (0, 1, 2, 4, 10, np.inf))),
        ("By gap over noise, nominal refitted", by_class(singles, "refit", (0, 0.05, 0.15, 0.4, 1, np.inf))),
        ("By noncentrality", by_class(singles, "noncentrality", (0, 10, 50, 150, 500, np.inf))),
        ("By effect", by_effect(singles)),
        ("Stages", confusion(singles)),
        ("Changed parameters", _changes([r for r in rows if r["kind"] == "changed"])),
        ("Clean", _groups([r for r in rows if r["kind"] == "clean"], "robot")),
        ("Outside the catalogue", _groups([r for r in rows if r["kind"] == "outside"], "truth")),
        ("Pairs", _pairs([r for r in rows if r["kind"] == "pair"])),
        ("Stated probabilities, all but clean", calibration([r for r in rows if r["kind"] != "clean"])),
        ("Failures", _failures(rows)),
    ):
        parts.append(f"## {title}\n\n{text}")
    return "\n\n".join(parts) + "\n"


def _groups(rows: Sequence[Row], key: str) -> str:
    names = sorted({str(r[key][0] if isinstance(r[key], list) else r[key]) for r in rows})
    body = []
    for name in names:
        own = [r for r in rows if name == str(r[key][0] if isinstance(r[key], list) else r[key])]
        body.append([name, *_accuracy(own)])
    return _table([key, *HEAD], body)


def _pairs(rows: Sequence[Row]) -> str:
    body = [
        [r["number"], r["robot"], " + ".join(r["truth"]), r["verdict"], " / ".join(r["set"]), r["found"]]
        for r in rows
    ]
    return _table(["case", "robot", "truth", "verdict", "first cause's set", "found"], body)


def _changes(rows: Sequence[Row]) -> str:
    body = []
    for r in rows:
        numbers = [f"{r[k]:.4g}" if r[k] is not None else "–" for k in ("from", "value", "stated", "stderr")]
        size, seen = f"{r['size']:+.0%}", f"{r['noncentrality'] or 0.0:.0f}"
        truth = r["truth"][0].removeprefix(PARAMETER)
        named = " / ".join(r["set"])
        body.append([r["number"], r["robot"], truth, size, seen, *numbers, r["verdict"], named])
    head = ["case", "robot", "parameter", "change", "noncentrality", "before", "in the trials", "estimate"]
    return _table([*head, "standard error", "verdict", "first cause's set"], body)


def _failures(rows: Sequence[Row]) -> str:
    body = [
        [r["number"], r["robot"], " + ".join(r["truth"]), r["status"]]
        for r in rows
        if r["verdict"] == "failed"
    ]
    return _table(["case", "robot", "truth", "exit status"], body)


def write(out: Path, other: Path | None = None) -> str:
    """Score a run and return the text of its score.md, which is written with score.json into its folder.

    ``other`` is the folder of a run of the same cases, with which the score is compared.
    """
    rows = read(out)
    text = markdown(rows)
    if other is not None:
        text = f"{text}\n{figures.compared(rows, read(other))}"
    (out / "score.md").write_text(text)
    (out / "score.json").write_text(json.dumps({"summary": summary(rows), "cases": rows}, indent=1) + "\n")
    return text
