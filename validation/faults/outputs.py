"""Attack on outputs: hostile names, links, full disks, and folders that cannot be written."""

from __future__ import annotations

import os
import resource
import shutil
from functools import partial
from pathlib import Path

import numpy as np

from tests.conftest import SAMPLES
from validation.faults.runner import Attack, Finding, command

LOG = SAMPLES / "rig" / "w10.csv"
NAMES = [
    "x" * 247, "x" * 251, "x" * 300, "a b", "a\nb", "-o", "--", "%s", "{}", "$(x)", "ü" * 120,
    "\u202ea", "a'b\"", "=1+1", "CON", ".", "..", "a/b", "/proc/x",
    "\ud800", "\udcff", "🐟", "#", "~",
]  # fmt: skip
COMMANDS = [
    ["plot", str(LOG), "-o", "OUT.svg"],
    ["import", str(LOG), "-o", "OUT.csv"],
    ["import", str(LOG), "-o", "OUT.parquet"],
    ["track", "imu", str(LOG), "-o", "OUT.csv"],
    ["schema", "gap", "-o", "OUT.json"],
    ["simulate", "--robot", "tfish", "--frequency-hz", "1", "--amplitude-deg", "20", "--duration-s", "1",
     "-o", "OUT.csv"],
]  # fmt: skip


def _clean(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _words(rng: np.random.Generator, name: str) -> list[str]:
    words = COMMANDS[int(rng.integers(len(COMMANDS)))]
    return [word.replace("OUT", name) for word in words]


def _check_whole(folder: Path, before: set[str], status: int) -> None:
    """Raise a finding if a failed command left files, or any command left temporary files."""
    left = {path.name for path in folder.iterdir()} - before
    if (status and left) or any(name.startswith(".") and len(name) > 9 for name in left):
        raise Finding(f"status {status} leaves {sorted(left)}")


def _name(rng: np.random.Generator, folder: Path) -> bool:
    _clean(folder)
    status, _ = command(*_words(rng, str(rng.choice(NAMES))))
    _check_whole(folder, set(), status) if status else None
    return status == 0


def _full(rng: np.random.Generator, folder: Path) -> bool:
    """Limit the size of files, as a full disk does, while an older file is replaced."""
    _clean(folder)
    words = _words(rng, "out")
    old = folder / words[-1]
    old.write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(rng.integers(0, 4000)), limits[1]))
    try:
        status, _ = command(*words, "--force")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    _check_whole(folder, {old.name}, status)
    if status and old.read_bytes() != b"old":
        raise Finding(f"status {status} changes the old file")
    return status == 0


def _read_only(rng: np.random.Generator, folder: Path) -> bool:
    """Write to a folder without permission. The administrator has none for a folder of the kernel."""
    _clean(folder)
    inner = folder / "closed"
    inner.mkdir(mode=0o555)
    if os.geteuid() == 0:
        inner = Path("/sys/kernel")
    before = {path.name for path in inner.iterdir()}
    status, _ = command(*_words(rng, str(inner / "out")))
    _check_whole(inner, before, status)
    if status == 0:
        raise Finding("writes to a folder without permission")
    return False


def _link(rng: np.random.Generator, folder: Path, *, dangling: bool) -> bool:
    """Write to a symbolic link: the link stays, and its target is written."""
    _clean(folder)
    words = _words(rng, "out")
    link, target = folder / words[-1], folder / f"target{Path(words[-1]).suffix}"
    if not dangling:
        target.write_bytes(b"old")
    link.symlink_to(target)
    status, _ = command(*words, "--force")
    if not link.is_symlink() or (status == 0 and target.read_bytes() == b"old"):
        raise Finding(f"status {status}: the link is replaced, or its target is not written")
    return status == 0


ATTACKS = [
    Attack("output: hostile name", _name, count=300, time_s=90.0),
    Attack("output: full disk", _full, count=300, time_s=90.0),
    Attack("output: folder without permission", _read_only, count=100, time_s=90.0),
    Attack("output: link", partial(_link, dangling=False), count=30, time_s=90.0),
    Attack("output: dangling link", partial(_link, dangling=True), count=30, time_s=90.0),
]
