"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from swimid.errors import InputError, UsageError


def check_writable(path: str | Path, *, inputs: Iterable[object] = ()) -> Path:
    """The path, after making sure that writing it can work and loses none of the inputs that are files.

    Raises
    ------
    InputError
        When its folder does not exist or cannot be written.
    UsageError
        When it is one of ``inputs`` or a folder.
    """
    path = Path(path)
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


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well.

    The temporary name keeps the ending, so that writers that choose their format by it
    work. An exception, a full disk or Ctrl-C leaves the old file untouched.
    """
    path = check_writable(path)
    # a device or a pipe is written to, never replaced
    device = path.exists() and not path.is_file()
    folder = None if device else path.parent
    handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=folder)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        if device:
            path.write_bytes(temporary.read_bytes())
        else:
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            temporary.chmod(_mode(path))
            temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
    finally:
        temporary.unlink(missing_ok=True)


def _mode(path: Path) -> int:
    """The permissions the finished file should have: the old file's, or the usual ones."""
    if path.exists():
        return path.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def write_text(path: str | Path, text: str) -> None:
    """Write ``text`` as UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
