"""Formats of ``swimid import``: a file that another program wrote, or that follows its documentation.

Each file becomes a log with the true positions, units, times and missing samples.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from swimid.logs.log import Log
from tests.conftest import Ran

Run = Callable[..., Ran]
Imported = Callable[..., tuple[Log, Ran]]
N, RATE = 120, 50.0
T = np.arange(N) / RATE
BEAT = 2 * np.pi * 1.4 * T
X_PX, Y_PX = 100 + 4.0 * np.arange(N), 200 + 9 * np.sin(BEAT)
X_M, Y_M, Z_M = 0.1 + 0.2 * T, 0.02 * np.sin(BEAT), -0.3 + 0.01 * np.cos(BEAT)
YAW = 0.4 + 0.3 * np.sin(BEAT)
GAP = slice(30, 36)


def _refused(swimid: Run, path: Path, *options: str) -> str:
    """Import a file that cannot be read; return the message, which names the file."""
    ran = swimid("import", path, *options, "-o", path.with_name("refused.csv"))
    assert ran.status == 3, (ran.status, ran.err)
    assert path.name in ran.err
    assert "Traceback" not in ran.err
    assert not path.with_name("refused.csv").exists()
    return ran.err


def _cut(path: Path, share: float = 0.5) -> Path:
    """Write the first part of a file to another one, as a broken copy has it."""
    whole = path.read_bytes()
    cut = path.with_name(f"cut{path.suffix}")
    cut.write_bytes(whole[: int(share * len(whole))])
    return cut


def _shortened(path: Path) -> Path:
    """Write a text file without its last ten lines to another one."""
    cut = path.with_name(f"short{path.suffix}")
    cut.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-10]))
    return cut


def _hidden(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[GAP] = np.nan
    return values


# ---------------------------------------------------------------- movement


def _dataset(fps: float | None, individuals: list[str]) -> Any:
    """A dataset of movement: two points, one of them hidden for a while."""
    poses = pytest.importorskip("movement.io.load_poses", reason="the package movement is not installed")
    nose = np.stack([_hidden(X_PX), _hidden(Y_PX)], axis=1)
    both = np.stack([nose, np.stack([X_PX - 80, Y_PX + 5], axis=1)], axis=2)
    position = np.stack([both + 1000 * k for k in range(len(individuals))], axis=3)
    confidence = np.full((N, 2, len(individuals)), 0.9)
    confidence[10:15, 1] = 0.1
    return poses.from_numpy(
        position,
        confidence,
        individual_names=individuals,
        keypoint_names=["nose", "tail tip"],
        fps=fps,
        source_software="SLEAP",
    )


def test_movement(imported: Imported, tmp_path: Path) -> None:
    _dataset(RATE, ["fish"]).to_netcdf(tmp_path / "a.nc")
    record, ran = imported(tmp_path / "a.nc")
    assert ran.json["result"]["profile"] == "movement"
    assert np.allclose(record.time_s, T)
    assert np.isnan(record["nose_x_px"][GAP]).all()
    assert np.allclose(record["nose_y_px"], _hidden(-Y_PX), equal_nan=True)
    assert np.isnan(record["tail_tip_x_px"][10:15]).all()
    assert np.allclose(record["tail_tip_y_px"][15:], -(Y_PX + 5)[15:])
    assert record.metadata["source_software"] == "SLEAP"


def test_movement_with_singular_dimensions_and_one_confidence_for_an_animal(
    imported: Imported, tmp_path: Path
) -> None:
    """The form of version 0.17."""
    data = _dataset(RATE, ["fish"])
    data = data.rename({name: name[:-1] for name in ("keypoints", "individuals") if name in data.dims})
    data["confidence"] = data["confidence"].min("keypoint")
    data.to_netcdf(tmp_path / "a.nc")
    record, _ = imported(tmp_path / "a.nc")
    assert np.isnan(record["nose_x_px"][10:15]).all()
    assert np.isnan(record["tail_tip_x_px"][10:15]).all()
    assert np.allclose(record["tail_tip_x_px"][15:], (X_PX - 80)[15:])


def test_movement_of_several_individuals_by_frame(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    _dataset(None, ["ann", "bob"]).to_netcdf(tmp_path / "a.nc", engine="scipy")
    assert "ann, bob" in _refused(swimid, tmp_path / "a.nc", "--rate-hz", "50")
    assert "--rate-hz" in _refused(swimid, tmp_path / "a.nc", "--select", "bob")
    record, _ = imported(tmp_path / "a.nc", "--select", "bob", "--rate-hz", "50")
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["tail_tip_x_px"][20:], (X_PX + 920)[20:])


def test_movement_scaled_to_a_length(imported: Imported, tmp_path: Path) -> None:
    transforms = pytest.importorskip("movement.transforms", reason="the package movement is not installed")
    data = _dataset(RATE, ["fish"])
    data["position"] = transforms.scale(data["position"], factor=0.1, space_unit="mm")
    data["confidence"] = data["confidence"] * np.nan  # unknown, as movement writes it
    data.to_netcdf(tmp_path / "a.nc")
    record, _ = imported(tmp_path / "a.nc")
    assert np.allclose(record["tail_tip_x_m"], (X_PX - 80) * 1e-4)
    assert np.allclose(record["tail_tip_y_m"], -(Y_PX + 5) * 1e-4)


def test_movement_that_is_cut_off(swimid: Run, tmp_path: Path) -> None:
    _dataset(RATE, ["fish"]).to_netcdf(tmp_path / "a.nc")
    _refused(swimid, _cut(tmp_path / "a.nc"), "--as", "movement")


# ---------------------------------------------------------------- points in pictures


def _coco() -> dict[str, Any]:
    """Annotations in the COCO format: the pictures are every second frame of a film, one is not annotated."""
    images = [
        {"id": 7 + k, "file_name": f"film_{2 * k:06d}.png", "width": 640, "height": 480} for k in range(N)
    ]
    annotations = []
    for k in reversed(range(N)):
        if k == 50:
            continue
        visible = 0 if 30 <= k < 36 else 2
        nose = [X_PX[k] * (visible > 0), Y_PX[k] * (visible > 0), visible]
        tail = [X_PX[k] - 80, Y_PX[k] + 5, 1]
        annotations.append(
            {"id": k, "image_id": 7 + k, "category_id": 3, "keypoints": nose + tail, "num_keypoints": 2}
        )
    categories = [{"id": 3, "name": "fish", "keypoints": ["nose", "tail tip"], "skeleton": [[1, 2]]}]
    return {"images": images, "annotations": annotations, "categories": categories}


def test_coco(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(_coco()))
    assert "--rate-hz" in _refused(swimid, tmp_path / "a.json")
    record, ran = imported(tmp_path / "a.json", "--rate-hz", str(2 * RATE))
    assert ran.json["result"]["profile"] == "coco"
    kept = np.delete(np.arange(N), 50)
    assert np.allclose(record.time_s, T[kept])
    assert np.allclose(record["nose_x_px"], _hidden(X_PX)[kept], equal_nan=True)
    assert np.allclose(record["tail_tip_y_px"], -(Y_PX + 5)[kept])
    _refused(swimid, _cut(tmp_path / "a.json"), "--rate-hz", "50")


def test_coco_individuals(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    content = _coco()
    other = [
        {**one, "keypoints": [value + 1 for value in one["keypoints"]]} for one in content["annotations"]
    ]
    content["annotations"] += other
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert "2 individuals in one picture" in _refused(swimid, tmp_path / "a.json", "--rate-hz", "50")
    for k, one in enumerate(content["annotations"]):
        one["track_id"] = k // (N - 1)
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert "0, 1" in _refused(swimid, tmp_path / "a.json", "--rate-hz", "50")
    record, _ = imported(tmp_path / "a.json", "--rate-hz", "100", "--select", "1")
    assert np.allclose(record["tail_tip_x_px"], np.delete(X_PX - 79, 50))


def test_coco_results(imported: Imported, tmp_path: Path) -> None:
    found = [
        {"image_id": k, "category_id": 1, "keypoints": [X_PX[k], Y_PX[k], 0.2 + 0.7 * (k > 4)], "score": 0.8}
        for k in range(N)
    ]
    (tmp_path / "a.json").write_text(json.dumps(found))
    record, ran = imported(tmp_path / "a.json", "--rate-hz", str(RATE))
    assert np.isnan(record["point1_x_px"][:5]).all()
    assert np.allclose(record["point1_y_px"][5:], -Y_PX[5:])
    assert ran.json["result"]["unlikely"] == {"point1_score": 5}


def _particles() -> pd.DataFrame:
    """A table that trackpy linked: a long track with a gap, and a short one."""
    trackpy = pytest.importorskip("trackpy")
    found = {"x": X_PX, "y": Y_PX, "frame": np.arange(N), "mass": 900.0, "size": 2.1, "ecc": 0.1, "ep": 0.07}
    other = pd.DataFrame(found).assign(x=X_PX + 300)[:40]
    trackpy.quiet()
    return trackpy.link(pd.concat([pd.DataFrame(found).drop(range(30, 36)), other]), 30, memory=10)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_trackpy(ending: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    path = tmp_path / f"a.{ending}"
    table = _particles()
    if ending == "csv":
        table.to_csv(path)
    else:
        table.to_parquet(path)
    assert "2 particles" in _refused(swimid, path, "--rate-hz", "50")
    number = table.loc[table["x"] == X_PX[-1], "particle"].iloc[0]
    record, ran = imported(path, "--rate-hz", "50", "--select", f"{number:g}")
    assert ran.json["result"]["profile"] == "trackpy"
    kept = np.delete(np.arange(N), np.arange(30, 36))
    assert np.allclose(record.time_s, T[kept])
    assert np.allclose(record["x_px"], X_PX[kept])
    assert np.allclose(record["y_px"], -Y_PX[kept])
    assert np.allclose(record["x_sd_px"], 0.07)


def _trajectories() -> np.ndarray:
    one = np.stack([_hidden(X_PX), _hidden(Y_PX)], axis=1)
    return np.stack([one, one + 300], axis=1)


def test_idtracker_hdf5(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """The layout that idtracker.ai 6 writes."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "trajectories.h5"
    with h5py.File(path, "w") as file:
        file.create_group("areas")["mean"] = [90.0, 95.0]
        file.create_group("setup_points")
        file.create_group("identities_groups")
        file.create_dataset("trajectories", data=_trajectories(), compression="gzip")
        file.create_dataset("id_probabilities", data=np.ones((N, 2)))
        file.attrs.update(
            {"version": "6.0.14", "frames_per_second": RATE, "body_length": 41.5, "length_unit": -1}
        )
        file.attrs["identities_labels"] = ["ann", "bob"]
    assert "ann, bob" in _refused(swimid, path)
    record, ran = imported(path, "--select", "bob")
    assert ran.json["result"]["profile"] == "idtrackerai"
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["x_px"], _hidden(X_PX + 300), equal_nan=True)
    assert np.allclose(record["y_px"], _hidden(-Y_PX - 300), equal_nan=True)
    assert record.metadata["idtrackerai_body_length"] == 41.5
    _refused(swimid, _cut(path), "--as", "idtrackerai")


def test_idtracker_csv(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    cells = np.column_stack([T, _trajectories().reshape(N, -1)])
    path = tmp_path / "trajectories.csv"
    np.savetxt(path, cells, delimiter=",", header="time,x1,y1,x2,y2", fmt="%.3f", comments="")
    _refused(swimid, path, "--select", "2")  # without its attributes the file may be of any program
    (tmp_path / "attributes.json").write_text(json.dumps({"frames_per_second": RATE, "version": "6.0.14"}))
    record, _ = imported(path, "--select", "2")
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["x_px"], _hidden(X_PX + 300), equal_nan=True, atol=6e-4)


def test_idtracker_pickles_are_never_loaded(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    class Program:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.touch, (tmp_path / "ran",))

    np.save(tmp_path / "a.npy", np.array({"trajectories": _trajectories(), "stats": Program()}, dtype=object))
    said = _refused(swimid, tmp_path / "a.npy")
    assert "pickle" in said
    assert "idtrackerai_format a.npy --formats h5" in said
    assert not (tmp_path / "ran").exists()
    np.save(tmp_path / "b.npy", _trajectories())
    record, _ = imported(tmp_path / "b.npy", "--as", "idtrackerai", "--rate-hz", "50", "--select", "1")
    assert np.allclose(record["y_px"], _hidden(-Y_PX), equal_nan=True)


@pytest.mark.parametrize(("mark", "decimal"), [(",", "."), (";", ",")])
def test_kinovea_csv(mark: str, decimal: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """One time column in ms for two tracks; the nose is tracked later than the tail."""

    def cell(value: float) -> str:
        return f'"{value:.3f}"'.replace(".", decimal) if np.isfinite(value) else ""

    names = ["Time", "nose/0/X", "nose/0/Y", "tail tip/0/X", "tail tip/0/Y"]
    rows = [mark.join(f'"{name}"' for name in names)]
    columns = (1000 * T, _hidden(X_M * 100), _hidden(Y_M * 100), 100 * X_M - 8, 100 * Y_M)
    rows += [mark.join(map(cell, row)) for row in zip(*columns, strict=True)]
    (tmp_path / "a.csv").write_text("\r\n".join(rows) + "\r\n")
    assert "--length-unit" in _refused(swimid, tmp_path / "a.csv", "--rate-hz", "50")
    assert "--rate-hz" in _refused(swimid, tmp_path / "a.csv", "--length-unit", "cm")
    record, ran = imported(tmp_path / "a.csv", "--length-unit", "cm", "--rate-hz", "50")
    assert ran.json["result"]["profile"] == "kinovea"
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["nose_x_m"], _hidden(X_M), atol=6e-6, equal_nan=True)
    assert np.allclose(record["tail_tip_y_m"], Y_M, atol=6e-6)


@pytest.mark.parametrize("decimal", [".", ","])
def test_kinovea_text(decimal: str, imported: Imported, tmp_path: Path) -> None:
    lines = ["#Kinovea Trajectory data export", "#T X Y", "", "# nose"]
    rows = [f"{1000 * t:.2f} {x:.5f} {y:.5f}" for t, x, y in zip(T, X_M, Y_M, strict=True)]
    rows += ["", "# tail"]
    rows += [
        f"{1000 * t:.2f} {x - 0.08:.5f} {y:.5f}" for t, x, y in zip(T[5:], X_M[5:], Y_M[5:], strict=True)
    ]
    lines += [row.replace(".", decimal) for row in rows]
    (tmp_path / "a.txt").write_text("\n".join([*lines, ""]) + "\n")
    (tmp_path / "map.yaml").write_text(
        "format: swimid-mapping/1\nas: kinovea\ntime: {source: Time, unit: ms}\nreader: {length_unit: m}\n"
        "columns: [{source: tail_x_m, target: x_m}, {source: tail_y_m, target: y_m}]\n"
    )
    record, _ = imported(tmp_path / "a.txt", "--map", str(tmp_path / "map.yaml"))
    assert np.allclose(record.time_s, T)
    assert np.isnan(record["x_m"][:5]).all()
    assert np.allclose(record["x_m"][5:], X_M[5:] - 0.08, atol=6e-6)


def test_kinovea_annotations(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """A KVA file with the elements that hold tracks: 512 time stamps a frame."""

    def track(name: str, shift: float) -> str:
        points = "".join(
            f"<TrackPoint>{x + shift:.3f};{y:.3f};{1024 + 512 * k}</TrackPoint>"
            for k, (x, y) in enumerate(zip(X_PX, Y_PX, strict=True))
            if k != 7
        )
        listed = f'<TrackPointList Count="{N - 1}">{points}</TrackPointList>'
        return f'<Track id="{name}" name="{name}">{listed}</Track>'

    body = f"<Tracks>{track('nose', 0)}{track('tail', -80)}</Tracks>"
    head = "<AverageTimeStampsPerFrame>512</AverageTimeStampsPerFrame><CaptureFramerate>50</CaptureFramerate>"
    text = (
        f'<?xml version="1.0" encoding="utf-8"?>\n<KinoveaVideoAnalysis>{head}{body}</KinoveaVideoAnalysis>'
    )
    (tmp_path / "a.kva").write_text(text)
    assert "nose, tail" in _refused(swimid, tmp_path / "a.kva")
    record, _ = imported(tmp_path / "a.kva", "--select", "tail")
    assert np.allclose(record.time_s, np.delete(T, 7))
    assert np.allclose(record["x_px"], np.delete(X_PX - 80, 7), atol=6e-4)
    assert np.allclose(record["y_px"], np.delete(-Y_PX, 7), atol=6e-4)
    _refused(swimid, _cut(tmp_path / "a.kva"))


def test_tables_of_lightning_pose_are_those_of_deeplabcut(imported: Imported, tmp_path: Path) -> None:
    columns = pd.MultiIndex.from_product(
        [["heatmap_tracker"], ["nose"], ["x", "y", "likelihood", "x_ens_var"]],
        names=["scorer", "bodyparts", "coords"],
    )
    cells = np.column_stack([X_PX, Y_PX, np.full(N, 0.9), np.full(N, 0.2)])
    pd.DataFrame(cells, columns=columns).to_csv(tmp_path / "a.csv")
    record, ran = imported(tmp_path / "a.csv", "--rate-hz", "50")
    assert ran.json["result"]["profile"] == "deeplabcut"
    assert np.allclose(record["nose_y_px"], -Y_PX)
    assert list(record.columns) == ["t_s", "nose_x_px", "nose_y_px", "nose_likelihood"]


@pytest.mark.parametrize("unit", ["mm", ""])
def test_anipose(unit: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """A table of triangulated points, as Anipose writes it."""
    score = np.full(N, 0.9)
    score[10:15] = 0.1
    cells: dict[str, Any] = {}
    for name, shift in (("nose", 0.0), ("tail_tip", -80.0)):
        place = {"x": 1000 * X_M + shift, "y": 1000 * Y_M, "z": 1000 * Z_M}
        cells |= {f"{name}_{axis}": _hidden(values) for axis, values in place.items()}
        cells |= {f"{name}_error": np.full(N, 0.4), f"{name}_ncams": np.full(N, 3.0), f"{name}_score": score}
    cells |= {f"M_{k}{j}": float(k == j) for k in range(3) for j in range(3)}
    cells |= {f"center_{k}": 0.0 for k in range(3)}
    pd.DataFrame({**cells, "fnum": np.arange(N)}).to_csv(tmp_path / "a.csv", index=False)
    if not unit:
        assert "--length-unit" in _refused(swimid, tmp_path / "a.csv", "--rate-hz", "50")
        return
    record, ran = imported(tmp_path / "a.csv", "--rate-hz", "50", "--length-unit", unit)
    assert ran.json["result"]["profile"] == "anipose"
    true = _hidden(Z_M)
    true[10:15] = np.nan
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["tail_tip_z_m"], true, equal_nan=True)
    assert ran.json["result"]["unlikely"] == {"nose_score": 5, "tail_tip_score": 5}


# ---------------------------------------------------------------- motion capture


def _pose() -> Rotation:
    return Rotation.from_euler("ZYX", np.column_stack([YAW, -0.1 * np.cos(BEAT), 0.05 * np.sin(2 * BEAT)]))


def _motive(path: Path, form: str, bodies: tuple[str, ...] = ("fish",)) -> None:
    """An export of Motive 3 after its documentation: y up, millimetres, an occluded body.

    The turn from z up to y up, and rotations about moving axes, are made with scipy here.
    """
    turn = Rotation.from_euler("x", -90, degrees=True)
    place = turn.apply(np.column_stack([X_M, Y_M, Z_M]) * 1000)
    rotated = turn * _pose() * turn.inv()
    if form == "Quaternion":
        cells, axes = rotated.as_quat(), "XYZW"
    else:
        angles = rotated.as_euler(form, degrees=True)  # upper case: about the axes of the body
        cells, axes = angles[:, [form.index(axis) for axis in "XYZ"]], "XYZ"
    rows: list[list[str]] = [["", "Type"], ["", "Name"], ["", "ID"], ["", ""], ["Frame", "Time (Seconds)"]]
    blocks = []

    def add(kind: str, name: str, what: str, names: str, values: np.ndarray) -> None:
        for row, cell in zip(rows, (kind, name, "4CF0", what), strict=False):
            row += [cell] * len(names)
        rows[4] += list(names)
        blocks.append(values)

    for k, name in enumerate(bodies):
        add("Rigid Body", name, "Rotation", axes, cells)
        add("Rigid Body", name, "Position", "XYZ", place + 100 * k)
        add("Rigid Body Marker", f"{name}:Marker1", "Position", "XYZ", place + 7)
    add(
        "Marker",
        f"{bodies[0]}:nose tip",
        "Position",
        "XYZ",
        turn.apply(np.column_stack([X_M, Y_M, Z_M]) * 1000),
    )
    add("Marker", "Unlabeled 1021", "Position", "XYZ", place)
    values = np.column_stack(blocks)
    values[GAP, : len(axes) + 3] = np.nan
    stated = {
        "Format Version": 1.25, "Take Name": "swim", "Take Notes": "", "Capture Frame Rate": 50,
        "Export Frame Rate": 50, "Total Frames in Take": N, "Total Exported Frames": N, "Rotation Type": form,
        "Length Units": "Millimeters", "Coordinate Space": "Global",
    }  # fmt: skip
    head = ",".join(f"{key},{value}" for key, value in stated.items())
    lines = [head, "", *(",".join(row) for row in rows)]
    for k, row in enumerate(values):
        lines.append(",".join([str(k), f"{T[k]:.6f}", *("" if np.isnan(v) else f"{v:.6f}" for v in row)]))
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("form", ["Quaternion", "XYZ", "YXZ"])
def test_optitrack(form: str, imported: Imported, tmp_path: Path) -> None:
    _motive(tmp_path / "a.csv", form)
    record, ran = imported(tmp_path / "a.csv")
    assert ran.json["result"]["profile"] == "optitrack"
    assert np.allclose(record.time_s, T)
    for name, true in (("x_m", X_M), ("y_m", Y_M), ("z_m", Z_M), ("yaw_rad", YAW)):
        assert np.allclose(record[name], _hidden(true), atol=5e-6, equal_nan=True), name
    assert np.allclose(record["pitch_rad"], _hidden(0.1 * np.cos(BEAT)), atol=5e-6, equal_nan=True)
    assert np.allclose(record["fish_nose_tip_z_m"], Z_M, atol=2e-9)
    assert not [name for name in record.columns if "Unlabeled" in name]


def test_optitrack_bodies_and_a_cut_file(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    _motive(tmp_path / "a.csv", "Quaternion", ("fish", "buoy"))
    said = _refused(swimid, tmp_path / "a.csv")
    assert "2 rigid bodies" in said
    assert "fish, buoy" in said
    record, _ = imported(tmp_path / "a.csv", "--select", "buoy")
    assert np.allclose(record["x_m"], X_M + 0.1, atol=2e-9)
    said = _refused(swimid, _shortened(tmp_path / "a.csv"), "--select", "buoy")
    assert f"states {N} frames, but the file ends after {N - 10}" in said
    assert "ends within a line" in _refused(swimid, _cut(tmp_path / "a.csv", 0.8), "--select", "buoy")


@pytest.mark.parametrize(("headings", "rate"), [(True, 50), (False, 50), (False, 0.5)])
def test_qualisys_markers(
    headings: bool, rate: float, imported: Imported, swimid: Run, tmp_path: Path
) -> None:
    lines = [
        f"NO_OF_FRAMES\t{N}", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t2", f"FREQUENCY\t{rate}",
        "NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--",
        "TIME_STAMP\t2022-06-03, 10:47:36.627\t94247.45402301",
        "DATA_INCLUDED\t3D", "MARKER_NAMES\tnose\ttail tip", "TRAJECTORY_TYPES\tMeasured\tMeasured",
    ]  # fmt: skip
    if headings:
        lines.append("Frame\tTime\tnose X\tnose Y\tnose Z\ttail tip X\ttail tip Y\ttail tip Z")
    for k in range(N):
        nose = [1000 * X_M[k], 1000 * Y_M[k], 1000 * Z_M[k]]
        if 30 <= k < 36:
            nose = [0.0, 0.0, 0.0]
        tail = [f"{1000 * X_M[k] - 80:.3f}", f"{1000 * Y_M[k]:.3f}", f"{1000 * Z_M[k]:.3f}"]
        if k == 50:
            tail = ["NULL", "NULL", "NULL"]
        stamps = [str(k + 1), f"{T[k]:.5f}"] if headings else []
        lines.append("\t".join([*stamps, *(f"{v:.3f}" for v in nose), *tail]))
    (tmp_path / "a.tsv").write_text("\r\n".join(lines) + "\r\n")
    record, ran = imported(tmp_path / "a.tsv")
    assert ran.json["result"]["profile"] == "qualisys"
    assert np.allclose(record.time_s, T * 50 / rate)
    assert np.allclose(record["nose_z_m"], _hidden(Z_M), atol=1e-6, equal_nan=True)
    assert np.isnan(record["tail_tip_x_m"][50])
    assert np.allclose(np.delete(record["tail_tip_x_m"], 50), np.delete(X_M - 0.08, 50), atol=1e-6)
    assert f"states {N} frames" in _refused(swimid, _shortened(tmp_path / "a.tsv"))


def test_qualisys_bodies(imported: Imported, tmp_path: Path) -> None:
    """Rows of a real export have Rot[1] = sin(yaw): the matrix stands column by column."""
    angles = [f"Rot[{k}]" for k in range(9)]
    names = ["fish X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *angles]
    lines = [
        f"NO_OF_FRAMES\t{N}",
        "NO_OF_BODIES\t1",
        "FREQUENCY\t50",
        "DATA_INCLUDED\t6D",
        "BODY_NAMES\tfish",
    ]
    lines.append("\t".join(["Frame", "Time", *names]))
    matrices = _pose().as_matrix()
    for k in range(N):
        cells = [1000 * X_M[k], 1000 * Y_M[k], 1000 * Z_M[k], 0, 0, 0, 0.4, *matrices[k].T.ravel()]
        if 30 <= k < 36:
            cells = [0.0] * 6 + [-1.0] + [0.0] * 9
        lines.append("\t".join([str(k + 1), f"{T[k]:.5f}", *(f"{v:.5f}" for v in cells)]))
    (tmp_path / "a.tsv").write_text("\n".join(lines) + "\n")
    record, _ = imported(tmp_path / "a.tsv")
    assert np.allclose(record["x_m"], _hidden(X_M), atol=1e-7, equal_nan=True)
    assert np.allclose(record["yaw_rad"], _hidden(YAW), atol=1e-4, equal_nan=True)
    assert np.allclose(record["pitch_rad"], _hidden(0.1 * np.cos(BEAT)), atol=1e-4, equal_nan=True)


@pytest.mark.parametrize("mark", [",", "\t"])
def test_vicon(mark: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """A plate sampled ten times a frame, and two markers, from frame 11 on."""
    lines = ["Devices", "500", mark.join(["", "", "Plate #1 - Force", "", "", "Pot - Voltage"])]
    lines += [
        mark.join(["Frame", "Sub Frame", "Fx", "Fy", "Mz", "1"]),
        mark.join(["", "", "N", "mN", "N.mm", "V"]),
    ]
    time = np.arange(10 * N) / 500
    for k, t in enumerate(time):
        cells = [f"{np.sin(9 * t):.6f}", f"{1000 * t:.4f}", f"{500 * t:.4f}", "1.5"]
        lines.append(mark.join([str(11 + k // 10), str(k % 10), *cells]))
    lines += ["", "Trajectories", "50", mark.join(["", "", "fish:nose", "", "", "fish:tail tip", "", ""])]
    lines += [mark.join(["Frame", "Sub Frame", *"XYZXYZ"]), mark.join(["", "", *["mm"] * 6])]
    for k in range(N):
        nose = [f"{1000 * v:.6g}" for v in (X_M[k], Y_M[k], Z_M[k])]
        if 30 <= k < 36:
            nose = ["", "", ""]
        tail = [f"{1000 * v:.6g}" for v in (X_M[k] - 0.08, Y_M[k], Z_M[k])]
        lines.append(mark.join([str(11 + k), "0", *nose, *tail]))
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    assert "Devices, Trajectories" in _refused(swimid, tmp_path / "a.csv")
    record, ran = imported(tmp_path / "a.csv", "--select", "Trajectories")
    assert ran.json["result"]["profile"] == "vicon"
    assert np.allclose(record.time_s, T + 0.2)
    assert np.allclose(record["nose_x_m"], _hidden(X_M), atol=1e-6, equal_nan=True)
    assert np.allclose(record["tail_tip_z_m"], Z_M, atol=1e-6)
    plate, _ = imported(tmp_path / "a.csv", "--select", "Devices")
    assert np.allclose(plate.time_s, time + 0.2)
    assert np.allclose(plate["Plate_1_Force_Fx_N"], np.sin(9 * time), atol=1e-6)
    assert np.allclose(plate["Plate_1_Force_Fy_N"], time, atol=1e-6)
    assert np.allclose(plate["Plate_1_Force_Mz_Nm"], 0.5 * time, atol=1e-6)
    assert np.allclose(plate["Pot_Voltage_1_V"], 1.5)
    assert "ends within a line" in _refused(
        swimid, _cut(tmp_path / "a.csv", 0.9995), "--select", "Trajectories"
    )


def _c3d(path: Path, vertical: str, *, analog: bool) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    place = {"+Z": (X_M, Y_M, Z_M), "+Y": (X_M, Z_M, -Y_M), "": (X_M, Y_M, Z_M)}[vertical]
    points = np.ones((4, 2, N))
    points[:3, 0] = 1000 * np.array(place)
    points[:3, 1] = 1000 * np.array(place) - 80
    residuals = np.zeros((1, 2, N))
    points[:3, 0, GAP], residuals[0, 0, GAP] = np.nan, -1
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = residuals
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [RATE], ["mm"]
    point["LABELS"]["value"] = ["nose", "tail tip"]
    if vertical:
        file.add_parameter("POINT", "Y_SCREEN", [vertical])
    if analog:
        part = file["parameters"]["ANALOG"]
        part["RATE"]["value"], part["UNITS"]["value"] = [10 * RATE], ["N", "Nmm"]
        part["LABELS"]["value"] = ["Fx", "Mz"]
        time = np.arange(10 * N) / (10 * RATE)
        file["data"]["analogs"] = np.array([np.sin(9 * time), 500 * time])[None]
    file.write(str(path))


@pytest.mark.parametrize("vertical", ["+Z", "+Y", ""])
def test_c3d(vertical: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    _c3d(tmp_path / "a.c3d", vertical, analog=False)
    record, ran = imported(tmp_path / "a.c3d")
    assert np.allclose(record.time_s, T)
    for axis, true in (("x", X_M), ("y", Y_M), ("z", Z_M)):
        assert np.allclose(record[f"nose_{axis}_m"], _hidden(true), atol=1e-6, equal_nan=True), axis
    assert np.allclose(record["tail_tip_x_m"], X_M - 0.08, atol=1e-6)
    assert ("does not state its vertical axis" in ran.err) == (vertical == "")


def test_c3d_analog(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    _c3d(tmp_path / "a.c3d", "+Z", analog=True)
    assert "points, analog" in _refused(swimid, tmp_path / "a.c3d")
    record, _ = imported(tmp_path / "a.c3d", "--select", "analog")
    time = np.arange(10 * N) / 500
    assert np.allclose(record.time_s, time)
    assert np.allclose(record["Fx_N"], np.sin(9 * time), atol=1e-6)
    assert np.allclose(record["Mz_Nm"], 0.5 * time, atol=1e-6)
    _refused(swimid, _cut(tmp_path / "a.c3d"), "--select", "points")


# ---------------------------------------------------------------- laboratory


def _tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_start_offset": 0.5, "wf_increment": 0.02}
    channels = [
        nptdms.ChannelObject("balance", "Fx", 1000 * np.sin(BEAT), {"unit_string": "mN", **clock}),
        nptdms.ChannelObject("balance", "load", np.full(N, 9.0), {"unit_string": "g", **clock}),
        nptdms.ChannelObject("encoder", "Time", 1000 * T, {"unit_string": "ms"}),
        nptdms.ChannelObject("encoder", "carriage", 100 * X_M, {"unit_string": "cm"}),
    ]
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.RootObject({"operator": "ann"}), *channels])


def test_tdms(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    _tdms(tmp_path / "a.tdms")
    assert "balance, encoder" in _refused(swimid, tmp_path / "a.tdms")
    record, ran = imported(tmp_path / "a.tdms", "--select", "balance")
    assert np.allclose(record.time_s, 0.5 + T)
    assert np.allclose(record["Fx_N"], np.sin(BEAT))
    assert record.metadata["operator"] == "ann"
    # gram is a unit of mass, and g one of acceleration: only a mapping can state which
    assert "load" in ran.err
    assert "load" not in " ".join(record.columns)
    encoder, _ = imported(tmp_path / "a.tdms", "--select", "encoder")
    assert np.allclose(encoder.time_s, T)
    assert np.allclose(encoder["carriage_m"], X_M)
    _refused(swimid, _cut(tmp_path / "a.tdms", 0.3))


@pytest.mark.parametrize(("form", "decimal"), [("One", "."), ("No", ",")])
def test_lvm(form: str, decimal: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    """A file after the specification of NI, with a special block and a comment in its first row."""

    def number(value: float) -> str:
        return f"{value:.6f}".replace(".", decimal)

    head = [
        "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab",
        f"Decimal_Separator\t{decimal}", "Multi_Headings\tNo", f"X_Columns\t{form}", "Time_Pref\tRelative",
        "Operator\tann", "Date\t2019/07/22", f"Time\t17:18:18{decimal}938945", "***End_of_Header***\t", "\t",
        "Channels\t2\t\t", f"Samples\t{N}\t{N}\t", "Y_Unit_Label\tNewtons\tmm\t", "X_Dimension\tTime\tTime\t",
        f"X0\t{number(0.5)}\t{number(0.5)}\t", f"Delta_X\t{number(0.02)}\t{number(0.02)}\t",
        "***End_of_Header***\t\t\t", "X_Value\tFx\tcarriage\tComment",
    ]  # fmt: skip
    for k in range(N):
        x = number(0.5 + T[k]) if form == "One" else ""
        head.append(f"{x}\t{number(np.sin(BEAT[k]))}\t{number(1000 * X_M[k])}" + "\tstart" * (k == 0))
    (tmp_path / "a.lvm").write_text("\r\n".join(head) + "\r\n")
    record, _ = imported(tmp_path / "a.lvm")
    assert np.allclose(record.time_s, 0.5 + T, atol=1e-6)
    assert np.allclose(record["Fx_N"], np.sin(BEAT), atol=1e-6)
    assert np.allclose(record["carriage_m"], X_M, atol=1e-6)
    (tmp_path / "b.lvm").write_text("\r\n".join(head[:18]))
    _refused(swimid, tmp_path / "b.lvm")


def test_workbook(imported: Imported, swimid: Run, tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "notes"
    book.active["A1"] = "tank 3"
    sheet = book.create_sheet("run 1")
    sheet.append(["t_s", "x_m", "load"])
    sheet.append([None, None, None])
    for k in range(N):
        sheet.append([T[k], None if 30 <= k < 36 else X_M[k], "#N/A" if k == 4 else 20.0 * T[k]])
    book.save(tmp_path / "a.xlsx")
    assert "notes, run 1" in _refused(swimid, tmp_path / "a.xlsx")
    record, _ = imported(tmp_path / "a.xlsx", "--select", "run 1")
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["x_m"], _hidden(X_M), equal_nan=True)
    (tmp_path / "map.yaml").write_text(
        "format: swimid-mapping/1\nselect: run 1\ntime: {source: t_s}\n"
        "columns: [{source: load, target: force_N, unit: gf}]\n"
    )
    mapped, _ = imported(tmp_path / "a.xlsx", "--map", str(tmp_path / "map.yaml"))
    assert np.isnan(mapped["force_N"][4])
    assert np.allclose(np.delete(mapped["force_N"], 4), np.delete(0.02 * 9.80665 * T, 4))
    _refused(swimid, _cut(tmp_path / "a.xlsx"))


@pytest.mark.parametrize("form", ["{}:{} {}:{} {}:{}", "{}={},\t{}={},\t{}={}"])
def test_lines_of_a_serial_monitor(form: str, imported: Imported, swimid: Run, tmp_path: Path) -> None:
    lines = ["12 fy:0.3"]  # the recording begins within a line
    for k, t in enumerate(T):
        line = form.format("ms", round(1000 * t), "x_m", f"{X_M[k]:.6f}", "fy", f"{-np.sin(BEAT[k]):.6f}")
        if k == 7:
            line = line.replace("fy", "fy ").rpartition("fy")[0].rstrip(" ,\t")
        lines.append(line)
    (tmp_path / "a.txt").write_text("\r\n".join(lines) + "\r\n")
    (tmp_path / "map.yaml").write_text(
        "format: swimid-mapping/1\ntime: {source: ms, unit: ms}\n"
        "columns: [{source: x_m, target: x_m}, {source: fy, target: force_N, unit: mN}]\n"
    )
    record, ran = imported(tmp_path / "a.txt", "--map", str(tmp_path / "map.yaml"))
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["x_m"], X_M, atol=1e-6)
    assert np.isnan(record["force_N"][7])
    assert np.allclose(np.delete(record["force_N"], 7), np.delete(-1e-3 * np.sin(BEAT), 7), atol=1e-9)
    assert "first: line 1" in ran.err
    assert "t_s" in _refused(swimid, tmp_path / "a.txt")


@pytest.mark.parametrize(
    "name",
    [
        "movement", "coco", "trackpy", "idtrackerai", "kinovea", "optitrack", "qualisys", "vicon", "c3d",
        "tdms", "lvm", "anipose", "deeplabcut", "sleap", "tracker", "opensim", "ardupilot", "dynamixel",
    ],
)  # fmt: skip
def test_a_file_that_is_none_of_the_format_named(name: str, swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,x_m\n0,1\n1,2\n2,3\n")
    _refused(swimid, tmp_path / "a.csv", "--as", name)
