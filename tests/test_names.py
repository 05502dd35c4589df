"""One name has one meaning in the package, and functions are verbs."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache

from tests.conftest import ROOT

#: Functions and constants that plug-in modules define under one name, because their package calls them by it.
HOOKS = {"answer", "checks", "export", "figures", "load", "read", "simulate", "tables", "warm_up", "write"}
HOOK_CONSTANTS = {
    "COLUMNS", "FORMAT", "KINDS", "NAME", "NAMES", "PROFILE", "REFERENCES", "TITLE", "UNITS", "_NUMBER",
}  # fmt: skip
#: Verbs that end like a participle.
VERBS = {"bleed", "embed", "exceed", "feed", "need", "proceed", "seed", "shed", "speed", "succeed", "weed"}
#: Irregular participles, present participles that are no noun of the field, and adverbs.
NO_VERBS = frozenset(
    re.findall(
        r"\w+",
        """
        beaten begun bent bound broken built caught chosen done drawn driven eaten felt forgotten fought
        found frozen given gone heard held hidden kept known led left lent lost made meant met paid risen
        seen sent shown sold spent spoken stolen stood struck sunk swept sworn taken taught thought thrown
        told torn undetermined understood unfinished unknown unmeasured unused woken won worked wound
        written acting agreeing carrying describing facing following having integrating leading matching
        missing moving naming replacing running telling widening yielding afterwards against ahead alike
        amid among anew apart around away beside besides beyond mostly nearly often seldom together within
        without
        """,
    )
)


@cache
def _modules() -> dict[str, ast.Module]:
    """Every module of the package by its path, without generated kernels."""
    paths = sorted(p for p in (ROOT / "swimid").rglob("*.py") if "__pycache__" not in p.parts)
    return {str(p.relative_to(ROOT)): ast.parse(p.read_text(encoding="utf-8")) for p in paths}


def _is_verb(name: str) -> bool:
    """Return whether the first word of a function's name is neither a participle nor an adverb."""
    word = name.strip("_").split("_")[0]
    return word not in NO_VERBS and (word in VERBS or len(word) < 4 or not word.endswith("ed"))


def _constants(tree: ast.Module) -> Iterator[str]:
    """Yield the names of the constants of a module."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        for target in targets:
            if isinstance(target, ast.Name) and re.fullmatch(r"_?[A-Z][A-Z0-9_]*", target.id):
                yield target.id


def _repeated(places: dict[str, list[str]]) -> list[str]:
    return [f"{name}: {', '.join(paths)}" for name, paths in sorted(places.items()) if len(paths) > 1]


def test_a_class_name_has_one_meaning() -> None:
    places = defaultdict(list)
    for path, tree in _modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(path)
    assert _repeated(places) == []


def test_a_public_function_name_has_one_meaning() -> None:
    places = defaultdict(list)
    for path, tree in _modules().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and node.name not in HOOKS and node.name[0] != "_":
                places[node.name].append(path)
    assert _repeated(places) == []


def test_a_constant_stands_once() -> None:
    places = defaultdict(list)
    for path, tree in _modules().items():
        for name in _constants(tree):
            if name not in HOOK_CONSTANTS:
                places[name].append(path)
    assert _repeated(places) == []


def test_functions_are_verbs() -> None:
    nodes = [(path, node) for path, tree in _modules().items() for node in ast.walk(tree)]
    found = [
        f"{path}:{node.lineno}: {node.name}"
        for path, node in nodes
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("__") and not _is_verb(node.name)
    ]
    assert found == []
