"""MATLAB files: up to version 7.2 by SciPy, of version 7.3 by pymatreader."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs.foreign.base import Options, Reader, Table, of_arrays, one_of, reading

#: First bytes of a file of version 7.3; HDF5 follows.
NEW = b"MATLAB 7.3"
#: Maximum number of elements of a cell array that are read.
MOST_CELLS = 1000


def load(path: Path, options: Options) -> Table:
    """Read every array of numbers of a file."""
    with reading(path, "MATLAB file"):
        content = _content(path)
    content = {name: value for name, value in content.items() if not name.startswith("__")}
    arrays: dict[str, NDArray[Any]] = {}
    metadata: dict[str, Any] = {}
    _flatten("", _chosen(content, options, path), arrays, metadata)
    hint = "only MATLAB reads a MATLAB table: save its columns, or use writetable"
    return of_arrays(arrays, path, metadata, hint=hint)


def _content(path: Path) -> dict[str, Any]:
    """Return the variables of the file; structs as dictionaries, cell arrays as lists."""
    from scipy.io import loadmat

    with path.open("rb") as stream:
        new = stream.read(len(NEW)) == NEW
    if not new:
        content: dict[str, Any] = loadmat(path, simplify_cells=True)
        return content
    from pymatreader import read_mat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about objects, which only MATLAB reads
        return dict(_sorted(read_mat(path, ignore_fields=["#subsystem#"])))


def _sorted(value: Any) -> Any:
    """Return structs with their fields sorted by name; pymatreader returns them in any order."""
    return {name: _sorted(value[name]) for name in sorted(value)} if isinstance(value, dict) else value


def _chosen(content: dict[str, Any], options: Options, path: Path) -> Any:
    if options.dataset is None:
        return content
    at: Any = content
    for part in options.dataset.replace("/", ".").strip(".").split("."):
        names = list(at) if isinstance(at, dict) else []
        at = at[
            one_of(part, names, file=path, what="struct", key="reader: {dataset: NAME} in a mapping, with")
        ]
    return at if isinstance(at, dict) else {options.dataset.rpartition(".")[2]: at}


def _flatten(prefix: str, value: Any, arrays: dict[str, NDArray[Any]], metadata: dict[str, Any]) -> None:
    """Collect arrays of numbers by their dotted names (``name{1}`` in a cell array), and text as metadata."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _flatten(f"{prefix}.{name}" if prefix else str(name), inner, arrays, metadata)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        # NumPy would take vectors of one length for a matrix of cells
        vectors = isinstance(value, list) and any(isinstance(cell, np.ndarray) for cell in value)
        cells = value if vectors else np.asarray(value, dtype=object).ravel()
        for at, inner in enumerate(cells[:MOST_CELLS], start=1):
            _flatten(f"{prefix}{{{at}}}", inner, arrays, metadata)
    elif isinstance(value, str):
        if value.strip():
            metadata[prefix] = value.strip()
    elif isinstance(value, np.ndarray | np.number | int | float):
        array = np.asarray(value)
        if array.dtype.kind in "iufb":
            arrays[prefix] = np.atleast_1d(array)


READER = Reader("mat", "MATLAB file", (".mat",), load, magic=(b"MATLAB 5.0", NEW))
