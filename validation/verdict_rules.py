"""``python -m validation.verdict_rules OUT``: score a blind run without each row of the verdict's table.

The gap files of the run hold the facts from which their verdicts follow. Each column of the table is a figure
of the score, each line the verdict without the rows of one question.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from swimid.diagnosis.gap_file import GapFile
from swimid.diagnosis.verdict import decide, list_rows
from validation.blind import figures as shown
from validation.blind import runner, score

Case = tuple[dict[str, Any], GapFile, dict[str, Any]]


def cases(out: Path) -> list[Case]:
    """Label, gap file and record of each case that has ended."""
    found = []
    for place in sorted((out / "results").glob("*/result.json")):
        record = json.loads(place.read_text())
        path = place.parent / "gap.yaml"
        if record["ended"] and path.exists():
            label = runner.label_of(out / "labels" / f"{place.parent.name}.json")
            found.append((label, GapFile.read(path), record))
    return found


def answered(file: GapFile, without: str) -> dict[str, Any]:
    """The gap file as the scorer reads it, with the verdict without the rows of a question."""
    decided = decide(file.facts, without=without)
    known = {c.effect: c for c in file.causes}
    causes = []
    for name in decided.causes:
        proposed = file.facts.proposed[name]
        cause = {"effect": name, "equivalent": proposed.equivalent, "probability": proposed.alone}
        if name in known:
            cause = known[name].model_dump(mode="json")
        causes.append(cause)
    return file.model_dump(mode="json") | {"verdict": decided.verdict, "causes": causes}


def figures(found: Sequence[Case], without: str = "") -> list[str]:
    """Counts of right and wrong answers, and of answers that differ from those with every row."""
    scored = [score.scored(label, answered(file, without), record) for label, file, record in found]
    kinds = {
        kind: [r for r in scored if r["kind"] == kind] for kind in ("clean", "single", "pair", "outside")
    }
    large = [r for r in kinds["single"] if (r["tool_ratio"] or 0.0) >= 1.5]
    named = [r for r in scored if shown.is_named(r)]
    doubted = [r for r in scored if shown.is_doubted(r)]
    other = sum(decide(file.facts, without=without) != decide(file.facts) for _, file, _ in found)
    return [
        f"{sum(r['within'] and r in named for r in large)} of {len(large)}",
        f"{sum(r['verdict'] == 'explained' and not r['within'] for r in kinds['single'])}",
        f"{sum(r['found'] == 2 for r in kinds['pair'])} of {len(kinds['pair'])}",
        f"{sum(r in doubted for r in kinds['outside'])} of {len(kinds['outside'])}",
        f"{sum(r in named for r in kinds['outside'])}",
        f"{sum(r in named for r in kinds['clean'])} of {len(kinds['clean'])}",
        f"{sum(r in doubted for r in kinds['clean'])}",
        str(other),
    ]


HEAD = (
    "without the row",
    "single effects in the set",
    "another one explained",
    "pairs, both",
    "outside, unexplained or partial",
    "outside, named",
    "clean, named",
    "clean, unexplained or partial",
    "other answers",
)


def table(out: Path) -> str:
    """The score with every row, and without each of them."""
    found = cases(out)
    questions = list(dict.fromkeys(row.question for _, file, _ in found for row in list_rows(file.facts)))
    lines = [["–", *figures(found)], *([question, *figures(found, question)] for question in questions)]
    head = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    return "\n".join([*head, *("| " + " | ".join(line) + " |" for line in lines)])


def main() -> None:
    """Print the table of a run."""
    parser = argparse.ArgumentParser(prog="python -m validation.verdict_rules", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of a blind run")
    print(table(parser.parse_args().out))


if __name__ == "__main__":
    main()
