"""Clocks of imported logs: times that a file states, start times of channels, and two clocks in one log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swimid.errors import InputError
from swimid.imports import mapping
from tests.conftest import Ran

Run = Callable[..., Ran]
N, RATE = 120, 50.0
T = np.arange(N) / RATE
X_M, Y_M = 0.1 + 0.2 * T, 0.02 * np.sin(2 * np.pi * 1.4 * T)


def _text(path: Path, head: list[str], row: str) -> None:
    rows = [
        row.format(k=k, n=k + 1, t=t, us=round(1e6 * t), x=1000 * X_M[k], y=1000 * Y_M[k])
        for k, t in enumerate(T)
    ]
    path.write_text("\n".join([*head, *rows]) + "\n")


def _vicon(path: Path) -> None:
    names = "Frame,Sub Frame,X,Y"
    _text(path, ["Trajectories", "50", ",,nose,", names, ",,mm,mm"], "{n},0,{x:.4f},{y:.4f}")


def _opensim(path: Path) -> None:
    head = ["PathFileType\t4\t(X/Y/Z)\ta.trc", "DataRate\tUnits", "50\tmm", "Frame#\tTime\tnose\t\t"]
    _text(path, [*head, "\t\tX1\tY1\tZ1", ""], "{n}\t{t:.5f}\t{x:.4f}\t{y:.4f}\t2.5")


def _tracker(path: Path) -> None:
    _text(path, ["nose\t\t", "t\tx (mm)\ty (mm)"], "{t:.6f}\t{x:.4f}\t{y:.4f}")


def _qualisys(path: Path) -> None:
    head = [f"NO_OF_FRAMES\t{N}", "FREQUENCY\t50", "DATA_INCLUDED\t3D", "MARKER_NAMES\tnose"]
    _text(path, head, "{x:.4f}\t{y:.4f}\t2.5")


def _lvm(path: Path) -> None:
    head = [
        "LabVIEW Measurement",
        "Separator\tTab",
        "X_Columns\tNo",
        "***End_of_Header***",
        "",
        "Channels\t2",
    ]
    head += ["Y_Unit_Label\tmm\tmm", "X_Dimension\tTime\tTime", "X0\t0\t0", "Delta_X\t0.02\t0.02"]
    _text(path, [*head, "***End_of_Header***", "X_Value\tx\ty\tComment"], "\t{x:.4f}\t{y:.4f}\t")


def _tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_increment": 0.02, "unit_string": "m"}
    with nptdms.TdmsWriter(str(path)) as writer:
        channels = [nptdms.ChannelObject("rig", name, v, clock) for name, v in (("x", X_M), ("y", Y_M))]
        writer.write_segment(channels)


def _dynamixel(path: Path) -> None:
    _text(path, ["Time (us),Present Position,Goal Position"], "{us},{x:.0f},2000")


def _ardupilot(path: Path) -> None:
    _text(path, ["TimeUS,GyrX,GyrY,GyrZ"], "{us},{x:.4f},{y:.4f},0")


#: Writer, format, a column of the log of each file that states its times, and its factor from X_M.
FILES = {
    "a.csv": (_vicon, "vicon", "nose_x_m"),
    "a.trc": (_opensim, "opensim", "nose_x_m"),
    "a.txt": (_tracker, "tracker", "x_m"),
    "a.tsv": (_qualisys, "qualisys", "nose_x_m"),
    "a.lvm": (_lvm, "lvm", "x_m"),
    "a.tdms": (_tdms, "tdms", "x_m"),
    "servo.csv": (_dynamixel, "dynamixel-x", "joint1_rad"),
    "imu.csv": (_ardupilot, "ardupilot", "wx_rad_s"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_mapping_of_chosen_columns_keeps_the_times_of_the_file(name: str, tmp_path: Path) -> None:
    write, kind, column = FILES[name]
    write(tmp_path / name)
    rules = mapping.read_mapping({"as": kind, "columns": [{"source": column, "target": f"chosen_{column}"}]})
    found = mapping.apply(rules, tmp_path / name)
    assert np.allclose(found.time_s, T, atol=1e-5)
    assert list(found.columns) == ["t_s", f"chosen_{column}"]
    # a rate that agrees changes nothing, and any other contradicts the file
    assert np.allclose(mapping.apply(rules, tmp_path / name, {"rate_hz": 50.1}).time_s, T, atol=1e-5)
    for chosen in (rules, None):
        with pytest.raises(InputError, match=r"at 50 Hz: a rate of 25.0 Hz contradicts"):
            mapping.apply(chosen, tmp_path / name, {"rate_hz": 25.0, "profile": kind})
    later = mapping.read_mapping({"as": kind, "time": {"offset_s": -0.7}})
    assert np.allclose(mapping.apply(later, tmp_path / name).time_s, T - 0.7, atol=1e-5)


def test_a_file_without_a_clock_is_asked_for_its_column_of_times(tmp_path: Path) -> None:
    _text(tmp_path / "a.csv", ["Time,force"], "{us},{x:.4f}")
    rules = mapping.read_mapping({"as": "delimited", "columns": [{"source": "force", "target": "force_N"}]})
    with pytest.raises(InputError) as refused:
        mapping.apply(rules, tmp_path / "a.csv")
    assert "source: Time" in str(refused.value.hint)
    assert "rate" not in str(refused.value.hint)


# ---------------------------------------------------------------- start times of channels


def _late(path: Path, shift_s: float, **other: Any) -> None:
    """A position from 10:00:00 on, and a force that starts later."""
    nptdms = pytest.importorskip("nptdms")
    start, clock = np.datetime64("2025-03-04T10:00:00.000000"), {"wf_increment": 0.02, "wf_start_offset": 0.0}
    later = start + np.timedelta64(round(1e6 * shift_s), "us")
    force = np.sin(3 * (T + shift_s))
    with nptdms.TdmsWriter(str(path)) as writer:
        channels = [
            nptdms.ChannelObject("rig", "x", X_M, {**clock, "wf_start_time": start, "unit_string": "m"}),
            nptdms.ChannelObject(
                "rig", "force", force, {**clock, "wf_start_time": later, "unit_string": "N"} | other
            ),
        ]
        writer.write_segment(channels)


@pytest.mark.parametrize("shift_s", [0.4, -0.4, 0.0, 0.41])
def test_channels_of_tdms_that_start_at_other_times(shift_s: float, tmp_path: Path) -> None:
    _late(tmp_path / "a.tdms", shift_s)
    found = mapping.apply(None, tmp_path / "a.tdms")
    assert np.allclose(found.columns["x_m"], 0.1 + 0.2 * found.time_s)
    assert np.allclose(found.columns["force_N"], np.sin(3 * found.time_s), atol=6e-4)
    assert len(found) == N - np.ceil(abs(shift_s) * RATE - 1e-6)
    assert ("channels_start_s" in found.metadata) == (shift_s != 0)
    assert ("interpolated" in " ".join(found.notes)) == (shift_s == 0.41)
    _late(tmp_path / "b.tdms", 10.0)
    with pytest.raises(InputError, match="no time in common"):
        mapping.apply(None, tmp_path / "b.tdms")
    _late(tmp_path / "c.tdms", 0.0, wf_increment=0.01)
    with pytest.raises(InputError, match="intervals"):
        mapping.apply(None, tmp_path / "c.tdms")


@pytest.mark.parametrize("key", ["X0\t0\t0.4", "Time\t10:00:00.0\t10:00:00.4000000000000000000"])
def test_channels_of_a_labview_file_that_start_at_other_times(key: str, tmp_path: Path) -> None:
    _lvm(tmp_path / "a.lvm")
    text = (tmp_path / "a.lvm").read_text().replace("X0\t0\t0", f"Date\t2025/03/04\t2025/03/04\n{key}")
    (tmp_path / "a.lvm").write_text(text)
    found = mapping.apply(None, tmp_path / "a.lvm")
    assert np.allclose(found.columns["x_m"], 0.1 + 0.2 * found.time_s, atol=1e-6)
    assert np.allclose(found.columns["y_m"], 0.02 * np.sin(2 * np.pi * 1.4 * (found.time_s - 0.4)), atol=1e-6)
    assert len(found) == N - 20


def test_sections_of_a_recording_with_other_rates_and_starts_are_joined_by_their_frames(
    tmp_path: Path,
) -> None:
    lines = ["Devices", "500", ",,Plate,", "Frame,Sub Frame,Fx", ",,N"]
    lines += [f"{11 + k // 10},{k % 10},{np.sin(3 * (0.2 + k / 500)):.6f}" for k in range(10 * N)]
    lines += ["", "Trajectories", "50", ",,nose,", "Frame,Sub Frame,X,Y", ",,mm,mm"]
    lines += [f"{31 + k},0,{1000 * X_M[k]:.4f},{1000 * Y_M[k]:.4f}" for k in range(N - 20)]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    columns = [{"source": "Plate_Fx_N", "target": "force_N"}]
    join = {"as": "vicon", "select": "Devices", "columns": columns}
    found = mapping.apply(
        mapping.read_mapping({"as": "vicon", "select": "Trajectories", "join": [join]}), tmp_path / "a.csv"
    )
    assert np.allclose(found.time_s, 0.6 + T[: N - 20])
    assert np.allclose(found.columns["force_N"], np.sin(3 * found.time_s), atol=1e-4)


def test_points_and_analog_channels_of_one_recording_share_a_clock(tmp_path: Path) -> None:
    ezc3d = pytest.importorskip("ezc3d")
    file = ezc3d.c3d()
    file["data"]["points"] = np.ones((4, 1, N))
    file["data"]["points"][0, 0] = 1000 * X_M
    point, analog = file["parameters"]["POINT"], file["parameters"]["ANALOG"]
    point["RATE"]["value"], point["UNITS"]["value"], point["LABELS"]["value"] = [RATE], ["mm"], ["nose"]
    analog["RATE"]["value"], analog["UNITS"]["value"] = [10 * RATE], ["N", "N"]
    analog["LABELS"]["value"] = ["Fx", "Fy"]
    file["data"]["analogs"] = np.array([np.sin(3 * np.arange(10 * N) / 500), np.zeros(10 * N)])[None]
    file.write(str(tmp_path / "a.c3d"))
    join = {"as": "c3d", "select": "analog", "columns": [{"source": "Fx_N", "target": "force_N"}]}
    found = mapping.apply(
        mapping.read_mapping({"as": "c3d", "select": "points", "join": [join]}), tmp_path / "a.c3d"
    )
    assert np.allclose(found.columns["force_N"], np.sin(3 * found.time_s), atol=1e-4)


# ---------------------------------------------------------------- units that a file states


def test_units_of_netcdf_are_used_and_a_mapping_must_not_contradict_them(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    columns = {"x": ("time", 1000 * X_M, {"units": "mm"}), "yaw": ("time", 10 * Y_M, {"units": "degrees"})}
    time = ("time", np.round(1000 * T).astype(int), {"units": "milliseconds since 2024-05-01"})
    data = xarray.Dataset(columns, coords={"time": time})
    plain = {"time": {"source": "time"}, "columns": [{"source": "x", "target": "x_m"}]}
    heading = [{"source": "yaw", "target": "yaw_rad"}]
    for name, engine in (("a.nc", "h5netcdf"), ("b.nc", "scipy")):
        data.to_netcdf(tmp_path / name, engine=engine)
        found = mapping.apply(
            mapping.read_mapping(plain | {"columns": plain["columns"] + heading}), tmp_path / name
        )
        assert np.allclose(found.time_s, T)
        assert np.allclose(found.columns["x_m"], X_M)
        assert np.allclose(found.columns["yaw_rad"], np.radians(10 * Y_M))
        drafted = mapping.guess_mapping(tmp_path / name).document
        assert 'unit: "ms"' in drafted
        assert "ASK" not in drafted.partition("columns:")[2]
    for wrong, words in (
        ({"time": {"source": "time", "unit": "ns"}}, "states ms for the times, the mapping states ns"),
        ({"columns": [{"source": "x", "target": "x_m", "unit": "cm"}]}, "states mm, the mapping states cm"),
    ):
        with pytest.raises(InputError, match=words):
            mapping.apply(mapping.read_mapping(plain | wrong), tmp_path / "a.nc")


# ---------------------------------------------------------------- two clocks


def _swim(folder: Path, *, steady: bool, offset_s: float) -> None:
    """A camera at 30 Hz and a controller at 50 Hz; the yaw follows the command after 0.05 s, mirrored."""
    rng, camera, controller = np.random.default_rng(1), np.arange(0, 14, 1 / 30), np.arange(-1, 16, 0.02)

    def command(t: np.ndarray) -> np.ndarray:
        ramp = np.ones(len(t)) if steady else np.clip(t - 2, 0, 1)
        return 20 * ramp * np.sin(2 * np.pi * 1.2 * t)

    yaw = -0.6 * np.radians(command(camera - 0.05)) + 0.004 * rng.standard_normal(len(camera)) + 0.02 * camera
    rows = [f"{t:.4f},{0.2 * t:.4f},0,{a:.5f}" for t, a in zip(camera, yaw, strict=True)]
    (folder / "camera.csv").write_text("\n".join(["t_s,x_m,y_m,yaw_rad", *rows]) + "\n")
    rows = [
        f"{1000 * (t + offset_s):.0f};{c:.3f}" for t, c in zip(controller, command(controller), strict=True)
    ]
    (folder / "controller.txt").write_text("\n".join(["millis;cmd_deg", *rows]) + "\n")


def _aligned(folder: Path, align: dict[str, Any], **time: Any) -> mapping.MappedLog:
    column = {"source": "cmd_deg", "target": "cmd1_rad", "unit": "deg"}
    join: dict[str, Any] = {
        "file": "controller.txt", "time": {"source": "millis", "unit": "ms", **time}, "columns": [column]
    }  # fmt: skip
    if align:
        join["align"] = align
    return mapping.apply(mapping.read_mapping({"as": "swimid", "join": [join]}), folder / "camera.csv")


def test_two_clocks_are_aligned_by_the_command_and_the_yaw(tmp_path: Path) -> None:
    _swim(tmp_path, steady=False, offset_s=7203.4)
    found = _aligned(tmp_path, {"this": "yaw_rad", "that": "cmd1_rad"})
    stated = found.metadata["clock_offsets"]["controller.txt"]
    assert stated["offset_s"] == pytest.approx(-7203.4 + 0.05, abs=4 * stated["sd_s"] + 1e-3)
    assert 0 < stated["sd_s"] < 0.005
    assert [note.partition(",")[0] for note in found.notes] == [
        "the clock offset of controller.txt includes the lag of yaw_rad behind cmd1_rad"
    ]
    started = found.time_s[np.argmax(np.abs(found.columns["cmd1_rad"]) > 0.03)]
    assert started == pytest.approx(2.35, abs=0.15)
    # the source of the column names it as well, and a stated offset needs no estimate
    same = _aligned(tmp_path, {"this": "yaw_rad", "that": "cmd_deg"})
    assert same.metadata["clock_offsets"]["controller.txt"]["offset_s"] == stated["offset_s"]
    given = _aligned(tmp_path, {}, offset_s=-7203.35)
    assert np.nanmax(np.abs(given.columns["cmd1_rad"] - found.columns["cmd1_rad"])) < 0.02


def test_the_offset_of_a_periodic_motion_is_ambiguous(swimid: Run, tmp_path: Path) -> None:
    _swim(tmp_path, steady=True, offset_s=0.7)
    found = _aligned(tmp_path, {"this": "yaw_rad", "that": "cmd1_rad"})
    assert "ambiguous" in found.notes[-1]
    near = _aligned(tmp_path, {"this": "yaw_rad", "that": "cmd1_rad", "within_s": 0.2}, offset_s=-0.6)
    assert not any("ambiguous" in note for note in near.notes)
    assert near.metadata["clock_offsets"]["controller.txt"]["offset_s"] == pytest.approx(-0.65, abs=0.005)
    (tmp_path / "map.yaml").write_text(
        "format: swimid-mapping/1\nas: swimid\njoin:\n"
        "  - {file: controller.txt, time: {source: millis, unit: ms}, "
        "columns: [{source: cmd_deg, target: cmd1_rad, unit: deg}], align: {this: yaw_rad, that: cmd1_rad}}\n"
    )
    ran = swimid("import", tmp_path / "camera.csv", "--map", tmp_path / "map.yaml", "-o", tmp_path / "o.csv")
    assert ran.status == 0
    assert "clock of controller.txt" in ran.out
    assert "CAUTION" in ran.out
    assert "within_s" in ran.err


@pytest.mark.parametrize(
    ("align", "words"),
    [
        ({"this": "yaw", "that": "cmd1_rad"}, "no such column"),
        ({"this": "yaw_rad", "that": "cmd2_rad"}, "no such column"),
        ({"this": "y_m", "that": "cmd1_rad"}, "explains only"),
    ],
)
def test_clocks_that_cannot_be_aligned(align: dict[str, str], words: str, tmp_path: Path) -> None:
    _swim(tmp_path, steady=False, offset_s=0.7)
    with pytest.raises(InputError, match=words):
        _aligned(tmp_path, align)
