"""A lock on an output: only one run at a time writes it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.errors import UsageError, file_errors

if TYPE_CHECKING:
    from filelock import BaseFileLock


@dataclass(eq=False)
class Lock:
    """A held lock: the file ``<output>.lock`` with the process that holds it.

    A lock of a process that no longer runs is replaced. A thread that asks for a lock which it holds already,
    directly or through a run that failed, shares it.
    """

    file: BaseFileLock
    thread: threading.Thread = field(default_factory=threading.current_thread)
    holders: int = 1

    def release(self) -> None:
        """Remove the lock after as many calls as there were of :func:`take`."""
        self.holders -= 1
        path = Path(self.file.lock_file)
        if self.holders == 0 and _HELD.get(path) is self:
            del _HELD[path]
            self.file.release()


#: The locks of this process.
_HELD: dict[Path, Lock] = {}


def take(output: Path) -> Lock:
    """Lock an output.

    Raises
    ------
    UsageError
        When another run holds the lock.
    InputError
        When the lock cannot be written.
    """
    from filelock import SoftFileLock, Timeout  # 60 ms

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
def held(output: Path | None) -> Iterator[None]:
    """Hold the lock of an output while the block runs; a device or a stream needs none."""
    stored = output is not None and (output.is_file() or output.is_dir() or not output.exists())
    if output is None or not stored or str(output) == "-" or not os.access(output.parent, os.W_OK):
        yield
        return
    lock = take(output)
    try:
        yield
    finally:
        lock.release()
