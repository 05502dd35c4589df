"""HDF5 files, by h5py, and MATLAB files of any version, by pymatreader."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, of_tree


def _open_hdf5(path: Path, options: Options) -> Table:
    import h5py

    def parts(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return dict(item.items())
        # a film is no column
        return {} if isinstance(item, h5py.Dataset) and item.ndim > 2 else item

    with h5py.File(path, "r") as file:
        # MATLAB writes a text block before the HDF5 content
        return _open_matlab(path, options) if file.userblock_size else of_tree(file, options, path, parts)


def _open_matlab(path: Path, options: Options) -> Table:
    from h5py import is_hdf5
    from pymatreader import read_mat

    # it warns about objects, which only MATLAB reads
    with warnings.catch_warnings(action="ignore"):
        content = read_mat(path, ignore_fields=["#subsystem#"])
    # pymatreader returns the fields of version 7.3 in any order
    arranged = sorted if is_hdf5(path) else list

    def parts(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {name: value[name] for name in arranged(value) if not name.startswith("__")}

    table = of_tree(content, options, path, parts)
    if not table.columns:
        hint = "only MATLAB reads a MATLAB table: save its columns, or use writetable"
        raise InputError("holds no columns of numbers", file=path, hint=hint)
    return table


HDF5 = Reader("hdf5", "HDF5 file", (".h5", ".hdf5"), _open_hdf5, magic=(b"\x89HDF",), extra="hdf5")
MATLAB = Reader(
    "mat", "MATLAB file", (".mat",), _open_matlab, magic=(b"MATLAB 5.0", b"MATLAB 7.3"), extra="hdf5"
)
