"""Tests that reach a line: those that execute it, or code that uses what the line defines.

Coverage sees no lines of compiled functions, and no lines of a module that is imported before the tests. The
tests of such a line are those that execute a use of the function or of the constant.
"""

from __future__ import annotations

import ast
import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.mutants.mutate import Mutant, is_compiled

#: Cost of one more file of tests, s: its import and its fixtures.
FILE_S = 0.3


@dataclass(frozen=True)
class Place:
    """A use of a name; ``owner`` is the name that the use defines, None in a function that coverage sees."""

    path: str
    line: int
    owner: str | None


class Reach:
    """Tests by line, of one tree.

    Parameters
    ----------
    root : Path
        Root of the tree.
    map_path : Path
        File of ``recorder``.
    """

    def __init__(self, root: Path, map_path: Path) -> None:
        data = json.loads(map_path.read_text())
        self.tests: list[str] = list(data["tests"])
        self.known: dict[str, dict[str, Any]] = data["tests"]
        self.lines: dict[str, dict[str, list[int]]] = data["lines"]
        self.uses: dict[str, list[Place]] = defaultdict(list)
        #: Names defined by the lines that coverage does not see, by module and line.
        self.defined: dict[tuple[str, int], str] = {}
        for path in sorted((root / "swimid").rglob("*.py")):
            if "__pycache__" not in path.parts:
                self._read(ast.parse(path.read_text(encoding="utf-8")), path.relative_to(root).as_posix())

    def _read(self, module: ast.Module, path: str) -> None:
        def visit(node: ast.AST, owner: str | None) -> None:
            for child in ast.iter_child_nodes(node):
                name = owner
                if is_compiled(child) or (isinstance(child, ast.ClassDef) and owner is not None):
                    name = child.name  # type: ignore[attr-defined]
                elif isinstance(child, ast.FunctionDef):
                    name = None
                elif isinstance(child, ast.Assign | ast.AnnAssign) and owner == "":
                    target = child.target if isinstance(child, ast.AnnAssign) else child.targets[0]
                    name = getattr(target, "id", "")
                if isinstance(child, ast.Name | ast.Attribute):
                    used = child.attr if isinstance(child, ast.Attribute) else child.id
                    self.uses[used].append(Place(path, child.lineno, name))
                if name and (isinstance(child, ast.Assign | ast.AnnAssign) or is_compiled(child)):
                    for line in range(child.lineno, (child.end_lineno or child.lineno) + 1):  # type: ignore[attr-defined]
                        self.defined[path, line] = name
                visit(child, name)

        visit(module, "")

    def _at(self, path: str, line: int) -> list[int]:
        return self.lines.get(path, {}).get(str(line), [])

    def _codes(self, mutant: Mutant) -> set[int]:
        """Return the numbers of the tests of a mutant, doubled, odd where only its set-up reaches it."""
        name = self.defined.get((mutant.path, mutant.line))
        if name is None:
            for line in range(mutant.line, max(mutant.line - 12, 0), -1):
                codes = self._at(mutant.path, line)
                if codes:
                    return set(codes)
            return set()
        found: set[int] = set()
        names, seen = [name], {name}
        while names:
            for place in self.uses[names.pop()]:
                if place.owner is None:
                    found |= set(self._at(place.path, place.line))
                elif place.owner and place.owner not in seen:
                    seen.add(place.owner)
                    names.append(place.owner)
        return found

    def _seconds(self, test: str) -> float:
        return self.known[test]["setup"] + self.known[test]["call"]

    def select(self, mutant: Mutant, first: Iterable[str], limit_s: float) -> tuple[list[str], float, int]:
        """Return tests of a mutant by file, their time in s, and the number of tests left out for the time.

        The shortest tests of those that execute the line come first, then the other tests of their files,
        which may read a result that the first one made for all.
        """
        codes = self._codes(mutant)
        direct = {self.tests[code // 2] for code in codes}
        files = {test.split("::")[0] for test in direct}
        beside = {test for test in self.tests if test.split("::")[0] in files} - direct
        order = [test for test in first if test in self.known]
        for group in (direct, beside):
            order += sorted((t for t in group if t not in order), key=lambda t: (self._seconds(t), t))
        order = [test for test in order if self.known[test]["passed"]]
        chosen: dict[str, list[str]] = {}
        spent, left_out = 0.0, 0
        for test in order:
            file = test.split("::")[0]
            cost = self._seconds(test)
            if file not in chosen:
                cost += FILE_S
            if spent + cost > limit_s:
                left_out += test in direct
                continue
            spent += cost
            chosen.setdefault(file, []).append(test)
        return [test for tests in chosen.values() for test in tests], spent, left_out
