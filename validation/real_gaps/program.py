"""Run rows, judge the answers and write the table as CSV."""

from __future__ import annotations

import contextlib
import csv
import importlib
import json
import os
import pkgutil
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from validation.real_gaps import rows
from validation.real_gaps.row import Gap, MissingDataError, Row, Sources

ROOT = Path(__file__).parents[2]
#: Longest time of one command, s.
TIMEOUT_S = 3600
COLUMNS = (
    "name",
    "model",
    "lacks",
    "verdict",
    "causes",
    "right",
    "size",
    "stderr",
    "known",
    "unit",
    "closed",
    "channel",
    "before",
    "refit",
    "repaired",
    "seconds",
    "date",
)

Result = dict[str, Any]


class CommandError(Exception):
    """A command of swimid that ended with an error."""


def all_rows() -> Iterator[Row]:
    """Yield the rows of all data sets, by module name."""
    for module in sorted(m.name for m in pkgutil.iter_modules(rows.__path__)):
        yield from importlib.import_module(f"{rows.__name__}.{module}").ROWS


def run_rows(names: Sequence[str], sources: Sources, folder: Path) -> list[Result]:
    """Run the named rows that have not run yet, and return the results of all rows that have run."""
    results = []
    unknown = set(names) - {row.name for row in all_rows()}
    if unknown:
        raise SystemExit(f"no row is named {', '.join(sorted(unknown))}")
    for row in all_rows():
        stored = folder / row.name / "result.json"
        if not stored.exists():
            if names and row.name not in names:
                continue
            try:
                run_row(row, sources, folder / row.name)
            except MissingDataError as error:
                print(f"{row.name}: no data at {error}", file=sys.stderr)
                continue
            print(text_table([read_result(row, folder / row.name)]), flush=True)
        results.append(read_result(row, folder / row.name))
    return results


def run_row(row: Row, sources: Sources, folder: Path) -> None:
    """Run the steps of a row in its folder and write ``result.json`` there.

    Raises
    ------
    MissingDataError
        If its recordings are not on this machine.
    """
    folder.mkdir(parents=True, exist_ok=True)
    begin, refused = time.monotonic(), None
    try:
        for step in row.steps:
            if callable(step):
                step(sources, folder)
            else:
                run_command(step.format(data=sources.data.resolve()), folder)
    except CommandError as error:
        refused = str(error)
    result = {
        "commands": [f"swimid {step}" for step in row.steps if isinstance(step, str)],
        "refused": refused,
        "seconds": round(time.monotonic() - begin, 1),
        "date": datetime.now(UTC).date().isoformat(),
    }
    (folder / "result.json").write_text(json.dumps(result, indent=1))


def read_result(row: Row, folder: Path) -> Result:
    """Judge the answer of a row that has run."""
    stored = json.loads((folder / "result.json").read_text())
    if stored["refused"]:
        answer = {"verdict": "refused", "right": "refused"}
    else:
        answer = judge(row, yaml.safe_load((folder / "gap.yaml").read_text()))
    known = row.known
    return {
        "name": row.name,
        "model": row.model,
        "lacks": row.lacks,
        "source": row.source,
        "licence": row.licence,
        "known": known.value if known else None,
        "unit": known.unit if known else "",
        **answer,
        **stored,
    }


def run_command(words: str, folder: Path) -> None:
    """Run one command line of swimid in a folder; its output is appended to ``commands.log``.

    Raises
    ------
    CommandError
        If it does not end with status 0, or not within the longest time.
    """
    command = [sys.executable, "-m", "swimid", *shlex.split(words)]
    if "--force" not in command:
        command.append("--force")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    try:
        ran = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, env=environment
        )
    except subprocess.TimeoutExpired as error:
        raise CommandError(f"swimid {words}: takes longer than {TIMEOUT_S} s") from error
    with (folder / "commands.log").open("a") as log:
        log.write(f"$ swimid {words}\n{ran.stdout}{ran.stderr}")
    if ran.returncode:
        last = [line for line in ran.stderr.splitlines() if "Error" in line or "hint" in line]
        raise CommandError(f"swimid {words}: {' '.join(last) or ran.stderr[-300:]}")


def judge(row: Row, gap: Gap) -> Result:
    """Compare the answer of a gap file with the right one."""
    causes = [
        {"names": [c["effect"], *c["equivalent"]], "probability": c["probability"]} for c in gap["causes"]
    ]
    size, error = None, None
    if row.known is not None and causes:
        # the answer names an effect without this size
        with contextlib.suppress(KeyError):
            size, error = row.known.read(gap)
    fall, closed = gap["waterfall"], gap["closed"] or {}
    channel, rmse = _worst_channel(fall[0]["rmse"], fall[-1]["rmse"]), [step["rmse"] for step in fall]
    return {
        "verdict": gap["verdict"],
        "causes": causes,
        "right": _rightness(row, gap["verdict"], causes),
        "size": size,
        "stderr": error,
        "closed": closed.get("share"),
        "by_refit": closed.get("by_refit"),
        "channel": channel,
        "before": rmse[0][channel],
        "refit": rmse[1][channel] if len(rmse) > 1 else None,
        "repaired": rmse[-2][channel] if causes and len(rmse) > 3 else None,
    }


def _rightness(row: Row, verdict: str, causes: Sequence[Mapping[str, Any]]) -> str:
    """``yes``, ``listed``, ``partly``, ``no`` or ``unexplained``.

    An answer is ``yes`` if each of its causes is acceptable, ``listed`` if an acceptable one is among the
    effects that the trials cannot distinguish from each, and ``partly`` if a wrong cause stands beside an
    acceptable one. Causes beside the verdict ``unexplained`` are no answer, and no gap is a wrong one.
    """
    if verdict == "unexplained":
        return "unexplained" if row.causes else "yes"
    if not causes:
        return "no"
    if all(cause["names"][0] in row.causes for cause in causes):
        return "yes"
    right = [bool(row.causes & set(cause["names"])) for cause in causes]
    if all(right):
        return "listed"
    return "partly" if any(right) else "no"


def _worst_channel(before: Mapping[str, float], noise: Mapping[str, float]) -> str:
    """Channel whose error is largest against the noise."""
    return max(before, key=lambda name: before[name] / max(noise[name], 1e-300))


def text_table(results: Sequence[Result]) -> str:
    """Return the table as aligned text."""
    lines = [[_cell(result, name) for name in COLUMNS] for result in results]
    widths = [max(len(row[k]) for row in [list(COLUMNS), *lines]) for k in range(len(COLUMNS))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in [list(COLUMNS), *lines]
    )


def write_table(path: Path, results: Sequence[Result]) -> None:
    """Write the table as CSV."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([[_cell(result, name) for name in COLUMNS] for result in results])


def _cell(result: Result, name: str) -> str:
    if name == "causes":
        return _names(result)
    value = result.get(name)
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _names(result: Result) -> str:
    """Causes with their equivalents; causes beside ``unexplained`` in brackets."""
    text = " and ".join(" or ".join(c["names"]) for c in result.get("causes", []))
    return f"({text})" if text and result["verdict"] == "unexplained" else text
