"""MATLAB files up to version 7.2, by SciPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Loaded, Options, Reader, one_of, sorted_out

#: Of a longer cell array the rest is left.
MOST_CELLS = 1000


def _open(path: Path, options: Options) -> Loaded:
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except Exception as error:  # damaged files make SciPy raise whatever comes
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"is no readable MATLAB file: {first}", file=path) from error
    content = {name: value for name, value in content.items() if not name.startswith("__")}
    arrays: dict[str, NDArray[Any]] = {}
    metadata: dict[str, Any] = {}
    _flatten("", _chosen(content, options, path), arrays, metadata)
    columns, scalars = sorted_out(arrays)
    if not columns:
        raise InputError(
            "holds no columns of numbers",
            file=path,
            hint="a MATLAB table is an object only MATLAB reads: save its columns, or use writetable",
        )
    return Loaded(columns, metadata, scalars)


def _chosen(content: dict[str, Any], options: Options, path: Path) -> Any:
    if options.dataset is None:
        return content
    at: Any = content
    for part in options.dataset.replace("/", ".").strip(".").split("."):
        names = list(at) if isinstance(at, dict) else []
        at = at[one_of(part, names, file=path, what="struct", key="dataset")]
    return at if isinstance(at, dict) else {options.dataset.rpartition(".")[2]: at}


def _flatten(prefix: str, value: Any, arrays: dict[str, NDArray[Any]], metadata: dict[str, Any]) -> None:
    """Arrays of numbers by their dotted names, of a cell array ``name{1}`` ...; texts as metadata."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _flatten(f"{prefix}.{name}" if prefix else str(name), inner, arrays, metadata)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        for at, inner in enumerate(np.asarray(value, dtype=object).ravel()[:MOST_CELLS], start=1):
            _flatten(f"{prefix}{{{at}}}", inner, arrays, metadata)
    elif isinstance(value, str):
        if value.strip():
            metadata[prefix] = value.strip()
    elif isinstance(value, np.ndarray | np.number | int | float):
        array = np.asarray(value)
        if array.dtype.kind in "iufb":
            arrays[prefix] = np.atleast_1d(array)


READER = Reader("mat", "MATLAB file (up to version 7.2)", (".mat",), _open, magic=(b"MATLAB 5.0",))
