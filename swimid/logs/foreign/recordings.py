"""Readers of recordings with topics: ULog (with pyulog), and MCAP with ROS 2 or JSON messages (with mcap)."""

from __future__ import annotations

import contextlib
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from swimid.logs.foreign import Format, Options, Table, choose, first_bytes, flat, of_records, reading

ULOG_MAGIC, MCAP_MAGIC = b"ULog\x01\x12\x35", b"\x89MCAP0\r\n"


def topics(path: Path) -> dict[str, str]:
    """Return the topics of a recording, each with the type of its messages as stated in the file.

    If a topic of a ULog recording has several instances, they are named ``name[0]``, ``name[1]``.
    """
    if first_bytes(path, len(ULOG_MAGIC)) == ULOG_MAGIC:
        return {topic: data.name for topic, data in _load_ulog(path)[1].items()}
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


def _load_ulog(path: Path) -> tuple[Any, dict[str, Any]]:
    """Return the recording and its topics, by name."""
    with reading(path, "ULog recording", "ulog"), contextlib.redirect_stdout(io.StringIO()):
        # the library prints warnings about a damaged file, but stdout is reserved for results
        from pyulog import ULog

        log = ULog(str(path))
    several = {data.name for data in log.data_list if data.multi_id}
    found = {}
    for data in log.data_list:
        name = data.name
        if name in several:
            name += f"[{data.multi_id}]"
        found[name] = data
    return log, found


def _open_ulog(path: Path, options: Options, select: str | None) -> Table:
    log, found = _load_ulog(path)
    topic = choose(select, list(found), "topic", path)
    # rename q[0] to q[1]: elements are counted from 1 in every format
    values = {
        re.sub(r"\[(\d+)\]$", lambda index: f"[{int(index[1]) + 1}]", name): column
        for name, column in found[topic].data.items()
    }
    notes = []
    if log.dropouts:
        notes.append(f"{len(log.dropouts)} dropouts while it was recorded")
    if log.file_corruption:
        notes.append("the file is damaged; its readable part was read")
    return Table(values, metadata={"topic": topic}, notes=notes)


def _open_mcap(path: Path, options: Options, select: str | None) -> Table:
    """Return the messages of one topic in the order of the file, with times as ``datetime64[ns]``.

    The messages are not sorted by ``log_time``, because the clock of the recorder may be set back.
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
            record = {
                "log_time": np.datetime64(message.log_time, "ns"),
                "publish_time": np.datetime64(message.publish_time, "ns"),
            }
            records.append(record | dict(flat(decode(message.data), _parts)))
    return Table(of_records(records), metadata={"topic": topic, "type": known[topic]})


def _parts(value: Any) -> Any:
    """Return the fields of a message as a dict, and a time stamp of seconds and nanoseconds as a date."""
    if hasattr(value, "__slots__"):
        value = {name: getattr(value, name) for name in value.__slots__}
    if isinstance(value, dict) and {"sec", "nanosec"} <= set(value):
        return np.datetime64(int(value["sec"]) * 1_000_000_000 + int(value["nanosec"]), "ns")
    return value


ULOG = Format(
    "ulog", "ULog recording", _open_ulog, endings=(".ulg", ".ulog"), magic=(ULOG_MAGIC,), extra="ulog"
)
MCAP_TITLE = "MCAP file of ROS 2 or JSON messages"
MCAP = Format("mcap", MCAP_TITLE, _open_mcap, endings=(".mcap",), magic=(MCAP_MAGIC,), extra="mcap")
