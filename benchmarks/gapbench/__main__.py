"""``python -m benchmarks.gapbench``: make cases, have a tool answer them, score answers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.gapbench import answers, make, scoring, table, tools


def arguments(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """What was typed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gapbench", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    made = verbs.add_parser("make", help="write cases, and their labels apart from them")
    made.add_argument("--cases", type=int, default=300, help="how many, recordings of others on top")
    made.add_argument("--seed", type=int, required=True)
    made.add_argument("--robots", nargs="+", default=[], help="only these, and no recordings of others")
    made.add_argument("--out", type=Path, required=True, help="folder; what is there is taken up again")
    told = verbs.add_parser("answer", help="have a tool answer the cases it has not answered yet")
    told.add_argument("--tool", choices=["swimid", "checkout", *tools.PEERS], required=True)
    told.add_argument("--cases", type=Path, required=True, help="the folder 'cases' of a benchmark")
    told.add_argument("--out", type=Path, required=True, help="answers, added to what is there")
    told.add_argument("--only", nargs="+", default=[], help="only the cases of these names: 0007")
    told.add_argument("--checkout", type=Path, help="of --tool checkout: folder of another swimid")
    told.add_argument("--jobs", type=int, default=1, help="cases at the same time")
    told.add_argument("--timeout", type=float, default=900.0, help="per command, s")
    scored = verbs.add_parser("score", help="print the table of entries")
    scored.add_argument("folder", type=Path, help="of a benchmark")
    scored.add_argument("answers", type=Path, nargs="+", help="one file an entry, named after it")
    scored.add_argument("--common", action="store_true", help="only cases that every file has an answer to")
    scored.add_argument("--out", type=Path, help="write the table there, too")
    verbs.add_parser("schema", help="print the JSON schema of an answer")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Run one verb."""
    chosen = arguments(argv)
    if chosen.verb == "schema":
        print(answers.schema())
        return
    try:
        if chosen.verb == "make":
            count = make.make(chosen.out, cases=chosen.cases, seed=chosen.seed, robots=chosen.robots)
            print(f"{count} cases in {chosen.out / 'cases'}")
        elif chosen.verb == "answer":
            asked = tools.tool(chosen.tool, chosen.checkout)
            count = tools.answer_all(
                asked,
                chosen.cases,
                chosen.out,
                only=chosen.only,
                jobs=chosen.jobs,
                timeout_s=chosen.timeout,
            )
            print(f"{count} answers more in {chosen.out}")
        else:
            entries = {path.stem: scoring.scored(chosen.folder, path) for path in chosen.answers}
            if chosen.common:
                entries = scoring.common(entries)
            text = table.markdown(entries)
            if chosen.out is not None:
                chosen.out.write_text(text, encoding="utf-8")
            print(text, end="")
    except answers.BadAnswer as error:
        raise SystemExit(str(error)) from error


if __name__ == "__main__":
    main()
