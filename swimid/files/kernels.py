"""The compiler numba, with a cache folder for compiled functions (kernels) to which nobody else can write.

Numba executes the machine code in its cache folder. Every module that compiles functions imports numba from
this module. The cache folder is ``NUMBA_CACHE_DIR`` or, if this is not set, the folders beside the modules.
Only this user and the administrator may be able to write to it, and its disk must have space. If not, the
cache folder of the user is used, or a temporary folder that is removed at the end of the process.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from swimid.notices import warn

#: Minimum free space on the disk of the cache folder, bytes. All compiled functions together need less.
MIN_FREE_BYTES = 50 << 20
_VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE_ROOT = Path(__file__).parents[1]


def find_fault(folder: Path) -> str:
    """Return the reason why a folder must not hold compiled functions, as message text; empty if none.

    For a folder that does not exist, the nearest existing folder above it is examined.
    """
    try:
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        about = folder.stat()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return f"cannot be used: {error.strerror or error}"
    if hasattr(os, "getuid"):
        if about.st_uid not in (os.geteuid(), 0):
            return "belongs to another user"
        for place in (folder.resolve(), *folder.resolve().parents):
            about = place.stat()
            # Accept a parent folder with the sticky bit, in which only the owner can rename or replace a
            # folder.
            if place != folder.resolve() and about.st_mode & stat.S_ISVTX:
                continue
            if about.st_mode & stat.S_IWOTH:
                return "can be written by other users"
            if about.st_mode & stat.S_IWGRP and not _is_private(about.st_gid, about.st_uid):
                return "can be written by other users of its group"
    if not os.access(folder, os.W_OK):
        return "cannot be written"
    if free < MIN_FREE_BYTES:
        return f"has {free >> 20} MB of free space; {MIN_FREE_BYTES >> 20} MB are needed"
    return ""


def _is_private(group: int, user: int) -> bool:
    """Return whether a group is private: it has the name of the user and no other members."""
    import grp
    import pwd

    with suppress(KeyError):
        found, name = grp.getgrgid(group), pwd.getpwuid(user).pw_name
        return found.gr_name == name and not set(found.gr_mem) - {name}
    return False


def _find_faults(folders: Iterable[Path]) -> str:
    """Return the first fault of several folders, with the name of the folder; empty if there is none."""
    faults = ((folder, find_fault(folder)) for folder in folders)
    return next((f"{folder} {fault}" for folder, fault in faults if fault), "")


def own_cache() -> Path:
    """Return the cache folder of the user for the kernels of swimid."""
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "swimid"


def remove_cache() -> int:
    """Remove the compiled kernels beside the modules and in the cache folder of the user.

    Kernels in ``NUMBA_CACHE_DIR`` stay, because other programs may share this folder.

    Returns
    -------
    int
        Number of bytes that were freed.
    """
    files = [path for path in _PACKAGE_ROOT.rglob("__pycache__/**/*") if path.suffix in (".nbi", ".nbc")]
    files += _PACKAGE_ROOT.rglob("__pycache__/lanes/*.py")
    files += (path for path in own_cache().rglob("*") if path.is_file())
    freed = 0
    for path in set(files):
        freed += path.stat().st_size
        path.unlink()
    for folder in (*_PACKAGE_ROOT.rglob("__pycache__/lanes"), own_cache()):
        shutil.rmtree(folder, ignore_errors=True)
    return freed


def choose_cache() -> None:
    """Set the environment variable of numba's cache folder, if the default folders must not be used.

    Warns
    -----
    SWM152
        No folder can be used, so that every command compiles its kernels again.
    """
    stated = os.environ.get(_VARIABLE)
    if stated:
        fault = _find_faults([Path(stated)])
    else:
        beside = {path.parent / "__pycache__" for path in _PACKAGE_ROOT.rglob("*.py")}
        fault = _find_faults([*beside, *(folder / "lanes" / "__pycache__" for folder in beside)])
    if not fault:
        return
    own = own_cache()
    if not stated and own.is_absolute() and not find_fault(own):
        os.environ[_VARIABLE] = str(own)
        return
    temporary = tempfile.mkdtemp(prefix="swimid-kernels-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    os.environ[_VARIABLE] = temporary
    text = f"{fault}; kernels are compiled again by every command"
    warn("SWM152", f"{text}. Set {_VARIABLE} to a folder to which only you can write")


choose_cache()

import numba  # noqa: E402 - numba reads the variable when it is imported

numba.config.reload_config()

__all__ = ["choose_cache", "find_fault", "numba", "own_cache", "remove_cache"]
