"""Files of recorders: binary logs, bags, satellite positions, NumPy archives, servos, and unsigned integers.

The libraries of the formats write the files. Only DataFlash logs follow the documentation of ArduPilot.
"""

from __future__ import annotations

import datetime as dt
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from swimid.errors import InputError
from swimid.imports import mapping
from swimid.imports.mapping import MappedLog
from tests.conftest import Ran

Run = Callable[..., Ran]
N = 120
T = np.arange(N) / 50
BEAT = 2 * np.pi * 1.4 * T
X_M, Y_M, YAW = 0.2 * T, 0.02 * np.sin(BEAT), 0.3 * np.sin(BEAT)
EPOCH_NS = 1_700_000_000_000_000_000
#: Length of a degree of latitude and of longitude at 47.1 degrees north, m (WGS 84).
NORTH_M, EAST_M = 111_176.9, 75_927.7


def _read(path: Path, **stated: Any) -> MappedLog:
    return mapping.apply(None, path, stated)


# ---------------------------------------------------------------- ArduPilot and MAVLink


def _dataflash(path: Path, *, noise: bytes = b"") -> None:
    """Messages IMU (two instances) and ATT, after the definitions FMT."""
    names = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    formats = [
        (128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
        (129, 36, b"IMU", b"QBffffff", names.encode()),
        (130, 17, b"ATT", b"QccC", b"TimeUS,Roll,Pitch,Yaw"),
    ]
    data = b"".join(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *one) for one in formats)
    for k, t in enumerate(T):
        for i in (0, 1):
            cells = (round(1e6 * (1 + t)) + 130 * i, i, 0.01, 0.02, float(YAW[k]) + i, 0.1, 0.2, -9.8)
            data += b"\xa3\x95\x81" + struct.pack("<QBffffff", *cells)
        angle = round(9000 + 100 * np.degrees(YAW[k]))
        data += b"\xa3\x95\x82" + struct.pack("<QhhH", round(1e6 * (1 + t)), 150, -50, angle)
    path.write_bytes(data + noise)


def test_a_dataflash_log(tmp_path: Path, swimid: Run) -> None:
    pytest.importorskip("pymavlink")
    path = tmp_path / "a.bin"
    _dataflash(path)
    with pytest.raises(InputError, match="2 message types") as refused:
        _read(path)
    assert "IMU, ATT" in str(refused.value.hint)
    imu = _read(path, select="IMU")
    assert np.allclose(imu.time_s, 1 + T, atol=1e-6)
    # x forward, y right, z down become x forward, y left, z up
    assert np.allclose(imu.columns["wz_rad_s"], -YAW, atol=1e-6)
    assert np.allclose(imu.columns["az_m_s2"], 9.8, atol=1e-6)
    assert "instance 0 of 0, 1" in imu.notes[0]
    assert np.allclose(_read(path, select="IMU[1]").columns["wz_rad_s"], -YAW - 1, atol=1e-6)
    attitude = _read(path, select="ATT")
    assert np.allclose(attitude.columns["yaw_rad"], -np.pi / 2 - YAW, atol=1e-4)
    assert np.allclose(attitude.columns["roll_rad"], np.radians(1.5))
    # a mapping takes the fields as they are in the log, under the format 'mavlink'
    rules = {"as": "mavlink", "select": "ATT", "time": {"source": "TimeUS", "unit": "us"}}
    rules |= {"columns": [{"source": "Yaw", "target": "yaw_rad", "unit": "deg"}]}
    assert np.allclose(
        mapping.apply(mapping.read_mapping(rules), path).columns["yaw_rad"], np.pi / 2 + YAW, atol=1e-4
    )
    _dataflash(tmp_path / "cut.bin", noise=b"\xa3\x95\x81cut")
    assert len(_read(tmp_path / "cut.bin", select="ATT")) == N
    data = bytearray(path.read_bytes())
    data[2000:2040] = bytes(40)
    (tmp_path / "damaged.bin").write_bytes(data)
    ran = swimid("import", tmp_path / "damaged.bin", "--select", "ATT", "-o", tmp_path / "d.csv", "--json")
    assert "damaged" in " ".join(ran.json["result"]["notes"])
    for content, words in ((b"\xa3\x95\x80", "no message type"), (bytes(range(64)), "--as NAME")):
        (tmp_path / "other.bin").write_bytes(content)
        ran = swimid("import", tmp_path / "other.bin", "-o", tmp_path / "o.csv")
        assert ran.status == 3
        assert words in ran.err
        assert "Traceback" not in ran.err


def test_a_mavlink_log(tmp_path: Path) -> None:
    dialect = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    link, data, still = dialect.MAVLink(None, srcSystem=1), bytearray(), (0, 0, 0)
    for k, t in enumerate(T):
        ms = round(1000 * t)
        place = (round(1e7 * (47.1 + X_M[k] / NORTH_M)), round(1e7 * (8.5 + Y_M[k] / EAST_M)))
        if k < 3:
            place = (0, 0)  # before the receiver knows its position
        for message in (
            link.attitude_encode(ms, 0.0, 0.0, YAW[k], 0.0, 0.0, 0.5),
            link.local_position_ned_encode(ms, X_M[k], Y_M[k], 0.3, 0.2, 0.0, 0.0),
            link.scaled_imu2_encode(ms, *still[:2], -1000, 0, 0, 100, 10, 20, 430),
            link.global_position_int_encode(ms, *place, 400_000, 0, *still, 9000),
            link.heartbeat_encode(1, 3, 0, 0, 0),
        ):
            data += struct.pack(">Q", EPOCH_NS // 1000 + 1000 * ms) + message.pack(link)
    path = tmp_path / "a.tlog"
    path.write_bytes(data)
    with pytest.raises(InputError, match="4 message types"):
        _read(path)
    attitude = _read(path, select="ATTITUDE")
    assert np.allclose(attitude.time_s, T)
    assert np.allclose(attitude.columns["yaw_rad"], -YAW, atol=1e-6)
    assert np.allclose(attitude.columns["wz_rad_s"], -0.5)
    place = _read(path, select="LOCAL_POSITION_NED")
    assert np.allclose(place.columns["y_m"], -Y_M, atol=1e-6)
    assert np.allclose(place.columns["z_m"], -0.3)
    imu = _read(path, select="SCALED_IMU2").columns
    assert np.allclose(imu["az_m_s2"], 9.80665)
    assert np.allclose(imu["wz_rad_s"], -0.1)
    assert np.allclose(imu["mz_T"], -43e-6)
    # 1e-7 degrees are 11 mm
    fix = _read(path, select="GLOBAL_POSITION_INT")
    assert np.isnan(fix.columns["x_m"][:3]).all()
    assert np.allclose(fix.columns["x_m"][3:], X_M[3:] - X_M[3], atol=0.012)
    assert np.allclose(fix.columns["y_m"][3:], Y_M[3] - Y_M[3:], atol=0.012)
    assert fix.metadata["origin_latitude_deg"] == pytest.approx(47.1)
    # two messages in one log
    join = {"as": "ardupilot", "select": "ATTITUDE", "columns": [{"source": "yaw_rad", "target": "yaw_rad"}]}
    both = mapping.apply(
        mapping.read_mapping({"as": "ardupilot", "select": "LOCAL_POSITION_NED", "join": [join]}), path
    )
    assert np.allclose(both.columns["yaw_rad"], -YAW, atol=1e-6)


# ---------------------------------------------------------------- ROS


def _messages(kinds: Any, k: int, t: float) -> dict[str, tuple[str, Any]]:
    """Return a fix and a reading of an IMU, by topic; the IMU is that of one of two boards in turn."""
    ns = EPOCH_NS + round(1e9 * t)
    stamp = kinds["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
    header = kinds["std_msgs/msg/Header"]
    extra = (k,) if "seq" in header.__dataclass_fields__ else ()
    vector, zeros = kinds["geometry_msgs/msg/Vector3"], np.zeros(9)
    status = kinds["sensor_msgs/msg/NavSatStatus"](0, 1)
    place = (47.1 + X_M[k] / NORTH_M, 8.5 + Y_M[k] / EAST_M, 400.0)
    turn = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    rate = vector(0.0, 0.0, float(YAW[k]) + (k % 2))
    boards = header(*extra, stamp, f"board{k % 2}")
    return {
        "/fix": (
            "sensor_msgs/msg/NavSatFix",
            kinds["sensor_msgs/msg/NavSatFix"](header(*extra, stamp, "gps"), status, *place, zeros, 0),
        ),
        "/imu": (
            "sensor_msgs/msg/Imu",
            kinds["sensor_msgs/msg/Imu"](boards, turn, zeros, rate, zeros, vector(0.0, 0.0, 9.8), zeros),
        ),
    }


def _bag(path: Path, version: int) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    if version == 1:
        from rosbags.rosbag1 import Writer

        store, bag = typesys.get_typestore(typesys.Stores.ROS1_NOETIC), Writer(path)
    else:
        from rosbags.rosbag2 import Writer

        store, bag = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE), Writer(path, version=8)
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with bag:
        topics: dict[str, Any] = {}
        for k, t in enumerate(T):
            for topic, (kind, message) in _messages(store.types, k, t).items():
                if topic not in topics:
                    topics[topic] = bag.add_connection(topic, kind, typestore=store)
                bag.write(topics[topic], EPOCH_NS + round(1e9 * t), serialize(message, kind))


@pytest.mark.parametrize(("name", "version"), [("a.bag", 1), ("bag", 2)])
def test_bags_of_ros(name: str, version: int, tmp_path: Path, swimid: Run) -> None:
    """A bag file of ROS 1, and the folder of a bag of ROS 2."""
    path = tmp_path / name
    _bag(path, version)
    with pytest.raises(InputError, match="2 topics"):
        _read(path)
    fix = _read(path, select="/fix")
    assert np.allclose(fix.time_s, T, atol=1e-9)
    assert fix.metadata["first_stamp_s"] == pytest.approx(EPOCH_NS * 1e-9)
    # x is to the east, y to the north
    assert np.allclose(fix.columns["y_m"], X_M, atol=1e-4)
    assert np.allclose(fix.columns["x_m"], Y_M, atol=1e-4)
    assert np.allclose(fix.columns["altitude_m"], 400)
    # the messages of two boards are never mixed
    with pytest.raises(InputError, match="2 instances in turn: board0, board1"):
        _read(path, select="/imu")
    rules = {"as": "ros2", "select": "/imu", "where": {"header.frame_id": "board1"}}
    assert np.allclose(mapping.apply(mapping.read_mapping(rules), path).columns["wz_rad_s"], YAW[1::2] + 1)
    ran = swimid("import", path, "--select", "/fix", "--raw", "-o", tmp_path / "o.csv", "--json")
    assert ran.status == 0, ran.err
    if version == 2:
        (database,) = path.glob("*.db3")
        assert np.allclose(_read(database, select="/fix").time_s, T, atol=1e-9)
        content, cut = database.read_bytes(), tmp_path / "cut.db3"
        cut.write_bytes(content[: int(0.6 * len(content))])
        ran = swimid("import", cut, "--select", "/fix", "-o", tmp_path / "cut.csv")
        assert ran.status == 3
        assert "cut.db3" in ran.err


def test_a_folder_that_is_no_bag(tmp_path: Path, swimid: Run) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "run.csv").write_text("t_s,x_m\n0,1\n")
    ran = swimid("import", tmp_path / "logs", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert "is a folder" in ran.err
    assert "run.csv" in ran.err


# ---------------------------------------------------------------- satellite positions


def test_gpx(tmp_path: Path) -> None:
    gpx = pytest.importorskip("gpxpy.gpx")
    content, start = gpx.GPX(), dt.datetime(2024, 5, 1, 23, 59, 59, tzinfo=dt.UTC)
    for name, timed in (("out", True), ("back", True), ("plan", False)):
        track, segment = gpx.GPXTrack(name=name), gpx.GPXTrackSegment()
        content.tracks.append(track)
        track.segments.append(segment)
        for k, t in enumerate(T):
            time = start + dt.timedelta(seconds=float(t)) if timed else None
            place = (47.1 + 10 * X_M[k] / NORTH_M, 8.5 + Y_M[k] / EAST_M)
            segment.points.append(gpx.GPXTrackPoint(*place, elevation=400.0, time=time))
    (tmp_path / "a.gpx").write_text(content.to_xml())
    with pytest.raises(InputError, match="3 tracks"):
        _read(tmp_path / "a.gpx")
    found = _read(tmp_path / "a.gpx", select="out")
    assert np.allclose(found.time_s, T, atol=1e-6)
    assert np.allclose(found.columns["y_m"], 10 * X_M, atol=1e-3)
    assert np.allclose(found.columns["x_m"], Y_M, atol=1e-3)
    assert np.allclose(found.columns["altitude_m"], 400)
    assert "z_m" not in found.columns
    assert found.metadata["origin_longitude_deg"] == 8.5
    assert found.metadata["first_stamp_s"] == start.timestamp()
    with pytest.raises(InputError, match="no valid positions with times"):
        _read(tmp_path / "a.gpx", select="plan")


@pytest.mark.parametrize("kind", ["RMC", "GGA"])
def test_nmea(kind: str, tmp_path: Path) -> None:
    """Sentences over midnight, among others: without a fix, with a wrong checksum, and cut off."""
    nmea = pytest.importorskip("pynmeagps")
    start, parts = dt.datetime(2024, 5, 1, 23, 59, 30), []
    for k in range(N):
        now = start + dt.timedelta(seconds=k)
        fix = {
            "lat": 47.1 + k / NORTH_M,
            "NS": "N",
            "lon": -8.5,
            "EW": "W",
            "time": now.strftime("%H%M%S.00"),
        }
        if kind == "RMC":
            fix |= {"date": now.strftime("%Y-%m-%d"), "status": "V" if k == 3 else "A", "spd": 0.4}
        else:
            fix |= {"quality": int(k != 3), "alt": 400.5}
        parts.append(nmea.NMEAMessage("GN", kind, nmea.GET, **fix).serialize())
        parts.append(nmea.NMEAMessage("GN", "VTG", nmea.GET, cogt=0.0).serialize())
    parts[20] = parts[20].replace(b"47", b"57")
    (tmp_path / "a.nmea").write_bytes(b"boot\r\n" + b"".join(parts) + b"$GNRMC,12")
    found = _read(tmp_path / "a.nmea")
    rows = np.delete(np.arange(N), [3, 10])
    assert np.allclose(found.time_s, rows)
    assert np.allclose(found.columns["y_m"], rows, atol=0.03)
    assert np.allclose(found.columns["x_m"], 0.0, atol=0.03)
    assert found.metadata["origin_longitude_deg"] == pytest.approx(-8.5)
    assert ("altitude_m" in found.columns) == (kind == "GGA")
    lost = {"RMC": "2 of 121", "GGA": "1 of 120"}[kind]
    assert f"{lost} sentences" in found.notes[0]


def test_distances_are_those_on_the_ellipsoid() -> None:
    """Length of a degree at 60 degrees north (Snyder 1987, USGS Professional Paper 1395, table 7)."""
    from swimid.imports.formats.gps import east_north

    step = 1e-3
    place, _ = east_north(np.array([60.0, 60.0 + step, 60.0]), np.array([10.0, 10.0, 10.0 + step]))
    assert place["y_m"][1] == pytest.approx(111_412 * step, rel=2e-5)
    assert place["x_m"][2] == pytest.approx(55_800 * step, rel=2e-5)


# ---------------------------------------------------------------- archives and projects


def test_a_numpy_archive(tmp_path: Path, swimid: Run) -> None:
    arrays = {"time": T, "X#wcentroid (cm)": 100 * X_M, "missing": np.zeros(N), "frame_rate": 50.0}
    np.savez(tmp_path / "fish0.npz", note=np.array([{}], dtype=object), place=np.ones((N, 2)), **arrays)
    ran = swimid("import", tmp_path / "fish0.npz", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert "X#wcentroid (cm), missing" in ran.err
    columns = [{"source": "X#wcentroid (cm)", "target": "x_m", "unit": "cm"}]
    rules: dict[str, Any] = {"time": {"source": "time"}, "columns": columns}
    found = mapping.apply(mapping.read_mapping(rules), tmp_path / "fish0.npz")
    assert np.allclose(found.columns["x_m"], X_M)
    assert "Python objects left out: note" in found.notes[0]
    by_rate = mapping.apply(
        mapping.read_mapping(rules | {"time": {"rate_hz": "frame_rate"}}), tmp_path / "fish0.npz"
    )
    assert np.allclose(by_rate.time_s, T)


def test_a_project_of_sleap(tmp_path: Path) -> None:
    sio = pytest.importorskip("sleap_io")
    skeleton, tracks = sio.Skeleton(["nose", "tail tip"]), [sio.Track("a"), sio.Track("b")]
    video, frames = sio.Video("film.mp4", backend=None), []
    for k in range(N):
        if k == 7:
            continue
        places = np.array([[100 + k, 200 + 9 * np.sin(BEAT[k])], [50.0, 60.0]])
        found = [
            sio.PredictedInstance.from_numpy(
                places + shift, skeleton, point_scores=np.array([0.9, 0.7]), score=0.8, track=track
            )
            for shift, track in zip((0.0, 300.0), tracks, strict=True)
        ]
        frames.append(sio.LabeledFrame(video, k, found))
    labels = sio.Labels(frames, [video], [skeleton], tracks)
    labels.save(str(tmp_path / "a.slp"), verbose=False)
    with pytest.raises(InputError, match="2 tracks"):
        _read(tmp_path / "a.slp", rate_hz=50.0)
    found = _read(tmp_path / "a.slp", select="b", rate_hz=50.0)
    assert np.allclose(
        np.delete(found.columns["nose_y_px"], 7), np.delete(-500 - 9 * np.sin(BEAT), 7), atol=1e-4
    )
    assert np.isnan(found.columns["nose_x_px"][7])
    assert np.allclose(np.delete(found.columns["tail_tip_score"], 7), 0.7)
    assert np.allclose(found.time_s, T)


# ---------------------------------------------------------------- servos


def _servos(path: Path, numbers: list[int], column: str = "ID", *, same_time: bool = False) -> None:
    lines = [f"time_ms,{column},Goal Position,Present Position"]
    for k, t in enumerate(T):
        for at, number in enumerate(numbers):
            tick = round(2048 + (at + 1) * 200 * np.sin(BEAT[k]))
            lines.append(f"{1000 * t + 3 * at * (not same_time):.1f},{number},{tick},{tick}")
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("column", ["ID", "dxl_id", "servo"])
@pytest.mark.parametrize(("numbers", "same_time"), [([1, 2], False), ([4, 7, 9], False), ([1, 2], True)])
def test_servos_in_turn_are_chosen(column: str, numbers: list[int], same_time: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    _servos(path, numbers, column, same_time=same_time)
    with pytest.raises(InputError, match="instances in turn") as refused:
        _read(path)
    assert refused.value.column == column
    assert f"where: {{{column}: {numbers[0]}}}" in str(refused.value.hint)
    chosen = [{column: number} for number in numbers]
    join = [
        {"as": "dynamixel", "where": one, "columns": [{"source": "joint1_rad", "target": f"joint{k}_rad"}]}
        for k, one in enumerate(chosen[1:], start=2)
    ]
    found = mapping.apply(mapping.read_mapping({"as": "dynamixel", "where": chosen[0], "join": join}), path)
    assert len(found) == N
    for k in range(1, len(numbers) + 1):
        wanted = k * 200 * np.sin(BEAT) * 2 * np.pi / 4096
        # the servos are read 3 ms after each other, and turn at 8.1 rad/s at most
        assert np.nanmax(np.abs(found.columns[f"joint{k}_rad"] - wanted)) < 0.05


def test_one_servo_with_a_column_of_its_number(tmp_path: Path) -> None:
    _servos(tmp_path / "a.csv", [3])
    assert len(_read(tmp_path / "a.csv")) == N


def test_a_scale_that_depends_on_the_servo_is_asked(tmp_path: Path) -> None:
    """Positions of an AX servo, of which a turn has not 4096 ticks."""
    ticks = np.round(512 + np.degrees(YAW) * 1024 / 300).astype(int)
    path = tmp_path / "a.csv"
    pd.DataFrame({"Time (ms)": 1000 * T, "Present Position": ticks}).to_csv(path, index=False)
    with pytest.raises(InputError, match="1024 in 300 degrees") as refused:
        _read(path)
    assert "--as dynamixel-ax" in str(refused.value.hint)
    assert np.allclose(_read(path, profile="dynamixel-ax").columns["joint1_rad"], YAW, atol=0.003)
    assert np.allclose(
        _read(path, profile="dynamixel-x").columns["joint1_rad"], (ticks - 2048) * np.pi / 2048
    )


# ---------------------------------------------------------------- integers without a sign


@pytest.mark.parametrize("bits", [16, 24, 32])
@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_negative_numbers_without_a_sign(bits: int, ending: str, tmp_path: Path) -> None:
    true = np.round(300 * np.sin(BEAT)).astype(np.int64)
    square = np.where(np.sin(BEAT) > 0, 100, -100)
    columns = {"time": T, "force": true % 2**bits, "command": square % 2**bits}
    path = tmp_path / f"a.{ending}"
    if ending == "npz":
        np.savez(path, **columns)
    elif ending == "csv":
        pd.DataFrame(columns).to_csv(path, index=False)
    else:
        pytest.importorskip("pyarrow")
        pd.DataFrame(columns).to_parquet(path)
    targets = [
        {"source": "force", "target": "force_N", "factor": 0.01},
        {"source": "command", "target": "cmd1_rad"},
    ]
    found = mapping.apply(mapping.read_mapping({"time": {"source": "time"}, "columns": targets}), path)
    assert np.allclose(found.columns["force_N"], 0.01 * true)
    assert np.allclose(found.columns["cmd1_rad"], square)
    assert f"unsigned integers of {bits} bits" in found.notes[0]


@pytest.mark.parametrize(
    "values",
    [
        np.round(32768 + 32000 * np.sin(BEAT)),  # of 16 bits, over the whole range
        np.round(52000 + 3000 * np.sin(BEAT)),  # above the middle
        np.where(np.arange(N) % 20 == 5, 0, np.round(52000 + 3000 * np.sin(BEAT))),  # lost samples are 0
        np.where(np.arange(N) == 50, 12, np.round(52000 + 300 * np.sin(BEAT))),  # one wrong value
        np.where(np.arange(N) == 50, 65535, np.round(300 + 200 * np.sin(BEAT))),  # a mark of a lost sample
        60000 + 0.5 * np.arange(N),
        np.round(300 * np.sin(BEAT)),
    ],
)
def test_numbers_that_may_be_positive_stay(values: np.ndarray, tmp_path: Path) -> None:
    pd.DataFrame({"time": T, "load": values}).to_csv(tmp_path / "a.csv", index=False)
    rules = {"time": {"source": "time"}, "columns": [{"source": "load", "target": "force_N"}]}
    found = mapping.apply(mapping.read_mapping(rules), tmp_path / "a.csv")
    assert np.array_equal(found.columns["force_N"], values)
    assert found.notes == []


def test_ticks_of_servos_without_a_sign(tmp_path: Path) -> None:
    """A servo in extended position mode that was zeroed beside tick 0, in four bytes."""
    for name, middle in (("about zero", 0), ("below zero", -3000)):
        ticks = np.round(middle + 300 * np.sin(BEAT)).astype(np.int64)
        path = tmp_path / f"{name}.csv"
        pd.DataFrame({"Time (s)": T, "Present Position": ticks % 2**32}).to_csv(path, index=False)
        assert np.allclose(_read(path).columns["joint1_rad"], (ticks - 2048) * 2 * np.pi / 4096)
