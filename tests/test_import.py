"""swimid import: every foreign format, mappings, order, and what is refused."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from swimid.imports import mapping
from swimid.imports.formats import formats, open_table
from swimid.logs import log
from tests.conftest import ROOT, Ran

Run = Callable[..., Ran]
N = 50
TIME_MS = np.arange(N) * 20.0
X_MM = 100.0 + 3.0 * np.arange(N)
YAW_DEG = 10 * np.sin(np.arange(N) / 3)
MAP = """\
format: swimid-mapping/1
{reader}
time: {{source: {time}, unit: ms}}
columns:
  - {{source: {x}, target: x_m, unit: mm}}
  - {{source: {yaw}, target: yaw_rad, unit: deg, factor: -1, offset: 0.5}}
metadata: {{robot: fish}}
"""


def _text(
    path: Path, delimiter: str = ",", header: bool = True, decimal: str = ".", encoding: str = "utf-8"
) -> None:
    rows = [["Time (ms)", "X [mm]", "Yaw (°)"]] if header else []
    rows += [
        [f"{v:.6f}".replace(".", decimal) for v in row] for row in zip(TIME_MS, X_MM, YAW_DEG, strict=True)
    ]
    path.write_bytes("".join(delimiter.join(row) + "\n" for row in rows).encode(encoding))


def _mat(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"t": TIME_MS, "run": {"pose": np.column_stack([X_MM, YAW_DEG]), "who": "us"}, "fs": 50.0})


def _mark_as_73(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    raw[: len(head)] = head
    path.write_bytes(raw)


def _mat73(path: Path) -> None:
    """What MATLAB writes with -v7.3: HDF5 behind a text block, arrays transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", TIME_MS[:, None]), ("pose", np.column_stack([X_MM, YAW_DEG]))):
            file[name] = values.T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    _mark_as_73(path)


def _mat_cells(path: Path) -> None:
    from scipy.io import savemat

    cells = np.empty(2, dtype=object)
    cells[:] = [TIME_MS, YAW_DEG]
    savemat(path, {"run": {"cells": cells, "who": "us"}})


def _mat73_cells(path: Path) -> None:
    """A cell array of version 7.3: references to arrays that lie in another group."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("a", TIME_MS), ("b", YAW_DEG)):
            file[f"#refs#/{name}"] = values[None, :]
            file[f"#refs#/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        found = [[file["#refs#/a"].ref], [file["#refs#/b"].ref]]
        file["run/cells"] = np.array(found, dtype=h5py.ref_dtype)
        file["run/cells"].attrs["MATLAB_class"] = np.bytes_("cell")
        file["run/who"] = np.array([[117], [115]], dtype=np.uint16)
        file["run/who"].attrs["MATLAB_class"] = np.bytes_("char")
    _mark_as_73(path)


def _parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(
        pa.table({"t": TIME_MS.astype(np.int64), "x": X_MM.astype(np.float32), "yaw": YAW_DEG}), path
    )


def _mcap(path: Path) -> None:
    writer_of = pytest.importorskip("mcap_ros2.writer")
    with path.open("wb") as stream:
        writer = writer_of.Writer(stream)
        schema = writer.register_msgdef(
            "fish_msgs/msg/Pose",
            "float64 ms\ngeometry_msgs/Point at\nfloat64 yaw\n"
            + "=" * 80
            + "\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n",
        )
        other = writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n")
        for k in range(N):
            stamp = 1_700_000_000_000_000_000 + int(TIME_MS[k] * 1e6)
            message = {"ms": TIME_MS[k], "at": {"x": X_MM[k], "y": 0.0, "z": 0.0}, "yaw": YAW_DEG[k]}
            writer.write_message("/pose", schema, message, log_time=stamp, publish_time=stamp)
            writer.write_message("/depth", other, {"data": 1.0}, log_time=stamp, publish_time=stamp)
        writer.finish()


def _ulog(path: Path) -> None:
    """The smallest ULog file: header, format, subscription, data (docs.px4.io, ULog file format)."""
    pytest.importorskip("pyulog")
    import struct

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)]
    parts.append(message(b"B", bytes(40)))
    parts.append(message(b"F", b"pose:uint64_t timestamp;double ms;double[2] p;"))
    parts.append(message(b"A", struct.pack("<BH", 0, 0) + b"pose"))
    for k in range(N):
        body = struct.pack("<Qddd", int(TIME_MS[k] * 1000), TIME_MS[k], X_MM[k], YAW_DEG[k])
        parts.append(message(b"D", struct.pack("<H", 0) + body))
    path.write_bytes(b"".join(parts))


def _db3(path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), "geometry_msgs/msg/Vector3"
    with rosbag2.Writer(path.parent / "bag", version=8) as bag:
        topics = {name: bag.add_connection(name, kind, typestore=store) for name in ("/pose", "/depth")}
        for k in range(N):
            data = store.serialize_cdr(store.types[kind](TIME_MS[k], X_MM[k], YAW_DEG[k]), kind)
            for topic in topics.values():
                bag.write(topic, 1_700_000_000_000_000_000 + int(TIME_MS[k] * 1e6), data)
    (path.parent / "bag" / "bag.db3").rename(path)
    shutil.rmtree(path.parent / "bag")


def _xlsx(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.create_sheet("empty")
    for row in [("Time", "X", "Yaw"), ("ms", "mm", "deg"), *zip(TIME_MS, X_MM, YAW_DEG, strict=True)]:
        book.active.append([cell if isinstance(cell, str) else float(cell) for cell in row])
    book.save(path)


def _json(path: Path) -> None:
    columns = {"ms": TIME_MS.tolist(), "pose": {"x": X_MM.tolist(), "yaw": YAW_DEG.tolist()}}
    path.write_text(json.dumps(columns))


FILES: dict[str, tuple[str, Callable[[Path], None], str, tuple[str, str, str]]] = {
    "comma": ("a.csv", _text, "", ('"Time (ms)"', '"X [mm]"', '"Yaw (°)"')),
    "numbers": ("a.csv", _text, "", ("1", "2", "3")),
    "headerless blanks": (
        "a.txt",
        lambda p: _text(p, "   ", header=False),
        "reader: {header: false}",
        ("1", "2", "3"),
    ),
    "tab": ("a.tsv", lambda p: _text(p, "\t"), "", ("1", "2", "3")),
    "semicolon, comma": ("a.csv", lambda p: _text(p, ";", decimal=","), "", ("1", "2", "3")),
    "Latin-1": ("a.csv", lambda p: _text(p, encoding="latin-1"), "", ("1", "2", '"Yaw (°)"')),
    "UTF-16": ("a.csv", lambda p: _text(p, encoding="utf-16"), "", ("1", "2", '"Yaw (°)"')),
    "mat": ("a.mat", _mat, "", ("t", '"run.pose[1]"', '"run.pose[2]"')),
    "mat 7.3": ("b.mat", _mat73, "", ("t", '"pose[1]"', '"pose[2]"')),
    "parquet": ("a.parquet", _parquet, "", ("t", "x", "yaw")),
    "mcap": ("a.mcap", _mcap, "select: /pose", ("ms", "at.x", "yaw")),
    "ulog": ("a.ulg", _ulog, "", ("ms", '"p[1]"', '"p[2]"')),
    "db3": ("a.db3", _db3, "select: /pose", ("x", "y", "z")),
    "xlsx": ("a.xlsx", _xlsx, "", ("Time", "X", "Yaw")),
    "json": ("a.json", _json, "", ("ms", "pose.x", "pose.yaw")),
}


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_every_format(kind: str, ending: str, swimid: Run, tmp_path: Path) -> None:
    name, make, reader, (time, x, yaw) = FILES[kind]
    make(tmp_path / name)
    (tmp_path / "map.yaml").write_text(MAP.format(reader=reader, time=time, x=x, yaw=yaw), encoding="utf-8")
    out = tmp_path / f"run.{ending}"
    ran = swimid("import", tmp_path / name, "--map", tmp_path / "map.yaml", "-o", out, "--json")
    assert ran.status == 0, ran.err
    record = log.read(out)
    # text files were written with six decimals, Parquet's x with 24 bits
    assert np.allclose(record.time_s, TIME_MS / 1000, rtol=0, atol=1e-9)
    assert np.allclose(record["x_m"], X_MM / 1000, rtol=1e-7, atol=1e-9)
    assert np.allclose(record["yaw_rad"], 0.5 - np.radians(YAW_DEG), rtol=0, atol=1e-8)
    assert record.metadata["robot"] == "fish"
    assert ran.json["result"]["samples"] == N
    assert out.with_name("run.evidence.json").exists()


@pytest.mark.parametrize(
    ("make", "kind"),
    [(_mat_cells, None), (_mat73_cells, None), (_mat73_cells, "mat"), (_mat73_cells, "hdf5")],
)
def test_cells_of_one_length_are_columns(
    make: Callable[[Path], None], kind: str | None, tmp_path: Path
) -> None:
    make(tmp_path / "a.mat")
    table = open_table(tmp_path / "a.mat", kind=kind)
    assert list(table.columns) == ["run.cells{1}", "run.cells{2}"]
    assert np.array_equal(table.columns["run.cells{1}"], TIME_MS)
    assert np.array_equal(table.columns["run.cells{2}"], YAW_DEG)
    assert table.metadata == {"run.who": "us"}


def test_each_format_without_a_profile_has_a_file_in_these_tests() -> None:
    plain = {name for name, found in formats().items() if found.recognises is None}
    # the others are in test_import_recorders.py and test_import_clocks.py
    here = {"delimited", "mat", "hdf5", "parquet", "mcap", "ulog", "db3", "xlsx", "json"}
    assert plain - {"mavlink", "npz", "netcdf"} == here


def test_a_file_with_a_preamble_units_and_a_cut_last_line(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(f"{k},{k / 2}\n" for k in range(100))
    path.write_text(f"Logger 7\nserial 12\n# a remark: 5\ntime,force\n[ms],[N]\n{rows}100")
    table = open_table(path)
    assert list(table.columns) == ["time", "force"]
    assert table.units == {"time": "ms", "force": "N"}
    assert len(table.columns["force"]) == 100
    assert table.lines is not None
    assert table.lines[0] == 6


def test_the_rows_of_a_mapped_log_are_lines_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t_s,u_m_s\n0,1\n\n# pause\n1,2\n2,3\n")
    assert mapping.apply(None, path).rows.tolist() == [2, 5, 6]


def test_stamps_since_1970_keep_their_steps(tmp_path: Path, swimid: Run) -> None:
    """Nanoseconds since 1970 do not fit a floating-point number: the first is taken off before."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stamps = 1_700_000_000_123_456_789 + np.arange(20) * 1_000_001
    pq.write_table(pa.table({"stamp": stamps, "u": np.arange(20.0)}), tmp_path / "a.parquet")
    time = "time: {source: stamp, unit: ns, origin: first}"
    text = f"format: swimid-mapping/1\n{time}\ncolumns: [{{source: u, target: u_m_s}}]\n"
    (tmp_path / "m.yaml").write_text(text)
    found = mapping.apply(mapping.read_mapping(tmp_path / "m.yaml"), tmp_path / "a.parquet")
    assert np.array_equal(found.time_s, np.arange(20) * 1_000_001 * 1e-9)


def test_a_rate_in_place_of_a_time_column(tmp_path: Path) -> None:
    _mat(tmp_path / "a.mat")
    column = '{source: "run.pose[1]", target: x_m, unit: mm}'
    text = f"format: swimid-mapping/1\ntime: {{rate_hz: fs}}\ncolumns: [{column}]\n"
    (tmp_path / "m.yaml").write_text(text)
    found = mapping.apply(mapping.read_mapping(tmp_path / "m.yaml"), tmp_path / "a.mat")
    assert np.allclose(found.time_s, np.arange(N) / 50)


def test_rows_out_of_order_are_sorted_and_reported(swimid: Run, tmp_path: Path) -> None:
    rows = [[k / 10, float(k)] for k in range(200)]
    rows[50], rows[51] = rows[51], rows[50]  # a late packet
    rows.insert(100, list(rows[99]))  # the same row twice
    rows.insert(150, [rows[149][0], -1.0])  # another value at a time that is taken
    lines = ["t_s,u_m_s", *(f"{t},{u}" for t, u in rows), ",5.0"]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "run.csv", "--json")
    assert ran.json["result"]["rows"] == {
        "unfilled": 0,
        "misdated": 0,
        "untimed": 1,
        "repeated": 1,
        "clashing": 1,
        "late": 1,
    }
    assert "SWM057" in [w["code"] for w in ran.json["warnings"]]
    record = log.read(tmp_path / "run.csv")
    assert np.allclose(record["u_m_s"], np.arange(200.0))


@pytest.mark.parametrize(
    "content,words",
    [
        ("t_s,u_m_s\n" + "".join(f"{k % 50},{k}\n" for k in range(100)), ["line 52", "clock starts again"]),
        (
            "t_s,u_m_s\n" + "".join(f"{k},{k}\n" for k in range(9)) + "9,1;5\n",
            ["line 11", "'u_m_s'", "not a number"],
        ),
        ("time,u\n1,2\n2,3\n", ["'t_s'", "missing", "--guess"]),
        ("", ["empty"]),
        ("\x00\x01\x02" * 50, ["no text file"]),
        ("once upon a time\nthere was a fish\n", ["no line holds numbers"]),
        ("t_s,u_m_s\n" + "".join(f"{k},{k}\n" for k in range(20)) + "1,2,3\n" * 3, ["line 22", "3 cells"]),
    ],
)
def test_invalid_files_are_refused(content: str, words: list[str], swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(content)
    ran = swimid("import", tmp_path / "a.csv", "-o", tmp_path / "run.csv")
    assert ran.status == 3
    for word in words:
        assert word in ran.err
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.parametrize(
    "change,words",
    [
        (("unit: mm", "unit: deg"), ["line 4", "unit of angle"]),
        (("unit: mm", "unit: furlong"), ["line 4", "unknown unit"]),
        (("target: x_m", "target: x m"), ["letters, digits"]),
        (("target: x_m, unit: mm", "target: yaw_rad"), ["target 'yaw_rad'"]),
        (("source: 2", "source: 9"), ["has 3 columns"]),
        (("source: 2", 'source: "X [m]"'), ["did you mean 'X [mm]'"]),
        (("time: {source: 1, unit: ms}", ""), ["the time is missing or given twice"]),
        (("columns:", "colums:"), ["did you mean 'columns'"]),
    ],
)
def test_mistakes_in_a_mapping(
    change: tuple[str, str], words: list[str], swimid: Run, tmp_path: Path
) -> None:
    _text(tmp_path / "a.csv")
    text = MAP.format(reader="", time="1", x="2", yaw="3").replace("\n\n", "\n").replace(*change)
    (tmp_path / "m.yaml").write_text(text)
    ran = swimid("import", tmp_path / "a.csv", "--map", tmp_path / "m.yaml", "-o", tmp_path / "run.csv")
    assert ran.status == 3
    for word in words:
        assert word in ran.err


def test_a_file_with_several_topics_needs_a_selection(swimid: Run, tmp_path: Path) -> None:
    _mcap(tmp_path / "a.mcap")
    ran = swimid("import", tmp_path / "a.mcap", "--guess")
    assert ran.status == 3
    assert "/depth, /pose" in ran.err
    ran = swimid("import", tmp_path / "a.mcap", "--guess", "--select", "/pose")
    assert ran.status == 0, ran.err
    assert 'select: "/pose"' in ran.out
    assert "source: yaw" in ran.out.replace('"', "")


def test_a_draft_can_be_used_after_its_questions_are_answered(swimid: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    acc = np.array([0.05, -0.02, 1.0]) + 0.01 * rng.normal(size=(400, 3))
    gyro = 20 * rng.normal(size=(400, 3))
    with (tmp_path / "imu.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["timestamp", "accX", "accY", "accZ", "gyroX (deg/s)", "gyroY (deg/s)", "gyroZ (deg/s)", "note"]
        )
        for k in range(400):
            writer.writerow([1_700_000_000_000 + 10 * k, *acc[k], *gyro[k], "ok"])
    assert swimid("import", tmp_path / "imu.csv", "--guess", "-o", tmp_path / "m.yaml").status == 0
    text = (tmp_path / "m.yaml").read_text()
    # the names state quantities, those of the turn rates their unit too; nothing states the others
    assert '{source: "timestamp", unit: ASK}' in text
    assert '{source: "accX", target: ax_m_s2, unit: ASK}' in text
    assert '{source: "gyroZ (deg/s)", target: wz_rad_s, unit: "deg/s"}' in text
    made = ("import", tmp_path / "imu.csv", "--map", tmp_path / "m.yaml", "-o", tmp_path / "run.csv")
    refused = swimid(*made)
    assert refused.status == 3
    assert "still ASK" in refused.err
    assert "line " in refused.err
    text = text.replace('"timestamp", unit: ASK', '"timestamp", unit: ms, origin: first')
    (tmp_path / "m.yaml").write_text(text.replace("unit: ASK", "unit: g"))
    ran = swimid(*made)
    assert ran.status == 0, ran.err
    record = log.read(tmp_path / "run.csv")
    assert np.allclose(record.time_s, 0.01 * np.arange(400))
    assert np.allclose(record["az_m_s2"], 9.80665 * acc[:, 2])
    assert np.allclose(record["wx_rad_s"], np.radians(gyro[:, 0]))


def test_a_draft_of_a_table_without_names_asks_for_everything(swimid: Run, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(300) * 0.01
    table = np.column_stack([t, 0.1 * rng.normal(size=(300, 3)) + [0, 9.8, 0]])
    np.savetxt(tmp_path / "imu.txt", table)
    ran = swimid("import", tmp_path / "imu.txt", "--guess")
    assert ran.status == 0
    assert "time: ASK" in ran.out
    assert ran.out.count("target: ASK, unit: ASK") == 4
    assert "m_s2" not in ran.out


@pytest.mark.parametrize("name", ["msu-states", "msu-control", "starfish"])
def test_example_mappings_are_valid(name: str) -> None:
    mapping.read_mapping(ROOT / "docs" / "examples" / f"{name}.yaml")


def test_msu_fish(real_data: Path, swimid: Run, tmp_path: Path) -> None:
    """The tail beats at 2.0 Hz in the straight runs; the authors' script says 1 Hz."""
    source = real_data / "msu_tail_fish" / "Amp20Bias0"
    example = ROOT / "docs" / "examples" / "msu-states.yaml"
    for name in ("STATES1", "STATES2"):
        out = tmp_path / f"{name}.csv"
        ran = swimid("import", source / f"{name}.txt", "--map", example, "-o", out, "--json")
        assert ran.status == 0, ran.err
        result = ran.json["result"]
        assert abs(result["stroke"]["frequency_hz"] - 2.0) < 0.05
        assert result["stroke"]["contradiction"]
        assert result["track"]["jumps"] == 0
        raw = np.loadtxt(source / f"{name}.txt")
        record = log.read(out)
        assert np.array_equal(record["x_m"], raw[:, 5])
        assert np.array_equal(record["yaw_rate_rad_s"], raw[:, 3])
        assert "SWM032" in [w["code"] for w in ran.json["warnings"]]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["airtest", "baseline", "cyclic1", "horizontal_cyclic1"])
def test_starfish(name: str, real_data: Path, swimid: Run, tmp_path: Path) -> None:
    source = real_data / "starfish" / f"data_{name}.csv"
    example = ROOT / "docs" / "examples" / "starfish.yaml"
    ran = swimid("import", source, "--map", example, "-o", tmp_path / "run.csv", "--json")
    assert ran.status == 0, ran.err
    raw = np.genfromtxt(source, delimiter=",", skip_header=1)
    record = log.read(tmp_path / "run.csv")
    assert np.allclose(record.time_s, raw[:, 0] / 1000, rtol=1e-12)
    assert np.allclose(record["m1_z_m"], raw[:, 3] / 1000, rtol=1e-12)
    assert np.array_equal(np.isnan(record["tendon_m"]), np.isnan(raw[:, 1]))
    # bursts of the limb are no jumps
    assert ran.json["result"]["track"]["jumps"] == 0


def test_the_manual_shows_the_output_of_the_command(
    swimid: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(ROOT)
    shown = re.search(
        r"\$ swimid import (.*) -o run\.csv\n(.*?)```", (ROOT / "docs/import.md").read_text(), re.S
    )
    assert shown is not None
    ran = swimid("import", *shown.group(1).split(), "-o", tmp_path / "run.csv")
    assert ran.out.strip() == shown.group(2).strip()


def test_the_period_of_a_pendulum_is_found(swimid: Run, tmp_path: Path) -> None:
    t = np.arange(600) / 30
    angle = 0.3 * np.exp(-t / 30) * np.cos(2 * np.pi * 0.7 * t)
    noise = np.random.default_rng(0).normal(size=(2, len(t))) * 5e-4
    x, z = 0.5 * np.sin(angle) + noise[0], -0.5 * np.cos(angle) + noise[1]
    rows = "".join(f"{a:.4f},{b:.5f},{c:.5f}\n" for a, b, c in zip(t, x, z, strict=True))
    (tmp_path / "p.csv").write_text("t_s,x_m,z_m\n" + rows)
    ran = swimid("import", tmp_path / "p.csv", "-o", tmp_path / "o.csv", "--json")
    stroke = ran.json["result"]["stroke"]
    assert stroke["period_s"] == pytest.approx(1 / 0.7, rel=0.01)


def test_a_stroke_range_in_the_wrong_order_is_refused(swimid: Run, tmp_path: Path) -> None:
    rows = "".join(f"{a:.4f},{0.1 * a:.5f},{0.01 * a:.5f}\n" for a in np.arange(60) / 30)
    (tmp_path / "p.csv").write_text("t_s,x_m,y_m\n" + rows)
    ran = swimid("import", tmp_path / "p.csv", "--stroke", "2", "1", "-o", tmp_path / "o.csv")
    assert ran.status == 2
    assert "the lower first" in ran.err
    assert not (tmp_path / "o.csv").exists()


def _write_swimmer(path: Path, *, metre: float = 1.0, radian: float = 1.0) -> None:
    t = np.arange(450) / 30
    rng = np.random.default_rng(1)
    x = metre * (0.15 * t + 0.0003 * rng.normal(size=len(t)))
    y = metre * (0.004 * np.sin(2 * np.pi * 1.2 * t) + 0.0003 * rng.normal(size=len(t)))
    yaw = radian * (0.15 * np.sin(2 * np.pi * 1.2 * t) + 0.002 * rng.normal(size=len(t)))
    rows = "".join(f"{a:.4f},{b:.6f},{c:.6f},{d:.6f}\n" for a, b, c, d in zip(t, x, y, yaw, strict=True))
    path.write_text("t_s,x_m,y_m,yaw_rad\n" + rows)


@pytest.mark.parametrize(
    ("units", "column"), [({}, None), ({"metre": 1000}, "x_m"), ({"radian": 57.3}, "yaw_rad")]
)
def test_unusual_values_are_a_reason_for_caution(
    units: dict[str, float], column: str | None, swimid: Run, tmp_path: Path
) -> None:
    _write_swimmer(tmp_path / "s.csv", **units)
    ran = swimid("import", tmp_path / "s.csv", "-o", tmp_path / "o.csv", "--json")
    assert ran.json["result"]["verdict"]["level"] == ("good" if column is None else "caution")
    check = next(c for c in ran.json["result"]["checks"] if c["name"] == "Values a swimmer reaches")
    assert check["verdict"] == ("pass" if column is None else "warn")
    assert (column or "") in check["text"]


def test_a_fit_to_impossible_values_is_bad(swimid: Run, tmp_path: Path) -> None:
    rig = ROOT / "sample_logs/rig"
    for source in rig.iterdir():
        text = source.read_text()
        if source.name == "w10.csv":
            lines = text.splitlines()
            at = lines.index("t_s,x_m") + 1
            lines[at:] = [f"{a},{1000 * float(b)}" for a, b in (line.split(",") for line in lines[at:])]
            text = "\n".join(lines) + "\n"
        (tmp_path / source.name).write_text(text)
    ran = swimid("fit-drag", tmp_path / "trials.yaml", "-o", tmp_path / "d.yaml")
    assert ran.status == 4 or "BAD" in ran.out


@pytest.mark.slow
def test_a_track_of_swimid_is_imported_without_warnings(swimid: Run, tmp_path: Path) -> None:
    pool = ROOT / "sample_logs/pool"
    tracked = swimid(
        "track", "video", pool / "pool.mp4", "--setup", pool / "pool_setup.yaml", "-o", tmp_path / "run.csv"
    )
    assert tracked.status == 0, tracked.err
    ran = swimid("import", tmp_path / "run.csv", "-o", tmp_path / "again.csv", "--json")
    result = ran.json["result"]
    assert "SWM" not in ran.err
    record = log.read(tmp_path / "run.csv")
    bridged = int(record["interpolated"].sum())
    assert bridged > 0
    # the noise is that of the positions before smoothing, which the track itself tells
    stated = json.loads((tmp_path / "run.evidence.json").read_text())
    noise = stated["facts"]["Measurement noise"]
    assert result["speed"]["noise_m"] == pytest.approx(float(noise.split()[0]), rel=0.5)
    assert result["track"]["gaps_s"], "what was bridged is no measurement"
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.1, abs=0.005)


def test_a_hum_beside_the_stroke_is_reported(swimid: Run, tmp_path: Path) -> None:
    """The heading hums at 10 Hz, the sway beats at 1.3 Hz: never a verdict of good."""
    rng, t = np.random.default_rng(0), np.arange(1200) / 60
    beat = 2 * np.pi * 1.3 * t
    columns = (
        t,
        0.2 * t + 0.0005 * rng.normal(size=len(t)),
        0.004 * np.sin(beat) + 0.0005 * rng.normal(size=len(t)),
        0.05 * np.sin(beat + 0.3) + 0.06 * np.sin(20 * np.pi * t) + 0.005 * rng.normal(size=len(t)),
    )
    lines = [",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True)]
    (tmp_path / "hum.csv").write_text("\n".join(["t_s,x_m,y_m,yaw_rad", *lines, ""]))
    made = ("import", tmp_path / "hum.csv", "-o", tmp_path / "run.csv", "--force", "--json")
    ran = swimid(*made)
    result = ran.json["result"]
    assert result["stroke"]["frequency_hz"] == pytest.approx(1.3, rel=2e-3)
    assert result["stroke"]["rivals_hz"]["yaw_rad"] == pytest.approx(10.0, rel=1e-3)
    assert result["verdict"]["level"] == "caution"
    assert "SWM033" in ran.err
    assert swimid(*made, "--stroke", "0.5", "3").json["result"]["verdict"]["level"] == "good"
