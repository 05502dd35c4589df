"""HDF5 files, by h5py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from swimid.logs.foreign import matlab
from swimid.logs.foreign.base import Options, Reader, Table, of_tree


def _open(path: Path, options: Options) -> Table:
    import h5py

    def parts(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return dict(item.items())
        # a film is no column
        return {} if isinstance(item, h5py.Dataset) and item.ndim > 2 else item

    with h5py.File(path, "r") as file:
        # MATLAB writes a text block before the HDF5 content
        return matlab.load(path, options) if file.userblock_size else of_tree(file, options, path, parts)


READER = Reader("hdf5", "HDF5 file", (".h5", ".hdf5"), _open, magic=(b"\x89HDF",), extra="hdf5")
