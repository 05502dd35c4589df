"""The wheel in an empty environment, and the files from which other package managers install."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from swimid import __version__
from tests.conftest import ROOT


def run(*words: str | Path, folder: Path) -> str:
    """Run a program as a user does whose shell has no variables for Python; return what it prints."""
    env = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA", "PIP"))}
    env |= {"HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}
    ran = subprocess.run([str(word) for word in words], cwd=folder, env=env, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


@pytest.mark.slow
def test_the_wheel_installs_runs_and_leaves_nothing(tmp_path: Path) -> None:
    run(sys.executable, "-m", "pip", "wheel", ROOT, "--no-deps", "--wheel-dir", tmp_path, folder=tmp_path)
    (wheel,) = tmp_path.glob("swimid-*.whl")
    venv.create(tmp_path / "env", with_pip=True)
    programs = tmp_path / "env" / os.path.relpath(sysconfig.get_path("scripts"), sys.prefix)
    found = subprocess.run(
        [programs / "python", "-m", "pip", "download", "click", "--no-deps", "-d", tmp_path / "probe"],
        capture_output=True,
    )
    if found.returncode:
        pytest.skip("no package index can be reached")
    before = {path for path in (tmp_path / "env").rglob("*") if "__pycache__" not in path.parts}
    run(programs / "python", "-m", "pip", "install", wheel, folder=tmp_path)
    swimid = programs / "swimid"
    assert __version__ in run(swimid, "--version", folder=tmp_path)
    run(swimid, "sample", "rig", folder=tmp_path)
    assert "GOOD" in run(swimid, "fit-drag", "rig/trials.yaml", "-o", "drag.yaml", folder=tmp_path)
    run(swimid, "report", "drag.yaml", "-o", "report.html", folder=tmp_path)
    assert (tmp_path / "report.html").stat().st_size > 50_000
    kernels = [path for path in tmp_path.rglob("*.nbc") if "swimid" in str(path)]
    assert kernels
    run(swimid, "doctor", "--clean", folder=tmp_path)
    assert not any(path.exists() for path in kernels)
    run(programs / "python", "-m", "pip", "uninstall", "-y", "swimid", folder=tmp_path)
    left = [path for path in (tmp_path / "env").rglob("*swimid*") if path not in before]
    assert not [path for path in left if path.is_file()]
    shutil.rmtree(tmp_path / "env")


def test_recipe_and_citation_state_what_the_project_states() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = YAML(typ="safe").load((ROOT / "packaging/recipe.yaml").read_text())
    names = {"matplotlib": "matplotlib-base", "opencv-python-headless": "py-opencv"}
    wanted = set()
    for text in project["dependencies"]:
        name, limits = re.fullmatch(r"([\w.-]+?)([<>=].*)", text).groups()
        wanted.add(f"{names.get(name, name)} {limits}")
    stated = set(recipe["requirements"]["run"])
    assert {one for one in stated if not one.startswith("python ")} == wanted
    assert recipe["context"]["version"] == __version__
    assert f"version: {__version__}" in (ROOT / "CITATION.cff").read_text()


def test_compiled_kernels_are_removed(tmp_path: Path) -> None:
    """Also those of generated kernels, which lie in a cache folder within a cache folder."""
    package = tmp_path / "swimid"
    shutil.copytree(ROOT / "swimid", package, ignore=shutil.ignore_patterns("__pycache__"))
    nested = package / "swimmer/planar/__pycache__/lanes/__pycache__"
    nested.mkdir(parents=True)
    for path in (nested / "lanes_1.nbi", nested.parent / "lanes_1.py", package / "rig/__pycache__/model.nbc"):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"12345")
    run_it = "from swimid.files import kernels; print(kernels.remove_cache())"
    env = {**os.environ, "PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    ran = subprocess.run(
        [sys.executable, "-c", run_it], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert ran.stdout.split() == ["15"], ran.stderr
    assert not nested.parent.exists()
