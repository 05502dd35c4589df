"""The next command of a result can be typed where it says, and replaces nothing."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Callable
from html import unescape
from pathlib import Path

import pytest

import swimid as package
from tests.conftest import SAMPLES, Ran

Run = Callable[..., Ran]
WRONG = ("--set", "drag_coefficient=3")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the rig's logs, and with parameters that were fitted in it."""
    folder = tmp_path_factory.mktemp("fitted")
    shutil.copytree(SAMPLES / "rig", folder / "rig")
    trials = str(folder / "rig" / "trials.yaml")
    package.fit_drag(trials, output=folder / "drag.yaml")
    return folder


@pytest.fixture
def folder(fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder as the working folder."""
    shutil.copytree(fitted, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def following(ran: Ran) -> list[str]:
    """Words of the line ``next:``."""
    assert ran.status == 0, ran.err
    lines = [line for line in ran.stderr.splitlines() if line.startswith("next: ")]
    return shlex.split(lines[0].removeprefix("next: ")) if lines else []


def on_page(page: Path) -> list[list[str]]:
    """Words of each next command on a page."""
    lines = re.findall(r'class="next">.*?<code>(.*?)</code>', page.read_text(encoding="utf-8"))
    return [shlex.split(unescape(line)) for line in lines]


def test_a_good_comparison_is_followed_by_a_report(swimid: Run, folder: Path) -> None:
    words = ("compare", "rig/trials.yaml", "--params", "drag.yaml", "-o", "comparison.yaml")
    assert following(swimid(*words)) == ["swimid", "report", "comparison.yaml", "-o", "report.html"]
    assert swimid("report", "comparison.yaml", "-o", "report.html").status == 0
    assert following(swimid(*words))[-1] == "report-2.html"


def test_a_diagnosis_replaces_no_gap_and_no_repaired_model(swimid: Run, folder: Path) -> None:
    words = ("compare", "rig/trials.yaml", "--params", "drag.yaml", *WRONG, "-o", "wrong.yaml")
    line = ["swimid", "diagnose", "rig/trials.yaml", "--params", "drag.yaml", "-o"]
    assert following(swimid(*words)) == [*line, "gap.yaml"]
    (folder / "gap.yaml").touch()
    assert following(swimid(*words)) == [*line, "gap-2.yaml"]
    (folder / "repaired.yaml").touch()
    assert following(swimid(*words)) == [*line, "gap-2.yaml", "--repaired", "repaired-2.yaml"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["my $(touch pwned).yaml", "-run; it's.yaml", "a`b`'c\".yaml"])
def test_names_are_quoted(swimid: Run, folder: Path, name: str) -> None:
    trials = Path("rig", name)
    Path("rig/trials.yaml").rename(trials)
    answer = swimid("fit-drag", trials, "-o", f"./{name}", "--json").json
    (line,) = answer["next"]
    words = shlex.split(line)
    assert words[:3] == ["swimid", "compare", str(trials)]
    assert Path(words[4]).name == name
    assert not words[4].startswith("-")
    assert swimid(*words[1:]).status == 0
    assert swimid("report", f"./{name}", "-o", "page.html").status == 0
    (shown,) = on_page(folder / "page.html")
    assert [shown[2], shown[4]] == [words[2], words[4]]
    assert shown[-1] == "comparison-2.yaml"
    assert not Path("pwned").exists()


@pytest.mark.slow
def test_a_page_has_the_paths_from_its_own_folder(
    swimid: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("out").mkdir()
    assert swimid("fit-drag", "rig/trials.yaml", "-o", "out/drag.yaml").status == 0
    monkeypatch.chdir(folder.parent)  # neither the folder of the fit nor that of the page
    page = folder / "out" / "report.html"
    assert swimid("report", folder / "out" / "drag.yaml", "-o", page).status == 0
    (words,) = on_page(page)
    assert shlex.join(words) == "swimid compare ../rig/trials.yaml --params drag.yaml -o comparison.yaml"
    monkeypatch.chdir(page.parent)
    assert swimid(*words[1:]).status == 0
    # what is on the page already is no next step, and neither is a page
    assert swimid("report", "drag.yaml", "comparison.yaml", "-o", "both.html").status == 0
    assert on_page(Path("both.html")) == []
    # where the trials are gone, there is nothing to type
    shutil.move(folder / "rig", folder / "elsewhere")
    assert swimid("report", "drag.yaml", "-o", page).status == 0
    assert on_page(page) == []


def test_the_answer_has_no_command_without_a_file(swimid: Run, folder: Path) -> None:
    assert json.loads(swimid("fit-drag", "rig/trials.yaml", "--json").out)["next"] == []
