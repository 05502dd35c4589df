"""Functions that write files completely or not at all, lock outputs, and store checkpoints.

A lock stops two processes from writing the same output. A checkpoint is a file next to the output with the
intermediate results of a long computation (``docs/formats.md``).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import socket
import tempfile
import threading
import unicodedata
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import swimid
from swimid.errors import InputError, UsageError, file_errors
from swimid.files import tabular
from swimid.notices import warn

if TYPE_CHECKING:
    import numpy as np
    from filelock import BaseFileLock
    from numpy.typing import NDArray


def check_writable(path: str | Path, *, inputs: Iterable[object] = ()) -> Path:
    """Check that an output path can be written and is not the path of an input, and return the path.

    Parameters
    ----------
    path : path
        Path of the output file.
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
    if path.suffix.lower() in tabular.PARQUET_ENDINGS:
        tabular.pyarrow()
    folder = path.parent
    if folder.is_file():
        raise InputError(f"{folder} is a file and no folder", file=path, hint="name another output")
    if not folder.is_dir():
        raise InputError(
            f"the output folder {folder} does not exist", file=path, hint=f"make it: mkdir -p {folder}"
        )
    if path.is_dir():
        raise UsageError(f"the output {path} is a folder; name a file")
    if not os.access(folder, os.W_OK):
        raise InputError(f"you may not write to the output folder {folder}", file=path)
    for other in inputs:
        if isinstance(other, str | Path) and Path(other).exists() and path.exists() and path.samefile(other):
            raise UsageError(f"the output {path} is also an input; name another file")
    return path


def is_device(path: Path) -> bool:
    """Return whether a path is a device or a pipe, and not a file that a temporary file can replace."""
    return path.exists() and not path.is_file()


@dataclass
class _Group:
    """Group of output files that are written under temporary names and then renamed together."""

    #: Temporary path of each output file by its final path; None for a file that will be removed.
    pending: dict[Path, Path | None] = field(default_factory=dict)
    #: Callbacks that remove leftover temporary files and new empty folders after the files are renamed.
    cleanup: ExitStack = field(default_factory=ExitStack)

    def commit(self) -> None:
        """Rename all temporary files of the group to their final names.

        Ctrl-C takes effect after the renaming. An error restores all files that were already renamed.
        """
        backups: dict[Path, Path] = {}
        done: list[Path] = []
        with _delay_interrupt():
            try:
                for path in self.pending:
                    if len(self.pending) > 1 and path.exists():
                        backups[path] = _second_name(path)
                for path, temporary in self.pending.items():
                    if temporary is None:
                        path.unlink(missing_ok=True)
                        continue
                    if path.exists():
                        shutil.copymode(path, temporary)
                    temporary.replace(path)
                    done.append(path)
            except OSError as error:
                for undone in {*done, *backups}:
                    with suppress(OSError):
                        if undone in backups:
                            backups[undone].replace(undone)
                        else:
                            undone.unlink()
                raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
            finally:
                for spare in backups.values():
                    spare.unlink(missing_ok=True)
            _WRITTEN.get([]).extend(done)


_GROUP: ContextVar[_Group | None] = ContextVar("_GROUP", default=None)
_WRITTEN: ContextVar[list[Path]] = ContextVar("_WRITTEN")


@contextmanager
def write_together() -> Iterator[_Group]:
    """Write all output files of a ``with`` block together, or none of them.

    The files are renamed to their final names when the block ends without an error. After an error, no file
    is changed. The files of a block inside another block are renamed at the end of the outer block.

    Raises
    ------
    InputError
        If a file cannot be renamed. Files that were already renamed are restored.
    """
    outer = _GROUP.get()
    if outer is not None:
        yield outer
        return
    group = _Group()
    token = _GROUP.set(group)
    try:
        with group.cleanup:
            yield group
            group.commit()
    finally:
        _GROUP.reset(token)


@contextmanager
def record_writes() -> Iterator[list[Path]]:
    """Yield a list to which each file that is written in the ``with`` block is added."""
    written: list[Path] = []
    token = _WRITTEN.set(written)
    try:
        yield written
    finally:
        _WRITTEN.reset(token)


@contextmanager
def replace_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to write, and replace ``path`` by it when the ``with`` block ends without error.

    Inside a block of :func:`write_together`, the file is replaced at the end of that block. The temporary
    path has the extension of ``path``, because some writers choose their format by the extension. An
    exception, a full disk or Ctrl-C leaves the old file unchanged.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = check_writable(path)
    target = path
    if path.is_symlink():  # Keep a symbolic link, and replace the file to which it points.
        target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.stem}-{uuid4().hex[:8]}{path.suffix}")
    if is_device(path):
        temporary = Path(tempfile.gettempdir()) / temporary.name
    with file_errors(path, "written"), write_together() as group:
        temporary.touch(exist_ok=False)
        group.cleanup.callback(temporary.unlink, missing_ok=True)
        yield temporary
        if is_device(path):
            path.write_bytes(temporary.read_bytes())
        else:
            with temporary.open("r+b") as stream:
                os.fsync(stream.fileno())
            group.pending[target] = temporary


def write_text(path: str | Path, text: str) -> None:
    """Write a text to a file in UTF-8, completely or not at all."""
    with replace_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def remove(path: Path) -> None:
    """Remove an obsolete file when the current block of :func:`write_together` ends without an error.

    Outside of such a block the file is removed at once.
    """
    with write_together() as group:
        group.pending[path] = None


def make_folder(path: Path) -> None:
    """Create a folder for output files, and remove it again if no file is written to it.

    An unused folder is removed at the end of the current block of :func:`write_together`.

    Raises
    ------
    InputError
        If the folder cannot be created.
    """
    if path.is_dir():
        return
    with file_errors(path, "made"), write_together() as group:
        path.mkdir()
        group.cleanup.callback(_remove_empty, path)


def check_empty(folder: Path, *, force: bool = False) -> None:
    """Check that a folder for output files is new or empty, or with ``force`` that it is a folder.

    Raises
    ------
    UsageError
        If the path is a file, or a folder with content.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"the output {folder} is a file", hint="name a folder")
    if not force and folder.is_dir() and any(folder.iterdir()):
        hint = "name a new folder, or give --force to replace files of the same names"
        raise UsageError(f"the folder {folder} is not empty", hint=hint)


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):  # The operating system refuses to remove a folder that contains files.
        folder.rmdir()


@contextmanager
def on_interrupt(handle: Callable[[Callable[[], None]], object]) -> Iterator[None]:
    """Call a function on every Ctrl-C during the ``with`` block instead of the previous handler of Ctrl-C.

    The function ``handle`` gets the previous handler as its argument. Outside the main thread, and in a
    process that ignores Ctrl-C, nothing changes.
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
def _delay_interrupt() -> Iterator[None]:
    """Delay the effect of Ctrl-C until the ``with`` block has ended."""
    received: list[Callable[[], None]] = []
    try:
        with on_interrupt(received.append):
            yield
    finally:
        if received:
            received[-1]()


def _second_name(path: Path) -> Path:
    """Make a hidden backup of a file in the same folder, and return the path of the backup."""
    spare = path.with_name(f".{path.stem}-{uuid4().hex[:8]}.before")
    try:
        os.link(path, spare)
    except OSError:  # Copy the file if the file system has no hard links.
        shutil.copy2(path, spare)
    return spare


# ---------------------------------------------------------------- one run at a time


#: Locks on output files that this process holds, each with the thread that acquired the lock last. The key is
#: the path of the lock file. This reference to a lock protects it from being deleted and so released.
_TAKEN: dict[Path, tuple[BaseFileLock, threading.Thread]] = {}


def lock(output: Path) -> BaseFileLock:
    """Lock an output file against other processes by creating the file ``<output>.lock``.

    The lock file names the process that holds the lock. A lock of a process that no longer runs is replaced.
    A thread can lock an output again that it has locked already, for instance in a command that failed. Each
    call needs a release of its own, and the last release removes the lock file.

    Raises
    ------
    UsageError
        If another process or thread holds the lock.
    InputError
        If the lock cannot be written.
    """
    from filelock import SoftFileLock, Timeout  # Import filelock only when needed, because it takes 60 ms.

    path = output.resolve().with_name(f"{output.name}.lock")
    file = SoftFileLock(path, timeout=0, thread_local=False, is_singleton=True)
    thread = threading.current_thread()
    holder = _TAKEN.get(path, (file, thread))[1]
    with file_errors(output, "locked"):
        if not file.is_locked and _has_ended(file.pid):
            path.unlink(missing_ok=True)
        try:
            if file.is_locked and holder is not thread and holder.is_alive():
                raise Timeout(str(path))
            file.acquire()
        except Timeout:
            raise UsageError(
                f"{output} is being written by another run of swimid ({holder_of(path)})",
                hint=f"wait for it, or name another output; if no such run exists, delete {path}",
            ) from None
    _TAKEN[path] = file, thread
    return file


def holder_of(path: Path) -> str:
    """Return the process that holds a lock file, as ``process 7 on node1``; empty without lock or process.

    A process on another machine always counts as a holder, because it is unknown whether this process runs.
    """
    try:
        number, host, *_ = [*path.read_text(errors="replace").split(), "", ""]
    except OSError:
        return ""
    if not number.isdecimal() or not host:
        return "an unknown process"
    if host == socket.gethostname() and os.name == "posix":
        try:
            os.kill(int(number), 0)
        except PermissionError:
            pass  # The process belongs to another user.
        except (OSError, OverflowError):
            return ""
        if _has_ended(int(number)):
            return ""
    return f"process {number} on {host}"


def _has_ended(process: int | None) -> bool:
    """Return whether a process has ended although its number is in use.

    A killed process keeps its number until its parent process notices. In a container without an init
    process this may be never. The state of a process is known only on Linux.
    """
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (OSError, IndexError):
        return False
    return state in ("Z", "X")


@contextmanager
def hold_lock(output: Path | None) -> Iterator[None]:
    """Lock an output file against other processes during the ``with`` block.

    A device, the standard output, and a file in a folder that cannot be written are not locked.
    """
    with ExitStack() as stack:
        if output is not None and _is_lockable(output):
            stack.callback(lock(output).release)
        yield


def _is_lockable(output: Path) -> bool:
    if str(output) == "-" or (is_device(output) and not output.is_dir()):
        return False
    return output.parent.is_dir() and os.access(output.parent, os.W_OK)


# ---------------------------------------------------------------- checkpoints

#: Number of hexadecimal digits of the key in a line of a checkpoint file.
DIGITS = 32


def checkpoint_path(output: Path) -> Path:
    """Return the path of the checkpoint file of an output: ``map.yaml.partial`` for ``map.yaml``."""
    return output.with_name(f"{output.name}.partial")


class Checkpoint:
    """Checkpoint file with the intermediate results of a long computation.

    Each intermediate result is an array of numbers with a name. It is stored as one JSON line
    ``{"key": ..., "name": ..., "values": [...]}``. The key is the SHA-256 of the name and of the inputs and
    settings of the computation. A line that is not of this form is damaged. A line with another key belongs
    to a computation with other inputs or settings. Damaged lines and lines with another key are ignored. The
    lines with another key stay in the file.

    Parameters
    ----------
    path : Path or None
        Checkpoint file. None stores nothing.
    key : str
        SHA-256 of the inputs and settings that determine the results.

    Raises
    ------
    UsageError
        If another process or thread holds the lock of the output, or if the file is not a checkpoint.
    InputError
        If the file cannot be read or written.

    Warns
    -----
    SWM150
        Lines are ignored.
    SWM151
        A result cannot be stored, for instance because the disk is full.
    """

    def __init__(self, path: Path | None = None, key: str = "") -> None:
        self.path = path
        self._key = key
        self._known: dict[str, list[float]] = {}
        #: Lines of the checkpoint file that belong to computations with other inputs or settings.
        self._others: list[str] = []
        self._writing = threading.Lock()
        self._full = False
        if path is None:
            return
        check_writable(path)
        # Release the lock of the output when the checkpoint object is deleted, so that it is released also
        # after a failed computation.
        self._release = weakref.finalize(self, lock(path.with_suffix("")).release)
        with file_errors(path, noted=False):
            self._read(path)

    @classmethod
    def of_output(cls, output: Path | None, belongs_to: Any) -> Checkpoint:
        """Return the checkpoint of an output file for one computation.

        The key of the checkpoint is computed from ``belongs_to``, the inputs and settings of the computation,
        and the version of swimid. Without an output, nothing is stored.
        """
        text = json.dumps([belongs_to, swimid.__version__], sort_keys=True)
        path = output and checkpoint_path(output)
        return cls(path, hashlib.sha256(text.encode()).hexdigest())

    def get(self, name: str) -> NDArray[np.float64] | None:
        """Return the stored intermediate result with the given name; None if the checkpoint has none."""
        if name not in self._known:
            return None
        import numpy as np

        return np.array(self._known[name], dtype=float)

    def put(self, name: str, values: NDArray[np.float64]) -> None:
        """Append an intermediate result with its name to the checkpoint file."""
        if self.path is None:
            return
        key, listed = self._key_of(name), [float(v) for v in values]
        line = {"key": key, "name": name, "values": listed}
        with self._writing:
            try:
                with self.path.open("a", encoding="utf-8") as stream:
                    # Begin with a line feed after a failed write, because the last line may be incomplete.
                    stream.write("\n" * self._full + json.dumps(line) + "\n")
            except OSError as error:
                if not self._full:
                    warn("SWM151", f"{self.path} cannot be written: {error.strerror or error}")
                self._full = True

    def get_or_compute(self, name: str, compute: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the intermediate result with the given name, from the checkpoint if it is stored there.

        If the checkpoint lacks the result, call ``compute`` and store what it returns.
        """
        values = self.get(name)
        if values is None:
            values = compute()
            self.put(name, values)
        return values

    def finish(self) -> None:
        """Remove the intermediate results of this computation from the checkpoint file.

        Call this method after the result is written. Lines of other computations stay in the file. A file
        without lines is removed.
        """
        if self.path is None:
            return
        if self._others:
            with record_writes():  # Hide this write from the list of outputs of the command.
                write_text(self.path, "".join(f"{line}\n" for line in self._others))
        else:
            self.path.unlink(missing_ok=True)
        self._release()

    def _key_of(self, name: str) -> str:
        return hashlib.sha256(f"{self._key}\n{name}".encode()).hexdigest()[:DIGITS]

    def _read(self, path: Path) -> None:
        """Read the results of this computation from the checkpoint file.

        Keep the lines of other computations, count damaged lines, and warn of both.
        """
        raw = b""
        if path.is_file():
            raw = path.read_bytes()
        lines = [line.decode("utf-8", "replace") for line in raw.splitlines() if line.strip()]
        if lines and not lines[0].startswith('{"key"'):
            raise UsageError(f"{path} is not a checkpoint of swimid", hint="move it away, or delete it")
        damaged = 0
        for line in lines:
            try:
                piece = json.loads(line)
                key, name, values = piece["key"], str(piece["name"]), [float(v) for v in piece["values"]]
            except (ValueError, TypeError, KeyError):
                damaged += 1
                continue
            if key == self._key_of(name):
                self._known[name] = values
            else:
                self._others.append(line)
        if lines and not raw.endswith(b"\n"):
            with path.open("ab") as stream:
                stream.write(b"\n")
        self._warn_of_lines(path, len(lines), damaged)

    def _warn_of_lines(self, path: Path, count: int, damaged: int) -> None:
        """Warn of the lines of the checkpoint file that are damaged or of other computations."""
        others = len(self._others)
        texts = []
        if others:
            texts.append(f"{others} of runs with other inputs or options, or of another version")
        if damaged:
            texts.append(f"{damaged} damaged")
        if texts:
            text = f"{path}: {others + damaged} of {count} lines were ignored: {', '.join(texts)}"
            if others:
                text += f"; delete {path.name} if nobody continues these other runs"
            warn("SWM150", text)


# ---------------------------------------------------------------- file names


def file_names(ids: Sequence[str], endings: Sequence[str]) -> list[str]:
    """Return a file name for the log of each trial. The names are distinct on every operating system.

    The name is the id of the trial, in which characters other than letters, digits, ``_``, ``-`` and ``.``
    become ``_``.

    Parameters
    ----------
    ids : sequence of str
        Distinct ids of trials.
    endings : sequence of str
        File extensions with their dot. All file names get the first extension. An id may end in any of them.

    Raises
    ------
    UsageError
        If two ids would have the same file name. Upper and lower case are not distinguished, because many
        file systems ignore case.

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
                hint="use ids that differ in letters, digits, '_', '-' or '.'; case does not count",
            )
    return [name for _, name in names.values()]
