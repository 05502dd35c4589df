"""MATLAB files of version 7.3, and other HDF5 files, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Loaded, Options, Reader, one_of, sorted_out


def _open(path: Path, options: Options) -> Loaded:
    import h5py

    arrays: dict[str, NDArray[Any]] = {}
    metadata: dict[str, Any] = {}
    try:
        with h5py.File(path, "r") as file:
            group: Any = file
            for part in (options.dataset or "").replace(".", "/").strip("/").split("/"):
                if part:
                    names = list(group) if isinstance(group, h5py.Group) else []
                    group = group[one_of(part, names, file=path, what="group", key="dataset")]
            if isinstance(group, h5py.Dataset):
                _take(group.name.rpartition("/")[2], group, arrays, metadata)
            else:
                group.visititems(lambda name, item: _take(name.replace("/", "."), item, arrays, metadata))
    except InputError:
        raise
    except Exception as error:
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"is no readable HDF5 or MATLAB 7.3 file: {first}", file=path) from error
    columns, scalars = sorted_out(arrays)
    if not columns:
        raise InputError("holds no columns of numbers", file=path)
    return Loaded(columns, metadata, scalars)


def _take(name: str, item: Any, arrays: dict[str, NDArray[Any]], metadata: dict[str, Any]) -> None:
    """One dataset. MATLAB's marks what it is, and lies transposed."""
    import h5py

    if not isinstance(item, h5py.Dataset) or name.startswith("#") or item.attrs.get("MATLAB_empty"):
        return
    matlab = item.attrs.get("MATLAB_class")
    if matlab == b"char":
        metadata[name] = "".join(chr(int(code)) for code in np.asarray(item).ravel() if code)
    elif item.dtype.kind in "iufb" and item.ndim <= 2:
        values = np.atleast_1d(np.asarray(item))
        arrays[name] = values.T if matlab is not None else values


READER = Reader(
    "hdf5",
    "HDF5 or MATLAB 7.3 file",
    (".h5", ".hdf5"),
    _open,
    magic=(b"\x89HDF", b"MATLAB 7.3"),
)
