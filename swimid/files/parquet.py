"""Parquet files, whose library comes with the extra ``parquet``."""

from __future__ import annotations

from typing import Any

from swimid.errors import extra_needed

ENDINGS = (".parquet", ".pq")


def library() -> Any:
    """Return the module ``pyarrow``, with ``pyarrow.parquet`` imported.

    Raises
    ------
    UsageError
        When pyarrow is not installed.
    """
    with extra_needed("a Parquet file", "parquet"):
        import pyarrow.parquet
    return pyarrow
