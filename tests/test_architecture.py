"""The picture in docs/architecture.md, held to: imports run one way, and --help stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from swimid import notices

PACKAGE = Path(notices.__file__).parent
#: The rooms from the ground up: each imports from itself and from those of the rows before its own.
LEVELS = (
    {"errors", "notices", "progress"},
    {"files"},
    {"results", "robots"},
    {"logs"},
    {"tracking", "inertial", "fitting"},
    {"rig", "propulsion", "swimmer", "blackbox", "effects"},
    {"simulation", "exporters"},
    {"diagnosis", "sensitivity_analysis"},
    {"cli"},
)
LEVEL = {room: level for level, rooms in enumerate(LEVELS) for room in rooms}


def _modules() -> list[Path]:
    return [p for p in PACKAGE.rglob("*.py") if p.parent != PACKAGE]


@pytest.mark.parametrize("path", _modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0]
    for node in ast.walk(ast.parse(path.read_text())):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        if isinstance(node, ast.ImportFrom) and node.module == "swimid":
            names = [f"swimid.{alias.name}" for alias in node.names]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            if name.startswith("swimid."):
                other = name.split(".")[1]
                below = other == room or LEVEL[other] < LEVEL[room]
                assert below, f"{path}: {room} may not import {name}"


def test_every_room_is_in_the_picture() -> None:
    rooms = {p.name for p in PACKAGE.iterdir() if (p / "__init__.py").exists()}
    assert rooms == set(LEVEL) - LEVELS[0]


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


def test_every_warning_code_is_used_and_documented() -> None:
    source = "".join(p.read_text() for p in PACKAGE.rglob("*.py") if p.name != "notices.py")
    manual = (PACKAGE.parent / "docs" / "warnings.md").read_text()
    for code in notices.CODES:
        assert code in source, f"{code} is never raised"
        assert code in manual, f"{code} is not in docs/warnings.md"
