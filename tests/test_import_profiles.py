"""Profiles of ``swimid import``: a file of each format becomes a log with the true values."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from swimid.logs.log import Log
from tests.conftest import Ran

Run = Callable[..., Ran]
N, RATE = 240, 30.0
T = np.arange(N) / RATE
BEAT = 2 * np.pi * 1.4 * T
X_PX, Y_PX = 100 + 4.0 * np.arange(N), 200 + 9 * np.sin(BEAT)
JOINT = np.radians(18) * np.sin(BEAT)


def _points() -> pd.DataFrame:
    """A table as DeepLabCut makes it: two points, one of them hidden for a while."""
    likelihood = np.full(N, 0.98)
    likelihood[50:70] = 0.04
    hidden = np.where(likelihood < 0.5, 3.0, 0.0) * np.arange(N)
    parts = {
        ("nose", "x"): X_PX + hidden,
        ("nose", "y"): Y_PX,
        ("nose", "likelihood"): likelihood,
        ("tail tip", "x"): X_PX - 80,
        ("tail tip", "y"): Y_PX + 20 * np.sin(BEAT - 1),
        ("tail tip", "likelihood"): np.full(N, 0.93),
    }
    columns = pd.MultiIndex.from_tuples(
        [("DLC_resnet50", *key) for key in parts], names=["scorer", "bodyparts", "coords"]
    )
    return pd.DataFrame(np.column_stack(list(parts.values())), columns=columns)


@pytest.mark.parametrize("ending", ["csv", "h5"])
def test_deeplabcut(ending: str, imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    path = tmp_path / f"filmDLC.{ending}"
    if ending == "csv":
        _points().to_csv(path)
    else:
        pytest.importorskip("tables")
        _points().to_hdf(path, key="df_with_missing", format="table", mode="w")
    record, ran = imported(path, "--rate-hz", "30")
    assert np.allclose(record.time_s, T)
    hidden = slice(50, 70)
    assert np.isnan(record["nose_x_px"][hidden]).all()
    assert np.allclose(np.delete(record["nose_x_px"], np.arange(50, 70)), np.delete(X_PX, np.arange(50, 70)))
    assert np.allclose(record["tail_tip_x_px"], X_PX - 80)
    assert np.allclose(record["tail_tip_y_px"], -(Y_PX + 20 * np.sin(BEAT - 1)))
    assert ran.json["result"]["unlikely"] == {"nose_likelihood": 20}
    assert ran.json["result"]["verdict"]["level"] == "caution"
    assert ran.json["result"]["profile"] == "deeplabcut"
    kept, _ = imported(path, "--rate-hz", "30", "--min-likelihood", "0")
    assert np.isfinite(kept["nose_x_px"]).all()


def test_several_individuals_are_never_mixed(swimid: Run, tmp_path: Path) -> None:
    table = _points()
    both = pd.concat(dict.fromkeys(("fish1", "fish2"), table["DLC_resnet50"]), axis=1)
    both = pd.concat({"DLC": both}, axis=1)
    both.columns.names = ["scorer", "individuals", "bodyparts", "coords"]
    both.to_csv(tmp_path / "two.csv")
    made = ("import", tmp_path / "two.csv", "--rate-hz", "30", "-o", tmp_path / "o.csv")
    ran = swimid(*made)
    assert ran.status == 3
    assert "fish1, fish2" in ran.err
    assert swimid(*made, "--select", "fish2").status == 0


def _sleap_hdf5(path: Path) -> None:
    """An analysis file as the SLEAP documentation describes it."""
    import h5py

    nodes = np.stack([np.stack([X_PX, Y_PX]), np.stack([X_PX - 80, Y_PX + 5])], axis=1)
    scores = np.full((1, 2, N), 0.9)
    scores[0, 1, 10:15] = 0.2
    with h5py.File(path, "w") as file:
        file["tracks"] = nodes[None]
        file["node_names"] = np.array([b"nose", b"tail tip"])
        file["track_names"] = np.array([b"fish"])
        file["track_occupancy"] = np.ones((N, 1), dtype=np.uint8)
        file["point_scores"] = scores


def _sleap_csv(path: Path) -> None:
    score = np.full(N, 0.9)
    score[10:15] = 0.2
    pd.DataFrame(
        {
            "track": "fish",
            "frame_idx": np.arange(N),
            "instance.score": 0.95,
            "nose.x": X_PX,
            "nose.y": Y_PX,
            "nose.score": 0.9,
            "tail tip.x": X_PX - 80,
            "tail tip.y": Y_PX + 5,
            "tail tip.score": score,
        }
    ).drop(index=[100, 101, 102]).to_csv(path, index=False)


@pytest.mark.parametrize(("name", "make"), [("film.analysis.h5", _sleap_hdf5), ("film.csv", _sleap_csv)])
def test_sleap(
    name: str, make: Callable[[Path], None], imported: Callable[..., tuple[Log, Ran]], tmp_path: Path
) -> None:
    make(tmp_path / name)
    record, ran = imported(tmp_path / name, "--rate-hz", "30")
    frames = np.round(record.time_s * RATE).astype(int)
    # frames in which nothing was found are missing, and count as time
    assert np.allclose(record.time_s, frames / RATE)
    assert frames[-1] == N - 1
    assert np.allclose(record["nose_x_px"], X_PX[frames])
    assert np.allclose(record["nose_y_px"], -Y_PX[frames])
    assert np.isnan(record["tail_tip_x_px"][10:15]).all()
    assert ran.json["result"]["unlikely"] == {"tail_tip_score": 5}


def _tracker(path: Path, unit: str) -> None:
    names = f"t\tx{unit}\ty{unit}\t"
    rows = [f"{t:.9E}\t{x:.9E}\t{y:.9E}\t" for t, x, y in zip(T, 0.3 * T, 0.02 * np.sin(BEAT), strict=True)]
    path.write_text("\n".join(["mass_A\t\t\t", names, *rows]) + "\n")


@pytest.mark.parametrize(("unit", "factor"), [("", 1.0), (" (cm)", 0.01)])
def test_tracker(unit: str, factor: float, imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    _tracker(tmp_path / "mass.txt", unit)
    record, ran = imported(tmp_path / "mass.txt")
    assert np.allclose(record.time_s, T)
    assert np.allclose(record["x_m"], factor * 0.3 * T, atol=1e-9)
    assert np.allclose(record["y_m"], factor * 0.02 * np.sin(BEAT), atol=1e-9)
    # the metre is the default of the program, and not stated by the file
    assert ran.json["result"]["verdict"]["level"] == ("caution" if unit == "" else "good")


def test_tracker_with_several_tracks(imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    rows = [f"{t:.6f}\t{0.3 * t:.6f}\t{0.1 * t:.6f}\t{-t:.6f}\t{2 * t:.6f}\t" for t in T]
    head = ["#multi:", "\tmass A\t\tmass B\t\t", "t\tx (m)\ty (m)\tx (m)\ty (m)\t"]
    (tmp_path / "m.txt").write_text("\n".join([*head, *rows]) + "\n")
    record, _ = imported(tmp_path / "m.txt")
    assert np.allclose(record["mass_B_y_m"], 2 * T, atol=1e-5)
    one, _ = imported(tmp_path / "m.txt", "--select", "mass B")
    assert np.allclose(one["x_m"], -T, atol=1e-5)


def test_the_header_of_marker_trajectories_states_the_unit(
    imported: Callable[..., tuple[Log, Ran]], tmp_path: Path
) -> None:
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tswim.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"30.00\t30.00\t{N}\t2\tmm\t30.00\t1\t{N}",
        "Frame#\tTime\tnose\t\t\ttail tip\t\t",
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
        "",
    ]
    for k, t in enumerate(T):
        tip = "\t\t" if k == 7 else f"{X_PX[k] - 80:.4f}\t{Y_PX[k]:.4f}\t3.0"
        lines.append(f"{k + 1}\t{t:.7f}\t{X_PX[k]:.4f}\t{Y_PX[k]:.4f}\t2.5\t{tip}")
    (tmp_path / "swim.trc").write_text("\n".join(lines) + "\n")
    record, _ = imported(tmp_path / "swim.trc")
    assert np.allclose(record.time_s, T, atol=1e-6)
    assert np.allclose(record["nose_x_m"], X_PX / 1000, atol=1e-7)
    assert np.isnan(record["tail_tip_y_m"][7])
    assert np.allclose(np.delete(record["tail_tip_y_m"], 7), np.delete(Y_PX, 7) / 1000, atol=1e-7)


@pytest.mark.parametrize(("degrees", "factor"), [("yes", np.pi / 180), ("no", 1.0)])
def test_a_motion_states_whether_it_is_in_degrees(
    degrees: str, factor: float, imported: Callable[..., tuple[Log, Ran]], tmp_path: Path
) -> None:
    head = ["Coordinates", "version=1", f"nRows={N}", "nColumns=3", f"inDegrees={degrees}", "", "endheader"]
    rows = [f"{t:.6f}\t{0.8 * np.sin(b):.6f}\t{0.2 * t:.6f}" for t, b in zip(T, BEAT, strict=True)]
    (tmp_path / "s.mot").write_text("\n".join([*head, "time\tcaudal\tpelvis_tx", *rows]) + "\n")
    record, _ = imported(tmp_path / "s.mot")
    assert np.allclose(record["caudal_rad"], factor * 0.8 * np.sin(BEAT), atol=1e-6)
    assert np.allclose(record["pelvis_tx_m"], 0.2 * T, atol=1e-6)


def test_columns_of_forces_in_a_motion(imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    """Files of forces state inDegrees too; their columns are no angles."""
    names = "time\tground_force_vx\tground_force_px\tground_torque_z"
    rows = [f"{t:.6f}\t{3 * np.sin(b):.6f}\t0.25\t{0.1 * t:.6f}" for t, b in zip(T, BEAT, strict=True)]
    head = ["forces", "version=1", "inDegrees=yes", "endheader"]
    (tmp_path / "f.mot").write_text("\n".join([*head, names, *rows]) + "\n")
    record, _ = imported(tmp_path / "f.mot")
    assert np.allclose(record["ground_force_vx_N"], 3 * np.sin(BEAT), atol=1e-6)
    assert np.allclose(record["ground_force_px_m"], 0.25)
    assert np.allclose(record["ground_torque_z_Nm"], 0.1 * T, atol=1e-6)


HEADER = "std_msgs/Header header\n"
LINE = "=" * 80
COMMON = (
    LINE + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + LINE + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    + LINE + "\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + LINE + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + LINE + "\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    + LINE + "\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    + LINE + "\nMSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    + LINE + "\nMSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
    + LINE + "\nMSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n"
)  # fmt: skip
TYPES = {
    "/odom": (
        "nav_msgs/msg/Odometry",
        HEADER + "string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        "geometry_msgs/TwistWithCovariance twist\n" + COMMON,
    ),
    "/imu": (
        "sensor_msgs/msg/Imu",
        HEADER + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n" + COMMON,
    ),
    "/joints": (
        "sensor_msgs/msg/JointState",
        HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + COMMON,
    ),
}


def _bag(path: Path, *, back_s: float = 0.0) -> None:
    """A bag of odometry, IMU and joints; the clock of the recorder steps back half way."""
    writer_of = pytest.importorskip("mcap_ros2.writer")
    yaw = 0.3 * np.sin(BEAT) + 2.0
    zeros = {"x": 0.0, "y": 0.0, "z": 0.0}
    with path.open("wb") as stream:
        writer = writer_of.Writer(stream)
        schemas = {topic: writer.register_msgdef(*kind) for topic, kind in TYPES.items()}
        for k, t in enumerate(T):
            stamp = 1_700_000_000_000_000_000 + round(t * 1e9)
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "world"}
            turn = {"x": 0.0, "y": 0.0, "z": np.sin(yaw[k] / 2), "w": np.cos(yaw[k] / 2)}
            rate = 0.3 * 2 * np.pi * 1.4 * np.cos(BEAT[k])
            pose = {"position": {"x": 0.2 * t, "y": 0.1, "z": -0.3}, "orientation": turn}
            twist = {"linear": {**zeros, "x": 0.2}, "angular": {**zeros, "z": rate}}
            messages = {
                "/odom": {
                    "child_frame_id": "fish",
                    "pose": {"pose": pose, "covariance": [0.0] * 36},
                    "twist": {"twist": twist, "covariance": [0.0] * 36},
                },
                "/imu": {
                    "orientation": {**zeros, "w": 0.0},
                    "angular_velocity": {**zeros, "z": rate},
                    "linear_acceleration": {**zeros, "z": 9.81},
                    **{f"{name}_covariance": [0.0] * 9 for name in ("orientation", "angular_velocity")},
                    "linear_acceleration_covariance": [0.0] * 9,
                },
                "/joints": {
                    "name": ["caudal", "pectoral fin"],
                    "position": [JOINT[k], -JOINT[k]],
                    "velocity": [0.0, 0.0],
                    "effort": [],
                },
            }
            shift = int(1e9 * back_s) if k > N // 2 else 0
            for topic, message in messages.items():
                message = {"header": header, **message}
                writer.write_message(
                    topic, schemas[topic], message, log_time=stamp - shift, publish_time=stamp
                )
        writer.finish()


def test_ros2_messages_by_their_type(
    imported: Callable[..., tuple[Log, Ran]], swimid: Run, tmp_path: Path
) -> None:
    path = tmp_path / "bag.mcap"
    _bag(path, back_s=3.0)
    refused = swimid("import", path, "-o", tmp_path / "o.csv")
    assert refused.status == 3
    assert "/imu, /joints, /odom" in refused.err
    odom, _ = imported(path, "--select", "/odom")
    assert np.allclose(odom.time_s, T, atol=1e-9)
    assert np.allclose(odom["x_m"], 0.2 * T)
    assert np.allclose(odom["yaw_rad"], 2.0 + 0.3 * np.sin(BEAT))
    assert np.allclose(odom["qw"], np.cos(1.0 + 0.15 * np.sin(BEAT)))
    assert np.allclose(odom["u_m_s"], 0.2)
    joints, _ = imported(path, "--select", "/joints")
    assert np.allclose(joints["caudal_rad"], JOINT)
    assert np.allclose(joints["pectoral_fin_rad"], -JOINT)
    imu, _ = imported(path, "--select", "/imu")
    assert np.allclose(imu["wz_rad_s"], 0.3 * 2 * np.pi * 1.4 * np.cos(BEAT))
    # a driver without attitude sends a quaternion of zeros
    assert "qw" not in imu


def test_px4_axes_are_turned(imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    """The smallest ULog file: header, format, subscription, data (docs.px4.io, ULog file format)."""
    pytest.importorskip("pyulog")

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message(b"B", bytes(40))]
    fields = b"vehicle_local_position:uint64_t timestamp;float x;float y;float z;float heading;"
    parts.append(message(b"F", fields))
    parts.append(message(b"A", struct.pack("<BH", 0, 0) + b"vehicle_local_position"))
    for k, t in enumerate(T):
        body = struct.pack("<Qffff", round(1e6 * t), 0.2 * t, 0.05 * t, 1.5, 0.3 * np.sin(BEAT[k]))
        parts.append(message(b"D", struct.pack("<H", 0) + body))
    (tmp_path / "a.ulg").write_bytes(b"".join(parts))
    record, _ = imported(tmp_path / "a.ulg")
    assert np.allclose(record.time_s, T, atol=1e-6)
    assert np.allclose(record["x_m"], 0.2 * T, atol=1e-6)
    assert np.allclose(record["y_m"], -0.05 * T, atol=1e-6)
    assert np.allclose(record["z_m"], -1.5)
    assert np.allclose(record["yaw_rad"], -0.3 * np.sin(BEAT), atol=1e-6)


def _ardupilot(path: Path, kind: str) -> None:
    """Two sensors in turn, as a CSV of one type, and as the text of a whole log."""
    rows = []
    for k, t in enumerate(T):
        for i in (0, 1):
            cells = [round(1e6 * (1 + t)) + 130 * i, i, 0.01, 0.02, np.cos(BEAT[k]) + i, 0.1, 0.2, -9.8]
            rows.append(",".join(str(cell) for cell in cells))
    names = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    if kind == "csv":
        path.write_text("\n".join([names, *rows]) + "\n")
        return
    head = [
        f"FMT, 129, 35, IMU, QBffffff, {names}",
        "FMT, 130, 30, MODE, QMB, TimeUS,Mode,Rsn",
        "MODE, 1, a, 1",
    ]
    path.write_text("\n".join([*head, *(f"IMU, {row}" for row in rows), "IMU, 99"]) + "\n")


@pytest.mark.parametrize(("kind", "second"), [("csv", "1"), ("log", "IMU[1]")])
def test_ardupilot_takes_one_instance(
    kind: str, second: str, imported: Callable[..., tuple[Log, Ran]], tmp_path: Path
) -> None:
    _ardupilot(tmp_path / f"a.{kind}", kind)
    record, ran = imported(tmp_path / f"a.{kind}")
    assert len(record) == N
    assert np.allclose(record.time_s, 1 + T, atol=1e-6)
    # x forward, y right, z down become x forward, y left, z up
    assert np.allclose(record["wz_rad_s"], -np.cos(BEAT))
    assert np.allclose(record["az_m_s2"], 9.8)
    assert np.allclose(record["ay_m_s2"], -0.2)
    assert ran.json["result"]["verdict"]["level"] == "caution"
    assert "instance 0 of 0, 1" in ran.err
    other, _ = imported(tmp_path / f"a.{kind}", "--select", second)
    assert np.allclose(other["wz_rad_s"], -np.cos(BEAT) - 1)


def test_dynamixel_ticks(imported: Callable[..., tuple[Log, Ran]], tmp_path: Path) -> None:
    ticks = np.round(2048 + JOINT / (2 * np.pi) * 4096).astype(int)
    lines = ["Time(ms),ID1 Present Position,ID1 Goal Position,ID4 Present Position"]
    lines += [f"{1000 * t:.3f},{a},{a + 3},{4096 - a}" for t, a in zip(T, ticks, strict=True)]
    (tmp_path / "servo.csv").write_text("\n".join(lines) + "\n")
    record, _ = imported(tmp_path / "servo.csv")
    tick = 2 * np.pi / 4096
    assert np.allclose(record["joint1_rad"], JOINT, atol=0.51 * tick)
    assert np.allclose(record["cmd1_rad"] - record["joint1_rad"], 3 * tick)
    assert np.allclose(record["joint2_rad"], -record["joint1_rad"])
    assert record.metadata["servos"] == [1, 4]


def test_a_profile_that_does_not_exist(swimid: Run, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t_s,x_m\n0,1\n1,2\n2,3\n")
    ran = swimid("import", tmp_path / "a.csv", "--as", "deeplabcat", "-o", tmp_path / "o.csv")
    assert ran.status == 3
    assert "did you mean 'deeplabcut'" in ran.err
