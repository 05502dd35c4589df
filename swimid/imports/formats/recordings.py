"""Readers of recordings of ROS: MCAP, also of JSON messages, by the library mcap, and bags by rosbags.

A bag is a db3 file or a folder of ROS 2, or a bag file of ROS 1. ROS has the units and axes of REP 103: SI
units, x forward, y left, z up. Quaternions of ROS are x, y, z, w from body to world. Times are those of the
message header, which the driver of the sensor sets,
not those of the recorder.
"""

from __future__ import annotations

import json
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.imports.formats import open_table
from swimid.imports.formats.gps import east_north
from swimid.imports.table import (
    ForeignTable,
    Format,
    Peek,
    ReaderOptions,
    axes,
    choose,
    flat,
    from_first,
    of_records,
    rename_columns,
)
from swimid.kinematics.attitude import with_angles
from swimid.logs.log import TIME
from swimid.logs.units import safe

MCAP_MAGIC = b"\x89MCAP0\r\n"
#: First bytes of the files of a bag: db3 file, description in the folder of a ROS 2 bag, and bag file of ROS
#: 1.
BAG_MAGIC = (b"SQLite format 3\x00", b"rosbag2_bagfile_information", b"#ROSBAG")


def topics(path: Path) -> dict[str, str]:
    """Return the topics of a recording, each with the message type that the file states."""
    if Peek.of(path).head.startswith(BAG_MAGIC):
        with _bag(path) as bag:
            kinds = {one.topic: one.msgtype for one in bag.connections if one.msgcount}
        return dict(sorted(kinds.items()))
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        if summary and summary.statistics and summary.statistics.channel_message_counts:
            counts = summary.statistics.channel_message_counts
            channels = [channel for number, channel in summary.channels.items() if counts.get(number)]
            found = {channel.topic: summary.schemas.get(channel.schema_id) for channel in channels}
        else:
            found = {channel.topic: schema for schema, channel, _ in reader.iter_messages()}
    return {topic: getattr(schema, "name", "") for topic, schema in sorted(found.items())}


def _open_mcap(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    """Return a table of the messages of one topic, with times as ``datetime64[ns]``.

    The messages stay in the order of the file. They are not sorted by ``log_time``, because the clock of the
    recorder may be set back.
    """
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    known = topics(path)
    topic = choose(select, list(known), "topic", path)
    records, decoders = [], DecoderFactory()
    with path.open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=[topic], log_time_order=False)
        for schema, channel, message in found:
            decode = decoders.decoder_for(channel.message_encoding, schema) or json.loads
            times = {"log_time": message.log_time, "publish_time": message.publish_time}
            record = {name: np.datetime64(time_ns, "ns") for name, time_ns in times.items()}
            records.append(record | dict(flat(decode(message.data), _parts)))
    return ForeignTable(of_records(records), metadata={"topic": topic, "type": known[topic]})


def _parts(value: Any) -> Any:
    """Convert a message to a dict of its fields, and a time stamp of seconds and nanoseconds to a date."""
    if is_dataclass(value):
        value = vars(value)
    elif isinstance(value, np.ndarray):
        value = value.tolist()
    elif hasattr(value, "__slots__"):
        value = {name: getattr(value, name) for name in value.__slots__}
    if isinstance(value, dict) and {"sec", "nanosec"} <= set(value):
        return np.datetime64(int(value["sec"]) * 1_000_000_000 + int(value["nanosec"]), "ns")
    return value


MCAP_TITLE = "MCAP file of ROS 2 or JSON messages"
MCAP = Format("mcap", MCAP_TITLE, _open_mcap, endings=(".mcap",), magic=(MCAP_MAGIC,), extra="mcap")


def _bag(path: Path) -> Any:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    # Use the message types of a distribution of ROS 2 for a bag without definitions of its types.
    return AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))


def _open_db3(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    """Return a table of the messages of one topic, with times as ``datetime64[ns]``."""
    with _bag(path) as bag:
        kinds = {one.topic: one.msgtype for one in bag.connections if one.msgcount}
        topic = choose(select, sorted(kinds), "topic", path)
        records = []
        for connection, time_ns, data in bag.messages([one for one in bag.connections if one.topic == topic]):
            message = bag.deserialize(data, connection.msgtype)
            records.append({"log_time": np.datetime64(time_ns, "ns")} | dict(flat(message, _parts)))
    return ForeignTable(of_records(records), metadata={"topic": topic, "type": kinds[topic]})


DB3 = Format("db3", "bag of ROS", _open_db3, endings=(".db3", ".bag"), magic=BAG_MAGIC, extra="rosbags")


# ---------------------------------------------------------------- messages of known types


def _pose(at: str) -> dict[str, str]:
    """Return the log column for each field of a ROS 2 pose, whose name begins with the prefix ``at``."""
    return axes(f"{at}position.{{}}", "{}_m") | axes(f"{at}orientation.{{}}", "q{}", "wxyz")


#: Column of the log for each field of a ROS 2 message, by message type. Types are written without ``/msg``.
ROS_FIELDS: dict[str, dict[str, str]] = {
    "nav_msgs/Odometry": _pose("pose.pose.")
    | axes("twist.twist.linear.{}", "{}_m_s", "xyz", "uvw")
    | axes("twist.twist.angular.{}", "w{}_rad_s"),
    "geometry_msgs/PoseStamped": _pose("pose."),
    "geometry_msgs/PoseWithCovarianceStamped": _pose("pose.pose."),
    "sensor_msgs/Imu": axes("linear_acceleration.{}", "a{}_m_s2")
    | axes("angular_velocity.{}", "w{}_rad_s")
    | axes("orientation.{}", "q{}", "wxyz"),
    "sensor_msgs/NavSatFix": {"altitude": "altitude_m"},
    "sensor_msgs/JointState": {},
}


def _topics(path: Path) -> dict[str, str]:
    """Return the topics of a ROS 2 recording with a known message type, each with its type."""
    kinds = {topic: kind.replace("/msg/", "/") for topic, kind in topics(path).items()}
    return {topic: kind for topic, kind in kinds.items() if kind in ROS_FIELDS}


def _recognises(peek: Peek) -> bool:
    return bool(_topics(peek.path))


def _read_ros2(path: Path, options: ReaderOptions, select: str | None) -> ForeignTable:
    topics = _topics(path)
    topic = choose(select, list(topics), "topic", path)
    table = open_table(path, select=topic)
    stamp = table.columns.get("header.stamp")
    if stamp is None or not (stamp.astype(np.int64) > 0).any():
        stamp = table.columns["log_time"]
        table.notes.append("the messages have no stamps; the times are those of the recorder")
    (time_s, start), kind = from_first(stamp), topics[topic]
    table.metadata |= start
    if kind == "sensor_msgs/NavSatFix":
        place, origin = east_north(*(table.columns[name] for name in ("latitude", "longitude")))
        table.metadata |= origin
        columns = place | rename_columns(table, ROS_FIELDS[kind])
    else:
        columns = rename_columns(table, ROS_FIELDS[kind] or _joints(table))
    keys = {name: table.columns[name] for name in ("header.frame_id",) if name in table.columns}
    return replace(table, columns={TIME: time_s, **with_angles(columns)}, keys=keys)


def _joints(table: ForeignTable) -> dict[str, str]:
    """Return the log column for each field of ROS 2 joint states. All joints are taken to be revolute."""
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


ROS2 = Format(
    "ros2", "recording of ROS", _read_ros2, _recognises, magic=(MCAP_MAGIC, *BAG_MAGIC), extra="mcap,rosbags"
)
