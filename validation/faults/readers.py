"""Attack on every reader: valid files with bytes changed, removed, inserted, repeated or cut off."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from swimid.imports import mapping
from swimid.imports.formats import open_table
from tests.conftest import SAMPLES
from tests.test_fuzz_import import KINDS
from tests.test_fuzz_readers import FORMATS, ODD_CELLS, ODD_SCALARS
from tests.test_import import FILES
from tests.test_import_formats import _c3d, _coco, _motive, _tdms
from validation.faults.runner import Attack, command, mutated
from validation.faults.signals import drag_parameters

PIECES = ODD_CELLS + ODD_SCALARS


def _read(
    rng: np.random.Generator, folder: Path, valid: bytes, name: str, read: Callable[[Path], Any]
) -> bool:
    path = folder / name
    path.write_bytes(mutated(valid, rng, PIECES))
    read(path)
    return True


def _import(
    rng: np.random.Generator, folder: Path, make: Callable[[Path], object], name: str, topic: str
) -> bool:
    path = folder / name
    path.write_bytes(mutated(_made(name, make), rng, PIECES))
    open_table(path, select=topic or None)
    mapping.apply(None, path, {"select": topic} if topic else {})
    return True


@cache
def _made(name: str, make: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


#: File, maker and topic of foreign formats.
FOREIGN: list[tuple[str, Callable[[Path], object], str]] = [
    *((name, make, KINDS.get(kind, "")) for kind, (name, make, _, _) in FILES.items()),
    ("a.c3d", lambda path: _c3d(path, "+Y", analog=True), "points"),
    ("a.tdms", _tdms, "balance"),
    ("motive.csv", lambda path: _motive(path, "Quaternion"), ""),
    ("coco.json", lambda path: path.write_text(json.dumps(_coco())), ""),
]


def _plan(rng: np.random.Generator, folder: Path, valid: bytes) -> bool:
    """Give a damaged trials file to the command that reads it; its logs are short."""
    for log in (SAMPLES / "rig").glob("*.csv"):
        (folder / log.name).write_bytes(b"\n".join(log.read_bytes().splitlines()[:60]) + b"\n")
    (folder / "trials.yaml").write_bytes(mutated(valid, rng, PIECES))
    (folder / "drag.yaml").write_bytes(drag_parameters())
    return command("compare", "trials.yaml", "--params", "drag.yaml")[0] == 0


ATTACKS = [
    *(
        Attack(f"reader: {name}", partial(_read, valid=valid, name=f"x{ending}", read=read))
        for name, (ending, read, valid) in FORMATS.items()
    ),
    *(
        Attack(f"import: {name}", partial(_import, make=make, name=name, topic=topic))
        for name, make, topic in FOREIGN
    ),
    Attack("plan: trials", partial(_plan, valid=(SAMPLES / "rig" / "trials.yaml").read_bytes())),
]
