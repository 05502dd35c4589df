"""The points of a Pareto front as a CSV: ``index``, ``profile``, coefficients, objectives.

An objective's column is called ``KIND[PROFILE]``; nothing else in the header has brackets.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files import atomic


@dataclass(frozen=True)
class FrontFile:
    """Points and what each is worth.

    Attributes
    ----------
    coefficients : list of str, length d
    objectives : list of (str, str), length m
        Profile and kind.
    profiles : list of str, length n
        On whose front a point lies.
    points : ndarray, shape (n, d)
    values : ndarray, shape (n, m)
    """

    coefficients: list[str]
    objectives: list[tuple[str, str]]
    profiles: list[str]
    points: NDArray[np.float64]
    values: NDArray[np.float64]


def beside(output: Path) -> Path:
    """Where the front of a parameter file is kept."""
    return output.with_name(f"{output.stem}.front.csv")


def write(path: Path, front: FrontFile) -> None:
    """Write a front, whole or not at all."""
    table = pd.DataFrame({"index": np.arange(len(front.points)), "profile": front.profiles})
    for j, name in enumerate(front.coefficients):
        table[name] = front.points[:, j]
    for j, (profile, kind) in enumerate(front.objectives):
        table[f"{kind}[{profile}]"] = front.values[:, j]
    atomic.write_text(path, table.to_csv(index=False))


def read(path: Path) -> FrontFile:
    """Read a front.

    Raises
    ------
    InputError
        For a file that is none.
    """
    try:
        table = pd.read_csv(path, dtype={"profile": str})
    except FileNotFoundError as error:
        raise InputError("there is no such file", file=path) from error
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"is no table: {error}", file=path) from error
    names = [str(c) for c in table.columns]
    scored = [n for n in names if n.endswith("]") and "[" in n]
    points = [n for n in names[2:] if n not in scored]
    if names[:2] != ["index", "profile"] or not scored or not points or table.empty:
        raise InputError(
            "holds no front: its columns are index, profile, coefficients, and objectives such as "
            "position[characteristic]",
            file=path,
            hint="give the .front.csv that an earlier --method nsga2 or hybrid wrote",
        )
    for column in [*points, *scored]:
        bad = np.flatnonzero(~np.isfinite(pd.to_numeric(table[column], errors="coerce").to_numpy()))
        if len(bad):
            raise InputError("holds no number", file=path, line=int(bad[0]) + 2, column=column)
    split = [n[:-1].split("[", 1) for n in scored]
    return FrontFile(
        points,
        [(profile, kind) for kind, profile in split],
        table["profile"].astype(str).tolist(),
        table[points].to_numpy(dtype=float),
        table[scored].to_numpy(dtype=float),
    )
