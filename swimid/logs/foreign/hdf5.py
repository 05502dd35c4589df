"""HDF5 files, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.logs.foreign import matlab
from swimid.logs.foreign.base import Options, Reader, Table, of_arrays, one_of, reading


def _open(path: Path, options: Options) -> Table:
    import h5py

    with path.open("rb") as stream:
        if stream.read(len(matlab.NEW)) == matlab.NEW:
            return matlab.load(path, options)
    arrays: dict[str, NDArray[Any]] = {}

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iufb" and item.ndim <= 2:
            arrays[name.replace("/", ".")] = np.atleast_1d(np.asarray(item))

    with reading(path, "HDF5 file"), h5py.File(path, "r") as file:
        group: Any = file
        for part in filter(None, (options.dataset or "").replace(".", "/").split("/")):
            names = list(group) if isinstance(group, h5py.Group) else []
            group = group[
                one_of(part, names, file=path, what="group", key="reader: {dataset: NAME} in a mapping, with")
            ]
        if isinstance(group, h5py.Dataset):
            take(group.name.rpartition("/")[2], group)
        else:
            group.visititems(take)
    return of_arrays(arrays, path)


READER = Reader("hdf5", "HDF5 file", (".h5", ".hdf5"), _open, magic=(b"\x89HDF",))
