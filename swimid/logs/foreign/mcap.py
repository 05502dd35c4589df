"""MCAP recordings (ROS 2 bags, or messages in JSON), by the ``mcap`` libraries."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from swimid.logs.foreign.base import Options, Reader, Table, flat, of_records, one_of

MAGIC = b"\x89MCAP0\r\n"


def topics(path: Path) -> dict[str, str]:
    """Return the type of the messages of every topic, as the schema names it (``nav_msgs/msg/Odometry``)."""
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


def load(path: Path, options: Options) -> Table:
    """Read one topic, its messages in the order of the file; times are ``datetime64[ns]``.

    The order of the file is kept, since the recorder's clock (``log_time``) may step back.
    """
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    known = topics(path)
    topic = one_of(options.topic, list(known), file=path, what="topic")
    records, decoders = [], DecoderFactory()
    with path.open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=[topic], log_time_order=False)
        for schema, channel, message in found:
            decode = decoders.decoder_for(channel.message_encoding, schema) or json.loads
            record = {
                "log_time": np.datetime64(message.log_time, "ns"),
                "publish_time": np.datetime64(message.publish_time, "ns"),
            }
            records.append(record | dict(flat(decode(message.data), _parts)))
    return Table(of_records(records), metadata={"topic": topic, "type": known[topic]})


def _parts(value: Any) -> Any:
    """Return the fields of a message as a dict; a stamp of seconds and nanoseconds as a date."""
    if hasattr(value, "__slots__"):
        value = {name: getattr(value, name) for name in value.__slots__}
    if isinstance(value, dict) and {"sec", "nanosec"} <= set(value):
        return np.datetime64(int(value["sec"]) * 1_000_000_000 + int(value["nanosec"]), "ns")
    return value


READER = Reader("mcap", "MCAP file of ROS 2 or JSON messages", (".mcap",), load, magic=(MAGIC,), extra="mcap")
