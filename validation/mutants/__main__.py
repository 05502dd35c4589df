"""Print the share of small errors in swimid that tests notice: ``python -m validation.mutants``.

The mutants are of the last commit. They run in a copy of its tree, and an interrupted run continues. The
equivalent mutants are listed in ``validation/mutants/equivalent.md``.
"""

from __future__ import annotations

import difflib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

import click

from validation.mutants import mutate
from validation.mutants.mutate import Mutant
from validation.mutants.reach import Reach

ROOT = Path(__file__).parents[2]
EQUIVALENT = Path(__file__).parent / "equivalent.md"
#: Statuses of pytest after which no test has failed.
PASSED, NO_TESTS = 0, 5
#: Number of files of tests that are mapped in one process.
CHUNK = 12


def _git(*words: str) -> bytes:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, check=True).stdout


def _environment(tree: Path) -> dict[str, str]:
    """Return the variables under which the tree's own package is tested."""
    return {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree.parent / "numba")}


def _record(tree: Path, out: Path, files: list[str]) -> None:
    words = [sys.executable, "-m", "validation.mutants.recorder", str(out), *files]
    subprocess.run(words, cwd=tree, env=_environment(tree), stdout=sys.stderr, check=True)


def _text(commit: str, path: str) -> list[str]:
    return _git("show", f"{commit}:{path}").decode().splitlines()


def _translate(old: dict[str, Any], new: dict[str, Any], before: str, after: str) -> dict[str, Any]:
    """Return an older map with the lines of a newer commit, with the tests of ``new`` in place of theirs."""
    changed = set(_git("diff", "--name-only", before, after).decode().split())
    there = set(_git("ls-tree", "-r", "--name-only", after).decode().split())
    files = set(new["files"])
    kept = {
        test: known
        for test, known in old["tests"].items()
        if test.split("::")[0] in there and test.split("::")[0] not in files
    }
    tests = {**kept, **new["tests"]}
    number = {test: i for i, test in enumerate(tests)}
    lines: dict[str, dict[str, list[int]]] = {}
    for data, is_old in ((old, True), (new, False)):
        names = list(data["tests"])
        for path, by_line in data["lines"].items():
            if path not in there:
                continue
            moved = {int(line): int(line) for line in by_line}
            if is_old and path in changed:
                match = difflib.SequenceMatcher(None, _text(before, path), _text(after, path), autojunk=False)
                moved = {
                    block.a + k + 1: block.b + k + 1
                    for block in match.get_matching_blocks()
                    for k in range(block.size)
                }
            for line, codes in by_line.items():
                if int(line) in moved:
                    found = lines.setdefault(path, {}).setdefault(str(moved[int(line)]), [])
                    # a test that both maps hold is taken from the newer
                    found += [
                        2 * number[names[code // 2]] + code % 2
                        for code in codes
                        if not is_old or names[code // 2] in kept
                    ]
    return {"tests": tests, "lines": lines, "files": sorted(({*old["files"]} & there) | files)}


def _files_of_tests(tree: Path) -> list[str]:
    """Return the files with tests, those with examples in docstrings included."""
    found = list((tree / "tests").rglob("test_*.py"))
    found += [path for path in (tree / "swimid").rglob("*.py") if ">>> " in path.read_text(encoding="utf-8")]
    return sorted(path.relative_to(tree).as_posix() for path in found)


def _restore(tree: Path, commit: str) -> None:
    """Write the files of a commit that are missing or differ, as after a run that was killed."""
    with tarfile.open(fileobj=BytesIO(_git("archive", commit))) as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is None:
                continue
            path = tree / member.name
            if not path.exists() or path.read_bytes() != content.read():
                archive.extract(member, tree, filter="data")


def prepare(folder: Path, commit: str) -> Path:
    """Return the folder of a commit, with its tree and its map of lines.

    The map of an earlier commit is used if there is one. Then only the changed files of tests run again. The
    map is stored after every :data:`CHUNK` files, so that an interrupted run continues.
    """
    work = folder / commit
    tree, out = work / "tree", work / "map.json"
    _restore(tree, commit)
    known: dict[str, Any] = {"tests": {}, "lines": {}, "files": []}
    earlier = sorted(folder.glob("*/map.json"), key=lambda path: path.stat().st_mtime)
    if out.exists():
        known = json.loads(out.read_text())
    elif earlier:
        before = earlier[-1].parent.name
        known = _translate(json.loads(earlier[-1].read_text()), known, before, commit)
        changed = set(_git("diff", "--name-only", before, commit, "--", "tests").decode().split())
        known["files"] = [name for name in known["files"] if name not in changed]
    left = [name for name in _files_of_tests(tree) if name not in known["files"]]
    for start in range(0, len(left), CHUNK):
        files = left[start : start + CHUNK]
        _record(tree, work / "map.new", files)
        new = json.loads((work / "map.new").read_text())
        known = _translate(known, {**new, "files": files}, commit, commit)
        _store(known, out)
    _store(known, out)
    return work


def _store(known: dict[str, Any], out: Path) -> None:
    part = out.with_suffix(".part")
    part.write_text(json.dumps(known))
    part.rename(out)


def _results(path: Path) -> dict[str, dict[str, Any]]:
    if not path.exists():
        return {}
    return {row["key"]: row for row in map(json.loads, path.read_text().splitlines())}


def _cache(mutant: Mutant, reach: Reach, work: Path) -> tuple[str, float]:
    """Return the folder of compiled functions for a mutant, and the time in s that they take to compile.

    A compiled function holds copies of the functions and the constants that it uses, so that all are compiled
    anew if the mutated line is among them. Another line of such a module only makes its own functions stale.
    """
    if "njit" not in mutant.source:
        return str(work / "numba"), 0.0
    scratch = work / "numba-of-mutant"
    shutil.rmtree(scratch, ignore_errors=True)
    if (mutant.path, mutant.line) not in reach.defined and (work / "numba").exists():
        shutil.copytree(work / "numba", scratch)
    return str(scratch), 60.0


def run(mutants: list[Mutant], work: Path, limit_s: float, earlier: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the result of each mutant; each is added to the file of results as soon as it is known."""
    path = work / "results.jsonl"
    known = _results(path)
    reach = Reach(work / "tree", work / "map.json")
    tree = work / "tree"
    with subprocess.Popen(
        [sys.executable, "-m", "validation.mutants.runner"],
        cwd=tree, env=_environment(tree), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as server:  # fmt: skip
        assert server.stdin is not None
        assert server.stdout is not None
        for number, mutant in enumerate(mutants, 1):
            if mutant.key in known:
                continue
            first = [earlier[mutant.key]["test"]] if mutant.key in earlier else []
            tests, seconds, left_out = reach.select(mutant, first, limit_s)
            row: dict[str, Any] = {"status": NO_TESTS, "test": "", "seconds": 0.0}
            if tests:
                cache, compile_s = _cache(mutant, reach, work)
                job = {
                    "path": mutant.path, "source": mutant.mutated, "tests": tests, "cache": cache,
                    "scratch": str(work / "scratch"), "limit_s": 30.0 + 3.0 * seconds + compile_s,
                }  # fmt: skip
                server.stdin.write(json.dumps(job) + "\n")
                server.stdin.flush()
                row = json.loads(server.stdout.readline())
            row |= {"key": mutant.key, "tests": len(tests), "left_out": left_out}
            row["noticed"] = row["status"] not in (PASSED, NO_TESTS)
            known[mutant.key] = row
            with path.open("a") as stream:
                stream.write(json.dumps(row) + "\n")
            word = "noticed" if row["noticed"] else "survived"
            print(
                f"{number:4d} {word:8s} {row['seconds']:5.1f} s {mutant.path}:{mutant.line}", file=sys.stderr
            )
        server.stdin.close()
    return [known[mutant.key] for mutant in mutants]


def table(mutants: list[Mutant], rows: list[dict[str, Any]], equivalent: set[str]) -> list[str]:
    """Return the lines of a table in Markdown: by package the drawn, equivalent and noticed mutants."""
    lines = ["| package | drawn | equivalent | noticed | share |", "|---|---|---|---|---|"]
    for package in (*mutate.SCOPE, "all"):
        chosen = [(m, row) for m, row in zip(mutants, rows, strict=True) if package in (m.package, "all")]
        noticed = sum(row["noticed"] for _, row in chosen)
        same = sum(m.key in equivalent and not row["noticed"] for m, row in chosen)
        share = "–"
        if len(chosen) > same:
            share = f"{100 * noticed / (len(chosen) - same):.0f} %"
        lines.append(f"| {package} | {len(chosen)} | {same} | {noticed} | {share} |")
    return lines


@click.command(help=__doc__)
@click.option("--mutants", "count", default=200, show_default=True, help="Number of mutants.")
@click.option("--seed", default=1, show_default=True, help="Seed of the draw.")
@click.option("--seconds", default=45.0, show_default=True, help="Time of the tests of one mutant, s.")
@click.option("--folder", type=click.Path(path_type=Path), help="Folder of trees, maps and results.")
@click.option("--again", is_flag=True, help="Run the survivors again.")
def main(count: int, seed: int, seconds: float, folder: Path | None, again: bool) -> None:
    """Draw mutants, run their tests and print the table."""
    if folder is None:
        folder = Path(tempfile.gettempdir()) / "swimid-mutants"
    commit = _git("rev-parse", "HEAD").decode().strip()
    work = prepare(folder.resolve(), commit)
    mutants = sorted(mutate.population(work / "tree"), key=lambda mutant: mutant.rank(seed))[:count]
    earlier = {}
    for path in sorted(folder.glob("*/results.jsonl"), key=lambda path: path.stat().st_mtime):
        earlier |= {key: row for key, row in _results(path).items() if row["test"]}
    results = work / "results.jsonl"
    if again and results.exists():
        kept = [row for row in _results(results).values() if row["noticed"]]
        results.write_text("".join(json.dumps(row) + "\n" for row in kept))
    rows = run(mutants, work, seconds, earlier)
    equivalent = set(re.findall(r"^\| `([0-9a-f]{10})`", EQUIVALENT.read_text(encoding="utf-8"), re.M))
    print("\n".join(table(mutants, rows, equivalent)))
    for title, wanted in (("Survivors", False), ("Equivalent (reasons in equivalent.md)", True)):
        print(f"\n{title}:")
        for mutant, row in zip(mutants, rows, strict=True):
            if not row["noticed"] and (mutant.key in equivalent) == wanted:
                tests = f"{row['tests']} tests pass"
                if row["left_out"]:
                    tests += f", {row['left_out']} left out for the time"
                print(f"{mutant.key} {mutant.path}:{mutant.line} in {mutant.scope or 'module'} ({tests})")
                print("".join(f"    {line}\n" for line in mutant.diff), end="")


if __name__ == "__main__":
    main()
