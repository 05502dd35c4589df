"""Attack with small files that expand, and with inputs that have no end."""

from __future__ import annotations

import itertools
import json
import os
import resource
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from tests.test_isolated import _hdf5, _mat, _parquet, _xlsx
from validation.faults.runner import Attack, Finding, command

#: Maximum growth of the memory of a process while it refuses a file, kB.
MAX_GROWTH_KB = 2_000_000


def _aliases(depth: int) -> str:
    names = [f"a{k}" for k in range(depth)]
    rows = [f"&{new} [{','.join([f'*{old}'] * 9)}]" for old, new in itertools.pairwise(names)]
    return f"[&a0 [1,1,1,1,1,1,1,1,1], {', '.join(rows)}]"


def _log(path: Path) -> None:
    path.write_text(f"# key: {_aliases(12)}\nt_s,x_m\n0,0\n1,1\n")


def _yaml(path: Path) -> None:
    path.write_text(f"format: swimid-parameters/1\nmodel: {_aliases(12)}\n")


def _nested(path: Path) -> None:
    path.write_text("[" * 100_000)


def _wide(path: Path) -> None:
    names = ",".join(f"c{k}_m" for k in range(5000))
    path.write_text(f"t_s,{names}\n0{',1' * 5000}\n1{',2' * 5000}\n2{',4' * 5000}\n")


def _lines(path: Path) -> None:
    path.write_text("".join(json.dumps({f"k{k}": 1.0 for k in range(20)}) + "\n" for _ in range(20_000)))


def _attempt(
    rng: np.random.Generator, folder: Path, *, name: str, make: Callable[[Path], object], words: list[str]
) -> bool:
    path = Path(name)
    if not path.is_absolute():
        path = folder / name
        path.unlink(missing_ok=True)
        make(path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    status, messages = command(*[str(path) if word == "FILE" else word for word in words])
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    if growth > MAX_GROWTH_KB:
        raise Finding(f"takes {growth} kB of memory")
    if status not in (0, 2, 3):
        raise Finding(f"status {status}: {messages}")
    return status == 0


_PLOT, _IMPORT = ["plot", "FILE", "-o", "p.svg", "--force"], ["import", "FILE", "-o", "i.csv", "--force"]
_REPORT = ["report", "FILE", "-o", "r.html", "--force"]
#: File name, maker and command of each bomb.
BOMBS: list[tuple[str, Callable[[Path], object], list[str]]] = [
    ("b.mat", _mat, _IMPORT),
    ("b.h5", _hdf5, _IMPORT),
    ("b.parquet", _parquet, _IMPORT),
    ("b.parquet", _parquet, _PLOT),
    ("b.xlsx", _xlsx, _IMPORT),
    ("b.csv", _log, _PLOT),
    ("b.csv", _log, _IMPORT),
    ("b.yaml", _yaml, _REPORT),
    ("b.yaml", _nested, _REPORT),
    ("b.json", _nested, _IMPORT),
    ("wide.csv", _wide, _PLOT),
    ("b.jsonl", _lines, _IMPORT),
    ("pipe.csv", os.mkfifo, _PLOT),
    ("pipe.mat", os.mkfifo, _IMPORT),
    ("pipe.yaml", os.mkfifo, _REPORT),
    ("/dev/zero", os.mkfifo, _PLOT),
    ("/dev/zero", os.mkfifo, _IMPORT),
]

ATTACKS = [
    Attack(
        f"bomb: {words[0]} {name}", partial(_attempt, name=name, make=make, words=words), count=1, time_s=90.0
    )
    for name, make, words in BOMBS
]
