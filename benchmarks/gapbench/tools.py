"""Programs that answer cases, each in a copy of its folder, with no label in reach."""

from __future__ import annotations

import json
import sys
import tempfile
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ruamel.yaml import YAML

from benchmarks.gapbench import answers
from benchmarks.gapbench.answers import Answer
from validation.blind import runner

ROOT = Path(__file__).parents[2]
PEERS = ("bic", "regression", "lisdd", "sindy")


@dataclass(frozen=True)
class Tool:
    """A program with the commands of ``swimid``, and where Python looks for its packages first."""

    program: tuple[str, ...]
    search: Path

    def answer(self, folder: Path, *, timeout_s: float) -> Answer:
        """What it says of the case in a folder."""
        with tempfile.TemporaryDirectory(prefix="answer_") as name:
            results = Path(name) / "results"
            record = runner.diagnose(
                folder, results, program=self.program, timeout_s=timeout_s, search=self.search
            )
            path = results / "gap.yaml"
            gap = YAML(typ="safe").load(path.read_text()) if record["ended"] and path.exists() else None
        if gap is None:
            last = record["steps"][-1]
            print(f"{folder.name}: ended with {last['status']}: {last['stderr'][-300:]}", file=sys.stderr)
        wall = sum(step["wall_s"] for step in record["steps"])
        return answers.of_gap(folder.name, gap, round(wall, 2))


def tool(name: str, checkout: Path | None = None) -> Tool:
    """The tool of a name: ``swimid``, a peer, or ``checkout`` with the folder of another swimid."""
    if name == "checkout":
        if checkout is None or not (checkout / "swimid").is_dir():
            raise SystemExit("--tool checkout needs --checkout PATH, a folder with swimid/ in it")
        return Tool(runner.PROGRAM, checkout.resolve())
    if name in PEERS:
        return Tool((sys.executable, "-m", "benchmarks.gapbench.peers", name), ROOT)
    return Tool(runner.PROGRAM, ROOT)


def answer_all(
    asked: Tool,
    cases: Path,
    out: Path,
    *,
    only: Sequence[str] = (),
    jobs: int = 1,
    timeout_s: float = 900.0,
) -> int:
    """Add answers of the cases that have none yet to a file. How many were added.

    Parameters
    ----------
    cases : Path
        Folder of the cases' folders.
    only : sequence of str
        Only these cases.
    """
    known = set(_whole(out))
    folders = [f for f in sorted(cases.iterdir()) if f.is_dir() and (not only or f.name in only)]
    missing = set(only) - {f.name for f in folders}
    if missing:
        raise SystemExit(f"{cases} has no case {', '.join(sorted(missing))}")
    left = [f for f in folders if f.name not in known]
    writing = threading.Lock()
    with out.open("a", encoding="utf-8") as stream, ThreadPoolExecutor(jobs) as pool:

        def one(folder: Path) -> None:
            found = asked.answer(folder, timeout_s=timeout_s)
            with writing:
                stream.write(found.line())
                stream.flush()
                print(f"{found.case} {found.verdict} {found.wall_s} s", file=sys.stderr, flush=True)

        list(pool.map(one, left))
    return len(left)


def _whole(out: Path) -> dict[str, Answer]:
    """The answers there are already; one cut short when the program was killed is taken out of the file."""
    if not out.exists():
        return {}
    text = out.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        last = text[text.rfind("\n") + 1 :]
        try:
            json.loads(last)
            out.write_text(text + "\n", encoding="utf-8")
        except json.JSONDecodeError:
            out.write_text(text.removesuffix(last), encoding="utf-8")
    return answers.read(out)
