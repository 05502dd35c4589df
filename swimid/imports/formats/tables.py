"""Readers of HDF5 (h5py), netCDF (xarray), MATLAB files (pymatreader), Parquet, and NumPy archives.

The attribute ``units`` of a variable of netCDF is the unit of its column. The unit of a time may name an
origin (``milliseconds since 2024-05-01``).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.files import isolated, tabular
from swimid.imports.table import ForeignTable, Format, ReaderOptions, of_tree
from swimid.logs import log


def _open_hdf5(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import h5py

    def parts(item: Any) -> Any:
        if isinstance(item, h5py.Group):
            return dict(item.items())
        if isinstance(item, h5py.Dataset):
            if item.ndim > 2:
                return {}  # leave out arrays with more than two axes, such as images
            isolated.check_size(path, item.size * item.dtype.itemsize)
        return item

    with h5py.File(path, "r") as file:
        if file.userblock_size:
            # Read a file with a user block as a MATLAB file, because MATLAB writes a block of text before the
            # HDF5 content of its files.
            return _open_matlab(path, options, select)
        return of_tree(file, select, path, parts)


def _open_netcdf(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import xarray

    with xarray.open_dataset(path, group=select, decode_times=False) as file:
        isolated.check_size(path, file.nbytes)
        data = {str(name): one.load() for name, one in file.variables.items()}
    table = of_tree({name: one.to_numpy() for name, one in data.items()}, None, path, lambda value: value)
    for name in table.columns:
        unit = data[name.partition("[")[0]].attrs.get("units", "")
        table.units[name] = str(unit).partition(" since ")[0]
    return table


def _open_npz(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    isolated.check_zip(path)
    with np.load(path, allow_pickle=False) as archive:
        # Leave out Python pickles, which can run any program when they are loaded.
        heads = {name: archive.zip.open(f"{name}.npy").read(128) for name in archive.files}
        plain = [name for name, head in heads.items() if b"'|O'" not in head]
        table = of_tree({name: archive[name] for name in plain}, select, path, lambda value: value)
    if len(plain) < len(heads):
        names = ", ".join(sorted({*heads} - {*plain})[:20])
        table.notes.append(f"arrays of Python objects left out: {names}")
    return table


def _open_matlab(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    from h5py import is_hdf5
    from pymatreader import read_mat

    # Hide warnings of pymatreader about MATLAB objects, which only MATLAB can read.
    with warnings.catch_warnings(action="ignore"):
        content = read_mat(path, ignore_fields=["#subsystem#"])
    is_unordered = is_hdf5(path)

    def parts(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        names = [name for name in value if not name.startswith("__")]
        if is_unordered:
            # Sort the names, because pymatreader returns the fields of a version 7.3 file in arbitrary order.
            names.sort()
        return {name: value[name] for name in names}

    table = of_tree(content, select, path, parts)
    if not table.columns:
        hint = "only MATLAB reads a MATLAB table: save its columns, or use writetable"
        raise InputError("holds no columns of numbers", file=path, hint=hint)
    return table


HDF5 = Format("hdf5", "HDF5 file", _open_hdf5, endings=(".h5", ".hdf5"), magic=(b"\x89HDF",), extra="hdf5")
_CDF, _CDF_MAGIC = (".nc", ".nc4", ".cdf"), (b"CDF", b"\x89HDF")
NETCDF = Format("netcdf", "netCDF file", _open_netcdf, endings=_CDF, magic=_CDF_MAGIC, extra="netcdf")
NPZ = Format("npz", "NumPy archive", _open_npz, endings=(".npz",), magic=(b"PK\x03\x04",))
MATLAB_MAGIC = (b"MATLAB 5.0", b"MATLAB 7.3")
MATLAB = Format("mat", "MATLAB file", _open_matlab, endings=(".mat",), magic=MATLAB_MAGIC, extra="hdf5")


#: Arguments for reading a Parquet file through a buffer of 1 MiB for each column. Without the buffer, a whole
#: row group would be read at once and stay in memory until the end of the file.
BUFFERED = {"buffer_size": 1 << 20, "pre_buffer": False}


def _open_parquet(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    import pyarrow.parquet

    types, notes = pyarrow.types, []
    with pyarrow.parquet.ParquetFile(path, **BUFFERED) as file:
        schema, count = file.schema_arrow, file.metadata.num_rows
        nested = [f.name for f in schema if types.is_nested(f.type) or types.is_binary(f.type)]
        names = [name for name in schema.names if name not in nested]
        first = next(_batches(file, names), schema.empty_table().select(names))
        columns = _arrays(first, path)
    if nested:
        notes.append(f"columns that hold no plain values left out: {', '.join(nested)}")
    stored = (schema.metadata or {}).get(b"swimid", b"")
    table = ForeignTable(columns, notes=notes, comments=stored.decode("utf-8", "replace").splitlines())
    if len(first) < count:
        table.names, table.after = list(columns), count - len(first)
        table.rest = partial(_rest, path, table.names, len(first))
    return table


def _rest(path: Path, known: list[str], start: int, names: list[str]) -> Iterator[ForeignTable]:
    """Yield the rows of a Parquet file from row ``start`` on, with only the columns ``names``."""
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path, **BUFFERED) as file:
        row = 0
        for batch in _batches(file, names):
            if row >= start:
                yield ForeignTable(_arrays(batch, path), names=known, before=row)
            row += len(batch)


def _batches(file: Any, names: list[str]) -> Iterator[Any]:
    return iter(file.iter_batches(batch_size=log.ROWS, columns=names, use_threads=False))


def _arrays(batch: Any, path: Path) -> dict[str, NDArray[Any]]:
    return log.arrays(batch.to_pandas(ignore_metadata=True), str(path))


PARQUET = Format(
    "parquet",
    "Parquet file",
    _open_parquet,
    endings=tabular.PARQUET_ENDINGS,
    magic=(b"PAR1",),
    extra="parquet",
)
