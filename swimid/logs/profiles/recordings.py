"""Recordings of messages of known types: ULog of PX4, and ROS 2 messages in MCAP.

The axes of PX4 are forward, right, down and north, east, down. They are converted to y left and z up. ROS 2
has the units and axes of REP 103: SI units, x forward, y left, z up. Quaternions of ROS 2 are x, y, z, w from
body to world. Times of ROS 2 are those of the message header, which the driver of the sensor sets, not those
of the recorder.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.logs.foreign import Format, Options, Peek, Table, choose, open_table, recordings
from swimid.logs.log import TIME
from swimid.logs.profiles import axes, renamed, safe
from swimid.logs.rotation import from_frd, with_angles


def _pose(at: str) -> dict[str, str]:
    """Return the columns of a pose whose fields have names that begin with ``at``."""
    return axes(f"{at}position.{{}}", "{}_m") | axes(f"{at}orientation.{{}}", "q{}", "wxyz")


#: Fields of each type of message, with the columns of the log. Types of ROS 2 are written without ``/msg``.
FIELDS: dict[str, dict[str, str]] = {
    "vehicle_local_position": axes("{}", "{}_m") | axes("v{}", "v{}_m_s") | {"heading": "yaw_rad"},
    "vehicle_attitude": axes("q[{}]", "q{}", "1234", "wxyz"),
    "vehicle_angular_velocity": axes("xyz[{}]", "w{}_rad_s", "123", "xyz"),
    "vehicle_acceleration": axes("xyz[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_combined": axes("gyro_rad[{}]", "w{}_rad_s", "123", "xyz")
    | axes("accelerometer_m_s2[{}]", "a{}_m_s2", "123", "xyz"),
    "sensor_gyro": axes("{}", "w{}_rad_s"),
    "sensor_accel": axes("{}", "a{}_m_s2"),
    "nav_msgs/Odometry": _pose("pose.pose.")
    | axes("twist.twist.linear.{}", "{}_m_s", "xyz", "uvw")
    | axes("twist.twist.angular.{}", "w{}_rad_s"),
    "geometry_msgs/PoseStamped": _pose("pose."),
    "geometry_msgs/PoseWithCovarianceStamped": _pose("pose.pose."),
    "sensor_msgs/Imu": axes("linear_acceleration.{}", "a{}_m_s2")
    | axes("angular_velocity.{}", "w{}_rad_s")
    | axes("orientation.{}", "q{}", "wxyz"),
    "sensor_msgs/JointState": {},
}


def _topics(path: Path) -> dict[str, str]:
    """Return the topics whose message type is known, each with its type."""
    kinds = {topic: kind.replace("/msg/", "/") for topic, kind in recordings.topics(path).items()}
    return {topic: kind for topic, kind in kinds.items() if kind in FIELDS}


def _recognises(peek: Peek) -> bool:
    with contextlib.suppress(Exception):  # a damaged file is refused by its reader
        return bool(_topics(peek.path))
    return False


def _open(path: Path, select: str | None) -> tuple[Table, str]:
    """Return the samples and the message type of the selected topic, or of the only topic."""
    topics = _topics(path)
    topic = choose(select, list(topics), "topic", path)
    return open_table(path, select=topic), topics[topic]


def _read_px4(path: Path, options: Options, select: str | None) -> Table:
    table, kind = _open(path, select)
    time_s = table.columns[table.column("timestamp", path)].astype(np.int64) * 1e-6
    return replace(table, columns={TIME: time_s, **with_angles(from_frd(renamed(table, FIELDS[kind])))})


def _read_ros2(path: Path, options: Options, select: str | None) -> Table:
    table, kind = _open(path, select)
    stamp = table.columns.get("header.stamp")
    if stamp is None or not (stamp.astype(np.int64) > 0).any():
        stamp = table.columns["log_time"]
        table.notes.append("its messages have no stamps; the times are those of the recorder")
    nanoseconds = stamp.astype("datetime64[ns]").astype(np.int64)
    table.metadata["first_stamp_s"] = float(nanoseconds[0]) * 1e-9
    columns = renamed(table, FIELDS[kind] or _joints(table))
    time_s = (nanoseconds - nanoseconds[0]) * 1e-9
    return replace(table, columns={TIME: time_s, **with_angles(columns)})


def _joints(table: Table) -> dict[str, str]:
    """Return the columns of joint states. All joints are taken for revolute joints."""
    fields = {}
    for name, words in table.columns.items():
        if not name.startswith("name["):
            continue
        at, joint = name.removeprefix("name"), safe(str(words[0]))
        if any(word != words[0] for word in words):
            table.notes.append(f"joint {at} changes its name while it is recorded")
        for field, unit in (("position", "rad"), ("velocity", "rad_s"), ("effort", "Nm")):
            fields[f"{field}{at}"] = f"{joint}_{unit}"
    return fields


PX4 = Format(
    "px4", "ULog recording of PX4", _read_px4, _recognises, magic=(recordings.ULOG_MAGIC,), extra="ulog"
)
ROS2 = Format(
    "ros2", "MCAP recording of ROS 2", _read_ros2, _recognises, magic=(recordings.MCAP_MAGIC,), extra="mcap"
)
