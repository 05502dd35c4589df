"""MCAP recordings (ROS 2 bags, or messages in JSON), by the ``mcap`` libraries."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError
from swimid.logs.foreign.base import Options, Reader, Table, flat, of_records, one_of, reading

MAGIC = b"\x89MCAP0\r\n"
#: Fields nested deeper are left out.
DEEPEST = 12


def topics(path: Path) -> dict[str, str]:
    """Return the type of the messages of every topic, as the schema names it (``nav_msgs/msg/Odometry``)."""
    from mcap.reader import make_reader

    with reading(path, "MCAP file"), path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        counts = (
            {} if summary is None or summary.statistics is None else summary.statistics.channel_message_counts
        )
        if summary is not None and counts:
            found = {
                channel.topic: summary.schemas.get(channel.schema_id)
                for number, channel in summary.channels.items()
                if counts.get(number)
            }
        else:
            stream.seek(0)
            found = {channel.topic: schema for schema, channel, _ in make_reader(stream).iter_messages()}
    return {topic: getattr(schema, "name", "") or "" for topic, schema in sorted(found.items())}


def load(path: Path, options: Options) -> Table:
    """Read one topic, its messages in the order of the file; times are ``datetime64[ns]``.

    The order of the file is kept, since the recorder's clock (``log_time``) may step back.
    """
    from mcap.reader import make_reader

    known = topics(path)
    key = "--select NAME, or reader: {topic: NAME} in a mapping, with"
    topic = one_of(options.topic, list(known), file=path, what="topic", key=key)
    records: list[dict[str, Any]] = []
    with reading(path, "MCAP file"), path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=_decoders())
        for found in reader.iter_decoded_messages(topics=[topic], log_time_order=False):
            stamps = {
                name: np.datetime64(getattr(found.message, name), "ns")
                for name in ("log_time", "publish_time")
            }
            records.append(stamps | dict(flat(found.decoded_message, DEEPEST, _fields)))
    if not records:
        raise InputError(f"holds no message of '{topic}'", file=path)
    return Table(of_records(records), metadata={"topic": topic, "type": known[topic]})


def _decoders() -> list[Any]:
    from mcap_ros2.decoder import DecoderFactory

    class Json:
        """Messages that are JSON texts."""

        def decoder_for(self, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
            return json.loads if encoding == "json" else None

    return [DecoderFactory(), Json()]


def _fields(value: Any) -> Any:
    """Return the fields of a message as a dict; a stamp of seconds and nanoseconds as a date."""
    names = getattr(value, "__slots__", None) or getattr(value, "__dict__", None)
    if names is not None:
        value = {name: getattr(value, name) for name in names if not name.startswith("_")}
    if isinstance(value, dict) and {"sec", "nanosec"} <= set(value):
        return np.datetime64(int(value["sec"]) * 1_000_000_000 + int(value["nanosec"]), "ns")
    return value


READER = Reader("mcap", "MCAP recording", (".mcap",), load, magic=(MAGIC,), extra="mcap")
