"""The table of packages in docs/architecture.md, held to: imports run one way, and --help stays light."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid import notices
from tests.conftest import ROOT

PACKAGE = Path(notices.__file__).parent
PAGE = ROOT / "docs" / "architecture.md"
#: Level of each package, and of each module that all use: it imports from itself and from lower levels.
LEVEL = {
    name: int(level)
    for level, name in re.findall(r"^\| (\d+) \| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
}
PACKAGES = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))


def _modules() -> dict[str, Path]:
    """Every module by its dotted name, a package by its own."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        if "__pycache__" not in path.parts:  # generated kernels
            parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = _modules()


def _imported(tree: ast.AST) -> set[str]:
    """The modules of the package that a module imports, inside a function too, but not for types only."""
    names: set[str] = set()
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        names |= _imported(child)
        if isinstance(child, ast.Import):
            names |= {alias.name for alias in child.names} & set(MODULES)
        elif isinstance(child, ast.ImportFrom) and child.module in MODULES:
            whole = [f"{child.module}.{alias.name}" for alias in child.names]
            # a name that is no module of its own is one in the module before it
            names |= {name if name in MODULES else child.module for name in whole}
    return names


@cache
def _graph() -> dict[str, set[str]]:
    """The modules that each module imports."""
    return {name: _imported(ast.parse(path.read_text(encoding="utf-8"))) for name, path in MODULES.items()}


@pytest.mark.parametrize("name", [name for name in MODULES if name.count(".") > 1])
def test_imports_run_one_way(name: str) -> None:
    package = name.split(".")[1]
    for other in _graph()[name] - {"swimid"}:
        target = other.split(".")[1]
        assert target == package or LEVEL[target] < LEVEL[package], f"{name} may not import {other}"


def test_every_package_is_in_the_table() -> None:
    beside = {"commands", "errors", "notices", "options", "reading"}
    assert set(LEVEL) == {*PACKAGES, *beside}
    assert {name for name, level in LEVEL.items() if level == 0} == beside


def test_no_modules_import_each_other_in_a_cycle() -> None:
    # a package imports its modules where it lists them
    graph = {name: {o for o in others if not name.startswith(f"{o}.")} for name, others in _graph().items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_the_page_is_short() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(text.split()) <= 1500
    assert text.count("```") == 2  # one picture


def test_documents_for_developers_name_what_is_there() -> None:
    """Every ``package/module.py`` of the documents for developers, and every ``package/folder/``."""
    place = re.compile(r"`(?:swimid/)?([a-z_]+/[a-z_/]*(?:\w+\.(?:py|yaml|md))?)`(?!:$)", re.M)
    for page in (PAGE, ROOT / "CONTRIBUTING.md"):
        for name in place.findall(page.read_text(encoding="utf-8")):
            inside = PACKAGE if name.split("/")[0] in LEVEL else ROOT
            assert (inside / name).exists(), f"{page.name} names {name}"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_what_is_in_it(package: str) -> None:
    """The docstring of a package names modules of it, and none that is not there."""
    folder = PACKAGE / package
    said = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    assert said is not None
    head = re.split(r"^-{4,}$", said, flags=re.M)[0]
    names = re.findall(r"``(\w+)``", head)
    inside = {path.stem for path in folder.glob("*.py")} | {
        path.name for path in folder.iterdir() if path.is_dir()
    }
    assert names, f"{package}: names none of its modules"
    assert set(names) <= inside, f"{package}: {set(names) - inside}"


def test_help_imports_nothing_heavy() -> None:
    """numpy and what is heavier stay out of --help and completion."""
    code = (
        "import sys; from swimid.cli.main import main; main(['--help'], standalone_mode=False); "
        "heavy = "
        "{'numpy', 'scipy', 'pandas', 'numba', 'cv2', 'control', 'filterpy', 'matplotlib', 'pydantic'}; "
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stderr.strip() == "[]"


HEAVY = {"pyarrow", "matplotlib", "scipy.signal", "scipy.stats", "control", "numba"}


def test_importing_a_log_imports_nothing_heavy(tmp_path: Path) -> None:
    """A log with a stroke is imported without pyarrow, and without the libraries of fits and figures."""
    time_s = np.arange(400) / 50
    log = pd.DataFrame({"t_s": time_s, "yaw_rad": 0.2 * np.sin(2 * np.pi * 1.5 * time_s)})
    log.to_csv(tmp_path / "raw.csv", index=False)
    code = (
        "import sys; sys.modules['pyarrow'] = None; from swimid.cli.main import main; "
        f"main(['import', 'raw.csv', '-o', 'run.csv'], standalone_mode=False); "
        f"print({HEAVY!r} & {{name for name, module in sys.modules.items() if module}}, file=sys.stderr)"
    )
    command = [sys.executable, "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert run.stderr.splitlines()[-1] == "set()"
    assert "stroke" in run.stdout


@pytest.mark.parametrize("path", MODULES.values(), ids=list(MODULES))
def test_heavy_libraries_are_imported_where_they_are_used(path: Path) -> None:
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            names = {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        else:
            continue
        assert not names & {"pyarrow", "scipy.signal", "scipy.stats", "control"}


def test_every_warning_code_is_used_and_documented() -> None:
    source = "".join(p.read_text() for p in PACKAGE.rglob("*.py") if p.name != "notices.py")
    manual = (PACKAGE.parent / "docs" / "warnings.md").read_text()
    for code in notices.read_codes():
        assert code in source, f"{code} is never raised"
        assert code in manual, f"{code} is not in docs/warnings.md"
