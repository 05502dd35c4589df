"""Logs and trials files as a user writes them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np


def write_log(path: Path, columns: Mapping[str, Any], digits: str = "%.10g", head: str = "") -> None:
    """Write a log of columns, each of shape (n,), below lines of metadata."""
    header = head + ",".join(columns)
    np.savetxt(path, np.column_stack(list(columns.values())), digits, ",", header=header, comments="")


def write_trials(path: Path, experiment: str, robot: str | Path, trials: Iterable[str], **keys: str) -> Path:
    """Write a trials file and return its path; a trial is the inside of a mapping in YAML."""
    keys = {"format": "swimid-trials/1", "experiment": experiment, "robot": str(robot), **keys}
    lines = [f"{name}: {value}" for name, value in keys.items()]
    path.write_text("\n".join([*lines, "trials:", *(f"  - {{{trial}}}" for trial in trials)]) + "\n")
    return path
