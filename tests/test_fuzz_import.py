"""Every foreign reader against garbage: it succeeds or raises a SwimidError, and never hangs."""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swimid.errors import SwimidError
from swimid.imports import mapping
from swimid.imports.formats import open_table
from swimid.imports.mapping import guess_mapping
from swimid.notices import SwimidWarning
from tests.conftest import Ran
from tests.test_fuzz_readers import _ends_in_order, examples, mutated, rewritten
from tests.test_import import FILES, MAP
from tests.test_import_formats import _c3d, _coco, _motive, _tdms

#: One file of each kind of reader, small enough to try many.
KINDS = {
    "comma": "",
    "headerless blanks": "",
    "mat": "",
    "mat 7.3": "",
    "parquet": "",
    "mcap": "/pose",
    "ulog": "",
    "db3": "/pose",
    "xlsx": "",
}


def _through(path: Path, topic: str) -> None:
    """Read all a file offers, and guess its mapping; any SwimidError is as good as an answer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SwimidWarning)
        with contextlib.suppress(SwimidError):
            open_table(path, select=topic or None)
        with contextlib.suppress(SwimidError):
            mapping.apply(None, path)
        with contextlib.suppress(SwimidError):
            guess_mapping(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def _read_mutations(valid: Path, read: Callable[[Path], object]) -> None:
    """Read 30 mutations of a valid file, each written beside it."""
    path = valid.with_name(f"x{valid.suffix}")

    @examples(12)
    @given(content=mutated(valid.read_bytes()))
    def run(content: bytes) -> None:
        path.write_bytes(content)
        read(path)

    run()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_mutated_files(kind: str, folder: Path) -> None:
    name, make, _, _ = FILES[kind]
    make(folder / name)
    _read_mutations(folder / name, lambda path: _through(path, KINDS[kind]))


@pytest.mark.parametrize(
    ("name", "make", "topic"),
    [
        ("a.c3d", lambda path: _c3d(path, "+Y", analog=True), "points"),
        ("a.tdms", _tdms, "balance"),
        ("a.csv", lambda path: _motive(path, "Quaternion"), ""),
        ("a.json", lambda path: path.write_text(json.dumps(_coco())), ""),
    ],
)
def test_mutated_files_of_profiles(
    name: str, make: Callable[[Path], object], topic: str, folder: Path
) -> None:
    make(folder / name)
    stated = {"select": topic} if topic else {}

    def read(path: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SwimidWarning)
            with contextlib.suppress(SwimidError):
                mapping.apply(None, path, stated)

    _read_mutations(folder / name, read)


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".mat", ".parquet", ".mcap", ".ulg", ".h5", ".c3d", ".xlsx"])
def test_arbitrary_files(ending: str, folder: Path) -> None:
    path = folder / f"y{ending}"
    heads = [
        b"",
        b"MATLAB 5.0 MAT-file",
        b"MATLAB 7.3",
        b"\x89HDF\r\n\x1a\n",
        b"PAR1",
        b"\x89MCAP0\r\n",
        b"ULog\x01\x12\x35",
        b'{"',
        b"CDF\x01",
        b"SQLite format 3\x00",
        b"TDSm",
        b"\x93NUMPY\x01\x00v\x00{'descr': '|O'",
        b"PK\x03\x04",
        b"LabVIEW Measurement\n",
        b"Format Version,1.25,Take Name,a\n",
        b"NO_OF_FRAMES\t3\nDATA_INCLUDED\t3D\n",
        b"Trajectories\n50\n,,a\nFrame,Sub Frame,X\n",
    ]

    @examples(12)
    @given(
        head=st.sampled_from(heads),
        content=st.one_of(st.binary(max_size=200), st.text(max_size=120).map(str.encode)),
    )
    def run(head: bytes, content: bytes) -> None:
        path.write_bytes(head + content)
        _through(path, "")

    run()


def test_tables_of_odd_cells(swimid: Callable[..., Ran], folder: Path) -> None:
    path = folder / "odd.csv"
    cell = st.one_of(
        st.sampled_from(
            ["", "nan", "inf", "-inf", "1e999", "1,5", '"', "2026-01-01", "x", "é", "1_0", "0x1"]
        ),
        st.floats().map(str),
        st.integers(-3, 9).map(str),
    )

    @examples(20)
    @given(rows=st.lists(st.lists(cell, min_size=3, max_size=4), max_size=40), split=st.sampled_from(",;\t "))
    def run(rows: list[list[str]], split: str) -> None:
        lines = ["t_s,x_m,y_m".replace(",", split), *(split.join(row) for row in rows)]
        path.write_text("\n".join(lines), encoding="utf-8")
        _ends_in_order(swimid("import", path, "-o", folder / "odd-out.csv", "--force"))

    run()


def test_rewritten_mappings(swimid: Callable[..., Ran], folder: Path) -> None:
    name, make, _, (time, x, yaw) = FILES["comma"]
    make(folder / name)
    valid = MAP.format(
        reader="reader: {delimiter: ',', header: true, skip_rows: 0, missing: [-9999]}",
        time=time,
        x=x,
        yaw=yaw,
    )
    path = folder / "m.yaml"

    @examples(20)
    @given(content=st.one_of(rewritten(valid.encode()), mutated(valid.encode())))
    def run(content: bytes) -> None:
        path.write_bytes(content)
        with contextlib.suppress(SwimidError):
            mapping.read_mapping(path)
        _ends_in_order(
            swimid("import", folder / name, "--map", path, "-o", folder / "map-out.csv", "--force")
        )

    run()
