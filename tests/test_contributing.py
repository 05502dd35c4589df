"""CONTRIBUTING.md is true: its examples work where it puts them, in a copy of the package."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from swimid import __version__
from tests.conftest import ROOT, SAMPLES

TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
#: A file's name on a line of its own, and the block of code that is to be in it.
BLOCK = re.compile(r"^`([\w./]+)`:\n\n```(\w+)\n(.*?)^```$", re.M | re.S)
#: What each worked list adds, its tests aside.
TOUCHED = {
    "Add an effect": ["swimid/effects/encoder_ripple.py", "swimid/effects/magnet.py"],
    "Add a model": ["swimid/rig/glide.py"],
    "Add an experiment": ["swimid/experiments/coasting_body.py"],
    "Add a robot": ["swimid/robots/koi.yaml"],
    "Add a command": ["swimid/rig/fit_glide.py", "swimid/rig/options.py", "swimid/commands.py"],
}
#: Runs the commands of the manual in the copy.
RUNNER = """
import pytest

COMMANDS = {commands!r}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_command(swimid, words):
    ran = swimid(*words)
    assert ran.status == 0, ran.err
"""


def _section(title: str) -> str:
    return TEXT.split(f"## {title}\n")[1].split("\n## ")[0]


def _changed(text: str, diff: str) -> str:
    """A text with the hunks of a diff applied, each of which stands at one place only."""
    for hunk in diff.split("@@\n")[1:]:
        lines = hunk.splitlines(keepends=True)
        before = "".join(line[1:] for line in lines if line[0] in " -")
        assert text.count(before) == 1, before
        text = text.replace(before, "".join(line[1:] for line in lines if line[0] in " +"))
    return text


def _put(copy: Path, blocks: list[tuple[str, str, str]]) -> None:
    for name, language, code in blocks:
        path = copy / name
        if language == "diff":
            path.write_text(_changed(path.read_text(encoding="utf-8"), code), encoding="utf-8")
        else:
            assert not path.exists(), f"{name} is there already"
            path.write_text(code, encoding="utf-8")


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package as it would be with every example of the manual in it."""
    folder = tmp_path_factory.mktemp("copy")
    shutil.copytree(ROOT / "swimid", folder / "swimid")  # compiled kernels with it
    shutil.copytree(SAMPLES / "rig", folder / "sample_logs" / "rig")
    (folder / "tests").mkdir()
    for name in ("__init__.py", "conftest.py"):
        shutil.copy(ROOT / "tests" / name, folder / "tests")
    _put(folder, BLOCK.findall(TEXT))
    lines = re.findall(r"^swimid (.*)$", "".join(map(_section, TOUCHED)), re.M)
    commands = [shlex.split(line) for line in lines]
    (folder / "tests" / "test_commands.py").write_text(RUNNER.format(commands=commands), encoding="utf-8")
    return folder


@pytest.mark.parametrize("title", TOUCHED)
def test_files_touched(title: str) -> None:
    """An effect, a model, an experiment and a robot take one file each, a command two and a row."""
    named = [name for name, *_ in BLOCK.findall(_section(title))]
    assert [name for name in named if not name.startswith("tests/")] == TOUCHED[title]


def _tested(copy: Path, *names: str) -> str:
    """Run tests in the copy and return the last line that pytest prints."""
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTEST_ADDOPTS": ""}
    ran = subprocess.run([*words, *names], cwd=copy, env=environment, capture_output=True, encoding="utf-8")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout.splitlines()[-1]


@pytest.mark.slow
def test_the_new_command_runs(copy: Path) -> None:
    """Two files make ``swimid fit-glide``, its help and its line in the list of commands."""
    assert _tested(copy, "tests/test_glide_command.py").startswith("2 passed")
    for words, shown in ((["--help"], "fit-glide "), (["fit-glide", "--help"], "--fix NAME=VALUE")):
        ran = subprocess.run(
            [sys.executable, "-m", "swimid", *words], cwd=copy, capture_output=True, encoding="utf-8"
        )
        assert shown in ran.stdout, ran.stderr


@pytest.mark.slow
def test_the_examples_work(copy: Path) -> None:
    """The tests that the manual writes for its examples pass, and its commands run."""
    names = [name for name, *_ in BLOCK.findall(TEXT) if name.startswith("tests/")]
    assert _tested(copy, *names, "tests/test_commands.py").startswith("8 passed")
    assert (copy / "koi.csv").exists()


def test_the_examples_are_in_good_style(copy: Path) -> None:
    """The linter finds nothing to say of them."""
    shutil.copy(ROOT / "pyproject.toml", copy)
    names = [name for name, language, _ in BLOCK.findall(TEXT) if language in ("python", "diff")]
    for words in (["check"], ["format", "--check"]):
        ran = subprocess.run(
            [sys.executable, "-m", "ruff", *words, "--no-cache", *names],
            cwd=copy,
            capture_output=True,
            encoding="utf-8",
        )
        assert ran.returncode == 0, ran.stdout + ran.stderr


def test_its_targets_are_in_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"(?:`|^)make ([a-z-]+)", TEXT, re.M):
        assert re.search(rf"^{target}:", makefile, re.M), target


def test_every_place_names_the_same_version() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"^## \[(.+)\] - (unreleased|\d{4}-\d\d-\d\d)$", changes, re.M)
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert newest is not None
    assert cited is not None
    assert newest.group(1) == cited.group(1) == __version__


def test_the_matrix_is_what_the_package_claims() -> None:
    """Every Python and system of the metadata is tried, by the commands of the README."""
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8"))
    job = workflow["jobs"]["tests"]
    claimed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    pythons = [c.rpartition(" ")[2] for c in claimed if re.search(r"Python :: 3\.\d", c)]
    assert job["strategy"]["matrix"]["python"] == pythons
    systems = {name.partition("-")[0] for name in job["strategy"]["matrix"]["os"]}
    assert systems == {"ubuntu", "macos", "windows"}
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make demo", "make test"]


def test_the_hooks_are_lint_format_and_types() -> None:
    found = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = [hook["id"] for repository in found["repos"] for hook in repository["hooks"]]
    assert hooks[:3] == ["ruff", "ruff-format", "mypy"]
