"""ROS 2 messages in MCAP, by their type: odometry, pose, IMU, joint states.

Times are those of the message header, which the sensor driver sets, not those of the recorder. Units and axes
are those of REP 103: SI, x forward, y left, z up; quaternions are x, y, z, w from body to world.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from swimid.logs.choices import Choices
from swimid.logs.foreign import mcap
from swimid.logs.foreign.base import Options, Table, one_of
from swimid.logs.log import TIME
from swimid.logs.profiles.base import Peek, Profile, safe
from swimid.logs.rotation import with_angles

_POSE = {"position.x": "x_m", "position.y": "y_m", "position.z": "z_m"}
_QUATERNION = {f"orientation.{axis}": f"q{axis}" for axis in "wxyz"}
_TWIST = {
    **{f"linear.{axis}": f"{name}_m_s" for axis, name in zip("xyz", "uvw", strict=True)},
    **{f"angular.{axis}": f"w{axis}_rad_s" for axis in "xyz"},
}
_IMU = {
    **{f"linear_acceleration.{axis}": f"a{axis}_m_s2" for axis in "xyz"},
    **{f"angular_velocity.{axis}": f"w{axis}_rad_s" for axis in "xyz"},
}


def _under(prefix: str, fields: dict[str, str]) -> dict[str, str]:
    return {f"{prefix}.{name}": target for name, target in fields.items()}


#: Fields and their columns, by type of message; the package may be written with or without ``/msg``.
FIELDS: dict[str, dict[str, str]] = {
    "nav_msgs/Odometry": _under("pose.pose", _POSE | _QUATERNION) | _under("twist.twist", _TWIST),
    "geometry_msgs/PoseStamped": _under("pose", _POSE | _QUATERNION),
    "geometry_msgs/PoseWithCovarianceStamped": _under("pose.pose", _POSE | _QUATERNION),
    "sensor_msgs/Imu": _IMU | _QUATERNION,
    "sensor_msgs/JointState": {},
}


def _kind(name: str) -> str:
    return name.replace("/msg/", "/")


def _recognises(peek: Peek) -> bool:
    if not peek.head.startswith(mcap.MAGIC):
        return False
    try:
        return any(_kind(kind) in FIELDS for kind in mcap.topics(peek.path).values())
    except Exception:  # noqa: BLE001 - a damaged file is refused by its reader
        return False


def _read(path: Path, choices: Choices) -> Table:
    topics = mcap.topics(path)
    known = [topic for topic, kind in topics.items() if _kind(kind) in FIELDS]
    topic = one_of(choices.select, known, file=path, what="topic", key="--select with")
    table = mcap.load(path, Options(topic=topic))
    stamp = table.columns.get("header.stamp")
    notes = list(table.notes)
    if stamp is None or not (stamp.astype(np.int64) > 0).any():
        stamp = table.columns["log_time"]
        notes.append("its messages have no stamps; the times are those of the recorder")
    nanoseconds = stamp.astype("datetime64[ns]").astype(np.int64)
    columns: dict[str, Any] = {TIME: (nanoseconds - nanoseconds[0]) * 1e-9}
    fields = FIELDS[_kind(topics[topic])] or _joints(table)
    for name, target in fields.items():
        if name in table.columns:
            columns[target] = table.columns[name].astype(float)
    metadata = {"topic": topic, "type": topics[topic], "first_stamp_s": float(nanoseconds[0]) * 1e-9}
    return Table(with_angles(columns), metadata=metadata, notes=notes)


def _joints(table: Table) -> dict[str, str]:
    """Return the columns of joint states; the joints are revolute (a prismatic one would be in m)."""
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


PROFILE = Profile("ros2", "MCAP recording of ROS 2", _recognises, _read, extra="mcap")
