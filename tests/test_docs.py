"""The documentation is true: links lead somewhere, commands parse, printed results are printed."""

from __future__ import annotations

import datetime
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from ruamel.yaml import YAML

from docs import evidence, reference
from swimid.api import NAMES
from swimid.cli.main import main
from swimid.commands import COMMAND_SPECS
from tests.conftest import ROOT, SAMPLES, Ran

DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", DOCS / "llms.txt", *sorted(DOCS.rglob("*.md"))]


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


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
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


@pytest.mark.parametrize("page", ["fit-drag", "fit-graybox"])
def test_a_page_shows_what_its_command_prints(
    page: str, swimid: Callable[..., Ran], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    shown = re.search(rf"\$ swimid {page} ([^\n]*) -o \S+\.yaml\n(.*?)```", text, re.S)
    assert shown is not None
    assert swimid(page, *shlex.split(shown.group(1))).out.strip() == shown.group(2).strip()


@pytest.mark.parametrize("name", sorted(evidence.TABLES))
def test_the_measured_tables_of_a_page_are_those_of_the_files(name: str) -> None:
    page, made = evidence.TABLES[name]
    text = (DOCS / page).read_text(encoding="utf-8")
    assert evidence.replaced(text, name, made()) == text, "run: make evidence"


def test_a_new_output_of_a_measurement_replaces_its_table(tmp_path: Path) -> None:
    shutil.copy(evidence.MEASURED / "sources.yaml", tmp_path)
    printed = (
        "attacks\n| attack | inputs |\n|---|---|\n| a film | 40 |\n| a log | 2 |\n\n| b |\n|---|\n| 1 |\n"
    )
    evidence.take("faults", printed, tmp_path)
    assert (tmp_path / "faults.csv").read_text() == "attack,inputs\na film,40\na log,2\n"
    today = datetime.date.today().isoformat()
    assert YAML(typ="safe").load((tmp_path / "sources.yaml").read_text())["faults"]["date"] == today
    with pytest.raises(ValueError, match="no table"):
        evidence.take("faults", "no findings", tmp_path)


def test_nothing_of_the_workshop_is_left() -> None:
    """No path of a machine, no leftover marker, in anything that ships."""
    words = re.compile(r"/work/|/root/|/tmp/|\bTODO\b|\bFIXME\b|\bXXX\b|^[<>]{7} ", re.MULTILINE)
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
    rows = re.findall(r"^\| [^|]+ \| ([^|]*\d[^|]*) \| \[[\w.-]+\]\(([\w./-]+)", text, re.M)
    assert len(rows) > 3
    for value, page in rows:
        assert value in (ROOT / "docs" / page).read_text(), f"{page} has no '{value}'"
    known = set(re.findall(r"^@\w+\{([\w-]+),", (ROOT / "docs/paper.bib").read_text(), re.M))
    assert set(re.findall(r"@([\w-]+)[;\]]", text)) <= known


# ---------------------------------------------------------------- the site


def _pages_of(nav: Any) -> Iterator[str]:
    """Yield the pages of the navigation of the site."""
    if isinstance(nav, str):
        yield nav
    for one in nav.values() if isinstance(nav, dict) else nav if isinstance(nav, list) else ():
        yield from _pages_of(one)


def test_every_page_is_in_the_navigation_once() -> None:
    nav = list(
        _pages_of(tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"])
    )
    written = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")]
    made = [name for name in nav if name.startswith("reference/")]
    assert sorted(nav) == sorted([*written, *made, "CONTRIBUTING.md", "CHANGELOG.md"])


def test_the_reference_lists_every_public_name_once() -> None:
    listed = [name for names in reference.PYTHON.values() for name in names]
    assert sorted(listed) == sorted(NAMES)


def _alike(row: str, other: str) -> bool:
    """Return whether two rows have the same words, and the same numbers but for the noise of a simulation.

    Processors and versions of libraries differ in the last digits of a fit, and codecs in single pixels.
    """
    number = r"[-+]?\d+\.?\d*"
    values, others = (list(map(float, re.findall(number, line))) for line in (row, other))
    same_words = re.sub(number, "", row) == re.sub(number, "", other)
    return same_words and values == pytest.approx(others, rel=0.3, abs=0.03)


@pytest.mark.parametrize("name", ["rig", "markers", "trials", "imu"])
@pytest.mark.slow
def test_the_tables_of_a_page_are_printed_by_its_command(name: str) -> None:
    place = DOCS if name == "imu" else DOCS / "learn"
    page = (place / f"{name}.md").read_text(encoding="utf-8")
    command = f"docs.learn.{name}"
    assert f"`python -m {command}`" in page
    ran = subprocess.run(
        [sys.executable, "-m", command], cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    )
    shown = [line for line in page.splitlines() if line.startswith("|")]
    printed = [line for line in ran.stdout.splitlines() if line]
    assert len(printed) > 5
    for row in printed:
        assert any(_alike(row, line) for line in shown), row


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("zensical") is None, reason="the extra docs is not installed: make docs"
)
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    for folder in (DOCS, ROOT / "swimid", SAMPLES):
        shutil.copytree(folder, tmp_path / folder.name)
    for name in ("zensical.toml", "CONTRIBUTING.md", "CHANGELOG.md"):
        shutil.copy(ROOT / name, tmp_path)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    words = [sys.executable, "docs/make_site.py"]
    ran = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    pages = sorted((tmp_path / "site").rglob("*.html"))
    whole = "".join(path.read_text(encoding="utf-8") for path in pages)
    foreign = r"<(script|img|iframe)[^>]*src=.https?:|<link[^>]*=.stylesheet[^>]*https?:"
    assert not re.search(foreign, whole)
    assert 'class="equation"' in (tmp_path / "site" / "equations.html").read_text(encoding="utf-8")
    assert "arithmatex" not in whole
    for command in COMMAND_SPECS:
        assert f'id="{command.replace(" ", "-")}"' in whole
    for name in NAMES:
        assert f'id="{name.lower()}"' in whole
