"""The documentation is true: links lead somewhere, commands parse, printed results are printed."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import click
import pytest

from swimid.cli.main import main
from tests.conftest import ROOT, Ran

PAGES = [ROOT / "README.md", ROOT / "docs/llms.txt", *sorted((ROOT / "docs").glob("*.md"))]


def _commands(page: Path) -> list[str]:
    """Every ``swimid ...`` line of a page's code blocks, continuation lines joined."""
    found = []
    for block in re.findall(r"```[a-z]*\n(.*?)```", page.read_text(), flags=re.S):
        text = block.replace("\\\n", " ")
        found += [line.removeprefix("$ ") for line in text.splitlines() if re.match(r"(\$ )?swimid ", line)]
    return found


def _anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), flags=re.M)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target, anchor in re.findall(r"\]\(([^)#]*)(?:#([^)]*))?\)", page.read_text()):
        if target.startswith("http"):
            continue
        linked = page.parent / target if target else page
        assert linked.exists(), target
        if anchor:
            assert anchor in _anchors(linked), f"{target}#{anchor}"


@pytest.mark.parametrize(
    "line", sorted({line for page in PAGES for line in _commands(page)}), ids=lambda line: line[:60]
)
def test_commands_parse(line: str) -> None:
    command: click.Command = main
    words = shlex.split(line, comments=True)[1:]
    while isinstance(command, click.Group) and words:
        command = command.commands[words.pop(0)]
    command.make_context("swimid", words)  # raises for an unknown option or a missing argument


def test_the_readme_shows_what_the_command_prints(
    swimid: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    shown = re.search(
        r"\$ swimid fit-drag (\S+) -o drag\.yaml\n(.*?)```", (ROOT / "README.md").read_text(), re.S
    )
    assert shown is not None
    assert swimid("fit-drag", shown.group(1)).out.strip() == shown.group(2).strip()


def test_nothing_of_the_workshop_is_left() -> None:
    """No path of a machine, no leftover marker, in anything that ships."""
    words = re.compile(r"/work/|/root/|/tmp/|\bTODO\b|\bFIXME\b|\bXXX\b")
    folders = [ROOT / name for name in ("swimid", "docs", "benchmarks")]
    files = [
        p
        for folder in folders
        for p in folder.rglob("*")
        if p.suffix in (".py", ".md", ".yaml", ".html", ".css")
    ]
    for path in [*files, ROOT / "README.md", ROOT / "Makefile", ROOT / "CHANGELOG.md"]:
        assert not words.search(path.read_text()), path


def test_the_paper_states_what_the_manuals_state() -> None:
    """Each figure of the table stands in the page that it links to, and each reference is in the list."""
    text = (ROOT / "docs/paper.md").read_text()
    rows = re.findall(r"^\| [^|]+ \| ([^|]*\d[^|]*) \| \[[\w.-]+\]\(([\w.-]+)", text, re.M)
    assert len(rows) > 3
    for value, page in rows:
        assert value in (ROOT / "docs" / page).read_text(), f"{page} has no '{value}'"
    known = set(re.findall(r"^@\w+\{([\w-]+),", (ROOT / "docs/paper.bib").read_text(), re.M))
    assert set(re.findall(r"@([\w-]+)[;\]]", text)) <= known
