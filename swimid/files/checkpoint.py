"""What a long run found so far, kept beside its result so that a killed one goes on where it was."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import swimid


def place(output: Path) -> Path:
    """Where what was found on the way to a result is kept."""
    return output.with_name(f"{output.name}.partial")


class Checkpoint:
    """A file of named numbers, one JSON line each, under a first line that says what they belong to.

    Parameters
    ----------
    path : Path or None
        None keeps nothing.
    key : str
        Of inputs and settings; a file of another key is begun anew.
    """

    def __init__(self, path: Path | None = None, key: str = "") -> None:
        self.path = path
        self._known: dict[str, list[float]] = {}
        self._lock = threading.Lock()
        if path is None:
            return
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        if lines and lines[0] == self._head(key):
            for line in lines[1:]:
                try:
                    name, numbers = json.loads(line)
                except ValueError:
                    break  # the line that was being written when the run was killed
                self._known[name] = numbers
        else:
            path.write_text(self._head(key) + "\n", encoding="utf-8")

    @classmethod
    def beside(cls, output: Path | None, belongs_to: Any) -> Checkpoint:
        """One beside a result, of this version of the program and of what JSON says it belongs to."""
        text = json.dumps([belongs_to, swimid.__version__], sort_keys=True)
        path = None if output is None else place(output)
        return cls(path, hashlib.sha256(text.encode()).hexdigest())

    @property
    def begun(self) -> bool:
        """Whether an earlier run left something."""
        return bool(self._known)

    @staticmethod
    def _head(key: str) -> str:
        return json.dumps({"swimid": "checkpoint", "key": key})

    def get(self, name: str) -> NDArray[np.float64] | None:
        """Numbers kept under a name."""
        kept = self._known.get(name)
        return None if kept is None else np.array(kept)

    def put(self, name: str, numbers: NDArray[np.float64]) -> None:
        """Keep numbers under a name."""
        if self.path is None:
            return
        with self._lock, self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps([name, [float(v) for v in numbers]]) + "\n")

    def kept(self, name: str, compute: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Numbers kept under a name; computed and kept where there are none."""
        numbers = self.get(name)
        if numbers is None:
            numbers = compute()
            self.put(name, numbers)
        return numbers

    def done(self) -> None:
        """Remove the file: the result is written."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)
