"""The picture in docs/architecture.md, held to: imports run one way, and --help stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from swimid import notices

PACKAGE = Path(notices.__file__).parent
#: What each layer may import, itself included.
BASE = {"errors", "notices", "progress"}
ALLOWED = {
    "errors": set(),
    "notices": set(),
    "progress": set(),
    "formats": {"formats", *BASE},
    "signals": {"signals", "formats", *BASE},
    "models": {"models", "signals", "formats", *BASE},
    "estimators": {"estimators", "models", "signals", "formats", *BASE},
    "effects": {"effects", "models", "signals", "formats", *BASE},
    "diagnosis": {"diagnosis", "effects", "estimators", "models", "signals", "formats", *BASE},
    "tracking": {"tracking", "signals", "formats", *BASE},
    "inertial": {"inertial", "signals", "formats", *BASE},
    "reporting": {"reporting", "signals", "formats", *BASE},
    "experiments": {"experiments", "estimators", "models", "signals", "formats", *BASE},
    "exporters": {"exporters", "models", "signals", "formats", *BASE},
    "robots": set(),
}
ALLOWED["verbs"] = {
    "verbs",
    *ALLOWED["experiments"],
    "tracking",
    "inertial",
    "reporting",
    "exporters",
    "effects",
    "diagnosis",
}
ALLOWED["cli"] = {"cli", "verbs", "formats", *BASE}


def _modules() -> list[Path]:
    return [p for p in PACKAGE.rglob("*.py") if p.parent != PACKAGE]


@pytest.mark.parametrize("path", _modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    layer = path.relative_to(PACKAGE).parts[0]
    for node in ast.walk(ast.parse(path.read_text())):
        names = [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        if isinstance(node, ast.ImportFrom) and node.module == "swimid":
            names = [f"swimid.{alias.name}" for alias in node.names]
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            if name.startswith("swimid."):
                imported = name.split(".")[1]
                assert imported in ALLOWED[layer], f"{path}: {layer} may not import {name}"


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
