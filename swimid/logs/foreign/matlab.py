"""MATLAB files of any version, by pymatreader."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, of_tree


def load(path: Path, options: Options) -> Table:
    """Read every array of numbers of a file.

    Raises
    ------
    InputError
        The file holds no array of numbers.
    """
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


READER = Reader("mat", "MATLAB file", (".mat",), load, magic=(b"MATLAB 5.0", b"MATLAB 7.3"), extra="hdf5")
