"""Writing of files completely or not at all, singly or in groups, and locks of outputs."""

from __future__ import annotations

import os
import re
import signal
import tempfile
import threading
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.errors import InputError, UsageError, file_errors
from swimid.files import tabular

if TYPE_CHECKING:
    from filelock import BaseFileLock


def check_writable(path: str | Path, *, inputs: Iterable[object] = ()) -> Path:
    """Return the path after checking that it can be written without replacing an input.

    Parameters
    ----------
    path : path
    inputs : iterable
        Input files. Objects in memory are ignored.

    Raises
    ------
    InputError
        If the folder of the path does not exist or cannot be written.
    UsageError
        If the path is one of ``inputs``, or is a folder, or needs pyarrow and pyarrow is not installed.
    """
    path = Path(path)
    if path.suffix.lower() in tabular.PARQUET:
        tabular.pyarrow()
    folder = path.parent
    if not folder.is_dir():
        raise InputError(
            f"the output folder {folder} does not exist", file=path, hint=f"make it first: mkdir -p {folder}"
        )
    if path.is_dir():
        raise UsageError(f"the output {path} is a folder; name a file")
    if not os.access(folder, os.W_OK):
        raise InputError(f"the output folder {folder} cannot be written", file=path)
    for other in inputs:
        if isinstance(other, str | Path) and Path(other).exists() and path.exists() and path.samefile(other):
            raise UsageError(f"the output {path} is also an input; name another file")
    return path


def is_device(path: Path) -> bool:
    """Return whether the path is a device or a pipe, which is written directly and never replaced."""
    return path.exists() and not path.is_file()


@dataclass
class _Group:
    """Files that are written under temporary names and then renamed to their final names together."""

    temporaries: list[Path] = field(default_factory=list)
    #: Temporary name of each complete file, by its final name.
    pending: dict[Path, Path] = field(default_factory=dict)
    #: Files to remove, and folders that were created for this group.
    removed: list[Path] = field(default_factory=list)
    folders: list[Path] = field(default_factory=list)

    def commit(self) -> None:
        """Rename every file to its final name. Ctrl-C is delayed."""
        with _uninterrupted():
            try:
                for path, temporary in self.pending.items():
                    temporary.chmod(_mode(path))
                    temporary.replace(path)
                for path in self.removed:
                    path.unlink(missing_ok=True)
            except OSError as error:
                raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
            self.folders.clear()
            _WRITTEN.get([]).extend(self.pending)

    def discard(self) -> None:
        """Remove the temporary files that were not renamed, and the folders created for this group."""
        for temporary in self.temporaries:
            temporary.unlink(missing_ok=True)
        for folder in reversed(self.folders):
            with suppress(OSError):  # somebody else has put a file there
                folder.rmdir()


_GROUP: ContextVar[_Group | None] = ContextVar("_GROUP", default=None)
_WRITTEN: ContextVar[list[Path]] = ContextVar("_WRITTEN")


@contextmanager
def together() -> Iterator[_Group]:
    """Rename all files that are written in this block together, when the block ends without an error.

    After an error, no file is changed. A block inside another block is part of the outer block.

    Raises
    ------
    InputError
        If a file cannot be renamed.
    """
    outer = _GROUP.get()
    if outer is not None:
        yield outer
        return
    group = _Group()
    token = _GROUP.set(group)
    try:
        yield group
        group.commit()
    finally:
        _GROUP.reset(token)
        group.discard()


@contextmanager
def noted() -> Iterator[list[Path]]:
    """Yield a list of the files that have been written so far in this block."""
    written: list[Path] = []
    token = _WRITTEN.set(written)
    try:
        yield written
    finally:
        _WRITTEN.reset(token)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that replaces ``path`` when the block and its group end without an error.

    The temporary path has the ending of ``path``, because some writers choose their format by the ending. An
    exception, a full disk or Ctrl-C leaves the old file unchanged.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    path = check_writable(path)
    target = path
    if path.is_symlink():  # the link stays, and the file it points to is replaced
        target = Path(os.path.realpath(path))
    folder = None if is_device(path) else target.parent
    with file_errors(path, "written"), together() as group:
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=path.suffix, dir=folder)
        os.close(handle)
        temporary = Path(name)
        group.temporaries.append(temporary)
        yield temporary
        if folder is None:
            path.write_bytes(temporary.read_bytes())
        else:
            with temporary.open("r+b") as stream:
                os.fsync(stream.fileno())
            group.pending[target] = temporary


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8, complete or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def remove(path: Path) -> None:
    """Remove an obsolete file when the group of the file that replaces it ends without an error."""
    with together() as group:
        group.removed.append(path)


def make_folder(path: Path) -> None:
    """Create a folder for the files of a group. The folder is removed again if no file is written.

    Raises
    ------
    InputError
        If the folder cannot be created.
    """
    if path.is_dir():
        return
    with file_errors(path, "made"), together() as group:
        path.mkdir()
        group.folders.append(path)


@contextmanager
def on_interrupt(handle: Callable[[Callable[[], None]], object]) -> Iterator[None]:
    """Call ``handle`` on every Ctrl-C in the block, with the previous handler of Ctrl-C as its argument.

    Nothing changes outside the main thread, or if Ctrl-C is ignored.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    signal.signal(signal.SIGINT, lambda number, frame: handle(partial(before, number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Delay the effect of Ctrl-C until the block has ended."""
    received: list[Callable[[], None]] = []
    try:
        with on_interrupt(received.append):
            yield
    finally:
        if received:
            received[-1]()


def _mode(path: Path) -> int:
    """Return the permissions of a new file: those of the old file, or the default ones."""
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


# ---------------------------------------------------------------- one run at a time


@dataclass(eq=False)
class Lock:
    """Lock of an output: the file ``<output>.lock``, which names the process that holds the lock.

    A lock of a process that no longer runs is replaced. A thread can lock an output again that it has locked
    already, directly or through a run that failed.
    """

    file: BaseFileLock
    thread: threading.Thread = field(default_factory=threading.current_thread)
    holders: int = 1

    def release(self) -> None:
        """Release the lock once. The last release, one for each call of :func:`lock`, removes the file."""
        self.holders -= 1
        path = Path(self.file.lock_file)
        if self.holders == 0 and _HELD.get(path) is self:
            del _HELD[path]
            self.file.release()


#: Locks that this process holds, by the path of their file.
_HELD: dict[Path, Lock] = {}


def lock(output: Path) -> Lock:
    """Lock an output and return the lock.

    Raises
    ------
    UsageError
        If another run holds the lock.
    InputError
        If the lock cannot be written.
    """
    from filelock import SoftFileLock, Timeout  # the import takes 60 ms

    path = output.resolve().with_name(f"{output.name}.lock")
    own, thread = _HELD.get(path), threading.current_thread()
    if own is not None and (own.thread is thread or not own.thread.is_alive()):
        own.thread = thread
        own.holders += 1
        return own
    file = SoftFileLock(path, timeout=0, thread_local=False)
    with file_errors(output, "locked"):
        try:
            file.acquire()
        except Timeout:
            who = "another run of swimid"
            if file.pid is not None:
                who = f"{who} (process {file.pid})"
            raise UsageError(
                f"{output} is being written by {who}",
                hint=f"wait for it, or name another output; if no such run exists, delete {path}",
            ) from None
    _HELD[path] = Lock(file)
    return _HELD[path]


@contextmanager
def locked(output: Path | None) -> Iterator[None]:
    """Hold the lock of an output during the block. A device or a stream is not locked."""
    stored = output is not None and (output.is_file() or output.is_dir() or not output.exists())
    if output is None or not stored or str(output) == "-" or not os.access(output.parent, os.W_OK):
        yield
        return
    taken = lock(output)
    try:
        yield
    finally:
        taken.release()


# ---------------------------------------------------------------- file names


def file_names(ids: Sequence[str], endings: Sequence[str]) -> list[str]:
    """Return one file name for each id. The names are different files on every operating system.

    Characters other than letters, digits, ``_``, ``-`` and ``.`` become ``_``.

    Parameters
    ----------
    ids : sequence of str
        Distinct ids.
    endings : sequence of str
        Endings with their dot. The file names have the first ending. An id may have any of the endings.

    Raises
    ------
    UsageError
        If two ids have the same name. Upper and lower case are not distinguished, because many file systems
        ignore case.

    Examples
    --------
    >>> file_names(["run 1.csv", "day2/run 1"], [".csv", ".parquet"])
    ['run_1.csv', 'day2_run_1.csv']
    """
    names: dict[str, tuple[str, str]] = {}
    for one in ids:
        bare = next((one.removesuffix(e) for e in endings if one.endswith(e)), one)
        stem = re.sub(r"[^\w.-]", "_", unicodedata.normalize("NFC", bare))
        other, name = names.setdefault(stem.casefold(), (one, stem + endings[0]))
        if other != one:
            raise UsageError(
                f"'{other}' and '{one}' would both be written to the file {name}",
                hint="give them ids that differ in letters, digits, '_', '-' or '.'; capitals do not count",
            )
    return [name for _, name in names.values()]
