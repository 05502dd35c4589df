"""Print all measured evidence as tables, and write them into the pages that show them.

python -m docs.evidence
python -m docs.evidence --take coverage printed.txt

The tables are computed from the files in docs/measured. Each of these is the table that a command of
docs/measured/sources.yaml printed. ``--take`` replaces one of them by a new output of its command. Two
comments in a page mark the place of a table.
"""

from __future__ import annotations

import argparse
import datetime
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd
from ruamel.yaml import YAML

from docs import reference
from docs.reference import table
from swimid.results import numbers

DOCS = Path(__file__).parent
MEASURED = DOCS / "measured"
#: Word in the quantity of a row of coverage.csv that counts false alarms.
ALARM = "alarm: "

Figures = list[tuple[str, str]]


def read(name: str) -> pd.DataFrame:
    """Return a table of docs/measured as texts, with the first column as index."""
    return pd.read_csv(MEASURED / f"{name}.csv", dtype=str, keep_default_na=False, index_col=0)


def sources() -> dict[str, dict[str, str]]:
    """Return what each table measures, its command, and its date."""
    found: dict[str, dict[str, str]] = YAML(typ="safe").load((MEASURED / "sources.yaml").read_text())
    return found


def take(name: str, printed: str, folder: Path = MEASURED) -> None:
    """Write the first Markdown table of a printed text to the folder, with the date of today.

    Raises
    ------
    ValueError
        If the text has no table.
    """
    tables = re.findall(r"(?:^\|.*\|$\n?){3,}", printed, re.MULTILINE)
    if not tables:
        raise ValueError("the text has no table")
    head, _, *body = (re.split(r"\s*\|\s*", line.strip("| ")) for line in tables[0].splitlines())
    pd.DataFrame(body, columns=head).to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    yaml, path = YAML(), folder / "sources.yaml"
    content = yaml.load(path.read_text())
    content[name]["date"] = datetime.date.today().isoformat()
    yaml.dump(content, path)


def share(part: float, whole: float) -> str:
    """Return a count and its share in per cent."""
    return f"{part:g} of {whole:g}, {100 * part / whole:.0f} %"


# ---------------------------------------------------------------- figures of each measurement


def surely_wrong(data: pd.DataFrame) -> int:
    """Return the number of real gaps of which the answer is sure of a wrong cause, or of none."""
    return int((data["right"].isin(["no", "partly"]) & data["verdict"].isin(["explained", "none"])).sum())


def real() -> Figures:
    """Return how often the known cause of a real gap is named."""
    data = read("real")
    named = (data["right"] == "yes").sum()
    listed = named + (data["right"] == "listed").sum()
    return [
        ("the right answer is named first", share(named, len(data))),
        ("the same, or listed as not separable from the first", share(listed, len(data))),
        ("`explained` with a wrong cause, or `none`", share(surely_wrong(data), len(data))),
    ]


def blind() -> Figures:
    """Return the figures of blind cases that matter most to a user."""
    values = read("blind")["value"]
    names = (
        "a changed parameter: named first",
        "one effect: another cause named",
        "clean: a cause named",
        "two effects, of which the noise-free data exclude each single one: both named",
        "closed share in the stated interval",
    )
    return [(name, values[name]) for name in names]


def simulators() -> Figures:
    """Return the figures of blind cases with models of MuJoCo."""
    data = read("simulators")[["cases", "in the answer", "none"]].astype(int)
    clean, hidden = data.loc["clean"], data.drop("clean").sum()
    return [
        ("the hidden cause is in the answer", share(hidden["in the answer"], hidden["cases"])),
        ("clean: a cause named", share(clean["cases"] - clean["none"], clean["cases"])),
    ]


def coverage() -> Figures:
    """Return how many rates of coverage, and of false alarms, lie in their wanted ranges."""
    data = read("coverage")
    is_alarm = data.index.str.contains(ALARM)
    found = []
    for text, rows in (
        ("coverage of 95 % intervals", data[~is_alarm]),
        ("false alarms of checks", data[is_alarm]),
    ):
        counts = [int((rows["verdict"] == word).sum()) for word in ("ok", "too few repeats")]
        rest = f"; {counts[1]} with too few repeats" if counts[1] else ""
        found.append((f"{text}: rows in the wanted range", share(counts[0], len(rows)) + rest))
    return found


def mutants() -> Figures:
    """Return the share of small errors that the tests notice."""
    row = read("mutants").loc["all"]
    return [("noticed by the tests", share(int(row["noticed"]), int(row["drawn"]) - int(row["equivalent"])))]


def faults() -> Figures:
    """Return how many damaged inputs end badly."""
    data = read("faults")[["inputs", "findings"]].astype(int).sum()
    return [("traceback, crash, partial file, or no end", share(data["findings"], data["inputs"]))]


FIGURES: tuple[Callable[[], Figures], ...] = (real, blind, simulators, coverage, mutants, faults)


# ---------------------------------------------------------------- tables in pages


def summary() -> str:
    """Return the table with one line for each figure, its command and its date."""
    rows, known = [], sources()
    for figures in FIGURES:
        source = known[figures.__name__]
        # A table whose rows were measured one by one has their dates.
        date = source.get("date") or max(read(figures.__name__)["date"])
        about = [source["what"], f"`{source['command']}`", date]
        for text, value in figures():
            rows.append([about[0], text, value, *about[1:]])
            about = ["", "", ""]
    return table(["measured on", "figure", "result", "command", "date"], rows)


def whole(name: str) -> Callable[[], str]:
    """Return a function that returns all rows of a file of docs/measured."""

    def made() -> str:
        data = read(name)
        return table([data.index.name, *data.columns], data.reset_index().to_numpy())

    return made


def real_gaps() -> str:
    """Return the table of real gaps in the columns that fit a page."""
    rows = []
    for name, row in read("real").iterrows():
        size = known = closed = ""
        unit = row["unit"].removeprefix("1")
        if row["size"]:
            size = numbers.format_estimate(float(row["size"]), float(row["stderr"] or "nan"))
        if row["known"]:
            known = f"{numbers.format_number(float(row['known']), 3)} {unit}".strip()
        if row["closed"]:
            closed = numbers.percent(float(row["closed"]), 2)
        rows.append([name, row["lacks"], row["verdict"], row["causes"], row["right"], size, known, closed])
    return table(["recording", "lacks", "verdict", "causes", "right", "size", "known", "closed"], rows)


def unlike() -> str:
    """Return the coverage of intervals for trials that differ and for slow noise, one row for each kind."""
    texts = {"drag_coefficient": "drag", "added_mass": "added mass", "pulley_friction": "friction"}
    rows: dict[str, dict[str, str]] = {}
    for quantity, row in read("coverage").iterrows():
        trials, _, name = str(quantity).removeprefix("unlike, ").partition(": ")
        word = "width" if name.startswith("width") else texts.get(name.partition(" ")[0])
        if str(quantity).startswith("unlike, ") and word:
            rows.setdefault(trials, {})[word] = row["share"]
    head = [*texts.values(), "width"]
    return table(
        ["trials", *head], [[name, *(row.get(word, "") for word in head)] for name, row in rows.items()]
    )


def coverage_not_ok() -> str:
    """Return the rows of the coverage that lie outside of their wanted ranges."""
    data = read("coverage")
    data = data[data["verdict"] == "not"]
    return table([data.index.name, *data.columns[:-1]], data.reset_index().to_numpy()[:, :-1])


def attacks() -> str:
    """Return the counts of damaged and hostile inputs by kind of attack."""
    data = read("faults").astype(int)
    kinds = (
        data.index.str.replace(r"^(SIG\w+) in .*", "\\1", regex=True).str.partition(": ").get_level_values(0)
    )
    data = data.groupby(kinds.rename("attack"), sort=False).sum()
    return table([data.index.name, *data.columns], data.reset_index().to_numpy())


def first_screen() -> str:
    """Return the sentences of the first screen on real gaps."""
    data = read("real")
    counts = data["right"].value_counts()
    said = surely_wrong(data) or "none"
    return (
        f"In {len(data)} recordings of other laboratories one known thing differs from the model. `diagnose` "
        f"names the right answer first in {counts.get('yes', 0)}, and in {counts.get('listed', 0)} more "
        f"lists it as not separable from the first. In {said} it is sure of a wrong one."
    )


#: Page and function of each table, by the name in the comments of the page.
TABLES: dict[str, tuple[str, Callable[[], str]]] = {
    "summary": ("trust.md", summary),
    "mutants": ("trust.md", whole("mutants")),
    "trials that differ": ("trust.md", unlike),
    "coverage outside its range": ("trust.md", coverage_not_ok),
    "attacks": ("trust.md", attacks),
    "blind": ("diagnose-method.md", whole("blind")),
    "gapbench": ("gapbench.md", whole("gapbench")),
    "simulators": ("your-simulator.md", whole("simulators")),
    "first-screen": ("../README.md", first_screen),
    "real": ("real-gaps.md", real_gaps),
    "files that people write": ("formats.md", partial(reference.formats_text, reference.WRITTEN_BY_HAND)),
    "files that commands write": (
        "formats.md",
        partial(reference.formats_text, reference.WRITTEN_BY_COMMANDS),
    ),
    "experiments": ("formats.md", reference.experiments_text),
    "public names": ("api.md", reference.names_text),
    "warnings": ("warnings.md", reference.warnings_text),
    "effects": ("effects.md", reference.effects_text),
}


def replaced(text: str, name: str, made: str) -> str:
    """Return the text of a page with a table between its comments.

    Raises
    ------
    ValueError
        If the page has not exactly one place for the table.
    """
    begin, end = f"<!-- table {name} -->\n", f"<!-- end of table {name} -->"
    text, count = re.subn(f"{begin}.*?{end}", lambda _: f"{begin}{made}\n{end}", text, flags=re.DOTALL)
    if count != 1:
        raise ValueError(f"the page has {count} places for the table {name}: one is needed")
    return text


def main() -> None:
    """Print all tables and write them into their pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--take", nargs=2, metavar=("NAME", "FILE"), help="use a new output of the command of a table"
    )
    chosen = parser.parse_args()
    if chosen.take:
        take(chosen.take[0], Path(chosen.take[1]).read_text(encoding="utf-8"))
    for name, (page, made) in TABLES.items():
        path, text = DOCS / page, made()
        print(f"{name} ({page})\n\n{text}\n")
        path.write_text(replaced(path.read_text(encoding="utf-8"), name, text), encoding="utf-8")


if __name__ == "__main__":
    main()
