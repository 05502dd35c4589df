"""Files of other programs are read in a child process: crashes, hangs and expansion end in one error."""

from __future__ import annotations

import ctypes
import itertools
import os
import resource
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid import import_log
from swimid.errors import InputError
from swimid.files import isolated, video
from swimid.imports.formats import open_table
from swimid.logs import log


def crash(_: Path) -> None:
    ctypes.string_at(0)


def hang(_: Path) -> None:
    time.sleep(60)


def take(_: Path) -> int:
    return len(np.ones(1 << 30))


def refuse(path: Path) -> None:
    raise InputError("is refused", file=path, line=3, hint="leave it")


def double(path: Path) -> str:
    return 2 * path.name


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.mat"
    path.write_bytes(b"0")
    return path


@pytest.mark.skipif(not hasattr(os, "fork"), reason="limits need a forked process")
@pytest.mark.parametrize(
    ("function", "words"), [(crash, "crashes"), (hang, "not read within 0 s"), (take, "MB of memory")]
)
def test_a_reader_that_fails_is_an_error_for_its_file(
    function: Callable[[Path], object], words: str, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolated, "MAX_TIME_S", 0.3 if function is hang else 30.0)
    with pytest.raises(InputError, match=words) as caught:
        isolated.run_isolated(function, file, file=file)
    assert caught.value.file == str(file)


@pytest.mark.parametrize("fork", [hasattr(os, "fork"), False])
def test_results_and_errors_come_back_as_they_are(fork: bool, file: Path) -> None:
    assert isolated.run_isolated(double, file, file=file, fork=fork) == "a.mata.mat"
    with pytest.raises(InputError) as caught:
        isolated.run_isolated(refuse, file, file=file, fork=fork)
    error = caught.value
    assert (error.line, error.hint, error.reason) == (3, "leave it", "is refused")


N = 60_000_000


def _mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"t_s": np.zeros(N // 3)}, do_compression=True)


def _hdf5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        file.create_dataset("t_s", shape=(10**9,), dtype="f8", chunks=(10**5,), compression="gzip")


def _parquet(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table({"t_s": np.zeros(N), "x_m": np.zeros(N)}), path)


def _xlsx(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", bytes(300 << 20))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="limits need a forked process")
@pytest.mark.parametrize(
    ("name", "make"), [("a.h5", _hdf5), ("a.parquet", _parquet), ("a.xlsx", _xlsx), ("a.mat", _mat)]
)
def test_small_files_that_expand_are_refused(
    name: str, make: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(isolated, "N_READER_COPIES", 1)
    path = tmp_path / name
    make(path)
    assert path.stat().st_size < 3e6
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    read: Callable[[Path], object] = open_table
    if name == "a.parquet":  # Only its first rows are read when it is opened.
        read = import_log
        with pytest.raises(InputError, match="MB"):
            log.read(path)
    with pytest.raises(InputError, match="MB") as caught:
        read(path)
    assert caught.value.hint is not None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes")
@pytest.mark.parametrize("read", [log.read, open_table])
def test_inputs_are_files(read: Callable[[Path], object], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        with pytest.raises(InputError, match="device or a pipe"):
            read(path)


def test_aliases_in_a_comment_line_do_not_multiply(tmp_path: Path) -> None:
    names = "abcdefghij"
    pairs = itertools.pairwise(names)
    rows = ["&a [1,1,1,1,1,1,1,1,1]", *(f"&{new} [{','.join([f'*{old}'] * 9)}]" for old, new in pairs)]
    path = tmp_path / "a.csv"
    path.write_text(f"# key: [{', '.join(rows)}]\nt_s,x_m\n0,0\n1,1\n")
    with pytest.raises(InputError, match="more than 100000 nodes"):
        log.read(path)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the limit is set in a forked process")
@pytest.mark.parametrize("share", [0.01, 0.5, 0.97, 0.999])
def test_a_full_disk_is_an_error_for_a_video(share: float, tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = tmp_path / "a.mp4"
    picture = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)

    def write(limit: int | None = None) -> None:
        writer = video.open_writer(path, 30.0, 640, 480)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
        try:
            for k in range(30):
                writer.write(k / 30, np.roll(picture, k, axis=0))
        finally:
            writer.close()

    write()
    size = path.stat().st_size
    with pytest.raises(InputError, match="File too large"):
        isolated.run_isolated(_as_input_error, write, int(share * size), path, file=path)


def _as_input_error(write: Callable[[int], None], limit: int, path: Path) -> None:
    from swimid.errors import file_errors

    with file_errors(path, "written"):
        write(limit)
