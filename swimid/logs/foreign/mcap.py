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
from swimid.logs.foreign.base import Chunk, Column, Options, Reader, one_of

#: Messages a piece.
ROWS = 20_000
#: Times every message has beside its fields; nanoseconds since 1970.
STAMPS = ("log_time", "publish_time")
_DEEPEST = 12


class McapSource:
    """One topic of an MCAP file."""

    def __init__(self, path: Path, options: Options) -> None:
        import mcap.reader  # noqa: F401 - tells at once whether it is installed

        self._path = path
        counts = self._topics()
        self.topic = one_of(options.topic, list(counts), file=path, what="topic", key="topic")
        first = next(self._messages(), None)
        if first is None:
            raise InputError(f"holds no message of '{self.topic}'", file=path)
        rows = counts[self.topic]
        self.columns = [
            Column(
                name,
                "time" if value.dtype.kind == "M" else "text" if value.dtype.kind not in "iufb" else "number",
                rows,
            )
            for name, value in ((name, np.asarray(value)) for name, value in first.items())
        ]
        self.metadata: dict[str, Any] = {"topic": self.topic}
        self.comments: list[str] = []
        self.scalars: dict[str, float] = {}
        self.notes: list[str] = []
        self.steps: int | None = rows

    def _topics(self) -> dict[str, int | None]:
        """Every topic with its number of messages, None where the file has no summary."""
        from mcap.reader import make_reader

        with self._reading() as stream:
            summary = make_reader(stream).get_summary()
            if summary is None or summary.statistics is None:
                stream.seek(0)
                topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
                return dict.fromkeys(sorted(topics))
            counts = summary.statistics.channel_message_counts
            found: dict[str, int | None] = {}
            for number, channel in summary.channels.items():
                if counts.get(number):
                    found[channel.topic] = (found.get(channel.topic) or 0) + counts[number]
            return dict(sorted(found.items()))

    def _reading(self) -> Any:
        return _Explaining(self._path)

    def _messages(self) -> Iterator[dict[str, Any]]:
        """Flat fields of each message, in the order of their log times."""
        from mcap.reader import make_reader

        with self._reading() as stream:
            reader = make_reader(stream, decoder_factories=_decoders())
            for found in reader.iter_decoded_messages(topics=[self.topic]):
                flat: dict[str, Any] = {
                    "log_time": np.datetime64(found.message.log_time, "ns"),
                    "publish_time": np.datetime64(found.message.publish_time, "ns"),
                }
                _flatten("", found.decoded_message, flat, 0)
                yield flat

    def chunks(self, names: Sequence[str], step: Callable[[int], None]) -> Iterator[Chunk]:
        """Pieces of :data:`ROWS` messages; fields a message lacks are NaN."""
        times = {column.name for column in self.columns if column.kind == "time"}
        messages = self._messages()
        while piece := list(islice(messages, ROWS)):
            yield {name: _column([m.get(name) for m in piece], name in times) for name in names}
            step(len(piece))

    def lines(self, count: int) -> NDArray[np.int64] | None:
        """A recording has no lines."""
        return None

    def close(self) -> None:
        """Nothing is held open between readings."""


class _Explaining:
    """The opened file; what the library raises of a damaged one becomes an InputError."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> Any:
        try:
            self._stream = self._path.open("rb")
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror or error}", file=self._path) from error
        return self._stream

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: Any) -> None:
        self._stream.close()
        if isinstance(error, Exception) and not isinstance(error, InputError | ImportError):
            first = (str(error) or type(error).__name__).splitlines()[0]
            raise InputError(f"is no readable MCAP file: {first}", file=self._path) from error


def _decoders() -> list[Any]:
    from mcap_ros2.decoder import DecoderFactory

    class Json:
        """Messages that are JSON texts."""

        def decoder_for(self, encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
            return json.loads if encoding == "json" else None

    return [DecoderFactory(), Json()]


def _flatten(prefix: str, value: Any, flat: dict[str, Any], depth: int) -> None:
    """Numbers of a message by their dotted names; a stamp of seconds and nanoseconds as a date."""
    fields = None
    if isinstance(value, dict):
        fields = value
    elif hasattr(value, "__slots__") or hasattr(value, "__dict__"):
        names = getattr(value, "__slots__", None) or vars(value)
        fields = {name: getattr(value, name) for name in names if not name.startswith("_")}
    if fields is not None and depth < _DEEPEST:
        if {"sec", "nanosec"} <= set(fields):
            stamp = int(fields["sec"]) * 1_000_000_000 + int(fields["nanosec"])
            flat[prefix] = np.datetime64(stamp, "ns")
            return
        for name, inner in fields.items():
            _flatten(f"{prefix}.{name}" if prefix else str(name), inner, flat, depth + 1)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= 100 and depth < _DEEPEST:
        for at, inner in enumerate(value, start=1):
            _flatten(f"{prefix}[{at}]", inner, flat, depth + 1)
    elif isinstance(value, bool | int | float | np.number | str):
        flat[prefix] = value


def _column(values: list[Any], dates: bool) -> NDArray[Any]:
    if dates:
        return np.array([np.datetime64("NaT") if v is None else v for v in values], dtype="datetime64[ns]")
    return np.array([float(v) if isinstance(v, int | float | np.number) else np.nan for v in values])


READER = Reader("mcap", "MCAP recording", (".mcap",), McapSource, magic=(b"\x89MCAP0\r\n",), extra="mcap")
