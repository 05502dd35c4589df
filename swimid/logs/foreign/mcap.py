"""MCAP recordings (ROS 2 bags, or messages in JSON), by the ``mcap`` libraries."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError
from swimid.logs.foreign.base import Chunk, Column, Options, Reader, Source, flat, kind_of, one_of, reading

#: Messages a piece.
ROWS = 20_000
#: Fields nested deeper are left.
DEEPEST = 12


class McapSource(Source):
    """One topic of an MCAP file."""

    def __init__(self, path: Path, options: Options) -> None:
        self._path = path
        counts = self._topics()
        self.topic = one_of(options.topic, list(counts), file=path, what="topic", key="topic")
        first = next(self._messages(), None)
        if first is None:
            raise InputError(f"holds no message of '{self.topic}'", file=path)
        rows = counts[self.topic]
        columns = [Column(name, kind_of(np.asarray(value)), rows) for name, value in first.items()]
        super().__init__(columns, {"topic": self.topic}, steps=rows)

    def _topics(self) -> dict[str, int | None]:
        """Every topic with its number of messages, None where the file has no summary."""
        from mcap.reader import make_reader

        with reading(self._path, "MCAP file"), self._path.open("rb") as stream:
            summary = make_reader(stream).get_summary()
            if summary is None or summary.statistics is None:
                stream.seek(0)
                topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
                return dict.fromkeys(sorted(topics))
            found: dict[str, int | None] = {}
            for number, channel in summary.channels.items():
                if count := summary.statistics.channel_message_counts.get(number):
                    found[channel.topic] = (found.get(channel.topic) or 0) + count
            return dict(sorted(found.items()))

    def _messages(self) -> Iterator[dict[str, Any]]:
        """Plain fields of each message, in the order of their log times; times in ns since 1970."""
        from mcap.reader import make_reader

        with reading(self._path, "MCAP file"), self._path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=_decoders())
            for found in reader.iter_decoded_messages(topics=[self.topic]):
                stamps = {
                    name: np.datetime64(getattr(found.message, name), "ns")
                    for name in ("log_time", "publish_time")
                }
                yield stamps | {
                    name: value
                    for name, value in flat(found.decoded_message, DEEPEST, _fields)
                    if isinstance(value, bool | int | float | np.number | np.datetime64 | str)
                }

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` messages; fields a message lacks are NaN."""
        times = {column.name for column in self.columns if column.kind == "time"}
        messages = self._messages()
        while piece := list(islice(messages, ROWS)):
            yield {name: _column([m.get(name) for m in piece], name in times) for name in names}
            step(len(piece))


def _decoders() -> list[Any]:
    from mcap_ros2.decoder import DecoderFactory

    class Json:
        """Messages that are JSON texts."""

        def decoder_for(self, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
            return json.loads if encoding == "json" else None

    return [DecoderFactory(), Json()]


def _fields(value: Any) -> Any:
    """The fields of a message; a stamp of seconds and nanoseconds as a date."""
    names = getattr(value, "__slots__", None) or getattr(value, "__dict__", None)
    if names is not None:
        value = {name: getattr(value, name) for name in names if not name.startswith("_")}
    if isinstance(value, dict) and {"sec", "nanosec"} <= set(value):
        return np.datetime64(int(value["sec"]) * 1_000_000_000 + int(value["nanosec"]), "ns")
    return value


def _column(values: list[Any], dates: bool) -> NDArray[Any]:
    if dates:
        return np.array([np.datetime64("NaT") if v is None else v for v in values], dtype="datetime64[ns]")
    return np.array([float(v) if isinstance(v, int | float | np.number) else np.nan for v in values])


READER = Reader("mcap", "MCAP recording", (".mcap",), McapSource, magic=(b"\x89MCAP0\r\n",), extra="mcap")
