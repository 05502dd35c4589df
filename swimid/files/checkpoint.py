"""Checkpoints: files with the intermediate results of long runs, next to the output (``docs/formats.md``)."""

from __future__ import annotations

import hashlib
import json
import threading
import weakref
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import swimid
from swimid.errors import file_errors
from swimid.files import atomic
from swimid.notices import warn

#: Number of hexadecimal digits of a key.
DIGITS = 32


def place(output: Path) -> Path:
    """Return the path of the checkpoint of an output."""
    return output.with_name(f"{output.name}.partial")


#: Number of stored pieces of the latest run of this process, by the path of the checkpoint.
_PIECES: Counter[Path] = Counter()


def has_pieces(output: Path) -> bool:
    """Return whether the checkpoint of an output has pieces of the latest run of this process."""
    return _PIECES[place(output)] > 0


class Checkpoint:
    """Named pieces of a computation (arrays of numbers), each stored as one JSON line.

    A line is ``{"key": ..., "name": ..., "values": [...]}``. The key is the SHA-256 of the inputs and
    settings of the run and of the name of the piece. A line that is not of this form is damaged. A line with
    another key belongs to another run. Both are ignored, and the lines of other runs are preserved.

    Parameters
    ----------
    path : Path or None
        Checkpoint file. None stores nothing.
    key : str
        SHA-256 of the inputs and settings that determine the results.
    anew : bool
        Whether to discard the pieces that an earlier run with this key has stored.

    Raises
    ------
    UsageError
        If another run holds the lock of the output.
    InputError
        If the file cannot be read or written.

    Warns
    -----
    SWM150
        Lines are ignored.
    SWM151
        A piece cannot be stored, for instance because the disk is full.
    """

    def __init__(self, path: Path | None = None, key: str = "", *, anew: bool = False) -> None:
        self.path = path
        self._key = key
        self._known: dict[str, list[float]] = {}
        #: Lines of other runs.
        self._others: list[str] = []
        self._writing = threading.Lock()
        self._full = False
        if path is None:
            return
        atomic.check_writable(path)
        # release the lock also after a failed run, when the checkpoint object is deleted
        self._release = weakref.finalize(self, atomic.lock(path.with_suffix("")).release)
        with file_errors(path):
            self._read(path, anew)

    @classmethod
    def beside(cls, output: Path | None, belongs_to: Any, *, anew: bool = False) -> Checkpoint:
        """Return the checkpoint of an output, with a key from ``belongs_to`` and the version of swimid."""
        text = json.dumps([belongs_to, swimid.__version__], sort_keys=True)
        path = output and place(output)
        return cls(path, hashlib.sha256(text.encode()).hexdigest(), anew=anew)

    @property
    def begun(self) -> bool:
        """Whether an earlier run with the same key has stored pieces."""
        return bool(self._known)

    def get(self, name: str) -> NDArray[np.float64] | None:
        """Return the values stored under a name; None if there are none."""
        if name not in self._known:
            return None
        return np.array(self._known[name], dtype=float)

    def put(self, name: str, values: NDArray[np.float64]) -> None:
        """Store values under a name."""
        if self.path is None:
            return
        key, listed = self._key_of(name), [float(v) for v in values]
        line = {"key": key, "name": name, "values": listed}
        with self._writing:
            try:
                with self.path.open("a", encoding="utf-8") as stream:
                    # the last line may be incomplete after a failed write: begin a new line
                    stream.write("\n" * self._full + json.dumps(line) + "\n")
                _PIECES[self.path] += 1
            except OSError as error:
                if not self._full:
                    warn("SWM151", f"{self.path} cannot be written: {error.strerror or error}")
                self._full = True

    def kept(self, name: str, compute: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the values stored under a name. If there are none, compute and store them."""
        values = self.get(name)
        if values is None:
            values = compute()
            self.put(name, values)
        return values

    def done(self) -> None:
        """Remove the lines of this run, whose result is now written. Lines of other runs stay."""
        if self.path is None:
            return
        self._rewrite()
        _PIECES[self.path] = 0
        self._release()

    def _rewrite(self) -> None:
        """Rewrite the file with the lines of other runs only."""
        assert self.path is not None
        if self._others:
            with atomic.noted():  # no output of the command
                atomic.write_text(self.path, "".join(f"{line}\n" for line in self._others))
        else:
            self.path.unlink(missing_ok=True)

    def _key_of(self, name: str) -> str:
        return hashlib.sha256(f"{self._key}\n{name}".encode()).hexdigest()[:DIGITS]

    def _read(self, path: Path, anew: bool) -> None:
        """Sort the lines of the file into lines of this run, lines of other runs and damaged lines."""
        raw = path.read_bytes() if path.is_file() else b""
        lines = [line.decode("utf-8", "replace") for line in raw.splitlines() if line.strip()]
        damaged = 0
        for line in lines:
            key, name, values = _parsed(line)
            if not key:
                damaged += 1
            elif key != self._key_of(name):
                self._others.append(line)
            elif not anew:
                self._known[name] = values
        _PIECES[path] = len(self._known)
        if anew:
            self._rewrite()
        elif lines and not raw.endswith(b"\n"):
            with path.open("ab") as stream:
                stream.write(b"\n")
        others = len(self._others)
        reasons = {"of runs with other inputs or options, or of another version": others, "damaged": damaged}
        if others or damaged:
            told = ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
            if others:
                told += f"; delete {path.name} if nobody goes on with those runs"
            warn("SWM150", f"{path}: {others + damaged} of {len(lines)} lines were ignored: {told}")


def _parsed(line: str) -> tuple[str, str, list[float]]:
    """Return key, name and values of a line; the key of a damaged line is empty."""
    with suppress(ValueError, TypeError, KeyError):
        piece = json.loads(line)
        return str(piece["key"]), str(piece["name"]), [float(value) for value in piece["values"]]
    return "", "", []
