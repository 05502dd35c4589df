"""The text of the package keeps to plain English and to one term for one thing."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

#: Private words and phrases, and the term to use.
TERMS = {
    r"\bverbs?\b": "command",
    r"\bat nought\b": "with the null value",
    r"\bforetells?\b|\bforetold\b": "predict",
    r"\bamid\b": "during",
    r"\bwhat is left\b": "residuals",
    r"\bwhat lacks\b": "the missing effect",
    r"\bsightings?\b": "detection",
    r"\btold apart\b": "distinguished",
    r"\bnot told\b": "not identifiable",
    r"\bat most so many\b|\bso many\b": "maximum number of",
    r"\bFewest\b": "Minimum number of",
    r"\bcame to (its|an) end\b": "converged",
    r"\bruns? into (its|a) bound\b": "at its bound",
    r"\bthe same to the last\b": "identical",
    r"\bin turn\b.*\bin turn\b": "one 'in turn' for each sentence",
    r"\b[Hh]ouse\b": "package",
    r"\bdone away with\b": "remove",
}
#: Words with which no docstring begins.
OPENINGS = re.compile(r"(What|How|Of|So|Where|That|Which|By|In what)\b")


def _texts(path: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield line, text, and whether it is a docstring, of each docstring and comment block."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node):
            yield getattr(node, "lineno", 1), ast.get_docstring(node) or "", True
    for number, line in enumerate(source.splitlines(), 1):
        if line.lstrip().startswith("#"):
            yield number, line.strip(), False


@pytest.mark.parametrize(
    "package",
    sorted(p.name for p in (ROOT / "swimid").iterdir() if p.is_dir() and (p / "__init__.py").exists()),
)
def test_docstrings_and_comments_use_the_terms_of_the_field(package: str) -> None:
    found = []
    for path in sorted((ROOT / "swimid" / package).rglob("*.py")):
        for line, text, is_docstring in _texts(path):
            where = f"{path.relative_to(ROOT)}:{line}"
            found += [
                f"{where}: {term!r}, say {better}" for term, better in TERMS.items() if re.search(term, text)
            ]
            if is_docstring and OPENINGS.match(text):
                found.append(f"{where}: begins with {text.split()[0]!r}")
    assert not found, "\n".join(found)
