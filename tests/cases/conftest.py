"""Fixtures for the recorded inputs in the folder ``cases`` of ``SWIMID_DATA``."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def case(real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Copy one folder of inputs, run its scripts, and make it the working folder.

    ``case("r-import-steps", "make.py")`` runs ``make.py`` in the copy. A script with arguments is a tuple:
    ``("make.py", "3", "1")``.
    """

    def prepare(name: str, *scripts: str | tuple[str, ...]) -> Path:
        source = real_data / "cases" / name
        if not source.is_dir():
            pytest.skip(f"no folder {name} among the recorded inputs")
        folder = tmp_path / name
        shutil.copytree(source, folder, copy_function=shutil.copyfile)
        folder.chmod(0o755)
        for path in folder.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)
        for script in scripts:
            words = (script,) if isinstance(script, str) else script
            subprocess.run([sys.executable, *words], cwd=folder, check=True, capture_output=True)
        monkeypatch.chdir(folder)
        return folder

    return prepare
