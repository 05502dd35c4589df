"""``swimid track imu`` against garbage: it ends in order, whatever the recording or the camera's log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import Ran
from tests.generators import imu
from tests.test_fuzz_readers import _ends_in_order, examples, mutated

#: What a cell may hold that is no sound reading.
ODD = ["", "nan", "inf", "-1e300", "1e999", "x", "0", "-9999", "1_0", "2026-01-01"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = imu.marching(np.random.default_rng(8), swim_s=4.0, rest_s=1.5, rate_hz=25.0)
    place = tmp_path_factory.mktemp("fuzz-imu")
    for name, quaternions in (("imu.csv", False), ("imu-q.csv", True)):
        pd.DataFrame(run.columns(quaternions=quaternions)).round(5).to_csv(place / name, index=False)
    camera = pd.DataFrame({"t_s": run.time_s, "x_m": run.position[:, 0], "y_m": run.position[:, 1]})
    camera.iloc[::3].round(4).to_csv(place / "camera.csv", index=False)
    return place


@pytest.mark.slow
def test_the_sound_files(swimid: Callable[..., Ran], folder: Path) -> None:
    """First, so that what is compiled at its first use is no hang later."""
    for more in ([], ["--with", folder / "camera.csv"]):
        ran = swimid("track", "imu", folder / "imu.csv", *more, "-o", folder / "out.csv", "--force")
        assert ran.status == 0, ran.err


@pytest.mark.slow
def test_a_mutated_recording(swimid: Callable[..., Ran], folder: Path) -> None:
    valid = (folder / "imu.csv").read_bytes()
    path = folder / "x.csv"

    @examples(25)
    @given(content=mutated(valid))
    def run(content: bytes) -> None:
        path.write_bytes(content)
        _ends_in_order(swimid("track", "imu", path, "-o", folder / "out.csv", "--force"))

    run()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["imu.csv", "imu-q.csv", "camera.csv"])
def test_odd_cells(name: str, swimid: Callable[..., Ran], folder: Path) -> None:
    rows = [line.split(",") for line in (folder / name).read_text().splitlines()]
    path = folder / f"odd-{name}"
    at = st.tuples(st.integers(1, len(rows) - 1), st.integers(0, len(rows[0]) - 1))

    @examples(25)
    @given(
        cells=st.lists(st.tuples(at, st.sampled_from(ODD)), min_size=1, max_size=30),
        column=st.one_of(st.none(), st.tuples(st.integers(0, len(rows[0]) - 1), st.sampled_from(ODD))),
    )
    def run(cells: list[tuple[tuple[int, int], str]], column: tuple[int, str] | None) -> None:
        changed = [list(row) for row in rows]
        for (row, place), value in cells:
            changed[row][place] = value
        if column is not None:
            for row_cells in changed[1:]:
                row_cells[column[0]] = column[1]
        path.write_text("\n".join(",".join(row) for row in changed) + "\n")
        files = [path] if name.startswith("imu") else [folder / "imu.csv", "--with", path]
        _ends_in_order(swimid("track", "imu", *files, "-o", folder / "out.csv", "--force"))

    run()
