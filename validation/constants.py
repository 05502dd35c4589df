"""``python -m validation.constants OUT``: how many answers of a diagnosis change with each of its constants.

Blind cases that are quick to diagnose (rigs, tables, free decays) are answered as they are, and once more
with each constant at half of its size and at half as much again. An answer is the verdict with the effects
of each cause, in any order. What acts only once everything is fitted is changed without fitting anew.
"""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import swimid
from swimid import diagnosis
from swimid.diagnosis import search
from validation.blind import runner

ROBOTS = ("falling-weight", "cruise", "free-decay")
FACTORS = (0.5, 1.5)


@dataclass(frozen=True)
class Constant:
    """A number that may decide an answer.

    Attributes
    ----------
    module, name : str
    rest : bool
        Whether what it lacks to one is changed: of a probability near one.
    after : bool
        Whether it acts only once everything is fitted.
    """

    module: str
    name: str
    rest: bool = False
    after: bool = False

    @property
    def value(self) -> float | int:
        """As shipped."""
        value: float | int = getattr(import_module(f"swimid.diagnosis.{self.module}"), self.name)
        return value

    def changed(self, factor: float) -> float | int:
        """At a share of its size."""
        found = 1.0 - factor * (1.0 - self.value) if self.rest else factor * self.value
        return type(self.value)(found)

    @contextmanager
    def at(self, factor: float) -> Iterator[None]:
        """At a share of its size, wherever it was imported."""
        value = self.changed(factor)
        with ExitStack() as stack:
            for name in (self.module, *importers().get((self.module, self.name), ())):
                stack.enter_context(mock.patch(f"swimid.diagnosis.{name}.{self.name}", value))
            yield


@cache
def importers() -> dict[tuple[str, str], list[str]]:
    """The modules of the diagnosis that import a name of another one, by that module and the name."""
    found: dict[tuple[str, str], list[str]] = {}
    for path in Path(diagnosis.__path__[0]).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("swimid.diagnosis."):
                module = str(node.module).removeprefix("swimid.diagnosis.")
                for alias in node.names:
                    found.setdefault((module, alias.name), []).append(path.stem)
    return found


def _of(module: str, *names: str, **how: bool) -> list[Constant]:
    return [Constant(module, name, **how) for name in names]


CONSTANTS = (
    *_of("posterior", "MODEL_ERROR_SHARE", "FURTHER_CAUSE_ODDS", "MAX_NO_GAP_PROBABILITY"),
    *_of("answer", "MIN_EQUIVALENT_PROBABILITY", rest=True, after=True),
    *_of("answer", "MAX_RELATIVE_ERROR", after=True),
    *_of("verdict", "MIN_SURE_PROBABILITY", "MIN_DECREASE_PROBABILITY", rest=True, after=True),
    *_of("verdict", "MIN_CLOSED_SHARE", after=True),
    *_of("held_out", "FALSE_ALARM_RATE", "MAX_INTERVAL_WIDTH", "LEAST_GAP", after=True),
    *_of("dropouts", "FAILED_MISFIT", after=True),
    *_of("dropouts", "JUMP", "MOVED", "MIN_OFFSET_SD"),
    *_of("remainder", "PER_SAMPLE", "LEAST_GAIN", "LEAST_OF_FEW", "MOST_USED"),
    *_of("remainder", "QUANTILE", rest=True),
    *_of("noise", "MIN_LOG_LIKELIHOOD_GAIN", "MIN_FREE_SHARE", "LARGEST_SD", "BESIDE_GAP"),
    *_of("odd", "MIN_ODDS_RATIO"),
    *_of("study", "EFFECT_PRIOR", "START_PRIOR", "MAX_PRIOR_DISTANCE_SD", "MAX_INFORMATIVE_SHARE"),
    *_of("nominal", "OWN_PRIOR", "OTHER_PRIOR", "OTHER_DAY", "MAX_RATE_CORRELATION"),
    *_of("crossval", "SHRINKAGE"),
    *_of("screening", "MIN_SOUND_SHARE"),
)


def answer(folder: Path, params: Path) -> list[Any]:
    """Verdict, and the effects of each cause."""
    file = swimid.diagnose(folder / "trials.yaml", params=params, jobs=1).file
    return [file.verdict, sorted(sorted({c.effect, *c.equivalent}) for c in file.causes)]


def answers(folder: Path, constants: Sequence[Constant]) -> dict[str, list[Any]]:
    """The answers of a case: as it is, and by constant and factor."""
    *fit, told = runner.commands(folder)
    for step in fit:
        subprocess.run([sys.executable, "-m", "swimid", *step], cwd=folder, capture_output=True, check=False)
    params = folder / told[told.index("--params") + 1]
    kept: list[search.SearchResult] = []
    run = search.search_causes

    def searched(*given: Any, **options: Any) -> search.SearchResult:
        kept.append(run(*given, **options))
        return kept[-1]

    with mock.patch.object(search, "search_causes", searched):
        found = {"": answer(folder, params)}
    for constant in constants:
        known = (
            mock.patch.object(search, "search_causes", return_value=kept[0])
            if constant.after
            else nullcontext()
        )
        for factor in FACTORS:
            with constant.at(factor), known:
                found[f"{constant.module}.{constant.name} {factor}"] = answer(folder, params)
    return found


def one(case: dict[str, Any], *, out: Path, seed: int, constants: Sequence[Constant]) -> dict[str, Any]:
    """The answers of a case, kept in its folder."""
    kept = out / "answers" / f"{case['number']:04d}.json"
    if not kept.exists():
        found = answers(runner.make(case, out, seed), constants)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(found), encoding="utf-8")
    found = json.loads(kept.read_text(encoding="utf-8"))
    print(f"{case['number']:04d} {found['']}", file=sys.stderr, flush=True)
    return dict(found)


def main(argv: Sequence[str] | None = None) -> None:
    """Answer the cases, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m validation.constants", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of cases and answers; what is there is taken up again")
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--after", action="store_true", help="only what acts once everything is fitted")
    chosen = parser.parse_args(argv)
    constants = [c for c in CONSTANTS if c.after or not chosen.after]
    cases = runner.plan(chosen.cases, chosen.seed, robots=ROBOTS)
    work = partial(one, out=chosen.out, seed=chosen.seed, constants=constants)
    with ProcessPoolExecutor(chosen.jobs) as pool:
        found = list(pool.map(work, cases))
    print("| constant | value | " + " | ".join(f"× {factor}" for factor in FACTORS) + " |")
    print("|---" * (2 + len(FACTORS)) + "|")
    for constant in constants:
        name = f"{constant.module}.{constant.name}"
        counts = [sum(a[f"{name} {factor}"] != a[""] for a in found) for factor in FACTORS]
        cells = [f"{count} of {len(found)}" for count in counts]
        print(f"| `{name}` | {constant.value:g} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
