"""``swimid export --to movement``: a dataset that movement opens, with the track of the log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import Ran

Run = Callable[..., Ran]
T = np.arange(200) / 40.0
X, Y = 0.2 * T, 0.03 * np.sin(9 * T)


def _log(path: Path, **columns: np.ndarray) -> Path:
    path.write_text("# robot: tfish\n" + pd.DataFrame({"t_s": T, **columns}).to_csv(index=False))
    return path


def test_movement_opens_an_exported_log(swimid: Run, tmp_path: Path) -> None:
    datasets = pytest.importorskip("movement.validators.datasets", reason="movement is not installed")
    kinematics = pytest.importorskip("movement.kinematics", reason="movement is not installed")
    import xarray

    likelihood = np.full(len(T), 0.9)
    likelihood[5] = 0.1
    columns = {"x_m": X, "y_m": Y, "yaw_rad": 0.1 * T, "nose_x_m": X + 0.1, "nose_y_m": Y}
    columns["nose_likelihood"] = likelihood
    path = _log(tmp_path / "run.csv", **columns)
    ran = swimid("export", path, "--to", "movement", "-o", tmp_path / "run.nc", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["result"]["points"] == ["reference", "nose"]

    data = xarray.open_dataset(tmp_path / "run.nc").load()
    opened = data
    if "keypoints" in datasets.ValidPosesInputs.DIM_NAMES:  # before version 0.17
        opened = data.rename(keypoint="keypoints", individual="individuals")
    datasets.ValidPosesInputs.validate(opened)
    assert data.attrs["fps"] == pytest.approx(40)
    assert data.position.attrs["space_unit"] == "m"
    one = data.sel(individual="tfish", keypoint="reference")
    assert np.allclose(one.time, T)
    assert np.allclose(one.position.sel(space="x"), X)
    # movement has y down, as in a picture
    assert np.allclose(one.position.sel(space="y"), -Y)
    assert np.allclose(data.confidence.sel(keypoint="nose", individual="tfish"), likelihood)
    assert np.allclose(data["yaw_rad"], 0.1 * T)
    velocity = kinematics.compute_velocity(opened.position).sel(space="x")
    assert np.allclose(velocity, 0.2)


def test_an_exported_log_is_imported_again(swimid: Run, tmp_path: Path) -> None:
    pytest.importorskip("h5netcdf", reason="h5netcdf is not installed")
    path = _log(tmp_path / "run.csv", x_m=X, y_m=Y, z_m=-0.1 * T)
    assert swimid("export", path, "--to", "movement", "-o", tmp_path / "run.nc").status == 0
    ran = swimid("import", tmp_path / "run.nc", "-o", tmp_path / "again.csv")
    assert ran.status == 0, ran.err
    again = pd.read_csv(tmp_path / "again.csv", comment="#")
    assert np.allclose(
        again[["t_s", "reference_x_m", "reference_y_m", "reference_z_m"]].to_numpy().T, [T, X, Y, -0.1 * T]
    )


def test_a_log_in_the_vertical_plane(swimid: Run, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    path = _log(tmp_path / "run.csv", x_m=X, z_m=Y)
    assert swimid("export", path, "--to", "movement", "-o", tmp_path / "run.nc").status == 0
    data = xarray.open_dataset(tmp_path / "run.nc", decode_times=False)
    assert data.space.values.tolist() == ["x", "y"]
    assert np.allclose(data.position.sel(space="y").squeeze(), -Y)


def test_a_log_without_a_track_and_an_export_without_a_file(swimid: Run, tmp_path: Path) -> None:
    path = _log(tmp_path / "run.csv", force_N=X)
    ran = swimid("export", path, "--to", "movement", "-o", tmp_path / "run.nc")
    assert ran.status == 3
    assert "no coordinates" in ran.err
    assert swimid("export", path, "--to", "movement").status == 2
    ran = swimid("export", path, "--to", "movement", "--draws", "3", "-o", tmp_path / "run.nc")
    assert ran.status == 2
    assert not (tmp_path / "run.nc").exists()
