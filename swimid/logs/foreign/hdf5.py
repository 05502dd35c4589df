"""HDF5 files, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign import matlab
from swimid.logs.foreign.base import Loaded, Options, Reader, one_of, sorted_out


def _open(path: Path, options: Options) -> Loaded:
    import h5py

    with path.open("rb") as stream:
        if stream.read(len(matlab.NEW)) == matlab.NEW:
            return matlab.load(path, options)
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with h5py.File(path, "r") as file:
            group: Any = file
            for part in (options.dataset or "").replace(".", "/").strip("/").split("/"):
                if part:
                    names = list(group) if isinstance(group, h5py.Group) else []
                    group = group[one_of(part, names, file=path, what="group", key="dataset")]
            if isinstance(group, h5py.Dataset):
                _take(group.name.rpartition("/")[2], group, arrays)
            else:
                group.visititems(lambda name, item: _take(name.replace("/", "."), item, arrays))
    except InputError:
        raise
    except Exception as error:
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(f"is no readable HDF5 file: {first}", file=path) from error
    columns, scalars = sorted_out(arrays)
    if not columns:
        raise InputError("holds no columns of numbers", file=path)
    return Loaded(columns, {}, scalars)


def _take(name: str, item: Any, arrays: dict[str, NDArray[Any]]) -> None:
    """One dataset of numbers, by its dotted name."""
    import h5py

    if isinstance(item, h5py.Dataset) and item.dtype.kind in "iufb" and item.ndim <= 2:
        arrays[name] = np.atleast_1d(np.asarray(item))


READER = Reader("hdf5", "HDF5 file", (".h5", ".hdf5"), _open, magic=(b"\x89HDF",))
